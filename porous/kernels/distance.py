"""Exact Euclidean distances of the voxels of a mask to the nearest voxel outside of it.

Rows first, then one lower envelope of parabolas per line and axis (P. F. Felzenszwalb,
D. P. Huttenlocher, Theory of Computing 8, 2012), of sixteen lines at a time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Axes = tuple[bool, bool, bool]
    Progress = Callable[[int, int], None]
    Numbers = NDArray[np.int32] | NDArray[np.float64]

SLAB = 1 << 21
"""Voxels that one kernel call looks at, about."""

FAR = 1 << 30
"""The square where there is nothing to be far from; squares of whole numbers stay below it."""

WIDE = 16
"""Lines that are fetched together: what one line of a cache holds of them."""


class Squares(NamedTuple):
    """Squared distances in units of ``step``, the shortest edge of a voxel.

    ``values`` are int32 where the ratios of the edges have whole squares (cubes have), else
    float64; 0 outside of the mask, and ``FAR`` or more where nothing lies outside of it. A vector
    (i, j, k) of voxels has the square ``weights`` · (i², j², k²).
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
    result = np.empty(mask.shape, np.int32 if exact else np.float64)
    given, flat = source(mask, np.bool_).view(np.uint8), result.reshape(-1)
    x, y, z = mask.shape
    far = float(max(FAR, 2 * reach))
    ends = [1 if wraps else 2 * int(walled) for wraps in periodic]
    total = 2 * x + y

    def told(before: int) -> Progress | None:
        return None if progress is None else lambda done, _: progress(before + done, total)

    def rows(a: int, b: int) -> None:
        _rows(given, weights[2], ends[2], far, result, a, b)

    def along_y(a: int, b: int) -> None:
        _envelopes(flat, (y, z), (y * z, z), (weights[1], far), ends[1], a, b)

    def along_x(a: int, b: int) -> None:
        _envelopes(flat, (x, z), (z, y * z), (weights[0], far), ends[0], a, b)

    slabs(x, max(1, SLAB // (y * z)), rows, told(0))
    slabs(x, max(1, SLAB // (y * z)), along_y, told(x))
    slabs(y, max(1, SLAB // (x * z)), along_x, told(2 * x))
    return Squares(result, weights, step)


@kernel
def _rows(mask, weight, ends, far, out, first, last):
    n = mask.shape[2]
    for i in range(first, last):
        for j in range(mask.shape[1]):
            below, above = -far, far
            if ends == 2:
                below, above = -1.0, np.float64(n)
            if ends == 1:
                for k in range(n):
                    if mask[i, j, k] == 0:
                        below = np.float64(k - n)
                        if above == far:
                            above = np.float64(k + n)
            for k in range(n):
                if mask[i, j, k] == 0:
                    below = np.float64(k)
                out[i, j, k] = min(k - below, 16777216.0)
            for k in range(n - 1, -1, -1):
                if mask[i, j, k] == 0:
                    above = np.float64(k)
                near = min(np.float64(out[i, j, k]), above - k)
                out[i, j, k] = far if near >= 16777216.0 else near * near * weight


@kernel
def _envelopes(flat, counts, strides, scale, ends, first, last):
    # Lines of counts[0] voxels; counts[1] of them lie side by side. Beyond the line's own voxels
    # there are sources: its own again (ends 1), or one at each end (ends 2).
    n, side = counts
    weight, far = scale
    pad = 0
    if ends == 1:
        pad = n // 2
    if ends == 2:
        pad = 1
    length = n + 2 * pad
    heights = np.empty((WIDE, length), np.float64)
    hull = np.empty(length + 1, np.int64)
    bounds = np.empty(length + 1, np.float64)
    halves = np.empty(length + 1, np.float64)
    for q in range(1, length + 1):
        halves[q] = 0.5 / (weight * q)
    for outer in range(first, last):
        for k in range(0, side, WIDE):
            wide = min(WIDE, side - k)
            base = outer * strides[0] + k
            for p in range(n):
                at = base + p * strides[1]
                for c in range(wide):
                    heights[c, p + pad] = flat[at + c]
            for c in range(wide):
                line = heights[c]
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
                    place = -np.inf
                    while top >= 0:
                        v = hull[top]
                        rise = height - line[v]
                        place = 0.5 * (q + v) + rise * halves[q - v]
                        if place > bounds[top]:
                            break
                        top -= 1
                    if top < 0:
                        place = -np.inf
                    top += 1
                    hull[top], bounds[top] = q, place
                if top < 0:
                    continue
                bounds[top + 1] = np.inf
                at, v = base + c, 0
                for p in range(n):
                    while bounds[v + 1] < p + pad:
                        v += 1
                    gap = p + pad - hull[v]
                    flat[at] = line[hull[v]] + weight * gap * gap
                    at += strides[1]
