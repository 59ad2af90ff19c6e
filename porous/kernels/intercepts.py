"""How often the phase changes between voxels a step apart, for many steps at once, on bits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, popcount, row_bits, slabs, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Axes = tuple[bool, bool, bool]
    Bools = NDArray[np.bool_]
    Ints = NDArray[np.int64]
    Words = NDArray[np.uint64]
    Progress = Callable[[int, int], None]

SLAB = 1 << 21
"""Voxels that one kernel call looks at, about, for each step."""

LONGEST = 63
"""Voxels of a step along an axis, at most."""


def changes(
    solid: Bools,
    known: Bools | None,
    steps: Ints,
    *,
    periodic: Axes,
    progress: Progress | None = None,
) -> tuple[Ints, Ints]:
    """Count the pairs of voxels a step apart, and those of them that differ in phase.

    Parameters
    ----------
    solid
        Shape (x, y, z): voxels of the one phase.
    known
        Shape (x, y, z), or None where all are: pairs with others do not count.
    steps
        int64, shape (m, 3), up to ``LONGEST`` along each axis, either sign.
    periodic
        Axes along which the grid closes on itself.
    progress
        Called as ``progress(done, count)`` in planes along x; raising in it cancels.

    Returns
    -------
    int64, shape (m,), twice: pairs that differ, and all.
    """
    given = source(np.where(steps[:, 2:] < 0, -steps, steps), np.int64)
    nx, ny, n = solid.shape
    ends = n, n + int(given[:, 2].max()) if periodic[2] else n
    words = (ends[1] + 63) // 64 + 1  # and one in which nothing is known
    bits = _rows(solid, ends[1], words)
    body = np.ones((1, ny, n), np.bool_) if known is None else known
    here, there = (_rows(body, end, words) for end in ends)
    wraps = source([periodic[0], periodic[1]], np.int64)
    size = max(1, SLAB // (ny * n))
    counts = np.zeros((-(-nx // size), len(steps), 2), np.int64)

    def work(a: int, b: int) -> None:
        _changes(bits, here, there, given, wraps, a, b, counts[a // size])

    slabs(nx, size, work, progress)
    differ, pairs = counts.sum(axis=0).T
    return differ, pairs


def _rows(mask: Bools, end: int, words: int) -> Words:
    """Return the bits of rows that go on, on closed lines, up to a voxel."""
    return row_bits(
        mask if end == mask.shape[2] else mask[..., np.arange(end) % mask.shape[2]], words
    )


@kernel
def _changes(bits, here, there, steps, wraps, first, last, counts):
    nx, ny, words = bits.shape
    for m in range(len(steps)):
        for i in range(first, last):
            p = i + steps[m, 0]
            if not 0 <= p < nx:
                if not wraps[0]:
                    continue
                p %= nx
            # Rows that follow each other do so a step away: they are one long row but at sides.
            j, stop = max(0, -steps[m, 1]), min(ny, ny - steps[m, 1])
            if wraps[1]:
                j, stop = 0, ny
            while j < stop:
                q = (j + steps[m, 1]) % ny
                rows = min(stop - j, ny - q)
                a, b = j * words, q * words
                size = rows * words - 1
                differ, pairs = _differ(
                    bits[i].reshape(-1)[a : a + size],
                    bits[p].reshape(-1)[b : b + size + 1],
                    here[min(i, len(here) - 1)].reshape(-1)[a : a + size],
                    there[min(p, len(there) - 1)].reshape(-1)[b : b + size + 1],
                    np.uint64(steps[m, 2]),
                )
                counts[m, 0] += np.int64(differ)
                counts[m, 1] += np.int64(pairs)
                j += rows


@kernel
def _differ(one, other, known, too, low):
    """Return how many pairs of bits differ, and all, the other ones of each so much higher."""
    # A shift by all of a word has no meaning: the step's other part is shifted in two.
    high, once = np.uint64(63) - low, np.uint64(1)
    differ, pairs = np.uint64(0), np.uint64(0)
    for w in range(len(one)):
        both = known[w] & ((too[w] >> low) | ((too[w + 1] << high) << once))
        apart = one[w] ^ ((other[w] >> low) | ((other[w + 1] << high) << once))
        pairs += popcount(both)
        differ += popcount(both & apart)
    return differ, pairs
