"""Do rough skins have the dimension and the amplitude asked for, by resolution?

A block of 26 × 26 mm has one rough face, Sq 0.3 mm, with one or four of the largest bumps along its
edge. Each row tells what was measured of its voxels for several seeds, as the mean and the worst
error: the dimension by the variogram and by the variation, over the distances told (in voxels, the
longest of any seed), Sq and the porosity; and the share of seeds whose dimension by the variogram
is within twice its stated uncertainty, of which the mean is told too. Of bumps that all point
outwards there is one surface. Where the environment variable POROUS_SMALL is set two seeds are
enough.
"""

import csv
import os
import time
from pathlib import Path

import numpy as np

from porous import Skin, measures, rough, voxelize

RESULTS = Path(os.environ.get("POROUS_RESULTS", Path(__file__).parent / "results"))
AMPLITUDE = 0.3
SEEDS = range(2 if os.environ.get("POROUS_SMALL") else 10)
CASES = [(bumps, outwards) for outwards in (False, True) for bumps in (1, 4)]


def measured(dimension, voxels, bumps, seed, outwards):
    """Return a block's dimensions, Sq, the error of its porosity and the longest distance."""
    skin = Skin("ZMAX", dimension, AMPLITUDE, bumps, seed, outwards)
    model = rough((26.0, 26.0, 4.0), [skin])
    grid = voxelize(model, voxels=voxels)
    heights = measures.height_map(grid, "ZMAX", within=model.rough_faces["ZMAX"])
    rows = measures.roughness(heights, "ZMAX")
    exact = measures.measure(model)["porosity"].value
    return [
        rows["dimension_zmax", "variogram"].value,
        rows["dimension_zmax", "variogram"].uncertainty,
        rows["dimension_zmax", "variation"].value,
        rows["sq_zmax"].value,
        measures.porosity(grid).value - exact,
        measures.variogram(heights).distances.max(),
    ]


def row(dimension, voxels, bumps, outwards):
    begin = time.process_time()
    seeds = SEEDS[:1] if outwards else SEEDS
    found = np.array([measured(dimension, voxels, bumps, seed, outwards) for seed in seeds])
    error = np.abs(found[:, 0] - dimension)
    return {
        "bumps": f"{bumps}, outwards" if outwards else str(bumps),
        "voxels": voxels,
        "distances": f"4 to {found[:, 5].max():.0f}",
        "dimension": dimension,
        "by_variogram": f"{found[:, 0].mean():.3f}",
        "worst_error": f"{error.max():.3f}",
        "stated": f"{found[:, 1].mean():.3f}",
        "within_twice": f"{(error <= 2 * found[:, 1]).mean():.2f}",
        "by_variation": f"{found[:, 2].mean():.3f}",
        "sq_error_percent": f"{100 * (found[:, 3] / AMPLITUDE - 1).mean():+.2f}",
        "porosity_error": f"{np.abs(found[:, 4]).max():.1e}",
        "core_seconds": f"{(time.process_time() - begin) / len(seeds):.1f}",
    }


def main():
    rows = []
    for bumps, outwards in CASES:
        for voxels in (192, 256) if outwards and bumps > 1 else (128, 192, 256):
            for dimension in (2.1, 2.2, 2.3):
                rows.append(row(dimension, voxels, bumps, outwards))
                print(*rows[-1].values(), sep="\t")
    with (RESULTS / f"{Path(__file__).stem}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
