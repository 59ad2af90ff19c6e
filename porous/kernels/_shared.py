"""What kernel files share: the house decorator, its cache, one array type, threads and strokes.

Compiled kernels are kept by the text that they are made from: that of their own file, of this one,
and of those of this folder that their file imports from. So no edit meets a stale one, and an edit
elsewhere, or another copy of the package, costs nobody anything.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import ArrayLike, DTypeLike, NDArray


IMPORTS = re.compile(rb"from porous\.kernels\.(\w+) import")


@functools.cache
def _digest(path: str) -> str:
    """Return what tells the text of a file, and of those it takes from, from others."""
    texts, left = dict[str, bytes](), [Path(path).stem]
    while left:
        name = left.pop()
        texts[name] = Path(path).with_name(f"{name}.py").read_bytes()
        left += {found.decode() for found in IMPORTS.findall(texts[name])} - {*texts, *left}
    return hashlib.sha256(b"".join(texts[name] for name in sorted(texts))).hexdigest()[:16]


@functools.cache
def _room() -> Path:
    """Return the folder that compiled kernels lie in, or one for this process alone."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(home) / "porous"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return Path(tempfile.mkdtemp(prefix="porous-kernels-"))


class ByText:
    """Where numba keeps a compiled function: by the text it was made from, wherever that lies."""

    def __init__(self, function: Callable[..., Any], path: str) -> None:
        self._line, self._digest = function.__code__.co_firstlineno, _digest(path)

    from_function = classmethod(lambda cls, function, path: cls(function, path))

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(_room() / f"kernels-{self._digest}")

    def ensure_cache_path(self) -> None:
        """Raise OSError where the folder is not there."""
        Path(self.get_cache_path()).mkdir(parents=True, exist_ok=True)

    def get_source_stamp(self) -> str:
        """Return what has to be the same for a function to be taken from there."""
        return self._digest

    def get_disambiguator(self) -> str:
        """Return what tells functions of the same name apart."""
        return str(self._line)


@contextlib.contextmanager
def _kept_by_text() -> Iterator[None]:
    """Let numba keep what is decorated meanwhile where ``ByText`` says, and nothing else."""
    before = numba.config.CACHE_LOCATOR_CLASSES  # type: ignore[attr-defined]
    numba.config.CACHE_LOCATOR_CLASSES = f"{__name__}.ByText"  # type: ignore[attr-defined]
    try:
        yield
    finally:
        numba.config.CACHE_LOCATOR_CLASSES = before  # type: ignore[attr-defined]


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function once, cached, free of the interpreter's lock: the house decorator."""
    own = contextlib.nullcontext() if "NUMBA_CACHE_DIR" in os.environ else _kept_by_text()
    with own:
        made = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    cache = getattr(made, "_cache", None)  # not there where numba is told not to compile
    if cache is not None:
        save = cache.save_overload

        def save_if_possible(signature: Any, data: Any) -> None:
            # A disk that is full costs the next start some seconds, not this run its result.
            with contextlib.suppress(OSError):
                save(signature, data)

        cache.save_overload = save_if_possible
    return made


def source(array: ArrayLike, dtype: DTypeLike) -> NDArray[Any]:
    """Return ``array`` as the one type that kernels take as input: C-contiguous and read-only.

    numba compiles a kernel anew for a writable array; values hold read-only ones.
    """
    result = np.ascontiguousarray(array, dtype=dtype).view()
    result.flags.writeable = False
    return result


def threads() -> int:
    """Return the number of threads to use: those this process may run on, or POROUS_THREADS."""
    wanted = os.environ.get("POROUS_THREADS", "")
    return int(wanted) if wanted.isdigit() and int(wanted) else len(os.sched_getaffinity(0))


def slabs(
    count: int,
    size: int,
    work: Callable[[int, int], None],
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Call ``work(start, stop)`` for slabs of ``size`` out of ``count``, on all threads.

    Slabs are independent, so results do not depend on the number of threads. ``progress(done,
    count)`` is called in the caller's thread after each slab; raising in it cancels the rest.
    """
    ranges = [(a, min(a + size, count)) for a in range(0, count, size)]
    done = 0
    with ThreadPoolExecutor(max_workers=threads()) as pool:
        futures = [pool.submit(work, a, b) for a, b in ranges]
        try:
            for future, (a, b) in zip(futures, ranges, strict=True):
                future.result()
                done += b - a
                if progress is not None:
                    progress(done, count)
        except BaseException:
            for future in futures:
                future.cancel()
            raise


def words_of(flags: NDArray[np.bool_]) -> NDArray[np.uint64]:
    """Return flags as bits, 64 along the last axis to a word, the first in its lowest bit.

    The last axis is of whole words. numpy packs no short rows without the interpreter's lock.
    """
    bits = np.packbits(flags.reshape(-1), bitorder="little")
    return bits.view("<u8").reshape(*flags.shape[:-1], flags.shape[-1] // 64)


def row_bits(mask: NDArray[np.bool_], words: int) -> NDArray[np.uint64]:
    """Return masks of rows (x, y, z) as bits, as ``words_of`` does: (x, y, words)."""
    nx, ny, n = mask.shape
    result = np.zeros((nx, ny, words), np.uint64)
    size = max(1, (1 << 22) // (ny * n))
    for a in range(0, nx, size):
        part = mask[a : a + size]
        if n % 64:
            part = np.pad(part, ((0, 0), (0, 0), (0, -n % 64)))
        result[a : a + size, :, : part.shape[2] // 64] = words_of(part)
    return source(result, np.uint64)


@kernel
def popcount(x):
    """Return the number of set bits, as uint64; one machine instruction once compiled."""
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)


@kernel
def stroke(column, start, low, high, depths, row):
    # Sample c of voxel k lies at k + depths[row, c]; only a span's first and last voxel can be
    # partly inside.
    points = depths.shape[1]
    stop = start + column.shape[0]
    low, high = min(max(low, start - 1.0), stop + 1.0), min(max(high, start - 1.0), stop + 1.0)
    first = max(start, np.int64(np.ceil(low - depths[row, points - 1])))
    last = min(stop - 1, np.int64(np.floor(high - depths[row, 0])))
    for k in range(first, last + 1):
        bits = np.uint64(0)
        for c in range(points):
            place = k + depths[row, c]
            if low <= place and place <= high:
                bits |= np.uint64(1) << np.uint64(row * points + c)
        column[k - start] |= bits


@kernel
def columns(box, start, shape):
    # Voxels of the window that a box, lower and upper corner, may have samples in.
    x0 = max(np.int64(np.floor(max(box[0], start[0] - 1.0))), start[0])
    y0 = max(np.int64(np.floor(max(box[1], start[1] - 1.0))), start[1])
    x1 = min(np.int64(np.floor(min(box[3], start[0] + shape[0] + 1.0))), start[0] + shape[0] - 1)
    y1 = min(np.int64(np.floor(min(box[4], start[1] + shape[1] + 1.0))), start[1] + shape[1] - 1)
    if box[5] < start[2] or box[2] > start[2] + shape[2]:
        x1 = x0 - 1
    return x0, y0, x1, y1


@kernel
def full(column, start, low, high, everything):
    # Whether the voxels between two places on a line are full: then no span can add to them.
    first = np.int64(np.floor(min(max(low - start, 0.0), column.shape[0] + 0.0)))
    last = np.int64(np.floor(min(max(high - start, -1.0), column.shape[0] - 1.0)))
    for k in range(first, last + 1):
        if column[k] != everything:
            return False
    return True


@kernel
def half_diagonal(box, spacing):
    # Half the diagonal of a box, in units of length.
    total = 0.0
    for a in range(3):
        total += (0.5 * max(box[a + 3] - box[a], 0.0) * spacing[a]) ** 2
    return np.sqrt(total)


@kernel
def all_marked(marks, span):
    # Whether all voxels of a span, first and last per axis, are marked.
    for i in range(span[0], span[3] + 1):
        for j in range(span[1], span[4] + 1):
            for k in range(span[2], span[5] + 1):
                if marks[i, j, k] == 0:
                    return False
    return True
