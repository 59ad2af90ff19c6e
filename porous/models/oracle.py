"""What is exactly so of a digit set's prefractal: a transfer matrix over 2×2×2 windows.

Refining a voxel into N³ turns the window about a vertex into the windows about N³ finer vertices,
by a rule that knows nothing but the window and the digit set. Counts of windows at level n are the
n-th power of that matrix on those of the full cube: whole numbers, for any level.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from porous.models.digits import DigitSet
from porous.values.value import Value

if TYPE_CHECKING:
    from numpy.typing import NDArray

Axes = tuple[bool, bool, bool]
Offset = tuple[int, int, int]
VACUUM: Axes = (False, False, False)
_CORNERS = tuple(product((0, 1), repeat=3))
_AROUND = tuple((x, y, z) for x, y, z in product((-1, 0, 1), repeat=3) if x or y or z)
_NEIGHBOURS = {
    6: frozenset(e for e in _AROUND if sum(map(abs, e)) == 1),
    26: frozenset(_AROUND),
}
"""Offsets of voxels that are joined, by connectivity."""


@dataclass(frozen=True, eq=False)
class Prefractal(Value):
    """A digit set's level-``level`` body in voxel units, N^level along each axis.

    ``periodic`` axes close on themselves; else the body lies in vacuum.
    """

    digits: DigitSet
    level: int
    periodic: Axes = VACUUM

    @cached_property
    def histogram(self) -> tuple[int, ...]:
        """How often each of the 256 windows occurs, exact; numbered as in ``kernels.windows``."""
        transfer = _transfer(self.digits)
        counts = _level_zero(self.periodic)
        for _ in range(self.level):
            finer: dict[int, int] = {}
            for window, count in counts.items():
                for target, times in transfer[window].items():
                    finer[target] = finer.get(target, 0) + count * times
            counts = finer
        side: int = self.digits.divisions**self.level
        vertices = 1
        for wraps in self.periodic:
            vertices *= side if wraps else side + 1
        counts[0] = vertices - sum(n for window, n in counts.items() if window)
        return tuple(counts.get(window, 0) for window in range(256))

    def count(self, name: str) -> int:
        """Return the value of one of ``kernels.windows.FUNCTIONALS``, exact."""
        from porous.kernels.windows import FUNCTIONALS

        return sum(n * int(w) for n, w in zip(self.histogram, FUNCTIONALS[name], strict=True))

    @property
    def cells(self) -> int:
        """Number of solid voxels."""
        return int(len(self.digits.keep) ** self.level)

    @property
    def faces(self) -> int:
        """Number of voxel faces between solid and void."""
        return sum(self.count(f"faces_{axis}") for axis in "xyz")

    @property
    def border_faces(self) -> int:
        """Number of solid voxel faces on the cube's sides, of axes in vacuum."""
        ends = (0, self.digits.divisions - 1)
        return sum(
            int((self.digits.keep[:, axis] == end).sum()) ** self.level
            for axis, wraps in enumerate(self.periodic)
            if not wraps
            for end in ends
        )

    def components(self, connectivity: int = 6) -> int | None:
        """Return the number of pieces where it follows level by level, else None.

        Copies of the level n−1 body touch across a side, an edge or a corner exactly where a path
        of length n−1 leads through the digits of both (the neighbour graph). Where the level n−1
        body is one piece, the pieces of level n are those of the graph of copies that touch; where
        no copies touch, pieces multiply.
        """
        pieces: int | None = 1
        touching = _NEIGHBOURS[connectivity]
        graph = _graph(self.digits, touching, VACUUM)
        for level in range(1, self.level + 1):
            if level == self.level and any(self.periodic):
                graph = _graph(self.digits, touching, self.periodic)
            pieces = _next_pieces(len(self.digits.keep), graph, pieces)
            finer = _steps(self.digits, touching)
            if finer != touching:
                touching, graph = finer, _graph(self.digits, finer, VACUUM)
        return pieces

    def cavities(self, connectivity: int = 26) -> int | None:
        """Return the number of enclosed voids where a theorem tells, else None; in vacuum only.

        ``connectivity`` is that of the void. At level 1 they are counted. There is none at any
        level where, for some axis and sense, (a) every void sub-cube of the cube is joined within
        it to a void one at the cube's side in that sense, and (b) what is void at that side is
        void at the opposite one. For then a void of a copy leads to the copy's side, through it
        into the next copy or a void sub-cube, and so on out of the cube.
        """
        if any(self.periodic):
            return None
        if self.level == 0:
            return 0
        if self.level == 1:
            return _enclosed(self.digits, connectivity)
        return 0 if _drains(self.digits, connectivity) else None

    def genus(self, connectivity: int = 6) -> int | None:
        """Return the number of independent tunnels of the solid, where it can be derived.

        The first Betti number b₁ = pieces + cavities − χ; where the body is one piece without
        cavities it is 1 − χ. In vacuum only: a torus of space has tunnels of its own.
        """
        pieces, cavities = self.components(connectivity), self.cavities(32 - connectivity)
        if pieces is None or cavities is None:
            return None
        name = "euler_number" if connectivity == 6 else "euler_number_26"
        return pieces + cavities - self.count(name)


def _level_zero(periodic: Axes) -> dict[int, int]:
    """Return the windows about the vertices of one solid voxel."""
    # Along a vacuum axis there are two vertices, the voxel above or below each; along a periodic
    # one there is one, with the voxel on both sides.
    sides = [((1, 1),) if wraps else ((0, 1), (1, 0)) for wraps in periodic]
    counts: dict[int, int] = {}
    for x, y, z in product(*sides):
        window = sum(1 << (4 * a + 2 * b + c) for a, b, c in _CORNERS if x[a] and y[b] and z[c])
        counts[window] = counts.get(window, 0) + 1
    return counts


def _transfer(digits: DigitSet) -> tuple[dict[int, int], ...]:
    return _transfer_of(digits.divisions, digits.keep.tobytes())


@lru_cache(maxsize=64)
def _transfer_of(divisions: int, keep: bytes) -> tuple[dict[int, int], ...]:
    """Return for each coarse window how often each fine one follows from it.

    The N³ fine vertices fall into eight classes, by the axes along which their window straddles
    two coarse voxels; within a class the fine window is the digits' own pattern, masked by the
    coarse voxels that it reaches.
    """
    digits = DigitSet(divisions, np.frombuffer(keep, np.int64).reshape(-1, 3))
    result: list[dict[int, int]] = [{} for _ in range(256)]
    patterns = _patterns(digits)
    for straddled, counts in patterns.items():
        for coarse in range(256):
            reach = _spread(coarse, straddled)
            row = result[coarse]
            for pattern, count in counts.items():
                row[pattern & reach] = row.get(pattern & reach, 0) + count
    return tuple(result)


def _patterns(digits: DigitSet) -> dict[tuple[int, ...], dict[int, int]]:
    """Return how often each window of the digits' wrapped table occurs, by axes straddled."""
    codes: NDArray[np.uint8] = np.zeros((digits.divisions,) * 3, np.uint8)
    table = digits.table
    for a, b, c in _CORNERS:
        shifted = np.roll(table, (-a, -b, -c), axis=(0, 1, 2))
        codes |= shifted.astype(np.uint8) << np.uint8(4 * a + 2 * b + c)
    result = {}
    for straddled in _CORNERS:
        part = codes[tuple(slice(-1, None) if s else slice(0, -1) for s in straddled)]
        found, counts = np.unique(part, return_counts=True)
        result[straddled] = dict(zip(found.tolist(), counts.tolist(), strict=True))
    return result


def _spread(coarse: int, straddled: tuple[int, ...]) -> int:
    """Return the mask of fine voxels that lie in solid coarse ones."""
    reach = 0
    for a, b, c in _CORNERS:
        x, y, z = (o * s for o, s in zip((a, b, c), straddled, strict=True))
        if coarse >> (4 * x + 2 * y + z) & 1:
            reach |= 1 << (4 * a + 2 * b + c)
    return reach


def _next_pieces(copies: int, graph: tuple[int, bool], before: int | None) -> int | None:
    pieces, joined = graph
    if before == 1:
        return pieces
    if before is None or joined:
        return None
    return copies * before


@lru_cache(maxsize=64)
def _steps(digits: DigitSet, alive: frozenset[Offset]) -> frozenset[Offset]:
    """Return the coarse offsets from which some pair of digits leads to a live finer one.

    Two copies of the level-n body touch at an offset where n such steps lead to neighbours.
    """
    table, n = digits.table, digits.divisions
    return frozenset(
        coarse
        for coarse in _AROUND
        if any(
            # The second copy's digit follows from the first's and the finer offset.
            _overlap(table, [f - n * e for f, e in zip(fine, coarse, strict=True)])
            for fine in alive
        )
    )


def _overlap(table: NDArray[np.bool_], shift: list[int]) -> bool:
    """Tell whether the table has a kept sub-cube and a kept one ``shift`` further."""
    if max(map(abs, shift)) >= len(table):
        return False
    here = tuple(slice(max(0, -s), len(table) - max(0, s)) for s in shift)
    there = tuple(slice(max(0, s), len(table) - max(0, -s)) for s in shift)
    return bool((table[here] & table[there]).any())


@lru_cache(maxsize=64)
def _graph(digits: DigitSet, touching: frozenset[Offset], periodic: Axes) -> tuple[int, bool]:
    """Return the number of pieces of the graph of copies that touch, and whether any do."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n, count = digits.divisions, len(digits.keep)
    number = np.full((n,) * 3, -1)
    number[tuple(digits.keep.T)] = np.arange(count)
    edges = [np.zeros((0, 2), np.int64)]
    for offset in touching:
        other = digits.keep + offset
        inside = ((other >= 0) & (other < n) | np.array(periodic)).all(axis=1)
        found = number[tuple((other[inside] % n).T)]
        pairs = np.stack([np.flatnonzero(inside), found], axis=1)
        edges.append(pairs[found >= 0])
    a, b = np.concatenate(edges).T
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(count, count))
    return int(connected_components(graph, directed=False)[0]), bool(len(a))


def _enclosed(digits: DigitSet, connectivity: int) -> int:
    padded = np.pad(~digits.table, 1, constant_values=True)
    return _labelled(padded, connectivity)[1] - 1


def _drains(digits: DigitSet, connectivity: int) -> bool:
    """Tell whether every void leads out of the body at every level; see ``cavities``."""
    void = ~digits.table
    labels, count = _labelled(void, connectivity)
    for axis in range(3):
        for near, far in ((0, -1), (-1, 0)):
            here, there = void.take(near, axis), void.take(far, axis)
            reached = np.unique(labels.take(near, axis))
            if (reached > 0).sum() == count and not (here & ~there).any():
                return True
    return False


def _labelled(void: NDArray[np.bool_], connectivity: int) -> tuple[NDArray[np.int32], int]:
    from scipy import ndimage

    structure = ndimage.generate_binary_structure(3, 1 if connectivity == 6 else 3)
    labels, count = ndimage.label(void, structure)
    return labels, int(count)
