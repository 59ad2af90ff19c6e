"""A body in voxels that is seen a box at a time: in memory, in a store, on another machine."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from porous.values.frame import Frame

    Index = tuple[int, int, int]

Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]
"""How a function is called for every tile: like the builtin, that is in order."""


@runtime_checkable
class Tiled(Protocol):
    """What measures and surfaces ask of a body in voxels; a ``VoxelGrid`` is one.

    Its fields mean what those of a ``VoxelGrid`` do. Work on it in tiles looks at one tile and a
    few layers about it at a time, so that it need never lie in memory as a whole.
    """

    @property
    def frame(self) -> Frame:
        """Where the voxels lie."""
        ...

    @property
    def sampling(self) -> str:
        """How the fills were made: fill, centre or cover."""
        ...

    @property
    def sampling_error(self) -> float:
        """How far the boundary of what was sampled may lie from the set's, in ``frame.unit``."""
        ...

    @property
    def hausdorff(self) -> float | None:
        """A bound on the distance between the solid voxels and the set, in ``frame.unit``."""
        ...

    def block(
        self, start: Index, stop: Index
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
        """Return fill and bulk of the voxels ``start`` … ``stop`` (not within).

        Parameters
        ----------
        start, stop
            First voxel, and the one after the last, per axis; counted from the frame's first
            voxel, inside the frame.

        Returns
        -------
        fill
            uint8, shape ``stop − start``; not to be written to.
        bulk
            The same, or None where all of the frame is bulk, and then so for every box.
        """
        ...


@runtime_checkable
class Chunked(Tiled, Protocol):
    """A body in voxels that comes in boxes of its own, read faster than others."""

    @property
    def tiles(self) -> tuple[tuple[Index, Index], ...]:
        """Those boxes, as first voxel and end (not within); they fill the frame."""
        ...
