"""How a guest program is run: in its own folder and process group, watched, killed as a group.

Where porous itself is killed the kernel ends the guest with it, on a Linux with ``setpriv``; what
the guest has started in its turn is not.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import tempfile
import time
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import IO, TYPE_CHECKING

from porous.errors import GuestError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    Watch = Callable[[float], None]

STEP = 0.05
"""Seconds between two looks at a guest."""

LINES = 5
"""How many of a guest's last lines an error tells."""

MOST_SAID = 1 << 26
"""Bytes that a guest may print on either stream: a program that asks for input that never comes
can fill a disk with its questions."""


STREAMS = ("guest.out", "guest.err")


@dataclass(frozen=True)
class Finished:
    """What a guest said: its output and its errors, as text."""

    output: str
    errors: str


@contextlib.contextmanager
def workplace() -> Iterator[Path]:
    """Yield a temporary folder that is gone afterwards.

    Raises
    ------
    GuestError
        Where the temporary folder cannot be made or written to.
    """
    try:
        with tempfile.TemporaryDirectory(prefix="porous-", ignore_cleanup_errors=True) as name:
            yield Path(name)
    except OSError as error:
        raise GuestError(f"the temporary folder of a guest failed: {error}") from None


def run(
    command: Sequence[str],
    *,
    name: str,
    folder: Path,
    time_limit: float,
    watch: Watch | None = None,
    environment: Mapping[str, str] | None = None,
    most_said: int | None = None,
) -> Finished:
    """Run a program to its end and return what it said.

    Parameters
    ----------
    command
        Program and arguments; no shell is involved.
    name
        What messages call it.
    folder
        Where it runs and where its output is kept.
    time_limit
        In seconds.
    watch
        Called every few hundredths of a second with the seconds gone by; raising in it ends the
        guest.
    environment
        Variables to set besides those of this process.
    most_said
        Bytes that it may print on its output, and as many on its errors; ``MOST_SAID`` by default.

    Raises
    ------
    GuestError
        Where the program is absent, ends with a code other than zero or by a signal, takes
        longer than ``time_limit`` or prints more than ``most_said``. Whatever ends this call ends
        the guest and all its children.
    """
    out, err = (folder / stream for stream in STREAMS)
    check = partial(_check_said, name, folder, MOST_SAID if most_said is None else most_said)
    with out.open("wb") as output, err.open("wb") as errors:
        process = _start(command, name, folder, (output, errors), environment)
        try:
            code = _wait(process, name, time_limit, watch, check)
        finally:
            _kill_group(process)
    check()
    said = Finished(*(path.read_text(errors="replace") for path in (out, err)))
    if code:
        raise GuestError(f"{name} {_end(code)}{_last_lines(said)}")
    return said


def _start(
    command: Sequence[str],
    name: str,
    folder: Path,
    streams: tuple[IO[bytes], IO[bytes]],
    environment: Mapping[str, str] | None,
) -> subprocess.Popen[bytes]:
    variables = {**os.environ, **(environment or {})}
    program = str(folder / command[0]) if os.sep in command[0] else command[0]
    there = shutil.which(program, path=variables.get("PATH")) is not None
    try:
        return subprocess.Popen(
            [*(_keeper() if there else ()), *command],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=streams[0],
            stderr=streams[1],
            env=variables,
            start_new_session=True,
        )
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise GuestError(f"{name} cannot be started: {command[0]}: {reason}") from None


@cache
def _keeper() -> tuple[str, ...]:
    """Return what stands before a command that the kernel is to end with us, on Linux."""
    # Code of ours between fork and exec could wait for ever for a lock of another thread's.
    found = shutil.which("setpriv")
    bound = (found or "", "--pdeathsig", "KILL", "--")
    try:
        tried = subprocess.run(
            [*bound, "true"], stdin=subprocess.DEVNULL, capture_output=True, timeout=10, check=False
        )
    except (OSError, subprocess.SubprocessError):
        return ()
    return bound if tried.returncode == 0 else ()


def _wait(
    process: subprocess.Popen[bytes],
    name: str,
    time_limit: float,
    watch: Watch | None,
    check: Callable[[], None],
) -> int:
    start = time.monotonic()
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(STEP)
        check()
        gone = time.monotonic() - start
        if gone > time_limit:
            raise GuestError(
                f"{name} was stopped after its time limit of {round(time_limit, 2):g} s; "
                "give it a simpler input or a longer time_limit"
            )
        if watch is not None:
            watch(gone)


def _check_said(name: str, folder: Path, most: int) -> None:
    for stream in STREAMS:
        size = (folder / stream).stat().st_size
        if size > most:
            with (folder / stream).open("rb") as said:
                start = said.read(200).decode(errors="replace").strip().splitlines()
            raise GuestError(
                f"{name} was stopped: it printed {size} bytes, more than the {most} that a guest "
                f"may; it began with {start[0] if start else ''!r}"
            )


def _kill_group(process: subprocess.Popen[bytes]) -> None:
    # Also after a regular end: a guest may have left children behind.
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _end(code: int) -> str:
    if code > 0:
        return f"failed with exit code {code}"
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"was ended by signal {-code}"


def _last_lines(said: Finished) -> str:
    lines = [line.strip() for line in (said.errors or said.output).splitlines() if line.strip()]
    return "".join(f"\n    {line}" for line in lines[-LINES:])
