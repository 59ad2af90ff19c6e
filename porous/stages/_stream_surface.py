"""The step from voxels to a closed surface in a file, where neither need fit into memory."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from porous import disk
from porous.errors import FormatError
from porous.formats import ply, stl
from porous.memory import available, check_memory
from porous.stages._extract_surface import NAMES, check_fullest
from porous.values.tiled import Chunked
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray

    from porous.kernels.surface import Slab
    from porous.values import Tiled

    Progress = Callable[[str, float], None]
    Span = tuple[float, float]
    Cut = Callable[[int, int], Iterator[tuple[int, int]]]

T = TypeVar("T")

VOXELS = 1 << 23
"""Voxels of a slab, about, while counting: what they give is kept for a moment at most."""
TRIANGLES = 1 << 21
"""Triangles of a slab, about, while writing."""
READ = 1 << 26
"""Voxels that are read at once, where the source does not come in chunks of its own."""
MOST_READ = 1 << 31
"""Voxels that are read at once at most, even where chunks are larger: 2 GiB."""
BYTES = 150
"""Memory that a triangle takes while it is written, with its half of a point, in several forms."""
GAP = (1 - 1e-9) / 256
"""Vertices lie at least this far from voxel centres, in voxels: any two differ so along an axis."""


@dataclass(frozen=True)
class StreamedSurface(Value):
    """What is known of a surface that went into a file.

    Parameters
    ----------
    points, triangles
        How many there are.
    volume
        Enclosed volume, in ``unit`` cubed.
    area
        Of all triangles, in ``unit`` squared.
    caps_area
        Of those on the frame's own faces: all that is not WALL.
    unit
        Unit of length.
    """

    points: int
    triangles: int
    volume: float
    area: float
    caps_area: float
    unit: str

    @property
    def euler_number(self) -> int:
        """Points − edges + triangles of the closed surface."""
        return self.points - self.triangles // 2


def stream_surface(
    source: Tiled, path: str | Path, *, progress: Progress | None = None
) -> StreamedSurface:
    """Write the closed surface of the solid voxels of ``source``, slab by slab, to STL or PLY.

    The file has the bytes that ``extract_surface`` by marching cubes and ``write`` would give it:
    slabs count alike on both sides of a seam, so vertices there have one number. Memory is that
    of one layer of the source's chunks (or of 2²⁶ voxels) and of what a few planes of it give.

    Parameters
    ----------
    source
        The body: a ``VoxelGrid``, a stored grid, anything that gives out boxes of voxels. It is
        gone through three times; for STL twice, if single precision keeps all vertices apart.
    path
        Its suffix, .stl or .ply, says the format. The file appears whole or not at all.
    progress
        Called as ``progress("stream_surface", done)`` with done in 0 … 1; raising in it cancels.

    Returns
    -------
    StreamedSurface
        Numbers of points and triangles, volume and area; they do not depend on slabs.

    Raises
    ------
    FormatError
        For another suffix, or more than the format can count.
    MeshError
        Where no voxel is solid.
    DiskError
        Where the disk refuses.
    MemoryLimitError
        Where not even the voxels of a plane and what they give would fit into memory.
    """
    writer = WRITERS.get(Path(path).suffix.lower())
    if writer is None:
        wanted = " or ".join(WRITERS)
        raise FormatError(f"{path}: surfaces are streamed to {wanted}. Use extract_surface")
    surface = _Surface(source, progress)
    try:
        disk.write_bytes(path, writer(surface))
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None
    return surface.told()


class _Surface:
    """A surface that is gone through slab by slab, and what is learned on the way."""

    def __init__(self, source: Tiled, progress: Progress | None) -> None:
        self.source, self.progress = source, progress
        self.frame = source.frame
        self.planes, *plane = self.frame.shape
        self.plane = plane[0] * plane[1]
        self.read = _planes_read(source, self.plane)
        self.counts = np.zeros((self.planes + 1, 2), dtype=np.int64)
        self.sums = np.zeros((self.planes + 1, 3))

    def told(self) -> StreamedSurface:
        area, caps, volume = (math.fsum(column) for column in self.sums.T)
        points, triangles = self.counts.sum(axis=0).tolist()
        return StreamedSurface(points, triangles, volume, area, caps, self.frame.unit)

    def count(self, until: float, look: Callable[[Slab], None] = lambda _slab: None) -> None:
        """Go through the voxels once, for the numbers of vertices and triangles of every row."""

        def count(slab: Slab) -> None:
            self.counts[slab.first : slab.last] = slab.counts
            look(slab)

        deque(self._each(self._by_voxels, count, (0.0, until)), maxlen=0)
        if not self.counts.any():
            check_fullest(max(self._each(self._by_voxels, _fullest)))
        totals = self.counts[:, 1]
        largest = min(int(totals.sum()), int(totals.max()) + TRIANGLES)
        check_memory(BYTES * largest, "A slab of the surface", "Use a frame with smaller planes.")

    def points(self, span: Span) -> Iterator[NDArray[np.float64]]:
        """Go through all points, in the order of their numbers."""
        return self._each(self._by_triangles, lambda slab: slab.points(self.frame), span)

    def faces(self, span: Span) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int16]]]:
        """Go through all triangles, as numbers of points, and their labels."""
        before = np.cumsum(self.counts[:, 0]) - self.counts[:, 0]

        def faces(slab: Slab) -> tuple[NDArray[np.int64], NDArray[np.int16]]:
            triangles, labels = slab.triangles(), slab.labels()
            self.sums[slab.first : slab.last] = slab.sums(self.frame, triangles, labels)
            return triangles + before[slab.first], labels

        return self._each(self._by_triangles, faces, span)

    def corners(self, span: Span) -> Iterator[NDArray[np.float64]]:
        """Go through the corners of all triangles, float64, shape (t, 3, 3)."""

        def corners(slab: Slab) -> Iterator[NDArray[np.float64]]:
            points, triangles = slab.points(self.frame, beyond=True), slab.triangles()
            labels = slab.labels()
            self.sums[slab.first : slab.last] = slab.sums(self.frame, triangles, labels)
            starts = range(0, len(triangles), stl.SLAB)
            return (points[triangles[a : a + stl.SLAB]] for a in starts)

        return chain.from_iterable(self._each(self._by_triangles, corners, span))

    def _each(self, cut: Cut, take: Callable[[Slab], T], span: Span | None = None) -> Iterator[T]:
        """Return what ``take`` gives of each slab; ``cut`` says what of the rows at hand is one.

        ``take`` must not keep the slab: the voxels that were read for it make way for the next.
        """
        from porous.kernels.surface import Slab

        held = np.empty((0, *self.frame.shape[1:]), np.uint8)
        for start in range(0, self.planes, self.read):
            stop = min(start + self.read, self.planes)
            fill, _ = self.source.block((start, 0, 0), (stop, *self.frame.shape[1:]))
            # A row of cubes lies between two planes, and the next row's vertices need a third.
            for first, last in cut(max(start - 1, 0), stop - 1 if stop < self.planes else stop + 1):
                low, high = max(first - 1, 0) - start, min(last + 1, self.planes) - start
                near = fill[low:high] if low >= 0 else np.concatenate([held[low:], fill[:high]])
                yield take(Slab(near, self.planes, first, last))
                del near
                self._tell(last, span)
            held = np.concatenate([held, fill[-2:]])[-2:]
            del fill

    def _tell(self, rows: int, span: Span | None) -> None:
        if self.progress is not None and span is not None:
            part = rows / (self.planes + 1)
            self.progress("stream_surface", span[0] + (span[1] - span[0]) * part)

    def _by_voxels(self, first: int, last: int) -> Iterator[tuple[int, int]]:
        step = max(1, VOXELS // self.plane)
        return ((a, min(a + step, last)) for a in range(first, last, step))

    def _by_triangles(self, first: int, last: int) -> Iterator[tuple[int, int]]:
        for a, b in self._by_voxels(first, last):
            ends = np.cumsum(self.counts[a:b, 1])
            parts = (np.maximum(ends, 1) - 1) // TRIANGLES
            cuts = [a, *(a + 1 + np.flatnonzero(np.diff(parts))).tolist(), b]
            yield from pairwise(cuts)


def _fullest(slab: Slab) -> int:
    return int(slab.fill.max(initial=0))


def _planes_read(source: Tiled, plane: int) -> int:
    """Return how many planes of voxels to read at once: those of a layer of chunks, if they fit."""
    most = max(1, min(MOST_READ, available() // 4) // plane)
    if not isinstance(source, Chunked):
        return min(most, max(1, READ // plane))
    start, stop = source.tiles[0]
    return min(most, stop[0] - start[0])


def _ply(surface: _Surface) -> Iterator[bytes]:
    surface.count(0.2)
    points, triangles = surface.counts.sum(axis=0).tolist()
    return ply.stream(
        surface.frame.unit,
        NAMES,
        (points, triangles),
        surface.points((0.2, 0.5)),
        surface.faces((0.5, 1.0)),
    )


def _stl(surface: _Surface) -> Iterator[bytes]:
    frame = surface.frame
    bounds = np.full(3, np.inf), np.full(3, -np.inf)

    def look(slab: Slab) -> None:
        points = slab.points(frame)
        if len(points):
            np.minimum(bounds[0], points.min(axis=0), out=bounds[0])
            np.maximum(bounds[1], points.max(axis=0), out=bounds[1])

    surface.count(0.2, look)
    apart = stl.stay_apart(bounds, GAP * np.array(frame.spacing))
    spans = iter([(0.2, 1.0)] if apart else [(0.2, 0.5), (0.5, 1.0)])
    count = int(surface.counts[:, 1].sum()) if apart else None
    return stl.stream(frame.unit, bounds, lambda: surface.corners(next(spans)), count)


WRITERS: Mapping[str, Callable[[_Surface], Iterator[bytes]]] = MappingProxyType(
    {".stl": _stl, ".ply": _ply}
)
"""The formats that take a surface piece by piece."""
