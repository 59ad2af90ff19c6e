"""From a model to the surface that its maps make, without voxels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from porous.errors import ModelError
from porous.models.model import HasBoundary

if TYPE_CHECKING:
    from porous.values import SurfaceMesh


def exact_surface(model: object) -> SurfaceMesh:
    """Return the exact boundary of a polyhedral prefractal: closed, oriented, manifold.

    Raises
    ------
    ModelError
        Where the model has none, or where its topology would not be certain; the message names
        what to do instead.
    """
    if not isinstance(model, HasBoundary):
        raise ModelError(
            f"exact surface: a {type(model).__name__} has none; use extract_surface on voxels"
        )
    return model.boundary()
