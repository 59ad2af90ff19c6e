"""Rational control points: four homogeneous numbers each, and the division that comes last.

A control with a weight w is kept as (w·x, w·y, w·z, w). Cells mix these four rows by the matrices
that mix three, and what is emitted is divided by its own weight at the very end: circles, cylinders
and spheres are then exact (Piegl & Tiller 1997, *The NURBS Book*, ch. 4). Arrays have three rows,
positions, where no weights are given, and four where they are; certificates of the matrices do not
depend on which.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

ROWS = (3, 4)
"""Rows of controls without weights and with them."""

WIDEST = 1e9
"""The largest weight may be so many times the least."""


def columns(rows: Sequence[Sequence[float]]) -> Floats:
    """Return points as a recipe lists them, [x, y, z] or [x, y, z, w], as an array (3 or 4, m).

    Raises ``ModelError`` where some have a weight and others have none; names the first such.
    """
    sizes = [len(row) for row in rows]
    other = next((i for i, size in enumerate(sizes) if size != sizes[0]), None)
    if other is not None:
        raise ModelError(
            f"controls[{other}]: got {sizes[other]} numbers, but {sizes[0]} in controls[0]; wanted "
            "[x, y, z] for all, or [x, y, z, weight] for all"
        )
    return np.array(rows, np.float64).T


def homogeneous(points: Floats) -> Floats:
    """Return controls (4, m) of points with weights; points without any (3, m) as they are.

    Weights that are all alike are none, and a common factor means nothing: the largest becomes one.

    Parameters
    ----------
    points
        Shape (3, m), or (4, m) with the weights as the fourth row.

    Raises
    ------
    ModelError
        For an array of another shape, or a weight that is not above zero or too small beside the
        largest; names the control.
    """
    if points.ndim != 2 or len(points) not in ROWS:
        raise ModelError(
            f"controls: got shape {points.shape}; wanted (3, m), or (4, m) with weights"
        )
    if not is_rational(points):
        return points
    weights = points[3]
    worst = int(weights.argmin())
    if not weights[worst] > weights.max() / WIDEST:
        raise ModelError(
            f"controls[{worst}]: got weight {weights[worst]:g} beside a largest of "
            f"{weights.max():g}; wanted weights above zero, within a factor of {WIDEST:g}"
        )
    if (weights == weights[0]).all():
        return points[:3]
    shares = weights / weights.max()
    return np.vstack([points[:3] * shares, shares])


def is_rational(controls: Floats) -> bool:
    """Tell whether controls (…, 3 or 4, m) have weights."""
    return bool(controls.shape[-2] == ROWS[1])


def positions(controls: Floats) -> Floats:
    """Return where controls (…, 3 or 4, m) lie, (…, 3, m): the division by weights.

    Raises
    ------
    ModelError
        Where a weight is not above zero: it was mixed with a negative share.
    """
    if not is_rational(controls):
        return controls
    weights = controls[..., 3:, :]
    if not (weights > 0).all():
        raise ModelError(
            f"controls: a point of some cell is mixed to a weight of {weights.min():.6g}; wanted "
            "weights above zero everywhere: weights closer to each other, or less texture"
        )
    return np.asarray(controls[..., :3, :] / weights)


def scaled(controls: Floats, factor: Floats | float, shift: Floats | float = 0.0) -> Floats:
    """Return the controls (…, 3 or 4, m) of all x moved to factor·x + shift; weights stay.

    ``factor`` and ``shift`` are one number each, or three (3, 1).
    """
    weights = controls[..., 3:, :]
    moved = controls[..., :3, :] * factor + shift * (weights if is_rational(controls) else 1.0)
    return np.concatenate([moved, weights], axis=-2)
