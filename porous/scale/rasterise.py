"""Every voxel of a body into a store, chunk by chunk, here or wherever ``map`` calls."""

from __future__ import annotations

import builtins
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from porous import disk
from porous.errors import FormatError
from porous.scale.files import read_plan
from porous.scale.store import CHUNK, Store, has_store

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Protocol

    from porous.scale.plan import Triple
    from porous.values import Tiled
    from porous.values.tiled import Map

    Progress = Callable[[int, int], None]

    class Source(Tiled, Protocol):
        """A body whose voxels are still to be worked out."""

        @property
        def has_bulk(self) -> bool:
            """Whether some of the frame is not bulk."""


@dataclass(frozen=True)
class _WriteTile:
    """Works out one chunk and writes it: a task that may be done anywhere, and more than once."""

    store: Store
    source: Source

    def __call__(self, index: int) -> int:
        if read_plan(self.store.folder) != self.store.plan:
            raise FormatError(
                f"{self.store.folder}: holds another store here than where work began"
            )
        start, stop = self.store.plan.tile(self.store.plan.place(index))
        fill, bulk = self.source.block(start, stop)
        if bulk is not None:
            self.store.write("bulk", index, bulk)
        self.store.write("fill", index, fill)
        return index


def fill_store(
    folder: str | Path,
    source: Source,
    *,
    recipe_sha256: str,
    chunk: int | Triple = CHUNK,
    map: Map = builtins.map,  # noqa: A002
    progress: Progress | None = None,
) -> Store:
    """Write all voxels of ``source`` into a store and commit it, going on where it was left.

    Parameters
    ----------
    folder
        A store begun by the same recipe is taken up: what is there and intact stays as it is, and
        the frame and the chunks are what they were. Else it is created. Nobody else may be writing
        to it.
    source
        The body; its blocks must not depend on when or where they are worked out.
    recipe_sha256, chunk
        As in ``Store.create``.
    map
        How a function is called for the number of every tile that is missing; like the builtin. It
        may hand them to other processes that see the same folder.
    progress
        Called as ``progress(done, count)`` with numbers of tiles; raising in it cancels, and what
        is written stays.

    Returns
    -------
    The whole store.

    Raises
    ------
    RecipeError
        Where the folder holds a store of another recipe or frame.
    FormatError
        Where it holds something else, or a store that another version has begun.
    DiskError
        Where the disk refuses; what is written stays.
    """
    store = _begun(Path(folder), source, recipe_sha256, chunk)
    if store.is_whole:
        return store
    missing = sorted({index for _, index in store.missing()})
    count = len(store.tiles)
    _tell(progress, count - len(missing), count)
    for done, _ in enumerate(map(_WriteTile(store, source), missing), 1):
        _tell(progress, count - len(missing) + done, count)
    for name in store.arrays:
        disk.sweep(store.folder / name)  # what workers that died have left
    return store.commit()


def _begun(folder: Path, source: Source, recipe_sha256: str, chunk: int | Triple) -> Store:
    if has_store(folder):
        return Store.resume(folder, recipe_sha256, frame=source.frame)
    return Store.create(
        folder,
        source.frame,
        recipe_sha256=recipe_sha256,
        chunk=chunk,
        sampling=source.sampling,
        has_bulk=source.has_bulk,
        hausdorff=source.hausdorff,
        sampling_error=source.sampling_error,
    )


def _tell(progress: Progress | None, done: int, count: int) -> None:
    if progress is not None:
        progress(done, count)
