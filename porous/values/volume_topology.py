"""What the connectivity of a volume mesh says: shared faces, boundary, bodies joined by faces.

A face is numbered as (cell, local face), cells counted through the blocks and local faces as in
``SHAPES``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import MeshError
from porous.values.surface_topology import joined
from porous.values.volume_mesh import SHAPES, WIDTH, Block, Part, VolumeMesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Indices = NDArray[np.int64]


class Faces(NamedTuple):
    """Every face of every cell: (cell, local face) and its nodes, −1 where it has fewer."""

    members: Indices
    """(f, 2)"""
    nodes: Indices
    """(f, 4)"""


def faces(mesh: VolumeMesh) -> Faces:
    """Return every face of every cell, cell by cell."""
    members, nodes, start = [], [], 0
    for block in mesh.blocks:
        local = SHAPES[block.shape].table
        count = len(block.cells)
        cell = np.repeat(start + np.arange(count), len(local))
        members.append(np.stack([cell, np.tile(np.arange(len(local)), count)], axis=1))
        nodes.append(np.where(local < 0, -1, block.cells[:, local]).reshape(-1, WIDTH))
        start += count
    empty = np.zeros((0, 2), np.int64), np.zeros((0, WIDTH), np.int64)
    return Faces(np.concatenate([empty[0], *members]), np.concatenate([empty[1], *nodes]))


def nodes_of(mesh: VolumeMesh, members: Indices) -> Indices:
    """Return the nodes (n, 4) of faces given as (cell, local face); −1 where there are fewer."""
    result = np.full((len(members), WIDTH), -1, dtype=np.int64)
    start = 0
    for block in mesh.blocks:
        own = np.flatnonzero((members[:, 0] >= start) & (members[:, 0] < start + len(block.cells)))
        cell, local = members[own].T
        table = SHAPES[block.shape].table[local]
        result[own] = np.where(table < 0, -1, block.cells[(cell - start)[:, None], table])
        start += len(block.cells)
    return result


def matched(all_faces: Faces) -> tuple[Indices, Indices]:
    """Return the pairs of faces, as indices into ``all_faces``, that are two sides of one.

    Raises
    ------
    MeshError
        Where three cells or more share a face.
    """
    key = np.sort(all_faces.nodes, axis=1)
    order = np.lexsort(key.T)
    same = (key[order[1:]] == key[order[:-1]]).all(axis=1)
    if (same[1:] & same[:-1]).any():
        cell = int(all_faces.members[order[1:-1][same[1:] & same[:-1]][0], 0])
        raise MeshError(f"volume mesh: a face of cell {cell} is shared by more than two cells")
    place = np.flatnonzero(same)
    return order[place], order[place + 1]


def boundary_faces(mesh: VolumeMesh) -> Indices:
    """Return the faces of one cell only, as (cell, local face), shape (n, 2)."""
    every = faces(mesh)
    outer = np.ones(len(every.members), dtype=bool)
    outer[np.concatenate(matched(every))] = False
    return every.members[outer]


def bodies(mesh: VolumeMesh) -> Indices:
    """Return the number of the body that each cell is of; cells of one body hang by faces.

    Bodies are numbered by their first cell, from 0 upwards.
    """
    every = faces(mesh)
    first, second = matched(every)
    return joined(mesh.cells, every.members[first, 0], every.members[second, 0])


def hung_by_faces(mesh: VolumeMesh) -> VolumeMesh:
    """Return the mesh with nodes that are shared across faces only.

    Cells that meet in a point or an edge, and are not joined there by others across faces, get
    nodes of their own at the same place: a contact of zero area carries no load. Without parts,
    whose nodes would be others.
    """
    slots = np.concatenate([block.cells.ravel() for block in mesh.blocks])
    every = faces(_numbered(mesh))  # nodes are slots: the corner of one cell
    nodes = np.where(every.nodes < 0, -1, slots[every.nodes])
    order = np.argsort(nodes, axis=1)
    ranked = np.take_along_axis(every.nodes, order, axis=1)
    first, second = matched(Faces(every.members, nodes))
    a, b = ranked[first].ravel(), ranked[second].ravel()
    linked = a >= 0
    node = joined(len(slots), a[linked], b[linked])
    source = np.empty(node.max(initial=-1) + 1, dtype=np.int64)
    source[node] = slots
    return VolumeMesh(mesh.points[source], _renumbered(mesh, node), mesh.cell_tags, unit=mesh.unit)


def extracted(mesh: VolumeMesh, chosen: NDArray[np.bool_]) -> VolumeMesh:
    """Return the mesh of the chosen cells alone, its unused nodes dropped, its parts cut down.

    Parameters
    ----------
    mesh
        Any.
    chosen
        Shape (cells,).
    """
    stops = np.cumsum([len(block.cells) for block in mesh.blocks])[:-1]
    kept = [
        (block.shape, block.cells[own])
        for block, own in zip(mesh.blocks, np.split(chosen, stops), strict=True)
    ]
    used = np.zeros(len(mesh.points), dtype=bool)
    for _, cells in kept:
        used[cells] = True
    node = np.where(used, np.cumsum(used) - 1, -1)
    cell = np.where(chosen, np.cumsum(chosen) - 1, -1)
    return VolumeMesh(
        mesh.points[used],
        tuple(Block(shape, node[cells]) for shape, cells in kept if len(cells)),
        {name: tag[chosen] for name, tag in mesh.cell_tags.items()},
        {name: _cut(part, node, cell) for name, part in mesh.parts.items()},
        mesh.unit,
    )


def _numbered(mesh: VolumeMesh) -> VolumeMesh:
    """Return a mesh whose cells share nothing: node numbers count the corners of all cells."""
    count = sum(block.cells.size for block in mesh.blocks)
    return VolumeMesh(np.zeros((count, 3)), _renumbered(mesh, np.arange(count)), unit=mesh.unit)


def _renumbered(mesh: VolumeMesh, node: Indices) -> tuple[Block, ...]:
    stops = np.cumsum([block.cells.size for block in mesh.blocks])[:-1]
    return tuple(
        Block(block.shape, part.reshape(block.cells.shape))
        for block, part in zip(mesh.blocks, np.split(node, stops), strict=True)
    )


def _cut(part: Part, node: Indices, cell: Indices) -> Part:
    members = part.members
    if part.kind == "faces":
        renamed = np.column_stack([cell[members[:, 0]], members[:, 1]])
        return Part("faces", renamed[renamed[:, 0] >= 0])
    renamed = (cell if part.kind == "cells" else node)[members]
    kept = (renamed >= 0).all(axis=tuple(range(1, renamed.ndim)))
    return Part(part.kind, renamed[kept])
