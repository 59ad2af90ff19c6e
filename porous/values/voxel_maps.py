"""Lengths that vary from voxel to voxel: how wide a pore is, how thick a wall, by name."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from porous.values.frame import Frame


@dataclass(frozen=True, eq=False)
class VoxelMaps(Value):
    """Lengths on the voxels of a frame.

    Parameters
    ----------
    frame
        Where the voxels lie.
    maps
        float32, shape ``frame.shape``, in ``frame.unit``, by name; 0 where there is none.

    Raises
    ------
    GridError
        Where a map has another shape, or there is none.
    """

    frame: Frame
    maps: Mapping[str, NDArray[np.float32]] = field(repr=False)

    def __post_init__(self) -> None:
        kept = {name: frozen(values, np.float32) for name, values in self.maps.items()}
        self._set("maps", MappingProxyType(kept))
        if not kept:
            raise GridError("maps: got none; wanted one at least")
        for name, values in kept.items():
            if values.shape != self.frame.shape:
                raise GridError(
                    f"{name}: got shape {values.shape}; the frame has {self.frame.shape}"
                )
