"""`porous make --out-of-core` and `porous resume` as a small job that faults befall."""

import random
import shutil
import subprocess
import sys
from contextlib import suppress
from functools import partial
from pathlib import Path
from unittest.mock import patch

from faults import Case, bare, contents, flip, mounted

from porous import disk, workspace
from porous.errors import DiskError, FormatError, RecipeError
from porous.recipe import load
from porous.scale import Store
from porous.scale.sealed import unseal
from porous.scale.tally import Tally, _told

SETTINGS = {"model.level": 1, "voxels.voxels": 9, "surface.method": "marching-cubes"}
CHUNK = 5
TIMES = ("log.json", "report.html")
"""Files that tell how long it took."""


def lasting(folder):
    return {name: data for name, data in contents(folder).items() if name not in TIMES}


def rotted(data):
    return bytes((*data[:9], data[9] ^ 4, *data[10:]))


def counts_written_down():
    """Have counts written down after every tile, as if they took long."""
    return patch("porous.pipeline._stored.Tally", partial(Tally, every=0.0))


def tells_of_counts(name, data):
    """Return whether a file is one of counts; fail where it is torn."""
    if not name.endswith(".tally"):
        return False
    header = unseal(data[21 : 21 + int(data[:20])])
    done, sums = _told(data, header["of"])
    return done > 0 and len(sums) > 0


class Stop(Exception):
    """Ends a job that has only just begun."""


class MakeCase(Case):
    """A recipe made out of core: its voxels, its surface and its measures."""

    name = "out"
    refusals = DiskError, FormatError, RecipeError  # the last one where recipe.toml is not read
    is_alone = False

    def __init__(self, place):
        self.recipe, self.folder = load("menger", set=SETTINGS), Path(place)
        self.begun = self._unfinished()
        self.go_on(self.folder)
        self.bytes = self.lasting(self.folder)

    def lasting(self, folder):
        return lasting(folder)

    def make(self, folder, **how):
        with counts_written_down():
            return workspace.make_stored(self.recipe, folder, only="measures", chunk=CHUNK, **how)

    def _unfinished(self):
        """Return the bytes that tell what an unfinished folder is of."""

        def stop(*_):
            if (self.folder / workspace.UNFINISHED).exists():
                raise Stop

        try:
            self.make(bare(self.folder), progress=stop)
        except Stop:
            return (self.folder / workspace.UNFINISHED).read_bytes()
        raise AssertionError

    def go_on(self, folder):
        """Resume, or make where nothing is to be resumed, as a user would."""
        try:
            with counts_written_down():
                return workspace.resume(folder)
        except FormatError:
            return self.make(folder)

    def check(self, folder):
        """Return whether a folder is whole; fail where a wrong byte is taken for a right one."""
        try:
            is_whole = workspace.is_whole(folder)
        except FormatError:
            return False
        if is_whole:
            assert self.lasting(folder) == self.bytes
            assert not Store.open(Path(folder) / "grid.zarr").verify()
        return is_whole

    def check_torn(self, folder):
        """Fail where a file that bears its final name is not the one that it should be."""
        may_be = self.may_be()
        for name, data in self.lasting(folder).items():
            right = (self.bytes.get(name), may_be.get(name))
            assert disk.TEMPORARY in name or data in right or tells_of_counts(name, data), name

    def may_be(self):
        """Return what else a file may hold before all is done."""
        return {workspace.UNFINISHED: self.begun}

    def check_resumed(self, folder):
        """Fail where going on from here does not end with the very bytes of an undisturbed run."""
        self.go_on(folder)
        assert self.lasting(folder) == self.bytes
        assert self.check(folder)


class MendCase(MakeCase):
    """A whole folder with two chunks that rotted: `porous resume` mends them."""

    rotten = ("grid.zarr/fill/c.0.1.0", "grid.zarr/fill/c.1.1.1")

    def begin(self, folder):
        folder = Path(folder)
        shutil.copytree(self.folder, bare(folder))
        for name in self.rotten:
            (folder / name).write_bytes(rotted(self.bytes[name]))
        return folder

    def may_be(self):
        return {**super().may_be(), **{name: rotted(self.bytes[name]) for name in self.rotten}}


class UnfinishedCase(MakeCase):
    """A folder whose voxels and surface are whole, and some counts written down."""

    def begin(self, folder):
        folder = Path(folder)

        def stop(*_):
            if self.tallies(folder):
                raise Stop

        with suppress(Stop):
            self.make(bare(folder), progress=stop)
        assert (folder / workspace.UNFINISHED).exists()
        assert self.tallies(folder)
        return folder

    def tallies(self, folder):
        return sorted(path.name for path in folder.glob("counts-*.tally"))


# --- bits that rot -----------------------------------------------------------------------


def flips_of_chunks(case, folder, trials, seed):
    """Flip one bit of a chunk of a made folder: it is whole no more, and resume mends it; a row."""
    random_ = random.Random(seed)
    shutil.copytree(case.folder, bare(folder))
    names = sorted(name for name in case.bytes if "/c." in name)
    mended = 0
    for trial in range(trials):
        name = random_.choice(names)
        bit = random_.randrange(8 * len(case.bytes[name]))
        flip(folder / name, bit)
        assert not case.check(folder), f"bit {bit} of {name} was not noticed"
        if trial % 10 == 0:
            case.check_resumed(folder)
            mended += 1
        else:
            flip(folder / name, bit)
    return {"trials": trials, "mended_by_resume": mended}


NAMES = ("grid.zarr/plan.json", "grid.zarr/zarr.json", "grid.zarr/fill/zarr.json")
MENDED = (*NAMES, "grid.zarr/manifest.json")
"""The small files that resume mends; each by what the others say."""
TOLD = ("recipe.toml", workspace.UNFINISHED)
"""Those that say what is wanted: nobody else knows."""


def flips_of_small(case, folder, *, step=1, first=0):
    """Flip every bit of every small file of a made folder; a row."""
    shutil.copytree(case.folder, bare(folder))
    found = mended = 0
    for name in MENDED:
        for bit in range(first, 8 * len(case.bytes[name]), step):
            flip(folder / name, bit)
            assert not case.check(folder), f"bit {bit} of {name} was not noticed"
            found += 1
            if found % 50 == 1:
                case.check_resumed(folder)
                mended += 1
            else:
                flip(folder / name, bit)
    return {"trials": found, "mended_by_resume": mended}


def flips_of_counts(case, folder, trials, seed):
    """Flip a bit of counts that were written down: they are counted anew, to the same; a row."""
    random_ = random.Random(seed)
    for _ in range(trials):
        case.begin(folder)
        path = folder / random_.choice(case.tallies(folder))
        flip(path, random_.randrange(8 * path.stat().st_size))
        case.check_resumed(folder)
    return {"trials": trials}


def flips_of_told(case, folder, name, *, step=1, first=0):
    """Flip every bit of a file that says what is wanted: refused, unless it still says that.

    Nothing that was done is lost meanwhile: with the bit flipped back, resume goes on.
    """
    case.begin(folder)
    before = contents(folder)
    refused = same = 0
    for bit in range(first, 8 * len(before[name]), step):
        flip(folder / name, bit)
        said = refusal(lambda: workspace.resume(folder), FormatError, RecipeError)
        if said:
            assert str(folder) in said
            assert "\n" not in said
            flip(folder / name, bit)
            assert contents(folder) == before, bit
            refused += 1
        else:
            assert case.lasting(folder) == case.bytes
            case.begin(folder)
            same += 1
    case.check_resumed(folder)
    return {"trials": refused + same, "struck": refused}


def refusal(work, *kinds):
    try:
        work()
    except kinds as error:
        return str(error)
    return ""


# --- small disks -------------------------------------------------------------------------


def porous(*arguments):
    """Run the command line; return exit code and what it says to standard error."""
    command = [sys.executable, "-m", "porous", *map(str, arguments)]
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, timeout=600
    )
    return done.returncode, done.stderr


def made(folder):
    settings = [f"--set={key}={value}" for key, value in SETTINGS.items()]
    how = ("--only", "measures", "--chunk", CHUNK, "--out-of-core", "-o", folder)
    return porous("make", "menger", *settings, *how)


def command_on_small_disks(case, place, sizes):
    """Run `porous make --out-of-core` where a disk of so many kilobytes gets full; a row."""
    disk_, said = Path(place) / "small", []
    disk_.mkdir(exist_ok=True)
    for size in sizes:
        if not mounted(["-o", f"size={size}k"], disk_):
            sys.exit(77)
        folder = disk_ / "out"
        code, text = made(folder)
        complaints = [line for line in text.splitlines() if line.startswith("porous:")]
        assert (code, len(complaints)) == (1, 1), text
        assert text.splitlines()[-1:] == complaints, text
        said += complaints
        case.check_torn(folder)
        assert not case.check(folder)
        assert not list(disk_.rglob(f"{disk.TEMPORARY}*"))
        mounted(["-o", "remount,size=64m"], disk_)
        begun = (folder / workspace.UNFINISHED).exists()
        code, text = porous("resume", folder) if begun else made(folder)
        assert code == 0, text
        assert case.lasting(folder) == case.bytes
        subprocess.run(["umount", disk_], check=True, stdin=subprocess.DEVNULL, timeout=120)
    return {"trials": len(sizes), "said": said}
