"""A grid under survey: what several families of measures need of it, worked out once."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

from porous.measures._census import Census
from porous.measures._phase import voxels_of
from porous.measures._thickness import local_and_widths, thickness_voxels
from porous.values import Frame, Measures, VoxelGrid
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from porous.kernels.diameters import Widths
    from porous.kernels.distance import Numbers, Squares
    from porous.measures._phase import Voxels
    from porous.measures._thickness import LocalThickness
    from porous.models.model import Model
    from porous.values import Curve

    Floats = NDArray[np.float64]
    Progress = Callable[[str, float], None]

T = TypeVar("T")

LEAST = 4
"""Voxels that the shortest edge of a coarser grid has at least."""

EACH = 8.0
"""Memory per voxel that squares of distances take."""


@dataclass(frozen=True)
class Survey:
    """What a survey is asked for.

    Parameters
    ----------
    beyond
        What lies beyond sides that are not periodic: ``"void"`` of a body that ends there, or
        ``"unknown"`` of what was cut out of a larger one.
    probe
        Diameter of the ball that pores are to let through; None for no ball in particular.
    smallest_wall, smallest_gap
        What the machine can make, None where there is no machine. Lengths are in the grid's unit.
    overhang
        Angle to the build plate, in degrees, below which a face that looks down needs support.
    seed
        Of what is drawn at random.
    """

    beyond: str = "void"
    probe: float | None = None
    smallest_wall: float | None = None
    smallest_gap: float | None = None
    overhang: float = 45.0
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Findings(Value):
    """What a survey has found: measures, curves for plots, and what the reader should know."""

    measures: Measures = field(default_factory=Measures)
    curves: tuple[Curve, ...] = ()
    notes: tuple[str, ...] = ()

    def __add__(self, other: Findings) -> Findings:
        return Findings(
            self.measures + other.measures, self.curves + other.curves, self.notes + other.notes
        )


@dataclass(frozen=True)
class Family:
    """Measures that are taken together.

    Parameters
    ----------
    name, title
        For programs and for people.
    place
        Where it comes among the others, the least first.
    take
        From a sample to what is found; a body without what is asked for gives nothing.
    """

    name: str
    title: str
    place: int
    take: Callable[[Sample], Findings]


class Sample:
    """A grid under survey; several threads may ask, what they share is worked out once.

    Parameters
    ----------
    grid
        The body, in memory.
    model
        What it samples, if anything.
    how
        What is asked for.
    progress
        Called with what is being done and its share done, from 0 to 1; raising in it cancels.
    census
        Of the grid, with what has been counted of it; a new one where not given.
    """

    def __init__(
        self,
        grid: VoxelGrid,
        *,
        model: Model | None = None,
        how: Survey | None = None,
        progress: Progress | None = None,
        census: Census | None = None,
    ) -> None:
        self.grid, self.model, self.progress = grid, model, progress
        self.how = how or Survey()
        self.census = Census(grid) if census is None else census
        self._kept: dict[str, object] = {}
        self._locks: dict[str, threading.RLock] = {}
        self._gate = threading.Lock()

    def _once(self, name: str, make: Callable[[], T]) -> T:
        """Return what ``make`` returned when it was first asked for by this name."""
        with self._gate:
            lock = self._locks.setdefault(name, threading.RLock())
        with lock:
            if name not in self._kept:
                self._kept[name] = make()
            return self._kept[name]  # type: ignore[return-value]

    @property
    def frame(self) -> Frame:
        """Where the voxels lie."""
        return self.grid.frame

    def has(self, phase: str) -> bool:
        """Tell whether a phase, pore or solid, has any voxel that counts."""
        return self._once(f"{phase} is there", lambda: self._has(phase))

    def _has(self, phase: str) -> bool:
        counts = self.census.fills.histogram
        found = counts[128:] if phase == "solid" else counts[:128, 128:]
        return bool(found.any())

    @property
    def has_both(self) -> bool:
        """Whether there is solid and there are pores."""
        return self.has("solid") and self.has("pore")

    def voxels(self, phase: str) -> Voxels:
        """Return the voxels of a phase.

        Raises
        ------
        GridError
            Where there are none.
        """
        return voxels_of(self.grid, phase, self.how.beyond, phase, 1.0)

    def squares(self, phase: str) -> Squares:
        """Return the squared distances of a phase's voxels to the other phase; kept."""
        return self._once(f"squares of {phase}", lambda: self._squares(phase))

    def _squares(self, phase: str) -> Squares:
        from porous.kernels.distance import squared_distances

        frame, voxels = self.frame, voxels_of(self.grid, phase, self.how.beyond, "distances", EACH)
        return squared_distances(
            voxels.mask, frame.spacing, periodic=frame.periodic, walled=voxels.walled
        )

    def thickness(self, phase: str) -> LocalThickness:
        """Return the local thickness of a phase; kept.

        Raises
        ------
        GridError
            Where one of the phases is missing.
        """
        return self._local(phase)[0]

    def half_widths(self, phase: str, squares: Numbers | Floats) -> Floats:
        """Return half the diameters of balls with these squares, in the frame's unit.

        They are those between walls that ``thickness`` tells; 0 of 0.

        Raises
        ------
        GridError
            Where one of the phases is missing.
        """
        from porous.kernels.diameters import half_widths

        return self.squares(phase).step * half_widths(squares, self.widths(phase))

    def widths(self, phase: str) -> Widths:
        """Return how wide balls of a phase are, in units of the squares' step."""
        return self._local(phase)[1]

    def _local(self, phase: str) -> tuple[LocalThickness, Widths]:
        def make() -> tuple[LocalThickness, Widths]:
            squares = self.squares(phase)
            voxels = thickness_voxels(self.grid, phase, self.how.beyond)
            return local_and_widths(self.grid, phase, voxels, squares, self.progress)

        return self._once(f"thickness of {phase}", make)

    @property
    def coarse(self) -> Sample | None:
        """The same body at half the resolution: a number there tells how far off it is here.

        Voxels are means of two by two by two; a last one of an odd number is left out along axes
        that are not periodic. None where the grid is too small, or cannot be halved along a
        periodic axis.
        """
        return self._once("coarse", self._coarse)

    def _coarse(self) -> Sample | None:
        shape = self.frame.shape
        odd = any(n % 2 and wraps for n, wraps in zip(shape, self.frame.periodic, strict=True))
        if odd or min(shape) < 2 * LEAST:
            return None
        return Sample(_halved(self.grid), model=self.model, how=self.how)

    def within(self, most: int) -> Sample:
        """Return the sample with ``most`` voxels or fewer: itself, or of coarser voxels."""
        if self.frame.size <= most or self.coarse is None:
            return self
        return self.coarse.within(most)

    def tell(self, name: str, done: float) -> None:
        """Say how far the work is; raises where somebody cancels."""
        if self.progress is not None:
            self.progress(name, done)


def _halved(grid: VoxelGrid) -> VoxelGrid:
    frame = grid.frame
    shape = tuple(n // 2 for n in frame.shape)
    spacing = tuple(2 * h for h in frame.spacing)
    coarse = Frame(frame.origin, spacing, shape, frame.periodic, frame.unit)  # type: ignore[arg-type]
    bulk = None if grid.bulk is None else _means(grid.bulk)
    return VoxelGrid(coarse, _means(grid.fill), bulk, grid.sampling, None, grid.sampling_error)


def _means(fill: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the mean of every two by two by two voxels, rounded."""
    from porous.kernels.means import block_means

    x, y, z = (2 * (n // 2) for n in fill.shape)
    return block_means(fill[:x, :y, :z], 2)
