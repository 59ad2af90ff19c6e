"""Descent of cells with control points: which voxels their limit can touch, whatever the weights.

A cell's part of the limit is the image of its state's, row·y + offset for each axis, where y are
weights in coordinates of which intervals are known. Transitions multiply rows from the right. A
fourth row, where there is one, is the divisor of the other three (rational controls).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.kernels._shared import all_marked, half_diagonal, kernel, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

BUDGET = 200_000
"""Cells of one call: some tenths of a second."""

SLACK = 1e-7
"""Boxes are larger by this part of a voxel, so that rounding loses no voxel."""

ASKED = 512
"""Boxes of more voxels are not asked whether all of theirs are marked already."""

ROOM = 1024
"""Cells that a stack has room for at first, and those of one batch of cells with ends."""


class Weighed(NamedTuple):
    """Maps of weights by their source state, and what is known of each state's limit.

    ``first`` (s + 1,) cuts ``targets`` (t,) and ``maps`` (t, n, n + 2) by source: matrices, shifts
    and bounds on their errors. ``middles`` and ``halves`` (s, n) are the intervals of the limits,
    ``points`` (s, n) lie in them. ``ended`` (s,) tells which states have children that end, and
    ``reach`` (s,) how far beyond its box such a child may mark voxels, in units of length.
    """

    first: Indices
    targets: Indices
    maps: Floats
    middles: Floats
    halves: Floats
    points: Floats
    ended: Indices
    reach: Floats


@kernel
def _value(row, y):
    # row·y + offset.
    result = row[len(y)]
    for b in range(len(y)):
        result += row[b] * y[b]
    return result


@kernel
def _enclose(node, middle, half, box):
    # Intersect a box with that of the image of intervals; errors are in the node's last column.
    # With a divisor w > 0, x/w is within (x − c·w's reach)/(least w) of c, the quotient in the
    # middle. Where w may be zero nothing is known.
    n = len(middle)
    divided = node.shape[0] > 3
    divisor = least = 1.0
    if divided:
        divisor = _value(node[3], middle)
        least = divisor - node[3, n + 1] - SLACK * abs(divisor)
        for b in range(n):
            least -= abs(node[3, b]) * half[b]
        if not least > 0.0:
            return
    for a in range(3):
        centre = _value(node[a], middle) / divisor
        reach = node[a, n + 1]
        if divided:
            reach += abs(centre) * node[3, n + 1]
        for b in range(n):
            way = node[a, b]
            if divided:
                way -= centre * node[3, b]
            reach += abs(way) * half[b]
        reach = reach / least + SLACK
        box[a] = max(box[a], centre - reach)
        box[a + 3] = min(box[a + 3], centre + reach)


@kernel
def _refine(parent, map_, node):
    # The child's rows, offset and errors.
    n = map_.shape[0]
    for a in range(parent.shape[0]):
        node[a, :] = 0.0
        node[a, n] = parent[a, n]
        node[a, n + 1] = parent[a, n + 1]
        for c in range(n):
            weight = parent[a, c]
            if weight != 0.0:
                for b in range(n + 1):
                    node[a, b] += weight * map_[c, b]
                node[a, n + 1] += abs(weight) * map_[c, n + 1]


@kernel
def _touched(box, more, spacing, start, shape, span):
    # The voxels of the window whose closed boxes meet a box that is grown; their number.
    count = 1
    for a in range(3):
        low = max(box[a] - more / spacing[a], start[a] - 2.0)
        high = min(box[a + 3] + more / spacing[a], start[a] + shape[a] + 2.0)
        span[a] = max(np.int64(np.ceil(low - 1.0)) - start[a], 0)
        span[a + 3] = min(np.int64(np.floor(high)) - start[a], shape[a] - 1)
        count *= max(span[a + 3] - span[a] + 1, 0)
    return count


@kernel
def _stamp(marks, start, node, point):
    # Mark the voxel of a point of the limit.
    divisor = _value(node[3], point) if node.shape[0] > 3 else 1.0
    inside = divisor > 0.0
    place = (np.int64(0), np.int64(0), np.int64(0))
    for a in range(3):
        value = np.floor(_value(node[a], point) / divisor) - start[a] if inside else -1.0
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
    middles,
    halves,
    points,
    ended,
    reach,
    stop,
    whole,
    states,
    nodes,
    boxes,
    span,
    found,
    owners,
    top,
    budget,
):
    # Depth first. A box lies in its parent's, so a cell whose voxels are all marked can add none,
    # and what is marked in the end depends neither on the order nor on the window. That is why
    # points are stamped at the ends only. Cells that are opened and have children that end are
    # written down.
    steps = taken = 0
    while top > 0 and steps < budget and taken < len(found):
        state = states[top - 1]
        many = first[state + 1] - first[state]
        if top + many > len(states):
            return top, steps, taken, True
        top -= 1
        steps += 1
        more = reach[state] if whole else 0.0
        count = _touched(boxes[top], more, spacing, start, marks.shape, span)
        if count == 0 or (count <= ASKED and all_marked(marks, span)):
            continue
        if half_diagonal(boxes[top], spacing) <= stop:
            if whole:
                _touched(boxes[top], 0.0, spacing, start, marks.shape, span)
                marks[span[0] : span[3] + 1, span[1] : span[4] + 1, span[2] : span[5] + 1] = 1
            else:
                _stamp(marks, start, nodes[top], points[state])
            continue
        parent, outer = nodes[len(states)], boxes[len(states)]
        parent[:, :], outer[:] = nodes[top], boxes[top]
        if whole and ended[state]:
            found[taken] = parent
            owners[taken] = state
            taken += 1
        for child in range(first[state], first[state + 1]):
            _refine(parent, maps[child], nodes[top])
            boxes[top, :] = outer
            _enclose(nodes[top], middles[targets[child]], halves[targets[child]], boxes[top])
            states[top] = targets[child]
            top += 1
    return top, steps, taken, False


class Descent:
    """Descents of cells that mark voxels one after the other.

    Parameters
    ----------
    marks
        uint8, shape (nx, ny, nz): what is marked is set to one.
    start
        First voxel of the window in the lattice, (3,).
    spacing
        Edge lengths of a voxel, (3,).
    weighed
        The maps of weights.
    roots
        Of each level-0 cell its state, and its rows, offset and errors (3, n + 2) in the lattice's
        voxels; (4, n + 2) with a divisor.
    """

    def __init__(
        self,
        marks: NDArray[np.uint8],
        start: Indices,
        spacing: Floats,
        weighed: Weighed,
        roots: list[tuple[int, Floats]],
    ) -> None:
        self.marks = marks
        self.given = source(start, np.int64), source(spacing, np.float64)
        self.weighed = tuple(source(field, field.dtype) for field in weighed)
        self.known = source(weighed.middles, np.float64), source(weighed.halves, np.float64)
        self.roots = roots
        self.opened: list[tuple[Indices, Floats]] = []

    def run(self, stop: float, *, whole: bool, limit: int) -> int:
        """Descend to boxes of half diagonal ``stop``; return the number of cells looked at.

        Marks all voxels that the last boxes touch where ``whole``, and writes down in ``opened``
        the states and rows of larger cells with children that end; else the voxels of a point of
        the limit in each. Returns more than ``limit`` where it gave up there.
        """
        size = max(ROOM, len(self.roots))
        stack = self._stack(size)
        for place, (state, rows) in enumerate(self.roots):
            stack[0][place], stack[1][place] = state, rows
            stack[2][place] = [-np.inf] * 3 + [np.inf] * 3
            _enclose(stack[1][place], *(part[state] for part in self.known), stack[2][place])
        found, owners = np.empty((ROOM, *self.roots[0][1].shape)), np.empty(ROOM, np.int64)
        top, total, span = len(self.roots), 0, np.empty(6, np.int64)
        while top and total <= limit:
            top, steps, taken, full = _descend(
                self.marks,
                *self.given,
                *self.weighed,
                stop,
                whole,
                *stack,
                span,
                found,
                owners,
                top,
                BUDGET,
            )
            total += steps
            if taken:
                self.opened.append((owners[:taken].copy(), found[:taken].copy()))
            if full:
                size *= 2
                stack = self._grown(stack, size, top)
        return total

    def _stack(self, size: int) -> tuple[Indices, Floats, Floats]:
        # One more cell than states: the one that is being opened.
        rows = self.roots[0][1].shape
        return np.empty(size, np.int64), np.empty((size + 1, *rows)), np.empty((size + 1, 6))

    def _grown(self, stack: tuple[Any, ...], size: int, top: int) -> tuple[Any, ...]:
        result = self._stack(size)
        for new, old in zip(result, stack, strict=True):
            new[:top] = old[:top]
        return result
