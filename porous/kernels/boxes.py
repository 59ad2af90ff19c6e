"""What boxes of one lattice hold of another: its solid sample points, the sums of its fills."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Ints = NDArray[np.int64]
    Index = tuple[int, int, int]

SLAB = 1 << 24
"""Voxels that one kernel call looks at, about."""


def masks_of(solid: NDArray[np.bool_], x: Ints, y: Ints, z: Ints) -> NDArray[np.uint64]:
    """Return the masks of a frame's voxels.

    Parameters
    ----------
    solid
        bool, shape (a, b, c): the voxels that are asked about.
    x, y
        int64, shapes (rows, nx) and (rows, ny): in which of them the lines of a pattern run, for
        each voxel of the frame; −1 where beyond them.
    z
        int64, shape (rows, columns, nz): the same of the points of each line.

    Returns
    -------
    uint64, shape (nx, ny, nz): bit r·columns + c is set where that point is solid.
    """
    masks = np.zeros((x.shape[1], y.shape[1], z.shape[2]), np.uint64)
    given = source(solid, np.bool_).view(np.uint8)
    _gather(given, *(source(index, np.int64) for index in (x, y, z)), masks)
    return masks


def box_sums(fill: NDArray[np.uint8], first: Index, shape: Index, parts: Index) -> Ints:
    """Return the sums of fills over boxes that cut each edge of a grid into equal parts.

    Voxel i of n along an axis lies in box ⌊i · parts / n⌋ of it: boxes are as many voxels wide, or
    one more, as are in their even share of the edge.

    Parameters
    ----------
    fill
        uint8, shape (x, y, z): a block of a grid.
    first
        Place of its first voxel in the grid.
    shape
        Numbers of voxels of the grid.
    parts
        Numbers of boxes along each edge of the grid, as many as there are voxels at most.

    Returns
    -------
    int64: one per box that the block has a voxel of.
    """
    begins = [
        _begins(a, count, n, k)
        for a, count, n, k in zip(first, fill.shape, shape, parts, strict=True)
    ]
    x, y, z = (source(begin, np.int64) for begin in begins)
    sums = np.zeros((len(x) - 1, len(y) - 1, len(z) - 1), np.int64)
    given = source(fill, np.uint8)
    thick = -(-shape[0] // parts[0]) * fill.shape[1] * fill.shape[2]
    slabs(len(sums), max(1, SLAB // thick), lambda a, b: _sum(given, x, y, z, a, b, sums))
    return sums


def _begins(first: int, count: int, n: int, parts: int) -> Ints:
    """Return the voxels of a block where boxes begin along an axis, and where the last one ends."""
    boxes = np.arange(first * parts // n, (first + count - 1) * parts // n + 2)
    return np.clip(-(-boxes * n // parts) - first, 0, count)


@kernel
def _sum(fill, x, y, z, start, stop, sums):
    for a in range(start, stop):
        for i in range(x[a], x[a + 1]):
            for b in range(len(y) - 1):
                line = sums[a, b]
                for j in range(y[b], y[b + 1]):
                    row = fill[i, j]
                    for c in range(len(z) - 1):
                        total = np.int64(0)
                        for k in range(z[c], z[c + 1]):
                            total += np.int64(row[k])
                        line[c] += total


@kernel
def _gather(solid, x, y, z, masks):
    rows, columns, nz = z.shape
    for i in range(masks.shape[0]):
        for j in range(masks.shape[1]):
            line = masks[i, j]
            for r in range(rows):
                a, b = x[r, i], y[r, j]
                if a < 0 or b < 0:
                    continue
                column = solid[a, b]
                for c in range(columns):
                    place = z[r, c]
                    bit = np.uint64(r * columns + c)
                    for k in range(nz):
                        if place[k] >= 0:
                            line[k] |= np.uint64(column[place[k]]) << bit
