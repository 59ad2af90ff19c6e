"""Self-affine reliefs: heights over a rectangle of a prescribed box dimension and amplitude.

A relief is a face of five controls, its corners and its middle, that is divided into four: corners
of the children lie on the bilinear face but for the one that they share, which is the middle; the
middle of a child is off the mean of its corners by ± r times as much as its parent's was. So
neighbours agree along their edges whatever the signs, for these stay straight, and so does the
border. As a sum over levels, h = Σ ± r^k ψ(2^k u) ψ(2^k v) with ψ(t) = 1 − |2t − 1| on the unit
interval, again and again: a Takagi–Landsberg surface, for one sign.

Its box dimension is D = 3 + log₂ r for 1/2 < r < 1, whatever the signs: over each cell of level n
the middle is off the mean of the corners by r^n exactly, and heights differ by no more than a
constant times r^n, so that cubes of edge 2^−n that cover it are about 4^n · r^n · 2^n.

Sources: G. Landsberg 1908; Y. Mishura & A. Schied 2019, "On (signed) Takagi–Landsberg functions";
C. Gentil, G. Gouaty & D. Sokolov 2021, Geometric Modeling of Fractal Forms for CAD, for the cells.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.values.value import Value

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

DEEPEST = 48
"""Levels that are summed at most: floating point has no more digits."""

VERTICES = 1 << 18
"""Points at which heights are surveyed, about."""

MOST_BUMPS = 256
"""Level-0 cells along an edge."""

UP, SIGNED = 7 / 144, 1 / 9
"""The variance of a level of bumps that point upwards, of mean 1/4, and of as many up as down."""

FINE = 16
"""Levels by which the highest point is bounded."""


@dataclass(frozen=True, eq=False)
class Relief(Value):
    """Heights over the unit square, zero on its border.

    Parameters
    ----------
    dimension
        Box dimension of the surface, between 2 and 3.
    amplitude
        Root-mean-square height about the mean height (Sq), above zero, in any unit of length.
    cells
        How many of the largest bumps there are along each edge.
    seed
        Draws which bumps point upwards: two of each four siblings. All do where it is None.

    Raises
    ------
    ModelError
        For numbers outside these bounds.
    """

    dimension: float
    amplitude: float
    cells: tuple[int, int] = (1, 1)
    seed: int | None = None

    def __post_init__(self) -> None:
        if not 2 < self.dimension < 3:
            raise ModelError(
                f"dimension: got {self.dimension:g}; wanted one between 2 and 3, as of a rough "
                "surface"
            )
        if not 0 < self.amplitude < math.inf:
            raise ModelError(f"amplitude: got {self.amplitude:g}; wanted a length above zero")
        if not all(1 <= count <= MOST_BUMPS for count in self.cells):
            raise ModelError(f"bumps: got {self.cells}; wanted 1 … {MOST_BUMPS} along each edge")

    @property
    def ratio(self) -> float:
        """What heights are multiplied by where cells are halved: r = 2^(D − 3)."""
        return math.exp2(self.dimension - 3)

    @property
    def mean(self) -> float:
        """The mean height, exactly: levels of as many bumps up as down have none."""
        if self.seed is None:
            return self.scale / (4 * (1 - self.ratio))
        middles = [(np.arange(n) + 0.5) / n for n in self.cells]
        return float(self.scale * self._sum(_grid(*middles), 1).mean() / 4)

    @property
    def scale(self) -> float:
        """The height of a bump of level 0."""
        variance, *_ = self._survey
        return self.amplitude / math.sqrt(variance)

    @property
    def amplitude_doubt(self) -> float:
        """How far the amplitude may be off: by as much as the levels that were not surveyed add."""
        if self.seed is None:
            return 0.0
        variance, *_ = self._survey
        return self.amplitude * self._rest(self._surveyed) / variance / 2

    @property
    def lowest(self) -> float:
        """A bound on the lowest height, zero or below."""
        below = 0.0 if self.seed is None else self.left(self._surveyed)
        return min(0.0, self.scale * self._survey[1] - below)

    @property
    def highest(self) -> float:
        """A bound on the highest height, zero or above."""
        return max(0.0, self.scale * self._survey[2] + self.left(self._surveyed))

    def heights(self, places: Floats, levels: int = DEEPEST) -> Floats:
        """Return the heights (n,) at places (n, 2) in edges of the square; zero outside of it."""
        return self.scale * self._sum(places, levels)

    def left(self, levels: int) -> float:
        """Return a bound on what all but so many levels add to a height or take from it."""
        return self.scale * self.ratio**levels * self._peak

    @cached_property
    def _peak(self) -> float:
        """A bound on the heights of any signs, unscaled.

        None reach higher than bumps that all point upwards, and by Cauchy and Schwarz those are
        highest on the diagonal, at the maximum M of Σ r^k ψ(2^k t)². A sum of n levels of it is
        convex between multiples of 2^−n, so M ≤ (its largest value there) + r^n M.
        """
        tent, size = np.arange(2**FINE + 1) / 2**FINE, 1.0
        total = np.zeros_like(tent)
        for _ in range(FINE):
            tent = 1 - np.abs(2 * tent - 1)
            total += size * tent**2
            size *= self.ratio
        return float(total.max()) / (1 - size)

    def levels(self, tolerance: float) -> int:
        """Return how many levels leave less than ``tolerance``, up to ``DEEPEST``."""
        wanted = math.log(tolerance / self.left(0)) / math.log(self.ratio)
        return min(max(1, math.ceil(wanted)), DEEPEST)

    @property
    def _surveyed(self) -> int:
        most = VERTICES / (self.cells[0] * self.cells[1])
        return min(DEEPEST, max(1, int(math.log2(most) / 2) - 1))

    def _rest(self, levels: int) -> float:
        """Return the variance of all but so many levels, which correlate with nothing on average.

        Of bumps that all point upwards every two levels are uncorrelated, exactly.
        """
        each = UP if self.seed is None else SIGNED
        return each * self.ratio ** (2 * levels) / (1 - self.ratio**2)

    @cached_property
    def _survey(self) -> tuple[float, float, float]:
        """Variance, lowest and highest value of as many levels as are surveyed, unscaled.

        They are bilinear on cells of the last level: Simpson's rule integrates their squares.
        """
        levels = self._surveyed
        counts = [n << levels for n in self.cells]
        x, y = (np.arange(2 * n + 1) / (2 * n) for n in counts)
        z = self._sum(_grid(x, y), levels).reshape(len(x), len(y))
        weights = [np.r_[1, np.tile([4, 2], n - 1), 4, 1] / (6 * n) for n in counts]
        mean, square = (float(weights[0] @ part @ weights[1]) for part in (z, z**2))
        return square - mean**2 + self._rest(levels), float(z.min()), float(z.max())

    def _sum(self, places: Floats, levels: int) -> Floats:
        from porous.kernels.relief import heights, keys

        signs = None if self.seed is None else keys(self.seed, levels)
        return heights(places, self.cells, self.ratio, levels, signs)


def _grid(x: Floats, y: Floats) -> Floats:
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
