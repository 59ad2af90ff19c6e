"""The fractal homeomorphism of the cube: where samples lie before they were warped.

A point of the unit cube has an address, eight kinds of digits: which half it lies in along each
axis, after folding the cube onto that half again and again (the tent map, exact in floating point).
Where the same address leads among the trilinear cells of a lattice of 27 points is its image.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MOST_DIGITS = 52
"""Floating point has no more digits of a number below one."""


@kernel
def _digits(place, count):
    # The binary digits of the tent map, the first one highest, and what is left.
    digits = np.int64(0)
    for _ in range(count):
        digits <<= 1
        if place > 0.5:
            digits |= 1
            place = 2.0 - 2.0 * place
        else:
            place = 2.0 * place
    return digits, place


@kernel
def _warped(cells, count, x, y, z, out):
    a, x = _digits(x, count)
    b, y = _digits(y, count)
    c, z = _digits(z, count)
    for level in range(count):
        cell = cells[(a >> level & 1) * 4 + (b >> level & 1) * 2 + (c >> level & 1)]
        for i in range(3):
            near = cell[0, i] + z * (cell[1, i] - cell[0, i])
            side = cell[2, i] + z * (cell[3, i] - cell[2, i])
            near += y * (side - near)
            far = cell[4, i] + z * (cell[5, i] - cell[4, i])
            side = cell[6, i] + z * (cell[7, i] - cell[6, i])
            far += y * (side - far)
            out[i] = near + x * (far - near)
        x, y, z = out[0], out[1], out[2]
    out[0], out[1], out[2] = x, y, z


@kernel
def _points(out, points, cells, count):
    for n in range(len(points)):
        _warped(cells, count, points[n, 0], points[n, 1], points[n, 2], out[n])


@kernel
def _samples(out, first, last, shape, start, lower, step, rows, depths, cells, count):
    n = 0
    for voxel in range(first, last):
        i, rest = divmod(voxel, shape[1] * shape[2])
        j, k = divmod(rest, shape[2])
        for r in range(len(rows)):
            x = lower[0] + (start[0] + i + rows[r, 0]) * step[0]
            y = lower[1] + (start[1] + j + rows[r, 1]) * step[1]
            for c in range(depths.shape[1]):
                z = lower[2] + (start[2] + k + depths[r, c]) * step[2]
                if min(x, y, z) < 0.0 or max(x, y, z) > 1.0:
                    out[n, :] = -1.0
                else:
                    _warped(cells, count, x, y, z, out[n])
                n += 1


def warped_points(points: Floats, cells: Floats, digits: int) -> Floats:
    """Return the images (n, 3) of points (n, 3) of the unit cube.

    Parameters
    ----------
    points
        Of the unit cube.
    cells
        Shape (8, 8, 3): the corners of each cell, both lexicographic, of mirrored cells too.
    digits
        How many digits of the addresses are read, up to ``MOST_DIGITS``.
    """
    result = np.empty((len(points), 3))
    _points(result, source(points, np.float64), source(cells, np.float64), digits)
    return result


def warped_samples(
    voxels: tuple[int, int],
    lattice: tuple[tuple[int, int, int], tuple[int, int, int], Floats, Floats],
    pattern: tuple[Floats, Floats],
    cells: Floats,
    digits: int,
) -> Floats:
    """Return the images (n, 3) of the samples of some voxels; −1 for samples outside the cube.

    Parameters
    ----------
    voxels
        The first and the one after the last, in C order of the tile.
    lattice
        The tile's shape and first voxel; the whole lattice's corner and a voxel's edges, in edges
        of the cube.
    pattern
        Rows (R, 2) and depths (R, C) of a voxel's samples.
    cells, digits
        As in ``warped_points``.
    """
    shape, start, lower, step = lattice
    rows, depths = (source(part, np.float64) for part in pattern)
    result = np.empty(((voxels[1] - voxels[0]) * depths.size, 3))
    _samples(
        result,
        *voxels,
        shape,
        start,
        source(lower, np.float64),
        source(step, np.float64),
        rows,
        depths,
        source(cells, np.float64),
        digits,
    )
    return result
