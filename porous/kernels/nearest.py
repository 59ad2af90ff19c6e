"""How far points lie from triangles: a tree of boxes along Morton's curve, searched best first.

Of two halves the nearer is looked into first, and what is no nearer than the best so far is left
out (after Roussopoulos, Kelley & Vincent 1995); a search begins at the neighbours along the curve,
so that there is little to look into. Where only the farthest point is sought, a point's search ends
as soon as it is known to be nearer than another. The distance to a triangle is that to the nearest
of its plane, sides and corners, by the regions that its sides cut out (Ericson 2005, §5.1.5).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

LEAF = 4
"""Triangles in the lowest boxes of the tree."""

SLAB = 4096
DEPTH = 128
"""Points of one task; places on the stack of one that goes down the tree."""

BITS = 20
"""Of each coordinate, in places along the curve."""


@kernel
def _minus(u, v):
    return (u[0] - v[0], u[1] - v[1], u[2] - v[2])


@kernel
def _dot(u, v):
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@kernel
def _corner(points, index):
    return (points[index, 0], points[index, 1], points[index, 2])


@kernel
def _part(over, under):
    # A share between 0 and 1, and 0 where a side has no length.
    return min(max(over / under, 0.0), 1.0) if under > 0 else 0.0


@kernel
def _to_side(p, a, b):
    # The square of the distance to the line between two points.
    side, way = _minus(b, a), _minus(p, a)
    t = _part(_dot(way, side), _dot(side, side))
    off = (way[0] - t * side[0], way[1] - t * side[1], way[2] - t * side[2])
    return _dot(off, off)


@kernel
def _to_triangle(p, a, b, c):
    # The square of the distance: to the plane where the foot is inside, else to the nearest side.
    u, v, w = _minus(b, a), _minus(c, a), _minus(p, a)
    uu, uv, vv, wu, wv = _dot(u, u), _dot(u, v), _dot(v, v), _dot(w, u), _dot(w, v)
    area = uu * vv - uv * uv
    s, t = vv * wu - uv * wv, uu * wv - uv * wu
    if area > 0 and s >= 0 and t >= 0 and s + t <= area:
        s, t = s / area, t / area
        off = (
            w[0] - s * u[0] - t * v[0],
            w[1] - s * u[1] - t * v[1],
            w[2] - s * u[2] - t * v[2],
        )
        return _dot(off, off)
    return min(_to_side(p, a, b), _to_side(p, b, c), _to_side(p, c, a))


@kernel
def _to_box(p, boxes, node):
    total = 0.0
    for axis in range(3):
        off = max(boxes[node, axis] - p[axis], p[axis] - boxes[node, axis + 3], 0.0)
        total += off * off
    return total


@kernel
def _places(points, triangles, low, scale, codes, first, last):
    # Numbers along Morton's curve of the triangles' middles: near ones are near.
    for i in range(first, last):
        code = 0
        for axis in range(3):
            total = 0.0
            for corner in range(3):
                total += points[triangles[i, corner], axis]
            most = (1 << BITS) - 1
            place = np.int64(min(max((total / 3.0 - low[axis]) * scale, 0.0), most))
            for bit in range(BITS):
                code |= ((place >> bit) & 1) << (3 * bit + axis)
        codes[i] = code


@kernel
def _fill(points, triangles, order, boxes, leaves, first, last):
    # The lowest boxes; those without triangles are nowhere.
    for leaf in range(first, last):
        node = leaves + leaf
        for axis in range(3):
            boxes[node, axis], boxes[node, axis + 3] = np.inf, -np.inf
        for i in range(leaf * LEAF, min((leaf + 1) * LEAF, order.shape[0])):
            for corner in range(3):
                point = triangles[order[i], corner]
                for axis in range(3):
                    boxes[node, axis] = min(boxes[node, axis], points[point, axis])
                    boxes[node, axis + 3] = max(boxes[node, axis + 3], points[point, axis])


@kernel
def _join(boxes, leaves):
    for node in range(leaves - 1, 0, -1):
        for axis in range(3):
            boxes[node, axis] = min(boxes[2 * node, axis], boxes[2 * node + 1, axis])
            boxes[node, axis + 3] = max(boxes[2 * node, axis + 3], boxes[2 * node + 1, axis + 3])


@kernel
def _to_leaf(p, points, triangles, order, leaf):
    best = np.inf
    for k in range(max(leaf, 0) * LEAF, min((leaf + 1) * LEAF, order.shape[0])):
        a = _corner(points, triangles[order[k], 0])
        b = _corner(points, triangles[order[k], 1])
        c = _corner(points, triangles[order[k], 2])
        best = min(best, _to_triangle(p, a, b, c))
    return best


@kernel
def _search(
    places, near, points, triangles, order, boxes, squares, stack, enough, grows, first, last
):
    # A search ends at what is no more than enough; that grows to the largest found, if it may.
    leaves = boxes.shape[0] // 2
    for i in range(first, last):
        p = _corner(places, i)
        best, top = np.inf, 1
        for leaf in range(near[i] // LEAF - 1, near[i] // LEAF + 2):
            best = min(best, _to_leaf(p, points, triangles, order, leaf))
        stack[0] = 1
        while top and best > enough:
            top -= 1
            node = stack[top]
            if _to_box(p, boxes, node) >= best:
                continue
            if node >= leaves:
                best = min(best, _to_leaf(p, points, triangles, order, node - leaves))
                continue
            left_first = _to_box(p, boxes, 2 * node) <= _to_box(p, boxes, 2 * node + 1)
            stack[top] = 2 * node + 1 if left_first else 2 * node
            stack[top + 1] = 2 * node if left_first else 2 * node + 1
            top += 2
        squares[i] = best
        if grows:
            enough = max(enough, best)


class Nearest:
    """A surface that is asked how far points are from it.

    Parameters
    ----------
    points
        Shape (n, 3).
    triangles
        Shape (t, 3), indices of points; at least one.
    """

    def __init__(self, points: Floats, triangles: Indices) -> None:
        self._points, self._triangles = source(points, np.float64), source(triangles, np.int64)
        codes = self._codes(self._points, self._triangles)
        self._order = source(np.argsort(codes, kind="stable"), np.int64)
        self._curve = codes[self._order]
        leaves = 1 << (-(-len(codes) // LEAF) - 1).bit_length()
        boxes = np.empty((2 * leaves, 6))

        def fill(first: int, last: int) -> None:
            _fill(self._points, self._triangles, self._order, boxes, leaves, first, last)

        slabs(leaves, 8 * SLAB, fill)
        _join(boxes, leaves)
        self._boxes = source(boxes, np.float64)

    def _codes(self, points: Floats, triangles: Indices) -> Indices:
        """Return places along the curve through the surface's box."""
        low, high = self._points.min(axis=0), self._points.max(axis=0)
        scale = (2**BITS - 1) / max(float((high - low).max()), float(np.finfo(float).tiny))
        low = source(low, np.float64)
        codes = np.empty(len(triangles), np.int64)

        def place(first: int, last: int) -> None:
            _places(points, triangles, low, scale, codes, first, last)

        slabs(len(codes), 32 * SLAB, place)
        return codes

    def distances(self, places: Floats) -> Floats:
        """Return the distance of each point, shape (m, 3), from the nearest triangle."""
        return np.asarray(np.sqrt(self._squares(places, -1.0, grows=False)))

    def farthest(self, places: Floats) -> float:
        """Return the largest of the distances of points, shape (m, 3); 0 of none."""
        return float(np.sqrt(self._squares(places, 0.0, grows=True).max(initial=0.0)))

    def beyond(self, places: Floats, distance: float) -> NDArray[np.bool_]:
        """Tell which points, shape (m, 3), are farther away than a distance."""
        square = float(distance) ** 2
        return np.asarray(self._squares(places, square, grows=False) > square)

    def _squares(self, places: Floats, enough: float, *, grows: bool) -> Floats:
        given = source(places, np.float64)
        alone = source(np.repeat(np.arange(len(given)), 3).reshape(-1, 3), np.int64)
        near = source(np.searchsorted(self._curve, self._codes(given, alone)), np.int64)
        squares = np.empty(len(given))
        tree = (self._points, self._triangles, self._order, self._boxes)

        def search(first: int, last: int) -> None:
            stack = np.empty(DEPTH, np.int64)
            _search(given, near, *tree, squares, stack, enough, grows, first, last)

        slabs(len(given), SLAB, search)
        return squares
