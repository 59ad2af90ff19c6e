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
def _stamp_clipped(marks, shape, maps, xs, ys, zs, places):
    count = len(xs)
    nx, ny, nz = np.float64(shape[0]), np.float64(shape[1]), np.float64(shape[2])
    across, along = np.int32(shape[1] * shape[2]), np.int32(shape[2])
    for w in range(len(maps)):
        a, b, c, p = maps[w, 0, 0], maps[w, 0, 1], maps[w, 0, 2], maps[w, 0, 3]
        d, e, f, q = maps[w, 1, 0], maps[w, 1, 1], maps[w, 1, 2], maps[w, 1, 3]
        g, h, i, r = maps[w, 2, 0], maps[w, 2, 1], maps[w, 2, 2], maps[w, 2, 3]
        for k in range(count):
            x, y, z = xs[k], ys[k], zs[k]
            u = a * x + b * y + c * z + p
            v = d * x + e * y + f * z + q
            t = g * x + h * y + i * z + r
            inside = (u >= 0.0) & (u < nx) & (v >= 0.0) & (v < ny) & (t >= 0.0) & (t < nz)
            # Held within the window, so that the conversions are defined for all.
            u, v, t = min(max(u, 0.0), nx), min(max(v, 0.0), ny), min(max(t, 0.0), nz)
            place = np.int32(u) * across + np.int32(v) * along + np.int32(t)
            places[k] = place if inside else np.int32(-1)
        for k in range(count):
            if places[k] >= 0:
                marks[places[k]] = 1


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
        where they do not, images outside are left out, more slowly.
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
            _stamp_clipped(flat, shape, batch, xs, ys, zs, places)
