"""Guests: what they say is heard, and whatever ends the call ends them and their children."""

import os
import subprocess
import sys
import time

import psutil
import pytest

from porous.errors import Cancelled, GuestError
from porous.guests.process import _keeper, run, workplace


def shell(script, folder, time_limit=20.0, **options):
    command = ["/bin/sh", "-c", script]
    return run(command, name="guest", folder=folder, time_limit=time_limit, **options)


def gone(path):
    """Tell whether the process whose number a file holds has ended, give or take a moment."""
    number = int(path.read_text())
    for _ in range(100):
        if not psutil.pid_exists(number) or psutil.Process(number).status() == "zombie":
            return True
        time.sleep(0.02)
    return False


CHILD = "sleep 60 & echo $! > child; wait"


def wait_for_child(folder):
    def watch(_):
        if (folder / "child").exists() and (folder / "child").read_text().strip():
            raise Cancelled("enough")

    return watch


def test_what_a_guest_says(tmp_path):
    said = shell(
        "echo word; echo oops >&2; pwd; cat; echo $COLOUR", tmp_path, environment={"COLOUR": "red"}
    )
    assert said.output.split() == ["word", str(tmp_path), "red"]
    assert said.errors == "oops\n"


def test_a_guest_that_fails_is_quoted(tmp_path):
    with pytest.raises(GuestError, match=r"guest failed with exit code 3\n(.*\n)*.*second"):
        shell("echo first >&2; echo second >&2; exit 3", tmp_path)
    with pytest.raises(GuestError, match="said on the wrong stream"):
        shell("echo said on the wrong stream; exit 1", tmp_path)


def test_a_signal_is_named(tmp_path):
    with pytest.raises(GuestError, match="SIGSEGV"):
        shell("kill -SEGV $$", tmp_path)


def test_a_missing_program_is_named(tmp_path):
    with pytest.raises(GuestError, match="no-such-program"):
        run(["no-such-program"], name="guest", folder=tmp_path, time_limit=1)


def test_time_is_up_for_the_children_too(tmp_path):
    begin = time.monotonic()
    with pytest.raises(GuestError, match=r"time limit of 0\.5 s"):
        shell(CHILD, tmp_path, time_limit=0.5)
    assert time.monotonic() - begin < 10
    assert gone(tmp_path / "child")


def test_cancelling_ends_the_children_too(tmp_path):
    with pytest.raises(Cancelled):
        shell(CHILD, tmp_path, watch=wait_for_child(tmp_path))
    assert gone(tmp_path / "child")


def test_an_interrupt_ends_the_children_too(tmp_path):
    def interrupt(_):
        if (tmp_path / "child").exists() and (tmp_path / "child").read_text().strip():
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        shell(CHILD, tmp_path, watch=interrupt)
    assert gone(tmp_path / "child")


def test_a_guest_has_a_group_of_its_own(tmp_path):
    said = shell("ps -o pgid= -p $$ || cut -d' ' -f5 /proc/$$/stat", tmp_path)
    assert int(said.output.split()[-1]) != os.getpgrp()


def test_a_workplace_is_gone_afterwards():
    with workplace() as folder:
        (folder / "file").write_text("x")
    assert not folder.exists()
    with pytest.raises(GuestError, match="disk full"), workplace() as folder:
        raise OSError("disk full")
    assert not folder.exists()


def test_a_workplace_that_cannot_be(monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", "/no/such/folder")
    with pytest.raises(GuestError, match="temporary folder"), workplace():
        pass


def test_a_guest_that_never_stops_talking_is_stopped(tmp_path):
    begin = time.monotonic()
    with pytest.raises(GuestError, match=r"more than the 100000 that a guest may.*'word'"):
        shell("yes word", tmp_path, most_said=100_000)
    with pytest.raises(GuestError, match="more than the 100000"):
        shell(f"{CHILD} & yes oops >&2", tmp_path, most_said=100_000)
    assert time.monotonic() - begin < 10
    assert gone(tmp_path / "child")


def test_what_was_said_before_the_end_counts(tmp_path):
    with pytest.raises(GuestError, match="printed 3000 bytes, more than the 2000"):
        shell("head -c 3000 /dev/zero", tmp_path, most_said=2000)
    assert len(shell("head -c 2000 /dev/zero", tmp_path, most_said=2000).output) == 2000


KILLED = """
import sys
from pathlib import Path
from porous.guests.process import run
run(["/bin/sh", "-c", "echo $$ > child; exec sleep 60"], name="g", folder=Path(sys.argv[1]),
    time_limit=60)
"""


@pytest.mark.skipif(not _keeper(), reason="only setpriv binds a guest to us")
def test_a_guest_dies_with_who_was_killed(tmp_path):
    porous = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path)], stdin=subprocess.DEVNULL
    )
    try:
        for _ in range(500):
            if (tmp_path / "child").exists() and (tmp_path / "child").read_text().strip():
                break
            time.sleep(0.02)
    finally:
        porous.kill()
        porous.wait()
    assert gone(tmp_path / "child")


def test_a_program_beside_the_guest_is_found_and_a_broken_one_named(tmp_path):
    (tmp_path / "own").write_text("#!/bin/sh\necho here\n")
    with pytest.raises(GuestError, match=r"\./own: permission denied"):
        run(["./own"], name="guest", folder=tmp_path, time_limit=10)
    (tmp_path / "own").chmod(0o755)
    said = run(["./own"], name="guest", folder=tmp_path, time_limit=10)
    assert said.output == "here\n"
