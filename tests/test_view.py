"""Pictures: what is drawn has the body's outline, and a machine that cannot draw says so."""

import io
import os
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from porous import view
from porous.errors import MeshError, PorousError, ViewError
from porous.values import Block, Frame, SurfaceMesh, VolumeMesh, VoxelGrid

UNIT_CUBE = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1.0]]
)


def can_draw():
    try:
        view._require_libraries()
    except ViewError:
        return False
    return True


draws = pytest.mark.skipif(
    not can_draw() and not os.environ.get("CI"), reason="this machine cannot draw"
)


def tower(height):
    frame = Frame((5, 5, 5), (1, 1, 1), (2, 3, height))
    return VoxelGrid(frame, np.full(frame.shape, 255, np.uint8))


def tetrahedron(size=1.0):
    points = size * np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 5.0]])
    return SurfaceMesh(points, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))


def bricks():
    """Two hexahedra side by side and a tetrahedron on its own."""
    points = np.vstack([UNIT_CUBE, UNIT_CUBE[[1, 2, 5, 6]] + [1, 0, 0], tetrahedron().points + 4])
    hexes = [[0, 1, 2, 3, 4, 5, 6, 7], [1, 8, 9, 2, 5, 10, 11, 6]]
    return VolumeMesh(points, (Block("hex8", hexes), Block("tet4", [[12, 13, 14, 15]])))


def extent(png):
    """Return the drawn body's width and height in pixels, without the triad in the corner."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    body = (pixels[..., 0] - pixels[..., 2] > 25) & (pixels[..., 0] < 250)
    body[-pixels.shape[0] // 4 :, : pixels.shape[1] // 4] = False
    rows, columns = np.flatnonzero(body.any(axis=1)), np.flatnonzero(body.any(axis=0))
    return np.ptp(columns) + 1, np.ptp(rows) + 1


@draws
def test_a_picture_has_the_asked_size_and_the_body_in_it():
    png = view.picture(tetrahedron(), width=320, height=200)
    assert png.startswith(b"\x89PNG\r\n\x1a\n")
    assert Image.open(io.BytesIO(png)).size == (320, 200)
    width, height = extent(png)
    assert height > 100
    assert 30 < width < 320


@draws
@pytest.mark.parametrize(("height", "stands"), [(1, False), (12, True)])
def test_z_points_upwards(height, stands):
    wide, high = extent(view.picture(tower(height), width=300, height=300))
    assert (high > 1.5 * wide) == stands


@draws
def test_a_mesh_of_cells_is_drawn():
    wide, high = extent(view.picture(bricks(), width=300, height=200))
    assert wide > 50
    assert high > 50


def colours(png):
    """Return the colour of each pixel that is not white, as saturations from 0 to 1."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(float)
    pixels = pixels[pixels.min(axis=-1) < 240]
    return 1 - pixels.min(axis=-1) / pixels.max(axis=-1)


@draws
def test_walls_are_told_from_sides_where_labels_do():
    body = tetrahedron()
    labelled = replace(body, labels=np.array([0, 1, 0, 0]), names=("WALL", "YMIN"))
    plain, both = (
        colours(view.picture(value, width=200, height=200, triad=False))
        for value in (body, labelled)
    )
    assert plain.max() < 0.55
    assert (both > 0.65).sum() > 200
    assert (both < 0.55).sum() > 200


@draws
def test_the_triad_can_be_left_out():
    with_it, without = (
        np.asarray(Image.open(io.BytesIO(view.picture(tower(9), width=300, height=300, triad=t))))
        for t in (True, False)
    )
    corner = np.s_[-75:, :75]
    assert without[corner].min() > 240
    assert with_it[corner].min() < 200


def test_the_boundary_is_the_faces_of_one_cell():
    faces = view._boundary(bricks())
    assert len(faces) == 10 + 4
    assert [1, 2, 5, 6] not in np.sort(faces, axis=1).tolist()
    triangles = faces[faces[:, 2] == faces[:, 3]]
    assert len(triangles) == 4


def test_a_fine_grid_is_thinned_without_losing_walls(monkeypatch):
    monkeypatch.setattr(view, "FINEST", 10)
    frame = Frame((1, 2, 3), (0.5, 0.25, 2), (25, 4, 7))
    fill = np.zeros(frame.shape, np.uint8)
    fill[13, 1, 6] = 200
    thin = view._thinned(VoxelGrid(frame, fill))
    assert thin.frame.shape == (9, 2, 3)
    assert thin.frame.spacing == (1.5, 0.75, 6)
    assert np.argwhere(thin.fill).tolist() == [[4, 0, 2]]
    monkeypatch.undo()
    assert np.array_equal(view._thinned(VoxelGrid(frame, fill)).fill, fill)


# --- what goes wrong -----------------------------------------------------------------------


@pytest.mark.parametrize("missing", ["libX11.so.6", "libEGL.so.1 libOSMesa.so.8"])
def test_missing_libraries_are_named_before_anything_is_drawn(monkeypatch, missing):
    monkeypatch.setattr(view, "_loads", lambda library: library not in missing)
    monkeypatch.setattr(view, "_draw", lambda *_: pytest.fail("it tried"))
    with pytest.raises(ViewError, match="apt-get install libx11-6 libegl1 libgl1"):
        view.picture(tetrahedron())


def test_one_way_to_draw_is_enough(monkeypatch):
    monkeypatch.setattr(view, "_loads", lambda library: library != "libEGL.so.1")
    view._require_libraries()


def test_a_library_that_is_not_there_is_noticed():
    assert not view._loads("libthere-is-none.so.7")


def test_nothing_to_draw(monkeypatch):
    monkeypatch.setattr(view, "_require_libraries", lambda: None)
    with pytest.raises(ViewError, match="nothing to draw"):
        view.picture(SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), int)))
    frame = Frame((0, 0, 0), (1, 1, 1), (2, 3, 4))
    with pytest.raises(MeshError, match="no voxel is at least half solid"):
        view.picture(VoxelGrid(frame, np.zeros(frame.shape, np.uint8)))
    with pytest.raises(ViewError, match="got 0 × 9 pixels"):
        view.picture(tetrahedron(), width=0, height=9)


def test_a_drawing_process_that_dies_is_an_error_not_the_end(monkeypatch):
    monkeypatch.setattr(view, "_require_libraries", lambda: None)
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(ViewError, match="could not be drawn: the drawing process failed"):
        view.picture(tetrahedron())


def test_a_drawing_process_that_hangs_is_stopped(monkeypatch):
    monkeypatch.setattr(view, "_require_libraries", lambda: None)
    monkeypatch.setattr(view, "TIME_LIMIT", 0.1)
    with pytest.raises(ViewError, match="time limit"):
        view.picture(tetrahedron())


def test_show_needs_a_screen(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(ViewError, match="no screen") as caught:
        view.show(tetrahedron())
    assert isinstance(caught.value, PorousError)
    assert caught.value.exit_code == 1
