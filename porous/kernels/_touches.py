"""Places where basins touch, told by both and by how many periods lie between their images."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

WIDE, ZERO = 5, 1 << 14
"""Periods along x, y and z are one number, of so many bits each; and what makes it positive."""


class Touches(NamedTuple):
    """Places where two basins touch: what tells them, the height there, and how many they are.

    A key is the one label times ``size``, and the other, and below them in 3 × ``WIDE`` bits the
    periods between their images and ``ZERO``.
    """

    keys: NDArray[np.int64]
    saddles: NDArray[np.float32]
    counts: NDArray[np.int64]

    @classmethod
    def room(cls, n: int) -> Touches:
        """Return room for so many places."""
        return cls(np.empty(n, np.int64), np.empty(n, np.float32), np.ones(n, np.int64))

    def reduced(self) -> Touches:
        """Return each key once, ascending, with the highest of its places."""
        order = np.lexsort((self.saddles, self.keys))
        keys, saddles, counts = self.keys[order], self.saddles[order], self.counts[order]
        first = np.flatnonzero(np.diff(keys, prepend=-1) != 0)
        if not len(first):
            return self
        last = np.append(first[1:], len(keys)) - 1
        return Touches(keys[first], saddles[last], np.add.reduceat(counts, first))

    def ends(self, size: int) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
        """Return both labels of each key, and the periods between them."""
        pairs = self.keys >> 3 * WIDE
        periods = (self.keys & ((1 << 3 * WIDE) - 1)) - ZERO
        return np.stack([pairs // size, pairs % size], axis=1).astype(np.int32), periods
