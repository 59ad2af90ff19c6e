"""Bodies bent by a fractal homeomorphism of their box: { x : h(x) ∈ body }, their topology kept.

The body is one that can be asked point by point; voxels of any other are bent by ``warp_grid``. h
is only ever evaluated forward; the maps are those of ``models.homeomorphism``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from porous.errors import ModelError
from porous.models import bcifs, ifs
from porous.models.bcifs_section import BCIFSSection
from porous.models.homeomorphism import Homeomorphism, Place, homeomorphism
from porous.models.ifs import IFSSection
from porous.models.model import HasDoubts, HasMembership, Model
from porous.models.sections import Digit, Section, Triple
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from porous.values import Box, Frame, Pattern

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

KIND = "warp"

INSTEAD = "; or voxelize it, and bend the voxels by warp_grid"
"""The end of a refusal: what bends any body."""

CHUNK = 1 << 19
"""Samples that are looked at in one step."""


@dataclass(frozen=True, eq=False)
class Warp(Value):
    """A model bent by a fractal homeomorphism of its domain: the x with h(x) in the model.

    The box that is sampled and that porosity refers to is the model's domain, which h maps onto
    itself. No porosity is known in closed form, and no smallest detail: h stretches without bound.

    Parameters
    ----------
    model
        Any model that can be asked point by point.
    bend
        The map h of its domain, in edges of it.

    Raises
    ------
    ModelError
        Where the model answers on lattices alone.
    """

    model: Model
    bend: Homeomorphism

    def __post_init__(self) -> None:
        if not isinstance(self.model, HasMembership):
            raise ModelError(
                f"model: a {type(self.model).__name__} is known on lattices of voxels alone; "
                "wanted one that can be asked point by point, such as kind = "
                f'"ifs" or the solid cells of kind = "bcifs"{INSTEAD}'
            )
        try:
            self.model.check_membership()
        except ModelError as error:
            raise ModelError(f"{error}{INSTEAD}") from None

    @property
    def unit(self) -> str:
        """Unit of length."""
        return self.model.unit

    @property
    def domain(self) -> Box:
        """The box that is bent within itself and sampled."""
        return self.model.domain

    @property
    def bulk(self) -> Box:
        """The same box."""
        return self.model.domain

    @property
    def is_cut(self) -> bool:
        """Whether the domain leaves out a part of the model."""
        return isinstance(self.model, HasDoubts) and self.model.is_cut

    @property
    def feature_size(self) -> None:
        """None: a fractal homeomorphism has no least stretch."""
        return None

    def sample(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the mask of each voxel: bit r·C + c where h of the pattern's point is solid.

        Each sample is asked for at its own place: to sample the model on a finer lattice instead
        would have an error without a useful bound, for h stretches without bound.
        """
        masks = np.zeros(frame.size, np.uint64)
        bits = np.uint64(1) << np.arange(pattern.points, dtype=np.uint64)
        step = max(1, CHUNK // pattern.points)
        for first in range(0, frame.size, step):
            last = min(first + step, frame.size)
            moved = self.bend.moved_samples(frame, self.domain, pattern, (first, last))
            inside = self._holds(moved).reshape(-1, pattern.points)
            masks[first:last] = np.where(inside, bits, 0).sum(axis=1, dtype=np.uint64)
        return masks.reshape(frame.shape)

    def _holds(self, places: Floats) -> Flags:
        """Tell which places, in edges of the domain, are in the model; negative ones are not."""
        assert isinstance(self.model, HasMembership)
        result = np.zeros(len(places), np.bool_)
        inside = np.flatnonzero((places >= 0).all(axis=1))
        world = np.array(self.domain.lower) + places[inside] * np.array(self.domain.lengths)
        result[inside] = self.model.contains(world)
        return result

    def check_membership(self) -> None:
        """Do nothing: what is warped can be warped again."""

    def contains(self, points: Floats) -> Flags:
        """Tell which points (n, 3), in ``unit``, lie in the warped body."""
        places = (np.asarray(points) - self.domain.lower) / self.domain.lengths
        outside = ((places < 0) | (places > 1)).any(axis=1)
        images = self.bend.moved(np.clip(places, 0, 1))
        images[outside] = -1
        return self._holds(images)

    def sampling_error(self, frame: Frame) -> float:
        """Return how far the boundary that is sampled may lie from the body's, in ``unit``."""
        return self.bend.sampling_error(frame, self.domain)


def warp(model: Model, offsets: ArrayLike | Mapping[Place, ArrayLike]) -> Warp:
    """Return a model bent by a fractal homeomorphism of its domain; its topology is kept.

    Voxels, which any model has, and meshes are bent by ``warp_grid`` and ``warp_mesh``.

    Parameters
    ----------
    model
        What is bent, which can be asked point by point: the cells of a level of an ``ifs``, or the
        solid cells of a ``bcifs``, without offset or drawn parts; a rough block, or a warp.
    offsets
        How far the 3 × 3 × 3 points of a lattice are moved, in edges of the domain, as in
        ``homeomorphism``.

    Raises
    ------
    ModelError
        As ``homeomorphism``, and where the model answers on lattices alone.
    """
    return Warp(model, homeomorphism(offsets))


class OffsetSection(Section):
    """How far one point of the lattice is moved."""

    at: Digit = Field(description="[i, j, k] of 0, 1 and 2: a point of the lattice")
    by: Triple = Field(description="three numbers, in edges of the domain")


Warped = Annotated[IFSSection | BCIFSSection, Field(discriminator="kind")]


class WarpSection(Section):
    """The ``[model]`` table of a fractal homeomorphism of another model."""

    kind: Literal["warp"] = Field(default="warp", description='"warp"')
    model: Warped = Field(
        description='a table [model.model] of kind "ifs" or "bcifs", of '
        "solids without offset; of other bodies po.warp_grid bends the voxels"
    )
    offsets: Annotated[tuple[OffsetSection, ...], Field(strict=False)] = Field(
        default=(),
        description="tables { at = [i, j, k], by = [x, y, z] }: lattice points that are moved",
    )


def build(section: WarpSection, folder: Path) -> Warp:
    """Return the model of a recipe's section; files lie relative to ``folder``.

    Raises
    ------
    ModelError
        As ``Warp``, or where the model within cannot be.
    """
    moves: dict[Place, Triple] = {}
    for each in section.offsets:
        if each.at in moves:
            raise ModelError(f"offsets: {list(each.at)} is there twice")
        moves[each.at] = each.by
    inner = section.model
    built = (
        ifs.build(inner, folder) if isinstance(inner, IFSSection) else bcifs.build(inner, folder)
    )
    if not isinstance(built, Model):
        raise ModelError("model: wanted a body that can be asked point by point")
    return warp(built, moves)
