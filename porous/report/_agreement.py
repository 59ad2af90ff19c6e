"""Measures side by side: which rows tell the same thing, and which contradict each other."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from porous.values.measure import ONE_SIDED

if TYPE_CHECKING:
    from porous.certificate import Certificate, Check
    from porous.values import Measure, Measures

ROUNDING = 1e-9
"""Relative difference that is put down to floating-point numbers."""

COVERAGE = 2.0
"""Standard uncertainties of a half-width: about 95 %."""

ROOM = 1.5
"""Half-widths within which two numbers are said to agree: three standard uncertainties. A report
compares dozens of numbers that are right, and at one half-width every twentieth would not agree."""


@dataclass(frozen=True)
class Row:
    """One line of the table of measures, as text; ``half`` is its half-width at 95 %."""

    name: str
    method: str
    of: str
    value: str
    exactly: str
    unit: str
    half: str
    half_exactly: str
    kind: str
    mark: str
    agrees: bool
    best: bool


@dataclass(frozen=True)
class Group:
    """What is known of one measure; the first row is the one that answers for it."""

    name: str
    rows: tuple[Row, ...]


def groups(measures: Measures) -> tuple[Group, ...]:
    """Return the measures by name, the best row first, each held against it."""
    return tuple(_group(measures, name) for name in measures.names)


def conflicts(measures: Measures) -> tuple[tuple[Measure, Measure], ...]:
    """Return the pairs of best row and other row that differ by more than they admit."""
    return tuple(
        (measures[name], row)
        for name in measures.names
        for row in measures.all(name)
        if not agree(measures[name], row)
    )


def agree(a: Measure, b: Measure) -> bool:
    """Tell whether two measures of one quantity are equal within what both admit."""
    if math.isnan(a.value) or math.isnan(b.value) or a.value == b.value:
        return True
    allowed = _room(a) + _room(b) + ROUNDING * max(abs(a.value), abs(b.value))
    gap = abs(a.value - b.value)
    return math.isfinite(gap) and gap <= allowed


def _room(measure: Measure) -> float:
    return half_width(measure) * (ROOM if measure.kind == "standard" else 1.0)


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
    if value == int(value) and abs(value) < 1e12:
        return f"{int(value):,}".replace(",", "\N{NARROW NO-BREAK SPACE}").replace("-", "−")
    return f"{value:.7g}".replace("-", "−")


def _group(measures: Measures, name: str) -> Group:
    best = measures[name]
    others = [row for row in measures.all(name) if row is not best]
    return Group(name, (_row(best, None), *(_row(row, best) for row in others)))


def _row(measure: Measure, best: Measure | None) -> Row:
    fine = best is None or agree(best, measure)
    mark = "" if best is None else compared(best, measure)
    return Row(
        name=measure.name,
        method=measure.method,
        of=measure.of,
        value=number(measure.value),
        exactly=repr(measure.value),
        unit=unit_of(measure),
        half=half_text(measure),
        half_exactly=repr(half_width(measure)),
        kind=measure.kind,
        mark=mark,
        agrees=fine,
        best=best is None,
    )


def unit_of(measure: Measure) -> str:
    """Return what stands after a value: nothing for pure numbers."""
    return "" if measure.unit == "1" else measure.unit


def half_text(measure: Measure) -> str:
    """Return how far off a measure may be, for people: a bound, or 95 % of a normal law."""
    if measure.kind == "exact" or measure.method in ONE_SIDED:
        return measure.spread
    half = half_width(measure)
    return f"± {half:.2g}" if math.isfinite(half) else "not known"


def compared(best: Measure, other: Measure) -> str:
    """Say whether a measure agrees with another that is held for better, and else by how much."""
    return "agrees" if agree(best, other) else f"differs by {_gap(best, other)}"


def _gap(best: Measure, other: Measure) -> str:
    gap = other.value - best.value
    sign = "+" if gap > 0 else "−"
    if best.value and math.isfinite(best.value) and math.isfinite(gap):
        return f"{sign}{abs(gap / best.value):.2%}"
    return f"{sign}{number(abs(gap))}"


@dataclass(frozen=True)
class Line:
    """One line of the certificate, as text; ``values`` are of model, grid, surface and volume."""

    quantity: str
    values: tuple[str, ...]
    tolerance: str
    verdict: str
    remedy: str
    good: bool


@dataclass(frozen=True)
class Verdict:
    """What the certificate comes to, in one sentence, and how it is to look: good, bad, open."""

    text: str
    tone: str


def lines(certificate: Certificate | None) -> tuple[Line, ...]:
    """Return the certificate for its table."""
    return tuple(map(_line, certificate.rows)) if certificate else ()


def verdict(certificate: Certificate | None) -> Verdict:
    """Return what the certificate comes to."""
    rows = certificate.rows if certificate else ()
    named = {
        word: [row.quantity.replace("_", " ") for row in rows if row.verdict == word]
        for word in ("agree", "differ", "unknown")
    }
    if named["differ"]:
        text = f"Model, voxels, surface and mesh differ in {', '.join(named['differ'])}"
        return Verdict(f"{text}: the certificate says what would mend it.", "bad")
    if not named["agree"]:
        return Verdict("Not certified: there was nothing to compare with.", "open")
    text = f"Model, voxels, surface and mesh agree in {', '.join(named['agree'])}"
    open_ones = f"; not decided: {', '.join(named['unknown'])}" if named["unknown"] else ""
    return Verdict(f"{text}{open_ones}.", "good")


def _line(row: Check) -> Line:
    values = (row.model, row.grid, row.surface, row.volume)
    unit = "" if row.unit == "1" else f" in {row.unit}"
    return Line(
        quantity=f"{row.quantity}{unit}",
        values=tuple("—" if value is None else number(value) for value in values),
        tolerance=f"{row.tolerance:.2g}",
        verdict=row.verdict,
        remedy=row.remedy,
        good=row.verdict != "differ",
    )
