"""The gate before every large allocation: what the work needs against what there is."""

from __future__ import annotations

import contextlib
import os
import re
import resource
from pathlib import Path
from typing import TYPE_CHECKING

from porous.errors import MemoryLimitError, RecipeError

if TYPE_CHECKING:
    from collections.abc import Iterator

SHARE = 0.8
"""Part of the free memory that porous takes at most."""
AMOUNT = re.compile(r"(\d{1,15}(?:\.\d{1,3})?)\s*([KMGTP]?)(?:i?B)?", re.IGNORECASE)
GROUPS = Path("/proc/self/cgroup")
CONTROL = Path("/sys/fs/cgroup")
FILES = {
    # What a control group may use, what it uses, and what of that are mere copies of files.
    "": ("memory.max", "memory.current", "inactive_file"),
    "memory": ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
}
NO_LIMIT = 2**62
"""From here on a limit is none: version 1 writes 2⁶³ less a page."""


def available() -> int:
    """Return how many bytes porous may take: 80 % of what is free.

    Free is what the machine has left, or the control group that the process runs in (a container,
    a batch job), or the limit on the process's address space: the least of them. The environment
    variable POROUS_MAX_MEMORY (``8G``) lowers it.
    """
    import psutil

    free = [psutil.virtual_memory().available, *_address_space(), *group_room(GROUPS, CONTROL)]
    share = int(max(min(free), 0) * SHARE)
    wanted = os.environ.get("POROUS_MAX_MEMORY", "")
    return min(share, parse(wanted)) if wanted else share


@contextlib.contextmanager
def limited(amount: str | None) -> Iterator[None]:
    """Let no more than ``amount`` (``8G``) of memory be taken, here and by guests."""
    before = os.environ.get("POROUS_MAX_MEMORY")
    if amount is not None:
        os.environ["POROUS_MAX_MEMORY"] = str(parse(amount))
    try:
        yield
    finally:
        if amount is not None:
            os.environ.pop("POROUS_MAX_MEMORY")
            if before is not None:
                os.environ["POROUS_MAX_MEMORY"] = before


def parse(text: str) -> int:
    """Return the bytes that a text such as ``8G``, ``500 MiB`` or ``1000000`` means.

    Raises
    ------
    RecipeError
        Where it is no amount of memory.
    """
    match = AMOUNT.fullmatch(text.strip())
    if match is None or float(match[1]) == 0:
        raise RecipeError(f"memory: got {text!r}; wanted an amount such as 8G or 500M")
    return int(float(match[1]) * 1024 ** " KMGTP".index(match[2].upper() or " "))


def group_room(groups: Path, control: Path) -> list[int]:
    """Return what is left to each control group that the process belongs to, in bytes.

    Parameters
    ----------
    groups
        The list of groups of the process: lines ``number:controllers:path``.
    control
        Where control groups are mounted; version 2, or version 1 under ``memory``.
    """
    room: list[int] = []
    with contextlib.suppress(OSError):
        for line in groups.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            if controllers in FILES:
                root = control / controllers
                inner = root / path.lstrip("/")
                # Limits of the groups around bind too; in a container the path may lie outside.
                places = [inner, *inner.parents]
                room += [
                    left
                    for place in places[: places.index(root) + 1]
                    if (left := _left(place, *FILES[controllers])) is not None
                ]
    return room


def _left(group: Path, most: str, used: str, cached: str) -> int | None:
    try:
        limit = int((group / most).read_text())
        if limit >= NO_LIMIT:
            return None
        taken = int((group / used).read_text())
        lines = (group / "memory.stat").read_text().splitlines()
    except (OSError, ValueError):  # no such group here, or "max": no limit
        return None
    spare = [int(value) for name, value in map(str.split, lines) if name == cached]
    return limit - taken + sum(spare)


def _address_space() -> list[int]:
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return []
    import psutil

    return [limit - psutil.Process().memory_info().vms]


def readable(amount: float) -> str:
    """Return a number of bytes for people: ``1.5 GiB``."""
    for unit in ("B", "KiB", "MiB", "GiB", "TiB", "PiB"):
        if amount < 1024 or unit == "PiB":
            break
        amount /= 1024
    digits = 3 if amount < 999.5 else 4  # three would write 1023 as 1.02e+03
    return f"{amount:.{digits}g} {unit}"


def check_memory(needed: float, what: str, remedy: str, *, limit: int | None = None) -> None:
    """Raise ``MemoryLimitError`` where ``needed`` bytes are more than ``limit`` or than there is.

    Parameters
    ----------
    needed
        Estimate in bytes; may be astronomically large.
    what
        What would need it: ``"a grid of 9³ voxels"``.
    remedy
        What the user can do instead.
    limit
        In bytes; ``available()`` where not given.
    """
    bound = available() if limit is None else limit
    if needed > bound:
        raise MemoryLimitError(
            f"{what} would need {readable(needed)} of memory; "
            f"{readable(bound)} may be used. {remedy}"
        )
