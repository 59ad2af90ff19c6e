"""In which frame each hexahedron of a macro mesh names its controls, so that neighbours agree.

Opposite edges of a quadrilateral are parallel: a rule that is not its own reversal has to run one
way along a whole class of parallel edges, and cells with several rules have to name their axes in
one order. Both is a matter of naming: a cell is relabelled, and its digits with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.models.builders import Options, Texture, build_cell
from porous.models.digits import DigitSet
from porous.models.macro import MacroMesh
from porous.models.merged import merged
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.models.brep import BRep

    Digits = tuple[DigitSet, ...]
    Edge = tuple[int, ...]
    Three = tuple[Texture, Texture, Texture]

AXES = range(3)


class Hexahedron(NamedTuple):
    """What a recipe says of a level-0 cell: its controls, its digits, and its lines' textures.

    ``controls`` are 8 or 27 indices, x slowest; ``textures`` those of its lines along x, y and z,
    none where it is straight.
    """

    controls: tuple[int, ...]
    digits: Digits
    textures: Three | None = None


class Axis(NamedTuple):
    """An axis of a cell: its class of parallel edges, and whether it runs against that."""

    family: int
    against: bool


@dataclass(frozen=True, eq=False)
class Families(Value):
    """The axes of all cells by classes of parallel edges, numbered as cells and axes meet them.

    Parameters
    ----------
    axes
        Of each cell, three.
    count
        How many classes there are.
    """

    axes: tuple[tuple[Axis, Axis, Axis], ...]
    count: int

    @classmethod
    def of(cls, cells: Sequence[Sequence[int]]) -> Families:
        """Return those of cells of 8 or 27 controls each, in the same order as in ``Hexahedron``.

        Where a class cannot be directed, for it comes back to itself the other way round, some of
        its axes run against others; what such cells share is then not symmetric.
        """
        ways = _Ways()
        for cell in cells:
            for axis in AXES:
                first, *others = _edges(cell, axis)
                for other in others:
                    ways.join(first, other)
        numbers: dict[Edge, int] = {}
        turned: dict[Edge, bool] = {}
        result = []
        for cell in cells:
            row = []
            for axis in AXES:
                root, way = ways.find(_edges(cell, axis)[0])
                number = numbers.setdefault(root, len(numbers))
                row.append(Axis(number, way != turned.setdefault(root, way)))
            result.append((row[0], row[1], row[2]))
        return cls(tuple(result), len(numbers))


class _Ways:
    """Union-find of directed edges: which are parallel, and which of them the same way."""

    def __init__(self) -> None:
        self._above: dict[Edge, tuple[Edge, bool]] = {}

    def find(self, edge: Edge) -> tuple[Edge, bool]:
        """Return what represents an edge's class, and whether the edge runs against that."""
        way = edge[0] > edge[-1]
        start = root = edge[::-1] if way else edge
        turned = False
        while root in self._above:
            root, turn = self._above[root]
            turned ^= turn
        if root != start:
            self._above[start] = root, turned
        return root, way ^ turned

    def join(self, one: Edge, other: Edge) -> None:
        """Make two edges parallel; contradictions are left to those who share the edges."""
        (a, way), (b, turn) = self.find(one), self.find(other)
        if a != b:
            self._above[a] = b, way ^ turn


def _lattice(cell: Sequence[int]) -> NDArray[np.int64]:
    """Return a cell's controls as a lattice (w, w, w)."""
    width = {8: 2, 27: 3}.get(len(cell))
    if width is None:
        raise ModelError(f"cells: got {len(cell)} controls for one; wanted 8 or 27")
    return np.array(cell, np.int64).reshape((width,) * 3)


def _edges(cell: Sequence[int], axis: int) -> list[Edge]:
    """Return the controls of the four edges along an axis, from low to high."""
    along = np.moveaxis(_lattice(cell), axis, 0)
    return [tuple(along[:, i, j].tolist()) for i, j in product((0, -1), repeat=2)]


class Assembly(NamedTuple):
    """States, cells of these, and the digits of each level where they are those of all cells."""

    brep: BRep
    mesh: MacroMesh
    digits: Digits


def assembled(cell: str, given: Sequence[Hexahedron]) -> Assembly:
    """Return the states of hexahedra and the mesh of them, each in a frame that suits all.

    Parameters
    ----------
    cell
        ``"hex-8"`` or ``"hex-27"``.
    given
        The cells; what they share has to be divided alike, or their mesh is refused.

    Raises
    ------
    ModelError
        As ``build_cell``.
    """
    families = Families.of([each.controls for each in given])
    rules = dict.fromkeys(t for each in given for t in each.textures or ())
    rank = {texture: number for number, texture in enumerate(rules)}
    framed = [_framed(*both, rank) for both in zip(given, families.axes, strict=True)]
    kinds = dict.fromkeys((each.digits, each.textures) for each in framed)
    breps = [
        build_cell(Options(cell, digits=digits, texture=_plain(textures), controls=_size(framed)))
        for digits, textures in kinds
    ]
    brep, starts = merged(breps)
    state = dict(zip(kinds, starts, strict=True))
    states = tuple(state[each.digits, each.textures] for each in framed)
    digits = {each.digits for each in framed}
    mesh = MacroMesh(tuple(each.controls for each in framed), states)
    return Assembly(brep, mesh, digits.pop() if len(digits) == 1 else ())


def _size(framed: Sequence[Hexahedron]) -> int:
    sizes = {len(each.controls) for each in framed}
    if len(sizes) > 1:
        raise ModelError(f"cells: got cells of {sorted(sizes)} controls; wanted one number for all")
    return sizes.pop()


def _plain(textures: Three | None) -> Texture | Three | None:
    return textures[0] if textures and len(set(textures)) == 1 else textures


def _framed(
    given: Hexahedron, axes: tuple[Axis, Axis, Axis], rank: dict[Texture, int]
) -> Hexahedron:
    """Return a cell that names its axes in the order of its textures, none against its class."""
    if given.textures is None:
        return given
    textures = given.textures
    flips = [a for a in AXES if axes[a].against and not _is_symmetric(textures[a], given.digits)]
    order = sorted(AXES, key=lambda a: (rank[textures[a]], a))
    if not flips and order == list(AXES):
        return given
    controls = np.flip(_lattice(given.controls), tuple(flips)).transpose(order).ravel()
    digits = tuple(_turned(each, flips, order) for each in given.digits)
    x, y, z = (textures[a] for a in order)
    return Hexahedron(tuple(controls.tolist()), digits, (x, y, z))


def _turned(digits: DigitSet, flips: list[int], order: list[int]) -> DigitSet:
    """Return a digit set seen from another frame; the same one where it is as symmetric."""
    keep = digits.keep.copy()
    keep[:, flips] = digits.divisions - 1 - keep[:, flips]
    keep = keep[:, order]
    same = np.array_equal(np.unique(keep, axis=0), np.unique(digits.keep, axis=0))
    return digits if same else DigitSet(digits.divisions, keep)


def _is_symmetric(texture: Texture, digits: Digits) -> bool:
    """Tell whether a line's rule is its own reversal on every level."""
    for each in digits:
        rule = texture.rule(each.divisions)
        if not np.allclose(rule, rule[::-1, ::-1, ::-1], rtol=0, atol=1e-12):
            return False
    return True
