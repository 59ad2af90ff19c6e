"""Bodies of solid cells: a mesh by construction, whatever the controls."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Literal

import numpy as np

from porous.errors import ModelError
from porous.models.automaton import DEEPEST
from porous.models.cell_mesh import cell_mesh
from porous.models.cell_shapes import COLLAPSED
from porous.models.cell_surface import cell_boundary
from porous.models.cell_system import CellSystem
from porous.models.simplices import Simplices, hexa_tets, octa_tets

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.models.inside import Union
    from porous.models.lines import LineBody
    from porous.values import Frame, Measure, Pattern, SurfaceMesh, VolumeMesh

    Floats = NDArray[np.float64]

SPLITS: dict[str, Callable[[Floats], Floats]] = {
    "tetra": np.asarray,
    "octa": octa_tets,
    "wedge": lambda corners: hexa_tets(corners[:, COLLAPSED]),
    "hexa": hexa_tets,
}
"""Tetrahedra (n, 4, 3) that fill cells of a shape, given their corners (k, c, 3)."""

HEIGHTS = {
    "tetra": [(*(j for j in range(4) if j != i), i) for i in range(4)],
    "octa": [
        (*face, opposite ^ 1) for face in product((0, 1), (2, 3), (4, 5)) for opposite in face
    ],
    "wedge": [
        (*face, corner)
        for corner in range(6)
        for face in (
            ((corner + 2) % 6, (corner + 4) % 6, (corner + 2) % 6 ^ 1),
            (corner ^ 1, (corner + 2) % 6 ^ 1, (corner + 4) % 6 ^ 1),
        )
    ],
    "hexa": [
        (i, i ^ a, i ^ b, i ^ 7 ^ a ^ b) for i in range(8) for a, b in ((1, 2), (2, 4), (4, 1))
    ],
}
"""Three corners of a shape that span a face, and one whose height over it is a thickness."""


@dataclass(frozen=True, eq=False)
class CellBody(CellSystem):
    """The union of the cells of a level, each filled.

    A bent hexahedron is the 24 tetrahedra about its middle and its faces' means: of the volume of
    the trilinear cell, and one body with its neighbours.

    Parameters
    ----------
    contacts
        ``"apart"``: cells that meet in an edge or a point alone share no nodes; ``"shared"``: they
        do, as the constraints prescribe.
    """

    contacts: Literal["apart", "shared"] = "apart"

    def cell_mesh(self) -> VolumeMesh:
        """Return the cells as a conforming mesh; see ``models.cell_mesh``."""
        return cell_mesh(self.nodes, contacts=self.contacts, unit=self.unit)

    def boundary(self) -> SurfaceMesh:
        """Return the boundary of the cells, closed and labelled; see ``models.cell_surface``."""
        return cell_boundary(self.nodes, unit=self.unit)

    def exact(
        self, periodic: tuple[bool, bool, bool] = (False, False, False)
    ) -> tuple[Measure, ...]:
        """Return what is known in closed form; see ``models.cell_exact``."""
        from porous.models.cell_exact import exact_measures

        return () if any(periodic) else exact_measures(self)

    @cached_property
    def solid(self) -> Simplices:
        """The tetrahedra that fill the cells."""
        return Simplices(tets=filled(self))

    def sample(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the mask of each voxel: bit r·C + c where the pattern's point lies in a cell."""
        self.reach.check(frame, certain=False)
        return self.solid.sample(frame, pattern)

    def check_membership(self) -> None:
        """Do nothing: tetrahedra can be asked about any point."""

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """Tell which points (n, 3), in ``unit``, lie in a cell."""
        return self._inside.contains(points)

    @cached_property
    def _inside(self) -> Union:
        from porous.models.inside import tetrahedra

        return tetrahedra(self.solid.tets)

    def line_body(self) -> LineBody | None:
        """Return the cells for lines; see ``models.lines``."""
        from porous.models.lines import lines_of

        return lines_of([self.solid])

    def cover(self, frame: Frame) -> tuple[NDArray[np.uint64], float]:
        """Return marks of every voxel that a cell touches, and a Hausdorff bound."""
        self.reach.check(frame, certain=True)
        return self.solid.cover(frame)

    def smallest_feature(self) -> float | None:
        """Return the least height of a corner of a cell over a face of it, in ``unit``.

        The edge of a cube, the height of a tetrahedron; of bent cells the thinnest corner. None
        where cells are folded.
        """
        try:
            return self._thinnest
        except ModelError:
            return None

    @cached_property
    def _thinnest(self) -> float:
        _ = self.nodes.unfolded
        return min(thinnest(self))

    def smallest_pore(self) -> None:
        """Return None: the widths of bent pores are not known in closed form."""

    def finest_printable_level(self, feature: float) -> float | None:
        """Return the last level up to which no cell is thinner than ``feature``, in ``unit``.

        None where the level-0 cell is thinner already.

        Raises ``ModelError`` for a feature that is not positive.
        """
        if not 0 < feature < math.inf:
            raise ModelError(f"feature: got {feature}; wanted a positive length")
        for level in range(DEEPEST):
            found = replace(self, level=level).smallest_feature()
            if found is None or found < feature * (1 - 1e-9):
                return level - 1 if level else None
        return math.inf

    @property
    def feature_size(self) -> float | None:
        """The length that ``per_feature`` divides.

        Raises ``ModelError`` where cells are folded; names the first one's address.
        """
        return self._thinnest


def filled(system: CellSystem) -> Floats:
    """Return the tetrahedra (n, 4, 3) of all cells of a level."""
    return np.concatenate([SPLITS[shape](corners) for shape, corners in system.corners()])


def thinnest(system: CellSystem) -> list[float]:
    """Return the least height of a corner over a face in each group of cells."""
    result = []
    for shape, corners in system.corners():
        a, b, c, apex = np.moveaxis(corners[:, np.array(HEIGHTS[shape])], 2, 0)
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=-1)
        volume = np.abs(np.einsum("khi,khi->kh", normal, apex - a))
        heights = np.divide(volume, length, out=np.zeros_like(length), where=length > 0)
        result.append(float(heights.min()))
    return result
