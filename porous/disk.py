"""The only file that writes where the user looks: each file appears complete or not at all."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import re
import secrets
import shutil
import stat
from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING

from porous.errors import DiskError, PorousError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

TEMPORARY = ".porous-"
"""How the names of unfinished files begin; they stand beside the file that they will become."""
STAGE = re.compile(re.escape(TEMPORARY) + "[0-9a-f]{16}")
LOOK = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
"""How a folder is opened to be locked: itself, not what a link stands for."""
CANNOT_SYNC = (errno.EINVAL, errno.ENOTSUP)
"""What file systems answer that cannot put a folder on the platter."""
CANNOT_LOCK = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS, errno.ENOLCK, errno.EBADF)
"""What file systems answer that know no locks."""


def write_bytes(path: str | Path, chunks: bytes | Iterable[bytes]) -> None:
    """Write a file whole: to a temporary beside it, to the platter, then into place.

    Parameters
    ----------
    path
        Where the file is to be; a file of that name is replaced, a link is followed. Pipes,
        devices and folders are refused.
    chunks
        Its bytes, at once or in pieces. Whatever an iterator raises ends the writing.

    Raises
    ------
    DiskError
        Where the disk refuses; what was there before is untouched and nothing is left behind.
    """
    pieces = [chunks] if isinstance(chunks, bytes) else chunks
    try:
        _put(_target(path), pieces)
    except OSError as error:
        raise DiskError(f"{path}: cannot be written: {_reason(error)}") from None


def write_files(folder: str | Path, files: Iterable[tuple[str, Iterable[bytes]]]) -> None:
    """Write files that belong together into a folder, the last of them last, or none at all.

    Parameters
    ----------
    folder
        There already.
    files
        Plain names, and their bytes in pieces. Files of those names are replaced.

    Raises
    ------
    DiskError
        Where the disk refuses.
    """
    with staging(folder) as stage:
        last = _stage(stage, files)
        commit(stage, folder, last=last)


def write_folder(path: str | Path, files: Iterable[tuple[str, Iterable[bytes]]]) -> None:
    """Write a new folder of files, whole or not at all.

    Parameters
    ----------
    path
        Where the folder is to be; nothing of that name may be there, but for an empty folder.
    files
        Names, with ``/`` between a folder inside and what is in it, and their bytes in pieces.

    Raises
    ------
    DiskError
        Where something is there already, or the disk refuses.
    """
    target = Path(path)
    if why := taken(target):
        raise DiskError(f"{path}: {why}")
    with staging(target.parent) as stage:
        inner = stage / target.name
        with _refusals(target):
            inner.mkdir()
        _stage(inner, files)
        with _refusals(target):
            inner.replace(target)
            _sync_folder(target.parent)


def taken(path: str | Path) -> str:
    """Return why no new folder can have this name, or nothing where it can.

    Raises
    ------
    DiskError
        Where the disk does not let anybody look.
    """
    with _refusals(Path(path)):
        target = _name(path)
        if target.is_symlink():
            return (
                f"is a link to {target.readlink()}, and no folder is written through a link; "
                "wanted another name, or that out of the way"
            )
        if target.exists() and not (target.is_dir() and not any(target.iterdir())):
            return "is there already; wanted another name, or that out of the way"
    return ""


def _stage(stage: Path, files: Iterable[tuple[str, Iterable[bytes]]]) -> str:
    name = ""
    for name, chunks in files:
        with _refusals(stage):
            (stage / name).parent.mkdir(parents=True, exist_ok=True)
        write_bytes(stage / name, chunks)
    return name


def place(path: str | Path, content: bytes) -> None:
    """Write one of many files whole, as ``write_bytes`` does, but for the folder's own entry.

    Its bytes are on the platter when it gets its name; that the name is there too ``settle`` sees
    to, once for all files of a folder. A link of that name is replaced, not followed: what stands
    in a store is never somewhere else.

    Raises
    ------
    DiskError
        Where the disk refuses; what was there before is untouched and nothing is left behind.
    """
    try:
        _move_in(_name(path), (content,))
    except OSError as error:
        raise DiskError(f"{path}: cannot be written: {_reason(error)}") from None


def settle(folder: str | Path) -> None:
    """Put the names of all files of a folder on the platter, where its file system can.

    Raises
    ------
    DiskError
        Where the disk refuses.
    """
    with _refusals(Path(folder)):
        _sync_folder(_name(folder))


def sweep(folder: str | Path, pattern: str = f"{TEMPORARY}*") -> None:
    """Remove what has such a name from a folder: the temporaries that killed writers have left.

    Raises
    ------
    DiskError
        Where the folder cannot be listed, or one of them cannot be removed.
    """
    with _refusals(Path(folder)):
        for left in list(_name(folder).glob(pattern)):
            if left.is_dir() and not left.is_symlink():
                shutil.rmtree(left)
            else:
                left.unlink(missing_ok=True)


def make_folder(path: str | Path) -> Path:
    """Create a folder and its parents where they are missing; return its path.

    Raises
    ------
    DiskError
        Where it cannot be made or written to; folders made on the way are removed again.
    """
    folder = Path(path)
    made: list[Path] = []
    try:
        for place in _missing(_name(folder)):
            place.mkdir(exist_ok=True)
            made.append(place)
            _sync_folder(place.parent)
        _probe(folder)
    except OSError as error:
        for place in reversed(made):
            with contextlib.suppress(OSError):
                place.rmdir()
        raise DiskError(f"{folder}: cannot be written to: {_reason(error)}") from None
    return folder


def remove(path: str | Path) -> None:
    """Remove a file if it is there."""
    try:
        _name(path).unlink(missing_ok=True)
    except OSError as error:
        raise DiskError(f"{path}: cannot be removed: {_reason(error)}") from None


@contextlib.contextmanager
def locked(folder: str | Path) -> Iterator[None]:
    """Let nobody else who asks for it work in a folder meanwhile; death gives it free again.

    File systems that know no locks give none.

    Raises
    ------
    DiskError
        At once where somebody else has it, or the folder cannot be opened.
    """
    with _refusals(Path(folder)):
        handle = os.open(_name(folder), os.O_RDONLY | os.O_CLOEXEC)
    try:
        _lock(handle, Path(folder))
        yield
    finally:
        with contextlib.suppress(OSError):  # nothing was written through it
            os.close(handle)


def _lock(handle: int, folder: Path) -> None:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise DiskError(f"{folder}: another porous is at work there; wait for it") from None
    except OSError as error:
        if error.errno not in CANNOT_LOCK:
            raise DiskError(f"{folder}: cannot be locked: {_reason(error)}") from None


@contextlib.contextmanager
def folder_for(path: str | Path) -> Iterator[Path]:
    """Give a folder, made where it is missing, with its parents; work that fails leaves none empty.

    Raises
    ------
    DiskError
        At once where nothing can be written there.
    """
    folder = Path(path)
    with _refusals(folder):
        missing = _missing(_name(folder))
    make_folder(folder)
    try:
        yield folder
    except BaseException:
        for place in reversed(missing):
            with contextlib.suppress(OSError):
                place.rmdir()
        raise


@contextlib.contextmanager
def staging(path: str | Path) -> Iterator[Path]:
    """Give a hidden folder inside ``path`` to fill; on leaving it is gone, whatever happened.

    ``path`` is created where it is missing, and removed again where the work fails, so that
    nothing is left behind. ``commit`` moves what was staged into place. Hidden folders that the
    killed have left there go; those of the living are locked and stay.

    Raises
    ------
    DiskError
        At once where nothing can be written there; later for files that the disk refuses.
    """
    with folder_for(path) as folder:
        with _refusals(folder):
            _sweep_dead(folder)
            stage, handle = _new_stage(folder)
        try:
            yield stage
        except PorousError as error:
            # The user knows the folder, not the hidden one inside it.
            error.args = (str(error).replace(str(stage), str(folder)),)
            raise
        finally:
            with contextlib.suppress(OSError):  # rmtree ignores errors, but for those of closing
                shutil.rmtree(stage, ignore_errors=True)
            with contextlib.suppress(OSError):
                os.close(handle)


def _new_stage(folder: Path) -> tuple[Path, int]:
    """Make a hidden folder, and lock it for as long as the handle is open: while we live."""
    stage = folder / f"{TEMPORARY}{secrets.token_hex(8)}"
    stage.mkdir()
    try:
        handle = _locked_for_good(stage)
    except BaseException:
        with contextlib.suppress(OSError):
            stage.rmdir()
        raise
    # Before the lock was on it somebody may have taken it for one that the dead have left.
    return (stage, handle) if handle is not None else _new_stage(folder)


def _locked_for_good(stage: Path) -> int | None:
    """Return a handle of a folder with a lock on it; None where the folder is gone by then."""
    try:
        handle = os.open(stage, LOOK)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
    except OSError as error:
        if error.errno not in CANNOT_LOCK:  # where there are no locks, nobody sweeps
            os.close(handle)
            raise
    try:
        if stage.exists():
            return handle
    except BaseException:
        os.close(handle)
        raise
    os.close(handle)
    return None


def _sweep_dead(folder: Path) -> None:
    """Remove the stages of those that were killed: nobody has a lock on them any more."""
    for left in folder.glob(f"{TEMPORARY}*"):
        if not STAGE.fullmatch(left.name):
            continue
        with contextlib.suppress(OSError):  # in use, no folder, not ours to remove
            handle = os.open(left, LOOK)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(left, ignore_errors=True)
            finally:
                os.close(handle)


def commit(stage: Path, folder: str | Path, *, last: str, stale: Iterable[str] = ()) -> None:
    """Move the files of ``stage`` into ``folder``, and ``last`` after all the others.

    The old ``last`` goes first, then the ``stale`` files: a folder that has it is whole. Where a
    folder of that name is there already, its files are replaced and others in it stay.
    """
    target = Path(folder)
    for name in (last, *stale):
        remove(target / name)
    with _refusals(target):
        _sync_folder(target)
        for file in sorted(stage.iterdir()):
            if file.name != last:
                _merge(file, target / file.name)
        _sync_folder(target)
        (stage / last).replace(target / last)
        _sync_folder(target)


def _merge(source: Path, target: Path) -> None:
    if not (source.is_dir() and target.is_dir()):
        source.replace(target)
        return
    for file in sorted(source.iterdir()):
        _merge(file, target / file.name)
    _sync_folder(target)


@contextlib.contextmanager
def _refusals(target: Path) -> Iterator[None]:
    """Turn what the disk refuses into ``DiskError``."""
    try:
        yield
    except OSError as error:
        raise DiskError(f"{target}: cannot be written to: {_reason(error)}") from None


def _target(path: str | Path) -> Path:
    """Return the file that a path stands for, through links; refuse what is no file."""
    target = Path(os.path.realpath(_name(path)))
    with contextlib.suppress(FileNotFoundError):
        if not stat.S_ISREG(target.stat().st_mode):  # a file would take the place of a device
            raise OSError(errno.EINVAL, "something that is not a file has that name")
    return target


def _name(path: str | Path) -> Path:
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "a name cannot hold a null character")
    return Path(path)


def _put(target: Path, pieces: Iterable[bytes]) -> None:
    _move_in(target, pieces)
    _sync_folder(target.parent)


def _move_in(target: Path, pieces: Iterable[bytes]) -> None:
    temporary = target.parent / f"{TEMPORARY}{secrets.token_hex(8)}"
    placed = False
    try:
        _fill(temporary, pieces)
        temporary.replace(target)
        placed = True
    finally:
        # Whatever ended the writing, Ctrl-C too: what is not in its place is nowhere.
        if not placed:
            with contextlib.suppress(OSError):
                temporary.unlink()


def _fill(temporary: Path, pieces: Iterable[bytes]) -> None:
    # The mode is the user's own: what umask leaves of it, as for every file.
    handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    with contextlib.ExitStack() as ends:
        ends.callback(os.close, handle)
        # Threads may make the pieces. Of who is given up they end here: not whenever, and in
        # whichever thread, its memory is collected.
        if isinstance(pieces, Generator):
            ends.callback(pieces.close)
        done = 0
        for piece in pieces:
            done += _write_all(handle, piece, done)
        os.fsync(handle)


def _write_all(handle: int, piece: bytes, before: int) -> int:
    rest = memoryview(piece)
    while rest:
        try:
            rest = rest[os.write(handle, rest) :]
        except OSError as error:
            done = before + len(piece) - len(rest)
            raise OSError(error.errno, f"{_reason(error)} (after {done} bytes)") from None
    return len(piece)


def _sync_folder(folder: Path) -> None:
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    except PermissionError:  # a folder that may be written to but not listed
        return
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in CANNOT_SYNC:
            raise
    finally:
        os.close(handle)


def _missing(folder: Path) -> list[Path]:
    """Return the folder and its parents that are not there, the outermost first."""
    return [place for place in reversed((folder, *folder.parents)) if not place.exists()]


def _probe(folder: Path) -> None:
    place = folder / f"{TEMPORARY}{secrets.token_hex(8)}"
    try:
        _fill(place, ())
    finally:
        place.unlink(missing_ok=True)


def _reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()
