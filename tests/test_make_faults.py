"""`porous make --out-of-core` and `porous resume`: killed, on failing and full disks, amid rot."""

import os
import shutil
import tempfile
from pathlib import Path

import faults
import make_faults
import numpy as np
import pytest
import zarr
from faults import bare, contents
from power import power_cuts

from porous import workspace
from porous.cli import main
from porous.errors import DiskError, FormatError, RecipeError
from porous.recipe import load


@pytest.fixture(scope="module", autouse=True)
def base():
    """A folder in memory where there is one: what is tested is not how fast disks are."""
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=memory) as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("POROUS_THREADS", "1")  # the same calls in the same order
        yield Path(folder)


@pytest.fixture(scope="module")
def case(base):
    return make_faults.MakeCase(base / "case")


@pytest.fixture(scope="module")
def unfinished(base):
    return make_faults.UnfinishedCase(base / "case of another")


@pytest.fixture
def folder(base):
    return bare(base / "out")


# --- deaths ------------------------------------------------------------------------------


def killed(base, name, numbers, when):
    folder = str(base / "out")
    every = f"range(1, faults.length(case, {folder!r}) + 1)"
    work = f"faults.kills_at_calls(case, {folder!r}, {every}{numbers}, {when!r})"
    found = faults.found_of(f"make_faults.{name}", base / "killed", work)
    assert found["struck"] == found["trials"]
    assert found["read_as_whole"] <= 3
    return found["trials"]


def test_killed_at_a_call_to_the_disk(base):
    assert killed(base, "MakeCase", "[4::90]", "before") >= 5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "when"), [("MakeCase", "amid"), ("MakeCase", "after"), ("MendCase", "before")]
)
def test_killed_at_many_calls_to_the_disk(base, name, when):
    assert killed(base, name, "[3::40]", when) >= 10


@pytest.mark.slow
def test_killed_at_random(base):
    work = f"faults.kills_at_random(case, {str(base / 'out')!r}, 10, seed=1)"
    found = faults.found_of("make_faults.MakeCase", base / "killed", work)
    assert found["struck"] == 10


# --- failing disks -----------------------------------------------------------------------


@pytest.mark.parametrize(("code", "persistent"), [("ENOSPC", True), ("EIO", False)])
def test_the_disk_fails_at_a_call(case, folder, code, persistent):
    found = faults.faults(case, folder, code, persistent=persistent, step=80, first=7)
    assert found["trials"] >= 5
    assert found["struck"] >= 0.5 * found["trials"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "persistent"),
    [("EIO", True), ("EMFILE", False), ("EROFS", True)],
)
def test_the_disk_fails_at_many_calls(case, folder, code, persistent):
    found = faults.faults(case, folder, code, persistent=persistent, step=40)
    assert found["trials"] >= 15
    assert found["struck"] >= 0.7 * found["trials"]


@pytest.mark.slow
def test_the_disk_fails_while_damage_is_mended(base, folder):
    case = make_faults.MendCase(base / "rotten")
    found = faults.faults(case, folder, "EIO", persistent=True, step=40)
    assert found["trials"] >= 15
    assert found["struck"] >= 0.7 * found["trials"]


def test_short_writes_give_the_same_bytes(case, folder):
    with case.calls(faults.short_writes(1), folder):
        case.go_on(folder)
    assert case.lasting(folder) == case.bytes


def test_what_a_power_cut_leaves(case, base):
    found = power_cuts(case, base, trials=1, seed=4, step=30)
    assert found["trials"] >= 5
    assert found["read_as_whole"] <= 2


@pytest.mark.slow
def test_what_many_power_cuts_leave(case, base):
    assert power_cuts(case, base, trials=1, seed=5, step=12)["trials"] >= 30


@pytest.mark.slow
def test_a_disk_that_gets_full(base):
    if faults.room() is None:
        pytest.skip("this user may not mount a small disk")
    work = f"make_faults.command_on_small_disks(case, {str(base)!r}, [8, 100])"
    found = faults.found_of("make_faults.MakeCase", base / "room", work, wrapped=faults.room())
    if found is None:
        pytest.skip("this user may not mount a small disk")
    assert all("no space left on device" in text for text in found["said"])


def complaints(capsys):
    """Return the lines of standard error that are no progress."""
    lines = capsys.readouterr().err.splitlines()
    return [line for line in lines if line.startswith("porous:") or "Error" in line]


# --- bits that rot -----------------------------------------------------------------------


def test_a_flipped_bit_of_a_chunk_is_found_and_mended(case, folder):
    found = make_faults.flips_of_chunks(case, folder, 30, seed=2)
    assert found["mended_by_resume"] == 3


def test_a_flipped_bit_of_a_small_file_is_found_and_mended(case, folder):
    found = make_faults.flips_of_small(case, folder, step=900, first=5)
    assert found["trials"] >= 30


@pytest.mark.parametrize("name", make_faults.TOLD)
def test_a_flipped_bit_of_what_is_wanted_is_refused(unfinished, folder, name):
    found = make_faults.flips_of_told(unfinished, folder, name, step=401, first=3)
    assert found["struck"] >= 4


def test_a_flipped_bit_of_counts_written_down_changes_nothing(unfinished, folder):
    make_faults.flips_of_counts(unfinished, folder, 5, seed=1)


def test_a_changed_recipe_is_refused_and_nothing_lost(case, folder, capsys):
    shutil.copytree(case.folder, folder)
    path = folder / "recipe.toml"
    path.write_text(path.read_text().replace("level = 1", "level = 2"))
    before = contents(folder)
    for work in (workspace.resume, workspace.is_whole):
        with pytest.raises(RecipeError, match="belongs to another recipe"):
            work(folder)
    assert main(["resume", str(folder)]) == 2
    assert len(complaints(capsys)) == 1
    assert contents(folder) == before


def test_a_recipe_changed_before_there_are_voxels_is_refused(case, folder):
    folder.mkdir()
    (folder / "recipe.toml").write_bytes(case.bytes["recipe.toml"])
    (folder / workspace.UNFINISHED).write_bytes(case.begun)
    path = folder / "recipe.toml"
    path.write_text(path.read_text().replace("level = 1", "level = 2"))
    with pytest.raises(RecipeError, match="belongs to another recipe"):
        workspace.resume(folder)
    path.write_bytes(case.bytes["recipe.toml"])
    case.check_resumed(folder)  # with the chunks that were asked for


def test_what_says_what_is_wanted_is_mended_by_making_again(unfinished, folder):
    unfinished.begin(folder)
    faults.flip(folder / workspace.UNFINISHED, 800)
    with pytest.raises(FormatError, match=r"unfinished.json: .*; make its folder again"):
        workspace.resume(folder)
    chunks = {path: path.stat().st_mtime_ns for path in folder.rglob("c.*")}
    unfinished.make(folder)
    assert unfinished.lasting(folder) == unfinished.bytes
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("c.*")} == chunks


@pytest.mark.parametrize("text", ["[]", '{"only": []}', "[" * 100_000, "\udcff", '{"only": "al"}'])
def test_a_log_that_says_nothing_of_use(case, folder, text):
    shutil.copytree(case.folder, folder)
    (folder / workspace.LOG).write_bytes(text.encode(errors="surrogateescape"))
    assert not workspace.is_whole(folder)


# --- foreign stores ----------------------------------------------------------------------


def zarr_v2(place):
    zarr.create_array(place, shape=(9, 9, 9), dtype="u1", zarr_format=2)[:] = 1


def zarr_v3(place):
    group = zarr.create_group(place)
    group.create_array("fill", shape=(9, 9, 9), chunks=(5, 5, 5), dtype="u1")[:] = np.uint8(1)


def hdf5(place):
    place.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(88))


def dangling(place):
    place.symlink_to("nowhere")


def a_plan_of_something_else(place):
    place.mkdir()
    (place / "plan.json").write_text('{"crop": "wheat"}')


def link_to_itself(place):
    place.symlink_to(place.name)


@pytest.mark.parametrize("recipe", [True, False], ids=["made before", "no recipe"])
@pytest.mark.parametrize(
    "lay", [zarr_v2, zarr_v3, hdf5, a_plan_of_something_else, link_to_itself, dangling]
)
def test_a_foreign_store_is_refused_and_kept(case, folder, capsys, lay, recipe):
    folder.mkdir()
    if recipe:
        for name in ("recipe.toml", "measures.json", "surface.stl"):
            (folder / name).write_bytes(case.bytes[name])
    lay(folder / "grid.zarr")
    before = contents(folder)
    settings = [f"--set={key}={value}" for key, value in make_faults.SETTINGS.items()]
    make = ["make", "menger", *settings, "--only", "measures", "-o", str(folder)]
    for arguments in ([*make, "--out-of-core"], make, ["resume", str(folder)]):
        assert main(arguments) in (1, 2)
        (said,) = complaints(capsys)
        assert str(folder) in said
        assert "fault of porous" not in said
    assert contents(folder) == before


def test_a_link_in_the_place_of_a_chunk_is_replaced_by_the_chunk(case, folder, base):
    shutil.copytree(case.folder, folder)
    chunk = folder / "grid.zarr/fill/c.0.1.0"
    chunk.rename(base / "elsewhere")
    chunk.symlink_to(base / "elsewhere")
    assert not workspace.is_whole(folder)
    case.check_resumed(folder)
    assert chunk.is_file()
    assert not chunk.is_symlink()
    assert (base / "elsewhere").read_bytes() == case.bytes["grid.zarr/fill/c.0.1.0"]


def test_a_folder_in_the_place_of_a_chunk_is_refused_and_kept(case, folder):
    shutil.copytree(case.folder, folder)
    chunk = folder / "grid.zarr/fill/c.0.1.0"
    chunk.unlink()
    chunk.mkdir()
    (chunk / "mine").write_bytes(b"precious")
    assert not workspace.is_whole(folder)
    with pytest.raises(DiskError, match=r"c.0.1.0: cannot be removed: is a directory"):
        workspace.resume(folder)
    assert (chunk / "mine").read_bytes() == b"precious"
    shutil.rmtree(chunk)
    case.check_resumed(folder)


def test_a_store_of_another_recipe_is_kept_whatever_the_folder_says(case, folder):
    shutil.copytree(case.folder, folder)
    other = load("menger", set={**make_faults.SETTINGS, "model.level": 2})
    for name in ("recipe.toml", workspace.LAST):
        (folder / name).unlink()
        before = contents(folder)
        with pytest.raises(RecipeError, match="belongs to another recipe"):
            workspace.make_stored(other, folder, only="measures")
        assert contents(folder) == before
