"""How far two sets are from each other: the Hausdorff distance, certified."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError, MeshError
from porous.values import Measure, SurfaceMesh, VoxelGrid
from porous.values.units import length_ratio

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Bools = NDArray[np.bool_]

    Subject = VoxelGrid | SurfaceMesh | NDArray[np.float64]

SAMPLES = 50_000
"""Points that a surface is sampled at, about, where no resolution is given."""

COMMON = 1e-6
"""Two grids share a lattice where their corners agree to this, in voxels."""


@dataclass(frozen=True)
class _Sampled:
    """Points of a set, and how far from them the set reaches at most."""

    points: Floats
    reach: float


def hausdorff_distance(a: Subject, b: Subject, *, resolution: float | None = None) -> Measure:
    """Return the Hausdorff distance of two sets: how far a point of one is from the other at most.

    Parameters
    ----------
    a, b
        Each a grid (the closed union of its solid voxels), a surface (its triangles, not what they
        enclose) or a point set, shape (n, 3), in the other's unit. A surface and a grid are not
        compared: one is a boundary, the other a body.
    resolution
        Surfaces are sampled so that every point of them is this close to a sample, in ``a``'s
        unit; by default as close as ``SAMPLES`` points allow.

    Returns
    -------
    Measure
        Of kind bound: the true distance lies within ``uncertainty`` of ``value``, in ``a``'s unit.
        Where samples of A and B reach within e_A and e_B of every point, the distance of A from B
        lies between d − e_B and d + e_A, d being that of the samples. Two grids of one lattice
        are within half a voxel diagonal of the distance of their voxels. Certificates of the grids
        themselves (``VoxelGrid.hausdorff``) are added: they tell of the sets that were covered.

    Raises
    ------
    GridError, MeshError
        Where a set is empty, or a grid meets a surface.
    """
    if resolution is not None and not 0 < resolution < math.inf:
        raise GridError(f"resolution: got {resolution}; wanted a length above zero")
    unit = _unit(a) or _unit(b) or "mm"
    kinds = {type(a), type(b)}
    if VoxelGrid in kinds and SurfaceMesh in kinds:
        raise GridError(
            "hausdorff_distance: got a grid and a surface, a body and a boundary; "
            "wanted two of a kind: extract the grid's surface"
        )
    if (
        isinstance(a, VoxelGrid)
        and isinstance(b, VoxelGrid)
        and (shift := _shift(a, b)) is not None
    ):
        low, high = _of_lattice(a, b, shift)
    else:
        spread = resolution or _resolution(a, b, unit)
        low, high = _of_samples(*(_sampled(s, unit, spread) for s in (a, b)))
    doubt = (high - low) / 2 + sum(_certificate(s, unit) for s in (a, b))
    of = "grid" if VoxelGrid in kinds else "surface"
    return Measure("hausdorff_distance", (low + high) / 2, unit, _METHODS[of], doubt, "bound", of)


_METHODS = {"grid": "voxel certified", "surface": "samples certified"}


def _unit(subject: Subject) -> str | None:
    if isinstance(subject, VoxelGrid):
        return subject.frame.unit
    return subject.unit if isinstance(subject, SurfaceMesh) else None


def _scale(subject: Subject, unit: str) -> float:
    return length_ratio(_unit(subject) or unit, unit)


def _certificate(subject: Subject, unit: str) -> float:
    if not isinstance(subject, VoxelGrid) or subject.hausdorff is None:
        return 0.0
    return subject.hausdorff * _scale(subject, unit)


def _shift(a: VoxelGrid, b: VoxelGrid) -> NDArray[np.int64] | None:
    """Return how many voxels b's first one lies beyond a's, where both are of one lattice."""
    ratio = length_ratio(b.frame.unit, a.frame.unit)
    spacing = np.array(a.frame.spacing)
    corners = np.array([np.array(b.frame.box.lower) * ratio, np.array(b.frame.box.upper) * ratio])
    steps = (corners - a.frame.box.lower) / spacing
    whole = np.rint(steps).astype(np.int64)
    if not np.abs(steps - whole).max() < COMMON or tuple(whole[1] - whole[0]) != b.frame.shape:
        return None
    return np.asarray(whole[0])


def _of_lattice(a: VoxelGrid, b: VoxelGrid, shift: NDArray[np.int64]) -> tuple[float, float]:
    """Return bounds on the distance of the solids of two grids of one lattice.

    A point of a voxel lies as far from the other set as the voxel's centre is from the nearest
    centre, or nearer: move both voxels onto each other. And half a diagonal nearer at most.
    """
    first = np.minimum(0, shift)
    shape = np.maximum(a.frame.shape, shift + b.frame.shape) - first
    one, other = _placed(a, -first, shape), _placed(b, shift - first, shape)
    steps = max(_farthest(one, other, a.frame.spacing), _farthest(other, one, a.frame.spacing))
    return max(0.0, steps - a.frame.diagonal / 2), steps


def _placed(grid: VoxelGrid, start: NDArray[np.int64], shape: NDArray[np.int64]) -> Bools:
    solid = grid.solid
    if not solid.any():
        raise GridError("hausdorff_distance: a grid has no solid voxel; wanted a set with points")
    if tuple(shape) == grid.frame.shape:
        return solid
    result = np.zeros(tuple(shape), bool)
    result[tuple(slice(s, s + n) for s, n in zip(start, grid.frame.shape, strict=True))] = solid
    return result


def _farthest(one: Bools, other: Bools, spacing: tuple[float, float, float]) -> float:
    from scipy.ndimage import distance_transform_edt

    if not (one & ~other).any():
        return 0.0
    return float(distance_transform_edt(~other, sampling=spacing)[one].max())


def _of_samples(a: _Sampled, b: _Sampled) -> tuple[float, float]:
    there, back = _directed(a.points, b.points), _directed(b.points, a.points)
    low = max(there - b.reach, back - a.reach, 0.0)
    return low, max(there + a.reach, back + b.reach)


def _directed(one: Floats, other: Floats) -> float:
    from scipy.spatial import KDTree

    return float(KDTree(other).query(one, workers=-1)[0].max())


def _resolution(a: Subject, b: Subject, unit: str) -> float:
    areas = [s.area * _scale(s, unit) ** 2 for s in (a, b) if isinstance(s, SurfaceMesh)]
    return math.sqrt(max(areas, default=0.0) / SAMPLES)


def _sampled(subject: Subject, unit: str, spread: float) -> _Sampled:
    scale = _scale(subject, unit)
    if isinstance(subject, VoxelGrid):
        return _voxel_centres(subject, scale)
    if isinstance(subject, SurfaceMesh):
        if not len(subject.triangles):
            raise MeshError(
                "hausdorff_distance: a surface has no triangles; wanted a set with points"
            )
        return _Sampled(*_refined(subject.corners * scale, spread))
    points = np.asarray(subject, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
        raise MeshError(
            f"hausdorff_distance: got points of shape {points.shape}; wanted (n, 3), finite, n ≥ 1"
        )
    return _Sampled(points, 0.0)


def _voxel_centres(grid: VoxelGrid, scale: float) -> _Sampled:
    index = np.argwhere(grid.solid)
    if not len(index):
        raise GridError("hausdorff_distance: a grid has no solid voxel; wanted a set with points")
    centres = np.stack([grid.frame.centres(axis)[index[:, axis]] for axis in range(3)], axis=1)
    return _Sampled(centres * scale, grid.frame.diagonal / 2 * scale)


def _refined(corners: Floats, spread: float) -> tuple[Floats, float]:
    """Return points of triangles (t, 3, 3), and how far from them the triangles reach.

    Triangles are quartered until no edge is longer than √3 · ``spread``: no point of a triangle
    is farther from its corners than its longest edge / √3.
    """
    done = []
    reach = 0.0
    while len(corners):
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
        small = edges <= math.sqrt(3) * spread
        if small.any():
            reach = max(reach, float(edges[small].max()) / math.sqrt(3))
            done.append(corners[small].reshape(-1, 3))
        corners = _quartered(corners[~small])
    return np.unique(np.concatenate(done), axis=0), reach


def _quartered(corners: Floats) -> Floats:
    a, b, c = np.moveaxis(corners, 1, 0)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])
