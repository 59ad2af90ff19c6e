"""How long lines run between phases, direction by direction, and the fabric that this tells."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import GridError
from porous.measures._surface_area import FLAT, even_normals, shares_of_sphere
from porous.memory import check_memory
from porous.values import Measure, Measures
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from porous.values.tiled import Tiled

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]
    Spacing = tuple[float, float, float]

METHOD = "lattice lines"

BYTES = 4.0
"""Memory per voxel."""

FURTHEST = 2
"""Voxels along each axis between neighbours on the lines: 49 directions."""

TIMES = (1, 2, 3)
"""Voxels of a line are compared with the next, the next but one, and the third."""

CLEAR = 0.5
"""Main directions are told where they are clear to so many radians."""

PARTED = 2.5
"""The square of how much noise off its diagonal parts eigenvalues that are all the same, by what
noise on it does: then both are as much as random matrices have, root mean square."""

ROUNDING = 1e-12
"""Eigenvalues of a fabric below this part of the largest are none."""

LEAST = 8
"""Voxels that the shortest edge of a grid has at least."""


@dataclass(frozen=True, eq=False)
class Intercepts(Value):
    """How often lines of many directions change from one phase to the other.

    Parameters
    ----------
    unit
        Of length.
    directions
        float64, shape (m, 3): unit vectors, of each direction and its opposite only one.
    weights
        float64, shape (m,): the part of the sphere that is nearest to each; they add up to 1.
    crossings
        float64, shape (m,): phase changes per length of line, in 1/unit.
    doubts
        float64, shape (m,): standard uncertainty of these.
    bias
        How much less or more the mean over directions may see of a body with flat faces than there
        is, as a part of it.
    """

    unit: str
    directions: Floats = field(repr=False)
    weights: Floats = field(repr=False)
    crossings: Floats = field(repr=False)
    doubts: Floats = field(repr=False)
    bias: float = 0.0

    def __post_init__(self) -> None:
        for name in ("directions", "weights", "crossings", "doubts"):
            self._set(name, frozen(getattr(self, name), np.float64))
        shapes = {self.weights.shape, self.crossings.shape, self.doubts.shape}
        if shapes != {(len(self.directions),)} or self.directions.shape[1:] != (3,):
            raise GridError(
                f"intercepts: got {self.directions.shape} directions and arrays of {shapes}; "
                "wanted (m, 3) and (m,) of each"
            )

    @property
    def mean(self) -> tuple[float, float]:
        """Phase changes per length over all directions, and their uncertainty, in 1/unit.

        They are half of the area between the phases by volume (Cauchy and Crofton).
        """
        mean = float(self.weights @ self.crossings)
        return mean, float(self.weights @ self.doubts) + self.bias * mean


class Rays(NamedTuple):
    """Steps between voxels, (m, 3), their unit vectors, lengths and parts of the sphere.

    ``spread`` and ``worst`` are how far off their mean is of planes, root mean square and at most.
    """

    steps: Ints
    directions: Floats
    lengths: Floats
    weights: Floats
    spread: float
    worst: float


@lru_cache(maxsize=32)
def rays(spacing: Spacing) -> Rays:
    """Return the directions to voxels up to ``FURTHEST`` away along each axis, one of each line.

    Weights are the parts of the unit sphere that are nearest to a direction or its opposite, as
    ``crofton`` has them of its 13.
    """
    around = product(range(-FURTHEST, FURTHEST + 1), repeat=3)
    steps = np.array([s for s in around if s > (0, 0, 0) and math.gcd(*s) == 1], np.int64)
    vectors = steps * np.array(spacing)
    lengths = np.linalg.norm(vectors, axis=1)
    unit = vectors / lengths[:, None]
    weights = shares_of_sphere(steps, spacing)
    off = 2 * np.abs(even_normals() @ unit.T) @ weights - 1
    spread, worst = float(np.sqrt((off**2).mean())), float(np.abs(off).max())
    return Rays(steps, unit, lengths, weights, spread, worst)


def intercepts(grid: Tiled, *, progress: Callable[[int, int], None] | None = None) -> Intercepts:
    """Return how often lines in 49 directions change from one phase to the other.

    Every line through voxels' centres is followed from voxel to voxel, as far apart as the
    direction has them; so no staircase is seen, and a plane is crossed just as often as it should
    be. What is missed about edges and of chords shorter than such a step is in proportion to its
    length, as long as features are wider, and so is added: lines to the next voxel but one miss
    twice as much.

    Parameters
    ----------
    grid
        The body; any spacing. Along periodic axes lines go on; elsewhere they end at the sides,
        which are no change of phase, and so are those of a bulk.
    progress
        Called as ``progress(done, count)``; raising in it cancels.

    Returns
    -------
    Intercepts
        A direction's doubt is how far lines to the third voxel are from missing thrice as much.

    Raises
    ------
    GridError
        Where the shortest edge has fewer than 8 voxels, or the phase never changes.
    MemoryLimitError
        Where there is too little memory.
    """
    frame = grid.frame
    if min(frame.shape) < LEAST:
        raise GridError(
            f"intercepts: got a grid of {frame.shape} voxels; wanted {LEAST} along each edge"
        )
    size = " × ".join(map(str, frame.shape))
    check_memory(frame.size * BYTES, f"intercepts of {size} voxels", "Use fewer voxels.")
    one, two, three = _rates(grid, TIMES, progress)
    if not one.any():
        raise GridError("intercepts: the grid has one phase only; wanted both")
    fan = rays(frame.spacing)
    found, doubts = _without_gaps(one, two), np.abs(one - 2 * two + three)
    flat = min(1.0, float(found.std() / found.mean()) / FLAT)
    bias = fan.spread + flat * fan.worst
    return Intercepts(frame.unit, fan.directions, fan.weights, found, doubts, bias)


def crossings(grid: Tiled) -> Floats:
    """Return the phase changes per length of line in the directions of ``intercepts``, (m,)."""
    one, two = _rates(grid, TIMES[:2])
    return _without_gaps(one, two)


def _without_gaps(one: Floats, two: Floats) -> Floats:
    """Return what lines would see that miss nothing between voxels: those of two miss as twice."""
    return np.maximum(2 * one - two, 0.0)


def _rates(
    grid: Tiled, times: tuple[int, ...], progress: Callable[[int, int], None] | None = None
) -> list[Floats]:
    """Return phase changes per length of line, from voxel to voxel, every other and every third."""
    from porous.kernels.intercepts import changes

    frame = grid.frame
    fan = rays(frame.spacing)
    fill, bulk = grid.block((0, 0, 0), frame.shape)
    known = None if bulk is None else bulk >= 128
    steps = np.concatenate([k * fan.steps for k in times])
    differ, pairs = changes(fill >= 128, known, steps, periodic=frame.periodic, progress=progress)
    lengths = np.concatenate([k * fan.lengths for k in times])
    # A bulk too thin for pairs shows no change.
    return np.split(differ / np.maximum(pairs, 1) / lengths, len(times))


class Fabric(NamedTuple):
    """M of 1/MIL(u)² = u·M·u: its eigenvalues (ascending) and eigenvectors (rows).

    ``error`` gives the standard error of Σ aᵢⱼ vᵢ·M·vⱼ from the matrix a, ``matrix`` the M of other
    squares of crossings.
    """

    values: Floats
    axes: Floats
    error: Callable[[Floats], float]
    matrix: Callable[[Floats], Floats]

    @property
    def anisotropy(self) -> float:
        """1 − least eigenvalue / largest."""
        return float(1 - self.values[0] / self.values[2])

    @property
    def whole(self) -> Floats:
        """M in x, y and z, float64, shape (3, 3)."""
        return np.asarray(self.axes.T @ np.diag(self.values) @ self.axes)

    @property
    def tensor(self) -> Floats:
        """M by its trace, float64, shape (3, 3)."""
        return np.asarray(self.whole / self.values.sum())

    def tensor_error(self, a: int, b: int) -> float:
        """Return the standard error of an entry of ``tensor``."""
        entry = np.zeros((3, 3))
        entry[a, b] = entry[b, a] = 0.5 * (1 + (a == b))
        # An entry's part of the trace.
        given = entry - self.tensor[a, b] * np.eye(3)
        return self.error(self.axes @ given @ self.axes.T) / float(self.values.sum())

    @property
    def unevenness(self) -> float:
        """The standard error of the anisotropy, and by how much noise alone may have raised it.

        Eigenvalues that are as near to each other as noise would part them are parted by it: by
        what ``tensor`` is off there, and of a body that is the same in all directions all of the
        anisotropy is such an error. Those further apart are parted by so much less.
        """
        slopes = np.array([1, 0, self.values[0] / self.values[2]]) / self.values[2]
        total = self.error(np.diag(slopes * (-1, 0, 1))) ** 2
        eye, off = np.eye(3), np.zeros((3, 3))
        for i in range(3):
            for j in range(3):
                off[i, j] = self.error((np.outer(eye[i], eye[j]) + np.outer(eye[j], eye[i])) / 2)
        reach = 2 * float(np.linalg.norm(off))
        for i, j in ((0, 1), (1, 2), (0, 2)):
            gap = self.values[j] - self.values[i]
            near = min(1.0, reach / gap) if gap else 1.0
            total += PARTED * (near * off[i, j] * (slopes[i] + slopes[j])) ** 2
        return math.sqrt(total)

    def tilt(self, place: int, other: Fabric) -> float:
        """Return how far an axis may be turned, in radians: by the fit, and to another fit's."""
        turn = math.acos(min(1.0, abs(float(self.axes[place] @ other.axes[place]))))
        total = turn**2
        for across in {0, 1, 2} - {place}:
            gap = abs(self.values[place] - self.values[across])
            pair = np.outer(np.eye(3)[place], np.eye(3)[across])
            total += (self.error(pair) / gap) ** 2 if gap else math.inf
        return math.sqrt(total)


def fabric(found: Intercepts) -> Measures:
    """Return mean intercept lengths along the main directions, these, and the anisotropy.

    The mean intercept length MIL(u) is the length of lines in direction u over the number of times
    that the phase changes on them. An ellipsoid is put through it, 1/MIL(u)² = u·M·u, by least
    squares over directions weighted by their parts of the sphere (T. P. Harrigan & R. W. Mann,
    J. Mater. Sci. 19, 1984; A. Odgaard, Bone 20, 1997): exact for layers, for tubes, and for
    whatever is a stretched isotropic body.

    Parameters
    ----------
    found
        What ``intercepts`` found.

    Returns
    -------
    Measures
        mean_intercept_length_1, _2 and _3 from the longest on (none that is infinite, as along
        tubes); degree_of_anisotropy, 1 − λ₁/λ₃ of the least and largest eigenvalue of M, 0 where
        all directions are alike and 1 of layers and tubes; fabric_tensor_xx, _yy, _zz, _yz, _xz and
        _xy, M by its trace; and, as far as the directions can be
        told from each other, unit vectors fabric_direction_1_x … and fabric_direction_3_x ….

        Uncertainties are the difference to what the crossings less their doubts come to, and the
        standard error of the fit by these doubts and by what the fit leaves: of a body that no
        ellipsoid describes the numbers depend on the directions that were looked along. Noise makes
        a body look more anisotropic than it is, never less so, and the anisotropy's holds that.
    """
    return Measures(tuple(_rows(found)))


def _rows(found: Intercepts) -> Iterator[Measure]:
    fit, other = fitted(found), fitted(found, less=1.0)
    for place, value in enumerate(fit.values):
        doubt = math.hypot(fit.error(np.diag(np.eye(3)[place])), value - other.values[place])
        if value > doubt:
            spread = value**-0.5 * doubt / value / 2
            yield _row(f"mean_intercept_length_{place + 1}", value**-0.5, found.unit, spread)
    doubt = math.hypot(fit.unevenness, fit.anisotropy - other.anisotropy)
    yield _row("degree_of_anisotropy", fit.anisotropy, "1", doubt)
    yield from _tensor(fit, other)
    for place in (0, 2):
        tilt = fit.tilt(place, other)
        if tilt < CLEAR:
            yield from _direction(f"fabric_direction_{place + 1}", fit.axes[place], tilt)


def _tensor(fit: Fabric, other: Fabric) -> Iterator[Measure]:
    mine, its = (given.tensor for given in (fit, other))
    for a, b in _PAIRS:
        doubt = math.hypot(fit.tensor_error(a, b), mine[a, b] - its[a, b])
        yield _row(f"fabric_tensor_{'xyz'[a]}{'xyz'[b]}", mine[a, b], "1", doubt)


def _direction(name: str, axis: Floats, tilt: float) -> Iterator[Measure]:
    for letter, part in zip("xyz", axis.tolist(), strict=True):
        # A vector that turns by t changes along an axis by t times what lies across it.
        spread = tilt * math.sqrt(max(0.0, 1 - part**2)) + tilt**2 / 2
        yield _row(f"{name}_{letter}", part, "1", spread)


def _row(name: str, value: float, unit: str, doubt: float) -> Measure:
    return Measure(name, float(value), unit, METHOD, float(doubt), "standard", "grid")


def fitted(found: Intercepts, *, less: float = 0.0) -> Fabric:
    """Return the ellipsoid through the crossings, less so many times their doubts.

    Eigenvalues below zero, or no larger than what rounding leaves, count as zero.
    """
    u, weights = found.directions, found.weights
    squares = np.maximum(found.crossings - less * found.doubts, 0.0) ** 2
    design = _products(u, u)
    inverse = np.linalg.inv(design.T @ (weights[:, None] * design))
    project = inverse @ (design * weights[:, None]).T
    terms = project @ squares
    left = squares - design @ terms
    spread = math.sqrt(float(weights @ left**2) * len(u) / (len(u) - len(_PAIRS)))
    errors = np.hypot(spread, 2 * found.crossings * found.doubts)
    values, vectors = np.linalg.eigh(_matrix(terms))
    axes = np.array([_turned(axis) for axis in vectors.T])

    def error(parts: Floats) -> float:
        given = sum(
            part * _products(axes[i : i + 1], axes[j : j + 1])
            for (i, j), part in np.ndenumerate(parts)
            if part
        )
        return float(np.linalg.norm(given @ project * errors))

    def matrix(squares: Floats) -> Floats:
        return _matrix(project @ squares)

    values = np.where(values > ROUNDING * values[2], values, 0.0)
    return Fabric(values, axes, error, matrix)


def _products(v: Floats, w: Floats) -> Floats:
    """Return what each entry of a symmetric M counts in v·M·w, shape (m, 6)."""
    columns = [(v[:, a] * w[:, b] + v[:, b] * w[:, a]) / (1 + (a == b)) for a, b in _PAIRS]
    return np.stack(columns, axis=1)


_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


def _matrix(terms: Floats) -> Floats:
    result = np.empty((3, 3))
    for (a, b), term in zip(_PAIRS, terms, strict=True):
        result[a, b] = result[b, a] = term
    return result


def _turned(axis: Floats) -> Floats:
    """Return an axis or its opposite: that whose first large part is positive."""
    large = np.flatnonzero(np.abs(axis) > 0.5)[0]
    return axis if axis[large] > 0 else -axis
