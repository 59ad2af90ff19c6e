"""Widest ways: the largest balls whose centres come to a place, from outside or from end to end.

From each voxel a way leads up to a peak, along which distances do not fall; so the widest way to a
voxel is as wide as that to its peak, or the voxel itself where that is less. Peaks are joined where
their slopes meet, the highest passes first, as in a forest of largest edges (T. C. Hu, Operations
Research 9, 1961); it is noted when what is joined comes to the outside, and to both ends of an axis
or back to itself a period on. Voxels are joined by faces, edges and corners.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.kernels.distance import Numbers, Squares

    Axes = tuple[bool, bool, bool]
    Index = tuple[int, int, int]
    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]
    Passes = tuple[Integers, NDArray[np.int32]]
    Progress = Callable[[int, int], None]

SLAB = 1 << 20
"""Voxels that one kernel call looks at, about."""

PASSES = 1 << 18
"""Passes that one kernel call tells or joins at."""

SLOTS = 1 << 16
"""Passes that are looked up among those seen last."""

LEVELS = 1 << 22
"""Squares that are told apart, at most."""

TIE = 1e-12
"""Squares that differ by this part of them are the same, but for rounding."""

SOLID, FREE, PEAKS = -1, -2, -3
"""What stands for voxels outside of the mask, for those that are free, and for the first peak."""

LOW, HIGH, OUTSIDE = 0, 3, 6
"""Bits of what a peak has come to: the first two of x, and by one and two more those of y, z."""

SHARED = 7
"""How many there are of them."""

TURNS = 27
"""Ways to be a period off the grid, or none, along each axis."""

EACH = 22
"""Passes at a voxel, at most: to 13 neighbours, to three sides and to six ends."""


class Ways(NamedTuple):
    """The widest ways through a mask.

    ``inward`` is like the ``values`` of the squares: of the largest ball whose centre can come from
    outside to each voxel, 0 where none can. ``through`` are the squares of the largest balls that
    pass along each axis, float64 (3,), 0 where none does.
    """

    inward: Numbers
    through: Floats


def widest(
    squares: Squares,
    *,
    ends: tuple[Index, Index],
    free: NDArray[np.bool_] | None = None,
    periodic: Axes = (False, False, False),
    progress: Progress | None = None,
) -> Ways:
    """Return how large balls come from outside and pass from end to end.

    A ball about a voxel reaches to the nearest voxel outside of the mask. A centre goes from voxel
    to voxel by faces, edges and corners, and the ball that comes along a way is the least there.

    Parameters
    ----------
    squares
        What ``squared_distances`` found, in a mask of which something lies outside.
    ends
        The first layers along each axis and the last, between which balls pass; along periodic axes
        they come back to the same place a period on.
    free
        bool, shape (x, y, z): voxels that balls come from as they do from the sides that are not
        periodic, but that none passes.
    periodic
        Axes along which the grid closes on itself.
    progress
        Called as ``progress(done, count)``; raising in it cancels.

    Returns
    -------
    Ways
        Exact. Where there are more than four million squares, which takes balls of hundreds of
        voxels, they are drawn in to four million levels.
    """
    given = source(squares.values, squares.values.dtype)
    levels = _levels(squares)
    ranks = given if levels is None else _ranked(given, levels)
    peaks = np.empty(given.shape, np.int32 if given.size < 1 << 31 else np.int64)
    wraps = np.array(periodic, np.int64)
    count = _find_peaks(ranks, free, peaks)
    bounds = np.array([*ends[0], *ends[1]], np.int64)
    reached, found = _joined(ranks, peaks, count, (wraps, bounds), progress)
    _settle_all(ranks, reached, peaks)
    if levels is None:
        return Ways(peaks.astype(given.dtype, copy=False), found.astype(np.float64))
    values = np.concatenate([[0.0], levels])
    return Ways(values[peaks].astype(given.dtype, copy=False), values[found])


def _planes(shape: tuple[int, ...]) -> int:
    return max(1, SLAB // (shape[1] * shape[2]))


def _levels(squares: Squares) -> Floats | None:
    """Return the squares that can occur, ascending, or None for all whole numbers."""
    largest = float(squares.values.max(initial=0))
    if squares.values.dtype.kind in "iu" and largest <= LEVELS:
        return None
    counts = [math.isqrt(int(largest / w)) + 2 for w in squares.weights]
    if math.prod(counts) > 4 * LEVELS:
        return np.linspace(1.0, max(largest, 1.0), LEVELS)
    x, y, z = (
        w * np.arange(n, dtype=float) ** 2 for n, w in zip(counts, squares.weights, strict=True)
    )
    values = np.sort((x[:, None, None] + y[:, None] + z).ravel())
    values = values[(values > 0) & (values <= largest * (1 + TIE))]
    return np.asarray(values[np.diff(values, prepend=0.0) > TIE * values])


def _ranked(given: Numbers, levels: Floats) -> NDArray[np.int32]:
    """Return the place of each voxel's level, from 1 on; 0 outside of the mask."""
    classes = 1 << 16
    width = float(levels[-1]) * (1 + 4 * TIE) / classes
    starts = np.searchsorted(levels, np.arange(classes + 1) * width, side="right").astype(np.int64)
    bounds = source(np.append(levels, np.inf), np.float64)
    ranks = np.empty(given.shape, np.int32)

    def rank(a: int, b: int) -> None:
        _rank(given, bounds, starts, width, ranks, a, b)

    slabs(given.shape[0], _planes(given.shape), rank)
    return source(ranks, np.int32)


def _find_peaks(ranks: Numbers, free: NDArray[np.bool_] | None, peaks: Numbers) -> int:
    """Set each voxel's peak, ``PEAKS`` less its number; return how many there are."""
    none = np.zeros((0, 0, 0), np.bool_)
    begin = source(none if free is None else free, np.bool_).view(np.uint8)
    flat, planes = peaks.reshape(-1), _planes(ranks.shape)
    side = ranks.shape[1] * ranks.shape[2]

    def climb(a: int, b: int) -> None:
        _climb(ranks, begin, peaks, a, b)

    def follow(a: int, b: int) -> None:
        _follow(flat, a * side, b * side)

    def take(a: int, b: int) -> None:
        _take(flat, a * side, b * side)

    slabs(ranks.shape[0], planes, climb)
    slabs(ranks.shape[0], planes, follow)
    count = 0
    for a in range(0, ranks.shape[0], planes):
        count = _number(flat, a * side, min(a + planes, ranks.shape[0]) * side, count)
    slabs(ranks.shape[0], planes, take)
    return count


def _joined(
    ranks: Numbers,
    peaks: Numbers,
    count: int,
    where: tuple[Integers, Integers],
    progress: Progress | None,
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the level at which each peak comes to the outside, and those of what passes."""
    keys, levels = _passes(ranks, peaks, count, where, progress)
    order = np.argsort(-levels, kind="stable")
    keys, levels = source(keys[order], np.int64), source(levels[order], np.int32)
    forest = np.stack([np.arange(count), np.arange(count)], axis=1)
    shifts, marks = np.zeros((count, 3), np.int32), np.zeros(count, np.uint8)
    reached, found = np.zeros(count, np.int32), np.zeros(3, np.int32)
    for a in range(0, len(keys), PASSES):
        part = slice(a, a + PASSES)
        _join(keys[part], levels[part], forest, shifts, marks, reached, found)
    return reached, found


def _passes(
    ranks: Numbers,
    peaks: Numbers,
    count: int,
    where: tuple[Integers, Integers],
    progress: Progress | None,
) -> Passes:
    """Return where slopes of two peaks meet and what they come to, each at its highest level."""
    planes, told = _planes(ranks.shape), source(peaks, peaks.dtype)
    room = PASSES + EACH * ranks.shape[2]
    found: dict[int, list[Passes]] = {}

    def look(a: int, b: int) -> None:
        keys, levels = np.full(room + SLOTS, -1, np.int64), np.zeros(room + SLOTS, np.int32)
        place, found[a] = np.array([a, 0], np.int64), []
        while place[0] < b:
            n = _look(ranks, told, count, *where, keys, levels, place, b)
            found[a].append((keys[SLOTS:n].copy(), levels[SLOTS:n].copy()))
        taken = keys[:SLOTS] >= 0
        found[a].append((keys[:SLOTS][taken], levels[:SLOTS][taken]))
        found[a] = [_highest(found[a])]

    slabs(ranks.shape[0], planes, look, progress)
    return _highest([part for a in sorted(found) for part in found[a]])


def _highest(parts: list[Passes]) -> Passes:
    """Return all passes, each once, at the highest level that it has."""
    keys, levels = (np.concatenate([part[end] for part in parts]) for end in (0, 1))
    order = np.lexsort((levels, keys))
    keys, levels = keys[order], levels[order]
    last = np.flatnonzero(np.diff(keys, append=-1))
    return keys[last], levels[last]


def _settle_all(ranks: Numbers, reached: NDArray[np.int32], peaks: Numbers) -> None:
    """Set each voxel's level, the lesser of its own and its peak's."""

    def settle(a: int, b: int) -> None:
        _settle(ranks, reached, peaks, a, b)

    slabs(ranks.shape[0], _planes(ranks.shape), settle)


@kernel
def _rank(squares, levels, starts, width, ranks, first, last):
    for i in range(first, last):
        for j in range(squares.shape[1]):
            for k in range(squares.shape[2]):
                square = np.float64(squares[i, j, k]) * (1.0 + TIE)
                rank = 0
                if square > 0.0:
                    rank = starts[np.int64(square / width)]
                    while levels[rank] <= square:
                        rank += 1
                    while rank > 0 and levels[rank - 1] > square:
                        rank -= 1
                ranks[i, j, k] = rank


@kernel
def _code(ranks, free, out):
    # Ranks so far apart that steps have room between them; none climbs to what is free.
    if len(free):
        for k in range(len(ranks)):
            out[k] = 0 if free[k] else np.int32(27 * np.int64(ranks[k]))
    else:
        for k in range(len(ranks)):
            out[k] = np.int32(27 * np.int64(ranks[k]))


@kernel
def _steepest(before, here, after, step, out):
    # The largest of three codes, steps added to them.
    for k in range(len(out)):
        out[k] = max(before[k], np.int32(here[k] + step), np.int32(after[k] + 2 * step))


@kernel
def _steep(ranks, free, i, line, rows, out):
    # The largest codes of the nine voxels about those of a plane; zeros beyond the grid.
    nx, ny, nz = ranks.shape
    if i < 0 or i == nx:
        out[:] = 0
        return
    for j in range(ny):
        some = free[i, j] if free.shape[0] > 0 else free.reshape(-1)
        _code(ranks[i, j], some, line[1 : nz + 1])
        _steepest(line[:nz], line[1 : nz + 1], line[2:], 1, rows[j + 1])
    for j in range(ny):
        _steepest(rows[j], rows[j + 1], rows[j + 2], 3, out[j])


@kernel
def _climb(ranks, free, peaks, first, last):
    # The steepest way up that stays in the grid, the voxel itself on a peak; of voxels alike, which
    # are in a row, the last. A code is 27 times a rank, and the number of the step to it.
    _, ny, nz = ranks.shape
    some = free.shape[0] > 0
    line, best = np.zeros(nz + 2, np.int32), np.empty(nz, np.int32)
    rows, planes = np.zeros((ny + 2, nz), np.int32), np.empty((3, ny, nz), np.int32)
    steps = np.empty(27, np.int64)
    for s in range(27):
        steps[s] = ((s // 9 - 1) * ny + s // 3 % 3 - 1) * nz + s % 3 - 1
    for i in range(first - 1, last + 1):
        _steep(ranks, free, i, line, rows, planes[(i + 3) % 3])
        if i <= first:
            continue
        low, here, high = planes[(i + 1) % 3], planes[(i + 2) % 3], planes[i % 3]
        for j in range(ny):
            _steepest(low[j], here[j], high[j], 9, best)
            start = ((i - 1) * ny + j) * nz
            for k in range(nz):
                top = start + k + steps[best[k] % 27]
                if some and free[i - 1, j, k]:
                    top = FREE
                peaks[i - 1, j, k] = top if ranks[i - 1, j, k] else SOLID


@kernel
def _follow(peaks, first, last):
    # Other slabs shorten their ways meanwhile, which lead to the same peaks.
    for voxel in range(last - 1, first - 1, -1):
        top = peaks[voxel]
        if top >= 0:
            while peaks[top] != top:
                top = peaks[top]
            peaks[voxel] = top


@kernel
def _number(peaks, first, last, count):
    for voxel in range(first, last):
        if peaks[voxel] == voxel:
            peaks[voxel] = PEAKS - count
            count += 1
    return count


@kernel
def _take(peaks, first, last):
    for voxel in range(first, last):
        if peaks[voxel] >= 0:
            peaks[voxel] = peaks[peaks[voxel]]


@kernel
def _note(keys, levels, stop, key, level):
    # Keep a pass in its slot, the highest of it; what was there goes to the end of the list.
    slot = key % SLOTS
    if keys[slot] == key:
        levels[slot] = max(levels[slot], level)
        return stop
    if keys[slot] >= 0:
        keys[stop], levels[stop] = keys[slot], levels[slot]
        stop += 1
    keys[slot], levels[slot] = key, level
    return stop


@kernel
def _differ(own, beside, flags):
    for k in range(len(flags)):
        flags[k] |= (beside[k] != own[k]) & (beside[k] != SOLID)


@kernel
def _meeting(peaks, i, j, ends, flags):
    # Flag voxels of a row that may be next to another peak's slope, or at an end of the grid.
    nx, ny, nz = peaks.shape
    if i == nx - 1 or i in (0, ends[0], ends[3]) or j in (0, ny - 1, ends[1], ends[4]):
        flags[:] = 1
        return
    own = peaks[i, j]
    flags[:] = 0
    for k in (0, nz - 1, ends[2], ends[5]):
        flags[k] = 1
    _differ(own[:-1], own[1:], flags[:-1])
    for x, y in ((i, j + 1), (i + 1, j - 1), (i + 1, j), (i + 1, j + 1)):
        beside = peaks[x, y]
        _differ(own, beside, flags)
        _differ(own[:-1], beside[1:], flags[:-1])
        _differ(own[1:], beside[:-1], flags[1:])


@kernel
def _beside(place, step, shape, wraps):
    # The neighbour of a voxel, by its number of 27, and the period that it lies in by the same;
    # −1 where there is none.
    at, turn = 0, 0
    for a in range(3):
        here, size = place[a] + step // (9, 3, 1)[a] % 3 - 1, shape[a]
        off = here // size
        if off != 0 and wraps[a] == 0:
            return -1, turn
        at, turn = at * size + here - off * size, 3 * turn + off + 1
    return at, turn


@kernel
def _key(own, other, turn, count):
    # What tells where the slopes of two peaks meet, or that of one and what is free.
    nodes, one = count + SHARED, np.int64(PEAKS - own)
    if other == FREE:
        return (one * nodes + count + OUTSIDE) * TURNS
    if own == FREE:
        return (np.int64(PEAKS - other) * nodes + count + OUTSIDE) * TURNS
    return (one * nodes + np.int64(PEAKS - other)) * TURNS + turn


@kernel
def _look(ranks, peaks, count, wraps, ends, keys, levels, place, last):
    nx, ny, nz = ranks.shape
    stop, i, j = SLOTS, place[0], place[1]
    nodes, flags = count + SHARED, np.empty(nz, np.uint8)
    flat, heights, steps = peaks.reshape(-1), ranks.reshape(-1), np.empty(13, np.int64)
    for s in range(13):
        steps[s] = ((s + 14) // 9 - 1) * ny * nz + ((s + 14) // 3 % 3 - 1) * nz + (s + 14) % 3 - 1
    some, pairs = np.empty(nz, np.int64), np.empty(nz + 1, np.int64)
    while i < last and stop + EACH * nz <= len(keys):
        inner, start, n = i < nx - 1 and 0 < j < ny - 1, (i * ny + j) * nz, 0
        _meeting(peaks, i, j, ends, flags)
        for k in range(nz):
            own = peaks[i, j, k]
            if flags[k] == 0 or own == SOLID:
                continue
            rank, one = ranks[i, j, k], np.int64(PEAKS - own)
            if own != FREE:
                for a, at, size in ((0, i, nx), (1, j, ny), (2, k, nz)):
                    if wraps[a] == 0:
                        if at == 0 or at == size - 1:
                            key = (one * nodes + count + OUTSIDE) * TURNS
                            stop = _note(keys, levels, stop, key, rank)
                        if at == ends[a]:
                            key = (one * nodes + count + LOW + a) * TURNS
                            stop = _note(keys, levels, stop, key, rank)
                        if at == ends[a + 3]:
                            key = (one * nodes + count + HIGH + a) * TURNS
                            stop = _note(keys, levels, stop, key, rank)
            if inner and 0 < k < nz - 1:
                some[n], n = k, n + 1
                continue
            for step in range(14, 27):
                at, turn = _beside((i, j, k), step, ranks.shape, wraps)
                if at < 0 or flat[at] == SOLID or (flat[at] == own and (turn == 13 or own == FREE)):
                    continue
                key = _key(own, flat[at], turn, count)
                stop = _note(keys, levels, stop, key, min(rank, heights[at]))
        for step in steps:
            met = 0
            for c in range(n):
                at = start + some[c]
                pairs[met] = at
                met += (flat[at + step] != SOLID) & (flat[at + step] != flat[at])
            for c in range(met):
                at = pairs[c]
                key = _key(flat[at], flat[at + step], 13, count)
                level = min(heights[at], heights[at + step])
                stop = _note(keys, levels, stop, key, level)
        j += 1
        if j == ny:
            i, j = i + 1, 0
    place[0], place[1] = i, j
    return stop


@kernel
def _root(forest, shifts, peak):
    # The root of a peak, and how many periods off it the peak lies.
    x = y = z = 0
    while forest[peak, 0] != peak:
        above = forest[peak, 0]
        for a in range(3):
            shifts[peak, a] += shifts[above, a]
        forest[peak, 0] = forest[above, 0]
        x, y, z = x + shifts[peak, 0], y + shifts[peak, 1], z + shifts[peak, 2]
        peak = forest[peak, 0]
    return peak, x, y, z


@kernel
def _mark(forest, marks, reached, found, root, what, level):
    # A tree comes to more of the grid's ends, or to the outside: then all its peaks do.
    if (what & ~marks[root]) >> OUTSIDE & 1:
        peak = root
        while reached[peak] == 0:
            reached[peak] = level
            peak = forest[peak, 1]
    marks[root] |= what
    for a in range(3):
        if (marks[root] >> (LOW + a)) & (marks[root] >> (HIGH + a)) & 1 and found[a] == 0:
            found[a] = level


@kernel
def _join(keys, levels, forest, shifts, marks, reached, found):
    # Join peaks, the highest passes first; those that lie a period off themselves go around.
    nodes = len(forest) + SHARED
    for n in range(len(keys)):
        turn, pair, level = keys[n] % TURNS, keys[n] // TURNS, levels[n]
        p, x, y, z = _root(forest, shifts, pair // nodes)
        other = pair % nodes
        if other >= len(forest):
            what = np.uint8(1) << np.uint8(other - len(forest))
            _mark(forest, marks, reached, found, p, what, level)
            continue
        q, a, b, c = _root(forest, shifts, other)
        x, y, z = x + turn // 9 - 1 - a, y + turn // 3 % 3 - 1 - b, z + turn % 3 - 1 - c
        if p == q:
            for axis, off in ((0, x), (1, y), (2, z)):
                if off != 0 and found[axis] == 0:
                    found[axis] = level
            continue
        if q < p:
            p, q, x, y, z = q, p, -x, -y, -z
        what = marks[p] | marks[q]
        _mark(forest, marks, reached, found, p, what, level)
        _mark(forest, marks, reached, found, q, what, level)
        forest[q, 0] = p
        shifts[q, 0], shifts[q, 1], shifts[q, 2] = x, y, z
        # The rings of their peaks become one.
        forest[p, 1], forest[q, 1] = forest[q, 1], forest[p, 1]


@kernel
def _settle(ranks, reached, peaks, first, last):
    _, ny, nz = ranks.shape
    for i in range(first, last):
        for j in range(ny):
            for k in range(nz):
                peak = peaks[i, j, k]
                rank = ranks[i, j, k]
                if peak <= PEAKS:
                    rank = min(rank, reached[PEAKS - peak])
                peaks[i, j, k] = rank
