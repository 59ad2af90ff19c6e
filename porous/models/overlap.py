"""What is known of an attractor whose parts overlap, so that voxels can be sought backwards."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from porous.models.adapted import adapted_norms
from porous.models.distinct import SAME, repeated

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.kernels.cover import System
    from porous.kernels.overlap import Reference

    Floats = NDArray[np.float64]

MUCH = 1.2
"""Sum of the maps' determinants from which the words at a place become ever more."""

SLOW = 0.95
"""Words that contract less in some direction leave the distance from a net too uncertain."""

BETTER = 0.99
"""Coordinates are changed where the largest norm, and letters where the overlap, becomes less than
this part of it."""

CELLS = 128
"""Cells of the net along the attractor's longest edge."""

IMAGES = 40
"""Words of the net, at most, if there are more than maps."""

WORDS, ROUNDS = 512, 8
"""Words that tighten the enclosures, and how often they do."""

THIN = 1e-9
"""An attractor that is flatter than this part of its ball is in a plane, or on a line."""

ROOM = 2
"""Cells about the attractor."""

TIGHT = 1 + 1e-9
"""Enclosures are larger by this against rounding."""


def overlaps(system: System) -> bool:
    """Tell whether words at a place become ever more, and can be sought backwards.

    That is for one state with invertible maps whose words contract in the coordinates that suit
    them. Words whose maps coincide count once. Sets in a plane or on a line are left to
    those who seek forwards: backwards no voxel beside one is ever told from those that it touches.
    """
    if len(system.balls) > 1 or len(system.maps) < 2:
        return False
    if _growth(system.maps, 1) <= MUCH or _is_flat(system):
        return False
    maps, growth = letters(system)
    turn = coordinates(maps)
    slowest = _norms(_words(_turned(system.maps, turn), IMAGES)).max()
    # The inverses do not stretch too unequally.
    upright = np.abs(np.linalg.det(maps[:, :, :3])) > 1e-3 * _norms(_turned(maps, turn)) ** 3
    return bool(growth > MUCH and slowest <= SLOW and upright.all())


def _is_flat(system: System) -> bool:
    """Tell whether a one-state attractor lies in a plane.

    It lies in the least affine subspace that holds one of its points and is sent into itself: that
    along the images of the point, less the point, and the images of these by the matrices.
    """
    point, radius, matrices = system.points[0], system.balls[0, 3], system.maps[:, :, :3]
    span = matrices @ point + system.maps[:, :, 3] - point
    for _ in range(2):  # each time by a dimension more, or no more will come
        images = np.einsum("mab,kb->mka", matrices, span).reshape(-1, 3)
        _, sizes, axes = np.linalg.svd(np.concatenate([span, images]), full_matrices=False)
        span = sizes[:, None] * axes
    return bool((sizes <= THIN * radius).any())


def letters(system: System) -> tuple[Floats, float]:
    """Return maps (m, 3, 4) of which a one-state attractor is that, and how fast they overlap.

    It is that of all words of a length, too, and where such coincide, of those that differ: fewer
    words are then at a place. The number is the sum of determinants by letter of the given maps.
    """
    centre, radius = system.balls[0, :3], system.balls[0, 3]
    found, least = system.maps, _growth(system.maps, 1)
    words, length = system.maps, 1
    while len(words) * len(system.maps) <= WORDS:
        words, length = _longer(words, system.maps), length + 1
        linear, shift = words[:, :, :3], words[:, :, :3] @ centre + words[:, :, 3] - centre
        placed = np.concatenate([linear * radius, shift[:, :, None]], axis=2)
        words = np.delete(words, repeated(placed, np.zeros(len(words)), SAME * radius), axis=0)
        growth = _growth(words, length)
        if growth < BETTER * least:
            found, least = words, growth
    return found, least


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

    chosen, _ = letters(system)
    turn = coordinates(chosen)
    maps, own = _turned(chosen, turn), _turned(system.maps, turn)
    words = _words(own, IMAGES)
    ball, block = _enclosed(words, _words(own, WORDS), turn @ system.balls[0, :3])
    middle, half = block[:3], block[3:]
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


def _enclosed(words: Floats, longer: Floats, middle: Floats) -> tuple[Floats, Floats]:
    """Return a ball (4,) and a box (6,), middle and half edges, that hold an attractor.

    Its words with norms s < 1 send the ball of radius max |T(m) − m| / (1 − s) about m into itself,
    so that it holds the attractor; what holds its images under ``longer`` words does so too, and is
    often half as wide.
    """
    from porous.kernels.overlap import held

    steps = np.linalg.norm(words[:, :, :3] @ middle + words[:, :, 3] - middle, axis=1)
    ball = np.append(middle, float((steps / (1 - _norms(words))).max()) * TIGHT)
    block = np.append(middle, np.full(3, ball[3]))
    norms, ends = _norms(longer), np.zeros(len(longer), np.int64)
    for _ in range(ROUNDS):
        smaller, block = held((ends, longer), norms, ball[None], block[None])
        ball = smaller if smaller[3] < ball[3] else ball
    return ball, block


def _norms(maps: Floats) -> Floats:
    return np.asarray(np.linalg.norm(maps[:, :, :3], 2, axis=(1, 2)), np.float64)


def _turned(maps: Floats, turn: Floats) -> Floats:
    """Return maps (m, 3, 4) in coordinates that a matrix leads to."""
    linear = turn @ maps[:, :, :3] @ np.linalg.inv(turn)
    return np.concatenate([linear, (maps[:, :, 3] @ turn.T)[:, :, None]], axis=2)


def _growth(words: Floats, length: int) -> float:
    return float(np.abs(np.linalg.det(words[:, :, :3])).sum() ** (1 / length))


def _words(maps: Floats, most: int) -> Floats:
    """Return the maps of all words of some length: the longer, the stronger they contract."""
    result = maps
    while len(result) * len(maps) <= most:
        result = _longer(result, maps)
    return result


def _longer(words: Floats, maps: Floats) -> Floats:
    linear = np.einsum("kab,mbc->kmac", words[:, :, :3], maps)
    linear[:, :, :, 3] += words[:, None, :, 3]
    return np.asarray(linear.reshape(-1, 3, 4))
