"""Points of an attractor, densely: one cloud per state, drawn under words that fit the voxels."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.kernels.cover import System

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

POINTS = 8192
"""Points of a cloud, at most: its coordinates fit the cache nearest to a core."""

WANTED = 24
"""Points per occupied voxel: as many as cost no more time than they save."""

APART = 1.2
"""One point per occupied voxel has parts of about this half diagonal, in edges of a voxel."""

SMALLER = 0.8
"""Step by step, the largest parts of a cloud are opened."""

MOST_POINTS = 32
"""Points per voxel of the window beyond which no more words are opened: they overlap."""

MARGIN = 1e-6
"""In voxels: images nearer to the border are asked where they are."""


class Cloud(NamedTuple):
    """Points of a state's attractor, in random order, and how far apart they are."""

    points: Floats
    """Shape (3, n)."""
    fineness: float
    """Size of the largest part that has one point, over that of the whole."""

    @property
    def dimension(self) -> float:
        """How fast points become more as their parts become smaller."""
        many, fine = self.points.shape[1], self.fineness
        return math.log(many) / -math.log(fine) if many > 1 and 0 < fine < 1 else 0.0

    def per_voxel(self, size: Floats) -> Floats:
        """Return about how many points an occupied voxel gets under words of this half diagonal."""
        parts = np.maximum(size * self.fineness, np.finfo(float).tiny)
        return np.asarray((APART / parts) ** self.dimension)


class Words(NamedTuple):
    """Words by their end states and their maps to a lattice."""

    states: Indices
    maps: Floats
    """Shape (w, 3, 4)."""


def clouds(system: System) -> tuple[Cloud, ...]:
    """Return a cloud of at most ``POINTS`` points for each state."""
    return tuple(_cloud(system, state) for state in range(len(system.balls)))


def _cloud(system: System, state: int) -> Cloud:
    words = Words(np.array([state]), np.eye(3, 4)[None])
    whole = size = _sizes(system, words, np.ones(3)).max()
    while size > 0:
        finer = opened(system, words, _sizes(system, words, np.ones(3)) >= SMALLER * size)
        if len(finer.states) > POINTS:
            break
        words = finer
        shrunk = _sizes(system, words, np.ones(3)).max()
        if len(words.states) == 1 and shrunk < whole * np.finfo(float).eps:
            break
        size = shrunk
    points = np.einsum("wab,wb->wa", words.maps[:, :, :3], system.points[words.states])
    points = np.random.default_rng(0).permutation(points + words.maps[:, :, 3])
    return Cloud(np.ascontiguousarray(points.T), float(size / whole) if whole else 0.0)


def _sizes(system: System, words: Words, spacing: Floats) -> Floats:
    """Return half diagonals of boxes that hold the words' parts, in units of length."""
    reach = np.linalg.norm(words.maps[:, :, :3], axis=2) * system.balls[words.states, 3:]
    return np.asarray(np.linalg.norm(reach * spacing, axis=1))


def boxes(system: System, words: Words) -> tuple[Floats, Floats]:
    """Return lower and upper corners (w, 3) of boxes that hold the words' parts."""
    linear, shift = words.maps[:, :, :3], words.maps[:, :, 3]
    ball, block = system.balls[words.states], system.blocks[words.states]
    middle = np.einsum("wab,wb->wa", linear, ball[:, :3]) + shift
    reach = np.linalg.norm(linear, axis=2) * ball[:, 3:]
    other = np.einsum("wab,wb->wa", linear, block[:, :3]) + shift
    across = np.einsum("wab,wb->wa", np.abs(linear), block[:, 3:])
    return np.maximum(middle - reach, other - across), np.minimum(middle + reach, other + across)


def opened(system: System, words: Words, which: NDArray[np.bool_]) -> Words:
    """Return the words with some replaced by all that are one longer."""
    wide = Words(words.states[which], words.maps[which])
    fan = system.first[wide.states + 1] - system.first[wide.states]
    parent = np.repeat(np.arange(len(fan)), fan)
    child = system.first[wide.states[parent]] + np.arange(len(parent))
    child -= np.repeat(np.cumsum(fan) - fan, fan)
    maps = np.einsum("wab,wbc->wac", wide.maps[parent, :, :3], system.maps[child])
    maps[:, :, 3] += wide.maps[parent, :, 3]
    states = np.concatenate([words.states[~which], system.targets[child]])
    return Words(states, np.concatenate([words.maps[~which], maps]))


def fitting(
    system: System, found: tuple[Cloud, ...], root: tuple[int, Floats], shape: Indices, h: Floats
) -> Words:
    """Return words whose clouds are dense in a window of voxels that starts at the root's zero.

    That is with ``WANTED`` points or more per voxel with any, if clouds are drawn in full.

    Where they would draw more than ``MOST_POINTS`` points per voxel, longer ones than those so far
    are left.
    """
    count = np.array([cloud.points.shape[1] for cloud in found])
    words = Words(np.array([root[0]]), root[1][None])
    while True:
        lower, upper = boxes(system, words)
        near = (upper > -MARGIN).all(axis=1) & (lower < shape + MARGIN).all(axis=1)
        words = Words(words.states[near], words.maps[near])
        wide = _per_voxel(system, found, words, h) < WANTED
        finer = opened(system, words, wide)
        if not wide.any() or count[finer.states].sum() > MOST_POINTS * shape.prod() + count.max():
            return words
        words = finer


def _per_voxel(system: System, found: tuple[Cloud, ...], words: Words, h: Floats) -> Floats:
    size = _sizes(system, words, h) / h.min()
    each = np.stack([cloud.per_voxel(size) for cloud in found])
    # A cloud of one point does not become denser under longer words.
    alone = np.array([not cloud.dimension for cloud in found])
    return np.where(alone[words.states], np.inf, each[words.states, np.arange(len(size))])


def stamp_points(
    marks: NDArray[np.uint8],
    system: System,
    found: tuple[Cloud, ...],
    root: tuple[int, Floats],
    spacing: Floats,
) -> bool:
    """Mark voxels of a window that hold points of the attractor; tell whether it may touch any.

    Parameters
    ----------
    marks
        uint8, shape (nx, ny, nz); set to one.
    system, found
        The automaton and its states' clouds.
    root
        The start state and the map (3, 4) of its space to the window's voxels.
    spacing
        Edge lengths of a voxel, (3,).
    """
    from porous.kernels.clouds import stamp

    shape = np.array(marks.shape)
    words = fitting(system, found, root, shape, spacing)
    lower, upper = boxes(system, words)
    inside = (lower > MARGIN).all(axis=1) & (upper < shape - MARGIN).all(axis=1)
    dense = _per_voxel(system, found, words, spacing)
    for state, cloud in enumerate(found):
        for within in (True, False):
            chosen = (words.states == state) & (inside == within)
            if chosen.any():
                share = min(1.0, WANTED / float(dense[chosen].mean()))
                some = cloud.points[:, : max(1, math.ceil(share * cloud.points.shape[1]))]
                stamp(marks, words.maps[chosen], some, inside=within)
    return bool(len(words.states))
