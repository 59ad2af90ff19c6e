"""How fast surfaces are extracted, against scikit-image's Lewiner and VTK's flying edges.

All on the same grids in one run, in turns, best of several. Everybody gets the grid in memory and
gives arrays; the others get it padded already, and give 32-bit points without labels where the
kernel gives 64-bit ones with. ``extract_surface`` also makes a checked value of them, and
``stream_surface`` a PLY file on disk, slab by slab. Only the kernel uses several cores; seconds of
cores tell the work where others load the machine.
"""

import csv
import os
import tempfile
import time
from pathlib import Path

import numpy as np
import pyvista
from skimage.measure import marching_cubes as lewiner
from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

from porous.kernels.surface import marching_cubes
from porous.stages import extract_surface, stream_surface
from porous.values import Frame, VoxelGrid

RESULTS = Path(os.environ.get("POROUS_RESULTS", Path(__file__).parent / "results"))
BARS = {"scikit-image Lewiner": 20.0, "VTK flying edges": 2.0}
"""How many times faster than these the kernel shall be on large grids."""
LARGE = 10_000_000


def menger(level):
    cross = np.add.outer(np.add.outer(*[np.array([0, 1, 0])] * 2), np.array([0, 1, 0]))
    solid = np.ones((1, 1, 1), bool)
    for _ in range(level):
        solid = np.kron(solid, cross < 2)
    return np.where(solid, np.uint8(255), np.uint8(0))


def gyroid(n, cells):
    x = np.linspace(0, 2 * np.pi * cells, n, endpoint=False)
    s, c = np.sin(x), np.cos(x)
    field = s[:, None, None] * c[:, None] + s[:, None] * c + s * c[:, None, None]
    return np.clip(127.5 + 200 * field, 0, 255).astype(np.uint8)


def best(contestants):
    """Seconds by the wall's clock and of the cores, each of the best run; number of triangles.

    They take turns, so that what else the machine does meets all of them.
    """
    times = {who: [] for who in contestants}
    triangles = {}
    for turn in range(max(repeats for _, repeats in contestants.values())):
        for who, (work, repeats) in contestants.items():
            if turn < repeats:
                wall, core = time.perf_counter(), time.process_time()
                triangles[who] = work()
                times[who].append((time.perf_counter() - wall, time.process_time() - core))
    return {who: (*np.min(rows, axis=0), triangles[who]) for who, rows in times.items()}


def on_one_thread(work):
    def run():
        before = os.environ.pop("POROUS_THREADS", None)
        os.environ["POROUS_THREADS"] = "1"
        try:
            return work()
        finally:
            del os.environ["POROUS_THREADS"]
            if before is not None:
                os.environ["POROUS_THREADS"] = before

    return run


def flying_edges(image):
    def run():
        filtered = vtkFlyingEdges3D()
        filtered.SetInputData(image)
        filtered.SetValue(0, 127.5)
        filtered.ComputeNormalsOff()
        filtered.ComputeGradientsOff()
        filtered.ComputeScalarsOff()
        filtered.Update()
        return filtered.GetOutput().GetNumberOfPolys()

    return run


def contestants(fill):
    grid = VoxelGrid(Frame((0, 0, 0), (1, 1, 1), fill.shape), fill)
    padded = np.pad(fill, 1)
    image = pyvista.ImageData(dimensions=padded.shape)
    image.point_data["fill"] = padded.ravel(order="F")
    image.set_active_scalars("fill")

    def stage():
        return len(extract_surface(grid).triangles)

    def stream():
        with tempfile.TemporaryDirectory() as folder:
            return stream_surface(grid, Path(folder) / "surface.ply").triangles

    def kernel():
        return len(marching_cubes(grid.fill, grid.frame)[1])

    return {
        "porous kernel": (kernel, 25),
        "porous kernel, one thread": (on_one_thread(kernel), 10),
        "porous extract_surface": (stage, 10),
        "porous stream_surface": (stream, 2),
        "scikit-image Lewiner": (lambda: len(lewiner(padded, 127.75)[1]), 3),
        "VTK flying edges": (flying_edges(image), 10),
    }


def main():
    rows = []
    for name, fill in (
        ("Menger 4", menger(4)),
        ("Menger 5", menger(5)),
        ("gyroid 128", gyroid(128, 2)),
        ("gyroid 256", gyroid(256, 4)),
    ):
        ours = None
        for who, (seconds, cores, triangles) in best(contestants(fill)).items():
            ours = (seconds, cores) if ours is None else ours
            bar = BARS.get(who) if fill.size > LARGE else None
            rows.append(
                {
                    "grid": name,
                    "voxels": fill.size,
                    "method": who,
                    "triangles": triangles,
                    "seconds": f"{seconds:.4f}",
                    "core_seconds": f"{cores:.4f}",
                    "mega_triangles_per_second": f"{triangles / seconds / 1e6:.1f}",
                    "times_as_long_as_the_kernel": f"{seconds / ours[0]:.2f}",
                    "times_the_kernels_core_seconds": f"{cores / ours[1]:.2f}",
                    "load_of_the_machine": f"{os.getloadavg()[0]:.1f}",
                    "wanted_at_least": "" if bar is None else f"{bar:g}",
                    "met": "" if bar is None else "yes" if seconds / ours[0] >= bar else "no",
                }
            )
            print(*rows[-1].values(), sep="\t")
    with (RESULTS / f"{Path(__file__).stem}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
