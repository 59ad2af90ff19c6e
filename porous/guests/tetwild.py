"""pytetwild, the field's own tetrahedral mesher, run where it can neither hang nor kill us."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar
from zipfile import BadZipFile

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

PASSES, PASSES_OF_WHOLE = 80, 10
"""Passes of optimisation at most. Between bodies that touch in points the wedges are too sharp
for the mesher ever to be content, and nothing drops them where all is kept."""

LEAST = 0.1
"""Seconds that an attempt has at least."""

T = TypeVar("T")


class Tetrahedra(NamedTuple):
    """Points (n, 3) and tetrahedra (t, 4)."""

    points: NDArray[np.float64]
    tets: NDArray[np.int64]


class Field(NamedTuple):
    """Wanted edge lengths at the points of tetrahedra that fill the space about a surface."""

    points: NDArray[np.float64]
    """(n, 3)"""
    tets: NDArray[np.int64]
    """(t, 4)"""
    lengths: NDArray[np.float64]
    """(n,), in the surface's unit; no edge becomes longer than the general edge length."""


@dataclass(frozen=True)
class Wish:
    """What is asked of the mesher, and for how long.

    Parameters
    ----------
    edge_length
        Wanted edge length, in the surface's unit; a twentieth of its box's diagonal by default.
    field
        Shorter edges here and there.
    epsilon
        How far the mesh may stray from the surface, relative to the box's diagonal; a quarter of
        that is tried where its volume comes out wrong.
    stop_energy
        Quality at which the mesher is content (its AMIPS energy); smaller is better and slower.
    time_limit
        Of all attempts together, in seconds.
    watch
        Called with the seconds gone by in an attempt; raising in it ends the mesher.

    Raises
    ------
    MeshError
        For numbers that are not positive.
    """

    edge_length: float | None = None
    field: Field | None = None
    epsilon: float = 1e-3
    stop_energy: float = 10.0
    time_limit: float = 600.0
    watch: Callable[[float], None] | None = None

    def __post_init__(self) -> None:
        for name in ("edge_length", "epsilon", "stop_energy", "time_limit"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise MeshError(f"{name}: got {value}; wanted a positive number")


def tetrahedra(surface: SurfaceMesh, wish: Wish) -> Tetrahedra:
    """Return tetrahedra that fill a closed surface.

    Every tetrahedron has positive volume and every point is used. pytetwild is not
    deterministic: numbers of points and tetrahedra differ from run to run.

    Parameters
    ----------
    surface
        Closed, oriented, manifold.
    wish
        How fine, how well and for how long.

    Raises
    ------
    MeshError
        Before the mesher starts, for a surface that is empty, open or not manifold.
    GuestError
        Where it dies, takes too long, or returns a mesh of another volume.
    """
    check_manifold(surface)

    def filled(found: Tetrahedra, _: float) -> Tetrahedra:
        _check_volume(surface, found)
        return found

    return attempted(surface.points, surface.triangles, wish, filled)


def attempted(
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    wish: Wish,
    accept: Callable[[Tetrahedra, float], T],
    *,
    whole: bool = False,
) -> T:
    """Return what ``accept`` makes of the mesh, of a finer epsilon where it raises at first.

    Parameters
    ----------
    points, triangles
        A soup of triangles, (n, 3) and (t, 3).
    wish
        How fine, how well and for how long.
    accept
        Takes tetrahedra and the epsilon they were made with, and raises ``GuestError`` where
        they are wrong.
    whole
        Whether to keep all that the mesher has filled, also outside the surface.
    """
    start = time.monotonic()
    options: dict[str, Any] = {"stop_energy": wish.stop_energy, "disable_filtering": whole}
    options["num_opt_iter"] = PASSES_OF_WHOLE if whole else PASSES
    if wish.edge_length is not None:
        options["edge_length_abs"] = wish.edge_length
    if wish.field is not None:
        for name, array in zip(("vertices", "tets", "values"), wish.field, strict=True):
            options[f"bg_{name}"] = array
    given = {"points": points, "triangles": triangles, **options}
    for finer in FINER:
        left = max(LEAST, wish.time_limit - (time.monotonic() - start))
        epsilon = wish.epsilon * finer
        found = _attempt(given | {"epsilon": epsilon}, wish, left)
        try:
            return accept(found, epsilon)
        except GuestError:
            if finer == FINER[-1]:
                raise
    raise AssertionError("unreachable")


def _attempt(given: dict[str, Any], wish: Wish, seconds: float) -> Tetrahedra:
    with workplace() as folder:
        np.savez(folder / "in.npz", **given, time_limit=wish.time_limit)
        run(
            [sys.executable, "-m", "porous.guests.tetwild_worker", "in.npz", "out.npz"],
            name=NAME,
            folder=folder,
            time_limit=seconds,
            watch=wish.watch,
            environment={"PYTHONPATH": _search_path()},
        )
        points, tets = _result(folder / "out.npz")
    points, tets = _used(points, _turned(points, tets))
    flat = int((~(signed_volumes(points, tets) > 0)).sum())
    if flat:
        raise GuestError(f"{NAME} returned {flat} tetrahedra without volume")
    return Tetrahedra(points, tets)


def check_manifold(surface: SurfaceMesh) -> None:
    """Raise ``MeshError`` for a surface that is empty, open or not manifold."""
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


def _result(path: Path) -> Tetrahedra:
    if not path.exists():
        raise GuestError(f"{NAME} ended without a mesh")
    try:
        with np.load(path, allow_pickle=False) as found:
            points = np.asarray(found["points"], np.float64)
            tets = found["tets"]
    except (ValueError, KeyError, EOFError, TypeError, BadZipFile) as error:
        raise GuestError(f"{NAME} left no mesh but something else: {error}") from None
    if tets.ndim != 2 or tets.shape[1:] != (4,) or not len(tets):
        raise GuestError(f"{NAME} returned no tetrahedra; is the surface thinner than epsilon?")
    _check_numbers(points, tets)
    return Tetrahedra(points, tets)


def _check_numbers(points: NDArray[np.float64], tets: NDArray[np.int64]) -> None:
    if points.ndim != 2 or points.shape[1:] != (3,) or not np.isfinite(points).all():
        raise GuestError(f"{NAME} returned points that are none")
    if tets.dtype.kind not in "iu" or not 0 <= tets.min() <= tets.max() < len(points):
        raise GuestError(f"{NAME} returned tetrahedra of points that are not there")


def signed_volumes(points: NDArray[np.float64], tets: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the volume of each tetrahedron, below zero where it is turned inside out."""
    a, b, c, d = (points[tets[:, i]] for i in range(4))
    return np.asarray(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6)


def _turned(points: NDArray[np.float64], tets: NDArray[np.int64]) -> NDArray[np.int64]:
    negative = signed_volumes(points, tets) < 0
    return np.where(negative[:, None], tets[:, [0, 2, 1, 3]], tets)


def _used(points: NDArray[np.float64], tets: NDArray[np.int64]) -> Tetrahedra:
    used, index = np.unique(tets, return_inverse=True)
    return Tetrahedra(points[used], index.reshape(tets.shape))


def _check_volume(surface: SurfaceMesh, found: Tetrahedra) -> None:
    error = float(signed_volumes(*found).sum() / surface.volume - 1)
    if abs(error) >= VOLUME_TOLERANCE:
        raise GuestError(
            f"{NAME} returned a mesh whose volume is {100 * error:+.2g} % off the surface's "
            f"{surface.volume:.6g} {surface.unit}³; a smaller epsilon or edge_length follows thin "
            "features more closely"
        )
