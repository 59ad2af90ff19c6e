"""Cells of branching trees: a trunk from the root to a node, and subtrees from the node to the top.

A tree's cell is a pyramid: the quadrilateral that it bears and the root that it stands on. The
node n = h·(mean of the top's corners) + (1 − h)·root ends the trunk; N × N subtrees stand on it and
divide the top as a bilinear face is divided. The trunk is terminal: drawn, never refined.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.models.brep import (
    Adjacency,
    Boundary,
    BRep,
    CellState,
    Child,
    Incidence,
    selection,
)
from porous.models.builders import Options, build_cell
from porous.models.digits import DigitSet

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

APEX = 4
"""The root among the controls of a tree; those before it are the top's corners, 2a + b."""

TRUNK = "trunk"

FIRST = np.zeros((1, 3), np.int64)
"""One digit: boundaries have all their children whatever a hexahedron keeps."""

CONTROLS = np.array([[0, 0, 1, 1, 0.5], [0, 1, 0, 1, 0.5], [1, 1, 1, 1, 0]])
"""Reference controls (3, 5): the unit cube's top, and the middle of its bottom."""


def tree_cells(branches: Sequence[int], heights: Sequence[float]) -> BRep:
    """Return a tree's cell with its boundaries, level by level.

    Parameters
    ----------
    branches
        N of the N × N subtrees of each level; the last holds below.
    heights
        h of each level: the node's share of the way from the root to the top; the last holds
        below.

    Raises
    ------
    ModelError
        For fewer than two branches along an axis, or heights that are not between 0 and 1.
    """
    _check(branches, heights)
    levels = max(len(branches), len(heights))
    counts = [branches[min(k, len(branches) - 1)] for k in range(levels)]
    shares = [heights[min(k, len(heights) - 1)] for k in range(levels)]
    # The faces, edges and vertices are those of hexahedra; the trees take their cells' place.
    boxes = build_cell(Options("hex-8", tuple(DigitSet(n, FIRST) for n in counts)))
    face = {s.name: q for q, s in enumerate(boxes.states)}
    rest = boxes.states[levels:]
    trunk, vertex = len(boxes.states), len(boxes.states) - 1
    trees = [
        _tree(k, boxes, face["face" + str(k) * (levels > 1)], shares[k], trunk)
        for k in range(levels)
    ]
    return BRep((*trees, *rest, _trunk(vertex)))


def _tree(level: int, boxes: BRep, face: int, height: float, trunk: int) -> CellState:
    """Return the state of the trees of a level; the states of all levels come first."""
    top, vertex = boxes.states[face], len(boxes.states) - 1
    below = boxes.states[level].children[0].state
    node = np.append(np.full(APEX, height / APEX), 1 - height)
    subtrees = [
        Child(part.name, below, np.column_stack([_lifted(part.guess), node]))
        for part in top.children
    ]
    own = [Boundary("TOP", face, selection(5, range(APEX)))]
    own += [Boundary(b.name, b.state, _lifted(b.matrix)) for b in top.boundaries]
    own += [Boundary("ROOT", vertex, selection(5, [APEX]))]
    root, last = len(own) - 1, len(subtrees)
    return CellState(
        boxes.states[level].name.replace("cell", "tree"),
        "pyramid",
        CONTROLS,
        tuple(own),
        (*subtrees, Child(TRUNK, trunk, np.column_stack([np.eye(5)[APEX], node]))),
        (*(Incidence(i, 0, 0, i) for i in range(last)), Incidence(last, 0, root, 0)),
        tuple(Adjacency(i, root, last, 1) for i in range(last)),
    )


def _lifted(weights: Floats) -> Floats:
    """Return weights of the top's corners as weights of the tree's controls."""
    return np.vstack([weights, np.zeros(weights.shape[1])])


def _trunk(vertex: int) -> CellState:
    ends = [Boundary(n, vertex, selection(2, [i])) for i, n in enumerate(("START", "END"))]
    return CellState(TRUNK, "edge", np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 1.0]]), tuple(ends))


def _check(branches: Sequence[int], heights: Sequence[float]) -> None:
    whole = all(isinstance(n, int | np.integer) and not isinstance(n, bool) for n in branches)
    if not branches or not whole or min(branches) < 2:
        raise ModelError(
            f"branches: got {list(branches)}; wanted whole numbers N from 2, of N × N branches"
        )
    if not heights or not all(0 < h < 1 for h in heights):
        raise ModelError(
            f"heights: got {list(heights)}; wanted parts of the way to the top, above 0, below 1"
        )
