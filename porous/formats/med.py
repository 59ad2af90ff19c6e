"""MED: meshes with groups for Salome and Code_Aster, version 4.0, which is HDF5.

Parts of cells, of faces and of nodes are groups; elements of one combination of groups are a
family. Faces are elements of their own, one dimension lower, seen from outside. MED's cells run
the other way round than VTK's: the first face's normal leaves the cell. The unit is that of the
axes. Parts of pairs and tags are not written. Names keep 80 characters of ASCII, of which
Code_Aster takes 24.
https://docs.salome-platform.org/latest/dev/MEDCoupling/developer/med-file.html
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from porous.formats._groups import (
    Groups,
    cells_in,
    face_elements,
    faces_in,
    names_in,
    node_order,
    nodes_in,
    refuse_empty,
)
from porous.formats._hdf import Branch, hdf5
from porous.formats._registry import Format
from porous.values import VolumeMesh
from porous.values.volume_mesh import HEXAHEDRON_EDGES, TETRAHEDRON_EDGES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Indices = NDArray[np.int64]

CORNERS = {"tet": (0, 2, 1, 3), "hex": (0, 3, 2, 1, 4, 7, 6, 5), "wed": (0, 2, 1, 3, 5, 4)}
"""Our numbers of MED's corners."""
EDGES = {"tet10": TETRAHEDRON_EDGES, "hex20": HEXAHEDRON_EDGES}
"""Edges in MED's order, between its own corners: the order is VTK's."""
TYPES = {
    "tri3": ("TR3", 203),
    "quad4": ("QU4", 204),
    "tri6": ("TR6", 206),
    "quad8": ("QU8", 208),
    "tet4": ("TE4", 304),
    "wed6": ("PE6", 306),
    "hex8": ("HE8", 308),
    "tet10": ("T10", 310),
    "hex20": ("H20", 320),
}
"""Names and numbers of element types."""
NAME = "mesh"
STEP = "-0000000000000000001-0000000000000000001"
"""The one step of a mesh that does not change."""
NO_PROFILE = "MED_NO_PROFILE_INTERNAL"
ODD, LONGEST = r"[^ -~]", 80


def write(mesh: VolumeMesh) -> Iterator[bytes]:
    """Write a mesh."""
    refuse_empty(mesh)
    names = names_in((n for n, p in mesh.parts.items() if p.kind != "pairs"), ODD, LONGEST, "MED")
    return hdf5(partial(_fill, mesh, names))


def _fill(mesh: VolumeMesh, names: dict[str, str], root: Branch) -> None:
    root.branch("INFOS_GENERALES", MAJ=4, MIN=0, REL=0)
    whole = root.branch(f"ENS_MAA/{NAME}", **_description(mesh.unit))
    step = whole.branch(STEP, CGT=1, NDT=-1, NOR=-1, NXI=-1, NXT=-1, PDT=0.0, PVI=-1, PVT=-1)
    families = root.branch(f"FAS/{NAME}")
    families.branch("FAMILLE_ZERO", NUM=0)
    nodes = _families(families.branch("NOEUD"), nodes_in(mesh), names, 1)
    place = step.branch("NOE", CGT=1, CGS=1, PFL=NO_PROFILE)
    place.put("COO", mesh.points.T.reshape(-1), CGT=1, NBR=len(mesh.points))
    place.put("FAM", nodes, CGT=1, NBR=len(mesh.points))
    _elements(step.branch("MAI", CGT=1), families.branch("ELEME"), mesh, names)


def _description(unit: str) -> dict[str, str | float]:
    return {
        "DES": "made by porous",
        "DIM": 3,
        "ESP": 3,
        "NOM": "".join(f"{axis:16}" for axis in "xyz"),
        "NXI": -1,
        "NXT": -1,
        "REP": 0,
        "SRT": 0,
        "TYP": 0,
        "UNI": f"{unit:16}" * 3,
        "UNT": "",
    }


def _elements(step: Branch, families: Branch, mesh: VolumeMesh, names: dict[str, str]) -> None:
    faces, groups = faces_in(mesh)
    cells = _families(families, cells_in(mesh), names, -1)
    lower = _families(families, groups, names, int(cells.min(initial=0)) - 1)
    for kind, (rows, nodes) in face_elements(mesh, faces).items():
        _put(step, kind, nodes, lower[rows])
    start = 0
    found: dict[str, list[tuple[Indices, Indices]]] = {}
    for block in mesh.blocks:
        order = node_order(block.shape, CORNERS[block.shape[:3]], EDGES.get(block.shape, ()))
        own = cells[start : start + len(block.cells)]
        found.setdefault(block.shape, []).append((block.cells[:, order], own))
        start += len(block.cells)
    for shape, pieces in found.items():
        nodes, own = (np.concatenate(some) for some in zip(*pieces, strict=True))
        if len(nodes):
            _put(step, shape, nodes, own)


def _put(step: Branch, kind: str, nodes: Indices, families: Indices) -> None:
    name, number = TYPES[kind]
    table = step.branch(name, CGT=1, CGS=1, GEO=number, PFL=NO_PROFILE)
    table.put("NOD", nodes.T.reshape(-1) + 1, CGT=1, NBR=len(nodes))
    table.put("FAM", families, CGT=1, NBR=len(nodes))


def _families(branch: Branch, groups: Groups, names: dict[str, str], first: int) -> Indices:
    """Write the families of some elements, numbered from ``first`` away from 0; return each's."""
    label, entities = groups.combined()
    numbers = np.zeros(len(entities), np.int64)
    for place, parts in enumerate(entities):
        if parts:
            numbers[place] = first
            family = branch.branch(f"FAM_{first}", NUM=first)
            family.branch("GRO", NBR=len(parts)).put_rows("NOM", _texts([names[p] for p in parts]))
            first += 1 if first > 0 else -1
    return numbers[label]


def _texts(names: list[str]) -> NDArray[np.int8]:
    """Return names as rows of bytes, which MED wants them to be."""
    table = np.zeros((len(names), LONGEST), np.int8)
    for row, name in zip(table, names, strict=True):
        row[: len(name)] = np.frombuffer(name.encode("ascii"), np.int8)
    return table


FORMAT = Format("MED of Salome", (".med",), writes=(VolumeMesh,), write=write, needs=("h5py",))
