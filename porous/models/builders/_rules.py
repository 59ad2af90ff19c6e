"""How a line of control points is divided: straight, smooth as a parabola, or rough."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.models.automaton import numbers
from porous.values.value import Value

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Rule = NDArray[np.float64]


FARTHEST = 4.0
"""How far from the chord points between pieces may lie, in parts of the line's bend."""


@dataclass(frozen=True, eq=False)
class Texture(Value):
    """How rough a line of three controls a, c, b is, as parts of its bend c − (a + b)/2.

    Parameters
    ----------
    edge
        r of each of the N pieces: its own bend; one number for all; 1/N² where not given.
    bump
        h of each of the N−1 points between the pieces: how far it is off the chord; one number
        for all; 2t(1−t) at t = i/N where not given.

    Both not given, a line is a quadratic Bézier curve. A rough body is rough where it is bent:
    with every middle control midway, all textures are the same.

    Raises
    ------
    ModelError
        For what is no number or no list of numbers; for |r| ≥ 1, where the pieces do not shrink.
    """

    edge: tuple[float, ...] | float | None = None
    bump: tuple[float, ...] | float | None = None

    def __post_init__(self) -> None:
        for field in ("edge", "bump"):
            self._set(field, _values(getattr(self, field), f"texture.{field}"))
        bump = self.bump if isinstance(self.bump, tuple) else (self.bump,)
        far = [h for h in bump if h is not None and abs(h) > FARTHEST]
        if far:
            raise ModelError(
                f"texture.bump: got h = {far[0]:g}; wanted -{FARTHEST:g} … {FARTHEST:g}, in parts "
                "of the bend"
            )
        edge = self.edge if isinstance(self.edge, tuple) else (self.edge,)
        for index, r in enumerate(edge):
            if r is not None and not abs(r) < 1:
                raise ModelError(
                    f"texture.edge: got r = {r:g} for piece {index}: the word {index}, {index}, … "
                    "does not contract; wanted |r| < 1"
                )

    def rule(self, divisions: int) -> Rule:
        """Return the matrices (N, 3, 3) of a line's pieces; ``bent`` says which.

        Raises
        ------
        ModelError
            Where there are not as many numbers as pieces, or as points between them.
        """
        t = np.arange(1, divisions) / divisions
        edge = _spread(self.edge, np.full(divisions, divisions**-2.0), "edge", divisions)
        bump = _spread(self.bump, 2 * t * (1 - t), "bump", divisions)
        return bent(edge, bump)


def straight(divisions: int) -> Rule:
    """Return the matrices (N, 2, 2) of the equal pieces of a segment."""
    t = np.arange(divisions + 1) / divisions
    points = np.stack([1 - t, t])
    return np.stack([points[:, :-1], points[:, 1:]], axis=-1).transpose(1, 0, 2)


def bent(edge: NDArray[np.float64], bump: NDArray[np.float64]) -> Rule:
    """Return the matrices (N, 3, 3) of a line's N pieces, controls (a, c, b).

    The pieces end at v_0 = a, v_i = (1−i/N, 0, i/N) + h_i·δ, v_N = b, and their middle controls
    are (v_k + v_{k+1})/2 + r_k·δ, with δ = (−½, 1, −½). With h_i = 2t(1−t), t = i/N, and r = 1/N²
    these are the blossoms (1−s)(1−t), s(1−t) + t(1−s), s·t of a quadratic: Bézier's subdivision.
    The eigenvalues of a piece are 1, 1/N and r_k, in one basis for all: words contract as
    max(1/N, |r|).
    """
    divisions = len(edge)
    t = np.arange(divisions + 1) / divisions
    delta = np.array([-0.5, 1.0, -0.5])
    points = np.stack([1 - t, np.zeros_like(t), t], axis=1)
    points[1:-1] += bump[:, None] * delta
    middles = (points[:-1] + points[1:]) / 2 + edge[:, None] * delta
    return np.stack([points[:-1], middles, points[1:]], axis=2)


def _values(value: object, what: str) -> tuple[float, ...] | float | None:
    if value is None:
        return None
    given = numbers(value, what)
    if given.ndim > 1:
        raise ModelError(f"{what}: got an array of shape {given.shape}; wanted a list of numbers")
    return tuple(given.tolist()) if given.ndim else float(given)


def _spread(
    value: tuple[float, ...] | float | None,
    default: NDArray[np.float64],
    field: str,
    divisions: int,
) -> NDArray[np.float64]:
    if value is None:
        return default
    if isinstance(value, tuple) and len(value) != len(default):
        raise ModelError(
            f"texture.{field}: got {len(value)} numbers; wanted {len(default)} for divisions = "
            f"{divisions}, or a single number"
        )
    return np.broadcast_to(np.asarray(value, np.float64), default.shape)
