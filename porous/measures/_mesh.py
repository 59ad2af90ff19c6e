"""What surfaces and volume meshes say of the solid, and how well shaped their elements are."""

from __future__ import annotations

import math
from functools import cached_property, partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import MeshError
from porous.measures._quality import ROWS, quality
from porous.values import SHAPES, Measure
from porous.values.surface_topology import euler_number, joined, pieces
from porous.values.volume_topology import Faces, faces, matched

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.measures._answer import Table
    from porous.measures._quality import Quality
    from porous.values import SurfaceMesh, VolumeMesh

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

EXACT, WALL = "exact boundary", "WALL"

CAPS = ("XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX")
"""Names of the triangles that close a surface where the frame cuts it."""

GATHERED = 1e-12
"""Relative to the body's size: how far an exact boundary's points may have been moved together."""

FULL = 1e-13
"""A body that differs from its bulk by no more than this part of it fills it."""

ROUNDING = 4e-16
"""Relative error of a sum of products of coordinates, per term's size; numpy sums in pairs."""


class SurfaceCensus:
    """What the measures of a surface are made of.

    Parameters
    ----------
    surface
        Closed and oriented, else volume and topology mean nothing.
    method
        How the surface was made, the rows' method: ``"triangles"``, or ``"exact boundary"``.
    volume_doubt, area_doubt
        Uncertainties as measures of the body that the surface stands for, in its unit; zero where
        the surface is the body.
    periodic
        Axes along which the body goes on: caps across them are not of its surface.
    """

    def __init__(
        self,
        surface: SurfaceMesh,
        *,
        method: str = "triangles",
        volume_doubt: float = 0.0,
        area_doubt: float = 0.0,
        periodic: tuple[bool, bool, bool] = (False, False, False),
    ) -> None:
        self.surface = surface
        self.method = method
        self.periodic = periodic
        self.areas: Floats = surface.areas
        area, size = float(self.areas.sum()), float(np.abs(surface.points).max(initial=0.0))
        moved = GATHERED * size if method == EXACT else 0.0
        rounding = ROUNDING * len(self.areas) ** 0.5 * area
        # A triangle whose corners move by d changes by no more than half its girth times d.
        volume_doubt, area_doubt = (
            volume_doubt + surface.altered[0],
            area_doubt + surface.altered[1],
        )
        self.area_doubt = area_doubt + rounding + (moved * _girths(surface) / 2 if moved else 0.0)
        self.volume_doubt = volume_doubt + (ROUNDING * size + moved) * area

    @cached_property
    def shells(self) -> Indices:
        """Which piece each triangle is of; pieces hang by edges."""
        return pieces(self.surface)

    @cached_property
    def shell_volumes(self) -> Floats:
        """Volume that each piece encloses, negative about a cavity, in its unit cubed."""
        if not len(self.shells):
            return np.zeros(0)
        return np.asarray(np.bincount(self.shells, self.surface.cones), np.float64)

    @cached_property
    def euler_number(self) -> int:
        """Vertices − edges + triangles."""
        return euler_number(self.surface)

    def area_without(self, names: tuple[str, ...]) -> float:
        """Return the area of the triangles that are not of these parts."""
        counted = np.array([name not in names for name in self.surface.names])
        return float(self.areas[counted[self.surface.labels]].sum())

    def area_row(self, name: str, caps: tuple[str, ...]) -> Measure:
        """Return the area without some caps; where they end is as uncertain as the whole."""
        return self.row(name, self.area_without(caps), f"{self.surface.unit}²", self.area_doubt)

    def row(self, name: str, value: float, unit: str, doubt: float | None = None) -> Measure:
        """Return a row of this surface; exact where there is no doubt."""
        kind = "exact" if doubt is None else "standard"
        return Measure(name, value, unit, self.method, doubt or 0.0, kind, "surface")


def _girths(surface: SurfaceMesh) -> float:
    """Return the sum of the lengths of all sides of the triangles."""
    corners = surface.corners
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).sum())


def _surface_area(census: SurfaceCensus) -> Measure:
    across = [axis for axis, wraps in enumerate(census.periodic) if wraps]
    caps = tuple(name for axis in across for name in CAPS[2 * axis : 2 * axis + 2])
    return census.area_row("surface_area", caps)


def _surface_interface(census: SurfaceCensus) -> Measure:
    # A model names the sides of its body, wherever they lie; all else is the wall of its pores.
    named = census.method == EXACT and WALL in census.surface.names
    sides = tuple(name for name in census.surface.names if name != WALL) if named else CAPS
    return census.area_row("interface_area", sides)


def _surface_volume(census: SurfaceCensus) -> Measure:
    total = float(census.shell_volumes.sum())
    return census.row("volume", total, f"{census.surface.unit}³", census.volume_doubt)


def _surface_components(census: SurfaceCensus) -> Measure:
    return census.row("components", int((census.shell_volumes > 0).sum()), "1")


def _solid_euler(census: SurfaceCensus) -> Measure:
    return census.row("euler_number", census.euler_number / 2, "1")


def _surface_genus(census: SurfaceCensus) -> Measure:
    return census.row("genus", len(census.shell_volumes) - census.euler_number / 2, "1")


def _shells(census: SurfaceCensus) -> Measure:
    return census.row("shells", len(census.shell_volumes), "1")


def _surface_euler(census: SurfaceCensus) -> Measure:
    return census.row("surface_euler_number", census.euler_number, "1")


SURFACE: Table[SurfaceCensus] = {
    ("volume", "triangles"): _surface_volume,
    ("surface_area", "triangles"): _surface_area,
    ("interface_area", "triangles"): _surface_interface,
    ("components", "triangles"): _surface_components,
    ("euler_number", "triangles"): _solid_euler,
    ("genus", "triangles"): _surface_genus,
    ("shells", "triangles"): _shells,
    ("surface_euler_number", "triangles"): _surface_euler,
}
"""Rows of a surface; those of an exact boundary carry that method's name."""

TOPOLOGY = ("components", "euler_number", "genus", "components_26", "euler_number_26", "genus_26")
"""What a capped surface or mesh cannot tell of the periodic body that it was cut from."""


def of_bulk(volume: Measure, area: Measure | None, bulk: float) -> tuple[Measure, ...]:
    """Return porosity, relative density and specific surface from a mesh's volume and area."""

    def row(name: str, value: float, unit: str, doubt: float, like: Measure) -> Measure:
        return Measure(name, value, unit, like.method, doubt, like.kind, like.of)

    part, doubt = volume.value / bulk, volume.uncertainty / bulk
    if math.isclose(part, 1.0, rel_tol=FULL):
        part = 1.0
    rows = [
        row("porosity", 1 - part, "1", doubt, volume),
        row("relative_density", part, "1", doubt, volume),
    ]
    if area is not None:
        unit = "1/" + area.unit.rstrip("²")
        value, doubt = area.value / bulk, area.uncertainty / bulk
        rows.append(row("specific_surface_area", value, unit, doubt, area))
    return tuple(rows)


class Counts(NamedTuple):
    """How many there are of each."""

    nodes: int
    edges: int
    faces: int


class VolumeCensus:
    """What the measures of a volume mesh are made of.

    Parameters
    ----------
    mesh
        Of any cells. A model's own are the body itself: their measures are exact.
    volume_doubt
        Uncertainty as a measure of the body that the mesh stands for, in its unit.
    """

    def __init__(self, mesh: VolumeMesh, *, volume_doubt: float = 0.0) -> None:
        if not mesh.cells:
            raise MeshError("volume mesh: has no cells to measure")
        self.mesh = mesh
        self.is_body = mesh.is_of_cells
        shapes = {block.shape for block in mesh.blocks}
        several = self.is_body or len(shapes) > 1
        self.method = "cells" if several else _METHODS[shapes.pop()]
        self.volumes = mesh.volumes
        self.volume_doubt = volume_doubt + ROUNDING * float(np.abs(self.volumes).sum())

    def row(self, name: str, value: float, unit: str, doubt: float | None = None) -> Measure:
        """Return a row of this mesh; exact where there is no doubt."""
        kind = "exact" if doubt is None else "standard"
        return Measure(name, value, unit, self.method, doubt or 0.0, kind, "volume")

    @cached_property
    def faces(self) -> Faces:
        """Every face of every cell."""
        return faces(self.mesh)

    @cached_property
    def quality(self) -> Quality:
        """How well shaped each cell is."""
        return quality(self.mesh, self.volumes)

    @cached_property
    def pairs(self) -> tuple[Indices, Indices]:
        """Which of ``faces`` are two sides of one."""
        return matched(self.faces)

    @cached_property
    def every(self) -> Counts:
        """How many nodes, edges and faces there are."""
        once = np.ones(len(self.faces.nodes), dtype=bool)
        once[self.pairs[1]] = False
        ring = self.faces.nodes[once]
        return Counts(_nodes(ring), _edges(ring), len(ring))

    @cached_property
    def inner(self) -> Counts:
        """How many of them are of no face of one cell only."""
        outer = np.ones(len(self.faces.nodes), dtype=bool)
        outer[np.concatenate(self.pairs)] = False
        ring, every = self.faces.nodes[outer], self.every
        return Counts(every.nodes - _nodes(ring), every.edges - _edges(ring), len(self.pairs[0]))


_METHODS = {
    **dict.fromkeys(("tet4", "tet10"), "tetrahedra"),
    **dict.fromkeys(("hex8", "hex20"), "hexahedra"),
    "wed6": "wedges",
}


def _mesh_volume(census: VolumeCensus) -> Measure:
    unit = f"{census.mesh.unit}³"
    doubt = None if census.is_body else census.volume_doubt
    return census.row("volume", float(census.volumes.sum()), unit, doubt)


def _mesh_components(census: VolumeCensus) -> Measure:
    first, second = census.pairs
    cell = census.faces.members[:, 0]
    return census.row(
        "components", int(joined(census.mesh.cells, cell[first], cell[second]).max()) + 1, "1"
    )


def _mesh_euler(census: VolumeCensus) -> Measure:
    # A node or an edge on the boundary joins nothing, whether cells share it or not.
    inner = census.inner
    value = census.mesh.cells - inner.faces + inner.edges - inner.nodes
    return census.row("euler_number", value, "1")


def _closed_euler(census: VolumeCensus) -> Measure:
    every = census.every
    value = every.nodes - every.edges + every.faces - census.mesh.cells
    return census.row("mesh_euler_number", value, "1")


def pinched_nodes(census: VolumeCensus) -> Measure:
    """Return how often voids meet in a node of cells that share nodes across faces only.

    Voxels join voids there (and digital topology with them), surfaces go round each of them: with
    k voids at a node half a surface's Euler number is k − 1 above the solid's.
    """
    # The cells about a node are a disc with k holes, seen from it: their sides less the faces
    # between them plus the edges among these are 2 − k, and 2 at a node inside.
    inner, every = census.inner, census.every
    corners = [(SHAPES[block.shape], len(block.cells)) for block in census.mesh.blocks]
    slots = sum(count * (1 + max(map(max, shape.faces))) for shape, count in corners)
    ends = int((census.faces.nodes[census.pairs[0]] >= 0).sum())
    discs = slots - ends + 2 * inner.edges - 2 * inner.nodes
    return census.row("pinched_nodes", every.nodes - inner.nodes - discs, "1")


def _nodes(ring: Indices) -> int:
    return int(np.count_nonzero(np.bincount(ring[ring >= 0])))


def _edges(ring: Indices) -> int:
    """Return the number of edges of faces (f, 4), of triangles with −1 in the last place."""
    following = np.where(np.roll(ring, -1, axis=1) < 0, ring[:, :1], np.roll(ring, -1, axis=1))
    a, b = ring[ring >= 0], following[ring >= 0]
    keys = np.sort(np.minimum(a, b) * (ring.max(initial=0) + 1) + np.maximum(a, b))
    return int(np.count_nonzero(np.diff(keys, prepend=-1)))


def _least_volume(census: VolumeCensus) -> Measure:
    unit = f"{census.mesh.unit}³"
    return census.row("smallest_cell_volume", float(census.volumes.min()), unit)


def _shape_row(census: VolumeCensus, *, name: str) -> Measure:
    number, unit, of_all = ROWS[name]
    return census.row(name, of_all(getattr(census.quality, number)), unit)


VOLUME: dict[str, Callable[[VolumeCensus], Measure]] = {
    "volume": _mesh_volume,
    "components": _mesh_components,
    "euler_number": _mesh_euler,
    "mesh_euler_number": _closed_euler,
    "smallest_cell_volume": _least_volume,
    **{name: partial(_shape_row, name=name) for name in ROWS},
}


def volume_rows(census: VolumeCensus) -> dict[str, Measure]:
    """Return every row of a volume mesh, by its name."""
    return {name: row(census) for name, row in VOLUME.items()}


def smallest_dihedral_angle(mesh: VolumeMesh) -> Measure:
    """Return the smallest angle between two faces of a cell, in degrees.

    Bent faces by their tangent planes at each corner; of quadratic cells by their corners.
    """
    return VOLUME["smallest_dihedral_angle"](VolumeCensus(mesh))


def largest_dihedral_angle(mesh: VolumeMesh) -> Measure:
    """Return the largest angle between two faces of a cell, in degrees; see the smallest."""
    return VOLUME["largest_dihedral_angle"](VolumeCensus(mesh))


def smallest_scaled_jacobian(mesh: VolumeMesh) -> Measure:
    """Return the worst corner: determinant of its edges over their lengths, unit 1.

    1 for cubes, regular tetrahedra and wedges, below zero for a cell that is turned inside out
    (P. Knupp 2003, Finite Elements in Analysis and Design 39:217).
    """
    return VOLUME["smallest_scaled_jacobian"](VolumeCensus(mesh))


def largest_edge_ratio(mesh: VolumeMesh) -> Measure:
    """Return the largest ratio of a cell's longest edge to its shortest, unit 1.

    C. J. Stimpson and others 2007, The Verdict geometric quality library, SAND2007-1751.
    """
    return VOLUME["largest_edge_ratio"](VolumeCensus(mesh))


def largest_aspect_ratio(mesh: VolumeMesh) -> Measure:
    """Return the largest aspect ratio of a cell, unit 1; a regular one has 1.

    Longest edge times surface over three volumes, over the same of a regular cell. Of tetrahedra
    that is the longest edge over 2√6 times the radius of the inscribed ball (C. J. Stimpson and
    others 2007, The Verdict geometric quality library, SAND2007-1751).
    """
    return VOLUME["largest_aspect_ratio"](VolumeCensus(mesh))
