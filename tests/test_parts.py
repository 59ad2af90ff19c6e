"""Names of parts, and what the connectivity of a volume mesh says."""

import naive_boundary as naive
import numpy as np
import pytest
import systems

from porous.errors import MeshError
from porous.stages import hexahedralize, name_parts
from porous.values import SHAPES, Block, Box, Frame, Part, VolumeMesh, VoxelGrid
from porous.values.box import SIDES
from porous.values.volume_topology import (
    bodies,
    boundary_faces,
    extracted,
    hung_by_faces,
    nodes_of,
)

SHAPE = (3, 4, 5)


def brick(spacing=(2.0, 1.0, 0.5), shape=SHAPE):
    return hexahedralize(
        VoxelGrid.of_solid(np.ones(shape, dtype=bool), Frame((1, 2, 3), spacing, shape))
    )


def box_of(mesh):
    return Box.of_points(mesh.points)


def test_sides_of_a_brick():
    mesh = brick()
    named = name_parts(mesh, box_of(mesh))
    for index, side in enumerate(SIDES):
        axis, end = divmod(index, 2)
        others = [n for i, n in enumerate(SHAPE) if i != axis]
        members = named.parts[side].members
        assert len(members) == (others[0] + 1) * (others[1] + 1)
        level = (box_of(mesh).lower, box_of(mesh).upper)[end][axis]
        assert (named.points[members, axis] == level).all()
        faces = named.parts[f"{side}_FACES"]
        assert len(faces.members) == others[0] * others[1]
        assert (named.points[nodes_of(named, faces.members)][:, :, axis] == level).all()
    assert len(named.parts["SKIN"].members) == 2 * (12 + 15 + 20)
    assert "WALL" not in named.parts
    assert named.parts["SOLID"].members.tolist() == list(range(60))


def test_walls_are_what_is_not_on_a_side():
    solid = naive.prefractal(3, systems.MENGER, 2)
    mesh = hexahedralize(VoxelGrid.of_solid(solid, Frame((0, 0, 0), (1, 2, 3), solid.shape)))
    named = name_parts(mesh, box_of(mesh))
    assert len(named.parts["SKIN"].members) == 6 * 64
    assert len(named.parts["SKIN"].members) + len(named.parts["WALL"].members) == 2 * 400 + 4 * 64
    assert named.parts["XMIN_FACES"].members.shape == (64, 2)


def test_faces_point_outwards_in_every_shape():
    # What S1, S2, … are: normals of SHAPES' faces leave the cell.
    corners = {
        "tet4": np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]),
        "hex8": brick(shape=(1, 1, 1)).points[brick(shape=(1, 1, 1)).blocks[0].cells[0]],
    }
    for shape, points in corners.items():
        for face in SHAPES[shape].faces:
            a, b, c = points[list(face)[:3]]
            outward = points[list(face)].mean(axis=0) - points.mean(axis=0)
            assert np.cross(b - a, c - a) @ outward > 0


def test_nodes_within_the_tolerance_count_and_others_do_not():
    mesh = brick(spacing=(1.0, 1.0, 1.0))
    near = mesh.points + 1e-5 * np.random.default_rng(0).standard_normal(mesh.points.shape)
    moved = VolumeMesh(near, mesh.blocks)
    box = box_of(mesh)
    assert len(name_parts(moved, box).parts["ZMAX"].members) == 20
    assert "ZMAX" not in name_parts(moved, box, tolerance=1e-9).parts
    with pytest.raises(MeshError, match="tolerance"):
        name_parts(mesh, box, tolerance=0.7)


def test_a_long_body_of_thin_cells_keeps_its_layers_apart():
    mesh = brick(spacing=(400.0, 1.0, 0.5))  # a thousandth of the length is more than two layers
    named = name_parts(mesh, box_of(mesh))
    assert len(named.parts["ZMAX"].members) == 20
    assert len(named.parts["YMIN_FACES"].members) == 15


def test_a_body_that_does_not_reach_a_side_has_no_part_there():
    mesh = brick()
    named = name_parts(mesh, box_of(mesh).grown(1.0))
    assert set(named.parts) == {"WALL", "SOLID"}


def test_parts_of_other_names_are_kept():
    mesh = brick()
    own = VolumeMesh(mesh.points, mesh.blocks, {}, {"GRIP": Part("nodes", np.array([3]))})
    assert name_parts(own, box_of(mesh)).parts["GRIP"].members.tolist() == [3]


def two_tets(shared):
    """Two tetrahedra that share so many of their nodes."""
    points = np.random.default_rng(shared).random((8 - shared, 3))
    second = list(range(4 - shared, 8 - shared))
    return VolumeMesh(points, (Block("tet4", np.array([[0, 1, 2, 3], second])),))


@pytest.mark.parametrize(("shared", "count"), [(0, 2), (1, 2), (2, 2), (3, 1)])
def test_bodies_hang_by_faces(shared, count):
    mesh = two_tets(shared)
    assert bodies(mesh).max() + 1 == count
    loose = hung_by_faces(mesh)
    assert len(loose.points) == (5 if shared == 3 else 8)
    assert np.array_equal(loose.points[loose.blocks[0].cells], mesh.points[mesh.blocks[0].cells])
    assert len(boundary_faces(mesh)) == (6 if shared == 3 else 8)


def test_nodes_joined_around_by_other_cells_stay_shared():
    # A fan of tetrahedra round an edge: all faces in a row, so the axis is one.
    angle = np.linspace(0, np.pi, 5)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(5)])
    points = np.vstack([[0, 0, -1], [0, 0, 1], ring])
    cells = np.array([[0, 1, 2 + i, 3 + i] for i in range(4)])
    mesh = VolumeMesh(points, (Block("tet4", cells),))
    assert len(hung_by_faces(mesh).points) == 7
    gap = VolumeMesh(points, (Block("tet4", cells[[0, 1, 3]]),))
    assert len(hung_by_faces(gap).points) == 5 + 4


def test_mixed_shapes_are_counted_through():
    hexes = brick(shape=(1, 1, 2))
    points = np.vstack([hexes.points, [9, 9, 9]])
    top = hexes.blocks[0].cells[1][[4, 5, 6]]
    tet = Block("tet4", np.array([[*top, len(points) - 1]]))
    mesh = VolumeMesh(points, (*hexes.blocks, tet), {"phase": np.array([1, 2, 3])})
    # A triangle and the half of a square are no common face.
    assert bodies(mesh).tolist() == [0, 0, 1]
    kept = extracted(mesh, np.array([False, True, True]))
    assert (kept.cells, len(kept.points)) == (2, 9)
    assert kept.cell_tags["phase"].tolist() == [2, 3]
    assert np.allclose(kept.volumes, mesh.volumes[1:])


def test_what_is_extracted_keeps_its_parts():
    mesh = brick()
    named = name_parts(mesh, box_of(mesh))
    chosen = np.arange(mesh.cells) % 5 == 4  # the top layer of voxels
    kept = extracted(named, chosen)
    assert len(kept.parts["ZMAX"].members) == 20
    assert len(kept.parts["ZMAX_FACES"].members) == 12
    assert len(kept.parts["ZMIN_FACES"].members) == 0
    assert kept.parts["SOLID"].members.tolist() == list(range(12))


def test_three_cells_on_one_face_are_refused():
    points = np.random.default_rng(0).random((6, 3))
    cells = np.array([[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 2, 5]])
    with pytest.raises(MeshError, match="more than two"):
        boundary_faces(VolumeMesh(points, (Block("tet4", cells),)))
