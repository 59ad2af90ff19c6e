"""Cells that are tensor products of curves: B-spline patches and blocks, biquadratic to tricubic.

The matrices of a cell are products of its lines', one for each axis, and so are its boundaries:
where an axis is at an end, the line's end is a factor with all its controls. A face of a
triquadratic cell is a face of 3 × 3 controls with two layers of them, 18 in all; its corners are
points that 2 × 2 × 2 controls shrink to, none of the controls.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.memory import check_memory
from porous.models.brep import Boundary, BRep, CellState, Child, selection
from porous.models.builders._cubes import SHAPES, pattern_name, patterns
from porous.models.builders._joins import Covered, Part, Placed, joins

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.models.brep import Adjacency, Incidence
    from porous.models.builders._cubes import Pattern
    from porous.models.builders._curves import Curve

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]
    Joins = tuple[tuple[Incidence, ...], tuple[Adjacency, ...]]

BYTES_PER_CHILD = 200
"""What a child needs beside its matrix for each of its boundaries: constraints and labels."""


class Factor(NamedTuple):
    """One axis of a state: of which class of axes it is, and its arc, or its end where it ends."""

    line: int
    number: int
    free: bool


Kind = tuple[Factor, ...]
"""A state: its free axes, then its ends of several controls; ends of one control are left out."""


class _Step(NamedTuple):
    """What becomes of one axis in a child: its factor, weights, and places of its controls."""

    factor: Factor
    matrix: Floats
    places: Ints


@dataclass(frozen=True, eq=False)
class _Plan:
    """The states of a tensor product, found from the cell on."""

    curves: tuple[Curve, ...]
    keep: tuple[Ints, ...]

    @property
    def start(self) -> Kind:
        """The cell: its axes in their order, those of equal curves of one class."""
        first = [self.curves.index(curve) for curve in self.curves]
        return tuple(Factor(line, 0, free=True) for line in first)

    def size(self, factor: Factor) -> int:
        curve = self.curves[factor.line]
        return (curve.arcs if factor.free else curve.ends)[factor.number].size

    def sizes(self, kind: Kind) -> list[int]:
        return [self.size(factor) for factor in kind]

    def abscissae(self, factor: Factor) -> Floats:
        curve = self.curves[factor.line]
        return (curve.arcs if factor.free else curve.ends)[factor.number].controls

    @cached_property
    def _known(self) -> dict[Factor, list[_Step]]:
        return {}

    def steps(self, factor: Factor) -> list[_Step]:
        """Return the children along one axis."""
        if factor not in self._known:
            self._known[factor] = self._steps(factor)
        return self._known[factor]

    def _steps(self, factor: Factor) -> list[_Step]:
        curve = self.curves[factor.line]
        if not factor.free:
            end = curve.ends[factor.number]
            after = factor._replace(number=end.after)
            return [_Step(after, end.matrix, np.arange(end.matrix.shape[1]))]
        pieces = curve.arcs[factor.number].pieces
        return [
            _Step(factor._replace(number=piece.arc), piece.matrix, places)
            for piece, places in zip(pieces, curve.places(factor.number), strict=True)
        ]

    def ended(self, factor: Factor, side: int) -> tuple[Factor, Ints]:
        """Return an axis's end, and which of its controls are the end's."""
        curve = self.curves[factor.line]
        end = Factor(factor.line, curve.arcs[factor.number].ends[side], free=False)
        own = np.arange(self.size(end))
        return end, own + (self.size(factor) - len(own)) * side

    def arranged(self, factors: Sequence[Factor], *, whole: bool) -> tuple[Kind, list[int]]:
        """Return the state of factors in any order, and the order in which it has them.

        Free axes stay in order in what is ``whole``, go by class in boundaries.
        """
        kept = [axis for axis, f in enumerate(factors) if f.free or self.size(f) > 1]
        free = [axis for axis in kept if factors[axis].free]
        if not whole:
            free.sort(key=lambda axis: factors[axis].line)
        ends = [axis for axis in kept if not factors[axis].free]
        order = free + sorted(ends, key=lambda axis: factors[axis])
        return tuple(factors[axis] for axis in order), order

    def digits(self, kind: Kind) -> list[tuple[int, ...]]:
        """Return the digits that a state keeps: a boundary all there are."""
        free = [f for f in kind if f.free]
        if len(free) == len(self.curves):
            level = self.curves[free[0].line].arcs[free[0].number].level
            return [tuple(digit) for digit in self.keep[level].tolist()]
        return list(product(*(range(len(self.steps(f))) for f in free)))

    def child(self, kind: Kind, digit: tuple[int, ...]) -> tuple[Kind, Floats, Ints]:
        """Return a child's state, its matrix and the places (m,) of its controls.

        Places are numbers of the refined control lattice of the state.
        """
        letters = (*digit, *[0] * (len(kind) - len(digit)))
        chosen = [self.steps(f)[letter] for f, letter in zip(kind, letters, strict=True)]
        child, order = self.arranged([step.factor for step in chosen], whole=True)
        matrix: Floats = np.ones((1, 1))
        for step in chosen:
            matrix = np.asarray(np.kron(matrix, step.matrix), np.float64)
        weights = _weights([step.matrix.shape[1] for step in chosen])
        columns = _spread([np.arange(s.matrix.shape[1]) for s in chosen], weights, order)
        places = _spread([step.places for step in chosen], self.lattice(kind), order)
        return child, matrix[:, columns], places

    def lattice(self, kind: Kind) -> list[int]:
        """Return what a step along each axis of the refined control lattice counts."""
        return _weights([1 + int(self.steps(f)[-1].places[-1]) for f in kind])

    def boundary(self, kind: Kind, pattern: Pattern) -> tuple[Kind, list[int], Ints]:
        """Return a boundary's state, the order of its axes, and which controls are its own."""
        factors, own = self.parts(kind, pattern)
        state, order = self.arranged(factors, whole=False)
        return state, order, _spread(own, _weights(self.sizes(kind)), [*order, *_rest(kind, order)])

    def parts(self, kind: Kind, pattern: Pattern) -> tuple[list[Factor], list[Ints]]:
        """Return for each axis of a state its factor in a boundary and the controls of that."""
        sides = (*pattern, *[None] * (len(kind) - len(pattern)))
        parts = [
            (factor, np.arange(self.size(factor))) if side is None else self.ended(factor, side)
            for factor, side in zip(kind, sides, strict=True)
        ]
        return [factor for factor, _ in parts], [own for _, own in parts]

    def covered(self, kind: Kind, pattern: Pattern) -> list[list[int]]:
        """Return the places of a boundary's children on the state's refined control lattice."""
        state, order, _ = self.boundary(kind, pattern)
        weights = self.lattice(kind)
        first = 0
        for axis, side in enumerate(pattern):
            if side:
                places = self.steps(kind[axis])[-1].places
                end, _ = self.ended(kind[axis], side)
                step = self.steps(end)[0]
                first += weights[axis] * (int(places[-1]) + 1 - step.matrix.shape[1])
        result = []
        for digit in self.digits(state):
            letters = (*digit, *[0] * (len(state) - len(digit)))
            chosen = [self.steps(f)[letter] for f, letter in zip(state, letters, strict=True)]
            _, turn = self.arranged([step.factor for step in chosen], whole=True)
            along = [weights[axis] for axis in order]
            result.append((first + _spread([s.places for s in chosen], along, turn)).tolist())
        return result

    @cached_property
    def kinds(self) -> dict[Kind, int]:
        """All states and their indices: cells first, then faces, edges and vertices."""
        found = {self.start: None}
        stack = [self.start]
        while stack:
            kind = stack.pop(0)
            free = sum(f.free for f in kind)
            near = [self.child(kind, digit)[0] for digit in self.digits(kind)]
            near += [self.boundary(kind, pattern)[0] for pattern in _ends(free)]
            fresh = [other for other in dict.fromkeys(near) if other not in found]
            found |= dict.fromkeys(fresh)
            stack += fresh
        ordered = sorted(found, key=lambda kind: -sum(f.free for f in kind))
        return {kind: index for index, kind in enumerate(ordered)}

    def names(self) -> list[str]:
        """Return a name for each state: what it is, with a number where there are several."""
        dimension = len(self.curves)
        free = [sum(f.free for f in kind) for kind in self.kinds]
        bare = ["cell" if n == dimension else ("vertex", "edge", "face")[n] for n in free]
        return [
            name + (str(bare[:index].count(name)) if bare.count(name) > 1 else "")
            for index, name in enumerate(bare)
        ]


def _ends(free: int) -> list[Pattern]:
    return patterns(free) if free else []


def _rest(kind: Kind, order: list[int]) -> list[int]:
    """Return the axes that an order leaves out: those of a single control."""
    return [axis for axis in range(len(kind)) if axis not in order]


def _weights(sizes: Sequence[int]) -> list[int]:
    """Return what a step along each axis counts, the last one fastest."""
    return [int(np.prod(sizes[axis + 1 :], dtype=np.int64)) for axis in range(len(sizes))]


def _spread(parts: Sequence[Ints], weights: Sequence[int], order: Sequence[int]) -> Ints:
    """Return the sums of one weighted number of each part, the last one of ``order`` fastest."""
    result = np.zeros(1, np.int64)
    for axis in order:
        result = (result[:, None] + parts[axis] * weights[axis]).ravel()
    return result


def tensor(curves: Sequence[Curve], keep: Sequence[Ints] | None = None) -> BRep:
    """Return the cells that are tensor products of curves, one for each axis.

    Parameters
    ----------
    curves
        One for an edge, two for a quadrilateral, three for a hexahedron. Equal ones are of one
        class of axes: faces and edges along them are the same states.
    keep
        Digits (k, axes) of the sub-cells kept, one table per level; the last repeats; all where
        not given.

    Raises
    ------
    ModelError
        For another number of curves or digits, or digits that are no pieces of the curves.
    MemoryLimitError
        For more sub-cells than fit.
    """
    if not 1 <= len(curves) <= 3:
        raise ModelError(f"curves: got {len(curves)}; wanted one to three")
    levels = 1 + max(arc.level for curve in curves for arc in curve.arcs)
    tables = [_every(curves, level) for level in range(levels)] if keep is None else list(keep)
    if len(tables) != levels:
        raise ModelError(f"keep: got digits of {len(tables)} levels; wanted {levels}, the curves'")
    plan = _Plan(tuple(curves), tuple(np.asarray(table, np.int64) for table in tables))
    for level, table in enumerate(plan.keep):
        _check_keep(table, pieces(curves, level), level)
    size = float(np.prod([curve.arcs[0].size for curve in curves]))
    count = max(len(table) for table in plan.keep)
    needed = count * (8 * size**2 + 26 * BYTES_PER_CHILD)
    check_memory(needed, f"a cell of {count} sub-cells", "Divide less, on more levels.")
    named = zip(plan.kinds, plan.names(), strict=True)
    return BRep(tuple(_state(plan, kind, name) for kind, name in named))


def pieces(curves: Sequence[Curve], level: int) -> list[int]:
    """Return into how many pieces each curve is cut on a level; a curve's last one repeats."""
    found = []
    for curve in curves:
        own = min(level, max(arc.level for arc in curve.arcs))
        found.append(len(next(arc.pieces for arc in curve.arcs if arc.level == own)))
    return found


def _every(curves: Sequence[Curve], level: int) -> Ints:
    return np.array(list(product(*map(range, pieces(curves, level)))), np.int64)


def _check_keep(table: Ints, pieces: list[int], level: int) -> None:
    good = table.ndim == 2 and table.shape[0] > 0 and table.shape[1] == len(pieces)
    if not good or (table < 0).any() or (table >= np.array(pieces)).any():
        raise ModelError(
            f"keep[{level}]: got digits {table.tolist()!s:.100}; wanted {len(pieces)} for each "
            f"sub-cell, below {pieces}"
        )


def _state(plan: _Plan, kind: Kind, name: str) -> CellState:
    free = sum(f.free for f in kind)
    sizes = plan.sizes(kind)
    born = {digit: plan.child(kind, digit) for digit in plan.digits(kind)}
    shape = [len(plan.steps(f)) for f in kind if f.free]
    separator = "." if max(shape, default=0) > 10 else ""
    bounds = [(p, *plan.boundary(kind, p)) for p in _ends(free)]
    incidences, adjacencies = _shared(plan, kind, [child[::2] for child in born.values()])
    return CellState(
        name,
        SHAPES[free],
        _reference(plan, kind),
        tuple(
            Boundary(pattern_name(p), plan.kinds[state], selection(int(np.prod(sizes)), own))
            for p, state, _, own in bounds
        ),
        tuple(
            Child(separator.join(map(str, digit)) or "0", plan.kinds[child], matrix)
            for digit, (child, matrix, _) in born.items()
        ),
        incidences,
        adjacencies,
    )


def _reference(plan: _Plan, kind: Kind) -> Floats:
    """Return the controls where each axis is the line from 0 to 1, ends about their own point."""
    along = [plan.abscissae(factor) for factor in kind]
    grid = np.meshgrid(*along, indexing="ij") if along else []
    result = np.zeros((3, int(np.prod(plan.sizes(kind)))))
    for axis, values in enumerate(grid):
        result[axis] = values.ravel()
    return result


def _shared(plan: _Plan, kind: Kind, born: Sequence[tuple[Kind, Ints]]) -> Joins:
    """Return incidences and adjacencies, by the places of controls on the refined lattice."""
    parts: dict[Kind, list[Part]] = {}
    for child, _ in born:
        if child not in parts:
            around = _ends(sum(f.free for f in child))
            parts[child] = [
                Part(p.count(None), tuple(plan.boundary(child, p)[2].tolist())) for p in around
            ]
    children = [Placed(places.tolist(), parts[child]) for child, places in born]
    covered = [
        Covered(face, letter, labels)
        for face, pattern in enumerate(_ends(sum(f.free for f in kind)))
        for letter, labels in enumerate(plan.covered(kind, pattern))
    ]
    return joins(children, covered)
