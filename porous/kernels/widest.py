"""Widest ways in: the largest ball whose centre can come from outside to each voxel of a mask.

A flood that always goes on from where it came with the largest ball (R. E. Pollack, Operations
Research 8, 1960): the first way on which it meets a voxel is the widest one, so that each is
queued once, in a bucket of its ball's square. Voxels are joined by faces, edges and corners.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.kernels.distance import Numbers, Squares

    Axes = tuple[bool, bool, bool]
    Floats = NDArray[np.float64]
    Progress = Callable[[int, int], None]

SLAB = 1 << 19
"""Voxels that one kernel call looks at, about."""

LEVELS = 1 << 22
"""Squares that a flood tells apart, at most."""

TIE = 1e-12
"""Squares that differ by this part of them are the same, but for rounding."""

MESH = 3
"""Every how many voxels, along each axis, a ball stays where all about it are as large."""


def widest(
    squares: Squares,
    outside: NDArray[np.bool_],
    *,
    periodic: Axes = (False, False, False),
    progress: Progress | None = None,
) -> Numbers:
    """Return the largest ball's square that can come from outside to each voxel of a mask.

    A ball about a voxel reaches to the nearest voxel outside of the mask. A centre goes from voxel
    to voxel by faces, edges and corners, and the ball that comes along a way is the least there.

    Parameters
    ----------
    squares
        What ``squared_distances`` found, in a mask of which something lies outside.
    outside
        bool, shape (x, y, z): voxels at which ways begin, at the side of the grid for instance.
        Those that are not in the mask do not matter.
    periodic
        Axes along which the grid closes on itself.
    progress
        Called as ``progress(done, count)`` in voxels; raising in it cancels.

    Returns
    -------
    Like ``squares.values``, in its units: 0 outside of the mask, and where no way leads. Where
    there are more than four million squares, which takes balls of hundreds of voxels, they are
    drawn in to four million levels.
    """
    given = source(squares.values, squares.values.dtype)
    levels = _levels(squares)
    state = np.empty(given.shape, np.int32)
    wraps = np.array(periodic, np.int64)
    most = int(given.max(initial=0)) if levels is None else len(levels)
    nexts = np.empty(given.size, np.int32 if given.size < 1 << 31 else np.int64)
    heads = np.full(most + 1, -1, nexts.dtype)
    _rank_all(given, levels, state)
    begin = source(outside, np.bool_).view(np.uint8)
    count = int(np.count_nonzero(given))
    place = np.array([most, 0], np.int64)  # the level, and how many voxels are done
    flat = state.reshape(-1)
    for a in range(0, given.shape[0], _planes(given.shape)):
        _begin(begin, state, nexts, heads, a, min(given.shape[0], a + _planes(given.shape)))
    while place[0] > 0:
        _flood(flat, given.shape, wraps, nexts, heads, place, SLAB)
        if progress is not None:
            progress(int(place[1]), count)
    np.maximum(state, 0, out=state)
    if levels is None:
        return state.astype(given.dtype, copy=False)
    return np.concatenate([[0.0], levels])[state].astype(given.dtype, copy=False)


def thinned(squares: Squares, ways: Numbers, *, periodic: Axes = (False, False, False)) -> Squares:
    """Return balls that cover what those of ``ways`` do, but for voxels that are centres of one.

    Behind a neck all balls are as large as the neck. Where those of a voxel's neighbours are no
    smaller, its own is held by theirs and by those where they come to an end, for a straight way
    from its centre to a voxel that it holds leaves them there, nearer to that voxel. Such balls
    shrink to their centres, but for some that hold their neighbours' centres.

    Parameters
    ----------
    squares
        Of the mask.
    ways
        What ``widest`` found in it.
    periodic
        Axes along which the grid closes on itself.

    Returns
    -------
    Squares
        A voxel's largest ball of ``ways`` is the larger of its own and of the largest of these.
    """
    given, told = source(squares.values, squares.values.dtype), source(ways, ways.dtype)
    result, wraps = np.empty_like(ways), np.array(periodic, np.int64)

    def thin(a: int, b: int) -> None:
        _thin(given, told, wraps, result, a, b)

    slabs(given.shape[0], _planes(given.shape), thin)
    return squares._replace(values=result)


def _rank_all(given: Numbers, levels: Floats | None, state: NDArray[np.int32]) -> None:
    """Set each voxel's level, below zero for no way has been found yet."""
    if levels is None:
        np.negative(given, out=state)
        return
    classes = 1 << 16
    width = float(levels[-1]) * (1 + 2 * TIE) / classes
    starts = np.searchsorted(levels, np.arange(classes + 1) * width, side="right").astype(np.int64)
    bounds = source(np.append(levels, np.inf), np.float64)

    def rank(a: int, b: int) -> None:
        _rank(given, bounds, starts, width, state, a, b)

    slabs(given.shape[0], _planes(given.shape), rank)


def levels_of(squares: Squares) -> Floats:
    """Return squares that can occur in a mask, ascending, the largest that does among them.

    All of them, but where there are more than four million.
    """
    levels = _levels(squares)
    return np.arange(1.0, squares.values.max(initial=0) + 1) if levels is None else levels


def _levels(squares: Squares) -> Floats | None:
    """Return the squares that can occur, ascending, or None for all whole numbers."""
    largest = float(squares.values.max(initial=0))
    if squares.values.dtype.kind == "i" and largest <= LEVELS:
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


def _planes(shape: tuple[int, ...]) -> int:
    return max(1, SLAB // (shape[1] * shape[2]))


@kernel
def _rank(squares, levels, starts, width, state, first, last):
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
                state[i, j, k] = -rank


@kernel
def _begin(outside, state, nexts, heads, first, last):
    _, ny, nz = state.shape
    for i in range(first, last):
        for j in range(ny):
            for k in range(nz):
                if outside[i, j, k] and state[i, j, k] < 0:
                    level = -state[i, j, k]
                    state[i, j, k] = level
                    voxel = (i * ny + j) * nz + k
                    nexts[voxel] = heads[level]
                    heads[level] = voxel


@kernel
def _flood(state, shape, wraps, nexts, heads, place, most):
    # Go on with the largest balls: below zero is what no way has led to yet.
    nx, ny, nz = shape
    level, done = place[0], 0
    while level > 0 and done < most:
        voxel = np.int64(heads[level])
        if voxel < 0:
            level -= 1
            continue
        heads[level] = nexts[voxel]
        done += 1
        row = voxel // nz
        k = voxel - row * nz
        i = row // ny
        j = row - i * ny
        if 0 < i < nx - 1 and 0 < j < ny - 1 and 0 < k < nz - 1:
            for x in range(-1, 2):
                for y in range(-1, 2):
                    middle = voxel + (x * ny + y) * nz
                    if min(state[middle - 1], state[middle], state[middle + 1]) >= 0:
                        continue
                    for other in range(middle - 1, middle + 2):
                        rank = -state[other]
                        if rank > 0:
                            rank = min(rank, level)
                            state[other] = rank
                            nexts[other] = heads[rank]
                            heads[rank] = other
            continue
        for step in range(27):
            a, b, c = i + step // 9 - 1, j + step // 3 % 3 - 1, k + step % 3 - 1
            if wraps[0]:
                a = (a + nx) % nx
            if wraps[1]:
                b = (b + ny) % ny
            if wraps[2]:
                c = (c + nz) % nz
            if a < 0 or b < 0 or c < 0 or a >= nx or b >= ny or c >= nz:
                continue
            other = (a * ny + b) * nz + c
            rank = -state[other]
            if rank > 0:
                rank = min(rank, level)
                state[other] = rank
                nexts[other] = heads[rank]
                heads[rank] = other
    place[0] = level
    place[1] += done


@kernel
def _thin(squares, ways, wraps, out, first, last):
    nx, ny, nz = squares.shape
    for i in range(first, last):
        for j in range(ny):
            meshed = (i % MESH == 1 or i == nx - 1) and (j % MESH == 1 or j == ny - 1)
            for k in range(nz):
                ball = ways[i, j, k]
                out[i, j, k] = ball
                if ball == 0 or (meshed and (k % MESH == 1 or k == nz - 1)):
                    continue
                held = True
                for step in range(27):
                    a, b, c = i + step // 9 - 1, j + step // 3 % 3 - 1, k + step % 3 - 1
                    if wraps[0]:
                        a = (a + nx) % nx
                    if wraps[1]:
                        b = (b + ny) % ny
                    if wraps[2]:
                        c = (c + nz) % nz
                    if a < 0 or b < 0 or c < 0 or a >= nx or b >= ny or c >= nz:
                        continue
                    if squares[a, b, c] * (1.0 + TIE) < ball:
                        held = False
                        break
                if held:
                    out[i, j, k] = 1
