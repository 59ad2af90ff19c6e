"""How the bytes of a grid are spread: which fills lie in which bulk, where solid meets void."""

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


def block_fills(
    fill: NDArray[np.uint8],
    bulk: NDArray[np.uint8] | None,
    *,
    below: Axes,
    above: Axes,
    progress: Progress | None = None,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Count the fills of a block of voxels.

    Parameters
    ----------
    fill
        uint8, shape (x, y, z).
    bulk
        uint8 of that shape, or None where all is bulk.
    below
        Axes along which the block's first layer is only looked at, as the one below a tile; along
        the others the block begins with void.
    above
        Axes along which void follows on the block.
    progress
        Called as ``progress(done, count)`` in planes along x.

    Returns
    -------
    histogram
        int64, shape (256, 256): number of voxels by fill and bulk.
    jumps
        int64, shape (3, longest + 1): number of voxel faces between fill 255 and fill 0 (or void),
        by axis and lattice plane: plane i lies below voxel i of the block.
    """
    given = source(fill, np.uint8)
    body = source(_NO_BULK if bulk is None else bulk, np.uint8)
    start, stop = [int(axis) for axis in below], fill.shape
    count = stop[0] - start[0]
    planes = max(1, SLAB // (stop[1] * stop[2]))
    parts = -(-count // planes)
    histogram = np.zeros((parts, 256, 1 if bulk is None else 256), np.int64)
    jumps = np.zeros((parts, 3, max(fill.shape) + 1), np.int64)
    void_above = np.array(above, np.int64)
    void = source(np.zeros(fill.shape[2]), np.uint8)

    def work(a, b):
        ends = np.array([[start[0] + a, *start[1:]], [start[0] + b, *stop[1:]]], np.int64)
        _survey(given, body, ends, void_above, void, histogram[a // planes], jumps[a // planes])

    slabs(count, planes, work, progress)
    result = np.zeros((256, 256), np.int64)
    result[:, 255 if bulk is None else slice(None)] = histogram.sum(axis=0).squeeze()
    return result, jumps.sum(axis=0)


def pooled(
    fill: NDArray[np.uint8],
    first: Index,
    factor: int,
    *,
    progress: Progress | None = None,
) -> NDArray[np.uint8]:
    """Return the largest fill in every box of ``factor``³ voxels.

    Parameters
    ----------
    fill
        uint8, shape (x, y, z): a block of a grid.
    first
        Place of its first voxel in the grid; boxes are counted from the grid's first voxel.
    factor
        Edge of a box in voxels.
    progress
        Called as ``progress(done, count)`` in boxes along x.

    Returns
    -------
    uint8: one per box that the block has a voxel of.
    """
    given = source(fill, np.uint8)
    phase = np.array([a % factor for a in first], np.int64)
    shape = [-(-(n + p) // factor) for n, p in zip(fill.shape, phase, strict=True)]
    result = np.zeros(shape, np.uint8)
    planes = max(1, SLAB // (factor * fill.shape[1] * fill.shape[2]))

    def work(a, b):
        _pool(given, phase, factor, a, b, np.empty(fill.shape[2], np.uint8), result)

    slabs(len(result), planes, work, progress)
    return result


@kernel
def _sharp(one, other, counts):
    """Return how often 0 meets 255 between two rows; add 1 to ``counts`` there, if it has room.

    Those two bytes differ in all bits, and are the only ones that one more makes 1 or 0.
    """
    total = 0
    for k in range(len(one)):
        total += np.int64((np.uint8(one[k] ^ other[k]) == 255) & (np.uint8(one[k] + 1) <= 1))
    if total and len(counts):
        for k in range(len(one)):
            sharp = (np.uint8(one[k] ^ other[k]) == 255) & (np.uint8(one[k] + 1) <= 1)
            counts[k] += np.int64(sharp)
    return total


@kernel
def _survey(fill, bulk, ends, above, void, histogram, jumps):
    """Add the voxels between ``ends`` to the histogram and their sharp faces to ``jumps``."""
    nx, ny, nz = fill.shape
    a, b = ends[0, 2], ends[1, 2]
    nowhere = jumps[0, :0]
    for i in range(ends[0, 0], ends[1, 0]):
        for j in range(ends[0, 1], ends[1, 1]):
            row = fill[i, j, a:b]
            left = void[a:b] if i == 0 else fill[i - 1, j, a:b]
            front = void[a:b] if j == 0 else fill[i, j - 1, a:b]
            jumps[0, i] += _sharp(row, left, nowhere)
            jumps[1, j] += _sharp(row, front, nowhere)
            if i == nx - 1 and above[0]:
                jumps[0, nx] += _sharp(row, void[a:b], nowhere)
            if j == ny - 1 and above[1]:
                jumps[1, ny] += _sharp(row, void[a:b], nowhere)
            below = fill[i, j, a - 1 : a] if a > 0 else void[:1]
            jumps[2, a] += _sharp(row[:1], below, nowhere)
            _sharp(row[1:], row[:-1], jumps[2, a + 1 : b])
            if above[2]:
                jumps[2, nz] += _sharp(row[-1:], void[:1], nowhere)
            if len(bulk):
                for k in range(b - a):
                    histogram[row[k], bulk[i, j, a + k]] += 1
                continue
            none, every = 0, 0
            for k in range(b - a):  # no table is asked, so it is quick
                none += np.int64(row[k] == 0)
                every += np.int64(row[k] == 255)
            histogram[0, 0] += none
            histogram[255, 0] += every
            if none + every < b - a:
                for k in range(b - a):
                    if np.uint8(row[k] + 1) > 1:
                        histogram[row[k], 0] += 1


@kernel
def _pool(fill, phase, factor, first, last, row, out):
    """Raise the boxes ``first`` … ``last`` (not within) along x to the largest fill in them."""
    nx, ny, nz = fill.shape
    for a in range(first, last):
        for b in range(out.shape[1]):
            row[:] = 0
            for i in range(max(0, a * factor - phase[0]), min(nx, (a + 1) * factor - phase[0])):
                for j in range(max(0, b * factor - phase[1]), min(ny, (b + 1) * factor - phase[1])):
                    line = fill[i, j]
                    for k in range(nz):
                        row[k] = max(row[k], line[k])
            for c in range(out.shape[2]):
                largest = out[a, b, c]
                low = max(0, c * factor - phase[2])
                for k in range(low, min(nz, (c + 1) * factor - phase[2])):
                    largest = max(largest, row[k])
                out[a, b, c] = largest
