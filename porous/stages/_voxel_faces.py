"""The exact boundary of the solid voxels as boxes, made 2-manifold by doubling points.

Around a lattice point the faces form closed fans, one point each. The eight voxels about it are
the corners of a cube of the dual lattice and the faces are that cube's cut edges, so the fans are
the loops of the table of marching cubes. Where two solid voxels touch in an edge whose both ends
belong to one fan, the edge itself is doubled: each of the two voxels gets a midpoint of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._cases import CASES, TUNNELS
from porous.memory import check_memory

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.values import VoxelGrid

    Indices = NDArray[np.int64]
    Bools = NDArray[np.bool_]

_BYTES_PER_FACE = 500
_BYTES_PER_VOXEL = 24


@dataclass(frozen=True)
class _Quads:
    """Faces as four points each, counter-clockwise from outside, and what the sides lie on."""

    corners: Indices
    """Numbers of the points, shape (f, 4)."""
    doubtful: Bools
    """Whether two solid voxels touch in the lattice edge of side k alone, shape (f, 4)."""
    voxel: Indices
    """The solid voxel behind each face."""
    labels: NDArray[np.int16]


def voxel_faces(
    grid: VoxelGrid, progress: Callable[[str, float], None] | None
) -> tuple[NDArray[np.float64], Indices, NDArray[np.int16]]:
    """Return points, triangles and caps' labels of the boundary of the solid voxels."""
    solid = np.pad(grid.solid, 1)
    _check(solid)
    cases = _cases(solid)
    fans, copies = _fans()
    first = np.cumsum(copies[cases], dtype=np.int64).reshape(cases.shape) - copies[cases]
    parts = [_faces(solid, cases, fans, first, axis) for axis in range(3)]
    quads = _Quads(*(np.concatenate(p) for p in zip(*map(_fields, parts), strict=True)))
    spots = np.repeat(np.arange(cases.size), copies[cases].ravel())
    lattice = np.stack(np.unravel_index(spots, cases.shape), axis=1).astype(np.float64)
    lattice, triangles, labels = _triangulated(lattice, quads)
    if progress is not None:
        progress("extract_surface", 1.0)
    frame = grid.frame
    return frame.origin + (frame.start + lattice) * frame.spacing, triangles, labels


def _fields(quads: _Quads) -> tuple[Indices, Bools, Indices, NDArray[np.int16]]:
    return quads.corners, quads.doubtful, quads.voxel, quads.labels


def _check(solid: Bools) -> None:
    faces = sum(int(np.count_nonzero(np.diff(solid, axis=axis))) for axis in range(3))
    needed = faces * _BYTES_PER_FACE + solid.size * _BYTES_PER_VOXEL
    check_memory(needed, f"A surface of {faces} voxel faces", "Use fewer voxels.")


def _cases(solid: Bools) -> NDArray[np.uint8]:
    """Return which of the eight voxels about each lattice point are solid, as bits."""
    nx, ny, nz = (n - 1 for n in solid.shape)
    result = np.zeros((nx, ny, nz), dtype=np.uint8)
    for bit, (a, b, c) in enumerate(product((0, 1), repeat=3)):
        result |= solid[a : a + nx, b : b + ny, c : c + nz].astype(np.uint8) << np.uint8(bit)
    return result


@cache
def _fans() -> tuple[NDArray[np.int8], NDArray[np.int8]]:
    """Return the fan of each face (dual edge) of each case, (256, 12), and their number, (256,)."""
    fan_of = np.full((256, 12), -1, dtype=np.int8)
    for case, text in enumerate(CASES):
        for number, fan in enumerate(_tunnel_ends(case) if case in TUNNELS else _loops(text)):
            fan_of[case, sorted(fan)] = number
    return fan_of, (fan_of.max(axis=1) + 1).astype(np.int8)


def _loops(text: str) -> list[set[int]]:
    """Return the sets of edges that triangles join."""
    found: list[set[int]] = []
    for start in range(0, len(text) - 2, 3):
        triangle = {int(digit, 16) for digit in text[start : start + 3]}
        touched = [loop for loop in found if loop & triangle]
        found = [loop for loop in found if not loop & triangle]
        found.append(triangle.union(*touched))
    return sorted(found, key=min)


def _tunnel_ends(case: int) -> list[set[int]]:
    """Return the edges at each of the two void corners: a tunnel has no room between boxes."""
    corners = (c for c in range(8) if not case >> c & 1)
    return [{c >> 0 & 3, 4 + (c >> 1 & 2 | c & 1), 8 + (c >> 1 & 3)} for c in corners]


def _faces(
    solid: Bools, cases: NDArray[np.uint8], fans: NDArray[np.int8], first: Indices, axis: int
) -> _Quads:
    """Return the faces across ``axis``."""
    below, above = (np.delete(np.arange(solid.shape[axis]), end) for end in (-1, 0))
    low = solid.take(below, axis)
    place = np.argwhere(low != solid.take(above, axis))
    outward = low[tuple(place.T)]
    corners = np.stack([_corner(place, cases, fans, first, axis, k) for k in range(4)], axis=1)
    doubtful = np.stack([_doubtful(place, solid, axis, k) for k in range(4)], axis=1)
    # Side k runs from corner k to k + 1; read backwards, corner 3 − k begins side 2 − k.
    corners = np.where(outward[:, None], corners, corners[:, ::-1])
    doubtful = np.where(outward[:, None], doubtful, doubtful[:, [2, 1, 0, 3]])
    behind = place.copy()
    behind[:, axis] += ~outward
    voxel = np.asarray(np.ravel_multi_index(tuple(behind.T), solid.shape), dtype=np.int64)
    ends = (place[:, axis] == 0) & ~outward, (place[:, axis] == solid.shape[axis] - 2) & outward
    labels = ends[0] * (1 + 2 * axis) + ends[1] * (2 + 2 * axis)
    return _Quads(corners, doubtful, voxel, labels.astype(np.int16))


_RING = ((0, 0), (1, 0), (1, 1), (0, 1))


def _corner(
    place: Indices,
    cases: NDArray[np.uint8],
    fans: NDArray[np.int8],
    first: Indices,
    axis: int,
    k: int,
) -> Indices:
    """Return the points of corner k, counter-clockwise about +axis."""
    u, v = (axis + 1) % 3, (axis + 2) % 3
    high = dict(zip((u, v), _RING[k], strict=True))
    spot = place.copy()
    spot[:, u] -= 1 - high[u]
    spot[:, v] -= 1 - high[v]
    # Seen from the lattice point at a voxel's upper corner, the voxel is a lower one.
    b, c = (1 - high[other] for other in sorted(high))
    where = tuple(spot.T)
    result: Indices = first[where] + fans[cases[where], 4 * axis + 2 * b + c]
    return result


def _doubtful(place: Indices, solid: Bools, axis: int, k: int) -> Bools:
    """Tell whether, at side k, the two solid voxels about the lattice edge touch nowhere else."""
    across = ((axis + 2) % 3, (axis + 1) % 3)[k % 2]
    step = np.zeros(3, dtype=np.int64)
    step[across] = -1 if k in (0, 3) else 1
    up = np.eye(3, dtype=np.int64)[axis]
    here, there = solid[tuple(place.T)], solid[tuple((place + up).T)]
    beside, beyond = solid[tuple((place + step).T)], solid[tuple((place + step + up).T)]
    result: Bools = (here == beyond) & (there == beside) & (here != there)
    return result


def _triangulated(
    lattice: NDArray[np.float64], quads: _Quads
) -> tuple[NDArray[np.float64], Indices, NDArray[np.int16]]:
    mids, spots = _midpoints(quads, len(lattice))
    lattice = np.concatenate([lattice, lattice[spots].mean(axis=1)])
    special = (mids >= 0).any(axis=1)
    plain = quads.corners[~special]
    halves = np.stack([plain[:, [0, 1, 2]], plain[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
    ring, mids = quads.corners[special], mids[special]
    centres = len(lattice) + np.arange(len(ring))
    lattice = np.concatenate([lattice, lattice[ring].mean(axis=1)])
    fan, of = _star(ring, mids, centres)
    labels = [np.repeat(quads.labels[~special], 2), quads.labels[special][of]]
    return lattice, np.concatenate([halves, fan]), np.concatenate(labels)


def _star(ring: Indices, mids: Indices, centres: Indices) -> tuple[Indices, Indices]:
    """Return triangles from each side (or its two halves) to the centre, and their face."""
    after = np.roll(ring, -1, axis=1)
    has = mids >= 0
    centre = np.broadcast_to(centres[:, None], ring.shape)
    one = np.stack([ring, np.where(has, mids, after), centre], axis=-1).reshape(-1, 3)
    two = np.stack([mids, after, centre], axis=-1)[has]
    face = np.broadcast_to(np.arange(len(ring))[:, None], ring.shape)
    return np.concatenate([one, two]), np.concatenate([face.ravel(), face[has]])


def _midpoints(quads: _Quads, points: int) -> tuple[Indices, Indices]:
    """Return the midpoint of each side, (f, 4) or −1, and the ends of each midpoint, (m, 2)."""
    ends = np.stack([quads.corners, np.roll(quads.corners, -1, axis=1)], axis=-1)
    ends = np.sort(ends[quads.doubtful], axis=-1)
    voxel = np.broadcast_to(quads.voxel[:, None], quads.corners.shape)[quads.doubtful]
    edge, uses = np.unique(
        ends[:, 0] * points + ends[:, 1], return_inverse=True, return_counts=True
    )[1:]
    double = uses[edge] > 2
    pairs = np.stack([edge[double], voxel[double]], axis=1)
    _, sample, number = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    found = np.full(len(ends), -1, dtype=np.int64)
    found[double] = points + number.ravel()
    mids = np.full(quads.corners.shape, -1, dtype=np.int64)
    mids[quads.doubtful] = found
    return mids, ends[double][sample]
