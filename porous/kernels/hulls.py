"""What holds the attractors of an automaton's states: hulls, boxes and balls."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

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


@kernel
def _cell(state, u, v, w):
    # Where the corners of a direction's cell are in flat hulls, their weights, and its length.
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
    return at, (1.0 - x) * (1.0 - y), (1.0 - x) * y, x * (1.0 - y), x * y, most


@kernel
def _mean(hulls, at, a, b, c, d):
    # Hulls are flat, and read by what cannot be negative: their number of axes, and whether an
    # index counts from the end, would take half the time.
    over = at + np.uint64(2 * CELLS + 2)
    middle = a * hulls[at] + b * hulls[at + np.uint64(2)]
    middle += c * hulls[over] + d * hulls[over + np.uint64(2)]
    half = a * hulls[at + np.uint64(1)] + b * hulls[at + np.uint64(3)]
    return middle, half + c * hulls[over + np.uint64(1)] + d * hulls[over + np.uint64(3)]


@kernel
def support(hulls, state, u, v, w):
    """Return the middle and half of a hull's width along a direction, or of more."""
    # It reaches no further than the mean of the corners of the direction's cell does, being convex.
    at, a, b, c, d, most = _cell(state, u, v, w)
    middle, half = _mean(hulls, at, a, b, c, d)
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
def _begin(first, targets, maps, balls, hulls, cells, weights):
    # Hulls that are balls; along which cells of other hulls parts reach as far, and by what shift.
    at, part = 0, 0
    for state in range(len(balls)):
        for face, i, j in np.ndindex((3, CELLS + 1, CELLS + 1)):
            u, v, w = _direction(face, i, j)
            hulls[at] = u * balls[state, 0] + v * balls[state, 1] + w * balls[state, 2]
            hulls[at + 1] = np.sqrt(u * u + v * v + w * w) * balls[state, 3]
            at += 2
            for t in range(first[state], first[state + 1]):
                cell, a, b, c, d, most = _cell(
                    targets[t],
                    u * maps[t, 0, 0] + v * maps[t, 1, 0] + w * maps[t, 2, 0],
                    u * maps[t, 0, 1] + v * maps[t, 1, 1] + w * maps[t, 2, 1],
                    u * maps[t, 0, 2] + v * maps[t, 1, 2] + w * maps[t, 2, 2],
                )
                cells[part] = cell
                weights[part, 0], weights[part, 1] = a * most, b * most
                weights[part, 2], weights[part, 3] = c * most, d * most
                weights[part, 4] = u * maps[t, 0, 3] + v * maps[t, 1, 3] + w * maps[t, 2, 3]
                part += 1


@kernel
def _narrow(first, balls, hulls, cells, weights):
    # An attractor reaches as far as the furthest of its parts; the largest gain, in radii.
    gain, at, part = 0.0, 0, 0
    for state in range(len(balls)):
        many, most = first[state + 1] - first[state], 0.0
        for _ in range(3 * (CELLS + 1) ** 2):
            middle, half = hulls[at], hulls[at + 1]
            low, high = np.inf, -np.inf
            for p in range(part, part + many):
                a, b, c, d = weights[p, 0], weights[p, 1], weights[p, 2], weights[p, 3]
                other, across = _mean(hulls, cells[p], a, b, c, d)
                other, across = other + weights[p, 4], abs(across)
                low, high = min(low, other - across), max(high, other + across)
            part += many
            low, high = max(low, middle - half), min(high, middle + half)
            hulls[at], hulls[at + 1] = (low + high) / 2, (high - low) / 2
            most = max(most, half - (high - low) / 2)
            at += 2
        if balls[state, 3] > 0.0:
            gain = max(gain, most / balls[state, 3])
    return gain


@kernel
def _about_hulls(hulls, balls, blocks):
    # Boxes and balls about hulls. Between the corners of a cell, a direction is longer than their
    # mean length by at most a quarter of the cell's squared edge.
    each = 6 * (CELLS + 1) ** 2
    for state in range(len(balls)):
        radius, at = 0.0, state * each
        for a in range(3):
            centre = at + ((a * (CELLS + 1) + CELLS // 2) * (CELLS + 1) + CELLS // 2) * 2
            blocks[state, a], blocks[state, a + 3] = hulls[centre], hulls[centre + 1] * TIGHT
        for face, i, j in np.ndindex((3, CELLS + 1, CELLS + 1)):
            u, v, w = _direction(face, i, j)
            middle = u * blocks[state, 0] + v * blocks[state, 1] + w * blocks[state, 2]
            reach = abs(hulls[at] - middle) + hulls[at + 1]
            radius = max(radius, reach / np.sqrt(u * u + v * v + w * w))
            at += 2
        radius *= (1.0 + 1.0 / CELLS**2) * TIGHT
        if radius < balls[state, 3]:
            balls[state, 3] = radius
            for a in range(3):
                balls[state, a] = blocks[state, a]


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
def _fixed(A, x):
    # Of a map that contracts, by Cramer's rule, and once more for what is left.
    for a in range(3):
        x[a] = 0.0
    a, b, c = 1.0 - A[0, 0], -A[0, 1], -A[0, 2]
    d, e, f = -A[1, 0], 1.0 - A[1, 1], -A[1, 2]
    g, h, i = -A[2, 0], -A[2, 1], 1.0 - A[2, 2]
    scale = 1.0 / (a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))
    for _ in range(2):
        u = A[0, 3] - a * x[0] - b * x[1] - c * x[2]
        v = A[1, 3] - d * x[0] - e * x[1] - f * x[2]
        w = A[2, 3] - g * x[0] - h * x[1] - i * x[2]
        x[0] += ((e * i - f * h) * u + (c * h - b * i) * v + (b * f - c * e) * w) * scale
        x[1] += ((f * g - d * i) * u + (a * i - c * g) * v + (c * d - a * f) * w) * scale
        x[2] += ((d * h - e * g) * u + (b * g - a * h) * v + (a * e - b * d) * w) * scale


@kernel
def _point(state, first, targets, maps, path, nodes, point):
    # The fixed point of the cycle that a state's first maps run into, and its image there.
    many, at = 0, 0
    while at == many:
        path[many] = state
        many += 1
        state = targets[first[state]]
        at = 0
        while at < many and path[at] != state:
            at += 1
    nodes[0] = np.eye(3, 4)
    for q in path[at:many]:
        _product(nodes, 0, maps, first[q], nodes, 1)
        nodes[0] = nodes[1]
    _fixed(nodes[0], point)
    x, y, z = point
    for q in path[:at][::-1]:
        m = maps[first[q]]
        x, y, z = (
            m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3],
            m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3],
            m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3],
        )
    point[0], point[1], point[2] = x, y, z


@kernel
def _enclose(first, targets, maps, balls, hulls, blocks, points, gaps):
    many = 3 * (CELLS + 1) ** 2 * len(targets)
    cells, weights = np.empty(many, np.uint64), np.empty((many, 5))
    _begin(first, targets, maps, balls, hulls, cells, weights)
    for _ in range(ROUNDS):
        if _narrow(first, balls, hulls, cells, weights) < NARROW:
            break
    each = 6 * (CELLS + 1) ** 2
    for state in range(len(balls)):
        hulls[state * each + 1 : (state + 1) * each : 2] += (TIGHT - 1.0) * balls[state, 3]
    _about_hulls(hulls, balls, blocks)
    states, nodes = np.empty(max(TRIED, len(balls) + 1), np.int64), np.empty((TRIED + 1, 3, 4))
    for state in range(len(balls)):
        _point(state, first, targets, maps, states, nodes, points[state])
    for state in range(len(balls)):
        given = first, targets, maps, balls, blocks, points
        gaps[state] = _gap(*given, state, states[:TRIED], nodes)


def enclosures(
    first: NDArray[np.int64], targets: NDArray[np.int64], maps: Floats, balls: Floats
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return smaller balls, boxes, points, hulls and gaps of attractors, as of a ``System``.

    An attractor reaches along a direction as far as one of its parts does, which is as far as the
    attractor it is an image of does along another direction: h(u) = max (u·b + h(Aᵀu)). What is
    larger than h stays so under the right side. The points are those of the cycles of first maps.

    Parameters
    ----------
    first, targets, maps
        Of a ``System``: there are maps from every state.
    balls
        Centre and radius of balls that hold the attractors, (s, 4).
    """
    many = len(balls)
    balls = np.array(balls, np.float64)
    hulls, blocks = np.empty((many, 3, CELLS + 1, CELLS + 1, 2)), np.empty((many, 6))
    points, gaps = np.empty((many, 3)), np.empty(many)
    _enclose(first, targets, maps, balls, hulls.reshape(-1), blocks, points, gaps)
    return balls, blocks, points, hulls, gaps
