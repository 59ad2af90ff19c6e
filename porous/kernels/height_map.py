"""What is seen from a side, column by column: solid of a grid from fills, the highest triangles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Index = tuple[int, int]

SEARCHING, RISING, DONE = range(3)

SLACK = 1e-9
"""Places so near a triangle, as a part of its size, are in it: there is no gap between two."""


def seen(
    layers: NDArray[np.uint8],
    missing: NDArray[np.float64],
    last: NDArray[np.int64],
    state: NDArray[np.int64],
) -> None:
    """Go on into columns by some layers, in place.

    A column is met at its first voxel of fill 128 or more, and goes on as long as fills rise: a
    voxel that the surface passes through obliquely is not full yet. What these voxels and those
    before them lack of being full is how far in the surface lies, on average over the column.

    Parameters
    ----------
    layers
        uint8, shape (n, m, depth): the next layers, the outermost first.
    missing
        Shape (n, m): voxels that columns lack so far; zero at first.
    last, state
        int64, shape (n, m): the last fill and how far columns are; zero at first, ``DONE`` at last.
    """
    _seen(source(layers, np.uint8), missing, last, state)


@kernel
def _seen(layers, missing, last, state):
    for i in range(layers.shape[0]):
        for j in range(layers.shape[1]):
            for k in range(layers.shape[2]):
                fill = np.int64(layers[i, j, k])
                if state[i, j] == RISING and fill <= last[i, j]:
                    state[i, j] = DONE
                if state[i, j] == DONE:
                    break
                missing[i, j] += 1.0 - fill / 255.0
                last[i, j] = fill
                if fill >= 128:
                    state[i, j] = RISING
                if fill == 255:
                    state[i, j] = DONE


def highest(
    corners: NDArray[np.float64],
    lower: tuple[float, float],
    step: tuple[float, float],
    shape: Index,
) -> NDArray[np.float64]:
    """Return the largest z of triangles over a lattice of places; −∞ where there is none.

    Parameters
    ----------
    corners
        Shape (k, 3, 3): the corners (x, y, z) of each triangle.
    lower, step, shape
        Place (i, j) is lower + (i, j) · step.
    """
    result = np.full(shape, -np.inf)
    _highest(source(corners, np.float64), *lower, *step, result)
    return result


@kernel
def _highest(corners, x0, y0, dx, dy, out):
    for t in range(len(corners)):
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corners[t, 0], corners[t, 1], corners[t, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        first = max(0, np.int64(np.ceil((min(ax, bx, cx) - x0) / dx - SLACK)))
        last = min(out.shape[0] - 1, np.int64(np.floor((max(ax, bx, cx) - x0) / dx + SLACK)))
        front = max(0, np.int64(np.ceil((min(ay, by, cy) - y0) / dy - SLACK)))
        back = min(out.shape[1] - 1, np.int64(np.floor((max(ay, by, cy) - y0) / dy + SLACK)))
        for i in range(first, last + 1):
            for j in range(front, back + 1):
                x, y = x0 + i * dx, y0 + j * dy
                b = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
                c = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
                if min(b, c, 1.0 - b - c) >= -SLACK:
                    out[i, j] = max(out[i, j], az + b * (bz - az) + c * (cz - az))
