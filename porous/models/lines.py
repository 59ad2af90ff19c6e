"""Bodies that straight lines can be sent through: unions of convex pieces and meshes, and digits.

Whatever a level draws is a union of polytopes, of quadrics between two planes and of closed meshes:
also what grows by a ball, of slabs over facets, beams along edges and balls.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from porous.kernels.line_probes import Hierarchy, Sight, through_digits, through_pieces
from porous.memory import check_memory
from porous.models.inside import tetrahedra
from porous.models.pieces import Pieces
from porous.models.simplices import Simplices
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from porous.models.digits import DigitSet
    from porous.models.drawing import Part
    from porous.models.ifs import IFS
    from porous.models.primitive import Primitive
    from porous.values import Box

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]
    Progress = Callable[[int, int], None]

TOLERANCE = 1e-9
"""Ends on a line nearer than this part of the box's longest edge are one. Where pieces share a side
rounding leaves a gap, some 1e-16 of that edge over the cosine of the line to the side's normal.
Lines cross a side in proportion to that cosine, so one in 1e14 of them shows a gap this long; of
gaps that are there, about cells a thousandth of the edge in size, some one in 1e6 is shorter."""

ROUND = 1e-9
"""Images of a ball whose half axes differ by less, relatively, are balls."""

EACH = 100
"""Bytes a piece takes besides its forms."""


class Stretches(NamedTuple):
    """What lines see of a body, each float64 of shape (n,).

    Parameters
    ----------
    length, solid
        How long the line is in the box, and how much of that lies in the solid.
    bulk, bulk_solid
        The same of the bulk.
    crossings
        How often the line goes into the solid or out of it, the box's sides left out.
    from_solid, to_solid
        1 where the line is inside the solid at the side where it enters the box, and where it
        leaves it; else 0.
    """

    length: Floats
    solid: Floats
    bulk: Floats
    bulk_solid: Floats
    crossings: Floats
    from_solid: Floats
    to_solid: Floats


class LineBody(Protocol):
    """A body that straight lines can be sent through."""

    def seen(
        self, lines: Floats, box: Box, bulk: Box, progress: Progress | None = None
    ) -> Stretches:
        """Return what lines (n, 6), a point and a direction of length one, see within a box."""


@dataclass(frozen=True, eq=False)
class Convex(Value):
    """Pieces of one kind, float64: forms (k, r, 4) and corners (k, 3) of a box about each."""

    forms: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 4, 4)))
    lower: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    upper: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        for name in ("forms", "lower", "upper"):
            self._set(name, frozen(getattr(self, name), np.float64))

    def __add__(self, other: Convex) -> Convex:
        rows = max(self.forms.shape[1], other.forms.shape[1])
        return Convex(
            np.concatenate([_widened(self.forms, rows), _widened(other.forms, rows)]),
            np.concatenate([self.lower, other.lower]),
            np.concatenate([self.upper, other.upper]),
        )


def _widened(forms: Floats, rows: int) -> Floats:
    """Return planes with more of them, which bound nothing; −1 is below zero everywhere."""
    more = np.zeros((len(forms), rows - forms.shape[1], 4))
    more[..., 3] = -1.0
    return np.concatenate([forms, more], axis=1)


@dataclass(frozen=True, eq=False)
class UnionLines(Value):
    """The union of polytopes, quadrics and closed meshes; see ``kernels.line_probes``."""

    polytopes: Convex = field(default_factory=Convex)
    quadrics: Convex = field(default_factory=Convex)
    triangles: Convex = field(default_factory=lambda: Convex(np.zeros((0, 3, 4))))

    def __add__(self, other: UnionLines) -> UnionLines:
        return UnionLines(
            self.polytopes + other.polytopes,
            self.quadrics + other.quadrics,
            self.triangles + other.triangles,
        )

    def seen(
        self, lines: Floats, box: Box, bulk: Box, progress: Progress | None = None
    ) -> Stretches:
        """Return what lines (n, 6) see within a box."""
        return Stretches(*through_pieces(lines, _sight(box, bulk), self._pieces, progress).T)

    @cached_property
    def _pieces(self) -> tuple[Hierarchy, Hierarchy, Hierarchy]:
        kinds = self.polytopes, self.quadrics, self.triangles
        need = sum(2 * kind.forms.nbytes + EACH * len(kind.forms) for kind in kinds)
        check_memory(need, "boxes of pieces for lines", "Choose a lower level.")
        a, b, c = (Hierarchy.of(kind.forms, kind.lower, kind.upper) for kind in kinds)
        return a, b, c


@dataclass(frozen=True, eq=False)
class DigitLines(Value):
    """The cells of a level of a digit set in a box, which lines look for from the largest down."""

    digits: DigitSet
    level: int
    box: Box

    def seen(
        self, lines: Floats, box: Box, bulk: Box, progress: Progress | None = None
    ) -> Stretches:
        """Return what lines (n, 6) see within a box."""
        cell = np.array([*self.box.lower, *self.box.upper])
        kept = self.digits.keep, self.digits.divisions, self.level
        return Stretches(*through_digits(lines, _sight(box, bulk), *kept, cell, progress).T)


def _sight(box: Box, bulk: Box) -> Sight:
    outer, inner = (frozen([*some.lower, *some.upper], np.float64) for some in (box, bulk))
    return Sight(outer, inner, TOLERANCE * max(box.lengths))


def lines_of_images(model: IFS) -> LineBody | None:
    """Return the level of an iterated function system for lines, None of a limit."""
    if model.level == "limit":
        return None
    if model.plain_digits is None:
        return lines_of([model.pieces])
    assert isinstance(model.level, int)
    return DigitLines(model.plain_digits, model.level, model.primitive.box)


def lines_of(parts: Iterable[Part]) -> UnionLines | None:
    """Return the union of parts for lines, None where one is known by its voxels alone."""
    result = UnionLines()
    for part in parts:
        found = _PARTS[type(part)](part) if type(part) in _PARTS else None
        if found is None:
            return None
        result = result + found
    return result


def _of_pieces(pieces: Pieces) -> UnionLines | None:
    rounds = UnionLines(quadrics=_balls(pieces.rounds))
    images = _images(pieces.primitive, pieces.frames)
    if not pieces.offset:
        return images + rounds
    grown = _grown(pieces.primitive, pieces.frames, pieces.offset)
    return None if grown is None else images + grown + rounds


def _of_simplices(body: Simplices) -> UnionLines:
    solid = tetrahedra(body.tets)
    inside = Convex(solid.forms, solid.lower, solid.upper)
    plates = [
        _plates(body.plates[body.plate_radii == radius], float(radius))
        for radius in np.unique(body.plate_radii)
        if radius
    ]
    whole = UnionLines(inside, _balls(body.balls) + _beams(body.capsules, body.capsule_radii))
    return reduce(UnionLines.__add__, plates, whole)


_PARTS: dict[type, Callable[..., UnionLines | None]] = {
    Pieces: _of_pieces,
    Simplices: _of_simplices,
}


def _images(solid: Primitive, frames: Floats) -> UnionLines:
    """Return the images of a solid; those that are flat have no inside."""
    size = np.linalg.norm(frames[:, :, :3], axis=(1, 2))
    frames = frames[np.abs(np.linalg.det(frames[:, :, :3])) > 1e-12 * size**3]
    corners = np.einsum("kab,nb->kna", frames[:, :, :3], solid.points) + frames[:, None, :, 3]
    if solid.radius is not None:
        rows: Floats = np.asarray(np.linalg.inv(frames[:, :, :3]) / solid.radius, np.float64)
        reach = solid.radius * np.linalg.norm(frames[:, :, :3], axis=2)
        return UnionLines(quadrics=_ellipsoids(corners[:, 0], rows, reach))
    if not solid.convex:
        return UnionLines(triangles=_triangles(solid, frames, corners))
    normals = np.einsum("fa,kab->kfb", solid.planes[:, :3], np.linalg.inv(frames[:, :, :3]))
    offsets = solid.planes[:, 3] + np.einsum("kfb,kb->kf", normals, frames[:, :, 3])
    return UnionLines(_hulls(normals, offsets, corners))


def _triangles(solid: Primitive, frames: Floats, corners: Floats) -> Convex:
    """Return the triangles of images of a mesh, turned where a map turns space inside out."""
    turned = np.linalg.det(frames[:, :, :3]) < 0
    ends = corners[:, solid.triangles]
    ends[turned] = ends[turned][:, :, ::-1]
    ends = ends.reshape(-1, 3, 3)
    forms = np.concatenate([ends, np.zeros((len(ends), 3, 1))], axis=2)
    return Convex(forms, ends.min(axis=1), ends.max(axis=1))


def _hulls(normals: Floats, offsets: Floats, corners: Floats, reach: float = 0.0) -> Convex:
    """Return pieces n·x ≤ d, (k, f, 3) and (k, f), within a reach of their corners (k, n, 3)."""
    forms = np.concatenate([normals, -offsets[..., None]], axis=2)
    return Convex(forms, corners.min(axis=1) - reach, corners.max(axis=1) + reach)


def _ellipsoids(centres: Floats, rows: Floats, reach: Floats) -> Convex:
    forms = np.zeros((len(centres), 4, 4))
    forms[:, :3, :3] = rows
    forms[:, :3, 3] = -np.einsum("kab,kb->ka", rows, centres)
    forms[:, 3, 3] = 0.5  # between zero and one everywhere
    return Convex(forms, centres - reach, centres + reach)


def _balls(balls: Floats) -> Convex:
    balls = balls[balls[:, 3] > 0]
    rows = np.eye(3) / balls[:, 3, None, None]
    return _ellipsoids(balls[:, :3], rows, np.repeat(balls[:, 3:], 3, axis=1))


def _beams(ends: Floats, radii: Floats) -> Convex:
    """Return cylinders between points (k, 2, 3), and balls about them."""
    caps = np.concatenate(
        [np.column_stack([ends[:, 0], radii]), np.column_stack([ends[:, 1], radii])]
    )
    balls = _balls(np.unique(caps, axis=0))
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    long = length > ROUND * radii
    ends, along, length, radii = ends[long], along[long], length[long], radii[long]
    unit = along / length[:, None]
    across = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit), axis=1)])
    across /= np.linalg.norm(across, axis=1)[:, None]
    forms = np.zeros((len(ends), 4, 4))
    forms[:, 0, :3] = across / radii[:, None]
    forms[:, 1, :3] = np.cross(unit, across) / radii[:, None]
    forms[:, 3, :3] = unit / length[:, None]
    forms[:, :, 3] = -np.einsum("kra,ka->kr", forms[:, :, :3], ends[:, 0])
    reach = radii[:, None]
    return balls + Convex(forms, ends.min(axis=1) - reach, ends.max(axis=1) + reach)


def _slabs(corners: Floats, radius: float) -> Convex:
    """Return convex polygons (k, c, 3) thickened by a radius to both sides, flat ones left out."""
    after = np.roll(corners, -1, axis=1)
    middle = corners.mean(axis=1, keepdims=True)
    normal = np.cross(corners - middle, after - middle).sum(axis=1)
    length = np.linalg.norm(normal, axis=1)
    flat = length > 1e-12 * (np.ptp(corners, axis=1) ** 2).sum(axis=1)
    corners, after, middle = corners[flat], after[flat], middle[flat, 0]
    normal = normal[flat] / length[flat, None]
    out = np.cross(after - corners, normal[:, None])
    normals = np.concatenate([normal[:, None], -normal[:, None], out], axis=1)
    height = np.einsum("ka,ka->k", normal, middle)
    offsets = np.column_stack(
        [height + radius, radius - height, np.einsum("kca,kca->kc", out, corners)]
    )
    return _hulls(normals, offsets, corners, radius)


def _plates(corners: Floats, radius: float) -> UnionLines:
    """Return triangles (k, 3, 3) with all within a radius of them."""
    sides = corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2, 3)
    return UnionLines(_slabs(corners, radius), _beams(sides, np.full(len(sides), radius)))


def _grown(solid: Primitive, frames: Floats, radius: float) -> UnionLines | None:
    """Return what a ball adds to images of a solid; None of ellipsoids, which it makes quartics."""
    corners = np.einsum("kab,nb->kna", frames[:, :, :3], solid.points) + frames[:, None, :, 3]
    if solid.radius is not None:
        axes = np.linalg.svd(frames[:, :, :3], compute_uv=False) * solid.radius
        if (np.ptp(axes, axis=1) > ROUND * axes.max(axis=1)).any():
            return None
        return UnionLines(quadrics=_balls(np.column_stack([corners[:, 0], axes[:, 0] + radius])))
    sides = corners[:, solid.edges].reshape(-1, 2, 3)
    slabs = reduce(Convex.__add__, (_slabs(corners[:, facet], radius) for facet in solid.facets))
    return UnionLines(slabs, _beams(sides, np.full(len(sides), radius)))
