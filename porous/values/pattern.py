"""Where inside a voxel the solid is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Pattern(Value):
    """Sample points of a voxel: lines along z through ``rows``, at ``depths`` on each.

    Bit ``r · C + c`` of a voxel's mask is the point ``(rows[r], depths[r, c])``.

    Parameters
    ----------
    rows
        Shape (R, 2): x and y of each line, in voxels, strictly between 0 and 1.
    depths
        Shape (R, C): z of the points of each line, rising; R · C ≤ 64.
    """

    rows: NDArray[np.float64]
    depths: NDArray[np.float64]

    def __post_init__(self) -> None:
        self._set("rows", frozen(self.rows, np.float64))
        self._set("depths", frozen(self.depths, np.float64))
        if self.rows.ndim != 2 or self.rows.shape[1] != 2 or self.depths.ndim != 2:
            raise GridError("pattern: wanted rows (R, 2) and depths (R, C)")
        if len(self.rows) != len(self.depths) or not 1 <= self.depths.size <= 64:
            raise GridError("pattern: wanted as many depths as rows, and at most 64 points")
        for array in (self.rows, self.depths):
            if not (array > 0).all() or not (array < 1).all():
                raise GridError("pattern: wanted points strictly inside the voxel")
        if not (np.diff(self.depths, axis=1) > 0).all():
            raise GridError("pattern: wanted the depths of each row to rise")

    @property
    def points(self) -> int:
        """Number of sample points of a voxel."""
        return int(self.depths.size)


def _staggered() -> Pattern:
    # Sixteen lines with distinct x and distinct y, and depths shifted by distinct sixteenths: no
    # axis-parallel plane passes through many samples at once. Which line has which y and shift was
    # searched for, so that planes of no other direction pass through many either.
    y = (7, 14, 5, 0, 10, 4, 13, 9, 2, 11, 15, 1, 8, 6, 12, 3)
    shift = np.array((14, 0, 4, 8, 13, 5, 11, 1, 12, 6, 3, 10, 2, 15, 7, 9))
    rows = (np.stack([np.arange(16), y], axis=1) + 0.5) / 16
    depths = (np.arange(4) + (shift[:, None] + 0.5) / 16) / 4
    return Pattern(rows, depths)


CENTRE = Pattern(np.array([[0.5, 0.5]]), np.array([[0.5]]))
"""One sample, at the voxel's centre."""

FILL = _staggered()
"""Sixty-four staggered samples: sub-voxel volume fraction."""
