"""Which boundaries children share with the cell's boundaries and with each other.

Every control of a child has a label: two controls are one where their labels are. Boundaries
are one where the sets of their labels are. A constraint is written where none of those between
boundaries of a higher dimension implies it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from porous.models.brep import Adjacency, Incidence

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

    Labels = Sequence[Hashable]
    Key = frozenset[Hashable]
    Order = tuple[int, ...]

CELL = -1
"""Stands for the cell itself among its children."""


class Part(NamedTuple):
    """A boundary of a child: its dimension and which of the child's controls are its own."""

    dimension: int
    indices: tuple[int, ...]


class Placed(NamedTuple):
    """A child: the labels of its controls and its boundaries in their order."""

    labels: Labels
    parts: Sequence[Part]


class Covered(NamedTuple):
    """Child ``letter`` of the cell's boundary ``face``, by the labels of its controls."""

    face: int
    letter: int
    labels: Labels


class _Slot(NamedTuple):
    child: int
    boundary: int
    labels: tuple[Hashable, ...]


class _Classes:
    """Union-find over pairs of a shared boundary and a child that has it, or the cell."""

    def __init__(self) -> None:
        self.above: dict[tuple[Key, int], tuple[Key, int]] = {}

    def find(self, node: tuple[Key, int]) -> tuple[Key, int]:
        while node in self.above:
            node = self.above[node]
        return node

    def unite(self, a: tuple[Key, int], b: tuple[Key, int]) -> bool:
        """Return whether they were not one before; the cell's own class stays on top."""
        a, b = self.find(a), self.find(b)
        if a == b:
            return False
        if b[1] == CELL:
            a, b = b, a
        self.above[b] = a
        return True


def joins(
    children: Sequence[Placed], covered: Sequence[Covered]
) -> tuple[tuple[Incidence, ...], tuple[Adjacency, ...]]:
    """Return the incidences and adjacencies of a cell, those of high dimension first.

    Parameters
    ----------
    children
        In the order of the letters. Boundaries of a child are nested where their indices are.
    covered
        All children of all the cell's boundaries.
    """
    targets: dict[Key, Covered] = {}
    for item in covered:
        targets.setdefault(frozenset(item.labels), item)
    classes, incidences, adjacencies = _Classes(), list[Incidence](), list[Adjacency]()
    for key, slots in _entities(children):
        target = targets.get(key)
        for slot in slots:
            if target is not None:
                if classes.unite((key, CELL), (key, slot.child)):
                    order = _order(slot.labels, target.labels)
                    incidences.append(
                        Incidence(slot.child, slot.boundary, target.face, target.letter, order)
                    )
            elif classes.unite((key, slots[0].child), (key, slot.child)):
                order = _order(slot.labels, slots[0].labels)
                adjacencies.append(Adjacency(*slot[:2], *slots[0][:2], order))
        _inherit(children, classes, key, slots)
    return tuple(incidences), tuple(adjacencies)


def _entities(children: Sequence[Placed]) -> list[tuple[Key, list[_Slot]]]:
    """Return what children have in common, from high dimensions to low, and who has it."""
    found: dict[int, dict[Key, list[_Slot]]] = {}
    for i, child in enumerate(children):
        for k, part in enumerate(child.parts):
            labels = tuple(child.labels[t] for t in part.indices)
            same = found.setdefault(part.dimension, {}).setdefault(frozenset(labels), [])
            same.append(_Slot(i, k, labels))
    return [
        entity for dimension in sorted(found, reverse=True) for entity in found[dimension].items()
    ]


def _inherit(
    children: Sequence[Placed], classes: _Classes, key: Key, slots: Sequence[_Slot]
) -> None:
    """Make the boundaries of a shared boundary shared among those who share it."""
    outside = classes.find((key, slots[0].child))[1] == CELL
    if len(slots) == 1 and not outside:
        return
    first = CELL if outside else slots[0].child
    child = children[slots[0].child]
    for part in child.parts:
        lower = frozenset(child.labels[t] for t in part.indices)
        if lower < key:
            for slot in slots:
                classes.unite((lower, first), (lower, slot.child))


def _order(mine: Sequence[Hashable], theirs: Sequence[Hashable]) -> Order:
    """Return the order with mine[t] = theirs[order[t]]; none where they agree."""
    order = tuple(theirs.index(label) for label in mine)
    return () if order == tuple(range(len(order))) else order
