"""What constraints make one: union-find over slots, with the orders in which each is named."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from porous.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from porous.models.brep import Adjacency, Incidence

    Order = tuple[int, ...]
    Node = tuple[int, ...]


def then(outer: Order, inner: Order) -> Order:
    """Return the order of the product I[:, outer]·I[:, inner]."""
    return tuple(outer[t] for t in inner)


def inverse(order: Order) -> Order:
    """Return the order of the inverse of I[:, order]."""
    result = [0] * len(order)
    for t, position in enumerate(order):
        result[position] = t
    return tuple(result)


def identity(size: int) -> Order:
    """Return the order that changes nothing."""
    return tuple(range(size))


class Slots:
    """Classes of slots that are one entity: slot = representative·I[:, order].

    A node is a slot (child, boundary), or, with a negative first number, a fixed place: what is
    known already. A class holds one fixed place at most, which then represents it.

    Parameters
    ----------
    text
        Returns a constraint as people write it.
    """

    def __init__(self, text: Callable[[Incidence | Adjacency], str]) -> None:
        self._text = text
        self._above: dict[Node, tuple[Node, Order]] = {}
        self._links: dict[Node, list[tuple[Node, Incidence | Adjacency]]] = {}

    def find(self, node: Node, size: int) -> tuple[Node, Order]:
        """Return what represents a node of ``size`` controls, and the order it is seen in."""
        root, order = node, identity(size)
        while root in self._above:
            root, step = self._above[root]
            order = then(step, order)
        if root != node:
            self._above[node] = root, order
        return root, order

    def join(self, slot: Node, node: Node, order: Order, constraint: Incidence | Adjacency) -> None:
        """Make one of two: slot = node·I[:, order].

        Raises
        ------
        ModelError
            Where that puts one thing in two fixed places, or makes it a reordering of itself;
            names the constraints that do so together.
        """
        a, mine = self.find(slot, len(order))
        b, theirs = self.find(node, len(order))
        step = then(then(theirs, order), inverse(mine))
        if a == b:
            if step != identity(len(step)):
                chain = self._listed([*self._path(slot, node), constraint])
                raise ModelError(f"{chain}: together make something its own reordering {step}")
            return
        if a[0] < 0 and b[0] < 0:
            chain = self._listed([*self._path(a, slot), constraint, *self._path(node, b)])
            raise ModelError(f"{chain}: contradict, for they put one thing in two places")
        self._links.setdefault(slot, []).append((node, constraint))
        self._links.setdefault(node, []).append((slot, constraint))
        if a[0] < 0:
            self._above[b] = a, inverse(step)
        else:
            self._above[a] = b, step

    def because(self, node: Node, size: int) -> str:
        """Return the constraints that give a slot its order, as people write them."""
        path = self._path(node, self.find(node, size)[0])
        return self._listed([c for c in path if c.order] or path)

    def _path(self, start: Node, end: Node) -> list[Incidence | Adjacency]:
        """Return the constraints that lead from one node to another of its class."""
        before: dict[Node, tuple[Node, Incidence | Adjacency]] = {}
        queue = deque([start])
        while queue and end != start and end not in before:
            here = queue.popleft()
            for node, constraint in self._links.get(here, []):
                if node not in before and node != start:
                    before[node] = here, constraint
                    queue.append(node)
        result: list[Incidence | Adjacency] = []
        while end != start:
            end, constraint = before[end]
            result.insert(0, constraint)
        return result

    def _listed(self, constraints: Iterable[Incidence | Adjacency]) -> str:
        return "; ".join(dict.fromkeys(map(self._text, constraints)))
