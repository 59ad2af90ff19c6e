"""Do bodies that memory does not hold come out right, killed on the way, below four gibibytes?

Menger's sponge of level 7 at 2187³ voxels against its closed forms, and a grown attractor off any
lattice at 2048³ against its own coarser grids: made out of core by the command line, killed once
while voxels are written and once while they are measured, and resumed. Levels 4 and 5 are made out
of core and in memory and have to give the same rows. Peak memory is that of each process, as the
system tells it. A row that does not hold ends the study with an error. Where the environment
variable POROUS_SMALL is set, bodies are small, so that the study can be tried within minutes.
"""

import csv
import json
import math
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
SMALL = bool(os.environ.get("POROUS_SMALL"))
LEVEL, VOXELS, CHUNK = (4, 81, 12) if SMALL else (7, 2187, 256)
GROWN_VOXELS, COARSE, GROWN_CHUNK = (128, (32, 64), 16) if SMALL else (2048, (256, 512), 256)
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
WEDGES = (
    "where two balls meet at a sharp angle the gap between them is narrower than a voxel for some "
    "way, at any resolution; what voxels make of its tip is no property of the body"
)
TURNS = ((0, 20, (0, 0, 0)), (1, 35, (0.5, 0, 0)), (2, 50, (0, 0.5, 0)), (0, 65, (0, 0, 0.5)))


def row(body, quantity, found, wanted, *, within=0.0, seconds="", peak="", note=""):
    agrees = "not judged" if within == math.inf else abs(found - wanted) <= within
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


def killed_twice(recipe, folder, chunk):
    """Make a recipe, killed amid its voxels and amid its measures; return the three runs."""
    asked = ["--out-of-core", "--only", "voxels", "--chunk", chunk, "-o", folder]
    limit = ["--max-memory", f"{MOST}M"]

    def amid_voxels():
        return len(list((folder / "grid.zarr/fill").glob("c.*"))) >= 100

    def amid_counts():
        counted = SMALL or any(folder.glob("counts-*.tally"))
        return counted and (folder / "grid.zarr/manifest.json").exists()

    runs = [Run(["make", *recipe, *asked, *limit], amid_voxels)]
    runs.append(Run(["resume", folder, *limit], amid_counts))
    assert [run.code for run in runs] == [-9, -9]
    assert not (folder / workspace.LAST).exists()
    runs.append(Run(["resume", folder, *limit]))
    assert runs[-1].code == 0
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
    recipe = ["menger", "--set", f"model.level={LEVEL}", "--voxels", VOXELS]
    runs = killed_twice(recipe, base / "menger", CHUNK)
    rows = measured(base / "menger")
    model = po.build(po.load("menger", set={"model.level": LEVEL}))
    exact = {known.name: known.value for known in model.exact()}
    body = f"Menger {LEVEL}, {VOXELS}³"
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
    solid = round((1 - rows["porosity", "voxel count"]["value"]) * VOXELS**3)
    yield row(body, f"solid voxels, 20^{LEVEL}", solid, 20**LEVEL)
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
    body = f"four turned maps, grown, {GROWN_VOXELS}³"
    coarse = {}
    for voxels in COARSE:
        recipe = po.load(grown_recipe(base, voxels))
        coarse[voxels] = po.run(recipe, only="voxels").measures
        beyond = workspace.make_stored(
            recipe, base / "beyond", only="voxels", chunk=GROWN_CHUNK // 4
        )
        differ = sum(a != b for a, b in zip(coarse[voxels], beyond.measures, strict=True))
        shutil.rmtree(base / "beyond")
        yield row(
            f"four turned maps, grown, {voxels}³", "rows that differ from memory's", differ, 0
        )
    runs = killed_twice([grown_recipe(base, GROWN_VOXELS)], base / "grown", GROWN_CHUNK)
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
    for name in ("components", "components_26"):
        known = coarse[COARSE[-1]][name].value
        found = rows[name, "voxel count"]["value"]
        yield row(body, f"{name}, against {COARSE[-1]} voxels", found, known)
    for name in ("euler_number", "euler_number_26"):
        known = coarse[COARSE[-1]][name].value
        found = rows[name, "voxel count"]["value"]
        what = f"{name}, against {COARSE[-1]} voxels"
        yield row(body, what, found, known, within=math.inf, note=WEDGES)
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
