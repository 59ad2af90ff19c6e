"""What readers share of named parts: names, as many members as a file justifies, faces by nodes.

What selects nothing of the volume elements is left out, and so is what cannot be held; a note says
which. Names are those of the file, but for what cannot be printed and what is beyond ``LONGEST``
characters; parts of several kinds that bear one name get their kind after it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.values import SHAPES, Part

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from porous.formats.gate import Source
    from porous.values import Block

    Indices = NDArray[np.int64]

MOST = max(len(shape.faces) for shape in SHAPES.values())
"""Faces of a cell, at most. A face as one number is its own, and ``MOST`` times its cell's."""
LONGEST = 127
"""The longest name, in characters."""
FREE = 1 << 19
"""Members that sets may have together beside one for each byte of the file."""
SHOWN = 5
"""Names that a note says; of more it says how many."""
WORDS = 40
"""Characters of a name that a note says."""


class Allowance:
    """How many members sets may still have: sets of sets say many in few bytes."""

    def __init__(self, source: Source) -> None:
        self.most = self.left = len(source.data) + FREE

    def take(self, count: int) -> None:
        """Take some, or refuse."""
        self.left -= count
        if self.left < 0:
            raise FormatError(f"sets: more than {self.most} members; the file is too short for it")


@dataclass
class Collected:
    """Parts as they are found, and what is said of those that are left out."""

    parts: dict[str, Part] = field(default_factory=dict)
    empty: list[str] = field(default_factory=list)
    left: dict[str, list[str]] = field(default_factory=dict)
    """Names by the reason why they are left out."""
    called: dict[str, int] = field(default_factory=dict)

    def add(self, kind: str, name: str, members: Indices) -> None:
        """Add a part; one without members is left out."""
        if not len(members):
            self.leave(name, "select nothing of the volume elements")
            return
        self.parts[self._free(printable(name), kind)] = Part(kind, members)

    def leave(self, name: str, reason: str) -> None:
        """Leave out a part for a reason, which reads on from "parts"."""
        self.left.setdefault(reason, []).append(printable(name))

    def note(self, source: Source) -> None:
        """Say what is left out."""
        for reason, names in self.left.items():
            source.note(f"{len(names)} parts {reason} and are left out: {listed(names)}")

    def _free(self, name: str, kind: str) -> str:
        if name not in self.parts:
            return name
        name = f"{name}_{kind.upper()}"
        while name in self.parts:
            count = self.called[name] = self.called.get(name, 1) + 1
            name = f"{name}_{count}"
        return name


def printable(name: str) -> str:
    """Return a name as it may stand anywhere: one line, no longer than names are."""
    kept = "".join(c if c.isprintable() else "_" for c in name[:LONGEST])
    return kept.strip() or "_"


def listed(names: Sequence[str]) -> str:
    """Return the first few of some names, in few characters."""
    more = [f"{len(names) - SHOWN} more"] if len(names) > SHOWN else []
    return ", ".join([*(name[:WORDS] for name in names[:SHOWN]), *more])


def distinct(members: Indices) -> Indices:
    """Return members in their order, each once."""
    if len(members) < 2 or (members[1:] > members[:-1]).all():
        return members
    _, first = np.unique(members, return_index=True)
    return members[np.sort(first)]


def ascending(pieces: Sequence[Indices]) -> Indices:
    """Return the members of several arrays, each once, from the lowest to the highest."""
    members = np.concatenate([np.zeros(0, np.int64), *pieces])
    return members if (members[1:] > members[:-1]).all() else np.unique(members)


def groups_of(labels: Indices) -> Iterator[tuple[int, Indices]]:
    """Give each label that there is, and the places that bear it."""
    order = np.argsort(labels, kind="stable")
    ranked = labels[order]
    starts = np.flatnonzero(np.diff(ranked, prepend=ranked[:1] - 1))
    pieces: list[Indices] = np.split(order, starts[1:])
    yield from zip(ranked[starts].tolist(), pieces, strict=False)


def same_rows(rows: Indices) -> tuple[Indices, Indices]:
    """Return the first of each distinct row, and which of the distinct ones each row is.

    Rows are told apart by a sum of their columns; where two have the same by chance or by malice,
    column by column.
    """
    weights: Indices = np.random.default_rng(7).integers(1 << 62, size=rows.shape[1:])
    sums = np.zeros(len(rows), np.int64)
    for index, weight in enumerate(list(weights)):
        sums += rows[:, index] * (weight | 1)  # beyond 2^63 it goes round
    _, first, place = np.unique(sums, return_index=True, return_inverse=True)
    if all((column[first][place] == column).all() for column in rows.T):
        return first, place
    _, first, place = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return first, place.reshape(-1)


def faces_by_nodes(blocks: Sequence[Block], count: int, corners: Indices) -> Indices:
    """Return which faces of cells some faces are, as (cell, local face), (n, 2); −1 for none.

    A face between two cells is of the one that it is seen from the outside of, else the first.

    Parameters
    ----------
    blocks
        Of a mesh of ``count`` nodes.
    corners
        Nodes of the corners of each face, shape (n, 3) or (n, 4).
    """
    found = np.full((len(corners), 2), -1)
    among = np.zeros(count, bool)
    among[corners] = True
    members, nodes = _faces_among(blocks, among, corners.shape[1])
    for form in (lambda rows: np.sort(rows, axis=1), _from_lowest):
        place = _first_of(form(nodes), form(corners))
        found[place >= 0] = members[place[place >= 0]]
    return found


def _faces_among(
    blocks: Sequence[Block], among: NDArray[np.bool_], width: int
) -> tuple[Indices, Indices]:
    """Return the faces of so many corners, all of them among some nodes, cell by cell."""
    members, nodes, start = [np.zeros((0, 2), np.int64)], [np.zeros((0, width), np.int64)], 0
    for block in blocks:
        for local, face in enumerate(SHAPES[block.shape].faces):
            if len(face) != width:
                continue
            chosen = among[block.cells[:, face[0]]]
            for corner in face[1:]:
                chosen &= among[block.cells[:, corner]]
            cells = np.flatnonzero(chosen)
            members.append(np.stack([start + cells, np.full(len(cells), local)], axis=1))
            nodes.append(block.cells[cells][:, face])
        start += len(block.cells)
    every = np.concatenate(members)
    order = np.lexsort(every.T[::-1])
    return every[order], np.concatenate(nodes)[order]


def _first_of(rows: Indices, wanted: Indices) -> Indices:
    """Return the first row that each wanted one equals, −1 where there is none."""
    first, place = same_rows(np.concatenate([rows, wanted]))
    at = first[place[len(rows) :]]
    return np.where(at < len(rows), at, -1)


def _from_lowest(rows: Indices) -> Indices:
    """Return rows turned about until the lowest number comes first."""
    turn = rows.argmin(axis=1)[:, None] + np.arange(rows.shape[1])
    return np.take_along_axis(rows, turn % rows.shape[1], axis=1)
