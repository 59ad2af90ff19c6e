"""Solids that touch in a point or an edge only, taken apart: each closed, no point shared.

A boolean engine may leave two solids that touch along an edge joined there by a seam of no width,
or not: that hangs on the order of its input. What is meant is decided here: around an edge the two
faces of one solid wedge belong together, and around a point each fan of such faces has a point of
its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError
from porous.values.surface_topology import joined

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

FLUSH = 1e-6
"""Two faces at an edge that enclose a smaller angle, in radians, lie on each other."""


def apart(points: Floats, triangles: Indices) -> tuple[Floats, Indices]:
    """Return a closed surface whose solid wedges hang together at edges and nowhere else.

    Points at the same place are taken as one first; triangles that name one twice vanish. Where
    two wedges along one edge end in the same points, because their solids are joined nearby,
    the edge gets a midpoint for each of them.

    Parameters
    ----------
    points
        Shape (n, 3); points at the same place carry the same numbers.
    triangles
        Shape (t, 3), closed, outward.

    Returns
    -------
    points, triangles
        A 2-manifold: every edge of two triangles, every point of one fan.

    Raises
    ------
    MeshError
        Where faces lie on each other, or solid and void do not alternate around an edge.
    """
    places, index = np.unique(points, axis=0, return_inverse=True)
    corners = index.reshape(-1)[triangles]
    a, b, c = corners.T
    corners = corners[(a != b) & (b != c) & (c != a)]
    side, other = _wedges(places, corners)
    fans = _fans(corners, side, other)
    source = np.empty(fans.max(initial=-1) + 1, dtype=np.int64)
    source[fans] = corners
    return _midpoints(places[source], fans, side, other)


def _wedges(points: Floats, triangles: Indices) -> tuple[Indices, Indices]:
    """Return the pairs of sides (3·triangle + corner) that bound one solid wedge."""
    start, stop = triangles, np.roll(triangles, -1, axis=1)
    low, high = np.minimum(start, stop).ravel(), np.maximum(start, stop).ravel()
    _, edge, uses = np.unique(low * len(points) + high, return_inverse=True, return_counts=True)
    ahead = (start < stop).ravel()
    angle = np.zeros(len(edge))
    crowded = np.flatnonzero(uses[edge] > 2)
    apex = np.roll(triangles, -2, axis=1).ravel()[crowded]
    angle[crowded] = _angles(points, low[crowded], high[crowded], apex)
    order = np.lexsort((ahead, angle, edge))
    return _paired(order, edge[order], angle[order], ahead[order], uses)


def _angles(points: Floats, low: Indices, high: Indices, apex: Indices) -> Floats:
    """Return the angle of each triangle about its edge, counted alike for all of one edge."""
    along = points[high] - points[low]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    least = np.abs(along).argmin(axis=1)
    first = np.cross(along, np.eye(3)[least])
    second = np.cross(along, first)
    spoke = points[apex] - points[low]
    return np.asarray(
        np.arctan2(np.einsum("ij,ij->i", spoke, second), np.einsum("ij,ij->i", spoke, first))
    )


def _paired(
    order: Indices, edge: Indices, angle: Floats, ahead: NDArray[np.bool_], uses: Indices
) -> tuple[Indices, Indices]:
    # Seen along the edge, a triangle that runs backwards has solid on its counter-clockwise side
    # and one that runs forwards on its clockwise side: the next one after the former is its mate.
    last = np.cumsum(uses) - 1
    following = np.arange(1, len(order) + 1)
    following[last] = last - uses + 1
    mate = following[~ahead]
    wedge = (angle[mate] - angle[~ahead]) % (2 * np.pi)
    # Only crowded edges have angles; a sheet folded onto itself encloses none or all.
    crowded = uses[edge[~ahead]] > 2
    flush = crowded & (np.minimum(wedge, 2 * np.pi - wedge) < FLUSH)
    if 2 * (~ahead).sum() != len(order) or not ahead[mate].all() or flush.any():
        raise MeshError("surface: solid and void do not alternate around some edges")
    gaps = (angle[following] - angle)[ahead] % (2 * np.pi)
    if ((uses[edge[ahead]] > 2) & (np.minimum(gaps, 2 * np.pi - gaps) < FLUSH)).any():
        raise MeshError("surface: some faces lie on each other")
    return order[~ahead], order[mate]


def _fans(triangles: Indices, side: Indices, other: Indices) -> Indices:
    """Return the fan of each corner: corners of one point, joined across wedges."""
    step = np.arange(triangles.size).reshape(-1, 3)
    end = np.roll(step, -1, axis=1).ravel()
    # The two sides run against each other: where one starts the other ends.
    first = np.concatenate([side, end[side]])
    second = np.concatenate([end[other], other])
    return joined(triangles.size, first, second).reshape(-1, 3)


def _midpoints(
    points: Floats, triangles: Indices, side: Indices, other: Indices
) -> tuple[Floats, Indices]:
    """Give the wedges of edges that still have more than two triangles midpoints of their own."""
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2))
    key = ends[:, 0] * len(points) + ends[:, 1]
    _, edge, uses = np.unique(key, return_inverse=True, return_counts=True)
    wedges = np.flatnonzero(uses[edge[side]] > 2)
    if not len(wedges):
        return points, triangles
    middle = np.full(triangles.size, -1)
    numbers = len(points) + np.arange(len(wedges))
    middle[side[wedges]] = middle[other[wedges]] = numbers
    added = points[ends[side[wedges]]].mean(axis=1)
    split = (middle.reshape(-1, 3) >= 0).any(axis=1)
    halves = [
        part
        for triangle, mids in zip(triangles[split], middle.reshape(-1, 3)[split], strict=True)
        for part in _divided(triangle.tolist(), mids.tolist())
    ]
    return np.vstack([points, added]), np.vstack([triangles[~split], halves])


def _divided(triangle: list[int], middles: list[int]) -> list[list[int]]:
    """Return the triangles of a triangle with midpoints (−1 for none) on its sides."""
    ring = [p for pair in zip(triangle, middles, strict=True) for p in pair if p >= 0]
    if len(ring) == 6:
        a, ab, b, bc, c, ca = ring
        return [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
    # A fan about a midpoint: no triangle has all its corners on one side.
    at = ring.index(next(p for p in middles if p >= 0))
    ring = ring[at:] + ring[:at]
    return [[ring[0], ring[i], ring[i + 1]] for i in range(1, len(ring) - 1)]
