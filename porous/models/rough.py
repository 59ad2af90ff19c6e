"""Bodies with rough faces: a block, or another model, cut along skins of a prescribed dimension.

The box is the stock that a body is cut from: no peak of a rough face reaches beyond it, and the
straight border of the face lies as far below the box's side as its highest peak may lie above the
border. What is left of the box when all rough sides are moved in so far is the core; each skin is a
relief (``models.relief``) over a side of the core, on whose edges it is zero, so that faces meet
along straight edges whatever their roughness. A point belongs to the body where it is beyond the
skin of no face, and in the other model, where there is one.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from porous.errors import ModelError, nearest
from porous.models.bcifs_section import BCIFSSection
from porous.models.cifs_section import CIFSSection
from porous.models.ifs import IFSSection
from porous.models.model import HasDoubts, HasMembership, Model
from porous.models.relief import MOST_BUMPS, Relief
from porous.models.sections import Section
from porous.models.tree import TreeSection
from porous.models.warp import WarpSection
from porous.values import Box, Measure
from porous.values.box import SIDES
from porous.values.units import check_unit
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from porous.values import Frame, Pattern

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

KIND = "rough"

METHOD = "closed form"

FINER = 1e-3
"""Heights that are left out of a sum of levels, as a part of a voxel's edge."""


@dataclass(frozen=True, eq=False)
class Skin(Value):
    """What a face of a box is to be like.

    Parameters
    ----------
    face
        XMIN, XMAX, YMIN, YMAX, ZMIN or ZMAX.
    dimension
        Box dimension of the face, between 2 and 3.
    amplitude
        Its root-mean-square height Sq about its mean plane, in the body's unit.
    bumps
        How many of the largest bumps lie along the face's shorter edge; as many of the same
        length, about, along the other.
    seed
        Draws which bumps point outwards: two of each four. Faces of one seed differ.
    outwards
        Whether all bumps point outwards instead, as a Takagi–Landsberg surface's do: then there are
        no pits below the face's border.

    Raises
    ------
    ModelError
        For an unknown face and numbers outside of their bounds.
    """

    face: str
    dimension: float
    amplitude: float
    bumps: int = 4
    seed: int = 0
    outwards: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.face, str):
            raise ModelError(
                f"face: got {self.face!r:.80}; wanted one of {', '.join(SIDES)}: each face has a "
                "skin of its own"
            )
        if self.face not in SIDES:
            raise ModelError(f"faces: got {self.face!r}{nearest(self.face, SIDES)}")
        if self.seed < 0:
            raise ModelError(f"seed: got {self.seed}; wanted a whole number, zero or more")
        if not 1 <= self.bumps <= MOST_BUMPS:
            raise ModelError(f"bumps: got {self.bumps!r:.40}; wanted 1 … {MOST_BUMPS}")
        self.relief((1.0, 1.0))

    def relief(self, edges: tuple[float, float]) -> Relief:
        """Return the heights over a rectangle of these edges."""
        ratio = max(edges) / min(edges)
        if self.bumps * ratio > MOST_BUMPS + 0.5:
            raise ModelError(
                f"bumps: got {self.bumps} along the shorter edge, {self.bumps * ratio:.6g} along "
                f"the longer; wanted 1 … {MOST_BUMPS} along each edge"
            )
        a, b = (max(1, round(self.bumps * edge / min(edges))) for edge in edges)
        drawn = len(SIDES) * self.seed + SIDES.index(self.face)
        return Relief(self.dimension, self.amplitude, (a, b), None if self.outwards else drawn)


@dataclass(frozen=True, eq=False)
class Rough(Value):
    """A box with rough faces, or what of a model lies in it.

    Parameters
    ----------
    box
        What no peak reaches beyond; it is the domain and the bulk.
    skins
        One per rough face.
    unit
        Unit of length.
    model
        What is cut, of the same domain; the box itself is where not given.

    Raises
    ------
    ModelError
        For a face that is there twice, and skins that leave nothing of the box between them.
    """

    box: Box
    skins: tuple[Skin, ...]
    unit: str = "mm"
    model: Model | None = None

    def __post_init__(self) -> None:
        check_unit(self.unit)
        self._set("skins", tuple(self.skins))
        faces = [skin.face for skin in self.skins]
        for face in faces:
            if faces.count(face) > 1:
                raise ModelError(f"skins: {face} is there twice; wanted each face once")
        for axis, name in enumerate("xyz"):
            sides = SIDES[2 * axis : 2 * axis + 2]
            deep = sum(self._reach(face)[1] - self._reach(face)[0] for face in sides)
            if not deep < self.box.lengths[axis]:
                raise ModelError(
                    f"amplitude: {_needing(sides, faces)} {deep:.6g} {self.unit} from peak to pit; "
                    f"wanted less than {self.box.lengths[axis]:.6g}, what the box has along {name}"
                )

    @property
    def domain(self) -> Box:
        """The box that is sampled."""
        return self.box

    @property
    def bulk(self) -> Box:
        """The same box."""
        return self.box

    @property
    def is_cut(self) -> bool:
        """Whether the domain leaves out a part of the model within."""
        return isinstance(self.model, HasDoubts) and self.model.is_cut

    @cached_property
    def reliefs(self) -> Mapping[str, Relief]:
        """The heights of the rough faces."""
        across = {skin.face: _others(_axis(skin.face)) for skin in self.skins}
        lengths = self.box.lengths
        return MappingProxyType(
            {s.face: s.relief(tuple(lengths[a] for a in across[s.face])) for s in self.skins}  # type: ignore[arg-type]
        )

    @cached_property
    def core(self) -> Box:
        """The box whose sides the skins are heights over."""
        inset = [self._reach(face)[1] for face in SIDES]
        lower = [a + by for a, by in zip(self.box.lower, inset[0::2], strict=True)]
        upper = [a - by for a, by in zip(self.box.upper, inset[1::2], strict=True)]
        return Box(tuple(lower), tuple(upper))  # type: ignore[arg-type]

    @cached_property
    def rough_faces(self) -> Mapping[str, Box]:
        """A box about each skin that lies bare, within what no pit of another face may reach.

        There are none where another model is cut, for that may have pores.
        """
        if self.model is not None:
            return MappingProxyType({})
        return MappingProxyType({face: self._about(face) for face in self.reliefs})

    def _about(self, face: str) -> Box:
        axis = _axis(face)
        pits = [self._reach(side)[0] for side in SIDES]
        lower = [a - pit for a, pit in zip(self.core.lower, pits[0::2], strict=True)]
        upper = [a + pit for a, pit in zip(self.core.upper, pits[1::2], strict=True)]
        lower[axis], upper[axis] = sorted(
            self._plane(face) + _out(face) * reach for reach in self._reach(face)
        )
        return Box(tuple(lower), tuple(upper))  # type: ignore[arg-type]

    def _reach(self, face: str) -> tuple[float, float]:
        """Return bounds on the heights of a face, (0, 0) of a flat one."""
        relief = self.reliefs.get(face)
        return (0.0, 0.0) if relief is None else (relief.lowest, relief.highest)

    def sample(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the mask of each voxel: bit r·C + c where the pattern's point is solid."""
        every = np.uint64(2**pattern.points - 1)
        if self.model is None:
            masks = np.full(frame.shape, every, np.uint64)
        else:
            masks = self.model.sample(frame, pattern)
        for face in SIDES:
            self._cut(masks, face, frame, pattern)
        return masks

    def _cut(self, masks: NDArray[np.uint64], face: str, frame: Frame, pattern: Pattern) -> None:
        """Clear the bits of samples beyond a face."""
        axis, lowest = _axis(face), self._reach(face)[0]
        first = frame.centres(axis) - frame.spacing[axis] / 2
        ends = self._beyond(face, np.stack([first, first + frame.spacing[axis]]))
        near = np.flatnonzero(ends.max(axis=0) > lowest)
        if not len(near):
            return
        layers = slice(int(near[0]), int(near[-1]) + 1)
        part = np.moveaxis(masks, axis, -1)[..., layers]
        levels = self._levels(frame)
        for sample, (row, deep) in enumerate(np.ndindex(pattern.depths.shape)):
            offsets = (*pattern.rows[row], pattern.depths[row, deep])
            at = [
                frame.origin[a] + (frame.start[a] + np.arange(frame.shape[a]) + offsets[a]) * step
                for a, step in enumerate(frame.spacing)
            ]
            if axis != 2 or not deep:  # else all samples of a line have one height
                x, y = (at[a] for a in _others(axis))
                places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
                heights = self._heights(face, places, levels).reshape(len(x), len(y), 1)
            beyond = self._beyond(face, at[axis][layers]) > heights
            part &= ~(beyond.astype(np.uint64) << np.uint64(sample))

    def contains(self, points: Floats) -> Flags:
        """Tell which points (n, 3), in ``unit``, lie in the body."""
        given = np.asarray(points, np.float64)
        inside = np.ones(len(given), np.bool_)
        for face in SIDES:
            axis = _axis(face)
            heights = self._heights(face, given[:, _others(axis)])
            inside &= self._beyond(face, given[:, axis]) <= heights
        if self.model is not None:
            assert isinstance(self.model, HasMembership)
            inside[inside] = self.model.contains(given[inside])
        return inside

    def check_membership(self) -> None:
        """Raise ``ModelError`` where the model within is known on lattices of voxels alone."""
        if self.model is None:
            return
        if not isinstance(self.model, HasMembership):
            raise ModelError(
                f"model: a {type(self.model).__name__} is known on lattices of voxels alone; "
                "wanted one that can be asked point by point"
            )
        self.model.check_membership()

    def _beyond(self, face: str, coordinates: Floats) -> Floats:
        """Return how far outwards of the core's side coordinates lie."""
        return _out(face) * (coordinates - self._plane(face))

    def _plane(self, face: str) -> float:
        """Return where the core's side lies along its axis."""
        return (self.core.lower, self.core.upper)[SIDES.index(face) % 2][_axis(face)]

    def _heights(self, face: str, places: Floats, levels: int | None = None) -> Floats:
        """Return the heights (n,) over points (n, 2) of a face's plane, in ``unit``."""
        relief = self.reliefs.get(face)
        if relief is None:
            return np.zeros(len(places))
        others = _others(_axis(face))
        lower = np.array([self.core.lower[a] for a in others])
        edges = np.array([self.core.lengths[a] for a in others])
        local = (places - lower) / edges
        return relief.heights(local) if levels is None else relief.heights(local, levels)

    def _levels(self, frame: Frame) -> int:
        finest = FINER * min(frame.spacing)
        return max((relief.levels(finest) for relief in self.reliefs.values()), default=1)

    def sampling_error(self, frame: Frame) -> float:
        """Return how far the boundary that is sampled may lie from the body's, in ``unit``."""
        levels = self._levels(frame)
        own = max((relief.left(levels) for relief in self.reliefs.values()), default=0.0)
        within = self.model.sampling_error(frame) if isinstance(self.model, HasDoubts) else 0.0
        return own + within

    def exact(
        self, periodic: tuple[bool, bool, bool] = (False, False, False)
    ) -> tuple[Measure, ...]:
        """Return what is known of a solid block in closed form, in vacuum.

        Dimension and Sq of each face as they were asked for; volume and topology where no two pits
        can meet within an edge.
        """
        if self.model is not None or any(periodic):
            return ()
        rows = [row for skin in self.skins for row in self._of_face(skin)]
        pitted = {_axis(face) for face in self.reliefs if self._reach(face)[0] < 0}
        return (*rows, *self._of_body()) if len(pitted) <= 1 else tuple(rows)

    def _of_face(self, skin: Skin) -> tuple[Measure, Measure]:
        side, doubt = skin.face.lower(), self.reliefs[skin.face].amplitude_doubt
        kind = "standard" if doubt else "exact"
        return (
            Measure(f"dimension_{side}", skin.dimension, "1", METHOD, 0.0, "exact", "model"),
            Measure(f"sq_{side}", skin.amplitude, self.unit, METHOD, doubt, kind, "model"),
        )

    def _of_body(self) -> tuple[Measure, ...]:
        volume = self.core.volume
        for face, relief in self.reliefs.items():
            volume += relief.mean * math.prod(self.core.lengths[a] for a in _others(_axis(face)))
        density = volume / self.box.volume
        values = {"volume": (volume, f"{self.unit}³"), "porosity": (1 - density, "1")}
        values |= {"relative_density": (density, "1"), "components": (1, "1")}
        values |= {"euler_number": (1, "1"), "genus": (0, "1")}
        return tuple(
            Measure(name, value, unit, METHOD, 0.0, "exact", "model")
            for name, (value, unit) in values.items()
        )


def _needing(sides: Sequence[str], faces: Sequence[str]) -> str:
    """Return the beginning of a sentence about the skins of an axis."""
    there = [side for side in sides if side in faces]
    return (
        f"the skin of {there[0]} needs"
        if len(there) == 1
        else f"the skins of {' and '.join(there)} need"
    )


def _axis(face: str) -> int:
    return SIDES.index(face) // 2


def _out(face: str) -> int:
    return 2 * (SIDES.index(face) % 2) - 1


def _others(axis: int) -> list[int]:
    return [a for a in range(3) if a != axis]


def rough(
    body: Model | Sequence[float],
    skins: Sequence[Skin],
    *,
    unit: str = "mm",
) -> Rough:
    """Return a block with rough faces, or a model that is cut along them.

    Parameters
    ----------
    body
        The edges of a block along x, y and z, which begins at the origin; or a model, whose domain
        the skins are cut into.
    skins
        One per rough face.
    unit
        Of a block: nm, um, mm, cm, m or in; a model has its own.

    Raises
    ------
    ModelError
        As ``Rough``; for edges that are no lengths.
    """
    if isinstance(body, Model):
        return Rough(body.domain, tuple(skins), body.unit, body)
    edges = tuple(body)
    if len(edges) != 3 or not all(0 < edge < math.inf for edge in edges):
        raise ModelError(f"size: got {edges}; wanted three lengths above zero")
    return Rough(Box((0, 0, 0), edges), tuple(skins), unit)


Length = Annotated[float, Field(gt=0)]
Within = Annotated[
    IFSSection | CIFSSection | BCIFSSection | TreeSection | WarpSection,
    Field(discriminator="kind"),
]


class SkinSection(Section):
    """One table of ``[[model.skins]]``: faces that are to be equally rough."""

    faces: Annotated[
        tuple[Literal["XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX"], ...],
        Field(strict=False, min_length=1),
    ] = Field(description="a list of XMIN, XMAX, YMIN, YMAX, ZMIN and ZMAX")
    dimension: float = Field(gt=2, lt=3, description="the box dimension, between 2 and 3")
    amplitude: float = Field(
        gt=0, description="the root-mean-square height Sq, above zero, in the unit of length"
    )
    bumps: int = Field(
        default=4,
        ge=1,
        le=MOST_BUMPS,
        description=f"how many of the largest bumps lie along the face's shorter edge, 1 … "
        f"{MOST_BUMPS}",
    )
    seed: int = Field(
        default=0,
        ge=0,
        description="a whole number, zero or more, that draws which bumps point outwards",
    )
    outwards: bool = Field(
        default=False, description="true to have all bumps point outwards, false for half of them"
    )


class RoughSection(Section):
    """The ``[model]`` table of a body with rough faces."""

    kind: Literal["rough"] = Field(default="rough", description='"rough"')
    size: Annotated[tuple[Length, Length, Length], Field(strict=False)] | None = Field(
        default=None, description="three lengths above zero: the edges of a block"
    )
    unit: Literal["nm", "um", "mm", "cm", "m", "in"] | None = Field(
        default=None, description="nm, um, mm, cm, m or in; mm if left out"
    )
    model: Within | None = Field(
        default=None, description="a table [model.model] of another kind, instead of size and unit"
    )
    skins: Annotated[tuple[SkinSection, ...], Field(strict=False, min_length=1)] = Field(
        description="tables { faces = [...], dimension = …, amplitude = … }"
    )


def build(section: RoughSection, folder: Path) -> Rough:
    """Return the model of a recipe's section; files lie relative to ``folder``.

    Raises
    ------
    ModelError
        As ``Rough``; where not one of size and model is given; where the model within cannot be.
    """
    if (section.size is None) == (section.model is None):
        raise ModelError("model: wanted one of size, the edges of a block, and [model.model]")
    skins = tuple(
        Skin(face, **part.model_dump(exclude={"faces"}))
        for part in section.skins
        for face in part.faces
    )
    if section.size is not None:
        return rough(section.size, skins, unit=section.unit or "mm")
    if section.unit is not None:
        raise ModelError("unit: [model.model] has its own; wanted none beside it")
    assert section.model is not None
    home = importlib.import_module(f"porous.models.{section.model.kind}")
    return rough(home.build(section.model, folder), skins)
