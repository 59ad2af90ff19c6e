"""Connected components of a binary grid, by runs along z.

A run is a maximal row of set voxels. Runs of neighbouring rows that touch are joined in a forest
whose roots are the smallest indices, so labels come in raster order of a component's first voxel,
whatever the number of slabs and threads.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Axes = tuple[bool, bool, bool]
    Progress = Callable[[int, int], None]

SLAB = 1 << 22
"""Voxels that one kernel call looks at, about."""


class Runs(NamedTuple):
    """The set voxels of a grid as labelled runs along z, in raster order.

    Run r covers voxels ``starts[r]`` … ``stops[r]`` (not within) of row ``i · ny + j``; the runs of
    a row are ``offsets[row]`` … ``offsets[row + 1]``. ``labels`` count from 0 to ``total`` − 1.
    """

    offsets: NDArray[np.int64]
    starts: NDArray[np.int32]
    stops: NDArray[np.int32]
    labels: NDArray[np.int32]
    total: int

    @property
    def sizes(self) -> NDArray[np.int64]:
        """Number of voxels of each component, int64, shape (total,)."""
        lengths = (self.stops - self.starts).astype(np.int64)
        return np.bincount(self.labels, lengths, self.total).astype(np.int64)

    @property
    def rows(self) -> NDArray[np.int64]:
        """Row of each run, int64."""
        return np.repeat(np.arange(len(self.offsets) - 1), np.diff(self.offsets))


def label_runs(
    mask: NDArray[np.bool_],
    connectivity: int,
    *,
    periodic: Axes = (False, False, False),
    progress: Progress | None = None,
) -> Runs:
    """Find the connected components of a mask.

    Parameters
    ----------
    mask
        bool, shape (x, y, z): the phase to label is True.
    connectivity
        6: voxels are joined by faces; 26: by faces, edges and corners.
    periodic
        Axes along which the grid closes on itself.
    progress
        Called as ``progress(done, count)`` in planes along x.

    Returns
    -------
    Runs

    Raises
    ------
    ValueError
        For another connectivity.
    """
    if connectivity not in (6, 26):
        raise ValueError(f"connectivity: got {connectivity!r}; wanted 6 or 26")
    wide = int(connectivity == 26)
    given = source(mask, np.bool_).view(np.uint8)
    planes = max(1, SLAB // (mask.shape[1] * mask.shape[2]))
    offsets, starts, stops = _runs_of(given, planes)
    parent = np.arange(len(starts), dtype=np.int32)
    wraps = np.array(periodic, np.int64)

    def link(a, b, *, seam):
        _link(offsets, starts, stops, given.shape, wraps, wide, a, b, seam, parent)

    slabs(mask.shape[0], planes, lambda a, b: link(a, b, seam=False), progress)
    for seam in range(0 if periodic[0] else planes, mask.shape[0], planes):
        link(seam, seam + 1, seam=True)
    return Runs(offsets, starts, stops, parent, int(_settle(parent)))


def label(
    mask: NDArray[np.bool_], connectivity: int, *, periodic: Axes = (False, False, False)
) -> tuple[NDArray[np.int32], int]:
    """Label the connected components of a mask.

    Parameters
    ----------
    mask, connectivity, periodic
        As in ``label_runs``.

    Returns
    -------
    labels
        int32, shape (x, y, z): 0 outside the mask, 1 … count in raster order of each component's
        first voxel.
    count
        Number of components.
    """
    runs = label_runs(mask, connectivity, periodic=periodic)
    labels = np.zeros(mask.shape, np.int32)
    rows = labels.reshape(-1, mask.shape[2])
    per_call = max(1, SLAB // mask.shape[2])
    slabs(
        len(rows),
        per_call,
        lambda a, b: _paint(runs.offsets, runs.starts, runs.stops, runs.labels, a, b, rows),
    )
    return labels, runs.total


def _runs_of(given, planes):
    rows = given.shape[0] * given.shape[1]
    offsets = np.zeros(rows + 1, np.int64)
    none = np.empty(0, np.int32)
    slabs(given.shape[0], planes, lambda a, b: _scan(given, a, b, offsets, none, none))
    np.cumsum(offsets, out=offsets)
    starts, stops = (np.empty(offsets[-1], np.int32) for _ in range(2))
    if len(starts):
        slabs(given.shape[0], planes, lambda a, b: _scan(given, a, b, offsets, starts, stops))
    return offsets, starts, stops


@kernel
def _scan(mask, first, last, offsets, starts, stops):
    """Count the runs of each row, into the place after it, or write them where there is room."""
    _, ny, nz = mask.shape
    write = len(starts) > 0
    for i in range(first, last):
        for j in range(ny):
            row = mask[i, j]
            run = offsets[i * ny + j] if write else 0
            before = 0
            for k in range(nz):
                now = row[k]
                if now != before:
                    if now:
                        if write:
                            starts[run] = k
                    else:
                        if write:
                            stops[run] = k
                        run += 1
                    before = now
            if before:
                if write:
                    stops[run] = nz
                run += 1
            if not write:
                offsets[i * ny + j + 1] = run


@kernel
def _join(parent, a, b):
    """Join two runs' components; the smaller root stays root, paths are halved on the way."""
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    while parent[b] != b:
        parent[b] = parent[parent[b]]
        b = parent[b]
    if a < b:
        parent[b] = a
    else:
        parent[a] = b


@kernel
def _meet(offsets, starts, stops, a, b, nz, wraps, wide, parent):
    """Join the touching runs of rows a and b; ``wide`` lets them touch at a corner."""
    p, p_end = offsets[a], offsets[a + 1]
    q, q_end = offsets[b], offsets[b + 1]
    if p == p_end or q == q_end:
        return
    if wraps and wide:
        if starts[p] == 0 and stops[q_end - 1] == nz:
            _join(parent, p, q_end - 1)
        if starts[q] == 0 and stops[p_end - 1] == nz:
            _join(parent, q, p_end - 1)
    while p < p_end and q < q_end:
        if starts[p] < stops[q] + wide and starts[q] < stops[p] + wide:
            _join(parent, p, q)
        if stops[p] < stops[q]:
            p += 1
        else:
            q += 1


@kernel
def _link(offsets, starts, stops, shape, wraps, wide, first, last, seam, parent):
    """Join the runs of planes ``first`` … ``last`` (not within) with those before them.

    Plane ``first`` is joined with the one before it only where ``seam`` is true, and then that is
    all that is done.
    """
    nx, ny, nz = shape
    for i in range(first, last):
        for j in range(ny):
            row = i * ny + j
            if not seam:
                if wraps[2] and offsets[row] < offsets[row + 1]:
                    p, q = offsets[row], offsets[row + 1] - 1
                    if starts[p] == 0 and stops[q] == nz:
                        _join(parent, p, q)
                if j > 0 or wraps[1]:
                    other = i * ny + (j - 1) % ny
                    _meet(offsets, starts, stops, row, other, nz, wraps[2], wide, parent)
            if seam or i > first:
                plane = (i - 1) % nx * ny
                for step in range(-wide, wide + 1):
                    if 0 <= j + step < ny or wraps[1]:
                        other = plane + (j + step) % ny
                        _meet(offsets, starts, stops, row, other, nz, wraps[2], wide, parent)


@kernel
def _settle(parent):
    """Replace each run's parent by its component's number; return how many there are."""
    count = 0
    for run in range(len(parent)):
        if parent[run] == run:
            parent[run] = count
            count += 1
        else:
            parent[run] = parent[parent[run]]
    return count


@kernel
def _paint(offsets, starts, stops, labels, first, last, rows):
    for row in range(first, last):
        for run in range(offsets[row], offsets[row + 1]):
            for k in range(starts[run], stops[run]):
                rows[row, k] = labels[run] + 1
