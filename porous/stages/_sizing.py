"""How long edges shall be where: a field of lengths, and the lattice that a mesher reads it on."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise, permutations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import MeshError
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from porous.values import Box

    Floats = NDArray[np.float64]
    Field = Callable[[Floats], Floats]

GROWTH = 0.5
"""How much edges may grow per length from a box that is to be finer."""

COARSEST, FINEST = 8, 24
"""Cells of the lattice along its longest edge, to begin with and at most."""

TRUE = 0.1
"""Relative error of the lattice's values at which it is fine enough."""


@dataclass(frozen=True, eq=False)
class Finer(Value):
    """A box in which edges shall be shorter; beyond it they grow by half the way from it.

    Parameters
    ----------
    box
        In the surface's unit.
    edge_length
        Wanted in it, in the same unit.

    Raises
    ------
    MeshError
        For a length that is not positive.
    """

    box: Box
    edge_length: float

    def __post_init__(self) -> None:
        if not 0 < self.edge_length < np.inf:
            raise MeshError(f"edge_length: got {self.edge_length}; wanted a positive number")


class Background(NamedTuple):
    """Wanted edge lengths at the points of tetrahedra that fill a box."""

    points: Floats
    """(n, 3)"""
    tets: NDArray[np.int64]
    """(t, 4)"""
    lengths: Floats
    """(n,)"""


def background(
    sizing: Field | Sequence[Finer], box: Box, *, edge_length: float | None
) -> Background:
    """Return the field of wanted edge lengths on a lattice about a box.

    The lattice has planes on the sides of finer boxes, and as many others as it takes until
    values between its points are right to a tenth, or 24 cells along the longest edge.

    Parameters
    ----------
    sizing
        A function from points (n, 3) to wanted lengths (n,), or boxes that are to be finer.
    box
        What is to be meshed.
    edge_length
        The longest edge wanted anywhere; required for boxes.

    Raises
    ------
    MeshError
        Where the function gives no positive number for each point; for a box that is to be finer
        and lies beyond ``box``.
    """
    if not callable(sizing):
        _check_there(sizing, box)
    reach = 0.1 * float(np.linalg.norm(box.lengths))
    around = box.grown(2 * reach if edge_length is None else reach + edge_length)
    finer: Sequence[Finer]
    if callable(sizing):
        finer, field = (), _checked(sizing, edge_length)
    else:
        assert edge_length is not None
        finer, field = sizing, _graded(sizing, edge_length)
    count = COARSEST
    while True:
        axes = _axes(around, count, finer, edge_length)
        lengths = field(_lattice(axes)).reshape([len(axis) for axis in axes])
        if count >= FINEST or _is_true(field, axes, lengths):
            return Background(_lattice(axes), _tets(lengths.shape), lengths.ravel())
        count = min(2 * count, FINEST)


def _check_there(finer: Sequence[Finer], box: Box) -> None:
    for part in finer:
        low, high = np.array(part.box.lower), np.array(part.box.upper)
        if (low > box.upper).any() or (high < box.lower).any():
            raise MeshError(
                f"finer: the box {_ends(part.box)} lies beyond the body, which is within "
                f"{_ends(box)}; wanted one that has some of it"
            )


def _ends(box: Box) -> str:
    lower, upper = (", ".join(f"{x:g}" for x in end) for end in (box.lower, box.upper))
    return f"({lower}) … ({upper})"


def _checked(sizing: Field, edge_length: float | None) -> Field:
    """Return the field with its values checked, none above the general edge length."""

    def field(points: Floats) -> Floats:
        lengths = np.asarray(sizing(points), dtype=np.float64)
        if lengths.shape != (len(points),) or not ((lengths > 0) & (lengths < np.inf)).all():
            wrong = lengths.ravel()[~((lengths > 0) & (lengths < np.inf)).ravel()]
            got = f"{wrong[0]}" if len(wrong) else f"shape {lengths.shape}"
            raise MeshError(
                f"sizing: got {got} for {len(points)} points; wanted one positive length for each"
            )
        return lengths if edge_length is None else np.minimum(lengths, edge_length)

    return field


def _graded(finer: Sequence[Finer], edge_length: float) -> Field:
    def field(points: Floats) -> Floats:
        lengths = np.full(len(points), edge_length)
        for part in finer:
            outside = np.maximum(part.box.lower - points, points - part.box.upper)
            way = np.linalg.norm(np.maximum(outside, 0.0), axis=1)
            lengths = np.minimum(lengths, part.edge_length + GROWTH * way)
        return lengths

    return field


def _axes(
    box: Box, count: int, finer: Sequence[Finer], edge_length: float | None
) -> tuple[Floats, ...]:
    """Return the lattice's planes: even ones, and those where finer boxes begin to be felt."""
    step = max(box.lengths) / count
    axes = []
    for axis, (low, high) in enumerate(zip(box.lower, box.upper, strict=True)):
        planes = [np.linspace(low, high, max(2, round((high - low) / step) + 1))]
        for part in finer:
            ends = np.array([part.box.lower[axis], part.box.upper[axis]])
            assert edge_length is not None
            way = max(0.0, edge_length - part.edge_length) / GROWTH
            planes += [ends, ends + np.array([-way, way])]
        found = np.clip(np.unique(np.concatenate(planes)), low, high)
        apart = np.diff(found, prepend=-np.inf) > 1e-9 * (high - low)
        axes.append(found[apart])
    return tuple(axes)


def _lattice(axes: Sequence[Floats]) -> Floats:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _is_true(field: Field, axes: Sequence[Floats], lengths: Floats) -> bool:
    """Tell whether the middles of the cells have about the means of their corners."""
    middles = [(axis[1:] + axis[:-1]) / 2 for axis in axes]
    for axis in range(3):
        lengths = (np.delete(lengths, 0, axis) + np.delete(lengths, -1, axis)) / 2
    wanted = field(_lattice(middles)).reshape(lengths.shape)
    return bool((np.abs(lengths - wanted) <= TRUE * wanted).all())


def _tets(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return six tetrahedra for each cell of a lattice of points (H. W. Kuhn 1960)."""
    index = np.arange(np.prod(shape)).reshape(shape)
    first = index[:-1, :-1, :-1].ravel()
    strides = (shape[1] * shape[2], shape[2], 1)
    tets = []
    for order in permutations(range(3)):
        steps = np.concatenate([[0], np.cumsum([strides[axis] for axis in order])])
        turned = sum(a > b for a, b in pairwise((*order, order[0]))) == 2  # an odd permutation
        tets.append(first[:, None] + (steps[[0, 2, 1, 3]] if turned else steps))
    return np.concatenate(tets)
