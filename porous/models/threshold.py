"""Which grey values of an image are of one phase: given limits, or Otsu's.

Whole numbers of up to 16 bits are counted level by level, so that empty levels between (a scan that
was stretched, or scaled up from 8 bits) change nothing; others in 65 536 steps between the least
and the greatest. Values that are not finite are of no phase and counted apart.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

STEPS = 1 << 16
"""Into how many steps floats and wide whole numbers are sorted, and the levels of 16 bits."""
LARGEST = 2**53
"""Whole numbers up to this are floats without loss."""
SLAB = 1 << 24
"""How many values are looked at in one step, about."""


class Levels(NamedTuple):
    """How often grey values occur: ``counts`` of those from ``first`` to ``last``, ascending.

    Only levels that occur are there; of a whole number of its own ``first`` and ``last`` are the
    same. ``low`` and ``high`` are the least and the greatest value, and ``bad`` values not finite.
    """

    low: float
    high: float

    first: Floats
    last: Floats
    counts: NDArray[np.int64]
    bad: int

    def share(self, low: float, high: float) -> float:
        """Return the part of all values, to a step, that lie from ``low`` to ``high``."""
        middle = (self.first + self.last) / 2
        inside = int(self.counts[(middle >= low) & (middle <= high)].sum())
        return inside / (int(self.counts.sum()) + self.bad)


def levels_of(values: NDArray[Any]) -> Levels:
    """Return how often each grey value occurs.

    Parameters
    ----------
    values
        Truth values, whole numbers or floats, of any shape and order in memory.

    Raises
    ------
    ModelError
        Where none of them is finite.
    """
    if values.dtype.kind != "f" and values.dtype.itemsize <= 2 and values.dtype.isnative:
        return _few_levels(values)
    low, high, bad = _range(values)
    counts = np.zeros(STEPS, np.int64)
    first: Floats
    if values.dtype.kind != "f" and high - low < STEPS and max(-low, high) < LARGEST:
        width, first = 0.0, low + np.arange(STEPS, dtype=np.float64)
        for slab in _slabs(values):
            counts += np.bincount(slab.ravel("K").astype(np.int64) - int(low), minlength=STEPS)
    else:
        width = (high / STEPS - low / STEPS) or 1.0
        first = np.asarray(low + width * np.arange(STEPS), np.float64)
        for slab in _slabs(values):
            steps = _finite(slab).astype(np.float64) / width - low / width
            counts += np.bincount(np.clip(steps, 0, STEPS - 1).astype(np.int64), minlength=STEPS)
    there = np.flatnonzero(counts)
    return Levels(low, high, first[there], first[there] + width, counts[there], bad)


def _few_levels(values: NDArray[Any]) -> Levels:
    """Return the levels of whole numbers of up to 16 bits, each of which is counted."""
    from porous.kernels.greys import level_counts

    plain = f"u{values.itemsize}"
    counts: NDArray[np.int64] = np.zeros(256**values.itemsize, np.int64)
    for slab in _slabs(values):
        counts += level_counts(slab.ravel("K").view(plain))
    found = np.flatnonzero(counts)
    # Bits of a negative number are those of one beyond all that are not.
    levels = found.astype(plain).view(values.dtype).astype(np.int64)
    order = np.argsort(levels)
    levels, counts = levels[order], counts[found][order]
    each = levels.astype(np.float64)
    return Levels(int(levels[0]), int(levels[-1]), each, each, counts, 0)


def _range(values: NDArray[Any]) -> tuple[float, float, int]:
    """Return the least and the greatest finite value, and how many are not finite."""
    low, high, bad = math.inf, -math.inf, 0
    for slab in _slabs(values):
        finite = _finite(slab)
        bad += slab.size - finite.size
        if finite.size:
            low, high = min(low, finite.min()), max(high, finite.max())
    if bad == values.size:
        raise ModelError(f"grey values: none of {values.size} is a finite number")
    whole = values.dtype.kind != "f"
    return (int(low), int(high), bad) if whole else (float(low), float(high), bad)


def _finite(slab: NDArray[Any]) -> NDArray[Any]:
    flat = slab.ravel("K")
    return flat[np.isfinite(flat)] if flat.dtype.kind == "f" else flat


def _slabs(values: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Give the values in pieces that lie together in memory."""
    axis = int(np.argmax(np.abs(values.strides)))
    turned = np.moveaxis(values, axis, 0)
    step = max(1, SLAB * len(turned) // max(values.size, 1))
    for start in range(0, len(turned), step):
        yield turned[start : start + step]


def otsu(levels: Levels) -> tuple[float, float]:
    """Return the threshold that parts grey values into two classes best, and how well it does.

    The variance between the classes is the greatest that any threshold gives (N. Otsu, IEEE Trans.
    SMC 9 (1979) 62–66). Levels that do not occur lie between the classes: the threshold is in the
    middle of them.

    Returns
    -------
    threshold
        Values at or above it are of the upper class.
    separability
        The part of all variance that lies between the classes, η of that paper, from 0 to 1.

    Raises
    ------
    ModelError
        Where there is one level alone.
    """
    if len(levels.counts) < 2:
        raise ModelError(f"threshold: all grey values are {levels.low:g}; there is nothing to part")
    middle = (levels.first + levels.last) / 2
    total = float(levels.counts.sum())
    mean = float((levels.counts * middle).sum()) / total
    scale = float(np.abs(middle - mean).max())
    away, share = (middle - mean) / scale, levels.counts / total
    below, moment = np.cumsum(share)[:-1], np.cumsum(share * away)[:-1]
    above = np.cumsum(share[::-1])[::-1][1:]
    between = moment**2 / (below * above)
    best = int(np.argmax(between))
    threshold = (levels.last[best] + levels.first[best + 1]) / 2
    return float(threshold), float(between[best] / (share * away**2).sum())


def within(values: NDArray[Any], low: float, high: float) -> Flags:
    """Return where values lie from ``low`` to ``high``, both within; shape (x, y, z), C order."""
    if values.dtype.kind != "f":  # as whole numbers, of which no wide one loses its last digits
        low = math.ceil(low) if math.isfinite(low) else low
        high = math.floor(high) if math.isfinite(high) else high

    def inside(part: NDArray[Any]) -> Flags:
        found = np.asarray(part >= low, np.bool_)
        if math.isfinite(high):
            found &= part <= high
        elif part.dtype.kind == "f":
            found &= np.isfinite(part)
        return found

    along_x, _, along_z = map(abs, values.strides)
    if along_x < along_z:
        from porous.kernels.greys import turned

        return turned(inside, values)
    result = np.empty(values.shape, np.bool_)
    rows = max(1, SLAB * len(values) // max(values.size, 1))
    for start in range(0, len(values), rows):
        result[start : start + rows] = inside(values[start : start + rows])
    return result
