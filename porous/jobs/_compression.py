"""Static compression along z: the lower side is held, the upper side bears a pressure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError
from porous.values import Held, Job, Pressed, Step
from porous.values.volume_topology import bodies, extracted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.values import Material, VolumeMesh

    Indices = NDArray[np.int64]

FIXED, LOADED = "ZMIN", "ZMAX"


def compression(mesh: VolumeMesh, *, material: Material, pressure: float) -> Job:
    """Return the job of pressing a mesh from above while its lower side is held.

    The mesh is cut down to the one body, joined across faces, that has faces on both sides:
    whatever hangs on it by a point or an edge, or not at all, bears no load and would leave the
    solver with a mechanism. Where there is no such body, or several, the job has no step and says
    why.

    Parameters
    ----------
    mesh
        With the parts that ``name_parts`` gives.
    material
        Of all cells.
    pressure
        In MPa, on the faces of ``ZMAX``; positive pushes down.

    Raises
    ------
    MeshError
        For a mesh without cells, or a pressure that is no number.
    """
    if not mesh.cells:
        raise MeshError("compression: the mesh has no cells")
    if not math.isfinite(pressure):
        raise MeshError(f"pressure: got {pressure} MPa; wanted a number")
    title = f"static compression of {material.name}, {pressure:g} MPa on {LOADED}, {FIXED} held"
    materials = {name: material for name in ("SOLID",) if name in mesh.parts}
    body = bodies(mesh)
    between = np.intersect1d(_on(mesh, body, FIXED), _on(mesh, body, LOADED))
    if len(between) != 1:
        why = _why_not(mesh, body, len(between))
        return Job(title, mesh, materials, why_no_step=why)
    kept = body == between[0]
    step = Step(
        "compression",
        "static",
        (Held(FIXED, "displacement", components=(0, 1, 2)),),
        (Pressed(f"{LOADED}_FACES", float(pressure)),),
    )
    return Job(title, extracted(mesh, kept), materials, (step,), note=_left_out(body, kept))


def _on(mesh: VolumeMesh, body: Indices, side: str) -> Indices:
    """Return the bodies with faces on a side; one that stands on a point or an edge tips over."""
    part = mesh.parts.get(f"{side}_FACES")
    return np.zeros(0, np.int64) if part is None else np.unique(body[part.members[:, 0]])


def _why_not(mesh: VolumeMesh, body: Indices, between: int) -> str:
    count = int(body.max()) + 1
    apart = f"the mesh falls into {count} bodies that no face joins" if count > 1 else ""
    joins = "where they only touch, contacts = 'fuse' or an offset joins them"
    if between:
        return (
            f"{apart}, and {between} of them reach from {FIXED} to {LOADED}, each by itself: a "
            f"step would press them side by side, not one material; {joins}"
        )
    bare = [side for side in (FIXED, LOADED) if not len(_on(mesh, body, side))]
    if bare:
        flat = (
            f"no face lies on {' or '.join(bare)}, and a point or an edge can be neither held nor "
            "pressed: choose a domain whose sides cut the body flat"
        )
        return f"{apart}: {joins}; {flat}" if apart else flat
    return (
        f"no face-connected body joins {FIXED} and {LOADED}: {apart}, and touching in a point or "
        f"an edge bears no load; {joins}"
    )


def _left_out(body: Indices, kept: NDArray[np.bool_]) -> str:
    count = int(body.max())
    if not count:
        return ""
    return (
        f"{count} bodies of {int((~kept).sum())} cells left out: no face joins them to the body "
        "that bears the load"
    )
