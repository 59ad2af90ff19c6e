"""What the totals of a solved job say of the material: effective tensors, reactions, heat flow."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError
from porous.formats._deck import FAR, set_name
from porous.guests.ccx import ENERGY, FORCE, HEAT
from porous.jobs._cubic import check_stresses
from porous.jobs._homogenisation import STRAINS
from porous.values import Measure, Measures
from porous.values.ties import ties
from porous.values.units import length_ratio, system_ratio

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from porous.values import Box, Job

    Totals = Mapping[tuple[str, str], tuple[float, ...]]

SINGULAR = 1e-9
"""Stiffness below this part of the greatest is none."""


def results(
    job: Job,
    totals: Sequence[Totals],
    frequencies: Sequence[float] = (),
    *,
    box: Box | None = None,
) -> Measures:
    """Return what a solver's totals come to.

    Of a periodic cell these are the effective stiffness (Voigt's order xx, yy, zz, yz, xz, xy, with
    γ = 2ε) and Young's moduli along the axes, 1 / (C⁻¹)ᵢᵢ, in MPa, or the effective conductivity in
    W/(m·K). The mean stress is Σₖ Fₖ ⊗ pₖ / V, with Fₖ the forces on the nodes that lie a period pₖ
    on and V the volume of the cell (virtual work of a uniform strain: Hill 1963, doi
    10.1016/0022-5096(63)90036-X). Of all else reactions in N, energies in N·mm, heat flows in mW,
    and natural frequencies in 1/s.

    No uncertainty is made up: that of the elements is not known from one mesh, and is NaN.

    Parameters
    ----------
    job
        As it was written into the deck.
    totals
        Of each step, by quantity and set, in the deck's units.
    frequencies
        In 1/s.
    box
        Of a periodic cell, in the mesh's unit; needed where nothing goes on along some of its axes,
        for then the mesh does not say how long it is there.

    Raises
    ------
    MeshError
        Where there are not as many totals as steps, or one that is needed is missing; where the
        stresses of two load cases are not those of a body with the symmetry of the cube.
    """
    if not frequencies and len(totals) != len(job.steps):
        raise MeshError(f"results: got totals of {len(totals)} steps; wanted {len(job.steps)}")
    kinds = dict.fromkeys(block.shape for block in job.mesh.blocks)
    method = f"finite elements {' and '.join(kinds)}, discretisation not included"
    rows = _rows(job, totals, frequencies, box)
    return Measures(
        tuple(
            Measure(name, value, unit, method, math.nan, "standard", "volume")
            for name, value, unit in rows
        )
    )


def _rows(
    job: Job, totals: Sequence[Totals], frequencies: Sequence[float], box: Box | None
) -> Iterator[tuple[str, float, str]]:
    for number, frequency in enumerate(frequencies, 1):
        yield f"natural_frequency_{number}", frequency, "1/s"
    if any(step.gradient for step in job.steps):
        thermal = job.steps[0].procedure == "conduction"
        mean = _mean_fluxes(job, totals, HEAT if thermal else FORCE, box)
        yield from _conductivity(job, mean[:, 0]) if thermal else _elastic(job, mean)
        return
    for step, found in zip(job.steps, totals, strict=False):
        if step.procedure == "static":
            yield from _mechanics(job, found)
        elif step.procedure == "conduction":
            heat = [abs(values[0]) for (what, _), values in found.items() if what == HEAT]
            yield "heat_flow", max(heat) / system_ratio(job.system, "power"), "mW"


def _mechanics(job: Job, found: Totals) -> Iterator[tuple[str, float, str]]:
    force, energy = (system_ratio(job.system, name) for name in ("force", "energy"))
    for (what, _), values in found.items():
        if what == FORCE:
            for axis, value in zip("xyz", values, strict=True):
                yield f"reaction_{axis}", value / force, "N"
            break
    for (what, _), values in found.items():
        if what == ENERGY:
            yield "strain_energy", values[0] / energy, "N·mm"


def _mean_fluxes(
    job: Job, totals: Sequence[Totals], what: str, box: Box | None
) -> NDArray[np.float64]:
    """Return the mean of each step, (steps, components, 3): stresses in MPa, or minus heat fluxes.

    Rows are components of what is balanced, columns the axes it flows along.
    """
    periods = ties(job.mesh, job.tied).periods * length_ratio(job.mesh.unit, "mm")
    volume = _volume(job, periods, box)
    unit = system_ratio(job.system, "power" if what == HEAT else "force")
    drive = []
    for step, found in zip(job.steps, totals, strict=True):
        try:
            drive.append([found[what, FAR + set_name(name)] for name in job.tied])
        except KeyError as error:
            raise MeshError(f"results: step {step.name!r} has no total {error}") from None
    return np.asarray(np.einsum("skc,kj->scj", np.array(drive) / unit, periods) / volume)


def _volume(job: Job, periods: NDArray[np.float64], box: Box | None) -> float:
    """Return the volume of the cell, in mm³: of its periods, and of the box where it has none."""
    if len(periods) == 3:
        return abs(float(np.linalg.det(periods)))
    if box is None:
        raise MeshError(
            f"results: got pairs {' and '.join(job.tied)} alone; wanted the box of the cell too, "
            "for nothing goes on along the other axes"
        )
    ends = ["xyz".index(axis) for axis in "xyz" if f"{axis.upper()}PAIRS" not in job.tied]
    lengths = np.array(box.lengths)[ends] * length_ratio(job.mesh.unit, "mm")
    edges = np.vstack([periods, np.eye(3)[ends] * lengths[:, None]])
    return abs(float(np.linalg.det(edges)))


def _conductivity(job: Job, flux: NDArray[np.float64]) -> Iterator[tuple[str, float, str]]:
    slopes = np.array([step.gradient for step in job.steps])
    if len(slopes) < len(job.tied):  # of a cubic body: all axes are as the first
        value = float(flux[0] @ slopes[0] / (slopes[0] @ slopes[0]))
        tensor = value * np.eye(3)
    else:
        tensor = (np.linalg.pinv(slopes) @ flux).T  # nothing along axes that nothing drives
    for index, axis in enumerate("xyz"):
        yield f"effective_conductivity_{axis}", float(tensor[index, index]), "W/(m·K)"
    for pair in ("yz", "xz", "xy") if len(slopes) == len(job.tied) else ():
        row, column = STRAINS[pair]
        both = float(tensor[row, column] + tensor[column, row])
        yield f"effective_conductivity_{pair}", both / 2, "W/(m·K)"


def _elastic(job: Job, stress: NDArray[np.float64]) -> Iterator[tuple[str, float, str]]:
    stiffness = _stiffness([step.name.rpartition("-")[2] for step in job.steps], stress)
    for i in range(6):
        for j in range(i, 6):
            yield f"effective_stiffness_{i + 1}{j + 1}", float(stiffness[i, j]), "MPa"
    for index, axis in enumerate("xyz"):
        yield f"effective_youngs_modulus_{axis}", _young(stiffness, index), "MPa"


def _stiffness(cases: list[str], stress: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrix (6, 6) whose columns are the stresses of the load cases."""
    places = list(STRAINS.values())
    voigt = np.array([[(mean[i, j] + mean[j, i]) / 2 for i, j in places] for mean in stress])
    if len(cases) == len(STRAINS):
        return np.asarray(voigt + voigt.T) / 2
    normal, shear = (voigt[cases.index(case)] for case in ("xx", "yz"))
    check_stresses(normal, shear)
    stiffness = np.zeros((6, 6))
    stiffness[:3, :3] = normal[1:3].mean()
    np.fill_diagonal(stiffness, [normal[0]] * 3 + [shear[3]] * 3)
    return stiffness


def _young(stiffness: NDArray[np.float64], axis: int) -> float:
    """Return 1 / (C⁻¹)ᵢᵢ; zero where a direction bears nothing, as across loose plates."""
    compliance = np.linalg.pinv(stiffness, rcond=SINGULAR)
    borne = (stiffness @ compliance)[:, axis]
    own = np.arange(6) == axis
    return float(1 / compliance[axis, axis]) if np.allclose(borne, own, atol=1e-6) else 0.0
