"""Steady flow through the pores, driven by a pressure or by a velocity along an axis."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from porous.errors import MeshError
from porous.jobs._block import why_no_block
from porous.jobs._diffusion import across, solved
from porous.jobs._section import Axis, MaterialName, SimulationSection, phases
from porous.jobs._through import through, volume, wet_area
from porous.values import Held, Job, Measures, Step
from porous.values.box import SIDES
from porous.values.units import length_ratio

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from porous.values import Box, Material, VolumeMesh

CREEPING = 0.01
"""The Reynolds number that is aimed at where nobody says how fast: inertia is nothing then."""
PASCAL = 1e-6
"""In MPa."""
DARCY = 9.869233e-13
"""In m²."""


class FlowSection(SimulationSection):
    """A fluid flows from the MIN side to the MAX side, laminar, at rest on every wall."""

    PHASE: ClassVar[Literal["solid", "pore", "both"]] = "pore"
    DECK: ClassVar[str] = "foam"
    PROCEDURES: ClassVar[tuple[str, ...]] = ("flow",)

    analysis: Literal["flow"] = Field(description='"flow"')
    material: MaterialName = Field(
        default="water",
        description="the name of a fluid, with a viscosity and a density, or a path to a TOML "
        "file, relative to the recipe",
    )
    axis: Axis = Field(default="x", description='"x", "y" or "z": along which it flows')
    pressure_drop: Annotated[float, Field(gt=0)] | None = Field(
        default=None,
        description="more than zero, in Pa, from the MIN to the MAX side; where neither it nor a "
        "velocity is given, one that makes the Reynolds number about 0.01",
    )
    velocity: Annotated[float, Field(gt=0)] | None = Field(
        default=None,
        description="more than zero, in mm/s, in place of a pressure: the same all over the pores' "
        "openings on the MIN side",
    )
    sides: Literal["walls", "slip"] = Field(
        default="walls",
        description='"walls" or "slip": whether the fluid clings to the four other sides',
    )

    @model_validator(mode="after")
    def _one_drive(self) -> FlowSection:
        if self.pressure_drop is not None and self.velocity is not None:
            raise ValueError("got pressure_drop and velocity; wanted one of them, or none")
        return self


def prepare(mesh: VolumeMesh, section: FlowSection) -> Job:
    """Return the job that a section asks for; see ``flow``."""
    pores, materials = phases(mesh, section)
    given = {"pressure_drop": section.pressure_drop, "velocity": section.velocity}
    return flow(
        pores,
        fluid=materials["PORE"],
        axis=section.axis,
        slip=section.sides == "slip",
        **{name: value for name, value in given.items() if value is not None},
    )


def flow(
    mesh: VolumeMesh,
    *,
    fluid: Material,
    axis: str = "x",
    pressure_drop: float = math.nan,
    velocity: float = math.nan,
    slip: bool = False,
) -> Job:
    """Return the job of driving a fluid through a pore space along an axis.

    Kept are the pores that lead from one side to the other. The title says the Reynolds number to
    be expected, that of a straight tube as wide as the pores are on average: ρ·u·d/μ, with the
    hydraulic diameter d = 4V/S of volume and wet surface, and u = Δp·d²/(32·μ·L) (Hagen and
    Poiseuille) where a pressure is given.

    Parameters
    ----------
    mesh
        Of the pores alone, with their part ``PORE`` and the sides that ``name_parts`` gives.
    fluid
        With a viscosity and a density.
    axis
        x, y or z.
    pressure_drop
        In Pa, from the ``MIN`` to the ``MAX`` side.
    velocity
        In mm/s, in place of a pressure: all over the openings on the ``MIN`` side. With neither, a
        pressure that makes the Reynolds number 0.01.
    slip
        Whether the fluid slips along the other four sides instead of clinging to them.

    Raises
    ------
    MeshError
        For a mesh without a part ``PORE``, a drive that is not above zero, or two of them.
    """
    for name, drive in (("pressure_drop", pressure_drop), ("velocity", velocity)):
        if not (math.isnan(drive) or 0 < drive < math.inf):
            raise MeshError(f"flow: got {name} = {drive}; wanted more than zero")
    if not math.isnan(pressure_drop) and not math.isnan(velocity):
        raise MeshError("flow: got a pressure and a velocity; wanted one of them, or none")
    first, last = (f"{axis.upper()}{end}" for end in ("MIN", "MAX"))
    title = f"steady flow of {fluid.name} from {first} to {last}"
    found = through(mesh, first, last)
    beside = _beside(found.mesh, first)
    wet = wet_area(found.mesh, () if slip else beside)
    why_not = found.why_not or ("" if wet else "there is no wall that the fluid clings to")
    if why_not:
        return Job(title, mesh, {"PORE": fluid}, why_no_step=why_not)
    wide = 4 * volume(found.mesh) / wet
    if math.isnan(velocity):
        far = _far(found.mesh, first, last)
        ease = wide**2 / (32 * fluid.known("viscosity") * far)
        drop = _drop(fluid, wide, ease) if math.isnan(pressure_drop) else pressure_drop * PASCAL
        told, speed = f"{drop / PASCAL:.4g} Pa", drop * ease
        held = [Held(first, "pressure", drop), Held(last, "pressure")]
    else:
        told, speed = f"{velocity:g} mm/s", velocity
        held = [*_driven(first, velocity), Held(last, "pressure")]
    if slip:
        held += [Held(side, "velocity", 0.0, ("XYZ".index(side[0]),)) for side in beside]
    reynolds = _reynolds(fluid, speed, wide)
    title = f"{title}, {told}; Reynolds number about {reynolds:.2g}"
    step = Step("flow", "flow", tuple(held))
    return Job(title, found.mesh, {"PORE": fluid}, (step,), note=found.note)


def permeability(
    job: Job, rates: Mapping[str, float], pressures: Mapping[str, float], box: Box | None
) -> Measures:
    """Return what a solved job of flow says of the pores: Darcy's k = μ·(Q/A)·L/Δp.

    Parameters
    ----------
    job
        As it was solved, with one step of flow.
    rates
        What leaves through the two sides, in m³/s.
    pressures
        On these sides, in Pa.
    box
        The whole body, in the mesh's unit: L is its length along the axis, A its area across. None
        where body and pores fill no box.

    Returns
    -------
    The permeability in mm² and in darcy, the mean velocity over the whole cross-section (of pores
    and solid), and the Reynolds number ρ·u·d/μ of the mean velocity u in the pores and their
    hydraulic diameter d. Of what is no block, for its sides do not lie in the box's: the flow and
    the drop of the pressure alone.
    """
    fluid = next(iter(job.materials.values()))
    first, last = (side for side in SIDES if side in pressures)
    through_it = (rates[last] - rates[first]) / 2 * 1e9
    drop = (pressures[first] - pressures[last]) * PASCAL
    if box is None or why_no_block(job.mesh, box):
        rows = solved("flow_rate", through_it, "mm³/s"), solved("pressure_drop", drop, "MPa")
        return Measures(rows)
    length, area = across(box, first, job.mesh.unit)
    speed = through_it / area
    found = fluid.known("viscosity") * speed * length / drop
    inside = speed * length * area / volume(job.mesh)
    held = {held.part for held in job.steps[0].held}
    wet = wet_area(job.mesh, [side for side in _beside(job.mesh, first) if side not in held])
    reynolds = _reynolds(fluid, inside, 4 * volume(job.mesh) / wet)
    axis = first[0].lower()
    return Measures(
        (
            solved(f"permeability_{axis}", found, "mm²"),
            solved(f"permeability_{axis}_in_darcy", found * 1e-6 / DARCY, "D"),
            solved(f"superficial_velocity_{axis}", speed, "mm/s"),
            solved("reynolds_number", reynolds, "1"),
        )
    )


def _drop(fluid: Material, wide: float, ease: float) -> float:
    """Return the pressure that makes the flow creep, in MPa."""
    return CREEPING / (_reynolds(fluid, 1.0, wide) * ease)


def _reynolds(fluid: Material, speed: float, wide: float) -> float:
    return fluid.known("density") * speed * wide / fluid.known("viscosity")


def _far(mesh: VolumeMesh, first: str, last: str) -> float:
    """Return how far two sides are from each other, in mm."""
    axis = "XYZ".index(first[0])
    low, high = (mesh.points[mesh.parts[side].members, axis].mean() for side in (first, last))
    return float(high - low) * length_ratio(mesh.unit, "mm")


def _beside(mesh: VolumeMesh, first: str) -> list[str]:
    """Return the sides along which it flows that the mesh has faces on."""
    there = [side for side in SIDES if f"{side}_FACES" in mesh.parts]
    return [
        side for side in there if side[0] != first[0] and len(mesh.parts[f"{side}_FACES"].members)
    ]


def _driven(side: str, speed: float) -> Iterator[Held]:
    along = "XYZ".index(side[0])
    yield Held(side, "velocity", speed, (along,))
    yield Held(side, "velocity", 0.0, tuple(axis for axis in range(3) if axis != along))
