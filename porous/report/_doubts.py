"""What is uncertain in a result, said in sentences."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from porous.report._agreement import conflicts
from porous.report._digits import half_width, is_noise, number, unit_of, value_text, width_text
from porous.report._names import LABELS, called
from porous.values.measure import ONE_SIDED

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from porous.pipeline import Result
    from porous.values import Measure

FEW = 3
"""Voxels across a feature below which its shape is not to be trusted."""

THIN = ("smallest_feature", "smallest_pore", "smallest_wall", "smallest_gap")
"""What a body's thinnest parts are measured by."""

MATERIAL = "material_"
"""How names begin of what tells of something larger."""

SPECIFIC = {"material_specific_surface": "area by volume"}
"""What is called otherwise there."""

AXIS = re.compile(r"(.* along )([+−]?[xyz])")

NOTEWORTHY = 0.01
"""Relative half-width from which a best number is said to be uncertain."""

MOVED = "would be where the threshold lay"
"""What a note on an image says of another threshold."""

NOT_APART = "not told apart from zero"

LENGTH = re.compile(r"(?:1/)?[a-zµ]+([²³]?)")
POWERS = {"": 1, "²": 2, "³": 3}


@dataclass(frozen=True)
class Doubts:
    """What a reader should not take for certain, the gravest first.

    Parameters
    ----------
    first
        Contradictions, what is too thin, what the threshold does, and the numbers that are looked
        for first where they are known badly.
    others
        All other numbers that are known badly.
    missing
        What could not be measured at all, in a sentence; or nothing.
    """

    first: tuple[str, ...]
    others: tuple[str, ...]
    missing: str


def doubts(result: Result) -> Doubts:
    """Return what a reader should not take for certain."""
    spread = dict(_of_spread(result))
    return Doubts(
        first=(
            *_of_conflicts(result),
            *_of_resolution(result),
            *(note for note in result.notes if MOVED in note),
            *_of_sampling(result),
            *_together({name: spread[name] for name in LABELS if name in spread}),
        ),
        others=tuple(_together({n: text for n, text in spread.items() if n not in LABELS})),
        missing=_missing(result),
    )


def _missing(result: Result) -> str:
    if result.grid is not None or not len(result.measures):
        return ""
    known = "" if "porosity" in result.measures else "porosity needs a bulk to be a part of, and "
    return (
        f"There are no voxels: {known}sizes of pores and walls, and ways through them, are "
        "measured of voxels."
    )


def _of_conflicts(result: Result) -> Iterator[str]:
    for best, other in conflicts(result.measures):
        chance = "standard" in (best.kind, other.kind)
        yield _sentence(
            f"{called(other.name)} by {other.method} of the {other.of} is {_shown(other)}, which "
            f"contradicts {_shown(best)} by {best.method} of the {best.of}"
            f"{'; 0.3 % of right numbers do so by chance' if chance else ''}."
        )


def _of_resolution(result: Result) -> Iterator[str]:
    if result.grid is None:
        return
    h = max(result.grid.frame.spacing)
    for name in THIN:
        for row in result.measures.all(name)[:1]:
            if math.isfinite(row.value) and row.value < FEW * h * (1 - 1e-9):
                yield (
                    f"The {name.replace('_', ' ')} is {value_text(row)} {unit_of(row)}, "
                    f"{row.value / h:.1f} voxels across; below {FEW} voxels its shape is lost."
                )


def _of_sampling(result: Result) -> Iterator[str]:
    unknown = []
    for name in filter(_is_of_material, result.measures.names):
        row = result.measures[name]
        label = SPECIFIC.get(name, called(name.removeprefix(MATERIAL)))
        if not math.isfinite(row.uncertainty):
            unknown.append(label)
        elif not _is_sure(row):
            yield f"As a sample of a larger body, {label}: {_shown(row)}, by blocks."
    if unknown:
        yield f"Of what the grid was cut out of is not known: {', '.join(unknown)}."


def _is_of_material(name: str) -> bool:
    return name.startswith(MATERIAL)


def _is_sure(row: Measure) -> bool:
    return half_width(row) <= NOTEWORTHY * abs(row.value)


def _together(said: Mapping[str, str]) -> Iterator[str]:
    """Yield sentences on measures; one for all axes of which the same is said."""
    axes: dict[tuple[str, str], list[str]] = {}
    for name, text in said.items():
        found = AXIS.fullmatch(called(name))
        axes.setdefault((found[1] if found else called(name), text), []).append(
            found[2] if found else ""
        )
    for (label, text), along in axes.items():
        yield _sentence(f"{label}{', '.join(along)} {text}")


def _of_spread(result: Result) -> Iterator[tuple[str, str]]:
    """Yield names of measures and what is uncertain of them."""
    for name in result.measures.names:
        row = result.measures[name]
        if _is_of_material(name) or is_noise(row, _usual(result, row)):
            continue
        if said := _spread(row):
            yield name, said


def _spread(row: Measure) -> str:
    """Return what is uncertain of a number, or nothing."""
    half = half_width(row)
    if math.isnan(row.value):
        return f"is not defined for this body ({row.method})."
    if row.method in ONE_SIDED:
        return f"is {row.spread} {_valued(row)}; how far off is not known."
    if _is_sure(row):
        return ""
    if not math.isfinite(half):
        return f"is {_valued(row)}, by {row.method}: how far off is not known."
    part = 100 * half / abs(row.value) if row.value else math.inf
    share = f"± {number(float(f'{part:.2g}'))} %" if part < 100 else NOT_APART
    return f"is {_shown(row)}, by {row.method}: {share}."


def _usual(result: Result, row: Measure) -> float:
    """Return what a measure may be of a body as large as this one, to tell rounding by."""
    found = LENGTH.fullmatch(row.unit)
    if result.grid is None or not found:
        return 0.0
    power = POWERS[found[1]]
    return float(max(result.grid.frame.box.lengths) ** (-power if "/" in row.unit else power))


def _valued(row: Measure) -> str:
    return f"{value_text(row)} {unit_of(row)}".strip()


def _shown(row: Measure) -> str:
    """Return a number with its half-width and unit."""
    half = half_width(row)
    if row.kind == "exact" or row.method in ONE_SIDED or is_noise(row):
        return _valued(row)
    sure = "" if row.kind == "bound" or not math.isfinite(half) else " (95 %)"
    return f"{value_text(row)} {width_text(row.value, half)} {unit_of(row)}".strip() + sure


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]
