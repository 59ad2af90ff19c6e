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
PER_MODE = 5
"""Degrees of freedom for each frequency that is asked for: CalculiX' solver (ARPACK) works with
five vectors for each, and stops where there are more of them than unknowns."""


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

    Of a clamped side it is the largest that has faces there. A coarse mesh has fewer modes than
    may be wanted: then there are as many as are found, and the note says so.
    """
    solid, materials = phases(mesh, section)
    side = "" if section.clamped == "none" else section.clamped
    found = largest(solid, side)
    held = (Held(side, "displacement", components=(0, 1, 2)),) if side else ()
    still = found.mesh.parts[side].members if side and not found.why_not else ()
    free = 3 * (len(found.mesh.points) - len(still))
    modes = min(section.modes, free // PER_MODE)
    how = f"{side} clamped" if side else "free"
    title = f"{modes} natural frequencies of {materials['SOLID'].name}, {how}"
    few = f"the mesh has {free} degrees of freedom, {PER_MODE} are needed for each mode"
    why_not = found.why_not or ("" if modes else f"{few}; wanted a finer one")
    if why_not:
        return Job(title, solid, materials, why_no_step=why_not)
    less = f"{modes} modes in place of {section.modes}: {few}" if modes < section.modes else ""
    step = Step("modal", "modal", held, modes=modes)
    note = "; ".join(one for one in (found.note, less) if one)
    return Job(title, found.mesh, materials, (step,), note=note)
