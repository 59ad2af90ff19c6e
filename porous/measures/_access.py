"""What gets in and through: balls from outside, mercury, and how narrow the pores' necks are."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from porous.measures._intrusion import (
    BALLS,
    accessible,
    has_outside,
    intrusion,
    passing,
    percolation_rows,
    ways_of,
)
from porous.measures._sample import Family, Findings
from porous.models.model import HasBulk
from porous.values import Curve, Measure, Measures
from porous.values.units import length_ratio

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from porous.measures._intrusion import MercuryIntrusion
    from porous.measures._sample import Sample
    from porous.measures._thickness import LocalThickness

    Floats = NDArray[np.float64]
    Three = tuple[float, float, float]

MOST = 256**3
"""Voxels of a survey at most."""

MOST_SWEPT = 256**3
"""The same for what a probe sweeps."""

TENSION, ANGLE = 0.480, 140.0
"""Of mercury: surface tension in N/m and contact angle in degrees."""

POINTS = 128
"""Diameters that a curve tells, at most, but for its ends."""

WASHBURN = (
    f"p = 4 γ |cos θ|/d (E. W. Washburn 1921), γ = {TENSION:.3f} N/m and θ = {ANGLE:.0f}° of "
    "mercury; from all sides that are not periodic"
)
SWEPT = "part of the pores that balls from outside sweep, of this diameter and larger"
NOWHERE = (
    "The body is periodic along all axes: nothing comes to its pores from outside, so that "
    "accessible porosity and mercury intrusion are not told."
)


@dataclass(frozen=True)
class _Seen:
    """What one resolution tells: diameters that pass (0 for none), and what comes from outside.

    Each of ``numbers`` stands with what a voxel more or less of all diameters makes of it.
    """

    passing: Three
    mercury: MercuryIntrusion | None = None
    pores: LocalThickness | None = None
    numbers: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def take(sample: Sample) -> Findings:
    """Return what gets into the pores of a sample and through them.

    Parameters
    ----------
    sample
        The body; of one with more than 256³ voxels a coarser one is looked at.

    Returns
    -------
    Findings
        percolation_diameter_x, _y and _z; accessible_porosity of the probe that is asked for;
        intrusion_threshold_diameter, intrusion_p50, intrusion_trapped_share,
        intrusion_unreached_share and constrictivity. Curves of accessible porosity and of mercury
        intrusion. Uncertainties hold the difference to voxels twice as large.
    """
    seen = sample.within(MOST)
    if not seen.has_both:
        return Findings()
    fine, coarse = _seen(seen), None
    if seen.coarse is not None and seen.coarse.has_both:
        coarse = _seen(seen.coarse)
    through = percolation_rows(seen, fine.passing, None if coarse is None else coarse.passing)
    rows, notes = list(through), []
    curves: tuple[Curve, ...] = ()
    if fine.mercury is None:
        notes.append(NOWHERE)
    else:
        swept = seen.within(MOST_SWEPT)
        if seen.how.probe is not None and swept.has_both:
            rows.append(accessible(swept, seen.how.probe))
        rows += _intrusion_rows(seen, fine, coarse, through)
        curves = tuple(_curves(seen, fine, coarse))
    if seen is not sample:
        notes.append(
            "What gets in and through was looked at with voxels of "
            f"{max(seen.frame.spacing):.4g} {seen.frame.unit}."
        )
    return Findings(Measures(tuple(rows)), curves, tuple(notes))


def _seen(sample: Sample) -> _Seen:
    ways = ways_of(sample)
    through = (0.0, 0.0, 0.0) if _is_bent(sample) else passing(sample, ways)
    if not has_outside(sample):
        return _Seen(through)
    mercury, pores = intrusion(sample, ways), sample.thickness("pore")
    return _Seen(through, mercury, pores, _numbers(sample, mercury, pores))


def _numbers(
    sample: Sample, mercury: MercuryIntrusion, pores: LocalThickness
) -> dict[str, tuple[float, float]]:
    numbers = {"intrusion_unreached_share": (1 - mercury.reached, 0.0)}
    if mercury.reached:
        (more, trapped, less), wide = _behind_necks(sample, mercury, pores)
        narrow, doubt = mercury.quantile(0.5), mercury.doubt
        beta = min(narrow / wide, 1.0) ** 2
        numbers["intrusion_p50"] = narrow, doubt
        numbers["intrusion_trapped_share"] = trapped, max(more - trapped, trapped - less)
        numbers["constrictivity"] = beta, 2 * beta * math.hypot(doubt / narrow, doubt / wide)
    return numbers


def _is_bent(sample: Sample) -> bool:
    """Tell whether the bulk is a model's own: it ends in no layer of voxels."""
    return sample.grid.bulk is not None and isinstance(sample.model, HasBulk)


def _behind_necks(
    sample: Sample, mercury: MercuryIntrusion, pores: LocalThickness
) -> tuple[Three, float]:
    """Return how much of what is reached is so by balls a voxel smaller than there is room for.

    Before it and after it what that is where necks are by the doubt of a diameter narrower, and
    wider. And the median of the room there is, in what is reached.
    """
    step, bulk = max(sample.frame.spacing), sample.grid.bulk
    steps = [1e-6 * step + max(0.0, step + a) for a in (-mercury.doubt, 0.0, mercury.doubt)]
    behind, rooms = np.zeros(3, np.int64), []
    for i in range(len(mercury.diameters)):
        narrow, wide = mercury.diameters[i], pores.diameters[i]
        reached = narrow > 0 if bulk is None else (narrow > 0) & (bulk[i] >= 128)
        room = wide[reached]
        gaps = room - narrow[reached]
        behind += [np.count_nonzero(gaps > least) for least in steps]
        rooms.append(np.unique(room, return_counts=True))
    sizes, numbers = (np.concatenate([told[end] for told in rooms]) for end in (0, 1))
    if not len(sizes):
        return (0.0, 0.0, 0.0), math.nan
    order = np.argsort(sizes, kind="stable")
    counts = np.cumsum(numbers[order])
    middle = int(np.searchsorted(counts, 0.5 * counts[-1] * (1 - 1e-12)))
    median = pores.sizes[np.abs(pores.sizes - sizes[order][middle]).argmin()]
    more, here, less = behind / int(counts[-1])
    return (float(more), float(here), float(less)), float(median)


def _intrusion_rows(
    sample: Sample, fine: _Seen, coarse: _Seen | None, through: tuple[Measure, ...]
) -> Iterator[Measure]:
    wraps = sample.frame.periodic
    sides = [0.0 if wrap else d for d, wrap in zip(fine.passing, wraps, strict=True)]
    if max(sides):
        name = f"percolation_diameter_{'xyz'[sides.index(max(sides))]}"
        (row,) = (row for row in through if row.name == name)
        yield replace(row, name="intrusion_threshold_diameter")
    for name, (value, lattice) in fine.numbers.items():
        other = math.inf
        if coarse is not None and name in coarse.numbers:
            other = coarse.numbers[name][0] - value
        unit = sample.frame.unit if name == "intrusion_p50" else "1"
        yield Measure(name, value, unit, BALLS, math.hypot(lattice, other), "standard", "grid")


def _curves(sample: Sample, fine: _Seen, coarse: _Seen | None) -> Iterator[Curve]:
    mercury, pores, unit = fine.mercury, fine.pores, sample.frame.unit
    assert mercury is not None
    assert pores is not None
    other = None if coarse is None else coarse.mercury
    sizes = _chosen(mercury.sizes)
    if len(sizes):
        share = _at_least(sizes, mercury)
        before = None if other is None else _at_least(sizes, other)
        filled = _Line("intruded from outside", sizes, share, before)
        yield filled.curve("mercury_intrusion", "diameter", unit, "intruded pores", WASHBURN)
        pressures = _Line(filled.series, _pressures(sizes, unit), share, before)
        yield pressures.curve(
            "mercury_intrusion_pressure", "pressure", "MPa", "intruded pores", WASHBURN
        )
    for series, found, again in (
        ("from outside", mercury, other),
        ("from anywhere", pores, None if coarse is None else coarse.pores),
    ):
        sizes = _chosen(found.sizes)
        if len(sizes):
            share = mercury.porosity * _at_least(sizes, found)
            before = None
            if again is not None and other is not None:
                before = other.porosity * _at_least(sizes, again)
            line = _Line(series, sizes, share, before)
            name = "accessible_porosity"
            yield line.curve(name, "probe's diameter", unit, "accessible porosity", SWEPT)


@dataclass(frozen=True)
class _Line:
    """Shares over diameters or pressures, and what they are at half the resolution."""

    series: str
    x: Floats
    y: Floats
    coarse: Floats | None

    def curve(self, name: str, x_name: str, x_unit: str, y_name: str, method: str) -> Curve:
        order = np.argsort(self.x)
        x, y = self.x[order], self.y[order]
        low = high = None
        if self.coarse is not None:
            off = np.abs(y - self.coarse[order])
            low, high = np.clip(y - off, 0, 1), np.clip(y + off, 0, 1)
        return Curve(
            name, self.series, x, y, x_name, x_unit, y_name, "1", method, low, high, log="x"
        )


def _chosen(sizes: Floats) -> Floats:
    """Return the diameters that a curve tells, evenly on a logarithmic axis, of those there are."""
    if len(sizes) <= POINTS:
        return sizes
    wanted = np.geomspace(sizes[0], sizes[-1], POINTS)
    places = np.searchsorted(sizes, wanted * (1 - 1e-9)).clip(0, len(sizes) - 1)
    return np.asarray(sizes[np.unique(places)])


def _at_least(diameters: Floats, found: MercuryIntrusion | LocalThickness) -> Floats:
    """Return the part of the pores' volume with each of these diameters or a larger one."""
    beyond = np.append(np.cumsum(found.shares[::-1])[::-1], 0.0)
    places = np.searchsorted(found.sizes, diameters * (1 - 1e-9))
    return np.asarray(np.minimum(beyond[places], 1.0))


def _pressures(diameters: Floats, unit: str) -> Floats:
    """Return the pressures, in MPa, that press mercury into pores of these diameters."""
    strength = 4 * TENSION * abs(math.cos(math.radians(ANGLE)))
    return np.asarray(1e-6 * strength / (diameters * length_ratio(unit, "m")))


FAMILY = Family("access", "What gets in and through", 40, take)
