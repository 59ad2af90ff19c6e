"""OpenFOAM cases: faces and zones of what is written, checkMesh's word, what is refused."""

import itertools
import re

import naive_boundary as naive
import numpy as np
import pytest
import systems
from foam_judge import check_mesh, openfoam

from porous import formats
from porous.errors import FormatError
from porous.formats._foam_mesh import poly_mesh
from porous.recipe import build, load
from porous.stages import hexahedralize, mesh_cells, name_parts, voxelize
from porous.values import (
    Block,
    Frame,
    Held,
    Job,
    Material,
    Part,
    Pressed,
    Step,
    VolumeMesh,
    VoxelGrid,
)

SPACING = (1.0, 2.0, 3.0)
GLASS = Material("glass", conductivity=0.8)
COPPER = Material("copper", conductivity=400.0)


def hexes(solid, spacing=SPACING, *, unit="mm", phase="solid"):
    frame = Frame((0.5, 0, 0), spacing, solid.shape, unit=unit)
    mesh = hexahedralize(VoxelGrid.of_solid(solid, frame), phase=phase)
    return name_parts(mesh, frame.box)


def menger(level, per=1):
    return np.kron(naive.prefractal(3, systems.MENGER, level), np.ones((per,) * 3, bool))


def stack():
    """Return a hexahedron, a wedge on a face of it, a tetrahedron on that, and a spare node."""
    points = np.array(
        [
            *([0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0], [0, 0, 4], [2, 0, 4], [2, 3, 4]),
            *([0, 3, 4], [0, 1.5, 6], [2, 1.5, 6], [3, 1.5, 5], [9, 9, 9]),
        ],
        dtype=float,
    )
    wedge = [4, 7, 8, 5, 6, 9]
    blocks = (
        Block("tet4", np.array([[5, 6, 9, 10]])),
        Block("wed6", np.array([wedge])),
        Block("hex8", np.array([[0, 1, 2, 3, 4, 5, 6, 7]])),
    )
    parts = {
        "a b;{}": Part("cells", np.array([0, 2])),
        "7up": Part("cells", np.array([1])),
        "middle": Part("faces", np.array([[2, 1]])),
        "spare": Part("nodes", np.array([11, 3])),
    }
    return VolumeMesh(points, blocks, parts=parts, unit="cm")


def volumes_of(poly):
    """Return each cell's volume, and how far its faces are from closing it, from faces alone."""
    volume, gap = np.zeros(poly.cells), np.zeros((poly.cells, 3))
    for index, nodes in enumerate(poly.faces):
        corners = poly.points[nodes[nodes >= 0]]
        middle, area, flux = corners.mean(axis=0), np.zeros(3), 0.0
        for a, b in itertools.pairwise([*corners, corners[0]]):
            half = np.cross(a - middle, b - middle) / 2
            area += half
            flux += half @ (a + b + middle) / 9
        sides = [(poly.owner[index], 1)]
        sides += [(poly.neighbour[index], -1)] if index < len(poly.neighbour) else []
        for cell, sign in sides:
            volume[cell] += sign * flux
            gap[cell] += sign * area
    return volume, np.abs(gap).max()


def bodies():
    rng = np.random.default_rng(3)
    yield hexes(rng.random((5, 4, 3)) < 0.6)
    yield hexes(rng.random((4, 3, 5)) < 0.4, phase="both")
    yield stack()


@pytest.mark.parametrize("mesh", [*bodies()], ids=["voxels", "both", "shapes"])
def test_faces_are_as_openfoam_wants_them(mesh):
    poly = poly_mesh(mesh)
    scale = {"mm": 1e-3, "cm": 1e-2}[mesh.unit]
    volume, gap = volumes_of(poly)
    assert volume == pytest.approx(mesh.volumes * scale**3, rel=1e-12)
    assert gap < 1e-15
    inner = len(poly.neighbour)
    pairs = list(zip(poly.owner[:inner].tolist(), poly.neighbour.tolist(), strict=True))
    assert pairs == sorted(pairs)
    assert all(a < b for a, b in pairs)
    ranges = list(poly.patches.values())
    assert [r.start for r in ranges] == [inner, *(r.stop for r in ranges[:-1])]
    assert ranges[-1].stop == len(poly.faces)
    assert set(np.unique(poly.faces)) - {-1} == set(range(len(poly.points)))


def test_the_shared_faces_of_a_stack():
    poly = poly_mesh(stack())
    assert len(poly.neighbour) == 2
    assert set(poly.patches) == {"WALL"}
    assert {name: len(cells) for name, cells in poly.cell_zones.items()} == {
        "a_b___": 2,
        "N_7up": 1,
    }
    (face,), (flipped,) = poly.face_zones["middle"]
    assert (poly.owner[face], poly.neighbour[face], flipped) == (1, 2, True)
    assert len(poly.points) == 11
    assert [len(nodes) for nodes in poly.point_zones.values()] == [1]


def shapes_of(mesh):
    return {block.shape: len(block.cells) for block in mesh.blocks}


def names_of(mesh, kind, *left_out):
    return {
        name: len(part.members)
        for name, part in mesh.parts.items()
        if part.kind == kind and not name.endswith(left_out)
    }


def agrees(found, mesh):
    """Hold what checkMesh found against a mesh in mm."""
    assert found["nodes"] == len(mesh.points)
    assert found["elements"] == shapes_of(mesh)
    assert found["volume"] == pytest.approx(mesh.volumes.sum() * 1e-9, rel=1e-9)
    patches = {
        name.removesuffix("_FACES"): count
        for name, count in names_of(mesh, "faces", "SKIN", "INTERFACE").items()
    }
    assert found["patches"] == patches
    zones = names_of(mesh, "faces", "_FACES", "WALL")
    assert found["face_sets"] == zones
    assert found["cell_sets"] == names_of(mesh, "cells", "#")
    assert found["node_sets"] == names_of(mesh, "nodes", "#")


PRESETS = [("menger", "solid", 18), ("mosely-heavy", "pore", 18), ("vicsek-7", "both", 18)]


@pytest.mark.parametrize(("preset", "phase", "voxels"), PRESETS)
def test_check_mesh_says_ok(preset, phase, voxels, judge, tmp_path):
    # Two voxels for each cell of level 2 at least, on a grid with unequal edges.
    grid = voxelize(build(load(preset)), voxels=voxels)
    frame = Frame((0.5, 0, 0), SPACING, grid.frame.shape)
    mesh = name_parts(hexahedralize(VoxelGrid.of_solid(grid.solid, frame), phase=phase), frame.box)
    formats.write(mesh, tmp_path / "a.foam")
    found = check_mesh(judge("checkMesh"), tmp_path / "a.foam")
    assert found["ok"], found["said"]
    assert found["non_orthogonality"] == 0
    agrees(found, mesh)


@pytest.mark.parametrize("preset", ["menger-bent", "tetra-octa", "junction-sponge"])
def test_cells_of_models_are_sound(preset, judge, tmp_path):
    # Bent hexahedra, tetrahedra, hexahedra with wedges. Walls one cell thick cannot tell a slope
    # across them, which -allGeometry calls a small determinant; nothing else is wrong.
    model = build(load(preset))
    mesh = name_parts(mesh_cells(model), model.domain)
    formats.write(mesh, tmp_path / "a.foam")
    plain = check_mesh(judge("checkMesh"), tmp_path / "a.foam", thorough=False)
    assert plain["ok"], plain["said"]
    said = check_mesh(judge("checkMesh"), tmp_path / "a.foam")["said"]
    faults = re.findall(r"^ \*\*\*(.*)", said, re.MULTILINE)
    assert len(faults) == 1
    assert faults[0].startswith("Cells with small determinant")


def test_check_mesh_counts_every_shape(judge, tmp_path):
    formats.write(stack(), tmp_path / "a.foam")
    found = check_mesh(judge("checkMesh"), tmp_path / "a.foam")
    assert found["elements"] == {"hex8": 1, "wed6": 1, "tet4": 1}
    assert found["volume"] == pytest.approx(stack().volumes.sum() * 1e-6, rel=1e-9)
    assert found["cell_sets"] == {"a_b___": 2, "N_7up": 1}
    assert "Upper triangular ordering OK" in found["said"]


def test_what_checks_can_fail(judge, tmp_path):
    # A case that was spoilt is found out, so that OK above means something.
    formats.write(hexes(np.ones((3, 4, 5), bool)), tmp_path / "a.foam")
    owner = tmp_path / "a.foam" / "constant" / "polyMesh" / "owner"
    text = owner.read_text()
    first, second = re.search(r"\(\n0\n(\d+)\n", text).span()
    owner.write_text(text[:first] + "(\n1\n0\n" + text[second:])
    with pytest.raises(AssertionError):
        assert check_mesh(judge("checkMesh"), tmp_path / "a.foam")["ok"]


# --- jobs ----------------------------------------------------------------------------------------


def conduction(mesh, materials, low=1.0, high=0.0, **more):
    held = (Held("XMIN", "temperature", low), Held("XMAX", "temperature", high))
    return Job("heat", mesh, materials, (Step("heat", "conduction", held),), **more)


def rate(folder, name):
    """Return the last value that a function object wrote."""
    (path,) = (folder / "postProcessing" / name).glob("*/surfaceFieldValue.dat")
    return float(path.read_text().split()[-1])


@pytest.mark.parametrize("unit", ["nm", "um", "m"])
def test_heat_through_layers_is_exact(unit, judge, tmp_path):
    # Three voxels of glass, two of copper behind them, between 21 °C and 1 °C.
    mesh = hexes(np.ones((5, 3, 4), bool), unit=unit)
    layer = mesh.points[mesh.blocks[0].cells].mean(axis=1)[:, 0] < 3.5
    parts = {
        **mesh.parts,
        "GLASS": Part("cells", np.flatnonzero(layer)),
        "COPPER": Part("cells", np.flatnonzero(~layer)),
    }
    mesh = VolumeMesh(mesh.points, mesh.blocks, parts=parts, unit=unit)
    job = conduction(mesh, {"GLASS": GLASS, "COPPER": COPPER}, 294.15, 274.15)
    formats.write(job, tmp_path / "a.foam")
    openfoam(judge("laplacianFoam"), tmp_path / "a.foam")
    scale = {"nm": 1e-9, "um": 1e-6, "m": 1.0}[unit]
    exact = 20 / (3 / 0.8 + 2 / 400) * 6 * 12 * scale
    assert rate(tmp_path / "a.foam", "out-XMAX-COPPER") == pytest.approx(exact, rel=1e-9)
    assert rate(tmp_path / "a.foam", "out-XMIN-GLASS") == pytest.approx(-exact, rel=1e-9)


def test_a_case_says_what_it_is_and_no_text_becomes_a_command(tmp_path):
    mesh = hexes(np.ones((2, 1, 1), bool))
    job = Job("a\nrm -rf ~ `x` ³ → é", mesh, why_no_step="no \\\n body", note="$(reboot)")
    formats.write(job, tmp_path / "odd name;.foam")
    script = (tmp_path / "odd name;.foam" / "Allrun").read_bytes().decode("ascii").splitlines()
    commands = [line for line in script if not line.startswith("#")]
    assert commands == [
        'cd "$(dirname "$0")" || exit 1',
        ': "${WM_PROJECT_DIR:=/usr/share/openfoam}"; export WM_PROJECT_DIR',
        "checkMesh -allGeometry -allTopology",
    ]
    assert "# a rm -rf ~ `x` 3 ? ?" in script
    assert "# no step: no \\ body" in script
    assert (tmp_path / "odd name;.foam" / "odd name;.foam").read_bytes() == b""


def test_the_same_job_gives_the_same_bytes():
    job = conduction(hexes(menger(1)), {"SOLID": GLASS})
    form = next(form for form in formats.formats() if form.suffix == ".foam")
    first, second = (
        [(name, b"".join(chunks)) for name, chunks in form.write_files(job, "a.foam")]
        for _ in range(2)
    )
    assert first == second
    assert len({name for name, _ in first}) == len(first)


def test_what_is_there_is_not_written_over(tmp_path):
    mesh = hexes(np.ones((2, 1, 1), bool))
    formats.write(mesh, tmp_path / "a.foam")
    with pytest.raises(FormatError, match="is there already"):
        formats.write(mesh, tmp_path / "a.foam")


def solid(**more):
    return Job("", hexes(np.ones((2, 1, 1), bool)), {"SOLID": GLASS}, **more)


def step(*held, **more):
    return Step("a", "conduction", held, **more)


HOT, COLD = Held("XMIN", "temperature", 1.0), Held("XMAX", "temperature")


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (VolumeMesh(np.zeros((0, 3)), ()), "no cells"),
        (solid(steps=(step(HOT), step(COLD))), "one step; got 2"),
        (solid(steps=(step(),)), "nothing is held"),
        (solid(steps=(step(HOT, HOT),)), "XMIN is held twice"),
        (solid(steps=(step(Held("XMIN", "pressure", 1.0)),)), "got pressure held on XMIN"),
        (solid(steps=(step(HOT, pressed=(Pressed("SKIN", 1.0),)),)), "got pressed faces"),
    ],
)
def test_what_a_case_cannot_hold(value, words, tmp_path):
    with pytest.raises(FormatError, match=words):
        formats.write(value, tmp_path / "a.foam")
    assert not list(tmp_path.iterdir())
