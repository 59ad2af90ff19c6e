"""What each stage of a recipe takes, by how much of everything there will be.

How many solid voxels and triangles there will be is told by a trial (``scale.trial``) or, of exact
boundaries and cells, counted. Memory and time follow by rates that were measured: see ``RATES``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

from porous.errors import PorousError
from porous.memory import available
from porous.models.automaton import count_cells
from porous.models.cell_nodes import BYTES_PER_CELL
from porous.models.cell_system import CellSystem
from porous.models.counts import boundary_count
from porous.models.model import HasBoundary, HasCells
from porous.scale.store import CHUNK
from porous.scale.stored_grid import KEPT
from porous.scale.trial import Trial, try_out
from porous.stages import SampledModel, fit_frame
from porous.stages._clean import BYTES as CLEAN_BYTES
from porous.stages._sampled import MASK_BYTES, TILE
from porous.stages._simplify import BYTES as SIMPLIFY_BYTES
from porous.stages._smooth import BYTES as SMOOTH_BYTES
from porous.stages._stream_surface import BYTES as STREAM_BYTES
from porous.stages._stream_surface import MOST_READ
from porous.stages._stream_surface import TRIANGLES as STREAM_TRIANGLES
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Mapping

    from porous.models.model import Model
    from porous.recipe import Recipe
    from porous.values import Frame

TETWILD_TRIANGLES = 20_000
"""Triangles up to which tetrahedra are made unasked, as the pipeline has it."""
OVERHEAD = 240 << 20
"""Bytes of libraries and compiled kernels that come into memory on the way, and of small things."""
PICTURE = 520 << 20
"""Bytes of the process that draws the report's picture, of a small scene."""
MOST_CELLS = 100_000
"""Cells of a model up to which its voxels are tried out: more take too long to make."""
SURFACE_VOXELS = 1 << 25
"""Voxels of an image up to which a surface is made of it to be measured, as the pipeline has it."""
GRID_TILE = 1 << 26
"""Voxels that are measured at once."""
SURVEYED = 1 << 24
"""Voxels up to which all families of a survey take them all; beyond, some take coarser ones."""
SEAM, SEAM_PIECES = 80, 500
"""Bytes that a voxel at the border of a tile takes until its neighbours are measured: where there
is little surface, and how much more where there is a triangle for every voxel."""
TETRAHEDRA = 80_000
"""Tetrahedra that a surface of any number of triangles may have besides one for each."""
GUEST = 250 << 20
"""Bytes of the process that makes tetrahedra, of a small surface."""


class Rate(NamedTuple):
    """What a unit (a voxel, a triangle, a cell) takes of memory, of disk, and of time."""

    work: float = 0.0
    """Bytes at the peak, beyond what was there before."""
    kept: float = 0.0
    """Bytes that stay."""
    disk: float = 0.0
    seconds: float = 0.0


RATES: dict[str, Rate] = {
    # Peaks of the resident set and times stage by stage, on two cores at 2.5 GHz shared with
    # others: Menger of levels 3 to 5 at 81³ … 486³, Koch, Sierpinski, a fern, bent cells.
    "cleaned": Rate(work=CLEAN_BYTES, seconds=30e-9),  # a voxel
    "marching cubes": Rate(work=44, kept=44, seconds=0.3e-6),  # a triangle
    "exact boundary": Rate(work=700, kept=60, seconds=1e-4),  # a triangle
    "boundary of cells": Rate(work=400, kept=250, seconds=1e-5),  # a triangle
    "hexahedra": Rate(work=260, kept=220, seconds=1.0e-6),  # a solid voxel
    "hexahedra's skin": Rate(kept=80),  # a triangle of the voxels' surface
    "hexahedra's lattice": Rate(work=28),  # a voxel
    "tetwild": Rate(work=2_500, kept=500, seconds=1e-3),  # a triangle
    "cells": Rate(work=2 * BYTES_PER_CELL, kept=2000, seconds=5e-5),  # a cell
    "cells drawn": Rate(work=8000, kept=5000),  # a cell that voxels are made of
    "measured surface": Rate(work=220, kept=50, seconds=5e-6),  # a triangle
    "measured mesh": Rate(work=1100, kept=20, seconds=20e-6),  # an element
    "measured skin": Rate(work=110),  # a triangle of the voxels' surface
    "measured grid": Rate(work=2),  # a voxel of a tile
    "measured chunk": Rate(work=6),  # a voxel of a chunk
    "measured bulk": Rate(work=4),  # a voxel of either
    "counted grid": Rate(seconds=60e-9),  # a voxel
    "surveyed": Rate(work=36, kept=8, seconds=1.5e-6),  # a voxel
    "surveyed in part": Rate(work=50, seconds=1.5e-6),  # a voxel of those that all families take
    "grid.vti": Rate(work=1.2, seconds=8e-9),  # a voxel
    "surface.stl": Rate(work=12, disk=50, seconds=1.2e-6),  # a triangle
    "mesh.vtu": Rate(work=90, disk=22, seconds=0.9e-6),  # an element
    "mesh.inp": Rate(work=160, disk=165, seconds=3.8e-6),  # an element
    "picture": Rate(work=390 + 200, seconds=8.5e-6),  # an element
    "picture of a surface": Rate(work=300, seconds=2e-6),  # a triangle
    "smooth": Rate(work=SMOOTH_BYTES, kept=44, seconds=2e-6),  # a triangle and step
    "simplify": Rate(work=SIMPLIFY_BYTES, kept=44, seconds=10e-6),  # a triangle
    "stored voxels": Rate(seconds=10e-9),  # a voxel: compressed, written, summed
    "streamed surface": Rate(disk=50, seconds=2.5e-6),  # a triangle
    "streamed lattice": Rate(seconds=15e-9),  # a voxel
    "stored measures": Rate(seconds=80e-9),  # a voxel
}
SECONDS = {"model": 2.0, "voxels": 0.5, "surface": 0.3, "volume": 0.5, "measures": 1.0}
SECONDS |= {"survey": 2.0, "files": 0.1, "report": 4.0, "tetwild": 4.0}
WANTED: Mapping[str, tuple[str, ...]] = {
    "model": (),
    "voxels": ("voxels",),
    "surface": ("surface",),
    "volume": ("volume",),
    "simulation": ("volume",),
    "measures": ("voxels", "surface"),
    "all": ("voxels", "surface", "volume", "report"),
}


@dataclass(frozen=True, eq=False)
class Cost(Value):
    """What a stage takes.

    Parameters
    ----------
    stage
        Its name.
    memory
        Bytes at its peak, with what earlier stages keep and programs that it calls.
    disk
        Bytes of the files that it leaves.
    seconds
        About.
    """

    stage: str
    memory: int
    disk: int = 0
    seconds: float = 0.0


class Work:
    """What a recipe asks for, and how much of everything there will be."""

    def __init__(
        self, recipe: Recipe, model: Model, only: str | None, *, out_of_core: bool
    ) -> None:
        self.recipe, self.model, self.stored = recipe, model, out_of_core
        self.wanted = WANTED[only or "all"]
        self.limit = available()
        self.held = OVERHEAD
        self.made: list[Cost] = []

    def costs(self) -> tuple[Cost, ...]:
        """Go through the stages as the pipeline does."""
        self._model()
        if self._is_too_much:
            return tuple(self.made)
        if self.frame is not None:
            self._stored_voxels() if self.stored else self._voxels()
            if self.recipe.clean is not None:
                self._add("clean", ("cleaned", self.size))
        if self.needs_surface:
            self._stored_surface() if self.streams else self._surface()
        if self.volume:
            self._volume()
        self._measures()
        self._files()
        if "report" in self.wanted:
            self._report()
        return tuple(self.made)

    # What there will be.

    @cached_property
    def is_whole(self) -> bool:
        """Whether the model alone is the body: no voxels that touch it or are mended, no tile."""
        return self._is_sharp and not any(self.recipe.voxels.periodic)

    @property
    def _is_sharp(self) -> bool:
        """The same, but that it may be a tile: the model's own cells may go on in its copies."""
        return self.recipe.voxels.sampling != "cover" and self.recipe.clean is None

    @cached_property
    def cells(self) -> int:
        """How many cells of its level the model is made of; 0 for a limit."""
        level = getattr(self.model, "level", None)
        automaton = getattr(self.model, "automaton", None)
        if not isinstance(level, int) or automaton is None:
            return 0
        return count_cells(automaton, level)

    @cached_property
    def exact(self) -> int:
        """Triangles of the exact boundary, at most; 0 where voxels will have to do."""
        how, model = self.recipe.surface, self.model
        if how.method not in ("auto", "exact") or (how.method == "auto" and how.smooth):
            return 0
        if not isinstance(model, HasBoundary) or not (self.is_whole or how.method == "exact"):
            return 0
        if isinstance(model, CellSystem):
            return 4 * boundary_count(model.closure, model.level)
        triangles = self._exact_by_level
        return triangles if RATES["exact boundary"].work * triangles <= self.limit else 0

    @property
    def _exact_by_level(self) -> int:
        """Level 1 tells whether there is an exact boundary, and how it grows from cell to cell."""
        model: Any = self.model
        if not self.cells:
            return 0
        try:
            first = replace(model, level=min(model.level, 1)).boundary()
        except PorousError:
            return 0
        cells = self.cells / count_cells(model.automaton, min(model.level, 1))
        return math.ceil(1.25 * len(first.triangles) * cells)

    @property
    def _is_too_much(self) -> bool:
        """Whether the model alone is: then nothing can be asked of it."""
        return BYTES_PER_CELL * self._drawn > self.limit

    @cached_property
    def volume(self) -> str:
        """Where the volume mesh comes from: cells, tetwild, hexahedra, or nowhere."""
        method = self.recipe.volume.method
        if "volume" not in self.wanted or method == "none":
            return ""
        solid = self.recipe.phase == "solid"
        own = self._is_sharp and solid and isinstance(self.model, HasCells)
        if method == "cells" or (method == "auto" and own):
            return "cells"
        few = solid and 0 < self.exact <= TETWILD_TRIANGLES
        if method == "tetwild" or (method == "auto" and few):
            return "tetwild"
        return "" if self.stored else "hexahedra"

    @cached_property
    def needs_surface(self) -> bool:
        """Whether a surface is made: because it is wanted, or to be filled."""
        tetrahedra = self.recipe.volume.method in ("auto", "tetwild")
        filled = "volume" in self.wanted and self.volume not in ("", "cells") and tetrahedra
        scan = self.recipe.model.kind == "image"  # type: ignore[attr-defined]
        alone = scan and self.wanted == WANTED["measures"] and self.size > SURFACE_VOXELS
        return ("surface" in self.wanted and not alone) or filled

    @cached_property
    def streams(self) -> bool:
        """Whether the surface goes to the disk piece by piece."""
        return self.stored and not self.exact

    @cached_property
    def frame(self) -> Frame | None:
        """Where the voxels lie, if anything needs them."""
        if not (
            "voxels" in self.wanted
            or (self.needs_surface and not self.exact)
            or self.volume == "hexahedra"
        ):
            return None
        if self._is_too_much:
            return None
        how = self.recipe.voxels
        return fit_frame(
            self.model,
            voxels=how.voxels,
            spacing=how.spacing,
            per_feature=how.per_feature,
            periodic=how.periodic,
            cubic=how.cubic,
        )

    @cached_property
    def source(self) -> SampledModel:
        """The voxels, none of them made yet."""
        assert self.frame is not None
        return SampledModel(self.model, self.frame, self.recipe.voxels.sampling or "fill")

    @cached_property
    def trial(self) -> Trial:
        """What the voxels will hold."""
        assert self.frame is not None
        if self._drawn > MOST_CELLS:
            size = float(self.frame.size)
            return Trial(size, size, 0.0, 1e-6 * size)
        return try_out(self.model, self.frame, self.source.sampling)

    @property
    def size(self) -> int:
        """Number of voxels."""
        return self.frame.size if self.frame is not None else 0

    @cached_property
    def bulks(self) -> int:
        """Arrays of voxels beside the fill: one where the bulk is not the whole frame."""
        return int(self.frame is not None and self.source.has_bulk)

    @property
    def solid(self) -> float:
        """Solid voxels, with room for the doubt."""
        return min(self.size, self._room * self.trial.solid)

    @property
    def skin(self) -> float:
        """Triangles of the voxels' surface, with room for the doubt."""
        return min(5.0 * self.size, self._room * self.trial.triangles)

    @property
    def _room(self) -> float:
        return 1.0 if self.trial.is_exact else 1.15 + 2 * self.trial.doubt

    @property
    def triangles(self) -> float:
        """Of the surface, at most."""
        return float(self.exact or (self.skin if self.frame is not None else 0))

    # What the stages take of it.

    def _add(
        self,
        stage: str,
        *parts: tuple[str, float],
        work: float = 0,
        kept: float = 0,
        disk: float = 0,
        seconds: float = 0,
    ) -> None:
        """Add a stage of so many units of several rates, and what they do not tell."""
        for rate, amount in ((RATES[name], amount) for name, amount in parts):
            work += rate.work * amount
            kept += rate.kept * amount
            disk += rate.disk * amount
            seconds += rate.seconds * amount
        peak = self.held + max(work, kept)
        self.held += math.ceil(kept)
        seconds += SECONDS.get(stage, 0.0)
        self.made.append(Cost(stage, math.ceil(peak), math.ceil(disk), seconds))

    def _model(self) -> None:
        self._add("model", ("cells", self._drawn))

    def _voxels(self) -> None:
        assert self.frame is not None
        tiles = _threads() * math.prod(map(min, TILE, self.frame.shape)) * MASK_BYTES
        kept = (1 + self.bulks) * self.size
        self._add(
            "voxels",
            ("cells drawn", self._drawn),
            work=kept + tiles,
            kept=kept,
            seconds=self.trial.seconds,
        )

    def _stored_voxels(self) -> None:
        tiles = _threads() * math.prod(TILE) * MASK_BYTES
        # A chunk, its compressed copy and what the compressor needs.
        chunk = (2 + self.bulks) * self._chunk
        self._add(
            "voxels",
            ("cells drawn", self._drawn),
            ("stored voxels", self.size),
            work=chunk + tiles,
            kept=KEPT,
            disk=self._packed + 200 * self._chunks,
            seconds=self.trial.seconds,
        )

    def _surface(self) -> None:
        if self.exact:
            system = isinstance(self.model, CellSystem)
            rate = "boundary of cells" if system else "exact boundary"
            self._add("surface", (rate, self.exact))
        else:
            self._add("surface", ("marching cubes", self.skin))
        how = self.recipe.surface
        if how.smooth:
            self._add(
                "smooth", ("smooth", self.triangles), seconds=1e-6 * how.smooth * self.triangles
            )
        if how.simplify < 1:
            self._add("simplify", ("simplify", self.triangles))

    def _stored_surface(self) -> None:
        assert self.frame is not None
        _, ny, nz = self.frame.shape
        layer = min(CHUNK * ny * nz, self.size, self.limit // 4, MOST_READ)
        plane = 2 * self.skin / self.size * ny * nz
        self._add(
            "surface",
            ("streamed surface", self.skin),
            ("streamed lattice", self.size),
            work=1.2 * layer + STREAM_BYTES * min(self.skin, STREAM_TRIANGLES + plane),
        )

    def _volume(self) -> None:
        if self.volume == "hexahedra":
            self._add(
                "volume",
                ("hexahedra", self.solid),
                ("hexahedra's skin", self.skin),
                ("hexahedra's lattice", self.size),
            )
        elif self.volume == "tetwild":
            self._add("volume", ("tetwild", self.triangles), work=GUEST, seconds=4.0)
        else:
            self._add("volume", ("cells", self.cells))

    @property
    def elements(self) -> float:
        """Of the volume mesh, at most."""
        per = {"hexahedra": self.solid if self.volume == "hexahedra" else 0.0}
        # tetwild makes 7 627 tetrahedra of 2 112 triangles and 36 663 of 36 096.
        per |= {"tetwild": min(8.0 * self.triangles, TETRAHEDRA + self.triangles)}
        per |= {"cells": 4.0 * self.cells}
        return per.get(self.volume, 0.0)

    def _measures(self) -> None:
        parts = []
        if self.frame is not None:
            parts += self._grid_parts()
        if self.needs_surface and not self.streams:
            parts.append(("measured surface", self.triangles))
        if self.volume:
            parts.append(("measured mesh", self.elements))
        if self.volume == "hexahedra":
            parts.append(("measured skin", self.skin))
        self._add("measures", *parts, work=self._seams)
        if self._is_surveyed:
            part = min(self.size, SURVEYED)
            self._add("survey", ("surveyed", self.size), ("surveyed in part", part))

    @property
    def _is_surveyed(self) -> bool:
        """Whether the grid is measured in full."""
        asked = "report" in self.wanted or self.wanted == WANTED["measures"]
        return asked and not self.stored and self.size > 0 and self.recipe.detail == "full"

    def _grid_parts(self) -> list[tuple[str, float]]:
        if self.stored:
            tile = max(self._chunk, min(self.size, GRID_TILE))
            return [
                ("measured chunk", tile),
                ("measured bulk", self.bulks * tile),
                ("stored measures", self.size),
            ]
        tile = min(self.size, GRID_TILE)
        return [
            ("measured grid", tile),
            ("measured bulk", self.bulks * tile),
            ("counted grid", self.size),
        ]

    @property
    def _seams(self) -> float:
        """Bytes of the pieces that are not finished while a grid is measured tile by tile."""
        if self.frame is None or (not self.stored and self.size <= GRID_TILE):
            return 0.0
        each = SEAM + SEAM_PIECES * min(1.0, self.skin / self.size)
        _, ny, nz = self.frame.shape
        # Chunks come in C order: open are a layer of them across x, a row and an end.
        return each * (ny * nz + (CHUNK * nz + CHUNK**2 if self.stored else 0))

    def _files(self) -> None:
        parts: list[tuple[str, float]] = []
        disk = 0.0
        if self.frame is not None and not self.stored:
            parts.append(("grid.vti", self.size))
            disk += self._packed
        if self.needs_surface and not self.streams:
            parts.append(("surface.stl", self.triangles))
        if self.volume:
            parts += [("mesh.vtu", self.elements), ("mesh.inp", self.elements)]
        self._add("files", *parts, disk=disk + 50_000)

    def _report(self) -> None:
        shown = min(self.triangles, 0 if self.streams else math.inf)
        picture = [("picture", self.elements)] if self.volume else []
        self._add("report", *picture, ("picture of a surface", shown), work=PICTURE, disk=500_000)

    @property
    def _packed(self) -> float:
        """Bytes of the voxels on disk."""
        return (1 + self.bulks) * self.size * min(1.0, 1.3 * self.trial.compressed + 1e-3)

    @property
    def _chunk(self) -> int:
        assert self.frame is not None
        return math.prod(min(CHUNK, n) for n in self.frame.shape)

    @property
    def _chunks(self) -> int:
        assert self.frame is not None
        return (1 + self.bulks) * math.prod(-(-n // CHUNK) for n in self.frame.shape)

    @property
    def _drawn(self) -> int:
        return self.cells if isinstance(self.model, CellSystem) else 0


def _threads() -> int:
    from porous.kernels._shared import threads

    return threads()
