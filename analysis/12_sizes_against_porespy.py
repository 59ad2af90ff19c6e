"""How right and how fast are thickness, chords and two-point correlation, beside PoreSpy?

First bodies that one knows, anywhere among the voxels: errors of diameters in voxels, smallest,
mean and largest. Then three images, measured by porous and by PoreSpy (in an environment of its
own, whose interpreter the environment variable POROUS_PORESPY names; rows are left empty without
it). Seconds are by the wall's clock and of the cores, ratios of both; machines are shared.
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
from scipy.ndimage import distance_transform_edt, gaussian_filter

from porous.kernels.distance import squared_distances
from porous.kernels.thickness import largest_balls
from porous.measures import chord_lengths, local_thickness, thicknesses, two_point
from porous.values import Frame, VoxelGrid

RESULTS = Path(os.environ.get("POROUS_RESULTS", Path(__file__).parent / "results"))
JUDGE = Path(__file__).parent.parent / "tests" / "judges" / "porespy_sizes.py"
SMALL = bool(os.environ.get("POROUS_SMALL"))
SIDE, DRAWS = (48, 6) if SMALL else (200, 60)


class Table:
    """The rows."""

    def __init__(self):
        self.rows = []

    def add(self, question, body, found, **judged):
        """Add a row; ``ratio`` or ``found`` is held against ``wanted`` (at most or at least)."""
        wanted, ratio = judged.get("wanted", ""), judged.get("ratio")
        core = judged.get("core_ratio")
        value = found if ratio is None else ratio
        given = value is not None and wanted
        self.rows.append(
            {
                "question": question,
                "body": body,
                "found": shown(found),
                "expected": shown(judged.get("expected")),
                "seconds": shown(judged.get("seconds")),
                "core_seconds": shown(judged.get("cores")),
                "ratio": shown(ratio),
                "core_ratio": shown(core),
                "wanted": wanted,
                "met": ("yes" if holds(value, wanted) else "no") if given else "",
                "met_by_cores": ("yes" if holds(core, wanted) else "no") if given and core else "",
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


def holds(ratio, wanted):
    """Tell whether a ratio is ``<= x`` or ``>= x``."""
    sign, bound = wanted.split()
    return ratio <= float(bound) if sign == "<=" else ratio >= float(bound)


def best(work, repeats):
    """Return what a work gives, and its seconds by the wall's clock and of the cores, the best."""
    times = []
    for _ in range(repeats):
        wall, core = time.perf_counter(), time.process_time()
        made = work()
        times.append((time.perf_counter() - wall, time.process_time() - core))
    wall, core = (min(each) for each in zip(*times, strict=True))
    return made, wall, core


def grid_of(solid, *, wraps=False):
    """Return a grid of cubes."""
    return VoxelGrid.of_solid(solid, Frame((0, 0, 0), (1.0,) * 3, solid.shape, (wraps,) * 3))


def centres(side):
    """Return the centres of a cube's voxels."""
    return np.stack(np.meshgrid(*(np.arange(side) + 0.5,) * 3, indexing="ij"))


# --- bodies that one knows -----------------------------------------------------------------


def ball(x, width, _):
    """A ball; where its centre is among the voxels, the caller has drawn."""
    return (x**2).sum(axis=0) < width**2 / 4


def tube(x, width, random):
    """A tube along a direction, at random."""
    along = turned(random)
    return (x**2).sum(axis=0) - np.tensordot(along, x, 1) ** 2 < width**2 / 4


def slab(x, width, _):
    """A slab across x."""
    return np.abs(x[0]) < width / 2


def turned(random):
    """Return a direction."""
    vector = random.normal(size=3)
    return vector / np.linalg.norm(vector)


ACROSS = [(1, 1, 0), (1, 1, 1), (2, 1, 0), (1, 2, 2), (3, 1, 0), (2, 1, 1), (0, 1, 5), (4, 1, 1)]
"""Directions in which slabs follow each other in a periodic grid."""


def rows_of(solid, *, wraps=False):
    """Return what local thickness comes to."""
    grid = grid_of(solid, wraps=wraps)
    return thicknesses(local_thickness(grid, phase="solid", beyond="unknown"))


def cut(shape, random):
    """Return a body's width, and what local thickness comes to."""
    side, width = 44, random.uniform(5, 28)
    place = side / 2 + random.uniform(-0.5, 0.5, 3)
    solid = shape(centres(side) - place[:, None, None, None], width, random)
    return width, rows_of(solid)


def tilted(random):
    """Return the width of slabs across a direction of a periodic grid, and what it comes to."""
    side, across = 64, np.array(ACROSS[random.integers(len(ACROSS))], float)
    pitch = side / np.linalg.norm(across)
    width = random.uniform(5, min(28, pitch - 3))
    place = np.tensordot(across, centres(side), 1) / np.linalg.norm(across)
    return width, rows_of((place - random.uniform(0, pitch)) % pitch < width, wraps=True)


def known(table):
    for name, draw in (
        ("balls of 5 to 28 voxels", lambda random: cut(ball, random)),
        ("tubes of 5 to 28 voxels, any direction", lambda random: cut(tube, random)),
        ("slabs of 5 to 28 voxels, along the axes", lambda random: cut(slab, random)),
        ("slabs of 5 to 28 voxels, eight directions", tilted),
    ):
        random, errors = np.random.default_rng(12), []
        for _ in range(DRAWS):
            width, rows = draw(random)
            errors.append([row.value - width for row in rows])
        medians = np.array(errors)[:, 1]
        what = "wall_thickness_p50 less the width, voxels: "
        table.add(what + "least", name, medians.min(), expected=0, wanted=">= -1")
        table.add(what + "mean", name, medians.mean(), expected=0)
        table.add(what + "largest", name, medians.max(), expected=0, wanted="<= 1")


# --- the same images -----------------------------------------------------------------------


def gyroid():
    x, y, z = 8 * np.pi * centres(SIDE) / SIDE
    return np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x) > 0


def blobs():
    noise = np.random.default_rng(2).random((SIDE,) * 3)
    field = gaussian_filter(noise, SIDE / 28, mode="wrap")
    return field > np.quantile(field, 0.6)


def balls():
    random, solid, radius = np.random.default_rng(3), np.zeros((SIDE,) * 3, bool), SIDE / 16
    reach = math.ceil(radius) + 1
    for place in random.uniform(0, SIDE, (700, 3)):
        near = [np.arange(int(c) - reach, int(c) + reach + 1) for c in place]
        gaps = np.meshgrid(*(a + 0.5 - c for a, c in zip(near, place, strict=True)), indexing="ij")
        solid[np.ix_(*(a % SIDE for a in near))] |= sum(g**2 for g in gaps) < radius**2
    return solid


def theirs(solid, folder):
    """Return what PoreSpy says and its map of radii, or None where it is not installed."""
    python = os.environ.get("POROUS_PORESPY", sys.executable)
    given, made = Path(folder) / "im.npz", Path(folder) / "radii.npz"
    np.savez(given, im=~solid)
    command = [python, JUDGE, given, "1" if SMALL else "3", made]
    done = subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=1200,
        check=False,
    )
    if done.returncode:
        return None, None
    return json.loads(done.stdout.splitlines()[-1]), np.load(made)["radii"]


EXACT = """
import json, logging, sys, time, warnings
import numpy as np
warnings.filterwarnings("ignore")
logging.disable(logging.CRITICAL)
import porespy
porespy.settings.tqdm["disable"] = True
image, told = np.load(sys.argv[1])["im"], []
porespy.filters.local_thickness(image[:24, :24, :24])
every = np.unique(porespy.tools.get_edt()(image)[image])
for how in ({}, {"method": "legacy", "sizes": every}):
    wall, core = time.perf_counter(), time.process_time()
    radii = porespy.filters.local_thickness(image, **how)
    told.append([time.perf_counter() - wall, time.process_time() - core])
    told[-1].append(radii[image].mean())
print(json.dumps(told))
"""


def modes(table):
    """Hold PoreSpy's default, of whole radii, and its mode of every distance against ours."""
    solid = blobs()[(slice(SIDE // 2),) * 3]
    python, body = os.environ.get("POROUS_PORESPY", sys.executable), f"blobs, {SIDE // 2}³"
    with tempfile.TemporaryDirectory() as folder:
        given = Path(folder) / "im.npz"
        np.savez(given, im=~solid)
        done = subprocess.run(
            [python, "-c", EXACT, given],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=1200,
            check=False,
        )
    told = [(None,) * 3] * 2 if done.returncode else json.loads(done.stdout)
    local_thickness(grid_of(solid))
    _, wall, cores = best(lambda: local_thickness(grid_of(solid)), 3)
    squares = squared_distances(~solid, (1, 1, 1))
    mean = np.sqrt(largest_balls(squares)[~solid]).mean()
    for how, (theirs_wall, theirs_cores, theirs_mean) in zip(
        ("whole radii, its default", "every distance, its legacy mode"), told, strict=True
    ):
        seconds = None if theirs_wall is None else (theirs_wall, theirs_cores)
        table.add(
            f"mean radius of lattice balls, voxels; expected is PoreSpy's: {how}",
            body,
            mean,
            expected=theirs_mean,
            seconds=wall,
            cores=cores,
            **against(seconds, wall, cores),
        )


def images(table):
    for body, make in (("gyroid, 4 cells", gyroid), ("blobs", blobs), ("overlapping balls", balls)):
        solid = make()
        with tempfile.TemporaryDirectory() as folder:
            said, radii = theirs(solid, folder)
        name = f"{body}, {SIDE}³"
        sizes(table, name, solid, said, radii)
        lines(table, name, solid, said)
        pairs(table, name, solid, said)


def against(seconds, wall, cores):
    """Return the ratios of PoreSpy's seconds to ours."""
    if seconds is None:
        return {}
    return {"ratio": seconds[0] / wall, "core_ratio": seconds[1] / cores}


def sizes(table, name, solid, said, radii):
    grid, void = grid_of(solid), ~solid
    local_thickness(grid)
    local, wall, cores = best(lambda: local_thickness(grid), 3)
    _, theirs_wall, theirs_cores = best(lambda: distance_transform_edt(void), 2)
    squared_distances(void, (1, 1, 1))
    _, ours_wall, ours_cores = best(lambda: squared_distances(void, (1, 1, 1)), 3)
    times = {"seconds": wall, "cores": cores}
    seconds = None if said is None else said["seconds"]["thickness"]
    question = "local thickness: PoreSpy's seconds to ours"
    table.add(question, name, None, **times, **against(seconds, wall, cores), wanted=">= 5")
    table.add(
        "local thickness: our seconds to those of scipy's distance transform",
        name,
        None,
        **times,
        ratio=wall / theirs_wall,
        core_ratio=cores / theirs_cores,
        wanted="<= 1.5",
    )
    table.add(
        "distance transform: our seconds to scipy's",
        name,
        None,
        seconds=ours_wall,
        cores=ours_cores,
        ratio=ours_wall / theirs_wall,
        core_ratio=ours_cores / theirs_cores,
        wanted="<= 1.5",
    )
    median = local.quantile(0.5) / 2
    expected = None if said is None else said["radius_median"]
    gap = None if said is None else abs(median - expected)
    table.add("median radius, voxels", name, median, expected=expected)
    table.add("median radius: difference, voxels", name, gap, expected=0, wanted="<= 1")
    mine = local.diameters[void] / 2
    gaps = None if said is None else np.abs(mine - radii[void])
    for part, what in ((0.5, "median"), (0.99, "99 % below"), (1.0, "largest")):
        gap = None if said is None else np.quantile(gaps, part)
        table.add(f"radii, voxel by voxel: difference, {what}", name, gap, expected=0)


def lines(table, name, solid, said):
    grid = grid_of(solid)
    chord_lengths(grid)
    found, wall, cores = best(lambda: chord_lengths(grid), 3)
    along = found.axes[0]
    mean = along.lengths @ along.whole / along.whole.sum()
    expected = None if said is None else said["chord_mean"]
    seconds = None if said is None else said["seconds"]["chords"]
    times = {"seconds": wall, "cores": cores, **against(seconds, wall, cores)}
    table.add(
        "porosity", name, (~solid).mean(), expected=None if said is None else said["porosity"]
    )
    table.add("mean chord along x, whole ones, voxels", name, mean, expected=expected, **times)
    gap = None if said is None else abs(mean - expected)
    table.add("mean chord: difference, voxels", name, gap, expected=0, wanted="<= 1")


def pairs(table, name, solid, said):
    grid, wrapped = grid_of(solid), grid_of(solid, wraps=True)
    longest = SIDE / 2 - 0.51
    two_point(grid, longest=longest)
    found, wall, cores = best(lambda: two_point(grid, longest=longest), 2)
    _, fast, fast_cores = best(lambda: two_point(wrapped), 3)
    curve = None if said is None else np.array(said["curve"])
    seconds = None if said is None else said["seconds"]["curve"]
    ours = found.values[1:]
    gap = None if said is None else np.abs(ours[: len(curve)] / curve[: len(ours)] - 1).max()
    table.add("two-point correlation: largest relative difference", name, gap, wanted="<= 0.01")
    times = {"seconds": wall, "cores": cores, **against(seconds, wall, cores)}
    table.add("two-point correlation, not periodic: PoreSpy's seconds to ours", name, None, **times)
    times = {"seconds": fast, "cores": fast_cores, **against(seconds, fast, fast_cores)}
    question = "two-point correlation, periodic: PoreSpy's seconds to ours"
    table.add(question, name, None, **times, wanted="" if SMALL else ">= 50")


def main():
    table = Table()
    known(table)
    images(table)
    modes(table)
    table.write()


if __name__ == "__main__":
    main()
