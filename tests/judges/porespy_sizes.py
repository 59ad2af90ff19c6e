"""Measure an image with PoreSpy: local thickness, chords along x and two-point correlation, timed.

Arguments: an NPZ file with ``im`` (True is pore), how often the thickness is taken, and where to
write what was found, as NPZ. Prints seconds by the wall's clock and of the cores.
"""

import json
import logging
import sys
import time
import warnings

import numpy as np

warnings.filterwarnings("ignore")
logging.disable(logging.CRITICAL)
import porespy  # noqa: E402

porespy.settings.tqdm["disable"] = True


def timed(work, repeats):
    """Return what a work gives, and its seconds by the wall's clock and of the cores, the best."""
    times = []
    for _ in range(repeats):
        wall, core = time.perf_counter(), time.process_time()
        found = work()
        times.append((time.perf_counter() - wall, time.process_time() - core))
    return found, [min(each) for each in zip(*times, strict=True)]


image = np.load(sys.argv[1])["im"]
small = image[:32, :32, :32]
porespy.filters.local_thickness(small)  # what compiles
porespy.metrics.two_point_correlation(small)
radii, thickness_seconds = timed(lambda: porespy.filters.local_thickness(image), int(sys.argv[2]))
bins = np.arange(0.5, min(image.shape) // 2, 1.0)
curve, curve_seconds = timed(lambda: porespy.metrics.two_point_correlation(image, bins=bins), 1)
chords = porespy.filters.apply_chords(image, spacing=1, axis=0, trim_edges=True)
lengths, chord_seconds = timed(lambda: porespy.metrics.chord_counts(chords), 1)
said = {
    "porosity": float(porespy.metrics.porosity(image)),
    "radius_median": float(np.median(radii[image])),
    "radius_mean": float(radii[image].mean()),
    "chord_mean": float(lengths.mean()),
    "curve": list(map(float, curve.probability_scaled)),
    "seconds": {
        "thickness": thickness_seconds,
        "curve": curve_seconds,
        "chords": chord_seconds,
    },
}
np.savez(sys.argv[3], radii=radii)
sys.stdout.write(json.dumps(said) + "\n")
