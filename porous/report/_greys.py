"""A body in coarser voxels, for a picture of what is inside it."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

import numpy as np

from porous.values import Frame, VoxelGrid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.values import Tiled

    Bytes = NDArray[np.uint8]

FINEST = 128
"""Voxels along the longest edge."""

SLAB = 1 << 26
"""Voxels that are read at once, about."""

HEAVY = 900_000
"""Bytes that the greys of a body may take, deflated."""

LEVEL = 7
"""How hard zlib tries."""

SHADES = (1, 8, 16, 32)
"""Steps of grey that are tried, until the body takes no more."""


def pooled(grid: Tiled, most: int = FINEST) -> VoxelGrid:
    """Return a grid with at most ``most`` voxels along an edge: means of blocks of the fills.

    Blocks are cubes of as many voxels along each axis; the last of them may be cut short, and the
    frame of what is returned reaches beyond the grid by what they lack.
    """
    shape = grid.frame.shape
    step = -(-max(shape) // most)
    if step == 1 and isinstance(grid, VoxelGrid):
        return grid
    count = tuple(-(-n // step) for n in shape)
    fill = np.empty(count, np.uint8)
    thick = step * max(1, SLAB // (step * shape[1] * shape[2]))
    for first in range(0, shape[0], thick):
        stop = min(first + thick, shape[0])
        slab, _ = grid.block((first, 0, 0), (stop, shape[1], shape[2]))
        fill[first // step : -(-stop // step)] = _means(slab, step)
    frame = grid.frame
    spacing = tuple(step * h for h in frame.spacing)
    low = frame.box.lower
    return VoxelGrid(Frame(low, spacing, count, frame.periodic, frame.unit), fill)  # type: ignore[arg-type]


def _means(fill: Bytes, step: int) -> Bytes:
    """Return the means of blocks, rounded; a block that is cut short has fewer voxels."""
    sums = fill.astype(np.uint32)
    size = np.ones((), np.uint32)
    for axis in (2, 1, 0):
        starts = range(0, fill.shape[axis], step)
        sums = np.add.reduceat(sums, starts, axis=axis, dtype=np.uint32)
        counts = np.diff([*starts, fill.shape[axis]]).astype(np.uint32)
        size = np.multiply.outer(counts, size)
    return ((sums + size // 2) // size).astype(np.uint8)


def packed_greys(fill: Bytes) -> tuple[bytes, int]:
    """Return fills deflated, and how many shades apart they are told: more where they are heavy."""
    for step in SHADES:
        deflated = zlib.compress(shades(fill, step).tobytes(), LEVEL)
        if len(deflated) <= HEAVY:
            break
    return deflated, step


def shades(fill: Bytes, step: int) -> Bytes:
    """Return fills at the nearest of shades that are ``step`` apart; none and full stay so."""
    most = round(255 / step)
    return np.asarray(np.rint(np.rint(fill * (most / 255)) * (255 / most)), np.uint8)
