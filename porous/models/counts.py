"""How many vertices, edges, faces and cells a complex has, at any level and exactly.

The entities of a level fall into types: an entity's state, and which boundaries of which states
of cells it is, in which orders. What becomes of an entity depends on its type alone, so the
numbers of entities of each type go from level to level by a matrix of whole numbers.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING, NamedTuple

from porous.errors import ModelError
from porous.models.complex import level_zero

if TYPE_CHECKING:
    from porous.models.closure import Closure
    from porous.models.complex import Complex

LARGEST = 100_000
"""The most types of entities that are followed."""

MANY = 2
"""One cell or more is all that is asked of a type: larger numbers of the same use count as two."""


class Incident(NamedTuple):
    """Cells that use an entity: their state, which boundary it is, in which order, how many.

    ``boundary`` is the number of boundaries where the entity is the cell itself.
    """

    state: int
    boundary: int
    order: int
    many: int


class Type(NamedTuple):
    """A type of entities: their state and the cells about each."""

    state: int
    cells: tuple[Incident, ...]


def counts(closure: Closure, level: int, start: Complex | None = None) -> tuple[int, int, int, int]:
    """Return the numbers of vertices, edges, faces and volumes of level ``level``, exact.

    Parameters
    ----------
    closure
        What the children of each state share.
    level
        Any; the numbers are Python's, without a largest.
    start
        Level-0 cells; one cell of the start's state where not given.

    Raises
    ------
    ModelError
        For a negative level, more than ``LARGEST`` types of entities, or a start in orders that
        the closure was not made for.
    """
    result = [0, 0, 0, 0]
    for kind, many in histogram(closure, level, start).items():
        result[closure.brep.states[kind.state].dimension] += many
    return result[0], result[1], result[2], result[3]


def euler_number(closure: Closure, level: int, start: Complex | None = None) -> int:
    """Return V − E + F − C of the closed complex of a level, exact; see ``counts``."""
    vertices, edges, faces, cells = counts(closure, level, start)
    return vertices - edges + faces - cells


def boundary_count(closure: Closure, level: int, start: Complex | None = None) -> int:
    """Return how many faces of volumes belong to one volume only, exact; see ``counts``."""
    states = closure.brep.states
    return sum(
        many
        for kind, many in histogram(closure, level, start).items()
        if states[kind.state].dimension == 2
        and sum(at.many for at in kind.cells if states[at.state].dimension == 3) == 1
    )


def histogram(closure: Closure, level: int, start: Complex | None = None) -> Counter[Type]:
    """Return how many entities of each type there are at a level, exact; see ``counts``."""
    if level < 0:
        raise ModelError(f"level: got {level}; wanted 0 or more")
    follow = _Following(closure)
    result = _types(closure, level_zero(closure, start))
    for _ in range(level):
        finer: Counter[Type] = Counter()
        for kind, many in result.items():
            for target, times in follow.below(kind).items():
                finer[target] += many * times
        result = finer
    return result


def _types(closure: Closure, start: Complex) -> Counter[Type]:
    found: dict[tuple[int, int], Counter[tuple[int, int, int]]] = defaultdict(Counter)
    for group in start.cells:
        for k, s in enumerate(closure.slots(group.state)):
            for number, order in zip(
                group.ids[:, k].tolist(), group.orders[:, k].tolist(), strict=True
            ):
                found[s, number][group.state, k, order] += 1
    return Counter(_type(s, uses) for (s, _), uses in found.items())


def _type(state: int, uses: Counter[tuple[int, int, int]]) -> Type:
    return Type(state, tuple(Incident(*use, min(n, MANY)) for use, n in sorted(uses.items())))


class _Following:
    """What becomes of each type, found when first asked."""

    def __init__(self, closure: Closure) -> None:
        self._closure = closure
        self._below: dict[Type, Counter[Type]] = {}
        self._met: set[Type] = set()

    def below(self, kind: Type) -> Counter[Type]:
        """Return how many entities of each type an entity of a type makes."""
        if kind not in self._below:
            self._below[kind] = self._split(kind)
            self._met.update(self._below[kind])
            if len(self._met) > LARGEST:
                raise ModelError(
                    f"counts: more than {LARGEST} kinds of entities, told apart by the cells about "
                    "them; wanted fewer: count the cells of a complex instead, at a low level"
                )
        return self._below[kind]

    def _split(self, kind: Type) -> Counter[Type]:
        closure, born = self._closure, defaultdict[int, Counter[tuple[int, int, int]]](Counter)
        for at in kind.cells:
            for child, slot, own, order in closure.inside[at.state][at.boundary]:
                target, seen = closure.act[kind.state][at.order, own].tolist()
                state = closure.own[kind.state][target].state
                turned = int(closure.compose[state][seen, order])
                born[target][closure.children[at.state][child], slot, turned] += at.many
        own_states = closure.own[kind.state]
        return Counter(_type(own_states[t].state, uses) for t, uses in born.items())
