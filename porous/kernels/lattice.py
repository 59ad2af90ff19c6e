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
def _descend(out, x0, x1, xd, yd, which, tables, inside, prefix, known, fresh):
    # prefix[l] is the AND of the line's tables of levels < l; known[l] tells whether any of it is
    # set. From one y to the next only the levels from the first changed digit on are done anew.
    # All lines of a plane follow each other while the plane is in the cache.
    lines, levels, nz = tables.shape[0], tables.shape[1], prefix.shape[1]
    for x in range(x0, x1):
        for line in range(lines):
            valid = 0
            prefix[0, :] = inside[line]
            for y in range(yd.shape[0]):
                row = out[x, y]
                if xd[x, line, 0] < 0 or yd[y, line, 0] < 0:
                    valid = 0
                    if fresh:
                        row[:] = 0
                    continue
                same = 0
                while same < valid and yd[y, line, same] == yd[y - 1, line, same]:
                    same += 1
                for level in range(same, levels):
                    table = which[xd[x, line, level], yd[y, line, level]]
                    known[level + 1] = known[level] and table >= 0
                    if known[level + 1] and level < levels - 1:
                        above, below, bits = (
                            prefix[level],
                            prefix[level + 1],
                            tables[line, level, table],
                        )
                        for z in range(nz):
                            below[z] = above[z] & bits[z]
                valid = levels
                if not known[levels]:
                    if fresh:
                        row[:] = 0
                    continue
                last = bits = prefix[0]
                if levels > 0:
                    last = prefix[levels - 1]
                    table = which[xd[x, line, levels - 1], yd[y, line, levels - 1]]
                    bits = tables[line, levels - 1, table]
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
    """Write or join the lines of a digit set into ``out``, on all threads where it is large.

    Parameters
    ----------
    out
        uint8 or uint64, shape (nx, ny, nz); every element is written where ``fresh``.
    xd, yd
        int32, shapes (nx, R, max(L, 1)) and (ny, R, max(L, 1)): numbers of the digits of R lines
        per voxel from the coarsest level down; −1 outside the body.
    which
        int32, shape (numbers along x, along y): the table of each pair, −1 for none.
    tables
        Type of ``out``, shape (R, L, U, nz): the bits of each voxel that a level's table keeps.
    inside
        Type of ``out``, shape (R, nz): the bits of each voxel that lie inside the body.
    fresh
        Whether ``out`` is written, by one line, rather than joined by OR.
    progress
        Called with planes done and planes in all; raising in it cancels.
    """
    xd, yd = source(xd, np.int32), source(yd, np.int32)
    which, tables = source(which, np.int32), source(tables, out.dtype)
    inside = source(inside, out.dtype)
    levels, nz = tables.shape[1], out.shape[2]

    def work(start: int, stop: int) -> None:
        prefix = np.empty((levels + 1, nz), out.dtype)
        known = np.ones(levels + 1, np.bool_)
        _descend(out, start, stop, xd, yd, which, tables, inside, prefix, known, fresh)

    size = max(1, SLAB // (out.shape[1] * nz * len(tables)))
    if progress is None and out.size * len(tables) <= SLAB:
        work(0, len(out))
    else:
        slabs(len(out), size, work, progress)
