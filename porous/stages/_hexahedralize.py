"""From voxels to hexahedra, one for each solid voxel."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.memory import check_memory
from porous.values import Block, VolumeMesh, VoxelGrid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.values import Frame

    Indices = NDArray[np.int64]

CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
"""A voxel's corners in VTK's order of a hexahedron's nodes."""

OCTANTS = tuple(itertools.product((0, 1), repeat=3))
"""The eight voxels around a lattice point; bit 4·dx + 2·dy + dz of its window."""

BYTES_PER_CELL, BYTES_PER_VOXEL = 400, 40


def hexahedralize(grid: VoxelGrid) -> VolumeMesh:
    """Return one trilinear hexahedron for each solid voxel.

    Nodes are shared across faces only: voxels that touch in an edge or a point, and are not
    joined around it by others, each have nodes of their own there. Cells are in the voxels' order,
    x slowest.

    Raises
    ------
    GridError
        Where no voxel is solid.
    MemoryLimitError
        Before anything is allocated.
    """
    if not isinstance(grid, VoxelGrid):
        raise GridError(
            f"hexahedralize: got a {type(grid).__name__}; wanted a grid in memory, as its "
            "to_grid() is where it fits"
        )
    count = int(np.count_nonzero(grid.solid))
    if not count:
        raise GridError(f"voxels: none of the {grid.frame.size} voxels is solid; no cells to make")
    check_memory(
        BYTES_PER_CELL * count + BYTES_PER_VOXEL * grid.frame.size,
        f"a mesh of {count} hexahedra",
        "Choose fewer voxels, or tetrahedra of the surface.",
    )
    windows = _windows(grid.solid)
    amount = COUNT[windows]
    first = np.cumsum(amount.ravel(), dtype=np.int64).reshape(amount.shape) - amount
    cells = _cells(np.argwhere(grid.solid), windows, first)
    points = _points(grid.frame, amount)
    return VolumeMesh(points, (Block("hex8", cells),), unit=grid.frame.unit)


def _windows(solid: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the 2×2×2 window of each lattice point as bits, shape (x + 1, y + 1, z + 1)."""
    x, y, z = solid.shape
    result = np.zeros((x + 1, y + 1, z + 1), dtype=np.uint8)
    for bit, (dx, dy, dz) in enumerate(OCTANTS):
        # Voxel (dx, dy, dz) of the window of point p is voxel p + (dx, dy, dz) − 1.
        a, b, c = 1 - dx, 1 - dy, 1 - dz
        result[a : a + x, b : b + y, c : c + z] |= solid.astype(np.uint8) << np.uint8(bit)
    return result


def _cells(voxels: Indices, windows: NDArray[np.uint8], first: Indices) -> Indices:
    cells = np.empty((len(voxels), 8), dtype=np.int64)
    for node, corner in enumerate(CORNERS):
        x, y, z = (voxels + corner).T
        dx, dy, dz = (1 - c for c in corner)
        cells[:, node] = first[x, y, z] + GROUP[windows[x, y, z], 4 * dx + 2 * dy + dz]
    return cells


def _points(frame: Frame, amount: NDArray[np.uint8]) -> NDArray[np.float64]:
    used = np.argwhere(amount)
    place = np.repeat(used, amount[tuple(used.T)], axis=0)
    return np.asarray(frame.origin + (place + frame.start) * np.array(frame.spacing))


def _groups() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return for each window the group of each voxel, joined by faces, and how many there are."""
    group = np.zeros((256, 8), dtype=np.uint8)
    count = np.zeros(256, dtype=np.uint8)
    for window in range(256):
        left = [bit for bit in range(8) if window >> bit & 1]
        while left:
            front = [left.pop(0)]
            while front:
                bit = front.pop()
                group[window, bit] = count[window]
                near = [other for other in left if (bit ^ other) in (1, 2, 4)]
                left = [other for other in left if other not in near]
                front += near
            count[window] += 1
    return group, count


GROUP, COUNT = _groups()
