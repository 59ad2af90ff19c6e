"""What deaths, failing disks, rotten bits and power cuts do to a store, and to all that writes.

Each row tells an experiment: how many trials, in how many of them the fault struck (a work may end
before it, or not depend on what failed), what was demanded after every single one of them, and in
how many it did not hold. One that does not hold ends the study with an error. The store is
small, so that every call to the disk can fail once; its code is that of large ones. "make" is
``porous make --out-of-core`` of a Menger sponge, resumed where it was begun: voxels, surface and
measures; "mend" is ``porous resume`` where two chunks have rotted. The last rows tell what chunks
cost.

``POROUS_STEP=25`` takes every 25th call, bit and trial of these two only.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # children are forked, which threads do not like
os.environ["POROUS_THREADS"] = "1"  # and calls are counted, which threads would make in any order

import csv
import json
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))

import faults  # noqa: E402
import make_faults  # noqa: E402
import numpy as np  # noqa: E402
from power import power_cuts  # noqa: E402

from porous import disk  # noqa: E402
from porous.scale import Store, StoredGrid  # noqa: E402
from porous.values import Frame  # noqa: E402

STEP = int(os.environ.get("POROUS_STEP", "1"))
RESULTS = Path(os.environ.get("POROUS_RESULTS", HERE / "results"))
MEMORY = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
NOTHING = "no torn file; refused or right; resumed to the same bytes"
ERRORS = (("ENOSPC", True), ("EIO", False), ("EIO", True), ("EMFILE", False), ("EROFS", True))


def row(experiment, demanded, found, *, note=""):
    return {
        "experiment": experiment,
        "trials": found["trials"],
        "struck": found.get("struck", found["trials"]),
        "demanded": demanded,
        "did_not_hold": 0,
        "note": note,
    }


def deaths(case, folder):
    every = range(1, faults.length(case, folder) + 1)
    for when in ("before", "after"):
        found = faults.kills_at_calls(case, folder, every, when)
        assert found["struck"] == found["trials"]
        yield row(f"killed {when} every call to the disk", NOTHING, found)
    writes = [i for i, name in enumerate(faults.undisturbed(case, folder), 1) if name == "write"]
    found = faults.kills_at_calls(case, folder, writes, "amid")
    yield row("killed amid every write", NOTHING, found)
    yield row("killed at random times", NOTHING, faults.kills_at_random(case, folder, 200, seed=1))


def deaths_of_store(base):
    yield from deaths(faults.Case(base / "case"), base / "grid.zarr")


def deaths_of_make(base):
    case, folder = make_faults.MakeCase(base / "made"), base / "out"
    yield from deaths_of_made(case, folder, "make", ("before", "amid", "after"))
    found = faults.kills_at_random(case, folder, max(1, 200 // STEP), seed=7)
    yield row("make: killed at random times", NOTHING, found)


def mending(base):
    case, folder = make_faults.MendCase(base / "made"), base / "out"
    yield from deaths_of_made(case, folder, "mend", ("before",))
    for code, persistent in ERRORS[2:3]:
        found = faults.faults(case, folder, code, persistent=persistent, step=STEP)
        yield row(f"mend: {code} {way(persistent)}", NOTHING, found)


def failures_of_make(base):
    case, folder = make_faults.MakeCase(base / "made"), base / "out"
    for code, persistent in ERRORS[:3]:
        found = faults.faults(case, folder, code, persistent=persistent, step=STEP)
        yield row(f"make: {code} {way(persistent)}", NOTHING, found)
    for seed in range(20):
        with case.calls(faults.short_writes(seed), folder):
            case.go_on(faults.bare(folder))
        assert case.lasting(folder) == case.bytes
    yield row("make: short writes", "the same bytes", {"trials": 20})


def losses_of_make(base):
    case = make_faults.MakeCase(base / "made")
    found = power_cuts(case, base, trials=2, seed=8, step=STEP)
    yield row("make: power cut after every step", NOTHING, found)
    yield from rot_of_made(case, base)
    yield from full_disks_of_made(base)


def deaths_of_made(case, folder, what, times):
    names = faults.undisturbed(case, folder)
    for when in times:
        among = ("write",) if when == "amid" else names
        numbers = [i for i, name in enumerate(names, 1) if name in among][::STEP]
        found = faults.kills_at_calls(case, folder, numbers, when)
        assert found["struck"] == found["trials"]
        which = "write" if when == "amid" else "call to the disk"
        yield row(f"{what}: killed {when} every {which}", NOTHING, found)


def rot_of_made(case, base):
    folder, demanded = base / "out", "not whole; mended by resuming, to the same bytes"
    found = make_faults.flips_of_chunks(case, folder, 2000 // STEP, seed=9)
    note = f"{found['mended_by_resume']} of them resumed"
    yield row("make: a bit flipped in a chunk", demanded, found, note=note)
    found = make_faults.flips_of_small(case, folder, step=STEP)
    note = f"{found['mended_by_resume']} of them resumed"
    yield row("make: every bit of the store's other files", demanded, found, note=note)
    unfinished = make_faults.UnfinishedCase(base / "unfinished")
    found = make_faults.flips_of_counts(unfinished, folder, max(1, 300 // STEP), seed=10)
    yield row("make: a bit flipped in counts written down", "the same bytes", found)
    for name in make_faults.TOLD:
        found = make_faults.flips_of_told(unfinished, folder, name, step=STEP)
        note = f"{found['trials'] - found['struck']} say the same as before"
        demanded = "refused in one line, nothing lost; or the same bytes"
        yield row(f"make: every bit of {name}, unfinished", demanded, found, note=note)


def full_disks_of_made(base):
    sizes = [8, 16, 24, 40, 56, 72, 88, 100][:: min(STEP, 4)]
    work = f"make_faults.command_on_small_disks(case, {str(base)!r}, {sizes})"
    found = in_a_room("make_faults.MakeCase", base, work)
    note = "by the command line" if found["trials"] else "not allowed to mount"
    yield row("make: disks that get full", f"one line, {NOTHING}", found, note=note)


def in_a_room(case, base, work):
    """Return a row of what needs disks of its own; an empty one where mounting is not allowed."""
    wrapped = faults.room()
    found = wrapped and faults.found_of(case, base / "room", work, wrapped=wrapped)
    return found or {"trials": 0}


def power(case, base):
    found = power_cuts(case, base, trials=10, seed=2)
    yield row("power cut after every step, names and bytes not synced at will", NOTHING, found)


def rot(case, folder):
    found = faults.flips(case, folder, 2000, seed=3, of_chunks=True)
    assert found["found_and_named"] == found["trials"]
    note = f"{found['mended_by_resume']} of them mended by resuming, to the same bytes"
    yield row("a bit flipped in a chunk", "found, the chunk and no other named", found, note=note)
    found = faults.flips(case, folder, 500, seed=4, of_chunks=False)
    assert found["found_and_named"] == found["trials"]
    yield row("a bit flipped in another file of the store", "found, the file named", found)
    yield row("the same, read by zarr-python", "found in chunks", of_zarr(case, folder, 200, 5))


def of_zarr(case, folder, trials, seed):
    """Return a row of flips that zarr-python has to find, which knows no manifest."""
    import zarr

    random = np.random.default_rng(seed)
    names = sorted(name for name in case.bytes if "/c." in name)
    faults.shutil.copytree(case.folder, faults.bare(folder))
    for _ in range(trials):
        name = names[random.integers(len(names))]
        bit = int(random.integers(8 * len(case.bytes[name])))
        faults.flip(folder / name, bit)
        try:
            zarr.open_group(folder, mode="r")[name.partition("/")[0]][:]
            raise AssertionError(f"bit {bit} of {name}")
        except ValueError:
            faults.flip(folder / name, bit)
    return {"trials": trials}


def failing_disks(case, folder):
    for code, persistent in ERRORS:
        found = faults.faults(case, folder, code, persistent=persistent)
        yield row(f"{code} {way(persistent)}, store written", NOTHING, found)
    for code, persistent in ERRORS[1:4]:
        found = faults.faults_of_readers(case, code, persistent=persistent)
        yield row(f"{code} {way(persistent)}, store read", "refused or right", found)
    for seed in range(20):
        faults.bare(folder)
        with faults.calls(faults.short_writes(seed)):
            case.go_on(folder)
        assert faults.contents(folder) == case.bytes
    yield row("short writes, store written", "the same bytes", {"trials": 20})


def way(persistent):
    return "from the N-th call on, every N" if persistent else "at the N-th call, every N"


def small_disks(base):
    sizes = [4, 8, 16, 24, 32, 40, 48, 56]
    found = in_a_room("faults.Case", base, f"faults.small_disks(case, {str(base)!r}, {sizes})")
    note = "" if found["trials"] else "not allowed to mount"
    yield row("disks of 4 to 56 kB", NOTHING, found, note=note)


def writers(base):
    """Every writer of files there is, each by an example of what it takes, and whole folders."""
    import porous as po

    for name, (suffix, write, fail) in faults.writers().items():
        total = {"trials": 0, "struck": 0}
        for code, persistent in ERRORS:
            place = faults.bare(base / "file")
            place.mkdir()
            path = place / f"x{suffix}"
            found = fail(write, path, code, persistent=persistent)
            total = {key: total[key] + found[key] for key in total}
        demanded = "old file or new, whole; short writes the same"
        yield row(f"{len(ERRORS)} errors at every call, {name}", demanded, total)
    recipe = po.load("cantor-dust", set={"model.level": 1, "voxels.voxels": 6})
    for code, persistent in ERRORS[:2]:
        found = faults.faults_of_folder(
            lambda folder: po.make(recipe, folder, only="voxels"),
            base / "made",
            "measures.json",
            code,
            persistent=persistent,
        )
        demanded = "whole where measures.json is, else nothing of it"
        yield row(f"{code} {way(persistent)}, a folder made", demanded, found)


def costs(_):
    """Megabytes of voxels per second of one core; what putting a chunk on the platter adds."""
    chunk, digit = 256, np.array([0, 1, 0])
    menger = cross = np.add.outer(np.add.outer(digit, digit), digit) < 2
    for _ in range(4):
        menger = np.kron(menger, cross)
    menger = np.pad(menger, ((0, 512 - 243), (0, 13), (0, 13)), mode="wrap")
    noise = np.random.default_rng(6).random(menger.shape) < 0.5
    for name, solid in (("Menger sponge", menger), ("noise of 0 and 255", noise)):
        yield from cost_of(name, np.where(solid, np.uint8(255), np.uint8(0)), chunk)


def cost_of(name, fill, chunk):
    frame = Frame((0, 0, 0), (1, 1, 1), fill.shape)
    with tempfile.TemporaryDirectory() as folder:
        store = Store.create(Path(folder) / "x", frame, chunk=chunk, recipe_sha256=faults.RECIPE)
        written, waited = timed(lambda: write_all(store, fill))
        found, _ = timed(store.commit)
        grid = StoredGrid.open(store.folder)
        read, _ = timed(lambda: [grid.store.read("fill", *tile) for tile in grid.tiles])
        size = sum(path.stat().st_size for path in Path(folder).rglob("*/c.*"))
    with tempfile.TemporaryDirectory() as folder:
        store = Store.create(Path(folder) / "x", frame, chunk=chunk, recipe_sha256=faults.RECIPE)
        real, disk.os.fsync = os.fsync, lambda _: None
        try:
            _, careless = timed(lambda: write_all(store, fill))
        finally:
            disk.os.fsync = real
    trials = {"trials": len(store.tiles), "struck": 0}
    mega = fill.size / 1e6
    said = f"{mega / written:.0f} MB/s written, {mega / read:.0f} MB/s read (of one core)"
    yield row(f"speed of chunks of {chunk}³: {name}", "", trials, note=said)
    said = f"{fill.size / size:.0f} to one; committed in {found:.3f} s"
    yield row(f"size of chunks of {chunk}³: {name}", "", trials, note=said)
    price = 1000 * (waited - careless) / len(store.tiles)
    said = f"{price:.0f} ms a chunk" if price > 0 else "lost in the noise"
    said = f"{said}, of {waited:.2f} s in all"
    yield row(f"price of fsync of every chunk: {name}", "", trials, note=said)


def write_all(store, fill):
    for index, (start, stop) in enumerate(store.tiles):
        store.write("fill", index, fill[tuple(map(slice, start, stop))])


def timed(work):
    """Return seconds of the processor and of the clock: the least of three runs, for both."""
    found = []
    for _ in range(3):
        cpu, clock = time.process_time(), time.perf_counter()
        work()
        found.append((time.process_time() - cpu, time.perf_counter() - clock))
    return tuple(map(min, zip(*found, strict=True)))


def losses_of_store(base):
    case, folder = faults.Case(base / "case"), base / "grid.zarr"
    yield from power(case, base)
    yield from rot(case, folder)
    yield from failing_disks(case, folder)
    yield from small_disks(base)
    yield from writers(base)


PARTS = {
    part.__name__: part
    for part in (
        deaths_of_store,
        deaths_of_make,
        failures_of_make,
        mending,
        losses_of_make,
        losses_of_store,
        costs,
    )
}
"""In processes of their own: one that forks must have one thread. Costs alone, at the end."""


def rows_of(part):
    """Return what a part finds, in a process of its own."""
    command = [sys.executable, __file__]
    environment = {**os.environ, "POROUS_PART": part}
    done = subprocess.run(
        command,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        stdin=subprocess.DEVNULL,
        timeout=7200,
    )
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    for found in rows:
        print(" ".join(f"{value}" for value in found.values()), flush=True)
    return rows


def main():
    if part := os.environ.get("POROUS_PART"):
        with tempfile.TemporaryDirectory(dir=MEMORY) as place:
            for found in PARTS[part](Path(place)):
                print(json.dumps(found), flush=True)
        return
    *parts, last = PARTS
    with ThreadPoolExecutor(2) as pool:
        rows = [found for part in pool.map(rows_of, parts) for found in part]
    rows += rows_of(last)
    RESULTS.mkdir(parents=True, exist_ok=True)
    with (RESULTS / f"{Path(__file__).stem}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
