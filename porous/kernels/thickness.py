"""The largest ball in a mask that covers each of its voxels, exactly on the lattice of voxels.

A ball about a voxel p holds the voxels nearer to p than the nearest one outside of the mask is.
Balls that a neighbour's holds are dropped by tables of how far a ball reaches from beside its
centre (E. Rémy, E. Thiel, Pattern Recognition Letters 23, 2002); the others are painted by falling
radius, so that the first to reach a voxel is its largest.
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

SIDE = 8
"""Voxels along a block's edge: a plane of it is the bits of one word."""

SLAB = 1 << 20
"""Voxels that one kernel call looks at, about."""

LAYERS = 2
"""Layers of blocks that one kernel call paints."""

CLASSES = 1 << 20
"""Squares of radii that tables tell apart, at most."""

SLACK = 1e-9
"""Part of a squared radius by which balls are drawn in, so that rounding joins no voxel to them."""

NEAR = 2
"""How far, in voxels, ``smallest`` looks about."""

STEEP = 0.5
"""Distances rise at the sine of half the angle of a wedge: these are of 60° and less."""


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
        Called as ``progress(done, count)`` in layers of blocks; raising in it cancels.

    Returns
    -------
    Like ``squares.values``, in its units: 0 outside of the mask.
    """
    given = source(squares.values, squares.values.dtype)
    result = np.zeros_like(squares.values)
    blocks = [-(-n // SIDE) for n in given.shape]
    centres, radii = _centres(given, squares.weights, periodic)
    free = np.zeros((*blocks, SIDE), np.uint64)
    left = np.zeros(blocks, np.int64)
    wraps = np.array(periodic, np.int64)

    def paint(a: int, b: int) -> None:
        _paint(given, centres, radii, squares.weights, wraps, free, left, result, a, b)

    slabs(blocks[0], LAYERS, paint, progress)
    return result


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


def _planes(shape: tuple[int, ...]) -> int:
    return max(1, SLAB // (shape[1] * shape[2]))


def _centres(given: Numbers, weights: Floats, periodic: Axes) -> tuple[NDArray[np.int64], Floats]:
    """Return the balls that no neighbour's ball holds: their squares, falling, and where they are.

    That is the voxel of the centre, and how many voxels the ball reaches along x, int64 (n, 4).
    """
    largest = float(given.max(initial=0))
    width = max(1.0, math.ceil(largest / CLASSES)) if given.dtype.kind == "i" else largest / 2**16
    table = np.zeros((7, math.ceil(largest / max(width, 1e-300)) + 2))
    _reaches(weights, width, table)
    kept = np.zeros(given.shape, np.uint8)
    wraps = np.array(periodic, np.int64)

    def prune(a: int, b: int) -> None:
        _prune(given, table, width, wraps, kept, a, b)

    slabs(given.shape[0], _planes(given.shape), prune)
    places = np.flatnonzero(kept)
    radii = given.reshape(-1)[places]
    order = np.argsort(-radii)
    radii = radii[order].astype(np.float64)
    wide = np.sqrt(radii * (1 - SLACK) / weights[0])
    centres = np.stack([*np.unravel_index(places[order], given.shape), wide], axis=1)
    return source(centres, np.int64), source(radii, np.float64)


@kernel
def _reaches(weights, width, table):
    # table[v - 1, b]: the largest square of x - v over all x with squares up to class b, of the
    # seven steps v to neighbours; x and v point away from each other.
    most = (table.shape[1] - 1) * width
    for i in range(np.int64(np.sqrt(most / weights[0])) + 1):
        for j in range(np.int64(np.sqrt(most / weights[1])) + 1):
            k, plane = 0, weights[0] * i * i + weights[1] * j * j
            while plane + weights[2] * k * k < most:
                b = np.int64((plane + weights[2] * k * k) / width)
                for v in range(1, 8):
                    x, y, z = i + (v >> 2), j + ((v >> 1) & 1), k + (v & 1)
                    square = weights[0] * x * x + weights[1] * y * y + weights[2] * z * z
                    table[v - 1, b] = max(table[v - 1, b], square)
                k += 1
    for v in range(7):
        for b in range(1, table.shape[1]):
            table[v, b] = max(table[v, b], table[v, b - 1])


@kernel
def _prune(squares, table, width, wraps, kept, first, last):
    nx, ny, nz = squares.shape
    steps = np.zeros((26, 4), np.int64)  # to neighbours; those across faces come first
    row = 0
    for near in range(1, 4):
        for step in range(27):
            x, y, z = step // 9 - 1, step // 3 % 3 - 1, step % 3 - 1
            if abs(x) + abs(y) + abs(z) == near:
                steps[row] = x, y, z, 4 * abs(x) + 2 * abs(y) + abs(z) - 1
                row += 1
    for i in range(first, last):
        for j in range(ny):
            inner = 0 < i < nx - 1 and 0 < j < ny - 1
            for k in range(nz):
                radius = squares[i, j, k]
                if radius == 0:
                    continue
                b = np.int64(np.ceil(radius / width)) - 1
                kept[i, j, k] = 1
                for row in range(26):
                    x, y, z = i + steps[row, 0], j + steps[row, 1], k + steps[row, 2]
                    if not inner or z < 0 or z >= nz:
                        if wraps[0]:
                            x = x + nx if x < 0 else x - nx if x >= nx else x
                        if wraps[1]:
                            y = y + ny if y < 0 else y - ny if y >= ny else y
                        if wraps[2]:
                            z = z + nz if z < 0 else z - nz if z >= nz else z
                        if x < 0 or y < 0 or z < 0 or x >= nx or y >= ny or z >= nz:
                            continue
                    other = squares[x, y, z]
                    if other <= radius:
                        continue
                    if table[steps[row, 3], b] < other * (1.0 - SLACK):
                        kept[i, j, k] = 0
                        break


@kernel
def _paint(squares, centres, radii, weights, wraps, free, left, out, first, last):
    nx, ny, nz = squares.shape
    beams = np.zeros((last - first, left.shape[1]), np.int64)
    total = 0
    for i in range(first * SIDE, min(nx, last * SIDE)):
        for j in range(ny):
            for k in range(nz):
                if squares[i, j, k] != 0:
                    bit = np.uint64(1) << np.uint64((j % SIDE) * SIDE + k % SIDE)
                    free[i // SIDE, j // SIDE, k // SIDE, i % SIDE] |= bit
                    left[i // SIDE, j // SIDE, k // SIDE] += 1
                    beams[i // SIDE - first, j // SIDE] += 1
                    total += 1
    for n in range(len(centres)):
        if total == 0:
            break
        cx, cy, cz, wide = centres[n]
        if not wraps[0] and (cx + wide < first * SIDE or cx - wide >= last * SIDE):
            continue
        radius = out.dtype.type(radii[n])
        most = radii[n] * (1.0 - SLACK)
        high = np.int64(np.sqrt(most / weights[1]))
        deep = np.int64(np.sqrt(most / weights[2]))
        # Along axes that close on themselves there is a ball about every image of the centre.
        x0, x1 = (-((cx + wide) // nx), (nx - 1 + wide - cx) // nx) if wraps[0] else (0, 0)
        y0, y1 = (-((cy + high) // ny), (ny - 1 + high - cy) // ny) if wraps[1] else (0, 0)
        z0, z1 = (-((cz + deep) // nz), (nz - 1 + deep - cz) // nz) if wraps[2] else (0, 0)
        for sx in range(x0, x1 + 1):
            x = cx + sx * nx
            if x + wide < first * SIDE or x - wide >= last * SIDE:
                continue
            for sy in range(y0, y1 + 1):
                y = cy + sy * ny
                for sz in range(z0, z1 + 1):
                    z = cz + sz * nz
                    for bx in range(
                        max(first, (x - wide) // SIDE), min(last, (x + wide) // SIDE + 1)
                    ):
                        gap = max(bx * SIDE - x, x - bx * SIDE - SIDE + 1, 0)
                        rest_x = most - weights[0] * gap * gap
                        if rest_x < 0.0:
                            continue
                        high_x = np.int64(np.sqrt(rest_x / weights[1]))
                        for by in range(
                            max(0, (y - high_x) // SIDE),
                            min(left.shape[1], (y + high_x) // SIDE + 1),
                        ):
                            if beams[bx - first, by] == 0:
                                continue
                            gap = max(by * SIDE - y, y - by * SIDE - SIDE + 1, 0)
                            rest_y = rest_x - weights[1] * gap * gap
                            if rest_y < 0.0:
                                continue
                            deep_y = np.int64(np.sqrt(rest_y / weights[2]))
                            for bz in range(
                                max(0, (z - deep_y) // SIDE),
                                min(left.shape[2], (z + deep_y) // SIDE + 1),
                            ):
                                if left[bx, by, bz] == 0:
                                    continue
                                done = _block(
                                    free[bx, by, bz],
                                    (bx * SIDE, by * SIDE, bz * SIDE),
                                    (x, y, z),
                                    most,
                                    weights,
                                    radius,
                                    out,
                                )
                                left[bx, by, bz] -= done
                                beams[bx - first, by] -= done
                                total -= done


@kernel
def _block(free, corner, centre, most, weights, radius, out):
    # Paint the free voxels of a block that a ball holds; return their number.
    done = 0
    for i in range(SIDE):
        if free[i] == 0:
            continue
        gap = corner[0] + i - centre[0]
        plane = most - weights[0] * gap * gap
        if plane < 0.0:
            continue
        bits = np.uint64(0)
        for j in range(SIDE):
            if free[i] >> np.uint64(SIDE * j) & np.uint64(255) == 0:
                continue
            gap = corner[1] + j - centre[1]
            row = plane - weights[1] * gap * gap
            if row < 0.0:
                continue
            reach = np.int64(np.sqrt(row / weights[2]))
            low = max(0, centre[2] - reach - corner[2])
            high = min(SIDE - 1, centre[2] + reach - corner[2])
            if low <= high:
                ones = (np.uint64(2) << np.uint64(high)) - (np.uint64(1) << np.uint64(low))
                bits |= ones << np.uint64(SIDE * j)
        bits &= free[i]
        if bits == 0:
            continue
        free[i] ^= bits
        for j in range(SIDE):
            line = bits >> np.uint64(SIDE * j) & np.uint64(255)
            k = 0
            while line:
                if line & np.uint64(1):
                    out[corner[0] + i, corner[1] + j, corner[2] + k] = radius
                    done += 1
                line >>= np.uint64(1)
                k += 1
    return done


@kernel
def _ridge(squares, balls, weights, wraps, walled, found, first, last):
    shape = squares.shape
    for i in range(first, last):
        for j in range(shape[1]):
            for k in range(shape[2]):
                square = np.float64(squares[i, j, k])
                if square == 0.0 or balls[i, j, k] >= found[i]:
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
                            if step and np.sqrt(squares[a, b, c]) >= depth + STEEP * np.sqrt(step):
                                lowest = False
                        if not lowest:
                            break
                    if not lowest:
                        break
                if lowest:
                    found[i] = balls[i, j, k]
