"""Sizes of pores and walls: quantiles, spread, distributions, and what half the voxels say."""

import math
from dataclasses import replace

import numpy as np
import pytest
from test_chords import grid_of, overlapping

from porous.measures import Sample, Survey, local_thickness, size_curves, sizes, survey
from porous.values import Frame, VoxelGrid

ALL = (True, True, True)


def layers(*widths, h=0.5):
    """Layers of solid of these even widths, 6 voxels apart, across y."""
    solid = np.zeros((12, sum(widths) + 6 * len(widths), 10), bool)
    place = 0
    for width in widths:
        solid[:, place : place + width] = True
        place += width + 6
    return VoxelGrid.of_solid(solid, Frame((0, 0, 0), (h, h, h), solid.shape, ALL, "um"))


def taken(grid, **how):
    found = survey(grid, how=Survey(**how), only=["sizes"])
    assert len({row.name for row in found.measures}) == len(found.measures)
    return {row.name: row for row in found.measures}, {c.name: c for c in found.curves}


def test_quantiles_and_spread_of_layers():
    rows, curves = taken(layers(4, 4, 8, 8))
    assert set(rows) == {
        *(f"pore_thickness_{part}" for part in ("mean", "p10", "p50", "p90", "deviation")),
        *(f"wall_thickness_{part}" for part in ("mean", "p10", "p50", "p90", "deviation")),
        *("largest_pore_diameter", "smallest_gap", "largest_wall", "smallest_wall"),
    }
    # A third of the solid is 2 um thick, two thirds are 4.
    values = {name: row.value for name, row in rows.items() if name.startswith("wall")}
    assert values == pytest.approx(
        {
            "wall_thickness_mean": 10 / 3,
            "wall_thickness_p10": 2,
            "wall_thickness_p50": 4,
            "wall_thickness_p90": 4,
            "wall_thickness_deviation": math.sqrt(8 / 9),
        }
    )
    assert rows["pore_thickness_p10"].value == rows["pore_thickness_p90"].value == 3
    assert rows["pore_thickness_deviation"].value == 0
    assert {row.unit for row in rows.values()} == {"um"}
    density = curves["wall_thickness_distribution"]
    widths, told = np.diff(density.x), density.y[:-1]
    assert (widths * told).sum() == pytest.approx(1)
    held = [(told * widths)[(density.x[:-1] < at) & (density.x[1:] > at)].sum() for at in (2, 4)]
    assert held == pytest.approx([1 / 3, 2 / 3])


def test_uncertainties_hold_the_difference_to_half_the_voxels():
    sample = Sample(layers(4, 8, 12))
    rows = {row.name: row for row in survey(sample, only=["sizes"]).measures}
    fine, coarse = sample.thickness("solid"), sample.coarse.thickness("solid")
    there = {row.name: row.value for row in sizes(coarse)}
    for row in sizes(fine):
        wanted = math.hypot(fine.doubt, row.value - there[row.name])
        assert rows[row.name].uncertainty == pytest.approx(wanted)
        assert row.uncertainty == fine.doubt
    assert rows["wall_thickness_p90"].uncertainty == fine.doubt  # 12 voxels or 6: the same


def test_what_half_the_voxels_do_not_see_is_not_known():
    solid = np.zeros((12, 16, 10), bool)
    solid[:, ::8, ::5] = True
    rows, _ = taken(grid_of(solid, periodic=ALL))
    assert math.isinf(rows["wall_thickness_mean"].uncertainty)
    assert 0 < rows["wall_thickness_mean"].value <= 2
    # A grid that cannot be halved has the doubt of a diameter alone.
    rows, _ = taken(grid_of(solid[:7], periodic=ALL))
    assert rows["wall_thickness_mean"].uncertainty == 1


@pytest.mark.parametrize("seed", range(3))
def test_tubes_anywhere_are_within_twice_the_uncertainty(seed):
    random = np.random.default_rng(seed)
    radius, spacing = random.uniform(4, 8), (1.0, 0.8, 1.2)
    frame = Frame((0, 0, 0), spacing, (24, 30, 20), ALL)
    x, y = ((frame.centres(a) - random.uniform(0, 24) + 12) % 24 - 12 for a in (0, 1))
    solid = (x[:, None] ** 2 + y**2 >= radius**2)[..., None] & np.ones(20, bool)
    rows, _ = taken(VoxelGrid.of_solid(solid, frame))
    for name in ("mean", "p10", "p50", "p90"):
        row = rows[f"pore_thickness_{name}"]
        assert abs(row.value - 2 * radius) <= 2 * row.uncertainty < 8, name
    spread = rows["pore_thickness_deviation"]
    assert spread.value <= 2 * spread.uncertainty


@pytest.fixture(scope="module")
def blobs():
    solid, _ = overlapping((48, 44, 50), 5.0, 130, 2)
    return local_thickness(grid_of(solid, (0.3, 0.3, 0.3), ALL))


def test_curves_are_the_distribution(blobs):
    density, upto = size_curves(blobs)
    widths = np.diff(density.x)
    assert widths.min() > 0.3 * (1 - 1e-9)
    assert len(widths) <= 41
    assert widths @ density.y[:-1] == pytest.approx(1)
    assert density.y[-1] == 0
    middles = (density.x[:-1] + density.x[1:]) / 2
    mean = float((middles * density.y[:-1]) @ widths)
    assert mean == pytest.approx(blobs.sizes @ blobs.shares, abs=widths[0] / 2)
    assert (density.drawn, density.x_unit, density.y_unit) == ("steps", "mm", "1/mm")
    assert (np.diff(upto.y) > 0).all()
    assert (upto.y[0], upto.y[-1]) == (0, 1)
    for x, y, low, high in zip(upto.x, upto.y, upto.low, upto.high, strict=True):
        assert y == pytest.approx(blobs.shares[blobs.sizes <= x].sum())
        assert low <= y <= high
        assert high == pytest.approx(blobs.shares[blobs.sizes <= x + blobs.doubt].sum())


def test_long_curves_are_thinned_to_every_quarter_percent(blobs):
    random = np.random.default_rng(1)
    shares = random.random(5000)
    many = replace(blobs, sizes=np.sort(random.uniform(1, 9, 5000)), shares=shares / shares.sum())
    density, upto = size_curves(many)
    assert len(upto.x) <= 401
    assert np.diff(upto.y).max() < 1 / 400 + 2 * many.shares.max()
    assert len(density.x) <= 42


def test_bodies_of_one_phase_have_the_sizes_that_there_are():
    full = grid_of(np.ones((8, 9, 10), bool))
    rows, curves = taken(full)
    assert {name.split("_")[0] for name in rows} <= {"wall", "largest", "smallest"}
    assert rows["largest_wall"].value == 8
    assert set(curves) == {"wall_thickness_distribution", "wall_thickness_cumulative"}
    for grid, beyond in ((full, "unknown"), (grid_of(np.zeros((8, 9, 10), bool)), "void")):
        assert taken(grid, beyond=beyond) == ({}, {})


def test_thickness_of_a_sample_tells_that_of_what_it_is_of():
    solid, _ = overlapping((48, 49, 50), 3.0, 900, 3)
    rows, _ = taken(grid_of(solid), beyond="unknown")
    row, mean = rows["material_pore_thickness_mean"], rows["pore_thickness_mean"]
    local = local_thickness(grid_of(solid), beyond="unknown").diameters
    parts = [
        local[x, y, z]
        for x in (slice(24), slice(24, None))
        for y in (slice(24), slice(24, None))
        for z in (slice(25), slice(25, None))
    ]
    error = np.std([part[part > 0].mean() for part in parts], ddof=1) / math.sqrt(8)
    assert row.value == mean.value
    assert row.uncertainty**2 - mean.uncertainty**2 == pytest.approx(error**2, rel=0.1)
    assert "material_pore_thickness_mean" not in taken(grid_of(solid))[0]
    few, _ = taken(grid_of(solid[:20]), beyond="unknown")
    assert math.isinf(few["material_pore_thickness_mean"].uncertainty)
