"""What h5py makes of HDF5 files of voxels."""

import json
import sys
import zlib

import h5py
import numpy as np


def plain(value):
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value


def told(path):
    with h5py.File(path, "r") as file:
        sets = {
            name: {
                "shape": data.shape,
                "type": str(data.dtype),
                "chunks": data.chunks,
                "labels": [dim.label for dim in data.dims],
                "element_size_um": plain(data.attrs["element_size_um"]),
                "crc32": zlib.crc32(data[()]),
            }
            for name, data in file.items()
        }
        return {"sets": sets, **{name: plain(value) for name, value in file.attrs.items()}}


json.dump([told(path) for path in sys.argv[1:]], sys.stdout)
