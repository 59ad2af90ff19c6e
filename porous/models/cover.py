"""Attractors in voxels: covers with a certificate, and their points grown by a ball."""

from __future__ import annotations

import math
import threading
from bisect import bisect_left
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.models.clouds import clouds, fitting, stamp_points
from porous.models.net import Net, Window
from porous.models.overlap import overlaps, reference
from porous.values import CENTRE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.kernels.cover import Descent, System
    from porous.kernels.overlap import Reference
    from porous.models.automaton import Automaton
    from porous.models.clouds import Cloud
    from porous.values import Frame, Pattern

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

FINE = 16
"""Boxes at the end of a descent have half diagonals of a voxel's shortest edge over this."""

COARSE = (4, 2, 1)
"""Half diagonals, in cells, of the descents of a net before the last."""

MOST_STEPS = 20_000_000
STEPS_PER_VOXEL = 300
"""Words that a descent may look at: at least, and per voxel of its window."""

FIRST = 1024
"""Words that are looked at before points are sought: they may be enough."""

FEW = 4096
"""Of about so many voxels that are touched, none are marked by points first: these would cost more
than the words that they spare."""

SLAB = 1 << 19
WORTH = 1 << 15
"""Cells of a slab, and those of them that are marked, about: fewer are not worth a thread …"""

SLABS = 4
"""… and that there are so many of for each."""

MOST_CELLS = (1 << 31) - 1
"""Cells of a slab, at most: they are counted in 32 bits."""

ROUNDING = 1 + 1e-5
"""Covers the kernels' slack."""

_ONE_AT_A_TIME = threading.Lock()


def cover_attractor(
    automaton: Automaton,
    balls: NDArray[np.float64],
    frame: Frame,
    *,
    offset: float = 0.0,
    fine: int = FINE,
) -> tuple[NDArray[np.uint8], float]:
    """Mark every voxel that an attractor touches, possibly a few more, with a Hausdorff bound.

    Words are descended with boxes that are certain to hold their part of the attractor, each
    within its parent's, down to a half diagonal of ε = min(spacing) / 16; every voxel that a last
    box touches is marked, but those that a slab about the part of a shorter word does not touch. So
    the attractor lies in marked voxels, and every point of these is within a voxel's diagonal + 2 ε
    of it. Voxels that hold one of the attractor's points are marked first, where there are not but
    few: a word whose box touches no others can add none, nor can longer ones. Where words
    at one place become ever more with their length (``models/overlap.py``), they are sought
    backwards instead from each voxel that is not marked, down to the same ε. The marks depend on
    the lattice alone: not on the order of the maps, the tile or the threads.

    Parameters
    ----------
    automaton
        With four independent controls in every state.
    balls
        Centre and radius of a ball per state that holds its attractor, (s, 4).
    frame
        The voxels.
    offset
        Radius of the ball that the attractor is grown by, zero or more. Grown sets are covered by
        the balls about a net of the attractor, as in ``sample_attractor``.
    fine
        What part of the shortest edge of a voxel ε is: more than one.

    Returns
    -------
    uint8 marks of shape ``frame.shape``, 0 or 1; the bound in the frame's unit.

    Raises
    ------
    ModelError
        Where words overlap so much that the work has no end in sight.
    """
    if offset > 0:
        net = _net(automaton, balls, frame, offset + frame.diagonal)
        reach = offset + net.error + frame.diagonal / 2
        masks = net.grown(frame, CENTRE, reach)
        return (masks != 0).view(np.uint8), (frame.diagonal + 2 * net.error) * ROUNDING
    size = min(frame.spacing) / fine
    marks = _Window.of(frame).covered(automaton, balls.tobytes(), _root(automaton, frame, 1), size)
    return marks, (frame.diagonal + 2 * size) * ROUNDING


def sample_attractor(
    automaton: Automaton,
    balls: NDArray[np.float64],
    frame: Frame,
    pattern: Pattern,
    *,
    offset: float,
) -> NDArray[np.uint64]:
    """Return the masks of an attractor grown by a ball of radius ``offset``.

    Balls are drawn about a net: the cells, on a lattice finer than the voxels, that hold a point
    of each small part of the attractor. The net's Hausdorff distance from the attractor is at
    most 1.37 cells, a cell being a quarter of a voxel's shortest edge, or a 48th of the offset
    where that is larger; so what is drawn lies within that distance of the true body.

    Parameters and errors as in ``cover_attractor``; ``pattern`` says where samples lie.

    Raises
    ------
    ModelError
        Also for an offset of zero: no sample point lies in a set without volume.
    """
    if not offset > 0:
        raise ModelError(
            f"offset: got {offset}; wanted a length above zero, for the attractor has no volume "
            'of its own; or sampling = "cover"'
        )
    return _net(automaton, balls, frame, offset).grown(frame, pattern, offset)


@dataclass(frozen=True)
class _Window(Window):
    """A window that an attractor's maps of space are descended in."""

    def covered(
        self, automaton: Automaton, given: bytes, root: tuple[int, Floats], size: float
    ) -> NDArray[np.uint8]:
        """Return which cells are touched by boxes of half diagonal ``size``, uint8 of 0 and 1."""
        from porous.kernels._shared import slabs
        from porous.kernels.cover import Descent

        edge = float(self.spacing.min())
        with _ONE_AT_A_TIME:  # threads that want the same wait for one
            system, backwards = _system(automaton, given), _reference(automaton, given)
        marks = self.empty()
        descent = Descent(marks, self.start, self.spacing, system, root)
        if not backwards and descent.run(size, whole=True, limit=FIRST) <= FIRST:
            return marks
        with _ONE_AT_A_TIME:
            known = _Known(system, _clouds(automaton, given, edge), backwards)
        occupied = known.occupied(root[0], edge)
        if not backwards and occupied <= FEW:
            _finish(descent, (size,), whole=True)
            return marks

        thickness = self._thickness(occupied)
        if thickness >= len(marks):  # as tiles are, of which each thread has its own
            self.cover(marks, known, root, size)
            return marks

        def work(first: int, last: int) -> None:
            start, shape = self.start.copy(), np.array(marks[first:last].shape)
            start[0] += first
            _Window(start, shape, self.spacing).cover(marks[first:last], known, root, size)

        slabs(len(marks), thickness, work)
        return marks

    def _thickness(self, occupied: float) -> int:
        """Return of how many planes of cells slabs are, if about so many cells are marked."""
        from porous.kernels._shared import threads

        planes, across = int(self.shape[0]), int(self.shape[1] * self.shape[2])
        many = min(SLABS * threads(), planes * across / SLAB, occupied / WORTH)
        return max(1, min(math.ceil(planes / max(math.floor(many), 1)), MOST_CELLS // across))

    def cover(
        self, marks: NDArray[np.uint8], known: _Known, root: tuple[int, Floats], size: float
    ) -> None:
        """Mark the cells of this window that are touched by boxes of half diagonal ``size``."""
        here = root[1].copy()
        here[:, 3] -= self.start
        # What is sought may be marked although the attractor is as far as 2 ``size``.
        reach = 2 * size / float(self.spacing.min()) if known.reference else 0.0
        given = known.system, known.clouds, (root[0], here), self.shape, self.spacing
        words = fitting(*given, reach)
        # Of a slab that the attractor does not come near, no memory is touched.
        if len(words.states):
            stamp_points(marks, known.clouds, words, self.spacing)
            if known.reference:
                self._seek(marks, known.reference, root, size)
            else:
                self._descend(marks, known.system, root, (size,), whole=True)

    def hold(
        self,
        marks: NDArray[np.uint8],
        system: System,
        root: tuple[int, Floats],
        size: float,
        *,
        whole: bool,
    ) -> None:
        """Mark cells that hold a point of the attractor from a box of half diagonal ``size``.

        Where ``whole``, those that such a box touches.
        """
        # Points of larger boxes first: most last boxes then touch marked cells only.
        coarse = tuple(step * float(self.spacing.min()) for step in COARSE)
        self._descend(marks, system, root, coarse, whole=False)
        self._descend(marks, system, root, (size,), whole=whole)

    def _seek(
        self,
        marks: NDArray[np.uint8],
        known: Reference,
        root: tuple[int, Floats],
        size: float,
    ) -> None:
        from porous.kernels.overlap import seek

        # The root's map is a change of units and origin: place = spacing × (voxel − shift).
        origin = self.spacing * (self.start - root[1][:, 3])
        limit = MOST_STEPS + STEPS_PER_VOXEL * marks.size
        count = seek(marks, origin, self.spacing, known, stop=size, limit=limit)
        if count > limit:
            raise ModelError(_endless(limit))

    def _descend(
        self,
        marks: NDArray[np.uint8],
        system: System,
        root: tuple[int, Floats],
        sizes: tuple[float, ...],
        *,
        whole: bool,
    ) -> None:
        from porous.kernels.cover import Descent

        descent = Descent(marks, self.start, self.spacing, system, root)
        _finish(descent, sizes, whole=whole)


def _finish(descent: Descent, sizes: tuple[float, ...], *, whole: bool) -> None:
    """Run a descent to the end for each of some sizes, or raise where none is in sight."""
    limit = MOST_STEPS + STEPS_PER_VOXEL * descent.marks.size
    for size in sizes:
        if descent.run(size, whole=whole, limit=limit) > limit:
            raise ModelError(_endless(limit))


def _endless(limit: int) -> str:
    return (
        f"the parts of this attractor overlap so much that {limit} words do not decide which "
        "voxels it touches; choose fewer voxels, or a level"
    )


def _net(automaton: Automaton, balls: Floats, frame: Frame, reach: float) -> Net:
    """Return the net of the part of an attractor within ``reach`` of a frame."""
    system = _system(automaton, balls.tobytes())
    ball = balls[automaton.start]

    def mark(window: Window, marks: NDArray[np.uint8], size: float, *, whole: bool) -> None:
        own = _Window(window.start, window.shape, window.spacing)
        own.hold(marks, system, _placed(automaton, frame, window.spacing), size, whole=whole)

    return Net.about(frame, reach, (ball[:3] - ball[3], ball[:3] + ball[3]), mark)


def _root(automaton: Automaton, frame: Frame, split: int) -> tuple[int, Floats]:
    """Return the start state and the map of its space to the cells of a split lattice."""
    return _placed(automaton, frame, np.array(frame.spacing) / split)


def _placed(automaton: Automaton, frame: Frame, cell: Floats) -> tuple[int, Floats]:
    """Return the start state and the map of its space to cells of these edge lengths."""
    root = np.zeros((3, 4))
    for a in range(3):
        root[a, a], root[a, 3] = 1 / cell[a], -frame.origin[a] / cell[a]
    return automaton.start, root


@lru_cache(maxsize=8)
def _system(automaton: Automaton, given: bytes) -> System:
    """Return the automaton's maps by source, each but once, and a point of each attractor."""
    from porous.kernels._shared import source
    from porous.kernels.cover import System
    from porous.kernels.hulls import enclosures

    maps = (automaton.maps.reshape(-1, 12) + 0.0).tolist()
    ends = ((t.source, t.target) for t in automaton.transitions)
    rows = sorted({(*pair, *row) for pair, row in zip(ends, maps, strict=True)})
    sources = [row[0] for row in rows]
    starts = [bisect_left(sources, state) for state in range(len(automaton.states) + 1)]
    for state, some, end in zip(automaton.states, starts, starts[1:], strict=False):
        if some == end:
            raise ModelError(
                f"state {state.name!r}: has no transitions, so nothing says what of it belongs to "
                "the limit; wanted transitions from every state, or a level"
            )
    first, targets = source(starts, np.int64), source([row[1] for row in rows], np.int64)
    maps = source([row[2:] for row in rows], np.float64).reshape(-1, 3, 4)
    balls = np.frombuffer(given).reshape(-1, 4)
    found = enclosures(first, targets, maps, balls)
    return System(first, targets, maps, *(source(array, np.float64) for array in found))


class _Known(NamedTuple):
    """What is known of an attractor before it is covered."""

    system: System
    clouds: tuple[Cloud, ...]
    """Points of each state's attractor."""
    reference: Reference | None
    """The distances from an attractor that is sought backwards."""

    def occupied(self, state: int, edge: float) -> float:
        """Return about how many voxels of this edge a state's attractor is in."""
        return self.clouds[state].occupied(math.sqrt(3) * float(self.system.balls[state, 3]) / edge)


@lru_cache(maxsize=8)
def _clouds(automaton: Automaton, given: bytes, edge: float) -> tuple[Cloud, ...]:
    return clouds(_system(automaton, given), edge)


@lru_cache(maxsize=4)
def _reference(automaton: Automaton, given: bytes) -> Reference | None:
    system = _system(automaton, given)
    return reference(system) if overlaps(system) else None
