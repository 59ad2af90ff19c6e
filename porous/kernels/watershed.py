"""Basins of a map of distances: which maximum each voxel lies uphill to, and where they meet.

Every voxel leads to the highest of its 26 neighbours that is higher than itself; one of a plateau
to where the plateau leads, by the shortest way within it; what leads nowhere is a maximum. That is
the partition that flooding level by level gives (L. Vincent, P. Soille, IEEE Trans. Pattern Anal.
13, 1991), without a queue for all of it. The highest places where basins touch are saddles, and
basins that no narrow saddle parts are one.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, slabs

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
    """

    labels: NDArray[np.int32]
    peaks: NDArray[np.int64]
    depths: NDArray[np.float32]
    pairs: NDArray[np.int32]
    saddles: NDArray[np.float32]


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
    heights = np.where(mask, squares.values, 0).astype(np.float32).reshape(-1)
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
    for a in range(0, mask.size, SLAB):
        _follow(uphill, labels, a, min(a + SLAB, mask.size))
        if progress is not None:
            progress(rows + rows * a // mask.size, 4 * rows)
    lattice, count = (shape, wraps), len(roots)
    touches = _touching(labels, heights, lattice, count, told=False, progress=told(2 * rows))
    numbers = np.array([*rule, *squares.weights], np.float64)
    parent = _joined(touches, roots, heights[roots], numbers, lattice)
    left = np.flatnonzero(parent == np.arange(count))
    names = np.zeros(count + 1, np.int32)
    names[left + 1] = np.arange(1, len(left) + 1)
    names[1:] = names[parent + 1]
    slabs(mask.size, SLAB, lambda a, b: _rename(labels, names, a, b))
    roots = roots[left]
    throats = _throats(labels, heights, lattice, len(roots), told(3 * rows))
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


def _touching(labels, heights, lattice, count, *, told, progress):
    """Return pairs of basins that touch, and the largest height at which they do; see ``_Touches``.

    Where ``told``, keys are twice as large, and one more where a third basin is next to either.
    """
    shape, wraps = lattice
    rows, step = int(shape[0] * shape[1]), max(1, SLAB // int(shape[2]))
    size, asked = np.int64(count + 1), int(told)
    parts = [_Touches.room(0) for _ in range(0, rows, step)]

    def work(a, b):
        found = _touch(labels, heights, shape, wraps, size, asked, a, b, *_Touches.room(0)[:2])
        if found:
            part = _Touches.room(found)
            _touch(labels, heights, shape, wraps, size, asked, a, b, *part[:2])
            parts[a // step] = part.reduced()

    slabs(rows, step, work, progress)
    return _Touches(*(np.concatenate(all_) for all_ in zip(*parts, strict=True))).reduced()


class _Touches(NamedTuple):
    """Places where two basins touch: a key of the pair, the height there, and how many they are."""

    keys: NDArray[np.int64]
    saddles: NDArray[np.float32]
    counts: NDArray[np.int64]

    @classmethod
    def room(cls, n):
        return cls(np.empty(n, np.int64), np.empty(n, np.float32), np.ones(n, np.int64))

    def reduced(self):
        """Return each key once, ascending, with the highest of its places."""
        order = np.lexsort((self.saddles, self.keys))
        keys, saddles, counts = (part[order] for part in self)
        first = np.flatnonzero(np.diff(keys, prepend=-1) != 0)
        if not len(first):
            return self
        last = np.append(first[1:], len(keys)) - 1
        return _Touches(keys[first], saddles[last], np.add.reduceat(counts, first))


def _throats(labels, heights, lattice, count, progress):
    """Return pairs of basins with a throat of their own, and the height of it.

    Basins that touch next to third ones for the most part meet in a line or a point. They have no
    throat, unless nothing else joined them: the widest such places first.
    """
    found = _touching(labels, heights, lattice, count, told=True, progress=progress)
    third = found.keys % 2
    signed = found.counts * np.where(third, -CROWDED, 1)
    pairs = _Touches(found.keys // 2, found.saddles, signed).reduced()
    own = pairs.counts > 0
    order = np.lexsort((pairs.keys, -pairs.saddles, ~own))
    ends = _ends(pairs.keys, count)
    kept = np.zeros(len(own), np.bool_)
    _bridge(ends[order], own[order], np.arange(count + 1, dtype=np.int32), kept)
    left = np.zeros(len(own), np.bool_)
    left[order] = kept
    return ends[left], pairs.saddles[left]


def _ends(keys, count):
    return np.stack([keys // (count + 1), keys % (count + 1)], axis=1).astype(np.int32)


def _joined(touches, roots, depths, numbers, lattice):
    """Return which basin each belongs to, once those are joined that a rule takes for one."""
    count = len(roots)
    parent = np.arange(count, dtype=np.int32)
    order = np.lexsort((touches.keys, -touches.saddles))
    pairs, saddles = _ends(touches.keys[order], count) - 1, touches.saddles[order]
    step = SLAB // 8
    for a in range(0, len(pairs), step):
        some = pairs[a : a + step], saddles[a : a + step]
        _join(*some, roots, depths, parent, numbers, *lattice)
    _settle(parent)
    return parent


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
def _follow(uphill, labels, first, last):
    for start in range(first, last):
        if uphill[start] == OUT:
            continue
        v = np.int64(start)
        while labels[v] == 0:
            v = np.int64(uphill[v])
        label, v = labels[v], np.int64(start)
        while labels[v] == 0:
            labels[v] = label
            v = np.int64(uphill[v])


@kernel
def _third(labels, u, v, shape, wraps, near):
    # Whether a basin that is none of two voxels' lies next to one of them.
    for place in (u, v):
        for s in range(_around(place, shape, wraps, near)):
            label = labels[near[s]]
            if label > 0 and label != labels[u] and label != labels[v]:
                return 1
    return 0


@kernel
def _touch(labels, heights, shape, wraps, size, asked, first, last, keys, saddles):
    # Pairs of voxels of two basins, told once, or only counted where there is no room to tell.
    n = shape[2]
    count, near = 0, np.empty(26, np.int64)
    for row in range(first, last):
        i, j, here = row // shape[1], row % shape[1], row * n
        for s in range(26):
            step, d = AROUND[s], AROUND[s, 2]
            if step[0] > 0 or (step[0] == 0 and (step[1] > 0 or (step[1] == 0 and d > 0))):
                continue  # the other voxel of the pair tells
            base = _row(i, j, step, shape, wraps)
            if base < 0:
                continue
            low, high = max(0, -d), n - max(0, d)
            for part in range(2):
                u, v, many = base + low + d, here + low, high - low
                if part == 1:
                    if d == 0 or not wraps[2]:
                        continue
                    u, v, many = base, here + n - 1, 1
                    if d < 0:
                        u, v = base + n - 1, here
                for k in range(many):
                    a, b = labels[u + k], labels[v + k]
                    if a == b or a == 0 or b == 0:
                        continue
                    if len(keys):
                        key = np.int64(min(a, b)) * size + max(a, b)
                        if asked:
                            key = 2 * key + _third(labels, u + k, v + k, shape, wraps, near)
                        keys[count] = key
                        saddles[count] = min(heights[u + k], heights[v + k])
                    count += 1
    return count


@kernel
def _root(parent, a):
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    return a


@kernel
def _apart(p, q, numbers, shape, wraps):
    # Square of the distance of two voxels.
    total = 0.0
    for a in range(3):
        step = abs(p % shape[2 - a] - q % shape[2 - a])
        if wraps[2 - a]:
            step = min(step, shape[2 - a] - step)
        total += numbers[4 - a] * step * step
        p, q = p // shape[2 - a], q // shape[2 - a]
    return total


@kernel
def _join(pairs, saddles, peaks, depths, parent, numbers, shape, wraps):
    # From the highest saddle downwards; the lesser of two basins is the one with the larger number.
    for at in range(len(pairs)):
        a, b = _root(parent, pairs[at, 0]), _root(parent, pairs[at, 1])
        if a == b:
            continue
        greater, lesser = min(a, b), max(a, b)
        radius = np.sqrt(depths[lesser])
        wide = radius - np.sqrt(saddles[at]) <= max(numbers[0] * radius, numbers[1])
        if not wide:
            apart = _apart(peaks[lesser], peaks[greater], numbers, shape, wraps)
            wide = apart < depths[greater]
        if wide:
            parent[lesser] = greater


@kernel
def _bridge(pairs, alone, parent, kept):
    for at in range(len(pairs)):
        a, b = _root(parent, pairs[at, 0]), _root(parent, pairs[at, 1])
        kept[at] = alone[at] or a != b
        parent[max(a, b)] = min(a, b)


@kernel
def _settle(parent):
    for a in range(len(parent)):
        parent[a] = parent[parent[a]]  # a parent comes before and is settled


@kernel
def _rename(labels, names, first, last):
    for v in range(first, last):
        labels[v] = names[labels[v]]
