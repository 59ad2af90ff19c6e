"""Clouds of points under many maps: which voxels hold one of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

BATCH = 1 << 26
"""Points of one call: about a tenth of a second."""


@kernel
def _stamp(marks, across, along, maps, xs, ys, zs, places):
    # All images lie in the window. Places first, marks after: the first loop has no stores that
    # could alias its loads, and is compiled to vectors.
    count = len(xs)
    for w in range(len(maps)):
        a, b, c, p = maps[w, 0, 0], maps[w, 0, 1], maps[w, 0, 2], maps[w, 0, 3]
        d, e, f, q = maps[w, 1, 0], maps[w, 1, 1], maps[w, 1, 2], maps[w, 1, 3]
        g, h, i, r = maps[w, 2, 0], maps[w, 2, 1], maps[w, 2, 2], maps[w, 2, 3]
        for k in range(count):
            x, y, z = xs[k], ys[k], zs[k]
            places[k] = (
                np.int32(a * x + b * y + c * z + p) * across
                + np.int32(d * x + e * y + f * z + q) * along
                + np.int32(g * x + h * y + i * z + r)
            )
        for k in range(count):
            marks[places[k]] = 1


@kernel
def _stamp_clipped(marks, shape, maps, xs, ys, zs):
    for w in range(len(maps)):
        for k in range(len(xs)):
            i = j = n = np.int64(-1)
            x = (
                maps[w, 0, 0] * xs[k]
                + maps[w, 0, 1] * ys[k]
                + maps[w, 0, 2] * zs[k]
                + maps[w, 0, 3]
            )
            if x >= 0.0 and x < shape[0]:
                i = np.int64(x)
            y = (
                maps[w, 1, 0] * xs[k]
                + maps[w, 1, 1] * ys[k]
                + maps[w, 1, 2] * zs[k]
                + maps[w, 1, 3]
            )
            if y >= 0.0 and y < shape[1]:
                j = np.int64(y)
            z = (
                maps[w, 2, 0] * xs[k]
                + maps[w, 2, 1] * ys[k]
                + maps[w, 2, 2] * zs[k]
                + maps[w, 2, 3]
            )
            if z >= 0.0 and z < shape[2]:
                n = np.int64(z)
            if i >= 0 and j >= 0 and n >= 0:
                marks[(i * shape[1] + j) * shape[2] + n] = 1


def stamp(marks: NDArray[np.uint8], maps: Floats, cloud: Floats, *, inside: bool) -> None:
    """Mark the voxels that hold a point of the images of a cloud.

    Parameters
    ----------
    marks
        uint8, shape (nx, ny, nz), C-contiguous and of fewer than 2³¹ voxels: what is hit is set to
        one.
    maps
        Shape (w, 3, 4): to places in the window, counted in voxels from its first corner.
    cloud
        Shape (3, n): x, y and z of the points.
    inside
        Whether all images are known to lie in the window, not nearer to its border than rounding;
        where they do not, images outside are left out, at a third of the speed.
    """
    flat = marks.reshape(-1)
    xs, ys, zs = (source(axis, np.float64) for axis in cloud)
    step = max(1, BATCH // max(1, len(xs)))
    places = np.empty(len(xs), np.int32)
    shape = source(marks.shape, np.int64)
    across, along = np.int32(marks.shape[1] * marks.shape[2]), np.int32(marks.shape[2])
    for first in range(0, len(maps), step):
        batch = source(maps[first : first + step], np.float64)
        if inside:
            _stamp(flat, across, along, batch, xs, ys, zs, places)
        else:
            _stamp_clipped(flat, shape, batch, xs, ys, zs)
