"""How decks are read: cards, and the tables of nodes and elements.

Read are the nodes and the hexahedra, wedges and tetrahedra of decks that stand in one file,
without instances; hexahedra of 27 nodes by their corners. Lengths are taken as millimetres, but
for decks of porous itself that say metres. Materials and steps are passed over, and so are elements
without a volume. What is read of sets: ``_inp_sets``.
"""

from __future__ import annotations

import re
from itertools import chain, pairwise
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.formats._elements import Draft
from porous.formats._inp_sets import COMMENT, Rows, Sets, words_in_lines
from porous.formats.gate import numbers, refuse, whole

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.formats.gate import Source
    from porous.values import VolumeMesh

    Indices = NDArray[np.int64]

READ = {
    "8": ("hex8", 8),
    "20": ("hex20", 20),
    "27": ("hex8", 27),
    "6": ("wed6", 6),
    "4": ("tet4", 4),
    "10": ("tet10", 10),
}
"""What C3D… is read as, and its nodes."""
VOLUME = re.compile(r"D?C3D(\d+)[A-Z]*")
"""Continuum elements, of stress or (D) of heat, with what the letters say of their integration."""
FLAT = re.compile(
    r"(S\d|STRI|DS\d|M3D|MAX|CP[SEF]|CG?AX|DCAX|S?AX|DC[12]D|T[23]D|B[23]|PIPE|ELBOW|FRAME"
    r"|R[23]D|RAX|RB[23]D|SFM|SFMAX|CONN|SPRING|DASHPOT|MASS|ROTARYI|GAP).*"
)
"""Elements without a volume of their own: shells, planes, trusses, beams, springs, masses."""
ELSEWHERE = {
    "INCLUDE": "all of the deck in one file",
    "INSTANCE": "a deck without instances: Abaqus/CAE writes it where the model's attribute "
    '"Do not use parts and assemblies in input files" is set',
    "SYSTEM": "nodes in the global system",
    **dict.fromkeys(("NGEN", "NFILL", "NCOPY", "NMAP"), "every node written out"),
    **dict.fromkeys(("ELGEN", "ELCOPY"), "every element written out"),
}
"""Cards without which a mesh would not be what its author meant, and what would be right."""
CARD = re.compile(rb"^\*(?!\*)", re.MULTILINE)
LONGEST = 4096
"""The longest card, in characters, over all its lines."""
DATA = bytes.maketrans(b",dD", b" ee")
"""What parts numbers becomes a blank, Fortran's exponents everybody's."""


def read(source: Source) -> VolumeMesh:
    """Read nodes, volume elements and sets; whatever else the deck says is passed over."""
    draft = Draft(source)
    found = _Tables()
    sets = Sets(source)
    for keyword, options, body in _cards(source.data):
        if keyword and not keyword[0].isalpha():
            refuse("card", f"*{keyword[:20]}", "a keyword that begins with a letter")
        if keyword in ELSEWHERE:
            refuse("card", f"*{keyword}", ELSEWHERE[keyword])
        if keyword in ("NODE", "ELEMENT"):
            _check_options(keyword, options)
        if keyword == "NODE":
            found.add("", body, options.get("NSET", ""), sets)
        elif keyword == "ELEMENT":
            found.add(_kind(options), body, options.get("ELSET", ""), sets)
        elif keyword in ("NSET", "ELSET", "SURFACE"):
            sets.add(keyword, options, body)
    return found.mesh(draft, sets)


class _Tables:
    """The lines of nodes (kind "") and elements, card after card, and the sets that they are in."""

    def __init__(self) -> None:
        self.bodies: dict[str, list[bytes]] = {"": []}

    def add(self, kind: str | None, body: bytes, name: str, sets: Sets) -> None:
        """Add a card, and the set that it names; of elements without volume (None) the set only."""
        if kind is None:
            sets.add_rows("ELSET", name, None, 0)
            return
        sets.add_rows("ELSET" if kind else "NSET", name, kind, len(self.bodies.get(kind, ())))
        self.bodies.setdefault(kind, []).append(body)

    def mesh(self, draft: Draft, sets: Sets) -> VolumeMesh:
        """Return the mesh."""
        table, ends = _table(self.bodies.pop(""), 4, "*NODE")
        nodes = whole(table[:, 0], "*NODE")
        draft.add_nodes(nodes, table[:, 1:])
        elements: dict[str, list[Indices]] = {}
        rows: dict[str, list[tuple[str, Indices]]] = {}
        for kind, bodies in self.bodies.items():
            shape, count = READ[kind]
            what = f"*ELEMENT of {count} nodes"
            table, last = _table(bodies, 1 + count, what, spread=True)
            cells = whole(table, what)
            draft.add_cells(shape, cells[:, 1:])
            elements.setdefault(shape, []).append(cells[:, 0].copy())
            rows.setdefault(shape, []).append((kind, last))
        draft.settle()
        numbers = np.concatenate([some for shape in draft.shapes for some in elements[shape]])
        cards: dict[tuple[str, int], Indices] = {}
        start = 0
        for kind, last in (one for shape in draft.shapes for one in rows[shape]):
            pieces = np.split(start + np.arange(last[-1]), last[:-1])
            cards |= {(kind, card): some for card, some in enumerate(pieces)}
            start += int(last[-1])
        parts, unit = sets.parts(draft, Rows(numbers, np.split(nodes, ends[:-1]), cards))
        return draft.mesh(parts, unit)


def _cards(data: bytes) -> Iterator[tuple[str, dict[str, str], bytes]]:
    """Give each card's keyword, its options, and the lines of data that follow it."""
    starts = (match.start() for match in CARD.finditer(data))
    for start, stop in pairwise(chain(starts, [len(data)])):
        end = _line_end(data, start, stop)
        while data[start:end].rstrip().endswith(b",") and end < stop:
            end = _line_end(data, end + 1, stop)
            if end - start > LONGEST:
                raise FormatError(f"a card of more than {LONGEST} characters")
        first, *words = data[start + 1 : min(end, start + LONGEST)].decode("latin-1").split(",")
        pairs = (word.partition("=") for word in words)
        options = {name.strip().upper(): value.strip() for name, _, value in pairs}
        yield " ".join(first.split()).upper(), options, data[end:stop]


def _line_end(data: bytes, start: int, stop: int) -> int:
    end = data.find(b"\n", start, stop)
    return stop if end < 0 else end


def _check_options(keyword: str, options: dict[str, str]) -> None:
    if "INPUT" in options:
        refuse(f"*{keyword} INPUT", options["INPUT"], "all of the deck in one file")
    if (system := options.get("SYSTEM", "R").upper()) != "R":
        refuse(f"*{keyword} SYSTEM", system, "R: nodes as x, y and z")
    if lost := next((name for name in options if not name[:1].isalpha()), None):
        refuse(f"*{keyword}, an option", lost, "a name, and no comma at the end of the card")


def _kind(options: dict[str, str]) -> str | None:
    """Return the number in the name of a volume element, None for what has no volume."""
    name = options.get("TYPE", "").upper()
    if FLAT.fullmatch(name):
        return None
    volume = VOLUME.fullmatch(name)
    if volume is None or volume[1] not in READ:
        refuse("*ELEMENT TYPE", name, "C3D8, C3D20, C3D6, C3D4, C3D10 and their kin")
    return volume[1]


def _table(
    bodies: list[bytes], width: int, what: str, *, spread: bool = False
) -> tuple[NDArray[np.float64], Indices]:
    """Return lines of data as rows of ``width`` numbers, which may be ``spread`` over several.

    A line never holds numbers of two rows, nor do two cards numbers of one, so that a number too
    few or too many is not made up for by the next. Also returns how many rows there are up to the
    end of each card, of none at all as if it were one.
    """
    text = COMMENT.sub(b"", b"".join(bodies)).translate(DATA)
    values = numbers(text, what)
    begins, ends = words_in_lines(text)
    starts = np.append(0, ends[:-1])
    good = (starts // width == (ends - 1) // width) if spread else (ends - starts == width)
    good[starts == ends] = True
    cards = ends[np.cumsum([0, *(body.count(b"\n") for body in bodies)])[1:] - 1]
    if bodies and not bodies[-1].endswith(b"\n"):
        cards[-1] = ends[-1]
    for last in cards[cards % width > 0][:1]:  # the last row of a card lacks numbers
        good[np.flatnonzero(starts < last)[-1:]] = False
    if not good.all() or len(values) != len(begins):
        line = int(np.argmin(good))
        got = text.split(b"\n", line + 1)[line].decode("utf-8", "replace")
        refuse(f"{what}: a line", got.strip(), f"{width} numbers")
    return values.reshape(-1, width), cards // width
