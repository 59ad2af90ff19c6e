"""How far in from a side of a grid the solid begins, column by column, from fills."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

SEARCHING, RISING, DONE = range(3)


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
