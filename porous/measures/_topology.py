"""How many pieces, tunnels and cavities there are, on voxels and on meshes."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from porous.errors import GridError
from porous.measures._answer import answer
from porous.measures._census import Census
from porous.measures._mesh import SURFACE, SurfaceCensus
from porous.values import Measure, SurfaceMesh

if TYPE_CHECKING:
    from porous.measures._answer import Table
    from porous.values.tiled import Tiled

METHOD = "voxel count"


def _exact(name: str, value: int) -> Measure:
    return Measure(name, value, "1", METHOD, 0.0, "exact", "grid")


def _euler(census: Census, name: str) -> Measure:
    return _exact(name, census.number(name))


def _components(census: Census, name: str, connectivity: int) -> Measure:
    return _exact(name, census.pieces(solid=True, connectivity=connectivity).number)


def _genus(census: Census, name: str, connectivity: int, euler: str) -> Measure:
    if any(census.frame.periodic):
        raise GridError(
            f"{name}: a body in periodic space has tunnels of space itself among its own; "
            "cap it: measure the genus of its surface"
        )
    pieces = census.pieces(solid=True, connectivity=connectivity).number
    return _exact(name, pieces + cavities(census, 32 - connectivity) - census.number(euler))


def cavities(census: Census, connectivity: int = 26, *, solid: bool = False) -> int:
    """Return the number of voids, or of solids, that nothing joins with the frame's outside."""
    inside = census.pieces(solid=solid, connectivity=connectivity)
    return int(inside.counts[~inside.open].sum())


GRID: Table[Census] = {
    ("components", METHOD): partial(_components, name="components", connectivity=6),
    ("euler_number", METHOD): partial(_euler, name="euler_number"),
    ("genus", METHOD): partial(_genus, name="genus", connectivity=6, euler="euler_number"),
    ("components_26", METHOD): partial(_components, name="components_26", connectivity=26),
    ("euler_number_26", METHOD): partial(_euler, name="euler_number_26"),
    ("genus_26", METHOD): partial(
        _genus, name="genus_26", connectivity=26, euler="euler_number_26"
    ),
}


def components(subject: Tiled | SurfaceMesh) -> Measure:
    """Return the number of pieces, unit 1.

    Of a grid: solid voxels joined by faces. Of a surface: pieces that enclose a positive volume;
    those about cavities are not bodies.
    """
    return _answered("components", subject)


def euler_number(subject: Tiled | SurfaceMesh) -> Measure:
    """Return the Euler number of the solid, unit 1.

    Of a grid χ₆ = voxels − pairs + squares − cubes of the solid joined by faces. Of a closed
    surface half of vertices − edges + triangles: the Euler number of what it encloses.
    """
    return _answered("euler_number", subject)


def genus(subject: Tiled | SurfaceMesh) -> Measure:
    """Return the number of independent tunnels of the solid, unit 1.

    Of a grid pieces + cavities − χ₆ (solid joined by faces, void by corners); of a closed surface
    pieces − χ/2, which is the same number.

    Raises
    ------
    GridError
        For a grid with a periodic axis.
    """
    return _answered("genus", subject)


def components_26(grid: Tiled) -> Measure:
    """Return the number of pieces of the closed union of solid voxels, unit 1.

    Voxels that meet in an edge or a corner are one piece.
    """
    return _answered("components_26", grid)


def euler_number_26(grid: Tiled) -> Measure:
    """Return vertices − edges + faces − cells of the closed union of solid voxels, unit 1."""
    return _answered("euler_number_26", grid)


def genus_26(grid: Tiled) -> Measure:
    """Return the number of tunnels of the closed union, unit 1; raises what ``genus`` does."""
    return _answered("genus_26", grid)


def _answered(name: str, subject: Tiled | SurfaceMesh) -> Measure:
    if isinstance(subject, SurfaceMesh):
        return answer(SURFACE, name, "triangles", SurfaceCensus(subject))
    return answer(GRID, name, METHOD, Census(subject))
