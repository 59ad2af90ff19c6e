"""The disk fails at its N-th call, for every N; it is full; the user presses Ctrl-C."""

import errno
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from porous import disk
from porous.errors import DiskError, FormatError

CALLS = ("open", "write", "fsync", "close", "replace", "stat", "mkdir")
WRITING = ["stat", "open", *["write"] * 3, "fsync", "close", "replace", "open", "fsync", "close"]
OLD, NEW = b"old " * 1000, b"new!" * 5000
CHUNKS = (NEW[:7], NEW[7:9000], b"", NEW[9000:])


class Faults:
    """Makes the N-th of the calls to the operating system fail, or all from the N-th on."""

    def __init__(self, monkeypatch, number, error, *, persistent=False, after=False):
        self.number, self.error = number, error
        self.persistent, self.after = persistent, after
        self.count, self.fired = 0, []
        for name in CALLS:
            monkeypatch.setattr(os, name, self.failing(name, getattr(os, name)))

    def failing(self, name, real):
        def call(*args, **kwargs):
            if sys._getframe(1).f_globals["__name__"] == "shutil":  # sweeping after a failure
                return real(*args, **kwargs)
            self.count += 1
            hit = self.count >= self.number if self.persistent else self.count == self.number
            if not hit:
                return real(*args, **kwargs)
            self.fired.append(name)
            if self.after or name == "close":  # a close that fails has closed all the same
                result = real(*args, **kwargs)
                if name == "open":
                    os.closerange(result, result + 1)
            raise self.error

        return call


def failing_until_clean(work, check, error, **how):
    """Run ``work`` with its first, second, … call failing; return the calls' names in order."""
    names = []
    for number in range(1, 100):
        raised = None
        with pytest.MonkeyPatch.context() as monkeypatch:
            faults = Faults(monkeypatch, number, error, **how)
            try:
                work()
            except (OSError, DiskError, KeyboardInterrupt) as caught:
                raised = caught
        if not faults.fired:
            assert raised is None
            return names
        names.append(faults.fired[0])
        check(raised, names)
    raise AssertionError("a failure was met a hundred times over")


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def os_error(code):
    return OSError(getattr(errno, code), os.strerror(getattr(errno, code)))


@pytest.fixture
def target(tmp_path):
    path = tmp_path / "grid.vti"
    path.write_bytes(OLD)
    return path


@pytest.mark.parametrize("persistent", [False, True])
@pytest.mark.parametrize("code", ["ENOSPC", "EIO", "EDQUOT", "EMFILE", "EROFS"])
def test_an_error_at_any_call_leaves_the_old_file(target, code, persistent):
    def check(raised, names):
        assert isinstance(raised, DiskError)
        assert str(raised).startswith(f"{target}: cannot be written: ")
        assert "\n" not in str(raised)
        assert names_in(target.parent) == [target.name]
        # Once the new file is in its place only its folder can fail to be made durable.
        assert target.read_bytes() == (NEW if "replace" in names[:-1] else OLD)
        target.write_bytes(OLD)

    def work():
        disk.write_bytes(target, iter(CHUNKS))

    names = failing_until_clean(work, check, os_error(code), persistent=persistent)
    assert names == WRITING
    assert target.read_bytes() == NEW


@pytest.mark.parametrize("after", [False, True])
def test_ctrl_c_at_any_call_leaves_nothing_behind(target, after):
    def check(raised, _):
        assert isinstance(raised, KeyboardInterrupt)
        assert names_in(target.parent) == [target.name]
        assert target.read_bytes() in (OLD, NEW)

    def work():
        disk.write_bytes(target, iter(CHUNKS))

    assert failing_until_clean(work, check, KeyboardInterrupt(), after=after) == WRITING
    assert target.read_bytes() == NEW


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, ValueError, DiskError])
def test_whatever_the_chunks_raise_comes_through_and_leaves_the_old_file(target, error):
    def chunks():
        yield NEW[:100]
        raise error("halfway")

    with pytest.raises(error, match="halfway"):
        disk.write_bytes(target, chunks())
    assert names_in(target.parent) == [target.name]
    assert target.read_bytes() == OLD


def test_who_makes_the_pieces_is_ended_where_writing_ends(target, monkeypatch):
    ended = []

    def pieces():
        try:
            yield from CHUNKS
        finally:
            ended.append(True)

    def full(*_):
        raise OSError(errno.ENOSPC, "no room")

    monkeypatch.setattr(os, "write", full)
    kept = pieces()
    with pytest.raises(DiskError):
        disk.write_bytes(target, kept)
    assert ended


def test_short_writes_are_gone_on_with(target, monkeypatch):
    real = os.write
    monkeypatch.setattr(os, "write", lambda handle, data: real(handle, bytes(data[:1234])))
    disk.write_bytes(target, NEW)
    assert target.read_bytes() == NEW


@pytest.mark.parametrize("code", ["EINVAL", "ENOTSUP"])
def test_folders_that_cannot_be_synced_are_no_failure(target, monkeypatch, code):
    real = os.fsync

    def fsync(handle):
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise os_error(code)
        real(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    disk.write_bytes(target, NEW)
    assert target.read_bytes() == NEW


def test_a_folder_that_cannot_be_made_leaves_no_parents(tmp_path):
    folder = tmp_path / "a" / "b" / "c"

    def check(raised, _):
        assert isinstance(raised, DiskError)
        assert str(raised).startswith(f"{folder}: cannot be written to: ")
        assert names_in(tmp_path) == []

    names = failing_until_clean(lambda: disk.make_folder(folder), check, os_error("EIO"))
    assert names.count("mkdir") == 3
    assert folder.is_dir()
    assert names_in(folder) == []


def test_making_a_folder_that_is_there_changes_nothing(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    assert disk.make_folder(tmp_path) == tmp_path
    assert names_in(tmp_path) == ["mine.txt"]


@pytest.mark.parametrize("place", ["/proc/porous/out", "/dev/null/out", "file.txt/out", "a\0b"])
def test_folders_that_cannot_be(tmp_path, monkeypatch, place):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file.txt").write_text("")
    with pytest.raises(DiskError, match="cannot be written to"):
        disk.make_folder(place)
    assert names_in(tmp_path) == ["file.txt"]


def test_devices_pipes_and_folders_are_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for place in (Path("/dev/null"), Path("/dev/full"), tmp_path / "pipe", tmp_path / "folder"):
        before = place.stat().st_mode
        with pytest.raises(DiskError, match="not a file"):
            disk.write_bytes(place, NEW)
        assert place.stat().st_mode == before
    assert names_in(tmp_path) == ["folder", "pipe"]


def test_a_folder_staged_and_committed_fails_at_every_call_without_a_trace(tmp_path):
    out = tmp_path / "a" / "out"
    work = {"grid.vti": OLD, "measures.json": NEW}

    def make():
        with disk.staging(out) as stage:
            for name, data in work.items():
                disk.write_bytes(stage / name, data)
            disk.commit(stage, out, last="measures.json")

    def check(raised, names):
        there = [n for n in names_in(out) if n in work] if out.exists() else []
        if raised is None:  # nothing was written through the handle of the lock
            assert (names[-1], there) == ("close", sorted(work))
        else:
            assert isinstance(raised, DiskError)
            assert disk.TEMPORARY not in str(raised)
        # The file that says "whole" comes last, and nothing comes before the commit.
        assert "measures.json" not in there or there == sorted(work)
        assert not there or names.count("replace") > len(work)
        assert names_in(tmp_path) == (["a"] if there else [])
        shutil.rmtree(tmp_path / "a", ignore_errors=True)

    names = failing_until_clean(make, check, os_error("EIO"))
    assert {"open", "write", "fsync", "close", "replace", "mkdir"} <= set(names)
    assert {name: (out / name).read_bytes() for name in names_in(out)} == work


STAGED = """
import sys, time
from porous import disk
with disk.staging(sys.argv[1]) as stage:
    disk.write_bytes(stage / "half", b"done")
    print(stage.name, flush=True)
    time.sleep(60)
"""


def test_stages_of_the_killed_go_and_those_of_the_living_stay(tmp_path):
    kept = [tmp_path / ".porous-mine", tmp_path / f".porous-{'0' * 16}"]
    kept[0].mkdir()
    kept[1].write_text("no folder")
    command = [sys.executable, "-c", STAGED, str(tmp_path)]
    other = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)
    try:
        assert other.stdout is not None
        name = other.stdout.readline().strip()
        with disk.staging(tmp_path) as first, disk.staging(tmp_path) as second:
            assert {path.name for path in tmp_path.iterdir()} == {
                *(path.name for path in kept),
                name,
                first.name,
                second.name,
            }
    finally:
        other.kill()
        other.communicate()
    assert (tmp_path / name / "half").read_bytes() == b"done"
    with disk.staging(tmp_path) as stage:
        assert set(tmp_path.iterdir()) == {*kept, stage}
    assert set(tmp_path.iterdir()) == set(kept)


def test_nobody_hears_of_the_hidden_folder(tmp_path):
    with pytest.raises(FormatError) as caught, disk.staging(tmp_path) as stage:
        raise FormatError(f"{stage / 'hexes.k'}: cannot be")
    assert str(caught.value) == f"{tmp_path / 'hexes.k'}: cannot be"


@pytest.mark.parametrize("name", ["no/such/folder/x.vti", "a\0b.vti", "x" * 300, "/proc/x.vti"])
def test_names_that_cannot_be(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DiskError, match="cannot be written"):
        disk.write_bytes(name, NEW)
    assert names_in(tmp_path) == []


def test_the_longest_name_there_is(tmp_path):
    target = tmp_path / ("x" * 251 + ".vti")
    disk.write_bytes(target, NEW)
    assert target.read_bytes() == NEW


def test_links_are_followed(tmp_path, target):
    link = tmp_path / "link.vti"
    link.symlink_to(target.name)
    disk.write_bytes(link, NEW)
    assert link.is_symlink()
    assert target.read_bytes() == NEW
    link.unlink()
    link.symlink_to("not-there-yet.vti")
    disk.write_bytes(link, NEW)
    assert (tmp_path / "not-there-yet.vti").read_bytes() == NEW


def test_a_loop_of_links_is_refused(tmp_path):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(DiskError, match="cannot be written"):
        disk.write_bytes(tmp_path / "a", NEW)
    assert names_in(tmp_path) == ["a", "b"]


@pytest.mark.parametrize("mask", [0o022, 0o077])
def test_files_have_the_rights_that_the_user_wants(tmp_path, mask):
    before = os.umask(mask)
    try:
        disk.write_bytes(tmp_path / "x", NEW)
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "x").stat().st_mode) == 0o666 & ~mask


def test_removing(tmp_path, target):
    disk.remove(target)
    disk.remove(target)
    assert names_in(tmp_path) == []
    with pytest.raises(DiskError, match="cannot be removed"):
        disk.remove(tmp_path)


FULL = """
import sys, numpy as np, porous.formats as formats
from porous.errors import DiskError
from porous.values import Frame, VoxelGrid
{limit}
rng = np.random.default_rng(0)
fill = rng.integers(0, 256, (40, 50, 60)).astype(np.uint8)  # noise: 120 kB, compressed or not
try:
    formats.write(VoxelGrid(Frame((0, 0, 0), (1, 2, 3), fill.shape), fill), sys.argv[1])
except DiskError as error:
    print(error)
    sys.exit(error.exit_code)
"""


@pytest.mark.parametrize("name", ["grid.vti", "grid.npz"])
def test_a_file_that_outgrows_its_limit(tmp_path, name):
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))"
    target = tmp_path / name
    target.write_bytes(OLD)
    command = [sys.executable, "-c", FULL.format(limit=limit), target]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL, timeout=120
    )
    assert (done.returncode, done.stderr) == (1, "")
    assert done.stdout == f"{target}: cannot be written: file too large (after 20000 bytes)\n"
    assert names_in(tmp_path) == [name]
    assert target.read_bytes() == OLD


SMALL_DISK = """
mount -t tmpfs -o size=64k none "$1" || exit 77
"$2" -c "$3" "$1/grid.vti"
code=$?
ls -A "$1"
exit $code
"""


def test_a_full_disk(tmp_path):
    unshare = shutil.which("unshare")
    if (
        not unshare
        or subprocess.run(
            [unshare, "-m", "true"], check=False, stdin=subprocess.DEVNULL, timeout=120
        ).returncode
    ):
        pytest.skip("this user may not mount a small disk")
    program = FULL.format(limit="")
    command = [unshare, "-m", "sh", "-c", SMALL_DISK, "sh", tmp_path, sys.executable, program]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL, timeout=120
    )
    if done.returncode == 77:
        pytest.skip("this user may not mount a small disk")
    said = f"{tmp_path / 'grid.vti'}: cannot be written: no space left on device"
    assert (done.returncode, done.stderr) == (1, "")
    assert done.stdout == f"{said} (after 65536 bytes)\n"  # and the small disk is empty again
