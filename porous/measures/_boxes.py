"""How a grid's solid fills space from scale to scale: box counts and their dimension."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import GridError
from porous.kernels.fills import pooled
from porous.measures._census import Census
from porous.values import Measure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.measures._answer import Table
    from porous.measures._fold import Index
    from porous.values.tiled import Tiled

    Bytes = NDArray[np.uint8]
    Ints = NDArray[np.int64]

METHOD = "voxel count"

LEAST = 8
"""A fit leaves out sizes of which fewer boxes hold solid: those see the outline of the body."""

POINTS = 3
"""Sizes that a fit has at least: two have no residual to tell an uncertainty from."""

NORMAL = 1.96
"""So many standard uncertainties either way hold 95 % of all draws, if there are many of them."""


class BoxCounts(NamedTuple):
    """Edges of boxes in voxels, and how many boxes of each size hold a solid voxel, int64 (n,)."""

    sizes: Ints
    counts: Ints


@dataclass(frozen=True)
class BoxSums:
    """Boxes with solid in them, of each size: how many tiles have seen whole, and the others.

    ``cut`` are the boxes that tiles share, by their numbers, int64, ascending: those two tiles
    saw something in are one.
    """

    counts: Ints
    cut: tuple[Ints, ...]

    def __add__(self, other: BoxSums) -> BoxSums:
        both = zip(self.cut, other.cut, strict=True)
        return BoxSums(self.counts + other.counts, tuple(np.union1d(a, b) for a, b in both))


@dataclass(frozen=True)
class BoxCount:
    """Counts the boxes of a tile that hold solid, of edges 1, ``base``, ``base``², … voxels."""

    base: int

    @classmethod
    def of(cls, shape: Index) -> BoxCount:
        """Return the count of boxes that fit a grid: the base whose powers divide it furthest.

        Powers of 2 where none of 2, 3, 5 and 7 divides it ``POINTS`` times; the last boxes along
        an axis are then smaller.
        """
        powers = {p: _power(p, math.gcd(*shape)) for p in (2, 3, 5, 7)}
        fitting = {p: n for p, n in powers.items() if n >= p**POINTS}
        return cls(max(fitting, key=lambda p: (fitting[p], -p), default=2))

    def sizes(self, shape: Index) -> tuple[int, ...]:
        """Return the edges of boxes, in voxels, up to the longest edge of the grid."""
        found = [1]
        while found[-1] * self.base <= max(shape):
            found.append(found[-1] * self.base)
        return tuple(found)

    def __call__(self, source: Tiled, start: Index, stop: Index) -> BoxSums:
        """Count the boxes of the tile ``start`` … ``stop`` (not within)."""
        shape = source.frame.shape
        boxes, _ = source.block(start, stop)
        first = start
        counts, cut = [], []
        for size in self.sizes(shape):
            if size > 1:
                boxes = pooled(boxes, first, self.base)
                first = tuple(a // size for a in start)  # type: ignore[assignment]
            total, others = _told(boxes >= 128, _Place(size, shape, start, stop))
            counts.append(total)
            cut.append(others)
        return BoxSums(np.array(counts, np.int64), tuple(cut))


class _Place(NamedTuple):
    size: int
    shape: Index
    start: Index
    stop: Index


def _told(occupied: NDArray[np.bool_], place: _Place) -> tuple[int, Ints]:
    """Return how many occupied boxes lie in the tile as a whole, and the numbers of the others."""
    whole, firsts, lattice = [], [], []
    for a, b, n, boxes in zip(*place[2:], place.shape, occupied.shape, strict=True):
        low, high = a % place.size > 0, b % place.size > 0 and b < n
        whole.append(slice(int(low), max(int(low), boxes - high)))
        firsts.append(a // place.size)
        lattice.append(-(-n // place.size))
    count = int(np.count_nonzero(occupied[tuple(whole)]))
    if whole == [slice(0, boxes) for boxes in occupied.shape]:
        return count, np.zeros(0, np.int64)
    occupied[tuple(whole)] = False
    others = [found + first for found, first in zip(np.nonzero(occupied), firsts, strict=True)]
    return count, np.asarray(np.ravel_multi_index(tuple(others), lattice), np.int64)


def _power(base: int, number: int) -> int:
    """Return the largest power of ``base`` that divides ``number``."""
    return base * _power(base, number // base) if number % base == 0 else 1


def _counted(census: Census, base: int | None = None) -> BoxCounts:
    shape = census.frame.shape
    count = BoxCount.of(shape) if base is None else BoxCount(base)
    sums: BoxSums = census.counted(count)
    totals = sums.counts + np.array([len(others) for others in sums.cut])
    return BoxCounts(np.array(count.sizes(shape)), totals)


class BoxFit(NamedTuple):
    """A line through the first ``window`` box counts: log N = −slope · log size + height."""

    slope: float
    doubt: float
    height: float
    window: int


def fitted(found: BoxCounts) -> BoxFit:
    """Return the line through box counts from one voxel up to the last size of ``LEAST`` boxes.

    Raises
    ------
    GridError
        Where nothing is solid, or there are fewer than ``POINTS`` sizes.
    """
    if not found.counts[0]:
        raise GridError("box_dimension: the grid has no solid voxel; wanted a set with points")
    if len(found.sizes) < POINTS:
        raise GridError(
            f"box_dimension: got a grid with boxes of {', '.join(map(str, found.sizes))} voxels; "
            f"wanted {POINTS} sizes at least"
        )
    most = max(POINTS, int((found.counts >= LEAST).sum()))
    x = [-math.log(size) for size in found.sizes[:most].tolist()]
    y = [math.log(count) for count in found.counts[:most].tolist()]
    slope, doubt = line(x, y)
    height = (math.fsum(y) - slope * math.fsum(x)) / most
    return BoxFit(slope, doubt * student(most - 2), height, most)


def student(freedom: int) -> float:
    """Return by how much a spread that so few points tell is to be widened.

    ``NORMAL`` times the product holds 95 % then (Student 1908).
    """
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.975)) / NORMAL


def _dimension(census: Census, base: int | None = None) -> Measure:
    fit = fitted(_counted(census, base))
    return Measure("box_dimension", fit.slope, "1", METHOD, fit.doubt, "standard", "grid")


def line(x: Sequence[float], y: Sequence[float]) -> tuple[float, float]:
    """Return the slope of a line by least squares and its uncertainty.

    That is its standard error, or the standard deviation of the slopes between neighbours where
    this is more: points off a line all alike, as those of a bend, are no independent errors.
    """
    middle, height = math.fsum(x) / len(x), math.fsum(y) / len(y)
    spread = math.fsum((a - middle) ** 2 for a in x)
    slope = math.fsum((a - middle) * (b - height) for a, b in zip(x, y, strict=True)) / spread
    left = [b - height - slope * (a - middle) for a, b in zip(x, y, strict=True)]
    error = math.sqrt(math.fsum(r * r for r in left) / (len(x) - 2) / spread)
    pairs = pairwise(zip(x, y, strict=True))
    steps = [(d - b) / (c - a) for (a, b), (c, d) in pairs]
    mean = math.fsum(steps) / len(steps)
    local = math.sqrt(math.fsum((s - mean) ** 2 for s in steps) / (len(steps) - 1))
    return slope, max(error, local)


GRID: Table[Census] = {("box_dimension", METHOD): _dimension}


def has_dimension(census: Census) -> bool:
    """Tell whether a grid has solid, and boxes of enough sizes for ``box_dimension``."""
    found = _counted(census)
    return len(found.sizes) >= POINTS and bool(found.counts[0])


def box_counts(grid: Tiled, *, base: int | None = None) -> BoxCounts:
    """Return how many boxes of each size hold a solid voxel.

    Parameters
    ----------
    grid
        The body.
    base
        Boxes have 1, ``base``, ``base``², … voxels along each edge and are laid from the grid's
        first voxel on. Where not given, that of 2, 3, 5 and 7 whose powers divide all three edges
        of the grid furthest, or 2: boxes that do not fit a fractal's own lattice mislead (of a
        Menger sponge of 81³ voxels powers of 2 tell 2.45 ± 0.39, and powers of 3 exactly 2.7268).

    Returns
    -------
    BoxCounts
        Sizes up to the longest edge. Along unequal spacings boxes are not cubes, but all alike,
        which changes no dimension.
    """
    return _counted(Census(grid), _checked(base))


def box_dimension(grid: Tiled, *, base: int | None = None) -> Measure:
    """Return the box dimension that the solid voxels of a grid show, unit 1.

    The slope of log N over −log size, by least squares (K. Falconer, Fractal Geometry, 1990,
    chapter 3), over the sizes from one voxel up to the last of which eight boxes hold solid, and
    the three smallest at least. Parameters are those of ``box_counts``.

    Returns
    -------
    Measure
        The uncertainty is the slope's standard error, or the standard deviation of the slopes
        between neighbouring sizes where that is more, times Student's factor for so few sizes:
        1.96 of it either way are a 95 % interval. Boxes finer than the smallest detail of a
        prefractal see a body of dimension 3, which widens the uncertainty; what was sampled is not
        asked.

    Raises
    ------
    GridError
        Where nothing is solid, or the grid has fewer than three sizes of boxes.
    """
    return _dimension(Census(grid), _checked(base))


def _checked(base: int | None) -> int | None:
    if base is not None and (base != int(base) or base < 2):
        raise GridError(f"base: got {base!r}; wanted a whole number, at least 2")
    return base
