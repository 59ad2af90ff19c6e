"""Triangles without height, taken out by joining points and flipping edges."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

THIN = 1e-5
"""Triangles less high than this part of their longest side are slivers."""

NEAR = 1e-6
"""Points nearer to each other than this part of the mean side are one."""

ROUNDS = 30


def without_slivers(points: Floats, triangles: Indices) -> tuple[Floats, Indices]:
    """Return points and triangles of the same closed 2-manifold, without slivers where possible.

    Two points in one place become one where that keeps the topology: where just two points are
    neighbours of both (Dey et al. 1999). A triangle with a corner in the middle of a side and the
    one across that side become two others, by turning the side; no edge is made that is there.
    Volume and area stay to within ``THIN``.

    Parameters
    ----------
    points
        Shape (n, 3).
    triangles
        Shape (t, 3), closed, oriented, 2-manifold.
    """
    triangles = triangles.copy()
    for _ in range(ROUNDS):
        joined = _join_some(points, triangles)
        triangles = joined if joined is not None else triangles
        if not _flip_some(points, triangles) and joined is None:
            break
    used, index = np.unique(triangles, return_inverse=True)
    return points[used], index.reshape(-1, 3)


def _join_some(points: Floats, triangles: Indices) -> Indices | None:
    """Return the triangles after ends of short edges were joined, or None where none were."""
    sides = points[triangles] - points[np.roll(triangles, -1, axis=1)]
    lengths = np.linalg.norm(sides, axis=2)
    triangle, side = np.nonzero(lengths <= NEAR * lengths.mean())
    if not len(triangle):
        return None
    order = np.argsort(triangles.ravel(), kind="stable") // 3
    first = np.searchsorted(np.sort(triangles.ravel()), np.arange(len(points) + 1))
    touched = np.zeros(len(triangles), bool)
    gone = np.zeros(len(triangles), bool)
    result = triangles.copy()
    for t, k in zip(triangle, side, strict=True):
        a, b = triangles[t, k], triangles[t, (k + 1) % 3]
        about_a, about_b = order[first[a] : first[a + 1]], order[first[b] : first[b + 1]]
        ring = np.union1d(about_a, about_b)
        shared = np.intersect1d(triangles[about_a], triangles[about_b])
        if touched[ring].any() or len(shared) != 4 or len(ring) < 6:
            continue
        touched[ring] = True
        gone[np.intersect1d(about_a, about_b)] = True
        result[about_b] = np.where(triangles[about_b] == b, a, triangles[about_b])
    return result[~gone] if gone.any() else None


def _flip_some(points: Floats, triangles: Indices) -> bool:
    """Flip longest sides of slivers where that harms nothing; tell whether there were any."""
    thin, side = _thin(points, triangles)
    if not len(thin):
        return False
    count = len(points)
    start, stop = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    keys = start * count + stop
    order = np.argsort(keys)
    ordered = keys[order]
    rows = np.arange(len(thin))
    a, b, m = (triangles[thin][rows, (side + k) % 3] for k in range(3))
    across = order[np.searchsorted(ordered, b * count + a)]
    other, d = across // 3, triangles.ravel()[across - across % 3 + (across + 2) % 3]
    fresh = ~_has(ordered, m * count + d) & ~_has(ordered, d * count + m) & (m != d)
    chosen = fresh & _shorter(points, a, b, m, d) & _upright(points, a, b, m, d)
    chosen = _apart(chosen, thin, other, np.minimum(m, d) * count + np.maximum(m, d))
    a, b, m, d, thin, other = (v[chosen] for v in (a, b, m, d, thin, other))
    triangles[thin] = np.stack([a, d, m], axis=1)
    triangles[other] = np.stack([d, b, m], axis=1)
    return bool(len(thin))


def _thin(points: Floats, triangles: Indices) -> tuple[Indices, Indices]:
    """Return which triangles are slivers and which side of each is longest."""
    corners = points[triangles]
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    longest = lengths.max(axis=1)
    twice = np.linalg.norm(_vectors(corners[:, 0], corners[:, 1], corners[:, 2]), axis=1)
    thin = np.flatnonzero(twice <= THIN * longest**2)
    return thin, lengths[thin].argmax(axis=1)


def _vectors(a: Floats, b: Floats, c: Floats) -> Floats:
    return np.asarray(np.cross(b - a, c - a))


def _has(ordered: Indices, wanted: Indices) -> NDArray[np.bool_]:
    place = np.minimum(np.searchsorted(ordered, wanted), len(ordered) - 1)
    return np.asarray(ordered[place] == wanted)


def _shorter(points: Floats, a: Indices, b: Indices, m: Indices, d: Indices) -> NDArray[np.bool_]:
    """Tell where the new side is shorter than the old one: so flips come to an end."""
    new, old = points[m] - points[d], points[a] - points[b]
    return np.asarray((new**2).sum(axis=1) < (old**2).sum(axis=1))


def _upright(points: Floats, a: Indices, b: Indices, m: Indices, d: Indices) -> NDArray[np.bool_]:
    """Tell where neither new triangle is turned against the proper old one."""
    pa, pb, pm, pd = (points[i] for i in (a, b, m, d))
    old = _vectors(pb, pa, pd)
    size = (old**2).sum(axis=1)
    ones = (_vectors(pa, pd, pm), _vectors(pd, pb, pm))
    return np.asarray(
        np.all([np.einsum("ij,ij->i", new, old) >= -THIN * size for new in ones], axis=0)
    )


def _apart(
    chosen: NDArray[np.bool_], first: Indices, second: Indices, edges: Indices
) -> NDArray[np.bool_]:
    """Choose flips that share no triangle and make no edge twice: the lowest of each."""
    rows = np.flatnonzero(chosen)
    owner = np.full(int(max(first.max(), second.max())) + 1, len(chosen))
    for triangle in (first, second):
        np.minimum.at(owner, triangle[rows], rows)
    rows = rows[(owner[first[rows]] == rows) & (owner[second[rows]] == rows)]
    rows = rows[np.unique(edges[rows], return_index=True)[1]]
    result = np.zeros(len(chosen), bool)
    result[rows] = True
    return result
