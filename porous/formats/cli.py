"""CLI: the Common Layer Interface, version 2.0, in ASCII; contours of layers for printers.

One layer for each layer of voxels, as high as they are, with the outlines of its solid voxels:
exact for the grid. Outer contours run counter-clockwise (direction 1), holes clockwise (direction
0), each back to its first point. Voxels that touch in a corner only are not joined, as everywhere
here, so contours touch there and never cross. The height of a layer is that of its top; the first,
without contours, says where the bottom is. ``$$UNITS`` says how many millimetres the grid's unit
is, and all digits of lengths are written, without exponents.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from porous.formats._registry import Format
from porous.values import VoxelGrid
from porous.values.units import length_ratio

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    Indices = NDArray[np.int64]

HEAD = """$$HEADERSTART
$$ASCII
$$UNITS/{units}
$$VERSION/200
$$LABEL/1,porous
$$DIMENSION/{box}
$$LAYERS/{layers}
$$HEADEREND
$$GEOMETRYSTART
"""
TAIL = b"$$GEOMETRYEND\n"
OUTER, HOLE = 1, 0


def write(grid: VoxelGrid) -> Iterator[bytes]:
    """Write the outlines of the solid voxels, layer by layer from the lowest."""
    x, y, z = (_edges(grid, axis) for axis in range(3))
    box = ",".join((x[0], y[0], z[0], x[-1], y[-1], z[-1]))
    units = _decimal(length_ratio(grid.frame.unit, "mm"))
    yield HEAD.format(units=units, box=box, layers=len(z)).encode()
    yield f"$$LAYER/{z[0]}\n".encode()
    for layer, top in enumerate(z[1:]):
        lines = [f"$$LAYER/{top}\n"]
        for corners in contours(grid.solid[:, :, layer]):
            places = ",".join(f"{x[i]},{y[j]}" for i, j in corners)
            direction = OUTER if _twice_area(corners) > 0 else HOLE
            lines.append(f"$$POLYLINE/1,{direction},{len(corners)},{places}\n")
        yield "".join(lines).encode()
    yield TAIL


def contours(solid: NDArray[np.bool_]) -> list[list[tuple[int, int]]]:
    """Return the outlines of a layer's solid pixels, each a list of corners that ends as it begins.

    Solid lies to the left. Only points where a contour turns are listed, and where two solid
    pixels touch in a corner alone, a contour turns to stay with its own.

    Parameters
    ----------
    solid
        Shape (nx, ny).
    """
    padded = np.pad(solid, 1).astype(np.int8)
    # An edge along x that has solid above runs forwards, one that has it below backwards.
    along_x = _runs(np.diff(padded[1:-1], axis=1).T)
    along_y = _runs(-np.diff(padded[:, 1:-1], axis=0))
    xs, ys = (np.array(rows, np.int64).reshape(-1, 3) for rows in (along_x, along_y))
    # Both as (x, y) of start and end; a run is followed by one across, to the left if it can.
    ends_x = np.stack([xs[:, 1], xs[:, 0], xs[:, 2], xs[:, 0]], axis=1)
    ends_y = np.stack([ys[:, 0], ys[:, 1], ys[:, 0], ys[:, 2]], axis=1)
    after_x = _followers(ends_x, ends_y, solid.shape[1], turn=1)
    after_y = _followers(ends_y, ends_x, solid.shape[1], turn=-1)
    follow = np.concatenate([after_x + len(xs), after_y]).tolist()
    starts = np.concatenate([ends_x, ends_y])[:, :2].tolist()
    return _loops(follow, starts)


def _runs(signs: NDArray[np.int8]) -> Indices:
    """Return the runs of equal signs in rows (n, m): row, start and end, as the sign directs."""
    padded = np.pad(signs, ((0, 0), (1, 1)))
    row, place = np.nonzero(np.diff(padded, axis=1))
    before, after = padded[row, place], padded[row, place + 1]
    begin, end = np.flatnonzero(after), np.flatnonzero(before)
    forward = after[begin] > 0
    first, last = place[begin], place[end]
    return np.stack(
        [row[begin], np.where(forward, first, last), np.where(forward, last, first)], axis=1
    )


def _followers(runs: Indices, across: Indices, width: int, *, turn: int) -> Indices:
    """Return which run across each run is followed by: the one that turns left where two begin.

    ``turn`` is 1 where forwards turns left into forwards (from x into y), −1 otherwise.
    """
    keys = _key(across[:, :2], width, _forward(across))
    order = np.argsort(keys)
    left = _forward(runs) if turn > 0 else ~_forward(runs)
    wanted = _key(runs[:, 2:], width, left)
    at = np.searchsorted(keys, wanted, sorter=order)
    at[at == len(keys)] = 0
    found = keys[order[at]] == wanted if len(keys) else np.zeros(0, bool)
    right = np.searchsorted(keys, _key(runs[:, 2:], width, ~left), sorter=order)
    return np.asarray(order[np.where(found, at, right)])


def _key(points: Indices, width: int, forward: NDArray[np.bool_]) -> Indices:
    return np.asarray(2 * (points[:, 0] * (width + 1) + points[:, 1]) + forward)


def _forward(runs: Indices) -> NDArray[np.bool_]:
    return np.asarray((runs[:, 2:] - runs[:, :2]).sum(axis=1) > 0)


def _loops(follow: list[int], starts: list[list[int]]) -> list[list[tuple[int, int]]]:
    seen, result = bytearray(len(follow)), []
    for first in range(len(follow)):
        if seen[first]:
            continue
        loop, run = [], first
        while not seen[run]:
            seen[run] = 1
            loop.append((starts[run][0], starts[run][1]))
            run = follow[run]
        result.append([*loop, loop[0]])
    return result


def _twice_area(corners: Sequence[tuple[int, int]]) -> int:
    """Return twice the area of a contour, in pixels; below zero where it runs clockwise."""
    return sum(a[0] * b[1] - a[1] * b[0] for a, b in pairwise(corners))


def _edges(grid: VoxelGrid, axis: int) -> list[str]:
    """Return where the voxels' faces across an axis lie, in decimals."""
    frame = grid.frame
    index = frame.start[axis] + np.arange(frame.shape[axis] + 1)
    return [_decimal(place) for place in frame.origin[axis] + index * frame.spacing[axis]]


def _decimal(number: float) -> str:
    return np.format_float_positional(number, trim="0")


FORMAT = Format("Common Layer Interface", (".cli",), writes=(VoxelGrid,), write=write)
