"""All that is known of a subject, by one call."""

from __future__ import annotations

import builtins
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError
from porous.measures import _boxes, _pores, _porosity, _surface_area, _topology
from porous.measures._census import Census, Extent, FillCounts, WindowCounts
from porous.measures._connected import PieceCounts, Pieces, Sightings
from porous.measures._fold import Sums
from porous.measures._mesh import (
    EXACT,
    SURFACE,
    TOPOLOGY,
    VOLUME,
    SurfaceCensus,
    VolumeCensus,
    of_bulk,
    pinched_nodes,
    volume_rows,
)
from porous.measures._model import model_rows
from porous.measures._porosity import Amounts
from porous.measures._roughness import roughness_of_skins
from porous.measures._streamed import streamed_rows
from porous.measures._surface_area import surface_doubt
from porous.models.model import HasBulk, HasCells, HasExact
from porous.stages import StreamedSurface
from porous.values import Measures, SurfaceMesh, Tiled, VolumeMesh
from porous.values.surface_topology import check_closed
from porous.values.volume_mesh import PHASE
from porous.values.volume_topology import extracted, hung_by_faces

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from porous.measures._answer import Table
    from porous.measures._fold import Tile
    from porous.models.model import Model
    from porous.values import Measure
    from porous.values.tiled import Map

    Subject = Model | Tiled | Census | SurfaceMesh | StreamedSurface | VolumeMesh
    Progress = Callable[[str, float], None]
    Axes = tuple[bool, bool, bool]

GRID: Table[Census] = {
    **_porosity.GRID,
    **_pores.GRID,
    **_surface_area.GRID,
    **_topology.GRID,
    **_boxes.GRID,
}
"""Every row of a grid, by name and method."""

COUNTED = (Sums, FillCounts, WindowCounts, Extent, Pieces, PieceCounts, Sightings, _boxes.BoxSums)
"""Classes that counts of tiles are made of, besides arrays and numbers."""

OF_BODY = {"volume", "components", "euler_number", "mesh_euler_number"}
"""Rows of a mesh that are of the body it fills; all others are of its cells."""

TETRAHEDRA = 1e-3
"""Part of the volume by which a tetrahedral mesh may differ from the surface that it fills."""


def measure(
    subject: Subject,
    *,
    model: Model | None = None,
    grid: Tiled | Census | None = None,
    tiles: Sequence[Tile] | None = None,
    map: Map = builtins.map,  # noqa: A002
    progress: Progress | None = None,
) -> Measures:
    """Return all that is known of a model, a grid, a surface or a volume mesh.

    Parameters
    ----------
    subject
        What to measure. A model gives its closed forms and dimensions. A grid need not lie in
        memory: whatever gives out boxes of one (``values.Tiled``) is measured tile by tile. A
        ``Census`` stands for its grid here and below, and remembers what was counted of it. Of a
        surface that went into a file, what is known is told of the grid that it was made from.
    model
        The model that the subject was made from: whose exact boundary a surface is (or a mesh
        fills), whose cells a mesh consists of, or which ``grid`` is of. Porosity and specific
        surface refer to its bulk. For a grid, the model that it samples: where that has a bulk of
        its own, the grid's bulk is as uncertain as what is solid.
    grid
        The grid that a surface or a mesh was made from: uncertainties are then those of that
        detour, caps across periodic axes are no surface, and porosity refers to the grid's bulk
        where the model has none of its own. A model's own cells are made from no grid: it tells
        only whether they are cut out of a periodic body. For a model, the grid whose periodicity
        its closed forms shall have.
    tiles, map
        Of a grid: boxes as (start, stop) that fill it, such of its own choice where not given, and
        how a function is called for each of them; see ``fold``. The rows do not depend on them.
    progress
        Called as ``progress("measures", done)`` with done in 0 … 1, after each tile of a grid that
        is the subject; raising in it cancels.

    Returns
    -------
    Measures
        A surface and a mesh that came from neither are taken for the body itself, but for what
        simplification and smoothing have changed.

    Raises
    ------
    GridError, MeshError
        Where there is nothing to measure.
    """
    if isinstance(subject, StreamedSurface):
        return Measures(tuple(_streamed_rows(subject, model, grid)))
    if isinstance(subject, SurfaceMesh):
        return Measures(tuple(_surface_rows(subject, model, grid)))
    if isinstance(subject, VolumeMesh):
        return Measures(tuple(_mesh_rows(subject, model, grid)))
    if isinstance(subject, Tiled | Census):
        census = Census.of(subject, tiles=tiles, sampled=isinstance(model, HasBulk), map=map)
        rows = (*_grid_rows(census, progress), *roughness_of_skins(census.source, model))
        return Measures(rows)
    periodic = (False, False, False) if grid is None else grid.frame.periodic
    return Measures(tuple(model_rows(subject, periodic)))


def _grid_rows(census: Census, progress: Progress | None) -> Iterator[Measure]:
    def report(done: int, count: int) -> None:
        assert progress is not None
        progress("measures", done / count)

    boxes = _boxes.BoxCount.of(census.frame.shape)
    census.take_all((boxes,), None if progress is None else report)
    untold = {
        "genus": any(census.frame.periodic),
        "genus_26": any(census.frame.periodic),
        "interface_area": census.sampled,
        # A tilted or bent end is no layer of voxels that a pore could lead to.
        **{f"through_porosity_{axis}": census.sampled for axis in "xyz"},
        "box_dimension": not _boxes.has_dimension(census),
    }
    for (name, _), row in GRID.items():
        if not untold.get(name, False):
            yield row(census)


def _streamed_rows(
    surface: StreamedSurface, model: Model | None, grid: Tiled | Census | None
) -> Iterator[Measure]:
    if grid is None:
        raise MeshError("a surface in a file: wanted the grid that it was made from, to measure it")
    rows = streamed_rows(surface, Census.of(grid))
    if isinstance(model, HasBulk) and Census.of(grid).has_bulk:
        rows.pop("interface_area")  # the sides of a curved bulk are no sides of the frame
    yield from rows.values()
    bulk = _bulk_volume(model, grid)
    if bulk is not None:
        yield from of_bulk(rows["volume"], rows.get("surface_area"), bulk)


def _surface_rows(
    surface: SurfaceMesh, model: Model | None, grid: Tiled | Census | None
) -> Iterator[Measure]:
    check_closed(surface)
    periodic = (False, False, False) if grid is None else grid.frame.periodic
    if grid is None:
        is_body = model is not None and not any(surface.altered)
        census = SurfaceCensus(surface, method=EXACT if is_body else "triangles")
    else:
        doubts = surface_doubt(Census.of(grid), surface)
        census = SurfaceCensus(
            surface, volume_doubt=doubts[0], area_doubt=doubts[1], periodic=periodic
        )
    rows = {name: row(census) for (name, _), row in SURFACE.items()}
    if grid is not None and isinstance(model, HasBulk) and Census.of(grid).has_bulk:
        del rows["interface_area"]  # the sides of a curved bulk are no sides of the frame
    if grid is None and model is not None:
        rows = _by_convention(rows, model)
    yield from _told(rows, periodic)
    bulk = _bulk_volume(model, grid)
    if bulk is not None:
        yield from of_bulk(rows["volume"], rows["surface_area"], bulk)


def _mesh_rows(
    mesh: VolumeMesh, model: Model | None, grid: Tiled | Census | None
) -> Iterator[Measure]:
    phase = mesh.cell_tags.get(PHASE, np.ones(mesh.cells))
    if np.isin(phase, (0, 1)).all() and not phase.all():
        yield from _phase_rows(mesh, model, grid)
        return
    census = VolumeCensus(mesh)
    if census.is_body:
        periodic = (False, False, False) if grid is None else grid.frame.periodic
        rows = {row.name: row for row in _cell_rows(census, model)}
        yield from _told(rows, periodic)
        return
    total = float(census.volumes.sum())
    if census.method == "tetrahedra" and (model is not None or grid is not None):
        census.volume_doubt += TETRAHEDRA * total
    if grid is not None:
        amounts, voxel = Amounts(Census.of(grid)), grid.frame.voxel_volume
        census.volume_doubt += (
            abs(total - amounts.everywhere * voxel) + amounts.everywhere_doubt * voxel
        )
    rows = volume_rows(census)
    if census.method == "tetrahedra" and model is not None and grid is None:
        rows = _by_convention(rows, model)
    periodic = (False, False, False) if grid is None else grid.frame.periodic
    yield from _told(rows, periodic)
    bulk = _bulk_volume(model, grid)
    if bulk is not None:
        yield from of_bulk(rows["volume"], None, bulk)


def _phase_rows(
    mesh: VolumeMesh, model: Model | None, grid: Tiled | Census | None
) -> Iterator[Measure]:
    """Yield the rows of a mesh of pores, or of solid and pores.

    The solid is measured as a mesh of its own, and so are the pores; what is told of single cells
    is told of all. Where no other bulk is known it is what both fill.
    """
    is_solid = mesh.cell_tags[PHASE] == 1
    whole = VolumeCensus(VolumeMesh(mesh.points, mesh.blocks, unit=mesh.unit))
    bare = whole.mesh
    shapes = {name: row(whole) for name, row in VOLUME.items() if name not in OF_BODY}
    bulk = _bulk_volume(model, grid)
    if is_solid.any():
        solid = list(_mesh_rows(hung_by_faces(extracted(bare, is_solid)), model, grid))
        yield from (row for row in solid if row.name in OF_BODY or row.name not in shapes)
        if bulk is None:
            volume = next(row for row in solid if row.name == "volume")
            yield from of_bulk(volume, None, float(whole.volumes.sum()))
    yield from shapes.values()
    pores = VolumeCensus(extracted(bare, ~is_solid))
    pores.volume_doubt += _pore_doubt(pores, model, grid)
    total = float(pores.volumes.sum())
    row = pores.row("pore_volume", total, f"{mesh.unit}³", pores.volume_doubt)
    yield row
    if bulk is not None and not is_solid.any():
        part, doubt = row.value / bulk, row.uncertainty / bulk
        yield replace(row, name="porosity", value=part, unit="1", uncertainty=doubt)


def _pore_doubt(census: VolumeCensus, model: Model | None, grid: Tiled | Census | None) -> float:
    """Return how far the pores' volume may be off that of the body's pores."""
    total = float(census.volumes.sum())
    made = census.method == "tetrahedra" and (model is not None or grid is not None)
    doubt = TETRAHEDRA * total if made else 0.0
    if grid is None:
        return doubt
    amounts, voxel = Amounts(Census.of(grid)), grid.frame.voxel_volume
    void = (amounts.bulk - amounts.everywhere) * voxel
    return doubt + abs(total - void) + amounts.everywhere_doubt * voxel


def _cell_rows(census: VolumeCensus, model: Model | None) -> Iterator[Measure]:
    """Yield the rows of a model's own cells.

    Where cells share nodes that they touch in, the mesh is the closed union, and told as such.
    """
    rows = volume_rows(census)
    yield from rows.values()
    yield _pinched(census)
    if model is None:
        return
    yield from of_bulk(rows["volume"], None, _own_bulk(model))
    closed = rows["mesh_euler_number"]
    known = _closed_forms(model)
    if closed.value == known.get("euler_number_26"):
        yield replace(closed, name="euler_number_26")


def _by_convention(rows: Mapping[str, Measure], model: Model) -> dict[str, Measure]:
    """Name the topology of an exact boundary by the convention whose closed form it has.

    Where voids meet in a point of the solid, the boundary goes round each of them, and voxels join
    them: cells tell how often, others have the boundary of the closed union there.
    """
    known = _closed_forms(model)
    found = rows["euler_number"].value
    if isinstance(model, HasCells):
        goes_round = "shells" in rows and found != known.get("euler_number")
        return _less_pinched(rows, model) if goes_round else dict(rows)
    if found == known.get("euler_number", found) or found != known.get("euler_number_26"):
        return dict(rows)
    names = {name: f"{name}_26" if f"{name}_26" in TOPOLOGY else name for name in rows}
    return {names[name]: replace(row, name=names[name]) for name, row in rows.items()}


def _less_pinched(rows: Mapping[str, Measure], model: HasCells) -> dict[str, Measure]:
    """Take the places where voids meet off the Euler number, as ``pinched_nodes`` has them.

    How many tunnels they make does not follow from their number.
    """
    euler, count = rows["euler_number"], _pinched(VolumeCensus(model.cell_mesh()))
    if not count.value:
        return dict(rows)
    left = {name: row for name, row in rows.items() if name != "genus"}
    return {**left, "euler_number": replace(euler, value=euler.value - count.value)}


def _pinched(census: VolumeCensus) -> Measure:
    hung = hung_by_faces(census.mesh)
    apart = len(hung.points) == len(census.mesh.points)  # it has been so from the start
    return pinched_nodes(census if apart else VolumeCensus(hung))


def _closed_forms(model: Model) -> dict[str, float]:
    rows = model.exact() if isinstance(model, HasExact) else ()
    return {row.name: row.value for row in rows}


def _told(rows: Mapping[str, Measure], periodic: Axes) -> Iterator[Measure]:
    """Yield the rows that a body cut out of periodic space can tell of it."""
    for name, row in rows.items():
        if not (any(periodic) and name in TOPOLOGY):
            yield row


def _bulk_volume(model: Model | None, grid: Tiled | Census | None) -> float | None:
    """Return the volume of the bulk, or None where it is not known or does not hold the solid."""
    own = _own_bulk(model) if isinstance(model, HasBulk) or (model and grid is None) else None
    if grid is None:
        return own
    amounts = Amounts(Census.of(grid, sampled=own is not None))
    voxels = amounts.bulk * grid.frame.voxel_volume
    return None if amounts.beyond else own or voxels


def _own_bulk(model: Model) -> float:
    return model.bulk_volume if isinstance(model, HasBulk) else model.bulk.volume
