"""What formats that are zip archives share: tables of contents that are true, damage in our words.

Reading trusts nothing that an archive says of itself: its table of contents has a limit, names are
plain and stand once, and what a member unpacks to is bounded by what it takes. Writing streams and
bears one date, so the same value gives the same bytes.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from contextlib import contextmanager
from typing import TYPE_CHECKING

from porous.errors import FormatError
from porous.formats.gate import RATIO, need, refuse

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from zipfile import ZipFile, ZipInfo

EPOCH = (1980, 1, 1, 0, 0, 0)
"""The date that every member bears."""
METHODS = {zipfile.ZIP_STORED: 1, zipfile.ZIP_DEFLATED: RATIO}
"""How many bytes one byte of a member may become."""
DIRECTORY = 64 * 1024
"""The longest table of contents that is read, in bytes."""
END = b"PK\x05\x06"
LARGE = 1 << 31
"""From so many bytes on a member needs the records of large archives."""


@contextmanager
def damage(what: str) -> Iterator[None]:
    """Say in our words what ``zipfile`` raises at files that are not as they should be."""
    try:
        yield
    except (zipfile.BadZipFile, zlib.error, struct.error, EOFError, ValueError) as error:
        raise FormatError(f"{what} is damaged ({error})") from None
    except (NotImplementedError, RuntimeError) as error:
        raise FormatError(f"{what} is encrypted or of a kind that is not read ({error})") from None


def check_directory(data: bytes) -> None:
    """Refuse a table of contents so long that ``zipfile`` would swell on reading it."""
    place = max(len(data) - 22, 0)  # without a comment it stands here: zipfile looks here first
    if not data.startswith(END, place):
        place = data.rfind(END, -DIRECTORY - 22)
    if place < 0:
        raise FormatError("no table of contents at its end; wanted a zip archive, all of it")
    size = int.from_bytes(data[place + 12 : place + 16], "little")
    if size == 2**32 - 1:  # the record of larger archives stands 76 bytes before
        size = int.from_bytes(data[max(place - 36, 0) : max(place - 28, 0)], "little")
    need(size, DIRECTORY, "the table of contents")


def opened(data: bytes) -> ZipFile:
    """Return an archive whose names are plain paths and stand once, whatever their case.

    Raises
    ------
    FormatError
        For damage, names that lead elsewhere, and names that stand twice.
    """
    check_directory(data)
    with damage("the archive"):
        archive = zipfile.ZipFile(io.BytesIO(data))
    seen: set[str] = set()
    for info in archive.infolist():
        name = info.orig_filename
        plain = name.isprintable() and not set(name) & set("\\:") and not name.startswith("/")
        if not plain or {"..", "."} & set(name.split("/")):
            refuse("a member", name, "names of files inside the archive")
        if name.lower() in seen:
            refuse("a member", name, "each name once")
        seen.add(name.lower())
    return archive


def checked(info: ZipInfo, most: int, what: str) -> None:
    """Refuse a member that cannot be unpacked, or says it is longer than ``most`` bytes.

    Raises
    ------
    FormatError
        For another compression, and a size that its own bytes do not justify.
    """
    if info.compress_type not in METHODS:
        refuse(f"compression of {what}", info.compress_type, "stored (0) or deflated (8)")
    need(info.file_size, min(most, METHODS[info.compress_type] * info.compress_size), what)


class _Pipe(io.RawIOBase):
    """A stream that ``zipfile`` writes to and we take from; it cannot be turned back."""

    def __init__(self) -> None:
        self.waiting: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, data: object) -> int:
        piece = bytes(data)  # type: ignore[call-overload]
        self.waiting.append(piece)
        return len(piece)

    def taken(self) -> bytes:
        result, self.waiting = b"".join(self.waiting), []
        return result


def written(members: Iterable[tuple[str, Iterable[bytes], int]]) -> Iterator[bytes]:
    """Give the bytes of an archive: of names, pieces of bytes, and how many these may be at most.

    No more than a piece is held at a time; the same members give the same bytes.
    """
    pipe = _Pipe()
    with zipfile.ZipFile(pipe, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, pieces, most in members:
            info = zipfile.ZipInfo(name, EPOCH)
            info.compress_type, info.create_system = zipfile.ZIP_DEFLATED, 3
            with archive.open(info, "w", force_zip64=most >= LARGE) as member:
                for piece in pieces:
                    member.write(piece)
                    yield pipe.taken()
    yield pipe.taken()
