"""Which sample points of a lattice lie in the solid voxels of another one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Ints = NDArray[np.int64]


def masks_of(solid: NDArray[np.bool_], x: Ints, y: Ints, z: Ints) -> NDArray[np.uint64]:
    """Return the masks of a frame's voxels.

    Parameters
    ----------
    solid
        bool, shape (a, b, c): the voxels that are asked about.
    x, y
        int64, shapes (rows, nx) and (rows, ny): in which of them the lines of a pattern run, for
        each voxel of the frame; −1 where beyond them.
    z
        int64, shape (rows, columns, nz): the same of the points of each line.

    Returns
    -------
    uint64, shape (nx, ny, nz): bit r·columns + c is set where that point is solid.
    """
    masks = np.zeros((x.shape[1], y.shape[1], z.shape[2]), np.uint64)
    given = source(solid, np.bool_).view(np.uint8)
    _gather(given, *(source(index, np.int64) for index in (x, y, z)), masks)
    return masks


@kernel
def _gather(solid, x, y, z, masks):
    rows, columns, nz = z.shape
    for i in range(masks.shape[0]):
        for j in range(masks.shape[1]):
            line = masks[i, j]
            for r in range(rows):
                a, b = x[r, i], y[r, j]
                if a < 0 or b < 0:
                    continue
                column = solid[a, b]
                for c in range(columns):
                    place = z[r, c]
                    bit = np.uint64(r * columns + c)
                    for k in range(nz):
                        if place[k] >= 0:
                            line[k] |= np.uint64(column[place[k]]) << bit
