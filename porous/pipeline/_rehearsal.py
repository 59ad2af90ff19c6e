"""What is simulated is tried on a few cells first: a mesh may cost hours, what is wrong shows now.

Materials that cannot be understood or lack what a step needs, and decks that cannot hold a step or
an element, are refused before anything is made. What depends on the real mesh is seen later.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError, MeshError, RecipeError
from porous.values import Block, Box, Frame, VolumeMesh, VoxelGrid

if TYPE_CHECKING:
    from collections.abc import Iterator

    from porous.recipe import Recipe

WAYS = ((1, 2), (2, 3), (3, 7), (7, 4), (4, 5), (5, 1))
"""What a box's six tetrahedra about its diagonal from 0 to 6 have besides."""


def rehearse(recipe: Recipe) -> None:
    """Prepare the job of a recipe on a cube of 27 cells, and write its decks to nowhere.

    Where it is open which elements there will be, those count that do.

    Raises
    ------
    RecipeError
        For materials and decks that will not do whatever the mesh.
    """
    from porous.formats import check
    from porous.jobs import prepare

    how = recipe.simulation
    if how is None or recipe.volume.method == "none":
        return
    refused: list[str] = []
    for mesh in _trials(recipe):
        try:
            job = prepare(mesh, how)
            for suffix in how.suffixes:
                check(job, suffix)
        except (MeshError, FormatError) as error:
            refused.append(str(error))
        else:
            return
    raise RecipeError(f"simulation: {refused[0]}")


def _trials(recipe: Recipe) -> Iterator[VolumeMesh]:
    from porous.stages import quadratic

    boxes = _boxes(recipe.phase, recipe.voxels.periodic)
    method = recipe.volume.method
    some = [boxes] if method != "tetwild" else []
    some += [_split(boxes)] if method != "voxel-hex" else []
    for mesh in some:
        yield quadratic(mesh) if recipe.volume.order == 2 else mesh


def _boxes(phase: str, periodic: tuple[bool, bool, bool]) -> VolumeMesh:
    """Return a cube of 27 boxes but for the one in the middle, which is of the other phase."""
    from porous.stages import hexahedralize, name_parts

    solid = np.full((3, 3, 3), phase != "pore")
    solid[1, 1, 1] = phase == "pore"
    frame = Frame((0, 0, 0), (1, 1, 1), solid.shape, periodic=periodic)
    return name_parts(hexahedralize(VoxelGrid.of_solid(solid, frame), phase=phase), frame.box)


def _split(boxes: VolumeMesh) -> VolumeMesh:
    """Return a mesh of boxes as tetrahedra, with the sides and the phases that it has."""
    from porous.stages import name_parts

    cells = np.stack([boxes.blocks[0].cells[:, [0, *way, 6]] for way in WAYS], axis=1)
    tags = {name: np.repeat(values, len(WAYS), axis=0) for name, values in boxes.cell_tags.items()}
    tets = VolumeMesh(boxes.points, (Block("tet4", cells.reshape(-1, 4)),), tags)
    return name_parts(tets, Box.of_points(boxes.points))
