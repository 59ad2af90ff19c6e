"""Hexahedra cut into N × N × N of which some are kept: straight ones, bent ones and rough ones.

Matrices are tensor products of a line's, T_ijk = C_i ⊗ C_j ⊗ C_k, and so are all boundaries:
faces are products of two lines, edges are lines. Boundary states carry all digits, whatever the
cell keeps; children that nobody uses do no harm.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.memory import check_memory
from porous.models.brep import Boundary, BRep, CellState, Child, selection
from porous.models.builders._builder import Builder
from porous.models.builders._cubes import SHAPES, pattern_name, patterns
from porous.models.builders._joins import Covered, Part, Placed, joins
from porous.models.builders._rules import Texture, straight

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.models.brep import Adjacency, Incidence
    from porous.models.builders._builder import Options
    from porous.models.builders._cubes import Pattern

    Joins = tuple[tuple[Incidence, ...], tuple[Adjacency, ...]]

BYTES_PER_CHILD = 200
"""What a child needs beside its matrix for each of its boundaries: constraints and labels."""


class Kind(NamedTuple):
    """A state: its level, and for each of its axes the class of axes that it is of."""

    level: int
    classes: tuple[int, ...]


@dataclass(frozen=True)
class _Plan:
    """All that the states of one cell follow from.

    ``rules[level][axis]`` are the matrices (N, p, p) of a line; axes of the same class have the
    same rules on all levels.
    """

    keep: tuple[NDArray[np.int64], ...]
    rules: tuple[tuple[NDArray[np.float64], ...], ...]
    classes: tuple[int, int, int]

    @property
    def width(self) -> int:
        """Controls along a line."""
        return int(self.rules[0][0].shape[1])

    @cached_property
    def kinds(self) -> dict[Kind, int]:
        """All states and their indices: cells first, then faces, edges and the vertex."""
        levels = range(len(self.rules))
        found = [Kind(level, self.classes) for level in levels]
        for dimension in (2, 1):
            sets = {tuple(sorted(c)) for c in combinations(self.classes, dimension)}
            found += [Kind(level, c) for c in sorted(sets) for level in levels]
        return {kind: index for index, kind in enumerate([*found, Kind(0, ())])}

    def divisions(self, kind: Kind) -> int:
        return len(self.rules[kind.level][0])

    def below(self, kind: Kind) -> Kind:
        """Return the kind of a kind's children."""
        last = len(self.rules) - 1
        return Kind(min(kind.level + 1, last), kind.classes) if kind.classes else kind

    def name(self, kind: Kind) -> str:
        name = ("vertex", "edge", "face", "cell")[len(kind.classes)]
        if kind.classes and len(self.rules) > 1:
            name += str(kind.level)
        if len(set(self.classes)) > 1 and 0 < len(kind.classes) < 3:
            name += "-" + "".join("xyz"[c] for c in kind.classes)
        return name

    def digits(self, kind: Kind) -> NDArray[np.int64]:
        """Return the digits that a state keeps: a boundary all there are."""
        if len(kind.classes) == 3:
            return self.keep[kind.level]
        found = list(product(range(self.divisions(kind)), repeat=len(kind.classes)))
        return np.array(found, np.int64).reshape(len(found), len(kind.classes))

    def matrices(self, kind: Kind) -> NDArray[np.float64]:
        """Return the matrices of a state's children, (k, m, m)."""
        digits = self.digits(kind)
        result = np.ones((len(digits), 1, 1))
        for axis, letters in enumerate(digits.T):
            part = self.rules[kind.level][kind.classes[axis]][letters]
            size = result.shape[1] * self.width
            result = result[:, :, None, :, None] * part[:, None, :, None, :]
            result = result.reshape(len(digits), size, size)
        return result

    def free(self, kind: Kind, pattern: Pattern) -> tuple[int, ...]:
        """Return the axes along which a boundary extends, in the order in which it names them."""
        axes = [axis for axis, side in enumerate(pattern) if side is None]
        return tuple(sorted(axes, key=lambda axis: (kind.classes[axis], axis)))

    def boundary(self, kind: Kind, pattern: Pattern) -> Kind:
        axes = self.free(kind, pattern)
        return Kind(kind.level if axes else 0, tuple(kind.classes[axis] for axis in axes))

    def labels(self, kind: Kind, pattern: Pattern, digits: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the places (k, m) of the controls of a boundary's sub-cells, in one number each.

        The places are those of the lattice that all sub-cells of the cell have in common.
        """
        return _labels(pattern, self.free(kind, pattern), digits, self.width, self.divisions(kind))

    def indices(self, kind: Kind, pattern: Pattern) -> tuple[int, ...]:
        """Return which of a cell's controls are those of a boundary."""
        axes = self.free(kind, pattern)
        found = _labels(pattern, axes, np.zeros((1, len(axes)), np.int64), self.width, 1)
        return tuple(found[0].tolist())


def _labels(
    pattern: Pattern, axes: tuple[int, ...], digits: NDArray[np.int64], width: int, divisions: int
) -> NDArray[np.int64]:
    reach = (width - 1) * divisions
    weights = (reach + 1) ** np.arange(len(pattern) - 1, -1, -1)
    corner = sum(side * reach * int(weights[axis]) for axis, side in enumerate(pattern) if side)
    along = weights[list(axes)]
    local = np.array(list(product(range(width), repeat=len(axes))), np.int64)
    moved = (width - 1) * digits @ along
    return np.asarray(corner + moved[:, None] + local @ along)


def _build(options: Options) -> BRep:
    """Return the cells of digit sets; their controls are the unit cube's lattice {0, ½, 1}³.

    Raises
    ------
    ModelError
        Without digits, for a number of controls that the cell cannot have, for a texture of
        straight cells or one that does not fit the divisions of a level.
    MemoryLimitError
        For more divisions than fit; names them.
    """
    if not options.digits:
        raise ModelError("digits: got none; wanted the sub-cells that are kept, for each level")
    width = _width(options)
    textures = options.texture or Texture()
    three = (textures,) * 3 if isinstance(textures, Texture) else textures
    divisions = [digits.divisions for digits in options.digits]
    for digits in options.digits:
        _check_size(digits.divisions, len(digits.keep), width)
    rules = tuple(
        tuple(straight(n) if width == 2 else _rule(t, n, level, len(divisions)) for t in three)
        for level, n in enumerate(divisions)
    )
    keep = tuple(digits.keep for digits in options.digits)
    plan = _Plan(keep, rules, _axis_classes(rules))
    return BRep(tuple(_state(plan, kind) for kind in plan.kinds))


def _width(options: Options) -> int:
    sizes = {"hex-8": (8,), "hex-27": (27, 8), "beam": (8, 27)}[options.cell]
    size = sizes[0] if options.controls is None else options.controls
    if size not in sizes:
        wanted = " or ".join(map(str, sizes))
        raise ModelError(f"controls: got {size} for a {options.cell} cell; wanted {wanted}")
    if sizes[0] == size == 8 and options.texture is not None:
        raise ModelError(
            'texture: a line of two controls is straight; wanted cell = "hex-27", or a beam of 27 '
            "controls"
        )
    # Eight corners of a cell of 27 controls say enough of it: the others are midway.
    return 2 if sizes[0] == size == 8 else 3


def _rule(texture: Texture, divisions: int, level: int, levels: int) -> NDArray[np.float64]:
    try:
        return texture.rule(divisions)
    except ModelError as error:
        if levels == 1:
            raise
        raise ModelError(f"level {level}: {error}") from None


def _check_size(divisions: int, kept: int, width: int) -> None:
    children = {2: 3 * float(divisions) ** 2, 3: float(kept)}
    needed = sum(n * (8 * width ** (2 * d) + 26 * BYTES_PER_CHILD) for d, n in children.items())
    check_memory(needed, f"a cell of {divisions}³ sub-cells", "Divide less, on more levels.")


def _axis_classes(rules: tuple[tuple[NDArray[np.float64], ...], ...]) -> tuple[int, int, int]:
    """Return for each axis the first that has the same rules on all levels."""
    first = [
        next(a for a in range(3) if all(np.array_equal(r[a], r[axis]) for r in rules))
        for axis in range(3)
    ]
    return first[0], first[1], first[2]


def _state(plan: _Plan, kind: Kind) -> CellState:
    dimension = len(kind.classes)
    ends = patterns(dimension)
    child = plan.kinds[plan.below(kind)]
    size = plan.width**dimension
    digits = plan.digits(kind)
    incidences, adjacencies = _shared(plan, kind, ends) if dimension else ((), ())
    separator = "." if plan.divisions(kind) > 10 else ""
    return CellState(
        plan.name(kind),
        SHAPES[dimension],
        _reference(plan, dimension),
        tuple(
            Boundary(
                pattern_name(pattern),
                plan.kinds[plan.boundary(kind, pattern)],
                selection(size, plan.indices(kind, pattern)),
            )
            for pattern in ends
        ),
        tuple(
            Child(separator.join(map(str, digit)) or "0", child, matrix)
            for digit, matrix in zip(digits.tolist(), plan.matrices(kind), strict=True)
        ),
        incidences,
        adjacencies,
    )


def _reference(plan: _Plan, dimension: int) -> NDArray[np.float64]:
    result = np.zeros((3, plan.width**dimension))
    lattice = np.array(list(product(range(plan.width), repeat=dimension)), np.float64)
    result[:dimension] = lattice.T / (plan.width - 1)
    return result


def _shared(plan: _Plan, kind: Kind, ends: Sequence[Pattern]) -> Joins:
    """Return incidences and adjacencies, by the places of controls on the cell's lattice."""
    dimension = len(kind.classes)
    divisions = plan.divisions(kind)
    natural = tuple(range(dimension))
    whole = _labels((None,) * dimension, natural, plan.digits(kind), plan.width, divisions)
    parts = [Part(p.count(None), plan.indices(kind, p)) for p in ends]
    children = [Placed(labels, parts) for labels in whole.tolist()]
    covered = [
        Covered(face, letter, labels)
        for face, pattern in enumerate(ends)
        for letter, labels in enumerate(
            plan.labels(kind, pattern, plan.digits(plan.boundary(kind, pattern))).tolist()
        )
    ]
    return joins(children, covered)


CELL = Builder(("hex-8", "hex-27", "beam"), _build, ("digits", "texture", "controls"))
