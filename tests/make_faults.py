"""`porous make --out-of-core` and `porous resume` as a small job that faults befall."""

import shutil
from pathlib import Path

from faults import Case, bare, contents

from porous import disk, workspace
from porous.errors import DiskError, FormatError, RecipeError
from porous.recipe import load
from porous.scale import Store

SETTINGS = {"model.level": 1, "voxels.voxels": 9, "surface.method": "marching-cubes"}
CHUNK = 5
TIMES = ("log.json", "report.html")
"""Files that tell how long it took."""


def lasting(folder):
    return {name: data for name, data in contents(folder).items() if name not in TIMES}


def rotted(data):
    return bytes((*data[:9], data[9] ^ 4, *data[10:]))


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
            assert disk.TEMPORARY in name or data in right, name

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
        shutil.copytree(self.folder, bare(folder))
        for name in self.rotten:
            (folder / name).write_bytes(rotted(self.bytes[name]))
        return folder

    def may_be(self):
        return {**super().may_be(), **{name: rotted(self.bytes[name]) for name in self.rotten}}
