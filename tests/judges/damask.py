"""What DAMASK's own library makes of its grids, and whether one of its own is the same."""

import json
import sys

sys.path.pop(0)  # this file has the library's name
import damask
import numpy as np


def told(path):
    grid = damask.GeomGrid.load(path)
    return {
        "cells": grid.cells.tolist(),
        "size": grid.size.tolist(),
        "origin": grid.origin.tolist(),
        "type": str(grid.material.dtype),
        "material": grid.material.reshape(-1, order="F").tolist(),
        "more": sorted(grid.initial_conditions),
    }


def same(path, folder):
    """Save what was loaded, load that, and say whether it is equal."""
    grid = damask.GeomGrid.load(path)
    made = damask.GeomGrid(np.array(grid.material), grid.size, grid.origin)
    made.save(f"{folder}/again.vti")
    return bool(damask.GeomGrid.load(f"{folder}/again.vti") == grid)


path, folder = sys.argv[1:]
json.dump({**told(path), "same": same(path, folder)}, sys.stdout)
