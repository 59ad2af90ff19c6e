"""What a surface that went into a file says of the solid."""

from __future__ import annotations

from typing import TYPE_CHECKING

from porous.measures._mesh import ROUNDING, TOPOLOGY
from porous.measures._surface_area import surface_doubt
from porous.values import Measure

if TYPE_CHECKING:
    from porous.measures._census import Census
    from porous.stages import StreamedSurface


def streamed_rows(surface: StreamedSurface, census: Census) -> dict[str, Measure]:
    """Return volume, areas and Euler numbers of a surface from marching cubes, by their names.

    Uncertainties are those of the grid that it was made from, as for a surface in memory; of
    pieces nothing was kept. Caps across periodic axes cannot be told from others: there the area
    of all is left out.
    """
    frame, unit = census.frame, surface.unit
    size = max(map(abs, (*frame.box.lower, *frame.box.upper)))
    volume_doubt, area_doubt = surface_doubt(census, surface)
    volume_doubt += ROUNDING * size * surface.area
    area_doubt += ROUNDING * surface.triangles**0.5 * surface.area

    def row(name: str, value: float, unit: str, doubt: float | None = None) -> Measure:
        kind = "exact" if doubt is None else "standard"
        return Measure(name, value, unit, "triangles", doubt or 0.0, kind, "surface")

    rows = [
        row("volume", surface.volume, f"{unit}³", volume_doubt),
        row("surface_area", surface.area, f"{unit}²", area_doubt),
        row("interface_area", surface.area - surface.caps_area, f"{unit}²", area_doubt),
        row("euler_number", surface.euler_number / 2, "1"),
        row("surface_euler_number", surface.euler_number, "1"),
    ]
    untold = (*TOPOLOGY, "surface_area") if any(frame.periodic) else ()
    return {row.name: row for row in rows if row.name not in untold}
