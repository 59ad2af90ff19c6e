"""Lengths of shortest paths through a mask, from its first layer on.

Fast marching (J. A. Sethian, PNAS 93, 1996) on all 26 neighbours: the front is taken as flat over
each of the 48 right-angled simplices about a voxel, as far as their corners are in the mask, so
that it is exact for flat fronts in any direction. A voxel waits at the place that its neighbours
one by one would give it, which is late by a tenth of a step at most, and is worked out when its
turn comes. All that it may depend on is earlier by half a step, so that buckets a quarter wide need
no order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Axes = tuple[bool, bool, bool]
    Progress = Callable[[int, int], None]

BATCH = 1 << 17
"""Voxels that one kernel call works out, at most."""

WIDTH = 0.25
"""Width of a bucket, in units of the shortest edge of a voxel."""


STRIDES = (9, 3, 1)
"""Steps along the axes in an array of 27 voxels, of which number 13 is the middle."""

FACES = np.array([(13 + s * STRIDES[a], a) for a in range(3) for s in (-1, 1)])
"""Neighbours across faces and their axis, shape (6, 2)."""

TURNS = np.array(
    [
        [
            (
                f + s * STRIDES[b],
                f + t * STRIDES[3 - a - b],
                f + s * STRIDES[b] + t * STRIDES[3 - a - b],
            )
            for b in [(a + 1) % 3]
            for s in (-1, 1)
            for t in (-1, 1)
        ]
        for f, a in FACES.tolist()
    ]
)
"""About each of these the four corners: the edges next to it, along the next axis and the one after
that, and the corner, shape (6, 4, 3)."""

EDGES = np.array(
    [
        (e, e - STRIDES[c], e + STRIDES[c], c)
        for c in range(3)
        for s in (-1, 1)
        for t in (-1, 1)
        for e in [13 + s * STRIDES[(c + 1) % 3] + t * STRIDES[(c + 2) % 3]]
    ]
)
"""Neighbours across edges, the corners next to each and their axis, shape (12, 4)."""


def path_lengths(
    mask: NDArray[np.bool_],
    spacing: tuple[float, float, float],
    *,
    periodic: tuple[bool, bool] = (False, False),
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """Return how long the shortest way is to each voxel of a mask from the plane below it.

    Parameters
    ----------
    mask
        bool, shape (x, y, z). Ways begin anywhere on the lower side of its first layer along x, and
        lead from voxel to voxel over faces, edges and corners.
    spacing
        Edges of a voxel.
    periodic
        Whether the grid closes on itself along y and z.
    progress
        Called as ``progress(done, count)`` in voxels; raising in it cancels.

    Returns
    -------
    float64, shape (y, z): lengths to the centres of the last layer's voxels, infinite where no way
    leads.
    """
    ratios = np.array(spacing, np.float64) / spacing[0]
    padded = np.pad(mask, 1)
    # What waits has its key, what is done its time less than zero, and solid is never done.
    times = np.where(padded.reshape(-1), np.inf, -np.inf)
    links = np.full((times.size, 2), -1, np.int32)
    per = 1 / (WIDTH * float(ratios.min()))
    heads = np.full(1 << int(np.sqrt((ratios**2).sum()) * per + 3).bit_length(), -1, np.int32)
    state = np.zeros(2, np.int64)  # the bucket whose turn it is, and how many voxels wait
    shape = np.array(padded.shape, np.int64)
    lattice = (shape, np.array(periodic, np.int64), ratios, per)
    _begin(times, shape, per, links, heads, state)
    total, worked = int(np.count_nonzero(mask)), 0
    while state[1]:
        worked += int(_march(times, *lattice, links, heads, state, BATCH))
        if progress is not None:
            progress(worked, total)
    last = times.reshape(padded.shape)[-2, 1:-1, 1:-1]
    result: NDArray[np.float64] = np.where(last < 0, -last, np.inf) * spacing[0]
    return result


@kernel
def _insert(v, bucket, links, heads, state):
    after = heads[bucket]
    links[v, 0], links[v, 1] = -1, after
    if after >= 0:
        links[after, 0] = v
    heads[bucket] = v
    state[1] += 1


@kernel
def _remove(v, bucket, links, heads, state):
    before, after = links[v, 0], links[v, 1]
    if before >= 0:
        links[before, 1] = after
    else:
        heads[bucket] = after
    if after >= 0:
        links[after, 0] = before
    state[1] -= 1


@kernel
def _begin(times, shape, per, links, heads, state):
    layer = shape[1] * shape[2]
    state[0] = np.int64(0.5 * per)
    for v in range(layer, 2 * layer):
        if times[v] > 0.0:
            times[v] = 0.5
            _insert(v, state[0] & (len(heads) - 1), links, heads, state)


@kernel
def _turn(v, shape, wraps, out):
    # Of the 27 voxels about a voxel of a grid with a border those at the other end of it.
    ny, nz = shape[1], shape[2]
    if wraps[0]:
        j = v // nz % ny
        for a in range(3):
            for c in range(3):
                if j == 1:
                    out[9 * a + c] += (ny - 2) * nz
                if j == ny - 2:
                    out[9 * a + 6 + c] -= (ny - 2) * nz
    if wraps[1]:
        k = v % nz
        for row in range(9):
            if k == 1:
                out[3 * row] += nz - 2
            if k == nz - 2:
                out[3 * row + 2] -= nz - 2


@kernel
def _edge(near, far, across, along, best):
    # Where a flat front gets to that passes two corners of a right triangle, from the one whose leg
    # ``along`` leads here, where it comes from between them. The legs are told by their squares.
    if near > far:
        slope = (near - far) ** 2
        if slope * (across + along) <= across * across:
            return min(best, near + np.sqrt(along * (1.0 - slope / across)))
    return best


@kernel
def _flat(first, second, third, squares, best):
    # Where a flat front gets to that passes three corners of a right-angled simplex, the last one
    # first, where it comes from between them. The legs are told by their squares.
    a, b, c = squares
    if second < first and third < second:
        p, q = (first - second) ** 2 / b, (second - third) ** 2 / c
        if (1.0 - p - q) * b >= p * a and p * c >= q * b:
            return min(best, first + np.sqrt(a * (1.0 - p - q)))
    return best


@kernel
def _arrive(times, best, squares):
    # The earliest that a front gets to the middle of 27 voxels, from the 48 simplices about it,
    # whose corners are at the ends of a, a + b and a + b + c, and from their sides. No front gets
    # there from what is later itself.
    for n in range(6):
        f, one = FACES[n, 0], FACES[n, 1]
        first = times[f]
        if first < best:
            a, b, c = squares[one], squares[(one + 1) % 3], squares[(one + 2) % 3]
            for m in range(4):
                left, right = times[TURNS[n, m, 0]], times[TURNS[n, m, 1]]
                corner = times[TURNS[n, m, 2]]
                if m & 1 == 0:
                    best = _edge(first, left, b, a, best)
                if m < 2:
                    best = _edge(first, right, c, a, best)
                if corner < first:
                    best = _edge(first, corner, b + c, a, best)
                    best = _flat(first, left, corner, (a, b, c), best)
                    best = _flat(first, right, corner, (a, c, b), best)
    for n in range(12):
        second = times[EDGES[n, 0]]
        if second < best:
            c = squares[EDGES[n, 3]]
            along = squares[0] + squares[1] + squares[2] - c
            best = _edge(second, times[EDGES[n, 1]], c, along, best)
            best = _edge(second, times[EDGES[n, 2]], c, along, best)
    return best


@kernel
def _march(times, shape, wraps, ratios, per, links, heads, state, most):
    near, done = np.empty(27, np.int64), np.empty(27, np.float64)
    steps, squares = np.empty(27, np.float64), ratios * ratios
    offsets, closed = np.empty(27, np.int64), wraps[0] or wraps[1]
    for s in range(27):
        x, y, z = s // 9 - 1, s // 3 % 3 - 1, s % 3 - 1
        offsets[s] = (x * shape[1] + y) * shape[2] + z
        steps[s] = np.sqrt(x * x * squares[0] + y * y * squares[1] + z * z * squares[2])
    worked, last = 0, len(heads) - 1
    while state[1] > 0 and worked < most:
        bucket = state[0] & last
        v = np.int64(heads[bucket])
        if v < 0:
            state[0] += 1
            continue
        _remove(v, bucket, links, heads, state)
        for s in range(27):
            near[s] = v + offsets[s]
        if closed:
            _turn(v, shape, wraps, near)
        for s in range(27):
            told = times[near[s]]
            done[s] = -told if told < 0.0 else np.inf
        time = _arrive(done, times[v], squares)
        times[v] = -time
        worked += 1
        for s in range(27):
            u, key = near[s], time + steps[s]
            before = times[u]
            if key < before:
                now = np.int64(key * per) & last
                if before == np.inf:
                    _insert(u, now, links, heads, state)
                else:
                    old = np.int64(before * per) & last
                    if now != old:
                        _remove(u, old, links, heads, state)
                        _insert(u, now, links, heads, state)
                times[u] = key
    return worked
