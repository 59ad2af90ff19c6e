"""What strips of TIFF files are unpacked with: LZW and PackBits.

Both write no more than the result has room for, and read nothing beyond what is packed. TIFF 6.0,
sections 9 and 13.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.kernels._shared import kernel, source

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

CODES = 4096
"""Codes of twelve bits: the longest that there are."""


def lzw(packed: bytes | memoryview, size: int) -> NDArray[np.uint8]:
    """Return the first ``size`` bytes, or as many as there are before a code that cannot be."""
    table = np.empty((3, CODES), dtype=np.int32)
    return _run(lambda data, result: _lzw(data, result, table), packed, size)


def packbits(packed: bytes | memoryview, size: int) -> NDArray[np.uint8]:
    """Return the first ``size`` bytes, or as many as there are."""
    return _run(_packbits, packed, size)


def _run(work: Callable[..., int], packed: bytes | memoryview, size: int) -> NDArray[np.uint8]:
    result = np.empty(size, dtype=np.uint8)
    count = work(source(np.frombuffer(packed, dtype=np.uint8), np.uint8), result)
    return result[:count]


@kernel
def _lzw(packed, result, table):
    # Rows of the table: the code of all but the last byte, the last byte, the number of bytes.
    before, last, lengths = table[0], table[1], table[2]
    for code in range(258):
        lengths[code] = 1
    width, fresh, old, place = 9, 258, -1, 0
    bits, have, i = np.int64(0), 0, 0
    while place < result.shape[0]:
        while have < width and i < packed.shape[0]:
            bits = (bits << 8) | packed[i]
            have += 8
            i += 1
        if have < width:
            return place
        have -= width
        code = bits >> have
        bits &= (np.int64(1) << have) - 1
        if code == 257:
            return place
        if code == 256:
            width, fresh, old = 9, 258, -1
            continue
        if code > fresh or (code >= 256 and (old < 0 or (fresh >= 4096 and code >= fresh))):
            return place
        # A code that is about to be made is the old one and its own first byte.
        known = code if code < fresh else old
        length = lengths[known]
        entry = known
        for k in range(length - 1, -1, -1):
            byte = entry
            if entry >= 258:
                byte = last[entry]
                entry = before[entry]
            if place + k < result.shape[0]:
                result[place + k] = byte
        first = result[place]
        if known != code:
            if place + length < result.shape[0]:
                result[place + length] = first
            length += 1
        if old >= 0 and fresh < 4096:
            before[fresh], last[fresh], lengths[fresh] = old, first, lengths[old] + 1
            fresh += 1
            if fresh + 1 >= 1 << width and width < 12:
                width += 1
        place += length
        old = code
    return result.shape[0]


@kernel
def _packbits(packed, result):
    i, place = 0, 0
    while place < result.shape[0] and i < packed.shape[0]:
        head = packed[i]
        i += 1
        if head < 128:
            for _ in range(min(head + 1, result.shape[0] - place, packed.shape[0] - i)):
                result[place] = packed[i]
                place += 1
                i += 1
        elif head > 128 and i < packed.shape[0]:
            for _ in range(min(257 - head, result.shape[0] - place)):
                result[place] = packed[i]
                place += 1
            i += 1
    return place
