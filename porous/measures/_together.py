"""Families of measures taken at the same time: what one leaves of the cores the other takes."""

from __future__ import annotations

import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from queue import SimpleQueue
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from porous.measures._sample import Family, Findings, Sample

    Progress = Callable[[str, float], None]

AT_ONCE = 2
"""Families that are taken at the same time: each has its memory, and kernels their threads."""


class Taken(NamedTuple):
    """What a family has found, and the seconds by the clock that it took, beside others."""

    findings: Findings
    seconds: float


class _CancelledError(Exception):
    """Raised in families that are under way when the work is cancelled."""


class _Relay:
    """Progress of several threads, which the caller's thread tells; ends their work where told to.

    Queued are names and shares, and each family's future when it has ended.
    """

    def __init__(self) -> None:
        self.told: SimpleQueue[tuple[str, float] | Future[Taken]] = SimpleQueue()
        self._ended = threading.Event()

    def __call__(self, name: str, done: float) -> None:
        if self._ended.is_set():
            raise _CancelledError
        self.told.put((name, done))

    def end(self) -> None:
        self._ended.set()


def taken(families: Sequence[Family], sample: Sample) -> dict[str, Taken]:
    """Return what families find out about a sample, by name and in their order.

    Two are under way at a time. The sample's progress is told in the caller's thread: raising in it
    cancels, once what is under way tells of itself the next time.

    Raises
    ------
    PorousError
        What a family raises, the first of them.
    """
    from porous.kernels._shared import threads

    tell, relay = sample.progress, _Relay()
    sample.progress = relay
    try:
        with ThreadPoolExecutor(min(AT_ONCE, threads())) as pool:
            futures = [pool.submit(_take, family, sample) for family in families]
            try:
                _follow(futures, relay, tell)
            except BaseException:
                relay.end()
                for future in futures:
                    future.cancel()
                raise
    finally:
        sample.progress = tell
    return {f.name: future.result() for f, future in zip(families, futures, strict=True)}


def _take(family: Family, sample: Sample) -> Taken:
    begin = time.perf_counter()
    sample.tell(family.name, 0.0)
    findings = family.take(sample)
    sample.tell(family.name, 1.0)
    return Taken(findings, time.perf_counter() - begin)


def _follow(futures: Sequence[Future[Taken]], relay: _Relay, tell: Progress | None) -> None:
    """Tell what threads tell until all have ended; raise what the first to fail raised."""
    for future in futures:
        future.add_done_callback(relay.told.put)
    left = len(futures)
    while left:
        said = relay.told.get()
        if isinstance(said, Future):
            said.result()
            left -= 1
        elif tell is not None:
            tell(*said)
