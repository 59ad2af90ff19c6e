"""The stages where memory ends: voxels in a store, a surface in a file, tile by tile."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from porous.errors import RecipeError
from porous.pipeline._work import Work
from porous.scale import StoredGrid, Tally, fill_store
from porous.stages import SampledModel, fit_frame

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from porous.pipeline._work import Progress
    from porous.recipe import Recipe
    from porous.values import VolumeMesh
    from porous.values.tiled import Map

STORE, SURFACE = "grid.zarr", "surface.stl"

NO_MESH = (
    "no volume mesh: out of core one is made of a model's own cells or its exact boundary only; "
    "no solver would take a cell for every voxel of a grid that memory does not hold"
)


class Place(NamedTuple):
    """Where to keep what is large: of what recipe, how the folder is begun, in what chunks."""

    folder: Path
    identity: str
    begin: Callable[[], object]
    chunk: int


class StoredWork(Work):
    """A run that keeps what is large in a folder."""

    def __init__(
        self,
        recipe: Recipe,
        progress: Progress | None,
        place: Place,
        map: Map,  # noqa: A002
    ) -> None:
        super().__init__(recipe, progress)
        self.place, self.map = place, map
        check_stored(recipe)

    def build(self) -> None:
        super().build()
        fit_frame(self.model, **self._lattice)  # says now what is wrong with it
        self.place.begin()

    def _voxels(self, progress: Progress | None) -> StoredGrid:

        def report(done: int, count: int) -> None:
            if progress is not None:
                progress("voxels", done / count)

        frame = fit_frame(self.model, **self._lattice)
        source = SampledModel(self.model, frame, self._sampling)
        store = fill_store(
            self.place.folder / STORE,
            source,
            recipe_sha256=self.place.identity,
            chunk=self.place.chunk,
            map=self.map,
            progress=report,
        )
        return StoredGrid(store)

    def _voxel_surface(self) -> None:
        from porous.stages import stream_surface

        if self.grid is None:
            self.voxelize()
        grid, path = self.grid, self.place.folder / SURFACE
        assert grid is not None
        self.streamed = self._timed(
            "surface", lambda progress: stream_surface(grid, path, progress=progress)
        )

    def _journal(self) -> Tally:
        return Tally(self.place.folder, f"{self.place.identity} {self.place.chunk}")

    def measure(self) -> None:
        super().measure()
        self._journal().clear()

    def _tetrahedra(self, *, required: bool) -> VolumeMesh | None:
        if self.surface is None and self.streamed is None:
            self.extract_surface()
        if self.surface is not None:
            return super()._tetrahedra(required=required)
        if required:
            self.notes.append(NO_MESH)
        return None

    def _hexahedra(self) -> VolumeMesh | None:
        self.notes.append(NO_MESH)
        return None


def check_stored(recipe: Recipe) -> None:
    """Raise ``RecipeError`` where a recipe asks for what is done in memory only."""
    how = recipe.surface
    asked = {
        "clean": (recipe.clean and "a table", recipe.clean is None, "none"),
        "surface.smooth": (how.smooth, not how.smooth, "0"),
        "surface.volume": (how.volume, how.volume == "own", '"own"'),
        "surface.simplify": (how.simplify, how.simplify == 1, "1"),
        "surface.method": (how.method, how.method != "voxel-faces", '"marching-cubes"'),
    }
    for key, (got, is_right, wanted) in asked.items():
        if not is_right:
            raise RecipeError(
                f"{key}: got {got!r}, which is done in memory; out of core wanted {wanted}"
            )
