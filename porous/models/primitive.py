"""The solids that cells are made of: bodies of the unit cube by name, and any closed mesh."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError, ModelError
from porous.values import Box, SurfaceMesh
from porous.values.surface_topology import check_closed, defects, joined, pieces, winding_numbers
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Points = NDArray[np.float64]

FLAT = 1e-9
"""Planes and edges closer than this part of the solid's size are one."""

MANY_FACETS = 200

MANY_EDGES = 400
"""Hulls with more directions of edges have their width taken over facets alone."""


@dataclass(frozen=True, eq=False)
class Primitive(Value):
    """A solid in its own coordinates, which affine maps carry to the cells.

    Parameters
    ----------
    name
        A name of ``NAMES``, or ``"mesh"``.
    points
        float64, shape (n, 3); a ball's only point is its centre.
    triangles
        int64, shape (t, 3), counter-clockwise seen from outside; none for a ball.
    convex
        Whether the solid is known to be the convex hull of its points (and has at most
        ``MANY_FACETS`` facets: beyond, half-spaces are no quicker than triangles).
    radius
        Of a ball, else None.
    """

    name: str
    points: NDArray[np.float64]
    triangles: NDArray[np.int64]
    convex: bool
    radius: float | None = None

    def __post_init__(self) -> None:
        self._set("points", frozen(self.points, np.float64))
        self._set("triangles", frozen(self.triangles, np.int64))
        if self.radius is not None and not 0 < self.radius < math.inf:
            raise ModelError(f"primitive {self.name}: got radius {self.radius}; wanted a length")

    @cached_property
    def planes(self) -> NDArray[np.float64]:
        """Outward unit normals and offsets of the facets, shape (f, 4): n·x ≤ d in the solid.

        Coplanar triangles have one plane; a ball has none. They bound the solid where it is convex.
        """
        normals, offsets, _ = self._facet_planes
        return np.column_stack([normals, offsets])

    @cached_property
    def facets(self) -> tuple[NDArray[np.int64], ...]:
        """The corners of each facet in order, counter-clockwise seen from outside.

        Whole polygons where the solid is convex, triangles where it is not.
        """
        if not self.convex:
            return tuple(self.triangles)
        return tuple(
            self._polygon(self.triangles[self._facet_planes[2] == f])
            for f in range(len(self.planes))
        )

    @cached_property
    def edges(self) -> NDArray[np.int64]:
        """Pairs of points that are edges, shape (e, 2); lines inside a flat facet are not."""
        if not len(self.triangles):
            return np.zeros((0, 2), np.int64)
        first, second = _pairs(self.triangles)
        facet = self._facet_planes[2]
        bent = first[facet[first // 3] != facet[second // 3]]
        ends = np.stack(
            [self.triangles.ravel()[bent], np.roll(self.triangles, -1, 1).ravel()[bent]]
        )
        return np.sort(ends.T, axis=1)

    @cached_property
    def box(self) -> Box:
        """The tight box."""
        return Box.of_points(self.points).grown(self.radius or 0.0)

    @property
    def volume(self) -> float:
        """Volume of the solid."""
        if self.radius is not None:
            return 4 / 3 * math.pi * self.radius**3
        return self.surface().volume

    @property
    def area(self) -> float:
        """Area of the solid's surface."""
        if self.radius is not None:
            return 4 * math.pi * self.radius**2
        return self.surface().area

    @cached_property
    def thickness(self) -> float:
        """The least distance of two parallel planes with the solid between them.

        Exact for convex solids; for others that of their convex hull, which their walls never
        exceed. Over facets' normals and cross products of edges (Gritzmann and Klee 1992); hulls
        with more than ``MANY_EDGES`` edge directions over facets alone, an upper bound.
        """
        if self.radius is not None:
            return 2 * self.radius
        hull = self if self.convex else convex_hull(self.points)
        heights = hull.points @ _width_directions(hull).T
        return float((heights.max(axis=0) - heights.min(axis=0)).min())

    def surface(self, unit: str = "mm") -> SurfaceMesh:
        """Return the triangles as a surface; a ball has none."""
        return SurfaceMesh(self.points, self.triangles, unit)

    def scaled(self, factor: float) -> Primitive:
        """Return the same solid ``factor`` times as far from the origin and as large."""
        if not 0 < factor < math.inf:
            raise ModelError(f"primitive: got factor {factor}; wanted a positive number")
        radius = None if self.radius is None else self.radius * factor
        return replace(self, points=self.points * factor, radius=radius)

    @cached_property
    def _facet_planes(self) -> tuple[Points, Points, NDArray[np.int64]]:
        if not len(self.triangles):
            return np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64)
        return _facets(self.surface(), max(self.box.lengths))

    def _polygon(self, triangles: NDArray[np.int64]) -> NDArray[np.int64]:
        sides = {
            (int(a), int(b)) for t in triangles for a, b in zip(t, np.roll(t, -1), strict=True)
        }
        after = {a: b for a, b in sides if (b, a) not in sides}
        loop = [min(after)]
        while after[loop[-1]] != loop[0]:
            loop.append(after[loop[-1]])
        return np.array(loop)

    def _content(self) -> tuple[object, ...]:
        return self.name, self.points, self.triangles, self.convex, self.radius


def named(name: str) -> Primitive:
    """Return a primitive of the unit cube by its name, one of ``NAMES``.

    Raises
    ------
    ModelError
        For another name; lists what there is.
    """
    if name not in _CORNERS:
        raise ModelError(f"primitive: got {name!r}; wanted one of {', '.join(NAMES)}, or a mesh")
    corners = np.array(_CORNERS[name], dtype=np.float64)
    if name == "ball":
        return Primitive(name, corners, np.zeros((0, 3), np.int64), convex=True, radius=0.5)
    return Primitive(name, corners, _hull_triangles(corners), convex=True)


def of_surface(surface: SurfaceMesh, name: str = "mesh", *, touching: bool = False) -> Primitive:
    """Return the solid that a closed surface encloses; it need not be convex.

    Points with the same coordinates are taken as one, as STL files need.

    Parameters
    ----------
    surface
        Closed, its triangles counter-clockwise seen from outside.
    name
        What the solid is called.
    touching
        Whether parts of the solid may touch along edges, which are of four triangles then.

    Raises
    ------
    MeshError
        Where the surface is open, not manifold, inside out or encloses nothing; names the number
        of edges and the place of the first.
    """
    welded = _welded(surface)
    check_closed(welded)
    found = defects(welded)
    if found.nonmanifold_edges and not touching:
        raise MeshError(
            f"surface: {found.nonmanifold_edges} edges of more than two triangles, the first near "
            f"{found.first}; wanted a manifold surface"
        )
    _check_shells(welded)
    solid = Primitive(name, welded.points, welded.triangles, convex=False)
    return replace(solid, convex=_is_convex(solid))


def _welded(surface: SurfaceMesh) -> SurfaceMesh:
    # Adding zero turns −0.0 into 0.0, which is the same place.
    points, index = np.unique(surface.points + 0.0, axis=0, return_inverse=True)
    triangles = index.reshape(-1)[surface.triangles]
    a, b, c = triangles.T
    proper = (a != b) & (b != c) & (c != a)
    return SurfaceMesh(points, triangles[proper], surface.unit)


def _check_shells(surface: SurfaceMesh) -> None:
    """Raise ``MeshError`` where a shell is inside out and is no cavity of another."""
    shell = pieces(surface)
    for index in range(int(shell.max()) + 1):
        part = SurfaceMesh(surface.points, surface.triangles[shell == index], surface.unit)
        if part.volume >= 0:
            continue
        place = surface.points[part.triangles[0, 0]]
        if winding_numbers(surface.corners[shell != index], place[None])[0] < 0.5:
            raise MeshError(
                f"surface: the shell at {tuple(place.tolist())} is inside out and lies in no other "
                "shell as a cavity; wanted triangles counter-clockwise seen from outside"
            )


def _is_convex(solid: Primitive) -> bool:
    if len(solid.planes) > MANY_FACETS or pieces(solid.surface()).max():
        return False
    heights = solid.points @ solid.planes[:, :3].T - solid.planes[:, 3]
    return bool((heights <= FLAT * max(solid.box.lengths)).all())


def _facets(surface: SurfaceMesh, size: float) -> tuple[Points, Points, NDArray[np.int64]]:
    """Return unit normals (f, 3) and offsets (f,) of facets, and the facet of each triangle (t,).

    Coplanar triangles that share an edge are of one facet; the largest gives it its normal, for
    slivers give poor ones. A triangle without area is of the facet across its longest side.
    """
    vectors = surface.area_vectors
    area = np.linalg.norm(vectors, axis=1)
    normal = vectors / np.where(area > 0, area, 1)[:, None]
    offset = np.einsum("ij,ij->i", normal, surface.corners.mean(axis=1))
    first, second = _pairs(surface.triangles)
    alike = np.einsum("ij,ij->i", normal[first // 3], normal[second // 3]) > 1 - 1e-12
    alike &= np.abs(offset[first // 3] - offset[second // 3]) <= FLAT * size
    sides = np.linalg.norm(surface.corners - np.roll(surface.corners, -1, axis=1), axis=2)
    longest = 3 * np.arange(len(area)) + sides.argmax(axis=1)
    flat = longest[~(area > 0)]
    alike |= np.isin(first, flat) | np.isin(second, flat)
    facet = joined(len(area), first[alike] // 3, second[alike] // 3)
    order = np.lexsort((-area, facet))
    chosen = order[np.unique(facet[order], return_index=True)[1]]
    return normal[chosen], offset[chosen], facet


def _pairs(triangles: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the two sides, 3·triangle + corner, of each edge of a closed manifold."""
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2))
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    return order[::2], order[1::2]


def _width_directions(hull: Primitive) -> Points:
    normals = hull.planes[:, :3]
    along = hull.points[hull.edges[:, 1]] - hull.points[hull.edges[:, 0]]
    along = along / np.linalg.norm(along, axis=1)[:, None]
    along = np.unique(np.round(along * np.where(_leading(along) < 0, -1, 1)[:, None], 9), axis=0)
    if len(along) > MANY_EDGES:
        return normals
    first, second = np.triu_indices(len(along), 1)
    cross = np.cross(along[first], along[second])
    length = np.linalg.norm(cross, axis=1)
    keep = length > 1e-6
    return np.vstack([normals, cross[keep] / length[keep, None]])


def _leading(vectors: Points) -> Points:
    """Return the first component of each vector that is not nearly zero."""
    index = np.argmax(np.abs(vectors) > 1e-6, axis=1)
    return np.asarray(vectors[np.arange(len(vectors)), index])


def convex_hull(points: Points) -> Primitive:
    """Return the convex hull of points that span space, named ``"hull"``."""
    from scipy.spatial import ConvexHull

    found = ConvexHull(points)
    corners = points[found.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = np.einsum("ij,ij->i", normals, found.equations[:, :3]) > 0
    triangles = np.where(outward[:, None], found.simplices, found.simplices[:, ::-1])
    used, index = np.unique(triangles, return_inverse=True)
    return Primitive("hull", points[used], index.reshape(-1, 3), convex=True)


def _hull_triangles(points: Points) -> NDArray[np.int64]:
    """Return the hull of a few points in convex position: every plane of three with all below."""
    found: dict[tuple[int, ...], Points] = {}
    for a, b, c in itertools.permutations(range(len(points)), 3):
        normal = np.cross(points[b] - points[a], points[c] - points[a])
        height = (points - points[a]) @ normal
        if a < b and a < c and height.max() < FLAT and np.linalg.norm(normal) > FLAT:
            found[tuple(np.flatnonzero(height > -FLAT))] = normal
    return np.vstack(
        [
            _fan(points, np.array(on), normal)
            for on, normal in sorted(found.items(), key=lambda item: item[0])
        ]
    )


def _fan(points: Points, on: NDArray[np.int64], normal: Points) -> NDArray[np.int64]:
    spokes = points[on] - points[on].mean(axis=0)
    across = np.cross(normal, spokes[0])
    angle = np.arctan2(
        spokes @ across / np.linalg.norm(across), spokes @ spokes[0] / np.linalg.norm(spokes[0])
    )
    loop = on[np.argsort(angle)]
    loop = np.roll(loop, -int(np.argmin(loop)))
    return np.array([[loop[0], b, c] for b, c in itertools.pairwise(loop[1:])])


_GOLD = (1 + math.sqrt(5)) / 2
_CUBE = list(itertools.product((0.0, 1.0), repeat=3))
_CORNERS: dict[str, list[tuple[float, ...]]] = {
    "ball": [(0.5, 0.5, 0.5)],
    "cube": _CUBE,
    "dodecahedron": [
        *(tuple(0.5 + (v - 0.5) / _GOLD for v in corner) for corner in _CUBE),
        *(
            tuple(np.roll((0.5, 0.5 + a / (2 * _GOLD**2), 0.5 + b / 2), turn).tolist())
            for turn in range(3)
            for a, b in itertools.product((-1, 1), repeat=2)
        ),
    ],
    "icosahedron": [
        tuple(np.roll((0.5, 0.5 + a / (2 * _GOLD), 0.5 + b / 2), turn).tolist())
        for turn in range(3)
        for a, b in itertools.product((-1, 1), repeat=2)
    ],
    "octahedron": [
        tuple(np.roll((0.5 + a / 2, 0.5, 0.5), turn).tolist()) for turn in range(3) for a in (-1, 1)
    ],
    "tetrahedron": [(0, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1)],
}

NAMES = tuple(sorted(_CORNERS))
"""The primitives that have names."""
