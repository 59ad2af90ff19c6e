"""Rows of a PNG picture as they were before they were filtered.

Each row says by its first byte what was taken off it: nothing, the pixel to the left, the one
above, the mean of both, or the one of left, above and corner nearest to left + above − corner.
https://www.w3.org/TR/png-3/#9Filters
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

KINDS = 5


def unfilter(lines: NDArray[np.uint8], step: int) -> NDArray[np.uint8] | None:
    """Return the bytes of a picture's rows.

    Parameters
    ----------
    lines
        uint8, shape (rows, 1 + bytes): each row with its filter before it.
    step
        Bytes from one pixel to the next.

    Returns
    -------
    uint8, shape (rows, bytes); None where a filter is unknown.
    """
    if lines[:, 0].max(initial=0) >= KINDS:
        return None
    out = np.zeros((lines.shape[0] + 1, lines.shape[1] - 1 + step), np.uint8)
    _unfilter(source(lines, np.uint8), step, out)
    return out[1:, step:]


@kernel
def _unfilter(lines, step, out):
    """Fill ``out``, which has a row and a pixel of zeros before the picture's own."""
    for i in range(lines.shape[0]):
        kind = lines[i, 0]
        for j in range(1, lines.shape[1]):
            k = j - 1 + step
            left, up, corner = np.int64(out[i + 1, k - step]), np.int64(out[i, k]), 0
            taken = np.int64(0)
            if kind == 1:
                taken = left
            elif kind == 2:
                taken = up
            elif kind == 3:
                taken = (left + up) // 2
            elif kind == 4:
                corner = np.int64(out[i, k - step])
                guess = left + up - corner
                a, b, c = abs(guess - left), abs(guess - up), abs(guess - corner)
                if a <= b and a <= c:
                    taken = left
                elif b <= c:
                    taken = up
                else:
                    taken = corner
            out[i + 1, k] = np.uint8((np.int64(lines[i, j]) + taken) & 255)
