"""States put together by their weights: constraints are found where controls of children are one.

Two controls of children are one point where they have the same weights. So whoever gives matrices
that fit has given the constraints too; they are those of ``_joins``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.errors import ModelError, nearest
from porous.models.brep import MATCHING, BRep
from porous.models.builders._joins import Covered, Part, Placed, joins

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from porous.models.brep import CellState

    Floats = NDArray[np.float64]
    Names = tuple[str, ...]


def assembled(
    states: Sequence[CellState], keep: Mapping[str, Names] | None = None, start: int = 0
) -> BRep:
    """Return states with the constraints that their matrices satisfy, cells thinned out first.

    Parameters
    ----------
    states
        Boundaries are selections of controls; constraints that are there already are dropped.
    keep
        Names of the children kept, by state; all where a state is not there. States that are
        boundaries keep all.
    start
        Index of the state of the level-0 cell.

    Raises
    ------
    ModelError
        For states of ``keep`` that are not there or are boundaries, or children that are not.
    """
    full = BRep(tuple(states), start)
    given = dict(keep or {})
    known = [full.states[q].name for q in full.reached]
    for name in given:
        if name not in known:
            raise ModelError(f"keep: got children of {name!r}{nearest(name, known)}")
    thin = tuple(_kept(state, given.get(state.name)) for state in full.states)
    return BRep(tuple(_joined(thin, state) for state in thin), start)


def called(states: Sequence[CellState], names: Mapping[int, tuple[int, str]]) -> list[CellState]:
    """Return some states by the numbers and names that they have among others.

    Parameters
    ----------
    states
        Of another system.
    names
        For the index of each state that is wanted its new index and name; the boundaries and
        children of those are among them.
    """

    def moved(parts: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(replace(part, state=names[part.state][0]) for part in parts)

    return [
        replace(
            states[old],
            name=name,
            boundaries=moved(states[old].boundaries),
            children=moved(states[old].children),
            incidences=(),
            adjacencies=(),
        )
        for old, (_, name) in names.items()
    ]


def _kept(state: CellState, names: Names | None) -> CellState:
    if names is None:
        return state
    known = [child.name for child in state.children]
    for name in names:
        if name not in known:
            raise ModelError(f"keep: got {name!r} for {state.name}{nearest(name, known)}")
    return replace(state, children=tuple(c for c in state.children if c.name in names))


def _joined(states: Sequence[CellState], state: CellState) -> CellState:
    placed = [
        Placed(_labels(child.guess), _parts(states, states[child.state]))
        for child in state.children
    ]
    covered = [
        Covered(face, letter, _labels(boundary.matrix @ child.guess))
        for face, boundary in enumerate(state.boundaries)
        for letter, child in enumerate(states[boundary.state].children)
    ]
    incidences, adjacencies = joins(placed, covered)
    return replace(state, incidences=incidences, adjacencies=adjacencies)


def _parts(states: Sequence[CellState], state: CellState) -> list[Part]:
    return [
        Part(states[b.state].dimension, tuple(b.matrix.argmax(axis=0).tolist()))
        for b in state.boundaries
    ]


def _labels(weights: Floats) -> list[tuple[int, ...]]:
    """Return a label for each column: equal where columns are."""
    return [tuple(column) for column in np.rint(weights.T / MATCHING).astype(np.int64).tolist()]
