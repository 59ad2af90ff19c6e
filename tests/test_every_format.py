"""Every format of the registry, read back by who did not write it.

A format that writes meshes is tried on every shape of element that it takes, on several in one
mesh, and on voxels of both phases with their parts and pairs; with and without a job. Its judge
must find the same nodes, elements, sets and volume. Those that write voxels must show the same
voxels in the same place; those of surfaces and beams the same triangles and beams. A format without
a judge in the tables of ``format_judges`` fails.
"""

from functools import cache

import neutral_meshes as meshes
import numpy as np
import pytest
import trimesh
from format_judges import (
    TABLES,
    near,
    of_beams,
    of_fields,
    of_maps,
    of_mesh,
    of_triangles,
    of_voxels,
    scaled,
)
from image_cases import grey_grid

from porous import formats, values
from porous.stages import hexahedralize, name_parts, periodic_pairs
from porous.values import (
    SHAPES,
    BeamLattice,
    Frame,
    Held,
    Job,
    Material,
    Part,
    Step,
    SurfaceMesh,
    VolumeMesh,
    VoxelGrid,
)

UNIT = "cm"

# --- meshes ------------------------------------------------------------------------------------


@cache
def body(kind):
    """Return what is written: ``both`` are voxels of two phases, as a recipe makes them."""
    if kind != "both":
        return meshes.body(kind, UNIT)
    solid = np.random.default_rng(3).random((5, 4, 3)) < 0.6
    frame = Frame((0.5, 0, -1), (1.0, 2.0, 3.0), solid.shape, unit=UNIT)
    mesh = hexahedralize(VoxelGrid.of_solid(solid, frame), phase="both")
    mesh = periodic_pairs(name_parts(mesh, frame.box))
    parts = {**mesh.parts, "WORD_01": Part("cells", np.arange(0, mesh.cells, 3))}
    return VolumeMesh(mesh.points, mesh.blocks, mesh.cell_tags, parts, mesh.unit)


def kinds_of(form):
    """Return the names of the bodies that a format is to take."""
    shapes = form.shapes or tuple(SHAPES)
    return [kind for kind in [*meshes.KINDS, "both"] if kind not in SHAPES or kind in shapes]


TWO = {
    "SOLID": Material("steel", 210000.0, 0.3, 7.85e-9, conductivity=50.0, diffusivity=1e-3),
    "PORE": Material("soft", 1000.0, 0.4, 1.25e-9, conductivity=0.2, diffusivity=2.0),
}
MOVED = (
    Held("XMIN", "displacement", 0.0, (0, 1, 2)),
    Held("XMAX", "displacement", 0.01, (0,)),
)
WARM = (Held("XMIN", "temperature", 300.0), Held("XMAX", "temperature", 280.0))
STEPS = {
    "static": Step("pull", "static", MOVED),
    "conduction": Step("warm", "conduction", WARM),
    "diffusion": Step(
        "spread",
        "diffusion",
        (Held("XMIN", "concentration", 1.0), Held("XMAX", "concentration", 0.0)),
    ),
    "modal": Step("ring", "modal", MOVED[:1], modes=3),
}


def job_of(form, kind):
    """Return a body of two materials, with a step; the format's procedures take turns."""
    names = [name for name in form.procedures if name in STEPS]
    if form.suffix == ".inp":  # its judge asks the solver for sets and areas, in statics
        names = ["static"]
    turn = [*meshes.KINDS, "both"].index(kind)
    steps = (STEPS[names[turn % len(names)]],) if names else ()
    return Job("every format", body(kind), TWO, steps)


# --- voxels ------------------------------------------------------------------------------------


GRID = grey_grid(unit="um", start=(0, 0, 0))
MAPS = values.VoxelMaps(GRID.frame, {"pore": GRID.fill / 7, "wall": GRID.fill * 0.1})


# --- surfaces and beams ------------------------------------------------------------------------


def ball():
    """Return an ellipsoid away from the origin."""
    mesh = trimesh.creation.icosphere(subdivisions=2)
    return SurfaceMesh(mesh.vertices * (1.0, 2.0, 3.0) + (4, -5, 6), mesh.faces, "mm")


def lattice():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], dtype=float)
    return BeamLattice(points, [[0, 1], [3, 2]], [[0.1, 0.2], [0.3, 0.1]])


# --- the registry ------------------------------------------------------------------------------


def fields_of(kind):
    """Return a body with a vector at its nodes, and a number and a tensor in its cells."""
    mesh = body(kind)
    tensor = np.arange(6.0 * mesh.cells).reshape(-1, 6)
    return values.MeshFields(
        mesh,
        (
            values.Field("displacement", mesh.points * (1, -2, 3), "mm"),
            values.Field("stress", tensor, "MPa", "cells"),
            values.Field("energy", tensor[:, 0], "1", "cells"),
        ),
    )


def given(form, kind):
    """Return what a format is to write of a type, by the stems of files, with what all told is."""
    several = {
        "VolumeMesh": lambda name: (body(name), of_mesh(body(name))),
        "Job": lambda name: (job_of(form, name), of_mesh(body(name))),
        "MeshFields": lambda name: (fields_of(name), of_fields(fields_of(name))),
    }
    single = {
        "VoxelGrid": lambda: (GRID, of_voxels(GRID)),
        "SurfaceMesh": lambda: (ball(), of_triangles(ball())),
        "BeamLattice": lambda: (lattice(), of_beams(lattice())),
        "VoxelMaps": lambda: (MAPS, of_maps(MAPS)),
    }
    if kind in single:
        return {"one": single[kind]()}
    return {name: several[kind](name) for name in kinds_of(form)}


def cases():
    for form in formats.formats():
        for kind in form.writes:
            judge = TABLES.get(kind.__name__, {}).get(form.suffix)
            marks = [pytest.mark.judge] if judge and judge.alone else []
            marks += [pytest.mark.slow] if judge and judge.slow else []
            name = kind.__name__
            yield pytest.param(form, name, marks=marks, id=f"{form.suffix}-{name}")


@pytest.mark.parametrize(("form", "kind"), list(cases()))
def test_a_judge_finds_what_was_written(form, kind, tmp_path, ask, judge):
    eye = TABLES.get(kind, {}).get(form.suffix)
    assert eye, f"{form.suffix} files of a {kind} have no judge: tell who reads them"
    suffixes = form.suffixes if kind == "VoxelGrid" else form.suffixes[:1]
    paths, written, wanted = [], [], []
    for name, (value, whole) in given(form, kind).items():
        kept = eye.keeps(getattr(value, "mesh", value), whole) if eye.keeps else whole
        for suffix in suffixes:
            paths.append(tmp_path / f"{name}{suffix}")
            formats.write(value, paths[-1])
            written.append(value)
            wanted.append(scaled(kept, eye.scale))
    found = eye.look(paths, written, ask, judge)
    for path, told, whole in zip(paths, found, wanted, strict=True):
        for key, value in whole.items():
            assert told.get(key, {}) == near(value), (path.name, key)


def test_no_judge_without_its_format():
    there = {form.suffix for form in formats.formats() if form.writes}
    assert {suffix for table in TABLES.values() for suffix in table} == there
