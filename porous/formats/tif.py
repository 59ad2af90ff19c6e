"""TIFF stack: pages are layers along z, rows run along y and columns along x.

Written as Fiji reads it: one page of uint8 a layer, compressed by deflate, with the voxels a unit
along x and y in the resolution, and ``spacing``, ``unit`` and origin in ImageJ's description;
BigTIFF where offsets would not fit into 32 bits. The description also holds the mark
(``_image``), and a private tag the bulk. Read: grey stacks of any program (``_tiff``), in one file.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.errors import FormatError
from porous.formats import _image as images
from porous.formats import _tiff as tiff
from porous.formats._registry import Format
from porous.formats.gate import inflate, markup, need, refuse
from porous.values import VoxelGrid
from porous.values.image import Image

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.formats._tiff import Page, Tags
    from porous.formats.gate import Source
    from porous.values import Frame

LARGEST = 2**32 - 1
"""What a RATIONAL's numbers and a classic TIFF's offsets may be at most."""
UNITS = {2: "in", 3: "cm"}
"""What ResolutionUnit means; 1 is no unit but ImageJ's own."""
SCREENS = (1, 72, 96)
"""Dots per inch that programs write which know no spacing."""
BYTE, ASCII, SHORT, LONG, RATIONAL, LONG8 = 1, 2, 3, 4, 5, 16
IMAGEJ = "ImageJ="


def read(source: Source) -> VoxelGrid:
    """Read a grid of voxels: what porous wrote, or a segmented stack of two values."""
    tags, pages = tiff.pages_of(source.data)
    words = _words(tags[0])
    image = _image(source, tags[0], pages, words)
    entries = images.entries_of(words.get("porous"))
    if entries is None:
        return images.grid_of(image, None, source)
    bulk = None
    if entries.get("bulk") is not None and tiff.BULK in tags[0]:
        flat = inflate(tags[0][tiff.BULK].tobytes(), image.values.size, "the bulk")
        bulk = _in_order(np.frombuffer(flat, np.uint8).reshape(image.shape[::-1]))
    return images.grid_of(image, images.Mark(entries, bulk), source)


def read_image(source: Source) -> Image:
    """Read the grey values as they are."""
    tags, pages = tiff.pages_of(source.data)
    return _image(source, tags[0], pages, _words(tags[0]))


def _image(source: Source, tags: Tags, pages: list[Page], words: dict[str, str]) -> Image:
    values = _in_order(_stack(source, pages, words))
    spacing, unit = _spacing(source, tags, words)
    pixels = [_number(words.get(f"{axis}origin"), 0.0) for axis in "xyz"]
    x, y, z = (-p * h for p, h in zip(pixels, spacing, strict=True))
    return Image(values, spacing, (x, y, z), unit)


def _in_order(values: NDArray[Any]) -> NDArray[Any]:
    return values.transpose(2, 1, 0)


def _stack(source: Source, pages: list[Page], words: dict[str, str]) -> NDArray[Any]:
    """Return the layers of all pages, shape (z, y, x)."""
    data, first = memoryview(source.data), pages[0]
    rows, columns = first.shape
    layers = _layers(source, words, len(pages))
    if layers > len(pages) == 1:
        return _after_one_page(data, first, layers)
    width = np.dtype(first.form).itemsize
    most = sum(page.most for page in pages) * (8 if first.bits == 1 else 1)
    images.check_size((columns, rows, len(pages)), width, most)
    there = _as_they_lie(data, pages)
    if there is not None:
        return there
    result = np.empty((len(pages), rows, columns), first.form.newbyteorder("="))
    for k, page in enumerate(pages):
        result[k] = page.voxels(data)
    return result


def _as_they_lie(data: memoryview, pages: list[Page]) -> NDArray[Any] | None:
    """Return a view of layers that lie in the file as in memory, None where they do not."""
    first, start = pages[0], int(pages[0].offsets[0])
    rows, columns = first.shape
    size = rows * columns * first.form.itemsize
    if not first.form.isnative or start % first.form.itemsize or not all(map(_lies_whole, pages)):
        return None
    gaps = np.diff([int(page.offsets[0]) for page in pages])
    if len(gaps) and ((gaps != gaps[0]).any() or gaps[0] < size or gaps[0] % first.form.itemsize):
        return None
    steps = (int(gaps[0]) if len(gaps) else size, columns * first.form.itemsize)
    strides = (*steps, first.form.itemsize)
    return np.ndarray((len(pages), rows, columns), first.form, data, start, strides)


def _lies_whole(page: Page) -> bool:
    """Whether a page's voxels lie row by row, in strips that follow on each other."""
    plain = page.compression == tiff.NONE and page.predictor == 1 and page.bits > 1
    if not plain or page.tiled or page.negative:
        return False
    (rows, columns), high = page.shape, page.piece[0]
    tops = np.append(np.arange(0, rows, high), rows) * (columns * page.form.itemsize)
    ends = np.append(page.offsets, page.offsets[-1] + page.counts[-1]) - page.offsets[0]
    return np.array_equal(ends, tops) and np.array_equal(page.counts, np.diff(tops))


def _after_one_page(data: memoryview, page: Page, layers: int) -> NDArray[Any]:
    """Return layers that stand one after the other, of which the file has one page only."""
    if page.compression != tiff.NONE or page.tiled or page.bits == 1 or page.predictor != 1:
        refuse(
            "the stack", f"one page for {layers} images", "a page for each where they are packed"
        )
    rows, columns = page.shape
    start = int(page.offsets[0])
    ends = page.offsets + page.counts
    if (page.offsets[1:] != ends[:-1]).any():
        refuse("the stack", "strips with gaps", "images that follow each other")
    size = images.check_size((columns, rows, layers), page.form.itemsize, len(data) - start)
    values = np.frombuffer(data[start : start + size], page.form).reshape(layers, rows, columns)
    values = values.astype(page.form.newbyteorder("="), copy=False)
    return ~values if page.negative else values


def _layers(source: Source, words: dict[str, str], pages: int) -> int:
    """Return how many images there are, by ImageJ or tifffile; refuse several channels of each."""
    channels, frames, slices = (_whole(words, name) for name in ("channels", "frames", "slices"))
    said = f"{channels} channels, {frames} frames, {slices} slices"
    if sorted((channels, frames, slices))[1] > 1:
        refuse("the stack", said, "layers of one channel at one time: split it")
    if max(channels, frames) > 1:  # as programs do that do not ask what an axis is
        source.note(f"it says {said}; taken as layers along z")
    return max(_whole(words, "images"), 1) if pages == 1 else pages


def _whole(words: dict[str, str], name: str) -> int:
    text = words.get(name, "1")
    if not text.isdecimal() or len(text) > 9:
        refuse(name, text, "a whole number")
    return int(text)


def _number(text: str | None, default: float) -> float:
    try:
        value = float(text) if text is not None and len(text) < 64 else default
    except ValueError:
        return default
    return value if math.isfinite(value) else default


def _words(tags: Tags) -> dict[str, str]:
    """Return what ImageJ's description says, or that of OME; nothing for descriptions of others."""
    raw = tags.get(tiff.DESCRIPTION)
    if raw is None or raw.dtype.itemsize != 1:
        return {}
    blob = raw.tobytes()[: 16 * images.MARK].split(b"\0")[0]
    text = blob.decode("utf-8", "replace") if _is_utf8(blob) else blob.decode("latin-1")
    if text.startswith(IMAGEJ):
        pairs = [line.partition("=") for line in text.splitlines()]
        return {name.strip(): value.strip() for name, sign, value in pairs if sign}
    return _of_ome(text) if "<OME" in text[:2000] else _of_tifffile(text)


def _is_utf8(blob: bytes) -> bool:
    try:
        blob.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def _of_ome(text: str) -> dict[str, str]:
    """Return what OME-XML says of the first image, in ImageJ's words; lengths are ``steps``."""
    try:
        root = markup(text.encode())
    except FormatError:
        return {}
    pixels = next((e for e in root.iter() if e.tag.rpartition(":")[2] == "Pixels"), None)
    if pixels is None:
        return {}
    names = {"channels": "SizeC", "frames": "SizeT", "slices": "SizeZ"}
    words = {ours: pixels.get(theirs, "1") for ours, theirs in names.items()}
    units = {pixels.get(f"PhysicalSize{axis}Unit", "µm") for axis in "XYZ"}
    steps = [pixels.get(f"PhysicalSize{axis}") for axis in "XYZ"]
    if len(units) == 1 and all(_number(step, 0.0) > 0 for step in steps):
        words |= {"unit": units.pop(), "steps": " ".join(map(str, steps))}
    return words


def _of_tifffile(text: str) -> dict[str, str]:
    """Return how many images follow where tifffile left all pages out but the first."""
    try:
        said = json.loads(text) if text.startswith('{"shape"') else {}
        shape = said["shape"] if said.get("truncated") else []
        return {"images": str(math.prod(shape[:-2]))} if shape else {}
    except (ValueError, RecursionError, TypeError, KeyError, AttributeError):
        return {}


def _spacing(source: Source, tags: Tags, words: dict[str, str]) -> tuple[images.Vector, str]:
    """Return spacing and unit; 1 mm, with a note, where the file says nothing of use."""
    across = [_resolution(tags.get(tag)) for tag in (tiff.X_RESOLUTION, tiff.Y_RESOLUTION)]
    unit = _unit(tags, words, across[0])
    if unit is not None and "steps" in words:
        x, y, z = map(float, words["steps"].split())
        return (x, y, z), unit
    if unit is None or not all(across):
        source.note("it says no voxel size; taken as 1 mm along x, y and z")
        return (1.0, 1.0, 1.0), "mm"
    x, y = (1 / r for r in across)
    z = _number(words.get("spacing"), 0.0)
    if not z > 0:
        source.note(f"it says no distance of layers; taken as that of columns, {x:.6g} {unit}")
        z = x
    return (x, y, z), unit


def _unit(tags: Tags, words: dict[str, str], across: float) -> str | None:
    if "unit" in words:
        name = words["unit"].replace("\\u00B5", "µ").lower()
        return images.NAMES.get(name)
    raw = tags.get(tiff.RESOLUTION_UNIT)
    number = 2 if raw is None or raw.dtype.kind != "u" or len(raw) != 1 else int(raw[0])
    if number == 2 and round(across, 3) in SCREENS:
        return None
    return UNITS.get(number)


def _resolution(pair: NDArray[Any] | None) -> float:
    """Return voxels per unit; 0 where the file does not say."""
    if pair is None or len(pair) != 2 or pair.dtype.kind != "u" or not pair.all():
        return 0.0
    return float(pair[0]) / float(pair[1])


# --- writing -----------------------------------------------------------------------------------


def write(grid: VoxelGrid) -> Iterator[bytes]:
    """Write a grid of voxels, a page a layer."""
    frame = grid.frame
    x, y, z = frame.shape
    bulk = b"" if grid.bulk is None else zlib.compress(b"".join(images.layers(grid.bulk)), 3)
    most = frame.size + frame.size // 1000 + 1024 * (z + 8) + len(bulk)
    layout = _Layout(most > LARGEST)
    place = layout.start
    yield layout.head()
    extra = _first(grid, bulk)
    for number, strip in enumerate(images.in_parallel(_slices(grid.fill, x * y))):
        tags = [*_page_tags(frame, len(strip)), *(extra if not number else [])]
        page = layout.page(tags, strip, place, last=number == z - 1)
        place += len(page)
        yield page


def _slices(values: NDArray[np.uint8], size: int) -> Iterator[bytes]:
    for piece in images.layers(values):
        yield from (piece[k : k + size] for k in range(0, len(piece), size))


Tag = tuple[int, int, int, bytes]
"""Number, type, count and the value's bytes; a strip's offset is put in where it is known."""


class _Layout:
    """How directories lie in a file: 32-bit offsets, or 64-bit ones in a BigTIFF."""

    def __init__(self, big: bool) -> None:  # noqa: FBT001  (one of two kinds of file)
        self.big, self.word = big, "Q" if big else "I"
        self.start = 16 if big else 8

    def head(self) -> bytes:
        """Return the file's beginning, after which the first page stands."""
        if self.big:
            return struct.pack("<2sHHHQ", b"II", 43, 8, 0, self.start)
        return struct.pack("<2sHI", b"II", 42, self.start)

    def page(self, tags: list[Tag], strip: bytes, place: int, *, last: bool) -> bytes:
        """Return a directory at ``place``, its values and its strip; the next one follows."""
        room = 8 if self.big else 4
        ends = struct.calcsize("<Q" if self.big else "<H"), room
        size = sum(ends) + len(tags) * (20 if self.big else 12)
        values, entries = b"", []
        after = place + size + sum(len(v) + len(v) % 2 for *_, v in tags if len(v) > room)
        after += (room - after % room) % room
        for tag, form, count, given in sorted(tags):
            value = struct.pack("<" + self.word, after) if tag == tiff.OFFSETS else given
            kind = LONG8 if self.big and tag == tiff.OFFSETS else form
            where = value.ljust(room, b"\0")
            if len(value) > room:
                where = struct.pack("<" + self.word, place + size + len(values))
                values += value + b"\0" * (len(value) % 2)
            entries.append(struct.pack("<HH" + self.word, tag, kind, count) + where)
        tail = b"\0" * (-(after + len(strip)) % room)
        following = 0 if last else after + len(strip) + len(tail)
        head = struct.pack("<Q" if self.big else "<H", len(tags)) + b"".join(entries)
        body = head + struct.pack("<" + self.word, following) + values
        return body.ljust(after - place, b"\0") + strip + tail


def _page_tags(frame: Frame, size: int) -> list[Tag]:
    numbers = [
        (tiff.WIDTH, LONG, frame.shape[0]),
        (tiff.HEIGHT, LONG, frame.shape[1]),
        (tiff.BITS, SHORT, 8),
        (tiff.COMPRESSION, SHORT, tiff.DEFLATE),
        (tiff.PHOTOMETRIC, SHORT, tiff.BLACK_IS_ZERO),
        (tiff.OFFSETS, LONG, 0),
        (tiff.SAMPLES, SHORT, 1),
        (tiff.ROWS, LONG, frame.shape[1]),
        (tiff.COUNTS, LONG, size),
        (tiff.RESOLUTION_UNIT, SHORT, {"in": 2, "cm": 3}.get(frame.unit, 1)),
    ]
    tags = [(t, k, 1, struct.pack("<H" if k == SHORT else "<I", v)) for t, k, v in numbers]
    for tag, h in zip((tiff.X_RESOLUTION, tiff.Y_RESOLUTION), frame.spacing, strict=False):
        tags.append((tag, RATIONAL, 1, struct.pack("<II", *_ratio(1 / h))))
    return tags


def _ratio(value: float) -> tuple[int, int]:
    """Return two numbers of 32 bits whose quotient is next to ``value``."""
    exact = Fraction(value)
    most = LARGEST if exact <= 1 else int(LARGEST / exact)
    near = exact.limit_denominator(max(most, 1))
    if not 0 < near.numerator <= LARGEST:
        refuse("spacing", 1 / value, f"between {1 / LARGEST:.1e} and {LARGEST:.1e} units")
    return near.numerator, near.denominator


def _first(grid: VoxelGrid, bulk: bytes) -> list[Tag]:
    """Return what the first page alone says: the description, and the bulk."""
    frame = grid.frame
    corner = [-low / h for low, h in zip(frame.box.lower, frame.spacing, strict=True)]
    lines = [
        f"{IMAGEJ}1.11a",
        f"images={frame.shape[2]}",
        f"slices={frame.shape[2]}",
        f"unit={'inch' if frame.unit == 'in' else frame.unit}",
        f"spacing={frame.spacing[2]!r}",
        *(f"{axis}origin={value!r}" for axis, value in zip("xyz", corner, strict=True)),
        "loop=false",
        "min=0.0",
        "max=255.0",
        f"porous={images.mark_of(grid)}\n\0",
    ]
    text = "\n".join(lines).encode("ascii")
    tags: list[Tag] = [
        (tiff.DESCRIPTION, ASCII, len(text), text),
        (tiff.SOFTWARE, ASCII, 7, b"porous\0"),
    ]
    if bulk:
        need(len(bulk), LARGEST, "the bulk")
        tags.append((tiff.BULK, BYTE, len(bulk), bulk))
    return tags


FORMAT = Format(
    "TIFF stack",
    (".tif", ".tiff"),
    VoxelGrid,
    read,
    (VoxelGrid,),
    write,
    read_image=read_image,
)
