"""The 2×2×2 windows of a binary grid: how often each of the 256 occurs, and what that tells.

There is one window about every vertex of the lattice. Bit ``4·dx + 2·dy + dz`` of its number says
whether the voxel at ``vertex + (dx, dy, dz) − 1`` is solid. Around a body in vacuum the lattice is
padded by one void voxel on every side, (n+1) vertices along an axis of n voxels; along a periodic
axis the lattice closes on itself, n vertices.

Every functional below is additive over windows and attributes each thing to exactly one window, so
all weights are whole numbers (denominator 1): the vertex itself; the three edges that leave it
upwards; the three squares between those; the voxel above it, bit 7 (Schladitz, Ohser & Nagel 2006
use the same histogram with other attributions).
"""

from __future__ import annotations

from itertools import product
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Axes = tuple[bool, bool, bool]
    Beyond = tuple[str, ...]
    Progress = Callable[[int, int], None]

_BITS = ((np.arange(256)[:, None] >> np.arange(8)) & 1).astype(bool)


def _table(weights):
    table = np.array(weights, np.int64)
    table.flags.writeable = False
    return table


def _any(*voxels):
    """Return for each window whether any of the voxels is solid."""
    return _table(_BITS[:, [4 * x + 2 * y + z for x, y, z in voxels]].any(axis=1))


def _all(*voxels):
    """Return for each window whether all of the voxels are solid."""
    return _table(_BITS[:, [4 * x + 2 * y + z for x, y, z in voxels]].all(axis=1))


def _about(free):
    """Return the voxels of a window that have 1 wherever ``free`` does not let them vary."""
    return tuple(product(*((0, 1) if axis else (1,) for axis in free)))


def _crossing(direction):
    """Return for each window whether its pair of voxels along ``direction`` differs in phase.

    A pair that does not vary along an axis lies in the upper half of the window.
    """
    low = [1 if step == 0 else (1 - step) // 2 for step in direction]
    high = [1 if step == 0 else (1 + step) // 2 for step in direction]
    return _any(low, high) - _all(low, high)


_ONE = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
_TWO = ((0, 1, 1), (1, 0, 1), (1, 1, 0))
_CUBE = _about((1, 1, 1))

DIRECTIONS = _table(
    [
        *_ONE,
        *((0, 1, 1), (0, 1, -1), (1, 0, 1), (1, 0, -1), (1, 1, 0), (1, -1, 0)),
        *((1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1)),
    ]
)
"""The 13 directions between neighbouring voxels, shape (13, 3), in steps of one voxel."""

CROSSINGS = _table([_crossing(direction) for direction in DIRECTIONS])
"""Phase changes along each of ``DIRECTIONS``, shape (13, 256): every pair of neighbours once."""

_SOLID = {
    "vertices": _any(*_CUBE),
    "edges": sum(_any(*_about(free)) for free in _TWO),
    "faces": sum(_any(*_about(free)) for free in _ONE),
    "cells": _all((1, 1, 1)),
}
_NEIGHBOURS = {
    "pairs": sum(_all(*_about(free)) for free in _ONE),
    "squares": sum(_all(*_about(free)) for free in _TWO),
    "cubes": _all(*_CUBE),
}

FUNCTIONALS = MappingProxyType(
    {
        name: _table(weights)
        for name, weights in {
            **_SOLID,
            **_NEIGHBOURS,
            "faces_x": CROSSINGS[0],
            "faces_y": CROSSINGS[1],
            "faces_z": CROSSINGS[2],
            "euler_number_26": _SOLID["vertices"]
            - _SOLID["edges"]
            + _SOLID["faces"]
            - _SOLID["cells"],
            "euler_number": _SOLID["cells"]
            - _NEIGHBOURS["pairs"]
            + _NEIGHBOURS["squares"]
            - _NEIGHBOURS["cubes"],
        }.items()
    }
)
"""Weights of the 256 windows, int64, shape (256,); histogram · weights is the number of

* ``vertices``, ``edges``, ``faces``, ``cells`` of the closed union of solid voxels;
* ``pairs``, ``squares``, ``cubes`` of solid voxels joined by faces (2, 2×2, 2×2×2 voxels);
* ``faces_x``, ``faces_y``, ``faces_z``: voxel faces between the phases, by their normal;
* ``euler_number_26`` = vertices − edges + faces − cells, of the closed (26-connected) solid;
* ``euler_number`` = cells − pairs + squares − cubes, of the 6-connected solid.
"""

SLAB = 1 << 22
"""Voxels that one kernel call looks at, about: milliseconds of work, a cache's worth of bits."""


def window_histogram(
    fill: NDArray[np.uint8],
    *,
    periodic: Axes = (False, False, False),
    progress: Progress | None = None,
) -> NDArray[np.int64]:
    """Count the 2×2×2 windows of a whole grid, solid where ``fill`` ≥ 128.

    Parameters
    ----------
    fill
        uint8, shape (x, y, z).
    periodic
        Axes along which the grid closes on itself; else it lies in void.
    progress
        Called as ``progress(done, count)`` in planes along x.

    Returns
    -------
    int64, shape (256,): how often each window occurs; see ``FUNCTIONALS``.
    """
    below, above = (tuple(told if w else "void" for w in periodic) for told in ("last", "nothing"))
    return block_histogram(fill, below=below, above=above, progress=progress)


def block_histogram(
    fill: NDArray[np.uint8],
    *,
    below: Beyond,
    above: Beyond,
    progress: Progress | None = None,
) -> NDArray[np.int64]:
    """Count the windows of a block of voxels and of what lies next to it.

    A tile of a larger grid is counted with the layer below it as part of the block: tiles that
    fill the grid then have every vertex of the lattice once, so that their counts add up.

    Parameters
    ----------
    fill
        uint8, shape (x, y, z).
    below, above
        What lies below and above the block, per axis: ``"nothing"``, so that windows which look
        there are not counted; ``"void"``; below also ``"last"``, the block's last layer, on which
        it closes; above also ``"again"``, one more layer like its last.
    progress
        Called as ``progress(done, count)`` in planes along x.

    Returns
    -------
    int64, shape (256,).
    """
    xs, ys, zs = (
        np.array([*_BELOW[low](n), *range(n), *_ABOVE[high](n)], np.int64)
        for low, high, n in zip(below, above, fill.shape, strict=True)
    )
    if min(len(xs), len(ys), len(zs)) < 2:
        return np.zeros(256, np.int64)
    given = source(fill, np.uint8)
    planes = max(1, SLAB // (len(ys) * len(zs)))
    count = len(xs) - 1
    result = np.zeros((-(-count // planes), 256), np.int64)

    def work(a, b):
        bits = np.empty((b - a + 1, len(ys), len(zs) // 64 + 1), np.uint64)
        _pack(given, xs[a : b + 1], ys, zs, bits)
        _count(bits, len(zs) - 1, result[a // planes])

    slabs(count, planes, work, progress)
    return result.sum(axis=0)


_BELOW = {"nothing": lambda _: [], "void": lambda _: [-1], "last": lambda n: [n - 1]}
_ABOVE = {"nothing": lambda _: [], "void": lambda _: [-1], "again": lambda n: [n - 1]}


@kernel
def _pack(fill, xs, ys, zs, bits):
    """Set bit p of row (i, j) of ``bits`` where the voxel (xs[i], ys[j], zs[p]) is solid.

    Between its ends ``zs`` counts upwards by one; bits beyond it are clear.
    """
    length = len(zs)
    end = length - 1
    # Only the ends may be void or another layer; between them zs counts upwards.
    first = zs[1] - 1
    for i in range(len(xs)):
        for j in range(len(ys)):
            row = bits[i, j]
            row[:] = 0
            if xs[i] < 0 or ys[j] < 0:
                continue
            line = fill[xs[i], ys[j]]
            if zs[0] >= 0:
                row[0] = np.uint64(line[zs[0]] >> 7)
            if zs[end] >= 0:
                row[end >> 6] |= np.uint64(line[zs[end]] >> 7) << np.uint64(end & 63)
            for w in range((length + 63) // 64):
                low = max(64 * w, 1)
                high = min(64 * w + 64, end)
                word = np.uint64(0)
                for p in range(low, high):
                    word |= np.uint64(line[first + p] >> 7) << np.uint64(p - 64 * w)
                row[w] |= word


@kernel
def _popcount(x):
    """Return the number of set bits, as uint64; one machine instruction once compiled."""
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)


@kernel
def _count(bits, vertices, histogram):
    """Add the windows of packed rows to ``histogram``; ``vertices`` lie along each row."""
    one = np.uint64(1)
    top = np.uint64(63)
    full = ~np.uint64(0)
    words = (vertices + 63) // 64
    last = full >> np.uint64(64 * words - vertices)
    none = np.uint64(0)
    every = np.uint64(0)
    for i in range(bits.shape[0] - 1):
        for j in range(bits.shape[1] - 1):
            for w in range(words):
                a0 = bits[i, j, w]
                b0 = bits[i, j + 1, w]
                c0 = bits[i + 1, j, w]
                d0 = bits[i + 1, j + 1, w]
                a1 = a0 >> one
                b1 = b0 >> one
                c1 = c0 >> one
                d1 = d0 >> one
                if w + 1 < bits.shape[2]:
                    a1 |= bits[i, j, w + 1] << top
                    b1 |= bits[i, j + 1, w + 1] << top
                    c1 |= bits[i + 1, j, w + 1] << top
                    d1 |= bits[i + 1, j + 1, w + 1] << top
                mask = last if w + 1 == words else full
                some = (a0 | a1 | b0 | b1 | c0 | c1 | d0 | d1) & mask
                all8 = a0 & a1 & b0 & b1 & c0 & c1 & d0 & d1 & mask
                none += _popcount(mask & ~some)
                every += _popcount(all8)
                mixed = some & ~all8
                while mixed:
                    lowest = mixed & (~mixed + one)
                    mixed ^= lowest
                    t = _popcount(lowest - one)
                    low = (
                        (a0 >> t & one)
                        | (a1 >> t & one) << np.uint64(1)
                        | (b0 >> t & one) << np.uint64(2)
                    )
                    low |= (
                        (b1 >> t & one) << np.uint64(3)
                        | (c0 >> t & one) << np.uint64(4)
                        | (c1 >> t & one) << np.uint64(5)
                    )
                    histogram[
                        low | (d0 >> t & one) << np.uint64(6) | (d1 >> t & one) << np.uint64(7)
                    ] += 1
    histogram[0] += np.int64(none)
    histogram[255] += np.int64(every)
