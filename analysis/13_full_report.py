"""How long does the full report of a scan of 512³ voxels take, and in how much memory?

A scan is made up: balls that overlap, blurred as a detector does and with its noise, written as a
TIFF. A process of its own makes the full report of it as a user would, by ``porous measure
scan.toml --detail full``; the system tells its seconds, by the wall's clock and of the cores, and
the most memory that it ever held. They are held against 16 times what PoreSpy (in an environment of
its own, whose interpreter the environment variable POROUS_PORESPY names; rows are left empty
without it) takes for the local thickness of the pores in an eighth of the scan: what both phases of
all of it would cost. PoreSpy has its turn before and after, and its best counts. Machines are
shared: ratios are of one run. Where the environment variable POROUS_SMALL is set, the scan has 64³
voxels.
"""

import csv
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import tifffile
from scipy.ndimage import gaussian_filter

RESULTS = Path(os.environ.get("POROUS_RESULTS", Path(__file__).parent / "results"))
SMALL = bool(os.environ.get("POROUS_SMALL"))
SIDE, REPEATS = (64, 1) if SMALL else (512, 2)
RADIUS, SHARE = 10.0, 0.5
"""Of the balls, in voxels, and how much of the scan they fill."""
DARK, BRIGHT, BLUR, NOISE = 90, 150, 0.7, 8
"""Grey values, the width of a detector's blur in voxels, and its noise in grey values."""
RECIPE = """
format = 1
title = "Balls that overlap"
model = { kind = "image", path = "scan.tif", spacing = 2.5, unit = "um", threshold = "otsu" }
"""
PHASES, EIGHTHS = 2, 8
MOST_MIB = 6 * 1024
LIMIT = 3600
"""Seconds that one process may take."""

THEIRS = """
import json, logging, sys, time, warnings
import numpy as np
warnings.filterwarnings("ignore")
logging.disable(logging.CRITICAL)
import porespy
porespy.settings.tqdm["disable"] = True
pores = np.load(sys.argv[1])
porespy.filters.local_thickness(pores[:32, :32, :32])
times = []
for _ in range(int(sys.argv[2])):
    wall, core = time.perf_counter(), time.process_time()
    porespy.filters.local_thickness(pores)
    times.append((time.perf_counter() - wall, time.process_time() - core))
print(json.dumps([porespy.__version__, *map(min, zip(*times))]))
"""


def scan():
    """Return grey values of balls that overlap."""
    random, solid = np.random.default_rng(13), np.zeros((SIDE,) * 3, bool)
    count = round(-math.log(1 - SHARE) * SIDE**3 / (4 / 3 * math.pi * RADIUS**3))
    reach = math.ceil(RADIUS) + 1
    for place in random.uniform(0, SIDE, (count, 3)):
        near = [np.arange(int(c) - reach, int(c) + reach + 1) for c in place]
        gaps = np.meshgrid(*(a + 0.5 - c for a, c in zip(near, place, strict=True)), indexing="ij")
        solid[np.ix_(*(a % SIDE for a in near))] |= sum(g**2 for g in gaps) < RADIUS**2
    grey = gaussian_filter(solid.astype(np.float32), BLUR) * np.float32(BRIGHT - DARK) + DARK
    grey += random.normal(0, NOISE, grey.shape).astype(np.float32)
    return grey.clip(0, 255).astype(np.uint8)


def theirs(pores, folder):
    """Return PoreSpy's version and its seconds, or None where it is not installed."""
    python, given = os.environ.get("POROUS_PORESPY", sys.executable), folder / "pores.npy"
    np.save(given, pores)
    done = subprocess.run(
        [python, "-c", THEIRS, given, str(REPEATS)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=LIMIT,
        check=False,
    )
    return None if done.returncode else json.loads(done.stdout)


def ours(image, folder):
    """Return seconds by the clock and of the cores, and mebibytes, that a report took."""
    image.with_suffix(".toml").write_text(RECIPE, encoding="utf-8")
    command = [sys.executable, "-m", "porous", "measure", str(image.with_suffix(".toml"))]
    command += ["--detail", "full", "-o", str(folder)]
    begin = time.perf_counter()
    with (folder.parent / "said.txt").open("w+b") as said:
        process = subprocess.Popen(
            ["timeout", str(LIMIT), *command], stdin=subprocess.DEVNULL, stdout=said, stderr=said
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        assert process.returncode == 0, said.read()[-2000:].decode(errors="replace")
    seconds = time.perf_counter() - begin
    return seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


class Table:
    """The rows."""

    def __init__(self):
        self.rows = []

    def add(self, question, found, unit, *, cores=None, wanted=None, reference=(None, None)):
        """Add a row; found and cores are wanted to be no more than ``wanted``, or a reference."""
        ratio, core_ratio = (
            None if mine is None or other is None else mine / other
            for mine, other in zip((found, cores), reference, strict=True)
        )
        met, met_by_cores = ratio, core_ratio
        if wanted is not None:
            met = found / wanted
        self.rows.append(
            {
                "question": question,
                "found": shown(found),
                "unit": unit,
                "core_seconds": shown(cores),
                "wanted_at_most": shown(reference[0] if wanted is None else wanted),
                "ratio": shown(ratio),
                "core_ratio": shown(core_ratio),
                "met": "" if met is None else "yes" if met <= 1 else "no",
                "met_by_cores": ""
                if met_by_cores is None
                else "yes"
                if met_by_cores <= 1
                else "no",
                "load_of_the_machine": f"{os.getloadavg()[0]:.1f}",
            }
        )
        print(*self.rows[-1].values(), sep="\t", flush=True)

    def write(self):
        """Write the table."""
        path = RESULTS / f"{Path(__file__).stem}.csv"
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(self.rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(self.rows)


def shown(number):
    """Return four digits, or nothing."""
    return "" if number is None else f"{number:.4g}"


def main():
    table = Table()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        grey = scan()
        middle = (DARK + BRIGHT) / 2
        pores = grey[(slice(SIDE // 2),) * 3] < middle
        tifffile.imwrite(folder / "scan.tif", grey.transpose(2, 1, 0))
        del grey
        told = [theirs(pores, folder)]
        seconds, cores, peak = ours(folder / "scan.tif", folder / "out")
        told.append(theirs(pores, folder))
        page = (folder / "out" / "report.html").stat().st_size / 2**20
        record = json.loads((folder / "out" / "measures.json").read_text(encoding="utf-8"))
    times = [each[1:] for each in told if each is not None]
    version = next((each[0] for each in told if each is not None), "not installed")
    wall, core = map(min, zip(*times, strict=True)) if times else (None, None)
    one = f"PoreSpy ({version}): local thickness of one phase, {SIDE // 2}³"
    table.add(one, wall, "s", cores=core)
    both = [None if each is None else PHASES * EIGHTHS * each for each in (wall, core)]
    table.add(f"16 times that: of both phases, {SIDE}³", both[0], "s", cores=both[1])
    table.add(f"full report, {SIDE}³", seconds, "s", cores=cores, reference=both)
    table.add(f"full report, {SIDE}³: peak memory", peak, "MiB", wanted=MOST_MIB)
    table.add(f"full report, {SIDE}³: the page", page, "MiB", wanted=8)
    table.add(f"full report, {SIDE}³: rows", len(record["measures"]), "1")
    table.write()


if __name__ == "__main__":
    main()
