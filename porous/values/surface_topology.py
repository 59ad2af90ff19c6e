"""What the connectivity of a surface says: holes, orientation, pieces, Euler number."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.values.surface import SurfaceMesh

    Indices = NDArray[np.int64]


@dataclass(frozen=True)
class SurfaceDefects:
    """How many places of a surface are not those of a closed, oriented 2-manifold.

    True where there is any defect. Triangles that name a point twice take no part in the edges:
    the surface without them has the same shape.

    Parameters
    ----------
    open_edges
        Edges of one triangle only: the rim of a hole.
    nonmanifold_edges
        Edges of more than two triangles.
    misoriented_edges
        Edges of two or more triangles that do not run as often one way as the other.
    degenerate_triangles
        Triangles without area.
    nonmanifold_vertices
        Points whose triangles form more than one fan.
    first
        Where the first defect lies (in the order of the counts), or None.
    """

    open_edges: int
    nonmanifold_edges: int
    misoriented_edges: int
    degenerate_triangles: int
    nonmanifold_vertices: int
    first: tuple[float, float, float] | None

    def __bool__(self) -> bool:
        return self.first is not None


@dataclass(frozen=True)
class _Edges:
    """Undirected edges: ends (n, 2) rising, triangles of each, balance of directions."""

    ends: Indices
    uses: Indices
    balance: Indices
    of_side: Indices
    """For side 3·t + k, from corner k to corner k + 1 of triangle t: its edge."""


def defects(surface: SurfaceMesh) -> SurfaceDefects:
    """Count what keeps ``surface`` from being a closed, oriented 2-manifold."""
    triangles = _proper(surface)
    edges = _edges(triangles, len(surface.points))
    flat = np.flatnonzero(~(_squares(surface) > 0))
    split = _split_vertices(triangles, edges, len(surface.points))
    rim, many, bent = edges.uses == 1, edges.uses > 2, (edges.uses > 1) & (edges.balance != 0)
    middles = surface.points[edges.ends].mean(axis=1)
    places = [middles[rim], middles[many], middles[bent]]
    places += [surface.corners[flat].mean(axis=1), surface.points[split]]
    first = next((tuple(map(float, p[0])) for p in places if len(p)), None)
    rims, manies, bents, flats, splits = map(len, places)
    return SurfaceDefects(rims, manies, bents, flats, splits, first)  # type: ignore[arg-type]


def check_closed(surface: SurfaceMesh) -> None:
    """Raise ``MeshError`` where ``surface`` does not enclose a solid; the message names where.

    Closed means that every edge is run as often one way as the other, so four triangles may meet
    in an edge where two solids touch (``defects`` counts that); and that the enclosed volume is
    positive.

    Raises
    ------
    MeshError
        For no triangles, a hole, triangles that are turned round, a surface inside out.
    """
    if not len(surface.triangles):
        raise MeshError("surface: has no triangles; wanted a closed surface")
    if not _is_balanced(surface):
        _complain(surface)
    if not surface.volume > 0:
        raise MeshError(
            f"surface: encloses a volume of {surface.volume:.6g} {surface.unit}³; wanted a "
            "positive one: is it flat or inside out?"
        )


def _is_balanced(surface: SurfaceMesh) -> bool:
    """Tell whether every edge is run as often one way as the other: that needs two sorts alone."""
    start, stop = _sides(_proper(surface))
    along, against = start * len(surface.points), stop * len(surface.points)
    along += stop
    against += start
    del start, stop  # of large surfaces every array counts
    along.sort()
    against.sort()
    return np.array_equal(along, against)


def _complain(surface: SurfaceMesh) -> None:
    edges = _edges(_proper(surface), len(surface.points))
    rim = edges.ends[edges.uses == 1]
    if len(rim):
        raise MeshError(_hole_message(surface, rim))
    bent = edges.ends[edges.balance != 0]
    if len(bent):
        raise MeshError(
            f"surface: {len(bent)} edges where triangles are turned against each other, the first "
            f"{_segment(surface, bent[0])}; wanted every edge run as often one way as the other"
        )


def euler_number(surface: SurfaceMesh) -> int:
    """Return vertices − edges + triangles; vertices that no triangle uses do not count."""
    points = len(surface.points)
    keys = np.sort(_keys(surface.triangles, points))
    edges = int(np.count_nonzero(keys[1:] != keys[:-1])) + (len(keys) > 0)
    used = np.zeros(points, dtype=bool)
    used[surface.triangles] = True
    return int(used.sum()) - edges + len(surface.triangles)


def pieces(surface: SurfaceMesh) -> Indices:
    """Return the number of the piece that each triangle is of, shape (t,), from 0 upwards.

    Triangles that share an edge are of one piece; pieces are numbered by their first triangle.
    """
    side, other = _neighbours(_keys(surface.triangles, len(surface.points)))
    return joined(len(surface.triangles), side // 3, other // 3)


def joined(count: int, first: Indices, second: Indices) -> Indices:
    """Return which connected set each of ``count`` things is of, given the pairs that touch.

    Sets are numbered from 0 by their lowest member. Roots hook onto lower roots and paths are
    halved until nothing changes (Shiloach and Vishkin 1982), so the work is a few whole-array
    rounds.
    """
    root = np.arange(count)
    while len(first):
        a, b = root[first], root[second]
        apart = a != b
        first, second, a, b = first[apart], second[apart], a[apart], b[apart]
        np.minimum.at(root, np.maximum(a, b), np.minimum(a, b))
        while not np.array_equal(above := root[root], root):
            root = above
    number = np.cumsum(root == np.arange(count)) - 1
    result: Indices = number[root]
    return result


def _proper(surface: SurfaceMesh) -> Indices:
    a, b, c = surface.triangles.T
    result: Indices = surface.triangles[(a != b) & (b != c) & (c != a)]
    return result


def _squares(surface: SurfaceMesh) -> NDArray[np.float64]:
    # Relative to the longest side, so that neither tiny triangles nor huge ones mislead.
    a, b, c = np.moveaxis(surface.corners, 1, 0)
    sides = np.stack([b - a, c - a])
    scale = np.abs(sides).max(axis=(0, 2), initial=0.0)[:, None]
    u, v = np.divide(sides, scale, out=np.zeros_like(sides), where=scale > 0)
    return np.asarray((np.cross(u, v) ** 2).sum(axis=1))


def _sides(triangles: Indices) -> tuple[Indices, Indices]:
    """Return where the sides of triangles start and stop, (3 t,) each: side 3·t + k at corner k."""
    return triangles.ravel(), triangles[:, (1, 2, 0)].ravel()


def _keys(triangles: Indices, points: int) -> Indices:
    start, stop = _sides(triangles)
    result: Indices = np.minimum(start, stop) * points + np.maximum(start, stop)
    return result


def _edges(triangles: Indices, points: int) -> _Edges:
    keys = _keys(triangles, points)
    found, of_side, uses = np.unique(keys, return_inverse=True, return_counts=True)
    start, stop = _sides(triangles)
    signs = np.where(start < stop, 1.0, -1.0)
    balance = np.bincount(of_side, weights=signs, minlength=len(found)).astype(np.int64)
    ends = np.stack(np.divmod(found, max(points, 1)), axis=1)
    return _Edges(ends, uses, balance, of_side)


def _neighbours(edges: Indices) -> tuple[Indices, Indices]:
    """Return pairs of sides of one edge: each side with the next of its edge, told by a number."""
    order = np.argsort(edges, kind="stable")
    found = edges[order]
    same = np.flatnonzero(found[1:] == found[:-1])
    del found
    return order[same], order[same + 1]


def _split_vertices(triangles: Indices, edges: _Edges, points: int) -> Indices:
    """Return the points whose corners do not form one fan: corners meet across shared sides."""
    corner = triangles.ravel()
    step = np.arange(len(corner))
    step += np.where(step % 3 == 2, -2, 1)  # the corner where side k ends
    side, other = _neighbours(edges.of_side)
    turned = corner[side] != corner[other]
    first = np.concatenate([side, step[side]])
    second = np.concatenate(
        [np.where(turned, step[other], other), np.where(turned, other, step[other])]
    )
    fan = joined(len(corner), first, second)
    fans = np.zeros(fan.max(initial=-1) + 1, dtype=np.int64)
    fans[fan] = corner
    return np.flatnonzero(np.bincount(fans, minlength=points) > 1)


def _hole_message(surface: SurfaceMesh, rim: Indices) -> str:
    ends, index = np.unique(rim, return_inverse=True)
    index = index.reshape(rim.shape)
    holes = int(joined(len(ends), index[:, 0], index[:, 1]).max()) + 1
    what = "a hole" if holes == 1 else f"{holes} holes"
    return (
        f"surface: has {what}: {len(rim)} edges of one triangle only, the first "
        f"{_segment(surface, rim[0])}; wanted a closed surface"
    )


def _segment(surface: SurfaceMesh, ends: Indices) -> str:
    a, b = ("(" + ", ".join(f"{v:.6g}" for v in surface.points[i]) + ")" for i in ends)
    return f"from {a} to {b}"


def winding_numbers(
    corners: NDArray[np.float64], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return how often triangles (t, 3, 3) wind round each point (n, 3), shape (n,).

    A. van Oosterom and J. Strackee 1983, IEEE Trans. Biomed. Eng. 30:125: 1 inside, 0 outside.
    """
    a, b, c = (corners[None, :, i] - points[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    ab, bc, ca = ((u * v).sum(axis=2) for u, v in ((a, b), (b, c), (c, a)))
    triple = (a * np.cross(b, c)).sum(axis=2)
    angle = np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb)
    return np.asarray(angle.sum(axis=1) / (2 * np.pi))
