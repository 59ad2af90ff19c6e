"""A store whose writers are killed, whose disk fails, whose bits rot, whose power goes."""

import csv
import errno
import os
import shutil
import tempfile
from pathlib import Path

import faults
import pytest
from faults import Case, bare, contents
from power import power_cuts

import porous.formats as po_formats
from porous import disk
from porous.errors import DiskError, FormatError
from porous.scale import Store

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def base():
    """A folder in memory where there is one: what is tested is not how fast disks are."""
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=memory) as folder:
        yield Path(folder)


@pytest.fixture(scope="module")
def case(base):
    return Case(base / "case")


@pytest.fixture
def folder(base):
    return bare(base / "grid.zarr")


def in_one_thread(base, work):
    """Return what a function of ``faults`` finds that forks, in a process of one thread."""
    return faults.found_of("faults.Case", base / "killed", work)


@pytest.mark.parametrize("when", ["before", "amid", "after"])
def test_killed_at_a_call_to_the_disk(base, folder, when):
    first = ("before", "amid", "after").index(when) + 1
    numbers = f"range({first}, faults.length(case, {str(folder)!r}), 9)"
    found = in_one_thread(
        base, f"faults.kills_at_calls(case, {str(folder)!r}, {numbers}, {when!r})"
    )
    assert found["struck"] == found["trials"] >= 20
    assert found["read_as_whole"] <= 2


def test_killed_at_random(base, folder):
    found = in_one_thread(base, f"faults.kills_at_random(case, {str(folder)!r}, 10, seed=1)")
    assert found["struck"] == 10


@pytest.mark.parametrize(
    ("code", "persistent"), [("ENOSPC", True), ("EIO", False), ("EMFILE", False)]
)
def test_the_disk_fails_at_any_call(case, folder, code, persistent):
    found = faults.faults(case, folder, code, persistent=persistent, step=5)
    assert found["trials"] >= 40
    assert found["struck"] >= 0.8 * found["trials"]
    assert found["read_as_whole"] - (found["trials"] - found["struck"]) <= 2


@pytest.mark.parametrize("persistent", [False, True])
@pytest.mark.parametrize("code", ["EIO", "EMFILE", "EACCES"])
def test_reading_fails_at_any_call(case, code, persistent):
    found = faults.faults_of_readers(case, code, persistent=persistent)
    assert found["trials"] >= 30
    assert found["struck"] >= found["trials"] - 4


def test_short_writes_give_the_same_bytes(case, folder):
    for seed in range(3):
        bare(folder)
        with faults.calls(faults.short_writes(seed)):
            case.go_on(folder)
        assert contents(folder) == case.bytes


def test_a_flipped_bit_in_any_chunk_is_found_and_the_chunk_named(case, folder):
    found = faults.flips(case, folder, 100, seed=2, of_chunks=True)
    assert found["found_and_named"] == 100
    assert found["mended_by_resume"] == 10


def test_a_flipped_bit_in_any_other_file_is_found_and_the_file_named(case, folder):
    found = faults.flips(case, folder, 100, seed=3, of_chunks=False)
    assert found["found_and_named"] == 100


def test_what_a_power_cut_leaves(case, base):
    found = power_cuts(case, base, trials=1, seed=4)
    assert found["trials"] >= 60
    assert found["read_as_whole"] <= 3


def test_disks_that_are_too_small(base):
    if faults.room() is None:
        pytest.skip("this user may not mount a small disk")
    work = f"faults.small_disks(case, {str(base)!r}, [4, 24, 48, 72])"
    found = faults.found_of("faults.Case", base / "room", work, wrapped=faults.room())
    if found is None:
        pytest.skip("this user may not mount a small disk")
    assert found["struck"] == 3
    assert all("no space left on device" in text for text in found["said"])


def test_a_transient_error_removes_nothing(case, folder, monkeypatch):
    """Handles that run out say nothing about the chunks: they are not taken for damaged."""
    shutil.copytree(case.folder, folder)
    real = os.open

    def few(path, *args, **kwargs):
        if "c." in Path(path).name:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        return real(path, *args, **kwargs)

    with monkeypatch.context() as patched:
        patched.setattr(os, "open", few)
        with pytest.raises(DiskError, match="cannot be read: too many open files"):
            Store.resume(folder, faults.RECIPE)
        with pytest.raises(DiskError, match="too many open files"):
            Store.open(folder).verify()
    assert contents(folder) == case.bytes


def test_a_damaged_plan_is_mended_from_its_copy_and_the_other_way_round(case, folder):
    for name in ("plan.json", "zarr.json", "fill/zarr.json", "manifest.json"):
        shutil.copytree(case.folder, bare(folder))
        (folder / name).unlink()
        with pytest.raises(FormatError):
            Store.open(folder)
        assert Store.resume(folder, faults.RECIPE).missing() == ()
        case.check_resumed(folder)
    (folder / "plan.json").unlink()
    faults.flip(folder / "zarr.json", 1234)
    with pytest.raises(FormatError, match="has no plan"):
        Store.resume(folder, faults.RECIPE)


def test_leftovers_are_swept(case, folder):
    shutil.copytree(case.folder, folder)
    for place in (folder, folder / "fill", folder / "bulk"):
        (place / f"{disk.TEMPORARY}0123").write_bytes(b"half")
    (folder / f"{disk.TEMPORARY}4567").mkdir()
    (folder / f"{disk.TEMPORARY}4567" / "x").write_bytes(b"")
    assert case.check(folder)
    case.check_resumed(folder)
    assert not [path for path in folder.rglob("*") if disk.TEMPORARY in path.name]


def test_a_store_is_begun_where_its_creation_was_killed(case, folder):
    folder.mkdir()
    (folder / f"{disk.TEMPORARY}0123").write_bytes(b"half a plan")
    case.check_resumed(folder)


def test_the_study_held_in_full():
    study = HERE.parent / "analysis" / "results" / "07_store_faults.csv"
    with study.open(newline="", encoding="utf-8") as stream:
        rows = {row["experiment"]: row for row in csv.DictReader(stream)}
    assert {row["did_not_hold"] for row in rows.values()} == {"0"}
    for part, most in (
        ("killed at random times", 200),
        ("killed before every call to the disk", 200),
        ("a bit flipped in a chunk", 2000),
    ):
        for name in (part, f"make: {part}"):
            assert int(rows[name]["struck"]) >= most
    every = {int(row["trials"]) for name, row in rows.items() if name.startswith("make: E")}
    assert len(every) == 1  # of all errors
    assert min(every) >= 400
    assert {f"make: killed {when} every call to the disk" for when in ("before", "after")} < set(
        rows
    )
    speeds = [row["note"] for name, row in rows.items() if name.startswith("speed")]
    assert len(speeds) == 2
    assert all(float(said.split()[0]) >= 300 for said in speeds)


@pytest.mark.parametrize("name", faults.writers())
def test_every_writer_leaves_the_old_file_or_the_new_one(base, name):
    suffix, write, fail = faults.writers()[name]
    place = bare(base / "file")
    place.mkdir()
    found = fail(write, place / f"x{suffix}", "EIO", persistent=False)
    assert found["struck"] >= 6


def test_there_is_an_example_for_every_format():
    names = faults.writers()
    for form in po_formats.formats():
        assert not (form.write or form.write_files) or form.writes
        assert all(f"{form.suffix} of a {kind.__name__}" in names for kind in form.writes)
    assert {".stl, streamed", ".ply, streamed"} <= set(names)
