"""Boundary representations as one: states that cannot be told apart become one state."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from porous.models.brep import BRep

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

    from porous.models.brep import CellState


def merged(breps: Sequence[BRep]) -> tuple[BRep, tuple[int, ...]]:
    """Return one representation of the states of several, and where the start of each is in it.

    Two states are one where they have the same controls, boundaries, children and constraints,
    names of states aside, and these lead to states that are one: the coarsest such partition, by
    refinement (Hopcroft 1971 for automata). Cells of different digits thus share their faces'
    states wherever these are divided alike.

    The first of the starts is the start; the others are ``BRep.more``.
    """
    states = [_shifted(state, first) for brep, first in _firsts(breps) for state in brep.states]
    classes = _numbered([_looks(state) for state in states])
    while True:
        finer = _numbered(
            [
                (own, *(classes[s] for s in _leads_to(state)))
                for own, state in zip(classes, states, strict=True)
            ]
        )
        if finer == classes:
            break
        classes = finer
    kept = [classes.index(number) for number in range(max(classes) + 1)]
    names = _names([states[index].name for index in kept])
    result = [
        _renumbered(replace(states[index], name=name), classes)
        for index, name in zip(kept, names, strict=True)
    ]
    starts = tuple(classes[brep.start + first] for brep, first in _firsts(breps))
    more = tuple(dict.fromkeys(s for s in starts if s != starts[0]))
    return BRep(tuple(result), starts[0], more), starts


def _firsts(breps: Sequence[BRep]) -> list[tuple[BRep, int]]:
    """Return where the states of each representation begin among all."""
    result, first = [], 0
    for brep in breps:
        result.append((brep, first))
        first += len(brep.states)
    return result


def _looks(state: CellState) -> Hashable:
    """Return all that a state is by itself."""
    return (
        state.shape,
        state.controls.tobytes(),
        tuple((b.name, b.matrix.shape, b.matrix.tobytes()) for b in state.boundaries),
        tuple((c.name, c.guess.shape, c.guess.tobytes()) for c in state.children),
        state.incidences,
        state.adjacencies,
    )


def _numbered(keys: Sequence[Hashable]) -> list[int]:
    """Return for each key which of the different ones it is, in the order they are met."""
    numbers: dict[Hashable, int] = {}
    return [numbers.setdefault(key, len(numbers)) for key in keys]


def _shifted(state: CellState, first: int) -> CellState:
    return _renumbered(state, range(first, first + 1 + max(_leads_to(state), default=0)))


def _leads_to(state: CellState) -> list[int]:
    return [*(b.state for b in state.boundaries), *(c.state for c in state.children)]


def _renumbered(state: CellState, numbers: Sequence[int]) -> CellState:
    return replace(
        state,
        boundaries=tuple(replace(b, state=numbers[b.state]) for b in state.boundaries),
        children=tuple(replace(c, state=numbers[c.state]) for c in state.children),
    )


def _names(given: Sequence[str]) -> list[str]:
    """Return names that differ: a number follows those that are there already."""
    result: list[str] = []
    for name in given:
        number, new = 2, name
        while new in result:
            new, number = f"{name}-{number}", number + 1
        result.append(new)
    return result
