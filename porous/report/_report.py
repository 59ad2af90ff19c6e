"""From a result to the text of its page, and from there to a file."""

from __future__ import annotations

import base64
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from porous import disk
from porous.errors import ViewError
from porous.models.model import HasNotes
from porous.report._agreement import lines, verdict
from porous.report._citation import citation
from porous.report._doubts import doubts
from porous.report._greys import pooled
from porous.report._page import page, text_of
from porous.report._plots import plots
from porous.report._provenance import provenance, title_of, told
from porous.report._scene import FILES, scene, scene_html
from porous.report._table import glossary, keys, methods_used, sections
from porous.scale.costs import SURFACE_VOXELS
from porous.stages import voxelize
from porous.values import SurfaceMesh, VoxelGrid
from porous.view import picture

if TYPE_CHECKING:
    from collections.abc import Sequence

    from porous.pipeline import Result
    from porous.values import VolumeMesh

    Drawable = SurfaceMesh | VoxelGrid | VolumeMesh

PARTS = (
    ("key", "Key numbers"),
    ("uncertain", "What is uncertain"),
    ("findings", "Findings"),
    ("plots", "Plots"),
    ("measures", "Measures"),
    ("certificate", "Certificate"),
    ("image", "How the image was read"),
    ("notes", "Notes"),
    ("made", "What was made"),
    ("cite", "Methods, and how to cite"),
    ("origin", "Where it comes from"),
    ("definitions", "Definitions"),
)
"""The parts of the page, and what leads to them."""

CLEANED = ("clean.", "all measures are of the cleaned voxels")
"""How notes begin that tell of cleaning."""

DRAWN_TRIANGLES = 500_000
"""Triangles of a surface up to which it is drawn; beyond, the voxels are."""
DRAWN_VOXELS = 128
"""Voxels along the longest edge of what is drawn of a grid that does not lie in memory."""


def report_html(result: Result, *, folder: Path | None = None) -> str:
    """Return the report of a result: one page that needs no other file and no network.

    It holds a picture (or why this machine cannot draw one), the numbers that are looked for first,
    plots, every measure with closed form beside measurement, the certificate, what is uncertain,
    the notes of the run, a paragraph on methods and where all of it comes from. Every text is
    escaped.

    Parameters
    ----------
    result
        What to tell of.
    folder
        Where the files are that its recipe reads, if they are not named in full.
    """
    value, remark = _drawable(result)
    with ThreadPoolExecutor(1) as aside:  # the picture is drawn by a process of its own meanwhile
        drawing = aside.submit(_picture, value)
        viewer, scripts = _viewer(result)
        image, excuse = drawing.result()
    steps = _steps(result)
    origin = provenance(result, folder)
    drawn = plots(result.findings.curves)
    by = [row.method for row in result.measures]
    return page(
        "report.html",
        plots=drawn,
        scripts=scripts,
        title=title_of(result),
        parts=_parts(plots=drawn, image=steps, findings=result.findings.notes),
        viewer=viewer,
        image=image,
        remark=remark,
        excuse=excuse,
        verdict=verdict(result.certificate),
        keys=keys(result.measures),
        sections=sections(result.measures),
        checks=lines(result.certificate),
        doubts=doubts(result),
        findings=result.findings.notes,
        steps=steps,
        notes=[note for note in result.notes if note not in steps],
        provenance=origin,
        origin=told(origin),
        citation=citation(result, origin.versions["porous"]),
        glossary=glossary((*result.measures.names, *(plot.definition for plot in drawn))),
        methods=methods_used((*by, *(method for plot in drawn for method in plot.methods))),
    )


def _viewer(result: Result) -> tuple[Markup, tuple[str, ...]]:
    """Return a body to be turned, if there is one, and the scripts that turn it."""
    body = scene(result)
    if body is None:
        return Markup(), ()
    scripts = tuple(text_of(FILES[name]) for name in ("reading", "script"))
    return Markup(scene_html(body)), scripts  # noqa: S704  (a template of the package)


def _parts(**given: Sequence[object]) -> list[tuple[str, str]]:
    """Return the headings of the page; some parts are there only where something is in them."""
    return [(key, name) for key, name in PARTS if key not in given or given[key]]


def _steps(result: Result) -> tuple[str, ...]:
    """Return what was done to an image before anything was measured, of the notes of the run."""
    recipe = result.recipe
    if recipe is None or recipe.model.kind != "image":  # type: ignore[attr-defined]
        return ()
    read = result.model.notes if isinstance(result.model, HasNotes) else ()
    return tuple(note for note in result.notes if note in read or note.startswith(CLEANED))


def write_report(result: Result, path: str | Path) -> None:
    """Write the report of a result as an HTML file.

    Raises
    ------
    DiskError
        Where the disk refuses; what was there before is untouched.
    """
    html = report_html(result, folder=Path(path).absolute().parent)
    disk.write_bytes(path, html.encode("utf-8"))


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
    if grid is not None and grid.frame.size > SURFACE_VOXELS:
        grid = pooled(grid)
        return grid, f", drawn with voxels of {grid.frame.spacing[0]:.3g} {grid.frame.unit}"
    return (grid, "") if grid is not None and grid.solid.any() else (result.volume, "")
