"""What a liquid at rest leaves behind: pores that cannot be left without rising.

Layers are added from below, and voids that touch are joined. A void of the layer at hand drains if
what it is joined with by then, which lies no higher, touches the outside; else it holds what is in
it for good, whatever comes above. So one pass finds the level of the lowest spill of every voxel.
Elements are spans of void.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.kernels.spans import Layers

CALL = 1 << 22
"""Voxels that one kernel call looks at, about."""

PORE, BEYOND = 1, 2
"""Kinds of void: of the body, and outside of it."""


def held(
    layers: Layers,
    connectivity: int,
    *,
    periodic: tuple[bool, bool] = (False, False),
    progress: Callable[[int, int], None] | None = None,
) -> NDArray[np.int64]:
    """Return how many pore voxels of each layer hold a liquid at rest that could leave upwards.

    Parameters
    ----------
    layers
        Spans of ``PORE`` and ``BEYOND``, the lowest layer first. From what lies beyond all flows
        off, and so it does from below, above and the sides without period.
    connectivity
        6 or 26: how voids are joined.
    periodic
        Whether layers close on themselves: across lines, and along them.
    progress
        Called as ``progress(done, count)`` in layers; raising in it cancels.

    Returns
    -------
    int64, shape (layers,). Pores that no way leads out of are not counted.
    """
    (_, _, offsets, spans, kinds), numbers = layers
    count, rows, length = numbers[:3].tolist()
    size, wide = max(1, CALL // (rows * length)), int(connectivity == 26)
    parent, marks = np.arange(len(spans), dtype=np.int32), np.zeros(len(spans), np.uint8)
    wraps = np.array(periodic, np.int64)
    for first in range(0, count, size):
        last = min(first + size, count)
        _rise(kinds, numbers, offsets, spans, wraps, wide, parent, marks, first, last)
        if progress is not None:
            progress(last, count)
    result = np.zeros(count, np.int64)
    _sum(numbers, offsets, spans, parent, marks, result)
    return result


@kernel
def _root(parent, a):
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    return a


@kernel
def _unite(parent, marks, a, b):
    if parent[a] == parent[b]:
        return
    a, b = _root(parent, a), _root(parent, b)
    if a > b:
        a, b = b, a
    parent[b] = a
    marks[a] |= marks[b] & 1


@kernel
def _meet(offsets, spans, parent, marks, a, b, nz, wraps, wide):
    # Join the touching runs of rows a and b; ``wide`` lets them touch at corners.
    p, q = offsets[a], offsets[b]
    p_end, q_end = offsets[a + 1], offsets[b + 1]
    if p == p_end or q == q_end:
        return
    if wraps and wide:
        if spans[p, 0] == 0 and spans[q_end - 1, 1] == nz:
            _unite(parent, marks, p, q_end - 1)
        if spans[q, 0] == 0 and spans[p_end - 1, 1] == nz:
            _unite(parent, marks, q, p_end - 1)
    while p < p_end and q < q_end:
        if spans[p, 0] < spans[q, 1] + wide and spans[q, 0] < spans[p, 1] + wide:
            _unite(parent, marks, p, q)
        if spans[p, 1] < spans[q, 1]:
            p += 1
        else:
            q += 1


@kernel
def _rise(kinds, numbers, offsets, spans, wraps, wide, parent, marks, first, last):
    # Marks of a run: 1 joined with the outside (at its root), 2 holds what is in it.
    layers, ny, nz, start, up, beside = numbers
    for i in range(first, last):
        low = start + i * up
        for j in range(ny):
            row = low + j * beside
            side = i == 0 or (not wraps[0] and (j == 0 or j == ny - 1))
            for r in range(offsets[row], offsets[row + 1]):
                edge = not wraps[1] and (spans[r, 0] == 0 or spans[r, 1] == nz)
                if side or edge or kinds[r] == BEYOND:
                    marks[r] = 1
        for j in range(ny):
            row = low + j * beside
            for r in range(offsets[row], offsets[row + 1] - 1):
                if spans[r, 1] == spans[r + 1, 0]:
                    _unite(parent, marks, r, r + 1)
            if wraps[1] and offsets[row] < offsets[row + 1]:
                p, q = offsets[row], offsets[row + 1] - 1
                if spans[p, 0] == 0 and spans[q, 1] == nz:
                    _unite(parent, marks, p, q)
            if j or wraps[0]:
                other = row - beside if j else row + (ny - 1) * beside
                _meet(offsets, spans, parent, marks, row, other, nz, wraps[1], wide)
            if i == 0:
                continue
            for step in range(-wide, wide + 1):
                y = j + step
                if wraps[0]:
                    y %= ny
                if 0 <= y < ny:
                    other = low - up + y * beside
                    _meet(offsets, spans, parent, marks, row, other, nz, wraps[1], wide)
        for j in range(ny):
            row = low + j * beside
            for r in range(offsets[row], offsets[row + 1]):
                if marks[_root(parent, r)] & 1 == 0:
                    marks[r] |= 2
        for j in range(ny if i == layers - 1 else 0):
            row = low + j * beside
            for r in range(offsets[row], offsets[row + 1]):
                marks[_root(parent, r)] |= 1


@kernel
def _sum(numbers, offsets, spans, parent, marks, result):
    for i in range(numbers[0]):
        for j in range(numbers[1]):
            row = numbers[3] + i * numbers[4] + j * numbers[5]
            for r in range(offsets[row], offsets[row + 1]):
                if marks[r] & 2 and marks[_root(parent, r)] & 1:
                    result[i] += spans[r, 1] - spans[r, 0]
