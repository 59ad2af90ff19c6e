"""How far from the origin bodies reach, and whether rounding there is less than voxels allow."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.models.rational import positions

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from porous.models.automaton import Automaton
    from porous.values import Box, Frame

    Floats = NDArray[np.float64]

ROUNDINGS = 64 * np.finfo(np.float64).eps
"""What the products of a word's matrices may lose, about, as a part of a coordinate."""

SHARE = 1 / 16
"""Part of a voxel that rounding may move a sampled body by."""

CERTAIN = 1e-7
"""Part of a voxel that the boxes of covers are larger by (``porous.kernels.cover.SLACK``)."""


class Reach(NamedTuple):
    """How far from the origin a body reaches, and how far rounding may move it, in its unit."""

    far: float
    rounding: float

    def check(self, frame: Frame, *, certain: bool) -> None:
        """Refuse a body so far from the origin that rounding moves it by too much of a voxel.

        That is ``SHARE`` of one for samples of cells, and for limits whose boxes hold rounding.
        Where boxes are larger by ``CERTAIN`` of one alone, covers hold the body, and show neither
        tiles nor windows, as long as rounding is less: up to seven million voxels from the origin,
        and less where weights are large.

        Raises
        ------
        ModelError
            Names the coordinates.
        """
        h, share = min(frame.spacing), CERTAIN if certain else SHARE
        if self.rounding > share * h:
            raise ModelError(
                f"model: lies at coordinates up to {self.far:.3g} {frame.unit}, where rounding may "
                f"move it by {self.rounding / h:.2g} of a voxel of {h:.3g}; wanted less than "
                f"{share:.2g}: the body nearer to the origin, or larger voxels"
            )


def attractor_reach(automaton: Automaton, balls: Floats, domain: Box) -> Reach:
    """Return the reach of the attractor of maps of space.

    Entries of the maps lose what weights lose: more the larger weights are than one, and the more
    slender the simplex of a state's controls is than that of the ends of three axes. Cells of a
    state are about as large in the world as the level-0 cell, whatever their own unit.

    Parameters
    ----------
    automaton
        With four independent controls in every state.
    balls
        A ball per state that holds its attractor, (s, 4).
    domain
        The box that is sampled.
    """
    own = np.abs(balls[:, :3]).max(axis=1) + balls[:, 3]
    sizes = np.array([np.ptp(state.controls, axis=1).max() for state in automaton.states])
    slender = [np.abs(state.local_inverse[:, :3]).max() for state in automaton.states]
    lost = own * sizes[automaton.start] / sizes * np.maximum(1.0, sizes * slender)
    far = max(_farthest(domain), float(own[automaton.start]))
    return Reach(far, ROUNDINGS * max(far, float(lost.max())) * _largest_weight(automaton))


def cells_reach(
    automaton: Automaton,
    points: Iterable[Floats],
    domain: Box,
    drawn: Iterable[tuple[Box, Floats | None]] = (),
) -> Reach:
    """Return the reach of cells.

    Controls of cells are products of weights: these lose what the largest is more than one, twice.
    Images of space lose what the weights of its points are.

    Parameters
    ----------
    automaton
        Of the cells.
    points
        Where their controls, or what is drawn on these, lie: arrays (…, 3 or 4, m).
    domain
        The box that is sampled.
    drawn
        Boxes of the primitives that are drawn in cells, and their states' ``inverse`` (4, 4).
    """
    largest = _largest_weight(automaton)
    weights = [_weight_of(box, inverse) for box, inverse in drawn if inverse is not None]
    far = [_farthest(domain), *(float(np.abs(positions(p)).max()) for p in points)]
    return Reach(max(far), ROUNDINGS * max(far) * largest * max([largest, *weights]))


def _weight_of(box: Box, inverse: Floats) -> float:
    corners = np.column_stack([box.corners, np.ones(8)])
    return float(np.abs(corners @ inverse.T).max())


def _farthest(box: Box) -> float:
    return max(map(abs, (*box.lower, *box.upper)))


def _largest_weight(automaton: Automaton) -> float:
    return max(1.0, *(float(np.abs(t.matrix).max()) for t in automaton.transitions))
