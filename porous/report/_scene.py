"""What a page shows of a result in three dimensions: numbers small enough to go with it."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from itertools import product
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from porous.errors import MemoryLimitError
from porous.report import _packed
from porous.report._colours import colours
from porous.report._greys import FINEST, packed_greys, pooled
from porous.report._mesh_data import STEPS, boundary_of, shown, split
from porous.report._page import embedded
from porous.scale.costs import SURFACE_VOXELS
from porous.stages import extract_surface, voxelize
from porous.values import SurfaceMesh, VoxelGrid
from porous.values.value import Value, adopted

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from jinja2 import Template
    from numpy.typing import NDArray

    from porous.measures import LocalThickness
    from porous.pipeline import Result
    from porous.values import Box, Frame

    Floats = NDArray[np.float64]

NOTHING = "There is no view to turn: neither solid voxels nor a mesh were made."
"""What is said where there is no scene."""

MEDIUM = 256
"""Voxels along an edge of a grid whose surface is shown where memory does not hold that of all."""

EDGE = 2.0
"""Voxels between corners at most, if there is room, where these have colours."""

NEAR = (1, 2)
"""So many voxels away a corner's own voxel is sought; further where it is not there.

Corners lie on the surface, or little away from it."""

FARTHEST = 5
"""Voxels along any axis; few grids have edges that differ so much."""

TIE = 1e-9
"""Squares of distances that differ by less, as a part, are the same."""


FILES = {"reading": "viewer_data.js", "script": "viewer.js", "shaders": "viewer.glsl"}


class Name(NamedTuple):
    """What a phase's local thickness is called, and what is too thin."""

    thing: str
    thin: str


NAMES = MappingProxyType(
    {
        "solid": Name("wall thickness", "walls thinner"),
        "pore": Name("pore diameter", "gaps narrower"),
    }
)


@dataclass(frozen=True, eq=False)
class Scene(Value):
    """A body as a page shows it.

    Parameters
    ----------
    box
        Of the body: its frame's, where it has one.
    places, low, high
        uint16, shape (n, 3): the corners, in steps of 1/65535 of the box from ``low`` to ``high``.
    triangles, walls
        uint32, shape (t, 3), seen from outside; so many of them are walls, the rest lies in sides
        where the frame cuts the solid.
    full
        How many triangles the whole surface has.
    error
        No corner is farther than this from the whole surface, in ``unit``: measured, and half a
        step's diagonal added. Where all triangles are shown it bounds the distance everywhere.
    missed
        The share of the whole surface, by its corners, that lies further from what is shown.
    unit
        Of lengths.
    values, ranges
        uint16, shape (n,), by phase: the wall's thickness and the pore's diameter at each corner,
        in steps of 1/65534 of the range, counted from 1; 0 where it is not known.
    limits
        By phase: the least that a machine makes.
    greys
        The body in voxels, at most 128 along an edge; None where there are no voxels.
    remark
        What else is to be said of what is shown.
    """

    box: Box
    places: NDArray[np.uint16] = field(repr=False)
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    triangles: NDArray[np.uint32] = field(repr=False)
    walls: int
    full: int
    error: float
    missed: float
    unit: str
    values: Mapping[str, NDArray[np.uint16]] = field(default_factory=dict, repr=False)
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    limits: Mapping[str, float] = field(default_factory=dict)
    greys: VoxelGrid | None = field(default=None, repr=False)
    remark: str = ""

    def __post_init__(self) -> None:
        for name in ("values", "ranges", "limits"):
            self._set(name, MappingProxyType(dict(getattr(self, name))))

    @property
    def points(self) -> Floats:
        """The corners in ``unit``, shape (n, 3), as they are shown."""
        low, high = np.array(self.low), np.array(self.high)
        return np.asarray(low + self.places * ((high - low) / STEPS))

    @property
    def surface(self) -> SurfaceMesh:
        """The triangles as they are shown, those in sides told from walls."""
        sides = (np.arange(len(self.triangles)) >= self.walls).astype(np.int16)
        return SurfaceMesh(
            self.points, self.triangles.astype(np.int64), self.unit, sides, ("WALL", "SIDE")
        )

    @property
    def caption(self) -> str:
        """How much of the surface is shown, and how well."""
        count, full = len(self.triangles), self.full
        within = f"within {_plain(self.error)} {self.unit}"
        if count >= full:
            finer = f", as {_grouped(count)} for their colours" if count > full else ""
            return f"Shown: all {_grouped(full)} triangles{finer}, {within}{self.remark}."
        rest = _rest(self.missed)
        return (
            f"Shown: {_grouped(count)} of {_grouped(full)} triangles, {within}{rest}{self.remark}."
        )


def scene(result: Result) -> Scene | None:
    """Return what a page shows of a result; None where there is nothing, as ``NOTHING`` says.

    That is its surface; where there is none in memory, that of its voxels, thinned or sampled anew
    where they do not lie there either; where there are none, the boundary of its volume mesh.
    """
    grid, remark = _voxels(result)
    surface = _surface(result, grid)
    if surface is None or not len(surface.triangles):
        return None
    if surface is result.surface:
        remark = ""
    part = shown(surface)
    if result.maps:
        part = split(part, EDGE * min(min(local.frame.spacing) for local in result.maps.values()))
    places, low, high = _quantised(part.points)
    order = _packed.curve(places)
    where = np.empty(len(order), np.int64)
    where[order] = np.arange(len(order))
    places, points = places[order], part.points[order]
    values, ranges = _thickness(result, points)
    return Scene(
        box=surface.box if grid is None else grid.frame.box,
        places=adopted(places),
        low=low,
        high=high,
        triangles=adopted(_packed.in_order(where[part.triangles], part.walls).astype(np.uint32)),
        walls=part.walls,
        full=part.full,
        error=part.away + _half_step(low, high),
        missed=part.missed,
        unit=surface.unit,
        values=values,
        ranges=ranges,
        limits=_limits(result),
        greys=None if grid is None else pooled(grid),
        remark=remark,
    )


def _voxels(result: Result) -> tuple[VoxelGrid | None, str]:
    """Return a grid in memory, and what to say of a surface of it."""
    grid = result.grid
    if grid is None or (isinstance(grid, VoxelGrid) and grid.frame.size <= SURFACE_VOXELS):
        return grid, ""
    if isinstance(grid, VoxelGrid) or result.model is None:
        coarse = pooled(grid, MEDIUM) if isinstance(grid, VoxelGrid) else pooled(grid)
        if isinstance(grid, VoxelGrid) and not coarse.solid.any():  # walls thinner than its voxels
            return grid, ""
        return coarse, f", of voxels of {coarse.frame.spacing[0]:.3g} {coarse.frame.unit}"
    count = min(FINEST, max(grid.frame.shape))
    coarse = voxelize(result.model, voxels=count, sampling=grid.sampling)
    return coarse, f", of the body sampled anew with {count} voxels along its longest edge"


def _surface(result: Result, grid: VoxelGrid | None) -> SurfaceMesh | None:
    if isinstance(result.surface, SurfaceMesh):
        return result.surface
    if grid is not None and int(grid.fill.max()) >= 128:
        try:
            return extract_surface(grid)
        except MemoryLimitError:
            return extract_surface(pooled(grid, MEDIUM))
    return None if result.volume is None else boundary_of(result.volume)


def _quantised(
    points: Floats,
) -> tuple[NDArray[np.uint16], tuple[float, float, float], tuple[float, float, float]]:
    """Return points in steps of their own box, and that."""
    low, high = points.min(axis=0), points.max(axis=0)
    extent = np.where(high > low, high - low, 1.0)
    places = np.rint((points - low) * (STEPS / extent)).astype(np.uint16)
    return places, tuple(low.tolist()), tuple(high.tolist())


def _half_step(low: tuple[float, float, float], high: tuple[float, float, float]) -> float:
    return math.dist(low, high) / STEPS / 2


def _limits(result: Result) -> dict[str, float]:
    given = None if result.recipe is None else result.recipe.report
    if given is None:
        return {}
    limits = {"solid": given.smallest_wall, "pore": given.smallest_gap}
    return {phase: limit for phase, limit in limits.items() if limit is not None}


def _thickness(
    result: Result, points: Floats
) -> tuple[dict[str, NDArray[np.uint16]], dict[str, tuple[float, float]]]:
    """Return local thicknesses at points in steps of their range, by phase, and the ranges."""
    values, ranges = {}, {}
    for phase, local in sorted(result.maps.items()):
        sizes = diameters_at(local, points)
        known = sizes > 0
        if known.any():
            least, most = float(sizes[known].min()), float(sizes[known].max())
            share = (sizes - least) / (most - least or 1.0)
            values[phase] = adopted(
                np.where(known, 1 + np.rint(share * (STEPS - 1)), 0).astype(np.uint16)
            )
            ranges[phase] = (least, most)
    return values, ranges


def diameters_at(local: LocalThickness, points: Floats) -> Floats:
    """Return the diameter in the voxel of the phase that is nearest to each point; 0 where none is.

    Points, shape (n, 3), are on its surface, or near it. Of voxels as near the widest tells.
    """
    frame = local.frame
    place = (points - frame.origin) / frame.spacing - frame.start
    sizes = np.zeros(len(points))
    for reach in NEAR:
        left = np.flatnonzero(sizes == 0)
        if len(left):
            sizes[left] = _nearest(local, place[left], reach)
    return sizes


def _nearest(local: LocalThickness, place: Floats, reach: int) -> Floats:
    """Return the diameter in the nearest voxel of the phase, of those ``reach`` away at most.

    That is counted in the longest edges of voxels.
    """
    spacing = local.frame.spacing
    reaches = [min(math.ceil(reach * max(spacing) / h - 1e-9), FARTHEST) for h in spacing]
    axes = [dict(_steps(local.frame, place, axis, n)) for axis, n in enumerate(reaches)]
    best, sizes = np.full(len(place), math.inf), np.zeros(len(place))
    for offset in product(*axes):
        along = [steps[step] for steps, step in zip(axes, offset, strict=True)]
        square = along[0][1] + along[1][1] + along[2][1]
        size = local.diameters[along[0][0], along[1][0], along[2][0]]
        as_near = (square <= best * (1 + TIE)) & (size > sizes)
        better = (size > 0) & np.isfinite(square) & (as_near | (square < best * (1 - TIE)))
        best[better], sizes[better] = square[better], size[better]
    return sizes


def _steps(
    frame: Frame, place: Floats, axis: int, reach: int
) -> Iterator[tuple[int, tuple[NDArray[np.int64], Floats]]]:
    """Yield steps along an axis, the voxels there and the squares of their distances from places.

    They are infinite beyond the frame, but where it goes on in copies of itself.
    """
    count, own = frame.shape[axis], np.floor(place[:, axis]).astype(np.int64)
    for step in range(-reach, reach + 1):
        voxel = own + step
        square = ((voxel + 0.5 - place[:, axis]) * frame.spacing[axis]) ** 2
        if frame.periodic[axis]:
            yield step, (voxel % count, square)
        else:
            inside = (voxel >= 0) & (voxel < count)
            yield step, (np.clip(voxel, 0, count - 1), np.where(inside, square, math.inf))


def scene_html(scene: Scene) -> str:
    """Return a view that can be turned, as a piece of a page: markup, data and scripts.

    The page's policy has to let these run, and inline styles. They set ``data-view`` of the page's
    root to ``ready`` when the view is drawn, and then ``figure.picture`` is for paper only; and to
    ``failed`` where a browser cannot, with a message in place of the view.
    """
    return _template().render(
        scene=scene,
        told=_told(scene),
        lengths=[(a, f"{length:.3g}") for a, length in zip("xyz", scene.box.lengths, strict=True)],
        bars=list(_bars(scene)),
        limited=any(phase in scene.limits for phase in scene.values),
        gradient=", ".join(f"rgb({r}, {g}, {b})" for r, g, b in colours().tolist()),
        data=embedded(_data(scene)),
        **{name: Markup(_text(file)) for name, file in FILES.items()},  # noqa: S704  (our own)
    )


@cache
def _template() -> Template:
    made = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return made.from_string(_text("viewer.html"))


def _text(name: str) -> str:
    return resources.files("porous.report").joinpath(name).read_text(encoding="utf-8")


def _told(scene: Scene) -> str:
    """Return what one who cannot see the view is told of it."""
    lengths = " × ".join(f"{length:.3g}" for length in scene.box.lengths)
    shown = " and ".join(NAMES[phase].thing for phase in scene.values)
    colour = f"; colours show {shown}" if shown else ""
    return (
        f"A body of {lengths} {scene.unit}, {_grouped(len(scene.triangles))} triangles{colour}. "
        "Arrow keys turn it, plus and minus zoom, 0 resets, Shift with arrow keys moves it."
    )


def _bars(scene: Scene) -> Iterator[dict[str, Any]]:
    for phase, (low, high) in scene.ranges.items():
        name = NAMES[phase]
        thin = f"{name.thin} than {scene.limits.get(phase, 0):.3g} {scene.unit}"
        ticks = [f"{value:.3g}" for value in (low, (low + high) / 2, high)]
        yield {"phase": phase, "name": name.thing, "ticks": ticks, "thin": thin}


def _data(scene: Scene) -> dict[str, Any]:
    """Return all that the script needs to know."""
    data: dict[str, Any] = {
        "unit": scene.unit,
        "box": [scene.box.lower, scene.box.upper],
        "corners": {
            "count": len(scene.places),
            "box": [scene.low, scene.high],
            "bytes": _packed.text(_packed.of_corners(scene.places)),
        },
        "triangles": {
            "count": len(scene.triangles),
            "walls": scene.walls,
            "bytes": _packed.text(_packed.of_triangles(scene.triangles)),
        },
        "values": {
            phase: {
                "range": scene.ranges[phase],
                "limit": scene.limits.get(phase),
                "bytes": _packed.text(_packed.of_values(values)),
            }
            for phase, values in scene.values.items()
        },
        "colours": colours().tolist(),
    }
    if scene.greys is not None:
        deflated, step = packed_greys(scene.greys.fill)
        data["greys"] = {
            "shape": scene.greys.frame.shape,
            "box": [scene.greys.frame.box.lower, scene.greys.frame.box.upper],
            "step": step,
            "bytes": base64.b64encode(deflated).decode(),
        }
    return data


def _plain(length: float) -> str:
    """Return a small length rounded up to two figures, without an exponent where it is readable."""
    digits = 1 - math.floor(math.log10(length)) if length > 0 else 0
    up = math.ceil(length * 10.0**digits) / 10.0**digits
    return f"{up:.{max(digits, 0)}f}" if digits < 9 else f"{up:.1e}"


def _grouped(count: int) -> str:
    return f"{count:,}".replace(",", "\u202f")


def _rest(missed: float) -> str:
    """Say how much of a surface is missing from what is shown of it."""
    if missed == 0:
        return ""
    share = f"{100 * missed:.2g}" if missed >= 1e-4 else "less than 0.01"
    return f"; {share} % of the surface, small details, lies further from what is shown"
