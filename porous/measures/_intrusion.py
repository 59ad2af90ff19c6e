"""What balls that come from outside reach: mercury intrusion, percolation, accessible porosity."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.measures._sample import Sample
from porous.measures._thickness import check_sizes, within_bulk
from porous.measures._trapped import missed_by
from porous.memory import check_memory
from porous.values import Measure, Measures
from porous.values.value import Value, adopted, frozen

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.kernels.distance import Numbers, Squares
    from porous.kernels.widest import Ways
    from porous.values import Frame, VoxelGrid

    Bools = NDArray[np.bool_]
    Floats = NDArray[np.float64]
    Index = tuple[int, int, int]
    Progress = Callable[[str, float], None]
    Three = tuple[float, float, float]

NAME, WAYS, BALLS = "access", "widest paths", "balls from outside"
"""What progress is told of, and methods."""

BYTES = {True: 24.0, False: 48.0}
"""Memory per voxel, by whether squares of distances are whole numbers."""


@dataclass(frozen=True, eq=False)
class MercuryIntrusion(Value):
    """Diameters at which mercury, or any ball from outside, comes to each voxel of the pores.

    Parameters
    ----------
    frame
        Where the voxels lie.
    diameters
        float32, shape ``frame.shape``, in ``frame.unit``: 0 where nothing comes, and beyond the
        bulk.
    sizes, shares
        Shape (n,): the diameters that occur, ascending, and the part of the pores' volume that has
        each; what shares lack to 1 is never reached.
    porosity
        The pores' part of the bulk, by voxel count.
    doubt
        Standard uncertainty of a diameter, in ``frame.unit``.

    Raises
    ------
    GridError
        Where shapes disagree.
    """

    frame: Frame
    diameters: NDArray[np.float32] = field(repr=False)
    sizes: Floats = field(repr=False)
    shares: Floats = field(repr=False)
    porosity: float
    doubt: float

    def __post_init__(self) -> None:
        self._set("diameters", frozen(self.diameters, np.float32))
        self._set("sizes", frozen(self.sizes, np.float64))
        self._set("shares", frozen(self.shares, np.float64))
        check_sizes(self.frame, self.diameters, self.sizes, self.shares)

    @property
    def reached(self) -> float:
        """The part of the pores' volume that anything comes to."""
        return float(self.shares.sum())

    def share(self, diameter: float) -> float:
        """Return the part of the pores' volume that balls of a diameter, or larger ones, sweep."""
        return float(self.shares[self.sizes >= diameter * (1 - 1e-9)].sum())

    def quantile(self, part: float) -> float:
        """Return the diameter that this part of the volume that is reached does not exceed.

        NaN where none is.
        """
        if not len(self.sizes):
            return math.nan
        place = np.searchsorted(np.cumsum(self.shares), part * self.reached * (1 - 1e-12))
        return float(self.sizes[min(int(place), len(self.sizes) - 1)])


def mercury_intrusion(grid: VoxelGrid, *, progress: Progress | None = None) -> MercuryIntrusion:
    """Return at which diameters a liquid that does not wet comes to each place of the pores.

    It fills what a ball of some diameter sweeps whose centre comes from outside (E. W. Washburn,
    Proc. Natl. Acad. Sci. 7, 1921: pressure p lets in what is wider than d = 4 γ cos θ/p). A centre
    goes from voxel to voxel by faces, edges and corners; along its way the ball is no larger than
    where the pore is narrowest. Over each voxel stands the largest ball that comes to it so: what
    local thickness is of balls that need not come from anywhere. Equal to trying all of them.

    Parameters
    ----------
    grid
        The body; any spacing. Balls come in by all sides that are not periodic, and from pores that
        lie beyond the bulk; their centres are looked at in the grid and in the bulk.
    progress
        Called as ``progress("access", done)`` with done in 0 … 1; raising in it cancels.

    Returns
    -------
    MercuryIntrusion
        A diameter is that between walls, as ``local_thickness`` tells it, which is no less
        anywhere; its doubt is one voxel (its longest edge, and twice the grid's sampling error).

    Raises
    ------
    GridError
        Where one of the phases is missing, or the grid is periodic along all axes and all bulk.
    MemoryLimitError
        Where there is too little memory.
    """
    return _mercury(Sample(grid, progress=progress))


def _mercury(sample: Sample) -> MercuryIntrusion:
    ways = ways_of(sample)
    check_outside(sample)
    return intrusion(sample, ways)


def check_outside(sample: Sample) -> None:
    """Raise ``GridError`` where balls come from nowhere."""
    if not has_outside(sample):
        raise GridError(
            "access: the grid is periodic along all axes, so that nothing comes from outside; "
            "wanted an axis that is not, or pores beyond the bulk"
        )


def accessible_porosity(grid: VoxelGrid, *, probe: float) -> Measure:
    """Return the part of the bulk that a ball from outside sweeps, unit 1.

    Its centre comes from a side that is not periodic, or from void that is not of the bulk; see
    ``mercury_intrusion``. What it sweeps is the union of balls of this diameter and of larger ones
    that come as far, which hold it; with centres beyond the sides too it is ``trapped_volume`` that
    is left.

    Parameters
    ----------
    grid
        The body.
    probe
        The ball's diameter, in the grid's unit.

    Returns
    -------
    Measure
        The uncertainty holds what it would be for balls by a voxel smaller and larger, and the
        difference to voxels twice as large; infinite where there are none.

    Raises
    ------
    GridError
        For a probe that is not positive, and as ``mercury_intrusion``.
    MemoryLimitError
        Where there is too little memory.
    """
    sample = Sample(grid)
    _squares(sample)
    check_outside(sample)
    return accessible(sample, probe)


def accessible(sample: Sample, probe: float) -> Measure:
    """Return the accessible porosity of a sample with both phases and an outside."""
    if not (math.isfinite(probe) and probe > 0):
        raise GridError(f"probe: got {probe}; wanted a diameter above 0")
    pores = int(np.count_nonzero(sample.voxels("pore").counted))
    bulk = sample.voxels("pore").bulk_count
    missed = missed_by(sample, probe, around=False)
    whole = bulk * sample.frame.voxel_volume
    value, doubt = max(pores / bulk - missed.value / whole, 0.0), missed.doubt / whole
    return Measure("accessible_porosity", value, "1", BALLS, doubt, "standard", "grid")


def percolation_diameters(grid: VoxelGrid) -> Measures:
    """Return the diameters of the largest balls that pass through the pores, axis by axis.

    Along an axis that is not periodic a ball passes whose centre goes from the first layer of the
    bulk to the last; along one that is, whose centre comes to the same place one or more periods
    on. Its centre stays in pores of the bulk and goes from voxel to voxel by faces, edges and
    corners. Known as critical pore diameter (A. J. Katz, A. H. Thompson, Phys. Rev. B 34, 1986).

    Parameters
    ----------
    grid
        The body; any spacing.

    Returns
    -------
    Measures
        percolation_diameter_x, percolation_diameter_y and percolation_diameter_z, those that are:
        where nothing passes there is no row. The uncertainty is that of a diameter (see
        ``mercury_intrusion``) and the difference to voxels twice as large, which is the whole
        diameter where nothing passes there; infinite where these have but one phase.

    Raises
    ------
    GridError
        Where one of the phases is missing.
    MemoryLimitError
        Where there is too little memory.
    """
    sample = Sample(grid)
    fine, coarse = passing(sample, ways_of(sample)), None
    if sample.coarse is not None and sample.coarse.has_both:
        coarse = passing(sample.coarse, ways_of(sample.coarse))
    return Measures(percolation_rows(sample, fine, coarse))


def percolation_rows(sample: Sample, fine: Three, coarse: Three | None) -> tuple[Measure, ...]:
    """Return the rows of diameters that pass, zero where none does, at both resolutions.

    Where there is a coarser sample of which nothing is known, it has lost a phase.
    """
    lost = 0.0 if sample.coarse is None else math.inf
    return tuple(
        Measure(
            f"percolation_diameter_{axis}",
            value,
            sample.frame.unit,
            WAYS,
            math.hypot(doubt_of(sample), lost if coarse is None else coarse[a] - value),
            "standard",
            "grid",
        )
        for a, (axis, value) in enumerate(zip("xyz", fine, strict=True))
        if value
    )


def ways_of(sample: Sample) -> Ways:
    """Return the widest ways into the pores of a sample and through them.

    Raises
    ------
    GridError
        Where one of the phases is missing.
    MemoryLimitError
        Where there is too little memory.
    """
    from porous.kernels.widest import widest

    bulk, frame = sample.grid.bulk, sample.frame
    free = None if bulk is None else bulk < 128
    return widest(
        _squares(sample),
        ends=_ends(frame.shape, free),
        free=free,
        periodic=frame.periodic,
        progress=_part(sample, 0.0, 0.5),
    )


def _ends(shape: Index, free: Bools | None) -> tuple[Index, Index]:
    """Return the outermost layers of the bulk, along each axis."""
    if free is None:
        return (0, 0, 0), (shape[0] - 1, shape[1] - 1, shape[2] - 1)
    held = (np.flatnonzero(~free.all(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1)))
    (a, d), (b, e), (c, f) = ((int(layers[0]), int(layers[-1])) for layers in held)
    return (a, b, c), (d, e, f)


def doubt_of(sample: Sample) -> float:
    """Return the doubt of a diameter: a voxel, and twice what sampling is off."""
    return math.hypot(max(sample.frame.spacing), 2 * sample.grid.sampling_error)


def passing(sample: Sample, ways: Ways) -> Three:
    """Return the diameter of the largest ball that passes along each axis; 0 where none does."""
    if not ways.through.any():
        return 0.0, 0.0, 0.0
    x, y, z = 2 * sample.half_widths("pore", ways.through)
    return float(x), float(y), float(z)


def _squares(sample: Sample) -> Squares:
    """Return the squared distances of the pores.

    Raises
    ------
    GridError
        Where one of the phases is missing.
    MemoryLimitError
        Where there is too little memory for what comes after.
    """
    from porous.kernels.distance import FAR

    frame = sample.frame
    each = BYTES[len(set(frame.spacing)) == 1]
    size = " × ".join(map(str, frame.shape))
    check_memory(frame.size * each, f"access of {size} voxels", "Use fewer voxels, or a part.")
    squares = sample.squares("pore")
    if squares.values.max() >= FAR:
        raise GridError("access: all voxels are pore; wanted both phases")
    return squares


def has_outside(sample: Sample) -> bool:
    """Tell whether there is a side that is not periodic, or a pore beyond the bulk."""
    bulk = sample.grid.bulk
    beyond = bulk is not None and bool(((bulk < 128) & ~sample.grid.solid).any())
    return beyond or not all(sample.frame.periodic)


def intrusion(sample: Sample, ways: Ways) -> MercuryIntrusion:
    """Return what ``mercury_intrusion`` does, of a sample with an outside."""
    from porous.kernels.thickness import largest_balls
    from porous.kernels.thinned import thinned

    bulk, periodic = sample.voxels("pore").bulk, sample.frame.periodic
    squares = within_bulk(sample.squares("pore"), bulk)
    reached = within_bulk(squares._replace(values=ways.inward), bulk).values
    if reached.any():
        balls = thinned(squares, reached, periodic=periodic)
        found = largest_balls(balls, periodic=periodic, progress=_part(sample, 0.5, 1.0))
        reached = np.maximum(found, reached, out=found)
    return _told(sample, reached)


def _part(sample: Sample, start: float, stop: float) -> Callable[[int, int], None]:
    return lambda done, count: sample.tell(NAME, start + (stop - start) * done / max(count, 1))


def _told(sample: Sample, reached: Numbers) -> MercuryIntrusion:
    from porous.kernels.diameters import Widths, different, half_widths, tally

    counted = ~sample.grid.solid if sample.grid.bulk is None else sample.voxels("pore").counted
    bulk = sample.frame.size
    if sample.grid.bulk is not None:
        bulk = int(np.count_nonzero(sample.grid.bulk >= 128))
    pores = int(np.count_nonzero(counted))
    wide, step = sample.widths("pore"), sample.squares("pore").step
    if reached.any():
        # Balls that come from outside may have squares that no largest ball has.
        wide = Widths(values := different(reached), half_widths(values, wide))
    found = tally(reached, counted, wide, step)
    some = found.sizes > 0
    return MercuryIntrusion(
        sample.frame,
        adopted(found.diameters),
        found.sizes[some],
        found.counts[some] / pores,
        pores / bulk,
        doubt_of(sample),
    )
