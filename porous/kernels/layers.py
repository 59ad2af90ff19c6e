"""Bodies that grow layer by layer: what of a layer hangs in the air while it is printed.

Spans of a layer that share faces are joined in a forest; what lies below each piece, or as near to
that as ``reach`` says, tells whether it stands on something. The state between two layers is one
layer, so that work may stop and go on between any two.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.kernels.spans import Layers

CALL = 1 << 22
"""Voxels that one kernel call looks at, about."""


def hanging(
    layers: Layers,
    reach: NDArray[np.int64],
    *,
    periodic: tuple[bool, bool] = (False, False),
    progress: Callable[[int, int], None] | None = None,
) -> NDArray[np.int64]:
    """Return what hangs in the air, layer by layer, while a body is built upwards.

    Parameters
    ----------
    layers
        Spans of solid, the lowest layer first.
    reach
        int64, shape (n, 2): steps, in voxels, from below a voxel to where something may carry it,
        across lines and along them; (0, 0) among them.
    periodic
        Whether layers close on themselves: across lines, and along them.
    progress
        Called as ``progress(done, count)`` in layers; raising in it cancels.

    Returns
    -------
    int64, shape (layers, 3): islands, which are pieces of a layer (joined by edges of pixels) with
    nothing within reach below; their voxels; and the voxels of all pieces that stand on nothing
    but islands. The first layer with a solid voxel stands on the plate.
    """
    (_, _, offsets, spans, _), numbers = layers
    count, rows, length = numbers[:3].tolist()
    steps, wraps = source(reach, np.int64), np.array(periodic, np.int64)
    below, state = np.zeros((rows, length), np.uint8), np.zeros(1, np.int64)
    forest = np.arange(len(spans), dtype=np.int32), np.zeros(len(spans), np.uint8)
    result, size = np.zeros((count, 3), np.int64), max(1, CALL // (rows * length))
    for first in range(0, count, size):
        last = min(first + size, count)
        _rise(numbers, offsets, spans, steps, wraps, below, state, forest, result, first, last)
        if progress is not None:
            progress(last, count)
    return result


@kernel
def _root(parent, a):
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    return a


@kernel
def _unite(parent, a, b):
    a, b = _root(parent, a), _root(parent, b)
    parent[max(a, b)] = min(a, b)


@kernel
def _join(numbers, offsets, spans, wraps, low, parent):
    # Join the spans of a layer, whose first line is ``low``, that touch.
    ny, nz, beside = numbers[1], numbers[2], numbers[5]
    for j in range(ny):
        row = low + j * beside
        if wraps[1] and offsets[row] < offsets[row + 1]:
            p, q = offsets[row], offsets[row + 1] - 1
            if spans[p, 0] == 0 and spans[q, 1] == nz:
                _unite(parent, p, q)
        if j == 0 and not wraps[0]:
            continue
        other = row - beside if j else row + (ny - 1) * beside
        p, q = offsets[row], offsets[other]
        while p < offsets[row + 1] and q < offsets[other + 1]:
            if spans[p, 0] < spans[q, 1] and spans[q, 0] < spans[p, 1]:
                _unite(parent, p, q)
            if spans[p, 1] < spans[q, 1]:
                p += 1
            else:
                q += 1


@kernel
def _carried(below, reach, wraps, j, start, stop):
    # What is within reach below voxels start … stop of a row: 1 for solid, 2 if it stands.
    ny, nz = below.shape
    found = 0
    for s in range(len(reach)):
        y, shift = j + reach[s, 0], reach[s, 1]
        if wraps[0]:
            y %= ny
        if y < 0 or y >= ny:
            continue
        for k in range(start, stop):
            z = k + shift
            if wraps[1]:
                z %= nz
            if 0 <= z < nz:
                found |= below[y, z]
                if found == 3:
                    return found
    return found


@kernel
def _rise(numbers, offsets, spans, reach, wraps, below, state, forest, result, first, last):
    # What is found below a piece, at its root: 1 for solid, 2 if it stands.
    parent, found = forest
    ny, beside = numbers[1], numbers[5]
    for i in range(first, last):
        low = numbers[3] + i * numbers[4]
        _join(numbers, offsets, spans, wraps, low, parent)
        plate = state[0] == 0
        for j in range(ny):
            row = low + j * beside
            for r in range(offsets[row], offsets[row + 1]):
                state[0], root = 1, _root(parent, r)
                if plate:
                    found[root] = 3
                elif found[root] != 3:
                    found[root] |= _carried(below, reach, wraps, j, spans[r, 0], spans[r, 1])
        below[:] = 0
        for j in range(ny):
            row = low + j * beside
            for r in range(offsets[row], offsets[row + 1]):
                root, length = _root(parent, r), spans[r, 1] - spans[r, 0]
                if found[root] == 0:
                    result[i, 0] += root == r
                    result[i, 1] += length
                if found[root] != 3:
                    result[i, 2] += length
                below[j, spans[r, 0] : spans[r, 1]] = 3 if found[root] == 3 else 1
