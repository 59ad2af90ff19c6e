"""Nets of sets without volume: cells, finer than voxels, that hold a point of each small part.

Balls about a net are material where the set itself is none. Whoever can tell which cells of a
lattice hold points, by maps of space or by weights of control points, has its net from here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from porous.memory import check_memory
from porous.models.pieces import Lattice, paint_balls, paint_cylinders

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from porous.values import Frame, Pattern

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

CELLS = 4
"""Cells per shortest edge of a voxel of the net that balls are drawn about …"""

CELLS_OF_OFFSET = 48
"""… but cells need not be smaller than the offset over this."""

ENDS = 4
"""Boxes at the end of a descent have half diagonals of a cell's shortest edge over this."""

SMALL = 1 << 27
"""Bytes of a net that are not worth asking the memory about."""


@dataclass(frozen=True)
class Window:
    """A part of a lattice: first cell, numbers of cells, edge lengths of a cell."""

    start: Indices
    shape: Indices
    spacing: Floats

    @classmethod
    def of(cls, frame: Frame) -> Self:
        """Return the window whose cells are a frame's voxels."""
        return cls(np.array(frame.start), np.array(frame.shape), np.array(frame.spacing))

    def empty(self) -> NDArray[np.uint8]:
        """Return marks of no cell; raises ``MemoryLimitError`` where there are too many."""
        cells = math.prod(map(int, self.shape))
        if cells > SMALL:
            check_memory(cells, f"a net of {cells} cells", "Choose fewer voxels.")
        return np.zeros(self.shape, np.uint8)


def net_error(frame: Frame, offset: float) -> float:
    """Return how far what is drawn about a net may be from the grown set, in the frame's unit."""
    return _error(split_cells(frame, offset)[1])


def split_cells(frame: Frame, reach: float) -> tuple[Indices, Floats]:
    """Return into how many cells of a net a voxel is split, and their edge lengths."""
    h = np.array(frame.spacing)
    finest = max(float(h.min()) / CELLS, reach / CELLS_OF_OFFSET)
    split = np.maximum(np.ceil(h / finest * (1 - 1e-9)), 1).astype(np.int64)
    return split, h / split


def _error(cell: Floats) -> float:
    # A point of the set is in a box with the point that marked a cell. Between the centres of two
    # cells nothing is further from both points than one's far corners.
    ends = 2 * float(cell.min()) / ENDS
    far = math.hypot(cell[0] / 2, cell[1] / 2, cell[2])
    return float(max(math.hypot(*(cell / 2)) + ends, far))


@dataclass(frozen=True)
class Net:
    """Cells that hold points of a set; ``error`` is their Hausdorff distance from it, at most."""

    window: Window
    origin: Floats
    marks: NDArray[np.uint8]
    error: float

    @classmethod
    def about(
        cls,
        frame: Frame,
        reach: float,
        held: tuple[Floats, Floats],
        mark: Callable[[Window, float], NDArray[np.uint8]],
    ) -> Net:
        """Return the net of the part of a set within ``reach`` of a frame.

        Parameters
        ----------
        frame
            The voxels.
        reach
            In the frame's unit.
        held
            Lower and upper corner of a box that holds the set.
        mark
            Returns which cells of a window hold a point from a box of that half diagonal.
        """
        _, cell = split_cells(frame, reach)
        lower = np.maximum(np.array(frame.box.lower) - reach, held[0])
        upper = np.maximum(lower, np.minimum(np.array(frame.box.upper) + reach, held[1]))
        origin = np.array(frame.origin)
        start = np.floor((lower - origin) / cell).astype(np.int64) - 1
        stop = np.ceil((upper - origin) / cell).astype(np.int64) + 1
        window = Window(start, np.maximum(stop - start, 1), cell)
        marks = mark(window, float(cell.min()) / ENDS)
        return cls(window, origin, marks, _error(cell))

    def grown(self, frame: Frame, pattern: Pattern, radius: float) -> NDArray[np.uint64]:
        """Return the masks of the balls about the net's runs of cells along z."""
        lattice = Lattice.over(frame, pattern)
        for ends in self._runs():
            paint_cylinders(lattice, ends, radius)
            centres = np.unique(ends.reshape(-1, 3), axis=0)
            paint_balls(lattice, centres, np.full(len(centres), radius))
        return lattice.window.masks

    def _runs(self) -> Iterator[Floats]:
        """Yield the ends (k, 2, 3) of runs of marked cells along z, plane by plane of x."""
        cell = self.window.spacing
        for x, plane in enumerate(self.marks):
            change = np.diff(plane.astype(np.int8), axis=1, prepend=0, append=0)
            y, first = np.nonzero(change > 0)
            if not len(y):
                continue
            last = np.nonzero(change < 0)[1] - 1
            index = np.stack(
                [np.stack([np.full(len(y), x), y, z], axis=1) for z in (first, last)], axis=1
            )
            yield self.origin + (self.window.start + index + 0.5) * cell
