"""A picture in space: numbers on a lattice, before anybody has said which of them are solid."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.errors import GridError
from porous.values.units import check_unit
from porous.values.value import Value, vector

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Image(Value):
    """Grey values of the voxels of a box, as a scanner or another program gives them.

    Parameters
    ----------
    values
        Truth values, whole numbers or floats, axes (x, y, z); a view that nobody writes to is kept
        as it is, in whatever order it lies in memory.
    spacing
        Edge lengths of one voxel along x, y and z, in ``unit``.
    origin
        Outer corner of the first voxel, in ``unit``.
    unit
        nm, um, mm, cm, m or in.

    Raises
    ------
    GridError
        For values that are no numbers on three axes, or spacing that is not positive and finite.
    """

    values: NDArray[Any] = field(repr=False)
    spacing: tuple[float, float, float]
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unit: str = "mm"

    def __post_init__(self) -> None:
        values = np.asarray(self.values).view()
        if values.ndim != 3 or values.dtype.kind not in "biuf" or not values.size:
            got = f"{values.dtype} of shape {values.shape}"
            raise GridError(f"image: got {got}; wanted numbers on three axes")
        values.flags.writeable = False
        self._set("values", values)
        self._set("spacing", vector(self.spacing, "image spacing", GridError))
        self._set("origin", vector(self.origin, "image origin", GridError))
        check_unit(self.unit)
        if min(self.spacing) <= 0:
            raise GridError(f"image spacing: got {self.spacing}; wanted three positive lengths")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of voxels along x, y and z."""
        x, y, z = self.values.shape
        return x, y, z
