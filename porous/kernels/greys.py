"""Grey values of an image: how often each occurs, and flags put into another order of axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Flags = NDArray[np.bool_]

SLAB = 1 << 22
"""Values that one call counts, about."""

LINES = 4
"""Tables that values are counted in by turns, so that equal ones need not wait for each other."""

DEEP, WIDE = 64, 512
"""Voxels along z and x that are turned together: what a line and the first cache hold."""


def level_counts(values: NDArray[Any]) -> NDArray[np.int64]:
    """Return how often each number occurs.

    Parameters
    ----------
    values
        uint8 or uint16, shape (n,).

    Returns
    -------
    int64, shape (256,) or (65536,).
    """
    given = source(values, values.dtype)
    parts = -(-len(given) // SLAB)
    counts = np.zeros((max(parts, 1), LINES, 256**given.itemsize), np.int64)
    slabs(len(given), SLAB, lambda a, b: _count(given[a:b], counts[a // SLAB]))
    return np.asarray(counts.sum(axis=(0, 1)), np.int64)


def turned(choose: Callable[[NDArray[Any]], Flags], values: NDArray[Any]) -> Flags:
    """Return which values of an image are chosen, z fastest, where x is fastest in memory.

    Parameters
    ----------
    choose
        What is asked of a piece of the image, axes (z, y, x); called on all threads.
    values
        Shape (x, y, z), in any order of memory.

    Returns
    -------
    bool, shape (x, y, z), C order.
    """
    nx, ny, nz = values.shape
    out = np.empty(values.shape, np.bool_)
    there = out.view(np.uint8)
    rows = max(1, WIDE * DEEP // nx)

    def work(first: int, last: int) -> None:
        room = np.empty((min(nx, WIDE), DEEP), np.uint8)
        for row in range(0, ny, rows):
            piece = choose(values[:, row : row + rows, first:last].transpose(2, 1, 0))
            _turn(source(piece, np.bool_).view(np.uint8), row, first, room, there)

    slabs(nz, DEEP, work)
    return out


@kernel
def _count(values, counts):
    whole = len(values) // LINES * LINES
    for k in range(0, whole, LINES):
        counts[0, values[k]] += 1
        counts[1, values[k + 1]] += 1
        counts[2, values[k + 2]] += 1
        counts[3, values[k + 3]] += 1
    for k in range(whole, len(values)):
        counts[0, values[k]] += 1


@kernel
def _turn(piece, row, first, room, out):
    # Each line of memory is read and written as a whole: what is in between fits the first cache.
    deep, rows, wide = piece.shape
    for j in range(rows):
        for start in range(0, wide, WIDE):
            stop = min(start + WIDE, wide)
            for k in range(deep):
                line = piece[k, j]
                for i in range(start, stop):
                    room[i - start, k] = line[i]
            for i in range(start, stop):
                there, done = out[i, row + j], room[i - start]
                for k in range(deep):
                    there[first + k] = done[k]
