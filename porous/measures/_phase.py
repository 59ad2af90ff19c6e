"""What is measured of a grid: its pores or its solid, and what lies beyond the grid's sides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError, nearest
from porous.memory import check_memory

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.values import Frame
    from porous.values.tiled import Tiled

    Bools = NDArray[np.bool_]
    Axes = tuple[bool, bool, bool]

PREFIX = {"pore": "pore", "solid": "wall"}
"""What names of measures begin with, by phase: balls in solid measure walls."""

BEYOND = ("void", "unknown")


@dataclass(frozen=True)
class Voxels:
    """The voxels of a phase, and those of them that count; masks of the grid's shape.

    Pores that lie beyond the bulk do not count (``counted``), but nothing ends in them: ``bulk``
    is None where all of the frame is bulk. ``walled`` tells whether the phase ends where the frame
    does, along axes that are not periodic.
    """

    frame: Frame
    mask: Bools
    bulk: Bools | None
    walled: bool

    @property
    def counted(self) -> Bools:
        """Voxels of the phase that count."""
        return self.mask if self.bulk is None else self.mask & self.bulk

    @property
    def bulk_count(self) -> int:
        """How many voxels the bulk has."""
        return self.frame.size if self.bulk is None else int(np.count_nonzero(self.bulk))


def voxels_of(grid: Tiled, phase: str, beyond: str, what: str, each: float) -> Voxels:
    """Return the voxels of a phase, once it is known that there is room to work on them.

    Parameters
    ----------
    grid
        The body.
    phase
        pore (fill below 128) or solid.
    beyond
        What lies beyond sides that are not periodic: void, or what nobody knows.
    what
        Whose work it is, for messages.
    each
        Bytes that the work takes per voxel.

    Raises
    ------
    GridError
        For an unknown phase or beyond, and where the phase has no voxel that counts.
    MemoryLimitError
        Where there is not so much memory.
    """
    if phase not in PREFIX:
        raise GridError(f"phase: got {phase!r}{nearest(phase, PREFIX)}")
    if beyond not in BEYOND:
        raise GridError(f"beyond: got {beyond!r}{nearest(beyond, BEYOND)}")
    frame = grid.frame
    size = " × ".join(map(str, frame.shape))
    check_memory(frame.size * each, f"{what} of {size} voxels", "Use fewer voxels, or a part.")
    fill, body = grid.block((0, 0, 0), frame.shape)
    mask = fill >= 128 if phase == "solid" else fill < 128
    bulk = None if body is None or phase == "solid" else body >= 128
    voxels = Voxels(frame, mask, bulk, walled=phase == "solid" and beyond == "void")
    if not voxels.counted.any():
        raise GridError(f"{what}: the grid has no {phase} voxel; wanted a body with some")
    return voxels
