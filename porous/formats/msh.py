"""MSH: meshes of Gmsh, versions 2.2 and 4.1, in text or binary of either byte order.

Written is 4.1 as text, with every part: cells and faces (seen from outside) in physical groups of
their names, parts of nodes as points where they are not just the nodes of a part of faces, parts of
pairs as periodic entities where faces lie on both sides. The unit is a comment; lengths are in it.
Nodes and cells bear the mesh's numbers, from 1. In names quotes, dollars, backslashes and what is
not ASCII become underscores. Tags are not written.

Read are the nodes and the hexahedra, prisms and tetrahedra; hexahedra of 20 and 27 nodes by their
corners. Points, lines and faces are passed over, and so are physical groups: an element that
version 2.2 lists once for each of its groups is one cell.
https://gmsh.info/doc/texinfo/gmsh.html#Gmsh-file-formats
"""

from __future__ import annotations

import re
from array import array
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from porous.errors import FormatError
from porous.formats._elements import Draft
from porous.formats._msh_write import write_4
from porous.formats._registry import Format
from porous.formats.gate import TOKEN, integer, need, numbers, refuse, whole
from porous.values import VolumeMesh

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.formats.gate import Source

VOLUMES = {
    4: ("tet4", 4),
    5: ("hex8", 8),
    6: ("wed6", 6),
    11: ("tet10", 10),
    12: ("hex8", 27),
    17: ("hex8", 20),
}
"""What element types are read as, and their nodes."""
FLAT = {1: 2, 2: 3, 3: 4, 8: 3, 9: 6, 10: 9, 15: 1, 16: 8}
"""Nodes of points, lines and faces up to the second order."""
NODES = FLAT | {kind: nodes for kind, (_, nodes) in VOLUMES.items()}
OTHERS = {
    7: "pyramid",
    13: "prism of 18 nodes",
    14: "pyramid of 14 nodes",
    18: "prism of 15 nodes",
    19: "pyramid of 13 nodes",
}
"""Names for the commonest of what is refused."""
TET10 = [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]
"""Gmsh's quadratic tetrahedron in VTK's order."""
SECTIONS = ("MeshFormat", "Nodes", "Elements")
SECTION = re.compile(rb"\s*\$(\w{1,64})[^\S\n]*\n")
TAGS = 512
"""The most tags of an element: its groups and the parts of a partition that touch it."""


def read(source: Source) -> VolumeMesh:
    """Read nodes and volume elements of a mesh."""
    sections = _sections(source.data)
    if missing := [name for name in SECTIONS if name not in sections]:
        refuse("sections", ", ".join(sections), ", ".join(missing))
    version, order, width = _header(sections["MeshFormat"])
    draft = Draft(source)
    for name, act in LAYOUTS[version].items():
        body = sections.pop(name)
        words = _Text(body, name) if order is None else _Binary(body, name, order, width)
        act(words, draft)
        words.end()
    return draft.mesh()


def _sections(data: bytes) -> dict[str, bytes]:
    """Return what stands in the sections that are read; others are passed over."""
    found, place = {}, 0
    while match := SECTION.match(data, place):
        name = match[1].decode("latin-1")
        stop = data.find(b"$End" + match[1], match.end())
        if stop < 0:
            raise FormatError(f"${name} has no $End{name}")
        if name in found:
            raise FormatError(f"${name} stands twice; wanted it once")
        if name in SECTIONS:
            found[name] = data[match.end() : stop]
        place = stop + len(match[1]) + 4
    if rest := data[place : place + 64].strip():
        refuse("sections", rest.decode("utf-8", "replace"), "$ and the name of a section")
    return found


def _header(body: bytes) -> tuple[str, str | None, int]:
    """Return the version, the byte order of what is binary, and the bytes of a size."""
    line, _, rest = body.partition(b"\n")
    words = line[:TOKEN].decode("utf-8", "replace").split()
    if len(words) != 3 or words[0] not in LAYOUTS or words[2] not in ("4", "8"):
        refuse("$MeshFormat", " ".join(words), "version 2.2 or 4.1, 0 or 1, and 8")
    orders = {b"\1\0\0\0": "<", b"\0\0\0\1": ">"}
    if words[1] == "0":
        return words[0], None, 0
    if words[1] != "1" or rest[:4] not in orders:
        refuse("$MeshFormat", rest[:4], "a one of four bytes, as binary files begin")
    return words[0], orders[rest[:4]], int(words[2])


class _Words(Protocol):
    """The numbers of a section, one after another."""

    def count(self) -> int:
        """Return how many there are of something, as version 2.2 says it: always in text."""

    def block(self) -> list[int]:
        """Return what a block of version 4.1 begins with: three integers, and how many it holds."""

    def sizes(self, count: int) -> NDArray[np.int64]:
        """Return so many sizes and numbers of nodes, which version 4.1 makes wide."""

    def reals(self, count: int) -> NDArray[np.float64]:
        """Return so many coordinates."""

    def nodes(self, count: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return numbers and places of nodes as version 2.2 has them."""

    def elements(self, count: int) -> Iterator[tuple[int, NDArray[np.int64]]]:
        """Give the types and nodes of elements as version 2.2 has them."""

    def end(self) -> None:
        """Refuse a section that holds more than it says."""


class _Text:
    def __init__(self, body: bytes, name: str) -> None:
        self.values, self.name, self.place = numbers(body, name), name, 0

    @property
    def left(self) -> int:
        return len(self.values) - self.place

    def reals(self, count: int) -> NDArray[np.float64]:
        need(count, self.left, self.name, unit="numbers")
        self.place += count
        return self.values[self.place - count : self.place]

    def sizes(self, count: int) -> NDArray[np.int64]:
        return whole(self.reals(count), self.name)

    def block(self) -> list[int]:
        result: list[int] = self.sizes(4).tolist()
        return result

    def count(self) -> int:
        return int(self.sizes(1)[0])

    def nodes(self, count: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        table = self.reals(4 * count).reshape(-1, 4)
        return whole(table[:, 0], self.name), table[:, 1:]

    def elements(self, count: int) -> Iterator[tuple[int, NDArray[np.int64]]]:
        words = self.sizes(self.left)
        kinds, tags = words[1:-1], words[2:]
        nodes = np.zeros(len(kinds), np.int64)
        for kind, number in NODES.items():
            nodes[kinds == kind] = number
        good = (nodes > 0) & (tags >= 0) & (tags < TAGS)
        steps = np.where(good, 3 + tags + nodes, 0).tolist()  # to the next, if one begins here
        starts, place = array("q"), 0
        for _ in range(count):
            need(3, len(words) - place, self.name, unit="numbers")
            if not steps[place]:
                _check_tags(int(tags[place]))
                _nodes_of(int(kinds[place]))
            starts.append(place)
            place += steps[place]
        need(place, len(words), self.name, unit="numbers")
        self.place -= len(words) - place
        begins = np.array(starts, dtype=np.int64)
        for kind in np.unique(kinds[begins]).tolist():
            some = begins[kinds[begins] == kind]
            yield kind, words[(some + 3 + tags[some])[:, None] + np.arange(NODES[kind])]

    def end(self) -> None:
        if self.left:
            refuse(self.name, f"{self.left} numbers more", "as many as the section says")


class _Binary:
    def __init__(self, body: bytes, name: str, order: str, width: int) -> None:
        self.body, self.name, self.place = body, name, 0
        self.order, self.width = order, width

    def take(self, form: Any, count: int) -> NDArray[Any]:
        kind = np.dtype(form).newbyteorder(self.order)
        need(count * kind.itemsize, len(self.body) - self.place, self.name)
        self.place += count * kind.itemsize
        return np.frombuffer(self.body, kind, count, self.place - count * kind.itemsize)

    def reals(self, count: int) -> NDArray[np.float64]:
        return self.take("f8", count).astype(np.float64)

    def sizes(self, count: int) -> NDArray[np.int64]:
        values = self.take(f"u{self.width}", count)
        if values.size and values.max() > np.iinfo(np.int64).max:
            refuse(self.name, int(values.max()), "at most 2^63 - 1")
        return values.astype(np.int64)

    def block(self) -> list[int]:
        return [*self.take("i4", 3).tolist(), *self.sizes(1).tolist()]

    def count(self) -> int:
        line = self.body[self.place : self.place + TOKEN].partition(b"\n")[0]
        self.place += len(line) + 1
        return integer(line, self.name)

    def nodes(self, count: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        table = self.take([("number", "i4"), ("place", "f8", 3)], count)
        return table["number"].astype(np.int64), table["place"].astype(np.float64)

    def elements(self, count: int) -> Iterator[tuple[int, NDArray[np.int64]]]:
        while count > 0:
            kind, run, tags = self.take("i4", 3).tolist()
            if not 0 < run <= count:
                refuse("elements of one kind", run, f"1 to {count}, what is left of them")
            width = _check_tags(tags) + 1 + _nodes_of(kind)
            yield kind, self.take("i4", run * width).reshape(run, width)[:, 1 + tags :]
            count -= run

    def end(self) -> None:
        if self.body[self.place :].strip():
            left = len(self.body) - self.place
            refuse(self.name, f"{left} bytes more", "as many as the section says")


def _nodes_2(words: _Words, draft: Draft) -> None:
    draft.add_nodes(*words.nodes(words.count()))


def _elements_2(words: _Words, draft: Draft) -> None:
    cells: dict[int, list[NDArray[np.int64]]] = {}
    for kind, nodes in words.elements(words.count()):
        cells.setdefault(kind, []).append(nodes)
    for kind, runs in cells.items():
        nodes = np.concatenate(runs)
        _, first = np.unique(nodes, axis=0, return_index=True)
        _add(draft, kind, nodes[np.sort(first)].astype(np.int64))


def _nodes_4(words: _Words, draft: Draft) -> None:
    blocks, total, *_ = words.sizes(4).tolist()
    for _ in range(blocks):
        dimension, _, parametric, count = words.block()
        if parametric and not 0 <= dimension <= 3:
            refuse("dimension of nodes", dimension, "0 to 3")
        width = 3 + (dimension if parametric else 0)
        labels = words.sizes(count)
        draft.add_nodes(labels, words.reals(count * width).reshape(count, width)[:, :3])
        total -= count
    _check_total(total, "nodes")


def _elements_4(words: _Words, draft: Draft) -> None:
    blocks, total, *_ = words.sizes(4).tolist()
    for _ in range(blocks):
        _, _, kind, count = words.block()
        width = 1 + _nodes_of(kind)
        _add(draft, kind, words.sizes(count * width).reshape(count, width)[:, 1:])
        total -= count
    _check_total(total, "elements")


LAYOUTS = {
    "2.2": {"Nodes": _nodes_2, "Elements": _elements_2},
    "4.1": {"Nodes": _nodes_4, "Elements": _elements_4},
}


def _add(draft: Draft, kind: int, nodes: NDArray[np.int64]) -> None:
    if kind in VOLUMES:
        shape, _ = VOLUMES[kind]
        draft.add_cells(shape, nodes[:, TET10] if shape == "tet10" else nodes)


def _nodes_of(kind: int) -> int:
    if kind not in NODES:
        got = f"{kind} {OTHERS.get(kind, '')}".rstrip()
        refuse(
            "element type",
            got,
            "hexahedra or tetrahedra of first or second order, or prisms of six nodes",
        )
    return NODES[kind]


def _check_tags(count: int) -> int:
    if not 0 <= count < TAGS:
        refuse("tags of an element", count, f"0 to {TAGS - 1}")
    return count


def _check_total(missing: int, what: str) -> None:
    if missing:
        raise FormatError(f"the blocks hold {-missing:+} {what} beside what the section says")


FORMAT = Format("Gmsh mesh", (".msh",), VolumeMesh, read, (VolumeMesh,), write_4)
