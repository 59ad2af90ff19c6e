"""Whether trilinear cells are folded: certain bounds on their Jacobians."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

FLAT = 1e-6
"""A Jacobian of less than this is none: its cell's volume, if it were regular, is 1."""

HALVINGS = 8
"""How often a cell is cut to decide whether its Jacobian is positive."""

NODES = np.array([0.0, 0.5, 1.0])

CONVERT = np.array([[1, 0, 0], [-0.5, 2, -0.5], [0, 0, 1]])
"""From the values at ``NODES`` of a polynomial of degree 2 to its Bernstein coefficients."""


def jacobians(corners: Floats) -> Floats:
    """Return the Jacobians of trilinear cells as Bernstein coefficients, (n, 3, 3, 3).

    The least of a cell's 27 bounds its Jacobian from below, the eight at corners are values.

    Parameters
    ----------
    corners
        Shape (n, 8, 3), lexicographic: corner 4a + 2b + c at (a, b, c).
    """
    matrices = np.einsum("gal,nld->ngad", _slopes(), corners)
    values = np.linalg.det(matrices).reshape(-1, 3, 3, 3)
    found = np.einsum("ai,bj,ck,nijk->nabc", CONVERT, CONVERT, CONVERT, values, optimize=True)
    return np.asarray(found)


def _slopes() -> Floats:
    """Return the derivatives of the corners' weights at the 27 nodes, (27, 3, 8)."""
    places = np.array(list(itertools.product(NODES, repeat=3)))
    ends = np.array(list(itertools.product((0, 1), repeat=3)))
    weights = np.where(ends, places[:, None], 1 - places[:, None])
    slopes = np.repeat(weights[:, None], 3, axis=1)
    for axis in range(3):
        slopes[:, axis, :, axis] = np.where(ends[:, axis], 1.0, -1.0)
    return np.asarray(slopes.prod(axis=3))


def least_jacobian(coefficients: Floats) -> tuple[float, bool]:
    """Return a bound on the Jacobian of one cell, and whether it is a value that it has.

    The cell is cut into eights until all Bernstein coefficients (3, 3, 3) are positive or a value
    is not.
    """
    boxes = coefficients[None]
    for _ in range(HALVINGS):
        value = float(boxes[:, ::2, ::2, ::2].min())
        if value <= FLAT:
            return value, True
        boxes = boxes[boxes.min(axis=(1, 2, 3)) <= FLAT]
        if not len(boxes):
            return value, True
        boxes = _halved(boxes)
    return float(boxes.min()), False


def _halved(boxes: Floats) -> Floats:
    """Return the Bernstein coefficients (8·n, 3, 3, 3) of the eighths of boxes (de Casteljau)."""
    low = np.array([[1, 0, 0], [0.5, 0.5, 0], [0.25, 0.5, 0.25]])
    half = np.stack([low, low[::-1, ::-1]])
    parts = np.einsum("xai,ybj,zck,nijk->nxyzabc", half, half, half, boxes, optimize=True)
    return np.asarray(parts.reshape(-1, 3, 3, 3))
