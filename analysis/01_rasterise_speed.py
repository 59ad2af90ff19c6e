"""How fast is sampling, told against the speed of memory in the same run?

For Menger sponges whose cells are voxels, `voxelize` is timed beside `np.empty` and `fill(1)` of
the same array, which touches every page of it (arrays below 32 MB may find pages that were touched
before); and so are the ways without a short cut: digit sets off the lattice, unions of cubes, of
tetrahedra and of balls, a closed mesh, an attractor's cover.
"""

import csv
import os
import time
from pathlib import Path

import numpy as np

import porous as po
from porous.models.automaton import of_maps
from porous.models.digits import named as digits
from porous.models.ifs import ifs
from porous.models.primitive import named, of_surface
from porous.values import SurfaceMesh

REPEATS = 5
FOLDER = Path(os.environ.get("POROUS_RESULTS", Path(__file__).parent / "results"))


def best(work, repeats=REPEATS):
    """Return the least time of some runs, in seconds; what a run makes is freed after it."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        made = work()
        times.append(time.perf_counter() - start)
        del made
    return min(times)


def touched(shape):
    """Allocate an array and touch all of its pages."""
    array = np.empty(shape, np.uint8)
    array.fill(1)
    return array


def rotations(count, ratio):
    """Return maps that turn and shrink: a fixed set of random ones."""
    random = np.random.default_rng(0)
    turned = [np.linalg.qr(random.normal(size=(3, 3)))[0] for _ in range(count)]
    return of_maps([(q * ratio, random.uniform(0, 0.5, 3)) for q in turned])


def mesh():
    """Return a solid that is not convex: an octahedron with a bite of a tetrahedron taken out."""
    solid = named("octahedron")
    middle = solid.points[solid.triangles[0]].mean(axis=0) * 0.5 + 0.25
    a, b, c = solid.triangles[0]
    top = len(solid.points)
    triangles = np.vstack([solid.triangles[1:], [(a, b, top), (b, c, top), (c, a, top)]])
    return of_surface(SurfaceMesh(np.vstack([solid.points, middle]), triangles))


def cases():
    """Yield a name, a model, the number of voxels and the sampling."""
    menger = digits("menger")
    for level, voxels in [(3, 81), (4, 243), (5, 486), (6, 729)]:
        for sampling in ("centre", "fill"):
            yield f"menger {level}, aligned", ifs(menger, level=level), voxels, sampling
    for voxels in (64, 250):
        yield "menger 3, not aligned", ifs(menger, level=3), voxels, "fill"
    maps = rotations(6, 0.5)
    for name in ("cube", "tetrahedron", "ball"):
        yield f"6 turned maps, level 4, {name}s", ifs(maps, level=4, primitive=name), 256, "fill"
    yield "6 turned maps, level 3, mesh", ifs(maps, level=3, primitive=mesh()), 256, "fill"
    yield "6 turned maps, level 4, cubes", ifs(maps, level=4), 256, "cover"
    yield "6 turned maps, limit", ifs(maps, level="limit"), 128, "cover"


def rows():
    """Time every case and the memory beside it."""
    for name, model, voxels, sampling in cases():
        slow = "aligned" not in name or "not" in name
        grid = po.voxelize(model, voxels=voxels, sampling=sampling)
        shape, solid = grid.frame.shape, float(grid.fill.mean()) / 255
        del grid
        repeats = 2 if slow else REPEATS
        took = best(lambda: po.voxelize(model, voxels=voxels, sampling=sampling), repeats)  # noqa: B023
        memory = best(lambda: touched(shape))  # noqa: B023
        yield {
            "body": name,
            "sampling": sampling,
            "voxels": "x".join(map(str, shape)),
            "solid_fraction": f"{solid:.6f}",
            "seconds": f"{took:.4f}",
            "fill_seconds": f"{memory:.4f}",
            "ratio_to_fill": f"{took / memory:.2f}",
            "million_voxels_per_second": f"{np.prod(shape) / took / 1e6:.1f}",
        }


def main():
    """Print the table and write it."""
    table = []
    for row in rows():
        print("  ".join(row.values()))
        table.append(row)
    with (FOLDER / "01_rasterise_speed.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(table[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)


if __name__ == "__main__":
    main()
