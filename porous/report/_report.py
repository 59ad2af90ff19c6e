"""From a result to the text of its page, and from there to a file."""

from __future__ import annotations

import base64
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from porous import disk
from porous.errors import ViewError
from porous.models.model import HasNotes
from porous.report._agreement import lines, verdict
from porous.report._citation import citation
from porous.report._doubts import doubts
from porous.report._page import page, text_of
from porous.report._plots import plots
from porous.report._provenance import provenance, title_of, told
from porous.report._scene import FILES, scene, scene_html
from porous.report._table import glossary, keys, methods_used, sections
from porous.scale.costs import SURFACE_VOXELS
from porous.values import SurfaceMesh, VoxelGrid
from porous.view import picture

if TYPE_CHECKING:
    from collections.abc import Sequence

    from porous.pipeline import Result
    from porous.report._scene import Scene
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
    body = scene(result)
    value, remark = _drawable(result, body)
    with ThreadPoolExecutor(1) as drawing:  # a process of its own, which the rest need not wait for
        drawn = drawing.submit(_picture, value)
        rest = _rest(result, body, folder)
        image, excuse = drawn.result()
    return page("report.html", image=image, remark=remark, excuse=excuse, **rest)


def _rest(result: Result, body: Scene | None, folder: Path | None) -> dict[str, Any]:
    """Return what the page holds besides its picture."""
    steps = _steps(result)
    origin = provenance(result, folder)
    drawn = plots(result.findings.curves)
    by = [row.method for row in result.measures]
    by += [method for plot in drawn for method in plot.methods]
    return {
        **_viewer(body),
        "plots": drawn,
        "title": title_of(result),
        "parts": _parts(plots=drawn, image=steps, findings=result.findings.notes),
        "verdict": verdict(result.certificate),
        "keys": keys(result.measures),
        "sections": sections(result.measures),
        "checks": lines(result.certificate),
        "doubts": doubts(result),
        "findings": result.findings.notes,
        "steps": steps,
        "notes": [note for note in result.notes if note not in steps],
        "provenance": origin,
        "origin": told(origin),
        "citation": citation(result, origin.versions["porous"]),
        "glossary": glossary((*result.measures.names, *(plot.definition for plot in drawn))),
        "methods": methods_used(by),
    }


def _viewer(body: Scene | None) -> dict[str, Any]:
    """Return a body to be turned, if there is one, and the scripts that turn it."""
    if body is None:
        return {"viewer": Markup(), "scripts": ()}
    scripts = tuple(text_of(FILES[name]) for name in ("reading", "script"))
    return {"viewer": Markup(scene_html(body)), "scripts": scripts}  # noqa: S704  (a template of the package)


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


def _drawable(result: Result, body: Scene | None) -> tuple[Drawable | None, str]:
    """Return what to draw of a result, and what to say of it: of too much what the view shows."""
    surface, grid = result.surface, result.grid
    if isinstance(surface, SurfaceMesh) and (
        grid is None or len(surface.triangles) <= DRAWN_TRIANGLES
    ):
        return surface, ""
    if isinstance(grid, VoxelGrid) and grid.frame.size <= SURFACE_VOXELS:
        return (grid, "") if grid.solid.any() else (result.volume, "")
    if grid is None or body is None:
        return result.volume, ""
    return body.surface, f", drawn as the view shows it{body.remark}"
