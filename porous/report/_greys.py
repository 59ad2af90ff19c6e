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
    from porous.kernels.means import block_means

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
        fill[first // step : -(-stop // step)] = block_means(slab, step)
    frame = grid.frame
    spacing = tuple(step * h for h in frame.spacing)
    low = frame.box.lower
    return VoxelGrid(Frame(low, spacing, count, frame.periodic, frame.unit), fill)  # type: ignore[arg-type]


def packed_greys(fill: Bytes) -> tuple[bytes, int]:
    """Return fills deflated, and how many shades apart they are told: more where they are heavy."""
    for step in SHADES:
        last = step == SHADES[-1]
        deflated = _deflated(shades(fill, step), np.inf if last else HEAVY)
        if deflated is not None:
            break
    assert deflated is not None
    return deflated, step


def _deflated(fill: Bytes, most: float) -> bytes | None:
    """Return fills deflated; None, and no more work, where that takes more than ``most`` bytes."""
    packer, done, count = zlib.compressobj(LEVEL), [], 0
    for plane in fill:
        done.append(packer.compress(plane.tobytes()))
        count += len(done[-1])
        if count > most:
            return None
    done.append(packer.flush())
    return b"".join(done) if count + len(done[-1]) <= most else None


def shades(fill: Bytes, step: int) -> Bytes:
    """Return fills at the nearest of shades that are ``step`` apart; none and full stay so."""
    most = round(255 / step)
    every = np.rint(np.rint(np.arange(256) * (most / 255)) * (255 / most)).astype(np.uint8)
    return np.asarray(every[fill], np.uint8)
