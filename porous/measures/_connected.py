"""Connected pores and solids of a grid, counted tile by tile and joined where tiles overlap.

What of a tile can still be joined is the voxels that other tiles see too. Once all of a voxel's
tiles have been added it is forgotten, and so is a piece with no such voxel left, but for its size
and what it touches: a sum takes no more memory than its border.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.kernels.components import (
    label_chosen,
    layer_labels,
    sizes_from,
    touching,
    unite,
    widened,
)
from porous.measures._fold import Block, Held

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from porous.kernels.components import Runs
    from porous.measures._fold import Index
    from porous.values import Frame
    from porous.values.tiled import Tiled

    Bools = NDArray[np.bool_]
    Bytes = NDArray[np.uint8]
    Ints = NDArray[np.int64]

LOW, HIGH, OUTSIDE, ENDLESS = 1, 8, 64, 128
"""Marks of a piece, bit by bit; all but ``OUTSIDE`` are of x, and twice and four times that of y
and z."""

SIGHTINGS = 8
"""Tiles that may see a voxel, counted as the lattice vertices about it; see ``Sightings``."""


@dataclass(frozen=True)
class Pieces:
    """Connected components of one phase, those of one kind together.

    Parameters
    ----------
    sizes
        Number of voxels of each, int64, shape (n,).
    marks
        What each touches, int64, shape (n,): see ``low``, ``high``, ``outside``, ``endless``.
    counts
        How many there are of that size and those marks, int64, shape (n,).
    """

    sizes: Ints
    marks: Ints
    counts: Ints

    @classmethod
    def none(cls) -> Pieces:
        """Return no pieces."""
        return cls(*(np.zeros(0, np.int64) for _ in range(3)))

    def __add__(self, other: Pieces) -> Pieces:
        sizes, marks, counts = (
            np.concatenate(both)
            for both in (
                (self.sizes, other.sizes),
                (self.marks, other.marks),
                (self.counts, other.counts),
            )
        )
        order = np.lexsort((sizes, marks))
        sizes, marks, counts = sizes[order], marks[order], counts[order]
        differs = (np.diff(sizes, prepend=-1) != 0) | (np.diff(marks, prepend=-1) != 0)
        first = np.flatnonzero(differs)
        if not len(first):
            return self
        return Pieces(sizes[first], marks[first], np.add.reduceat(counts, first))

    @property
    def number(self) -> int:
        """How many pieces there are."""
        return int(self.counts.sum())

    @property
    def voxels(self) -> Ints:
        """Number of voxels in all pieces of each kind, int64, shape (n,)."""
        return self.sizes * self.counts

    @property
    def low(self) -> Bools:
        """Whether each reaches the bulk's first layer, per axis without period, shape (n, 3)."""
        return self._marked(LOW)

    @property
    def high(self) -> Bools:
        """Whether each reaches the bulk's last layer, per axis without period, shape (n, 3)."""
        return self._marked(HIGH)

    @property
    def outside(self) -> Bools:
        """Whether each touches the outside, bool, shape (n,).

        That is the border of the frame along an axis that is not periodic, or void that is not of
        the bulk.
        """
        return np.asarray(self.marks & OUTSIDE != 0)

    @property
    def endless(self) -> Bools:
        """Whether each winds around a periodic axis and so never ends, bool, shape (n, 3)."""
        return self._marked(ENDLESS)

    @property
    def through(self) -> Bools:
        """Whether each goes through the body, per axis: from end to end, or without end."""
        return np.asarray((self.low & self.high) | self.endless)

    @property
    def open(self) -> Bools:
        """Whether each is joined with the outside, or goes on without end."""
        return np.asarray(self.outside | self.endless.any(axis=1))

    def _marked(self, first: int) -> Bools:
        return np.asarray(self.marks[:, None] & (first << np.arange(3)) != 0)


@dataclass(frozen=True)
class Sightings:
    """Voxels that several tiles see, and which piece each tile found there.

    ``voxels`` are their numbers in the whole grid, int64, shape (m,), ascending; ``owners`` the
    pieces, int32; ``turns``, int32, shape (m, 3), how many periods off the grid the tile saw them,
    or (0, 3) where no axis is periodic. The tile that a voxel is of sees it, and so does every one
    that has a voxel above it, along one or more axes: each of the eight lattice vertices about it
    belongs to one tile's block. ``weights``, int8, says how many of them a sighting has; with
    ``SIGHTINGS`` of them no other tile sees the voxel.
    """

    voxels: Ints
    owners: NDArray[np.int32]
    turns: NDArray[np.int32]
    weights: NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.voxels)

    def __getitem__(self, chosen: Ints | Bools) -> Sightings:
        turns = self.turns[chosen] if len(self.turns) else self.turns
        return Sightings(self.voxels[chosen], self.owners[chosen], turns, self.weights[chosen])

    def beside(self, other: Sightings, first: int) -> Sightings:
        """Return both, in order; the other's pieces are numbered from ``first`` on."""
        owners = (other.owners + np.int32(first)).astype(np.int32)
        return Sightings.of([self, Sightings(other.voxels, owners, other.turns, other.weights)])

    @classmethod
    def of(cls, parts: Sequence[Sightings]) -> Sightings:
        """Return all of them, in order; of no parts there are none."""
        voxels: Ints = np.concatenate([part.voxels for part in parts] or [np.zeros(0, np.int64)])
        order = np.argsort(voxels, kind="stable")

        def sorted_(name: str, shape: tuple[int, ...], dtype: type) -> NDArray[Any]:
            found = [getattr(part, name) for part in parts]
            joined = np.concatenate([np.zeros(shape, dtype), *found])
            return joined[order] if len(joined) else joined

        return cls(
            voxels[order],
            sorted_("owners", (0,), np.int32),
            sorted_("turns", (0, 3), np.int32),
            sorted_("weights", (0,), np.int8),
        )

    def unfinished(self) -> Sightings:
        """Return one sighting of each voxel that other tiles see too; all have one owner."""
        if not len(self):
            return self
        first = np.flatnonzero(np.diff(self.voxels, prepend=-1))
        weights = np.add.reduceat(self.weights, first, dtype=np.int8)
        left = weights < SIGHTINGS
        kept = self[first[left]]
        return Sightings(kept.voxels, kept.owners, kept.turns, weights[left])


@dataclass(frozen=True)
class PieceCounts:
    """Pieces of some tiles, and what is needed to join them with those of others.

    ``done`` are those that no other tile sees. The others have ``sizes`` and ``marks``, int64,
    shape (n,), and voxels that others see.
    """

    done: Pieces
    sizes: Ints
    marks: Ints
    seen: Sightings

    def __add__(self, other: PieceCounts) -> PieceCounts:
        return _joined(
            self.done + other.done,
            np.concatenate([self.sizes, other.sizes]),
            np.concatenate([self.marks, other.marks]),
            self.seen.beside(other.seen, len(self.sizes)),
        )

    @property
    def pieces(self) -> Pieces:
        """The pieces of the whole grid.

        Raises
        ------
        ValueError
            Where the tiles that were added do not fill it.
        """
        if len(self.seen):
            raise ValueError("tiles: got some that do not fill the grid; wanted each voxel once")
        return self.done


def _joined(done: Pieces, sizes: Ints, marks: Ints, seen: Sightings) -> PieceCounts:
    """Join pieces that share a voxel, and put away those that no other tile sees.

    Each piece has a place in the plane unrolled along the periodic axes; where walking around by
    overlaps leads back to it at another place, it winds around, and never ends.
    """
    one = unite(seen.voxels, seen.owners, seen.turns, sizes, marks, around=ENDLESS)
    turns = seen.turns
    if len(turns):
        turns = (turns + one.places[seen.owners]).astype(np.int32)
    owners = one.numbers[seen.owners].astype(np.int32)
    left = Sightings(seen.voxels, owners, turns, seen.weights).unfinished()
    again = np.zeros(len(one.sizes), bool)
    again[left.owners] = True
    alone = Pieces(one.sizes[~again], one.marks[~again], np.ones((~again).sum(), np.int64))
    numbers = (np.cumsum(again) - 1).astype(np.int32)
    left = Sightings(left.voxels, numbers[left.owners], left.turns, left.weights)
    return PieceCounts(done + alone, one.sizes[again], one.marks[again], left)


@dataclass(frozen=True)
class Phase:
    """What is labelled: which voxels, how they are joined, and where the bulk begins and ends.

    ``first`` and ``last`` are the outermost layers of the bulk, per axis.
    """

    solid: bool
    connectivity: int
    in_bulk: bool
    first: Index
    last: Index

    def __call__(self, source: Tiled, start: Index, stop: Index) -> PieceCounts:
        """Count the pieces of the tile ``start`` … ``stop`` (not within)."""
        held = source if isinstance(source, Held) else Held(source)
        joined = replace(self, connectivity=6)
        found = held.once((joined, start, stop), lambda: joined.by_faces(held, start, stop))
        if self.connectivity == 26:
            found = found.widened()
        return _joined(Pieces.none(), found.sizes, found.marks, found.seen)

    def by_faces(self, source: Tiled, start: Index, stop: Index) -> _Found:
        """Return what faces join of a tile; edges and corners join some of that."""
        block = Block.of(source, start, stop)
        shape = block.fill.shape
        runs = label_chosen(lambda a, b: self._mask(block, slice(a, b)), shape)
        sizes = sizes_from(runs, shape, tuple(map(int, block.halo)))  # type: ignore[arg-type]
        marks: Ints = np.zeros(runs.total, np.int64)
        for (axis, layer), mark in self._marked_layers(block, source.frame).items():
            labels = layer_labels(runs, shape, axis, layer)
            marks[labels[labels > 0] - 1] |= mark
        if self.in_bulk and block.bulk is not None:
            beyond = (block.fill < 128) & (block.bulk < 128)
            marks[touching(runs, _grown(beyond))] |= OUTSIDE
        seen = Sightings.of(list(_shared_layers(block, source.frame, runs)))
        return _Found(runs, shape, sizes, marks, seen)

    def _mask(self, block: Block, planes: slice) -> Bools:
        fill = block.fill[planes]
        phase = fill >= 128 if self.solid else fill < 128
        if self.in_bulk and block.bulk is not None:
            phase &= block.bulk[planes] >= 128
        return np.asarray(phase)

    def _marked_layers(self, block: Block, frame: Frame) -> dict[tuple[int, int], int]:
        """Return marks that layers of the block, by axis and place, give to pieces."""
        found: dict[tuple[int, int], int] = {}
        for axis in (a for a in range(3) if not frame.periodic[a]):
            n = block.fill.shape[axis]
            for mark, layer in ((LOW, self.first[axis]), (HIGH, self.last[axis])):
                place = layer - block.first[axis] + block.halo[axis]
                if block.halo[axis] <= place < n:
                    found[axis, place] = found.get((axis, place), 0) | mark << axis
            sides = ((0, not block.halo[axis]), (n - 1, block.ends[axis]))
            for place in (place for place, is_outside in sides if is_outside):
                found[axis, place] = found.get((axis, place), 0) | OUTSIDE
        return found


class _Found(NamedTuple):
    """Components of a tile: their runs, sizes and marks, and the voxels that other tiles see."""

    runs: Runs
    shape: Index
    sizes: Ints
    marks: Ints
    seen: Sightings

    def widened(self) -> _Found:
        """Return what edges and corners join besides; the runs keep their components."""
        numbers, total = widened(self.runs, self.shape)
        sizes, marks = (np.zeros(total, np.int64) for _ in range(2))
        np.add.at(sizes, numbers, self.sizes)
        np.bitwise_or.at(marks, numbers, self.marks)
        seen = replace(self.seen, owners=numbers[self.seen.owners])
        return _Found(self.runs, self.shape, sizes, marks, seen)


def _shared_layers(block: Block, frame: Frame, runs: Runs) -> Iterator[Sightings]:
    """Yield the voxels of a phase that another block may see, each once."""
    shape = block.fill.shape
    index = [np.arange(n) + a - h for n, a, h in zip(shape, block.first, block.halo, strict=True)]
    weights, moved = [_weights(block, axis) for axis in range(3)], any(frame.periodic)
    for axis in range(3):
        for layer in np.flatnonzero(weights[axis] == 1):
            labels = layer_labels(runs, shape, axis, int(layer))
            for other in range(axis):  # the layers across these were told already
                cut: list[slice | Bools] = [slice(None), slice(None)]
                cut[other] = weights[other] == 1
                labels[tuple(cut)] = 0
            where = list(np.nonzero(labels))
            owners = (labels[tuple(where)] - 1).astype(np.int32)
            where.insert(axis, np.full(len(owners), layer))
            turns, places = zip(
                *(np.divmod(i[w], n) for i, w, n in zip(index, where, frame.shape, strict=True)),
                strict=True,
            )
            each = [w[at] for w, at in zip(weights, where, strict=True)]
            yield Sightings(
                np.asarray(np.ravel_multi_index(places, frame.shape)),
                owners,
                np.stack(turns, axis=1).astype(np.int32) if moved else np.zeros((0, 3), np.int32),
                np.prod(each, axis=0, dtype=np.int8),
            )


def _weights(block: Block, axis: int) -> NDArray[np.int8]:
    """Return how many vertices of the lattice, below and above, the block sees of each layer."""
    weights: NDArray[np.int8] = np.full(block.fill.shape[axis], 2, np.int8)
    if block.halo[axis]:
        weights[0] = 1
    if not block.ends[axis]:
        weights[-1] = 1
    return weights


def _grown(mask: Bools) -> Bools:
    """Return the voxels that are in the mask or next to it by a face, an edge or a corner."""
    result = mask.copy()
    for axis in range(3):
        before = np.moveaxis(result.copy(), axis, 0)
        after = np.moveaxis(result, axis, 0)
        after[1:] |= before[:-1]
        after[:-1] |= before[1:]
    return result
