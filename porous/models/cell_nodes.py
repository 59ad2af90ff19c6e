"""The cells of a level and their corners: where they lie, and who shares them.

Who shares what is the quotient complex's to say; coordinates only follow. Shared corners that are
computed from different cells agree to a few units in the last place: the first one is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.memory import check_memory
from porous.models.automaton import cells as expanded
from porous.models.automaton import count_cells, product
from porous.models.cell_folds import (
    check_controls,
    check_folds,
    corner_weights,
    handedness,
)
from porous.models.cell_shapes import DIAGONALS, WIDTH, Cut, cut
from porous.models.rational import positions
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from porous.models.automaton import Automaton
    from porous.models.brep import BRep
    from porous.models.complex import CellEntities, Complex
    from porous.models.solve import Solution

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

TEAR = 1e-12
"""How far occurrences of one corner may lie apart, relative to the largest coordinate."""

EQUAL = 1e-9
"""Diagonals whose squares differ less than this part are as long: the first one cuts."""

BYTES_PER_CELL = 1500


@dataclass(frozen=True, eq=False)
class Group(Value):
    """The cells of one state, in the order of their places.

    Parameters
    ----------
    state
        Index among the states of the boundary representation.
    place
        Number of each cell among all cells of the level, in lexicographic order, (k,).
    corners, edges, faces
        What each cell's corners (k, c), edges (k, e) and faces (k, f) are, numbered through all
        the complex's vertices, edges and faces.
    cut
        How the cells are cut into elements.
    variant
        Which variant of the cut is each cell's, (k,).
    """

    state: int
    place: Indices
    corners: Indices
    edges: Indices
    faces: Indices
    cut: Cut
    variant: Indices

    def __post_init__(self) -> None:
        for name in ("place", "corners", "edges", "faces", "variant"):
            self._set(name, frozen(getattr(self, name), np.int64))

    @property
    def variants(self) -> tuple[int, ...]:
        """The variants that occur."""
        return tuple(np.flatnonzero(np.bincount(self.variant)).tolist())

    def by_variant(self, table: Indices) -> Indices:
        """Return each cell's row of a table of the cut, (k, …); a view where all are alike."""
        if len(self.variants) == 1:
            row = table[self.variants[0]]
            return np.broadcast_to(row, (len(self.place), *row.shape))
        result: Indices = table[self.variant]
        return result


@dataclass(frozen=True, eq=False)
class CellNodes(Value):
    """The cells of a level, the places of the corners they share, and who shares which face.

    Slots are the corners of single cells, counted through the groups; sides of faces alike.

    Parameters
    ----------
    points
        Position of each vertex of the complex, float64 (vertices, 3).
    groups
        The cells by state.
    origins
        For each vertex and each face the outer boundary of the level-0 cells that it lies in, or
        −1.
    faces
        Names of the outer faces of the level-0 cells, by their numbers.
    closures
        For each of them all the outer boundaries of the level-0 cells that lie in it.
    brep, level, starts
        Whose cells these are, and the states of the level-0 cells.
    """

    points: Floats
    groups: tuple[Group, ...]
    origins: tuple[Indices, Indices]
    faces: Mapping[int, str]
    closures: Mapping[int, tuple[int, ...]]
    brep: BRep
    level: int
    starts: tuple[int, ...]

    def __post_init__(self) -> None:
        self._set("points", frozen(self.points, np.float64))
        self._set("groups", tuple(self.groups))
        self._set("origins", tuple(frozen(own, np.int64) for own in self.origins))
        for name in ("faces", "closures"):
            self._set(name, MappingProxyType(dict(getattr(self, name))))

    @property
    def cells(self) -> int:
        """Number of cells."""
        return sum(len(group.place) for group in self.groups)

    @cached_property
    def unfolded(self) -> CellNodes:
        """These cells, looked at: none is folded.

        Raises ``ModelError`` where one is folded or flat; names the first one's address, children
        by name.
        """
        check_folds(self.points, self.groups, self.brep, self.level, self.starts)
        return self

    @cached_property
    def slots(self) -> Indices:
        """The vertex of each corner of each cell."""
        return np.concatenate([group.corners.ravel() for group in self.groups])

    @cached_property
    def edges(self) -> int:
        """Number of edges of the complex."""
        return 1 + max(int(group.edges.max(initial=-1)) for group in self.groups)

    @cached_property
    def sides(self) -> Indices:
        """The face of each side: of each face of each cell."""
        return np.concatenate([group.faces.ravel() for group in self.groups])

    @cached_property
    def pairs(self) -> tuple[Indices, Indices]:
        """The sides of faces with two cells, first and second.

        Raises ``ModelError`` where a face has more than two cells.
        """
        sides = self.sides
        count = np.bincount(sides)
        if (count > 2).any():
            raise ModelError(
                f"mesh: {int((count > 2).sum())} faces are shared by three cells or more; "
                "wanted children that meet in a face two by two"
            )
        first, second = (np.empty(len(count), np.int64) for _ in range(2))
        number = np.arange(len(sides))
        second[sides] = number  # the last one stays
        first[sides[::-1]] = number[::-1]
        inner = count == 2
        return first[inner], second[inner]

    @cached_property
    def outer(self) -> NDArray[np.bool_]:
        """Whether each side is of a face with one cell."""
        result = np.ones(len(self.sides), bool)
        for sides in self.pairs:
            result[sides] = False
        return result

    def face_slots(self, sides: Indices) -> Indices:
        """Return the slots of sides' corners in the faces' own order, (n, 4); −1 for none."""
        result = np.empty((len(sides), WIDTH), np.int64)
        for group, first_slot, which, cell, face in self.split(sides):
            corner = group.cut.faces[face]
            width = group.corners.shape[1]
            result[which] = np.where(corner < 0, -1, first_slot + cell[:, None] * width + corner)
        return result

    def split(self, sides: Indices) -> Iterable[tuple[Group, int, Indices, Indices, Indices]]:
        """Yield for each group its first slot, which sides are its, and their cells and faces."""
        slot = side = 0
        for group in self.groups:
            stop = side + group.faces.size
            which = np.flatnonzero((sides >= side) & (sides < stop))
            cell, face = np.divmod(sides[which] - side, group.faces.shape[1])
            yield group, slot, which, cell, face
            slot, side = slot + group.corners.size, stop


def cell_nodes(
    solution: Solution, complex_: Complex, automaton: Automaton, level: int
) -> CellNodes:
    """Return the cells of a complex with the positions of their corners, folded or not.

    The last level is multiplied by T_child·B_corner only. Sums run in one order
    (``automaton.product``): the coordinates are those of the automaton's own cells.

    Parameters
    ----------
    solution
        Boundary representation with its matrices.
    complex_
        The complex of the level.
    automaton
        ``solution.automaton(controls)``: the placed level-0 cells.
    level
        Zero or more.

    Raises
    ------
    ModelError
        For cells that are no volumes; controls that coincide; constraints under which occurrences
        of one corner lie apart.
    MemoryLimitError
        Before anything is allocated.
    """
    brep = solution.brep
    cuts = [cut(brep, entities.state) for entities in complex_.cells]
    weights = _corner_weights(solution)
    points, corners = placed_corners(solution, complex_, automaton, level)
    hand = handedness(solution, automaton, weights, level)
    groups = tuple(
        Group(
            entities.state,
            entities.place,
            own,
            _ids(complex_, entities, 1),
            _ids(complex_, entities, 2),
            how,
            _variant(points, own, brep.states[entities.state].shape, hand[entities.place]),
        )
        for entities, own, how in zip(complex_.cells, corners, cuts, strict=True)
    )
    origins = _origins(brep, complex_, 0), _origins(brep, complex_, 2)
    return CellNodes(
        points,
        groups,
        origins,
        complex_.faces,
        complex_.closures,
        brep,
        level,
        complex_.starts,
    )


def placed_corners(
    solution: Solution, complex_: Complex, automaton: Automaton, level: int
) -> tuple[Floats, list[Indices]]:
    """Return where a complex's vertices lie (v, 3), and the corners (k, c) of its cells by state.

    Of cells of any dimension; parameters and errors as ``cell_nodes``.
    """
    count = count_cells(automaton, level)
    check_memory(
        BYTES_PER_CELL * count, f"a mesh of level {level} ({count} cells)", "Choose a lower level."
    )
    weights = _corner_weights(solution)
    if not automaton.roots:
        controls = automaton.states[automaton.start].controls
        check_controls(solution.brep, controls, weights[solution.brep.start])
    spots = _spots(solution, automaton, weights, level, complex_.cells)
    corners = [_ids(complex_, entities, 0) for entities in complex_.cells]
    size = max(float(np.abs(positions(g.points)).max()) for g in automaton.level_zero)
    return _points(spots, corners, size), corners


def _corner_weights(solution: Solution) -> dict[int, Floats]:
    return {q: corner_weights(solution, q) for q in solution.brep.reached}


def _of_dimension(brep: BRep, dimension: int) -> list[int]:
    return [q for q, state in enumerate(brep.states) if state.dimension == dimension]


def _ids(complex_: Complex, entities: CellEntities, dimension: int) -> Indices:
    return np.asarray(complex_.ids_of(entities, dimension), np.int64)


def _origins(brep: BRep, complex_: Complex, dimension: int) -> Indices:
    parts = [complex_.origin[q] for q in _of_dimension(brep, dimension)]
    return np.concatenate([np.zeros(0, np.int64), *parts])


def _spots(
    solution: Solution,
    automaton: Automaton,
    weights: Mapping[int, Floats],
    level: int,
    cells: Sequence[CellEntities],
) -> list[Floats]:
    """Return the positions (k, c, 3) of the corners of each group's cells."""
    row = np.empty(sum(len(entities.place) for entities in cells), np.int64)
    result = {}
    for entities in cells:
        row[entities.place] = np.arange(len(entities.place))
        result[entities.state] = np.empty(
            (len(entities.place), weights[entities.state].shape[1], 3)
        )
    parents = expanded(automaton, max(level - 1, 0))
    reached = solution.brep.reached
    steps = [_steps(solution, q, weights, last=level > 0) for q in reached]
    fan = np.empty(sum(len(group.place) for group in parents), np.int64)
    for group in parents:
        fan[group.place] = len(steps[group.state])
    first = np.cumsum(fan) - fan
    for group in parents:
        for letter, (target, matrix) in enumerate(steps[group.state]):
            at = row[first[group.place] + letter]
            result[target][at] = positions(product(group.points, matrix)).transpose(0, 2, 1)
    return [result[entities.state] for entities in cells]


def _steps(
    solution: Solution, state: int, weights: Mapping[int, Floats], *, last: bool
) -> list[tuple[int, Floats]]:
    """Return the states and corners' weights of a cell's children, or of the cell itself."""
    children = solution.brep.states[state].children if last else ()
    matrices = solution.matrices[state]
    born = [
        (child.state, product(matrix, weights[child.state]))
        for child, matrix in zip(children, matrices if children else (), strict=True)
    ]
    return born or [(state, weights[state])]


def _points(spots: Sequence[Floats], corners: Sequence[Indices], scale: float) -> Floats:
    """Return the first occurrence of each vertex; all others have to be where it is."""
    total = 1 + max(int(own.max()) for own in corners)
    points = np.empty((total, 3))
    for spot, own in zip(reversed(spots), reversed(corners), strict=True):
        # Of those that name one vertex the last one written stays.
        points[own.ravel()[::-1]] = spot.reshape(-1, 3)[::-1]
    gap = max(
        float(np.abs(points[own] - spot).max()) for spot, own in zip(spots, corners, strict=True)
    )
    if not gap <= TEAR * scale:
        raise ModelError(
            f"mesh: occurrences of one corner lie {gap:.3g} apart; wanted less than "
            f"{TEAR * scale:.3g}: the constraints do not hold, or weights are too large"
        )
    return points


def _variant(points: Floats, corners: Indices, shape: str, hand: NDArray[np.int8]) -> Indices:
    """Return how each cell is cut: about its shortest diagonal, mirrored where it is."""
    choice = np.zeros(len(corners), np.int64)
    if shape in DIAGONALS:
        ends = points[corners[:, np.array(DIAGONALS[shape])]]
        squares = ((ends[:, :, 1] - ends[:, :, 0]) ** 2).sum(axis=2)
        short = squares.min(axis=1, keepdims=True)
        choice = (squares <= short * (1 + EQUAL)).argmax(axis=1)
    return np.asarray(2 * choice + (hand < 0))
