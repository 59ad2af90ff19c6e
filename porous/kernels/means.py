"""Means of blocks of voxels: the same body in coarser ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Bytes = NDArray[np.uint8]

SLAB = 1 << 22
"""Voxels that one kernel call looks at, about."""


def block_means(fill: Bytes, step: int) -> Bytes:
    """Return the means of blocks of ``step`` voxels along each axis, rounded, halves up.

    Parameters
    ----------
    fill
        uint8, shape (x, y, z).
    step
        At least 1. Blocks at the upper ends that are cut short are means of what they have.

    Returns
    -------
    uint8, shape (⌈x / step⌉, ⌈y / step⌉, ⌈z / step⌉).
    """
    given = source(fill, np.uint8)
    result = np.empty([-(-n // step) for n in fill.shape], np.uint8)

    def work(first: int, last: int) -> None:
        _means(given, step, first, last, np.empty(fill.shape[2], np.uint32), result)

    slabs(len(result), max(1, SLAB // (step * given[0].size)), work)
    return result


@kernel
def _means(fill, step, first, last, sums, result):
    nx, ny, nz = fill.shape
    for i in range(first, last):
        for j in range(result.shape[1]):
            sums[:] = 0
            low, high = (step * i, step * j), (min(step * (i + 1), nx), min(step * (j + 1), ny))
            for x in range(low[0], high[0]):
                for y in range(low[1], high[1]):
                    row = fill[x, y]
                    for k in range(nz):
                        sums[k] += np.uint32(row[k])
            rows = (high[0] - low[0]) * (high[1] - low[1])
            for k in range(result.shape[2]):
                total, stop = np.int64(0), min(step * (k + 1), nz)
                for z in range(step * k, stop):
                    total += sums[z]
                size = rows * (stop - step * k)
                result[i, j, k] = (total + size // 2) // size
