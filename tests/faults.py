"""Deaths, failing disks and rotten bits, made to order; what must hold after each of them.

The tests run a short version of what ``analysis/07_store_faults.py`` runs in full.
"""

import errno
import fcntl
import io
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np

from porous import disk
from porous.errors import DiskError, FormatError, PorousError
from porous.formats import formats, write
from porous.scale import Store
from porous.stages import stream_surface
from porous.stages._stream_surface import WRITERS
from porous.values import (
    BeamLattice,
    Block,
    Field,
    Frame,
    Held,
    Job,
    Material,
    MeshFields,
    Part,
    Pressed,
    Step,
    SurfaceMesh,
    VolumeMesh,
    VoxelGrid,
    VoxelMaps,
)

RECIPE = "0123456789abcdef" * 4
CALLS = (
    *("open", "read", "write", "fsync", "close", "replace", "unlink", "mkdir", "rmdir"),
    *("stat", "lstat", "fstat", "scandir", "listdir"),
    *("io.open", "fcntl.flock"),
)
MODULES = {"os": os, "io": io, "fcntl": fcntl}
HOMES = {name: (MODULES[("os." + name).split(".")[-2]], name.split(".")[-1]) for name in CALLS}
"""Module and name of each call; those of ``os`` go without it."""
REAL = {name: getattr(*HOMES[name]) for name in CALLS}


class Case:
    """A small job: the voxels that a store is to hold, and the bytes that it then consists of."""

    name = "grid.zarr"
    """What its folder is called."""
    refusals = DiskError, FormatError
    """How it says that it cannot go on."""
    is_alone = True
    """Whether all calls to the disk are its own; else those that have to do with its folder are."""

    def __init__(self, place, shape=(5, 4, 7), chunk=(3, 4, 4), seed=0):
        self.frame = Frame((0, 0, 0), (1.0, 0.5, 0.25), shape)
        self.chunk = chunk
        random_ = np.random.default_rng(seed)
        self.arrays = {name: random_.integers(0, 256, shape).astype(np.uint8) for name in NAMES}
        self.folder = Path(place)
        self.go_on(self.folder)
        self.bytes = contents(self.folder)

    def go_on(self, folder):
        """Do what is left to do, as `porous make` and `porous resume` would."""
        try:
            store = Store.resume(folder, RECIPE, frame=self.frame)
        except FormatError:
            options = {"chunk": self.chunk, "recipe_sha256": RECIPE, "has_bulk": True}
            store = Store.create(folder, self.frame, **options)
        tiles = store.tiles
        for name, index in store.missing():
            store.write(name, index, self.arrays[name][tuple(map(slice, *tiles[index]))])
        return store if store.is_whole else store.commit()

    def begin(self, folder):
        """Put into a folder what the job finds there: nothing."""
        return bare(folder)

    def lasting(self, folder):
        """Return the bytes of all files that the job determines."""
        return contents(folder)

    def calls(self, act, folder):
        """Have ``act`` in the place of every call to the disk of this job."""
        return calls(act, below=None if self.is_alone else folder)

    def check(self, folder):
        """Return whether a store is whole; fail where a wrong byte is taken for a right one."""
        try:
            store = Store.open(folder)
            found = {name: store.read(name, (0, 0, 0), self.frame.shape) for name in NAMES}
        except FormatError:
            return False
        assert all(np.array_equal(found[name], self.arrays[name]) for name in NAMES)
        return True

    def check_torn(self, folder):
        """Fail where a file that bears its final name is not the one that it should be."""
        for name, data in contents(folder).items():
            assert Path(name).name.startswith(disk.TEMPORARY) or data == self.bytes[name], name

    def check_resumed(self, folder):
        """Fail where going on from here does not end with the very bytes of an undisturbed run."""
        self.go_on(folder)
        assert contents(folder) == self.bytes
        assert self.check(folder)


NAMES = ("fill", "bulk")


def contents(folder):
    folder = Path(folder)
    files = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def bare(folder):
    shutil.rmtree(folder, ignore_errors=True)
    return Path(folder)


# --- calls to the operating system -------------------------------------------------------


@contextmanager
def calls(act, names=CALLS, *, below=None):
    """Have ``act(number, name, real, args, kwargs)`` in the place of every call to the disk.

    With ``below`` calls count only that have to do with that folder and what is in it; Python asks
    for files of its own.
    """
    numbers, handles = count(1), set()

    def standing_for(name):
        def call(*args, **kwargs):
            real = REAL[name]
            if below is not None and not _is_below(str(below), handles, args, kwargs):
                return real(*args, **kwargs)
            if name == "close":
                handles.discard(args[0])
            result = act(next(numbers), name, real, args, kwargs)
            if name == "open":
                handles.add(result)
            return result

        return call

    for name in names:
        setattr(*HOMES[name], standing_for(name))
    try:
        yield
    finally:
        for name in names:
            setattr(*HOMES[name], REAL[name])


def _is_below(base, handles, args, kwargs):
    what = args[0] if args else kwargs.get("path")
    if isinstance(what, int) or kwargs.get("dir_fd") is not None:
        return kwargs.get("dir_fd", what) in handles
    return what is not None and f"{os.fsdecode(what)}/".startswith(f"{base}/")


def noting(names):
    """Return an ``act`` that lets every call be and adds its name to a list."""

    def act(_, name, real, args, kwargs):
        names.append(name)
        return real(*args, **kwargs)

    return act


def counted(work, among=CALLS):
    """Return the names of all calls to the disk that ``work`` makes."""
    names = []
    with calls(noting(names), among):
        work()
    return names


def undisturbed(case, folder):
    """Return the names of all calls to the disk that a job makes."""
    names = []
    case.begin(folder)
    with case.calls(noting(names), folder):
        case.go_on(folder)
    return names


def failing(number, code, *, persistent):
    """Return an ``act`` whose N-th call fails, or all from the N-th on."""
    error = OSError(getattr(errno, code), os.strerror(getattr(errno, code)))

    def act(at, name, real, args, kwargs):
        if at < number or (at > number and not persistent):
            return real(*args, **kwargs)
        if name == "close":  # a close that fails has closed all the same
            real(*args, **kwargs)
        raise error

    return act


def short_writes(seed):
    """Return an ``act`` under which every write takes only some of what it is given."""
    random_ = random.Random(seed)

    def act(_, name, real, args, kwargs):
        if name == "write":
            handle, data = args
            args = handle, bytes(data[: random_.randint(1, len(data))])
        return real(*args, **kwargs)

    return act


def dying(number, when):
    """Return an ``act`` that kills the process before, amid or after its N-th call."""

    def act(at, name, real, args, kwargs):
        if at != number:
            return real(*args, **kwargs)
        if when == "amid" and name == "write":
            real(args[0], bytes(args[1][: len(args[1]) // 2]))
        elif when == "after":
            with suppress(OSError):
                real(*args, **kwargs)
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError

    return act


# --- processes ---------------------------------------------------------------------------


def told(code, *, wrapped=()):
    """Return what Python code prints in a process of one thread; None where it says it may not."""
    here = f"import sys, json; sys.path.insert(0, {str(Path(__file__).parent)!r}); import faults"
    done = subprocess.run(
        [*wrapped, sys.executable, "-W", "error", "-c", f"{here}\n{code}"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "POROUS_THREADS": "1"},
        stdin=subprocess.DEVNULL,
        timeout=3600,
    )
    if done.returncode == 77:
        return None
    assert done.returncode == 0, done.stderr
    return done.stdout


def found_of(case, place, work, *, wrapped=()):
    """Return the row that ``work`` gives of a case (its class by name), in a process of its own."""
    module = case.partition(".")[0]
    said = told(
        f"import {module}; case = {case}({str(bare(place))!r}); print(json.dumps({work}))",
        wrapped=wrapped,
    )
    return said and json.loads(said)


# --- deaths ------------------------------------------------------------------------------


def forked(work):
    """Run ``work`` in a child of this process, which must have one thread; return its number."""
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        work()
        code = 0
    finally:
        os._exit(code)


def ended(child):
    """Wait for a child; return whether it was killed."""
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0
    return os.WIFSIGNALED(status)


def kills_at_calls(case, folder, numbers, when):
    """Kill the job at each of these calls to the disk, with a fresh folder each; return a row."""
    killed = whole = 0
    for number in numbers:
        case.begin(folder)

        def work(number=number):
            with case.calls(dying(number, when), folder):
                case.go_on(folder)

        killed += ended(forked(work))
        case.check_torn(folder)
        whole += case.check(folder)
        case.check_resumed(folder)
    return {"trials": len(numbers), "struck": killed, "read_as_whole": whole}


def kills_at_random(case, folder, wanted, seed):
    """Kill the job at random times, and sometimes those who resume it; return a row.

    Goes on until so many children were killed before they had ended.
    """
    random_ = random.Random(seed)
    case.begin(folder)
    start = time.monotonic()
    case.go_on(folder)
    usual = time.monotonic() - start
    case.begin(folder)
    trials = killed = whole = finished = 0
    while killed < wanted:
        trials += 1
        child = forked(lambda: case.go_on(folder))
        time.sleep(random_.uniform(0, 1.2 * usual))
        os.kill(child, signal.SIGKILL)
        killed += ended(child)
        case.check_torn(folder)
        is_whole = case.check(folder)
        whole += is_whole
        if is_whole or random_.random() < 0.5:
            case.check_resumed(folder)
            finished += 1
            case.begin(folder)
    return {"trials": trials, "struck": killed, "read_as_whole": whole, "resumed": finished}


# --- failing disks -----------------------------------------------------------------------


def length(case, folder):
    """Return how many calls to the disk an undisturbed job makes."""
    return len(undisturbed(case, folder))


def faults(case, folder, code, *, persistent, step=1, first=1):
    """Fail at the first, second, … last call of the whole job, or all from there; return a row."""
    numbers = range(first, length(case, folder) + 1, step)
    struck = whole = 0
    for number in numbers:
        case.begin(folder)
        raised = None
        with case.calls(failing(number, code, persistent=persistent), folder):
            try:
                case.go_on(folder)
            except PorousError as error:
                raised = error
        assert raised is None or isinstance(raised, case.refusals), raised
        assert "\n" not in str(raised)
        case.check_torn(folder)
        is_whole = case.check(folder)
        assert is_whole or raised, number
        struck, whole = struck + (raised is not None), whole + is_whole
        case.check_resumed(folder)
    return {"trials": len(numbers), "struck": struck, "read_as_whole": whole}


def faults_of_readers(case, code, *, persistent):
    """Fail at every call of opening and reading a whole store; return a row."""
    number_of_calls = len(counted(lambda: case.check(case.folder)))
    struck = 0
    for number in range(1, number_of_calls + 1):
        with calls(failing(number, code, persistent=persistent)):
            try:
                struck += not case.check(case.folder)
            except DiskError:
                struck += 1
    assert contents(case.folder) == case.bytes
    return {"trials": number_of_calls, "struck": struck}


TETRAHEDRON = np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 5]])
SOLID = np.random.default_rng(0).integers(0, 256, (4, 3, 5)).astype(np.uint8)
MESH = VolumeMesh(
    TETRAHEDRON,
    (Block("tet4", np.array([[0, 1, 2, 3]])),),
    parts={
        "ZMIN": Part("nodes", np.array([0, 1, 2])),
        "TOP": Part("faces", np.array([[0, 2]])),
        "SOLID": Part("cells", np.array([0])),
    },
)
EXAMPLES = {
    VoxelGrid: VoxelGrid(Frame((0, 0, 0), (1, 2, 3), SOLID.shape), SOLID),
    VoxelMaps: VoxelMaps(Frame((0, 0, 0), (1, 2, 3), SOLID.shape), {"pore_diameter": SOLID / 7}),
    SurfaceMesh: SurfaceMesh(TETRAHEDRON, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])),
    VolumeMesh: MESH,
    MeshFields: MeshFields(MESH, (Field("temperature", np.arange(4.0), "K"),)),
    BeamLattice: BeamLattice(TETRAHEDRON, [[0, 1], [3, 2]], [[0.1, 0.2], [0.3, 0.1]]),
    Job: Job(
        "weight",
        MESH,
        {"SOLID": Material("steel", 210e3, 0.3, 7.85e-9)},
        (
            Step(
                "press",
                "static",
                (Held("ZMIN", "displacement", components=(0, 1, 2)),),
                (Pressed("TOP", 1.5),),
            ),
        ),
    ),
}
"""One of each type that there are writers for."""


def example(form, kind):
    """Return what a format is given; a job without its step where there is no writing of it."""
    value = EXAMPLES[kind]
    if kind is Job and "static" not in form.procedures:
        return replace(value, steps=())
    return value


def writers():
    """Return every writer there is: by name, its suffix, a function of a path, and its faults.

    Those that are registered, so that a new format is among them on the day it is registered, and
    those that take a surface piece by piece.
    """
    registered = {
        f"{form.suffix} of a {kind.__name__}": (
            form.suffix,
            partial(write, example(form, kind)),
            faults_of_files if form.write_files else faults_of_writer,
        )
        for form in formats()
        for kind in form.writes
    }
    streamed = {
        f"{suffix}, streamed": (
            suffix,
            partial(stream_surface, EXAMPLES[VoxelGrid]),
            faults_of_writer,
        )
        for suffix in WRITERS
    }
    return registered | streamed


ONE_FILE = ("open", "write", "fsync", "close", "replace")
"""What writing one file asks of the disk; what formats there are is asked of the package."""


def faults_of_writer(write, path, code, *, persistent):
    """Fail at every call of a writer that replaces a file by another; return a row."""
    old = b"what was there before"
    write(path)
    new = path.read_bytes()
    number_of_calls = len(counted(lambda: write(path), ONE_FILE))
    struck = 0
    for number in range(1, number_of_calls + 1):
        path.write_bytes(old)
        raised = None
        with calls(failing(number, code, persistent=persistent), ONE_FILE):
            try:
                write(path)
            except DiskError as error:
                raised = error
        struck += raised is not None
        assert path.read_bytes() == new or (raised and path.read_bytes() == old)
        assert [file.name for file in path.parent.iterdir()] == [path.name]
    with calls(short_writes(number_of_calls), ONE_FILE):
        write(path)
    assert path.read_bytes() == new
    return {"trials": number_of_calls, "struck": struck}


WRITES = ("write", "fsync", "replace", "mkdir")
"""What makes files: engines ask the disk about their own files, and do so in their own way."""


def faults_of_files(write, path, code, *, persistent):
    """Fail at every call of a writer of several files, or of a folder of them; return a row.

    The one of the name that was given is there where all are; a folder is there whole or not.
    """
    place = path.parent
    beside = place / "beside"

    def make(act):
        bare(place).mkdir()
        beside.write_bytes(b"somebody else's")
        with calls(act, WRITES):
            write(path)

    names = []
    make(noting(names))
    new, is_folder = contents(place), path.is_dir()
    struck = 0
    for number in range(1, len(names) + 1):
        raised = None
        try:
            make(failing(number, code, persistent=persistent))
        except DiskError as error:
            raised = error
        found = contents(place)
        assert found == new if path.exists() else raised
        assert path.exists() or not is_folder or list(found) == ["beside"]
        assert found["beside"] == new["beside"]
        assert not [file for file in place.iterdir() if file.name.startswith(disk.TEMPORARY)]
        struck += raised is not None
    return {"trials": len(names), "struck": struck}


def faults_of_folder(make, folder, last, code, *, persistent):
    """Fail at every call that fills a folder; with ``last`` it is whole, else it is not; a row."""
    make(bare(folder))
    whole = set(contents(folder))
    length_ = len(counted(lambda: make(bare(folder)), WRITES))
    struck = 0
    for number in range(1, length_ + 1):
        bare(folder)
        raised = None
        with calls(failing(number, code, persistent=persistent), WRITES):
            try:
                make(folder)
            except DiskError as error:
                raised = error
        names = set(contents(folder))
        assert names == whole if last in names else raised
        assert persistent or not [name for name in names if disk.TEMPORARY in name]
        struck += raised is not None
    return {"trials": length_, "struck": struck}


# --- bits that rot -----------------------------------------------------------------------


def flip(path, bit):
    data = bytearray(path.read_bytes())
    data[bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)


def _refusal(work):
    try:
        work()
    except FormatError as error:
        return str(error)
    return ""


def flips(case, folder, trials, seed, *, of_chunks):
    """Flip one bit anywhere; demand that its file is named, and what is left is read; a row."""
    random_ = random.Random(seed)
    shutil.copytree(case.folder, bare(folder))
    names = sorted(name for name in case.bytes if ("/c." in name) == of_chunks)
    sizes = [len(case.bytes[name]) for name in names]
    found = mended = 0
    for trial in range(trials):
        (name,) = random_.choices(names, sizes)
        bit = random_.randrange(8 * len(case.bytes[name]))
        flip(folder / name, bit)
        if of_chunks:
            found += Store.open(folder).verify() == (name,)
        said = _refusal(lambda: Store.open(folder).read("fill", (0, 0, 0), case.frame.shape))
        said = said or _refusal(
            lambda: Store.open(folder).read("bulk", (0, 0, 0), case.frame.shape)
        )
        assert name in said, f"bit {bit} of {name} was not noticed: {said}"
        found += not of_chunks
        if trial % 10 == 0:
            case.check_resumed(folder)
            mended += 1
        else:
            flip(folder / name, bit)
    return {"trials": trials, "found_and_named": found, "mended_by_resume": mended}


# --- small disks -------------------------------------------------------------------------


def mounted(options, place):
    command = ["mount", "-t", "tmpfs", *options, "none", place]
    return not subprocess.run(
        command, check=False, stdin=subprocess.DEVNULL, timeout=120
    ).returncode


def small_disks(case, place, sizes):
    """Fill up disks of these many kilobytes, then make them larger and go on; return a row."""
    disk_, struck, said = Path(place) / "small", 0, []
    disk_.mkdir(exist_ok=True)
    for size in sizes:
        if not mounted(["-o", f"size={size}k"], disk_):
            sys.exit(77)
        folder = disk_ / case.name
        raised = None
        try:
            case.go_on(folder)
        except DiskError as error:
            raised = error
            said.append(str(error))
        assert not list(disk_.rglob(f"{disk.TEMPORARY}*"))
        if folder.exists():
            case.check_torn(folder)
        assert case.check(folder) == (raised is None)
        struck += raised is not None
        mounted(["-o", "remount,size=64m"], disk_)
        case.check_resumed(folder)
        subprocess.run(["umount", disk_], check=True, stdin=subprocess.DEVNULL, timeout=120)
    return {"trials": len(sizes), "struck": struck, "said": said}


def room():
    """Return the command that gives a process disks of its own to mount; None where not allowed."""
    unshare = shutil.which("unshare")
    if (
        not unshare
        or subprocess.run(
            [unshare, "-m", "true"], check=False, stdin=subprocess.DEVNULL, timeout=120
        ).returncode
    ):
        return None
    return (unshare, "-m")
