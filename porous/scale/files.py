"""The files of a store, one by one: what each has to hold, and whether it does."""

from __future__ import annotations

import contextlib
import math
import os
import stat
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from porous import disk
from porous.errors import DiskError, FormatError
from porous.scale import codec
from porous.scale.manifest import Manifest
from porous.scale.plan import Plan
from porous.scale.sealed import read_file, seal, unseal

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

PLAN, MANIFEST, GROUP = "plan.json", "manifest.json", "zarr.json"
SMALL = 64 * 1024
"""Bytes that a plan or one of Zarr's own files has at most."""
LINE = 96
"""Bytes that the manifest spends on a file at most."""
RESUME = "`porous resume` mends it"


@dataclass(frozen=True)
class Files:
    """Folder, plan, and, where the store is known to be whole, what every file must be."""

    folder: Path
    plan: Plan
    manifest: Manifest | None = None

    @property
    def folders(self) -> tuple[Path, ...]:
        """Those of the arrays."""
        return tuple(self.folder / name for name in self.plan.arrays)

    def own(self) -> dict[str, bytes]:
        """Return what the files have to hold that are neither chunks nor the manifest."""
        return {PLAN: seal(self.plan.record()), **self.plan.metadata()}

    def holds(self, name: str, text: bytes) -> bool:
        """Return whether a file holds just that."""
        try:
            return read_file(self.folder / name, len(text)) == text
        except FormatError:
            return False

    def lay_out(self) -> None:
        """Make the arrays' folders, write files that are not as they should be, sweep.

        Raises
        ------
        FormatError
            Where an array's folder is a link: what is stored is stored here.
        DiskError
            Where the disk refuses.
        """
        disk.sweep(self.folder)
        for folder in self.folders:
            _check_folder(folder)
            disk.make_folder(folder)
            disk.sweep(folder)
        for name, text in self.own().items():
            if not self.holds(name, text):
                disk.place(self.folder / name, text)
        self.settle()

    def settle(self) -> None:
        """Put the names of all files on the platter."""
        for folder in (*self.folders, self.folder):
            disk.settle(folder)

    def check_own(self) -> None:
        """Raise ``FormatError`` where a file that is no chunk is not as the plan wants it."""
        for folder in self.folders:
            _check_folder(folder)
        for name, text in self.own().items():
            if not self.holds(name, text):
                raise FormatError(f"{self.folder / name}: is damaged or missing; {RESUME}")

    def read_manifest(self) -> Manifest:
        """Return the manifest.

        Raises
        ------
        FormatError
            Where there is none, it is damaged, or not of this plan.
        """
        path = self.folder / MANIFEST
        if not os.path.lexists(path):
            raise FormatError(
                f"{self.folder}: is unfinished: it has a plan but no {MANIFEST}; "
                "`porous resume` goes on with it"
            )
        names = [*self.own(), *self.plan.chunk_names()]
        with naming(path, RESUME):
            record = unseal(read_file(path, SMALL + LINE * len(names)))
            return Manifest.of_record(record, self.plan, names)

    def check_sizes(self, manifest: Manifest) -> None:
        """Raise ``FormatError`` where a chunk is missing or has another size; names the first."""
        there = {
            f"{array}/{file}": size
            for array in self.plan.arrays
            for file, size in _sizes(self.folder / array).items()
        }
        wrong = [
            (name, there.get(name), manifest.files[name][0])
            for name in self.plan.chunk_names()
            if there.get(name) != manifest.files[name][0]
        ]
        if wrong:
            name, found, size = wrong[0]
            got = "is missing" if found is None else f"has {found} bytes; wanted {size}"
            more = f" (and {len(wrong) - 1} more like it)" if len(wrong) > 1 else ""
            raise FormatError(f"{self.folder / name}: {got}{more}; {RESUME}")

    def remove_damage(self) -> Manifest | None:
        """Return the manifest where every byte is as it says; else remove what is not, and it.

        Chunks go first: were the manifest to go before them, a chunk of another place or time,
        which has a right checksum of its own, could outlive it.
        """
        try:
            manifest = self.read_manifest()
        except FormatError:
            disk.remove(self.folder / MANIFEST)
            return None
        whole = Files(self.folder, self.plan, manifest)
        wrong = [name for name in self.plan.chunk_names() if not whole.is_intact(name)]
        if not wrong:
            return manifest
        for name in wrong:
            disk.remove(self.folder / name)
        self.settle()
        disk.remove(self.folder / MANIFEST)
        self.settle()
        return None

    def listed(self) -> Manifest:
        """Return the manifest of what is there, after reading and summing all of it.

        Raises
        ------
        FormatError
            Where a file is damaged or missing; names it.
        """
        self.check_own()
        files = {name: (len(text), codec.crc32c(text)) for name, text in self.own().items()}
        for name in self.plan.chunk_names():
            with naming(self.folder / name, "the store is not whole yet"):
                data, found = self._intact(name)
                files[name] = (len(data), found)
        return Manifest(files, self.plan.recipe_sha256, self.plan.version)

    def is_intact(self, name: str) -> bool:
        """Return whether a chunk is there with the checksum it says, and the manifest's if any."""
        try:
            self._intact(name)
        except FormatError:
            return False
        return True

    def chunk(self, name: str) -> NDArray[np.uint8]:
        """Return the voxels of a chunk, the zeros beyond the frame too.

        Raises
        ------
        FormatError
            Where it is damaged or missing; names it.
        """
        with naming(self.folder / name, RESUME):
            return codec.decode(self._intact(name)[0], self.plan.chunk)

    def _intact(self, name: str) -> tuple[bytes, int]:
        """Return the bytes of a chunk's file and its checksum."""
        size = math.prod(self.plan.chunk)
        data = read_file(self.folder / name, codec.largest(size))
        found = codec.check(data, size)
        if self.manifest is not None and self.manifest.files[name] != (len(data), found):
            raise FormatError("is not the chunk that was committed")
        return data, found


def read_plan(folder: Path) -> Plan:
    """Return the plan of a store.

    Raises
    ------
    FormatError
        Where there is none, or it is damaged.
    """
    path = folder / PLAN
    if not os.path.isdir(folder):  # noqa: PTH112
        raise FormatError(f"{folder}: there is no such folder; wanted a store of porous")
    if not os.path.lexists(path):
        raise FormatError(f"{folder}: has no {PLAN}: it is no store that porous has begun")
    with naming(path, RESUME):
        return Plan.of_record(unseal(read_file(path, SMALL)))


def read_sealed(path: Path) -> dict[str, Any]:
    """Return the content of a small sealed file.

    Raises
    ------
    FormatError
        Where it is missing or damaged; names it.
    """
    with naming(path, "make its folder again, as it was made: what is done is kept"):
        return unseal(read_file(path, SMALL))


def mended_plan(folder: Path) -> Plan:
    """Return the plan; where its file is damaged, the one that the group's ``zarr.json`` repeats.

    Raises
    ------
    FormatError
        Where there is neither.
    """
    try:
        return read_plan(folder)
    except FormatError as error:
        try:
            return Plan.of_metadata(read_file(folder / GROUP, SMALL))
        except FormatError:
            told = str(error).replace(RESUME, f"so is {GROUP}, which repeats it: remove {folder}")
            raise FormatError(told) from None


def check_empty(folder: Path) -> None:
    """Raise ``FormatError`` where a folder holds anything but what killed writers have left."""
    try:
        held = [path.name for path in folder.iterdir()]
    except (FileNotFoundError, NotADirectoryError):
        if os.path.lexists(folder):  # a file, or a link to nowhere
            raise FormatError(f"{folder}: is no folder; wanted an empty or a new one") from None
        return
    except OSError as error:
        raise DiskError(f"{folder}: cannot be listed: {str(error.strerror).lower()}") from None
    if PLAN in held:
        raise FormatError(f"{folder}: holds a store already; resume it, or remove it")
    if foreign := sorted(name for name in held if not name.startswith(disk.TEMPORARY)):
        raise FormatError(f"{folder}: holds {foreign[0]!r}; wanted an empty or a new folder")


@contextlib.contextmanager
def naming(path: Path, remedy: str) -> Iterator[None]:
    """Say of which file a ``FormatError`` speaks, and what to do."""
    try:
        yield
    except FormatError as error:
        raise FormatError(f"{path}: {error}; {remedy}") from None


def _check_folder(folder: Path) -> None:
    try:
        mode = folder.lstat().st_mode
    except FileNotFoundError:
        return
    except OSError as error:
        raise DiskError(f"{folder}: cannot be read: {str(error.strerror).lower()}") from None
    if not stat.S_ISDIR(mode):
        raise FormatError(f"{folder}: is a link or no folder; wanted a folder")


def _sizes(folder: Path) -> dict[str, int]:
    """Return the sizes of the regular files of a folder by name."""
    try:
        with os.scandir(folder) as entries:
            found = {entry.name: entry.stat(follow_symlinks=False) for entry in entries}
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise DiskError(f"{folder}: cannot be read: {str(error.strerror).lower()}") from None
    return {name: info.st_size for name, info in found.items() if stat.S_ISREG(info.st_mode)}
