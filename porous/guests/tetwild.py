"""pytetwild, the field's own tetrahedral mesher, run where it can neither hang nor kill us."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import porous
from porous.errors import GuestError, MeshError
from porous.guests.process import run, workplace
from porous.values.surface_topology import check_closed, defects

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.values import SurfaceMesh

VOLUME_TOLERANCE = 1e-3
"""How far the sum of the tets' volumes may be from the surface's, relative to it."""

FINER = (1.0, 0.25)
"""Parts of the wanted epsilon to try one after the other until the volume is right."""

NAME = "pytetwild"


def tetrahedra(
    surface: SurfaceMesh,
    *,
    edge_length: float | None = None,
    epsilon: float = 1e-3,
    stop_energy: float = 10.0,
    time_limit: float,
    watch: Callable[[float], None] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return points (n, 3) and tetrahedra (t, 4) that fill a closed surface.

    Every tetrahedron has positive volume and every point is used. pytetwild is not
    deterministic: numbers of points and tetrahedra differ from run to run.

    Parameters
    ----------
    surface
        Closed, oriented, manifold.
    edge_length
        Wanted edge length, in the surface's unit; a twentieth of its box's diagonal by default.
    epsilon
        How far the mesh may stray from the surface, relative to the box's diagonal; a quarter of
        that is tried where its volume comes out wrong.
    stop_energy
        Quality at which the mesher is content (its AMIPS energy); smaller is better and slower.
    time_limit
        Of one attempt, in seconds.
    watch
        Called with the seconds gone by; raising in it ends the mesher.

    Raises
    ------
    MeshError
        Before the mesher starts, for a surface that is empty, open or not manifold; and for
        lengths that are not positive.
    GuestError
        Where it dies, takes too long, or returns a mesh of another volume.
    """
    _check_input(surface, edge_length=edge_length, epsilon=epsilon, stop_energy=stop_energy)
    options: dict[str, Any] = {"stop_energy": stop_energy, "time_limit": time_limit}
    if edge_length is not None:
        options["edge_length_abs"] = edge_length
    for finer in FINER[:-1]:
        found = _attempt(surface, options | {"epsilon": epsilon * finer}, watch)
        if abs(_volume_error(surface, *found)) < VOLUME_TOLERANCE:
            return found
    found = _attempt(surface, options | {"epsilon": epsilon * FINER[-1]}, watch)
    _check_volume(surface, *found)
    return found


def _attempt(
    surface: SurfaceMesh, options: dict[str, Any], watch: Callable[[float], None] | None
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    with workplace() as folder:
        given: dict[str, Any] = {"points": surface.points, "triangles": surface.triangles}
        np.savez(folder / "in.npz", **given, **options)
        run(
            [sys.executable, "-m", "porous.guests.tetwild_worker", "in.npz", "out.npz"],
            name=NAME,
            folder=folder,
            time_limit=options["time_limit"],
            watch=watch,
            environment={"PYTHONPATH": _search_path()},
        )
        points, tets = _result(folder / "out.npz")
    points, tets = _used(points, _turned(points, tets))
    flat = int((~(_signed(points, tets) > 0)).sum())
    if flat:
        raise GuestError(f"{NAME} returned {flat} tetrahedra without volume")
    return points, tets


def _check_input(surface: SurfaceMesh, **lengths: float | None) -> None:
    for name, value in lengths.items():
        if value is not None and not 0 < value < np.inf:
            raise MeshError(f"{name}: got {value}; wanted a positive number")
    check_closed(surface)
    found = defects(surface)
    if found.nonmanifold_edges or found.nonmanifold_vertices:
        raise MeshError(
            f"surface: not a manifold: {found.nonmanifold_edges} edges of more than two triangles "
            f"and {found.nonmanifold_vertices} points of several fans, the first at {found.first}"
        )


def _search_path() -> str:
    """Return PYTHONPATH with the folder of this very package in front."""
    here = str(Path(next(iter(porous.__path__))).parent)
    return os.pathsep.join(filter(None, [here, os.environ.get("PYTHONPATH", "")]))


def _result(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    if not path.exists():
        raise GuestError(f"{NAME} ended without a mesh")
    with np.load(path, allow_pickle=False) as found:
        points, tets = found["points"], found["tets"]
    if tets.ndim != 2 or tets.shape[1:] != (4,) or not len(tets):
        raise GuestError(f"{NAME} returned no tetrahedra; is the surface thinner than epsilon?")
    return points, tets


def _signed(points: NDArray[np.float64], tets: NDArray[np.int64]) -> NDArray[np.float64]:
    a, b, c, d = (points[tets[:, i]] for i in range(4))
    return np.asarray(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6)


def _turned(points: NDArray[np.float64], tets: NDArray[np.int64]) -> NDArray[np.int64]:
    negative = _signed(points, tets) < 0
    return np.where(negative[:, None], tets[:, [0, 2, 1, 3]], tets)


def _used(
    points: NDArray[np.float64], tets: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    used, index = np.unique(tets, return_inverse=True)
    return points[used], index.reshape(tets.shape)


def _volume_error(
    surface: SurfaceMesh, points: NDArray[np.float64], tets: NDArray[np.int64]
) -> float:
    return float(_signed(points, tets).sum() / surface.volume - 1)


def _check_volume(
    surface: SurfaceMesh, points: NDArray[np.float64], tets: NDArray[np.int64]
) -> None:
    error = _volume_error(surface, points, tets)
    if abs(error) >= VOLUME_TOLERANCE:
        raise GuestError(
            f"{NAME} returned a mesh whose volume is {100 * error:+.2g} % off the surface's "
            f"{surface.volume:.6g} {surface.unit}³; a smaller epsilon or edge_length follows thin "
            "features more closely"
        )
