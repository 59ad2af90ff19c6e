"""What pynrrd makes of images: those it is given, and some of its own for us to read."""

import json
import sys
import zlib
from pathlib import Path

sys.path.pop(0)  # this file has the library's name
import nrrd
import numpy as np


def told(path):
    values, header = nrrd.read(path)
    return {
        "size": values.shape,
        "directions": header["space directions"].tolist(),
        "origin": header["space origin"].tolist(),
        "units": header["space units"],
        "crc32": zlib.crc32(np.ascontiguousarray(values.transpose(2, 1, 0))),
    }


def written(folder):
    x, y, z = np.meshgrid(np.arange(5), np.arange(6), np.arange(7), indexing="ij")
    values = (x * 31 + y * 7 + z * 3) % 120
    place = {
        "space dimension": 3,
        "space directions": np.diag([0.25, 1.5, 3.0]),
        "space origin": np.array([-2.0, 0.125, 7.5]),
        "space units": ["um", "um", "um"],
    }
    for form in ("u1", "i2", ">u2", ">i4", "<u8", "<f4", ">f8"):
        for encoding in ("raw", "gzip", "ascii", "bzip2"):
            for suffix in (".nrrd", ".nhdr"):
                name = f"{form.strip('<>')}-{'big' if form[0] == '>' else 'small'}-{encoding}"
                path = Path(folder) / f"{name}{suffix}"
                header = {**place, "encoding": encoding}
                nrrd.write(str(path), values.astype(form), header, detached_header=False)
                yield path.name
    flips = np.diag([-0.25, 1.5, -3.0])
    nrrd.write(str(Path(folder) / "flipped.nrrd"), values, {**place, "space directions": flips})
    yield "flipped.nrrd"
    turned = place["space directions"][[1, 0, 2]]
    nrrd.write(str(Path(folder) / "turned.nrrd"), values, {**place, "space directions": turned})
    nrrd.write(str(Path(folder) / "spacings.nrrd"), values, {"spacings": [0.25, 1.5, 3.0]})


command, *paths = sys.argv[1:]
if command == "write":
    json.dump(list(written(*paths)), sys.stdout)
else:
    json.dump([told(path) for path in paths], sys.stdout)
