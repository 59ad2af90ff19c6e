"""How fast are voxels made and read, side by side with what else there is, in one run?

Every question has its own rows: ours first, then the others on the same task. Seconds by the
wall's clock and of the cores are each of the best of some runs; ratios are of the wall's clock, and
beside them of core seconds, which tell the work where others load the machine (a contestant on one
thread then keeps its core, while two threads of ours share what is left). What is not installed is
named and left empty: PoreSpy may live in an environment of its own, whose interpreter the
environment variable POROUS_PORESPY names.
"""

import csv
import itertools
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numba
import numpy as np
import pyvista
from skimage.io import imread
from skimage.measure import euler_number
from skimage.measure import marching_cubes as lewiner
from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

import porous as po
from porous.kernels._shared import slabs
from porous.kernels.clouds import stamp
from porous.kernels.surface import marching_cubes
from porous.models import clouds, cover
from porous.models.automaton import of_maps
from porous.models.digits import named as digits
from porous.models.enclosure import enclosing_balls
from porous.values import Frame

RESULTS = Path(os.environ.get("POROUS_RESULTS", Path(__file__).parent / "results"))
TILE = (128, 128, 128)
SIDE = 256
POINTS_PER_VOXEL = 10
SYSTEMS, SLOWEST = 100, 8


def best(work, repeats):
    """Return seconds by the wall's clock and of the cores, each of the best run, and the result."""
    (found,) = in_turn([work], repeats)
    return found


def in_turn(works, repeats):
    """Return the same for each of some works, of which one follows the other in every round."""
    walls, cores, made = ([[] for _ in works] for _ in range(3))
    for _ in range(repeats):
        for k, work in enumerate(works):
            made[k] = None
            wall, core = time.perf_counter(), time.process_time()
            made[k] = work()
            walls[k].append(time.perf_counter() - wall)
            cores[k].append(time.process_time() - core)
    return [(min(a), min(b), c) for a, b, c in zip(walls, cores, made, strict=True)]


class Table:
    """The rows, and the row that others of the same question are held against."""

    def __init__(self):
        self.rows = []

    def add(self, question, method, amount="", unit="", seconds=None, cores=None, **judged):
        """Add a row; ``ratio``, ``core_ratio`` and ``wanted`` (at most or at least) judge it."""
        ratio, wanted = judged.get("ratio"), judged.get("wanted", "")
        core_ratio = judged.get("core_ratio")
        self.rows.append(
            {
                "question": question,
                "method": method,
                "amount": amount,
                "unit": unit,
                "seconds": "" if seconds is None else f"{seconds:.4f}",
                "core_seconds": "" if cores is None else f"{cores:.4f}",
                "ratio": "" if ratio is None else f"{ratio:.3f}",
                "core_ratio": "" if core_ratio is None else f"{core_ratio:.3f}",
                "wanted": wanted,
                "met": "" if not wanted else "yes" if holds(ratio, wanted) else "no",
                "met_by_cores": ""
                if not wanted or core_ratio is None
                else ("yes" if holds(core_ratio, wanted) else "no"),
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


def holds(ratio, wanted):
    """Tell whether a ratio is ``<= x`` or ``>= x``."""
    sign, bound = wanted.split()
    return ratio <= float(bound) if sign == "<=" else ratio >= float(bound)


# --- a grid that is made of copies ---------------------------------------------------------


def touched(shape):
    """Allocate an array and touch all of its pages."""
    array = np.empty(shape, np.uint8)
    array.fill(1)
    return array


def menger_cells(level):
    """Return a Menger sponge by numpy's kron."""
    cross = np.add.outer(np.add.outer(*[np.array([0, 1, 0])] * 2), np.array([0, 1, 0]))
    solid, cell = np.ones((1, 1, 1), np.uint8), (cross < 2).astype(np.uint8)
    for _ in range(level):
        solid = np.kron(solid, cell)
    return solid


def copies(table):
    question = "Menger 6, 729³, centre"
    model, shape = po.ifs(digits("menger"), level=6), (729,) * 3
    ours, core, grid = best(lambda: po.voxelize(model, voxels=729, sampling="centre"), 5)
    fill, fill_core, _ = best(lambda: touched(shape), 5)
    kron, kron_core, cells = best(lambda: menger_cells(6), 1)
    assert np.array_equal(cells.astype(bool), grid.solid)
    table.add(
        question,
        "porous",
        729**3,
        "voxels",
        ours,
        core,
        ratio=ours / fill,
        core_ratio=core / fill_core,
        wanted="<= 2",
    )
    table.add(question, "allocate and fill", 729**3, "voxels", fill, fill_core, ratio=1.0)
    table.add(question, "numpy kron", 729**3, "voxels", kron, kron_core, ratio=kron / fill)


# --- points of an attractor ----------------------------------------------------------------


@numba.njit
def chaos_game(marks, maps, origin, spacing, count):
    """Mark the voxels of so many points; the game as one writes it down."""
    x = y = z = 0.0
    for step in range(count + 50):
        m = maps[np.random.randint(len(maps))]  # noqa: NPY002
        x, y, z = (
            m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3],
            m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3],
            m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3],
        )
        if step >= 50:
            i = int((x - origin[0]) / spacing[0])
            j = int((y - origin[1]) / spacing[1])
            k = int((z - origin[2]) / spacing[2])
            if 0 <= i < marks.shape[0] and 0 <= j < marks.shape[1] and 0 <= k < marks.shape[2]:
                marks[i, j, k] = 1


@numba.njit
def bare_game(marks, maps, origin, scale, count, seed):
    """Mark the same with a random generator of three shifts and no division: as fast as it gets."""
    x = y = z = 0.0
    s = np.uint64(seed)
    for step in range(count + 50):
        s ^= s << np.uint64(13)
        s ^= s >> np.uint64(7)
        s ^= s << np.uint64(17)
        m = maps[np.int64((s >> np.uint64(11)) % np.uint64(len(maps)))]
        x, y, z = (
            m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3],
            m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3],
            m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3],
        )
        if step >= 50:
            i = int((x - origin[0]) * scale[0])
            j = int((y - origin[1]) * scale[1])
            k = int((z - origin[2]) * scale[2])
            if 0 <= i < marks.shape[0] and 0 <= j < marks.shape[1] and 0 <= k < marks.shape[2]:
                marks[i, j, k] = 1


def turned(count, ratio, seed):
    """Return maps that turn at random, shrink by a ratio and shift at random."""
    random = np.random.default_rng(seed)
    turns = [np.linalg.qr(random.normal(size=(3, 3)))[0] for _ in range(count)]
    return [(turn * ratio, random.uniform(-0.5, 0.5, 3)) for turn in turns]


def turned_menger():
    """Return the maps of a Menger sponge, each of which turns its part besides."""
    turn = np.linalg.qr(np.random.default_rng(9).normal(size=(3, 3)))[0]
    kept = [d for d in itertools.product(range(3), repeat=3) if d.count(1) < 2]
    return [(turn / 3, np.array(d) / 3) for d in kept]


class Attractor:
    """An affine IFS that no lattice suits, with a frame about its limit."""

    def __init__(self, maps, voxels):
        self.model = po.ifs(maps, level="limit")
        self.frame = Frame.fit(self.model.domain, voxels=voxels)
        self.maps = np.array([np.column_stack(pair) for pair in maps])
        self.automaton = of_maps(maps)
        self.balls = enclosing_balls(self.automaton)
        self.marks = touched(self.frame.shape)

    def tiles(self, work):
        """Call ``work(frame of a tile, where it lies)`` for all tiles, on all threads."""
        steps = [range(0, n, size) for n, size in zip(self.frame.shape, TILE, strict=True)]
        starts = list(itertools.product(*steps))

        def some(first, last):
            for start in starts[first:last]:
                stop = np.minimum(np.add(start, TILE), self.frame.shape)
                part = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
                work(self.frame.tile(start, tuple(map(int, stop))), part)

        slabs(len(starts), 1, some)

    def stamped(self):
        """Stamp what ``marks`` has room for; return the number of points that were drawn."""
        given = self.automaton, self.balls.tobytes()
        system = cover._system(*given)  # noqa: SLF001
        found = clouds.clouds(system, min(self.frame.spacing))
        (cloud,) = found
        counts = []

        def work(tile, part):
            state, root = cover._root(self.automaton, tile, 1)  # noqa: SLF001
            root[:, 3] -= tile.start
            shape = np.array(tile.shape)
            words = clouds.fitting(system, found, (state, root), shape, np.array(tile.spacing))
            if not len(words.maps):
                return
            here = np.zeros(tile.shape, np.uint8)
            for within in (True, False):
                stamp(here, words.maps[words.inside == within], cloud.points, inside=within)
            self.marks[part] = here
            counts.append(len(words.maps) * cloud.points.shape[1])

        self.tiles(work)
        return sum(counts)

    def covered(self, fine):
        """Return the certified cover down to a part of a voxel's edge, from nothing."""
        for kept in (cover._system, cover._reference, cover._clouds):  # noqa: SLF001
            kept.cache_clear()
        return cover.cover_attractor(self.automaton, self.balls, self.frame, fine=fine)[0]

    def game(self, count, *, bare=False, keep=False):
        """Return what a chaos game of so many points marks, in ``marks`` where these are kept."""
        marks = self.marks if keep else np.zeros(self.frame.shape, np.uint8)
        origin, spacing = np.array(self.frame.origin), np.array(self.frame.spacing)
        if bare:
            bare_game(marks, self.maps, origin, 1 / spacing, count, 88172645463325252)
        else:
            chaos_game(marks, self.maps, origin, spacing, count)
        return marks


def fern():
    """Return the maps of the preset."""
    maps = po.load("fern").model.maps
    return [(np.array(m.matrix), np.array(m.translation)) for m in maps]


def attractors(table):
    dense = {
        "four turned maps of 1/2": Attractor(turned(4, 0.5, 1), 512),
        "six turned maps of 1/2": Attractor(turned(6, 0.5, 3), SIDE),
        "Menger, every part turned": Attractor(turned_menger(), SIDE),
    }
    for name, body in dense.items():
        warm(body)
        points(table, name, body)
        certified(table, name, body)
    # Of few voxels: what is prepared counts as much as what is marked.
    few = {
        "three turned maps of 1/2": Attractor(turned(3, 0.5, 2), SIDE),
        "fern": Attractor(fern(), SIDE),
    }
    for name, body in few.items():
        warm(body)
        certified(table, name, body)


def random_maps(random):
    """Return 2 to 9 random maps: similarities, turned stretches, shears, or flat ones."""
    kind, maps = random.integers(4), []
    for _ in range(random.integers(2, 10)):
        turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
        if kind == 0:
            matrix = turn * random.uniform(0.2, 0.6)
        elif kind == 1:
            matrix = turn @ np.diag(random.uniform(0.1, 0.7, 3))
        elif kind == 2:
            matrix = turn @ (np.eye(3) + np.triu(random.uniform(-0.7, 0.7, (3, 3)), 1))
            matrix *= random.uniform(0.25, 0.7) / np.linalg.norm(matrix, 2)
        else:
            thin = random.choice([0, 0.1, 0.3])
            sizes = [random.uniform(0.3, 0.8), random.uniform(0.1, 0.5), thin]
            matrix = turn @ np.diag(sizes)
        maps.append((matrix, random.uniform(-0.5, 0.5, 3)))
    return maps


def random_systems(table):
    """Time certified covers of random systems, and name the slowest."""
    question, found = f"certified cover, ε = h/2, {SYSTEMS} random systems, 128 to 512", []
    for seed in range(SYSTEMS):
        random = np.random.default_rng(seed)
        maps, voxels = random_maps(random), int(random.choice([128, 256, 256, 512]))
        body = Attractor(maps, voxels)
        occupied = int(body.covered(2).sum())
        count = POINTS_PER_VOXEL * occupied
        works = [lambda b=body: b.covered(2), lambda b=body, n=count: b.game(n)]
        repeats = 9 if occupied < 10**5 else 2
        (ours, core, _), (game, game_core, _) = in_turn(works, repeats)
        name = f"system {seed} of {len(maps)} maps"
        found.append((ours / game, core / game_core, name, occupied, ours, core))
    for ratio, core_ratio, name, occupied, ours, core in sorted(found, reverse=True)[:SLOWEST]:
        both = {"ratio": ratio, "core_ratio": core_ratio}
        table.add(question, f"porous, certified, {name}", occupied, "voxels", ours, core, **both)
    ratios = np.array([row[:2] for row in found])
    for name, share in (("half", 0.5), ("nine of ten", 0.9), ("all", 1.0)):
        wall, core = np.quantile(ratios, share, axis=0, method="higher")
        method = f"porous, certified, {name} of them at most"
        table.add(question, method, ratio=wall, core_ratio=core, wanted="<= 3")


def warm(body):
    """Have everything compiled."""
    body.stamped()
    body.covered(2)
    body.game(9)
    body.game(9, bare=True)


def points(table, name, body):
    question = f"points per second, {name}, {max(body.frame.shape)}"
    count = 10_000_000
    # As densely as it takes to draw more points than the game does.
    usual = clouds.WANTED
    while body.stamped() < 2 * count:
        clouds.WANTED *= 2
    ours, core, drawn = best(body.stamped, 3)
    clouds.WANTED = usual
    game, game_core, _ = best(lambda: body.game(count, keep=True), 3)
    bare, bare_core, _ = best(lambda: body.game(count, bare=True, keep=True), 3)
    speed, per_core = drawn / ours, drawn / core
    table.add(
        question,
        "porous, leaf clouds",
        drawn,
        "points",
        ours,
        core,
        ratio=speed / (count / game),
        core_ratio=per_core / (count / game_core),
        wanted=">= 8",
    )
    table.add(question, "numba chaos game", count, "points", game, game_core, ratio=1.0)
    table.add(
        question,
        "numba chaos game, bare",
        count,
        "points",
        bare,
        bare_core,
        ratio=game / bare,
        core_ratio=game_core / bare_core,
    )


def certified(table, name, body):
    question = f"certified cover, ε = h/2, {name}, {max(body.frame.shape)}"
    count = POINTS_PER_VOXEL * int(body.covered(2).sum())
    (ours, core, marks), (game, game_core, hit), (bare, bare_core, _) = in_turn(
        [lambda: body.covered(2), lambda: body.game(count), lambda: body.game(count, bare=True)], 7
    )
    occupied = int(marks.sum())
    assert not (hit.astype(bool) & (marks == 0)).any()
    table.add(
        question,
        "porous, certified",
        occupied,
        "voxels",
        ours,
        core,
        ratio=ours / game,
        core_ratio=core / game_core,
        wanted="<= 3",
    )
    missed = 1 - hit.sum() / body.covered(cover.FINE).sum()
    table.add(
        question,
        f"numba chaos game, {missed:.0%} of the voxels missed",
        count,
        "points",
        game,
        game_core,
        ratio=1.0,
    )
    table.add(
        question,
        "numba chaos game, bare",
        count,
        "points",
        bare,
        bare_core,
        ratio=bare / game,
        core_ratio=bare_core / game_core,
    )


def overlap(table):
    question = f"cover with overlap, per occupied voxel, {SIDE}"
    found = {}
    for name, maps in (
        ("six maps of 0.7", turned(6, 0.7, 5)),
        ("four maps of 0.5", turned(4, 0.5, 1)),
    ):
        body = Attractor(maps, SIDE)
        Attractor(maps, 24).covered(cover.FINE)  # compiled
        repeats = 1 if len(maps) > 4 else 3
        seconds, cores, marks = best(lambda b=body: b.covered(cover.FINE), repeats)
        found[name] = seconds, cores, int(marks.sum())
    (ours, core, many), (plain, plain_core, few) = found.values()
    table.add(
        question,
        "six maps of 0.7",
        many,
        "voxels",
        ours,
        core,
        ratio=ours / many / (plain / few),
        core_ratio=core / many / (plain_core / few),
        wanted="<= 5",
    )
    table.add(question, "four maps of 0.5", few, "voxels", plain, plain_core, ratio=1.0)


# --- voxels that are read ------------------------------------------------------------------


def filled(table):
    question = "fill of Menger 3, 243³, by 4³ samples"
    aligned = po.ifs(digits("menger"), level=3)
    ours, core, grid = best(lambda: po.voxelize(aligned, voxels=243), 5)
    theirs, their_core, _ = best(lambda: euler_number(grid.solid, connectivity=1), 2)
    turn = np.linalg.qr(np.random.default_rng(9).normal(size=(3, 3)))[0]
    middle = np.full(3, 0.5)
    kept = [d for d in itertools.product(range(3), repeat=3) if d.count(1) < 2]
    # Conjugated by a turn: the same sponge, with no plane along the lattice.
    skew = po.ifs(
        [(np.eye(3) / 3, turn @ (np.array(d) / 3 - middle * 2 / 3) + middle * 2 / 3) for d in kept],
        level=3,
    )
    other, other_core, _ = best(lambda: po.voxelize(skew, voxels=243), 3)
    table.add(
        question,
        "porous",
        243**3,
        "voxels",
        ours,
        core,
        ratio=theirs / ours,
        core_ratio=their_core / core,
        wanted=">= 4",
    )
    table.add(
        question,
        "scikit-image euler_number of it",
        243**3,
        "voxels",
        theirs,
        their_core,
        ratio=1.0,
    )
    table.add(
        question,
        "porous, pieces off the lattice",
        po.voxelize(skew, voxels=243).frame.size,
        "voxels",
        other,
        other_core,
        ratio=theirs / other,
        core_ratio=their_core / other_core,
    )


def grown(table):
    """Time attractors that a ball grows, by the voxel, against cells that lie on the lattice."""
    question = "fill of a grown attractor, per voxel, by 4³ samples"
    aligned = po.ifs(digits("menger"), level=3)
    plain, plain_core, cells = best(lambda: po.voxelize(aligned, voxels=243), 5)
    table.add(
        question, "Menger 3 on the lattice, 243", cells.frame.size, "voxels", plain, plain_core
    )
    for name, maps in (("four turned maps of 1/2", turned(4, 0.5, 1)), ("fern", fern())):
        longest = max(po.ifs(maps, level="limit").domain.lengths)
        for voxels in (2, 12):
            body = po.ifs(maps, level="limit", offset=voxels * longest / SIDE)
            ours, core, grid = best(lambda b=body: po.voxelize(b, voxels=SIDE), 2)
            size = grid.frame.size
            table.add(
                question,
                f"{name}, grown by {voxels} voxels, {SIDE}",
                size,
                "voxels",
                ours,
                core,
                ratio=ours / size / (plain / cells.frame.size),
                core_ratio=core / size / (plain_core / cells.frame.size),
            )


def surfaces(table):
    question = "surface of Menger 5, 243³"
    fill = menger_cells(5) * np.uint8(255)
    frame = Frame((0, 0, 0), (1, 1, 1), fill.shape)
    padded = np.pad(fill, 1)
    image = pyvista.ImageData(dimensions=padded.shape)
    image.point_data["fill"] = padded.ravel(order="F")
    image.set_active_scalars("fill")

    def kernel():
        return len(marching_cubes(fill, frame)[1])

    def flying_edges():
        filtered = vtkFlyingEdges3D()
        filtered.SetInputData(image)
        filtered.SetValue(0, 127.5)
        filtered.ComputeNormalsOff()
        filtered.ComputeGradientsOff()
        filtered.ComputeScalarsOff()
        filtered.Update()
        return filtered.GetOutput().GetNumberOfPolys()

    ours, core, count = best(kernel, 5)
    table.add(question, "porous kernel", count, "triangles", ours, core, ratio=1.0)
    others = {
        "scikit-image Lewiner": (lambda: len(lewiner(padded, 127.75)[1]), 1, ">= 20"),
        "VTK flying edges": (flying_edges, 4, ">= 2"),
        "PyMCubes": (pymcubes(padded), 1, ""),
    }
    for name, (work, repeats, wanted) in others.items():
        if work is None:
            table.add(question, f"{name}: not installed")
            continue
        seconds, cores, count = best(work, repeats)
        table.add(
            question,
            name,
            count,
            "triangles",
            seconds,
            cores,
            ratio=seconds / ours,
            core_ratio=cores / core,
            wanted=wanted,
        )


def pymcubes(padded):
    try:
        import mcubes
    except ImportError:
        return None
    return lambda: len(mcubes.marching_cubes(padded, 127.5)[1])


# --- what others make ----------------------------------------------------------------------


PORESPY = """
import json, logging, sys, time, warnings
warnings.filterwarnings("ignore")
logging.disable(logging.CRITICAL)
import porespy
porespy.settings.tqdm["disable"] = True
best = {}
for name, make in (
    ("foam", lambda: porespy.generators.sierpinski_foam([243] * 3, n=5, mode="upper")),
    ("dust", lambda: porespy.generators.random_cantor_dust([256] * 3, n=8, seed=1)),
):
    times = []
    for _ in range(3):
        wall, core = time.perf_counter(), time.process_time()
        made = make()
        times.append((time.perf_counter() - wall, time.process_time() - core))
    best[name] = [min(t) for t in zip(*times)]
print(json.dumps(best))
"""


def porespy():
    """Return PoreSpy's seconds for its foam and its dust, or None where it is not installed."""
    import json

    python = os.environ.get("POROUS_PORESPY", sys.executable)
    done = subprocess.run(
        [python, "-c", PORESPY],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    return json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 else None


def others(table):
    theirs = porespy()
    foam = [d for d in itertools.product(range(3), repeat=3) if d != (1, 1, 1)]
    dust = list(itertools.product((0, 1), repeat=3))[:6]
    for question, key, divisions, kept, level, voxels in (
        ("Sierpinski foam, 243³", "foam", 3, foam, 5, 243),
        ("Cantor dust of 8 levels, 256³", "dust", 2, dust, 8, 256),
    ):
        maps = [(np.eye(3) / divisions, np.array(d) / divisions) for d in kept]
        model = po.ifs(maps, level=level)
        po.voxelize(model, voxels=voxels, sampling="centre")
        ours, core, _ = best(
            lambda m=model, v=voxels: po.voxelize(m, voxels=v, sampling="centre"), 5
        )
        table.add(question, "porous", voxels**3, "voxels", ours, core, ratio=1.0)
        if theirs is None:
            table.add(question, "PoreSpy: not installed")
            continue
        seconds, cores = theirs[key]
        table.add(
            question,
            "PoreSpy",
            voxels**3,
            "voxels",
            seconds,
            cores,
            ratio=seconds / ours,
            core_ratio=cores / core,
        )


SETTINGS = {
    "formula_1": 7,  # the Menger sponge in [-1, 1]³
    "voxel_custom_limit_enabled": 1,  # to that box
    "voxel_max_iter": 30,
}
LIMIT = 600
"""Seconds that one export may take."""


def exported(program, voxels):
    """Return the sponge's voxels as mandelbulber2 exports them in slices, without a window."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "slices").mkdir()
        recipe = folder / "sponge.fract"
        recipe.write_text("# Mandelbulber settings file\n# version 2.20\n[main_parameters]\n")
        settings = {f"voxel_samples_{axis}": voxels for axis in "xyz"} | SETTINGS
        settings["voxel_image_path"] = folder / "slices"
        override = "#".join(f"{key}={value}" for key, value in settings.items())
        command = [program, "--nogui", "--voxel", "slice", "--override", override, str(recipe)]
        subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            env=os.environ | {"HOME": name},
            timeout=LIMIT,
            check=True,
        )
        slices = sorted((folder / "slices").glob("*.png"))
        return np.array([imread(path)[..., 0] for path in slices]) > 0  # white on black


def of_a_child(work):
    """Return seconds by the wall's clock and of the cores of a program, and what it made."""
    before, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    made = work()
    wall = time.perf_counter() - wall
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, made


def sponge(table):
    """Time mandelbulber2's export of voxels: those nearer to the sponge than it can tell."""
    question, voxels = "Menger sponge, 243³", 243
    cells = po.ifs(digits("menger"), level=5)
    limit = po.ifs(digits("menger"), level="limit")
    ours, core, grid = best(lambda: po.voxelize(cells, voxels=voxels, sampling="centre"), 5)
    sure, sure_core, cover = best(lambda: po.voxelize(limit, voxels=voxels, sampling="cover"), 3)
    table.add(question, "porous, centre", voxels**3, "voxels", ours, core, ratio=1.0)
    table.add(
        question,
        f"porous, certified cover, {(cover.fill > 0).mean():.0%} of the voxels marked",
        voxels**3,
        "voxels",
        sure,
        sure_core,
        ratio=sure / ours,
        core_ratio=sure_core / core,
    )
    program = shutil.which("mandelbulber2")
    if program is None:
        table.add(question, "mandelbulber2: not installed")
        return
    start, start_core, _ = of_a_child(lambda: exported(program, 3))
    wall, cores, marked = of_a_child(lambda: exported(program, voxels))
    assert marked.shape == grid.frame.shape
    assert marked[grid.solid].all()
    table.add(
        question,
        f"mandelbulber2, slices to PNG, its start taken off, {marked.mean():.0%} marked",
        voxels**3,
        "voxels",
        wall - start,
        cores - start_core,
        ratio=(wall - start) / ours,
        core_ratio=(cores - start_core) / core,
    )


# --- growth --------------------------------------------------------------------------------


def growth(table):
    bodies = {
        "fill of Menger 3, off the lattice": (po.ifs(digits("menger"), level=3), "fill"),
        "cover of six turned maps of 1/2": (po.ifs(turned(6, 0.5, 3), level="limit"), "cover"),
    }
    for name, (model, sampling) in bodies.items():
        times, amounts = [], []
        for voxels in (64, 128, 256, 512, 1024):
            seconds, cores, grid = best(
                lambda m=model, v=voxels, s=sampling: po.voxelize(m, voxels=v, sampling=s),
                1 if voxels > 500 else 3,
            )
            times.append((seconds, cores))
            # Of a cover, what costs is the voxels that are occupied.
            amount = grid.frame.size if sampling == "fill" else int((grid.fill > 0).sum())
            amounts.append(amount)
            unit = "voxels" if sampling == "fill" else "occupied voxels"
            table.add(f"growth, {name}", f"porous, {voxels}", amount, unit, seconds, cores)
        slope, core_slope = (
            np.polyfit(np.log(amounts), np.log([t[i] for t in times]), 1)[0] for i in (0, 1)
        )
        table.add(
            f"growth, {name}",
            "log-log slope",
            ratio=slope,
            core_ratio=core_slope,
            wanted="<= 1.05",
        )


def main():
    table = Table()
    for part in (
        copies,
        attractors,
        random_systems,
        overlap,
        filled,
        grown,
        surfaces,
        others,
        sponge,
        growth,
    ):
        part(table)
    table.write()


if __name__ == "__main__":
    main()
