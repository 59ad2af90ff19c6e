"""CalculiX: solves the decks that we write, and says what the supports and the solid bear."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from porous.errors import GuestError
from porous.guests.process import run, workplace

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

PROGRAM = "ccx"
NUMBER = r"\s+([-+0-9.Ee]+)"


class Solution(NamedTuple):
    """What a deck's step came to."""

    reaction: tuple[float, float, float]
    """Sum of the forces on the held nodes, in N."""
    energy: float
    """Strain energy of the solid, in N·mm."""
    volume: float
    """Volume of the solid, in mm³."""
    log: str
    """What the solver printed."""


def solve(
    deck: bytes | Iterable[bytes],
    *,
    program: str = PROGRAM,
    time_limit: float = 600.0,
    watch: Callable[[float], None] | None = None,
) -> Solution:
    """Solve a deck with one step and return its totals.

    Parameters
    ----------
    deck
        As ``formats.inp`` writes it: it prints totals of RF, ELSE and EVOL.
    program
        CalculiX's solver.
    time_limit
        In seconds.
    watch
        Called with the seconds gone by; raising in it ends the solver.

    Raises
    ------
    GuestError
        Where the solver is absent, fails, takes too long, or prints an error or no totals.
    """
    with workplace() as folder:
        with (folder / "job.inp").open("wb") as stream:
            stream.writelines([deck] if isinstance(deck, bytes) else deck)
        said = run(
            [program, "job"],
            name="CalculiX",
            folder=folder,
            time_limit=time_limit,
            watch=watch,
        )
        if "*ERROR" in said.output:
            lines = said.output[said.output.index("*ERROR") :].splitlines()[:5]
            raise GuestError("CalculiX reports " + "\n    ".join(lines))
        return _totals(folder / "job.dat", said.output)


def _totals(path: Path, log: str) -> Solution:
    text = path.read_text() if path.exists() else ""
    x, y, z = _after(text, "total force", 3)
    return Solution(
        (x, y, z),
        _after(text, "total internal energy", 1)[0],
        _after(text, "total volume", 1)[0],
        log,
    )


def _after(text: str, title: str, count: int) -> list[float]:
    found = re.search(rf"{title}[^\n]*\n\s*\n" + count * NUMBER, text)
    if found is None:
        raise GuestError(f"CalculiX printed no {title}; did the deck have a step?")
    return [float(number) for number in found.groups()]
