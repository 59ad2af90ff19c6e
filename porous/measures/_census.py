"""The counts of a grid, each taken once, when a measure first asks for it."""

from __future__ import annotations

import builtins
import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.kernels.fills import block_fills
from porous.kernels.windows import FUNCTIONALS, block_histogram
from porous.measures._connected import Phase
from porous.measures._fold import DEPTH, Block, Together, fold, layers_of, tiles_of
from porous.values.tiled import Chunked

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from porous.measures._connected import PieceCounts, Pieces
    from porous.measures._fold import Count, Index, Journal, Progress, Tile
    from porous.values import Frame
    from porous.values.tiled import Map, Tiled

    Bytes = NDArray[np.uint8]
    Ints = NDArray[np.int64]


@dataclass(frozen=True)
class FillCounts:
    """How many voxels there are by fill and bulk, int64 (256, 256), and how many sharp faces.

    A face is sharp where a full voxel meets an empty one: the surface lies in one of them, but
    no sample has told. They are counted by axis and lattice plane, int64 (3, longest + 1).
    """

    histogram: Ints
    jumps: Ints

    def __add__(self, other: FillCounts) -> FillCounts:
        return FillCounts(self.histogram + other.histogram, self.jumps + other.jumps)


def count_fills(source: Tiled, start: Index, stop: Index) -> FillCounts:
    """Count the fills of a tile; ``FillCounts`` add up."""
    return _fills_of(Block.of(source, start, stop), source.frame)


def count_bulk_fills(source: Tiled, start: Index, stop: Index) -> FillCounts:
    """Count the voxels of a tile by how much of them is bulk, as if that were what is solid."""
    block = Block.of(source, start, stop)
    assert block.bulk is not None
    return _fills_of(replace(block, fill=block.bulk, bulk=None), source.frame)


def _fills_of(block: Block, frame: Frame) -> FillCounts:
    owned = block.bulk
    histogram, seen = block_fills(block.fill, owned, below=block.halo, above=block.ends)
    jumps: Ints = np.zeros((3, max(frame.shape) + 1), np.int64)
    for axis, below in enumerate(block.halo):
        planes = seen[axis, int(below) : block.fill.shape[axis] + 1]
        first = block.first[axis]
        jumps[axis, first : first + len(planes)] = planes
    return FillCounts(histogram, jumps)


def count_windows(source: Tiled, start: Index, stop: Index) -> Ints:
    """Count the 2×2×2 windows of a tile, int64 (256,); histograms add up."""
    block = Block.of(source, start, stop)
    return _histogram(block.fill, _told(block.halo, "nothing", "void"), _void(block.ends))


def count_continued_windows(source: Tiled, start: Index, stop: Index) -> Ints:
    """Count the windows of a tile where the outermost voxels go on beyond the frame.

    Eight times as many as there are voxels: along each axis that is not periodic windows within the
    frame count twice, and once those that look beyond one of its ends, where they find the
    outermost layer again. So a body that is turned round has the same.
    """
    block = Block.of(source, start, stop)
    before = [not halo for halo in block.halo]
    return _continued(block.fill, list(zip(before, block.ends, strict=True)))


def _continued(fill: Bytes, ends: list[tuple[bool, bool]]) -> Ints:
    """Count windows of layers, twice along each axis; once more beyond those of its ends that are.

    ``ends`` tells for each axis whether the first layer is the frame's, and whether the last is.
    """
    total: Ints = np.zeros(256, np.int64)
    within: list[tuple[slice, int]] = [(slice(None), 2)]
    for pieces in product(*(within + _beyond(*axis) for axis in ends)):
        piece = fill[tuple(layers for layers, _ in pieces)]
        for axis, (_, times) in enumerate(pieces):
            if times == 1:
                piece = np.concatenate([piece, piece], axis)
        counts = _histogram(piece, _NOTHING, _NOTHING)
        total += counts * math.prod(times for _, times in pieces)
    return total


_NOTHING = ("nothing", "nothing", "nothing")


def _beyond(first: bool, last: bool) -> list[tuple[slice, int]]:  # noqa: FBT001
    return [(slice(0, 1), 1)] * first + [(slice(-1, None), 1)] * last


def count_coarse_windows(source: Tiled, start: Index, stop: Index) -> Ints:
    """Count the windows of every other voxel along each axis, in all eight ways to choose them."""
    total: Ints = np.zeros(256, np.int64)
    for chosen, ways in _coarse(source, start, stop):
        below, above = (tuple(way.below for way in ways), tuple(way.above for way in ways))
        total += _histogram(chosen, below, above)
    return total


def count_coarse_continued_windows(source: Tiled, start: Index, stop: Index) -> Ints:
    """Count the windows of every other voxel in all eight ways, each as it goes on at the ends."""
    total: Ints = np.zeros(256, np.int64)
    for chosen, ways in _coarse(source, start, stop):
        total += _continued(chosen, [(w.below == "void", w.above == "void") for w in ways])
    return total


def _coarse(
    source: Tiled, start: Index, stop: Index
) -> Iterator[tuple[Bytes, tuple[_Way, _Way, _Way]]]:
    """Yield the voxels that each way has of a tile, and the ways of x, y and z."""
    axes = [
        _Coarse.of(a, b, n, wraps)
        for a, b, n, wraps in zip(start, stop, *_lattice(source.frame), strict=True)
    ]
    fill, _ = layers_of(source, [axis.layers for axis in axes])
    for x, y, z in product(*(axis.ways for axis in axes)):
        yield fill[x.first :: 2, y.first :: 2, z.first :: 2], (x, y, z)


def count_caps(source: Tiled, start: Index, stop: Index) -> Ints:
    """Count the solid voxel faces of a tile on the frame's border, int64 (3,), by their axis."""
    fill, _ = source.block(start, stop)
    counts: Ints = np.zeros(3, np.int64)
    for axis, (n, wraps) in enumerate(zip(*_lattice(source.frame), strict=True)):
        for at_border, layer in ((start[axis] == 0, 0), (stop[axis] == n, -1)):
            if at_border and not wraps:
                counts[axis] += np.count_nonzero(fill.take(layer, axis=axis) >= 128)
    return counts


@dataclass(frozen=True)
class Extent:
    """The outermost layers that hold bulk, per axis; of nothing the first is above the last."""

    first: Index
    last: Index

    def __add__(self, other: Extent) -> Extent:
        return Extent(
            tuple(map(min, self.first, other.first)),  # type: ignore[arg-type]
            tuple(map(max, self.last, other.last)),  # type: ignore[arg-type]
        )


def find_bulk(source: Tiled, start: Index, stop: Index) -> Extent:
    """Find the outermost layers of a tile that hold a voxel at least half in the bulk."""
    bulk = source.block(start, stop)[1]
    assert bulk is not None
    body = bulk >= 128
    found = [np.flatnonzero(body.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1))]
    if not len(found[0]):
        return Extent(source.frame.shape, (0, 0, 0))
    first, last = ([int(a + f[end]) for a, f in zip(start, found, strict=True)] for end in (0, -1))
    return Extent(tuple(first), tuple(last))  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Way:
    """One of the two ways to choose every other layer of a block, and what is next to them."""

    first: int
    below: str
    above: str


@dataclass(frozen=True)
class _Coarse:
    """The layers of a tile and the two below it, and the ways to choose every other of them.

    Along a periodic axis each way closes on itself, whatever the number of layers.
    """

    layers: tuple[int, ...]
    ways: tuple[_Way, ...]

    @classmethod
    def of(cls, start: int, stop: int, n: int, wraps: bool) -> _Coarse:  # noqa: FBT001
        seen = [v for v in range(start - DEPTH, stop) if v >= 0 or wraps]
        # Below the first layers are the last of the same way; of one layer there is but one way.
        layers = [v if v >= 0 else max(0, n - 1 - (n - 1 - v) % 2) for v in seen]
        ways = []
        for chosen in (start, start + 1):
            if chosen >= stop:
                continue
            below = "nothing" if chosen - 2 >= seen[0] else "void"
            last = chosen + (stop - 1 - chosen) // 2 * 2
            above = "void" if last + 2 >= n and not wraps else "nothing"
            first = chosen if below == "void" else chosen - 2
            ways.append(_Way(first - seen[0], below, above))
        return cls(tuple(layers), tuple(ways))


def _tiles(source: Tiled) -> tuple[Tile, ...]:
    if not isinstance(source, Chunked):
        return tiles_of(source.frame.shape)
    start, stop = source.tiles[0]
    x, y, z = (b - a for a, b in zip(start, stop, strict=True))
    return tiles_of(source.frame.shape, chunk=(x, y, z))


def _lattice(frame: Frame) -> tuple[Index, tuple[bool, bool, bool]]:
    return frame.shape, frame.periodic


def _told(axes: Sequence[bool], yes: str, no: str) -> tuple[str, ...]:
    return tuple(yes if axis else no for axis in axes)


def _void(axes: Sequence[bool]) -> tuple[str, ...]:
    return _told(axes, "void", "nothing")


def _histogram(fill: Bytes, below: tuple[str, ...], above: tuple[str, ...]) -> Ints:
    result: Ints = block_histogram(fill, below=below, above=above)
    return result


class Census:
    """What the measures of a grid are made of.

    Parameters
    ----------
    source
        The body: a grid, or anything that gives out boxes of one.
    tiles
        Boxes of voxels that fill it; where not given those that the source comes in, or such as
        suit. The counts do not depend on them.
    sampled
        Whether the bulk was sampled at the 64 points of a fill, as that of a model with a bulk of
        its own is; else it is taken for exact.
    map
        How tiles are counted; see ``fold``.
    journal
        Where sums are written down; see ``fold``.
    """

    def __init__(
        self,
        source: Tiled,
        *,
        tiles: Sequence[Tile] | None = None,
        sampled: bool = False,
        map: Map = builtins.map,  # noqa: A002
        journal: Journal | None = None,
    ) -> None:
        self.source = source
        self.has_bulk = source.block((0, 0, 0), (1, 1, 1))[1] is not None
        self.sampled = sampled and self.has_bulk
        self.tiles = _tiles(source) if tiles is None else tuple(tiles)
        self._map, self._journal = map, journal
        self._sums: dict[Count, Any] = {}

    @classmethod
    def of(
        cls,
        source: Tiled | Census,
        *,
        tiles: Sequence[Tile] | None = None,
        sampled: bool = False,
        map: Map = builtins.map,  # noqa: A002
    ) -> Census:
        """Return the census of a grid; one that has been begun is gone on with."""
        if isinstance(source, Census):
            return source
        return cls(source, tiles=tiles, sampled=sampled, map=map)

    @property
    def frame(self) -> Frame:
        """The grid's frame."""
        return self.source.frame

    def take(self, counts: Sequence[Count], progress: Progress | None = None) -> None:
        """Take counts that were not taken yet, all in one pass over the tiles."""
        wanted = tuple(count for count in dict.fromkeys(counts) if count not in self._sums)
        if wanted:
            together = Together(wanted)
            sums = fold(
                together,
                self.source,
                self.tiles,
                map=self._map,
                journal=self._journal,
                progress=progress,
            )
            self._sums.update(zip(wanted, sums.of, strict=True))

    def counted(self, count: Callable[[Tiled, Index, Index], Any]) -> Any:
        """Return a count of the whole grid."""
        self.take((count,))
        return self._sums[count]

    @property
    def fills(self) -> FillCounts:
        """Voxels by fill and bulk."""
        result: FillCounts = self.counted(count_fills)
        return result

    @property
    def bulk_fills(self) -> FillCounts:
        """Voxels by how much of them is bulk, as ``fills`` counts what is solid of them."""
        result: FillCounts = self.counted(count_bulk_fills)
        return result

    @property
    def windows(self) -> Ints:
        """Windows of the solid in vacuum or periodic space."""
        result: Ints = self.counted(count_windows)
        return result

    @property
    def continued_windows(self) -> Ints:
        """Windows of the solid where the outermost voxels go on beyond the frame.

        Eight times as many as there are voxels, so that each direction has as many pairs: faces
        that end at the frame are seen as large as they are, and the frame's own sides not at all.
        """
        if all(self.frame.periodic):
            return 8 * self.windows
        result: Ints = self.counted(count_continued_windows)
        return result

    @property
    def coarse_continued_windows(self) -> Ints:
        """Those at twice the spacing, eight times as many in all eight ways together."""
        if all(self.frame.periodic):
            return 8 * self.coarse_windows
        result: Ints = self.counted(count_coarse_continued_windows)
        return result

    @property
    def coarse_windows(self) -> Ints:
        """Windows of the solid at twice the spacing, eight times as many as one such grid has."""
        result: Ints = self.counted(count_coarse_windows)
        return result

    @property
    def caps(self) -> Ints:
        """Solid voxel faces on the frame's border across x, y and z, where it is not periodic."""
        result: Ints = self.counted(count_caps)
        return result

    def take_all(self, others: Sequence[Count], progress: Progress | None = None) -> None:
        """Take all that rows of a grid are made of, and others, in one pass where that can be.

        Where there is a bulk, one before it tells where that begins and ends.
        """
        passes = 1 + self.has_bulk

        def report(number: int) -> Progress | None:
            if progress is None:
                return None
            return lambda done, count: progress(number * count + done, passes * count)

        if self.has_bulk:
            self.take((find_bulk,), report(0))
        inside: tuple[Count, ...] = (count_continued_windows, count_coarse_continued_windows)
        inside = (count_caps, *(() if all(self.frame.periodic) else inside))
        of_sampled = (count_bulk_fills,) if self.sampled else inside
        phases = [
            self.phase(solid=solid, connectivity=connectivity, in_bulk=in_bulk)
            for solid, in_bulk in ((True, False), (False, True), (False, False))
            for connectivity in (6, 26)
            if solid or in_bulk or not any(self.frame.periodic)
        ]
        counts = (count_fills, count_windows, count_coarse_windows, *of_sampled, *phases, *others)
        self.take(counts, report(passes - 1))

    def number(self, functional: str) -> int:
        """Return one of ``kernels.windows.FUNCTIONALS`` of the solid."""
        return int(self.windows @ FUNCTIONALS[functional])

    def phase(self, *, solid: bool, connectivity: int, in_bulk: bool = False) -> Phase:
        """Return what counts the connected components of a phase."""
        extent = self._bulk_extent
        return Phase(solid, connectivity, in_bulk and self.has_bulk, extent.first, extent.last)

    def pieces(self, *, solid: bool, connectivity: int, in_bulk: bool = False) -> Pieces:
        """Return the connected components of a phase."""
        phase = self.phase(solid=solid, connectivity=connectivity, in_bulk=in_bulk)
        counts: PieceCounts = self.counted(phase)
        return counts.pieces

    @cached_property
    def _bulk_extent(self) -> Extent:
        nx, ny, nz = self.frame.shape
        if not self.has_bulk:
            return Extent((0, 0, 0), (nx - 1, ny - 1, nz - 1))
        extent: Extent = self.counted(find_bulk)
        return extent if extent.first <= extent.last else Extent((0, 0, 0), (0, 0, 0))
