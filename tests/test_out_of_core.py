"""A recipe made tile by tile into a store: the numbers and the bytes of memory, killed or not."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
from faults import contents

from porous import disk, workspace
from porous.cli import main
from porous.errors import (
    DiskError,
    FormatError,
    ModelError,
    PorousError,
    RecipeError,
    ViewError,
)
from porous.recipe import load
from porous.scale import Store, StoredGrid
from porous.stages import StreamedSurface

MENGER = {"model.level": 2, "voxels.voxels": 27, "surface.method": "marching-cubes"}
CHUNK = 8
TOLD_OF_PIECES = {"components", "genus", "shells"}


@pytest.fixture(autouse=True)
def no_picture(monkeypatch):
    """Draw no pictures: that takes seconds, and the report is tested elsewhere."""

    def refuse(*_, **__):
        raise ViewError("not now")

    monkeypatch.setattr("porous.report._report.picture", refuse)


def rows(result):
    return {(row.name, row.method, row.of): row for row in result.measures}


def same_to_rounding(a, b):
    numbers = (a.value, a.uncertainty), (b.value, b.uncertainty)
    return (a.unit, a.kind) == (b.unit, b.kind) and numbers[0] == pytest.approx(numbers[1], 1e-12)


def lasting(folder):
    """Return the bytes of all files that a recipe determines."""
    found = contents(folder)
    return {name: data for name, data in found.items() if name not in ("log.json", "report.html")}


CASES = {
    "menger": MENGER,
    "menger, periodic": {**MENGER, "voxels.periodic": [True, False, True]},
    "octahedron-flake": {"model.level": 2, "voxels.voxels": 25, "surface.method": "marching-cubes"},
    "sierpinski-tetrahedron": {"voxels.voxels": 23, "surface.method": "marching-cubes"},
    "menger-bent": {"model.level": 1, "voxels.voxels": 21},
    "fern": {"voxels.voxels": 24},
}


@pytest.mark.parametrize("name", CASES)
def test_the_same_as_in_memory(tmp_path, name):
    recipe = load(name.partition(",")[0], set=CASES[name])
    whole = workspace.make(recipe, tmp_path / "whole", only="measures")
    parts = workspace.make_stored(recipe, tmp_path / "parts", only="measures", chunk=CHUNK)
    assert isinstance(parts.grid, StoredGrid)
    assert parts.grid.to_grid() == whole.grid or whole.grid.bulk is None
    a, b = rows(whole), rows(parts)
    left = {row.name for key, row in a.items() if key not in b}
    assert left <= (TOLD_OF_PIECES if isinstance(parts.surface, StreamedSurface) else set()) | (
        {"surface_area", "specific_surface_area"} if any(whole.grid.frame.periodic) else set()
    )
    assert set(b) <= set(a)
    assert all(b[key] == a[key] for key in b if key[2] != "surface")
    assert all(same_to_rounding(b[key], a[key]) for key in b)
    stl = [(tmp_path / place / "surface.stl").read_bytes() for place in ("whole", "parts")]
    assert stl[0] == stl[1]


def test_everything_is_there(tmp_path):
    made = workspace.make_stored(load("menger", set=MENGER), tmp_path, chunk=CHUNK)
    wanted = {"recipe.toml", "grid.zarr", "surface.stl", "report.html", "measures.csv", "log.json"}
    assert {path.name for path in tmp_path.iterdir()} == {*wanted, workspace.LAST}
    assert made.volume is None
    assert any("no volume mesh: out of core" in note for note in made.notes)
    record = json.loads((tmp_path / workspace.LAST).read_text())
    assert record["recipe_sha256"] == load(tmp_path / "recipe.toml").sha256
    assert Store.open(tmp_path / "grid.zarr").plan.recipe_sha256 == record["recipe_sha256"]
    page = (tmp_path / "report.html").read_text()
    assert "27 × 27 × 27" in page
    assert "triangles" in page
    assert workspace.is_whole(tmp_path)


def test_what_is_there_is_not_made_again(tmp_path, monkeypatch):
    recipe = load("menger", set=MENGER)
    workspace.make_stored(recipe, tmp_path, chunk=CHUNK)
    before = lasting(tmp_path)
    written = []
    monkeypatch.setattr(Store, "write", lambda *_: written.append(1))
    workspace.make_stored(recipe, tmp_path)
    assert not written
    assert lasting(tmp_path) == before


@pytest.mark.parametrize("share", [0.2, 0.7])
def test_what_is_cancelled_is_gone_on_with(tmp_path, share):
    recipe, made = load("menger", set=MENGER), tmp_path / "made"
    workspace.make_stored(recipe, tmp_path / "whole", only="surface", chunk=CHUNK)

    def stop(stage, done):
        if stage == "voxels" and done >= share:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        workspace.make_stored(recipe, made, only="surface", chunk=CHUNK, progress=stop)
    assert not (made / workspace.LAST).exists()
    with pytest.raises(FormatError, match="unfinished"):
        Store.open(made / "grid.zarr")
    tiles = {path.name: path.stat().st_mtime_ns for path in (made / "grid.zarr/fill").glob("c.*")}
    assert len(tiles) >= share * 64 - 1
    workspace.resume(made)
    for name, time_ in tiles.items():
        assert (made / "grid.zarr/fill" / name).stat().st_mtime_ns == time_
    assert lasting(made) == lasting(tmp_path / "whole")
    assert workspace.is_whole(made)


def test_a_damaged_chunk_is_mended(tmp_path):
    workspace.make_stored(load("menger", set=MENGER), tmp_path, only="voxels", chunk=CHUNK)
    before = lasting(tmp_path)
    path = tmp_path / "grid.zarr/fill/c.1.2.0"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)
    assert not workspace.is_whole(tmp_path)
    workspace.resume(tmp_path)
    assert lasting(tmp_path) == before
    assert workspace.is_whole(tmp_path)


def remove_store(out):
    shutil.rmtree(out / "grid.zarr")


def remove_surface(out):
    (out / "surface.stl").unlink()


def cut_surface(out):
    (out / "surface.stl").write_bytes((out / "surface.stl").read_bytes()[:1000])


def cut_measures(out):
    (out / "measures.json").write_bytes((out / "measures.json").read_bytes()[:1000])


def lose_log(out):
    (out / "log.json").unlink()


@pytest.mark.parametrize(
    "spoil", [remove_store, remove_surface, cut_surface, cut_measures, lose_log]
)
def test_whatever_is_missing_or_cut_is_made_again(tmp_path, spoil):
    workspace.make_stored(load("menger", set=MENGER), tmp_path, only="measures", chunk=CHUNK)
    before = lasting(tmp_path)
    assert workspace.is_whole(tmp_path)
    spoil(tmp_path)
    assert not workspace.is_whole(tmp_path)
    workspace.resume(tmp_path)
    found = lasting(tmp_path)
    if spoil is lose_log:  # then all is asked for
        return
    assert found == before
    assert workspace.is_whole(tmp_path)


@pytest.mark.parametrize("name", ["../secret", "/etc/passwd", "a\0b", "grid.zarr/../../secret"])
def test_a_log_names_no_file_outside(tmp_path, name, monkeypatch):
    out = tmp_path / "out"
    workspace.make_stored(load("menger", set=MENGER), out, only="voxels", chunk=CHUNK)
    log = json.loads((out / "log.json").read_text())
    log["files"][name] = [1, 2]
    (out / "log.json").write_text(json.dumps(log))
    looked_at = []
    monkeypatch.setattr(workspace._make, "_sum", looked_at.append)
    assert not workspace.is_whole(out)
    assert not looked_at


def test_a_folder_made_in_memory_is_not_gone_on_with(tmp_path):
    workspace.make(load("menger", set=MENGER), tmp_path, only="voxels")
    with pytest.raises(FormatError, match="holds nothing to go on with"):
        workspace.resume(tmp_path)


@pytest.mark.parametrize("name", ["recipe.toml", "surface.stl", "report.html"])
@pytest.mark.parametrize("make", [workspace.make, workspace.make_stored])
def test_files_of_the_user_are_not_touched(tmp_path, name, make):
    (tmp_path / name).write_text("my own")
    with pytest.raises(RecipeError, match=f"holds a file {name} that porous has not made there"):
        make(load("menger", set=MENGER), tmp_path, only="voxels")
    assert contents(tmp_path) == {name: b"my own"}


@pytest.mark.parametrize("name", ["menger-block", "menger-halved"])
def test_a_bulk_that_fills_the_frame_is_none_on_disk_either(tmp_path, name):
    recipe = load(name, set={"voxels.voxels": 27, "model.level": 1})
    whole = workspace.make(recipe, tmp_path / "whole", only="voxels")
    parts = workspace.make_stored(recipe, tmp_path / "parts", only="voxels", chunk=10)
    assert whole.grid.bulk is None
    assert parts.measures == whole.measures


def test_a_file_that_a_recipe_reads_goes_along(tmp_path):
    (tmp_path / "corner.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    )
    (tmp_path / "mine.toml").write_text(
        '[model]\nkind = "ifs"\nlevel = 1\nprimitive = { mesh = "corner.obj" }\n'
        'digits = { divisions = 2, keep = "full-2" }\n[voxels]\nvoxels = 16\n'
    )
    out = tmp_path / "out"
    workspace.make_stored(load(tmp_path / "mine.toml"), out, only="voxels", chunk=CHUNK)
    (tmp_path / "corner.obj").unlink()
    (out / "grid.zarr/fill/c.0.0.0").unlink()
    before = lasting(out)
    workspace.resume(out)
    assert {**before, "grid.zarr/fill/c.0.0.0": b""}.keys() == lasting(out).keys()
    (out / "mesh.obj").write_text((out / "mesh.obj").read_text().replace("v 0 0 1", "v 0 0 .9"))
    with pytest.raises(RecipeError, match="another recipe"):
        workspace.resume(out)


def test_a_store_of_another_recipe_is_refused_and_kept(tmp_path):
    workspace.make_stored(load("menger", set=MENGER), tmp_path, only="voxels", chunk=CHUNK)
    before = contents(tmp_path)
    other = load("menger", set={**MENGER, "model.level": 1})
    for make in (workspace.make, workspace.make_stored):
        with pytest.raises(RecipeError, match="belongs to another recipe"):
            make(other, tmp_path)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"surface.smooth": 3}, "surface.smooth: got 3, which is done in memory; .* wanted 0"),
        ({"surface.simplify": 0.5}, "surface.simplify: got 0.5"),
        ({"surface.method": "voxel-faces"}, "surface.method: got 'voxel-faces'"),
    ],
)
def test_what_is_done_in_memory_only_is_refused(tmp_path, change, text):
    with pytest.raises(RecipeError, match=text):
        workspace.make_stored(load("menger", set={**MENGER, **change}), tmp_path / "out")


def test_no_empty_folder_stays_of_what_cannot_begin(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "google_crc32c", None)
    with pytest.raises(PorousError, match=r"pip install 'porous\[scale\]'"):
        workspace.make_stored(load("menger", set=MENGER), tmp_path / "new" / "out")
    assert not (tmp_path / "new").exists()


def test_nothing_is_begun_of_a_model_that_is_none(tmp_path):
    out = tmp_path / "out"
    workspace.make(load("menger", set={"model.level": 1}), out, only="model")
    before = contents(out)
    recipe = load("menger", set={"model.level": 2})
    broken = recipe.model_copy(update={"model": recipe.model.model_copy(update={"offset": -1.0})})
    with pytest.raises(ModelError):
        workspace.make_stored(broken, out)
    assert contents(out) == before


def test_nothing_to_go_on_with(tmp_path, capsys):
    for folder in (tmp_path, tmp_path / "nowhere"):
        assert main(["resume", str(folder)]) == 2
        assert "holds nothing to go on with" in capsys.readouterr().err


def test_two_at_a_time_are_refused(tmp_path):
    with disk.locked(tmp_path), pytest.raises(DiskError, match="another porous is at work there"):
        workspace.make_stored(load("menger", set=MENGER), tmp_path, chunk=CHUNK)
    workspace.make_stored(load("menger", set=MENGER), tmp_path, only="voxels", chunk=CHUNK)


# --- the command line --------------------------------------------------------------------

COMMAND = [sys.executable, "-m", "porous"]
SETTINGS = ["--set", "surface.method=marching-cubes", "--set", "model.level=3"]
MAKE = ["menger", *SETTINGS, "--voxels", "81", "--only", "measures", "--chunk", "12"]


def porous(*arguments):
    return [*COMMAND, *map(str, arguments)]


def test_made_and_resumed_by_the_command_line(tmp_path, capsys):
    assert main(["make", *MAKE, "--out-of-core", "-o", str(tmp_path)]) == 0
    assert "grid.zarr" in capsys.readouterr().out
    assert main(["resume", str(tmp_path)]) == 0
    assert "is whole; there is nothing to do" in capsys.readouterr().out
    for path in (tmp_path, tmp_path / "grid.zarr"):
        assert main(["measure", str(path)]) == 0
        assert "euler_number" in capsys.readouterr().out
    assert main(["convert", str(tmp_path / "grid.zarr"), str(tmp_path / "grid.npz")]) == 0


@pytest.mark.parametrize(
    ("more", "text"),
    [
        (["--chunk", "0", "--out-of-core"], "--chunk: got 0; wanted 1 voxel or more"),
        (["--chunk", "8"], "wanted 1 voxel or more, with --out-of-core"),
        (["--out-of-core", "--set", "surface.smooth=2", "--dry-run"], "surface.smooth: got 2"),
        (["--voxels", "1500", "--max-memory", "2G", "--dry-run"], "--out-of-core"),
        (["--cluster", "local:900"], "cluster: got 'local:900'; wanted at most"),
    ],
)
def test_options_that_cannot_be_are_refused_before_anything_is_made(tmp_path, capsys, more, text):
    out = tmp_path / "out"
    assert main(["make", "menger", "--only", "voxels", "-o", str(out), *more]) == 2
    assert text in capsys.readouterr().err
    assert not out.exists()


def test_who_interrupts_is_told_what_stays(tmp_path, capsys, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("porous.workspace.make_stored", interrupted)
    assert main(["make", "menger", "--out-of-core", "-o", str(tmp_path / "out")]) == 130
    said = capsys.readouterr().err
    assert f"interrupted; what is done stays: porous resume {tmp_path / 'out'}" in said


@pytest.mark.slow
@pytest.mark.parametrize("trials", [4, pytest.param(12, marks=pytest.mark.nightly)])
def test_killed_again_and_again(tmp_path, trials):
    """Killed at any time, resumed and killed again: in the end the bytes of an undisturbed run."""
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    begin = time.monotonic()
    subprocess.run(
        porous("make", *MAKE, "--out-of-core", "-o", whole), check=True, timeout=300,
        stdin=subprocess.DEVNULL, capture_output=True,
    )  # fmt: skip
    usual = time.monotonic() - begin
    wanted = lasting(whole)
    struck = 0
    for trial in range(trials):
        begun = (killed / workspace.UNFINISHED).exists()
        what = ("resume", killed) if begun else ("make", *MAKE, "--out-of-core", "-o", killed)
        child = subprocess.Popen(
            porous(*what), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        try:
            child.wait(usual * (0.3 + 0.6 / trials * trial))
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            struck += 1
        child.wait(60)
        if (killed / workspace.LAST).exists():
            assert lasting(killed) == wanted
            shutil.rmtree(killed)
    subprocess.run(
        porous(*(("resume", killed) if killed.exists() else
                 ("make", *MAKE, "--out-of-core", "-o", killed))),
        check=True, timeout=300, stdin=subprocess.DEVNULL, capture_output=True,
    )  # fmt: skip
    assert struck
    assert lasting(killed) == wanted
