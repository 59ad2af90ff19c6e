"""A whole store as a grid that stays on disk."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from porous.memory import check_memory
from porous.scale.recent import Recent
from porous.scale.store import Store
from porous.values import VoxelGrid
from porous.values.value import Value

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from porous.scale.plan import Triple
    from porous.values import Frame

KEPT = 1 << 28
"""Bytes of chunks that a grid remembers, so that what surrounds a tile is not read eight times."""


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
        """Open a whole store, or that in a folder which was made out of core.

        Raises
        ------
        FormatError
            As ``Store.open``.
        """
        place = Path(folder)
        inner = place / "grid.zarr"  # as `porous make --out-of-core` calls it
        return cls(Store.open(inner if inner.is_dir() else place))

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
        return self._box("fill", start, stop), self._bulk(start, stop)

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
        read, all_ = self.store.read, ((0, 0, 0), self.frame.shape)
        bulk = read("bulk", *all_) if self.store.has_bulk else None
        fill = read("fill", *all_)
        return VoxelGrid(self.frame, fill, bulk, self.sampling, self.hausdorff, self.sampling_error)

    def _bulk(self, start: Triple, stop: Triple) -> NDArray[np.uint8] | None:
        return self._box("bulk", start, stop) if self.store.has_bulk else None

    def _box(self, name: str, start: Triple, stop: Triple) -> NDArray[np.uint8]:
        keep = self._recent
        return self.store.gather(
            name, start, stop, lambda file: keep.get(file, self.store.chunk_of)
        )

    @cached_property
    def _recent(self) -> Recent:
        return Recent(KEPT)
