"""States of cells as recipes write them: controls, boundaries, children and constraints in words.

A constraint is a line of text. ``a.end = b.start`` is an adjacency: boundary ``end`` of child ``a``
is boundary ``start`` of child ``b``. ``a.start = start/first`` is an incidence: it is child
``first`` of the parent's boundary ``start``. Where both sides number their controls differently,
the order follows: ``a.f = b.f (2, 1, 0)`` says that control t on the left is control order[t] on
the right.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from porous.errors import ModelError, nearest
from porous.models.automaton import State
from porous.models.brep import (
    Adjacency,
    Boundary,
    BRep,
    CellState,
    Child,
    Incidence,
    selection,
)
from porous.models.mixtures import weights_of
from porous.models.sections import Section, Triple

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

VERTEX = "vertex"
"""The state that need not be written down: one control, which is its own child."""

SIDE = r"\s*([\w:+-]+)\s*\.\s*([\w:*+-]+)\s*"
CONSTRAINT = re.compile(
    rf"{SIDE}=\s*(?:([\w:+-]+)\s*\.\s*([\w:*+-]+)|([\w:*+-]+)\s*/\s*([\w:+-]+))"
    r"\s*(?:\(([\d,\s]*)\))?\s*"
)

Row = Annotated[tuple[float, ...], Field(strict=False)]
Rows = Annotated[tuple[Row, ...], Field(strict=False, min_length=1)]


class BoundarySection(Section):
    """A boundary of a state: some of its controls, or weights of them."""

    name: str = Field(description="a word")
    state: str = Field(description="the name of a state")
    controls: Annotated[tuple[int, ...], Field(strict=False)] | None = Field(
        default=None, description="indices of the cell's controls, in the boundary's order"
    )
    matrix: Rows | None = Field(
        default=None, description="a row for each control of the cell, a column for each of its own"
    )

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.controls is None) == (self.matrix is None):
            raise ValueError("wanted controls or a matrix, one of them")
        return self


class ChildSection(Section):
    """A child of a state, by weights or by where its controls lie in the reference cell."""

    name: str = Field(description="a word")
    state: str = Field(description="the name of a state")
    matrix: Rows | None = Field(
        default=None, description="a row for each control of the parent, a column for each child's"
    )
    points: Annotated[tuple[Triple, ...], Field(strict=False)] | None = Field(
        default=None, description="where the child's controls lie in the parent's reference cell"
    )

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.points is None) == (self.matrix is None):
            raise ValueError("wanted points or a matrix, one of them")
        return self


class StateSection(Section):
    """A state in full."""

    name: str = Field(description="a word")
    shape: Literal["vertex", "edge", "triangle", "quad", "tetra", "octa", "wedge", "hexa"] = Field(
        description="one of vertex, edge, triangle, quad, tetra, octa, wedge, hexa"
    )
    controls: Annotated[tuple[Triple, ...], Field(strict=False, min_length=1)] = Field(
        description="reference positions of the control points"
    )
    boundaries: Annotated[tuple[BoundarySection, ...], Field(strict=False)] = Field(
        default=(), description="tables of name, state and controls: of every lower dimension"
    )
    children: Annotated[tuple[ChildSection, ...], Field(strict=False)] = Field(
        default=(), description="tables of name, state and matrix or points; none for a last cell"
    )
    constraints: Annotated[tuple[str, ...], Field(strict=False)] = Field(
        default=(), description='lines such as "a.end = b.start" and "a.start = start/a"'
    )


def vertex_state(name: str = VERTEX) -> CellState:
    """Return the state of a point: one control, whose only child it is itself."""
    return CellState(name, "vertex", np.zeros((3, 1)), (), (Child("0", 0, np.ones((1, 1))),))


def build_states(sections: Sequence[StateSection], start: str | None) -> BRep:
    """Return the cells that a recipe's states describe.

    Parameters
    ----------
    sections
        The states; ``vertex`` is there unless they have their own.
    start
        The state of the level-0 cell; the last where not given.

    Raises
    ------
    ModelError
        For names that are there twice or not at all, constraints that cannot be read, and as
        ``BRep``.
    """
    names = [section.name for section in sections]
    own_vertex = VERTEX in names
    names = names if own_vertex else [VERTEX, *names]
    for name in names:
        if names.count(name) > 1:
            raise ModelError(f"states: {name!r} is there twice")
    built = [] if own_vertex else [vertex_state()]
    by_name = {section.name: section for section in sections}
    sizes = {section.name: len(section.controls) for section in sections}
    built += [_state(section, names, {VERTEX: 1, **sizes}, by_name) for section in sections]
    return BRep(tuple(built), _named(start or names[-1], names, "start"))


def _named(name: str, names: Sequence[str], where: str) -> int:
    if name not in names:
        raise ModelError(f"{where}: no {name!r}{nearest(name, names)}")
    return names.index(name)


def _state(
    section: StateSection,
    names: list[str],
    sizes: dict[str, int],
    by_name: dict[str, StateSection],
) -> CellState:
    controls = np.array(section.controls, np.float64).T
    for parts in (section.boundaries, section.children):
        part_names = [part.name for part in parts]
        for name in part_names:
            if part_names.count(name) > 1:
                raise ModelError(f"state {section.name}: {name!r} is there twice")
    boundaries = [_boundary(section, part, names) for part in section.boundaries]
    children = [_child(section, part, names, sizes, controls) for part in section.children]
    read = [_constraint(section, text, by_name) for text in section.constraints]
    return CellState(
        section.name,
        section.shape,
        controls,
        tuple(boundaries),
        tuple(children),
        tuple(c for c in read if isinstance(c, Incidence)),
        tuple(c for c in read if isinstance(c, Adjacency)),
    )


def _boundary(section: StateSection, part: BoundarySection, names: list[str]) -> Boundary:
    where = f"state {section.name}: boundary {part.name}"
    kind = _named(part.state, names, where)
    if part.matrix is not None:
        return Boundary(part.name, kind, np.array(part.matrix))
    assert part.controls is not None
    count = len(section.controls)
    for index in part.controls:
        if not 0 <= index < count:
            raise ModelError(f"{where}: got control {index}; wanted 0 … {count - 1}")
    return Boundary(part.name, kind, selection(count, part.controls))


def _child(
    section: StateSection,
    part: ChildSection,
    names: list[str],
    sizes: dict[str, int],
    controls: Floats,
) -> Child:
    where = f"state {section.name}: child {part.name}"
    kind = _named(part.state, names, where)
    if part.matrix is not None:
        if len({len(row) for row in part.matrix}) > 1:
            raise ModelError(f"{where}: got rows of different lengths in its matrix")
        return Child(part.name, kind, np.array(part.matrix))
    points = np.array(part.points, np.float64)
    if len(points) != sizes[part.state]:
        raise ModelError(
            f"{where}: got {len(points)} points; wanted {sizes[part.state]}, one for each "
            f"control of {part.state}"
        )
    return Child(part.name, kind, weights_of(State(where, controls), points))


def _constraint(
    section: StateSection, text: str, by_name: dict[str, StateSection]
) -> Incidence | Adjacency:
    where = f"state {section.name}: constraint {text!r}"
    match = CONSTRAINT.fullmatch(text)
    if match is None:
        raise ModelError(
            f"{where}: wanted child.boundary = child.boundary or child.boundary = boundary/child"
        )
    child, boundary, other, other_boundary, face, letter, order = match.groups()
    left = _slot(section, child, boundary, by_name, where)
    try:
        named = tuple(int(digit) for digit in (order or "").split(",") if digit.strip())
    except ValueError:
        raise ModelError(f"{where}: wanted an order such as (2, 1, 0)") from None
    if face is None:
        return Adjacency(*left, *_slot(section, other, other_boundary, by_name, where), named)
    index = _named(face, [part.name for part in section.boundaries], where)
    kind = section.boundaries[index].state
    kids = ["0"] if kind not in by_name else [part.name for part in by_name[kind].children]
    return Incidence(*left, index, _named(letter, kids, where), named)


def _slot(
    section: StateSection,
    child: str,
    boundary: str,
    by_name: dict[str, StateSection],
    where: str,
) -> tuple[int, int]:
    index = _named(child, [part.name for part in section.children], where)
    kind = section.children[index].state
    known = [] if kind not in by_name else [part.name for part in by_name[kind].boundaries]
    return index, _named(boundary, known, where)
