"""How right areas and volumes from voxels are: Crofton, triangles, voxel faces, by resolution.

Bodies of known area, about as many voxels across as a row says, are sampled in random places and
directions. Each row tells the mean and the largest error over these, the mean uncertainty that the
measure stated, and in how many of them the truth lay within once and within twice that.
"""

import csv
import math
import os
from pathlib import Path

import numpy as np

from porous import extract_surface, measures
from porous.values import CENTRE, FILL, Frame, VoxelGrid

RESULTS = Path(os.environ.get("POROUS_RESULTS", Path(__file__).parent / "results"))
PATTERNS = {"fill": FILL, "centre": CENTRE}
SIZES = (5, 10, 20, 40)
PLACES = 8


def sampled(inside, size, sampling, random):
    """Return the grid of a body about the origin that is ``size`` voxels across."""
    n = math.ceil(size) + 4
    frame = Frame(tuple(-n / 2 + random.uniform(-0.5, 0.5, 3)), (1, 1, 1), (n, n, n))
    pattern = PATTERNS[sampling]
    points = np.column_stack(
        [np.repeat(pattern.rows, pattern.depths.shape[1], 0), pattern.depths.ravel()]
    )
    x, y, z = (frame.centres(axis) - 0.5 for axis in range(3))
    count = np.zeros(frame.shape, int)
    for a, b, c in points:
        count += inside((x + a)[:, None, None], (y + b)[None, :, None], (z + c)[None, None])
    full = len(points)
    fill = ((255 * count + full // 2) // full).astype(np.uint8)
    return VoxelGrid(frame, fill, sampling=sampling)


def ball(diameter, sampling, random):
    grid = sampled(
        lambda x, y, z: x**2 + y**2 + z**2 <= diameter**2 / 4, diameter, sampling, random
    )
    return grid, math.pi * diameter**2, math.pi * diameter**3 / 6


def cube_turned_by(turn):
    def cube(edge, sampling, random):
        matrix = turn(random)

        def inside(x, y, z):
            rows = [abs(a * x + b * y + c * z) <= edge / 2 for a, b, c in matrix]
            return rows[0] & rows[1] & rows[2]

        size = edge * np.abs(matrix).sum(axis=0).max()
        return sampled(inside, size, sampling, random), 6 * edge**2, edge**3

    return cube


def anyhow(random):
    return np.linalg.qr(random.normal(size=(3, 3)))[0]


def menger(voxels, sampling, _):
    """Return the level-2 sponge on its lattice, as many voxels to its finest cells."""
    cross = np.add.outer(np.add.outer(*[np.array([0, 1, 0])] * 2), np.array([0, 1, 0])) < 2
    solid = np.kron(np.kron(cross, cross), np.ones((voxels,) * 3, bool))
    side = len(solid)
    grid = VoxelGrid.of_solid(solid, Frame((0, 0, 0), (1, 1, 1), solid.shape), sampling=sampling)
    return grid, (2 * (20 / 9) ** 2 + 4 * (8 / 9) ** 2) * side**2, (20 / 27) ** 2 * side**3


BODIES = {
    "ball": (ball, SIZES, PLACES),
    "cube, any direction": (cube_turned_by(anyhow), SIZES, PLACES),
    "cube along the axes": (cube_turned_by(lambda _: np.eye(3)), SIZES, PLACES),
    "Menger 2 on its lattice": (menger, (1, 2, 4), 1),
}


def estimates(grid):
    """Yield quantity, method and measure of all that tells of area and volume."""
    for method in ("crofton", "voxel faces"):
        yield "area", method, measures.surface_area(grid, method=method)
    for method in ("voxel fill", "voxel count"):
        yield "volume", method, measures.volume(grid, method=method)
    surface = measures.measure(extract_surface(grid), grid=grid)
    yield "area", "triangles", surface["surface_area"]
    yield "volume", "triangles", surface["volume"]


def study(make, size, places, sampling):
    found = {}
    for seed in range(places):
        random = np.random.default_rng(seed)
        across = size * random.uniform(0.9, 1.1) if places > 1 else size
        grid, area, volume = make(across, sampling, random)
        truth = {"area": area, "volume": volume}
        for quantity, method, row in estimates(grid):
            errors = found.setdefault((quantity, method), [])
            errors.append(
                np.array([row.value - truth[quantity], row.uncertainty]) / truth[quantity]
            )
    for (quantity, method), pairs in found.items():
        error, doubt = np.array(pairs).T
        yield {
            "quantity": quantity,
            "method": method,
            "mean_error_percent": f"{100 * error.mean():+.2f}",
            "worst_error_percent": f"{100 * error[np.abs(error).argmax()]:+.2f}",
            "stated_percent": f"{100 * doubt.mean():.2f}",
            "within_once": f"{(np.abs(error) <= doubt).mean():.2f}",
            "within_twice": f"{(np.abs(error) <= 2 * doubt).mean():.2f}",
        }


def main():
    rows = []
    for body, (make, sizes, places) in BODIES.items():
        for size in sizes:
            for sampling in PATTERNS:
                for row in study(make, size, places, sampling):
                    rows.append({"body": body, "voxels": size, "sampling": sampling, **row})
                    print(*rows[-1].values(), sep="\t")
    with (RESULTS / f"{Path(__file__).stem}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
