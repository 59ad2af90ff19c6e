"""The boundary representation on an automaton: cells, their boundaries, and what they share.

A state of a boundary-controlled system (BC-IFS; Gentil, Gouaty & Sokolov 2021) is a kind of cell
with boundaries of every lower dimension, which are cells of their own. Its children share what
constraints say: an *incidence* puts a boundary of a child on a child of a boundary of the parent,
an *adjacency* makes a boundary of one child that of another. Constraints prescribe the topology;
what they leave of the matrices is free (``models.solve``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.models.automaton import SUM_TOLERANCE, numbers
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Order = tuple[int, ...]

SHAPES = {
    "vertex": 0,
    "edge": 1,
    "triangle": 2,
    "quad": 2,
    "tetra": 3,
    "pyramid": 3,
    "octa": 3,
    "wedge": 3,
    "hexa": 3,
}
"""Shapes of cells and their dimensions. Corners are the boundaries of dimension zero in their
order: a quad's and a hexa's lexicographic in their digits (0 and 1 per axis), an octa's in opposite
pairs, a wedge's those of its triangle, each with the one across from it, a pyramid's those of its
quad and then its apex. Pyramids are neither drawn nor meshed."""

MATCHING = 1e-9
"""How far columns of weights that are the same may differ."""


@dataclass(frozen=True, eq=False)
class Boundary(Value):
    """A boundary of a state: its state and the weights (m, m_b) of its controls in the cell's."""

    name: str
    state: int
    matrix: NDArray[np.float64]

    def __post_init__(self) -> None:
        self._set("matrix", frozen(numbers(self.matrix, f"boundary {self.name}"), np.float64))


@dataclass(frozen=True, eq=False)
class Child(Value):
    """A child of a state: its state and a guess (m, m_child) at its matrix.

    ``models.solve`` finds the nearest matrices that satisfy the constraints.
    """

    name: str
    state: int
    guess: NDArray[np.float64]

    def __post_init__(self) -> None:
        self._set("guess", frozen(numbers(self.guess, f"child {self.name}"), np.float64))


class Incidence(NamedTuple):
    """Boundary ``boundary`` of child ``child`` is child ``letter`` of the parent's ``face``.

    T_child·B_boundary = B_face·T_letter·Π with Π = I[:, order]; the identity where not given.
    """

    child: int
    boundary: int
    face: int
    letter: int
    order: Order = ()


class Adjacency(NamedTuple):
    """Boundary ``boundary`` of child ``child`` is boundary ``other_boundary`` of child ``other``.

    T_child·B_boundary = T_other·B_other_boundary·Π with Π = I[:, order].
    """

    child: int
    boundary: int
    other: int
    other_boundary: int
    order: Order = ()


@dataclass(frozen=True, eq=False)
class CellState(Value):
    """A kind of cell.

    Parameters
    ----------
    name
        What it is called.
    shape
        One of ``SHAPES``; gives its dimension.
    controls
        Reference positions of its control points, float64 (3, m).
    boundaries
        Of every lower dimension, each once: all the faces, edges and vertices.
    children
        In the order of the letters; none for a terminal state, which is drawn and never refined.
    incidences, adjacencies
        What the children share with the cell's boundaries and with each other. What follows for
        the boundaries of what is shared need not be said.
    """

    name: str
    shape: str
    controls: NDArray[np.float64]
    boundaries: tuple[Boundary, ...] = ()
    children: tuple[Child, ...] = ()
    incidences: tuple[Incidence, ...] = ()
    adjacencies: tuple[Adjacency, ...] = ()

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise ModelError(
                f"state {self.name}: got shape {self.shape!r}; wanted one of {', '.join(SHAPES)}"
            )
        self._set("controls", frozen(numbers(self.controls, f"state {self.name}"), np.float64))
        if self.controls.ndim != 2 or self.controls.shape[0] != 3 or not self.controls.size:
            raise ModelError(
                f"state {self.name}: got controls of shape {self.controls.shape}; wanted (3, m)"
            )
        for field in ("boundaries", "children", "incidences", "adjacencies"):
            self._set(field, tuple(getattr(self, field)))

    @property
    def dimension(self) -> int:
        """Zero for a vertex, three for a volume."""
        return SHAPES[self.shape]

    @property
    def size(self) -> int:
        """Number of control points."""
        return int(self.controls.shape[1])


class Use(NamedTuple):
    """Which boundary of a cell something is, and in which order it names its controls."""

    boundary: int
    order: Order


@dataclass(frozen=True, eq=False)
class BRep(Value):
    """States of cells with boundaries, and the state of the level-0 cell.

    Parameters
    ----------
    states
        Each with the boundaries of its boundaries among its own (nested consistency).
    start
        Index of the state of the level-0 cell.
    more
        The states of further level-0 cells, where these are not all of one.

    Raises
    ------
    ModelError
        For states, boundaries, children or orders that are not there, boundaries of no lower
        dimension, matrices of a wrong shape or whose columns do not sum to one, constraints
        between boundaries of different states, a boundary whose own boundary is missing; names
        the state and the constraint.
    """

    states: tuple[CellState, ...]
    start: int = 0
    more: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        self._set("states", tuple(self.states))
        self._set("more", tuple(self.more))
        for start in (self.start, *self.more):
            if not 0 <= start < len(self.states):
                raise ModelError(f"start: got state {start}; there are {len(self.states)}")
        for index, state in enumerate(self.states):
            self._check_state(state)
            self._check_constraints(index, state)
        _ = self.sub

    def _check_state(self, state: CellState) -> None:
        for part, matrix in [(b, b.matrix) for b in state.boundaries] + [
            (c, c.guess) for c in state.children
        ]:
            what = f"state {state.name}: {type(part).__name__.lower()} {part.name}"
            if not 0 <= part.state < len(self.states):
                raise ModelError(f"{what}: got state {part.state}; there are {len(self.states)}")
            other = self.states[part.state]
            if matrix.shape != (state.size, other.size):
                raise ModelError(
                    f"{what}: got a matrix of shape {matrix.shape}; wanted "
                    f"{(state.size, other.size)}, the controls of {state.name} and {other.name}"
                )
            _check_columns(what, matrix)
            limit = state.dimension - isinstance(part, Boundary)
            if other.dimension > limit:
                raise ModelError(
                    f"{what}: is a {other.shape} of dimension {other.dimension}; "
                    f"wanted at most {limit}"
                )

    def _check_constraints(self, index: int, state: CellState) -> None:
        for at in state.incidences:
            self._check_indices(index, at, (at.child, at.boundary), at.face)
            target = self.states[state.boundaries[at.face].state]
            if not 0 <= at.letter < len(target.children):
                raise ModelError(
                    f"state {state.name}: boundary {state.boundaries[at.face].name} has no child "
                    f"{at.letter}; it has {len(target.children)}"
                )
            self._check_shared(index, at, target.children[at.letter].state)
        for to in state.adjacencies:
            self._check_indices(index, to, (to.child, to.boundary), None)
            self._check_indices(index, to, (to.other, to.other_boundary), None)
            other = self.states[state.children[to.other].state]
            self._check_shared(index, to, other.boundaries[to.other_boundary].state)

    def _check_indices(
        self,
        index: int,
        constraint: Incidence | Adjacency,
        slot: tuple[int, int],
        face: int | None,
    ) -> None:
        state = self.states[index]
        good = 0 <= slot[0] < len(state.children)
        good = good and 0 <= slot[1] < len(self.states[state.children[slot[0]].state].boundaries)
        good = good and (face is None or 0 <= face < len(state.boundaries))
        if not good:
            raise ModelError(
                f"state {state.name}: {tuple(constraint)} names a child or a boundary that is "
                "not there"
            )

    def _check_shared(self, index: int, at: Incidence | Adjacency, state: int) -> None:
        child = self.states[index].children[at.child]
        mine = self.states[child.state].boundaries[at.boundary].state
        if mine != state:
            raise ModelError(
                f"{self.text(index, at)}: joins a boundary of state {self.states[mine].name} to "
                f"one of state {self.states[state].name}; wanted the same state on both sides"
            )
        wanted = range(self.states[mine].size)
        if at.order and sorted(at.order) != list(wanted):
            raise ModelError(
                f"{self.text(index, at)}: wanted an order of the {len(wanted)} controls"
            )

    def text(self, index: int, constraint: Incidence | Adjacency) -> str:
        """Return a constraint as people write it: ``cell: a.XMAX = b.XMIN``.

        An incidence reads ``cell: a.XMIN = XMIN/c``, c the child of the cell's own boundary.
        """
        state = self.states[index]
        left = self._slot(state, constraint.child, constraint.boundary)
        if isinstance(constraint, Adjacency):
            right = self._slot(state, constraint.other, constraint.other_boundary)
        else:
            face = state.boundaries[constraint.face]
            right = f"{face.name}/{self.states[face.state].children[constraint.letter].name}"
        order = f" {constraint.order}" if constraint.order else ""
        return f"{state.name}: {left} = {right}{order}"

    def _slot(self, state: CellState, child: int, boundary: int) -> str:
        part = state.children[child]
        return f"{part.name}.{self.states[part.state].boundaries[boundary].name}"

    @cached_property
    def sub(self) -> tuple[tuple[tuple[Use, ...], ...], ...]:
        """For each state, boundary k and boundary m of k: which boundary of the state that is.

        ``sub[q][k][m] = Use(e, order)`` with B_k·B_m = B_e·I[:, order].
        """
        return tuple(
            tuple(self._nested(state, boundary) for boundary in state.boundaries)
            for state in self.states
        )

    def _nested(self, state: CellState, outer: Boundary) -> tuple[Use, ...]:
        result = []
        for inner in self.states[outer.state].boundaries:
            wanted = outer.matrix @ inner.matrix
            found = find_use(wanted, self._candidates(state, inner.state))
            if found is None:
                raise ModelError(
                    f"state {state.name}: boundary {inner.name} of its boundary {outer.name} is "
                    f"no boundary of {state.name}; wanted every {self.states[inner.state].shape} "
                    "of its boundaries among its own"
                )
            result.append(found)
        return tuple(result)

    def _candidates(self, state: CellState, kind: int) -> list[tuple[int, Floats]]:
        return [(e, b.matrix) for e, b in enumerate(state.boundaries) if b.state == kind]

    def of_dimension(self, index: int, dimension: int) -> tuple[int, ...]:
        """Return the boundaries of a state that have a dimension, in their order."""
        return tuple(
            k
            for k, boundary in enumerate(self.states[index].boundaries)
            if self.states[boundary.state].dimension == dimension
        )

    @cached_property
    def by_dimension(self) -> tuple[int, ...]:
        """All states, from vertices to volumes."""
        return tuple(sorted(range(len(self.states)), key=lambda q: self.states[q].dimension))

    @cached_property
    def reached(self) -> tuple[int, ...]:
        """The states of the cells that come of the start, the start first, and of more starts."""
        found = list(dict.fromkeys((self.start, *self.more)))
        for state in found:
            found += [
                t
                for t in dict.fromkeys(c.state for c in self.states[state].children)
                if t not in found
            ]
        return tuple(found)


def selection(size: int, indices: Iterable[int]) -> Floats:
    """Return the matrix (size, n) of a boundary whose controls are ``indices`` of the cell's."""
    return np.asarray(np.eye(size)[:, list(indices)])


def find_use(wanted: Floats, candidates: Iterable[tuple[int, Floats]]) -> Use | None:
    """Return which candidate has the columns of ``wanted``, and their order, or None.

    wanted = candidate·I[:, order]; columns are compared within ``MATCHING``.
    """
    for index, matrix in candidates:
        order = column_order(wanted, matrix)
        if order is not None:
            return Use(index, order)
    return None


def column_order(wanted: Floats, matrix: Floats) -> Order | None:
    """Return the order with wanted = matrix·I[:, order], or None where the columns differ."""
    if wanted.shape != matrix.shape:
        return None
    gap = np.abs(wanted[:, :, None] - matrix[:, None, :]).max(axis=0)
    order = gap.argmin(axis=1)
    if (gap[np.arange(len(order)), order] > MATCHING).any():
        return None
    if len(set(order.tolist())) < len(order):
        return None
    return tuple(order.tolist())


def _check_columns(what: str, matrix: Floats) -> None:
    sums = matrix.sum(axis=0)
    scale = np.maximum(1.0, np.abs(matrix).sum(axis=0))
    bad = np.flatnonzero(np.abs(sums - 1) > SUM_TOLERANCE * scale)
    if len(bad):
        raise ModelError(f"{what}: column {bad[0]} sums to {sums[bad[0]]:.9g}; wanted 1")
