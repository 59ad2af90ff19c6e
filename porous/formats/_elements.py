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
    from numpy.typing import NDArray

    from porous.formats.gate import Source

GROWTH = 10
"""Bytes of memory for each of a file, at most: measured on 720 000 hexahedra in every format."""


@dataclass
class Draft:
    """A mesh that is being read: nodes with their numbers, and cells of node numbers by shape."""

    source: Source
    numbers: list[NDArray[np.int64]] = field(default_factory=list)
    points: list[NDArray[np.float64]] = field(default_factory=list)
    cells: dict[str, list[NDArray[np.int64]]] = field(default_factory=dict)
    bent: int = 0

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

    def mesh(self) -> VolumeMesh:
        """Return the mesh: nodes that cells use by their numbers, cells by shape as they came."""
        if not self.cells:
            raise FormatError("no volume elements; wanted hexahedra, wedges or tetrahedra")
        blocks = {shape: np.concatenate(rows) for shape, rows in self.cells.items()}
        used, places = np.unique(
            np.concatenate([rows.reshape(-1) for rows in blocks.values()]), return_inverse=True
        )
        points = self._places(used)
        note_bent(self.source, self.bent)
        ends = np.cumsum([rows.size for rows in blocks.values()])
        parts = np.split(places.astype(np.int64), ends[:-1])
        return VolumeMesh(
            points,
            tuple(
                Block(shape, part.reshape(rows.shape))
                for (shape, rows), part in zip(blocks.items(), parts, strict=True)
            ),
        )

    def _places(self, used: NDArray[np.int64]) -> NDArray[np.float64]:
        known = np.concatenate([np.zeros(0, np.int64), *self.numbers])
        order = np.argsort(known, kind="stable")
        known = known[order]
        if (twice := known[1:][known[1:] == known[:-1]]).size:
            refuse("nodes", f"number {twice[0]} twice", "each number once")
        at = np.searchsorted(known, used)
        found = at < len(known)
        found[found] = known[at[found]] == used[found]
        if not found.all():
            missing = used[~found][0]
            raise FormatError(f"an element has node {missing}; it is not among {len(known)} nodes")
        points: NDArray[np.float64] = np.concatenate(self.points)[order[at]]
        return points


def note_bent(source: Source, count: int) -> None:
    """Say where hexahedra with nodes along their edges lose these."""
    if count:
        source.note(f"{count} hexahedra of more than 8 nodes are read by their corners")
