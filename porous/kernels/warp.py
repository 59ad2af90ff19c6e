"""The fractal homeomorphism of the cube, and its inverse: where points go, and whence they come.

A point of the unit cube has an address, eight kinds of digits: which half it lies in along each
axis, after folding the cube onto that half again and again (the tent map, exact in floating point).
Where the same address leads among the trilinear cells of a lattice of 27 points is its image. Back
it goes by finding the cell that holds a point, and where in it (Newton's method), level by level.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MOST_DIGITS = 52
"""Floating point has no more digits of a number below one."""

MOST_STEPS = 40
"""Of Newton's method in one cell; four or five are usual."""

REACH = 0.1
"""How far beyond a cell's sides a step may lead: farther out its Jacobian need not be positive."""

CLOSE = 1e-15
"""A step of Newton's method, in edges of a cell, after which there is no other."""

STARTS = np.array([(0.5, 0.5, 0.5), *itertools.product((0.05, 0.95), repeat=3)])
"""Where in a cell Newton's method begins; from the middle nearly always suffices."""

INSIDE = 1e-12
"""A place this far beyond a cell's side is in the cell: rounding put it there."""

SLAB = 4096
"""Points that a thread takes at a time."""


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


@kernel
def _newton(cell, image, place, m):
    # Where in a trilinear cell a point lies, from a first guess; the length of the last step.
    last = np.inf
    for _ in range(MOST_STEPS):
        x, y, z = place[0], place[1], place[2]
        # Columns of the matrix are the derivatives; the fourth is what is left to go.
        for i in range(3):
            a, b = cell[0, i] + z * (cell[1, i] - cell[0, i]), cell[1, i] - cell[0, i]
            c, d = cell[2, i] + z * (cell[3, i] - cell[2, i]), cell[3, i] - cell[2, i]
            e, f = cell[4, i] + z * (cell[5, i] - cell[4, i]), cell[5, i] - cell[4, i]
            g, h = cell[6, i] + z * (cell[7, i] - cell[6, i]), cell[7, i] - cell[6, i]
            near, far = a + y * (c - a), e + y * (g - e)
            m[i, 0] = far - near
            m[i, 1] = c - a + x * (g - e - c + a)
            near_z, far_z = b + y * (d - b), f + y * (h - f)
            m[i, 2] = near_z + x * (far_z - near_z)
            m[i, 3] = image[i] - near - x * (far - near)
        det = _det(m, 0, 1, 2)
        steps = _det(m, 3, 1, 2) / det, _det(m, 0, 3, 2) / det, _det(m, 0, 1, 3) / det
        for i in range(3):
            place[i] = min(max(place[i] + steps[i], -REACH), 1.0 + REACH)
        last = max(abs(steps[0]), abs(steps[1]), abs(steps[2]))
        if not last > CLOSE:
            break
    return last


@kernel
def _det(m, i, j, k):
    return (
        m[0, i] * (m[1, j] * m[2, k] - m[1, k] * m[2, j])
        - m[0, j] * (m[1, i] * m[2, k] - m[1, k] * m[2, i])
        + m[0, k] * (m[1, i] * m[2, j] - m[1, j] * m[2, i])
    )


@kernel
def _holds(cell, image, place, m, start):
    for i in range(3):
        place[i] = STARTS[start, i]
    if not _newton(cell, image, place, m) <= INSIDE:
        return False
    return min(place[0], place[1], place[2]) >= -INSIDE and (
        max(place[0], place[1], place[2]) <= 1.0 + INSIDE
    )


@kernel
def _located(cells, image, place, m):
    # The cell that holds a point, and where in it: that of its side of the middle, or any.
    middle = cells[0, 7]
    first = 0
    for i in range(3):
        first = 2 * first + (image[i] > middle[i])
    for start in range(len(STARTS)):
        for other in range(8):
            if _holds(cells[first ^ other], image, place, m, start):
                return first ^ other
    return -1


@kernel
def _unwarped(cells, count, image, place, m, out):
    # The place whose image is given, into out; whether it was found.
    a, b, c = np.int64(0), np.int64(0), np.int64(0)
    for _ in range(count):
        cell = _located(cells, image, place, m)
        if cell < 0:
            return False
        for i in range(3):
            if image[i] == 0.0 or image[i] == 1.0:  # a side of the box stays one
                cell = cell & ~(4 >> i) | np.int64(image[i]) * (4 >> i)
                place[i] = 0.0
            image[i] = min(max(place[i], 0.0), 1.0)
        a, b, c = a << 1 | cell >> 2, b << 1 | (cell >> 1 & 1), c << 1 | (cell & 1)
    out[0], out[1], out[2] = image[0], image[1], image[2]
    for level in range(count):
        out[0] = _half(a >> level & 1, out[0])
        out[1] = _half(b >> level & 1, out[1])
        out[2] = _half(c >> level & 1, out[2])
    return True


@kernel
def _half(digit, place):
    return 1.0 - 0.5 * place if digit else 0.5 * place


@kernel
def _origins(out, found, points, cells, count, start, stop):
    image, place, m = np.empty(3), np.empty(3), np.empty((3, 4))
    for n in range(start, stop):
        image[:] = points[n]
        found[n] = _unwarped(cells, count, image, place, m, out[n])


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


def unwarped_points(points: Floats, cells: Floats, digits: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the places (n, 3) of given images (n, 3) in the unit cube, and which are found.

    Parameters
    ----------
    points, cells, digits
        As in ``warped_points``, of which this is the inverse, but for rounding.
    """
    result, found = np.empty((len(points), 3)), np.empty(len(points), np.bool_)
    given = source(points, np.float64), source(cells, np.float64)

    def work(start: int, stop: int) -> None:
        _origins(result, found, *given, digits, start, stop)

    slabs(len(points), SLAB, work)
    return result, found


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
