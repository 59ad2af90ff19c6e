"""A recipe from end to end: the stages in order, what each cost, and what is known in the end."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

from porous.errors import (
    GridError,
    GuestError,
    MemoryLimitError,
    MeshError,
    ModelError,
    RecipeError,
    nearest,
)
from porous.recipe import build
from porous.values import Box, Measures
from porous.values.box import SIDES
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from porous.certificate import Certificate
    from porous.models.model import Model
    from porous.recipe import Recipe
    from porous.values import Job, SurfaceMesh, VolumeMesh, VoxelGrid

    Progress = Callable[[str, float], None]

T = TypeVar("T")

TETWILD_TRIANGLES = 20_000
"""Triangles of a surface up to which ``auto`` asks tetwild; beyond, one hexahedron per voxel."""

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


@dataclass(frozen=True, eq=False)
class Result(Value):
    """What came of a recipe; None where a stage was not asked for.

    Parameters
    ----------
    recipe, model
        What was asked for.
    grid, surface, volume, job
        What the stages made.
    measures
        Of all of these; closed forms beside what was measured.
    certificate
        Model, grid, surface and mesh held against each other.
    times
        Seconds that each stage took.
    notes
        What was decided on the way and what the user should know.
    """

    recipe: Recipe | None
    model: Model | None = None
    grid: VoxelGrid | None = None
    surface: SurfaceMesh | None = None
    volume: VolumeMesh | None = None
    job: Job | None = None
    measures: Measures = field(default_factory=Measures)
    certificate: Certificate | None = None
    times: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self._set("times", MappingProxyType(dict(self.times)))
        self._set("notes", tuple(self.notes))


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
    wanted = _wanted(only)
    work = _Work(recipe, progress)
    work.build()
    if "voxels" in wanted:
        work.voxelize()
    if "surface" in wanted:
        work.extract_surface()
    if "volume" in wanted:
        work.fill_volume()
    if "simulation" in wanted:
        work.prepare_job()
    work.measure()
    work.certify()
    return work.result()


def examine(value: VoxelGrid | SurfaceMesh | VolumeMesh) -> Result:
    """Return the measures of a value that came from a file, as a result without a recipe."""
    from porous.measures import measure

    begin = time.perf_counter()
    measures = measure(value)
    made = Result(None, measures=measures, times={"measures": time.perf_counter() - begin})
    return replace(made, **{_FIELDS[type(value).__name__]: value})  # type: ignore[arg-type]


_FIELDS = {"VoxelGrid": "grid", "SurfaceMesh": "surface", "VolumeMesh": "volume"}


def _wanted(only: str | None) -> tuple[str, ...]:
    if only is not None and only not in WANTED:
        raise RecipeError(f"--only: got {only!r}{nearest(only, WANTED)}")
    return WANTED[only or "all"]


def _no_cells(recipe: Recipe, model: Model) -> str:
    from porous.models.model import HasBoundary

    kind = recipe.model.kind  # type: ignore[attr-defined]
    has = "an exact boundary and voxels" if isinstance(model, HasBoundary) else "voxels"
    return (
        f'volume.method: got "cells"; a model of kind {kind} has {has}, but no cells that are a '
        'mesh. Wanted "tetwild" or "voxel-hex"'
    )


def _told(what: str, before: SurfaceMesh, after: SurfaceMesh) -> str:
    """Return a note on a step that altered a surface and kept its topology."""
    return (
        f"surface {what}: volume {before.volume:.6g} → {after.volume:.6g} {after.unit}³, area "
        f"{before.area:.6g} → {after.area:.6g} {after.unit}²; closed, of the same topology"
    )


def _with_sides(mesh: VolumeMesh) -> VolumeMesh:
    """Return a mesh of cells with parts for the sides of its box, where it names no sides.

    A bent block's sides are faces of its level-0 cell; of a tetrahedron's none is XMIN.
    """
    from porous.stages import name_parts

    if any(side in mesh.parts for side in SIDES):
        return mesh
    box = Box(tuple(mesh.points.min(axis=0)), tuple(mesh.points.max(axis=0)))
    return replace(mesh, parts={**name_parts(mesh, box).parts, **mesh.parts})


class _Work:
    """One run under way: what has been made so far, and the clock."""

    def __init__(self, recipe: Recipe, progress: Progress | None) -> None:
        self.recipe = recipe
        self.progress = progress
        self.times: dict[str, float] = {}
        self.notes: list[str] = []
        self.grid: VoxelGrid | None = None
        self.surface: SurfaceMesh | None = None
        self.volume: VolumeMesh | None = None
        self.job: Job | None = None
        self.measures = Measures()
        self.certificate: Certificate | None = None
        self.is_exact = False
        self.filled = ""

    def build(self) -> None:
        self.model: Model = self._timed("model", lambda _: build(self.recipe))

    def voxelize(self) -> None:
        from porous.stages import voxelize

        how = self.recipe.voxels
        self.grid = self._timed(
            "voxels",
            lambda progress: voxelize(
                self.model,
                voxels=how.voxels,
                spacing=how.spacing,
                per_feature=how.per_feature,
                sampling=how.sampling or "fill",
                periodic=how.periodic,
                cubic=how.cubic,
                progress=progress,
            ),
        )

        if self.grid.sampling == "cover":
            self.notes.append(
                "the voxels cover the set: volume, area and topology are those of its cover, not "
                "of the set itself; an offset makes material of it"
            )

    def extract_surface(self) -> None:
        from porous.stages import extract_surface

        method = self.recipe.surface.method
        # Steps to smooth are those of voxels.
        if method == "exact" or (method == "auto" and not self.recipe.surface.smooth):
            self._exact_surface(required=method == "exact")
        if self.surface is None:
            method = "marching-cubes" if method == "auto" else method
            grid = self._solid_grid()
            self.surface = self._timed(
                "surface", lambda progress: extract_surface(grid, method=method, progress=progress)
            )
        self._alter_surface()

    def _alter_surface(self) -> None:
        from porous.stages import simplify, smooth

        how, made = self.recipe.surface, self.surface
        assert made is not None
        if how.smooth:
            self.surface = self._timed(
                "smooth", lambda report: smooth(made, iterations=how.smooth, progress=report)
            )
            self.notes.append(_told(f"smoothed in {how.smooth} steps", made, self.surface))
        smoothed = self.surface
        assert smoothed is not None
        if how.simplify < 1:
            self.surface = self._timed(
                "simplify", lambda report: simplify(smoothed, keep=how.simplify, progress=report)
            )
            share = len(self.surface.triangles) / len(smoothed.triangles)
            what = f"simplified to {share:.2%} of its triangles"
            if share > 1.01 * how.simplify:
                what += ", for fewer would not keep its topology and volume"
            self.notes.append(_told(what, smoothed, self.surface))

    def _exact_surface(self, *, required: bool) -> None:
        from porous.models.model import HasBoundary
        from porous.stages import exact_surface

        if not required and not (self._is_whole and isinstance(self.model, HasBoundary)):
            return
        try:
            self.surface = self._timed("surface", lambda _: exact_surface(self.model))
        except (ModelError, MeshError, MemoryLimitError, GuestError) as error:
            if required or (self._wants_cells and isinstance(error, ModelError)):
                raise
            self.notes.append(f"surface from voxels: {error}")
        else:
            self.is_exact = True

    @property
    def _wants_cells(self) -> bool:
        """Whether the mesh is to be the model's own cells: then what is wrong with them is."""
        from porous.models.model import HasCells

        asked = self.recipe.volume.method in ("auto", "cells")
        return asked and self._is_whole and isinstance(self.model, HasCells)

    @property
    def _is_whole(self) -> bool:
        """Whether the model alone is the body, not voxels that touch it or a tile of many."""
        how = self.recipe.voxels
        return how.sampling != "cover" and not any(how.periodic)

    def fill_volume(self) -> None:
        method = self.recipe.volume.method
        auto = method == "auto"
        if auto or method == "cells":
            self.volume = self._cells(required=not auto)
        if self.volume is None and (auto or method == "tetwild"):
            self.volume = self._tetrahedra(required=not auto)
        if self.volume is None and (auto or method == "voxel-hex"):
            self.volume = self._hexahedra()

    def _cells(self, *, required: bool) -> VolumeMesh | None:
        """Return the model's own cells, or None where nobody insists and there are none."""
        from porous.models.model import HasCells
        from porous.stages import mesh_cells

        if not required and not (self._is_whole and isinstance(self.model, HasCells)):
            return None
        if not isinstance(self.model, HasCells):
            raise ModelError(_no_cells(self.recipe, self.model))
        try:
            mesh = self._timed("volume", lambda _: mesh_cells(self.model))
        except (MeshError, MemoryLimitError) as error:
            if required:
                raise
            self.notes.append(f"volume not of the model's cells: {error}")
            return None
        self.filled = "cells"
        return _with_sides(mesh)

    def _tetrahedra(self, *, required: bool) -> VolumeMesh | None:
        """Return the mesh, or None where nobody insists on it and it is too much or fails."""
        from porous.stages import name_parts, tetrahedralize

        if self.surface is None:
            self.extract_surface()
        surface, how = self.surface, self.recipe.volume
        assert surface is not None
        if any(surface.altered):
            self._solid_grid()  # says how far off a mesh of it may be
        count = len(surface.triangles)
        if not required and count > TETWILD_TRIANGLES:
            self.notes.append(
                f"one hexahedron per solid voxel: the surface has {count} triangles; tetrahedra "
                f"are made unasked up to {TETWILD_TRIANGLES}, beyond with "
                'volume.method = "tetwild"'
            )
            return None
        try:
            mesh = self._timed(
                "volume",
                lambda progress: tetrahedralize(
                    surface, edge_length=how.edge_length, progress=progress
                ),
            )
        except GuestError as error:
            if required:
                raise
            self.notes.append(f"one hexahedron per solid voxel: {error}")
            return None
        self.filled = "surface"
        return name_parts(mesh, self.model.domain)

    def _hexahedra(self) -> VolumeMesh:
        from porous.stages import hexahedralize, name_parts

        grid = self._solid_grid()
        mesh = self._timed("volume", lambda _: hexahedralize(grid))
        self.filled = "grid"
        return name_parts(mesh, self.model.domain)

    def prepare_job(self) -> None:
        from porous.jobs import compression, material

        how = self.recipe.simulation
        if how is None or self.volume is None:
            return
        self.job = compression(self.volume, material=material(how.material), pressure=how.pressure)
        if self.job.step is None:
            self.notes.append(f"no step in the deck: {self.job.why_no_step}")
        if self.job.note:
            self.notes.append(self.job.note)

    def measure(self) -> None:
        from porous.measures import measure

        # What the surface and the mesh were made from says how far off their numbers may be.
        of_model, of_grid = {"model": self.model}, {"model": self.model, "grid": self.grid}
        of_surface = of_model if self.is_exact else of_grid
        altered = self.surface is not None and any(self.surface.altered)
        of_filled = of_grid if altered else of_surface
        of_volume = {"cells": of_model, "surface": of_filled, "grid": of_grid}
        tasks = [
            (subject, source)
            for subject, source in (
                (self.model, {"grid": self.grid}),
                (self.grid, of_model),
                (self.surface, of_surface),
                (self.volume, of_volume.get(self.filled, {})),
            )
            if subject is not None
        ]

        def take(progress: Progress | None) -> Measures:
            taken = Measures()
            for index, (subject, source) in enumerate(tasks):
                if progress is not None:
                    progress("measures", index / len(tasks))
                taken += measure(subject, **source)
            return taken

        self.measures = self._timed("measures", take)

    def certify(self) -> None:
        from porous.certificate import certify

        things = (self.model, self.grid, self.surface, self.volume)
        self.certificate = self._timed(
            "certificate", lambda _: certify(*things, measures=self.measures)
        )

    def result(self) -> Result:
        return Result(
            self.recipe,
            self.model,
            self.grid,
            self.surface,
            self.volume,
            self.job,
            self.measures,
            self.certificate,
            self.times,
            tuple(self.notes),
        )

    def _solid_grid(self) -> VoxelGrid:
        """Return the grid, made now if it was not asked for, or refuse one without a body."""
        if self.grid is None:
            self.voxelize()
        assert self.grid is not None
        if not self.grid.solid.any():
            raise GridError(
                f"voxels: none of the {self.grid.frame.size} voxels is solid; wanted a finer grid "
                'or model.offset, or sampling = "cover"'
            )
        return self.grid

    def _timed(self, stage: str, step: Callable[[Progress | None], T]) -> T:
        """Run one stage on the clock; what it reports is reported under the stage's name."""
        report = self.progress

        def inside(_: str, done: float) -> None:
            assert report is not None
            report(stage, min(done, 0.999))

        inner = None if report is None else inside
        if report is not None:
            report(stage, 0.0)
        begin = time.perf_counter()
        value = step(inner)
        self.times[stage] = self.times.get(stage, 0.0) + time.perf_counter() - begin
        if report is not None:
            report(stage, 1.0)
        return value
