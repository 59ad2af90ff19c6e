"""Where a result comes from: recipe, versions, machine, times, and the size of what was made."""

from __future__ import annotations

import hashlib
import os
import platform
from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

from porous.recipe import dump, files
from porous.report._digits import number, unit_text
from porous.values import SurfaceMesh
from porous.values.job import PROPERTIES

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from porous.pipeline import Result
    from porous.stages import StreamedSurface
    from porous.values import Frame, Job, Material, Tiled, VolumeMesh

PACKAGES = (
    "porous",
    "numpy",
    "scipy",
    "numba",
    "scikit-image",
    "manifold3d",
    "pytetwild",
    "vtk",
    "plotly",
)
"""Whose versions can change a number."""

SHAPES = {
    "tet4": "tetrahedra",
    "tet10": "quadratic tetrahedra",
    "hex8": "hexahedra",
    "hex20": "quadratic hexahedra",
    "wed6": "wedges",
}


@dataclass(frozen=True)
class Provenance:
    """What the last section of the report tells."""

    recipe: str
    sha256: str
    seed: str
    source: str
    date: str
    made: tuple[tuple[str, str], ...]
    files: tuple[tuple[str, str], ...]
    threads: str
    times: tuple[tuple[str, str], ...]
    versions: Mapping[str, str]


def provenance(result: Result, folder: Path | None = None) -> Provenance:
    """Return where a result comes from, as text.

    Parameters
    ----------
    result
        What was made.
    folder
        Where the files are that its recipe reads, if they are not named in full.
    """
    recipe = result.recipe
    return Provenance(
        recipe=dump(recipe) if recipe else "",
        sha256=recipe.sha256 if recipe else "",
        seed=str(recipe.seed) if recipe else "",
        source=recipe.source if recipe else "",
        date=now(),
        made=tuple(_made(result)),
        files=(*_source(result), *_files(result, folder)),
        threads=str(len(os.sched_getaffinity(0))),
        times=tuple((stage, f"{seconds:.2f} s") for stage, seconds in result.times.items()),
        versions=versions(),
    )


def told(origin: Provenance) -> list[tuple[str, str]]:
    """Return what is said of where a result comes from, in its order."""
    said = [("made", origin.date)]
    if origin.recipe:
        said += [("recipe, SHA-256", origin.sha256), ("seed", origin.seed)]
    said += [(f"file {key}".strip(), value) for key, value in origin.files]
    said += [("threads there", origin.threads)]
    said += [(f"time for {stage}", spent) for stage, spent in origin.times]
    return [*said, *origin.versions.items()]


def title_of(result: Result) -> str:
    """Return the recipe's title, or what can be said without one."""
    if result.recipe is None:
        return f"Measures of {result.source.name if result.source else 'a body without a recipe'}"
    return result.recipe.title or f"A body of kind {result.recipe.model.kind}"  # type: ignore[attr-defined]


def versions() -> dict[str, str]:
    """Return the versions of Python, of this platform and of the packages that compute."""
    there = {"python": platform.python_version(), "platform": platform.platform()}
    for package in PACKAGES:
        try:
            there[package] = version(package)
        except PackageNotFoundError:
            there[package] = "not installed"
    return there


def now() -> str:
    """Return date and time."""
    return f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"


def _source(result: Result) -> Iterator[tuple[str, str]]:
    source = result.source
    if source is not None:
        hashed = f", SHA-256 {source.sha256}, {number(source.size)} bytes" if source.sha256 else ""
        yield "", f"{source.name}{hashed}"


def _files(result: Result, folder: Path | None) -> Iterator[tuple[str, str]]:
    """Yield the files that a recipe reads by key path, each with its SHA-256 where it is there."""
    for key, path in files(result.recipe).items() if result.recipe else ():
        where = path if path.is_absolute() or folder is None else folder / path
        if where.is_absolute() and where.is_file():
            with where.open("rb") as stream:
                yield (
                    key,
                    f"{path.name}, SHA-256 {hashlib.file_digest(stream, 'sha256').hexdigest()}",
                )
        else:
            yield key, path.name


def _made(result: Result) -> Iterator[tuple[str, str]]:
    if result.grid is not None:
        yield from _of_grid(result.grid)
    if result.surface is not None:
        yield "surface", _of_surface(result.surface)
    if result.volume is not None:
        yield "volume mesh", _of_volume(result.volume)
    if result.job is not None:
        yield "simulation", _of_job(result.job)


def _of_grid(grid: Tiled) -> Iterator[tuple[str, str]]:
    frame, unit = grid.frame, unit_text(grid.frame.unit)
    yield "voxels", f"{times(frame.shape)} = {number(frame.size)}, sampled as {grid.sampling}"
    yield "voxel size", f"{times(frame.spacing)} {unit}"
    yield "frame", f"{times(frame.box.lengths)} {unit}, {surroundings(frame)}"
    if grid.hausdorff is not None:
        yield "Hausdorff distance of voxels and set", f"≤ {grid.hausdorff:.4g} {unit}"


def times(values: tuple[float, ...]) -> str:
    """Return numbers with times signs between them."""
    return " × ".join(map(number, values))


def surroundings(frame: Frame) -> str:
    """Say what lies beyond the sides of a frame."""
    axes = [axis for axis, periodic in zip("xyz", frame.periodic, strict=True) if periodic]
    return f"periodic along {', '.join(axes)}" if axes else "in vacuum"


def _of_surface(surface: SurfaceMesh | StreamedSurface) -> str:
    if isinstance(surface, SurfaceMesh):
        triangles, points = len(surface.triangles), len(surface.points)
    else:
        triangles, points = surface.triangles, surface.points
    return f"{number(triangles)} triangles, {number(points)} points"


def _of_volume(mesh: VolumeMesh) -> str:
    counts: Counter[str] = Counter()
    for block in mesh.blocks:
        counts[SHAPES.get(block.shape, block.shape)] += len(block.cells)
    cells = ", ".join(f"{number(count)} {shape}" for shape, count in counts.items())
    cells += ", the model's own cells" if mesh.is_of_cells else ""
    volumes = mesh.volumes
    least = f"; smallest volume {volumes.min():.3g} {unit_text(mesh.unit)}³" if len(volumes) else ""
    return f"{cells}, {number(len(mesh.points))} nodes{least}"


def _of_job(job: Job) -> str:
    if not job.steps:
        return f"no step: {job.why_no_step}"
    made_of = "; ".join(map(_of_material, job.materials.values()))
    return f"{job.title}; {made_of}{'; ' if job.note else ''}{job.note}"


def _of_material(material: Material) -> str:
    known = {name: getattr(material, name) for name in PROPERTIES}
    told = ", ".join(f"{n} = {v:g}" for n, v in known.items() if v is not None)
    return f"{material.name}: {told} (mm, t, s, K)"
