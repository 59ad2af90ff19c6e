"""Spans of one kind along the lines of a grid, and the layers that a body is built of from them.

Layers across any axis are made of the lines along another one, from either end, so that nothing is
copied to look at a body from another side.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

SLAB = 1 << 21
"""Voxels that one kernel call looks at, about."""


class Spans(NamedTuple):
    """Spans along the last axis of a grid, or along the one before it.

    Parameters
    ----------
    shape
        Of the grid.
    along
        2 or 1. Lines are numbered in the order of the other two axes.
    offsets
        int64, one more than there are lines: where the spans of each begin.
    ends
        int32, shape (n, 2): first voxel of a span, and the one after its last.
    kinds
        uint8, shape (n,): of which kind it is.
    """

    shape: tuple[int, int, int]
    along: int
    offsets: NDArray[np.int64]
    ends: NDArray[np.int32]
    kinds: NDArray[np.uint8]

    def layers(self, axis: int, *, up: bool = True) -> Layers:
        """Return the spans as layers across an axis that is not ``along``, its first one first."""
        order = [a for a in range(3) if a != self.along]
        across = order[1 - order.index(axis)]
        step, beside = (self.shape[order[1]], 1) if axis == order[0] else (1, self.shape[order[1]])
        count = self.shape[axis]
        first, step = (0, step) if up else ((count - 1) * step, -step)
        numbers = np.array(
            [count, self.shape[across], self.shape[self.along], first, step, beside], np.int64
        )
        return Layers(self, numbers)


class Layers(NamedTuple):
    """Spans, layer by layer.

    ``numbers``, int64: how many layers there are, lines of a layer, and voxels of a line; and the
    number of the first line, of one in the next layer less that, and of the next line less that.
    """

    spans: Spans
    numbers: NDArray[np.int64]


def spans(kinds: NDArray[np.uint8], along: int = 2) -> Spans:
    """Return the spans of one kind along an axis of a grid.

    Parameters
    ----------
    kinds
        uint8, shape (x, y, z): 0 for what is in no span.
    along
        The axis, 2 or 1.
    """
    given, (x, y, z) = source(kinds, np.uint8), kinds.shape
    scan, lines = (_scan, y) if along == 2 else (_scan_across, z)
    size = max(1, SLAB // max(1, y * z))
    offsets = np.zeros(x * lines + 1, np.int64)
    ends, told = np.zeros((0, 2), np.int32), np.zeros(0, np.uint8)
    slabs(x, size, lambda a, b: scan(given, offsets, ends, told, a, b))
    np.cumsum(offsets, out=offsets)
    if offsets[-1]:
        ends, told = np.empty((offsets[-1], 2), np.int32), np.empty(offsets[-1], np.uint8)
        slabs(x, size, lambda a, b: scan(given, offsets, ends, told, a, b))
    return Spans((x, y, z), along, offsets, ends, told)


@kernel
def _scan(kinds, offsets, ends, told, first, last):
    # Count the spans of each line along z, or write them where there is room.
    _, ny, nz = kinds.shape
    write = len(ends) > 0
    for i in range(first, last):
        for j in range(ny):
            span = offsets[i * ny + j] if write else 0
            before = 0
            for k in range(nz + 1):
                now = np.int64(kinds[i, j, k]) if k < nz else 0
                if now == before:
                    continue
                if before:
                    if write:
                        ends[span, 1] = k
                    span += 1
                if now and write:
                    ends[span, 0], told[span] = k, now
                before = now
            if not write:
                offsets[i * ny + j + 1] = span


@kernel
def _scan_across(kinds, offsets, ends, told, first, last):
    # The same along y, all lines of a plane at a time.
    _, ny, nz = kinds.shape
    write = len(ends) > 0
    place, none = np.zeros(nz, np.int64), np.zeros(nz, np.uint8)
    for i in range(first, last):
        place[:] = 0
        if write:
            place[:] = offsets[i * nz : (i + 1) * nz]
        for j in range(ny + 1):
            before, now = kinds[i, j - 1] if j else none, kinds[i, j] if j < ny else none
            for k in range(nz):
                if now[k] == before[k]:
                    continue
                if before[k]:
                    if write:
                        ends[place[k], 1] = j
                    place[k] += 1
                if now[k] and write:
                    ends[place[k], 0], told[place[k]] = j, now[k]
        if not write:
            offsets[i * nz + 1 : (i + 1) * nz + 1] = place
