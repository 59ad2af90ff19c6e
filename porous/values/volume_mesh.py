"""A mesh of volume elements with named parts."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError
from porous.values.surface import indices_checked, points_checked
from porous.values.units import check_unit
from porous.values.value import Value, frozen, frozen_whole

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray


SLAB = 1 << 14
"""Cells that are worked on at a time: their corners stay in the processor's cache."""
WIDTH = 4
"""Most nodes of a face; a triangle's fourth is −1."""


@dataclass(frozen=True)
class Shape:
    """A kind of volume element: its nodes, its VTK number and its outward faces."""

    nodes: int
    vtk: int
    faces: tuple[tuple[int, ...], ...]
    """Local corners of each face, counter-clockwise seen from outside."""
    linear: str = ""
    """Of a shape with nodes along its edges: the shape of its corners."""
    edges: tuple[tuple[int, int], ...] = ()
    """Local corners that each of the nodes beyond the corners lies between, in their order."""

    @property
    def table(self) -> NDArray[np.int64]:
        """The faces' nodes, (faces, ``WIDTH``), −1 where a face has fewer."""
        return np.array([(*face, *[-1] * (WIDTH - len(face))) for face in self.faces])


TETRAHEDRON = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
TETRAHEDRON_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
HEXAHEDRON = (
    (0, 3, 2, 1),
    (4, 5, 6, 7),
    (0, 1, 5, 4),
    (1, 2, 6, 5),
    (2, 3, 7, 6),
    (3, 0, 4, 7),
)
HEXAHEDRON_EDGES = (
    *((0, 1), (1, 2), (2, 3), (3, 0)),
    *((4, 5), (5, 6), (6, 7), (7, 4)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
)

SHAPES: Mapping[str, Shape] = MappingProxyType(
    {
        "tet4": Shape(4, 10, TETRAHEDRON),
        "hex8": Shape(8, 12, HEXAHEDRON),
        "tet10": Shape(10, 24, TETRAHEDRON, "tet4", TETRAHEDRON_EDGES),
        "hex20": Shape(20, 25, HEXAHEDRON, "hex8", HEXAHEDRON_EDGES),
        "wed6": Shape(6, 13, ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5))),
    }
)
"""The elements there are, corners first. Nodes are in VTK's order and Abaqus', which are the same
but for wedges: there in Abaqus', the first triangle seen from inside. Faces are numbered as
CalculiX and Abaqus number S1, S2, …"""

ADDRESS = "address"
"""The tag that a model's own cells bear: the place of each among all cells of its level."""

PHASE = "phase"
"""The tag of cells that says which phase they are of: 1 solid, 0 pore."""

PART_KINDS = ("nodes", "faces", "cells", "pairs")
ROWS = MappingProxyType({"faces": "(n, 2), cell and local face", "pairs": "(n, 2), nodes"})
"""Parts whose members are rows of two numbers."""


@dataclass(frozen=True, eq=False)
class Block(Value):
    """Cells of one shape: ``cells`` is int64, shape (n, nodes of the shape)."""

    shape: str
    cells: NDArray[np.int64]

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise MeshError(f"block: got shape {self.shape!r}; wanted one of {', '.join(SHAPES)}")
        self._set("cells", frozen_whole(self.cells, np.int64, self.shape, MeshError))


@dataclass(frozen=True, eq=False)
class Part(Value):
    """A named set: of nodes (n,), cells (n,), faces (n, 2) as (cell, local face), or pairs (n, 2).

    Pairs are nodes of a body that goes on in copies of itself: the second of each lies one
    period on from the first, and the period is the same for all pairs of a part.
    """

    kind: str
    members: NDArray[np.int64]

    def __post_init__(self) -> None:
        if self.kind not in PART_KINDS:
            raise MeshError(f"part: got kind {self.kind!r}; wanted one of {PART_KINDS}")
        self._set("members", frozen_whole(self.members, np.int64, "part", MeshError))
        told = ROWS.get(self.kind, "(n,)")
        if self.members.shape[1:] != ((2,) if self.kind in ROWS else ()) or not self.members.ndim:
            raise MeshError(f"part of {self.kind}: got shape {self.members.shape}; wanted {told}")


@dataclass(frozen=True, eq=False)
class VolumeMesh(Value):
    """Volume elements with shared nodes; cells are counted through the blocks in their order.

    Parameters
    ----------
    points
        float64, shape (n, 3), in ``unit``.
    blocks
        Cells by shape; every volume positive (``SHAPES``' node order).
    cell_tags
        Integer arrays, one number per cell: phase, body, …
    parts
        Named sets: nodes as ``"XMIN"``, faces as ``"XMIN_FACES"``, pairs as ``"XPAIRS"``.
    unit
        Unit of length.

    Raises
    ------
    MeshError
        For NaN points, indices out of range, tags of another length.
    """

    points: NDArray[np.float64]
    blocks: tuple[Block, ...]
    cell_tags: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)
    parts: Mapping[str, Part] = field(default_factory=dict)
    unit: str = "mm"

    def __post_init__(self) -> None:
        self._set("points", frozen(self.points, np.float64))
        self._set("blocks", tuple(self.blocks))
        check_unit(self.unit)
        points_checked(self.points, "volume mesh")
        for block in self.blocks:
            indices_checked(block.cells, len(self.points), SHAPES[block.shape].nodes, block.shape)
        tags = {
            name: frozen_whole(tag, np.int64, f"tag {name!r}", MeshError)
            for name, tag in self.cell_tags.items()
        }
        for name, tag in tags.items():
            if tag.shape != (self.cells,):
                raise MeshError(f"tag {name!r}: got {tag.shape}; there are {self.cells} cells")
        self._set("cell_tags", MappingProxyType(tags))
        self._set("parts", MappingProxyType(dict(self.parts)))
        self._check_parts()

    def _check_parts(self) -> None:
        for name, part in self.parts.items():
            limit = len(self.points) if part.kind in ("nodes", "pairs") else self.cells
            first = part.members[:, 0] if part.kind == "faces" else part.members
            if first.size and not 0 <= first.min() <= first.max() < limit:
                raise MeshError(
                    f"part {name!r}: members run from {first.min()} to {first.max()}; "
                    f"there are {limit}"
                )
            if part.kind == "faces":
                self._check_faces(name, part.members)

    def _check_faces(self, name: str, members: NDArray[np.int64]) -> None:
        faces = [np.full(len(block.cells), len(SHAPES[block.shape].faces)) for block in self.blocks]
        limits = np.concatenate(faces) if faces else np.zeros(0, np.int64)
        cell, face = members.T
        bad = np.flatnonzero((face < 0) | (face >= limits[cell]))
        if len(bad):
            raise MeshError(
                f"part {name!r}: cell {cell[bad[0]]} has no face {face[bad[0]]}; "
                f"its faces are 0 to {limits[cell[bad[0]]] - 1}"
            )

    @property
    def cells(self) -> int:
        """Number of cells in all blocks."""
        return sum(len(block.cells) for block in self.blocks)

    @property
    def is_of_cells(self) -> bool:
        """Whether it consists of a model's own cells, and so is the body itself."""
        return ADDRESS in self.cell_tags

    @property
    def volumes(self) -> NDArray[np.float64]:
        """Signed volume of each cell, in ``unit`` cubed; trilinear hexes exactly."""
        result = np.empty(self.cells)
        first = 0
        for block in self.blocks:
            faces = SHAPES[block.shape].faces
            for start in range(0, len(block.cells), SLAB):
                cells = block.cells[start : start + SLAB]
                result[first : first + len(cells)] = _volumes(self.points, cells, faces)
                first += len(cells)
        return result


def _volumes(
    points: NDArray[np.float64], cells: NDArray[np.int64], faces: tuple[tuple[int, ...], ...]
) -> NDArray[np.float64]:
    """Return volumes by cones over the faces from the first corner.

    A bilinear face and the fan of triangles about its mean m bound the same volume, and the
    fan's is m · (p₂ − p₀) × (p₃ − p₁) / 6, a triangle's p₀ · (p₁ − p₀) × (p₂ − p₀) / 6.
    """
    corners = (points[cells.T[: 1 + max(map(max, faces))]] - points[cells[:, 0]]).transpose(0, 2, 1)
    total = np.zeros(len(cells))
    for face in faces:
        a, b, c, d = corners[[face[0], face[1], face[2], face[-1]]]
        mean = corners[list(face)].sum(axis=0) / len(face)
        one, other = (c - a, d - b) if len(face) == WIDTH else (b - a, c - a)
        total += _triple(mean, one, other) / 6
    return total


def _triple(
    a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return a · b × c of vectors in columns, shape (3, n)."""
    return np.asarray(
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
