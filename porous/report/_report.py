"""From a result to the text of its page, and from there to a file."""

from __future__ import annotations

import base64
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING

from porous import disk
from porous.errors import ViewError
from porous.report._agreement import groups, lines, verdict
from porous.report._doubts import doubts
from porous.report._provenance import provenance, title_of
from porous.stages import voxelize
from porous.values import SurfaceMesh, VoxelGrid
from porous.view import picture

if TYPE_CHECKING:
    from pathlib import Path

    from jinja2 import Template

    from porous.pipeline import Result
    from porous.values import VolumeMesh

    Drawable = SurfaceMesh | VoxelGrid | VolumeMesh

DRAWN_TRIANGLES = 500_000
"""Triangles of a surface up to which it is drawn; beyond, the voxels are."""
DRAWN_VOXELS = 128
"""Voxels along the longest edge of what is drawn of a grid that does not lie in memory."""


def report_html(result: Result) -> str:
    """Return the report of a result: one page that needs no other file and no network.

    It holds a picture (or why this machine cannot draw one), every measure with closed form
    beside measurement, the certificate, what is uncertain, the notes of the run and where all of
    it comes from. Every text is escaped.
    """
    value, remark = _drawable(result)
    image, excuse = _picture(value)
    return _template().render(
        title=title_of(result),
        image=image,
        remark=remark,
        excuse=excuse,
        verdict=verdict(result.certificate),
        groups=groups(result.measures),
        checks=lines(result.certificate),
        doubts=doubts(result),
        notes=result.notes,
        provenance=provenance(result),
    )


def write_report(result: Result, path: str | Path) -> None:
    """Write the report of a result as an HTML file.

    Raises
    ------
    DiskError
        Where the disk refuses; what was there before is untouched.
    """
    disk.write_bytes(path, report_html(result).encode("utf-8"))


@cache
def _template() -> Template:
    from jinja2 import Environment, StrictUndefined

    text = resources.files("porous.report").joinpath("page.html").read_text(encoding="utf-8")
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(text)


def _picture(value: Drawable | None) -> tuple[str, str]:
    """Return a picture in base64, or nothing and why there is none."""
    if value is None:
        return "", "There is no picture: neither voxels nor a mesh were made."
    try:
        return base64.b64encode(picture(value, width=960, height=640)).decode(), ""
    except ViewError as error:
        return "", f"There is no picture: {error}."


def _drawable(result: Result) -> tuple[Drawable | None, str]:
    """Return what to draw of a result, and what to say of it: too much is drawn more coarsely."""
    surface, grid = result.surface, result.grid
    if isinstance(surface, SurfaceMesh) and (
        grid is None or len(surface.triangles) <= DRAWN_TRIANGLES
    ):
        return surface, ""
    if grid is not None and not isinstance(grid, VoxelGrid):
        assert result.model is not None
        count = min(DRAWN_VOXELS, max(grid.frame.shape))
        grid = voxelize(result.model, voxels=count, sampling=grid.sampling)
        remark = f", drawn with {count} voxels along its longest edge"
        return (grid, remark) if grid.solid.any() else (None, "")
    return (grid, "") if grid is not None and grid.solid.any() else (result.volume, "")
