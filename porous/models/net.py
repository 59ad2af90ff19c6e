"""Nets of sets without volume: cells, finer than voxels, that hold a point of each small part.

Balls about a net are material where the set itself is none. Whoever can tell which cells of a
lattice hold points, by maps of space or by weights of control points, has its net from here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Protocol, Self

import numpy as np

from porous.memory import check_memory

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.kernels.grown import Samples
    from porous.values import Frame, Pattern

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

CELLS = 4
"""Cells per shortest edge of a voxel of the net that balls are drawn about …"""

CELLS_OF_OFFSET = 48
"""… but cells need not be smaller than the offset over this."""

SPLIT = 4
"""Cells per edge of a cell of the next coarser net."""

OUT = 2
"""Mark of cells that matter to no sample that is undecided."""

TILE = (64, 64, 128)
"""Voxels that are drawn at a time."""

ENDS = 4
"""Boxes at the end of a descent have half diagonals of a cell's shortest edge over this."""

_OTHERS = ((1, 2), (0, 2), (0, 1))

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

    def finer(self, wanted: NDArray[np.bool_], cell: Floats) -> tuple[Window, NDArray[np.uint8]]:
        """Return the window of the finer cells in some of these, and which of these are in it."""
        found = [np.flatnonzero(wanted.any(axis=axes)) for axes in _OTHERS]
        lower = np.array([some[0] for some in found])
        part = wanted[tuple(slice(some[0], some[-1] + 1) for some in found)]
        start = (self.start + lower) * SPLIT
        shape = np.array(part.shape) * SPLIT
        return Window(start, shape, cell), np.ascontiguousarray(part, np.uint8)

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


class Marker(Protocol):
    """Marks the cells of a window that hold points of a set, as ``Net`` says."""

    def __call__(
        self, window: Window, marks: NDArray[np.uint8], size: float, *, whole: bool
    ) -> None:
        """Mark cells."""


@dataclass(frozen=True)
class Net:
    """The cells of a lattice that hold points of a set.

    Parameters
    ----------
    cell
        Edge lengths of a cell: whole parts of a voxel.
    held
        Lower and upper corner of a box that holds the set.
    mark
        Sets the marks (ux, uy, uz) of a window to one, by boxes of a half diagonal and smaller that
        are certain to hold their parts of the set: of every cell that holds a certain point of a
        box, or, where ``whole``, of every cell that a box touches. Where marks are set already, it
        may leave cells out. A cell's mark depends on its place in the lattice alone.
    """

    cell: Floats
    held: tuple[Floats, Floats]
    mark: Marker

    @classmethod
    def about(cls, frame: Frame, reach: float, held: tuple[Floats, Floats], mark: Marker) -> Self:
        """Return the net that is fine enough for balls of radius ``reach`` about its cells."""
        return cls(split_cells(frame, reach)[1], held, mark)

    @property
    def error(self) -> float:
        """Hausdorff distance from the set, at most, of the segments between neighbours along z."""
        return _error(self.cell)

    def grown(self, frame: Frame, pattern: Pattern, radius: float) -> NDArray[np.uint64]:
        """Return the masks of the balls about the net's runs of cells along z.

        Samples are within ``radius`` of a run, give or take 1e-6 of a voxel's shortest edge.
        """
        from porous.kernels.grown import Samples

        samples = Samples.of(pattern)
        masks = np.zeros(frame.shape, np.uint64)
        steps = (range(0, n, size) for n, size in zip(frame.shape, TILE, strict=True))
        for x, y, z in product(*steps):
            part = masks[x : x + TILE[0], y : y + TILE[1], z : z + TILE[2]]
            nx, ny, nz = part.shape
            tile = frame.tile((x, y, z), (x + nx, y + ny, z + nz))
            self._draw(part, tile, samples, radius)
        return masks

    def _draw(
        self, masks: NDArray[np.uint64], frame: Frame, samples: Samples, radius: float
    ) -> None:
        """Set the masks of a tile by nets that are finer each time, where the last was in doubt."""
        from porous.kernels.grown import WANTED, Canvas

        spacing = np.array(frame.spacing)
        canvas = Canvas(masks, np.array(frame.start), spacing, samples, radius)
        coarse = _coarse(self.cell, radius)
        window = self._window(frame, radius, self.cell * coarse)
        marks = window.empty()
        sought = np.ones((1, 1, 1), np.uint8), max(marks.shape)
        while coarse > 1:
            size, half = float(window.spacing.min()) / ENDS, math.hypot(*window.spacing) / 2
            self.mark(window, marks, size, whole=True)
            within = half + 2 * size + self.error, half
            canvas.by_coarse(marks, (window.start, window.spacing), sought, within)
            wanted = marks == WANTED
            if not wanted.any():
                return
            coarse //= SPLIT
            window, found = window.finer(wanted, self.cell * coarse)
            sought = found, SPLIT
            marks = window.empty()
            _leave_out(marks, found)
        self.mark(window, marks, float(self.cell.min()) / ENDS, whole=False)
        canvas.by_fine(marks, (window.start, window.spacing), sought)

    def _window(self, frame: Frame, reach: float, cell: Floats) -> Window:
        """Return the window of the cells within ``reach`` of a frame, and some more."""
        lower = np.maximum(np.array(frame.box.lower) - reach, self.held[0])
        upper = np.maximum(lower, np.minimum(np.array(frame.box.upper) + reach, self.held[1]))
        origin = np.array(frame.origin)
        start = np.floor((lower - origin) / cell).astype(np.int64) - 1
        stop = np.ceil((upper - origin) / cell).astype(np.int64) + 1
        return Window(start, np.maximum(stop - start, 1), cell)


def _coarse(cell: Floats, radius: float) -> int:
    """Return how many cells go along the edges of those of the coarsest net."""
    result = SPLIT
    while SPLIT * result * float(cell.max()) <= radius:
        result *= SPLIT
    return result


def _leave_out(marks: NDArray[np.uint8], sought: NDArray[np.uint8]) -> None:
    """Set marks (ux · s, …) to ``OUT`` where cells (ux, uy, uz) of s³ are not sought."""
    rows = np.repeat(np.where(sought, np.uint8(0), np.uint8(OUT)), SPLIT, axis=2)
    x, y, _ = sought.shape
    marks.reshape(x, SPLIT, y, SPLIT, -1)[:] = rows[:, None, :, None]
