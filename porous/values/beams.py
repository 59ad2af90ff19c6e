"""A lattice of beams: nodes, and round struts between them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError
from porous.values.box import Box
from porous.values.surface import indices_checked, points_checked
from porous.values.units import check_unit
from porous.values.value import Value, frozen, frozen_whole

if TYPE_CHECKING:
    from numpy.typing import NDArray

CAPS = ("sphere", "hemisphere", "butt")
"""How beams may end: in the ball of the end's radius, in half of one, or cut off flat."""


@dataclass(frozen=True, eq=False)
class BeamLattice(Value):
    """Beams between nodes, and balls on nodes; the body is their union.

    Parameters
    ----------
    points
        Nodes, float64, shape (n, 3), in ``unit``.
    beams
        int64, shape (e, 2): the nodes that each beam joins.
    radii
        float64, shape (e, 2), in ``unit``: at both ends; between them the radius changes evenly.
    balls, ball_radii
        int64 and float64, shape (b,): nodes that are centres of balls, and their radii.
    cap
        How beams end, of ``CAPS``. With ``"sphere"`` a beam of one radius is what a ball sweeps
        that runs along it.
    clip
        A box; what lies outside is no part of the body. None where there is nothing to cut off.
    unit
        Unit of length.

    Raises
    ------
    MeshError
        For numbers that are not finite, indices out of range, radii that are not above zero,
        beams from a node to itself.
    """

    points: NDArray[np.float64] = field(repr=False)
    beams: NDArray[np.int64] = field(repr=False)
    radii: NDArray[np.float64] = field(repr=False)
    balls: NDArray[np.int64] = field(default=(), repr=False)  # type: ignore[arg-type]
    ball_radii: NDArray[np.float64] = field(default=(), repr=False)  # type: ignore[arg-type]
    cap: str = "sphere"
    clip: Box | None = None
    unit: str = "mm"

    def __post_init__(self) -> None:
        check_unit(self.unit)
        self._set("points", frozen(self.points, np.float64))
        for name, dtype in (("beams", np.int64), ("balls", np.int64)):
            self._set(name, frozen_whole(getattr(self, name), dtype, name, MeshError))
        for name in ("radii", "ball_radii"):
            self._set(name, frozen(getattr(self, name), np.float64))
        points_checked(self.points, "beam lattice")
        indices_checked(self.beams, len(self.points), 2, "beams")
        indices_checked(self.balls[:, None], len(self.points), 1, "balls")
        _check_radii("radii", self.radii, self.beams.shape)
        _check_radii("ball_radii", self.ball_radii, self.balls.shape)
        if len(idle := np.flatnonzero(self.beams[:, 0] == self.beams[:, 1])):
            raise MeshError(f"beams: beam {idle[0]} joins node {self.beams[idle[0], 0]} to itself")
        if self.cap not in CAPS:
            raise MeshError(f"cap: got {self.cap!r}; wanted one of {', '.join(CAPS)}")

    @property
    def lengths(self) -> NDArray[np.float64]:
        """Length of each beam from node to node, shape (e,), in ``unit``."""
        ends = self.points[self.beams]
        return np.asarray(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))

    @property
    def box(self) -> Box:
        """A box of the body: of balls of the ends' radii, and not more than ``clip``.

        Raises ``MeshError`` where there is nothing.
        """
        centres = np.concatenate([self.points[self.beams].reshape(-1, 3), self.points[self.balls]])
        if not len(centres):
            raise MeshError("beam lattice: got no beams and no balls; nothing has no box")
        reach = np.concatenate([self.radii.ravel(), self.ball_radii])[:, None]
        lower, upper = (centres - reach).min(axis=0), (centres + reach).max(axis=0)
        if self.clip is not None:
            lower, upper = np.maximum(lower, self.clip.lower), np.minimum(upper, self.clip.upper)
        return Box(tuple(lower), tuple(upper))


def _check_radii(name: str, radii: NDArray[np.float64], shape: tuple[int, ...]) -> None:
    if radii.shape != shape:
        raise MeshError(f"{name}: got shape {radii.shape}; wanted {shape}")
    if len(bad := np.flatnonzero(~((radii > 0) & (radii < np.inf)))):
        raise MeshError(f"{name}: got {radii.flat[bad[0]]}; wanted lengths above zero")
