"""Numbers for people: no more digits than are known."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from porous.values.measure import ONE_SIDED

if TYPE_CHECKING:
    from porous.values import Measure

COVERAGE = 2.0
"""Standard uncertainties of a half-width: about 95 %."""

FIGURES = 7
"""Of a number that is exact."""

LOOSE = 4
"""Figures of a number of which nobody knows how far off it is."""

MICRO = re.compile(r"(?<![a-z])um(?![a-z])")

NOISE = 1e-9
"""Below it a pure number, and how far off it may be, are put down to floating-point numbers."""


def half_width(measure: Measure) -> float:
    """Return how far a measure may be off: its bound, or twice its standard uncertainty."""
    factor = COVERAGE if measure.kind == "standard" else 1.0
    return factor * measure.uncertainty


def number(value: float) -> str:
    """Return a number for people: whole numbers whole, others to seven figures."""
    if math.isnan(value):
        return "not defined"
    if math.isinf(value):
        return "infinite" if value > 0 else "−infinite"
    if 10 ** (FIGURES - 1) <= abs(value) < 1e12 and value != int(value):
        value = float(f"{value:.{FIGURES}g}")
    if value == int(value) and abs(value) < 1e12:
        return f"{int(value):,}".replace(",", "\N{NARROW NO-BREAK SPACE}").replace("-", "−")
    return f"{value:.{FIGURES}g}".replace("-", "−")


def value_text(measure: Measure) -> str:
    """Return the value of a measure to two figures of how far off it may be."""
    if measure.kind == "exact" or measure.method in ONE_SIDED:
        return number(measure.value)
    return rounded(_quiet(measure), half_width(measure))


def half_text(measure: Measure) -> str:
    """Return how far off a measure may be, for people: a bound, or 95 % of a normal law."""
    if measure.kind == "exact" or measure.method in ONE_SIDED:
        return measure.spread
    if is_noise(measure):
        return "exact as shown"
    return width_text(measure.value, half_width(measure))


def is_noise(measure: Measure, size: float = 0.0) -> bool:
    """Tell whether how far off a measure may be is put down to floating-point numbers.

    Parameters
    ----------
    measure
        A pure number is held against one at least.
    size
        What others are held against at least, in their unit.
    """
    usual = 1.0 if measure.unit == "1" else size
    half = half_width(measure)
    return math.isfinite(half) and half <= NOISE * max(abs(measure.value), usual)


def rounded(value: float, half: float) -> str:
    """Return a number to two figures of a half-width; where that is not known, to a few."""
    if not math.isfinite(value):
        return number(value)
    if not math.isfinite(half):
        return number(float(f"{value:.{LOOSE}g}"))
    if _is_below(value, half):
        return number(value)
    return number(round(value, 1 - math.floor(math.log10(half))) + 0.0)


def width_text(value: float, half: float) -> str:
    """Return a half-width to two figures; one that no figure of the value tells is not shown."""
    if not math.isfinite(half):
        return "not known"
    if _is_below(value, half):
        return "exact as shown"
    return f"± {number(float(f'{half:.2g}'))}"


def unit_of(measure: Measure) -> str:
    """Return what stands after a value: nothing for pure numbers."""
    return "" if measure.unit == "1" else unit_text(measure.unit)


def unit_text(unit: str) -> str:
    """Return a unit as people write it."""
    return MICRO.sub("µm", unit)


def _is_below(value: float, half: float) -> bool:
    return half <= 0.5 * 10.0**-FIGURES * abs(value)


def _quiet(measure: Measure) -> float:
    """Return a value, nought for one that is put down to floating-point numbers."""
    half = half_width(measure)
    tiny = abs(measure.value) <= NOISE and (half <= NOISE or not math.isfinite(half))
    quiet = measure.unit == "1" and tiny
    return 0.0 if quiet else measure.value
