"""Do bodies that memory does not hold come out right, killed on the way, below four gibibytes?

Menger's sponge of level 7 at 2187³ voxels against its closed forms, and a grown attractor off any
lattice at 2048³ against its own coarser grids: made out of core by the command line, killed once
while voxels are written and once while they are measured, and resumed. Levels 4 and 5 are made out
of core and in memory and have to give the same rows. Peak memory is that of each process, as the
system tells it. A row that does not hold ends the study with an error.
"""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import porous as po
from porous import workspace

RESULTS = Path(os.environ.get("POROUS_RESULTS", Path(__file__).parent / "results"))
PLACE = os.environ.get("POROUS_LARGE")
"""A folder on a disk with some gigabytes to spare; the temporary one where it is not set."""
MOST = 4096
"""Mebibytes that no process may take."""
GROWN = """
format = 1
title = "Four turned maps of 1/2, grown"
[model]
kind = "ifs"
level = "limit"
offset = 0.03
{maps}
[voxels]
voxels = {voxels}
[surface]
method = "marching-cubes"
"""
TURNS = ((0, 20, (0, 0, 0)), (1, 35, (0.5, 0, 0)), (2, 50, (0, 0.5, 0)), (0, 65, (0, 0, 0.5)))


def row(body, quantity, found, wanted, *, within=0.0, seconds="", peak="", note=""):
    agrees = abs(found - wanted) <= within
    print(f"{body:28} {quantity:34} {found:.9g} {wanted:.9g} ± {within:.2g} {agrees}", flush=True)
    names = (
        "body",
        "quantity",
        "found",
        "wanted",
        "within",
        "agrees",
        "seconds",
        "peak_mib",
        "note",
    )
    values = (body, quantity, found, wanted, within, agrees, seconds, peak, note)
    return dict(zip(names, values, strict=True))


# --- the command line, killed ---------------------------------------------------------------


class Run:
    """What became of one process: seconds, peak mebibytes, exit code; −9 where it was killed."""

    def __init__(self, arguments, until=None):
        command = [sys.executable, "-m", "porous", *map(str, arguments)]
        begin = time.perf_counter()
        child = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True
        )
        if until is not None:
            while child.poll() is None and not until():
                time.sleep(0.2)
            if child.returncode is None:
                os.killpg(child.pid, signal.SIGKILL)
        _, status, usage = os.wait4(child.pid, 0) if child.returncode is None else (0, 0, None)
        self.code = os.waitstatus_to_exitcode(status)
        self.seconds = time.perf_counter() - begin
        self.peak = 0 if usage is None else usage.ru_maxrss / 1024


def killed_twice(recipe, folder):
    """Make a recipe, killed amid its voxels and amid its measures; return the three runs."""
    make = ["make", *recipe, "--out-of-core", "--only", "voxels", "-o", folder]
    limit = ["--max-memory", f"{MOST}M"]
    begin = time.monotonic()

    def amid_voxels():
        return len(list((folder / "grid.zarr/fill").glob("c.*"))) >= 100

    def amid_counts():
        return any(folder.glob("counts-*.tally")) and time.monotonic() > begin + 60

    runs = [Run([*make, *limit], amid_voxels), Run(["resume", folder, *limit], amid_counts)]
    assert [run.code for run in runs] == [-9, -9]
    assert not (folder / workspace.LAST).exists()
    tally = next(iter(folder.glob("counts-*.tally"))).stat()
    runs.append(Run(["resume", folder, *limit]))
    assert runs[-1].code == 0
    assert tally.st_size > 0
    return runs


def measured(folder):
    """Return the best row of each measure of the grid, and those by other methods."""
    record = json.loads((folder / workspace.LAST).read_text())
    return {(row["name"], row["method"]): row for row in record["measures"]}


# --- the bodies --------------------------------------------------------------------------------


def levels(base):
    for level, voxels in ((4, 81), (4, 162), (5, 243)):
        settings = {"model.level": level, "voxels.voxels": voxels, "voxels.sampling": "centre"}
        recipe = po.load("menger", set=settings)
        begin = time.perf_counter()
        inside = workspace.make(recipe, base / "inside", only="voxels")
        middle = time.perf_counter()
        beyond = workspace.make_stored(recipe, base / "beyond", only="voxels", chunk=64)
        end = time.perf_counter()
        body = f"Menger {level}, {voxels}³"
        differ = sum(a != b for a, b in zip(inside.measures, beyond.measures, strict=True))
        note = f"in memory {middle - begin:.1f} s, out of core {end - middle:.1f} s"
        yield row(body, "rows that differ from memory's", differ, 0, seconds=end - begin, note=note)
        for place in ("inside", "beyond"):
            shutil.rmtree(base / place)


def menger(base):
    recipe = ["menger", "--set", "model.level=7", "--voxels", 2187]
    runs = killed_twice(recipe, base / "menger")
    rows = measured(base / "menger")
    model = po.build(po.load("menger", set={"model.level": 7}))
    exact = {known.name: known.value for known in model.exact()}
    body = "Menger 7, 2187³"
    yield from costs(body, runs)
    asked = (
        *(("porosity", method, "porosity") for method in ("voxel fill", "voxel count")),
        ("surface_area", "voxel faces", "surface_area"),
        ("interface_area", "voxel faces", "interface_area"),
        ("components", "voxel count", "components"),
        ("euler_number", "voxel count", "euler_number"),
        ("components_26", "voxel count", "components_26"),
        ("euler_number_26", "voxel count", "euler_number_26"),
    )
    for name, method, known in asked:
        found = rows[name, method]["value"]
        rounding = 1e-12 * abs(exact[known])
        yield row(body, f"{name} ({method})", found, exact[known], within=rounding)
    yield row(body, "closed_porosity", rows["closed_porosity", "voxel count"]["value"], 0.0)
    open_ = rows["open_porosity", "voxel count"]["value"]
    yield row(body, "open_porosity", open_, exact["porosity"], within=1e-12)
    solid = round((1 - rows["porosity", "voxel count"]["value"]) * 2187**3)
    yield row(body, "solid voxels, 20^7", solid, 20**7)
    shutil.rmtree(base / "menger")


def costs(body, runs):
    names = ("killed amid its voxels", "resumed, killed amid its counts", "resumed to the end")
    for name, run in zip(names, runs, strict=True):
        peak = row(body, f"{name}: MiB above {MOST}", max(0.0, run.peak - MOST), 0.0)
        yield {**peak, "seconds": run.seconds, "peak_mib": run.peak}


def grown_recipe(folder, voxels):
    import numpy as np

    tables = []
    for axis, degrees, place in TURNS:
        cosine, sine = np.cos(np.radians(degrees)) / 2, np.sin(np.radians(degrees)) / 2
        matrix = np.eye(3) / 2
        one, two = [(1, 2), (2, 0), (0, 1)][axis]
        matrix[one, one] = matrix[two, two] = cosine
        matrix[one, two], matrix[two, one] = -sine, sine
        tables.append(f"[[model.maps]]\nmatrix = {matrix.tolist()}\ntranslation = {list(place)}")
    path = folder / f"grown-{voxels}.toml"
    path.write_text(GROWN.format(maps="\n".join(tables), voxels=voxels))
    return path


def grown(base):
    body = "four turned maps, grown, 2048³"
    coarse = {}
    for voxels in (256, 512):
        result = po.run(po.load(grown_recipe(base, voxels)), only="voxels")
        coarse[voxels] = result.measures
    runs = killed_twice([grown_recipe(base, 2048)], base / "grown")
    rows = measured(base / "grown")
    yield from costs(body, runs)
    for name, method in (("porosity", "voxel fill"), ("surface_area", "crofton")):
        fine = rows[name, method]
        for voxels, measures in coarse.items():
            known = measures[name, method]
            within = 2 * (known.uncertainty + fine["uncertainty"])
            yield row(
                body, f"{name}, against {voxels} voxels", fine["value"], known.value, within=within
            )
    for name in ("components", "euler_number", "components_26", "euler_number_26"):
        known = coarse[512][name].value
        yield row(body, f"{name}, against 512 voxels", rows[name, "voxel count"]["value"], known)
    shutil.rmtree(base / "grown")


def main():
    with tempfile.TemporaryDirectory(dir=PLACE) as folder:
        base = Path(folder)
        rows = [found for part in (levels, menger, grown) for found in part(base)]
    RESULTS.mkdir(exist_ok=True)
    with (RESULTS / "08_larger_than_memory.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    wrong = [found for found in rows if not found["agrees"]]
    if wrong:
        raise SystemExit(f"{len(wrong)} of {len(rows)} rows do not hold: {wrong[0]}")


if __name__ == "__main__":
    main()
