"""Attractors whose parts overlap: a point of theirs per cell, and voxels sought backwards."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

BUDGET = 2_000_000
"""Images or words of one call: about a tenth of a second."""

SLACK = 1e-7
"""Boxes and distances are larger by this part of a voxel, so that rounding loses no voxel."""

STEPS = 64
"""Steps towards the smallest ball about others."""

TIGHT = 1 + 1e-9
"""Balls and boxes about others are larger by this against rounding."""

DEPTH = 256
"""Places on the stack for each map."""


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
        Of each state, as in ``kernels.cover.System``: balls and boxes that hold the same.
    """
    ends, maps = source(words[0], np.int64), source(words[1], np.float64)
    given = (source(array, np.float64) for array in (norms, balls, blocks))
    middles, radii, block = np.empty((len(ends), 3)), np.empty(len(ends)), np.empty(6)
    _hold(ends, maps, *given, middles, radii, block)
    *centre, radius = _about(middles, radii, block, STEPS)
    return np.array([*centre, radius * TIGHT]), block


@kernel
def _spread(index, points, maps, low, edge, head, tail, budget):
    # Each point's images found cells that have none yet, until all have been asked.
    ny, nz = index.shape[1], index.shape[2]
    steps = 0
    while head < tail and steps < budget:
        x, y, z = points[head, 0], points[head, 1], points[head, 2]
        head += 1
        steps += len(maps)
        for m in range(len(maps)):
            p = maps[m, 0, 0] * x + maps[m, 0, 1] * y + maps[m, 0, 2] * z + maps[m, 0, 3]
            q = maps[m, 1, 0] * x + maps[m, 1, 1] * y + maps[m, 1, 2] * z + maps[m, 1, 3]
            r = maps[m, 2, 0] * x + maps[m, 2, 1] * y + maps[m, 2, 2] * z + maps[m, 2, 3]
            i = min(max(np.int64((p - low[0]) / edge), 0), index.shape[0] - 1)
            j = min(max(np.int64((q - low[1]) / edge), 0), ny - 1)
            k = min(max(np.int64((r - low[2]) / edge), 0), nz - 1)
            if index[i, j, k] < 0:
                index[i, j, k] = tail
                points[tail, 0], points[tail, 1], points[tail, 2] = p, q, r
                tail += 1
    return head, tail


def spread(maps: Floats, first: Floats, low: Floats, edge: float, shape: tuple[int, ...]) -> Floats:
    """Return one point (n, 3) of an attractor for each cell that its points' images reach.

    Parameters
    ----------
    maps
        Shape (m, 3, 4).
    first
        A point of the attractor, (3,).
    low, edge, shape
        The grid of cubic cells: its lower corner, their edge and numbers. It holds the attractor.
    """
    index = np.full(shape, -1, np.int32)
    points = np.empty((index.size, 3))
    points[0] = first
    cell = np.clip(((first - low) / edge).astype(np.int64), 0, np.array(shape) - 1)
    index[tuple(cell)] = 0
    given = source(maps, np.float64)
    corner = source(low, np.float64)
    head, tail = 0, 1
    while head < tail:
        head, tail = _spread(index, points, given, corner, edge, head, tail, BUDGET)
    return points[:tail].copy()


class Reference(NamedTuple):
    """An attractor in coordinates that suit its maps: points of it, and how far all else is.

    ``turn`` (3, 3) takes the world to these coordinates. ``maps`` (m, 3, 4) are invertible
    contractions there; ``ball`` (4,) is centre and radius of a ball that holds the attractor.
    ``distance`` (nx, ny, nz) float32 is from the centres of cubic cells of edge ``edge``, the first
    of them at ``low``, to the nearest of ``points`` (n, 3), but for ``doubt``; ``nearest`` int32
    says which one that is about.
    """

    turn: Floats
    maps: Floats
    ball: Floats
    low: Floats
    edge: float
    distance: NDArray[np.float32]
    nearest: NDArray[np.int32]
    points: Floats
    doubt: float


@kernel
def _far(y, radius, low, edge, distance, doubt, ball):
    # Whether no point of the attractor is within a radius of y; the cell that y is in, or -1.
    total = 0.0
    for a in range(3):
        total += (y[a] - ball[a]) ** 2
    if total > (ball[3] + radius) ** 2:
        return True, -1, -1, -1
    i = np.int64(np.floor((y[0] - low[0]) / edge))
    j = np.int64(np.floor((y[1] - low[1]) / edge))
    k = np.int64(np.floor((y[2] - low[2]) / edge))
    inside = i >= 0 and j >= 0 and k >= 0
    inside = inside and i < distance.shape[0] and j < distance.shape[1] and k < distance.shape[2]
    if not inside:
        return False, -1, -1, -1
    return distance[i, j, k] - doubt > radius, i, j, k


@kernel
def _touches(centre, half, turned, maps, inverses, grows, ball, reference, stop, stack):
    # Whether the attractor touches a voxel: words are sought backwards from it. Of a point of the
    # attractor in the voxel, the images under the inverses are points of the attractor too: so
    # where none is near the voxel's own image, no longer word leads there. Places and radii are in
    # the coordinates that suit the maps, nodes lead from these to the world.
    low, edge, distance, nearest, points, doubt = reference
    turn, back, first = turned
    places, radii, nodes = stack
    many = len(maps)
    here = np.empty((3, 4))
    y = np.empty(3)
    top, steps = 1, 0
    radii[0] = first
    for a in range(3):
        places[0, a] = turn[a, 0] * centre[0] + turn[a, 1] * centre[1] + turn[a, 2] * centre[2]
        nodes[0, a, :3] = back[a]
        nodes[0, a, 3] = 0.0
    while top > 0:
        top -= 1
        steps += 1
        radius = radii[top]
        y[:] = places[top]
        far, i, j, k = _far(y, radius, low, edge, distance, doubt, ball)
        if far:
            continue
        here[:, :] = nodes[top]
        size, apart = 0.0, False
        for a in range(3):
            middle = here[a, 3]
            reach = 0.0
            for b in range(3):
                middle += here[a, b] * ball[b]
                reach += here[a, b] ** 2
            reach = np.sqrt(reach) * ball[3]
            size += reach**2
            apart = apart or abs(middle - centre[a]) > half[a] * (1.0 + SLACK) + reach
        if apart:
            continue
        if size <= stop * stop:
            return True, steps
        if i >= 0:
            near = nearest[i, j, k]
            inside = True
            for a in range(3):
                value = here[a, 3] - centre[a]
                for b in range(3):
                    value += here[a, b] * points[near, b]
                inside = inside and abs(value) <= half[a]
            if inside:
                return True, steps
        if top + many > len(radii):
            return True, -1
        for m in range(many):
            for a in range(3):
                place = inverses[m, a, 3]
                for b in range(3):
                    place += inverses[m, a, b] * y[b]
                places[top, a] = place
                for c in range(4):
                    value = here[a, 3] if c == 3 else 0.0
                    for b in range(3):
                        value += here[a, b] * maps[m, b, c]
                    nodes[top, a, c] = value
            radii[top] = radius * grows[m]
            top += 1
    return False, steps


@kernel
def _seek(
    marks,
    origin,
    spacing,
    turned,
    maps,
    inverses,
    grows,
    ball,
    reference,
    stop,
    stack,
    voxel,
    budget,
):
    # Voxels that are marked already are passed by.
    shape = marks.shape
    steps = 0
    centre, half = np.empty(3), np.empty(3)
    for a in range(3):
        half[a] = spacing[a] / 2
    while voxel < marks.size and steps < budget:
        i, rest = divmod(voxel, shape[1] * shape[2])
        j, k = divmod(rest, shape[2])
        voxel += 1
        if marks[i, j, k]:
            continue
        centre[0] = origin[0] + (i + 0.5) * spacing[0]
        centre[1] = origin[1] + (j + 0.5) * spacing[1]
        centre[2] = origin[2] + (k + 0.5) * spacing[2]
        found, more = _touches(
            centre, half, turned, maps, inverses, grows, ball, reference, stop, stack
        )
        if more < 0:
            return voxel, -1
        steps += 1 + more
        if found:
            marks[i, j, k] = 1
    return voxel, steps


def seek(
    marks: NDArray[np.uint8],
    origin: Floats,
    spacing: Floats,
    reference: Reference,
    *,
    stop: float,
    limit: int,
) -> int:
    """Mark every voxel that an attractor touches, and none further than 2 ``stop`` from it.

    Parameters
    ----------
    marks
        uint8, shape (nx, ny, nz): those set are not asked.
    origin, spacing
        The lower corner of the window and edge lengths of its voxels, (3,).
    reference
        Of the attractor.
    stop
        Half diagonal of the parts at which a touch is taken for granted.
    limit
        Number of words after which to give up.

    Returns
    -------
    The number of words looked at; more than ``limit`` where it gave up.
    """
    turn, maps, ball, low, edge, distance, nearest, points, doubt = reference
    linear = np.linalg.inv(maps[:, :, :3])
    shift = -np.einsum("mab,mb->ma", linear, maps[:, :, 3])
    inverses = np.concatenate([linear, shift[:, :, None]], axis=2)
    grows = np.linalg.norm(linear, 2, axis=(1, 2)) * (1 + SLACK)
    size = DEPTH * len(maps)
    stack = (np.empty((size, 3)), np.empty(size), np.empty((size, 3, 4)))
    known = (
        source(low, np.float64),
        float(edge),
        source(distance, np.float32),
        source(nearest, np.int32),
        source(points, np.float64),
        float(doubt),
    )
    corners = np.array(list(product((-0.5, 0.5), repeat=3))) * spacing
    radius = float(np.linalg.norm(corners @ turn.T, axis=1).max()) * (1 + SLACK)
    turned = source(turn, np.float64), source(np.linalg.inv(turn), np.float64), radius
    window = source(origin, np.float64), source(spacing, np.float64)
    given = [source(array, np.float64) for array in (maps, inverses, grows, ball)]
    voxel, total = 0, 0
    while voxel < marks.size and total <= limit:
        voxel, steps = _seek(marks, *window, turned, *given, known, stop, stack, voxel, BUDGET)
        total = limit + 1 if steps < 0 else total + steps
    return total
