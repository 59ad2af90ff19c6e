"""From a model made of cells to the conforming mesh that they are, without voxels or mesher."""

from __future__ import annotations

from typing import TYPE_CHECKING

from porous.errors import MeshError
from porous.models.model import HasCells

if TYPE_CHECKING:
    from porous.values import VolumeMesh


def mesh_cells(model: object) -> VolumeMesh:
    """Return the level-n cells as one conforming mesh, by construction.

    Nodes are shared, parts are named by the level-0 cell's own faces, and ``cell_tags`` hold the
    cells' addresses.

    Raises
    ------
    MeshError
        Where the model has no cells.
    ModelError
        Where cells are folded (naming the address) or are no volumes.
    """
    if not isinstance(model, HasCells):
        raise MeshError(
            f"mesh cells: a {type(model).__name__} has none; models of kind bcifs have, others "
            "are meshed by tetrahedralize or hexahedralize"
        )
    return model.cell_mesh()
