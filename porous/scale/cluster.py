"""Tiles over many processes and machines: a function called for each, by workers of Dask.

Dask says what runs where, and runs again what a dead worker had. What it does not promise is ours:
an end to all waiting, a task that is not blamed for its neighbours, results in order, and a bounded
number of them.

Nothing is scattered: scattered data are gone for ever with the workers that held them. A function
travels with every task while its pickle is small. A large one (a model with a mesh in it) is the
*result of a task*: workers get it once each, and where all that had it are dead Dask runs that
task again. Voxels never travel this way; what is too large is refused.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import socket
import threading
import time
import uuid
import warnings
import weakref
from asyncio import CancelledError
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from porous.errors import FormatError, GuestError, PorousError, RecipeError
from porous.guests.dask_host import local_cluster
from porous.scale import tasks
from porous.scale.files import PLAN, SMALL
from porous.scale.sealed import read_file

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

T = TypeVar("T")
R = TypeVar("R")

SIX, HOST = r"\[(?P<six>[\da-fA-F:.]+)\]", r"(?P<host>[\w.-]+)"
REMOTE = re.compile(rf"(tcp|tls)://({SIX}|{HOST}):(?P<port>\d{{1,5}})", re.ASCII)
MOST_LOCAL = 4
"""Processes for each core of this machine, at most: more only take memory."""
LOCAL = re.compile(r"local(:(?P<count>[1-9]\d{0,3}))?", re.ASCII)
CONNECT = 4.0
"""Seconds that a machine has to take our call, and that a scheduler then has to answer it."""
ANSWER = 30.0
"""Seconds that a scheduler which we have reached has for a question: it may be busy."""
HELLO = 1 << 16
"""Bytes that a scheduler says at first, at most."""
STEP = 0.5
"""Seconds between two looks at tasks of which none ends."""
AHEAD = 3
"""Tasks that are sent out at a time, for every thread of the workers."""
DEATHS = 12
"""Deaths of workers that had a task, with no task ended in between, after which it is to blame."""
LARGE = 1 << 18
"""Bytes of a function's pickle above which a worker gets it once, not with every task."""
LARGEST = 1 << 28
"""Bytes of a function's pickle above which it is not sent at all: it holds voxels."""
NOISY = ("distributed", "tornado")
"""Whose logs are not for the user: what they have to say is said by our errors."""
LOST = "the scheduler was lost"
KEPT = "what is done is kept, and `porous resume` goes on with it"


@dataclass(eq=False)
class _Job:
    """One item on its way."""

    item: object
    name: str
    given: tuple[object, ...]
    worker: str | None = None
    tries: int = 0
    deaths: int = 0
    future: Any = field(init=False)
    ended: bool = False
    value: Any = None
    error: Exception | None = None

    def end(self, value: object = None, error: Exception | None = None) -> bool:
        """Keep what came of it, and let Dask forget it."""
        self.ended, self.value, self.error = True, value, error
        self.future.release()
        return True

    def answer(self) -> Any:
        """Return or raise what came of it."""
        if self.error is not None:
            raise self.error
        return self.value


class Cluster:
    """Workers that tiles are given to: a context manager, made by ``connect``.

    Whoever can reach a scheduler of Dask can run anything on its workers, and what they answer is
    unpickled here: use none that you would not trust with your account.
    """

    def __init__(
        self,
        client: Any,
        address: str,
        *,
        patience: float,
        limit: float | None,
    ) -> None:
        self.address = address
        self._client = client
        self._patience = patience
        self._limit = limit
        self._start = time.monotonic()
        self._end: Callable[[], object] = lambda: None

    @classmethod
    def connect(
        cls, address: str, *, patience: float = 300.0, limit: float | None = None
    ) -> Cluster:
        """Reach a scheduler, or start one here; its workers have to run what runs here.

        Parameters
        ----------
        address
            ``tcp://host:port`` (or ``tls://``) of a scheduler of Dask; or ``local``, ``local:3``
            for as many processes of one thread each on this machine, which end with this one; by
            default one for each core.
        patience
            Seconds that may go by without the end of any task.
        limit
            Seconds from now on that everything may take.

        Raises
        ------
        RecipeError
            For an address that is none, or times that are not positive.
        GuestError
            Where nobody answers there, or a worker runs another porous, Python, numpy, numba or
            numcodecs, which might make other bytes.
        PorousError
            Where the extra ``scale`` is not installed.
        """
        check_address(address)
        for name, value in (("patience", patience), ("limit", limit)):
            if value is not None and not value > 0:
                raise RecipeError(f"{name}: got {value}; wanted a positive number of seconds")
        _dask()
        with contextlib.ExitStack() as parts:
            parts.enter_context(_silence())
            client = _client(parts, address)
            made = cls(client, address, patience=patience, limit=limit)
            made._ask(bool, None)
            # Also where it is forgotten: with the object, or with the interpreter.
            made._end = weakref.finalize(made, parts.pop_all().close)
        return made

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Cancel what is under way and let go; a local cluster is gone afterwards."""
        self._end()

    @property
    def workers(self) -> int:
        """How many workers there are now.

        Raises
        ------
        GuestError
            Where the scheduler was lost.
        """
        return len(self._threads())

    def check(self, folder: str | Path) -> None:
        """Check that every worker sees the store in this folder, by the bytes of its plan.

        Workers that come later are not asked: their tasks raise what is wrong.

        Raises
        ------
        FormatError
            Where there is no plan here.
        GuestError
            Where a worker finds none or another one; names the worker.
        """
        path = Path(folder) / PLAN
        try:
            plan = read_file(path, SMALL)
        except FormatError as error:
            raise FormatError(f"{path}: {error}; wanted a store that has been begun") from None
        self._ask(tasks.sees, (path, plan))

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """Call a function for every item, on the workers; yield the results in order.

        A few tasks for each thread are sent out at a time, more of them as results are taken. A
        task may run more than once, where a worker died or was thought dead: what it writes must
        not depend on that. Leaving the iterator cancels what has not begun.

        Parameters
        ----------
        function, items
            Can be pickled, and are small against voxels: they say where these are or how they
            are made.

        Raises
        ------
        GuestError
            Where the scheduler is lost, patience or the limit is at an end, or workers die of an
            item again and again; what is done is kept.
        Exception
            What the function raises, of the first item for which it does.
        """
        name = f"porous-{uuid.uuid4().hex}"
        given = self._sent(function, f"{name}-function")
        rest = enumerate(items)
        jobs: deque[_Job] = deque()
        try:
            while True:
                room = AHEAD * max(1, sum(self._threads().values())) - len(jobs)
                for _, (place, item) in zip(range(room), rest, strict=False):
                    job = _Job(item, f"{name}-{place}", _given(given, item))
                    self._submit(job)
                    jobs.append(job)
                if not jobs:
                    return
                yield self._result(jobs)
                jobs.popleft()
        finally:
            for job in jobs:
                job.future.release()

    def _sent(self, function: Callable[..., Any], name: str) -> object:
        """Return what tasks get for a function: its pickle, or the task that gives it out."""
        size = tasks.packed_size(function)
        if size > LARGEST:
            raise GuestError(
                f"cluster {self.address}: every worker would be sent {size >> 20} MiB, and at most "
                f"{LARGEST >> 20} are: write the voxels to a store that all workers see"
            )
        data = tasks.packed(function)
        if size <= LARGE:
            return data
        with self._reaching(), warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
            return self._client.submit(bytes, data, key=name, pure=False)

    def _submit(self, job: _Job) -> None:
        bound: dict[str, Any] = {}
        if job.worker is not None:
            bound = {"workers": [job.worker], "allow_other_workers": False}
        # What was blamed once stays blamed under that name.
        job.tries += 1
        key = f"{job.name}-{job.tries}"
        with self._reaching():
            job.future = self._client.submit(tasks.call, *job.given, key=key, pure=False, **bound)

    def _ask(self, question: Callable[[Any], object], item: object) -> None:
        """Have every worker answer; raise what one of them raises, naming it."""
        name, given = f"porous-{uuid.uuid4().hex}", _given(tasks.packed(question), item)
        jobs = [_Job(a, f"{name}-{i}", given, worker=a) for i, a in enumerate(self._threads())]
        for job in jobs:
            self._submit(job)
        try:
            for job in jobs:
                self._result([job])
        except PorousError:
            raise
        except Exception as error:  # noqa: BLE001  (whatever a foreign installation says)
            reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
            raise GuestError(
                f"cluster {self.address}: worker {job.item} cannot run porous: {reason}"
            ) from None
        finally:
            for job in jobs:
                job.future.release()

    def _result(self, jobs: Sequence[_Job]) -> Any:
        """Return what the first job comes to; look after the others meanwhile."""
        last = time.monotonic()
        self._check_limit()
        while not jobs[0].ended:
            if self._collect(jobs):
                last = time.monotonic()
                for job in jobs:
                    job.deaths = 0
                continue
            if jobs[0].worker is not None and jobs[0].worker not in self._threads():
                return None  # who is gone has nothing to answer
            self._check_limit()
            self._check_patience(last)
            self._doze(jobs)
        return jobs[0].answer()

    def _collect(self, jobs: Sequence[_Job]) -> int:
        """Return how many jobs have just ended."""
        return sum(self._has_ended(job) for job in jobs if not job.ended)

    def _has_ended(self, job: _Job) -> bool:
        """Return whether a job has just ended; its result is with us then, and safe."""
        match job.future.status:
            case "finished":
                return self._fetch(job)
            case "error":
                return self._hear(job)
            case "cancelled":
                raise self._failure(LOST)
            case _:
                return False

    def _fetch(self, job: _Job) -> bool:
        try:
            return job.end(job.future.result(timeout=min(ANSWER, self._patience)))
        except (TimeoutError, _dask().KilledWorker):  # its worker is gone, or slow: we shall see
            return False
        except (OSError, CancelledError):
            raise self._failure(LOST) from None
        except Exception as error:  # noqa: BLE001  (what cannot be unpickled here)
            return job.end(error=error)

    def _hear(self, job: _Job) -> bool:
        """Take a task's error, or give it out again where only its workers have died."""
        with self._reaching():
            error = job.future.exception(timeout=ANSWER)
            trace = job.future.traceback(timeout=ANSWER)
        if not isinstance(error, _dask().KilledWorker):
            return job.end(error=error.with_traceback(trace))
        job.deaths += error.allowed_failures + 1
        if job.deaths >= DEATHS:
            raise self._failure(
                f"tile {job.item!r}: {job.deaths} workers have died while they had it, one after "
                "the other (too little memory?)"
            )
        self._submit(job)
        return False

    def _doze(self, jobs: Sequence[_Job]) -> None:
        awaited = [job.future for job in jobs if not job.ended]
        with self._client.as_current(), contextlib.suppress(TimeoutError, CancelledError):
            _dask().wait(awaited, timeout=STEP, return_when="FIRST_COMPLETED")

    def _check_limit(self) -> None:
        if self._limit is not None and time.monotonic() - self._start > self._limit:
            raise self._failure(f"its time limit of {self._limit:g} s is over")

    def _check_patience(self, last: float) -> None:
        if time.monotonic() - last > self._patience:
            count = self.workers
            there = f"{count} worker{'s are' if count != 1 else ' is'} there"
            raise self._failure(f"no task has ended for {self._patience:g} s, and {there}")

    def _threads(self) -> dict[str, int]:
        """Return how many threads each worker has, by address."""
        with self._reaching():
            client = self._client
            return dict(client.sync(client.scheduler.ncores, callback_timeout=ANSWER))

    @contextlib.contextmanager
    def _reaching(self) -> Iterator[None]:
        """Make whatever goes wrong between us and the scheduler one error."""
        if self._client.status != "running":
            raise self._failure(LOST)
        try:
            yield
        except (Exception, CancelledError) as error:
            raise self._failure(f"{LOST} ({type(error).__name__})") from error

    def _failure(self, what: str) -> GuestError:
        return GuestError(f"cluster {self.address}: {what}; {KEPT}")


def check_address(address: str) -> None:
    """Raise ``RecipeError`` where this is no address that ``Cluster.connect`` takes."""
    remote = REMOTE.fullmatch(address)
    if remote is not None and not 0 < int(remote["port"]) < 1 << 16:
        raise RecipeError(f"cluster: got {address!r}; wanted a port from 1 to 65535")
    if remote is None and not LOCAL.fullmatch(address):
        raise RecipeError(
            f"cluster: got {address!r}; wanted tcp://host:port of a scheduler of Dask, or local, "
            "or local:4 for as many processes on this machine"
        )
    count = address.partition(":")[2] if remote is None else ""
    if count and int(count) > MOST_LOCAL * (os.cpu_count() or 1):
        raise RecipeError(
            f"cluster: got {address!r}; wanted at most {MOST_LOCAL} processes for each of the "
            f"{os.cpu_count()} cores"
        )


def _dask() -> Any:
    """Return Dask's distributed, which not everybody has."""
    try:
        import distributed
    except ImportError as error:
        raise PorousError(f"a cluster needs more: {error}; pip install 'porous[scale]'") from None
    return distributed


def _given(function: object, item: object) -> tuple[object, ...]:
    return function, tasks.packed(item), tasks.versions()


def _client(parts: contextlib.ExitStack, address: str) -> Any:
    """Return a client of the scheduler at an address; what has to end goes to ``parts``."""
    local = LOCAL.fullmatch(address)
    if local is None:
        _knock(address)
        client = _connected(address, CONNECT)
    else:
        count = int(local["count"] or len(os.sched_getaffinity(0)))
        client = _connected(parts.enter_context(local_cluster(count)), ANSWER)
    parts.callback(_close, client)
    return client


def _knock(address: str) -> None:
    """Raise ``GuestError`` where nobody listens: Dask itself would try again and again."""
    remote = REMOTE.fullmatch(address)
    assert remote is not None
    try:
        with socket.create_connection(
            (remote["six"] or remote["host"], int(remote["port"])), timeout=CONNECT
        ) as line:
            known = address.startswith("tls") or _says_hello(line)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise GuestError(
            f"cluster {address}: cannot be reached: {reason}; is a scheduler of Dask there?"
        ) from None
    if not known:
        raise GuestError(f"cluster {address}: who answers there is no scheduler of Dask")


def _says_hello(line: socket.socket) -> bool:
    """Return whether somebody speaks first, and as Dask does: it tells how it pickles.

    A client of Dask believes every length that it is told, and waits for ever.
    """
    with line.makefile("rb") as said:
        length = int.from_bytes(said.read(8), "little")
        return 0 < length <= HELLO and b"pickle-protocol" in said.read(length)


def _connected(address: str, patience: float) -> Any:
    """Return a client; its making is watched, for it can hang with a scheduler that does."""
    made: list[Any] = []

    def connect() -> None:
        try:
            made.append(_dask().Client(address, timeout=patience, set_as_default=False))
        except Exception as error:  # noqa: BLE001  (whatever a foreign server makes Dask say)
            made.append(error)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of unequal versions: which of them matter we look at
        thread = threading.Thread(target=connect, daemon=True)
        thread.start()
        thread.join(patience + 1)
    if made and not isinstance(made[0], Exception):
        return made[0]
    reason = " ".join(f"{type(made[0]).__name__}: {made[0]}".split())[:200] if made else "silence"
    raise GuestError(
        f"cluster {address}: no scheduler has answered within {patience:g} s ({reason})"
    )


def _close(client: Any) -> None:
    with contextlib.suppress(Exception, CancelledError):
        client.close(timeout=CONNECT)


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Keep Dask from writing to the terminal what our errors say."""
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in NOISY]
    before = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    logging.getLogger("asyncio").addFilter(_is_not_of_dask)  # and stays: it may come late
    try:
        yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)


def _is_not_of_dask(record: logging.LogRecord) -> bool:
    # Where a worker dies as its results are fetched, Dask leaves a coroutine's error unheard.
    return f"{os.sep}distributed{os.sep}" not in record.getMessage()
