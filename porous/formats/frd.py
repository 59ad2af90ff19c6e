"""FRD: what CalculiX came to, fields at the nodes of a mesh, in text of fixed columns.

Read are nodes, hexahedra, wedges and tetrahedra, and blocks of numbers, vectors and symmetric
tensors at nodes. Of several steps a field is called ``displacement_step_2``, of modes
``displacement_mode_2``. Quantities are in the deck's units. Where the deck was written by porous
its heading says them; other files do not: their fields have no unit, and lengths are taken as
millimetres. Binary files (``*NODE OUTPUT``) are refused.
https://www.dhondt.de/cgx_2.20.pdf, "Result Format"
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import FormatError
from porous.formats._elements import Draft
from porous.formats._registry import Format
from porous.formats.gate import integer, need, numbers, refuse, whole
from porous.values import Field, MeshFields, VolumeMesh
from porous.values.units import system_length

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from porous.formats.gate import Source

ELEMENTS = {1: ("hex8", 8), 2: ("wed6", 6), 3: ("tet4", 4), 4: ("hex20", 20), 6: ("tet10", 10)}
"""What an element's number stands for, and its nodes."""
FLAT = (7, 8, 9, 10, 11, 12)
"""Triangles, quadrangles and lines: passed over."""
MIDDLES = np.array([*range(12), *range(16, 20), *range(12, 16)])
"""Of a hexahedron of 20 nodes: those between bottom and top come before those of the top."""
NAMES = {
    "DISP": "displacement",
    "STRESS": "stress",
    "TOSTRAIN": "strain",
    "FORC": "reaction",
    "NDTEMP": "temperature",
    "FLUX": "heat_flux",
    "RFL": "heat_flow",
    "ERROR": "stress_error_estimate",
}
"""What fields are called here; all others keep their name, in small letters."""
UNITS = {
    "mm-N-MPa": {
        "displacement": "mm",
        "stress": "MPa",
        "strain": "1",
        "reaction": "N",
        "temperature": "K",
        "heat_flux": "mW/mm²",
        "heat_flow": "mW",
    },
    "m-SI": {
        "displacement": "m",
        "stress": "Pa",
        "strain": "1",
        "reaction": "N",
        "temperature": "K",
        "heat_flux": "W/m²",
        "heat_flow": "W",
    },
}
"""Of fields in each system of units that a heading may name."""
HEADING = re.compile(rb" {4}1C[^\n]{,99}\n {4}1Uunits (mm-N-MPa|m-SI): ")
"""How a file begins whose deck has the heading that porous writes."""
MODAL = 2
"""The type of an analysis of frequencies."""
KEY, WORD = 3, 12
"""Characters before the first column of a line, and of a number with a point."""
DIGITS = {0: 5, 1: 10}
"""Characters of a whole number in short and in long files."""
PER_LINE = {5: 15, 10: 10}
"""Nodes of an element in a line, by the characters of each."""
LONGEST = 200
"""The longest line that is no table's, in characters."""
SLAB = 20_000
"""Lines of a table that are read at once."""


class Block(NamedTuple):
    """A field as the file has it."""

    name: str
    frame: int
    """Which of the file's states it belongs to, from 1: a step, or a mode."""
    is_mode: bool
    numbers: NDArray[np.int64]
    """Of the nodes, (n,)."""
    values: NDArray[np.float64]
    """(n,), (n, 3) or (n, 6)."""

    def at(self, nodes: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the values at these nodes, NaN where there are none."""
        order = np.argsort(self.numbers, kind="stable")
        known = self.numbers[order]
        place = np.searchsorted(known, nodes).clip(max=max(len(known) - 1, 0))
        result = np.full((len(nodes), *self.values.shape[1:]), np.nan)
        if len(known):
            found = known[place] == nodes
            result[found] = self.values[order[place[found]]]
        return result


class Content(NamedTuple):
    """A file's mesh, the numbers that its nodes have there, and its fields."""

    mesh: VolumeMesh
    nodes: NDArray[np.int64]
    blocks: tuple[Block, ...]
    units: Mapping[str, str]
    """Of fields, by their names, as far as the file says."""


def read(source: Source) -> MeshFields:
    """Read a mesh and the fields on it."""
    found = content(source)
    several = len({block.frame for block in found.blocks}) > 1
    fields: dict[str, Field] = {}
    for block in found.blocks:
        tail = f"_{'mode' if block.is_mode else 'step'}_{block.frame}"
        name = block.name + (tail if block.is_mode or several else "")
        # The size of a mode says nothing; a later field of a name is the last.
        unit = "" if block.is_mode else found.units.get(block.name, "")
        fields[name] = Field(name, block.at(found.nodes), unit)
    return MeshFields(found.mesh, tuple(fields.values()))


def content(source: Source) -> Content:
    """Return what a file holds."""
    draft = Draft(source)
    data = source.data.replace(b"\r\n", b"\n")
    used: list[NDArray[np.int64]] = []
    blocks: list[Block] = []
    place = 0
    said = HEADING.match(data)
    system = said[1].decode() if said else ""
    while place < len(data):
        line, place = _line(data, place)
        kind = line[:6].strip()
        if kind == b"9999":
            break
        if kind == b"2C":
            body, place = _body(data, place)
            draft.add_nodes(*_nodes(line, body))
        elif kind == b"3C":
            body, place = _body(data, place)
            for shape, cells in _cells(line, body):
                draft.add_cells(shape, cells)
                used.append(cells.ravel())
        elif kind == b"100C":
            body, place = _body(data, place)
            blocks += _block(line, body)
        elif kind[:2] not in (b"1C", b"1U", b"1P", b""):
            refuse("a line", _told(line), "one of 1C, 1U, 1P, 2C, 3C, 100C and 9999")
    else:
        raise FormatError("the file ends before its last line, 9999; did the solver finish?")
    mesh = draft.mesh(unit=system_length(system) if system else "mm")
    nodes = np.unique(np.concatenate(used))
    return Content(mesh, nodes, tuple(blocks), UNITS.get(system, {}))


def _line(data: bytes, place: int) -> tuple[bytes, int]:
    end = data.find(b"\n", place, place + LONGEST)
    if end < 0:
        if len(data) - place > LONGEST:
            refuse("a line", _told(data[place : place + 20]), f"at most {LONGEST} characters")
        end = len(data)
    return data[place:end], end + 1


def _body(data: bytes, place: int) -> tuple[bytes, int]:
    """Return the lines up to the next one that ends a block, and where what follows begins."""
    end = data.find(b"\n -3", place - 1)
    if end < 0:
        raise FormatError("a block without an end; wanted a line -3")
    after = data.find(b"\n", end + 1)
    return data[place : end + 1], len(data) if after < 0 else after + 1


class _Table:
    """Lines of a block, of which columns are read by their place."""

    def __init__(self, body: bytes, what: str) -> None:
        self.codes = np.frombuffer(body, np.uint8)
        self.ends = np.flatnonzero(self.codes == ord("\n"))
        self.starts = np.concatenate([[0], self.ends[:-1] + 1]).astype(np.int64)[: len(self.ends)]
        self.what = what
        room = self.ends - self.starts >= KEY
        self.keys = np.zeros(len(self.starts), np.int64)
        self.keys[room] = self.codes[self.starts[room] + 2] - ord("0")
        head = (self.codes[self.starts[room]] == 32) & (self.codes[self.starts[room] + 1] == 45)
        if not room.all() or not head.all():
            self._refuse(int(np.argmin(room)) if not room.all() else int(np.argmin(head)), "-1, -2")

    def columns(
        self, lines: NDArray[np.int64], first: int, width: int, count: int
    ) -> NDArray[np.float64]:
        """Return the numbers in ``count`` columns from ``first`` on: (lines, count)."""
        short = self.ends[lines] - self.starts[lines] < first + width * count
        if short.any():
            self._refuse(int(lines[np.argmax(short)]), f"{count} columns of {width} characters")
        at = first + width * np.arange(count)[:, None] + np.arange(width)
        rows = [np.zeros((0, count))]
        for start in range(0, len(lines), SLAB):
            own = lines[start : start + SLAB]
            text = np.full((len(own), count, width + 1), ord(" "), np.uint8)
            text[..., 1:] = self.codes[self.starts[own][:, None, None] + at]
            word = text > ord(" ")
            single = (word[..., 1:] & ~word[..., :-1]).sum(axis=2) == 1
            if not single.all():
                self._refuse(int(own[np.argmin(single.all(axis=1))]), "a number in every column")
            rows.append(numbers(text.tobytes(), self.what).reshape(-1, count))
        return np.concatenate(rows)

    def _refuse(self, line: int, wanted: str) -> None:
        got = self.codes[self.starts[line] : self.ends[line]].tobytes()
        refuse(f"{self.what}: a line", _told(got), wanted)


def _nodes(head: bytes, body: bytes) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    table, digits = _Table(body, "nodes"), _digits(head)
    lines = _announced(table, integer(head[24:36], "number of nodes"))
    labels = whole(table.columns(lines, KEY, digits, 1)[:, 0], "a node's number")
    return labels, table.columns(lines, KEY + digits, WORD, 3)


def _announced(table: _Table, count: int) -> NDArray[np.int64]:
    """Return the lines of a block that has as many as its head says, each by itself."""
    lines = np.arange(len(table.starts))
    if len(lines) != count or (table.keys != 1).any():
        refuse(table.what, f"{len(lines)} lines", f"{count} as announced, each with the key -1")
    return lines


def _cells(head: bytes, body: bytes) -> Iterator[tuple[str, NDArray[np.int64]]]:
    table, digits = _Table(body, "elements"), _digits(head)
    heads = np.flatnonzero(table.keys == 1)
    count = integer(head[24:36], "number of elements")
    if len(heads) != count or (len(table.keys) and table.keys[0] != 1):
        refuse("elements", len(heads), f"{count} as announced")
    kinds = whole(table.columns(heads, KEY + digits, 5, 1)[:, 0], "an element's type")
    follow = np.diff(np.append(heads, len(table.keys))) - 1
    for kind in np.unique(kinds).tolist():
        if kind in FLAT:
            continue
        if kind not in ELEMENTS:
            refuse("an element's type", kind, f"one of {', '.join(map(str, ELEMENTS))}")
        shape, nodes = ELEMENTS[kind]
        own = kinds == kind
        most = PER_LINE[digits]
        if (follow[own] != -(-nodes // most)).any():
            refuse(f"elements of type {kind}", "lines of nodes", f"{-(-nodes // most)} for each")
        parts = [
            table.columns(heads[own] + 1 + i, KEY, digits, min(most, nodes - i * most))
            for i in range(-(-nodes // most))
        ]
        cells = whole(np.concatenate(parts, axis=1), "an element's node")
        yield shape, cells[:, MIDDLES] if shape == "hex20" else cells


def _block(head: bytes, body: bytes) -> Iterator[Block]:
    """Give the field of a block; nothing where it is of complex numbers or the like."""
    digits = _digits(head)
    count = integer(head[24:36], "number of values")
    frame = integer(head[58:63], "number of the step")
    mode = integer(head[56:58], "type of the analysis") == MODAL
    line, place = _line(body, 0)
    name = line[5:13].strip().decode("ascii", "replace")
    if line[:3] != b" -4":
        refuse("a block", _told(line), "a line -4 with its name")
    width = 0
    for _ in range(integer(line[13:18], f"components of {name}")):
        line, place = _line(body, place)
        if line[:3] != b" -5":
            refuse(f"components of {name}", _told(line), "a line -5 for each")
        width += line[33:38].strip() != b"1"  # one that is worked out from the others is not there
    if width not in (1, 3, 6):
        return
    table = _Table(body[place:], name)
    need(count, len(table.starts), name, unit="lines")
    lines = _announced(table, count)
    labels = whole(table.columns(lines, KEY, digits, 1)[:, 0], f"{name}: a node's number")
    values = table.columns(lines, KEY + digits, WORD, width)
    yield Block(_named(name), frame, mode, labels, values[:, 0] if width == 1 else values)


def _named(name: str) -> str:
    return NAMES.get(name) or re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "field"


def _digits(head: bytes) -> int:
    kind = integer(head[73:75], "format")
    if kind not in DIGITS:
        refuse("format", kind, "0 or 1, text: *NODE FILE and *EL FILE write it")
    return DIGITS[kind]


def _told(line: bytes) -> str:
    return line.decode("utf-8", "replace").strip()


FORMAT = Format("CalculiX results", (".frd",), MeshFields, read)
