"""What a 3MF model part says: objects of triangles, parts put together of others, what is built.

Meshes have millions of elements, so this is a machine that reads a stream: numbers go into arrays
as they come and nothing else is kept. An object may only name objects that stand before it, so
none can hold itself; how much all copies make is counted before the first is made.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, NoReturn
from xml.parsers import expat

import numpy as np

from porous.errors import FormatError
from porous.formats.gate import DEPTH, HEADER, few, need, refuse
from porous.memory import check_memory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from typing import IO

    from numpy.typing import NDArray

    Attributes = dict[str, str]
    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
MODEL = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
BEAMS = "http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02"
BALLS = "http://schemas.microsoft.com/3dmanufacturing/beamlattice/balls/2020/07"
MATERIALS = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
SETS = "http://schemas.microsoft.com/3dmanufacturing/trianglesets/2021/07"
KNOWN = {BEAMS, BALLS, MATERIALS, PRODUCTION, SETS}
"""Extensions without which the triangles stay as they are."""

UNITS = {
    "micron": "um",
    "millimeter": "mm",
    "centimeter": "cm",
    "inch": "in",
    "foot": "in",
    "meter": "m",
}
FOOT = 12.0
"""Inches: there is no unit of ours for it."""
STEP = 1 << 16
"""Bytes that are parsed at once."""
LONGEST = 4 * HEADER
"""The longest tag or comment, in bytes."""
COPIES = 256
"""Bytes of points and triangles that one byte of the packed model may become: one copy takes 2."""
SMALL = 1 << 24
"""So many bytes are always allowed."""
PIECES = 4_096
"""The most copies of objects, and the most objects."""
USES = 4 * PIECES
"""The most items and components."""
ENOUGH = 1 << 62


class Matrix(NamedTuple):
    """Points, as rows, are multiplied by ``linear`` and moved by ``shift``."""

    linear: Floats
    shift: Floats


IDENTITY = Matrix(np.eye(3), np.zeros(3))


@dataclass
class Thing:
    """An object: its triangles, or the objects that it is put together of."""

    name: str
    points: array[float] = field(default_factory=lambda: array("d"))
    triangles: array[int] = field(default_factory=lambda: array("q"))
    components: list[tuple[str, Matrix]] = field(default_factory=list)
    counts: tuple[int, int, int, int] = (0, 0, 0, 0)
    """Depth, pieces, points and triangles of it and of all that it is put together of."""

    @cached_property
    def arrays(self) -> tuple[Floats, Indices]:
        """Its own points (n, 3) and triangles (t, 3); refused where these name other points."""
        points = np.array(self.points).reshape(-1, 3)
        triangles = np.array(self.triangles).reshape(-1, 3)
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(points):
            got = f"{triangles.min()} to {triangles.max()}"
            raise FormatError(f"triangles name vertices {got}; there are {len(points)}")
        return points, triangles


class ModelPart:
    """The machine; ``feed`` it, then take ``unit``, ``beams`` and ``surfaces``."""

    def __init__(self) -> None:
        self.unit, self.scale, self.beams = "mm", 1.0, 0
        self.things: dict[str, Thing] = {}
        self.built: list[tuple[str, Matrix]] = []
        self._prefixes: dict[str, str] = {}
        self._depth = self._size = self._uses = 0
        self._open: tuple[str, Thing] | None = None
        self._root = False
        self._parser = _parser(self)

    def feed(self, stream: IO[bytes]) -> None:
        """Read the whole of a stream.

        Raises ``FormatError`` for what is no model, names what it has not, or is not finite.
        """
        try:
            while piece := stream.read(STEP):
                self._parser.Parse(piece, False)  # noqa: FBT003  (expat knows no keyword)
                self._size += len(piece)
                if self._size - self._parser.CurrentByteIndex > LONGEST:
                    raise FormatError(f"XML: a tag of more than {LONGEST} characters")
            self._parser.Parse(b"", True)  # noqa: FBT003
        except (expat.ExpatError, UnicodeError, LookupError, ValueError) as error:
            raise FormatError(f"XML: {error}") from None
        finally:
            self._parser = None  # type: ignore[assignment]  # its handlers hold us: no circles

    def surfaces(self, packed: int) -> Iterator[tuple[str, Floats, Indices]]:
        """Give the name, the points and the triangles of each copy of an object that is built.

        ``packed`` is how many bytes the model takes in its archive. Raises ``FormatError`` where
        copies would make far more of the file than it holds.
        """
        counts = np.array([self._thing(key).counts for key, _ in self.built], dtype=object)
        if not len(counts):
            raise FormatError("nothing is built; wanted at least one item")
        _, pieces, points, triangles = counts.sum(axis=0)
        if pieces > PIECES:
            raise FormatError(f"{_many(pieces)} copies of objects; wanted at most {PIECES}")
        size = 24 * (points + triangles)
        need(size, max(COPIES * packed, SMALL), "what is built")
        check_memory(3 * size, "what is built", "Cut it into parts.")
        for key, matrix in self.built:
            for thing, place in self._pieces(key, matrix):
                yield self.things[key].name, *_placed(*thing.arrays, place, self.scale)

    def _pieces(self, key: str, matrix: Matrix) -> Iterator[tuple[Thing, Matrix]]:
        thing = self.things[key]
        if len(thing.triangles):
            yield thing, matrix
        for inner, own in thing.components:
            yield from self._pieces(inner, _after(own, matrix))

    def _thing(self, key: str | None) -> Thing:
        if key is None or key not in self.things:
            refuse("an object that is used", key, "the id of one that stands before")
        return self.things[key]

    # --- what expat calls

    def start(self, tag: str, given: Attributes) -> None:
        """Take an element in; those of others' namespaces mean nothing to us."""
        self._depth += 1
        if self._depth > DEPTH:
            raise FormatError(f"XML: nested over {DEPTH} deep")
        if not self._root:
            self._model(tag, given)
        elif (act := ACTS.get(tag)) is not None:
            act(self, given)

    def end(self, tag: str) -> None:
        """Close an element; an object is whole then and may be named."""
        self._depth -= 1
        if tag == OBJECT:
            assert self._open is not None
            key, thing = self._open
            thing.counts = self._counts(thing)
            self.things[key], self._open = thing, None

    def prefix(self, name: str | None, space: str) -> None:
        """Note which namespace a prefix stands for."""
        if name is not None and len(self._prefixes) < DEPTH:
            self._prefixes[name] = space

    def _model(self, tag: str, given: Attributes) -> None:
        if tag != f"{CORE} model":
            refuse("root", tag, "a model of the 3MF core specification")
        self._root = True
        unit = given.get("unit", "millimeter")
        if unit not in UNITS:
            refuse("unit", unit, f"one of {', '.join(UNITS)}")
        self.unit, self.scale = UNITS[unit], FOOT if unit == "foot" else 1.0
        for name in given.get("requiredextensions", "").split():
            if (space := self._prefixes.get(name, name)) not in KNOWN:
                refuse("an extension that the model needs", space, "none, or beams and materials")

    def _object(self, given: Attributes) -> None:
        key = given.get("id", "")
        if self._open is not None or not key or key in self.things:
            refuse("id of an object", key, "one that no other object has, and none inside another")
        if len(self.things) >= PIECES:
            raise FormatError(f"more than {PIECES} objects")
        self._open = key, Thing(given.get("name", ""))

    def _current(self, what: str) -> Thing:
        if self._open is None:
            raise FormatError(f"a {what} that is in no object")
        return self._open[1]

    def _vertex(self, given: Attributes) -> None:
        points = self._current("vertex").points
        try:
            points.extend((float(given["x"]), float(given["y"]), float(given["z"])))
        except (KeyError, ValueError):
            self._bad("vertex", len(points) // 3, given, "numbers x, y and z")

    def _triangle(self, given: Attributes) -> None:
        triangles = self._current("triangle").triangles
        try:
            triangles.extend((int(given["v1"]), int(given["v2"]), int(given["v3"])))
        except (KeyError, ValueError, OverflowError):
            self._bad("triangle", len(triangles) // 3, given, "vertices v1, v2 and v3")

    def _bad(self, what: str, number: int, given: Attributes, wanted: str) -> NoReturn:
        assert self._open is not None
        refuse(f"{what} {number} of object {self._open[0]}", " ".join(given.values()), wanted)

    def _component(self, given: Attributes) -> None:
        self._current("component").components.append(self._used(given))

    def _item(self, given: Attributes) -> None:
        self.built.append(self._used(given))

    def _used(self, given: Attributes) -> tuple[str, Matrix]:
        if f"{PRODUCTION} path" in given:
            refuse("an object", given[f"{PRODUCTION} path"], "all objects in one model part")
        key = given.get("objectid")
        self._thing(key)
        self._uses += 1
        if self._uses > USES:
            raise FormatError(f"objects are used more than {USES} times")
        assert key is not None
        return key, _matrix(given.get("transform"))

    def _beam(self, _: Attributes) -> None:
        self.beams += 1

    def _counts(self, thing: Thing) -> tuple[int, int, int, int]:
        inner = [self.things[key].counts for key, _ in thing.components]
        depth = 1 + max((row[0] for row in inner), default=0)
        if depth > DEPTH:
            raise FormatError(f"objects put together of others over {DEPTH} deep")
        own = 1, len(thing.points) // 3, len(thing.triangles) // 3
        sums = [
            min(sum(column), ENOUGH) for column in zip(own, *(r[1:] for r in inner), strict=True)
        ]
        return depth, sums[0], sums[1], sums[2]


OBJECT = f"{CORE} object"
ACTS: dict[str, Callable[[ModelPart, Attributes], None]] = {
    OBJECT: ModelPart._object,  # noqa: SLF001
    f"{CORE} vertex": ModelPart._vertex,  # noqa: SLF001
    f"{CORE} triangle": ModelPart._triangle,  # noqa: SLF001
    f"{CORE} component": ModelPart._component,  # noqa: SLF001
    f"{CORE} item": ModelPart._item,  # noqa: SLF001
    f"{BEAMS} beam": ModelPart._beam,  # noqa: SLF001
}


def _parser(part: ModelPart) -> expat.XMLParserType:
    parser = expat.ParserCreate(namespace_separator=" ")
    parser.StartElementHandler, parser.EndElementHandler = part.start, part.end
    parser.StartNamespaceDeclHandler = part.prefix
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = _forbidden
    return parser


def _forbidden(*_: object) -> NoReturn:
    raise FormatError("XML: document types and entities are not read")


def _many(count: int) -> str:
    return str(count) if count < ENOUGH else "more than 10¹⁸"


def _matrix(text: str | None) -> Matrix:
    if text is None:
        return IDENTITY
    words = text.encode("utf-8", "replace").split()
    if len(words) != 12:
        refuse("transform", text, "12 numbers")
    rows = np.array(few(words, "transform")).reshape(4, 3)
    linear = rows[:3]
    with np.errstate(all="ignore"):
        flat = not np.isfinite(rows).all() or np.linalg.det(linear) == 0
    if flat:
        refuse("transform", text, "finite numbers that turn, stretch or move, and do not flatten")
    return Matrix(linear, rows[3])


def _after(first: Matrix, second: Matrix) -> Matrix:
    if second is IDENTITY:
        return first
    with np.errstate(over="ignore", invalid="ignore"):  # the surface refuses what comes of it
        linear = first.linear @ second.linear
        return Matrix(linear, first.shift @ second.linear + second.shift)


def _placed(
    points: Floats, triangles: Indices, place: Matrix, scale: float
) -> tuple[Floats, Indices]:
    """Return points and triangles of a copy; one that is mirrored is turned outside out again."""
    if place is not IDENTITY:
        with np.errstate(over="ignore", invalid="ignore"):  # the surface refuses what comes of it
            points = points @ place.linear + place.shift
            mirrored = np.linalg.det(place.linear) < 0
        if mirrored:
            triangles = triangles[:, ::-1]
    return points * scale, triangles
