"""What is uncertain in a result, said in sentences."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from porous.report._agreement import conflicts, half_width, number
from porous.values.measure import ONE_SIDED

if TYPE_CHECKING:
    from collections.abc import Iterator

    from porous.pipeline import Result
    from porous.values import Measure

FEW = 3
"""Voxels across a feature below which its shape is not to be trusted."""

THIN = ("smallest_feature", "smallest_pore", "smallest_wall", "smallest_gap")
"""What a body's thinnest parts are measured by."""

OF_MATERIAL = {
    "material_porosity": "porosity",
    "material_specific_surface": "area by volume",
}
"""What tells of something larger, and what it is called there."""

NOTEWORTHY = 0.01
"""Relative half-width from which a best number is said to be uncertain."""


def doubts(result: Result) -> tuple[str, ...]:
    """Return what a reader should not take for certain, the gravest first."""
    return (
        *_of_conflicts(result),
        *_of_resolution(result),
        *_of_sampling(result),
        *result.findings.notes,
        *_of_spread(result),
    )


def _of_conflicts(result: Result) -> Iterator[str]:
    for best, other in conflicts(result.measures):
        chance = "standard" in (best.kind, other.kind)
        yield (
            f"{other.name} by {other.method} of the {other.of} is {_shown(other)}, which "
            f"contradicts {_shown(best)} by {best.method} of the {best.of}"
            f"{'; one in twenty does so by chance' if chance else ''}."
        )


def _of_resolution(result: Result) -> Iterator[str]:
    if result.grid is None:
        return
    h = max(result.grid.frame.spacing)
    for name in THIN:
        for row in result.measures.all(name)[:1]:
            if math.isfinite(row.value) and row.value < FEW * h * (1 - 1e-9):
                yield (
                    f"The {name.replace('_', ' ')} is {number(row.value)} {row.unit}, "
                    f"{row.value / h:.1f} voxels across; below {FEW} voxels its shape is lost."
                )


def _of_sampling(result: Result) -> Iterator[str]:
    for name, label in OF_MATERIAL.items():
        for row in result.measures.all(name)[:1]:
            far = (
                f"by blocks of it {_shown(row)}" if math.isfinite(row.uncertainty) else "not known"
            )
            yield f"Of what the grid was cut out of the {label} is {far}."


def _of_spread(result: Result) -> Iterator[str]:
    for name in result.measures.names:
        row = result.measures[name]
        if name in OF_MATERIAL:
            continue
        if math.isnan(row.value):
            yield f"{name} is not defined for this body ({row.method})."
        elif row.method in ONE_SIDED:
            yield f"{name} is {row.spread} {number(row.value)}; how far off is not known."
        elif not half_width(row) <= NOTEWORTHY * abs(row.value):
            yield (
                f"{name} is {_shown(row)}: the best there is ({row.method}) leaves "
                f"{_share(row)} open."
            )


def _shown(row: Measure) -> str:
    unit = "" if row.unit == "1" else f" {row.unit}"
    spread = {"exact": "", "bound": f" ± {row.uncertainty:.2g}"}.get(
        row.kind, f" ± {half_width(row):.2g} (95 %)"
    )
    return f"{number(row.value)}{spread}{unit}"


def _share(row: Measure) -> str:
    share = half_width(row) / abs(row.value) if row.value else math.inf
    return f"{share:.1%}" if math.isfinite(share) else "its size"
