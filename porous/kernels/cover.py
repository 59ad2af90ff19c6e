"""Descent of an automaton's words with enclosing boxes: which voxels its attractor can touch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, source
from porous.kernels.candidates import EVERY, SMALL, any_left, left, mark, mark_one, near, within
from porous.kernels.hulls import support

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

BUDGET = 2_000_000
"""Nodes of one call: about a tenth of a second."""

SLACK = 1e-7
"""Boxes are larger by this part of a voxel, so that rounding loses no voxel."""

TINY = 1e-100
"""Faces of no area have no direction, and their slabs part nothing."""

ROOM = 1024
"""Words that there is room for, before there are more."""

FAR = 1.4
"""Boxes are last ones, too, of which no point is further from one of the attractor's points than so
many ``stop``: the bound allows two, but so it marks about as few voxels as by half diagonals."""


class System(NamedTuple):
    """Maps by their source state, and what is known of each state's attractor.

    ``first`` (s + 1,) cuts ``targets`` (t,) and ``maps`` (t, 3, 4), source ← target, by source;
    ``balls`` (s, 4), ``blocks`` (s, 6), middles and half edges of boxes, and ``hulls`` (s, 3, c, c,
    2) hold the attractors, ``points`` (s, 3) lie in them; ``gaps`` (s,) is from a block's middle to
    the nearest of its attractor's points, or more. All are as ``_shared.source`` returns them.

    A hull says the middle and half of its width along each direction of which one component is one
    and the other two, in their order, are corners of cells of −1 … 1.
    """

    first: NDArray[np.int64]
    targets: NDArray[np.int64]
    maps: Floats
    balls: Floats
    blocks: Floats
    points: Floats
    hulls: Floats
    gaps: Floats


@kernel
def _block(row, blocks, state, low, high):
    # Intersect an axis of a box with that of a block's image under a map: quickly, before that of
    # a hull's, for most words can be dropped by this alone.
    u, v, w, middle = row
    middle += u * blocks[state, 0] + v * blocks[state, 1] + w * blocks[state, 2]
    half = abs(u) * blocks[state, 3] + abs(v) * blocks[state, 4] + abs(w) * blocks[state, 5]
    return max(low, middle - half - SLACK), min(high, middle + half + SLACK)


@kernel
def _enclose(row, hulls, state, low, high):
    # Intersect an axis of a box with that of a hull's image under a map, of which this is a row.
    middle, half = support(hulls, state, row[0], row[1], row[2])
    middle += row[3]
    return max(low, middle - half - SLACK), min(high, middle + half + SLACK)


@kernel
def _touched(low, high, start, size):
    # The first and the last of a window's voxels along an axis that meet a closed interval.
    first = np.int64(np.ceil(max(low, start - 2.0) - 1.0)) - start
    last = np.int64(np.floor(min(high, start + size + 2.0))) - start
    return max(first, 0), min(last, size - 1)


@kernel
def _span(box, start, shape):
    # The window's voxels that a box meets.
    x0, x1 = _touched(box[0], box[3], start[0], shape[0])
    y0, y1 = _touched(box[1], box[4], start[1], shape[1])
    z0, z1 = _touched(box[2], box[5], start[2], shape[2])
    return x0, x1, y0, y1, z0, z1


@kernel
def _is_empty(span):
    return span[0] > span[1] or span[2] > span[3] or span[4] > span[5]


@kernel
def _is_small(box):
    return box[3] - box[0] < SMALL and box[4] - box[1] < SMALL and box[5] - box[2] < SMALL


@kernel
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def _square(a):
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]


@kernel
def _unit(a):
    scale = 1.0 / max(np.sqrt(_square(a)), TINY)
    return a[0] * scale, a[1] * scale, a[2] * scale


@kernel
def _slab(n, rows, hulls, state):
    # A direction, the middle and half of a hull's image's width along it.
    u, v, w = n
    x, y, z = rows
    a = u * x[0] + v * y[0] + w * z[0]
    b = u * x[1] + v * y[1] + w * z[1]
    c = u * x[2] + v * y[2] + w * z[2]
    middle, half = support(hulls, state, a, b, c)
    return u, v, w, middle + u * x[3] + v * y[3] + w * z[3], half


@kernel
def _slabs(rows, blocks, hulls, state):
    # What an image is thin along: across its largest face, and across that one's longest edge.
    x, y, z = rows
    h, i, j = blocks[state, 3], blocks[state, 4], blocks[state, 5]
    a, b, c = (
        (x[0] * h, y[0] * h, z[0] * h),
        (x[1] * i, y[1] * i, z[1] * i),
        (x[2] * j, y[2] * j, z[2] * j),
    )
    face, other, third = _cross(b, c), _cross(c, a), _cross(a, b)
    face = other if _square(other) > _square(face) else face
    face = _unit(third if _square(third) > _square(face) else face)
    edge = b if _square(b) > _square(a) else a
    edge = c if _square(c) > _square(edge) else edge
    side = _unit(_cross(face, edge))
    return _slab(face, rows, hulls, state), _slab(side, rows, hulls, state)


@kernel
def _middle(nodes, at, a, blocks, state):
    value = nodes[at, a, 3] + nodes[at, a, 0] * blocks[state, 0]
    return value + nodes[at, a, 1] * blocks[state, 1] + nodes[at, a, 2] * blocks[state, 2]


@kernel
def _stamp(marks, free, shift, corner, rows, points, state):
    # Mark the voxel of an attractor's point.
    x, y, z = rows
    u, v, w = points[state, 0], points[state, 1], points[state, 2]
    i = np.int64(np.floor(x[0] * u + x[1] * v + x[2] * w + x[3])) - corner[0]
    j = np.int64(np.floor(y[0] * u + y[1] * v + y[2] * w + y[3])) - corner[1]
    k = np.int64(np.floor(z[0] * u + z[1] * v + z[2] * w + z[3])) - corner[2]
    inside = i >= 0 and j >= 0 and k >= 0
    if inside and i < marks.shape[0] and j < marks.shape[1] and k < marks.shape[2]:
        mark_one(marks, free, shift, i, j, k)


@kernel
def _row(nodes, at, a):
    return nodes[at, a, 0], nodes[at, a, 1], nodes[at, a, 2], nodes[at, a, 3]


@kernel
def _longer(row, maps, child):
    # A row of the map of a word with one more letter. Arrays are passed whole, each by itself, and
    # to what neither loops nor calls on: views of rows, members of tuples and arrays of all else
    # are references that are counted.
    u, v, w, shift = row
    return (
        u * maps[child, 0, 0] + v * maps[child, 1, 0] + w * maps[child, 2, 0],
        u * maps[child, 0, 1] + v * maps[child, 1, 1] + w * maps[child, 2, 1],
        u * maps[child, 0, 2] + v * maps[child, 1, 2] + w * maps[child, 2, 2],
        u * maps[child, 0, 3] + v * maps[child, 1, 3] + w * maps[child, 2, 3] + shift,
    )


@kernel
def _in_blocks(rows, blocks, state, box):
    x0, x1 = _block(rows[0], blocks, state, box[0], box[3])
    y0, y1 = _block(rows[1], blocks, state, box[1], box[4])
    z0, z1 = _block(rows[2], blocks, state, box[2], box[5])
    return x0, y0, z0, x1, y1, z1


@kernel
def _in_hulls(rows, hulls, state, box):
    x0, x1 = _enclose(rows[0], hulls, state, box[0], box[3])
    y0, y1 = _enclose(rows[1], hulls, state, box[1], box[4])
    z0, z1 = _enclose(rows[2], hulls, state, box[2], box[5])
    return x0, y0, z0, x1, y1, z1


@kernel
def _box(boxes, at):
    return boxes[at, 0], boxes[at, 1], boxes[at, 2], boxes[at, 3], boxes[at, 4], boxes[at, 5]


@kernel
def _put(nodes, boxes, at, rows, box):
    x, y, z = rows
    nodes[at, 0, 0], nodes[at, 0, 1], nodes[at, 0, 2], nodes[at, 0, 3] = x
    nodes[at, 1, 0], nodes[at, 1, 1], nodes[at, 1, 2], nodes[at, 1, 3] = y
    nodes[at, 2, 0], nodes[at, 2, 1], nodes[at, 2, 2], nodes[at, 2, 3] = z
    boxes[at, 0], boxes[at, 1], boxes[at, 2], boxes[at, 3], boxes[at, 4], boxes[at, 5] = box


@kernel
def _open(states, nodes, boxes, masks, state, hulls):
    # The empty word, of which the map is there.
    everywhere = -np.inf, -np.inf, -np.inf, np.inf, np.inf, np.inf
    rows = _row(nodes, 0, 0), _row(nodes, 0, 1), _row(nodes, 0, 2)
    states[0], masks[0] = state, EVERY
    _put(nodes, boxes, 0, rows, _in_hulls(rows, hulls, state, everywhere))


@kernel
def _ends(nodes, boxes, at, spacing, blocks, gaps, state, stop, whole):
    # Whether no point of a box is further than twice ``stop`` from a point of the attractor in it:
    # from any where its half diagonal is not more than ``stop``, or from one near the image of the
    # block's middle.
    half, far, reach = 0.0, 0.0, 0.0
    for a in range(3):
        half += (0.5 * (boxes[at, a + 3] - boxes[at, a]) * spacing[a]) ** 2
    if half <= stop * stop or not whole or half > (FAR * stop) ** 2:
        return half <= stop * stop
    for a in range(3):
        middle = _middle(nodes, at, a, blocks, state)
        far += (max(boxes[at, a + 3] - middle, middle - boxes[at, a]) * spacing[a]) ** 2
        gap = nodes[at, a, 0] ** 2 + nodes[at, a, 1] ** 2 + nodes[at, a, 2] ** 2
        reach += gap * spacing[a] ** 2
    return np.sqrt(far) + gaps[state] * np.sqrt(reach) <= FAR * stop


@kernel
def _descend(
    marks,
    start,
    spacing,
    first,
    targets,
    maps,
    blocks,
    points,
    hulls,
    gaps,
    stop,
    whole,
    states,
    nodes,
    boxes,
    masks,
    free,
    made,
    top,
    budget,
):
    # Depth first. A box lies in its parent's, and of a small box's voxels those are candidates that
    # are its parent's or, where that one's is not small, that no slab about its part of the
    # attractor parts from it. So a node whose candidates are all marked can add none, and what is
    # marked in the end depends neither on the order nor on the window. That is why points are
    # stamped at the ends only: the points of shorter words are those of longer ones, but for
    # rounding.
    steps, parent = 0, len(states)
    shape, corner = marks.shape, (start[0], start[1], start[2])
    shift = corner[0] & 7, corner[1] & 7, corner[2] & 7
    while top > 0 and steps < budget:
        many = first[states[top - 1] + 1] - first[states[top - 1]]
        if top + many > len(states):
            return top, steps, True
        top -= 1
        state, outer = states[top], _box(boxes, top)
        span, narrow = _span(outer, corner, shape), _is_small(outer)
        # Its voxels may have been marked since by others.
        if narrow:
            more = left(marks, free, made, shift, span, masks, top, parent)
        else:
            more = any_left(marks, free, made, shift, span)
        if not more:
            continue
        x_row, y_row, z_row = _row(nodes, top, 0), _row(nodes, top, 1), _row(nodes, top, 2)
        steps += many
        for child in range(first[state], first[state + 1]):
            target = targets[child]
            rows = (
                _longer(x_row, maps, child),
                _longer(y_row, maps, child),
                _longer(z_row, maps, child),
            )
            box = _in_blocks(rows, blocks, target, outer)
            span = _span(box, corner, shape)
            if _is_empty(span):
                continue
            if narrow:
                more = within(shift, span, masks, parent, top)
            else:
                more = any_left(marks, free, made, shift, span)
            if not more:
                continue
            box = _in_hulls(rows, hulls, target, box)
            span = _span(box, corner, shape)
            if _is_empty(span):
                continue
            if narrow:
                more = within(shift, span, masks, top, top)
            else:
                more = any_left(marks, free, made, shift, span)
            if not more:
                continue
            if not narrow and _is_small(box):
                first_slab, second_slab = _slabs(rows, blocks, hulls, target)
                if not near(shift, corner, span, masks, top, first_slab, second_slab):
                    continue
            _put(nodes, boxes, top, rows, box)
            if not _ends(nodes, boxes, top, spacing, blocks, gaps, target, stop, whole):
                states[top] = target
                top += 1
            elif whole:
                mark(marks, free, shift, span, masks, top)
            else:
                _stamp(marks, free, shift, corner, rows, points, target)
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
            system.first,
            system.targets,
            system.maps,
            system.blocks,
            system.points,
            system.hulls.reshape(-1),
            system.gaps,
        )
        self.root = root
        self.top = 0

    def run(self, stop: float, *, whole: bool, limit: int) -> int:
        """Descend to boxes of half diagonal ``stop``; return the number of words looked at.

        Marks the voxel of a point of the attractor in each of the last boxes. Where ``whole``, all
        voxels that they touch; boxes are then the last ones, too, of which no point is further than
        ``FAR`` times ``stop`` from some point of the attractor: ``stop`` is not larger than a voxel
        there. Returns more than ``limit`` where it gave up; called again, it goes on from there.
        """
        if not self.top:
            self.stack = self._stack(ROOM)
            self.stack[1][0] = self.root[1]
            _open(*self.stack, self.root[0], self.system[5])
            self.top = 1
        total, known = 0, self._unread()
        while self.top and total <= limit:
            budget = min(BUDGET, limit + 1 - total)
            self.top, steps, full = _descend(
                self.marks,
                *self.given,
                *self.system,
                stop,
                whole,
                *self.stack,
                *known,
                self.top,
                budget,
            )
            total += steps
            if full:
                self._grow()
        return total

    def _unread(self) -> tuple[NDArray[np.uint64], NDArray[np.uint8]]:
        # Blocks of voxels whose marks have not been read. Places in them are the lattice's.
        ends = zip(self.marks.shape, self.given[0].tolist(), strict=True)
        blocks = tuple((many + start % 8 + 3) // 4 for many, start in ends)
        return np.empty(blocks, np.uint64), np.zeros(blocks, np.uint8)

    def _stack(self, size: int) -> tuple[NDArray[Any], ...]:
        # One more mask than states: that of the word that is being opened.
        return (
            np.empty(size, np.int64),
            np.empty((size, 3, 4)),
            np.empty((size, 6)),
            np.empty((size + 1, 8), np.uint64),
        )

    def _grow(self) -> None:
        larger = self._stack(2 * len(self.stack[0]))
        for new, old in zip(larger, self.stack, strict=True):
            new[: self.top] = old[: self.top]
        self.stack = larger
