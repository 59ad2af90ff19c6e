"""Boundary-controlled iterated function systems: cells that share faces, edges and vertices."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, get_args

import numpy as np

from porous.errors import ModelError
from porous.models.automaton import COINCIDENT, check_apart, numbers
from porous.models.bcifs_section import FUSED, BCIFSSection, Contacts, Level, system_of
from porous.models.cell_attractor import BULK_LEVEL, CellAttractor
from porous.models.cell_body import CellBody, thinnest
from porous.models.cell_folds import corner_weights
from porous.models.cell_system import CellSystem, natural_box
from porous.models.contraction import check_contracts
from porous.models.macro import MacroMesh, automaton_of, check_macro, with_middles
from porous.models.macro_places import check_hanging, check_places
from porous.models.rational import homogeneous, positions, scaled
from porous.models.solve import solve
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

WIDEST = 10
"""Radii and offsets above so many extents of the controls are slips: all shape is lost in them."""

FLAT = 1e-6
"""A limit that is thinner than this part of its longest extent lies in a plane."""


def build(section: BCIFSSection, folder: Path) -> CellSystem | CellAttractor:
    """Return the model of a recipe's section.

    ``folder`` is where its mesh is looked for.

    Raises
    ------
    ModelError
        Where there is no such model: constraints that contradict each other (names them), cells
        that do not contract (names the word), control points that coincide, …
    """
    given = system_of(section, folder)
    return bcifs(
        given.brep,
        level=section.levels()[0],
        controls=given.controls,
        cells=given.mesh,
        moves=section.moves,
        digits=given.digits,
        draw=section.sweep(),
        domain=section.domain.box() if section.domain else None,
        bulk=section.bulk.box() if section.bulk else None,
        **section.model_dump(include={"size", "unit", "offset", "contacts", "contact_radius"}),
    )


def bcifs(
    brep: BRep,
    *,
    level: Level = 2,
    controls: ArrayLike | None = None,
    cells: Sequence[Sequence[int]] | MacroMesh | None = None,
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
        controls, whose others are put midway. Of several level-0 cells, all their controls.
    cells
        For each of several level-0 cells the indices of its controls, in the order of the start's
        reference cell; a mesh of cells of several states. Cells share what they name by the same
        indices, however their axes lie.
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
    macro, given = (None, controls) if cells is None else _macro(brep, cells, controls)
    given = _controls(start, given, alone=macro is None)
    limit = level == "limit"
    _check_start(start, drawn=draw is not None or limit)
    automaton = automaton_of(solution, given, macro)
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
        macro,
    )
    _check_radii(system, draw, offset, contact_radius)
    if start.dimension == 3 or macro:
        _check_level_zero(replace(system, level=0))
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


def _check_radii(
    system: CellSystem, draw: Sweep | None, offset: float, contact_radius: float | None
) -> None:
    """Raise ``ModelError`` for a ball in which the whole body would be lost."""
    extent = float(np.ptp(positions(system.controls), axis=1).max())
    radius = draw.radius if draw else None
    balls = {"draw.radius": radius, "offset": offset, "contact_radius": contact_radius}
    for name, value in balls.items():
        if value is not None and value > WIDEST * extent:
            raise ModelError(
                f"{name}: got {value:g} {system.unit}, but controls extend over {extent:g} "
                f"{system.unit}; wanted at most {WIDEST} times that, {WIDEST * extent:g} "
                f"{system.unit}"
            )


def _check_level_zero(system: CellSystem) -> None:
    """Raise ``ModelError`` where a level-0 cell is folded; its controls are out of order then."""
    _ = system.complex  # what is wrong with the lists of controls is told first
    try:
        if system.brep.states[system.brep.start].dimension == 3:
            check_places(system.nodes)
    except ModelError as error:
        corners = system.brep.of_dimension(system.brep.start, 0)
        hint = "x slowest, z fastest" if len(corners) == 8 else "as in its reference cell"
        raise ModelError(
            f"controls: {error}. Are they in order ({hint}), and no corner pushed through a face?"
        ) from None
    if system.sharing:
        check_hanging(system.sharing, system.controls)


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


def _macro(
    brep: BRep, cells: Sequence[Sequence[int]] | MacroMesh, controls: ArrayLike | None
) -> tuple[MacroMesh, Floats]:
    """Return level-0 cells and all their controls, those between corners too."""
    if controls is None:
        raise ModelError("cells: got indices of controls, but no controls; wanted both")
    points = numbers(controls, "controls")
    if not isinstance(cells, MacroMesh):
        if _has_eight(brep.states[brep.start]):
            points, cells = with_middles(points, cells)
        cells = MacroMesh(tuple(map(tuple, cells)), (brep.start,) * len(cells))
    check_macro(brep, cells, points.shape[1])
    return cells, points


def _has_eight(state: CellState) -> bool:
    """Tell whether a cell of 27 controls has its 8 corners among them: it ends in controls."""
    return state.size == 27 and any(b.matrix.shape[1] == 1 for b in state.boundaries)


def _controls(state: CellState, given: ArrayLike | None, *, alone: bool) -> Floats:
    """Return the level-0 cells' controls, or say which are missing or coincide."""
    points = state.controls if given is None else numbers(given, "controls")
    eight = _has_eight(state)
    if points.ndim == 2 and points.shape[1] == 8 and eight and alone:
        points, (own,) = with_middles(points, [range(8)])
        points = points[:, own]
    controls = homogeneous(points)
    if controls.shape[1] != state.size and alone:
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
