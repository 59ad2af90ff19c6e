"""Chords of a phase along lines of voxels, counted by their length, on bits."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, popcount, row_bits, slabs, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Bools = NDArray[np.bool_]
    Ints = NDArray[np.int64]
    Words = NDArray[np.uint64]

SLAB = 1 << 22
"""Voxels that one kernel call looks at, about."""


class Phase(NamedTuple):
    """Bits of the voxels of a phase, and of those of which one knows what they are.

    Both of shape (x, y, words), 64 voxels along z in a word, the first in its lowest bit; none of
    ``known`` where all are. ``sides`` are the numbers of voxels.
    """

    inside: Words
    known: Words
    sides: tuple[int, int, int]

    @property
    def bulk(self) -> Phase:
        """Where one looks, as a phase that nothing else meets."""
        return Phase(self.known, self.known, self.sides)


class Runs(NamedTuple):
    """How many chords there are of each length in voxels, int64 (n + 1,).

    None, one or both of their ends are cut; on ``endless`` lines the phase goes all round.
    ``voxels`` and ``ends``, int64 (2,), are of lines of every other voxel, from the first and from
    the second one on: how many lie in the phase, and how many ends its chords have at the other
    one. Closed lines of an odd number of voxels have them all in two turns, and are told of once.
    """

    whole: Ints
    halves: Ints
    pieces: Ints
    endless: int
    voxels: Ints
    ends: Ints


def phase_of(mask: Bools, known: Bools | None = None) -> Phase:
    """Return the voxels of a phase as bits.

    Parameters
    ----------
    mask
        Shape (x, y, z): voxels of the phase.
    known
        Shape (x, y, z): where one looks; everywhere where not given.
    """
    words = (mask.shape[2] + 63) // 64
    inside = row_bits(mask, words)
    if known is None:
        return Phase(inside, source(np.zeros((0, 0, 0)), np.uint64), mask.shape)
    bits = row_bits(known, words)
    return Phase(source(inside & bits, np.uint64), bits, mask.shape)


def turned(phase: Phase, axis: int) -> Phase:
    """Return a phase with an axis and y the other way round: x or z, 0 or 2."""
    nx, ny, nz = phase.sides
    if axis == 0:
        inside, known = (source(bits.transpose(1, 0, 2), np.uint64) for bits in phase[:2])
        return Phase(inside, known, (ny, nx, nz))
    inside, known = (_turned(bits, nz) for bits in phase[:2])
    return Phase(inside, known, (nx, nz, ny))


def _turned(bits: Words, n: int) -> Words:
    result = np.zeros((len(bits), n, (bits.shape[1] + 63) // 64), np.uint64)
    size = max(1, SLAB // (n * max(1, bits.shape[1])))
    slabs(len(bits), size, lambda a, b: _turn(bits[a:b], np.empty(64, np.uint64), result[a:b]))
    return source(result, np.uint64)


def runs_along(phase: Phase, *, wraps: bool, goes_on: bool) -> Runs:
    """Count the runs of a phase along y.

    Runs that are followed by voxels that are not known are cut.

    Parameters
    ----------
    phase
        What ``phase_of`` or ``turned`` gave.
    wraps
        Whether lines close on themselves.
    goes_on
        Whether nobody knows what follows on lines that do not; else it is the other phase.
    """
    planes, n, wide = phase.sides
    size = max(1, SLAB // (n * wide))
    parts = -(-planes // size)
    counts = np.zeros((parts, 3, n + 1), np.int64)
    others = np.zeros((parts, 5), np.int64)

    def work(a: int, b: int) -> None:
        part, began = a // size, np.empty(64, np.int64)
        how = (a, b, int(wraps), int(goes_on))
        _runs(phase.inside, phase.known, how, began, counts[part], others[part])

    slabs(planes, size, work)
    (whole, halves, pieces), (endless, *told) = counts.sum(axis=0), others.sum(axis=0)
    voxels, ends = np.array(told, np.int64).reshape(2, 2)
    if wraps and n % 2:
        voxels, ends = voxels.sum(keepdims=True), ends.sum(keepdims=True)
    return Runs(whole, halves, pieces, int(endless), voxels, ends)


@kernel
def _turn(bits, block, result):
    """Write the bits of each plane as those of its transpose, in blocks of 64 by 64."""
    n = result.shape[1]
    for i in range(len(bits)):
        for first in range(0, bits.shape[1], 64):
            rows = min(64, bits.shape[1] - first)
            for w in range(bits.shape[2]):
                for k in range(64):
                    block[k] = bits[i, first + k, w] if k < rows else np.uint64(0)
                # Halves change places across the diagonal; then quarters, down to single bits.
                step, mask = 32, np.uint64(0xFFFFFFFF)
                while step:
                    shift = np.uint64(step)
                    for k in range(64):
                        if k & step == 0:
                            swap = ((block[k] >> shift) ^ block[k + step]) & mask
                            block[k] ^= swap << shift
                            block[k + step] ^= swap
                    step >>= 1
                    mask ^= mask << np.uint64(step)
                for k in range(min(64, n - 64 * w)):
                    result[i, 64 * w + k, first // 64] = block[k]


@kernel
def _hidden(known, i, j, w):
    """Return where nobody looks."""
    return ~known[i, j, w] if len(known) else np.uint64(0)


@kernel
def _ended(ended, hidden, place, began, counts):
    """Count the runs that end before a place, but for those that began nobody knows where."""
    while ended:
        lowest = ended & (~ended + np.uint64(1))
        ended ^= lowest
        start = began[popcount(lowest - np.uint64(1))]
        if start >= 0:
            cuts = (start & 1) + np.int64(hidden & lowest != 0)
            counts[cuts, place - (start >> 1)] += 1


@kernel
def _runs(inside, known, how, began, counts, others):
    first, last, wraps, goes_on = how
    n = inside.shape[1]
    beyond = ~np.uint64(0) if goes_on else np.uint64(0)
    for i in range(first, last):
        for w in range(inside.shape[2]):
            began[:] = -1
            # The voxel before, and that before it, and where these are hidden.
            before, earlier = np.uint64(0), np.uint64(0)
            unseen, unseen_too = beyond, beyond
            if wraps:
                before = inside[i, n - 1, w]
                earlier = inside[i, max(n - 2, 0), w]
                unseen = _hidden(known, i, n - 1, w)
                unseen_too = _hidden(known, i, max(n - 2, 0), w)
            for step in range(n):
                here = inside[i, step, w]
                hidden = _hidden(known, i, step, w)
                _ended(before & ~here, hidden, step, began, counts)
                begun = here & ~before
                while begun:
                    lowest = begun & (~begun + np.uint64(1))
                    begun ^= lowest
                    cut = np.int64(unseen & lowest != 0)
                    began[popcount(lowest - np.uint64(1))] = 2 * step + cut
                others[1 + (step & 1)] += np.int64(popcount(here))
                apart = (here ^ earlier) & ~(hidden | unseen_too)
                others[3 + (step & 1)] += np.int64(popcount(apart))
                before, earlier, unseen, unseen_too = here, before, hidden, unseen
            if not wraps:
                _ended(before, beyond, n, began, counts)
                others[3 + ((n - 1) & 1)] += np.int64(popcount(before & ~beyond))
                others[3 + (n & 1)] += np.int64(popcount(earlier & ~beyond))
                continue
            # Once more from the start, for those that go on there.
            for step in range(n):
                here = inside[i, step, w]
                hidden = _hidden(known, i, step, w)
                _ended(before & ~here, hidden, n + step, began, counts)
                before &= here
                if not before:
                    break
            others[0] += np.int64(popcount(before))
