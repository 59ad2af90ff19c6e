"""What is known of an attractor whose parts overlap, so that voxels can be sought backwards."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from porous.models.adapted import adapted_norms

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.kernels.cover import System
    from porous.kernels.overlap import Reference

    Floats = NDArray[np.float64]

MUCH = 1.2
"""Sum of the maps' determinants from which the words at a place become ever more."""

SLOW = 0.95
"""Maps that contract less in some direction leave the distance from a net too uncertain."""

BETTER = 0.99
"""Coordinates are changed for those in which the largest norm is less than this part of it."""

CELLS = 128
"""Cells of the net along the attractor's longest edge."""

IMAGES = 40
"""Words of the net, at most, if there are more than maps."""

WORDS, ROUNDS = 512, 8
"""Words that tighten the enclosures, and how often they do."""

ROOM = 2
"""Cells about the attractor."""

TIGHT = 1 + 1e-9
"""Enclosures are larger by this against rounding."""


def overlaps(system: System) -> bool:
    """Tell whether words at a place become ever more, and can be sought backwards.

    That is for one state with invertible maps that contract in the coordinates that suit them.
    """
    if len(system.balls) > 1 or len(system.maps) < 2:
        return False
    amount = np.abs(np.linalg.det(system.maps[:, :, :3]))
    if amount.sum() <= MUCH:
        return False
    largest = _norms(_turned(system.maps, coordinates(system.maps)))
    upright = amount > 1e-3 * largest**3  # the inverses do not stretch too unequally
    return bool(largest.max() <= SLOW and upright.all())


def coordinates(maps: Floats) -> Floats:
    """Return the matrix (3, 3) to coordinates in whose Euclidean norm maps (m, 3, 4) contract well.

    Of an ellipsoid norm of all maps together (``models/adapted.py``); the identity where that gains
    nothing. Maps that are turned ones in sheared coordinates get their own coordinates back.
    """
    zeros = np.zeros(len(maps), np.int64)
    lower = adapted_norms(zeros, zeros, maps[:, :, :3])
    if lower is None:
        return np.eye(3)
    turn = lower[0].T / np.cbrt(np.prod(np.diag(lower[0])))
    gained = _norms(_turned(maps, turn)).max() < BETTER * _norms(maps).max()
    return turn if gained else np.eye(3)


def reference(system: System) -> Reference:
    """Return a net of a one-state attractor and the distances from it.

    All is told in the coordinates and the norm that suit the maps. Points of the attractor, one per
    cell of a grid that their images under all words of a length reach: with X those points and δ a
    cell's diagonal, every T_w(x) is within δ of X, so that every point of the attractor is within
    δ / (1 − s) of X, s being the largest norm of these T_w.
    """
    from scipy.ndimage import distance_transform_edt

    from porous.kernels.overlap import Reference, spread

    turn = coordinates(system.maps)
    maps = _turned(system.maps, turn)
    ball, block = _enclosed(_words(maps, WORDS), turn @ system.balls[0, :3])
    words, middle, half = _words(maps, IMAGES), block[:3], block[3:]
    edge = 2 * float(half.max()) / CELLS
    shape = tuple(int(n) + 2 * ROOM for n in np.maximum(np.ceil(2 * half / edge), 1))
    low = middle - edge * np.array(shape) / 2
    points = spread(words, turn @ system.points[0], low, edge, shape)
    empty = np.ones(shape, bool)
    cells = np.clip(((points - low) / edge).astype(np.int64), 0, np.array(shape) - 1)
    empty[tuple(cells.T)] = False
    index = np.zeros(shape, np.int32)
    index[tuple(cells.T)] = np.arange(len(points))
    distance, to = distance_transform_edt(empty, sampling=edge, return_indices=True)
    diagonal = edge * math.sqrt(3)
    # From a place to its cell's centre, from the other cell's centre to its point: half each.
    doubt = diagonal / (1 - float(_norms(words).max())) + diagonal
    return Reference(
        turn,
        maps,
        ball,
        low,
        edge,
        distance.astype(np.float32),
        index[tuple(to)],
        points,
        doubt * (1 + 1e-5),  # covers the distances' rounding
    )


def _enclosed(words: Floats, middle: Floats) -> tuple[Floats, Floats]:
    """Return a ball (4,) and a box (6,), middle and half edges, that hold the maps' attractor.

    Maps with norms s < 1 send the ball of radius max |T(m) − m| / (1 − s) about m into itself, so
    that it holds the attractor; what holds its images does so too, and is often half as wide.
    """
    from porous.kernels.cover import held

    norms, ends = _norms(words), np.zeros(len(words), np.int64)
    steps = np.linalg.norm(words[:, :, :3] @ middle + words[:, :, 3] - middle, axis=1)
    ball = np.append(middle, float((steps / (1 - norms)).max()) * TIGHT)
    block = np.append(middle, np.full(3, ball[3]))
    for _ in range(ROUNDS):
        smaller, block = held((ends, words), norms, ball[None], block[None])
        ball = smaller if smaller[3] < ball[3] else ball
    return ball, block


def _norms(maps: Floats) -> Floats:
    return np.asarray(np.linalg.norm(maps[:, :, :3], 2, axis=(1, 2)), np.float64)


def _turned(maps: Floats, turn: Floats) -> Floats:
    """Return maps (m, 3, 4) in coordinates that a matrix leads to."""
    linear = turn @ maps[:, :, :3] @ np.linalg.inv(turn)
    return np.concatenate([linear, (maps[:, :, 3] @ turn.T)[:, :, None]], axis=2)


def _words(maps: Floats, most: int) -> Floats:
    """Return the maps of all words of some length: the longer, the stronger they contract."""
    result = maps
    while len(result) * len(maps) <= most:
        linear = np.einsum("kab,mbc->kmac", result[:, :, :3], maps)
        linear[:, :, :, 3] += result[:, None, :, 3]
        result = linear.reshape(-1, 3, 4)
    return result
