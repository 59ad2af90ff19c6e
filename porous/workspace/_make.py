"""A recipe into a folder of files: all of them or nothing, or out of core and to be resumed."""

from __future__ import annotations

import builtins
import hashlib
import json
import stat
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous import disk, pipeline
from porous.errors import DiskError, FormatError, RecipeError
from porous.recipe import dump, files, load, with_files
from porous.scale import CHUNK, StoredGrid
from porous.stages import StreamedSurface
from porous.values import SurfaceMesh, VoxelGrid, VoxelMaps
from porous.workspace._folder import KINDS, RESULTS, as_json, row_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from porous.pipeline import Progress, Result
    from porous.recipe import Recipe
    from porous.values.tiled import Map

LOG, LAST = "log.json", "measures.json"
"""Times and versions; and what comes last: a folder that has this file is whole."""

KIND_OF = {"tet4": "tets", "tet10": "tets", "hex8": "hexes", "hex20": "hexes"}
"""What the files of a volume mesh are called, by the shape of its cells; ``cells`` where they are
the model's own."""

DECK = ("inp",)
"""The suffix of the mesh's deck where no analysis wants another."""

KNOWN = (
    "grid.vti",
    "surface.stl",
    *(f"{kind}.{suffix}" for kind in KINDS for suffix in ("vtu", *DECK)),
    *RESULTS,
    "report.html",
    "maps.vti",
    "measures.csv",
    "curves.csv",
    LOG,
)
"""What else a folder may hold, besides decks that are asked for; what a new run does not write
would belong to another recipe."""

HEADERS = (".mhd", ".nhdr")
"""Suffixes of images whose voxels are in another file."""

UNFINISHED = "unfinished.json"
"""A folder that has this file is to be gone on with; it says what was asked for."""


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
    RecipeError
        Where the folder holds a store of voxels of another recipe: that may have cost days.
    FormatError
        Where it holds something else in the place of a store.
    PorousError
        As ``run``.
    """
    _check_store(Path(folder), _identity(recipe))
    _check_own(Path(folder), recipe)
    _stale(Path(folder), dump(with_files(recipe, _names(recipe))))
    with disk.staging(folder) as stage:
        result = pipeline.run(recipe, only=only, progress=progress)
        local, text = _localised(recipe, stage)
        disk.write_bytes(stage / "recipe.toml", text.encode())
        _finish(replace(result, recipe=local), stage, {"only": only}, progress)
        # Results of an earlier mesh would stand beside a new one.
        stale = dict.fromkeys((*_stale(Path(folder), text), *RESULTS))
        stale |= dict.fromkeys(_left_over(Path(folder), recipe))
        disk.commit(stage, folder, last=LAST, stale=stale)
    return result


def make_stored(
    recipe: Recipe,
    folder: str | Path,
    *,
    only: str | None = None,
    chunk: int = CHUNK,
    map: Map = builtins.map,  # noqa: A002
    progress: Progress | None = None,
) -> Result:
    """Do what ``make`` does where voxels and surface need not fit into memory.

    The voxels are in ``grid.zarr`` then, a Zarr store with a manifest, and not in ``grid.vti``. The
    folder keeps what was done, whatever ends the work, and ``resume`` goes on with it; so does this
    where the recipe is the same.

    Parameters
    ----------
    recipe, folder, only, progress
        As for ``make``.
    chunk
        Voxels along the edges of a stored chunk; a store that is there keeps its own.
    map
        How a function is called for every tile; see ``run_stored``.

    Raises
    ------
    DiskError
        Where the folder cannot be written to, or another porous is at work there.
    RecipeError
        Where the folder holds a store of another recipe.
    PorousError
        As ``run_stored``; what was done stays.
    """
    with disk.folder_for(Path(folder).absolute()) as place, disk.locked(place):
        disk.sweep(place)  # the path is absolute, for workers may stand elsewhere
        return _stored(recipe, place, _How(only, chunk, map, progress))


def resume(
    folder: str | Path,
    *,
    map: Map = builtins.map,  # noqa: A002
    progress: Progress | None = None,
) -> Result:
    """Go on with what ``make_stored`` has begun, or mend it: with the bytes it would have had.

    Parameters
    ----------
    folder
        What ``make_stored`` was given.
    map, progress
        As for ``make_stored``.

    Raises
    ------
    FormatError
        Where there is nothing to go on with.
    RecipeError
        Where the recipe in the folder is not the one that was begun.
    PorousError
        As ``make_stored``.
    """
    place = Path(folder).absolute()
    recipe, asked = _begun(place)
    with disk.locked(place):
        disk.sweep(place)
        return _stored(recipe, place, _How(*asked, map, progress))


def is_whole(folder: str | Path) -> bool:
    """Return whether ``resume`` has nothing to do: all is done, every byte of the store is right.

    Raises
    ------
    FormatError
        Where there is nothing that ``make_stored`` has begun.
    RecipeError
        Where the recipe in the folder is not the one that was begun.
    """
    from porous.scale import Store

    place = Path(folder)
    recipe, _ = _begun(place)
    made = _logged(place).get("files")
    if _is_there(place / UNFINISHED) or not isinstance(made, dict) or LAST not in made:
        return False
    known = {"recipe.toml", *_known(), LAST, pipeline.STORE, *map(str, _names_of(recipe))}
    if not made.keys() <= known:  # a log of somebody else's: no other file is looked at
        return False
    if any(_sum(place / name) != told for name, told in made.items()):
        return False
    store = place / pipeline.STORE
    try:
        return pipeline.STORE not in made or not Store.open(store).verify()
    except FormatError:
        return False


def _sum(path: Path) -> object:
    """Return a file's size and CRC32C, "folder" for a folder, None where there is nothing."""
    from porous.scale import crc32c_of

    try:
        return "folder" if stat.S_ISDIR(path.stat().st_mode) else list(crc32c_of(path))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _unreadable(path, error) from None


class _How(NamedTuple):
    """What ``make_stored`` was asked for besides a recipe."""

    only: str | None
    chunk: int
    map: Map
    progress: Progress | None


def _stored(recipe: Recipe, place: Path, how: _How) -> Result:
    identity = _identity(recipe)
    _check_store(place, identity)
    _check_own(place, recipe)
    result = pipeline.run_stored(
        recipe,
        place,
        identity=identity,
        begin=lambda: _begin(recipe, place, how),
        **how._asdict(),
    )
    with disk.staging(place) as stage:
        result = replace(result, recipe=with_files(recipe, _names(recipe)))
        asked = {"only": how.only, "chunk": how.chunk}
        _finish(result, stage, asked, how.progress, place)
        disk.commit(stage, place, last=LAST)
    disk.remove(place / UNFINISHED)
    disk.settle(place)
    return result


def _begin(recipe: Recipe, place: Path, how: _How) -> None:
    """Say in the folder what is being made; what was made of another recipe goes."""
    from porous.scale import seal

    asked = {"only": how.only, "chunk": how.chunk, "recipe_sha256": _identity(recipe)}
    note = seal({**asked, "version": version("porous")})
    with disk.staging(place) as stage:
        _, text = _localised(recipe, stage)
        if not _stale(place, text) and _held(place / UNFINISHED) == note:
            return
        disk.write_bytes(stage / "recipe.toml", text.encode())
        disk.write_bytes(stage / UNFINISHED, note)
        disk.commit(stage, place, last=UNFINISHED, stale=(LAST, *_stale(place, text)))


def _begun(place: Path) -> tuple[Recipe, tuple[str | None, int]]:
    """Return the recipe of a folder that ``make_stored`` has begun; what was asked for, chunks.

    Raises
    ------
    RecipeError
        Where it is not the recipe that was begun.
    FormatError
        Where nothing was begun, or what says what was is damaged.
    """
    from porous.scale import read_sealed
    from porous.scale.store import check_same

    path = place / "recipe.toml"
    begun = any(_is_there(place / name) for name in (UNFINISHED, pipeline.STORE))
    if not _is_there(path) or not (begun or "files" in _logged(place)):
        raise FormatError(
            f"{place}: holds nothing to go on with; wanted a folder that `porous make "
            "--out-of-core` has begun"
        )
    recipe = load(path)
    identity = _identity(recipe)
    _check_store(place, identity)
    if not _is_there(place / UNFINISHED):
        return recipe, _asked(_logged(place))
    note = read_sealed(place / UNFINISHED)
    check_same(place, str(note.get("recipe_sha256")), identity)
    return recipe, _asked(note)


def _logged(place: Path) -> dict[str, Any]:
    """Return the log of a finished folder; nothing where it is of no use."""
    try:
        log = json.loads(_held(place / LOG) or b"")
    except (ValueError, RecursionError):
        return {}
    return log if isinstance(log, dict) else {}


def _asked(note: dict[str, Any]) -> tuple[str | None, int]:
    """Return what a note says was asked for, and in what chunks."""
    only, chunk = note.get("only"), note.get("chunk")
    return (
        only if isinstance(only, str) and only in pipeline.WANTED else None,
        chunk if isinstance(chunk, int) and chunk > 0 else CHUNK,
    )


def _identity(recipe: Recipe) -> str:
    """Return a hash of a recipe and of all that it reads, wherever that lies."""
    text = dump(with_files(recipe, _names(recipe)))
    contents = [_content(path) for _, path in sorted(files(recipe).items()) if not path.is_dir()]
    contents += [_content(path) for _, path in sorted(_members(recipe).items())]
    return hashlib.sha256(b"".join((text.encode(), *contents))).hexdigest()


def _check_store(place: Path, identity: str) -> None:
    """Refuse a folder with a store of another recipe, or what is no store in its place."""
    from porous.scale.store import check_store

    if _is_there(place / pipeline.STORE):
        check_store(place / pipeline.STORE, identity)


def _check_own(place: Path, recipe: Recipe) -> None:
    """Refuse a folder with files of these names that porous has not made there."""
    if any(_is_there(place / name) for name in (LAST, LOG, UNFINISHED, pipeline.STORE)):
        return
    found = [name for name in _known() if _is_there(place / name)]
    # Who was killed in the beginning leaves the recipe alone, in his own words.
    own = dump(with_files(recipe, _names(recipe))).encode()
    if _held(place / "recipe.toml") not in (None, own):
        found.insert(0, "recipe.toml")
    if found:
        raise RecipeError(
            f"{place}: holds a file {found[0]} that porous has not made there; wanted another "
            "folder, or that file elsewhere"
        )


def _is_there(path: Path) -> bool:
    return _mode(path) != 0


def _mode(path: Path) -> int:
    """Return what kind of thing is there, as ``stat`` counts kinds; zero where there is nothing."""
    try:
        return path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return 0
    except OSError as error:
        raise _unreadable(path, error) from None


def _held(path: Path) -> bytes | None:
    """Return the bytes of a file; None where there is none."""
    try:
        return path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: OSError) -> DiskError:
    return DiskError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}")


def write_measures(result: Result, folder: str | Path, *, progress: Progress | None = None) -> None:
    """Put the report and the measures of a result into a folder, ``measures.json`` last.

    Raises
    ------
    DiskError
        Where the folder cannot be written to.
    """
    with disk.staging(folder) as stage:
        _report(result, stage / "report.html", progress)
        _tables(result, stage)
        disk.write_bytes(stage / LAST, as_json(record(result)))
        disk.commit(stage, folder, last=LAST, stale=_stale_of(Path(folder)))


def record(result: Result) -> dict[str, Any]:
    """Return the content of ``measures.json``: provenance, measures, certificate, notes."""
    recipe, certificate = result.recipe, result.certificate
    return {
        "recipe": recipe.model_dump(mode="json", exclude_none=True) if recipe else None,
        "recipe_sha256": recipe.sha256 if recipe else None,
        "version": version("porous"),
        "measures": [row_of(measure) for measure in result.measures],
        "certificate": [row_of(row) for row in certificate.rows] if certificate else [],
        "notes": [*result.notes, *result.findings.notes],
    }


def _finish(
    result: Result,
    stage: Path,
    asked: dict[str, Any],
    progress: Progress | None,
    place: Path | None = None,
) -> None:
    """Write all that came of a recipe, but for the recipe itself.

    Of a ``place`` that is gone on with the log tells what files it then holds, and their sums.
    """
    for name, value in _artefacts(result):
        _write(value, stage / name)
    if asked["only"] is None:
        _report(result, stage / "report.html", progress)
    _tables(result, stage)
    disk.write_bytes(stage / LAST, as_json(record(result)))
    if place is not None:
        asked = {**asked, "files": _sums(result, stage, place)}
    disk.write_bytes(stage / LOG, as_json({**asked, **_log(result)}))


def _sums(result: Result, stage: Path, place: Path) -> dict[str, object]:
    """Return what a folder will hold by name: sizes and sums of files, stores as folders."""
    assert result.recipe is not None
    copies = {key: place / name for key, name in files(result.recipe).items()}
    read = map(str, _names_of(with_files(result.recipe, copies)))
    names = {"recipe.toml": place, **dict.fromkeys(read, place)}
    names |= {path.name: stage for path in stage.iterdir()}
    if isinstance(result.surface, StreamedSurface):
        names[pipeline.SURFACE] = place
    if isinstance(result.grid, StoredGrid):
        names[pipeline.STORE] = place
    return {name: _sum(where / name) for name, where in sorted(names.items())}


def _names_of(recipe: Recipe) -> Iterable[Path]:
    """Return the names in the folder of all that a recipe reads."""
    return (*_names(recipe).values(), *_members(recipe))


def _names(recipe: Recipe) -> dict[str, Path]:
    """Return how the files that a recipe reads are called in the folder, by key path."""
    return {
        key: Path(f"{key.rpartition('.')[2]}{path.suffix}") for key, path in files(recipe).items()
    }


def _members(recipe: Recipe) -> dict[Path, Path]:
    """Return the files that others which a recipe reads consist of besides, by their names there.

    Raises
    ------
    FormatError
        Where one has a name that porous needs, or what names it is damaged.
    """
    from porous.formats import members

    found = {}
    for key, path in files(recipe).items():
        if not path.is_dir() and path.suffix.lower() not in HEADERS:
            continue
        for name in members(path):
            if path.is_dir():
                found[_names(recipe)[key] / name] = path / name
            elif name in (*_known(), LAST, "recipe.toml", str(_names(recipe)[key])):
                raise FormatError(f"{path}: its voxels are in {name}; wanted another name there")
            else:
                found[Path(name)] = path.parent / name
    return found


def _left_over(folder: Path, recipe: Recipe) -> Iterator[str]:
    """Yield what is of no use any more in folders of slices that a recipe's own are put into."""
    wanted = {str(name) for name in _members(recipe)}
    for key, path in files(recipe).items():
        inner = folder / _names(recipe)[key]
        if path.is_dir() and inner.is_dir():
            there = (f"{inner.name}/{file.name}" for file in inner.iterdir() if file.is_file())
            yield from (name for name in there if name not in wanted)


def _localised(recipe: Recipe, stage: Path) -> tuple[Recipe, str]:
    """Copy the files that a recipe reads beside it; return the recipe that means the copies."""
    names = _names(recipe)
    for key, path in files(recipe).items():
        if path.is_dir():
            disk.make_folder(stage / names[key])
        else:
            disk.write_bytes(stage / names[key], _content(path))
    for name, path in _members(recipe).items():
        disk.write_bytes(stage / name, _content(path))
    local = with_files(recipe, names)
    return local, dump(local)


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise FormatError(f"{path}: cannot be read: {error.strerror}") from None


def _artefacts(result: Result) -> Iterator[tuple[str, Any]]:
    if isinstance(result.grid, VoxelGrid):
        yield "grid.vti", result.grid
    asked = result.recipe.report if result.recipe else None
    if result.maps and asked and asked.maps:
        yield "maps.vti", _maps(result)
    if isinstance(result.surface, SurfaceMesh):
        yield "surface.stl", result.surface
    if result.volume is not None:
        shape = result.volume.blocks[0].shape
        kind = "cells" if result.volume.is_of_cells else KIND_OF[shape]
        yield f"{kind}.vtu", result.volume
        for suffix in _decks(result):
            yield f"{kind}.{suffix}", result.job or result.volume


def _decks(result: Result) -> tuple[str, ...]:
    """Return the suffixes of the decks that are written."""
    simulation = result.recipe.simulation if result.recipe else None
    return simulation.suffixes if result.job and simulation else DECK


def _commands(result: Result) -> list[str]:
    """Return the command lines that run what was written, each from within the folder."""
    from porous.formats import formats

    if result.job is None or not result.job.steps:
        return []
    runs = {form.suffix: form.command for form in formats()}
    names = [Path(name) for name, value in _artefacts(result) if value is result.job]
    commands = [runs[name.suffix].format(name=name, stem=name.stem) for name in names]
    return [command for command in commands if command]


def _write(value: Any, path: Path) -> None:
    from porous.formats import write

    write(value, path)


def _tables(result: Result, stage: Path) -> None:
    """Write the numbers for who opens them in a spreadsheet: those of ``measures.json``."""
    from porous.report import curves_csv, measures_csv

    disk.write_bytes(stage / "measures.csv", measures_csv(result.measures))
    if result.findings.curves:
        disk.write_bytes(stage / "curves.csv", curves_csv(result.findings.curves))


def _maps(result: Result) -> VoxelMaps:
    """Return how wide pores and how thick walls are, and where less than the machine makes."""
    asked = result.recipe.report if result.recipe else None
    limits = {
        "pore": ("pore_diameter", "narrow_gap", asked.smallest_gap if asked else None),
        "solid": ("wall_thickness", "thin_wall", asked.smallest_wall if asked else None),
    }
    maps = {}
    for phase, local in result.maps.items():
        name, below, least = limits[phase]
        maps[name] = local.diameters
        if least is not None:
            maps[below] = np.where(local.diameters < least, local.diameters, np.float32(0))
    return VoxelMaps(next(iter(result.maps.values())).frame, maps)


def _report(result: Result, path: Path, progress: Progress | None) -> None:
    from porous.report import write_report

    if progress is not None:
        progress("report", 0.0)
    write_report(result, path)
    if progress is not None:
        progress("report", 1.0)


def _log(result: Result) -> dict[str, Any]:
    from porous.report import now, versions

    return {
        "made": now(),
        "times": {stage: round(seconds, 3) for stage, seconds in result.times.items()},
        "versions": versions(),
        "notes": list(result.notes),
        "commands": _commands(result),
    }


def _stale(folder: Path, text: str) -> tuple[str, ...]:
    """Return the files of an earlier run that do not belong to this recipe.

    Raises
    ------
    RecipeError
        For a folder among them: a solver may have put its results there.
    """
    same = _held(folder / "recipe.toml") == text.encode()
    return () if same else _stale_of(folder)


def _stale_of(folder: Path) -> tuple[str, ...]:
    stale = _known()
    for name in stale:
        if stat.S_ISDIR(_mode(folder / name)):
            raise RecipeError(
                f"{folder}: holds a case {name} of another recipe, and maybe results; wanted "
                "another folder, or that one elsewhere"
            )
    return stale


def _known() -> tuple[str, ...]:
    """Return what porous may have put into a folder, decks of every kind too."""
    from porous.formats import formats

    decks = [form.suffix for form in formats() if form.procedures]
    return (*KNOWN, *(f"{k}{d}" for k in KINDS for d in decks if f"{k}{d}" not in KNOWN))
