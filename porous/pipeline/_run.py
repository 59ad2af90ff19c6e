"""The stages of a recipe in their order, in memory or beyond it."""

from __future__ import annotations

import builtins
import time
from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from porous.errors import RecipeError, nearest
from porous.measures import Survey
from porous.pipeline._rehearsal import rehearse
from porous.pipeline._result import Result
from porous.pipeline._stored import Place, StoredWork
from porous.pipeline._survey import IN_MEMORY, OF_MESHES, surveyed
from porous.pipeline._work import Work
from porous.scale import CHUNK
from porous.values import Tiled, VoxelGrid

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from porous.recipe import Recipe
    from porous.scale import StoredGrid
    from porous.values import SurfaceMesh, VolumeMesh
    from porous.values.tiled import Map

Progress = Callable[[str, float], None]

WANTED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "model": (),
        "voxels": ("voxels",),
        "surface": ("surface",),
        "volume": ("volume",),
        "simulation": ("volume", "simulation"),
        "measures": ("voxels", "surface"),
        "all": ("voxels", "surface", "volume", "simulation"),
    }
)
"""What ``only`` may be, and the stages it asks for; those that they need run besides."""

SURVEYED = (None, "all", "measures")
"""What ``only`` is where all is measured that the recipe asks for."""


def run(recipe: Recipe, *, only: str | None = None, progress: Progress | None = None) -> Result:
    """Run the stages of a recipe, in memory.

    Parameters
    ----------
    recipe
        What to make.
    only
        model, voxels, surface, volume, simulation or measures: run what that needs and no more.
    progress
        Called with the stage's name and its share done, from 0 to 1; raising in it cancels.

    Raises
    ------
    PorousError
        As the stages do: ``ModelError``, ``MemoryLimitError``, ``MeshError``, ``GuestError``, …
    """
    return _through(Work(recipe, progress), only)


def run_stored(
    recipe: Recipe,
    folder: Path,
    *,
    identity: str,
    begin: Callable[[], object],
    chunk: int = CHUNK,
    only: str | None = None,
    map: Map = builtins.map,  # noqa: A002
    progress: Progress | None = None,
) -> Result:
    """Run the stages of a recipe where its voxels and its surface need not fit into memory.

    Voxels go into the store ``grid.zarr`` and a surface of voxels into ``surface.stl``, tile by
    tile; the numbers are those that ``run`` gives. Of a store that is there already, begun by the
    same recipe, what is intact is kept. A volume mesh is made of a model's own cells or its exact
    boundary only, and where memory holds it.

    Parameters
    ----------
    recipe, only, progress
        As for ``run``.
    folder
        There already; nobody else may be writing to it.
    identity
        A hash, 64 hex digits, of the recipe and all that it reads: a store of another is refused.
    begin
        Called when the model stands, before anything is written.
    chunk
        Voxels along the edges of a stored chunk; a store that is there keeps its own.
    map
        How a function is called for every tile; like the builtin. It may hand them to other
        processes that see the same folder.

    Raises
    ------
    RecipeError
        Where the recipe asks for what is done in memory only, or the store is of another.
    PorousError
        As the stages and the store do.
    """
    _wanted(only)
    work = StoredWork(recipe, progress, Place(folder, identity, begin, chunk), map)
    return _through(work, only)


def _through(work: Work, only: str | None) -> Result:
    wanted = _wanted(only)
    if "simulation" in wanted:
        rehearse(work.recipe)
    work.build()
    if "voxels" in wanted:
        work.voxelize()
    if "surface" in wanted and not (only == "measures" and work.is_large_scan):
        work.extract_surface()
    if "volume" in wanted:
        work.fill_volume()
    if "simulation" in wanted:
        work.prepare_job()
    work.measure()
    if only in SURVEYED and work.recipe.detail == "full":
        work.survey()
    work.certify()
    return work.result()


def examine(
    value: VoxelGrid | StoredGrid | SurfaceMesh | VolumeMesh,
    *,
    detail: str = "brief",
    progress: Progress | None = None,
) -> Result:
    """Return the measures of a value that came from a file, as a result without a recipe.

    Parameters
    ----------
    value
        What to measure.
    detail
        brief or full: a grid in memory may be surveyed besides, as what was cut out of a larger
        body.
    progress
        As for ``run``.
    """
    from porous.measures import Census, measure, roughness_of_sides

    begin = time.perf_counter()
    census = Census(value) if isinstance(value, Tiled) else None
    measures = measure(census or value, progress=progress)
    if isinstance(value, Tiled):
        measures += roughness_of_sides(value)
    made = Result(None, measures=measures, times={"measures": time.perf_counter() - begin})
    made = replace(made, **{_FIELDS[type(value).__name__]: value})  # type: ignore[arg-type]
    if detail == "brief":
        return made
    if not isinstance(value, VoxelGrid):
        why = IN_MEMORY if isinstance(value, Tiled) else OF_MESHES
        return replace(made, notes=(*made.notes, why))
    found = surveyed(value, census, None, Survey(beyond="unknown"), progress)
    return replace(
        made,
        measures=measures + found.findings.measures,
        findings=found.findings,
        maps=found.maps,
        times={**made.times, **found.times},
    )


_FIELDS = {
    "VoxelGrid": "grid",
    "StoredGrid": "grid",
    "SurfaceMesh": "surface",
    "VolumeMesh": "volume",
}


def _wanted(only: str | None) -> tuple[str, ...]:
    if only is not None and only not in WANTED:
        raise RecipeError(f"--only: got {only!r}{nearest(only, WANTED)}")
    return WANTED[only or "all"]
