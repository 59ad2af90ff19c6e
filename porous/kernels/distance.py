"""Exact Euclidean distances of the voxels of a mask to the nearest voxel outside of it.

Rows first, then the lower envelope of parabolas along each line of both other axes. Where that is
near, it is looked for step by step, of many lines at a time; where it is not, by where parabolas
cross (P. F. Felzenszwalb, D. P. Huttenlocher, Theory of Computing 8, 2012).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Axes = tuple[bool, bool, bool]
    Progress = Callable[[int, int], None]
    Numbers = NDArray[np.uint16] | NDArray[np.int32] | NDArray[np.float64]

SLAB = 1 << 21
"""Voxels that one kernel call looks at, about."""

FAR = 1 << 30
"""The square where there is nothing to be far from; squares of whole numbers stay below it."""

WIDE = 64
"""Lines that are looked at together."""

NEAR = 48
"""How far, in voxels, one looks step by step."""

STEPS = 4
"""Steps between two looks at whether it is enough."""

NOWHERE = 1 << 24
"""More voxels than an edge has."""


class Squares(NamedTuple):
    """Squared distances in units of ``step``, the shortest edge of a voxel.

    ``values`` are whole numbers where the ratios of the edges have whole squares (cubes have),
    uint16 where these fit and else int32; otherwise they are float64. They are 0 outside of the
    mask, and ``FAR`` or more where nothing lies outside of it. A vector (i, j, k) of voxels has the
    square ``weights`` · (i², j², k²).
    """

    values: Numbers
    weights: NDArray[np.float64]
    step: float


def squared_distances(
    mask: NDArray[np.bool_],
    spacing: tuple[float, float, float],
    *,
    periodic: Axes = (False, False, False),
    walled: bool = False,
    progress: Progress | None = None,
) -> Squares:
    """Return how far each voxel of a mask is from those outside of it, from centre to centre.

    Parameters
    ----------
    mask
        bool, shape (x, y, z).
    spacing
        Edges of a voxel.
    periodic
        Axes along which the grid closes on itself.
    walled
        Whether voxels beyond the sides of other axes count as outside of the mask; else as
        nothing.
    progress
        Called as ``progress(done, count)``; raising in it cancels.

    Returns
    -------
    Squares
    """
    step = min(spacing)
    weights = (np.array(spacing) / step) ** 2
    whole = np.rint(weights)
    # Along a walled or a periodic axis no source lies farther than the edge.
    reach = float(weights @ np.add(mask.shape, 1.0) ** 2)
    exact = bool(np.allclose(weights, whole, rtol=1e-12, atol=0)) and reach < FAR
    weights = whole if exact else weights
    far = float(max(FAR, 2 * reach))
    if (walled and not all(periodic)) or not mask.all():
        for dtype in (np.uint16, np.int32) if exact else (np.float64,):
            top = float(np.iinfo(dtype.__name__).max) if exact else math.inf
            values = np.empty(mask.shape, dtype)
            ends = [1 if wraps else 2 * int(walled) for wraps in periodic]
            if _transform(mask, weights, ends, (min(far, top), top), values, progress):
                return Squares(values, weights, step)
    return Squares(np.full(mask.shape, far, np.int32 if exact else np.float64), weights, step)


def _transform(
    mask: NDArray[np.bool_],
    weights: NDArray[np.float64],
    ends: list[int],
    limits: tuple[float, float],
    result: Numbers,
    progress: Progress | None,
) -> bool:
    """Set squared distances; tell whether all are below the first limit, if it is the second."""
    given, flat = source(mask, np.bool_).view(np.uint8), result.reshape(-1)
    x, y, z = mask.shape
    total = 2 * x + y
    largest: list[float] = []

    def told(before: int) -> Progress | None:
        return None if progress is None else lambda done, _: progress(before + done, total)

    def rows(a: int, b: int) -> None:
        _rows(given, weights[2], ends[2], limits[0], result, a, b)

    def along_y(a: int, b: int) -> None:
        _lines(flat, (y, z), (y * z, z), (weights[1], *limits), ends[1], a, b)

    def along_x(a: int, b: int) -> None:
        most = _lines(flat, (x, z), (z, y * z), (weights[0], *limits), ends[0], a, b)
        largest.append(float(most))

    slabs(x, max(1, SLAB // (y * z)), rows, told(0))
    slabs(x, max(1, SLAB // (y * z)), along_y, told(x))
    slabs(y, max(1, SLAB // (x * z)), along_x, told(2 * x))
    return max(largest) < limits[1]


@kernel
def _rows(mask, weight, ends, far, out, first, last):
    n = mask.shape[2]
    away = np.zeros(n, np.int32)
    for i in range(first, last):
        for j in range(mask.shape[1]):
            below = above = NOWHERE if ends == 0 else 0
            if ends == 1:
                below = above = NOWHERE
                for k in range(n):
                    if mask[i, j, k] == 0:
                        below = n - 1 - k
                        above = min(above, k)
            for k in range(n):
                below = min(below + 1, NOWHERE) if mask[i, j, k] != 0 else 0
                away[k] = below
            for k in range(n - 1, -1, -1):
                above = min(above + 1, np.int64(away[k]))
                out[i, j, k] = far if above == NOWHERE else min(far, above * above * weight)


@kernel
def _lines(flat, counts, strides, scale, ends, first, last):
    # Lines of counts[0] voxels; counts[1] of them lie side by side. Beyond the line's own voxels
    # there are sources: its own again (ends 1), or one at each end (ends 2). Return the largest
    # square; none rises above scale[2].
    n, side = counts
    weight, far, _ = scale
    most = 0.0
    around = np.empty((n + 2 * NEAR) * WIDE, flat.dtype)
    best = np.empty(WIDE, flat.dtype)
    for outer in range(first, last):
        for k in range(0, side, WIDE):
            place = (outer * strides[0] + k, strides[1], min(WIDE, side - k))
            _fetch(flat, place, n, far, ends, around)
            largest = -1.0
            if weight * NEAR * NEAR < far:
                largest = _look(flat, place, n, scale, around, best)
            if largest < 0.0:
                largest = _envelopes(flat, place, n, scale, ends, around)
            most = max(most, largest)
    return most


@kernel
def _fetch(flat, place, n, far, ends, around):
    # Lines side by side, and what lies beyond their ends.
    base, stride, wide = place
    for p in range(-NEAR, n + NEAR):
        to = np.uint64((p + NEAR) * WIDE)
        if 0 <= p < n or ends == 1:
            at = np.uint64(base + p % n * stride)
            for c in range(wide):
                around[to + np.uint64(c)] = flat[at + np.uint64(c)]
        else:
            value = flat.dtype.type(0 if ends == 2 and -1 <= p <= n else far)
            for c in range(wide):
                around[to + np.uint64(c)] = value
        for c in range(wide, WIDE):
            around[to + np.uint64(c)] = 0


@kernel
def _look(flat, place, n, scale, around, best):
    # Step by step from each voxel; return the largest, or -1 where that was not enough. Loops
    # without a way out are those that are done for many lines at once.
    base, stride, wide = place
    weight, _, top = scale
    enough, largest = True, flat.dtype.type(0)
    for p in range(n):
        here = np.uint64((p + NEAR) * WIDE)
        most = flat.dtype.type(0)
        for c in range(WIDE):
            best[c] = around[here + np.uint64(c)]
            most = max(most, best[c])
        step = 1
        while enough and step <= NEAR and weight * step * step < most:
            for ahead in range(step, step + STEPS):
                low, high = here - np.uint64(ahead * WIDE), here + np.uint64(ahead * WIDE)
                rise = flat.dtype.type(min(weight * ahead * ahead, top))
                most = flat.dtype.type(top - rise)
                for c in range(WIDE):
                    near = min(around[low + np.uint64(c)], around[high + np.uint64(c)], most)
                    best[c] = min(best[c], flat.dtype.type(near + rise))
            most = flat.dtype.type(0)
            for c in range(WIDE):
                most = max(most, best[c])
            step += STEPS
        enough &= weight * step * step >= most
        largest = max(largest, most)
        at = np.uint64(base + p * stride)
        for c in range(wide):
            flat[at + np.uint64(c)] = best[c]
    return np.float64(largest) if enough else -1.0


@kernel
def _envelopes(flat, place, n, scale, ends, around):
    # Where parabolas cross, line by line.
    base, stride, wide = place
    weight, far, limit = scale
    pad, largest = 0, 0.0
    if ends == 1:
        pad = n // 2
    if ends == 2:
        pad = 1
    length = n + 2 * pad
    line = np.empty(length, np.float64)
    hull = np.empty(length + 1, np.int64)
    bounds = np.empty(length + 1, np.float64)
    halves = np.empty(length + 1, np.float64)
    for q in range(1, length + 1):
        halves[q] = 0.5 / (weight * q)
    for c in range(wide):
        for p in range(n):
            line[p + pad] = around[(p + NEAR) * WIDE + c]
        if ends == 2:
            line[0], line[n + 1] = 0.0, 0.0
        if ends == 1:
            for p in range(pad):
                line[p] = line[n + p]
                line[n + pad + p] = line[pad + p]
        top = -1
        for q in range(length):
            height = line[q]
            if height >= far:
                continue
            crossing = -np.inf
            while top >= 0:
                v = hull[top]
                crossing = 0.5 * (q + v) + (height - line[v]) * halves[q - v]
                if crossing > bounds[top]:
                    break
                top -= 1
            if top < 0:
                crossing = -np.inf
            top += 1
            hull[top], bounds[top] = q, crossing
        at, v = base + c, 0
        if top >= 0:
            bounds[top + 1] = np.inf
        for p in range(n):
            square = line[p + pad]
            if top >= 0:
                while bounds[v + 1] < p + pad:
                    v += 1
                gap = p + pad - hull[v]
                square = min(line[hull[v]] + weight * gap * gap, limit)
            flat[at] = square
            largest = max(largest, square)
            at += stride
    return largest
