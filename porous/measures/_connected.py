"""Connected pores and solids of a grid, counted tile by tile and joined where tiles overlap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from porous.kernels.components import label

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.measures._fold import Index
    from porous.values import VoxelGrid

    Bools = NDArray[np.bool_]
    Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Pieces:
    """The connected components of one phase.

    Parameters
    ----------
    sizes
        Number of voxels of each, int64, shape (n,).
    low, high
        bool, shape (n, 3): whether it reaches the first and the last layer of the bulk, per axis
        that is not periodic.
    outside
        bool, shape (n,): whether it touches the outside (the border of the frame along an axis
        that is not periodic, or void that is not of the bulk).
    endless
        bool, shape (n, 3): whether it winds around a periodic axis and so never ends.
    """

    sizes: Ints
    low: Bools
    high: Bools
    outside: Bools
    endless: Bools

    @property
    def through(self) -> Bools:
        """Whether each goes through the body, per axis: from end to end, or without end."""
        return np.asarray((self.low & self.high) | self.endless)

    @property
    def open(self) -> Bools:
        """Whether each is joined with the outside, or goes on without end."""
        return np.asarray(self.outside | self.endless.any(axis=1))


@dataclass(frozen=True)
class PieceCounts:
    """Components of a tile and what is needed to join them with those of other tiles.

    ``flags`` are, per component, low x y z, high x y z, outside. The voxels in which tiles overlap
    are listed by their number in the whole grid (``voxels``), the component they are of
    (``owners``) and how many periods off the grid the tile saw them (``turns``).
    """

    sizes: Ints
    flags: Bools
    voxels: Ints
    owners: Ints
    turns: Ints

    def __add__(self, other: PieceCounts) -> PieceCounts:
        return PieceCounts(
            np.concatenate([self.sizes, other.sizes]),
            np.concatenate([self.flags, other.flags]),
            np.concatenate([self.voxels, other.voxels]),
            np.concatenate([self.owners, other.owners + len(self.sizes)]),
            np.concatenate([self.turns, other.turns]),
        )


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

    def count(self, grid: VoxelGrid, start: Index, stop: Index) -> PieceCounts:
        """Count the components of the tile ``start`` … ``stop`` (not within)."""
        block = _Block.of(grid, start, stop)
        mask = self._mask(block)
        labels, total = label(mask, self.connectivity)
        owned = labels[block.owned]
        flags = np.zeros((total + 1, 7), bool)
        for axis in (a for a in range(3) if not grid.frame.periodic[a]):
            for flag, layer in ((axis, self.first[axis]), (axis + 3, self.last[axis])):
                flags[_layer(owned, axis, layer - start[axis]), flag] = True
        flags[self._touching_outside(block, mask, labels), 6] = True
        sizes = np.bincount(owned.ravel(), minlength=total + 1)
        voxels, owners, turns = block.overlap(labels)
        return PieceCounts(sizes[1:], flags[1:], voxels, owners, turns)

    def _mask(self, block: _Block) -> Bools:
        phase = (block.fill >= 128) == self.solid
        if self.in_bulk and block.bulk is not None:
            phase &= block.bulk >= 128
        return np.asarray(phase)

    def _touching_outside(self, block: _Block, mask: Bools, labels: NDArray[np.int32]) -> Ints:
        found = [_layer(labels, *border).ravel() for border in block.borders]
        if self.in_bulk and block.bulk is not None:
            beyond = (block.fill < 128) & (block.bulk < 128)
            found.append(labels[_grown(beyond) & mask])
        return np.unique(np.concatenate(found)) if found else np.zeros(0, np.int64)


@dataclass(frozen=True)
class _Block:
    """A tile with the layer below it, where there is one."""

    fill: NDArray[np.uint8]
    bulk: NDArray[np.uint8] | None
    seen: tuple[Ints, Ints, Ints]
    """Index of each layer of the block, per axis; −1 and below are turned around."""
    shape: Index
    owned: tuple[slice, slice, slice]
    borders: tuple[tuple[int, int], ...]
    shared: tuple[tuple[int, int], ...]

    @classmethod
    def of(cls, grid: VoxelGrid, start: Index, stop: Index) -> _Block:
        shape, wraps = grid.frame.shape, grid.frame.periodic
        halo = [a > 0 or w for a, w in zip(start, wraps, strict=True)]
        seen = tuple(np.arange(a - h, b) for a, b, h in zip(start, stop, halo, strict=True))
        borders = [(axis, 0) for axis in range(3) if not halo[axis]]
        shared = [(axis, 0) for axis in range(3) if halo[axis]]
        for axis in range(3):
            at_end = stop[axis] == shape[axis] and not wraps[axis]
            (borders if at_end else shared).append((axis, len(seen[axis]) - 1))
        bulk = None if grid.bulk is None else _taken(grid.bulk, seen)
        owned = tuple(slice(int(h), None) for h in halo)
        return cls(
            _taken(grid.fill, seen),
            bulk,
            seen,  # type: ignore[arg-type]
            shape,
            owned,  # type: ignore[arg-type]
            tuple(borders),
            tuple(shared),
        )

    def overlap(self, labels: NDArray[np.int32]) -> tuple[Ints, Ints, Ints]:
        """Return number, component and turns of the set voxels that another block may see."""
        parts = list(self._overlaps(labels))
        voxels, owners, turns = zip(*parts, strict=True) if parts else ([], [], [])
        return (
            np.concatenate([np.zeros(0, np.int64), *voxels]),
            np.concatenate([np.zeros(0, np.int64), *owners]),
            np.concatenate([np.zeros((0, 3), np.int64), *turns]),
        )

    def _overlaps(self, labels: NDArray[np.int32]) -> Iterator[tuple[Ints, Ints, Ints]]:
        for axis, layer in self.shared:
            seen = [np.asarray(s[[layer]] if a == axis else s) for a, s in enumerate(self.seen)]
            part = _layer(labels, axis, layer)
            where = np.nonzero(part)
            place = np.stack([s[w] for s, w in zip(seen, where, strict=True)], axis=1)
            turns, index = np.divmod(place, self.shape)
            yield (
                np.asarray(np.ravel_multi_index(tuple(index.T), self.shape)),
                part[where].astype(np.int64) - 1,
                turns,
            )


def joined(counts: PieceCounts) -> Pieces:
    """Return the components of the whole grid from the counts of all its tiles.

    A voxel that two blocks saw makes their components one. Each component has a place in the
    plane unrolled along the periodic axes; where walking around by overlaps leads back to it at
    another place, it winds around, and never ends.
    """
    a, b, step = _links(counts)
    number, place = _spread(len(counts.sizes), a, b, step)
    total = int(number.max(initial=-1)) + 1
    flags = np.zeros((total, 7), bool)
    np.logical_or.at(flags, number, counts.flags)
    endless = np.zeros((total, 3), bool)
    np.logical_or.at(endless, number[a], place[b] - place[a] != step)
    sizes = np.bincount(number, counts.sizes, total).astype(np.int64)
    return Pieces(sizes, flags[:, :3], flags[:, 3:6], flags[:, 6], endless)


def _links(counts: PieceCounts) -> tuple[Ints, Ints, Ints]:
    """Return pairs of components that share a voxel, and the second's place from the first."""
    order = np.argsort(counts.voxels, kind="stable")
    voxels, owners, turns = counts.voxels[order], counts.owners[order], counts.turns[order]
    same = np.flatnonzero(voxels[1:] == voxels[:-1])
    step = turns[same] - turns[same + 1]
    links = np.column_stack([owners[same], owners[same + 1], step])
    links = np.unique(links, axis=0)
    return links[:, 0], links[:, 1], links[:, 2:]


def _spread(n: int, a: Ints, b: Ints, step: Ints) -> tuple[Ints, Ints]:
    """Return each component's connected set and its place along a spanning tree of the links."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(n, n))
    _, number = connected_components(graph, directed=False)
    roots = np.unique(number, return_index=True)[1]
    # One more node above all roots makes the forest a tree; its links lead nowhere.
    ends = np.concatenate([a, np.full(len(roots), n)]), np.concatenate([b, roots])
    tree = coo_array((np.ones(len(ends[0]), np.int8), ends), shape=(n + 1, n + 1)).tocsr()
    _, above = breadth_first_order(tree, n, directed=False)
    parent = np.where(above < 0, np.arange(n + 1), above)
    place = np.zeros((n + 1, 3), np.int64)
    for child, other, sign in ((b, a, 1), (a, b, -1)):
        along = parent[child] == other
        place[child[along]] = sign * step[along]
    while not np.array_equal(parent, parent[parent]):
        place += place[parent]
        parent = parent[parent]
    return number.astype(np.int64), place[:n]


def _taken(array: NDArray[np.uint8], seen: tuple[Ints, ...]) -> NDArray[np.uint8]:
    for axis, layers in enumerate(seen):
        if layers[0] < 0:
            array = array.take(layers, axis=axis, mode="wrap")
        else:
            cut = [slice(None)] * 3
            cut[axis] = slice(int(layers[0]), int(layers[-1]) + 1)
            array = array[tuple(cut)]
    return array


def _layer(array: NDArray[np.int32], axis: int, layer: int) -> NDArray[np.int32]:
    """Return one layer across an axis, empty where the array has none; it keeps three axes."""
    cut = [slice(None)] * 3
    cut[axis] = slice(layer, layer + 1) if layer >= 0 else slice(0, 0)
    return array[tuple(cut)]


def _grown(mask: Bools) -> Bools:
    """Return the voxels that are in the mask or next to it by a face, an edge or a corner."""
    result = mask.copy()
    for axis in range(3):
        before = np.moveaxis(result.copy(), axis, 0)
        after = np.moveaxis(result, axis, 0)
        after[1:] |= before[:-1]
        after[:-1] |= before[1:]
    return result
