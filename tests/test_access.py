"""What gets in and through: equal to brute force on the lattice, and right on bodies one knows."""

import heapq
import itertools
import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from porous.kernels.distance import squared_distances
from porous.kernels.thickness import largest_balls
from porous.kernels.widest import thinned, widest
from porous.measures import (
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


def near(place, shape, periodic):
    """Neighbours of a voxel, and how many periods off the grid each is."""
    for step in STEPS:
        turns, other = np.divmod(np.add(place, step), shape)
        if not turns[~np.array(periodic)].any():
            yield tuple(other), turns


def naive_ways(squares, outside, periodic):
    """Go on from voxel to voxel, always from the widest way there is."""
    result = np.zeros_like(squares)
    begin = map(tuple, np.argwhere(outside & (squares > 0)))
    queue = [(-squares[place], place) for place in begin]
    heapq.heapify(queue)
    while queue:
        ball, place = heapq.heappop(queue)
        if result[place]:
            continue
        result[place] = -ball
        for other, _ in near(place, squares.shape, periodic):
            if squares[other] and not result[other]:
                heapq.heappush(queue, (max(ball, -squares[other]), other))
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


def passes(mask, axis, periodic):
    """Walk about in unrolled space: to the last layer, or to the same voxel a period on."""
    start = mask.copy()
    if not periodic[axis]:
        np.moveaxis(start, axis, 0)[1:] = False
    seen = {}
    for place in map(tuple, np.argwhere(start)):
        queue = [] if place in seen else [place]
        seen.setdefault(place, 0)
        while queue:
            here = queue.pop()
            steps = [step for step in near(here, mask.shape, periodic) if mask[step[0]]]
            if any(seen.get(p, seen[here] + t[axis]) != seen[here] + t[axis] for p, t in steps):
                return True
            queue += [place for place, _ in steps if place not in seen]
            seen |= {place: seen[here] + turns[axis] for place, turns in steps}
    return not periodic[axis] and any(place[axis] == mask.shape[axis] - 1 for place in seen)


def ways_in(squares, **options):
    last = tuple(n - 1 for n in squares.values.shape)
    return widest(squares, ends=((0, 0, 0), last), **options).inward


@pytest.mark.parametrize("spacing", SPACINGS)
@pytest.mark.parametrize("periodic", PERIODS[:3])
def test_ways_and_balls_from_outside_are_those_of_brute_force(spacing, periodic):
    for shape, smooth, share in (
        ((9, 8, 7), 0, 0.4),
        ((11, 12, 9), 1, 0.6),
        ((12, 10, 14), 2, 0.3),
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


@pytest.mark.parametrize("spacing", SPACINGS)
@pytest.mark.parametrize("periodic", PERIODS)
def test_what_passes_is_what_brute_force_lets_pass(spacing, periodic):
    for seed in range(3):
        mask = noise((9, 7, 8), seed, 1.0, 0.45)
        squares = squared_distances(mask, spacing, periodic=periodic)
        rows = {r.name[-1]: r for r in percolation_diameters(grid_of(~mask, spacing, periodic))}
        for axis, name in enumerate("xyz"):
            occurring = sorted(set(squares.values[mask]), reverse=True)
            wide = (s for s in occurring if passes(squares.values >= s, axis, periodic))
            largest = next(wide, None)
            assert (name in rows) == (largest is not None)
            if largest is not None:
                wanted = 2 * squares.step * math.sqrt(largest)
                assert rows[name].value == pytest.approx(wanted, rel=1e-12)


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
    assert rows["accessible_porosity"].value == pytest.approx(porosity, abs=0.02 * porosity)
    beyond, _ = rows_of(grid_of(2 * away >= diameter, spacing), probe=diameter + 0.6)
    assert beyond["accessible_porosity"].value == 0


def test_a_probe_that_just_fits_comes_in_and_a_larger_one_does_not():
    solid = np.ones((20, 21, 18), bool)
    solid[4:16, 4:16] = False
    grid, share = grid_of(solid, (0.25, 0.25, 0.5)), 144 / 420
    assert accessible_porosity(grid, probe=3 * (1 + 1e-6)).value == 0
    just = accessible_porosity(grid, probe=3.0)
    assert 0.85 * share < just.value < share  # a ball of this width leaves the corners
    assert just.uncertainty > 0.3 * share
    assert accessible_porosity(grid, probe=1e-9).value == pytest.approx(share, rel=1e-12)


def test_a_room_behind_a_neck_is_filled_through_the_neck():
    grid = bottle(room=16, neck=4)
    mercury, rooms = mercury_intrusion(grid), local_thickness(grid)
    inside = np.zeros(grid.frame.shape, bool)
    inside[3:-3, 3:19, 3:19] = True
    assert mercury.diameters[inside].max() == 4
    assert (mercury.diameters[inside] == 4).mean() > 0.9
    assert mercury.diameters[grid.solid].max() == 0
    assert mercury.quantile(0.5) == 4
    assert rooms.sizes[-1] == 16
    rows, _ = rows_of(grid)
    assert rows["intrusion_p50"].value == 4
    assert rows["intrusion_trapped_share"].value > 0.9
    assert rows["constrictivity"].value == pytest.approx((4 / 16) ** 2)
    assert "intrusion_threshold_diameter" not in rows
