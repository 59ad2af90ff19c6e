"""Every reader against files made to harm, mutants, and sentences of its own grammar.

Each gives the right answer, or one line; within two seconds and 64 MiB; and opens nothing else.
``scripts/fuzz`` goes on where this ends, and what it has found lies in ``tests/corpus``.
"""

import subprocess
import sys
import warnings
from pathlib import Path

import fuzz_files
import hostile_files
import pytest
from hypothesis import given, settings
from refusals import refuse
from test_hostile import BYTES, SECONDS, attempt

from porous import formats
from porous.errors import FormatError, FormatWarning
from porous.kernels.lzw import lzw, packbits

CORPUS = Path(__file__).parent / "corpus"
READERS = {form.read: form for form in reversed(formats.formats()) if form.read}
READERS = {form.suffix: form for form in READERS.values()}
"""The first suffix of each reader; ``.msh2`` shares that of ``.msh``."""
HOSTILE = hostile_files.hostile()

# --- the ten classes ---------------------------------------------------------------------------

CLASSES = {
    ".frd": """
        R nodes 1e11
        R nodes -8
        R values 1e11
        R a node that is not there
        R a node twice
        A values of nodes that are not there
        R nan
        R commas
        R two in a column
        R a type unknown
        R an element of many lines
        R components 1e4
        R a binary file
        R no end of a block
        R no end
        R a line of a megabyte
    """,
    ".stl": """
        R count beyond the bytes
        R header only
        R nan
        A solid and binary
        R cut within a facet
        W bytes at the end
        R no facets
        W flat and double facets
        A open
        W as large as the moon
    """,
    ".ply": """
        R count 1e12, binary
        R negative count
        R no end for long
        R index too large
        R index negative
        R list of 2^31
        R order unknown
        R property twice
        A polygons
        R text with nan
        R text with commas
    """,
    ".3mf": """
        R zip bomb
        R billion laughs
        R external entity
        R components in a circle
        R index out of range
        R nan
        R member that leads out
        R member of the root
        R two members of one name
        R no model
        R broken relations
        A unit inch
        A unit micron
    """,
    ".tif": """
        R pages in a circle
        R 2^31 by 2^31
        R 65529 samples
        R a deflate bomb
        R a strip past the end
        R none wide
        R 2^32 - 1 values
        R pages unlike each other
        R images that are not there
        R no directory
    """,
    ".nrrd": """
        R sizes of 1e15
        R a negative size
        R 900 axes
        R a bomb for few voxels
        R short
        R a file elsewhere
        R a file above
        R a link
        R spacing of nan
        R singular
        R skip from the end, packed
        R unknown type
        R unknown order
        R a line of a megabyte
    """,
    ".mhd": """
        R sizes of 1e15
        R a negative size
        R 99 axes
        R short
        R a file elsewhere
        R a link
        R a list of lists
        R spacing of zero
        R spacing of nan
        R packed size too small
        R unknown type
        R no text
    """,
    ".vti": """
        R extent 1e5³
        R extent inverted
        R too few values
        R offset past the end
        R blocks beyond the bytes
        R document type
        R spacing 0
        R pieces that overlap
        R piece with a gap
        R base64 broken
        R floats
    """,
    ".npz": """
        R pickle
        R 80 bytes of 32 GiB
        R header of 4 GiB
        R bomb behind a small array
        A bomb beside the array
        R shape negative
        R records
        A Fortran order
        R no arrays
        R other arrays
        R floats with nan
        R sum wrong
    """,
    ".obj": """
        R index zero
        R index before the first
        R index too large
        R index of 5000 digits
        R two corners
        R nan
        R commas
        R no faces
        R one long line
        R 40000 groups
        R cut short
        A other files
        R not text
    """,
    ".inp": """
        R another file
        R nodes of another file
        R instances
        R nan
        R commas
        R a node twice
        R a node that is not there
        R an element twice
        R an element too long
        R pyramids
        A a card of 1 MB
        R a word of 1 MB
        R a null byte
        A numbers far apart
    """,
    ".msh": """
        R nodes 1e12
        R nodes 2^63, 4.1 binary
        R nodes -8
        R elements 1e18, 4.1 binary
        R a run of 2^31
        R tags 1e9
        R a node twice
        R a node that is not there
        R nan
        R version 3
        R binary of middle order
        R a section twice
        R many sections
        A numbers far apart
    """,
    ".vtu": """
        R points 1e12
        R cells -1
        R node too large
        R node negative
        R offsets that leap
        R offsets that fall
        R points nan
        R types unknown
        R part of 1e15
        R face out of range
        R blocks of 1e18
        R document type
        A a line before
    """,
}
"""At least ten classes for every reader: refused, accepted, or accepted with a warning."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    lzw(b"\x80", 1)  # compiling a kernel is not the file's doing
    packbits(b"\x80", 1)
    place = tmp_path_factory.mktemp("fuzz") / "here"
    place.mkdir()
    (place.parent / "secret.raw").write_bytes(bytes(210))
    (place / "link.raw").symlink_to(place.parent / "secret.raw")
    return place


def lay(folder, files):
    """Write files; return the path of the first, which is the one that is read."""
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder / next(iter(files))


def judged(path):
    """Return what a file holds or why not; it must cost no more than such a file may."""
    outcome, spent, peak = attempt(path)
    assert spent < SECONDS
    assert peak < BYTES + 40 * path.stat().st_size
    return outcome


@pytest.mark.parametrize("suffix", READERS)
def test_every_reader_meets_ten_classes_of_hostile_files(suffix, folder):
    rows = [line.strip().split(" ", 1) for line in CLASSES[suffix].strip().splitlines()]
    assert len({name for _, name in rows}) == len(rows) >= 10
    for verdict, name in rows:
        path = lay(folder, HOSTILE[suffix][name])
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("always")
            try:
                formats.read(path)
                said = "W" if notes else "A"
            except FormatError:
                said = "R"
        assert said == verdict, name
        assert all(issubclass(note.category, FormatWarning) for note in notes)


@pytest.mark.parametrize("suffix", READERS)
def test_the_command_line_refuses_in_one_line(suffix, folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    names = [line.split("R ", 1)[1] for line in CLASSES[suffix].splitlines() if " R " in line]
    for name in names:
        path = lay(folder, HOSTILE[suffix][name])
        form = READERS[suffix].reads
        refuse(folder, capsys, ["convert", path.name, f"out{TARGETS[form.__name__]}"], 2, path.name)
        path.unlink()


TARGETS = {"SurfaceMesh": ".ply", "VoxelGrid": ".npz", "VolumeMesh": ".vtu", "MeshFields": ".vtu"}


@pytest.mark.slow
def test_real_processes_end_with_exit_code_2(tmp_path):
    for suffix in READERS:
        name = next(
            line.split("R ", 1)[1] for line in CLASSES[suffix].splitlines() if " R " in line
        )
        path = lay(tmp_path, {f"{suffix[1:]}{suffix}": next(iter(HOSTILE[suffix][name].values()))})
        argv = [sys.executable, "-m", "porous", "convert", path, tmp_path / "out.vtu"]
        done = subprocess.run(
            argv, capture_output=True, text=True, check=False, timeout=60, stdin=subprocess.DEVNULL
        )
        assert done.returncode == 2, suffix
        assert done.stdout == ""
        (line,) = done.stderr.splitlines()
        assert line.startswith(f"porous: {path}: ")
        path.unlink()
        assert not list(tmp_path.iterdir())


# --- no other file is opened -------------------------------------------------------------------


@pytest.mark.parametrize(
    "suffixes", [[".3mf", ".frd"], pytest.param(list(READERS), marks=pytest.mark.slow)]
)
def test_no_file_is_opened_but_those_that_are_named(tmp_path, suffixes):
    """Fast for those only whose own tests do not show it."""
    (tmp_path / "secret.raw").write_bytes(bytes(210))
    number = 0
    for suffix in suffixes:
        for files in HOSTILE[suffix].values():
            number += 1
            place = tmp_path / "batch" / f"{number:04}"
            place.mkdir(parents=True)
            (place / "link.raw").symlink_to(tmp_path / "secret.raw")
            path = lay(place, files)
            path.rename(path.with_name(f"read{suffix}"))
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", BATCH, tmp_path / "batch"],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        stdin=subprocess.DEVNULL,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert int(done.stdout) >= number


BATCH = """
import os, pathlib, resource, sys, sysconfig
import psutil
from porous import formats
from porous.errors import FormatError
formats.formats()
paths = [next(place.glob("read*")) for place in sorted(pathlib.Path(sys.argv[1]).iterdir())]
if any(path.suffix == ".tif" for path in paths):
    from porous.kernels.lzw import lzw, packbits
    lzw(b"a", 1), packbits(b"a", 1)
opened = []
watched = ("open", "os.exec", "os.posix_spawn", "os.system", "subprocess.Popen", "socket.connect",
           "pickle.find_class", "os.listdir", "os.scandir", "os.remove", "os.rename", "os.mkdir")
def watch(event, arguments):
    if event in watched:
        opened.append((event, arguments[0]))
def all_of_them():
    for path in paths:
        try:
            formats.read(path)
        except FormatError:
            pass
used = psutil.Process().memory_info().vms
resource.setrlimit(resource.RLIMIT_AS, (used + 192 * 2**20,) * 2)
sys.addaudithook(watch)
all_of_them()
opened = [(event, str(name)) for event, name in opened if not isinstance(name, int)]
folders = {str(path.parent) for path in paths}
ours = [name for event, name in opened if event == "open" and name.startswith(sys.argv[1])]
assert all(os.path.dirname(name) in folders and not os.path.islink(name) for name in ours), ours
home = str(pathlib.Path(formats.__file__).parent.parent)
system = ("/proc/", "/sys/fs/cgroup/")  # how much memory there is
modules = (home, sys.prefix, sys.base_prefix, sysconfig.get_path("stdlib"))  # that are loaded late
others = [(event, name) for event, name in opened if not name.startswith(sys.argv[1])]
assert all(name.startswith(system + modules) for _, name in others), others
assert {event for event, _ in opened} <= {"open", "os.listdir", "os.scandir"}, opened
print(len(ours))
"""


# --- what was found, and what is good ----------------------------------------------------------


def corpus(suffix):
    """Return the files that a reader has to do with: good ones, and those that once broke it."""
    ends = tuple(READERS[suffix].suffixes)
    return [path for path in sorted((CORPUS / suffix[1:]).glob("*")) if path.name.endswith(ends)]


@pytest.mark.parametrize("suffix", READERS)
@pytest.mark.usefixtures("folder")
def test_the_corpus_is_read_again(suffix):
    files = corpus(suffix)
    assert len(files) >= 2
    for path in files:
        outcome = judged(path)
        if not path.name.startswith(("found-", "was-")):
            assert not isinstance(outcome, str), path.name


def test_the_corpus_is_small_and_all_of_it_is_read():
    there = [path for path in CORPUS.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in there) < 2**20
    assert {path.parent.name for path in there} == {suffix[1:] for suffix in READERS}


# --- mutants and sentences ---------------------------------------------------------------------

COUNTS = [30, pytest.param(3000, marks=[pytest.mark.slow, pytest.mark.nightly])]
HOMES = {"SurfaceMesh": ".ply", "VoxelGrid": ".npz", "VolumeMesh": ".vtu"}


def tried(folder, suffix, data):
    """Read a file that may be anything; what is read must be a value that can be kept."""
    path = folder / f"it{suffix}"
    path.write_bytes(data or b" ")
    outcome = judged(path)
    home = HOMES.get(type(outcome).__name__)
    if home:
        formats.write(outcome, folder / f"again{home}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FormatWarning)
            assert formats.read(folder / f"again{home}") == outcome
    return outcome


def companions(folder, suffix):
    for path in (CORPUS / suffix[1:]).glob("*raw*"):
        if path.suffix in (".raw", ".zraw", ".gz"):
            (folder / path.name).write_bytes(path.read_bytes())


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("suffix", READERS)
def test_mutants(suffix, count, folder):
    good = [path.read_bytes() for path in corpus(suffix)]
    companions(folder, suffix)

    @settings(max_examples=count, derandomize=count < 1000)
    @given(fuzz_files.mutants(good))
    def run(data):
        tried(folder, suffix, data)

    run()


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("suffix", READERS)
def test_sentences(suffix, count, folder):
    read = []

    @settings(max_examples=count, derandomize=count < 1000)
    @given(fuzz_files.GRAMMARS[suffix])
    def run(data):
        read.append(not isinstance(tried(folder, suffix, data), str))

    run()
    assert 0 < sum(read) < len(read)  # the grammar is that of the format, and not tame
