"""What Gmsh's versions share in writing: points, faces and cells as elements of numbered entities.

An entity is a distinct combination of parts, so that parts may overlap. Of the parts of nodes those
are points that are not just the nodes of a part of faces.
"""

from __future__ import annotations

from dataclasses import dataclass
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
from porous.values import SHAPES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.values import VolumeMesh

    Indices = NDArray[np.int64]

TYPES = {"point": 15, "tri3": 2, "quad4": 3, "tri6": 9, "quad8": 16}
TYPES |= {"tet4": 4, "hex8": 5, "wed6": 6, "tet10": 11, "hex20": 17}
"""Numbers of element types."""
CORNERS = {"tri3": 3, "quad4": 4, "tri6": 3, "quad8": 4}
TETRAHEDRON = ((0, 1), (1, 2), (2, 0), (3, 0), (3, 2), (3, 1))
HEXAHEDRON = (
    *((0, 1), (0, 3), (0, 4), (1, 2), (1, 5), (2, 3)),
    *((2, 6), (3, 7), (4, 5), (4, 7), (5, 6), (6, 7)),
)
EDGES = {"tet10": TETRAHEDRON, "hex20": HEXAHEDRON}
"""Edges in the order in which Gmsh numbers the nodes upon them."""
ODD, LONGEST = r"[^ !#%-\[\]-~]", 127
"""What no name of a group holds: quotes, $, backslashes, what is not ASCII; the longest name."""


@dataclass(frozen=True)
class Tier:
    """All elements of one dimension."""

    dimension: int
    groups: Groups
    label: Indices
    """Which of ``entities`` each element is of."""
    entities: list[tuple[str, ...]]
    """The parts that the elements of each are in."""
    pieces: list[tuple[str, Indices, Indices]]
    """Elements of one type: the type, which of the tier's elements, their nodes."""
    first: int
    """Number in the file of the first element."""

    def boxes(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the corners of each entity's box, (entities, 6)."""
        low, high = np.empty((2, len(self.label), 3))
        for _, rows, nodes in self.pieces:
            low[rows], high[rows] = points[nodes].min(axis=1), points[nodes].max(axis=1)
        order = np.argsort(self.label, kind="stable")
        starts = np.searchsorted(self.label[order], np.arange(len(self.entities)))
        if not len(starts):
            return np.zeros((0, 6))
        lower = np.minimum.reduceat(low[order], starts)
        return np.concatenate([lower, np.maximum.reduceat(high[order], starts)], axis=1)


@dataclass(frozen=True)
class Link:
    """An entity of faces that lies one period on from another, and the nodes that match."""

    slave: int
    master: int
    pairs: Indices
    """(n, 2), each node of the slave and the one of the master that it matches."""


def tiers_of(mesh: VolumeMesh) -> tuple[Tier, Tier, Tier]:
    """Return points, faces and cells; cells are numbered first, as the mesh has them."""
    refuse_empty(mesh)
    faces, groups = faces_in(mesh)
    found = face_elements(mesh, faces)
    second = _tier(2, groups, [(k, *piece) for k, piece in found.items()], 1 + mesh.cells)
    nodes, loose = _loose(mesh, second)
    point = [("point", np.arange(len(nodes)), nodes[:, None])] if len(nodes) else []
    return (
        _tier(0, loose, point, second.first + len(faces)),
        second,
        _tier(3, cells_in(mesh), list(_cells(mesh)), 1),
    )


def _tier(
    dimension: int, groups: Groups, pieces: list[tuple[str, Indices, Indices]], first: int
) -> Tier:
    label, entities = groups.combined()
    return Tier(dimension, groups, label, entities, pieces, first)


def _cells(mesh: VolumeMesh) -> Iterator[tuple[str, Indices, Indices]]:
    start = 0
    for block in mesh.blocks:
        shape = SHAPES[block.shape]
        corners = SHAPES[shape.linear].nodes if shape.linear else shape.nodes
        order = node_order(block.shape, range(corners), EDGES.get(block.shape, ()))
        rows = start + np.arange(len(block.cells))
        if len(rows):
            yield block.shape, rows, block.cells[:, order]
        start += len(block.cells)


def _loose(mesh: VolumeMesh, faces: Tier) -> tuple[Indices, Groups]:
    """Return the nodes that become points and their parts: those that no part of faces says."""
    said = set()
    for members in faces.groups.sets.values():
        chosen = np.zeros(faces.groups.count, bool)
        chosen[members] = True
        whole = [(nodes[chosen[rows]], CORNERS[kind]) for kind, rows, nodes in faces.pieces]
        said.add(np.unique(np.concatenate([n.ravel() for n, _ in whole])).tobytes())
        said.add(np.unique(np.concatenate([n[:, :c].ravel() for n, c in whole])).tobytes())
    sets = {n: some for n, some in nodes_in(mesh).sets.items() if some.tobytes() not in said}
    every = np.unique(np.concatenate([np.zeros(0, np.int64), *sets.values()]))
    return every, Groups(len(every), {n: np.searchsorted(every, m) for n, m in sets.items()})


def names_of(tiers: tuple[Tier, ...]) -> dict[str, tuple[int, str]]:
    """Return the number and the name that each part has in the file."""
    names = names_in((n for tier in tiers for n in tier.groups.sets), ODD, LONGEST, "Gmsh")
    return {key: (number, name) for number, (key, name) in enumerate(names.items(), 1)}


def name_lines(rows: list[tuple[int, int, str]]) -> bytes:
    """Return the section of names: dimension, number and name of each group."""
    lines = [f'{dimension} {number} "{name}"\n' for dimension, number, name in rows]
    return section("PhysicalNames", f"{len(rows)}\n{''.join(lines)}") if rows else b""


def section(name: str, body: str) -> bytes:
    """Return a section of text."""
    return f"${name}\n{body}$End{name}\n".encode()


def links_of(mesh: VolumeMesh, faces: Tier) -> list[Link]:
    """Return what entities of faces match: by parts of pairs, where both sides have faces."""
    return [
        link
        for part in mesh.parts.values()
        if part.kind == "pairs" and len(part.members)
        for link in _links(len(mesh.points), part.members, faces)
    ]


def _links(count: int, pairs: Indices, faces: Tier) -> Iterator[Link]:
    partner = np.full(count, -1)
    partner[pairs[:, 1]] = pairs[:, 0]
    owner = np.full(count, -1)
    for entity, nodes in _faces_among(pairs[:, 0], count, faces):
        owner[nodes] = entity
    found: dict[int, list[Indices]] = {}
    for entity, nodes in _faces_among(pairs[:, 1], count, faces):
        found.setdefault(entity, []).append(nodes[partner[nodes] >= 0])
    for entity, pieces in found.items():
        slaves = np.unique(np.concatenate(pieces))
        masters = owner[partner[slaves]]
        masters = masters[(masters >= 0) & (masters != entity)]
        if len(masters):
            table = np.stack([slaves, partner[slaves]], axis=1)
            yield Link(entity, int(np.bincount(masters).argmax()), table)


def _faces_among(some: Indices, count: int, faces: Tier) -> Iterator[tuple[int, Indices]]:
    """Give entities and the nodes of those of their faces whose corners are all among some."""
    among = np.zeros(count, bool)
    among[some] = True
    for kind, rows, nodes in faces.pieces:
        inside = among[nodes[:, : CORNERS[kind]]].all(axis=1)
        labels = faces.label[rows[inside]]
        for entity in np.unique(labels).tolist():
            yield entity, np.unique(nodes[inside][labels == entity])
