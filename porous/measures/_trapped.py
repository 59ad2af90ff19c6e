"""What stays in a body: pores that a probe cannot reach, and pools that cannot drain."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.measures._build import Direction, check_room, directions_named, paired, row
from porous.measures._sample import Sample, Survey
from porous.memory import check_memory
from porous.values import Measure, Measures

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.measures._sample import Progress
    from porous.values import Frame, VoxelGrid

    Bools = NDArray[np.bool_]

FLOOD, PROBE = "voxel flood", "probe flood"

CUPS = 8.0
"""Bytes per voxel that layers in their order and runs of void take."""

EACH = 24.0
"""Bytes per voxel that a probe's flood takes, of the grid and a margin as wide as the probe."""


def trapped_volume(
    grid: VoxelGrid, *, probe: float | None = None, progress: Progress | None = None
) -> Measure:
    """Return the volume of the pores that nothing gets out of: powder, resin.

    Without a probe that is the closed pores: joined, by faces, edges and corners of voxels, with no
    outside. With one it is all that a ball of that diameter which comes from outside cannot touch,
    behind openings that are too narrow as well as in corners that are too tight. A ball goes where
    its centre goes, from voxel to voxel that is as far from the nearest solid voxel as half the
    diameter, or farther; and where a larger one has room it touches what that one does. It reaches
    in from beyond the sides too, with its centre outside of the grid.

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
        resolution, and without a probe that to pores joined by faces alone. Infinite where there is
        no outside.

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
    kinds = {id(of): _kinds(of) for of in (sample, sample.coarse) if of is not None}
    for place, direction in enumerate(directions):
        sample.tell("cupped volume", place / len(directions))

        def volumes(of: Sample, direction: Direction = direction) -> tuple[float, float]:
            return _held(of, kinds[id(of)], direction)

        (wide, doubt), (narrow, _) = paired(sample, volumes)
        doubt = math.hypot(doubt, wide - narrow)
        rows.append(row(f"cupped_volume_{direction.name}", wide, unit, FLOOD, doubt))
    return Measures(tuple(rows))


def _kinds(sample: Sample) -> NDArray[np.uint8]:
    from porous.kernels.drain import BEYOND, PORE

    grid = sample.grid
    kinds = np.where(grid.solid, np.uint8(0), np.uint8(PORE))
    if grid.bulk is not None:
        kinds[(kinds == PORE) & (grid.bulk < 128)] = BEYOND
    return kinds


def _held(sample: Sample, kinds: NDArray[np.uint8], direction: Direction) -> tuple[float, float]:
    """Return the volume that is held by pores joined by corners too, and by faces alone."""
    from porous.kernels.drain import held

    layers, around = direction.layers(kinds), direction.around(sample.frame)
    voxel = sample.frame.voxel_volume
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
    volume = _missed(sample, probe, told=True)
    doubt = math.inf
    if sample.coarse is not None:
        edge = max(sample.frame.spacing)
        less, here, more = (_missed(sample.coarse, probe + a) for a in (-edge, 0.0, edge))
        doubt = math.hypot(volume - here, max(here - less, more - here))
    return row("trapped_volume", volume, unit, PROBE, doubt)


def _closed(sample: Sample) -> tuple[float, float]:
    """Return the volume of pores that reach no outside, joined by corners too or by faces."""
    census, voxel = sample.census, sample.frame.voxel_volume
    found = []
    for connectivity in (26, 6):
        pores = census.pieces(solid=False, connectivity=connectivity, in_bulk=True)
        found.append(float(pores.voxels[~pores.outside].sum()) * voxel)
    return found[0], found[1]


def _missed(sample: Sample, probe: float, *, told: bool = False) -> float:
    """Return the volume of the pores that no ball of a diameter touches that comes from outside."""
    from porous.kernels.distance import squared_distances
    from porous.kernels.reached import held_by_balls

    grid, frame = sample.grid, sample.frame
    margins = _margins(frame, probe)
    size = " × ".join(map(str, frame.shape))
    what = f"a flood of {size} voxels, and around them as far as a probe reaches,"
    check_memory(flooded(frame, probe) * EACH, what, "Use a smaller probe, or fewer voxels.")
    void = np.pad(~grid.solid, margins, constant_values=True)

    def tell(done: float) -> None:
        if told:
            sample.tell("trapped volume", done)

    tell(0.1)
    squares = squared_distances(void, frame.spacing, periodic=frame.periodic)
    tell(0.3)
    # Where there is room for larger balls they are taken: all that they touch is touched.
    fits = squares.values >= (probe / 2 / squares.step) ** 2 * (1 - 1e-9)
    balls = squares.values.astype(np.float32)
    balls[~_from_outside(fits & void, grid, margins)] = 0
    tell(0.6)
    touched = held_by_balls(balls, squares.weights, periodic=frame.periodic)
    inner = tuple(slice(a, a + n) for n, (a, _) in zip(frame.shape, margins, strict=True))
    missed = ~touched[inner] & ~grid.solid
    if grid.bulk is not None:
        missed &= grid.bulk >= 128
    return float(np.count_nonzero(missed)) * frame.voxel_volume


def _margins(frame: Frame, probe: float) -> list[tuple[int, int]]:
    """Return how many voxels beyond each side balls may touch the grid from."""
    each = zip(frame.spacing, frame.periodic, strict=True)
    return [(0, 0) if wraps else (math.ceil(probe / 2 / h) + 1,) * 2 for h, wraps in each]


def flooded(frame: Frame, probe: float) -> int:
    """Return how many voxels a probe's flood is of: the frame's, and those of its margins."""
    each = zip(frame.shape, _margins(frame, probe), strict=True)
    return math.prod(n + a + b for n, (a, b) in each)


def _from_outside(fits: Bools, grid: VoxelGrid, margins: list[tuple[int, int]]) -> Bools:
    """Return the voxels of a mask that are joined with the outside, of the grid with margins."""
    from porous.kernels.components import label

    labels, count = label(fits, 26, periodic=grid.frame.periodic)
    found: Bools = np.zeros(count + 1, np.bool_)
    for axis, (margin, _) in enumerate(margins):
        if margin:
            found[np.unique(labels.take((0, -1), axis=axis))] = True
    if grid.bulk is not None:
        found[np.unique(labels[np.pad(grid.bulk < 128, margins)])] = True
    found[0] = False
    return np.asarray(found[labels])
