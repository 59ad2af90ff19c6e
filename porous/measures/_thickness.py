"""How wide pores and how thick walls are: the largest ball that covers each voxel."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.measures._phase import PREFIX, voxels_of
from porous.values import Measure, Measures
from porous.values.value import Value, adopted, frozen

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from porous.kernels.diameters import Widths
    from porous.kernels.distance import Squares
    from porous.measures._phase import Voxels
    from porous.values import Frame
    from porous.values.tiled import Tiled

    Bools = NDArray[np.bool_]
    Floats = NDArray[np.float64]
    Progress = Callable[[str, float], None]

METHOD, RIDGE = "local thickness", "distance ridge"

BYTES = {True: 20.0, False: 40.0}
"""Memory per voxel, by whether squares of distances are whole numbers."""

NAMES = {
    "pore": ("largest_pore_diameter", "smallest_gap"),
    "solid": ("largest_wall", "smallest_wall"),
}


@dataclass(frozen=True, eq=False)
class LocalThickness(Value):
    """Diameters of the largest balls in a phase, voxel by voxel.

    Parameters
    ----------
    frame
        Where the voxels lie.
    diameters
        float32, shape ``frame.shape``, in ``frame.unit``: 0 outside of the phase, and in pores
        beyond the bulk.
    phase
        pore or solid.
    sizes, shares
        Shape (n,): the diameters that occur, ascending, and the part of the phase's volume that
        has each; shares add up to 1.
    smallest
        The least diameter where walls face each other; NaN where they do so nowhere.
    doubt
        Standard uncertainty of a diameter, in ``frame.unit``.

    Raises
    ------
    GridError
        Where shapes disagree.
    """

    frame: Frame
    diameters: NDArray[np.float32] = field(repr=False)
    phase: str
    sizes: Floats = field(repr=False)
    shares: Floats = field(repr=False)
    smallest: float
    doubt: float

    def __post_init__(self) -> None:
        self._set("diameters", frozen(self.diameters, np.float32))
        self._set("sizes", frozen(self.sizes, np.float64))
        self._set("shares", frozen(self.shares, np.float64))
        check_sizes(self.frame, self.diameters, self.sizes, self.shares)
        if not len(self.sizes):
            raise GridError("sizes and shares: got none; wanted one of each, at least")

    def quantile(self, part: float) -> float:
        """Return the diameter that this part of the phase's volume does not exceed."""
        place = np.searchsorted(np.cumsum(self.shares), part * (1 - 1e-12))
        return float(self.sizes[min(int(place), len(self.sizes) - 1)])


def check_sizes(
    frame: Frame, diameters: NDArray[np.float32], sizes: Floats, shares: Floats
) -> None:
    """Raise ``GridError`` where a map of diameters is not the frame's, or its sizes lack shares."""
    if diameters.shape != frame.shape:
        raise GridError(f"diameters: got shape {diameters.shape}; the frame has {frame.shape}")
    if sizes.ndim != 1 or sizes.shape != shares.shape:
        raise GridError(
            f"sizes and shares: got shapes {sizes.shape} and {shares.shape}; wanted one of each"
        )


def local_thickness(
    grid: Tiled,
    *,
    phase: str = "pore",
    beyond: str = "void",
    squares: Squares | None = None,
    progress: Progress | None = None,
) -> LocalThickness:
    """Return the local thickness of pores or of solid: of each voxel the largest ball over it.

    The diameter at a place is that of the largest ball that holds the place and no part of the
    other phase (T. Hildebrand & P. Rüegsegger, J. Microscopy 185, 1997), exactly so on the lattice:
    a ball about the centre of a voxel holds the voxels whose centres are nearer to it than that of
    the nearest voxel of the other phase. Its diameter is twice that distance, less or more by what
    balls of its size miss on average: the middle between walls, which is no voxel's centre, and the
    wall, which lies before the centre of the voxel beyond it (``kernels.diameters.widths``).

    Parameters
    ----------
    grid
        The body; any spacing. Along periodic axes balls go on into its copies. Centres of balls in
        pores lie in the bulk; what is near its boundary they may reach beyond.
    phase
        pore or solid.
    beyond
        What lies beyond sides that are not periodic: ``"void"``, so that solid ends there, or
        ``"unknown"``, for what was cut out of a larger body: then nothing does. No pore ends at a
        side. Centres of balls lie within the grid in any case, so that next to sides where a phase
        goes on balls are fewer, and thicknesses those of what is seen.
    squares
        What ``squared_distances`` found of this phase, if that is known already.
    progress
        Called as ``progress("local thickness", done)`` with done in 0 … 1; raising in it cancels.

    Returns
    -------
    LocalThickness
        The diameter's doubt is one voxel (its longest edge, and twice the grid's sampling error):
        medians of balls, tubes and flat walls of 5 to 28 voxels, anywhere among the voxels and in
        any direction, were right within it (``analysis/12``).

    Raises
    ------
    GridError
        Where one of the phases is missing, or squares are not those of the phase.
    MemoryLimitError
        Where there is too little memory.
    """
    from porous.kernels.distance import squared_distances

    frame, voxels = grid.frame, thickness_voxels(grid, phase, beyond)
    if squares is None:
        squares = squared_distances(
            voxels.mask,
            frame.spacing,
            periodic=frame.periodic,
            walled=voxels.walled,
            progress=_part(progress, 0.0, 0.4),
        )
    elif not np.array_equal(squares.values > 0, voxels.mask):
        raise GridError("squares: got those of another body; wanted those of this phase")
    return local_and_widths(grid, phase, voxels, squares, progress)[0]


def thickness_voxels(grid: Tiled, phase: str, beyond: str) -> Voxels:
    """Return the voxels of a phase, once it is known that there is room for local thickness."""
    alike = len(set(grid.frame.spacing)) == 1
    return voxels_of(grid, phase, beyond, METHOD, BYTES[alike])


def local_and_widths(
    grid: Tiled, phase: str, voxels: Voxels, squares: Squares, progress: Progress | None = None
) -> tuple[LocalThickness, Widths]:
    """Return what ``local_thickness`` does of a phase's voxels and the squares of their distances.

    And how wide balls are by which it was told.
    """
    from porous.kernels.diameters import half_widths, smallest, tally, widths
    from porous.kernels.distance import FAR
    from porous.kernels.thickness import largest_balls

    frame = grid.frame
    periodic, walled = frame.periodic, voxels.walled
    if squares.values[0, 0, 0] >= FAR:  # then all are
        raise GridError(
            f"local thickness: all voxels are {phase}, which ends nowhere; wanted both phases"
        )
    inner = within_bulk(squares, voxels.bulk)
    balls = largest_balls(inner, periodic=periodic, progress=_part(progress, 0.4, 1.0))
    least = smallest(squares, balls, periodic=periodic, walled=walled)
    wide = widths(squares, balls, periodic)
    found = tally(balls, voxels.counted, wide, squares.step)
    if math.isfinite(least):
        least = 2 * squares.step * float(half_widths(np.float64(least), wide))
    local = LocalThickness(
        frame,
        adopted(found.diameters),
        phase,
        found.sizes,
        found.counts / found.counts.sum(),
        least if math.isfinite(least) else math.nan,
        math.hypot(max(frame.spacing), 2 * grid.sampling_error),
    )
    return local, wide


def within_bulk(squares: Squares, bulk: Bools | None) -> Squares:
    """Return squares that are 0 beyond the bulk: balls that have their centres in it."""
    if bulk is None:
        return squares
    return squares._replace(values=np.where(bulk, squares.values, squares.values.dtype.type(0)))


def _part(
    progress: Progress | None, start: float, stop: float
) -> Callable[[int, int], None] | None:
    if progress is None:
        return None
    return lambda done, count: progress(METHOD, start + (stop - start) * done / count)


def thicknesses(local: LocalThickness) -> Measures:
    """Return what local thickness comes to: its mean, median, largest and smallest.

    Means and medians are weighted by volume. The smallest gap (or wall) is the least diameter at
    voxels about which walls face each other: from which no voxel near by lies deeper by half of its
    distance, or more. So places where walls taper at 60° and less count, and edges of cubes do not,
    where balls are as small as voxels.

    Parameters
    ----------
    local
        What ``local_thickness`` found.

    Returns
    -------
    Measures
        pore_thickness_mean, pore_thickness_p50, largest_pore_diameter and smallest_gap; of solid
        wall_thickness_mean, wall_thickness_p50, largest_wall and smallest_wall. All have the doubt
        of one diameter, for it is the same way off everywhere. No smallest one where there is none.
    """
    return Measures(tuple(_rows(local)))


def _rows(local: LocalThickness) -> Iterator[Measure]:
    prefix, unit = PREFIX[local.phase], local.frame.unit
    largest, smallest = NAMES[local.phase]
    values = {
        f"{prefix}_thickness_mean": float(local.sizes @ local.shares),
        f"{prefix}_thickness_p50": local.quantile(0.5),
        largest: float(local.sizes[-1]),
    }
    for name, value in values.items():
        yield Measure(name, value, unit, METHOD, local.doubt, "standard", "grid")
    if not math.isnan(local.smallest):
        yield Measure(smallest, local.smallest, unit, RIDGE, local.doubt, "standard", "grid")
