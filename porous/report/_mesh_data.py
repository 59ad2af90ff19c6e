"""A surface with few enough triangles to be turned in a page, and how far off that is."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.stages._simplify import collapsed
from porous.values import SurfaceMesh
from porous.values.volume_topology import boundary_faces, nodes_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.kernels.nearest import Nearest
    from porous.values import VolumeMesh

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

MOST = 200_000
"""Triangles that are shown at most."""

EASY = 3
"""So many times as many are thinned by collapsing edges alone; more are clustered first."""

PER_SQUARE = 2.5
"""Triangles per square of a cell's edge that clustering leaves of a smooth surface, about."""

FEW = 0.1
"""The part of the triangles allowed that clustering leaves at least, but of dust."""

COARSER = 1.2
"""By how much cells grow where too many triangles are left."""

ASKED = 100_000
"""Points at which the way from one surface to the other is measured, besides the corners shown."""

MANY = 6_000_000
"""Triangles of the whole surface to which distances are measured, at most about."""

SLAB = 1 << 21
"""Triangles that are looked at at once."""

ROOM = 0.8
"""The part of the triangles allowed from which on there is no room to split any."""

SPARSE = 8
"""So many times as many keys as occur may there be, for all to be held."""

STEPS = 65535
"""Steps of a coordinate along each edge of the box."""

PATTERNS = (
    ((0, 1, 2),),
    ((0, 3, 2), (3, 1, 2)),
    ((3, 1, 4), (0, 3, 4), (0, 4, 2)),
    ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
)
"""Triangles of which none to three sides are halved: corners 0 … 2, middles of sides 3 … 5."""


class Shown(NamedTuple):
    """A surface as it is shown: walls first, then caps, the sides where a frame cuts the solid."""

    points: Floats
    triangles: Indices
    walls: int
    """How many of the triangles are walls."""
    full: int
    """How many triangles the whole surface has."""
    away: float = 0.0
    """The largest distance measured from what is shown to it; 0 where all of it is shown."""
    missed: float = 0.0
    """The share of it, by corners, that lies further than that from what is shown."""


def boundary_of(mesh: VolumeMesh) -> SurfaceMesh:
    """Return the faces of one cell only, as triangles."""
    nodes = nodes_of(mesh, boundary_faces(mesh))
    four = nodes[nodes[:, 3] >= 0]
    triangles = np.concatenate([nodes[:, :3], four[:, [0, 2, 3]]])
    used, flat = np.unique(triangles, return_inverse=True)
    return SurfaceMesh(mesh.points[used], flat.reshape(-1, 3), mesh.unit)


def shown(surface: SurfaceMesh, most: int = MOST) -> Shown:
    """Return a surface with at most ``most`` triangles.

    One with more loses edges in the order of the error that this costs (Garland & Heckbert 1997);
    one with far more is first gathered in cells, all corners in a cell becoming their mean
    (Rossignac & Borrel 1993), rims and caps apart. Neither keeps topology: it is to be looked at.
    Of dust, whose grains vanish in cells, one triangle of many is shown.

    How far it is off is measured: from every corner and some middles of triangles that are shown
    to the nearest point of any triangle of the whole surface (of some, where there are millions:
    that is no less). Between these points it may be more.
    Pieces and holes smaller than a cell may be missing: which share of the whole lies further than
    that from what is shown is measured at some of its corners.
    """
    full, capped = len(surface.triangles), _capped(surface)
    if full <= most:
        order = np.argsort(capped, kind="stable")
        return Shown(surface.points, surface.triangles[order], int((~capped).sum()), full)
    with ThreadPoolExecutor(1) as beside:
        whole = beside.submit(_whole, surface)
        points, triangles = _thinned(surface, capped, most)
        planes = list(_planes(surface, capped))
        order, walls = _walls_first(points, triangles, planes)
        off = _deviation(surface, whole.result(), points, triangles)
    return Shown(points, triangles[order], walls, full, *off)


def _thinned(surface: SurfaceMesh, capped: NDArray[np.bool_], most: int) -> tuple[Floats, Indices]:
    full, points, triangles = len(surface.triangles), surface.points, surface.triangles
    if full > EASY * most:
        points, triangles = _clustered(surface, capped, EASY * most)
    if len(triangles) < FEW * most:  # dust: its grains are smaller than cells
        points, triangles = surface.points, surface.triangles[:: -(-full // most)]
    elif len(triangles) > most:
        points, triangles = collapsed(points, triangles, most, _edge(points, triangles))
    return _used(points, triangles[:most])


def _capped(surface: SurfaceMesh) -> NDArray[np.bool_]:
    """Tell which triangles are caps: none where names do not tell them from walls."""
    assert surface.labels is not None
    named = np.array([name != "WALL" for name in surface.names])[surface.labels]
    return np.asarray(named & (not named.all()))


def _planes(surface: SurfaceMesh, capped: NDArray[np.bool_]) -> Iterator[tuple[int, float]]:
    """Yield axis and place of the planes that caps lie in."""
    assert surface.labels is not None
    for label in np.unique(surface.labels[capped]):
        corners = surface.points[surface.triangles[capped & (surface.labels == label)].ravel()]
        axis = int(np.ptp(corners, axis=0).argmin())
        yield axis, float(corners[:, axis].mean())


def _edge(points: Floats, triangles: Indices) -> float:
    """Return the root of the mean square of edges, of some of them."""
    some = points[triangles[:: len(triangles) // 20_000 + 1]]
    return float(np.sqrt(((some - np.roll(some, 1, axis=1)) ** 2).sum(axis=2).mean()))


def _area(points: Floats, triangles: Indices) -> float:
    """Return the area, about: that of some triangles for all."""
    step = len(triangles) // 200_000 + 1
    a, b, c = np.moveaxis(points[triangles[::step]], 1, 0)
    return float(step * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _clustered(
    surface: SurfaceMesh, capped: NDArray[np.bool_], most: int
) -> tuple[Floats, Indices]:
    marks = np.zeros(len(surface.points), np.int64)
    assert surface.labels is not None
    for label in np.unique(surface.labels[capped]).tolist():
        of_cap = capped & (surface.labels == label)
        marks[surface.triangles[of_cap].ravel()] |= 1 << min(label, 7)
    edge = np.sqrt(PER_SQUARE * _area(surface.points, surface.triangles) / most)
    while True:
        points, triangles = _gathered(surface, marks, float(edge))
        if len(triangles) <= COARSER * most:
            return points, triangles
        edge *= COARSER


def _gathered(surface: SurfaceMesh, marks: Indices, edge: float) -> tuple[Floats, Indices]:
    """Return a surface whose corners are the means of those in cells of an edge."""
    low = surface.points.min(axis=0)
    key = marks
    for axis in range(3):
        place = ((surface.points[:, axis] - low[axis]) / edge).astype(np.int64)
        key = key * (int(place.max()) + 1) + place
    cell = _numbered(key)
    count = np.bincount(cell)
    columns = [np.bincount(cell, weights=surface.points[:, axis]) / count for axis in range(3)]
    return np.stack(columns, axis=1), _distinct(_renamed(surface.triangles, cell))


def _numbered(keys: Indices) -> NDArray[np.int32]:
    """Return the place of each key, not negative, among those that occur."""
    if keys.max(initial=0) > SPARSE * len(keys):
        return np.unique(keys, return_inverse=True)[1].astype(np.int32)
    occurs = np.zeros(keys.max(initial=0) + 1, bool)
    occurs[keys] = True
    return (np.cumsum(occurs, dtype=np.int32) - 1)[keys]


def _renamed(triangles: Indices, names: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return triangles by new names of their corners, without those of which two are the same."""
    kept = [np.zeros((0, 3), np.int32)]
    for first in range(0, len(triangles), SLAB):
        part = names[triangles[first : first + SLAB]]
        a, b, c = part.T
        kept.append(part[(a != b) & (b != c) & (c != a)])
    return np.concatenate(kept)


def _distinct(triangles: NDArray[np.int32]) -> Indices:
    """Return each triangle once, its smallest corner first; two that face each other both stay."""
    a, b, c = triangles.astype(np.int64).T
    first = np.where((a < b) & (a < c), 0, np.where(b < c, 1, 2))
    sides = [np.choose(first, (a, b, c)), np.choose(first, (b, c, a)), np.choose(first, (c, a, b))]
    count = int(triangles.max(initial=0)) + 1
    if count >= 1 << 21:  # three numbers do not fit into one
        return np.unique(np.stack(sides, axis=1), axis=0)
    keys = np.unique((sides[0] * count + sides[1]) * count + sides[2])
    pairs, last = np.divmod(keys, count)
    return np.stack([*np.divmod(pairs, count), last], axis=1)


def _used(points: Floats, triangles: Indices) -> tuple[Floats, Indices]:
    occurs = np.zeros(len(points), bool)
    occurs[triangles.ravel()] = True
    return points[occurs], (np.cumsum(occurs) - 1)[triangles]


def _walls_first(
    points: Floats, triangles: Indices, planes: list[tuple[int, float]]
) -> tuple[Indices, int]:
    """Return an order with the caps last, and how many come before: caps lie in their planes."""
    capped = np.zeros(len(triangles), bool)
    near = 0.1 * _edge(points, triangles)
    for axis, place in planes:
        capped |= (np.abs(points[:, axis] - place) <= near)[triangles].all(axis=1)
    return np.argsort(capped, kind="stable"), int((~capped).sum())


def split(shown: Shown, length: float, most: int = MOST) -> Shown:
    """Return the same surface with its longest edges halved, so that colours can change along them.

    Until none is longer than ``length``, or there would be more than ``most`` triangles.
    """
    points, triangles, walls = shown.points, shown.triangles, shown.walls
    bound = float(np.linalg.norm(np.ptp(points, axis=0))) / 2
    while len(triangles) < ROOM * most:
        finer = _halved(points, triangles, walls, max(bound, length))
        if finer is not None and len(finer[1]) <= most:
            points, triangles, walls = finer
        elif finer is not None or bound <= length:
            break
        else:
            bound /= 2
    return shown._replace(points=points, triangles=triangles, walls=walls)


def _halved(
    points: Floats, triangles: Indices, walls: int, length: float
) -> tuple[Floats, Indices, int] | None:
    """Return triangles of which each edge longer than ``length`` is halved; None without any."""
    sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2)
    low, high = sides.min(axis=2), sides.max(axis=2)
    long = np.linalg.norm(points[low] - points[high], axis=2) > length
    if not long.any():
        return None
    names, which = np.unique(low[long] * len(points) + high[long], return_inverse=True)
    middle = np.full(triangles.shape, -1)
    middle[long] = len(points) + which
    ends = np.stack(np.divmod(names, len(points)))
    count, pieces, kept = long.sum(axis=1), [], []
    for halved, pattern in enumerate(PATTERNS):
        rows = np.flatnonzero(count == halved)
        turned = _turned(rows, triangles, middle, long)
        pieces.append(turned[:, pattern].reshape(-1, 3))
        kept.append(np.repeat(rows < walls, len(pattern)))
    parts, is_wall = np.concatenate(pieces), np.concatenate(kept)
    order = np.argsort(~is_wall, kind="stable")
    return np.concatenate([points, points[ends].mean(axis=0)]), parts[order], int(is_wall.sum())


def _turned(rows: Indices, triangles: Indices, middle: Indices, long: NDArray[np.bool_]) -> Indices:
    """Return corners and middles of sides, shape (n, 6), turned so that the first side is halved.

    Where two are, the second is the other.
    """
    mine = long[rows]
    first = np.where(mine.sum(axis=1) == 2, (mine.argmin(axis=1) + 1) % 3, mine.argmax(axis=1))
    turn = (first[:, None] + np.arange(3)) % 3
    both = (np.take_along_axis(of[rows], turn, axis=1) for of in (triangles, middle))
    return np.concatenate(list(both), axis=1)


def _whole(surface: SurfaceMesh) -> Nearest:
    """Return a surface that can be asked for distances, or some of its triangles.

    The distance to some is no less than that to all, and of so many little more.
    """
    from porous.kernels.nearest import Nearest

    return Nearest(surface.points, surface.triangles[:: len(surface.triangles) // MANY + 1])


def _deviation(
    surface: SurfaceMesh, whole: Nearest, points: Floats, triangles: Indices
) -> tuple[float, float]:
    """Return how far off what is shown is, and what share of the whole lies further from it."""
    from porous.kernels.nearest import Nearest

    middles = points[triangles[:: len(triangles) // ASKED + 1]].mean(axis=1)
    asked = np.concatenate([points, middles])
    away = whole.farthest(asked)
    some = surface.points[:: len(surface.points) // ASKED + 1]
    return away, float(Nearest(points, triangles).beyond(some, away).mean())
