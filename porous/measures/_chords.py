"""How long lines run in a phase: chord lengths along the axes, their mean, and the lineal path."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import GridError
from porous.measures._census import Census
from porous.measures._phase import PREFIX, voxels_of
from porous.measures._porosity import Amounts
from porous.measures._surface_area import GRID as AREAS
from porous.values import Measure, Measures
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.kernels.chords import Phase, Runs
    from porous.measures._phase import Voxels
    from porous.values.tiled import Tiled

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

METHOD = "voxel chords"

BYTES = 4.0
"""Memory per voxel."""


class LinealPath(NamedTuple):
    """Lengths in units of length, (n,), and the part of places where such a segment fits, (n,)."""

    distances: NDArray[np.float64]
    values: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Chords(Value):
    """The chords of a phase along one axis, counted by length.

    Parameters
    ----------
    spacing
        Length of a voxel along the axis.
    whole, cut
        int64, shape (n + 1,): number of chords of 0 … n voxels; ``cut`` are those that end at a
        side of the grid (or of the bulk) at least once, beyond which they go on.
    ends
        Number of ends of chords at the other phase.
    endless
        Number of lines along a periodic axis that lie in the phase all round.
    coarse
        Mean chord length on every other voxel of each line, from the first or from the second one
        on, whichever differs more; NaN where it is not known.
    places
        int64, shape (n,): places on lines where 1 … n voxels in a row are bulk.
    """

    spacing: float
    whole: Ints = field(repr=False)
    cut: Ints = field(repr=False)
    ends: int
    endless: int
    coarse: float
    places: Ints = field(repr=False)

    def __post_init__(self) -> None:
        for name in ("whole", "cut", "places"):
            self._set(name, frozen(getattr(self, name), np.int64))
        if not len(self.whole) == len(self.cut) == len(self.places) + 1:
            raise GridError(
                f"chords: got counts of {len(self.whole)} and {len(self.cut)} lengths and "
                f"{len(self.places)} of places; wanted n + 1, n + 1 and n"
            )

    @property
    def lengths(self) -> Floats:
        """The length that each count is of."""
        return self.spacing * np.arange(len(self.whole), dtype=np.float64)

    @property
    def total(self) -> float:
        """Length of all chords and parts of them."""
        around = self.spacing * len(self.places) * self.endless
        return float(self.lengths @ (self.whole + self.cut)) + around

    @property
    def mean(self) -> float:
        """Mean length: that of all parts over half the number of ends. Infinite without ends."""
        return 2 * self.total / self.ends if self.ends else math.inf

    @property
    def lineal_path(self) -> LinealPath:
        """How likely a segment that is put into the bulk along the axis lies in the phase.

        Distances are between the centres of its first and last voxel; the first value is the
        phase's part of the bulk.
        """
        inside = _fitting(self.whole + self.cut) + self.endless * len(self.places)
        known = self.places > 0
        return LinealPath(self.lengths[:-1][known], inside[known] / self.places[known])


@dataclass(frozen=True, eq=False)
class ChordLengths(Value):
    """Chords along x, y and z of a phase, in a unit of length."""

    phase: str
    unit: str
    axes: tuple[Chords, Chords, Chords]


def chord_lengths(grid: Tiled, *, phase: str = "pore", beyond: str = "void") -> ChordLengths:
    """Return the chords of pores or of solid along the axes, on every line of voxels.

    Parameters
    ----------
    grid
        The body; any spacing. Along periodic axes chords go on into its copies.
    phase
        pore or solid.
    beyond
        What lies beyond sides that are not periodic: ``"void"``, so that chords of solid end there,
        or ``"unknown"``: they are cut. Chords of pores are cut there in any case.

    Returns
    -------
    ChordLengths
        Chords that are cut are counted apart, and no part of the distribution of whole ones, in
        which long ones are then too few. ``Chords.mean`` takes them into account without such a
        bias: the length of all parts over half the number of ends.

    Raises
    ------
    GridError
        For an unknown phase, or one that is missing.
    """
    from porous.kernels.chords import phase_of, turned

    voxels = voxels_of(grid, phase, beyond, "chord lengths", BYTES)
    bits = phase_of(voxels.mask, voxels.bulk)
    each = (bits if axis == 1 else turned(bits, axis) for axis in range(3))
    axes = tuple(_along(voxels, axis, along) for axis, along in enumerate(each))
    return ChordLengths(phase, grid.frame.unit, axes)  # type: ignore[arg-type]


def _along(voxels: Voxels, axis: int, bits: Phase) -> Chords:
    """Return the chords along an axis, which is y of the bits."""
    from porous.kernels.chords import runs_along

    h, wraps = voxels.frame.spacing[axis], voxels.frame.periodic[axis]
    found = runs_along(bits, wraps=wraps, goes_on=not voxels.walled)
    ends = int(2 * found.whole.sum() + found.halves.sum())
    fine = _mean(_inside(found, voxels.frame.shape[axis]), ends, h)
    each = zip(found.voxels.tolist(), found.ends.tolist(), strict=True)
    told = [_mean(*every_other, 2 * h) for every_other in each if every_other[1]]
    return Chords(
        h,
        found.whole,
        found.halves + found.pieces,
        ends,
        found.endless,
        max(told, key=lambda mean: abs(mean - fine), default=math.nan),
        _places(voxels, axis, bits),
    )


def _inside(runs: Runs, n: int) -> int:
    """Return how many voxels of lines of n lie in runs."""
    counts = runs.whole + runs.halves + runs.pieces
    return int(np.arange(len(counts)) @ counts) + runs.endless * n


def _mean(voxels: int, ends: int, spacing: float) -> float:
    return 2 * spacing * voxels / ends if ends else math.nan


def _places(voxels: Voxels, axis: int, bits: Phase) -> Ints:
    from porous.kernels.chords import runs_along

    n, wraps = voxels.frame.shape[axis], voxels.frame.periodic[axis]
    if voxels.bulk is None:
        lines = voxels.frame.size // n
        return lines * (np.full(n, n) if wraps else np.arange(n, 0, -1))
    runs = runs_along(bits.bulk, wraps=wraps, goes_on=True)
    counts = runs.whole + runs.halves + runs.pieces
    return np.asarray(_fitting(counts) + runs.endless * n, np.int64)


def _fitting(counts: Ints) -> Ints:
    """Return at how many places 1 … n voxels in a row fit into runs of these lengths."""
    longer = np.cumsum(counts[:0:-1])
    return np.asarray(np.cumsum(longer)[::-1], np.int64)


def chords(lengths: ChordLengths) -> Measures:
    """Return the mean chord length along each axis: pore_chord_mean_x, … or wall_chord_mean_x, ….

    The length of a phase over half the number of ends that its chords have at the other one
    (E. E. Underwood, Quantitative Stereology, 1970): chords that a side cuts count as the parts
    that they are.

    Parameters
    ----------
    lengths
        What ``chord_lengths`` found.

    Returns
    -------
    Measures
        The uncertainty is what is missed of chords shorter than a voxel h: the difference to lines
        of every other voxel, and h²/mean. It is not known where the mean is infinite.
    """
    return Measures(tuple(_rows(lengths)))


def _rows(lengths: ChordLengths) -> Iterator[Measure]:
    for axis, found in zip("xyz", lengths.axes, strict=True):
        name, mean = f"{PREFIX[lengths.phase]}_chord_mean_{axis}", found.mean
        known = math.isfinite(mean) and math.isfinite(found.coarse)
        doubt = abs(mean - found.coarse) + found.spacing**2 / mean if known else math.inf
        yield Measure(name, mean, lengths.unit, METHOD, doubt, "standard", "grid")


def pore_chord_mean(grid: Tiled | Census) -> Measure:
    """Return the mean chord length of pores over all lines, 4 V/A, in the grid's unit.

    V is the volume of the pores in the frame, by voxel fill, and A the area between them and the
    solid, by crofton (``interface_area``); Cauchy's formula holds for any body. The uncertainty is
    that of both.

    Raises
    ------
    GridError
        Where there is no interface, or the bulk is not the frame, beyond which a grid does not
        tell pores from what is not there.
    """
    census = Census.of(grid)
    if census.has_bulk:
        raise GridError("pore_chord_mean: the bulk is not the grid's box; wanted a box")
    amounts = Amounts(census)
    voids = census.frame.size - amounts.everywhere
    area = AREAS["interface_area", "crofton"](census)
    return _over(census, area, voids, amounts.inside_doubt, "pore")


def wall_chord_mean(grid: Tiled | Census, *, beyond: str = "void") -> Measure:
    """Return the mean chord length of solid over all lines, 4 V/A, in the grid's unit.

    V is the volume of the solid by voxel fill and A its ``surface_area`` by crofton: along axes
    that are not periodic the solid ends where the frame does. With ``beyond="unknown"`` it does
    not, and A is its ``interface_area``.

    Raises
    ------
    GridError
        Where there is no surface.
    """
    census = Census.of(grid)
    amounts = Amounts(census)
    goes_on = beyond == "unknown"
    area = AREAS["interface_area" if goes_on else "surface_area", "crofton"](census)
    doubt = amounts.inside_doubt if goes_on else amounts.everywhere_doubt
    return _over(census, area, amounts.everywhere, doubt, "wall")


def _over(census: Census, area: Measure, voxels: float, doubt: float, prefix: str) -> Measure:
    name, volume = f"{prefix}_chord_mean", voxels * census.frame.voxel_volume
    if not (area.value > 0 and voxels > 0):
        raise GridError(f"{name}: got volume {volume:.6g} and area {area.value:.6g}; wanted both")
    value = 4 * volume / area.value
    spread = value * math.hypot(area.uncertainty / area.value, doubt / voxels)
    return Measure(name, value, census.frame.unit, "crofton", spread, "standard", "grid")
