"""Places where basins touch, told by both and by how many periods lie between their images.

Voxels that no other basin touches are left out first, for whole rows at a time; of the others each
pair is told once, and pairs that tell the same are counted while they are at hand.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, slabs

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Progress = Callable[[int, int], None]

SLAB = 1 << 19
"""Voxels that one kernel call looks at, about."""

PLACES = 1 << 16
"""Places where basins touch that one kernel call tells, about."""

SLOT_BITS, MIXED = 12, 0x9E3779B97F4A7C15
"""What was told last is kept in so many slots, powers of two, and what mixes keys for these."""

WIDE, ZERO = 5, 1 << 14
"""Periods along x, y and z are one number, of so many bits each; and what makes it positive."""

MIDDLE = 16 * (1 + (1 << WIDE) + (1 << 2 * WIDE))
"""What makes each of the three positive."""

NONE, NOWHERE = np.int32((1 << 31) - 1), -(1 << 62)
"""As the least of labels, and as a voxel or as the largest of images: none."""


class Lattice(NamedTuple):
    """A grid, the axes along which it closes, and the period that a voxel lies in of its basin.

    Where no axis is periodic, there is one number for all voxels.
    """

    shape: NDArray[np.int64]
    wraps: NDArray[np.int64]
    periods: NDArray[np.int16]


class Touches(NamedTuple):
    """Places where two basins touch: what tells them, the height there, and how many they are.

    A key is the one label times ``size``, and the other, and below them in 3 × ``WIDE`` bits the
    periods between their images and ``ZERO``.
    """

    keys: NDArray[np.int64]
    saddles: NDArray[np.float32]
    counts: NDArray[np.int64]

    @classmethod
    def room(cls, n: int) -> Touches:
        """Return room for so many places."""
        return cls(np.empty(n, np.int64), np.empty(n, np.float32), np.ones(n, np.int64))

    @classmethod
    def joined(cls, parts: list[Touches]) -> Touches:
        """Return all places, each key once, as ``reduced`` does."""
        return cls(*(np.concatenate(all_) for all_ in zip(*parts, strict=True))).reduced()

    def some(self, places: NDArray[np.int64]) -> Touches:
        """Return some of the places."""
        return Touches(self.keys[places], self.saddles[places], self.counts[places])

    def reduced(self) -> Touches:
        """Return each key once, ascending, with the highest of its places."""
        order = np.lexsort((self.saddles, self.keys))
        keys, saddles, counts = self.keys[order], self.saddles[order], self.counts[order]
        first = np.flatnonzero(np.diff(keys, prepend=-1) != 0)
        if not len(first):
            return self
        last = np.append(first[1:], len(keys)) - 1
        return Touches(keys[first], saddles[last], np.add.reduceat(counts, first))

    def ends(self, size: int) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
        """Return both labels of each key, and the periods between them."""
        pairs = self.keys >> 3 * WIDE
        periods = (self.keys & ((1 << 3 * WIDE) - 1)) - ZERO
        return np.stack([pairs // size, pairs % size], axis=1).astype(np.int32), periods


def touching(
    labels: NDArray[np.int32],
    heights: NDArray[np.float32],
    lattice: Lattice,
    endless: NDArray[np.int64],
    *,
    told: bool,
    progress: Progress | None,
) -> Touches:
    """Return pairs of basins that touch, and the largest height at which they do.

    Parameters
    ----------
    labels, heights
        Of all voxels, in raster order; 0 of those that are in no basin.
    lattice
        Where they lie.
    endless
        int64, of each label: bits of the axes along which the basin goes on into its own image.
    told
        Whether keys are twice as large, and one more where a third basin is next to either voxel.
    progress
        Called as ``progress(done, count)`` in rows; raising in it cancels.
    """
    n, rows = int(lattice.shape[2]), int(np.prod(lattice.shape[:2]))
    slots, crowds = 1 << SLOT_BITS, np.empty(len(labels), np.uint8)
    step, asked = max(1, SLAB // n), int(told)
    parts: dict[int, Touches] = {}

    def work(a: int, b: int) -> None:
        place, part = np.array([a], np.int64), Touches.room(slots + PLACES + 13 * n)
        part.keys[:slots] = -1
        found = []
        while place[0] < b:
            stop = _touch(labels, heights, *lattice, endless, asked, crowds, place, b, part)
            found.append(part.some(np.arange(slots, stop)))
        found.append(part.some(np.flatnonzero(part.keys[:slots] >= 0)))
        parts[a] = Touches.joined(found)

    slabs(rows, step, lambda a, b: _crowd(labels, *lattice, asked, crowds, a, b))
    slabs(rows, step, work, progress)
    return Touches.joined([parts[a] for a in sorted(parts)])


@kernel
def _without(periods, axes):
    # Periods but for those along some axes.
    some = periods + MIDDLE
    for axis in range(3):
        if axes >> axis & 1:
            place = WIDE * (2 - axis)
            periods -= (((some >> place) & 31) - 16) << place
    return periods


@kernel
def _about(row, shape, wraps, steps, overs):
    # From voxel k of a row to its 27 neighbours, itself in the middle: ``steps`` + k, below zero
    # where there is none, in the period ``overs``; as if rows had no end.
    i, j = row // shape[1], row % shape[1]
    for r in range(9):
        x, y = i + r // 3 - 1, j + r % 3 - 1
        over = (x // shape[0] << 2 * WIDE) + (y // shape[1] << WIDE)
        if wraps[0]:
            x = (x + shape[0]) % shape[0]
        if wraps[1]:
            y = (y + shape[1]) % shape[1]
        inside = 0 <= x and x < shape[0] and 0 <= y and y < shape[1]
        for d in range(3):
            overs[3 * r + d] = over
            steps[3 * r + d] = (x * shape[1] + y) * shape[2] + d - 1 if inside else NOWHERE


@kernel
def _beside(k, s, shape, wraps, steps, overs):
    # A neighbour of voxel k of a row and the period it lies in; below zero where there is none.
    w, across = steps[s] + k, overs[s]
    if 0 < k and k < shape[2] - 1:
        return w, across
    turn = (k + s % 3 - 1) // shape[2]
    if turn and not wraps[2]:
        return NOWHERE, across
    return w - turn * shape[2], across + turn


@kernel
def _gather(labels, shape, wraps, periods, row, around, apart):
    # The nine rows about a row and their ends' neighbours, 0 where there is none; and how many
    # periods on from the image in the grid is that which is seen from the row.
    n, wound = shape[2], len(periods) > 1
    steps, overs = np.empty(27, np.int64), np.empty(27, np.int64)
    _about(row, shape, wraps, steps, overs)
    for r in range(9):
        around[r] = 0
        start = steps[3 * r + 1]
        if start < 0:
            continue
        around[r, 1 : n + 1] = labels[start : start + n]
        if wraps[2]:
            around[r, 0], around[r, n + 1] = labels[start + n - 1], labels[start]
        if wound:
            for k in range(n):
                apart[r, k + 1] = overs[3 * r] - periods[start + k]
            apart[r, 0], apart[r, n + 1] = apart[r, n] - 1, apart[r, 1] + 1


@kernel
def _bound(labels, low, high):
    for k in range(len(labels)):
        low[k] = min(low[k], labels[k] if labels[k] else NONE)
        high[k] = max(high[k], labels[k])


@kernel
def _differ(labels, low, high, left, right, first, last, flags):
    # Whether there is more than one label next to voxels that have one.
    for k in range(len(labels)):
        least, most = min(low[k], left[k], right[k]), max(high[k], first[k], last[k])
        flags[k] = (labels[k] != 0) & (least < most)


@kernel
def _several(around, apart, some, count, flags):
    # How many images that are not their own some voxels of a row touch: 0, 1, or 2 for several.
    for c in range(count):
        k = some[c]
        own, home = around[4, k + 1], apart[4, k + 1]
        low, high = NOWHERE, NOWHERE
        for s in range(27):
            label, away = around[s // 3, k + s % 3], apart[s // 3, k + s % 3] - home
            image = (np.int64(label) << 3 * WIDE) + away
            other = (label != 0) & ((label != own) | (away != 0))
            low = max(low, -image if other else NOWHERE)
            high = max(high, image if other else NOWHERE)
        flags[k] = (low != NOWHERE) + np.uint8(low != NOWHERE and high != -low)


@kernel
def _crowd(labels, shape, wraps, periods, asked, crowds, first, last):
    # Set 1 where another image may touch a voxel; where ``asked`` how many there are, up to 2.
    n = shape[2]
    around, apart = np.zeros((9, n + 2), np.int32), np.zeros((9, n + 2), np.int32)
    low, high = np.empty(n + 2, np.int32), np.empty(n + 2, np.int32)
    some = np.empty(n + 1, np.int64)
    for row in range(first, last):
        own, flags = labels[row * n : (row + 1) * n], crowds[row * n : (row + 1) * n]
        _gather(labels, shape, wraps, periods, row, around, apart)
        low[:], high[:] = NONE, 0
        for r in range(9):
            _bound(around[r], low, high)
        _differ(own, low[1:-1], high[1:-1], low[:-2], low[2:], high[:-2], high[2:], flags)
        if len(periods) > 1:
            for k in range(n):
                flags[k] = own[k] != 0
        if asked:
            count = 0
            for k in range(n):
                some[count] = k
                count += flags[k] != 0
            _several(around, apart, some, count, flags)


@kernel
def _third(labels, both, told, shape, wraps, periods, steps, overs):
    # Whether a basin's image that is none of two voxels' lies next to one of them, but for periods
    # along ``axes``; u lies ``across`` so many periods from v, and its image is ``apart`` so many.
    (u, v), (across, apart, axes) = both, told
    a, b = labels[v], labels[u]
    for place in (v, u):
        here = periods[v] + (across if place == u else 0)
        _about(place // shape[2], shape, wraps, steps, overs)
        for s in range(27):
            w, other = _beside(place % shape[2], s, shape, wraps, steps, overs)
            if w < 0 or labels[w] == 0:
                continue
            other = _without(other + here - periods[w], axes)
            if not ((labels[w] == a and other == 0) or (labels[w] == b and other == apart)):
                return 1
    return 0


@kernel
def _note(keys, saddles, counts, stop, key, saddle):
    # Keep a place in its slot, with those that have the same key; what was there goes to the end.
    slot = np.int64((np.uint64(key) * np.uint64(MIXED)) >> np.uint64(64 - SLOT_BITS))
    if keys[slot] == key:
        saddles[slot] = max(saddles[slot], saddle)
        counts[slot] += 1
        return stop
    if keys[slot] >= 0:
        keys[stop], saddles[stop], counts[stop] = keys[slot], saddles[slot], counts[slot]
        stop += 1
    keys[slot], saddles[slot], counts[slot] = key, saddle, 1
    return stop


@kernel
def _touch(labels, heights, shape, wraps, periods, endless, asked, crowds, place, last, found):
    # Pairs of voxels of two basins, or of one and its image, told once: row by row, as far as there
    # is room.
    keys, saddles, counts = found
    n, wound, size = shape[2], len(periods) > 1, np.int64(len(endless))
    stop = np.int64(1) << SLOT_BITS
    around, far = np.zeros((9, n + 2), np.int32), np.zeros((9, n + 2), np.int32)
    steps, overs = np.empty(27, np.int64), np.empty(27, np.int64)
    others = np.empty(27, np.int64), np.empty(27, np.int64)
    some, pairs = np.empty(n + 1, np.int64), np.empty(n + 1, np.int64)
    while place[0] < last and stop + 13 * n <= len(keys):
        row = place[0]
        place[0] += 1
        count = 0
        for k in range(n):
            some[count] = k
            count += crowds[row * n + k] != 0
        if count == 0:
            continue
        _gather(labels, shape, wraps, periods, row, around, far)
        _about(row, shape, wraps, steps, overs)
        for s in range(13):  # the other voxel tells of those after it
            met, r, d = 0, s // 3, s % 3
            for c in range(count):
                k = some[c]
                b, apart = around[r, k + d], far[r, k + d] - far[4, k + 1]
                pairs[met] = k
                met += (b != 0) & ((b != around[4, k + 1]) | (apart != 0))
            for c in range(met):
                k = pairs[c]
                v = row * n + k
                u, across = _beside(k, s, shape, wraps, steps, overs)
                a, b, apart, axes = around[4, k + 1], around[r, k + d], 0, 0
                if wound:
                    axes = endless[a] | endless[b]
                    apart = _without(far[r, k + d] - far[4, k + 1], axes)
                if a == b and apart == 0:
                    continue
                turned = a > b or (a == b and apart < 0)
                key = np.int64(min(a, b)) * size + max(a, b)
                key = (key << 3 * WIDE) + (-apart if turned else apart) + ZERO
                if asked:
                    third = np.int64(crowds[v] == 2 or crowds[u] == 2)
                    if third and axes:
                        told = across, apart, axes
                        third = _third(labels, (u, v), told, shape, wraps, periods, *others)
                    key = 2 * key + third
                saddle = min(heights[u], heights[v])
                stop = _note(keys, saddles, counts, stop, key, saddle)
    return stop
