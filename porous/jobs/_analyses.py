"""Which analyses there are: the folder is listed, nothing is registered."""

from __future__ import annotations

import pkgutil
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, get_args

from porous.errors import MeshError, RecipeError
from porous.jobs._section import SimulationSection
from porous.toml import shown

if TYPE_CHECKING:
    from collections.abc import Mapping

    from porous.values import Job, VolumeMesh

DEFAULT = "compression"
"""What is meant where a recipe does not name its analysis."""


@cache
def sections() -> Mapping[str, type[SimulationSection]]:
    """Return the ``[simulation]`` sections there are, by the analysis that each is of."""
    names = sorted(info.name for info in pkgutil.iter_modules([str(Path(__file__).parent)]))
    found = {name[1:]: _section_in(name) for name in names}
    return MappingProxyType({name: section for name, section in found.items() if section})


def section_of(table: object, name: str) -> type[SimulationSection]:
    """Return the section class of a ``[simulation]`` table.

    Raises
    ------
    RecipeError
        For what is no table, or an analysis that is not there; ``name`` is the recipe's.
    """
    if not isinstance(table, dict):
        got = shown(table)
        raise RecipeError(f"{name}: simulation: got {got}; wanted a table [simulation]")
    analysis = table.get("analysis", DEFAULT)
    if not isinstance(analysis, str) or analysis not in sections():
        wanted = ", ".join(f'"{one}"' for one in sections())
        raise RecipeError(
            f"{name}: simulation.analysis: got {shown(analysis)}; wanted one of {wanted}"
        )
    return sections()[analysis]


def prepare(mesh: VolumeMesh, section: SimulationSection) -> Job:
    """Return the job of an analysis on a mesh.

    Parameters
    ----------
    mesh
        With the parts that the analysis speaks of; in any unit.
    section
        One of ``sections()``, filled in.

    Returns
    -------
    Its mesh holds what bears load only; where nothing does it has no step and says why.

    Raises
    ------
    MeshError
        For a mesh without cells or without a part that is asked for; for a material that lacks
        what the analysis needs.
    RecipeError
        For a material that is not there or cannot be understood.
    """
    if not mesh.cells:
        raise MeshError(f"{_analysis(section)}: the mesh has no cells")
    job: Job = import_module(f"porous.jobs._{_analysis(section)}").prepare(mesh, section)
    _check_selected(job)
    return replace(job, system=section.units)


def _check_selected(job: Job) -> None:
    """Refuse a job that speaks of a part without members: a solver would do something else."""
    named = [*job.materials, *job.tied]
    for step in job.steps:
        named += [held.part for held in step.held] + [pressed.part for pressed in step.pressed]
    for name in named:
        part = job.mesh.parts[name]
        if not len(part.members):
            raise MeshError(f"job: the part {name!r} selects nothing; wanted some {part.kind}")


def _analysis(section: SimulationSection) -> str:
    return str(section.analysis)  # type: ignore[attr-defined]


def _section_in(module: str) -> type[SimulationSection] | None:
    for value in vars(import_module(f"porous.jobs.{module}")).values():
        if isinstance(value, type) and issubclass(value, SimulationSection):
            field = value.model_fields.get("analysis")
            if field is not None and get_args(field.annotation) == (module[1:],):
                return value
    return None
