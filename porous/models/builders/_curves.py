"""Curves that are unions of smaller copies of themselves: Bézier, B-spline, Koch, Takagi, rough.

A curve is an automaton of *arcs*: an arc with controls P (d, m) is the union of its pieces, arcs
with controls P·T. At each end of an arc a point is left, the *end*: a state with several of the
arc's controls, its first or its last, and one piece of its own, P_e·T_e (a B-spline ends in no
control, but where its first p controls shrink to). Neighbouring pieces have their common end's
controls in common.

Polynomial arcs of degree p are known by the 2p knots around their span: control j is the blossom
f(u_j, …, u_{j+p−1}), and a piece's controls are the blossoms of the refined knots (Ramshaw 1989).
Refining cuts every span that is no point into N; the spans around a piece are alike after a few
levels, so that there are few arcs (Morlet, Gentil, Lanquetin, Neveu & Baril 2019).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.models.automaton import SUM_TOLERANCE, numbers
from porous.models.builders._rules import Texture
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Row = list[Fraction]
    Line = tuple[Fraction, ...]

HIGHEST = 8
"""The highest degree: blossoms are exact, and a cell of degree p has (p + 1)³ controls."""

UNEVEN = 10**3
"""How many times the shortest span of knots the longest may be; far beyond, linear systems fail."""


@dataclass(frozen=True, eq=False)
class Piece(Value):
    """A part of an arc: which arc it is and the weights (m, m_piece) of its controls."""

    arc: int
    matrix: NDArray[np.float64]

    def __post_init__(self) -> None:
        self._set("matrix", frozen(numbers(self.matrix, "piece"), np.float64))


@dataclass(frozen=True, eq=False)
class End(Value):
    """The state of an arc's end: what is left of its m_e first or last controls.

    Parameters
    ----------
    after
        Index of the end that its one piece is.
    matrix
        Weights (m_e, m_after) of that piece's controls.
    controls
        Where they lie along the line, about the end, (m_e,).
    """

    after: int
    matrix: NDArray[np.float64]
    controls: NDArray[np.float64]

    def __post_init__(self) -> None:
        self._set("matrix", frozen(numbers(self.matrix, "end"), np.float64))
        self._set("controls", frozen(numbers(self.controls, "end"), np.float64))

    @property
    def size(self) -> int:
        """Number of controls."""
        return len(self.controls)


@dataclass(frozen=True, eq=False)
class Arc(Value):
    """An arc: its level, ends, pieces from first to last, and where its controls lie.

    Parameters
    ----------
    level
        How often it was divided, as far as the rules differ by level.
    ends
        Indices of its ends.
    pieces
        Its parts.
    controls
        Where its controls lie along the line from 0 to 1, (m,): the arc x(t) = t.
    """

    level: int
    ends: tuple[int, int]
    pieces: tuple[Piece, ...]
    controls: NDArray[np.float64]

    def __post_init__(self) -> None:
        self._set("pieces", tuple(self.pieces))
        self._set("controls", frozen(numbers(self.controls, "arc"), np.float64))

    @property
    def size(self) -> int:
        """Number of controls."""
        return len(self.controls)


@dataclass(frozen=True, eq=False)
class Curve(Value):
    """A family of arcs and their ends; the first arc is the curve.

    Raises
    ------
    ModelError
        For weights whose columns do not sum to one, or pieces that have not in common what their
        ends say; names the arc and the piece.
    """

    arcs: tuple[Arc, ...]
    ends: tuple[End, ...]

    def __post_init__(self) -> None:
        for index, end in enumerate(self.ends):
            _check_sums(f"end {index}", end.matrix)
        for index, arc in enumerate(self.arcs):
            for number, piece in enumerate(arc.pieces):
                _check_sums(f"arc {index}: piece {number}", piece.matrix)
            self._check_joined(index)

    def _check_joined(self, index: int) -> None:
        arc = self.arcs[index]
        what = f"arc {index}"
        for side in (0, 1):
            piece = arc.pieces[-side]
            outer = self.boundary(index, side) @ self.ends[arc.ends[side]].matrix
            inner = piece.matrix @ self.boundary(piece.arc, side)
            if outer.shape != inner.shape or np.abs(outer - inner).max() > SUM_TOLERANCE:
                raise ModelError(f"{what}: its outer piece does not end where it ends itself")
        for number, (one, two) in enumerate(pairwise(arc.pieces)):
            left = one.matrix @ self.boundary(one.arc, 1)
            right = two.matrix @ self.boundary(two.arc, 0)
            if left.shape != right.shape or np.abs(left - right).max() > SUM_TOLERANCE:
                raise ModelError(
                    f"{what}: pieces {number} and {number + 1} have no end in common; wanted "
                    "the last controls of one to be the first of the other"
                )

    @property
    def matrices(self) -> Floats:
        """The matrices (N, m, m) of the first arc's pieces."""
        return np.array([piece.matrix for piece in self.arcs[0].pieces])

    def boundary(self, arc: int, side: int) -> Floats:
        """Return the weights (m, m_e) of an end's controls: the arc's first or last ones."""
        size = self.arcs[arc].size
        width = self.ends[self.arcs[arc].ends[side]].size
        chosen = np.eye(size)[:, size - width :] if side else np.eye(size)[:, :width]
        return np.asarray(chosen)

    def places(self, arc: int) -> NDArray[np.int64]:
        """Return the places (N, m) of the pieces' controls, counted along the refined line.

        Controls that neighbours have in common are at one place.
        """
        pieces = self.arcs[arc].pieces
        own = [self.arcs[piece.arc] for piece in pieces]
        steps = [each.size - self.ends[each.ends[1]].size for each in own[:-1]]
        first = np.cumsum([0, *steps])
        return np.asarray(first[:, None] + np.arange(own[0].size))


def _check_sums(what: str, matrix: Floats) -> None:
    sums = matrix.sum(axis=0)
    bad = np.flatnonzero(np.abs(sums - 1) > SUM_TOLERANCE * np.maximum(1, np.abs(matrix).sum(0)))
    if len(bad):
        raise ModelError(f"{what}: column {bad[0]} sums to {sums[bad[0]]:.9g}; wanted 1")


# --- polynomials -----------------------------------------------------------------------------


def bezier(degree: int, divisions: int | Iterable[int] = 2) -> Curve:
    """Return the Bézier curve of a degree cut into N, or into N of each level; the last repeats.

    Raises
    ------
    ModelError
        For a degree below 1 or above ``HIGHEST``, or fewer than two divisions.
    """
    degree = _whole(degree, 1, "degree")
    knots = [Fraction(0)] * degree + [Fraction(1)] * degree
    return _blossomed(tuple(knots), degree, _divisions(divisions))


def uniform(degree: int, divisions: int | Iterable[int] = 2) -> Curve:
    """Return the span of a uniform B-spline; degree 2 in halves is Chaikin's curve.

    Errors as ``bezier``.
    """
    degree = _whole(degree, 1, "degree")
    return spline(range(1 - degree, 1 + degree), divisions)


def spline(knots: Iterable[float], divisions: int | Iterable[int] = 2) -> Curve:
    """Return the span of a B-spline in the middle of its 2p knots, refined by simple knots.

    Where a knot is there p times the curve ends in a control.

    Raises
    ------
    ModelError
        For an odd number of knots, knots that decrease or are no numbers, a span of no length,
        spans of which one is more than ``UNEVEN`` times another; and as ``bezier``.
    """
    given = numbers(list(knots), "knots").tolist()
    degree = len(given) // 2
    if not given or len(given) % 2 or degree > HIGHEST or not all(map(isfinite, given)):
        raise ModelError(
            f"knots: got {given}; wanted 2p numbers, of a degree p between 1 and {HIGHEST}"
        )
    if any(a > b for a, b in pairwise(given)) or given[degree - 1] == given[degree]:
        raise ModelError(
            f"knots: got {given}; wanted none below the one before, and a middle span from "
            f"{given[degree - 1]:g} to more"
        )
    exact = [Fraction(u) for u in given]
    spans = [b - a for a, b in pairwise(exact) if a < b]
    if max(spans) > UNEVEN * min(spans):
        raise ModelError(
            f"knots: got {given}; wanted the longest span between neighbours at most {UNEVEN} "
            "times the shortest above zero"
        )
    start = _normal(exact, degree)
    return _blossomed(start, 1, _divisions(divisions))


def _whole(value: object, least: int, what: str) -> int:
    most = HIGHEST if what == "degree" else np.inf
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
        wanted = f"{least} … {HIGHEST}" if what == "degree" else f"{least} or more"
        raise ModelError(f"{what}: got {value!r}; wanted a whole number, {wanted}")
    return value


def _divisions(given: int | Iterable[int]) -> tuple[int, ...]:
    listed = (given,) if isinstance(given, int) else tuple(given)
    if not listed:
        raise ModelError("divisions: got none; wanted those of each level")
    return tuple(_whole(n, 2, "divisions") for n in listed)


class _Key(NamedTuple):
    """An arc or an end: its level and the knots around it."""

    level: int
    knots: Line


def _blossomed(start: Line, multiplicity: int, divisions: Sequence[int]) -> Curve:
    """Return the arcs that come of one; new knots are inserted ``multiplicity`` times."""
    split = _Split(len(start) // 2, multiplicity, tuple(divisions))
    keys = [_Key(0, start)]
    for key in keys:
        keys += [kid for kid in dict.fromkeys(split.kids(key)) if kid not in keys]
    outer = {split.end(key, side): (key, side) for key in keys for side in (0, 1)}
    ends = list(outer)
    arcs = tuple(
        Arc(
            key.level,
            (ends.index(split.end(key, 0)), ends.index(split.end(key, 1))),
            tuple(
                Piece(keys.index(kid), matrix)
                for kid, matrix in zip(split.kids(key), split.weights(key), strict=True)
            ),
            split.means(key.knots),
        )
        for key in keys
    )
    return Curve(arcs, tuple(_ending(split, ends, end, *outer[end]) for end in ends))


def _ending(split: _Split, ends: list[_Key], end: _Key, key: _Key, side: int) -> End:
    """Return an end as the outer piece of an arc that has it says it is."""
    controls = split.means(end.knots)
    after = split.end(split.kids(key)[-side], side)
    matrix = split.weights(key)[-side]
    width = len(controls)
    part = matrix[-width:, -width:] if side else matrix[:width, :width]
    return End(ends.index(after), part, controls)


class _Split(NamedTuple):
    """How arcs of a degree are divided: how often knots are inserted, and N of each level."""

    degree: int
    multiplicity: int
    divisions: tuple[int, ...]

    def kids(self, key: _Key) -> list[_Key]:
        """Return the pieces of an arc."""
        below = min(key.level + 1, len(self.divisions) - 1)
        return [_Key(below, _normal(window, self.degree)) for window in self.windows(key)]

    def windows(self, key: _Key) -> list[Line]:
        """Return the knots around each piece, in the arc's own parameter."""
        count = self.divisions[key.level]
        knots: Row = [key.knots[0]]
        for a, b in pairwise(key.knots):
            inner = [a + (b - a) * Fraction(i, count) for i in range(1, count)] if a < b else []
            knots += [u for u in inner for _ in range(self.multiplicity)] + [b]
        starts = [i for i, (a, b) in enumerate(pairwise(knots)) if 0 <= a < b <= 1]
        return [tuple(knots[i - self.degree + 1 : i + self.degree + 1]) for i in starts]

    def weights(self, key: _Key) -> list[Floats]:
        """Return the weights (p + 1, p + 1) of each piece's controls, correctly rounded."""
        count = self.degree + 1
        return [
            np.array(
                [
                    [float(w) for w in _blossom(key.knots, window[j : j + self.degree])]
                    for j in range(count)
                ]
            ).T
            for window in self.windows(key)
        ]

    def end(self, key: _Key, side: int) -> _Key:
        """Return an end of an arc: the knots of the controls that the point there depends on."""
        degree, knots = self.degree, key.knots
        at = Fraction(side)
        often = knots.count(at)
        if often == degree:
            return _Key(key.level, (Fraction(0),) * degree)
        chosen = knots[often:] if side else knots[: 2 * degree - often]
        gap = min(u for u in knots if u > at) - max(u for u in knots if u < at)
        return _Key(key.level, tuple((u - at) / gap for u in chosen))

    def means(self, knots: Line) -> Floats:
        """Return where the controls of knots lie along the line (Greville)."""
        windows = range(len(knots) - self.degree + 1)
        return np.array([float(sum(knots[j : j + self.degree]) / self.degree) for j in windows])


def _normal(knots: Sequence[Fraction], degree: int) -> Line:
    """Return the knots in the parameter in which the middle span is from 0 to 1."""
    start, stop = knots[degree - 1], knots[degree]
    return tuple((u - start) / (stop - start) for u in knots)


def _blossom(knots: Line, at: Line) -> Row:
    """Return the weights of f(at), de Boor's algorithm with another parameter at each step.

    Step r interpolates between f(a_1 … a_{r−1}, u_{j+r−1} …) and f(a_1 … a_{r−1}, u_{j+r} …),
    which differ in u_{j+r−1} and u_{j+p}.
    """
    degree = len(at)
    rows = [[Fraction(i == j) for i in range(degree + 1)] for j in range(degree + 1)]
    for r, a in enumerate(at, 1):
        rows = [
            _between(one, two, (a - knots[j + r - 1]) / (knots[j + degree] - knots[j + r - 1]))
            for j, (one, two) in enumerate(pairwise(rows))
        ]
    return rows[0]


def _between(one: Row, two: Row, t: Fraction) -> Row:
    return [(1 - t) * x + t * y for x, y in zip(one, two, strict=True)]


# --- curves of three controls ----------------------------------------------------------------


def koch() -> Curve:
    """Return von Koch's curve of four thirds; controls (0, 0), (½, √3/6), (1, 0) draw his own."""
    a, b, c = Fraction(1, 3), Fraction(2, 3), Fraction(1)
    columns = [
        [(c, 0, 0), (b, a, 0), (b, 0, a)],
        [(b, 0, a), (a, b, 0), (0, c, 0)],
        [(0, c, 0), (0, b, a), (a, 0, b)],
        [(a, 0, b), (0, a, b), (0, 0, c)],
    ]
    return pointed(np.array(columns, np.float64).transpose(0, 2, 1))


def takagi(w: float) -> Curve:
    """Return Takagi and Landsberg's curve; (0, 0), (½, 1), (1, 0) draw Σ wᵏ·dist(2ᵏx, ℤ).

    w = ¼ is a parabola, w = ½ Takagi's function. Raises ``ModelError`` for |w| ≥ 1.
    """
    return pointed(Texture(edge=w, bump=0.5).rule(2))


def rough(texture: Texture, divisions: int) -> Curve:
    """Return the line of three controls that a texture divides; errors as ``Texture.rule``."""
    return pointed(texture.rule(divisions))


def pointed(matrices: NDArray[np.float64]) -> Curve:
    """Return the curve of one arc (N, m, m) that begins in its first control and ends in its last.

    Raises ``ModelError`` as ``Curve``.
    """
    size = matrices.shape[1]
    arc = Arc(
        0, (0, 0), tuple(Piece(0, matrix) for matrix in matrices), np.arange(size) / (size - 1)
    )
    return Curve((arc,), (End(0, np.ones((1, 1)), np.zeros(1)),))
