"""The gate that every reader passes: nothing is allocated that the file's own bytes do not justify.

Readers get a ``Source``: bytes that are in memory already. What they allocate from there on they
first ask of ``need`` (raw bytes), ``inflate`` (compressed bytes), ``numbers`` (text) or ``markup``
(XML without document types or entities).
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import stat
import warnings
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from porous.errors import FormatError, FormatWarning
from porous.memory import check_memory

if TYPE_CHECKING:
    from numpy.typing import NDArray

HEADER = 64 * 1024
"""The longest header that is read, in bytes."""
RATIO = 1032
"""Deflate makes at most this many bytes of one (zlib, "Maximum Expansion Factor")."""
ZLIB_OR_GZIP = 32 + zlib.MAX_WBITS
"""What zlib is told, so that a stream's head says which of the two it is."""
ELEMENTS, DEPTH = 10_000, 64
"""The most elements and the deepest nesting of an XML file's head."""
LONG_TAG = re.compile(rb"<[^<>]{%d}" % HEADER)
TOKEN = 64
"""The longest number that is read, in characters."""
STEP = 1 << 18
"""Text is read in pieces of this many characters."""


@dataclass(frozen=True)
class Source:
    """A file's name, for messages, and all its bytes."""

    name: str
    data: bytes
    folder: Path | None = None
    """Where it lies, for ``beside``; None where it lies nowhere."""

    def beside(self, name: str, what: str) -> bytes:
        """Return the bytes of another file, which must lie in the same folder and be no link.

        Raises
        ------
        FormatError
            For a name that is not plain, or a file that is not there or not a regular one.
        """
        if not _is_plain(name) or self.folder is None:
            refuse(what, name, "the name of a file in the same folder")
        path = self.folder / name
        with contextlib.suppress(OSError):  # what such names are worth is said on opening
            if path.is_symlink():
                refuse(what, name, "a file, not a link to one")
        try:
            return open_source(path).data
        except FormatError as error:
            raise FormatError(f"{what}: {name}: {error}") from None

    def misses(self, name: str) -> bool:
        """Whether a plain name is that of no file in the same folder."""
        plain = _is_plain(name) and self.folder is not None
        return plain and not os.path.lexists(Path(self.folder or "") / name)

    def is_bad_name(self, name: str) -> bool:
        """Whether ``beside`` refuses a name unseen."""
        return not _is_plain(name) or self.folder is None

    def note(self, text: str) -> None:
        """Warn of something that was accepted though it is not as it should be."""
        warnings.warn(f"{self.name}: {text}", FormatWarning, stacklevel=2)


def _is_plain(name: str) -> bool:
    return name not in ("", ".", "..") and not set(name) & set("/\\\0")


def open_source(path: str | Path) -> Source:
    """Read a regular file into memory; pipes, devices and folders are refused unread."""
    try:
        # Without O_NONBLOCK the opening of a pipe that nobody writes to would wait for ever.
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as error:
        raise FormatError(f"cannot be opened: {_reason(error)}") from None
    try:
        return Source(str(path), _bytes(handle), Path(path).parent)
    except OSError as error:
        raise FormatError(f"cannot be read: {_reason(error)}") from None
    finally:
        os.close(handle)


def need(wanted: int, have: int, what: str, *, unit: str = "bytes") -> None:
    """Refuse ``what`` where it takes ``wanted`` bytes and only ``have`` are there."""
    if wanted < 0:
        refuse(what, wanted, f"zero or more {unit}")
    if wanted > have:
        raise FormatError(f"{what} would take {wanted} {unit}; the file has {have} left for it")


def inflate(blob: bytes | memoryview, size: int, what: str) -> bytes:
    """Return the ``size`` bytes that ``blob`` holds compressed by zlib, and not one more."""
    return inflate_first(blob, size, what)[0]


def inflate_first(blob: bytes | memoryview, size: int, what: str) -> tuple[bytes, int]:
    """Return the ``size`` bytes of the stream of zlib or gzip that ``blob`` begins with.

    Also returns how many bytes of ``blob`` the stream takes; what follows is left to the caller.
    """
    need(size, RATIO * len(blob), what)
    machine = zlib.decompressobj(ZLIB_OR_GZIP)
    try:
        result = machine.decompress(blob, size + 1)
    except zlib.error as error:
        raise FormatError(f"{what}: compressed bytes are damaged ({error})") from None
    if len(result) != size or not machine.eof:
        raise FormatError(f"{what}: did not decompress to {size} bytes as its header says")
    return result, len(blob) - len(machine.unused_data)


def numbers(text: bytes, what: str, *, most: int | None = None) -> NDArray[np.float64]:
    """Return the numbers of a text, parted by white space; at most ``most`` of them.

    Works through the text piece by piece, so that no more than a few megabytes of tokens are
    alive. Refuses whatever is not a number; NaN and infinities are left for the value to refuse.
    """
    pieces, count, start = [], 0, 0
    while start < len(text):
        tokens, start = _tokens(text, start, what)
        count += len(tokens)
        if most is not None and count > most:
            raise FormatError(f"{what}: got more than the {most} numbers that were announced")
        pieces.append(_floats(tokens, what))
    return np.concatenate(pieces) if pieces else np.zeros(0)


def few(words: list[bytes], what: str) -> list[float]:
    """Return the numbers of a few words, where calling ``numbers`` on each line would be slow."""
    try:
        return [float(word) for word in words]
    except ValueError:
        refuse(what, b" ".join(words).decode("utf-8", "replace"), "numbers")


def whole(values: NDArray[np.float64], what: str) -> NDArray[np.int64]:
    """Return numbers that must be whole, as integers."""
    good = np.isfinite(values) & (np.abs(values) < 2.0**53)
    good[good] = values[good] == np.floor(values[good])
    if not good.all():
        bad = values[~good][0]
        raise FormatError(f"{what}: got {bad}; wanted a whole number")
    return values.astype(np.int64)


def integer(text: str | bytes | None, what: str) -> int:
    """Return the whole number that a text holds."""
    try:
        if text is not None and len(text) <= TOKEN:
            return int(text)
    except ValueError:
        pass
    return refuse(what, text, "a whole number")


def markup(text: bytes) -> Element:
    """Parse XML that has no document type, no entities, few elements and little depth."""
    if LONG_TAG.search(text):
        raise FormatError(f"XML: a tag of more than {HEADER} characters")
    builder = TreeBuilder()
    parser = expat.ParserCreate()
    parser.buffer_text = True
    depth = elements = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, elements
        depth, elements = depth + 1, elements + 1
        if depth > DEPTH or elements > ELEMENTS:
            raise FormatError(f"XML: more than {ELEMENTS} elements, or nested over {DEPTH} deep")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def forbidden(*_: object) -> NoReturn:
        raise FormatError("XML: document types and entities are not read")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = forbidden
    try:
        parser.Parse(text, True)  # noqa: FBT003  (expat knows no keyword)
    except (expat.ExpatError, UnicodeError, LookupError, ValueError) as error:
        raise FormatError(f"XML: {error}") from None
    return builder.close()


def refuse(what: str, got: object, wanted: str) -> NoReturn:
    """Raise ``FormatError``: what was wrong, what was got (cut short), what would be right."""
    shown = repr(got)
    shown = shown if len(shown) <= 60 else f"{shown[:57]}…"
    raise FormatError(f"{what}: got {shown}; wanted {wanted}")


def _bytes(handle: int) -> bytes:
    status = os.fstat(handle)
    if not stat.S_ISREG(status.st_mode):
        raise FormatError("is not a regular file")
    if not status.st_size:
        raise FormatError("is empty")
    check_memory(2 * status.st_size, "its bytes", "Cut it into parts.")
    with io.FileIO(handle, closefd=False) as stream:
        return stream.readall()


def _tokens(text: bytes, start: int, what: str) -> tuple[list[bytes], int]:
    tokens = text[start : start + STEP].split()
    stop = start + STEP
    if stop < len(text) and tokens and not text[stop - 1 : stop].isspace():
        stop -= len(tokens.pop())  # the last one may go on beyond the piece
    if stop <= start or (tokens and max(map(len, tokens)) > TOKEN):
        raise FormatError(f"{what}: got a word of more than {TOKEN} characters; wanted numbers")
    return tokens, stop


def _floats(tokens: list[bytes], what: str) -> NDArray[np.float64]:
    try:
        return np.array(tokens, dtype="S").astype(np.float64) if tokens else np.zeros(0)
    except ValueError:
        bad = next(token for token in tokens if not _is_number(token))
    refuse(what, bad.decode("utf-8", "replace"), "a number")


def _is_number(token: bytes) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return True


def _reason(error: Exception) -> str:
    return (getattr(error, "strerror", None) or str(error)).lower()
