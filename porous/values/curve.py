"""A line of a plot: a quantity over another, with its band of uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

DRAWN = ("line", "steps", "points")


@dataclass(frozen=True, eq=False)
class Curve(Value):
    """One line of a plot; lines of the same name share it.

    Parameters
    ----------
    name
        What the plot shows, in snake case: ``pore_size_distribution``, ``porosity_profile``, …
    series
        What this line is: ``pore``, ``along x``, …
    x, y
        float64, shape (n,), n at least 1.
    x_name, x_unit, y_name, y_unit
        What the axes are, in words and units; ``"1"`` for pure numbers.
    method
        How it was found.
    low, high
        float64, shape (n,), or None: y is within these by one standard uncertainty.
    drawn
        line, steps (a histogram: y holds from its x on to the next) or points.
    log
        Which axes are logarithmic: ``""``, ``"x"``, ``"y"`` or ``"xy"``.

    Raises
    ------
    ValueError
        Where shapes disagree, or ``drawn`` or ``log`` is not known.
    """

    name: str
    series: str
    x: Floats = field(repr=False)
    y: Floats = field(repr=False)
    x_name: str
    x_unit: str
    y_name: str
    y_unit: str
    method: str
    low: Floats | None = field(default=None, repr=False)
    high: Floats | None = field(default=None, repr=False)
    drawn: str = "line"
    log: str = ""

    def __post_init__(self) -> None:
        for name in ("x", "y", "low", "high"):
            if getattr(self, name) is not None:
                self._set(name, frozen(getattr(self, name), np.float64))
        shapes = {a.shape for a in (self.x, self.y, self.low, self.high) if a is not None}
        if len(shapes) != 1 or self.x.ndim != 1 or not len(self.x):
            raise ValueError(f"{self.name}: got arrays of shapes {shapes}; wanted (n,) for each")
        if (self.low is None) != (self.high is None):
            raise ValueError(f"{self.name}: got one of low and high; wanted both or neither")
        if self.drawn not in DRAWN:
            raise ValueError(f"drawn: got {self.drawn!r}; wanted one of {DRAWN}")
        if self.log not in ("", "x", "y", "xy"):
            raise ValueError(f'log: got {self.log!r}; wanted "", "x", "y" or "xy"')
