"""Solid and pore together: tetrahedra of a whole box with one interface between the phases."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GuestError, MeshError
from porous.stages._inside import inside
from porous.stages._tetrahedralize import wished
from porous.values import SHAPES, Block, Box, VolumeMesh
from porous.values.box import SIDES
from porous.values.volume_mesh import PHASE
from porous.values.volume_topology import boundary_faces, extracted, hung_by_faces, nodes_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.guests.tetwild import Tetrahedra
    from porous.stages._tetrahedralize import Sizing
    from porous.values import SurfaceMesh

    Progress = Callable[[str, float], None]
    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

PHASES = {"pore": 0, "solid": 1}
"""What the tag ``PHASE`` says of a cell."""

STRAYED = 2.0
"""How far the mesher may leave the box's sides, in its epsilon; nodes so near are put on them."""
BEYOND = 1e-9
"""How far beyond a box a surface may reach, as part of its diagonal."""


def tetrahedralize_phases(
    surface: SurfaceMesh,
    box: Box | None = None,
    *,
    edge_length: float | None = None,
    sizing: Sizing | None = None,
    epsilon: float = 1e-3,
    stop_energy: float = 10.0,
    time_limit: float | None = None,
    progress: Progress | None = None,
) -> VolumeMesh:
    """Fill a box with tetrahedra of the solid and of the pores, which share their nodes.

    Each cell's tag ``"phase"`` is 1 in the solid and 0 in the pores. Faces between them are faces
    of two cells, as all others inside; the box's sides are flat. Where a solid touches itself or
    a side in a point or an edge only, nodes are shared there. ``phase_alone`` takes one of them.

    Parameters
    ----------
    surface
        The solid's: closed, oriented, manifold, inside the box; with caps where it ends at a side.
    box
        What to fill, in the surface's unit; the surface's own box by default.
    edge_length, sizing, epsilon, stop_energy, time_limit, progress
        As for ``tetrahedralize``; lengths that follow from a diagonal follow from the box's.

    Raises
    ------
    MeshError
        For a surface that is empty, open, not manifold or not inside the box; for a box without
        volume.
    GuestError
        Where the mesher dies, takes too long, or returns phases of another volume.
    """
    from porous.guests.tetwild import attempted, check_manifold

    tell = progress or (lambda _stage, _done: None)
    check_manifold(surface)
    box = surface.box if box is None else box
    _check_box(surface, box)
    points, triangles = _with_sides(surface, box)
    wish = wished(
        surface,
        box=box,
        edge_length=edge_length,
        sizing=sizing,
        epsilon=epsilon,
        stop_energy=stop_energy,
        time_limit=time_limit,
        tell=tell,
    )

    def both(found: Tetrahedra, epsilon: float) -> VolumeMesh:
        reach = STRAYED * epsilon * float(np.linalg.norm(box.lengths))
        mesh = _put_on_sides(_inside_box(found, box, surface.unit), box, reach)
        phase = inside(surface, mesh.points[mesh.blocks[0].cells].mean(axis=1))
        _check_phases(surface, box, mesh, phase)
        return replace(mesh, cell_tags={PHASE: phase.astype(np.int64)})

    mesh = attempted(points, triangles, wish, both, whole=True)
    tell("volume", 1.0)
    return mesh


def phase_alone(mesh: VolumeMesh, phase: str) -> VolumeMesh:
    """Return the solid or the pores of a mesh of both, as a mesh of its own without parts.

    Cells that meet in a point or an edge only share no nodes.

    Parameters
    ----------
    mesh
        With the tag ``"phase"``.
    phase
        ``"solid"`` or ``"pore"``.

    Raises
    ------
    MeshError
        For another phase, or a mesh that has none of it.
    """
    if phase not in PHASES:
        raise MeshError(f"phase: got {phase!r}; wanted one of {', '.join(PHASES)}")
    if PHASE not in mesh.cell_tags:
        raise MeshError(f"mesh: has no tag {PHASE!r}; wanted one of tetrahedralize_phases")
    chosen = mesh.cell_tags[PHASE] == PHASES[phase]
    if not chosen.any():
        raise MeshError(f"mesh: has no cells of the {phase}")
    return hung_by_faces(replace(extracted(mesh, chosen), parts={}))


def _check_box(surface: SurfaceMesh, box: Box) -> None:
    if not box.volume > 0:
        raise MeshError(f"box: has no volume, from {box.lower} to {box.upper}")
    slack = BEYOND * float(np.linalg.norm(box.lengths))
    if not box.contains(surface.box, tolerance=slack):
        raise MeshError(
            f"surface: reaches from {surface.box.lower} to {surface.box.upper}; wanted it inside "
            f"the box from {box.lower} to {box.upper}"
        )


def _with_sides(surface: SurfaceMesh, box: Box) -> tuple[Floats, Indices]:
    """Return points and triangles of the surface and of the box's sides, each facing outwards."""
    corners = np.array(box.corners)[[0, 4, 6, 2, 1, 5, 7, 3]]  # of a hexahedron
    sides = np.array(SHAPES["hex8"].faces)
    flat = np.concatenate([sides[:, [0, 1, 2]], sides[:, [0, 2, 3]]])
    points = np.concatenate([surface.points, corners])
    return points, np.concatenate([surface.triangles, flat + len(surface.points)])


def _inside_box(found: Tetrahedra, box: Box, unit: str) -> VolumeMesh:
    centre = found.points[found.tets].mean(axis=1)
    kept = ((centre > box.lower) & (centre < box.upper)).all(axis=1)
    return extracted(VolumeMesh(found.points, (Block("tet4", found.tets),), unit=unit), kept)


def _put_on_sides(mesh: VolumeMesh, box: Box, reach: float) -> VolumeMesh:
    """Return the mesh with its boundary on the box: each outer face on the side it lies along.

    Raises
    ------
    GuestError
        Where an outer face is further from every side than ``reach``.
    """
    faces = nodes_of(mesh, boundary_faces(mesh))[:, :3]
    corners = mesh.points[faces]
    ends = np.array([box.lower, box.upper])
    # Axis by axis, the lower side and the upper: how far off the farthest corner of a face is.
    off = np.abs(corners[:, :, :, None] - ends.T).max(axis=1).reshape(-1, 6)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = np.stack([-normal, normal], axis=2).reshape(-1, 6)
    side = np.where(off <= reach, facing, -np.inf).argmax(axis=1)
    lost = np.flatnonzero(off[np.arange(len(side)), side] > reach)
    if len(lost):
        place = ", ".join(f"{x:.6g}" for x in corners[lost[0]].mean(axis=0))
        raise GuestError(
            f"the mesh of both phases does not end on the box: {len(lost)} faces lie further than "
            f"{reach:.3g} from its sides, the first at ({place}); a smaller epsilon or edge_length "
            "follows it more closely"
        )
    points = mesh.points.copy()
    for number in range(len(SIDES)):
        points[faces[side == number], number // 2] = ends[number % 2, number // 2]
    return replace(mesh, points=points)


def _check_phases(
    surface: SurfaceMesh, box: Box, mesh: VolumeMesh, phase: NDArray[np.bool_]
) -> None:
    from porous.guests.tetwild import VOLUME_TOLERANCE

    volumes = mesh.volumes
    flat = int((~(volumes > 0)).sum())
    if flat:
        raise GuestError(
            f"the mesh of both phases has {flat} cells without volume; a smaller epsilon or "
            "edge_length follows the surface more closely"
        )
    solid, whole = float(volumes[phase].sum()), float(volumes.sum())
    wanted = {"box": (whole, box.volume), "solid": (solid, surface.volume)}
    pore = box.volume - surface.volume
    if pore > VOLUME_TOLERANCE * box.volume:
        wanted["pore"] = (whole - solid, pore)
    for name, (is_now, shall_be) in wanted.items():
        error = is_now / shall_be - 1
        if abs(error) >= VOLUME_TOLERANCE:
            raise GuestError(
                f"the mesh of both phases is {100 * error:+.2g} % off in the volume of the {name}, "
                f"which is {shall_be:.6g} {surface.unit}³; a smaller epsilon or edge_length "
                "follows thin features more closely"
            )
