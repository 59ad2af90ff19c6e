"""The boundary of the cells of a level: the faces that have one cell, as a closed 2-manifold."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.memory import check_memory
from porous.models.cell_mesh import numbered
from porous.models.cell_shapes import WIDTH
from porous.values.surface import SurfaceMesh
from porous.values.surface_topology import joined

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.models.cell_nodes import CellNodes

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

WALL, SKIN = "WALL", "SKIN"

BYTES_PER_FACE = 1200


class _Rims(NamedTuple):
    """The outer faces' rims, four rims to a face, the fourth of a triangle empty."""

    sides: Indices
    """Which sides of cells the faces are, (n,)."""
    vertices: Indices
    """Vertex where each rim starts, (4·n,); −1 where empty."""
    edges: Indices
    """Edge of the complex that each rim is, (4·n,); −1 where empty."""
    after: Indices
    """The rim that comes next round the face, (4·n,)."""


def cell_boundary(nodes: CellNodes, *, unit: str = "mm") -> SurfaceMesh:
    """Return the boundary of the cells: closed, oriented outward, 2-manifold.

    Quadrilaterals are fanned about the mean of their corners, which encloses the volume of the
    trilinear cells exactly; triangles stay. Around an edge where several fans of face-joined cells
    meet, the two end faces of each fan are joined; points are the corners that hang together
    across joined edges. Cells that only touch thus have points of their own at the same place,
    and so does an edge that two fans share while its ends are joined around it: such edges get
    a point of their own for each fan, in the middle.

    Labels are ``WALL`` and the names of the level-0 cell's faces, wherever those lie; ``SKIN``
    where such a face has no name.

    Parameters
    ----------
    nodes
        From ``cell_nodes``.
    unit
        Unit of the coordinates.

    Raises
    ------
    ModelError
        For cells that are folded (names an address), or a face with more than two cells.
    MemoryLimitError
        Before anything is allocated.
    """
    count = int(nodes.outer.sum())
    check_memory(BYTES_PER_FACE * count, f"a surface of {count} faces", "Choose a lower level.")
    rims = _rims(nodes.unfolded)
    first, second = _joined_rims(nodes, rims)
    corner, vertex = _corners(rims, first, second)
    points = nodes.points[vertex]
    middle, middles = _middles(points, rims, corner, first, second)
    origin = nodes.origins[1][nodes.sides[rims.sides]]
    names = (WALL, *dict.fromkeys(nodes.faces.values()), SKIN)
    label = np.where(origin < 0, 0, len(names) - 1)
    for face, name in nodes.faces.items():
        label[origin == face] = names.index(name)
    return _fanned(
        np.vstack([points, middles]),
        corner.reshape(-1, WIDTH),
        middle.reshape(-1, WIDTH),
        label,
        names if (label == len(names) - 1).any() else names[:-1],
        unit,
    )


def _rims(nodes: CellNodes) -> _Rims:
    sides = np.flatnonzero(nodes.outer)
    vertices, edges = (np.full((len(sides), WIDTH), -1) for _ in range(2))
    for group, _, which, cell, face in nodes.split(sides):
        variant = group.variant[cell]
        loops, rims = group.cut.loops[variant, face], group.cut.sides[variant, face]
        own = cell[:, None]
        vertices[which] = np.where(loops < 0, -1, group.corners[own, loops])
        edges[which] = np.where(rims < 0, -1, group.edges[own, rims])
    many = (vertices >= 0).sum(axis=1, keepdims=True)
    step = (np.arange(WIDTH) + 1) % np.maximum(many, 1)
    after = WIDTH * np.arange(len(sides))[:, None] + step
    return _Rims(sides, vertices.ravel(), edges.ravel(), after.ravel())


def _joined_rims(nodes: CellNodes, rims: _Rims) -> tuple[Indices, Indices]:
    """Return the rims that are one edge of the surface, first and second."""
    real = np.flatnonzero(rims.edges >= 0)
    edges = rims.edges[real]
    count = np.bincount(edges, minlength=nodes.edges)
    first, second = (np.full(len(count), -1) for _ in range(2))
    second[edges] = real  # the last one stays
    first[edges[::-1]] = real[::-1]
    simple = count == 2
    if not (count > 2).any():
        return first[simple], second[simple]
    a, b = _by_fans(nodes, rims, count > 2)
    return np.concatenate([first[simple], a]), np.concatenate([second[simple], b])


def _by_fans(nodes: CellNodes, rims: _Rims, crowded: NDArray[np.bool_]) -> tuple[Indices, Indices]:
    """Return the pairs of rims that end one fan of face-joined cells around a crowded edge.

    A wedge is a cell at such an edge. Two of its faces meet there; across each it is joined to
    the wedge of the neighbour, or it ends in a rim.
    """
    wings = _wings(nodes, crowded)
    order = np.argsort(wings, axis=None, kind="stable")
    keys, wedge = wings.ravel()[order], order // 2
    same = np.flatnonzero(keys[1:] == keys[:-1])
    fan = joined(len(wings), wedge[same], wedge[same + 1])
    alone = np.ones(len(keys), bool)
    alone[same] = alone[same + 1] = False
    ends = fan[wedge[alone]]  # in the order of their keys
    own = np.flatnonzero((rims.edges >= 0) & crowded[rims.edges])
    faces = nodes.sides[rims.sides[own // WIDTH]]
    own = own[np.argsort(faces * nodes.edges + rims.edges[own])]
    pairs = own[np.argsort(ends, kind="stable")].reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def _wings(nodes: CellNodes, crowded: NDArray[np.bool_]) -> Indices:
    """Return a key of (face, edge) for both faces of each wedge, (w, 2)."""
    result = [np.zeros((0, 2), np.int64)]
    for group in nodes.groups:
        cell, edge = np.nonzero(crowded[group.edges])
        faces = group.faces[cell[:, None], group.cut.wings[edge]]
        result.append(faces * nodes.edges + group.edges[cell, edge][:, None])
    return np.concatenate(result)


def _corners(rims: _Rims, first: Indices, second: Indices) -> tuple[Indices, Indices]:
    """Return the point of each rim's start, −1 where empty, and the vertex of each point."""
    # Faces that are oriented alike run along their common edge in opposite directions.
    turned = rims.vertices[first] == rims.vertices[rims.after[second]]
    far = np.where(turned, rims.after[second], second)
    near = np.where(turned, second, rims.after[second])
    real = rims.vertices >= 0
    rank = np.cumsum(real) - 1
    a = np.concatenate([first, rims.after[first]])
    b = np.concatenate([far, near])
    classes = joined(int(real.sum()), rank[a], rank[b])
    corner = np.full(len(real), -1)
    corner[real], vertex = numbered(rims.vertices[real], classes)
    return corner, vertex


def _middles(
    points: Floats, rims: _Rims, corner: Indices, first: Indices, second: Indices
) -> tuple[Indices, Floats]:
    """Return the middle point of each rim, −1 for most, and where those points are.

    Edges of the surface between the same two points would be one edge of four triangles.
    """
    start, stop = corner[first], corner[rims.after[first]]
    key = np.minimum(start, stop) * len(points) + np.maximum(start, stop)
    order = np.argsort(key)
    again = key[order][1:] == key[order][:-1]
    double = np.zeros(len(key), bool)
    double[order[1:]] |= again
    double[order[:-1]] |= again
    which = np.flatnonzero(double)
    middle = np.full(len(corner), -1)
    number = len(points) + np.arange(len(which))
    middle[first[which]] = middle[second[which]] = number
    return middle, (points[start[which]] + points[stop[which]]) / 2


def _fanned(
    points: Floats,
    corner: Indices,
    middle: Indices,
    label: Indices,
    names: tuple[str, ...],
    unit: str,
) -> SurfaceMesh:
    """Return the surface: triangles as they are, all else fanned about the mean of its corners."""
    many = (corner >= 0).sum(axis=1)
    fanned = (many > WIDTH - 1) | (middle >= 0).any(axis=1)
    spots = np.where(corner[fanned, :, None] < 0, 0.0, points[corner[fanned]])
    centres = spots.sum(axis=1) / many[fanned, None]
    # A triangle is a fan of one: about its third corner, from the first to the second.
    centre = corner[:, 2].copy()
    centre[fanned] = len(points) + np.arange(len(centres))
    # Every rim makes a triangle with the centre; where it has a middle, two.
    count = np.where(corner < 0, 0, 1 + (middle >= 0))
    count[~fanned, 1:] = 0
    after = np.where(
        np.arange(WIDTH) + 1 < many[:, None], np.roll(corner, -1, axis=1), corner[:, :1]
    )
    first = (np.cumsum(count) - count.ravel()).reshape(count.shape)
    triangles = np.empty((int(count.sum()), 3), np.int64)
    for rims, start, stop, at in (
        (count > 0, corner, np.where(middle < 0, after, middle), first),
        (middle >= 0, middle, after, first + 1),
    ):
        triangles[at[rims]] = np.column_stack(
            [start[rims], stop[rims], np.repeat(centre, rims.sum(axis=1))]
        )
    labels = np.repeat(label, count.sum(axis=1)).astype(np.int16)
    return SurfaceMesh(np.vstack([points, centres]), triangles, unit, labels, names)
