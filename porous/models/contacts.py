"""Where cells touch in a point or an edge only: contacts of zero area.

Two convex cells meet in a convex set; it is found by clipping the edges of each against the other.
Where that set is flat or solid the two are joined, and joined near each of its points; where it is
a point or a segment they are not, unless other cells around join them there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.models.membership import check_invertible, placed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.models.primitive import Primitive

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

TOUCH = 1e-7
"""Cells closer than this touch, relative to the smaller one's radius."""

THIN = 1e-4
"""What two cells share is flat where it is wider than this, relative to the smaller radius."""

CHUNK = 1 << 22
"""How many numbers one step of the clipping holds."""


class _Cells(NamedTuple):
    corners: Floats
    """(k, n, 3)"""
    planes: Floats
    """(k, f, 4): unit normal and offset, inside where n·x ≤ d."""
    ends: Indices
    """(e, 2): corners of each edge."""
    centres: Floats
    radii: Floats


class _Meetings(NamedTuple):
    """Pairs of cells that touch: whether they are joined, and if not, from where to where."""

    pairs: Indices
    joined: NDArray[np.bool_]
    tips: Floats
    """(p, 2, 3): the ends of a segment, twice the same for a point."""


def contact_points(primitive: Primitive, frames: Floats) -> Floats:
    """Return the points where cells touch in a point or an edge without being joined there.

    Cells are joined where they share area or volume. For an edge both its ends are returned, but
    an end around which other cells join the two is not: a ball there would join nothing. Of
    edges that touch in part, the ends of the common part are returned. Cells of primitives that
    are not convex touch where corners coincide, and are joined where whole triangles do.

    Parameters
    ----------
    primitive
        What each cell is an image of.
    frames
        Affine maps of primitive coordinates to the world, shape (k, 3, 4).

    Returns
    -------
    array of shape (c, 3)
        In the frames' unit, in lexicographic order.

    Raises
    ------
    ModelError
        For balls under maps that are no similarities: ellipsoids.
    """
    frames = np.asarray(frames, dtype=np.float64)
    if primitive.radius is not None:
        found = _between_balls(primitive, frames)
    elif primitive.convex:
        found = _between_convex(primitive, frames)
    else:
        found = _between_meshes(primitive, frames)
    return found[np.lexsort(found.T[::-1])]


def planes_of(primitive: Primitive, frames: Floats) -> Floats:
    """Return the face planes (k, f, 4) of convex cells: n·x ≤ d inside, n of unit length."""
    check_invertible(frames)
    linear = frames[:, :, :3]
    normals = np.einsum("fj,kji->kfi", primitive.planes[:, :3], np.linalg.inv(linear))
    offsets = primitive.planes[:, 3] + np.einsum("kfi,ki->kf", normals, frames[:, :, 3])
    planes = np.concatenate([normals, offsets[:, :, None]], axis=2)
    return np.asarray(planes / np.linalg.norm(normals, axis=2, keepdims=True))


def neighbours(centres: Floats, radii: Floats) -> Indices:
    """Return the pairs (p, 2) of balls that touch or overlap, each once."""
    from scipy.spatial import cKDTree

    reach = 2 * radii.max(initial=0.0) * (1 + TOUCH)
    pairs: Indices = cKDTree(centres).query_pairs(reach, output_type="ndarray").astype(np.int64)
    a, b = pairs.T
    gaps = np.linalg.norm(centres[a] - centres[b], axis=1)
    near: Indices = pairs[gaps <= (radii[a] + radii[b]) * (1 + TOUCH)]
    return near


def _between_balls(primitive: Primitive, frames: Floats) -> Floats:
    scales = np.linalg.svd(frames[:, :, :3], compute_uv=False)
    if not (scales[:, 2] > (1 - TOUCH) * scales[:, 0]).all():
        raise ModelError(
            "contacts = 'fuse': the maps turn the ball into ellipsoids, whose contacts are not "
            "known; choose another primitive, or an offset"
        )
    assert primitive.radius is not None
    centres = placed(primitive.points, frames)[:, 0]
    radii = np.asarray(primitive.radius * scales[:, 0], dtype=np.float64)
    a, b = neighbours(centres, radii).T
    step = centres[b] - centres[a]
    gap = np.linalg.norm(step, axis=1)
    touch = gap >= (radii[a] + radii[b]) * (1 - TOUCH)
    touch &= gap > 0
    share = (radii[a] / (radii[a] + radii[b]))[touch, None]
    return _merged(centres[a][touch] + share * step[touch], radii.min() * THIN)


def _between_meshes(primitive: Primitive, frames: Floats) -> Floats:
    from scipy.sparse.csgraph import connected_components

    corners = placed(primitive.points, frames)
    size = np.ptp(corners, axis=1).max(axis=1).min()
    name = _clusters(corners.reshape(-1, 3), size * TOUCH).reshape(corners.shape[:2])
    triangles = np.sort(name[:, primitive.triangles], axis=2)
    # A slot is a corner of a cell; slots of cells that share a triangle at that corner are one.
    slots = np.arange(name.size).reshape(name.shape)
    cell_slots = _slots_sorted(name, slots, primitive.triangles).reshape(-1, 3)
    _, which = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    order = np.argsort(which, kind="stable")
    same = np.flatnonzero(np.diff(which[order]) == 0)
    a, b = cell_slots[order[same]].ravel(), cell_slots[order[same + 1]].ravel()
    group = connected_components(_links(a, b, name.size), directed=False)[1]
    used = np.unique(np.stack([name.ravel(), group]), axis=1)[0]
    several = np.flatnonzero(np.bincount(used, minlength=name.max() + 1) > 1)
    first = np.unique(name.ravel(), return_index=True)[1]
    return np.asarray(corners.reshape(-1, 3)[first[several]])


def _slots_sorted(name: Indices, slots: Indices, triangles: Indices) -> Indices:
    order = np.argsort(name[:, triangles], axis=2)
    return np.take_along_axis(slots[:, triangles], order, axis=2)


def _between_convex(primitive: Primitive, frames: Floats) -> Floats:
    cells = _cells(primitive, frames)
    meetings = _meetings(cells)
    points = meetings.tips[~meetings.joined].reshape(-1, 3)
    if not len(points):
        return np.zeros((0, 3))
    size = cells.radii.min() * THIN
    points = _merged(_at_corners(points, cells, size), size)
    cell, point = _members(cells, points)
    return points[_split(point, cell, meetings, len(points), len(frames))]


def _cells(primitive: Primitive, frames: Floats) -> _Cells:
    corners = placed(primitive.points, frames)
    centres = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    return _Cells(corners, planes_of(primitive, frames), primitive.edges, centres, radii)


def _meetings(cells: _Cells) -> _Meetings:
    pairs = neighbours(cells.centres, cells.radii)
    step = max(1, CHUNK // (len(cells.ends) * cells.planes.shape[1]))
    parts = [_meeting(cells, pairs[i : i + step]) for i in range(0, len(pairs), step)]
    if not parts:
        return _Meetings(pairs, np.zeros(0, dtype=bool), np.zeros((0, 2, 3)))
    return _Meetings(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _meeting(cells: _Cells, pairs: Indices) -> _Meetings:
    radius = np.minimum(*cells.radii[pairs.T])
    near = ~(_beyond(cells, pairs, radius) | _beyond(cells, pairs[:, ::-1], radius))
    pairs, radius = pairs[near], radius[near]
    sides = [_clipped(cells, p, radius) for p in (pairs, pairs[:, ::-1])]
    points, found = (np.concatenate(part, axis=1) for part in zip(*sides, strict=True))
    touch = found.any(axis=1)
    pairs, radius, points, found = pairs[touch], radius[touch], points[touch], found[touch]
    widths, tips = _extent(points, found)
    return _Meetings(pairs, widths[:, 1] > THIN * radius, tips)


def _beyond(cells: _Cells, pairs: Indices, radius: Floats) -> NDArray[np.bool_]:
    """Tell for which pairs a face plane of the first has the whole second cell outside."""
    planes, corners = cells.planes[pairs[:, 0]], cells.corners[pairs[:, 1]]
    depth = np.einsum("pfi,pni->pfn", planes[:, :, :3], corners).min(axis=2) - planes[:, :, 3]
    return np.asarray(depth.max(axis=1) > TOUCH * radius)


def _clipped(cells: _Cells, pairs: Indices, radius: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Clip the edges of the first cell of each pair against the second (Cyrus and Beck 1978).

    Returns both ends of what remains of each edge (p, 2e, 3), and which of them there are.
    """
    planes = cells.planes[pairs[:, 1]]
    start, stop = (cells.corners[pairs[:, 0]][:, cells.ends[:, i]] for i in (0, 1))
    slack = (TOUCH * radius)[:, None, None]
    above = [
        np.einsum("pei,pfi->pef", p, planes[:, :, :3]) - planes[:, None, :, 3] - slack
        for p in (start, stop)
    ]
    slope = above[0] - above[1]
    cut = np.divide(above[0], slope, out=np.zeros_like(slope), where=slope != 0)
    enter = np.where(above[0] > 0, np.where(slope > 0, cut, np.inf), 0.0).max(axis=2)
    leave = np.where(above[1] > 0, np.where(slope < 0, cut, -np.inf), 1.0).min(axis=2)
    ends = [start + t[:, :, None] * (stop - start) for t in _kept(enter, leave)]
    found = enter <= leave
    return np.concatenate(ends, axis=1), np.concatenate([found, found], axis=1)


def _kept(enter: Floats, leave: Floats) -> tuple[Floats, Floats]:
    return tuple(np.where(enter <= leave, t, 0.0) for t in (enter, leave))  # type: ignore[return-value]


def _extent(points: Floats, found: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Return the widths (p, 3) of point sets along their main axes, and the ends of the longest."""
    weight = found[:, :, None].astype(np.float64)
    mean = (points * weight).sum(axis=1) / weight.sum(axis=1)
    away = (points - mean[:, None]) * weight
    axes = np.linalg.eigh(np.einsum("pni,pnj->pij", away, away))[1][:, :, ::-1]
    along = np.einsum("pni,pij->pnj", away, axes)
    widths = np.ptp(along, axis=1)
    reach = np.stack([along[:, :, 0].min(axis=1), along[:, :, 0].max(axis=1)], axis=1)
    return widths, mean[:, None] + reach[:, :, None] * axes[:, None, :, 0]


def _at_corners(points: Floats, cells: _Cells, reach: float) -> Floats:
    """Move points onto corners of cells that lie closer than ``reach``."""
    from scipy.spatial import cKDTree

    corners = cells.corners.reshape(-1, 3)
    gap, nearest = cKDTree(corners).query(points, distance_upper_bound=reach)
    found = np.isfinite(gap)
    result = points.copy()
    result[found] = corners[nearest[found]]
    return result


def _merged(points: Floats, reach: float) -> Floats:
    first = np.unique(_clusters(points, reach), return_index=True)[1]
    return points[first]


def _clusters(points: Floats, reach: float) -> Indices:
    """Return the number of each point's cluster: chains of points closer than ``reach``."""
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    pairs = cKDTree(points).query_pairs(reach, output_type="ndarray")
    graph = _links(pairs[:, 0], pairs[:, 1], len(points))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _links(a: Indices, b: Indices, count: int) -> object:
    from scipy.sparse import coo_matrix

    return coo_matrix((np.ones(len(a), dtype=np.int8), (a, b)), shape=(count, count))


def _members(cells: _Cells, points: Floats) -> tuple[Indices, Indices]:
    """Return (cell, point) for each cell and each point that lies in it, by point."""
    from scipy.spatial import cKDTree

    tree, reach = cKDTree(cells.centres), cells.radii.max() * (1 + THIN)
    found = [(i, p) for p, near in enumerate(tree.query_ball_point(points, reach)) for i in near]
    cell, point = np.array(found, dtype=np.int64).reshape(-1, 2).T
    planes = cells.planes[cell]
    depth = np.einsum("mfi,mi->mf", planes[:, :, :3], points[point]) - planes[:, :, 3]
    inside = depth.max(axis=1) <= THIN * cells.radii[cell]
    return cell[inside], point[inside]


def _split(point: Indices, cell: Indices, meetings: _Meetings, points: int, cells: int) -> Indices:
    """Return the points around which the cells fall into several joined groups."""
    from scipy.sparse.csgraph import connected_components

    a, b = (np.array(part, dtype=np.int64) for part in _rivals(point))
    pairs = np.sort(meetings.pairs[meetings.joined], axis=1)
    known = np.unique(pairs[:, 0] * cells + pairs[:, 1])
    low, high = np.minimum(cell[a], cell[b]), np.maximum(cell[a], cell[b])
    linked = np.isin(low * cells + high, known)
    group = connected_components(_links(a[linked], b[linked], len(point)), directed=False)[1]
    of_point = np.unique(np.stack([point, group]), axis=1)[0]
    return np.flatnonzero(np.bincount(of_point, minlength=points) > 1)


def _rivals(point: Indices) -> Iterator[Indices]:
    """Return all pairs of entries that name the same point; ``point`` is sorted."""
    start = np.searchsorted(point, point, side="left")
    place = np.arange(len(point)) - start
    later = np.repeat(np.arange(len(point)), place)
    before = np.arange(len(later)) - np.repeat(np.cumsum(place) - place, place)
    yield start[later] + before
    yield later
