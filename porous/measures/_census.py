"""The counts of a grid, each taken once, when a measure first asks for it."""

from __future__ import annotations

import builtins
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.kernels.fills import block_fills
from porous.kernels.windows import FUNCTIONALS, layer_windows
from porous.measures._connected import Phase
from porous.measures._fold import Block, Together, fold, layers_of, tiles_of
from porous.values.tiled import Chunked

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

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


@dataclass(frozen=True)
class WindowCounts:
    """Windows of a grid's solid; histograms add up.

    ``seen`` are those of the solid in vacuum or periodic space, int64 (3, 3, 3, 256), by what they
    see along each axis: voxels alone, or what lies below the first or above the last of them. Of
    ``continued`` ones, int64 (256,), where the outermost voxels go on beyond the frame, there are
    eight times as many as voxels: along each axis that is not periodic windows within the frame
    count twice, and once those that look beyond one of its ends, where they find the outermost
    layer again. So a body that is turned round has the same.
    """

    seen: Ints
    continued: Ints

    def __add__(self, other: WindowCounts) -> WindowCounts:
        return WindowCounts(self.seen + other.seen, self.continued + other.continued)

    @property
    def of_solid(self) -> Ints:
        """Windows of the solid, int64 (256,)."""
        return np.asarray(self.seen.sum(axis=(0, 1, 2)), np.int64)

    @property
    def of_void(self) -> Ints:
        """Windows of all that is not solid, beyond which there is nothing of it either."""
        total: Ints = np.zeros(256, np.int64)
        for sights in product(range(3), repeat=3):
            inside = _voxels_of(sights)
            numbers = np.flatnonzero(np.arange(256) & ~inside == 0)
            total[inside ^ numbers] += self.seen[sights][numbers]
        return total


def _voxels_of(sights: Sequence[int]) -> int:
    """Return the bits of a window's voxels that are not void for what it sees."""
    return sum(
        1 << place
        for place, voxel in enumerate(product((0, 1), repeat=3))
        if all(seen in (0, 2 - upper) for seen, upper in zip(sights, voxel, strict=True))
    )


def count_windows(source: Tiled, start: Index, stop: Index) -> WindowCounts:
    """Count the 2×2×2 windows of a tile."""
    return _windows(source, start, stop, 1)


def count_coarse_windows(source: Tiled, start: Index, stop: Index) -> WindowCounts:
    """Count the windows of every other voxel along each axis, in all eight ways to choose them."""
    return _windows(source, start, stop, 2)


def _windows(source: Tiled, start: Index, stop: Index, step: int) -> WindowCounts:
    """Count the windows of every ``step``-th layer whose upper voxels lie in the tile.

    Those that look beyond the upper end of the frame are of the last tile.
    """
    axes = [
        _Axis.of(a, b, n, step, wraps)
        for a, b, n, wraps in zip(start, stop, *_lattice(source.frame), strict=True)
    ]
    fill, _ = layers_of(source, [axis.layers for axis in axes])
    seen = layer_windows(fill, [axis.padded for axis in axes], step=step)
    continued = 8 * seen[0, 0, 0]
    for x, y, z in list(product(*(axis.pieces for axis in axes)))[1:]:
        piece = fill[x.layers, y.layers, z.layers]
        again = [end.again(n, step) for end, n in zip((x, y, z), piece.shape, strict=True)]
        times = x.times * y.times * z.times
        continued += times * layer_windows(piece, again, step=step)[0, 0, 0]
    return WindowCounts(seen, continued)


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
class _Piece:
    """Some layers of a tile, how often windows of them count, and whether they find them again."""

    layers: slice
    times: int

    def again(self, count: int, step: int) -> Ints:
        """Return the layers in their order: those at an end once more, behind each other."""
        return np.arange(count if self.times > 1 else count + step) % count


@dataclass(frozen=True)
class _Axis:
    """The layers of a tile and some below it, and what of them lies at the frame's ends.

    Along a periodic axis each way to choose every ``step``-th layer closes on itself, whatever the
    number of layers.
    """

    layers: tuple[int, ...]
    padded: Ints
    pieces: tuple[_Piece, ...]

    @classmethod
    def of(cls, start: int, stop: int, n: int, step: int, wraps: bool) -> _Axis:  # noqa: FBT001
        seen = [v for v in range(start - step, stop) if v >= 0 or wraps]
        # Below the first layers are the last of the same way; of one layer there is but one way.
        layers = tuple(v if v >= 0 else max(0, n - 1 - (n - 1 - v) % step) for v in seen)
        below, first = step - (start - seen[0]), start - seen[0]
        above = step if stop == n and not wraps else 0
        void = [[-1] * below, [-1] * above]
        pieces = [_Piece(slice(None), 2)]
        if below:
            pieces.append(_Piece(slice(first, first + below), 1))
        if above:
            pieces.append(_Piece(slice(max(0, len(layers) - step), None), 1))
        padded = np.array([*void[0], *range(len(layers)), *void[1]], np.int64)
        return cls(layers, padded, tuple(pieces))


def _tiles(source: Tiled) -> tuple[Tile, ...]:
    if not isinstance(source, Chunked):
        return tiles_of(source.frame.shape)
    start, stop = source.tiles[0]
    x, y, z = (b - a for a, b in zip(start, stop, strict=True))
    return tiles_of(source.frame.shape, chunk=(x, y, z))


def _lattice(frame: Frame) -> tuple[Index, tuple[bool, bool, bool]]:
    return frame.shape, frame.periodic


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
        return self._windows(count_windows).of_solid

    @property
    def void_windows(self) -> Ints:
        """Windows of all that is not solid, which ends where the frame does."""
        return self._windows(count_windows).of_void

    @property
    def inner_windows(self) -> Ints:
        """Windows of the solid that do not look beyond the frame."""
        return np.asarray(self._windows(count_windows).seen[0, 0, 0], np.int64)

    @property
    def continued_windows(self) -> Ints:
        """Windows of the solid where the outermost voxels go on beyond the frame.

        Eight times as many as there are voxels, so that each direction has as many pairs: faces
        that end at the frame are seen as large as they are, and the frame's own sides not at all.
        """
        return self._windows(count_windows).continued

    @property
    def coarse_windows(self) -> Ints:
        """Windows of the solid at twice the spacing, eight times as many as one such grid has."""
        return self._windows(count_coarse_windows).of_solid

    @property
    def coarse_continued_windows(self) -> Ints:
        """Those that go on at the ends, eight times as many in all eight ways together."""
        return self._windows(count_coarse_windows).continued

    def _windows(self, count: Count) -> WindowCounts:
        result: WindowCounts = self.counted(count)
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
        of_sampled = count_bulk_fills if self.sampled else count_caps
        phases = [
            self.phase(solid=solid, connectivity=connectivity, in_bulk=in_bulk)
            for solid, in_bulk in ((True, False), (False, True), (False, False))
            for connectivity in (6, 26)
            if solid or in_bulk or not any(self.frame.periodic)
        ]
        counts = (count_fills, count_windows, count_coarse_windows, of_sampled, *phases, *others)
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
