"""A recipe into a folder of files: all of them, or nothing."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from porous import disk, pipeline
from porous.errors import FormatError
from porous.recipe import dump, files, with_files

if TYPE_CHECKING:
    from collections.abc import Iterator

    from porous.pipeline import Progress, Result
    from porous.recipe import Recipe

LAST = "measures.json"
"""A folder that has this file is whole."""

KINDS = {"tet4": "tets", "tet10": "tets", "hex8": "hexes"}
"""What the files of a volume mesh are called, by the shape of its cells; ``cells`` where they are
the model's own."""

KNOWN = (
    "grid.vti",
    "surface.stl",
    *(f"{kind}.{suffix}" for kind in ("tets", "hexes", "cells") for suffix in ("vtu", "inp")),
    "report.html",
    "log.json",
)
"""What else a folder may hold; what a new run does not write would belong to another recipe."""


def make(
    recipe: Recipe, folder: str | Path, *, only: str | None = None, progress: Progress | None = None
) -> Result:
    """Run a recipe and put what came of it into a folder, ``measures.json`` last.

    Files of an earlier run of the same recipe stay; those of another recipe are removed. Where
    anything fails the folder is as it was.

    Parameters
    ----------
    recipe
        What to make.
    folder
        Created where it is missing; checked before the work starts.
    only, progress
        As ``run`` takes them.

    Raises
    ------
    DiskError
        Where the folder cannot be written to.
    PorousError
        As ``run``.
    """
    with disk.staging(folder) as stage:
        result = pipeline.run(recipe, only=only, progress=progress)
        local, text = _localised(recipe, stage)
        disk.write_bytes(stage / "recipe.toml", text.encode())
        for name, value in _artefacts(result):
            _write(value, stage / name)
        if only is None:
            _report(replace(result, recipe=local), stage / "report.html", progress)
        disk.write_bytes(stage / "log.json", _json(_log(result)))
        disk.write_bytes(stage / LAST, _json(record(replace(result, recipe=local))))
        disk.commit(stage, folder, last=LAST, stale=_stale(Path(folder), text))
    return result


def write_measures(result: Result, folder: str | Path) -> None:
    """Put the report and the measures of a result into a folder, ``measures.json`` last.

    Raises
    ------
    DiskError
        Where the folder cannot be written to.
    """
    with disk.staging(folder) as stage:
        _report(result, stage / "report.html", None)
        disk.write_bytes(stage / LAST, _json(record(result)))
        disk.commit(stage, folder, last=LAST, stale=KNOWN)


def record(result: Result) -> dict[str, Any]:
    """Return the content of ``measures.json``: provenance, measures, certificate, notes."""
    recipe, certificate = result.recipe, result.certificate
    return {
        "recipe": recipe.model_dump(mode="json", exclude_none=True) if recipe else None,
        "recipe_sha256": recipe.sha256 if recipe else None,
        "version": version("porous"),
        "measures": [_row(measure) for measure in result.measures],
        "certificate": [_row(row) for row in certificate.rows] if certificate else [],
        "notes": list(result.notes),
    }


def _row(value: Any) -> dict[str, Any]:
    """Return the fields of a flat value; JSON knows no NaN, so what is not finite becomes null."""
    row = {name: getattr(value, name) for name in value.__dataclass_fields__}
    return {
        name: None if isinstance(part, float) and not math.isfinite(part) else part
        for name, part in row.items()
    }


def _localised(recipe: Recipe, stage: Path) -> tuple[Recipe, str]:
    """Copy the files that a recipe reads beside it; return the recipe that means the copies."""
    names: dict[str, Path] = {}
    for key, path in files(recipe).items():
        names[key] = Path(f"{key.rpartition('.')[2]}{path.suffix}")
        disk.write_bytes(stage / names[key], _content(path))
    local = with_files(recipe, names)
    return local, dump(local)


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise FormatError(f"{path}: cannot be read: {error.strerror}") from None


def _artefacts(result: Result) -> Iterator[tuple[str, Any]]:
    if result.grid is not None:
        yield "grid.vti", result.grid
    if result.surface is not None:
        yield "surface.stl", result.surface
    if result.volume is not None:
        shape = result.volume.blocks[0].shape
        kind = "cells" if result.volume.is_of_cells else KINDS[shape]
        yield f"{kind}.vtu", result.volume
        yield f"{kind}.inp", result.job or result.volume


def _write(value: Any, path: Path) -> None:
    from porous.formats import write

    write(value, path)


def _report(result: Result, path: Path, progress: Progress | None) -> None:
    from porous.report import write_report

    if progress is not None:
        progress("report", 0.0)
    write_report(result, path)
    if progress is not None:
        progress("report", 1.0)


def _log(result: Result) -> dict[str, Any]:
    from porous.report import versions

    return {
        "times": {stage: round(seconds, 3) for stage, seconds in result.times.items()},
        "versions": versions(),
        "notes": list(result.notes),
    }


def rendered(record: dict[str, Any]) -> str:
    """Return a record as JSON text, the same for the same record."""
    return json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _json(record: dict[str, Any]) -> bytes:
    return rendered(record).encode()


def _stale(folder: Path, text: str) -> tuple[str, ...]:
    """Return the files of an earlier run that do not belong to this recipe."""
    old = folder / "recipe.toml"
    if old.is_file() and old.read_bytes() == text.encode():
        return ()
    return KNOWN
