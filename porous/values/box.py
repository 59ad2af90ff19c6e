"""An axis-parallel box of space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from porous.errors import GridError
from porous.values.value import Value, vector

SIDES = ("XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX")
"""Names of a box's sides."""


@dataclass(frozen=True, eq=False)
class Box(Value):
    """The closed box of the points between ``lower`` and ``upper``, in the unit of its owner.

    Raises
    ------
    GridError
        Where a bound is not finite or an upper bound lies below its lower one.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    def __post_init__(self) -> None:
        self._set("lower", vector(self.lower, "box lower corner", GridError))
        self._set("upper", vector(self.upper, "box upper corner", GridError))
        if any(a > b for a, b in zip(self.lower, self.upper, strict=True)):
            raise GridError(
                f"box: lower corner {self.lower} lies above the upper corner {self.upper}"
            )

    @classmethod
    def of_points(cls, points: object) -> Box:
        """Return the tight box of points, shape (n, 3)."""
        array = np.asarray(points, dtype=float)
        if array.ndim != 2 or array.shape[1] != 3 or not len(array):
            raise GridError(f"box: got points of shape {array.shape}; wanted (n, 3) with n ≥ 1")
        return cls(tuple(array.min(axis=0)), tuple(array.max(axis=0)))

    @property
    def lengths(self) -> tuple[float, float, float]:
        """Edge lengths along x, y and z."""
        a, b = self.lower, self.upper
        return b[0] - a[0], b[1] - a[1], b[2] - a[2]

    @property
    def volume(self) -> float:
        """Volume of the box, in its unit cubed."""
        x, y, z = self.lengths
        return x * y * z

    @property
    def centre(self) -> tuple[float, float, float]:
        """Midpoint of the box."""
        a, b = self.lower, self.upper
        return (a[0] + b[0]) / 2, (a[1] + b[1]) / 2, (a[2] + b[2]) / 2

    @property
    def corners(self) -> tuple[tuple[float, float, float], ...]:
        """The eight corners, z fastest."""
        x, y, z = zip(self.lower, self.upper, strict=True)
        return tuple((a, b, c) for a in x for b in y for c in z)

    def scaled(self, factor: float) -> Box:
        """Return the box whose corners are ``factor`` times as far from the origin."""
        lower, upper = (
            (x * factor, y * factor, z * factor) for x, y, z in (self.lower, self.upper)
        )
        return Box(lower, upper)

    def grown(self, distance: float) -> Box:
        """Return the box pushed outwards by ``distance`` on every side."""
        return Box(
            tuple(v - distance for v in self.lower),  # type: ignore[arg-type]
            tuple(v + distance for v in self.upper),  # type: ignore[arg-type]
        )

    def union(self, other: Box) -> Box:
        """Return the smallest box that holds both."""
        return Box(
            tuple(map(min, self.lower, other.lower)),  # type: ignore[arg-type]
            tuple(map(max, self.upper, other.upper)),  # type: ignore[arg-type]
        )

    def contains(self, other: Box, *, tolerance: float = 0.0) -> bool:
        """Tell whether ``other`` lies inside, give or take ``tolerance``."""
        return all(
            a - tolerance <= b for a, b in zip(self.lower, other.lower, strict=True)
        ) and all(b <= a + tolerance for a, b in zip(self.upper, other.upper, strict=True))
