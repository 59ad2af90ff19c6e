"""From a model to voxels: a frame that fits its domain, and what is sampled there."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from porous.errors import GridError
from porous.memory import available, check_memory
from porous.models.model import HasFeature, HasLattice
from porous.stages._sampled import MASK_BYTES, TILE, SampledModel
from porous.values import Frame, VoxelGrid

if TYPE_CHECKING:
    from collections.abc import Callable

    from porous.models.model import Model


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
        and ``per_feature``, but for a model that is made of voxels already.
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
    frame = fit_frame(
        model,
        voxels=voxels,
        spacing=spacing,
        per_feature=per_feature,
        periodic=periodic,
        cubic=cubic,
    )
    source = SampledModel(model, frame, sampling)
    check_grid_memory(frame, 2 if source.has_bulk else 1)
    half = 0.5 if source.is_bulk_sampled else 1.0
    start = (0, 0, 0)
    fill = source.fill(start, frame.shape, _Report(progress, 0.0, half))
    bulk = source.bulk(start, frame.shape, _Report(progress, half, 1.0))
    return VoxelGrid(frame, fill, bulk, sampling, source.hausdorff, source.sampling_error)


def fit_frame(
    model: Model,
    *,
    voxels: int | None = None,
    spacing: tuple[float, float, float] | None = None,
    per_feature: float | None = None,
    periodic: tuple[bool, bool, bool] = (False, False, False),
    cubic: bool = False,
) -> Frame:
    """Return the lattice of voxels that fits a model's domain; see ``voxelize``.

    Raises
    ------
    GridError
        For no or several resolutions, or one that the model does not have.
    """
    if isinstance(model, HasLattice) and voxels is None and spacing is None and per_feature is None:
        if cubic:
            raise GridError(
                "cubic: the model's own voxels are as they are; wanted voxels or spacing"
            )
        return model.lattice(periodic)
    steps = _spacing(model, voxels, spacing, per_feature)
    return Frame.fit(
        model.domain,
        voxels=voxels,
        spacing=steps,
        cubic=cubic,
        periodic=periodic,
        unit=model.unit,
    )


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


def check_grid_memory(frame: Frame, bytes_each: int) -> None:
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
        f"Choose voxels = {fits} or fewer along the longest edge, or make it out of core."
        if fits
        else "Not even one voxel would fit: allow more memory.",
        limit=free,
    )


def _scaled_size(frame: Frame, longest: int) -> int:
    return math.prod(max(1, round(n * longest / max(frame.shape))) for n in frame.shape)


def _threads() -> int:
    from porous.kernels._shared import threads

    return threads()
