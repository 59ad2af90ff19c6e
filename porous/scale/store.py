"""Voxels on disk, chunk by chunk: a Zarr group that is whole when its manifest says so.

::

    grid.zarr/
    ├── plan.json          first: recipe hash, version, frame, chunk, sampling
    ├── zarr.json          the group; fill/zarr.json, bulk/zarr.json: the arrays
    ├── fill/c.0.0.0 …     one file per chunk: zstd level 1, then CRC32C
    ├── bulk/c.0.0.0 …     where there is a bulk
    └── manifest.json      last: names, sizes and CRC32C of all files above

Zarr by itself takes a chunk that was never written for void and notices no flipped bit
in what it is not told to sum. So every chunk is written and summed, and nothing is read as a whole
store that has no manifest. Each file appears complete or not at all, and may be written by any
thread or process; a store that was interrupted is resumed chunk by chunk.

The same voxels give the same bytes with the same numcodecs; another release of zstd may compress
otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from porous import disk
from porous.errors import DiskError, FormatError, RecipeError
from porous.scale import codec
from porous.scale.files import MANIFEST, PLAN, Files, check_empty, mended_plan, read_plan
from porous.scale.plan import VERSION, Plan
from porous.scale.sealed import seal
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.scale.manifest import Manifest
    from porous.scale.plan import Triple
    from porous.values import Frame

CHUNK = 256
"""Voxels along an edge of a chunk where nothing else is asked for: 16 MiB."""


@dataclass(frozen=True, eq=False)
class Store(Value):
    """A folder of chunks; made by ``create``, ``resume`` or ``open``, never by hand.

    Parameters
    ----------
    folder
        Where it is.
    plan
        What it holds or is going to hold.
    manifest
        What it was found to consist of when it was whole; None while it is being written.
    """

    folder: Path
    plan: Plan
    manifest: Manifest | None = None

    @classmethod
    def create(
        cls,
        folder: str | Path,
        frame: Frame,
        *,
        recipe_sha256: str,
        chunk: int | Triple = CHUNK,
        sampling: str = "fill",
        has_bulk: bool = False,
        hausdorff: float | None = None,
        sampling_error: float = 0.0,
    ) -> Store:
        """Begin a store: the plan first, then what Zarr needs.

        Parameters
        ----------
        folder
            Created where it is missing; anything but an empty folder is refused.
        frame
            Where the voxels lie.
        recipe_sha256
            Names the recipe; a store is resumed by no other.
        chunk
            Voxels of a chunk, along each axis or one number for all; cut to the frame's.
        sampling, hausdorff, sampling_error
            As in ``VoxelGrid``.
        has_bulk
            Whether there will be a second array, ``bulk``.

        Raises
        ------
        FormatError
            Where the folder holds something already.
        GridError
            For chunks or values that no grid could have.
        DiskError
            Where the disk refuses; what was begun is taken up by ``resume``, or by ``create``
            where not even the plan could be written.
        """
        edges = (chunk, chunk, chunk) if isinstance(chunk, int) else chunk
        plan = Plan(frame, edges, sampling, has_bulk, recipe_sha256, hausdorff, sampling_error)
        place = Path(folder)
        check_empty(place)
        disk.make_folder(place)
        disk.sweep(place)
        disk.write_bytes(place / PLAN, seal(plan.record()))
        disk.settle(place.parent)
        Files(place, plan).lay_out()
        return cls(place, plan)

    @classmethod
    def resume(cls, folder: str | Path, recipe_sha256: str, *, frame: Frame | None = None) -> Store:
        """Take up a store where it was left: whole, interrupted or damaged.

        Leftovers of killed writers are removed and Zarr's own files written anew where they are
        not as they should be. Where one byte of a committed store is not as it was, the chunks
        that differ and then the manifest are removed: from there on it is unfinished. What is
        still to be written ``missing`` tells. Nobody else may be writing to the folder.

        Raises
        ------
        FormatError
            Where the folder is no store of porous, or was begun by another version of it.
        RecipeError
            Where it is of another recipe or frame.
        DiskError
            Where the disk refuses.
        """
        place = Path(folder)
        plan = mended_plan(place)
        _check_plan(place, plan, recipe_sha256, frame)
        files = Files(place, plan)
        files.lay_out()
        return cls(place, plan, files.remove_damage())

    @classmethod
    def open(cls, folder: str | Path) -> Store:
        """Open a whole store for reading.

        The plan, Zarr's own files and the manifest are checked byte by byte, the chunks for being
        there in their size; what is in them is checked when it is read.

        Raises
        ------
        FormatError
            Where it is no store of porous, unfinished, damaged or incomplete; names the file.
        """
        place = Path(folder)
        plan = read_plan(place)
        files = Files(place, plan)
        files.check_own()
        manifest = files.read_manifest()
        files.check_sizes(manifest)
        return cls(place, plan, manifest)

    def __reduce__(self) -> tuple[Any, ...]:
        # A manifest of many chunks is read where it is needed, not sent along.
        if self.manifest is not None:
            return Store.open, (self.folder,)
        return Store, (self.folder, self.plan)

    @property
    def frame(self) -> Frame:
        """Where the voxels lie."""
        return self.plan.frame

    @property
    def chunk(self) -> Triple:
        """Voxels of a chunk along x, y and z."""
        return self.plan.chunk

    @property
    def sampling(self) -> str:
        """How the voxels were made: fill, centre or cover."""
        return self.plan.sampling

    @property
    def sampling_error(self) -> float:
        """As in ``VoxelGrid``, in ``frame.unit``."""
        return self.plan.sampling_error

    @property
    def hausdorff(self) -> float | None:
        """As in ``VoxelGrid``, in ``frame.unit``."""
        return self.plan.hausdorff

    @property
    def has_bulk(self) -> bool:
        """Whether there is a second array, ``bulk``."""
        return self.plan.has_bulk

    @property
    def arrays(self) -> tuple[str, ...]:
        """Names of the arrays."""
        return self.plan.arrays

    @property
    def tiles(self) -> tuple[tuple[Triple, Triple], ...]:
        """First voxel and end (not within) of every chunk, in C order."""
        return self.plan.tiles

    @property
    def is_whole(self) -> bool:
        """Whether the store was committed when it was opened, resumed or committed."""
        return self.manifest is not None

    def write(self, name: str, index: int, array: NDArray[np.uint8]) -> None:
        """Write a chunk, whole or not at all; different chunks may be written at the same time.

        Parameters
        ----------
        name
            Of the array: fill or bulk.
        index
            Number of the tile, counted as in ``tiles``.
        array
            uint8, of the tile's shape.

        Raises
        ------
        DiskError
            Where the disk refuses; what was there before is untouched.
        """
        if self.is_whole:
            raise ValueError(f"{self.folder}: is whole; nothing can be written to it")
        place = self._place(name, index)
        start, stop = self.plan.tile(place)
        wanted = tuple(b - a for a, b in zip(start, stop, strict=True))
        if array.dtype != np.uint8 or array.shape != wanted:
            raise ValueError(f"got {array.dtype} of shape {array.shape}; wanted uint8, {wanted}")
        path = self.folder / self.plan.chunk_name(name, place)
        disk.place(path, codec.encode(array, self.chunk))

    def has(self, name: str, index: int) -> bool:
        """Return whether a chunk is there and intact; in a whole store, the one committed.

        Its checksum is computed and its header read; it is not decompressed.
        """
        return self._files.is_intact(self.plan.chunk_name(name, self._place(name, index)))

    def missing(self) -> tuple[tuple[str, int], ...]:
        """Return array and number of every chunk that is not there or not intact."""
        return tuple(
            (name, index)
            for name in self.arrays
            for index in range(len(self.tiles))
            if not self.has(name, index)
        )

    def read(self, name: str, start: Triple, stop: Triple) -> NDArray[np.uint8]:
        """Return any box of voxels, C-contiguous; every chunk that it meets is verified.

        Raises
        ------
        FormatError
            Where one is damaged or missing; names it.
        """
        return self.gather(name, start, stop, self._files.chunk)

    def chunk_of(self, file: str) -> NDArray[np.uint8]:
        """Return a whole chunk by the name of its file, the zeros beyond the frame too.

        Raises
        ------
        FormatError
            Where it is damaged or missing; names it.
        """
        return self._files.chunk(file)

    def gather(
        self, name: str, start: Triple, stop: Triple, chunk: Callable[[str], NDArray[np.uint8]]
    ) -> NDArray[np.uint8]:
        """Return what ``read`` returns, of chunks that ``chunk`` gives by the names of files."""
        self._check_name(name)
        self._check_box(start, stop)
        shape = tuple(b - a for a, b in zip(start, stop, strict=True))
        result = np.empty(shape, np.uint8)
        for place in self.plan.places(start, stop):
            first, end = self.plan.tile(place)
            low = [max(a, s) for a, s in zip(first, start, strict=True)]
            high = [min(b, e) for b, e in zip(end, stop, strict=True)]
            block = chunk(self.plan.chunk_name(name, place))
            result[_box(low, high, start)] = block[_box(low, high, first)]
        return result

    def commit(self) -> Store:
        """Declare the store whole and return it so.

        Every file is read once more and summed, everything is put on the platter, and the manifest
        comes last.

        Raises
        ------
        FormatError
            Where a chunk is damaged or missing; names it.
        DiskError
            Where the disk refuses; the store can be resumed.
        """
        manifest = self._files.listed()
        self._files.settle()
        disk.write_bytes(self.folder / MANIFEST, seal(manifest.record()))
        return replace(self, manifest=manifest)

    def verify(self) -> tuple[str, ...]:
        """Read and decompress everything; return the names of files that are damaged or missing."""
        files = self._files
        found = [name for name, text in files.own().items() if not files.holds(name, text)]
        for name in self.plan.chunk_names():
            try:
                files.chunk(name)
            except FormatError:
                found.append(name)
        return tuple(found)

    @property
    def _files(self) -> Files:
        return Files(self.folder, self.plan, self.manifest)

    def _place(self, name: str, index: int) -> Triple:
        self._check_name(name)
        return self.plan.place(index)

    def _check_name(self, name: str) -> None:
        if name not in self.arrays:
            raise ValueError(f"array: got {name!r}; wanted one of {self.arrays}")

    def _check_box(self, start: Triple, stop: Triple) -> None:
        edges = zip(start, stop, self.frame.shape, strict=True)
        if not all(0 <= a <= b <= n for a, b, n in edges):
            raise ValueError(f"box: got {start} … {stop}; the frame has {self.frame.shape}")


def check_same(folder: Path, begun: str, recipe_sha256: str) -> None:
    """Raise ``RecipeError`` where the recipe that a folder was begun by is another."""
    if begun != recipe_sha256:
        raise RecipeError(
            f"{folder}: belongs to another recipe: it has {begun[:12]}…, "
            f"this one is {recipe_sha256[:12]}…; choose another folder, or remove it"
        )


def check_store(folder: Path, recipe_sha256: str) -> None:
    """Raise where a recipe can neither go on with what a folder holds nor begin a store there.

    Raises
    ------
    RecipeError
        Where it holds a store of another recipe.
    FormatError
        Where it holds something else, or a store that another version of porous has begun.
    DiskError
        Where the disk refuses.
    """
    if has_store(folder):
        _check_plan(folder, mended_plan(folder), recipe_sha256, None)
    else:
        check_empty(folder)


def has_store(folder: Path) -> bool:
    """Return whether a store has been begun in a folder, whatever became of it."""
    try:
        return any((folder / name).exists() for name in (PLAN, MANIFEST))
    except OSError as error:
        raise DiskError(f"{folder}: cannot be read: {str(error.strerror).lower()}") from None


def _check_plan(folder: Path, plan: Plan, recipe_sha256: str, frame: Frame | None) -> None:
    check_same(folder, plan.recipe_sha256, recipe_sha256)
    if frame is not None and frame != plan.frame:
        raise RecipeError(
            f"{folder}: has the frame {plan.frame}; wanted {frame}; choose another folder"
        )
    if plan.version != VERSION:
        raise FormatError(
            f"{folder}: was begun by porous {plan.version}; this is {VERSION}, which may make "
            "other voxels: go on with that one, or remove the folder"
        )


def _box(low: list[int], high: list[int], start: Triple) -> tuple[slice, ...]:
    return tuple(slice(a - s, b - s) for a, b, s in zip(low, high, start, strict=True))
