"""Solid and pores in one mesh: volumes, the interface they share, the box that they fill."""

from dataclasses import replace

import numpy as np
import pytest
import systems

from porous import measures
from porous.errors import GuestError, MeshError
from porous.guests import tetwild
from porous.models.boundary import exact_boundary
from porous.models.primitive import named
from porous.stages import phase_alone, tetrahedralize_phases
from porous.stages._inside import inside
from porous.values import Box, SurfaceMesh, VolumeMesh
from porous.values.surface_topology import euler_number, winding_numbers
from porous.values.volume_topology import bodies, boundary_faces, faces, matched, nodes_of

CUBE = named("cube").surface("um")
STRETCH = np.array([1.0, 1.1, 1.2])
BOX = Box((0, 0, 0), (1, 1.1, 1.2))
TOLERANCE = 1e-3


def menger(level):
    surface = exact_boundary(systems.digits(3, systems.MENGER), named("cube"), level)
    return SurfaceMesh(surface.points * STRETCH, surface.triangles, "um")


@pytest.fixture(scope="module")
def surface():
    return menger(1)


@pytest.fixture(scope="module")
def both(surface):
    return tetrahedralize_phases(surface, BOX, edge_length=0.15)


def interface(mesh):
    """Return the corners (n, 3, 3) of the faces between the phases."""
    every = faces(mesh)
    first, second = matched(every)
    phase = mesh.cell_tags["phase"][every.members[:, 0]]
    return mesh.points[every.nodes[first[phase[first] != phase[second]]][:, :3]]


def areas(corners):
    a, b, c = np.moveaxis(corners, 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def test_volumes_are_those_of_box_and_surface(both, surface):
    solid = both.cell_tags["phase"] == 1
    assert both.unit == "um"
    assert (both.volumes > 0).all()
    assert both.volumes.sum() == pytest.approx(BOX.volume, rel=1e-12)
    assert both.volumes[solid].sum() == pytest.approx(surface.volume, rel=TOLERANCE)
    assert both.volumes[~solid].sum() == pytest.approx(BOX.volume * 7 / 27, rel=TOLERANCE)


def test_the_interface_is_one_and_as_large_as_the_pores_walls(both):
    # Six tunnels of a third each: four walls around each, of a ninth of the box's sides.
    x, y, z = STRETCH / 3
    walls = 4 * (2 * x * y + 2 * y * z + 2 * z * x)
    assert areas(interface(both)).sum() == pytest.approx(walls, rel=0.005)
    solid, pore = phase_alone(both, "solid"), phase_alone(both, "pore")
    assert len(boundary_faces(solid)) + len(boundary_faces(pore)) == 2 * len(interface(both)) + len(
        boundary_faces(both)
    )


def test_it_ends_on_the_box_and_nowhere_else(both):
    outer = both.points[nodes_of(both, boundary_faces(both))[:, :3]]
    ends = np.array([BOX.lower, BOX.upper])
    on_side = (outer[:, :, None, :] == ends).all(axis=1)
    assert on_side.any(axis=(1, 2)).all()
    for axis in range(3):
        for end in range(2):
            side = areas(outer[on_side[:, end, axis]]).sum()
            assert side == pytest.approx(BOX.volume / BOX.lengths[axis], rel=1e-12)


def test_each_phase_alone(both, surface):
    solid, pore = phase_alone(both, "solid"), phase_alone(both, "pore")
    assert solid.cells + pore.cells == both.cells
    assert bodies(solid).max() == bodies(pore).max() == bodies(both).max() == 0
    bare = {"solid": replace(solid, cell_tags={}), "pore": replace(pore, cell_tags={})}
    told = {name: measures.measure(mesh) for name, mesh in bare.items()}
    assert told["solid"]["euler_number"].value == euler_number(surface) / 2 == -4
    assert told["pore"]["euler_number"].value == 1
    assert told["solid"]["smallest_dihedral_angle"].value > 8
    assert told["pore"]["smallest_dihedral_angle"].value > 8
    assert set(solid.cell_tags["phase"]) == {1}
    assert set(pore.cell_tags["phase"]) == {0}


def test_a_solid_off_the_sides_is_surrounded_by_pores():
    box = Box((-0.4, -0.2, 0), (1.3, 1.5, 1.4))
    mesh = tetrahedralize_phases(CUBE, box, edge_length=0.4)
    assert mesh.volumes.sum() == pytest.approx(box.volume, rel=1e-12)
    assert mesh.volumes[mesh.cell_tags["phase"] == 1].sum() == pytest.approx(1, rel=TOLERANCE)
    assert areas(interface(mesh)).sum() == pytest.approx(5, rel=TOLERANCE)  # one side on the box


@pytest.mark.parametrize("body", ["octahedron", "tetrahedron", "menger"])
def test_points_are_inside_as_often_as_a_surface_winds_round_them(body):
    generator = np.random.default_rng(4)
    solid = menger(2) if body == "menger" else named(body).surface()
    low, high = np.array(solid.box.lower), np.array(solid.box.upper)
    points = low + (1.4 * generator.random((1000, 3)) - 0.2) * (high - low)
    if body != "menger":  # no upright edges: below them a ray meets two triangles or more
        ends = solid.corners[:, [0, 0, 1]] + solid.corners[:, [0, 1, 2]]
        points = np.concatenate([points, ends.reshape(-1, 3) / 2 - [0, 0, 1e-3]])
    turns = winding_numbers(solid.corners, points)
    assert np.abs(turns - np.round(turns)).max() < 1e-6
    assert (inside(solid, points) == (turns > 0.5)).all()
    assert 0.05 < (turns > 0.5).mean() < 0.95


def test_points_far_off_and_none_at_all():
    assert not inside(CUBE, np.array([[5.0, 6, 7], [0.5, 0.6, 2], [0.5, 0.6, -2]])).any()
    assert inside(CUBE, np.zeros((0, 3))).shape == (0,)


# --- refusals ------------------------------------------------------------------------------


@pytest.fixture
def no_guest(monkeypatch):
    def run(*_args, **_options):
        pytest.fail("the mesher was started")

    monkeypatch.setattr(tetwild, "run", run)


@pytest.mark.usefixtures("no_guest")
def test_what_cannot_be_is_refused_before_the_mesher_starts(surface):
    with pytest.raises(MeshError, match="wanted it inside the box"):
        tetrahedralize_phases(surface, Box((0, 0, 0), (1, 1, 1)))
    with pytest.raises(MeshError, match="no volume"):
        tetrahedralize_phases(surface, Box((0, 0, 0), (1, 0, 1)))
    with pytest.raises(MeshError, match="hole"):
        tetrahedralize_phases(SurfaceMesh(surface.points, surface.triangles[1:]))
    with pytest.raises(MeshError, match="inside out"):
        tetrahedralize_phases(SurfaceMesh(surface.points, surface.triangles[:, ::-1]))
    with pytest.raises(MeshError, match="epsilon"):
        tetrahedralize_phases(surface, epsilon=-1)


def answer(monkeypatch, points, tets):
    """Have the mesher give this mesh, whatever it is asked."""

    def run(_command, *, folder, **_):
        np.savez(folder / "out.npz", points=points, tets=tets)

    monkeypatch.setattr(tetwild, "run", run)


def test_meshes_that_are_wrong_are_told(monkeypatch, both):
    tets = both.blocks[0].cells
    answer(monkeypatch, both.points, tets)
    small = SurfaceMesh(CUBE.points * STRETCH * 0.7, CUBE.triangles)
    with pytest.raises(GuestError, match="off in the volume of the solid"):
        tetrahedralize_phases(small, BOX)
    answer(monkeypatch, both.points, tets[both.cell_tags["phase"] == 1])
    with pytest.raises(GuestError, match="does not end on the box"):
        tetrahedralize_phases(menger(1), BOX)
    answer(monkeypatch, both.points * 0.99, tets)
    with pytest.raises(GuestError, match="does not end on the box"):
        tetrahedralize_phases(menger(1), BOX)


def test_phases_that_there_are_not(both):
    with pytest.raises(MeshError, match="wanted one of pore, solid"):
        phase_alone(both, "void")
    with pytest.raises(MeshError, match="no tag"):
        phase_alone(VolumeMesh(both.points, both.blocks), "solid")
    solid = phase_alone(both, "solid")
    with pytest.raises(MeshError, match="no cells of the pore"):
        phase_alone(solid, "pore")
