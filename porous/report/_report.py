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
from porous.view import picture

if TYPE_CHECKING:
    from pathlib import Path

    from jinja2 import Template

    from porous.pipeline import Result
    from porous.values import SurfaceMesh, VolumeMesh, VoxelGrid

DRAWN_TRIANGLES = 500_000
"""Triangles of a surface up to which it is drawn; beyond, the voxels are."""


def report_html(result: Result) -> str:
    """Return the report of a result: one page that needs no other file and no network.

    It holds a picture (or why this machine cannot draw one), every measure with closed form
    beside measurement, the certificate, what is uncertain, the notes of the run and where all of
    it comes from. Every text is escaped.
    """
    image, excuse = _picture(result)
    return _template().render(
        title=title_of(result),
        image=image,
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


def _picture(result: Result) -> tuple[str, str]:
    """Return a picture in base64, or nothing and why there is none."""
    value = _drawable(result)
    if value is None:
        return "", "There is no picture: neither voxels nor a mesh were made."
    try:
        return base64.b64encode(picture(value, width=960, height=640)).decode(), ""
    except ViewError as error:
        return "", f"There is no picture: {error}."


def _drawable(result: Result) -> SurfaceMesh | VoxelGrid | VolumeMesh | None:
    surface, grid = result.surface, result.grid
    if surface is not None and (grid is None or len(surface.triangles) <= DRAWN_TRIANGLES):
        return surface
    return grid if grid is not None and grid.solid.any() else result.volume
