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

TABLE = 1 << 10
"""Cosines whose class is looked up."""

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


def filtered(
    values: NDArray[np.float32], weights: NDArray[np.float64], axis: int, places: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Return what a filter makes of values along one axis.

    Parameters
    ----------
    values
        float32, shape (x, y, z).
    weights
        float64, shape (r + 1,): of a voxel, and of its neighbours to either side.
    axis
        Along which.
    places
        int64, r more than voxels along the axis at either end: which one stands there, −1 for 0.
    """
    given, out = source(values, np.float32), np.empty_like(values)
    taps, rows = source(weights, np.float64), source(places, np.int64)
    planes = max(1, CALL // values[0].size)
    slabs(len(values), planes, lambda a, b: _filter(given, taps, axis, rows, out, a, b))
    return out


@kernel
def _add(before, after, weight, totals):
    for k in range(len(totals)):
        totals[k] += (np.float64(before[k]) + np.float64(after[k])) * weight


@kernel
def _filter(values, weights, axis, places, out, first, last):
    _, ny, nz = values.shape
    reach = len(weights) - 1
    totals, none = np.empty(nz), np.zeros(nz, np.float32)
    line = np.empty(nz + 2 * reach, np.float32)
    for i in range(first, last):
        for j in range(ny):
            own = values[i, j]
            if axis == 2:
                for k in range(len(line)):
                    line[k] = own[places[k]] if places[k] >= 0 else np.float32(0.0)
            for k in range(nz):
                totals[k] = np.float64(own[k]) * weights[0]
            for m in range(reach, 0, -1):
                before, after = none, none
                if axis == 2:
                    before, after = line[reach - m : nz + reach - m], line[reach + m :][:nz]
                else:
                    at = (i if axis == 0 else j) + reach
                    low, high = places[at - m], places[at + m]
                    if low >= 0:
                        before = values[low, j] if axis == 0 else values[i, low]
                    if high >= 0:
                        after = values[high, j] if axis == 0 else values[i, high]
                _add(before, after, weights[m], totals)
            for k in range(nz):
                out[i, j, k] = totals[k]


@kernel
def _slope(before, after, beyond, behind):
    # Central difference of fourth order, times 12.
    return 8.0 * (after - before) - (behind - beyond)


@kernel
def _slopes(smooth, i, j, k, out):
    # The slopes along all axes.
    nx, ny, nz = smooth.shape
    inner = 1 < i < nx - 2 and 1 < j < ny - 2 and 1 < k < nz - 2
    for axis in range(3):
        x, y, z = axis == 0, axis == 1, axis == 2
        found = (np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0))
        if inner:
            found = (
                smooth[i - x, j - y, k - z],
                smooth[i + x, j + y, k + z],
                smooth[i - 2 * x, j - 2 * y, k - 2 * z],
                smooth[i + 2 * x, j + 2 * y, k + 2 * z],
            )
        else:
            found = (
                smooth[(i - x) % nx, (j - y) % ny, (k - z) % nz],
                smooth[(i + x) % nx, (j + y) % ny, (k + z) % nz],
                smooth[(i - 2 * x) % nx, (j - 2 * y) % ny, (k - 2 * z) % nz],
                smooth[(i + 2 * x) % nx, (j + 2 * y) % ny, (k + 2 * z) % nz],
            )
        out[axis] = _slope(*found)


@kernel
def _classes(cosines, table):
    # The class of every so many cosines, evenly spread.
    low = 0
    for t in range(len(table)):
        while low + 2 < len(cosines) and cosines[low + 1] <= t / TABLE:
            low += 1
        table[t] = low


@kernel
def _class(cosines, table, value):
    low = table[min(np.int64(value * TABLE), TABLE)]
    while low + 2 < len(cosines) and cosines[low + 1] <= value:
        low += 1
    return low


@kernel
def _mark(here, beside, bit, flags):
    for k in range(len(flags)):
        flags[k] |= np.uint8(here[k] != beside[k]) << bit


@kernel
def _faces(smooth, solid, steps, cosines, ends, within, found, first, last):
    nx, ny, nz = solid.shape
    normal, own, other = np.zeros(3), np.zeros(3), np.zeros(3)
    place, flags = np.zeros(3, np.int64), np.zeros(nz, np.uint8)
    table = np.empty(TABLE + 1, np.int64)
    _classes(cosines, table)
    for i in range(max(first, within[0, 0]), min(last, within[0, 1] + 1)):
        for j in range(within[1, 0], within[1, 1] + 1):
            flags[:] = 0
            row = solid[i, j]
            _mark(row, solid[(i + 1) % nx, j], 0, flags)
            _mark(row, solid[i, (j + 1) % ny], 1, flags)
            _mark(row[:-1], row[1:], 2, flags[:-1])
            flags[nz - 1] |= np.uint8(row[nz - 1] != row[0]) << 2
            for k in range(within[2, 0], within[2, 1] + 1):
                if flags[k] == 0:
                    continue
                here = row[k]
                _slopes(smooth, i, j, k, own)
                for axis in range(3):
                    if not flags[k] >> axis & 1:
                        continue
                    x, y, z = i, j, k
                    if axis == 0:
                        x = i + 1 if i + 1 < nx else 0
                    elif axis == 1:
                        y = j + 1 if j + 1 < ny else 0
                    else:
                        z = k + 1 if k + 1 < nz else 0
                    if x > within[0, 1] or y > within[1, 1] or z > within[2, 1]:
                        continue
                    _slopes(smooth, x, y, z, other)
                    size = 0.0
                    for b in range(3):
                        normal[b] = -(own[b] + other[b]) / steps[b]
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
                        c = _class(cosines, table, abs(normal[b]))
                        found[0, b, along, c] += area
                        if place[b] == ends[b, 0]:
                            found[1, b, along, c] += area
                        if place[b] == ends[b, 1]:
                            found[2, b, along, c] += area
