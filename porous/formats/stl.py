"""STL: triangles without shared points, in single precision; what printers take.

Binary: 80 bytes of header, the number of facets, and 50 bytes a facet (normal, three corners,
attribute). Text is read too. The format knows no unit, no parts and seven digits: our header says
``unit=mm``; parts are lost. A body that lies far from zero for its size would lose its shape in
seven digits: it is written relative to its own corner, and the header says ``origin=x,y,z``, which
our reader adds again.
"""

from __future__ import annotations

import re
from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.errors import FormatError
from porous.formats._registry import Format
from porous.formats.gate import few, numbers, refuse
from porous.values import SurfaceMesh
from porous.values.units import METRES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from porous.formats.gate import Source

FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
PREFIX = 84
MOST = int(np.iinfo(np.uint32).max)
"""Facets that the header can count."""
FAR = 4.0
"""A body whose farthest coordinate is more than this many of its own lengths is moved."""
SLAB = 100_000
SPACE = re.compile(rb"\s*")
TITLE = re.compile(rb"\s*(end)?solid\b[^\n]*", re.IGNORECASE)
VERTEX = rb"\s+vertex" + 3 * rb"\s+(\S{1,64})"
TEXT = re.compile(
    rb"\s*facet\s+normal(?:\s+\S{1,64}){3}\s+outer\s+loop" + 3 * VERTEX + rb"\s+endloop\s+endfacet",
    re.IGNORECASE,
)
PLAUSIBLE = (1e-6, 1e6)
"""Longest edge, in the file's unit, beyond which the unit is asked after."""


@dataclass(frozen=True)
class _Soup:
    """Facets as they stand in the file: corners (t, 3, 3) relative to ``origin``."""

    corners: NDArray[np.floating[Any]]
    unit: str
    origin: NDArray[np.float64]


def read(source: Source) -> SurfaceMesh:
    """Read a binary or text STL; equal corners become one point, in their order of appearance."""
    soup = _read_text(source.data) if _is_text(source.data) else _read_binary(source)
    bad = np.flatnonzero(~np.isfinite(soup.corners).all(axis=(1, 2)))
    if len(bad):
        got = soup.corners[bad[0]].tolist()
        refuse(f"facet {bad[0] + 1} of {len(soup.corners)}", got, "finite corners")
    points, triangles = _weld(soup.corners)
    proper = triangles[_proper(triangles)]
    if not len(proper):
        what = f"none of {len(triangles)} facets has three corners" if len(points) else "no facets"
        raise FormatError(f"{what}; wanted at least one")
    surface = SurfaceMesh(points + soup.origin, proper, soup.unit)
    _notes(source, surface, len(triangles) - len(proper))
    return surface


def write(surface: SurfaceMesh) -> Iterator[bytes]:
    """Write binary STL; facets whose corners fall together in single precision are left out."""
    points, triangles = surface.points, surface.triangles
    if not len(triangles):
        raise FormatError("the surface has no triangles; an STL file needs at least one")
    starts = range(0, len(triangles), SLAB)
    bounds = points.min(axis=0), points.max(axis=0)
    return stream(
        surface.unit, bounds, lambda: (points[triangles[a : a + SLAB]] for a in starts), None
    )


def stream(
    unit: str,
    bounds: tuple[NDArray[np.float64], NDArray[np.float64]],
    corners: Callable[[], Iterable[NDArray[np.float64]]],
    count: int | None,
) -> Iterator[bytes]:
    """Write a surface that comes piece by piece: the bytes that ``write`` gives of the whole.

    Parameters
    ----------
    unit
        Unit of length.
    bounds
        Least and greatest coordinates of all points, (3,) each.
    corners
        Begins anew with every call: corners of triangles, float64, shape (t, 3, 3), piece by piece.
    count
        How many triangles there are, where ``stay_apart`` has shown that none is to be left out;
        else None, and they are gone through once more, to count those that stay.

    Raises
    ------
    FormatError
        For coordinates beyond single precision, or more triangles than the format can count.
    """
    _check_range(bounds)
    words, shift = _shift(*bounds)
    if count is None:
        count = sum(int(_distinct(_single(piece, shift)).sum()) for piece in corners())
    if count > MOST:
        raise FormatError(f"{count} facets; wanted at most {MOST} for STL. Write PLY")
    header = f"porous STL unit={unit}{words}".encode().ljust(80)
    return _stream(header + np.uint32(count).tobytes(), corners, shift)


def stay_apart(
    bounds: tuple[NDArray[np.float64], NDArray[np.float64]], gaps: NDArray[np.float64]
) -> bool:
    """Return whether points surely stay apart in the file, by the bounds of all points.

    ``gaps``, shape (3,): the points differ by at least so much along one axis or another.
    """
    _, shift = _shift(*bounds)
    shifted = np.maximum(*(np.abs(bound - shift) for bound in bounds))
    rounded = shifted * 2.0**-22 + np.maximum(*np.abs(bounds)) * 2.0**-50
    return bool((gaps > rounded).all())


def _stream(
    header: bytes, corners: Callable[[], Iterable[NDArray[np.float64]]], shift: NDArray[np.float64]
) -> Iterator[bytes]:
    yield header
    for piece in corners():
        single = _single(piece, shift)
        kept = _distinct(single)
        yield _facets(piece[kept], single[kept]).tobytes()


def _single(corners: NDArray[np.float64], shift: NDArray[np.float64]) -> NDArray[np.float32]:
    return (corners - shift).astype(np.float32)


def _is_text(data: bytes) -> bool:
    # Many binary files begin with "solid" too: the count decides before the word does.
    if len(data) >= PREFIX and len(data) == PREFIX + _count(data) * FACET.itemsize:
        return False
    head = data[:1024].lstrip().lower()
    return head.startswith(b"solid") and b"\0" not in head


def _count(data: bytes) -> int:
    return int.from_bytes(data[80:PREFIX], "little")


def _read_binary(source: Source) -> _Soup:
    data = source.data
    if len(data) < PREFIX:
        raise FormatError(f"got {len(data)} bytes; a binary STL has at least {PREFIX}")
    count, there = _count(data), (len(data) - PREFIX) // FACET.itemsize
    if count > there:
        raise FormatError(f"the header says {count} facets; the file has bytes for {there}")
    over = len(data) - PREFIX - count * FACET.itemsize
    if over:
        source.note(f"{over} bytes follow the last of {count} facets; they are left out")
    facets = np.frombuffer(data, FACET, count, PREFIX)
    unit, origin = _header(data[:80])
    return _Soup(facets["corners"], unit, origin)


def _header(text: bytes) -> tuple[str, NDArray[np.float64]]:
    if not text.startswith(b"porous STL "):
        return "mm", np.zeros(3)
    words = dict(re.findall(r"(\w+)=([^\s\0]+)", text.decode("ascii", "replace")))
    unit = words.get("unit", "mm")
    if unit not in METRES:
        refuse("unit in the header", unit, f"one of {', '.join(METRES)}")
    origin = numbers(
        words.get("origin", "0,0,0").replace(",", " ").encode(), "origin in the header"
    )
    if origin.shape != (3,):
        refuse("origin in the header", words["origin"], "three numbers")
    return unit, origin


def _read_text(data: bytes) -> _Soup:
    corners, place, count, ended = array("d"), 0, 0, False
    while (place := SPACE.match(data, place).end()) < len(data):  # type: ignore[union-attr]
        if title := TITLE.match(data, place):
            place, ended = title.end(), bool(title[1])
            continue
        count += 1
        match = TEXT.match(data, place)
        if match is None:
            wanted = "facet normal …, outer loop, three vertices, endloop, endfacet"
            refuse(f"facet {count}", data[place : place + 30].decode("utf-8", "replace"), wanted)
        corners.extend(few(list(match.groups()), f"facet {count}"))
        place, ended = match.end(), False
    if not ended:
        raise FormatError(f"the text ends after {count} facets; wanted endsolid")
    return _Soup(np.array(corners).reshape(-1, 3, 3), "mm", np.zeros(3))


def _weld(
    corners: NDArray[np.floating[Any]],
) -> tuple[NDArray[np.floating[Any]], NDArray[np.int64]]:
    """Return the distinct corners in the order of their appearance, and the facets' indices."""
    rows = np.ascontiguousarray(corners.reshape(-1, 3)) + 0.0  # −0 and 0 are one place
    order = np.lexsort(rows.T)  # stable: of equal rows the first in the file comes first
    fresh = np.ones(len(rows), dtype=bool)
    fresh[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    first = order[fresh]
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    place = np.empty(len(rows), dtype=np.int64)
    place[order] = rank[np.cumsum(fresh) - 1]
    return rows[np.sort(first)], place.reshape(-1, 3)


def _notes(source: Source, surface: SurfaceMesh, collapsed: int) -> None:
    if collapsed:
        source.note(f"{collapsed} facets have two corners in one place; they are left out")
    corners = np.sort(surface.triangles, axis=1)
    corners = corners[np.lexsort(corners.T)]
    twice = int((corners[1:] == corners[:-1]).all(axis=1).sum())
    if twice:
        source.note(f"{twice} facets lie on others")
    length = max(surface.box.lengths)
    if not PLAUSIBLE[0] <= length <= PLAUSIBLE[1]:
        source.note(f"the longest edge is {length:.3g} {surface.unit}: is that the unit?")


def _proper(triangles: NDArray[np.int64]) -> NDArray[np.bool_]:
    a, b, c = triangles.T
    result: NDArray[np.bool_] = (a != b) & (b != c) & (c != a)
    return result


def _distinct(corners: NDArray[np.float32]) -> NDArray[np.bool_]:
    a, b, c = np.moveaxis(corners, 1, 0)
    different = [(u != v).any(axis=1) for u, v in ((a, b), (b, c), (c, a))]
    return np.asarray(np.logical_and.reduce(different))


def _shift(
    lower: NDArray[np.float64], upper: NDArray[np.float64]
) -> tuple[str, NDArray[np.float64]]:
    """Return the corner that coordinates are relative to: as the header's words, and exactly."""
    far = max(np.abs(lower).max(), np.abs(upper).max())
    if far <= FAR * (upper - lower).max():
        return "", np.zeros(3)
    words = [str(v) for v in lower.astype(np.float32)]  # the shortest names there are: they fit
    return f" origin={','.join(words)}", np.array([float(word) for word in words])


def _check_range(bounds: tuple[NDArray[np.float64], NDArray[np.float64]]) -> None:
    farthest = float(np.abs(bounds).max())
    if farthest > np.finfo(np.float32).max / 2:
        refuse("coordinates", farthest, "at most 1.7e38 for STL")


def _facets(corners: NDArray[np.float64], single: NDArray[np.float32]) -> NDArray[Any]:
    a, b, c = np.moveaxis(corners, 1, 0)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    facets = np.zeros(len(corners), FACET)
    facets["normal"] = normals / np.where(lengths > 0, lengths, 1.0)
    facets["corners"] = single
    return facets


FORMAT = Format("STL", (".stl",), SurfaceMesh, read, (SurfaceMesh,), write)
