"""Lines through pieces: each piece gives spans along z, and spans set the bits of masks.

Lengths are in voxels of the whole lattice, so a tile's numbers are those of the whole. Kernels run
on one thread and write one tile: who shares a grid among threads gives each thread its own tile.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

CLOSED = 1e-6
"""Pieces are closed: a sample within this part of a voxel of a piece is in it."""

STEEPEST = 1e3
"""Triangles steeper than this are taken as parallel to z."""

BATCH = 1 << 24
"""Lines of one call, about: well below half a second."""


class Window(NamedTuple):
    """What is sampled: masks (nx, ny, nz), the first voxel (3,), and the pattern's rows, depths."""

    masks: NDArray[np.uint64]
    start: NDArray[np.int64]
    rows: Floats
    depths: Floats


@kernel
def _stroke(column, start, low, high, depths, row):
    # Sample c of voxel k lies at k + depths[row, c]; only a span's first and last voxel can be
    # partly inside.
    points = depths.shape[1]
    stop = start + column.shape[0]
    low, high = min(max(low, start - 1.0), stop + 1.0), min(max(high, start - 1.0), stop + 1.0)
    first = max(start, np.int64(np.ceil(low - depths[row, points - 1])))
    last = min(stop - 1, np.int64(np.floor(high - depths[row, 0])))
    for k in range(first, last + 1):
        bits = np.uint64(0)
        for c in range(points):
            place = k + depths[row, c]
            if low <= place and place <= high:
                bits |= np.uint64(1) << np.uint64(row * points + c)
        column[k - start] |= bits


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
                _stroke(column, start, lows[r], highs[r], depths, r)
            else:
                _stroke(column, start, lows[r], min(highs[r], common_first), depths, r)
                _stroke(column, start, max(lows[r], common_last + 1.0), highs[r], depths, r)


@kernel
def _columns(box, start, shape):
    # Voxels of the window that a box, lower and upper corner, may have samples in.
    x0 = max(np.int64(np.floor(max(box[0], start[0] - 1.0))), start[0])
    y0 = max(np.int64(np.floor(max(box[1], start[1] - 1.0))), start[1])
    x1 = min(np.int64(np.floor(min(box[3], start[0] + shape[0] + 1.0))), start[0] + shape[0] - 1)
    y1 = min(np.int64(np.floor(min(box[4], start[1] + shape[1] + 1.0))), start[1] + shape[1] - 1)
    if box[5] < start[2] or box[2] > start[2] + shape[2]:
        x1 = x0 - 1
    return x0, y0, x1, y1


@kernel
def _full(column, start, low, high, everything):
    # Whether the voxels between two places on a line are full: then no span can add to them.
    first = np.int64(np.floor(min(max(low - start, 0.0), column.shape[0] + 0.0)))
    last = np.int64(np.floor(min(max(high - start, -1.0), column.shape[0] - 1.0)))
    for k in range(first, last + 1):
        if column[k] != everything:
            return False
    return True


@kernel
def _polytopes(masks, start, rows, depths, planes, boxes, first, last, lows, highs):
    everything = ~np.uint64(0) >> np.uint64(64 - depths.size)
    for p in range(first, last):
        x0, y0, x1, y1 = _columns(boxes[p], start, masks.shape)
        for i in range(x0, x1 + 1):
            for j in range(y0, y1 + 1):
                column = masks[i - start[0], j - start[1]]
                if _full(column, start[2], boxes[p, 2], boxes[p, 5], everything):
                    continue
                for r in range(rows.shape[0]):
                    lows[r] = boxes[p, 2]
                    highs[r] = boxes[p, 5]
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
        x0, y0, x1, y1 = _columns(boxes[p], start, masks.shape)
        middle = 0.5 * (boxes[p, 2] + boxes[p, 5])
        half = 0.5 * (boxes[p, 5] - boxes[p, 2])
        form = forms[p]
        squared = form[0, 2] ** 2 + form[1, 2] ** 2 + form[2, 2] ** 2
        for i in range(x0, x1 + 1):
            for j in range(y0, y1 + 1):
                column = masks[i - start[0], j - start[1]]
                if _full(column, start[2], boxes[p, 2], boxes[p, 5], everything):
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
        x0, y0, x1, y1 = _columns(boxes[p], start, masks.shape)
        form, axis = forms[p], axes[p]
        for i in range(x0, x1 + 1):
            for j in range(y0, y1 + 1):
                column = masks[i - start[0], j - start[1]]
                if _full(column, start[2], boxes[p, 2], boxes[p, 5], everything):
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


@kernel
def _side(px, py, qx, qy, x, y):
    # On which side of the line from p to q a point is. The ends are put in order first, so that
    # two triangles find the very same number for the edge they share, with opposite signs.
    if px < qx or (px == qx and py < qy):
        return (qx - px) * (y - py) - (qy - py) * (x - px)
    return -((px - qx) * (y - qy) - (py - qy) * (x - qx))


@kernel
def _crossing(a, b, c, x, y):
    # How often a triangle's outline winds round (x, y), seen along z, where the line meets it, and
    # how far along the line one goes to be one away from its plane.
    # An edge counts where it passes the point's y, its lower end included and its upper end not,
    # to the right of it: over a closed surface the numbers of a line always sum to zero.
    turns, ends = 0, (a, b, c, a)
    for k in range(3):
        p, q = ends[k], ends[k + 1]
        if (p[1] <= y) != (q[1] <= y):
            side = _side(p[0], p[1], q[0], q[1], x, y)
            if p[1] <= y and side > 0.0:
                turns += 1
            elif q[1] <= y and side < 0.0:
                turns -= 1
    if turns == 0:
        return 0, 0.0, 0.0
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    least, most = min(a[2], b[2], c[2]), max(a[2], b[2], c[2])
    if nz == 0.0:
        return turns, 0.5 * (least + most), STEEPEST
    z = a[2] - (nx * (x - a[0]) + ny * (y - a[1])) / nz
    steep = np.sqrt(nx * nx + ny * ny + nz * nz) / abs(nz)
    return turns, min(max(z, least), most), min(steep, STEEPEST)


@kernel
def _upright(a, b, c, x, y, slack):
    # The span of a line inside a triangle that is parallel to it, give or take ``slack``.
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    flat = np.sqrt(nx * nx + ny * ny)
    low, high = np.inf, -np.inf
    if abs(nz) * STEEPEST > flat or abs(nx * (x - a[0]) + ny * (y - a[1])) > slack * flat:
        return low, high
    tx, ty = -ny / flat, nx / flat
    ends = (a, b, c, a)
    for k in range(3):
        p, q = ends[k], ends[k + 1]
        s, t = tx * (p[0] - x) + ty * (p[1] - y), tx * (q[0] - x) + ty * (q[1] - y)
        if abs(s) <= slack:
            low, high = min(low, p[2]), max(high, p[2])
        if (s < 0.0) != (t < 0.0):
            z = p[2] + (q[2] - p[2]) * s / (s - t)
            low, high = min(low, z), max(high, z)
    return low, high


@kernel
def _chosen(points, triangles, given, count, x0, x1, y0, y1, found):
    # Of ``count`` triangles those whose outline meets a rectangle.
    many = 0
    for k in range(count):
        t = given[k]
        a, b, c = points[triangles[t, 0]], points[triangles[t, 1]], points[triangles[t, 2]]
        if (
            min(a[0], b[0], c[0]) <= x1
            and max(a[0], b[0], c[0]) >= x0
            and min(a[1], b[1], c[1]) <= y1
            and max(a[1], b[1], c[1]) >= y0
        ):
            found[many] = t
            many += 1
    return many


@kernel
def _line(points, triangles, near, count, x, y, places, turns, steeps):
    # The crossings of a line, by rising z (insertion: there are few).
    many = 0
    for k in range(count):
        t = near[k]
        a, b, c = points[triangles[t, 0]], points[triangles[t, 1]], points[triangles[t, 2]]
        turn, z, steep = _crossing(a, b, c, x, y)
        if turn != 0:
            at = many
            while at > 0 and places[at - 1] > z:
                places[at], turns[at], steeps[at] = places[at - 1], turns[at - 1], steeps[at - 1]
                at -= 1
            places[at], turns[at], steeps[at] = z, turn, steep
            many += 1
    return many


@kernel
def _solids(
    masks,
    start,
    rows,
    depths,
    frames,
    corners,
    triangles,
    boxes,
    first,
    last,
    points,
    every,
    wide,
    near,
    places,
    turns,
    steeps,
    lows,
    highs,
    slack,
):
    for p in range(first, last):
        x0, y0, x1, y1 = _columns(boxes[p], start, masks.shape)
        if x1 < x0 or y1 < y0:
            continue
        for v in range(len(corners)):
            for a in range(3):
                value = frames[p, a, 3]
                for b in range(3):
                    value += frames[p, a, b] * corners[v, b]
                points[v, a] = value
        count = _chosen(points, triangles, every, len(triangles), x0, x1 + 1.0, y0, y1 + 1.0, wide)
        for i in range(x0, x1 + 1):
            for j in range(y0, y1 + 1):
                some = _chosen(
                    points,
                    triangles,
                    wide,
                    count,
                    i - slack,
                    i + 1.0 + slack,
                    j - slack,
                    j + 1.0 + slack,
                    near,
                )
                if some == 0:
                    continue
                column = masks[i - start[0], j - start[1]]
                for r in range(len(rows)):
                    x, y = i + rows[r, 0], j + rows[r, 1]
                    many = _line(points, triangles, near, some, x, y, places, turns, steeps)
                    winding = 0
                    for k in range(many):
                        before = winding
                        winding += turns[k]
                        if before == 0:
                            lows[0] = places[k] - slack * steeps[k]
                        if winding == 0:
                            highs[0] = places[k] + slack * steeps[k]
                            _stroke(column, start[2], lows[0], highs[0], depths, r)
                    for k in range(some):
                        t = near[k]
                        low, high = _upright(
                            points[triangles[t, 0]],
                            points[triangles[t, 1]],
                            points[triangles[t, 2]],
                            x,
                            y,
                            slack,
                        )
                        if low <= high:
                            _stroke(column, start[2], low - slack, high + slack, depths, r)


def paint_polytopes(window: Window, planes: Floats, boxes: Floats) -> None:
    """Set the samples in convex polytopes: planes (k, m, 4) with n·g ≤ d, boxes (k, 6).

    Normals have unit length; planes of zeros and a positive d bound nothing.
    """
    planes, boxes = _closed(planes), _grown(boxes)
    _batched(window, boxes, _polytopes, (source(planes, np.float64),))


def paint_quadrics(window: Window, forms: Floats, boxes: Floats) -> None:
    """Set the samples with |F g + f| ≤ 1 and 0 ≤ s·g + t ≤ 1: forms (k, 4, 4), boxes (k, 6).

    The first three rows are F and f, the fourth s and t: ellipsoids, and cylinders with flat ends.
    """
    _batched(window, _grown(boxes), _quadrics, (source(forms, np.float64),), slack=CLOSED)


def paint_rounded_ellipsoids(
    window: Window, forms: Floats, axes: Floats, boxes: Floats, radius: float
) -> None:
    """Set the samples within ``radius`` of solid ellipsoids.

    ``forms`` (k, 3, 4) takes voxels to the ellipsoid's own axes, in units of length; ``axes``
    (k, 3) are its half axes, zero where it is flat; ``boxes`` (k, 6) hold the sum.
    """
    arrays = source(forms, np.float64), source(axes, np.float64)
    _batched(window, _grown(boxes), _rounded_ellipsoids, arrays, radius, slack=CLOSED)


def paint_solids(window: Window, frames: Floats, solid: tuple[Floats, Any], boxes: Floats) -> None:
    """Set the samples that a closed surface winds round: frames (k, 3, 4), boxes (k, 6).

    ``solid`` is the surface's points (n, 3) and triangles (t, 3), which the frames take to voxels.
    A line through an edge meets one of its two triangles, never none and never both.
    """
    corners, triangles = source(solid[0], np.float64), source(solid[1], np.int64)
    count = len(triangles)
    scratch = (
        *(np.empty((len(corners), 3)), source(np.arange(count), np.int64)),
        *(np.empty(count, np.int64), np.empty(count, np.int64)),
        *(np.empty(count), np.empty(count, np.int64), np.empty(count)),
    )
    arrays = source(frames, np.float64), corners, triangles
    _batched(window, _grown(boxes), _solids, arrays, *scratch, slack=CLOSED)


def _closed(planes: Floats) -> Floats:
    result = planes.copy()
    result[..., 3] += CLOSED
    return result


def _grown(boxes: Floats) -> Floats:
    return np.concatenate([boxes[:, :3] - 2 * CLOSED, boxes[:, 3:] + 2 * CLOSED], axis=1)


def _batched(
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
