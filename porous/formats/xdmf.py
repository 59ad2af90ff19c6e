"""XDMF with HDF5 beside it, for FEniCSx and ParaView.

Two files: ``name.xdmf`` says what lies where in ``name.h5``. The grid ``mesh`` holds the cells, the
grid ``facets`` the faces of all parts of faces, each once and seen from outside. In both the first
attribute, ``leading``, numbers the part that comes first of those that a cell or a face is in
(``SOLID`` and ``PORE`` before all others, ``SKIN`` after them; 0 for none), for that is what
``read_meshtags`` of FEniCSx takes; pieces of information say the numbers' names. Then come tags,
and a 1 or 0 for each part, nodes' parts at the nodes. Several shapes become one mixed grid, which
FEniCSx does not read, nor does its version 0.5 read wedges. Parts of pairs are tables of the HDF5
file, and pieces of information say which. Names keep ASCII; the unit is a piece of information.
Nodes are in VTK's order, but wedges as Abaqus has them: so VTK finds their volume positive.
https://www.xdmf.org/index.php/XDMF_Model_and_Format
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from porous.formats._groups import (
    Groups,
    cells_in,
    face_elements,
    faces_in,
    names_in,
    nodes_in,
    refuse_empty,
)
from porous.formats._hdf import Branch, hdf5
from porous.formats._registry import Format
from porous.values import VolumeMesh

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    Indices = NDArray[np.int64]

TOPOLOGIES = {
    "tri3": ("Triangle", 4),
    "quad4": ("Quadrilateral", 5),
    "tet4": ("Tetrahedron", 6),
    "wed6": ("Wedge", 8),
    "hex8": ("Hexahedron", 9),
    "tri6": ("Triangle_6", 36),
    "quad8": ("Quadrilateral_8", 37),
    "tet10": ("Tetrahedron_10", 38),
    "hex20": ("Hexahedron_20", 48),
}
"""Names of shapes, and their numbers in mixed grids."""
TYPES = {"i8": ("Int", 8), "u1": ("UChar", 1), "f8": ("Float", 8), "i4": ("Int", 4)}
LEADING, UNIT = "leading", "unit"
ODD, LONGEST = r"[^ -~]", 255


@dataclass
class _Pair:
    """The two files that are being made: the tree of one, the arrays of the other."""

    file: str
    root: Element
    arrays: dict[str, NDArray[Any]]

    def item(self, parent: Element, path: str, array: NDArray[Any]) -> None:
        """Refer to an array, which is kept once."""
        self.arrays[path] = array
        kind, width = TYPES[array.dtype.str[1:]]
        marks = {
            "Dimensions": " ".join(map(str, array.shape)),
            "NumberType": kind,
            "Precision": str(width),
            "Format": "HDF",
        }
        SubElement(parent, "DataItem", marks).text = f"{self.file}:{path}"

    def attribute(self, grid: Element, name: str, centre: str, array: NDArray[Any]) -> None:
        marks = {"Name": name, "AttributeType": "Scalar", "Center": centre}
        number = sum(path.startswith(f"/{grid.get('Name')}/values") for path in self.arrays)
        path = f"/{grid.get('Name')}/values{number}"
        self.item(SubElement(grid, "Attribute", marks), path, array)


def write_files(mesh: VolumeMesh, name: str) -> Iterator[tuple[str, Iterable[bytes]]]:
    """Write a mesh: the HDF5 file, then the XDMF file that the user named."""
    refuse_empty(mesh)
    names = names_in((LEADING, UNIT, *mesh.cell_tags, *mesh.parts), ODD, LONGEST, "XDMF")
    file = f"{quote(Path(name).stem, safe='')}.h5"
    pair = _Pair(file, Element("Xdmf", Version="3.0"), {})
    domain = SubElement(pair.root, "Domain")
    grid = _cells(pair, domain, mesh, names)
    _facets(pair, domain, mesh, names)
    _inform(grid, UNIT, mesh.unit)
    pairs = {key: part for key, part in mesh.parts.items() if part.kind == "pairs"}
    for number, (key, part) in enumerate(pairs.items()):
        path = f"/pairs/{number}"
        pair.arrays[path] = part.members
        _inform(grid, names[key], f"{file}:{path}")
    yield file, hdf5(lambda root: _put_all(root, pair.arrays), packed=True)
    indent(pair.root)
    yield name, [tostring(pair.root, encoding="us-ascii", xml_declaration=True), b"\n"]


def _put_all(root: Branch, arrays: dict[str, NDArray[Any]]) -> None:
    for path, array in arrays.items():
        root.put(path, array)


def _cells(pair: _Pair, domain: Element, mesh: VolumeMesh, names: dict[str, str]) -> Element:
    grid = _grid(pair, domain, "mesh", [(b.shape, b.cells) for b in mesh.blocks], mesh.points)
    groups = cells_in(mesh)
    _lead(pair, grid, groups, names)
    for key, tag in mesh.cell_tags.items():
        pair.attribute(grid, names[key], "Cell", tag)
    _members(pair, grid, groups, names, "Cell")
    _members(pair, grid, nodes_in(mesh), names, "Node")
    return grid


def _facets(pair: _Pair, domain: Element, mesh: VolumeMesh, names: dict[str, str]) -> None:
    faces, groups = faces_in(mesh)
    if not len(faces):
        return
    found = face_elements(mesh, faces)
    grid = _grid(pair, domain, "facets", [(k, n) for k, (_, n) in found.items()], mesh.points)
    order = np.concatenate([rows for rows, _ in found.values()])
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    turned = Groups(groups.count, {key: place[rows] for key, rows in groups.sets.items()})
    _lead(pair, grid, turned, names)
    _members(pair, grid, turned, names, "Cell")


def _grid(
    pair: _Pair,
    domain: Element,
    name: str,
    pieces: list[tuple[str, Indices]],
    points: NDArray[np.float64],
) -> Element:
    grid = SubElement(domain, "Grid", Name=name, GridType="Uniform")
    pieces = [(shape, cells) for shape, cells in pieces if len(cells)]
    count = str(sum(len(cells) for _, cells in pieces))
    marks: dict[str, str] = {"NumberOfElements": count}
    if len({shape for shape, _ in pieces}) == 1:
        kind = TOPOLOGIES[pieces[0][0]][0]
        table = np.concatenate([cells for _, cells in pieces])
        marks["NodesPerElement"] = str(table.shape[1])
    else:
        kind = "Mixed"
        table = np.concatenate(
            [np.insert(cells, 0, TOPOLOGIES[shape][1], axis=1).ravel() for shape, cells in pieces]
        )
    topology = SubElement(grid, "Topology", {"TopologyType": kind, **marks})
    pair.item(topology, f"/{name}/topology", table)
    pair.item(SubElement(grid, "Geometry", GeometryType="XYZ"), "/points", points)
    return grid


def _lead(pair: _Pair, grid: Element, groups: Groups, names: dict[str, str]) -> None:
    """Add which part leads each element, and say the numbers' names."""
    label, shown = groups.leading()
    if groups.sets:
        pair.attribute(grid, names[LEADING], "Cell", (label + 1).astype(np.int32))
    for number, key in enumerate(shown, 1):
        _inform(grid, names[key], str(number))


def _members(
    pair: _Pair, grid: Element, groups: Groups, names: dict[str, str], centre: str
) -> None:
    for key, members in groups.sets.items():
        inside = np.zeros(groups.count, np.uint8)
        inside[members] = 1
        pair.attribute(grid, names[key], centre, inside)


def _inform(parent: Element, name: str, value: str) -> None:
    SubElement(parent, "Information", Name=name, Value=value)


FORMAT = Format(
    "XDMF with HDF5",
    (".xdmf",),
    writes=(VolumeMesh,),
    write_files=write_files,
    needs=("h5py",),
)
