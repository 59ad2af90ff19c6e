"""What decks of cards share: names, numbers in columns of a width, cells by what they are made of.

A deck counts nodes and elements from 1, elements in the order of the mesh's cells. Whatever the
user has named comes into it as letters, digits and a few signs that are no card, markup or comment
in any of them.
"""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import FormatError
from porous.values import Job
from porous.values.job import PROPERTIES
from porous.values.units import length_ratio, system_length, system_ratio

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from porous.values import Held, Material, Step, VolumeMesh

    Indices = NDArray[np.int64]
    Points = NDArray[np.float64]

SLAB = 10_000
"""Lines that are made at once."""
PHASES = ("SOLID", "PORE")
"""Parts of cells that a bare mesh is divided into."""
REST = "REST"
"""The cells that no material is given for."""
HELD = {"static": "displacement", "modal": "displacement", "conduction": "temperature"}
"""What may be held in a step of each procedure."""
DIMENSIONS = {"displacement": "length", "temperature": "temperature"}
UNITS = {
    "mm-N-MPa": "mm, N, MPa, t, s, K",
    "m-SI": "m, N, Pa, kg, s, K",
}
WIDTH = 66
ODD = re.compile(r"[^A-Za-z0-9 .,;:()/+_-]")


class Group(NamedTuple):
    """Cells that are made of the same: what they are called, and of what, where that is known."""

    name: str
    material: Material | None


class Piece(NamedTuple):
    """Cells of one shape and group: numbers of the elements, from 1, and their nodes, from 0."""

    group: int
    shape: str
    numbers: Indices
    nodes: Indices


@dataclass(frozen=True)
class Deck:
    """A job as a deck has it.

    Parameters
    ----------
    job
        Of a bare mesh: one without materials and steps.
    points
        In the deck's unit of length.
    names
        By the part, its name in the deck.
    groups, group
        What the cells are made of, and the group of each.
    """

    job: Job
    points: Points
    names: dict[str, str]
    groups: tuple[Group, ...]
    group: Indices

    @property
    def mesh(self) -> VolumeMesh:
        """The mesh, in its own unit."""
        return self.job.mesh

    def scaled(self, value: float, dimension: str) -> float:
        """Return a quantity in mm-t-s-K in the deck's units."""
        return float(value * system_ratio(self.job.system, dimension))

    def known(self, material: Material, name: str) -> float:
        """Return a property in the deck's units, or raise where it is not known."""
        return self.scaled(material.known(name), PROPERTIES[name])

    def held(self, held: Held) -> float:
        """Return the value at which a quantity is held, in the deck's units."""
        return self.scaled(held.value, DIMENSIONS[held.quantity])

    def pieces(self) -> Iterator[Piece]:
        """Give the cells by block and group."""
        start = 0
        for block in self.mesh.blocks:
            own = self.group[start : start + len(block.cells)]
            for group in np.unique(own).tolist():
                rows = np.flatnonzero(own == group)
                yield Piece(group, block.shape, start + rows + 1, block.cells[rows])
            start += len(block.cells)

    def parts(self, kind: str) -> Iterator[tuple[str, str, Indices]]:
        """Give key, name and members of the parts of a kind that are not empty, no member twice."""
        for key, part in self.mesh.parts.items():
            if part.kind == kind and len(part.members):
                yield key, self.names[key], np.unique(part.members, axis=0)

    def heading(self) -> list[str]:
        """Return what a comment at the deck's head says, one line each."""
        said = [f"made by porous; units: {UNITS[self.job.system]}"]
        for group in self.groups:
            if group.material is not None:
                made = f"{group.name}: {group.material.name}"
                said.append(f"{made}, {group.material.source}" if group.material.source else made)
        if self.job.note:
            said.append(self.job.note)
        if not self.job.steps:
            said.append(f"no step: {self.job.why_no_step or 'a mesh and its sets'}")
        return [line for text in said for line in textwrap.wrap(plain(text), WIDTH)]


def deck_of(
    value: Job | VolumeMesh,
    suffix: str,
    *,
    odd: str = "[^A-Z0-9_-]",
    longest: int = 60,
    together: bool = False,
    reserved: tuple[str, ...] = (),
    most_steps: int | None = None,
) -> Deck:
    """Return a job or a bare mesh as a deck has it.

    Parameters
    ----------
    value
        What is written; a bare mesh comes in mm.
    suffix
        Of the format, for messages.
    odd
        A regular expression of what becomes an underscore in the names of parts.
    longest
        How many characters of a name are kept.
    together
        Whether parts of all kinds share one space of names.
    reserved
        Names that mean something else in the format; parts of such names are called ``N_…``.
    most_steps
        How many steps a deck may have.

    Raises
    ------
    FormatError
        For a mesh without cells, and a job that a deck cannot hold.
    """
    job = value if isinstance(value, Job) else Job("mesh", value)
    mesh = job.mesh
    if not mesh.cells:
        raise FormatError("the mesh has no cells; a deck needs at least one")
    _check_steps(job, suffix, most_steps)
    called = {key: _name(key, odd, longest, reserved) for key in mesh.parts}
    names = _distinct(mesh, called, together=together)
    points = mesh.points * length_ratio(mesh.unit, system_length(job.system))
    groups, group = _grouped(job, names)
    return Deck(job, points, names, groups, group)


def _check_steps(job: Job, suffix: str, most: int | None) -> None:
    if job.tied:
        raise FormatError(
            f"a {suffix} file cannot hold tied nodes ({', '.join(job.tied)}); wanted .inp"
        )
    procedures = sorted({step.procedure for step in job.steps})
    if len(procedures) > 1:
        raise FormatError(
            f"a {suffix} file cannot hold steps of {' and '.join(procedures)}; wanted one of them"
        )
    if most is not None and len(job.steps) > most:
        raise FormatError(
            f"a {suffix} file cannot hold {len(job.steps)} steps that each start from the body as "
            f"it was; wanted {most}"
        )
    for step in job.steps:
        _check_step(step)


def _check_step(step: Step) -> None:
    wanted = HELD.get(step.procedure)
    for held in step.held:
        if held.quantity != wanted:
            raise FormatError(
                f"step {step.name!r}: a {step.procedure} step cannot hold a {held.quantity} in "
                f"this format; wanted {wanted}"
            )
    if step.pressed and step.procedure != "static":
        raise FormatError(f"step {step.name!r}: a {step.procedure} step bears no pressure")
    if step.procedure == "modal":
        if step.modes < 1:
            raise FormatError(f"step {step.name!r}: got {step.modes} modes; wanted 1 or more")
        if any(held.value for held in step.held):
            raise FormatError(f"step {step.name!r}: a modal step holds nodes where they are, at 0")


def _distinct(mesh: VolumeMesh, names: dict[str, str], *, together: bool) -> dict[str, str]:
    """Return the names of parts, or refuse two that would be one."""
    seen: dict[tuple[str, str], str] = {}
    for key, part in mesh.parts.items():
        if part.kind == "pairs" or not len(part.members):
            continue  # such parts are not written
        first = seen.setdefault(("" if together else part.kind, names[key]), key)
        if first != key:
            raise FormatError(f"parts {first!r} and {key!r} would both be {names[key]} in a deck")
    return names


def _name(text: str, odd: str, longest: int, reserved: tuple[str, ...]) -> str:
    """Return a set's name: capitals, digits and _, a letter first."""
    name = re.sub(odd, "_", text.upper())
    is_fine = re.match("[A-Z]", name) and name not in reserved
    return (name if is_fine else f"N_{name}")[:longest]


def _grouped(job: Job, names: dict[str, str]) -> tuple[tuple[Group, ...], Indices]:
    """Return what the cells are made of, and the group of each; no group is empty."""
    mesh = job.mesh
    keys = list(job.materials) or [
        key for key in PHASES if key in mesh.parts and mesh.parts[key].kind == "cells"
    ]
    group = np.full(mesh.cells, len(keys))
    for number in reversed(range(len(keys))):
        group[mesh.parts[keys[number]].members] = number
    bare = int((group == len(keys)).sum())
    if bare and job.steps:
        raise FormatError(
            f"{bare} cells are made of nothing; wanted each in one of {', '.join(keys)}"
        )
    rest = Group(REST if keys else PHASES[0], None)
    every = [*(Group(names[key], job.materials.get(key)) for key in keys), rest]
    used, place = np.unique(group, return_inverse=True)
    return tuple(every[number] for number in used.tolist()), place.astype(np.int64)


# ------------------------------------------------------------------ text


def plain(text: str) -> str:
    """Return one line of ASCII that is no card, markup, comment or assignment anywhere."""
    line = " ".join(text.replace("³", "3").replace("=", ":").split())
    line = re.sub(r"-{2,}", "-", ODD.sub("_", line))
    return line.lstrip(" .,;:()/+_-").rstrip(" ,;-")


def lines(*some: str) -> bytes:
    """Return lines as bytes, each with its end."""
    return "".join(f"{line}\n" for line in some).encode("ascii")


def rows(line: str, *columns: Indices | Points) -> Iterator[bytes]:
    """Give a line for each row of columns that stand side by side.

    Parameters
    ----------
    line
        As ``%`` takes it, with its end.
    columns
        Arrays of shape (n,) or (n, k); whole numbers up to 2^53 beside others.
    """
    for start in range(0, len(columns[0]), SLAB):
        slab = np.column_stack([column[start : start + SLAB] for column in columns])
        yield (line * len(slab) % tuple(slab.ravel().tolist())).encode("ascii")


def packed(numbers: Indices, word: str, per_line: int) -> Iterator[bytes]:
    """Give numbers so many to a line, the last line shorter."""
    whole = len(numbers) // per_line * per_line
    for part, width in ((numbers[:whole], per_line), (numbers[whole:], len(numbers) - whole)):
        if len(part):
            yield from rows(word * width + "\n", part.reshape(-1, width))


def runs(numbers: Indices) -> tuple[Indices, Indices]:
    """Return first and last of each run of consecutive numbers, of numbers that ascend."""
    breaks = np.flatnonzero(np.diff(numbers) != 1)
    return numbers[np.append(0, breaks + 1)], numbers[np.append(breaks, len(numbers) - 1)]


FULL = 16
"""How wide the columns of coordinates are in Nastran's large fields and in LS-DYNA."""
SMALLEST = -5
"""Below this power of ten an exponent keeps more digits than a fixed point."""
WORDS = np.array(
    [f"%{FULL}.{digits}{form}" for form in "fe" for digits in range(FULL)], dtype=object
)


def _words(values: Points) -> NDArray[np.object_]:
    """Return how each number is written so that it keeps most within ``FULL`` characters."""
    size = np.abs(values)
    # A number that rounding may carry to the next power of ten counts as one.
    power = np.floor(np.log10(np.where(size > 0, size, 1.0)) + 5e-10).astype(np.int64)
    sign = np.signbit(values)
    fixed = FULL - 2 - np.maximum(power, 0) - sign
    scientific = FULL - 6 - sign - (np.abs(power) >= 100)
    return WORDS[np.where((power >= SMALLEST) & (fixed > 0), fixed, FULL + scientific)]


def node_rows(points: Points, before: tuple[str, str, str], end: str) -> Iterator[bytes]:
    """Give nodes, numbered from 1, with coordinates in columns of 16 characters.

    Numbers from 1e-5 to 1 are written to 13 decimals or more, larger ones with 14 digits, or 13
    and a sign, up to 1e13; others with 9 digits or more.

    Parameters
    ----------
    points
        Shape (n, 3).
    before
        What stands before x, which has a place for the node's number, before y and before z.
    end
        What stands after z.
    """
    for start in range(0, len(points), SLAB):
        slab = points[start : start + SLAB]
        words = np.empty((len(slab), 7), dtype=object)
        words[:, 0:6:2], words[:, 1:6:2], words[:, 6] = before, _words(slab), end
        numbers = np.arange(start + 1, start + 1 + len(slab))
        values = np.column_stack([numbers, slab]).ravel().tolist()
        yield ("".join(words.ravel().tolist()) % tuple(values)).encode("ascii")


def fit(value: float, width: int) -> str:
    """Return a number, with a point, as well as so many characters can say it."""
    found = []
    for digits in range(1, 18):
        short = re.sub(r"e([+-])0*(\d)", r"e\1\2", f"{value:.{digits}e}")
        found += [text for text in (short, f"{value:.{digits}f}") if len(text) <= width]
    return min(found, key=lambda text: (abs(float(text) - value), len(text)))


def fitted(values: Sequence[float | int | None], width: int) -> str:
    """Return numbers in columns of a width, None as an empty one."""
    texts = (
        "" if v is None else str(v) if isinstance(v, int | np.integer) else fit(v, width)
        for v in values
    )
    return "".join(text.rjust(width) for text in texts)
