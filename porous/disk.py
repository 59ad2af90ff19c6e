"""The only file that writes where the user looks: each file appears complete or not at all."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from porous.errors import DiskError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator


def write_bytes(path: str | Path, chunks: bytes | Iterable[bytes]) -> None:
    """Write a file whole: to a temporary beside it, to the platter, then into place.

    Parameters
    ----------
    path
        Where the file is to be; a file of that name is replaced.
    chunks
        Its bytes, at once or in pieces.

    Raises
    ------
    DiskError
        Where the disk refuses; what was there before is untouched and nothing is left behind.
    """
    pieces = [chunks] if isinstance(chunks, bytes) else chunks
    target = Path(path)

    def fill(temporary: Path) -> None:
        with temporary.open("wb") as stream:
            for piece in pieces:
                stream.write(piece)
            stream.flush()
            os.fsync(stream.fileno())

    _put(target, fill)


def make_folder(path: str | Path) -> Path:
    """Create a folder and its parents where they are missing; return its path."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise DiskError(f"{folder}: cannot be written to: {_reason(error)}") from None
    return folder


def remove(path: str | Path) -> None:
    """Remove a file if it is there."""
    try:
        Path(path).unlink(missing_ok=True)
    except OSError as error:
        raise DiskError(f"{path}: cannot be removed: {_reason(error)}") from None


@contextlib.contextmanager
def staging(path: str | Path) -> Iterator[Path]:
    """Give a hidden folder inside ``path`` to fill; on leaving it is gone, whatever happened.

    ``path`` is created where it is missing, and removed again where the work fails, so that
    nothing is left behind. ``commit`` moves what was staged into place.

    Raises
    ------
    DiskError
        At once where nothing can be written there.
    """
    folder = Path(path)
    fresh = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    stage = folder
    try:
        make_folder(folder)
        with _refusals(folder):
            stage = Path(tempfile.mkdtemp(prefix=".porous-", dir=folder))
        yield stage
        shutil.rmtree(stage, ignore_errors=True)
    except BaseException as error:
        if stage is not folder:
            shutil.rmtree(stage, ignore_errors=True)
        for parent in fresh:
            with contextlib.suppress(OSError):
                parent.rmdir()
        if isinstance(error, DiskError):
            raise DiskError(str(error).replace(str(stage), str(folder))) from None
        raise


def commit(stage: Path, folder: str | Path, *, last: str, stale: Iterable[str] = ()) -> None:
    """Move the files of ``stage`` into ``folder``, and ``last`` after all the others.

    The old ``last`` goes first, then the ``stale`` files: a folder that has it is whole.
    """
    target = Path(folder)
    for name in (last, *stale):
        remove(target / name)
    with _refusals(target):
        for file in sorted(stage.iterdir()):
            if file.name != last:
                file.replace(target / file.name)
        _sync_folder(target)
        (stage / last).replace(target / last)
        _sync_folder(target)


@contextlib.contextmanager
def _refusals(target: Path) -> Iterator[None]:
    """Turn what the disk refuses into ``DiskError``."""
    try:
        yield
    except OSError as error:
        raise DiskError(f"{target}: cannot be written: {_reason(error)}") from None


def _put(target: Path, fill: Callable[[Path], None]) -> None:
    temporary: Path | None = None
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
        os.close(handle)
        temporary = Path(name)
        temporary.chmod(0o644)
        fill(temporary)
        temporary.replace(target)
        temporary = None
        _sync_folder(target.parent)
    except OSError as error:
        raise DiskError(f"{target}: cannot be written: {_reason(error)}") from None
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink()


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()
