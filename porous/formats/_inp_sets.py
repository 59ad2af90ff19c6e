"""What is read of a deck's sets: of nodes, of elements, and surfaces of numbered faces.

``*NSET`` and ``*ELSET`` may list numbers and sets that stand before, or say ``GENERATE``;
``NSET=`` and ``ELSET=`` on the cards of nodes and elements count too, and several cards of one name
are one set. Names become capitals, as the deck means them. Members that no volume element uses are
left out, and sets with nothing else; a note says which. Of porous' own decks come the parts that
were written: pairs are pairs again, and sets that only the deck needs are not read.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import FormatError
from porous.formats._elements import places_in
from porous.formats._sets import MOST, Allowance, Collected, distinct, groups_of
from porous.formats.gate import numbers, refuse, whole
from porous.values import SHAPES, Part

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from porous.formats._elements import Draft
    from porous.formats.gate import Source

    Indices = NDArray[np.int64]

COMMENT = re.compile(rb"^\*\*[^\n]*", re.MULTILINE)
LETTER = re.compile(rb"[^\d\s,.+-]")
"""What lists of numbers alone do not hold."""
COMMAS = bytes.maketrans(b",", b" ")
FACES = {f"S{i + 1}".encode(): i for i in range(MOST)}
MADE = re.compile(rb"^\*\* made by porous; the mesh was in \w+; lengths in (mm|m),", re.MULTILINE)
"""What porous writes at the head of a deck, and how much of a deck is its head."""
HEAD = 512
AT_ONCE = 1 << 17
"""Members of runs that are worked out at once."""
FIRST, SECOND = "_FIRST", "_SECOND"
"""How the names of sets end that hold the nodes of pairs, in order, in decks of porous."""
EVERY = re.compile(r"ALL_CELLS(_\d+)?")

UNKNOWN = "name sets that do not stand before them"
ODD = "are not of elements' faces S1, S2, …"


class Rows(NamedTuple):
    """What the cards of nodes and elements list, for sets that they name."""

    elements: Indices
    """The number in the deck of each cell."""
    nodes: list[Indices]
    """The numbers on each card of nodes."""
    cells: dict[tuple[str, int], Indices]
    """The cells on each card of elements, by kind of element and card."""


class _Known:
    """Numbers in a deck of what the mesh has."""

    def __init__(self, known: Indices) -> None:
        self.order = None if (known[1:] > known[:-1]).all() else np.argsort(known, kind="stable")
        self.known = known if self.order is None else known[self.order]
        if (self.known[1:] == self.known[:-1]).any():
            raise FormatError("*ELEMENT: a number stands twice; wanted each once")

    def places(self, some: Indices) -> Indices:
        """Return what bears each number; -1 for numbers that nothing bears."""
        at = places_in(self.known, some)
        if self.order is None:
            return at
        return np.where(at < 0, -1, self.order[at])

    def find(self, some: Indices) -> Indices:
        """Return what bears some numbers; numbers that nothing bears are left out."""
        at = self.places(some)
        return at[at >= 0]

    def runs(self, runs: Indices, allowance: Allowance) -> Indices:
        """Return what bears first, first + step, … up to last, of runs (n, 3)."""
        low, near = self._near(runs)
        count = np.minimum(near, (runs[:, 1] - runs[:, 0]) // runs[:, 2] + 1)
        allowance.take(int(count.sum()))
        chosen = np.zeros(len(self.known), bool)
        for _, some in groups_of(np.cumsum(count) // AT_ONCE):
            is_few = count[some] < near[some]
            few, others = runs[some[is_few]], some[~is_few]
            at = places_in(self.known, _steps(few[:, 0], few[:, 2], count[some[is_few]]))
            chosen[at[at >= 0]] = True
            at = _steps(low[others], np.ones_like(others), near[others])
            first, step = np.repeat(runs[others][:, ::2], near[others], axis=0).T
            chosen[at[(self.known[at] - first) % step == 0]] = True
        return np.sort(self._at(np.flatnonzero(chosen)))

    def _near(self, runs: Indices) -> tuple[Indices, Indices]:
        """Return where known numbers that runs span begin, and how many they are."""
        low = np.searchsorted(self.known, runs[:, 0])
        return low, np.searchsorted(self.known, runs[:, 1], side="right") - low

    def _at(self, places: Indices) -> Indices:
        return places if self.order is None else self.order[places]


@dataclass
class _Set:
    """The members of a set, card by card, or the reason why it cannot be held."""

    pieces: list[Indices] = field(default_factory=list)
    reason: str = ""
    flat: bool = False
    """Whether elements without volume are in it."""

    def members(self) -> Indices:
        """Return its members in their order, each once."""
        if len(self.pieces) != 1:
            self.pieces = [np.concatenate([np.zeros(0, np.int64), *self.pieces])]
        self.pieces = [distinct(self.pieces[0])]
        return self.pieces[0]


class _Card(NamedTuple):
    """A card that says members of a set."""

    keyword: str
    name: str
    options: Mapping[str, str]
    body: bytes
    kind: str | None = None
    """Of cards of elements: their kind, None where they have no volume."""
    card: int = -1
    """Which of the cards of nodes, or of elements of that kind; -1 for other cards."""


class Sets:
    """The sets of a deck: first what its cards say, then what that is in the mesh."""

    def __init__(self, source: Source) -> None:
        self.source, self.cards = source, list[_Card]()
        self.made = MADE.search(source.data[:HEAD])
        self.found: dict[str, dict[str, _Set]] = {"NSET": {}, "ELSET": {}, "SURFACE": {}}

    def add(self, keyword: str, options: Mapping[str, str], body: bytes) -> None:
        """Add a card ``*NSET``, ``*ELSET`` or ``*SURFACE``."""
        name = _name(options.get("NAME" if keyword == "SURFACE" else keyword, ""))
        if name:
            self.cards.append(_Card(keyword, name, options, body))

    def add_rows(self, keyword: str, name: str, kind: str | None, card: int) -> None:
        """Add what a card of nodes or elements says of its set."""
        if name:
            self.cards.append(_Card(keyword, _name(name), {}, b"", kind, card))

    def parts(self, draft: Draft, rows: Rows) -> tuple[dict[str, Part], str]:
        """Return the parts, and the unit of lengths."""
        allowance = Allowance(self.source)
        chooser = _Chooser(draft, rows, self.found, allowance)
        for card in sorted(self.cards, key=lambda card: card.keyword == "SURFACE"):
            own = self.found[card.keyword].setdefault(card.name, _Set())
            own.flat |= card.card >= 0 and card.kind is None
            if not own.reason:
                own.pieces += chooser.pieces(card, own)
        collected = Collected()
        pairs = self._ours(len(rows.elements)) if self.made else {}
        for keyword, kind in (("ELSET", "cells"), ("SURFACE", "faces"), ("NSET", "nodes")):
            for name, own in self.found[keyword].items():
                if own.reason:
                    collected.leave(name, own.reason)
                    continue
                members = own.members()
                if own.flat and not len(members):
                    continue
                rows_of = np.stack(np.divmod(members, MOST), axis=1)
                collected.add(kind, name, rows_of if kind == "faces" else members)
        for name, some in pairs.items():
            collected.add("pairs", name, some)
        collected.note(self.source)
        return collected.parts, (self.made[1].decode() if self.made else "mm")

    def _ours(self, cells: int) -> dict[str, Indices]:
        """Take out what only a deck of porous needs, and return its pairs."""
        nodes, elements = self.found["NSET"], self.found["ELSET"]
        for card in self.cards:
            if card.keyword == "NSET" and card.card >= 0:  # all nodes, and one of each tie
                nodes.pop(card.name, None)
        pairs = {}
        for name in [n.removesuffix(FIRST) for n in nodes if n.endswith(FIRST)]:
            ends = [nodes[n].members() for n in (name + FIRST, name + SECOND) if n in nodes]
            if len({len(end) for end in ends}) == len(ends) - 1:
                pairs[name] = np.stack(ends, axis=1)
                for other in (name + FIRST, name + SECOND, f"REF_{name}", f"FAR_{name}"):
                    nodes.pop(other, None)
        named = {card.name for card in self.cards if card.keyword == "ELSET" and card.card >= 0}
        for name in [n for n in elements if n in named - {"SOLID"} or EVERY.fullmatch(n)]:
            if name in named or len(elements[name].members()) == cells:
                del elements[name]
        return pairs


class _Chooser:
    """From what a card says to the members of a set."""

    def __init__(
        self, draft: Draft, rows: Rows, found: dict[str, dict[str, _Set]], allowance: Allowance
    ) -> None:
        self.draft, self.rows, self.found, self.allowance = draft, rows, found, allowance
        self.known = {"NSET": _Known(draft.used), "ELSET": _Known(rows.elements)}
        self.ends = np.cumsum([len(block.cells) for block in draft.blocks])
        self.limits = np.array([len(SHAPES[block.shape].faces) for block in draft.blocks])

    def pieces(self, card: _Card, own: _Set) -> list[Indices]:
        """Return members that a card says, or why it says none."""
        if card.card >= 0:
            if card.keyword == "NSET":
                return [self.known["NSET"].find(self.rows.nodes[card.card])]
            found = self.rows.cells.get((card.kind or "", card.card))
            return [] if found is None else [found]  # no element of that kind, or a card of none
        if card.keyword == "SURFACE":
            return self._surface(card, own)
        body = COMMENT.sub(b"", card.body)
        if "GENERATE" in card.options:
            return [self._generated(card.keyword, card.name, body)]
        pieces = list(self._listed(card.keyword, card.name, body, own))
        if card.keyword == "NSET" and (source := _name(card.options.get("ELSET", ""))):
            pieces += [self._nodes_of(cells) for cells in self._named("ELSET", [source], own)]
        return pieces

    def _listed(self, keyword: str, name: str, body: bytes, own: _Set) -> Iterator[Indices]:
        what = f"*{keyword} {name[:20]}"
        known = self.known[keyword]
        if not LETTER.search(body):
            yield known.find(whole(numbers(body.translate(COMMAS), what), what))
            return
        words = [word for word in map(bytes.strip, re.split(rb"[,\n]", body)) if word]
        digits = [word for word in words if not LETTER.search(word)]
        yield known.find(whole(numbers(b" ".join(digits), what), what))
        others = dict.fromkeys(_name(w.decode("latin-1")) for w in words if LETTER.search(w))
        yield from self._named(keyword, list(others), own)

    def _named(self, keyword: str, names: list[str], own: _Set) -> Iterator[Indices]:
        """Give the members of sets, which must stand before."""
        for name in names:
            other = self.found[keyword].get(name)
            if other is None or other is own or other.reason:
                own.reason = UNKNOWN
                return
            members = other.members()
            self.allowance.take(len(members))
            yield members

    def _generated(self, keyword: str, name: str, body: bytes) -> Indices:
        what = f"*{keyword} {name[:20]}, GENERATE"
        text = body.translate(COMMAS)
        values = whole(numbers(text, what), what)
        _, ends = words_in_lines(text)
        count = np.diff(ends, prepend=0)
        first = (ends - count)[count > 0]
        count = count[count > 0]
        if not np.isin(count, (2, 3)).all():
            line = next(line for line in text.split(b"\n") if len(line.split()) not in (0, 2, 3))
            refuse(what, line.decode("latin-1").strip(), "first, last and step")
        step = np.where(count > 2, values[np.minimum(first + 2, len(values) - 1)], 1)
        runs = np.stack([values[first], values[first + 1], step], axis=1)
        for run in runs[(step < 1) | (runs[:, 1] < runs[:, 0])][:1].tolist():
            refuse(what, ", ".join(map(str, run)), "a step of 1 or more, up to the last")
        return self.known[keyword].runs(runs, self.allowance)

    def _nodes_of(self, cells: Indices) -> Indices:
        """Return the nodes of cells."""
        block = np.searchsorted(self.ends, cells, side="right")
        own = [self._rows(index, cells[block == index]) for index in np.unique(block).tolist()]
        self.allowance.take(sum(rows.size for rows in own))
        return np.unique(np.concatenate([np.zeros(0, np.int64), *(rows.ravel() for rows in own)]))

    def _rows(self, index: int, cells: Indices) -> Indices:
        block = self.draft.blocks[index]
        own: Indices = block.cells[cells - (self.ends[index] - len(block.cells))]
        return own

    def _surface(self, card: _Card, own: _Set) -> list[Indices]:
        """Return faces, each as one number."""
        if card.options.get("TYPE", "ELEMENT").upper() != "ELEMENT":
            own.reason = ODD
            return []
        singles: tuple[list[bytes], list[bytes]] = ([], [])
        pieces = []
        for element, face in dict.fromkeys(_lines(COMMENT.sub(b"", card.body).upper())):
            if face not in FACES:
                own.reason = ODD
                return []
            if element.isdigit():
                singles[0].append(element)
                singles[1].append(face)
                continue
            named = self._named("ELSET", [_name(element.decode("latin-1"))], own)
            pieces += [self._faces(card.name, c, np.full(len(c), FACES[face])) for c in named]
            if own.reason:
                return []
        cells = self.known["ELSET"].places(
            whole(numbers(b" ".join(singles[0]), card.name), card.name)
        )
        local = np.array([FACES[face] for face in singles[1]], dtype=np.int64)
        return [self._faces(card.name, cells[cells >= 0], local[cells >= 0]), *pieces]

    def _faces(self, name: str, cells: Indices, local: Indices) -> Indices:
        limits = self.limits[np.searchsorted(self.ends, cells, side="right")]
        if (bad := np.flatnonzero(local >= limits)).size:
            number = self.rows.elements[cells[bad[0]]]
            got = f"S{local[bad[0]] + 1} of element {number}"
            refuse(f"*SURFACE {name[:20]}", got, f"S1 to S{limits[bad[0]]}")
        return cells * MOST + local


def _steps(first: Indices, step: Indices, count: Indices) -> Indices:
    """Return first, first + step, … of each run, so many of each."""
    before = np.cumsum(count) - count
    return np.repeat(first - step * before, count) + np.repeat(step, count) * np.arange(count.sum())


def words_in_lines(text: bytes) -> tuple[Indices, Indices]:
    """Return where words begin, and how many words there are up to the end of each line."""
    codes = np.frombuffer(text, np.uint8)
    word = codes > 32  # white space, as bytes.split() has it, lies below
    begins = np.flatnonzero(word & ~np.concatenate([[False], word[:-1]]))
    return begins, np.append(np.searchsorted(begins, np.flatnonzero(codes == 10)), len(begins))


def _lines(body: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Give what stands before and after the comma of each line."""
    for line in body.split(b"\n"):
        element, _, face = line.partition(b",")
        if element := element.strip():
            yield element, face.strip(b", \t\r")


def _name(text: str) -> str:
    return text.strip().strip('"').upper()
