"""Natural frequencies of a body that is clamped on one side, or free."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from porous.jobs._body import largest
from porous.jobs._section import SimulationSection, phases
from porous.values import Held, Job, Step

if TYPE_CHECKING:
    from porous.values import VolumeMesh

LARGEST_NUMBER = 1000


class ModalSection(SimulationSection):
    """The lowest natural frequencies."""

    PROCEDURES: ClassVar[tuple[str, ...]] = ("modal",)

    analysis: Literal["modal"] = Field(default="modal", description='"modal"')
    clamped: Literal["XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX", "none"] = Field(
        default="ZMIN", description='the side that is held, "XMIN" … "ZMAX", or "none"'
    )
    modes: int = Field(
        default=10,
        gt=0,
        le=LARGEST_NUMBER,
        description=f"how many frequencies, 1 … {LARGEST_NUMBER}; of a free body the first six "
        "are those of its motion as a whole, zero",
    )


def prepare(mesh: VolumeMesh, section: ModalSection) -> Job:
    """Return the job of finding the natural frequencies of the largest body.

    Of a clamped side it is the largest that has faces there.
    """
    solid, materials = phases(mesh, section)
    side = "" if section.clamped == "none" else section.clamped
    how = f"{side} clamped" if side else "free"
    title = f"{section.modes} natural frequencies of {materials['SOLID'].name}, {how}"
    found = largest(solid, side)
    if found.why_not:
        return Job(title, solid, materials, why_no_step=found.why_not)
    held = (Held(side, "displacement", components=(0, 1, 2)),) if side else ()
    step = Step("modal", "modal", held, modes=section.modes)
    return Job(title, found.mesh, materials, (step,), note=found.note)
