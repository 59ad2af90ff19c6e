"""Balls about the cells of a net: which samples they hold, block by block of voxels.

Of a block's candidates only those go on to its parts that may be the nearest to some sample there
and that may reach one; where one holds all, or none reaches any, the block is done. Places are
lengths from the lattice's origin that depend on the indices of cells and samples alone, so that a
sample's distances are the same numbers whichever tile, block and candidates they are asked with.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.values import Pattern

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

CLOSED = 1e-6
"""Balls are closed: their radii are larger by this part of a voxel's shortest edge."""

BUDGET = 100_000_000
"""Distances of one call: about a tenth of a second."""

ROUNDING = 1e-9
"""What bounds on distances may err by, in a voxel's shortest edge."""

FEW = 12
"""Candidates that all samples of a voxel are held against at once."""

SLICE = 64
"""Candidates between two looks whether a sample is held."""

ROOM = 1 << 18
"""Candidates that there is room for at first."""

ENOUGH = 4
"""Room for each candidate where there are more; it grows as there is need."""

DEPTH = 200
"""Blocks that wait at a time: seven for each of the cuts, of which there are not as many as 28."""

HELD = 1
"""Mark of a cell that belongs to a net, …"""

WANTED = 3
"""… and may be the nearest to a sample that is undecided."""


class Samples(NamedTuple):
    """Sample points of a voxel by the part of it that they lie in.

    ``places`` (p, 3) and their ``bits`` (p,) are cut into parts by ``first`` (g + 1,), whose boxes
    have the corners ``lows`` and ``highs`` (g, 3). The last row is that of the whole voxel.
    """

    places: Floats
    bits: NDArray[np.uint64]
    first: Indices
    lows: Floats
    highs: Floats

    @classmethod
    def of(cls, pattern: Pattern) -> Samples:
        """Return the points of a pattern by the eighth of the voxel that they lie in."""
        depths = pattern.depths
        rows = np.repeat(pattern.rows, depths.shape[1], axis=0)
        places = np.column_stack([rows, depths.ravel()])
        part = (places >= 0.5) @ np.array([4, 2, 1])
        order = np.argsort(part, kind="stable")
        first = np.flatnonzero(np.diff(part[order], prepend=-1))
        places = places[order]
        lows, highs = np.minimum.reduceat(places, first), np.maximum.reduceat(places, first)
        return cls(
            source(places, np.float64),
            source(np.uint64(1) << order.astype(np.uint64), np.uint64),
            source(np.append(first, len(order)), np.int64),
            source(np.vstack([lows, lows.min(axis=0)]), np.float64),
            source(np.vstack([highs, highs.max(axis=0)]), np.float64),
        )


@kernel
def _runs(marks, coarse, split, merge, start, cell, runs, cells):
    # Runs of marked cells along z, or each cell alone, where a coarser net is; their number. They
    # are written down if there is room: x, y and both ends, and the first cell.
    count, room = 0, runs.shape[1]
    n1, n2 = marks.shape[1], marks.shape[2]
    for i in range(marks.shape[0]):
        x = (start[0] + i + 0.5) * cell[0]
        p = i // split
        for j in range(n1):
            y = (start[1] + j + 0.5) * cell[1]
            q = j // split
            last = -2
            for r in range(coarse.shape[2]):
                if coarse[p, q, r] == 0:
                    continue
                for k in range(r * split, min((r + 1) * split, n2)):
                    if marks[i, j, k] != HELD:
                        continue
                    z = (start[2] + k + 0.5) * cell[2]
                    if not merge or last < k - 1:
                        if count < room:
                            runs[0, count], runs[1, count], runs[2, count] = x, y, z
                            cells[count] = (i * n1 + j) * n2 + k
                        count += 1
                    if count <= room:
                        runs[3, count - 1] = z
                    last = k
    return count


@kernel
def _sift(runs, cells, first, last, box, bound, work):
    # Write those of the candidates that matter to a box of samples, middle and half edges, behind
    # the last. Whether one holds all of the box, and where those that were written end. Positive
    # numbers rise with their bits, and only the least of integers is sought many at a time.
    x, y, z, e, f, g = box
    less, more, radius = bound
    near, far, order = work
    many = last - first
    xs, ys = runs[0, first:last], runs[1, first:last]
    lows, highs = runs[2, first:last], runs[3, first:last]
    for c in range(many):
        p = abs(xs[c] - x)
        q = abs(ys[c] - y)
        a, b = lows[c] - z, z - highs[c]
        r = a if a > b else b
        u, v, w = p - e, q - f, r - g
        u = u if u > 0.0 else 0.0
        v = v if v > 0.0 else 0.0
        w = w if w > 0.0 else 0.0
        near[c] = u * u + v * v + w * w
        r += g
        r = r if r > 0.0 else 0.0
        far[c] = (p + e) * (p + e) + (q + f) * (q + f) + r * r
    least = np.int64(0x7FF0000000000000)
    for c in range(many):
        least = order[c] if order[c] < least else least
    at, best = last, last
    reach = np.inf
    for c in range(many):
        if order[c] == least:
            reach = np.sqrt(far[c]) + less
            break
    if reach <= radius:
        return True, last
    limit = (min(reach, radius) + more) ** 2
    for c in range(many):
        if near[c] <= limit:
            runs[0, at], runs[1, at] = xs[c], ys[c]
            runs[2, at], runs[3, at] = lows[c], highs[c]
            cells[at] = cells[first + c]
            if order[c] == least:
                best = at
            at += 1
    if at > last:  # the nearest comes first
        for a in range(4):
            runs[a, last], runs[a, best] = runs[a, best], runs[a, last]
        cells[last], cells[best] = cells[best], cells[last]
    return False, at


@kernel
def _held(runs, first, last, x, y, z, squared):
    # Whether a sample is within the radius of a candidate.
    while first < last:
        stop = min(first + SLICE, last)
        xs, ys = runs[0, first:stop], runs[1, first:stop]
        lows, highs = runs[2, first:stop], runs[3, first:stop]
        found = 0
        for c in range(stop - first):
            p, q = xs[c] - x, ys[c] - y
            a, b = lows[c] - z, z - highs[c]
            r = a if a > b else b
            r = r if r > 0.0 else 0.0
            found += p * p + q * q + r * r <= squared
        if found:
            return True
        first = stop
    return False


@kernel
def _bits(runs, first, last, samples, part, voxel, spacing, squared):
    # The samples of a part of a voxel that candidates hold.
    places, bits, firsts = samples[0], samples[1], samples[2]
    result = np.uint64(0)
    for s in range(firsts[part], firsts[part + 1]):
        x = (voxel[0] + places[s, 0]) * spacing[0]
        y = (voxel[1] + places[s, 1]) * spacing[1]
        z = (voxel[2] + places[s, 2]) * spacing[2]
        if _held(runs, first, last, x, y, z, squared):
            result |= bits[s]
    return result


@kernel
def _box(low, high, samples, part, spacing):
    # Middle and half edges of the box of the samples of voxels, both given, or of a part of each.
    lows, highs = samples[3], samples[4]
    x0, x1 = (low[0] + lows[part, 0]) * spacing[0], (high[0] + highs[part, 0]) * spacing[0]
    y0, y1 = (low[1] + lows[part, 1]) * spacing[1], (high[1] + highs[part, 1]) * spacing[1]
    z0, z1 = (low[2] + lows[part, 2]) * spacing[2], (high[2] + highs[part, 2]) * spacing[2]
    return (
        0.5 * (x0 + x1),
        0.5 * (y0 + y1),
        0.5 * (z0 + z1),
        0.5 * (x1 - x0),
        0.5 * (y1 - y0),
        0.5 * (z1 - z0),
    )


@kernel
def _voxel(runs, cells, first, last, samples, voxel, spacing, bound, work):
    # The samples of a voxel that its candidates hold, and how many distances that took.
    squared = bound[2] * bound[2]
    parts = len(samples[2]) - 1
    result, steps = np.uint64(0), 0
    for part in range(parts):
        begin, end = first, last
        if last - first > FEW and parts > 1:
            box = _box(voxel, voxel, samples, part, spacing)
            steps += last - first
            whole, end = _sift(runs, cells, first, last, box, bound, work)
            if whole:
                for s in range(samples[2][part], samples[2][part + 1]):
                    result |= samples[1][s]
                continue
            begin = last
        steps += (end - begin) * (samples[2][part + 1] - samples[2][part])
        result |= _bits(runs, begin, end, samples, part, voxel, spacing, squared)
    return result, steps


@kernel
def _open(done, block):
    # Whether some voxel of a block is undecided.
    for i in range(block[0], block[3]):
        for j in range(block[1], block[4]):
            for k in range(block[2], block[5]):
                if done[i, j, k] == 0:
                    return True
    return False


@kernel
def _close(masks, done, block, mask):
    # A block is decided: full or void.
    for i in range(block[0], block[3]):
        for j in range(block[1], block[4]):
            for k in range(block[2], block[5]):
                masks[i, j, k] |= mask
                done[i, j, k] = 1


@kernel
def _cut(block, spacing, leaf, cuts):
    # Where a block is cut along each axis: at its end if it is not.
    longest = 0.0
    for a in range(3):
        n = block[a + 3] - block[a]
        if n > leaf:
            longest = max(longest, n * spacing[a])
    for a in range(3):
        n = block[a + 3] - block[a]
        cuts[a] = block[a + 3]
        if n > leaf and 2.0 * n * spacing[a] > longest:
            cuts[a] = block[a] + (n + 1) // 2
    return longest > 0.0


@kernel
def _push(blocks, lists, top, block, cuts, first, last):
    # The parts of a block wait with its candidates.
    for corner in range(8):
        fits = True
        for a in range(3):
            upper = (corner >> a) & 1
            low = cuts[a] if upper else block[a]
            high = block[a + 3] if upper else cuts[a]
            blocks[top, a], blocks[top, a + 3] = low, high
            fits = fits and low < high
        if fits:
            lists[top, 0], lists[top, 1] = first, last
            top += 1
    return top


@kernel
def _settle(
    masks, done, start, spacing, samples, runs, cells, marks, until, bound, work, stack, top, budget
):
    # Depth first: the candidates of a block lie behind those of the block it is a part of.
    blocks, lists, block, cuts, low, high = stack
    leaf, final = until
    parts = len(samples[2]) - 1
    everything = ~np.uint64(0) >> np.uint64(64 - len(samples[1]))
    steps, room = 0, runs.shape[1]
    while top > 0 and steps < budget:
        first, last = lists[top - 1, 0], lists[top - 1, 1]
        if last + 2 * (last - first) > room:  # also for the parts of a voxel
            return top, True
        top -= 1
        for a in range(6):
            block[a] = blocks[top, a]
        if not _open(done, block):
            continue
        for a in range(3):
            low[a], high[a] = start[a] + block[a], start[a] + block[a + 3] - 1
        box = _box(low, high, samples, parts, spacing)
        steps += last - first
        whole, end = _sift(runs, cells, first, last, box, bound, work)
        if whole or end == last:
            _close(masks, done, block, everything if whole else np.uint64(0))
        elif _cut(block, spacing, leaf, cuts):
            top = _push(blocks, lists, top, block, cuts, last, end)
        elif final:
            bits, more = _voxel(runs, cells, last, end, samples, low, spacing, bound, work)
            masks[block[0], block[1], block[2]] |= bits
            steps += more
        else:
            for c in range(last, end):
                marks[cells[c]] = WANTED
    return top, False


class Canvas:
    """A tile whose samples are asked by nets, each finer than the one before.

    Parameters
    ----------
    masks
        uint64, shape (nx, ny, nz), all zero: bits of samples within the radius are set.
    start
        First voxel of the tile in the lattice, (3,).
    spacing
        Edge lengths of a voxel, (3,).
    samples
        The points of a voxel.
    radius
        Of the balls.
    """

    def __init__(
        self,
        masks: NDArray[np.uint64],
        start: Indices,
        spacing: Floats,
        samples: Samples,
        radius: float,
    ) -> None:
        self.masks = masks
        self.done = np.zeros(masks.shape, np.uint8)
        self.start, self.spacing = source(start, np.int64), source(spacing, np.float64)
        self.samples = samples
        edge = float(spacing.min())
        self.radius, self.rounding = radius + CLOSED * edge, ROUNDING * edge

    def by_coarse(
        self,
        marks: NDArray[np.uint8],
        place: tuple[Indices, Floats],
        sought: tuple[NDArray[np.uint8], int],
        within: tuple[float, float],
    ) -> None:
        """Decide the blocks that a coarse net is certain of, and mark the cells the others want.

        Parameters
        ----------
        marks
            uint8 (ux, uy, uz), one where a cell belongs to the net; set to ``WANTED`` where the
            last net may have cells that are the nearest to an undecided sample.
        place
            The first cell and the edge lengths of a cell.
        sought
            Not zero where cells of the net are looked for, in cubes of so many cells an edge.
        within
            How much further than the centre of a cell of this net the nearest of the last net may
            be at most, and how much nearer.
        """
        self._settle(marks, place, sought, within, final=False)

    def by_fine(
        self,
        marks: NDArray[np.uint8],
        place: tuple[Indices, Floats],
        sought: tuple[NDArray[np.uint8], int],
    ) -> None:
        """Set the bits of samples within the radius of the net's runs along z, as above."""
        self._settle(marks, place, sought, (0.0, 0.0), final=True)

    def _settle(
        self,
        marks: NDArray[np.uint8],
        place: tuple[Indices, Floats],
        sought: tuple[NDArray[np.uint8], int],
        within: tuple[float, float],
        *,
        final: bool,
    ) -> None:
        start, cell = source(place[0], np.int64), source(place[1], np.float64)
        given = marks, source(sought[0], np.uint8), sought[1], final, start, cell
        runs, cells = _room(ROOM)
        count = _runs(*given, runs, cells)
        if count > ROOM:
            runs, cells = _room(ENOUGH * count)
            _runs(*given, runs, cells)
        far = np.empty(count)
        work = np.empty(count), far, far.view(np.int64)
        bound = within[0] + self.rounding, within[1] + self.rounding, self.radius
        stack = _stack(self.masks.shape, count)
        leaf = 1 if final else max(1, int((2 * cell / self.spacing).max()))
        tile = self.masks, self.done, self.start, self.spacing, self.samples
        flags, top = marks.reshape(-1), 1
        while top:
            net = runs, cells, flags, (leaf, final), bound, work
            top, full = _settle(*tile, *net, stack, top, BUDGET)
            if full:
                old, size = (runs, cells), len(cells)
                runs, cells = _room(2 * size)
                runs[:, :size], cells[:size] = old


def _room(size: int) -> tuple[Floats, Indices]:
    return np.empty((4, size)), np.empty(size, np.int64)


def _stack(shape: tuple[int, ...], count: int) -> tuple[Indices, ...]:
    blocks, lists = np.empty((DEPTH, 6), np.int64), np.empty((DEPTH, 2), np.int64)
    blocks[0], lists[0] = (0, 0, 0, *shape), (0, count)
    return (blocks, lists, *(np.empty(n, np.int64) for n in (6, 3, 3, 3)))
