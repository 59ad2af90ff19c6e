"""What TIFF files are made of: directories of tags, and strips or tiles of packed voxels.

Classic TIFF and BigTIFF, both byte orders. Offsets of a hostile file may point anywhere: each
directory is read once, and all that tags point to may be no longer than the file itself.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.errors import FormatError
from porous.formats.gate import RATIO, inflate, need, refuse

if TYPE_CHECKING:
    from numpy.typing import NDArray

PAGES, TAGS = 16384, 4096
"""The most pages of a file, and the most tags of a page."""
TYPES = {
    **dict.fromkeys((1, 2, 7), "u1"),
    **dict.fromkeys((4, 5, 13), "u4"),
    **dict.fromkeys((9, 10), "i4"),
    **dict.fromkeys((16, 18), "u8"),
    **dict(zip((3, 6, 8, 11, 12, 17), ("u2", "i1", "i2", "f4", "f8", "i8"), strict=True)),
}
PAIRS = (5, 10)
"""Types whose values are two numbers each."""
SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC = 254, 256, 257, 258, 259, 262
ORDER, DESCRIPTION, OFFSETS, SAMPLES, ROWS, COUNTS = 266, 270, 273, 277, 278, 279
X_RESOLUTION, Y_RESOLUTION, RESOLUTION_UNIT, SOFTWARE, PREDICTOR = 282, 283, 296, 305, 317
TILE_WIDTH, TILE_HEIGHT, TILE_OFFSETS, TILE_COUNTS, SAMPLE_FORMAT = 322, 323, 324, 325, 339
BULK = 65110
"""A tag of our own: the bulk, compressed by zlib."""
WANTED = {
    *(SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, ORDER, DESCRIPTION, OFFSETS),
    *(SAMPLES, ROWS, COUNTS, X_RESOLUTION, Y_RESOLUTION, RESOLUTION_UNIT, PREDICTOR),
    *(TILE_WIDTH, TILE_HEIGHT, TILE_OFFSETS, TILE_COUNTS, SAMPLE_FORMAT, BULK),
}
NONE, LZW, DEFLATE, PACKBITS, OLD_DEFLATE = 1, 5, 8, 32773, 32946
MOST = {NONE: 1, LZW: 4096, DEFLATE: RATIO, OLD_DEFLATE: RATIO, PACKBITS: 64}
"""How many bytes one byte of a strip may become."""
FORMS = {
    **{(bits, 1): f"u{bits // 8}" for bits in (8, 16, 32, 64)},
    **{(bits, 2): f"i{bits // 8}" for bits in (8, 16, 32, 64)},
    **{(bits, 3): f"f{bits // 8}" for bits in (32, 64)},
    (1, 1): "b1",
}
"""Types of voxels by their bits and their sample format."""
WHITE_IS_ZERO, BLACK_IS_ZERO = 0, 1

Tags = dict[int, "NDArray[Any]"]


@dataclass(frozen=True)
class Page:
    """One image of a file: how its voxels lie and are packed, and where the pieces are."""

    shape: tuple[int, int]
    """Rows and columns."""
    form: np.dtype[Any]
    negative: bool
    """Whether white is zero."""
    compression: int
    predictor: int
    piece: tuple[int, int]
    """Rows and columns of a strip or tile."""
    tiled: bool
    offsets: NDArray[np.int64]
    counts: NDArray[np.int64]
    bits: int

    @property
    def kind(self) -> str:
        """What all pages of a stack must have in common, in words."""
        colours = "white is zero" if self.negative else "black is zero"
        return f"{self.shape[1]} × {self.shape[0]} of {self.form}, {colours}"

    @property
    def most(self) -> int:
        """How many bytes its pieces can become at most."""
        return int(self.counts.sum()) * MOST[self.compression]

    def voxels(self, data: memoryview) -> NDArray[Any]:
        """Return the values, shape ``shape``, in the machine's byte order."""
        rows, columns = self.shape
        high, wide = self.piece
        across = -(-columns // wide)
        result = np.empty(self.shape, self.form.newbyteorder("="))
        for k, (offset, count) in enumerate(zip(self.offsets, self.counts, strict=True)):
            top, left = k // across * high, k % across * wide
            tall = high if self.tiled else min(high, rows - top)
            values = self._piece(data[offset : offset + count], tall, wide)
            there = result[top : top + tall, left : left + wide]
            there[:] = values[: there.shape[0], : there.shape[1]]
        return ~result if self.negative else result  # of unsigned numbers: the largest less each

    def _piece(self, packed: memoryview, rows: int, columns: int) -> NDArray[Any]:
        line = -(-columns * self.bits // 8)
        flat = _unpacked(packed, rows * line, self.compression)
        if self.bits == 1:
            bits = np.unpackbits(flat.reshape(rows, line), axis=1, count=columns)
            return bits.view(np.bool_)
        values = flat.view(self.form).reshape(rows, columns)
        values = values.astype(self.form.newbyteorder("="), copy=False)
        if self.predictor == 1:
            return values
        whole = values.view(f"u{values.itemsize}")
        return np.cumsum(whole, axis=1, dtype=whole.dtype).view(values.dtype)


def pages_of(data: bytes) -> tuple[list[Tags], list[Page]]:
    """Return the tags of all pages but thumbnails, and what they mean for the first and others."""
    directories = _Directories(data)
    all_tags = [tags for tags in directories if not int(_one(tags, SUBFILE, 0)) & 1]
    if not all_tags:
        raise FormatError("no image in it; wanted a stack of pages")
    pages = []
    for number, tags in enumerate(all_tags):
        try:
            pages.append(_page(tags, len(data), directories.order))
        except FormatError as error:
            raise FormatError(f"page {number + 1}: {error}") from None
    other = [str(k + 1) for k, page in enumerate(pages) if page.kind != pages[0].kind]
    if other:
        k = int(other[0]) - 1
        shown = ", ".join(other[:8]) + (", …" if len(other) > 8 else "")
        raise FormatError(
            f"pages {shown} of {len(pages)} are not like the first: page {k + 1} is "
            f"{pages[k].kind}; wanted {pages[0].kind}"
        )
    need(sum(int(page.counts.sum()) for page in pages), len(data), "the strips of all pages")
    return all_tags, pages


class _Directories:
    """The directories of a file, one after the other, each resolved into its tags."""

    def __init__(self, data: bytes) -> None:
        order = {b"II": "<", b"MM": ">"}.get(data[:2], "")
        version = int.from_bytes(data[2:4], "little" if order == "<" else "big")
        if not order or version not in (42, 43):
            refuse("its beginning", data[:4], "II or MM, then 42 or 43: TIFF or BigTIFF")
        self.data, self.order, self.big = data, order, version == 43
        self.word = "Q" if self.big else "I"
        self.entry = struct.Struct(f"{order}HH{self.word}{8 if self.big else 4}x")
        self.left = len(data)

    def __iter__(self) -> Any:
        """Give the tags of each directory."""
        if self.big and self._numbers("HH", 4) != (8, 0):
            refuse("bytes of an offset", self._numbers("HH", 4), "8, then 0")
        (place,) = self._numbers(self.word, 8 if self.big else 4)
        seen: set[int] = set()
        while place:
            if place in seen:
                raise FormatError(f"its pages run in a circle: after {len(seen)} comes one of them")
            seen.add(place)
            need(len(seen), PAGES, "the stack", unit="pages")
            tags, place = self._directory(place)
            yield tags

    def _numbers(self, form: str, place: int) -> tuple[int, ...]:
        size = struct.calcsize(self.order + form)
        need(place + size, len(self.data), "a directory")
        return struct.unpack_from(self.order + form, self.data, place)

    def _directory(self, place: int) -> tuple[Tags, int]:
        (count,) = self._numbers("Q" if self.big else "H", place)
        if not count:
            refuse("a directory", "no tags", "those of an image")
        need(count, TAGS, "a directory", unit="tags")
        start = place + (8 if self.big else 2)
        size = count * self.entry.size
        following = self._numbers(self.word, start + size)[0]
        self._take(size)
        entries = self.entry.iter_unpack(memoryview(self.data)[start : start + size])
        tags: Tags = {}
        for k, (tag, kind, values) in enumerate(entries):
            if tag in WANTED:
                if tag in tags:
                    refuse("tags of a page", tag, "each tag once")
                tags[tag] = self._values(tag, kind, values, start + k * self.entry.size)
        return tags, following

    def _values(self, tag: int, kind: int, count: int, place: int) -> NDArray[Any]:
        if kind not in TYPES:
            refuse(f"type of tag {tag}", kind, f"one of {', '.join(map(str, TYPES))}")
        form = np.dtype(self.order + TYPES[kind])
        numbers = 2 * count if kind in PAIRS else count
        size, room = numbers * form.itemsize, 8 if self.big else 4
        place += 12 if self.big else 8
        if size > room:
            place = self._numbers(self.word, place)[0]
            need(place + size, len(self.data), f"tag {tag}")
            self._take(size)
        return np.frombuffer(self.data, form, numbers, place)

    def _take(self, size: int) -> None:
        self.left -= size
        if self.left < 0:
            raise FormatError("its directories lie over each other: they are longer than the file")


def _page(tags: Tags, size: int, order: str) -> Page:
    width, height = (_one(tags, tag, 0) for tag in (WIDTH, HEIGHT))
    if not (0 < width < 2**32 and 0 < height < 2**32):
        refuse("width and height", f"{width} × {height}", "at least 1 each")
    negative = _check_grey(tags)
    bits, form = _form(tags, order)
    if negative and form.kind not in "ub":
        refuse("photometric", "white is zero", f"black is zero for voxels of {form}")
    compression, predictor = _one(tags, COMPRESSION, NONE), _one(tags, PREDICTOR, 1)
    if compression not in MOST:
        refuse("compression", compression, "none (1), LZW (5), deflate (8) or PackBits (32773)")
    if predictor not in (1, 2) or (predictor == 2 and (bits == 1 or form.kind == "f")):
        refuse("predictor", predictor, "none (1), or horizontal (2) of whole numbers")
    tiled = TILE_WIDTH in tags
    piece = _piece(tags, height, width, tiled=tiled)
    offsets, counts = (_many(tags, tag) for tag in _places(tiled=tiled))
    across = -(-width // piece[1]) * -(-height // piece[0])
    if len(offsets) != across or len(counts) != across:
        got = f"{len(offsets)} and {len(counts)}"
        refuse("offsets and lengths of strips or tiles", got, f"{across} each")
    if (offsets < 0).any() or (counts < 0).any() or (offsets + counts > size).any():
        refuse("a strip or tile", f"at {offsets.max()}", f"one that lies within the {size} bytes")
    return Page(
        (height, width),
        form,
        negative,
        compression,
        predictor,
        piece,
        tiled,
        offsets,
        counts,
        bits,
    )


def _places(*, tiled: bool) -> tuple[int, int]:
    return (TILE_OFFSETS, TILE_COUNTS) if tiled else (OFFSETS, COUNTS)


def _check_grey(tags: Tags) -> bool:
    """Refuse colours; return whether white is zero."""
    samples, photometric = _one(tags, SAMPLES, 1), _one(tags, PHOTOMETRIC, BLACK_IS_ZERO)
    if photometric == 3:
        refuse("colours", "a colour table", "grey values; save it as an 8-bit grey image")
    if samples != 1 or photometric not in (WHITE_IS_ZERO, BLACK_IS_ZERO):
        refuse("numbers of a voxel", samples, "one grey value; save it as an 8-bit grey image")
    if _one(tags, ORDER, 1) != 1:
        refuse("order of bits", _one(tags, ORDER, 1), "1: the highest bit first")
    return photometric == WHITE_IS_ZERO


def _form(tags: Tags, order: str) -> tuple[int, np.dtype[Any]]:
    bits, sample = _one(tags, BITS, 1), _one(tags, SAMPLE_FORMAT, 1)
    sample = 1 if sample == 4 else sample  # 4 says nothing of the kind
    if (bits, sample) not in FORMS:
        refuse("bits and sample format", f"{bits} and {sample}", "1, 8, 16, 32 or 64 bits")
    return bits, np.dtype(order + FORMS[bits, sample])


def _piece(tags: Tags, height: int, width: int, *, tiled: bool) -> tuple[int, int]:
    if not tiled:
        rows = min(_one(tags, ROWS, height), height)
        if rows < 1:
            refuse("rows of a strip", rows, "at least 1")
        return rows, width
    high, wide = _one(tags, TILE_HEIGHT, 0), _one(tags, TILE_WIDTH, 0)
    if not (0 < high < 2**24 and 0 < wide < 2**24):
        refuse("size of a tile", f"{wide} × {high}", "at least 1 each")
    return high, wide


def _one(tags: Tags, tag: int, default: int) -> int:
    """Return a tag's whole number; every value must be the same where it has several."""
    if tag not in tags:
        return default
    values = tags[tag]
    if values.dtype.kind not in "ui" or not len(values) or (values != values[0]).any():
        refuse(f"tag {tag}", values[:4].tolist(), "one whole number")
    return int(values[0])


def _many(tags: Tags, tag: int) -> NDArray[np.int64]:
    values = tags.get(tag, np.zeros(0, np.int64))
    if values.dtype.kind not in "ui" or (values.size and int(values.max()) >= 2**62):
        refuse(f"tag {tag}", values[:4].tolist(), "places in the file")
    return values.astype(np.int64)


def _unpacked(packed: memoryview, size: int, compression: int) -> NDArray[np.uint8]:
    what = "a strip or tile"
    need(size, len(packed) * MOST[compression], what)
    if compression == NONE:
        return np.frombuffer(packed[:size], np.uint8)
    if compression in (DEFLATE, OLD_DEFLATE):
        return np.frombuffer(inflate(packed, size, what), np.uint8)
    from porous.kernels.lzw import lzw, packbits

    if compression == LZW and packed[0] == 0 and packed[1:2] and packed[1] & 1:
        refuse("compression", "LZW of before 1992", "LZW as TIFF 6.0 has it")
    flat = (lzw if compression == LZW else packbits)(packed, size)
    if len(flat) != size:
        raise FormatError(f"{what}: its packed bytes are damaged after {len(flat)} of {size}")
    return flat
