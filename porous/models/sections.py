"""Tables and values that several sections of a recipe are made of, and what stands for a stage."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003  (pydantic reads it)
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from porous.errors import ModelError, nearest
from porous.models import digits as digit_sets
from porous.models.digits import DigitSet
from porous.values import Box


class Section(BaseModel):
    """A table of a recipe: frozen, strict about types, no unknown keys, no NaN."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


Triple = Annotated[tuple[float, float, float], Field(strict=False)]
Matrix = Annotated[tuple[Triple, Triple, Triple], Field(strict=False)]
Place = Annotated[int, Field(ge=0, lt=digit_sets.LARGEST)]
Digit = Annotated[tuple[Place, Place, Place], Field(strict=False)]


def _triple(value: object) -> object:
    return (value, value, value) if isinstance(value, int | float) else value


Length = Annotated[float, Field(gt=0)]
Spacing = Annotated[tuple[Length, Length, Length], BeforeValidator(_triple), Field(strict=False)]
Voxels = Annotated[int, Field(ge=1)]


class CleanSection(Section):
    """What is mended of the voxels before anything is made of them."""

    islands: Literal["all but the largest"] | Voxels | None = Field(
        default=None,
        description='"all but the largest", or a number of voxels: which pieces of solid go, all '
        "others or those of fewer voxels",
    )
    closed_pores: Literal["fill"] | Voxels | None = Field(
        default=None,
        description='"fill", or a number of voxels: which pores that nothing reaches are filled, '
        "all or those of fewer voxels",
    )


class SizeSection(Section):
    """A level by size."""

    size: float = Field(gt=0, description="a length above zero: refine until cells are smaller")


class MeshSection(Section):
    """A primitive of one's own."""

    mesh: Path = Field(strict=False, description="a path to a closed STL, PLY or OBJ file")


class DigitsSection(Section):
    """Lattice-aligned maps x ↦ (x + d) / divisions."""

    divisions: int | None = Field(
        default=None,
        ge=2,
        le=digit_sets.LARGEST,
        description=f"a whole number, 2 … {digit_sets.LARGEST}; a named set has its own",
    )
    keep: str | Annotated[tuple[Digit, ...], Field(strict=False)] = Field(
        description="a list of [i, j, k], each once and below divisions, or the name of a set"
    )

    @model_validator(mode="after")
    def _known(self) -> Self:
        try:
            self.digits()
        except ModelError as error:
            raise ValueError(str(error)) from None
        return self

    def digits(self) -> DigitSet:
        """Return the digit set."""
        if isinstance(self.keep, str):
            if self.keep not in digit_sets.names():
                near = nearest(self.keep, digit_sets.names())
                raise ModelError(f"no set of digits {self.keep!r}{near}")
            return digit_sets.named(self.keep, self.divisions)
        if self.divisions is None:
            raise ModelError("digits: wanted divisions beside a list of digits")
        return DigitSet(self.divisions, np.array(self.keep, np.int64).reshape(-1, 3))


class MapSection(Section):
    """An affine map x ↦ matrix·x + translation."""

    matrix: Matrix = Field(description="three rows of three numbers")
    translation: Triple = Field(default=(0.0, 0.0, 0.0), description="three numbers")


class BoxSection(Section):
    """A box in model units, like the maps."""

    lower: Triple = Field(description="three numbers")
    upper: Triple = Field(description="three numbers, none below its lower bound")

    @model_validator(mode="after")
    def _proper(self) -> Self:
        if any(a >= b for a, b in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"got upper {self.upper}; wanted it above lower {self.lower}")
        return self

    def box(self) -> Box:
        """Return the box."""
        return Box(self.lower, self.upper)
