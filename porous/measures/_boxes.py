"""How a grid's solid fills space from scale to scale: box counts and their dimension."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import GridError
from porous.kernels.boxes import box_sums
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
    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

METHOD = "voxel count"

LEAST = 8
"""A fit leaves out sizes of which fewer boxes hold solid: those see the outline of the body."""

POINTS = 3
"""Sizes that a fit has at least: two have no residual to tell an uncertainty from."""

NORMAL = 1.96
"""So many standard uncertainties either way hold 95 % of all draws, if there are many of them."""


OCTAVE = math.log(1.9)
"""Local slopes are told of sizes a factor of two apart, about (edges go into whole numbers of
parts): closer ones show the lattice's jumps."""


class BoxCounts(NamedTuple):
    """Edges of boxes in voxels, float64 (n,), and how many of them hold a solid voxel, int64 (n,).

    Edges are those of cubes as large as the boxes: edges of a grid are cut into equal parts.
    """

    sizes: Floats
    counts: Ints


class Lattice(NamedTuple):
    """Boxes of one size: ``parts`` of them along each edge of the grid, so that none sticks out.

    ``wanted`` is the edge, in voxels, that they come next to, and ``size`` the one they have in the
    mean: along axes that are shorter than a box there is one, and it has no say in this.
    """

    wanted: int
    parts: Index
    size: float

    @classmethod
    def of(cls, shape: Index, wanted: int) -> Lattice:
        """Return the boxes of a grid of ``shape`` that come next to a number of voxels."""
        x, y, z = (_parts(n, wanted) for n in shape)
        edges = [n / k for n, k in zip(shape, (x, y, z), strict=True) if n >= wanted]
        alike = min(edges) == max(edges)
        size = edges[0] if alike else math.exp(math.fsum(map(math.log, edges)) / len(edges))
        return cls(wanted, (x, y, z), size)

    def fits(self, shape: Index) -> bool:
        """Tell whether all boxes have just the voxels wanted."""
        return all(n % self.wanted == 0 for n in shape)


def _parts(n: int, wanted: int) -> int:
    """Return into how many parts ``n`` voxels go: of two at least, but for single ones."""
    return n if wanted == 1 else max(1, min(n // 2, int(n / wanted + 0.5)))


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
    """Counts the boxes of a tile that hold solid, of edges near 1, ``base``, ``base``², … voxels.

    Powers of √2 where ``base`` is None.
    """

    base: int | None

    @classmethod
    def of(cls, shape: Index) -> BoxCount:
        """Return the count of boxes that fit a grid: the base whose powers divide it furthest.

        None where none of 2, 3, 5 and 7 divides it ``POINTS`` times.
        """
        powers = {p: _power(p, math.gcd(*shape)) for p in (2, 3, 5, 7)}
        fitting = {p: n for p, n in powers.items() if n >= p**POINTS}
        return cls(max(fitting, key=lambda p: (fitting[p], -p), default=None))

    def lattices(self, shape: Index) -> tuple[Lattice, ...]:
        """Return the boxes that a grid is cut into, up to its longest edge, all of them unlike."""
        found: list[Lattice] = []
        for power in range(2 * max(shape).bit_length()):
            wanted = round(math.sqrt(2) ** power) if self.base is None else self.base**power
            lattice = Lattice.of(shape, min(wanted, max(shape)))
            if wanted <= max(shape) and (not found or lattice.parts != found[-1].parts):
                found.append(lattice)
        return tuple(found)

    def __call__(self, source: Tiled, start: Index, stop: Index) -> BoxSums:
        """Count the boxes of the tile ``start`` … ``stop`` (not within)."""
        shape = source.frame.shape
        fill, _ = source.block(start, stop)
        counts, cut = [], []
        solid: Bytes | None = None
        boxes, first = fill, start
        for lattice in self.lattices(shape):
            if lattice.wanted == 1:  # none of these is cut, and there are too many for a copy
                counts.append(sum(int(np.count_nonzero(plane >= 128)) for plane in fill))
                cut.append(np.zeros(0, np.int64))
                continue
            if self.base is not None and lattice.fits(shape):
                boxes = pooled(boxes, first, self.base)
                first = tuple(a // lattice.wanted for a in start)  # type: ignore[assignment]
                occupied = boxes >= 128
            else:
                solid = (fill >= 128).view(np.uint8) if solid is None else solid
                occupied = box_sums(solid, start, shape, lattice.parts) > 0
            total, others = _told(occupied, _Place(lattice.parts, shape, start, stop))
            counts.append(total)
            cut.append(others)
        return BoxSums(np.array(counts, np.int64), tuple(cut))


class _Place(NamedTuple):
    parts: Index
    shape: Index
    start: Index
    stop: Index


def _told(occupied: NDArray[np.bool_], place: _Place) -> tuple[int, Ints]:
    """Return how many occupied boxes lie in the tile as a whole, and the numbers of the others."""
    whole, firsts = [], []
    for k, n, a, b, boxes in zip(*place, occupied.shape, strict=True):
        first, last = a * k // n, (b - 1) * k // n
        low, high = -(-first * n // k) < a, -(-(last + 1) * n // k) > b
        whole.append(slice(int(low), max(int(low), boxes - high)))
        firsts.append(first)
    count = int(np.count_nonzero(occupied[tuple(whole)]))
    if whole == [slice(0, boxes) for boxes in occupied.shape]:
        return count, np.zeros(0, np.int64)
    occupied[tuple(whole)] = False
    others = [found + first for found, first in zip(np.nonzero(occupied), firsts, strict=True)]
    return count, np.asarray(np.ravel_multi_index(tuple(others), place.parts), np.int64)


def _power(base: int, number: int) -> int:
    """Return the largest power of ``base`` that divides ``number``."""
    return base * _power(base, number // base) if number % base == 0 else 1


def lattices(shape: Index, base: int | None = None) -> tuple[Lattice, ...]:
    """Return the boxes of a grid: those of a base, or those that fit it."""
    return (BoxCount.of(shape) if base is None else BoxCount(base)).lattices(shape)


def _counted(census: Census, base: int | None = None) -> BoxCounts:
    shape = census.frame.shape
    count = BoxCount.of(shape) if base is None else BoxCount(base)
    sums: BoxSums = census.counted(count)
    totals = sums.counts + np.array([len(others) for others in sums.cut])
    sizes = np.array([lattice.size for lattice in count.lattices(shape)])
    return BoxCounts(sizes, totals)


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
            f"box_dimension: got a grid with boxes of {', '.join(f'{s:g}' for s in found.sizes)} "
            f"voxels; "
            f"wanted {POINTS} sizes at least"
        )
    most = max(POINTS, int((found.counts >= LEAST).sum()))
    x = [-math.log(size) for size in found.sizes[:most].tolist()]
    y = [math.log(count) for count in found.counts[:most].tolist()]
    slope, doubt = scaling(x, y)
    height = (math.fsum(y) - slope * math.fsum(x)) / most
    return BoxFit(slope, doubt, height, most)


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
    slope, error = _least_squares(x, y)
    return slope, max(error, _spread(list(pairwise(zip(x, y, strict=True)))))


def scaling(x: Sequence[float], y: Sequence[float]) -> tuple[float, float]:
    """Return the slope of counts over logarithms of sizes, and its uncertainty.

    The root of the squared standard error and the variance of local slopes, those to the first size
    ``OCTAVE`` away: what scatters about the line and what bends it. Widened by Student's factor.
    """
    slope, error = _least_squares(x, y)
    points = list(zip(x, y, strict=True))
    further = [
        next((q for q in points[i:] if abs(q[0] - p[0]) >= OCTAVE), p) for i, p in enumerate(points)
    ]
    pairs = [(p, q) for p, q in zip(points, further, strict=True) if p != q]
    pairs = pairs if len(pairs) > 1 else list(pairwise(points))
    return slope, math.hypot(error, _spread(pairs)) * student(len(x) - 2)


def _spread(pairs: Sequence[tuple[tuple[float, float], tuple[float, float]]]) -> float:
    """Return the standard deviation of the slopes between pairs of points."""
    steps = [(d - b) / (c - a) for (a, b), (c, d) in pairs]
    mean = math.fsum(steps) / len(steps)
    return math.sqrt(math.fsum((s - mean) ** 2 for s in steps) / (len(steps) - 1))


def _least_squares(x: Sequence[float], y: Sequence[float]) -> tuple[float, float]:
    """Return the slope of a line by least squares and its standard error."""
    middle, height = math.fsum(x) / len(x), math.fsum(y) / len(y)
    spread = math.fsum((a - middle) ** 2 for a in x)
    slope = math.fsum((a - middle) * (b - height) for a, b in zip(x, y, strict=True)) / spread
    left = [b - height - slope * (a - middle) for a, b in zip(x, y, strict=True)]
    return slope, math.sqrt(math.fsum(r * r for r in left) / (len(x) - 2) / spread)


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
        Each edge of the grid is cut into equal parts, as many as come next to 1, ``base``,
        ``base``², … voxels: so no box sticks out of the grid, and boxes of one size differ by one
        voxel where they do not divide it. Where not given, that of 2, 3, 5 and 7 whose powers
        divide all three edges furthest, three times at least; or else powers of √2, for boxes that
        do not fit a fractal's own lattice mislead, and many sizes less than few (of a Menger sponge
        of 81³ voxels powers of 3 tell exactly 2.7268, and in a grid one layer larger those of √2
        tell 2.70).

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
        The uncertainty joins the slope's standard error and the standard deviation of the slopes
        between sizes a factor of two apart, or the next further, and is widened by Student's factor
        for so few sizes: 1.96 of it either way are a 95 % interval, as far as it lies between 0 and
        3. A block, a plate or a rod along the axes has 3, 2 or 1 exactly. Boxes finer than the
        smallest detail of a prefractal see a body of dimension 3, which widens the uncertainty;
        what was sampled is not asked.

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
