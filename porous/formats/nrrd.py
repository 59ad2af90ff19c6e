"""NRRD: nearly raw raster data, as ITK, 3D Slicer and teem take it.

Voxels are uint8 with x fastest, compressed by gzip; ``space directions`` are the spacing and
``space origin`` is the centre of the first voxel, as in ITK. The key ``porous`` holds the mark
(``_image``), and the bulk follows the fill as a second gzip stream that others pass over. A
``.nhdr`` has its voxels in a file beside it.
https://teem.sourceforge.net/nrrd/format.html
"""

from __future__ import annotations

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
    whole,
)
from porous.values import VoxelGrid
from porous.values.image import Image

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.formats._registry import File
    from porous.formats.gate import Source

GZIP = 31
TYPES = {
    **dict.fromkeys(("signed char", "int8", "int8_t"), "i1"),
    **dict.fromkeys(("uchar", "unsigned char", "uint8", "uint8_t"), "u1"),
    **dict.fromkeys(("short", "short int", "signed short", "signed short int"), "i2"),
    **dict.fromkeys(("int16", "int16_t"), "i2"),
    **dict.fromkeys(("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"), "u2"),
    **dict.fromkeys(("int", "signed int", "int32", "int32_t"), "i4"),
    **dict.fromkeys(("uint", "unsigned int", "uint32", "uint32_t"), "u4"),
    **dict.fromkeys(("longlong", "long long", "long long int", "signed long long"), "i8"),
    **dict.fromkeys(("signed long long int", "int64", "int64_t"), "i8"),
    **dict.fromkeys(("ulonglong", "unsigned long long", "unsigned long long int"), "u8"),
    **dict.fromkeys(("uint64", "uint64_t"), "u8"),
    "float": "f4",
    "double": "f8",
}
ENCODINGS = {"raw": "raw", "gzip": "gzip", "gz": "gzip", "txt": "text", "text": "text"}
ENCODINGS["ascii"] = "text"
ORDERS = {"little": "<", "big": ">"}
DETACHED = ("data file", "datafile")
MAGIC = re.compile(rb"NRRD000[1-5]|NRRD00\.01")
VECTOR = re.compile(r"\(([^()]*)\)|none", re.IGNORECASE)
SPACES = 3
"""Of how many dimensions the space is that directions live in."""


def read(source: Source) -> VoxelGrid:
    """Read a grid of voxels: what porous wrote, or a segmented image of two values."""
    image, mark = _read(source)
    return images.grid_of(image, mark, source)


def read_image(source: Source) -> Image:
    """Read the grey values as they are."""
    return _read(source)[0]


def members(source: Source) -> tuple[str, ...]:
    """Return the name of the file that the voxels are in, where that is another one."""
    fields = _head(source.data)[0]
    names = [fields[name] for name in DETACHED if name in fields]
    return tuple(name for name in names if not source.is_bad_name(name))


def write_files(grid: VoxelGrid, name: str) -> Iterator[File]:
    """Write a grid of voxels, into one file or with a header of its own."""
    body = [grid.fill] if grid.bulk is None else [grid.fill, grid.bulk]
    voxels = (piece for values in body for piece in images.packed(values, GZIP))
    if name.lower().endswith(".nhdr"):
        data = f"{name[:-5]}.raw.gz"
        if not data.isascii() or not data.isprintable():
            refuse("a name", name, "one of plain letters, for the header says it")
        yield data, voxels
        yield name, [_header(grid, f"data file: {data}\n")]
    else:
        yield name, _joined(_header(grid, ""), voxels)


def _joined(head: bytes, voxels: Iterator[bytes]) -> Iterator[bytes]:
    yield head
    yield from voxels


def _header(grid: VoxelGrid, data: str) -> bytes:
    frame = grid.frame
    rows = [tuple(h if i == j else 0.0 for j in range(3)) for i, h in enumerate(frame.spacing)]
    return (
        "NRRD0005\n"
        "# Written by porous; the space origin is the centre of the first voxel.\n"
        "type: uint8\n"
        "dimension: 3\n"
        "space dimension: 3\n"
        f"sizes: {' '.join(map(str, frame.shape))}\n"
        f"space directions: {' '.join(map(_spell, rows))}\n"
        "kinds: domain domain domain\n"
        "encoding: gzip\n"
        f"space units: {' '.join([_quoted(frame.unit)] * 3)}\n"
        f"space origin: {_spell(images.first_centre(frame))}\n"
        f"{data}"
        f"porous:={images.mark_of(grid)}\n\n"
    ).encode("ascii")


def _spell(values: tuple[float, ...]) -> str:
    return f"({','.join(map(repr, values))})"


def _quoted(unit: str) -> str:
    return f'"{unit}"'


# --- reading -----------------------------------------------------------------------------------


def _read(source: Source) -> tuple[Image, images.Mark | None]:
    fields, keys, data = _split(source)
    dimension = integer(_field(fields, "dimension"), "dimension")
    sizes = _integers(fields, "sizes")
    if dimension != SPACES or len(sizes) != SPACES:
        refuse("dimension and sizes", f"{dimension} and {fields.get('sizes')}", "three axes")
    shape = images.shape_of(sizes, "sizes")
    spacing, flips = _spacing(fields, source)
    entries = images.entries_of(keys.get("porous"))
    bulked = entries is not None and entries.get("bulk") is not None
    values, bulk = _voxels(fields, data, shape, bulked=bulked)
    centre = _origin(fields, spacing)
    values, origin = images.forwards(values, centre, spacing, flips)
    image = Image(values, spacing, origin, _unit(fields))
    return image, images.Mark(entries, bulk) if entries is not None else None


def _split(source: Source) -> tuple[dict[str, str], dict[str, str], memoryview]:
    """Return the header's fields and keys, and the bytes of the voxels, wherever they are."""
    fields, keys, stop = _head(source.data)
    for name in DETACHED:
        if name in fields:
            return fields, keys, memoryview(source.beside(fields[name], name))
    return fields, keys, memoryview(source.data)[stop:]


def _head(data: bytes) -> tuple[dict[str, str], dict[str, str], int]:
    """Return the header's fields and keys, and where it ends."""
    if not MAGIC.match(data):
        refuse("its beginning", data[:8], "NRRD0001 … NRRD0005")
    stop, lines = 0, []
    while stop < len(data):
        end = data.find(b"\n", stop, HEADER)
        if end < 0 and len(data) > HEADER:
            raise FormatError(f"no end of the header within {HEADER} bytes")
        end = len(data) if end < 0 else end
        line, stop = data[stop:end].rstrip(b"\r").decode("utf-8", "replace"), end + 1
        if not line.strip():
            break
        lines.append(line)
    return *_fields(lines[1:]), stop


def _fields(lines: list[str]) -> tuple[dict[str, str], dict[str, str]]:
    fields: dict[str, str] = {}
    keys: dict[str, str] = {}
    for line in lines:
        if line.startswith("#"):
            continue
        match = re.match(r"([^:]*):(=|\s)?(.*)", line, re.DOTALL)
        if match is None:
            refuse("a line of the header", line, "field: value or key:=value")
        table = keys if match[2] == "=" else fields
        name = match[1] if match[2] == "=" else match[1].strip().lower()
        if name in table:
            refuse("the header", name, "each field once")
        table[name] = match[3].strip()
    return fields, keys


def _field(fields: dict[str, str], name: str) -> str:
    if name not in fields:
        refuse("fields of the header", ", ".join(fields), f"{name} as well")
    return fields[name]


def _integers(fields: dict[str, str], name: str) -> list[int]:
    words = _field(fields, name).split()
    if len(words) > 2 * SPACES:
        refuse(name, fields[name], "three numbers")
    return [integer(word, name) for word in words]


def _one_of(fields: dict[str, str], name: str, table: dict[str, str], default: str | None) -> str:
    got = fields.get(name, default)
    got = (_field(fields, name) if got is None else got).lower()
    if got not in table:
        refuse(name, got, f"one of {', '.join(table)}")
    return table[got]


def _voxels(
    fields: dict[str, str], data: memoryview, shape: tuple[int, int, int], *, bulked: bool
) -> tuple[NDArray[Any], NDArray[np.uint8] | None]:
    form = np.dtype(_one_of(fields, "type", TYPES, None))
    if form.itemsize > 1:
        form = form.newbyteorder(_one_of(fields, "endian", ORDERS, "little"))  # type: ignore[arg-type]
    encoding = _one_of(fields, "encoding", ENCODINGS, None)
    data = _after_lines(data, integer(fields.get("line skip", fields.get("lineskip", "0")), "skip"))
    skip = integer(fields.get("byte skip", fields.get("byteskip", "0")), "byte skip")
    if skip < -1 or (skip == -1 and encoding != "raw"):
        refuse("byte skip", skip, "zero or more, or -1 for raw voxels at the end")
    most = len(data) * {"raw": 1, "gzip": RATIO, "text": form.itemsize}[encoding]
    size = images.check_size(shape, form.itemsize, most)
    if encoding == "text":
        return _in_order(_spelt(bytes(data[skip:]), size // form.itemsize, form), shape), None
    if encoding == "raw":
        start = len(data) - size if skip == -1 else skip
        need(start + size, len(data), "the voxels")
        return _in_order(np.frombuffer(data[start : start + size], form), shape), None
    flat, used = inflate_first(data, skip + size, "the voxels")
    values = _in_order(np.frombuffer(flat, form, offset=skip), shape)
    if not bulked or size != values.size or used == len(data):
        return values, None
    more = inflate_first(data[used:], size, "the bulk")[0]
    return values, _in_order(np.frombuffer(more, np.uint8), shape)


def _after_lines(data: memoryview, count: int) -> memoryview:
    if not count:
        return data
    need(count, HEADER, "line skip", unit="lines")
    head, start = bytes(data[:HEADER]), 0
    for _ in range(max(count, 0)):
        start = head.find(b"\n", start) + 1
        if not start:
            refuse("line skip", count, f"lines that end within {HEADER} bytes")
    return data[start:]


def _spelt(text: bytes, count: int, form: np.dtype[Any]) -> NDArray[Any]:
    given = numbers(text.replace(b",", b" "), "the voxels", most=count)
    need(count, len(given), "the voxels", unit="numbers")
    if form.kind == "f":
        return given.astype(form)
    exact, limits = whole(given, "the voxels"), np.iinfo(form)
    if not limits.min <= exact.min() <= exact.max() <= limits.max:
        refuse("the voxels", f"{exact.min()} to {exact.max()}", f"{limits.min} to {limits.max}")
    return exact.astype(form)


def _in_order(flat: NDArray[Any], shape: tuple[int, int, int]) -> NDArray[Any]:
    return flat.reshape(shape[::-1]).transpose(2, 1, 0)


def _spacing(fields: dict[str, str], source: Source) -> tuple[images.Vector, tuple[bool, ...]]:
    """Return spacing and which axes run backwards; 1, with a note, where the file says nothing."""
    if "space directions" in fields:
        return images.axes_of(_vectors(fields, "space directions", SPACES), "space directions")
    if "spacings" not in fields:
        source.note(f"it says no voxel size; taken as 1 {_unit(fields)} along x, y and z")
        return (1.0, 1.0, 1.0), (False, False, False)
    x, y, z = _floats(fields["spacings"], "spacings")
    return (x, y, z), (False, False, False)


def _origin(fields: dict[str, str], spacing: images.Vector) -> images.Vector:
    """Return the centre of the first voxel; where the file says nothing, its corner is at zero."""
    if "space origin" not in fields:
        x, y, z = (h / 2 for h in spacing)
        return x, y, z
    x, y, z = _vectors(fields, "space origin", 1)[0].tolist()
    return x, y, z


def _vectors(fields: dict[str, str], name: str, count: int) -> NDArray[np.float64]:
    found = [match[1] for match in VECTOR.finditer(fields[name])]
    if len(found) != count or None in found:
        refuse(name, fields[name], f"{count} of three numbers, as in (1,0,0)")
    return np.array([_floats(text.replace(",", " "), name) for text in found])


def _floats(text: str, what: str) -> list[float]:
    values = numbers(text.encode("utf-8", "replace"), what, most=SPACES)
    if len(values) != SPACES:
        refuse(what, text, "three numbers")
    return [float(v) for v in values]


def _unit(fields: dict[str, str]) -> str:
    """Return the unit of length, mm where the file says none."""
    text = fields.get("space units", fields.get("units", ""))
    units = {images.unit_of(word, "units") for word in re.findall(r'"([^"]*)"', text) if word}
    if len(units) > 1:
        refuse("units", text, "one unit for all axes")
    return units.pop() if units else "mm"


FORMAT = Format(
    "NRRD",
    (".nrrd", ".nhdr"),
    VoxelGrid,
    read,
    (VoxelGrid,),
    write_files=write_files,
    read_image=read_image,
    members=members,
)
