"""What the cells of a state are drawn as: solids, balls, beams and plates on their controls.

A drawing knows nothing of automata but the number of a cell's controls; every family whose cells
have control points of their own can be drawn with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Annotated, Literal, Protocol, Self

import numpy as np
from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from porous.errors import ModelError, nearest
from porous.models import primitive as primitives
from porous.models.automaton import product
from porous.models.pieces import Pieces
from porous.models.primitive import Primitive
from porous.models.rational import positions
from porous.models.sections import Section
from porous.models.simplices import HEXA_FACES, Simplices, hexa_tets, octa_tets
from porous.values.value import Value, frozen, frozen_whole

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from porous.models.automaton import Cells, State
    from porous.values import Frame, Pattern

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

NOTHING, CELL = "none", "cell"
NAMES = (NOTHING, CELL, *primitives.NAMES)
"""What a state may be drawn as by name."""

LATTICE = tuple(9 * a + 3 * b + c for a in (0, 2) for b in (0, 2) for c in (0, 2))
CORNERS: dict[int, tuple[int, ...]] = {
    **{amount: tuple(range(amount)) for amount in (2, 3, 4, 6, 8)},
    27: LATTICE,
}
"""The controls that are corners of a cell, by their number."""

SIDES: dict[int, tuple[tuple[int, int], ...]] = {
    2: ((0, 1),),
    3: ((0, 1), (1, 2), (2, 0)),
    4: tuple(combinations(range(4), 2)),
    6: tuple(pair for pair in combinations(range(6), 2) if pair[0] ^ 1 != pair[1]),
    8: tuple((i, i | bit) for i in range(8) for bit in (4, 2, 1) if not i & bit),
}
"""The edges of a cell by the number of its corners: the segment, the triangle, the solid."""

FACES: dict[int, NDArray[np.int64]] = {
    6: np.array([(i, j, k) for i in (0, 1) for j in (2, 3) for k in (4, 5)]),
    8: HEXA_FACES,
}
"""The faces of octahedra and hexahedra, their corners in the order of a loop."""

SPLITS: dict[int, Callable[[Floats], Floats]] = {4: np.asarray, 6: octa_tets, 8: hexa_tets}
"""Tetrahedra (n, 4, 3) that fill solids, by their number of corners (k, c, 3)."""


class Part(Protocol):
    """A part of a body."""

    def sample(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the mask of each voxel."""

    def cover(self, frame: Frame) -> tuple[NDArray[np.uint64], float]:
        """Return marks of every voxel that the part touches, and a Hausdorff bound."""


@dataclass(frozen=True, eq=False)
class Body(Value):
    """The union of parts; of none, the empty set."""

    parts: tuple[Part, ...]

    def sample(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the mask of each voxel: bit r·C + c where the pattern's point lies in a part."""
        masks = np.zeros(frame.shape, np.uint64)
        for part in self.parts:
            masks |= part.sample(frame, pattern)
        return masks

    def cover(self, frame: Frame) -> tuple[NDArray[np.uint64], float]:
        """Return marks of every voxel that a part touches, and a Hausdorff bound."""
        marks, bound = np.zeros(frame.shape, np.uint64), 0.0
        for part in self.parts:
            found, error = part.cover(frame)
            marks |= found
            bound = max(bound, error)
        return marks, bound


@dataclass(frozen=True, eq=False)
class Drawing(Value):
    """What a cell is drawn as, on points that are mixed from its controls.

    Parameters
    ----------
    mix
        float64, shape (m, p): column j says how point j is mixed from the m controls.
    primitive
        A solid in the state's reference coordinates, carried along by four independent controls.
    inverse
        float64, shape (4, 4): the controls' weights of homogeneous reference coordinates, see
        ``State.inverse``; wanted with a primitive only.
    solid
        Points that are the corners of a solid: four of a tetrahedron, six of an octahedron in
        opposite pairs, eight of a hexahedron in the order 4a + 2b + c.
    balls, beams, plates
        int64, shapes (b,), (e, 2) and (f, 3): points, segments and triangles of points, swept by
        a ball.
    radius
        Of balls and beams, in ``unit``, by the level at which a cell is born; the last holds below.
    thickness
        Of plates, likewise: twice the radius of the ball that sweeps them.

    Raises
    ------
    ModelError
        For points that are not there, swept parts without their lengths, lengths not positive.
    """

    mix: Floats
    primitive: Primitive | None = None
    inverse: Floats | None = None
    solid: tuple[int, ...] = ()
    balls: Indices = ()  # type: ignore[assignment]
    beams: Indices = ()  # type: ignore[assignment]
    plates: Indices = ()  # type: ignore[assignment]
    radius: tuple[float, ...] = ()
    thickness: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        self._set("mix", frozen(self.mix, np.float64))
        if self.inverse is not None:
            self._set("inverse", frozen(self.inverse, np.float64))
        for name, shape in (("balls", (-1,)), ("beams", (-1, 2)), ("plates", (-1, 3))):
            index = frozen_whole(getattr(self, name), np.int64, f"draw.{name}", ModelError)
            self._set(name, index.reshape(shape))
            _check_points(name, index, self.mix.shape[1])
        for name, swept in (("radius", (self.balls, self.beams)), ("thickness", (self.plates,))):
            self._set(name, tuple(map(float, getattr(self, name))))
            _check_lengths(name, getattr(self, name), needed=any(map(len, swept)))

    @property
    def controls(self) -> int:
        """Number of controls of the cells."""
        return len(self.mix)

    @property
    def is_empty(self) -> bool:
        """Whether nothing is drawn."""
        parts = (self.solid, self.balls, self.beams, self.plates)
        return self.primitive is None and not any(map(len, parts))

    @property
    def reach(self) -> float:
        """How far the body may reach beyond the hull of its corners, in ``unit``."""
        return max((*self.radius, *(t / 2 for t in self.thickness)), default=0.0)

    @property
    def simplices(self) -> int:
        """The most simplices that a cell is drawn with."""
        solids = {0: 0, 4: 1, 6: 4, 8: 24}[len(self.solid)]
        return solids + len(self.balls) + len(self.beams) + len(self.plates)

    @property
    def corners(self) -> Floats:
        """Weights (m, n) of points whose hull, grown by ``reach``, holds what is drawn."""
        parts = (np.array(self.solid, np.int64), self.balls, self.beams, self.plates)
        used = np.unique(np.concatenate([part.ravel() for part in parts]))
        columns = [self.mix[:, used]]
        if self.primitive is not None:
            assert self.inverse is not None
            round_ = self.primitive.radius is not None
            points = np.array(self.primitive.box.corners) if round_ else self.primitive.points
            columns.append(self.inverse @ np.vstack([points.T, np.ones(len(points))]))
        return np.hstack(columns)

    def frames(self, points: Floats) -> Floats:
        """Return the maps (k, 3, 4) that carry the primitive to cells with controls (k, 3, m)."""
        assert self.inverse is not None
        return product(points, self.inverse)

    def thinnest(self, points: Floats, births: Indices) -> float:
        """Return the least thickness of what is drawn in cells, or a lower bound; infinite if none.

        σ_min of a cell's map times the primitive's thickness; the width of a tetrahedron; twice
        the least distance of another solid's middle from its faces; diameters and thicknesses.
        """
        found = [math.inf]
        if self.primitive is not None:
            linear = self.frames(points)[:, :, :3]
            least = np.linalg.svd(linear, compute_uv=False)[:, 2].min()
            found.append(float(least) * self.primitive.thickness)
        if len(self.balls) or len(self.beams):
            found.append(2 * float(_at_birth(self.radius, births).min()))
        if len(self.plates):
            found.append(float(_at_birth(self.thickness, births).min()))
        if self.solid:
            corners = _mixed(self, points)[:, list(self.solid)]
            width = _widths if len(self.solid) == 4 else _clearances
            found.append(float(width(corners).min()))
        return min(found)


def nothing(controls: int) -> Drawing:
    """Return the drawing of nothing."""
    return Drawing(np.eye(controls))


def cell(controls: int) -> Drawing:
    """Return the drawing of the solid on all of a cell's controls.

    Four controls are a tetrahedron, six an octahedron in opposite pairs, eight a hexahedron in the
    order 4a + 2b + c of its digits, 27 the hexahedron of the corners of a lattice 9a + 3b + c.

    Raises
    ------
    ModelError
        For another number of controls.
    """
    corners = CORNERS.get(controls, ())
    if len(corners) not in SPLITS:
        raise ModelError(
            f'draw: "cell" is a solid on 4, 6, 8 or 27 controls; this state has {controls}'
        )
    return Drawing(np.eye(controls), solid=corners)


def sticks(
    controls: int,
    *,
    balls: Iterable[int] | Literal["all"] = (),
    beams: Iterable[Sequence[int]] | Literal["edges"] = (),
    plates: Iterable[Sequence[int]] = (),
    radius: float | Sequence[float] | None = None,
    thickness: float | Sequence[float] | None = None,
) -> Drawing:
    """Return the drawing of balls, beams and plates on a cell's controls.

    Parameters
    ----------
    controls
        Number of controls of the cells.
    balls
        Indices of controls, or ``"all"``.
    beams
        Pairs of controls, or ``"edges"``: of a segment, a triangle or the solid of ``cell``.
    plates
        Three controls each, or four in the order of a loop: fanned about their mean.
    radius, thickness
        A length, or one per level at which a cell is born; the last holds below.

    Raises
    ------
    ModelError
        As ``Drawing``, and for a state whose edges are not known.
    """
    mix, triangles = _fanned([list(map(int, plate)) for plate in plates], controls)
    return Drawing(
        mix,
        balls=np.arange(controls) if balls == "all" else _array(balls),
        beams=_edges(controls) if beams == "edges" else _array(beams),
        plates=triangles,
        radius=_several(radius),
        thickness=_several(thickness),
    )


def image(primitive: str | Primitive, state: State) -> Drawing:
    """Return the drawing of a primitive, which lies in a state's reference coordinates.

    Raises
    ------
    ModelError
        For an unknown name, or a state without four independent controls.
    """
    body = primitive if isinstance(primitive, Primitive) else primitives.named(primitive)
    if state.inverse is None:
        raise ModelError(
            f'draw: "{body.name}" is carried along by four independent controls, which this state '
            'does not have; wanted "cell", { balls = …, beams = …, plates = … } or "none"'
        )
    return Drawing(np.eye(state.size), primitive=body, inverse=state.inverse)


def drawn_as(given: str | Primitive | SticksSection | Drawing, state: State) -> Drawing:
    """Return the drawing that a recipe or a caller asks for, of cells of a state.

    Raises
    ------
    ModelError
        For an unknown name (with the nearest), or what cannot be drawn on the state's controls.
    """
    if isinstance(given, SticksSection):
        return sticks(state.size, **given.model_dump())
    if isinstance(given, Drawing):
        if given.controls != state.size:
            raise ModelError(
                f"draw: got a drawing on {given.controls} controls; this state has {state.size}"
            )
        return given
    if isinstance(given, str) and given not in NAMES:
        raise ModelError(f"draw: no drawing {given!r}{nearest(given, NAMES)}")
    if given == NOTHING:
        return nothing(state.size)
    return cell(state.size) if given == CELL else image(given, state)


def body(
    drawings: Sequence[Drawing],
    groups: Iterable[Cells],
    births: Indices,
    *,
    offset: float = 0.0,
) -> Body:
    """Return the union of what cells are drawn as, grown by a ball.

    Parameters
    ----------
    drawings
        What the cells of each state are drawn as.
    groups
        The cells by state.
    births
        The level at which each cell was born, by its place among all.
    offset
        Radius of the ball added (Minkowski sum).
    """
    parts: list[Part] = []
    for group in groups:
        drawing = drawings[group.state]
        if drawing.primitive is not None:
            parts.append(Pieces(drawing.primitive, drawing.frames(group.points), offset))
        if drawing.simplices:
            swept = _simplices(drawing, group.points, births[group.place])
            parts.append(swept.grown(offset) if offset else swept)
    return Body(tuple(parts))


def _simplices(drawing: Drawing, points: Floats, births: Indices) -> Simplices:
    mixed = _mixed(drawing, points)
    solids = mixed[:, list(drawing.solid)]
    radii, halves = _at_birth(drawing.radius, births), _at_birth(drawing.thickness, births) / 2
    centres, repeated = _placed(mixed, drawing.balls[:, None], radii)
    beams, beam_radii = _placed(mixed, drawing.beams, radii)
    plates, plate_radii = _placed(mixed, drawing.plates, halves)
    return Simplices(
        tets=SPLITS[len(drawing.solid)](solids) if drawing.solid else np.zeros((0, 4, 3)),
        balls=np.column_stack([centres[:, 0], repeated]),
        capsules=beams,
        capsule_radii=beam_radii,
        plates=plates,
        plate_radii=plate_radii,
    )


def _mixed(drawing: Drawing, points: Floats) -> Floats:
    """Return the points (k, p, 3) of cells with controls (k, 3 or 4, m)."""
    return np.swapaxes(positions(product(points, drawing.mix)), 1, 2)


def _listed(value: object) -> object:
    return (value,) if isinstance(value, int | float) else value


Index = Annotated[int, Field(ge=0)]
Lengths = Annotated[
    tuple[Annotated[float, Field(gt=0)], ...],
    BeforeValidator(_listed),
    Field(strict=False, min_length=1),
]


class SticksSection(Section):
    """Balls, beams and plates on a cell's controls, which are counted from 0."""

    balls: Literal["all"] | Annotated[tuple[Index, ...], Field(strict=False)] = Field(
        default=(), description='"all" or a list of controls, counted from 0'
    )
    beams: (
        Literal["edges"]
        | Annotated[
            tuple[Annotated[tuple[Index, Index], Field(strict=False)], ...], Field(strict=False)
        ]
    ) = Field(default=(), description='"edges" or a list of pairs of controls, counted from 0')
    plates: Annotated[
        tuple[Annotated[tuple[Index, ...], Field(strict=False, min_length=3, max_length=4)], ...],
        Field(strict=False),
    ] = Field(default=(), description="a list of three or four controls each, counted from 0")
    radius: Lengths | None = Field(
        default=None,
        description="a length above zero, in unit, or a list of them by the level of birth",
    )
    thickness: Lengths | None = Field(
        default=None,
        description="a length above zero, in unit, or a list of them by the level of birth",
    )

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if not (self.balls or self.beams or self.plates):
            raise ValueError('got no balls, beams or plates; wanted some, or draw = "none"')
        for name, needed in (
            ("radius", bool(self.balls or self.beams)),
            ("thickness", bool(self.plates)),
        ):
            if needed != (getattr(self, name) is not None):
                what = "balls and beams" if name == "radius" else "plates"
                raise ValueError(
                    f"got {'no ' if needed else ''}{name}; wanted it with {what} and only then"
                )
        return self


def _kind(value: object) -> str:
    return "name" if isinstance(value, str) else "sticks"


Draw = Annotated[
    Annotated[str, Tag("name")] | Annotated[SticksSection, Tag("sticks")], Discriminator(_kind)
]
"""What a recipe says of a state's drawing."""


def _check_points(name: str, index: Indices, amount: int) -> None:
    bad = index[(index < 0) | (index >= amount)]
    if len(bad):
        raise ModelError(
            f"draw.{name}: got control {bad[0]}; this state has {amount}, 0 … {amount - 1}"
        )


def _check_lengths(name: str, lengths: tuple[float, ...], *, needed: bool) -> None:
    if needed and not lengths:
        raise ModelError(f"draw.{name}: got none; wanted a length, or one per level")
    if not all(0 < length < math.inf for length in lengths):
        raise ModelError(f"draw.{name}: got {list(lengths)}; wanted positive lengths")


def _several(lengths: float | Sequence[float] | None) -> tuple[float, ...]:
    if lengths is None:
        return ()
    return (float(lengths),) if isinstance(lengths, int | float) else tuple(lengths)


def _at_birth(lengths: tuple[float, ...], births: Indices) -> Floats:
    """Return the length that holds for cells born at these levels; zeros where there is none."""
    if not lengths:
        return np.zeros(len(births))
    return np.array(lengths)[np.minimum(births, len(lengths) - 1)]


def _placed(points: Floats, index: Indices, radii: Floats) -> tuple[Floats, Floats]:
    """Return corners (k·n, c, 3) of n simplices in each of k cells, and their radii."""
    corners = points[:, index].reshape(-1, index.shape[1], 3)
    return corners, np.repeat(radii, len(index))


def _array(rows: Iterable[object]) -> Indices:
    return np.array(list(rows), np.int64)


def _edges(controls: int) -> Indices:
    corners = CORNERS.get(controls, ())
    if not corners:
        raise ModelError(
            f'draw.beams: "edges" are known of 2, 3, 4, 6, 8 and 27 controls; this state has '
            f"{controls}; wanted a list of pairs"
        )
    return np.asarray(np.array(corners, np.int64)[np.array(SIDES[len(corners)])])


def _fanned(plates: list[list[int]], controls: int) -> tuple[Floats, Indices]:
    """Return weights of the controls and of the means of plates of four, and triangles on them."""
    columns, triangles = [np.eye(controls)], []
    for plate in plates:
        if len(plate) not in (3, 4):
            raise ModelError(f"draw.plates: got {plate}; wanted three controls, or four")
        _check_points("plates", np.array(plate), controls)
        if len(plate) == 3:
            triangles.append(plate)
            continue
        middle = controls + len(columns) - 1
        columns.append(columns[0][:, plate].mean(axis=1, keepdims=True))
        triangles += [[a, b, middle] for a, b in zip(plate, plate[1:] + plate[:1], strict=True)]
    return np.hstack(columns), np.array(triangles, np.int64).reshape(-1, 3)


def _widths(corners: Floats) -> Floats:
    """Return the widths of tetrahedra (k, 4, 3): of heights and distances of opposite edges."""
    a, b, c = (corners[:, i] - corners[:, 3] for i in range(3))
    volume = np.abs(np.einsum("ki,ki->k", a, np.cross(b, c)))
    areas = [np.cross(a, b), np.cross(b, c), np.cross(c, a), np.cross(a - b, a - c)]
    pairs = [np.cross(a, b - c), np.cross(b, c - a), np.cross(c, a - b)]
    largest = np.max([np.linalg.norm(area, axis=1) for area in areas + pairs], axis=0)
    return np.asarray(volume / np.maximum(largest, 1e-300))


def _clearances(corners: Floats) -> Floats:
    """Return twice the least distance of each solid's middle from the fans of its faces."""
    middle = corners.mean(axis=1)
    loops = corners[:, FACES[corners.shape[1]]]
    means = loops.mean(axis=2, keepdims=True)
    normals = np.cross(loops - means, np.roll(loops, -1, axis=2) - means)
    normals /= np.maximum(np.linalg.norm(normals, axis=3, keepdims=True), 1e-300)
    heights = np.einsum("kfci,kfci->kfc", normals, means - middle[:, None, None])
    return np.asarray(2 * np.abs(heights).min(axis=(1, 2)))
