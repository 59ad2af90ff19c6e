"""Names for the parts of a mesh: the six sides of its box, its skin, its walls, its phases."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError
from porous.values import Part, VolumeMesh
from porous.values.box import SIDES
from porous.values.volume_mesh import PHASE
from porous.values.volume_topology import faces, matched

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.values import Box

    Indices = NDArray[np.int64]

TOLERANCE = 1e-3
"""Nodes closer to a side are on it, relative to the box's longest edge. tetwild keeps to its
surface within about that: at edges of the body it puts nodes up to 9e-4 inside a side, and faces
that lack one of them would leave up to 2 % of the side without load."""

NEAR = 0.2
"""Nodes farther from a side than this part of a typical cell's extent are of another layer."""


def name_parts(mesh: VolumeMesh, box: Box, *, tolerance: float = TOLERANCE) -> VolumeMesh:
    """Return the mesh with parts named after the box that it was made in.

    ``XMIN`` … ``ZMAX`` are the boundary's nodes on each side of the box, ``XMIN_FACES`` …
    ``ZMAX_FACES`` the boundary faces that lie in it; ``SKIN`` are the boundary faces on any side,
    ``WALL`` all the others, ``SOLID`` every cell. Sides that the mesh does not reach have no part.

    Of a mesh with the tag ``"phase"`` ``SOLID`` are the cells where it is 1 and ``PORE`` those
    where it is 0. One of both has no walls: all its boundary is ``SKIN``, and ``INTERFACE`` are
    the faces of solid cells behind which there are pores.

    Parameters
    ----------
    mesh
        Parts it has are kept, but for those of the same names. Nodes in the middle of edges are
        of no side; ``quadratic`` gives them to the sides of the corners.
    box
        In the mesh's unit.
    tolerance
        How far from a side nodes may lie, relative to the box's longest edge; never more than
        ``NEAR`` of a typical cell's extent along that axis.

    Raises
    ------
    MeshError
        For a negative tolerance, or one that makes opposite sides one.
    """
    if not 0 <= tolerance < 0.5:
        raise MeshError(f"tolerance: got {tolerance}; wanted a number from 0 to less than 0.5")
    every = faces(mesh)
    first, second = matched(every)
    outer = np.ones(len(every.members), dtype=bool)
    outer[first] = outer[second] = False
    members, nodes = every.members[outer], every.nodes[outer]
    reach = np.minimum(tolerance * max(box.lengths), NEAR * _cell_extent(mesh))
    parts: dict[str, Part] = {}
    skin = np.zeros(len(members), dtype=bool)
    for index, side in enumerate(SIDES):
        axis, end = divmod(index, 2)
        level = (box.lower, box.upper)[end][axis]
        on = np.abs(mesh.points[:, axis] - level) <= reach[axis]
        inside = (on[nodes] | (nodes < 0)).all(axis=1)
        skin |= inside
        parts[side] = Part("nodes", np.flatnonzero(on & _touched(mesh, nodes)))
        parts[f"{side}_FACES"] = Part("faces", members[inside])
    phases = mesh.cell_tags.get(PHASE, np.ones(mesh.cells, np.int64))
    skin |= len(np.unique(phases)) > 1
    parts["SKIN"] = Part("faces", members[skin])
    parts["WALL"] = Part("faces", members[~skin])
    parts["SOLID"] = Part("cells", np.flatnonzero(phases == 1))
    parts["PORE"] = Part("cells", np.flatnonzero(phases == 0))
    parts["INTERFACE"] = Part("faces", _interface(every.members, (first, second), phases))
    found = {name: part for name, part in parts.items() if len(part.members)}
    kept = {name: part for name, part in mesh.parts.items() if name not in parts}
    return VolumeMesh(mesh.points, mesh.blocks, mesh.cell_tags, {**kept, **found}, mesh.unit)


def _interface(members: Indices, pairs: tuple[Indices, Indices], phases: Indices) -> Indices:
    """Return the faces of cells of phase 1 whose other side is of phase 0, in order."""
    phase = phases[members[:, 0]]
    a, b = (np.concatenate([pairs[i], pairs[1 - i]]) for i in (0, 1))
    return np.asarray(members[np.sort(a[(phase[a] == 1) & (phase[b] == 0)])])


def _cell_extent(mesh: VolumeMesh) -> NDArray[np.float64]:
    """Return the median extent of the cells along x, y and z."""
    extents = [np.ptp(mesh.points[block.cells], axis=1) for block in mesh.blocks]
    return np.asarray(
        np.median(np.concatenate([*extents, np.zeros((int(not extents), 3))]), axis=0)
    )


def _touched(mesh: VolumeMesh, nodes: Indices) -> NDArray[np.bool_]:
    result = np.zeros(len(mesh.points), dtype=bool)
    result[nodes[nodes >= 0]] = True
    return result
