"""What voxels of a model will hold, learned from a few of them.

Solid voxels are found by the thousand in one place and not at all in another, and at a fixed level
the surface of a fractal changes its order of growth with the resolution. So the lattice is gone
down like an octree: boxes of it are looked at coarsely, those that hold a piece of the surface are
counted, a few of them are looked at more closely, and so on down to single voxels. How many boxes
have surface at each step is a branching ratio; their product is the number sought, and their
scatter says how well it is known. A lattice that is small is looked at whole, and known exactly.
"""

from __future__ import annotations

import math
import time
import zlib
from dataclasses import dataclass, replace
from itertools import islice, product
from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._cases import COUNTS
from porous.kernels.windows import block_histogram
from porous.stages import SampledModel

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from porous.models.model import Model
    from porous.values import Frame

    Bytes = NDArray[np.uint8]
    Ints = NDArray[np.int64]
    Index = tuple[int, int, int]

PARTS = 2
"""Parts along an edge that a box is looked at in, where that does not take too long."""
ROOT = 32
"""Boxes along the longest edge, at most, that the whole lattice is looked at in."""
WHOLE = 64
"""Voxels along the longest edge up to which a lattice is looked at as it is."""
FINER = 8
"""Parts along an edge that a box is cut into."""
LOOKS, FEWEST = 48, 6
"""Boxes that are looked at more closely, at every step: at most, and where that is slow."""
TIMED = 8
"""Boxes of voxels that are timed."""
BOX, SMALL = (32, 32, 64), (16, 16, 16)
"""Voxels of such a box, and where the model is slow."""
QUICK = 0.02
"""Seconds that boxes may take for larger ones to be timed, eight times as long at most."""
SECONDS = 0.5
"""No box is begun after this: what is not looked at by then is told from fewer boxes."""


@dataclass(frozen=True)
class Trial:
    """What a lattice of voxels will hold, about.

    Parameters
    ----------
    solid
        Number of voxels at least half solid.
    triangles
        Of their surface by marching cubes.
    doubt
        Standard error of ``triangles`` relative to it, as the scatter of the boxes tells.
    seconds
        That making the voxels takes.
    boxes
        Voxels that were looked at on the way, to be compressed on trial.
    is_exact
        Whether all voxels were looked at: then the numbers are what they will be.
    """

    solid: float
    triangles: float
    doubt: float
    seconds: float
    boxes: tuple[Bytes, ...] = ()
    is_exact: bool = False

    @property
    def compressed(self) -> float:
        """Bytes that a voxel takes on disk, about."""
        if not self.boxes:
            return 1.0
        bytes_ = sum(len(zlib.compress(box.tobytes(), 1)) for box in self.boxes)
        return bytes_ / sum(box.size for box in self.boxes)


def try_out(model: Model, frame: Frame, sampling: str) -> Trial:
    """Return what the voxels of a model will hold.

    Parameters
    ----------
    model
        What is to be sampled.
    frame
        Where the voxels lie.
    sampling
        fill, centre or cover.
    """
    return _Descent(model, frame, sampling).result()


class _Descent:
    """A lattice of cubes between voxel centres, looked at from coarse to fine.

    Cube k along an axis lies between the centres of voxels k − 1 and k, and beyond the frame is
    void: so there is one more cube than there are voxels, and the surface is closed.
    """

    def __init__(self, model: Model, frame: Frame, sampling: str) -> None:
        self.model, self.frame, self.sampling = model, frame, sampling
        self.begun = time.perf_counter()
        self.solid = self.triangles = self.variance = 0.0

    def result(self) -> Trial:
        frame = self.frame
        if max(frame.shape) <= WHOLE:
            fill = self._voxels((0, 0, 0), frame.shape)
            took = time.perf_counter() - self.begun
            self._count(np.pad(fill, 1), 1.0)
            return Trial(self.solid, self.triangles, 0.0, took, (fill,), is_exact=True)
        places, weight, edge = self._root()
        while edge > 1 and len(places):
            places, weight, edge = self._closer(places, weight, edge)
        doubt = math.sqrt(self.variance)
        boxes, seconds = self._timed()
        return Trial(self.solid, self.triangles, doubt, seconds, boxes)

    def _root(self) -> tuple[Ints, float, int]:
        cubes = [n + 1 for n in self.frame.shape]
        edge = 1 << math.ceil(math.log2(max(cubes) / ROOT))
        shape = [-(-n // edge) for n in cubes]
        origin = np.zeros(3, np.int64)
        begun = time.perf_counter()
        cells = self._cells(origin, shape, edge, 1)
        if PARTS**3 * (time.perf_counter() - begun) < SECONDS / 2:
            cells = self._cells(origin, shape, edge, PARTS)
        places = self._surface(origin, cells, edge, 1.0)
        return places, 1.0, edge

    def _closer(self, places: Ints, weight: float, edge: int) -> tuple[Ints, float, int]:
        """Look at some of the boxes that have surface; return those in them that do."""
        finer = max(1, edge // FINER)
        parts = [edge // finer] * 3
        chosen = places[_spread(len(places), LOOKS)]
        found, amounts = [np.zeros((0, 3), np.int64)], list[float]()
        looked = 0
        share = weight * len(places) / max(1, len(chosen))
        before = self.solid, self.triangles
        for place in chosen:
            if looked >= FEWEST and self._is_late:
                break
            looked += 1
            if finer == 1:
                triangles = self.triangles
                self._look(place, edge, share)
                amounts.append(self.triangles - triangles)
            else:
                inner = self._surface(place, self._cells(place, parts, finer, PARTS), finer, share)
                found.append(inner)
                amounts.append(float(len(inner)))
        more = len(chosen) / max(1, looked)
        self.solid = before[0] + more * (self.solid - before[0])
        self.triangles = before[1] + more * (self.triangles - before[1])
        self.variance += _relative_variance(amounts, len(places))
        return np.concatenate(found), share * more, finer

    def _surface(self, first: Ints, cells: tuple[Bytes, Bytes], edge: int, weight: float) -> Ints:
        """Return the first cubes of the boxes of a block that may have surface in them.

        A box is told by its corners: cells about them, as large as itself.
        """
        low, high = _around(cells[0], np.minimum), _around(cells[1], np.maximum)
        index = np.indices(low.shape).reshape(3, -1).T
        corner = first + index * edge
        ends = corner + edge >= np.array(self.frame.shape) + 1
        at_border = ((corner == 0) | ends).any(axis=1)
        beyond = (corner > np.array(self.frame.shape)).any(axis=1)
        low, high = low.reshape(-1), high.reshape(-1)
        # A cell that is wholly solid has no surface; one that is covered may have.
        has_void = (low < 255) | at_border | (self.sampling == "cover")
        mixed = (high > 0) & has_void & ~beyond
        full = (low == 255) & ~mixed & ~beyond
        self.solid += weight * float(full.sum()) * edge**3
        return np.asarray(corner[mixed])

    def _cells(
        self, first: Ints, shape: Sequence[int], edge: int, parts: int
    ) -> tuple[Bytes, Bytes]:
        """Return the emptiest and the fullest part of cells about the corners of boxes.

        There is one more along each axis than there are boxes, and each is looked at in so many
        parts along an edge: of what is thin the samples of a single fill may see nothing.
        """
        h = np.array(self.frame.spacing)
        # Cube k begins at the centre of voxel k − 1.
        low = np.array(self.frame.origin) + (first - 0.5 - edge / 2 + self.frame.start) * h
        frame = replace(
            self.frame,
            origin=tuple(low),
            spacing=tuple(edge / parts * h),
            shape=tuple(parts * (n + 1) for n in shape),  # type: ignore[arg-type]
            start=(0, 0, 0),
            periodic=(False, False, False),
        )
        sampling = "cover" if self.sampling == "cover" else "fill"
        fill = SampledModel(self.model, frame, sampling).fill((0, 0, 0), frame.shape)
        split = fill.reshape([k for n in shape for k in (n + 1, parts)])
        return split.min(axis=(1, 3, 5)), split.max(axis=(1, 3, 5))

    def _look(self, place: Ints, edge: int, weight: float) -> None:
        """Count what a box of single cubes holds."""
        start = [int(a) - 1 for a in place]
        stop = [min(a + edge + 1, n + 1) for a, n in zip(start, self.frame.shape, strict=True)]
        inner = [
            (max(a, 0), min(b, n)) for a, b, n in zip(start, stop, self.frame.shape, strict=True)
        ]
        fill = np.zeros([b - a for a, b in zip(start, stop, strict=True)], np.uint8)
        if all(a < b for a, b in inner):
            part = tuple(slice(a - s, b - s) for (a, b), s in zip(inner, start, strict=True))
            (x, u), (y, v), (z, w) = inner
            fill[part] = self._voxels((x, y, z), (u, v, w))
        self._count(fill, weight)

    def _count(self, fill: Bytes, weight: float) -> None:
        """Add the triangles of the cubes of a block, and the solid voxels at their lower ends."""
        nothing = ("nothing", "nothing", "nothing")
        windows = block_histogram(fill, below=nothing, above=nothing)
        self.triangles += weight * float(windows @ COUNTS)
        self.solid += weight * float(np.count_nonzero(fill[:-1, :-1, :-1] >= 128))

    def _voxels(self, start: Index, stop: Index) -> Bytes:
        return SampledModel(self.model, self.frame, self.sampling).fill(start, stop)

    def _timed(self) -> tuple[tuple[Bytes, ...], float]:
        """Return some boxes of voxels, and how long all would take at their rate."""
        boxes: list[Bytes] = []
        begun, count = time.perf_counter(), 0
        for start, stop in _boxes(self.frame.shape, SMALL if self._is_late else BOX):
            if boxes and self._is_late:
                break
            boxes.append(self._voxels(start, stop))
            count += boxes[-1].size
        rate = (time.perf_counter() - begun) / count
        return tuple(boxes), min(rate, *self._rates()) * self.frame.size

    def _rates(self) -> Iterator[float]:
        """Yield seconds per voxel of ever larger boxes, for a small one costs mostly its call."""
        yield math.inf
        box, took = BOX, 0.0
        while took < QUICK and math.prod(box) < self.frame.size:
            box = (2 * box[0], 2 * box[1], 2 * box[2])
            begun, count = time.perf_counter(), 0
            for start, stop in islice(_boxes(self.frame.shape, box), 2):
                count += self._voxels(start, stop).size
            took = time.perf_counter() - begun
            yield took / count

    @property
    def _is_late(self) -> bool:
        return time.perf_counter() - self.begun > SECONDS


def _around(cells: Bytes, extreme: np.ufunc) -> Bytes:
    """Return the least or the greatest of the eight corners of every box."""
    for axis in range(3):
        lower = tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))
        upper = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
        cells = extreme(cells[lower], cells[upper])
    return cells


def _spread(count: int, most: int) -> Ints:
    """Return the indices of at most so many of ``count`` things: one by chance of each stretch.

    Even steps would fall into step with a fractal's own. The chance is the same every time.
    """
    if count <= most:
        return np.arange(count)
    chance = np.random.default_rng(count)
    chosen = ((np.arange(most) + chance.random(most)) * count / most).astype(np.int64)
    return chance.permutation(chosen)  # the first of them are spread evenly too


def _relative_variance(amounts: Sequence[float], of: int) -> float:
    """Return the variance of a mean relative to its square, of a part of ``of`` things."""
    n, mean = len(amounts), float(np.mean(amounts)) if amounts else 0.0
    if n < 2 or not mean or n >= of:
        return 0.0
    return float(np.var(amounts, ddof=1)) / n / mean**2 * (1 - n / of)


def _boxes(shape: Index, box: Index) -> Iterator[tuple[Index, Index]]:
    """Yield boxes in the eight octants of a lattice, opposite ones first."""
    size = [min(a, n) for a, n in zip(box, shape, strict=True)]
    order = sorted(product((0, 1), repeat=3), key=lambda p: (sum(p) % 2, p))
    for place in order[:TIMED]:
        start = [
            int((n - a) * (0.31 + 0.37 * p)) for p, a, n in zip(place, size, shape, strict=True)
        ]
        x, y, z = start
        yield (x, y, z), (x + size[0], y + size[1], z + size[2])
