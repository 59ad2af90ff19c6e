"""A model as voxels that are worked out when they are asked for, tile by tile, on all threads."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.models.model import HasBulk, HasCover, HasDoubts, HasFill
from porous.values import CENTRE, FILL
from porous.values.grid import SAMPLINGS
from porous.values.value import Value, adopted

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from porous.models.model import Model
    from porous.values import Box, Frame, Pattern

    Bytes = NDArray[np.uint8]
    Index = tuple[int, int, int]
    Report = Callable[[int, int], None]

TILE = (64, 64, 128)
"""Voxels of a tile: its masks fit the cache, and lines along z are long."""

FULL = 1e-9
"""Part of a frame's volume that a bulk may lack and fill it all the same."""

MASK_BYTES = 8 * 6
"""Bytes per voxel of a tile while it is sampled, about."""

PATTERNS: Mapping[str, Pattern] = MappingProxyType({"centre": CENTRE, "fill": FILL})


@dataclass(frozen=True, eq=False)
class SampledModel(Value):
    """The voxels of a model (``Tiled``), none of them kept; what is pickled is model and frame.

    Parameters
    ----------
    model
        What is sampled.
    frame
        Where the voxels lie, in the model's unit.
    sampling
        fill, centre or cover, as in ``voxelize``.

    Raises
    ------
    GridError
        For an unknown sampling, or a cover of a model that has none.
    """

    model: Model
    frame: Frame
    sampling: str = "fill"

    def __post_init__(self) -> None:
        if self.sampling not in SAMPLINGS:
            raise GridError(
                f"sampling: got {self.sampling!r}; wanted one of {', '.join(SAMPLINGS)}"
            )
        if self.sampling == "cover" and not isinstance(self.model, HasCover):
            raise GridError("sampling: this model cannot be covered; wanted fill or centre")

    @property
    def is_bulk_sampled(self) -> bool:
        """Whether the bulk is a body of the model's own, and no box."""
        return isinstance(self.model, HasBulk)

    @cached_property
    def has_bulk(self) -> bool:
        """Whether some of the frame is not bulk."""
        box = self.frame.box
        if isinstance(self.model, HasBulk):
            # The frame holds it, so it fills the frame where it is as large.
            return self.model.bulk_volume < box.volume * (1 - FULL)
        return not self.model.bulk.contains(box, tolerance=1e-9 * max(box.lengths))

    @cached_property
    def hausdorff(self) -> float | None:
        """A bound on the distance between the solid voxels and the set, in ``frame.unit``."""
        is_cut = isinstance(self.model, HasDoubts) and self.model.is_cut
        return None if self.sampling != "cover" or is_cut else self._bound

    @cached_property
    def sampling_error(self) -> float:
        """How far the boundary of what is sampled may lie from the set's, in ``frame.unit``."""
        if self.sampling == "cover" or not isinstance(self.model, HasDoubts):
            return 0.0
        return self.model.sampling_error(self.frame)

    def block(self, start: Index, stop: Index) -> tuple[Bytes, Bytes | None]:
        """Return fill and bulk of the voxels ``start`` … ``stop`` (not within)."""
        return self.fill(start, stop), self.bulk(start, stop)

    def fill(self, start: Index, stop: Index, report: Report | None = None) -> Bytes:
        """Return the fill of a box; ``report`` is called with tiles done and all of them."""
        frame = self.frame.tile(start, stop)
        if self.sampling == "cover":
            assert self._bound >= 0  # found now, not by every thread
            return adopted(_each_tile(frame, self._cover, report, np.zeros))
        model, pattern = self.model, PATTERNS[self.sampling]
        if isinstance(model, HasFill):
            fill = model.fill(frame, pattern, report)
            if fill is not None:
                return adopted(fill)
        return adopted(_counted(model.sample, frame, pattern, report))

    def bulk(self, start: Index, stop: Index, report: Report | None = None) -> Bytes | None:
        """Return which part of each voxel of a box is bulk; None where all of the frame is."""
        if not self.has_bulk:
            return None
        frame = self.frame.tile(start, stop)
        if isinstance(self.model, HasBulk):
            # Sampled at the points of a fill: a solid that lies in it then does so in each voxel.
            return adopted(_counted(self.model.sample_bulk, frame, FILL, report))
        return adopted(_part_in_box(self.model.bulk, frame))

    def _cover(self, tile: Frame, out: Bytes) -> None:
        assert isinstance(self.model, HasCover)
        marks, bound = self.model.cover(tile)
        if marks.any():
            np.multiply(marks != 0, np.uint8(255), out=out)
        assert bound <= self._bound

    @cached_property
    def _bound(self) -> float:
        """The bound that any tile's cover has: it depends on the lattice alone."""
        assert isinstance(self.model, HasCover)
        return self.model.cover(self.frame.tile((0, 0, 0), (1, 1, 1)))[1]


def _counted(
    masks: Callable[[Frame, Pattern], NDArray[np.uint64]],
    frame: Frame,
    pattern: Pattern,
    report: Report | None,
) -> Bytes:
    """Return how much of each voxel is set in the masks of its tile."""
    table = _fills(pattern)

    def sample(tile: Frame, out: Bytes) -> None:
        out[...] = table[np.bitwise_count(masks(tile, pattern))]

    return _each_tile(frame, sample, report)


def _fills(pattern: Pattern) -> Bytes:
    """Return the fill of each number of samples: (255·k + P/2) // P."""
    count = pattern.points
    return np.array([(255 * k + count // 2) // count for k in range(count + 1)], np.uint8)


def _each_tile(
    frame: Frame,
    sample: Callable[[Frame, Bytes], None],
    report: Report | None,
    begin: Callable[[Index, type], Bytes] = np.empty,
) -> Bytes:
    """Return what ``sample(tile, its part of the result)`` fills in, tile by tile."""
    from porous.kernels._shared import slabs

    result = begin(frame.shape, np.uint8)
    tiles = _tiles(frame.shape)

    def work(first: int, last: int) -> None:
        for start, stop in tiles[first:last]:
            part = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
            sample(frame.tile(start, stop), result[part])

    slabs(len(tiles), 1, work, report)
    return result


def _tiles(shape: Sequence[int]) -> list[tuple[Index, Index]]:
    steps = [range(0, n, size) for n, size in zip(shape, TILE, strict=True)]
    return [
        (
            (x, y, z),
            (min(x + TILE[0], shape[0]), min(y + TILE[1], shape[1]), min(z + TILE[2], shape[2])),
        )
        for x, y, z in product(*steps)
    ]


def _part_in_box(bulk: Box, frame: Frame) -> Bytes:
    """Return which part of each voxel lies in a box, 255 being all of it."""
    parts = []
    for axis in range(3):
        edge = frame.start[axis] + np.arange(frame.shape[axis] + 1)
        place = frame.origin[axis] + edge * frame.spacing[axis]
        inside = np.clip(place, bulk.lower[axis], bulk.upper[axis])
        parts.append(np.diff(inside) / frame.spacing[axis])
    plane = parts[1][:, None] * parts[2]
    result = np.empty(frame.shape, np.uint8)
    for x, part in enumerate(parts[0]):
        result[x] = np.rint(255 * part * plane)
    return result
