"""Pictures of grids and meshes: drawn off screen by VTK in a process of its own, or in a window.

VTK ends the whole process where libX11 or an OpenGL library is missing, so they are looked for
first, and the drawing is done by ``python -m porous.view`` under watch.
"""

from __future__ import annotations

import ctypes
import math
import os
import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.errors import GuestError, ViewError
from porous.guests.process import run, workplace
from porous.values import MeshFields, SurfaceMesh, VolumeMesh, VoxelGrid
from porous.values.volume_topology import boundary_faces, nodes_of

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Drawable = SurfaceMesh | VolumeMesh | VoxelGrid | MeshFields
    Polygons = tuple[NDArray[np.float64], NDArray[np.int64]]

TIME_LIMIT = 120.0
"""Seconds that one picture may take."""

PACKAGES = "libx11-6 libegl1 libgl1"
"""Debian's packages that drawing needs."""

FINEST = 160
"""Voxels along an edge that a picture shows; finer grids are thinned."""

COLOUR = "#e3c794"
INSIDE = "#c65d2e"
"""Of walls, where a surface's labels tell them from the sides of the body or of its frame."""

LIGHTS = (((-0.2, 1.4, 0.8), 0.72), ((-1.2, -0.1, 1.0), 0.52), ((0.5, 0.0, 1.0), 0.4))
"""Where the lights stand, to the right, above and towards the eye, and how bright they are."""

CREASE = 35.0
"""Degrees between triangles from which on the edge between them is drawn as one."""

DEFORMED = 0.06
"""What the greatest displacement is in a picture, of the diagonal of the body's box."""

MAP = ("#30123b", "#4777ef", "#1bd0d5", "#62fc6b", "#d2e935", "#fe9b2d", "#db3a07", "#7a0403")
"""Colours of a field, from the least value to the greatest."""

FROM = (1.7, -2.3, 1.3)
"""Where the eye is, seen from the body."""


def picture(value: Drawable, *, width: int = 800, height: int = 600, triad: bool = True) -> bytes:
    """Return a picture of a grid or a mesh as the bytes of a PNG file.

    Parameters
    ----------
    value
        A voxel grid (its solid voxels are drawn), a surface (its walls darker than the sides of
        the body, where labels tell them apart) or a volume mesh (its boundary, with the edges of
        its cells).
    width, height
        In pixels.
    triad
        Whether the directions of the axes are shown in the lower left corner.

    Raises
    ------
    ViewError
        Where this machine cannot draw, with the packages that would mend it, or where there is
        nothing to draw.
    """
    _require_libraries()
    with workplace() as folder:
        _save_scene(folder / "scene.npz", value, (width, height), triad=triad)
        _draw(folder, "picture.png")
        return (folder / "picture.png").read_bytes()


def field_picture(
    value: MeshFields,
    name: str,
    *,
    title: str = "",
    deformed_by: str = "",
    width: int = 800,
    height: int = 600,
) -> bytes:
    """Return a picture of a field on the boundary of a mesh as the bytes of a PNG file.

    Parameters
    ----------
    value
        A mesh with the field at its nodes.
    name
        Of the field; of vectors their length is drawn, of tensors von Mises' stress.
    title
        Of the bar of colours; by default name and unit.
    deformed_by
        The name of a field of vectors by which the shape is moved, enlarged so that it can be
        seen; the title says by how much.
    width, height
        In pixels.

    Raises
    ------
    ViewError
        As ``picture``, and for fields that cannot be drawn.
    """
    _require_libraries()
    with workplace() as folder:
        scene = _field_scene(value, name, title=title, deformed_by=deformed_by)
        if min(width, height) < 1:
            raise ViewError(f"picture: got {width} × {height} pixels; wanted at least one")
        np.savez(folder / "scene.npz", size=(width, height), **scene)  # type: ignore[arg-type]
        _draw(folder, "picture.png")
        return (folder / "picture.png").read_bytes()


def _field_scene(
    value: MeshFields, name: str, *, title: str, deformed_by: str
) -> dict[str, NDArray[Any]]:
    field, mesh = value[name], value.mesh
    if field.at != "nodes":
        raise ViewError(f"field {name!r}: is at {field.at}; wanted one at nodes")
    faces = _boundary(mesh)
    colour = field.magnitude
    if not len(faces) or not np.isfinite(colour[np.unique(faces)]).any():
        raise ViewError(f"field {name!r}: there is nothing to draw")
    said = title or name.replace("_", " ") + (f" / {field.unit}" if field.unit else "")
    points = mesh.points
    if deformed_by:
        moved = value[deformed_by].values
        if moved.shape != points.shape:
            raise ViewError(f"field {deformed_by!r}: got {moved.shape}; wanted vectors at nodes")
        factor = _factor(points, moved)
        points = points + factor * np.nan_to_num(moved)
        said += f", deformed × {factor:.6g}" if factor else ""
    return {"points": points, "faces": faces, "colour": colour, "title": np.array(said)}


def _factor(points: NDArray[np.float64], moved: NDArray[np.float64]) -> float:
    """Return a round number by which displacements are to be enlarged; zero where all are."""
    most = float(np.nan_to_num(np.linalg.norm(moved, axis=1)).max(initial=0.0))
    if not most:
        return 0.0
    wanted = DEFORMED * float(np.linalg.norm(np.ptp(points, axis=0))) / most
    power = 10.0 ** math.floor(math.log10(wanted))
    return float(f"{max(1, math.floor(wanted / power)) * power:.1e}")


def show(value: Drawable) -> None:
    """Open a window on a grid or a mesh, to turn and zoom; return when it is closed.

    Raises
    ------
    ViewError
        Where there is no screen or this machine cannot draw.
    """
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ViewError(
            "there is no screen here (neither DISPLAY nor WAYLAND_DISPLAY is set); "
            "the report of `porous make` has a picture"
        )
    _require_libraries()
    with workplace() as folder:
        _save_scene(folder / "scene.npz", value, (1200, 900))
        _draw(folder)


def _require_libraries() -> None:
    drawers = ("libEGL.so.1", "libOSMesa.so.8")
    if not _loads("libX11.so.6") or not any(map(_loads, drawers)):
        raise ViewError(
            "this machine cannot draw: libX11 and one of libEGL and OSMesa are needed; "
            f"on Debian: apt-get install {PACKAGES}"
        )


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _draw(folder: Path, *image: str) -> None:
    command = [sys.executable, "-m", "porous.view", "scene.npz", *image]
    limit = TIME_LIMIT if image else math.inf
    try:
        run(command, name="the drawing process", folder=folder, time_limit=limit)
    except GuestError as error:
        raise ViewError(f"the picture could not be drawn: {error}") from None


def _save_scene(path: Path, value: Drawable, size: tuple[int, int], *, triad: bool = True) -> None:
    if min(size) < 1:
        raise ViewError(f"picture: got {size[0]} × {size[1]} pixels; wanted at least one")
    value = value.mesh if isinstance(value, MeshFields) else value
    points, faces = _polygons(value)
    if not len(faces):
        raise ViewError("there is nothing to draw: no solid voxel, triangle or cell")
    edges = isinstance(value, VolumeMesh)
    walls = _walls(value) if isinstance(value, SurfaceMesh) else np.zeros(len(faces), bool)
    if walls.any():  # sides and walls meet in creases, however obtuse
        points, faces = np.concatenate([points, points]), faces + len(points) * ~walls[:, None]
    np.savez(path, points=points, faces=faces, walls=walls, size=size, edges=edges, triad=triad)


def _walls(surface: SurfaceMesh) -> NDArray[np.bool_]:
    """Tell which triangles are walls; none where nothing is told from them."""
    assert surface.labels is not None
    named = np.array([name == "WALL" for name in surface.names])[surface.labels]
    return np.asarray(named & (not named.all()))


def _polygons(value: SurfaceMesh | VolumeMesh | VoxelGrid) -> Polygons:
    if isinstance(value, SurfaceMesh):
        return value.points, value.triangles
    if isinstance(value, VolumeMesh):
        return value.points, _boundary(value)
    from porous.stages import extract_surface  # the drawing process does without the kernels

    surface = extract_surface(_thinned(value), method="voxel-faces")
    return surface.points, surface.triangles


def _boundary(mesh: VolumeMesh) -> NDArray[np.int64]:
    """Faces that just one cell has, shape (f, 4); a triangle names its last point twice."""
    nodes = nodes_of(mesh, boundary_faces(mesh))
    return np.where(nodes < 0, nodes[:, 2:3], nodes)


def _thinned(grid: VoxelGrid) -> VoxelGrid:
    """Return the grid in blocks of voxels where it is finer than a picture shows.

    A block is as full as its fullest voxel: thin walls stay, and fine pores close.
    """
    step = -(-max(grid.frame.shape) // FINEST)
    fill = grid.fill
    for axis, count in enumerate(grid.frame.shape):
        fill = np.maximum.reduceat(fill, range(0, count, step), axis=axis)
    spacing = tuple(h * step for h in grid.frame.spacing)
    frame = replace(grid.frame, spacing=spacing, shape=fill.shape)  # type: ignore[arg-type]
    return VoxelGrid(frame, fill)


def _render(scene: str, image: str | None) -> None:
    """Draw a scene into a PNG file, or into a window where no file is named."""
    import pyvista as pv

    with np.load(scene) as arrays:
        if "colour" in arrays:
            _render_field(dict(arrays), image)
            return
        body = pv.PolyData.from_regular_faces(arrays["points"], arrays["faces"])
        body.cell_data["walls"] = arrays["walls"].astype(np.uint8)
        size, edges, triad = arrays["size"].tolist(), bool(arrays["edges"]), bool(arrays["triad"])
    length = body.length
    plotter: Any = pv.Plotter(off_screen=image is not None, window_size=size)
    _add_body(plotter, body, edges=edges)
    plotter.set_background("white")
    if triad:
        plotter.add_axes()
    plotter.view_vector(FROM)
    plotter.camera.zoom(1.05)
    plotter.enable_ssao(radius=length / 8, bias=length / 1000, kernel_size=32)
    plotter.enable_anti_aliasing("ssaa")
    plotter.show(screenshot=image or False, auto_close=True)


def _render_field(scene: dict[str, NDArray[Any]], image: str | None) -> None:
    """Draw a field's colours, and beside them what they stand for."""
    import pyvista as pv

    body = pv.PolyData.from_regular_faces(scene["points"], scene["faces"])
    body.point_data["colour"] = scene["colour"]
    shown = scene["colour"][np.unique(scene["faces"])]
    low, high = float(np.nanmin(shown)), float(np.nanmax(shown))
    size: list[int] = scene["size"].tolist()
    plotter: Any = pv.Plotter(off_screen=image is not None, window_size=size)
    plotter.set_background("white")
    limits = (low, high if high > low else low + 1.0)
    table = pv.LookupTable(values=_colours(), scalar_range=limits)
    look = {"ambient": 0.45, "diffuse": 0.6, "show_scalar_bar": False}
    plotter.add_mesh(body, scalars="colour", cmap=table, clim=limits, **look)
    letter = max(10, size[1] // 36)
    plotter.add_scalar_bar(
        n_labels=5,
        fmt="%.3g",
        color="black",
        vertical=True,
        position_x=0.88,
        position_y=0.12,
        width=0.05,
        height=0.76,
        label_font_size=letter,
        unconstrained_font_size=True,
    )
    where = {"position": (0.02, 0.94), "viewport": True}
    plotter.add_text(str(scene["title"]), color="black", font_size=round(0.7 * letter), **where)
    plotter.view_vector(FROM)
    plotter.camera.zoom(0.95)
    plotter.enable_anti_aliasing("ssaa")
    plotter.show(screenshot=image or False, auto_close=True)


def _colours() -> NDArray[np.uint8]:
    """Return 256 colours between those of ``MAP``, with their opacity."""
    knots = np.array([[int(word[i : i + 2], 16) for i in (1, 3, 5)] for word in MAP], float)
    place = np.linspace(0, len(knots) - 1, 256)
    rgb = np.stack([np.interp(place, np.arange(len(knots)), knots[:, i]) for i in range(3)], axis=1)
    return np.column_stack([np.rint(rgb), np.full(256, 255)]).astype(np.uint8)


def _add_body(plotter: Any, body: Any, *, edges: bool) -> None:
    """Light a body from where the eye is, round between creases unless its cells are shown."""
    import pyvista as pv

    if not edges:
        body = body.compute_normals(
            cell_normals=False,
            split_vertices=True,
            feature_angle=CREASE,
            consistent_normals=False,
        )
    plotter.add_mesh(
        body,
        scalars="walls",
        cmap=[COLOUR, INSIDE],
        clim=(0, 1),
        show_scalar_bar=False,
        ambient=0.26,
        diffuse=0.8,
        smooth_shading=not edges,
        show_edges=edges,
        edge_color="#5c4a32",
    )
    plotter.remove_all_lights()
    for position, intensity in LIGHTS:
        plotter.add_light(pv.Light(position, light_type="camera light", intensity=intensity))


if __name__ == "__main__":
    _render(sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else None)
