"""What stays in a body: pores that a probe cannot reach, and pools that cannot drain."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import GridError
from porous.measures._build import Direction, check_room, directions_named, layers_of, paired, row
from porous.measures._sample import Sample, Survey
from porous.memory import check_memory
from porous.values import Measure, Measures

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.kernels.diameters import Widths
    from porous.kernels.distance import Squares
    from porous.kernels.spans import Layers
    from porous.measures._sample import Progress
    from porous.values import Frame, VoxelGrid

    Bools = NDArray[np.bool_]

FLOOD, PROBE = "voxel flood", "probe flood"

CUPS = 8.0
"""Bytes per voxel that spans of void take."""

CORNER = 1 + math.sqrt(0.5)
"""Radius, in voxels, of the least ball that misses the centre of a voxel in a corner."""

EACH = 28.0
"""Bytes per voxel that a probe's flood takes, of the grid and a margin as wide as the probe."""


def trapped_volume(
    grid: VoxelGrid, *, probe: float | None = None, progress: Progress | None = None
) -> Measure:
    """Return the volume of the pores that nothing gets out of: powder, resin.

    Without a probe that is the closed pores: joined, by faces, edges and corners of voxels, with no
    outside. With one it is all that a ball of that diameter which comes from outside cannot touch,
    behind openings that are too narrow as well as in corners that are too tight. A ball goes where
    its centre goes, from voxel to voxel where pores are as wide between walls as its diameter, or
    wider; and where a larger one has room it touches what that one does. It reaches in from beyond
    the sides too, with its centre outside of the grid. What is missed is the mean of what balls do
    that end at walls about all of these voxels, and about those alone where they are as large as
    the probe.

    Parameters
    ----------
    grid
        The body; any spacing. Outside is what lies beyond sides that are not periodic, and void
        that is not of the bulk.
    probe
        Diameter of the ball, in the grid's unit; None for the closed pores.
    progress
        Called as ``progress("trapped volume", done)``; raising in it cancels.

    Returns
    -------
    Measure
        ``trapped_volume``, in the grid's unit cubed. The uncertainty is the difference to half the
        resolution, and the larger of those to probes by a voxel smaller and larger, or without a
        probe that to pores joined by faces alone. Infinite where there is no outside.

    Raises
    ------
    GridError
        For a probe that is no length, or wider than the grid.
    MemoryLimitError
        Where there is too little memory.
    """
    return grid_trapped(Sample(grid, how=Survey(probe=probe), progress=progress))


def cupped_volume(
    grid: VoxelGrid, *, direction: str | None = None, progress: Progress | None = None
) -> Measures:
    """Return the volume of liquid that rests in a body and cannot drain, for six ways to hold it.

    That is pores from which every way to the outside leads up before it leads out, higher than they
    lie themselves: what is left of resin when the body is taken off the plate and held as it was
    built. Closed pores are not counted, they are ``trapped_volume``. The liquid has no surface
    tension.

    Parameters
    ----------
    grid
        The body; any spacing. Outside is what lies beyond sides that are not periodic, below and
        above too, and void that is not of the bulk.
    direction
        ``"z_up"`` is held with the high end of z up, ``"z_down"`` the other way round; x and y as
        well; all six where not given.
    progress
        Called as ``progress("cupped volume", done)``; raising in it cancels.

    Returns
    -------
    Measures
        cupped_volume_z_up, …, in the grid's unit cubed; none along periodic axes. The uncertainty
        is the difference to half the resolution, and that to pores joined by faces alone.

    Raises
    ------
    GridError
        For an unknown direction or one along a periodic axis.
    MemoryLimitError
        Where there is too little memory.
    """
    directions = directions_named(direction, grid.frame)
    return grid_cupped(Sample(grid, progress=progress), directions)


def grid_cupped(sample: Sample, directions: Sequence[Direction]) -> Measures:
    """Return the cups of a grid."""
    check_room(sample.frame, CUPS, "cupped volume")
    rows, unit = [], f"{sample.frame.unit}³"
    layers = {
        id(of): layers_of(_kinds(of), directions)
        for of in (sample, sample.coarse)
        if of is not None
    }
    for place, direction in enumerate(directions):
        sample.tell("cupped volume", place / len(directions))

        def volumes(of: Sample, direction: Direction = direction) -> tuple[float, float]:
            return _held(of, layers[id(of)][direction], direction)

        (wide, doubt), (narrow, _) = paired(sample, volumes)
        doubt = math.hypot(doubt, wide - narrow)
        rows.append(row(f"cupped_volume_{direction.name}", wide, unit, FLOOD, doubt))
    return Measures(tuple(rows))


def _kinds(sample: Sample) -> NDArray[np.uint8]:
    from porous.kernels.drain import BEYOND, PORE

    grid = sample.grid
    kinds = (~grid.solid).view(np.uint8)
    kinds *= PORE
    if grid.bulk is not None:
        kinds[(kinds == PORE) & (grid.bulk < 128)] = BEYOND
    return kinds


def _held(sample: Sample, layers: Layers, direction: Direction) -> tuple[float, float]:
    """Return the volume that is held by pores joined by corners too, and by faces alone."""
    from porous.kernels.drain import held

    around, voxel = direction.around(sample.frame), sample.frame.voxel_volume
    wide, narrow = (
        float(held(layers, connectivity, periodic=around).sum()) * voxel for connectivity in (26, 6)
    )
    return wide, narrow


def has_outside(sample: Sample) -> bool:
    """Tell whether a grid's pores could lead anywhere outside of it."""
    return not all(sample.frame.periodic) or sample.grid.bulk is not None


def grid_trapped(sample: Sample) -> Measure:
    """Return what is trapped in a grid, for the probe that is asked for or none."""
    unit, probe = f"{sample.frame.unit}³", sample.how.probe
    if not has_outside(sample):
        return row("trapped_volume", math.inf, unit, FLOOD, math.inf)
    if probe is None:
        (wide, doubt), (narrow, _) = paired(sample, _closed)
        return row("trapped_volume", wide, unit, FLOOD, math.hypot(doubt, narrow - wide))
    if not (math.isfinite(probe) and probe > 0):
        raise GridError(f"probe: got {probe}; wanted a diameter above 0")
    longest = max(sample.frame.box.lengths)
    if probe > longest:
        raise GridError(f"probe: got {probe}; wanted a diameter up to {longest:.6g}, the grid's")
    missed = missed_by(sample, probe)
    return row("trapped_volume", missed.value, unit, PROBE, missed.doubt)


def _closed(sample: Sample) -> tuple[float, float]:
    """Return the volume of pores that reach no outside, joined by corners too or by faces."""
    census, voxel = sample.census, sample.frame.voxel_volume
    found = []
    for connectivity in (26, 6):
        pores = census.pieces(solid=False, connectivity=connectivity, in_bulk=True)
        found.append(float(pores.voxels[~pores.outside].sum()) * voxel)
    return found[0], found[1]


class Missed(NamedTuple):
    """What balls of a diameter do not touch, in the frame's unit cubed, and its doubt."""

    value: float
    doubt: float


def missed_by(sample: Sample, probe: float, *, around: bool = True) -> Missed:
    """Return the volume of the pores that no ball touches that comes from outside.

    Parameters
    ----------
    sample
        The body, with an outside.
    probe
        The ball's diameter.
    around
        Whether it touches the grid with its centre beyond the grid's sides, or the bulk, too.

    Returns
    -------
    Missed
        Its doubt is the larger difference to balls by a voxel smaller and larger, and that to half
        the resolution; infinite where there is none. Of balls that are so small that they touch the
        centres of all voxels, it is what they leave along edges between walls.
    """
    if not sample.has_both:
        return Missed(0.0, 0.0)
    flood, edge = _Flood(sample, probe, around=around), max(sample.frame.spacing)
    sample.tell("trapped volume", 0.3)
    value = 0.5 * sum(flood.missed(probe))
    sample.tell("trapped volume", 0.6)
    least = flood.missed(probe - edge)[0] if probe > edge else 0.0
    most = flood.missed(probe + edge)[1]
    sample.tell("trapped volume", 1.0)
    other, coarse = math.inf, sample.coarse
    if coarse is not None and coarse.has_both:
        other = 0.5 * sum(_Flood(coarse, probe, around=around).missed(probe))
    doubt = max(value - least, most - value, flood.edges(probe))
    return Missed(value, math.hypot(doubt, other - value))


class _Flood:
    """Balls in the pores of a grid and around it as far as they reach in.

    A ball about a voxel's centre ends at that of the nearest voxel of solid, half a voxel beyond
    the wall where that is flat and faces it along an axis: where the distance falls by a whole
    voxel to the next one. There ``inner``, the square of what is free, is so much less.
    """

    def __init__(self, sample: Sample, probe: float, *, around: bool) -> None:
        from porous.kernels.distance import squared_distances

        self.sample, grid, frame = sample, sample.grid, sample.frame
        edge = max(frame.spacing)
        self.margins = _margins(frame, probe + edge) if around else [(0, 0)] * 3
        size = " × ".join(map(str, frame.shape))
        count = math.prod(n + a + b for n, (a, b) in zip(frame.shape, self.margins, strict=True))
        what = f"a flood of {size} voxels, and around them as far as a probe reaches,"
        check_memory(count * EACH, what, "Use a smaller probe, or fewer voxels.")
        self.around, self.void = around, np.pad(~grid.solid, self.margins, constant_values=True)
        sample.tell("trapped volume", 0.1)
        self.squares = squared_distances(self.void, frame.spacing, periodic=frame.periodic)
        self.inner = _free(self.squares, frame)

    def missed(self, probe: float) -> tuple[float, float]:
        """Return the volume that no ball touches, of those that pass, and that fit about voxels.

        Centres pass where the pores are as wide as the probe between walls, which may be half a
        voxel beside the voxel's centre; of these those fit that need not be beside it, and those
        that stand for places where no voxel near by does. Where there is room for larger balls they
        are taken: all that they touch is touched.
        """
        squares, sample = self.squares, self.sample
        passing = squares.values >= _square(probe / 2 / squares.step, sample.widths("pore"))
        from_outside = _from_outside(passing & self.void, sample.grid, self)
        fits = self.inner >= (probe / 2 / squares.step) ** 2 * (1 - 1e-5)
        fits &= from_outside
        near = fits
        for axis, wraps in enumerate(sample.frame.periodic):
            near = near | _beside(near, axis, wraps)
        return self._untouched(from_outside), self._untouched(from_outside & (fits | ~near))

    def edges(self, probe: float) -> float:
        """Return what a ball leaves along edges between walls, where these are at right angles."""
        frame, solid = self.sample.frame, self.sample.grid.solid
        beside = [_beside(solid, axis, wraps) for axis, wraps in enumerate(frame.periodic)]
        edges = sum(np.asarray(one, np.int8) for one in beside) > 1
        count = int(np.count_nonzero(edges & ~solid))
        radius = min(probe / 2 / min(frame.spacing), CORNER)
        return count * (1 - math.pi / 4) * radius**2 * frame.voxel_volume

    def _untouched(self, centres: Bools) -> float:
        from porous.kernels.reached import held_by_balls

        grid, frame = self.sample.grid, self.sample.frame
        balls = np.where(centres, self.inner, np.float32(0))
        touched = held_by_balls(balls, self.squares.weights, periodic=frame.periodic)
        each = zip(frame.shape, self.margins, strict=True)
        missed = ~touched[tuple(slice(a, a + n) for n, (a, _) in each)] & ~grid.solid
        if grid.bulk is not None:
            missed &= grid.bulk >= 128
        return float(np.count_nonzero(missed)) * frame.voxel_volume


def _beside(solid: Bools, axis: int, wraps: bool) -> Bools:  # noqa: FBT001
    """Return which voxels have solid beside them along an axis."""
    around = [(0, 0)] * 3
    around[axis] = (1, 1)
    wide = np.moveaxis(np.pad(solid, around, mode="wrap" if wraps else "constant"), axis, 0)
    return np.moveaxis(wide[2:] | wide[:-2], 0, axis)


def _square(half: float, wide: Widths) -> float:
    """Return the least square of balls that are so wide, but for rounding."""
    roots, radii = np.append(0.0, np.sqrt(wide.squares)), np.append(0.0, wide.radii)
    half *= 1 - 1e-9
    over = half - float(radii[-1])
    if over > 0:
        return (float(roots[-1]) + over) ** 2 * (1 - 1e-9)
    i = int(np.searchsorted(radii, half))
    part = (half - radii[i - 1]) / (radii[i] - radii[i - 1])
    return float(roots[i - 1] + part * (roots[i] - roots[i - 1])) ** 2 * (1 - 1e-9)


def _free(squares: Squares, frame: Frame) -> NDArray[np.float32]:
    """Return squares of balls, less half a voxel where they end at a flat wall along an axis."""
    roots = np.sqrt(squares.values, dtype=np.float32)
    beyond = np.full_like(roots, np.inf)
    for axis, wraps in enumerate(frame.periodic):
        edge = np.float32(math.sqrt(squares.weights[axis]))
        for step in (1, -1):
            beside = np.roll(roots, step, axis=axis)
            if not wraps:
                np.moveaxis(beside, axis, 0)[0 if step == 1 else -1] = np.inf
            np.subtract(beside, roots, out=beside)
            walled = beside <= -edge * np.float32(1 - 1e-5)
            beyond[walled] = np.minimum(beyond[walled], edge / 2)
    roots -= np.where(np.isfinite(beyond), beyond, np.float32(0))
    return np.multiply(roots, roots, out=roots)


def _margins(frame: Frame, probe: float) -> list[tuple[int, int]]:
    """Return how many voxels beyond each side balls may touch the grid from."""
    each = zip(frame.spacing, frame.periodic, strict=True)
    return [(0, 0) if wraps else (math.ceil(probe / 2 / h) + 1,) * 2 for h, wraps in each]


def flooded(frame: Frame, probe: float) -> int:
    """Return how many voxels a probe's flood is of: the frame's, and those of its margins."""
    each = zip(frame.shape, _margins(frame, probe), strict=True)
    return math.prod(n + a + b for n, (a, b) in each)


def _from_outside(fits: Bools, grid: VoxelGrid, flood: _Flood) -> Bools:
    """Return the voxels of a mask that are joined with the outside, of the grid with margins.

    Where balls have their centres in the bulk, of those alone.
    """
    from porous.kernels.components import label

    labels, count = label(fits, 26, periodic=grid.frame.periodic)
    found: Bools = np.zeros(count + 1, np.bool_)
    for axis, wraps in enumerate(grid.frame.periodic):
        if not wraps:
            found[np.unique(labels.take((0, -1), axis=axis))] = True
    free = None if grid.bulk is None else np.pad(grid.bulk < 128, flood.margins)
    if free is not None:
        found[np.unique(labels[free])] = True
    found[0] = False
    result = np.asarray(found[labels])
    if free is not None and not flood.around:
        result &= ~free
    return result
