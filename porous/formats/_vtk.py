"""What VTK's XML files share: arrays in text, base64 or raw bytes, compressed by zlib or not.

Written: arrays appended raw, compressed in blocks, little-endian; the bytes depend on the values
alone. Read: whatever VTK writes in serial files without LZ4 or LZMA.
https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

import base64
import binascii
import math
import os
import re
import zlib
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from porous.errors import FormatError
from porous.formats.gate import (
    HEADER,
    RATIO,
    inflate,
    integer,
    markup,
    need,
    numbers,
    refuse,
    whole,
)
from porous.memory import check_memory
from porous.values.units import METRES

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

TYPES = {
    **{f"Int{8 * n}": f"i{n}" for n in (1, 2, 4, 8)},
    **{f"UInt{8 * n}": f"u{n}" for n in (1, 2, 4, 8)},
    **{f"Float{8 * n}": f"f{n}" for n in (4, 8)},
}
NAMES = {form: name for name, form in TYPES.items()}
ORDERS = {"LittleEndian": "<", "BigEndian": ">"}
WORDS = {"UInt32": "u4", "UInt64": "u8"}
ZLIB = "vtkZLibDataCompressor"
BLOCK = 1 << 20
STRINGS = 1 << 20
"""The longest array of strings that is read, in bytes."""
LEVEL = 3
UNSPEAKABLE = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
UNIT = "metres_per_unit"
MARK = b"<AppendedData"


class Writer:
    """A file being put together: its elements, and the blocks appended after them."""

    def __init__(self, kind: str) -> None:
        head = {"type": kind, "version": "1.0", "byte_order": "LittleEndian"}
        self.root = Element("VTKFile", {**head, "header_type": "UInt64", "compressor": ZLIB})
        self.blobs: list[bytes] = []
        self.size = 0

    def array(self, parent: Element, name: str, values: NDArray[Any], **more: str) -> Element:
        """Append an array; one of two dimensions has components. Return its element."""
        if UNSPEAKABLE.search(name):
            refuse("a name", name, "characters that XML can hold")
        if values.ndim == 2:
            more = {"NumberOfComponents": str(values.shape[1]), **more}
        form = NAMES[values.dtype.str[1:]]
        more = {"Name": name, **more, "format": "appended", "offset": str(self.size)}
        element = SubElement(parent, "DataArray", {"type": form, **more})
        blobs = _compressed(values)
        self.blobs += blobs
        self.size += sum(map(len, blobs))
        return element

    def field(self, parent: Element, name: str, values: NDArray[Any]) -> None:
        """Append an array that belongs to the whole file."""
        self.array(parent, name, values, NumberOfTuples=str(len(values)))

    def unit(self, parent: Element, unit: str) -> None:
        """Say the unit of length as a number: not every reader of VTK's files knows texts."""
        self.field(parent, UNIT, np.array([METRES[unit]]))

    def strings(self, parent: Element, name: str, values: Sequence[str]) -> None:
        """Write short texts in place, as VTK does: the codes of their characters, ended by 0."""
        count = str(len(values))
        more = {"Name": name, "NumberOfTuples": count, "format": "ascii"}
        codes = b"".join(text.encode() + b"\0" for text in values)
        SubElement(parent, "Array", {"type": "String", **more}).text = " ".join(map(str, codes))

    def chunks(self) -> Iterator[bytes]:
        """Return the file's bytes."""
        indent(self.root)
        yield b'<?xml version="1.0"?>\n' + tostring(self.root).removesuffix(b"</VTKFile>")
        yield b'  <AppendedData encoding="raw">\n_'
        yield from self.blobs
        yield b"\n  </AppendedData>\n</VTKFile>\n"


class Document:
    """A file that has been read: its elements, and the arrays that they point to."""

    def __init__(self, data: bytes, kind: str) -> None:
        split = data.find(MARK)
        self.root = markup(data if split < 0 else data[:split] + b"</VTKFile>")
        if self.root.tag != "VTKFile" or self.root.get("type") != kind:
            refuse("root", f"{self.root.tag} {self.root.get('type')}", f"VTKFile {kind}")
        order = _one_of(self.root, "byte_order", ORDERS, "LittleEndian")
        self.order = order
        self.word = np.dtype(order + _one_of(self.root, "header_type", WORDS, "UInt32"))
        self.compressed = bool(_one_of(self.root, "compressor", {"": "", ZLIB: "zlib"}, ""))
        self.tail = _Blocks(b"", raw=True) if split < 0 else _tail(data, split)

    def array(self, element: Element, count: int, what: str) -> NDArray[Any]:
        """Return the ``count`` numbers of an array, in the machine's byte order."""
        form = np.dtype(self.order + _one_of(element, "type", TYPES, ""))
        if element.get("format") == "ascii":
            return _spelt(element, count, form, what)
        need(count, 2**48, what, unit="numbers")
        size = count * form.itemsize
        return np.frombuffer(self._bytes(element, size, size, what), form).astype(
            form.newbyteorder("="), copy=False
        )

    def strings(self, element: Element, what: str) -> tuple[str, ...]:
        """Return the texts of an array of strings."""
        if element.get("format") == "ascii":
            codes = whole(numbers(_text(element), what, most=STRINGS), what)
            if codes.size and not 0 <= codes.min() <= codes.max() < 256:
                refuse(what, codes.tolist(), "codes of characters")
            data: bytes | bytearray = codes.astype(np.uint8).tobytes()
        else:
            data = self._bytes(element, 0, STRINGS, what)
        return tuple(data.decode("utf-8", "replace").split("\0")[:-1])

    def _bytes(self, element: Element, least: int, most: int, what: str) -> bytes | bytearray:
        form = element.get("format")
        if form == "appended":
            blocks, place = self.tail, integer(element.get("offset"), f"offset of {what}")
        elif form == "binary":
            blocks, place = _Blocks(_text(element).translate(None, b" \t\r\n"), raw=False), 0
        else:
            refuse(f"format of {what}", form, "ascii, binary or appended")
        need(place, len(blocks.data), f"offset of {what}")
        if self.compressed:
            return self._inflated(blocks, place, least, most, what)
        size = int(np.frombuffer(blocks.take(place, self.word.itemsize, what)[0], self.word)[0])
        _check_size(size, least, most, what)
        return blocks.take(place, self.word.itemsize + size, what)[0][self.word.itemsize :]

    def _inflated(self, blocks: _Blocks, place: int, least: int, most: int, what: str) -> bytearray:
        width = self.word.itemsize
        head = np.frombuffer(blocks.take(place, 3 * width, what)[0], self.word)
        count, block, last = (int(v) for v in head)
        need(count * width, len(blocks.data), f"{count} blocks of {what}")
        words, place = blocks.take(place, (3 + count) * width, what)
        lengths = [int(v) for v in np.frombuffer(words, self.word)[3:]]
        sizes = [block] * count
        if count and last:
            sizes[-1] = last
        _check_size(sum(sizes), least, most, what)
        need(sum(sizes), RATIO * sum(lengths), what)
        check_memory(2 * sum(sizes), what, "Make the file in parts.")
        packed = memoryview(blocks.take(place, sum(lengths), what)[0])
        ends = np.cumsum([0, *lengths]).tolist()
        spans = zip(ends, ends[1:], sizes, strict=False)
        result, done = bytearray(sum(sizes)), 0
        for a, b, size in spans:
            result[done : done + size] = inflate(packed[a:b], size, what)
            done += size
        return result


class _Blocks:
    """Bytes as they stand, or in base64, where each unit is padded by itself."""

    def __init__(self, data: bytes | memoryview, *, raw: bool) -> None:
        self.data, self.raw = data, raw

    def take(self, place: int, size: int, what: str) -> tuple[bytes, int]:
        """Return ``size`` bytes of the unit at ``place``, and where the next unit begins."""
        stop = place + (size if self.raw else -(-size // 3) * 4)
        need(stop - place, len(self.data) - place, what)
        piece = bytes(self.data[place:stop])
        if not self.raw:
            try:
                piece = base64.b64decode(piece, validate=True)[:size]
            except binascii.Error as error:
                raise FormatError(f"{what}: base64 is damaged ({error})") from None
        need(size, len(piece), what)
        return piece, stop


def named(parent: Element | None) -> dict[str, Element]:
    """Return the arrays under an element by name; a name that stands twice is refused."""
    arrays = [] if parent is None else [e for e in parent if e.tag in ("DataArray", "Array")]
    result = {element.get("Name", ""): element for element in arrays}
    if len(result) < len(arrays):
        refuse("arrays", ", ".join(e.get("Name", "") for e in arrays), "each name once")
    return result


def child(parent: Element, tag: str) -> Element:
    """Return the one child of that name."""
    found = parent.findall(tag)
    if len(found) != 1:
        raise FormatError(f"{parent.tag} has {len(found)} {tag}; wanted one")
    return found[0]


def word(document: Document, fields: dict[str, Element], name: str, default: str) -> str:
    """Return the one text of a field, or ``default`` where the file has none of that name."""
    texts = document.strings(fields[name], name) if name in fields else (default,)
    if len(texts) != 1:
        refuse(name, texts, "one text")
    return texts[0]


def unit_of(document: Document, fields: dict[str, Element]) -> str:
    """Return the unit of length of a file; millimetres where it says nothing."""
    if UNIT not in fields:
        return "mm"
    metres = float(document.array(fields[UNIT], 1, UNIT)[0])
    for unit, length in METRES.items():
        if math.isclose(metres, length, rel_tol=1e-6):
            return unit
    lengths = ", ".join(f"{length} ({unit})" for unit, length in METRES.items())
    return refuse(UNIT, metres, f"one of {lengths}")


def vector(element: Element, name: str, count: int, default: str | None = None) -> list[float]:
    """Return the numbers of an attribute."""
    text = element.get(name, default)
    values = numbers((text or "").encode(), name, most=count)
    if len(values) != count:
        refuse(name, text, f"{count} numbers")
    return [float(v) for v in values]


def _one_of(element: Element, name: str, table: dict[str, str], default: str) -> str:
    got = element.get(name, default)
    if got not in table:
        refuse(name, got, f"one of {', '.join(table)}")
    return table[got]


def _check_size(size: int, least: int, most: int, what: str) -> None:
    if not least <= size <= most:
        raise FormatError(f"{what}: got {size} bytes; wanted {least if least else f'up to {most}'}")


def _text(element: Element) -> bytes:
    tails = [child.tail or "" for child in element]  # what VTK says of an array may stand within
    return "".join([element.text or "", *tails]).encode("ascii", "replace")


def _spelt(element: Element, count: int, form: np.dtype[Any], what: str) -> NDArray[Any]:
    values = numbers(_text(element), what, most=count)
    if len(values) != count:
        refuse(what, f"{len(values)} numbers", f"{count}")
    native = form.newbyteorder("=")
    if form.kind == "f":
        return values.astype(native)
    exact, limits = whole(values, what), np.iinfo(native)
    if count and not limits.min <= exact.min() <= exact.max() <= limits.max:
        refuse(what, f"{exact.min()} to {exact.max()}", f"{limits.min} to {limits.max}")
    return exact.astype(native)


def _tail(data: bytes, split: int) -> _Blocks:
    stop = data.find(b">", split, split + HEADER)
    start = data.find(b"_", stop, stop + HEADER)
    if stop < 0 or start < 0 or data[stop + 1 : start].strip():
        raise FormatError("AppendedData has no beginning; wanted an underscore before the bytes")
    encoding = markup(data[split:stop] + b"/>").get("encoding")
    if encoding not in ("raw", "base64"):
        refuse("encoding of AppendedData", encoding, "raw or base64")
    end = len(data)
    if encoding == "base64":
        end = max(data.find(b"<", start), 0) or end
    return _Blocks(memoryview(data)[start + 1 : end], raw=encoding == "raw")


def _compressed(values: NDArray[Any]) -> list[bytes]:
    little = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    flat = little.reshape(-1).view(np.uint8)
    pieces = [flat[i : i + BLOCK] for i in range(0, len(flat), BLOCK)]
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        packed = list(pool.map(lambda piece: zlib.compress(piece, LEVEL), pieces))
    head = [len(packed), BLOCK, len(flat) % BLOCK, *map(len, packed)]
    return [np.array(head, dtype="<u8").tobytes(), *packed]
