"""Lines through simplices: spans along z of tetrahedra, and of balls swept over simplices.

A line meets a convex body in one span, so planes cut spans and parts join them. Lengths of
tetrahedra are in voxels of the whole lattice, relative to a corner; those of swept simplices in the
world, relative to a corner. A sample's numbers are the same whoever's tile it lies in.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import columns, full, kernel, source, stroke
from porous.kernels.pieces import CLOSED

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.kernels.pieces import Window

    Floats = NDArray[np.float64]

SINGULAR = 1e-13
"""A tetrahedron of which |det| is below this part of its edges' norm cubed has no volume."""

SHARP = 0.1
"""Tetrahedra with heights below this part of their edges are cut off at edges and corners too."""

VERTICAL = 1e-12
"""Planes with normals of a smaller z are parallel to z."""

PLANES = 50
"""Most planes of one body: two per facet, six per edge, four sides of its box."""


BATCH = 1 << 22
"""Lines of one call, about: well below half a second."""


class Crowd(NamedTuple):
    """Simplices of one kind in the world, and which of them are asked.

    ``corners`` (k, n, 3); ``radii`` (k,) of the balls that are swept over them; ``blocks`` (b,)
    are the numbers of the blocks of ``size`` consecutive ones that are asked.
    """

    corners: Floats
    radii: Floats
    blocks: NDArray[np.int64]
    size: int


@kernel
def _add(planes, count, nx, ny, nz, places, half):
    # The half-space with a normal that just holds four corners, grown by a voxel or not at all.
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if not length > 0.0:
        return count
    nx, ny, nz = nx / length, ny / length, nz / length
    most = -np.inf
    for v in range(4):
        most = max(most, nx * places[v, 0] + ny * places[v, 1] + nz * places[v, 2])
    planes[count, 0], planes[count, 1], planes[count, 2] = nx, ny, nz
    planes[count, 3] = most + half * (abs(nx) + abs(ny) + abs(nz)) + CLOSED
    return count + 1


@kernel
def _facets(planes, places, half, both):
    # The planes of the facets, and the least height over the longest edge.
    count, widest, longest = 0, 0.0, 0.0
    volume = 0.0
    for f in range(4):
        a, b, c = places[(f + 1) % 4], places[(f + 2) % 4], places[(f + 3) % 4]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        d = places[f]
        wx, wy, wz = d[0] - a[0], d[1] - a[1], d[2] - a[2]
        side = nx * wx + ny * wy + nz * wz
        volume = max(volume, abs(side))
        widest = max(widest, nx * nx + ny * ny + nz * nz)
        longest = max(longest, ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz)
        if side > 0.0:
            nx, ny, nz = -nx, -ny, -nz
        count = _add(planes, count, nx, ny, nz, places, half)
        if both:
            count = _add(planes, count, -nx, -ny, -nz, places, half)
    return count, volume, np.sqrt(widest * longest)


@kernel
def _chamfers(planes, count, places):
    # Planes that touch an edge or a corner only: facets that are almost parallel and grown by the
    # slack meet far away from the body.
    for a in range(4):
        sx, sy, sz = 0.0, 0.0, 0.0
        for b in range(4):
            ux = places[b, 0] - places[a, 0]
            uy = places[b, 1] - places[a, 1]
            uz = places[b, 2] - places[a, 2]
            length = np.sqrt(ux * ux + uy * uy + uz * uz)
            if a == b or length == 0.0:
                continue
            ux, uy, uz = ux / length, uy / length, uz / length
            sx, sy, sz = sx - ux, sy - uy, sz - uz
            if b > a:
                ex, ey, ez = 0.0, 0.0, 0.0
                for c in range(4):
                    wx = places[c, 0] - places[a, 0]
                    wy = places[c, 1] - places[a, 1]
                    wz = places[c, 2] - places[a, 2]
                    along = wx * ux + wy * uy + wz * uz
                    wx, wy, wz = wx - along * ux, wy - along * uy, wz - along * uz
                    across = np.sqrt(wx * wx + wy * wy + wz * wz)
                    if c not in (a, b) and across > 0.0:
                        ex, ey, ez = ex - wx / across, ey - wy / across, ez - wz / across
                count = _add(planes, count, ex, ey, ez, places, 0.0)
        count = _add(planes, count, sx, sy, sz, places, 0.0)
    return count


@kernel
def _products(planes, count, places, half):
    # Planes along an edge of the tetrahedron and one of the voxel.
    for a in range(4):
        for b in range(a + 1, 4):
            ux = places[b, 0] - places[a, 0]
            uy = places[b, 1] - places[a, 1]
            uz = places[b, 2] - places[a, 2]
            for sign in (-1.0, 1.0):
                count = _add(planes, count, 0.0, sign * uz, -sign * uy, places, half)
                count = _add(planes, count, -sign * uz, 0.0, sign * ux, places, half)
                count = _add(planes, count, sign * uy, -sign * ux, 0.0, places, half)
    return count


@kernel
def _sides(planes, count, places, half):
    for sign in (-1.0, 1.0):
        count = _add(planes, count, sign, 0.0, 0.0, places, half)
        count = _add(planes, count, 0.0, sign, 0.0, places, half)
    return count


@kernel
def _flat(corners):
    # Whether a tetrahedron has no volume, whatever the lattice.
    a, b, c = corners[1] - corners[0], corners[2] - corners[0], corners[3] - corners[0]
    volume = (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
    squared = 0.0
    for axis in range(3):
        squared += a[axis] ** 2 + b[axis] ** 2 + c[axis] ** 2
    return not abs(volume) > SINGULAR * squared * np.sqrt(squared)


@kernel
def _sort(planes, count, rows, forms, shifts):
    # Planes over z as forms h − p x − q y: those from above first, those from below from the end
    # on, and those along z behind the former. How a form changes from row to row is written down.
    above, below, beside = 0, 0, 0
    for f in range(count):
        if planes[f, 2] >= VERTICAL:
            steep, at = 1.0 / planes[f, 2], above
            above += 1
        elif planes[f, 2] <= -VERTICAL:
            steep, at = 1.0 / planes[f, 2], PLANES + below
            below += 1
        else:
            steep, at = 1.0, 2 * PLANES + beside
            beside += 1
        forms[at, 0], forms[at, 1] = planes[f, 0] * steep, planes[f, 1] * steep
        forms[at, 2] = planes[f, 3] * steep
        for r in range(rows.shape[0]):
            shifts[at, r] = forms[at, 0] * rows[r, 0] + forms[at, 1] * rows[r, 1]
    return above, below, beside


@kernel
def _cut(forms, shifts, counts, x, y, z, lows, highs):
    # Cut the spans of a column's lines by all planes; x, y, z: from the corner to the column.
    above, below, beside = counts
    rows = lows.shape[0]
    for f in range(2 * PLANES, 2 * PLANES + beside):
        rest = forms[f, 2] - forms[f, 0] * x - forms[f, 1] * y
        for r in range(rows):
            if rest - shifts[f, r] < 0.0:
                highs[r] = -np.inf
    for f in range(above):
        rest = z + forms[f, 2] - forms[f, 0] * x - forms[f, 1] * y
        for r in range(rows):
            place = rest - shifts[f, r]
            highs[r] = place if place < highs[r] else highs[r]
    for f in range(PLANES, PLANES + below):
        rest = z + forms[f, 2] - forms[f, 0] * x - forms[f, 1] * y
        for r in range(rows):
            place = rest - shifts[f, r]
            lows[r] = place if place > lows[r] else lows[r]


@kernel
def _strokes(column, start, lows, highs, depths):
    for r in range(lows.shape[0]):
        if lows[r] <= highs[r]:
            stroke(column, start, lows[r], highs[r], depths, r)


@kernel
def _tetrahedra(
    masks, start, rows, depths, corners, blocks, size, origin, spacing, at, budget, cover
):
    # Sample tetrahedra, or mark the voxels that they touch: a voxel meets a body where its centre
    # lies in their sum, and that is bounded by facets of both and products of an edge of each.
    # Stop after a budget of lines; return where.
    everything = ~np.uint64(0) >> np.uint64(64 - depths.size)
    lines, half = 0, 0.5 if cover else 0.0
    planes, box, places = np.empty((PLANES, 4)), np.empty(6), np.empty((4, 3))
    forms, shifts = np.empty((3 * PLANES, 3)), np.empty((3 * PLANES, rows.shape[0]))
    lows, highs = np.empty(rows.shape[0]), np.empty(rows.shape[0])
    while at < blocks.shape[0] * size and lines < budget:
        p = blocks[at // size] * size + at % size
        at += 1
        if p >= corners.shape[0] or (not cover and _flat(corners[p])):
            continue
        for axis in range(3):
            box[axis], box[axis + 3] = 0.0, 0.0
            for v in range(4):
                place = (corners[p, v, axis] - corners[p, 0, axis]) / spacing[axis]
                places[v, axis] = place
                box[axis] = min(box[axis], place)
                box[axis + 3] = max(box[axis + 3], place)
            middle = (corners[p, 0, axis] - origin[axis]) / spacing[axis]
            box[axis] += middle - half - 2 * CLOSED
            box[axis + 3] += middle + half + 2 * CLOSED
        x0, y0, x1, y1 = columns(box, start, masks.shape)
        if x1 < x0 or y1 < y0:
            continue
        count, volume, extent = _facets(planes, places, half, cover)
        if cover:
            count = _products(planes, count, places, half)
        elif volume < SHARP * extent:
            count = _chamfers(planes, count, places)
        if cover or volume < SHARP * extent:
            count = _sides(planes, count, places, half)
        counts = _sort(planes, count, rows, forms, shifts)
        ox = (corners[p, 0, 0] - origin[0]) / spacing[0]
        oy = (corners[p, 0, 1] - origin[1]) / spacing[1]
        oz = (corners[p, 0, 2] - origin[2]) / spacing[2]
        lines += (x1 - x0 + 1) * (y1 - y0 + 1) * rows.shape[0]
        for i in range(x0, x1 + 1):
            for j in range(y0, y1 + 1):
                column = masks[i - start[0], j - start[1]]
                if full(column, start[2], box[2], box[5], everything):
                    continue
                lows[:], highs[:] = box[2], box[5]
                _cut(forms, shifts, counts, i - ox, j - oy, oz, lows, highs)
                _strokes(column, start[2], lows, highs, depths)
    return at


@kernel
def _between(slope, inverse, value, most, low, high):
    # The part of a span where 0 ≤ value + slope z ≤ most; an empty one has its ends swapped.
    if abs(slope) < VERTICAL:
        if value < 0.0 or value > most:
            return np.inf, -np.inf
        return low, high
    first, second = -value * inverse, (most - value) * inverse
    return max(low, min(first, second)), min(high, max(first, second))


@kernel
def _rods(rods, places):
    # Of each corner, and the edge from it to the next: the place, the edge's direction, its length,
    # the squared part of the direction across z, the inverses of that and of the part along z.
    n = places.shape[0]
    for v in range(n):
        p, q = places[v], places[v if n == 2 and v == 0 else v - 1]
        ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        length = np.sqrt(ux * ux + uy * uy + uz * uz)
        rods[v, :3], rods[v, 3:] = p, 0.0
        if length > 0.0:
            ux, uy, uz = ux / length, uy / length, uz / length
            flat = ux * ux + uy * uy
            rods[v, 3], rods[v, 4], rods[v, 5], rods[v, 6] = ux, uy, uz, length
            rods[v, 7], rods[v, 8], rods[v, 9] = flat, 1.0 / flat, 1.0 / uz


@kernel
def _round_rod(rod, squared, x, y, low, high):
    # Join the span of a ball about a corner, and of the cylinder about its edge, on the line
    # through (x, y).
    x, y = x - rod[0], y - rod[1]
    rest = squared - x * x - y * y
    if rest >= 0.0:
        root = np.sqrt(rest)
        low, high = min(low, rod[2] - root), max(high, rod[2] + root)
    across = x * rod[4] - y * rod[3]
    rest = rod[7] * squared - across * across
    if rod[7] < VERTICAL * VERTICAL or rest < 0.0:
        return low, high  # along z the balls at both ends hold the whole span
    root, along = np.sqrt(rest), x * rod[3] + y * rod[4]
    first, last = (along * rod[5] - root) * rod[8], (along * rod[5] + root) * rod[8]
    first, last = _between(rod[5], rod[9], along, rod[6], first, last)
    if first <= last:
        low, high = min(low, rod[2] + first), max(high, rod[2] + last)
    return low, high


@kernel
def _walls(walls, places):
    # Of a triangle: the rows of forms that vanish on its sides, positive within, and on its plane,
    # unit normals, and the inverses of their slopes. Whether it has an area.
    a, b, c = places[0], places[1], places[2]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area = np.sqrt(nx * nx + ny * ny + nz * nz)
    size = ux * ux + uy * uy + uz * uz + vx * vx + vy * vy + vz * vz
    if not area > 1e-12 * size:
        return False
    nx, ny, nz = nx / area, ny / area, nz / area
    for k in range(3):
        p, q = places[k], places[(k + 1) % 3]
        ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        sx, sy, sz = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux
        length = np.sqrt(sx * sx + sy * sy + sz * sz)
        sx, sy, sz = sx / length, sy / length, sz / length
        walls[k, 0], walls[k, 1], walls[k, 2] = sx, sy, sz
        walls[k, 3], walls[k, 4] = -(sx * p[0] + sy * p[1] + sz * p[2]), 1.0 / sz
    walls[3, 0], walls[3, 1], walls[3, 2] = nx, ny, nz
    walls[3, 3], walls[3, 4] = -(nx * a[0] + ny * a[1] + nz * a[2]), 1.0 / nz
    return True


@kernel
def _slab(walls, radius, x, y):
    # The span of a triangle thickened to both sides; whether its ends lie on those.
    low, high = -np.inf, np.inf
    for k in range(3):
        value = walls[k, 0] * x + walls[k, 1] * y + walls[k, 3]
        low, high = _between(walls[k, 2], walls[k, 4], value, np.inf, low, high)
    value = walls[3, 0] * x + walls[3, 1] * y + walls[3, 3] + radius
    first, last = _between(walls[3, 2], walls[3, 4], value, 2.0 * radius, -np.inf, np.inf)
    whole = low <= first and first <= last and last <= high
    low, high = max(low, first), min(high, last)
    if low <= high:
        return low, high, whole
    return np.inf, -np.inf, False


@kernel
def _fence(fence, rods, radius, width, depth):
    # Half-planes a x + b y ≤ c that hold the middles of the columns which a body can reach: two for
    # each edge, seen along z.
    n = rods.shape[0]
    for v in range(n):
        flat = np.sqrt(rods[v, 7])
        fence[v, :] = 0.0
        if flat > 1e-6:
            a, b = rods[v, 4] / flat, -rods[v, 3] / flat
            least, most = np.inf, -np.inf
            for w in range(n):
                place = a * rods[w, 0] + b * rods[w, 1]
                least, most = min(least, place), max(most, place)
            reach = radius + 0.5 * (abs(a) * width + abs(b) * depth) * (1 + 1e-9)
            fence[v, 0], fence[v, 1] = a, b
            fence[v, 2], fence[v, 3] = least - reach, most + reach


@kernel
def _fenced_out(fence, x, y):
    for v in range(fence.shape[0]):
        place = fence[v, 0] * x + fence[v, 1] * y
        if place < fence[v, 2] or place > fence[v, 3]:
            return True
    return False


@kernel
def _swept(
    masks, start, rows, depths, corners, radii, more, blocks, size, origin, spacing, at, budget
):
    # The sum of a convex body and a ball is convex: on a line the spans of its parts, balls,
    # cylinders and slabs, make one. Stop after a budget of lines; return where.
    everything = ~np.uint64(0) >> np.uint64(64 - depths.size)
    lines, n = 0, corners.shape[1]
    box, places, rods, walls = np.empty(6), np.empty((n, 3)), np.empty((n, 10)), np.empty((4, 5))
    fence = np.empty((n, 4))
    lows, highs = np.empty(rows.shape[0]), np.empty(rows.shape[0])
    while at < blocks.shape[0] * size and lines < budget:
        p = blocks[at // size] * size + at % size
        at += 1
        if p >= corners.shape[0] or not radii[p] + more > 0.0:
            continue
        radius = radii[p] + more
        for axis in range(3):
            box[axis], box[axis + 3] = 0.0, 0.0
            for v in range(n):
                place = corners[p, v, axis] - corners[p, 0, axis]
                places[v, axis] = place
                box[axis] = min(box[axis], place)
                box[axis + 3] = max(box[axis + 3], place)
            middle = corners[p, 0, axis] - origin[axis]
            box[axis] = (box[axis] + middle - radius) / spacing[axis] - 2 * CLOSED
            box[axis + 3] = (box[axis + 3] + middle + radius) / spacing[axis] + 2 * CLOSED
        x0, y0, x1, y1 = columns(box, start, masks.shape)
        if x1 < x0 or y1 < y0:
            continue
        _rods(rods, places)
        _fence(fence, rods, radius, spacing[0], spacing[1])
        wide = n == 3 and _walls(walls, places)
        ox = (corners[p, 0, 0] - origin[0]) / spacing[0]
        oy = (corners[p, 0, 1] - origin[1]) / spacing[1]
        oz = (corners[p, 0, 2] - origin[2]) / spacing[2]
        lines += (x1 - x0 + 1) * (y1 - y0 + 1) * rows.shape[0]
        for i in range(x0, x1 + 1):
            for j in range(y0, y1 + 1):
                x, y = (i + 0.5 - ox) * spacing[0], (j + 0.5 - oy) * spacing[1]
                if _fenced_out(fence, x, y):
                    continue
                column = masks[i - start[0], j - start[1]]
                if full(column, start[2], box[2], box[5], everything):
                    continue
                for r in range(rows.shape[0]):
                    x = (i + rows[r, 0] - ox) * spacing[0]
                    y = (j + rows[r, 1] - oy) * spacing[1]
                    low, high, done = np.inf, -np.inf, False
                    if wide:
                        low, high, done = _slab(walls, radius, x, y)
                    for v in range(0 if done else n):
                        low, high = _round_rod(rods[v], radius * radius, x, y, low, high)
                    lows[r] = oz + low / spacing[2] - CLOSED
                    highs[r] = oz + high / spacing[2] + CLOSED
                _strokes(column, start[2], lows, highs, depths)
    return at


def paint_tetrahedra(
    window: Window, origin: Floats, spacing: Floats, crowd: Crowd, *, cover: bool = False
) -> None:
    """Set the samples in solid tetrahedra, or mark the voxels that they touch.

    Samples within ``CLOSED`` voxels of a tetrahedron are in it; flat ones have none, but they do
    touch voxels. To mark, the window has one sample in a voxel's middle; radii are not asked.
    """
    _in_turns(window, crowd, _tetrahedra, (), (origin, spacing), (cover,))


def paint_swept(
    window: Window, origin: Floats, spacing: Floats, crowd: Crowd, *, more: float = 0.0
) -> None:
    """Set the samples within their radius and ``more`` of points, segments or triangles."""
    arrays = source(crowd.radii, np.float64), float(more)
    _in_turns(window, crowd, _swept, arrays, (origin, spacing), ())


def _in_turns(window, crowd, paint, before, lattice, after):
    """Call a kernel for about ``BATCH`` lines at a time, so that Python is asked in between."""
    arrays = (
        source(window.start, np.int64),
        source(window.rows, np.float64),
        source(window.depths, np.float64),
        source(crowd.corners, np.float64),
        *before,
        source(crowd.blocks, np.int64),
        crowd.size,
        *(source(values, np.float64) for values in lattice),
    )
    at = 0
    while at < len(crowd.blocks) * crowd.size:
        at = paint(window.masks, *arrays, at, BATCH, *after)
