"""Sierpinski tetrahedra: joined in corners, or across faces by the octahedra between them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from porous.errors import ModelError
from porous.models.builders._builder import Builder
from porous.models.builders._simplices import UPRIGHT, simplicial

if TYPE_CHECKING:
    from porous.models.brep import BRep
    from porous.models.builders._builder import Options

FACE_JOINED = {
    "tetra": ("tetra", "octa"),
    "octa": (*(piece.name for piece in UPRIGHT), "octa"),
}
"""All but the inverted tetrahedra: T → 4 T + O, O → 4 T + 6 O.

What is left is joined across faces at every level: in O each of the four tetrahedra meets three
octahedra, which joins all six, and the children at the corners of a triangle that T and O share
meet again. (With O → 8 T the tetrahedra in O meet in edges alone.) The dimension is
log₂(5 + √5) = 2.855, for the matrix of counts is [[4, 1], [4, 6]]."""


def _build(options: Options) -> BRep:
    """Return a tetrahedron of the unit cube and its halves: the four at its corners if not told.

    ``keep`` with ``"octa"`` among the tetrahedron's children joins them across faces; the
    octahedron's own children are then those of ``FACE_JOINED`` if not told.

    Raises
    ------
    ModelError
        For children that are not there, or an octahedron that nobody keeps.
    """
    keep = options.keeping("tetra")
    keep.setdefault("tetra", ("tetra",))
    if "octa" in keep["tetra"]:
        keep.setdefault("octa", FACE_JOINED["octa"])
    elif "octa" in keep:
        raise ModelError("keep: got children of octa; wanted octa among those of tetra")
    return simplicial("tetra", keep, options.controls)


CELL = Builder(("tetra",), _build, ("keep", "controls"))
