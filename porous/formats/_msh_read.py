"""How Gmsh's files are read: sections, and their numbers in text or binary of either order.

Read are the nodes and the hexahedra, prisms and tetrahedra; hexahedra of 27 nodes by their corners.
An element that version 2.2 lists once for each of its groups is one cell. What is read of groups
and of what is periodic: ``_msh_groups``.
"""

from __future__ import annotations

import re
from array import array
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from porous.errors import FormatError
from porous.formats._elements import Draft
from porous.formats._msh_groups import NODES, Elements, group_names
from porous.formats.gate import TOKEN, integer, need, numbers, refuse, whole
from porous.values.units import METRES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.formats.gate import Source
    from porous.values import VolumeMesh

    Indices = NDArray[np.int64]

OTHERS = {
    7: "pyramid",
    13: "prism of 18 nodes",
    14: "pyramid of 14 nodes",
    18: "prism of 15 nodes",
    19: "pyramid of 13 nodes",
}
"""Names for the commonest of what is refused."""
SECTIONS = ("MeshFormat", "Nodes", "Elements")
MORE = ("Comments", "PhysicalNames", "Entities", "Periodic")
"""Sections that are read where they are there."""
UNIT = re.compile(rb"made by porous; lengths in (\w{1,4})[\r\n]")
AFFINE = re.compile(rb"Affine[^\n]*")
SECTION = re.compile(rb"\s*\$(\w{1,64})[^\S\n]*\n")
TAGS = 512
"""The most tags of an element: its groups and the parts of a partition that touch it."""


def read(source: Source) -> VolumeMesh:
    """Read nodes, volume elements, groups and what is periodic."""
    sections = _sections(source.data)
    if missing := [name for name in SECTIONS if name not in sections]:
        refuse("sections", ", ".join(sections), ", ".join(missing))
    version, order, width = _header(sections["MeshFormat"])
    elements = Elements(Draft(source))
    elements.names = group_names(sections.pop("PhysicalNames", b"0"))
    unit = UNIT.match(sections.get("Comments", b""))
    for name, act in LAYOUTS[version].items():
        if name not in sections:
            continue
        body = sections.pop(name)
        packed = order is not None and act is not _periodic_2  # which is always text
        words = _Binary(body, name, order or "", width) if packed else _Text(body, name)
        act(words, elements)
        words.end()
    return elements.mesh(unit[1].decode() if unit and unit[1].decode() in METRES else "mm")


def _sections(data: bytes) -> dict[str, bytes]:
    """Return what stands in the sections that are read; others are passed over."""
    found, place = {}, 0
    while match := SECTION.match(data, place):
        name = match[1].decode("latin-1")
        stop = data.find(b"$End" + match[1], match.end())
        if stop < 0:
            raise FormatError(f"${name} has no $End{name}")
        if name in found and name != "Comments":
            raise FormatError(f"${name} stands twice; wanted it once")
        if name in (*SECTIONS, *MORE) and name not in found:
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

    def integers(self, count: int) -> list[int]:
        """Return so many integers, which version 4.1 makes narrow."""

    def size(self) -> int:
        """Return a size."""

    def block(self) -> list[int]:
        """Return what a block of version 4.1 begins with: three integers, and how many it holds."""

    def sizes(self, count: int) -> NDArray[np.int64]:
        """Return so many sizes and numbers of nodes, which version 4.1 makes wide."""

    def reals(self, count: int) -> NDArray[np.float64]:
        """Return so many coordinates."""

    def nodes(self, count: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return numbers and places of nodes as version 2.2 has them."""

    def elements(self, count: int) -> Iterator[tuple[int, Indices, Indices]]:
        """Give the types, groups and nodes of elements as version 2.2 has them; group 0 is none."""

    def end(self) -> None:
        """Refuse a section that holds more than it says."""


class _Text:
    def __init__(self, body: bytes, name: str) -> None:
        text = AFFINE.sub(b"", body) if name == "Periodic" else body
        self.values, self.name, self.place = numbers(text, name), name, 0

    @property
    def left(self) -> int:
        return len(self.values) - self.place

    def reals(self, count: int) -> NDArray[np.float64]:
        need(count, self.left, self.name, unit="numbers")
        self.place += count
        return self.values[self.place - count : self.place]

    def sizes(self, count: int) -> NDArray[np.int64]:
        return whole(self.reals(count), self.name)

    def integers(self, count: int) -> list[int]:
        result: list[int] = self.sizes(count).tolist()
        return result

    def block(self) -> list[int]:
        return self.integers(4)

    def size(self) -> int:
        return int(self.sizes(1)[0])

    def count(self) -> int:
        return int(self.sizes(1)[0])

    def nodes(self, count: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        table = self.reals(4 * count).reshape(-1, 4)
        return whole(table[:, 0], self.name), table[:, 1:]

    def elements(self, count: int) -> Iterator[tuple[int, Indices, Indices]]:
        words = self.sizes(self.left)
        kinds, tags = words[1:-1], words[2:]
        known = np.array([NODES.get(kind, 0) for kind in range(max(NODES) + 1)])
        nodes = known[np.where((kinds > 0) & (kinds < len(known)), kinds, 0)]
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
        there, first = np.unique(kinds[begins], return_index=True)
        for kind in there[np.argsort(first)].tolist():
            some = begins[kinds[begins] == kind]
            groups = np.where(tags[some] > 0, words[some + 3], 0)
            yield kind, groups, words[(some + 3 + tags[some])[:, None] + np.arange(NODES[kind])]

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

    def integers(self, count: int) -> list[int]:
        result: list[int] = self.take("i4", count).tolist()
        return result

    def block(self) -> list[int]:
        return [*self.integers(3), self.size()]

    def size(self) -> int:
        return int(self.sizes(1)[0])

    def count(self) -> int:
        line = self.body[self.place : self.place + TOKEN].partition(b"\n")[0]
        self.place += len(line) + 1
        return integer(line, self.name)

    def nodes(self, count: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        table = self.take([("number", "i4"), ("place", "f8", 3)], count)
        return table["number"].astype(np.int64), table["place"].astype(np.float64)

    def elements(self, count: int) -> Iterator[tuple[int, Indices, Indices]]:
        while count > 0:
            kind, run, tags = self.take("i4", 3).tolist()
            if not 0 < run <= count:
                refuse("elements of one kind", run, f"1 to {count}, what is left of them")
            width = _check_tags(tags) + 1 + _nodes_of(kind)
            rows = self.take("i4", run * width).reshape(run, width)
            yield kind, rows[:, 1] if tags else np.zeros(run, np.int64), rows[:, 1 + tags :]
            count -= run

    def end(self) -> None:
        if self.body[self.place :].strip():
            left = len(self.body) - self.place
            refuse(self.name, f"{left} bytes more", "as many as the section says")


def _nodes_2(words: _Words, elements: Elements) -> None:
    elements.draft.add_nodes(*words.nodes(words.count()))


def _elements_2(words: _Words, elements: Elements) -> None:
    for kind, groups, nodes in words.elements(words.count()):
        labels = np.abs(groups.astype(np.int64))
        elements.add(kind, labels[:0], nodes.astype(np.int64), labels)


def _periodic_2(words: _Words, elements: Elements) -> None:
    for _ in range(words.count()):
        dimension, _, _, count = words.integers(4)
        elements.link(dimension, words.sizes(2 * count).reshape(-1, 2))


def _entities_4(words: _Words, elements: Elements) -> None:
    for dimension, count in enumerate(words.sizes(4).tolist()):
        for _ in range(count):
            (number,) = words.integers(1)
            words.reals(6 if dimension else 3)
            groups = {abs(group) for group in words.integers(words.size())}
            elements.entities[dimension, number] = tuple(sorted(groups))
            words.integers(words.size() if dimension else 0)  # what bounds it


def _nodes_4(words: _Words, elements: Elements) -> None:
    blocks, total, *_ = words.sizes(4).tolist()
    for _ in range(blocks):
        dimension, _, parametric, count = words.block()
        if parametric and not 0 <= dimension <= 3:
            refuse("dimension of nodes", dimension, "0 to 3")
        width = 3 + (dimension if parametric else 0)
        labels = words.sizes(count)
        elements.draft.add_nodes(labels, words.reals(count * width).reshape(count, width)[:, :3])
        total -= count
    _check_total(total, "nodes")


def _elements_4(words: _Words, elements: Elements) -> None:
    blocks, total, *_ = words.sizes(4).tolist()
    for _ in range(blocks):
        dimension, entity, kind, count = words.block()
        width = 1 + _nodes_of(kind)
        rows = words.sizes(count * width).reshape(count, width)
        label = np.full(count, elements.combined(dimension, entity))
        elements.add(kind, rows[:, 0], rows[:, 1:], label)
        total -= count
    _check_total(total, "elements")


def _periodic_4(words: _Words, elements: Elements) -> None:
    for _ in range(words.size()):
        dimension, _, _ = words.integers(3)
        words.reals(words.size())  # the map, which the nodes say too
        elements.link(dimension, words.sizes(2 * words.size()).reshape(-1, 2))


LAYOUTS = {
    "2.2": {"Nodes": _nodes_2, "Elements": _elements_2, "Periodic": _periodic_2},
    "4.1": {
        "Entities": _entities_4,
        "Nodes": _nodes_4,
        "Elements": _elements_4,
        "Periodic": _periodic_4,
    },
}


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
