"""From a model to voxels: a frame, tiles on all threads, bits counted tile by tile."""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.memory import available, check_memory
from porous.models.model import HasBulk, HasCover, HasDoubts, HasFeature, HasFill
from porous.values import CENTRE, FILL, Frame, VoxelGrid
from porous.values.grid import SAMPLINGS
from porous.values.value import adopted

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from porous.models.model import Model
    from porous.values import Box, Pattern

    Bytes = NDArray[np.uint8]
    Span = tuple[tuple[int, int, int], tuple[int, int, int]]

TILE = (64, 64, 128)
"""Voxels of a tile: its masks fit the cache, and lines along z are long."""

MASK_BYTES = 8 * 6
"""Bytes per voxel of a tile while it is sampled, about."""

PATTERNS = {"centre": CENTRE, "fill": FILL}


def voxelize(
    model: Model,
    *,
    voxels: int | None = None,
    spacing: tuple[float, float, float] | None = None,
    per_feature: float | None = None,
    sampling: str = "fill",
    periodic: tuple[bool, bool, bool] = (False, False, False),
    cubic: bool = False,
    progress: Callable[[str, float], None] | None = None,
) -> VoxelGrid:
    """Sample a model on a lattice of voxels that fits its domain.

    Parameters
    ----------
    model
        What is sampled, in its own unit, which the grid takes over.
    voxels
        Number of voxels along the longest edge of the domain; give one of ``voxels``, ``spacing``
        and ``per_feature``.
    spacing
        Edge lengths of a voxel, in the model's unit; stretched until they fit the domain.
    per_feature
        Number of voxels across the model's smallest feature.
    sampling
        ``"fill"``: solid fraction of each voxel by 64 staggered samples; ``"centre"``: solid where
        the voxel's centre is; ``"cover"``: solid where the voxel touches the set (and perhaps a few
        more), with a bound on the Hausdorff distance.
    periodic
        Along which axes the body goes on in copies of itself.
    cubic
        Keep the voxels' edges equal and pad the frame instead of stretching them.
    progress
        Called as ``progress("voxelize", done)``, done from 0 to 1; raising in it cancels.

    Returns
    -------
    The grid; its bytes do not depend on the number of threads. ``bulk`` is set where the model's
    bulk is not the whole frame; a bulk that is no box is sampled at 64 points of each voxel.

    Raises
    ------
    GridError
        For no or several resolutions, an unknown sampling, a sampling or resolution that the model
        does not have.
    MemoryLimitError
        Before anything is allocated; names the largest number of voxels that fits.
    """
    if sampling not in SAMPLINGS:
        raise GridError(f"sampling: got {sampling!r}; wanted one of {', '.join(SAMPLINGS)}")
    steps = _spacing(model, voxels, spacing, per_feature)
    frame = Frame.fit(
        model.domain,
        voxels=voxels,
        spacing=steps,
        cubic=cubic,
        periodic=periodic,
        unit=model.unit,
    )
    own = isinstance(model, HasBulk)
    whole = not own and _holds(model.bulk, frame)
    _check_memory(frame, 1 if whole else 2)
    fill, hausdorff = _sampled(model, frame, sampling, _Report(progress, 0.0, 0.5 if own else 1.0))
    bulk = None if whole else _bulk(model, frame, _Report(progress, 0.5, 1.0))
    error = 0.0
    if isinstance(model, HasDoubts):
        error = model.sampling_error(frame) if sampling != "cover" else 0.0
        hausdorff = None if model.is_cut else hausdorff
    return VoxelGrid(frame, adopted(fill), bulk, sampling, hausdorff, error)


class _Report:
    """Turns counts of work into the caller's progress from one share done to another."""

    def __init__(
        self, progress: Callable[[str, float], None] | None, first: float, last: float
    ) -> None:
        self.progress = progress
        self.first, self.last = first, last

    def __call__(self, done: int, count: int) -> None:
        if self.progress is not None:
            share = done / count
            self.progress("voxelize", (1 - share) * self.first + share * self.last)


def _spacing(
    model: Model,
    voxels: int | None,
    spacing: tuple[float, float, float] | None,
    per_feature: float | None,
) -> tuple[float, float, float] | None:
    given = {"voxels": voxels, "spacing": spacing, "per_feature": per_feature}
    names = [name for name, value in given.items() if value is not None]
    if len(names) != 1:
        raise GridError(
            f"voxelize: got {' and '.join(names) or 'no resolution'}; wanted one of voxels (along "
            "the longest edge), spacing and per_feature"
        )
    if per_feature is None:
        return spacing
    if not 0 < per_feature < math.inf:
        raise GridError(f"per_feature: got {per_feature}; wanted a positive number of voxels")
    feature = model.feature_size if isinstance(model, HasFeature) else None
    if feature is None:
        raise GridError(
            "per_feature: this model has no smallest feature (the limit has details of every "
            "size); give voxels, the number along the longest edge"
        )
    h = feature / per_feature
    return h, h, h


def _check_memory(frame: Frame, bytes_each: int) -> None:
    """Raise ``MemoryLimitError`` where a grid of ``frame`` would not fit."""
    tiles = _threads() * math.prod(map(min, TILE, frame.shape)) * MASK_BYTES
    needed = frame.size * bytes_each + tiles
    free = available()
    longest = max(frame.shape)
    fits = int(longest * min(1.0, (max(free - tiles, 0) / (frame.size * bytes_each)) ** (1 / 3)))
    while fits > 1 and _scaled_size(frame, fits) * bytes_each + tiles > free:
        fits -= 1
    check_memory(
        needed,
        f"a grid of {' × '.join(map(str, frame.shape))} voxels",
        f"Choose voxels = {fits} or fewer along the longest edge."
        if fits
        else "Not even one voxel would fit: allow more memory.",
        limit=free,
    )


def _scaled_size(frame: Frame, longest: int) -> int:
    return math.prod(max(1, round(n * longest / max(frame.shape))) for n in frame.shape)


def _threads() -> int:
    from porous.kernels._shared import threads

    return threads()


def _sampled(
    model: Model, frame: Frame, sampling: str, report: _Report
) -> tuple[Bytes, float | None]:
    if sampling == "cover":
        return _covered(model, frame, report)
    pattern = PATTERNS[sampling]
    if isinstance(model, HasFill):
        fill = model.fill(frame, pattern, report)
        if fill is not None:
            return fill, None
    return _counted(model.sample, frame, pattern, report), None


def _covered(model: Model, frame: Frame, report: _Report) -> tuple[Bytes, float]:
    if not isinstance(model, HasCover):
        raise GridError("sampling: this model cannot be covered; wanted fill or centre")
    fill = np.empty(frame.shape, np.uint8)
    bounds = []

    def sample(tile: Frame, out: Bytes) -> None:
        marks, bound = model.cover(tile)
        np.multiply(marks != 0, np.uint8(255), out=out)
        bounds.append(bound)

    _each_tile(frame, fill, sample, report)
    return fill, max(bounds)


def _counted(
    masks: Callable[[Frame, Pattern], NDArray[np.uint64]],
    frame: Frame,
    pattern: Pattern,
    report: _Report,
) -> Bytes:
    """Return how much of each voxel is set in the masks of its tile."""
    table = _fills(pattern)
    result = np.empty(frame.shape, np.uint8)

    def sample(tile: Frame, out: Bytes) -> None:
        out[...] = table[np.bitwise_count(masks(tile, pattern))]

    _each_tile(frame, result, sample, report)
    return result


def _fills(pattern: Pattern) -> Bytes:
    """Return the fill of each number of samples: (255·k + P/2) // P."""
    count = pattern.points
    return np.array([(255 * k + count // 2) // count for k in range(count + 1)], np.uint8)


def _each_tile(
    frame: Frame, out: Bytes, sample: Callable[[Frame, Bytes], None], report: _Report
) -> None:
    """Call ``sample(tile, its part of out)`` for all tiles, on all threads."""
    from porous.kernels._shared import slabs

    tiles = _tiles(frame.shape)

    def work(first: int, last: int) -> None:
        for start, stop in tiles[first:last]:
            part = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
            sample(frame.tile(start, stop), out[part])

    slabs(len(tiles), 1, work, report)


def _tiles(shape: Sequence[int]) -> list[Span]:
    steps = [range(0, n, size) for n, size in zip(shape, TILE, strict=True)]
    return [
        (
            (x, y, z),
            (min(x + TILE[0], shape[0]), min(y + TILE[1], shape[1]), min(z + TILE[2], shape[2])),
        )
        for x, y, z in product(*steps)
    ]


def _holds(bulk: Box, frame: Frame) -> bool:
    return bulk.contains(frame.box, tolerance=1e-9 * max(frame.box.lengths))


def _bulk(model: Model, frame: Frame, report: _Report) -> Bytes | None:
    """Return which part of each voxel is bulk, or None where all is."""
    if not isinstance(model, HasBulk):
        return adopted(_part_in_box(model.bulk, frame))
    # Sampled at the points of a fill: a solid that lies in it then does so voxel by voxel.
    found = _counted(model.sample_bulk, frame, FILL, report)
    return None if found.min() == 255 else adopted(found)


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
