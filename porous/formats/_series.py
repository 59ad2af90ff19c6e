"""Folders of slices: grey pictures with numbers in their names, one for each layer along z.

PNG of 1, 8 or 16 bits, or TIFF of one page each. Columns are x and rows y, as in a TIFF stack; in
what porous wrote itself (``slices.json`` is there) the first row holds the largest y. No number may
be missing and no picture of another size.
"""

from __future__ import annotations

import json
import re
import struct
import warnings
import zlib
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.errors import FormatError, FormatWarning
from porous.formats.gate import inflate, need, refuse
from porous.memory import check_memory
from porous.values.image import Image

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from porous.formats.gate import Source

SIGNATURE = b"\x89PNG\r\n\x1a\n"
NAME = re.compile(r"(?P<stem>.*?)(?P<number>[0-9]{1,18})(?P<suffix>\.png|\.tiff?)", re.IGNORECASE)
SUFFIXES = (".png", ".tif", ".tiff")
PAGE = "slices.json"
GREY = 0
DEPTHS = (1, 8, 16)
MOST = 100_000
"""The most slices of a folder."""


def members(source: Source) -> tuple[str, ...]:
    """Return the names of the files of a folder of slices, in the order of their numbers."""
    assert source.folder is not None
    names = _slices(source.folder)
    return (*names, PAGE) if (source.folder / PAGE).is_file() else names


def read_image(source: Source) -> Image:
    """Read the grey values of all slices of a folder."""
    assert source.folder is not None
    names = _slices(source.folder)
    first = _slice(source, names[0], quiet=False)
    shape = (*first.values.shape[:2], len(names))
    what = f"an image of {' × '.join(map(str, shape))} voxels"
    check_memory(3 * first.values.itemsize * first.values.size * len(names), what, "Take fewer.")
    values = np.empty(shape[::-1], first.values.dtype)
    values[0] = first.values[:, :, 0].T
    for k, name in enumerate(names[1:], 1):
        layer = _slice(source, name, quiet=True).values
        if (layer.shape, layer.dtype) != (first.values.shape, first.values.dtype):
            refuse(name, _kind(layer), f"{_kind(first.values)} as in {names[0]}")
        values[k] = layer[:, :, 0].T
    turned = values.transpose(2, 1, 0)
    if PAGE in members(source):
        return _ours(source, turned)
    if names[0].lower().endswith(".png"):
        source.note("it says no voxel size; taken as 1 mm along x, y and z")
    return Image(turned, first.spacing, (0.0, 0.0, 0.0), first.unit)


def _kind(values: NDArray[Any]) -> str:
    return f"{values.shape[0]} × {values.shape[1]} of {values.dtype}"


def _slices(folder: Path) -> tuple[str, ...]:
    """Return the slices of a folder by their numbers, which must be of one series without gaps."""
    try:
        there = sorted(path.name for path in folder.iterdir() if _is_picture(path.name))
    except OSError as error:
        raise FormatError(f"cannot be read: {(error.strerror or str(error)).lower()}") from None
    need(len(there), MOST, "the folder", unit="pictures")
    found: dict[int, str] = {}
    series = set()
    for name in there:
        match = NAME.fullmatch(name)
        if match is None:
            refuse("a slice", name, "a number before the suffix, as in slice-0001.png")
        series.add((match["stem"], match["suffix"].lower()))
        number = int(match["number"])
        if number in found:
            refuse("slices", f"{found[number]} and {name}", "each number once")
        found[number] = name
    if len(series) != 1:
        names = ", ".join(f"{stem}…{suffix}" for stem, suffix in sorted(series)[:4])
        refuse("slices", names or "none", "pictures of one name with numbers, .png or .tif")
    numbers = sorted(found)
    for before, after in pairwise(numbers):
        if after != before + 1:
            raise FormatError(
                f"slice {before + 1} is missing: after {found[before]} comes {found[after]}"
            )
    return tuple(found[number] for number in numbers)


def _is_picture(name: str) -> bool:
    return name.lower().endswith(SUFFIXES) and not name.startswith(".")


def _slice(source: Source, name: str, *, quiet: bool) -> Image:
    """Return one layer; ``quiet`` where what there is to say was said of the first."""
    from porous.formats import tif
    from porous.formats.gate import Source as Bytes

    data = source.beside(name, "a slice")
    try:
        if name.lower().endswith(".png"):
            return Image(_picture(data).T[:, :, None], (1.0, 1.0, 1.0))
        with warnings.catch_warnings():
            if quiet:
                warnings.simplefilter("ignore", FormatWarning)
            layer = tif.read_image(Bytes(source.name, data))
    except FormatError as error:
        raise FormatError(f"{name}: {error}") from None
    if layer.shape[2] != 1:
        refuse(name, f"{layer.shape[2]} pages", "one page for each slice")
    return layer


def _ours(source: Source, values: NDArray[Any]) -> Image:
    """Return what porous wrote, by its page."""
    try:
        known = json.loads(source.beside(PAGE, "the page"))
        spacing = [float(known[name]) for name in ("pixel_width", "pixel_height", "layer_height")]
        (x, y, z), (u, v, w) = spacing, map(float, known["lower"])
        unit, turned = str(known["unit"]), known["first_row"] == "largest y"
    except (ValueError, KeyError, TypeError, RecursionError):
        raise FormatError(f"{PAGE}: is not what porous writes beside slices") from None
    return Image(values[:, ::-1] if turned else values, (x, y, z), (u, v, w), unit)


# --- PNG ---------------------------------------------------------------------------------------


def _picture(data: bytes) -> NDArray[Any]:
    """Return the grey values of a PNG, shape (rows, columns)."""
    if not data.startswith(SIGNATURE):
        refuse("its beginning", data[:8], "that of a PNG")
    head, packed = b"", []
    for kind, body in _chunks(memoryview(data)[len(SIGNATURE) :]):
        if kind == b"IHDR":
            head = bytes(body)
        elif kind == b"IDAT":
            packed.append(body)
    if len(head) != 13 or not packed:
        raise FormatError("it has no head or no pixels; wanted a whole PNG")
    width, height, depth, colour, *how = struct.unpack(">II5B", head)
    if colour != GREY or depth not in DEPTHS:
        got = f"{depth} bits, colour type {colour}"
        refuse("pixels", got, "1, 8 or 16 bits of grey; save it as an 8-bit grey picture")
    if how != [0, 0, 0] or not (width and height):
        refuse("its head", f"{width} × {height}, {how}", "a picture that is not interlaced")
    line = 1 + -(-width * depth // 8)
    return _pixels(inflate(b"".join(packed), height * line, "its pixels"), height, width, depth)


def _pixels(flat: bytes, height: int, width: int, depth: int) -> NDArray[Any]:
    from porous.kernels.unfilter import unfilter

    rows = unfilter(np.frombuffer(flat, np.uint8).reshape(height, -1), max(1, depth // 8))
    if rows is None:
        raise FormatError("its rows are filtered in a way that no PNG has")
    if depth == 1:
        return np.unpackbits(rows, axis=1, count=width).view(np.bool_)
    if depth == 16:
        return np.ascontiguousarray(rows).view(">u2").astype(np.uint16)
    return rows


def _chunks(data: memoryview) -> Iterator[tuple[bytes, memoryview]]:
    """Give kind and body of each chunk, up to the end that is marked; sums must be right."""
    place = 0
    while True:
        need(place + 12, len(data), "a chunk")
        size = int.from_bytes(data[place : place + 4], "big")
        need(place + 12 + size, len(data), "a chunk")
        kind, body = bytes(data[place + 4 : place + 8]), data[place + 8 : place + 8 + size]
        told = int.from_bytes(data[place + 8 + size : place + 12 + size], "big")
        if zlib.crc32(body, zlib.crc32(kind)) != told:
            refuse("a chunk", kind.decode("latin-1"), "one whose sum is right: it is damaged")
        if kind == b"IEND":
            return
        yield kind, body
        place += 12 + size
