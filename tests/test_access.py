"""What gets in and through: equal to brute force on the lattice, and right on bodies one knows."""

import heapq
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, label

from porous.errors import Cancelled, GridError, MemoryLimitError
from porous.kernels.distance import squared_distances
from porous.kernels.thickness import largest_balls
from porous.kernels.thinned import thinned
from porous.kernels.widest import widest
from porous.measures import (
    Sample,
    Survey,
    accessible_porosity,
    local_thickness,
    mercury_intrusion,
    percolation_diameters,
    survey,
)
from porous.values import Frame, VoxelGrid

SPACINGS = [(1.0, 1.0, 1.0), (0.2, 0.2, 0.4), (1.0, 1.3, 0.7)]
PERIODS = [(False, False, False), (True, True, False), (False, True, False), (True, True, True)]
STEPS = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]


def grid_of(solid, spacing=(1.0, 1.0, 1.0), periodic=(False, False, False), unit="mm"):
    return VoxelGrid.of_solid(solid, Frame((0, 0, 0), spacing, solid.shape, periodic, unit))


def noise(shape, seed, smooth=0.0, share=0.5):
    field = np.random.default_rng(seed).random(shape)
    field = gaussian_filter(field, smooth, mode="wrap") if smooth else field
    return field < np.quantile(field, share)


def sides_of(shape, periodic):
    outside = np.zeros(shape, bool)
    for axis in range(3):
        if not periodic[axis]:
            layers = np.moveaxis(outside, axis, 0)
            layers[0] = layers[-1] = True
    return outside


def ends_of(shape):
    return (0, 0, 0), tuple(n - 1 for n in shape)


def near(place, shape, periodic):
    """Neighbours of a voxel, and how many periods off the grid each is."""
    for step in STEPS:
        each = [divmod(p + s, n) for p, s, n in zip(place, step, shape, strict=True)]
        if all(wraps or not turn for (turn, _), wraps in zip(each, periodic, strict=True)):
            yield tuple(at for _, at in each), [turn for turn, _ in each]


def naive_ways(squares, outside, periodic):
    """Go on from voxel to voxel, always from the widest way there is."""
    result = np.zeros_like(squares)
    begin = map(tuple, np.argwhere(outside & (squares > 0)).tolist())
    queue = [(-float(squares[place]), place) for place in begin]
    heapq.heapify(queue)
    while queue:
        ball, place = heapq.heappop(queue)
        if result[place]:
            continue
        result[place] = -ball
        for other, _ in near(place, squares.shape, periodic):
            if squares[other] and not result[other]:
                heapq.heappush(queue, (max(ball, -float(squares[other])), other))
    return result


def naive_balls(balls, weights, periodic):
    """Put a ball about every voxel and keep the largest at each."""
    result = np.zeros_like(balls)
    for place in np.argwhere(balls):
        steps = []
        for at, n, wraps, weight in zip(place, balls.shape, periodic, weights, strict=True):
            step = np.abs(np.arange(n) - at)
            steps.append(weight * (np.minimum(step, n - step) if wraps else step) ** 2)
        ball = balls[tuple(place)]
        held = steps[0][:, None, None] + steps[1][:, None] + steps[2] < ball * (1 - 1e-9)
        result[held] = np.maximum(result[held], ball)
    return result


def passes(mask, axis, periodic, ends=None):
    """Walk about in unrolled space: to the last layer, or to the same voxel a period on."""
    start = mask.copy()
    first, last = ends or ends_of(mask.shape)
    if not periodic[axis]:
        layers = np.arange(mask.shape[axis]) != first[axis]
        np.moveaxis(start, axis, 0)[layers] = False
    seen = {}
    for place in map(tuple, np.argwhere(start).tolist()):
        queue = [] if place in seen else [place]
        seen.setdefault(place, 0)
        while queue:
            here = queue.pop()
            steps = [step for step in near(here, mask.shape, periodic) if mask[step[0]]]
            if any(seen.get(p, seen[here] + t[axis]) != seen[here] + t[axis] for p, t in steps):
                return True
            queue += [place for place, _ in steps if place not in seen]
            seen |= {place: seen[here] + turns[axis] for place, turns in steps}
    return not periodic[axis] and any(place[axis] == last[axis] for place in seen)


def ways_in(squares, **options):
    return widest(squares, ends=ends_of(squares.values.shape), **options).inward


@pytest.mark.parametrize("spacing", SPACINGS)
@pytest.mark.parametrize("periodic", PERIODS[:3])
def test_ways_and_balls_from_outside_are_those_of_brute_force(spacing, periodic):
    for shape, smooth, share in (
        ((9, 8, 7), 0, 0.4),
        ((9, 11, 8), 1, 0.6),
        ((12, 9, 10), 2, 0.3),
    ):
        mask = noise(shape, 2, smooth, share)
        squares = squared_distances(mask, spacing, periodic=periodic)
        outside = sides_of(shape, periodic)
        ways = ways_in(squares, periodic=periodic)
        wanted = naive_ways(squares.values, outside, periodic)
        assert ways == pytest.approx(wanted, rel=1e-12, abs=0)
        assert ways.dtype == squares.values.dtype
        balls = thinned(squares, ways, periodic=periodic)
        found = np.maximum(largest_balls(balls, periodic=periodic), ways)
        assert found == pytest.approx(
            naive_balls(wanted, squares.weights, periodic), rel=1e-12, abs=0
        )


@pytest.mark.parametrize("spacing", SPACINGS)
def test_places_that_a_ball_comes_to_are_labels_that_touch_a_side(spacing):
    mask = noise((30, 26, 28), 6, 2.0, 0.6)
    squares = squared_distances(mask, spacing)
    ways, sides = ways_in(squares), sides_of(mask.shape, (False, False, False))
    for square in np.unique(squares.values[mask])[::5]:
        labels, _ = label(squares.values >= square, np.ones((3, 3, 3)))
        touching = np.unique(labels[sides])
        wanted = np.isin(labels, touching[touching > 0])
        assert np.array_equal(ways >= square * (1 - 1e-9), wanted)


def bottle(spacing=(1.0, 1.0, 1.0), room=15, neck=4, wall=3):
    """A room behind a square neck along z, whose edges are those numbers of voxels."""
    solid = np.ones((room + 2 * wall, room + 2 * wall + 1, room + 2 * wall + 2), bool)
    solid[wall:-wall, wall : wall + room, wall : wall + room] = False
    middle = wall + (room - neck) // 2
    solid[middle : middle + neck, middle : middle + neck, : wall + 1] = False
    return grid_of(solid, spacing)


@pytest.mark.parametrize("spacing", SPACINGS)
def test_a_room_behind_a_neck_is_brute_force_too(spacing):
    # All centres behind the neck have the same ball, most of which are left out.
    grid = bottle(spacing)
    squares = squared_distances(~grid.solid, spacing)
    ways = ways_in(squares)
    balls = thinned(squares, ways)
    assert (balls.values < ways).sum() > 0.3 * (ways > 0).sum()
    found = np.maximum(largest_balls(balls), ways)
    assert np.array_equal(found, naive_balls(ways, squares.weights, (False,) * 3))


def naive_through(squares, ends, free, periodic):
    """The largest threshold at which something passes, axis by axis."""
    inside = np.where(free, 0, squares)
    occurring = sorted(set(inside[inside > 0]), reverse=True)
    return [
        next((s for s in occurring if passes(inside >= s, axis, periodic, ends)), 0)
        for axis in range(3)
    ]


@pytest.mark.parametrize("spacing", SPACINGS)
@pytest.mark.parametrize("periodic", PERIODS)
def test_what_passes_is_what_brute_force_lets_pass(spacing, periodic):
    for seed, shape in enumerate([(9, 7, 8), (8, 9, 7), (1, 6, 9), (5, 1, 1)]):
        mask = noise(shape, seed, 1.0, 0.45)
        squares = squared_distances(mask, spacing, periodic=periodic)
        found = widest(squares, ends=ends_of(shape), periodic=periodic).through
        wanted = naive_through(squares.values, ends_of(shape), ~mask, periodic)
        assert found == pytest.approx(wanted, rel=1e-12, abs=0)


@pytest.mark.parametrize("periodic", PERIODS)
def test_what_is_free_is_where_balls_come_from_and_none_passes(periodic):
    for seed in range(2):
        mask, shape = noise((9, 8, 10), seed, 1.0, 0.7), (9, 8, 10)
        free = noise(shape, seed + 9, 1.5, 0.3)
        squares = squared_distances(mask, (1, 1.3, 0.7), periodic=periodic)
        ends = (1, 2, 1), (7, 7, 9)
        found = widest(squares, ends=ends, free=free, periodic=periodic)
        outside = free | sides_of(shape, periodic)
        wanted = naive_ways(squares.values, outside, periodic)
        assert found.inward == pytest.approx(wanted, rel=1e-12, abs=0)
        wanted = naive_through(squares.values, ends, free, periodic)
        assert found.through == pytest.approx(wanted, rel=1e-12, abs=0)


def test_slabs_and_threads_change_nothing(monkeypatch):
    squares = squared_distances(noise((17, 14, 15), 4, 0.5, 0.6), (1, 1, 1.2))
    wanted = widest(squares, ends=ends_of((17, 14, 15)), periodic=(True, False, True))
    monkeypatch.setattr("porous.kernels.widest.SLAB", 1)
    monkeypatch.setattr("porous.kernels.widest.PASSES", 1)
    monkeypatch.setenv("POROUS_THREADS", "3")
    found = widest(squares, ends=ends_of((17, 14, 15)), periodic=(True, False, True))
    assert np.array_equal(found.inward, wanted.inward)
    assert np.array_equal(found.through, wanted.through)


def test_squares_without_number_are_drawn_in_to_levels(monkeypatch):
    squares = squared_distances(noise((12, 14, 15), 4, 1.5, 0.3), (1, 1.3, 0.7))
    wanted = widest(squares, ends=ends_of((12, 14, 15)))
    monkeypatch.setattr("porous.kernels.widest.LEVELS", 64)
    found = widest(squares, ends=ends_of((12, 14, 15)))
    step = (squares.values.max() - 1) / 63
    for told, true in zip(found, wanted, strict=True):
        assert np.array_equal(told > 0, true > 0)
        assert np.all(told <= true + 1e-9)
        assert np.all(told > true - step - 1e-9)


def centres(shape, spacing=(1.0, 1.0, 1.0)):
    axes = ((np.arange(n) + 0.5) * h for n, h in zip(shape, spacing, strict=True))
    return np.stack(np.meshgrid(*axes, indexing="ij"))


def rows_of(grid, **options):
    found = survey(grid, only=["access"], how=Survey(**options))
    return {row.name: row for row in found.measures}, found


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_tube_lets_its_own_diameter_pass(axis):
    shape, spacing, diameter = (40, 36, 28), (0.5, 0.4, 0.5), 9.3
    x = centres(shape, spacing) - np.array([10.1, 7.3, 7.2])[:, None, None, None]
    away = np.hypot(*(x[a] for a in range(3) if a != axis))
    rows, found = rows_of(grid_of(2 * away >= diameter, spacing), probe=diameter - 1)
    name = f"percolation_diameter_{'xyz'[axis]}"
    assert [row for row in rows if row.startswith("perc")] == [name]
    for row in (name, "intrusion_threshold_diameter", "intrusion_p50"):
        assert rows[row].value == pytest.approx(diameter, abs=0.5), row
        assert abs(rows[row].value - diameter) < rows[row].uncertainty
    assert rows["constrictivity"].value == pytest.approx(1, abs=1e-9)
    assert rows["intrusion_trapped_share"].value == 0
    assert rows["intrusion_unreached_share"].value == 0
    assert not found.notes
    porosity = (2 * away < diameter).mean()
    swept = rows["accessible_porosity"]
    assert swept.value == pytest.approx(porosity, abs=0.05 * porosity)
    assert abs(swept.value - porosity) < swept.uncertainty
    beyond, _ = rows_of(grid_of(2 * away >= diameter, spacing), probe=diameter + 0.6)
    assert beyond["accessible_porosity"].value == 0


def test_a_probe_that_just_fits_comes_in_and_a_larger_one_does_not():
    solid = np.ones((20, 21, 18), bool)
    solid[4:16, 4:16] = False
    grid, share = grid_of(solid, (0.25, 0.25, 0.5)), 144 / 420
    assert accessible_porosity(grid, probe=3 * (1 + 1e-6)).value == 0
    just = accessible_porosity(grid, probe=3.0)
    # A ball of this width leaves the corners.
    assert just.value == pytest.approx(math.pi / 4 * share, rel=0.07)
    assert abs(just.value - math.pi / 4 * share) < just.uncertainty
    assert just.uncertainty > 0.3 * share
    assert accessible_porosity(grid, probe=1e-9).value == pytest.approx(share, rel=1e-12)


def test_a_room_behind_a_neck_is_filled_through_the_neck():
    grid = bottle(room=16, neck=4, wall=9)
    mercury = mercury_intrusion(grid)
    inside = np.zeros(grid.frame.shape, bool)
    inside[9:-9, 9:25, 9:25] = True
    assert mercury.diameters[inside].max() == 4
    assert (mercury.diameters[inside] == 4).mean() > 0.9
    assert mercury.diameters[grid.solid].max() == 0
    assert mercury.quantile(0.5) == 4
    rows, _ = rows_of(grid)
    assert rows["intrusion_p50"].value == 4
    assert rows["intrusion_trapped_share"].value > 0.9
    narrow = rows["constrictivity"]
    assert abs(narrow.value - (4 / 16) ** 2) < narrow.uncertainty
    assert narrow.uncertainty >= 2 * narrow.value / 4
    assert "intrusion_threshold_diameter" not in rows


def menger(level, each):
    solid = np.ones((1, 1, 1), bool)
    kept = np.add.outer(np.add.outer([0, 1, 0], [0, 1, 0]), [0, 1, 0]) < 2
    for _ in range(level):
        solid = np.kron(kept, solid)
    return np.kron(solid, np.ones((each,) * 3)) > 0


@pytest.mark.parametrize("periodic", PERIODS)
def test_the_largest_channel_of_a_sponge_is_a_third_of_it(periodic):
    for level, each in ((1, 2), (1, 4), (2, 2)):
        solid = menger(level, each)
        rows = percolation_diameters(grid_of(solid, (1 / len(solid),) * 3, periodic))
        assert rows.names == tuple(f"percolation_diameter_{axis}" for axis in "xyz")
        for row in rows:
            # Walls that are pierced all over count as none: a voxel too much.
            assert 1 / 3 - 1e-9 <= row.value <= 1 / 3 + 1.001 / len(solid)
            assert row.uncertainty >= 1 / len(solid)


def packing(shape, shift):
    """Balls of radius a half that touch in a cubic lattice: one cell, moved by parts of a voxel."""
    x = centres(shape, tuple(1 / n for n in shape)) - (shift / np.array(shape))[:, None, None, None]
    return ((x - np.round(x)) ** 2).sum(axis=0) < 0.25


@pytest.mark.parametrize("shape", [(20, 20, 20), (40, 36, 32)])
def test_windows_of_a_packing_let_pass_what_goes_between_four_balls(shape):
    spacing, window = tuple(1 / n for n in shape), math.sqrt(2) - 1
    errors, random = [], np.random.default_rng(1)
    for n in range(8):
        solid = packing(shape, random.uniform(0, 1, 3))
        rows = percolation_diameters(grid_of(solid, spacing, PERIODS[n % 4]))
        assert len(rows) == 3
        errors += [(row.value - window) / max(spacing) for row in rows]
        assert all(row.uncertainty >= max(spacing) for row in rows)
    # What local thickness is off where centres are no voxels'.
    assert np.abs(errors).max() < 1.5
    assert math.sqrt(np.square(errors).mean()) < 1


@pytest.mark.parametrize("width", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("shut", [False, True])
def test_a_slit_is_as_wide_as_it_is_whatever_comes_through(width, shut):
    solid = np.ones((16, 20, 18), bool)
    solid[:, 4 : 4 + width, (4 if shut else 0) :] = False
    rows, _ = rows_of(grid_of(solid, (0.5,) * 3), probe=0.5 * width)
    largest = local_thickness(grid_of(solid, (0.5,) * 3)).sizes[-1]
    names = ("percolation_diameter_x", "intrusion_threshold_diameter", "intrusion_p50")
    assert [rows[name].value for name in names] == [0.5 * width] * 3
    assert largest == 0.5 * width
    assert rows["constrictivity"].value == 1
    assert rows["constrictivity"].uncertainty >= 2.82 / width
    # A ball that fills the slit leaves the corners where it ends.
    row, pores = rows["accessible_porosity"], (~solid).mean()
    corners = 2 * (1 - math.pi / 4) * (width / 2) ** 2 / (14 * width) if shut else 0
    assert row.value == pytest.approx((1 - corners) * pores, rel=0.03 if shut else 1e-12)


@pytest.mark.parametrize("spacing", SPACINGS)
@pytest.mark.parametrize("bulk", [False, True])
def test_nothing_that_comes_in_or_through_is_larger_than_there_is_room_for(spacing, bulk):
    grid = grid_of(noise((24, 26, 22), 8, 1.5, 0.4), spacing)
    if bulk:
        body = np.zeros((24, 26, 22), np.uint8)
        body[4:20, 5:22, 3:18] = 255
        grid = VoxelGrid(grid.frame, np.where(body, grid.fill, np.uint8(0)), body)
    mercury, local = mercury_intrusion(grid), local_thickness(grid)
    assert np.all(mercury.diameters <= local.diameters)
    rows, _ = rows_of(grid)
    assert len(rows) >= 6
    assert rows["constrictivity"].value <= 1
    for name, row in rows.items():
        assert "diameter" not in name or row.value <= local.sizes[-1], name


def test_mercury_breaks_through_along_axes_that_are_not_periodic():
    solid = np.ones((20, 21, 22), bool)
    solid[:, 3:9, 3:9] = False
    solid[4:8, 12:16, :] = False
    rows, _ = rows_of(grid_of(solid, periodic=(True, False, False)))
    assert rows["percolation_diameter_x"].value == 6
    assert "percolation_diameter_y" not in rows
    assert rows["percolation_diameter_z"].value == 4
    assert rows["intrusion_threshold_diameter"].value == 4
    # The wider channel begins nowhere.
    wide, narrow = 20 * 36, 22 * 16
    assert rows["intrusion_unreached_share"].value == pytest.approx(wide / (wide + narrow))


def test_what_is_shut_in_is_never_reached():
    solid = np.ones((14, 15, 16), bool)
    solid[2:6, 3:7, :] = False
    solid[8:12, 9:13, 5:12] = False
    grid = grid_of(solid, (0.5, 1.0, 1.0))
    mercury = mercury_intrusion(grid)
    assert not mercury.diameters[8:12].any()
    assert mercury.diameters[2:6, 3:7].all()
    rows, found = rows_of(grid)
    share = 4 * 4 * 7 / (4 * 4 * 23)
    assert rows["intrusion_unreached_share"].value == pytest.approx(share, rel=1e-12)
    assert mercury.reached == pytest.approx(1 - share, rel=1e-12)
    curves = {(curve.name, curve.series): curve for curve in found.curves}
    open_part = curves["accessible_porosity", "from outside"].y[0]
    assert open_part == pytest.approx(4 * 4 * 16 / solid.size, rel=1e-12)
    assert curves["accessible_porosity", "from anywhere"].y[0] == pytest.approx(
        4 * 4 * 23 / solid.size, rel=1e-12
    )


def test_nothing_reached_is_told_as_nothing():
    solid = np.ones((10, 11, 12), bool)
    solid[3:7, 4:8, 5:9] = False
    rows, found = rows_of(grid_of(solid), probe=2.0)
    assert set(rows) == {"accessible_porosity", "intrusion_unreached_share"}
    assert rows["accessible_porosity"].value == 0
    assert rows["intrusion_unreached_share"].value == 1
    assert [curve.series for curve in found.curves] == ["from anywhere"]


@given(st.integers(0, 10**6), st.permutations(range(3)))
@settings(max_examples=8)
def test_axes_are_alike(seed, order):
    solid, spacing, periodic = noise((10, 12, 9), seed, 1.0), (1.0, 1.5, 0.8), (False, True, False)
    turned = solid.transpose(order)
    rows, _ = rows_of(grid_of(solid, spacing, periodic), probe=2.0)
    again, _ = rows_of(
        grid_of(turned, *(tuple(of[a] for a in order) for of in (spacing, periodic))), probe=2.0
    )
    names = {
        f"percolation_diameter_{'xyz'[a]}": f"percolation_diameter_{'xyz'[b]}"
        for b, a in enumerate(order)
    }
    assert {names.get(name, name) for name in rows} == set(again)
    for name, row in rows.items():
        other = again[names.get(name, name)]
        assert other.value == pytest.approx(row.value, rel=1e-9)
        assert other.uncertainty == pytest.approx(row.uncertainty, rel=1e-6, abs=1e-9)


@given(st.integers(0, 10**6), st.integers(-9, 9))
@settings(max_examples=8)
def test_periodic_bodies_may_be_moved_and_told_twice(seed, shift):
    solid, periodic = noise((8, 10, 12), seed, 1.0), (True, True, False)
    rows, _ = rows_of(grid_of(solid, (1, 1, 1.2), periodic), probe=2.0)
    moved = np.roll(solid, (2 * shift, 2 * shift), axis=(0, 1))
    for other in (moved, np.tile(solid, (2, 1, 1)), np.tile(solid, (1, 2, 1))):
        again, _ = rows_of(grid_of(other, (1, 1, 1.2), periodic), probe=2.0)
        assert set(again) == set(rows)
        for name, row in rows.items():
            assert again[name].value == pytest.approx(row.value, rel=1e-9), name
            assert again[name].uncertainty == pytest.approx(row.uncertainty, rel=1e-6, abs=1e-9)


def test_curves_fall_with_the_diameter_and_rise_with_the_pressure():
    grid = grid_of(noise((40, 36, 44), 3, 2.5, 0.4), (2.0, 2.5, 2.0), unit="um")
    mercury, rooms = mercury_intrusion(grid), local_thickness(grid).diameters
    _, found = rows_of(grid)
    curves = {(curve.name, curve.series): curve for curve in found.curves}
    sizes = curves["mercury_intrusion", "intruded from outside"]
    pressures = curves["mercury_intrusion_pressure", "intruded from outside"]
    assert np.all(np.diff(sizes.y) <= 0)
    assert np.all(np.diff(pressures.y) >= 0)
    assert np.array_equal(sizes.y, pressures.y[::-1])
    assert sizes.y[0] == pytest.approx(mercury.reached)
    # E. W. Washburn: 4 · 0.480 N/m · cos 40° over 1 µm are 1.4708 MPa.
    assert sizes.x * pressures.x[::-1] == pytest.approx(1.470805, rel=1e-6)
    for series, diameters in (("from outside", mercury.diameters), ("from anywhere", rooms)):
        curve = curves["accessible_porosity", series]
        assert 40 < len(curve.x) <= 128
        wanted = [(diameters >= x * (1 - 1e-6)).mean() for x in curve.x]
        assert curve.y == pytest.approx(wanted, abs=1e-12)
        assert np.all((curve.low <= curve.y) & (curve.y <= curve.high))
    outside, anywhere = (
        np.interp(sizes.x, curve.x, curve.y)
        for curve in (curves["accessible_porosity", s] for s in ("from outside", "from anywhere"))
    )
    assert np.all(outside <= anywhere + 1e-12)


def test_uncertainties_hold_the_difference_to_half_the_resolution():
    grid = grid_of(noise((36, 40, 44), 5, 2.5, 0.5))
    rows, _ = rows_of(grid, probe=5.0)
    coarse = Sample(grid).coarse
    others, _ = rows_of(coarse.grid, probe=5.0)
    for name, row in rows.items():
        assert row.uncertainty >= abs(row.value - others[name].value) * (1 - 1e-9), name
    small, _ = rows_of(grid_of(bottle(room=3, neck=1, wall=2).solid[:, :7, :7]), probe=1.0)
    assert math.isinf(small["intrusion_unreached_share"].uncertainty)
    assert math.isinf(small["accessible_porosity"].uncertainty)


def test_pores_beyond_the_bulk_are_outside():
    shape, periodic = (20, 22, 24), (True, True, True)
    x = centres(shape) - np.array([10.0, 11.0, 12.0])[:, None, None, None]
    body = (x**2).sum(axis=0) < 81
    solid = body & (np.abs(x[0]) + np.abs(x[1]) > 4)
    frame = Frame((0, 0, 0), (1, 1, 1), shape, periodic, "mm")
    bulk = np.where(body, np.uint8(255), np.uint8(0))
    grid = VoxelGrid(frame, np.where(solid, np.uint8(255), np.uint8(0)), bulk)
    rows, found = rows_of(grid, probe=6.0)
    assert not found.notes
    assert rows["constrictivity"].value <= 1
    assert rows["intrusion_unreached_share"].value == 0
    pores = (body & ~solid).sum() / body.sum()
    assert 0.5 * pores < rows["accessible_porosity"].value < pores
    whole, found = rows_of(replace(grid, bulk=None), probe=3.0)
    assert set(whole) <= {f"percolation_diameter_{axis}" for axis in "xyz"}
    assert "nothing comes" in found.notes[0]
    assert not found.curves
    with pytest.raises(GridError, match="periodic along all axes"):
        mercury_intrusion(replace(grid, bulk=None))


@pytest.mark.parametrize("solid", [np.ones((5, 6, 7), bool), np.zeros((5, 6, 7), bool)])
def test_bodies_of_one_phase_tell_nothing(solid):
    grid = grid_of(solid)
    assert rows_of(grid, probe=1.0) == ({}, survey(grid, only=[]))
    for take in (mercury_intrusion, percolation_diameters):
        with pytest.raises(GridError, match=r"wanted (both phases|a body with some)"):
            take(grid)


@pytest.mark.parametrize("probe", [0.0, -1.0, math.nan, math.inf])
def test_a_probe_has_a_diameter(probe):
    with pytest.raises(GridError, match=r"probe: got .*; wanted a diameter above 0"):
        accessible_porosity(bottle(), probe=probe)


def test_it_tells_how_far_it_is_and_can_be_cancelled(monkeypatch):
    told = []
    mercury_intrusion(bottle(), progress=lambda name, done: told.append((name, done)))
    parts = [done for name, done in told if name == "access"]
    assert parts == sorted(parts)
    assert 0 < parts[0] < parts[-1] == 1

    def cancel(*_):
        raise Cancelled("enough")

    with pytest.raises(Cancelled):
        mercury_intrusion(bottle(), progress=cancel)
    monkeypatch.setenv("POROUS_MAX_MEMORY", "10K")
    with pytest.raises(MemoryLimitError, match="access of"):
        mercury_intrusion(bottle())
