"""Points of an attractor, densely: one cloud per state, drawn under words that fit the voxels."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.kernels.clouds import Words
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

    @property
    def widest(self) -> float:
        """Half diagonal of the parts that ``WANTED`` points per voxel still go with, in voxels."""
        # A cloud of one point does not become denser under longer words.
        if not self.dimension:
            return math.inf
        return APART / (self.fineness * math.pow(WANTED, 1 / self.dimension))


def clouds(system: System) -> tuple[Cloud, ...]:
    """Return a cloud of at most ``POINTS`` points for each state."""
    return tuple(_cloud(system, state) for state in range(len(system.balls)))


def _cloud(system: System, state: int) -> Cloud:
    states, maps = np.array([state]), np.eye(3, 4)[None]
    sizes = _sizes(system, states, maps)
    whole = size = float(sizes.max())
    while size > 0:
        wide = sizes >= SMALLER * size
        fan = system.first[states + 1] - system.first[states]
        if fan[wide].sum() + (~wide).sum() > POINTS:
            break
        opened = _opened(system, states[wide], maps[wide], fan[wide])
        finer = _sizes(system, *opened)
        states = np.concatenate([states[~wide], opened[0]])
        maps = np.concatenate([maps[~wide], opened[1]])
        sizes = np.concatenate([sizes[~wide], finer])
        shrunk = float(sizes.max(initial=0.0))
        if len(states) == 1 and shrunk < whole * np.finfo(float).eps:
            break
        size = shrunk
    points = np.einsum("wab,wb->wa", maps[:, :, :3], system.points[states]) + maps[:, :, 3]
    points = np.random.default_rng(0).permutation(points)
    return Cloud(np.ascontiguousarray(points.T), size / whole if whole else 0.0)


def _sizes(system: System, states: Indices, maps: Floats) -> Floats:
    """Return half diagonals of boxes that hold the words' parts."""
    return np.asarray(np.linalg.norm(maps[:, :, :3], axis=(1, 2)) * system.balls[states, 3])


def _opened(system: System, states: Indices, maps: Floats, fan: Indices) -> tuple[Indices, Floats]:
    """Return all words that are one letter longer, of which each has ``fan``."""
    parent = np.repeat(np.arange(len(fan)), fan)
    child = system.first[states[parent]] + np.arange(len(parent))
    child -= np.repeat(np.cumsum(fan) - fan, fan)
    finer = maps[parent, :, :3] @ system.maps[child]
    finer[:, :, 3] += maps[parent, :, 3]
    return system.targets[child], finer


def fitting(
    system: System,
    found: tuple[Cloud, ...],
    root: tuple[int, Floats],
    shape: Indices,
    h: Floats,
    reach: float = 0.0,
) -> Words:
    """Return words whose clouds are dense in a window of voxels that starts at the root's zero.

    That is with ``WANTED`` points or more per voxel with any, if clouds are drawn in full. Words
    that come within ``reach`` voxels of the window are among them.

    Where they would draw more than ``MOST_POINTS`` points per voxel, longer ones than those so far
    are left.
    """
    from porous.kernels.clouds import fit

    count = np.array([cloud.points.shape[1] for cloud in found])
    return fit(
        system,
        root,
        shape,
        h,
        widest=np.array([cloud.widest for cloud in found]) * h.min(),
        counts=count,
        most=MOST_POINTS * int(shape.prod()) + int(count.max()),
        margin=MARGIN + reach,
    )


def stamp_points(
    marks: NDArray[np.uint8], found: tuple[Cloud, ...], words: Words, h: Floats
) -> None:
    """Mark voxels of a window that hold points of the attractor.

    Parameters
    ----------
    marks
        uint8, shape (nx, ny, nz); set to one.
    found
        The states' clouds.
    words
        Those that fit the window.
    h
        Edge lengths of a voxel, (3,).
    """
    from porous.kernels.clouds import stamp

    for state, cloud in enumerate(found):
        own = words.states == state
        for within in (True, False):
            chosen = own & (words.inside == within)
            if chosen.any():
                dense = float(cloud.per_voxel(words.sizes[chosen] / h.min()).mean())
                share = min(1.0, WANTED / dense) if cloud.dimension else 1.0
                some = cloud.points[:, : max(1, math.ceil(share * cloud.points.shape[1]))]
                stamp(marks, words.maps[chosen], some, inside=within)
