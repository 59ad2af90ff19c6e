"""Rough skins: heights by their definition, dimensions and amplitudes as asked for, measured."""

import csv
import itertools
import math
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import porous as po
from porous.errors import GridError, ModelError, RecipeError
from porous.kernels.relief import GOLDEN, PAIRS, WORD, keys
from porous.measures import (
    HeightMap,
    _roughness,
    height_map,
    measure,
    roughness,
    roughness_of_sides,
    variogram,
)
from porous.models.digits import named
from porous.models.relief import DEEPEST, Relief
from porous.models.rough import Rough, Skin, rough
from porous.pipeline import examine
from porous.recipe import dump, parse, schema
from porous.values import CENTRE, FILL
from porous.values.box import SIDES

BLOCK = (20.0, 26.0, 8.0)
UNEQUAL = po.Box((-1.0, 2.0, 0.5), (3.0, 8.0, 5.5))


def grid_of(n, m):
    """The middles of n × m cells of the unit square."""
    x, y = ((np.arange(count) + 0.5) / count for count in (n, m))
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


def averaged(relief, n, fine=4):
    """The means of a relief over n × n squares, as voxels have them."""
    z = relief.heights(grid_of(fine * n, fine * n), 20)
    return z.reshape(n, fine, n, fine).mean(axis=(1, 3))


# --- slow twins ----------------------------------------------------------------------------


def naive_sign(seed, level, i, j):
    """Which way a bump points, in whole numbers of any length."""
    if seed is None:
        return 1

    def mixed(word):
        word = (word ^ word >> 30) * 0xBF58476D1CE4E5B9 & WORD
        word = (word ^ word >> 27) * 0x94D049BB133111EB & WORD
        return word ^ word >> 31

    word = mixed(seed + (level + 1) * GOLDEN & WORD)
    for parent in (i // 2, j // 2):
        word = mixed(word + parent * GOLDEN & WORD)
    return 1 if PAIRS[word % 6] >> (2 * (i % 2) + j % 2) & 1 else -1


def naive_height(relief, place, levels):
    """The sum over levels as the literature has it."""
    total = 0.0
    for level in range(levels):
        u, v = (c * n * 2**level for c, n in zip(place, relief.cells, strict=True))
        tents = [1 - abs(2 * (c - math.floor(c)) - 1) for c in (u, v)]
        sign = naive_sign(relief.seed, level, math.floor(u), math.floor(v))
        total += sign * relief.ratio**level * tents[0] * tents[1]
    return relief.scale * total


def naive_heights(grid, face):
    """The outermost half solid voxel of each column and what it lacks, one voxel at a time."""
    axis, upper = divmod(SIDES.index(face), 2)
    fill = np.moveaxis(grid.fill.astype(float), axis, -1)
    fill = fill[..., ::-1] if upper else fill
    result = np.zeros(fill.shape[:2])
    for i, j in np.ndindex(result.shape):
        column = fill[i, j]
        last = first = next(k for k, f in enumerate(column) if f >= 128)
        while last + 1 < len(column) and column[last + 1] > column[last]:
            last += 1
        assert last >= first
        result[i, j] = -(1 - column[: last + 1] / 255).sum() * grid.frame.spacing[axis]
    return result


reliefs = st.builds(
    Relief,
    st.floats(2.02, 2.9),
    st.floats(0.1, 5),
    st.tuples(st.integers(1, 5), st.integers(1, 5)),
    st.none() | st.integers(0, 2**70),
)


@settings(max_examples=25)
@given(reliefs, st.integers(1, 30))
def test_heights_are_sums_over_levels(relief, levels):
    places = np.random.default_rng(levels).random((6, 2))
    wanted = [naive_height(relief, place, levels) for place in places]
    assert relief.heights(places, levels) == pytest.approx(wanted, abs=1e-6 * relief.scale)


# --- heights -------------------------------------------------------------------------------


def test_a_surface_of_all_bumps_upwards_is_takagis():
    relief = Relief(2.4, 1.0, seed=None)
    r = 2**-0.6
    assert relief.ratio == pytest.approx(r)
    # ψ(2^k/3) = 2/3; ψ(2^k/5) = 2/5, 4/5, 2/5, …; in the middle and beside it only the first bump.
    places = np.array([[1 / 3, 1 / 3], [1 / 3, 1 / 5], [0.5, 0.5], [0.5, 0.3]])
    wanted = np.array([4 / 9 / (1 - r), 2 / 3 * (2 / 5 + 4 / 5 * r) / (1 - r**2), 1, 0.6])
    assert relief.heights(places) == pytest.approx(wanted * relief.scale, rel=1e-6)


@settings(max_examples=25)
@given(reliefs, st.integers(0, 4))
def test_middles_are_off_the_mean_of_their_corners_by_the_ratio_to_the_level(relief, level):
    counts = [n * 2**level for n in relief.cells]
    random = np.random.default_rng(level)
    cells = np.stack([random.integers(0, n, 8) for n in counts], axis=1)
    corners = [relief.heights((cells + c) / counts, 30) for c in product((0, 1), repeat=2)]
    middles = relief.heights((cells + 0.5) / counts, 30)
    off = (middles - np.mean(corners, axis=0)) / relief.scale
    assert np.abs(off) == pytest.approx(relief.ratio**level, rel=1e-6)


@settings(max_examples=15)
@given(reliefs)
def test_borders_are_zero_and_so_is_all_beyond(relief):
    t = np.linspace(0, 1, 41)
    for axis, end in product((0, 1), (0.0, 1.0, -0.2, 1.1)):
        places = np.stack([np.full(41, end), t], axis=1)[:, :: 1 if axis else -1]
        assert np.abs(relief.heights(places)).max() == 0


@settings(max_examples=25)
@given(reliefs)
def test_neighbours_agree_along_their_edges(relief):
    t = np.random.default_rng(1).random(30)
    for axis, edge in product((0, 1), (0.25, 0.5, 0.625)):
        sides = []
        for shift in (-1e-13, 1e-13):
            places = np.stack([np.full(30, edge / relief.cells[axis] + shift), t], axis=1)
            sides.append(relief.heights(places[:, :: 1 if axis == 0 else -1], 30))
        assert np.abs(sides[0] - sides[1]).max() < 0.1 * relief.scale * relief.ratio**25 + 1e-9


@settings(max_examples=12)
@given(reliefs)
def test_heights_lie_within_what_is_certified(relief):
    z = relief.heights(np.random.default_rng(2).random((20_000, 2)), 40)
    assert relief.lowest <= z.min() <= z.max() <= relief.highest
    assert (relief.lowest == 0) == (relief.seed is None) or relief.lowest < 0
    for levels in (1, 4, 9):
        left = relief.heights(grid_of(50, 40), 44) - relief.heights(grid_of(50, 40), levels)
        assert np.abs(left).max() <= relief.left(levels) * (1 + 1e-9)
    assert relief.left(relief.levels(1e-2)) <= 1e-2 or relief.levels(1e-2) == 48


@pytest.mark.parametrize("dimension", [2.01, 2.2, 2.4, 2.6])
def test_the_highest_point_is_bounded_closely(dimension):
    relief = Relief(dimension, 1.0)
    t = np.linspace(0, 0.5, 100_001)
    highest = relief.heights(np.stack([t, t], axis=1)).max()
    assert highest <= relief.left(0) <= 1.03 * highest


@pytest.mark.parametrize("dimension", [2.05, 2.2, 2.5])
@pytest.mark.parametrize("cells", [(1, 1), (2, 3)])
def test_the_amplitude_of_all_bumps_upwards_has_a_closed_form(dimension, cells):
    relief = Relief(dimension, 2.5, cells)
    variance = 7 / 144 / (1 - relief.ratio**2)
    assert relief.scale == pytest.approx(2.5 / math.sqrt(variance), rel=1e-9)
    assert relief.amplitude_doubt == 0
    z = relief.heights(grid_of(487, 479), 30)
    assert z.std() == pytest.approx(2.5, rel=3e-3)
    assert z.mean() == pytest.approx(relief.mean, rel=3e-3)
    assert relief.mean == pytest.approx(relief.scale / 4 / (1 - relief.ratio))


@pytest.mark.parametrize(("seed", "cells"), [(0, (1, 1)), (5, (3, 2)), (2**80, (4, 4))])
def test_the_amplitude_is_that_of_the_surface_drawn(seed, cells):
    relief = Relief(2.25, 0.7, cells, seed)
    z = relief.heights(grid_of(640, 600), 25)
    assert z.std() == pytest.approx(0.7, abs=max(relief.amplitude_doubt, 2e-4))
    assert z.mean() == pytest.approx(relief.mean, abs=1e-4)
    assert relief.amplitude_doubt < 2e-3


def test_two_of_four_siblings_point_upwards_and_seeds_differ():
    drawn = [[naive_sign(7, 3, i, j) for j in range(32)] for i in range(32)]
    pairs = np.array(drawn).reshape(16, 2, 16, 2).sum(axis=(1, 3))
    assert (pairs == 0).all()
    assert len(np.unique(np.array(drawn).reshape(16, 2, 16, 2).swapaxes(1, 2), axis=0)) == 16
    places = grid_of(20, 20)
    one, again, other = (Relief(2.2, 1, (2, 2), s).heights(places) for s in (3, 3, 4))
    assert np.array_equal(one, again)
    assert np.abs(one - other).max() > 0.5
    assert len(np.unique(keys(3, 48))) == 48


# --- the face of five controls -------------------------------------------------------------


def test_it_is_a_face_of_five_controls_divided_into_four():
    """The corners and the middle of each cell, by matrices from the right, for one sign."""
    r = Relief(2.3, 1.0).ratio
    corners = list(product((0, 1), repeat=2))
    delta = np.array([-0.25, -0.25, -0.25, -0.25, 1.0])
    rules = []
    for child in corners:
        columns = []
        for corner in corners:
            u, v = ((a + b) / 2 for a, b in zip(child, corner, strict=True))
            bilinear = [(1 - u, u)[a] * (1 - v, v)[b] for a, b in corners]
            is_middle = (u, v) == (0.5, 0.5)
            columns.append(np.array([*bilinear, 0]) + is_middle * delta)
        columns.append(np.mean(columns, axis=0) + r * delta)
        rules.append(np.stack(columns, axis=1))
    relief = Relief(2.3, 1.0)
    first = np.array([[0, 0, 1, 1, 0.5], [0, 1, 0, 1, 0.5], [0, 0, 0, 0, relief.scale]])
    assert np.allclose(np.array(rules).sum(axis=1), 1)
    for word in product(range(4), repeat=4):
        controls = first
        for digit in word:
            controls = controls @ rules[digit]
        assert relief.heights(controls[:2].T) == pytest.approx(controls[2], abs=1e-6)


# --- maps of heights -----------------------------------------------------------------------


def values(heights, face="ZMAX"):
    return {(r.name.rsplit("_", 1)[0], r.method): r for r in roughness(heights, face)}


def test_a_plane_has_no_roughness_and_no_dimension():
    rows = values(HeightMap(np.full((40, 33), 7.5), (0.1, 0.3)))
    assert {name for name, _ in rows} == {"sa", "sq", "sz", "sdr"}
    assert all(row.value == 0 for row in rows.values())


def test_a_sinusoid_has_its_closed_forms():
    x = np.broadcast_to((np.arange(600) + 0.5)[:, None] / 200, (600, 31))
    rows = values(HeightMap(0.3 * np.cos(2 * np.pi * x) + 4, (1 / 200, 2 / 30)))
    assert rows["sa", "height map"].value == pytest.approx(0.3 * 2 / np.pi, rel=1e-4)
    assert rows["sq", "height map"].value == pytest.approx(0.3 / math.sqrt(2), rel=1e-9)
    assert rows["sz", "height map"].value == pytest.approx(0.6, rel=1e-3)


def test_a_sinusoid_has_the_area_of_its_arc():
    x, y = np.meshgrid(np.arange(401) / 200, np.linspace(0, 2, 31), indexing="ij")
    rows = values(HeightMap(0.3 * np.cos(2 * np.pi * x) + 0 * y, (1 / 200, 2 / 30)))
    t = np.linspace(0, 2 * np.pi, 4001)[:-1]
    area = np.sqrt(1 + (0.6 * np.pi * np.sin(t)) ** 2).mean()
    assert rows["sdr", "height map"].value == pytest.approx(area - 1, rel=1e-3)


def test_a_tilted_plane_has_the_area_of_its_tilt():
    x, y = np.meshgrid(np.arange(30) * 0.5, np.arange(20) * 0.25, indexing="ij")
    rows = values(HeightMap(0.75 * x - 1.5 * y, (0.5, 0.25)))
    assert rows["sdr", "height map"].value == pytest.approx(math.sqrt(1 + 0.75**2 + 1.5**2) - 1)


def test_units_and_uncertainties_are_told():
    z = np.random.default_rng(0).normal(size=(40, 40))
    rows = values(HeightMap(z, (1.0, 1.0), "um", 0.2))
    assert {row.unit for (name, _), row in rows.items() if name in ("sa", "sq", "sz")} == {"um"}
    assert rows["sdr", "height map"].unit == "1"
    assert all(row.kind == "standard" and row.uncertainty > 0 for row in rows.values())
    # Of white noise, means of four have half the height: the map is not fine enough to know.
    assert rows["sq", "height map"].uncertainty == pytest.approx(0.5, abs=0.06)


def fractional(hurst, n, seed):
    """A Gaussian surface with the spectrum |k|^(−2H − 2), one period of twice the map."""
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(2 * n), np.fft.fftfreq(2 * n)))
    k[0, 0] = np.inf
    noise = np.fft.fft2(np.random.default_rng(seed).normal(size=k.shape))
    return np.fft.ifft2(noise * k ** (-hurst - 1)).real[:n, :n]


@pytest.mark.parametrize("dimension", [2.1, 2.3, 2.6])
def test_the_variogram_tells_the_dimension_of_gaussian_surfaces(dimension):
    found = [
        values(HeightMap(fractional(3 - dimension, 256, seed), (1.0, 1.0)))[
            "dimension", "variogram"
        ]
        for seed in range(6)
    ]
    assert np.mean([row.value for row in found]) == pytest.approx(dimension, abs=0.04)
    assert all(abs(row.value - dimension) < 3 * row.uncertainty + 0.03 for row in found)


@pytest.mark.parametrize("dimension", [2.1, 2.2, 2.3])
@pytest.mark.parametrize("seed", range(4))
def test_what_is_drawn_has_the_dimension_asked_for(dimension, seed):
    """Over distances of 4 to 64 of 256 columns, at four bumps; means over columns, as of voxels."""
    z = averaged(Relief(dimension, 1.0, (4, 4), seed), 256)
    rows = values(HeightMap(z, (0.1, 0.1)))
    assert rows["dimension", "variogram"].value == pytest.approx(dimension, abs=0.05)
    assert rows["dimension", "variation"].value == pytest.approx(dimension, abs=0.15)


@pytest.mark.parametrize("columns", [64, 128])
@pytest.mark.parametrize("dimension", [2.1, 2.2, 2.3])
def test_twice_the_stated_uncertainty_holds_the_error(columns, dimension):
    for bumps, seed in itertools.product(range(1, columns // 64 + 1), range(10)):
        z = averaged(Relief(dimension, 1.0, (bumps, bumps), seed), columns)
        row = values(HeightMap(z, (0.1, 0.1)))["dimension", "variogram"]
        assert abs(row.value - dimension) <= 2 * row.uncertainty, (bumps, seed)
        assert row.uncertainty < 0.15


def test_a_variogram_is_the_mean_of_second_differences():
    z = np.random.default_rng(3).normal(size=(70, 64)).cumsum(axis=0).cumsum(axis=1)
    found = variogram(HeightMap(z, (0.3, 0.7)))
    assert 3 <= len(found.distances) <= 5
    for lag, mean in zip(found.distances, found.means, strict=True):
        along = [
            (z[i - lag, j] - 2 * z[i, j] + z[i + lag, j]) ** 2
            for j in range(64)
            for i in range(lag, 70 - lag)
        ]
        across = [
            (z[i, j - lag] - 2 * z[i, j] + z[i, j + lag]) ** 2
            for i in range(70)
            for j in range(lag, 64 - lag)
        ]
        assert mean == pytest.approx(math.sqrt(np.mean(along) * np.mean(across)))
        assert mean <= 2.5 * z.var()
    assert not len(variogram(HeightMap(z[:12], (1, 1))).distances)


def test_the_study_has_the_dimensions_asked_for():
    path = Path(__file__).parent.parent / "analysis" / "results" / "09_rough_skins.csv"
    with path.open(encoding="utf-8") as file:
        every = list(csv.DictReader(file))
    rows = [row for row in every if row["voxels"] == "256"]
    judged = [row for row in rows if row["bumps"] != "1, outwards"]
    assert {row["dimension"] for row in judged} == {"2.1", "2.2", "2.3"}
    assert max(float(row["worst_error"]) for row in judged) <= 0.05
    assert {row["voxels"] for row in every} == {"128", "192", "256"}
    assert all(row["within_twice"] == "1.00" for row in every if "outwards" not in row["bumps"])
    assert max(abs(float(row["sq_error_percent"])) for row in judged) <= 1


def test_a_map_that_cannot_be_is_refused():
    for heights, spacing in (
        (np.zeros((1, 5)), (1, 1)),
        (np.zeros(7), (1, 1)),
        (np.full((3, 3), np.nan), (1, 1)),
        (np.zeros((3, 3)), (0, 1)),
    ):
        with pytest.raises(GridError, match=r"(heights|spacing): got .*wanted"):
            HeightMap(heights, spacing)
    with pytest.raises(GridError, match=r"face: got 'TOP'"):
        roughness(HeightMap(np.zeros((3, 3)), (1, 1)), "TOP")


# --- heights of grids ----------------------------------------------------------------------


@pytest.mark.parametrize("face", SIDES)
def test_heights_are_those_of_columns(face):
    random = np.random.default_rng(SIDES.index(face))
    fill = random.integers(0, 256, (7, 9, 8)).astype(np.uint8)
    fill[2:5, 3:6, 2:6] = 255
    fill[:, :, 4][fill[:, :, 4] < 128] += 128
    fill[3], fill[:, 4] = np.maximum(fill[3], 128), np.maximum(fill[:, 4], 128)
    grid = po.VoxelGrid(po.Frame((1, 2, 3), (0.5, 0.25, 2.0), fill.shape), fill)
    found = height_map(grid, face)
    assert found.heights == pytest.approx(naive_heights(grid, face), abs=1e-12)
    assert found.spacing == tuple(np.delete(grid.frame.spacing, SIDES.index(face) // 2))
    assert found.doubt == pytest.approx(0.13 * grid.frame.spacing[SIDES.index(face) // 2])


def test_thick_grids_are_read_on_until_every_column_is_met():
    fill = np.zeros((3, 4, 300), np.uint8)
    fill[:, :, :100] = 255
    fill[1, 2, 10:] = 0
    fill[0, 0, 100] = 51
    grid = po.VoxelGrid(po.Frame((0, 0, 0), (1, 1, 0.5), fill.shape), fill, sampling="centre")
    wanted = np.full((3, 4), -100.0)
    wanted[1, 2], wanted[0, 0] = -145.0, -99.9
    found = height_map(grid, "ZMAX")
    assert found.heights == pytest.approx(wanted)
    assert found.doubt == pytest.approx(0.5 * 12**-0.5)
    assert height_map(grid, "ZMIN").heights == pytest.approx(np.zeros((3, 4)))


def test_a_column_without_solid_is_refused():
    fill = np.full((4, 5, 6), 255, np.uint8)
    fill[1, 2] = 0
    grid = po.VoxelGrid(po.Frame((0, 0, 0), (1, 1, 1), fill.shape), fill)
    with pytest.raises(GridError, match="column seen from ZMIN meets no solid; wanted"):
        height_map(grid, "ZMIN")
    within = po.Box((2, 0, 0), (4, 5, 6))
    assert height_map(grid, "ZMIN", within=within).heights.shape == (2, 5)
    with pytest.raises(GridError, match="wanted"):
        height_map(grid, "ZMIN", within=po.Box((8, 8, 8), (9, 9, 9)))
    with pytest.raises(GridError, match="face: got 'zmin'"):
        height_map(grid, "zmin")


@pytest.mark.parametrize("slit", [True, False])
def test_of_a_grid_from_a_file_the_sides_that_are_skins_are_told(slit):
    fill = np.full((40, 44, 48), 255, np.uint8)
    fill[:, :, 44:] = fill[10:20, 10:30, 43:] = 0  # a groove in ZMAX
    fill[38:] = fill[37, 20:, 20:] = 0  # a step in XMAX, in the outer eighth of ZMAX
    if slit:
        fill[:, 7] = 0  # from XMIN to XMAX, and from ZMIN to ZMAX
    grid = po.VoxelGrid(po.Frame((0, 0, 0), (1, 1, 1), fill.shape), fill)
    rows = roughness_of_sides(grid)
    found = {row.name: row.value for row in rows if row.name.startswith("sz")}
    assert found == pytest.approx({} if slit else {"sz_xmax": 1, "sz_zmax": 1})  # others are flat
    assert set(rows.names) <= set(examine(grid).measures.names)
    assert not [name for name in measure(grid).names if name.startswith("sq_")]


def test_what_is_read_at_once_is_bounded_and_changes_nothing(monkeypatch):
    grid = po.voxelize(rough(BLOCK, [skin()]), voxels=40)
    wanted = height_map(grid, "ZMAX")
    monkeypatch.setattr(_roughness, "PATCH", 1000)
    monkeypatch.setattr(_roughness, "LAYERS", 3)
    assert height_map(grid, "ZMAX") == wanted


# --- heights of surfaces -------------------------------------------------------------------


def test_a_tent_is_seen_as_it_is():
    points = np.array([[0, 0, 1], [4, 0, 1], [4, 3, 1], [0, 3, 1], [2, 1.5, 2.5]])
    fan = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    floor = [[0, 2, 1], [0, 3, 2]]
    tent = po.SurfaceMesh(points, np.array(fan + floor), unit="um")
    found = height_map(tent, "ZMAX", columns=8)
    x, y = np.meshgrid(np.arange(8) / 2 + 0.25, np.arange(6) / 2 + 0.25, indexing="ij")
    wanted = -1.5 * np.maximum(np.abs(x - 2) / 2, np.abs(y - 1.5) / 1.5)
    assert found.heights == pytest.approx(wanted, abs=1e-12)
    assert (found.spacing, found.unit, found.doubt) == ((0.5, 0.5), "um", 0.0)
    assert height_map(tent, "ZMIN", columns=9).heights == pytest.approx(0)
    assert all(row.of == "surface" for row in roughness(found, "ZMAX"))
    with pytest.raises(GridError, match="column seen from XMAX meets no solid"):
        height_map(tent, "XMAX")
    with pytest.raises(GridError, match="got 1 columns"):
        height_map(tent, "ZMAX", columns=1)


@pytest.mark.parametrize("face", SIDES)
def test_the_surface_of_a_grid_is_as_rough_as_the_grid(face):
    model = rough((13.0, 11.0, 9.0), [skin(face, 2.3, 0.2, bumps=2, seed=1)])
    grid = po.voxelize(model, voxels=104)
    within = model.rough_faces[face]
    surface = po.extract_surface(grid)
    rows, others = (
        values(height_map(body, face, within=within, columns=104), face) for body in (grid, surface)
    )
    assert rows["sq", "height map"].value == pytest.approx(0.2, rel=0.02)
    for name in ("sa", "sq"):
        # Marching cubes round peaks and pits off.
        wanted = rows[name, "height map"].value
        assert others[name, "height map"].value == pytest.approx(wanted, rel=0.02)


# --- bodies --------------------------------------------------------------------------------


def skin(face="ZMAX", dimension=2.2, amplitude=0.3, **given):
    return Skin(face, dimension, amplitude, **given)


@pytest.mark.parametrize("dimension", [2.1, 2.2, 2.3])
def test_a_block_has_the_skin_asked_for(dimension):
    """Sq within 1 %, the variogram's dimension within 0.05 over 4 to 64 voxels of 256."""
    model = rough((26.0, 26.0, 5.0), [skin(dimension=dimension, seed=1)])
    grid = po.voxelize(model, voxels=256)
    rows = measure(grid, model=model) + measure(model)
    assert rows["dimension_zmax"].value == dimension
    assert rows["dimension_zmax", "variogram"].value == pytest.approx(dimension, abs=0.05)
    assert rows["sq_zmax"].value == 0.3
    assert rows["sq_zmax", "height map"].value == pytest.approx(0.3, rel=0.01)
    assert rows["porosity", "voxel fill"].value == pytest.approx(rows["porosity"].value, abs=1e-4)
    for name in ("components", "euler_number", "genus"):
        assert rows[name, "voxel count"].value == rows[name].value


@settings(max_examples=10)
@given(
    st.lists(st.sampled_from(SIDES), min_size=1, max_size=6, unique=True),
    st.integers(0, 99),
    st.booleans(),
)
def test_the_porosity_of_voxels_is_that_of_the_body(faces, seed, outwards):
    skins = [skin(face, 2.3, 0.2, bumps=2, seed=seed, outwards=outwards) for face in faces]
    model = rough((6.0, 7.0, 8.0), skins)
    exact = {row.name: row.value for row in model.exact()}
    if not outwards and len({face[0] for face in faces}) > 1:
        assert "porosity" not in exact  # pits of two faces may meet
        return
    grid = po.voxelize(model, voxels=48)
    assert po.measures.porosity(grid).value == pytest.approx(exact["porosity"], abs=1e-3)
    assert exact["volume"] == pytest.approx((1 - exact["porosity"]) * 6 * 7 * 8)
    assert po.measures.components(grid).value == 1
    assert po.measures.euler_number(grid).value == 1


def test_no_peak_reaches_beyond_the_box_and_the_highest_nearly_does():
    model = rough(BLOCK, [skin(face, amplitude=0.4, seed=4) for face in SIDES])
    frame = po.Frame.fit(model.domain.grown(0.5), voxels=90)
    solid = model.sample(frame, CENTRE).astype(bool)
    places = np.argwhere(solid) * frame.spacing + frame.origin
    low, high = places.min(axis=0), places.max(axis=0) + frame.spacing
    assert (low >= np.array(model.box.lower) - frame.spacing).all()
    assert (high <= np.array(model.box.upper) + frame.spacing).all()
    assert np.abs(np.r_[low, high - BLOCK]).max() < 0.6


@pytest.mark.parametrize("outwards", [True, False])
def test_rough_faces_meet_along_straight_edges(outwards):
    skins = [skin("ZMAX", seed=1, outwards=outwards), skin("XMIN", 2.4, 0.2, outwards=outwards)]
    model = rough(BLOCK, skins)
    x, z = model.core.lower[0], model.core.upper[2]
    y = np.linspace(0.01, 0.99, 300) * BLOCK[1]
    on, beyond, within = (
        np.stack([np.full(300, x - by), y, np.full(300, z + by)], axis=1) for by in (0, 1e-9, -1e-3)
    )
    assert model.contains(on).all()
    assert not model.contains(beyond).any()
    # Pits begin at the edge; where there are none, all that lies within it is solid.
    assert model.contains(within).all() == outwards
    assert model.contains(within).mean() > 0.1


def test_samples_are_points_of_the_body(monkeypatch):
    monkeypatch.setattr(Relief, "levels", lambda *_: DEEPEST)
    model = rough(BLOCK, [skin(face, 2.3, 0.3, seed=3, bumps=2) for face in SIDES])
    frame = po.Frame.fit(model.domain.grown(0.3), voxels=40)
    masks = model.sample(frame, FILL)
    tile = frame.tile((3, 4, 2), (20, 31, 12))
    assert np.array_equal(model.sample(tile, FILL), masks[3:20, 4:31, 2:12])
    for row, deep in ((0, 0), (5, 3), (15, 2)):
        offset = np.array([*FILL.rows[row], FILL.depths[row, deep]])
        index = np.stack(np.meshgrid(*map(np.arange, frame.shape), indexing="ij"), axis=-1)
        points = (index + offset) * frame.spacing + frame.origin
        wanted = model.contains(points.reshape(-1, 3)).reshape(frame.shape)
        found = masks >> np.uint64(4 * row + deep) & np.uint64(1) == 1
        assert np.array_equal(wanted, found)
        assert 0.5 < wanted.mean() < 1


def test_what_is_left_out_of_heights_is_told():
    model = rough(BLOCK, [skin(face, 2.3, 0.3, bumps=2) for face in SIDES])
    frame = po.Frame.fit(model.domain, voxels=40)
    assert 0 < model.sampling_error(frame) <= 1e-3 * min(frame.spacing)
    finer = po.Frame.fit(model.domain, voxels=400)
    assert model.sampling_error(finer) <= 1e-3 * min(finer.spacing)


def test_a_body_without_skins_is_its_box():
    model = rough(BLOCK, [])
    assert (po.voxelize(model, voxels=13).fill == 255).all()
    assert model.core == model.box


def test_faces_of_one_seed_differ_and_bumps_are_as_long_as_wide():
    model = rough((10.0, 20.0, 10.0), [skin("ZMAX", bumps=3), skin("ZMIN", bumps=3)])
    assert {relief.cells for relief in model.reliefs.values()} == {(3, 6)}
    assert model.reliefs["ZMAX"].seed != model.reliefs["ZMIN"].seed
    assert rough(BLOCK, [skin(seed=1)]) == rough(BLOCK, [skin(seed=1)])
    one, other = (po.voxelize(rough(BLOCK, [skin(seed=s)]), voxels=32).fill for s in (1, 2))
    assert not np.array_equal(one, other)


def test_another_model_is_cut_and_keeps_what_lies_within():
    inner = po.ifs(named("menger"), level=1, size=9.0)
    model = po.rough(inner, [skin("ZMAX", amplitude=0.2, seed=5)])
    assert model.domain == inner.domain
    assert model.exact() == ()
    assert not model.rough_faces
    block = Rough(inner.domain, model.skins)
    frame = po.Frame.fit(model.domain, voxels=27)
    wanted = inner.sample(frame, FILL) & block.sample(frame, FILL)
    assert np.array_equal(model.sample(frame, FILL), wanted)
    points = np.random.default_rng(1).random((500, 3)) * 9
    assert np.array_equal(model.contains(points), inner.contains(points) & block.contains(points))
    bent = po.warp(model, {(1, 1, 1): (0.05, 0, 0)})
    assert 0 < bent.contains(points).mean() < 1


def test_a_model_known_on_lattices_can_be_cut_but_not_warped():
    model = po.rough(po.build(po.load("support-tree")), [skin("ZMIN", amplitude=0.01)])
    with pytest.raises(ModelError, match="CIFS is known on lattices of voxels alone; wanted"):
        po.warp(model, {})


# --- refusals ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"dimension": 2.0}, r"dimension: got 2; wanted one between 2 and 3"),
        ({"dimension": 3.0}, r"dimension: got 3; wanted"),
        ({"dimension": math.nan}, r"dimension: got nan; wanted"),
        ({"amplitude": -0.1}, r"amplitude: got -0\.1; wanted a length above zero"),
        ({"amplitude": 0.0}, r"amplitude: got 0; wanted"),
        ({"amplitude": math.inf}, r"amplitude: got inf; wanted"),
        ({"face": "TOP"}, r"faces: got 'TOP'"),
        ({"face": "ZMAXX"}, r"faces: got 'ZMAXX'.*did you mean 'ZMAX'"),
        ({"face": ["ZMAX"]}, r"face: got \['ZMAX'\]; wanted one of XMIN, .*each face"),
        ({"bumps": 0}, r"bumps: got 0; wanted 1 … 256"),
        ({"bumps": 10**400}, r"bumps: got 1.*; wanted 1 … 256"),
        ({"seed": -1}, r"seed: got -1; wanted a whole number, zero or more"),
    ],
)
def test_skins_that_cannot_be_are_refused(given, says):
    with pytest.raises(ModelError, match=says):
        skin(**given)


def test_skins_that_leave_nothing_of_the_body_are_refused():
    with pytest.raises(ModelError, match=r"amplitude: the skin of ZMAX needs .* mm from .*8,"):
        rough(BLOCK, [skin(amplitude=4.0)])
    thin = [skin("XMIN", amplitude=2.6), skin("XMAX", amplitude=2.6)]
    with pytest.raises(ModelError, match=r"XMIN and XMAX need .*wanted less than 20"):
        rough(BLOCK, thin)
    with pytest.raises(ModelError, match=r"skins: ZMAX is there twice"):
        rough(BLOCK, [skin(), skin()])
    with pytest.raises(ModelError, match=r"size: got .*wanted three lengths"):
        rough((1.0, -2.0, 3.0), [skin()])
    with pytest.raises(ModelError, match=r"bumps: got .*wanted 1 … 256"):
        rough((1.0, 200.0, 3.0), [skin(amplitude=0.001, bumps=4)])
    with pytest.raises(ModelError, match=r"bumps: got 4 along the shorter edge, 4e\+299 along"):
        rough((1e300, 10.0, 10.0), [skin(amplitude=0.001, bumps=4)])
    with pytest.raises(GridError, match="feature"):
        po.voxelize(rough(BLOCK, [skin()]), per_feature=4)


# --- recipes -------------------------------------------------------------------------------

TABLE = {
    "kind": "rough",
    "size": [4.0, 5.0, 6.0],
    "unit": "cm",
    "skins": [
        {"faces": ["ZMAX", "ZMIN"], "dimension": 2.3, "amplitude": 0.1, "bumps": 3, "seed": 9},
        {"faces": ["XMAX"], "dimension": 2.1, "amplitude": 0.2, "outwards": True},
    ],
}
MENGER = {"kind": "ifs", "digits": {"divisions": 3, "keep": "menger"}, "level": 1, "size": 5.0}


def test_a_recipe_makes_what_python_makes(tmp_path):
    recipe = parse({"model": TABLE, "voxels": {"voxels": 20}})
    above = [skin(face, 2.3, 0.1, bumps=3, seed=9) for face in ("ZMAX", "ZMIN")]
    side = skin("XMAX", 2.1, 0.2, outwards=True)
    assert po.build(recipe) == rough((4.0, 5.0, 6.0), [*above, side], unit="cm")
    assert "model_rough" in schema()["$defs"]
    (tmp_path / "again.toml").write_text(dump(recipe))
    assert po.load(tmp_path / "again.toml") == recipe


def test_a_recipe_cuts_another_model():
    table = {"kind": "rough", "model": MENGER, "skins": TABLE["skins"][1:]}
    model = po.build(parse({"model": table, "voxels": {"voxels": 20}}))
    inner = po.ifs(named("menger"), level=1, size=5.0)
    assert model == rough(inner, [skin("XMAX", 2.1, 0.2, outwards=True)])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"dimension": 2.0}, r"dimension: got 2\.0; wanted the box dimension, between 2 and 3"),
        ({"amplitude": -1.0}, r"amplitude: got -1\.0; wanted"),
        ({"faces": ["UP"]}, r"faces.*wanted a list of XMIN, XMAX"),
        ({"faces": []}, r"faces: got \[\]; wanted a list of XMIN, XMAX"),
        ({"bumps": 1.5}, r"bumps: got 1\.5; wanted"),
        ({"sed": 3}, r"sed: unknown key.*seed"),
    ],
)
def test_recipes_that_cannot_be_understood(change, says):
    with pytest.raises(RecipeError, match=says):
        parse({"model": TABLE | {"skins": [TABLE["skins"][0] | change]}})


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"size": None}, "wanted one of size, the edges of a block, and"),
        ({"model": MENGER}, "wanted one of size, the edges of a block, and"),
        ({"size": None, "model": MENGER}, r"unit: \[model\.model\] has its own; wanted none"),
        ({"skins": TABLE["skins"][:1] * 2}, "ZMAX is there twice"),
    ],
)
def test_a_body_that_is_said_twice_or_not_at_all_is_refused(change, says):
    table = {key: value for key, value in (TABLE | change).items() if value is not None}
    with pytest.raises(ModelError, match=says):
        po.build(parse({"model": table}))
