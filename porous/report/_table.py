"""The tables of the page: key numbers first, then every row, by what its definition is under."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from porous.report._agreement import agree, compared, groups
from porous.report._definitions import OTHERS, definition, definitions, methods
from porous.report._digits import half_text, half_width, unit_of, value_text
from porous.report._names import CLOSED, FORMS, KEYS, called
from porous.values import Measures

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from porous.report._agreement import Row
    from porous.values import Measure

NOTHING = "nan"
"""What a cell without a number sorts by."""
AXES = ("x", "y", "z")
OVERHANG = "overhang_share_"


@dataclass(frozen=True)
class Key:
    """One line of the first table, as text: what was measured, and the closed form beside it."""

    label: str
    name: str
    value: str
    exactly: str
    half: str
    half_exactly: str
    unit: str
    method: str
    closed: str
    closed_exactly: str
    mark: str
    tone: str


@dataclass(frozen=True)
class Section:
    """Rows whose definitions stand under one heading."""

    title: str
    key: str
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class Term:
    """One entry of the glossary."""

    name: str
    key: str
    text: str


def keys(measures: Measures) -> tuple[Key, ...]:
    """Return the numbers that a reader looks for first."""
    return (*_known(measures), *_open_axes(measures), *_best_direction(measures))


def _known(measures: Measures) -> Iterator[Key]:
    for name, label in KEYS:
        if name in measures or FORMS.get(name) in measures:
            yield _key(measures, name, label)


def _key(measures: Measures, name: str, label: str) -> Key:
    taken = Measures(tuple(row for row in measures.all(name) if row.method != CLOSED))
    formula = _formula(measures, name)
    row = taken[name] if len(taken) else None
    answer = row or formula
    if answer is None:  # of a form that holds for the model at least, or at most
        answer = row = measures[FORMS[name]]
    return Key(
        label=label,
        name=answer.name,
        value=value_text(row) if row else "—",
        exactly=repr(row.value) if row else NOTHING,
        half=half_text(row) if row else "",
        half_exactly=repr(half_width(row)) if row else NOTHING,
        unit=unit_of(answer),
        method=answer.method,
        closed=value_text(formula) if formula else "—",
        closed_exactly=repr(formula.value) if formula else NOTHING,
        mark=compared(formula, row) if formula and row else "",
        tone=_tone(name, formula, row),
    )


def _formula(measures: Measures, name: str) -> Measure | None:
    """Return the closed form that stands beside a measurement, of its own name or another."""
    rows = (*measures.all(name), *measures.all(FORMS.get(name, "")))
    return next((row for row in rows if row.method == CLOSED), None)


def _tone(name: str, formula: Measure | None, row: Measure | None) -> str:
    if formula is None or row is None or agree(formula, row):
        return "good"
    return "open" if name in FORMS else "bad"


def _open_axes(measures: Measures) -> Iterator[Key]:
    """Yield the axes along which pores lead from side to side."""
    rows = {axis: measures.all(f"through_porosity_{axis}")[:1] for axis in AXES}
    if not all(rows.values()):
        return
    led = [axis for axis in AXES if rows[axis][0].value > 0]
    first = rows["x"][0]
    yield Key(
        label="axes that pores pass",
        name=first.name,
        value=", ".join(led) if led else "none",
        exactly=NOTHING,
        half="",
        half_exactly=NOTHING,
        unit="",
        method=first.method,
        closed="—",
        closed_exactly=NOTHING,
        mark="",
        tone="good",
    )


def _best_direction(measures: Measures) -> Iterator[Key]:
    """Yield what overhangs where the body is built as it overhangs least."""
    named = [name for name in measures.names if name.startswith(OVERHANG)]
    if named:
        best = min(named, key=lambda name: round(measures[name].value, 6))
        yield _key(measures, best, called(best))


def sections(measures: Measures) -> tuple[Section, ...]:
    """Return every row, those of one measure together, under the headings of the definitions."""
    found: dict[str, list[Row]] = {known.section: [] for known in definitions().values()}
    found[OTHERS] = []
    for group in groups(measures):
        known = definition(group.name)
        title = known.section if known else OTHERS
        found[title] += group.rows
    return tuple(
        Section(title, f"measures-{place}", tuple(rows))
        for place, (title, rows) in enumerate(found.items(), 1)
        if rows
    )


def glossary(names: Iterable[str]) -> tuple[Term, ...]:
    """Return what the measures of a page are, each once, by the order of the page of measures."""
    used = {known.name: known for known in map(definition, names) if known}
    order = {name: place for place, name in enumerate(definitions())}
    return tuple(
        Term(known.name, anchor(known.name), known.text)
        for known in sorted(used.values(), key=lambda one: order[one.name])
    )


def methods_used(names: Iterable[str]) -> tuple[Term, ...]:
    """Return what methods do, each once."""
    known = methods()
    used = dict.fromkeys(names)
    return tuple(Term(name, method_anchor(name), known[name]) for name in used if name in known)


def anchor(name: str) -> str:
    """Return where on the page a measure is defined; nothing where it is not."""
    known = definition(name)
    return f"def-{known.name}" if known else ""


def method_anchor(name: str) -> str:
    """Return where on the page a method is explained; nothing where it is not."""
    return f"how-{name.replace(' ', '-')}" if name in methods() else ""


def sortable(exactly: str) -> str:
    """Return what a table sorts a number by: nothing for what is no number."""
    value = float(exactly)
    return "" if math.isnan(value) else exactly
