"""What readers of other programs' meshes share: nodes and cells that bear numbers of their own.

Abaqus and Gmsh number nodes as they like, with gaps and in any order. Cells name nodes by their
numbers; nodes that no cell names (of lines and faces, of arcs' centres, in the middle of edges) are
left out.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.formats.gate import refuse
from porous.memory import check_memory
from porous.values import SHAPES, Block, VolumeMesh

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from porous.formats.gate import Source
    from porous.values import Part

GROWTH = 10
"""Bytes of memory for each of a file, at most: measured on 720 000 hexahedra in every format."""
DENSE = 8
"""Numbers of nodes below so many for each node of a cell are marked, not sorted."""


@dataclass
class Draft:
    """A mesh that is being read: nodes with their numbers, and cells of node numbers by shape."""

    source: Source
    numbers: list[NDArray[np.int64]] = field(default_factory=list)
    points: list[NDArray[np.float64]] = field(default_factory=list)
    cells: dict[str, list[NDArray[np.int64]]] = field(default_factory=dict)
    bent: int = 0
    used: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    """Once settled: the numbers of the mesh's nodes, ascending."""
    blocks: tuple[Block, ...] = ()
    """Once settled: the cells, of nodes as the mesh has them."""
    where: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    """Once settled: the places of the mesh's nodes, (n, 3)."""

    def __post_init__(self) -> None:
        check_memory(GROWTH * len(self.source.data), "its nodes and elements", "Coarsen the mesh.")

    def add_nodes(self, numbers: NDArray[np.int64], points: NDArray[np.float64]) -> None:
        """Add nodes: their numbers, shape (n,), and places, shape (n, 3)."""
        self.numbers.append(numbers)
        self.points.append(points)

    def add_cells(self, shape: str, nodes: NDArray[np.int64]) -> None:
        """Add cells, of whose nodes those of the shape come first; none of a card without lines."""
        if not len(nodes):
            return
        count = SHAPES[shape].nodes
        self.bent += len(nodes) * (nodes.shape[1] > count)
        self.cells.setdefault(shape, []).append(nodes[:, :count])

    def settle(self) -> None:
        """Find the nodes that cells use, and number the cells' nodes by them."""
        if not self.cells:
            raise FormatError("no volume elements; wanted hexahedra, wedges or tetrahedra")
        note_bent(self.source, self.bent)
        rows = {shape: np.concatenate(some) for shape, some in self.cells.items()}
        self.cells.clear()
        self.used = _used(list(rows.values()))
        self.where = self._points()
        self.blocks = tuple(Block(shape, self.places(some)) for shape, some in rows.items())

    def places(self, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return which of the mesh's nodes bear some numbers, −1 for those that no cell uses."""
        return places_in(self.used, numbers)

    @property
    def shapes(self) -> list[str]:
        """The shapes of the blocks of a settled mesh."""
        return [block.shape for block in self.blocks]

    def mesh(self, parts: Mapping[str, Part] | None = None, unit: str = "mm") -> VolumeMesh:
        """Return the mesh: nodes that cells use by their numbers, cells by shape as they came."""
        if not self.blocks:
            self.settle()
        return VolumeMesh(self.where, self.blocks, parts=parts or {}, unit=unit)

    def _points(self) -> NDArray[np.float64]:
        known = np.concatenate([np.zeros(0, np.int64), *self.numbers])
        order = np.argsort(known, kind="stable")
        known = known[order]
        if (twice := known[1:][known[1:] == known[:-1]]).size:
            refuse("nodes", f"number {twice[0]} twice", "each number once")
        at = places_in(known, self.used)
        if (at < 0).any():
            missing = self.used[at < 0][0]
            raise FormatError(f"an element has node {missing}; it is not among {len(known)} nodes")
        points: NDArray[np.float64] = np.concatenate(self.points)[order[at]]
        return points


def places_in(known: NDArray[np.int64], numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return where numbers stand among known ones, which ascend; −1 for those that do not."""
    if not len(known):
        return np.full(numbers.shape, -1)
    if int(known[-1]) - int(known[0]) == len(known) - 1:  # each is one more than the one before
        if numbers.size and known[0] <= numbers.min() <= numbers.max() <= known[-1]:
            shifted: NDArray[np.int64] = numbers - known[0]
            return shifted
        inside = (numbers >= known[0]) & (numbers <= known[-1])
        return np.where(inside, numbers - known[0], -1)
    at = np.minimum(np.searchsorted(known, numbers), len(known) - 1)
    return np.where(known[at] == numbers, at, -1)


def _used(rows: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return the numbers that there are, ascending: marked where they are dense, else sorted."""
    most = sum(some.size for some in rows)
    if all(some.min() >= 0 and some.max() < DENSE * most for some in rows):
        marks = np.zeros(max(int(some.max()) for some in rows) + 1, bool)
        for some in rows:
            marks[some] = True
        return np.flatnonzero(marks)
    return np.unique(np.concatenate([some.reshape(-1) for some in rows]))


def note_bent(source: Source, count: int) -> None:
    """Say where hexahedra with nodes along their edges lose these."""
    if count:
        source.note(f"{count} hexahedra of more than 8 nodes are read by their corners")
