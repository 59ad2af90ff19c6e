"""What a recipe may say of the stages and the report: their parameters are its keys."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from porous.models.sections import BoxSection, Section, Spacing


class VoxelsSection(Section):
    """How the model is sampled; one of voxels, spacing and per_feature says how finely."""

    voxels: int | None = Field(
        default=None, gt=0, description="a whole number above zero: voxels along the longest edge"
    )
    spacing: Spacing | None = Field(
        default=None,
        description="the edge lengths of a voxel along x, y and z, above zero, in unit",
    )
    per_feature: int | None = Field(
        default=None,
        gt=0,
        description="a whole number above zero: voxels across the smallest feature",
    )
    sampling: Literal["fill", "centre", "cover"] | None = Field(
        default=None,
        description='"fill", "centre" or "cover"; where it is missing, cover for an attractor '
        "without offset and fill for all else",
    )
    periodic: Annotated[tuple[bool, bool, bool], Field(strict=False)] = Field(
        default=(False, False, False), description="three of true and false, for x, y and z"
    )
    cubic: bool = Field(
        default=False, description="true to pad with equal edges, false to stretch to fit"
    )

    @model_validator(mode="after")
    def _one_resolution(self) -> VoxelsSection:
        given = [name for name in ("voxels", "spacing", "per_feature") if getattr(self, name)]
        if len(given) > 1:
            raise ValueError(f"got {' and '.join(given)}; wanted one of them")
        return self


class SurfaceSection(Section):
    """Where the surface comes from, and what is done to it: first smoothed, then simplified."""

    method: Literal["auto", "exact", "marching-cubes", "voxel-faces", "lewiner"] = Field(
        default="auto", description='"auto", "exact", "marching-cubes", "voxel-faces" or "lewiner"'
    )
    smooth: int = Field(
        default=0, ge=0, le=1000, description="a number of smoothing steps, from 0 to 1000"
    )
    volume: Literal["own", "fills"] = Field(
        default="own",
        description='"own" or "fills": what volume a surface of voxels is to enclose; marching '
        "cubes rounds edges off, the fills do not",
    )
    simplify: float = Field(
        default=1.0, gt=0, le=1, description="the share of triangles to keep, above 0 up to 1"
    )

    @model_validator(mode="after")
    def _has_steps(self) -> SurfaceSection:
        if self.smooth and self.method == "exact":
            raise ValueError(
                'smooth: an exact boundary has no steps to smooth; wanted method = "marching-cubes"'
            )
        if self.volume == "fills" and self.method == "exact":
            raise ValueError(
                'volume: an exact boundary encloses its own; wanted method = "marching-cubes"'
            )
        return self


class FinerSection(BoxSection):
    """Where tetrahedra are to be smaller: a box and the edge length in it."""

    edge_length: float = Field(
        gt=0, description="the wanted edge length in this box, above zero, in unit"
    )


class VolumeSection(Section):
    """Where the volume mesh comes from."""

    method: Literal["auto", "cells", "tetwild", "voxel-hex", "none"] = Field(
        default="auto", description='"auto", "cells", "tetwild", "voxel-hex" or "none"'
    )
    edge_length: float | None = Field(
        default=None,
        gt=0,
        description="the wanted edge length of a tetrahedron, above zero, in unit",
    )
    finer: Annotated[tuple[FinerSection, ...], Field(strict=False)] = Field(
        default=(), description="tables [[volume.finer]] with lower, upper and edge_length"
    )
    time_limit: float | None = Field(
        default=None, gt=0, description="what a mesher may take at most, above zero, in seconds"
    )
    phase: Literal["auto", "solid", "pore", "both"] = Field(
        default="auto",
        description='"auto", "solid", "pore" or "both": what is meshed; auto is what the analysis '
        "needs, and solid without one",
    )
    order: Literal[1, 2] = Field(
        default=1, description="1 or 2: of the elements; 2 has nodes in the middle of edges"
    )
    branches: int = Field(
        default=0,
        ge=0,
        description="a whole number, zero or more: letters of the addresses by which cells are "
        "put into sets, 0 for none",
    )

    @model_validator(mode="after")
    def _can_be(self) -> VolumeSection:
        if self.method == "cells" and self.phase in ("pore", "both"):
            raise ValueError(
                f'phase: got "{self.phase}", but a model\'s cells are its solid; wanted method = '
                '"voxel-hex" or "tetwild"'
            )
        return self


class ReportSection(Section):
    """How much is measured, and what for."""

    detail: Literal["brief", "full"] | None = Field(
        default=None,
        description='"brief" or "full"; where it is missing, full for images and brief for all '
        "else",
    )
    probe: float | None = Field(
        default=None,
        gt=0,
        description="the diameter of the ball that pores are to let through, above zero, in unit",
    )
    smallest_wall: float | None = Field(
        default=None, gt=0, description="the thinnest wall that a machine makes, in unit"
    )
    smallest_gap: float | None = Field(
        default=None, gt=0, description="the narrowest gap that a machine leaves open, in unit"
    )
    overhang: float = Field(
        default=45.0,
        gt=0,
        lt=90,
        description="the angle to the build plate, in degrees, below which a face needs support",
    )
    maps: bool = Field(
        default=False,
        description="true to write maps.vti: how wide each pore and how thick each wall is",
    )
