"""Limits of cells with control points in voxels: covers with a certificate, and grown by a ball.

The limit of a state is a set of weights, and a cell's part of the figure the image of it under the
cell's control points. Intervals that hold the weights (``models.weight_intervals``; entries may be
negative) therefore give every cell a box that is certain to hold its part.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.memory import check_memory
from porous.models.adapted import EPSILON
from porous.models.automaton import Automaton, Cells, State, Transition, product
from porous.models.control_box import control_box, narrowed
from porous.models.cover import COARSE, FINE, MOST_STEPS, ROUNDING, STEPS_PER_VOXEL
from porous.models.drawing import Drawing, body, nothing
from porous.models.net import Net, Window
from porous.models.rational import is_rational, positions, scaled
from porous.models.weight_intervals import endless, intervals, weights_of
from porous.values import CENTRE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.kernels.cell_cover import Descent, Weighed
    from porous.models.weight_intervals import Endless, Intervals, Weights
    from porous.values import Frame, Pattern

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

NARROWER = 0.98
"""Intervals are narrowed as long as the sum of their lengths falls below this part of it, …"""

ROUNDS = 8
"""… and no more often than this."""

SIMPLEX_BYTES = 200
"""Memory of a simplex that is drawn, about."""

BOX = 0.01
"""The box of a limit may be too large by this part of its longest edge."""

ROUNDED = 64 * EPSILON
"""What sums of a few numbers may be off by, as a part of them."""

EDGE = 1e-3
"""What marks the voxels of bodies exactly may err by this part of a voxel."""


def cover_cells(
    automaton: Automaton,
    frame: Frame,
    *,
    drawings: tuple[Drawing, ...] = (),
    offset: float = 0.0,
) -> tuple[NDArray[np.uint64], float]:
    """Mark every voxel that a limit touches, possibly a few more, with a Hausdorff bound.

    Words are descended with boxes that are certain to hold their part of the limit, each within
    its parent's, down to a half diagonal of ε = min(spacing) / 16; every voxel that a last box
    touches is marked. So the limit lies in marked voxels, and every point of these is within a
    voxel's diagonal + 2 ε of it. The marks depend on the lattice alone: not on the order of the
    maps, the tile or the threads.

    Parameters
    ----------
    automaton
        States of any number of controls; matrices may be negative. The level-0 cells' controls are
        in the world.
    frame
        The voxels.
    drawings
        What the cells of each state are drawn as, of which only those of states whose paths end
        count: such cells, of any level, belong to the limit. None where all paths are endless.
    offset
        Radius of the ball that the limit is grown by, zero or more. Grown sets are covered by
        balls about a net of the limit, as in ``sample_cells``.

    Returns
    -------
    uint64 marks of shape ``frame.shape``, 0 or 1; the bound in the frame's unit.

    Raises
    ------
    ModelError
        Where no bounds on the weights are found, cells overlap so much that the work has no end in
        sight, or what ends is swept by balls or shall grow by one.
    """
    check_limit(automaton, _drawn(automaton, drawings), offset)
    limit = _limit(automaton, drawings)
    if offset > 0:
        net = _net(limit, frame, offset + frame.diagonal)
        masks = net.grown(frame, CENTRE, offset + net.error + frame.diagonal / 2)
        return masks, (frame.diagonal + 2 * net.error) * ROUNDING
    h = min(frame.spacing)
    window = _Window.of(frame)
    roots = limit.roots(np.array(frame.origin), window.spacing)
    descent = window.descent(limit, roots, window.empty())
    marks = window.marked(descent, h / FINE, whole=True).astype(np.uint64)
    bound = (frame.diagonal + 2 * h / FINE) * ROUNDING
    for found, error in _ended(limit, descent, frame):
        marks |= found
        bound = max(bound, error)
    return marks, bound


def sample_cells(
    automaton: Automaton,
    frame: Frame,
    pattern: Pattern,
    *,
    drawings: tuple[Drawing, ...] = (),
    offset: float,
) -> NDArray[np.uint64]:
    """Return the masks of a limit grown by a ball of radius ``offset``.

    Balls are drawn about a net: the cells, on a lattice finer than the voxels, that hold a point
    of each small part of the limit. The net's Hausdorff distance from the limit is at most 1.37
    cells, a cell being a quarter of a voxel's shortest edge, or a 48th of the offset where that is
    larger; so what is drawn lies within that distance of the true body.

    Parameters and errors as in ``cover_cells``; ``pattern`` says where samples lie.

    Raises
    ------
    ModelError
        Also for an offset of zero: no sample point lies in a set without volume.
    """
    if not offset > 0:
        raise ModelError(
            f"offset: got {offset}; wanted a length above zero, for the limit has no volume of its "
            'own; or sampling = "cover"'
        )
    check_limit(automaton, _drawn(automaton, drawings), offset)
    return _net(_limit(automaton, drawings), frame, offset).grown(frame, pattern, offset)


def check_limit(automaton: Automaton, drawings: tuple[Drawing, ...], offset: float) -> None:
    """Raise ``ModelError`` where a limit cannot be covered: every path ends, or as above."""
    states = automaton.states
    open_ = _open(automaton)
    for group in automaton.level_zero:
        if group.state not in open_:
            raise ModelError(
                f'level: "limit" wants endless paths; all that start from '
                f"{states[group.state].name!r} end. Wanted a number"
            )
    for q in sorted(set(range(len(states))) - open_):
        if automaton.children[q] or drawings[q].is_empty:
            continue
        if drawings[q].reach:
            raise ModelError(
                f'level: "limit" draws ever smaller cells of {states[q].name!r}, whose radius or '
                "thickness does not shrink with them; wanted solids, or a number"
            )
        if offset > 0:
            raise ModelError(
                f'offset: level = "limit" does not grow the cells of {states[q].name!r}, which '
                "end; wanted no offset, or a number"
            )


def _open(automaton: Automaton) -> set[int]:
    """Return the states with endless paths."""
    found = set(range(len(automaton.states)))
    while ending := {q for q in found if not {t.target for t in automaton.children[q]} & found}:
        found -= ending
    return found


# --- what is known of a limit --------------------------------------------------------------


class _End(NamedTuple):
    """A cell that ends, below an endless state: its state, and its controls' weights (m, k)."""

    state: int
    matrix: Floats


@dataclass(frozen=True)
class _Limit:
    """The maps of weights for the kernel, and the cells that end below each endless state."""

    automaton: Automaton
    drawings: tuple[Drawing, ...]
    weights: Weights
    held: Intervals
    weighed: Weighed
    cells: tuple[tuple[int, Floats], ...]
    ends: tuple[tuple[_End, ...], ...]

    @cached_property
    def box(self) -> tuple[Floats, Floats]:
        """Lower and upper corner of a box that holds the limit."""
        silent: dict[int, tuple[int, ...]] = dict.fromkeys(range(len(self.automaton.states)), ())
        places = [positions(controls) for _, controls in self.cells]
        size = max(float(np.ptp(own, axis=1).max()) for own in places)
        found = control_box(self.automaton, tolerance=BOX * size, drawn=silent)
        return np.array(found.lower), np.array(found.upper)

    def roots(self, origin: Floats, cell: Floats) -> list[tuple[int, Floats]]:
        """Return the level-0 cells' states, rows, offsets and errors in cells of a lattice."""
        result = []
        for q, controls in self.cells:
            rows = self._rows(q, controls)
            # x − origin is (w·x − w·origin) / w: a divisor of one where there is none.
            divisor = rows[3] if is_rational(rows) else np.eye(1, rows.shape[1], rows.shape[1] - 2)
            shift = origin[:, None] * divisor
            size = np.abs(shift[:, :-2]) @ self._sizes(q) + np.abs(shift[:, -2])
            shift[:, -1] = -np.abs(shift[:, -1]) - ROUNDED * size
            result.append((q, np.vstack([(rows[:3] - shift) / cell[:, None], rows[3:]])))
        return result

    def _sizes(self, q: int) -> Floats:
        return np.asarray(np.maximum(np.abs(self.held.lower[q]), np.abs(self.held.upper[q])))

    def _rows(self, q: int, controls: Floats) -> Floats:
        """Return how the controls' rows depend on a state's coordinates, offsets and errors."""
        z, width = controls[:, :-1] - controls[:, -1:], controls.shape[1] - 1
        X, c = self.weights.bases[q], self.weights.centres[q]
        rows = z @ X[:width]
        place = z @ c[:width] + controls[:, -1]
        # Y·X is nearly one; by how much it is not shows in rows·y.
        Y = (self.weights.controls[q][:-1] - self.weights.controls[q][-1]).T
        size = np.abs(Y) @ np.abs(X[:width])
        defect = np.abs(Y @ X[:width] - np.eye(len(X))) + (len(X) + 8) * EPSILON * size
        reach = self._sizes(q)
        sizes = np.abs(z) @ np.abs(X[:width])
        error = 2 * sizes @ (defect @ reach + (len(X) + 8) * EPSILON * reach)
        error += (len(X) + 8) * EPSILON * (np.abs(z) @ np.abs(c[:width]) + np.abs(place))
        return np.column_stack([rows, place, error])


def _drawn(automaton: Automaton, drawings: tuple[Drawing, ...]) -> tuple[Drawing, ...]:
    return drawings or tuple(nothing(state.size) for state in automaton.states)


@lru_cache(maxsize=8)
def _limit(automaton: Automaton, drawings: tuple[Drawing, ...]) -> _Limit:
    """Return what is known of the limit of an automaton's level-0 cells."""
    drawn = _drawn(automaton, drawings)
    part, ends = _endless(automaton, drawn)
    weights = weights_of(part)
    held = _narrow(weights, intervals(weights))
    cells = tuple(
        (part.states.index(group.state), points)
        for group in automaton.level_zero
        for points in group.points
    )
    weighed = _weighed(weights, held, tuple(bool(own) for own in ends))
    return _Limit(automaton, drawn, weights, held, weighed, cells, ends)


def _endless(
    automaton: Automaton, drawings: tuple[Drawing, ...]
) -> tuple[Endless, tuple[tuple[_End, ...], ...]]:
    """Return the states with endless paths, and what ends below each of them."""
    states, transitions = list(automaton.states), list(automaton.transitions)
    last = [q for q, children in enumerate(automaton.children) if not children]
    for q in last:
        if not drawings[q].is_empty:
            transitions.append(Transition(q, len(states), drawings[q].corners))
            corners = states[q].controls @ drawings[q].corners
            states.append(State(f"{states[q].name}, drawn", corners))
    drawn = dict.fromkeys(range(len(automaton.states)), ())
    extended = Automaton(tuple(states), tuple(transitions), automaton.start, automaton.roots)
    part, _ = endless(extended, drawn)
    ends = tuple(tuple(_ends(automaton, drawings, q)) for q in part.states)
    return part, ends


def _ends(automaton: Automaton, drawings: tuple[Drawing, ...], state: int) -> Iterator[_End]:
    """Yield the drawn cells of all paths from a state that end, by way of none that is endless."""
    open_ = _open(automaton)
    front = [(t.target, t.matrix) for t in automaton.children[state] if t.target not in open_]
    while front:
        q, matrix = front.pop()
        front += [(t.target, matrix @ t.matrix) for t in automaton.children[q]]
        if not automaton.children[q] and not drawings[q].is_empty:
            yield _End(q, matrix)


def _narrow(weights: Weights, held: Intervals) -> Intervals:
    """Return intervals as narrow as some searches make them."""
    for _ in range(ROUNDS):
        before = (held.upper - held.lower).sum()
        held = narrowed(weights, held)
        if (held.upper - held.lower).sum() > NARROWER * before:
            break
    return held


def _weighed(weights: Weights, held: Intervals, ended: tuple[bool, ...]) -> Weighed:
    from porous.kernels.cell_cover import Weighed

    system, n = weights.system, weights.shifts.shape[1]
    reach = np.maximum(np.abs(held.lower), np.abs(held.upper))[system.targets]
    doubts = np.einsum("tij,tj->ti", system.errors, reach) + weights.doubts
    sizes = np.einsum("tij,tj->ti", np.abs(system.matrices), reach) + np.abs(weights.shifts)
    doubts += (2 * n + 8) * EPSILON * sizes
    maps = np.concatenate([system.matrices, weights.shifts[:, :, None], doubts[:, :, None]], axis=2)
    rows = np.column_stack([system.sources, system.targets, maps.reshape(len(maps), -1)]) + 0.0
    rows = np.unique(rows, axis=0)
    first = np.searchsorted(rows[:, 0], np.arange(len(weights.widths) + 1))
    middles, halves = (held.lower + held.upper) / 2, (held.upper - held.lower) / 2
    points = [p[0] if len(p) else middle for p, middle in zip(weights.points, middles, strict=True)]
    return Weighed(
        first,
        rows[:, 1].astype(np.int64),
        rows[:, 2:].reshape(-1, n, n + 2),
        middles,
        halves * (1 + 1e-12) + 1e-15 * reach.max(initial=0.0),
        np.array(points),
        np.array(ended, np.int64),
        np.zeros(len(middles)),
    )


# --- windows -------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Window(Window):
    """A window that the cells of a limit are descended in."""

    def descent(
        self, limit: _Limit, roots: list[tuple[int, Floats]], marks: NDArray[np.uint8]
    ) -> Descent:
        """Return a descent that marks this window's cells."""
        from porous.kernels.cell_cover import Descent

        reach = np.array([_margin(limit, own, self.spacing) for own in limit.ends])
        return Descent(marks, self.start, self.spacing, limit.weighed._replace(reach=reach), roots)

    def marked(self, descent: Descent, size: float, *, whole: bool) -> NDArray[np.uint8]:
        """Return which cells are touched by boxes of half diagonal ``size``, uint8 of 0 and 1.

        Where not ``whole``, which cells hold a point of the limit from such a box.
        """
        limit = MOST_STEPS + STEPS_PER_VOXEL * math.prod(map(int, self.shape))
        # Points of the limit first: most last boxes then touch marked cells only.
        coarse = [step * float(self.spacing.min()) for step in COARSE]
        for stop in (*coarse, size):
            if descent.run(stop, whole=whole and stop == size, limit=limit) > limit:
                raise ModelError(
                    f"the cells of this limit overlap so much that {limit} of them do not decide "
                    "which voxels it touches; choose fewer voxels, or a level"
                )
        return descent.marks


def _margin(limit: _Limit, ends: tuple[_End, ...], spacing: Floats) -> float:
    """Return how far from an endless state's box the cells that end below it may mark voxels."""
    bodies = [limit.drawings[end.state].primitive for end in ends]
    if any(body is not None and body.radius is not None for body in bodies):
        return float(np.linalg.norm(spacing)) / 2 * ROUNDING
    return EDGE * float(spacing.min()) if ends else 0.0


def _ended(
    limit: _Limit, descent: Descent, frame: Frame
) -> Iterator[tuple[NDArray[np.uint64], float]]:
    """Yield the marks, with their bounds, of the cells that end below those that were opened."""
    spacing, origin = np.array(frame.spacing)[:, None], np.array(frame.origin)[:, None]
    for owners, nodes in descent.opened:
        n = nodes.shape[2] - 2
        for q, ends in enumerate(limit.ends):
            opened = nodes[owners == q]
            for end in ends if len(opened) else ():
                y = limit.weights.controls[q].T @ end.matrix
                places = product(opened[:, :, :n], y) + opened[:, :, n, None]
                points = scaled(places, spacing, origin)
                count = len(points)
                simplices = max(1, limit.drawings[end.state].simplices)
                check_memory(count * simplices * SIMPLEX_BYTES, f"{count} cells", "Fewer voxels.")
                group = Cells(end.state, points, np.arange(count))
                drawn = body(limit.drawings, [group], np.zeros(count, np.int64))
                yield drawn.cover(frame)


def _net(limit: _Limit, frame: Frame, reach: float) -> Net:
    """Return the net of the part of a limit within ``reach`` of a frame."""

    def mark(window: Window, marks: NDArray[np.uint8], size: float, *, whole: bool) -> None:
        own = _Window(window.start, window.shape, window.spacing)
        roots = limit.roots(np.array(frame.origin), window.spacing)
        own.marked(own.descent(limit, roots, marks), size, whole=whole)

    return Net.about(frame, reach, limit.box, mark)
