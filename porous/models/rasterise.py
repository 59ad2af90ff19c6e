"""The front of sampling: which points of which voxels lie in what a model is made of."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.models.cover import cover_attractor, sample_attractor
from porous.models.lattice import fill_digits, sample_digits
from porous.models.pieces import Pieces

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.models.primitive import Primitive
    from porous.values import Box, Frame, Pattern

ROUNDINGS = 64
"""How many roundings of a coordinate's power the products of a word's matrices may come to."""
SHARE = 1 / 16
"""Part of a voxel that rounding may move a body by."""

__all__ = [
    "Pieces",
    "check_place",
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


def check_place(domain: Box, frame: Frame, size: float, power: int) -> None:
    """Refuse a body so far from the origin that rounding moves it by a part of a voxel.

    Maps are weights of controls about the origin. Where coordinates are no larger than these
    controls, rounding is that of the coordinates; where they are, products of the weights cancel:
    attractors lose that ratio besides, pieces of a level its square; measured at coordinates from
    1e3 to 1e12, with ``ROUNDINGS`` of room.

    Parameters
    ----------
    domain, frame
        What is sampled, and where.
    size
        How far from the origin the controls of the level-0 cell reach.
    power
        Of the ratio: 1 for attractors, 2 for pieces.

    Raises
    ------
    ModelError
        Names the coordinates.
    """
    far, h = max(map(abs, (*domain.lower, *domain.upper))), min(frame.spacing)
    if ROUNDINGS * np.finfo(float).eps * far * max(1.0, far / size) ** power > SHARE * h:
        raise ModelError(
            f"model: lies at coordinates up to {far:.3g} {frame.unit}, where voxels of {h:.3g} are "
            "lost in rounding; wanted translations that bring it nearer to the origin"
        )
