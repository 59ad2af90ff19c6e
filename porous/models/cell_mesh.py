"""The cells of a level as one conforming volume mesh, by construction: no mesher, no tolerance."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.values.surface_topology import joined
from porous.values.volume_mesh import SHAPES, Block, Part, VolumeMesh

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from porous.models.cell_nodes import CellNodes, Group

    Indices = NDArray[np.int64]

RESERVED = ("SKIN", "WALL", "SOLID")
"""Names of parts that every mesh has."""


def cell_mesh(nodes: CellNodes, *, contacts: str = "apart", unit: str = "mm") -> VolumeMesh:
    """Return the cells as one mesh with shared nodes, named parts and their addresses as tags.

    Cells are in lexicographic order within their blocks: hexas first, then the tetrahedra of
    tetras and octas. ``cell_tags`` hold each element's ``"address"``, the number of its cell's
    word among all words in lexicographic order, and its ``"state"``.

    Parts are named by the level-0 cell's own faces, wherever they lie: ``XMIN`` the nodes in the
    face XMIN, ``XMIN_FACES`` the faces in it; ``SKIN`` the faces in any of them, ``WALL`` all other
    faces of one cell, ``SOLID`` every element. Empty ones are left out. Of several level-0 cells
    the outer faces that lie in a side of the body's box are called as that is, and all of them are
    ``SKIN``.

    Parameters
    ----------
    nodes
        From ``cell_nodes``.
    contacts
        ``"apart"``: nodes are shared across faces only, so that cells that meet in an edge or a
        point, and are not joined around it, have nodes of their own there: a contact of zero area
        carries no load. ``"shared"``: one node for each vertex of the complex.
    unit
        Unit of the coordinates.

    Raises
    ------
    ModelError
        For cells that are folded (names an address), another word for ``contacts``, faces of the
        level-0 cell that are called ``SKIN``, ``WALL`` or ``SOLID``.
    """
    if contacts not in ("apart", "shared"):
        raise ModelError(f"contacts: got {contacts!r}; wanted 'apart' or 'shared'")
    taken = sorted(set(nodes.faces.values()) & set(RESERVED))
    if taken:
        raise ModelError(
            f"mesh: a face of the level-0 cell is called {taken[0]}; wanted a name "
            f"other than {', '.join(RESERVED)}"
        )
    nodes = nodes.unfolded
    shared = nodes.slots, np.arange(len(nodes.points))
    node, vertex = shared if contacts == "shared" else hung(nodes)
    layout = _layout(nodes)
    blocks, tags = _elements(nodes, layout, node)
    parts = dict(_parts(nodes, layout, vertex))
    return VolumeMesh(nodes.points[vertex], blocks, tags, parts, unit)


def hung(nodes: CellNodes) -> tuple[Indices, Indices]:
    """Return the node of each slot where only faces share nodes, and the vertex of each node.

    Nodes are the classes of slots under "same corner of two cells that share a face", in the
    order of their vertices: where no vertex is split, nodes are the complex's vertices.
    """
    a, b = (nodes.face_slots(sides) for sides in nodes.pairs)
    slots = nodes.slots
    if not np.array_equal(slots[a], slots[b]):
        a, b = _ranked(a, slots), _ranked(b, slots)
    linked = a >= 0
    classes = joined(len(slots), a[linked], b[linked])
    if int(classes.max()) + 1 == len(nodes.points):
        # Every vertex is some slot's: as many classes as vertices are the vertices.
        return slots, np.arange(len(nodes.points))
    return numbered(slots, classes)


def _ranked(corners: Indices, slots: Indices) -> Indices:
    """Return the slots of each face in the order of their vertices, −1 first."""
    order = np.argsort(np.where(corners < 0, -1, slots[corners]), axis=1)
    return np.take_along_axis(corners, order, axis=1)


def numbered(vertices: Indices, classes: Indices) -> tuple[Indices, Indices]:
    """Return classes renumbered by their vertices, then by their first member; and the vertices.

    Parameters
    ----------
    vertices
        Vertex of each thing, (n,); the things of a class have the same.
    classes
        Class of each thing, numbered by first members, (n,).
    """
    vertex = np.empty(int(classes.max(initial=-1)) + 1, np.int64)
    vertex[classes] = vertices
    order = np.argsort(vertex, kind="stable")
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return rank[classes], vertex[order]


_MOST_FACES = max(len(shape.faces) for shape in SHAPES.values())


class _Layout(NamedTuple):
    """Where the elements of each cell are: the first of each place, and of each kind its size."""

    first: Indices
    sizes: dict[str, int]


def _layout(nodes: CellNodes) -> _Layout:
    first = np.empty(nodes.cells, np.int64)
    sizes: dict[str, int] = {}
    for kind in sorted({group.cut.kind for group in nodes.groups}):
        fan = np.zeros(nodes.cells, np.int64)
        for group in _of_kind(nodes, kind):
            fan[group.place] = group.cut.elements.shape[1]
        own = fan > 0
        first[own] = sum(sizes.values()) + (np.cumsum(fan) - fan)[own]
        sizes[kind] = int(fan.sum())
    return _Layout(first, sizes)


def _of_kind(nodes: CellNodes, kind: str) -> Iterable[Group]:
    return (group for group in nodes.groups if group.cut.kind == kind)


def _elements(
    nodes: CellNodes, layout: _Layout, node: Indices
) -> tuple[tuple[Block, ...], dict[str, Indices]]:
    total = sum(layout.sizes.values())
    tags = {name: np.empty(total, np.int64) for name in ("address", "state")}
    cells = {}
    slot = 0
    for group in nodes.groups:
        cut = group.cut
        own = node[slot : slot + group.corners.size].reshape(group.corners.shape)
        slot += own.size
        at = layout.first[group.place][:, None] + np.arange(cut.elements.shape[1])
        tags["address"][at] = group.place[:, None]
        tags["state"][at] = group.state
        if cut.kind not in cells:
            cells[cut.kind] = np.empty((total, cut.elements.shape[2]), np.int64)
        table = group.by_variant(cut.elements)
        cells[cut.kind][at] = np.take_along_axis(own[:, None, :], table, axis=2)
    start, blocks = 0, []
    for kind, size in layout.sizes.items():
        blocks.append(Block(kind, cells[kind][start : start + size].copy()))
        start += size
    return tuple(blocks), tags


def _parts(nodes: CellNodes, layout: _Layout, vertex: Indices) -> Iterable[tuple[str, Part]]:
    members, origin = _outer_faces(nodes, layout)
    lies_in = nodes.origins[0][vertex]
    for name in dict.fromkeys(nodes.faces.values()):
        called = [face for face, other in nodes.faces.items() if other == name]
        around = [bound for face in called for bound in nodes.closures[face]]
        for part, kind, own in (
            (name, "nodes", np.flatnonzero(np.isin(lies_in, around))),
            (f"{name}_FACES", "faces", members[np.isin(origin, called)]),
        ):
            if len(own):
                yield part, Part(kind, own)
    for part, chosen in (("SKIN", origin >= 0), ("WALL", origin < 0)):
        if chosen.any():
            yield part, Part("faces", members[chosen])
    yield "SOLID", Part("cells", np.arange(sum(layout.sizes.values())))


def _outer_faces(nodes: CellNodes, layout: _Layout) -> tuple[Indices, Indices]:
    """Return the faces of one cell as (element, local face), and what they lie in, in order."""
    outer = np.flatnonzero(nodes.outer)
    members = np.empty((len(outer), 2), np.int64)
    for group, _, which, cell, face in nodes.split(outer):
        element, local = group.cut.members[group.variant[cell], face].T
        members[which] = np.column_stack([layout.first[group.place[cell]] + element, local])
    origin = nodes.origins[1][nodes.sides[outer]]
    order = np.argsort(members[:, 0] * _MOST_FACES + members[:, 1])
    return members[order], origin[order]
