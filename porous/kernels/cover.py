"""Descent of an automaton's words with enclosing boxes: which voxels its attractor can touch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.kernels._shared import all_marked, half_diagonal, kernel, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

BUDGET = 2_000_000
"""Nodes of one call: about a tenth of a second."""

SLACK = 1e-7
"""Boxes are larger by this part of a voxel, so that rounding loses no voxel."""

ASKED = 512
"""Boxes of more voxels are not asked whether all of theirs are marked already."""


class System(NamedTuple):
    """Maps by their source state, and what is known of each state's attractor.

    ``first`` (s + 1,) cuts ``targets`` (t,) and ``maps`` (t, 3, 4), source ← target, by source;
    ``balls`` (s, 4) and ``blocks`` (s, 6), middles and half edges of boxes, hold the attractors,
    ``points`` (s, 3) lie in them.
    """

    first: NDArray[np.int64]
    targets: NDArray[np.int64]
    maps: Floats
    balls: Floats
    blocks: Floats
    points: Floats


@kernel
def _enclose(map_, ball, block, box):
    # Intersect a box with those of the ellipsoid and the slanted box which a map makes of a ball
    # and a box.
    for a in range(3):
        middle = other = map_[a, 3]
        reach = across = 0.0
        for b in range(3):
            middle += map_[a, b] * ball[b]
            reach += map_[a, b] ** 2
            other += map_[a, b] * block[b]
            across += abs(map_[a, b]) * block[b + 3]
        reach = np.sqrt(reach) * ball[3] + SLACK
        across += SLACK
        box[a] = max(box[a], middle - reach, other - across)
        box[a + 3] = min(box[a + 3], middle + reach, other + across)


@kernel
def _touched(box, start, shape, span):
    # The voxels of the window whose closed boxes meet a box; their number.
    count = 1
    for a in range(3):
        low = max(box[a], start[a] - 2.0)
        high = min(box[a + 3], start[a] + shape[a] + 2.0)
        span[a] = max(np.int64(np.ceil(low - 1.0)) - start[a], 0)
        span[a + 3] = min(np.int64(np.floor(high)) - start[a], shape[a] - 1)
        count *= max(span[a + 3] - span[a] + 1, 0)
    return count


@kernel
def _stamp(marks, start, map_, point):
    # Mark the voxel of an attractor's point.
    inside = True
    place = (np.int64(0), np.int64(0), np.int64(0))
    for a in range(3):
        value = map_[a, 3]
        for b in range(3):
            value += map_[a, b] * point[b]
        value = np.floor(value) - start[a]
        inside = inside and value >= 0.0 and value < marks.shape[a]
        if inside:
            place = (place[1], place[2], np.int64(value))
    if inside:
        marks[place] = 1


@kernel
def _descend(
    marks,
    start,
    spacing,
    first,
    targets,
    maps,
    balls,
    blocks,
    points,
    stop,
    whole,
    states,
    nodes,
    boxes,
    span,
    top,
    budget,
):
    # Depth first. A box lies in its parent's, so a node whose voxels are all marked can add none,
    # and what is marked in the end depends neither on the order nor on the window. That is why
    # points are stamped at the ends only: the points of shorter words are those of longer ones, but
    # for rounding.
    steps = 0
    while top > 0 and steps < budget:
        many = first[states[top - 1] + 1] - first[states[top - 1]]
        if top + many > len(states):
            return top, steps, True
        top -= 1
        state = states[top]
        # Its voxels may have been marked since by others.
        if _touched(boxes[top], start, marks.shape, span) <= ASKED and all_marked(marks, span):
            continue
        m = nodes[top]
        m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
        m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
        m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
        b0, b1, b2 = boxes[top, 0], boxes[top, 1], boxes[top, 2]
        b3, b4, b5 = boxes[top, 3], boxes[top, 4], boxes[top, 5]
        steps += many
        for child in range(first[state], first[state + 1]):
            node, box = nodes[top], boxes[top]
            for c in range(4):
                t0, t1, t2 = maps[child, 0, c], maps[child, 1, c], maps[child, 2, c]
                node[0, c] = m00 * t0 + m01 * t1 + m02 * t2
                node[1, c] = m10 * t0 + m11 * t1 + m12 * t2
                node[2, c] = m20 * t0 + m21 * t1 + m22 * t2
            node[0, 3] += m03
            node[1, 3] += m13
            node[2, 3] += m23
            box[0], box[1], box[2], box[3], box[4], box[5] = b0, b1, b2, b3, b4, b5
            target = targets[child]
            _enclose(node, balls[target], blocks[target], box)
            count = _touched(box, start, marks.shape, span)
            if count == 0 or (count <= ASKED and all_marked(marks, span)):
                continue
            if first[target] < first[target + 1] and half_diagonal(box, spacing) > stop:
                states[top] = target
                top += 1
            elif whole:
                marks[span[0] : span[3] + 1, span[1] : span[4] + 1, span[2] : span[5] + 1] = 1
            else:
                _stamp(marks, start, node, points[target])
    return top, steps, False


class Descent:
    """A descent that can be paused: the words that are still to be looked at.

    Parameters
    ----------
    marks
        uint8, shape (nx, ny, nz): what is marked is set to one.
    start
        First voxel of the window in the lattice, (3,).
    spacing
        Edge lengths of a voxel, (3,).
    system
        The automaton, as ``System``.
    root
        The start state and the map (3, 4) of its space to the lattice's voxels.
    """

    def __init__(
        self,
        marks: NDArray[np.uint8],
        start: NDArray[np.int64],
        spacing: Floats,
        system: System,
        root: tuple[int, Floats],
    ) -> None:
        self.marks = marks
        self.given = source(start, np.int64), source(spacing, np.float64)
        self.system = (
            source(system.first, np.int64),
            source(system.targets, np.int64),
            source(system.maps, np.float64),
            source(system.balls, np.float64),
            source(system.blocks, np.float64),
            source(system.points, np.float64),
        )
        self.root = root

    def run(self, stop: float, *, whole: bool, limit: int) -> int:
        """Descend to boxes of half diagonal ``stop``; return the number of words looked at.

        Marks all voxels that the last boxes touch where ``whole``, else the voxels of a point of
        the attractor in each. Returns more than ``limit`` where it gave up there.
        """
        size = 1024
        stack = self._stack(size)
        stack[0][0] = self.root[0]
        stack[1][0] = self.root[1]
        stack[2][0] = [-np.inf] * 3 + [np.inf] * 3
        ball, block = (held[self.root[0]] for held in self.system[3:5])
        _enclose(stack[1][0], ball, block, stack[2][0])
        top, total, span = 1, 0, np.empty(6, np.int64)
        while top and total <= limit:
            top, steps, full = _descend(
                self.marks, *self.given, *self.system, stop, whole, *stack, span, top, BUDGET
            )
            total += steps
            if full:
                size *= 2
                stack = self._grown(stack, size, top)
        return total

    def _stack(self, size: int) -> tuple[NDArray[np.int64], Floats, Floats]:
        # One more map and box than states: the node that is being opened.
        return np.empty(size, np.int64), np.empty((size + 1, 3, 4)), np.empty((size + 1, 6))

    def _grown(self, stack: tuple[Any, ...], size: int, top: int) -> tuple[Any, ...]:
        result = self._stack(size)
        for new, old in zip(result, stack, strict=True):
            new[:top] = old[:top]
        return result
