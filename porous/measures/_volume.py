"""How much space the solid takes, on voxels and on meshes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from porous.measures import _porosity
from porous.measures._answer import answer
from porous.measures._census import Census
from porous.measures._mesh import SURFACE, VOLUME, SurfaceCensus, VolumeCensus
from porous.values import Measure, SurfaceMesh, VolumeMesh

if TYPE_CHECKING:
    from porous.values.tiled import Tiled


def volume(subject: Tiled | SurfaceMesh | VolumeMesh, *, method: str | None = None) -> Measure:
    """Return the volume of the solid, in the subject's unit cubed.

    Parameters
    ----------
    subject
        A grid, a closed surface or a volume mesh.
    method
        Of a grid ``"voxel fill"`` (default) or ``"voxel count"``; meshes have one method each.
    """
    if isinstance(subject, SurfaceMesh):
        return answer(SURFACE, "volume", method or "triangles", SurfaceCensus(subject))
    if isinstance(subject, VolumeMesh):
        return VOLUME["volume"](VolumeCensus(subject))
    return answer(_porosity.GRID, "volume", method or "voxel fill", Census(subject))
