"""Steady diffusion through the pores: the concentration is held on two opposite sides."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from porous.errors import MeshError
from porous.jobs._block import why_no_block
from porous.jobs._section import Axis, MaterialName, SimulationSection, phases
from porous.jobs._through import through, volume
from porous.values import Held, Job, Measure, Measures, Step
from porous.values.units import length_ratio

if TYPE_CHECKING:
    from collections.abc import Mapping

    from porous.values import Box, Material, VolumeMesh


class DiffusionSection(SimulationSection):
    """What is dissolved in the pores wanders from one side to the opposite one."""

    PHASE: ClassVar[Literal["solid", "pore", "both"]] = "pore"
    DECK: ClassVar[str] = "foam"
    PROCEDURES: ClassVar[tuple[str, ...]] = ("diffusion",)

    analysis: Literal["diffusion"] = Field(description='"diffusion"')
    material: MaterialName = Field(
        default="oxygen-in-water",
        description="what wanders in what: the name of a material with a diffusivity, or a path "
        "to a TOML file, relative to the recipe",
    )
    axis: Axis = Field(default="x", description='"x", "y" or "z": of the sides that are held')
    concentrations: Annotated[tuple[float, float], Field(strict=False)] = Field(
        default=(1.0, 0.0),
        description="two numbers: of the MIN and of the MAX side, in any unit of your own",
    )

    @model_validator(mode="after")
    def _differ(self) -> DiffusionSection:
        if self.concentrations[0] == self.concentrations[1]:
            raise ValueError("concentrations: wanted two that differ, for else nothing wanders")
        return self


def prepare(mesh: VolumeMesh, section: DiffusionSection) -> Job:
    """Return the job that a section asks for; see ``diffusion``."""
    pores, materials = phases(mesh, section)
    return diffusion(
        pores,
        material=materials["PORE"],
        axis=section.axis,
        concentrations=section.concentrations,
    )


def diffusion(
    mesh: VolumeMesh,
    *,
    material: Material,
    axis: str = "x",
    concentrations: tuple[float, float] = (1.0, 0.0),
) -> Job:
    """Return the job of holding concentrations on two opposite sides of a pore space.

    Kept are the pores that lead from one to the other; all other sides, and the walls, let nothing
    through.

    Parameters
    ----------
    mesh
        Of the pores alone, with their part ``PORE`` and the sides that ``name_parts`` gives.
    material
        With a diffusivity.
    axis
        x, y or z.
    concentrations
        On the ``MIN`` and on the ``MAX`` side, in any unit.

    Raises
    ------
    MeshError
        For a mesh without a part ``PORE``, or concentrations that are no numbers.
    """
    if not all(map(math.isfinite, concentrations)):
        raise MeshError(f"diffusion: got concentrations {concentrations}; wanted two numbers")
    first, last = (f"{axis.upper()}{end}" for end in ("MIN", "MAX"))
    low, high = concentrations
    title = f"steady diffusion of {material.name}, {low:g} on {first}, {high:g} on {last}"
    found = through(mesh, first, last)
    if found.why_not:
        return Job(title, mesh, {"PORE": material}, why_no_step=found.why_not)
    held = (Held(first, "concentration", low), Held(last, "concentration", high))
    step = Step("diffusion", "diffusion", held)
    return Job(title, found.mesh, {"PORE": material}, (step,), note=found.note)


def effective_diffusivity(
    job: Job, rates: Mapping[str, float], box: Box | None, *, porosity: float = math.nan
) -> Measures:
    """Return what a solved job of diffusion says of the pores.

    D_eff = J·L / (A·Δc), with J what passes, L and A the box's length along the axis and its area
    across; τ = D·φ / D_eff. Of what is no block, for its sides do not lie in the box's, J alone.

    Parameters
    ----------
    job
        As it was solved, with one step of diffusion.
    rates
        What leaves through each of the two sides, in m³/s times the unit of the concentration.
    box
        The whole body, in the mesh's unit; none where body and pores fill no box.
    porosity
        φ; by default that of the pores that lead through.
    """
    first, last = (held.part for held in job.steps[0].held)
    low, high = (held.value for held in job.steps[0].held)
    passing = (rates[last] - rates[first]) / 2 * 1e9
    if box is None or why_no_block(job.mesh, box):
        return Measures((solved("diffusion_rate", abs(passing), "mm³/s"),))
    length, area = across(box, first, job.mesh.unit)
    inside = volume(job.mesh) / (length * area)
    effective = passing * length / (area * (low - high))
    share = inside if math.isnan(porosity) else porosity
    free = next(iter(job.materials.values())).known("diffusivity")
    tortuosity = free * share / effective
    axis, nan = first[0].lower(), math.nan
    return Measures(
        (
            solved(f"effective_diffusivity_{axis}", effective, "mm²/s"),
            solved(f"tortuosity_factor_{axis}", tortuosity, "1"),
            Measure("through_porosity", inside, "1", "volume of cells", nan, "standard", "volume"),
        )
    )


def across(box: Box, side: str, unit: str) -> tuple[float, float]:
    """Return the length of a box along a side's axis in mm, and its area across in mm²."""
    lengths = [length * length_ratio(unit, "mm") for length in box.lengths]
    along = lengths.pop("XYZ".index(side[0]))
    return along, lengths[0] * lengths[1]


def solved(name: str, value: float, unit: str) -> Measure:
    """Return a measure that finite volumes gave; how good the mesh is, one solution cannot say."""
    method = "finite volumes, discretisation not included"
    return Measure(name, value, unit, method, math.nan, "standard", "volume")
