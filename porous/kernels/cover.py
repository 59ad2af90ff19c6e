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

STEPS = 64
"""Steps towards the smallest ball about others."""

TIGHT = 1 + 1e-9
"""Balls and boxes about others are larger by this against rounding."""

ROOT = 1 + 1e-7
"""Covers the rounding of a root of a cubic that is nearly a double one."""


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
def _about(middles, radii, centre, steps):
    # Each step goes towards the furthest ball: Bădoiu and Clarkson 2003.
    x, y, z = centre[0], centre[1], centre[2]
    for step in range(1, steps + 2):
        radius, furthest = -1.0, 0
        for w in range(len(radii)):
            total = (middles[w, 0] - x) ** 2 + (middles[w, 1] - y) ** 2 + (middles[w, 2] - z) ** 2
            # Roots of the few that are further than all before.
            if radius < radii[w] or total > (radius - radii[w]) ** 2:
                radius, furthest = np.sqrt(total) + radii[w], w
        if step <= steps:
            x += (middles[furthest, 0] - x) / (step + 1)
            y += (middles[furthest, 1] - y) / (step + 1)
            z += (middles[furthest, 2] - z) / (step + 1)
    return x, y, z, radius


@kernel
def _hold(ends, maps, norms, balls, blocks, middles, radii, block):
    # The box about the images of balls and boxes, the images' middles and radii.
    block[:3], block[3:] = np.inf, -np.inf
    for w in range(len(ends)):
        q = ends[w]
        radii[w] = norms[w] * balls[q, 3]
        for a in range(3):
            m0, m1, m2, m3 = maps[w, a, 0], maps[w, a, 1], maps[w, a, 2], maps[w, a, 3]
            middle = m0 * balls[q, 0] + m1 * balls[q, 1] + m2 * balls[q, 2] + m3
            reach = np.sqrt(m0 * m0 + m1 * m1 + m2 * m2) * balls[q, 3]
            other = m0 * blocks[q, 0] + m1 * blocks[q, 1] + m2 * blocks[q, 2] + m3
            across = abs(m0) * blocks[q, 3] + abs(m1) * blocks[q, 4] + abs(m2) * blocks[q, 5]
            middles[w, a] = middle
            block[a] = min(block[a], max(middle - reach, other - across))
            block[a + 3] = max(block[a + 3], min(middle + reach, other + across))
    for a in range(3):
        low, high = block[a], block[a + 3]
        block[a], block[a + 3] = (low + high) / 2, (high - low) / 2 * TIGHT


def held(
    words: tuple[NDArray[np.int64], Floats], norms: Floats, balls: Floats, blocks: Floats
) -> tuple[Floats, Floats]:
    """Return a small ball (4,) and a box (6,) that hold the images of balls and boxes under words.

    Parameters
    ----------
    words
        Their end states (k,) and their maps (k, 3, 4).
    norms
        How far they stretch, at most, (k,).
    balls, blocks
        Of each state, as in a ``System``: balls and boxes that hold the same.
    """
    ends, maps = source(words[0], np.int64), source(words[1], np.float64)
    given = (source(array, np.float64) for array in (norms, balls, blocks))
    middles, radii, block = np.empty((len(ends), 3)), np.empty(len(ends)), np.empty(6)
    _hold(ends, maps, *given, middles, radii, block)
    *centre, radius = _about(middles, radii, block, STEPS)
    return np.array([*centre, radius * TIGHT]), block


@kernel
def _stretches(maps, result):
    # Roots of the largest eigenvalues of MᵀM, in closed form (Smith 1961), of maps made so large
    # that no power of their entries is lost.
    for w in range(len(maps)):
        scale = 0.0
        for p in range(3):
            for q in range(3):
                scale = max(scale, abs(maps[w, p, q]))
        if scale == 0.0:
            result[w] = 0.0
            continue
        a, b, c = maps[w, 0, 0] / scale, maps[w, 0, 1] / scale, maps[w, 0, 2] / scale
        d, e, f = maps[w, 1, 0] / scale, maps[w, 1, 1] / scale, maps[w, 1, 2] / scale
        g, h, i = maps[w, 2, 0] / scale, maps[w, 2, 1] / scale, maps[w, 2, 2] / scale
        xx, yy, zz = a * a + d * d + g * g, b * b + e * e + h * h, c * c + f * f + i * i
        xy, xz, yz = a * b + d * e + g * h, a * c + d * f + g * i, b * c + e * f + h * i
        mean = (xx + yy + zz) / 3
        xx, yy, zz = xx - mean, yy - mean, zz - mean
        spread = np.sqrt((xx * xx + yy * yy + zz * zz + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
        turn = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
        angle = np.arccos(min(max(turn / 2 / spread**3, -1.0), 1.0)) if spread > 0.0 else 0.0
        result[w] = scale * np.sqrt(mean + 2 * spread * np.cos(angle / 3)) * ROOT


def stretches(maps: Floats) -> Floats:
    """Return how far maps (k, 3, 4) stretch at most: bounds on their spectral norms, (k,)."""
    result = np.empty(len(maps))
    _stretches(source(maps, np.float64), result)
    return result


@kernel
def _enclose(m0, m1, m2, m3, balls, blocks, state, low, high):
    # Intersect an axis of a box with those of the ellipsoid and the slanted box which a map, of
    # which this is a row, makes of a ball and a box.
    middle = m0 * balls[state, 0] + m1 * balls[state, 1] + m2 * balls[state, 2] + m3
    reach = np.sqrt(m0 * m0 + m1 * m1 + m2 * m2) * balls[state, 3] + SLACK
    other = m0 * blocks[state, 0] + m1 * blocks[state, 1] + m2 * blocks[state, 2] + m3
    across = abs(m0) * blocks[state, 3] + abs(m1) * blocks[state, 4] + abs(m2) * blocks[state, 5]
    across += SLACK
    return max(low, middle - reach, other - across), min(high, middle + reach, other + across)


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
def _extend(part, a, letter):
    # An axis of a word's map and box, from those of the word without its last letter. Arrays are
    # passed whole: a view of a row is a reference that is counted.
    nodes, boxes, at, parent = part
    maps, child, balls, blocks, state = letter
    m0, m1, m2 = nodes[parent, a, 0], nodes[parent, a, 1], nodes[parent, a, 2]
    n0 = m0 * maps[child, 0, 0] + m1 * maps[child, 1, 0] + m2 * maps[child, 2, 0]
    n1 = m0 * maps[child, 0, 1] + m1 * maps[child, 1, 1] + m2 * maps[child, 2, 1]
    n2 = m0 * maps[child, 0, 2] + m1 * maps[child, 1, 2] + m2 * maps[child, 2, 2]
    n3 = m0 * maps[child, 0, 3] + m1 * maps[child, 1, 3] + m2 * maps[child, 2, 3]
    n3 += nodes[parent, a, 3]
    low, high = boxes[parent, a], boxes[parent, a + 3]
    low, high = _enclose(n0, n1, n2, n3, balls, blocks, state, low, high)
    nodes[at, a, 0], nodes[at, a, 1], nodes[at, a, 2], nodes[at, a, 3] = n0, n1, n2, n3
    boxes[at, a], boxes[at, a + 3] = low, high
    return low, high


@kernel
def _half_diagonal(boxes, at, spacing):
    total = 0.0
    for a in range(3):
        total += (0.5 * max(boxes[at, a + 3] - boxes[at, a], 0.0) * spacing[a]) ** 2
    return np.sqrt(total)


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
            part = nodes, boxes, top, parent
            letter = maps, child, balls, blocks, target
            low, high = _extend(part, 0, letter)
            x0, x1 = _touched(low, high, s0, n0)
            low, high = _extend(part, 1, letter)
            y0, y1 = _touched(low, high, s1, n1)
            low, high = _extend(part, 2, letter)
            z0, z1 = _touched(low, high, s2, n2)
            apart = x0 > x1 or y0 > y1 or z0 > z1
            if apart or _none_left(marks, x0, x1, y0, y1, z0, z1):
                continue
            if first[target] < first[target + 1] and _half_diagonal(boxes, top, spacing) > stop:
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
        for a, row in enumerate(self.root[1]):
            held = _enclose(*row, *self.system[3:5], self.root[0], -np.inf, np.inf)
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
