"""Counts of some tiles in a file, so that who is killed counts on where he stopped.

A file is a sealed header, the length of which its first line says, and arrays as zstd made them,
each with its CRC32C in the header. It names classes of counts, never code, and is of use only to
who counts the same things of the same tiles of the same voxels.
"""

from __future__ import annotations

import hashlib
import math
import time
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from porous import disk
from porous.errors import FormatError
from porous.measures import COUNTED
from porous.memory import available
from porous.scale import codec
from porous.scale.sealed import read_file, seal, unseal

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    Sums = list[tuple[int, Any]]

EVERY = 20.0
"""Seconds between two times that counts are written down."""
MOST = 1 << 36
"""Bytes of such a file at most."""
DIGITS = 20
"""Of the header's length, in the first line."""
CLASSES = {kind.__name__: kind for kind in COUNTED}


class Tally:
    """The counts of a grid (``fold``'s ``journal``), a file for each pass over its tiles.

    Parameters
    ----------
    folder
        Of the files, ``counts-….tally``; it is there already.
    about
        Names the voxels that are counted.
    every
        Seconds between two times that a file is written.
    """

    def __init__(self, folder: str | Path, about: str, *, every: float = EVERY) -> None:
        self.folder, self.about, self.every = Path(folder), about, every
        self._last = time.monotonic()

    def load(self, key: str) -> tuple[int, Sums]:
        """Return how many tiles were counted, and their sums; none where the file is of no use."""
        name = self._name(key)
        try:
            return _told(read_file(self._file(name), MOST), name)
        except FormatError:
            return 0, []

    def save(self, key: str, done: int, sums: Sums) -> None:
        """Write down the sums of the first ``done`` tiles, if that is due.

        Raises
        ------
        DiskError
            Where the disk refuses; what was written before stays.
        """
        if time.monotonic() - self._last < self.every:
            return
        name = self._name(key)
        disk.write_bytes(self._file(name), _written(name, done, sums))
        self._last = time.monotonic()

    def clear(self) -> None:
        """Remove the files: what they are for has been done.

        Raises
        ------
        DiskError
            Where the disk refuses.
        """
        disk.sweep(self.folder, "counts-*.tally")

    def _file(self, name: str) -> Path:
        return self.folder / f"counts-{name[:12]}.tally"

    def _name(self, key: str) -> str:
        return hashlib.sha256(f"{self.about}\n{key}".encode()).hexdigest()


def _written(name: str, done: int, sums: Sums) -> Iterator[bytes]:
    arrays: list[NDArray[Any]] = []
    tree = [[rank, _tree(total, arrays)] for rank, total in sums]
    bodies = [codec.compressed(array) for array in arrays]
    told = [
        [array.dtype.str, list(array.shape), len(body), codec.crc32c(body)]
        for array, body in zip(arrays, bodies, strict=True)
    ]
    header = seal({"of": name, "done": done, "sums": tree, "arrays": told})
    yield f"{len(header):{DIGITS}d}\n".encode()
    yield header
    yield from bodies


def _tree(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """Return the shape of a count as lists; its arrays are put aside."""
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return ["array", len(arrays) - 1]
    if isinstance(value, tuple):
        return ["tuple", [_tree(part, arrays) for part in value]]
    if is_dataclass(value):
        parts = [_tree(getattr(value, field.name), arrays) for field in fields(value)]
        return [type(value).__name__, parts]
    return ["number", value]


def _told(data: bytes, name: str) -> tuple[int, Sums]:
    """Return what ``_written`` has written.

    Raises
    ------
    FormatError
        Where it is damaged, or of something else.
    """
    try:
        start = DIGITS + 1
        stop = start + int(data[:DIGITS])
        header = unseal(data[start:stop])
        if header["of"] != name:
            raise FormatError("is of other counts")
        arrays = list(_arrays(header["arrays"], data, stop))
        sums = [(int(rank), _value(tree, arrays)) for rank, tree in header["sums"]]
        return int(header["done"]), sums
    except (KeyError, TypeError, ValueError, IndexError, RecursionError) as error:
        raise FormatError(f"tells of no counts: {error}") from None


def _arrays(told: Sequence[Any], data: bytes, start: int) -> Iterator[NDArray[Any]]:
    room = available()
    for kind, shape, length, crc in told:
        body = data[start : start + length]
        start += length
        dtype, size = np.dtype(kind), math.prod(shape)
        room -= size * dtype.itemsize
        if dtype.hasobject or size < 0 or room < 0 or codec.crc32c(body) != crc:
            raise FormatError("is damaged")
        yield codec.expanded(body, dtype, tuple(shape))


def _value(tree: Any, arrays: Sequence[NDArray[Any]]) -> Any:
    kind, content = tree
    if kind == "array":
        return arrays[content]
    if kind == "number":
        return content
    parts = tuple(_value(part, arrays) for part in content)
    return parts if kind == "tuple" else CLASSES[kind](*parts)
