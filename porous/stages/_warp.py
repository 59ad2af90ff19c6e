"""Voxels and meshes bent by a fractal homeomorphism of their box, as ``po.warp`` bends models."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from porous.errors import GridError, MeshError
from porous.memory import check_memory
from porous.models.homeomorphism import homeomorphism
from porous.models.trilinear import FLAT, jacobians, least_jacobian
from porous.stages._altered import check_manifold, pieces_of, volumes_of
from porous.values import FILL, Box, SurfaceMesh, VolumeMesh, VoxelGrid
from porous.values.value import adopted
from porous.values.volume_mesh import ADDRESS
from porous.values.volume_topology import boundary_faces, nodes_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import ArrayLike, NDArray

    from porous.models.homeomorphism import Homeomorphism, Place
    from porous.values import Frame

    Bytes = NDArray[np.uint8]
    Floats = NDArray[np.float64]
    Offsets = ArrayLike | Mapping[Place, ArrayLike]

Mesh = TypeVar("Mesh", SurfaceMesh, VolumeMesh)

VOXELS = 1 << 13
"""Voxels that a thread looks up at a time."""

LEXICOGRAPHIC = (0, 4, 3, 7, 1, 5, 2, 6)
"""The nodes of VTK's hexahedron in the order 4a + 2b + c of its corners (a, b, c)."""

CELLS = 1 << 14
"""Hexahedra whose Jacobians are looked at in one step."""

AGAIN = "wanted points of the lattice moved less far, or a coarser mesh"


def warp_grid(
    grid: VoxelGrid,
    offsets: Offsets,
    *,
    progress: Callable[[str, float], None] | None = None,
) -> VoxelGrid:
    """Return a grid bent by a fractal homeomorphism h of its frame's box.

    What is bent is the body of voxels: each of the 64 samples of a voxel of the result is looked up
    where h carries it, in the voxel that holds that point, and the voxel's fill is the mean of
    those 64 fills. So a voxel is solid where the majority of its samples are, an unmoved lattice
    gives back the same fills, and no value is interpolated. The topology is that of the body where
    its parts and pores stay wider than about two voxels; a second resolution tells.

    Parameters
    ----------
    grid
        In memory. Of a periodic axis both sides must be moved alike.
    offsets
        How far the 3 × 3 × 3 points of a lattice are moved, in edges of the frame's box, as in
        ``warp``.
    progress
        Called as ``progress("warp", done)`` with done in 0 … 1; raising in it cancels.

    Raises
    ------
    ModelError
        As ``warp``.
    GridError
        For what is no grid in memory, and for periodic sides that would not fit each other.
    MemoryLimitError
        Where the grid would not fit twice.
    """
    if not isinstance(grid, VoxelGrid):
        raise GridError(
            f"warp_grid: got a {type(grid).__name__}; wanted a grid in memory, as its to_grid() "
            "is where it fits"
        )
    bend = homeomorphism(offsets)
    _check_periods(grid.frame, bend)
    arrays = [grid.fill] if grid.bulk is None else [grid.fill, grid.bulk]
    check_memory(
        len(arrays) * grid.frame.size,
        f"a warped grid of {grid.frame.size} voxels",
        "Choose fewer voxels.",
    )
    pulled = [
        _pulled(array, grid.frame, bend, _shares(progress, k, len(arrays)))
        for k, array in enumerate(arrays)
    ]
    return VoxelGrid(grid.frame, pulled[0], pulled[1] if len(pulled) > 1 else None)


def _shares(
    progress: Callable[[str, float], None] | None, number: int, of: int
) -> Callable[[int, int], None] | None:
    if progress is None:
        return None
    return lambda done, count: progress("warp", (number + done / count) / of)


def _check_periods(frame: Frame, bend: Homeomorphism) -> None:
    """Raise ``GridError`` where periodic sides would be moved apart from each other."""
    for axis in np.flatnonzero(frame.periodic).tolist():
        others = [a for a in range(3) if a != axis]
        low, high = (np.take(bend.lattice, end, axis)[..., others] for end in (0, 2))
        if not np.array_equal(low, high):
            raise GridError(
                f"warp_grid: the grid is periodic along {'xyz'[axis]}, and its two sides are moved "
                "by different offsets; wanted the same for both, or a grid that is not periodic"
            )


def _pulled(
    array: Bytes, frame: Frame, bend: Homeomorphism, report: Callable[[int, int], None] | None
) -> Bytes:
    """Return the mean of the bytes at the images of each voxel's samples."""
    from porous.kernels._shared import slabs

    flat, shape, box = array.reshape(-1), np.array(frame.shape), frame.box
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    result = np.empty(frame.size, np.uint8)
    count = FILL.points

    def work(first: int, last: int) -> None:
        places = bend.moved_samples(frame, box, FILL, (first, last))
        index = np.clip((places * shape).astype(np.int64), 0, shape - 1) @ strides
        total = flat[index].reshape(-1, count).sum(axis=1, dtype=np.int64)
        result[first:last] = (total + count // 2) // count

    slabs(frame.size, VOXELS, work, report)
    return adopted(result.reshape(frame.shape))


def warp_mesh(mesh: Mesh, offsets: Offsets, *, box: Box | None = None) -> Mesh:
    """Return a mesh bent by a fractal homeomorphism h of a box: its points are moved.

    The body is { x : h(x) ∈ body }, as of ``warp``: points go where h came from, h⁻¹, found by
    Newton's method in the trilinear cells, digit by digit. What joins them stays: triangles, cells,
    parts, closedness and Euler number are the same. Sides between points stay straight, so bends
    finer than the mesh are not seen; points on a side of the box stay on it.

    Parameters
    ----------
    mesh
        A closed surface, or a volume mesh of tetrahedra and hexahedra.
    offsets
        How far the 3 × 3 × 3 points of a lattice are moved, in edges of the box, as in ``warp``.
    box
        The box that h maps onto itself, in the mesh's unit; the mesh's own where not given.

    Raises
    ------
    ModelError
        As ``warp``.
    MeshError
        For a surface that is not a closed 2-manifold; points outside the box; where a triangle
        would cross another, parts of a body of cells cross each other, a piece of surface be
        turned inside out or a cell be turned over or folded (names it): the finer the mesh the more
        it sees of h, which stretches and shears without bound.
    """
    bend = homeomorphism(offsets)
    if isinstance(mesh, SurfaceMesh):
        check_manifold(mesh, "warp_mesh")
        surface = replace(mesh, points=_pushed(mesh.points, bend, box))
        _check_surface(mesh, surface)
        return surface
    _check_shapes(mesh)
    tags = {name: tag for name, tag in mesh.cell_tags.items() if name != ADDRESS}
    bent = replace(mesh, points=_pushed(mesh.points, bend, box), cell_tags=tags)
    _check_cells(bent)
    _check_apart(mesh, bent)
    return bent


def _pushed(points: Floats, bend: Homeomorphism, box: Box | None) -> Floats:
    about = Box.of_points(points) if box is None else box
    lower, upper, lengths = (np.array(v) for v in (about.lower, about.upper, about.lengths))
    if not lengths.min() > 0:
        raise MeshError(f"warp_mesh: the box {about.lower} … {about.upper} has no volume")
    outside = ((points < lower) | (points > upper)).any(axis=1)
    if outside.any():
        first = int(np.argmax(outside))
        raise MeshError(
            f"warp_mesh: point {first} at {points[first].tolist()} is outside the box "
            f"{about.lower} … {about.upper}; wanted a box that holds the mesh"
        )
    places = bend.moved_back((points - lower) / lengths)
    return np.where(places == 1, upper, lower + places * lengths)


def _check_apart(before: VolumeMesh, after: VolumeMesh) -> None:
    """Raise ``MeshError`` where parts of the body that lie beside each other would cross."""
    members = boundary_faces(before)
    skins = [_fanned(mesh.points, nodes_of(mesh, members)) for mesh in (before, after)]
    crossed = _crossed(*skins)
    if crossed.any():
        first = int(np.argmax(crossed))
        raise MeshError(
            f"warp_mesh: the body would cross itself {_near(skins[1].corners[first])}, where cells "
            f"lie beside each other; {AGAIN}"
        )


def _fanned(points: Floats, faces: NDArray[np.int64]) -> SurfaceMesh:
    """Return faces (n, 4) as fans about their means; triangles have −1 for their last node."""
    last = np.where(faces < 0, faces[:, 2:3], faces)
    means = points[last].mean(axis=1)
    hubs = len(points) + np.arange(len(faces))
    fan = [np.column_stack([last[:, i], last[:, (i + 1) % 4], hubs]) for i in range(4)]
    triangles = np.concatenate(fan)
    return SurfaceMesh(np.vstack([points, means]), triangles[triangles[:, 0] != triangles[:, 1]])


def _crossed(before: SurfaceMesh, after: SurfaceMesh) -> NDArray[np.bool_]:
    """Return which triangles cross or touch others that have not done so before."""
    from porous.kernels.crossings import crossing

    crossed = np.asarray(crossing(after.points, after.triangles))
    if crossed.any():
        crossed = crossed & ~np.asarray(crossing(before.points, before.triangles))
    return crossed


def _check_surface(before: SurfaceMesh, after: SurfaceMesh) -> None:
    """Raise ``MeshError`` where a triangle crosses another, or a piece is turned inside out."""
    crossed = _crossed(before, after)
    if crossed.any():
        first = int(np.argmax(crossed))
        raise MeshError(
            f"warp_mesh: triangle {first} {_near(after.corners[first])} would cross or touch "
            f"another, and so would {int(crossed.sum()) - 1} more; {AGAIN}"
        )
    found = pieces_of(before)
    old, new = (volumes_of(s.points, s.triangles, found) for s in (before, after))
    turned = np.sign(new) != np.sign(old)
    if turned.any():
        first = int(np.argmax(turned[found.of_triangle]))
        raise MeshError(
            f"warp_mesh: the piece with triangle {first} {_near(after.corners[first])} would be "
            f"turned inside out; {AGAIN}"
        )


def _check_shapes(mesh: VolumeMesh) -> None:
    wrong = [block.shape for block in mesh.blocks if block.shape not in _LEAST]
    if wrong:
        raise MeshError(
            f"warp_mesh: got cells of shape {wrong[0]}; wanted {' and '.join(_LEAST)}, whose "
            "sides are straight"
        )


def _check_cells(mesh: VolumeMesh) -> None:
    """Raise ``MeshError`` where a cell is turned over or folded, naming the first one."""
    first = 0
    for block in mesh.blocks:
        for start in range(0, len(block.cells), CELLS):
            corners = mesh.points[block.cells[start : start + CELLS]]
            least = _LEAST[block.shape](corners)
            if not (least > 0).all():
                worst = int(np.argmin(least > 0))
                raise MeshError(
                    f"warp_mesh: cell {first + start + worst} {_near(corners[worst])} would be "
                    f"turned over or folded; {AGAIN}"
                )
        first += len(block.cells)


def _of_tetrahedra(corners: Floats) -> Floats:
    """Return the Jacobian of each tetrahedron (n, 4, 3)."""
    return np.asarray(np.linalg.det(corners[:, 1:] - corners[:, :1]))


def _of_hexahedra(corners: Floats) -> Floats:
    """Return a number for each hexahedron (n, 8, 3), above zero where none of it is folded."""
    found = jacobians(corners[:, LEXICOGRAPHIC])
    result = np.asarray(found.min(axis=(1, 2, 3)))
    size = np.abs(found).max(axis=(1, 2, 3))
    for cell in np.flatnonzero((result <= 0) & (size > 0)):
        least, _ = least_jacobian(found[cell] / size[cell])
        result[cell] = least if least > FLAT else 0.0
    return result


_LEAST = {"tet4": _of_tetrahedra, "hex8": _of_hexahedra}


def _near(corners: Floats) -> str:
    return "near (" + ", ".join(f"{x:.6g}" for x in corners.mean(axis=0)) + ")"
