"""Which way a surface of voxels looks: faces, weighed by normals that are seen about them.

A face between solid and void stands for as much of the smooth surface as it shows along the
normal n there: its area times |n_a|, a its axis, which adds up to the area of the surface
(J.-O. Lachaud, B. Thibert, J. Mathematical Imaging and Vision 54, 2016). Normals are the gradient
of smoothed fills.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Progress = Callable[[int, int], None]

CALL = 1 << 20
"""Voxels that one kernel call looks at, about."""

MARGIN = 3
"""Layers of voxels beyond what has faces that gradients are taken over."""


def inclinations(
    smooth: NDArray[np.float32],
    solid: NDArray[np.bool_],
    spacing: tuple[float, float, float],
    cosines: NDArray[np.float64],
    ends: NDArray[np.int64],
    within: NDArray[np.int64],
    *,
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """Return the area of the surface by how it is inclined to each axis.

    Parameters
    ----------
    smooth
        float32, shape (x, y, z): smoothed fills.
    solid
        bool, of that shape. Both close on themselves along every axis; ``MARGIN`` layers of void
        beside what lies in vacuum keep its sides apart.
    spacing
        Edges of a voxel.
    cosines
        float64, shape (n,), ascending from 0 to 1: bounds of the classes.
    ends
        int64, shape (3, 2): first and last layer along each axis.
    within
        int64, shape (3, 2): first and last voxel along each axis that faces are counted between.
    progress
        Called as ``progress(done, count)``; raising in it cancels.

    Returns
    -------
    float64, shape (3, 3, 2, n − 1): area by the cosine of the outward normal to an axis, bounds
    belonging to the class above. Along the first axis: of all faces, of those of voxels of the
    first layer, and of the last; then by axis; then of normals against the axis, and along it.
    """
    planes = max(1, CALL // (smooth.shape[1] * smooth.shape[2]))
    count = -(-len(smooth) // planes)
    found = np.zeros((count, 3, 3, 2, len(cosines) - 1))
    given, mask = source(smooth, np.float32), source(solid, np.bool_).view(np.uint8)
    edges, layers = source(cosines, np.float64), source(ends, np.int64)
    box = source(within, np.int64)
    steps = np.array(spacing, np.float64)

    def work(a: int, b: int) -> None:
        _faces(given, mask, steps, edges, layers, box, found[a // planes], a, b)

    slabs(len(smooth), planes, work, progress)
    return np.asarray(found.sum(axis=0))


@kernel
def _slope(smooth, i, j, k, axis):
    # Central difference of fourth order, times 12.
    nx, ny, nz = smooth.shape
    if axis == 0:
        a, b = smooth[(i + 1) % nx, j, k], smooth[(i - 1) % nx, j, k]
        c, d = smooth[(i + 2) % nx, j, k], smooth[(i - 2) % nx, j, k]
    elif axis == 1:
        a, b = smooth[i, (j + 1) % ny, k], smooth[i, (j - 1) % ny, k]
        c, d = smooth[i, (j + 2) % ny, k], smooth[i, (j - 2) % ny, k]
    else:
        a, b = smooth[i, j, (k + 1) % nz], smooth[i, j, (k - 1) % nz]
        c, d = smooth[i, j, (k + 2) % nz], smooth[i, j, (k - 2) % nz]
    return 8.0 * (a - b) - (c - d)


@kernel
def _class(cosines, value):
    low, high = 0, len(cosines) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if cosines[middle] <= value:
            low = middle
        else:
            high = middle
    return low


@kernel
def _faces(smooth, solid, steps, cosines, ends, within, found, first, last):
    nx, ny, nz = solid.shape
    normal = np.zeros(3)
    place = np.zeros(3, np.int64)
    for i in range(max(first, within[0, 0]), min(last, within[0, 1] + 1)):
        for j in range(within[1, 0], within[1, 1] + 1):
            for k in range(within[2, 0], within[2, 1] + 1):
                here = solid[i, j, k]
                for axis in range(3):
                    x, y, z = i, j, k
                    if axis == 0:
                        x = i + 1 if i + 1 < nx else 0
                    elif axis == 1:
                        y = j + 1 if j + 1 < ny else 0
                    else:
                        z = k + 1 if k + 1 < nz else 0
                    if solid[x, y, z] == here:
                        continue
                    if x > within[0, 1] or y > within[1, 1] or z > within[2, 1]:
                        continue
                    size = 0.0
                    for b in range(3):
                        slope = _slope(smooth, i, j, k, b) + _slope(smooth, x, y, z, b)
                        normal[b] = -slope / steps[b]
                        size += normal[b] ** 2
                    size = np.sqrt(size)
                    outward = 1.0 if here else -1.0
                    if size > 0.0:
                        for b in range(3):
                            normal[b] /= size
                    else:
                        normal[axis] = outward
                    shown = outward * normal[axis]
                    if shown <= 0.0:
                        continue
                    area = shown * steps[0] * steps[1] * steps[2] / steps[axis]
                    if here:
                        place[0], place[1], place[2] = i, j, k
                    else:
                        place[0], place[1], place[2] = x, y, z
                    for b in range(3):
                        along = 1 if normal[b] > 0.0 else 0
                        c = _class(cosines, abs(normal[b]))
                        found[0, b, along, c] += area
                        if place[b] == ends[b, 0]:
                            found[1, b, along, c] += area
                        if place[b] == ends[b, 1]:
                            found[2, b, along, c] += area
