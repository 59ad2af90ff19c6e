"""Corners and triangles as bytes that deflate well, and the order that makes them so.

Corners lie along Morton's curve, and of each coordinate only the step from the last corner is kept.
Triangles begin with their first corner along the curve, follow it, and keep the step from the last
triangle's and how much further the two others lie. Of all numbers the low bytes come first, then
the next: most high ones are zero.
"""

from __future__ import annotations

import base64
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Indices = NDArray[np.int64]

LEVEL = 7
"""How hard zlib tries."""


def curve(places: NDArray[np.uint16]) -> Indices:
    """Return the order of places, shape (n, 3), along Morton's curve."""
    code = np.zeros(len(places), np.int64)
    for bit in range(16):
        for axis in range(3):
            code |= ((places[:, axis].astype(np.int64) >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def in_order(triangles: Indices, walls: int) -> Indices:
    """Return triangles that begin with their first corner and follow these; walls stay first."""
    first = triangles.argmin(axis=1)
    turned = np.take_along_axis(triangles, (first[:, None] + np.arange(3)) % 3, axis=1)
    caps = np.arange(len(turned)) >= walls
    return turned[np.lexsort((turned[:, 2], turned[:, 1], turned[:, 0], caps))]


def of_corners(places: NDArray[np.uint16]) -> bytes:
    """Return places, shape (n, 3), as bytes: axis by axis, the steps between them."""
    steps = np.diff(places, axis=0, prepend=np.zeros((1, 3), np.uint16))
    return b"".join(_planes(steps[:, axis]) for axis in range(3))


def of_triangles(triangles: NDArray[np.uint32]) -> bytes:
    """Return triangles, shape (t, 3), as bytes: steps between first corners, then the others'."""
    first = triangles[:, 0]
    steps = np.diff(first, prepend=np.zeros(1, np.uint32))
    return b"".join(map(_planes, (steps, triangles[:, 1] - first, triangles[:, 2] - first)))


def of_values(values: NDArray[np.uint16]) -> bytes:
    """Return values, shape (n,), as bytes."""
    return _planes(values)


def _planes(numbers: NDArray[Any]) -> bytes:
    """Return the low bytes of all numbers, then the next."""
    size = numbers.dtype.itemsize
    little = np.ascontiguousarray(numbers, dtype=numbers.dtype.newbyteorder("<"))
    return little.view(np.uint8).reshape(-1, size).T.tobytes()


def text(content: bytes) -> str:
    """Return bytes deflated, in base64."""
    return base64.b64encode(zlib.compress(content, LEVEL)).decode()
