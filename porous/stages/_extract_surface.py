"""The step from voxels to a closed surface."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError, MeshError
from porous.stages._voxel_faces import voxel_faces
from porous.values import SurfaceMesh, VoxelGrid
from porous.values.value import adopted

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from porous.values import Frame

    Progress = Callable[[str, float], None]

FACES = ("XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX")
"""Faces of the frame, in the order of the caps' labels 1 … 6; label 0 is WALL."""
NAMES = ("WALL", *FACES)

LEWINER_LEVEL = 127.75
"""At 127.5, the midpoint of 0 and 255, scikit-image's face tests are ties: its surface breaks."""


def extract_surface(
    grid: VoxelGrid, *, method: str = "marching-cubes", progress: Progress | None = None
) -> SurfaceMesh:
    """Return the closed surface of the solid voxels (fill ≥ 128) of ``grid``.

    Beyond the frame there is void, so the surface is closed everywhere. Triangles that lie on the
    frame's own faces are caps, named XMIN … ZMAX; all others are WALL. Where a voxel at the border
    is not wholly solid, the surface passes inside the frame's face and is WALL.

    Parameters
    ----------
    grid
        The body, sampled as ``fill`` for accuracy; binary grids give staircases.
    method
        ``"marching-cubes"``: vertices where the linearly interpolated fill is 127.5. Always
        closed, oriented and 2-manifold, and its topology is exactly that of the 6-connected
        solid: χ(surface) = 2 χ₆(solid), and one piece for each component of the solid and for
        each enclosed (26-connected) component of the void. Edges and corners of the body are
        rounded over about a voxel, so volume is low by O((h / edge)²): 1.3 % for a rotated cube
        of 30 voxels. Volume fractions fall too steeply for linear interpolation to be exact: the
        area of a plane comes out 0 to 0.9 % too large (0.4 % in the mean over directions).
        ``"lewiner"``: scikit-image's marching cubes (Lewiner et al. 2003) at 127.75. Of that
        topology on binary grids only; on grey ones neither topology nor manifoldness is certain.
        ``"voxel-faces"``: the exact boundary of the solid voxels as boxes. Closed, oriented,
        2-manifold: where solid voxels touch in an edge or a point only, points are doubled and
        the pieces stay apart. Void voxels that touch in a point only are not joined here.
    progress
        Called as ``progress("extract_surface", done)`` with done in 0 … 1.

    Returns
    -------
    SurfaceMesh
        In the frame's unit, triangles counter-clockwise seen from outside the solid.

    Raises
    ------
    MeshError
        Where no voxel is solid, or the method is not known.
    MemoryLimitError
        Where the surface would not fit into memory.
    """
    if not isinstance(grid, VoxelGrid):
        raise GridError(
            f"extract_surface: got a {type(grid).__name__}; wanted a grid in memory: "
            "stream_surface writes the surface of one that is not"
        )
    if method not in METHODS:
        raise MeshError(f"surface method: got {method!r}; wanted one of {', '.join(METHODS)}")
    check_fullest(int(grid.fill.max()))
    points, triangles, labels = METHODS[method](grid, progress)
    return SurfaceMesh(adopted(points), adopted(triangles), grid.frame.unit, adopted(labels), NAMES)


def check_fullest(fullest: int) -> None:
    """Raise ``MeshError`` where the fullest voxel is not solid: there is no surface."""
    if fullest < 128:
        raise MeshError(
            f"surface: no voxel is at least half solid (the fullest is {fullest / 2.55:.0f} % "
            "solid). Use more voxels, sampling = 'cover', or an offset"
        )


Extraction = tuple["NDArray[np.float64]", "NDArray[np.int64]", "NDArray[np.int16]"]


def _marching_cubes(grid: VoxelGrid, progress: Progress | None) -> Extraction:
    from porous.kernels.surface import marching_cubes

    def report(done: int, count: int) -> None:
        assert progress is not None
        progress("extract_surface", done / count)

    return marching_cubes(grid.fill, grid.frame, None if progress is None else report)


def _lewiner(grid: VoxelGrid, progress: Progress | None) -> Extraction:
    from skimage.measure import marching_cubes

    padded = np.pad(grid.fill, 1)
    vertices, triangles, _, _ = marching_cubes(  # type: ignore[no-untyped-call]
        padded, LEWINER_LEVEL, allow_degenerate=False, gradient_direction="ascent"
    )
    lattice = vertices.astype(np.float64) - 0.5
    # A full voxel at the border puts the level this far inside the frame's face, in voxels.
    labels = _caps(lattice, triangles, grid.frame, LEWINER_LEVEL / 255 - 0.5)
    if progress is not None:
        progress("extract_surface", 1.0)
    points = grid.frame.origin + (grid.frame.start + lattice) * grid.frame.spacing
    return points, triangles.astype(np.int64), labels


def _caps(
    lattice: NDArray[np.float64], triangles: NDArray[np.int64], frame: Frame, tolerance: float
) -> NDArray[np.int16]:
    """Label the triangles that lie on the frame's faces; lattice coordinates count voxels."""
    labels = np.zeros(len(triangles), dtype=np.int16)
    for face in range(6):
        axis, upper = divmod(face, 2)
        plane = frame.shape[axis] if upper else 0
        on_plane = np.abs(lattice[:, axis] - plane) <= tolerance + 1e-4
        labels[on_plane[triangles].all(axis=1)] = face + 1
    return labels


METHODS: Mapping[str, Callable[[VoxelGrid, Progress | None], Extraction]] = MappingProxyType(
    {"marching-cubes": _marching_cubes, "lewiner": _lewiner, "voxel-faces": voxel_faces}
)
"""The ways to a surface there are."""
