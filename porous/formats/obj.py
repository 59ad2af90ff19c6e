"""Wavefront OBJ: points and polygons as text, in parts; what modellers exchange.

Coordinates are written with all their digits. Parts are groups (``g``); the unit is a comment.
Polygons are fanned about their first corner. Normals, texture and materials are left out, and no
material file is ever opened.
"""

from __future__ import annotations

import io
import re
from array import array
from dataclasses import dataclass, field
from itertools import pairwise, takewhile
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.formats._registry import Format
from porous.formats.gate import HEADER, few, integer, refuse
from porous.values import SurfaceMesh

if TYPE_CHECKING:
    from collections.abc import Iterator

    from porous.formats.gate import Source

SLAB = 100_000
PARTS = 2**15 - 1
HEAD = re.compile(rb"# porous: unit (\w+), (\d{1,18}) points, (\d{1,18}) triangles\s*")
"""Our first line: the unit, and what tells a file that was cut short."""


@dataclass
class _Draft:
    points: array[float] = field(default_factory=lambda: array("d"))
    triangles: array[int] = field(default_factory=lambda: array("q"))
    labels: array[int] = field(default_factory=lambda: array("h"))
    names: dict[str, int] = field(default_factory=dict)
    part: int = -1
    unit: str = "mm"
    counts: tuple[int, int] | None = None

    def head(self, words: re.Match[bytes]) -> None:
        self.unit = words[1].decode("ascii", "replace")
        self.counts = int(words[2]), int(words[3])

    def point(self, words: list[bytes]) -> None:
        if len(words) < 3:
            refuse("a point", b" ".join(words).decode("utf-8", "replace"), "x, y and z")
        self.points.extend(few(words[:3], "a point"))

    def group(self, words: list[bytes]) -> None:
        name = b" ".join(words).decode("utf-8", "replace") or "default"
        self.part = self.names.setdefault(name, len(self.names))
        if self.part >= PARTS:
            raise FormatError(f"more than {PARTS} groups")

    def face(self, words: list[bytes]) -> None:
        words = list(takewhile(lambda word: not word.startswith(b"#"), words))
        if len(words) < 3:
            refuse("a face", len(words), "at least three corners")
        if self.part < 0:
            self.group([b"WALL"])
        corners = [self._index(word) for word in words]
        for b, c in pairwise(corners[1:]):
            self.triangles.extend((corners[0], b, c))
            self.labels.append(self.part)

    def _index(self, word: bytes) -> int:
        number = integer(word.partition(b"/")[0], "a corner of a face")
        count = len(self.points) // 3
        index = number - 1 if number > 0 else count + number
        if number == 0 or not 0 <= index < 2**62:
            refuse("a corner of a face", number, "the number of a point, from 1")
        return index


ACTS = {b"v": _Draft.point, b"f": _Draft.face, b"g": _Draft.group, b"o": _Draft.group}


def read(source: Source) -> SurfaceMesh:
    """Read points, polygons and groups; whatever else the file says is left out."""
    draft = _Draft()
    data = source.data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    for place, line in enumerate(io.BytesIO(data), 1):
        if len(line) > HEADER:
            raise FormatError(f"line {place} has {len(line)} bytes; wanted at most {HEADER}")
        words = line.split()
        try:
            if words and words[0] in ACTS:
                ACTS[words[0]](draft, words[1:])
            elif place == 1 and (head := HEAD.fullmatch(line)):
                draft.head(head)
        except FormatError as error:
            raise FormatError(f"line {place}: {error}") from None
    return _surface(draft)


def write(surface: SurfaceMesh) -> Iterator[bytes]:
    """Write points and triangles in their order, a group line wherever the part changes."""
    names = [_group(name) for name in surface.names]
    counts = f"{len(surface.points)} points, {len(surface.triangles)} triangles"
    yield f"# porous: unit {surface.unit}, {counts}\n".encode()
    yield "".join(names).encode()  # all groups first: so they keep their order
    for start in range(0, len(surface.points), SLAB):
        rows = surface.points[start : start + SLAB].tolist()
        yield "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in rows).encode()
    assert surface.labels is not None
    part = -1
    for start in range(0, len(surface.triangles), SLAB):
        lines = []
        faces = (surface.triangles[start : start + SLAB] + 1).tolist()
        labels = surface.labels[start : start + SLAB].tolist()
        for (a, b, c), label in zip(faces, labels, strict=True):
            if label != part:
                lines.append(names[label])
                part = label
            lines.append(f"f {a} {b} {c}\n")
        yield "".join(lines).encode()


def _group(name: str) -> str:
    return f"g {' '.join(name.split()) or 'default'}\n"


def _surface(draft: _Draft) -> SurfaceMesh:
    triangles = np.array(draft.triangles, dtype=np.int64).reshape(-1, 3)
    if not len(triangles):
        raise FormatError("no faces; wanted at least one")
    if draft.counts not in (None, (len(draft.points) // 3, len(triangles))):
        got = (len(draft.points) // 3, len(triangles))
        refuse("points and triangles", got, f"{draft.counts}, as the first line says")
    points = np.array(draft.points).reshape(-1, 3)
    labels = np.array(draft.labels, dtype=np.int16)
    return SurfaceMesh(points, triangles, draft.unit, labels, tuple(draft.names))


FORMAT = Format("Wavefront OBJ", (".obj",), SurfaceMesh, read, (SurfaceMesh,), write)
