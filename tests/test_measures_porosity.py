"""Porosity and pores: closed forms, duality, tiles, masks; uncertainties that cover the truth."""

import math
from itertools import pairwise, product

import naive_measures
import numpy as np
import pytest

from porous import build, ifs, load, measures, voxelize
from porous.errors import GridError
from porous.measures._census import (
    Census,
    count_coarse_windows,
    count_fills,
    count_windows,
)
from porous.measures._porosity import VOXEL, solid_fractions
from porous.models.digits import named
from porous.values import FILL, Box, Frame, VoxelGrid

PERIODIC = list(product((False, True), repeat=3))
POINTS = np.column_stack([np.repeat(FILL.rows, FILL.depths.shape[1], 0), FILL.depths.ravel()])


def random_grid(shape, seed, *, density=0.5, periodic=(False, False, False), bulk=None):
    random = np.random.default_rng(seed)
    fill = (random.random(shape) * 255).astype(np.uint8)
    fill = np.where(random.random(shape) < density, fill | 128, fill & 127).astype(np.uint8)
    return VoxelGrid(Frame((1, 2, 3), (0.5, 0.4, 0.3), shape, periodic), fill, bulk)


def sampled(inside, frame):
    """Return the grid of ``inside`` at the 64 points of every voxel."""
    index = np.stack(np.meshgrid(*map(np.arange, frame.shape), indexing="ij"), axis=-1)
    count = np.zeros(frame.shape, int)
    for point in POINTS:
        count += inside(np.array(frame.origin) + (index + point) * frame.spacing)
    return VoxelGrid(frame, ((255 * count + 32) // 64).astype(np.uint8))


def cuts_of(shape, seed):
    random = np.random.default_rng(seed)
    parts = [sorted({0, n, *random.integers(0, n, 2).tolist()}) for n in shape]
    for tile in product(*(list(pairwise(p)) for p in parts)):
        yield tuple(zip(*tile, strict=True))


# --- porosity ------------------------------------------------------------------------------


@pytest.mark.parametrize("voxels", [50, 64, 100])
def test_uncertainty_covers_menger_off_its_lattice(voxels):
    grid = voxelize(build(load("menger")), voxels=voxels)
    truth = 1 - (20 / 27) ** 2
    fill, count = (measures.porosity(grid, method=m) for m in ("voxel fill", "voxel count"))
    assert abs(fill.value - truth) <= fill.uncertainty < 0.02
    assert abs(count.value - truth) <= count.uncertainty
    assert fill.uncertainty <= count.uncertainty


@pytest.mark.parametrize("seed", range(20))
def test_uncertainty_covers_random_bodies(seed):
    random = np.random.default_rng(seed)
    frame = Frame((0, 0, 0), tuple(random.uniform(0.7, 1.4, 3)), (17, 18, 19))
    centre = np.array(frame.box.centre) + random.uniform(-1, 1, 3)
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0] if seed % 3 else np.eye(3)
    edges = random.uniform(4, 9, 3)
    if seed % 5 == 4:
        radius = random.uniform(3, 5)
        grid = sampled(lambda p: ((p - centre) ** 2).sum(-1) <= radius**2, frame)
        truth = 4 / 3 * np.pi * radius**3
    else:
        grid = sampled(lambda p: (abs((p - centre) @ turn) <= edges / 2).all(-1), frame)
        truth = edges.prod()
    for method in ("voxel fill", "voxel count"):
        row = measures.volume(grid, method=method)
        assert abs(row.value - truth) <= row.uncertainty
        assert row.unit == "mm³"
    assert measures.volume(grid).uncertainty < 0.04 * truth or not seed % 3


def test_errors_of_planes_are_what_is_said():
    for v in product(range(-7, 8), repeat=3):
        if v <= (0, 0, 0) or math.gcd(*v) != 1:
            continue
        phases = np.sort((POINTS @ v) % 1)
        ends = np.concatenate([phases - 1e-12, phases + 1e-12])
        shared = np.abs(((phases - ends[:, None]) % 1).mean(axis=1) - 0.5).max()
        places = np.abs(v).sum()
        assert shared / places <= VOXEL / places**0.5


def test_errors_of_single_voxels_are_what_is_said():
    normals = np.random.default_rng(0).normal(size=(2000, 3))
    offsets = np.random.default_rng(1).uniform(-0.5, 0.5, 2000)
    fine = (np.stack(np.meshgrid(*[np.arange(40)] * 3), axis=-1).reshape(-1, 3) + 0.5) / 40 - 0.5
    worst = 0.0
    for normal, offset in zip(normals, offsets, strict=True):
        seen = ((POINTS - 0.5) @ normal <= offset).mean()
        worst = max(worst, abs(seen - (fine @ normal <= offset).mean()))
    assert 0.04 < worst < VOXEL


def test_centres_and_covers_say_so_in_their_uncertainty():
    frame = Frame((0, 0, 0), (1, 1, 1), (20, 21, 22))
    index = np.stack(np.meshgrid(*map(np.arange, frame.shape), indexing="ij"), axis=-1)
    solid = (np.abs(index + 0.5 - 10) <= 5).all(axis=-1)
    rows = [
        measures.volume(VoxelGrid.of_solid(solid, frame, sampling=sampling))
        for sampling in ("fill", "centre", "cover")
    ]
    assert all(row.value == 1000 for row in rows)
    fill, centre, cover = (row.uncertainty for row in rows)
    assert 0 < fill < centre < cover == 1000
    assert centre == pytest.approx(200 * 3**0.5 / 12**0.5)


def test_fills_of_64_points_stand_for_whole_64ths():
    k = np.arange(65)
    histogram = np.bincount((255 * k + 32) // 64, minlength=256)
    assert (solid_fractions(histogram, "fill")[(255 * k + 32) // 64] == k / 64).all()
    histogram[1] += 1  # no count of 64 gives 1: these are other fractions
    np.testing.assert_array_equal(solid_fractions(histogram, "fill"), np.arange(256) / 255)


def test_half_filled_layers_are_half():
    fill = np.full((4, 5, 6), 128, np.uint8)
    grid = VoxelGrid(Frame((0, 0, 0), (1, 2, 3), (4, 5, 6)), fill)
    assert measures.porosity(grid).value == 0.5
    assert measures.porosity(grid, method="voxel count").value == 0


@pytest.mark.parametrize("seed", range(4))
def test_porosity_and_density_add_up_to_one(seed):
    bulk = np.random.default_rng(seed).choice([0, 100, 200, 255], (6, 7, 8)).astype(np.uint8)
    grid = random_grid((6, 7, 8), seed, bulk=bulk if seed % 2 else None)
    for method in ("voxel fill", "voxel count"):
        total = (
            measures.porosity(grid, method=method).value
            + measures.relative_density(grid, method=method).value
        )
        assert total == pytest.approx(1, abs=1e-14)


def test_porosity_refers_to_the_bulk():
    fill, bulk = np.zeros((2, 4, 6, 8), np.uint8)
    bulk[:, :3] = 255
    fill[:2, :3] = 255
    fill[:, 3:] = 255  # of no concern
    grid = VoxelGrid(Frame((0, 0, 0), (1, 1, 1), (4, 6, 8)), fill, bulk)
    assert measures.porosity(grid).value == 0.5
    assert measures.porosity(grid, method="voxel count").value == 0.5
    assert measures.volume(grid).value == 4 * 3 * 8 + 2 * 3 * 8


def test_bulk_and_fill_that_share_a_voxel_leave_it_open():
    fill = np.full((3, 3, 3), 128, np.uint8)
    bulk = np.full((3, 3, 3), 128, np.uint8)
    row = measures.relative_density(VoxelGrid(Frame((0, 0, 0), (1, 1, 1), (3, 3, 3)), fill, bulk))
    assert row.value == pytest.approx(0.5 / (128 / 255))
    assert row.value - row.uncertainty <= 0


def test_a_bulk_of_nothing_is_refused():
    grid = random_grid((3, 4, 5), 0, bulk=np.zeros((3, 4, 5), np.uint8))
    with pytest.raises(GridError, match="bulk"):
        measures.porosity(grid)


def test_unknown_methods_are_named():
    with pytest.raises(ValueError, match="'voxel fill', 'voxel count'"):
        measures.porosity(random_grid((3, 4, 5), 0), method="guess")


@pytest.mark.parametrize("value", [128, 255])
def test_pores_that_nobody_saw_may_be_of_any_kind(value):
    grid = VoxelGrid(Frame((0, 0, 0), (1, 1, 1), (10, 10, 10)), np.full((10,) * 3, value, np.uint8))
    total = measures.porosity(grid, method="voxel count")
    assert (total.value, total.uncertainty > 0) == (0, True)
    taken = (measures.open_porosity, measures.closed_porosity, measures.through_porosity_x)
    for row in (take(grid) for take in (*taken, measures.through_porosity_z)):
        assert (row.value, row.uncertainty) == (0, total.uncertainty)


# --- folds ---------------------------------------------------------------------------------


@pytest.mark.parametrize("periodic", PERIODIC)
def test_counts_of_tiles_add_up(periodic):
    bulk = np.random.default_rng(1).choice([0, 255], (7, 9, 8), p=[0.3, 0.7]).astype(np.uint8)
    for seed, mask in ((0, None), (1, bulk)):
        grid = random_grid((7, 9, 8), seed, periodic=periodic, bulk=mask)
        whole = [((0, 0, 0), grid.frame.shape)]
        for count in (count_windows, count_coarse_windows):
            many = measures.fold(count, grid, cuts_of((7, 9, 8), seed))
            one = measures.fold(count, grid, whole)
            for name in ("seen", "continued"):
                np.testing.assert_array_equal(getattr(many, name), getattr(one, name))
        one, many = (measures.fold(count_fills, grid, t) for t in (whole, cuts_of((7, 9, 8), 3)))
        np.testing.assert_array_equal(one.histogram, many.histogram)
        np.testing.assert_array_equal(one.jumps, many.jumps)


@pytest.mark.parametrize("periodic", PERIODIC)
@pytest.mark.parametrize("connectivity", [6, 26])
def test_pieces_of_tiles_join(periodic, connectivity):
    bulk = np.zeros((7, 9, 8), np.uint8)
    bulk[1:6, :, 2:] = 255
    for seed, density in enumerate((0.15, 0.4, 0.7, 0.88, 0.95)):
        mask = bulk if seed % 2 else None
        grid = random_grid((7, 9, 8), seed, density=density, periodic=periodic, bulk=mask)
        one, many = (
            Census(grid, tiles=tiles).pieces(solid=False, connectivity=connectivity, in_bulk=True)
            for tiles in (None, list(cuts_of((7, 9, 8), seed)))
        )
        assert told(one) == told(many)
        assert one.number == many.number == len(told(many))


def told(pieces):
    rows = [pieces.sizes, pieces.low.T, pieces.high.T, pieces.outside, pieces.endless.T]
    each = np.repeat(np.vstack(rows).astype(int), pieces.counts, axis=1)
    return sorted(zip(*map(tuple, each.tolist()), strict=True))


@pytest.mark.parametrize("periodic", PERIODIC)
@pytest.mark.parametrize("connectivity", [6, 26])
def test_pieces_are_those_of_flooding(periodic, connectivity):
    for seed, density in enumerate((0.3, 0.5, 0.65, 0.8, 0.9)):
        grid = random_grid((4, 5, 6), seed, density=density, periodic=periodic)
        pieces = Census(grid).pieces(solid=False, connectivity=connectivity)
        labels, count = naive_measures.label(~grid.solid, connectivity, periodic)
        sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
        assert sorted(np.repeat(pieces.sizes, pieces.counts)) == sorted(sizes)
        for axis in range(3):
            if periodic[axis]:
                around = naive_measures.winds(~grid.solid, connectivity, periodic, axis)
                assert pieces.voxels[pieces.endless[:, axis]].sum() == around.sum()
            else:
                ends = [set(labels.take(end, axis=axis).flat) - {0} for end in (0, -1)]
                both = sum(sizes[label - 1] for label in ends[0] & ends[1])
                assert pieces.voxels[pieces.through[:, axis]].sum() == both
                assert not pieces.endless[:, axis].any()


# --- pores ---------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_open_and_closed_add_up_to_the_porosity_by_count(seed):
    bulk = np.full((9, 8, 7), 255, np.uint8)
    bulk[:, 6:] = 0
    grid = random_grid((9, 8, 7), seed, density=0.55 + 0.06 * seed, bulk=bulk if seed % 2 else None)
    total = measures.porosity(grid, method="voxel count")
    parts = measures.open_porosity(grid), measures.closed_porosity(grid)
    assert parts[0].value + parts[1].value == pytest.approx(total.value, abs=1e-15)
    assert parts[0].uncertainty + parts[1].uncertainty >= total.uncertainty


def block(shape=(5, 6, 7), periodic=(False, False, False)):
    return np.full(shape, 255, np.uint8), Frame((0, 0, 0), (1, 1, 1), shape, periodic)


def test_a_channel_is_open_and_leads_through_its_axis_only():
    fill, frame = block()
    fill[:, 2, 3] = 0
    fill[2, 4, 2] = 0
    grid = VoxelGrid(frame, fill)
    assert measures.open_porosity(grid).value == 5 / 210
    assert measures.closed_porosity(grid).value == 1 / 210
    through = [
        measures.through_porosity_x,
        measures.through_porosity_y,
        measures.through_porosity_z,
    ]
    assert [f(grid).value for f in through] == [5 / 210, 0, 0]


def test_pores_that_meet_in_an_edge_are_open_and_uncertain():
    fill, frame = block()
    fill[0, 2, 3] = fill[1, 3, 3] = 0
    row = measures.open_porosity(VoxelGrid(frame, fill))
    assert row.value == 2 / 210
    # All pores are open, so the doubt about the porosity itself comes on top of the edge's.
    sampled = measures.porosity(VoxelGrid(frame, fill), method="voxel count").uncertainty
    assert row.uncertainty == pytest.approx(1 / 210 + sampled)


def test_a_straight_channel_goes_on_along_a_periodic_axis():
    fill, frame = block(periodic=(True, True, True))
    fill[:, 2, 3] = 0
    grid = VoxelGrid(frame, fill)
    assert measures.open_porosity(grid).value == 5 / 210
    assert measures.through_porosity_x(grid).value == 5 / 210
    fill = fill.copy()
    fill[2, 2, 3] = 255  # a plug: the pore reaches both ends, but leads nowhere
    grid = VoxelGrid(frame, fill)
    assert measures.through_porosity_x(grid).value == 0
    assert measures.closed_porosity(grid).value == 4 / 210


def test_a_channel_that_climbs_goes_around_two_axes():
    fill, frame = block((6, 6, 4), periodic=(True, True, False))
    for i in range(6):
        fill[i, i, 2] = fill[i, (i + 1) % 6, 2] = 0
    grid = VoxelGrid(frame, fill)
    assert measures.through_porosity_x(grid).value == measures.through_porosity_y(grid).value > 0
    # In one period the same steps lead up and down again: a ring that leads nowhere.
    fill, frame = block((6, 6, 4), periodic=(True, True, False))
    fill[1:4, 1, 1] = fill[1:4, 3, 1] = fill[[1, 3], 2, 1] = 0
    assert measures.through_porosity_x(VoxelGrid(frame, fill)).value == 0


def test_pores_end_where_the_bulk_does():
    fill, frame = block()
    bulk = np.zeros_like(fill)
    bulk[1:4, 1:5, 1:6] = 255
    fill[1:4, 2, 3] = 0
    fill[4, 2, 3] = 0  # void beyond the bulk: the pore opens into it
    grid = VoxelGrid(frame, fill, bulk)
    assert measures.open_porosity(grid).value == 3 / 60
    assert measures.through_porosity_x(grid).value == 3 / 60
    fill[4, 2, 3] = 255
    grid = VoxelGrid(frame, fill, bulk)
    assert measures.closed_porosity(grid).value == 3 / 60


@pytest.mark.parametrize("seed", range(3))
def test_tiling_a_period_changes_no_fraction(seed):
    grid = random_grid((4, 5, 6), seed, density=0.75, periodic=(True, True, True))
    frame = Frame((0, 0, 0), grid.frame.spacing, (8, 5, 18), (True, True, True))
    tiled = VoxelGrid(frame, np.tile(grid.fill, (2, 1, 3)))
    for function in (
        measures.porosity,
        measures.open_porosity,
        measures.closed_porosity,
        measures.through_porosity_x,
        measures.through_porosity_z,
    ):
        assert function(tiled).value == pytest.approx(function(grid).value, abs=1e-14)


def test_permuting_axes_permutes_the_measures():
    grid = random_grid((5, 6, 7), 3, density=0.6)
    moved = VoxelGrid(
        Frame((0, 0, 0), (0.3, 0.5, 0.4), (7, 5, 6)), np.transpose(grid.fill, (2, 0, 1))
    )
    assert measures.through_porosity_x(grid).value == measures.through_porosity_y(moved).value
    assert measures.through_porosity_z(grid).value == measures.through_porosity_x(moved).value


# --- bodies that leave their bulk, and boundaries that are not quite the body's --------------


@pytest.mark.parametrize("voxels", [13, 20, 47])
def test_the_volume_of_a_body_that_outgrows_its_bulk(voxels):
    ball = ifs([(np.eye(3) / 2, np.zeros(3))], level=0, primitive="ball", offset=0.5)
    row = measures.volume(voxelize(ball, voxels=voxels))
    assert 0 < abs(row.value - 4 / 3 * math.pi) <= 2 * row.uncertainty


@pytest.mark.parametrize(("offset", "voxels"), [(0.2, 51), (0.05, 51), (1.0, 24)])
def test_a_grown_segment_is_within_its_uncertainty(offset, voxels):
    halves = [(np.eye(3) / 2, np.array([shift, 0, 0])) for shift in (0.0, 0.5)]
    grid = voxelize(ifs(halves, level="limit", offset=offset), voxels=voxels)
    steiner = math.pi * offset**2 + 4 / 3 * math.pi * offset**3
    row = measures.volume(grid)
    assert grid.sampling_error > 0
    assert abs(row.value - steiner) <= 2 * row.uncertainty


def test_a_full_body_has_no_negative_doubt():
    corners = [(np.eye(3) / 2, np.array(np.unravel_index(i, (2, 2, 2))) / 2) for i in range(8)]
    row = measures.porosity(voxelize(ifs(corners, level="limit", offset=0.05), voxels=51))
    assert row.uncertainty >= abs(row.value)


def test_a_cut_cover_has_no_hausdorff_bound():
    menger = named("menger")
    whole = voxelize(ifs(menger, level="limit"), voxels=18, sampling="cover")
    cut = ifs(menger, level="limit", domain=Box((0, 0, 0), (1, 1, 0.5)))
    assert whole.hausdorff is not None
    assert voxelize(cut, voxels=18, sampling="cover").hausdorff is None
