"""Betti numbers: those of known bodies, of boundary matrices, and of what is left; tunnels per
volume, of bodies and of samples."""

from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

import porous as po
from porous.errors import GridError
from porous.measures import Sample, Survey, betti_numbers, connectivity_density, survey
from porous.values import Frame, VoxelGrid

SPACING = (0.5, 1.0, 0.8)


def grid_of(solid, periodic=(False, False, False), bulk=None):
    frame = Frame((1, 2, 3), SPACING, solid.shape, periodic)
    grid = VoxelGrid.of_solid(solid, frame)
    return grid if bulk is None else VoxelGrid(frame, grid.fill, bulk)


def numbers(grid, **how):
    return tuple(int(row.value) for row in betti_numbers(grid, **how))


def frame_of_bars(n):
    """The edges of a cube."""
    ends = np.zeros(n, int)
    ends[[0, -1]] = 1
    return ends[:, None, None] + ends[:, None] + ends >= 2


@pytest.mark.parametrize(
    ("solid", "wanted"),
    [
        (np.ones((3, 4, 5), bool), (1, 0, 0)),
        (np.pad(np.zeros((1, 2, 3), bool), 1, constant_values=True), (1, 0, 1)),
        (frame_of_bars(4), (1, 5, 0)),
        (
            np.pad(np.zeros((1, 1, 3), bool), ((1, 1), (1, 1), (0, 0)), constant_values=True),
            (1, 1, 0),
        ),
        (np.arange(7)[:, None, None] % 2 + np.zeros((7, 2, 2)) == 0, (4, 0, 0)),
    ],
)
def test_bodies_that_one_can_count(solid, wanted):
    assert numbers(grid_of(solid)) == wanted
    assert numbers(grid_of(solid), connectivity=26) == wanted
    assert numbers(grid_of(~np.pad(solid, 1)), phase="pore") == wanted


def test_voxels_that_touch_at_an_edge_are_joined_in_the_closed_union_alone():
    solid = np.zeros((2, 2, 1), bool)
    solid[0, 0] = solid[1, 1] = True
    assert numbers(grid_of(solid)) == (2, 0, 0)
    assert numbers(grid_of(solid), connectivity=26) == (1, 0, 0)
    assert numbers(grid_of(solid), phase="pore") == (1, 0, 0)
    assert numbers(grid_of(solid), phase="pore", connectivity=26) == (2, 0, 0)


@pytest.mark.parametrize(("level", "tunnels"), [(1, 5), (2, 81)])
def test_menger_sponges_have_the_tunnels_of_the_closed_form(level, tunnels):
    model = po.build(po.load("menger", set={"model.level": level}))
    found = survey(po.voxelize(model, voxels=3**level), model=model, only=["topology"]).measures
    for name, value in (("betti_0", 1), ("betti_1", tunnels), ("betti_2", 0)):
        for suffix in ("", "_26"):
            rows = found.all(name + suffix)
            assert [(row.method, row.value) for row in rows] == [
                ("closed form", value),
                ("voxel count", value),
            ]
            assert {row.kind for row in rows} == {"exact"}
    assert found["connectivity_density"].value == pytest.approx(tunnels)


def naive_numbers(solid):
    """Betti numbers of the closed union of voxels, by the ranks of its boundary matrices."""
    cells = set()
    for voxel in np.argwhere(solid):
        cells |= {tuple(2 * voxel + 1 + step) for step in product((-1, 0, 1), repeat=3)}
    ranks, sizes = [0], []
    of = [sorted(c for c in cells if sum(x % 2 for x in c) == k) for k in range(4)]
    for k in range(4):
        sizes.append(len(of[k]))
        if k:
            place = {cell: n for n, cell in enumerate(of[k - 1])}
            matrix = np.zeros((len(of[k - 1]), len(of[k])))
            for column, cell in enumerate(of[k]):
                for turn, axis in enumerate(a for a in range(3) if cell[a] % 2):
                    for side in (-1, 1):
                        face = tuple(x + side * (a == axis) for a, x in enumerate(cell))
                        matrix[place[face], column] = side * (-1) ** turn
            ranks.append(np.linalg.matrix_rank(matrix) if matrix.size else 0)
    ranks.append(0)
    return tuple(int(sizes[k] - ranks[k] - ranks[k + 1]) for k in range(3))


@pytest.mark.parametrize("seed", range(6))
def test_the_closed_union_has_the_numbers_of_its_boundary_matrices(seed):
    rng = np.random.default_rng(seed)
    solid = rng.random((4, 3, 5)) < (0.2, 0.5, 0.8)[seed % 3]
    assert numbers(grid_of(solid), connectivity=26) == naive_numbers(solid)
    assert numbers(grid_of(~solid), phase="pore") == naive_numbers(solid)


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.floats(0.05, 0.95), st.sampled_from([6, 26]))
def test_a_body_and_what_is_left_of_space_are_dual(seed, share, connectivity):
    """J. W. Alexander's duality: pieces are the others' cavities, and tunnels are tunnels."""
    solid = np.pad(np.random.default_rng(seed).random((4, 6, 5)) < share, 1)
    if solid.any():
        pieces, tunnels, cavities = numbers(grid_of(solid), connectivity=connectivity)
        left = numbers(grid_of(solid), phase="pore", connectivity=connectivity)
        assert left == (cavities + 1, tunnels, pieces)


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.permutations(range(3)))
def test_axes_are_alike(seed, order):
    solid = np.random.default_rng(seed).random((4, 6, 5)) < 0.5
    turned = np.ascontiguousarray(solid.transpose(order)[::-1])
    for phase in ("pore", "solid"):
        assert numbers(grid_of(solid), phase=phase) == numbers(grid_of(turned), phase=phase)


def test_pores_are_those_of_the_bulk():
    solid = np.zeros((8, 5, 7), bool)
    solid[2:4, 2:4, 2:5] = True
    bulk = np.zeros(solid.shape, np.uint8)
    bulk[1:5, 1:5, 1:6] = 255
    bulk[7, 0, 0] = 255  # a second piece of it
    assert numbers(grid_of(solid, bulk=bulk), phase="pore") == (2, 0, 1)


def test_periodic_bodies_have_pieces_and_nothing_else_is_told():
    solid = np.zeros((6, 5, 7), bool)
    solid[[0, -1]] = True
    grid = grid_of(solid, (True, False, False))
    assert numbers(grid) == (1,)
    assert numbers(grid, phase="pore") == (1,)
    found = survey(grid, only=["topology"])
    assert "betti_1" not in found.measures
    assert "periodic" in found.notes[0]


def test_what_is_asked_for_wrongly_is_refused():
    grid = grid_of(frame_of_bars(4))
    with pytest.raises(GridError, match="phase: got 'pores'"):
        betti_numbers(grid, phase="pores")
    with pytest.raises(GridError, match="wanted 6 or 26"):
        betti_numbers(grid, connectivity=18)
    with pytest.raises(GridError, match="wanted 6 or 26"):
        connectivity_density(grid, connectivity=18)
    with pytest.raises(GridError, match="beyond: got 'nothing'"):
        connectivity_density(grid, beyond="nothing")
    with pytest.raises(GridError, match="two layers"):
        connectivity_density(grid_of(np.ones((1, 4, 5), bool)), beyond="unknown")
    bulk = np.full((4, 4, 4), 255, np.uint8)
    with pytest.raises(GridError, match="bulk"):
        connectivity_density(grid_of(frame_of_bars(4), bulk=bulk), beyond="unknown")


def test_tunnels_per_volume_of_a_body_that_ends():
    row = connectivity_density(grid_of(frame_of_bars(5)))
    assert row.value == pytest.approx(5 / (125 * np.prod(SPACING)))
    assert (row.kind, row.unit) == ("exact", "1/mm³")


@pytest.mark.parametrize("connectivity", [6, 26])
@pytest.mark.parametrize("axes", [axes for n in (1, 2, 3) for axes in combinations(range(3), n)])
def test_a_sample_of_whole_periods_has_the_tunnels_of_the_periodic_body(connectivity, axes):
    """Its sides are told apart from it: χ is that of the torus, whatever they cut."""
    solid = np.random.default_rng(3).random((6, 7, 5)) < 0.4
    cut = np.pad(solid, [(0, int(axis in axes)) for axis in range(3)], mode="wrap")
    rest = tuple(axis not in axes for axis in range(3))
    whole = connectivity_density(grid_of(solid, (True,) * 3), connectivity=connectivity)
    part = connectivity_density(grid_of(cut, rest), beyond="unknown", connectivity=connectivity)
    volume = solid.size * np.prod(SPACING)
    assert part.value * volume == pytest.approx(whole.value * volume + (not any(rest)))
    assert whole.kind == "exact"
    assert part.kind == "standard"


def test_samples_side_by_side_add_up():
    solid = np.random.default_rng(4).random((9, 8, 11)) < 0.5

    def euler(part):
        volume = np.prod(np.subtract(part.shape, 1)) * np.prod(SPACING)
        return 1 - connectivity_density(grid_of(part), beyond="unknown").value * volume

    for cut in ((5, slice(None), slice(None)), (slice(None), slice(None), 4)):
        axis = next(a for a in range(3) if isinstance(cut[a], int))
        below, above = np.split(solid, [cut[axis]], axis=axis)
        above = np.concatenate([below.take([-1], axis=axis), above], axis=axis)
        assert euler(below) + euler(above) == pytest.approx(euler(solid))


def test_the_uncertainty_of_samples_is_that_of_their_spread():
    field = gaussian_filter(np.random.default_rng(5).random((96, 96, 96)), 2, mode="wrap")
    solid = field < np.median(field)
    truth = connectivity_density(grid_of(solid, (True,) * 3)).value
    pulls = []
    for start in product((0, 32, 64), repeat=3):
        part = solid[tuple(slice(a, a + 32) for a in start)]
        row = connectivity_density(grid_of(part), beyond="unknown")
        pulls.append((row.value - truth) / row.uncertainty)
    assert 0.5 < np.std(pulls) < 1.6
    assert abs(np.mean(pulls)) < 0.6


def overlapping_balls(rng, n, radius, density):
    """Balls at random in a periodic box of n³ voxels, as many as may be in such a volume."""
    solid, reach = np.zeros((n, n, n), bool), int(radius) + 2
    for centre in rng.random((rng.poisson(density * n**3), 3)) * n:
        places = [np.arange(int(c) - reach, int(c) + reach + 1) for c in centre]
        x, y, z = (at + 0.5 - c for at, c in zip(places, centre, strict=True))
        ball = x[:, None, None] ** 2 + y[:, None] ** 2 + z**2 < radius**2
        solid[np.ix_(*(at % n for at in places))] |= ball
    return solid


def test_the_uncertainty_of_samples_covers_what_creases_are_off():
    """Of balls at random χ is known; of their voxels it is off at any resolution."""
    radius, pulls = 6.0, []
    density = np.log(2) / (4 / 3 * np.pi * radius**3)
    area, width = 4 * np.pi * radius**2, 4 * np.pi * radius
    truth = 0.5 * density * (density * width * area / (4 * np.pi) - 1)
    truth -= 0.5 * np.pi * density**3 * area**3 / 384
    rng = np.random.default_rng(7)
    for _ in range(3):
        grid = VoxelGrid.of_solid(
            overlapping_balls(rng, 64, radius, density), Frame((0, 0, 0), (1, 1, 1), (64, 64, 64))
        )
        for connectivity in (6, 26):
            row = connectivity_density(grid, beyond="unknown", connectivity=connectivity)
            pulls.append((row.value - truth) / row.uncertainty)
            assert row.uncertainty < truth
    assert np.linalg.norm(pulls) / np.sqrt(len(pulls)) < 2


def test_samples_that_cannot_be_halved_have_no_known_uncertainty():
    solid = np.random.default_rng(8).random((7, 8, 9)) < 0.5
    row = connectivity_density(grid_of(solid), beyond="unknown")
    assert row.uncertainty == np.inf


def test_a_bulk_that_was_sampled_leaves_its_volume_open():
    solid, bulk = np.pad(frame_of_bars(5), 1), np.zeros((7, 7, 7), np.uint8)
    bulk[1:6, 1:6, 1:6] = 255
    row = connectivity_density(grid_of(solid, bulk=bulk))
    assert (row.kind, row.uncertainty) == ("exact", 0)
    bulk[1, 1:6, 1:6] = 191
    row = connectivity_density(grid_of(solid, bulk=bulk))
    assert row.value == pytest.approx(5 / ((100 + 25 * 0.75) * np.prod(SPACING)))
    assert row.kind == "standard"
    assert row.value * 0.13 * 25 / 118.75 <= row.uncertainty < 0.1 * row.value


def test_a_survey_of_a_sample_tells_its_tunnels_without_the_sides():
    solid = np.random.default_rng(6).random((8, 9, 10)) < 0.5
    found = survey(Sample(grid_of(solid), how=Survey(beyond="unknown")), only=["topology"])
    for connectivity, suffix in ((6, ""), (26, "_26")):
        wanted = connectivity_density(grid_of(solid), beyond="unknown", connectivity=connectivity)
        assert found.measures[f"connectivity_density{suffix}"] == wanted
