"""Bodies that can be asked point by point: cells of digit sets, and unions of small pieces."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.memory import check_memory
from porous.models.lattice import MOST_CELLS
from porous.models.membership import covered
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.kernels.points import Bins
    from porous.models.digits import DigitSet
    from porous.models.primitive import Primitive
    from porous.values import Box

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]
    Indices = NDArray[np.int64]

CLOSED = 1e-12
"""Solids are closed: a point within this part of their body's size of them is in them."""

MOST_BINS = 64
"""Bins along an axis."""


@dataclass(frozen=True, eq=False)
class DigitCells(Value):
    """The cells of a level of a digit set; points on a plane between two belong to both.

    Parameters
    ----------
    digits, level
        Which cells are kept, and how often; 0 is the whole box.
    box
        The level-0 cell.

    Raises
    ------
    ModelError
        For cells too small for floating point.
    """

    digits: DigitSet
    level: int
    box: Box

    def __post_init__(self) -> None:
        if self.digits.divisions**self.level > MOST_CELLS:
            raise ModelError(
                f"level: {self.digits.divisions}^{self.level} cells along an axis are more than "
                "floating point tells apart; choose a lower level"
            )

    def contains(self, points: Floats) -> Flags:
        """Tell which points (n, 3) lie in a cell."""
        from porous.kernels.points import in_digits

        count = self.digits.divisions**self.level
        per = count / np.array(self.box.lengths)
        lower, slack = np.array(self.box.lower), min(CLOSED * count, 0.25)
        return in_digits(points, self._table, self.level, lower, per, slack)

    @cached_property
    def _table(self) -> Flags:
        return self.digits.table


@dataclass(frozen=True, eq=False)
class Union(Value):
    """Convex pieces of one kind, which lie in bins.

    Parameters
    ----------
    forms
        float64, shape (k, r, 4): each piece is where all its linear forms are at most zero, or
        where the sum of their squares is at most one.
    lower, upper
        float64, shape (k, 3): corners of a box about each piece.
    is_round
        Whether pieces are ellipsoids.
    """

    forms: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    is_round: bool = False

    def __post_init__(self) -> None:
        for name in ("forms", "lower", "upper"):
            self._set(name, frozen(getattr(self, name), np.float64))

    def contains(self, points: Floats) -> Flags:
        """Tell which points (n, 3) lie in a piece."""
        from porous.kernels.points import in_pieces

        if not len(self.forms):
            return np.zeros(len(points), np.bool_)
        return in_pieces(points, self.forms, self.bins, is_round=self.is_round)

    @cached_property
    def bins(self) -> Bins:
        """Which pieces may hold the points of a part of space; about as large as pieces are."""
        from porous.kernels.points import Bins

        size = self.upper - self.lower
        lower = self.lower.min(axis=0)
        whole = (self.upper.max(axis=0) - lower) * (1 + CLOSED)
        shape = np.clip(np.ceil(whole / size.mean(axis=0)), 1, MOST_BINS).astype(np.int64)
        per = shape / whole
        at = (np.floor((corner - lower) * per).astype(np.int64) for corner in self._reach)
        begin, end = (np.clip(index, 0, shape - 1) for index in at)
        bin_, item = _pairs(begin, end, shape)
        order = np.argsort(bin_, kind="stable")
        first = np.searchsorted(bin_[order], np.arange(shape.prod() + 1))
        x, y, z = map(int, shape)
        return Bins(lower, per, (x, y, z), first, item[order])

    @property
    def _reach(self) -> tuple[Floats, Floats]:
        slack = CLOSED * (np.abs(self.upper).max() + np.abs(self.lower).max())
        return self.lower - slack, self.upper + slack


def _pairs(begin: Indices, end: Indices, shape: Indices) -> tuple[Indices, Indices]:
    """Return each bin that a piece's range of bins has, and the piece."""
    spans = end - begin + 1
    many = spans.prod(axis=1)
    check_memory(32 * int(many.sum()), f"bins of {len(many)} pieces", "Choose a lower level.")
    item = np.repeat(np.arange(len(many)), many)
    number = np.arange(len(item)) - np.repeat(np.cumsum(many) - many, many)
    number, z = np.divmod(number, spans[item, 2])
    x, y = np.divmod(number, spans[item, 1])
    i, j, k = (begin[item] + np.stack([x, y, z], axis=1)).T
    return np.asarray((i * shape[1] + j) * shape[2] + k), item


@dataclass(frozen=True, eq=False)
class Images(Value):
    """The union of images of a solid, a polyhedron, a ball or any closed mesh, and of balls.

    Parameters
    ----------
    primitive
        The solid.
    frames
        float64, shape (k, 3, 4): matrix, regular, and translation of each image.
    balls
        float64, shape (c, 4): centres and radii of balls that are joined.
    """

    primitive: Primitive
    frames: NDArray[np.float64]
    balls: NDArray[np.float64]

    def __post_init__(self) -> None:
        self._set("frames", frozen(self.frames, np.float64))
        self._set("balls", frozen(self.balls, np.float64))

    def contains(self, points: Floats) -> Flags:
        """Tell which points (n, 3) lie in an image or a ball."""
        if self.primitive.radius is None and not self.primitive.convex:
            images = covered(points, self.primitive, self.frames)
        else:
            images = self._union.contains(points)
        return images | self._rounds.contains(points) if len(self.balls) else images

    @cached_property
    def _rounds(self) -> Union:
        rows = np.eye(3) / self.balls[:, 3, None, None]
        reach = np.repeat(self.balls[:, 3:], 3, axis=1)
        return _ellipsoids(self.balls[:, :3], rows, reach)

    @cached_property
    def _union(self) -> Union:
        solid, frames = self.primitive, self.frames
        inverse = np.linalg.inv(frames[:, :, :3])
        if solid.radius is not None:
            centres = frames[:, :, :3] @ solid.points[0] + frames[:, :, 3]
            reach = solid.radius * np.linalg.norm(frames[:, :, :3], axis=2)
            rows = np.asarray(inverse / solid.radius, np.float64)
            return _ellipsoids(centres, rows, reach)
        normals = np.einsum("fa,kab->kfb", solid.planes[:, :3], inverse)
        offsets = solid.planes[:, 3] + np.einsum("kfb,kb->kf", normals, frames[:, :, 3])
        corners = np.einsum("kab,nb->kna", frames[:, :, :3], solid.points) + frames[:, None, :, 3]
        return _hulls(normals, offsets, corners)


def tetrahedra(corners: Floats) -> Union:
    """Return the union of tetrahedra (k, 4, 3) of any orientation; flat ones are left out."""
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    size = np.linalg.norm(edges, axis=(1, 2))
    kept = np.abs(np.linalg.det(edges)) > CLOSED * size**3
    inverse = np.linalg.inv(edges[kept])
    normals = np.concatenate([-inverse, inverse.sum(axis=1, keepdims=True)], axis=1)
    offsets = np.einsum("kfa,ka->kf", normals, corners[kept, 0])
    offsets[:, 3] += 1
    return _hulls(normals, offsets, corners[kept])


def _ellipsoids(centres: Floats, rows: Floats, reach: Floats) -> Union:
    constants = -np.einsum("kab,kb->ka", rows, centres)
    forms = np.concatenate([rows, constants[..., None]], axis=2)
    return Union(forms, centres - reach, centres + reach, is_round=True)


def _hulls(normals: Floats, offsets: Floats, corners: Floats) -> Union:
    """Return pieces n·x ≤ d, (k, f, 3) and (k, f), with corners (k, n, 3); closed within slack."""
    length = np.linalg.norm(normals, axis=2)
    slack = CLOSED * (np.abs(corners).max() if len(corners) else 1.0)
    constants = -(offsets / length + slack)
    forms = np.concatenate([normals / length[..., None], constants[..., None]], axis=2)
    return Union(forms, corners.min(axis=1), corners.max(axis=1))
