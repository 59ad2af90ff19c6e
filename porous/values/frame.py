"""Where voxels lie in space."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.values.box import Box
from porous.values.units import check_unit
from porous.values.value import Value, counts, flags, vector

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Frame(Value):
    """A lattice of voxels: voxel i covers ``origin + (start + [i, i + 1]) · spacing``.

    ``start`` is zero but for a tile of a larger frame: a tile keeps the origin of the whole, so
    that a voxel's coordinates are the same floating-point numbers whoever asks for them.

    Parameters
    ----------
    origin
        Outer corner of the whole lattice, in ``unit``.
    spacing
        Edge lengths of one voxel along x, y and z, in ``unit``.
    shape
        Numbers of voxels along x, y and z.
    periodic
        Along which axes the body goes on in copies of itself; else it lies in vacuum.
    unit
        nm, um, mm, cm, m or in.
    start
        Index of the first voxel, for tiles.

    Raises
    ------
    GridError
        For spacing that is not positive and finite, or fewer than one voxel along an axis.
    """

    origin: tuple[float, float, float]
    spacing: tuple[float, float, float]
    shape: tuple[int, int, int]
    periodic: tuple[bool, bool, bool] = (False, False, False)
    unit: str = "mm"
    start: tuple[int, int, int] = (0, 0, 0)

    def __post_init__(self) -> None:
        self._set("origin", vector(self.origin, "frame origin", GridError))
        self._set("spacing", vector(self.spacing, "frame spacing", GridError))
        self._set("shape", counts(self.shape, "frame shape", GridError))
        self._set("start", counts(self.start, "frame start", GridError))
        self._set("periodic", flags(self.periodic, "frame periodic", GridError))
        check_unit(self.unit)
        if min(self.spacing) <= 0:
            raise GridError(f"frame spacing: got {self.spacing}; wanted three positive lengths")
        if min(self.shape) < 1:
            raise GridError(f"frame shape: got {self.shape}; wanted at least one voxel per axis")

    @classmethod
    def fit(
        cls,
        box: Box,
        *,
        voxels: int | None = None,
        spacing: tuple[float, float, float] | None = None,
        cubic: bool = False,
        periodic: tuple[bool, bool, bool] = (False, False, False),
        unit: str = "mm",
    ) -> Frame:
        """Return the frame that fits ``box``: n = round(L / h) voxels, stretched to fit exactly.

        ``voxels`` counts along the longest edge; ``spacing`` gives h per axis. With ``cubic``
        the voxels keep equal edges and the frame is padded at the upper ends instead.
        """
        steps = _steps(box, voxels, spacing)
        if cubic:
            return cls(box.lower, *_padded(box, min(steps), periodic), periodic, unit)
        n = tuple(max(1, round(a / h)) for a, h in zip(box.lengths, steps, strict=True))
        fitted = tuple(a / k for a, k in zip(box.lengths, n, strict=True))
        return cls(box.lower, fitted, n, periodic, unit)  # type: ignore[arg-type]

    @property
    def box(self) -> Box:
        """The box that the voxels cover."""
        lower = [o + a * h for o, a, h in zip(self.origin, self.start, self.spacing, strict=True)]
        upper = [
            o + (a + n) * h
            for o, a, n, h in zip(self.origin, self.start, self.shape, self.spacing, strict=True)
        ]
        return Box(tuple(lower), tuple(upper))  # type: ignore[arg-type]

    @property
    def voxel_volume(self) -> float:
        """Volume of one voxel, in ``unit`` cubed."""
        return self.spacing[0] * self.spacing[1] * self.spacing[2]

    @property
    def size(self) -> int:
        """Number of voxels."""
        return self.shape[0] * self.shape[1] * self.shape[2]

    @property
    def diagonal(self) -> float:
        """Length of a voxel's diagonal, in ``unit``."""
        return math.hypot(*self.spacing)

    def centres(self, axis: int) -> NDArray[np.float64]:
        """Return the voxel centres along ``axis``, in ``unit``."""
        index = self.start[axis] + np.arange(self.shape[axis]) + 0.5
        return np.asarray(self.origin[axis] + index * self.spacing[axis], dtype=np.float64)

    def tile(self, start: tuple[int, int, int], stop: tuple[int, int, int]) -> Frame:
        """Return the part from voxel ``start`` up to ``stop`` (not within), counted here."""
        shape = tuple(b - a for a, b in zip(start, stop, strict=True))
        first = tuple(a + b for a, b in zip(self.start, start, strict=True))
        return replace(self, shape=shape, start=first)  # type: ignore[arg-type]


def _steps(
    box: Box, voxels: int | None, spacing: tuple[float, float, float] | None
) -> tuple[float, float, float]:
    if min(box.lengths) <= 0:
        raise GridError(f"frame: the domain {box.lower} … {box.upper} has no volume")
    if (voxels is None) == (spacing is None):
        raise GridError("frame: give one of voxels (along the longest edge) and spacing")
    if spacing is not None:
        return _checked_spacing(spacing, box)
    assert voxels is not None
    if voxels != int(voxels) or voxels < 1:
        raise GridError(f"voxels: got {voxels}; wanted a whole number, at least 1")
    h = max(box.lengths) / voxels
    return h, h, h


def _checked_spacing(spacing: tuple[float, float, float], box: Box) -> tuple[float, float, float]:
    steps = vector(spacing, "spacing", GridError)
    if min(steps) <= 0:
        raise GridError(f"spacing: got {steps}; wanted three positive lengths")
    if any(math.isinf(a / h) for a, h in zip(box.lengths, steps, strict=True)):
        raise GridError(f"spacing: got {steps}; that is beyond counting in a box of {box.lengths}")
    return steps


def _padded(
    box: Box, h: float, periodic: tuple[bool, bool, bool]
) -> tuple[tuple[float, float, float], tuple[int, int, int]]:
    # The tolerance keeps a length that is a whole number of steps from gaining one by rounding.
    n = [max(1, math.ceil(length / h - 1e-9)) for length in box.lengths]
    for axis, (count, length) in enumerate(zip(n, box.lengths, strict=True)):
        if periodic[axis] and not math.isclose(count * h, length, rel_tol=1e-6):
            raise GridError(
                f"frame: cubic voxels of {h:.6g} do not divide the period {length:.6g} along "
                f"{'xyz'[axis]}; choose voxels or spacing that do, or cubic = false"
            )
    return (h, h, h), (n[0], n[1], n[2])
