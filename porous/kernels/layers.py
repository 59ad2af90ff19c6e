"""Bodies that grow layer by layer: what of a layer hangs in the air while it is printed.

Runs of a layer that share faces are joined in a forest; what lies below each piece, or as near to
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

CALL = 1 << 22
"""Voxels that one kernel call looks at, about."""


def hanging(
    solid: NDArray[np.bool_],
    reach: NDArray[np.int64],
    *,
    periodic: tuple[bool, bool] = (False, False),
    progress: Callable[[int, int], None] | None = None,
) -> NDArray[np.int64]:
    """Return what hangs in the air, layer by layer, while a body is built upwards.

    Parameters
    ----------
    solid
        bool, shape (layers, y, z), the lowest layer first.
    reach
        int64, shape (n, 2): steps, in voxels, from below a voxel to where something may carry it;
        (0, 0) among them.
    periodic
        Whether layers close on themselves, along y and z.
    progress
        Called as ``progress(done, count)`` in layers; raising in it cancels.

    Returns
    -------
    int64, shape (layers, 3): islands, which are pieces of a layer (joined by edges of pixels) with
    nothing within reach below; their voxels; and the voxels of all pieces that stand on nothing
    but islands. The first layer with a solid voxel stands on the plate.
    """
    layers, ny, nz = solid.shape
    given, steps = source(solid, np.bool_).view(np.uint8), source(reach, np.int64)
    most = ny * (nz // 2 + 1)
    rows = np.zeros(ny + 1, np.int64)
    runs = np.zeros((most, 4), np.int32)
    below, state = np.zeros((ny, nz), np.uint8), np.zeros(1, np.int64)
    wraps = np.array(periodic, np.int64)
    result = np.zeros((layers, 3), np.int64)
    size = max(1, CALL // (ny * nz))
    for first in range(0, layers, size):
        last = min(first + size, layers)
        _rise(given, steps, wraps, below, state, rows, runs, result, first, last)
        if progress is not None:
            progress(last, layers)
    return result


@kernel
def _root(runs, a):
    while runs[a, 2] != a:
        runs[a, 2] = runs[runs[a, 2], 2]
        a = runs[a, 2]
    return a


@kernel
def _unite(runs, a, b):
    a, b = _root(runs, a), _root(runs, b)
    if a < b:
        runs[b, 2] = a
    else:
        runs[a, 2] = b


@kernel
def _pieces(layer, wraps, rows, runs):
    # Runs of a layer: first voxel, end, parent in the forest of pieces, what is below (bits).
    ny, nz = layer.shape
    n = 0
    for j in range(ny):
        rows[j] = n
        before = 0
        for k in range(nz):
            now = layer[j, k]
            if now and not before:
                runs[n, 0], runs[n, 2], runs[n, 3] = k, n, 0
            if before and not now:
                runs[n, 1] = k
                n += 1
            before = now
        if before:
            runs[n, 1] = nz
            n += 1
    rows[ny] = n
    for j in range(ny):
        if wraps[1] and rows[j] < rows[j + 1]:
            p, q = rows[j], rows[j + 1] - 1
            if runs[p, 0] == 0 and runs[q, 1] == nz:
                _unite(runs, p, q)
        if j == 0 and not wraps[0]:
            continue
        other = j - 1 if j else ny - 1
        p, q = rows[j], rows[other]
        while p < rows[j + 1] and q < rows[other + 1]:
            if runs[p, 0] < runs[q, 1] and runs[q, 0] < runs[p, 1]:
                _unite(runs, p, q)
            if runs[p, 1] < runs[q, 1]:
                p += 1
            else:
                q += 1
    return n


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
def _rise(solid, reach, wraps, below, state, rows, runs, result, first, last):
    ny = solid.shape[1]
    for i in range(first, last):
        count = _pieces(solid[i], wraps, rows, runs)
        plate = state[0] == 0
        if count:
            state[0] = 1
        for j in range(ny):
            for r in range(rows[j], rows[j + 1]):
                root = _root(runs, r)
                if plate:
                    runs[root, 3] = 3
                elif runs[root, 3] != 3:
                    runs[root, 3] |= _carried(below, reach, wraps, j, runs[r, 0], runs[r, 1])
        below[:] = 0
        for j in range(ny):
            for r in range(rows[j], rows[j + 1]):
                root = _root(runs, r)
                length = runs[r, 1] - runs[r, 0]
                if runs[root, 3] == 0:
                    result[i, 0] += root == r
                    result[i, 1] += length
                if runs[root, 3] != 3:
                    result[i, 2] += length
                for k in range(runs[r, 0], runs[r, 1]):
                    below[j, k] = 3 if runs[root, 3] == 3 else 1
