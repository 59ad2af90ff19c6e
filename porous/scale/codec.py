"""One chunk as bytes: zstd at level 1, then the CRC32C of what zstd made.

These are Zarr's own codecs in Zarr's own order, so that any reader of Zarr finds the same voxels
and notices a flipped bit. Chunks at the upper ends of the frame are stored full, as Zarr wants
them, with zeros beyond the frame.

Sources: RFC 8878 §3.1.1.1 (header of a zstd frame); RFC 3720 §B.4 (CRC32C); Zarr v3 codecs
``zstd`` and ``crc32c``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from porous.errors import FormatError, PorousError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

LEVEL = 1
"""zstd's level: higher ones are slower than the disk and save little on 0 and 255."""
PIECE = 1 << 24
"""Bytes of a file that are read at once."""
SUM = 4
"""Bytes of the CRC32C at a chunk's end."""
MAGIC = b"\x28\xb5\x2f\xfd"


def crc32c(data: bytes) -> int:
    """Return the CRC32C (Castagnoli) of some bytes.

    Raises
    ------
    PorousError
        Where the extra ``scale`` is not installed.
    """
    try:
        import google_crc32c
    except ImportError as error:
        raise _not_installed(error) from None
    return int(google_crc32c.value(data))


def crc32c_of(path: Path) -> tuple[int, int]:
    """Return how many bytes a file has, and their CRC32C."""
    import google_crc32c

    size = total = 0
    with path.open("rb") as file:
        while piece := file.read(PIECE):
            size, total = size + len(piece), int(google_crc32c.extend(total, piece))
    return size, total


def encode(block: NDArray[np.uint8], chunk: tuple[int, int, int]) -> bytes:
    """Return the file of a chunk.

    Parameters
    ----------
    block
        uint8; the whole chunk, or what of it lies in the frame.
    chunk
        Shape of a whole chunk.
    """
    full = block
    if block.shape != chunk:
        full = np.zeros(chunk, np.uint8)
        full[tuple(slice(n) for n in block.shape)] = block
    body: bytes = _zstd().encode(np.ascontiguousarray(full))
    return body + crc32c(body).to_bytes(SUM, "little")


def check(data: bytes, size: int) -> int:
    """Return the CRC32C of a chunk's body, or raise ``FormatError`` where it is damaged.

    The sum is of the body alone: over the body *and* its own CRC32C every intact file of the
    world has the same sum, 0x48674BC7, and one chunk could stand for another.

    Parameters
    ----------
    data
        All bytes of the file.
    size
        Bytes of a chunk before compression.
    """
    body, end = data[:-SUM], data[-SUM:]
    found = crc32c(body)
    if len(end) < SUM or end != found.to_bytes(SUM, "little"):
        raise FormatError("its checksum is wrong: bytes have changed or are missing")
    if (claimed := _content_size(body)) != size:
        raise FormatError(f"it would become {claimed} bytes; wanted a chunk of {size}")
    return found


def decode(data: bytes, chunk: tuple[int, int, int]) -> NDArray[np.uint8]:
    """Return the voxels of a chunk that ``check`` has let pass: uint8, shape ``chunk``.

    No more than the chunk is allocated, whatever the bytes claim.

    Raises
    ------
    FormatError
        Where the body is no zstd frame of just that many bytes.
    """
    result = np.empty(chunk, np.uint8)
    try:
        _zstd().decode(data[:-SUM], out=result.reshape(-1))
    except (RuntimeError, ValueError) as error:
        raise FormatError(f"its compressed bytes are damaged ({error})") from None
    return result


def compressed(array: NDArray[Any]) -> bytes:
    """Return an array of any kind as zstd makes it."""
    body: bytes = _zstd().encode(np.ascontiguousarray(array).reshape(-1).view(np.uint8))
    return body


def expanded(body: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return the array that ``compressed`` was given; no more than it is allocated.

    Raises
    ------
    FormatError
        Where the bytes are not of just that.
    """
    result = np.empty(shape, dtype)
    wanted = result.reshape(-1).view(np.uint8)
    if _content_size(body) != wanted.size:
        raise FormatError(f"does not become {wanted.size} bytes")
    if not wanted.size:
        return result
    try:
        _zstd().decode(body, out=wanted)
    except (RuntimeError, ValueError) as error:
        raise FormatError(f"its compressed bytes are damaged ({error})") from None
    return result


def largest(size: int) -> int:
    """Return how many bytes a chunk's file has at most (zstd's ``ZSTD_COMPRESSBOUND``, and CRC)."""
    return size + (size >> 8) + 128 + SUM


def _zstd() -> Any:
    try:
        from numcodecs.zstd import Zstd
    except ImportError as error:
        raise _not_installed(error) from None
    return Zstd(level=LEVEL)


def _not_installed(error: ImportError) -> PorousError:
    return PorousError(f"a store of chunks needs more: {error}; pip install 'porous[scale]'")


def _content_size(body: bytes) -> int | None:
    """Return how many bytes the header of a zstd frame promises; None where it does not say."""
    if len(body) < 6 or not body.startswith(MAGIC):
        return None
    flags = body[4]
    single = flags >> 5 & 1
    width = (single, 2, 4, 8)[flags >> 6]
    place = 5 + (1 - single) + (0, 1, 2, 4)[flags & 3]
    field = body[place : place + width]
    if not width or len(field) < width:
        return None
    return int.from_bytes(field, "little") + (256 if width == 2 else 0)
