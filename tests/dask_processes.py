"""A scheduler of Dask and its workers as processes of their own, and what they are given to do."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from porous.errors import DiskError

ROOT = Path(__file__).parent.parent
LIFE = 300
"""Seconds after which a process ends that nobody has killed."""


class Site:
    """A scheduler on loopback and workers that can be killed; a context manager."""

    def __init__(self, folder, workers=2, **environment):
        self.folder = folder
        search = [str(ROOT), str(Path(__file__).parent)]
        self.environment = {**os.environ, "PYTHONPATH": os.pathsep.join(search), **environment}
        self.scheduler = self.start("scheduler", "--port", "0", "--scheduler-file", "dask.json")
        self.workers = []
        try:
            self.address = self.wait_for_address()
            for _ in range(workers):
                self.join()
        except BaseException:
            self.close()
            raise

    def start(self, kind, *arguments):
        command = ["timeout", "--signal=KILL", str(LIFE), sys.executable, "-m"]
        command += [f"distributed.cli.dask_{kind}", *arguments]
        command += ["--host", "127.0.0.1", "--no-dashboard", "--dashboard-address", "127.0.0.1:0"]
        return subprocess.Popen(
            command,
            cwd=self.folder,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def wait_for_address(self):
        for _ in range(600):
            with contextlib.suppress(OSError, ValueError):
                return json.loads((self.folder / "dask.json").read_text())["address"]
            time.sleep(0.05)
        raise AssertionError("no scheduler after 30 s")

    def join(self, **environment):
        """Start one more worker, of one thread."""
        before, self.environment = self.environment, {**self.environment, **environment}
        options = ["--nthreads", "1", "--no-nanny", "--local-directory", str(self.folder)]
        self.workers.append(self.start("worker", self.address, *options))
        self.environment = before
        return self.workers[-1]

    def kill(self, process):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait(10)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        for process in (*self.workers, self.scheduler):
            self.kill(process)


def until(true, seconds=30.0):
    """Wait until something is so."""
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.05)


# --- what workers do -----------------------------------------------------------------------


def write_chunk(store, grid, index, seconds=0.0):
    """Write one chunk of a grid into a store; return its number."""
    start, stop = store.tiles[index]
    box = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
    time.sleep(seconds)
    store.write("fill", index, np.ascontiguousarray(grid.fill[box]))
    return index


def square(number):
    return number * number


def slow_square(number):
    time.sleep(0.15)
    return number * number


def square_and_process(number):
    time.sleep(0.02)
    return number * number, os.getpid()


def note(folder, number):
    """Leave a file that says that this one has begun."""
    Path(folder, str(number)).touch()
    time.sleep(0.2)
    return number


def fail_at(bad, number):
    if number == bad:
        raise DiskError(f"tile {number}: no space left on device")
    return number


def fail_otherwise(number):
    raise KeyError(number)


def time_out(number):
    raise TimeoutError(f"of {number}'s own")


def hang(number):
    time.sleep(3600)
    return number


def die_at(bad, number):
    if number == bad:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def die_so_often(folder, times, number):
    """Kill the process that this runs in, so many times; then be well-behaved."""
    deaths = len(list(Path(folder).iterdir()))
    if number == 2 and deaths < times:
        Path(folder, str(deaths)).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def setting(name):
    return os.environ.get(name)


def parity(array, number):
    """Return what depends on an array that comes along."""
    return int(array[number]), os.getpid()
