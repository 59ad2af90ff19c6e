"""How rough the sides of a body are: heights seen from outside, and what follows from them.

A side is seen as by a profilometer: column by column, along its normal, down to the first solid.
What lies below an overhang is not seen. Heights of a grid are means over columns of one voxel; what
is told of them refers to their mean plane, which is parallel to the side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import takewhile
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import numpy as np

from porous.errors import GridError, nearest
from porous.measures._boxes import line
from porous.measures._porosity import OFFSET, VOXEL
from porous.values import Box, Measure, Measures, SurfaceMesh
from porous.values.box import SIDES
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from porous.models.model import Model
    from porous.values import Frame
    from porous.values.tiled import Tiled

    Floats = NDArray[np.float64]
    Index = tuple[int, int, int]

METHOD, VARIOGRAM, VARIATION = "height map", "variogram", "variation"

LAYERS = 64
"""Layers that are looked at before the next are read."""

DEEPEST = 1 / 8
"""Of a grid of any origin, sides are looked for in the outer part of it so deep."""

PATCH = 1 << 26
"""Voxels that are read at once, about."""

LAGS = (4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
"""Distances that dimensions are fitted over, in columns: shorter ones see what columns average."""

PART = 4
"""The longest distance, as a part of the map's shorter edge."""

ROUGH = 2.5
"""Second differences of heights that have nothing to do with each other have a mean square of
6 Sq²; distances at which it is more than this times Sq² are longer than the largest bumps."""

POINTS = 3
"""Distances that a fit has at least."""

SCATTER = 0.4
"""Standard uncertainty of a variogram's dimension on one column, that falls with the root of how
many lie along the shorter edge: what a fit cannot see of a few bumps (``analysis/09``)."""


@dataclass(frozen=True, eq=False)
class HeightMap(Value):
    """Heights over a rectangular lattice of places.

    Parameters
    ----------
    heights
        float64, shape (n, m), at least 2 × 2, in ``unit``, outwards.
    spacing
        Distances between places along both edges, in ``unit``.
    unit
        Unit of length.
    doubt
        Standard uncertainty of a height, in ``unit``.
    of
        What was seen, grid or surface.

    Raises
    ------
    GridError
        For fewer than 2 × 2 heights, such as are not finite, and spacings that are no lengths.
    """

    heights: NDArray[np.float64] = field(repr=False)
    spacing: tuple[float, float]
    unit: str = "mm"
    doubt: float = 0.0
    of: str = "surface"

    def __post_init__(self) -> None:
        self._set("heights", frozen(self.heights, np.float64))
        if self.heights.ndim != 2 or min(self.heights.shape) < 2:
            raise GridError(f"heights: got shape {self.heights.shape}; wanted 2 × 2 or more")
        if not np.isfinite(self.heights).all():
            raise GridError("heights: got some that are not finite; wanted one at every place")
        if not all(0 < step < math.inf for step in self.spacing):
            raise GridError(f"spacing: got {self.spacing}; wanted two lengths above zero")

    @property
    def residual(self) -> Floats:
        """Heights above their mean plane."""
        return np.asarray(self.heights - self.heights.mean(), np.float64)

    @property
    def coarse(self) -> HeightMap:
        """The map at twice the distances, of means of 2 × 2 heights."""
        n, m = (count // 2 for count in self.heights.shape)
        means = self.heights[: 2 * n, : 2 * m].reshape(n, 2, m, 2).mean(axis=(1, 3))
        a, b = self.spacing
        return HeightMap(means, (2 * a, 2 * b), self.unit, self.doubt, self.of)


class Variogram(NamedTuple):
    """Distances in columns, int64 (n,), and the mean squares of second differences, (n,)."""

    distances: NDArray[np.int64]
    means: NDArray[np.float64]


def height_map(
    subject: Tiled | SurfaceMesh, face: str, *, within: Box | None = None, columns: int = 256
) -> HeightMap:
    """Return the heights of a side of a body, as seen along its normal.

    Parameters
    ----------
    subject
        A grid, which is read from that side inwards until every column has met solid; or a surface,
        which need not be closed.
    face
        XMIN, XMAX, YMIN, YMAX, ZMIN or ZMAX. Heights are above this side of the grid's frame or of
        the surface's box, so most are negative; rows and columns of the map are along the other two
        axes, in their order.
    within
        Columns whose centres lie outside of this box are left out.
    columns
        Of a surface: how many there are along the longer edge.

    Returns
    -------
    HeightMap
        Of a grid a column's height is what it lacks of being filled up to the side, from the first
        voxel that is half solid outwards, and inwards as long as fills rise. Of fills each is
        uncertain by 0.13 of a voxel, of centres or a cover by 0.29. Of a surface it is that of its
        highest point at the column's centre.

    Raises
    ------
    GridError
        For an unknown face; where a column meets nothing, or there are fewer than 2 × 2.
    """
    if face not in SIDES:
        raise GridError(f"face: got {face!r}{nearest(face, SIDES)}")
    if isinstance(subject, SurfaceMesh):
        found = _seen_surface(subject, face, within, columns)
    else:
        found = _seen(subject, face, within, 1.0)
    if found is None:
        raise GridError(
            f"height map: a column seen from {face} meets no solid; wanted a side without holes "
            "through it, or `within` where it has none"
        )
    return found


def _seen_surface(
    surface: SurfaceMesh, face: str, within: Box | None, columns: int
) -> HeightMap | None:
    from porous.kernels.height_map import highest

    (axis, upper), box = divmod(SIDES.index(face), 2), surface.box
    seen = box if within is None else within
    across = [a for a in range(3) if a != axis]
    lengths = [seen.lengths[a] for a in across]
    if not (columns >= 2 and min(lengths) > 0):
        raise GridError(f"height map: got {columns} columns over {lengths}; wanted 2 or more")
    shape = [max(2, round(columns * length / max(lengths))) for length in lengths]
    a, b = (length / count for length, count in zip(lengths, shape, strict=True))
    corners = surface.corners[..., [*across, axis]]
    corners[..., 2] = (
        corners[..., 2] - box.upper[axis] if upper else box.lower[axis] - corners[..., 2]
    )
    first = seen.lower[across[0]] + a / 2, seen.lower[across[1]] + b / 2
    heights = highest(corners, first, (a, b), (shape[0], shape[1]))
    if not np.isfinite(heights).all():
        return None
    return HeightMap(heights, (a, b), surface.unit, of="surface")


def _seen(grid: Tiled, face: str, within: Box | None, deepest: float) -> HeightMap | None:
    """Return the map of a side, or None where a column misses it down to a part of the depth."""
    frame, axis = grid.frame, SIDES.index(face) // 2
    start, stop = _columns(frame, axis, within)
    first, second = (a for a in range(3) if a != axis)
    if min(stop[first] - start[first], stop[second] - start[second]) < 2:
        return None
    rows = max(1, PATCH // (LAYERS * (stop[second] - start[second])))
    depth, parts = math.ceil(frame.shape[axis] * deepest), []
    for row in range(start[first], stop[first], rows):
        begin, end = list(start), list(stop)
        begin[first], end[first] = row, min(row + rows, stop[first])
        missing = _missing(grid, face, (begin, end), depth)
        if missing is None:
            return None
        parts.append(missing)
    step = frame.spacing[axis]
    doubt = step * (VOXEL if grid.sampling == "fill" else OFFSET)
    spacing = frame.spacing[first], frame.spacing[second]
    return HeightMap(-step * np.concatenate(parts), spacing, frame.unit, doubt, "grid")


def _missing(grid: Tiled, face: str, box: tuple[list[int], list[int]], depth: int) -> Floats | None:
    """Return how many voxels the columns of a box lack up to the face, None where one is empty."""
    from porous.kernels.height_map import DONE, seen

    (start, stop), (axis, upper) = box, divmod(SIDES.index(face), 2)
    shape = [b - a for i, (a, b) in enumerate(zip(start, stop, strict=True)) if i != axis]
    missing = np.zeros(shape)
    last, state = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    for first in range(0, depth, LAYERS):
        ends = first, min(first + LAYERS, depth)
        count = grid.frame.shape[axis]
        start[axis], stop[axis] = (count - ends[1], count - ends[0]) if upper else ends
        fill, _ = grid.block(tuple(start), tuple(stop))  # type: ignore[arg-type]
        layers = np.moveaxis(fill, axis, -1)
        seen(layers[..., ::-1] if upper else layers, missing, last, state)
        if (state == DONE).all():
            break
    return missing if state.all() else None


def _columns(frame: Frame, axis: int, within: Box | None) -> tuple[list[int], list[int]]:
    """Return the first voxels and ends of the columns whose centres lie within a box."""
    start, stop = [0, 0, 0], list(frame.shape)
    for a in range(3):
        if within is not None and a != axis:
            centres = frame.centres(a)
            inside = (centres >= within.lower[a]) & (centres <= within.upper[a])
            found = np.flatnonzero(inside)
            start[a], stop[a] = (int(found[0]), int(found[-1]) + 1) if len(found) else (0, 0)
    return start, stop


def roughness(heights: HeightMap, face: str) -> Measures:
    """Return areal roughness (ISO 25178-2) and dimension of a map of heights.

    Sa is the mean of |z| over the map, Sq the root of the mean of z², Sz the height of the highest
    peak above the deepest pit, Sdr how much more area the surface has than its plane, by triangles
    through neighbouring heights. None of them is filtered: they are of wavelengths from twice the
    lattice to the whole map. Their uncertainties are that of the heights, and the difference to the
    map at twice the distance; Sdr of a fractal surface rises without bound on finer lattices.

    The dimension is 3 − s/2 of the slope s of the variogram of second differences along both
    edges, log mean (z(x+d) − 2 z(x) + z(x−d))² over log d (J. Istas & G. Lang 1997; T. Gneiting,
    H. Ševčíková & D. B. Percival 2012): these do not see what is tilted, which biases first
    differences of surfaces of dimension near 2 by more than 0.1. The variation is the box-counting
    dimension, 3 − s of the slope s of log (mean range of heights in windows of width d) over log d
    (B. Dubuc, C. Roques-Carmes, C. Tricot & S. W. Zucker 1989); it does see tilts, and on maps of
    some hundred columns is too high by about 0.12 near 2.1 and 0.06 near 2.2. Both are fitted over
    d from 4 columns to a quarter of the shorter edge, and no further than second differences stay
    below 2.5 Sq², as they do within the largest bumps. The variogram's uncertainty is that of the
    fit and 0.4/√n for n columns along the shorter edge, twice of which held all errors of skins of
    two bumps of each four outwards; where all point outwards, one bump per edge, it is too high by
    about 0.1.

    Parameters
    ----------
    heights
        The map.
    face
        What is seen, by which the measures are named: sq_zmax, …

    Returns
    -------
    Measures
        Of what was seen; no dimension where there are fewer than three distances.
    """
    side = face.lower()
    if face not in SIDES:
        raise GridError(f"face: got {face!r}{nearest(face, SIDES)}")
    rows = [*_areal(heights, side), *_dimensions(heights, side)]
    return Measures(tuple(rows))


def _areal(heights: HeightMap, side: str) -> Iterator[Measure]:
    fine = _parameters(heights)
    coarse = _parameters(heights.coarse) if min(heights.heights.shape) >= 4 else fine
    noise = math.sqrt(fine["sq"] ** 2 + heights.doubt**2) - fine["sq"]
    noises = {"sa": noise, "sq": noise, "sz": math.sqrt(2) * heights.doubt, "sdr": 0.0}
    for name, value in fine.items():
        doubt = math.hypot(noises[name], value - coarse[name])
        unit = "1" if name == "sdr" else heights.unit
        yield Measure(f"{name}_{side}", value, unit, METHOD, doubt, "standard", heights.of)


def _parameters(heights: HeightMap) -> dict[str, float]:
    z = heights.residual
    return {
        "sa": float(np.abs(z).mean()),
        "sq": math.sqrt(float((z**2).mean())),
        "sz": float(np.ptp(z)),
        "sdr": _developed(z, heights.spacing),
    }


def _developed(z: Floats, spacing: tuple[float, float]) -> float:
    """Return the area of two triangles per square of places, of both ways to cut it, less one."""
    a, b = spacing
    south, north = np.diff(z[:, :-1], axis=0) / a, np.diff(z[:, 1:], axis=0) / a
    west, east = np.diff(z[:-1], axis=1) / b, np.diff(z[1:], axis=1) / b
    pairs = ((south, west), (south, east), (north, west), (north, east))
    return float(np.mean([np.sqrt(1 + p**2 + q**2).mean() for p, q in pairs])) - 1


def variogram(heights: HeightMap) -> Variogram:
    """Return the variogram of second differences that a map's dimension is fitted to.

    Its means are geometric ones over both edges, in the map's unit squared: a lattice of unequal
    distances multiplies all of one edge alike, which changes no slope. Distances are as told of
    ``roughness``; of a map that is small or flat there are none.
    """
    z = heights.residual
    square, longest = float((z**2).mean()), min(z.shape) // PART
    rows = ((lag, _second(z, lag)) for lag in LAGS if lag <= longest)
    # Beyond the largest bumps they may fall again: a lattice of bumps is periodic.
    told = list(takewhile(lambda row: 0 < row[1] <= ROUGH * square, rows))
    return Variogram(
        np.array([lag for lag, _ in told], np.int64), np.array([mean for _, mean in told])
    )


def _dimensions(heights: HeightMap, side: str) -> Iterator[Measure]:
    found = variogram(heights)
    if len(found.distances) < POINTS:
        return
    lags = np.log(found.distances).tolist()
    slope, doubt = line(lags, np.log(found.means).tolist())
    name, kind = f"dimension_{side}", "standard"
    scatter = SCATTER / math.sqrt(min(heights.heights.shape))
    doubt = math.hypot(doubt / 2, scatter)
    yield Measure(name, 3 - slope / 2, "1", VARIOGRAM, doubt, kind, heights.of)
    ranges = [math.log(_range(heights.residual, lag)) for lag in found.distances.tolist()]
    slope, doubt = line(lags, ranges)
    yield Measure(name, 3 - slope, "1", VARIATION, doubt, kind, heights.of)


def _second(z: Floats, lag: int) -> float:
    means = [
        float(((w[2 * lag :] - 2 * w[lag:-lag] + w[: -2 * lag]) ** 2).mean()) for w in (z, z.T)
    ]
    return math.sqrt(means[0] * means[1])


def _range(z: Floats, lag: int) -> float:
    """Return the mean range of heights within windows of ``lag`` + 1 places along each edge."""
    from scipy.ndimage import maximum_filter, minimum_filter

    size = lag + 1
    high, low = (part(z, size, mode="nearest") for part in (maximum_filter, minimum_filter))
    return float((high - low).mean())


@runtime_checkable
class _HasRoughFaces(Protocol):
    @property
    def rough_faces(self) -> Mapping[str, Box]: ...


def roughness_of_skins(grid: Tiled, model: Model | None) -> Iterator[Measure]:
    """Yield the roughness of the sides of a grid that its model says are rough."""
    if not isinstance(model, _HasRoughFaces) or any(grid.frame.periodic):
        return
    for face, within in model.rough_faces.items():
        found = _seen(grid, face, within, 1.0)
        if found is not None:
            yield from roughness(found, face)


def roughness_of_sides(grid: Tiled) -> Measures:
    """Return the roughness of the sides of a grid that look like skins, whatever it is of.

    That is of all that no column misses in the outer eighth of the grid, but for flat ones and
    those of a grid that goes on in copies of itself. Columns in the outer eighth of another side
    are left out, for its own pits and bumps are there. The grid is read anew for each side.
    """
    if any(grid.frame.periodic):
        return Measures()
    box, margin = grid.frame.box, DEEPEST * np.array(grid.frame.box.lengths)
    middle = Box(tuple(box.lower + margin), tuple(box.upper - margin))
    seen = {face: _seen(grid, face, middle, DEEPEST) for face in SIDES}
    skins = {face: found for face, found in seen.items() if found and np.ptp(found.heights) > 0}
    rows = (roughness(found, face) for face, found in skins.items())
    return sum(rows, start=Measures())
