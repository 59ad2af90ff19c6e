"""The gate before every large allocation: what the work needs against what there is."""

from __future__ import annotations

import os
import re

import psutil

from porous.errors import MemoryLimitError, RecipeError

SHARE = 0.8
"""Part of the free memory that porous takes at most."""


def available() -> int:
    """Return how many bytes porous may take: 80 % of what is free, or POROUS_MAX_MEMORY."""
    free = int(psutil.virtual_memory().available * SHARE)
    wanted = os.environ.get("POROUS_MAX_MEMORY", "")
    return min(free, parse(wanted)) if wanted else free


def parse(text: str) -> int:
    """Return the bytes that a text such as ``8G``, ``500 MiB`` or ``1000000`` means.

    Raises
    ------
    RecipeError
        Where it is no amount of memory.
    """
    match = re.fullmatch(
        r"(\d{1,15}(?:\.\d{1,3})?)\s*([KMGTP]?)(?:i?B)?", text.strip(), re.IGNORECASE
    )
    if match is None or float(match[1]) == 0:
        raise RecipeError(f"memory: got {text!r}; wanted an amount such as 8G or 500M")
    return int(float(match[1]) * 1024 ** " KMGTP".index(match[2].upper() or " "))


def readable(amount: float) -> str:
    """Return a number of bytes for people: ``1.5 GiB``."""
    for unit in ("B", "KiB", "MiB", "GiB", "TiB", "PiB"):
        if amount < 1024 or unit == "PiB":
            break
        amount /= 1024
    return f"{amount:.3g} {unit}" if unit != "PiB" or amount < 1e4 else f"{amount:.1e} {unit}"


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
