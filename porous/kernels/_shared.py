"""What every kernel file shares: the house decorator, its cache, one array type, threads.

numba's cache does not notice an edit to a function called from another file, so kernels call only
their own file and this one, and the cache lies in a folder named after the text of all of them.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, DTypeLike, NDArray


def _cache_folder():
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(home) / "porous" / f"kernels-{digest.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return str(folder)
    except OSError:
        return tempfile.mkdtemp(prefix="porous-kernels-")


if "NUMBA_CACHE_DIR" not in os.environ:
    numba.config.CACHE_DIR = _cache_folder()  # type: ignore[attr-defined]

kernel = numba.njit(cache=True, nogil=True, error_model="numpy")
"""The house decorator: compiled once, cached, free of the interpreter's lock."""


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
