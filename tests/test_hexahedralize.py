"""One hexahedron for each solid voxel: nodes across faces only, exact volumes, unequal axes."""

import naive_boundary as naive
import numpy as np
import pytest
import systems
from hypothesis import given, settings
from hypothesis import strategies as st

from porous.errors import GridError, MemoryLimitError
from porous.stages import hexahedralize
from porous.values import Block, Frame, VolumeMesh, VoxelGrid
from porous.values.volume_topology import bodies, boundary_faces, hung_by_faces


def grid_of(solid, spacing=(0.5, 0.25, 2.0)):
    return VoxelGrid.of_solid(solid, Frame((1.0, -2.0, 3.0), spacing, solid.shape))


@pytest.mark.parametrize(
    ("divisions", "keep", "level", "nodes", "parts"),
    [
        (2, systems.PARITY, 5, 8192, 1024),
        (3, systems.VICSEK_9, 3, 5832, 729),
        (3, systems.EDGES_12, 3, 8 * 1728, 1728),
        (3, systems.MENGER, 3, 15616, 1),
        (3, systems.MENGER, 2, 896, 1),
    ],
)
def test_nodes_and_bodies_of_the_literature(divisions, keep, level, nodes, parts):
    solid = naive.prefractal(divisions, keep, level)
    mesh = hexahedralize(grid_of(solid))
    assert (mesh.cells, len(mesh.points)) == (solid.sum(), nodes)
    assert bodies(mesh).max() + 1 == parts


@settings(max_examples=60)
@given(st.data())
def test_any_grid_has_the_nodes_of_shared_faces(data):
    shape = data.draw(st.tuples(*[st.integers(1, n) for n in (5, 4, 3)]))
    size = shape[0] * shape[1] * shape[2]
    bits = data.draw(st.lists(st.booleans(), min_size=size, max_size=size))
    solid = np.array(bits).reshape(shape)
    if not solid.any():
        solid[0, 0, 0] = True
    mesh = hexahedralize(grid_of(solid))
    # Each voxel in its place, with the volume of a voxel.
    middles = mesh.points[mesh.blocks[0].cells].mean(axis=1)
    assert np.allclose(middles, [1, -2, 3] + (np.argwhere(solid) + 0.5) * [0.5, 0.25, 2])
    assert np.allclose(mesh.volumes, 0.25)
    # The general rule for any mesh, from lattice nodes shared in every way, gives these nodes.
    shared, index = np.unique(mesh.points, axis=0, return_inverse=True)
    closed = VolumeMesh(shared, (Block("hex8", index.reshape(-1)[mesh.blocks[0].cells]),))
    assert len(hung_by_faces(closed).points) == len(mesh.points)
    assert len(boundary_faces(mesh)) == len(naive.quads(solid))
    assert len(np.unique(mesh.blocks[0].cells)) == len(mesh.points)


def test_a_tile_lies_where_it_is_in_the_whole():
    frame = Frame((0, 0, 0), (1, 2, 3), (4, 4, 4)).tile((1, 2, 3), (3, 3, 4))
    mesh = hexahedralize(VoxelGrid(frame, np.full(frame.shape, 255, np.uint8)))
    assert mesh.points.min(axis=0).tolist() == [1, 4, 9]
    assert mesh.points.max(axis=0).tolist() == [3, 6, 12]


def test_half_full_voxels_are_solid_and_the_unit_is_kept():
    fill = np.array([127, 128, 255], np.uint8).reshape(3, 1, 1)
    mesh = hexahedralize(VoxelGrid(Frame((0, 0, 0), (1, 1, 1), (3, 1, 1), unit="um"), fill))
    assert (mesh.cells, mesh.unit) == (2, "um")


def test_an_empty_grid_is_refused():
    with pytest.raises(GridError, match="none of the 6 voxels"):
        hexahedralize(grid_of(np.zeros((1, 2, 3), dtype=bool)))


def test_memory_is_asked_for_first(monkeypatch):
    monkeypatch.setattr("porous.memory.available", lambda: 1000)
    with pytest.raises(MemoryLimitError, match="hexahedra"):
        hexahedralize(grid_of(np.ones((4, 5, 6), dtype=bool)))
