"""What takes longer to measure: family by family, on the clock, and what it leaves to be drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from porous.measures import Findings, Sample, Survey, families
from porous.measures._together import taken
from porous.models.model import HasDoubts, HasLattice
from porous.scale.costs import SURFACE_VOXELS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from porous.measures import Census, LocalThickness
    from porous.models.model import Model
    from porous.recipe import Recipe
    from porous.values import VoxelGrid

    Progress = Callable[[str, float], None]

IN_MEMORY = (
    "full detail is measured of voxels in memory only; out of core the report has what passes over "
    "the tiles tell"
)

OF_MESHES = (
    "full detail is measured of voxels; of a surface or a mesh the report has what its triangles "
    "or elements tell"
)

NO_SURFACE = (
    f"no surface: images of more than {SURFACE_VOXELS} voxels are measured by these alone; "
    "porous make makes one"
)


BOXED = ("geometric_tortuosity", "succolarity", "connectivity_density", "pore_chord_mean")
"""Measures that want a bulk that is a box, as their names begin."""


class Surveyed(NamedTuple):
    """What was found, local thicknesses by phase, and each family's seconds, beside others."""

    findings: Findings
    maps: Mapping[str, LocalThickness]
    times: Mapping[str, float]


def how_of(recipe: Recipe, model: Model) -> Survey:
    """Return what a recipe asks a survey for."""
    cut = isinstance(model, HasLattice) or (isinstance(model, HasDoubts) and model.is_cut)
    beyond = "unknown" if cut else "void"
    given = recipe.report
    if given is None:
        return Survey(beyond, seed=recipe.seed)
    return Survey(
        beyond, given.probe, given.smallest_wall, given.smallest_gap, given.overhang, recipe.seed
    )


def surveyed(
    grid: VoxelGrid,
    census: Census | None,
    model: Model | None,
    how: Survey,
    progress: Progress | None,
) -> Surveyed:
    """Return what all families find out about a grid; each is told of under its own name.

    What has been counted of the grid already, the census tells.
    """
    sample = Sample(grid, census=census, model=model, how=how, progress=progress)
    each = taken(families(), sample)
    found = sum((one.findings for one in each.values()), Findings())
    found += Findings(notes=tuple(_untold(grid, found)))
    phases = ("pore", "solid") if sample.has_both else ()
    times = {name: one.seconds for name, one in each.items()}
    return Surveyed(found, {phase: sample.thickness(phase) for phase in phases}, times)


def _untold(grid: VoxelGrid, found: Findings) -> Iterator[str]:
    """Say what is missing for want of a box."""
    missing = [what for what in BOXED if not any(n.startswith(what) for n in found.measures.names)]
    if grid.bulk is not None and missing:
        words = ", ".join(what.replace("_", " ") for what in missing)
        yield f"the bulk is no box: not told of it are {words}"
