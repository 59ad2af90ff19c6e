"""Points of an attractor, densely: one cloud per state, drawn under words that fit the voxels."""

from __future__ import annotations

import math
import sys
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

FINE = 2 / 3
"""Parts of a cloud are as small as this power of a voxel's size, both over that of the whole.

Few voxels want few points: with a half, a cloud would have as many as there are words to draw it
under, but a word costs more than a point.
"""

LARGER = 1.25
"""Step by step, parts are larger until they are few enough."""

MOST_POINTS = 32
"""Points per voxel of the window beyond which no more words are opened: they overlap."""

PARTS = 8
SOME = 1 << 18
WORTH = 1 / 800
"""Clouds are drawn in so many parts where they have more points than some under all words, and the
rest is left where a part marks less than this many voxels a point: words overlap."""

MARGIN = 1e-6
"""In voxels: images nearer to the border are asked where they are."""


class Cloud(NamedTuple):
    """Points of a state's attractor, one of each small part, and how far apart they are."""

    points: Floats
    """Shape (3, n); neighbours in this order are near each other."""
    fineness: float
    """Size of the largest part that has one point, over that of the whole."""

    @property
    def dimension(self) -> float:
        """How fast points become more as their parts become smaller."""
        many, fine = self.points.shape[1], self.fineness
        return math.log(many) / -math.log(fine) if many > 1 and 0 < fine < 1 else 0.0

    def thinned(self, share: float) -> Floats:
        """Return about this share of the points, from everywhere, (3, k)."""
        count = self.points.shape[1]
        kept = max(1, math.ceil(share * count))
        if kept == count:
            return self.points
        return self.points[:, np.arange(kept) * count // kept]

    def per_voxel(self, size: Floats | float) -> Floats:
        """Return about how many points an occupied voxel gets under words of this half diagonal."""
        parts = np.maximum(size * self.fineness, sys.float_info.min)
        return np.asarray((APART / parts) ** self.dimension)

    def occupied(self, size: float) -> float:
        """Return about how many voxels the attractor is in, its own half diagonal being so many."""
        return len(self.points[0]) / float(self.per_voxel(size))

    @property
    def widest(self) -> float:
        """Half diagonal of the parts that ``WANTED`` points per voxel still go with, in voxels."""
        # A cloud of one point does not become denser under longer words.
        if not self.dimension:
            return math.inf
        return APART / (self.fineness * math.pow(WANTED, 1 / self.dimension))


def clouds(system: System, edge: float) -> tuple[Cloud, ...]:
    """Return a cloud of at most ``POINTS`` points for each state, for voxels of this edge."""
    return tuple(_cloud(system, state, edge) for state in range(len(system.balls)))


def _cloud(system: System, state: int, edge: float) -> Cloud:
    from porous.kernels.clouds import spread

    whole = math.sqrt(3) * float(system.balls[state, 3])
    if not whole:
        return Cloud(system.points[state][:, None], 0.0)
    finest, size = whole * min(1.0, (edge / whole) ** FINE), math.inf
    while math.isinf(size):
        points, size = spread(system, state, finest, POINTS)
        finest *= LARGER
    return Cloud(points, size / whole)


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

    counts = [cloud.points.shape[1] for cloud in found]
    edge = float(h.min())
    return fit(
        system,
        root,
        shape,
        h,
        widest=np.array([cloud.widest * edge for cloud in found]),
        counts=np.array(counts),
        most=MOST_POINTS * math.prod(map(int, shape)) + max(counts),
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
    edge = float(h.min())
    for state, cloud in enumerate(found):
        own = words.states == state
        for within in (True, False):
            chosen = np.flatnonzero(own & (words.inside == within))
            if len(chosen):
                dense = float(cloud.per_voxel(words.sizes[chosen] / edge).mean())
                share = min(1.0, WANTED / dense) if cloud.dimension else 1.0
                _stamp_parts(marks, words.maps[chosen], cloud.thinned(share), inside=within)


def _stamp_parts(marks: NDArray[np.uint8], maps: Floats, cloud: Floats, *, inside: bool) -> None:
    from porous.kernels.clouds import stamp

    parts = PARTS if len(maps) * cloud.shape[1] > SOME else 1
    for part in range(parts):
        some = cloud[:, part::parts]
        if stamp(marks, maps, some, inside=inside) < WORTH * len(maps) * some.shape[1]:
            break
