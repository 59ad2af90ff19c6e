"""From a model that is drawn with beams to the lattice of them, without voxels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from porous.errors import ModelError
from porous.models.model import HasBeams

if TYPE_CHECKING:
    from porous.values import BeamLattice


def beams(model: object, *, alone: bool = False) -> BeamLattice:
    """Return the beams and balls that a model is drawn with, as nodes and struts between them.

    The union of the lattice is the body: beams end in balls, and where the model's domain cuts
    the body off, the lattice is clipped to it.

    Parameters
    ----------
    model
        Of kind ``cifs`` or ``tree`` with beams, or ``bcifs`` with ``draw``.
    alone
        Take the beams of a body that has plates or solids too; these are left out.

    Raises
    ------
    ModelError
        Where the model has no beams, or is an attractor; without ``alone`` where they are not the
        whole body.
    """
    if not isinstance(model, HasBeams):
        raise ModelError(
            f"beams: a {type(model).__name__} has none; models of kind cifs, tree and bcifs have "
            "where they are drawn with them"
        )
    lattice, others = model.beam_lattice()
    if others and not alone:
        raise ModelError(
            f"beams: the body has {others} beside its {len(lattice.beams)} beams; wanted beams and "
            "balls only, or alone = True to leave the others out"
        )
    return lattice
