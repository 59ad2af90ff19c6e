"""Clouds of points under many maps: which voxels hold one of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.kernels.cover import System

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

BATCH = 1 << 26
"""Points of one call: about a tenth of a second."""

ROOM = 1024
"""Words that there is room for, before there are more."""


class Words(NamedTuple):
    """Words whose parts lie in a window or near it."""

    states: Indices
    """Their end states."""
    maps: Floats
    """Shape (w, 3, 4): to places in the window, counted in voxels from its first corner."""
    sizes: Floats
    """Half diagonals of boxes that hold their parts, in units of length."""
    inside: NDArray[np.bool_]
    """Whether the parts lie in the window for certain, no nearer to its border than a margin."""


@kernel
def _place(nodes, w, balls, blocks, state, window):
    # Whether a part may be near the window, whether it is inside for certain; its half diagonal.
    # Arrays are passed whole: a view of a row is a reference that is counted.
    shape, spacing, margin = window
    near, inside, size = True, True, 0.0
    for a in range(3):
        middle = other = nodes[w, a, 3]
        reach = across = 0.0
        for b in range(3):
            middle += nodes[w, a, b] * balls[state, b]
            reach += nodes[w, a, b] ** 2
            other += nodes[w, a, b] * blocks[state, b]
            across += abs(nodes[w, a, b]) * blocks[state, b + 3]
        reach = np.sqrt(reach) * balls[state, 3]
        low, high = max(middle - reach, other - across), min(middle + reach, other + across)
        near = near and high > -margin and low < shape[a] + margin
        inside = inside and low > margin and high < shape[a] - margin
        size += (reach * spacing[a]) ** 2
    return near, inside, np.sqrt(size)


@kernel
def _child(nodes, w, maps, child, result, made):
    for a in range(3):
        for c in range(4):
            value = nodes[w, a, 3] if c == 3 else 0.0
            for b in range(3):
                value += nodes[w, a, b] * maps[child, b, c]
            result[made, a, c] = value


@kernel
def _move(words, w, result, made):
    # Words are their states, maps, sizes, and whether they are inside.
    result[0][made], result[2][made], result[3][made] = words[0][w], words[2][w], words[3][w]
    for a in range(3):
        for c in range(4):
            result[1][made, a, c] = words[1][w, a, c]


@kernel
def _longer(first, targets, maps, states, nodes):
    count = 0
    for state in states:
        count += first[state + 1] - first[state]
    ends, result, made = np.empty(count, np.int64), np.empty((count, 3, 4)), 0
    for w in range(len(states)):
        for child in range(first[states[w]], first[states[w] + 1]):
            _child(nodes, w, maps, child, result, made)
            ends[made] = targets[child]
            made += 1
    return ends, result


def longer(
    first: Indices, targets: Indices, maps: Floats, words: tuple[Indices, Floats]
) -> tuple[Indices, Floats]:
    """Return all words that are one letter longer than these, in their order.

    Parameters
    ----------
    first, targets, maps
        Of a ``System``.
    words
        Their end states (k,) and their maps (k, 3, 4).
    """
    types = np.int64, np.int64, np.float64, np.int64, np.float64
    given = zip((first, targets, maps, *words), types, strict=True)
    ends, found = _longer(*(source(array, dtype) for array, dtype in given))
    return ends, found


@kernel
def _spread(system, state, finest, states, nodes, points):
    # Depth first. Every word that waits has a point; the last place is that of the word at hand.
    first, targets, maps, balls, centres = system
    room = len(states)
    states[0], nodes[0] = state, np.eye(3, 4)
    top, made, largest = 1, 0, 0.0
    while top:
        top -= 1
        state, total = states[top], 0.0
        for a in range(3):
            for c in range(4):
                nodes[room, a, c] = nodes[top, a, c]
                total += nodes[room, a, c] ** 2 if c < 3 else 0.0
        size = np.sqrt(total) * balls[state, 3]
        if size <= finest:
            for a in range(3):
                points[a, made] = nodes[room, a, 3]
                for b in range(3):
                    points[a, made] += nodes[room, a, b] * centres[state, b]
            made, largest = made + 1, max(largest, size)
        elif made + top + first[state + 1] - first[state] > room:
            return 0, np.inf
        else:
            for child in range(first[state], first[state + 1]):
                _child(nodes, room, maps, child, nodes, top)
                states[top] = targets[child]
                top += 1
    return made, largest


def spread(system: System, state: int, finest: float, most: int) -> tuple[Floats, float]:
    """Return a point of each part of an attractor, (3, n), and the size of the largest part.

    Parts are those of the shortest words of half diagonals up to ``finest``; there are no points,
    and the size is infinite, where there are more than ``most`` of them.
    """
    given = system.first, system.targets, system.maps, system.balls, system.points
    points = np.empty((3, most))
    words = np.empty(most, np.int64), np.empty((most + 1, 3, 4))
    made, largest = _spread(given, state, finest, *words, points)
    return np.ascontiguousarray(points[:, :made]), largest


@kernel
def _fit(system, window, asked, words, waiting, settled, many):
    # Level by level: of the words, those that are short enough come first, the others wait.
    first, targets, maps, balls, blocks = system
    widest, counts, most = asked
    states, nodes, sizes, inside = words
    points = 0
    for w in range(settled):
        points += counts[states[w]]
    while True:
        wide, opened, wanted = 0, 0, 0
        for w in range(settled, many):
            state = states[w]
            near, inside[w], sizes[w] = _place(nodes, w, balls, blocks, state, window)
            if near and sizes[w] > widest[state]:
                _move(words, w, waiting, wide)
                wide += 1
                opened += first[state + 1] - first[state]
                for child in range(first[state], first[state + 1]):
                    wanted += counts[targets[child]]
            elif near:
                _move(words, w, words, settled)
                settled += 1
                points += counts[state]
        room = settled + opened <= len(states)
        if wide == 0 or points + wanted > most or not room:
            for w in range(wide):
                _move(waiting, w, words, settled + w)
            more = 0 if room or points + wanted > most else settled + opened
            return settled, settled + wide, more
        many = settled
        for w in range(wide):
            state = waiting[0][w]
            for child in range(first[state], first[state + 1]):
                _child(waiting[1], w, maps, child, nodes, many)
                states[many] = targets[child]
                many += 1


def fit(
    system: System,
    root: tuple[int, Floats],
    shape: Indices,
    spacing: Floats,
    *,
    widest: Floats,
    counts: Indices,
    most: int,
    margin: float,
) -> Words:
    """Return words of an attractor that have parts in a window, or near it.

    Parameters
    ----------
    system
        The automaton.
    root
        The start state and the map (3, 4) of its space to the window's voxels.
    shape, spacing
        Numbers of voxels along the axes, and their edge lengths, (3,).
    widest
        For each state the half diagonal of parts above which words are replaced by all that are
        one letter longer, in units of length.
    counts
        Points of each state's cloud.
    most
        No longer words are looked for where these would have more points.
    margin
        How near, in voxels.
    """
    given = system.first, system.targets, system.maps, system.balls, system.blocks
    window = source(shape, np.int64), source(spacing, np.float64), float(margin)
    asked = source(widest, np.float64), source(counts, np.int64), int(most)
    words = _room(ROOM)
    words.states[0], words.maps[0] = root
    settled, many = 0, 1
    while True:
        waiting = _room(len(words.states))
        settled, many, more = _fit(given, window, asked, words, waiting, settled, many)
        found = Words._make(field[:many] for field in words)
        if not more:
            return found
        words = _room(2 * more)
        for new, field in zip(words, found, strict=True):
            new[:many] = field


def _room(size: int) -> Words:
    return Words(
        np.empty(size, np.int64), np.empty((size, 3, 4)), np.empty(size), np.empty(size, np.bool_)
    )


@kernel
def _stamp(marks, shape, maps, cloud, places):
    # All images lie in the window. Places first, marks after: the first loop has no stores that
    # could alias its loads, and is compiled to vectors.
    xs, ys, zs = cloud[0], cloud[1], cloud[2]
    count, new = len(xs), 0
    across, along = np.int32(shape[1] * shape[2]), np.int32(shape[2])
    for w in range(len(maps)):
        a, b, c, p = maps[w, 0, 0], maps[w, 0, 1], maps[w, 0, 2], maps[w, 0, 3]
        d, e, f, q = maps[w, 1, 0], maps[w, 1, 1], maps[w, 1, 2], maps[w, 1, 3]
        g, h, i, r = maps[w, 2, 0], maps[w, 2, 1], maps[w, 2, 2], maps[w, 2, 3]
        for k in range(count):
            x, y, z = xs[k], ys[k], zs[k]
            places[k] = (
                np.int32(a * x + b * y + c * z + p) * across
                + np.int32(d * x + e * y + f * z + q) * along
                + np.int32(g * x + h * y + i * z + r)
            )
        for k in range(count):
            new += marks[places[k]] == 0
            marks[places[k]] = 1
    return new


@kernel
def _stamp_clipped(marks, shape, maps, cloud, places):
    xs, ys, zs = cloud[0], cloud[1], cloud[2]
    count, new = len(xs), 0
    nx, ny, nz = np.float64(shape[0]), np.float64(shape[1]), np.float64(shape[2])
    across, along = np.int32(shape[1] * shape[2]), np.int32(shape[2])
    for w in range(len(maps)):
        a, b, c, p = maps[w, 0, 0], maps[w, 0, 1], maps[w, 0, 2], maps[w, 0, 3]
        d, e, f, q = maps[w, 1, 0], maps[w, 1, 1], maps[w, 1, 2], maps[w, 1, 3]
        g, h, i, r = maps[w, 2, 0], maps[w, 2, 1], maps[w, 2, 2], maps[w, 2, 3]
        for k in range(count):
            x, y, z = xs[k], ys[k], zs[k]
            u = a * x + b * y + c * z + p
            v = d * x + e * y + f * z + q
            t = g * x + h * y + i * z + r
            inside = (u >= 0.0) & (u < nx) & (v >= 0.0) & (v < ny) & (t >= 0.0) & (t < nz)
            # Held within the window, so that the conversions are defined for all.
            u, v, t = min(max(u, 0.0), nx), min(max(v, 0.0), ny), min(max(t, 0.0), nz)
            place = np.int32(u) * across + np.int32(v) * along + np.int32(t)
            places[k] = place if inside else np.int32(-1)
        for k in range(count):
            if places[k] >= 0:
                new += marks[places[k]] == 0
                marks[places[k]] = 1
    return new


def stamp(marks: NDArray[np.uint8], maps: Floats, cloud: Floats, *, inside: bool) -> int:
    """Mark the voxels that hold a point of the images of a cloud; return how many were not yet.

    Parameters
    ----------
    marks
        uint8, shape (nx, ny, nz), C-contiguous and of fewer than 2³¹ voxels: what is hit is set to
        one.
    maps
        Shape (w, 3, 4): to places in the window, counted in voxels from its first corner.
    cloud
        Shape (3, n): x, y and z of the points.
    inside
        Whether all images are known to lie in the window, not nearer to its border than rounding;
        where they do not, images outside are left out, more slowly.
    """
    flat = marks.reshape(-1)
    count = cloud.shape[1]
    step = max(1, BATCH // max(1, count))
    given = source(cloud, np.float64), np.empty(count, np.int32)
    draw = _stamp if inside else _stamp_clipped
    new = 0
    for first in range(0, len(maps), step):
        batch = source(maps[first : first + step], np.float64)
        new += draw(flat, marks.shape, batch, *given)
    return int(new)
