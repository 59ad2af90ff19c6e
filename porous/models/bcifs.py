"""Boundary-controlled iterated function systems: cells that share faces, edges and vertices."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Literal, Self, get_args

import numpy as np
from pydantic import Field, model_validator

from porous.errors import ModelError, nearest
from porous.models.automaton import COINCIDENT, DEEPEST, check_apart, numbers
from porous.models.builders import Options, Texture, build_cell, cell_names
from porous.models.cell_attractor import BULK_LEVEL, CellAttractor
from porous.models.cell_body import CellBody, thinnest
from porous.models.cell_folds import corner_weights
from porous.models.cell_system import CellSystem, natural_box
from porous.models.contraction import check_contracts
from porous.models.rational import columns, homogeneous, positions, scaled
from porous.models.sections import BoxSection, DigitsSection, Section
from porous.models.solve import solve
from porous.models.states import StateSection, build_states
from porous.models.swept_body import Sweep, SweptBody

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from porous.models.brep import BRep, CellState
    from porous.models.digits import DigitSet
    from porous.models.solve import Solution
    from porous.values import Box

    Floats = NDArray[np.float64]

KIND = "bcifs"

BOX_TOLERANCE = 1e-3
"""How far too wide the certified box may be, as a part of the controls' longest extent."""

SMALLEST = 1e-30
"""Extents of controls below this, or above its inverse, are refused: their cubes are no numbers."""

FLAT = 1e-6
"""A limit that is thinner than this part of its longest extent lies in a plane."""

FUSED = 0.25
"""Radius of what fuses contacts where none is given, as a part of the thinnest cell."""

Numbers = Annotated[tuple[float, ...], Field(strict=False, min_length=1)]
Control = Annotated[tuple[float, ...], Field(strict=False, min_length=3, max_length=4)]
Names = Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
Contacts = Literal["apart", "fuse", "shared"]
Level = int | Literal["limit"]


class TextureSection(Section):
    """The curve rule of a cell's edges: where their pieces end, and how far these bulge."""

    edge: float | Numbers | None = Field(
        default=None,
        description="r: the bulge of each piece of an edge, in parts of the edge's own; one number "
        "or one for each division",
    )
    bump: float | Numbers | None = Field(
        default=None,
        description="h: how far each point between pieces lies towards the middle control; one "
        "number or one for each such point",
    )


class SweepSection(Section):
    """What is drawn along cells in place of the solid cells."""

    along: Annotated[
        tuple[
            Literal["vertices", "edges", "faces", "face-diagonals", "body-diagonals"],
            ...,
        ],
        Field(strict=False, min_length=1),
    ] = Field(description="some of vertices, edges, faces, face-diagonals, body-diagonals")
    radius: float | Numbers = Field(
        description="of the ball that sweeps them, above zero, in unit; or one for each level"
    )


class BCIFSSection(Section):
    """The ``[model]`` table of a boundary-controlled iterated function system."""

    kind: Literal["bcifs"] = Field(description='"bcifs"')
    cell: str | None = Field(default=None, description=f"one of {', '.join(cell_names())}")
    states: Annotated[tuple[StateSection, ...], Field(strict=False, min_length=1)] | None = Field(
        default=None, description="tables of one's own states, in place of cell"
    )
    start: str | None = Field(default=None, description="the name of the level-0 cell's state")
    level: Annotated[int, Field(ge=0, le=DEEPEST)] | Literal["limit"] = Field(
        default=2, description='a whole number, zero or more, or "limit"'
    )
    digits: (
        DigitsSection
        | Annotated[tuple[DigitsSection, ...], Field(strict=False, min_length=1)]
        | None
    ) = Field(
        default=None,
        description="{ divisions = N, keep = a list or a name }; or a list of these, one for each "
        "level, of which the last holds below",
    )
    keep: dict[str, Names] | None = Field(
        default=None, description="the names of the children that each state keeps"
    )
    texture: (
        TextureSection
        | Annotated[tuple[TextureSection, TextureSection, TextureSection], Field(strict=False)]
        | None
    ) = Field(
        default=None,
        description="{ edge = r, bump = h } of cells with 27 controls; or three of these, for the "
        "lines along x, y and z",
    )
    moves: dict[str, Numbers] = Field(
        default_factory=dict, description="free points by name, and how far each is moved"
    )
    controls: Annotated[tuple[Control, ...], Field(strict=False, min_length=1)] | None = Field(
        default=None,
        description="the control points [x, y, z] of the level-0 cell, or [x, y, z, weight]",
    )
    size: float | None = Field(
        default=None,
        gt=0,
        description="length of the domain's longest edge before radius and offset, in unit",
    )
    unit: Literal["nm", "um", "mm", "cm", "m", "in"] = Field(
        default="mm", description="nm, um, mm, cm, m or in"
    )
    draw: Literal["cell"] | SweepSection = Field(
        default="cell", description='"cell" or { along = ["edges"], radius = 0.05 }'
    )
    offset: float = Field(default=0.0, ge=0, description="a length, zero or more, in unit")
    contacts: Contacts = Field(default="apart", description='"apart", "fuse" or "shared"')
    contact_radius: float | None = Field(
        default=None,
        gt=0,
        description=f"a length above zero, in unit; {FUSED:g} of the thinnest cell if left out",
    )
    domain: BoxSection | None = Field(
        default=None, description="{ lower = [x, y, z], upper = [x, y, z] }"
    )
    bulk: BoxSection | None = Field(
        default=None, description="{ lower = [x, y, z], upper = [x, y, z] }"
    )

    @model_validator(mode="after")
    def _one_system(self) -> Self:
        if (self.cell is None) == (self.states is None):
            got = "both" if self.cell else "neither"
            raise ValueError(f"got {got} of cell and states; wanted one")
        if self.cell is not None and self.cell not in cell_names():
            raise ValueError(f"no cell {self.cell!r}{nearest(self.cell, cell_names())}")
        if self.states is not None:
            for name in ("digits", "keep", "texture"):
                if getattr(self, name) is not None:
                    raise ValueError(f"{name}: shapes a built-in cell; got states of one's own")
        if self.cell == "beam" and self.draw == "cell" and self.level != "limit":
            raise ValueError('draw: wanted { along = ["edges"], radius = … } for cell = "beam"')
        return self

    def digit_sets(self) -> tuple[DigitSet, ...]:
        """Return the digit set of each level."""
        if self.digits is None:
            return ()
        listed = self.digits if isinstance(self.digits, tuple) else (self.digits,)
        return tuple(each.digits() for each in listed)


def build(section: BCIFSSection, _: Path) -> CellSystem | CellAttractor:
    """Return the model of a recipe's section; it reads no files.

    Raises
    ------
    ModelError
        Where there is no such model: constraints that contradict each other (names them), cells
        that do not contract (names the word), control points that coincide, …
    """
    brep = _brep(section)
    level = section.level
    return bcifs(
        brep,
        level=level,
        controls=None if section.controls is None else columns(section.controls),
        moves=section.moves,
        digits=section.digit_sets(),
        draw=None if isinstance(section.draw, str) else _sweep(section.draw, level),
        domain=section.domain.box() if section.domain else None,
        bulk=section.bulk.box() if section.bulk else None,
        **section.model_dump(include={"size", "unit", "offset", "contacts", "contact_radius"}),
    )


def bcifs(
    brep: BRep,
    *,
    level: Level = 2,
    controls: ArrayLike | None = None,
    moves: Mapping[str, ArrayLike] | None = None,
    digits: Sequence[DigitSet] = (),
    draw: Sweep | None = None,
    size: float | None = None,
    unit: str = "mm",
    offset: float = 0.0,
    contacts: Contacts = "apart",
    contact_radius: float | None = None,
    domain: Box | None = None,
    bulk: Box | None = None,
) -> CellSystem | CellAttractor:
    """Return the model of cells with boundaries: solid cells, what is swept along them, the limit.

    Parameters
    ----------
    brep
        The states with their boundaries and constraints.
    level
        Zero or more, or ``"limit"`` for the attractor.
    controls
        Control points of the level-0 cell, (3, m), in ``unit``, or (4, m) with weights as the
        fourth row; those of its reference cell where not given. Eight corners serve a cell of 27
        controls, whose others are put midway.
    moves
        Displacements of free points by the names of their sliders; see ``models.solve``.
    digits
        The digit set of each level where cells are those of cubes: closed forms are known then.
    draw
        What is swept along the cells; the solid cells where not given.
    size
        Length of the domain's longest edge before it grows by radius and offset, in ``unit``;
        controls are in ``unit`` where not given.
    unit
        nm, um, mm, cm, m or in.
    offset
        Radius of the ball added, in ``unit``.
    contacts
        ``"apart"``, ``"fuse"`` (balls and beams where solid cells meet in points and edges alone)
        or ``"shared"`` (cell meshes share nodes there).
    contact_radius
        Of what fuses, in ``unit``; ``FUSED`` of the thinnest cell where not given.
    domain, bulk
        Boxes in place of those that follow, in the controls' own unit.

    Raises
    ------
    ModelError
        As ``build``.
    """
    _check_arguments(size, offset, contacts, contact_radius)
    solution = solve(brep, moves)
    _check_digits(solution, digits)
    start = brep.states[brep.start]
    given = _controls(start, controls)
    limit = level == "limit"
    _check_start(start, drawn=draw is not None or limit)
    automaton = solution.automaton(given)
    check_contracts(automaton, _letters(brep))
    natural = None if domain and not limit else natural_box(solution, automaton, BOX_TOLERANCE)
    box = domain or natural
    assert box is not None
    scale = 1.0 if size is None else float(size) / max(box.lengths)
    system = CellSystem(
        solution,
        scaled(given, scale),
        BULK_LEVEL if level == "limit" else level,
        (natural or box).scaled(scale),
        unit,
        tuple(digits),
        bulk.scaled(scale) if bulk else None,
    )
    if start.dimension == 3:
        _check_first_cell(system)
    if bulk is None and start.dimension < 3:
        reach = draw.radius if draw else float(offset) if limit else 0.0
        system = replace(system, bulk_box=system.domain.grown(reach))
    if limit:
        _check_limit(draw, contacts)
        return _attractor(system, float(offset), domain and domain.scaled(scale))
    return _body(
        system,
        draw,
        offset=float(offset),
        contacts=contacts,
        contact_radius=contact_radius,
        grown=domain is None,
    )


def _body(
    system: CellSystem,
    draw: Sweep | None,
    *,
    offset: float,
    contacts: Contacts,
    contact_radius: float | None,
    grown: bool,
) -> CellSystem:
    """Return the body of a level: solid cells as a mesh, or what is swept, grown or fused."""
    shared = {name: getattr(system, name) for name in CellSystem.__dataclass_fields__}
    if draw is None and not offset and contacts != "fuse":
        return CellBody(**shared, contacts=contacts)
    if draw is not None and contacts != "apart":
        raise ModelError(f'contacts: got "{contacts}"; what is swept has none: wanted "apart"')
    radius = 0.0
    if contacts == "fuse":
        radius = contact_radius or FUSED * min(thinnest(system))
    if grown:
        shared["domain"] = system.domain.grown(offset + (draw.radius if draw else 0.0))
    return SweptBody(**shared, sweep=draw, offset=offset, fused=radius)


def _check_limit(draw: Sweep | None, contacts: Contacts) -> None:
    if draw is not None:
        raise ModelError(
            f"draw: got {{ along = {list(draw.along)}, … }}, which is swept along the cells of a "
            'level; level = "limit" has none. Wanted offset, or a number'
        )
    if contacts != "apart":
        raise ModelError(
            f'contacts: got "{contacts}", which joins cells; level = "limit" has none. Wanted '
            '"apart" and an offset, or a number'
        )


def _attractor(system: CellSystem, offset: float, domain: Box | None) -> CellAttractor:
    """Return the limit of a system in a box, its own where none is given."""
    box = domain or system.domain.grown(offset)
    if min(box.lengths) <= FLAT * max(box.lengths):
        raise ModelError(
            f"domain: got a box of edges {box.lengths}, for all that the limit holds lies in a "
            "plane; wanted an offset, or a domain"
        )
    return CellAttractor(system, box, offset)


def _brep(section: BCIFSSection) -> BRep:
    if section.states is not None:
        return build_states(section.states, section.start)
    assert section.cell is not None
    return build_cell(
        Options(
            cell=section.cell,
            digits=section.digit_sets(),
            texture=_texture(section.texture),
            keep=section.keep,
            controls=None if section.controls is None else len(section.controls),
            start=section.start,
        )
    )


def _texture(
    given: TextureSection | tuple[TextureSection, ...] | None,
) -> Texture | tuple[Texture, Texture, Texture] | None:
    if given is None:
        return None
    if isinstance(given, TextureSection):
        return Texture(edge=given.edge, bump=given.bump)
    x, y, z = (Texture(edge=each.edge, bump=each.bump) for each in given)
    return x, y, z


def _check_digits(solution: Solution, digits: Sequence[DigitSet]) -> None:
    """Raise ``ModelError`` where children are not the sub-cubes that digits name."""
    index = solution.brep.start
    for level, kept in enumerate(digits):
        state = solution.brep.states[index]
        corners = _corners(solution, index, np.eye(state.size))
        lower, size = corners.min(axis=1), np.ptp(corners, axis=1)
        children = [_corners(solution, index, c.guess, c.state) for c in state.children]
        found = np.array([child.min(axis=1) for child in children])
        wanted = lower + size * kept.keep / kept.divisions
        if found.shape != wanted.shape or np.abs(found - wanted).max() > COINCIDENT * size.max():
            raise ModelError(
                f"digits[{level}]: the {len(state.children)} children of state {state.name} are "
                f"not the {len(kept.keep)} sub-cubes that it names; wanted the digits that the "
                "cell was built with"
            )
        index = state.children[0].state


def _corners(solution: Solution, index: int, matrix: Floats, child: int | None = None) -> Floats:
    """Return where the corners (3, c) of a state's child lie; its controls if it has none."""
    weights = corner_weights(solution, index if child is None else child)
    controls = solution.brep.states[index].controls @ matrix
    return np.asarray(controls @ weights if weights.shape[1] else controls)


def _sweep(section: SweepSection, level: Level) -> Sweep:
    radii = section.radius if isinstance(section.radius, tuple) else (section.radius,)
    return Sweep(section.along, radii[-1 if level == "limit" else min(level, len(radii) - 1)])


def _check_arguments(
    size: float | None, offset: float, contacts: str, contact_radius: float | None
) -> None:
    if contacts not in get_args(Contacts):
        raise ModelError(f"contacts: got {contacts!r}; wanted {', '.join(get_args(Contacts))}")
    for name, value in (("size", size), ("contact_radius", contact_radius)):
        if value is not None and not 0 < value < np.inf:
            raise ModelError(f"{name}: got {value}; wanted a length above zero")
    if not 0 <= offset < np.inf:
        raise ModelError(f"offset: got {offset}; wanted a length, zero or more")


def _check_first_cell(system: CellSystem) -> None:
    """Raise ``ModelError`` where the level-0 cell is folded; its controls are out of order then."""
    try:
        _ = replace(system, level=0).nodes.unfolded
    except ModelError as error:
        corners = system.brep.of_dimension(system.brep.start, 0)
        hint = "x slowest, z fastest" if len(corners) == 8 else "as in its reference cell"
        raise ModelError(
            f"controls: {error}. Are they in order ({hint}), and no corner pushed through a face?"
        ) from None


def _check_start(start: CellState, *, drawn: bool) -> None:
    """Raise ``ModelError`` where the level-0 cell is never refined, or nothing to be seen."""
    if not start.children:
        raise ModelError(
            f"state {start.name}: has no children; wanted a level-0 cell that is refined"
        )
    if start.dimension < 3 and not drawn:
        raise ModelError(
            f"draw: cells of state {start.name} are of shape {start.shape}, no volumes; wanted "
            '{ along = ["edges"], radius = … }, or level = "limit"'
        )


def _letters(brep: BRep) -> list[str]:
    """Return what each transition of the cells is called: its state and its child."""
    return [
        f"{brep.states[q].name}.{c.name}" for q in brep.reached for c in brep.states[q].children
    ]


def _controls(state: CellState, given: ArrayLike | None) -> Floats:
    """Return the level-0 cell's controls, or say which are missing or coincide."""
    controls = state.controls if given is None else homogeneous(numbers(given, "controls"))
    # Only a cell that ends in controls has its 8 corners among its 27.
    eight = state.size == 27 and any(b.matrix.shape[1] == 1 for b in state.boundaries)
    if controls.shape[1] == 8 and eight:
        controls = _midway(controls)
    if controls.shape[1] != state.size:
        raise ModelError(
            f"controls: got {controls.shape[-1]} points; wanted {state.size}, those of "
            f"{state.name}" + (", or its 8 corners" if eight else "")
        )
    places = positions(controls)
    size, far = float(np.ptp(places, axis=1).max()), float(np.abs(places).max())
    if not SMALLEST < size < 1 / SMALLEST or far > size / COINCIDENT:
        raise ModelError(
            f"controls: extend over {size:g} and up to {far:g} from the "
            f"origin; wanted an extent between {SMALLEST:g} and {1 / SMALLEST:g}, not far off"
        )
    check_apart(places, "controls")
    return controls


def _midway(corners: Floats) -> Floats:
    """Return 27 controls whose edges, faces and middle lie midway between 8 corners."""
    line = np.array([[1, 0.5, 0], [0, 0.5, 1]])
    return np.asarray(corners @ np.kron(line, np.kron(line, line)))
