"""From voxels to hexahedra: one for each voxel of the solid, of the pores, or of both."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.memory import check_memory
from porous.values import Block, Part, VolumeMesh, VoxelGrid
from porous.values.volume_mesh import PHASE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.values import Frame

    Indices = NDArray[np.int64]
    Flags = NDArray[np.bool_]
    Bytes = NDArray[np.uint8]

PHASES = ("solid", "pore", "both")
CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
"""A voxel's corners in VTK's order of a hexahedron's nodes."""

OCTANTS = tuple(itertools.product((0, 1), repeat=3))
"""The eight voxels around a lattice point; bit 4·dx + 2·dy + dz of its window."""

BYTES_PER_CELL, BYTES_PER_VOXEL = 400, 40


def hexahedralize(grid: VoxelGrid, *, phase: str = "solid") -> VolumeMesh:
    """Return one trilinear hexahedron for each voxel of a phase.

    Nodes are shared across faces only: voxels that touch in an edge or a point, and are not
    joined around it by others, each have nodes of their own there. Cells are in the voxels' order,
    x slowest. So pores, like solids, are joined across faces here, unlike in what is measured of a
    grid.

    Along periodic axes voxels are joined across the border too: opposite sides have the same nodes
    wherever the body goes on from one to the other, and the parts ``XPAIRS`` … ``ZPAIRS`` name
    them, the node at MIN first. Nodes of a side that the body ends at have no partner; a part
    without pairs says that nothing goes on along a periodic axis.

    Parameters
    ----------
    grid
        In memory.
    phase
        ``"solid"``; ``"pore"``, the voxels of the bulk (of the frame where there is none) that are
        not solid; ``"both"`` as one mesh that shares the nodes between them. Meshes of pores have
        the tag ``"phase"``: 1 solid, 0 pore.

    Raises
    ------
    GridError
        For another phase, and where no voxel is of it.
    MemoryLimitError
        Before anything is allocated.
    """
    if not isinstance(grid, VoxelGrid):
        raise GridError(
            f"hexahedralize: got a {type(grid).__name__}; wanted a grid in memory, as its "
            "to_grid() is where it fits"
        )
    if phase not in PHASES:
        raise GridError(f"phase: got {phase!r}; wanted one of {', '.join(PHASES)}")
    taken = _taken(grid, phase)
    count = int(np.count_nonzero(taken))
    if not count:
        raise GridError(
            f"voxels: none of the {grid.frame.size} voxels is {phase}; no cells to make"
        )
    check_memory(
        BYTES_PER_CELL * count + BYTES_PER_VOXEL * grid.frame.size,
        f"a mesh of {count} hexahedra",
        "Choose fewer voxels, or tetrahedra of the surface.",
    )
    lattice = _Lattice(taken, grid.frame.periodic)
    return VolumeMesh(
        _points(grid.frame, lattice.amount),
        (Block("hex8", lattice.cells(np.argwhere(taken))),),
        {} if phase == "solid" else {PHASE: grid.solid[taken].astype(np.int64)},
        dict(lattice.pairs()),
        grid.frame.unit,
    )


def _taken(grid: VoxelGrid, phase: str) -> Flags:
    """Return which voxels are of the phase; what is solid is so beyond the bulk too."""
    if phase == "solid":
        return grid.solid
    whole = np.ones(grid.frame.shape, np.bool_) if grid.bulk is None else grid.bulk >= 128
    return np.asarray(whole & ~grid.solid if phase == "pore" else whole | grid.solid)


class _Lattice:
    """The points between voxels, and the nodes that each of them has."""

    def __init__(self, taken: Flags, periodic: tuple[bool, bool, bool]) -> None:
        self.periodic = periodic
        self.windows = _windows(taken, periodic)
        self.ends = [_ends(n, wraps) for n, wraps in zip(taken.shape, periodic, strict=True)]
        sides = self._sides(*np.ix_(*self.ends))
        self.amount = COUNT[sides, self.windows]
        self.first = np.cumsum(self.amount.ravel(), dtype=np.int64).reshape(sides.shape)
        self.first -= self.amount

    @staticmethod
    def _sides(x: Bytes, y: Bytes, z: Bytes) -> Bytes:
        return np.asarray(9 * x + 3 * y + z, np.uint8)

    def cells(self, voxels: Indices) -> Indices:
        """Return the nodes of voxels (n, 3)."""
        cells = np.empty((len(voxels), 8), dtype=np.int64)
        for node, corner in enumerate(CORNERS):
            at = tuple((voxels + corner).T)
            dx, dy, dz = (1 - c for c in corner)
            sides = self._sides(*(ends[i] for ends, i in zip(self.ends, at, strict=True)))
            rank = RANK[sides, self.windows[at], 4 * dx + 2 * dy + dz]
            cells[:, node] = self.first[at] + rank
        return cells

    def pairs(self) -> Iterator[tuple[str, Part]]:
        """Yield the pairs of nodes of each periodic axis, none where nothing goes on along it."""
        for axis, wraps in enumerate(self.periodic):
            if wraps:
                yield f"{'XYZ'[axis]}PAIRS", Part("pairs", self._pairs_along(axis))

    def _pairs_along(self, axis: int) -> Indices:
        low, high = (
            tuple(np.moveaxis(field, axis, 0)[end] for field in (self._all_sides, self.first))
            for end in (0, -1)
        )
        window = np.moveaxis(self.windows, axis, 0)[0]
        found = []
        for group in range(GROUPS):
            ranks = [GROUP_RANK[sides, window, group] for sides, _ in (low, high)]
            both = np.logical_and(*(rank >= 0 for rank in ranks))
            nodes = [
                end[1][both] + rank[both] for end, rank in zip((low, high), ranks, strict=True)
            ]
            found.append(np.stack(nodes, axis=1))
        pairs = np.concatenate(found)
        return np.asarray(pairs[np.argsort(pairs[:, 0], kind="stable")])

    @property
    def _all_sides(self) -> Bytes:
        return self._sides(*np.ix_(*self.ends))


def _windows(taken: Flags, periodic: tuple[bool, bool, bool]) -> Bytes:
    """Return the 2×2×2 window of each lattice point as bits, shape (x + 1, y + 1, z + 1)."""
    x, y, z = taken.shape
    padded = taken.astype(np.uint8)
    for axis, wraps in enumerate(periodic):
        width = [(1, 1) if a == axis else (0, 0) for a in range(3)]
        padded = np.pad(padded, width, mode="wrap" if wraps else "constant")
    result = np.zeros((x + 1, y + 1, z + 1), dtype=np.uint8)
    for bit, (dx, dy, dz) in enumerate(OCTANTS):
        # Voxel (dx, dy, dz) of the window of point p is voxel p + (dx, dy, dz) − 1.
        result |= padded[dx : dx + x + 1, dy : dy + y + 1, dz : dz + z + 1] << np.uint8(bit)
    return result


def _ends(count: int, wraps: bool) -> Bytes:  # noqa: FBT001
    """Return for each plane of points which voxels about it have corners there.

    0 all of them, 1 the upper ones only, 2 the lower ones only: the others are copies. Beyond the
    border of a body in vacuum there are none.
    """
    ends = np.zeros(count + 1, np.uint8)
    if wraps:
        ends[0], ends[-1] = 1, 2
    return ends


def _points(frame: Frame, amount: Bytes) -> NDArray[np.float64]:
    used = np.argwhere(amount)
    place = np.repeat(used, amount[tuple(used.T)], axis=0)
    return np.asarray(frame.origin + (place + frame.start) * np.array(frame.spacing))


def _groups() -> Bytes:
    """Return for each window the group of each voxel, joined by faces: (256, 8)."""
    group = np.zeros((256, 8), dtype=np.uint8)
    for window in range(256):
        left = [bit for bit in range(8) if window >> bit & 1]
        count = 0
        while left:
            front = [left.pop(0)]
            while front:
                bit = front.pop()
                group[window, bit] = count
                near = [other for other in left if (bit ^ other) in (1, 2, 4)]
                left = [other for other in left if other not in near]
                front += near
            count += 1
    return group


GROUPS = 4
"""The most groups of voxels about a point."""


def _ranks() -> tuple[Bytes, NDArray[np.int8], Bytes]:
    """Return the nodes of a window (256) by which of its voxels have corners there (27).

    The rank of each voxel's node (27, 256, 8), of each group's (27, 256, 4), −1 where it has none,
    and how many there are (27, 256).
    """
    group = _groups()
    bits = np.arange(256)[:, None] >> np.arange(8) & 1
    member = (group[:, None] == np.arange(GROUPS)[:, None]) & (bits[:, None] == 1)
    kept = [(True, True), (False, True), (True, False)]
    own = np.array(
        [
            [all(side[d] for side, d in zip(sides, octant, strict=True)) for octant in OCTANTS]
            for sides in itertools.product(kept, repeat=3)
        ]
    )
    there = (member & own[:, None, None]).any(axis=3)
    rank = np.where(there, np.cumsum(there, axis=2) - 1, -1).astype(np.int8)
    of_voxel = np.take_along_axis(rank, np.broadcast_to(group, (27, 256, 8)).astype(int), axis=2)
    return of_voxel.clip(0).astype(np.uint8), rank, there.sum(axis=2).astype(np.uint8)


RANK, GROUP_RANK, COUNT = _ranks()
