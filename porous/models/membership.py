"""Which points lie in at least one of many cells."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.values.surface_topology import winding_numbers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.models.primitive import Primitive

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

SLACK = 1e-9
"""A cell's reach is widened by this, relative to its size, so that rounding loses no candidate."""

CHUNK = 1 << 20
"""How many pairs of a point and a face of a cell are looked at in one step."""


def covered(points: Floats, primitive: Primitive, frames: Floats) -> NDArray[np.bool_]:
    """Tell which points (n, 3) lie in the image of a polyhedron under any of frames (k, 3, 4)."""
    faces = primitive.planes if primitive.convex else primitive.triangles
    step = max(1, CHUNK // len(faces))
    result = np.zeros(len(points), dtype=bool)
    point, cell = candidates(points, primitive, frames)
    inverse = np.linalg.inv(frames[:, :, :3])
    for start in range(0, len(point), step):
        p, c = point[start : start + step], cell[start : start + step]
        local = np.einsum("mij,mj->mi", inverse[c], points[p] - frames[c, :, 3])
        result[p[contains(primitive, local)]] = True
    return result


def candidates(points: Floats, primitive: Primitive, frames: Floats) -> tuple[Indices, Indices]:
    """Return pairs of a point and a cell whose circumscribed ball holds it."""
    from scipy.spatial import cKDTree

    corners = placed(primitive.points, frames)
    centres = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centres[:, None], axis=2).max() * (1 + SLACK)
    found = cKDTree(centres).query_ball_point(points, reach)
    counts = np.fromiter(map(len, found), np.int64, len(points))
    cell = np.fromiter(itertools.chain.from_iterable(found), np.int64, counts.sum())
    return np.repeat(np.arange(len(points)), counts), cell


def placed(points: Floats, frames: Floats) -> Floats:
    """Return the images (k, n, 3) of points (n, 3) under frames (k, 3, 4)."""
    result: Floats = np.einsum("kij,nj->kni", frames[:, :, :3], points) + frames[:, None, :, 3]
    return result


def contains(primitive: Primitive, points: Floats) -> NDArray[np.bool_]:
    """Tell which points (n, 3) lie in a polyhedron, in its own coordinates."""
    if primitive.convex:
        heights = points @ primitive.planes[:, :3].T - primitive.planes[:, 3]
        return np.asarray(heights.max(axis=1) <= 0)
    return winding_numbers(primitive.points[primitive.triangles], points) > 0.5


def check_invertible(frames: Floats) -> None:
    """Raise ``ModelError`` where a map flattens its cell."""
    linear = frames[:, :, :3]
    size = np.linalg.norm(linear, axis=(1, 2))
    flat = np.flatnonzero(~(np.abs(np.linalg.det(linear)) > 1e-12 * size**3))
    if len(flat):
        raise ModelError(
            f"maps: {len(flat)} of {len(frames)} cells are flattened by their maps and have no "
            "inside; wanted matrices with a determinant other than zero"
        )
