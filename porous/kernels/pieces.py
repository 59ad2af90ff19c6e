"""Lines through pieces: each piece gives spans along z, and spans set the bits of masks.

Lengths are in voxels of the whole lattice, so a tile's numbers are those of the whole. Kernels run
on one thread and write one tile: who shares a grid among threads gives each thread its own tile.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.kernels._shared import columns, full, kernel, source, stroke

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

CLOSED = 1e-6
"""Pieces are closed: a sample within this part of a voxel of a piece is in it."""

BATCH = 1 << 24
"""Lines of one call, about: well below half a second."""


class Window(NamedTuple):
    """What is sampled: masks (nx, ny, nz), the first voxel (3,), and the pattern's rows, depths."""

    masks: NDArray[np.uint64]
    start: NDArray[np.int64]
    rows: Floats
    depths: Floats


@kernel
def _paint(column, start, lows, highs, depths):
    # One span per row of a column: voxels that all rows fill are set at once, others row by row.
    rows, points = depths.shape
    stop = start + column.shape[0]
    common_first, common_last = start, stop - 1
    for r in range(rows):
        low = min(max(lows[r], start - 1.0), stop + 1.0)
        high = min(max(highs[r], start - 1.0), stop + 1.0)
        if not low <= high:
            common_first = stop
        else:
            common_first = max(common_first, np.int64(np.ceil(low - depths[r, 0])))
            common_last = min(common_last, np.int64(np.floor(high - depths[r, points - 1])))
    if common_first <= common_last:
        everything = ~np.uint64(0) >> np.uint64(64 - rows * points)
        for k in range(common_first, common_last + 1):
            column[k - start] = everything
    else:
        common_first, common_last = stop, stop
    for r in range(rows):
        if lows[r] <= highs[r]:
            if common_first == stop:
                stroke(column, start, lows[r], highs[r], depths, r)
            else:
                stroke(column, start, lows[r], min(highs[r], common_first), depths, r)
                stroke(column, start, max(lows[r], common_last + 1.0), highs[r], depths, r)


@kernel
def _polytopes(masks, start, rows, depths, planes, boxes, first, last, lows, highs):
    everything = ~np.uint64(0) >> np.uint64(64 - depths.size)
    for p in range(first, last):
        x0, y0, x1, y1 = columns(boxes[p], start, masks.shape)
        for i in range(x0, x1 + 1):
            for j in range(y0, y1 + 1):
                column = masks[i - start[0], j - start[1]]
                if full(column, start[2], boxes[p, 2], boxes[p, 5], everything):
                    continue
                for r in range(rows.shape[0]):
                    x, y = i + rows[r, 0], j + rows[r, 1]
                    beside = x < boxes[p, 0] or x > boxes[p, 3]
                    beside = beside or y < boxes[p, 1] or y > boxes[p, 4]
                    lows[r] = boxes[p, 2]
                    highs[r] = -np.inf if beside else boxes[p, 5]
                for f in range(planes.shape[1]):
                    a, b, c = planes[p, f, 0], planes[p, f, 1], planes[p, f, 2]
                    rest = planes[p, f, 3] - a * i - b * j
                    if abs(c) < 1e-12:
                        for r in range(rows.shape[0]):
                            if rest - a * rows[r, 0] - b * rows[r, 1] < 0.0:
                                highs[r] = -np.inf
                        continue
                    steep = 1.0 / c
                    for r in range(rows.shape[0]):
                        z = (rest - a * rows[r, 0] - b * rows[r, 1]) * steep
                        if c > 0.0:
                            highs[r] = min(highs[r], z)
                        else:
                            lows[r] = max(lows[r], z)
                some = False
                for r in range(rows.shape[0]):
                    some = some or lows[r] <= highs[r]
                if some:
                    _paint(column, start[2], lows, highs, depths)


@kernel
def _quadrics(masks, start, rows, depths, forms, boxes, first, last, lows, highs, slack):
    # |F g + f| ≤ 1 over the first three rows of a form, and its fourth between 0 and 1.
    everything = ~np.uint64(0) >> np.uint64(64 - depths.size)
    for p in range(first, last):
        x0, y0, x1, y1 = columns(boxes[p], start, masks.shape)
        middle = 0.5 * (boxes[p, 2] + boxes[p, 5])
        half = 0.5 * (boxes[p, 5] - boxes[p, 2])
        form = forms[p]
        squared = form[0, 2] ** 2 + form[1, 2] ** 2 + form[2, 2] ** 2
        for i in range(x0, x1 + 1):
            for j in range(y0, y1 + 1):
                column = masks[i - start[0], j - start[1]]
                if full(column, start[2], boxes[p, 2], boxes[p, 5], everything):
                    continue
                some = False
                for r in range(rows.shape[0]):
                    x, y = i + rows[r, 0], j + rows[r, 1]
                    mixed, constant = 0.0, -1.0
                    for a in range(3):
                        value = form[a, 0] * x + form[a, 1] * y + form[a, 2] * middle + form[a, 3]
                        mixed += value * form[a, 2]
                        constant += value * value
                    low, high = -half, half
                    if squared < 1e-24:
                        if constant > 0.0:
                            high = -np.inf
                    else:
                        root = mixed * mixed - squared * constant
                        if root < 0.0:
                            high = -np.inf
                        else:
                            root = np.sqrt(root)
                            low = max(low, (-mixed - root) / squared)
                            high = min(high, (-mixed + root) / squared)
                    value = form[3, 0] * x + form[3, 1] * y + form[3, 2] * middle + form[3, 3]
                    slope = form[3, 2]
                    if abs(slope) < 1e-12:
                        if value < 0.0 or value > 1.0:
                            high = -np.inf
                    else:
                        low = max(low, min(-value / slope, (1.0 - value) / slope))
                        high = min(high, max(-value / slope, (1.0 - value) / slope))
                    lows[r] = middle + low - slack
                    highs[r] = middle + high + slack
                    some = some or low <= high
                if some:
                    _paint(column, start[2], lows, highs, depths)


@kernel
def _distance(form, axes, x, y, z):
    # Squared distance of a point from a solid ellipsoid, and how it changes along z. The nearest
    # point is e²v / (t + e²) with Σ (e v / (t + e²))² = 1 (Eberly 2013); Newton's iteration rises
    # to t from the bound below at which one term alone is one, for the sum is convex.
    v0 = form[0, 0] * x + form[0, 1] * y + form[0, 2] * z + form[0, 3]
    v1 = form[1, 0] * x + form[1, 1] * y + form[1, 2] * z + form[1, 3]
    v2 = form[2, 0] * x + form[2, 1] * y + form[2, 2] * z + form[2, 3]
    e0, e1, e2 = axes[0], axes[1], axes[2]
    inside = -1.0
    if e0 > 0.0:
        inside += (v0 / e0) ** 2
    if e1 > 0.0:
        inside += (v1 / e1) ** 2
    if e2 > 0.0:
        inside += (v2 / e2) ** 2
    t = 0.0
    if inside > 0.0:
        t = max(e0 * (abs(v0) - e0), e1 * (abs(v1) - e1), e2 * (abs(v2) - e2), 0.0)
        for _ in range(60):
            value, slope = -1.0, 0.0
            for e, v in ((e0, v0), (e1, v1), (e2, v2)):
                if e > 0.0:
                    term = e * v / (t + e * e)
                    value += term * term
                    slope -= 2.0 * term * term / (t + e * e)
            if value <= 0.0 or slope == 0.0:
                break
            step = -value / slope
            t += step
            if step <= 1e-15 * t:
                break
    # Where an axis is zero the nearest point has that coordinate zero.
    d0 = v0 if e0 == 0.0 else v0 * t / (t + e0 * e0)
    d1 = v1 if e1 == 0.0 else v1 * t / (t + e1 * e1)
    d2 = v2 if e2 == 0.0 else v2 * t / (t + e2 * e2)
    along = d0 * form[0, 2] + d1 * form[1, 2] + d2 * form[2, 2]
    return d0 * d0 + d1 * d1 + d2 * d2, along


@kernel
def _rounded_ellipsoids(
    masks, start, rows, depths, forms, axes, boxes, first, last, radius, lows, highs, slack
):
    # The distance is convex along a line: halve towards its least, then towards both ends.
    everything = ~np.uint64(0) >> np.uint64(64 - depths.size)
    for p in range(first, last):
        x0, y0, x1, y1 = columns(boxes[p], start, masks.shape)
        form, axis = forms[p], axes[p]
        for i in range(x0, x1 + 1):
            for j in range(y0, y1 + 1):
                column = masks[i - start[0], j - start[1]]
                if full(column, start[2], boxes[p, 2], boxes[p, 5], everything):
                    continue
                some = False
                for r in range(rows.shape[0]):
                    x, y = i + rows[r, 0], j + rows[r, 1]
                    below, above = boxes[p, 2], boxes[p, 5]
                    left, right, found = below, above, False
                    inner = 0.5 * (left + right)
                    for _ in range(60):
                        inner = 0.5 * (left + right)
                        squared, along = _distance(form, axis, x, y, inner)
                        if squared <= radius * radius:
                            found = True
                            break
                        if along > 0.0:
                            right = inner
                        else:
                            left = inner
                    lows[r], highs[r] = np.inf, -np.inf
                    if found:
                        some = True
                        lows[r] = highs[r] = inner
                        for _ in range(50):
                            z = 0.5 * (below + lows[r])
                            if _distance(form, axis, x, y, z)[0] <= radius * radius:
                                lows[r] = z
                            else:
                                below = z
                            z = 0.5 * (above + highs[r])
                            if _distance(form, axis, x, y, z)[0] <= radius * radius:
                                highs[r] = z
                            else:
                                above = z
                        lows[r] -= slack
                        highs[r] += slack
                if some:
                    _paint(column, start[2], lows, highs, depths)


def paint_polytopes(window: Window, planes: Floats, boxes: Floats) -> None:
    """Set the samples in convex polytopes: planes (k, m, 4) with n·g ≤ d, boxes (k, 6).

    Normals have unit length; planes of zeros and a positive d bound nothing.
    """
    planes, boxes = _closed(planes), grown(boxes)
    batched(window, boxes, _polytopes, (source(planes, np.float64),))


def paint_quadrics(window: Window, forms: Floats, boxes: Floats) -> None:
    """Set the samples with |F g + f| ≤ 1 and 0 ≤ s·g + t ≤ 1: forms (k, 4, 4), boxes (k, 6).

    The first three rows are F and f, the fourth s and t: ellipsoids, and cylinders with flat ends.
    """
    batched(window, grown(boxes), _quadrics, (source(forms, np.float64),), slack=CLOSED)


def paint_rounded_ellipsoids(
    window: Window, forms: Floats, axes: Floats, boxes: Floats, radius: float
) -> None:
    """Set the samples within ``radius`` of solid ellipsoids.

    ``forms`` (k, 3, 4) takes voxels to the ellipsoid's own axes, in units of length; ``axes``
    (k, 3) are its half axes, zero where it is flat; ``boxes`` (k, 6) hold the sum.
    """
    arrays = source(forms, np.float64), source(axes, np.float64)
    batched(window, grown(boxes), _rounded_ellipsoids, arrays, radius, slack=CLOSED)


def _closed(planes: Floats) -> Floats:
    result = planes.copy()
    result[..., 3] += CLOSED
    return result


def grown(boxes: Floats) -> Floats:
    """Return boxes (k, 6) grown by more than the slack of what they hold."""
    return np.concatenate([boxes[:, :3] - 2 * CLOSED, boxes[:, 3:] + 2 * CLOSED], axis=1)


def batched(
    window: Window,
    boxes: Floats,
    paint: Any,
    arrays: tuple[Floats, ...],
    *more: Any,
    slack: float | None = None,
) -> None:
    """Call a kernel for runs of pieces with about ``BATCH`` lines each."""
    rows, depths = source(window.rows, np.float64), source(window.depths, np.float64)
    boxes = source(boxes, np.float64)
    lows, highs = np.empty(len(rows)), np.empty(len(rows))
    tail = () if slack is None else (slack,)
    for first, last in _runs(boxes, window):
        paint(
            window.masks,
            source(window.start, np.int64),
            rows,
            depths,
            *arrays,
            boxes,
            first,
            last,
            *more,
            lows,
            highs,
            *tail,
        )


def _runs(boxes: Floats, window: Window) -> list[tuple[int, int]]:
    lower = np.maximum(boxes[:, :2], window.start[:2])
    upper = np.minimum(boxes[:, 3:5], window.start[:2] + window.masks.shape[:2])
    columns = np.prod(np.maximum(upper - lower + 2, 0), axis=1) * len(window.rows)
    run = (np.cumsum(columns) // BATCH).astype(np.int64)
    edges = np.flatnonzero(np.diff(run, prepend=-1, append=-1)) if len(run) else np.zeros(1, int)
    return [(int(a), int(b)) for a, b in pairwise(edges)]
