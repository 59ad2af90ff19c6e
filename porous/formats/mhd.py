"""MetaImage: a header with raw voxels, as ITK, elastix and ImageJ take it.

A ``.mhd`` has its voxels in a ``.raw`` beside it, uint8 with x fastest; a ``.mha`` holds them
itself, compressed by zlib. ``Offset`` is the centre of the first voxel, as in ITK; lengths are in
millimetres, which is what ITK takes them for whatever a header says. The field ``Porous`` holds
the mark (``_image``), and the bulk stands in a ``.bulk.raw`` beside or after the voxels.
https://itk.org/Wiki/MetaIO/Documentation
"""

from __future__ import annotations

import itertools
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.errors import FormatError
from porous.formats import _image as images
from porous.formats._registry import Format
from porous.formats.gate import (
    HEADER,
    RATIO,
    inflate_first,
    integer,
    need,
    numbers,
    refuse,
)
from porous.values import VoxelGrid
from porous.values.image import Image
from porous.values.units import length_ratio

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from porous.formats._registry import File
    from porous.formats.gate import Source

    Shape = tuple[int, int, int]

TYPES = {
    f"MET_{sign}{name}": f"{kind}{size}"
    for sign, kind in (("", "i"), ("U", "u"))
    for name, size in (("CHAR", 1), ("SHORT", 2), ("INT", 4), ("LONG", 4), ("LONG_LONG", 8))
} | {"MET_FLOAT": "f4", "MET_DOUBLE": "f8"}
"""MetaIO's names of types; a LONG has four bytes in its files, on every machine."""
NAMES = {
    **dict.fromkeys(("position", "origin"), "offset"),
    **dict.fromkeys(("rotation", "orientation"), "transformmatrix"),
    "binarydatabyteordermsb": "elementbyteordermsb",
}
"""Fields that have two names, in small letters."""
TRUTHS = {"true": True, "t": True, "1": True, "false": False, "f": False, "0": False}
LOCAL = "LOCAL"
LINE = re.compile(rb"\s*([A-Za-z0-9_\[\]]+)[ \t]*[=:][ \t]*([^\n]*)\n")
AXES = 3


def read(source: Source) -> VoxelGrid:
    """Read a grid of voxels: what porous wrote, or a segmented image of two values."""
    image, mark = _read(source)
    return images.grid_of(image, mark, source)


def read_image(source: Source) -> Image:
    """Read the grey values as they are."""
    return _read(source)[0]


def members(source: Source) -> tuple[str, ...]:
    """Return the name of the file that the voxels are in, where that is another one."""
    name = _fields(source.data)[0]["elementdatafile"]
    return () if name.upper() == LOCAL or source.is_bad_name(name) else (name,)


def write_files(grid: VoxelGrid, name: str) -> Iterator[File]:
    """Write a grid of voxels: a header with its voxels beside it, or one file."""
    stem = name[:-4]
    if name.lower().endswith(".mha"):
        fill = b"".join(images.packed(grid.fill, 15))
        bulk = () if grid.bulk is None else images.packed(grid.bulk, 15)
        size = f"CompressedDataSize = {len(fill)}\n"
        yield name, itertools.chain([_header(grid, LOCAL, size), fill], bulk)
        return
    several = "%" in stem or stem.split()[:1] == ["LIST"]  # so readers would take it
    if several or not stem.isascii() or not stem.isprintable():
        refuse("a name", name, "one of plain letters, for the header says it")
    yield f"{stem}.raw", images.layers(grid.fill)
    more = {}
    if grid.bulk is not None:
        more = {"beside": f"{stem}.bulk.raw"}
        yield more["beside"], images.layers(grid.bulk)
    yield name, [_header(grid, f"{stem}.raw", "", **more)]


def _header(grid: VoxelGrid, data: str, size: str, **more: str) -> bytes:
    frame = grid.frame
    ratio = length_ratio(frame.unit, "mm")
    return (
        "ObjectType = Image\n"
        "NDims = 3\n"
        "BinaryData = True\n"
        "BinaryDataByteOrderMSB = False\n"
        f"CompressedData = {bool(size)}\n"
        f"{size}"
        "TransformMatrix = 1 0 0 0 1 0 0 0 1\n"
        f"Offset = {_spell(images.first_centre(frame), ratio)}\n"
        "CenterOfRotation = 0 0 0\n"
        f"ElementSpacing = {_spell(frame.spacing, ratio)}\n"
        f"DimSize = {' '.join(map(str, frame.shape))}\n"
        f"Porous = {images.mark_of(grid, **more)}\n"
        "ElementType = MET_UCHAR\n"
        f"ElementDataFile = {data}\n"
    ).encode("ascii")


def _spell(values: Iterable[float], ratio: float) -> str:
    return " ".join(repr(value * ratio) for value in values)


# --- reading -----------------------------------------------------------------------------------


def _read(source: Source) -> tuple[Image, images.Mark | None]:
    fields, rest = _fields(source.data)
    _check_kind(fields)
    # The number of axes is looked at first: it says how many words the other fields have.
    sizes = [integer(word, "DimSize") for word in fields["dimsize"].split()[: AXES + 1]]
    shape = images.shape_of(sizes, "DimSize")
    spacing, flips = _spacing(fields, source)
    entries = images.entries_of(fields.get("porous"))
    bulked = entries is not None and entries.get("bulk") is not None
    values, bulk = _voxels(source, fields, rest, shape, bulked=bulked)
    beside = str(entries["beside"]) if entries is not None and "beside" in entries else ""
    if bulked and beside and not source.misses(beside):
        bulk = _beside(source, beside, shape)
    values, origin = images.forwards(values, _centre(fields, spacing), spacing, flips)
    image = Image(values, spacing, origin, images.unit_of(fields["distanceunits"], "DistanceUnits"))
    return image, images.Mark(entries, bulk) if entries is not None else None


def _fields(data: bytes) -> tuple[dict[str, str], memoryview]:
    """Return the header's fields by their names in small letters, and what follows it."""
    fields: dict[str, str] = {}
    start = 0
    while "elementdatafile" not in fields:
        match = LINE.match(data[start : start + HEADER] + b"\n")
        if match is None or start + match.end() > HEADER:
            got = data[start : start + 40].decode("latin-1")
            refuse("a line of the header", got, f"Name = value, {HEADER} bytes at most")
        name = match[1].decode().lower()
        name = NAMES.get(name, name)
        if name in fields:
            refuse("the header", match[1].decode(), "each field once")
        fields[name] = match[2].decode("utf-8", "replace").strip()
        start += match.end()
    defaults = {"objecttype": "Image", "distanceunits": "mm", "headersize": "0"}
    return {**defaults, **fields}, memoryview(data)[start:]


def _check_kind(fields: dict[str, str]) -> None:
    wanted = [name for name in ("ndims", "dimsize", "elementtype") if name not in fields]
    if wanted:
        refuse("fields of the header", ", ".join(fields), f"{', '.join(wanted)} as well")
    if fields["objecttype"].lower() != "image":
        refuse("ObjectType", fields["objecttype"], "Image")
    if integer(fields["ndims"], "NDims") != AXES:
        refuse("NDims", fields["ndims"], "3")
    if integer(fields.get("elementnumberofchannels", "1"), "ElementNumberOfChannels") != 1:
        refuse("ElementNumberOfChannels", fields["elementnumberofchannels"], "1")
    if not _truth(fields, "binarydata", default=True):
        refuse("BinaryData", fields["binarydata"], "True: voxels in text are not read")
    if fields["elementtype"] not in TYPES:
        refuse("ElementType", fields["elementtype"], f"one of {', '.join(TYPES)}")


def _truth(fields: dict[str, str], name: str, *, default: bool) -> bool:
    got = fields.get(name)
    if got is None:
        return default
    if got.lower() not in TRUTHS:
        refuse(name, got, "True or False")
    return TRUTHS[got.lower()]


def _voxels(
    source: Source, fields: dict[str, str], rest: memoryview, shape: Shape, *, bulked: bool
) -> tuple[NDArray[Any], NDArray[np.uint8] | None]:
    form = np.dtype(TYPES[fields["elementtype"]])
    form = form.newbyteorder(">" if _truth(fields, "elementbyteordermsb", default=False) else "<")
    data = _data(source, fields["elementdatafile"], rest)
    packed = _truth(fields, "compresseddata", default=False)
    head = integer(fields["headersize"], "HeaderSize")
    if head < -1 or (head == -1 and packed):
        refuse("HeaderSize", head, "zero or more, or -1 for raw voxels at the end")
    size = images.check_size(shape, form.itemsize, len(data) * (RATIO if packed else 1))
    start = len(data) - size if head == -1 else head
    need(start, len(data), "HeaderSize")
    data = data[start:]
    bulk = None
    if packed:
        said = integer(fields.get("compresseddatasize", str(len(data))), "CompressedDataSize")
        need(said, len(data), "CompressedDataSize")
        flat, used = inflate_first(data, size, "the voxels")
        if used != said:
            refuse("CompressedDataSize", said, f"{used}, which the voxels take")
        if bulked and used < len(data):
            bulk = _in_order(inflate_first(data[used:], size, "the bulk")[0], np.dtype("u1"), shape)
        return _in_order(flat, form, shape), bulk
    need(size, len(data), "the voxels")
    if len(data) > size:
        source.note(f"{len(data) - size} bytes after the voxels; passed over")
    return _in_order(data[:size], form, shape), None


def _data(source: Source, name: str, rest: memoryview) -> memoryview:
    if name.upper() == LOCAL:
        return rest
    if name.split()[:1] == ["LIST"] or "%" in name:
        refuse("ElementDataFile", name, "one file; several are not read")
    return memoryview(source.beside(name, "ElementDataFile"))


def _in_order(flat: bytes | memoryview, form: np.dtype[Any], shape: Shape) -> NDArray[Any]:
    if len(flat) != int(np.prod(shape)) * form.itemsize:
        raise FormatError(f"got {len(flat)} bytes of voxels; wanted {shape} of {form}")
    return np.frombuffer(flat, form).reshape(shape[::-1]).transpose(2, 1, 0)


def _beside(source: Source, name: str, shape: Shape) -> NDArray[np.uint8]:
    return _in_order(source.beside(name, "the bulk"), np.dtype("u1"), shape)


def _spacing(fields: dict[str, str], source: Source) -> tuple[images.Vector, tuple[bool, ...]]:
    """Return spacing and which axes run backwards; 1, with a note, where the file says nothing."""
    text = fields.get("elementspacing", fields.get("elementsize"))
    if text is None:
        unit = images.unit_of(fields["distanceunits"], "DistanceUnits")
        source.note(f"it says no voxel size; taken as 1 {unit} along x, y and z")
        text = "1 1 1"
    x, y, z = _floats(text, AXES, "ElementSpacing")
    if not min(x, y, z) > 0:
        refuse("ElementSpacing", text, "three positive lengths")
    matrix = _floats(fields.get("transformmatrix", "1 0 0 0 1 0 0 0 1"), 9, "TransformMatrix")
    lengths, flips = images.axes_of(np.array(matrix).reshape(3, 3), "TransformMatrix")
    if any(abs(length - 1) > images.CLOSE for length in lengths):
        refuse("TransformMatrix", fields["transformmatrix"], "directions of length 1")
    return (x, y, z), flips


def _centre(fields: dict[str, str], spacing: images.Vector) -> images.Vector:
    """Return the centre of the first voxel; where the file says nothing, its corner is at zero."""
    if "offset" not in fields:
        x, y, z = (h / 2 for h in spacing)
    else:
        x, y, z = _floats(fields["offset"], AXES, "Offset")
    return x, y, z


def _floats(text: str, count: int, what: str) -> list[float]:
    values = numbers(text.encode("utf-8", "replace"), what, most=count)
    if len(values) != count:
        refuse(what, text, f"{count} numbers")
    return [float(v) for v in values]


FORMAT = Format(
    "MetaImage",
    (".mhd", ".mha"),
    VoxelGrid,
    read,
    (VoxelGrid,),
    write_files=write_files,
    read_image=read_image,
    members=members,
)
