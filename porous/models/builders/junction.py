"""Junctions of quadratic with cubic B-splines: a curve, and a strip of surface.

A quadratic ends in two controls, its point between them (dual); a cubic in three, its point at the
middle one (primal): no end of the one is an end of the other. A junction has the controls of both
ends. It is a quadratic piece and a smaller junction, and one point where they meet is free
(Podkorytov, Gentil, Sokolov & Lanquetin 2014). In the strip every line across is such a curve.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.models.brep import Boundary, CellState, Child, selection
from porous.models.builders._assembled import assembled, called
from porous.models.builders._builder import Builder
from porous.models.builders._curves import uniform
from porous.models.builders._tensor import tensor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.models.brep import BRep
    from porous.models.builders._builder import Options

    Floats = NDArray[np.float64]

DUAL = np.array([[3, 1, 0, 0], [1, 3, 3, 1], [0, 0, 1, 3]]) / 4
"""Weights of the four new controls of a quadratic's three, one after the other."""

PRIMAL = np.array([[4, 1, 0, 0, 0], [4, 6, 4, 1, 0], [0, 1, 4, 6, 4], [0, 0, 0, 1, 4]]) / 8
"""Weights of the five new controls of a cubic's four."""

BETWEEN = np.array([[1, 0, 0, 0], [3, 3, 1, 0], [0, 1, 3, 3], [0, 0, 0, 1]]) / 4
"""Weights of the four points among a cubic's controls that lie beside a quadratic's new ones."""

FREE = np.array([0, 1, 1, 2, 0]) / 4
"""Weights of the free point of a curve, so that parabolas stay parabolas.

The smaller junction's eigenvalues are then 1, ½, ¼, ¼, ¼: there is a tangent at the cubic end. With
Chaikin's own point (0, ¾, ¼, 0, 0) they begin with 1, ¾: there is none.
"""

PARABOLA = np.array([[-1 / 2, 1 / 2, 1 / 2, 1, 3 / 2], [0, 0, 1 / 6, 11 / 12, 13 / 6], [0] * 5])
"""Controls of a curve: its points are (t, t²) from 0 to 1."""

STRIP, PATCH, ACROSS, QUADRATIC, CUBIC, QUADRATIC_END, CUBIC_END = range(7)
"""Indices of the states of a strip."""

WIDTHS = (3, 3, 4, 4, 4)
"""Number of a strip's controls along v in its rows: two of a quadratic end, three of a cubic."""


def _curve(options: Options) -> BRep:
    """Return the curve from a quadratic's end to a cubic's; ``keep`` of its pieces "0" and "1".

    Raises ``ModelError`` for another number of controls, or pieces that are not there.
    """
    _check_controls(options, 5)
    points = _line()
    ends = Boundary("V0", 2, selection(5, (0, 1))), Boundary("V1", 3, selection(5, (2, 3, 4)))
    pieces = Child("0", 1, points[:, :3]), Child("1", 0, points[:, 1:])
    quadratic = {0: (1, "quadratic"), 1: (2, "quadratic end")}
    states = (
        CellState("cell", "edge", PARABOLA, ends, pieces),
        *called(tensor([uniform(2)]).states, quadratic),
        *called(tensor([uniform(3)]).states, {1: (3, "cubic end")}),
    )
    return assembled(states, options.keeping("cell"))


def _strip(options: Options) -> BRep:
    """Return the strip from a biquadratic patch at u = 0 to a bicubic one at u = 1.

    Its controls are 2 × 3 of the one, then 3 × 4 of the other; its quarters, ``keep`` of them,
    are two patches and two strips.

    Raises ``ModelError`` for another number of controls, or quarters that are not there.
    """
    _check_controls(options, sum(WIDTHS))
    biquadratic, bicubic = (tensor([uniform(degree)] * 2).states for degree in (2, 3))
    quadratic = {0: (PATCH, "patch"), 1: (QUADRATIC, "quadratic edge")}
    patch, edge, end = called(biquadratic, quadratic | {2: (QUADRATIC_END, "quadratic end")})
    cubic = called(bicubic, {1: (CUBIC, "cubic edge"), 2: (CUBIC_END, "cubic end")})
    strip = CellState(
        "cell",
        "quad",
        _level_strip(),
        tuple(
            Boundary(name, state, selection(sum(WIDTHS), own))
            for name, (state, own) in _sides().items()
        ),
        tuple(Child(f"{u}{v}", (PATCH, STRIP)[u], _quarter(u, v)) for u in (0, 1) for v in (0, 1)),
    )
    states = strip, patch, _across(strip, patch), edge, cubic[0], end, cubic[1]
    return assembled(states, options.keeping("cell"))


def _line() -> Floats:
    """Return the weights (5, 6) of a curve's new controls: two, the free one, and three."""
    result = np.zeros((5, 6))
    result[:2, :2] = DUAL[:2, :2]
    result[:, 2] = FREE
    result[2:, 3:] = PRIMAL[:3, :3]
    return result


def _check_controls(options: Options, size: int) -> None:
    if options.controls not in (None, size):
        raise ModelError(
            f"controls: got {options.controls} for a {options.cell} cell; wanted {size}"
        )


# --- the strip -------------------------------------------------------------------------------


def _control(row: int, along: int) -> int:
    """Return which control of the strip is the one at a place of a row."""
    return sum(WIDTHS[:row]) + along


def _ends(rows: tuple[int, ...], side: int) -> list[int]:
    """Return the controls of rows that their ends on a side need, v = 0 or v = 1."""
    return [_control(row, side + k) for row in rows for k in range(WIDTHS[row] - 1)]


def _sides() -> dict[str, tuple[int, list[int]]]:
    """Return the boundaries of the strip: their states and controls."""
    left, right = (0, 1), (2, 3, 4)
    return {
        "UMIN": (QUADRATIC, [_control(row, k) for k in range(3) for row in left]),
        "UMAX": (CUBIC, [_control(row, k) for k in range(4) for row in right]),
        "VMIN": (ACROSS, _ends(left + right, 0)),
        "VMAX": (ACROSS, _ends(left + right, 1)),
        "V00": (QUADRATIC_END, _ends(left, 0)),
        "V01": (QUADRATIC_END, _ends(left, 1)),
        "V10": (CUBIC_END, _ends(right, 0)),
        "V11": (CUBIC_END, _ends(right, 1)),
    }


def _quarter(u: int, v: int) -> Floats:
    """Return the matrix of a quarter: a patch's at u = 0, a strip's at u = 1."""
    widths = ((3, 3, 3), WIDTHS)[u]
    return np.stack(
        [_new(u + row, v + k) for row, width in enumerate(widths) for k in range(width)], axis=1
    )


def _new(row: int, along: int) -> Floats:
    """Return the weights of a new control: in products, the curve's and those along the row."""
    left, right = np.split(_line()[:, row], [2])
    if row < 3:
        parts = np.kron(left, DUAL[:, along]), np.kron(right, BETWEEN[:, along])
    else:
        parts = np.zeros(6), np.kron(right, PRIMAL[:, along])
    return np.concatenate(parts)


def _across(strip: CellState, patch: CellState) -> CellState:
    """Return the edge v = 0 of the strip: what its quarters there say of its controls."""
    side, inner = (
        next(b.matrix for b in state.boundaries if b.name == "VMIN") for state in (strip, patch)
    )
    chosen = side.argmax(axis=0)
    near, far = _quarter(0, 0) @ inner, _quarter(1, 0) @ side
    return CellState(
        "across",
        "edge",
        strip.controls[:, chosen],
        (
            Boundary("V0", QUADRATIC_END, selection(13, range(4))),
            Boundary("V1", CUBIC_END, selection(13, range(4, 13))),
        ),
        (Child("0", QUADRATIC, near[chosen]), Child("1", ACROSS, far[chosen])),
    )


def _level_strip() -> Floats:
    """Return the controls (3, 18) of the flat strip (u, v, 0)."""
    lines = {3: (-0.5, 0.5, 1.5), 4: (-1.0, 0.0, 1.0, 2.0)}
    return np.array(
        [(u, v, 0) for u, width in zip(PARABOLA[0], WIDTHS, strict=True) for v in lines[width]]
    ).T


def _build(options: Options) -> BRep:
    return (_curve if options.cell == "junction-curve" else _strip)(options)


CELL = Builder(("junction-curve", "junction-strip"), _build, ("keep", "controls"))
