"""VTU: volume elements of several shapes with tags and parts, as VTK and ParaView take them.

Tags are Int64 cell arrays. Parts are field data: ``nodes:XMIN`` holds the numbers of points,
``cells:SOLID`` those of cells, ``faces:XMIN_FACES`` cells and local faces, ``pairs:XPAIRS`` points
and their partners. The blocks (their shapes and how many cells each has) are field data too, so
what is written reads back equal. In files of others the cells are sorted by shape, and
whole-numbered cell arrays become tags; points, lines and faces are passed over, and hexahedra of
24 and 27 nodes are read by their corners.

Fields are Float64 arrays of the points and cells, whose units VTK's readers find as UNITS_LABEL;
they are written, and passed over when such a file is read as a mesh.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.etree.ElementTree import SubElement

import numpy as np

from porous.errors import FormatError
from porous.formats._elements import note_bent
from porous.formats._registry import Format
from porous.formats._vtk import Document, Writer, child, named, unit_of
from porous.formats.gate import integer, refuse
from porous.values import SHAPES, Block, MeshFields, Part, VolumeMesh
from porous.values.volume_mesh import PART_KINDS, ROWS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from xml.etree.ElementTree import Element

    from numpy.typing import NDArray

    from porous.formats.gate import Source
    from porous.values import Field

KIND = "UnstructuredGrid"
SHAPE_OF = {shape.vtk: name for name, shape in SHAPES.items()}
VOXEL = 11
VOXEL_CORNERS = np.array([0, 1, 3, 2, 4, 5, 7, 6])
WEDGE_CORNERS = np.array([0, 2, 1, 3, 5, 4])
HEXAHEDRA = {VOXEL: 8, 29: 27, 33: 24}
"""Hexahedra that are read by their corners: how many nodes each has, the corners first."""
NODES = {kind: SHAPES[name].nodes for kind, name in SHAPE_OF.items()} | HEXAHEDRA
FLAT = (*range(10), 21, 22, 23, 28, 30, 34, 35, 36, 68, 69, 70, 75, 76, 77)
"""Points, lines and faces, straight and curved."""
OTHERS = {
    14: "pyramid",
    15: "pentagonal prism",
    16: "hexagonal prism",
    26: "wedge of 15 nodes",
    27: "pyramid of 13 nodes",
    32: "wedge of 18 nodes",
    42: "polyhedron",
    71: "Lagrange tetrahedron",
    72: "Lagrange hexahedron",
}
"""Names for the commonest of what is refused."""


def read(source: Source) -> VolumeMesh:
    """Read a volume mesh from one piece of an unstructured grid."""
    document = Document(source.data, KIND)
    grid = child(document.root, KIND)
    piece, fields = child(grid, "Piece"), named(grid.find("FieldData"))
    count = integer(piece.get("NumberOfCells"), "NumberOfCells")
    types, starts, nodes = _cells(document, named(child(piece, "Cells")), count)
    runs = _runs(document, fields, types)
    order = np.concatenate([np.arange(0), *(cells for _, cells in runs)])
    note_bent(source, int(np.isin(types, [k for k in HEXAHEDRA if k != VOXEL]).sum()))
    return VolumeMesh(
        _points(document, piece),
        tuple(_block(shape, nodes, starts[cells], types[cells]) for shape, cells in runs),
        _tags(document, named(piece.find("CellData")), count, order),
        _parts(document, fields),
        unit_of(document, fields),
    )


def write(value: VolumeMesh | MeshFields) -> Iterator[bytes]:
    """Write a volume mesh and the fields on it, compressed."""
    mesh = value.mesh if isinstance(value, MeshFields) else value
    fields = value.fields if isinstance(value, MeshFields) else ()
    writer = Writer(KIND)
    grid = SubElement(writer.root, KIND)
    _write_fields(writer, SubElement(grid, "FieldData"), mesh)
    counts = {"NumberOfPoints": str(len(mesh.points)), "NumberOfCells": str(mesh.cells)}
    piece = SubElement(grid, "Piece", counts)
    if at_nodes := [field for field in fields if field.at == "nodes"]:
        _write_data(writer, SubElement(piece, "PointData"), at_nodes)
    tags = SubElement(piece, "CellData")
    for name, tag in mesh.cell_tags.items():
        writer.array(tags, name, tag)
    _write_data(writer, tags, [field for field in fields if field.at == "cells"])
    writer.array(SubElement(piece, "Points"), "Points", mesh.points)
    shapes = [SHAPES[block.shape] for block in mesh.blocks]
    lengths = [len(block.cells) for block in mesh.blocks]
    nodes = [_in_order(block.cells, block.shape).reshape(-1) for block in mesh.blocks]
    widths = np.repeat(np.array([s.nodes for s in shapes], dtype=np.int64), lengths)
    cells = SubElement(piece, "Cells")
    writer.array(cells, "connectivity", np.concatenate([np.zeros(0, np.int64), *nodes]))
    writer.array(cells, "offsets", np.cumsum(widths))
    writer.array(cells, "types", np.repeat(np.array([s.vtk for s in shapes], np.uint8), lengths))
    return writer.chunks()


def _write_fields(writer: Writer, fields: Element, mesh: VolumeMesh) -> None:
    writer.unit(fields, mesh.unit)
    rows = [(SHAPES[block.shape].vtk, len(block.cells)) for block in mesh.blocks]
    writer.field(fields, "blocks", np.array(rows, dtype=np.int64).reshape(-1, 2))
    for name, part in mesh.parts.items():
        writer.field(fields, f"{part.kind}:{name}", part.members)


def _write_data(writer: Writer, parent: Element, fields: Sequence[Field]) -> None:
    for field in fields:
        if any(array.get("Name") == field.name for array in parent):
            refuse("a field", field.name, "a name that no tag of the mesh has")
        array = writer.array(parent, field.name, field.values)
        if field.unit:
            key = {"name": "UNITS_LABEL", "location": "vtkDataArray"}
            SubElement(array, "InformationKey", key).text = field.unit


def _points(document: Document, piece: Element) -> NDArray[np.float64]:
    count = integer(piece.get("NumberOfPoints"), "NumberOfPoints")
    arrays = list(named(child(piece, "Points")).values())
    if len(arrays) != 1 or arrays[0].get("NumberOfComponents") != "3":
        refuse("Points", f"{len(arrays)} arrays", "one array of three components")
    values = document.array(arrays[0], 3 * count, "Points")
    return values.reshape(-1, 3).astype(np.float64)


def _cells(
    document: Document, arrays: dict[str, Element], count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return each cell's type and where its nodes begin in the list of all nodes, the third."""
    if missing := [n for n in ("connectivity", "offsets", "types") if n not in arrays]:
        refuse("Cells", ", ".join(arrays), ", ".join(missing))
    types = _integers(document, arrays["types"], count, "types")
    ends = _integers(document, arrays["offsets"], count, "offsets")
    _check_types(types)
    widths = np.diff(ends, prepend=0)
    wanted = np.full(256, -1)
    wanted[list(NODES)] = list(NODES.values())
    right = np.where(wanted[types] < 0, widths >= 0, widths == wanted[types])
    if count and (ends.min() < 0 or not right.all()):
        raise FormatError("offsets do not rise by the number of nodes that each cell's type has")
    total = int(ends[-1]) if count else 0
    return types, ends - widths, _integers(document, arrays["connectivity"], total, "connectivity")


def _check_types(types: NDArray[np.int64]) -> None:
    kinds = set(np.unique(types).tolist())
    unknown = sorted(kinds - set(NODES) - set(FLAT))
    if unknown or (kinds and kinds <= set(FLAT)):
        named_kinds = (
            f"{kind} {OTHERS.get(kind, '')}".rstrip() for kind in unknown or sorted(kinds)
        )
        refuse(
            "cell types",
            ", ".join(named_kinds),
            "hexahedra (12, 25), wedges (13) or tetrahedra (10, 24)",
        )


def _runs(
    document: Document, fields: dict[str, Element], types: NDArray[np.int64]
) -> list[tuple[str, NDArray[np.int64]]]:
    """Return for each block its shape and the numbers of its cells in the file."""
    if "blocks" not in fields:
        merged = np.where(np.isin(types, list(HEXAHEDRA)), SHAPES["hex8"].vtk, types)
        kinds = [kind for kind in np.unique(merged).tolist() if kind in SHAPE_OF]
        return [(SHAPE_OF[kind], np.flatnonzero(merged == kind)) for kind in kinds]
    element = fields["blocks"]
    count = integer(element.get("NumberOfTuples"), "NumberOfTuples of blocks")
    rows = _integers(document, element, 2 * count, "blocks").reshape(-1, 2)
    kinds, lengths = rows[:, 0].tolist(), rows[:, 1].tolist()
    right = set(kinds) <= set(SHAPE_OF) and min(lengths, default=0) >= 0
    if not right or sum(lengths) != len(types) or (np.repeat(kinds, lengths) != types).any():
        refuse("blocks", rows.tolist(), f"types and counts of the {len(types)} cells")
    ends = np.cumsum([0, *lengths]).tolist()
    spans = zip(kinds, ends, ends[1:], strict=False)
    return [(SHAPE_OF[kind], np.arange(a, b)) for kind, a, b in spans]


def _block(
    shape: str, nodes: NDArray[np.int64], starts: NDArray[np.int64], types: NDArray[np.int64]
) -> Block:
    cells = nodes[starts[:, None] + np.arange(SHAPES[shape].nodes)]
    if (voxels := types == VOXEL).any():
        cells[voxels] = cells[voxels][:, VOXEL_CORNERS]
    return Block(shape, _in_order(cells, shape))


def _in_order(cells: NDArray[np.int64], shape: str) -> NDArray[np.int64]:
    """Return nodes in VTK's order, or back: a wedge's triangles are the other way round."""
    return cells[:, WEDGE_CORNERS] if shape == "wed6" else cells


def _tags(
    document: Document, arrays: dict[str, Element], count: int, order: NDArray[np.int64]
) -> dict[str, NDArray[np.int64]]:
    tags = {}
    for name, element in arrays.items():
        whole = (element.get("type") or "").removeprefix("U").startswith("Int")
        if whole and element.get("NumberOfComponents", "1") == "1":
            tags[name] = _integers(document, element, count, name)[order]
    return tags


def _integers(document: Document, element: Element, count: int, what: str) -> NDArray[np.int64]:
    values = document.array(element, count, what)
    if values.dtype.kind == "f":
        refuse(what, element.get("type"), "whole numbers")
    if values.dtype == np.uint64 and values.size and values.max() > np.iinfo(np.int64).max:
        refuse(what, int(values.max()), "at most 2^63 - 1")
    return values.astype(np.int64)


def _parts(document: Document, fields: dict[str, Element]) -> dict[str, Part]:
    parts = {}
    for field, element in fields.items():
        kind, colon, name = field.partition(":")
        if colon and kind in PART_KINDS and element.get("type") == "Int64":
            count = integer(element.get("NumberOfTuples"), f"NumberOfTuples of {field}")
            width = 2 if kind in ROWS else 1
            members = document.array(element, count * width, field)
            parts[name] = Part(kind, members.reshape(-1, 2) if width == 2 else members)
    return parts


FORMAT = Format(
    "VTK unstructured grid", (".vtu",), VolumeMesh, read, (VolumeMesh, MeshFields), write
)
