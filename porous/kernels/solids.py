"""Lines through closed surfaces: crossings by rising z, solid where the surface winds round."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import columns, kernel, source, stroke
from porous.kernels.pieces import CLOSED, batched, grown

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.kernels.pieces import Window

    Floats = NDArray[np.float64]

STEEPEST = 1e3
"""Triangles steeper than this are taken as parallel to z."""


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
def _outline(points, triangles, limits):
    # The rectangle round each triangle, seen along z.
    for t in range(len(triangles)):
        for a in range(2):
            u, v, w = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            limits[t, a] = min(points[u, a], points[v, a], points[w, a])
            limits[t, a + 2] = max(points[u, a], points[v, a], points[w, a])


@kernel
def _chosen(limits, given, count, x0, x1, y0, y1, found):
    # Of ``count`` triangles those whose outline meets a rectangle.
    many = 0
    for k in range(count):
        t = given[k]
        inside = limits[t, 0] <= x1 and limits[t, 2] >= x0
        if inside and limits[t, 1] <= y1 and limits[t, 3] >= y0:
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
    limits,
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
        x0, y0, x1, y1 = columns(boxes[p], start, masks.shape)
        if x1 < x0 or y1 < y0:
            continue
        for v in range(len(corners)):
            for a in range(3):
                value = frames[p, a, 3]
                for b in range(3):
                    value += frames[p, a, b] * corners[v, b]
                points[v, a] = value
        _outline(points, triangles, limits)
        count = _chosen(limits, every, len(triangles), x0, x1 + 1.0, y0, y1 + 1.0, wide)
        for i in range(x0, x1 + 1):
            for j in range(y0, y1 + 1):
                some = _chosen(
                    limits,
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
                            stroke(column, start[2], lows[0], highs[0], depths, r)
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
                            stroke(column, start[2], low - slack, high + slack, depths, r)


def paint_solids(
    window: Window, frames: Floats, solid: tuple[Floats, NDArray[np.int64]], boxes: Floats
) -> None:
    """Set the samples that a closed surface winds round: frames (k, 3, 4), boxes (k, 6).

    ``solid`` is the surface's points (n, 3) and triangles (t, 3), which the frames take to voxels.
    A line through an edge meets one of its two triangles, never none and never both.
    """
    corners, triangles = source(solid[0], np.float64), source(solid[1], np.int64)
    count = len(triangles)
    scratch = (
        *(np.empty((len(corners), 3)), np.empty((count, 4)), source(np.arange(count), np.int64)),
        *(np.empty(count, np.int64), np.empty(count, np.int64)),
        *(np.empty(count), np.empty(count, np.int64), np.empty(count)),
    )
    arrays = source(frames, np.float64), corners, triangles
    batched(window, grown(boxes), _solids, arrays, *scratch, slack=CLOSED)
