"""What netCDF's own library finds in Exodus files, in double precision, read as the manual says."""

import json
import sys

import netCDF4
import numpy as np

TETRAHEDRA = {
    "TET": [[0, 1, 2, 3]],
    "HEX": [[0, 1, 2, 6], [0, 5, 1, 6], [0, 4, 5, 6], [0, 7, 4, 6], [0, 3, 7, 6], [0, 2, 3, 6]],
    "WED": [[0, 1, 2, 5], [0, 1, 5, 4], [0, 4, 5, 3]],
}
"""How cells with flat faces are cut; corners by the manual's figures, from 0."""


def names(file, variable):
    there = variable in file.variables
    return [str(name) for name in netCDF4.chartostring(file[variable][:])] if there else []


def sets(file, code, entry):
    return {
        name: len(set(zip(*(file[f"{e}{code}{i}"][:].tolist() for e in entry), strict=True)))
        for i, name in enumerate(names(file, f"{code}_names"), 1)
    }


def judge(path):
    with netCDF4.Dataset(path) as file:
        points = np.stack([file[f"coord{axis}"][:].filled() for axis in "xyz"], axis=1)
        blocks, volume, least = {}, 0.0, float("inf")
        for i, name in enumerate(names(file, "eb_names"), 1):
            cells = file[f"connect{i}"]
            kind = cells.elem_type
            blocks[name] = [kind, len(cells)]
            for cut in TETRAHEDRA[kind[:3]]:
                a, b, c, d = (points[cells[:].filled()[:, k] - 1] for k in cut)
                six = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)
                volume, least = volume + six.sum() / 6, min(least, six.min())
        ids = [
            file[f"{c}_prop1"][:].tolist() for c in ("ss", "ns") if f"{c}_prop1" in file.variables
        ]
        return {
            "model": file.data_model,
            "word": str(points.dtype),
            "nodes": len(file.dimensions["num_nodes"]),
            "blocks": blocks,
            "volume": volume,
            "least": least,
            "ids": [number for some in ids for number in some],
            "map": file["elem_num_map"][:].tolist(),
            "said": names(file, "info_records"),
            "node_sets": sets(file, "ns", ["node_"]),
            "face_sets": sets(file, "ss", ["elem_", "side_"]),
            "cell_sets": sets(file, "els", ["elem_"]),
        }


results = [judge(path) for path in sys.argv[1:]]
json.dump(results[0] if len(results) == 1 else results, sys.stdout)
