"""Small records that know whether they are whole: JSON with its own CRC32C.

A sealed record has one spelling. A text that is not spelled as ``seal`` would spell its content is
refused, so that no flipped bit passes, not even one in a space.
"""

from __future__ import annotations

import errno
import json
import os
import stat
from typing import TYPE_CHECKING, Any, NoReturn

from porous.errors import DiskError, FormatError
from porous.scale.codec import crc32c

if TYPE_CHECKING:
    from pathlib import Path

DAMAGE = (errno.EIO, errno.ELOOP, errno.ENOTDIR, errno.ENXIO, errno.EISDIR)
"""What the system answers where there is no readable file of that name; nor will there be."""


def seal(content: dict[str, Any]) -> bytes:
    """Return the text of a record: its CRC32C and its content, one spelling for one content."""
    text = json.dumps(content, indent=1, allow_nan=False)
    return f'{{"crc32c": "{crc32c(text.encode()):08x}", "content": {text}}}\n'.encode()


def unseal(data: bytes) -> dict[str, Any]:
    """Return the content of a sealed record.

    Raises
    ------
    FormatError
        Where it is not JSON, or one character is not as it was written.
    """
    content = _parsed(data).get("content")
    try:
        if isinstance(content, dict) and seal(content) == data:
            return content
    except (ValueError, RecursionError):  # infinite numbers; brackets nested too deep
        pass
    raise FormatError("is damaged: its checksum is wrong")


def read_file(path: Path, most: int) -> bytes:
    """Return the bytes of a regular file that has at most ``most`` of them; links are refused.

    Raises
    ------
    FormatError
        Where there is none, it is something else, longer, or the disk has lost its bytes.
    DiskError
        Where it may be as it should be and only cannot be read now: no rights, no handles left.
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            return _bytes(handle, most)
        finally:
            os.close(handle)
    except FileNotFoundError:
        raise FormatError("is missing") from None
    except OSError as error:
        if error.errno in DAMAGE:
            raise FormatError(f"cannot be read: {_reason(error)}") from None
        raise DiskError(f"{path}: cannot be read: {_reason(error)}") from None


def _bytes(handle: int, most: int) -> bytes:
    status = os.fstat(handle)
    if not stat.S_ISREG(status.st_mode):
        raise FormatError("is not a regular file")
    if status.st_size > most:
        raise FormatError(f"has {status.st_size} bytes; it can have {most} at most")
    pieces, left = [], status.st_size
    while left and (piece := os.read(handle, left)):
        pieces.append(piece)
        left -= len(piece)
    return b"".join(pieces)


def _parsed(data: bytes) -> dict[str, Any]:
    try:
        record = json.loads(data, parse_constant=_not_a_number)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"is not JSON: {str(error)[:80]}") from None
    return record if isinstance(record, dict) else {}


def _not_a_number(word: str) -> NoReturn:
    raise ValueError(f"{word} is no number")


def _reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()
