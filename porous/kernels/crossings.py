"""Triangles that meet where they share no corner or edge, found by seeking what parts them.

Two triangles are apart where a plane has one on either side: a direction along which all of one
lies further than all of the other. Of finitely many directions one will do wherever there is any
(Gottschalk, Lin & Manocha 1996), and whichever it is, the gap along it is held against all that
rounding can do. So "apart" is proved in floating point, and whatever is not proved counts as met:
triangles that touch, or that pass within some 1e-14 of their size, count too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError
from porous.kernels._shared import kernel, slabs, source
from porous.values.surface_topology import pieces, winding_numbers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.values import SurfaceMesh

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

MARGIN = 1e-14
"""A gap, as a part of sizes: differences and sums of three products are off by a fifth of that."""

LEAF = 4
"""Triangles in the lowest boxes of the tree."""

SLAB = 8192
DEPTH = 128
"""Triangles of one task; places on the stack of one that goes down the tree."""

NEAR = 1e-5
"""How far from a triangle the places lie, by the root of twice its area."""

PLACES = (32, 4096)
WORK = 3_000_000
"""Places at which it is asked how often a surface winds round; pairs of them and triangles."""


@kernel
def _plus(u, v):
    return (u[0] + v[0], u[1] + v[1], u[2] + v[2])


@kernel
def _minus(u, v):
    return (u[0] - v[0], u[1] - v[1], u[2] - v[2])


@kernel
def _dot(u, v):
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@kernel
def _cross(u, v):
    return (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])


@kernel
def _size(u):
    return abs(u[0]) + abs(u[1]) + abs(u[2])


@kernel
def _unit(u):
    length = np.sqrt(_dot(u, u))
    return (u[0] / length, u[1] / length, u[2] / length)


@kernel
def _parted(axis, one, other, size):
    # Whether there is a gap along an axis between all corners of one and all of the other.
    a, b, c = _dot(axis, one[0]), _dot(axis, one[1]), _dot(axis, one[2])
    d, e, f = _dot(axis, other[0]), _dot(axis, other[1]), _dot(axis, other[2])
    above = min(a, b, c) - max(d, e, f)
    below = min(d, e, f) - max(a, b, c)
    return max(above, below) > MARGIN * size * _size(axis)


@kernel
def _strangers_apart(one, other):
    # No corner shared. The directions are those across the faces of the hull of all differences
    # of their points: both normals, products of sides and, in one plane, across the sides.
    origin = one[0]
    zero = _minus(origin, origin)
    one = (zero, _minus(one[1], origin), _minus(one[2], origin))
    other = (_minus(other[0], origin), _minus(other[1], origin), _minus(other[2], origin))
    size = 0.0
    for corner in range(3):
        size = max(size, _size(one[corner]), _size(other[corner]))
    sides = (one[1], _minus(one[2], one[1]), one[2])
    others = (_minus(other[1], other[0]), _minus(other[2], other[1]), _minus(other[0], other[2]))
    normal, across = _cross(sides[0], sides[1]), _cross(others[0], others[1])
    if _parted(normal, one, other, size) or _parted(across, one, other, size):
        return True
    for i in range(3):
        for j in range(3):
            if _parted(_cross(sides[i], others[j]), one, other, size):
                return True
    for i in range(3):
        if _parted(_cross(normal, sides[i]), one, other, size):
            return True
        if _parted(_cross(across, others[i]), one, other, size):
            return True
    return False


@kernel
def _above(axis, rays):
    # Whether all rays leave a plane to the side that its normal shows.
    least = MARGIN * _size(axis)
    for ray in rays:
        if not _dot(axis, ray) > least:
            return False
    return True


@kernel
def _fans_apart(apex, one, next_one, other, next_other):
    # One corner shared, the apex. A plane through it parts the others where a half space holds
    # the rays to the one's and those away from the other's. If so, then that about the point
    # nearest to the apex of the four rays' hull, which is across two or three of them.
    a, b = _unit(_minus(one, apex)), _unit(_minus(next_one, apex))
    c, d = _unit(_minus(apex, other)), _unit(_minus(apex, next_other))
    rays = (a, b, c, d)
    if _above(
        (a[0] + b[0] + c[0] + d[0], a[1] + b[1] + c[1] + d[1], a[2] + b[2] + c[2] + d[2]), rays
    ):
        return True
    for i in range(3):
        for j in range(i + 1, 4):
            if _above(_plus(rays[i], rays[j]), rays):
                return True
    for left_out in range(4):
        u, v, w = rays[left_out - 1], rays[left_out - 2], rays[left_out - 3]
        axis = _cross(_minus(v, u), _minus(w, u))
        if _above(axis, rays) or _above((-axis[0], -axis[1], -axis[2]), rays):
            return True
    return False


@kernel
def _wings_apart(start, stop, one, other):
    # One side shared, from start to stop: they meet elsewhere only where they lie the same way
    # from it, that is, where their normals about it are the same.
    side, u, v = _minus(stop, start), _minus(one, start), _minus(other, start)
    normal, across = _cross(side, u), _cross(side, v)
    long, broad = np.sqrt(_dot(normal, normal)), np.sqrt(_dot(across, across))
    doubt = np.sqrt(_dot(side, side))
    doubt *= long * np.sqrt(_dot(v, v)) + broad * np.sqrt(_dot(u, u))
    doubt = MARGIN * (doubt + long * broad)
    turn = _cross(normal, across)
    return _dot(normal, across) < -doubt or np.sqrt(_dot(turn, turn)) > doubt


@kernel
def _corner(corners, triangle, place):
    place %= 3
    return (
        corners[triangle, place, 0],
        corners[triangle, place, 1],
        corners[triangle, place, 2],
    )


@kernel
def _apart(corners, triangles, i, j):
    shared, p, q = 0, 0, 0
    for k in range(3):
        for m in range(3):
            if triangles[i, k] == triangles[j, m]:
                shared += 1
                p += k
                q += m
    if shared == 0:
        one = (_corner(corners, i, 0), _corner(corners, i, 1), _corner(corners, i, 2))
        other = (_corner(corners, j, 0), _corner(corners, j, 1), _corner(corners, j, 2))
        return _strangers_apart(one, other)
    if shared == 1:
        return _fans_apart(
            _corner(corners, i, p),
            _corner(corners, i, p + 1),
            _corner(corners, i, p + 2),
            _corner(corners, j, q + 1),
            _corner(corners, j, q + 2),
        )
    if shared == 2:
        # Places of a triangle add up to 3: the third is what lacks.
        p, q = 3 - p, 3 - q
        return _wings_apart(
            _corner(corners, i, p + 1),
            _corner(corners, i, p + 2),
            _corner(corners, i, p),
            _corner(corners, j, q),
        )
    return False


@kernel
def _build(corners, boxes, leaves):
    # The boxes of a full binary tree over the triangles as they come: node k has 2k and 2k + 1.
    for node in range(len(boxes)):
        for axis in range(3):
            boxes[node, axis] = np.inf
            boxes[node, axis + 3] = -np.inf
    for triangle in range(len(corners)):
        node = leaves + triangle // LEAF
        for corner in range(3):
            for axis in range(3):
                value = corners[triangle, corner, axis]
                boxes[node, axis] = min(boxes[node, axis], value)
                boxes[node, axis + 3] = max(boxes[node, axis + 3], value)
    for node in range(leaves - 1, 0, -1):
        for axis in range(3):
            boxes[node, axis] = min(boxes[2 * node, axis], boxes[2 * node + 1, axis])
            upper = max(boxes[2 * node, axis + 3], boxes[2 * node + 1, axis + 3])
            boxes[node, axis + 3] = upper


@kernel
def _box(corners, triangle):
    a, b, c = corners[triangle, 0], corners[triangle, 1], corners[triangle, 2]
    return (
        min(a[0], b[0], c[0]),
        min(a[1], b[1], c[1]),
        min(a[2], b[2], c[2]),
        max(a[0], b[0], c[0]),
        max(a[1], b[1], c[1]),
        max(a[2], b[2], c[2]),
    )


@kernel
def _overlap(a, b):
    for axis in range(3):
        if a[axis] > b[axis + 3] or b[axis] > a[axis + 3]:
            return False
    return True


@kernel
def _search(corners, triangles, boxes, leaves, marks, stack, start, stop):
    # Marks triangles from start to stop, and later ones, that are not apart from one another.
    for i in range(start, stop):
        box = _box(corners, i)
        node = leaves + i // LEAF
        top = 0
        stack[top] = node
        while node:
            while top >= 0:
                below = stack[top]
                top -= 1
                if not _overlap(box, boxes[below]):
                    continue
                if below < leaves:
                    stack[top + 1], stack[top + 2] = 2 * below, 2 * below + 1
                    top += 2
                    continue
                first = (below - leaves) * LEAF
                for j in range(max(first, i + 1), min(first + LEAF, len(corners))):
                    if _overlap(box, _box(corners, j)) and not _apart(corners, triangles, i, j):
                        marks[i] = marks[j] = 1
            # What comes later lies to the right of the way up.
            if node % 2 == 0:
                top = 0
                stack[top] = node + 1
            node //= 2


def crossing(points: Floats, triangles: Indices) -> NDArray[np.bool_]:
    """Tell which triangles cross or touch another one elsewhere than in what they share.

    Shared are corners of the same index and sides between them. Triangles without area are found
    as well wherever they have neighbours.

    Parameters
    ----------
    points
        Shape (n, 3).
    triangles
        Shape (t, 3), indices of points.

    Returns
    -------
    Shape (t,). Where none is marked, none crosses another: that is proved, rounding included.
    """
    result = np.zeros(len(triangles), bool)
    if len(triangles) < 2:
        return result
    order = np.argsort(_codes(points, triangles), kind="stable")
    ordered = source(triangles[order], np.int64)
    corners = source(points[ordered], np.float64)
    leaves = 1 << (-(-len(ordered) // LEAF) - 1).bit_length()
    boxes = np.empty((2 * leaves, 6))
    _build(corners, boxes, leaves)
    marks = np.zeros(len(ordered), np.uint8)

    def work(start: int, stop: int) -> None:
        stack = np.empty(DEPTH, np.int64)
        _search(corners, ordered, source(boxes, np.float64), leaves, marks, stack, start, stop)

    slabs(len(ordered), SLAB, work)
    result[order] = marks.astype(bool)
    return result


def check_uncrossed(surface: SurfaceMesh) -> None:
    """Raise ``MeshError`` where a closed surface crosses itself, and winds round a place twice.

    Surfaces that touch themselves pass. It is asked how often the surface winds round places on
    both sides of triangles that touch or cross others, and of one of each piece; these are drawn at
    random, with the same seed always, so what crosses in little of them may be missed.

    Raises
    ------
    MeshError
        Naming a place that is inside twice, or less often than not at all.
    """
    shell = pieces(surface)
    some = crossing(surface.points, surface.triangles)
    if not some.any() and not shell.max(initial=0):
        return
    some[np.unique(shell, return_index=True)[1]] = True  # one that lies within another crosses none
    corners = surface.corners[some]
    random = np.random.default_rng(0)
    most = max(PLACES[0], min(PLACES[1], WORK // len(surface.triangles)))
    corners = random.permutation(corners)[:most]
    weights = random.dirichlet((1, 1, 1), -(-most // len(corners)))
    places = np.einsum("wi,tix->wtx", weights, corners)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    away = NEAR * np.sqrt(lengths) * normals / np.where(lengths > 0, lengths, 1)
    both = np.stack([places + away, places - away], axis=1).reshape(-1, 3)
    step = max(1, SLAB * 8 // len(surface.triangles))
    for start in range(0, len(both), step):
        near = both[start : start + step]
        winding = winding_numbers(surface.corners, near)
        wrong = (winding > 1.5) | (winding < -0.5)
        if wrong.any():
            place = tuple(float(f"{x:.6g}") for x in near[np.argmax(wrong)])
            raise MeshError(
                f"surface: crosses itself: it winds {round(winding[np.argmax(wrong)])} times round "
                f"{place}; wanted once round what is inside. Unite its pieces first"
            )


def _codes(points: Floats, triangles: Indices) -> Indices:
    """Return numbers along Morton's curve of the triangles' middles: near ones are near."""
    middles = points[triangles].mean(axis=1)
    low = middles.min(axis=0)
    extent = max(float((middles.max(axis=0) - low).max()), np.finfo(float).tiny)
    code = np.zeros(len(triangles), np.int64)
    for axis in range(3):
        bits = ((middles[:, axis] - low[axis]) / extent * (2**20 - 1)).astype(np.int64)
        # Two places are put between bits and the next, by halving (after G. M. Morton 1966).
        for shift, mask in (
            (32, 0x1F00000000FFFF),
            (16, 0x1F0000FF0000FF),
            (8, 0x100F00F00F00F00F),
            (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):
            bits = (bits | bits << shift) & mask
        code |= bits << axis
    return code
