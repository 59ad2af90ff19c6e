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

import numpy as np

_BITS = ((np.arange(256)[:, None] >> np.arange(8)) & 1).astype(bool)


def _any(*voxels):
    """Return for each window whether any of the voxels is solid."""
    return _BITS[:, [4 * x + 2 * y + z for x, y, z in voxels]].any(axis=1).astype(np.int64)


def _all(*voxels):
    """Return for each window whether all of the voxels are solid."""
    return _BITS[:, [4 * x + 2 * y + z for x, y, z in voxels]].all(axis=1).astype(np.int64)


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

DIRECTIONS = np.array(
    [
        *_ONE,
        *((0, 1, 1), (0, 1, -1), (1, 0, 1), (1, 0, -1), (1, 1, 0), (1, -1, 0)),
        *((1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1)),
    ]
)
"""The 13 directions between neighbouring voxels, shape (13, 3), in steps of one voxel."""

CROSSINGS = np.array([_crossing(direction) for direction in DIRECTIONS])
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
        **_SOLID,
        **_NEIGHBOURS,
        "faces_x": CROSSINGS[0],
        "faces_y": CROSSINGS[1],
        "faces_z": CROSSINGS[2],
        "euler_number_26": _SOLID["vertices"] - _SOLID["edges"] + _SOLID["faces"] - _SOLID["cells"],
        "euler_number": _SOLID["cells"]
        - _NEIGHBOURS["pairs"]
        + _NEIGHBOURS["squares"]
        - _NEIGHBOURS["cubes"],
    }
)
"""Whole-number weights of the 256 windows, int64, shape (256,); histogram · weights is the number of

* ``vertices``, ``edges``, ``faces``, ``cells`` of the closed union of solid voxels;
* ``pairs``, ``squares``, ``cubes`` of solid voxels joined by faces (2, 2×2, 2×2×2 voxels);
* ``faces_x``, ``faces_y``, ``faces_z``: voxel faces between the phases, by their normal;
* ``euler_number_26`` = vertices − edges + faces − cells, of the closed (26-connected) solid;
* ``euler_number`` = cells − pairs + squares − cubes, of the 6-connected solid.
"""
