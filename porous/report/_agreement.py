"""Measures side by side: which rows tell the same thing, and which contradict each other."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from porous.report._digits import (
    half_text,
    half_width,
    number,
    rounded,
    unit_of,
    value_text,
    width_text,
)

if TYPE_CHECKING:
    from porous.certificate import Certificate, Check
    from porous.values import Measure, Measures

ROUNDING = 1e-9
"""Relative difference that is put down to floating-point numbers."""

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
        value=value_text(measure),
        exactly=repr(measure.value),
        unit=unit_of(measure),
        half=half_text(measure),
        half_exactly=repr(half_width(measure)),
        kind=measure.kind,
        mark=mark,
        agrees=fine,
        best=best is None,
    )


def compared(best: Measure, other: Measure) -> str:
    """Say whether a measure agrees with another that is held for better, and else by how much."""
    return "agrees" if agree(best, other) else f"differs by {_gap(best, other)}"


def _gap(best: Measure, other: Measure) -> str:
    gap = other.value - best.value
    sign = "+" if gap > 0 else "−"
    if best.value and math.isfinite(best.value) and math.isfinite(gap):
        return f"{sign}{abs(gap / best.value):.2%}"
    return f"{sign}{number(abs(gap))}"


TONES = {"agree": "good", "unknown": "open", "differ": "bad"}
"""How a verdict looks."""

SUBJECTS = {"model": "model", "grid": "voxels", "surface": "surface", "volume": "mesh"}
"""What is compared, and what it is called."""


@dataclass(frozen=True)
class Line:
    """One line of the certificate, as text; ``values`` are of model, grid, surface and volume.

    ``tone`` is good, open or bad, as of a ``Verdict``.
    """

    quantity: str
    values: tuple[str, ...]
    tolerance: str
    verdict: str
    remedy: str
    tone: str


@dataclass(frozen=True)
class Verdict:
    """What the certificate comes to, in one sentence, and how it is to look: good, bad, open."""

    text: str
    tone: str


def lines(certificate: Certificate | None) -> tuple[Line, ...]:
    """Return the certificate for its table."""
    return tuple(map(_line, certificate.rows)) if certificate else ()


def verdict(certificate: Certificate | None) -> Verdict:
    """Return what the certificate comes to; only what was compared is named."""
    rows = certificate.rows if certificate else ()
    named = {
        word: [row.quantity.replace("_", " ") for row in rows if row.verdict == word]
        for word in TONES
    }
    if named["differ"]:
        text = f"{_compared(rows, 'differ')} differ in {', '.join(named['differ'])}"
        return Verdict(f"{text}: the certificate says what would mend it.", "bad")
    if not named["agree"]:
        return Verdict("Not certified: there was nothing to compare with.", "open")
    text = f"{_compared(rows, 'agree')} agree in {', '.join(named['agree'])}"
    if named["unknown"]:
        return Verdict(f"{text}; not decided: {', '.join(named['unknown'])}.", "open")
    return Verdict(f"{text}.", "good")


def _compared(rows: tuple[Check, ...], word: str) -> str:
    """Return who has a value where the verdict is that word, in a sentence's first words."""
    there = [
        name
        for subject, name in SUBJECTS.items()
        if any(getattr(row, subject) is not None for row in rows if row.verdict == word)
    ]
    text = " and ".join((", ".join(there[:-1]), there[-1])) if len(there) > 1 else "".join(there)
    return text[:1].upper() + text[1:]


def _line(row: Check) -> Line:
    values = (row.model, row.grid, row.surface, row.volume)
    shown = ["—" if value is None else number(value) for value in values]
    if row.grid is not None and row.width:
        shown[1] = f"{rounded(row.grid, row.width)} {width_text(row.grid, row.width)}"
    unit = "" if row.unit == "1" else f" in {row.unit}"
    return Line(
        quantity=f"{row.quantity}{unit}",
        values=tuple(shown),
        tolerance=f"{row.tolerance:.2g}",
        verdict=row.verdict,
        remedy=row.remedy,
        tone=TONES[row.verdict],
    )
