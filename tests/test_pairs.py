"""Nodes of opposite sides: pairs of any periodic mesh, and what has none."""

import naive_boundary as naive
import numpy as np
import pytest
import systems

import porous as po
from porous.errors import MeshError
from porous.stages import hexahedralize, name_parts, periodic_pairs, quadratic
from porous.values import Block, Box, Frame, VolumeMesh, VoxelGrid
from porous.values.volume_topology import bodies, boundary_faces, hung_by_faces

SPACING = (0.5, 0.25, 2.0)
ALL = (True, True, True)
NAMES = ("XPAIRS", "YPAIRS", "ZPAIRS")


def voxels(solid, periodic=ALL, phase="solid"):
    frame = Frame((1.0, -2.0, 3.0), SPACING, solid.shape, periodic)
    return hexahedralize(VoxelGrid.of_solid(solid, frame), phase=phase)


def as_set(part):
    return set(map(tuple, part.members.tolist()))


def in_tetrahedra(mesh):
    """Cut each hexahedron into six about its diagonal: opposite faces are cut alike."""
    steps = [(1, 2), (2, 3), (3, 7), (7, 4), (4, 5), (5, 1)]
    cells = mesh.blocks[0].cells
    tets = np.stack([cells[:, [0, a, b, 6]] for a, b in steps], axis=1).reshape(-1, 4)
    return VolumeMesh(mesh.points, (Block("tet4", tets),), unit=mesh.unit)


@pytest.mark.parametrize("phase", ["solid", "both"])
def test_pairs_found_by_place_are_those_of_the_voxels(phase):
    mesh = voxels(naive.prefractal(3, systems.MENGER, 2), phase=phase)
    found = periodic_pairs(VolumeMesh(mesh.points, mesh.blocks))
    for name in NAMES:
        assert as_set(found.parts[name]) == as_set(mesh.parts[name])
    # Along x alone there are those along x alone.
    assert set(periodic_pairs(in_tetrahedra(mesh), axes=(True, False, False)).parts) == {"XPAIRS"}


def test_tetrahedra_and_noise_below_the_tolerance():
    mesh = voxels(np.ones((2, 3, 4), bool))
    tets = in_tetrahedra(mesh)
    assert tets.volumes.min() > 0
    rng = np.random.default_rng(0)
    noise = rng.uniform(-1e-8, 1e-8, mesh.points.shape)
    moved = VolumeMesh(tets.points + noise, tets.blocks)
    for name in NAMES:
        assert as_set(periodic_pairs(moved).parts[name]) == as_set(mesh.parts[name])
    with pytest.raises(MeshError, match=r"no partner|no face lies"):
        periodic_pairs(moved, tolerance=1e-12)


def test_conforming_cells_that_are_periodic():
    model = po.build(po.load("menger-block", set={"model.level": 2}))
    mesh = po.mesh_cells(model)
    paired = periodic_pairs(mesh)
    lower, upper = mesh.points.min(axis=0), mesh.points.max(axis=0)
    for axis, name in enumerate(NAMES):
        low, high = paired.parts[name].members.T
        step = np.where(np.arange(3) == axis, upper - lower, 0)
        assert np.abs(mesh.points[high] - mesh.points[low] - step).max() < 1e-12
        # A side is a carpet of 64 squares on 96 nodes.
        assert len(low) == len(np.unique(high)) == 96
    assert paired.parts["SOLID"] == mesh.parts["SOLID"]


def test_nodes_at_one_place_keep_to_their_own_cells():
    # Two bars that touch in an edge: nodes there are two on either side.
    solid = np.zeros((2, 2, 3), bool)
    solid[0, 0] = solid[1, 1] = True
    mesh = voxels(solid, (False, False, True))
    found = periodic_pairs(VolumeMesh(mesh.points, mesh.blocks), axes=(False, False, True))
    assert as_set(found.parts["ZPAIRS"]) == as_set(mesh.parts["ZPAIRS"])
    assert len(found.parts["ZPAIRS"].members) == 8


def test_what_has_no_partner_is_counted_and_placed():
    solid = np.ones((2, 3, 4), bool)
    solid[1, 2, 3] = False
    mesh = voxels(solid, (False, False, False))
    with pytest.raises(MeshError) as caught:
        periodic_pairs(mesh, axes=(True, False, False))
    said = str(caught.value)
    assert "1 nodes and 1 faces of XMIN and 0 nodes and 0 faces of XMAX" in said
    assert "the first node at (1, -1.25, 11) mm" in said
    assert "the first face about (1, -1.375, 10) mm" in said


def test_joined_on_one_side_and_apart_on_the_other_is_refused():
    # In the layer at ZMIN two corners are joined around by a third voxel, at ZMAX they are not.
    solid = np.zeros((2, 2, 2), bool)
    solid[0, 0] = solid[1, 1] = True
    mesh = voxels(solid, (False, False, False))
    points, cells = mesh.points, mesh.blocks[0].cells.copy()
    low = np.flatnonzero((points[:, 2] == 3) & np.isclose(points[:, 0], 1.5))
    twins = [n for n in low if np.isclose(points[n, 1], -1.75)]
    assert len(twins) == 2
    cells[cells == twins[1]] = twins[0]
    with pytest.raises(MeshError, match="1 nodes of ZMIN have several partners"):
        periodic_pairs(VolumeMesh(points, (Block("hex8", cells),)), axes=(False, False, True))


def test_triangles_are_no_copies_of_quadrilaterals():
    hexes = voxels(np.ones((1, 1, 1), bool))
    tets = in_tetrahedra(voxels(np.ones((1, 1, 1), bool)))
    shift = np.array([SPACING[0], 0, 0])
    points = np.concatenate([hexes.points, tets.points + shift])
    blocks = (hexes.blocks[0], Block("tet4", tets.blocks[0].cells + 8))
    with pytest.raises(MeshError, match="4 nodes and 1 faces of XMIN"):
        periodic_pairs(VolumeMesh(points, blocks), axes=(True, False, False))


def test_a_body_without_a_face_on_its_side_is_refused():
    points = np.array([[0, 0, 0], [1, 0, 0], [0.2, 1, 0], [0.3, 0.2, 1.0]])
    mesh = VolumeMesh(points, (Block("tet4", np.array([[0, 1, 2, 3]])),))
    with pytest.raises(MeshError, match="no face lies in XMIN, x = 0 mm"):
        periodic_pairs(mesh)
    with pytest.raises(MeshError, match="tolerance: got 0"):
        periodic_pairs(mesh, tolerance=0)
    with pytest.raises(MeshError, match="no cells"):
        periodic_pairs(VolumeMesh(points, ()))


@pytest.mark.parametrize("cut", [False, True])
def test_middles_of_edges_are_paired_whichever_comes_first(cut):
    solid = naive.prefractal(3, systems.MENGER, 1)
    mesh = voxels(solid)
    if cut:
        mesh = periodic_pairs(in_tetrahedra(mesh))
    first = quadratic(mesh)
    then = periodic_pairs(quadratic(VolumeMesh(mesh.points, mesh.blocks)))
    lengths = np.ptp(mesh.points, axis=0)
    for axis, name in enumerate(NAMES):
        assert as_set(first.parts[name]) == as_set(then.parts[name])
        low, high = first.parts[name].members.T
        step = np.where(np.arange(3) == axis, lengths, 0)
        assert np.allclose(first.points[high] - first.points[low], step, atol=1e-12)
        # A ring of 8 squares: 16 nodes, 24 edges and, cut in triangles, 8 diagonals.
        assert len(low) == len(np.unique(low)) == 16 + 24 + 8 * cut


def test_every_node_of_a_side_is_in_a_pair():
    mesh = voxels(np.random.default_rng(4).random((3, 4, 5)) < 0.5, phase="both")
    mesh = quadratic(name_parts(mesh, Box.of_points(mesh.points)))
    for axis, name in enumerate(NAMES):
        for column, side in enumerate(("MIN", "MAX")):
            part = mesh.parts[f"{'XYZ'[axis]}{side}"].members
            assert np.array_equal(np.sort(part), np.sort(mesh.parts[name].members[:, column]))


def test_copies_of_a_tile_close_without_a_seam():
    mesh = voxels(naive.prefractal(3, systems.MENGER, 1))
    paired = periodic_pairs(in_tetrahedra(mesh))
    low, high = paired.parts["XPAIRS"].members.T
    count = len(paired.points)
    node = np.arange(2 * count)
    node[low + count] = high
    cells = paired.blocks[0].cells
    points = np.concatenate([paired.points, paired.points + np.array([3 * SPACING[0], 0, 0])])
    glued = VolumeMesh(points, (Block("tet4", node[np.concatenate([cells, cells + count])]),))
    both = [paired, hung_by_faces(glued)]
    assert bodies(both[1]).max() == 0
    # Two of the carpet's 16 triangles go from each copy.
    left = [len(boundary_faces(m)) for m in both]
    assert left[1] == 2 * left[0] - 2 * 16


def test_axes_are_told_apart():
    for axis in range(3):
        axes = tuple(a == axis for a in range(3))
        mesh = periodic_pairs(voxels(np.ones((2, 3, 4), bool), (False,) * 3), axes=axes)
        others = [n + 1 for a, n in enumerate((2, 3, 4)) if a != axis]
        assert [len(mesh.parts[NAMES[axis]].members)] == [others[0] * others[1]]
        assert len(mesh.parts) == 1
