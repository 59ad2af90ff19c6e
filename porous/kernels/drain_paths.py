"""How far it is out of pores: lengths of the shortest ways through void, by fast marching.

The eikonal equation |∇T| = 1 in first-order upwind differences (J. A. Sethian, PNAS 93, 1996) has
one solution on the lattice. A queue of buckets, each a list linked both ways, visits voxels by
growing T, and again where T became less, so that it is that solution whatever the order of visits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Axes = tuple[bool, bool, bool]

CALL = 1 << 20
"""Visits to voxels that one kernel call makes, about."""

BUCKETS = 3
"""Buckets per shortest edge of a voxel."""

LEAST = 1e-5
"""Part of the shortest edge that a length must become less by to count."""


def lengths_out(
    void: NDArray[np.bool_],
    spacing: tuple[float, float, float],
    *,
    periodic: Axes = (False, False, False),
    outside: NDArray[np.bool_] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> NDArray[np.float32]:
    """Return how long the shortest way out is from each voxel of void, through faces of voxels.

    Parameters
    ----------
    void
        bool, shape (x, y, z).
    spacing
        Edges of a voxel.
    periodic
        Axes along which the grid closes on itself; the sides of others lead out.
    outside
        bool: void that is outside itself.
    progress
        Called as ``progress(done, count)`` in voxels, the count as if all were reached; raising in
        it cancels.

    Returns
    -------
    float32, shape (x, y, z), from a voxel's centre: infinite where no way leads out, and in solid;
    0 outside.
    """
    shape = void.shape
    lengths = np.full(shape, np.inf, np.float32)
    for axis, (closed, h) in enumerate(zip(periodic, spacing, strict=True)):
        for end in () if closed else (0, -1):
            side = np.moveaxis(lengths, axis, 0)[end]
            np.minimum(side, np.float32(h / 2), out=side)
    if outside is not None:
        lengths[outside] = 0
    lengths[~void] = np.inf
    flat = lengths.reshape(-1)
    starts = source(np.flatnonzero(np.isfinite(flat)), np.int64)
    given = source(void, np.bool_).view(np.uint8).reshape(-1)
    size, wraps = np.array(shape, np.int64), np.array(periodic, np.int64)
    steps, width = np.array(spacing, np.float64), min(spacing) / BUCKETS
    count = int(np.ceil(max(spacing) / width)) + 2
    links = np.full((len(flat), 2), -1, np.int32)
    heads = np.full(count, -1, np.int32)
    state = np.zeros(2, np.int64)  # the bucket at hand, voxels in all of them
    _start(flat, starts, width, links, heads, state)
    total, done = max(1, int(np.count_nonzero(void))), 0
    while state[1]:
        done += _march(flat, given, size, wraps, steps, width, links, heads, state, CALL)
        if progress is not None:
            progress(min(done, total), total)
    return lengths


@kernel
def _insert(links, heads, bucket, at):
    # The bucket's first voxel has −2 − bucket before it; −1 after the last.
    first = heads[bucket]
    links[at, 0] = -2 - bucket
    links[at, 1] = first
    if first >= 0:
        links[first, 0] = at
    heads[bucket] = at


@kernel
def _remove(links, heads, at):
    before, after = links[at, 0], links[at, 1]
    if before <= -2:
        heads[-2 - before] = after
    else:
        links[before, 1] = after
    if after >= 0:
        links[after, 0] = before
    links[at, 0] = -1


@kernel
def _start(lengths, starts, width, links, heads, state):
    for s in range(len(starts)):
        bucket = np.int64(lengths[starts[s]] / width)
        _insert(links, heads, bucket, starts[s])
    state[1] = len(starts)


@kernel
def _solved(a, b, c, p, q, r):
    # The T with ((T − a)/p)² + ((T − b)/q)² + ((T − c)/r)² = 1, of those that are below it.
    if b < a:
        a, b, p, q = b, a, q, p
    if c < b:
        b, c, q, r = c, b, r, q
        if b < a:
            a, b, p, q = b, a, q, p
    result = a + p
    if b >= result:
        return result
    one, two = 1.0 / (p * p), 1.0 / (q * q)
    weight, linear = one + two, two * (b - a)
    square = linear * (b - a)
    result = a + (linear + np.sqrt(max(linear * linear - weight * (square - 1.0), 0.0))) / weight
    if c >= result:
        return result
    three = 1.0 / (r * r)
    weight, linear = weight + three, linear + three * (c - a)
    square += three * (c - a) * (c - a)
    return a + (linear + np.sqrt(max(linear * linear - weight * (square - 1.0), 0.0))) / weight


@kernel
def _least_beside(lengths, at, place, count, stride, wraps):
    # The less of the lengths of two voxels beside one along an axis.
    result = np.float32(np.inf)
    if place:
        result = lengths[at - stride]
    elif wraps:
        result = lengths[at + (count - 1) * stride]
    if place + 1 < count:
        result = min(result, lengths[at + stride])
    elif wraps:
        result = min(result, lengths[at - (count - 1) * stride])
    return np.float64(result)


@kernel
def _march(lengths, void, shape, wraps, steps, width, links, heads, state, most):
    nx, ny, nz = shape[0], shape[1], shape[2]
    sx, sy = ny * nz, nz
    least = np.float32(LEAST * min(steps[0], steps[1], steps[2]))
    visits = 0
    while visits < most and state[1]:
        at = np.int64(heads[state[0] % len(heads)])
        if at < 0:
            state[0] += 1
            continue
        _remove(links, heads, at)
        state[1] -= 1
        visits += 1
        here = lengths[at]
        i = at // sx
        j = (at - i * sx) // sy
        k = at - i * sx - j * sy
        for n in range(6):
            x, y, z = i, j, k
            way = 2 * (n & 1) - 1
            if n < 2:
                x += way
                if x < 0 or x >= nx:
                    if wraps[0] == 0:
                        continue
                    x -= way * nx
            elif n < 4:
                y += way
                if y < 0 or y >= ny:
                    if wraps[1] == 0:
                        continue
                    y -= way * ny
            else:
                z += way
                if z < 0 or z >= nz:
                    if wraps[2] == 0:
                        continue
                    z -= way * nz
            beside = x * sx + y * sy + z
            before = lengths[beside]
            if before <= here or void[beside] == 0:
                continue
            length = np.float32(
                _solved(
                    _least_beside(lengths, beside, x, nx, sx, wraps[0]),
                    _least_beside(lengths, beside, y, ny, sy, wraps[1]),
                    _least_beside(lengths, beside, z, nz, 1, wraps[2]),
                    steps[0],
                    steps[1],
                    steps[2],
                )
            )
            if length < before - least:
                if links[beside, 0] != -1:
                    _remove(links, heads, beside)
                    state[1] -= 1
                lengths[beside] = length
                bucket = max(state[0], np.int64(length / width))
                _insert(links, heads, bucket % len(heads), beside)
                state[1] += 1
    return visits
