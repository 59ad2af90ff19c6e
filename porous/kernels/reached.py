"""The union of balls about voxels, each as large as it is given, exactly on the lattice.

A voxel is held where |v − p|² < r(p)² for some centre p: where the lower envelope of paraboloids
of height −r² is below zero. Envelopes are taken axis by axis (T. Saito, J. Toriwaki, Pattern
Recognition 27, 1994; P. F. Felzenszwalb, D. P. Huttenlocher, Theory of Computing 8, 2012).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, slabs

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Axes = tuple[bool, bool, bool]

CALL = 1 << 20
"""Voxels that one kernel call looks at, about."""

WIDE = 16
"""Lines that are fetched together: what one line of a cache holds of them."""

SLACK = 1e-6
"""Part of a squared radius by which balls are drawn in, so that rounding joins no voxel to them."""


def held_by_balls(
    squares: NDArray[np.float32],
    weights: NDArray[np.float64],
    *,
    periodic: Axes = (False, False, False),
    progress: Callable[[int, int], None] | None = None,
) -> NDArray[np.bool_]:
    """Return the voxels that any of many balls holds.

    Parameters
    ----------
    squares
        float32, shape (x, y, z): squared radius of the ball about each voxel, 0 for none. It is
        overwritten.
    weights
        float64, shape (3,): squared edges of a voxel, in the same unit. A ball holds the voxels
        whose centres are nearer than its radius.
    periodic
        Axes along which the grid closes on itself.
    progress
        Called as ``progress(done, count)``; raising in it cancels.

    Returns
    -------
    bool, shape (x, y, z).
    """
    x, y, z = squares.shape
    np.multiply(squares, SLACK - 1, out=squares)
    flat = squares.reshape(-1)
    # Lines along z, y and x: how many slabs of them there are, how many in one, and strides.
    plans = (
        (2, x, (z, y), (y * z, z, 1)),
        (1, x, (y, z), (y * z, 1, z)),
        (0, y, (x, z), (z, 1, y * z)),
    )
    for step, (axis, outer, counts, strides) in enumerate(plans):
        wraps, weight = int(periodic[axis]), float(weights[axis])

        def work(
            a: int, b: int, plan: tuple[object, ...] = (counts, strides, weight, wraps)
        ) -> None:
            _envelopes(flat, *plan, a, b)

        def told(done: int, count: int, step: int = step) -> None:
            if progress is not None:
                progress(step * count + done, 3 * count)

        slabs(outer, max(1, CALL // (counts[0] * counts[1])), work, told)
    return squares < 0


@kernel
def _envelopes(flat, counts, strides, weight, wraps, first, last):
    # Line ``side`` of slab ``outer`` has counts[0] voxels; a periodic one goes on on both sides.
    n = counts[0]
    pad = n if wraps else 0
    length = n + 2 * pad
    lines = np.empty((WIDE, length), np.float64)
    hull = np.empty(length + 1, np.int64)
    bounds = np.empty(length + 1, np.float64)
    for outer in range(first, last):
        for side in range(0, counts[1], WIDE):
            wide = min(WIDE, counts[1] - side)
            base = outer * strides[0] + side * strides[1]
            for p in range(n):
                at = base + p * strides[2]
                for c in range(wide):
                    lines[c, p + pad] = flat[at + c * strides[1]]
            for c in range(wide):
                line = lines[c]
                for p in range(pad):
                    line[p] = line[n + p]
                    line[n + pad + p] = line[pad + p]
                top = -1
                for q in range(length):
                    height = line[q]
                    if height == 0.0:
                        continue
                    place = -np.inf
                    while top >= 0:
                        v = hull[top]
                        place = 0.5 * (q + v) + 0.5 * (height - line[v]) / (weight * (q - v))
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
                at, v = base + c * strides[1], 0
                for p in range(n):
                    while bounds[v + 1] < p + pad:
                        v += 1
                    gap = p + pad - hull[v]
                    flat[at] = min(0.0, line[hull[v]] + weight * gap * gap)
                    at += strides[2]
