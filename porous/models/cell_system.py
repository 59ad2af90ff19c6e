"""A boundary-controlled system at a level: its cells, where they lie, and the body they fill.

The model proper is one of two bodies: of solid cells, which are a mesh by construction
(``models.cell_body``), or of what is swept along them (``models.swept_body``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.models.automaton import (
    DEEPEST,
    Automaton,
    State,
    Transition,
    check_cells,
    count_cells,
)
from porous.models.betti import betti
from porous.models.cell_folds import corner_weights
from porous.models.cell_nodes import CellNodes, cell_nodes, placed_corners
from porous.models.closure import Closure, closure
from porous.models.complex import Complex, cell_complex, level_zero
from porous.models.counts import counts
from porous.models.macro import MacroMesh, Sharing, automaton_of, check_macro
from porous.models.macro_places import side_names
from porous.models.rational import ROWS, positions
from porous.models.reach import Reach, cells_reach
from porous.values import Box
from porous.values.units import check_unit
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.models.brep import BRep
    from porous.models.digits import DigitSet
    from porous.models.lines import LineBody
    from porous.models.pieces import Pieces
    from porous.models.solve import Solution
    from porous.values import Frame, Pattern, SurfaceMesh

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

SOLVED = 1e-15
"""Weights may be less than zero by so much where they are none: the rounding of ``solve``."""

DIVIDED = 1e-15
"""By which part of the largest coordinate a division by weights may be off."""

WEIGHTLESS = 1e-12
"""Weights below this count as none when the controls that corners lie on are looked for."""


@dataclass(frozen=True, eq=False)
class CellSystem(Value):
    """What all models of cells with boundaries have in common.

    Parameters
    ----------
    solution
        The matrices that satisfy the constraints.
    controls
        Control points of the level-0 cells, float64 (3, m), in ``unit``; with weights (4, m),
        homogeneous (``models.rational``).
    level
        Zero or more.
    domain
        The box that is sampled.
    unit
        Unit of length.
    digits
        The digit set of each level where cells are those of cubes; else none.
    bulk_box
        The box that porosity refers to, in place of the level-0 cell's body.
    macro
        The level-0 cells where there are several, on the same control points.

    Raises
    ------
    ModelError
        For a negative level, controls of another shape.
    """

    solution: Solution
    controls: NDArray[np.float64]
    level: int
    domain: Box
    unit: str = "mm"
    digits: tuple[DigitSet, ...] = ()
    bulk_box: Box | None = None
    macro: MacroMesh | None = None

    def __post_init__(self) -> None:
        self._set("controls", frozen(self.controls, np.float64))
        self._set("digits", tuple(self.digits))
        check_unit(self.unit)
        size = self.brep.states[self.brep.start].size
        if self.macro:
            check_macro(self.brep, self.macro, self.controls.shape[1])
        elif self.controls.shape not in [(rows, size) for rows in ROWS]:
            raise ModelError(f"controls: got shape {self.controls.shape}; wanted (3, {size})")
        whole = isinstance(self.level, int) and not isinstance(self.level, bool)
        if not whole or not 0 <= self.level <= DEEPEST:
            raise ModelError(f"level: got {self.level!r}; wanted a whole number, 0 … {DEEPEST}")

    @property
    def brep(self) -> BRep:
        """The states with their boundaries and constraints."""
        return self.solution.brep

    @cached_property
    def automaton(self) -> Automaton:
        """The automaton of the cells, its level-0 cells where the controls lie."""
        return automaton_of(self.solution, self.controls, self.macro)

    @cached_property
    def sharing(self) -> Sharing | None:
        """What several level-0 cells share."""
        return Sharing(self.brep, self.macro) if self.macro else None

    @cached_property
    def closure(self) -> Closure:
        """What every state's split creates and shares."""
        return self.sharing.closure(self.solution) if self.sharing else closure(self.solution)

    @cached_property
    def level_zero(self) -> Complex:
        """The level-0 cells with all that they share."""
        if self.sharing is None:
            return level_zero(self.closure)
        names = side_names(self.sharing, self.solution, self.controls)
        return self.sharing.complex(self.closure, names)

    @cached_property
    def complex(self) -> Complex:
        """The cells of the level with all that they share."""
        return cell_complex(self.closure, self.level, self.level_zero)

    @cached_property
    def nodes(self) -> CellNodes:
        """Where the vertices of the complex lie, and which cells share them."""
        return cell_nodes(self.solution, self.complex, self.automaton, self.level)

    @cached_property
    def places(self) -> tuple[Floats, list[Indices]]:
        """Where the vertices of the complex lie, (v, 3), and the corners of its cells by state."""
        return placed_corners(self.solution, self.complex, self.automaton, self.level)

    def corners(self) -> list[tuple[str, Floats]]:
        """Return the shape of each group of cells and where its corners lie, (k, c, 3)."""
        points, corners = self.places
        return [
            (self.brep.states[group.state].shape, points[own])
            for group, own in zip(self.complex.cells, corners, strict=True)
        ]

    @cached_property
    def reach(self) -> Reach:
        """How far from the origin the cells of the level reach."""
        return cells_reach(self.automaton, [self.places[0].T], self.domain)

    @property
    def counts(self) -> tuple[int, int, int, int]:
        """Vertices, edges, faces and cells of the closed complex of the level, whole numbers.

        From the power of a matrix: levels far too deep to be made are counted too.
        """
        return counts(self.closure, self.level, self.level_zero)

    @property
    def betti_numbers(self) -> tuple[int, int, int]:
        """Pieces, tunnels and cavities of the closed complex of the level."""
        return betti(self.complex)

    @property
    def digits_by_level(self) -> tuple[DigitSet, ...]:
        """The digit set of each level down to this one, the coarsest first."""
        last = self.digits[-1:] * max(0, self.level - len(self.digits))
        return (*self.digits, *last)[: self.level]

    @property
    def bulk(self) -> Box:
        """The box of the body that porosity refers to."""
        return self.bulk_box or self.bulk_surface.box

    @property
    def bulk_volume(self) -> float:
        """Volume of the body that porosity refers to, in ``unit`` cubed."""
        return self.bulk_box.volume if self.bulk_box else self.bulk_surface.volume

    @cached_property
    def bulk_surface(self) -> SurfaceMesh:
        """The boundary of the body that porosity refers to: level-0 cells with nothing lost."""
        from porous.models.cell_bulk import bulk_surface
        from porous.models.cell_exact import affine_volume

        level = self.level
        if affine_volume(self.solution, self.automaton, 0) is not None:
            level = 0  # flat faces are the same however finely they are cut
        check_cells(self.automaton, count_cells(self.automaton, level), f"level {level}")
        return bulk_surface(self.solution, self.automaton, self.level_zero, level, self.unit)

    def sample_bulk(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the masks of the body that porosity refers to."""
        return self._bulk_pieces.sample(frame, pattern)

    def bulk_line_body(self) -> LineBody | None:
        """Return the body that porosity refers to for lines; see ``models.lines``."""
        from porous.models.lines import lines_of

        return lines_of([self._bulk_pieces])

    @cached_property
    def _bulk_pieces(self) -> Pieces:
        from porous.models import primitive
        from porous.models.pieces import Pieces

        if self.bulk_box is None:
            # Cells that hang together by faces may touch along an edge besides.
            solid = primitive.of_surface(self.bulk_surface, touching=True)
            place = np.eye(3, 4)
        else:
            solid = primitive.named("cube")
            lower, lengths = np.array(self.bulk_box.lower), np.array(self.bulk_box.lengths)
            place = np.column_stack([np.diag(lengths), lower])
        return Pieces(solid, place[None])


def natural_box(solution: Solution, automaton: Automaton, tolerance: float) -> Box:
    """Return a certified box of all that is drawn at any level, and of the attractor.

    Parameters
    ----------
    solution
        As in ``CellSystem``.
    automaton
        Its placed level-0 cells.
    tolerance
        How much too large it may be, relative to the controls' longest extent.
    """
    from porous.models.control_box import control_box

    hull, corners = _hulls(solution, automaton)
    mixtures = all(T.min() >= -SOLVED for q in solution.brep.reached for T in solution.matrices[q])
    if mixtures and corners.contains(hull, tolerance=DIVIDED * float(np.abs(hull.corners).max())):
        return corners  # no mixture leaves it, and it is reached
    cornered, drawn = _cornered(automaton, solution)
    return control_box(cornered, tolerance=tolerance * max(hull.lengths), drawn=drawn)


def _hulls(solution: Solution, automaton: Automaton) -> tuple[Box, Box]:
    """Return the boxes of the controls and of the corners of the level-0 cells."""
    hulls, corners = [], []
    for group in automaton.level_zero:
        weights = corner_weights(solution, solution.brep.reached[group.state])
        hulls.append(np.swapaxes(positions(group.points), 1, 2).reshape(-1, 3))
        corners.append(np.swapaxes(positions(group.points @ weights), 1, 2).reshape(-1, 3))
    return Box.of_points(np.concatenate(hulls)), Box.of_points(np.concatenate(corners))


def _cornered(
    automaton: Automaton, solution: Solution
) -> tuple[Automaton, dict[int, tuple[int, ...]]]:
    """Return an automaton and which controls of each state are corners.

    Corners that are mixed of several controls become those of a state of their own.
    """
    states, transitions = list(automaton.states), list(automaton.transitions)
    drawn = {}
    for place, q in enumerate(solution.brep.reached):
        weights = corner_weights(solution, q)
        used = np.abs(weights) > WEIGHTLESS
        mixed = bool((used.sum(axis=0) > 1).any())
        drawn[place] = () if mixed else tuple(np.flatnonzero(used.any(axis=1)).tolist())
        if mixed:
            transitions.append(Transition(place, len(states), weights))
            corners = automaton.states[place].controls @ weights
            states.append(State(f"corners of {automaton.states[place].name}", corners))
    return Automaton(tuple(states), tuple(transitions), automaton.start, automaton.roots), drawn
