"""Which nodes of opposite sides are one, where a body goes on in copies of itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import MeshError
from porous.stages._quadratic import Edges, with_middles
from porous.values import Box, Part, VolumeMesh
from porous.values.box import SIDES
from porous.values.volume_topology import boundary_faces, nodes_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Indices = NDArray[np.int64]
    Floats = NDArray[np.float64]

TOLERANCE = 1e-6
"""Nodes that lie closer, relative to the box's longest edge, are at one place: coordinates read
from files in single precision are as far off."""


class _Side(NamedTuple):
    """The faces of a side: their nodes (f, 4), −1 where fewer, and places across the axis."""

    name: str
    nodes: Indices
    corners: Floats
    """(f, 4, 2), infinite where there is none."""
    middles: Floats
    """(f, 2)"""


def periodic_pairs(
    mesh: VolumeMesh,
    *,
    axes: tuple[bool, bool, bool] = (True, True, True),
    tolerance: float = TOLERANCE,
) -> VolumeMesh:
    """Return the mesh with parts ``XPAIRS``, ``YPAIRS``, ``ZPAIRS`` of nodes on opposite sides.

    Each face in a side of the mesh's box is to have one in the opposite side that is its copy;
    their nodes are the pairs, the node at MIN first. Nodes at one place that are not one stay
    apart. What touches a side in points and edges only has no partner there.

    Parameters
    ----------
    mesh
        Of any cells; nodes in the middle of edges are paired too.
    axes
        Along which the body goes on.
    tolerance
        How far nodes may be off, relative to the box's longest edge.

    Raises
    ------
    MeshError
        Where faces or nodes of a side have no partner (says how many, and where), nodes have
        several, no face lies in a side, or the tolerance is not a small positive number.
    """
    if not 0 < tolerance < 0.1:
        raise MeshError(f"tolerance: got {tolerance}; wanted a number between 0 and 0.1")
    if not mesh.cells:
        raise MeshError("periodic pairs: the mesh has no cells; wanted at least one")
    box = Box.of_points(mesh.points)
    reach = tolerance * max(box.lengths)
    rings = nodes_of(mesh, boundary_faces(mesh))
    edges = Edges.of(mesh)
    found = {}
    for axis in (axis for axis, wanted in enumerate(axes) if wanted):
        sides = [_side(mesh, rings, box, 2 * axis + end, reach) for end in (0, 1)]
        pairs = _paired(mesh, sides[0], sides[1], reach)
        pairs = with_middles(pairs, edges) if len(edges.keys) else pairs
        found[f"{'XYZ'[axis]}PAIRS"] = Part("pairs", pairs)
    parts = {**mesh.parts, **found}
    return VolumeMesh(mesh.points, mesh.blocks, mesh.cell_tags, parts, mesh.unit)


def _side(mesh: VolumeMesh, rings: Indices, box: Box, index: int, reach: float) -> _Side:
    axis, end = divmod(index, 2)
    level = (box.lower, box.upper)[end][axis]
    on = np.abs(mesh.points[:, axis] - level) <= reach
    nodes = rings[(on[rings] | (rings < 0)).all(axis=1)]
    across = np.delete(mesh.points, axis, axis=1)[nodes]
    there = (nodes >= 0)[..., None]
    middles = np.where(there, across, 0.0).sum(axis=1) / there.sum(axis=1)
    if not len(nodes):
        raise MeshError(
            f"periodic pairs: no face lies in {SIDES[index]}, "
            f"{'xyz'[axis]} = {level:.6g} {mesh.unit}; wanted a body that goes on there"
        )
    return _Side(SIDES[index], nodes, np.where(there, across, np.inf), middles)


def _paired(mesh: VolumeMesh, low: _Side, high: _Side, reach: float) -> Indices:
    """Return the pairs of nodes (n, 2) of two sides, or say what is not a copy of what."""
    from scipy.spatial import cKDTree

    far, which = cKDTree(high.middles).query(low.middles)
    close = np.flatnonzero(far <= reach)
    corners, others = low.corners[close], high.corners[which[close]]
    # Corners that are missing are as far from all others as can be.
    with np.errstate(invalid="ignore"):
        gaps = np.abs(corners[:, :, None] - others[:, None]).max(axis=3)
    gaps = np.where(np.isnan(gaps), np.inf, gaps)
    least, there = gaps.min(axis=2), low.nodes[close] >= 0
    fits = ((least <= reach) | ~there).all(axis=1)
    fits &= there.sum(axis=1) == (high.nodes[which[close]] >= 0).sum(axis=1)
    own, other = close[fits], which[close[fits]]
    partner = np.take_along_axis(high.nodes[other], gaps[fits].argmin(axis=2), axis=1)
    pairs = np.unique(np.stack([low.nodes[own], partner], axis=2)[there[fits]], axis=0)
    _check_complete(mesh, (low, high), (own, other), pairs)
    return pairs


def _check_complete(
    mesh: VolumeMesh, sides: tuple[_Side, _Side], own: tuple[Indices, Indices], pairs: Indices
) -> None:
    lost = [
        side.nodes[np.setdiff1d(np.arange(len(side.nodes)), faces)]
        for side, faces in zip(sides, own, strict=True)
    ]
    alone = [
        np.setdiff1d(side.nodes[side.nodes >= 0], members)
        for side, members in zip(sides, pairs.T, strict=True)
    ]
    for side, members in zip(sides, pairs.T, strict=True):
        nodes, many = np.unique(members, return_counts=True)
        if (many > 1).any():
            raise MeshError(
                f"periodic pairs: {(many > 1).sum()} nodes of {side.name} have several partners, "
                f"the first at {_told(mesh, nodes[many > 1][:1])}: cells are joined there on one "
                "side and apart on the other; wanted the same nodes on both"
            )
    if any(map(len, lost)):
        counts = [
            f"{len(nodes)} nodes and {len(faces)} faces of {side.name}"
            for side, nodes, faces in zip(sides, alone, lost, strict=True)
        ]
        ring = next(faces[0] for faces in lost if len(faces))
        first = next((f", the first node at {_told(mesh, n[:1])}" for n in alone if len(n)), "")
        raise MeshError(
            f"periodic pairs: {' and '.join(counts)} have no partner on the opposite side{first}, "
            f"the first face about {_told(mesh, ring[ring >= 0])}; wanted sides that are copies "
            "of each other"
        )


def _told(mesh: VolumeMesh, nodes: Indices) -> str:
    point = mesh.points[nodes].mean(axis=0)
    return f"({', '.join(f'{x:.6g}' for x in point)}) {mesh.unit}"
