"""The largest ball in a mask that covers each of its voxels, exactly on the lattice of voxels.

A ball about a voxel p holds the voxels nearer to p than the nearest one outside of the mask is.
Balls that a neighbour's holds are dropped by tables of how far a ball reaches from beside its
centre (E. Rémy, E. Thiel, Pattern Recognition Letters 23, 2002); the others are painted by falling
radius, so that the first to reach a voxel is its largest. What is not painted yet are bits, lines
along z of them words, and a ball is a stencil of such words, one for all balls of its radius, that
is laid over several lines at a time.

What a ball adds to that about a neighbour v farther, which is painted before it, lies on the far
side of a plane across v: |x|² < D(0) and |x − v|² ≥ D(v) give 2 x·v < D(0) − D(v) + |v|². So
neighbours across faces bound where its voxels are looked for.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numba
import numba.extending
import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.kernels.distance import Numbers, Squares

    Axes = tuple[bool, bool, bool]
    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]
    Progress = Callable[[int, int], None]

SLAB = 1 << 20
"""Voxels that one kernel call looks at, about."""

PLANES = 32
"""Planes of voxels that one kernel call paints."""

LINES = 8
"""Lines along z, or planes of them, that a stencil is laid over at a time."""

MARGIN = LINES + 1
"""Lines of a stencil that are empty, on either side."""

WORD = 64
"""Voxels along z that a word of bits tells of."""

CLASSES = 1 << 20
"""Squares of radii that tables tell apart, at most."""

SLACK = 1e-9
"""Part of a squared radius by which balls are drawn in, so that rounding joins no voxel to them."""

FREE = 127
"""Of limits the first that is none, on the upper side; on the lower it is -FREE - 1."""


class _Balls(NamedTuple):
    """Balls by falling radius, and in the order of their centres' voxels where radii agree.

    ``table`` (n, 5) is the centre's voxel and between what steps along x, and along y, a ball may
    hold voxels that none before it does, as ``_limits`` tells; ``starts[m]`` is the first ball with
    the square ``squares[m]``.
    """

    table: Integers
    starts: Integers
    squares: Floats


def largest_balls(
    squares: Squares, *, periodic: Axes = (False, False, False), progress: Progress | None = None
) -> Numbers:
    """Return the squared radius of the largest ball that covers each voxel of a mask.

    Parameters
    ----------
    squares
        What ``squared_distances`` found, in a mask of which something lies outside.
    periodic
        Axes along which the grid closes on itself.
    progress
        Called as ``progress(done, count)`` in planes of voxels; raising in it cancels.

    Returns
    -------
    Like ``squares.values``, in its units: 0 outside of the mask.
    """
    given = source(squares.values, squares.values.dtype)
    result = np.zeros_like(squares.values)
    wraps = np.array(periodic, np.int64)
    balls = _balls(given, squares.weights, wraps)
    inner = balls.squares - 0.5 if _whole(given) else balls.squares * (1 - SLACK)

    def paint(a: int, b: int) -> None:
        _paint(given, *balls, inner, squares.weights, wraps, result, a, b)

    slabs(len(given), PLANES, paint, progress)
    return result


def _planes(shape: tuple[int, ...]) -> int:
    return max(1, SLAB // (shape[1] * shape[2]))


def _whole(given: Numbers) -> bool:
    return given.dtype.kind in "iu"


def _balls(given: Numbers, weights: Floats, wraps: Integers) -> _Balls:
    """Return the balls that no neighbour's ball holds."""
    largest = float(given.max(initial=0))
    width = max(1.0, math.ceil(largest / CLASSES)) if _whole(given) else largest / 2**16
    needs = np.zeros((math.ceil(largest / max(width, 1e-300)) + 2, 8), given.dtype)
    half = 0.5 if _whole(given) else 0.0
    top = float(np.iinfo(given.dtype.name).max) if _whole(given) else math.inf
    _reaches(weights, width, half, top, needs)
    scale = (half, 1 / max(width, 1e-300))
    found: dict[int, tuple[Integers, Numbers]] = {}
    dtype = np.int16 if max(given.shape) < 1 << 15 else np.int32
    planes = _planes(given.shape)
    spare: list[tuple[Integers, Numbers]] = []

    def prune(a: int, b: int) -> None:
        try:
            table, radii = spare.pop()
        except IndexError:
            room = planes * given[0].size
            table, radii = np.empty((room, 5), dtype), np.empty(room, given.dtype)
        count = _prune(given, needs, scale, weights, wraps, table, radii, a, b)
        found[a] = table[:count].copy(), radii[:count].copy()
        spare.append((table, radii))

    slabs(given.shape[0], planes, prune)
    spare.clear()
    return _sorted([found.pop(a) for a in sorted(found)], largest)


def _sorted(parts: list[tuple[Integers, Numbers]], largest: float) -> _Balls:
    """Return balls by falling radius, of those of parts; the list of these is used up."""
    values = _falling([radii for _, radii in parts], largest)
    counts = np.zeros(len(values), np.int64)
    for _, radii in parts:
        counts += np.bincount(_ranks(radii, values), minlength=len(values))
    ends = np.cumsum(counts)
    places, some = ends - counts, counts > 0
    table = np.empty((int(counts.sum()), 5), parts[0][0].dtype)
    while parts:
        rows, radii = parts.pop(0)
        _place(rows, _ranks(radii, values), places, table)
    return _Balls(
        source(table, table.dtype),
        source(np.concatenate([[0], ends[some]]), np.int64),
        source(values[some], np.float64),
    )


def _falling(radii: list[Numbers], largest: float) -> NDArray[Any]:
    """Return the squares that there are, falling; all numbers down from small whole ones."""
    if _whole(radii[0]) and largest < CLASSES:
        return np.arange(int(largest), 0, -1)
    return np.unique(np.concatenate(radii))[::-1]


def _ranks(radii: Numbers, values: NDArray[Any]) -> Integers:
    """Return where squares stand in a falling row of such."""
    if _whole(radii) and len(values) and values[0] == len(values):
        return np.subtract(len(values), radii, dtype=np.int64)
    return np.asarray(len(values) - 1 - np.searchsorted(values[::-1], radii), np.int64)


@numba.extending.intrinsic
def _lowest_bit(_typing, word):
    """Return the place of the lowest set bit of a word that is not zero."""

    def generate(context, builder, _signature, arguments):
        return builder.cttz(arguments[0], context.get_constant(numba.boolean, 1))

    return word(word), generate


@kernel
def _place(rows, keys, places, table):
    # Put rows where those with the same key go on, and count them.
    for n in range(len(rows)):
        for column in range(rows.shape[1]):
            table[places[keys[n]], column] = rows[n, column]
        places[keys[n]] += 1


@kernel
def _reaches(weights, width, half, most, needs):
    # needs[b, v - 1]: how large the square of a ball about v must be, one of the seven steps to
    # neighbours, if it is to hold all balls of class b about 0. That is more than the largest
    # square of x - v over the x of such balls; x and v point away from each other.
    top = len(needs) - 1
    reach = np.zeros(needs.shape, np.float64)
    end = top * width
    for i in range(np.int64(np.sqrt(end / weights[0])) + 1):
        for j in range(np.int64(np.sqrt(end / weights[1])) + 1):
            k, plane = 0, weights[0] * i * i + weights[1] * j * j
            while plane + weights[2] * k * k < end:
                b = np.int64((plane + weights[2] * k * k) / width)
                for v in range(1, 8):
                    x, y, z = i + (v >> 2), j + ((v >> 1) & 1), k + (v & 1)
                    square = weights[0] * x * x + weights[1] * y * y + weights[2] * z * z
                    reach[b, v - 1] = max(reach[b, v - 1], square)
                k += 1
    for b in range(top + 1):
        for v in range(7):
            if b > 0:
                reach[b, v] = max(reach[b, v], reach[b - 1, v])
            need = reach[b, v] + 1.0 if half else reach[b, v] * (1.0 + 2.0 * SLACK)
            needs[b, v] = min(need, most)


@kernel
def _prune(squares, needs, scale, weights, wraps, table, radii, first, last):
    # Write down the balls of some planes that no neighbour's ball holds; return their number.
    ny, nz = squares.shape[1:]
    size, line = (ny + 2) * (nz + 2), nz + 2
    around = np.zeros(3 * size, squares.dtype)
    most = np.zeros((7, nz), squares.dtype)
    count = 0
    for i in range(first - 1, last + 1):
        _plane(squares, i, wraps, around, (i + 1) % 3 * size)
        if i <= first:
            continue
        low, here, high = (i - 1) % 3 * size, i % 3 * size, (i + 1) % 3 * size
        for j in range(ny):
            row = (j + 1) * line + 1
            _neighbours(around, (low + row, here + row, high + row), line, most)
            for k in range(nz):
                radius = around[here + row + k]
                if radius == 0:
                    continue
                b = np.int64((radius - scale[0]) * scale[1])
                held = most[0, k] >= needs[b, 0]
                for v in range(1, 7):
                    held |= most[v, k] >= needs[b, v]
                if held:
                    continue
                # Of balls as large, those whose voxel comes first are painted first.
                at = here + row + k
                beside = around[low + row + k], around[high + row + k]
                x = _limits(radius, beside, i > 1, weights[0], scale[0])
                beside = around[at - line], around[at + line]
                y = _limits(radius, beside, j > 0, weights[1], scale[0])
                z = _limits(radius, (around[at - 1], around[at + 1]), k > 0, weights[2], scale[0])
                if _some(x) and _some(y) and _some(z):
                    radii[count] = radius
                    table[count, 0], table[count, 1], table[count, 2] = i - 1, j, k
                    table[count, 3], table[count, 4] = x, y
                    count += 1
    return count


@kernel
def _limits(radius, beside, tie, weight, half):
    # Between what steps along an axis a ball may hold voxels that larger ones, beside it to either
    # side, do not hold; one as large counts where ``tie`` says so, on the lower side only. Both in
    # 16 bits: limits beyond what fits are drawn out to it, or there are none.
    loose, part = 0.0 if half else 1e-3, 0.5 / weight
    low = np.ceil((np.float64(radius) - beside[0] + weight) * part + loose) - 1.0
    high = np.ceil((np.float64(radius) - beside[1] + weight) * part + loose) - 1.0
    low = low if beside[0] > radius or (tie and beside[0] == radius) else FREE + 1
    high = high if beside[1] > radius else FREE
    low, high = max(-FREE, min(low, FREE + 1)), max(-FREE - 1, min(high, FREE))
    return -np.int64(low) * 256 + np.int64(high) + FREE + 1


@kernel
def _some(limits):
    return limits >> 8 <= (limits & 255) - FREE - 1


@kernel
def _within(limits, reach):
    # Limits, and that of the ball itself.
    low, high = np.int64(limits) >> 8, (np.int64(limits) & 255) - FREE - 1
    low = -reach if low == -FREE - 1 else max(low, -reach)
    return low, reach if high == FREE else min(high, reach)


@kernel
def _plane(squares, i, wraps, around, start):
    # A plane with a margin: of zeros, or of what lies at the other end.
    nx, ny, nz = squares.shape
    if wraps[0]:
        i = (i + nx) % nx
    for j in range(-1, ny + 1):
        to = start + (j + 1) * (nz + 2)
        row = (j + ny) % ny
        if i < 0 or i >= nx or (row != j and not wraps[1]):
            around[to : to + nz + 2] = 0
            continue
        for k in range(nz):
            around[to + 1 + k] = squares[i, row, k]
        around[to] = squares[i, row, nz - 1] if wraps[2] else 0
        around[to + nz + 1] = squares[i, row, 0] if wraps[2] else 0


@kernel
def _neighbours(around, rows, line, most):
    # The largest of the two, four or eight neighbours at each of seven steps, all along a line:
    # one loop for each, that many voxels are done at once.
    low, here, high = rows
    below, level, above = np.uint64(low - line), np.uint64(low), np.uint64(low + line)
    before, at, behind = np.uint64(here - line), np.uint64(here), np.uint64(here + line)
    under, flush, over = np.uint64(high - line), np.uint64(high), np.uint64(high + line)
    one = np.uint64(1)
    for c in range(most.shape[1]):
        k = np.uint64(c)
        most[0, c] = max(around[at + k - one], around[at + k + one])
    for c in range(most.shape[1]):
        k = np.uint64(c)
        most[1, c] = max(around[before + k], around[behind + k])
    for c in range(most.shape[1]):
        k = np.uint64(c)
        a = max(around[before + k - one], around[before + k + one])
        most[2, c] = max(a, around[behind + k - one], around[behind + k + one])
    for c in range(most.shape[1]):
        k = np.uint64(c)
        most[3, c] = max(around[level + k], around[flush + k])
    for c in range(most.shape[1]):
        k = np.uint64(c)
        a = max(around[level + k - one], around[level + k + one])
        most[4, c] = max(a, around[flush + k - one], around[flush + k + one])
    for c in range(most.shape[1]):
        k = np.uint64(c)
        a = max(around[below + k], around[above + k])
        most[5, c] = max(a, around[under + k], around[over + k])
    for c in range(most.shape[1]):
        k = np.uint64(c)
        a = max(around[below + k - one], around[below + k + one])
        b = max(around[above + k - one], around[above + k + one])
        a = max(a, around[under + k - one], around[under + k + one])
        most[6, c] = max(a, b, around[over + k - one], around[over + k + one])


@kernel
def _paint(squares, table, starts, values, inner, weights, wraps, out, first, last):
    shape = squares.shape
    across = (weights[1], weights[0], weights[2])
    reach = _reach(inner[0], weights)
    words = _words(reach)
    # Lines of words: those of the grid, and those that a ball may reach beyond them.
    lines = -(-shape[2] // WORD) + 2 * words + 1
    beams = -(-shape[1] // LINES)
    free = np.zeros((last - first) * lines * beams * LINES, np.uint64)
    some = np.zeros(beams * lines * (last - first) + LINES, np.uint64)
    left = _free(squares, free, some, (lines, beams, words), first, last)
    stencil = np.zeros((reach[0] + 1) * words * (2 * reach[1] + 1 + 2 * MARGIN), np.uint64)
    profile = np.zeros((reach[1] + 1) * words * (2 * reach[0] + 1 + 2 * MARGIN), np.uint64)
    highs, wides = np.zeros(reach[0] + 1, np.int64), np.zeros(reach[1] + 1, np.int64)
    flat = out.reshape(-1)
    sizes = (first, last, lines, beams, words)
    for n in range(len(values)):
        if left == 0:
            break
        reach = _reach(inner[n], weights)
        a, b = starts[n], starts[n + 1]
        if not wraps[0]:
            a = _first(table, a, starts[n + 1], first - reach[0])
            b = _first(table, a, starts[n + 1], last + reach[0])
        if a == b:
            continue
        _draw(inner[n], weights, reach, stencil, highs)
        _draw(inner[n], across, (reach[1], reach[0], reach[2]), profile, wides)
        drawn = (reach, stencil, highs, profile, wides)
        value = out.dtype.type(values[n])
        left -= _lay(table[a:b], shape, wraps, sizes, drawn, value, free, some, flat)


@kernel
def _first(table, a, b, x):
    # The first of some balls, by rising x, whose centre is not before x.
    while a < b:
        half = (a + b) // 2
        if table[half, 0] < x:
            a = half + 1
        else:
            b = half
    return a


@kernel
def _reach(most, weights):
    # How many voxels a ball reaches from its centre, along each axis.
    x, y = np.int64(np.sqrt(most / weights[0])), np.int64(np.sqrt(most / weights[1]))
    return x, y, np.int64(np.sqrt(most / weights[2]))


@kernel
def _words(reach):
    # How many words hold a ball's longest line.
    return (2 * reach[2] + WORD) // WORD


@kernel
def _images(at, reach, n, wraps):
    # Where the images of a centre lie whose ball reaches into the grid: a range of step n. Along
    # axes that close on themselves there is one about every period.
    if not wraps:
        return at, at + 1
    return at - (at + reach) // n * n, at + (n - 1 + reach - at) // n * n + 1


@kernel
def _free(squares, free, some, sizes, first, last):
    # Set the bits of all voxels of the mask, and of what eight lines have together; return their
    # number. Lines side by side along y follow each other in ``free``, planes in ``some``.
    lines, beams, words = sizes
    _, ny, nz = squares.shape
    count = 0
    for i in range(first, last):
        for j in range(ny):
            for start in range(0, nz, WORD):
                bits = np.uint64(0)
                for k in range(min(WORD, nz - start)):
                    one = np.uint64(squares[i, j, start + k] != 0)
                    bits |= one << np.uint64(k)
                    count += np.int64(one)
                line = words + start // WORD
                free[((i - first) * lines + line) * beams * LINES + j] = bits
                some[(j // LINES * lines + line) * (last - first) + i - first] |= bits
    return count


@kernel
def _draw(most, weights, reach, stencil, extents):
    # The lines of a ball as bits, by step along the first axis, word, and step along the second,
    # and how many lines it has there to either side. Lines beyond the last are empty.
    words, row = _words(reach), 2 * reach[1] + 1 + 2 * MARGIN
    every, centre = ~np.uint64(0), words * WORD // 2 - 1
    for i in range(reach[0] + 1):
        plane = max(0.0, most - weights[0] * i * i)
        extents[i] = np.int64(np.sqrt(plane / weights[1]))
        for w in range(words):
            middle = (i * words + w) * row + MARGIN + extents[i]
            for j in range(extents[i] + 1):
                deep = np.int64(np.sqrt(max(0.0, plane - weights[1] * j * j) / weights[2]))
                low, top = max(0, centre - deep - w * WORD), min(WORD - 1, centre + deep - w * WORD)
                bits = np.uint64(0)
                if low <= top:
                    bits = (every >> np.uint64(WORD - 1 - top)) & (every << np.uint64(low))
                stencil[middle + j] = bits
                stencil[middle - j] = bits
            for j in range(extents[i] + 1, extents[i] + 1 + MARGIN):
                stencil[middle + j] = 0
                stencil[middle - j] = 0


@kernel
def _lay(table, shape, wraps, sizes, drawn, value, free, some, out):
    # Paint what is free in balls of one size, and return how much: look at what eight lines of a
    # plane have together, of eight planes at a time, and then at those lines. A line of a ball
    # begins anywhere in a word, so there are two of each.
    first, last, lines, beams, margin = sizes
    reach, stencil, highs, profile, wides = drawn
    words = _words(reach)
    row, tall = 2 * reach[0] + 1 + 2 * MARGIN, 2 * reach[1] + 1 + 2 * MARGIN
    one = np.uint64(1)
    done = 0
    for ball in range(len(table)):
        x0, x1 = _images(np.int64(table[ball, 0]), reach[0], shape[0], wraps[0])
        y0, y1 = _images(np.int64(table[ball, 1]), reach[1], shape[1], wraps[1])
        z0, z1 = _images(np.int64(table[ball, 2]), reach[2], shape[2], wraps[2])
        x_low, x_high = _within(table[ball, 3], reach[0])
        y_low, y_high = _within(table[ball, 4], reach[1])
        for x in range(x0, x1, shape[0]):
            for y in range(y0, y1, shape[1]):
                for z in range(z0, z1, shape[2]):
                    bit = z - (words * WORD // 2 - 1)
                    line = margin + (bit >> 6)
                    shift, back = np.uint64(bit & 63), np.uint64(63 - (bit & 63))
                    for beam in range(
                        max(y + y_low, 0) // LINES, min(y + y_high, shape[1] - 1) // LINES + 1
                    ):
                        near = beam * LINES - y
                        near = max(0, near, -near - LINES + 1)
                        wide = wides[near]
                        low, top = max(x_low, first - x, -wide), min(x_high, last - 1 - x, wide)
                        for w in range(words):
                            here = (beam * lines + line + w) * (last - first) + x - first
                            form = (near * words + w) * row + MARGIN + wide
                            for i in range(low, top + 1, LINES):
                                a, b = np.uint64(here + i), np.uint64(here + i + last - first)
                                m = np.uint64(form + i)
                                ahead = np.uint64(0)
                                for c in range(LINES):
                                    k = np.uint64(c)
                                    bits = (some[a + k] >> shift) | ((some[b + k] << one) << back)
                                    ahead |= np.uint64(bits & profile[m + k] != 0) << k
                                ahead &= (one << np.uint64(min(LINES, top + 1 - i))) - one
                                while ahead:
                                    c = np.int64(_lowest_bit(ahead))
                                    ahead &= ahead - one
                                    step = abs(i + c)
                                    start = ((x + i + c - first) * lines + line + w) * beams + beam
                                    p = np.uint64(start * LINES)
                                    q = np.uint64((start + beams) * LINES)
                                    lay = np.uint64(
                                        (step * words + w) * tall
                                        + MARGIN
                                        + highs[step]
                                        + beam * LINES
                                        - y
                                    )
                                    found = np.uint64(0)
                                    for d in range(LINES):
                                        e = np.uint64(d)
                                        bits = (free[p + e] >> shift) | (
                                            (free[q + e] << one) << back
                                        )
                                        found |= np.uint64(bits & stencil[lay + e] != 0) << e
                                    if found == 0:
                                        continue
                                    to = (x + i + c) * shape[1] + beam * LINES
                                    to = to * shape[2] + bit + w * WORD
                                    while found:
                                        d = np.int64(_lowest_bit(found))
                                        found &= found - one
                                        e = np.uint64(d)
                                        bits = (free[p + e] >> shift) | (
                                            (free[q + e] << one) << back
                                        )
                                        bits &= stencil[lay + e]
                                        free[p + e] &= ~(bits << shift)
                                        free[q + e] &= ~((bits >> one) >> back)
                                        while bits:
                                            place = to + d * shape[2] + np.int64(_lowest_bit(bits))
                                            out[np.uint64(place)] = value
                                            bits &= bits - one
                                            done += 1
                                    k, bits, found = np.uint64(c), np.uint64(0), np.uint64(0)
                                    for d in range(LINES):
                                        bits |= free[p + np.uint64(d)]
                                        found |= free[q + np.uint64(d)]
                                    some[a + k], some[b + k] = bits, found
    return done
