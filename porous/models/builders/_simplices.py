"""Tetrahedra and octahedra halved: T → 4 T + O and O → 8 T + 6 O, or some of these children.

A control of a child is the mean of a group of its parent's controls: corners, middles of edges,
and an octahedron's centre, the mean of all six. The groups are the labels by which children share
what they share.
"""

from __future__ import annotations

from itertools import combinations, product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError, nearest
from porous.models.brep import Boundary, BRep, CellState, Child, selection
from porous.models.builders._joins import Covered, Part, Placed, joins
from porous.models.primitive import named

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    Group = tuple[int, ...]
    Groups = tuple[Group, ...]
    Keep = Mapping[str, tuple[str, ...]]


class Facet(NamedTuple):
    """A boundary: its name, its kind and which controls are its own."""

    name: str
    kind: str
    indices: tuple[int, ...]


class Piece(NamedTuple):
    """A child: its name, its kind and the group of controls that each of its own is the mean of."""

    name: str
    kind: str
    groups: Groups


class Kind(NamedTuple):
    """A state: its dimension, its number of controls, its boundaries and all its children."""

    dimension: int
    size: int
    boundaries: tuple[Facet, ...]
    children: tuple[Piece, ...]


TETRA_EDGES = ((0, 1), (2, 3), (0, 2), (1, 3), (0, 3), (1, 2))
"""The edges of a tetrahedron in whose middles its octahedron has its corners: opposite pairs."""

CENTRE = (0, 1, 2, 3, 4, 5)


def _middle(*groups: Group) -> Group:
    """Return the group of the middle of corners: a corner itself where they are one."""
    return tuple(sorted({index for group in groups for index in group}))


def _corner(size: int, corner: int) -> Groups:
    """Return a simplex's half at a corner: column j is the middle of the corner and corner j."""
    return tuple(_middle((corner,), (j,)) for j in range(size))


def _octa_at(corner: int) -> Groups:
    """Return an octahedron's half at a corner: a translate; opposite the corner is the centre."""
    return tuple(CENTRE if j == corner ^ 1 else _middle((corner,), (j,)) for j in range(6))


def _tetra_on(corner: int, *, upright: bool) -> Piece:
    """Return the tetrahedron between a face of an octahedron and its centre.

    The octahedron is that of a tetrahedron's edge middles. The upright ones stand on the faces
    that lie on the tetrahedron's, opposite ``corner``, and are its translates, column by column;
    the others stand on the faces that cut its corners off and point the other way.
    """
    others = [j for j in range(4) if j != corner]
    columns: list[Group] = [CENTRE] * 4
    for j in others:
        rest = [k for k in others if k != j]
        ends = [(j, k) if upright else (corner, k) for k in rest]
        columns[j] = tuple(sorted(TETRA_EDGES.index((min(e), max(e))) for e in ends))
    if not upright:  # mirrored through the centre: two columns exchanged make it positive again
        first, second = others[:2]
        columns[first], columns[second] = columns[second], columns[first]
    face = sorted({index for j in others for index in columns[j]})
    return Piece("".join(map(str, face)), "tetra", tuple(columns))


def _vertices(size: int) -> tuple[Facet, ...]:
    return tuple(Facet(f"V{i}", "vertex", (i,)) for i in range(size))


def _edges(pairs: Iterable[tuple[int, int]]) -> tuple[Facet, ...]:
    return tuple(Facet(f"E{a}{b}", "edge", (a, b)) for a, b in pairs)


def _corners(kind: str, size: int) -> tuple[Piece, ...]:
    return tuple(Piece(str(i), kind, _corner(size, i)) for i in range(size))


UPRIGHT = tuple(sorted(_tetra_on(i, upright=True) for i in range(4)))
INVERTED = tuple(sorted(_tetra_on(i, upright=False) for i in range(4)))

KINDS = {
    "tetra": Kind(
        3,
        4,
        (
            *(Facet(f"F{i}", "triangle", tuple(j for j in range(4) if j != i)) for i in range(4)),
            *_edges(combinations(range(4), 2)),
            *_vertices(4),
        ),
        (*_corners("tetra", 4), Piece("octa", "octa", TETRA_EDGES)),
    ),
    "octa": Kind(
        3,
        6,
        (
            *(
                Facet("F" + "".join(map(str, face)), "triangle", face)
                for face in product((0, 1), (2, 3), (4, 5))
            ),
            *_edges((a, b) for a, b in combinations(range(6), 2) if a // 2 != b // 2),
            *_vertices(6),
        ),
        (
            *sorted((*UPRIGHT, *INVERTED)),
            *(Piece(str(i), "octa", _octa_at(i)) for i in range(6)),
        ),
    ),
    "triangle": Kind(
        2,
        3,
        (*_edges(combinations(range(3), 2)), *_vertices(3)),
        (*_corners("triangle", 3), Piece("centre", "triangle", ((1, 2), (0, 2), (0, 1)))),
    ),
    "edge": Kind(1, 2, _vertices(2), _corners("edge", 2)),
    "vertex": Kind(0, 1, (), (Piece("0", "vertex", ((0,),)),)),
}
"""All states; boundaries have all their children, and all orders of a triangle permute them."""


def simplicial(start: str, keep: Keep, controls: int | None = None) -> BRep:
    """Return the cells of halved tetrahedra and octahedra that come of one.

    Parameters
    ----------
    start
        State of the level-0 cell, ``"tetra"`` or ``"octa"``.
    keep
        Names of children by state; the name of a state is all children of that state. All are
        kept of a state that is not there.
    controls
        How many controls the level-0 cell is given; only checked.

    Raises
    ------
    ModelError
        For states and children that are not there, or twice, with the nearest; for another
        number of controls than the start has.
    """
    cells = [name for name, kind in KINDS.items() if kind.dimension == 3]
    for state in [start, *keep]:
        if state not in cells:
            raise ModelError(f"state: got {state!r}{nearest(str(state), cells)}")
    if controls not in (None, KINDS[start].size):
        raise ModelError(f"controls: got {controls}; wanted {KINDS[start].size}, of one {start}")
    kept = {name: _kept(name, keep.get(name)) for name in KINDS}
    order = [start]
    for name in order:
        order += dict.fromkeys(p.kind for p in kept[name] if p.kind not in order)
    order += [name for name in KINDS if name not in cells]
    return BRep(tuple(_state(name, kept[name], order, start) for name in order))


def _kept(state: str, names: tuple[str, ...] | None) -> tuple[Piece, ...]:
    pieces = KINDS[state].children
    if names is None:
        return pieces
    known = {piece.name for piece in pieces} | {piece.kind for piece in pieces}
    chosen: list[Piece] = []
    for name in names:
        found = [p for p in pieces if p.name == name or p.kind == name]
        if not found:
            raise ModelError(f"keep: {state} has no child {name!r}{nearest(name, known)}")
        again = next((p.name for p in found if p in chosen), None)
        if again is not None:
            raise ModelError(f"keep: child {again} of {state} is there twice")
        chosen += found
    return tuple(piece for piece in pieces if piece in chosen)


def _state(name: str, kept: Sequence[Piece], order: Sequence[str], start: str) -> CellState:
    kind = KINDS[name]
    incidences, adjacencies = joins(
        [Placed(piece.groups, _parts(piece.kind)) for piece in kept],
        [
            Covered(
                face, letter, [_middle(*((facet.indices[i],) for i in g)) for g in piece.groups]
            )
            for face, facet in enumerate(kind.boundaries)
            for letter, piece in enumerate(KINDS[facet.kind].children)
        ],
    )
    return CellState(
        name,
        name,
        _reference(name, start),
        tuple(
            Boundary(facet.name, order.index(facet.kind), selection(kind.size, facet.indices))
            for facet in kind.boundaries
        ),
        tuple(
            Child(piece.name, order.index(piece.kind), _means(kind.size, piece.groups))
            for piece in kept
        ),
        incidences,
        adjacencies,
    )


def _parts(name: str) -> list[Part]:
    return [Part(KINDS[f.kind].dimension, f.indices) for f in KINDS[name].boundaries]


def _means(size: int, groups: Groups) -> NDArray[np.float64]:
    result = np.zeros((size, len(groups)))
    for column, group in enumerate(groups):
        result[list(group), column] = 1 / len(group)
    return result


def _reference(name: str, start: str) -> NDArray[np.float64]:
    """Return the controls: the start's in the unit cube, tetrahedra and octahedra of equal edges.

    The primitives' tetrahedron has edges √2, their octahedron √½. Two of the tetrahedron's
    corners are exchanged: its edges from corner 0 are then right-handed.
    """
    unit = 1.0 if start == "tetra" else 0.5
    if name == "octa":
        return 2 * unit * named("octahedron").points.T
    return unit * named("tetrahedron").points[[0, 2, 1, 3]].T[:, : KINDS[name].size]
