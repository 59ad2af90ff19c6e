"""What formats with groups share: names that they can hold, memberships, faces as elements.

Parts overlap as they like. Formats that give an element one number take the distinct combinations
of parts that elements are in (``combined``) or the first part that each is in (``leading``).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.values import SHAPES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from porous.values import VolumeMesh

    Indices = NDArray[np.int64]

PHASES = ("SOLID", "PORE")
"""Parts that lead before all others: every cell of most meshes is in one of them."""
SKIN = "SKIN"
"""The part that leads after all others: its faces are those of the six sides."""
FACES = {3: "tri3", 4: "quad4", 6: "tri6", 8: "quad8"}
"""What a face of so many nodes is."""


@dataclass(frozen=True)
class Groups:
    """Parts of one kind: their names in the mesh and each one's members, no member twice."""

    count: int
    """How many elements there are."""
    sets: Mapping[str, Indices]

    def combined(self) -> tuple[Indices, list[tuple[str, ...]]]:
        """Return each element's combination of parts, and what parts each combination is."""
        label = np.zeros(self.count, np.int64)
        found: list[tuple[str, ...]] = [()]
        for name, members in self.sets.items():
            old, place = np.unique(label[members], return_inverse=True)
            label[members] = len(found) + place
            found += [(*found[number], name) for number in old.tolist()]
        used, label = np.unique(label, return_inverse=True)
        return label.astype(np.int64), [found[number] for number in used.tolist()]

    def leading(self) -> tuple[Indices, list[str]]:
        """Return for each element the first part that it is in, −1 for none, and the parts.

        ``PHASES`` come before all others and ``SKIN`` after them; parts that lead nowhere are not
        among the parts.
        """
        names = list(self.sets)
        order = [n for n in PHASES if n in names]
        order += [n for n in names if n not in (*PHASES, SKIN)]
        order += [n for n in (SKIN,) if n in names]
        label = np.full(self.count, len(order), np.int64)
        for place in range(len(order) - 1, -1, -1):
            label[self.sets[order[place]]] = place
        used, label = np.unique(label, return_inverse=True)
        shown = [order[number] for number in used.tolist() if number < len(order)]
        return np.where(label < len(shown), label, -1), shown


def nodes_in(mesh: VolumeMesh) -> Groups:
    """Return the parts of nodes."""
    return Groups(len(mesh.points), _members(mesh, "nodes"))


def cells_in(mesh: VolumeMesh) -> Groups:
    """Return the parts of cells."""
    return Groups(mesh.cells, _members(mesh, "cells"))


def faces_in(mesh: VolumeMesh) -> tuple[Indices, Groups]:
    """Return the faces that are in any part, as (cell, local face), each once; and the parts."""
    width = max((len(shape.faces) for shape in SHAPES.values()), default=1)
    codes = {
        name: np.unique(part.members @ np.array([width, 1]))
        for name, part in mesh.parts.items()
        if part.kind == "faces" and len(part.members)
    }
    every = np.unique(np.concatenate([np.zeros(0, np.int64), *codes.values()]))
    sets = {name: np.searchsorted(every, some) for name, some in codes.items()}
    return np.stack(np.divmod(every, width), axis=1), Groups(len(every), sets)


def _members(mesh: VolumeMesh, kind: str) -> dict[str, Indices]:
    return {
        name: np.unique(part.members)
        for name, part in mesh.parts.items()
        if part.kind == kind and len(part.members)
    }


def face_elements(mesh: VolumeMesh, faces: Indices) -> dict[str, tuple[Indices, Indices]]:
    """Return faces by what they are: which of ``faces``, and their nodes seen from outside.

    Nodes in the middle of edges follow the corners, as everybody has them.
    """
    found: dict[str, list[tuple[Indices, Indices]]] = {}
    start = 0
    for block in mesh.blocks:
        cell = faces[:, 0] - start
        own = np.flatnonzero((cell >= 0) & (cell < len(block.cells)))
        for local, nodes in enumerate(_whole_faces(block.shape)):
            rows = own[faces[own, 1] == local]
            if len(rows):
                kind = FACES[len(nodes)]
                found.setdefault(kind, []).append((rows, block.cells[cell[rows]][:, nodes]))
        start += len(block.cells)
    return {kind: _in_order(found[kind]) for kind in FACES.values() if kind in found}


def _in_order(pieces: list[tuple[Indices, Indices]]) -> tuple[Indices, Indices]:
    rows = np.concatenate([rows for rows, _ in pieces])
    order = np.argsort(rows, kind="stable")
    return rows[order], np.concatenate([nodes for _, nodes in pieces])[order]


@cache
def _whole_faces(name: str) -> list[list[int]]:
    shape = SHAPES[name]
    corners = SHAPES[shape.linear].nodes if shape.linear else shape.nodes
    middle = {frozenset(edge): corners + i for i, edge in enumerate(shape.edges)}
    return [
        [*face, *(middle[frozenset(e)] for e in zip(face, (*face[1:], face[0]), strict=True))]
        if middle
        else list(face)
        for face in shape.faces
    ]


def node_order(
    name: str, corners: Sequence[int], edges: Iterable[tuple[int, int]] = ()
) -> list[int]:
    """Return which of a shape's nodes come first, second, … in the order of others.

    Parameters
    ----------
    name
        One of ``SHAPES``.
    corners
        Our numbers of their corners.
    edges
        Their edges between their corners, in the order in which they have the nodes upon them;
        only those of shapes with such nodes are looked at.
    """
    shape = SHAPES[name]
    ours = {frozenset(edge): len(corners) + i for i, edge in enumerate(shape.edges)}
    theirs = [frozenset((corners[a], corners[b])) for a, b in edges] if ours else []
    return [*corners, *(ours[edge] for edge in theirs)]


def names_in(names: Iterable[str], odd: str, longest: int, form: str) -> dict[str, str]:
    """Return the name that each part has in a file.

    Parameters
    ----------
    names
        Of parts that share one space of names there.
    odd
        A regular expression of what becomes an underscore.
    longest
        How many characters are kept.
    form
        The format, for messages.

    Raises
    ------
    FormatError
        Where two would become one.
    """
    seen: dict[str, str] = {}
    for name in names:
        short = re.sub(odd, "_", name)[:longest].strip() or "_"
        if short in seen:
            raise FormatError(
                f"parts {seen[short]!r} and {name!r} would both be {short} in {form}; "
                "wanted names that differ"
            )
        seen[short] = name
    return {name: short for short, name in seen.items()}


def refuse_empty(mesh: VolumeMesh) -> None:
    """Refuse a mesh that has no cells."""
    if not mesh.cells:
        raise FormatError("the mesh has no cells; wanted at least one")
