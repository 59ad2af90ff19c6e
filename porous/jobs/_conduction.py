"""Steady conduction of heat along an axis: two opposite sides are held at temperatures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from porous.jobs._body import between
from porous.jobs._section import Axis, TwoPhaseSection, phases
from porous.values import Held, Job, Step

if TYPE_CHECKING:
    from porous.values import VolumeMesh


class ConductionSection(TwoPhaseSection):
    """Heat flows from one side to the opposite one, no heat through all others."""

    PROCEDURES: ClassVar[tuple[str, ...]] = ("conduction",)

    analysis: Literal["conduction"] = Field(default="conduction", description='"conduction"')
    axis: Axis = Field(default="z", description='"x", "y" or "z": of the sides that are held')
    temperatures: Annotated[tuple[float, float], Field(strict=False)] = Field(
        default=(0.0, 1.0), description="two numbers: of the MIN and of the MAX side, in K"
    )

    @model_validator(mode="after")
    def _differ(self) -> ConductionSection:
        if self.temperatures[0] == self.temperatures[1]:
            raise ValueError("temperatures: wanted two that differ, for else no heat flows")
        return self


def prepare(mesh: VolumeMesh, section: ConductionSection) -> Job:
    """Return the job of holding two sides at temperatures.

    Kept is all that has faces on both sides: several bodies side by side lead heat, each by itself.
    """
    cells, materials = phases(mesh, section)
    first, last = (f"{section.axis.upper()}{end}" for end in ("MIN", "MAX"))
    low, high = section.temperatures
    made_of = " and ".join(material.name for material in materials.values())
    title = f"steady conduction in {made_of}, {first} at {low:g} K, {last} at {high:g} K"
    found = between(cells, first, last, several=True)
    if found.why_not:
        return Job(title, cells, materials, why_no_step=found.why_not)
    held = (Held(first, "temperature", low), Held(last, "temperature", high))
    return Job(
        title, found.mesh, materials, (Step("conduction", "conduction", held),), note=found.note
    )
