"""Surfaces from voxels, with their steps, for tests of what smooths and simplifies them."""

import numpy as np

import porous as po
from porous.values import Frame, VoxelGrid
from porous.values.surface_topology import euler_number, pieces


def surface_of(fill, spacing=(1.0, 1.2, 0.9), origin=(5.0, -6.0, 70.0)):
    return po.extract_surface(VoxelGrid(Frame(origin, spacing, fill.shape), fill))


def gyroid(n=36, cells=2):
    x = np.linspace(0, 2 * np.pi * cells, n, endpoint=False)
    s, c = np.sin(x), np.cos(x)
    field = s[:, None, None] * c[:, None] + s[:, None] * c + s * c[:, None, None]
    return np.clip(127.5 + 200 * field, 0, 255).astype(np.uint8)[:, : n - 3, : n - 5]


def noise(seed, grey):
    random = np.random.default_rng(seed)
    fill = random.integers(0, 256, (8, 9, 7)).astype(np.uint8)
    return fill if grey else np.where(fill < 128, np.uint8(0), np.uint8(255))


def hollow():
    fill = np.zeros((14, 13, 15), np.uint8)
    fill[2:12, 2:11, 2:13] = 255
    fill[5:9, 5:8, 5:10] = 0
    fill[0, 0, 0] = 255
    return fill


def topology(surface):
    return euler_number(surface), int(pieces(surface).max()) + 1


def many(count):
    """A row of tetrahedra that do not touch."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    one = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    shifts = 3.0 * np.arange(count)[:, None, None] * [1, 0, 0]
    triangles = (one + 4 * np.arange(count)[:, None, None]).reshape(-1, 3)
    return po.SurfaceMesh((points + shifts).reshape(-1, 3), triangles)


def cancel(*_):
    raise po.Cancelled("enough")
