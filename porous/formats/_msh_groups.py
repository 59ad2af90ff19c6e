"""What is read of Gmsh's groups: physical groups as parts, and faces that match one period on.

Groups of volumes are parts of cells, those of surfaces parts of faces, those of points parts of
nodes. A face between two cells is of the one that it is seen from the outside of, else the first.
A group without a name is called by its dimension and number. Entities that match by a shift along
an axis are parts of pairs, ``XPAIRS`` and so on. Groups of lines are left out, and so are elements
that are not part of a volume element; a note says so.
"""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from porous.formats._groups import node_order
from porous.formats._msh_tiers import EDGES
from porous.formats._sets import (
    MOST,
    Allowance,
    Collected,
    ascending,
    faces_by_nodes,
    groups_of,
    same_rows,
)
from porous.formats.gate import refuse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.formats._elements import Draft
    from porous.values import VolumeMesh

    Indices = NDArray[np.int64]

VOLUMES = {
    4: ("tet4", 4),
    5: ("hex8", 8),
    6: ("wed6", 6),
    11: ("tet10", 10),
    12: ("hex8", 27),
    17: ("hex20", 20),
}
"""What element types are read as, and their nodes."""
FLAT = {1: 2, 2: 3, 3: 4, 8: 3, 9: 6, 10: 9, 15: 1, 16: 8}
"""Nodes of points, lines and faces up to the second order."""
NODES = FLAT | {kind: nodes for kind, (_, nodes) in VOLUMES.items()}
CORNERS = {2: 3, 3: 4, 9: 3, 10: 4, 16: 4}
"""Corners of faces."""
POINT = 15
ORDERS = {
    "tet10": np.argsort(node_order("tet10", range(4), EDGES["tet10"])),
    "hex20": np.argsort(node_order("hex20", range(8), EDGES["hex20"])),
}
"""Which of Gmsh's nodes come first, second, … in our order."""
PLAIN = ("POINT", "CURVE", "SURFACE", "VOLUME")
"""What groups without a name are called, by dimension."""
NAME = re.compile(rb'[ \t]*([0-3])[ \t]+(-?\d{1,10})[ \t]+"([^\n]*)"[ \t\r]*')
NEAR = 1e-6
"""How far shifts may differ, in diagonals of the mesh's box."""


def group_names(body: bytes) -> dict[tuple[int, int], str]:
    """Return the names of groups, by dimension and number."""
    count, *lines = body.split(b"\n")
    lines = [line for line in lines if line.strip()]
    names = {}
    for line in lines:
        match = NAME.fullmatch(line)
        if match is None:
            refuse("$PhysicalNames", line.decode("utf-8", "replace"), "dimension, number, name")
        names[int(match[1]), abs(int(match[2]))] = match[3].decode("utf-8", "replace")
    if count.strip() != b"%d" % len(lines):
        refuse("$PhysicalNames", count.decode("utf-8", "replace"), f"{len(lines)}, its names")
    return names


class Elements:
    """The elements of a file with labels that say their groups, on the way to a mesh.

    Labels are groups themselves, and 0 is none; or they are numbers that ``combined`` gave.
    """

    def __init__(self, draft: Draft) -> None:
        self.draft = draft
        self.names: dict[tuple[int, int], str] = {}
        self.entities: dict[tuple[int, int], tuple[int, ...]] = {}
        """The groups of each entity, by dimension and number."""
        self.combinations: list[tuple[int, ...]] | None = None
        self.pieces: dict[int, list[tuple[Indices, Indices, Indices]]] = {}
        """By type: numbers, nodes and labels."""
        self.links: list[tuple[int, Indices]] = []
        self.allowance = Allowance(draft.source)

    def combined(self, dimension: int, entity: int) -> int:
        """Return a label for the groups of an entity."""
        if self.combinations is None:
            self.combinations = [()]
        groups = self.entities.get((dimension, entity), ())
        if groups:
            self.combinations.append(groups)
        return len(self.combinations) - 1 if groups else 0

    def add(self, kind: int, numbers: Indices, nodes: Indices, labels: Indices) -> None:
        """Add elements of one type; such without volume only where a group has them."""
        chosen = labels != 0
        if not len(nodes) or (kind in FLAT and not chosen.any()):
            return
        if kind in FLAT:
            nodes, labels = nodes[chosen], labels[chosen]
        self.pieces.setdefault(kind, []).append((numbers, nodes, labels))

    def link(self, dimension: int, pairs: Indices) -> None:
        """Add nodes of an entity, and those of another one that they match: (n, 2)."""
        self.links.append((dimension, pairs))

    def mesh(self, unit: str) -> VolumeMesh:
        """Return the mesh with its parts."""
        members: dict[tuple[int, str], list[Indices]] = {}
        cells: dict[str, list[tuple[Indices, Indices]]] = {}
        for kind in [kind for kind in self.pieces if kind in VOLUMES]:
            shape, _ = VOLUMES[kind]
            cells.setdefault(shape, []).append(self._cells(kind, shape))
        self.draft.settle()
        start = 0
        for shape in self.draft.shapes:
            for place, labels in cells[shape]:
                self._sort(3, labels, place + start, members)
                start += int(place.max()) + 1
        lost = sum(self._flat(kind, members) for kind in list(self.pieces))
        collected = self._collected(members)
        if lost:
            self.draft.source.note(f"{lost} faces of groups are faces of no volume element")
        self._pair(collected)
        collected.note(self.draft.source)
        return self.draft.mesh(collected.parts, unit)

    def _cells(self, kind: int, shape: str) -> tuple[Indices, Indices]:
        """Add the cells of one type, and return which of them each of the file is, and its label.

        Where the labels are combinations they go by their numbers, else what is listed once for
        each of its groups is one cell.
        """
        numbers, nodes, labels = self._joined(kind)
        place = np.arange(len(nodes))
        if self.combinations is not None:
            if (numbers[1:] < numbers[:-1]).any():
                order = np.argsort(numbers, kind="stable")
                nodes, labels = nodes[order], labels[order]
        else:
            first, which = same_rows(nodes)
            if len(first) < len(nodes):
                kept = np.sort(first)
                nodes, place = nodes[kept], np.searchsorted(kept, first)[which]
        self.draft.add_cells(shape, nodes[:, ORDERS[shape]] if shape in ORDERS else nodes)
        return place, labels

    def _joined(self, kind: int) -> list[Indices]:
        pieces = self.pieces.pop(kind)
        if len(pieces) == 1:
            return list(pieces[0])
        return [np.concatenate(some) for some in zip(*pieces, strict=True)]

    def _flat(self, kind: int, members: dict[tuple[int, str], list[Indices]]) -> int:
        """Find points and faces in the mesh; return how many faces are of no cell."""
        _, nodes, labels = self._joined(kind)
        if kind == POINT:
            place = self.draft.places(nodes[:, 0])
            self._sort(0, labels[place >= 0], place[place >= 0], members)
            self._sort(0, labels[place < 0], place[:0], members)
            return 0
        if kind not in CORNERS:
            self._sort(1, labels, np.zeros(0, np.int64), members)
            return 0
        corners = self.draft.places(nodes[:, : CORNERS[kind]])
        faces = np.full((len(corners), 2), -1)
        inside = (corners >= 0).all(axis=1)
        faces[inside] = faces_by_nodes(self.draft.blocks, len(self.draft.used), corners[inside])
        found = faces[:, 0] >= 0
        self._sort(2, labels[found], faces[found] @ np.array([MOST, 1]), members)
        self._sort(2, labels[~found], np.zeros(0, np.int64), members)
        return int(len(found) - found.sum())

    def _sort(
        self,
        dimension: int,
        labels: Indices,
        place: Indices,
        members: dict[tuple[int, str], list[Indices]],
    ) -> None:
        """Add places to the groups that the labels say, or no places to them."""
        for label, some in groups_of(labels):
            groups = (label,) if self.combinations is None else self.combinations[label]
            own = place[some] if len(place) else place
            for group in groups if label else ():
                self.allowance.take(len(own))
                members.setdefault((dimension, self._name(dimension, group)), []).append(own)

    def _name(self, dimension: int, group: int) -> str:
        return self.names.get((dimension, group), f"{PLAIN[dimension]}_{group}")

    def _collected(self, members: dict[tuple[int, str], list[Indices]]) -> Collected:
        collected = Collected()
        for (dimension, _), name in self.names.items():
            members.setdefault((dimension, name), [])
        for dimension, kind in ((3, "cells"), (2, "faces"), (0, "nodes")):
            for (_, name), pieces in [item for item in members.items() if item[0][0] == dimension]:
                own = ascending(pieces)
                rows = np.stack(np.divmod(own, MOST), axis=1) if kind == "faces" else own
                collected.add(kind, name, rows)
        for name in [name for dimension, name in members if dimension == 1]:
            collected.leave(name, "are of lines")
        return collected

    def _pair(self, collected: Collected) -> None:
        """Add what matches one period on along an axis; curves and points lie upon the faces."""
        found: dict[tuple[int, int], list[Indices]] = {}
        others = 0
        with np.errstate(all="ignore"):  # of places that the mesh will refuse
            near = NEAR * float(np.linalg.norm(np.ptp(self.draft.where, axis=0)))
        for pairs in [pairs for dimension, pairs in self.links if dimension == 2]:
            ends = self.draft.places(pairs)
            ends = ends[(ends >= 0).all(axis=1)]
            axis, period = _shift(self.draft.where, ends, near)
            if axis < 0:
                others += 1
                continue
            key = axis, round(abs(period) / near)
            found.setdefault(key, []).append(ends[:, ::-1] if period > 0 else ends)
        if others:
            text = f"{others} links of $Periodic are no shifts along an axis and are left out"
            self.draft.source.note(text)
        count: Counter[int] = Counter()
        for (axis, _), some in found.items():
            count[axis] += 1
            tail = f"_{count[axis]}" if count[axis] > 1 else ""
            collected.add("pairs", f"{'XYZ'[axis]}PAIRS{tail}", _distinct(some))


def _distinct(some: list[Indices]) -> Indices:
    rows = np.concatenate(some)
    return rows[np.sort(same_rows(rows)[0])]


def _shift(points: NDArray[np.float64], ends: Indices, near: float) -> tuple[int, float]:
    """Return along which axis the first of pairs lie on from the second, and how far; −1 if not."""
    if not len(ends):
        return -1, 0.0
    with np.errstate(all="ignore"):  # of places that the mesh will refuse
        shift = points[ends[:, 0]] - points[ends[:, 1]]
        mean = shift.mean(axis=0)
        far = np.abs(mean) > near
        alike = (np.abs(shift - mean) <= near).all()
    if far.sum() != 1 or not alike:
        return -1, 0.0
    axis = int(far.argmax())
    return axis, float(mean[axis])
