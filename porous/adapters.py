"""Values as other packages' own, in memory: with the phase, the axes and the units that they want.

A package is imported when its function is called. Pores are the voxels that are not solid, of the
whole frame; axes stay x, y, z unless a function says otherwise. Lengths stay in the value's unit
but where the package has a unit of its own.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from porous.errors import GridError, GuestError, MeshError
from porous.values import SHAPES, SurfaceMesh, VolumeMesh, VoxelGrid
from porous.values.units import length_ratio

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.values.value import Value

    Indices = NDArray[np.int64]

CUBIC = 1e-9
"""Voxels whose edges differ by no more than this part of them are cubes."""

TRIMESH_UNITS = {
    "nm": "nanometers",
    "um": "microns",
    "mm": "millimeters",
    "cm": "centimeters",
    "m": "meters",
    "in": "inches",
}

TURNED_WEDGE = (0, 2, 1, 3, 5, 4)
"""A wedge's nodes for VTK, which counts the first triangle as seen from outside: so its faces look
outwards. (Its sizes and its quality of such a wedge have the wrong sign; it contradicts itself.)"""

SKFEM_CORNERS = {
    "tet4": (0, 1, 2, 3),
    "hex8": (6, 2, 5, 7, 1, 3, 4, 0),
    "wed6": (0, 1, 2, 3, 4, 5),
}
"""The corner of ours that each of scikit-fem's is: its hexahedra begin at (1, 1, 1)."""

MAKERS: dict[type[Value], str] = {
    VoxelGrid: "voxelize(model, voxels=64)",
    SurfaceMesh: "extract_surface(grid)",
    VolumeMesh: "hexahedralize(grid)",
}
"""What makes one of each kind."""

SKFEM_MESHES = {
    "tet4": "MeshTet1",
    "tet10": "MeshTet2",
    "hex8": "MeshHex1",
    "hex20": "MeshHex2",
    "wed6": "MeshWedge1",
}


class PorespyImage(NamedTuple):
    """An image as PoreSpy takes it, and its voxel size."""

    im: NDArray[np.bool_]
    """True is pore, axes x, y, z."""
    voxel_size: float
    """Edge of a voxel in metres."""


class TaufactorImage(NamedTuple):
    """An image as TauFactor takes it, and the spacing for its ``AnisotropicSolver``."""

    img: NDArray[np.uint8]
    """1 is pore and conducts, 0 is solid; the flux runs along the first axis."""
    spacing: tuple[float, float, float]
    """Edges of a voxel along the image's axes, in the grid's unit."""


def to_porespy(grid: VoxelGrid) -> PorespyImage:
    """Return a grid as PoreSpy and OpenPNM take it: ``im, voxel_size = to_porespy(grid)``.

    Returns
    -------
    bool, shape ``frame.shape``, True where there is pore; the edge of a voxel in metres.

    Raises
    ------
    GridError
        For voxels that are no cubes: PoreSpy knows one length only.
    TypeError
        For a value of another kind.
    """
    _check_kind("to_porespy", grid, VoxelGrid)
    h = grid.frame.spacing
    if max(h) - min(h) > CUBIC * max(h):
        raise GridError(
            f"to_porespy: got voxels of {h[0]:g} × {h[1]:g} × {h[2]:g} {grid.frame.unit}; PoreSpy "
            "knows cubes only; wanted cubic = true in [voxels], or one spacing"
        )
    return PorespyImage(~grid.solid, h[0] * length_ratio(grid.frame.unit, "m"))


def to_taufactor(grid: VoxelGrid, axis: Literal["x", "y", "z"] = "x") -> TaufactorImage:
    """Return a grid as TauFactor takes it: ``img, spacing = to_taufactor(grid, "z")``.

    ``taufactor.Solver(img)`` takes voxels that are cubes, ``AnisotropicSolver(img, spacing)`` any.

    Parameters
    ----------
    grid
        Its pores conduct.
    axis
        Along which the flux runs. It becomes the first axis; the others keep their order.

    Raises
    ------
    GridError
        For another axis.
    TypeError
        For a value of another kind.
    """
    _check_kind("to_taufactor", grid, VoxelGrid)
    if axis not in ("x", "y", "z"):
        raise GridError(f"to_taufactor: got axis {axis!r}; wanted x, y or z")
    first = "xyz".index(axis)
    order = (first, *(i for i in range(3) if i != first))
    image = np.ascontiguousarray(np.transpose(~grid.solid, order)).astype(np.uint8)
    x, y, z = (float(grid.frame.spacing[i]) for i in order)
    return TaufactorImage(image, (x, y, z))


def to_trimesh(surface: SurfaceMesh) -> Any:
    """Return a surface as a ``trimesh.Trimesh``: points and triangles in their order, not merged.

    Its ``units`` are named; ``face_attributes["part"]`` is each triangle's part, an index into
    ``metadata["parts"]``.

    Raises
    ------
    GuestError
        Where trimesh is not installed.
    TypeError
        For a value of another kind.
    """
    _need("trimesh")
    _check_kind("to_trimesh", surface, SurfaceMesh)
    import trimesh

    mesh = trimesh.Trimesh(
        np.array(surface.points),
        np.array(surface.triangles),
        face_attributes={"part": np.array(surface.labels)},
        metadata={"parts": list(surface.names)},
        process=False,
        validate=False,
    )
    mesh.units = TRIMESH_UNITS[surface.unit]
    return mesh


def to_pyvista(value: VoxelGrid | SurfaceMesh | VolumeMesh) -> Any:
    """Return a value as PyVista's own, with all that it says in arrays.

    A grid becomes ``ImageData`` with the cell array ``fill`` (and ``bulk``); a surface ``PolyData``
    with the cell array ``part`` and the parts' names as field data ``parts``; a volume mesh an
    ``UnstructuredGrid`` with its tags, its parts of cells and of nodes as arrays of 0 and 1, and
    its parts of faces and pairs as field data. The unit is field data ``unit``.

    Raises
    ------
    GuestError
        Where PyVista is not installed.
    TypeError
        For a value of another kind.
    """
    _need("pyvista")
    if isinstance(value, VoxelGrid):
        return _image(value)
    if isinstance(value, SurfaceMesh):
        return _poly(value)
    if isinstance(value, VolumeMesh):
        return _unstructured(value)
    raise TypeError(
        f"to_pyvista: got a {type(value).__name__}; wanted VoxelGrid, SurfaceMesh or VolumeMesh"
    )


def _image(grid: VoxelGrid) -> Any:
    import pyvista

    frame = grid.frame
    image = pyvista.ImageData(
        dimensions=tuple(n + 1 for n in frame.shape),
        spacing=frame.spacing,
        origin=frame.box.lower,
    )
    image.cell_data["fill"] = grid.fill.ravel(order="F")
    if grid.bulk is not None:
        image.cell_data["bulk"] = grid.bulk.ravel(order="F")
    image.add_field_data([frame.unit], "unit")
    return image


def _poly(surface: SurfaceMesh) -> Any:
    import pyvista

    triangles: Any = np.array(surface.triangles)
    poly = pyvista.PolyData.from_regular_faces(np.array(surface.points), triangles)
    poly.cell_data["part"] = np.array(surface.labels)
    poly.add_field_data(list(surface.names), "parts")
    poly.add_field_data([surface.unit], "unit")
    return poly


def _unstructured(mesh: VolumeMesh) -> Any:
    import pyvista

    rows, kinds = [np.zeros(0, np.int64)], [np.zeros(0, np.uint8)]
    for block in mesh.blocks:
        cells = block.cells[:, TURNED_WEDGE] if block.shape == "wed6" else block.cells
        rows.append(np.insert(cells, 0, cells.shape[1], axis=1).ravel())
        kinds.append(np.full(len(cells), SHAPES[block.shape].vtk, np.uint8))
    grid = pyvista.UnstructuredGrid(
        np.concatenate(rows), np.concatenate(kinds), np.array(mesh.points)
    )
    for name, tag in mesh.cell_tags.items():
        grid.cell_data[name] = np.array(tag)
    for name, part in mesh.parts.items():
        if part.kind == "cells":
            grid.cell_data[name] = _marks(part.members, mesh.cells)
        elif part.kind == "nodes":
            grid.point_data[name] = _marks(part.members, len(mesh.points))
        else:
            grid.add_field_data(np.array(part.members), name)
    grid.add_field_data([mesh.unit], "unit")
    return grid


def _marks(members: Indices, count: int) -> NDArray[np.uint8]:
    marks = np.zeros(count, np.uint8)
    marks[members] = 1
    return marks


def to_skfem(mesh: VolumeMesh) -> Any:
    """Return a volume mesh as a mesh of scikit-fem, with its named boundaries and subdomains.

    ``boundaries`` are the parts of faces, ``subdomains`` those of cells; scikit-fem has no named
    nodes. Nodes that no cell has are left out, the others keep their order; of elements with nodes
    along their edges the corners come first. Hexahedra of 20 nodes get nodes in the middle of
    faces and cells where their own shape has them, so that they are as bent as they were.

    The rule by which scikit-fem 12.0 integrates over wedges is wrong (its weights sum to a half of
    the wedge): give ``Basis`` a ``quadrature`` of your own for them.

    Raises
    ------
    GuestError
        Where scikit-fem is not installed.
    MeshError
        For elements of several shapes, or none.
    TypeError
        For a value of another kind.
    """
    _need("skfem", "scikit-fem")
    _check_kind("to_skfem", mesh, VolumeMesh)
    import skfem

    shapes = sorted({block.shape for block in mesh.blocks if len(block.cells)})
    if len(shapes) != 1:
        raise MeshError(
            f"to_skfem: got elements {', '.join(shapes) or 'none'}; wanted one shape, for a mesh "
            "of scikit-fem has one"
        )
    (shape,) = shapes
    cells = np.concatenate([block.cells for block in mesh.blocks if len(block.cells)])
    used, index = np.unique(cells, return_inverse=True)
    points, cells = mesh.points[used], index.reshape(cells.shape)
    if shape == "hex20":
        points, cells = _triquadratic(points, cells)
    order = _skfem_order(shape)
    rows = np.ascontiguousarray(points.T), np.ascontiguousarray(cells[:, order].T)
    result = getattr(skfem, SKFEM_MESHES[shape])(*rows)
    local = _skfem_facets(shape, result)
    faces = {
        name: np.unique(result.t2f[local[part.members[:, 1]], part.members[:, 0]])
        for name, part in mesh.parts.items()
        if part.kind == "faces"
    }
    groups = {name: part.members for name, part in mesh.parts.items() if part.kind == "cells"}
    return result.with_boundaries(faces).with_subdomains(groups)


def _skfem_order(shape: str) -> Sequence[int]:
    """Return which node of ours each of scikit-fem's is; of hexahedra, of 27 nodes of ours."""
    kind = SHAPES[shape]
    corners = SKFEM_CORNERS[kind.linear or shape]
    if not kind.edges:
        return corners
    if shape == "tet10":
        return range(10)
    from skfem.refdom import RefHex

    ours = {frozenset(edge): 8 + i for i, edge in enumerate(kind.edges)}
    ours |= {frozenset(face): 20 + i for i, face in enumerate(kind.faces)}
    parts = [*RefHex.edges, *RefHex.facets]
    return (*corners, *(ours[frozenset(corners[i] for i in part)] for part in parts), 26)


def _skfem_facets(shape: str, mesh: Any) -> Indices:
    """Return which of scikit-fem's facets each face of ours is."""
    corners = SKFEM_CORNERS[SHAPES[shape].linear or shape]
    theirs = [frozenset(corners[i] for i in facet) for facet in mesh.elem.refdom.facets]
    return np.array([theirs.index(frozenset(face)) for face in SHAPES[shape].faces])


def _triquadratic(
    points: NDArray[np.float64], cells: Indices
) -> tuple[NDArray[np.float64], Indices]:
    """Return hexahedra of 27 nodes that are where those of 20 are: nodes, and cells (n, 27).

    In the middle of a face or a cell the 20 functions are −1/4 for corners, and 1/2 (of a face) or
    1/4 (of a cell) for the nodes along edges.
    """
    kind = SHAPES["hex20"]
    middles, keys = [], []
    for face in kind.faces:
        edges = [8 + i for i, edge in enumerate(kind.edges) if set(edge) <= set(face)]
        corners = points[cells[:, face]].sum(axis=1) / 4
        middles.append(points[cells[:, edges]].sum(axis=1) / 2 - corners)
        keys.append(np.sort(cells[:, face], axis=1))
    _, first, faces = np.unique(
        np.concatenate(keys), axis=0, return_index=True, return_inverse=True
    )
    inner = points[cells[:, 8:]].sum(axis=1) / 4 - points[cells[:, :8]].sum(axis=1) / 4
    places = np.concatenate([points, np.concatenate(middles)[first], inner])
    more = len(points) + faces.reshape(6, -1).T
    centres = len(points) + len(first) + np.arange(len(cells))[:, None]
    return places, np.concatenate([cells, more, centres], axis=1)


def _check_kind(what: str, value: object, kind: type[Value]) -> None:
    if not isinstance(value, kind):
        raise TypeError(
            f"{what}: got a {type(value).__name__}; wanted a {kind.__name__}: {MAKERS[kind]} makes "
            "one"
        )


def _need(module: str, package: str = "") -> None:
    if find_spec(module) is None:
        name = package or module
        raise GuestError(f"to_{module}: {name} is not installed; wanted pip install {name}")
