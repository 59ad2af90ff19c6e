"""OpenFOAM: solves the cases that we write, and says what flows through the sides that are held."""

from __future__ import annotations

import math
import os
import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from porous.errors import GuestError
from porous.guests.process import run, workplace

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

PACKAGE = "openfoam"
"""Debian's package that has the solvers."""
PLACES = ("/usr/share/openfoam",)
"""Where OpenFOAM's settings may be if WM_PROJECT_DIR does not say it: Debian's package."""
OUT, PRESSURE = "out-", "pressure-"
"""How the names of the function objects of ``formats.foam`` begin; the side follows."""
APPLICATION = re.compile(r"^application\s+(\w+);", re.MULTILINE)
CONVERGED = re.compile(r"^SIMPLE solution converged in \d+ iterations", re.MULTILINE)
TROUBLE = re.compile(r"^--> FOAM FATAL[^\n]*\n(?:[^\n]*\n){0,5}", re.MULTILINE)
MOST_READ = 1 << 20
"""Characters of a log that are searched for what went wrong."""
SETTLED = 1e-5
"""What leaves may change by this much in the last tenth of the iterations, relative to itself."""
BALANCE = 1e-3
"""What enters and what leaves may differ by this much of it."""


class Solution(NamedTuple):
    """What a case came to, in SI."""

    rates: Mapping[str, float]
    """What leaves the body through each side that is held: m³/s of a fluid, W of heat, or m³/s
    times the unit of the concentration; negative where it enters."""
    pressures: Mapping[str, float]
    """Of a flow: the mean pressure on each of these sides, in Pa."""
    iterations: int
    log: str
    """What the solver printed."""


def solve(
    case: str | Path | Iterable[tuple[str, Iterable[bytes]]],
    *,
    program: str | None = None,
    time_limit: float = 600.0,
    watch: Callable[[float], None] | None = None,
) -> Solution:
    """Solve a case in a folder of its own and return what flows.

    Parameters
    ----------
    case
        As ``formats.foam`` writes it: a folder, which is left as it is, or names of files and
        their bytes.
    program
        The solver; by default the one that the case names.
    time_limit
        In seconds.
    watch
        Called with the seconds gone by; raising in it ends the solver.

    Raises
    ------
    GuestError
        Where the solver is absent, fails, diverges, takes too long, does not come to rest, or
        reports an error; for a case without a step.
    """
    with workplace() as folder:
        _put(case, folder)
        application = _application(folder)
        log = _run(program or application, application, folder, time_limit, watch)
        return solution(folder, log)


def solution(folder: str | Path, log: str = "") -> Solution:
    """Return what flows in a case that was solved where it lies, by its ``Allrun``.

    Parameters
    ----------
    folder
        Of the case.
    log
        What the solver printed: where it says that it came to rest, it is believed.

    Raises
    ------
    GuestError
        Where nothing was solved, or it diverged, or did not come to rest.
    """
    application = _application(Path(folder))
    histories = _histories(Path(folder))
    _check_rest(histories, log, application)
    last = {name: history[-1] for name, history in histories.items()}
    rounds = max(len(history) for history in histories.values())
    return Solution(_sums(last, OUT), _sums(last, PRESSURE), rounds, log)


def _put(case: str | Path | Iterable[tuple[str, Iterable[bytes]]], folder: Path) -> None:
    if isinstance(case, str | Path):
        _application(Path(case))
        shutil.copytree(case, folder, dirs_exist_ok=True)
        return
    for name, chunks in case:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as stream:
            stream.writelines(chunks)


def _application(folder: Path) -> str:
    control = folder / "system" / "controlDict"
    if not control.is_file():
        raise GuestError(f"{folder}: has no system/controlDict; wanted the folder of a case")
    found = APPLICATION.search(control.read_text(errors="replace"))
    name = found[1] if found else ""
    if name in ("", "checkMesh"):
        raise GuestError("the case has no step; its Allrun says why")
    return name


def _run(
    program: str,
    name: str,
    folder: Path,
    time_limit: float,
    watch: Callable[[float], None] | None,
) -> str:
    check_installed(program)
    try:
        said = run(
            [program],
            name=f"OpenFOAM's {name}",
            folder=folder,
            time_limit=time_limit,
            watch=watch,
            environment=_environment(),
        )
    except GuestError as error:
        if "SIGFPE" in str(error):
            raise GuestError(
                f"OpenFOAM's {name} diverged; wanted a slower flow or a finer mesh"
            ) from None
        if trouble := _trouble(folder):
            raise GuestError(f"OpenFOAM's {name} reports {trouble}") from None
        raise
    return said.output


def check_installed(program: str) -> None:
    """Raise ``GuestError`` where there is no such solver; say what brings it."""
    if shutil.which(program) is None:
        raise GuestError(
            f"OpenFOAM is not installed: there is no program {program!r}; on Debian: "
            f"apt-get install {PACKAGE}"
        )


def _environment() -> dict[str, str]:
    place = next((place for place in PLACES if Path(place).is_dir()), "")
    known = os.environ.get("WM_PROJECT_DIR") or place
    return {"FOAM_SIGFPE": "true", **({"WM_PROJECT_DIR": known} if known else {})}


def _trouble(folder: Path) -> str:
    """Return what OpenFOAM says of an error that it found itself, on one line."""
    for name in ("guest.err", "guest.out"):
        with (folder / name).open(errors="replace") as stream:
            found = TROUBLE.search(stream.read(MOST_READ))
        if found:
            return " ".join(found[0].split())
    return ""


def _histories(folder: Path) -> dict[str, list[float]]:
    """Return what the function objects wrote after each iteration, by their names."""
    found = {}
    for path in sorted(folder.glob("postProcessing/*/*/surfaceFieldValue.dat")):
        rows = [line.split() for line in path.read_text().splitlines() if line[:1] != "#"]
        found[path.parent.parent.name] = [float(row[-1]) for row in rows if len(row) > 1]
    if not found or not all(found.values()):
        raise GuestError("OpenFOAM wrote no rates; was a case of porous with a step solved?")
    return found


def _sums(last: Mapping[str, float], start: str) -> dict[str, float]:
    """Return the values of each side; a side may be several zones, ``XMIN-SOLID``."""
    sums: dict[str, float] = {}
    for name, value in last.items():
        if name.startswith(start):
            side = name.removeprefix(start).partition("-")[0]
            sums[side] = sums.get(side, 0.0) + value
    return sums


def _check_rest(histories: Mapping[str, list[float]], log: str, name: str) -> None:
    rates = {key: history for key, history in histories.items() if key.startswith(OUT)}
    last = [history[-1] for history in rates.values()]
    most = max(map(abs, last))
    if not math.isfinite(sum(last)):
        raise GuestError(f"OpenFOAM's {name} diverged; wanted a slower flow or a finer mesh")
    moved = max(_moved(history) for history in rates.values())
    if not CONVERGED.search(log) and moved > SETTLED * most:
        raise GuestError(
            f"OpenFOAM's {name} did not come to rest: what flows still changed by {moved:.2g} of "
            f"{most:.2g}; wanted a slower flow (a Reynolds number below about 10) or a finer mesh"
        )
    if abs(sum(last)) > BALANCE * most:
        raise GuestError(
            f"OpenFOAM's {name} lost some: {sum(last):.2g} of {most:.2g} enters and does not leave"
        )


def _moved(history: list[float]) -> float:
    tail = history[-2 - len(history) // 10 :]
    return max(tail) - min(tail)
