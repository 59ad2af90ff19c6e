"""How the bytes of a grid are spread: which fills lie in which bulk, and where solid meets void."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Axes = tuple[bool, bool, bool]
    Index = tuple[int, int, int]
    Progress = Callable[[int, int], None]

SLAB = 1 << 24
"""Voxels that one kernel call looks at, about."""

_NO_BULK = np.zeros((0, 0, 0), np.uint8)


def tile_fills(
    fill: NDArray[np.uint8],
    bulk: NDArray[np.uint8] | None,
    start: Index,
    stop: Index,
    *,
    periodic: Axes = (False, False, False),
    progress: Progress | None = None,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Count the fills of the tile ``start`` … ``stop`` (not within) of a grid.

    Parameters
    ----------
    fill
        uint8, shape (x, y, z): the whole grid; one voxel below the tile is read.
    bulk
        uint8 of that shape, or None where all is bulk.
    start, stop
        First voxel, and the one after the last, per axis.
    periodic
        Axes along which the grid closes on itself; else it lies in void.
    progress
        Called as ``progress(done, count)`` in planes along x.

    Returns
    -------
    histogram
        int64, shape (256, 256): number of voxels by fill and bulk.
    jumps
        int64, shape (3, longest + 1): number of voxel faces between fill 255 and fill 0 (or the
        void beyond the grid), by axis and lattice plane: plane i lies below voxel i.
    """
    given = source(fill, np.uint8)
    body = source(_NO_BULK if bulk is None else bulk, np.uint8)
    count = stop[0] - start[0]
    planes = max(1, SLAB // ((stop[1] - start[1]) * (stop[2] - start[2])))
    parts = -(-count // planes)
    histogram = np.zeros((parts, 256, 1 if bulk is None else 256), np.int64)
    jumps = np.zeros((parts, 3, max(fill.shape) + 1), np.int64)
    wraps = np.array(periodic, np.int64)
    void = source(np.zeros(fill.shape[2]), np.uint8)

    def work(a, b):
        ends = np.array([[start[0] + a, *start[1:]], [start[0] + b, *stop[1:]]], np.int64)
        _survey(given, body, ends, wraps, void, histogram[a // planes], jumps[a // planes])

    slabs(count, planes, work, progress)
    result = np.zeros((256, 256), np.int64)
    result[:, 255 if bulk is None else slice(None)] = histogram.sum(axis=0).squeeze()
    return result, jumps.sum(axis=0)


@kernel
def _sharp(one, other, counts):
    """Return how often 0 meets 255 between two rows; add 1 to ``counts`` there, if it has room."""
    total = 0
    for k in range(len(one)):
        total += np.int64((one[k] == 0) & (other[k] == 255) | (one[k] == 255) & (other[k] == 0))
    if total and len(counts):
        for k in range(len(one)):
            counts[k] += np.int64(
                (one[k] == 0) & (other[k] == 255) | (one[k] == 255) & (other[k] == 0)
            )
    return total


@kernel
def _survey(fill, bulk, ends, wraps, void, histogram, jumps):
    """Add the voxels between ``ends`` to the histogram and their sharp faces to ``jumps``."""
    nx, ny, nz = fill.shape
    a, b = ends[0, 2], ends[1, 2]
    none = jumps[0, :0]
    for i in range(ends[0, 0], ends[1, 0]):
        for j in range(ends[0, 1], ends[1, 1]):
            row = fill[i, j, a:b]
            left = void[a:b] if i == 0 and not wraps[0] else fill[i - 1, j, a:b]
            front = void[a:b] if j == 0 and not wraps[1] else fill[i, j - 1, a:b]
            jumps[0, i] += _sharp(row, left, none)
            jumps[1, j] += _sharp(row, front, none)
            if i == nx - 1 and not wraps[0]:
                jumps[0, nx] += _sharp(row, void[a:b], none)
            if j == ny - 1 and not wraps[1]:
                jumps[1, ny] += _sharp(row, void[a:b], none)
            below = row[:1]
            if a > 0:
                below = fill[i, j, a - 1 : a]
            elif wraps[2]:
                below = fill[i, j, nz - 1 :]
            else:
                below = void[:1]
            jumps[2, a] += _sharp(row[:1], below, none)
            _sharp(row[1:], row[:-1], jumps[2, a + 1 : b])
            if b == nz and not wraps[2]:
                jumps[2, nz] += _sharp(row[-1:], void[:1], none)
            if len(bulk):
                for k in range(b - a):
                    histogram[row[k], bulk[i, j, a + k]] += 1
            else:
                for k in range(b - a):
                    histogram[row[k], 0] += 1
