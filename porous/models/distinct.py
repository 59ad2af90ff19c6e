"""The cells of a level that differ: words whose cells coincide are one.

For what is drawn and sampled, where a second cell at the same place adds nothing. What counts
words, or knows cells by their symbols, expands the automaton as it is (``models/automaton.py``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.models.automaton import (
    DEEPEST,
    Automaton,
    Cells,
    cells,
    check_cells,
    count_cells,
    product,
    refined,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

SAME = 2.0**-46
"""Cells of which no control differs by more than this part of the start's size are one.

64 roundings, about ten times what a level's words differ by that ought to be one. Where a drawn
point is mixed with weights whose absolute values sum to w, n levels move it by n·w such parts at
most: with w = 5, as for maps of space, and 20 levels 1.5e-12 of the size, which the kernels' slack
of 1e-6 of a voxel covers up to 700 000 voxels along an edge.
"""

FEW = 1 << 12
"""Levels of so many cells are always looked at; larger ones where words have coincided before."""


def distinct_cells(automaton: Automaton, level: int) -> tuple[tuple[Cells, ...], Indices]:
    """Return the cells of a level that differ, by state, and by place the level each was born at.

    A cell of a terminal state is born once and carried through; all others are born at the level.
    Of cells that coincide in state, birth and controls (to ``SAME``) one is kept, at every level:
    its children are theirs. Places number those that are kept, in lexicographic order of their
    words.

    Raises
    ------
    ModelError
        For a negative level.
    MemoryLimitError
        Before a step that would need too much, and before the first one where no words coincide.
    """
    if level < 0:
        raise ModelError(f"level: got {level}; wanted 0 or more")
    groups, births, coincide = cells(automaton, 0), np.zeros(1, np.int64), False
    for depth in range(1, level + 1):
        many = count_cells(automaton, 1, groups)
        looks = coincide or many <= FEW
        amount = many if looks else count_cells(automaton, level - depth + 1, groups)
        check_cells(automaton, amount, f"level {level}")
        groups, births = _deeper(automaton, groups, births, depth, looks=looks)
        coincide = coincide or len(births) < many
    return groups, births


def count_distinct(automaton: Automaton, level: int, most: int) -> int:
    """Return the number of a level's cells that differ, or a bound on it.

    Below the first level for which more than ``most`` cells would be looked at, words are counted.
    """
    groups, births = cells(automaton, 0), np.zeros(1, np.int64)
    for depth in range(1, level + 1):
        if count_cells(automaton, 1, groups) > most:
            return count_cells(automaton, level - depth + 1, groups)
        groups, births = _deeper(automaton, groups, births, depth, looks=True)
    return len(births)


def cut_set(
    automaton: Automaton, size: float, measure: Callable[[Cells], Floats]
) -> tuple[Cells, ...]:
    """Return the cells that differ of the words that end where one first is smaller than ``size``.

    Cells stop at different depths: a cut set is for rasterising, not for conforming meshes.

    Parameters
    ----------
    size
        Positive; a cell that is as large, give or take 1e-9 of it, is refined.
    measure
        Returns the size of each of a group's cells, (k,).

    Raises
    ------
    ModelError
        For a size that is not positive, or cells that do not shrink.
    MemoryLimitError
        Before a step that would need too much.
    """
    if not size > 0:
        raise ModelError(f"level: got size = {size}; wanted a positive length")
    groups, coincide = cells(automaton, 0), False
    for _ in range(DEEPEST):
        large = {
            g.state: (measure(g) >= size * (1 - 1e-9)) & bool(automaton.children[g.state])
            for g in groups
        }
        if not any(mask.any() for mask in large.values()):
            return groups
        amount = sum(
            len(g.place) + int(large[g.state].sum()) * (len(automaton.children[g.state]) - 1)
            for g in groups
        )
        check_cells(automaton, amount, f"cells smaller than {size:g}")
        groups = refined(automaton, groups, large)
        if coincide or amount <= FEW:
            groups, kept = merged(automaton, groups)
            coincide = coincide or len(kept) < amount
    raise ModelError(f"level: cells are not smaller than {size:g} after {DEEPEST} steps")


def merged(
    automaton: Automaton, groups: Sequence[Cells], births: Indices | None = None
) -> tuple[tuple[Cells, ...], Indices]:
    """Return one of each set of cells that coincide, and the places that they had.

    Parameters
    ----------
    automaton
        Its start's controls say what size is.
    groups
        Cells by state.
    births
        By place: cells of different births are never one. All are of one where not given.
    """
    reach = SAME * float(np.ptp(automaton.states[automaton.start].controls, axis=1).max())
    count = sum(len(group.place) for group in groups)
    kept = np.ones(count, bool)
    for group in groups:
        age = np.zeros(len(group.place)) if births is None else births[group.place]
        kept[group.place[repeated(group.points, age, reach)]] = False
    place = np.cumsum(kept) - 1
    chosen = [kept[group.place] for group in groups]
    left = tuple(
        Cells(group.state, group.points[mask], place[group.place[mask]])
        for group, mask in zip(groups, chosen, strict=True)
    )
    return left, np.flatnonzero(kept)


def repeated(points: Floats, ages: Indices | Floats, reach: float) -> Indices:
    """Return the indices of cells that coincide with another one of their age, which is not.

    Of points (k, 3, m) no coordinate differs by more than ``reach``. A random mixture of a cell's
    numbers is its key: cells that coincide follow each other in the order of the keys. What tells
    is the comparison of all their numbers with the first such cell's.
    """
    flat: Floats = np.column_stack([points.reshape(len(points), -1), ages])
    mixture = np.random.default_rng(0).uniform(1, 2, flat.shape[1:])
    key = product(flat, mixture[:, None])[:, 0]
    order = np.argsort(key, kind="stable")
    starts = np.concatenate([[True], np.diff(key[order]) > reach * mixture.sum()])
    first = order[np.flatnonzero(starts)[np.cumsum(starts) - 1]]
    later = np.flatnonzero(~starts)
    apart = np.abs(flat[order[later]] - flat[first[later]])
    same = (apart[:, :-1] <= reach).all(axis=1) & (apart[:, -1] == 0)
    return np.asarray(order[later[same]])


def _deeper(
    automaton: Automaton, groups: Sequence[Cells], births: Indices, depth: int, *, looks: bool
) -> tuple[tuple[Cells, ...], Indices]:
    """Return the children of cells, and by place the level that each was born at.

    One of those that coincide, if one ``looks``.
    """
    fan, births = np.ones(len(births), np.int64), births.copy()
    for group in groups:
        children = len(automaton.children[group.state])
        births[group.place] = depth if children else births[group.place]
        fan[group.place] = max(1, children)
    below, births = refined(automaton, groups), np.repeat(births, fan)
    if not looks:
        return below, births
    below, kept = merged(automaton, below, births)
    return below, births[kept]
