"""The folder that make fills: every file whole, the last one last, the same bytes every time."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from porous import disk
from porous.errors import DiskError, ModelError, ViewError
from porous.formats import read
from porous.recipe import load
from porous.workspace import KNOWN, LAST, make

COARSE = {"model.level": 1, "voxels.voxels": 9, "volume.method": "voxel-hex"}
ALL = {
    "recipe.toml",
    "grid.vti",
    "surface.stl",
    "hexes.vtu",
    "hexes.inp",
    "report.html",
    "measures.csv",
    "log.json",
}


@pytest.fixture(autouse=True)
def no_picture(monkeypatch):
    """Draw no pictures: that takes seconds, and the report is tested elsewhere."""

    def refuse(*_, **__):
        raise ViewError("not now")

    monkeypatch.setattr("porous.report._report.picture", refuse)


def names(folder: Path) -> set[str]:
    """Return the names of all files in a folder, hidden ones too."""
    return {path.name for path in folder.iterdir()}


def test_everything_is_there_and_reads_back(tmp_path):
    result = make(load("menger", set=COARSE), tmp_path / "new" / "out")
    out = tmp_path / "new" / "out"
    assert names(out) == {*ALL, LAST}
    assert read(out / "grid.vti") == result.grid
    assert len(read(out / "surface.stl").triangles) == len(result.surface.triangles)
    assert read(out / "hexes.vtu").cells == result.volume.cells
    assert "*STEP" in (out / "hexes.inp").read_text().upper()
    assert (out / "report.html").read_text().lower().startswith("<!doctype html>")


def test_the_record_tells_where_it_comes_from(tmp_path):
    result = make(load("menger", set=COARSE), tmp_path)
    record = json.loads((tmp_path / LAST).read_text())
    text = (tmp_path / "recipe.toml").read_bytes()
    assert record["recipe_sha256"] == hashlib.sha256(text).hexdigest()
    assert record["recipe"]["model"]["level"] == 1
    assert len(record["measures"]) == len(result.measures)
    assert set(record["measures"][0]) == {
        "name", "value", "unit", "method", "uncertainty", "kind", "of",
    }  # fmt: skip
    assert record["certificate"]
    log = json.loads((tmp_path / "log.json").read_text())
    assert {"model", "voxels", "surface", "volume"} <= set(log["times"])
    assert {"python", "porous", "numpy"} <= set(log["versions"])


def test_the_same_recipe_gives_the_same_bytes(tmp_path, monkeypatch):
    recipe = load("menger", set=COARSE)
    make(recipe, tmp_path / "a")
    monkeypatch.setenv("POROUS_THREADS", "1")
    make(load(tmp_path / "a" / "recipe.toml"), tmp_path / "b")
    for name in ("recipe.toml", "grid.vti", "surface.stl", "hexes.vtu", "hexes.inp", LAST):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name


def test_the_folder_holds_what_its_recipe_reads(tmp_path, monkeypatch):
    made = make(
        load("menger-crosses", set={"model.level": 1, "voxels.voxels": 20}), tmp_path, only="voxels"
    )
    assert (tmp_path / "mesh.obj").is_file()
    assert 'mesh = "mesh.obj"' in (tmp_path / "recipe.toml").read_text()
    monkeypatch.chdir("/")
    moved = tmp_path.parent / "moved"
    tmp_path.rename(moved)
    again = make(load(moved / "recipe.toml"), moved, only="voxels")
    assert again.grid == made.grid
    assert 'mesh = "mesh.obj"' in (moved / "recipe.toml").read_text()


def test_files_of_another_recipe_go_and_those_of_the_same_stay(tmp_path):
    recipe = load("menger", set=COARSE)
    make(recipe, tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    make(recipe, tmp_path, only="voxels")
    assert names(tmp_path) == {*ALL, LAST, "notes.txt"}
    make(load("menger", set={**COARSE, "voxels.voxels": 6}), tmp_path, only="voxels")
    left = {"recipe.toml", "grid.vti", "log.json", "measures.csv", LAST, "notes.txt"}
    assert names(tmp_path) == left


def test_every_file_that_is_made_is_known(tmp_path):
    make(load("menger", set=COARSE), tmp_path)
    assert names(tmp_path) - {"recipe.toml", LAST} <= set(KNOWN)


@pytest.mark.parametrize("fresh", [True, False])
def test_wherever_the_disk_fails_the_folder_is_as_it_was(fresh, tmp_path, monkeypatch):
    out = tmp_path / "out"
    if not fresh:
        make(load("menger", set={**COARSE, "voxels.voxels": 6}), out, only="surface")
    before = {path: path.read_bytes() for path in out.iterdir()} if out.exists() else {}
    recipe = load("menger", set=COARSE)
    write = disk.write_bytes
    for failing in range(8):
        calls = iter(range(100))

        def fail(path, chunks, *, calls=calls, failing=failing):
            if next(calls) == failing:
                raise DiskError(f"{path}: cannot be written: no space left on device")
            write(path, chunks)

        monkeypatch.setattr(disk, "write_bytes", fail)
        with pytest.raises(DiskError, match=r"out/[a-z]+\.[a-z]+: cannot be written: no space"):
            make(recipe, out)
        assert out.exists() != fresh
        assert {path: path.read_bytes() for path in out.iterdir()} == before if not fresh else True
    assert names(tmp_path) == (set() if fresh else {"out"})


def test_the_last_file_is_last(tmp_path, monkeypatch):
    """Cut off between any two moves into place, a folder has its last file only if it is whole."""
    recipe = load("menger", set=COARSE)
    make(load("menger", set={**COARSE, "voxels.voxels": 6}), tmp_path)
    move = Path.replace
    moved = []

    def watch(source, target):
        if source.parent.name.startswith(".porous-") and Path(target).parent == tmp_path:
            assert not (tmp_path / LAST).exists()
            moved.append(Path(target).name)
        return move(source, target)

    monkeypatch.setattr(Path, "replace", watch)
    make(recipe, tmp_path)
    assert moved[-1] == LAST
    assert set(moved) == {*ALL, LAST}


def test_a_folder_that_cannot_be_is_refused_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr("porous.pipeline.run", lambda *_, **__: pytest.fail("work was done"))
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "out", Path("/proc/porous")):
        with pytest.raises(DiskError, match="cannot be written"):
            make(load("menger"), folder)


def test_where_the_work_fails_nothing_is_left(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise ModelError("no")

    monkeypatch.setattr("porous.pipeline.run", fail)
    with pytest.raises(ModelError):
        make(load("menger"), tmp_path / "a" / "b")
    assert names(tmp_path) == set()


def test_files_may_be_read_by_everybody(tmp_path):
    make(load("menger", set=COARSE), tmp_path / "out", only="voxels")
    for path in (tmp_path / "out").iterdir():
        assert path.stat().st_mode & 0o600 == 0o600
