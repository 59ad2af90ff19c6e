"""How often the phase changes between voxels a step apart, for many steps at once, on bits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, popcount, slabs, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Axes = tuple[bool, bool, bool]
    Bytes = NDArray[np.uint8]
    Ints = NDArray[np.int64]
    Words = NDArray[np.uint64]
    Progress = Callable[[int, int], None]

PORE, SOLID, UNKNOWN = range(3)
"""What a voxel is, or where nobody looks."""

SLAB = 1 << 21
"""Voxels that one kernel call looks at, about, for each step."""

LONGEST = 63
"""Voxels of a step along an axis, at most."""


def changes(
    codes: Bytes, steps: Ints, *, periodic: Axes, progress: Progress | None = None
) -> tuple[Ints, Ints]:
    """Count the pairs of voxels a step apart, and those of them that differ in phase.

    Parameters
    ----------
    codes
        uint8, shape (x, y, z): PORE, SOLID or UNKNOWN. Pairs with the latter do not count.
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
    upwards = np.where(steps[:, 2:] < 0, -steps, steps)
    n = codes.shape[2]
    size = max(1, SLAB // (codes.shape[1] * n))
    words = _packed(codes, int(upwards[:, 2].max()), size, wraps=periodic[2])
    wraps = source([periodic[0], periodic[1]], np.int64)
    given = source(upwards, np.int64)
    counts = np.zeros((-(-len(codes) // size), len(steps), 2), np.int64)

    def work(a: int, b: int) -> None:
        _changes(words, n, given, wraps, a, b, counts[a // size])

    slabs(len(codes), size, work, progress)
    differ, known = counts.sum(axis=0).T
    return differ, known


def _packed(codes: Bytes, reach: int, size: int, *, wraps: bool) -> Words:
    """Return bits of rows, known ones and solid ones, shape (x, y, words, 2).

    Rows go on for ``reach`` voxels, and by a word in which nothing is known.
    """
    nx, ny, n = codes.shape
    words = (n + reach + 63) // 64 + 1
    result = np.zeros((nx, ny, words, 2), np.uint64)
    more = np.arange(n, n + reach) % n
    for a in range(0, nx, size):
        part = codes[a : a + size]
        wide = np.full((len(part), ny, 64 * words), UNKNOWN, np.uint8)
        wide[..., :n] = part
        if wraps:
            wide[..., n : n + reach] = part[..., more]
        for place, bits in enumerate((wide != UNKNOWN, wide == SOLID)):
            packed = np.packbits(bits, axis=-1, bitorder="little").view("<u8")
            result[a : a + size, :, :, place] = packed
    return source(result, np.uint64)


@kernel
def _changes(words, n, steps, wraps, first, last, counts):
    nx, ny = words.shape[:2]
    full = ~np.uint64(0)
    used = (n + 63) // 64
    end = full >> np.uint64(64 * used - n)
    for m in range(len(steps)):
        low = np.uint64(steps[m, 2])
        # A shift by all of a word has no meaning: the step's other part is shifted in two.
        high = np.uint64(63) - low
        differ, known = np.uint64(0), np.uint64(0)
        for i in range(first, last):
            p = i + steps[m, 0]
            if not 0 <= p < nx:
                if not wraps[0]:
                    continue
                p %= nx
            for j in range(ny):
                q = j + steps[m, 1]
                if not 0 <= q < ny:
                    if not wraps[1]:
                        continue
                    q %= ny
                here, there = words[i, j], words[p, q]
                for w in range(used):
                    after = (there[w + 1, 0] << high) << np.uint64(1)
                    both = here[w, 0] & ((there[w, 0] >> low) | after)
                    if w + 1 == used:
                        both &= end
                    after = (there[w + 1, 1] << high) << np.uint64(1)
                    other = here[w, 1] ^ ((there[w, 1] >> low) | after)
                    known += popcount(both)
                    differ += popcount(both & other)
        counts[m, 0] += np.int64(differ)
        counts[m, 1] += np.int64(known)
