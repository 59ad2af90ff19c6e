"""Whether what was solved is a block that fills a box, so that its numbers are a material's."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.values.box import SIDES

if TYPE_CHECKING:
    from porous.values import Box, VolumeMesh

TOLERANCE = 1e-3
"""How far nodes may lie from the plane of their side, relative to the longest edge: what
``name_parts`` admits."""


def is_flat(mesh: VolumeMesh, side: str) -> bool:
    """Tell whether all nodes of a side lie in one plane across its axis."""
    level = mesh.points[mesh.parts[side].members, SIDES.index(side) // 2]
    return bool(np.ptp(level) <= 2 * TOLERANCE * np.ptp(mesh.points, axis=0).max())


def why_no_block(mesh: VolumeMesh, box: Box) -> str:
    """Return why a body is no block between the sides of a box; empty where it is.

    Its sides are: all nodes of every side that the mesh names are to lie in the box's own. Those
    of a bent block are faces of its level-0 cell, tilted or curved; it has neither a length nor an
    area that forces and flows could be divided by.

    Parameters
    ----------
    mesh
        With parts of nodes ``XMIN`` … ``ZMAX``, or some of them.
    box
        The body with its pores, in the mesh's unit.
    """
    reach = TOLERANCE * max(box.lengths)
    for index, side in enumerate(SIDES):
        if side not in mesh.parts or not len(mesh.parts[side].members):
            continue
        axis, end = divmod(index, 2)
        apart = mesh.points[mesh.parts[side].members, axis] - (box.lower, box.upper)[end][axis]
        if (far := float(np.abs(apart).max())) > reach:
            return (
                f"its side {side} is not that of its box, a node lies {far:.3g} {mesh.unit} off: a "
                "body that is bent, twisted or round has no length and area to divide by"
            )
    return ""
