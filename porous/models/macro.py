"""Many level-0 cells on common control points: what they share, however the axes of each lie.

An entity of such a mesh is its state and the set of all its controls. A cell that names them in
another order than the first one did uses the entity in that order; which orders are legal is the
closure's to say (``models.closure``), before there is any geometry.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.models.automaton import Cells
from porous.models.cell_shapes import CUTS
from porous.models.closure import closure
from porous.models.complex import INTERIOR, CellEntities, Complex
from porous.values.surface_topology import joined
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from porous.models.automaton import Automaton
    from porous.models.brep import BRep
    from porous.models.closure import Closure
    from porous.models.solve import Solution
    from porous.values import HexMesh

    Floats = NDArray[np.float64]
    Order = tuple[int, ...]

WHOLE = 1e-12
"""How far weights may be from 0 and 1 where boundaries are to be some of a cell's controls."""


@dataclass(frozen=True, eq=False)
class MacroMesh(Value):
    """The level-0 cells of a body: the state and the controls of each.

    Parameters
    ----------
    cells
        For each cell the indices of its controls, in the order of its state's.
    states
        The state of each cell, among those of the boundary representation.
    """

    cells: tuple[tuple[int, ...], ...]
    states: tuple[int, ...]

    def __post_init__(self) -> None:
        self._set("cells", tuple(tuple(map(int, cell)) for cell in self.cells))
        self._set("states", tuple(map(int, self.states)))

    def roots(self, brep: BRep, controls: Floats) -> tuple[Cells, ...]:
        """Return where the cells lie, by state, as an automaton's level-0 cells."""
        result = []
        for number, q in enumerate(brep.reached):
            place = np.flatnonzero(np.array(self.states) == q)
            if len(place):
                indices = np.array([self.cells[cell] for cell in place])
                result.append(Cells(number, np.moveaxis(controls[:, indices], 0, 1), place))
        return tuple(result)


def of_hexahedra(mesh: HexMesh) -> tuple[Floats, list[tuple[int, ...]]]:
    """Return the controls (3, n) and cells of a mesh of hexahedra, in the order of a cell's.

    That is x slowest and z fastest; ``with_middles`` makes cells of 27 of them.
    """
    ((element,), _) = CUTS["hexa"][1]
    places = np.argsort(element)
    return mesh.points.T, [tuple(row) for row in mesh.hexahedra[:, places].tolist()]


def with_middles(
    controls: Floats, cells: Sequence[Sequence[int]]
) -> tuple[Floats, list[tuple[int, ...]]]:
    """Return controls (3 or 4, n) and cells of 27 each; those between 8 corners are put midway.

    Cells of another number of controls are left as they are. Neighbours share what lies between
    the same corners. A fourth row are weights.
    """
    line = np.array([[1, 0.5, 0], [0, 0.5, 1]])
    weights = np.kron(line, np.kron(line, line))
    known: dict[frozenset[int], int] = {}
    added: list[Floats] = []
    result = []
    for cell in cells:
        if len(cell) != 8 or not all(0 <= index < controls.shape[1] for index in cell):
            result.append(tuple(cell))
            continue
        own = []
        for column in weights.T:
            between = [cell[corner] for corner in np.flatnonzero(column).tolist()]
            if len(between) > 1 and frozenset(between) not in known:
                known[frozenset(between)] = controls.shape[1] + len(added)
                added.append(_mean(controls[:, list(cell)], column))
            own.append(known[frozenset(between)] if len(between) > 1 else between[0])
        result.append(tuple(own))
    return np.column_stack([controls, *added]), result


def _mean(points: Floats, shares: Floats) -> Floats:
    """Return the mean of points (3, n), or of points with weights (4, n) and its weight."""
    if len(points) == 3:
        return np.asarray(points @ shares)
    own = points[3] * shares
    return np.append(points[:3] @ own / own.sum(), own.sum())


class Slot(NamedTuple):
    """Boundary ``boundary`` of cell ``cell``."""

    cell: int
    boundary: int


class Entity(NamedTuple):
    """A vertex, an edge or a face: its controls as its first cell names them, and its cells."""

    number: int
    controls: tuple[int, ...]
    users: list[Slot]


class Sharing:
    """What the cells of a mesh share: entities, by state and set of controls.

    Parameters
    ----------
    brep
        The states of the cells.
    mesh
        The cells, as ``check_macro`` wants them.

    Raises
    ------
    ModelError
        For faces that do not match, that three cells share, or that are subdivided differently by
        the two cells they belong to; cells in several pieces. Names cells and faces.
    """

    def __init__(self, brep: BRep, mesh: MacroMesh) -> None:
        self.brep, self.mesh = brep, mesh
        self.entities: dict[int, list[Entity]] = defaultdict(list)
        self.ids = [[-1] * len(brep.states[q].boundaries) for q in mesh.states]
        self.orders: list[list[Order]] = [[()] * len(row) for row in self.ids]
        self._meet_all()
        self._check_sides()
        self._check_faces()
        self._check_corners()
        self._check_pieces()

    def text(self, slot: Slot) -> str:
        """Return a boundary as people call it: ``XMAX of cell 3``."""
        state = self.brep.states[self.mesh.states[slot.cell]]
        return f"{state.boundaries[slot.boundary].name} of cell {slot.cell}"

    @property
    def outer(self) -> list[tuple[int, Entity]]:
        """The faces of one cell, with their states."""
        return [(s, face) for s, face in self.faces() if len(face.users) == 1]

    def faces(self) -> list[tuple[int, Entity]]:
        """Return all faces, with their states."""
        return [
            (s, entity)
            for s, found in sorted(self.entities.items())
            for entity in found
            if self.brep.states[s].dimension == 2
        ]

    def check_levels(self, levels: Sequence[object]) -> None:
        """Raise ``ModelError`` for a face of two cells that are divided to other levels."""
        for _, face in self.faces():
            one, *others = face.users
            for other in others:
                if levels[one.cell] != levels[other.cell]:
                    raise ModelError(
                        f"cells: {self.text(one)} and {self.text(other)} are one face, of controls "
                        f"{', '.join(map(str, sorted(face.controls)))}, but are divided to levels "
                        f"{levels[one.cell]} and {levels[other.cell]}; wanted the same level"
                    )

    def closure(self, solution: Solution) -> Closure:
        """Return the closure for the orders in which these cells use their boundaries."""
        starts: dict[int, list[dict[Order, None]]] = {}
        reasons: dict[tuple[int, int, Order], str] = {}
        for cell, q in enumerate(self.mesh.states):
            known = starts.setdefault(q, [{} for _ in self.ids[cell]])
            for k, order in enumerate(self.orders[cell]):
                known[k][order] = None
                reasons.setdefault((q, k, order), self._reason(Slot(cell, k)))
        given = {q: tuple(map(tuple, found)) for q, found in starts.items()}
        return closure(solution, given, reasons)

    def _reason(self, slot: Slot) -> str:
        state = self.brep.states[self.mesh.states[slot.cell]].boundaries[slot.boundary].state
        first = self.entities[state][self.ids[slot.cell][slot.boundary]].users[0]
        return f"{self.text(slot)}, which is {self.text(first)}"

    def complex(self, closure: Closure, names: Mapping[int, str]) -> Complex:
        """Return the level-0 cells as a complex to be refined.

        Parameters
        ----------
        closure
            From ``self.closure``.
        names
            What outer faces are called, by their numbers in ``outer``.
        """
        counts = [len(self.entities.get(q, ())) for q in range(len(self.brep.states))]
        groups = []
        for q in self.brep.reached:
            place = [cell for cell, state in enumerate(self.mesh.states) if state == q]
            if place:
                groups.append(self._group(closure, q, place))
                counts[q] += len(place)
        numbers, closures = _outer_numbers(self)
        origin = [np.full(count, INTERIOR, np.int32) for count in counts]
        for (state, entity), number in numbers.items():
            origin[state][entity] = number
        found = tuple(groups), tuple(origin), self.mesh.states, names, closures
        return Complex(self.brep, 0, tuple(counts), *found)

    def _group(self, closure: Closure, q: int, place: list[int]) -> CellEntities:
        numbers = [closure.orders[s].index for s in closure.slots(q)[:-1]]
        ids = [[*self.ids[cell], number] for number, cell in enumerate(place)]
        orders = [
            [*(n(order) for n, order in zip(numbers, self.orders[cell], strict=True)), 0]
            for cell in place
        ]
        return CellEntities(q, np.array(ids, np.int32), np.array(orders), np.array(place))

    def _meet_all(self) -> None:
        """Number the entities, faces first, and see who uses them in which order."""
        found: dict[frozenset[int], tuple[int, Entity]] = {}
        named = {q: _named_controls(self.brep, q) for q in set(self.mesh.states)}
        for dimension in (2, 1, 0):
            for cell, indices in enumerate(self.mesh.cells):
                q = self.mesh.states[cell]
                for k in self.brep.of_dimension(q, dimension):
                    own = tuple(indices[c] for c in named[q][k])
                    self._meet(Slot(cell, k), own, found)

    def _meet(
        self, slot: Slot, own: tuple[int, ...], found: dict[frozenset[int], tuple[int, Entity]]
    ) -> None:
        state = self.brep.states[self.mesh.states[slot.cell]].boundaries[slot.boundary].state
        key = frozenset(own)
        if key not in found:
            found[key] = state, Entity(len(self.entities[state]), own, [])
            self.entities[state].append(found[key][1])
        kind, entity = found[key]
        if kind != state:
            one, other = (self.brep.states[s] for s in (kind, state))
            pieces = len(one.children), len(other.children)
            why = "by other textures or other states"
            if pieces[0] != pieces[1]:
                why = f"into {pieces[0]} and {pieces[1]} pieces"
            raise ModelError(
                f"cells: {self.text(entity.users[0])} and {self.text(slot)} are one face, of "
                f"controls {', '.join(map(str, sorted(own)))}, but are subdivided differently: "
                f"{why}; wanted the same divisions and textures on both sides"
            )
        entity.users.append(slot)
        self.ids[slot.cell][slot.boundary] = entity.number
        self.orders[slot.cell][slot.boundary] = tuple(entity.controls.index(i) for i in own)

    def inner(self, slot: Slot, dimension: int | None = None) -> set[tuple[int, int]]:
        """Return the boundaries of a cell's boundary as entities: their states and numbers."""
        q = self.mesh.states[slot.cell]
        boundaries = self.brep.states[q].boundaries
        found = set()
        for use in self.brep.sub[q][slot.boundary]:
            s = boundaries[use.boundary].state
            if dimension in (None, self.brep.states[s].dimension):
                found.add((s, self.ids[slot.cell][use.boundary]))
        return found

    def _check_sides(self) -> None:
        """Refuse entities whose cells do not agree on their edges and vertices."""
        for found in self.entities.values():
            for entity in found:
                wanted = self.inner(entity.users[0])
                for slot in entity.users[1:]:
                    if self.inner(slot) != wanted:
                        raise self._mismatch(entity.users[0], slot, "the same controls, twisted")

    def _check_faces(self) -> None:
        for _, entity in self.faces():
            if len(entity.users) > 2:
                cells = ", ".join(str(slot.cell) for slot in entity.users)
                raise ModelError(
                    f"cells: {self.text(entity.users[0])} is a face of {len(entity.users)} cells "
                    f"({cells}); wanted one or two"
                )

    def _check_corners(self) -> None:
        """Refuse two faces with the same corners and most of their edges in common."""
        met: dict[frozenset[tuple[int, int]], list[Slot]] = defaultdict(list)
        for _, entity in self.faces():
            slot = entity.users[0]
            key = frozenset(self.inner(slot, 0))
            for other in met[key]:
                edges = self.inner(slot, 1), self.inner(other, 1)
                if len(edges[0] & edges[1]) >= len(edges[0]) - 1:
                    raise self._mismatch(other, slot, "other controls between the same corners")
            met[key].append(slot)

    def _mismatch(self, one: Slot, other: Slot, what: str) -> ModelError:
        return ModelError(
            f"cells: {self.text(one)} and {self.text(other)}: faces do not match ({what}); wanted "
            "the controls of one face at the same places in both cells"
        )

    def _check_pieces(self) -> None:
        pairs = [entity.users for _, entity in self.faces() if len(entity.users) == 2]
        if len(self.mesh.cells) == 1 or not self.faces():
            return
        ends = np.array([[slot.cell for slot in users] for users in pairs]).reshape(-1, 2)
        piece = joined(len(self.mesh.cells), ends[:, 0], ends[:, 1])
        if piece.any():
            other = int(np.flatnonzero(piece)[0])
            raise ModelError(
                f"cells: are in {int(piece.max()) + 1} pieces; no chain of common faces joins cell "
                f"0 and cell {other}. Wanted one body: controls that cells share named by the same "
                "indices"
            )


def automaton_of(solution: Solution, controls: Floats, mesh: MacroMesh | None) -> Automaton:
    """Return the automaton of a cell that lies where its controls do, or of a mesh of them."""
    if mesh is None:
        return solution.automaton(controls)
    return solution.automaton(roots=mesh.roots(solution.brep, controls))


def _outer_numbers(
    sharing: Sharing,
) -> tuple[dict[tuple[int, int], int], dict[int, tuple[int, ...]]]:
    """Return the numbers of outer entities, faces first, and all that lies in each face."""
    numbers = {(s, face.number): n for n, (s, face) in enumerate(sharing.outer)}
    closures = {}
    for n, (_, face) in enumerate(sharing.outer):
        inner = sorted(sharing.inner(face.users[0]))
        closures[n] = (n, *(numbers.setdefault(e, len(numbers)) for e in inner))
    return numbers, closures


def _named_controls(brep: BRep, q: int) -> list[tuple[int, ...]]:
    """Return which of a cell's controls are those of each of its boundaries."""
    result = []
    for boundary in brep.states[q].boundaries:
        which = boundary.matrix.argmax(axis=0)
        gap = np.abs(boundary.matrix - np.eye(len(boundary.matrix))[:, which]).max()
        if gap > WHOLE:
            raise ModelError(
                f"cells: boundary {boundary.name} of state {brep.states[q].name} has controls that "
                "are mixed of the cell's; wanted some of the cell's own, for cells to share them"
            )
        result.append(tuple(which.tolist()))
    return result


def check_macro(brep: BRep, mesh: MacroMesh, controls: int) -> None:
    """Raise ``ModelError`` for cells that are none, given how many control points there are.

    Cells with a control too many, that is not there or named twice; a control of no cell; cells
    that are the same. Names the cell.
    """
    check_indices(mesh.cells, controls)
    met: dict[frozenset[int], int] = {}
    for cell, (q, indices) in enumerate(zip(mesh.states, mesh.cells, strict=True)):
        size = brep.states[q].size
        if len(indices) != size:
            raise ModelError(f"cells[{cell}]: got {len(indices)} controls; wanted {size}")
        twice = [index for index in indices if indices.count(index) > 1]
        if twice:
            raise ModelError(
                f"cells[{cell}]: names control {twice[0]} twice; wanted {size} different ones (a "
                "cell that meets itself has to be cut into two)"
            )
        same = met.setdefault(frozenset(indices), cell)
        if same != cell:
            raise ModelError(f"cells[{cell}]: has the controls of cells[{same}]; wanted each once")
    _check_used(mesh.cells, controls)


def check_indices(cells: Sequence[Sequence[int]], controls: int) -> None:
    """Raise ``ModelError`` for a cell that names a control that is not there."""
    for cell, indices in enumerate(cells):
        for index in indices:
            if not 0 <= index < controls:
                raise ModelError(
                    f"cells[{cell}]: names control {index}; there are {controls}, numbered from 0"
                )


def _check_used(cells: Sequence[Sequence[int]], controls: int) -> None:
    unused = sorted(set(range(controls)).difference(*cells))
    if unused:
        raise ModelError(f"controls[{unused[0]}]: belongs to no cell; wanted each in some cell")
