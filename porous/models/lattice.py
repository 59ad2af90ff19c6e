"""Sampling of digit sets: each sample has a digit per axis and level, and rows share tables."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.memory import check_memory
from porous.values import CENTRE

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.models.digits import DigitSet
    from porous.values import Box, Frame, Pattern

    Indices = NDArray[np.int64]

CLOSED = 1e-6
"""Solids are closed: a sample within this part of a voxel of a cell is in it."""

SMALL = 1 << 26
"""Bytes of tables that are not worth asking the memory about."""

MOST_CELLS = 2**45
"""More cells than this along an axis are below what floating point tells apart."""


def sample_digits(
    digits: DigitSet, level: int, box: Box, frame: Frame, pattern: Pattern
) -> NDArray[np.uint64]:
    """Return the masks of the level-``level`` cells of a digit set.

    A sample belongs to the cells that it lies in; on a plane between two (within ``CLOSED``) to
    both, so that a symmetric set gives a symmetric grid.

    Parameters
    ----------
    digits
        Which of the N × N × N cells are kept, at every level.
    level
        0 is the whole box.
    box
        The level-0 cell, in the frame's unit.
    frame
        Any; it need not be aligned with the cells.
    pattern
        Where in a voxel samples lie.

    Returns
    -------
    uint64, shape ``frame.shape``: bit r · C + c for the pattern's point (r, c).

    Raises
    ------
    ModelError
        For cells too small for floating point.
    """
    masks = np.zeros(frame.shape, np.uint64)
    lattice = _Lattice(digits, level, box, frame)
    bits = np.uint64(1) << np.arange(pattern.points, dtype=np.uint64)
    along = (pattern.rows[:, 0], pattern.rows[:, 1], pattern.depths.ravel())
    for chosen in product(*(lattice.cells(axis, along[axis]) for axis in range(3))):
        lattice.join(masks, chosen, bits.reshape(pattern.depths.shape), fresh=False)
    return masks


def fill_digits(
    digits: DigitSet,
    level: int,
    box: Box,
    frame: Frame,
    pattern: Pattern = CENTRE,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> NDArray[np.uint8] | None:
    """Return the fill, 0 or 255, where each voxel's samples lie in one cell; None elsewhere.

    That is so on every frame aligned with the cells, and for one sample per voxel unless a sample
    lies on a plane between cells. Nothing is counted, so this runs at the speed of memory.

    Parameters and errors as in ``sample_digits``; ``progress`` is called with planes done and all.
    """
    lattice = _Lattice(digits, level, box, frame)
    along = (pattern.rows[:, 0], pattern.rows[:, 1], pattern.depths.ravel())
    chosen = []
    for axis in range(3):
        both = lattice.cells(axis, along[axis])
        if len(both) > 1 or (both[0] != both[0][:, :1]).any():
            return None
        chosen.append(both[0][:, :1])
    fill = np.empty(frame.shape, np.uint8)
    lattice.join(fill, tuple(chosen), np.array([[255]], np.uint8), fresh=True, progress=progress)
    return fill


@dataclass(frozen=True)
class _Lattice:
    """A digit set's cells laid over a frame."""

    digits: DigitSet
    level: int
    box: Box
    frame: Frame

    def __post_init__(self) -> None:
        if self.level < 0:
            raise ModelError(f"level: got {self.level}; wanted 0 or more")
        if self.digits.divisions**self.level > MOST_CELLS:
            raise ModelError(
                f"level: {self.digits.divisions}^{self.level} cells along an axis are more than "
                "floating point tells apart; choose a lower level"
            )

    def cells(self, axis: int, offsets: NDArray[np.float64]) -> tuple[Indices, ...]:
        """Return the cell index of each voxel's samples along an axis, (n, p); −1 outside.

        Two arrays where samples lie on planes between cells: the lower and the upper cells.
        """
        frame, count = self.frame, self.digits.divisions**self.level
        at = (frame.start[axis] + np.arange(frame.shape[axis]))[:, None] + offsets
        place = frame.origin[axis] + at * frame.spacing[axis] - self.box.lower[axis]
        scale = count / self.box.lengths[axis]
        slack = min(CLOSED * frame.spacing[axis] * scale, 0.25)
        lower, upper = (np.floor(place * scale + s).astype(np.int64) for s in (-slack, slack))
        outside = (upper < 0) | (lower >= count)
        lower = np.where(outside, -1, np.maximum(lower, 0))
        upper = np.where(outside, -1, np.minimum(upper, count - 1))
        return (lower,) if np.array_equal(lower, upper) else (lower, upper)

    def join(
        self,
        out: NDArray[np.uint64] | NDArray[np.uint8],
        cells: tuple[Indices, ...],
        bits: NDArray[np.unsignedinteger],
        *,
        fresh: bool,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        """Join a pattern's lines: cells (n, R), (n, R), (n, R · C) along x, y, z; bits (R, C)."""
        from porous.kernels.lattice import join_rows

        x, y, z = (self._numbered(axis, index) for axis, index in enumerate(cells))
        which, kept = self._pairs(x.values, y.values, z.values)
        inside = np.where(cells[2].T >= 0, bits.reshape(-1, 1), 0).astype(out.dtype)
        lines = len(bits)
        join_rows(
            out,
            x.numbers,
            y.numbers,
            which,
            self._tables(kept, z.numbers, bits, out.dtype),
            np.bitwise_or.reduce(inside.reshape(lines, -1, out.shape[2]), axis=1),
            fresh=fresh,
            progress=progress,
        )

    def _tables(
        self,
        kept: NDArray[np.bool_],
        numbers: NDArray[np.int32],
        bits: NDArray[np.unsignedinteger],
        dtype: np.dtype[np.unsignedinteger],
    ) -> NDArray[np.unsignedinteger]:
        """Return the bits (R, L, U, n) that each kind of row keeps at each level."""
        shape = (len(bits), self.level, len(kept), len(numbers))
        needed = math.prod(shape) * dtype.itemsize
        if needed > SMALL:
            remedy = "Choose fewer divisions or fewer voxels."
            check_memory(needed, f"tables of {len(kept)} kinds of rows", remedy)
        tables = np.zeros(shape, dtype)
        for sample, bit in enumerate(bits.ravel()):
            line = sample // bits.shape[1]
            for level in range(self.level):
                keeps = kept[:, numbers[:, sample, level]]
                tables[line, level] |= keeps * bit.astype(dtype)
        return tables

    def _numbered(self, axis: int, index: Indices) -> _Numbered:
        """Return the digits of cells, (n, p) to (n, p, max(L, 1)), numbered among those there."""
        base = self.digits.divisions
        powers = base ** np.arange(self.level - 1, -1, -1, dtype=np.int64)
        digit = index[..., None] // powers % base if self.level else np.zeros((*index.shape, 1))
        values = np.intersect1d(digit, self.digits.keep[:, axis]).astype(np.int64)
        found = np.searchsorted(values, digit)
        known = np.append(values, -1)[found] == digit
        numbers = np.where(known, found, len(values))
        numbers[index < 0] = -1
        return _Numbered(values, numbers.astype(np.int32))

    def _pairs(
        self, xs: Indices, ys: Indices, zs: Indices
    ) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
        """Return the row kind of each pair of x and y digits, and what each kind keeps in z.

        The last number of every axis stands for digits that are never kept.
        """
        keep = self.digits.keep
        there = np.isin(keep[:, 0], xs) & np.isin(keep[:, 1], ys) & np.isin(keep[:, 2], zs)
        x, y, z = (np.searchsorted(v, keep[there, a]) for a, v in enumerate((xs, ys, zs)))
        pair, row = np.unique(x * (len(ys) + 1) + y, return_inverse=True)
        flags = np.zeros((len(pair), len(zs) + 1), np.bool_)
        flags[row.reshape(-1), z] = True
        kept, kind = np.unique(flags, axis=0, return_inverse=True)
        which = np.full((len(xs) + 1, len(ys) + 1), -1, np.int32)
        which.ravel()[pair] = kind.reshape(-1)
        return which, kept


@dataclass(frozen=True)
class _Numbered:
    values: Indices
    numbers: NDArray[np.int32]
