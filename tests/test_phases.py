"""Hexahedra of solid, pores and both: counts, one interface, opposite sides that match."""

import itertools
import tracemalloc

import naive_boundary as naive
import numpy as np
import pytest
import systems
from hypothesis import given, settings
from hypothesis import strategies as st

from porous.errors import GridError
from porous.stages import hexahedralize, name_parts
from porous.stages._hexahedralize import BYTES_PER_CELL, BYTES_PER_VOXEL
from porous.values import Block, Frame, VolumeMesh, VoxelGrid
from porous.values.box import SIDES
from porous.values.surface_topology import joined
from porous.values.volume_topology import (
    bodies,
    boundary_faces,
    extracted,
    faces,
    hung_by_faces,
    matched,
    nodes_of,
)

SPACING = (0.5, 0.25, 2.0)
ALL = (True, True, True)


def grid_of(solid, periodic=(False, False, False), bulk=None):
    frame = Frame((1.0, -2.0, 3.0), SPACING, solid.shape, periodic)
    fill = np.where(solid, np.uint8(200), np.uint8(50))
    return VoxelGrid(frame, fill, None if bulk is None else bulk.astype(np.uint8) * 130)


@st.composite
def solids(draw):
    shape = draw(st.tuples(*[st.integers(1, n) for n in (4, 3, 5)]))
    size = shape[0] * shape[1] * shape[2]
    bits = draw(st.lists(st.booleans(), min_size=size, max_size=size))
    return np.array(bits).reshape(shape)


@settings(max_examples=40)
@given(solids())
def test_both_phases_are_one_mesh_of_the_frame(solid):
    mesh = hexahedralize(grid_of(solid), phase="both")
    x, y, z = solid.shape
    assert (mesh.cells, len(mesh.points)) == (x * y * z, (x + 1) * (y + 1) * (z + 1))
    assert mesh.cell_tags["phase"].tolist() == solid.ravel().tolist()
    assert len(boundary_faces(mesh)) == 2 * (x * y + y * z + z * x)
    named = name_parts(mesh, grid_of(solid).frame.box)
    inner = [n for n in naive.quads(solid) if in_frame(naive.neighbour(*n), solid.shape)]
    assert len(named.parts["INTERFACE"].members if inner else []) == len(inner)
    assert len(named.parts["SKIN"].members) == len(boundary_faces(mesh))
    assert "WALL" not in named.parts
    for name, count in (("SOLID", solid.sum()), ("PORE", (~solid).sum())):
        assert len(named.parts[name].members if count else []) == count


def in_frame(voxel, shape):
    return all(0 <= i < n for i, n in zip(voxel, shape, strict=True))


def test_the_interface_is_of_the_solid_and_faces_the_pores():
    solid = naive.prefractal(3, systems.MENGER, 1)
    mesh = hexahedralize(grid_of(solid), phase="both")
    named = name_parts(mesh, grid_of(solid).frame.box)
    cell, _ = named.parts["INTERFACE"].members.T
    assert (named.cell_tags["phase"][cell] == 1).all()
    assert len(cell) == 24
    # Seen from the solid the normal leaves it: the middle behind the face is a pore's.
    corners = named.points[nodes_of(named, named.parts["INTERFACE"].members)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0])
    behind = corners.mean(axis=1) + 0.5 * normal / np.prod(SPACING) * np.square(SPACING)
    at = np.floor((behind - [1, -2, 3]) / SPACING).astype(int)
    assert not solid[tuple(at.T)].any()


@settings(max_examples=40)
@given(solids())
def test_pores_are_the_solid_of_the_negative(solid):
    if solid.all():
        with pytest.raises(GridError, match="is pore"):
            hexahedralize(grid_of(solid), phase="pore")
        return
    mesh = hexahedralize(grid_of(solid), phase="pore")
    other = hexahedralize(grid_of(~solid))
    assert (mesh.points == other.points).all()
    assert mesh.blocks == other.blocks
    assert not mesh.cell_tags["phase"].any()
    named = name_parts(mesh, grid_of(solid).frame.box)
    assert "SOLID" not in named.parts
    assert len(named.parts["PORE"].members) == mesh.cells


def test_pores_are_of_the_bulk_and_solid_is_wherever_it_is():
    rng = np.random.default_rng(3)
    solid, bulk = rng.random((4, 5, 3)) < 0.4, rng.random((4, 5, 3)) < 0.6
    pores = hexahedralize(grid_of(solid, bulk=bulk), phase="pore")
    both = hexahedralize(grid_of(solid, bulk=bulk), phase="both")
    assert pores.cells == (bulk & ~solid).sum()
    assert both.cells == (bulk | solid).sum()
    assert both.cell_tags["phase"].sum() == solid.sum()
    assert len(hung_by_faces(both).points) == len(both.points)
    # Whatever the bulk leaves bare is skin, on the frame or not.
    assert "WALL" not in name_parts(both, grid_of(solid).frame.box).parts


def test_another_phase_is_refused():
    with pytest.raises(GridError, match="got 'void'; wanted one of solid, pore, both"):
        hexahedralize(grid_of(np.ones((1, 2, 3), bool)), phase="void")


def tiled(mesh, grid, copies):
    """Return copies of a mesh glued by its pairs alone."""
    lengths = np.array(grid.frame.box.lengths)
    count, places = len(mesh.points), list(itertools.product(*map(range, copies)))
    node = np.arange(count * len(places))
    links = []
    for index, place in enumerate(places):
        for axis in range(3):
            step = tuple(p + (a == axis) for a, p in enumerate(place))
            part = mesh.parts.get(f"{'XYZ'[axis]}PAIRS")
            if step in places and part is not None:
                low, high = part.members.T
                links.append(
                    np.column_stack([high + index * count, low + places.index(step) * count])
                )
    if links:
        node = joined(len(node), *np.concatenate(links).T)
    points = np.empty((node.max() + 1, 3))
    points[node] = np.concatenate([mesh.points + lengths * place for place in places])
    cells = np.concatenate([mesh.blocks[0].cells + i * count for i in range(len(places))])
    return VolumeMesh(points, (Block("hex8", node[cells]),))


@settings(max_examples=40)
@given(solids(), st.sampled_from(list(itertools.product((True, False), repeat=3))[:-1]))
def test_copies_glued_by_pairs_are_the_mesh_of_the_tiling(solid, periodic):
    solid = solid.copy()
    solid[0, 0, 0] = True
    grid = grid_of(solid, periodic)
    mesh = hexahedralize(grid)
    copies = tuple(3 if wraps else 1 for wraps in periodic)
    glued = tiled(mesh, grid, copies)
    whole = hexahedralize(grid_of(np.tile(solid, copies)))
    # The faces that copies share, and what is then left as boundary, are those of the tiling.
    assert len(boundary_faces(glued)) == len(boundary_faces(whole))
    assert bodies(glued).max() == bodies(whole).max()
    # Inside, where no copy ends, nodes are those of the tiling, one by one.
    middle = np.array(grid.frame.box.lengths) * [c // 2 for c in copies] + grid.frame.origin
    upper = middle + np.array(grid.frame.box.lengths)
    wraps = np.array(periodic)
    tiles = []
    for tiling in (glued, whole):
        inner = ((tiling.points > middle - 1e-9) & (tiling.points < upper + 1e-9)) | ~wraps
        tiles.append(int(inner.all(axis=1).sum()))
    assert tiles[0] == tiles[1]


@settings(max_examples=40)
@given(solids())
def test_partners_lie_one_period_on_and_are_one_to_one(solid):
    solid = solid.copy()
    solid[0, 0, 0] = True
    grid = grid_of(solid, ALL)
    mesh = hexahedralize(grid)
    for axis in range(3):
        part = mesh.parts[f"{'XYZ'[axis]}PAIRS"]
        crossing = np.take(solid, 0, axis) & np.take(solid, -1, axis)
        assert bool(len(part.members)) == crossing.any()
        low, high = part.members.T
        step = np.where(np.arange(3) == axis, grid.frame.box.lengths, 0.0)
        assert np.allclose(mesh.points[high] - mesh.points[low], step)
        assert len(np.unique(low)) == len(np.unique(high)) == len(low)


def test_every_node_of_a_full_tile_has_a_partner():
    shape = (3, 4, 5)
    mesh = hexahedralize(grid_of(np.eye(20).reshape(4, 5, 20)[:3, :4, :5] > 0, ALL), phase="both")
    for axis in range(3):
        others = [n + 1 for a, n in enumerate(shape) if a != axis]
        assert len(mesh.parts[f"{'XYZ'[axis]}PAIRS"].members) == others[0] * others[1]
    box = grid_of(np.ones(shape, bool)).frame.box
    named = name_parts(mesh, box)
    for axis in range(3):
        low, high = named.parts[f"{'XYZ'[axis]}PAIRS"].members.T
        for side, nodes in zip(SIDES[2 * axis : 2 * axis + 2], (low, high), strict=True):
            assert np.array_equal(named.parts[side].members, np.sort(nodes))


def test_voxels_that_meet_in_an_edge_across_the_border_have_the_same_nodes_on_both_sides():
    solid = np.zeros((2, 3, 3), bool)
    solid[0, 0, 1] = solid[0, 1, 1] = True  # beside each other at XMIN
    solid[1, 0, 1] = True  # behind the first one, across the border
    mesh = hexahedralize(grid_of(solid, (True, False, False)))
    assert len(mesh.parts["XPAIRS"].members) == 4
    apart = np.zeros((3, 2, 1), bool)
    apart[0, 0, 0] = apart[2, 1, 0] = True  # in an edge only: nothing to hold
    assert not len(hexahedralize(grid_of(apart, (True, False, False))).parts["XPAIRS"].members)
    assert "YPAIRS" not in hexahedralize(grid_of(apart, (True, False, False))).parts


def test_memory_is_what_is_asked_for():
    solid = np.random.default_rng(0).random((50, 40, 60)) < 0.5
    grid = grid_of(solid, ALL)
    tracemalloc.start()
    mesh = hexahedralize(grid, phase="both")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    asked = BYTES_PER_CELL * mesh.cells + BYTES_PER_VOXEL * grid.frame.size
    assert peak < asked < 2**31 * mesh.cells / 10**6  # a million cells in two gibibytes


def test_interior_faces_are_shared_by_two():
    solid = np.random.default_rng(1).random((5, 6, 4)) < 0.5
    mesh = hexahedralize(grid_of(solid), phase="both")
    every = faces(mesh)
    first, _ = matched(every)
    assert 2 * len(first) + len(boundary_faces(mesh)) == len(every.members) == 6 * mesh.cells
    part = extracted(mesh, mesh.cell_tags["phase"] == 1)
    assert len(boundary_faces(part)) == len(naive.quads(solid))
