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
    "octa": (*(piece.name for piece in UPRIGHT), "0", "1", "4", "5"),
}
"""T → 4 T + O, O → 4 T + 4 O: no inverted tetrahedra, no octahedra at the ends of one axis.

The body is in one piece at every level, across faces: in O the tetrahedra and the octahedra form
a ring; each face of O has octahedra at two of its corners, so that a T and an O that share a
triangle have children that share one. Its pores are open, and the dimension is log₂ 6, for the
matrix of counts [[4, 1], [4, 4]] has the eigenvalue 6. (With O → 8 T there are eight pieces at
level 2; with T → 4 T + O and all symmetries of a tetrahedron, a body in one piece is full or has
closed pores.)"""


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
