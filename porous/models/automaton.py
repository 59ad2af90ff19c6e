"""The automaton that every fractal here descends: states, transitions and the cells they make.

Columns of a matrix are weights: column j says how a child's j-th control point is mixed from its
parent's. Control points are all that is transformed; the descent multiplies them from the right.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.memory import check_memory
from porous.models.rational import ROWS, is_rational, scaled
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

SUM_TOLERANCE = 1e-9
"""How far a column's sum may be from one, relative to the column's sum of absolute weights."""

DEEPEST = 1024
"""The deepest level that is ever tried."""

FLATNESS = 1e-12
"""Four controls that are thinner than this part of their size span no space."""


COINCIDENT = 1e-9
"""Control points closer than this part of their extent are one."""


@dataclass(frozen=True, eq=False)
class State(Value):
    """A kind of cell: its name and its reference control points, float64 (3, m).

    With weights (4, m), homogeneous: see ``models.rational``.
    """

    name: str
    controls: NDArray[np.float64]

    def __post_init__(self) -> None:
        self._set("controls", frozen(numbers(self.controls, f"state {self.name!r}"), np.float64))
        if self.controls.ndim != 2 or len(self.controls) not in ROWS or not self.controls.size:
            raise ModelError(
                f"state {self.name!r}: got controls of shape {self.controls.shape}; wanted (3, m), "
                "or (4, m) with weights"
            )

    @property
    def size(self) -> int:
        """Number of control points."""
        return int(self.controls.shape[1])

    @cached_property
    def inverse(self) -> NDArray[np.float64] | None:
        """Weights of a point's homogeneous coordinates (4, 4), or None where none are unique."""
        if self.size != 4 or is_rational(self.controls):
            return None
        lifted = np.vstack([self.controls, np.ones(4)])
        size = max(float(np.ptp(self.controls, axis=1).max()), 1e-300)
        centred = (self.controls - self.controls.mean(axis=1, keepdims=True)) / size
        if np.linalg.svd(centred, compute_uv=False)[-1] < FLATNESS:
            return None
        return np.asarray(np.linalg.inv(lifted))

    @cached_property
    def local_inverse(self) -> NDArray[np.float64]:
        """``inverse`` with the first control as the origin: keeps digits that it loses far away."""
        return np.linalg.inv(np.vstack([self.controls - self.controls[:, :1], np.ones(4)]))

    def _content(self) -> tuple[object, ...]:
        return self.name, self.controls


@dataclass(frozen=True, eq=False)
class Transition(Value):
    """A child of a state: indices of both states and the matrix (m_source, m_target)."""

    source: int
    target: int
    matrix: NDArray[np.float64]

    def __post_init__(self) -> None:
        self._set("matrix", frozen(numbers(self.matrix, "transition"), np.float64))


@dataclass(frozen=True, eq=False)
class Automaton(Value):
    """States and the transitions between them; cells of a level are the paths of that length.

    A state without transitions is terminal: its cells are carried through unchanged.

    Parameters
    ----------
    states
        At least one; each with its own number of control points.
    transitions
        In the order of the letters: a word is the sequence of indices among those of its state.
    start
        Index of the state of the level-0 cell, which lies where its reference controls lie.
    roots
        The level-0 cells, where there are several: by state, each state once.

    Raises
    ------
    ModelError
        For matrices of a wrong shape, NaN, columns that do not sum to one (see
        ``SUM_TOLERANCE``), states that are absent or cannot be reached.
    """

    states: tuple[State, ...]
    transitions: tuple[Transition, ...]
    start: int = 0
    roots: tuple[Cells, ...] = ()

    def __post_init__(self) -> None:
        self._set("states", tuple(self.states))
        self._set("transitions", tuple(self.transitions))
        self._set("roots", tuple(_frozen_cells(group) for group in self.roots))
        if not self.states or not self.transitions:
            raise ModelError("automaton: wanted at least one state and one transition")
        if not 0 <= self.start < len(self.states):
            raise ModelError(f"automaton: start is {self.start}; there are {len(self.states)}")
        for index, transition in enumerate(self.transitions):
            self._check(index, transition)
        self._check_reached()

    def _check(self, index: int, transition: Transition) -> None:
        for end in (transition.source, transition.target):
            if not 0 <= end < len(self.states):
                raise ModelError(
                    f"transition {index}: names state {end}; there are {len(self.states)}"
                )
        wanted = self.states[transition.source].size, self.states[transition.target].size
        if transition.matrix.shape != wanted:
            raise ModelError(
                f"transition {index}: got a matrix of shape {transition.matrix.shape}; "
                f"wanted {wanted}, the controls of its two states"
            )
        sums = transition.matrix.sum(axis=0)
        scale = np.maximum(1.0, np.abs(transition.matrix).sum(axis=0))
        if (np.abs(sums - 1) > SUM_TOLERANCE * scale).any():
            bad = int(np.argmax(np.abs(sums - 1) / scale))
            raise ModelError(
                f"transition {index}: column {bad} sums to {sums[bad]:.9g}; "
                f"wanted 1 (within {SUM_TOLERANCE:g})"
            )

    def _check_reached(self) -> None:
        starts = {self.start, *(group.state for group in self.roots)}
        found = set().union(*(reachable(self, start) for start in starts))
        missing = set(range(len(self.states))) - found
        if missing:
            state = min(missing)
            raise ModelError(
                f"state {state} ({self.states[state].name!r}) is never reached from the start"
            )

    @cached_property
    def children(self) -> tuple[tuple[Transition, ...], ...]:
        """The transitions of each state, in their order: its alphabet."""
        return tuple(
            tuple(t for t in self.transitions if t.source == state)
            for state in range(len(self.states))
        )

    @property
    def level_zero(self) -> tuple[Cells, ...]:
        """The level-0 cells, by state."""
        start = self.states[self.start].controls[None]
        return self.roots or (Cells(self.start, start, np.zeros(1, np.int64)),)

    @property
    def spatial(self) -> bool:
        """Whether every state has four independent controls: its transitions map space."""
        return all(state.inverse is not None for state in self.states)

    @cached_property
    def maps(self) -> NDArray[np.float64]:
        """Each transition as an affine map of its target's space to its source's, (t, 3, 4).

        Raises ``ModelError`` where a state has no four independent controls.
        """
        return np.stack([self._map(t) for t in self.transitions])

    def _map(self, transition: Transition) -> NDArray[np.float64]:
        source, target = self.states[transition.source], self.states[transition.target]
        if target.inverse is None:
            raise ModelError(
                f"state {target.name!r} has no four independent controls: its cells are no affine "
                "images of space"
            )
        # From first control to first control: matrices far from the origin keep their digits.
        images = product(source.controls - source.controls[:, :1], transition.matrix)
        result = product(images, target.local_inverse)
        shift = source.controls[:, :1] - product(result[:, :3], target.controls[:, :1])
        result[:, 3] += shift[:, 0]
        return result

    def scaled(self, factor: float) -> Automaton:
        """Return the same automaton with its controls ``factor`` times as far from the origin."""
        states = tuple(State(state.name, scaled(state.controls, factor)) for state in self.states)
        roots = tuple(group._replace(points=scaled(group.points, factor)) for group in self.roots)
        return Automaton(states, self.transitions, self.start, roots)

    def _content(self) -> tuple[object, ...]:
        return self.states, self.transitions, self.start, self.roots


class Cells(NamedTuple):
    """Cells of one state: their controls (k, 3 or 4, m) and places among all cells (k,)."""

    state: int
    points: NDArray[np.float64]
    place: NDArray[np.int64]


def of_maps(maps: Iterable[tuple[ArrayLike, ArrayLike]], *, size: float = 1.0) -> Automaton:
    """Return the one-state automaton of affine maps x ↦ A·x + b of space: T = V⁻¹·F·V.

    Parameters
    ----------
    maps
        Pairs of a matrix (3, 3) and a translation (3,).
    size
        How far from the origin the other three controls lie, along the axes: a power of two.
        Translations much longer than that cost digits of the matrices.

    Raises
    ------
    ModelError
        For no maps, a wrong shape or numbers that are not finite; names the map's index.
    """
    pairs = [checked_map(index, *pair) for index, pair in enumerate(maps)]
    if not pairs:
        raise ModelError("maps: got none; wanted at least one")
    # The controls are the origin and the ends of the three axes: V is exact, and so is T
    # wherever the maps are dyadic.
    state = State("cell", np.hstack([np.zeros((3, 1)), np.eye(3) * size]))
    transitions = [Transition(0, 0, _weights(matrix, shift / size)) for matrix, shift in pairs]
    return Automaton((state,), tuple(transitions))


def checked_map(
    index: int, matrix: ArrayLike, translation: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a map's matrix and translation as arrays, or raise ``ModelError`` with its index."""
    A = numbers(matrix, f"maps[{index}].matrix")
    b = numbers(translation, f"maps[{index}].translation")
    if A.shape != (3, 3) or b.shape != (3,):
        raise ModelError(
            f"maps[{index}]: got a matrix of shape {A.shape} and a translation of shape "
            f"{b.shape}; wanted (3, 3) and (3,)"
        )
    return A, b


def numbers(array: Any, what: str) -> NDArray[np.float64]:
    """Return finite float64 numbers, or raise ``ModelError`` naming ``what``."""
    try:
        result = np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError):
        raise ModelError(f"{what}: wanted numbers, got {array!r:.200}") from None
    if not np.isfinite(result).all():
        raise ModelError(f"{what}: got {result.tolist()!r:.200}; wanted finite numbers")
    return result


def check_apart(controls: NDArray[np.float64], what: str) -> None:
    """Raise ``ModelError`` naming ``what`` where two of the controls (3, m) are one point."""
    size = float(np.ptp(controls, axis=1).max())
    gaps = np.abs(controls[:, :, None] - controls[:, None]).max(axis=0)
    pairs = np.argwhere(np.triu(gaps <= COINCIDENT * size, 1))
    if len(pairs):
        i, j = pairs[0]
        raise ModelError(
            f"{what}: {i} and {j} coincide at {tuple(controls[:, i].tolist())}; "
            "wanted points apart from each other"
        )


def product(points: NDArray[np.float64], matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``points @ matrix``, (…, m) by (m, k), summed in one order whatever the shapes.

    A cell's coordinates are then the same floating-point numbers whoever computes them, with
    however many others: renamed states give the same voxels, and so do tiles.
    """
    result = points[..., 0, None] * matrix[0]
    for row in range(1, len(matrix)):
        result += points[..., row, None] * matrix[row]
    return np.asarray(result)


def count_cells(automaton: Automaton, level: int, above: Sequence[Cells] | None = None) -> int:
    """Return the exact number of words of cells ``level`` levels below the start or ``above``."""
    counts = [0] * len(automaton.states)
    for group in above or automaton.level_zero:
        counts[group.state] = len(group.place)
    for _ in range(level):
        counts = _counts_below(automaton, counts)
    return sum(counts)


def cells(automaton: Automaton, level: int) -> tuple[Cells, ...]:
    """Return the level-``level`` cells by state; ``place`` numbers all in lexicographic order.

    Raises
    ------
    ModelError
        For a negative level.
    MemoryLimitError
        Before anything is allocated; names the number of cells.
    """
    if level < 0:
        raise ModelError(f"level: got {level}; wanted 0 or more")
    check_cells(automaton, count_cells(automaton, level), f"level {level}")
    groups = automaton.level_zero
    for _ in range(level):
        groups = refined(automaton, groups)
    return groups


def expand(automaton: Automaton, level: int) -> tuple[tuple[int, NDArray[np.float64]], ...]:
    """Return the control points (k, 3 or 4, m) of the level-``level`` cells, by state.

    Raises as ``cells`` does.
    """
    return tuple((group.state, group.points) for group in cells(automaton, level))


def refined(
    automaton: Automaton,
    groups: Sequence[Cells],
    which: Mapping[int, NDArray[np.bool_]] | None = None,
) -> tuple[Cells, ...]:
    """Return the children of cells, in lexicographic order; terminal cells stay.

    ``which`` tells for each state which of its cells are refined; all where not given.
    """
    masks = which or {group.state: np.ones(len(group.place), bool) for group in groups}
    fan = np.empty(sum(len(group.place) for group in groups), np.int64)
    for group in groups:
        many = max(1, len(automaton.children[group.state]))
        fan[group.place] = np.where(masks[group.state], many, 1)
    first = np.cumsum(fan) - fan
    born: dict[int, list[Cells]] = {}
    for group in groups:
        for child in _offspring(automaton, group, masks[group.state], first):
            born.setdefault(child.state, []).append(child)
    return tuple(_merged(state, born[state]) for state in sorted(born))


def frames(automaton: Automaton, groups: Sequence[Cells]) -> NDArray[np.float64]:
    """Return the affine map (k, 3, 4) of each cell, in the order of the places.

    A frame takes the reference coordinates of the cell's state to the world.

    Raises
    ------
    ModelError
        Where a state has no four independent controls.
    """
    result = np.empty((sum(len(group.place) for group in groups), 3, 4))
    for group in groups:
        state = automaton.states[group.state]
        if state.inverse is None:
            raise ModelError(f"state {state.name!r} has no four independent controls: no frames")
        result[group.place] = product(group.points, state.inverse)
    return result


def words(automaton: Automaton, level: int) -> NDArray[np.int64]:
    """Return the addresses (k, level) of the cells in the order of their places.

    A letter is the index of a transition among those of its state; −1 after a terminal state.
    """
    check_cells(automaton, count_cells(automaton, level) * (1 + level // 12), f"level {level}")
    states = np.empty(count_cells(automaton, 0), np.int64)
    for group in automaton.level_zero:
        states[group.place] = group.state
    result = np.empty((len(states), 0), np.int64)
    fans = np.array([max(1, len(c)) for c in automaton.children])
    for _ in range(level):
        fan = fans[states]
        parent = np.repeat(np.arange(len(states)), fan)
        letter = np.arange(len(parent)) - np.repeat(np.cumsum(fan) - fan, fan)
        targets = [[t.target for t in c] or [q] for q, c in enumerate(automaton.children)]
        letter_or_none = [-1 if not c else 0 for c in automaton.children]
        old = states[parent]
        states = np.array([targets[q][i] for q, i in zip(old, letter, strict=True)])
        shown = letter + np.array(letter_or_none)[old]
        result = np.hstack([result[parent], shown[:, None]])
    return result


def reachable(automaton: Automaton, state: int) -> set[int]:
    """Return the states that can be reached from ``state``, itself included."""
    found, front = {state}, {state}
    while front:
        front = {t.target for t in automaton.transitions if t.source in front} - found
        found |= front
    return found


def check_cells(automaton: Automaton, amount: int, what: str) -> None:
    """Raise ``MemoryLimitError`` where ``amount`` cells are more than memory holds."""
    rows = len(automaton.states[automaton.start].controls)
    controls = max(state.size for state in automaton.states)
    # Controls of children and parents, the frames made of them and a temporary of that size.
    check_memory(
        amount * (rows * controls * 8 * 2 + 12 * 8 + 16),
        f"{what} ({amount} cells)",
        "Choose a lower level or a larger cell size.",
    )


def _counts_below(automaton: Automaton, counts: list[int]) -> list[int]:
    result = [0] * len(counts)
    for state, children in enumerate(automaton.children):
        for target in [t.target for t in children] or [state]:
            result[target] += counts[state]
    return result


def _weights(A: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    images = np.hstack([b[:, None], b[:, None] + A])
    return np.vstack([1 - images.sum(axis=0), images])


def _frozen_cells(group: Cells) -> Cells:
    points, place = frozen(group.points, np.float64), frozen(group.place, np.int64)
    return Cells(group.state, points, place)


def _offspring(
    automaton: Automaton, group: Cells, mask: NDArray[np.bool_], first: NDArray[np.int64]
) -> list[Cells]:
    children = automaton.children[group.state]
    if not children or not mask.any():
        return [Cells(group.state, group.points, first[group.place])]
    kept = Cells(group.state, group.points[~mask], first[group.place[~mask]])
    place = first[group.place[mask]]
    result = [kept] if len(kept.place) else []
    for target in sorted({t.target for t in children}):
        letters = [i for i, t in enumerate(children) if t.target == target]
        shape = group.points.shape[1], automaton.states[target].size
        points = np.empty((len(place), len(letters), *shape))
        for j, letter in enumerate(letters):
            points[:, j] = product(group.points[mask], children[letter].matrix)
        places = (place[:, None] + np.array(letters)).reshape(-1)
        result.append(Cells(target, points.reshape(-1, *points.shape[2:]), places))
    return result


def _merged(state: int, parts: list[Cells]) -> Cells:
    if len(parts) == 1:
        return parts[0]
    place = np.concatenate([part.place for part in parts])
    order = np.argsort(place, kind="stable")
    return Cells(state, np.concatenate([part.points for part in parts])[order], place[order])
