"""Which points lie inside a closed surface: how often it winds round them, by rays along z."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.values import SurfaceMesh

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

PAIRS = 1 << 20
"""Pairs of a triangle and a point that are looked at together, about."""


def inside(surface: SurfaceMesh, points: Floats) -> NDArray[np.bool_]:
    """Tell which points (n, 3) lie inside a closed surface, that is, are wound round.

    The triangles above a point are counted, those that face up against those that face down. An
    edge that a ray meets belongs to one of its two triangles, for both find the very same number
    for its side.

    Parameters
    ----------
    surface
        Closed and oriented.
    points
        None of them on the surface.
    """
    turns = np.zeros(len(points), dtype=np.int64)
    if len(points):
        order, first, stop, triangle = _runs(surface.corners, points)
        for part in _parts(stop - first):
            length = stop[part] - first[part]
            slot = np.repeat(first[part] - np.cumsum(length) + length, length)
            point = order[slot + np.arange(len(slot))]
            corners = surface.corners[np.repeat(triangle[part], length)]
            turns += np.bincount(
                point, _above(corners, points[point]), minlength=len(points)
            ).astype(np.int64)
    return turns > 0


def _runs(corners: Floats, points: Floats) -> tuple[Indices, Indices, Indices, Indices]:
    """Return the points in the order of columns, and runs of them that triangles may lie above.

    Columns are even ones over the points' box, about one for each point; a run is a row of them
    that one triangle covers: its first place, its last, its triangle.
    """
    count = max(1, int(np.sqrt(len(points))))
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    step = np.maximum((high - low) / count, np.finfo(float).tiny)

    def column(places: Floats) -> Indices:  # monotonic: what lies between, stays between
        result: Indices = np.clip((places - low) // step, 0, count - 1).astype(np.int64)
        return result

    key = column(points[:, :2]) @ np.array([count, 1])
    order = np.argsort(key, kind="stable")
    starts = np.searchsorted(key[order], np.arange(count**2 + 1))
    least, most = column(corners[:, :, :2].min(axis=1)), column(corners[:, :, :2].max(axis=1))
    rows = most[:, 0] - least[:, 0] + 1
    triangle = np.repeat(np.arange(len(corners)), rows)
    row = np.arange(len(triangle)) - np.repeat(np.cumsum(rows) - rows, rows) + least[triangle, 0]
    first = starts[row * count + least[triangle, 1]]
    stop = starts[row * count + most[triangle, 1] + 1]
    some = stop > first
    return order, first[some], stop[some], triangle[some]


def _parts(lengths: Indices) -> Iterator[slice]:
    """Yield slices of runs that hold about ``PAIRS`` together."""
    total = np.cumsum(lengths)
    most = int(total[-1]) if len(total) else 0
    ends = np.searchsorted(total, np.arange(PAIRS, most + PAIRS, PAIRS), side="right")
    begin = 0
    for end in np.unique(np.maximum(ends, 1)) if most else ():
        yield slice(begin, end)
        begin = end


def _above(corners: Floats, points: Floats) -> Floats:
    """Return 1 where a triangle (n, 3, 3) above a point (n, 3) faces up, −1 down, else 0."""
    a, b, c = (corners[:, i] for i in range(3))
    sides, left = zip(*(_side(p, q, points) for p, q in ((b, c), (c, a), (a, b))), strict=True)
    # Three sides together are twice the triangle's area seen from above, negative from below.
    height = sum(
        side * (corner[:, 2] - points[:, 2]) for side, corner in zip(sides, (a, b, c), strict=True)
    )
    up, down = left[0] & left[1] & left[2], ~(left[0] | left[1] | left[2])
    return np.where(up & (height > 0), 1.0, 0.0) - np.where(down & (height < 0), 1.0, 0.0)


def _side(p: Floats, q: Floats, points: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return how far left of the way from p to q points lie, seen from above, and whether so.

    The ends are put in order first, so that the triangles of an edge find the same number with
    opposite signs; a point in line with it is left of the way in that order.
    """
    turned = (p[:, 0] > q[:, 0]) | ((p[:, 0] == q[:, 0]) & (p[:, 1] > q[:, 1]))
    p, q = np.where(turned[:, None], q, p), np.where(turned[:, None], p, q)
    way, off = q - p, points - p
    side = way[:, 0] * off[:, 1] - way[:, 1] * off[:, 0]
    return np.where(turned, -side, side), (side >= 0) ^ turned
