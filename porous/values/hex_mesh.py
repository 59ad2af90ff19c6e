"""A coarse mesh of hexahedra: what a part's volume is divided into before cells fill it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Self

import numpy as np

from porous.errors import MeshError
from porous.values.surface import indices_checked, points_checked
from porous.values.value import Value, frozen, frozen_whole

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.values.volume_mesh import VolumeMesh


HEXAHEDRA = ("hex8", "hex20")


@dataclass(frozen=True, eq=False)
class HexMesh(Value):
    """Hexahedra that share points; which way a cell's own axes run is its own affair.

    Parameters
    ----------
    points
        float64, shape (n, 3). The unit is said by whoever uses the mesh: files of meshes seldom
        know it.
    hexahedra
        int64, shape (k, 8), indices of points in VTK's corner order, which is that of Abaqus,
        CalculiX and Gmsh: four about one face, then the four that lie over them.

    Raises
    ------
    MeshError
        For NaN points, indices out of range, a corner that stands twice in a cell, no cells.
        Whether cells are inverted, folded or disconnected is not asked here.
    """

    points: NDArray[np.float64] = field(repr=False)
    hexahedra: NDArray[np.int64] = field(repr=False)

    def __post_init__(self) -> None:
        self._set("points", frozen(self.points, np.float64))
        self._set("hexahedra", frozen_whole(self.hexahedra, np.int64, "hexahedra", MeshError))
        points_checked(self.points, "hexahedral mesh")
        indices_checked(self.hexahedra, len(self.points), 8, "hexahedra")
        if not len(self.hexahedra):
            raise MeshError("the mesh has no hexahedra; wanted at least one")
        corners = np.sort(self.hexahedra, axis=1)
        twice = np.flatnonzero((corners[:, 1:] == corners[:, :-1]).any(axis=1))
        if len(twice):
            cell = int(twice[0])
            raise MeshError(
                f"hexahedron {cell}: got corners {self.hexahedra[cell].tolist()}; "
                "wanted eight different points"
            )

    @classmethod
    def of_volume(cls, mesh: VolumeMesh) -> Self:
        """Return the hexahedra of a mesh that has no other cells, quadratic ones by their corners.

        Points that no cell uses are left out, tags and parts too, and the points keep their
        numbers whatever unit the mesh says.
        """
        others = {block.shape: len(block.cells) for block in mesh.blocks if len(block.cells)}
        for shape in HEXAHEDRA:
            others.pop(shape, None)
        if others:
            got = ", ".join(f"{count} {shape}" for shape, count in others.items())
            raise MeshError(f"cells: got {got}; wanted hexahedra (hex8) only")
        cells = [block.cells[:, :8] for block in mesh.blocks if block.shape in HEXAHEDRA]
        used, corners = np.unique(
            np.concatenate([np.zeros((0, 8), np.int64), *cells]), return_inverse=True
        )
        return cls(mesh.points[used], corners.reshape(-1, 8))
