"""Two-point correlation: equal to counting pairs, and that of bodies one knows; block errors."""

import math
import pickle
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from test_chords import grid_of, overlapping

from porous.errors import GridError
from porous.measures import (
    TwoPoint,
    correlation_length,
    over_blocks,
    pore_chord_mean,
    porosity,
    two_point,
)

PERIODS = [(False, False, False), (True, True, True), (False, True, False)]


def naive(mask, bulk, lag, periodic):
    """Count pairs of voxels by moving the grid onto itself."""
    here, there, pairs = mask, mask, (bulk, bulk)
    for axis, (step, wraps) in enumerate(zip(lag, periodic, strict=True)):
        if wraps:
            there = np.roll(there, -step, axis)
            pairs = (pairs[0], np.roll(pairs[1], -step, axis))
            continue
        n = mask.shape[axis]
        first = [slice(None)] * 3
        second = [slice(None)] * 3
        first[axis], second[axis] = (
            slice(max(0, -step), n - max(0, step)),
            slice(max(0, step), n - max(0, -step)),
        )
        here, there = here[tuple(first)], there[tuple(second)]
        pairs = (pairs[0][tuple(first)], pairs[1][tuple(second)])
    known = (pairs[0] & pairs[1]).sum()
    return (here & there & pairs[0] & pairs[1]).sum() / known if known else math.nan


@pytest.mark.parametrize("periodic", PERIODS)
@pytest.mark.parametrize("has_bulk", [False, True])
def test_it_is_the_part_of_pairs_that_are_counted(periodic, has_bulk):
    random = np.random.default_rng(4)
    solid, spacing = random.random((7, 9, 8)) < 0.4, (1.0, 0.7, 1.2)
    body = random.random(solid.shape) < (0.8 if has_bulk else 1)
    grid = grid_of(solid, spacing, periodic)
    if has_bulk:
        grid = replace(grid, bulk=np.where(body, 255, 0).astype(np.uint8))
    reach = 3.1
    found = two_point(grid, longest=reach)
    bins = {}
    for lag in product(range(-4, 5), repeat=3):
        length = math.hypot(*(a * h for a, h in zip(lag, spacing, strict=True)))
        value = naive(~solid, body, lag, periodic)
        if length <= reach and not math.isnan(value):
            bins.setdefault(int(length / 0.7 + 0.5), []).append((length, value))
    rows = np.array([np.mean(bins[b], axis=0) for b in sorted(bins)])
    assert found.distances == pytest.approx(rows[:, 0])
    assert found.values == pytest.approx(rows[:, 1])
    assert found.lags.tolist() == [len(bins[b]) for b in sorted(bins)]
    for axis, along in enumerate(found.axes):
        for step, value in enumerate(along):
            lag = tuple(step * (a == axis) for a in range(3))
            assert value == pytest.approx(naive(~solid, body, lag, periodic))
    assert pickle.loads(pickle.dumps(found)) == found


def test_it_starts_at_the_phase_and_phases_go_together():
    solid, _ = overlapping((40, 36, 44), 5.0, 60, 1)
    grid = grid_of(solid, periodic=(True, True, True))
    pore, wall = two_point(grid), two_point(grid, phase="solid")
    share = (~solid).mean()
    assert pore.values[0] == share == porosity(grid, method="voxel count").value
    assert wall.values[0] == solid.mean()
    # P(both solid) = 1 − 2 P(one pore) + P(both pores).
    assert wall.values == pytest.approx(1 - 2 * share + pore.values)


def test_its_slope_tells_the_projected_area():
    """Along an axis −dS₂/dr is half the faces across it: Debye's relation on voxels."""
    solid, _ = overlapping((40, 36, 44), 5.0, 60, 1)
    for along, axis in zip(
        two_point(grid_of(solid, periodic=(True,) * 3)).axes, range(3), strict=True
    ):
        faces = (solid != np.roll(solid, 1, axis)).sum()
        assert along[0] - along[1] == pytest.approx(faces / 2 / solid.size)


def test_the_correlation_length_is_the_integral_up_to_where_it_ends():
    distances, h = np.arange(12.0), (1.0, 1.0, 1.0)
    share = 0.4
    left = np.array([1, 0.7, 0.5, 0.2, -0.1, 0.3, 0, 0, 0, 0, 0, 0])
    values = share**2 + left * (share - share**2)
    lags = np.ones(12, np.int64)
    found = TwoPoint("pore", "um", h, distances, values, lags, (values,) * 3)
    wanted = (1 + 0.7) / 2 + (0.7 + 0.5) / 2 + (0.5 + 0.2) / 2 + 0.2 * (2 / 3) / 2
    row = correlation_length(found)
    assert row.value == pytest.approx(wanted)
    assert (row.unit, row.uncertainty) == ("um", math.inf)
    coarse = replace(found, distances=2 * distances)
    assert correlation_length(found, coarse).uncertainty == pytest.approx(wanted)
    # It does not end: what there is, and nobody knows how far off.
    short = replace(found, distances=distances[:3], values=values[:3], lags=lags[:3])
    assert correlation_length(short).value == pytest.approx(0.85 + 0.6)
    assert correlation_length(found, short).uncertainty == math.inf
    with pytest.raises(GridError, match="a phase that is 1 of all"):
        correlation_length(replace(found, values=np.ones(12)))


def test_errors_by_blocks_are_those_of_samples():
    found = [
        over_blocks(
            lambda block: porosity(block, method="voxel count"),
            grid_of(overlapping((64, 64, 64), 3.0, 900, seed)[0]),
            blocks=4,
        )
        for seed in range(12)
    ]
    spread = np.std([one.mean for one in found], ddof=1)
    assert {one.blocks for one in found} == {64}
    assert 0.5 < np.mean([one.error for one in found]) / spread < 2
    curve = over_blocks(
        lambda block: two_point(block, longest=8.0).values,
        grid_of(overlapping((40, 44, 48), 3.0, 400, 1)[0], periodic=(True,) * 3),
    )
    assert curve.mean.shape == curve.error.shape
    assert (curve.error > 0).all()
    one = over_blocks(pore_chord_mean, grid_of(overlapping((40, 44, 48), 3.0, 400, 1)[0]))
    assert 0 < one.error < 0.2 * one.mean


def test_wrong_wishes_are_refused():
    grid = grid_of(np.indices((6, 7, 8)).sum(axis=0) % 2 == 0, periodic=(True, False, False))
    for longest in (0, -1, 3.1, math.nan):
        with pytest.raises(GridError, match=r"longest: got .*; wanted a length of 3 at most"):
            two_point(grid, longest=longest)
    with pytest.raises(GridError, match="blocks: got 7; wanted 2 … 6"):
        over_blocks(porosity, grid, blocks=7)
    with pytest.raises(GridError, match="wanted as many of each"):
        replace(two_point(grid), lags=[1])
