"""How counts of a grid are taken: tile by tile, and added up."""

from __future__ import annotations

import builtins
import math
from dataclasses import dataclass, field
from functools import partial, reduce
from itertools import groupby, product
from operator import add
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from porous.values import Frame
    from porous.values.tiled import Map, Tiled

    Axes = tuple[bool, bool, bool]
    Index = tuple[int, int, int]
    Tile = tuple[Index, Index]
    Bytes = NDArray[np.uint8]
    Voxels = tuple[Bytes, Bytes | None]
    Count = Callable[[Tiled, Index, Index], Any]
    Progress = Callable[[int, int], None]

C = TypeVar("C", bound=Any)


class Journal(Protocol):
    """Where the sums of the first tiles are written down, so that they need not be taken again."""

    def load(self, key: str) -> tuple[int, list[tuple[int, Any]]]:
        """Return how many tiles of the count that ``key`` names were taken, and their sums."""

    def save(self, key: str, done: int, sums: list[tuple[int, Any]]) -> None:
        """Write down the sums of the first ``done`` tiles, or let it be for now."""


TILE = 1 << 26
"""Voxels of a tile, about: a count of it takes less than 1 GiB."""


def tiles_of(shape: Index, *, size: int = TILE, chunk: Index = (1, 1, 1)) -> tuple[Tile, ...]:
    """Return boxes of voxels, as (start, stop), that fill a grid of ``shape``.

    Slabs across x while they are thick; beams along z where slabs would be thin, for tiles that
    share less border are joined in less time.

    Parameters
    ----------
    shape
        Numbers of voxels.
    size
        Voxels of a tile at most, about; one chunk is the least.
    chunk
        Tiles begin at multiples of this, so that none reads a part of a stored chunk.
    """
    _, ny, nz = shape
    rows = max(1, size // nz)
    parts = max(1, round(ny / math.sqrt(rows)))
    wide = _whole(-(-ny // parts), chunk[1])
    planes = _whole(rows // min(wide, ny), chunk[0])
    long = _whole(size // (planes * wide), chunk[2])
    steps = [(n, step) for n, step in zip(shape, (planes, wide, long), strict=True)]
    ranges = [[(a, min(a + step, n)) for a in range(0, n, step)] for n, step in steps]
    return tuple(tuple(zip(*tile, strict=True)) for tile in product(*ranges))  # type: ignore[misc]


def _whole(length: int, chunk: int) -> int:
    return max(chunk, length // chunk * chunk)


def fold(
    count: Callable[[Tiled, Index, Index], C],
    source: Tiled,
    tiles: Iterable[Tile],
    *,
    map: Map = builtins.map,  # noqa: A002
    journal: Journal | None = None,
    progress: Progress | None = None,
) -> C:
    """Return the sum of ``count(source, start, stop)`` over tiles that fill the grid.

    ``count`` looks at the voxels of its tile and at a layer or two below them (the tile's halo),
    so that every window of 2×2×2 voxels is seen by just one tile.

    Parameters
    ----------
    count
        What to take of a tile; its results add up by ``+``.
    source
        The grid: anything that gives out boxes of voxels.
    tiles
        Boxes as (start, stop) that fill the grid.
    map
        How a function is called for every tile: like the builtin, that is in order. It may hand
        them to other processes, for the function and the tiles can be pickled where ``count`` and
        ``source`` can; on one machine kernels use all threads as it is.
    journal
        Where sums are written down now and then; what it has of them is not counted again.
    progress
        Called as ``progress(done, count)`` after each tile; raising in it cancels.
    """
    wanted = tuple(tiles)
    key = f"{count!r} of {wanted!r}"
    before, sums = (0, []) if journal is None else journal.load(key)
    rest = wanted[before:]
    for done, result in enumerate(map(partial(_taken_of, count, source), rest), before + 1):
        # Halves are added first, so that no sum is added to more often than tiles double.
        rank, total = 0, result
        while sums and sums[-1][0] == rank:
            rank, total = rank + 1, sums.pop()[1] + total
        sums.append((rank, total))
        if journal is not None:
            journal.save(key, done, sums)
        if progress is not None:
            progress(done, len(wanted))
    whole: C = reduce(lambda later, earlier: earlier + later, [total for _, total in sums[::-1]])
    return whole


def _taken_of(count: Callable[[Tiled, Index, Index], C], source: Tiled, tile: Tile) -> C:
    return count(source, *tile)


@dataclass(frozen=True)
class Together:
    """Several counts at once, so that every voxel is fetched once; they add up one by one."""

    counts: tuple[Count, ...]

    def __repr__(self) -> str:
        # A function's own has its place in memory.
        names = [getattr(count, "__qualname__", None) or repr(count) for count in self.counts]
        return f"Together({', '.join(names)})"

    def __call__(self, source: Tiled, start: Index, stop: Index) -> Sums:
        """Take them all of one tile."""
        if len(self.counts) == 1:
            return Sums((self.counts[0](source, start, stop),))
        held = Held(source)
        held.block(tuple(max(0, a - DEPTH) for a in start), stop)  # type: ignore[arg-type]
        return Sums(tuple(count(held, start, stop) for count in self.counts))


@dataclass(frozen=True)
class Sums:
    """What several counts came to."""

    of: tuple[Any, ...]

    def __add__(self, other: Sums) -> Sums:
        return Sums(tuple(map(add, self.of, other.of)))


DEPTH = 2
"""Layers below a tile that counts look at, at most."""


@dataclass(frozen=True)
class Held:
    """A source that keeps the boxes it has given out, for counts that ask for them again.

    So does it what several counts of a tile are made of.
    """

    source: Tiled
    boxes: list[tuple[Index, Index, Voxels]] = field(default_factory=list)
    kept: dict[Any, Any] = field(default_factory=dict)

    def once(self, key: Any, make: Callable[[], C]) -> C:
        """Return what ``make`` returned when it was first asked for by this key."""
        if key not in self.kept:
            self.kept[key] = make()
        found: C = self.kept[key]
        return found

    @property
    def frame(self) -> Frame:
        return self.source.frame

    @property
    def sampling(self) -> str:
        return self.source.sampling

    @property
    def sampling_error(self) -> float:
        return self.source.sampling_error

    @property
    def hausdorff(self) -> float | None:
        return self.source.hausdorff

    def block(self, start: Index, stop: Index) -> Voxels:
        for first, last, voxels in self.boxes:
            if all(map(int.__le__, first, start)) and all(map(int.__le__, stop, last)):
                cut = tuple(slice(a - f, b - f) for a, b, f in zip(start, stop, first, strict=True))
                fill, bulk = voxels
                return fill[cut], None if bulk is None else bulk[cut]
        self.boxes.append((start, stop, self.source.block(start, stop)))
        return self.boxes[-1][2]


@dataclass(frozen=True)
class Block:
    """A tile with the layer below it, where there is one: along a periodic axis, always.

    ``first`` is the tile's first voxel in the grid, ``halo`` says along which axes there is a layer
    below, ``ends`` along which the body ends above.
    """

    fill: Bytes
    bulk: Bytes | None
    first: Index
    halo: Axes
    ends: Axes

    @classmethod
    def of(cls, source: Tiled, start: Index, stop: Index) -> Block:
        """Fetch the block of the tile ``start`` … ``stop`` (not within)."""
        shape, wraps = source.frame.shape, source.frame.periodic
        halo = tuple(a > 0 or w for a, w in zip(start, wraps, strict=True))
        ends = tuple(b == n and not w for b, n, w in zip(stop, shape, wraps, strict=True))
        layers = [
            [(a - 1) % n, *range(a, b)] if h else range(a, b)
            for a, b, n, h in zip(start, stop, shape, halo, strict=True)
        ]
        return cls(*layers_of(source, layers), start, halo, ends)  # type: ignore[arg-type]

    @property
    def owned(self) -> tuple[slice, ...]:
        """The tile's own voxels."""
        return tuple(slice(int(h), None) for h in self.halo)


def layers_of(source: Tiled, layers: Sequence[Sequence[int]]) -> Voxels:
    """Return the voxels where the chosen layers cross, which need not follow on each other."""
    stretches = [list(_stretches(chosen)) for chosen in layers]
    if all(len(found) == 1 for found in stretches):
        (x,), (y,), (z,) = stretches
        return source.block((x[1], y[1], z[1]), (x[2], y[2], z[2]))
    fill = np.empty([len(chosen) for chosen in layers], np.uint8)
    bulk: Bytes | None = None
    for x, y, z in product(*stretches):
        part, body = source.block((x[1], y[1], z[1]), (x[2], y[2], z[2]))
        to = tuple(slice(at, at + last - first) for at, first, last in (x, y, z))
        fill[to] = part
        if body is not None:
            bulk = np.empty_like(fill) if bulk is None else bulk
            bulk[to] = body
    return fill, bulk


def _stretches(layers: Sequence[int]) -> Iterable[tuple[int, int, int]]:
    """Yield where layers follow on each other: place among them, first, one after the last."""
    for _, group in groupby(enumerate(layers), lambda pair: pair[1] - pair[0]):
        found = list(group)
        yield found[0][0], found[0][1], found[-1][1] + 1
