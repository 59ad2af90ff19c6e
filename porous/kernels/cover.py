"""Descent of an automaton's words with enclosing boxes: which voxels its attractor can touch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

BUDGET = 2_000_000
"""Nodes of one call: about a tenth of a second."""

SLACK = 1e-7
"""Boxes are larger by this part of a voxel, so that rounding loses no voxel."""

ASKED = 512
"""Boxes of more voxels are not asked whether all of theirs are marked already."""

FAR = 1.4
"""Boxes are last ones, too, of which no point is further from one of the attractor's points than so
many ``stop``: the bound allows two, but so it marks about as few voxels as by half diagonals."""

CELLS = 8
"""Hulls are known along the corners of so many cells squared, on each of three faces of a cube."""

ROUNDS = 32
NARROW = 5e-3
"""Steps that narrow hulls, at most, and what part of a ball's radius the last one gained."""

GRAIN = 64
TRIED = 2048
"""The distance of a hull's middle from points is known to a radius over this, or after so many."""

TIGHT = 1 + 1e-9
"""Balls and boxes about others are larger by this against rounding."""


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
def _support(hulls, state, u, v, w):
    # The middle and half of a hull's width along a direction, or of more: it reaches no further
    # than the mean of the corners of the direction's cell does, being convex. Hulls are flat, and
    # read by what cannot be negative: their number of axes, and whether an index counts from the
    # end, would take half the time.
    x, y, z = abs(u), abs(v), abs(w)
    first, second = x >= y and x >= z, y >= z
    face = 0 if first else (1 if second else 2)
    most = u if first else (v if second else w)
    p = v if first else u
    q = w if first or second else v
    scale = 1.0 / most if most != 0.0 else 0.0
    x, y = (p * scale + 1.0) * (CELLS / 2), (q * scale + 1.0) * (CELLS / 2)
    i, j = min(np.int64(x), CELLS - 1), min(np.int64(y), CELLS - 1)
    x, y = x - i, y - j
    at = np.uint64((((state * 3 + face) * (CELLS + 1) + i) * (CELLS + 1) + j) * 2)
    over = at + np.uint64(2 * CELLS + 2)
    a, b, c, d = (1.0 - x) * (1.0 - y), (1.0 - x) * y, x * (1.0 - y), x * y
    middle = a * hulls[at] + b * hulls[at + np.uint64(2)]
    middle += c * hulls[over] + d * hulls[over + np.uint64(2)]
    half = a * hulls[at + np.uint64(1)] + b * hulls[at + np.uint64(3)]
    half += c * hulls[over + np.uint64(1)] + d * hulls[over + np.uint64(3)]
    return most * middle, abs(most) * half


@kernel
def _direction(face, i, j):
    p, q = 2.0 * i / CELLS - 1.0, 2.0 * j / CELLS - 1.0
    if face == 0:
        return 1.0, p, q
    if face == 1:
        return p, 1.0, q
    return p, q, 1.0


@kernel
def _begin(balls, hulls):
    # Hulls that are balls.
    for state, face, i, j in np.ndindex(hulls.shape[:4]):
        u, v, w = _direction(face, i, j)
        middle = u * balls[state, 0] + v * balls[state, 1] + w * balls[state, 2]
        hulls[state, face, i, j, 0] = middle
        hulls[state, face, i, j, 1] = np.sqrt(u * u + v * v + w * w) * balls[state, 3]


@kernel
def _narrow(first, targets, maps, balls, hulls, flat, result):
    # An attractor reaches as far as the furthest of its parts; the largest gain, in radii.
    gain = 0.0
    for state, face, i, j in np.ndindex(hulls.shape[:4]):
        u, v, w = _direction(face, i, j)
        middle, half = hulls[state, face, i, j, 0], hulls[state, face, i, j, 1]
        low, high = np.inf, -np.inf
        for t in range(first[state], first[state + 1]):
            a = u * maps[t, 0, 0] + v * maps[t, 1, 0] + w * maps[t, 2, 0]
            b = u * maps[t, 0, 1] + v * maps[t, 1, 1] + w * maps[t, 2, 1]
            c = u * maps[t, 0, 2] + v * maps[t, 1, 2] + w * maps[t, 2, 2]
            shift = u * maps[t, 0, 3] + v * maps[t, 1, 3] + w * maps[t, 2, 3]
            other, across = _support(flat, targets[t], a, b, c)
            low, high = min(low, shift + other - across), max(high, shift + other + across)
        low, high = max(low, middle - half), min(high, middle + half)
        result[state, face, i, j, 0] = (low + high) / 2
        result[state, face, i, j, 1] = (high - low) / 2
        if balls[state, 3] > 0.0:
            gain = max(gain, (half - (high - low) / 2) / balls[state, 3])
    return gain


@kernel
def _about_hulls(hulls, balls, blocks):
    # Boxes and balls about hulls. Between the corners of a cell, a direction is longer than their
    # mean length by at most a quarter of the cell's squared edge.
    for state in range(len(hulls)):
        radius = 0.0
        for a in range(3):
            blocks[state, a] = hulls[state, a, CELLS // 2, CELLS // 2, 0]
            blocks[state, a + 3] = hulls[state, a, CELLS // 2, CELLS // 2, 1] * TIGHT
        for face, i, j in np.ndindex(hulls.shape[1:4]):
            u, v, w = _direction(face, i, j)
            middle = u * blocks[state, 0] + v * blocks[state, 1] + w * blocks[state, 2]
            reach = abs(hulls[state, face, i, j, 0] - middle) + hulls[state, face, i, j, 1]
            radius = max(radius, reach / np.sqrt(u * u + v * v + w * w))
        radius *= (1.0 + 1.0 / CELLS**2) * TIGHT
        if radius < balls[state, 3]:
            balls[state, 3] = radius
            for a in range(3):
                balls[state, a] = blocks[state, a]


@kernel
def _enclosures(first, targets, maps, balls, blocks, hulls, flat, work):
    _begin(balls, hulls)
    for _ in range(ROUNDS):
        gain = _narrow(first, targets, maps, balls, hulls, flat, work)
        hulls[:] = work
        if gain < NARROW:
            break
    for state, face, i, j in np.ndindex(hulls.shape[:4]):
        hulls[state, face, i, j, 1] += (TIGHT - 1.0) * balls[state, 3]
    _about_hulls(hulls, balls, blocks)


def enclosures(
    first: NDArray[np.int64], targets: NDArray[np.int64], maps: Floats, balls: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return smaller balls (s, 4), boxes (s, 6) and hulls of attractors, as of a ``System``.

    An attractor reaches along a direction as far as one of its parts does, which is as far as the
    attractor it is an image of does along another direction: h(u) = max (u·b + h(Aᵀu)). What is
    larger than h stays so under the right side.

    Parameters
    ----------
    first, targets, maps
        Of a ``System``.
    balls
        Centre and radius of balls that hold the attractors, (s, 4).
    """
    balls = np.array(balls, np.float64)
    blocks, hulls = np.empty((len(balls), 6)), np.empty((len(balls), 3, CELLS + 1, CELLS + 1, 2))
    given = first, targets, maps, balls, blocks, hulls
    _enclosures(*given, hulls.reshape(-1), np.empty_like(hulls))
    return balls, blocks, hulls


@kernel
def _product(nodes, at, maps, child, result, made):
    for a in range(3):
        for c in range(4):
            value = nodes[at, a, 3] if c == 3 else 0.0
            for b in range(3):
                value += nodes[at, a, b] * maps[child, b, c]
            result[made, a, c] = value


@kernel
def _far(nodes, at, points, state, goals, goal):
    # From the image of a point, or of a ball's or a block's middle, to a goal.
    total = 0.0
    for a in range(3):
        value = nodes[at, a, 3] - goals[goal, a]
        for b in range(3):
            value += nodes[at, a, b] * points[state, b]
        total += value * value
    return np.sqrt(total)


@kernel
def _gap(first, targets, maps, balls, blocks, points, goal, states, nodes):
    # Depth first, parts that are nearer than the best point so far by a quarter of a grain.
    room, tried, top = len(states), 0, 1
    states[0], nodes[0] = goal, np.eye(3, 4)
    best = _far(nodes, 0, points, goal, blocks, goal)
    grain = balls[goal, 3] / GRAIN
    while top > 0 and tried < TRIED:
        top -= 1
        state = states[top]
        for a in range(3):
            for c in range(4):
                nodes[room, a, c] = nodes[top, a, c]
        for child in range(first[state], first[state + 1]):
            target, total = targets[child], 0.0
            _product(nodes, room, maps, child, nodes, top)
            tried += 1
            for a in range(3):
                for b in range(3):
                    total += nodes[top, a, b] ** 2
            near = _far(nodes, top, balls, target, blocks, goal) - np.sqrt(total) * balls[target, 3]
            best = min(best, _far(nodes, top, points, target, blocks, goal))
            if near < best - grain / 4 and top < room - 1:
                states[top] = target
                top += 1
    # Up to a whole grain, so that it does not depend on where the search ended.
    return max(best, np.ceil(best / grain - 1e-6) * grain) if grain > 0.0 else best


@kernel
def _gaps(first, targets, maps, balls, blocks, points, gaps, states, nodes):
    for state in range(len(gaps)):
        gaps[state] = _gap(first, targets, maps, balls, blocks, points, state, states, nodes)


def gaps(first: NDArray[np.int64], targets: NDArray[np.int64], *known: Floats) -> Floats:
    """Return how far at most the middles of blocks are from the attractors, (s,).

    Parameters
    ----------
    first, targets
        Of a ``System``.
    known
        Its maps, balls, blocks and points.
    """
    result = np.empty(len(first) - 1)
    _gaps(first, targets, *known, result, np.empty(TRIED, np.int64), np.empty((TRIED + 1, 3, 4)))
    return result


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
    middle, half = _support(hulls, state, row[0], row[1], row[2])
    middle += row[3]
    return max(low, middle - half - SLACK), min(high, middle + half + SLACK)


@kernel
def _touched(low, high, start, size):
    # The first and the last of a window's voxels along an axis that meet a closed interval.
    first = np.int64(np.ceil(max(low, start - 2.0) - 1.0)) - start
    last = np.int64(np.floor(min(high, start + size + 2.0))) - start
    return max(first, 0), min(last, size - 1)


@kernel
def _none_left(marks, x0, x1, y0, y1, z0, z1):
    # Whether all voxels of a span are marked, if it is one of not too many.
    if (x1 - x0 + 1) * (y1 - y0 + 1) * (z1 - z0 + 1) > ASKED:
        return False
    for i in range(x0, x1 + 1):
        for j in range(y0, y1 + 1):
            for k in range(z0, z1 + 1):
                if marks[i, j, k] == 0:
                    return False
    return True


@kernel
def _middle(nodes, at, a, blocks, state):
    value = nodes[at, a, 3] + nodes[at, a, 0] * blocks[state, 0]
    return value + nodes[at, a, 1] * blocks[state, 1] + nodes[at, a, 2] * blocks[state, 2]


@kernel
def _mark(marks, x0, x1, y0, y1, z0, z1):
    for i in range(x0, x1 + 1):
        for j in range(y0, y1 + 1):
            for k in range(z0, z1 + 1):
                marks[i, j, k] = 1


@kernel
def _stamp(marks, start, nodes, at, points, state):
    # Mark the voxel of an attractor's point.
    inside = True
    place = (np.int64(0), np.int64(0), np.int64(0))
    for a in range(3):
        value = nodes[at, a, 3]
        for b in range(3):
            value += nodes[at, a, b] * points[state, b]
        value = np.floor(value) - start[a]
        inside = inside and value >= 0.0 and value < marks.shape[a]
        if inside:
            place = (place[1], place[2], np.int64(value))
    if inside:
        marks[place] = 1


@kernel
def _row(nodes, at, a, maps, child):
    # A row of the map of a word with one more letter. Arrays are passed whole, each by itself, and
    # to what neither loops nor calls on: views of rows, members of tuples and arrays of all else
    # are references that are counted.
    m0, m1, m2 = nodes[at, a, 0], nodes[at, a, 1], nodes[at, a, 2]
    n3 = m0 * maps[child, 0, 3] + m1 * maps[child, 1, 3] + m2 * maps[child, 2, 3]
    return (
        m0 * maps[child, 0, 0] + m1 * maps[child, 1, 0] + m2 * maps[child, 2, 0],
        m0 * maps[child, 0, 1] + m1 * maps[child, 1, 1] + m2 * maps[child, 2, 1],
        m0 * maps[child, 0, 2] + m1 * maps[child, 1, 2] + m2 * maps[child, 2, 2],
        n3 + nodes[at, a, 3],
    )


@kernel
def _put(nodes, boxes, at, a, row, low, high):
    nodes[at, a, 0], nodes[at, a, 1], nodes[at, a, 2], nodes[at, a, 3] = row
    boxes[at, a], boxes[at, a + 3] = low, high


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
    top,
    budget,
):
    # Depth first. A box lies in its parent's, so a node whose voxels are all marked can add none,
    # and what is marked in the end depends neither on the order nor on the window. That is why
    # points are stamped at the ends only: the points of shorter words are those of longer ones, but
    # for rounding.
    steps, parent = 0, len(states)
    s0, s1, s2 = start[0], start[1], start[2]
    n0, n1, n2 = marks.shape
    while top > 0 and steps < budget:
        many = first[states[top - 1] + 1] - first[states[top - 1]]
        if top + many > len(states):
            return top, steps, True
        top -= 1
        state = states[top]
        # Its voxels may have been marked since by others.
        x0, x1 = _touched(boxes[top, 0], boxes[top, 3], s0, n0)
        y0, y1 = _touched(boxes[top, 1], boxes[top, 4], s1, n1)
        z0, z1 = _touched(boxes[top, 2], boxes[top, 5], s2, n2)
        if _none_left(marks, x0, x1, y0, y1, z0, z1):
            continue
        for a in range(3):  # out of its children's way
            for c in range(4):
                nodes[parent, a, c] = nodes[top, a, c]
            boxes[parent, a], boxes[parent, a + 3] = boxes[top, a], boxes[top, a + 3]
        steps += many
        for child in range(first[state], first[state + 1]):
            target = targets[child]
            x_row = _row(nodes, parent, 0, maps, child)
            low, high = boxes[parent, 0], boxes[parent, 3]
            x_low, x_high = _block(x_row, blocks, target, low, high)
            x0, x1 = _touched(x_low, x_high, s0, n0)
            y_row = _row(nodes, parent, 1, maps, child)
            low, high = boxes[parent, 1], boxes[parent, 4]
            y_low, y_high = _block(y_row, blocks, target, low, high)
            y0, y1 = _touched(y_low, y_high, s1, n1)
            z_row = _row(nodes, parent, 2, maps, child)
            low, high = boxes[parent, 2], boxes[parent, 5]
            z_low, z_high = _block(z_row, blocks, target, low, high)
            z0, z1 = _touched(z_low, z_high, s2, n2)
            apart = x0 > x1 or y0 > y1 or z0 > z1
            if apart or _none_left(marks, x0, x1, y0, y1, z0, z1):
                continue
            low, high = _enclose(x_row, hulls, target, x_low, x_high)
            _put(nodes, boxes, top, 0, x_row, low, high)
            x0, x1 = _touched(low, high, s0, n0)
            low, high = _enclose(y_row, hulls, target, y_low, y_high)
            _put(nodes, boxes, top, 1, y_row, low, high)
            y0, y1 = _touched(low, high, s1, n1)
            low, high = _enclose(z_row, hulls, target, z_low, z_high)
            _put(nodes, boxes, top, 2, z_row, low, high)
            z0, z1 = _touched(low, high, s2, n2)
            apart = x0 > x1 or y0 > y1 or z0 > z1
            if apart or _none_left(marks, x0, x1, y0, y1, z0, z1):
                continue
            if not _ends(nodes, boxes, top, spacing, blocks, gaps, target, stop, whole):
                states[top] = target
                top += 1
            elif whole:
                _mark(marks, x0, x1, y0, y1, z0, z1)
            else:
                _stamp(marks, start, nodes, top, points, target)
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

    def run(self, stop: float, *, whole: bool, limit: int) -> int:
        """Descend to boxes of half diagonal ``stop``; return the number of words looked at.

        Marks the voxel of a point of the attractor in each of the last boxes. Where ``whole``, all
        voxels that they touch; boxes are then the last ones, too, of which no point is further than
        ``FAR`` times ``stop`` from some point of the attractor. Returns more than ``limit`` where
        it gave up there.
        """
        size = 1024
        stack = self._stack(size)
        stack[0][0] = self.root[0]
        stack[1][0] = self.root[1]
        for a, row in enumerate(self.root[1]):
            held = _enclose(tuple(map(float, row)), self.system[5], self.root[0], -np.inf, np.inf)
            stack[2][0, a], stack[2][0, a + 3] = held
        top, total = 1, 0
        while top and total <= limit:
            top, steps, full = _descend(
                self.marks, *self.given, *self.system, stop, whole, *stack, top, BUDGET
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
