"""What is measured of a recipe, or of a file, without a folder of its own."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from porous import pipeline, presets

if TYPE_CHECKING:
    from porous.pipeline import Progress, Result
    from porous.recipe import Recipe


def is_recipe(source: str) -> bool:
    """Tell whether a preset or a recipe is meant, and no file of another kind."""
    named = Path(source).suffix in ("", presets.SUFFIX) and not Path(source).is_dir()
    return source in presets.names() or named


def measured(recipe: Recipe, feature: float | None, progress: Progress | None = None) -> Result:
    """Return the measures of a recipe.

    Parameters
    ----------
    recipe
        Its voxels and surface are made, no volume mesh.
    feature
        The smallest that can be printed, in the recipe's unit: asks for the finest level that can.
    progress
        As ``run`` takes it.

    Raises
    ------
    PorousError
        As ``run``.
    """
    from porous.measures import finest_printable_level
    from porous.values import Measures

    result = pipeline.run(recipe, only="measures", progress=progress)
    if feature is None:
        return result
    assert result.model is not None
    level = finest_printable_level(result.model, feature=feature)
    return replace(result, measures=result.measures + Measures((level,)))


def examined(path: str, *, detail: str = "brief", progress: Progress | None = None) -> Result:
    """Return the measures of a file, of a store of voxels, or of the mesh that fields are on.

    Parameters
    ----------
    path
        The file, or the folder of a store.
    detail, progress
        As ``examine`` takes them.

    Raises
    ------
    FormatError
        Where it cannot be read.
    PorousError
        As ``examine``.
    """
    from porous.formats import read
    from porous.kernels.crossings import check_uncrossed
    from porous.scale import StoredGrid
    from porous.values import MeshFields, SurfaceMesh
    from porous.values.surface_topology import check_closed

    if Path(path).is_dir():
        made = pipeline.examine(StoredGrid.open(path), detail=detail, progress=progress)
        return replace(made, source=pipeline.Origin(Path(path).absolute().name))
    value = read(path)
    if isinstance(value, SurfaceMesh):
        check_closed(value)
        check_uncrossed(value)
    known = value.mesh if isinstance(value, MeshFields) else value
    made = pipeline.examine(known, detail=detail, progress=progress)  # type: ignore[arg-type]
    return replace(made, source=_origin(Path(path)))


def _origin(path: Path) -> pipeline.Origin:
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
        return pipeline.Origin(path.name, digest, stream.tell())
