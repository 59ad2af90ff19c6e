"""Dask's scheduler and workers on this machine: a process of its own that never outlives ours.

They are not started from our own process: multiprocessing's *spawn* would run a user's script once
more in every worker. The host waits for the end of its input, which the system closes with
whatever ends us, and takes its whole process group along.
"""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import porous
from porous.errors import GuestError
from porous.guests.process import workplace
from porous.memory import available

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

START = 90.0
"""Seconds that the workers have to come up."""
STEP = 2.0
"""Seconds between two looks for workers that are missing."""
LOST = "6s"
"""After which a worker that was not there is no longer expected."""
LOOPBACK = "127.0.0.1"


@contextlib.contextmanager
def local_cluster(workers: int) -> Iterator[str]:
    """Give the address of a scheduler with worker processes of one thread each, on loopback.

    A worker that dies is replaced. Whoever may use this machine's loopback can reach the scheduler
    while it is there, as with every cluster of Dask.

    Parameters
    ----------
    workers
        How many worker processes.

    Raises
    ------
    GuestError
        Where they do not come up.
    """
    with workplace() as folder:
        with (folder / "host.err").open("wb") as errors:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", __spec__.name, str(workers), str(folder)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                env={**os.environ, **_environment(workers)},
                start_new_session=True,
            )
        try:
            yield _address(process, folder / "host.err")
        finally:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


def _environment(workers: int) -> Mapping[str, str]:
    """Return what workers shall know: one thread, a share of the memory, our modules."""
    here = str(Path(next(iter(porous.__path__))).parent)
    return {
        "POROUS_THREADS": "1",
        "POROUS_MAX_MEMORY": str(max(1, available() // workers)),
        "PYTHONPATH": os.pathsep.join(dict.fromkeys([here, *map(os.path.abspath, sys.path)])),
    }


def _address(process: subprocess.Popen[bytes], errors: Path) -> str:
    """Return the line that the host says when all workers are there."""
    assert process.stdout is not None
    deadline, said = time.monotonic() + START, b""
    while not said.endswith(b"\n"):
        left = max(0.0, deadline - time.monotonic())
        if not select.select([process.stdout], [], [], left)[0]:
            raise GuestError(f"the local cluster did not come up within {START:g} s")
        piece = os.read(process.stdout.fileno(), 4096)
        if not piece:
            lines = errors.read_text(errors="replace").strip().splitlines() or ["nothing was said"]
            raise GuestError(f"the local cluster did not come up: {lines[-1]}")
        said += piece
    return said.decode().strip()


def _serve(workers: int, folder: str) -> None:
    """Be the scheduler, watch over workers, and end with whoever holds our input."""
    import dask
    import distributed

    dask.config.set({"distributed.deploy.lost-worker-timeout": LOST})
    cluster_of: Any = distributed.LocalCluster
    told = os.dup(1)
    os.dup2(2, 1)  # workers inherit this one: what a task prints must not meet a pipe
    try:
        with cluster_of(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host=LOOPBACK,
            dashboard_address=f"{LOOPBACK}:0",
            worker_dashboard_address=f"{LOOPBACK}:0",
            scheduler_kwargs={"dashboard": False},
            memory_limit=0,
            local_directory=folder,
        ) as cluster:
            os.write(told, f"{cluster.scheduler_address}\n".encode())
            while not select.select([0], [], [], STEP)[0]:
                cluster.scale(workers)  # one that was killed as it came up nobody else replaces
            shutil.rmtree(folder, ignore_errors=True)
    finally:
        os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    _serve(int(sys.argv[1]), sys.argv[2])
