"""Junctions of lattices that are cut in thirds with lattices that are cut in halves.

A *mixed* triangle has one edge in thirds and two in halves. Along the former it is cut into three
mixed triangles; two *halved* ones fill what is left, which are cut as usual. So a lattice in thirds
meets one in halves. In space cells are these triangles times a line: a mixed prism times thirds has
a side of 3 × 3 for a sponge, and its other sides are in thirds along their height still; a second
one, turned, times halves, has a side of 3 × 2 for the first and leaves halves on all others.

Controls are corners, all edges straight, so that cells share faces whichever way round they are.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError, nearest
from porous.models.brep import SHAPES, Boundary, CellState, Child, selection
from porous.models.builders._assembled import assembled
from porous.models.builders._builder import Builder
from porous.models.builders._cubes import pattern_name, patterns
from porous.models.builders._rules import straight

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from porous.models.brep import BRep
    from porous.models.builders._builder import Options
    from porous.models.builders._cubes import Pattern

    Floats = NDArray[np.float64]
    Indices = tuple[int, ...]

MIXED = (
    ("mixed", ((3, 0, 0), (2, 1, 0), (1.5, 0, 1.5))),
    ("mixed", ((2, 1, 0), (1, 2, 0), (1.5, 0, 1.5))),
    ("mixed", ((1, 2, 0), (0, 3, 0), (0, 1.5, 1.5))),
    ("halved", ((1.5, 0, 1.5), (1, 2, 0), (0, 1.5, 1.5))),
    ("halved", ((1.5, 0, 1.5), (0, 1.5, 1.5), (0, 0, 3))),
)
"""Children of a mixed triangle, whose edge from corner 0 to corner 1 is in thirds: thrice the
weights of their corners. Three along that edge, the one between them and the opposite edges'
middles, and the one at the tip."""

HALVED = (
    ("halved", ((2, 0, 0), (1, 1, 0), (1, 0, 1))),
    ("halved", ((1, 1, 0), (0, 2, 0), (0, 1, 1))),
    ("halved", ((1, 0, 1), (0, 1, 1), (0, 0, 2))),
    ("halved", ((0, 1, 1), (1, 0, 1), (1, 1, 0))),
)
"""Children of a halved triangle, twice the weights: at its corners and in the middle."""

ITSELF = (("vertex", ((1,),)),)
"""The child of a vertex."""

PRODUCTS = {
    ("vertex", 2): "edge 2",
    ("vertex", 3): "edge 3",
    ("edge 2", 2): "face 22",
    ("edge 2", 3): "face 23",
    ("edge 3", 3): "face 33",
    ("face 22", 2): "halves",
    ("face 33", 3): "thirds",
    ("mixed", 2): "mixed-halves",
    ("mixed", 3): "mixed-thirds",
    ("halved", 2): "halved-halves",
    ("halved", 3): "halved-thirds",
}
"""What a state times a line in two or three is called."""

SWAPPED = {("edge 3", 2): "face 23"}
"""Products that are others with their two axes exchanged."""

STATES = ("mixed", "halved", "vertex", *PRODUCTS.values())

LIFTED = {"vertex": "edge", "edge": "quad", "triangle": "wedge", "quad": "hexa"}
"""The shape of a shape times a line."""

STARTS = {
    "junction-lattice": ("mixed", "halved"),
    "junction-prism": ("mixed-thirds", "mixed-halves", "halved-thirds", "halved-halves"),
}
"""The states that cells may start with; the first if not told."""


def _states() -> dict[str, CellState]:
    """Return all states by their names, in the order of ``STATES``."""
    found = {"vertex": CellState("vertex", "vertex", np.zeros((3, 1)), (), _pieces(ITSELF, 1))}
    for line in (2, 3):
        found[PRODUCTS["vertex", line]] = _times(found["vertex"], line)
    found["mixed"] = _triangle("mixed", ("edge 3", "edge 2", "edge 2"), _pieces(MIXED, 3))
    found["halved"] = _triangle("halved", ("edge 2",) * 3, _pieces(HALVED, 2))
    for (base, line), name in PRODUCTS.items():
        if name not in found:
            found[name] = _times(found[base], line)
    return {name: found[name] for name in STATES}


def _pieces(
    children: Sequence[tuple[str, Sequence[Sequence[float]]]], whole: int
) -> tuple[Child, ...]:
    return tuple(
        Child(str(i), STATES.index(state), np.array(corners).T / whole)
        for i, (state, corners) in enumerate(children)
    )


def _triangle(name: str, edges: Sequence[str], children: tuple[Child, ...]) -> CellState:
    """Return a triangle with its edges 01, 12 and 02."""
    ends: tuple[Indices, ...] = ((0, 1), (1, 2), (0, 2))
    parts = [(STATES.index(edge), own) for edge, own in zip(edges, ends, strict=True)]
    parts += [(STATES.index("vertex"), (corner,)) for corner in range(3)]
    corners = np.array([[0.0, 1, 0], [0, 0, 1], [0, 0, 0]])
    return CellState(name, "triangle", corners, _boundaries(3, parts), children)


def _boundaries(size: int, parts: Iterable[tuple[int, Indices]]) -> tuple[Boundary, ...]:
    """Return boundaries named by their corners."""
    return tuple(
        Boundary("VEFF"[len(own) - 1] + "".join(map(str, own)), state, selection(size, own))
        for state, own in sorted(parts, key=lambda part: (-min(len(part[1]), 3), part[1]))
    )


def _times(base: CellState, line: int) -> CellState:
    """Return a state times a line: control (i, k) is 2·i + k.

    Its boundaries are the base's times the line, then the base and its boundaries at both ends.
    """
    own = [(b.state, tuple(b.matrix.argmax(axis=0).tolist())) for b in base.boundaries]
    parts = [_side(state, corners, line) for state, corners in own]
    for state, corners in [(STATES.index(base.name), tuple(range(base.size))), *own]:
        parts += [(state, tuple(2 * i + k for i in corners)) for k in (0, 1)]
    axis = np.eye(3)[:, [SHAPES[base.shape]]]
    controls = np.kron(base.controls, [1, 1]) + axis * np.tile([0.0, 1.0], base.size)
    return CellState(
        PRODUCTS[base.name, line],
        LIFTED[base.shape],
        controls,
        _boundaries(2 * base.size, parts),
        tuple(
            Child(
                f"{child.name}{k}" if base.size > 1 else str(k),
                STATES.index(PRODUCTS[STATES[child.state], line]),
                np.kron(child.guess, piece),
            )
            for child in base.children
            for k, piece in enumerate(straight(line))
        ),
    )


def _side(state: int, corners: Indices, line: int) -> tuple[int, Indices]:
    """Return the state of a boundary times a line, and its controls as that state has them."""
    name = STATES[state]
    if (name, line) in SWAPPED:
        return STATES.index(SWAPPED[name, line]), tuple(2 * i + k for k in (0, 1) for i in corners)
    return STATES.index(PRODUCTS[name, line]), tuple(2 * i + k for i in corners for k in (0, 1))


# --- the block -------------------------------------------------------------------------------


GRID = tuple(product(range(2), range(2), range(5)))
"""Controls of the block: the corners of four unit cubes along z."""

LENGTHS = (1, 1, 4)

CUBE = tuple(product((0, 1), (0, 1), (0, 1)))

LAYER = (((1, 1), (0, 1), (0, 2)), ((0, 2), (1, 2), (1, 1)))
"""Corners (x, z) of the mixed and the halved triangle of the first layer, whose lines run along y;
and (y, z) of the second's, one higher, whose lines run along x. They look the way the block's
sides do, for mixed ones are no mirror images of themselves."""


class _Part(NamedTuple):
    """A cell of the block, or a boundary of one: its state and which controls are its corners."""

    state: int
    corners: Indices


def _block(known: Sequence[CellState]) -> list[CellState]:
    """Return the states of a block that is cut as its parts are, once, on all its sides.

    From z = 0 up to 4: a cube in thirds; prisms in thirds along y; prisms in halves along x; a cube
    in halves.
    """
    parts = [_Part(STATES.index(name), tuple(map(GRID.index, at))) for name, at in _cells()]
    for cell in list(parts):
        for b in known[cell.state].boundaries:
            own = tuple(cell.corners[i] for i in b.matrix.argmax(axis=0))
            parts.append(_Part(b.state, own))
    distinct = list({frozenset(part.corners): part for part in parts}.values())
    sides = patterns(3)
    numbers = {p: len(STATES) + 1 + i for i, p in enumerate(sides) if None in p}
    numbers |= {p: STATES.index("vertex") for p in sides if None not in p}
    whole = (None, None, None)
    return [_side_of(p, distinct, numbers, known) for p in [whole, *sides] if None in p]


def _cells() -> Iterator[tuple[str, list[tuple[int, int, int]]]]:
    """Yield the cells of the block: their states and where their corners are."""
    yield "thirds", list(CUBE)
    for name, triangle in zip(("mixed", "halved"), LAYER, strict=True):
        yield f"{name}-thirds", [(x, y, z) for x, z in triangle for y in (0, 1)]
    for name, triangle in zip(("mixed", "halved"), LAYER, strict=True):
        yield f"{name}-halves", [(x, y, z + 1) for y, z in triangle for x in (0, 1)]
    yield "halves", [(x, y, z + 3) for x, y, z in CUBE]


def _on(pattern: Pattern) -> Indices:
    """Return the controls on a side of the block."""
    return tuple(
        n
        for n, place in enumerate(GRID)
        if all(
            side is None or x == side * length
            for x, side, length in zip(place, pattern, LENGTHS, strict=True)
        )
    )


def _facing(corners: Indices, pattern: Pattern) -> Indices:
    """Return a face's corners in an order in which it looks the way the block's side does."""
    axes = [axis for axis, side in enumerate(pattern) if side is None]
    places = np.array([GRID[n] for n in corners])[:, axes]
    if np.linalg.det(places[[2, 1]] - places[0]) > 0:
        return corners
    return corners[2:] + corners[:2]


def _side_of(
    pattern: Pattern,
    parts: Sequence[_Part],
    numbers: Mapping[Pattern, int],
    known: Sequence[CellState],
) -> CellState:
    """Return the block, or a side of it: its children are the parts of its dimension on it."""
    own, free = _on(pattern), pattern.count(None)
    inside = [
        part
        for part in parts
        if set(part.corners) <= set(own) and known[part.state].dimension == free
    ]
    smaller = [other for other in numbers if set(_on(other)) < set(own)]

    def chosen(points: Indices) -> Floats:
        return selection(len(own), [own.index(point) for point in points])

    return CellState(
        "cell" if free == 3 else pattern_name(pattern),
        ("vertex", "edge", "quad", "hexa")[free],
        np.array([GRID[n] for n in own], np.float64).T,
        tuple(Boundary(pattern_name(p), numbers[p], chosen(_on(p))) for p in smaller),
        tuple(
            Child(known[part.state].name if free == 3 else str(i), part.state, chosen(corners))
            for i, part in enumerate(inside)
            for corners in [_facing(part.corners, pattern) if free == 2 else part.corners]
        ),
    )


# --- cells by name ---------------------------------------------------------------------------


def _build(options: Options) -> BRep:
    """Return a triangle, a prism or the block, with the children that are kept; all if not told.

    Raises
    ------
    ModelError
        For another number of controls, a start that the cell does not have, children that are not
        there.
    """
    states = list(_states().values())
    if options.cell == "junction":
        states += _block(states)
        start = "cell"
    else:
        starts = STARTS[options.cell]
        start = starts[0] if options.start is None else options.start
        if start not in starts:
            raise ModelError(f"start: got {start!r}{nearest(start, starts)}")
    if options.cell == "junction" and options.start is not None:
        raise ModelError("start: a junction cell takes none; wanted controls and keep alone")
    index = [state.name for state in states].index(start)
    if options.controls not in (None, states[index].size):
        raise ModelError(
            f"controls: got {options.controls}; wanted {states[index].size}, those of {start}"
        )
    return assembled(states, options.keeping(start), index)


CELL = Builder((*STARTS, "junction"), _build, ("keep", "start", "controls"))
