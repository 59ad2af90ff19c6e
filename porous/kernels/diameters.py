"""How wide the largest balls are: between walls, not between voxels, and voxel by voxel."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.kernels.distance import Numbers, Squares

    Axes = tuple[bool, bool, bool]
    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

SLAB = 1 << 20
"""Voxels that one kernel call looks at, about."""

CLASSES = 1 << 20
"""Squares of radii that stand in a row of their own, at most."""

SLACK = 1e-9
"""Part of a length by which two may differ and be the same."""

NEAR = 2
"""How far, in voxels, ``smallest`` looks about."""

FINE = 1 << 24
"""Parts of a voxel that are added up, as whole numbers: sums do not depend on their order."""

LEVEL = 0.25
"""The part of places between walls about which distances are level: of flat walls that much."""

BESIDE = 0.65
"""Along diagonals the nearest voxel of a wall may lie beside the line: half a square of a voxel, or
two thirds, by which distances fall less than one goes."""

STEEP = 0.5
"""Distances rise at the sine of half the angle of a wedge: these are of 60° and less."""


def smallest(squares: Squares, balls: Numbers, *, periodic: Axes, walled: bool) -> float:
    """Return the least of ``balls`` on the ridge of the distances, infinite where there is none.

    A voxel is on the ridge where no voxel within ``NEAR`` of it lies deeper by ``STEEP`` of their
    distance or more: the walls about it face each other, or taper at 60° at most. Where nothing is
    known beyond a side (not ``walled``), voxels next to it are left out.
    """
    given, found = source(squares.values, squares.values.dtype), np.full(len(balls), np.inf)
    wraps, told = np.array(periodic, np.int64), source(balls, balls.dtype)

    def search(a: int, b: int) -> None:
        _ridge(given, told, squares.weights, wraps, int(walled), found, a, b)

    slabs(len(balls), _planes(balls.shape), search)
    return float(found.min())


class Widths(NamedTuple):
    """How wide balls are about places that are no voxels' centres: half of that, by square.

    ``squares`` are those that balls have, ascending, and ``radii`` do not fall.
    """

    squares: Floats
    radii: Floats


def widths(squares: Squares, balls: Numbers, periodic: Axes) -> Widths:
    """Return by how much balls about voxels are too small or too large, by their size.

    A ball about the centre of a voxel misses the middle between walls by up to half a voxel, and
    ends at the centre of a voxel that lies beyond the wall. The middle follows from how distances
    fall to either side of a voxel that no larger ball covers, across the walls, that is along that
    of 13 lines on which they fall most: of a tent that falls by a and b ≤ a, the top is (a − b)/2
    higher. Where they fall as fast as one goes, and at a quarter of the places or more not at all
    along another line, the wall is flat and lies along a plane of voxels: half of the distance of
    such planes is too much. What is found is averaged over balls of one size.

    Parameters
    ----------
    squares, balls
        What ``squared_distances`` and ``largest_balls`` found.
    periodic
        Axes along which the grid closes on itself.

    Returns
    -------
    Widths
    """
    given, told = source(squares.values, squares.values.dtype), source(balls, balls.dtype)
    direct = _direct(told)
    # Sums of the same squares in another order differ in their last digits: these are one class.
    squared = source(different(told), np.float64)
    shape, wraps = (4, len(squared)), np.array(periodic, np.int64)
    found: list[Integers] = []

    def look(a: int, b: int) -> None:
        sums = np.zeros(shape, np.int64)
        _tops(given, told, squared, int(direct), squares.weights, wraps, sums, a, b)
        found.append(sums)

    slabs(len(told), _planes(told.shape), look)
    rises, walls, level, count = np.sum(found, axis=0)
    roots, some = np.sqrt(squared), np.flatnonzero(count)
    over = (rises - np.where(level >= LEVEL * count, walls, 0))[some] / (count[some] * float(FINE))
    rise = np.interp(roots, roots[some], over)
    return Widths(squared, np.maximum.accumulate(np.maximum(roots + rise, 0.5 * roots)))


def different(squares: Numbers) -> Floats:
    """Return squares above zero that balls have, ascending; all numbers up to small whole ones."""
    if _direct(squares):
        return np.arange(1.0, float(squares.max()) + 1)
    return np.unique(squares[squares > 0].astype(np.float32)).astype(np.float64)


def half_widths(squares: Numbers | Floats | np.float64, wide: Widths) -> Floats:
    """Return half of how wide balls of any squares are, also of such as no ball has."""
    roots = np.append(0.0, np.sqrt(wide.squares))
    told = np.interp(np.sqrt(squares, dtype=np.float64), roots, np.append(0.0, wide.radii))
    return np.asarray(told, np.float64)


class Tally(NamedTuple):
    """Diameters, voxel by voxel, and how many of the voxels that count have which diameter."""

    diameters: NDArray[np.float32]
    sizes: Floats
    counts: Integers


def tally(balls: Numbers, counted: NDArray[np.bool_], wide: Widths, step: float) -> Tally:
    """Return the diameters of balls, and how often each occurs among the voxels that count.

    Parameters
    ----------
    balls
        What ``largest_balls`` found.
    counted
        Which voxels count, bool.
    wide
        How wide they are.
    step
        The unit of length in which that is.
    """
    given, some = source(balls, balls.dtype), source(counted, np.bool_).view(np.uint8)
    diameters = np.empty(given.shape, np.float32)
    sizes = np.concatenate([[0.0], 2 * step * wide.radii])
    counts: list[Integers] = []
    # Whole numbers in a row are their own places, also of those with larger ones beyond them.
    direct = int(_direct(given) and wide.squares[-1] == len(wide.squares))

    def look(a: int, b: int) -> None:
        found = np.zeros(len(sizes), np.int64)
        _tally(given, some, wide.squares, direct, sizes, diameters, found, a, b)
        counts.append(found)

    slabs(len(given), _planes(given.shape), look)
    number = np.sum(counts, axis=0)
    told, which = np.unique(sizes[number > 0], return_inverse=True)
    found = np.bincount(which, number[number > 0]).astype(np.int64)
    return Tally(diameters, told, found)


def _direct(balls: Numbers) -> bool:
    """Tell whether squares are so small whole numbers that they are places in a row."""
    return balls.dtype.kind in "iu" and float(balls.max(initial=0)) < CLASSES


def _planes(shape: tuple[int, ...]) -> int:
    return max(1, SLAB // (shape[1] * shape[2]))


@kernel
def _tally(balls, counted, classes, direct, sizes, diameters, counts, first, last):
    for i in range(first, last):
        for j in range(balls.shape[1]):
            for k in range(balls.shape[2]):
                at = np.int64(balls[i, j, k])
                if not direct and balls[i, j, k] > 0:
                    at = 1 + _class(classes, balls[i, j, k])
                diameters[i, j, k] = sizes[at]
                counts[at] += counted[i, j, k]


@kernel
def _class(classes, square):
    # Where a square stands in an ascending row of such, rounded as they are.
    a, b, rounded = 0, len(classes), np.float64(np.float32(square))
    while a < b:
        half = (a + b) // 2
        if classes[half] < rounded:
            a = half + 1
        else:
            b = half
    return a


@kernel
def _tops(squares, balls, classes, direct, weights, wraps, sums, first, last):
    # Add up how much higher than at voxels that no larger ball covers distances are close by, how
    # far beyond a flat wall they end, at how many they are level along a line, and all of them.
    shape = squares.shape
    beside = np.zeros(2, np.float64)
    for i in range(first, last):
        for j in range(shape[1]):
            for k in range(shape[2]):
                if squares[i, j, k] == 0 or squares[i, j, k] != balls[i, j, k]:
                    continue
                middle, best, rise = np.sqrt(np.float64(squares[i, j, k])), 0.0, 0.0
                before, level = 0.0, False
                for step in range(14, 27):
                    x, y, z = step // 9 - 1, step // 3 % 3 - 1, step % 3 - 1
                    inside = True
                    for side in range(2):
                        a, b, c = i + (x, -x)[side], j + (y, -y)[side], k + (z, -z)[side]
                        if wraps[0]:
                            a %= shape[0]
                        if wraps[1]:
                            b %= shape[1]
                        if wraps[2]:
                            c %= shape[2]
                        if 0 <= a < shape[0] and 0 <= b < shape[1] and 0 <= c < shape[2]:
                            beside[side] = middle - np.sqrt(np.float64(squares[a, b, c]))
                            # Pores beyond the bulk have no balls.
                            inside &= balls[a, b, c] > 0 or squares[a, b, c] == 0
                        else:
                            inside = False
                    length = np.sqrt(weights[0] * x * x + weights[1] * y * y + weights[2] * z * z)
                    high, low = max(beside[0], beside[1]), min(beside[0], beside[1])
                    if not inside:
                        continue
                    level |= max(high, -low) < SLACK * length
                    if high < (best - SLACK) * length:
                        continue
                    more, wall, axes = 0.5 * (high - max(low, 0.0)), 0.0, abs(x) + abs(y) + abs(z)
                    least = 1.0 - (SLACK if axes == 1 else BESIDE / middle**2)
                    if high >= least * length:
                        wall = 0.5 * length / axes
                    # Of lines along which they fall alike, that with the lowest top.
                    if high > (best + SLACK) * length or more - wall < rise - before:
                        rise, before = more, wall
                    best = max(best, high / length)
                at = np.int64(squares[i, j, k]) - 1
                if not direct:
                    at = _class(classes, squares[i, j, k])
                sums[0, at] += np.int64(np.rint(rise * FINE))
                sums[1, at] += np.int64(np.rint(before * FINE))
                sums[2, at] += np.int64(level)
                sums[3, at] += 1


@kernel
def _ridge(squares, balls, weights, wraps, walled, found, first, last):
    shape = squares.shape
    for i in range(first, last):
        for j in range(shape[1]):
            for k in range(shape[2]):
                square = np.float64(squares[i, j, k])
                if balls[i, j, k] == 0 or balls[i, j, k] >= found[i]:
                    continue
                depth, lowest = np.sqrt(square), True
                if 0 < i < shape[0] - 1 and 0 < j < shape[1] - 1 and 0 < k < shape[2] - 1:
                    # Most are told by the voxels across their faces.
                    x = max(squares[i - 1, j, k], squares[i + 1, j, k])
                    y = max(squares[i, j - 1, k], squares[i, j + 1, k])
                    z = max(squares[i, j, k - 1], squares[i, j, k + 1])
                    lowest = x < (depth + STEEP * np.sqrt(weights[0])) ** 2
                    lowest &= y < (depth + STEEP * np.sqrt(weights[1])) ** 2
                    lowest &= z < (depth + STEEP * np.sqrt(weights[2])) ** 2
                if not lowest:
                    continue
                for x in range(-NEAR, NEAR + 1):
                    for y in range(-NEAR, NEAR + 1):
                        for z in range(-NEAR, NEAR + 1):
                            a, b, c = i + x, j + y, k + z
                            if wraps[0]:
                                a %= shape[0]
                            if wraps[1]:
                                b %= shape[1]
                            if wraps[2]:
                                c %= shape[2]
                            beyond = a < 0 or b < 0 or c < 0
                            beyond |= a >= shape[0] or b >= shape[1] or c >= shape[2]
                            if beyond:
                                lowest &= walled == 1
                                continue
                            step = weights[0] * x * x + weights[1] * y * y + weights[2] * z * z
                            if step and np.sqrt(
                                np.float64(squares[a, b, c])
                            ) >= depth + STEEP * np.sqrt(step):
                                lowest = False
                        if not lowest:
                            break
                    if not lowest:
                        break
                if lowest:
                    found[i] = balls[i, j, k]
