"""Sums of what voxels count, by the layer that they lie in, and over layers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Axes = tuple[bool, bool, bool]
    Bytes = NDArray[np.uint8]
    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

SLAB = 1 << 22
"""Voxels that one kernel call looks at, about."""

_NO_BULK = np.zeros((0, 0, 0), np.uint8)


def layer_sums(
    fill: Bytes, bulk: Bytes | None, worth: tuple[Ints, Ints]
) -> tuple[tuple[Ints, Ints], ...]:
    """Return what the voxels of each layer along x, y and z count: solid, no more than bulk; bulk.

    Parameters
    ----------
    fill
        uint8, shape (x, y, z).
    bulk
        uint8 of that shape, or None where all voxels count as 255.
    worth
        int64, shape (256,): what each byte of fill counts, and what of bulk.
    """
    given, body = source(fill, np.uint8), source(_NO_BULK if bulk is None else bulk, np.uint8)
    solids, bulks = (source(each, np.int64) for each in worth)
    nx, ny, nz = fill.shape
    planes = max(1, SLAB // (ny * nz))
    x, *others = (np.zeros((2, -(-nx // planes), n), np.int64) for n in (planes, ny, nz))

    def work(a: int, b: int) -> None:
        part = [sums[:, a // planes] for sums in (x, *others)]
        _layers(given[a:b], body[a:b], solids, bulks, *part)

    slabs(nx, planes, work)
    along = [x.reshape(2, -1)[:, :nx], *(sums.sum(axis=1) for sums in others)]
    return tuple((solid, body) for solid, body in along)


def summed_planes(
    fill: Bytes,
    bulk: Bytes | None,
    worth: tuple[Floats, Floats, Floats],
    wraps: Axes,
    planes: tuple[int, int],
) -> Floats:
    """Return sums over planes across x: of solid, no more than bulk, of bulk, and of windows.

    Parameters
    ----------
    fill
        uint8, shape (x, y, z).
    bulk
        uint8 of that shape, or None where all voxels count as 255.
    worth
        float64, shape (256,): what each byte of fill counts, what of bulk, and what each window of
        two by two by two voxels that has this one as its last: solid is bit 4·x + 2·y + z.
    wraps
        Along which axes the last voxel lies before the first; else the second does, for it is as
        good as the next.
    planes
        The first, and the one after the last.

    Returns
    -------
    float64, shape (3, y, z).
    """
    given, body = source(fill, np.uint8), source(_NO_BULK if bulk is None else bulk, np.uint8)
    tables = source(worth, np.float64)
    ends = [n - 1 if w else min(1, n - 1) for n, w in zip(fill.shape, wraps, strict=True)]
    result = np.zeros((3, *fill.shape[1:]))
    before = source(ends, np.int64)
    _planes(given, body, tables, before, *planes, np.empty(fill.shape[2] + 1, np.uint8), result)
    return result


@kernel
def _layers(fill, bulk, solids, bulks, x, y, z):
    nx, ny, nz = fill.shape
    for i in range(nx):
        for j in range(ny):
            row, total = fill[i, j], np.int64(0)
            if len(bulk) == 0:
                for k in range(nz):
                    solid = min(solids[row[k]], bulks[255])
                    total += solid
                    z[0, k] += solid
                whole = nz * bulks[255]
            else:
                body, whole = bulk[i, j], np.int64(0)
                for k in range(nz):
                    most = bulks[body[k]]
                    solid = min(solids[row[k]], most)
                    total += solid
                    whole += most
                    z[0, k] += solid
                    z[1, k] += most
            x[0, i] += total
            x[1, i] += whole
            y[0, j] += total
            y[1, j] += whole
    if len(bulk) == 0:
        for k in range(nz):
            z[1, k] += nx * ny * bulks[255]


@kernel
def _planes(fill, bulk, worth, before, first, last, codes, result):
    ny, nz = result.shape[1:]
    for i in range(first, last):
        low = i - 1 if i else before[0]
        for j in range(ny):
            left = j - 1 if j else before[1]
            a, b, c, d = fill[low, left], fill[low, j], fill[i, left], fill[i, j]
            for k in range(nz):
                code = (a[k] >> 7) | (b[k] >> 7) << 2 | (c[k] >> 7) << 4 | (d[k] >> 7) << 6
                codes[k + 1] = code
            codes[0] = codes[before[2] + 1]
            for k in range(nz):
                solid, most = worth[0, d[k]], worth[1, 255]
                if len(bulk):
                    most = worth[1, bulk[i, j, k]]
                result[0, j, k] += min(solid, most)
                result[1, j, k] += most
                result[2, j, k] += worth[2, codes[k] | codes[k + 1] << 1]
