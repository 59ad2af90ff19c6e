"""From a closed surface to tetrahedra."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from porous.stages._sizing import background
from porous.values import Block, VolumeMesh
from porous.values.volume_topology import hung_by_faces

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from porous.guests.tetwild import Wish
    from porous.stages._sizing import Field, Finer
    from porous.values import Box, SurfaceMesh

    Progress = Callable[[str, float], None]
    Sizing = Field | Sequence[Finer]

EDGE = 0.05
"""The wanted edge length where none is given, as part of the diagonal: the mesher's own."""

SECONDS = 600.0
SECONDS_PER_TRIANGLE = 0.02
"""The mesher's time limit: ten times what it took on surfaces of 1 000 to 170 000 triangles."""


def tetrahedralize(
    surface: SurfaceMesh,
    *,
    edge_length: float | None = None,
    sizing: Sizing | None = None,
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
    sizing
        Where edges shall be shorter: boxes (``Finer``), or a function that returns the wanted
        edge length (n,) at points (n, 3), in the surface's unit. Edges grow gradually from short
        to long ones; none is wanted longer than ``edge_length``, where that is given or boxes are.
    epsilon
        How far the mesh may stray from the surface, relative to its box's diagonal; a quarter of
        that is tried where its volume comes out wrong.
    stop_energy
        Quality at which the mesher is content; smaller is better and slower.
    time_limit
        In seconds, of all attempts; ten minutes and more for large surfaces by default.
    progress
        Called with the stage's name and the part done; raising in it ends the mesher. The mesher
        itself does not tell how far it is: the part stays 0 until the end.

    Raises
    ------
    MeshError
        For a surface that is empty, open or not manifold; for lengths that are not positive.
    GuestError
        Where the mesher dies, takes too long or returns a mesh of another volume.
    """
    from porous.guests.tetwild import tetrahedra

    tell = progress or (lambda _stage, _done: None)
    wish = wished(
        surface,
        edge_length=edge_length,
        sizing=sizing,
        epsilon=epsilon,
        stop_energy=stop_energy,
        time_limit=time_limit,
        tell=tell,
    )
    points, cells = tetrahedra(surface, wish)
    mesh = hung_by_faces(VolumeMesh(points, (Block("tet4", cells),), unit=surface.unit))
    tell("volume", 1.0)
    return mesh


def wished(
    surface: SurfaceMesh,
    *,
    box: Box | None = None,
    edge_length: float | None,
    sizing: Sizing | None,
    epsilon: float,
    stop_energy: float,
    time_limit: float | None,
    tell: Progress,
) -> Wish:
    """Return what the mesher is asked for: defaults said, the field of sizes on its lattice."""
    from porous.guests.tetwild import Field, Wish

    limit = SECONDS + SECONDS_PER_TRIANGLE * len(surface.triangles)
    wish = Wish(
        edge_length,
        None,
        epsilon,
        stop_energy,
        limit if time_limit is None else time_limit,
        lambda _: tell("volume", 0.0),
    )
    if sizing is None or (not callable(sizing) and not len(sizing)):
        return wish
    box = surface.box if box is None else box
    if edge_length is None and not callable(sizing):
        edge_length = EDGE * float(np.linalg.norm(box.lengths))
    field = background(sizing, box, edge_length=edge_length)
    longest = float(field.lengths.max()) if edge_length is None else edge_length
    return replace(wish, edge_length=longest, field=Field(*field))
