"""Boxes that glide over a grid voxel by voxel: how much each holds, by sums over corners."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Axes = tuple[bool, bool, bool]
    Progress = Callable[[int, int], None]

SLAB = 1 << 20
"""Boxes of one call, about: some milliseconds."""

_NOTHING = np.zeros((0, 0, 0), np.int32)


def corner_sums(mask: NDArray[np.bool_], periodic: Axes, longest: int) -> NDArray[np.int32]:
    """Return how many set voxels lie below each corner of the lattice (F. C. Crow 1984).

    Parameters
    ----------
    mask
        bool, shape (x, y, z).
    periodic
        Axes along which the grid goes on in copies of itself, for boxes up to ``longest`` voxels.

    Returns
    -------
    int32, one more than there are voxels along each axis, and ``longest`` − 1 more than that along
    periodic axes.
    """
    more = [(0, longest - 1 if wraps else 0) for wraps in periodic]
    given = np.pad(mask, more, mode="wrap") if any(periodic) else mask
    sums = np.zeros([n + 1 for n in given.shape], np.int32)
    np.cumsum(given, axis=2, dtype=np.int32, out=sums[1:, 1:, 1:])
    for axis in (1, 0):
        np.cumsum(sums, axis=axis, dtype=np.int32, out=sums)
    return sums


def gliding_moments(
    sums: NDArray[np.int32],
    bulk: NDArray[np.int32] | None,
    places: tuple[int, int, int],
    size: int,
    progress: Progress | None = None,
) -> tuple[int, float, float]:
    """Return how many boxes of a size there are, the sum of what they hold, and of its squares.

    Parameters
    ----------
    sums
        What ``corner_sums`` found, of what is held.
    bulk
        The same of what a box has to lie in as a whole; None where it may lie anywhere.
    places
        From how many voxels along each axis a box begins.
    size
        Edge of the boxes in voxels.
    progress
        Called as ``progress(done, count)`` in planes of boxes along x.
    """
    given = source(sums, np.int32)
    within = source(_NOTHING if bulk is None else bulk, np.int32)
    planes = np.zeros((places[0], 3))

    def work(start: int, stop: int) -> None:
        _moments(given, within, size, start, stop, places[1], places[2], planes)

    slabs(places[0], max(1, SLAB // (places[1] * places[2])), work, progress)
    count, first, second = planes.sum(axis=0).tolist()
    return int(count), first, second


@kernel
def _held(sums, i, j, k, size):
    low, high = sums[i], sums[i + size]
    above = high[j + size, k + size] - high[j + size, k] - high[j, k + size] + high[j, k]
    return above - low[j + size, k + size] + low[j + size, k] + low[j, k + size] - low[j, k]


@kernel
def _moments(sums, bulk, size, start, stop, ny, nz, planes):
    whole = np.int64(size) ** 3
    for i in range(start, stop):
        count, first, second = 0, 0.0, 0.0
        for j in range(ny):
            for k in range(nz):
                if len(bulk) and _held(bulk, i, j, k, size) < whole:
                    continue
                held = np.float64(_held(sums, i, j, k, size))
                count += 1
                first += held
                second += held * held
        planes[i, 0], planes[i, 1], planes[i, 2] = count, first, second
