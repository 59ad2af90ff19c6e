"""How large the interface between solid and void is, on voxels and on meshes."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels.windows import CROSSINGS, DIRECTIONS
from porous.measures._answer import answer
from porous.measures._census import Census
from porous.measures._mesh import SURFACE, SurfaceCensus
from porous.measures._porosity import Amounts
from porous.values import Measure, SurfaceMesh

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.measures._answer import Table
    from porous.stages import StreamedSurface
    from porous.values.tiled import Tiled

    Floats = NDArray[np.float64]
    Spacing = tuple[float, float, float]

STAIRCASE = 1 - 1 / math.sqrt(3)
"""Voxel faces show |n_x| + |n_y| + |n_z| of each unit of area: between 1 and √3 of it."""

LOST = 2.5
"""How much of the area may be lost about edges and in thin walls, as a multiple of what every other
voxel shows less of it (or more): an error in proportion to their size has 1 (``analysis/03``)."""

STEPPED = 0.09
"""Triangles on a binary grid show up to 9 % too much of a curved surface (Lindblad & Nyström
2002); on solid fractions ``SMOOTH``."""

SMOOTH = 0.005

FLAT = 0.18
"""Spread of the projected areas (standard deviation over mean) of a cube along the axes. There the
estimate is off by the whole plane bias; where there is no spread it averages out."""


NEEDLE = 1e-5
"""Spacings below this part of the longest are taken for it when the sphere is shared out: double
precision cannot tell the cells of directions apart that lie closer."""


class Crofton(NamedTuple):
    """The 13 directions of a lattice: weights that add up to 1, lengths, bias over all planes."""

    weights: Floats
    lengths: Floats
    lowest: float
    highest: float
    spread: float


@lru_cache(maxsize=32)
def crofton(spacing: Spacing) -> Crofton:
    """Return Crofton weights for any spacing: shares of the sphere nearest to each direction.

    The 26 directions between neighbouring voxels cut the unit sphere into Voronoi cells; a
    direction's weight is its cell's and its opposite's part of the sphere (Ohser & Mücklich 2000).
    The bias is (estimate − area) / area of a plane, smallest, largest and root mean square over
    all planes.
    """
    steps = DIRECTIONS * (np.array(spacing) / max(spacing))
    lengths = np.linalg.norm(steps, axis=1)
    unit = steps / lengths[:, None]
    weights = shares_of_sphere(DIRECTIONS, spacing)
    seen = 2 * np.abs(even_normals() @ unit.T) @ weights - 1
    # The deepest dips lie at normals of planes that hold many of the directions.
    normals = np.cross(unit[:, None], unit[None]).reshape(-1, 3)
    size = np.linalg.norm(normals, axis=1)
    kinks = normals[size > 1e-9] / size[size > 1e-9, None]
    extremes = np.concatenate([seen, 2 * np.abs(kinks @ unit.T) @ weights - 1])
    return Crofton(
        weights,
        lengths * max(spacing),
        float(extremes.min()),
        float(extremes.max()),
        float(np.sqrt((seen**2).mean())),
    )


def shares_of_sphere(steps: NDArray[np.int64], spacing: Spacing) -> Floats:
    """Return the parts of the sphere that are nearest to a step or its opposite, shape (m,).

    Parameters
    ----------
    steps
        Shape (m, 3), in voxels; of each direction and its opposite only one.
    spacing
        Edges of a voxel. Those below ``NEEDLE`` of the longest are taken for that, which moves a
        direction by no more than it.
    """
    from scipy.spatial import SphericalVoronoi

    vectors = steps * np.maximum(np.array(spacing) / max(spacing), NEEDLE)
    unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    areas = SphericalVoronoi(np.concatenate([unit, -unit])).calculate_areas()
    count = len(steps)
    return np.asarray((areas[:count] + areas[count:]) / areas.sum(), np.float64)


def even_normals(count: int = 20_000) -> Floats:
    """Return normals spread evenly over the sphere, by the golden angle, shape (count, 3)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = math.pi * (1 + math.sqrt(5)) * np.arange(count)
    ring = np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


def _crofton_area(crossings: Floats, frame_spacing: Spacing) -> tuple[float, float]:
    """Return the area, and its uncertainty for planes and curved surfaces, from crossings.

    Cauchy and Crofton: the area is twice the mean over all directions of the projected area with
    multiplicity, and along one direction that is crossings × voxel volume / step.
    """
    rule = crofton(frame_spacing)
    projected = crossings * math.prod(frame_spacing) / rule.lengths
    area = 2 * float(rule.weights @ projected)
    mean = float(projected.mean())
    flatness = min(1.0, float(projected.std()) / mean / FLAT) if mean else 0.0
    worst = max(1 / (1 + rule.lowest) - 1, 1 - 1 / (1 + rule.highest))
    return area, area * (rule.spread + flatness * worst)


def _lost(census: Census) -> float:
    """Return what edges may cost: ``LOST`` times what changes at twice the spacing."""
    return _changed(census, census.windows @ CROSSINGS.T, census.coarse_windows @ CROSSINGS.T / 8)


def _changed(census: Census, crossings: Floats, coarse: Floats) -> float:
    fine, spacing = census.frame.spacing, tuple(2 * h for h in census.frame.spacing)
    there = _crofton_area(coarse, spacing)[0]  # type: ignore[arg-type]
    return LOST * abs(_crofton_area(crossings, fine)[0] - there)


def _turned(windows: NDArray[np.int64], axis: int) -> NDArray[np.int64]:
    """Return the numbers of windows that are turned round along an axis."""
    bits = windows[:, None] >> (np.arange(8) ^ 4 >> axis) & 1
    return np.asarray(bits @ (1 << np.arange(8)), np.int64)


def _either_way() -> Floats:
    """Return ``CROSSINGS`` as the mean over windows and those that are turned round.

    A pair that does not vary along an axis lies in both halves of a window, half in each.
    """
    total: Floats = CROSSINGS.astype(np.float64)
    windows, steps = np.arange(256), DIRECTIONS.tolist()
    for axis in range(3):
        turned = DIRECTIONS * np.where(np.arange(3) == axis, -1, 1)
        which = [steps.index(d if d in steps else [-k for k in d]) for d in turned.tolist()]
        total = (total + total[which][:, _turned(windows, axis)]) / 2
    return total


INSIDE = _either_way() / 8
"""Phase changes along each of the 13 directions by windows that go on at the frame, which are
counted eight times: the same whichever way round the body lies."""


def surface_doubt(census: Census, surface: SurfaceMesh | StreamedSurface) -> tuple[float, float]:
    """Return the uncertainties of a surface's volume and area as those of the grid's body.

    The volume's is its difference to that of the fills, and theirs. The area's is what is lost
    about edges, and ``SMOOTH`` of it on solid fractions, ``STEPPED`` on binary grids; that of
    voxel faces (no triangle is oblique) is as in ``surface_area``.
    """
    amounts, voxel = Amounts(census), census.frame.voxel_volume
    volume = abs(surface.volume - amounts.everywhere * voxel) + amounts.everywhere_doubt * voxel
    if isinstance(surface, SurfaceMesh) and surface.is_stepped:
        return volume, STAIRCASE * surface.area
    steps = SMOOTH if amounts.cut else STEPPED
    return volume, steps * surface.area + _lost(census)


def _row(census: Census, name: str, method: str, area: float, doubt: float) -> Measure:
    unit = f"{census.frame.unit}²"
    return Measure(name, area, unit, method, doubt, "standard", "grid")


def face_areas(spacing: Spacing) -> Floats:
    """Return the area of a voxel's face across x, y and z."""
    x, y, z = spacing
    return np.array([y * z, x * z, x * y])


def _area_faces(census: Census) -> Measure:
    counts = [census.number(f"faces_{axis}") for axis in "xyz"]
    area = float(face_areas(census.frame.spacing) @ counts)
    return _row(census, "surface_area", "voxel faces", area, STAIRCASE * area)


def _area_crofton(census: Census) -> Measure:
    area, doubt = _crofton_area(census.windows @ CROSSINGS.T, census.frame.spacing)
    return _row(census, "surface_area", "crofton", area, doubt + _lost(census))


def _interface_faces(census: Census) -> Measure:
    counts = [census.number(f"faces_{axis}") for axis in "xyz"]
    area = float(face_areas(census.frame.spacing) @ (np.array(counts) - census.caps))
    return _row(census, "interface_area", "voxel faces", area, STAIRCASE * area)


def _interface_crofton(census: Census) -> Measure:
    crossings = census.continued_windows @ INSIDE.T
    area, doubt = _crofton_area(crossings, census.frame.spacing)
    lost = _changed(census, crossings, census.coarse_continued_windows @ INSIDE.T / 8)
    return _row(census, "interface_area", "crofton", area, doubt + lost)


def _specific(method: str) -> Callable[[Census], Measure]:
    def row(census: Census) -> Measure:
        area = GRID["surface_area", method](census)
        amounts, voxel = Amounts(census), census.frame.voxel_volume
        bulk = amounts.bulk * voxel
        name, unit = "specific_surface_area", f"1/{census.frame.unit}"
        value = area.value / bulk
        doubt = math.hypot(area.uncertainty, value * amounts.bulk_doubt * voxel) / bulk
        return Measure(name, value, unit, method, doubt, "standard", "grid")

    return row


GRID: Table[Census] = {
    ("surface_area", "crofton"): _area_crofton,
    ("surface_area", "voxel faces"): _area_faces,
    ("interface_area", "crofton"): _interface_crofton,
    ("interface_area", "voxel faces"): _interface_faces,
    ("specific_surface_area", "crofton"): _specific("crofton"),
    ("specific_surface_area", "voxel faces"): _specific("voxel faces"),
}


def surface_area(subject: Tiled | SurfaceMesh, *, method: str | None = None) -> Measure:
    """Return the area of the boundary of the solid, in the subject's unit squared.

    The solid lies in vacuum, so that it ends where the frame does, but along periodic axes it
    goes on.

    Parameters
    ----------
    subject
        A grid, or a closed surface.
    method
        Of a grid ``"crofton"`` (crossings of lines in 13 directions, any spacing; default) or
        ``"voxel faces"``; of a surface ``"triangles"``.

    Returns
    -------
    Measure
        Crofton's uncertainty has three parts: the bias on planes, root mean square over their
        directions (1.6 % on cubic voxels); the largest such bias (7.8 %), in the measure in which
        projected areas differ between directions, as they do for flat faces; and what is lost
        about edges, ``LOST`` times what every other voxel would show less. Voxel faces are between
        1 and √3 of the area.
    """
    if isinstance(subject, SurfaceMesh):
        return answer(SURFACE, "surface_area", method or "triangles", SurfaceCensus(subject))
    return answer(GRID, "surface_area", method or "crofton", Census(subject))


def interface_area(subject: Tiled | SurfaceMesh, *, method: str | None = None) -> Measure:
    """Return the area between solid and void inside the frame: without caps, in unit squared.

    Caps close the solid where the frame cuts it. Of a surface they are the triangles with the
    names of the box's sides (XMIN … ZMAX), of a grid the voxel faces on the border of the frame;
    ``"crofton"`` has the outermost voxels go on beyond the frame, and so do its doubts. Parameters
    as for ``surface_area``.
    """
    if isinstance(subject, SurfaceMesh):
        return answer(SURFACE, "interface_area", method or "triangles", SurfaceCensus(subject))
    return answer(GRID, "interface_area", method or "crofton", Census(subject))


def specific_surface_area(grid: Tiled, *, method: str = "crofton") -> Measure:
    """Return surface area over bulk volume, in 1/unit; methods as for ``surface_area``."""
    return answer(GRID, "specific_surface_area", method, Census(grid))
