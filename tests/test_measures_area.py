"""Areas: planes, balls, cubes and unequal voxels; what each method may be off by."""

import math

import numpy as np
import pytest

from porous import extract_surface, measures
from porous.kernels.windows import DIRECTIONS
from porous.measures._intercept import rays
from porous.measures._surface_area import _crofton_area, crofton
from porous.values import FILL, Frame, SurfaceMesh, VoxelGrid

SPACINGS = [(1, 1, 1), (1, 1, 2), (1, 1.5, 0.7), (0.02, 0.05, 0.03)]
CENTRE = np.full((1, 3), 0.5)
POINTS = np.column_stack([np.repeat(FILL.rows, FILL.depths.shape[1], 0), FILL.depths.ravel()])


def sampled(inside, frame, *, points=POINTS):
    index = np.stack(np.meshgrid(*map(np.arange, frame.shape), indexing="ij"), axis=-1)
    count = sum(
        inside(np.array(frame.origin) + (index + p) * frame.spacing).astype(int) for p in points
    )
    full = len(points)
    fill = ((255 * count + full // 2) // full).astype(np.uint8)
    return VoxelGrid(frame, fill, sampling="fill" if full == 64 else "centre")


def ball(radius, spacing=(1, 1, 1), *, seed=0, points=CENTRE):
    half = [math.ceil(radius / h) + 2 for h in spacing]
    origin = -np.array(half) * spacing + np.random.default_rng(seed).uniform(-0.5, 0.5, 3) * spacing
    frame = Frame(tuple(origin), spacing, tuple(2 * n for n in half))
    return sampled(lambda p: (p**2).sum(axis=-1) <= radius**2, frame, points=points)


def cube(edge, *, seed=0, points=CENTRE):
    random = np.random.default_rng(seed)
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0] if seed else np.eye(3)
    n = math.ceil(edge * 1.75) + 3
    origin = -n / 2 + random.uniform(-0.5, 0.5, 3)
    frame = Frame(tuple(origin), (1, 1, 1), (n, n, n))
    return sampled(lambda p: (abs(p @ turn) <= edge / 2).all(axis=-1), frame, points=points)


# --- Crofton -------------------------------------------------------------------------------


@pytest.mark.parametrize("spacing", SPACINGS)
def test_weights_are_shares_of_the_sphere(spacing):
    rule = crofton(spacing)
    assert rule.weights.sum() == pytest.approx(1)
    assert (rule.weights > 0).all()
    np.testing.assert_allclose(rule.lengths, np.linalg.norm(DIRECTIONS * spacing, axis=1))
    points = np.random.default_rng(0).normal(size=(200_000, 3))
    unit = DIRECTIONS * spacing / rule.lengths[:, None]
    nearest = np.abs(points @ unit.T).argmax(axis=1)
    shares = np.bincount(nearest, minlength=13) / len(points)
    np.testing.assert_allclose(rule.weights, shares, atol=4e-3)


def test_cubic_weights_and_plane_bias_are_those_of_the_literature():
    # Ohser & Mücklich 2000, table of 13 directions: 0.0916, 0.0740, 0.0704.
    rule = crofton((0.3, 0.3, 0.3))
    np.testing.assert_allclose(rule.weights, [0.0916] * 3 + [0.0740] * 6 + [0.0704] * 4, atol=1e-4)
    assert rule.lowest == pytest.approx(-0.0726, abs=1e-3)
    assert rule.highest == pytest.approx(0.0228, abs=1e-3)
    assert rule.spread == pytest.approx(0.0162, abs=1e-3)


@pytest.mark.parametrize("spacing", SPACINGS)
def test_planes_are_seen_with_the_stated_bias(spacing):
    rule = crofton(spacing)
    random = np.random.default_rng(1)
    for normal in (*random.normal(size=(40, 3)), *np.eye(3), (1, 1, 0), (1, 1, 1)):
        unit = np.array(normal) / np.linalg.norm(normal)
        # Crossings of a unit area along a step: the prism between the plane and its image holds
        # so many voxels.
        crossings = np.abs((DIRECTIONS * spacing) @ unit) / math.prod(spacing)
        area, doubt = _crofton_area(crossings, spacing)
        assert rule.lowest - 1e-3 <= area - 1 <= rule.highest + 1e-3
        assert abs(area - 1) <= doubt


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("middle", [1.0, 2e3, 1e7])
def test_needles_and_sheets_of_any_length_are_measured(axis, middle):
    spacing = np.roll([1.0, middle, 1e7], axis)
    rule = crofton(tuple(spacing))
    longest = spacing.max()
    assert rule.weights.sum() == pytest.approx(1)
    assert rays(tuple(spacing)).weights.sum() == pytest.approx(1)
    np.testing.assert_allclose(rule.lengths, np.linalg.norm(DIRECTIONS * spacing, axis=1))
    for normal in np.random.default_rng(1).normal(size=(40, 3)):
        unit = normal / np.linalg.norm(normal)
        seen = 2 * np.abs(DIRECTIONS * (spacing / longest) @ unit) / (rule.lengths / longest)
        assert rule.lowest - 1e-3 <= seen @ rule.weights - 1 <= rule.highest + 1e-3
    solid = np.random.default_rng(0).random((8, 8, 8)) < 0.5
    fill = np.where(solid, 255, 0).astype(np.uint8)
    grid = VoxelGrid(Frame((0, 0, 0), tuple(spacing), solid.shape), fill)
    row, faces = (measures.surface_area(grid, method=m) for m in ("crofton", "voxel faces"))
    assert abs(row.value - faces.value) <= row.uncertainty + faces.uncertainty


@pytest.mark.parametrize("spacing", SPACINGS[:3])
@pytest.mark.parametrize("radius", [10, 20])
def test_balls_are_right_within_a_percent(radius, spacing):
    for seed in range(3):
        row = measures.surface_area(ball(radius, spacing, seed=seed))
        truth = 4 * math.pi * radius**2
        assert row.method == "crofton"
        assert abs(row.value - truth) < 0.01 * truth * max(1, 10 / radius * max(spacing))
        assert abs(row.value - truth) <= row.uncertainty < 0.3 * truth


@pytest.mark.parametrize("edge", [5, 9.3, 20])
@pytest.mark.parametrize("seed", range(4))
def test_cubes_are_within_the_uncertainty(edge, seed):
    row = measures.surface_area(cube(edge, seed=seed))
    assert abs(row.value - 6 * edge**2) <= row.uncertainty
    faces = measures.surface_area(cube(edge, seed=seed), method="voxel faces")
    assert abs(faces.value - 6 * edge**2) <= faces.uncertainty


def test_area_scales_with_the_unit_and_spacing():
    grid = ball(6)
    small = VoxelGrid(Frame((5, 6, 7), (0.1, 0.1, 0.1), grid.frame.shape, unit="um"), grid.fill)
    for method in ("crofton", "voxel faces"):
        one, other = (measures.surface_area(g, method=method) for g in (grid, small))
        assert other.value == pytest.approx(one.value / 100)
        assert (one.unit, other.unit) == ("mm²", "um²")


# --- voxel faces ---------------------------------------------------------------------------


def test_faces_of_unequal_voxels():
    fill = np.zeros((5, 6, 7), np.uint8)
    fill[1:3, 1:4, 1:5] = 255
    grid = VoxelGrid(Frame((0, 0, 0), (2, 3, 5), fill.shape), fill)
    x, y, z = 2 * 2, 3 * 3, 4 * 5
    area = measures.surface_area(grid, method="voxel faces")
    assert area.value == 2 * (x * y + y * z + x * z)
    per_volume = measures.specific_surface_area(grid, method="voxel faces")
    assert per_volume.value == pytest.approx(area.value / (10 * 18 * 35))
    assert per_volume.unit == "1/mm"


@pytest.mark.parametrize("periodic", [(False, False, False), (True, False, True)])
def test_a_period_has_the_area_of_its_tiling(periodic):
    fill = (np.random.default_rng(4).random((6, 5, 7)) * 255).astype(np.uint8)
    times = [3 if wraps else 1 for wraps in periodic]
    one = VoxelGrid(Frame((0, 0, 0), (1, 2, 3), fill.shape, periodic), fill)
    many = np.tile(fill, times)
    tiled = VoxelGrid(Frame((0, 0, 0), (1, 2, 3), many.shape, periodic), many)
    for function in (measures.surface_area, measures.interface_area):
        for method in ("crofton", "voxel faces"):
            assert function(tiled, method=method).value == pytest.approx(
                math.prod(times) * function(one, method=method).value
            )


# --- interface -----------------------------------------------------------------------------


def test_the_interface_leaves_out_what_lies_on_the_border():
    fill = np.full((12, 14, 16), 255, np.uint8)
    fill[:, 4:9, :] = 0
    grid = VoxelGrid(Frame((0, 0, 0), (1, 1, 1), fill.shape), fill)
    assert measures.interface_area(grid, method="voxel faces").value == 2 * 12 * 16
    crossed = measures.interface_area(grid)
    assert crossed.value == pytest.approx(2 * 12 * 16 * 0.9274, rel=1e-3)  # of a plane
    assert abs(crossed.value - 2 * 12 * 16) <= crossed.uncertainty
    surface = extract_surface(grid)
    row = measures.measure(surface, grid=grid)["interface_area"]
    assert abs(row.value - 2 * 12 * 16) <= row.uncertainty
    assert row.value < 0.5 * measures.surface_area(surface).value


@pytest.mark.parametrize("room", [1, 4, 15])
def test_the_interface_of_a_body_inside_the_frame_is_its_surface(room):
    solid = ball(9).solid
    grid = VoxelGrid.of_solid(
        np.pad(solid, room), Frame((0, 0, 0), (1, 1, 1), np.pad(solid, room).shape)
    )
    for method in ("crofton", "voxel faces"):
        surface = measures.surface_area(grid, method=method).value
        assert measures.interface_area(grid, method=method).value == pytest.approx(surface)


@pytest.mark.parametrize("periodic", [(False, False, False), (True, False, False)])
def test_the_interface_and_its_doubt_are_the_same_whichever_way_round(periodic):
    solid = np.random.default_rng(5).random((7, 8, 5)) < 0.5
    spacing = (1.0, 0.7, 1.2)

    def taken(solid):
        row = measures.interface_area(
            VoxelGrid.of_solid(solid, Frame((0, 0, 0), spacing, solid.shape, periodic))
        )
        return row.value, row.uncertainty

    for axes in ((0,), (1,), (2,), (0, 2), (0, 1, 2)):
        assert taken(np.flip(solid, axes)) == pytest.approx(taken(solid), rel=1e-12)


def test_the_skin_of_a_body_is_no_part_of_the_doubt_of_its_pores():
    """One spherical pore in a block: as doubtful as the same ball of solid in nothing."""
    pore = np.pad(ball(10).solid, 18)
    frame = Frame((0, 0, 0), (1, 1, 1), pore.shape)
    row = measures.interface_area(VoxelGrid.of_solid(~pore, frame))
    truth = 4 * math.pi * 100
    assert abs(row.value - truth) <= row.uncertainty < 0.15 * truth
    same = measures.surface_area(VoxelGrid.of_solid(pore, frame))
    assert (row.value, row.uncertainty) == pytest.approx((same.value, same.uncertainty))
    block = measures.interface_area(VoxelGrid.of_solid(np.ones_like(pore), frame))
    assert (block.value, block.uncertainty) == (0, 0)


def test_interface_and_surface_agree_in_periodic_space():
    fill = (np.random.default_rng(4).random((6, 5, 7)) * 255).astype(np.uint8)
    grid = VoxelGrid(Frame((0, 0, 0), (1, 2, 3), fill.shape, (True, True, True)), fill)
    for method in ("crofton", "voxel faces"):
        assert measures.interface_area(grid, method=method).value == pytest.approx(
            measures.surface_area(grid, method=method).value
        )


def test_no_interface_has_no_area():
    for value in (0, 255):
        grid = VoxelGrid(
            Frame((0, 0, 0), (1, 1, 1), (4, 5, 6), (True, True, True)),
            np.full((4, 5, 6), value, np.uint8),
        )
        row = measures.surface_area(grid)
        assert row.value == row.uncertainty == 0
    single = VoxelGrid(Frame((0, 0, 0), (1, 1, 1), (1, 1, 1)), np.full((1, 1, 1), 255, np.uint8))
    assert measures.interface_area(single).value == 0


# --- triangles -----------------------------------------------------------------------------


def test_triangles_on_fractions_of_a_ball():
    grid = ball(20, points=POINTS)
    surface = extract_surface(grid)
    truth = 4 * math.pi * 400
    row = measures.measure(surface, grid=grid)["surface_area"]
    assert abs(row.value - truth) < 0.01 * truth
    assert abs(row.value - truth) <= row.uncertainty < 0.08 * truth
    volume = measures.measure(surface, grid=grid)["volume"]
    assert abs(volume.value - truth * 20 / 3) <= volume.uncertainty


@pytest.mark.parametrize("points", [CENTRE, POINTS])
@pytest.mark.parametrize("edge", [5, 11.4])
def test_triangles_of_cubes_are_within_the_uncertainty(points, edge):
    for seed in range(3):
        grid = cube(edge, seed=seed, points=points)
        rows = measures.measure(extract_surface(grid), grid=grid)
        assert abs(rows["surface_area"].value - 6 * edge**2) <= rows["surface_area"].uncertainty
        assert abs(rows["volume"].value - edge**3) <= rows["volume"].uncertainty


def test_voxel_faces_as_triangles_are_a_staircase():
    grid = ball(8)
    row = measures.measure(extract_surface(grid, method="voxel-faces"), grid=grid)["surface_area"]
    assert row.value == pytest.approx(measures.surface_area(grid, method="voxel faces").value)
    assert row.uncertainty == pytest.approx((1 - 1 / math.sqrt(3)) * row.value)
    assert abs(row.value - 4 * math.pi * 64) <= row.uncertainty


def test_a_surface_alone_is_the_body():
    points = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4]], float)
    surface = SurfaceMesh(points, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))
    area = measures.surface_area(surface)
    assert area.value == pytest.approx(3 + 4 + 6 + math.sqrt(61), rel=1e-14)
    assert area.uncertainty < 1e-13
    assert measures.volume(surface).value == pytest.approx(4, rel=1e-14)
