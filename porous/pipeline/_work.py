"""The stages of a recipe, one by one: what has been made so far, and the clock."""

from __future__ import annotations

import builtins
import time
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from porous.errors import GridError, GuestError, MemoryLimitError, MeshError, ModelError
from porous.measures import Findings
from porous.pipeline._result import Result
from porous.pipeline._survey import IN_MEMORY, NO_SURFACE, how_of, surveyed
from porous.recipe import build
from porous.scale.costs import SURFACE_VOXELS
from porous.values import Box, Measures, Part, VoxelGrid
from porous.values.box import SIDES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from porous.certificate import Certificate
    from porous.measures import Census, Journal, LocalThickness
    from porous.models.model import Model
    from porous.models.sections import CleanSection
    from porous.recipe import Recipe
    from porous.scale import StoredGrid
    from porous.stages import StreamedSurface
    from porous.values import Job, SurfaceMesh, VolumeMesh
    from porous.values.tiled import Map

    Progress = Callable[[str, float], None]

T = TypeVar("T")

TETWILD_TRIANGLES = 20_000
"""Triangles of a surface up to which ``auto`` asks tetwild; beyond, one hexahedron per voxel."""


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
        solid = Part("cells", np.arange(mesh.cells))
        return replace(mesh, parts={"SOLID": solid, **mesh.parts})
    box = Box(tuple(mesh.points.min(axis=0)), tuple(mesh.points.max(axis=0)))
    return replace(mesh, parts={**name_parts(mesh, box).parts, **mesh.parts})


def _part(progress: Progress | None, index: int, count: int) -> Progress:
    """Return what reports the progress of one task of several."""

    def report(stage: str, done: float) -> None:
        if progress is not None:
            progress(stage, (index + done) / count)

    return report


class Work:
    """One run under way: what has been made so far, and the clock."""

    map: Map = staticmethod(builtins.map)
    """How a function is called for every tile of what is measured."""

    def __init__(self, recipe: Recipe, progress: Progress | None) -> None:
        self.recipe = recipe
        self.progress = progress
        self.times: dict[str, float] = {}
        self.notes: list[str] = []
        self.grid: VoxelGrid | StoredGrid | None = None
        self.surface: SurfaceMesh | None = None
        self.streamed: StreamedSurface | None = None
        self.volume: VolumeMesh | None = None
        self.job: Job | None = None
        self.measures = Measures()
        self.census: Census | None = None
        self.findings, self.maps = Findings(), dict[str, "LocalThickness"]()
        self.certificate: Certificate | None = None
        self.is_exact = self.is_cleaned = False
        self.filled = ""

    def build(self) -> None:
        from porous.models.model import HasNotes

        self.model: Model = self._timed("model", lambda _: build(self.recipe))
        self.notes += self.model.notes if isinstance(self.model, HasNotes) else ()

    def voxelize(self) -> None:
        self.grid = self._timed("voxels", self._voxels)
        if self.grid.sampling == "cover":
            self.notes.append(
                "the voxels cover the set: volume, area and topology are those of its cover, not "
                "of the set itself; an offset makes material of it"
            )
        if self.recipe.clean is not None:
            self._clean(self.recipe.clean)

    def _clean(self, how: CleanSection) -> None:
        from porous.stages import clean

        assert isinstance(self.grid, VoxelGrid)
        given, wanted = self.grid, {"islands": how.islands, "closed_pores": how.closed_pores}
        made = self._timed("clean", lambda report: clean(given, **wanted, progress=report))
        self.grid, self.is_cleaned = made.grid, made.is_changed
        self.notes += map(str, made.steps)
        if self.is_cleaned:
            self.notes.append("all measures are of the cleaned voxels, and of what is made of them")

    def _voxels(self, progress: Progress | None) -> VoxelGrid | StoredGrid:
        from porous.stages import voxelize

        return voxelize(self.model, **self._lattice, sampling=self._sampling, progress=progress)

    @property
    def _lattice(self) -> dict[str, Any]:
        """What the recipe says of the lattice of voxels."""
        how = self.recipe.voxels
        names = ("voxels", "spacing", "per_feature", "periodic", "cubic")
        return {name: getattr(how, name) for name in names}

    @property
    def _sampling(self) -> str:
        return self.recipe.voxels.sampling or "fill"

    @property
    def is_large_scan(self) -> bool:
        """Whether this is an image of so many voxels that its numbers are taken of these alone.

        Triangles over binary voxels tell less than lines through them, and take longest of all.
        """
        is_image = self.recipe.model.kind == "image"  # type: ignore[attr-defined]
        if self.grid is None or not is_image or self.grid.frame.size <= SURFACE_VOXELS:
            return False
        self.notes.append(NO_SURFACE)
        return True

    def extract_surface(self) -> None:
        method = self.recipe.surface.method
        # Steps to smooth and edges cut off are those of voxels.
        how = self.recipe.surface
        of_voxels = how.smooth or how.volume == "fills"
        if method == "exact" or (method == "auto" and not of_voxels):
            self._exact_surface(required=method == "exact")
        if self.surface is None:
            self._voxel_surface()
        if self.surface is not None:
            self._alter_surface(self.surface)

    def _voxel_surface(self) -> None:
        from porous.stages import extract_surface

        method = self.recipe.surface.method
        method = "marching-cubes" if method == "auto" else method
        grid = self._solid_grid()
        self.surface = self._timed(
            "surface", lambda progress: extract_surface(grid, method=method, progress=progress)
        )

    def _alter_surface(self, made: SurfaceMesh) -> None:
        from porous.stages import simplify, smooth

        how, smoothed = self.recipe.surface, made
        wanted = self._fills_volume() if how.volume == "fills" else None
        if how.smooth or wanted is not None:
            smoothed = self.surface = self._timed(
                "smooth",
                lambda report: smooth(made, iterations=how.smooth, volume=wanted, progress=report),
            )
            what = f"smoothed in {how.smooth} steps" if how.smooth else "moved"
            what += " to the volume of the fills" if wanted is not None else ""
            self.notes.append(_told(what, made, smoothed))
        if how.simplify < 1:
            self.surface = self._timed(
                "simplify", lambda report: simplify(smoothed, keep=how.simplify, progress=report)
            )
            share = len(self.surface.triangles) / len(smoothed.triangles)
            what = f"simplified to {share:.2%} of its triangles"
            if share > 1.01 * how.simplify:
                what += ", for fewer would not keep its topology and volume"
            self.notes.append(_told(what, smoothed, self.surface))

    def _fills_volume(self) -> float:
        from porous.measures import volume

        return volume(self._solid_grid()).value

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
        """Whether the model alone is the body: no voxels that touch it or are mended, no tile."""
        how = self.recipe.voxels
        return how.sampling != "cover" and not any(how.periodic) and self.recipe.clean is None

    def fill_volume(self) -> None:
        method = self.recipe.volume.method
        auto = method == "auto"
        if auto and self._are_cells_periodic:
            self.volume = self._periodic_cells()
        why = self._needs_voxels if auto and self.volume is None else ""
        if why:
            method, auto = "voxel-hex", False
        if self.volume is None and (auto or method == "cells"):
            self.volume = self._cells(required=not auto)
        if self.volume is None and (auto or method == "tetwild"):
            self.volume = self._tetrahedra(required=not auto)
        if self.volume is None and (auto or method == "voxel-hex"):
            self.volume = self._hexahedra()
        if why and self.volume is not None:
            self.notes.append(f"auto took voxel-hex, one hexahedron per voxel: {why}")
        if self.volume is not None:
            self.volume = self._timed("volume", partial(self._refined, self.volume))

    @property
    def _needs_voxels(self) -> str:
        """Why nobody but voxels serves who leaves the choice, or nothing."""
        if self.recipe.phase != "solid":
            return 'they mesh pores as they do solids; tetrahedra do with volume.method = "tetwild"'
        if any(self.recipe.voxels.periodic):
            return "opposite sides of a periodic body then have the same nodes"
        return ""

    @property
    def _are_cells_periodic(self) -> bool:
        """Whether the model's own cells may be what goes on in copies of itself."""
        from porous.models.model import HasCells

        how, recipe = self.recipe.voxels, self.recipe
        alone = how.sampling != "cover" and recipe.clean is None and recipe.phase == "solid"
        return any(how.periodic) and alone and isinstance(self.model, HasCells)

    def _periodic_cells(self) -> VolumeMesh | None:
        """Return the model's own cells with their pairs, or None where they do not go on."""
        from porous.stages import mesh_cells, periodic_pairs

        try:
            mesh = self._timed("volume", lambda _: mesh_cells(self.model))
            mesh = periodic_pairs(mesh, axes=self.recipe.voxels.periodic)
        except (MeshError, ModelError, MemoryLimitError) as error:
            self.notes.append(f"volume not of the model's cells: {error}")
            return None
        self.filled = "cells"
        return _with_sides(mesh)

    def _refined(self, mesh: VolumeMesh, _: Progress | None) -> VolumeMesh:
        """Return the mesh with the sets and the nodes that the recipe wants besides."""
        from porous.stages import branches, quadratic

        how = self.recipe.volume
        if how.branches:
            mesh = branches(mesh, self.model, length=how.branches)
        return quadratic(mesh) if how.order == 2 else mesh

    def _cells(self, *, required: bool) -> VolumeMesh | None:
        """Return the model's own cells, or None where nobody insists and there are none."""
        from porous.models.model import HasCells
        from porous.stages import mesh_cells, periodic_pairs

        if not required and not (self._is_whole and isinstance(self.model, HasCells)):
            return None
        if self.recipe.phase != "solid":
            raise ModelError(
                f'volume.method: got "cells", which are solid; phase = "{self.recipe.phase}" '
                'wanted "voxel-hex" or "tetwild"'
            )
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
        periodic = self.recipe.voxels.periodic
        try:
            mesh = periodic_pairs(mesh, axes=periodic) if any(periodic) else mesh
        except MeshError as error:
            self.notes.append(f"the cells have no pairs of nodes: {error}")
        return _with_sides(mesh)

    def _tetrahedra(self, *, required: bool) -> VolumeMesh | None:
        """Return the mesh, or None where nobody insists on it and it is too much or fails."""
        from porous.stages import Finer, name_parts

        if self.surface is None:
            self.extract_surface()
        surface, how = self.surface, self.recipe.volume
        assert surface is not None
        if any(surface.altered):
            self._solid_grid()  # says how far off a mesh of it may be
        count = len(surface.triangles)
        if not required and count > TETWILD_TRIANGLES:
            self.notes.append(
                f"auto took voxel-hex, one hexahedron per solid voxel: the surface has {count} "
                f"triangles; tetrahedra are made unasked up to {TETWILD_TRIANGLES}, beyond with "
                'volume.method = "tetwild"'
            )
            return None
        try:
            mesh = self._timed(
                "volume",
                lambda progress: self._mesher(surface)(
                    edge_length=how.edge_length,
                    sizing=[Finer(part.box(), part.edge_length) for part in how.finer],
                    time_limit=how.time_limit,
                    progress=progress,
                ),
            )
        except GuestError as error:
            if required:
                raise
            self.notes.append(f"auto took voxel-hex, one hexahedron per solid voxel: {error}")
            return None
        self.filled = "surface"
        return name_parts(mesh, self.model.domain)

    def _mesher(self, surface: SurfaceMesh) -> Callable[..., VolumeMesh]:
        """Return what fills a surface, or the box about it, with tetrahedra of the phase."""
        from porous.models.model import HasBulk
        from porous.stages import phase_alone, tetrahedralize, tetrahedralize_phases

        phase = self.recipe.phase
        if phase == "solid":
            return partial(tetrahedralize, surface)
        if isinstance(self.model, HasBulk):
            raise ModelError(
                f'volume.method: got "tetwild", which meshes the pores of a box; the bulk of this '
                f'model is another body. For phase = "{phase}" wanted "voxel-hex"'
            )
        inside = self.model.bulk.contains(surface.box, tolerance=1e-9 * max(surface.box.lengths))
        box = self.model.bulk if inside else self.model.domain
        if phase == "both":
            return partial(tetrahedralize_phases, surface, box)
        return lambda **how: phase_alone(tetrahedralize_phases(surface, box, **how), phase)

    def _hexahedra(self) -> VolumeMesh | None:
        from porous.stages import hexahedralize, name_parts

        grid = self._solid_grid()
        mesh = self._timed("volume", lambda _: hexahedralize(grid, phase=self.recipe.phase))
        self.filled = "grid"
        return name_parts(mesh, self.model.domain)

    def prepare_job(self) -> None:
        from porous.jobs import prepare

        how = self.recipe.simulation
        if how is None or self.volume is None:
            return
        self.job = prepare(self.volume, how)
        if not self.job.steps:
            self.notes.append(f"no step in the deck: {self.job.why_no_step}")
        if self.job.note:
            self.notes.append(self.job.note)

    def measure(self) -> None:
        from porous.measures import measure

        tasks = [task for task in self._tasks() if task[0] is not None]

        def take(progress: Progress | None) -> Measures:
            taken = Measures()
            for index, (subject, sources) in enumerate(tasks):
                report = _part(progress, index, len(tasks))
                report("measures", 0.0)
                taken += measure(subject, progress=report, **sources)
            return taken

        self.measures = self._timed("measures", take)

    def survey(self) -> None:
        """Measure what takes longer; what the grid was cleaned of is not the model's any more."""
        if not isinstance(self.grid, VoxelGrid):
            self.notes.append(IN_MEMORY)
            return
        model, how = None if self.is_cleaned else self.model, how_of(self.recipe, self.model)
        found = surveyed(self.grid, self.census, model, how, self.progress)
        self.findings, self.maps = found.findings, dict(found.maps)
        self.measures += found.findings.measures
        self.times |= found.times

    def _tasks(self) -> Iterator[tuple[Any, dict[str, Any]]]:
        """Yield what is to be measured, if it was made, and what that was made from.

        The latter says how far off its numbers may be.
        """
        self.census = self._census()
        of_model, of_grid = {"model": self.model}, {"model": self.model, "grid": self.census}
        of_surface = of_model if self.is_exact else of_grid
        altered = self.surface is not None and any(self.surface.altered)
        of_filled = of_grid if altered else of_surface
        # Cells are made from no grid; but whether they are cut from a periodic body it says.
        of_cells = of_grid if any(self.recipe.voxels.periodic) else of_model
        of_volume = {"cells": of_cells, "surface": of_filled, "grid": of_grid}
        # What is known of the model is not of what it was cleaned to.
        yield None if self.is_cleaned else self.model, {"grid": of_grid["grid"]}
        yield of_grid["grid"], of_model
        yield self.surface or self.streamed, of_surface
        yield self.volume, of_volume.get(self.filled, {})

    def _census(self) -> Census | None:
        """Return what counts the grid."""
        from porous.measures import Census
        from porous.models.model import HasBulk

        if self.grid is None:
            return None
        is_sampled = isinstance(self.model, HasBulk)
        return Census(self.grid, sampled=is_sampled, map=self.map, journal=self._journal())

    def _journal(self) -> Journal | None:
        """Return where counts are written down, for who is killed to count on."""
        return None

    def certify(self) -> None:
        from porous.certificate import certify

        things = (self.model, self.grid, self.surface or self.streamed, self.volume)
        self.certificate = self._timed(
            "certificate", lambda _: certify(*things, measures=self.measures)
        )

    def result(self) -> Result:
        return Result(
            self.recipe,
            self.model,
            self.grid,
            self.surface or self.streamed,
            self.volume,
            self.job,
            self.measures,
            self.certificate,
            self.times,
            tuple(self.notes),
            self.findings,
            self.maps,
        )

    def _solid_grid(self) -> VoxelGrid:
        """Return the grid, made now if it was not asked for, or refuse one without a body."""
        if self.grid is None:
            self.voxelize()
        assert isinstance(self.grid, VoxelGrid)
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
