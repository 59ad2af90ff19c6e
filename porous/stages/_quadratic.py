"""From linear elements to quadratic ones: a node in the middle of every edge."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import MeshError
from porous.memory import check_memory
from porous.values import SHAPES, Block, Part, VolumeMesh
from porous.values.volume_topology import boundary_faces, nodes_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Indices = NDArray[np.int64]

CURVED = {shape.linear: name for name, shape in SHAPES.items() if shape.linear}
"""The quadratic shape of each linear one."""

BYTES_PER_EDGE = 100
"""Measured on hexahedra, per edge of every cell, the mesh that comes out included."""


class Edges(NamedTuple):
    """The edges of a mesh and the nodes in their middles."""

    keys: Indices
    """Two corners as one number, sorted."""
    middles: Indices
    nodes: int
    """How many nodes corners are numbered among."""

    @classmethod
    def of(cls, mesh: VolumeMesh) -> Edges:
        """Return the edges of the quadratic cells of a mesh."""
        keys, middles = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        for block in mesh.blocks:
            if edges := SHAPES[block.shape].edges:
                keys.append(_keys(block.cells[:, edges], len(mesh.points)).ravel())
                middles.append(block.cells[:, -len(edges) :].ravel())
        found, first = np.unique(np.concatenate(keys), return_index=True)
        return cls(found, np.concatenate(middles)[first], len(mesh.points))

    def between(self, ends: Indices) -> Indices:
        """Return the node between two corners (n, 2), −1 where no edge has these."""
        wanted = _keys(ends, self.nodes)
        at = np.searchsorted(self.keys, wanted).clip(max=len(self.keys) - 1)
        return np.asarray(np.where(self.keys[at] == wanted, self.middles[at], -1))


def quadratic(mesh: VolumeMesh) -> VolumeMesh:
    """Return the same cells with a node in the middle of each edge: tet10 and hex20.

    Edges stay straight; cells that share an edge share its node, and the corners keep their
    numbers. Tags and parts are kept. Parts of nodes gain the middles of the edges of boundary
    faces that lie in them: of ``XMIN_FACES`` for ``XMIN``, where there is such a part, else of the
    faces that have all their corners in it. Pairs gain the middles between them.

    Raises
    ------
    MeshError
        For wedges, and cells that are quadratic already.
    MemoryLimitError
        Before anything is allocated.
    """
    for block in mesh.blocks:
        if block.shape not in CURVED:
            raise MeshError(
                f"quadratic: got cells of shape {block.shape}; wanted {' or '.join(CURVED)}"
            )
    shapes = [SHAPES[CURVED[block.shape]] for block in mesh.blocks]
    total = sum(len(b.cells) * len(s.edges) for b, s in zip(mesh.blocks, shapes, strict=True))
    check_memory(
        BYTES_PER_EDGE * total,
        f"quadratic elements with {total} edges",
        "Choose fewer voxels, or volume.order = 1.",
    )
    count = len(mesh.points)
    keys = [_keys(b.cells[:, s.edges], count) for b, s in zip(mesh.blocks, shapes, strict=True)]
    flat = np.concatenate([np.zeros(0, np.int64), *(key.ravel() for key in keys)])
    edges, index = np.unique(flat, return_inverse=True)
    middles = (mesh.points[edges // max(count, 1)] + mesh.points[edges % max(count, 1)]) / 2
    parts = np.split(count + index.ravel(), np.cumsum([key.size for key in keys])[:-1])
    blocks = tuple(
        Block(CURVED[block.shape], np.hstack([block.cells, part.reshape(key.shape)]))
        for block, key, part in zip(mesh.blocks, keys, parts, strict=False)
    )
    table = Edges(edges, count + np.arange(len(edges)), count)
    return VolumeMesh(
        np.concatenate([mesh.points, middles]),
        blocks,
        mesh.cell_tags,
        dict(_parts(mesh, table)),
        mesh.unit,
    )


def with_middles(pairs: Indices, edges: Edges) -> Indices:
    """Return pairs of nodes and, after them, those of the middles of edges between them."""
    partner = np.full(edges.nodes, -1)
    partner[pairs[:, 0]] = pairs[:, 1]
    ends = np.stack(np.divmod(edges.keys, max(edges.nodes, 1)), axis=1)
    own = (partner[ends] >= 0).all(axis=1)
    opposite = edges.between(partner[ends[own]])
    found = np.stack([edges.middles[own], opposite], axis=1)
    return np.concatenate([pairs, found[opposite >= 0]])


def _keys(ends: Indices, count: int) -> Indices:
    """Return two nodes (…, 2) of ``count`` as one number, whichever comes first."""
    return np.asarray(ends.min(axis=-1) * count + ends.max(axis=-1))


def _parts(mesh: VolumeMesh, edges: Edges) -> list[tuple[str, Part]]:
    result = []
    outer = None
    for name, part in mesh.parts.items():
        grown = part
        if part.kind == "pairs":
            grown = Part("pairs", with_middles(part.members, edges))
        elif part.kind == "nodes":
            outer = boundary_faces(mesh) if outer is None else outer
            own = mesh.parts.get(f"{name}_FACES")
            faces = own.members if own is not None and own.kind == "faces" else outer
            found = _middles_in(part.members, nodes_of(mesh, faces), edges)
            grown = Part("nodes", np.concatenate([part.members, found]))
        result.append((name, grown))
    return result


def _middles_in(nodes: Indices, rings: Indices, edges: Edges) -> Indices:
    """Return the middles of the edges of faces (f, 4) that have all their corners in a part."""
    inside = np.zeros(edges.nodes, dtype=bool)
    inside[nodes] = True
    rings = rings[(inside[rings] | (rings < 0)).all(axis=1)]
    following = np.roll(rings, -1, axis=1)
    following = np.where(following < 0, rings[:, :1], following)
    ends = np.stack([rings, following], axis=2)[rings >= 0]
    return np.unique(edges.between(ends))
