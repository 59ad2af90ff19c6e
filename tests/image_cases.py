"""Grids and images that the tests of image formats share; axes are unequal."""

import zlib

import numpy as np

from porous.values import Frame, VoxelGrid

SHAPE = (5, 6, 7)
SPACING, CENTRE = (0.25, 1.5, 3.0), (-2.0, 0.125, 7.5)
CORNER = (-2.125, -0.625, 6.0)
"""Outer corner of the first voxel of what the judges write."""


def ramp(form=np.int64):
    """Return the grey values that the judges write, axes (x, y, z)."""
    x, y, z = np.indices(SHAPE)
    return ((x * 31 + y * 7 + z * 3) % 120).astype(form)


def grey_grid(*, bulk=True, unit="um", start=(3, 0, 4)):
    """Return a grid that says all that a grid can say."""
    fill = np.random.default_rng(3).integers(0, 256, SHAPE).astype(np.uint8)
    spacing = (1 / 3, 2.0, 3.5)
    frame = Frame((0.1, -0.2, 1 / 3), spacing, SHAPE, (True, False, True), unit, start)
    return VoxelGrid(frame, fill, fill[::-1] if bulk else None, "cover", 0.25, 0.125)


def first_centre(frame):
    return [a + h / 2 for a, h in zip(frame.box.lower, frame.spacing, strict=True)]


def in_file_order(values):
    """Return the sum of the bytes with x fastest, as judges tell it."""
    return zlib.crc32(np.ascontiguousarray(values.transpose(2, 1, 0)))


def on_disk(folder, name, data):
    path = folder / name
    path.write_bytes(data)
    return path
