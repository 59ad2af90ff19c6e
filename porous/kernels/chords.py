"""Chords of a phase along lines of voxels, counted by their length."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Bytes = NDArray[np.uint8]
    Ints = NDArray[np.int64]

OTHER, INSIDE, UNKNOWN = range(3)
"""What a voxel is: of the other phase, of the phase, or where nobody looks."""

SLAB = 1 << 22
"""Voxels that one kernel call looks at, about."""


class Runs(NamedTuple):
    """How many chords there are of each length in voxels, int64 (n + 1,).

    None, one or both of their ends are cut; on ``endless`` lines the phase goes all round.
    """

    whole: Ints
    halves: Ints
    pieces: Ints
    endless: int


def runs_along(codes: Bytes, *, wraps: bool, beyond: int) -> Runs:
    """Count the runs of ``INSIDE`` along the last axis.

    Parameters
    ----------
    codes
        uint8, shape (..., n): OTHER, INSIDE or UNKNOWN. Runs that UNKNOWN follows on are cut.
    wraps
        Whether lines close on themselves.
    beyond
        What follows on lines that do not, OTHER or UNKNOWN.
    """
    n = codes.shape[-1]
    given = source(codes.reshape(-1, n), np.uint8)
    size = max(1, SLAB // n)
    counts = np.zeros((-(-len(given) // size), 3, n + 1), np.int64)
    endless = np.zeros(len(counts), np.int64)

    def work(a: int, b: int) -> None:
        endless[a // size] = _runs(given[a:b], int(wraps), beyond, counts[a // size])

    slabs(len(given), size, work)
    whole, halves, pieces = counts.sum(axis=0)
    return Runs(whole, halves, pieces, int(endless.sum()))


@kernel
def _runs(codes, wraps, beyond, counts):
    n = codes.shape[1]
    endless = 0
    for line in codes:
        start, before = 0, beyond
        if wraps:
            while start < n and line[start] == 1:
                start += 1
            if start == n:
                endless += 1
                continue
            before = np.int64(line[start])
        length = 0
        for step in range(n + 1):
            if step == n:
                code = np.int64(line[start]) if wraps else beyond
            else:
                place = start + step
                code = np.int64(line[place - n if place >= n else place])
            if code == 1:
                length += 1
                continue
            if length:
                counts[(before == 2) + (code == 2), length] += 1
                length = 0
            before = code
    return endless
