"""What pressing, or heating, a block between two sides says of it as one material."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from porous.errors import MeshError
from porous.guests.ccx import ENERGY, FORCE, HEAT
from porous.jobs._block import is_flat, why_no_block
from porous.jobs._diffusion import across
from porous.values import Measure, Measures
from porous.values.units import system_ratio

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from porous.values import Box, Job, Step

    Totals = Mapping[tuple[str, str], tuple[float, ...]]

LEFT_OUT = "discretisation not included"


def effective(job: Job, totals: Sequence[Totals], box: Box | None, *, how: str = "") -> Measures:
    """Return the modulus, or the conductivity, of the block that was solved, along its axis.

    Of compression it is E = (F/A) / (u/L), with F the force on the side that is held, A and L the
    box's area across the axis and its length along it, pores and solid together, and u how far the
    other side moves: as it was told to, or 2W/F, with W the strain energy, which is the mean over
    the faces that are pressed (Clapeyron's theorem). The side that is held cannot slide, which
    makes a block stiffer than its material is without ends.

    Of conduction it is λ = Q·L / (A·ΔT), with Q what flows.

    Of what is no block, for its sides do not lie in the box's, neither is told: it has no one
    length and area.

    Parameters
    ----------
    job
        As it was written into the deck; of other steps, and of periodic cells, nothing is said.
    totals
        Of each step, by quantity and set, in the deck's units.
    box
        The whole body with its pores, in the mesh's unit; none where these fill no box.
    how
        What solved it, for the method; by default finite elements of the mesh's shapes.

    Raises
    ------
    MeshError
        Where a total is missing, or nothing bears the load.
    """
    kinds = dict.fromkeys(block.shape for block in job.mesh.blocks)
    solver = how or f"finite elements {' and '.join(kinds)}"
    block = None if box is None or why_no_block(job.mesh, box) else box
    rows: list[tuple[str, float, str, str]] = []
    if len(job.steps) == len(totals) == 1 and not job.steps[0].gradient:
        step, found = job.steps[0], totals[0]
        if step.procedure == "static" and _sides(step):
            rows = list(_modulus(job, found, block))
        elif step.procedure == "conduction" and block is not None:
            rows = list(_conductivity(job, found, block))
    return Measures(
        tuple(
            Measure(
                name, value, unit, f"{solver}, {told}{LEFT_OUT}", math.nan, "standard", "volume"
            )
            for name, value, unit, told in rows
        )
    )


def _sides(step: Step) -> tuple[str, str] | None:
    """Return the side that is held and the one that is pressed or moved; of compression only."""
    held = [one for one in step.held if one.quantity == "displacement"]
    loaded = [one.part.removesuffix("_FACES") for one in step.pressed]
    loaded += [one.part for one in held if one.value]
    fixed = [one.part for one in held if not one.value]
    if len(loaded) == len(fixed) == 1 and loaded[0][:1] == fixed[0][:1]:
        return fixed[0], loaded[0]
    return None


def _modulus(job: Job, found: Totals, box: Box | None) -> Iterator[tuple[str, float, str, str]]:
    sides = _sides(job.steps[0])
    assert sides is not None
    axis = sides[0][0].lower()
    reaction = _total(found, FORCE, sides[0])["xyz".index(axis)]
    force = abs(reaction) / system_ratio(job.system, "force")
    energy = _total(found, ENERGY)[0] / system_ratio(job.system, "energy")
    told = [held.value for held in job.steps[0].held if held.value]
    if not force or not energy:
        raise MeshError("results: nothing bears the load: no force, or no energy")
    pressed = [one.pressure for one in job.steps[0].pressed]
    moved = told[0] if told else -math.copysign(2 * energy / force, pressed[0])
    held = f"{sides[0]} held, "
    if box is not None:
        length, area = across(box, sides[0], job.mesh.unit)
        yield f"effective_youngs_modulus_{axis}", force / area * length / abs(moved), "MPa", held
    if told or is_flat(job.mesh, sides[1]):  # a pressure on what is tilted works along other axes
        yield f"mean_displacement_{axis}", moved, "mm", held


def _conductivity(job: Job, found: Totals, box: Box) -> Iterator[tuple[str, float, str, str]]:
    first, last = job.steps[0].held
    length, area = across(box, first.part, job.mesh.unit)
    power = system_ratio(job.system, "power")
    flows = [abs(_total(found, HEAT, held.part)[0]) / power for held in (first, last)]
    value = max(flows) * length / (area * abs(last.value - first.value))
    yield f"effective_conductivity_{first.part[0].lower()}", value, "W/(m·K)", ""


def _total(found: Totals, what: str, of: str = "") -> tuple[float, ...]:
    for (quantity, name), values in found.items():
        if quantity == what and of in ("", name):
            return values
    raise MeshError(f"results: the solver printed no {what}{f' of {of}' if of else ''}")
