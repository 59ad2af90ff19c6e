"""What steps that alter a surface share: what they take, what they must keep, what they owe."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import MeshError
from porous.values import SurfaceMesh
from porous.values.surface_topology import defects, pieces

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]


class Pieces(NamedTuple):
    """The closed pieces of a surface."""

    of_triangle: Indices
    of_point: Indices
    """Of points that no triangle uses: 0."""
    euler_numbers: Indices
    """V − E + T of each, with 2 E = 3 T."""

    @property
    def number(self) -> int:
        """How many there are."""
        return len(self.euler_numbers)


def check_manifold(surface: SurfaceMesh, step: str) -> None:
    """Raise ``MeshError`` where ``surface`` is not a closed, oriented 2-manifold.

    Triangles without area are let through: they harm no topology.
    """
    if not len(surface.triangles):
        raise MeshError(f"{step}: the surface has no triangles; wanted a closed surface")
    found = defects(surface)
    names = ("open_edges", "nonmanifold_edges", "misoriented_edges", "nonmanifold_vertices")
    counts = {name.replace("_", " "): getattr(found, name) for name in names}
    wrong = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    if wrong:
        place = "(" + ", ".join(f"{v:.6g}" for v in found.first or ()) + ")"
        raise MeshError(
            f"{step}: the surface has {wrong}, the first defect at {place}; wanted a closed "
            "2-manifold, as marching cubes makes it"
        )


def pieces_of(surface: SurfaceMesh) -> Pieces:
    """Return the pieces of a closed 2-manifold."""
    of_triangle = pieces(surface)
    of_point = np.zeros(len(surface.points), np.int64)
    of_point[surface.triangles] = of_triangle[:, None]
    used = np.zeros(len(surface.points), bool)
    used[surface.triangles] = True
    count = int(of_triangle.max(initial=-1)) + 1
    vertices = np.bincount(of_point[used], minlength=count)
    triangles = np.bincount(of_triangle, minlength=count)
    return Pieces(of_triangle, of_point, vertices - triangles // 2)


def volumes_of(points: Floats, triangles: Indices, found: Pieces) -> Floats:
    """Return the volume that each piece encloses, negative about a cavity, shape (pieces,)."""
    a, b, c = points[triangles[:, 0]], points[triangles[:, 1]], points[triangles[:, 2]]
    cones = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    return np.asarray(np.bincount(found.of_triangle, cones, minlength=found.number))


def part_areas(surface: SurfaceMesh) -> Floats:
    """Return the area of each named part, shape (names,)."""
    assert surface.labels is not None
    areas = np.linalg.norm(surface.area_vectors, axis=1)
    return np.asarray(np.bincount(surface.labels, areas, minlength=len(surface.names)))


def altered(
    before: SurfaceMesh, points: Floats, triangles: Indices, labels: NDArray[np.int16]
) -> SurfaceMesh:
    """Return the surface that a step made of another, which owes what the step changed.

    By how much volume and area were changed (area part by part, so that no part's gain hides
    another's loss) is added to what ``before`` owes already.
    """
    new = SurfaceMesh(points, triangles, before.unit, labels, before.names)
    volume = abs(new.volume - before.volume)
    area = float(np.abs(part_areas(new) - part_areas(before)).sum())
    owed = (before.altered[0] + volume, before.altered[1] + area)
    return SurfaceMesh(new.points, new.triangles, new.unit, new.labels, new.names, owed)
