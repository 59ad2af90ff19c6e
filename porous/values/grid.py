"""A body in voxels."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.values.frame import Frame

    Index = tuple[int, int, int]

SAMPLINGS = ("fill", "centre", "cover")


@dataclass(frozen=True, eq=False)
class VoxelGrid(Value):
    """The solid volume fraction of each voxel of a frame: 0 is void, 255 is solid.

    Parameters
    ----------
    frame
        Where the voxels lie.
    fill
        uint8, shape ``frame.shape``, axes (x, y, z).
    bulk
        uint8 or None: which part of each voxel belongs to the body that porosity refers to,
        where that is not the whole frame.
    sampling
        How ``fill`` was made: fill, centre or cover.
    hausdorff
        A bound on the Hausdorff distance between the solid voxels and the set, in ``frame.unit``;
        None where there is none, as where the frame cuts the set.
    sampling_error
        How far the boundary of what was sampled may lie from that of the set, in ``frame.unit``.

    Raises
    ------
    GridError
        Where shapes disagree or the sampling is not known.
    """

    frame: Frame
    fill: NDArray[np.uint8] = field(repr=False)
    bulk: NDArray[np.uint8] | None = field(default=None, repr=False)
    sampling: str = "fill"
    hausdorff: float | None = None
    sampling_error: float = 0.0

    def __post_init__(self) -> None:
        self._set("fill", _bytes(self.fill, "fill", self.frame))
        if self.bulk is not None:
            self._set("bulk", _bytes(self.bulk, "bulk", self.frame))
        if self.sampling not in SAMPLINGS:
            raise GridError(f"sampling: got {self.sampling!r}; wanted one of {SAMPLINGS}")
        if self.hausdorff is not None and not self.hausdorff >= 0:
            raise GridError(f"hausdorff: got {self.hausdorff}; wanted a distance or None")
        if not 0 <= self.sampling_error < np.inf:
            raise GridError(f"sampling_error: got {self.sampling_error}; wanted a distance")

    @classmethod
    def of_solid(
        cls, solid: NDArray[np.bool_], frame: Frame, *, sampling: str = "centre"
    ) -> VoxelGrid:
        """Return the binary grid whose solid voxels are True in ``solid``."""
        return cls(frame, np.where(solid, np.uint8(255), np.uint8(0)), sampling=sampling)

    @property
    def solid(self) -> NDArray[np.bool_]:
        """The boolean view: True where at least half of the voxel is solid (fill ≥ 128)."""
        result: NDArray[np.bool_] = self.fill >= 128
        return result

    def block(
        self, start: Index, stop: Index
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
        """Return views of fill and bulk of the voxels ``start`` … ``stop``, as ``Tiled`` asks.

        Raises
        ------
        GridError
            For a box that is empty or not inside the frame.
        """
        if not all(0 <= a < b <= n for a, b, n in zip(start, stop, self.frame.shape, strict=True)):
            raise GridError(
                f"block: got voxels {start} … {stop}; wanted a box inside (0, 0, 0) … "
                f"{self.frame.shape}"
            )
        box = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
        return self.fill[box], None if self.bulk is None else self.bulk[box]


def _bytes(array: object, what: str, frame: Frame) -> NDArray[np.uint8]:
    given = np.asarray(array)
    if given.dtype != np.uint8:
        raise GridError(f"{what}: got {given.dtype}; wanted uint8, 0 = void and 255 = solid")
    if given.shape != frame.shape:
        raise GridError(f"{what}: got shape {given.shape}; the frame has {frame.shape}")
    return frozen(given, np.uint8)
