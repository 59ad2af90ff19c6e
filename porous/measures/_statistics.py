"""Statistics of a body: lines and pairs of points in it, its fabric, and how it changes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.measures._chords import chord_lengths, chords, pore_chord_mean, wall_chord_mean
from porous.measures._correlation import correlation_length, two_point
from porous.measures._intercept import LEAST, fabric, intercepts
from porous.measures._intercept import METHOD as LINES
from porous.measures._material import material
from porous.measures._phase import PREFIX
from porous.measures._porosity import Amounts
from porous.measures._profiles import porosity_profiles, representative_volumes
from porous.measures._sample import Family, Findings
from porous.values import Curve, Measure, Measures

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from porous.measures._chords import ChordLengths, Chords
    from porous.measures._correlation import TwoPoint
    from porous.measures._intercept import Intercepts
    from porous.measures._sample import Sample

    Floats = NDArray[np.float64]

NAME = "statistics"

MOST = 256**3
"""Voxels on which pairs of points and boxes are looked at."""

PART = 3.0
"""Pairs of points are as far apart as the shortest edge over this, at most."""

BINS = 40
"""Bins of a distribution of chords at most."""


def chord_curves(lengths: ChordLengths) -> tuple[Curve, ...]:
    """Return how chords are distributed by length, and the lineal path, along each axis.

    Parameters
    ----------
    lengths
        What ``chord_lengths`` found.

    Returns
    -------
    tuple of Curve
        pore_chord_distribution (of solid wall_chord_distribution): the part of chords that no side
        cuts, by number, per length; and pore_lineal_path (wall_lineal_path): how likely a segment
        of that length lies in the phase. Along axes that have none there is no curve.
    """
    return tuple(_chord_curves(lengths))


def _chord_curves(lengths: ChordLengths) -> Iterator[Curve]:
    prefix, unit = PREFIX[lengths.phase], lengths.unit
    for letter, found in zip("xyz", lengths.axes, strict=True):
        series = f"along {letter}"
        if found.whole.any():
            words = ("chord length", unit, "part of the chords per length", f"1/{unit}")
            x, y = _binned(found)
            name = f"{prefix}_chord_distribution"
            yield Curve(name, series, x, y, *words, "voxel chords", drawn="steps")
        path = found.lineal_path
        if len(path.distances):
            words = ("length of a segment", unit, "part of segments that fit", "1")
            name = f"{prefix}_lineal_path"
            yield Curve(name, series, *_upto_nothing(*path), *words, "voxel chords")


def _binned(found: Chords) -> tuple[Floats, Floats]:
    """Return lower ends of bins, and the last upper one, and the density of chords in each."""
    longest = int(np.flatnonzero(found.whole)[-1])
    width = -(-longest // BINS)
    counts = np.zeros(-(-longest // width) * width)
    counts[:longest] = found.whole[1 : longest + 1]
    density = counts.reshape(-1, width).sum(axis=1) / counts.sum() / width / found.spacing
    left = (width * np.arange(len(density) + 1) + 0.5) * found.spacing
    return np.asarray(left, np.float64), np.append(density, 0.0)


def _upto_nothing(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return a curve up to the first place where nothing is left of it."""
    past = np.flatnonzero(y <= 0)
    stop = int(past[0]) + 1 if len(past) else len(y)
    return x[:stop], y[:stop]


def take(sample: Sample) -> Findings:
    """Return chords, correlation, fabric, profiles, and how boxes of all sizes differ."""
    found = _chords(sample)
    sample.tell(NAME, 0.25)
    lines, told = _intercepts(sample), Measures()
    if lines is not None:
        told = fabric(lines) + _means(sample, lines)
        found += Findings(told, _roses(lines))
    sample.tell(NAME, 0.5)
    found += _pairs(sample, lines, told)
    sample.tell(NAME, 0.75)
    curves = porosity_profiles(sample)
    if sample.has_both:
        curves += representative_volumes(sample.within(MOST))
    return found + Findings(curves=curves)


def _chords(sample: Sample) -> Findings:
    found = Findings()
    for phase in PREFIX:
        if sample.has(phase):
            lengths = chord_lengths(sample.grid, phase=phase, beyond=sample.how.beyond)
            found += Findings(chords(lengths), chord_curves(lengths))
    census, beyond = sample.census, sample.how.beyond
    rows = [
        *_if_there(lambda: pore_chord_mean(census)),
        *_if_there(lambda: wall_chord_mean(census, beyond=beyond)),
    ]
    return found + Findings(Measures(tuple(rows)))


def _if_there(take: Callable[[], Measure]) -> tuple[Measure, ...]:
    try:
        return (take(),)
    except GridError:  # no such phase, no surface, or a bulk that is no box
        return ()


def _intercepts(sample: Sample) -> Intercepts | None:
    if not sample.has_both or min(sample.frame.shape) < LEAST:
        return None
    try:
        return intercepts(
            sample.grid, progress=lambda done, count: sample.tell(NAME, 0.25 + 0.25 * done / count)
        )
    except GridError:  # a bulk within one phase
        return None


def _means(sample: Sample, found: Intercepts) -> Measures:
    """Return the area between the phases, and the mean chords of both over all directions.

    The area is twice the crossings by the length of lines, chords twice their part by crossings:
    not those of solid that ends at sides, where no line goes, and nothing in a bulk that is no box.
    """
    if sample.grid.bulk is not None:
        return Measures()
    amounts = Amounts(sample.census)
    crossings, doubt = found.mean
    volume = sample.frame.box.volume
    area, unsure, unit = 2 * crossings * volume, 2 * doubt * volume, f"{found.unit}²"
    rows = [Measure("interface_area", area, unit, LINES, unsure, "standard", "grid")]
    solid = amounts.solid / amounts.bulk
    parts = {"pore": 1 - solid}
    if sample.how.beyond == "unknown" or all(sample.frame.periodic):
        parts["solid"] = solid
    for phase, part in parts.items():
        value = 2 * part / crossings
        unsure = amounts.inside_doubt / amounts.bulk
        spread = math.hypot(value * doubt / crossings, 2 * unsure / crossings)
        name = f"{PREFIX[phase]}_chord_mean"
        rows.append(Measure(name, value, found.unit, LINES, spread, "standard", "grid"))
    return Measures(tuple(rows))


def _roses(found: Intercepts) -> tuple[Curve, ...]:
    """Return the mean intercept length by direction in the planes xy, xz and yz."""
    planes = ((0, 1), (0, 2), (1, 2))
    return tuple(curve for plane in planes if (curve := _rose(found, plane)) is not None)


def _rose(found: Intercepts, plane: tuple[int, int]) -> Curve | None:
    """Return those of a plane that are finite, if any."""
    first, second = plane
    inside = np.abs(found.directions[:, 3 - first - second]) < 1e-12
    inside &= found.crossings > 0
    if not inside.any():
        return None
    u, crossings = found.directions[inside], found.crossings[inside]
    angle = np.asarray(np.degrees(np.arctan2(u[:, second], u[:, first])) % 180, np.float64)
    order = np.argsort(angle)
    length = 1 / crossings[order]
    spread = length * found.doubts[inside][order] / crossings[order]
    return Curve(
        "mean_intercept_length",
        f"in the {'xyz'[first]}{'xyz'[second]} plane",
        angle[order],
        length,
        f"angle to {'xyz'[first]}",
        "°",
        "mean intercept length",
        found.unit,
        LINES,
        length - spread,
        length + spread,
        "points",
    )


def _pairs(sample: Sample, lines: Intercepts | None, told: Measures) -> Findings:
    less = sample.within(MOST)
    found = _two_point(less)
    if found is None:
        return Findings()
    row = correlation_length(found, None if less.coarse is None else _two_point(less.coarse))
    notes = () if less is sample else (_noted("Pairs of points and boxes", less),)
    rows = Measures((row,))
    if sample.how.beyond == "unknown" and lines is not None:
        rows += material(sample, lines, told, row.value, MOST)
    surface = None if lines is None else 2 * lines.mean[0]
    return Findings(rows, correlation_curves(found, surface), notes)


def _two_point(sample: Sample) -> TwoPoint | None:
    if not sample.has_both or min(sample.frame.shape) < 2 * PART:
        return None
    found = two_point(sample.grid, longest=min(sample.frame.box.lengths) / PART)
    return found if 0 < found.values[0] < 1 else None  # else the bulk lies within one phase


def _noted(what: str, sample: Sample) -> str:
    size = " × ".join(map(str, sample.frame.shape))
    return f"{what} were looked at on {size} voxels, each the mean of some of the grid's."


def correlation_curves(found: TwoPoint, surface: float | None = None) -> tuple[Curve, ...]:
    """Return the two-point correlation as curves: over all directions, along axes, and its limit.

    Parameters
    ----------
    found
        What ``two_point`` found.
    surface
        Area between the phases by volume, whose quarter is the slope that the curve begins with
        (P. Debye, H. R. Anderson & H. Brumberger, J. Appl. Phys. 28, 1957).

    Returns
    -------
    tuple of Curve
        two_point_correlation: over all directions, along x, y and z, the square of the phase's
        part, which it comes down to where places no longer correlate, and the slope by the surface.
    """
    words = ("distance", found.unit, "probability that both ends are pore", "1")
    method, part, end = "two-point correlation", float(found.values[0]), float(found.distances[-1])

    def curve(series: str, x: Floats, y: Floats, method: str = method) -> Curve:
        return Curve("two_point_correlation", series, x, y, *words, method)

    curves = [curve("all directions", found.distances, found.values)]
    for letter, along, h in zip("xyz", found.axes, found.spacing, strict=True):
        curves.append(
            curve(f"along {letter}", _numbers(*(h * k for k in range(len(along)))), along)
        )
    curves.append(curve("porosity squared", _numbers(0, end), _numbers(part**2, part**2)))
    if surface:
        stop = min(4 * part * (1 - part) / surface, end)
        line = _numbers(part, part - surface / 4 * stop)
        curves.append(curve("slope by the surface", _numbers(0, stop), line, LINES))
    return tuple(curves)


def _numbers(*values: float) -> Floats:
    return np.array(values, np.float64)


FAMILY = Family(NAME, "Statistics of lines, pairs of points and places", 30, take)
