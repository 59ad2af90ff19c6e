"""Runs the deck in a folder that ``make`` has filled, as it stands; puts there what it came to."""

from __future__ import annotations

import hashlib
import math
import re
import time
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from porous import disk
from porous.errors import FormatError, GuestError, MeshError, RecipeError, ViewError
from porous.guests import ccx, openfoam
from porous.recipe import build, load
from porous.values import Box, Measure, Measures, MeshFields, VolumeMesh
from porous.workspace._fields import fields_of, main_field, titled
from porous.workspace._folder import KINDS, RESULTS, as_json, row_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from porous.pipeline import Progress
    from porous.recipe import Recipe
    from porous.values import Job, Step

SOLVED, FIELDS, PICTURE = RESULTS
"""What is written; the first comes last, and a folder that has it has all."""
STEP = re.compile(rb"^\*STEP\b", re.MULTILINE | re.IGNORECASE)
PAPER = (800, 600)
"""Pixels of the picture."""
TIME_LIMIT = 3600.0
SPEED = re.compile(r"Reynolds number about \S+")
"""In the title of a job of flow."""
BLOCK = 1e-6
"""What of a box may be missing where body and pores are said to fill it: rounding."""
FOAM_VERSION = re.compile(r"Version: +([\w.]+)")


class Deck(NamedTuple):
    """What is to be solved, and what it was made from."""

    path: Path
    recipe: Recipe
    job: Job
    content: bytes
    """Of a deck that is one file."""
    is_own: bool
    """Whether it is what porous writes, byte for byte."""
    box: Box | None = None
    """The block that the body fills with its pores, where it does."""
    why_no_block: str = ""


class Solved(NamedTuple):
    """What a deck came to."""

    measures: Measures
    fields: MeshFields | None
    """Of a deck of CalculiX: on its mesh."""
    notes: tuple[str, ...]
    solver: Mapping[str, object]
    """Its name and version, the command line, and how many seconds it took."""
    deck: str
    """The name of the file or folder that was run."""
    deck_sha256: str | None
    recipe_sha256: str


def solve(
    folder: str | Path,
    *,
    program: str | None = None,
    time_limit: float = TIME_LIMIT,
    progress: Progress | None = None,
) -> Solved:
    """Run the deck that ``make`` has put into a folder, and put there what it comes to.

    CalculiX runs decks ``.inp``, OpenFOAM cases ``.foam``; where there are both, the one that the
    recipe's analysis writes unasked. It runs as it stands, in a temporary folder. Then
    ``results.vtu`` (fields on the mesh), ``results.png`` and ``results.json`` are written, all of
    them or none; of a case of OpenFOAM the measures alone.

    Parameters
    ----------
    folder
        That ``porous make`` has filled.
    program
        The solver, where it is not ``ccx`` or what the case names.
    time_limit
        In seconds.
    progress
        Called with ``"solve"`` while the solver runs; raising in it ends the solver.

    Returns
    -------
    Measures, fields, and what there is to know of them. How far off the elements are one mesh does
    not say: that is not part of any uncertainty.

    Raises
    ------
    FormatError
        Where the folder holds no recipe, or no deck that can be run here.
    RecipeError
        For a recipe without an analysis, or a time limit that is no time.
    MeshError
        For a deck without a step; says why it has none.
    GuestError
        Where the solver is not installed, fails, is killed, takes too long, reports an error, or
        prints what makes no sense.
    DiskError
        Where the folder cannot be written to.
    """
    if not 0 < time_limit < math.inf:
        raise RecipeError(f"time limit: got {time_limit} s; wanted more than zero")
    place = Path(folder)
    deck = _deck(place)
    disk.make_folder(place)  # says at once where nothing can be written
    run = _by_openfoam if deck.path.suffix == ".foam" else _by_calculix
    found = run(deck, program, time_limit, _watch(progress))
    if progress is not None:
        progress("solve", 1.0)
    return _put(found, place)


def _watch(progress: Progress | None) -> Callable[[float], None] | None:
    return None if progress is None else lambda _: progress("solve", 0.0)


def _put(found: Solved, place: Path) -> Solved:
    """Write what was found; the picture too, if this machine can draw."""
    from porous.formats import write

    with disk.staging(place) as stage:
        if found.fields is not None and found.fields.fields:
            write(found.fields, stage / FIELDS)
            try:
                disk.write_bytes(stage / PICTURE, _picture(found.fields))
            except ViewError as error:
                found = found._replace(notes=(*found.notes, f"no picture: {error}"))
        disk.write_bytes(stage / SOLVED, as_json(record(found)))
        disk.commit(stage, place, last=SOLVED, stale=(FIELDS, PICTURE))
    return found


def _picture(fields: MeshFields) -> bytes:
    from porous.view import field_picture

    name, deformed = main_field(fields)
    width, height = PAPER
    return field_picture(
        fields,
        name,
        title=titled(fields[name]),
        deformed_by=deformed,
        width=width,
        height=height,
    )


def record(found: Solved) -> dict[str, Any]:
    """Return the content of ``results.json``."""
    fields = found.fields.fields if found.fields is not None else ()
    return {
        "deck": found.deck,
        "deck_sha256": found.deck_sha256,
        "recipe_sha256": found.recipe_sha256,
        "version": version("porous"),
        "solver": dict(found.solver),
        "measures": [row_of(measure) for measure in found.measures],
        "fields": [{"name": f.name, "unit": f.unit or None, "at": f.at} for f in fields],
        "notes": list(found.notes),
    }


# --- what there is -------------------------------------------------------------------------


def _deck(place: Path) -> Deck:
    """Return the deck in a folder, and the job that porous makes of the recipe and mesh there."""
    from porous.formats import read
    from porous.jobs import prepare

    if not place.is_dir():
        raise FormatError(f"{place}: no such folder; wanted one that `porous make` has filled")
    if not (place / "recipe.toml").is_file():
        raise FormatError(
            f"{place}: holds no recipe.toml; wanted a folder that `porous make` has filled"
        )
    recipe = load(place / "recipe.toml")
    if recipe.simulation is None:
        raise RecipeError(f"{place / 'recipe.toml'}: has no table [simulation]; wanted one")
    path = _path(place, recipe)
    mesh = read(path.with_suffix(".vtu"))
    assert isinstance(mesh, VolumeMesh)
    job = prepare(mesh, recipe.simulation)
    deck = _compared(path, recipe, job)
    if deck.is_own and not job.steps:
        raise MeshError(f"{path}: has no step: {job.why_no_step}")
    if path.suffix == ".inp" and not STEP.search(deck.content):
        why = f": {job.why_no_step}" if job.why_no_step else "; wanted one, as `porous make` writes"
        raise MeshError(f"{path}: has no step{why}")
    return _with_block(deck) if deck.is_own else deck


def _path(place: Path, recipe: Recipe) -> Path:
    assert recipe.simulation is not None
    wanted = [suffix for suffix in recipe.simulation.suffixes if suffix in ("inp", "foam")]
    for suffix in wanted:
        for kind in KINDS:
            if (path := place / f"{kind}.{suffix}").exists():
                return path
    there = sorted(path.name for kind in KINDS for path in place.glob(f"{kind}.*"))
    raise FormatError(
        f"{place}: holds no deck {' or '.join(f'.{suffix}' for suffix in wanted)}; it has "
        f"{', '.join(there) or 'no mesh'}; wanted what `porous make` writes without --only"
    )


def _compared(path: Path, recipe: Recipe, job: Job) -> Deck:
    from porous.formats import foam, inp
    from porous.formats.gate import open_source

    if path.suffix == ".foam":
        files = foam.write_files(job, path.name)
        own = all(_is_file_of(path / name, chunks) for name, chunks in files)
        return Deck(path, recipe, job, b"", own)
    try:
        content = open_source(path).data
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None
    return Deck(path, recipe, job, content, _is_of(content, inp.write(job)))


def _is_file_of(path: Path, chunks: Any) -> bool:
    try:
        return _is_of(path.read_bytes(), chunks)
    except OSError:
        return False


def _is_of(content: bytes, chunks: Any) -> bool:
    """Tell whether bytes are those that a writer gives, which are never all in memory."""
    place = 0
    for chunk in chunks:
        if content[place : place + len(chunk)] != chunk:
            return False
        place += len(chunk)
    return place == len(content)


def _with_block(deck: Deck) -> Deck:
    """Return the deck with its box, or why there is none: the model's domain, if it lies within."""
    from porous.jobs import why_no_block
    from porous.models.model import HasBulk

    model = build(deck.recipe)
    of_mesh = Box.of_points(deck.job.mesh.points)
    inside = model.domain.contains(of_mesh, tolerance=1e-6 * max(model.domain.lengths))
    box = model.domain if inside else of_mesh
    why = why_no_block(deck.job.mesh, box)
    if not why and isinstance(model, HasBulk):
        share = model.bulk_volume / model.bulk.volume
        why = "" if share > 1 - BLOCK else f"body and pores fill {share:.3g} of their box only"
    return deck._replace(box=None if why else box, why_no_block=why)


def _notes(deck: Deck) -> Iterator[str]:
    if deck.job.note:
        yield deck.job.note
    if deck.why_no_block and any(_is_of_block(step) for step in deck.job.steps):
        yield f"no effective value of a material is told: {deck.why_no_block}"
    if not deck.is_own:
        yield (
            f"{deck.path.name} is not what porous {version('porous')} writes from recipe.toml and "
            f"{deck.path.stem}.vtu: it was edited, or another version wrote it; told is what the "
            "solver printed, in the deck's own units"
        )


def _is_of_block(step: Step) -> bool:
    return step.procedure != "modal" and not step.gradient


def _solved(
    deck: Deck, measures: Measures, fields: MeshFields | None, solver: Mapping[str, object]
) -> Solved:
    return Solved(
        measures,
        fields,
        tuple(_notes(deck)),
        solver,
        deck.path.name,
        hashlib.sha256(deck.content).hexdigest() if deck.content else None,
        deck.recipe.sha256,
    )


# --- CalculiX ------------------------------------------------------------------------------


def _by_calculix(
    deck: Deck, program: str | None, time_limit: float, watch: Callable[[float], None] | None
) -> Solved:
    begin = time.perf_counter()
    name = program or ccx.PROGRAM
    found = ccx.solve(deck.content, program=name, time_limit=time_limit, watch=watch, fields=True)
    solver = {
        "name": "CalculiX",
        "version": found.version or None,
        "command": f"{name} -i {deck.path.stem}",
        "seconds": round(time.perf_counter() - begin, 3),
    }
    try:
        fields = fields_of(deck.job if deck.is_own else None, found.fields)
        measures = _of_job(deck, found, fields) if deck.is_own else _as_printed(found)
    except (FormatError, MeshError) as error:
        raise GuestError(f"CalculiX wrote what makes no sense: {error}") from None
    solved = _solved(deck, measures, fields, solver)
    if fields is None:
        solved = solved._replace(notes=(*solved.notes, "CalculiX wrote no fields"))
    return solved


def _of_job(deck: Deck, found: ccx.Solution, fields: MeshFields | None) -> Measures:
    from porous.jobs import effective, results

    job = deck.job
    numbers = [value for step in found.steps for values in step.values() for value in values]
    if not all(map(math.isfinite, (*numbers, *found.frequencies))):
        raise MeshError("got totals that are not finite")
    cell = _cell(deck.recipe) if 0 < len(job.tied) < 3 else None
    rows = effective(job, found.steps, deck.box)
    rows += results(job, found.steps, found.frequencies, box=cell)
    if fields is not None and "von_mises_stress" in fields.names:
        kinds = " and ".join(dict.fromkeys(block.shape for block in job.mesh.blocks))
        method = f"finite elements {kinds}, greatest at nodes, depends on the mesh"
        most = fields["von_mises_stress"].values.max()
        name = "largest_von_mises_stress"
        rows += Measures((Measure(name, most, "MPa", method, math.nan, "standard", "volume"),))
    return rows


def _cell(recipe: Recipe) -> Box:
    """Return the box of the voxels that a recipe asks for."""
    from porous.stages import fit_frame

    how = recipe.voxels
    return fit_frame(
        build(recipe),
        voxels=how.voxels,
        spacing=how.spacing,
        per_feature=how.per_feature,
        periodic=how.periodic,
        cubic=how.cubic,
    ).box


def _as_printed(found: ccx.Solution) -> Measures:
    """Return what a solver printed of a deck that is not ours, in the deck's own units."""
    rows = [(f"natural_frequency_{i}", value) for i, value in enumerate(found.frequencies, 1)]
    several = len(found.steps) > 1
    for number, step in enumerate(found.steps, 1):
        for (what, name), values in step.items():
            ends = [""] if len(values) == 1 else [f"_{axis}" for axis in "xyz"]
            tail = f"_of_{name}" + (f"_step_{number}" if several else "")
            rows += [
                (f"{what.replace(' ', '_')}{end}{tail}", value)
                for end, value in zip(ends, values, strict=False)
            ]
    method = "total that CalculiX printed, in the deck's units"
    return Measures(
        tuple(
            Measure(name, value, "", method, math.nan, "standard", "volume") for name, value in rows
        )
    )


# --- OpenFOAM ------------------------------------------------------------------------------


def _by_openfoam(
    deck: Deck, program: str | None, time_limit: float, watch: Callable[[float], None] | None
) -> Solved:
    begin = time.perf_counter()
    application = program or _application(deck.path)
    try:
        found = openfoam.solve(deck.path, program=program, time_limit=time_limit, watch=watch)
    except GuestError as error:
        raise _with_speed(error, deck) from None
    version_ = FOAM_VERSION.search(found.log)
    solver = {
        "name": "OpenFOAM",
        "version": version_[1] if version_ else None,
        "command": application,
        "seconds": round(time.perf_counter() - begin, 3),
    }
    rows = _of_case(deck, found) if deck.is_own else _as_told(found)
    return _solved(deck, rows, None, solver)


def _with_speed(error: GuestError, deck: Deck) -> GuestError:
    """Return the error; where a flow is too fast, with how fast this one was to be."""
    told = SPEED.search(deck.job.title) if deck.is_own else None
    if told is None or "slower flow" not in str(error):
        return error
    return GuestError(f"{error}; this one was made for a {told[0]}")


def _application(path: Path) -> str:
    """Return the solver that a case names."""
    control = path / "system" / "controlDict"
    text = control.read_text(errors="replace") if control.is_file() else ""
    found = openfoam.APPLICATION.search(text)
    return found[1] if found else ""


def _of_case(deck: Deck, found: openfoam.Solution) -> Measures:
    from porous.jobs import effective, effective_diffusivity, permeability
    from porous.values.units import system_ratio

    job, box = deck.job, deck.box
    procedure = job.steps[0].procedure
    if procedure == "flow":
        return permeability(job, found.rates, found.pressures, box)
    if procedure == "diffusion":
        return effective_diffusivity(job, found.rates, box)
    watt = 1e3 * system_ratio(job.system, "power")
    totals = {(ccx.HEAT, side): (rate * watt,) for side, rate in found.rates.items()}
    return effective(job, [totals], box, how="finite volumes")


def _as_told(found: openfoam.Solution) -> Measures:
    rows = [(f"outflow_of_{side}", rate) for side, rate in found.rates.items()]
    rows += [(f"pressure_on_{side}", value) for side, value in found.pressures.items()]
    method = "what OpenFOAM wrote, in SI"
    return Measures(
        tuple(
            Measure(name, value, "", method, math.nan, "standard", "volume") for name, value in rows
        )
    )
