"""How well shaped the elements of a volume mesh are: angles, Jacobians, edges; cell by cell.

Elements with nodes along their edges are told by their corners. Sources: P. M. Knupp 2003, Finite
Elements in Analysis and Design 39:217 (Jacobians); C. J. Stimpson and others 2007, The Verdict
geometric quality library, SAND2007-1751 (edge and aspect ratio).
"""

from __future__ import annotations

import math
from functools import cache
from itertools import pairwise
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.values import SHAPES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from porous.values import VolumeMesh

    Floats = NDArray[np.float64]

SLAB = 1 << 13
"""Cells that are looked at together: what is known of them stays near the processor."""


class _Regular(NamedTuple):
    """What makes a regular element's numbers 1."""

    jacobian: float
    """Multiplies the determinant of a corner's edges of length 1."""
    slimness: float
    """Divides longest edge times surface over three volumes."""


REGULAR = MappingProxyType(
    {
        4: _Regular(math.sqrt(2), 2 * math.sqrt(6)),
        6: _Regular(2 / math.sqrt(3), (4 * math.sqrt(3) + 2) / 3),
        8: _Regular(1.0, 2.0),
    }
)
"""By the number of an element's corners; all edges of a regular one have the same length."""


class Quality(NamedTuple):
    """What is known of each cell, arrays of shape (cells,)."""

    smallest_angle: Floats
    """Between two of its faces, in degrees; bent faces by their tangents at each corner."""
    largest_angle: Floats
    jacobian: Floats
    """Least over its corners: determinant of the three edges over their lengths, 1 is regular."""
    edge_ratio: Floats
    """Longest edge over shortest."""
    aspect_ratio: Floats
    """Longest edge times surface over three volumes, over the same of a regular element: of
    tetrahedra, longest edge over 2√6 times the inscribed ball's radius."""


class _Frame(NamedTuple):
    """Which edges an element has, and which meet at each corner."""

    edges: tuple[tuple[int, int], ...]
    corners: tuple[tuple[int, tuple[int, int, int]], ...]
    """Each corner with its neighbours, in the order in which the faces about it turn."""
    parts: tuple[tuple[float, float, float], ...]
    """What the parallelograms at a corner are of faces: a triangle has three, each twice it."""


def quality(mesh: VolumeMesh, volumes: Floats) -> Quality:
    """Return how well shaped each cell of a mesh is, given the cells' volumes; slab by slab."""
    count = mesh.cells
    found = Quality(*(np.empty(count) for _ in Quality._fields))
    start = 0
    for block in mesh.blocks:
        linear = SHAPES[block.shape].linear or block.shape
        frame, corners = _frame(linear), SHAPES[linear].nodes
        for first in range(0, len(block.cells), SLAB):
            cells = block.cells[first : first + SLAB, :corners]
            # Corner, axis, cell: each coordinate of a slab lies together.
            places = np.ascontiguousarray(np.moveaxis(mesh.points[cells], 0, 2))
            own = slice(start + first, start + first + len(cells))
            for array, values in zip(found, _of_slab(frame, places, volumes[own]), strict=True):
                array[own] = values
        start += len(block.cells)
    return found


@cache
def _frame(shape: str) -> _Frame:
    faces = SHAPES[shape].faces
    pairs = {(min(p), max(p)) for face in faces for p in pairwise((*face, face[0]))}
    corners, parts = [], []
    for corner in range(SHAPES[shape].nodes):
        follows = {
            face[face.index(corner) - 1]: face[(face.index(corner) + 1) % len(face)]
            for face in faces
            if corner in face
        }
        a = min(follows)
        near = (a, follows[a], follows[follows[a]])
        corners.append((corner, near))
        # Opposite each way lies the face of the two others.
        sizes = [_size(faces, {corner, *near} - {way}) for way in near]
        parts.append((sizes[0], sizes[1], sizes[2]))
    return _Frame(tuple(sorted(pairs)), tuple(corners), tuple(parts))


def _size(faces: tuple[tuple[int, ...], ...], three: set[int]) -> float:
    face = next(face for face in faces if three <= set(face))
    return 1 / 6 if len(face) == 3 else 1 / 4


def _of_slab(frame: _Frame, places: Floats, volumes: Floats) -> tuple[Floats, ...]:
    """Return what ``Quality`` holds, of cells given as (corner, axis, cell)."""
    lengths = {edge: _norm(places[edge[1]] - places[edge[0]]) for edge in frame.edges}
    count = places.shape[2]
    least, most, jacobian = (np.full(count, start) for start in (1.0, -1.0, np.inf))
    faces = np.zeros(count)
    for (corner, near), parts in zip(frame.corners, frame.parts, strict=True):
        ways = [places[n] - places[corner] for n in near]
        long = np.prod([lengths[min(corner, n), max(corner, n)] for n in near], axis=0)
        normals = [_cross(ways[i - 2], ways[i - 1]) for i in range(3)]
        sizes = [_norm(normal) for normal in normals]
        faces += sum(size * part for size, part in zip(sizes, parts, strict=True))
        jacobian = np.minimum(jacobian, _ratio(_dot(ways[0], normals[0]), long, 0.0))
        for i in range(3):
            # Two faces meet at an edge: both normals turn the same way about it, or against it.
            both = -_dot(normals[i - 1], normals[i - 2])
            size = sizes[i - 1] * sizes[i - 2]
            least = np.minimum(least, _ratio(both, size, -1.0))
            most = np.maximum(most, _ratio(both, size, 1.0))
    raw = np.stack(list(lengths.values()))
    longest, shortest = raw.max(axis=0), raw.min(axis=0)
    smallest, largest = (np.degrees(np.arccos(np.clip(c, -1, 1))) for c in (most, least))
    corners = len(places)
    slim = _ratio(longest * faces, 3 * np.abs(volumes), np.inf)
    return (
        smallest,
        largest,
        jacobian * REGULAR[corners].jacobian,
        _ratio(longest, shortest, np.inf),
        slim / REGULAR[corners].slimness,
    )


def _cross(u: Floats, v: Floats) -> Floats:
    """Return the cross products of vectors given as (axis, cell)."""
    x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    return np.stack([x, y, z])


def _dot(u: Floats, v: Floats) -> Floats:
    return np.asarray(u[0] * v[0] + u[1] * v[1] + u[2] * v[2])


def _norm(u: Floats) -> Floats:
    return np.asarray(np.sqrt(_dot(u, u)))


def _ratio(over: Floats, under: Floats, flat: float) -> Floats:
    """Return quotients, and ``flat`` where an element has no extent to divide by."""
    return np.asarray(np.divide(over, under, out=np.full(len(under), flat), where=under > 0))


def _at(part: float) -> Callable[[Floats], float]:
    """Return what gives the value of some cell that this part of all cells does not exceed."""
    return lambda values: float(np.quantile(values, part, method="inverted_cdf"))


def _least(values: Floats) -> float:
    return float(values.min())


def _most(values: Floats) -> float:
    return float(values.max())


ROWS: Mapping[str, tuple[str, str, Callable[[Floats], float]]] = MappingProxyType(
    {
        "smallest_dihedral_angle": ("smallest_angle", "°", _least),
        "dihedral_angle_p1": ("smallest_angle", "°", _at(0.01)),
        "dihedral_angle_p50": ("smallest_angle", "°", _at(0.5)),
        "largest_dihedral_angle": ("largest_angle", "°", _most),
        "smallest_scaled_jacobian": ("jacobian", "1", _least),
        "scaled_jacobian_p1": ("jacobian", "1", _at(0.01)),
        "scaled_jacobian_p50": ("jacobian", "1", _at(0.5)),
        "edge_ratio_p50": ("edge_ratio", "1", _at(0.5)),
        "edge_ratio_p99": ("edge_ratio", "1", _at(0.99)),
        "largest_edge_ratio": ("edge_ratio", "1", _most),
        "aspect_ratio_p50": ("aspect_ratio", "1", _at(0.5)),
        "aspect_ratio_p99": ("aspect_ratio", "1", _at(0.99)),
        "largest_aspect_ratio": ("aspect_ratio", "1", _most),
    }
)
"""What is told of a mesh: which number of its cells, its unit, and which of them all."""
