"""A curve in a recipe: which it is, and the numbers that it takes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self, get_args

from pydantic import Field, model_validator

from porous.errors import ModelError
from porous.models.builders import _curves as curves
from porous.models.builders._rules import Texture
from porous.models.sections import Section

if TYPE_CHECKING:
    from collections.abc import Sequence

    from porous.models.builders._curves import Curve

Numbers = Annotated[tuple[float, ...], Field(strict=False, min_length=1)]
Name = Literal["bezier", "b-spline", "koch", "takagi", "rough"]

TAKES: dict[str, tuple[str, ...]] = {
    "bezier": ("degree", "divisions"),
    "b-spline": ("degree", "knots", "divisions"),
    "koch": (),
    "takagi": ("weight",),
    "rough": ("edge", "bump", "divisions"),
}
"""The keys of each curve beside its name."""

MOST = 64
"""Pieces that a curve is cut into, at most."""


class CurveSection(Section):
    """One of the curves whose product a cell is."""

    curve: Name = Field(description=f"one of {', '.join(get_args(Name))}")
    degree: Annotated[int, Field(ge=1, le=curves.HIGHEST)] | None = Field(
        default=None,
        description=f"of a bezier or b-spline, 1 … {curves.HIGHEST}; 2 if left out",
    )
    knots: Numbers | None = Field(
        default=None, description="the 2·degree knots around a b-spline's span, none decreasing"
    )
    weight: float | None = Field(default=None, description="w of takagi, between -1 and 1")
    edge: float | Numbers | None = Field(
        default=None, description="r of rough: one number, or one for each piece"
    )
    bump: float | Numbers | None = Field(
        default=None, description="h of rough: one number, or one for each point between pieces"
    )
    divisions: Annotated[int, Field(ge=2, le=MOST)] | None = Field(
        default=None, description=f"pieces, 2 … {MOST}; those of digits, or 2, if left out"
    )

    @model_validator(mode="after")
    def _known(self) -> Self:
        takes = TAKES[self.curve]
        given = self.model_dump(exclude={"curve"}, exclude_none=True)
        for key in given:
            if key not in takes:
                wanted = ", ".join(takes) or "no more keys"
                raise ValueError(f"{key}: {self.curve} takes none; wanted {wanted}")
        if self.curve == "takagi" and self.weight is None:
            raise ValueError("weight: takagi wants one, between -1 and 1")
        if self.knots is not None and self.degree not in (None, len(self.knots) / 2):
            raise ValueError(f"knots: got {len(self.knots)}; wanted {2 * (self.degree or 0)}")
        try:
            self.made(())
        except ModelError as error:
            raise ValueError(str(error)) from None
        return self

    def made(self, divisions: Sequence[int]) -> Curve:
        """Return the curve; ``divisions`` are those of each level where it has none of its own.

        Raises
        ------
        ModelError
            For knots or textures that make no curve.
        """
        counts = self.divisions or tuple(divisions) or 2
        if self.curve == "koch":
            return curves.koch()
        if self.curve == "takagi":
            assert self.weight is not None
            return curves.takagi(self.weight)
        if self.curve == "rough":
            pieces = counts if isinstance(counts, int) else counts[0]
            return curves.rough(Texture(edge=self.edge, bump=self.bump), pieces)
        if self.knots is not None:
            return curves.spline(self.knots, counts)
        make = curves.bezier if self.curve == "bezier" else curves.uniform
        return make(self.degree or 2, counts)
