"""Jobs: which body bears the load, what is left out, why there is no step."""

import itertools

import naive_boundary as naive
import numpy as np
import pytest
import systems

from porous.errors import MeshError
from porous.jobs import compression
from porous.stages import hexahedralize, name_parts
from porous.values import Block, Box, Frame, Material, Pressed, VolumeMesh, VoxelGrid

STEEL = Material("steel", 210e3, 0.3, 7.85e-9)


def hexes(solid, spacing=(1.0, 2.0, 3.0)):
    frame = Frame((0, 0, 0), spacing, solid.shape)
    return name_parts(hexahedralize(VoxelGrid.of_solid(solid, frame)), frame.box)


def press(solid, pressure=2.0):
    return compression(hexes(solid), material=STEEL, pressure=pressure)


def columns(*ranges):
    """Return voxels of a 5×4×3 frame that are solid where listed: ((x, y), z from, z to)."""
    solid = np.zeros((5, 4, 3), dtype=bool)
    for (x, y), low, high in ranges:
        solid[x, y, low:high] = True
    return solid


def test_the_body_between_is_pressed():
    job = press(columns(((0, 0), 0, 3)))
    assert (job.steps[0].held[0].part, job.steps[0].pressed) == (
        "ZMIN",
        (Pressed("ZMAX_FACES", 2.0),),
    )
    assert (job.mesh.cells, job.note, job.why_no_step) == (3, "", "")
    assert len(job.mesh.parts["ZMIN"].members) == 4


def test_what_bears_no_load_is_left_out_and_said():
    # A column; a stub beside it, joined by an edge; another on the floor; one in the air.
    job = press(columns(((0, 0), 0, 3), ((1, 1), 1, 3), ((4, 0), 0, 1), ((4, 3), 1, 2)))
    assert job.mesh.cells == 3
    assert len(job.mesh.points) == 16
    assert "3 bodies of 4 cells left out" in job.note
    assert len(job.mesh.parts["ZMAX_FACES"].members) == 1
    assert job.mesh.parts["SOLID"].members.tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("solid", "words"),
    [
        (columns(((0, 0), 0, 2)), "no face lies on ZMAX"),
        (columns(((0, 0), 1, 2)), "no face lies on ZMIN or ZMAX"),
        (columns(((0, 0), 0, 2), ((1, 0), 2, 3)), "no face-connected body.*2 bodies"),
        (columns(((0, 0), 0, 1), ((1, 0), 1, 3)), "point or an edge bears no load"),
        (columns(((0, 0), 0, 3), ((2, 2), 0, 3)), "2 of them reach.*side by side"),
    ],
)
def test_no_step_and_why(solid, words):
    job = press(solid)
    assert not job.steps
    assert job.mesh == hexes(solid)
    import re

    assert re.search(words, job.why_no_step)


@pytest.mark.parametrize(("divisions", "keep"), [(3, systems.VICSEK_9), (2, systems.PARITY)])
def test_cells_that_only_touch_bear_nothing(divisions, keep):
    job = press(naive.prefractal(divisions, keep, 2))
    assert not job.steps
    assert f"{len(keep) ** 2} bodies that no face joins" in job.why_no_step
    assert "fuse" in job.why_no_step


def test_cantor_squares_stay_in_pieces():
    keep = [(x, y, z) for x, y in itertools.product((0, 2), repeat=2) for z in range(3)]
    job = press(naive.prefractal(3, keep, 2))
    assert not job.steps
    assert "16 of them reach from ZMIN to ZMAX" in job.why_no_step


def test_bad_jobs_are_refused():
    empty = VolumeMesh(np.zeros((0, 3)), ())
    with pytest.raises(MeshError, match="no cells"):
        compression(empty, material=STEEL, pressure=1.0)
    with pytest.raises(MeshError, match="pressure"):
        press(columns(((0, 0), 0, 3)), pressure=float("nan"))


def test_a_mesh_without_names_has_no_step():
    mesh = VolumeMesh(np.eye(4, 3), (Block("tet4", np.array([[3, 0, 1, 2]])),))
    assert "ZMIN" in compression(mesh, material=STEEL, pressure=1.0).why_no_step
    named = name_parts(mesh, Box((0, 0, 0), (1, 1, 1)))
    assert "no face lies on ZMAX" in compression(named, material=STEEL, pressure=1.0).why_no_step
