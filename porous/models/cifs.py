"""Controlled iterated function systems: an automaton whose states have their own controls.

A state says how many control points a cell has, what it is drawn as, and its children; a state
without children is terminal: its cells are drawn and never refined (an IFS with condensation).
Gentil, Gouaty & Sokolov 2021; Mauldin & Williams 1988.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from porous.errors import ModelError
from porous.memory import check_memory
from porous.models.automaton import (
    DEEPEST,
    Automaton,
    Cells,
    State,
    Transition,
    numbers,
    product,
)
from porous.models.cifs_section import CIFSSection, index_of, system
from porous.models.contraction import check_contracts
from porous.models.distinct import count_distinct, distinct_cells
from porous.models.drawing import Body, Drawing, body, drawn_as
from porous.models.enclosure import Seeds, enclosing_balls, orbit_box
from porous.models.features import MOST_CELLS
from porous.models.rational import is_rational
from porous.models.reach import Reach, attractor_reach, cells_reach
from porous.models.struts import lattice
from porous.values import Box
from porous.values.units import check_unit
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from porous.models.ifs import IFS
    from porous.models.lines import LineBody
    from porous.models.primitive import Primitive
    from porous.values import BeamLattice, Frame, Measure, Pattern, SurfaceMesh

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

KIND = "cifs"

BOX_TOLERANCE = 1e-3
"""How far too wide the certified box may be, as a part of the start's longest edge."""

SNAP = 1e-9
"""A certified box that is the level-0 cell's give or take this part of its size is just that."""

SIMPLEX_BYTES = 200
"""Memory of a simplex that is drawn, about."""

Level = int | Literal["limit"]


@dataclass(frozen=True, eq=False)
class CIFS(Value):
    """The cells of a level of an automaton, each drawn as its state says; or the attractor.

    All lengths are in ``unit``.

    Parameters
    ----------
    automaton
        States with any numbers of controls; those without transitions are terminal.
    drawings
        What the cells of each state are drawn as.
    level
        A number, or ``"limit"`` for the attractor; cells of terminal states, of any level, belong
        to it.
    domain
        The box that is sampled: of all levels and the attractor, grown by radii and ``offset``.
    bulk
        The box that porosity refers to.
    offset
        Radius of the ball added.
    unit
        Unit of length.

    Raises
    ------
    ModelError
        For a negative offset, levels that cannot be, a drawing too many or too few.
    """

    automaton: Automaton
    drawings: tuple[Drawing, ...]
    level: Level
    domain: Box
    bulk: Box
    offset: float = 0.0
    unit: str = "mm"

    def __post_init__(self) -> None:
        check_unit(self.unit)
        self._set("drawings", tuple(self.drawings))
        if not 0 <= self.offset < math.inf:
            raise ModelError(f"offset: got {self.offset}; wanted zero or a length")
        sizes = [drawing.controls for drawing in self.drawings]
        wanted = [state.size for state in self.automaton.states]
        if sizes != wanted:
            raise ModelError(f"drawings: got some on {sizes} controls; wanted {wanted}")
        _check_level(self.automaton, self.drawings, self.level, self.offset)

    @cached_property
    def born(self) -> tuple[tuple[Cells, ...], Indices]:
        """The cells of the level that differ, by state, and by place the level each was born at.

        Raises ``ModelError`` for ``"limit"``, ``MemoryLimitError`` where there are too many.
        """
        if self.level == "limit":
            raise ModelError('level: "limit" has no cells; wanted a number')
        return distinct_cells(self.automaton, self.level)

    @property
    def cells(self) -> tuple[Cells, ...]:
        """The cells of the level, by state."""
        return self.born[0]

    @cached_property
    def body(self) -> Body:
        """What is drawn at the level, as a union of parts that remember where they lie."""
        groups, births = self.born
        amount = sum(len(g.place) * self.drawings[g.state].simplices for g in groups)
        check_memory(
            amount * SIMPLEX_BYTES, f"a body of {amount} simplices", "Choose a lower level."
        )
        return body(self.drawings, groups, births, offset=self.offset)

    @cached_property
    def attractor_balls(self) -> NDArray[np.float64]:
        """A ball per state that holds its attractor, (s, 4)."""
        return enclosing_balls(self.automaton)

    def sample(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the mask of each voxel: bit r·C + c where the pattern's point lies in the body.

        Raises
        ------
        ModelError
            For an attractor without offset: no sample point lies in a set without volume.
        """
        self._reach.check(frame, certain=self._moves_space and self.level == "limit")
        if self.level != "limit":
            return self.body.sample(frame, pattern)
        if self._moves_space:
            from porous.models.cover import sample_attractor

            return sample_attractor(
                self.automaton, self.attractor_balls, frame, pattern, offset=self.offset
            )
        from porous.models.cell_cover import sample_cells

        return sample_cells(
            self.automaton, frame, pattern, drawings=self.drawings, offset=self.offset
        )

    def cover(self, frame: Frame) -> tuple[NDArray[np.unsignedinteger[Any]], float]:
        """Return marks of every voxel that the body touches, and a Hausdorff bound."""
        self._reach.check(frame, certain=self._moves_space or self.level != "limit")
        if self.level != "limit":
            return self.body.cover(frame)
        if self._moves_space:
            from porous.models.cover import cover_attractor

            return cover_attractor(self.automaton, self.attractor_balls, frame, offset=self.offset)
        from porous.models.cell_cover import cover_cells

        return cover_cells(self.automaton, frame, drawings=self.drawings, offset=self.offset)

    @cached_property
    def _reach(self) -> Reach:
        """How far the body reaches; boxes of limits with control points hold their rounding."""
        if self.level != "limit":
            drawn = [(d.primitive.box, d.inverse) for d in self.drawings if d.primitive is not None]
            return cells_reach(self.automaton, [g.points for g in self.cells], self.domain, drawn)
        if self._moves_space:
            return attractor_reach(self.automaton, self.attractor_balls, self.domain)
        roots = [group.points for group in self.automaton.level_zero]
        return cells_reach(self.automaton, roots, self.domain)

    @property
    def _moves_space(self) -> bool:
        """Whether cells are images of space, and every path is endless."""
        return self.automaton.spatial and all(self.automaton.children)

    @cached_property
    def is_cut(self) -> bool:
        """Whether the domain leaves out a part of the set."""
        if self.level == "limit":
            whole = natural_box(self.automaton, self.drawings).grown(self.offset)
        else:
            whole = self._box
        return not self.domain.contains(whole, tolerance=SNAP * max(whole.lengths))

    @cached_property
    def _box(self) -> Box:
        """A box of what is drawn at the level: the hulls of the cells, grown by their radii."""
        boxes = []
        for group in self.cells:
            drawing = self.drawings[group.state]
            if not drawing.is_empty:
                ends = product(group.points, drawing.corners).swapaxes(1, 2).reshape(-1, 3)
                boxes.append(Box.of_points(ends).grown(drawing.reach + self.offset))
        return reduce(Box.union, boxes)

    def sampling_error(self, frame: Frame) -> float:
        """Return how far the boundary that is sampled may lie from the body's, in ``unit``."""
        if self.level != "limit":
            return 0.0
        from porous.models.net import net_error

        return net_error(frame, self.offset)

    @cached_property
    def plain(self) -> IFS | None:
        """The same body as images of one primitive, where it is that: no terminal states."""
        from porous.models.ifs import IFS

        primitive = _one_primitive(self.automaton, self.drawings)
        if primitive is None:
            return None
        return IFS(
            self.automaton,
            self.level,
            primitive,
            domain=self.domain,
            bulk=self.bulk,
            offset=self.offset,
            unit=self.unit,
        )

    def boundary(self) -> SurfaceMesh:
        """Return the exact boundary.

        Raises ``ModelError`` where cells are not images of one polyhedron, or its topology would
        not be certain.
        """
        if self.plain is None:
            raise ModelError(
                "exact boundaries are made where every state draws the same primitive and none "
                "is terminal"
            )
        return self.plain.boundary()

    def line_body(self) -> LineBody | None:
        """Return the body for lines, None for an attractor; see ``models.lines``."""
        from porous.models.lines import lines_of

        return None if self.level == "limit" else lines_of(self.body.parts)

    def beam_lattice(self) -> tuple[BeamLattice, str]:
        """Return the beams and balls that are drawn, and what else there is, in words.

        Raises ``ModelError`` where there are none, or for ``"limit"``.
        """
        return lattice(self.body.parts, self.domain, self.unit)

    def exact(
        self, periodic: tuple[bool, bool, bool] = (False, False, False)
    ) -> tuple[Measure, ...]:
        """Return what is known in closed form: of images of one primitive, as of an ``IFS``."""
        return () if self.plain is None else self.plain.exact(periodic)

    def smallest_feature(self) -> float | None:
        """Return the thickness of the thinnest part, or a lower bound on it, in ``unit``.

        See ``Drawing.thinnest``; plus the offset on both sides. None for an attractor.
        """
        if self.level == "limit":
            return None
        return self._thinnest(self.level) + 2 * self.offset

    def smallest_pore(self) -> None:
        """Return None: the widths of pores are not known in closed form."""

    def finest_printable_level(self, feature: float) -> float | None:
        """Return the last level up to which no part is thinner than ``feature``, in ``unit``.

        None where the level-0 body is thinner already; infinite where the offset alone is as
        thick or every path has ended.

        Raises
        ------
        ModelError
            For a feature that is not positive, or where levels have too many cells to look at.
        """
        if not 0 < feature < math.inf:
            raise ModelError(f"feature: got {feature}; wanted a positive length")
        needed = (feature - 2 * self.offset) * (1 - 1e-9)
        for level in range(DEEPEST if needed > 0 else 0):
            found = count_distinct(self.automaton, level, MOST_CELLS)
            if found > MOST_CELLS:
                raise ModelError(
                    f"finest_printable_level: level {level} has {found} cells; no more than "
                    f"{MOST_CELLS} are looked at"
                )
            if self._thinnest(level) < needed:
                return level - 1 if level else None
            if _ended(self.automaton, level):
                break
        return math.inf

    @property
    def feature_size(self) -> float | None:
        """The length that ``per_feature`` divides; None for an attractor."""
        return self.smallest_feature() or None

    def _thinnest(self, level: int) -> float:
        groups, births = self.born if level == self.level else distinct_cells(self.automaton, level)
        return min(self.drawings[g.state].thinnest(g.points, births[g.place]) for g in groups)


def build(section: CIFSSection, folder: Path) -> CIFS:  # noqa: ARG001  (no state reads a file)
    """Return the model of a recipe's section.

    Raises
    ------
    ModelError
        Where there is no such model: as ``system``, and for states that do not contract together
        (names the word).
    """
    automaton, drawings = system(section)
    return cifs(
        automaton,
        drawings,
        controls=section.controls,
        domain=section.domain.box() if section.domain else None,
        bulk=section.bulk.box() if section.bulk else None,
        **section.model_dump(include={"level", "size", "unit", "offset"}),
    )


def cifs(
    automaton: Automaton,
    drawings: Sequence[str | Primitive | Drawing] | Mapping[str, str | Primitive | Drawing],
    *,
    level: Level = 2,
    controls: ArrayLike | None = None,
    size: float | None = None,
    unit: str = "mm",
    offset: float = 0.0,
    domain: Box | None = None,
    bulk: Box | None = None,
) -> CIFS:
    """Return the model of an automaton whose states are drawn one by one.

    Parameters
    ----------
    automaton
        States with any numbers of controls; those without transitions are terminal.
    drawings
        For each state ``"none"``, ``"cell"``, a primitive or its name, or a drawing (see
        ``models.drawing``); in the order of the states, or by their names.
    level
        A number, or ``"limit"`` for the attractor.
    controls
        Where the level-0 cell's controls lie, (m, 3): the whole body is mixed from them. Those of
        the start state where not given.
    size
        Length of the domain's longest edge, in ``unit``; controls are in ``unit`` where not given.
        Radii and thicknesses are in ``unit`` always.
    unit
        nm, um, mm, cm, m or in.
    offset
        Radius of the ball added, in ``unit``.
    domain, bulk
        Boxes in model units, in place of those that follow from the automaton and its drawings.

    Raises
    ------
    ModelError
        As ``build``; and for controls with weights.
    """
    for state in automaton.states:
        if is_rational(state.controls):
            raise ModelError(
                f"states.{state.name}: got controls of shape {state.controls.shape}, with weights; "
                f"wanted (3, {state.size}), or cells with boundaries (bcifs), which take weights"
            )
    drawn = _drawings(automaton, drawings)
    automaton = automaton if controls is None else _moved(automaton, controls)
    _check_level(automaton, drawn, level, float(offset))
    check_contracts(automaton, _letters(automaton))
    sampled = domain or natural_box(automaton, drawn)
    scale = 1.0 if size is None else float(size) / max(sampled.lengths)
    box = sampled.scaled(scale).grown(0.0 if domain else _reach(drawn) + offset)
    if not box.volume:
        raise ModelError(
            f"domain: got a box of edges {box.lengths}, for all controls lie in a plane and what "
            "is drawn has no thickness; wanted radii, an offset, or a domain"
        )
    about = (bulk or sampled).scaled(scale)
    return CIFS(
        automaton.scaled(scale),
        drawn,
        level,
        box,
        about if about.volume else box,
        offset=float(offset),
        unit=unit,
    )


def _moved(automaton: Automaton, controls: ArrayLike) -> Automaton:
    """Return the automaton with the start's controls elsewhere."""
    start = automaton.states[automaton.start]
    points = numbers(controls, "controls")
    if points.shape != (start.size, 3):
        raise ModelError(
            f"controls: got shape {points.shape}; wanted ({start.size}, 3), as many points as the "
            f"start {start.name!r} has"
        )
    states = list(automaton.states)
    states[automaton.start] = State(start.name, points.T)
    return Automaton(tuple(states), automaton.transitions, automaton.start)


def natural_box(automaton: Automaton, drawings: Sequence[Drawing]) -> Box:
    """Return a certified box of all that is drawn at any level, radii left out, and of the limit.

    The box of what the level-0 cell is drawn as, or of its controls, where nothing leaves it.
    """
    from porous.models.control_box import control_box

    start, drawing = automaton.states[automaton.start], drawings[automaton.start]
    longest = max(float(np.ptp(start.controls, axis=1).max()), 1e-300)
    primitive = _one_primitive(automaton, drawings)
    if primitive is not None:
        seeds = Seeds(primitive.points, primitive.radius or 0.0)
        return orbit_box(automaton, seeds, tolerance=BOX_TOLERANCE * max(seeds.box.lengths))
    extended = _with_drawings(automaton, drawings)
    drawn = {
        index: tuple(range(state.size)) if index >= len(automaton.states) else ()
        for index, state in enumerate(extended.states)
    }
    found = control_box(extended, tolerance=BOX_TOLERANCE * longest, drawn=drawn)
    corners = [start.controls]
    if not drawing.is_empty:
        corners.append(start.controls @ drawing.corners)
    for points in corners:
        exact = Box.of_points(points.T)
        slack = SNAP * max(found.lengths)
        if exact.contains(found, tolerance=slack) and found.contains(exact, tolerance=slack):
            return exact
    return found


def _with_drawings(automaton: Automaton, drawings: Sequence[Drawing]) -> Automaton:
    """Return the automaton with the points of each drawing as a terminal child of its state."""
    states, transitions = list(automaton.states), list(automaton.transitions)
    for index, (state, drawing) in enumerate(zip(automaton.states, drawings, strict=True)):
        if not drawing.is_empty:
            weights = drawing.corners
            transitions.append(Transition(index, len(states), weights))
            states.append(State(f"{state.name}, drawn", state.controls @ weights))
    return Automaton(tuple(states), tuple(transitions), automaton.start)


def _one_primitive(automaton: Automaton, drawings: Sequence[Drawing]) -> Primitive | None:
    """Return the primitive that every cell of every level is an image of, if there is one.

    In the states' reference coordinates, which may be larger than those of the drawings.
    """
    first = drawings[0]
    bare = not any(drawing.simplices for drawing in drawings)
    if first.primitive is None or not bare or not automaton.spatial or not all(automaton.children):
        return None
    factor = None
    for state, drawing in zip(automaton.states, drawings, strict=True):
        if drawing.primitive != first.primitive:
            return None
        assert state.inverse is not None
        assert drawing.inverse is not None
        larger = np.linalg.norm(drawing.inverse[:, :3]) / np.linalg.norm(state.inverse[:, :3])
        factor = float(larger) if factor is None else factor
        same = state.inverse * np.array([factor, factor, factor, 1])
        if not np.allclose(same, drawing.inverse, rtol=1e-12, atol=1e-12 * np.abs(same).max()):
            return None
    assert factor is not None
    return first.primitive if factor == 1 else first.primitive.scaled(factor)


def _drawings(
    automaton: Automaton,
    given: Sequence[str | Primitive | Drawing] | Mapping[str, str | Primitive | Drawing],
) -> tuple[Drawing, ...]:
    names = [state.name for state in automaton.states]
    if isinstance(given, Mapping):
        for name in given:
            index_of(names, name, "drawings")
        given = [given.get(name, "none") for name in names]
    if isinstance(given, str) or len(given) != len(names):
        raise ModelError(f"drawings: got {given!r:.80}; wanted one for each of {len(names)} states")
    return tuple(map(drawn_as, given, automaton.states))


def _check_level(
    automaton: Automaton, drawings: Sequence[Drawing], level: object, offset: float
) -> None:
    """Raise ``ModelError`` for a level that cannot be, or at which nothing is drawn."""
    if level == "limit":
        from porous.models.cell_cover import check_limit

        check_limit(automaton, tuple(drawings), offset)
        return
    if not isinstance(level, int | np.integer) or isinstance(level, bool):
        raise ModelError(f'level: got {level!r}; wanted a whole number or "limit"')
    if not 0 <= level <= DEEPEST:
        raise ModelError(f"level: got {level}; wanted 0 … {DEEPEST}")
    there = _states_at(automaton, int(level))
    if all(drawings[q].is_empty for q in there):
        names = ", ".join(repr(automaton.states[q].name) for q in sorted(there))
        raise ModelError(
            f"draw: nothing is drawn at level {level}, whose cells are of {names}; wanted a "
            'drawing other than "none" for one of them'
        )
    for q, (state, drawing) in enumerate(zip(automaton.states, drawings, strict=True)):
        _check_regular(automaton, q, state, drawing)


def _check_regular(automaton: Automaton, q: int, state: State, drawing: Drawing) -> None:
    """Raise ``ModelError`` where a child that is drawn as a solid image is flattened."""
    if drawing.primitive is None:
        return
    for source, children in enumerate(automaton.children):
        above = automaton.states[source]
        for i, t in enumerate(children):
            if t.target != q or above.inverse is None or state.inverse is None:
                continue
            A = (above.controls @ t.matrix @ state.inverse)[:, :3]
            if abs(np.linalg.det(A)) <= 1e-14 * np.linalg.norm(A, 2) ** 3:
                raise ModelError(
                    f"states.{above.name}.children.{i}: got a singular matrix, which flattens the "
                    f"primitive that {state.name!r} is drawn as; wanted one with an inverse"
                )


def _letters(automaton: Automaton) -> list[str]:
    """Return what a recipe calls each transition."""
    place = {id(t): i for children in automaton.children for i, t in enumerate(children)}
    return [
        f"states.{automaton.states[t.source].name}.children.{place[id(t)]}"
        for t in automaton.transitions
    ]


def _states_at(automaton: Automaton, level: int) -> set[int]:
    """Return the states of the cells of a level."""
    there = {automaton.start}
    for _ in range(level):
        there = {t for q in there for t in [c.target for c in automaton.children[q]] or [q]}
    return there


def _ended(automaton: Automaton, level: int) -> bool:
    return not any(automaton.children[q] for q in _states_at(automaton, level))


def _reach(drawings: Sequence[Drawing]) -> float:
    """Return how far the body may reach beyond the box without radii."""
    return max(drawing.reach for drawing in drawings)
