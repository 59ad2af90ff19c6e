"""Unions of tetrahedra and of balls swept over points, segments and triangles."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property, reduce
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.models.pieces import BLOCK, ROUNDING, Lattice
from porous.values import CENTRE, Box
from porous.values.value import Value, adopted, frozen

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from porous.kernels.simplices import Crowd
    from porous.values import Frame, Pattern

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

CHUNK = 1 << 12
"""Cells that are split, and blocks whose boxes are found, at once."""

STRAIGHT = 1e-12
"""A hexahedron is a parallelepiped where no corner is further off than this part of its size."""

HEXA_FACES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4]])
HEXA_FACES = np.vstack([HEXA_FACES, [1, 5, 7, 3]])
"""Corners 4a + 2b + c of a hexahedron's faces, anticlockwise seen from outside."""

HEXA_TETS = np.array(
    [
        [14, 8 + face, corners[k], corners[(k + 1) % 4]]
        for face, corners in enumerate(HEXA_FACES.tolist())
        for k in range(4)
    ]
)
"""Centre 14, face means 8 … 13 and the edges: 24 tetrahedra."""

STRAIGHT_TETS = np.array([[0, 4, 2, 1], [6, 2, 4, 7], [5, 4, 1, 7], [3, 1, 2, 7], [1, 4, 2, 7]])
"""Four corners cut off and what is left: five tetrahedra."""

OCTA_TETS = np.array([[0, 1, 2, 4], [0, 1, 4, 3], [0, 1, 3, 5], [0, 1, 5, 2]])
"""Four tetrahedra about the diagonal from corner 0 to corner 1."""

TETRA_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


def _none(*shape: int) -> Floats:
    return adopted(np.zeros((0, *shape)))


@dataclass(frozen=True, eq=False)
class Simplices(Value):
    """The union of solid tetrahedra and of balls swept over points, segments and triangles.

    Parameters
    ----------
    tets
        float64, shape (k, 4, 3): corners of tetrahedra, of any orientation. Flat ones have no
        volume, but they touch voxels.
    balls
        float64, shape (n, 4): centres and radii.
    capsules, capsule_radii
        float64, shapes (n, 2, 3) and (n,): all points within a radius of a segment.
    plates, plate_radii
        float64, shapes (n, 3, 3) and (n,): all points within a radius, half the thickness, of a
        triangle. What has no radius has no volume, but it touches voxels.

    Raises
    ------
    ModelError
        For arrays of another shape, numbers that are not finite, or negative radii.
    """

    tets: NDArray[np.float64] = field(default_factory=lambda: _none(4, 3))
    balls: NDArray[np.float64] = field(default_factory=lambda: _none(4))
    capsules: NDArray[np.float64] = field(default_factory=lambda: _none(2, 3))
    capsule_radii: NDArray[np.float64] = field(default_factory=_none)
    plates: NDArray[np.float64] = field(default_factory=lambda: _none(3, 3))
    plate_radii: NDArray[np.float64] = field(default_factory=_none)

    def __post_init__(self) -> None:
        for name, shape in (("tets", (4, 3)), ("balls", (4,)), ("capsules", (2, 3))):
            self._set(name, _checked(getattr(self, name), name, shape))
        self._set("plates", _checked(self.plates, "plates", (3, 3)))
        for name, held in (("capsule", self.capsules), ("plate", self.plates)):
            what = f"{name}_radii"
            radii = _radii(_checked(getattr(self, what), what, ()), what)
            if len(radii) != len(held):
                raise ModelError(
                    f"{what}: got {len(radii)} for {len(held)} {name}s; wanted one for each"
                )
            self._set(what, radii)
        _radii(self.balls[:, 3], "balls")

    @property
    def empty(self) -> bool:
        """Whether there is nothing at all."""
        return not any(len(group.corners) for group in self._all)

    @property
    def box(self) -> Box:
        """The tight box of the closed union.

        Raises
        ------
        ModelError
            Where it is empty.
        """
        if self.empty:
            raise ModelError("simplices: got none; wanted at least one, for nothing has no box")
        groups = [group for group in self._all if len(group.corners)]
        return Box.of_points(
            np.concatenate([ends for group in groups for ends in (group.lower, group.upper)])
        )

    def sample(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the masks of a frame's voxels, uint64 of shape ``frame.shape``.

        Bit r · C + c is set where the pattern's point (r, c) lies in the union. Tetrahedra are
        closed within 1e-6 of a voxel (4e-5 at their edges and corners), so that those that abut
        leave no gap. Any thread may ask for any tile.
        """
        from porous.kernels.simplices import paint_swept, paint_tetrahedra

        lattice = Lattice.over(frame, pattern)
        place = lattice.window, lattice.origin, lattice.spacing
        paint_tetrahedra(*place, self._solid.near(frame))
        for group in self._swept:
            paint_swept(*place, group.near(frame))
        return lattice.window.masks

    def cover(self, frame: Frame) -> tuple[NDArray[np.uint64], float]:
        """Return a mark for every voxel that the closed union touches, and a Hausdorff bound.

        Tetrahedra, and what has no radius, mark just the voxels they touch (separating axes,
        Gottschalk 1996); swept simplices also some whose centre is within half a diagonal. Every
        point of a marked voxel is within one diagonal, the bound, of the union.
        """
        from porous.kernels.simplices import paint_swept, paint_tetrahedra

        lattice = Lattice.over(frame, CENTRE)
        place = lattice.window, lattice.origin, lattice.spacing
        for group in (self._solid, self._thin):
            paint_tetrahedra(*place, group.near(frame), cover=True)
        reach = frame.diagonal / 2
        for group in self._swept:
            paint_swept(*place, group.near(frame, reach), more=reach)
        return lattice.window.masks, frame.diagonal * ROUNDING

    def grown(self, radius: float, skin: ArrayLike | None = None) -> Simplices:
        """Return the sum of the union and a ball (Minkowski).

        Tetrahedra stay, and balls are swept over the surface of their union; radii grow.

        Parameters
        ----------
        radius
            Of the ball, zero or more.
        skin
            Triangles (t, 3, 3) that hold the surface of the tetrahedra's union; all faces of all
            tetrahedra where nothing is given.

        Raises
        ------
        ModelError
            For a radius that is not a length, or triangles as in the class.
        """
        if not 0 <= radius < np.inf:
            raise ModelError(f"radius: got {radius}; wanted a length, zero or more")
        if skin is None:
            skin = self.tets[:, TETRA_FACES].reshape(-1, 3, 3)
        surface = _checked(skin, "skin", (3, 3))
        return Simplices(
            self.tets,
            self.balls + np.array([0, 0, 0, radius]),
            self.capsules,
            self.capsule_radii + radius,
            adopted(np.concatenate([self.plates, surface])),
            np.concatenate([self.plate_radii + radius, np.full(len(surface), float(radius))]),
        )

    def joined(self, other: Simplices) -> Simplices:
        """Return the union with another body."""
        parts = [
            adopted(np.concatenate([getattr(self, part.name), getattr(other, part.name)]))
            for part in fields(self)
        ]
        return Simplices(*parts)

    @cached_property
    def _solid(self) -> _Group:
        return _Group.of(self.tets, None)

    @cached_property
    def _round(self) -> tuple[_Group, ...]:
        """Balls, capsules and plates."""
        return (
            _Group.of(self.balls[:, None, :3], self.balls[:, 3]),
            _Group.of(self.capsules, self.capsule_radii),
            _Group.of(self.plates, self.plate_radii),
        )

    @property
    def _all(self) -> tuple[_Group, ...]:
        return (self._solid, *self._round)

    @cached_property
    def _swept(self) -> tuple[_Group, ...]:
        """What has a radius."""
        return tuple(group.chosen(group.radii > 0) for group in self._round)

    @cached_property
    def _thin(self) -> _Group:
        """What has none, as flat tetrahedra with corners that coincide."""
        thin = [group.corners[group.radii == 0] for group in self._round]
        corners = [part[:, np.minimum(np.arange(4), part.shape[1] - 1)] for part in thin]
        return _Group.of(np.concatenate(corners), None)


@dataclass(frozen=True)
class _Group:
    """Simplices of one kind, and the boxes of blocks of consecutive ones, radii included."""

    corners: Floats
    radii: Floats
    lower: Floats
    upper: Floats

    @classmethod
    def of(cls, corners: Floats, radii: Floats | None) -> _Group:
        """Return simplices (k, n, 3) with their radii (k,), or without any."""
        corners = frozen(corners, np.float64)
        radii = np.zeros(0) if radii is None else radii
        lower, upper = [np.zeros((0, 3))], [np.zeros((0, 3))]
        for first in range(0, len(corners), CHUNK * BLOCK):
            part = slice(first, first + CHUNK * BLOCK)
            ends = [corners[part, v] for v in range(corners.shape[1])]
            reach = radii[part, None] if len(radii) else 0.0
            blocks = np.arange(0, len(ends[0]), BLOCK)
            lower.append(np.minimum.reduceat(reduce(np.minimum, ends) - reach, blocks))
            upper.append(np.maximum.reduceat(reduce(np.maximum, ends) + reach, blocks))
        return cls(corners, radii, np.concatenate(lower), np.concatenate(upper))

    def chosen(self, keep: NDArray[np.bool_]) -> _Group:
        """Return some of them."""
        return self if keep.all() else _Group.of(self.corners[keep], self.radii[keep])

    def near(self, frame: Frame, more: float = 0.0) -> Crowd:
        """Return those whose block's box meets the frame's, give or take ``more`` and a voxel."""
        from porous.kernels.simplices import Crowd

        margin = np.array(frame.spacing) + more
        lower, upper = np.array(frame.box.lower) - margin, np.array(frame.box.upper) + margin
        meets = ((self.lower <= upper) & (self.upper >= lower)).all(axis=1)
        return Crowd(self.corners, self.radii, np.flatnonzero(meets), BLOCK)


def volumes(tets: ArrayLike) -> NDArray[np.float64]:
    """Return the volumes of tetrahedra (k, 4, 3), float64 (k,): det(b − a, c − a, d − a) / 6.

    Positive where a, b, c run anticlockwise seen from d's other side: right-handed ones.

    Raises
    ------
    ModelError
        For an array of another shape or numbers that are not finite.
    """
    corners = _checked(tets, "tets", (4, 3))
    a, b, c = (corners[:, v] - corners[:, 0] for v in (1, 2, 3))
    return np.asarray((a * np.cross(b, c)).sum(axis=1) / 6)


def hexa_tets(corners: ArrayLike) -> NDArray[np.float64]:
    """Return tetrahedra (t, 4, 3) that fill trilinear hexahedra, in their order.

    A curved one gives 24: its centre, the means of its faces and its edges. They treat all corners
    alike, so what neighbours share is cut alike, and their volume is just the trilinear cell's, for
    a fan's is affine in its apex and a bilinear face is the mean of its two diagonal splits. A
    parallelepiped (within 1e-12 of its size) gives five, which fill it, too.

    Parameters
    ----------
    corners
        Shape (k, 8, 3): corner 4a + 2b + c lies at (a, b, c) of the unit cube. Right-handed cells
        give tetrahedra of positive volume.

    Raises
    ------
    ModelError
        For an array of another shape or numbers that are not finite.
    """
    cells = _checked(corners, "corners", (8, 3))
    straight = np.concatenate([_straight(part) for part in _parts(cells)] or [np.zeros(0, bool)])
    first = np.cumsum(np.where(straight, len(STRAIGHT_TETS), len(HEXA_TETS)))
    result = np.empty((int(first[-1]) if len(first) else 0, 4, 3))
    done = 0
    for part in _parts(cells):
        some = straight[done : done + len(part)]
        ends = first[done : done + len(part)]
        _fill(result, ends[some], part[some], STRAIGHT_TETS)
        _fill(result, ends[~some], _with_means(part[~some]), HEXA_TETS)
        done += len(part)
    return adopted(result)


def octa_tets(corners: ArrayLike) -> NDArray[np.float64]:
    """Return the four tetrahedra of each octahedron about its first diagonal, (4 k, 4, 3).

    Parameters
    ----------
    corners
        Shape (k, 6, 3): opposite corners in pairs (0, 1), (2, 3), (4, 5); right-handed where the
        ways from the first to the second corner of the pairs are.

    Raises
    ------
    ModelError
        For an array of another shape or numbers that are not finite.
    """
    cells = _checked(corners, "corners", (6, 3))
    return adopted(np.ascontiguousarray(cells[:, OCTA_TETS].reshape(-1, 4, 3)))


def _parts(cells: Floats) -> list[Floats]:
    return [cells[first : first + CHUNK] for first in range(0, len(cells), CHUNK)]


def _straight(cells: Floats) -> NDArray[np.bool_]:
    """Return which hexahedra (k, 8, 3) are images of a cube under an affine map."""
    a, b, c = (cells[:, v] - cells[:, 0] for v in (4, 2, 1))
    wanted = {3: b + c, 5: a + c, 6: a + b, 7: a + b + c}
    size = np.ptp(cells, axis=1).max(axis=1)
    off = [np.abs(cells[:, v] - cells[:, 0] - way).max(axis=1) for v, way in wanted.items()]
    return np.asarray(np.max(off, axis=0) <= STRAIGHT * size)


def _with_means(cells: Floats) -> Floats:
    """Return the corners (k, 8, 3), the means of the faces, and the centres: (k, 15, 3)."""
    means = cells[:, HEXA_FACES].mean(axis=2)
    return np.concatenate([cells, means, cells.mean(axis=1, keepdims=True)], axis=1)


def _fill(result: Floats, ends: Indices, points: Floats, tets: Indices) -> None:
    """Write each cell's tetrahedra just before row ``ends`` of the result."""
    rows = ends[:, None] - len(tets) + np.arange(len(tets))
    result[rows] = points[:, tets]


def _checked(array: ArrayLike, name: str, shape: tuple[int, ...]) -> Floats:
    try:
        result = frozen(array, np.float64)
    except (TypeError, ValueError) as error:
        raise ModelError(f"{name}: got no array of numbers ({error})") from None
    if result.ndim != len(shape) + 1 or result.shape[1:] != shape:
        wanted = ", ".join(["n", *map(str, shape)]) + ("," if not shape else "")
        raise ModelError(f"{name}: got shape {result.shape}; wanted ({wanted})")
    if not np.isfinite(result).all():
        raise ModelError(f"{name}: got a number that is not finite; wanted finite coordinates")
    return result


def _radii(radii: Floats, name: str) -> Floats:
    if len(radii) and radii.min() < 0:
        raise ModelError(f"{name}: got radius {radii.min()}; wanted lengths, zero or more")
    return radii
