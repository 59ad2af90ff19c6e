"""What a cluster's worker does with a task: make sure that it is one of us, unpack, call.

Functions and items travel as pickles of our own making, so that neither the scheduler nor Dask's
reading of arguments needs to understand them.
"""

from __future__ import annotations

import os
import platform
from functools import cache
from importlib import metadata
from typing import TYPE_CHECKING, Any

from porous.errors import FormatError, GuestError
from porous.scale.plan import VERSION
from porous.scale.sealed import read_file

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

DECIDING = ("numpy", "numba", "numcodecs")
"""Packages whose versions may decide over the bytes of a chunk."""


@cache
def versions() -> Mapping[str, str]:
    """Return what has to be the same on all workers, by name."""
    python = ".".join(platform.python_version_tuple()[:2])
    return {"porous": VERSION, "Python": python, **{name: _version(name) for name in DECIDING}}


def call(function: bytes, item: bytes, wanted: Mapping[str, str]) -> Any:
    """Call a function that has come as a pickle, on a worker.

    Where nothing else is said there, kernels use one thread: a worker has as many tasks at a time
    as it has threads.

    Parameters
    ----------
    function, item
        As ``packed`` makes them.
    wanted
        ``versions()`` of who asks.

    Raises
    ------
    GuestError
        Where other versions run here.
    """
    for name, found in versions().items():
        if found != wanted.get(name):
            raise GuestError(
                f"worker {_address()}: runs {name} {found}; wanted {wanted.get(name)}, as here: "
                "other versions may make other bytes"
            )
    os.environ.setdefault("POROUS_THREADS", "1")
    return unpacked(function)(unpacked(item))


def sees(given: tuple[Path, bytes]) -> None:
    """Raise ``GuestError`` where a file does not hold just these bytes, on a worker."""
    path, wanted = given
    try:
        found = read_file(path, len(wanted))
    except FormatError as error:
        raise GuestError(f"worker {_address()}: does not see the store: {path} {error}") from None
    if found != wanted:
        raise GuestError(f"worker {_address()}: sees another store: {path} holds another plan")


def packed(thing: object) -> bytes:
    """Return the pickle of anything, functions of a script too."""
    return bytes(_pickle().dumps(thing))


def packed_size(thing: object) -> int:
    """Return the bytes of its pickle, without copying the arrays in it."""
    arrays: list[Any] = []
    rest = _pickle().dumps(thing, buffer_callback=arrays.append)
    return int(len(rest) + sum(array.raw().nbytes for array in arrays))


def unpacked(data: bytes) -> Any:
    """Return what was packed; each time anew, so that no two tasks share it."""
    return _pickle().loads(data)


def _pickle() -> Any:
    from distributed.protocol import pickle

    return pickle


def _address() -> str:
    import distributed

    worker: Any = distributed.get_worker()
    return str(worker.address)


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "none"
