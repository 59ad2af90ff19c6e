"""Which way round cells are, whether they are folded, and what a cell's address reads like."""

from __future__ import annotations

from bisect import bisect_right
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.models.automaton import product
from porous.models.cell_shapes import CUTS
from porous.models.rational import positions
from porous.values.volume_mesh import Block, VolumeMesh

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from porous.models.automaton import Automaton
    from porous.models.brep import BRep
    from porous.models.cell_nodes import Group
    from porous.models.solve import Solution

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

FLAT = 1e-9
"""A Jacobian less than this part of the product of its edges' lengths is none."""

COINCIDENT = 1e-12
"""Controls closer than this part of the largest coordinate are one point."""


def corner_weights(solution: Solution, index: int) -> Floats:
    """Return the weights (m, corners) of a cell's corners in its controls.

    Raises
    ------
    ModelError
        For a vertex state of several controls that does not lead, one child each, to one that is
        its own only child.
    """
    state = solution.brep.states[index]
    which = (state.boundaries[k] for k in solution.brep.of_dimension(index, 0))
    columns = [product(b.matrix, _vertex_weights(solution, b.state)) for b in which]
    return np.hstack([np.zeros((state.size, 0)), *columns])


def _vertex_weights(solution: Solution, index: int, above: tuple[int, ...] = ()) -> Floats:
    """Return the weights (m, 1) of the point that a vertex is: what its rule leaves in place."""
    state = solution.brep.states[index]
    if state.size == 1:
        return np.ones((1, 1))
    after = [child.state for child in state.children]
    if len(after) != 1 or after[0] in above:
        raise ModelError(
            f"mesh: vertex state {state.name} has {state.size} controls and does not lead to a "
            "state that is its own only child; wanted a rule that leaves one point in place"
        )
    if after[0] != index:
        rest = _vertex_weights(solution, after[0], (*above, index))
        return product(solution.matrices[index][0], rest)
    fixed = np.vstack([solution.matrices[index][0] - np.eye(state.size), np.ones(state.size)])
    wanted = np.zeros(state.size + 1)
    wanted[-1] = 1
    return np.asarray(np.linalg.lstsq(fixed, wanted, rcond=None)[0][:, None], np.float64)


def handedness(
    solution: Solution, automaton: Automaton, weights: Mapping[int, Floats], level: int
) -> NDArray[np.int8]:
    """Return for each cell, by place, 1 where it is the right way round and −1 where mirrored.

    Of level-0 cells their volume says so; of a child the volume that it has in its parent's
    reference position. A cell whose own volume says otherwise is folded.
    """
    brep, states = solution.brep, solution.brep.reached
    number = {q: a for a, q in enumerate(states)}
    turns: list[tuple[int, int]] = []
    fans, firsts = [], []
    for q in states:
        firsts.append(len(turns))
        turns += _turns(solution, q, weights, number)
        fans.append(len(turns) - firsts[-1])
    target, turn = np.array(turns).T
    fan, first = np.array(fans), np.array(firsts)
    state, hand = np.empty((2, sum(len(group.place) for group in automaton.level_zero)), np.int64)
    for group in automaton.level_zero:
        q = states[group.state]
        corners = positions(product(group.points, weights[q]))
        state[group.place] = group.state
        hand[group.place] = [_sign(brep, q, spots) for spots in corners]
    for _ in range(level):
        many = fan[state]
        letter = np.arange(many.sum()) - np.repeat(np.cumsum(many) - many, many)
        at = np.repeat(first[state], many) + letter
        hand, state = np.repeat(hand, many) * turn[at], target[at]
    return np.asarray(hand, np.int8)


def _turns(
    solution: Solution, q: int, weights: Mapping[int, Floats], number: Mapping[int, int]
) -> list[tuple[int, int]]:
    """Return for each child its state and −1 where it is turned against its parent."""
    brep, state = solution.brep, solution.brep.states[q]
    own = _sign(brep, q, product(state.controls, weights[q]))
    result = []
    for child, matrix in zip(state.children, solution.matrices[q], strict=True):
        spots = product(product(state.controls, matrix), weights[child.state])
        result.append((number[child.state], own * _sign(brep, child.state, spots)))
    return result or [(number[q], 1)]


def _sign(brep: BRep, index: int, spots: Floats) -> int:
    """Return −1 where a cell with these corners (3, c) has a negative volume, else 1."""
    shape = brep.states[index].shape
    if shape not in CUTS:
        return 1
    kind, variants = CUTS[shape]
    mesh = VolumeMesh(spots.T, (Block(kind, np.array(variants[0])),))
    return -1 if mesh.volumes.sum() < 0 else 1


def check_controls(brep: BRep, controls: Floats, weights: Floats) -> None:
    """Raise ``ModelError`` where two corners of the level-0 cell are one point."""
    spots = positions(product(controls, weights))
    limit = COINCIDENT * float(np.abs(positions(controls)).max())
    gap = np.abs(spots[:, :, None] - spots[:, None, :]).max(axis=0)
    pairs = np.argwhere(np.triu(gap <= limit, 1))
    if len(pairs):
        names = [_control(brep, weights[:, corner], corner) for corner in pairs[0]]
        where = ", ".join(f"{x:.6g}" for x in spots[:, pairs[0][0]])
        raise ModelError(
            f"controls {names[0]} and {names[1]} coincide at ({where}): what lies between them "
            "has no length; wanted corners apart from each other"
        )


def _control(brep: BRep, weights: Floats, corner: int) -> str:
    alone = np.flatnonzero(weights == 1)
    if len(alone) == 1 and np.count_nonzero(weights) == 1:
        return str(alone[0])
    return brep.states[brep.start].boundaries[brep.of_dimension(brep.start, 0)[corner]].name


def check_folds(
    points: Floats, groups: Sequence[Group], brep: BRep, level: int, starts: tuple[int, ...]
) -> None:
    """Raise ``ModelError`` for cells without a positive Jacobian, naming the first one."""
    bad = []
    for group in groups:
        quality = _quality(points, group)
        which = np.flatnonzero(~(quality >= FLAT))
        bad.append(np.column_stack([group.place[which], quality[which]]))
    folded = np.concatenate(bad)
    if len(folded):
        place, least = folded[folded[:, 0].argmin()]
        total = sum(len(group.place) for group in groups)
        raise ModelError(
            f"{address(brep, level, int(place), starts)} is folded or flat: at one corner its "
            f"Jacobian is {least:.3g} of the product of its edges, wanted a positive number; so "
            f"are {len(folded)} of {total} cells. Choose a lower level, less texture or controls "
            "that bend less, or mesh voxels instead"
        )


def _quality(points: Floats, group: Group) -> Floats:
    """Return the least Jacobian of each cell, relative to the lengths of its edges."""
    result = np.empty(len(group.place))
    for variant in group.variants:
        own = group.variant == variant
        corners = group.corners if own.all() else group.corners[own]
        spots = np.ascontiguousarray(points[corners].transpose(1, 2, 0))
        result[own] = _least(spots, group.cut.frames[variant])
    return result


def _least(spots: Floats, frames: Indices) -> Floats:
    """Return the least scaled Jacobian over ``frames`` of cells with corners (c, 3, k)."""
    least = np.full(spots.shape[2], np.inf)
    for origin, *ends in frames:
        (a, b, c), (d, e, f), (g, h, i) = u, v, w = [spots[end] - spots[origin] for end in ends]
        value = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
        size = np.sqrt((u * u).sum(axis=0) * (v * v).sum(axis=0) * (w * w).sum(axis=0))
        np.minimum(
            least, np.divide(value, size, out=np.zeros_like(value), where=size > 0), out=least
        )
    return least


def address(brep: BRep, level: int, place: int, starts: tuple[int, ...] = ()) -> str:
    """Return the address of the cell at a place: ``cell 012.220 (children by name)``.

    ``starts`` are the states of the level-0 cells; the start's where not given.
    """
    amounts = _amounts(brep, level)
    ends = np.cumsum([amounts[level][q] for q in starts or (brep.start,)]).tolist()
    root = bisect_right(ends, place)
    place -= ends[root - 1] if root else 0
    state, names = (starts or (brep.start,))[root], []
    for left in range(level - 1, -1, -1):
        for child in brep.states[state].children:
            if place < amounts[left][child.state]:
                names.append(child.name)
                state = child.state
                break
            place -= amounts[left][child.state]
    if not names:
        return f"level-0 cell {root}" if len(ends) > 1 else "the level-0 cell"
    between = "/" if any("." in name for name in names) else "."
    where = f" of level-0 cell {root}" if len(ends) > 1 else ""
    return f"cell {between.join(names)} (children by name){where}"


def _amounts(brep: BRep, level: int) -> list[dict[int, int]]:
    """Return for each number of levels how many cells come of each state."""
    result = [dict.fromkeys(brep.reached, 1)]
    for _ in range(level):
        last = result[-1]
        result.append(
            {
                q: sum(last[child.state] for child in brep.states[q].children) or last[q]
                for q in brep.reached
            }
        )
    return result
