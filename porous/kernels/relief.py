"""Heights of self-affine reliefs: a bump on every dyadic cell of a rectangle, level by level."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

PAIRS = (0b0011, 0b0101, 0b0110, 0b1001, 0b1010, 0b1100)
"""Which two of the four children of a cell point upwards."""

WORD = (1 << 64) - 1
GOLDEN = 0x9E3779B97F4A7C15
FIRST, SECOND = 0xBF58476D1CE4E5B9, 0x94D049BB133111EB
"""Constants of the mixing of SplitMix64 (G. L. Steele, D. Lea & C. H. Flood 2014)."""


def keys(seed: int, levels: int) -> NDArray[np.uint64]:
    """Return the numbers that the signs of each level are drawn by, uint64 (levels,)."""

    def mixed(word):
        word = ((word ^ word >> 30) * FIRST) & WORD
        word = ((word ^ word >> 27) * SECOND) & WORD
        return word ^ word >> 31

    return np.array([mixed(seed + (k + 1) * GOLDEN & WORD) for k in range(levels)], np.uint64)


@kernel
def _mixed(word):
    word = (word ^ word >> np.uint64(30)) * np.uint64(FIRST)
    word = (word ^ word >> np.uint64(27)) * np.uint64(SECOND)
    return word ^ word >> np.uint64(31)


@kernel
def _sign(key, i, j):
    # Two of each four siblings point upwards, two downwards: which, their parent's number says.
    word = _mixed(key + np.uint64(i >> 1) * np.uint64(GOLDEN))
    word = _mixed(word + np.uint64(j >> 1) * np.uint64(GOLDEN))
    up = PAIRS[np.int64(word % np.uint64(6))]
    return 1.0 if up >> ((i & 1) * 2 + (j & 1)) & 1 else -1.0


@kernel
def _heights(out, places, cells, ratio, levels, signs):
    for n in range(len(places)):
        x, y = places[n, 0], places[n, 1]
        out[n] = 0.0
        if not (0.0 <= x <= 1.0 and 0.0 <= y <= 1.0):
            continue
        x, y = x * cells[0], y * cells[1]
        i, j = min(np.int64(x), cells[0] - 1), min(np.int64(y), cells[1] - 1)
        x, y = x - i, y - j
        size = 1.0
        for level in range(levels):
            bump = size * (1.0 - abs(2.0 * x - 1.0)) * (1.0 - abs(2.0 * y - 1.0))
            out[n] += _sign(signs[level], i, j) * bump if len(signs) else bump
            right, up = np.int64(x >= 0.5), np.int64(y >= 0.5)
            x, y = 2.0 * x - right, 2.0 * y - up
            i, j = 2 * i + right, 2 * j + up
            size *= ratio


def heights(
    places: Floats,
    cells: tuple[int, int],
    ratio: float,
    levels: int,
    signs: NDArray[np.uint64] | None = None,
) -> Floats:
    """Return Σ ± ratio^k · (the pyramid of the level-k cell), (n,); zero outside the unit square.

    Parameters
    ----------
    places
        Shape (n, 2), in edges of the rectangle.
    cells
        How many level-0 cells there are along each edge.
    ratio
        By what heights shrink where cells are halved.
    levels
        How many levels are summed, up to 48.
    signs
        The ``keys`` of at least as many levels; every bump points upwards where not given.
    """
    result = np.empty(len(places))
    _heights(
        result,
        source(places, np.float64),
        source(cells, np.int64),
        ratio,
        levels,
        source(np.zeros(0) if signs is None else signs, np.uint64),
    )
    return result
