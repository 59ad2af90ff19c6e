"""The space-filling tetrahedra and octahedra, T → 4 T + O, O → 8 T + 6 O, and parts of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from porous.models.builders._builder import Builder
from porous.models.builders._simplices import simplicial

if TYPE_CHECKING:
    from porous.models.brep import BRep
    from porous.models.builders._builder import Options


def _build(options: Options) -> BRep:
    """Return a tetrahedron or an octahedron of the unit cube and its halves, all if not told.

    ``keep = {"tetra": ("tetra",)}`` is T → 4 T, O → 8 T + 6 O and ``{"octa": ("tetra",)}``
    T → 4 T + O, O → 8 T.

    Raises
    ------
    ModelError
        For a start that is neither, or children that are not there.
    """
    start = "tetra" if options.start is None else options.start
    return simplicial(start, options.keeping(start), options.controls)


CELL = Builder(("tetra-octa",), _build, ("keep", "start", "controls"))
