"""HDF5 files that are made in memory, the same bytes for the same content.

h5py is an optional dependency: it is imported here, when something is written.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

PACK = 1 << 16
"""Arrays of more bytes are packed."""


class Branch:
    """A group of a file that is being made."""

    def __init__(self, group: Any, *, packed: bool) -> None:
        self.group, self.packed = group, packed

    def branch(self, path: str, **marks: str | float) -> Branch:
        """Return a new group inside, with attributes: texts, whole numbers, others."""
        inner = Branch(self.group.create_group(path, track_order=True), packed=self.packed)
        inner.mark(**marks)
        return inner

    def put(self, name: str, array: NDArray[Any], **marks: str | float) -> None:
        """Keep an array, with attributes."""
        big = self.packed and array.nbytes > PACK
        form = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if big else {}
        data = self.group.create_dataset(name, data=array, track_times=False, **form)
        Branch(data, packed=False).mark(**marks)

    def put_rows(self, name: str, table: NDArray[Any]) -> None:
        """Keep a table as a line of rows: each is one thing of an array type."""
        kind = np.dtype((table.dtype, table.shape[1:]))
        data = self.group.create_dataset(name, table.shape[:1], kind, track_times=False)
        data[...] = table

    def mark(self, **marks: str | float) -> None:
        """Set attributes; texts as ASCII of their own length, whole numbers in 64 bits."""
        for name, value in marks.items():
            if isinstance(value, str):
                self.group.attrs[name] = np.bytes_(value.encode("ascii"))
            else:
                self.group.attrs[name] = np.array(value)


def hdf5(fill: Callable[[Branch], None], *, packed: bool = False) -> Iterator[bytes]:
    """Give the bytes of a file.

    Parameters
    ----------
    fill
        Is given the root.
    packed
        Whether large arrays are compressed.
    """
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w", libver=("earliest", "v108")) as file:
        fill(Branch(file, packed=packed))
    yield stream.getvalue()
