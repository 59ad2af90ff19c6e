"""Coarse meshes of hexahedra: the value, and files of others from which it comes."""

import pickle

import numpy as np
import pytest

from porous.errors import MeshError
from porous.values import Block, HexMesh, VolumeMesh

CORNERS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
)
"""A cube's corners in VTK's order."""


def brick(shape=(2, 3, 4), spacing=(1.0, 0.5, 0.25), *, seed=0):
    """Return hexahedra in a brick whose inner and outer points are moved a little."""
    counts = np.array(shape) + 1
    lattice = np.stack(np.indices(counts), axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(seed)
    points = (lattice + rng.uniform(-0.1, 0.1, lattice.shape)) * spacing
    cells = np.stack(np.indices(shape), axis=-1).reshape(-1, 1, 3) + CORNERS
    return HexMesh(points, np.ravel_multi_index(np.moveaxis(cells, -1, 0), counts))


def cubes(mesh):
    """Return each cell's corner coordinates: what does not depend on how points are numbered."""
    return mesh.points[mesh.hexahedra]


# --- the value ---------------------------------------------------------------------------------


def test_a_mesh_is_a_value():
    mesh = brick()
    assert mesh == pickle.loads(pickle.dumps(mesh)) == HexMesh(mesh.points, mesh.hexahedra)
    assert mesh != brick(seed=1)
    assert not mesh.points.flags.writeable
    assert (mesh.points.dtype, mesh.hexahedra.dtype) == (np.float64, np.int64)


@pytest.mark.parametrize(
    ("points", "cells", "said"),
    [
        (CORNERS, np.zeros((0, 8), int), "no hexahedra; wanted at least one"),
        (CORNERS, [[0, 1, 2, 3, 4, 5, 6]], r"hexahedra: got shape \(1, 7\); wanted \(n, 8\)"),
        (CORNERS, [[0, 1, 2, 3, 4, 5, 6, 8]], "run from 0 to 8; there are 8 points"),
        (CORNERS, [[0, 1, 2, 3, 4, 5, 6, -1]], "run from -1 to 6"),
        (
            CORNERS,
            [list(range(8)), [0, 1, 2, 3, 4, 5, 6, 2]],
            r"hexahedron 1: got corners \[0, .* 2\];",
        ),
        (CORNERS, [[0.0, 1, 2, 3, 4, 5, 6, 7]], "hexahedra: got float64; wanted whole numbers"),
        (CORNERS[:, :2], [range(8)], r"points: got shape \(8, 2\); wanted \(n, 3\)"),
        (np.where(CORNERS == 0, np.nan, 1), [range(8)], "point 0 is .*nan"),
        (np.where(CORNERS == 0, np.inf, 1), [range(8)], "point 0 is .*inf"),
    ],
)
def test_what_is_no_mesh_is_refused(points, cells, said):
    with pytest.raises(MeshError, match=said):
        HexMesh(points, np.array(cells))


def test_the_hexahedra_of_a_volume_mesh():
    mesh = brick()
    lonely = np.concatenate([[[9.0, 9, 9]], mesh.points, [[7.0, 7, 7]]])
    blocks = (Block("hex8", mesh.hexahedra[:5] + 1), Block("hex8", mesh.hexahedra[5:] + 1))
    volume = VolumeMesh(lonely, (*blocks, Block("tet4", np.zeros((0, 4), int))), unit="cm")
    assert HexMesh.of_volume(volume) == mesh


def test_a_volume_mesh_with_other_cells_has_no_hexahedral_mesh():
    tets = Block("tet4", np.array([[0, 1, 2, 4], [1, 2, 3, 4]]))
    with pytest.raises(MeshError, match=r"got 2 tet4; wanted hexahedra \(hex8\) only"):
        HexMesh.of_volume(VolumeMesh(CORNERS, (tets, Block("hex8", np.arange(8)[None]))))
    with pytest.raises(MeshError, match="no hexahedra"):
        HexMesh.of_volume(VolumeMesh(CORNERS, ()))
