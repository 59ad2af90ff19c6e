"""The counts of a grid, each taken once, when a measure first asks for it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from porous.kernels.fills import tile_fills
from porous.kernels.windows import FUNCTIONALS, tile_histogram
from porous.measures._connected import Phase, Pieces, joined
from porous.measures._fold import fold, tiles_of
from porous.values import VoxelGrid

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.measures._fold import Index, Tile
    from porous.values import Frame


@dataclass(frozen=True)
class FillCounts:
    """How many voxels there are by fill and bulk, int64 (256, 256), and how many sharp faces.

    A face is sharp where a full voxel meets an empty one: the surface lies in one of them, but
    no sample has told. They are counted by axis and lattice plane, int64 (3, longest + 1).
    """

    histogram: NDArray[np.int64]
    jumps: NDArray[np.int64]

    def __add__(self, other: FillCounts) -> FillCounts:
        return FillCounts(self.histogram + other.histogram, self.jumps + other.jumps)


def count_fills(grid: VoxelGrid, start: Index, stop: Index) -> FillCounts:
    """Count the fills of a tile; ``FillCounts`` add up."""
    periodic = grid.frame.periodic
    return FillCounts(*tile_fills(grid.fill, grid.bulk, start, stop, periodic=periodic))


def count_windows(grid: VoxelGrid, start: Index, stop: Index) -> NDArray[np.int64]:
    """Count the 2×2×2 windows of a tile, int64 (256,); histograms add up."""
    result: NDArray[np.int64] = tile_histogram(grid.fill, start, stop, periodic=grid.frame.periodic)
    return result


def count_inner_windows(grid: VoxelGrid, start: Index, stop: Index) -> NDArray[np.int64]:
    """Count the windows of a tile that lie inside the grid or across its periodic sides."""
    result: NDArray[np.int64] = tile_histogram(
        grid.fill, start, stop, periodic=grid.frame.periodic, beyond="nothing"
    )
    return result


def continued(grid: VoxelGrid) -> VoxelGrid:
    """Return the grid with one more layer at its upper ends: the last again, or the next period."""
    fill = grid.fill
    for axis, wraps in enumerate(grid.frame.periodic):
        width = [(0, int(a == axis)) for a in range(3)]
        fill = np.pad(fill, width, mode="wrap" if wraps else "edge")
    frame = replace(grid.frame, shape=fill.shape, periodic=(False, False, False))
    return VoxelGrid(frame, fill, sampling=grid.sampling)


def count_coarse_windows(grid: VoxelGrid, start: Index, stop: Index) -> NDArray[np.int64]:
    """Count the windows of every other voxel along each axis, in all eight ways to choose them."""
    total: NDArray[np.int64] = np.zeros(256, np.int64)
    for phase in product((0, 1), repeat=3):
        chosen = grid.fill[tuple(slice(first, None, 2) for first in phase)]
        a, b = (
            tuple((end - first + 1) // 2 for end, first in zip(ends, phase, strict=True))
            for ends in (start, stop)
        )
        if all(low < high for low, high in zip(a, b, strict=True)):
            total += tile_histogram(chosen, a, b, periodic=grid.frame.periodic)  # type: ignore[arg-type]
    return total


class Census:
    """What the measures of a grid are made of.

    Parameters
    ----------
    grid
        The body.
    tiles
        Boxes of voxels that fill it; slabs of its own choice where not given. The counts do not
        depend on them.
    sampled
        Whether the bulk was sampled at the 64 points of a fill, as that of a model with a bulk of
        its own is; else it is taken for exact.
    """

    def __init__(
        self, grid: VoxelGrid, *, tiles: Sequence[Tile] | None = None, sampled: bool = False
    ) -> None:
        self.grid = grid
        self.sampled = sampled and grid.bulk is not None
        self.tiles = tiles_of(grid.frame.shape) if tiles is None else tuple(tiles)
        self._pieces: dict[Phase, Pieces] = {}

    @property
    def frame(self) -> Frame:
        """The grid's frame."""
        return self.grid.frame

    @cached_property
    def fills(self) -> FillCounts:
        """Voxels by fill and bulk."""
        return fold(count_fills, self.grid, self.tiles)

    @cached_property
    def bulk_fills(self) -> FillCounts:
        """Voxels by how much of them is bulk, as ``fills`` counts what is solid of them."""
        assert self.grid.bulk is not None
        return fold(count_fills, replace(self.grid, fill=self.grid.bulk, bulk=None), self.tiles)

    @cached_property
    def windows(self) -> NDArray[np.int64]:
        """Windows of the solid in vacuum or periodic space."""
        return fold(count_windows, self.grid, self.tiles)

    @cached_property
    def continued_windows(self) -> NDArray[np.int64]:
        """Windows of the solid where the outermost voxels go on beyond the frame.

        As many as there are voxels, so that each direction has as many pairs: faces that end at
        the frame are seen as large as they are, and the frame's own sides not at all.
        """
        grid = continued(self.grid)
        return fold(count_inner_windows, grid, tiles_of(grid.frame.shape))

    @cached_property
    def coarse_windows(self) -> NDArray[np.int64]:
        """Windows of the solid at twice the spacing, eight times as many as one such grid has."""
        return fold(count_coarse_windows, self.grid, self.tiles)

    def number(self, functional: str) -> int:
        """Return one of ``kernels.windows.FUNCTIONALS`` of the solid."""
        return int(self.windows @ FUNCTIONALS[functional])

    def pieces(self, *, solid: bool, connectivity: int, in_bulk: bool = False) -> Pieces:
        """Return the connected components of a phase."""
        phase = Phase(solid, connectivity, in_bulk, *self._bulk_layers)
        if phase not in self._pieces:
            counts = fold(phase.count, self.grid, self.tiles)
            self._pieces[phase] = joined(counts)
        return self._pieces[phase]

    @cached_property
    def _bulk_layers(self) -> tuple[Index, Index]:
        nx, ny, nz = self.frame.shape
        if self.grid.bulk is None:
            return (0, 0, 0), (nx - 1, ny - 1, nz - 1)
        body = self.grid.bulk >= 128
        found = [np.flatnonzero(body.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1))]
        first = tuple(int(layers[0]) if len(layers) else 0 for layers in found)
        last = tuple(int(layers[-1]) if len(layers) else 0 for layers in found)
        return first, last  # type: ignore[return-value]
