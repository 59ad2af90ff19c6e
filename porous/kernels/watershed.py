"""Basins of a map of distances: which maximum each voxel lies uphill to, and where they meet.

Every voxel leads to the highest of its 26 neighbours that is higher than itself; one of a plateau
to where the plateau leads, by the shortest way within it; what leads nowhere is a maximum. That is
the partition that flooding level by level gives (L. Vincent, P. Soille, IEEE Trans. Pattern Anal.
13, 1991), without a queue for all of it. The highest places where basins touch are saddles, and
basins that no narrow saddle parts are one.

Where the grid closes on itself, every basin has an image in every period, and a basin may touch
itself or another in several of them. Each voxel knows in which period it lies of the image whose
maximum is in the grid itself, so that touching voxels tell how many periods apart the images are.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, slabs
from porous.kernels._touches import MIDDLE, WIDE, Lattice, Touches, touching

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.kernels.distance import Squares

    Axes = tuple[bool, bool, bool]
    Progress = Callable[[int, int], None]

SLAB = 1 << 19
"""Voxels that one kernel call looks at, about."""

OUT, FLAT = -1, -2
"""What a voxel leads to that is not of the mask, and one with no higher neighbour."""


AROUND = np.array(
    sorted(set(product((-1, 0, 1), repeat=3)) - {(0, 0, 0)}, key=lambda at: (np.dot(at, at), at)),
    np.int64,
)
"""Steps to the neighbours of a voxel, the nearest first, shape (26, 3)."""


CROWDED = 3
"""A throat has more than so many times as many places next to none but its own two basins as next
to third ones. Cells of packings of balls had 2 at most where they meet in lines, in faces 5 or
more.
"""


class Rule(NamedTuple):
    """When two maxima are one: where nothing narrow lies between them.

    That is where the distance on the way from the lesser one falls by no more than the part
    ``narrower`` of it, or by no more than ``noise``, in units of the squares' step; and where the
    lesser one lies within the ball about the greater.
    """

    narrower: float
    noise: float


class Basins(NamedTuple):
    """The basins of a mask of voxels, from the deepest on, and the saddles between them.

    ``labels``, int32, are 0 outside of the mask and 1 … n in it; ``peaks``, int64, shape (n,), flat
    indices of the voxel where each is deepest, the first of its equals in raster order; ``depths``,
    float32, shape (n,), the squared distance there, in units of the squares' step. ``pairs``,
    int32, shape (m, 2), are labels of basins with a throat between them, the lesser first, in
    order, and ``saddles``, float32, shape (m,), the largest squared distance at which they touch.
    ``periods``, int32, shape (m, 3), tell how many periods along each axis the image of the second
    basin is away that the first one touches; a throat of a basin with itself is there once.
    """

    labels: NDArray[np.int32]
    peaks: NDArray[np.int64]
    depths: NDArray[np.float32]
    pairs: NDArray[np.int32]
    saddles: NDArray[np.float32]
    periods: NDArray[np.int32]


def basins(
    squares: Squares,
    mask: NDArray[np.bool_],
    rule: Rule,
    *,
    periodic: Axes = (False, False, False),
    progress: Progress | None = None,
) -> Basins:
    """Divide a mask into basins about the maxima of a map of distances.

    Parameters
    ----------
    squares
        Squared distances of the voxels of a mask, or a larger one.
    mask
        bool, shape (x, y, z); voxels are joined by faces, edges and corners.
    rule
        Which maxima are one.
    periodic
        Axes along which the grid closes on itself.
    progress
        Called as ``progress(done, count)``; raising in it cancels.

    Returns
    -------
    Basins
    """
    heights = squares.values.astype(np.float32)
    heights *= mask
    heights = heights.reshape(-1)
    bits = heights.view(np.int32)
    shape, wraps = np.array(mask.shape, np.int64), np.array(periodic, np.int64)
    uphill, rows = np.empty(mask.size, np.int32), int(shape[0] * shape[1])
    step = max(1, SLAB // mask.shape[2])

    def told(before: int) -> Progress | None:
        if progress is None:
            return None
        return lambda done, count: progress(before + done, 4 * count)

    slabs(rows, step, lambda a, b: _climb(bits, shape, wraps, uphill, a, b), told(0))
    roots = _plateaus(heights, shape, wraps, uphill)
    labels = np.zeros(mask.size, np.int32)
    labels[roots] = np.arange(1, len(roots) + 1)
    lattice = Lattice(shape, wraps, np.zeros(mask.size if any(periodic) else 1, np.int16))
    for a in range(0, mask.size, SLAB):
        _follow(uphill, labels, *lattice, a, min(a + SLAB, mask.size))
        if progress is not None:
            progress(rows + rows * a // mask.size, 4 * rows)
    numbers = np.array([*rule, *squares.weights], np.float64)
    left, endless = _joined(labels, heights, roots, lattice, numbers, told(2 * rows))
    roots = roots[left]
    throats = _throats(labels, heights, lattice, endless, told(3 * rows))
    return Basins(labels.reshape(mask.shape), roots, heights[roots], *throats)


def _plateaus(heights, shape, wraps, uphill):
    """Lead what is flat to where its plateau leads; return where each maximum begins, in order."""
    flat = np.flatnonzero(uphill == FLAT)
    queue, leads = (np.empty(len(flat) + 1, np.int32) for _ in range(2))
    state = np.zeros(2, np.int64)
    for a in range(0, len(flat), SLAB):
        _edges(flat[a : a + SLAB], heights, shape, wraps, uphill, queue, leads, state)
    _admit(queue, leads, state, uphill)
    while _spread(heights, shape, wraps, uphill, queue, state, SLAB):
        pass
    flat = flat[uphill[flat] == FLAT]
    roots, count = np.empty(len(flat), np.int64), 0
    for a in range(0, len(flat), SLAB):
        some = flat[a : a + SLAB]
        count = _tops(some, heights, shape, wraps, uphill, queue, state, roots, count)
    roots = roots[:count]
    return roots[np.lexsort((roots, -heights[roots]))]


def _throats(labels, heights, lattice, endless, progress):
    """Return pairs of basins with a throat of their own, the height of it, and the periods.

    Basins that touch next to third ones for the most part meet in a line or a point. They have no
    throat, unless nothing else joined them: the widest such places first.
    """
    found = touching(labels, heights, lattice, endless, told=True, progress=progress)
    third = found.keys % 2
    signed = found.counts * np.where(third, -CROWDED, 1)
    pairs = Touches(found.keys // 2, found.saddles, signed).reduced()
    own = pairs.counts > 0
    order = np.lexsort((pairs.keys, -pairs.saddles, ~own))
    ends, periods = pairs.ends(len(endless))
    kept, parent = np.zeros(len(own), np.bool_), np.arange(len(endless), dtype=np.int32)
    _bridge(ends[order], own[order], parent, np.zeros(len(parent), np.int64), kept)
    left = np.zeros(len(own), np.bool_)
    left[order] = kept
    apart = [[_part(number, axis) for axis in range(3)] for number in periods[left]]
    return ends[left], pairs.saddles[left], np.array(apart, np.int32).reshape(-1, 3)


def _joined(labels, heights, roots, lattice, numbers, progress):
    """Join the basins that a rule takes for one; return which are left, and which have no end.

    ``endless``, int64, has a bit for every axis along which a basin, by its new label, goes on into
    its own image without a throat.
    """
    endless = np.zeros(len(roots) + 1, np.int64)
    touches = touching(labels, heights, lattice, endless, told=False, progress=progress)
    parent, shifts = np.arange(len(roots) + 1, dtype=np.int32), np.zeros_like(endless)
    peaks = np.concatenate([[0], roots])
    depths = heights[peaks]
    order = np.lexsort((touches.keys, -touches.saddles))
    pairs, periods = touches.ends(len(endless))
    step = SLAB // 8
    for a in range(0, len(order), step):
        some = order[a : a + step]
        found = pairs[some], periods[some], touches.saddles[some]
        _join(*found, peaks, depths, parent, shifts, endless, numbers, lattice.shape)
    _settle(parent, shifts)
    left = np.flatnonzero(parent[1:] == np.arange(1, len(parent)))
    names = np.zeros(len(parent), np.int32)
    names[left + 1] = np.arange(1, len(left) + 1)
    names = names[parent]
    slabs(len(labels), SLAB, lambda a, b: _rename(labels, names, lattice.periods, shifts, a, b))
    return left, np.concatenate([[0], endless[left + 1]])


@kernel
def _part(periods, axis):
    # Periods along one axis.
    return (((periods + MIDDLE) >> WIDE * (2 - axis)) & 31) - 16


@kernel
def _crossed(v, u, shape, wraps):
    # Into which period one gets that steps from a voxel to a neighbour.
    periods = 0
    for a in range(3):
        axis = 2 - a
        step = u % shape[axis] - v % shape[axis]
        if wraps[axis] and abs(step) > 1:
            periods += (-1 if step > 0 else 1) << WIDE * a
        u, v = u // shape[axis], v // shape[axis]
    return periods


@kernel
def _row(i, j, step, shape, wraps):
    # First voxel of a row next to row (i, j); −1 where there is none.
    x, y = i + step[0], j + step[1]
    if wraps[0]:
        x = (x + shape[0]) % shape[0]
    if wraps[1]:
        y = (y + shape[1]) % shape[1]
    inside = x >= 0 and x < shape[0] and y >= 0 and y < shape[1]
    return (x * shape[1] + y) * shape[2] if inside else -1


@kernel
def _around(v, shape, wraps, out):
    # Write the neighbours of a voxel, the nearest first; return how many there are.
    ny, nz = shape[1], shape[2]
    i, j, k = v // (ny * nz), v // nz % ny, v % nz
    if 0 < i < shape[0] - 1 and 0 < j < ny - 1 and 0 < k < nz - 1:
        for s in range(26):
            out[s] = v + (AROUND[s, 0] * ny + AROUND[s, 1]) * nz + AROUND[s, 2]
        return 26
    count = 0
    for s in range(26):
        row, z = _row(i, j, AROUND[s], shape, wraps), k + AROUND[s, 2]
        if wraps[2]:
            z = (z + nz) % nz
        if row >= 0 and z >= 0 and z < nz:
            out[count] = row + z
            count += 1
    return count


@kernel
def _raise(bits, best, code):
    for k in range(len(best)):
        best[k] = max(best[k], (np.int64(bits[k]) << 5) | code)


@kernel
def _climb(bits, shape, wraps, uphill, first, last):
    # Heights are not negative, so that their bits are in order; a code below them tells the step.
    n = shape[2]
    best = np.empty(n, np.int64)
    for row in range(first, last):
        i, j = row // shape[1], row % shape[1]
        best[:] = 0
        for s in range(26):
            base, d, code = _row(i, j, AROUND[s], shape, wraps), AROUND[s, 2], 31 - s
            if base < 0:
                continue
            low, high = max(0, -d), n - max(0, d)
            _raise(bits[base + low + d : base + high + d], best[low:high], code)
            if wraps[2] and d < 0:
                _raise(bits[base + n - 1 : base + n], best[:1], code)
            if wraps[2] and d > 0:
                _raise(bits[base : base + 1], best[n - 1 :], code)
        for k in range(n):
            v = row * n + k
            if bits[v] == 0:
                uphill[v] = OUT
            elif best[k] >> 5 <= bits[v]:
                uphill[v] = FLAT
            else:
                step = AROUND[31 - (best[k] & 31)]
                uphill[v] = _row(i, j, step, shape, wraps) + (k + step[2] + n) % n


@kernel
def _edges(flat, heights, shape, wraps, uphill, queue, leads, state):
    # What is flat and touches what is as high and leads somewhere; told, not led there yet.
    near = np.empty(26, np.int64)
    for at in range(len(flat)):
        v = flat[at]
        for s in range(_around(v, shape, wraps, near)):
            if uphill[near[s]] >= 0 and heights[near[s]] == heights[v]:
                queue[state[1]], leads[state[1]] = v, near[s]
                state[1] += 1
                break


@kernel
def _admit(queue, leads, state, uphill):
    for at in range(state[1]):
        uphill[queue[at]] = leads[at]


@kernel
def _spread(heights, shape, wraps, uphill, queue, state, most):
    # Voxels of a plateau lead to the one that came to them first. Returns whether more may follow.
    near = np.empty(26, np.int64)
    stop = state[0] + most
    while state[0] < state[1] and state[0] < stop:
        v = np.int64(queue[state[0]])
        state[0] += 1
        for s in range(_around(v, shape, wraps, near)):
            u = near[s]
            if uphill[u] == FLAT and heights[u] == heights[v]:
                uphill[u] = v
                queue[state[1]] = u
                state[1] += 1
    return state[0] < state[1]


@kernel
def _tops(flat, heights, shape, wraps, uphill, queue, state, roots, count):
    # Each plateau that leads nowhere becomes one maximum, at its first voxel.
    for at in range(len(flat)):
        v = flat[at]
        if uphill[v] == FLAT:
            uphill[v] = v
            roots[count] = v
            count += 1
            state[0], state[1] = 0, 1
            queue[0] = v
            _spread(heights, shape, wraps, uphill, queue, state, len(queue))
    return count


@kernel
def _follow(uphill, labels, shape, wraps, periods, first, last):
    wound = len(periods) > 1
    for start in range(first, last):
        if uphill[start] == OUT or labels[start] != 0:
            continue
        v, period = np.int64(start), 0
        while labels[v] == 0:
            u = np.int64(uphill[v])
            if wound:
                period -= _crossed(v, u, shape, wraps)
            v = u
        label = labels[v]
        if wound:
            period += periods[v]
        v = np.int64(start)
        while labels[v] == 0:
            labels[v] = label
            u = np.int64(uphill[v])
            if wound:
                periods[v] = period
                period += _crossed(v, u, shape, wraps)
            v = u


@kernel
def _root(parent, shifts, a):
    # What a basin has been joined to, and how many periods on that image is that it is part of.
    shift = np.int64(0)
    while parent[a] != a:
        shifts[a] += shifts[parent[a]]
        parent[a] = parent[parent[a]]
        shift += shifts[a]
        a = parent[a]
    return a, shift


@kernel
def _apart(p, q, periods, numbers, shape):
    # Square of the distance of a voxel to the image of another.
    total = 0.0
    for a in range(3):
        axis = 2 - a
        step = q % shape[axis] - p % shape[axis] + _part(periods, axis) * shape[axis]
        total += numbers[2 + axis] * step * step
        p, q = p // shape[axis], q // shape[axis]
    return total


@kernel
def _join(pairs, periods, saddles, peaks, depths, parent, shifts, endless, numbers, shape):
    # From the highest saddle downwards; the lesser of two basins is the one with the larger number.
    for at in range(len(pairs)):
        a, before = _root(parent, shifts, pairs[at, 0])
        b, after = _root(parent, shifts, pairs[at, 1])
        apart = periods[at] + after - before
        if a == b and apart == 0:
            continue
        greater, lesser = min(a, b), max(a, b)
        radius = np.sqrt(depths[lesser])
        wide = radius - np.sqrt(saddles[at]) <= max(numbers[0] * radius, numbers[1])
        if not wide:
            wide = _apart(peaks[a], peaks[b], apart, numbers, shape) < depths[greater]
        if wide and a == b:
            for axis in range(3):
                if _part(apart, axis) != 0:
                    endless[a] |= 1 << axis
        elif wide:
            parent[lesser] = greater
            shifts[lesser] = apart if lesser == a else -apart
            endless[greater] |= endless[lesser]


@kernel
def _bridge(pairs, alone, parent, shifts, kept):
    for at in range(len(pairs)):
        a, b = _root(parent, shifts, pairs[at, 0])[0], _root(parent, shifts, pairs[at, 1])[0]
        kept[at] = alone[at] or a != b
        parent[max(a, b)] = min(a, b)


@kernel
def _settle(parent, shifts):
    for a in range(len(parent)):
        shifts[a] += shifts[parent[a]]  # a parent comes before and is settled
        parent[a] = parent[parent[a]]


@kernel
def _rename(labels, names, periods, shifts, first, last):
    for v in range(first, last):
        if len(periods) > 1:
            periods[v] -= shifts[labels[v]]
        labels[v] = names[labels[v]]
