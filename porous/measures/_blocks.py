"""How far numbers of a sample are off those of what it was taken from: block by block."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import GridError
from porous.values import Measure, VoxelGrid

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from porous.values.tiled import Tiled


class OverBlocks(NamedTuple):
    """Mean over blocks, its standard error, of the shape of what was taken, and their number."""

    mean: NDArray[np.float64]
    error: NDArray[np.float64]
    blocks: int


def over_blocks(
    take: Callable[[VoxelGrid], Measure | ArrayLike], grid: Tiled, *, blocks: int = 2
) -> OverBlocks:
    """Return what is taken of a grid's blocks: its mean, and its standard error by their spread.

    The uncertainty of a measure is that of the grid as the body. Where the grid is a sample of
    something larger, what is taken of another sample differs: by about the standard error told
    here, as long as blocks are large against what correlates.

    Parameters
    ----------
    take
        From a grid to a measure, or to numbers of the same shape for each block.
    grid
        The sample.
    blocks
        Into how many blocks each edge is cut, 2 at least; blocks are not periodic. Lengths that are
        no multiple lose their last voxels.

    Raises
    ------
    GridError
        For fewer than two blocks, or more than an edge has voxels.
    """
    frame = grid.frame
    if not (blocks == int(blocks) and 2 <= blocks <= min(frame.shape)):
        raise GridError(f"blocks: got {blocks}; wanted 2 … {min(frame.shape)} along each edge")
    size = [n // blocks for n in frame.shape]
    found = []
    for place in product(range(blocks), repeat=3):
        start = tuple(a * n for a, n in zip(place, size, strict=True))
        stop = tuple(a + n for a, n in zip(start, size, strict=True))
        taken = take(_block(grid, start, stop))  # type: ignore[arg-type]
        found.append(taken.value if isinstance(taken, Measure) else np.asarray(taken, np.float64))
    values = np.array(found)
    error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
    return OverBlocks(values.mean(axis=0), np.asarray(error), len(values))


def _block(grid: Tiled, start: tuple[int, int, int], stop: tuple[int, int, int]) -> VoxelGrid:
    from dataclasses import replace

    frame = replace(grid.frame.tile(start, stop), periodic=(False, False, False))
    fill, bulk = grid.block(start, stop)
    return VoxelGrid(frame, fill, bulk, grid.sampling, None, grid.sampling_error)
