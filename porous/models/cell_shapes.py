"""How a cell is cut into volume elements: which corners, which way round, which face is whose.

A hexa and a wedge are an element, a tetra a tetrahedron, an octa four tetrahedra about one of its
diagonals. The corners of a cell are its boundaries of dimension zero in their order, its edges and
faces those of dimension one and two; whatever is said of them here is said by these numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.values.value import Value, frozen
from porous.values.volume_mesh import SHAPES

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.models.brep import BRep

    Indices = NDArray[np.int64]
    Elements = tuple[tuple[int, ...], ...]

WIDTH = 4
"""Most corners of a face; a triangle's fourth is −1."""

DIAGONALS = {"octa": ((0, 1), (2, 3), (4, 5))}
"""Pairs of opposite corners about which a cell may be cut; the first where there is no choice."""


def _about(axis: int) -> Elements:
    (a, b), (c, d), (e, f) = (DIAGONALS["octa"][(axis + i) % 3] for i in range(3))
    return (a, b, c, e), (a, b, e, d), (a, b, d, f), (a, b, f, c)


def _mirrored(elements: Elements) -> Elements:
    return tuple((a, b, d, c) for a, b, c, d in elements)


_HEXA = (((0, 4, 6, 2, 1, 5, 7, 3),), ((0, 2, 6, 4, 1, 3, 7, 5),))
_WEDGE = (((0, 2, 4, 1, 3, 5),), ((0, 4, 2, 1, 5, 3),))
_TETRA = (((0, 1, 2, 3),), ((0, 1, 3, 2),))
_OCTA = tuple(cut for axis in range(3) for cut in (_about(axis), _mirrored(_about(axis))))

CUTS: dict[str, tuple[str, tuple[Elements, ...]]] = {
    "hexa": ("hex8", _HEXA),
    "wedge": ("wed6", _WEDGE),
    "tetra": ("tet4", _TETRA),
    "octa": ("tet4", _OCTA),
}
"""The element and the variants of each shape: for each diagonal, then the same mirrored."""

COLLAPSED = (0, 1, 2, 3, 4, 5, 4, 5)
"""Corners of a wedge as those of a hexa, two of whose edges are one: the same body."""

COUNTS = {"hexa": (8, 12, 6), "tetra": (4, 6, 4), "octa": (6, 12, 8), "wedge": (6, 9, 5)}
"""Vertices, edges and faces of each shape."""

FRAMES = {
    "tet4": ((0, 1, 2, 3),),
    "wed6": (
        *((0, 1, 2, 3), (1, 2, 0, 4), (2, 0, 1, 5)),
        *((3, 5, 4, 0), (4, 3, 5, 1), (5, 4, 3, 2)),
    ),
    "hex8": (
        *((0, 1, 3, 4), (1, 2, 0, 5), (2, 3, 1, 6), (3, 0, 2, 7)),
        *((4, 7, 5, 0), (5, 4, 6, 1), (6, 5, 7, 2), (7, 6, 4, 3)),
    ),
}
"""A corner and its three neighbours, right-handed, for each Jacobian that has to be positive."""


@dataclass(frozen=True, eq=False)
class Cut(Value):
    """How cells of one state are cut; every table but ``wings`` and ``faces`` is by variant.

    Parameters
    ----------
    kind
        The element: ``"hex8"``, ``"wed6"`` or ``"tet4"``.
    elements
        Corners of each element in VTK order, (variants, elements, nodes).
    frames
        Corners of each Jacobian, (variants, frames, 4).
    faces
        Corners of each face in the order of the face's own vertices, (faces, 4), −1 where there
        are three.
    loops
        The same, counter-clockwise seen from outside, (variants, faces, 4).
    sides
        The edge from each corner of a loop to the next, (variants, faces, 4).
    members
        Element and local face that a face is, (variants, faces, 2).
    wings
        The two faces that meet in each edge, (edges, 2).
    """

    kind: str
    elements: Indices
    frames: Indices
    faces: Indices
    loops: Indices
    sides: Indices
    members: Indices
    wings: Indices

    def __post_init__(self) -> None:
        for table in fields(self)[1:]:
            self._set(table.name, frozen(getattr(self, table.name), np.int64))


def cut(brep: BRep, index: int) -> Cut:
    """Return how cells of state ``index`` are cut into elements.

    Raises
    ------
    ModelError
        For a state that is no volume, or whose vertices, edges and faces are not those of its
        shape.
    """
    state = brep.states[index]
    if state.shape not in CUTS:
        raise ModelError(
            f"mesh: cells of state {state.name} are of shape {state.shape}, no volumes; "
            f"wanted one of {', '.join(CUTS)}"
        )
    kind, variants = CUTS[state.shape]
    elements = np.array(variants)
    counts = tuple(len(brep.of_dimension(index, d)) for d in range(3))
    if counts != COUNTS[state.shape]:
        raise ModelError(
            f"mesh: state {state.name} has {_read(counts)}; wanted those of a {state.shape}: "
            f"{_read(COUNTS[state.shape])}"
        )
    faces = [_ends(brep, index, k) for k in brep.of_dimension(index, 2)]
    edges = [_ends(brep, index, k) for k in brep.of_dimension(index, 1)]
    frames = elements[:, :, np.array(FRAMES[kind])].reshape(len(elements), -1, 4)
    found = [[_member(state.name, kind, v, face) for face in faces] for v in variants]
    loops = np.array([[_padded(loop) for _, loop in row] for row in found])
    members = np.array([[member for member, _ in row] for row in found])
    sides = np.array([[_sides(state.name, edges, loop) for _, loop in row] for row in found])
    padded = np.array([_padded(face) for face in faces])
    return Cut(
        kind, elements, frames, padded, loops, sides, members, _wings(state.name, sides[0], edges)
    )


def _read(counts: tuple[int, ...]) -> str:
    return "{} vertices, {} edges and {} faces".format(*counts)


def _ends(brep: BRep, index: int, boundary: int) -> tuple[int, ...]:
    """Return the corners of a boundary in its own order of vertices."""
    corner = {k: c for c, k in enumerate(brep.of_dimension(index, 0))}
    own = brep.of_dimension(brep.states[index].boundaries[boundary].state, 0)
    uses = brep.sub[index][boundary]
    return tuple(corner[uses[m].boundary] for m in own)


def _padded(corners: tuple[int, ...]) -> tuple[int, ...]:
    return (*corners, *[-1] * (WIDTH - len(corners)))


def _member(
    name: str, kind: str, elements: Elements, face: tuple[int, ...]
) -> tuple[tuple[int, int], tuple[int, ...]]:
    """Return the element and local face with a face's corners, and its outward loop."""
    for e, element in enumerate(elements):
        for local, nodes in enumerate(SHAPES[kind].faces):
            loop = tuple(element[node] for node in nodes)
            if set(loop) == set(face):
                return (e, local), loop
    raise ModelError(f"mesh: state {name}: corners {face} are no face of its shape")


def _sides(name: str, edges: list[tuple[int, ...]], loop: tuple[int, ...]) -> tuple[int, ...]:
    result = []
    for a, b in zip(loop, (*loop[1:], loop[0]), strict=True):
        between = [e for e, ends in enumerate(edges) if set(ends) == {a, b}]
        if len(between) != 1:
            raise ModelError(
                f"mesh: state {name}: {len(between)} edges join corners {a} and {b}; wanted one"
            )
        result.append(between[0])
    return _padded(tuple(result))


def _wings(name: str, sides: Indices, edges: list[tuple[int, ...]]) -> Indices:
    result = [np.flatnonzero((sides == e).any(axis=1)) for e in range(len(edges))]
    for ends, faces in zip(edges, result, strict=True):
        if len(faces) != 2:
            raise ModelError(
                f"mesh: state {name}: {len(faces)} faces meet in the edge of corners {ends}; "
                "wanted two"
            )
    return np.array(result)
