"""VTI: voxels on a lattice, as VTK and ParaView take them.

The fill is the cell array ``fill`` (UInt8, x fastest), the body that porosity refers to ``bulk``;
sampling, Hausdorff bound, periodic axes and unit are field data, so what is written reads back
equal, and the same grid gives the same bytes. In files of others the one UInt8 cell array is taken;
one that holds nothing but 0 and 1 is a mask, and 1 is solid.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import SubElement

import numpy as np

from porous.errors import FormatError
from porous.formats._registry import Format
from porous.formats._vtk import Document, Writer, child, named, unit_of, vector, word
from porous.formats.gate import RATIO, need, refuse, whole
from porous.memory import check_memory
from porous.values import Frame, VoxelGrid, VoxelMaps
from porous.values.image import Image

if TYPE_CHECKING:
    from collections.abc import Iterator
    from xml.etree.ElementTree import Element

    from numpy.typing import NDArray

    from porous.formats.gate import Source

KIND = "ImageData"
MOST = 2**31 - 1
IDENTITY = [1, 0, 0, 0, 1, 0, 0, 0, 1]
OURS = "fill"
WIDEST = 8
"""Bytes of the widest number."""


def read(source: Source) -> VoxelGrid:
    """Read a grid of voxels from one piece of image data with a UInt8 cell array."""
    document = Document(source.data, KIND)
    image = child(document.root, KIND)
    fields = named(image.find("FieldData"))
    frame = _frame(document, image, fields)
    shape = " × ".join(map(str, frame.shape))
    need(frame.size, RATIO * len(source.data), f"a grid of {shape} voxels")
    check_memory(4 * frame.size, f"a grid of {shape} voxels", "Cut it into parts.")
    arrays = named(child(image, "Piece").find("CellData"))
    name = _chosen(arrays)
    fill = _voxels(document, arrays[name], frame)
    if name != OURS and fill.max() <= 1:
        fill = fill * np.uint8(255)
    bulk = _voxels(document, arrays["bulk"], frame) if {OURS, "bulk"} <= set(arrays) else None
    bound, error = (_length(document, fields, name) for name in ("hausdorff", "sampling_error"))
    sampling = _sampling(document, fields, fill)
    return VoxelGrid(frame, fill, bulk, sampling, bound, error or 0.0)


def read_image(source: Source) -> Image:
    """Read the grey values as they are, of the one array of cells, else of points.

    Points are the centres of voxels then, as scanners' images have them.
    """
    document = Document(source.data, KIND)
    image = child(document.root, KIND)
    frame = _frame(document, image, named(image.find("FieldData")))
    piece = child(image, "Piece")
    cells, points = (_grey(named(piece.find(name))) for name in ("CellData", "PointData"))
    origin, shape = frame.box.lower, frame.shape
    if not cells and points:
        x, y, z = (o - h / 2 for o, h in zip(origin, frame.spacing, strict=True))
        origin, shape = (x, y, z), (shape[0] + 1, shape[1] + 1, shape[2] + 1)
    found = cells or points
    if len(found) != 1:
        got = ", ".join(found) or "none"
        refuse("arrays of grey values", got, f"one, of cells or of points, or {OURS!r} of cells")
    ((name, element),) = found.items()
    count = math.prod(shape)
    what = f"an image of {' × '.join(map(str, shape))} voxels"
    need(count, RATIO * len(source.data), what)
    check_memory(3 * count * WIDEST, what, "Cut it into parts.")
    values = document.array(element, count, name).reshape(shape[::-1]).transpose(2, 1, 0)
    return Image(values, frame.spacing, origin, frame.unit)


def _grey(arrays: dict[str, Element]) -> dict[str, Element]:
    """Return the arrays that can be an image: ours alone where it is there."""
    one = {n: e for n, e in arrays.items() if e.get("NumberOfComponents", "1") == "1"}
    return {OURS: one[OURS]} if OURS in one else {n: e for n, e in one.items() if e.get("type")}


def write(value: VoxelGrid | VoxelMaps) -> Iterator[bytes]:
    """Write a grid of voxels, or what is known of each of its voxels, as cell data, compressed."""
    writer = Writer(KIND)
    image = _image(writer, value.frame)
    fields = SubElement(image, "FieldData")
    writer.unit(fields, value.frame.unit)
    if isinstance(value, VoxelMaps):
        arrays: dict[str, NDArray[Any]] = dict(value.maps)
    else:
        arrays = {OURS: value.fill} | ({} if value.bulk is None else {"bulk": value.bulk})
        _tell(writer, fields, value)
    piece = SubElement(image, "Piece", {"Extent": str(image.get("WholeExtent"))})
    cells = SubElement(piece, "CellData", Scalars=next(iter(arrays)))
    for name, values in arrays.items():
        writer.array(cells, name, values.transpose(2, 1, 0).reshape(-1))
    return writer.chunks()


def _tell(writer: Writer, fields: Element, grid: VoxelGrid) -> None:
    """Say how a grid was made."""
    writer.strings(fields, "sampling", [grid.sampling])
    writer.field(fields, "periodic", np.array(grid.frame.periodic, dtype=np.uint8))
    if grid.hausdorff is not None:
        writer.field(fields, "hausdorff", np.array([grid.hausdorff], dtype=np.float64))
    if grid.sampling_error:
        writer.field(fields, "sampling_error", np.array([grid.sampling_error], dtype=np.float64))


def _image(writer: Writer, frame: Frame) -> Element:
    ends = [str(v) for a, n in zip(frame.start, frame.shape, strict=True) for v in (a, a + n)]
    image = SubElement(writer.root, KIND, {"WholeExtent": " ".join(ends)})
    image.set("Origin", _spell(frame.origin))
    image.set("Spacing", _spell(frame.spacing))
    return image


def _spell(values: tuple[float, ...]) -> str:
    return " ".join(map(repr, values))


def _frame(document: Document, image: Element, fields: dict[str, Element]) -> Frame:
    if vector(image, "Direction", 9, " ".join(map(str, IDENTITY))) != IDENTITY:
        refuse("Direction", image.get("Direction"), "axes that are not turned")
    extent = whole(np.array(vector(image, "WholeExtent", 6)), "WholeExtent")
    if (extent[::2] >= extent[1::2]).any() or np.abs(extent).max() > MOST:
        refuse("WholeExtent", image.get("WholeExtent"), "x0 x1 y0 y1 z0 z1 with x0 < x1, …")
    if vector(child(image, "Piece"), "Extent", 6) != extent.tolist():
        raise FormatError("the piece does not fill WholeExtent; wanted one piece of all voxels")
    return Frame(
        vector(image, "Origin", 3, "0 0 0"),  # type: ignore[arg-type]
        vector(image, "Spacing", 3, "1 1 1"),  # type: ignore[arg-type]
        (extent[1::2] - extent[::2]).tolist(),
        _periodic(document, fields),
        unit_of(document, fields),
        extent[::2].tolist(),
    )


def _periodic(document: Document, fields: dict[str, Element]) -> tuple[bool, bool, bool]:
    if "periodic" not in fields:
        return False, False, False
    x, y, z = document.array(fields["periodic"], 3, "periodic").tolist()
    return bool(x), bool(y), bool(z)


def _length(document: Document, fields: dict[str, Element], name: str) -> float | None:
    if name not in fields:
        return None
    return float(document.array(fields[name], 1, name)[0])


def _sampling(document: Document, fields: dict[str, Element], fill: NDArray[np.uint8]) -> str:
    binary = not ((fill > 0) & (fill < 255)).any()
    return word(document, fields, "sampling", "centre" if binary else "fill")


def _chosen(arrays: dict[str, Element]) -> str:
    good = [name for name, element in arrays.items() if element.get("type") == "UInt8"]
    if OURS in good:
        return OURS
    if len(good) != 1:
        got = ", ".join(f"{name} ({e.get('type')})" for name, e in arrays.items()) or "none"
        refuse("cell arrays", got, f"one of type UInt8, or one of them named {OURS!r}")
    return good[0]


def _voxels(document: Document, element: Element, frame: Frame) -> NDArray[np.uint8]:
    if element.get("NumberOfComponents", "1") != "1":
        refuse("NumberOfComponents", element.get("NumberOfComponents"), "1")
    if element.get("type") != "UInt8":
        refuse(f"type of {element.get('Name')}", element.get("type"), "UInt8")
    values = document.array(element, frame.size, str(element.get("Name")))
    return values.reshape(frame.shape[::-1]).transpose(2, 1, 0)


FORMAT = Format(
    "VTK image data",
    (".vti",),
    VoxelGrid,
    read,
    (VoxelGrid, VoxelMaps),
    write,
    read_image=read_image,
)
