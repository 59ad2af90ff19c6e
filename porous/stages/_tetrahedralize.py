"""From a closed surface to tetrahedra."""

from __future__ import annotations

from typing import TYPE_CHECKING

from porous.values import Block, VolumeMesh
from porous.values.volume_topology import hung_by_faces

if TYPE_CHECKING:
    from collections.abc import Callable

    from porous.values import SurfaceMesh

    Progress = Callable[[str, float], None]

SECONDS = 600.0
SECONDS_PER_TRIANGLE = 0.02
"""The mesher's time limit: ten times what it took on surfaces of 1 000 to 170 000 triangles."""


def tetrahedralize(
    surface: SurfaceMesh,
    *,
    edge_length: float | None = None,
    epsilon: float = 1e-3,
    stop_energy: float = 10.0,
    time_limit: float | None = None,
    progress: Progress | None = None,
) -> VolumeMesh:
    """Fill a closed surface with tetrahedra (fTetWild: Hu, Schneider, Wang, Zorin, Panozzo 2020).

    Solids that touch in a point or an edge only share no nodes. The mesher is not deterministic:
    numbers of nodes and cells differ a little from run to run.

    Parameters
    ----------
    surface
        Closed, oriented, manifold.
    edge_length
        Wanted edge length, in the surface's unit; a twentieth of its box's diagonal by default.
    epsilon
        How far the mesh may stray from the surface, relative to its box's diagonal; a quarter of
        that is tried where its volume comes out wrong.
    stop_energy
        Quality at which the mesher is content; smaller is better and slower.
    time_limit
        In seconds; ten minutes and more for large surfaces by default.
    progress
        Called with the stage's name and the part done; raising in it ends the mesher. The mesher
        itself does not tell how far it is: the part stays 0 until the end.

    Raises
    ------
    MeshError
        For a surface that is empty, open or not manifold.
    GuestError
        Where the mesher dies, takes too long or returns a mesh of another volume.
    """
    from porous.guests.tetwild import tetrahedra

    tell = progress or (lambda _stage, _done: None)
    limit = SECONDS + SECONDS_PER_TRIANGLE * len(surface.triangles)
    points, cells = tetrahedra(
        surface,
        edge_length=edge_length,
        epsilon=epsilon,
        stop_energy=stop_energy,
        time_limit=limit if time_limit is None else time_limit,
        watch=lambda _: tell("volume", 0.0),
    )
    mesh = hung_by_faces(VolumeMesh(points, (Block("tet4", cells),), unit=surface.unit))
    tell("volume", 1.0)
    return mesh
