"""Several materials side by side on one page."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from porous.recipe import dump
from porous.report._agreement import agree, compared
from porous.report._definitions import OTHERS, definition, definitions
from porous.report._digits import half_text, unit_of, unit_text, value_text
from porous.report._names import KEYS, called
from porous.report._page import page
from porous.report._plots import plots
from porous.report._provenance import title_of, versions
from porous.report._table import NOTHING, glossary, methods_used
from porous.values import Measure, Measures
from porous.values.units import METRES, length_ratio

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from porous.pipeline import Result
    from porous.values import Curve

POWERS = {"": 1, "²": 2, "³": 3, "⁴": 4}
LENGTH = re.compile(rf"(1/)?({'|'.join(sorted(METRES, key=len, reverse=True))})([²³⁴]?)")

APART = 30.0
"""Ratio of sizes from which on an axis is logarithmic."""

PARTS = (
    ("key", "Key numbers"),
    ("plots", "Plots"),
    ("measures", "Measures"),
    ("origin", "Where they come from"),
    ("definitions", "Definitions"),
)
"""The parts of the page, and what leads to them."""


@dataclass(frozen=True)
class Material:
    """One of the materials that are compared.

    Parameters
    ----------
    label
        What it is called on the page; each has a name of its own.
    title, source
        As its recipe says.
    measures, curves
        What is known of it.
    recipe, sha256
        Its recipe as text, and the recipe's hash; nothing where it came from a file.
    version
        Of the porous that measured it.
    notes
        What the user should know.
    """

    label: str
    title: str
    source: str = ""
    measures: Measures = field(default_factory=Measures)
    curves: tuple[Curve, ...] = ()
    recipe: str = ""
    sha256: str = ""
    version: str = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Cell:
    """A number of one material, as text, and how it stands to that of the first."""

    value: str
    exactly: str
    half: str
    method: str
    mark: str
    agrees: bool


@dataclass(frozen=True)
class Line:
    """One measure of all materials."""

    name: str
    label: str
    unit: str
    method: str
    cells: tuple[Cell, ...]

    @property
    def differs(self) -> bool:
        """Whether a material differs from the first by more than both admit."""
        return not all(cell.agrees for cell in self.cells)


NONE = Cell("—", NOTHING, "", "", "", agrees=True)


def material_of(result: Result, label: str) -> Material:
    """Return a result as one of several materials."""
    recipe = result.recipe
    return Material(
        label=label,
        title=title_of(result),
        source=recipe.source if recipe else "",
        measures=result.measures,
        curves=result.findings.curves,
        recipe=dump(recipe) if recipe else "",
        sha256=recipe.sha256 if recipe else "",
        version=versions()["porous"],
        notes=(*result.notes, *result.findings.notes),
    )


def compare_html(materials: Sequence[Material]) -> str:
    """Return a page that has materials side by side; it needs no other file and no network.

    It holds a table of measure by material with half-widths, marks what differs from the first by
    more than both admit, overlays their curves, and says where each comes from. For one measure all
    are told by the most trustworthy method that they share, and lengths are in the first's unit.
    """
    measured = [_in_units_of(materials[0], one) for one in materials]
    names = dict.fromkeys(name for measures, _ in measured for name in measures.names)
    lines = [_line([measures for measures, _ in measured], name) for name in names]
    drawn = plots(_overlaid(materials, [curves for _, curves in measured]))
    by = [row.method for measures, _ in measured for row in measures]
    return page(
        "comparison.html",
        plots=drawn,
        title=f"Comparison of {_listed([one.label for one in materials])}",
        parts=[part for part in PARTS if part[0] != "plots" or drawn],
        verdict=_verdict(lines, materials[0].label),
        materials=materials,
        keys=_keys(lines),
        sections=_sections(lines),
        glossary=glossary((*names, *(plot.definition for plot in drawn))),
        methods=methods_used((*by, *(method for plot in drawn for method in plot.methods))),
    )


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]


def _verdict(lines: Sequence[Line], first: str) -> str:
    both = [line for line in lines if sum(cell is not NONE for cell in line.cells) > 1]
    apart = [called(line.name) for line in both if line.differs]
    if not apart:
        return f"Of {len(both)} measures none differs from {first} beyond both uncertainties."
    shown = ", ".join(apart[:6]) + (" and more" if len(apart) > 6 else "")
    return (
        f"Of {len(both)} measures {len(apart)} differ from {first} beyond both uncertainties: "
        f"{shown}."
    )


def _line(measured: Sequence[Measures], name: str) -> Line:
    rows = list(_rows(measured, name))
    known = next(row for row in rows if row is not None)
    shared = {row.method for row in rows if row is not None}
    held = [None, *rows[:1] * (len(rows) - 1)]
    return Line(
        name=name,
        label=name,
        unit=unit_of(known),
        method=known.method if len(shared) == 1 else "",
        cells=tuple(
            _cell(row, first, known.unit, alone=len(shared) > 1)
            for row, first in zip(rows, held, strict=True)
        ),
    )


def _rows(measured: Sequence[Measures], name: str) -> Iterator[Measure | None]:
    """Yield a row of each material, by the best method that all share that have the measure."""
    known = [[row.method for row in measures.all(name)] for measures in measured]
    shared = set.intersection(*(set(methods) for methods in known if methods))
    for measures, methods in zip(measured, known, strict=True):
        rows = [row for row in measures.all(name) if not shared or row.method in shared]
        yield Measures(tuple(rows))[name] if methods else None


def _cell(row: Measure | None, first: Measure | None, unit: str, *, alone: bool) -> Cell:
    """Return a number, held against ``first`` if there is one."""
    if row is None:
        return NONE
    other = row.unit != unit
    mark = "" if first is None else "has another unit" if other else compared(first, row)
    return Cell(
        value=value_text(row) + (f" {unit_text(row.unit)}" if other else ""),
        exactly=repr(row.value),
        half=half_text(row),
        method=row.method if alone else "",
        mark=mark,
        agrees=first is None or (not other and agree(first, row)),
    )


def _keys(lines: Iterable[Line]) -> tuple[Line, ...]:
    known = {line.name: line for line in lines}
    return tuple(replace(known[name], label=label) for name, label in KEYS if name in known)


def _sections(lines: Iterable[Line]) -> tuple[tuple[str, tuple[Line, ...]], ...]:
    found: dict[str, list[Line]] = {known.section: [] for known in definitions().values()}
    found[OTHERS] = []
    for line in lines:
        known = definition(line.name)
        found[known.section if known else OTHERS].append(line)
    return tuple((title, tuple(part)) for title, part in found.items() if part)


# --- units ---------------------------------------------------------------------------------


def _in_units_of(first: Material, other: Material) -> tuple[Measures, tuple[Curve, ...]]:
    """Return measures and curves in the units of length that the first material has."""
    units = {row.name: row.unit for row in first.measures}
    rows = tuple(_converted(row, units.get(row.name, row.unit)) for row in other.measures)
    axes = {curve.name: (curve.x_unit, curve.y_unit) for curve in first.curves}
    return Measures(rows), tuple(_scaled(c, *axes.get(c.name, ("", ""))) for c in other.curves)


def _converted(row: Measure, unit: str) -> Measure:
    ratio = factor(row.unit, unit)
    if ratio is None or ratio == 1:
        return row
    return replace(row, value=row.value * ratio, uncertainty=row.uncertainty * ratio, unit=unit)


def _scaled(curve: Curve, x_unit: str, y_unit: str) -> Curve:
    x, y = factor(curve.x_unit, x_unit), factor(curve.y_unit, y_unit)
    if x is not None and x != 1:
        curve = replace(curve, x=curve.x * x, x_unit=x_unit)
    if y is None or y == 1:
        return curve
    low, high = (None if band is None else band * y for band in (curve.low, curve.high))
    return replace(curve, y=curve.y * y, low=low, high=high, y_unit=y_unit)


def factor(unit: str, target: str) -> float | None:
    """Return how many ``target`` one ``unit`` is; None where they are of different kinds."""
    if unit == target:
        return 1.0
    parts = [LENGTH.fullmatch(text) for text in (unit, target)]
    if not all(parts):
        return None
    (over, length, power), (over_2, length_2, power_2) = (m.groups() for m in parts if m)
    if (over, power) != (over_2, power_2):
        return None
    ratio = length_ratio(length, length_2) ** POWERS[power]
    return 1 / ratio if over else ratio


def _overlaid(materials: Sequence[Material], curves: Sequence[Sequence[Curve]]) -> list[Curve]:
    """Return the curves of all materials, those of one plot together, each with its material.

    Where sizes of materials lie too far apart to be seen on one axis it is logarithmic.
    """
    named = [
        replace(curve, series=f"{one.label}: {curve.series}")
        for one, part in zip(materials, curves, strict=True)
        for curve in part
    ]
    wide = {letter: _far_apart(curves, letter) for letter in "xy"}
    return [
        replace(c, log="".join(s for s in "xy" if s in c.log or c.name in wide[s])) for c in named
    ]


def _far_apart(curves: Sequence[Sequence[Curve]], letter: str) -> set[str]:
    """Return the plots whose lines end at sizes that differ by more than ``APART``."""
    ends: dict[str, list[float]] = {}
    for part in curves:
        tops: dict[str, float] = {}
        for curve in part:
            values = getattr(curve, letter)
            known = values[np.isfinite(values) & (values > 0)]
            if LENGTH.fullmatch(getattr(curve, f"{letter}_unit")) and len(known):
                tops[curve.name] = max(tops.get(curve.name, 0.0), float(known.max()))
        for name, top in tops.items():
            ends.setdefault(name, []).append(top)
    return {name for name, tops in ends.items() if max(tops) > APART * min(tops)}
