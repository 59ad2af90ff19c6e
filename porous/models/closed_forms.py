"""What is known in closed form of systems whose level-1 cells lie side by side in the primitive.

Where every map sends a convex container of the primitive (its hull, or its box) into itself, and
the images of the container have no inner points in common, then so it is at every level: volumes
add up to (Σ|det Aᵢ|)ⁿ·V₀. Where the cells also share no area and the maps are similarities, so do
areas, (Σ rᵢ²)ⁿ·S₀, and convex cells are pieces of their own. For several states the sums run along
the transitions.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.models.dimension import ratios

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.models.automaton import Automaton
    from porous.models.primitive import Primitive

    Points = NDArray[np.float64]

TOLERANCE = 1e-9
"""Overlaps and overhangs up to this part of the primitive's size count as none."""

MOST_CHILDREN = 64
"""Beyond so many children of a state their pairs are not looked at, nor hulls of more corners."""


class ClosedForms(NamedTuple):
    """Volume, and area and number of pieces where they are known."""

    volume: float
    area: float | None
    pieces: int | None


class _Solid(NamedTuple):
    """A convex solid: corners, unit normals of faces, unit directions of edges; ball radius."""

    corners: Points
    normals: Points
    edges: Points
    radius: float


def closed_forms(automaton: Automaton, primitive: Primitive, level: int) -> ClosedForms | None:
    """Return what is known of the level's union of cells, or None where nothing is."""
    apart = _arrangement(automaton, primitive) if level else True
    if apart is None:
        return None
    dets = np.abs(np.linalg.det(automaton.maps[:, :, :3]))
    volume = _summed(automaton, dets, level) * primitive.volume
    if level == 0:
        return ClosedForms(volume, primitive.area, 1 if primitive.convex else None)
    scale = ratios(automaton)
    if scale is None or not apart:
        return ClosedForms(volume, None, None)
    area = _summed(automaton, scale**2, level) * primitive.area
    pieces = round(_summed(automaton, np.ones(len(dets)), level)) if primitive.convex else None
    return ClosedForms(volume, area, pieces)


def _summed(automaton: Automaton, weights: NDArray[np.float64], level: int) -> float:
    total = np.ones(len(automaton.states))
    for _ in range(level):
        deeper = np.zeros_like(total)
        for t, weight in zip(automaton.transitions, weights, strict=True):
            deeper[t.source] += weight * total[t.target]
        total = deeper
    return float(total[automaton.start])


def _arrangement(automaton: Automaton, primitive: Primitive) -> bool | None:
    """Return None where cells may overlap, else whether it is known that no two share area."""
    # Terminal cells are carried through: the argument would need them inside the others' images.
    if not all(0 < len(children) <= MOST_CHILDREN for children in automaton.children):
        return None
    if np.abs(np.linalg.det(automaton.maps[:, :, :3])).min() <= 0:
        return None
    similar = ratios(automaton) is not None
    for container in _containers(primitive, similar=similar):
        apart = _nested(automaton, container)
        if apart is not None:
            # Balls that do not overlap touch in points.
            return apart or (primitive.radius is not None and similar)
    return None


def _nested(automaton: Automaton, container: _Solid) -> bool | None:
    """Return None unless images lie side by side in the container, else whether none share area."""
    slack = TOLERANCE * (float(np.ptp(container.corners, axis=0).max()) + 2 * container.radius)
    apart = True
    for state in range(len(automaton.states)):
        chosen = [i for i, t in enumerate(automaton.transitions) if t.source == state]
        images = [_image(container, F) for F in automaton.maps[chosen]]
        if not all(_inside(image, container, slack) for image in images):
            return None
        for a, b in combinations(images, 2):
            shared = _shared(a, b, slack)
            if shared is None:
                return None
            apart = apart and not shared
    return apart


def _containers(primitive: Primitive, *, similar: bool) -> list[_Solid]:
    """Return convex solids that hold the primitive: its hull or itself, and its box."""
    from porous.models.primitive import convex_hull, named

    cube = _polyhedron(named("cube"))
    lower, upper = np.array(primitive.box.lower), np.array(primitive.box.upper)
    box = cube._replace(corners=lower + cube.corners * (upper - lower))
    if primitive.radius is not None:
        empty = np.zeros((0, 3))
        own = _Solid(primitive.points, empty, empty, primitive.radius)
        return [own, box] if similar else [box]
    if primitive.convex:
        return [_polyhedron(primitive), box]
    hull = convex_hull(primitive.points)
    return [_polyhedron(hull), box] if len(hull.points) <= MOST_CHILDREN else [box]


def _polyhedron(solid: Primitive) -> _Solid:
    ends = solid.points[solid.edges]
    edges = ends[:, 1] - ends[:, 0]
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    return _Solid(solid.points, solid.planes[:, :3], _directions(edges), 0.0)


def _directions(vectors: Points) -> Points:
    """Return unit vectors with those left out that are another's, or its opposite."""
    kept: list[Points] = []
    for vector in vectors:
        if all(abs(float(vector @ other)) < 1 - 1e-12 for other in kept):
            kept.append(vector)
    return np.array(kept).reshape(-1, 3)


def _image(solid: _Solid, F: Points) -> _Solid:
    A = F[:, :3]
    corners = solid.corners @ A.T + F[:, 3]
    if solid.radius:
        ratio = float(np.cbrt(abs(np.linalg.det(A))))
        return _Solid(corners, solid.normals, solid.edges, solid.radius * ratio)
    normals = solid.normals @ np.linalg.inv(A)
    edges = solid.edges @ A.T
    return _Solid(
        corners,
        normals / np.linalg.norm(normals, axis=1, keepdims=True),
        edges / np.linalg.norm(edges, axis=1, keepdims=True),
        0.0,
    )


def _inside(image: _Solid, whole: _Solid, slack: float) -> bool:
    if whole.radius:
        reach = np.linalg.norm(image.corners[0] - whole.corners[0]) + image.radius
        return bool(reach <= whole.radius + slack)
    most = (whole.corners @ whole.normals.T).max(axis=0)
    return bool(((image.corners @ whole.normals.T) <= most + slack).all())


def _shared(a: _Solid, b: _Solid, slack: float) -> bool | None:
    """Return whether two convex solids share area, or None where they share volume."""
    if a.radius:
        gap = float(np.linalg.norm(a.corners[0] - b.corners[0])) - a.radius - b.radius
        return None if gap < -slack else False
    axes = _candidates(a, b)
    pa, pb = a.corners @ axes.T, b.corners @ axes.T
    gaps = np.maximum(pb.min(axis=0) - pa.max(axis=0), pa.min(axis=0) - pb.max(axis=0))
    index = int(np.argmax(gaps))
    if gaps[index] < -slack:
        return None
    if gaps[index] > slack:
        return False
    below, above = (a, b) if pa[:, index].mean() < pb[:, index].mean() else (b, a)
    axis = axes[index]
    top, bottom = below.corners @ axis, above.corners @ axis
    return _faces_meet(
        below.corners[top > top.max() - 10 * slack],
        above.corners[bottom < bottom.min() + 10 * slack],
        axis,
        slack,
    )


def _candidates(a: _Solid, b: _Solid) -> Points:
    """Return the axes of which one separates two convex polyhedra that can be separated."""
    crosses = np.cross(a.edges[:, None], b.edges[None, :]).reshape(-1, 3)
    lengths = np.linalg.norm(crosses, axis=1)
    good = lengths > 1e-9
    return np.vstack([a.normals, b.normals, crosses[good] / lengths[good, None]])


def _faces_meet(a: Points, b: Points, normal: Points, slack: float) -> bool:
    """Tell whether two convex faces of one plane share area, given as points in any order."""
    if min(len(a), len(b)) < 3:
        return False
    # Any two directions that span the plane do.
    across = np.linalg.svd(normal[None])[2][1:]
    first, second = _outline(a @ across.T), _outline(b @ across.T)
    if first is None or second is None:
        return False
    # Two convex polygons share area unless an edge of one separates them.
    return all(_depth(p, q) > 10 * slack for p, q in ((first, second), (second, first)))


def _outline(points: Points) -> Points | None:
    """Return the corners of the convex hull in the plane, counter-clockwise; None if flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        return None


def _depth(p: Points, q: Points) -> float:
    """Return the least depth to which q reaches into p across one of p's edges."""
    edges = np.roll(p, -1, axis=0) - p
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return float(((p * normals).sum(axis=1)[:, None] - normals @ q.T).max(axis=1).min())
