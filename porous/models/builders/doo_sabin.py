"""Doo and Sabin's surface about an extraordinary point: a quarter of a face with n corners.

The surface of control points that are the corners of faces: every corner has a new point in every
face that it is of (Doo & Sabin 1978), so that faces shrink to points of the surface, their middles.
Where four faces of four corners meet, the surface is biquadratic. The *cell* is the part of the
surface that belongs to one corner of a face with n: it is again a cell at the face, and three
*patches*. Two of its edges, the *spokes*, end in the middle of that face, the *hub*.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.models.brep import Boundary, CellState, Child, selection
from porous.models.builders._assembled import assembled, called
from porous.models.builders._builder import Builder, Options, build_cell

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.models.brep import BRep

    Floats = NDArray[np.float64]
    Corner = tuple[int, int]

CELLS = {f"doo-sabin-{n}": n for n in range(3, 9)}
"""Number of corners of the extraordinary face of each cell."""

START, SPOKE, HUB, PATCH, EDGE, VERTEX = range(6)
"""Indices of the states."""

DECIMALS = 15
"""Sines and cosines are rounded to so many: those of right angles are whole numbers."""


_GRID = [(u, v) for u in range(3) for v in range(3)]


class _Net(NamedTuple):
    """The controls of a cell: a grid of 3 × 3, its first corner replaced by n − 3 others.

    Corners of the grid are (u, v); those that replace (0, 0) are (−i, −i), i = 1 … n − 3.
    """

    n: int

    @property
    def hub(self) -> list[Corner]:
        """The corners of the extraordinary face, all the way round from (1, 1)."""
        return [(1, 1), (0, 1), *((-i, -i) for i in range(1, self.n - 2)), (1, 0)]

    @property
    def corners(self) -> list[Corner]:
        """All controls in their order: of four corners that of the grid."""
        return [*self.hub[2:-1], *_GRID[1:]]

    def face(self, u: int, v: int) -> list[Corner]:
        """Return the corners of the face between (u, v) and (u + 1, v + 1), all the way round."""
        return [(u, v), (u, v + 1), (u + 1, v + 1), (u + 1, v)] if (u, v) != (0, 0) else self.hub

    def place(self, chosen: Sequence[Corner]) -> list[int]:
        """Return which controls corners are."""
        return [self.corners.index(corner) for corner in chosen]

    def point(self, corner: Corner, face: Sequence[Corner]) -> Floats:
        """Return the weights of the new point of a corner in a face."""
        weights = np.zeros(len(self.corners))
        weights[self.place(face)] = _ring(len(face))[face.index(corner)]
        return weights

    def grid(self, u: int, v: int) -> dict[Corner, Floats]:
        """Return the weights of the new 3 × 3 controls of the quarter (u, v), by their corners."""
        return {
            (a, b): self.point(
                ((a + u + 1) // 2, (b + v + 1) // 2), self.face((a + u) // 2, (b + v) // 2)
            )
            for a, b in _GRID
            if (a + u, b + v) != (0, 0)
        }

    def quarter(self, u: int, v: int) -> Floats:
        """Return the matrix of a quarter: the cell's at (0, 0), else a patch's."""
        points = self.grid(u, v)
        if (u, v) == (0, 0):
            points |= {corner: self.point(corner, self.hub) for corner in self.hub[2:-1]}
            return np.stack([points[corner] for corner in self.corners], axis=1)
        return np.stack(list(points.values()), axis=1)


def _ring(k: int) -> Floats:
    """Return the weights (k, k) of a face's corners in the new points of each of its corners.

    (k + 5)/(4k) of its own, (3 + 2 cos 2πj/k)/(4k) of one j further round.
    """
    steps = np.abs(np.subtract.outer(np.arange(k), np.arange(k)))
    steps = np.minimum(steps, k - steps)
    own = (k + 5) / (4 * k)
    return np.asarray(np.where(steps == 0, own, (3 + 2 * _cos(steps / k)) / (4 * k)))


def _cos(turns: Floats) -> Floats:
    return np.asarray(np.round(np.cos(2 * np.pi * turns), DECIMALS), np.float64)


def _build(options: Options) -> BRep:
    """Return the cell at a corner of a face with n, ``keep`` of its quarters; all if not told.

    Raises
    ------
    ModelError
        For a number of controls that the cell does not have, children that are not there.
    """
    net = _Net(CELLS[options.cell])
    size = len(net.corners)
    if options.controls not in (None, size):
        raise ModelError(f"controls: got {options.controls}; wanted {size}, those of its faces")
    regular = build_cell(Options("biquadratic")).states
    names = {0: (PATCH, "patch"), 1: (EDGE, "edge"), 2: (VERTEX, "vertex")}
    patch, edge, vertex = called(regular, names)
    states = (_cell(net, patch), _spoke(net, patch), _hub(net), patch, edge, vertex)
    return assembled(states, options.keeping("cell"))


def _cell(net: _Net, patch: CellState) -> CellState:
    size = len(net.corners)
    spokes = {"UMIN": [*net.hub, (1, 2), (0, 2)], "VMIN": [*_turned(net.hub), (2, 0), (2, 1)]}
    own = {name: (SPOKE, net.place(corners)) for name, corners in spokes.items()}
    own["V00"] = HUB, net.place(net.hub)
    for boundary in patch.boundaries:
        if boundary.name not in own:
            chosen = [divmod(int(i), 3) for i in boundary.matrix.argmax(axis=0)]
            own[boundary.name] = boundary.state, net.place(chosen)
    quarters = {(u, v): net.quarter(u, v) for u, v in product(range(2), repeat=2)}
    return CellState(
        "cell",
        "quad",
        _positions(net),
        tuple(
            Boundary(boundary.name, own[boundary.name][0], selection(size, own[boundary.name][1]))
            for boundary in patch.boundaries
        ),
        tuple(
            Child(f"{u}{v}", PATCH if u or v else START, matrix)
            for (u, v), matrix in quarters.items()
        ),
    )


def _turned(ring: list[Corner]) -> list[Corner]:
    """Return the same ring from its last corner on."""
    return ring[-1:] + ring[:-1]


def _spoke(net: _Net, patch: CellState) -> CellState:
    """Return the edge u = 0: the hub's corners, then the other two of the face at its end."""
    n = net.n
    chosen = net.place([*net.hub, (1, 2), (0, 2)])
    near = net.quarter(0, 0)[:, chosen]
    far = net.quarter(0, 1) @ next(b.matrix for b in patch.boundaries if b.name == "UMIN")
    ends = (HUB, list(range(n))), (VERTEX, [1, n + 1, 0, n])
    return CellState(
        "spoke",
        "edge",
        _positions(net)[:, chosen],
        tuple(
            Boundary(f"V{side}", state, selection(n + 2, own))
            for side, (state, own) in enumerate(ends)
        ),
        (Child("0", SPOKE, near[chosen]), Child("1", EDGE, far[chosen])),
    )


def _hub(net: _Net) -> CellState:
    positions = _positions(net)[:, net.place(net.hub)]
    return CellState("hub", "vertex", positions, (), (Child("0", HUB, _ring(net.n)),))


def _positions(net: _Net) -> Floats:
    """Return controls (3, m) about the hub, all its n cells alike; of four corners a square's grid.

    The cell lies between the axes at the angles 0 and 2π/n.
    """
    turn = _rotation(1 / net.n)
    axes = np.array([[1.0, 0], turn[:, 0]]).T
    places = {(a, b): axes @ (a - 0.5, b - 0.5) for a, b in product(range(1, 3), repeat=2)}
    for i in range(1, net.n - 1):
        places[net.hub[i]] = _rotation(i / net.n) @ places[1, 1]
    back = turn.T
    places[1, 0] = back @ places[1, 1]
    places[2, 0] = back @ places[1, 2]
    places[0, 2] = turn @ places[2, 1]
    flat = np.array([places[corner] for corner in net.corners]).T
    return np.vstack([flat, np.zeros(len(net.corners))])


def _rotation(turns: float) -> Floats:
    c, s = _cos(np.array([turns, turns - 0.25]))
    return np.array([[c, -s], [s, c]])


CELL = Builder(tuple(CELLS), _build, ("keep", "controls"))
