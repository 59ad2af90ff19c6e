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
    held, planes = source(given, np.bool_).view(np.uint8), max(1, SLAB // given[0].size)
    for a in range(0, len(given), planes):
        _sum(held, sums, a, min(a + planes, len(given)))
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
    # Sums of squares that are whole numbers of 64 bits at most.
    most = max(1, (1 << 62) // size**6 // places[2])

    def work(start: int, stop: int) -> None:
        _moments(given, within, size, most, start, stop, places[1], places[2], planes)

    slabs(places[0], max(1, SLAB // (places[1] * places[2])), work, progress)
    count, first, second = planes.sum(axis=0).tolist()
    return int(count), first, second


@kernel
def _sum(mask, sums, first, last):
    _, ny, nz = mask.shape
    level = np.zeros(nz, np.int32)
    for i in range(first, last):
        level[:] = 0
        for j in range(ny):
            own, held = mask[i, j], 0
            for k in range(nz):
                held += own[k]
                level[k] += held
            below, out = sums[i, j + 1, 1:], sums[i + 1, j + 1, 1:]
            for k in range(nz):
                out[k] = below[k] + level[k]


@kernel
def _held(sums, i, j, size, beam, held):
    # What the boxes of a row hold, by sums over the beam that they glide along.
    low, high = sums[i], sums[i + size]
    a, b, c, d = high[j + size], high[j], low[j + size], low[j]
    for k in range(len(beam)):
        beam[k] = a[k] - b[k] - c[k] + d[k]
    ahead = beam[size:]
    for k in range(len(held)):
        held[k] = ahead[k] - beam[k]


@kernel
def _moments(sums, bulk, size, most, start, stop, ny, nz, planes):
    whole = np.int64(size) ** 3
    beam, held, full = np.empty(nz + size, np.int32), np.empty(nz, np.int32), np.empty(nz, np.int32)
    for i in range(start, stop):
        count, first, second = 0, np.int64(0), np.int64(0)
        planes[i] = 0.0
        for j in range(ny):
            count += nz
            if len(bulk):
                _held(bulk, i, j, size, beam, full)
            _held(sums, i, j, size, beam, held)
            if len(bulk):
                for k in range(nz):
                    count -= full[k] < whole
                    held[k] = 0 if full[k] < whole else held[k]
            for k in range(nz):
                first += held[k]
                second += np.int64(held[k]) * held[k]
            if (j + 1) % most == 0:
                planes[i, 2] += second
                second = np.int64(0)
        planes[i, 0], planes[i, 1] = count, first
        planes[i, 2] += second
