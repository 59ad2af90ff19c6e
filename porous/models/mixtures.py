"""The weights with which a cell's control points are mixed to give other points."""

from __future__ import annotations

from functools import reduce
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.models.automaton import State

    Floats = NDArray[np.float64]

FIT = 1e-9
"""How far a point may be from what its weights give, relative to the controls' size."""


def weights_of(state: State, points: Floats) -> Floats:
    """Return weights (m, n) that sum to one and give points (n, 3), in reference coordinates.

    Of four independent controls there is one choice. Of the corners of a parallelogram or a
    parallelepiped in the order 2a + b or 4a + 2b + c they are the products of the corners' linear
    weights, so that a bent cell's children are bent with it. Of other controls they are the least
    in norm of those that give the point (Moore–Penrose), which bend with the cell as a plane does.

    Raises
    ------
    ModelError
        For a point off the line or the plane that the controls span; names its index.
    """
    if state.inverse is not None:
        return np.asarray(state.inverse @ np.vstack([points.T, np.ones(len(points))]))
    axes = _box_axes(state.controls)
    found = _affine(state.controls, points) if axes is None else _multilinear(state, axes, points)
    size = max(float(np.ptp(state.controls, axis=1).max()), float(np.abs(points).max()))
    off = np.abs(state.controls @ found - points.T).max(axis=0)
    if (off > FIT * size).any():
        index = int(off.argmax())
        raise ModelError(
            f"points[{index}]: {points[index].tolist()} is {off[index]:.3g} off what the "
            f"{state.size} controls of {state.name!r} span; wanted a point that is a mixture of "
            "them"
        )
    return found


def _affine(controls: Floats, points: Floats) -> Floats:
    middle = controls.mean(axis=1, keepdims=True)
    size = max(float(np.ptp(controls, axis=1).max()), 1e-300)
    lifted = np.vstack([(controls - middle) / size, np.ones(controls.shape[1])])
    wanted = np.vstack([(points.T - middle) / size, np.ones(len(points))])
    return np.asarray(np.linalg.pinv(lifted, rcond=1e-12) @ wanted)


def _box_axes(controls: Floats) -> Floats | None:
    """Return the edges (3, k) from the first of 2^k controls that are a parallelepiped's corners.

    None where they are not, or for fewer than four.
    """
    amount = controls.shape[1]
    if amount not in (4, 8):
        return None
    first = [amount >> step for step in range(1, amount.bit_length())]
    axes = controls[:, first] - controls[:, :1]
    digits = np.array(list(product((0, 1), repeat=len(first)))).T
    size = float(np.abs(axes).max())
    off = np.abs(controls - controls[:, :1] - axes @ digits).max()
    flat = np.linalg.svd(axes, compute_uv=False)[-1] <= FIT * size
    return None if off > FIT * size or flat else axes


def _multilinear(state: State, axes: Floats, points: Floats) -> Floats:
    places = np.linalg.lstsq(axes, points.T - state.controls[:, :1], rcond=None)[0]
    linear = np.stack([1 - places, places], axis=1)
    return np.asarray(reduce(lambda a, b: (a[:, None] * b[None]).reshape(-1, len(points)), linear))
