"""The step from many triangles to fewer, of the same topology."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError
from porous.kernels.crossings import crossing
from porous.memory import check_memory
from porous.stages._altered import altered, check_manifold, part_areas, pieces_of, volumes_of
from porous.stages._slivers import without_slivers
from porous.values import SurfaceMesh
from porous.values.surface_topology import defects

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]
    Progress = Callable[[str, float], None]

TOLERANCE = 2e-3
"""Part of the volume that simplification may change unless told otherwise."""

ROUNDS = 7
"""How often a gentler target is tried: each halves what is not known of how far one can go."""

NORMAL = 2.0
"""How many lengths of an edge a turn of the normal by a radian counts when labels are looked up."""

MOST_TRIANGLES = 2**31 // 3
"""Corners are counted in 32 bits there."""

BYTES = 600
"""Memory per triangle while a surface is simplified, about."""

_ENGINE = threading.Lock()  # fast-simplification keeps its mesh in one place for all threads


def simplify(
    surface: SurfaceMesh,
    *,
    keep: float = 0.5,
    tolerance: float = TOLERANCE,
    progress: Progress | None = None,
) -> SurfaceMesh:
    """Return a surface of fewer triangles with the same topology.

    Edges are collapsed in the order of the error they cost (Garland and Heckbert 1997, by
    fast-simplification), and slivers that this leaves in flat faces are turned. That engine does
    not watch topology, so what it makes is checked: closed, oriented, 2-manifold, as many pieces
    as before, each with the Euler number and the side it had, volume within ``tolerance``, every
    named part still there, and no triangle that crosses or touches another (of a surface that had
    some already: no more than it had). Where a check fails, gentler targets are tried by halving;
    so the result may keep more than ``keep``, in the end all.

    Parameters
    ----------
    surface
        Closed, oriented, 2-manifold.
    keep
        The share of triangles to keep, above 0 and at most 1; 1 changes nothing.
    tolerance
        The part of the volume that may change, zero or more.
    progress
        Called as ``progress("simplify", done)`` with done in 0 … 1.

    Returns
    -------
    SurfaceMesh
        Triangles carry the label of the nearest triangle of the same direction. ``altered`` says
        by how much volume and area were changed, and measures add it to their uncertainties.

    Raises
    ------
    MeshError
        For another ``keep`` or ``tolerance``, or a surface that is not a closed 2-manifold.
    MemoryLimitError
        Where the work would not fit into memory.
    """
    _check(keep, tolerance)
    check_manifold(surface, "simplify")
    count = len(surface.triangles)
    wanted = max(round(keep * count), 4)
    if wanted >= count:
        return surface
    if count > MOST_TRIANGLES:
        raise MeshError(f"simplify: got {count} triangles; wanted at most {MOST_TRIANGLES}")
    check_memory(BYTES * count, f"simplifying {count} triangles", "Choose fewer voxels.")
    return _sought(surface, wanted, tolerance, progress)


def _check(keep: float, tolerance: float) -> None:
    if not 0 < keep <= 1:
        raise MeshError(f"simplify: keep: got {keep}; wanted a share above 0 and at most 1")
    if not tolerance >= 0:
        raise MeshError(f"simplify: tolerance: got {tolerance}; wanted zero or more")


def _sought(
    surface: SurfaceMesh, wanted: int, tolerance: float, progress: Progress | None
) -> SurfaceMesh:
    """Return what keeps the fewest triangles of all that was tried and passed."""
    best, low, high = surface, wanted, len(surface.triangles)
    promised, parts = _signature(surface), part_areas(surface) > 0
    target = wanted
    for step in range(ROUNDS + 1):
        if progress is not None:
            progress("simplify", step / (ROUNDS + 1))
        found = _collapsed(surface, target)
        if _passes(found, surface, tolerance, promised, parts):
            assert found is not None
            best, high = found, target
        else:
            low = target
        if high <= low + 1 or high == wanted:
            break
        target = (low + high) // 2
    if progress is not None:
        progress("simplify", 1.0)
    return best


def _collapsed(surface: SurfaceMesh, target: int) -> SurfaceMesh | None:
    """Return the surface with about ``target`` triangles, or None where nothing is left."""
    length = _edge_length(surface)
    points, triangles = collapsed(surface.points, surface.triangles, target, length)
    if not len(triangles):
        return None
    if len(points) and _closed(points, triangles):
        points, triangles = without_slivers(points, triangles)
    return altered(surface, points, triangles, _labels(surface, points, triangles, length))


def collapsed(
    points: Floats, triangles: Indices, target: int, length: float
) -> tuple[Floats, Indices]:
    """Return about ``target`` triangles, whatever becomes of the topology.

    ``length`` is that of an edge, about: the engine's thresholds are absolute, and edges of length
    one about the origin are what it is tuned for.
    """
    import fast_simplification

    centre = points.mean(axis=0)
    with _ENGINE:
        found, left = fast_simplification.simplify(
            (points - centre) / length, triangles.astype(np.int32), target_count=target
        )[:2]
    return centre + length * np.asarray(found), np.asarray(left, np.int64)


def _closed(points: Floats, triangles: Indices) -> bool:
    """Tell whether every edge has two triangles, one each way."""
    start, stop = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    there, back = start * len(points) + stop, stop * len(points) + start
    there.sort()
    back.sort()
    return bool(np.array_equal(there, back) and (np.diff(there) > 0).all())


def _edge_length(surface: SurfaceMesh) -> float:
    sides = surface.corners - np.roll(surface.corners, 1, axis=1)
    return float(np.sqrt((sides**2).sum(axis=2).mean()))


def _labels(
    surface: SurfaceMesh, points: Floats, triangles: Indices, length: float
) -> NDArray[np.int16]:
    """Return for each new triangle the label of the nearest old one that looks the same way."""
    assert surface.labels is not None
    if (surface.labels == surface.labels[0]).all():
        return np.full(len(triangles), surface.labels[0], np.int16)
    from scipy.spatial import cKDTree

    new = SurfaceMesh(points, triangles, surface.unit)
    nearest = cKDTree(_sites(surface, length)).query(_sites(new, length))[1]
    return np.asarray(surface.labels[nearest], np.int16)


def _sites(surface: SurfaceMesh, length: float) -> Floats:
    """Return middle and direction of each triangle as one point of six dimensions."""
    vectors = surface.area_vectors
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    normals = np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0)
    return np.hstack([surface.corners.mean(axis=1), NORMAL * length * normals])


def _signature(surface: SurfaceMesh) -> list[tuple[int, bool]]:
    """Return the Euler number of each piece and whether it bounds a solid outwards, sorted."""
    found = pieces_of(surface)
    volumes = volumes_of(surface.points - surface.points.mean(axis=0), surface.triangles, found)
    return sorted(zip(found.euler_numbers.tolist(), (volumes > 0).tolist(), strict=True))


def _passes(
    found: SurfaceMesh | None,
    surface: SurfaceMesh,
    tolerance: float,
    promised: list[tuple[int, bool]],
    parts: NDArray[np.bool_],
) -> bool:
    if found is None or abs(found.volume - surface.volume) > tolerance * abs(surface.volume):
        return False
    if not np.array_equal(part_areas(found) > 0, parts):
        return False
    if defects(found) or _signature(found) != promised:
        return False
    crossed = crossing(found.points, found.triangles).sum()
    return not crossed or bool(crossed <= crossing(surface.points, surface.triangles).sum())
