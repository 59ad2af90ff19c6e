"""The cell complex of a level: which cells share which faces, edges and vertices, exactly.

Entities are whole numbers and no coordinates are looked at. Entity e of state b makes own entity
t of its split at the number base + e·stride + rank of t, so that one level's arrays give the
next's by arithmetic; what no cell uses is dropped and the rest numbered anew.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.memory import check_memory
from porous.models.closure import OWN
from porous.values.value import Value, adopted, frozen

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from porous.models.brep import BRep
    from porous.models.closure import Closure

    Ints = NDArray[np.int64]
    Ids = NDArray[np.signedinteger[Any]]

INTERIOR = -1
"""Origin of what lies on no outer boundary of the level-0 cells."""

REMEDY = "Choose a lower level."


@dataclass(frozen=True, eq=False)
class CellEntities(Value):
    """The cells of one state and what their boundaries are.

    Parameters
    ----------
    state
        Index among the states of the system.
    ids
        Integers (c, boundaries + 1): the number, among the entities of its state, of each
        boundary of each cell; last that of the cell itself.
    orders
        int16 (c, boundaries + 1): the order, among ``Closure.orders`` of the entity's state, in
        which the cell names the controls of each boundary.
    place
        int64 (c,): the cell's place among all cells in the order of their addresses.
    """

    state: int
    ids: Ids
    orders: NDArray[np.int16]
    place: Ints

    def __post_init__(self) -> None:
        self._set("ids", frozen(self.ids, np.asarray(self.ids).dtype))
        self._set("orders", frozen(self.orders, np.int16))
        self._set("place", frozen(self.place, np.int64))


@dataclass(frozen=True, eq=False)
class Complex(Value):
    """Cells, and the faces, edges and vertices that they share.

    Parameters
    ----------
    brep
        The states.
    level
        How often level-0 cells were refined.
    states
        For each state how many entities of it the cells use; they are numbered from zero.
    cells
        By state, in the order of ``brep.reached``.
    origin
        For each state, for each entity: the outer boundary of the level-0 cells that it descends
        from, or ``INTERIOR``. Of one cell all boundaries are outer, and numbered as it does.
    starts
        The states of the level-0 cells, in the order of their places.
    faces
        What outer faces are called, by their numbers.
    closures
        For each outer face all the outer boundaries that lie in it.
    """

    brep: BRep
    level: int
    states: tuple[int, ...]
    cells: tuple[CellEntities, ...]
    origin: tuple[NDArray[np.int32], ...]
    starts: tuple[int, ...] = ()
    faces: Mapping[int, str] = field(default_factory=dict)
    closures: Mapping[int, tuple[int, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("faces", "closures"):
            self._set(name, MappingProxyType(dict(getattr(self, name))))

    def count(self, dimension: int) -> int:
        """Return the number of vertices, edges, faces or volumes: dimension 0, 1, 2 or 3."""
        return sum(
            count
            for state, count in zip(self.brep.states, self.states, strict=True)
            if state.dimension == dimension
        )

    @property
    def euler_number(self) -> int:
        """V − E + F − C of the closed complex: cells that share a vertex are joined there."""
        return sum((-1) ** dimension * self.count(dimension) for dimension in range(4))

    @cached_property
    def offsets(self) -> Ints:
        """Where each state's entities begin when those of each dimension are numbered together."""
        result = np.zeros(len(self.states), np.int64)
        for dimension in range(4):
            which = [q for q, s in enumerate(self.brep.states) if s.dimension == dimension]
            result[which] = np.cumsum([0, *(self.states[q] for q in which)])[:-1]
        return np.asarray(frozen(result, np.int64))

    def ids_of(self, cells: CellEntities, dimension: int) -> Ints:
        """Return the cells' boundaries of a dimension, (c, n), numbered over all states."""
        slots = list(self.brep.of_dimension(cells.state, dimension))
        states = [self.brep.states[cells.state].boundaries[k].state for k in slots]
        return np.asarray(cells.ids[:, slots] + self.offsets[states])

    def vertex_ids(self, cells: CellEntities) -> Ints:
        """Return the cells' vertices (c, n), numbered 0 … V − 1 over all states.

        In the order of ``brep.of_dimension(cells.state, 0)``.
        """
        return self.ids_of(cells, 0)

    @cached_property
    def components(self) -> int:
        """The number of pieces of the closed complex: cells that share anything are joined."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        start = np.cumsum([0, *self.states])
        pairs = [np.zeros((2, 0), np.int64)]
        for group in self.cells:
            itself = group.ids[:, -1] + start[group.state]
            for k, boundary in enumerate(self.brep.states[group.state].boundaries):
                if self._joins(boundary.state):
                    pairs.append(np.stack([itself, group.ids[:, k] + start[boundary.state]]))
        rows, columns = np.hstack(pairs)
        used = np.zeros(start[-1], bool)
        used[rows] = used[columns] = True
        for group in self.cells:
            used[group.ids[:, -1] + start[group.state]] = True
        graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(len(used),) * 2)
        pieces = int(connected_components(graph, directed=False)[0])
        return pieces - int((~used).sum())

    def _joins(self, state: int) -> bool:
        # What shares an edge or a face shares its vertices, where it has any.
        inner = [b.state for b in self.brep.states[state].boundaries]
        return not any(self.brep.states[s].dimension == 0 for s in inner)


def cell_complex(closure: Closure, level: int, start: Complex | None = None) -> Complex:
    """Return the complex of the level-``level`` cells.

    Parameters
    ----------
    closure
        What the children of each state share.
    level
        How often the start is refined; terminal cells stay.
    start
        Level-0 cells; one cell of the start's state where not given.

    Raises
    ------
    ModelError
        For a negative level, or a start in orders that the closure was not made for.
    MemoryLimitError
        Before anything is allocated.
    """
    if level < 0:
        raise ModelError(f"level: got {level}; wanted 0 or more")
    result = level_zero(closure, start)
    _check_level(closure, result, level)
    for _ in range(level):
        result = _refined(closure, result)
    return result


def level_zero(closure: Closure, start: Complex | None = None) -> Complex:
    """Return the level-0 cells, one of the start's state where not given.

    Raises
    ------
    ModelError
        Where they use a state in an order that the closure was not made for.
    """
    if start is None:
        return _single(closure)
    for group in start.cells:
        for k, s in enumerate(closure.slots(group.state)):
            if not set(np.unique(group.orders[:, k]).tolist()) <= set(closure.uses[group.state][k]):
                raise ModelError(
                    f"state {closure.brep.states[s].name}: level-0 cells of state "
                    f"{closure.brep.states[group.state].name} use it in orders that the closure "
                    "does not know; wanted a closure made for these cells"
                )
    return start


def _single(closure: Closure) -> Complex:
    brep = closure.brep
    slots = closure.slots(brep.start)
    ids, states = [], [0] * len(brep.states)
    origin: list[list[int]] = [[] for _ in brep.states]
    for k, s in enumerate(slots):
        ids.append(states[s])
        states[s] += 1
        origin[s].append(k if k < len(slots) - 1 else INTERIOR)
    row = np.array([ids], np.int32)
    cells = CellEntities(brep.start, row, np.zeros_like(row, np.int16), np.zeros(1, np.int64))
    faces = brep.of_dimension(brep.start, 2)
    return Complex(
        brep,
        0,
        tuple(states),
        (cells,),
        tuple(np.array(o, np.int32) for o in origin),
        (brep.start,),
        {k: brep.states[brep.start].boundaries[k].name for k in faces},
        {k: (k, *(use.boundary for use in brep.sub[brep.start][k])) for k in faces},
    )


def cell_counts(closure: Closure, level: int, start: Sequence[int]) -> list[int]:
    """Return how many cells of each state there are after ``level`` refinements, exact."""
    counts = list(start)
    for _ in range(level):
        finer = [0] * len(counts)
        for state, many in enumerate(counts):
            for target in closure.children[state] if many else ():
                finer[target] += many
        counts = finer
    return counts


def _check_level(closure: Closure, start: Complex, level: int) -> None:
    counts = [0] * len(start.states)
    for group in start.cells:
        counts[group.state] += len(group.place)
    amounts = cell_counts(closure, level, counts)
    # Numbers and orders of the level, what they were before numbering anew, and a temporary.
    needed = sum(many * len(closure.slots(q)) * 20 for q, many in enumerate(amounts) if many)
    check_memory(needed, f"the complex of level {level} ({sum(amounts)} cells)", REMEDY)


class _Numbering(NamedTuple):
    """Where the own entities of each state's entities are numbered, before any is dropped."""

    first: tuple[Ints, ...]
    """For each state b and own entity t: the number of t of entity 0 of b."""
    stride: tuple[Ints, ...]
    """For each state b and own entity t: how much further t of the next entity of b is."""
    totals: tuple[int, ...]
    """For each state how many entities there are."""


class _Born(NamedTuple):
    """Cells of one state that have just been made; arrays still to be written to."""

    state: int
    ids: Ids
    orders: NDArray[np.int16]
    place: Ints


def _refined(closure: Closure, coarse: Complex) -> Complex:
    numbering = _numbering(closure, coarse)
    groups = _offspring(closure, coarse, numbering)
    marks = [np.zeros(total, bool) for total in numbering.totals]
    columns = [(group, k, s) for group in groups for k, s in enumerate(closure.slots(group.state))]
    for group, k, s in columns:
        marks[s][group.ids[:, k]] = True
    numbers = [np.cumsum(mark, dtype=groups[0].ids.dtype) for mark in marks]
    for group, k, s in columns:
        group.ids[:, k] = numbers[s][group.ids[:, k]] - 1
    cells = tuple(
        CellEntities(g.state, adopted(g.ids), adopted(g.orders), adopted(g.place)) for g in groups
    )
    counts = tuple(int(mark.sum()) for mark in marks)
    origin = tuple(o[m] for o, m in zip(_origins(closure, coarse), marks, strict=True))
    return replace(coarse, level=coarse.level + 1, states=counts, cells=cells, origin=origin)


def _numbering(closure: Closure, coarse: Complex) -> _Numbering:
    totals = [0] * len(coarse.states)
    first, stride = [], []
    for b, own in enumerate(closure.own):
        rank: Counter[int] = Counter()
        base = list(totals)
        starts = []
        for entity in own:
            starts.append(base[entity.state] + rank[entity.state])
            rank[entity.state] += 1
            totals[entity.state] += coarse.states[b]
        first.append(np.array(starts, np.int64))
        stride.append(np.array([rank[entity.state] for entity in own], np.int64))
    check_memory(13 * sum(totals), f"the complex of level {coarse.level + 1}", REMEDY)
    return _Numbering(tuple(first), tuple(stride), tuple(totals))


def _origins(closure: Closure, coarse: Complex) -> list[NDArray[np.int32]]:
    """Return the origin of every entity of the next level, in their numbering."""
    parts: list[list[NDArray[np.int32]]] = [[np.zeros(0, np.int32)] for _ in coarse.states]
    for b, own in enumerate(closure.own):
        for s, many in Counter(entity.state for entity in own).items():
            parts[s].append(np.repeat(coarse.origin[b], many))
    return [np.concatenate(part) for part in parts]


def _offspring(closure: Closure, coarse: Complex, numbering: _Numbering) -> list[_Born]:
    """Return the children of all cells by state, each state's in the order of their places."""
    kind = np.dtype(np.int32 if max(numbering.totals) < 2**31 else np.int64)
    fan = np.empty(sum(len(group.place) for group in coarse.cells), np.int64)
    for group in coarse.cells:
        fan[group.place] = len(closure.table[group.state])
    first = np.cumsum(fan) - fan
    born: dict[int, list[_Born]] = {}
    for group in coarse.cells:
        children = closure.children[group.state]
        for target in dict.fromkeys(children):
            letters = [i for i, state in enumerate(children) if state == target]
            shape = len(group.place), len(letters), len(closure.slots(target))
            ids, orders = np.empty(shape, kind), np.zeros(shape, np.int16)
            for j, i in enumerate(letters):
                _fill(closure, numbering, group, i, ids[:, j], orders[:, j])
            place = first[group.place][:, None] + np.array(letters)
            many = len(group.place) * len(letters)
            parts = ids.reshape(many, -1), orders.reshape(many, -1), place.reshape(-1)
            born.setdefault(target, []).append(_Born(target, *parts))
    return [_merged(born[state]) for state in closure.brep.reached if state in born]


def _fill(
    closure: Closure,
    numbering: _Numbering,
    parents: CellEntities,
    child: int,
    ids: Ids,
    orders: NDArray[np.int16],
) -> None:
    """Write what the boundaries of one child of each parent are: the table's row."""
    slots = closure.slots(parents.state)
    for k, (boundary, own, order) in enumerate(closure.table[parents.state][child]):
        b = slots[boundary]
        first, stride = numbering.first[b], numbering.stride[b][own]
        kind = closure.own[b][own].state
        if len(closure.orders[b]) == 1 or boundary == OWN:
            ids[:, k] = parents.ids[:, boundary] * stride + first[own]
            orders[:, k] = order
        else:
            seen = closure.act[b][parents.orders[:, boundary], own]
            ids[:, k] = parents.ids[:, boundary] * stride + first[seen[:, 0]]
            orders[:, k] = closure.compose[kind][seen[:, 1], order]


def _merged(parts: list[_Born]) -> _Born:
    if len(parts) == 1:
        return parts[0]
    place = np.concatenate([part.place for part in parts])
    order = np.argsort(place, kind="stable")
    ids, orders = (np.concatenate([part[f] for part in parts])[order] for f in (1, 2))
    return _Born(parts[0].state, ids, orders, place[order])
