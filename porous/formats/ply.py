"""PLY: points and polygons with properties, in text or binary; what scanners and meshers exchange.

Read: text, and binary of either byte order; polygons are fanned about their first corner; elements
and properties that are not asked for are stepped over. Written: binary, little-endian, points in
double precision, triangles, and, where there are several parts, each one's as the face property
``label``; the parts' names and the unit are comments, so what is written reads back equal.
"""

from __future__ import annotations

import json
from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.errors import FormatError
from porous.formats._registry import Format
from porous.formats.gate import HEADER, integer, need, numbers, refuse, whole
from porous.values import SurfaceMesh
from porous.values.units import METRES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from numpy.typing import NDArray

    from porous.formats.gate import Source

NAMES = {
    "i1": ("char", "int8"),
    "u1": ("uchar", "uint8"),
    "i2": ("short", "int16"),
    "u2": ("ushort", "uint16"),
    "i4": ("int", "int32"),
    "u4": ("uint", "uint32"),
    "f4": ("float", "float32"),
    "f8": ("double", "float64"),
}
TYPES = {name: form for form, names in NAMES.items() for name in names}
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
CORNERS = ("vertex_indices", "vertex_index")
ONE_PART = ("WALL",)
"""A surface of one part has no labels: not every reader knows properties of faces."""
SLAB = 100_000
END = b"end_header"


@dataclass(frozen=True)
class _Property:
    name: str
    type: str
    count: str | None = None
    """The type of a list's length; None where the property is one number."""


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]


@dataclass(frozen=True)
class _Table:
    """One element's columns: plain ones as arrays; a list as its lengths and its entries."""

    columns: Mapping[str, NDArray[Any]]
    lengths: Mapping[str, NDArray[np.int64]]


def read(source: Source) -> SurfaceMesh:
    """Read points and faces; refuse what the header promises and the bytes do not hold."""
    order, elements, comments, start = _header(source.data)
    stream = _Binary(source.data, start, order) if order else _Text(source.data[start:])
    tables = {element.name: stream.table(element) for element in elements}
    if stream.left:
        source.note(f"{stream.left} follow the last element; they are left out")
    if "vertex" not in tables or "face" not in tables:
        refuse("elements", ", ".join(tables), "vertex and face")
    return _surface(tables["vertex"], tables["face"], comments)


def write(surface: SurfaceMesh) -> Iterator[bytes]:
    """Write binary little-endian PLY."""
    triangles, labels = surface.triangles, surface.labels
    assert labels is not None
    slabs = [slice(a, a + SLAB) for a in range(0, len(triangles), SLAB)]
    return stream(
        surface.unit,
        surface.names,
        (len(surface.points), len(triangles)),
        [surface.points],
        ((triangles[slab], labels[slab]) for slab in slabs),
    )


def stream(
    unit: str,
    names: tuple[str, ...],
    counts: tuple[int, int],
    points: Iterable[NDArray[np.float64]],
    faces: Iterable[tuple[NDArray[np.int64], NDArray[np.int16]]],
) -> Iterator[bytes]:
    """Write a surface that comes piece by piece: the bytes that ``write`` gives of the whole.

    Parameters
    ----------
    unit, names
        As in ``SurfaceMesh``.
    counts
        How many points and triangles there are in all.
    points
        float64, shape (n, 3), piece after piece.
    faces
        Triangles (t, 3) of points counted over all pieces, and their labels (t,).

    Raises
    ------
    FormatError
        For more points than the format can number.
    """
    if counts[0] > np.iinfo(np.uint32).max:
        raise FormatError(f"{counts[0]} points; wanted at most {np.iinfo(np.uint32).max} for PLY")
    index = "int" if counts[0] <= np.iinfo(np.int32).max else "uint"
    return _stream(_heading(unit, names, counts, index), _face(names, index), points, faces)


def _face(names: tuple[str, ...], index: str) -> np.dtype[Any]:
    form = [("n", "u1"), ("corners", f"<{TYPES[index]}", 3)]
    return np.dtype(form if names == ONE_PART else [*form, ("label", "<i4")])


def _stream(
    heading: str,
    form: np.dtype[Any],
    points: Iterable[NDArray[np.float64]],
    faces: Iterable[tuple[NDArray[np.int64], NDArray[np.int16]]],
) -> Iterator[bytes]:
    yield heading.encode("ascii")
    for piece in points:
        yield piece.astype("<f8", copy=False).tobytes()
    for triangles, labels in faces:
        rows = np.empty(len(triangles), form)
        rows["n"], rows["corners"] = 3, triangles
        if "label" in form.fields:  # type: ignore[operator]
            rows["label"] = labels
        yield rows.tobytes()


def _heading(unit: str, names: tuple[str, ...], counts: tuple[int, int], index: str) -> str:
    parts = () if names == ONE_PART else names
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment unit {unit}",
        *(f"comment label {json.dumps(name)}" for name in parts),
        f"element vertex {counts[0]}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element face {counts[1]}",
        f"property list uchar {index} vertex_indices",
        *["property int label"] * bool(parts),
        END.decode(),
    ]
    return "\n".join(lines) + "\n"


def _header(data: bytes) -> tuple[str, list[_Element], list[str], int]:
    if not data.startswith(b"ply"):
        refuse("first word", data[:8].decode("latin-1"), "ply")
    stop = data.find(b"\n" + END, 0, HEADER)
    line = data.find(b"\n", stop + 1, stop + 16)
    if stop < 0 or line < 0:
        raise FormatError(f"no {END.decode()} within {HEADER} bytes")
    lines = data[:stop].decode("latin-1").splitlines()
    words = [line.split() for line in lines[1:]]
    order = _order([line for line in words if line[:1] == ["format"]])
    comments = [line[8:] for line in lines if line.startswith("comment ")]
    return order, _elements(words), comments, line + 1


def _order(lines: list[list[str]]) -> str:
    got = lines[0][1] if len(lines) == 1 and len(lines[0]) > 1 else None
    if got not in ORDERS:
        refuse("format", got, f"one of {', '.join(ORDERS)}, once")
    return ORDERS[got]


def _elements(lines: list[list[str]]) -> list[_Element]:
    found: list[tuple[str, int, list[_Property]]] = []
    for words in lines:
        if words[:1] == ["element"] and len(words) == 3:
            found.append((words[1], _count(words), []))
        elif words[:1] == ["property"] and found:
            found[-1][2].append(_property(words[1:]))
        elif words[:1] not in ([], ["comment"], ["obj_info"], ["format"]):
            refuse("header", " ".join(words), "element name count, or property type name")
    return [_element(*parts) for parts in found]


def _count(words: list[str]) -> int:
    count = integer(words[2], f"count of {words[1]}")
    if count < 0:
        refuse(f"count of {words[1]}", count, "zero or more")
    return count


def _property(words: list[str]) -> _Property:
    form = words[1:-1] if words[:1] == ["list"] else words[:-1]
    wanted = 2 if words[:1] == ["list"] else 1
    if len(form) != wanted or any(word not in TYPES for word in form):
        refuse("property", " ".join(words), f"[list] types of {', '.join(TYPES)}, and a name")
    types = [TYPES[word] for word in form]
    if wanted == 2 and types[0][0] == "f":
        refuse(f"list {words[-1]}", words[1], "a whole number to count with")
    return _Property(words[-1], types[-1], types[0] if wanted == 2 else None)


def _element(name: str, count: int, properties: list[_Property]) -> _Element:
    names = [item.name for item in properties]
    if len(set(names)) < len(names):
        refuse(f"properties of {name}", ", ".join(names), "each name once")
    if count and not properties:
        raise FormatError(f"element {name}: {count} of them, without a property")
    return _Element(name, count, tuple(properties))


class _Binary:
    """The elements of a binary file, taken one after the other."""

    def __init__(self, data: bytes, place: int, order: str) -> None:
        self.data, self.place, self.order = data, place, order

    @property
    def left(self) -> str:
        over = len(self.data) - self.place
        return f"{over} bytes" if over else ""

    def table(self, element: _Element) -> _Table:
        least = sum(np.dtype(p.count or p.type).itemsize for p in element.properties)
        need(element.count * least, len(self.data) - self.place, f"{element.count} {element.name}")
        # Nearly every file's lists are all as long as the first one: then rows have one size.
        return self._even(element) or self._walk(element)

    def _even(self, element: _Element) -> _Table | None:
        row, lengths = self._row(element)
        if element.count * row.itemsize > len(self.data) - self.place:
            if lengths:
                return None
            need(element.count * row.itemsize, len(self.data) - self.place, element.name)
        rows = np.frombuffer(self.data, row, element.count, self.place)
        if any((rows[f"{name} length"] != length).any() for name, length in lengths.items()):
            return None
        self.place += rows.nbytes
        columns = {p.name: rows[p.name].reshape(-1) for p in element.properties}
        return _Table(columns, {n: np.full(element.count, k) for n, k in lengths.items()})

    def _row(self, element: _Element) -> tuple[np.dtype[Any], dict[str, int]]:
        fields: list[Any] = []
        lengths: dict[str, int] = {}
        place = self.place
        for item in element.properties:
            form = np.dtype(self.order + item.type)
            if item.count is None:
                fields.append((item.name, form))
            else:
                count = np.dtype(self.order + item.count)
                lengths[item.name] = self._length(place, count, form) if element.count else 0
                place += count.itemsize
                fields += [(f"{item.name} length", count), (item.name, form, lengths[item.name])]
            place += form.itemsize * lengths.get(item.name, 1)
        return np.dtype(fields), lengths

    def _length(self, place: int, count: np.dtype[Any], form: np.dtype[Any]) -> int:
        need(count.itemsize, len(self.data) - place, "the length of a list")
        length = int(np.frombuffer(self.data, count, 1, place)[0])
        need(length * form.itemsize, len(self.data) - place - count.itemsize, "a list")
        return length

    def _walk(self, element: _Element) -> _Table:
        plan = [
            (p.name, np.dtype(self.order + p.type), p.count and np.dtype(self.order + p.count))
            for p in element.properties
        ]
        parts = {name: bytearray() for name, _, _ in plan}
        lengths = {name: array("q") for name, _, count in plan if count}
        for _ in range(element.count):
            for name, form, count in plan:
                length = 1
                if count:
                    length = self._length(self.place, count, form)
                    lengths[name].append(length)
                    self.place += count.itemsize
                size = length * form.itemsize
                need(size, len(self.data) - self.place, f"{element.name} {name}")
                parts[name] += self.data[self.place : self.place + size]
                self.place += size
        columns = {name: np.frombuffer(parts[name], form) for name, form, _ in plan}
        return _Table(columns, {name: np.array(k) for name, k in lengths.items()})


class _Text:
    """The elements of a text file, taken one after the other from its stream of numbers."""

    def __init__(self, text: bytes) -> None:
        self.values, self.place = numbers(text, "numbers"), 0

    @property
    def left(self) -> str:
        over = len(self.values) - self.place
        return f"{over} numbers" if over else ""

    def table(self, element: _Element) -> _Table:
        least = element.count * len(element.properties)
        self._need(least, f"{element.count} {element.name}")
        even = self._even(element) if element.count else None
        return even or self._walk(element)

    def _need(self, count: int, what: str) -> None:
        need(count, len(self.values) - self.place, what, unit="numbers")

    def _even(self, element: _Element) -> _Table | None:
        """Return the table where every row is as long as the first one."""
        columns, lengths, place = {}, {}, 0
        first = self.values[self.place :]
        for item in element.properties:
            length = 1
            if item.count:
                length = lengths[item.name] = self._length(self.place + place, item.name)
                place += 1
            columns[item.name] = slice(place, place + length)
            place += length
        if element.count * place > len(first):
            return None
        rows = first[: element.count * place].reshape(element.count, place)
        if any((rows[:, columns[n].start - 1] != k).any() for n, k in lengths.items()):
            return None
        self.place += rows.size
        flat = {name: rows[:, columns[name]].reshape(-1) for name in columns}
        return _Table(flat, {n: np.full(element.count, k) for n, k in lengths.items()})

    def _length(self, place: int, name: str) -> int:
        if place >= len(self.values):
            raise FormatError(f"the file ends before the list {name}")
        length = int(whole(self.values[place : place + 1], f"length of {name}")[0])
        need(length, len(self.values) - place - 1, f"list {name}", unit="numbers")
        return length

    def _walk(self, element: _Element) -> _Table:
        parts = {p.name: array("d") for p in element.properties}
        lengths = {p.name: array("q") for p in element.properties if p.count}
        for _ in range(element.count):
            for item in element.properties:
                length = 1
                if item.count:
                    length = self._length(self.place, item.name)
                    lengths[item.name].append(length)
                    self.place += 1
                self._need(length, f"{element.name} {item.name}")
                values = self.values[self.place : self.place + length]
                parts[item.name].frombytes(values.tobytes())
                self.place += length
        columns = {name: np.array(values) for name, values in parts.items()}
        return _Table(columns, {name: np.array(k) for name, k in lengths.items()})


def _surface(vertex: _Table, face: _Table, comments: list[str]) -> SurfaceMesh:
    if missing := [axis for axis in "xyz" if axis not in vertex.columns or axis in vertex.lengths]:
        refuse("properties of vertex", ", ".join(vertex.columns), f"{', '.join(missing)}")
    points = np.stack([vertex.columns[axis].astype(np.float64) for axis in "xyz"], axis=1)
    name = next((name for name in CORNERS if name in face.lengths), None)
    if name is None:
        refuse("properties of face", ", ".join(face.columns), f"the list {CORNERS[0]}")
    triangles, owners = _fans(_indices(face.columns[name], name), face.lengths[name])
    labels, names = _parts(face, owners, comments)
    return SurfaceMesh(points, triangles, _unit(comments), labels, names)


def _indices(entries: NDArray[Any], what: str) -> NDArray[np.int64]:
    if entries.dtype.kind == "f":
        return whole(entries.astype(np.float64), what)
    return entries.astype(np.int64)


def _fans(
    entries: NDArray[np.int64], lengths: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the triangles of polygons, fanned about their first corner, and whose they are."""
    if (lengths < 3).any():
        bad = int(np.flatnonzero(lengths < 3)[0])
        refuse(f"face {bad}", int(lengths[bad]), "at least three corners")
    owners = np.repeat(np.arange(len(lengths)), lengths - 2)
    first = np.cumsum(lengths) - lengths
    step = np.arange(len(owners)) - np.repeat(np.cumsum(lengths - 2) - (lengths - 2), lengths - 2)
    at = first[owners]
    return np.stack([entries[at], entries[at + step + 1], entries[at + step + 2]], axis=1), owners


def _parts(
    face: _Table, owners: NDArray[np.int64], comments: list[str]
) -> tuple[NDArray[np.int16] | None, tuple[str, ...]]:
    names = tuple(_name(text[6:]) for text in comments if text.startswith("label "))
    if not names or "label" not in face.columns or "label" in face.lengths:
        return None, ONE_PART
    labels = _indices(face.columns["label"], "label")[owners]
    if labels.size and not 0 <= labels.min() <= labels.max() < len(names):
        raise FormatError(f"label: got {labels.min()} to {labels.max()}; there are {len(names)}")
    return labels.astype(np.int16), names


def _name(text: str) -> str:
    try:
        name = json.loads(text)
    except (ValueError, RecursionError):
        return text
    return name if isinstance(name, str) else text


def _unit(comments: list[str]) -> str:
    units = [text[5:].strip() for text in comments if text.startswith("unit ")]
    return units[0] if units and units[0] in METRES else "mm"


FORMAT = Format("Stanford PLY", (".ply",), SurfaceMesh, read, (SurfaceMesh,), write)
