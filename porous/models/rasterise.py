"""The front of sampling: which points of which voxels lie in what a model is made of."""

from __future__ import annotations

from typing import TYPE_CHECKING

from porous.models.cover import cover_attractor, sample_attractor
from porous.models.lattice import fill_digits, sample_digits
from porous.models.pieces import Pieces

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from porous.models.primitive import Primitive
    from porous.values import Frame, Pattern

__all__ = [
    "Pieces",
    "cover_attractor",
    "cover_pieces",
    "fill_digits",
    "sample_attractor",
    "sample_digits",
    "sample_pieces",
]


def sample_pieces(
    primitive: Primitive,
    frames: NDArray[np.float64],
    frame: Frame,
    pattern: Pattern,
    *,
    offset: float = 0.0,
    balls: NDArray[np.float64] | None = None,
) -> NDArray[np.uint64]:
    """Return the masks of a union of images of a primitive; see ``Pieces``.

    Who samples many tiles keeps one ``Pieces``: it remembers where its pieces lie.
    """
    return Pieces(primitive, frames, offset, balls).sample(frame, pattern)


def cover_pieces(
    primitive: Primitive,
    frames: NDArray[np.float64],
    frame: Frame,
    *,
    offset: float = 0.0,
    balls: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.uint64], float]:
    """Return the voxels that a union of images touches, and a Hausdorff bound; see ``Pieces``."""
    return Pieces(primitive, frames, offset, balls).cover(frame)
