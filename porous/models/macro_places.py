"""Where the cells of a macro mesh lie: which faces are sides of the body, and what cannot be."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.models.automaton import product
from porous.models.cell_folds import corner_weights
from porous.models.rational import positions
from porous.values.box import SIDES

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.models.cell_nodes import CellNodes
    from porous.models.macro import Sharing
    from porous.models.solve import Solution

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

SAME = 1e-9
"""Points closer than this part of the body's extent to a plane, or a line, lie in it."""


def side_names(sharing: Sharing, solution: Solution, controls: Floats) -> dict[int, str]:
    """Return what outer faces are called that lie in a side of the box of all corners.

    By their numbers, in the order of ``Sharing.outer``: XMIN, …, ZMAX. What is mixed of controls in
    a plane lies in it, whatever the weights.
    """
    brep = sharing.brep
    corners = [
        positions(product(group.points, corner_weights(solution, brep.reached[group.state])))
        for group in sharing.mesh.roots(brep, controls)
    ]
    spots = np.concatenate([np.moveaxis(own, 1, 0).reshape(3, -1) for own in corners], axis=1)
    box = np.stack([spots.min(axis=1), spots.max(axis=1)], axis=1)
    reach = SAME * float(np.ptp(box, axis=1).max())
    places = positions(controls)
    result = {}
    for number, (_, face) in enumerate(sharing.outer):
        gaps = np.abs(places[:, list(face.controls), None] - box[:, None]).max(axis=1)
        on = np.flatnonzero(gaps.ravel() <= reach)
        if len(on):
            result[number] = SIDES[on[0]]
    return result


def check_places(nodes: CellNodes) -> None:
    """Raise ``ModelError`` for level-0 cells that are folded, or in front of their own neighbours.

    Seen from outside, the cells on both sides of a face run round it in opposite ways.

    Parameters
    ----------
    nodes
        Those of level 0.
    """
    nodes = nodes.unfolded
    loops, cells = _loops(nodes)
    first, second = nodes.pairs
    # A loop that is run the other way has each of its edges turned round.
    many = (loops >= 0).sum(axis=1, keepdims=True)
    step = np.take_along_axis(loops, (np.arange(loops.shape[1]) + 1) % many, axis=1)
    edges = loops * len(nodes.points) + step, step * len(nodes.points) + loops
    for table in edges:
        table[loops < 0] = -1
    alike = (np.sort(edges[0][first], axis=1) != np.sort(edges[1][second], axis=1)).any(axis=1)
    if alike.any():
        bad = int(np.flatnonzero(alike)[0])
        one, other = cells[first[bad]], cells[second[bad]]
        raise ModelError(
            f"cells: {one} and {other} lie on the same side of the face that they share, for one "
            "is inverted or they overlap; wanted cells side by side"
        )


def _loops(nodes: CellNodes) -> tuple[Indices, Indices]:
    """Return the vertices of all sides, counter-clockwise from outside, and their cells."""
    sides = np.arange(len(nodes.sides))
    cells = np.empty(len(sides), np.int64)
    loops = np.empty((len(sides), nodes.groups[0].cut.loops.shape[2]), np.int64)
    for group, _, which, cell, face in nodes.split(sides):
        loop = group.cut.loops[group.variant[cell], face]
        loops[which] = np.where(loop < 0, -1, group.corners[cell[:, None], loop])
        cells[which] = group.place[cell]
    return loops, cells


def check_hanging(sharing: Sharing, controls: Floats) -> None:
    """Raise ``ModelError`` for a corner that lies within a straight edge of another cell."""
    places = positions(controls)
    reach = SAME * float(np.ptp(places, axis=1).max())
    skin = {e for _, face in sharing.outer for e in sharing.inner(face.users[0])}
    kinds = sharing.brep.states
    points = [sharing.entities[s][n].controls for s, n in skin if kinds[s].dimension == 0]
    if any(len(own) > 1 for own in points):
        return  # corners are mixed of several controls each
    corners = np.array(sorted(own[0] for own in points))
    for s, n in sorted(e for e in skin if kinds[e[0]].dimension == 1):
        edge = np.array(sharing.entities[s][n].controls)
        ends = places[:, edge[np.isin(edge, corners)]].T
        if not _lies_on(places[:, edge].T, ends, reach).all():
            continue
        others = np.setdiff1d(corners, edge)
        hanging = others[_lies_on(places[:, others].T, ends, reach)]
        if len(hanging):
            raise ModelError(
                f"cells: control {hanging[0]} is a corner, but lies within an edge of cell "
                f"{sharing.entities[s][n].users[0].cell} that has no corner there: faces do not "
                "match; wanted cells that meet in whole faces"
            )


def _lies_on(points: Floats, ends: Floats, reach: float) -> NDArray[np.bool_]:
    """Tell which points (n, 3) lie on the segment between two ends (2, 3)."""
    way = ends[1] - ends[0]
    share = np.clip((points - ends[0]) @ way / (way @ way), 0, 1)
    return np.asarray(np.linalg.norm(points - ends[0] - share[:, None] * way, axis=1) <= reach)
