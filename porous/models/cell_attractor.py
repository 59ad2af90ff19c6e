"""The limit of a boundary-controlled system: what its cells shrink to, and no cells any more."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

from porous.errors import ModelError
from porous.models.cell_cover import check_limit, cover_cells, sample_cells
from porous.models.cell_folds import corner_weights
from porous.models.cell_shapes import COLLAPSED
from porous.models.drawing import Drawing, nothing
from porous.models.net import net_error
from porous.models.reach import Reach, cells_reach
from porous.values.units import check_unit
from porous.values.value import Value

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from porous.models.automaton import Automaton
    from porous.models.cell_system import CellSystem
    from porous.models.solve import Solution
    from porous.values import Box, Frame, Pattern

BULK_LEVEL = 2
"""The level at which the faces of the level-0 cell bound the bulk."""

SOLIDS: dict[str, tuple[int, ...]] = {
    "vertex": (0, 0, 0, 0),
    "edge": (0, 1, 1, 1),
    "triangle": (0, 1, 2, 2),
    "quad": (0, 1, 2, 3, 0, 1, 2, 3),
    "tetra": (0, 1, 2, 3),
    "octa": (0, 1, 2, 3, 4, 5),
    "wedge": COLLAPSED,
    "hexa": (0, 1, 2, 3, 4, 5, 6, 7),
}
"""Corners of the tetrahedra, octahedra and hexahedra, flat ones too, that shapes are."""


@dataclass(frozen=True, eq=False)
class CellAttractor(Value):
    """The attractor of a boundary-controlled system, grown by a ball of radius ``offset``.

    Cells of states without children, of any level, belong to it.

    Parameters
    ----------
    system
        The cells at a level that stands for all: its domain holds the limit, and its bulk is what
        porosity refers to.
    domain
        The box that is sampled.
    offset
        Radius of the ball added, in ``unit``.

    Raises
    ------
    ModelError
        For a negative offset, paths that all end, or an offset of cells that end.
    """

    level: ClassVar[str] = "limit"

    system: CellSystem
    domain: Box
    offset: float = 0.0

    def __post_init__(self) -> None:
        check_unit(self.unit)
        if not 0 <= self.offset < math.inf:
            raise ModelError(f"offset: got {self.offset}; wanted zero or a length")
        check_limit(self.automaton, self.drawings, self.offset)

    @property
    def unit(self) -> str:
        """Unit of length."""
        return self.system.unit

    @property
    def automaton(self) -> Automaton:
        """The automaton of the cells, its level-0 cell where the controls lie."""
        return self.system.automaton

    @property
    def bulk(self) -> Box:
        """The box of the body that porosity refers to."""
        return self.system.bulk

    @property
    def bulk_volume(self) -> float:
        """Volume of the body that porosity refers to, in ``unit`` cubed."""
        return self.system.bulk_volume

    def sample_bulk(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the masks of the body that porosity refers to."""
        return self.system.sample_bulk(frame, pattern)

    def sample(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the mask of each voxel: bit r·C + c where the pattern's point lies in the body.

        Raises
        ------
        ModelError
            For a limit without offset: no sample point lies in a set without volume.
        """
        self._reach.check(frame, certain=False)
        return sample_cells(
            self.automaton, frame, pattern, drawings=self.drawings, offset=self.offset
        )

    def cover(self, frame: Frame) -> tuple[NDArray[np.uint64], float]:
        """Return marks of every voxel that the body touches, and a Hausdorff bound."""
        self._reach.check(frame, certain=False)
        return cover_cells(self.automaton, frame, drawings=self.drawings, offset=self.offset)

    @cached_property
    def _reach(self) -> Reach:
        roots = [group.points for group in self.automaton.level_zero]
        return cells_reach(self.automaton, roots, self.domain)

    @cached_property
    def drawings(self) -> tuple[Drawing, ...]:
        """What the cells of each state are drawn as: solids on their corners, where they end."""
        return tuple(_solid(self.system.solution, q) for q in self.system.brep.reached)

    @property
    def is_cut(self) -> bool:
        """Whether the domain leaves out a part of the set."""
        whole = self.system.domain.grown(self.offset)
        return not self.domain.contains(whole, tolerance=1e-9 * max(whole.lengths))

    def sampling_error(self, frame: Frame) -> float:
        """Return how far the boundary that is sampled may lie from the body's, in ``unit``."""
        return net_error(frame, self.offset)

    @property
    def feature_size(self) -> None:
        """None: the limit has details of every size."""
        return None


def _solid(solution: Solution, state: int) -> Drawing:
    """Return the drawing of a cell that ends: the solid, face or edge of its corners."""
    found = solution.brep.states[state]
    if found.children:
        return nothing(found.size)
    return Drawing(corner_weights(solution, state), solid=SOLIDS[found.shape])
