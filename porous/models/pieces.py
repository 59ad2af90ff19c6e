"""Unions of affine images of a primitive: which samples lie in them, which voxels they touch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.values import CENTRE
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.kernels.pieces import Window
    from porous.models.primitive import Primitive
    from porous.values import Frame, Pattern

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

SINGULAR = 1e-13
"""A matrix of which |det| is below this part of its norm cubed makes bodies without volume."""

BLOCK = 64
"""Consecutive pieces lie close to each other: so many share a box that is asked first."""

CHUNK = 1 << 16
"""Convex parts that are written down at once."""

MANY_EDGES = 60
"""Hulls with more edges are covered triangle by triangle."""

ROUNDING = 1 + 1e-5
"""Slack of the kernels, in voxels, is covered by bounds that are larger by this factor."""


@dataclass(frozen=True, eq=False)
class Pieces(Value):
    """The union of affine images of a solid, grown by a ball, and of balls.

    Parameters
    ----------
    primitive
        The solid; convex, a ball or any closed mesh.
    frames
        float64, shape (k, 3, 4): matrix and translation of each image. Singular ones make flat
        bodies: they have no volume, but they do grow.
    offset
        Radius of the ball that the images grow by (Minkowski sum), zero or more.
    balls
        float64, shape (c, 4): centres and radii of balls that are joined.

    Raises
    ------
    ModelError
        For a negative offset or arrays of another shape.
    """

    primitive: Primitive
    frames: NDArray[np.float64]
    offset: float = 0.0
    balls: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        self._set("frames", frozen(self.frames, np.float64))
        balls = np.zeros((0, 4)) if self.balls is None else self.balls
        self._set("balls", frozen(balls, np.float64))
        if self.frames.ndim != 3 or self.frames.shape[1:] != (3, 4):
            raise ModelError(f"frames: got shape {self.frames.shape}; wanted (k, 3, 4)")
        if self.rounds.ndim != 2 or self.rounds.shape[1] != 4:
            raise ModelError(f"balls: got shape {self.rounds.shape}; wanted (c, 4)")
        if not 0 <= self.offset < np.inf:
            raise ModelError(f"offset: got {self.offset}; wanted a length, zero or more")

    @property
    def rounds(self) -> Floats:
        """The balls, shape (c, 4)."""
        assert self.balls is not None
        return self.balls

    def sample(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the masks of a frame's voxels, uint64 of shape ``frame.shape``.

        Bit r · C + c is set where the pattern's point (r, c) lies in the union. Solids are closed
        within 1e-6 of a voxel, so pieces that abut leave no gap (but where a line along z only
        grazes a mesh's outline).
        """
        return self._sampled(frame, pattern, self.offset, self.rounds)

    def cover(self, frame: Frame) -> tuple[NDArray[np.uint64], float]:
        """Return a mark for every voxel that the closed union touches, and a Hausdorff bound.

        Polyhedra without offset mark just the voxels they touch (separating axes, Gottschalk
        1996); balls and grown bodies also some whose centre is within half a diagonal. Every
        point of a marked voxel is within one diagonal of the union.
        """
        reach = frame.diagonal / 2
        balls = self.rounds + np.array([0, 0, 0, reach])
        bound = frame.diagonal * ROUNDING
        if self.offset > 0 or self.primitive.radius is not None:
            return self._sampled(frame, CENTRE, self.offset + reach, balls), bound
        lattice = Lattice.over(frame, CENTRE)
        _cover_polyhedra(lattice, self.primitive, self.frames[self._near(frame, 0.0)])
        paint_balls(lattice, balls[:, :3], balls[:, 3])
        return lattice.window.masks, bound

    def _sampled(
        self, frame: Frame, pattern: Pattern, offset: float, balls: Floats
    ) -> NDArray[np.uint64]:
        lattice = Lattice.over(frame, pattern)
        frames = self.frames[self._near(frame, offset)]
        _paint_images(lattice, self.primitive, frames)
        if offset > 0:
            _paint_rims(lattice, self.primitive, frames, offset)
        paint_balls(lattice, balls[:, :3], balls[:, 3])
        return lattice.window.masks

    @cached_property
    def _blocks(self) -> tuple[Floats, Floats]:
        """Lower and upper corners of the boxes of blocks of pieces, without the offset."""
        lower, upper = _boxes(self.primitive, self.frames)
        first = np.arange(0, len(self.frames), BLOCK)
        return np.minimum.reduceat(lower, first), np.maximum.reduceat(upper, first)

    def _near(self, frame: Frame, offset: float) -> Indices:
        """Return the pieces whose box meets the frame's, give or take a voxel."""
        if not len(self.frames):
            return np.zeros(0, np.int64)
        margin = np.array(frame.spacing) + offset
        lower, upper = np.array(frame.box.lower) - margin, np.array(frame.box.upper) + margin

        def meets(low: Floats, high: Floats) -> Indices:
            return np.flatnonzero(((low <= upper) & (high >= lower)).all(axis=1))

        block = meets(*self._blocks)
        index = (block[:, None] * BLOCK + np.arange(BLOCK)).ravel()
        index = index[index < len(self.frames)]
        return np.asarray(index[meets(*_boxes(self.primitive, self.frames[index]))])

    def _content(self) -> tuple[object, ...]:
        return self.primitive, self.frames, self.offset, self.balls


@dataclass(frozen=True)
class Lattice:
    """Lines through a tile; takes lengths of the world to voxels of the whole lattice."""

    window: Window
    origin: Floats
    spacing: Floats

    @classmethod
    def over(cls, frame: Frame, pattern: Pattern) -> Lattice:
        """Return the lines of a pattern through a frame, with empty masks."""
        from porous.kernels.pieces import Window

        masks = np.zeros(frame.shape, np.uint64)
        window = Window(masks, np.array(frame.start), pattern.rows, pattern.depths)
        return cls(window, np.array(frame.origin), np.array(frame.spacing))

    def places(self, points: Floats) -> Floats:
        """Return points (…, 3) of the world in voxels."""
        return np.asarray((points - self.origin) / self.spacing)

    def frames(self, frames: Floats) -> Floats:
        """Return affine maps (k, 3, 4) into the world as maps into voxels."""
        result = frames / self.spacing[:, None]
        result[..., 3] -= self.origin / self.spacing
        return np.asarray(result)

    def forms(self, rows: Floats, constants: Floats) -> Floats:
        """Return linear forms (…, 3) and constants (…) over the world as (…, 4) over voxels."""
        return np.concatenate(
            [rows * self.spacing, (constants + rows @ self.origin)[..., None]], axis=-1
        )

    def planes(self, normals: Floats, offsets: Floats) -> Floats:
        """Return half-spaces n·x ≤ d of the world as (…, 4) over voxels, normals of length one.

        A normal of zeros bounds nothing.
        """
        forms = self.forms(normals, -offsets)
        length = np.linalg.norm(forms[..., :3], axis=-1, keepdims=True)
        result = forms / np.where(length > 0, length, 1)
        result[..., 3] = np.where(length[..., 0] > 0, -result[..., 3], 1.0)
        return np.asarray(result)

    def boxes(self, corners: Floats, radius: float | Floats = 0.0) -> Floats:
        """Return the boxes (k, 6) in voxels of corners (k, n, 3) in the world, grown by radius."""
        reach = np.asarray(radius)[..., None] / self.spacing
        places = self.places(corners)
        return np.concatenate([places.min(axis=1) - reach, places.max(axis=1) + reach], axis=1)


def _boxes(primitive: Primitive, frames: Floats) -> tuple[Floats, Floats]:
    box = primitive.box
    centre = frames[:, :, :3] @ np.array(box.centre) + frames[:, :, 3]
    half = np.abs(frames[:, :, :3]) @ (np.array(box.lengths) / 2)
    return centre - half, centre + half


def _chunks(frames: Floats, parts: int) -> Iterator[Floats]:
    size = max(1, CHUNK // max(1, parts))
    for first in range(0, len(frames), size):
        yield frames[first : first + size]


def _images(frames: Floats, points: Floats) -> Floats:
    """Return points (n, 3) carried by each frame, (k, n, 3), summed in one order for any k."""
    result = frames[:, None, :, 3] + points[:, 0, None] * frames[:, None, :, 0]
    for axis in (1, 2):
        result = result + points[:, axis, None] * frames[:, None, :, axis]
    return np.asarray(result)


def _solid(frames: Floats) -> Floats:
    """Return the frames that make bodies with volume."""
    size = np.linalg.norm(frames[:, :, :3], axis=(1, 2))
    kept = np.abs(np.linalg.det(frames[:, :, :3])) > SINGULAR * size**3
    return np.asarray(frames[kept])


def _paint_images(lattice: Lattice, primitive: Primitive, frames: Floats) -> None:
    frames = _solid(frames)
    if primitive.radius is not None:
        _paint_ellipsoids(lattice, primitive, frames)
    elif primitive.convex:
        for chunk in _chunks(frames, len(primitive.planes)):
            _paint_hulls(lattice, primitive, chunk)
    else:
        _paint_meshes(lattice, primitive, frames)


def _paint_hulls(lattice: Lattice, primitive: Primitive, frames: Floats) -> None:
    from porous.kernels.pieces import paint_polytopes

    inverse = np.linalg.inv(frames[:, :, :3])
    normals = np.einsum("fa,kab->kfb", primitive.planes[:, :3], inverse)
    offsets = primitive.planes[:, 3] + np.einsum("kfb,kb->kf", normals, frames[:, :, 3])
    boxes = lattice.boxes(_images(frames, primitive.points))
    paint_polytopes(lattice.window, lattice.planes(normals, offsets), boxes)


def _paint_ellipsoids(lattice: Lattice, primitive: Primitive, frames: Floats) -> None:
    from porous.kernels.pieces import paint_quadrics

    assert primitive.radius is not None
    rows = np.asarray(np.linalg.inv(frames[:, :, :3]) / primitive.radius, np.float64)
    centres = _images(frames, primitive.points)[:, 0]
    forms = np.zeros((len(frames), 4, 4))
    forms[:, :3] = lattice.forms(rows, -np.einsum("kab,kb->ka", rows, centres))
    forms[:, 3, 3] = 0.5
    reach = primitive.radius * np.linalg.norm(frames[:, :, :3], axis=2) / lattice.spacing
    places = lattice.places(centres)
    paint_quadrics(lattice.window, forms, np.concatenate([places - reach, places + reach], axis=1))


def _paint_meshes(lattice: Lattice, primitive: Primitive, frames: Floats) -> None:
    from porous.kernels.solids import paint_solids

    lower, upper = _boxes(primitive, frames)
    boxes = np.concatenate([lattice.places(lower), lattice.places(upper)], axis=1)
    solid = primitive.points, primitive.triangles
    paint_solids(lattice.window, lattice.frames(frames), solid, boxes)


def _paint_rims(lattice: Lattice, primitive: Primitive, frames: Floats, radius: float) -> None:
    """Paint what a ball adds to bodies: slabs over facets, cylinders along edges, balls."""
    if primitive.radius is not None:
        _paint_grown_balls(lattice, primitive, frames, radius)
        return
    parts = len(primitive.facets) + len(primitive.edges) + len(primitive.points)
    for chunk in _chunks(frames, parts):
        corners = _images(chunk, primitive.points)
        for facets in _facets_by_size(primitive):
            for some in _slices(facets, CHUNK // len(chunk)):
                _paint_slabs(lattice, corners[:, some].reshape(-1, some.shape[1], 3), radius)
        for some in _slices(primitive.edges, CHUNK // len(chunk)):
            paint_cylinders(lattice, corners[:, some].reshape(-1, 2, 3), radius)
        points = corners.reshape(-1, 3)
        paint_balls(lattice, points, np.full(len(points), radius))


def _facets_by_size(primitive: Primitive) -> list[Indices]:
    facets = sorted(primitive.facets, key=len)
    return [np.array(list(group)) for _, group in groupby(facets, key=len)]


def _slices(array: Indices, size: int) -> Iterator[Indices]:
    size = max(1, size)
    for first in range(0, len(array), size):
        yield array[first : first + size]


def _paint_slabs(lattice: Lattice, corners: Floats, radius: float) -> None:
    """Paint convex polygons (k, c, 3) thickened by ``radius`` to both sides."""
    from porous.kernels.pieces import paint_polytopes

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
    boxes = lattice.boxes(corners, radius)
    paint_polytopes(lattice.window, lattice.planes(normals, offsets), boxes)


def paint_cylinders(lattice: Lattice, ends: Floats, radius: float) -> None:
    """Paint cylinders with flat ends about segments (k, 2, 3)."""
    from porous.kernels.pieces import paint_quadrics

    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    keep = length > 1e-9 * radius
    ends, along, length = ends[keep], along[keep], length[keep]
    unit = along / length[:, None]
    helper = np.eye(3)[np.argmin(np.abs(unit), axis=1)]
    first = np.cross(unit, helper)
    first /= np.linalg.norm(first, axis=1)[:, None]
    rows = np.stack(
        [first / radius, np.cross(unit, first) / radius, 0 * unit, unit / length[:, None]], axis=1
    )
    forms = lattice.forms(rows, -np.einsum("kra,ka->kr", rows, ends[:, 0]))
    paint_quadrics(lattice.window, forms, lattice.boxes(ends, radius))


def paint_balls(lattice: Lattice, centres: Floats, radii: Floats) -> None:
    """Paint balls: centres (k, 3) and radii (k,); those without radius add nothing."""
    from porous.kernels.pieces import paint_quadrics

    keep = radii > 0
    centres, radii = centres[keep], radii[keep]
    rows = np.eye(3) / radii[:, None, None]
    forms = np.zeros((len(centres), 4, 4))
    forms[:, :3] = lattice.forms(rows, -centres / radii[:, None])
    forms[:, 3, 3] = 0.5
    paint_quadrics(lattice.window, forms, lattice.boxes(centres[:, None], radii))


def _paint_grown_balls(
    lattice: Lattice, primitive: Primitive, frames: Floats, radius: float
) -> None:
    """Paint the sums of ellipsoids, the images of a ball, and a ball."""
    from porous.kernels.pieces import paint_rounded_ellipsoids

    assert primitive.radius is not None
    centres = _images(frames, primitive.points)[:, 0]
    turn, half_axes, _ = np.linalg.svd(frames[:, :, :3] * primitive.radius)
    half_axes[half_axes < 1e-12 * radius] = 0.0
    round_ = np.ptp(half_axes, axis=1) <= 1e-12 * half_axes.max(axis=1)
    paint_balls(lattice, centres[round_], half_axes[round_, 0] + radius)
    rows = np.swapaxes(turn[~round_], 1, 2)
    forms = lattice.forms(rows, -np.einsum("kab,kb->ka", rows, centres[~round_]))
    reach = primitive.radius * np.linalg.norm(frames[~round_, :, :3], axis=2) + radius
    ends = centres[~round_, None] + np.stack([-reach, reach], axis=1)
    paint_rounded_ellipsoids(lattice.window, forms, half_axes[~round_], lattice.boxes(ends), radius)


def _cover_polyhedra(lattice: Lattice, primitive: Primitive, frames: Floats) -> None:
    small = primitive.convex and len(primitive.edges) <= MANY_EDGES
    hulls = primitive.points, primitive.facets, primitive.edges
    if small:
        for chunk in _chunks(frames, 4 * len(primitive.edges)):
            _cover_hulls(lattice, _images(chunk, hulls[0]), *_corners_of(*hulls[1:]))
        return
    _paint_images(lattice, primitive, frames)
    sides = np.array([[0, 1], [1, 2], [2, 0]])
    for chunk in _chunks(frames, 16 * len(primitive.triangles)):
        corners = _images(chunk, primitive.points)
        for some in _slices(primitive.triangles, CHUNK // (16 * len(chunk))):
            triangles = corners[:, some].reshape(-1, 3, 3)
            _cover_hulls(lattice, triangles, np.array([[0, 1, 2]]), sides)


def _corners_of(facets: tuple[Indices, ...], edges: Indices) -> tuple[Indices, Indices]:
    return np.array([facet[:3] for facet in facets]), edges


def _cover_hulls(lattice: Lattice, corners: Floats, facets: Indices, edges: Indices) -> None:
    """Mark the voxels that the hulls of corners (k, n, 3) touch, by their centres.

    A voxel meets a hull where its centre lies in the sum of the hull and the voxel, and that sum is
    bounded by the hull's facets, the voxel's faces and products of an edge of each.
    """
    from porous.kernels.pieces import paint_polytopes

    places = lattice.places(corners)
    a, b, c = (places[:, facets[:, i]] for i in range(3))
    along = places[:, edges[:, 1]] - places[:, edges[:, 0]]
    products = np.cross(along[:, :, None], np.eye(3)).reshape(len(places), -1, 3)
    normals = np.concatenate([np.cross(b - a, c - a), products], axis=1)
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    normals = np.where(length > 1e-12 * length.max(axis=1, keepdims=True), normals, 0.0)
    normals /= np.where(length > 0, length, 1)
    normals = np.concatenate([normals, -normals], axis=1)
    offsets = np.einsum("kma,kna->kmn", normals, places).max(axis=2)
    offsets += np.abs(normals).sum(axis=2) / 2
    offsets[~normals.any(axis=2)] = 1.0
    planes = np.concatenate([normals, offsets[..., None]], axis=2)
    boxes = np.concatenate([places.min(axis=1) - 0.5, places.max(axis=1) + 0.5], axis=1)
    paint_polytopes(lattice.window, planes, boxes)
