"""Local thickness: equal to brute force on the lattice, and right on bodies one knows."""

import json
import math
import os
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import programs
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt, gaussian_filter

from porous.errors import Cancelled, GridError, MemoryLimitError
from porous.kernels.distance import squared_distances
from porous.kernels.thickness import largest_balls
from porous.measures import (
    LocalThickness,
    chord_lengths,
    local_thickness,
    thicknesses,
    two_point,
)
from porous.values import Frame, VoxelGrid

SPACINGS = [(1.0, 1.0, 1.0), (0.2, 0.2, 0.4), (1.0, 1.3, 0.7)]
PERIODS = [(False, False, False), (True, True, True), (True, False, True)]


def grid_of(solid, spacing=(1.0, 1.0, 1.0), periodic=(False, False, False), unit="mm"):
    return VoxelGrid.of_solid(solid, Frame((0, 0, 0), spacing, solid.shape, periodic, unit))


def noise(shape, seed, smooth=0.0, share=0.5):
    field = np.random.default_rng(seed).random(shape)
    field = gaussian_filter(field, smooth, mode="wrap") if smooth else field
    return field < np.quantile(field, share)


def naive_squares(mask, spacing, periodic, walled):
    """Squares of distances, in units of the shortest edge: the grid among images of itself."""
    around = [(0, 0) if wraps else (1, 1) for wraps in periodic]
    wide = np.pad(mask, around, constant_values=not walled)
    wide = np.tile(wide, [3 if wraps else 1 for wraps in periodic])
    distances = distance_transform_edt(wide, sampling=np.array(spacing) / min(spacing))
    each = zip(mask.shape, periodic, strict=True)
    return distances[tuple(slice(n, 2 * n) if wraps else slice(1, n + 1) for n, wraps in each)] ** 2


def naive_balls(squares, weights, periodic):
    """Put a ball about every voxel and keep the largest at each."""
    result = np.zeros_like(squares)
    for place in np.argwhere(squares):
        radius, near, steps = squares[tuple(place)], [], []
        for at, n, wraps, weight in zip(place, squares.shape, periodic, weights, strict=True):
            step = np.abs(np.arange(n) - at)
            step = weight * (np.minimum(step, n - step) if wraps else step) ** 2
            near.append(np.flatnonzero(step < radius))
            steps.append(step[near[-1]])
        square = steps[0][:, None, None] + steps[1][:, None] + steps[2]
        held = np.where(square < radius * (1 - 1e-9), radius, 0)
        result[np.ix_(*near)] = np.maximum(result[np.ix_(*near)], held)
    return result


@pytest.mark.parametrize("spacing", SPACINGS)
@pytest.mark.parametrize("periodic", PERIODS)
@pytest.mark.parametrize("walled", [False, True])
def test_distances_are_those_of_scipy(spacing, periodic, walled):
    for shape, share in (((13, 11, 9), 0.5), ((20, 7, 33), 0.97), ((1, 5, 4), 0.9)):
        mask = noise(shape, 1, share=share)
        found = squared_distances(mask, spacing, periodic=periodic, walled=walled)
        wanted = naive_squares(mask, spacing, periodic, walled)
        assert found.values == pytest.approx(wanted, rel=1e-12)
        assert found.values.dtype == (np.float64 if spacing == SPACINGS[2] else np.uint16)


def test_nothing_to_be_far_from_is_far():
    assert squared_distances(np.ones((3, 4, 5), bool), (1, 1, 1)).values.min() == 1 << 30


@pytest.mark.slow
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("length", [256, 257, 400])
def test_squares_take_the_room_that_they_need(axis, length):
    place = np.moveaxis(np.broadcast_to(np.arange(length), (3, 3, length)), 2, axis)
    squares = squared_distances(place > 0, (1, 1, 1))
    assert squares.values.dtype == (np.uint16 if length == 256 else np.int32)
    assert np.array_equal(squares.values, place.astype(np.int64) ** 2)
    assert np.array_equal(largest_balls(squares), (place > 0) * (length - 1) ** 2)


@pytest.mark.parametrize("spacing", SPACINGS)
@pytest.mark.parametrize("periodic", PERIODS)
def test_balls_are_those_of_brute_force(spacing, periodic):
    for shape, smooth, share, walled in (
        ((13, 12, 10), 0, 0.5, False),
        ((11, 12, 9), 0, 0.9, True),
        ((9, 20, 12), 3, 0.8, False),
    ):
        squares = squared_distances(
            noise(shape, 2, smooth, share), spacing, periodic=periodic, walled=walled
        )
        found = largest_balls(squares, periodic=periodic)
        assert np.array_equal(found, naive_balls(squares.values, squares.weights, periodic))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("smooth", "periodic"), [(0, PERIODS[1]), (1, PERIODS[2]), (3, PERIODS[0]), (4, PERIODS[1])]
)
def test_balls_are_those_of_brute_force_on_forty_cubed(smooth, periodic):
    squares = squared_distances(noise((40, 38, 41), 3, smooth), (2.0,) * 3, periodic=periodic)
    found = largest_balls(squares, periodic=periodic)
    assert np.array_equal(found, naive_balls(squares.values, squares.weights, periodic))


@given(st.integers(0, 10**6), st.floats(0.1, 0.95), st.permutations(range(3)))
def test_axes_are_alike(seed, share, order):
    solid, spacing = noise((6, 9, 7), seed, share=share), (1.0, 1.5, 0.8)
    turned = grid_of(solid.transpose(order), tuple(spacing[a] for a in order))
    found = local_thickness(grid_of(solid, spacing)).diameters
    assert local_thickness(turned).diameters == pytest.approx(found.transpose(order), rel=1e-6)


@given(st.integers(0, 10**6), st.integers(-9, 9))
def test_periodic_bodies_may_be_moved(seed, shift):
    solid = noise((6, 9, 7), seed, 1)
    grid = grid_of(solid, periodic=(True, True, True))
    moved = replace(grid, fill=np.roll(grid.fill, shift, axis=(0, 1)))
    found = local_thickness(grid).diameters
    assert np.array_equal(local_thickness(moved).diameters, np.roll(found, shift, axis=(0, 1)))


def centres(shape):
    return np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in shape), indexing="ij"))


def values(grid, **options):
    return {row.name: row for row in thicknesses(local_thickness(grid, **options))}


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("width", [1, 2, 5, 8])
def test_slabs_are_as_wide_as_they_are(axis, width):
    solid = np.zeros((12, 13, 14), bool)
    solid[(slice(None),) * axis + (slice(2, 2 + width),)] = True
    periodic = tuple(a != axis for a in range(3))
    rows = values(grid_of(solid, (0.5, 0.5, 0.5), periodic), phase="solid")
    wanted = {"wall_thickness_mean", "wall_thickness_p50", "largest_wall", "smallest_wall"}
    assert set(rows) == wanted
    for row in rows.values():
        assert row.value == 0.5 * width
        assert row.uncertainty == 0.5
    gap = values(grid_of(~solid, (0.5, 0.5, 0.5), periodic))
    assert gap["smallest_gap"].value == gap["largest_pore_diameter"].value == 0.5 * width


@pytest.mark.parametrize("seed", range(4))
def test_tilted_slabs_and_tubes_are_right_within_a_voxel(seed):
    random = np.random.default_rng(seed)
    place = random.uniform(0, 24, 3)[:, None, None, None]
    # Periodic along a lattice direction: gaps of 24 (2, 1, 0) / |(2, 1, 0)| / 5 steps.
    x, y, z = centres((24, 24, 24)) - place
    pitch, width = 24 / math.sqrt(5), random.uniform(3, 8)
    across = (2 * x + y) / math.sqrt(5) % pitch
    rows = values(grid_of(across >= width, periodic=(True, True, True)))
    for name in ("pore_thickness_mean", "pore_thickness_p50", "smallest_gap"):
        assert rows[name].value == pytest.approx(width, abs=1), name
    radius = random.uniform(3, 9)
    away = np.hypot((x + 12) % 24 - 12, (y + 12) % 24 - 12) + 0 * z
    rows = values(grid_of(away >= radius, periodic=(True, True, True)))
    for name in ("pore_thickness_mean", "largest_pore_diameter", "smallest_gap"):
        assert rows[name].value == pytest.approx(2 * radius, abs=1), name
    assert rows["pore_thickness_p50"].value == pytest.approx(2 * radius, abs=1)


def packing(count, box, radii, seed):
    """Balls anywhere in a periodic box that keep a voxel or two between them."""
    random, placed = np.random.default_rng(seed), []
    while len(placed) < count:
        place, radius = random.uniform(0, box, 3), random.uniform(*radii)
        gaps = [np.abs((place - other + box / 2) % box - box / 2) for other, _ in placed]
        if all(np.linalg.norm(g) > radius + r + 2 for g, (_, r) in zip(gaps, placed, strict=True)):
            placed.append((place, radius))
    return placed


def test_balls_of_a_packing_are_found_one_by_one():
    balls, shape = packing(14, 60, (5, 10), 5), (60, 60, 60)
    x = centres(shape)
    owner = np.full(shape, -1)
    for number, (place, radius) in enumerate(balls):
        gaps = (x - place[:, None, None, None] + 30) % 60 - 30
        owner[(gaps**2).sum(axis=0) < radius**2] = number
    local = local_thickness(grid_of(owner >= 0, periodic=(True, True, True)), phase="solid")
    found = np.array([np.median(local.diameters[owner == n]) for n in range(len(balls))])
    errors = found - [2 * radius for _, radius in balls]
    assert np.abs(errors).max() < local.doubt == 1.0
    assert math.sqrt((errors**2).mean()) < 0.5
    share = sum(radius**3 for _, radius in balls)
    wanted = sum(2 * radius**4 for _, radius in balls) / share
    (row, *_) = thicknesses(local)
    assert row.value == pytest.approx(wanted, abs=1)


@pytest.mark.slow
def test_porespy_finds_the_same_sizes(tmp_path):
    python = os.environ.get("POROUS_PORESPY")
    if not python:
        pytest.skip("POROUS_PORESPY names no Python that has PoreSpy")
    solid, given, made = noise((48, 52, 56), 8, 2), tmp_path / "im.npz", tmp_path / "radii.npz"
    np.savez(given, im=~solid)
    judge = Path(__file__).parent / "judges" / "porespy_sizes.py"
    printed, _ = programs.said([python, judge, given, "1", made], tmp_path, seconds=300)
    said = json.loads(printed.splitlines()[-1])
    grid = grid_of(solid)
    local, along = local_thickness(grid), chord_lengths(grid).axes[0]
    gaps = np.abs(local.diameters / 2 - np.load(made)["radii"])[~solid]
    assert np.median(gaps) < 1  # theirs are whole numbers
    assert local.quantile(0.5) / 2 == pytest.approx(said["radius_median"], abs=1)
    whole = along.lengths @ along.whole / along.whole.sum()
    assert whole == pytest.approx(said["chord_mean"], abs=1)  # theirs are every other line's
    curve = two_point(grid, longest=24).values[1:]
    wanted = np.array(said["curve"])
    assert len(wanted) >= 22
    assert curve[: len(wanted) - 1] == pytest.approx(wanted[:-1], rel=0.01)
    assert said["porosity"] == pytest.approx((~solid).mean(), abs=1e-12)


def test_the_gyroid_converges():
    found = []
    for n in (24, 48, 96):
        x, y, z = 2 * np.pi * centres((n, n, n)) / n
        level = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
        rows = values(grid_of(level > 0, (1 / n,) * 3, (True,) * 3), phase="solid")
        found.append([row.value for row in rows.values()])
        assert np.abs(np.array(found[-1]) - 0.457).max() < 1 / n  # 180³: .456 and .458
    assert rows["smallest_wall"].method == "distance ridge"


def test_edges_of_cubes_are_no_walls():
    solid = np.zeros((20, 22, 24), bool)
    solid[3:15, 4:18, 5:21] = True
    rows = values(grid_of(solid), phase="solid")
    assert rows["smallest_wall"].value == rows["largest_wall"].value == 12
    assert local_thickness(grid_of(solid), phase="solid").diameters[3, 4, 5] == 4


def test_a_neck_is_the_smallest_wall():
    x, y, z = centres((40, 20, 21)) - 10
    radius = np.where(np.abs(x - 10) < 6, 3.2, 7.2)
    rows = values(grid_of(np.hypot(y, z) < radius, periodic=(True, False, False)), phase="solid")
    assert rows["smallest_wall"].value == pytest.approx(6.4, abs=1)
    assert rows["largest_wall"].value == pytest.approx(14.4, abs=1)


def test_what_lies_beyond_a_side_is_said():
    solid = np.ones((8, 9, 10), bool)
    solid[:, 4:] = False
    grid = grid_of(solid)
    assert values(grid, phase="solid")["largest_wall"].value == 4
    # Balls sit on the side: what goes on beyond it could be so thick at least.
    assert values(grid, phase="solid", beyond="unknown")["largest_wall"].value == 8
    assert values(grid)["largest_pore_diameter"].value == 10
    assert "smallest_gap" not in values(grid)


def test_pores_beyond_the_bulk_do_not_count():
    solid = np.zeros((9, 10, 11), bool)
    solid[:, 4:6] = True
    bulk = np.full(solid.shape, 255, np.uint8)
    bulk[:, 6:] = 0
    local = local_thickness(replace(grid_of(solid), bulk=bulk))
    assert local.diameters[0, 9, 0] == 0
    assert local.sizes.tolist() == [8.0]
    assert local.shares.tolist() == [1.0]


@pytest.mark.parametrize("width", [1, 2, 4, 5])
def test_pores_beyond_the_bulk_lend_no_balls(width):
    bulk = np.zeros((40, 41, 42), np.uint8)
    bulk[10:30, 10:30, 10:30] = 255
    solid = bulk > 0
    solid[10:30, 18 : 18 + width, 10:30] = False
    rows = values(replace(grid_of(solid), bulk=bulk))
    assert {row.value for row in rows.values()} == {width}
    assert "smallest_gap" in rows


def test_the_distribution_is_that_of_the_map():
    local = local_thickness(grid_of(noise((20, 21, 22), 4, 2), (0.3, 0.4, 0.5), unit="um"))
    inside = local.diameters[local.diameters > 0]
    assert local.sizes @ local.shares == pytest.approx(inside.mean(dtype=float), rel=1e-6)
    assert local.shares.sum() == pytest.approx(1)
    assert (np.diff(local.sizes) > 0).all()
    for part in (0.01, 0.5, 0.99, 1):
        least = np.sort(inside)[math.ceil(part * len(inside)) - 1]
        assert local.quantile(part) == pytest.approx(least, rel=1e-6)
    assert {row.unit for row in thicknesses(local)} == {"um"}
    assert pickle.loads(pickle.dumps(local)) == local


def test_squares_that_are_known_are_taken():
    grid = grid_of(noise((14, 13, 12), 9, 1), (0.5, 0.5, 0.5))
    mask = grid.solid
    squares = squared_distances(mask, grid.frame.spacing, walled=True)
    assert local_thickness(grid, phase="solid", squares=squares) == local_thickness(
        grid, phase="solid"
    )
    others = replace(grid, fill=np.roll(grid.fill, 3, axis=2))
    with pytest.raises(GridError, match="squares: got those of another body"):
        local_thickness(others, phase="solid", squares=squares)


def test_sampling_error_is_in_the_doubt():
    grid = replace(grid_of(noise((9, 9, 9), 1), (0.3,) * 3), sampling_error=0.2)
    assert local_thickness(grid).doubt == pytest.approx(0.5)


def test_progress_is_told_and_may_cancel():
    grid, told = grid_of(noise((40, 9, 12), 1)), []
    local_thickness(grid, progress=lambda what, done: told.append((what, done)))
    assert {what for what, _ in told} == {"local thickness"}
    assert [done for _, done in told] == sorted(done for _, done in told)
    assert told[-1][1] == 1

    def cancel(*_):
        raise Cancelled

    with pytest.raises(Cancelled):
        local_thickness(grid, progress=cancel)


def test_results_do_not_depend_on_threads(monkeypatch):
    grid = grid_of(noise((50, 31, 33), 6, 2), periodic=(True, False, True))
    found = local_thickness(grid)
    for count in ("1", "5"):
        monkeypatch.setenv("POROUS_THREADS", count)
        assert local_thickness(grid) == found


def test_wrong_wishes_are_refused(monkeypatch):
    grid = grid_of(noise((5, 6, 7), 1))
    with pytest.raises(GridError, match=r"phase: got 'pores'; did you mean 'pore'"):
        local_thickness(grid, phase="pores")
    with pytest.raises(GridError, match="beyond: got 'nothing'; there is unknown, void"):
        local_thickness(grid, beyond="nothing")
    full = grid_of(np.ones((5, 6, 7), bool))
    with pytest.raises(GridError, match="no pore voxel; wanted a body with some"):
        local_thickness(full)
    with pytest.raises(GridError, match="all voxels are solid, which ends nowhere"):
        local_thickness(full, phase="solid", beyond="unknown")
    everywhere = replace(full, frame=replace(full.frame, periodic=(True, True, True)))
    with pytest.raises(GridError, match="which ends nowhere"):
        local_thickness(everywhere, phase="solid")
    local = local_thickness(grid)
    with pytest.raises(GridError, match=r"diameters: got shape \(2, 2, 2\)"):
        replace(local, diameters=np.zeros((2, 2, 2)))
    with pytest.raises(GridError, match="wanted one of each"):
        LocalThickness(local.frame, local.diameters, "pore", [1.0], [], 1.0, 1.0)
    monkeypatch.setenv("POROUS_MAX_MEMORY", "1K")
    with pytest.raises(MemoryLimitError, match="local thickness of 5 × 6 × 7 voxels"):
        local_thickness(grid)
