"""CalculiX: solves the decks that we write, and says what each of their steps came to."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

from porous.errors import GuestError
from porous.guests.process import run, workplace

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

PROGRAM = "ccx"
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

    Raises
    ------
    GuestError
        Where the solver is absent, fails, takes too long, or prints an error, or no totals
        and no frequencies.
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
        return _solution(folder / "job.dat", said.output)


def _solution(path: Path, log: str) -> Solution:
    text = path.read_text() if path.exists() else ""
    steps: dict[str, dict[tuple[str, str], tuple[float, ...]]] = {}
    for what, name, when, values in TOTAL.findall(text):
        steps.setdefault(when, {})[what, name] = tuple(map(float, values.split()))
    frequencies = [
        float(cycles) if float(square) >= 0 else -math.sqrt(-float(square)) / math.tau
        for modes in MODES.findall(text)
        for square, cycles in MODE.findall(modes)
    ]
    if not steps and not frequencies:
        raise GuestError("CalculiX printed no totals and no frequencies; did the deck have a step?")
    return Solution(tuple(steps.values()), tuple(frequencies), log)
