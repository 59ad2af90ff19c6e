"""CalculiX: solves the decks that we write, and says what each of their steps came to."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from porous.errors import GuestError
from porous.guests.process import run, workplace
from porous.memory import check_memory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

PROGRAM, PACKAGE = "ccx", "calculix-ccx"
"""The solver, and Debian's package that has it."""
ERROR = re.compile(r"\*ERROR[^\n]*(?:\n[^\n]*){0,3}")
VERSION = re.compile(r"^CalculiX Version ([\w.]+)", re.MULTILINE)
MOST_READ = 1 << 22
"""Characters of what it printed that are searched for an error."""
NUMBER = r"[-+]?\d[-+0-9.Ee]*"
TOTAL = re.compile(
    rf"^ total ([a-z ]+?)(?: \([a-z,]+\))? for set (\S+) and time +({NUMBER})\n\s*\n"
    rf"((?:[ ]+{NUMBER})+)\n",
    re.MULTILINE,
)
"""What a deck's totals look like: of what, of which set, when, and the numbers."""
MODES = re.compile(
    r"E I G E N V A L U E   O U T P U T(.*?)(?:P A R T I C I P A T I O N|\Z)", re.DOTALL
)
MODE = re.compile(rf"^ +\d+ +({NUMBER}) +{NUMBER} +({NUMBER}) +{NUMBER}$", re.MULTILINE)
EXPONENT = re.compile(r"(\d)([-+]\d{3})$")
FORCE, HEAT, ENERGY, VOLUME = "force", "heat generation", "internal energy", "volume"
"""What totals are of, as CalculiX calls it."""

Totals = Mapping[tuple[str, str], tuple[float, ...]]
"""By what it is of, and the name of the set in the deck."""


class Solution(NamedTuple):
    """What a deck's steps came to, in the deck's units."""

    steps: tuple[Totals, ...]
    """The totals that each step printed."""
    frequencies: tuple[float, ...]
    """Natural frequencies, per second; negative where the square of one is."""
    log: str
    """What the solver printed."""
    fields: bytes = b""
    """The file .frd that it wrote, where it was asked for."""

    @property
    def version(self) -> str:
        """The solver's version as it printed it; empty where it did not."""
        found = VERSION.search(self.log)
        return found[1] if found else ""

    @property
    def reaction(self) -> tuple[float, ...]:
        """The sum of the forces on the nodes that are held, of the first step's first set."""
        return self._first(FORCE)

    @property
    def energy(self) -> float:
        """The strain energy of all elements, in the first step."""
        return self._first(ENERGY)[0]

    @property
    def volume(self) -> float:
        """The volume of all elements."""
        return self._first(VOLUME)[0]

    def _first(self, what: str) -> tuple[float, ...]:
        for (quantity, _), values in (self.steps[0] if self.steps else {}).items():
            if quantity == what:
                return values
        raise GuestError(f"CalculiX printed no total {what}; was there a step of that kind?")


def solve(
    deck: bytes | Iterable[bytes],
    *,
    program: str = PROGRAM,
    time_limit: float = 600.0,
    watch: Callable[[float], None] | None = None,
    fields: bool = False,
) -> Solution:
    """Solve a deck and return the totals of its steps, or its frequencies.

    Parameters
    ----------
    deck
        As ``formats.inp`` writes it: it prints totals of RF or RFL, of ELSE and of EVOL.
    program
        CalculiX's solver.
    time_limit
        In seconds.
    watch
        Called with the seconds gone by; raising in it ends the solver.
    fields
        Whether the fields that it wrote are wanted too.

    Raises
    ------
    GuestError
        Where the solver is absent, fails, takes too long, or prints an error, or no totals
        and no frequencies.
    MemoryLimitError
        Where the fields would not fit into memory.
    """
    check_installed(program)
    with workplace() as folder:
        with (folder / "job.inp").open("wb") as stream:
            stream.writelines([deck] if isinstance(deck, bytes) else deck)
        log = _run(program, folder, time_limit, watch)
        solution = _solution(folder / "job.dat", log)
        return solution._replace(fields=_content(folder / "job.frd")) if fields else solution


def check_installed(program: str = PROGRAM) -> None:
    """Raise ``GuestError`` where there is no such program; say what brings it."""
    if shutil.which(program) is None:
        raise GuestError(
            f"CalculiX is not installed: there is no program {program!r}; on Debian: "
            f"apt-get install {PACKAGE}"
        )


def _run(
    program: str, folder: Path, time_limit: float, watch: Callable[[float], None] | None
) -> str:
    try:
        said = run(
            [_place(program), "job"],
            name="CalculiX",
            folder=folder,
            time_limit=time_limit,
            watch=watch,
        )
    except GuestError:
        with (folder / "guest.out").open(errors="replace") as stream:
            _check_said(stream.read(MOST_READ))  # what it says of its end says more than how it was
        raise
    _check_said(said.output)
    return said.output


def _place(program: str) -> str:
    """Return where a program is: one that is named by a path is not looked for in the folder."""
    found = shutil.which(program)
    return str(Path(found).absolute()) if found else program


def _check_said(log: str) -> None:
    if found := ERROR.search(log):
        raise GuestError(f"CalculiX reports {' '.join(found[0].split())}")


def _content(path: Path) -> bytes:
    """Return a file's bytes, none where there is no such file."""
    if not path.is_file():
        return b""
    check_memory(path.stat().st_size, "the fields that CalculiX wrote", "Coarsen the mesh.")
    return path.read_bytes()


def _solution(path: Path, log: str) -> Solution:
    text = path.read_text(errors="replace") if path.is_file() else ""
    steps: dict[str, dict[tuple[str, str], tuple[float, ...]]] = {}
    for what, name, when, values in TOTAL.findall(text):
        steps.setdefault(when, {})[what, name] = tuple(map(_number, values.split()))
    frequencies = [
        _number(cycles) if _number(square) >= 0 else -math.sqrt(-_number(square)) / math.tau
        for modes in MODES.findall(text)
        for square, cycles in MODE.findall(modes)
    ]
    if not steps and not frequencies:
        raise GuestError("CalculiX printed no totals and no frequencies; did the deck have a step?")
    return Solution(tuple(steps.values()), tuple(frequencies), log)


def _number(text: str) -> float:
    """Return a number of Fortran's, whose exponents of three digits have no letter."""
    try:
        return float(EXPONENT.sub(r"\1E\2", text))
    except ValueError:
        raise GuestError(f"CalculiX printed {text!r} where a number belongs") from None
