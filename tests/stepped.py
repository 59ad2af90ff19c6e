"""Surfaces from voxels, with their steps, for tests of what smooths and simplifies them."""

import os
from functools import partial

import numpy as np
import pytest
from scipy import ndimage

import porous as po
from porous import presets
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


def blobs(seed):
    """Smooth noise, grey or binary, of unequal sides."""
    random = np.random.default_rng(seed)
    field = random.normal(size=(20 + seed, 18 + seed, 17 + seed))
    field = ndimage.gaussian_filter(field, random.uniform(0.8, 2.5), mode="wrap")
    values = 127.5 + field / field.std() * random.uniform(20, 300)
    fill = np.clip(values, 0, 255).astype(np.uint8)
    return np.where(fill < 128, np.uint8(0), np.uint8(255)) if seed % 2 else fill


def of_preset(name):
    model = po.build(po.load(name, set={"voxels.voxels": 47}))
    return po.extract_surface(po.voxelize(model, voxels=47))


def hundred(every=1):
    """Surfaces of a hundred bodies and more: noise, blobs, sheets, and presets at 47 voxels.

    With ``every`` 10 each tenth of them, and the others are not made.
    """
    fills = [(noise, seed, grey) for seed in range(30) for grey in (False, True)]
    fills += [*((blobs, seed) for seed in range(20)), (gyroid,), (hollow,)]
    surfaces = [lambda fill=fill, told=told: surface_of(fill(*told)) for fill, *told in fills]
    surfaces += [partial(of_preset, name) for name in presets.names()]
    return (surface() for surface in surfaces[::every])


def crossings(surface):
    """Return how many pairs of triangles pass through each other: libigl judges, exactly."""
    try:
        from igl.copyleft import cgal
    except ImportError:
        missing = "libigl is not installed here"
        (pytest.fail if os.environ.get("CI") else pytest.skip)(missing)
    points, triangles = surface.points.copy(), surface.triangles.copy()
    return len(cgal.remesh_self_intersections(points, triangles, detect_only=True)[2])


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
