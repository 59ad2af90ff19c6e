"""Tables of numbers as lines of text, many lines at a time."""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy as np
    from numpy.typing import NDArray

SLAB = 10_000
"""Lines that are made at once."""


def lines_of(*columns: NDArray[np.int64] | NDArray[np.float64]) -> Iterator[bytes]:
    """Give lines of numbers parted by blanks: whole ones as they are, others with all digits.

    Parameters
    ----------
    columns
        Arrays of shape (n,) or (n, k), which stand side by side.
    """
    widths = [column.shape[1] if column.ndim == 2 else 1 for column in columns]
    words = [
        word
        for column, width in zip(columns, widths, strict=True)
        for word in ["%d" if column.dtype.kind in "iu" else "%r"] * width
    ]
    line = " ".join(words) + "\n"
    for start in range(0, len(columns[0]), SLAB):
        slabs = [_lists(column[start : start + SLAB]) for column in columns]
        rows = zip(*chain.from_iterable(slabs), strict=True)
        count = len(columns[0][start : start + SLAB])
        yield (line * count % tuple(chain.from_iterable(rows))).encode()


def _lists(slab: NDArray[np.int64] | NDArray[np.float64]) -> Sequence[Sequence[float]]:
    result: Sequence[Sequence[float]] = [slab.tolist()] if slab.ndim == 1 else slab.T.tolist()
    return result
