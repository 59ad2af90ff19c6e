"""Sets of digits on lattices: rows of bits, one table per level, joined by AND."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

SLAB = 1 << 22
"""Voxels of one call, about: a few milliseconds."""


@kernel
def _descend(out, x0, x1, xd, yd, which, tables, prefix, known, fresh):
    # prefix[l] is the AND of the row's tables of levels < l; known[l] tells whether any of it is
    # set. From one row to the next only the levels from the first changed digit on are done anew.
    levels, nz = tables.shape[0], prefix.shape[1]
    for x in range(x0, x1):
        valid = 0
        for y in range(yd.shape[0]):
            row = out[x, y]
            if xd[x, 0] < 0 or yd[y, 0] < 0:
                valid = 0
                if fresh:
                    for z in range(nz):
                        row[z] = 0
                continue
            same = 0
            while same < valid and yd[y, same] == yd[y - 1, same]:
                same += 1
            some = known[same]
            for level in range(same, levels):
                table = which[xd[x, level], yd[y, level]]
                some = known[level] and table >= 0
                known[level + 1] = some
                if some and level < levels - 1:
                    above, below, bits = prefix[level], prefix[level + 1], tables[level, table]
                    for z in range(nz):
                        below[z] = above[z] & bits[z]
            valid = levels
            if not some:
                if fresh:
                    for z in range(nz):
                        row[z] = 0
                continue
            if levels == 0:
                last, bits = prefix[0], prefix[0]
            else:
                last = prefix[levels - 1]
                bits = tables[levels - 1, which[xd[x, levels - 1], yd[y, levels - 1]]]
            if fresh:
                for z in range(nz):
                    row[z] = last[z] & bits[z]
            else:
                for z in range(nz):
                    row[z] |= last[z] & bits[z]


def join_rows(
    out: NDArray[Any],
    xd: NDArray[np.int32],
    yd: NDArray[np.int32],
    which: NDArray[np.int32],
    tables: NDArray[Any],
    inside: NDArray[Any],
    *,
    fresh: bool,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write or join the rows of a digit set into ``out``, on all threads.

    Parameters
    ----------
    out
        uint8 or uint64, shape (nx, ny, nz); every element is written where ``fresh``.
    xd, yd
        int32, shapes (nx, max(L, 1)) and (ny, max(L, 1)): numbers of the digits from the coarsest
        level down; −1 outside the body.
    which
        int32, shape (numbers along x, along y): the table of each pair, −1 for none.
    tables
        Type of ``out``, shape (L, U, nz): the bits of each voxel that a level's table keeps.
    inside
        Type of ``out``, shape (nz,): the bits of each voxel that lie inside the body.
    fresh
        Whether ``out`` is written rather than joined by OR.
    progress
        Called with planes done and planes in all; raising in it cancels.
    """
    xd, yd = source(xd, np.int32), source(yd, np.int32)
    which, tables = source(which, np.int32), source(tables, out.dtype)
    levels, nz = tables.shape[0], out.shape[2]

    def work(start, stop):
        prefix = np.empty((levels + 1, nz), out.dtype)
        prefix[0] = inside
        known = np.ones(levels + 1, np.bool_)
        _descend(out, start, stop, xd, yd, which, tables, prefix, known, fresh)

    if out.size <= SLAB and progress is None:
        work(0, len(out))
    else:
        slabs(len(out), max(1, SLAB // (out.shape[1] * nz)), work, progress)
