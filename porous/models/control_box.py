"""A certified box of everything that control points may draw, at any level.

The controls of all cells are functionals on weights. They are searched for the largest value, word
by word, between known points and the intervals that hold all weights (Hart & DeFanti 1991 do it
with balls in space), so weights may be negative.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.models.rational import is_rational, positions
from porous.models.weight_intervals import (
    Intervals,
    endless,
    group_sizes,
    intervals,
    negatives,
    weights_of,
)
from porous.values import Box

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from porous.models.automaton import Automaton
    from porous.models.weight_intervals import Weights

MOST_ROWS = 40_000
"""How many functionals a search may form."""

BATCH = 1_000
"""How many words are made longer at once."""

FEW_ROWS = 500
"""How many of them, for each interval, when intervals are narrowed."""

MOST_STEPS = 20
"""Steps of the search for the largest quotient, after which a bound is looser."""

WEIGHT = 0.01
"""Bounds on weights may be off by this part of the least one given."""

ROUNDS = 4
"""How often intervals are narrowed before the box is left looser."""


class _Rows(NamedTuple):
    """Functionals row·y + offset on the sets of states, one for each word, and their bounds.

    ``roots`` tells which of the functionals that were asked for they descend from.
    """

    roots: NDArray[np.int64]
    states: NDArray[np.int64]
    rows: NDArray[np.float64]
    offsets: NDArray[np.float64]
    bounds: NDArray[np.float64]

    def where(self, mask: NDArray[np.bool_]) -> _Rows:
        """Return the functionals that are marked."""
        chosen: Any = (field[mask] for field in self)
        return _Rows(*chosen)


def control_box(
    automaton: Automaton,
    *,
    tolerance: float,
    drawn: Mapping[int, Sequence[int] | None] | None = None,
) -> Box:
    """Return a box of the drawn control points of all cells at all levels, and of the limit.

    Parameters
    ----------
    automaton
        States of any number of controls; weights may be negative. The start state's controls are
        in the world.
    tolerance
        How much too far out each face may lie, in the unit of the controls. Where textures shrink
        so slowly that more than ``MOST_ROWS`` words stay open the box is looser, but holds all.
    drawn
        Which controls of a state are drawn; all of them where a state is not named.

    Raises
    ------
    ModelError
        For a tolerance that is not positive, or where no bounds on the weights were found.
    """
    if not tolerance > 0:
        raise ModelError(f"box of control points: got tolerance {tolerance}; wanted more than 0")
    controls = automaton.states[automaton.start].controls
    part, points = endless(automaton, drawn or {})
    if automaton.start not in part.states:
        if not points.shape[1]:
            raise ModelError("box of control points: nothing is drawn and every path ends")
        return Box.of_points(positions(controls @ points).T)
    weights = weights_of(part)
    search = _Search(weights, intervals(weights), part.states.index(automaton.start))
    forms = np.vstack([controls[:3], -controls[:3]])
    if is_rational(controls):
        upper = _quotients(search, forms, controls[3], points, tolerance)
    else:
        upper = search.largest(forms, tolerance)[1]
    return Box(tuple((-upper[3:]).tolist()), tuple(upper[:3].tolist()))


class _Search:
    """A search for the largest values of forms, which narrows its intervals where it has to."""

    def __init__(self, weights: Weights, held: Intervals, start: int) -> None:
        self.weights, self.held, self.start = weights, held, start
        self.rounds = ROUNDS

    def largest(
        self, forms: NDArray[np.float64], tolerance: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return what forms (k, m) of the start's weights reach, and certain bounds on it, (k,)."""
        asked = self._asked(forms)
        best, upper = _largest(self.weights, self.held, asked, tolerance, MOST_ROWS)
        while self.rounds and (upper > best + tolerance).any():
            self.rounds -= 1
            self.held = narrowed(self.weights, self.held)
            again = _largest(self.weights, self.held, asked, tolerance, MOST_ROWS)
            best, upper = np.maximum(best, again[0]), np.minimum(upper, again[1])
        slack = 1e-12 * float(np.abs(forms).max()) * (1 + 2 * float(self.held.negative.max()))
        return best, upper + slack

    def _asked(self, forms: NDArray[np.float64]) -> _Rows:
        z = forms[:, :-1] - forms[:, -1:]
        width = z.shape[1]
        rows = z @ self.weights.bases[self.start][:width]
        offsets = z @ self.weights.centres[self.start][:width] + forms[:, -1]
        return _roots(np.full(len(forms), self.start), rows, offsets)


def _quotients(
    search: _Search,
    forms: NDArray[np.float64],
    weight: NDArray[np.float64],
    points: NDArray[np.float64],
    tolerance: float,
) -> NDArray[np.float64]:
    """Return bounds (k,) on forms (k, m) divided by the weight (m,) of the same point.

    f / w ≤ u wherever f − u·w ≤ 0 and w > 0; u grows from what ``points`` (m, p) reach to what
    others do (Dinkelbach 1967).
    """
    least, most = _weights(search, weight)
    known = points if points.shape[1] else np.eye(len(weight))
    u = ((forms @ known) / (weight @ known)).max(axis=1)
    for _ in range(MOST_STEPS):
        best, over = search.largest(forms - u[:, None] * weight, tolerance * least / 2)
        if (best <= tolerance * least / 2).all():
            break
        u = u + np.maximum(best, 0) / most
    return np.asarray(u + np.maximum(over, 0) / least)


def _weights(search: _Search, weight: NDArray[np.float64]) -> tuple[float, float]:
    """Return bounds, above zero, on the weights of all that is drawn and of the limit."""
    reached, bounds = search.largest(np.stack([-weight, weight]), WEIGHT * float(weight.min()))
    if not bounds[0] < 0:
        got = f"fall to {-reached[0]:.6g}" if reached[0] >= 0 else "could not be bounded above zero"
        raise ModelError(
            f"controls: the weights of smaller cells {got}; wanted weights above zero everywhere: "
            "weights closer to each other, or less texture"
        )
    return float(-bounds[0]), float(bounds[1])


def _roots(
    states: NDArray[np.int64], rows: NDArray[np.float64], offsets: NDArray[np.float64]
) -> _Rows:
    return _Rows(np.arange(len(states)), states, rows, offsets, np.full(len(states), np.inf))


def narrowed(weights: Weights, held: Intervals) -> Intervals:
    """Return narrower intervals: coordinates and weights are searched as functionals themselves.

    Parameters
    ----------
    weights
        The maps of weights.
    held
        Intervals that hold all weights of what is drawn and of the limit.
    """
    count, n = held.lower.shape
    states, unit = np.repeat(np.arange(count), n), np.tile(np.eye(n), (count, 1))
    nothing = np.zeros(len(states))
    few = FEW_ROWS * len(states)
    upper = _largest(weights, held, _roots(states, unit, nothing), 0.0, few)[1]
    lower = -_largest(weights, held, _roots(states, -unit, nothing), 0.0, few)[1]
    size = 1e-12 * np.maximum(np.abs(held.lower), np.abs(held.upper))
    lower = np.maximum(held.lower, lower.reshape(count, n) - size)
    upper = np.minimum(held.upper, upper.reshape(count, n) + size)
    negative = np.minimum(held.negative, negatives(weights, lower, upper))
    held = held._replace(lower=lower, upper=upper, negative=negative)
    return held._replace(negative=_searched_negatives(weights, held))


def _searched_negatives(weights: Weights, held: Intervals) -> NDArray[np.float64]:
    """Return the sum of how negative each weight may become, (s,)."""
    if not held.negative.any():
        return held.negative
    states = np.repeat(np.arange(len(weights.widths)), weights.widths + 1)
    rows, offsets = [], []
    for q, width in enumerate(weights.widths):
        last = -weights.bases[q][:width].sum(axis=0)
        rows.append(np.vstack([weights.bases[q][:width], last]))
        centre = weights.centres[q][:width]
        offsets.append(np.append(centre, 1 - centre.sum()))
    asked = _roots(states, -np.vstack(rows), -np.concatenate(offsets))
    found = _largest(weights, held, asked, 0.0, FEW_ROWS * len(states))[1]
    total = np.zeros(len(weights.widths))
    np.add.at(total, states, np.maximum(found + 1e-12 * (1 + np.abs(found)), 0))
    return np.minimum(held.negative, total)


# --- search --------------------------------------------------------------------------------


def _largest(
    weights: Weights, held: Intervals, asked: _Rows, tolerance: float, limit: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what functionals reach on their states' sets, and bounds on it.

    Words whose bound is no further than ``tolerance`` beyond a known value are settled, the others
    made longer, the furthest ones first, until ``limit`` functionals have been formed.
    """
    rows, formed = _bounded(weights, held, asked), 0
    best, settled = np.full((2, len(asked.roots)), -np.inf)
    front = rows
    while True:
        np.maximum.at(best, front.roots, _reached(weights, front))
        rows = _joined(rows, front) if formed else front
        done = rows.bounds <= best[rows.roots] + tolerance
        np.maximum.at(settled, rows.roots[done], rows.bounds[done])
        rows = rows.where(~done)
        if not len(rows.states) or formed > limit:
            break
        chosen = _worst(rows, best, BATCH)
        front = _bounded(weights, held, _deeper(weights, rows.where(chosen)))
        rows = rows.where(~chosen)
        formed += len(front.states)
    upper = np.maximum(best, settled)
    np.maximum.at(upper, rows.roots, rows.bounds)
    return best, upper


def _joined(one: _Rows, other: _Rows) -> _Rows:
    return _Rows(*(np.concatenate(fields) for fields in zip(one, other, strict=True)))


def _worst(rows: _Rows, best: NDArray[np.float64], many: int) -> NDArray[np.bool_]:
    """Mark the rows whose bounds are furthest from what is reached."""
    if len(rows.states) <= many:
        return np.ones(len(rows.states), bool)
    gaps = rows.bounds - best[rows.roots]
    return np.asarray(gaps >= np.partition(gaps, -many)[-many])


def _reached(weights: Weights, rows: _Rows) -> NDArray[np.float64]:
    """Return the largest value at known points, −∞ where there are none."""
    result = np.full(len(rows.states), -np.inf)
    for q in np.unique(rows.states):
        mine = rows.states == q
        known = np.vstack([weights.drawn[q], weights.points[q]])
        if len(known):
            result[mine] = (rows.rows[mine] @ known.T).max(axis=1) + rows.offsets[mine]
    return result


def _deeper(weights: Weights, rows: _Rows) -> _Rows:
    """Return the functionals of the words one letter longer."""
    system, parts = weights.system, []
    for q, r, B, shift in zip(
        system.sources, system.targets, system.matrices, weights.shifts, strict=True
    ):
        mine = rows.where(rows.states == q)
        states = np.full(len(mine.states), r)
        offsets = mine.offsets + mine.rows @ shift
        parts.append(_Rows(mine.roots, states, mine.rows @ B, offsets, mine.bounds))
    return _Rows(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))


def _bounded(weights: Weights, held: Intervals, rows: _Rows) -> _Rows:
    """Bound functionals by the intervals and by the hull of the controls, and its overhang."""
    middle, half = (held.upper + held.lower) / 2, (held.upper - held.lower) / 2
    bounds = rows.bounds.copy()
    for q in np.unique(rows.states):
        mine = rows.states == q
        part = rows.rows[mine]
        known = np.minimum(
            bounds[mine], part @ middle[q] + np.abs(part) @ half[q] + rows.offsets[mine]
        )
        if held.balls is not None:
            sizes = group_sizes(part, weights.groups[[q] * len(part)])
            # A state may have fewer groups of coordinates than the one with most.
            reach = sizes @ held.balls[q][: sizes.shape[1]]
            known = np.minimum(known, reach + rows.offsets[mine])
        values = part @ weights.controls[q].T
        top = values.max(axis=1)
        hull = top + held.negative[q] * (top - values.min(axis=1)) + rows.offsets[mine]
        bounds[mine] = np.minimum(known, hull)
    return rows._replace(bounds=bounds)
