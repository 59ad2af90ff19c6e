"""The command line: one function per command, and the only file that prints or exits.

Exit codes: 0 done; 2 the user can mend it; 1 a foreign engine or the disk failed; 130 Ctrl-C.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import traceback
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter

from porous.disk import folder_for
from porous.errors import Cancelled, ModelError, PorousError, RecipeError
from porous.memory import limited
from porous.terminal import Progress, columns, of_result

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from porous.pipeline import Result
    from porous.recipe import Recipe
    from porous.values.tiled import Map
    from porous.workspace import Solved

app = App(
    name="porous",
    help="Volumetric porous materials: recipe in; analysed, printable, simulation-ready geometry "
    "out. Begin with: porous make menger -o out",
    version=lambda: f"porous {version('porous')}",
    suppress_keyboard_interrupt=False,
    help_format="plaintext",
)

Source = Annotated[str, Parameter(help="A preset's name, or a path to a recipe (TOML).")]
Values = Annotated[
    tuple[str, ...],
    Parameter(
        name="--set",
        negative="",
        show_default=False,
        help="Another value for a key of the recipe: --set model.level=3. May be repeated.",
    ),
]
Voxels = Annotated[
    int | None, Parameter(name="--voxels", help="Voxels along the longest edge of the domain.")
]
Memory = Annotated[
    str | None, Parameter(name="--max-memory", help="Memory that may be taken, such as 8G.")
]
Cluster = Annotated[
    str | None,
    Parameter(
        name="--cluster",
        help="Work out of core on Dask's workers: tcp://host:port of a scheduler whose workers see "
        "the folder, or local:2 for so many processes here.",
    ),
]
Detail = Annotated[
    Literal["brief", "full"] | None,
    Parameter(
        name="--detail",
        help="How much is measured: brief is porosity, surface and topology; full adds sizes, "
        "access, transport, printability and more, with plots. Images are measured in full, and "
        "so is what porous measure makes a report of.",
    ),
]
FLAG = Parameter(negative="", show_default=False)
Json = Annotated[bool, FLAG, Parameter(name="--json", help="Print JSON.")]
Folder = Annotated[Path, Parameter(name=["--out", "-o"], help="The folder to fill.")]


@app.command(name="list")
def list_() -> None:
    """List the presets: name, kind, title."""
    from porous import presets
    from porous.toml import read_table

    tables = {name: read_table(presets.path_of(name)) for name in presets.names()}
    rows = [(name, table["model"]["kind"], table["title"]) for name, table in tables.items()]
    print(columns(rows))


@app.command
def recipe(
    name: Annotated[str | None, Parameter(help=Source.__metadata__[0].help)] = None,
    *,
    values: Values = (),
    voxels: Voxels = None,
    schema: Annotated[bool, FLAG, Parameter(help="Print the JSON Schema of recipes.")] = False,
) -> None:
    """Print a recipe in full (TOML): copy it, edit it, make it."""
    from porous.recipe import dump
    from porous.recipe import schema as json_schema

    if schema:
        print(json.dumps(json_schema(), indent=1))
        return
    if name is None:
        raise RecipeError("recipe: wanted a preset's name or a path; see: porous list")
    print(dump(_load(name, values, voxels)), end="")


@app.command
def make(
    source: Source,
    *,
    out: Folder,
    values: Values = (),
    voxels: Voxels = None,
    detail: Detail = None,
    only: Annotated[
        str | None,
        Parameter(
            help="Make no more than that: model, voxels, surface, volume, simulation or measures."
        ),
    ] = None,
    out_of_core: Annotated[
        bool,
        FLAG,
        Parameter(
            help="Keep voxels and surface on disk, tile by tile: for more than memory holds. "
            "What is done stays; porous resume goes on with it.",
        ),
    ] = False,
    chunk: Annotated[
        int | None, Parameter(help="Voxels along the edges of a chunk that is stored out of core.")
    ] = None,
    cluster: Cluster = None,
    dry_run: Annotated[
        bool, FLAG, Parameter(help="Say what memory, disk and time it would take.")
    ] = False,
    as_json: Json = False,
    max_memory: Memory = None,
) -> None:
    """Make everything that a recipe says, into a folder: voxels, surface, mesh, deck, report."""
    from porous import workspace
    from porous.pipeline import check_stored
    from porous.scale.estimate import check, estimate

    stored = out_of_core or cluster is not None
    with limited(max_memory), _of(source), Progress(_tell) as progress:
        recipe = _load(source, values, voxels, detail)
        _check_chunk(chunk, stored=stored)
        if stored:
            check_stored(recipe)
        expected = estimate(recipe, only=only, out_of_core=stored)
        if dry_run:
            print(expected)
        check(expected)
        if dry_run:
            return
        _tell(expected.summary)
        if stored:
            how = {} if chunk is None else {"chunk": chunk}
            with _staying(out), _workers(cluster) as map_:
                made = workspace.make_stored(
                    recipe, out, only=only, map=map_, progress=progress, **how
                )
        else:
            made = workspace.make(recipe, out, only=only, progress=progress)
    _print_made(made, out, as_json=as_json)


@app.command
def resume(
    folder: Annotated[Path, Parameter(help="What porous make --out-of-core was to fill.")],
    *,
    cluster: Cluster = None,
    as_json: Json = False,
    max_memory: Memory = None,
) -> None:
    """Go on with what porous make --out-of-core has begun, or mend what of it was damaged."""
    from porous import workspace

    if workspace.is_whole(folder):
        print(f"{folder}: is whole; there is nothing to do")
        return
    with (
        limited(max_memory),
        _staying(folder),
        Progress(_tell) as progress,
        _workers(cluster) as map_,
    ):
        made = workspace.resume(folder, map=map_, progress=progress)
    _print_made(made, folder, as_json=as_json)


@app.command
def solve(
    folder: Annotated[Path, Parameter(help="A folder that porous make has filled.")],
    *,
    program: Annotated[
        str | None, Parameter(help="The solver, where it is not ccx or what the case names.")
    ] = None,
    time_limit: Annotated[float, Parameter(help="Seconds that the solver may take.")] = 3600.0,
    as_json: Json = False,
    max_memory: Memory = None,
) -> None:
    """Run the deck in a folder in CalculiX or OpenFOAM; put there what it comes to."""
    from porous import workspace

    with limited(max_memory), Progress(_tell) as progress:
        solved = workspace.solve(folder, program=program, time_limit=time_limit, progress=progress)
    _print_made(solved, folder, as_json=as_json, name="results")


def _check_chunk(chunk: int | None, *, stored: bool) -> None:
    if chunk is not None and (chunk < 1 or not stored):
        raise RecipeError(f"--chunk: got {chunk}; wanted 1 voxel or more, with --out-of-core")


@contextlib.contextmanager
def _staying(folder: Path) -> Iterator[None]:
    """Say to who interrupts work out of core that it was not in vain."""
    try:
        yield
    except KeyboardInterrupt:
        raise Cancelled(f"interrupted; what is done stays: porous resume {folder}") from None


@contextlib.contextmanager
def _workers(address: str | None) -> Iterator[Map]:
    """Give what calls a function for every tile: here, or on the workers of a cluster."""
    if address is None:
        yield map
        return
    from porous.scale.cluster import Cluster

    with Cluster.connect(address) as cluster:
        yield cluster.map


def _print_made(
    made: Result | Solved, folder: Path, *, as_json: bool, name: str = "measures"
) -> None:
    if as_json:
        print((folder / f"{name}.json").read_text(encoding="utf-8"), end="")
        return
    solved = name == "results"
    print(of_result(made, every=solved))
    files = folder.glob("results.*" if solved else "*")
    print(f"{folder}: {', '.join(sorted(path.name for path in files))}")


@app.command
def measure(
    source: Annotated[str, Parameter(help="A surface, grid or mesh file, a preset or a recipe.")],
    *,
    values: Values = (),
    voxels: Voxels = None,
    detail: Detail = None,
    feature: Annotated[
        float | None, Parameter(help="The smallest feature that can be printed, in the unit.")
    ] = None,
    as_json: Json = False,
    out: Annotated[
        Path | None, Parameter(name=["--out", "-o"], help="A folder for the report.")
    ] = None,
    max_memory: Memory = None,
) -> None:
    """Measure a file, a preset or a recipe."""
    from porous import workspace

    detail = detail or ("full" if out is not None else None)
    place = contextlib.nullcontext() if out is None else folder_for(out)
    with limited(max_memory), _of(source), place, Progress(_tell) as progress:
        if workspace.is_recipe(source):
            result = workspace.measured(_load(source, values, voxels, detail), feature, progress)
        elif values or voxels or feature:
            raise RecipeError(
                f"{source}: --set, --voxels and --feature are for presets and recipes"
            )
        else:
            result = workspace.examined(source, detail=detail or "brief", progress=progress)
        if out is not None:
            workspace.write_measures(result, out, progress=progress)
    if as_json:
        print(workspace.rendered(workspace.record(result)), end="")
        return
    print(of_result(result, every=True))


@app.command
def compare(
    folders: Annotated[
        list[Path], Parameter(help="Folders that porous make or porous measure -o has filled.")
    ],
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="The HTML file to write.")],
) -> None:
    """Put materials side by side on one page; all are held against the first."""
    from porous import workspace

    workspace.compare(folders, out)


@app.command
def convert(
    source: Annotated[Path, Parameter(help="A file of any format that is read.")],
    target: Annotated[Path, Parameter(help="The file to write; its suffix says the format.")],
) -> None:
    """Convert a file into another format."""
    from porous.formats import read, write
    from porous.scale import StoredGrid

    value = StoredGrid.open(source).to_grid() if source.is_dir() else read(source)
    write(value, target)


@app.command
def show(source: Annotated[Path, Parameter(help="A grid, surface or mesh file.")]) -> None:
    """Show a file in a window."""
    from porous.formats import read
    from porous.view import show as show_value

    show_value(read(source))  # type: ignore[arg-type]


@app.command
def formats() -> None:
    """List the formats: suffixes, name, what is read and what is written."""
    from porous.formats import formats as known

    rows = [("suffix", "format", "read as", "written from")]
    for form in known():
        read_as = form.reads.__name__ if form.reads else "–"
        written = ", ".join(kind.__name__ for kind in form.writes) or "–"
        rows.append((", ".join(form.suffixes), form.name, read_as, written))
    print(columns(rows))


@app.command
def models() -> None:
    """List the kinds of models that a recipe may have."""
    from porous.recipe import sections

    told = {kind: sys.modules[part.__module__].__doc__ or "" for kind, part in sections().items()}
    print(columns([(kind, text.splitlines()[0]) for kind, text in told.items()]))


@app.command
def materials(
    name: Annotated[str | None, Parameter(help="One of them: print it in full (TOML).")] = None,
) -> None:
    """List the materials: name, title, what is known; or print one: copy it, edit it."""
    from porous import presets
    from porous.toml import read_table

    if name is not None:
        print(presets.material_path(name).read_text(encoding="utf-8"), end="")
        return
    tables = {one: read_table(presets.material_path(one)) for one in presets.material_names()}
    known = {one: sorted(set(of) - {"title", "source"}) for one, of in tables.items()}
    print(columns([(one, of["title"], ", ".join(known[one])) for one, of in tables.items()]))


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line; return its exit code."""
    with _quiet_warnings(), _terminated():
        try:
            app(
                sys.argv[1:] if argv is None else list(argv),
                exit_on_error=False,
                print_error=False,
                result_action="return_value",
            )
            sys.stdout.flush()
        except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001  (the last door out)
            return _failed(error)
    return 0


def _failed(error: BaseException) -> int:
    """Say in one line what went wrong; return the exit code."""
    if isinstance(error, BrokenPipeError):
        # Whoever read our output has gone; the interpreter must not try to flush it again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    code, text = _verdict(error)
    if os.environ.get("POROUS_TRACEBACK"):
        traceback.print_exception(error)
    _complain(text)
    return code


def _verdict(error: BaseException) -> tuple[int, str]:
    if isinstance(error, PorousError):
        return error.exit_code, str(error)
    if isinstance(error, CycloptsError):
        return 2, f"{str(error).rstrip('.')}; see: porous --help"
    if isinstance(error, KeyboardInterrupt):
        return 130, "interrupted; nothing was written"
    if isinstance(error, MemoryError):
        return 1, f"out of memory: {error}" if str(error) else "out of memory"
    if isinstance(error, OSError):
        return 1, f"{error.filename or 'the disk'}: {(error.strerror or str(error)).lower()}"
    what = f"{type(error).__name__}: {error}"
    return 1, f"a fault of porous itself: {what} (POROUS_TRACEBACK=1 says where)"


def _complain(text: str) -> None:
    """Say what is wrong, in one line."""
    _tell(f"porous: {' '.join(text.split())}")


def _tell(text: str) -> None:
    """Say something on stderr, if anybody listens."""
    with contextlib.suppress(OSError):
        print(text, file=sys.stderr, flush=True)


@contextlib.contextmanager
def _quiet_warnings() -> Iterator[None]:
    """Say warnings in one line; those of other people's packages are not for the user."""

    def say(message: Warning | str, category: type[Warning], *_: Any) -> None:
        if category.__module__.startswith("porous."):
            _complain(f"warning: {message}")

    with warnings.catch_warnings():
        warnings.simplefilter("default")
        warnings.showwarning = say  # type: ignore[assignment]
        yield


@contextlib.contextmanager
def _terminated() -> Iterator[None]:
    """Let a request to terminate, or a terminal that is closed, clean up as Ctrl-C does."""

    def stop(number: int, _: object) -> None:
        raise SystemExit(128 + number)

    # Whoever lets us live on without a terminal, as nohup does, has said so.
    asked = [s for s in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(s) != signal.SIG_IGN]
    before = {}
    with contextlib.suppress(ValueError):  # not in the main thread: whoever runs us keeps them
        before = {number: signal.signal(number, stop) for number in asked}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def _of(source: str) -> Iterator[None]:
    """Name the recipe in what is said of its model: the user may run many."""
    try:
        yield
    except ModelError as error:
        raise ModelError(f"{source}: {error}") from None


def _load(
    source: str, values: Iterable[str], voxels: int | None, detail: str | None = None
) -> Recipe:
    from porous.recipe import assignment, load

    given = {"voxels.voxels": voxels, "report.detail": detail}
    chosen = {key: value for key, value in given.items() if value is not None}
    return load(source, set={**dict(map(assignment, values)), **chosen})
