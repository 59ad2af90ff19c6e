"""Balls that come by widest ways, but for those that others make needless."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, slabs, source
from porous.kernels.widest import SLAB, TIE

if TYPE_CHECKING:
    from porous.kernels.distance import Numbers, Squares

    Axes = tuple[bool, bool, bool]

MESH = 3
"""Every how many voxels, along each axis, a ball stays where all about it are as large."""


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
        The ways inward that ``widest`` found in it.
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

    slabs(given.shape[0], max(1, SLAB // given[0].size), thin)
    return squares._replace(values=result)


@kernel
def _least(before, here, after, out):
    for k in range(len(out)):
        out[k] = min(before[k], here[k], after[k])


@kernel
def _beside(i, size, wraps):
    # The places before and after one, or itself at an end.
    before, after = max(i - 1, 0), min(i + 1, size - 1)
    if wraps:
        before, after = (i + size - 1) % size, (i + 1) % size
    return before, after


@kernel
def _low(squares, wraps, i, line, rows, out):
    # The least squares of the nine voxels about those of a plane.
    nx, ny, nz = squares.shape
    i = (i + nx) % nx if wraps[0] else min(max(i, 0), nx - 1)
    before, after = _beside(0, nz, wraps[2])[0], _beside(nz - 1, nz, wraps[2])[1]
    for j in range(ny):
        line[1 : nz + 1] = squares[i, j]
        line[0], line[nz + 1] = squares[i, j, before], squares[i, j, after]
        _least(line[:nz], line[1 : nz + 1], line[2:], rows[j])
    for j in range(ny):
        low, high = _beside(j, ny, wraps[1])
        _least(rows[low], rows[j], rows[high], out[j])


@kernel
def _thin(squares, ways, wraps, out, first, last):
    nx, ny, nz = squares.shape
    line, least = np.empty(nz + 2, squares.dtype), np.empty(nz, squares.dtype)
    rows, planes = np.empty((ny, nz), squares.dtype), np.empty((3, ny, nz), squares.dtype)
    for after in range(first - 1, last + 1):
        _low(squares, wraps, after, line, rows, planes[(after + 3) % 3])
        if after <= first:
            continue
        i = after - 1
        for j in range(ny):
            meshed = (i % MESH == 1 or i == nx - 1) and (j % MESH == 1 or j == ny - 1)
            _least(planes[0, j], planes[1, j], planes[2, j], least)
            for k in range(nz):
                ball = ways[i, j, k]
                held = ball != 0 and least[k] * (1.0 + TIE) >= ball
                if meshed and (k % MESH == 1 or k == nz - 1):
                    held = False
                out[i, j, k] = 1 if held else ball
