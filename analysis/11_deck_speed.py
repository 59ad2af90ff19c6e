"""How fast, and in how much memory, is a mesh of a million voxels written as decks and meshes?

A full cube of 100³ voxels with its named parts is written in every format that takes hexahedra,
each in a process of its own that is given the mesh and does nothing else. In the same run numpy's
``savetxt`` writes the numbers of the deck: nodes and elements with their numbers, coordinates as
the deck has them, and no sets. Seconds are those of the best of some runs, by the wall's clock and
of the cores; ratios are to ``savetxt``, which has its turn before and after all others. Memory is
the most that the process ever held, as the system tells it, and how much that is above what it
held with the mesh alone. Where the environment variable POROUS_SMALL is set, the cube is of 24³
voxels.
"""

import csv
import json
import os
import pickle
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from porous import formats
from porous.jobs import compression, material
from porous.stages import hexahedralize, name_parts
from porous.values import Frame, Job, VolumeMesh, VoxelGrid

RESULTS = Path(os.environ.get("POROUS_RESULTS", Path(__file__).parent / "results"))
SIDE, REPEATS = (24, 1) if os.environ.get("POROUS_SMALL") else (100, 2)
SPACING = (0.1, 0.2, 0.3)
YARDSTICK, DECK = "np.savetxt", ".inp"
MOST_RATIO, MOST_MIB = 2.0, 2048
LIMIT = 300
"""Seconds that one process may take."""


def make(folder):
    """Leave a mesh with its parts, and a job of it, for others to take."""
    frame = Frame((0, 0, 0), SPACING, (SIDE,) * 3)
    grid = VoxelGrid.of_solid(np.ones(frame.shape, bool), frame)
    mesh = name_parts(hexahedralize(grid), frame.box)
    job = compression(mesh, material=material("steel"), pressure=1.0)
    for value in (mesh, job):
        with (folder / type(value).__name__).open("wb") as file:
            pickle.dump(value, file, protocol=5)


def contestants():
    """Return what is written and as what, in turn: the yardstick comes first and last."""
    known = [form for form in formats.formats() if VolumeMesh in form.writes]
    taken = [form.suffix for form in known if not form.shapes or "hex8" in form.shapes]
    decks = [(DECK, Job)] + [(suffix, VolumeMesh) for suffix in taken]
    return [(YARDSTICK, VolumeMesh), *decks]


# --- one process for each ----------------------------------------------------------------------


def savetxt(mesh, path):
    """Write nodes and elements, each with its number, by numpy."""
    with path.open("wb") as file:
        for values, form in ((mesh.points, "%.9e"), (mesh.blocks[0].cells + 1, "%d")):
            numbered = np.column_stack([np.arange(1, len(values) + 1), values])
            line = ["%d", *[form] * values.shape[1]]
            np.savetxt(file, numbered, fmt=line, delimiter=", ")


def peak():
    """Return the most mebibytes that this process has ever held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def alone(suffix, given, folder):
    """Write the value that a file holds, and tell what it took."""
    with Path(given).open("rb") as file:
        value = pickle.load(file)
    before = peak()
    path = Path(folder) / f"cube{suffix if suffix != YARDSTICK else '.txt'}"
    work = savetxt if suffix == YARDSTICK else formats.write
    wall, core = time.perf_counter(), time.process_time()
    work(value, path)
    seconds = time.perf_counter() - wall, time.process_time() - core
    size = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
    load = os.getloadavg()[0]
    told = {"took": seconds, "peak": peak(), "before": before, "size": size, "load": load}
    print(json.dumps(told))


def run(*words):
    """Return what a process of its own told; this one stays small, for its size would be theirs."""
    done = subprocess.run(
        [sys.executable, __file__, *words],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=LIMIT,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:].decode(errors="replace")
    return json.loads(done.stdout or "null")


# --- the table ---------------------------------------------------------------------------------


def measured(place):
    """Return for each contestant what each of its runs told."""
    run("", place)
    told = {who: [] for who in contestants()}
    for _ in range(REPEATS):
        for who in [*told, (YARDSTICK, VolumeMesh)]:
            with tempfile.TemporaryDirectory() as folder:
                told[who].append(run(who[0], place / who[1].__name__, folder))
            print(*who, told[who][-1], file=sys.stderr, flush=True)
    return told


def rows(told):
    least = {
        who: [min(one["took"][clock] for one in runs) for clock in (0, 1)]
        for who, runs in told.items()
    }
    for who, runs in told.items():
        pairs = zip(least[who], least[YARDSTICK, VolumeMesh], strict=True)
        ratio, core_ratio = (mine / theirs for mine, theirs in pairs)
        most = max(one["peak"] for one in runs)
        met = ratio <= MOST_RATIO and most < MOST_MIB
        judged = who[0] == DECK
        yield {
            "format": who[0],
            "written_from": who[1].__name__,
            "elements": SIDE**3,
            "megabytes": f"{runs[0]['size'] / 1e6:.1f}",
            "seconds": f"{least[who][0]:.2f}",
            "core_seconds": f"{least[who][1]:.2f}",
            "ratio_to_savetxt": f"{ratio:.3f}",
            "core_ratio": f"{core_ratio:.3f}",
            "peak_mib": f"{most:.0f}",
            "above_the_mesh_mib": f"{max(one['peak'] - one['before'] for one in runs):.0f}",
            "wanted": f"<= {MOST_RATIO:g} and < {MOST_MIB} MiB" if judged else "",
            "met": ("yes" if met else "no") if judged else "",
            "load_of_the_machine": f"{max(one['load'] for one in runs):.1f}",
        }


def main():
    place = Path(tempfile.mkdtemp())
    try:
        table = list(rows(measured(place)))
    finally:
        shutil.rmtree(place)
    path = RESULTS / f"{Path(__file__).stem}.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(table[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)
    for row in table:
        print(*row.values(), sep="\t")


if __name__ == "__main__":
    if len(sys.argv) == 1:
        main()
    elif sys.argv[1]:
        alone(*sys.argv[1:])
    else:
        make(Path(sys.argv[2]))
