"""Where a result comes from: recipe, versions, machine, times, and the size of what was made."""

from __future__ import annotations

import platform
from collections import Counter
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

from porous.recipe import dump
from porous.report._agreement import number
from porous.values import SurfaceMesh
from porous.values.job import PROPERTIES

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from porous.pipeline import Result
    from porous.stages import StreamedSurface
    from porous.values import Frame, Job, Material, Tiled, VolumeMesh

PACKAGES = ("porous", "numpy", "scipy", "numba", "scikit-image", "manifold3d", "pytetwild", "vtk")
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
    made: tuple[tuple[str, str], ...]
    times: tuple[tuple[str, str], ...]
    versions: Mapping[str, str]


def provenance(result: Result) -> Provenance:
    """Return where a result comes from, as text."""
    recipe = result.recipe
    return Provenance(
        recipe=dump(recipe) if recipe else "",
        sha256=recipe.sha256 if recipe else "",
        seed=str(recipe.seed) if recipe else "",
        source=recipe.source if recipe else "",
        made=tuple(_made(result)),
        times=tuple((stage, f"{seconds:.2f} s") for stage, seconds in result.times.items()),
        versions=versions(),
    )


def title_of(result: Result) -> str:
    """Return the recipe's title, or what can be said without one."""
    if result.recipe is None:
        return "Measures of a body without a recipe"
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
    frame = grid.frame
    yield "voxels", f"{_times(frame.shape)} = {number(frame.size)}, sampled as {grid.sampling}"
    yield "voxel size", f"{_times(frame.spacing)} {frame.unit}"
    yield "frame", f"{_times(frame.box.lengths)} {frame.unit}, {_surroundings(frame)}"
    if grid.hausdorff is not None:
        yield "Hausdorff distance of voxels and set", f"≤ {grid.hausdorff:.4g} {frame.unit}"


def _times(values: tuple[float, ...]) -> str:
    return " × ".join(map(number, values))


def _surroundings(frame: Frame) -> str:
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
    least = f"; smallest volume {volumes.min():.3g} {mesh.unit}³" if len(volumes) else ""
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
