"""Sizes of pores and walls: what local thickness comes to, and how it is distributed."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.measures._material import octants
from porous.measures._phase import PREFIX
from porous.measures._sample import Family, Findings
from porous.measures._thickness import METHOD, thicknesses
from porous.values import Curve, Measure, Measures

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.measures._sample import Sample
    from porous.measures._thickness import LocalThickness

    Floats = NDArray[np.float64]

BINS = 40
"""Bins of a distribution at most; none is narrower than a voxel is long."""

POINTS = 400
"""Points of a cumulative curve at most."""

WORDS = {"pore": "pores", "solid": "walls"}
"""What a phase's sizes are of, for plots."""


def sizes(local: LocalThickness, coarse: LocalThickness | None = None) -> Measures:
    """Return the sizes of a phase: what ``thicknesses`` tells, and how they spread.

    Parameters
    ----------
    local
        The local thickness of a phase.
    coarse
        The same of voxels twice as long, for uncertainties.

    Returns
    -------
    Measures
        Rows of ``thicknesses``, and pore_thickness_p10, _p90 and _deviation (of solid
        wall_thickness_…): diameters that 10 % and 90 % of the phase's volume do not exceed, and
        their standard deviation by volume. Uncertainties are the doubt of one diameter and,
        combined with it, the difference to the coarse voxels where these are given; infinite where
        there is no such size on them.
    """
    rows = tuple(_rows(local))
    if coarse is None:
        return Measures(rows)
    there = {row.name: row.value for row in _rows(coarse)}
    return Measures(tuple(_against(row, there.get(row.name, math.inf)) for row in rows))


def _rows(local: LocalThickness) -> Iterator[Measure]:
    yield from thicknesses(local)
    name, middle = f"{PREFIX[local.phase]}_thickness", float(local.sizes @ local.shares)
    values = {
        "p10": local.quantile(0.1),
        "p90": local.quantile(0.9),
        "deviation": math.sqrt(float((local.sizes - middle) ** 2 @ local.shares)),
    }
    unit = local.frame.unit
    for part, value in values.items():
        yield Measure(f"{name}_{part}", value, unit, METHOD, local.doubt, "standard", "grid")


def _against(row: Measure, coarse: float) -> Measure:
    return replace(row, uncertainty=math.hypot(row.uncertainty, row.value - coarse))


def size_curves(local: LocalThickness) -> tuple[Curve, Curve]:
    """Return the distribution of a phase's sizes, by volume.

    Returns
    -------
    Curve
        pore_size_distribution, or wall_thickness_distribution of solid: the part of the phase's
        volume per length of diameter, in bins of a voxel or more, whose edges lie half way between
        whole numbers of voxels.
    Curve
        pore_size_cumulative, or wall_thickness_cumulative: the part of the volume up to a diameter,
        with what it would be were all diameters off by their doubt.
    """
    return _density(local), _cumulative(local)


def _curve(local: LocalThickness, kind: str, x: Floats, y: Floats, **how: object) -> Curve:
    name = {"pore": "pore_size", "solid": "wall_thickness"}[local.phase]
    unit = local.frame.unit
    y_name, y_unit = (
        ("part of the volume", "1")
        if kind == "cumulative"
        else ("part of the volume per length", f"1/{unit}")
    )
    return Curve(
        f"{name}_{kind}",
        WORDS[local.phase],
        x,
        y,
        "diameter",
        unit,
        y_name,
        y_unit,
        METHOD,
        drawn="steps",
        **how,  # type: ignore[arg-type]
    )


def _density(local: LocalThickness) -> Curve:
    width = max(*local.frame.spacing, float(local.sizes[-1]) / BINS)
    place = np.floor(local.sizes / width + 0.5).astype(np.int64)
    density = np.asarray(np.bincount(place, local.shares) / width, np.float64)
    left = width * (np.arange(len(density) + 1, dtype=np.float64) - 0.5)
    first = int(place[0])
    return _curve(local, "distribution", left[first:], np.append(density[first:], 0.0))


def _cumulative(local: LocalThickness) -> Curve:
    upto = np.cumsum(local.shares)
    upto /= upto[-1]
    kept = np.unique(np.searchsorted(upto, np.arange(1, POINTS + 1) / POINTS * (1 - 1e-12)))
    x = np.append(0.0, local.sizes[kept])

    def share(at: Floats) -> Floats:
        return np.append(0.0, upto)[np.searchsorted(local.sizes, at, side="right")]

    low, high = share(x - local.doubt), share(x + local.doubt)
    return _curve(local, "cumulative", x, share(x), low=low, high=high)


def take(sample: Sample) -> Findings:
    """Return the sizes of pores and of walls, and their distributions."""
    found = Findings()
    for phase in ("pore", "solid"):
        local = _thickness(sample, phase)
        if local is not None:
            coarse = None if sample.coarse is None else _thickness(sample.coarse, phase)
            rows = sizes(local, coarse)
            if sample.coarse is not None and coarse is None:
                rows = Measures(tuple(_against(row, math.inf) for row in rows))
            if sample.how.beyond == "unknown" and sample.grid.bulk is None:
                mean = rows[f"{PREFIX[phase]}_thickness_mean"]
                rows += Measures((octants(local, mean),))
            found += Findings(rows, size_curves(local))
    return found


def _thickness(sample: Sample, phase: str) -> LocalThickness | None:
    try:
        return sample.thickness(phase)
    except GridError:  # the phase is missing, or ends nowhere
        return None


FAMILY = Family("sizes", "Pore and wall sizes", 20, take)
