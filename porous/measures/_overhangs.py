"""Overhangs: how much of a surface looks down too steeply to be printed, for six directions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import GridError
from porous.measures._build import DIRECTIONS, Direction, angle_of, check_room, directions_of
from porous.measures._phase import BEYOND
from porous.measures._sample import Sample, Survey
from porous.values import Measure, Measures, SurfaceMesh

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.measures._sample import Progress
    from porous.values import VoxelGrid

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

METHOD = "voxel normals"

EACH = 8.0
"""Bytes per voxel that smoothed fills take."""

WIDTH = 1.5
"""Standard deviation, in voxels, of the Gaussian that fills are smoothed with."""

REACH = 6
"""How many voxels to either side it is taken over."""

OFF = {True: 0.5, False: 5.0}
"""Degrees that a normal is off: root mean square over the worst plane there was, by whether the
grid has solid shares between void and solid. Over planes of all directions it is 0.2 and 2."""

LOST = 2.0
"""What the plate and edges may cost, as a multiple of what half the resolution changes: an error in
proportion to their size has 1, and it depends on how the body lies among the voxels."""

SIDES = 6
"""Of area that comes to light or goes with the resolution one part in so many may look down: it is
that of walls and holes of few voxels, and what is left of one says nothing of where another looks.
"""

TIE = 1e-6
"""What a cosine has to be above the limit's by: faces that are just at it are not below."""

ROUNDING = 1e-9
"""What corners may be off by rounding, relative to the body, and angles, in degrees."""


class Inclined(NamedTuple):
    """Areas by the angle between a face that looks down and the plate.

    ``angles`` are the bounds of classes in degrees, ascending from 0 to 90, shape (n,); ``areas``
    have a row for each of ``DIRECTIONS``, shape (6, n − 1), and leave out what is on the plate;
    ``total`` is the area of the whole surface.
    """

    angles: Floats
    areas: Floats
    total: float

    def below(self, direction: Direction, angle: float) -> float:
        """Return the area at less than an angle to the plate, which is one of the bounds."""
        classes = int(np.searchsorted(self.angles, angle - ROUNDING))
        return float(self.areas[DIRECTIONS.index(direction), :classes].sum())


def overhangs(
    subject: VoxelGrid | SurfaceMesh,
    *,
    overhang: float = 45.0,
    beyond: str = "void",
    progress: Progress | None = None,
) -> Measures:
    """Return how much of a surface hangs over, for each of six directions to build a body in.

    A face hangs over where it looks down at less than a given angle to the build plate, and is not
    on the plate itself: where the lowest layer of voxels is, or the lowest plane of a surface.

    Voxels only know 0° and 90°. So each face between solid and void is weighed by how much it
    shows of the smooth surface there, |n_a| of its area (J.-O. Lachaud, B. Thibert, J. Math.
    Imaging Vis. 54, 2016), n the gradient of fills smoothed with a Gaussian of 1.5 voxels. On
    planes n is off by 0.2° on solid shares and by 2° on binary voxels (root mean square over
    directions; 0.5° and 5° of the worst ones); edges are rounded over two voxels.

    Parameters
    ----------
    subject
        A grid, of any spacing; or a closed surface, whose triangles are taken as they are.
    overhang
        Angle to the plate, in degrees, below which a face needs support.
    beyond
        What lies beyond sides of a grid that are not periodic: ``"void"``, so that these are
        faces of the body; or ``"unknown"`` of what was cut out of a larger one, where fills are
        taken to go on as they are at the side, so that normals are bent within two voxels of it.
    progress
        Called as ``progress("overhangs", done)``; raising in it cancels.

    Returns
    -------
    Measures
        overhang_area_x_up, …, overhang_area_z_down, in ``unit`` squared, and
        overhang_share_x_up, …, part of the whole surface's area. None along periodic axes, nor
        where there is no surface. The uncertainty is twice the difference to half the resolution,
        a sixth of what the whole area differs by, and what normals may be off about the angle.

    Raises
    ------
    GridError
        For an angle that is not between 0 and 90°, or an unknown ``beyond``.
    MemoryLimitError
        Where there is too little memory.
    """
    angle = angle_of(overhang)
    if isinstance(subject, SurfaceMesh):
        return surface_overhangs(subject, angle, "triangles", "surface")
    if beyond not in BEYOND:
        raise GridError(f"beyond: got {beyond!r}; wanted one of {', '.join(BEYOND)}")
    how = Survey(beyond=beyond, overhang=angle)
    return grid_overhangs(Sample(subject, how=how, progress=progress))[0]


def grid_overhangs(sample: Sample) -> tuple[Measures, Inclined]:
    """Return the rows of a grid, and areas by angle."""
    fine = _inclined(sample)
    coarse = None if sample.coarse is None else _inclined(sample.coarse)
    return Measures(tuple(_rows(sample, fine, coarse))), fine


def _rows(sample: Sample, fine: Inclined, coarse: Inclined | None) -> Iterator[Measure]:
    angle, unit = sample.how.overhang, sample.frame.unit
    if not fine.total:
        return
    around = _around(sample, angle)
    for direction in directions_of(sample.frame):
        area = fine.below(direction, angle)
        steps = [abs(fine.below(direction, a) - area) for a in around]
        doubt, share = math.inf, math.inf
        if coarse is not None and coarse.total:
            there, lost = coarse.below(direction, angle), (fine.total - coarse.total) / SIDES
            doubt = math.hypot(LOST * (area - there), lost, max(steps))
            part = area / fine.total - there / coarse.total
            share = math.hypot(LOST * part, lost / fine.total, max(steps) / fine.total)
        name = direction.name
        yield Measure(f"overhang_area_{name}", area, f"{unit}²", METHOD, doubt, "standard", "grid")
        yield Measure(
            f"overhang_share_{name}", area / fine.total, "1", METHOD, share, "standard", "grid"
        )


def _around(sample: Sample, angle: float) -> tuple[float, float]:
    fill = sample.grid.fill
    off = OFF[bool(((fill > 0) & (fill < 255)).any())]
    return max(0.0, angle - off), min(90.0, angle + off)


def _inclined(sample: Sample) -> Inclined:
    from porous.kernels.normals import inclinations

    angle = sample.how.overhang
    angles: Floats = np.union1d(np.arange(91.0), [angle, *_around(sample, angle)])
    solid = sample.grid.solid
    if not solid.any():
        return Inclined(angles, np.zeros((6, len(angles) - 1)), 0.0)
    smooth, mask, within = _smoothed(sample)
    cosines = np.cos(np.radians(angles[::-1])) + TIE
    cosines[[0, -1]] = 0.0, 2.0
    found = inclinations(
        smooth,
        mask,
        sample.frame.spacing,
        cosines,
        _ends(mask, within),
        within,
        progress=lambda done, count: sample.tell("overhangs", 0.5 + 0.5 * done / count),
    )[..., ::-1]
    areas = []
    for direction in DIRECTIONS:
        everywhere, first, last = found[:, direction.axis, int(not direction.up)]
        areas.append(everywhere - (first if direction.up else last))
    return Inclined(angles, np.array(areas), float(found[0, 0].sum()))


def _smoothed(sample: Sample) -> tuple[NDArray[np.float32], NDArray[np.bool_], Ints]:
    """Return smoothed fills and the solid voxels with margins, and which voxels have faces.

    Beside sides without period lie margins of void, so that sides are faces of the body; or of the
    sides' own voxels where nobody knows what lies beyond them, and there nothing counts.
    """
    from porous.kernels.normals import MARGIN, filtered

    check_room(sample.frame, EACH, "overhangs")
    periodic, shape = sample.frame.periodic, sample.frame.shape
    around = [(0, 0) if wraps else (MARGIN, MARGIN) for wraps in periodic]
    known = sample.how.beyond == "void"
    fill = np.pad(sample.grid.fill, around, mode="constant" if known else "edge")
    smooth: NDArray[np.float32] = fill.astype(np.float32)
    bell = np.exp(-0.5 / WIDTH**2 * np.arange(-REACH, REACH + 1) ** 2)
    weights = (bell / bell.sum())[REACH:]
    for axis, wraps in enumerate(periodic):
        sample.tell("overhangs", axis / 6)
        n = smooth.shape[axis]
        places = np.arange(-REACH, n + REACH)
        if wraps:
            places %= n
        else:
            inside = np.clip(places, 0, n - 1)
            places = np.where(places == inside, places, -1) if known else inside
        smooth = filtered(smooth, weights, axis, places)
    within: Ints = np.array(
        [
            (0, n + 2 * a - 1) if known or not a else (a, a + n - 1)
            for n, (a, _) in zip(shape, around, strict=True)
        ]
    )
    return smooth, fill >= 128, within


def _ends(mask: NDArray[np.bool_], within: Ints) -> Ints:
    """Return the first and last layer along each axis that have a solid voxel within a box."""
    box = mask[tuple(slice(a, b + 1) for a, b in within)]
    ends: Ints = np.zeros((3, 2), np.int64)
    for axis in range(3):
        others = tuple(a for a in range(3) if a != axis)
        ends[axis] = within[axis, 0] + np.flatnonzero(box.any(axis=others))[[0, -1]]
    return ends


def surface_overhangs(surface: SurfaceMesh, angle: float, method: str, of: str) -> Measures:
    """Return the rows of a closed surface: of its triangles' own normals, so exactly its own."""
    found, unit = surface_inclined(surface, angle), f"{surface.unit}²"
    if not found.total:
        return Measures()
    rows = []
    for direction in DIRECTIONS:
        area, name = found.below(direction, angle), direction.name
        part = area / found.total
        rows += [
            Measure(f"overhang_area_{name}", area, unit, method, 0.0, "exact", of),
            Measure(f"overhang_share_{name}", part, "1", method, 0.0, "exact", of),
        ]
    return Measures(tuple(rows))


def surface_inclined(surface: SurfaceMesh, angle: float) -> Inclined:
    """Return areas by angle of a closed surface's triangles; the angle is one of the bounds."""
    angles: Floats = np.union1d(np.arange(91.0), [angle])
    vectors = surface.area_vectors
    sizes = np.linalg.norm(vectors, axis=1)
    corners, slack = surface.corners, ROUNDING * max(surface.box.lengths)
    cosines = np.cos(np.radians(angles[::-1])) + ROUNDING
    areas = []
    for direction in DIRECTIONS:
        sign = 1.0 if direction.up else -1.0
        heights = sign * corners[:, :, direction.axis]
        hangs = (sizes > 0) & ~(heights <= heights.min() + slack).all(axis=1)
        down = -sign * vectors[hangs, direction.axis] / sizes[hangs]
        areas.append(np.histogram(down, cosines, weights=sizes[hangs])[0][::-1])
    return Inclined(angles, np.array(areas), float(sizes.sum()))
