"""The step from a stepped surface to a smooth one, of the same triangles and volume."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.errors import MeshError
from porous.kernels.crossings import crossing
from porous.memory import check_memory
from porous.stages._altered import Pieces, altered, check_manifold, pieces_of, volumes_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.values import SurfaceMesh

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]
    Progress = Callable[[str, float], None]

SHRINK, GROW = 0.5, -0.53
"""Taubin's λ and μ: 1/λ + 1/μ = 0.11 is the frequency below which nothing is smoothed away."""

REACH = 0.5
"""How far a point may move unless told otherwise: this part of the mean length of an edge."""

AXIS_OF = {"XMIN": 0, "XMAX": 0, "YMIN": 1, "YMAX": 1, "ZMIN": 2, "ZMAX": 2}
"""Points of caps stay in the plane across this axis."""

CLOSE = 1e-12
"""Part of a piece's volume to which it is restored …"""
ROUNDING = 4e-15
"""… but for rounding: relative to its area times the body's size."""

ROUNDS = 40
TAMED = 30
GENTLY = 5
"""Steps towards a volume; how often points about a fold or a crossing are taken back: some times by
half, then for good with their neighbours."""

BYTES = 500
"""Memory per triangle while a surface is smoothed, about."""


def smooth(
    surface: SurfaceMesh,
    *,
    iterations: int = 10,
    reach: float | None = None,
    volume: float | None = None,
    progress: Progress | None = None,
) -> SurfaceMesh:
    """Return the surface with its steps smoothed away, each piece keeping its volume.

    G. Taubin 1995 (SIGGRAPH '95, 351): points are moved towards the mean of their neighbours and
    away again, which takes away what changes from point to point and leaves the shape. After
    each step the pieces' volumes are restored along the normals. Triangles stay as they are, so
    topology does; points of caps (XMIN … ZMAX) stay in their planes; no point moves further than
    ``reach``, so that no point of either surface is further than that from the other. Where a
    triangle would be turned over, or would cross or touch another, its points are taken back: so
    a surface that does not cross itself never does.

    Parameters
    ----------
    surface
        Closed, oriented, 2-manifold.
    iterations
        Number of steps, zero or more; 0 changes nothing but for ``volume``.
    reach
        In ``surface.unit``, above zero; half the mean length of an edge (about a third of a
        voxel) where not given.
    volume
        What the surface is to enclose, in ``surface.unit`` cubed; what it does where not given.
        Marching cubes rounds edges and corners off, of a tetrahedron with edges of 40 voxels 1 %;
        the fills' sum, ``measure(grid)["volume"]``, is right to 1e-4. The difference is shared
        out by area, as one step along the normals. A piece that cannot have its share without
        harm stays as it was.
    progress
        Called as ``progress("smooth", done)`` with done in 0 … 1.

    Returns
    -------
    SurfaceMesh
        Of the same triangles and labels; edges and corners of the body are rounded. ``altered``
        says by how much volume and area were changed, and measures add it to their uncertainties.

    Raises
    ------
    MeshError
        For negative iterations, reach or volume, or a surface that is not a closed 2-manifold.
    MemoryLimitError
        Where the work would not fit into memory.
    """
    if iterations < 0:
        raise MeshError(f"smooth: iterations: got {iterations}; wanted zero or more")
    if reach is not None and not reach > 0:
        raise MeshError(f"smooth: reach: got {reach}; wanted a length above zero")
    if volume is not None and not 0 < volume < np.inf:
        raise MeshError(f"smooth: volume: got {volume}; wanted one above zero")
    check_manifold(surface, "smooth")
    if not iterations and volume is None:
        return surface
    count = len(surface.triangles)
    check_memory(BYTES * count, f"smoothing {count} triangles", "Choose fewer voxels.")
    body = _Body.of(surface, reach, volume)
    moved = np.zeros_like(body.points)
    for step in range(iterations):
        moved = body.smoothed(moved)
        if progress is not None:
            progress("smooth", (step + 1) / (iterations + 1))
    moved = body.settled(moved)
    if progress is not None:
        progress("smooth", 1.0)
    assert surface.labels is not None
    return altered(surface, surface.points + moved, surface.triangles, surface.labels)


@dataclass(frozen=True)
class _Body:
    """A surface under way: where its points were, what they may do, what must stay."""

    given: Floats
    points: Floats
    """Those given, about their middle."""
    triangles: Indices
    free: Floats
    """1 where a point may move along an axis, 0 where it is of a cap across it; (n, 3)."""
    reach: float
    found: Pieces
    volumes: Floats
    """What each piece is to enclose."""
    slack: Floats
    """How closely the volume of each piece is restored."""
    sums: Any
    """Sparse (n, n): the means over the neighbours of each point."""
    folded: NDArray[np.bool_]
    """Triangles that lie against their neighbourhood from the start."""

    @classmethod
    def of(cls, surface: SurfaceMesh, reach: float | None, volume: float | None) -> _Body:
        points = surface.points - surface.points.mean(axis=0)
        found = pieces_of(surface)
        volumes = volumes_of(points, surface.triangles, found)
        areas = np.bincount(found.of_triangle, np.linalg.norm(surface.area_vectors, axis=1))
        rough = areas * float(np.abs(points).max())
        if volume is not None:
            volumes += (volume - volumes.sum()) * areas / max(areas.sum(), np.finfo(float).tiny)
        if reach is None:
            sides = surface.corners - np.roll(surface.corners, 1, axis=1)
            reach = REACH * float(np.linalg.norm(sides, axis=2).mean())
        return cls(
            surface.points,
            points,
            surface.triangles,
            _freedom(surface),
            reach,
            found,
            volumes,
            CLOSE * np.abs(volumes) + ROUNDING * rough,
            _means(surface.triangles, len(points)),
            _folded(points, surface.triangles),
        )

    def smoothed(self, moved: Floats) -> Floats:
        """Return displacements after one more step of both kinds, volumes about restored."""
        for factor in (SHRINK, GROW):
            place = self.points + moved
            moved = moved + factor * self.free * (self.sums @ place - place)
        moved = self._held(moved)
        normals, areas = self._directions(moved)
        lost = self.volumes - volumes_of(self.points + moved, self.triangles, self.found)
        return self._held(moved + self._along(normals, lost, areas))

    def settled(self, moved: Floats) -> Floats:
        """Return displacements that harm no triangle and restore every volume."""
        body = self
        for tried in range(TAMED):
            moved, lost = body._restored(moved)
            worse = self._harmed(moved)
            if not worse.any() and not lost.any():
                return moved
            about = self._about(worse, 0 if tried < GENTLY else 1)
            moved = np.where(lost[self.found.of_point, None], 0.5 * moved, moved)
            moved[about] *= 0.5 if tried < GENTLY else 0.0
            if tried >= GENTLY:
                body = replace(body, free=np.where(about[:, None], 0.0, body.free))
        return self._taken_back(moved, worse, lost)

    def _taken_back(
        self, moved: Floats, worse: NDArray[np.bool_], lost: NDArray[np.bool_]
    ) -> Floats:
        """Return displacements without those of pieces that are harmed or have lost volume.

        A piece that stays where it was may be in the way of another, which then stays too.
        """
        while lost.any() or worse.any():
            bad = lost.copy()
            bad[self.found.of_triangle[worse]] = True
            there = bad[self.found.of_point]
            if not moved[there].any():  # of a surface that crossed itself from the start
                return np.zeros_like(moved)
            moved[there] = 0.0
            lost = np.zeros_like(lost)
            worse = self._harmed(moved)
        return moved

    def _harmed(self, moved: Floats) -> NDArray[np.bool_]:
        """Tell which triangles are folded over, or cross or touch another, and did not before."""
        folded = _folded(self.points + moved, self.triangles) & ~self.folded
        crossed = crossing(self.given + moved, self.triangles)
        if crossed.any():
            crossed &= ~crossing(self.given, self.triangles)
        return np.asarray(folded | crossed)

    def _about(self, chosen: NDArray[np.bool_], rings: int) -> NDArray[np.bool_]:
        """Tell which points are of chosen triangles, or of ``rings`` of triangles about them."""
        about = np.zeros(len(self.points), bool)
        for _ in range(rings + 1):
            about[self.triangles[chosen]] = True
            chosen = np.asarray(about[self.triangles].any(axis=1))
        return about

    def _restored(self, moved: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return displacements of the pieces' own volumes, and which pieces have not got them."""
        normals, areas = self._directions(moved)
        steps = np.zeros(self.found.number)
        for _ in range(ROUNDS):
            result = self._held(moved + steps[self.found.of_point, None] * normals)
            lost = self.volumes - volumes_of(self.points + result, self.triangles, self.found)
            far = np.abs(lost) > self.slack
            if not far.any():
                break
            steps += np.divide(lost, areas, out=np.zeros_like(lost), where=far & (areas > 0))
        return result, far

    def _directions(self, moved: Floats) -> tuple[Floats, Floats]:
        """Return unit normals at the points where free, and what a step along them adds (p,)."""
        vectors = _vertex_vectors(self.points + moved, self.triangles)
        size = np.linalg.norm(vectors, axis=1, keepdims=True)
        normals = self.free * np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0)
        gains = np.einsum("ij,ij->i", normals, vectors) / 3
        areas = np.bincount(self.found.of_point, gains, minlength=self.found.number)
        return normals, np.asarray(areas, np.float64)

    def _along(self, normals: Floats, lost: Floats, areas: Floats) -> Floats:
        steps = np.divide(lost, areas, out=np.zeros_like(lost), where=areas > 0)
        return steps[self.found.of_point, None] * normals

    def _held(self, moved: Floats) -> Floats:
        """Return displacements that are no longer than ``reach``."""
        length = np.linalg.norm(moved, axis=1, keepdims=True)
        return np.asarray(moved * (self.reach / np.maximum(length, self.reach)))


def _freedom(surface: SurfaceMesh) -> Floats:
    assert surface.labels is not None
    free = np.zeros(surface.points.shape)
    free[surface.triangles] = 1.0
    for label, name in enumerate(surface.names):
        if name in AXIS_OF:
            free[np.unique(surface.triangles[surface.labels == label]), AXIS_OF[name]] = 0.0
    return free


def _means(triangles: Indices, points: int) -> Any:
    """Return the sparse matrix that takes the mean over the neighbours of each point."""
    from scipy.sparse import coo_matrix, diags

    # On a closed, oriented 2-manifold each edge runs once each way.
    start, stop = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    near = coo_matrix((np.ones(len(start)), (start, stop)), shape=(points, points)).tocsr()
    count = np.bincount(start, minlength=points)
    return diags(1.0 / np.maximum(count, 1)) @ near


def _area_vectors(points: Floats, triangles: Indices) -> Floats:
    a, b, c = points[triangles[:, 0]], points[triangles[:, 1]], points[triangles[:, 2]]
    return np.asarray(np.cross(b - a, c - a) / 2)


def _vertex_vectors(points: Floats, triangles: Indices) -> Floats:
    """Return the sum of the area vectors of the triangles about each point, (n, 3)."""
    vectors = _area_vectors(points, triangles)
    corner = triangles.ravel()
    columns = [
        np.bincount(corner, np.repeat(vectors[:, axis], 3), minlength=len(points))
        for axis in range(3)
    ]
    return np.stack(columns, axis=1)


def _folded(points: Floats, triangles: Indices) -> NDArray[np.bool_]:
    """Tell which triangles look against the mean direction about their corners."""
    about = _vertex_vectors(points, triangles)
    size = np.linalg.norm(about, axis=1, keepdims=True)
    unit = np.divide(about, size, out=np.zeros_like(about), where=size > 0)
    mean = unit[triangles].sum(axis=1)
    return np.asarray(np.einsum("ij,ij->i", _area_vectors(points, triangles), mean) <= 0)
