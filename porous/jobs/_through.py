"""Which pores lead from one side to the opposite one, and how wide they are."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.values import Part
from porous.values.box import SIDES
from porous.values.units import length_ratio
from porous.values.volume_topology import bodies, boundary_faces, extracted, nodes_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from porous.values import VolumeMesh

WIDEST = 8
"""More than any cell has faces."""
NONE = np.zeros((0, 2), np.int64)


class Through(NamedTuple):
    """The pores that lead through, or why none does."""

    mesh: VolumeMesh
    """Cut down to what leads through, or as it was where nothing does."""
    note: str
    """What was left out."""
    why_not: str
    """Empty where something leads through."""


def through(mesh: VolumeMesh, first: str, last: str) -> Through:
    """Return all pores, each joined across faces, that open on both of two sides.

    Several side by side are as good as one. What opens on one of the sides only stays where it
    hangs on a pore that leads through; closed pores, and those that touch in an edge or a point
    only, would leave a solver with a matrix that has no inverse.
    """
    pore = bodies(mesh)
    count = int(pore.max()) + 1
    opening = {side: _opening(mesh, pore, side) for side in (first, last)}
    leading = np.intersect1d(opening[first], opening[last])
    if len(leading):
        kept = np.isin(pore, leading)
        return Through(extracted(mesh, kept), _left_out(count - len(leading), kept), "")
    closed = [side for side in (first, last) if not len(opening[side])]
    if closed:
        return Through(mesh, "", f"no pore opens on {' or '.join(closed)}: nothing can pass")
    return Through(
        mesh,
        "",
        f"no pore leads from {first} to {last}: they fall into {count} that no face joins, and "
        "nothing passes where they touch in an edge or a point; finer voxels may open a passage",
    )


def walled(mesh: VolumeMesh) -> VolumeMesh:
    """Return a mesh that was cut down to a phase, with its parts ``SKIN`` and ``WALL`` named anew.

    Where the other phase was, there are walls now.
    """
    outer = boundary_faces(mesh)
    on = _in_sides(mesh, outer)
    named = {"SKIN": Part("faces", outer[on]), "WALL": Part("faces", outer[~on])}
    return replace(mesh, parts={**mesh.parts, **named})


def wet_area(mesh: VolumeMesh, sides: Iterable[str]) -> float:
    """Return the area of all boundary faces that lie in no side, and of these sides, in mm²."""
    outer = boundary_faces(mesh)
    members = [outer[~_in_sides(mesh, outer)]]
    members += [mesh.parts[f"{side}_FACES"].members for side in sides]
    nodes = nodes_of(mesh, np.concatenate(members))
    corners = mesh.points[np.where(nodes < 0, nodes[:, :1], nodes)]
    across = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    area = np.linalg.norm(across, axis=1).sum() / 2
    return float(area * length_ratio(mesh.unit, "mm") ** 2)


def _in_sides(mesh: VolumeMesh, members: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell of faces, as (cell, local face), whether they lie in a side of the box."""
    named = [mesh.parts[name].members for side in SIDES if (name := f"{side}_FACES") in mesh.parts]
    lying, asked = (rows @ [WIDEST, 1] for rows in (np.concatenate([NONE, *named]), members))
    return np.isin(asked, lying)


def volume(mesh: VolumeMesh) -> float:
    """Return the volume of all cells, in mm³."""
    return float(mesh.volumes.sum() * length_ratio(mesh.unit, "mm") ** 3)


def _opening(mesh: VolumeMesh, pore: NDArray[np.int64], side: str) -> NDArray[np.int64]:
    part = mesh.parts.get(f"{side}_FACES")
    return np.zeros(0, np.int64) if part is None else np.unique(pore[part.members[:, 0]])


def _left_out(count: int, kept: NDArray[np.bool_]) -> str:
    if not count:
        return ""
    cells = int((~kept).sum())
    return f"pores left out, for they do not lead through: {count}, of {cells} cells"
