"""Surfaces of files that enclose no solid: one clear line, exit code 2, and nothing left behind."""

import os
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
import trimesh
from refusals import refuse

from porous import formats
from porous.cli import main
from porous.errors import MeshError
from porous.kernels.crossings import check_uncrossed
from porous.values import SurfaceMesh

BOX, BALL = trimesh.creation.box(), trimesh.creation.icosphere(subdivisions=2)
CUBE = "[model]\nkind = 'ifs'\nlevel = 1\ndigits = { divisions = 2, keep = [[0, 0, 0]] }\n"


def both(one, other):
    """Return two bodies as one surface."""
    points = np.vstack([one.vertices, other.vertices])
    return SurfaceMesh(points, np.vstack([one.faces, other.faces + len(one.vertices)]))


def moved(body, *by, scale=1.0, inside_out=False):
    result = body.copy()
    result.apply_scale(scale)
    result.apply_translation(by)
    if inside_out:
        result.invert()
    return result


CROSSED = {
    "overlapping": both(BOX, moved(BOX, 0.5, 0.4, 0.3)),
    "in line": both(BOX, moved(BOX, 0.9, 0, 0)),
    "by little": both(BALL, moved(BALL, 1.9, 0, 0)),
    "twice the same": both(BOX, BOX),
    "one in another": both(BOX, moved(BOX, 0.1, 0, 0, scale=0.5)),
    "a cavity that leads out": both(BOX, moved(BALL, 0.3, 0, 0, scale=0.3, inside_out=True)),
}
WHOLE = {
    "one": both(BOX, moved(BOX, 3, 0, 0)),
    "side by side": both(BOX, moved(BOX, 1, 0.3, 0.2)),
    "an edge in common": both(BOX, moved(BOX, 1, 1, 0)),
    "a corner in common": both(BALL, moved(BALL, 2, 0, 0)),
    "a cavity": both(BOX, moved(BOX, 0, 0, 0, scale=0.5, inside_out=True)),
}


@pytest.mark.parametrize("name", CROSSED)
def test_surfaces_that_cross_themselves(name):
    with pytest.raises(MeshError, match=r"surface: crosses itself: it winds (2|-1) times round \("):
        check_uncrossed(CROSSED[name])


@pytest.mark.parametrize("name", WHOLE)
def test_surfaces_that_touch_themselves_pass(name):
    check_uncrossed(WHOLE[name])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    formats.write(CROSSED["overlapping"], tmp_path / "crossed.stl")
    formats.write(SurfaceMesh(BOX.vertices, BOX.faces[:-1]), tmp_path / "open.stl")
    formats.write(WHOLE["a cavity"], tmp_path / "hollow.stl")
    for name in ("crossed", "open"):
        (tmp_path / f"{name}.toml").write_text(f'{CUBE}primitive = {{ mesh = "{name}.stl" }}\n')
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(("name", "words"), [("crossed", "crosses itself"), ("open", "has a hole")])
def test_no_tetrahedra_and_no_measures_of_them(folder, capsys, name, words):
    make = ["make", f"{name}.toml", "-o", "a/out", "--set", "volume.method=tetwild"]
    refuse(folder, capsys, make, 2, words)
    refuse(folder, capsys, ["measure", f"{name}.stl"], 2, words)
    refuse(folder, capsys, ["measure", f"{name}.stl", "-o", "report"], 2, words)
    refuse(folder, capsys, ["convert", f"{name}.stl", "out.vtu"], 2, "cannot hold a SurfaceMesh")


def test_a_cavity_is_measured(folder, capsys):
    assert main(["measure", "hollow.stl"]) == 0
    assert "0.875" in capsys.readouterr().out
    assert sorted(path.name for path in folder.iterdir() if path.suffix != ".toml") == [
        "crossed.stl", "hollow.stl", "open.stl",
    ]  # fmt: skip


# --- where files cannot be written -------------------------------------------------------------

FOLDERS = [".foam", ".pngs", ".ome.zarr"]


@pytest.fixture
def given(tmp_path, monkeypatch):
    """A folder with a grid and a mesh in it, and the format's own name taken by a folder."""
    solid = np.zeros((3, 4, 5), bool)
    solid[1:] = True
    from porous.stages import hexahedralize, name_parts
    from porous.values import Frame, VoxelGrid

    frame = Frame((0, 0, 0), (1, 2, 3), solid.shape)
    grid = VoxelGrid.of_solid(solid, frame)
    formats.write(grid, tmp_path / "grid.npz")
    formats.write(name_parts(hexahedralize(grid), frame.box), tmp_path / "mesh.vtu")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("suffix", FOLDERS)
def test_a_folder_that_is_there_is_kept(given, capsys, suffix):
    source = "mesh.vtu" if suffix == ".foam" else "grid.npz"
    taken = given / f"it{suffix}"
    taken.mkdir()
    (taken / "mine").write_text("precious")
    refuse(given, capsys, ["convert", source, taken.name], 2, "is there already; wanted another na")
    (taken / "mine").unlink()
    taken.rmdir()
    taken.write_text("a file")
    refuse(given, capsys, ["convert", source, taken.name], 2, "is there already")


@pytest.mark.parametrize("suffix", FOLDERS)
@pytest.mark.parametrize("there", ["full", "empty", "missing"])
def test_no_folder_is_written_through_a_link(given, capsys, suffix, there):
    source = "mesh.vtu" if suffix == ".foam" else "grid.npz"
    if there != "missing":
        (given / there).mkdir()
    if there == "full":
        (given / there / "mine").write_text("precious")
    taken = given / f"it{suffix}"
    taken.symlink_to(there)
    refuse(given, capsys, ["convert", source, taken.name], 2, f"is a link to {there}")


@pytest.mark.parametrize("suffix", [".vti", ".mhd", ".pngs", ".nhdr"])
def test_a_folder_that_is_not_there(given, capsys, suffix):
    Path("taken").write_text("a file")
    refuse(given, capsys, ["convert", "grid.npz", f"taken/it{suffix}"], 1, "taken")
    refuse(given, capsys, ["convert", "grid.npz", f"/proc/it{suffix}"], 1, "/proc")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
@pytest.mark.parametrize("suffix", [".vti", ".mhd", ".pngs"])
def test_a_folder_that_may_not_be_written(given, capsys, suffix):
    locked = given / "locked"
    locked.mkdir()
    locked.chmod(0o500)
    refuse(given, capsys, ["convert", "grid.npz", f"locked/it{suffix}"], 1, "permission denied")


STEMS = ["a b", "ä–é", "-x", "$(id)", "a;b|c&d", "'\"", "a\nb", "%s{name}", "LIST a", "."]


@pytest.mark.parametrize(
    "suffix", [".vti", ".mhd", ".nhdr", ".pngs", ".ome.zarr", ".xdmf", ".foam"]
)
def test_names_with_strange_characters(given, capsys, suffix):
    source = "mesh.vtu" if suffix in (".foam", ".xdmf") else "grid.npz"
    for stem in STEMS:
        before = set(given.iterdir())
        code = main(["convert", source, f"./{stem}{suffix}"])
        said = capsys.readouterr().err
        assert code in (0, 2), said
        made = {path for path in given.iterdir() if path not in before}
        assert bool(made) == (code == 0)
        assert all(unquote(path.name).startswith(stem.strip(".")) for path in made), made
        if code:
            assert len(said.splitlines()) == 1
            assert "fault of porous" not in said
        elif suffix in (".vti", ".mhd", ".nhdr"):
            assert formats.read(given / f"{stem}{suffix}").frame.shape == (3, 4, 5)
