"""Whether a body can be printed and cleaned: walls, overhangs, islands, what stays in it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError, MemoryLimitError, ModelError
from porous.measures._build import Direction, angle_of, directions_of, row
from porous.measures._drain_path import grid_drain
from porous.measures._islands import grid_islands
from porous.measures._overhangs import (
    METHOD,
    ROUNDING,
    Inclined,
    grid_overhangs,
    surface_inclined,
    surface_overhangs,
)
from porous.measures._sample import Family, Findings, Sample
from porous.measures._thickness import METHOD as THICKNESS
from porous.measures._thickness import local_thickness
from porous.measures._trapped import flooded, grid_cupped, grid_trapped, has_outside
from porous.models.automaton import count_cells
from porous.models.model import HasBoundary
from porous.values import Curve, Measure, Measures

if TYPE_CHECKING:
    from collections.abc import Iterator

    from porous.measures._thickness import LocalThickness
    from porous.values import VoxelGrid

ENDLESS = (
    "periodic along x, y and z: a body without end stands on no plate, so nothing is told of "
    "overhangs, islands and cups"
)
"""What is noted where no direction is left to build in."""

MOST = 256**3
"""Voxels that are looked at, at most; of larger grids coarser ones are."""

MOST_WAYS = 192**3
"""The same for the ways out of pores, which take longest."""

EXACT = "exact boundary"
"""How overhangs of a model are called that come of no voxels; they answer for it."""

CELLS = 10_000
"""Cells of a model whose exact boundary is made, at most: it takes seconds."""

RANKED = ("unsupported_volume", "overhang_area", "cupped_volume")
"""What tells the best direction, the first of them first."""

SHARES = {
    "solid": ("thin_wall_share", "walls thinner", "solid"),
    "pore": ("narrow_gap_share", "gaps narrower", "pores"),
}


def thin_wall_share(grid: VoxelGrid, *, width: float) -> Measure:
    """Return the part of the solid's volume in walls that are thinner than a width, unit 1.

    By local thickness: of each place the diameter of the largest ball of solid over it. The
    uncertainty is what a diameter's doubt of a voxel more or less makes of it.

    Raises
    ------
    GridError
        Where one of the phases is missing, or the width is no length.
    """
    return _share(local_thickness(grid, phase="solid"), width)


def narrow_gap_share(grid: VoxelGrid, *, width: float) -> Measure:
    """Return the part of the pores' volume that is narrower than a width, unit 1.

    As ``thin_wall_share`` of the solid.
    """
    return _share(local_thickness(grid, phase="pore"), width)


def _share(local: LocalThickness, width: float) -> Measure:
    if not (math.isfinite(width) and width > 0):
        raise GridError(f"width: got {width}; wanted a length above 0")
    # Diameters that are roots of whole numbers may be off in the last digit.
    less, value, more = (
        float(local.shares[local.sizes < (width + a) * (1 - 1e-9)].sum())
        for a in (-local.doubt, 0.0, local.doubt)
    )
    doubt = max(value - less, more - value)
    return row(SHARES[local.phase][0], value, "1", THICKNESS, doubt)


def _take(sample: Sample) -> Findings:
    found = _thin(sample)
    within = sample.within(MOST)
    if not sample.has("solid"):
        return found
    angle_of(sample.how.overhang)
    directions = directions_of(within.frame)
    if not directions:
        found += Findings(notes=(ENDLESS,))
    overhang, inclined = grid_overhangs(within)
    hanging, curves = grid_islands(within, directions)
    exact, by_angle = _exact(sample) or (Measures(), _by_angle(inclined, within, METHOD))
    rows, curves = overhang + hanging + exact, (*by_angle, *curves)
    left: tuple[str, ...] = ()
    if sample.has("pore") and has_outside(within):
        trapped, left = _left(within)
        ways, lengths = grid_drain(sample.within(MOST_WAYS))
        rows += grid_cupped(within, directions) + trapped + ways
        curves += lengths
    notes = (*_coarser(sample, within), *left, *_best(rows, directions))
    return found + Findings(rows, curves, notes)


def _thin(sample: Sample) -> Findings:
    """Compare walls and gaps with what the machine can make, where it is known."""
    found, unit = Findings(), sample.frame.unit
    limits = {"solid": sample.how.smallest_wall, "pore": sample.how.smallest_gap}
    for phase, limit in limits.items():
        if limit is None or not sample.has_both:
            continue
        local = sample.thickness(phase)
        share, (_, words, whole) = _share(local, limit), SHARES[phase]
        least = "" if math.isnan(local.smallest) else f"; the least is {local.smallest:.3g} {unit}"
        verdict = f"{words} than {limit:g} {unit} make up {100 * share.value:.3g} % of the {whole}"
        found += Findings(Measures((share,)), (), (verdict + least,))
    return found


def _left(sample: Sample) -> tuple[Measures, tuple[str, ...]]:
    """Return what is trapped, or why that is not told."""
    try:
        return _trapped(sample), ()
    except MemoryLimitError as error:
        probe = f"{sample.how.probe:g} {sample.frame.unit}"
        return Measures(), (f"what a probe of {probe} leaves is not told: {error}",)


def _trapped(sample: Sample) -> Measures:
    """Return what is trapped, of coarser voxels where a wide probe needs wide margins.

    A probe that is wider than the grid is in no doubt about it, and gives no row.
    """
    probe = sample.how.probe
    if probe is not None:
        if probe > max(sample.frame.box.lengths):
            return Measures()
        if sample.coarse is not None and flooded(sample.frame, probe) > 2 * MOST:
            return _trapped(sample.coarse)
    return Measures((grid_trapped(sample),))


def _exact(sample: Sample) -> tuple[Measures, tuple[Curve, ...]] | None:
    """Return the overhangs of the model's own boundary, where there is one and it is soon made."""
    model = sample.model
    if not isinstance(model, HasBoundary) or any(sample.frame.periodic):
        return None
    level, automaton = (getattr(model, name, None) for name in ("level", "automaton"))
    if isinstance(level, int) and automaton is not None and count_cells(automaton, level) > CELLS:
        return None
    try:
        surface = model.boundary()
    except ModelError:
        return None
    angle = sample.how.overhang
    rows = surface_overhangs(surface, angle, EXACT, "model")
    return rows, tuple(_by_angle(surface_inclined(surface, angle), sample, EXACT))


def _by_angle(inclined: Inclined, sample: Sample, method: str) -> Iterator[Curve]:
    """Yield the area that hangs over at less than each angle, for each direction."""
    unit = f"{sample.frame.unit}²"
    angles = np.arange(91.0)
    for direction in directions_of(sample.frame) if inclined.total else ():
        yield Curve(
            "overhang_by_angle",
            f"built along {direction.words}",
            angles,
            np.array([inclined.below(direction, angle) for angle in angles]),
            "angle to the plate",
            "°",
            "area below it",
            unit,
            method,
        )


def _coarser(sample: Sample, within: Sample) -> Iterator[str]:
    """Say what is measured of coarser voxels."""
    ways = sample.within(MOST_WAYS)
    if within is not sample:
        yield f"overhangs, islands and what stays in the pores are {_voxels(within)}"
    if ways is not sample:
        yield f"ways out of the pores are {_voxels(ways)}"


def _voxels(sample: Sample) -> str:
    return f"those of a coarser grid, {' × '.join(map(str, sample.frame.shape))} voxels"


def _best(rows: Measures, directions: tuple[Direction, ...]) -> Iterator[str]:
    """Say which direction is the best to build in, and by what.

    Of those left the least is looked for, quantity by quantity, by the method that answers for it;
    what is no farther from the least than either's uncertainty counts as equal to it.
    """
    left = list(directions)
    for name in RANKED:
        there = {d: rows[f"{name}_{d.name}"] for d in left if f"{name}_{d.name}" in rows}
        if there:
            least = min(there.values(), key=lambda r: r.value)
            left = [d for d, r in there.items() if _no_more(r, least)]
    if not left:
        return
    rule = "the least unsupported volume, then overhang area, then cupped volume"
    if len(left) == len(directions):
        yield f"no direction to build in is better than another by {rule}, as far as they are known"
    elif len(left) == 1:
        told = "; ".join(
            f"{name.replace('_', ' ')} {rows[key].value:.4g} {rows[key].unit}"
            for name in RANKED
            if (key := f"{name}_{left[0].name}") in rows
        )
        yield (
            f"best built along {left[0].words}, of {len(directions)} directions, by {rule} ({told})"
        )
    else:
        worse = _words([d for d in directions if d not in left])
        yield (
            f"built worse along {worse} by {rule}; which of {_words(left)} is best is not "
            "told apart"
        )


def _words(directions: list[Direction]) -> str:
    *most, last = [d.words for d in directions]
    return f"{', '.join(most)} and {last}" if most else last


def _no_more(one: Measure, least: Measure) -> bool:
    doubt = max(one.uncertainty, least.uncertainty, ROUNDING * abs(least.value))
    return one is least or (math.isfinite(doubt) and one.value - least.value <= doubt)


FAMILY = Family("printability", "Printing and cleaning", 90, _take)
