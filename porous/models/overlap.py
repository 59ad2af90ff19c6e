"""What is known of an attractor whose parts overlap, so that voxels can be sought backwards."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.kernels.cover import System
    from porous.kernels.overlap import Reference

    Floats = NDArray[np.float64]

MUCH = 1.2
"""Sum of the maps' determinants from which the words at a place become ever more."""

SLOW = 0.95
"""Maps that contract less in some direction leave the distance from a net too uncertain."""

CELLS = 128
"""Cells of the net along the attractor's longest edge."""

IMAGES = 40
"""Words of the net, at most, if there are more than maps."""

ROOM = 2
"""Cells about the attractor."""


def overlaps(system: System) -> bool:
    """Tell whether words at a place become ever more, and can be sought backwards.

    That is for one state with invertible maps that contract.
    """
    if len(system.balls) > 1 or len(system.maps) < 2:
        return False
    linear = system.maps[:, :, :3]
    amount = np.abs(np.linalg.det(linear))
    largest = np.linalg.norm(linear, 2, axis=(1, 2))
    upright = amount > 1e-3 * largest**3  # the inverses do not stretch too unequally
    return bool(amount.sum() > MUCH and largest.max() <= SLOW and upright.all())


def reference(system: System) -> Reference:
    """Return a net of a one-state attractor and the distances from it.

    Points of the attractor, one per cell of a grid that their images under all words of a length
    reach: with X those points and δ a cell's diagonal, every T_w(x) is within δ of X, so that every
    point of the attractor is within δ / (1 − s) of X, s being the largest norm of these T_w.
    """
    from scipy.ndimage import distance_transform_edt

    from porous.kernels.overlap import Reference, spread

    maps = _words(system.maps)
    middle, half = system.blocks[0, :3], system.blocks[0, 3:]
    edge = 2 * float(half.max()) / CELLS
    shape = tuple(int(n) + 2 * ROOM for n in np.maximum(np.ceil(2 * half / edge), 1))
    low = middle - edge * np.array(shape) / 2
    points = spread(maps, system.points[0], low, edge, shape)
    empty = np.ones(shape, bool)
    cells = np.clip(((points - low) / edge).astype(np.int64), 0, np.array(shape) - 1)
    empty[tuple(cells.T)] = False
    index = np.zeros(shape, np.int32)
    index[tuple(cells.T)] = np.arange(len(points))
    distance, to = distance_transform_edt(empty, sampling=edge, return_indices=True)
    diagonal = edge * math.sqrt(3)
    contraction = float(np.linalg.norm(maps[:, :, :3], 2, axis=(1, 2)).max())
    # From a place to its cell's centre, from the other cell's centre to its point: half each.
    doubt = diagonal / (1 - contraction) + diagonal
    return Reference(
        low,
        edge,
        distance.astype(np.float32),
        index[tuple(to)],
        points,
        doubt * (1 + 1e-5),  # covers the distances' rounding
    )


def _words(maps: Floats) -> Floats:
    """Return the maps of all words of some length: the longer, the stronger they contract."""
    result = maps
    while len(result) * len(maps) <= IMAGES:
        linear = np.einsum("kab,mbc->kmac", result[:, :, :3], maps)
        linear[:, :, :, 3] += result[:, None, :, 3]
        result = linear.reshape(-1, 3, 4)
    return result
