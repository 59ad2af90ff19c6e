"""What a recipe says of a controlled system: states, their controls, drawings and children."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from porous.errors import ModelError, nearest
from porous.models.automaton import (
    DEEPEST,
    SUM_TOLERANCE,
    Automaton,
    State,
    Transition,
    check_apart,
)
from porous.models.drawing import Draw, Drawing, drawn_as
from porous.models.mixtures import weights_of
from porous.models.sections import BoxSection, MapSection, Section, Triple

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


class ChildSection(Section):
    """A child of a state: which state it is, and where its controls lie."""

    state: str = Field(description="the name of a state")
    matrix: (
        Annotated[
            tuple[Annotated[tuple[float, ...], Field(strict=False)], ...], Field(strict=False)
        ]
        | None
    ) = Field(
        default=None,
        description="rows of weights: a row for each control of the parent, a column for each of "
        "the child, columns that sum to one",
    )
    points: Annotated[tuple[Triple, ...], Field(strict=False)] | None = Field(
        default=None, description="the child's controls in the parent's reference coordinates"
    )
    map: MapSection | None = Field(
        default=None,
        description="{ matrix = three rows, translation = three numbers }: takes the child's "
        "reference controls to the parent's reference coordinates",
    )

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        given = [name for name in ("matrix", "points", "map") if getattr(self, name) is not None]
        if len(given) != 1:
            got = " and ".join(given) or "none"
            raise ValueError(f"got {got} of matrix, points and map; wanted one of them")
        return self


class StateSection(Section):
    """A kind of cell: its controls, what it is drawn as, its children."""

    controls: Annotated[tuple[Triple, ...], Field(strict=False, min_length=1)] = Field(
        description="a list of points [x, y, z], at least one"
    )
    draw: Draw = Field(
        description='"none", "cell", a primitive, or { balls, beams, plates, radius, thickness }'
    )
    children: Annotated[tuple[ChildSection, ...], Field(strict=False)] = Field(
        default=(), description="tables of state and one of matrix, points and map; or none"
    )


class CIFSSection(Section):
    """The ``[model]`` table of a controlled iterated function system."""

    kind: Literal["cifs"] = Field(default="cifs", description='"cifs"')
    level: Annotated[int, Field(ge=0, le=DEEPEST)] | Literal["limit"] = Field(
        default=2, description='a whole number, zero or more, or "limit"'
    )
    start: str = Field(description="the name of the level-0 cell's state")
    states: Annotated[dict[str, StateSection], Field(min_length=1)] = Field(
        description="a table for each state, [model.states.NAME]"
    )
    controls: Annotated[tuple[Triple, ...], Field(strict=False)] | None = Field(
        default=None,
        description="a list of points [x, y, z]: where the level-0 cell's controls lie; those of "
        "the start if left out",
    )
    size: float | None = Field(
        default=None,
        gt=0,
        description="the length of the domain's longest edge, above zero, in unit; controls are "
        "in unit if left out",
    )
    unit: Literal["nm", "um", "mm", "cm", "m", "in"] = Field(
        default="mm", description="nm, um, mm, cm, m or in"
    )
    offset: float = Field(default=0.0, ge=0, description="a length, zero or more, in unit")
    contacts: Literal["apart"] = Field(
        default="apart",
        description='"apart"; an offset or balls at the controls join what touches in a point',
    )
    domain: BoxSection | None = Field(
        default=None, description="{ lower = [x, y, z], upper = [x, y, z] } in model units"
    )
    bulk: BoxSection | None = Field(
        default=None, description="{ lower = [x, y, z], upper = [x, y, z] } in model units"
    )

    @model_validator(mode="after")
    def _one_system(self) -> Self:
        try:
            system(self)
        except ModelError as error:
            raise ValueError(str(error)) from None
        return self


def system(section: CIFSSection) -> tuple[Automaton, tuple[Drawing, ...]]:
    """Return the automaton of a section and what its states are drawn as.

    Raises
    ------
    ModelError
        For names of no state, matrices of another shape, columns that do not sum to one, points
        that are no mixtures of the parent's controls, drawings that cannot be; names the key.
    """
    names = list(section.states)
    states = tuple(
        State(name, np.array(part.controls, np.float64).T) for name, part in section.states.items()
    )
    for state in states:
        check_apart(state.controls, f"states.{state.name}.controls")
    transitions = [
        Transition(source, index_of(names, child.state, f"{where}.state"), matrix)
        for source, name in enumerate(names)
        for i, child in enumerate(section.states[name].children)
        for where in [f"states.{name}.children.{i}"]
        for matrix in [_matrix(states, names, source, child, where)]
    ]
    start = index_of(names, section.start, "start")
    drawings = []
    for state, part in zip(states, section.states.values(), strict=True):
        try:
            drawings.append(drawn_as(part.draw, state))
        except ModelError as error:
            raise ModelError(f"states.{state.name}.{error}") from None
    if not transitions:
        raise ModelError("states: got no children at all; wanted a state that is refined")
    return Automaton(states, tuple(transitions), start), tuple(drawings)


def index_of(names: list[str], name: str, where: str) -> int:
    """Return the index of a name, or raise ``ModelError`` that says where and the nearest."""
    if name not in names:
        raise ModelError(f"{where}: no state {name!r}{nearest(name, names)}")
    return names.index(name)


def _matrix(
    states: tuple[State, ...], names: list[str], source: int, child: ChildSection, where: str
) -> Floats:
    """Return the weights of a child's controls, (m, m_child)."""
    target = states[index_of(names, child.state, f"{where}.state")]
    if child.matrix is not None:
        return _weights(child.matrix, states[source], target, f"{where}.matrix")
    if child.map is not None:
        shift = np.array(child.map.translation)[:, None]
        points = (np.array(child.map.matrix) @ target.controls + shift).T
    else:
        points = np.array(child.points).reshape(-1, 3)
    if len(points) != target.size:
        raise ModelError(
            f"{where}.points: got {len(points)}; wanted {target.size}, the controls of "
            f"{target.name!r}"
        )
    try:
        return weights_of(states[source], points)
    except ModelError as error:
        raise ModelError(f"{where}.{error}") from None


def _weights(
    rows: tuple[tuple[float, ...], ...], source: State, target: State, where: str
) -> Floats:
    lengths = {len(row) for row in rows}
    if len(rows) != source.size or lengths != {target.size}:
        raise ModelError(
            f"{where}: got {len(rows)} rows of {sorted(lengths)} numbers; wanted {source.size} "
            f"rows, the controls of {source.name!r}, of {target.size}, those of {target.name!r}"
        )
    matrix = np.array(rows, np.float64)
    sums, scale = matrix.sum(axis=0), np.maximum(1, np.abs(matrix).sum(axis=0))
    off = np.abs(sums - 1) / scale
    if off.max() > SUM_TOLERANCE:
        bad = int(off.argmax())
        raise ModelError(f"{where}: column {bad} sums to {sums[bad]:.9g}; wanted 1")
    return matrix
