"""Contours of layers: their areas are the solid voxels', and they cross nowhere."""

import itertools

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from porous import formats
from porous.formats import cli
from porous.formats.cli import contours
from porous.values import Frame, VoxelGrid

LAYERS = hnp.arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 7)))


def area(loop):
    x, y = np.array(loop).T
    return float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) / 2)


def edges(loop):
    """Return the unit edges of a contour, (x, y) to (x, y)."""
    found = []
    for (ax, ay), (bx, by) in itertools.pairwise(loop):
        steps = max(abs(bx - ax), abs(by - ay))
        dx, dy = (bx - ax) // steps, (by - ay) // steps
        found += [
            ((ax + i * dx, ay + i * dy), (ax + (i + 1) * dx, ay + (i + 1) * dy))
            for i in range(steps)
        ]
    return found


@given(LAYERS)
@settings(max_examples=200)
def test_areas_are_those_of_the_solid(solid):
    loops = contours(solid)
    assert sum(map(area, loops)) == solid.sum()


@given(LAYERS)
@settings(max_examples=100)
def test_there_is_a_contour_for_each_component_and_each_hole(solid):
    """Solid is joined by sides alone, so what it leaves out is joined by corners too."""
    outer = [loop for loop in contours(solid) if area(loop) > 0]
    holes = [loop for loop in contours(solid) if area(loop) < 0]
    _, parts = ndimage.label(solid)
    _, voids = ndimage.label(~np.pad(solid, 1), np.ones((3, 3)))
    assert len(outer) == parts
    assert len(holes) == voids - 1


@given(LAYERS)
@settings(max_examples=100)
def test_contours_run_along_every_edge_once_with_solid_to_the_left(solid):
    padded = np.pad(solid, 1)
    seen = [edge for loop in contours(solid) for edge in edges(loop)]
    assert len(seen) == len(set(seen))
    for (ax, ay), (bx, by) in seen:
        mx, my, dx, dy = (ax + bx) / 2, (ay + by) / 2, bx - ax, by - ay
        left = int(np.floor(mx - dy / 2)), int(np.floor(my + dx / 2))
        right = int(np.floor(mx + dy / 2)), int(np.floor(my - dx / 2))
        assert padded[left[0] + 1, left[1] + 1]
        assert not padded[right[0] + 1, right[1] + 1]
    jumps = sum(np.count_nonzero(np.diff(padded.astype(int), axis=axis)) for axis in (0, 1))
    assert len(seen) == jumps


@given(LAYERS)
@settings(max_examples=100)
def test_contours_end_where_they_begin_and_list_corners_only(solid):
    for loop in contours(solid):
        assert loop[0] == loop[-1]
        for a, b, c in zip(loop[-2:-1] + loop[:-2], loop[:-1], loop[1:], strict=True):
            assert (a[0] == b[0]) != (a[1] == b[1])
            assert (a[0] == b[0]) == (b[1] == c[1])


def test_contours_touch_where_voxels_do_and_do_not_cross():
    """At a corner that two solid voxels share, each contour turns back to its own voxel."""
    for solid in (np.eye(2, dtype=bool), np.eye(2, dtype=bool)[::-1]):
        loops = contours(solid)
        assert [area(loop) for loop in loops] == [1, 1]
        assert all(len(loop) == 5 for loop in loops)
        assert all((1, 1) in loop for loop in loops)


def test_voids_that_touch_in_a_corner_are_one_hole():
    solid = np.ones((4, 4), bool)
    solid[1, 1] = solid[2, 2] = False
    assert sorted(area(loop) for loop in contours(solid)) == [-2, 16]


# --- the file ----------------------------------------------------------------------------------


def grid_of(solid, unit="um", spacing=(0.1, 1 / 3, 1e-5)):
    return VoxelGrid.of_solid(solid, Frame((1, -2, 3), spacing, solid.shape, unit=unit))


def lines_of(grid):
    return b"".join(cli.write(grid)).decode("ascii").splitlines()


def test_the_header_says_unit_box_and_layers():
    lines = lines_of(grid_of(np.ones((3, 6, 2), bool)))
    assert lines[:4] == ["$$HEADERSTART", "$$ASCII", "$$UNITS/0.001", "$$VERSION/200"]
    assert lines[5] == "$$DIMENSION/1.0,-2.0,3.0,1.3,0.0,3.00002"
    assert lines[6:9] == ["$$LAYERS/3", "$$HEADEREND", "$$GEOMETRYSTART"]
    assert lines[-1] == "$$GEOMETRYEND"


@pytest.mark.parametrize(
    ("unit", "said"),
    [("nm", "0.000001"), ("mm", "1.0"), ("cm", "10.0"), ("m", "1000.0"), ("in", "25.4")],
)
def test_units_are_millimetres_without_exponents(unit, said):
    assert f"$$UNITS/{said}" in lines_of(grid_of(np.ones((1, 1, 1), bool), unit))


def test_a_block_is_one_contour_a_layer_at_the_layers_tops():
    lines = lines_of(grid_of(np.ones((3, 6, 2), bool)))
    assert lines[9:-1] == [
        "$$LAYER/3.0",
        "$$LAYER/3.00001",
        "$$POLYLINE/1,1,5,1.0,-2.0,1.3,-2.0,1.3,0.0,1.0,0.0,1.0,-2.0",
        "$$LAYER/3.00002",
        "$$POLYLINE/1,1,5,1.0,-2.0,1.3,-2.0,1.3,0.0,1.0,0.0,1.0,-2.0",
    ]


def test_holes_run_clockwise():
    solid = np.ones((3, 4, 1), bool)
    solid[1, 1] = False
    rows = [line for line in lines_of(grid_of(solid)) if line.startswith("$$POLYLINE")]
    for row in rows:
        _, direction, count, *numbers = row.removeprefix("$$POLYLINE/").split(",")
        loop = np.array(numbers, float).reshape(int(count), 2)
        assert (area(loop) > 0) == (direction == "1")
    assert sorted(row.split(",")[1] for row in rows) == ["0", "1"]


@given(hnp.arrays(bool, st.tuples(*[st.integers(1, 6)] * 3)))
@settings(max_examples=40)
def test_written_areas_are_the_solid_voxels_layer_by_layer(solid):
    grid = grid_of(solid, spacing=(0.125, 0.375, 0.5))  # powers of two: no rounding
    layer, found = -2, np.zeros(solid.shape[2])
    for line in lines_of(grid):
        if line.startswith("$$LAYER/"):
            layer += 1
            assert float(line[8:]) == 3 + 0.5 * (layer + 1)
        elif line.startswith("$$POLYLINE/"):
            numbers = line.split(",")[3:]
            found[layer] += area(np.array(numbers, float).reshape(-1, 2))
    assert np.array_equal(found, solid.sum(axis=(0, 1)) * 0.125 * 0.375)


def test_no_number_has_an_exponent(tmp_path):
    solid = np.random.default_rng(2).random((5, 4, 3)) < 0.6
    formats.write(grid_of(solid, spacing=(1e-7, 1e-9, 1e-12)), tmp_path / "part.cli")
    text = (tmp_path / "part.cli").read_text("ascii")
    assert set(text.replace("$$", "")) <= set("ABCDEFGHIJKLMNOPQRSTUVWXYZporus\n/,.-0123456789")


def test_nothing_solid_is_layers_without_contours():
    lines = lines_of(grid_of(np.zeros((2, 2, 2), bool)))
    assert [line for line in lines if "POLYLINE" in line] == []
    assert sum(line.startswith("$$LAYER/") for line in lines) == 3
