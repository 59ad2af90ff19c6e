"""Exodus II: blocks, node sets, side sets and element sets, for MOOSE, Sierra, Cubit and ParaView.

A block is of one shape and one part: the first part that its cells are in, where ``SOLID`` and
``PORE`` come before all others. Its name is the part's, and the shape's where the part has several.
Parts of cells that are not just a block are element sets too, so that parts may overlap. Faces are
side sets, by the numbers that Exodus gives to sides. Elements are numbered block by block; a map
says what number, from 1, each has in the mesh. The unit is an information record; lengths are in
it. Names are 32 letters, digits, ``_``, ``.``, ``+`` and ``-``. Parts of pairs, empty parts and
tags are not written. The file is classic netCDF with 64-bit offsets.
https://sandialabs.github.io/seacas-docs/sphinx/html/index.html
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.formats._groups import cells_in, faces_in, names_in, node_order, nodes_in, refuse_empty
from porous.formats._netcdf import Classic
from porous.formats._registry import Format
from porous.values import SHAPES, VolumeMesh

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Indices = NDArray[np.int64]

TYPES = {"tet4": "TETRA4", "tet10": "TETRA10", "hex8": "HEX8", "hex20": "HEX20", "wed6": "WEDGE"}
SIDES = {"tet": (4, 1, 2, 3), "hex": (5, 6, 1, 2, 3, 4), "wed": (4, 5, 1, 2, 3)}
"""Numbers that Exodus gives to our faces."""
HEXAHEDRON = (
    *((0, 1), (1, 2), (2, 3), (3, 0)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
    *((4, 5), (5, 6), (6, 7), (7, 4)),
)
"""Edges in the order in which Exodus numbers the nodes upon them; tetrahedra are as VTK's."""
REST = "CELLS"
"""The block of cells that are in no part."""
ODD, LONGEST = r"[^A-Za-z0-9_.+-]", 32
MOST = 2**31 - 1
"""The most nodes or elements that 32 bits count."""


def write(mesh: VolumeMesh) -> Iterator[bytes]:
    """Write a mesh."""
    refuse_empty(mesh)
    if max(len(mesh.points), mesh.cells) > MOST:
        raise FormatError(f"the mesh has more than {MOST} nodes or cells; wanted no more")
    file = Classic(
        {
            "api_version": np.float32(8.03),
            "version": np.float32(8.03),
            "floating_point_word_size": np.int32(8),
            "file_size": np.int32(1),
            "maximum_name_length": np.int32(LONGEST),
            "title": "made by porous",
        },
        {"len_string": 33, "len_line": 81, "four": 4, "len_name": LONGEST + 1, "time_step": 0},
    )
    file.put_texts("info_records", [f"lengths in {mesh.unit}"], "num_info", "len_line")
    for axis, values in zip("xyz", mesh.points.T, strict=True):
        file.put(f"coord{axis}", values, "num_nodes")
    file.put_texts("coor_names", ["x", "y", "z"], "num_dim", "len_name")
    number = _blocks(file, mesh)
    _side_sets(file, mesh, number)
    file.put("time_whole", np.zeros(0), "time_step")
    return file.chunks()


def _blocks(file: Classic, mesh: VolumeMesh) -> Indices:
    """Put blocks and element sets; return the number that each cell has in the file."""
    groups = cells_in(mesh)
    label, parts = groups.leading()
    found: dict[str, list[tuple[str, Indices, Indices]]] = {}
    for shape, (rows, nodes) in _by_shape(mesh).items():
        for lead in np.unique(label[rows]).tolist():
            own = label[rows] == lead
            part = parts[lead] if lead >= 0 else REST
            found.setdefault(part, []).append((shape, rows[own], nodes[own]))
    order = [part for part in (*parts, REST) if part in found]
    blocks = [
        (part if len(found[part]) == 1 else f"{part}_{TYPES[shape]}", shape, rows, nodes)
        for part in order
        for shape, rows, nodes in found[part]
    ]
    places = np.concatenate([rows for _, _, rows, _ in blocks])
    file.put("elem_num_map", _whole(places + 1), "num_elem")
    _heads(file, "eb", "num_el_blk", [name for name, *_ in blocks])
    for index, (_, shape, rows, nodes) in enumerate(blocks, 1):
        dimensions = f"num_el_in_blk{index}", f"num_nod_per_el{index}"
        assert nodes.shape == (len(rows), SHAPES[shape].nodes)
        file.put(f"connect{index}", _whole(nodes + 1), *dimensions, elem_type=TYPES[shape])
    number = np.empty(mesh.cells, np.int64)
    number[places] = np.arange(1, mesh.cells + 1)
    sets = {n: m for n, m in groups.sets.items() if not _is_block(found.get(n, []), m)}
    _heads(file, "els", "num_elem_sets", list(sets))
    for index, members in enumerate(sets.values(), 1):
        file.put(f"elem_els{index}", _whole(np.sort(number[members])), f"num_ele_els{index}")
    return number


def _by_shape(mesh: VolumeMesh) -> dict[str, tuple[Indices, Indices]]:
    """Return cells and their nodes in the order of Exodus, by shape."""
    found: dict[str, list[tuple[Indices, Indices]]] = {}
    start = 0
    for block in mesh.blocks:
        shape = SHAPES[block.shape]
        corners = SHAPES[shape.linear].nodes if shape.linear else shape.nodes
        edges = HEXAHEDRON if block.shape == "hex20" else shape.edges
        order = node_order(block.shape, range(corners), edges)
        rows = start + np.arange(len(block.cells))
        if len(rows):
            found.setdefault(block.shape, []).append((rows, block.cells[:, order]))
        start += len(block.cells)
    return {
        shape: (np.concatenate([r for r, _ in pieces]), np.concatenate([n for _, n in pieces]))
        for shape, pieces in found.items()
    }


def _is_block(pieces: list[tuple[str, Indices, Indices]], members: Indices) -> bool:
    """Return whether a part of so many members is one block: it never has more in its blocks."""
    return len(pieces) == 1 and len(pieces[0][1]) == len(members)


def _side_sets(file: Classic, mesh: VolumeMesh, number: Indices) -> None:
    """Put sets of sides and of nodes, which MOOSE wants numbered apart."""
    faces, groups = faces_in(mesh)
    sides = _sides(mesh, faces)
    _heads(file, "ss", "num_side_sets", list(groups.sets))
    for index, rows in enumerate(groups.sets.values(), 1):
        file.put(f"elem_ss{index}", _whole(number[faces[rows, 0]]), f"num_side_ss{index}")
        file.put(f"side_ss{index}", _whole(sides[rows]), f"num_side_ss{index}")
    nodes = nodes_in(mesh).sets
    _heads(file, "ns", "num_node_sets", list(nodes), first=len(groups.sets) + 1)
    for index, members in enumerate(nodes.values(), 1):
        file.put(f"node_ns{index}", _whole(members + 1), f"num_nod_ns{index}")


def _sides(mesh: VolumeMesh, faces: Indices) -> Indices:
    sides = np.zeros(len(faces), np.int64)
    start = 0
    for block in mesh.blocks:
        own = (faces[:, 0] >= start) & (faces[:, 0] < start + len(block.cells))
        sides[own] = np.array(SIDES[block.shape[:3]])[faces[own, 1]]
        start += len(block.cells)
    return sides


def _heads(file: Classic, code: str, dimension: str, names: list[str], first: int = 1) -> None:
    """Put the states, numbers and names of blocks or sets, where there are any."""
    if names:
        count = len(names)
        file.put(f"{code}_status", np.ones(count, np.int32), dimension)
        file.put(f"{code}_prop1", _whole(first + np.arange(count)), dimension, name="ID")
        short = names_in(names, ODD, LONGEST, "Exodus")
        file.put_texts(f"{code}_names", list(short.values()), dimension, "len_name")


def _whole(numbers: Indices) -> NDArray[np.int32]:
    return numbers.astype(np.int32)


FORMAT = Format("Exodus II", (".exo", ".e", ".ex2"), writes=(VolumeMesh,), write=write)
