"""How small the details of a prefractal are: its thinnest cell, its narrowest pore."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.models.automaton import frames
from porous.models.dimension import ratios, singular_values
from porous.models.distinct import count_distinct, distinct_cells

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.models.automaton import Automaton
    from porous.models.digits import DigitSet

MOST_CELLS = 200_000
"""Up to so many cells of maps that are no similarities are looked at one by one."""


def least_shrinkage(automaton: Automaton, level: int) -> float:
    """Return min σ_min(A_w) over the words of the level, or a lower bound on it.

    The product of the ratios where all maps are similarities; else the cells' own singular values
    where there are at most ``MOST_CELLS``, beyond that the product of the maps' σ_min, which
    bounds them from below. Terminal cells count as they are.
    """
    scale = ratios(automaton)
    if scale is None and count_distinct(automaton, level, MOST_CELLS) <= MOST_CELLS:
        return thinnest(frames(automaton, distinct_cells(automaton, level)[0]))
    steps = singular_values(automaton)[:, 2] if scale is None else scale
    least = [1.0] * len(automaton.states)
    for _ in range(level):
        deeper = [np.inf if children else 1.0 for children in automaton.children]
        for t, step in zip(automaton.transitions, steps, strict=True):
            deeper[t.source] = min(deeper[t.source], float(step) * least[t.target])
        least = deeper
    return least[automaton.start]


def thinnest(placed: NDArray[np.float64]) -> float:
    """Return the least singular value of frames (k, 3, 4)."""
    return float(np.linalg.svd(placed[:, :, :3], compute_uv=False)[:, 2].min())


def narrowest_run(digits: DigitSet, level: int) -> int | None:
    """Return the shortest run of void voxels between two solid ones along an axis.

    Over all lines along x, y and z of the level's N^level voxels; None where no line has one.
    Exact for any level: a line of level n is a line of level n−1 repeated where the level-1 line
    is solid, so a gap is a gap within a copy, or what one copy leaves at its end, whole void
    copies, and what the next leaves at its start.
    """
    runs = [_narrowest_along(digits, level, axis) for axis in range(3)]
    return min((run for run in runs if run is not None), default=None)


def _narrowest_along(digits: DigitSet, level: int, axis: int) -> int | None:
    n = digits.divisions
    gaps, ends = _gaps(digits, axis)
    least = min(ends)
    best: int | None = None
    shortest, shortest_positive = 0, None
    # ``shortest``: what a line of the level below leaves at its two ends together, at least;
    # ``shortest_positive``: the same over the lines that leave something.
    side = 1
    for _ in range(level):
        for gap in gaps:
            run = gap * side + shortest if gap else shortest_positive
            if run is not None and (best is None or run < best):
                best = run
        options = [e * side + shortest for e in ends if e * side + shortest > 0]
        if shortest_positive is not None:
            options += [e * side + shortest_positive for e in ends]
        shortest, shortest_positive = least * side + shortest, min(options, default=None)
        side *= n
    return best


def _gaps(digits: DigitSet, axis: int) -> tuple[set[int], set[int]]:
    """Return the gaps between neighbouring kept sub-cubes of a line, and voids at both ends."""
    across = [a for a in range(3) if a != axis]
    order = np.lexsort([digits.keep[:, axis], *digits.keep[:, across].T])
    kept = digits.keep[order]
    new = (kept[1:, across] != kept[:-1, across]).any(axis=1)
    steps = np.diff(kept[:, axis]) - 1
    gaps = {int(step) for step in np.unique(steps[~new])}
    first = kept[np.concatenate([[True], new]), axis]
    last = kept[np.concatenate([new, [True]]), axis]
    return gaps, {int(end) for end in np.unique(first + digits.divisions - 1 - last)}
