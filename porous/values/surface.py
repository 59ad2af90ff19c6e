"""A triangulated surface."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError
from porous.values.box import Box
from porous.values.units import check_unit
from porous.values.value import Value, frozen, frozen_whole

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

PART = 1 << 15
"""Triangles that are worked on at a time."""


@dataclass(frozen=True, eq=False)
class SurfaceMesh(Value):
    """Triangles, counter-clockwise seen from outside the solid.

    Parameters
    ----------
    points
        float64, shape (n, 3), in ``unit``.
    triangles
        int64, shape (t, 3), indices of points.
    unit
        Unit of length.
    labels
        int16, shape (t,): index into ``names`` of each triangle's part; all zero where not given.
    names
        Names of the parts: ``("WALL", "XMIN", …)``. Caps of periodic or open grids carry the name
        of the face they close; ``interface_area`` leaves them out.
    altered
        By how much simplification and smoothing have changed volume and area since the surface was
        made, in ``unit`` cubed and squared: measures add it to their uncertainties. Files do not
        hold it.

    Raises
    ------
    MeshError
        For NaN points, indices out of range, negative or infinite ``altered``. Whether the surface
        is closed is not asked here.
    """

    points: NDArray[np.float64] = field(repr=False)
    triangles: NDArray[np.int64] = field(repr=False)
    unit: str = "mm"
    labels: NDArray[np.int16] | None = field(default=None, repr=False)
    names: tuple[str, ...] = ("WALL",)
    altered: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        self._set("points", frozen(self.points, np.float64))
        self._set("triangles", frozen_whole(self.triangles, np.int64, "triangles", MeshError))
        check_unit(self.unit)
        points_checked(self.points, "surface")
        indices_checked(self.triangles, len(self.points), 3, "triangles")
        labels = np.zeros(len(self.triangles), np.int16) if self.labels is None else self.labels
        self._set("labels", frozen_whole(labels, np.int16, "labels", MeshError))
        self._set("names", tuple(self.names))
        volume, area = map(float, self.altered)
        if not (0 <= volume < np.inf and 0 <= area < np.inf):
            raise MeshError(
                f"altered: got {self.altered}; wanted a volume and an area, not below 0"
            )
        self._set("altered", (volume, area))
        self._check_labels()

    def _check_labels(self) -> None:
        assert self.labels is not None
        if self.labels.shape != (len(self.triangles),):
            raise MeshError(f"labels: got {self.labels.shape}; wanted one per triangle")
        if len(self.labels) and not 0 <= self.labels.min() <= self.labels.max() < len(self.names):
            raise MeshError(f"labels: wanted indices into the {len(self.names)} names")

    @property
    def box(self) -> Box:
        """The tight box of the points."""
        return Box.of_points(self.points)

    @property
    def corners(self) -> NDArray[np.float64]:
        """The triangles' corners, shape (t, 3, 3): triangle, corner, axis."""
        result: NDArray[np.float64] = self.points[self.triangles]
        return result

    @property
    def area_vectors(self) -> NDArray[np.float64]:
        """Outward normals as long as the triangles' areas, shape (t, 3), in ``unit`` squared."""
        result = np.empty((len(self.triangles), 3))
        for part, corners in self._parts():
            result[part] = _area_vectors(corners)
        return result

    @property
    def areas(self) -> NDArray[np.float64]:
        """The triangles' areas, shape (t,), in ``unit`` squared."""
        result = np.empty(len(self.triangles))
        for part, corners in self._parts():
            vectors = _area_vectors(corners)
            result[part] = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
        return result

    @cached_property
    def area(self) -> float:
        """Sum of the triangles' areas, in ``unit`` squared."""
        return float(self.areas.sum())

    @property
    def cones(self) -> NDArray[np.float64]:
        """Volumes between the triangles and the middle of the points, shape (t,), signed.

        Those of a closed piece add up to what it encloses, negative where it is inside out.
        """
        result = np.empty(len(self.triangles))
        centre = self.points.mean(axis=0) if len(self.points) else np.zeros(3)
        for part, corners in self._parts():
            heights = (corners[:, 0] + corners[:, 1] + corners[:, 2]) / 3 - centre
            result[part] = np.einsum("ij,ij->i", heights, _area_vectors(corners)) / 3
        return result

    @cached_property
    def volume(self) -> float:
        """Enclosed volume by the divergence theorem, in ``unit`` cubed."""
        return float(self.cones.sum())

    @property
    def is_stepped(self) -> bool:
        """Whether every triangle lies across an axis, as the faces of voxels do."""
        return all(
            ((_area_vectors(corners) != 0).sum(axis=1) <= 1).all() for _, corners in self._parts()
        )

    def _parts(self) -> Iterator[tuple[slice, NDArray[np.float64]]]:
        """Yield triangles and their corners, as many at a time as caches hold."""
        for start in range(0, len(self.triangles), PART):
            part = slice(start, start + PART)
            yield part, self.points[self.triangles[part]]


def _area_vectors(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    result = np.empty_like(u)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[:, i] = (u[:, j] * v[:, k] - u[:, k] * v[:, j]) / 2
    return result


def points_checked(points: NDArray[np.float64], what: str) -> None:
    """Raise ``MeshError`` where points are not (n, 3) finite numbers."""
    if points.ndim != 2 or points.shape[1:] != (3,):
        raise MeshError(f"{what} points: got shape {points.shape}; wanted (n, 3)")
    if not np.isfinite(points).all():
        bad = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise MeshError(f"{what} points: point {bad} is {points[bad].tolist()}; wanted numbers")


def indices_checked(cells: NDArray[np.int64], points: int, corners: int, what: str) -> None:
    """Raise ``MeshError`` where cells are not (n, corners) indices below ``points``."""
    if cells.ndim != 2 or cells.shape[1:] != (corners,):
        raise MeshError(f"{what}: got shape {cells.shape}; wanted (n, {corners})")
    # One pass over large meshes: seen as unsigned, a negative index is a huge one.
    if cells.size and int(cells.view(np.uint64).max()) >= points:
        raise MeshError(
            f"{what}: indices run from {cells.min()} to {cells.max()}; there are {points} points"
        )
