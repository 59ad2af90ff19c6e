"""Straight lines through bodies: where each is inside, and how often it goes in and out.

A piece gives the line's two ends in it, a closed mesh each place where the line goes through a
triangle. A line is inside where more has begun than has ended, so that pieces may overlap.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, slabs, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]
    Progress = Callable[[int, int], None]

POLYTOPES, QUADRICS, TRIANGLES = 0, 1, 2
"""What forms are: planes that bound a piece, the rows of a quadric, the corners of a triangle."""

FIELDS = ("length", "solid", "bulk", "bulk_solid", "crossings", "from_solid", "to_solid")
"""What is told of each line."""

SLAB = 250
"""Lines of one call: a few milliseconds, where each meets hundreds of pieces."""

EVENTS = 1024
"""Ends on a line that there is room for at first."""

LEAF = 4
"""Pieces that share the smallest box."""

DEPTH = 64
"""Boxes that wait: one for each level of halving, of which there are no more."""


class Sight(NamedTuple):
    """Between which corners lines are looked at: of the box, and of the bulk within it.

    Parameters
    ----------
    box, bulk
        float64, shape (6,): lower and upper corner.
    tolerance
        Length within which ends are one, and lie on a side of the box.
    """

    box: Floats
    bulk: Floats
    tolerance: float


class Hierarchy(NamedTuple):
    """Pieces in an order in which neighbours are close, and boxes about halves of them.

    Parameters
    ----------
    forms
        float64, shape (k, r, 4).
    boxes
        float64, shape (2n, 6): node i has 2i and 2i + 1 below it; the last n each hold ``LEAF``
        pieces.
    """

    forms: Floats
    boxes: Floats

    @classmethod
    def of(cls, forms: Floats, lower: Floats, upper: Floats) -> Hierarchy:
        """Return the hierarchy of pieces (k, r, 4) that lie between corners (k, 3)."""
        order = np.argsort(_codes(lower + upper), kind="stable") if len(forms) else slice(None)
        count = 1 << max(0, (-(-len(forms) // LEAF) - 1)).bit_length()
        ends = np.full((count * LEAF, 6), np.inf)
        ends[:, 3:] = -np.inf
        ends[: len(forms)] = np.concatenate([lower, upper], axis=1)[order]
        boxes = np.zeros((2 * count, 6))
        boxes[count:] = _united(ends.reshape(count, LEAF, 6))
        while count > 1:
            count //= 2
            boxes[count : 2 * count] = _united(boxes[2 * count : 4 * count].reshape(count, 2, 6))
        return cls(source(forms[order], np.float64), source(boxes, np.float64))


def _united(ends: Floats) -> Floats:
    return np.concatenate([ends[..., :3].min(axis=1), ends[..., 3:].max(axis=1)], axis=1)


def _codes(middles: Floats) -> Indices:
    """Return numbers along Z. M. Morton's curve (1966), ten bits an axis."""
    low = middles.min(axis=0)
    extent = max(float(np.ptp(middles, axis=0).max()), np.finfo(float).tiny)
    cells = ((middles - low) / extent * 1023).astype(np.int64)
    codes = np.zeros(len(middles), np.int64)
    for bit in range(10):
        for axis in range(3):
            codes |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return codes


@kernel
def _span(box, at, along):
    # Between which places a line, given by a point and a direction, lies in a box.
    low, high = -np.inf, np.inf
    for a in range(3):
        if along[a] == 0.0:
            if at[a] < box[a] or at[a] > box[a + 3]:
                return np.inf, -np.inf
        elif along[a] > 0.0:
            low = max(low, (box[a] - at[a]) / along[a])
            high = min(high, (box[a + 3] - at[a]) / along[a])
        else:
            low = max(low, (box[a + 3] - at[a]) / along[a])
            high = min(high, (box[a] - at[a]) / along[a])
    return low, high


@kernel
def _in_planes(rows, at, along):
    low, high = -np.inf, np.inf
    for r in range(len(rows)):
        slope = rows[r, 0] * along[0] + rows[r, 1] * along[1] + rows[r, 2] * along[2]
        value = rows[r, 0] * at[0] + rows[r, 1] * at[1] + rows[r, 2] * at[2] + rows[r, 3]
        if slope == 0.0:
            if value > 0.0:
                return np.inf, -np.inf
        elif slope < 0.0:
            low = max(low, -value / slope)
        else:
            high = min(high, -value / slope)
    return low, high


@kernel
def _in_quadric(rows, at, along):
    # |F x + f| ≤ 1 over three rows, and the fourth between 0 and 1. Places count from the one
    # where the sum is least, for far from there squares cancel.
    slopes, mixed = 0.0, 0.0
    for r in range(3):
        slope = rows[r, 0] * along[0] + rows[r, 1] * along[1] + rows[r, 2] * along[2]
        value = rows[r, 0] * at[0] + rows[r, 1] * at[1] + rows[r, 2] * at[2] + rows[r, 3]
        slopes += slope * slope
        mixed += slope * value
    if slopes == 0.0:
        return np.inf, -np.inf
    middle, rest = -mixed / slopes, 1.0
    for r in range(3):
        value = rows[r, 3]
        for a in range(3):
            value += rows[r, a] * (at[a] + middle * along[a])
        rest -= value * value
    if rest <= 0.0:
        return np.inf, -np.inf
    half = np.sqrt(rest / slopes)
    low, high = middle - half, middle + half
    slope = rows[3, 0] * along[0] + rows[3, 1] * along[1] + rows[3, 2] * along[2]
    value = rows[3, 0] * at[0] + rows[3, 1] * at[1] + rows[3, 2] * at[2] + rows[3, 3]
    if slope == 0.0:
        if value < 0.0 or value > 1.0:
            return np.inf, -np.inf
    else:
        low = max(low, min(-value / slope, (1.0 - value) / slope))
        high = min(high, max(-value / slope, (1.0 - value) / slope))
    return low, high


@kernel
def _side(along, ax, ay, az, bx, by, bz):
    # On which side of a line an edge passes; of the edge the other way just the negative, so that
    # a line never slips between two triangles or goes through both.
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return along[0] * x + along[1] * y + along[2] * z


@kernel
def _in_triangle(corners, at, along):
    # Where a line goes through, and 1 where it goes in, −1 where out, 0 where past it.
    ax, ay, az = corners[0, 0] - at[0], corners[0, 1] - at[1], corners[0, 2] - at[2]
    bx, by, bz = corners[1, 0] - at[0], corners[1, 1] - at[1], corners[1, 2] - at[2]
    cx, cy, cz = corners[2, 0] - at[0], corners[2, 1] - at[1], corners[2, 2] - at[2]
    u = _side(along, ax, ay, az, bx, by, bz)
    v = _side(along, bx, by, bz, cx, cy, cz)
    w = _side(along, cx, cy, cz, ax, ay, az)
    if not ((u > 0.0 and v > 0.0 and w > 0.0) or (u < 0.0 and v < 0.0 and w < 0.0)):
        return 0.0, 0.0
    # The point is where the corners' weights v, w and u have it.
    total = u + v + w
    place = (v * ax + w * bx + u * cx) * along[0] + (v * ay + w * by + u * cy) * along[1]
    place += (v * az + w * bz + u * cz) * along[2]
    size = along[0] ** 2 + along[1] ** 2 + along[2] ** 2
    return place / total / size, -np.sign(total)


@kernel
def _collect(kind, forms, boxes, at, along, low, high, events, count, stack):
    # Adds what begins (1) and ends (−1) on a line; −1 where there is no more room.
    leaves = len(boxes) // 2
    top = 0
    stack[0] = 1
    while top >= 0:
        node = stack[top]
        top -= 1
        near, far = _span(boxes[node], at, along)
        if not max(near, low) <= min(far, high):
            continue
        if node < leaves:
            stack[top + 1], stack[top + 2] = 2 * node + 1, 2 * node
            top += 2
            continue
        first = (node - leaves) * 4
        for k in range(first, min(first + 4, len(forms))):
            if count + 2 > len(events):
                return -1
            if kind == 2:
                place, sign = _in_triangle(forms[k], at, along)
                if sign != 0.0:
                    events[count, 0], events[count, 1] = place, sign
                    count += 1
                continue
            if kind == 0:
                a, b = _in_planes(forms[k], at, along)
            else:
                a, b = _in_quadric(forms[k], at, along)
            if a < b:
                events[count, 0], events[count, 1] = a, 1.0
                events[count + 1, 0], events[count + 1, 1] = b, -1.0
                count += 2
    return count


@kernel
def _collect_digits(keep, divisions, level, lower, lengths, at, along, events, stack, box):
    # The same of the kept cells of a digit set: a cell waits as its level and its place there.
    count, top = 0, 0
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0, 0, 0, 0
    while top >= 0:
        depth, x, y, z = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        top -= 1
        cells = np.float64(divisions) ** depth
        for a in range(3):
            place = x if a == 0 else (y if a == 1 else z)
            box[a] = lower[a] + lengths[a] * (place / cells)
            box[a + 3] = lower[a] + lengths[a] * ((place + 1) / cells)
        near, far = _span(box, at, along)
        if not near < far:
            continue
        if depth < level:
            for k in range(len(keep)):
                top += 1
                stack[top, 0] = depth + 1
                stack[top, 1] = x * divisions + keep[k, 0]
                stack[top, 2] = y * divisions + keep[k, 1]
                stack[top, 3] = z * divisions + keep[k, 2]
            continue
        if count + 2 > len(events):
            return -1
        events[count, 0], events[count, 1] = near, 1.0
        events[count + 1, 0], events[count + 1, 1] = far, -1.0
        count += 2
    return count


@kernel
def _sort(events, count):
    # Shell's sort with Ciura's gaps: what is nearly in order takes hardly more than one pass.
    for gap in (701, 301, 132, 57, 23, 10, 4, 1):
        for i in range(gap, count):
            place, sign = events[i, 0], events[i, 1]
            j = i
            while j >= gap and events[j - gap, 0] > place:
                events[j, 0], events[j, 1] = events[j - gap, 0], events[j - gap, 1]
                j -= gap
            events[j, 0], events[j, 1] = place, sign


@kernel
def _shared_length(a, b, low, high):
    return max(0.0, min(b, high) - max(a, low))


@kernel
def _steepness(box, at, along, place):
    # How steeply a line goes through the side of the box that it is at.
    best, result = np.inf, 1.0
    for a in range(3):
        x = at[a] + place * along[a]
        off = min(abs(x - box[a]), abs(x - box[a + 3]))
        if off < best and along[a] != 0.0:
            best, result = off, abs(along[a])
    return result


@kernel
def _tell(result, events, count, at, along, box, bulk, tolerance):
    # What is inside is told of the stretches that follow; ends closer than the tolerance are one.
    low, high = _span(box, at, along)
    first, last = _span(bulk, at, along)
    first, last = max(first, low), min(last, high)
    for k in range(len(result)):
        result[k] = 0.0
    if not low < high:
        return
    result[0], result[2] = high - low, max(0.0, last - first)
    near = tolerance / _steepness(box, at, along, low)
    far = tolerance / _steepness(box, at, along, high)
    i = 0
    while i < count:
        begin, depth = events[i, 0], 0.0
        end = begin
        while i < count and (depth > 0.5 or events[i, 0] - end <= tolerance):
            depth += events[i, 1]
            end = events[i, 0]
            i += 1
        if end - low <= near or high - begin <= far or end <= begin:
            continue
        result[1] += _shared_length(begin, end, low, high)
        result[3] += _shared_length(begin, end, first, last)
        if begin - low <= near:
            result[5] = 1.0
        else:
            result[4] += 1.0
        if high - end <= far:
            result[6] = 1.0
        else:
            result[4] += 1.0


@kernel
def _through_pieces(out, lines, start, stop, box, bulk, tolerance, forms, boxes, events, stack):
    for n in range(start, stop):
        at, along = lines[n, :3], lines[n, 3:]
        low, high = _span(box, at, along)
        count = np.int64(0)  # of one type from the start: else all below is compiled twice
        for kind in range(3):
            if kind == 2:
                # All of a mesh, beyond the box too: what has begun there may go on in it.
                low, high = -np.inf, np.inf
            if count >= 0:
                count = _collect(
                    kind, forms[kind], boxes[kind], at, along, low, high, events, count, stack
                )
        if count < 0:
            return n
        _sort(events, count)
        _tell(out[n], events, count, at, along, box, bulk, tolerance)
    return stop


@kernel
def _through_digits(
    out, lines, start, stop, box, bulk, tolerance, keep, divisions, level, lower, lengths, events,
    stack, cell
):  # fmt: skip
    for n in range(start, stop):
        at, along = lines[n, :3], lines[n, 3:]
        count = _collect_digits(
            keep, divisions, level, lower, lengths, at, along, events, stack, cell
        )
        if count < 0:
            return n
        _sort(events, count)
        _tell(out[n], events, count, at, along, box, bulk, tolerance)
    return stop


def through_pieces(
    lines: Floats,
    sight: Sight,
    pieces: tuple[Hierarchy, Hierarchy, Hierarchy],
    progress: Progress | None = None,
) -> Floats:
    """Return what lines see of the union of pieces.

    Parameters
    ----------
    lines
        Shape (n, 6): a point and a direction of length one.
    sight
        Where lines are looked at.
    pieces
        Polytopes: a place is inside where all forms (k, r, 4) are zero or less. Quadrics: where the
        squares of the first three forms add up to one or less and the fourth lies from zero to
        one. Triangles: their corners (k, 3, 4), the fourth number unused, counter-clockwise seen
        from outside, of closed meshes.
    progress
        Called with the number of lines done and that of all.

    Returns
    -------
    float64, shape (n, 7): ``FIELDS``: the length in the box, how much of that is solid, both of the
    bulk, how often the line goes in or out inside the box, and whether it is inside where it enters
    the box and where it leaves it.
    """
    given = tuple(some.forms for some in pieces), tuple(some.boxes for some in pieces)

    def work(out: Floats, some: Floats, start: int, stop: int, events: Floats) -> int:
        stack = np.empty(DEPTH, np.int64)
        reached: int = _through_pieces(out, some, start, stop, *sight, *given, events, stack)
        return reached

    return _through(lines, work, progress)


def through_digits(
    lines: Floats,
    sight: Sight,
    keep: Indices,
    divisions: int,
    level: int,
    box: Floats,
    progress: Progress | None = None,
) -> Floats:
    """Return what lines see of the cells of a level of a digit set; see ``through_pieces``.

    Parameters
    ----------
    lines, sight, progress
        As there.
    keep
        Shape (k, 3): which of the ``divisions``³ cells are kept, and are divided again.
    divisions, level
        How often an edge is divided, and how often that is done.
    box
        Lower and upper corner of the level-0 cell, (6,).
    """
    kept = source(keep, np.int64)
    lower, lengths = source(box[:3], np.float64), source(box[3:] - box[:3], np.float64)

    def work(out: Floats, some: Floats, start: int, stop: int, events: Floats) -> int:
        stack = np.empty((level * len(kept) + 2, 4), np.int64)
        cells = kept, divisions, level, lower, lengths
        ends = start, stop, *sight
        reached: int = _through_digits(out, some, *ends, *cells, events, stack, np.empty(6))
        return reached

    return _through(lines, work, progress)


def _through(
    lines: Floats,
    work: Callable[[Floats, Floats, int, int, Floats], int],
    progress: Progress | None,
) -> Floats:
    """Call ``work`` for slabs of lines; it says how far it got, where there was too little room."""
    given = source(lines, np.float64)
    result = np.zeros((len(given), len(FIELDS)))

    def some(start: int, stop: int) -> None:
        events = np.empty((EVENTS, 2))
        while start < stop:
            start = work(result, given, start, stop, events)
            if start < stop:
                events = np.empty((2 * len(events), 2))

    slabs(len(given), SLAB, some, progress)
    return result
