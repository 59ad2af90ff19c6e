"""How counts of a grid are taken: tile by tile, and added up."""

from __future__ import annotations

from functools import reduce
from operator import add
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from porous.values import VoxelGrid

    Index = tuple[int, int, int]
    Tile = tuple[Index, Index]

C = TypeVar("C", bound=Any)

TILE = 1 << 26
"""Voxels of a tile, about: labels of one tile take 256 MiB."""


def tiles_of(shape: Index, *, size: int = TILE) -> tuple[Tile, ...]:
    """Return slabs across x, as (start, stop), that fill a grid of ``shape``."""
    nx, ny, nz = shape
    planes = max(1, size // (ny * nz))
    return tuple(((a, 0, 0), (min(a + planes, nx), ny, nz)) for a in range(0, nx, planes))


def fold(
    count: Callable[[VoxelGrid, Index, Index], C], grid: VoxelGrid, tiles: Iterable[Tile]
) -> C:
    """Return the sum of ``count(grid, start, stop)`` over tiles that fill the grid.

    ``count`` looks at the voxels of its tile and at the layer below them (the tile's halo), so
    that every window of 2×2×2 voxels is seen by just one tile.
    """
    return reduce(add, (count(grid, start, stop) for start, stop in tiles))
