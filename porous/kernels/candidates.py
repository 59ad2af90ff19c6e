"""Which voxels of a span are not marked yet, and which of a small one may be touched: sets of bits.

A span is the first and the last of a window's voxels along x, y and z. Blocks are of 4³ voxels of
the lattice, a word of 64 bits each; a window begins ``shift`` voxels, 0 to 7, after an even block.
"""

from __future__ import annotations

import numpy as np

from porous.kernels._shared import kernel

SMALL = 7.0
"""Boxes of less than this meet at most eight voxels along an axis: their candidates are eight
words, a voxel's bit being at its place modulo eight."""

ASKED = 27
"""Spans in more blocks than this are not asked whether all of their voxels are marked."""

SLACK = 1e-7
"""Slabs are wider by this part of a voxel, so that rounding loses none."""

EVERY = np.uint64((1 << 64) - 1)
STEEP = 1e30
"""Slope of a plane along z, which parts all of a column or nothing."""

_BITS = np.uint64(1) << np.arange(64, dtype=np.uint64)
PLANES = np.array(
    [
        [_BITS[some >> place & 1 == 1].sum() for some in range(16)]
        for place in np.indices((4, 4, 4)).reshape(3, 64)
    ],
    np.uint64,
)
"""The bits of a block's voxels that are in some of its planes across an axis, a bit each."""


@kernel
def _read(marks, free, made, shift, bi, bj, bk):
    # The voxels of a block that are in the window and not marked.
    left = np.uint64(0)
    i0, j0, k0 = 4 * bi - shift[0], 4 * bj - shift[1], 4 * bk - shift[2]
    for i in range(max(i0, 0), min(i0 + 4, marks.shape[0])):
        for j in range(max(j0, 0), min(j0 + 4, marks.shape[1])):
            for k in range(max(k0, 0), min(k0 + 4, marks.shape[2])):
                place = np.uint64((i - i0) << 4 | (j - j0) << 2 | (k - k0))
                left |= np.uint64(marks[i, j, k] == 0) << place
    free[bi, bj, bk], made[bi, bj, bk] = left, 1


@kernel
def _planes(axis, first, last, block):
    # The bits of a block's voxels that are, along an axis, in a span of the blocks' voxels.
    low, high = max(first - 4 * block, 0), min(last - 4 * block, 3)
    return PLANES[axis, (2 << high) - (1 << low)]


@kernel
def _in_blocks(shift, span):
    x0, x1, y0, y1, z0, z1 = span
    return (
        (x0 + shift[0], x1 + shift[0]),
        (y0 + shift[1], y1 + shift[1]),
        (z0 + shift[2], z1 + shift[2]),
    )


@kernel
def any_left(marks, free, made, shift, span):
    """Tell whether a span holds a voxel that is not marked, or is too large to say."""
    xs, ys, zs = _in_blocks(shift, span)
    many = ((xs[1] >> 2) - (xs[0] >> 2) + 1) * ((ys[1] >> 2) - (ys[0] >> 2) + 1)
    if many * ((zs[1] >> 2) - (zs[0] >> 2) + 1) > ASKED:
        return True
    for bi in range(xs[0] >> 2, (xs[1] >> 2) + 1):
        in_x = _planes(0, xs[0], xs[1], bi)
        for bj in range(ys[0] >> 2, (ys[1] >> 2) + 1):
            in_xy = in_x & _planes(1, ys[0], ys[1], bj)
            for bk in range(zs[0] >> 2, (zs[1] >> 2) + 1):
                if made[bi, bj, bk] == 0:
                    _read(marks, free, made, shift, bi, bj, bk)
                if free[bi, bj, bk] & in_xy & _planes(2, zs[0], zs[1], bk):
                    return True
    return False


@kernel
def left(marks, free, made, shift, span, masks, at, result):
    """Set of a row of masks what is not marked in a small span; tell whether that is any."""
    xs, ys, zs = _in_blocks(shift, span)
    found = np.uint64(0)
    for q in range(8):
        masks[result, q] = 0
    for bi in range(xs[0] >> 2, (xs[1] >> 2) + 1):
        in_x = _planes(0, xs[0], xs[1], bi)
        for bj in range(ys[0] >> 2, (ys[1] >> 2) + 1):
            in_xy = in_x & _planes(1, ys[0], ys[1], bj)
            for bk in range(zs[0] >> 2, (zs[1] >> 2) + 1):
                if made[bi, bj, bk] == 0:
                    _read(marks, free, made, shift, bi, bj, bk)
                q = (bi & 1) << 2 | (bj & 1) << 1 | bk & 1
                word = free[bi, bj, bk] & in_xy & _planes(2, zs[0], zs[1], bk) & masks[at, q]
                masks[result, q] |= word
                found |= word
    return found != 0


@kernel
def _run(first, last):
    # The places modulo eight of at most eight voxels, a bit each.
    run = ((2 << (last - first)) - 1) << (first & 7)
    return (run | run >> 8) & 255


@kernel
def within(shift, span, masks, at, result):
    """Set of a row of masks the part in a small span; tell whether that is any."""
    xs, ys, zs = _in_blocks(shift, span)
    x, y, z = _run(xs[0], xs[1]), _run(ys[0], ys[1]), _run(zs[0], zs[1])
    in_x = PLANES[0, x & 15], PLANES[0, x >> 4]
    in_y = PLANES[1, y & 15], PLANES[1, y >> 4]
    in_z = PLANES[2, z & 15], PLANES[2, z >> 4]
    found = np.uint64(0)
    for q in range(8):
        word = masks[at, q] & in_x[q >> 2] & in_y[q >> 1 & 1] & in_z[q & 1]
        masks[result, q] = word
        found |= word
    return found != 0


@kernel
def _column(i, j):
    # The first word of a column of voxels, and the place of its bits there.
    return (i & 4) | (j & 4) >> 1, np.uint64((i & 3) << 4 | (j & 3) << 2)


@kernel
def _between(slab, half, x, y):
    # Where along z the middles of a column's voxels are no further from a slab's middle than this.
    u, v, w, middle, _ = slab
    slope = 1.0 / w if w != 0.0 else STEEP
    at, reach = (middle - u * x - v * y) * slope, half * abs(slope)
    return at - reach, at + reach


@kernel
def _reach(slab):
    # How far from a slab's middle the middles of voxels are that it touches.
    return slab[4] + (abs(slab[0]) + abs(slab[1]) + abs(slab[2])) * 0.5 + SLACK


@kernel
def near(shift, start, span, masks, at, first, second):
    """Set a row of masks to what two slabs do not part from a body; tell whether that is any.

    A slab is a direction, where the body's middle is along it, and half of its width, in voxels of
    the lattice: the window makes no difference.
    """
    x0, x1, y0, y1, z0, z1 = span
    half, across, found = _reach(first), _reach(second), False
    for q in range(8):
        masks[at, q] = 0
    for i in range(x0, x1 + 1):
        for j in range(y0, y1 + 1):
            x, y = i + start[0] + 0.5, j + start[1] + 0.5
            low, high = _between(first, half, x, y)
            below, above = _between(second, across, x, y)
            low = max(max(low, below) - 0.5, np.float64(z0 + start[2]))
            high = min(min(high, above) - 0.5, np.float64(z1 + start[2]))
            if np.ceil(low) <= np.floor(high):
                k0, k1 = np.int64(np.ceil(low)), np.int64(np.floor(high))
                row, place = _column(i + shift[0], j + shift[1])
                run = _run(k0 - start[2] + shift[2], k1 - start[2] + shift[2])
                masks[at, row] |= np.uint64(run & 15) << place
                masks[at, row + 1] |= np.uint64(run >> 4) << place
                found = True
    return found


@kernel
def mark_one(marks, free, shift, i, j, k):
    """Mark a voxel."""
    marks[i, j, k] = 1
    i, j, k = i + shift[0], j + shift[1], k + shift[2]
    place = np.uint64((i & 3) << 4 | (j & 3) << 2 | k & 3)
    free[i >> 2, j >> 2, k >> 2] &= ~(np.uint64(1) << place)


@kernel
def mark(marks, free, shift, span, masks, at):
    """Mark the voxels of a row of masks that are in a small span."""
    x0, x1, y0, y1, z0, z1 = span
    for i in range(x0, x1 + 1):
        for j in range(y0, y1 + 1):
            row, place = _column(i + shift[0], j + shift[1])
            for k in range(z0, z1 + 1):
                along = k + shift[2]
                bit = np.uint64(1) << (place | np.uint64(along & 3))
                if masks[at, row | (along & 4) >> 2] & bit:
                    mark_one(marks, free, shift, i, j, k)
