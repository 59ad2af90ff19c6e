"""Which points of space lie in a body, point by point and not line by line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]


class Bins(NamedTuple):
    """Boxes of equal size, and which pieces may reach into each.

    Bin b in C order holds the pieces ``items[first[b]:first[b + 1]]``; point p lies in bin
    ``(p − lower) · per``, numbers of bins per length, of the ``shape``.
    """

    lower: Floats
    per: Floats
    shape: tuple[int, int, int]
    first: Indices
    items: Indices


@kernel
def _keeps(table, level, x, y, z):
    base = len(table)
    for _ in range(level):
        if not table[x % base, y % base, z % base]:
            return False
        x, y, z = x // base, y // base, z // base
    return True


@kernel
def _in_digits(out, points, table, level, lower, per, slack):
    count = np.int64(len(table)) ** level
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for n in range(len(points)):
        inside = True
        for a in range(3):
            place = (points[n, a] - lower[a]) * per[a]
            if not -slack <= place <= count + slack:
                inside = False
                break
            low[a] = max(np.int64(np.floor(place - slack)), 0)
            high[a] = min(np.int64(np.floor(place + slack)), count - 1)
            low[a] = min(low[a], high[a])
        out[n] = False
        if inside:
            for x in range(low[0], high[0] + 1):
                for y in range(low[1], high[1] + 1):
                    for z in range(low[2], high[2] + 1):
                        out[n] |= _keeps(table, level, x, y, z)


@kernel
def _in_piece(rows, x, y, z, is_round):
    total = 0.0
    for r in range(len(rows)):
        value = rows[r, 0] * x + rows[r, 1] * y + rows[r, 2] * z + rows[r, 3]
        if is_round:
            total += value * value
        elif value > 0.0:
            return False
    return total <= 1.0


@kernel
def _in_pieces(out, points, forms, lower, per, shape, first, items, is_round):
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        i = np.floor((x - lower[0]) * per[0])
        j = np.floor((y - lower[1]) * per[1])
        k = np.floor((z - lower[2]) * per[2])
        out[n] = False
        if min(i, j, k) < 0.0 or i >= shape[0] or j >= shape[1] or k >= shape[2]:
            continue
        b = (np.int64(i) * shape[1] + np.int64(j)) * shape[2] + np.int64(k)
        for m in range(first[b], first[b + 1]):
            if _in_piece(forms[items[m]], x, y, z, is_round):
                out[n] = True
                break


def in_digits(
    points: Floats, table: NDArray[Any], level: int, lower: Floats, per: Floats, slack: float
) -> NDArray[np.bool_]:
    """Tell which points (n, 3) lie in the cells of a level of a digit set.

    Parameters
    ----------
    points
        Any.
    table
        Shape (N, N, N): whether each digit is kept.
    level
        Zero or more; N to its power is the number of cells along an axis.
    lower, per
        The lower corner of the level-0 cell, and cells of the level per length along each axis.
    slack
        Cells are closed, within this part of their edge; below a half.
    """
    result = np.empty(len(points), np.bool_)
    given = source(points, np.float64), source(table, np.bool_)
    _in_digits(result, *given, level, source(lower, np.float64), source(per, np.float64), slack)
    return result


def in_pieces(points: Floats, forms: Floats, bins: Bins, *, is_round: bool) -> NDArray[np.bool_]:
    """Tell which points (n, 3) lie in at least one piece.

    Parameters
    ----------
    points
        Any.
    forms
        Shape (k, r, 4): linear forms r of each piece. A point lies in a piece where all of them are
        zero or less; in one that is round where the sum of their squares is at most one.
    bins
        Which pieces may hold the points of a box.
    is_round
        Whether pieces are ellipsoids.
    """
    result = np.empty(len(points), np.bool_)
    _in_pieces(
        result,
        source(points, np.float64),
        source(forms, np.float64),
        source(bins.lower, np.float64),
        source(bins.per, np.float64),
        bins.shape,
        source(bins.first, np.int64),
        source(bins.items, np.int64),
        is_round,
    )
    return result
