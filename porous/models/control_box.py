"""A certified box of everything that control points may draw, at any level.

The controls of all cells are functionals on weights. They are searched for the largest value, word
by word, between known points and the intervals that hold all weights (Hart & DeFanti 1991 do it
with balls in space), so weights may be negative.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.models.automaton import cells, count_cells, words
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

    Floats = NDArray[np.float64]

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

FEW_LEVELS = 12
"""Levels that are looked through for the first weight that is not above zero."""

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
        States of any number of controls; matrices may be negative. The level-0 cells' controls are
        in the world.
    tolerance
        How much too far out each face may lie, in the unit of the controls. Where textures shrink
        so slowly that more than ``MOST_ROWS`` words stay open the box is looser, but holds all.
    drawn
        Which controls of a state are drawn; all of them where a state is not named.

    Raises
    ------
    ModelError
        For a tolerance that is not positive, where no bounds on the weights were found, or where
        weights of rational controls fall to zero.
    """
    if not tolerance > 0:
        raise ModelError(f"box of control points: got tolerance {tolerance}; wanted more than 0")
    part, drawings = endless(automaton, drawn or {})
    placed = [(group.state, points) for group in automaton.level_zero for points in group.points]
    shown = np.hstack([positions(points @ drawings[q]) for q, points in placed])
    open_ = [(part.states.index(q), points) for q, points in placed if q in part.states]
    if not open_ and not shown.size:
        raise ModelError("box of control points: nothing is drawn and every path ends")
    reached = np.vstack([shown, -shown]).max(axis=1, initial=-np.inf)
    if open_:
        weights = weights_of(part)
        search = _Search(automaton, weights, intervals(weights), [q for q, _ in open_])
        reached = _reach(search, [points for _, points in open_], reached, tolerance)
    return Box(tuple((-reached[3:]).tolist()), tuple(reached[:3].tolist()))


class _Search:
    """A search for the largest values of forms, which narrows its intervals where it has to.

    Forms are given for each level-0 cell with endless paths, (k, m), on its state's weights.
    """

    def __init__(
        self, automaton: Automaton, weights: Weights, held: Intervals, states: list[int]
    ) -> None:
        self.automaton, self.weights, self.held, self.states = automaton, weights, held, states
        self.rounds = ROUNDS

    def largest(self, forms: list[Floats], tolerance: float) -> tuple[Floats, Floats]:
        """Return what each of k forms reaches in some cell, and certain bounds on it, (k,)."""
        asked = self._asked(forms)
        best, upper = _largest(self.weights, self.held, asked, tolerance, MOST_ROWS)
        while self.rounds and (upper > best + tolerance).any():
            self.rounds -= 1
            self.held = narrowed(self.weights, self.held)
            again = _largest(self.weights, self.held, asked, tolerance, MOST_ROWS)
            best, upper = np.maximum(best, again[0]), np.minimum(upper, again[1])
        size = max(float(np.abs(own).max()) for own in forms)
        return best, upper + 1e-12 * size * (1 + 2 * float(self.held.negative.max()))

    def _asked(self, forms: list[Floats]) -> _Rows:
        rows, offsets = [], []
        for q, own in zip(self.states, forms, strict=True):
            z = own[:, :-1] - own[:, -1:]
            width = z.shape[1]
            rows.append(z @ self.weights.bases[q][:width])
            offsets.append(z @ self.weights.centres[q][:width] + own[:, -1])
        many = len(forms[0])
        asked = _roots(np.repeat(self.states, many), np.vstack(rows), np.concatenate(offsets))
        return asked._replace(roots=asked.roots % many)


def _reach(search: _Search, controls: list[Floats], reached: Floats, tolerance: float) -> Floats:
    """Return bounds (6,) on x, y, z, −x, −y, −z of all that cells with such controls draw.

    Of controls with weights f / w ≤ u wherever f − u·w ≤ 0 and w > 0: u grows from what is
    ``reached`` to what else there is (Dinkelbach 1967).
    """
    forms = [np.vstack([points[:3], -points[:3]]) for points in controls]
    if not is_rational(controls[0]):
        return np.maximum(search.largest(forms, tolerance)[1], reached)
    weights = [points[3] for points in controls]
    least, most = _weights(search, weights)
    own = np.hstack([positions(points) for points in controls])
    u = np.maximum(reached, np.vstack([own, -own]).min(axis=1))
    for _ in range(MOST_STEPS):
        over = [f - u[:, None] * w for f, w in zip(forms, weights, strict=True)]
        best, upper = search.largest(over, tolerance * least / 2)
        if (best <= tolerance * least / 2).all():
            break
        u = u + np.maximum(best, 0) / most
    return np.asarray(u + np.maximum(upper, 0) / least)


def _weights(search: _Search, weights: list[Floats]) -> tuple[float, float]:
    """Return bounds, above zero, on the weights of all that is drawn and of the limit."""
    least = min(float(own.min()) for own in weights)
    best, upper = search.largest([np.stack([-own, own]) for own in weights], WEIGHT * least)
    if not upper[0] < 0:
        got = f"fall to {-best[0]:.6g}" if best[0] >= 0 else "may fall to zero"
        raise ModelError(
            f"controls: the weights of smaller cells {got}{_first(search.automaton)}; wanted "
            "weights above zero everywhere: weights closer to each other, or less texture"
        )
    return float(-upper[0]), float(upper[1])


def _first(automaton: Automaton) -> str:
    """Return what the first weight of a control is, of few cells, that is not above zero."""
    for level in range(1, FEW_LEVELS):
        if count_cells(automaton, level) > MOST_ROWS:
            break
        for group in cells(automaton, level):
            lowest = group.points[:, 3].min(axis=1)
            if lowest.min() <= 0:
                first = int(lowest.argmin())
                word = ".".join(map(str, words(automaton, level)[group.place[first]]))
                return f", to {lowest[first]:.6g} at a control of cell {word} (children by number)"
    return ""


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
    best, settled = np.full((2, 1 + int(asked.roots.max())), -np.inf)
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
