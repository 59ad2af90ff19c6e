"""Iterated function systems: affine maps of space, a primitive and how deep to go."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from porous.errors import MeshError, ModelError, nearest
from porous.models import digits as digit_sets
from porous.models import primitive as primitives
from porous.models.automaton import DEEPEST, Automaton, Cells, checked_map, frames, of_maps
from porous.models.contraction import check_contracts
from porous.models.digits import DigitSet
from porous.models.distinct import cut_set, distinct_cells
from porous.models.enclosure import Seeds, enclosing_balls, orbit_box
from porous.models.features import least_shrinkage, narrowest_run, thinnest
from porous.models.primitive import Primitive
from porous.models.reach import Reach, attractor_reach, cells_reach
from porous.models.sections import (
    BoxSection,
    DigitsSection,
    MapSection,
    MeshSection,
    Section,
    SizeSection,
)
from porous.values.units import check_unit
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import ArrayLike, NDArray

    from porous.models.lines import LineBody
    from porous.models.pieces import Pieces
    from porous.values import Box, Frame, Measure, Pattern, SurfaceMesh

KIND = "ifs"

MOST_MAPS = 100_000
"""A system of more maps is refused: each is looked at on its own."""

BOX_TOLERANCE = 1e-3
"""How far too wide the certified box of an orbit may be, as a part of its longest edge."""

NEAR = 16.0
"""Translations up to this length, and from its inverse on, are near the length of one."""

FUSED = 0.25
"""Radius of the balls that fuse contacts where none is given, as a part of the thinnest cell."""

Contacts = Literal["apart", "fuse", "shared"]


@dataclass(frozen=True, eq=False)
class CutSet(Value):
    """A level by size: cells are refined until they are smaller than ``size``, in the unit.

    The size of a cell is the longest edge of the primitive's box times the largest stretch of
    the cell's map: for cubes under similarities, the edge of the small cube.
    """

    size: float

    def __post_init__(self) -> None:
        if not 0 < self.size < math.inf:
            raise ModelError(f"level: got size = {self.size}; wanted a positive length")


Level = int | CutSet | Literal["limit"]


@dataclass(frozen=True, eq=False)
class IFS(Value):
    """A prefractal, or the attractor, of an automaton whose states are frames of space.

    The body is the union of the images of ``primitive`` in all cells of the level, or the
    attractor; grown by a ball of radius ``offset``. All lengths are in ``unit``.

    Parameters
    ----------
    automaton
        Every state with four independent controls, in the coordinates of the primitive.
    level
        A number, a ``CutSet``, or ``"limit"`` for the attractor itself.
    primitive
        What each cell is an image of, in reference coordinates of its state.
    domain
        The box that is sampled: that of all levels and the attractor, grown by ``offset`` and by
        the balls that fuse.
    bulk
        The box that porosity refers to.
    offset
        Radius of the ball added.
    contacts
        ``"apart"``; ``"fuse"`` adds balls where cells touch without sharing area; ``"shared"``
        says that cell meshes may share nodes there.
    contact_radius
        Of the balls that fuse.
    digits
        The digit set, where the maps are x ↦ (x + d) / N of a cube: exact counts are known then.
    unit
        Unit of length.

    Raises
    ------
    ModelError
        For negative lengths, levels that cannot be, fused contacts of an attractor.
    """

    automaton: Automaton
    level: Level
    primitive: Primitive
    domain: Box
    bulk: Box
    offset: float = 0.0
    contacts: Contacts = "apart"
    contact_radius: float = 0.0
    digits: DigitSet | None = None
    unit: str = "mm"

    def __post_init__(self) -> None:
        check_level(self.level)
        check_unit(self.unit)
        for name in ("offset", "contact_radius"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ModelError(f"{name}: got {getattr(self, name)}; wanted zero or a length")
        if self.contacts == "fuse" and self.level == "limit":
            raise ModelError('contacts: "fuse" joins cells; level = "limit" has none. Use offset')

    @property
    def plain_digits(self) -> DigitSet | None:
        """The digit set where the body is exactly its cells of a whole-numbered level."""
        grown = self.offset > 0 or (self.contacts == "fuse" and len(self.balls))
        return None if grown or not isinstance(self.level, int) else self.digits

    @cached_property
    def cells(self) -> tuple[Cells, ...]:
        """The cells of the level that differ, by state; see ``models.distinct``.

        Raises ``ModelError`` for ``"limit"``, ``MemoryLimitError`` where there are too many.
        """
        if self.level == "limit":
            raise ModelError('level: "limit" has no cells; wanted a number or { size = … }')
        if isinstance(self.level, CutSet):
            return cut_set(self.automaton, self.level.size, self._sizes)
        assert isinstance(self.level, int)
        return distinct_cells(self.automaton, self.level)[0]

    def frames(self) -> NDArray[np.float64]:
        """Return the affine map of each cell from the primitive to the world, (k, 3, 4)."""
        return self._frames

    @cached_property
    def _frames(self) -> NDArray[np.float64]:
        return frames(self.automaton, self.cells)

    @cached_property
    def balls(self) -> NDArray[np.float64]:
        """The balls that fuse contacts, (c, 4): centre and radius; none unless they are fused."""
        if self.contacts != "fuse":
            return np.zeros((0, 4))
        from porous.models.contacts import contact_points

        points = contact_points(self.primitive, self.frames())
        return np.column_stack([points, np.full(len(points), self.contact_radius)])

    @cached_property
    def pieces(self) -> Pieces:
        """The body of a level as a union of images; it remembers where they lie."""
        from porous.models.pieces import Pieces

        return Pieces(self.primitive, self.frames(), self.offset, self.balls)

    @cached_property
    def attractor_balls(self) -> NDArray[np.float64]:
        """A ball per state that holds its attractor, (s, 4)."""
        return enclosing_balls(self.automaton)

    def sample(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the mask of each voxel: bit r·C + c where the pattern's point lies in the body.

        Raises
        ------
        ModelError
            For an attractor without offset: no sample point lies in a set without volume.
        """
        from porous.models import rasterise

        if self.level == "limit":
            if not self.offset:
                raise ModelError(
                    "the attractor has no volume, so no sample point lies in it; "
                    'wanted an offset, sampling = "cover", or a level'
                )
            self._reach.check(frame, certain=True)
            return rasterise.sample_attractor(
                self.automaton, self.attractor_balls, frame, pattern, offset=self.offset
            )
        if self.plain_digits is not None:
            assert isinstance(self.level, int)
            return rasterise.sample_digits(
                self.plain_digits, self.level, self.primitive.box, frame, pattern
            )
        self._reach.check(frame, certain=False)
        return self.pieces.sample(frame, pattern)

    @cached_property
    def _reach(self) -> Reach:
        if self.level == "limit":
            return attractor_reach(self.automaton, self.attractor_balls, self.domain)
        drawn = [(self.primitive.box, state.inverse) for state in self.automaton.states]
        return cells_reach(self.automaton, [g.points for g in self.cells], self.domain, drawn)

    def check_membership(self) -> None:
        """Raise ``ModelError`` for attractors and grown bodies, known on lattices alone."""
        if self.level == "limit" or self.offset:
            got = "the attractor" if self.level == "limit" else f"an offset of {self.offset:g}"
            raise ModelError(
                f"model: got {got}, which cannot be asked point by point; wanted a level of cells "
                "without offset"
            )

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which points (n, 3), in ``unit``, lie in the body; see ``models.inside``."""
        self.check_membership()
        return self._inside(points)

    @cached_property
    def _inside(self) -> Callable[[NDArray[np.float64]], NDArray[np.bool_]]:
        from porous.models import inside

        if self.plain_digits is not None:
            assert isinstance(self.level, int)
            return inside.DigitCells(self.plain_digits, self.level, self.primitive.box).contains
        return inside.Images(self.primitive, self.frames(), self.balls).contains

    def line_body(self) -> LineBody | None:
        """Return the body for lines, None for an attractor; see ``models.lines``."""
        from porous.models.lines import lines_of_images

        return lines_of_images(self)

    def fill(
        self,
        frame: Frame,
        pattern: Pattern,
        progress: Callable[[int, int], None] | None = None,
    ) -> NDArray[np.uint8] | None:
        """Return the fill of every voxel where there is a short cut to it, else None."""
        from porous.models import rasterise

        if self.plain_digits is None:
            return None
        assert isinstance(self.level, int)
        return rasterise.fill_digits(
            self.plain_digits, self.level, self.primitive.box, frame, pattern, progress=progress
        )

    def cover(self, frame: Frame) -> tuple[NDArray[np.unsignedinteger[Any]], float]:
        """Return marks of every voxel that the body touches, and a Hausdorff bound."""
        from porous.models import rasterise

        self._reach.check(frame, certain=True)
        if self.level == "limit":
            return rasterise.cover_attractor(
                self.automaton, self.attractor_balls, frame, offset=self.offset
            )
        return self.pieces.cover(frame)

    @cached_property
    def is_cut(self) -> bool:
        """Whether the domain leaves out a part of the set."""
        reach = self.offset + (self.contact_radius if self.contacts == "fuse" else 0.0)
        whole = _natural_box(self.automaton, self.primitive).grown(reach)
        return not self.domain.contains(whole, tolerance=1e-9 * max(whole.lengths))

    def sampling_error(self, frame: Frame) -> float:
        """Return how far the boundary that is sampled may lie from the body's, in ``unit``.

        A grown attractor is drawn about a net of its points; other bodies are drawn as they are.
        """
        from porous.models.net import net_error

        return net_error(frame, self.offset) if self.level == "limit" else 0.0

    def boundary(self) -> SurfaceMesh:
        """Return the exact boundary.

        Raises ``ModelError`` where it is not polyhedral or its topology would not be certain.
        """
        from porous.models.boundary import exact_boundary

        return exact_boundary(
            self.automaton,
            self.primitive,
            self.level,
            offset=self.offset,
            contacts=self.contacts,
            contact_radius=self.contact_radius,
            domain=self.domain,
            unit=self.unit,
        )

    def exact(
        self, periodic: tuple[bool, bool, bool] = (False, False, False)
    ) -> tuple[Measure, ...]:
        """Return what is known in closed form; see ``models.exact``."""
        from porous.models.exact import exact_measures

        return exact_measures(self, periodic)

    def smallest_feature(self) -> float | None:
        """Return the thickness of the thinnest cell, or a lower bound on it, in ``unit``.

        min σ_min(A_w)·t₀ over the cells, t₀ the primitive's thickness, plus the offset on both
        sides. None for an attractor, which has details of every size.
        """
        if self.level == "limit":
            return None
        return self._shrinkage() * self.primitive.thickness + 2 * self.offset

    def smallest_pore(self) -> float | None:
        """Return the shortest void between two solids along an axis, in ``unit``.

        Of digit sets in vacuum, less the offset on both sides; None where there is no such void
        or it is not known.
        """
        if self.digits is None or not isinstance(self.level, int):
            return None
        run = narrowest_run(self.digits, self.level)
        if run is None:
            return None
        part = Fraction(run, self.digits.divisions**self.level)
        return max(0.0, float(part) * self.primitive.box.lengths[0] - 2 * self.offset)

    def finest_printable_level(self, feature: float) -> float | None:
        """Return the last level up to which no cell is thinner than ``feature``, in ``unit``.

        None where the level-0 body is thinner already; infinite where the offset alone is as
        thick.

        Raises ``ModelError`` for a feature that is not positive.
        """
        if not 0 < feature < math.inf:
            raise ModelError(f"feature: got {feature}; wanted a positive length")
        if 2 * self.offset >= feature:
            return math.inf
        needed = (feature - 2 * self.offset) / self.primitive.thickness * (1 - 1e-9)
        for level in range(DEEPEST):
            if least_shrinkage(self.automaton, level) < needed:
                return level - 1 if level else None
        return math.inf

    @property
    def feature_size(self) -> float | None:
        """The length that ``per_feature`` divides; None for an attractor."""
        return self.smallest_feature() or None

    def _shrinkage(self) -> float:
        if isinstance(self.level, int):
            if self.digits is not None:
                return float(self.digits.divisions) ** -self.level
            return least_shrinkage(self.automaton, self.level)
        return thinnest(self.frames())

    def _sizes(self, group: Cells) -> NDArray[np.float64]:
        placed = frames(self.automaton, [group._replace(place=np.arange(len(group.place)))])
        stretch = np.linalg.norm(placed[:, :, :3], 2, axis=(1, 2))
        return np.asarray(stretch * max(self.primitive.box.lengths))


def check_level(level: object) -> None:
    """Raise ``ModelError`` where a level is no whole number of 0 …, ``CutSet`` or "limit"."""
    if level == "limit" or isinstance(level, CutSet):
        return
    if not isinstance(level, int | np.integer) or isinstance(level, bool):
        raise ModelError(f'level: got {level!r}; wanted a whole number, CutSet(size) or "limit"')
    if not 0 <= level <= DEEPEST:
        raise ModelError(f"level: got {level}; wanted 0 … {DEEPEST}")


class IFSSection(Section):
    """The ``[model]`` table of an iterated function system."""

    kind: Literal["ifs"] = Field(default="ifs", description='"ifs"')
    level: Annotated[int, Field(ge=0, le=DEEPEST)] | SizeSection | Literal["limit"] = Field(
        default=2, description='a whole number, zero or more, { size = 0.2 } or "limit"'
    )
    primitive: str | MeshSection = Field(
        default="cube",
        description=f'one of {", ".join(primitives.NAMES)}, or {{ mesh = "part.stl" }}',
    )
    size: float = Field(default=1.0, gt=0, description="a length above zero, in unit")
    unit: Literal["nm", "um", "mm", "cm", "m", "in"] = Field(
        default="mm", description="nm, um, mm, cm, m or in"
    )
    offset: float = Field(default=0.0, ge=0, description="a length, zero or more, in unit")
    contacts: Contacts = Field(default="apart", description='"apart", "fuse" or "shared"')
    contact_radius: float | None = Field(
        default=None,
        gt=0,
        description=f"a length above zero, in unit; {FUSED:g} of the thinnest cell if left out",
    )
    digits: DigitsSection | None = Field(
        default=None, description="{ divisions = N, keep = [[i, j, k], …] or a name }"
    )
    maps: Annotated[tuple[MapSection, ...], Field(strict=False, min_length=1)] | None = Field(
        default=None, description="tables of matrix and translation, at least one"
    )
    domain: BoxSection | None = Field(
        default=None, description="{ lower = [x, y, z], upper = [x, y, z] } in model units"
    )
    bulk: BoxSection | None = Field(
        default=None, description="{ lower = [x, y, z], upper = [x, y, z] } in model units"
    )

    @model_validator(mode="after")
    def _one_system(self) -> Self:
        if (self.digits is None) == (self.maps is None):
            raise ValueError(
                f"got {'both' if self.digits else 'neither'} of digits and maps; wanted one"
            )
        if isinstance(self.primitive, str) and self.primitive not in primitives.NAMES:
            near = nearest(self.primitive, primitives.NAMES)
            raise ValueError(f"no primitive {self.primitive!r}{near}")
        return self


def build(section: IFSSection, folder: Path) -> IFS:
    """Return the model of a recipe's section; meshes lie relative to ``folder``.

    Raises
    ------
    ModelError
        Where there is no such model: maps that do not contract together (names the word), a
        singular map (names it) of a level, a primitive that is no closed solid.
    """
    level: Any = section.level
    return _built(
        section.digits.digits() if section.digits else None,
        [(m.matrix, m.translation) for m in section.maps or ()],
        level=CutSet(level.size) if isinstance(level, SizeSection) else level,
        primitive=_primitive(section.primitive, folder),
        domain=section.domain.box() if section.domain else None,
        bulk=section.bulk.box() if section.bulk else None,
        **section.model_dump(include={"size", "unit", "offset", "contacts", "contact_radius"}),
    )


def ifs(
    maps: Iterable[tuple[ArrayLike, ArrayLike]] | Automaton | DigitSet,
    *,
    level: Level = 2,
    primitive: str | Primitive | SurfaceMesh = "cube",
    size: float | None = None,
    unit: str = "mm",
    offset: float = 0.0,
    contacts: Contacts = "apart",
    contact_radius: float | None = None,
    domain: Box | None = None,
    bulk: Box | None = None,
) -> IFS:
    """Return the model of affine maps of space.

    Parameters
    ----------
    maps
        Pairs of a matrix (3, 3) and a translation (3,); or an automaton whose states are frames of
        space; or a digit set.
    level
        A number, ``CutSet(size)``, or ``"limit"`` for the attractor.
    primitive
        A name, a primitive, or a closed surface in model units.
    size
        Length of the domain's longest edge, in ``unit``; model units are units where not given.
    unit
        nm, um, mm, cm, m or in.
    offset
        Radius of the ball added, in ``unit``.
    contacts
        ``"apart"``, ``"fuse"`` or ``"shared"``.
    contact_radius
        Of the balls that fuse, in ``unit``; ``FUSED`` of the thinnest cell where not given.
    domain, bulk
        Boxes in model units, in place of those that follow from the maps and the primitive.

    Raises
    ------
    ModelError
        As ``build``.
    """
    system = maps if isinstance(maps, Automaton | DigitSet) else None
    pairs: Any = () if system is not None else maps
    return _built(
        system,
        list(islice(pairs, MOST_MAPS + 1)),
        level=level,
        primitive=_primitive(primitive, None),
        size=size,
        unit=unit,
        offset=offset,
        contacts=contacts,
        contact_radius=contact_radius,
        domain=domain,
        bulk=bulk,
    )


def _primitive(given: object, folder: Path | None) -> Primitive:
    if isinstance(given, Primitive):
        return given
    if isinstance(given, str):
        return primitives.named(given)
    if isinstance(given, MeshSection):
        from porous.formats import read

        given = read((folder or Path()) / given.mesh)
    from porous.values import SurfaceMesh

    if not isinstance(given, SurfaceMesh):
        raise MeshError(f"primitive: got a {type(given).__name__}; wanted a closed surface")
    solid = primitives.of_surface(given)
    if not solid.convex:
        from porous.kernels.crossings import check_uncrossed

        check_uncrossed(solid.surface())
    return solid


def _system(
    given: DigitSet | Automaton | None, maps: list[tuple[ArrayLike, ArrayLike]], name: str
) -> tuple[Automaton, DigitSet | None]:
    """Return the automaton, and the digit set where cells are the sub-cubes of a cube."""
    amount = len(given.keep) if isinstance(given, DigitSet) else len(maps)
    if amount > MOST_MAPS:
        raise ModelError(f"maps: wanted at most {MOST_MAPS}, got more")
    if isinstance(given, Automaton):
        return given, None
    if isinstance(given, DigitSet):
        return of_maps(given.maps), given if name == "cube" else None
    checked = [checked_map(index, *pair) for index, pair in enumerate(maps)]
    found = digit_sets.detect(checked) if checked and name == "cube" else None
    return of_maps(checked, size=_reach(checked)), found


def _reach(maps: list[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> float:
    """Return a power of two about as large as the longest translation: there rounding is least.

    One where that is nearly as good: such maps are the automaton of them that anyone would make.
    """
    longest = max((float(np.abs(shift).max()) for _, shift in maps), default=0.0)
    return 2.0 ** math.ceil(math.log2(longest)) if longest > NEAR or 0 < longest < 1 / NEAR else 1.0


def _built(
    given: DigitSet | Automaton | None,
    maps: list[tuple[ArrayLike, ArrayLike]],
    *,
    level: Level,
    primitive: Primitive,
    size: float | None,
    unit: str,
    offset: float,
    contacts: Contacts,
    contact_radius: float | None,
    domain: Box | None,
    bulk: Box | None,
) -> IFS:
    automaton, digits = _system(given, maps, primitive.name)
    check_level(level)
    if level != "limit":
        _check_regular(automaton)
    check_contracts(automaton)
    natural = _natural_box(automaton, primitive)
    sampled = domain or natural
    scale = 1.0 if size is None else float(size) / max(sampled.lengths)
    scaled, solid = automaton.scaled(scale), primitive.scaled(scale)
    model = IFS(
        scaled,
        level,
        solid,
        domain=sampled.scaled(scale),
        bulk=(bulk or sampled).scaled(scale),
        offset=float(offset),
        contacts=contacts,
        contact_radius=contact_radius or 0.0,
        digits=digits,
        unit=unit,
    )
    return _with_radius(model, grown=domain is None)


def _with_radius(model: IFS, *, grown: bool) -> IFS:
    """Return the model with its contact radius settled and its domain grown by the offset.

    Balls at contacts do not grow it: they depend on the level, which the domain does not.
    """
    radius = model.contact_radius
    if model.contacts == "fuse" and not radius:
        radius = FUSED * (model.smallest_feature() or 0.0)
    domain = model.domain.grown(model.offset) if grown and model.offset else model.domain
    return replace(model, contact_radius=radius, domain=domain)


def _natural_box(automaton: Automaton, primitive: Primitive) -> Box:
    seeds = Seeds(primitive.points, primitive.radius or 0.0)
    return orbit_box(automaton, seeds, tolerance=BOX_TOLERANCE * max(seeds.box.lengths))


def _check_regular(automaton: Automaton) -> None:
    scale = np.linalg.norm(automaton.maps[:, :, :3], 2, axis=(1, 2)) ** 3
    flat = np.flatnonzero(np.abs(np.linalg.det(automaton.maps[:, :, :3])) <= 1e-14 * scale)
    if len(flat):
        raise ModelError(
            f"maps[{flat[0]}]: got a singular matrix, which flattens the primitive; wanted one "
            'with an inverse, or level = "limit" with an offset'
        )
