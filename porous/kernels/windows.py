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

from itertools import pairwise, product
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, popcount, slabs, words_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

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
    beside = [_BELOW[low](n) for low, n in zip(below, fill.shape, strict=True)]
    after = [_ABOVE[high](n) for high, n in zip(above, fill.shape, strict=True)]
    layers = [
        np.array([*low, *range(n), *high], np.int64)
        for low, n, high in zip(beside, fill.shape, after, strict=True)
    ]
    return np.asarray(layer_windows(fill, layers, progress=progress).sum(axis=(0, 1, 2)), np.int64)


def layer_windows(
    fill: NDArray[np.uint8],
    layers: Sequence[NDArray[np.int64]],
    *,
    step: int = 1,
    progress: Progress | None = None,
) -> NDArray[np.int64]:
    """Count the windows of layers of a block, each of voxels some layers apart.

    Parameters
    ----------
    fill
        uint8, shape (x, y, z), in any order of memory.
    layers
        Per axis the block's layers in their order, int64; −1 for one of void. Void may be at the
        ends alone.
    step
        How many of these layers there are from a window's lower voxels to its upper ones: windows
        of every ``step``-th layer are counted, in all ways to choose these.
    progress
        Called as ``progress(done, count)`` in planes along x.

    Returns
    -------
    int64, shape (3, 3, 3, 256): by what windows see along x, y and z: 0 layers of the block alone,
    1 void below one, 2 void above one.
    """
    count, across, along = (len(axis) - step for axis in layers)
    result = np.zeros((0, 27, 256), np.int64)
    if min(count, across, along) > 0:
        planes = max(1, SLAB // (len(layers[1]) * len(layers[2])))
        result = np.zeros((-(-count // planes), 27, 256), np.int64)
        first, second, third = (_sights(axis, step) for axis in layers)
        masks = words_of(np.equal.outer(np.arange(3), _to_words(third, 3)))

        def work(a: int, b: int) -> None:
            bits = _packed(fill, layers[0][a : b + step], *layers[1:])
            _count(bits, step, first[a:b], second, masks, result[a // planes])

        if count <= planes and progress is None:
            work(0, count)
        else:
            slabs(count, planes, work, progress)
    return np.asarray(result.sum(axis=0).reshape(3, 3, 3, 256), np.int64)


_BELOW = {"nothing": lambda _: [], "void": lambda _: [-1], "last": lambda n: [n - 1]}
_ABOVE = {"nothing": lambda _: [], "void": lambda _: [-1], "again": lambda n: [n - 1]}


def _sights(layers: NDArray[np.int64], step: int) -> NDArray[np.int64]:
    """Return what windows see along an axis: layers alone, void below, above or nothing else."""
    return np.asarray((layers[:-step] < 0) + 2 * (layers[step:] < 0), np.int64)


def _to_words(line: NDArray[np.int64], other: int) -> NDArray[np.int64]:
    """Return a line made longer by ``other``, to whole words."""
    return np.pad(line, (0, -len(line) % 64), constant_values=other)


def _packed(fill, xs, ys, zs):
    """Return bits (i, j, p) set where the voxel (xs[i], ys[j], zs[p]) is solid, 64 to a word."""
    room = np.zeros((len(xs), len(ys), -(-len(zs) // 64) * 64), np.bool_)
    for parts in product(*map(_stretches, (xs, ys, zs))):
        there, here = (tuple(slices) for slices in zip(*parts, strict=True))
        np.greater_equal(fill[here], 128, out=room[there])
    return words_of(room)


def _stretches(layers):
    """Return where layers that are not void follow on each other: places among them, and them."""
    breaks = np.flatnonzero((np.diff(layers) != 1) | (layers[:-1] < 0)) + 1
    parts = [(a, b) for a, b in pairwise([0, *breaks.tolist(), len(layers)]) if layers[a] >= 0]
    return [(slice(a, b), slice(layers[a], layers[a] + b - a)) for a, b in parts]


@kernel
def _count(bits, step, xs, ys, masks, histogram):
    """Add windows to ``histogram`` by what they see; ``masks`` are where on a line they see what.

    A mixed window's number is put together of two bits of each of four rows; for every other voxel
    these are parted, and the numbers' bits so too.
    """
    one = np.uint64(1)
    words = masks.shape[1]
    up, down = np.uint64(step), np.uint64(64 - step)
    pair = one | one << up
    b_at = np.uint64(2 if step == 1 else 1)
    d_at = np.uint64(6 if step == 1 else 5)
    c_at = np.uint64(4)
    half = np.uint64(32)
    zero = np.uint64(0)
    found = np.zeros((27, 256), np.int64)
    for i in range(bits.shape[0] - step):
        for j in range(bits.shape[1] - step):
            if xs[i] > 2 or ys[j] > 2:
                continue
            first = 9 * xs[i] + 3 * ys[j]
            for w in range(words):
                a, b = bits[i, j, w], bits[i, j + step, w]
                c, d = bits[i + step, j, w], bits[i + step, j + step, w]
                e, f, g, h = zero, zero, zero, zero
                if w + 1 < bits.shape[2]:
                    e, f = bits[i, j, w + 1], bits[i, j + step, w + 1]
                    g, h = bits[i + step, j, w + 1], bits[i + step, j + step, w + 1]
                any_low, all_low = a | b | c | d, a & b & c & d
                some = any_low | any_low >> up | (e | f | g | h) << down
                every = all_low & (all_low >> up | (e & f & g & h) << down)
                for k in range(3):
                    chosen = masks[k, w]
                    if chosen == 0:
                        continue
                    side = first + k
                    found[side, 0] += np.int64(popcount(chosen & ~some))
                    found[side, 255] += np.int64(popcount(chosen & every))
                    mixed = chosen & some & ~every
                    if mixed == 0:
                        continue
                    low = mixed & np.uint64(0xFFFFFFFF)
                    while low:
                        t = popcount((low & (~low + one)) - one)
                        low &= low - one
                        number = (a >> t & pair) | (b >> t & pair) << b_at
                        number |= (c >> t & pair) << c_at | (d >> t & pair) << d_at
                        found[side, number] += 1
                    high = mixed >> half
                    if high == 0:
                        continue
                    p, q = a >> half | e << half, b >> half | f << half
                    r, s = c >> half | g << half, d >> half | h << half
                    while high:
                        t = popcount((high & (~high + one)) - one)
                        high &= high - one
                        number = (p >> t & pair) | (q >> t & pair) << b_at
                        number |= (r >> t & pair) << c_at | (s >> t & pair) << d_at
                        found[side, number] += 1
    for number in range(256):
        place = number
        if step > 1:  # what was parted comes together again
            place = number & 0x99 | (number & 0x22) << 1 | (number & 0x44) >> 1
        for side in range(27):
            histogram[side, place] += found[side, number]
