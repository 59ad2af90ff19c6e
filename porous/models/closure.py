"""What a state's children are of its parts: the closure of the constraints, once per state.

Every boundary of every child of a state is an *own entity* of the state (one of the children, or
a vertex, edge or face between them) or an own entity of one of the state's boundaries. Which it
is follows from the constraints alone, symbolically; with that table a cell complex is refined by
arithmetic on numbers (``models.complex``) and counted by a matrix (``models.counts``).

An order says in which order a slot names the controls of its entity: slot = entity·I[:, order].
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from porous.errors import ModelError
from porous.models.brep import Use, find_use
from porous.models.slots import Slots, identity, inverse, then
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from numpy.typing import NDArray

    from porous.models.brep import Adjacency, BRep, Incidence
    from porous.models.slots import Node
    from porous.models.solve import Solution

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]
    Order = tuple[int, ...]
    Starts = Mapping[int, tuple[tuple[Order, ...], ...]]
    Reasons = Mapping[tuple[int, int, Order], str]

OWN = -1
"""Stands for the state itself where a boundary is named."""


class Own(NamedTuple):
    """An entity that a state's split makes inside it: its state and weights (m, m_entity)."""

    state: int
    weights: Floats


class Entry(NamedTuple):
    """Own entity ``own`` of boundary ``boundary`` (``OWN``: of the state itself) in an order.

    ``order`` is an index among ``Closure.orders`` of the entity's state.
    """

    boundary: int
    own: int
    order: int


class Part(NamedTuple):
    """Boundary ``slot`` of child ``child`` is own entity ``own`` of the boundary it lies in."""

    child: int
    slot: int
    own: int
    order: int


class Place(NamedTuple):
    """An entry with its order written out."""

    boundary: int
    own: int
    order: Order


At = TypeVar("At", Entry, Place)


@dataclass(frozen=True, eq=False)
class Closure(Value):
    """The closure of a system's constraints.

    Attributes
    ----------
    brep
        The states.
    own
        For each state its own entities.
    table
        ``table[q][i][k]`` for boundary k of child i of state q, the child itself after its last
        boundary. A terminal state counts as its own only child, of which every boundary stays.
        Empty for states that the start does not need.
    orders
        For each state the orders in which it is used; the identity first.
    act
        For each state int64 (orders, own entities, 2): the own entity and its order that own
        entity t is seen as through an order, Π·W_t = W_t'·Π'. −1 for orders that no cell uses.
    compose
        For each state int64 (orders, orders): the order of I[:, a]·I[:, b]; −1 where unused.
    uses
        ``uses[q][k]``: the orders in which cells of state q use their boundary k, of level-0
        cells and of all that come of them; last those of the cell itself.
    """

    brep: BRep
    own: tuple[tuple[Own, ...], ...]
    table: tuple[tuple[tuple[Entry, ...], ...], ...]
    orders: tuple[tuple[Order, ...], ...]
    act: tuple[Ints, ...]
    compose: tuple[Ints, ...]
    uses: tuple[tuple[tuple[int, ...], ...], ...]

    @cached_property
    def children(self) -> tuple[tuple[int, ...], ...]:
        """The states of each state's children; of a terminal state, itself."""
        return tuple(
            tuple(child.state for child in state.children) or (q,)
            for q, state in enumerate(self.brep.states)
        )

    @cached_property
    def inside(self) -> tuple[tuple[tuple[Part, ...], ...], ...]:
        """The table by where things lie: for each state and boundary the children's slots in it.

        After the last boundary what lies on none.
        """
        return tuple(
            tuple(
                tuple(Part(i, k, at.own, at.order) for i, k, at in found)
                for found in _by_boundary(rows, len(state.boundaries))
            )
            for rows, state in zip(self.table, self.brep.states, strict=True)
        )

    def slots(self, state: int) -> tuple[int, ...]:
        """Return the states of a cell's boundaries, in their order, and of the cell itself."""
        return (*(b.state for b in self.brep.states[state].boundaries), state)


def closure(
    solution: Solution, starts: Starts | None = None, reasons: Reasons | None = None
) -> Closure:
    """Return what every boundary of every child is, from the constraints alone.

    Parameters
    ----------
    solution
        The states and their matrices; weights are compared only to learn what an order does.
    starts
        For each state of level-0 cells and each of its boundaries the orders in which those cells
        name its controls; not given: one cell of the start's state, all as they come.
    reasons
        For a state, boundary and order of these who asks for it, for people to read.

    Raises
    ------
    ModelError
        Where constraints put one thing in two places or make something its own reversal; where a
        state is not symmetric under an order in which it is used; where a boundary of a terminal
        cell goes on into several entities. Names the constraints.
    """
    brep = solution.brep
    if starts is None:
        bare = [identity(brep.states[b.state].size) for b in brep.states[brep.start].boundaries]
        starts = {brep.start: tuple((order,) for order in bare)}
    work = _Work(brep, solution.matrices)
    needed = _needed(brep, starts)
    for q in brep.by_dimension:
        if q in needed:
            work.split(q)
    return _numbered(work, work.follow(starts, reasons or {}))


def _needed(brep: BRep, starts: Starts) -> set[int]:
    found = list(starts)
    for q in found:
        state = brep.states[q]
        more = [c.state for c in state.children] + [b.state for b in state.boundaries]
        found += [s for s in dict.fromkeys(more) if s not in found]
    return set(found)


class _Work:
    """Tables under construction, with their orders written out."""

    def __init__(self, brep: BRep, matrices: tuple[tuple[Floats, ...], ...]) -> None:
        self.brep = brep
        self.matrices = matrices
        self.own: list[list[Own]] = [[] for _ in brep.states]
        self.table: list[list[list[Place]]] = [[] for _ in brep.states]
        self.slots: dict[int, Slots] = {}
        self.images: dict[tuple[int, Order], tuple[tuple[int, Order], ...]] = {}
        self._turned: dict[tuple[int, Order], tuple[Use, ...]] = {}
        self._inside: dict[int, list[list[tuple[int, int, Place]]]] = {}
        self._bare = [identity(state.size) for state in brep.states]

    def entity(self, q: int, boundary: int) -> int:
        """Return the state of a boundary, or q itself for ``OWN`` and after the last boundary."""
        boundaries = self.brep.states[q].boundaries
        return boundaries[boundary].state if 0 <= boundary < len(boundaries) else q

    def kind(self, q: int, at: Place) -> int:
        """Return the state of the entity at a place of a state's table."""
        return self.own[self.entity(q, at.boundary)][at.own].state

    def split(self, q: int) -> None:
        """Find what the children of a state and their boundaries are."""
        if not self.brep.states[q].children:
            self._carry(q)
            return
        slots = Slots(lambda constraint: self.brep.text(q, constraint))
        for at in self.brep.states[q].incidences:
            for slot, node, order in self._anchored(q, at):
                slots.join(slot, node, order, at)
        for to in self.brep.states[q].adjacencies:
            for slot, node, order in self._joined(q, to):
                slots.join(slot, node, order, to)
        self.slots[q] = slots
        self._number(q, slots)

    def _carry(self, q: int) -> None:
        self.own[q] = [Own(q, frozen(np.eye(self.brep.states[q].size), np.float64))]
        row = [
            Place(k, 0, self._bare[b.state]) for k, b in enumerate(self.brep.states[q].boundaries)
        ]
        self.table[q] = [[*row, Place(OWN, 0, self._bare[q])]]

    def _number(self, q: int, slots: Slots) -> None:
        """Write the table: what is on no boundary is own, named as its first slot names it."""
        first: dict[Node, tuple[int, Order]] = {}
        for i, child in enumerate(self.brep.states[q].children):
            row = []
            matrices = [b.matrix for b in self.brep.states[child.state].boundaries]
            states = [b.state for b in self.brep.states[child.state].boundaries]
            for k, s in enumerate([*states, child.state]):
                root, order = slots.find((i, k), self.brep.states[s].size)
                if root[0] < 0:
                    row.append(Place(root[1], root[2], order))
                    continue
                if root not in first:
                    weights = self.matrices[q][i]
                    weights = weights @ matrices[k] if k < len(matrices) else weights
                    first[root] = len(self.own[q]), inverse(order)
                    self.own[q].append(Own(s, frozen(weights, np.float64)))
                number, back = first[root]
                row.append(Place(OWN, number, then(back, order)))
            self.table[q].append(row)

    def _anchored(self, q: int, at: Incidence) -> Iterator[tuple[Node, Node, Order]]:
        """Yield what an incidence puts on the boundary: the slot and all its own boundaries."""
        child = self.brep.states[q].children[at.child].state
        shared = self.brep.states[child].boundaries[at.boundary].state
        order = at.order or self._bare[shared]
        row = self.table[self.brep.states[q].boundaries[at.face].state][at.letter]
        why = self.brep.text(q, at)
        for slot, use in self._parts(child, at.boundary, shared, order, why):
            spot = self._lifted(q, at.face, row[use.boundary], why)
            yield (at.child, slot), (OWN, spot.boundary, spot.own), then(spot.order, use.order)

    def _joined(self, q: int, to: Adjacency) -> Iterator[tuple[Node, Node, Order]]:
        """Yield what an adjacency makes one: the slots and all their boundaries."""
        children = self.brep.states[q].children
        child, other = children[to.child].state, children[to.other].state
        shared = self.brep.states[child].boundaries[to.boundary].state
        order = to.order or self._bare[shared]
        whole = Use(to.other_boundary, self._bare[shared])
        theirs = (*self.brep.sub[other][to.other_boundary], whole)
        for slot, use in self._parts(child, to.boundary, shared, order, self.brep.text(q, to)):
            target = theirs[use.boundary]
            yield (to.child, slot), (to.other, target.boundary), then(target.order, use.order)

    def _parts(
        self, child: int, boundary: int, shared: int, order: Order, why: str
    ) -> Iterator[tuple[int, Use]]:
        """Yield a child's boundary and its own boundaries, and which of the other side's each is.

        The other side's are numbered as the boundaries of ``shared``, itself after the last.
        """
        turned = self.turned(shared, order, why)
        for mine, use in zip(self.brep.sub[child][boundary], turned, strict=True):
            yield mine.boundary, Use(use.boundary, then(use.order, inverse(mine.order)))
        yield boundary, Use(len(turned), order)

    def _lifted(self, q: int, face: int, spot: Place, why: str) -> Place:
        """Return for a place in a boundary's table which place in the cell's that is."""
        if spot.boundary == OWN:
            return Place(face, spot.own, spot.order)
        use = self.brep.sub[q][face][spot.boundary]
        state = self.brep.states[q].boundaries[use.boundary].state
        own, order = self.image(state, use.order, why)[spot.own]
        return Place(use.boundary, own, then(order, spot.order))

    def turned(self, q: int, order: Order, why: str) -> tuple[Use, ...]:
        """Return which boundary each boundary is seen as: Π·B_k = B_k'·Π'."""
        key = q, order
        if key not in self._turned:
            boundaries = self.brep.states[q].boundaries
            found = []
            for k, boundary in enumerate(boundaries):
                use: Use | None = Use(k, self._bare[boundary.state])
                if order != self._bare[q]:
                    same = [
                        (e, b.matrix) for e, b in enumerate(boundaries) if b.state == boundary.state
                    ]
                    use = find_use(_moved(boundary.matrix, order), same)
                if use is None:
                    raise self._asymmetric(q, order, why)
                found.append(use)
            self._turned[key] = tuple(found)
        return self._turned[key]

    def image(self, q: int, order: Order, why: str) -> tuple[tuple[int, Order], ...]:
        """Return which own entity each own entity is seen as, and in which order."""
        key = q, order
        if key not in self.images:
            if order == self._bare[q]:
                found = tuple((t, self._bare[own.state]) for t, own in enumerate(self.own[q]))
            elif not self.brep.states[q].children:
                found = ((0, order),)
            else:
                found = self._symmetry(q, order, why)
            self.images[key] = found
        return self.images[key]

    def _symmetry(self, q: int, order: Order, why: str) -> tuple[tuple[int, Order], ...]:
        """Follow an order through the table: all children and what they share must agree."""
        faces = self.turned(q, order, why)
        found: dict[int, tuple[int, Order]] = {}
        children = self.brep.states[q].children
        for i, (other, seen) in enumerate(self._children_turned(q, order, why)):
            inner = (
                *self.turned(children[i].state, seen, why),
                Use(len(self.table[q][i]) - 1, seen),
            )
            for spot, use in zip(self.table[q][i], inner, strict=True):
                target = self.table[q][other][use.boundary]
                new = target.own, then(then(target.order, use.order), inverse(spot.order))
                if spot.boundary == OWN:
                    wanted, face = found.setdefault(spot.own, new), OWN
                else:
                    state = self.brep.states[q].boundaries[spot.boundary].state
                    face = faces[spot.boundary].boundary
                    wanted = self.image(state, faces[spot.boundary].order, why)[spot.own]
                if wanted != new or target.boundary != face:
                    raise self._asymmetric(q, order, why)
        return tuple(found[t] for t in range(len(self.own[q])))

    def _children_turned(self, q: int, order: Order, why: str) -> list[tuple[int, Order]]:
        left = set(range(len(self.matrices[q])))
        result = []
        for child, matrix in zip(self.brep.states[q].children, self.matrices[q], strict=True):
            wanted = _moved(matrix, order)
            alike = [
                j for j in sorted(left) if self.brep.states[q].children[j].state == child.state
            ]
            found = find_use(wanted, [(j, self.matrices[q][j]) for j in alike])
            if found is None:
                raise self._asymmetric(q, order, why)
            left.discard(found.boundary)
            result.append((found.boundary, found.order))
        return result

    def _asymmetric(self, q: int, order: Order, why: str) -> ModelError:
        return ModelError(
            f"state {self.brep.states[q].name} is not symmetric under {order}; wanted by {why}"
        )

    def follow(self, starts: Starts, reasons: Reasons) -> dict[tuple[int, int], dict[Order, str]]:
        """Find in which orders cells use their boundaries, level after level, and why."""
        uses: dict[tuple[int, int], dict[Order, str]] = {}
        queue: deque[tuple[int, int, Order]] = deque()

        def meet(q: int, k: int, order: Order, why: str) -> None:
            if order not in uses.setdefault((q, k), {}):
                uses[q, k][order] = why
                queue.append((q, k, order))

        for q, boundaries in starts.items():
            meet(q, len(boundaries), self._bare[q], "a level-0 cell")
            for k, given in enumerate(boundaries):
                for order in given:
                    meet(q, k, order, reasons.get((q, k, order), "a level-0 cell"))
        while queue:
            q, k, order = queue.popleft()
            for step in self._steps(q, k, order, uses[q, k][order]):
                meet(*step)
        return uses

    def _steps(
        self, q: int, k: int, order: Order, why: str
    ) -> Iterator[tuple[int, int, Order, str]]:
        """Yield how the children of a cell use what their parent's boundary becomes."""
        state = self.brep.states[q]
        entity = self.entity(q, k)
        self._check_carried(q, k, entity)
        seen = self.image(entity, order, why)
        if q not in self._inside:
            self._inside[q] = _by_boundary(self.table[q], len(state.boundaries))
        for i, slot, spot in self._inside[q][k]:
            new = then(seen[spot.own][1], spot.order)
            plain = spot.order == identity(len(new))
            reason = why if plain else self.slots[q].because((i, slot), len(new))
            yield state.children[i].state if state.children else q, slot, new, reason

    def _check_carried(self, q: int, k: int, entity: int) -> None:
        """Refuse a boundary of a terminal cell that is cut or changed while the cell stays."""
        state = self.brep.states[q]
        if state.children or k == len(state.boundaries):
            return
        if [own.state for own in self.own[entity]] != [entity]:
            raise ModelError(
                f"state {state.name} is terminal, but its boundary {state.boundaries[k].name} goes "
                f"on into {len(self.own[entity])} entities of its own: a refined neighbour would "
                f"leave hanging nodes; wanted a state {self.brep.states[entity].name} that is "
                "terminal or its own only child"
            )


def _numbered(work: _Work, uses: dict[tuple[int, int], dict[Order, str]]) -> Closure:
    """Return the tables with orders as numbers."""
    brep = work.brep
    orders = _orders(work, uses)
    table = tuple(
        tuple(
            tuple(Entry(at.boundary, at.own, orders[work.kind(q, at)][at.order]) for at in row)
            for row in rows
        )
        for q, rows in enumerate(work.table)
    )
    return Closure(
        brep,
        tuple(map(tuple, work.own)),
        table,
        tuple(map(tuple, orders)),
        tuple(_act(work, q, orders) for q in range(len(brep.states))),
        tuple(map(_compose, orders)),
        tuple(_uses(work, q, orders, uses) for q in range(len(brep.states))),
    )


def _uses(
    work: _Work,
    q: int,
    orders: list[dict[Order, int]],
    uses: dict[tuple[int, int], dict[Order, str]],
) -> tuple[tuple[int, ...], ...]:
    return tuple(
        tuple(orders[work.entity(q, k)][order] for order in uses.get((q, k), ()))
        for k in range(len(work.brep.states[q].boundaries) + 1)
    )


def _orders(work: _Work, uses: dict[tuple[int, int], dict[Order, str]]) -> list[dict[Order, int]]:
    """Number for each state all orders that occur, the identity first."""
    result = [{identity(state.size): 0} for state in work.brep.states]
    met = [(work.entity(q, k), order) for (q, k), found in uses.items() for order in found]
    met += [
        (work.kind(q, at), at.order)
        for q in range(len(result))
        for row in work.table[q]
        for at in row
    ]
    for (q, order), image in work.images.items():
        met += [(q, order), *((work.own[q][t].state, seen) for t, seen in image)]
    for state, order in met:
        result[state].setdefault(order, len(result[state]))
    return result


def _act(work: _Work, q: int, orders: list[dict[Order, int]]) -> Ints:
    result = np.full((len(orders[q]), len(work.own[q]), 2), -1)
    for (state, order), image in work.images.items():
        if state == q:
            for t, (own, seen) in enumerate(image):
                result[orders[q][order], t] = own, orders[work.own[q][own].state][seen]
    return np.asarray(frozen(result, np.int64))


def _compose(orders: dict[Order, int]) -> Ints:
    result = [[orders.get(then(a, b), -1) for b in orders] for a in orders]
    return np.asarray(frozen(result, np.int64))


def _by_boundary(rows: Iterable[Iterable[At]], last: int) -> list[list[tuple[int, int, At]]]:
    """Return the slots of a table by the boundary that they lie in; ``OWN`` is ``last``."""
    result: list[list[tuple[int, int, At]]] = [[] for _ in range(last + 1)]
    for i, row in enumerate(rows):
        for k, at in enumerate(row):
            result[at.boundary].append((i, k, at))
    return result


def _moved(matrix: Floats, order: Order) -> Floats:
    """Return Π·matrix with Π = I[:, order]."""
    return matrix[list(inverse(order))]
