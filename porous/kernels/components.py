"""Connected components of a binary grid, by runs along z.

A run is a maximal row of set voxels. Runs of neighbouring rows that touch are joined in a forest
whose roots are the smallest indices, so labels come in raster order of a component's first voxel,
whatever the number of slabs and threads.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, popcount, slabs, source, words_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Axes = tuple[bool, bool, bool]
    Index = tuple[int, int, int]
    Progress = Callable[[int, int], None]

SLAB = 1 << 22
"""Voxels that one kernel call looks at, about."""

LARGEST = (1 << 31) - 1
"""Runs of a mask at most: their numbers are int32."""


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
        For another connectivity, or a mask with more runs than an int32 can number.
    """
    if connectivity not in (6, 26):
        raise ValueError(f"connectivity: got {connectivity!r}; wanted 6 or 26")

    def choose(first: int, last: int) -> NDArray[np.bool_]:
        return mask[first:last]

    shape = mask.shape
    runs = label_chosen(choose, shape, periodic=periodic, progress=progress)
    if connectivity == 6:
        return runs
    numbers, total = widened(runs, shape, periodic=periodic)
    return runs._replace(labels=numbers[runs.labels], total=total)


def label_chosen(
    choose: Callable[[int, int], NDArray[np.bool_]],
    shape: Index,
    *,
    periodic: Axes = (False, False, False),
    progress: Progress | None = None,
) -> Runs:
    """Find what faces join of a phase that is told of some planes at a time.

    Parameters
    ----------
    choose
        ``choose(first, last)`` returns the mask of these planes along x; called on all threads.
    shape
        Numbers of voxels.
    periodic, progress
        As in ``label_runs``.

    Raises
    ------
    ValueError
        For a mask with more runs than an int32 can number.
    """
    planes = max(1, SLAB // (shape[1] * shape[2]))
    offsets, starts, stops = _runs_of(choose, shape, planes)
    parent = np.arange(len(starts), dtype=np.int32)
    wraps = np.array(periodic, np.int64)

    def link(a: int, b: int, *, seam: bool) -> None:
        _link(offsets, starts, stops, shape, wraps, a, b, seam, parent)

    slabs(shape[0], planes, lambda a, b: link(a, b, seam=False), progress)
    for seam in range(0 if periodic[0] else planes, shape[0], planes):
        link(seam, seam + 1, seam=True)
    return Runs(offsets, starts, stops, parent, int(_settle(parent)))


def widened(
    runs: Runs, shape: Index, *, periodic: Axes = (False, False, False)
) -> tuple[NDArray[np.int32], int]:
    """Join components of faces where edges and corners join them too.

    Returns
    -------
    numbers
        int32, shape (runs.total,): the component, in raster order, that each is of.
    total
        How many these are.
    """
    parent = np.arange(runs.total, dtype=np.int32)
    wraps = np.array(periodic, np.int64)
    planes = max(1, SLAB // (shape[1] * shape[2]))
    for first in range(0, shape[0] if runs.total > 1 else 0, planes):
        _widen(*runs[:4], shape, wraps, first, min(first + planes, shape[0]), parent)
    return parent, int(_settle(parent))


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
    out, rows = labels.reshape(-1, mask.shape[2]), np.arange(mask.shape[0] * mask.shape[1])
    slabs(
        len(rows),
        max(1, SLAB // mask.shape[2]),
        lambda a, b: _paint(*runs[:4], rows[a:b], 0, out[a:b]),
    )
    return labels, runs.total


def layer_labels(runs: Runs, shape: Index, axis: int, layer: int) -> NDArray[np.int32]:
    """Return the labels of one layer of voxels across an axis.

    Parameters
    ----------
    runs
        What ``label_runs`` found in a mask of this ``shape``.
    axis, layer
        Which layer.

    Returns
    -------
    int32, shape without ``axis``: 0 outside the mask, else 1 + the component's number.
    """
    rows = np.arange(shape[0] * shape[1]).reshape(shape[:2])
    if axis < 2:
        chosen = np.ascontiguousarray(rows.take(layer, axis=axis))
        out = np.zeros((len(chosen), shape[2]), np.int32)
        _paint(*runs[:4], chosen, 0, out)
        return out
    out = np.zeros((rows.size, 1), np.int32)
    _paint(*runs[:4], rows.ravel(), layer, out)
    return out.reshape(rows.shape)


def sizes_from(runs: Runs, shape: Index, first: Index) -> NDArray[np.int64]:
    """Return how many voxels each component has at ``first`` or beyond, along every axis.

    Returns
    -------
    int64, shape (runs.total,).
    """
    result = np.zeros(runs.total, np.int64)
    _weigh(*runs[:4], np.array(shape, np.int64), np.array(first, np.int64), result)
    return result


def touching(runs: Runs, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return whether each component has a voxel in ``mask``, bool, shape (runs.total,)."""
    found = np.zeros(runs.total, np.uint8)
    rows = source(mask, np.bool_).view(np.uint8).reshape(-1, mask.shape[2])
    _touch(*runs[:4], rows, found)
    return found.view(np.bool_)


class United(NamedTuple):
    """Components that were found to be one: their number, and each one's place in that one.

    ``sizes`` and ``marks`` are of the whole: added up and joined bit by bit.
    """

    numbers: NDArray[np.int64]
    places: NDArray[np.int64]
    sizes: NDArray[np.int64]
    marks: NDArray[np.int64]


def unite(
    voxels: NDArray[np.int64],
    owners: NDArray[np.int32],
    turns: NDArray[np.int32],
    sizes: NDArray[np.int64],
    marks: NDArray[np.int64],
    *,
    around: int,
) -> United:
    """Join components of several blocks that were seen to own the same voxels.

    Parameters
    ----------
    voxels
        int64, shape (m,), ascending: voxels of the grid that were seen.
    owners, turns
        int32, shapes (m,) and (m, 3): whose voxel it was, and how many periods off the grid, per
        axis, that one's block saw it; (0, 3) where none saw any off it.
    sizes, marks
        int64, shape (n,): of each component.
    around
        The mark of winding around the first axis, and twice and four times that around the
        others. Where a walk from block to block leads back to a component some periods off, it
        winds around.

    Returns
    -------
    United
        Numbered by each one's first part. A part lies ``places`` periods off that one.
    """
    parent = np.arange(len(sizes))
    places = np.zeros((len(sizes), 3), np.int64)
    sizes, marks = sizes.copy(), marks.copy()
    moved = int(len(turns) > 0)
    at = turns if moved else np.zeros((1, 3), np.int32)
    _unite(voxels, owners, at, moved, parent, places, sizes, marks, around)
    numbers = np.empty(len(sizes), np.int64)
    _number(parent, places, numbers)
    first = parent == np.arange(len(sizes))
    return United(numbers, places, sizes[first], marks[first])


def _runs_of(choose, shape, planes):
    nx, ny, nz = shape
    bits = np.empty((nx, ny, -(-nz // 64)), np.uint64)
    offsets = np.zeros(nx * ny + 1, np.int64)
    none = np.empty(0, np.int32)

    def count(first, last):
        room = np.zeros((last - first, ny, 64 * bits.shape[2]), np.bool_)
        room[:, :, :nz] = choose(first, last)
        bits[first:last] = words_of(room)
        _scan(bits, nz, first, last, offsets, none, none)

    slabs(nx, planes, count)
    np.cumsum(offsets, out=offsets)
    if offsets[-1] > LARGEST:
        raise ValueError(f"mask: got {offsets[-1]} runs; wanted {LARGEST} at most: smaller tiles")
    starts, stops = (np.empty(offsets[-1], np.int32) for _ in range(2))
    if len(starts):
        slabs(nx, planes, lambda a, b: _scan(bits, nz, a, b, offsets, starts, stops))
    return offsets, starts, stops


@kernel
def _scan(bits, length, first, last, offsets, starts, stops):
    """Count the runs of each row, into the place after it, or write them where there is room."""
    one = np.uint64(1)
    ny, words = bits.shape[1], bits.shape[2]
    write = len(starts) > 0
    for i in range(first, last):
        for j in range(ny):
            row = i * ny + j
            run = offsets[row] if write else 0
            before = np.uint64(0)
            for w in range(words):
                word = bits[i, j, w]
                changes = word ^ (word << one | before)
                before = word >> np.uint64(63)
                if not write:
                    run += np.int64(popcount(changes & word))
                    continue
                while changes:
                    lowest = changes & (~changes + one)
                    changes ^= lowest
                    place = 64 * w + np.int64(popcount(lowest - one))
                    if word & lowest:
                        starts[run] = place
                    else:
                        stops[run] = place
                        run += 1
            if write and before:
                stops[run] = length
            if not write:
                offsets[row + 1] = run


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
def _meet(offsets, starts, stops, a, b, parent):
    """Join the runs of rows a and b that share a face."""
    p, p_end = offsets[a], offsets[a + 1]
    q, q_end = offsets[b], offsets[b + 1]
    while p < p_end and q < q_end:
        if starts[p] < stops[q] and starts[q] < stops[p]:
            _join(parent, p, q)
        if stops[p] < stops[q]:
            p += 1
        else:
            q += 1


@kernel
def _link(offsets, starts, stops, shape, wraps, first, last, seam, parent):
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
                    _meet(offsets, starts, stops, row, i * ny + (j - 1) % ny, parent)
            if seam or i > first:
                _meet(offsets, starts, stops, row, (i - 1) % nx * ny + j, parent)


@kernel
def _near(offsets, starts, stops, labels, a, b, nz, wraps, parent):
    """Join the components of runs of rows a and b that touch, if in a corner only."""
    p, p_end = offsets[a], offsets[a + 1]
    q, q_end = offsets[b], offsets[b + 1]
    if p == p_end or q == q_end:
        return
    if wraps:
        if starts[p] == 0 and stops[q_end - 1] == nz:
            _join(parent, labels[p], labels[q_end - 1])
        if starts[q] == 0 and stops[p_end - 1] == nz:
            _join(parent, labels[q], labels[p_end - 1])
    while p < p_end and q < q_end:
        if starts[p] <= stops[q] and starts[q] <= stops[p] and labels[p] != labels[q]:
            _join(parent, labels[p], labels[q])
        if stops[p] < stops[q]:
            p += 1
        else:
            q += 1


@kernel
def _widen(offsets, starts, stops, labels, shape, wraps, first, last, parent):
    """Join components about the rows of planes ``first`` … ``last`` (not within)."""
    nx, ny, nz = shape
    for i in range(first, last):
        for j in range(ny):
            row = i * ny + j
            if j > 0 or wraps[1]:
                other = i * ny + (j - 1) % ny
                _near(offsets, starts, stops, labels, row, other, nz, wraps[2], parent)
            if i > 0 or wraps[0]:
                plane = (i - 1) % nx * ny
                for step in range(-1, 2):
                    if 0 <= j + step < ny or wraps[1]:
                        other = plane + (j + step) % ny
                        _near(offsets, starts, stops, labels, row, other, nz, wraps[2], parent)


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
def _paint(offsets, starts, stops, labels, rows, first, out):
    """Write the labels of rows, from voxel ``first`` on, as many as ``out`` is wide."""
    for r in range(len(rows)):
        for run in range(offsets[rows[r]], offsets[rows[r] + 1]):
            if starts[run] - first >= out.shape[1]:
                break
            for k in range(max(starts[run] - first, 0), min(stops[run] - first, out.shape[1])):
                out[r, k] = labels[run] + 1


@kernel
def _weigh(offsets, starts, stops, labels, shape, first, sizes):
    for i in range(first[0], shape[0]):
        for j in range(first[1], shape[1]):
            row = i * shape[1] + j
            for run in range(offsets[row], offsets[row + 1]):
                sizes[labels[run]] += max(0, stops[run] - max(starts[run], first[2]))


@kernel
def _touch(offsets, starts, stops, labels, rows, found):
    for row in range(len(rows)):
        for run in range(offsets[row], offsets[row + 1]):
            for k in range(starts[run], stops[run]):
                found[labels[run]] |= rows[row, k]


@kernel
def _unite(voxels, owners, turns, moved, parent, places, sizes, marks, around):
    """Join the owners of equal voxels in a forest; places are from the parent, roots are first."""
    for s in range(1, len(voxels)):
        if voxels[s] != voxels[s - 1]:
            continue
        a, b = np.int64(owners[s - 1]), np.int64(owners[s])
        p, q = (s - 1) * moved, s * moved
        x = np.int64(turns[p, 0]) - turns[q, 0]
        y = np.int64(turns[p, 1]) - turns[q, 1]
        z = np.int64(turns[p, 2]) - turns[q, 2]
        while parent[a] != a:
            places[a] += places[parent[a]]
            parent[a] = parent[parent[a]]
            x, y, z = x + places[a, 0], y + places[a, 1], z + places[a, 2]
            a = parent[a]
        while parent[b] != b:
            places[b] += places[parent[b]]
            parent[b] = parent[parent[b]]
            x, y, z = x - places[b, 0], y - places[b, 1], z - places[b, 2]
            b = parent[b]
        if a == b:
            marks[a] |= around * ((x != 0) + 2 * (y != 0) + 4 * (z != 0))
            continue
        if b < a:
            a, b, x, y, z = b, a, -x, -y, -z
        parent[b] = a
        places[b, 0], places[b, 1], places[b, 2] = x, y, z
        sizes[a] += sizes[b]
        marks[a] |= marks[b]


@kernel
def _number(parent, places, numbers):
    """Number the roots and give their number to all below; places become those from the root."""
    count = 0
    for one in range(len(parent)):
        above = parent[one]
        if above == one:
            numbers[one] = count
            count += 1
        else:  # what is above comes before and is done
            numbers[one] = numbers[above]
            places[one] += places[above]
