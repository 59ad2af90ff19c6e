"""Power cuts: what a disk may keep of what was written, laid out to be read.

After the model of ALICE (Pillai et al., OSDI 2014): bytes are sure after an fsync of their file,
names after one of their folder; of names that are not, any subset may have arrived.
"""

import os
import random
from pathlib import Path

from faults import bare, calls


class Platter:
    """Records what work does to files below a folder, and tells what a power cut leaves of it."""

    def __init__(self, base):
        self.base, self.log = Path(base), []
        self.handles, self.files = {}, {}

    def record(self, work):
        with calls(self._act, below=self.base):
            work()

    def _act(self, _, name, real, args, kwargs):
        if name in ("unlink", "rmdir"):
            args, kwargs = (self._path(*args, **kwargs),), {}
        result = real(*args, **kwargs)
        note = getattr(self, f"_{name}", None)
        if note is not None:
            note(result, *args, **kwargs)
        return result

    def _path(self, name, *, dir_fd=None):
        return Path(name) if dir_fd is None else self.handles[dir_fd] / name

    def _open(self, handle, path, flags=0, *_, dir_fd=None):
        self.handles[handle] = self._path(path, dir_fd=dir_fd)
        if flags & os.O_CREAT:
            self.files[Path(path)] = len(self.log)
            self.log.append(("create", Path(path), len(self.log)))

    def _write(self, count, handle, data):
        self.log.append(("write", self.files[self.handles[handle]], bytes(data[:count])))

    def _fsync(self, _, handle):
        path = self.handles[handle]
        self.log.append(("sync", self.files[path]) if path in self.files else ("settle", path))

    def _replace(self, _, old, new):
        self.files[Path(new)] = self.files.pop(Path(old))
        file = self.files[Path(new)]
        if Path(old).parent == Path(new).parent:
            self.log.append(("rename", Path(old), Path(new), file))
        else:  # an entry of each folder changes: either may arrive without the other
            self.log += [("link", Path(new), file), ("unlink", Path(old))]

    def _unlink(self, _, path):
        self.log.append(("unlink", Path(path)))

    _rmdir = _unlink

    def _mkdir(self, _, path, *__):
        self.log.append(("mkdir", Path(path)))

    def after(self, number, random_, target):
        """Lay out in ``target`` what is left where the power goes after ``number`` steps."""
        left = Remains()
        for step in self.log[:number]:
            getattr(left, step[0], left.change)(*step)
        left.arrive(random_)
        left.lay(self.base, Path(target), random_)


class Remains:
    """What is sure, and what is on its way."""

    def __init__(self):
        self.names, self.pending = {}, {}
        self.data, self.synced = {}, {}

    def create(self, kind, path, file):
        self.data[file], self.synced[file] = b"", 0
        self.change(kind, path, file)

    def write(self, _, file, data):
        self.data[file] += data

    def sync(self, _, file):
        self.synced[file] = len(self.data[file])

    def settle(self, _, folder):
        for step in self.pending.pop(folder, []):
            self.enter(*step)

    def change(self, *step):
        self.pending.setdefault(step[1].parent, []).append(step)

    def arrive(self, random_):
        """Let some of the changes to each folder arrive: none, all, the first ones or any."""
        for steps in self.pending.values():
            first, any_ = (
                random_.randint(0, len(steps)),
                [s for s in steps if random_.random() < 0.5],
            )
            for step in random_.choice([[], steps, steps[:first], any_]):
                self.enter(*step)

    def enter(self, kind, path, *rest):
        entries = self.names.setdefault(path.parent, {})
        if kind in ("create", "link", "mkdir"):
            entries[path.name] = rest[0] if rest else None
            return
        entries.pop(path.name, None)
        if kind == "rename":
            entries[rest[0].name] = rest[1]

    def lay(self, folder, target, random_):
        target.mkdir()
        for name, file in self.names.get(folder, {}).items():
            if file is None:
                self.lay(folder / name, target / name, random_)
            else:
                (target / name).write_bytes(self.kept(file, random_))

    def kept(self, file, random_):
        """Return what is left of a file: what was synced, then less of it, or zeros instead."""
        data, sure = self.data[file], self.synced[file]
        tail = random_.randint(0, len(data) - sure)
        return data[:sure] + bytes(tail) if random_.random() < 0.5 else data[: sure + tail]


def power_cuts(case, base, trials, seed, *, step=1):
    """Cut the power after every step of the job, in several ways each; return a row."""
    random_ = random.Random(seed)
    first, second = Path(base) / "first", Path(base) / "second"
    bare(first).mkdir()
    platter = Platter(first)
    platter.record(lambda: case.go_on(first / case.name))
    whole = total = 0
    for number in range(0, len(platter.log) + 1, step):
        for _ in range(trials):
            platter.after(number, random_, bare(second))
            (second / case.name).mkdir(exist_ok=True)
            case.check_torn(second / case.name)
            whole += case.check(second / case.name)
            case.check_resumed(second / case.name)
            total += 1
    for _ in range(9 * trials):  # what was declared whole stays whole
        platter.after(len(platter.log), random_, bare(second))
        assert case.check(second / case.name)
    return {"trials": total, "struck": total, "read_as_whole": whole}
