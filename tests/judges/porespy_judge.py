"""Measure an image with PoreSpy: its porosity, and the porosity's profiles along the axes."""

import json
import sys

import numpy as np
import porespy

with np.load(sys.argv[1]) as given:
    image = given["im"]
profiles = [list(porespy.metrics.porosity_profile(image, axis=axis).porosity) for axis in range(3)]
porosity = float(porespy.metrics.porosity(image))
sys.stdout.write(json.dumps({"porosity": porosity, "profiles": profiles}) + "\n")
