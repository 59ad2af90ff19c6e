"""A whole store as a grid that stays on disk."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from porous.memory import check_memory
from porous.scale.store import Store
from porous.values import VoxelGrid
from porous.values.value import Value

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from porous.scale.plan import Triple
    from porous.values import Frame


@dataclass(frozen=True, eq=False)
class StoredGrid(Value):
    """The voxels of a whole store, read box by box; what is pickled is where they are.

    Parameters
    ----------
    store
        As ``Store.open`` returns it.
    """

    store: Store

    @classmethod
    def open(cls, folder: str | Path) -> StoredGrid:
        """Open a whole store.

        Raises
        ------
        FormatError
            As ``Store.open``.
        """
        return cls(Store.open(folder))

    @property
    def frame(self) -> Frame:
        """Where the voxels lie."""
        return self.store.frame

    @property
    def sampling(self) -> str:
        """How the voxels were made: fill, centre or cover."""
        return self.store.sampling

    @property
    def sampling_error(self) -> float:
        """As in ``VoxelGrid``, in ``frame.unit``."""
        return self.store.sampling_error

    @property
    def hausdorff(self) -> float | None:
        """As in ``VoxelGrid``, in ``frame.unit``."""
        return self.store.hausdorff

    @property
    def tiles(self) -> tuple[tuple[Triple, Triple], ...]:
        """First voxel and end (not within) of the boxes that are read fastest, in C order."""
        return self.store.tiles

    def block(
        self, start: Triple, stop: Triple
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
        """Return fill and bulk of a box inside the frame, from voxel ``start`` up to ``stop``.

        Raises
        ------
        FormatError
            Where a chunk is damaged or missing; names it.
        """
        read = self.store.read
        return read("fill", start, stop), self._bulk(start, stop)

    def to_grid(self) -> VoxelGrid:
        """Return all of it in memory.

        Raises
        ------
        MemoryLimitError
            Where there is not enough.
        FormatError
            Where a chunk is damaged or missing; names it.
        """
        arrays = len(self.store.arrays)
        check_memory(arrays * self.frame.size, "the stored grid", "Measure it where it is.")
        fill, bulk = self.block((0, 0, 0), self.frame.shape)
        return VoxelGrid(self.frame, fill, bulk, self.sampling, self.hausdorff, self.sampling_error)

    def _bulk(self, start: Triple, stop: Triple) -> NDArray[np.uint8] | None:
        return self.store.read("bulk", start, stop) if self.store.has_bulk else None
