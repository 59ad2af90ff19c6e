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
def _place(map_, ball, block, shape, spacing, margin):
    # Whether a part may be near the window, whether it is inside for certain; its half diagonal.
    near, inside, size = True, True, 0.0
    for a in range(3):
        middle = other = map_[a, 3]
        reach = across = 0.0
        for b in range(3):
            middle += map_[a, b] * ball[b]
            reach += map_[a, b] ** 2
            other += map_[a, b] * block[b]
            across += abs(map_[a, b]) * block[b + 3]
        reach = np.sqrt(reach) * ball[3]
        low, high = max(middle - reach, other - across), min(middle + reach, other + across)
        near = near and high > -margin and low < shape[a] + margin
        inside = inside and low > margin and high < shape[a] - margin
        size += (reach * spacing[a]) ** 2
    return near, inside, np.sqrt(size)


@kernel
def _child(node, map_, result):
    for a in range(3):
        for c in range(4):
            value = node[a, 3] if c == 3 else 0.0
            for b in range(3):
                value += node[a, b] * map_[b, c]
            result[a, c] = value


@kernel
def _fit(system, window, asked, here, many, states, nodes, sizes, inside):
    # Level by level, from one of two places for words to the other and back.
    first, targets, maps, balls, blocks = system
    shape, spacing, margin = window
    widest, counts, most = asked
    while True:
        kept, opened, points = 0, 0, 0
        for w in range(many):
            state = states[here, w]
            ball, block = balls[state], blocks[state]
            near, within, size = _place(nodes[here, w], ball, block, shape, spacing, margin)
            if not near:
                continue
            states[here, kept], sizes[kept], inside[kept] = state, size, within
            nodes[here, kept] = nodes[here, w]
            kept += 1
            if size > widest[state]:
                opened += first[state + 1] - first[state]
                for child in range(first[state], first[state + 1]):
                    points += counts[targets[child]]
            else:
                opened += 1
                points += counts[state]
        many, wide = kept, False
        for w in range(many):
            wide = wide or sizes[w] > widest[states[here, w]]
        if not wide or points > most:
            return here, many, 0
        if opened > len(sizes):
            return here, many, opened
        made, other = 0, 1 - here
        for w in range(many):
            state = states[here, w]
            if sizes[w] > widest[state]:
                for child in range(first[state], first[state + 1]):
                    _child(nodes[here, w], maps[child], nodes[other, made])
                    states[other, made] = targets[child]
                    made += 1
            else:
                states[other, made] = state
                nodes[other, made] = nodes[here, w]
                made += 1
        here, many = other, made


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
    given = (
        source(system.first, np.int64),
        source(system.targets, np.int64),
        source(system.maps, np.float64),
        source(system.balls, np.float64),
        source(system.blocks, np.float64),
    )
    window = source(shape, np.int64), source(spacing, np.float64), float(margin)
    asked = source(widest, np.float64), source(counts, np.int64), int(most)
    room, here, many = ROOM, 0, 1
    states, nodes = np.empty((2, room), np.int64), np.empty((2, room, 3, 4))
    states[0, 0], nodes[0, 0] = root
    while True:
        sizes, inside = np.empty(room), np.empty(room, np.bool_)
        here, many, more = _fit(given, window, asked, here, many, states, nodes, sizes, inside)
        if not more:
            return Words(states[here, :many], nodes[here, :many], sizes[:many], inside[:many])
        room = 2 * more
        old, states, nodes = (
            (states, nodes),
            np.empty((2, room), np.int64),
            np.empty((2, room, 3, 4)),
        )
        for new, kept in zip((states, nodes), old, strict=True):
            new[here, :many] = kept[here, :many]


@kernel
def _stamp(marks, across, along, maps, xs, ys, zs, places):
    # All images lie in the window. Places first, marks after: the first loop has no stores that
    # could alias its loads, and is compiled to vectors.
    count = len(xs)
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
            marks[places[k]] = 1


@kernel
def _stamp_clipped(marks, shape, maps, xs, ys, zs, places):
    count = len(xs)
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
                marks[places[k]] = 1


def stamp(marks: NDArray[np.uint8], maps: Floats, cloud: Floats, *, inside: bool) -> None:
    """Mark the voxels that hold a point of the images of a cloud.

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
    xs, ys, zs = (source(axis, np.float64) for axis in cloud)
    step = max(1, BATCH // max(1, len(xs)))
    places = np.empty(len(xs), np.int32)
    shape = source(marks.shape, np.int64)
    across, along = np.int32(marks.shape[1] * marks.shape[2]), np.int32(marks.shape[2])
    for first in range(0, len(maps), step):
        batch = source(maps[first : first + step], np.float64)
        if inside:
            _stamp(flat, across, along, batch, xs, ys, zs, places)
        else:
            _stamp_clipped(flat, shape, batch, xs, ys, zs, places)
