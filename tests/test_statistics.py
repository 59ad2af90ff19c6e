"""Lines, pairs and places: intercepts equal to counting, fabrics one knows, profiles, boxes."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_chords import centres, grid_of, overlapping

from porous.errors import Cancelled, GridError
from porous.kernels.intercepts import changes
from porous.measures import (
    Sample,
    Survey,
    chord_curves,
    chord_lengths,
    correlation_curves,
    fabric,
    intercepts,
    interface_area,
    porosity,
    survey,
    two_point,
)
from porous.measures._surface_area import crofton
from porous.values import Frame, VoxelGrid

ALL = (True, True, True)
NONE = (False, False, False)


# --- lines from voxel to voxel -------------------------------------------------------------


UNKNOWN = 2


def naive_changes(codes, step, periodic):
    """Pairs that differ and all pairs, one by one."""
    differ = known = 0
    for place in np.ndindex(codes.shape):
        there = [p + s for p, s in zip(place, step, strict=True)]
        there = [t % n if w else t for t, n, w in zip(there, codes.shape, periodic, strict=True)]
        if not all(0 <= t < n for t, n in zip(there, codes.shape, strict=True)):
            continue
        one, other = codes[place], codes[tuple(there)]
        if UNKNOWN not in (one, other):
            known += 1
            differ += one != other
    return differ, known


STEPS = np.array([(0, 0, 1), (1, -2, 0), (2, 1, -2), (-2, 2, 1), (0, 0, 6), (4, -6, 6), (0, 3, 0)])


@settings(max_examples=40)
@given(
    st.integers(0, 10**6),
    st.sampled_from([ALL, NONE, (True, False, True), (False, True, False)]),
    st.sampled_from([(3, 4, 5), (2, 3, 63), (3, 2, 64), (2, 2, 65), (1, 2, 130)]),
    st.sampled_from([2, 3]),
)
def test_changes_are_those_that_are_counted(seed, periodic, shape, kinds):
    codes = np.random.default_rng(seed).integers(0, kinds, shape).astype(np.uint8)
    body = codes != UNKNOWN if kinds == 3 else None
    differ, known = changes(codes == 1, body, STEPS, periodic=periodic)
    wanted = [naive_changes(codes, step, periodic) for step in STEPS]
    assert list(zip(differ.tolist(), known.tolist(), strict=True)) == wanted


def rows_of(grid):
    return {row.name: row for row in fabric(intercepts(grid))}


def directed(rows, number):
    return np.array([rows[f"fabric_direction_{number}_{axis}"].value for axis in "xyz"])


def tensor_of(rows, told="value"):
    m = np.zeros((3, 3))
    for a, b in ("xx", "yy", "zz", "yz", "xz", "xy"):
        m["xyz".index(a), "xyz".index(b)] = getattr(rows[f"fabric_tensor_{a}{b}"], told)
    return m + np.triu(m, 1).T


def test_tilted_layers_of_unequal_voxels_are_seen_exactly():
    spacing, turns = np.array((0.5, 0.8, 0.3)), np.array((2, 1, 2))
    x = centres((60, 60, 60)).T.T
    solid = np.tensordot(turns, x, 1) / 60 % 1 < 0.5
    grid = grid_of(solid, tuple(spacing), ALL, "um")
    across = turns / spacing / 60
    rows = rows_of(grid)
    half = 1 / np.linalg.norm(across) / 2
    assert rows["mean_intercept_length_3"].value == pytest.approx(half, rel=1e-9)
    assert rows["mean_intercept_length_3"].uncertainty < 1e-6
    assert rows["mean_intercept_length_3"].unit == "um"
    assert "mean_intercept_length_1" not in rows  # along layers it is infinite
    assert rows["degree_of_anisotropy"].value == pytest.approx(1)
    unit = across / np.linalg.norm(across)
    assert directed(rows, 3) == pytest.approx(unit, abs=1e-6)
    assert tensor_of(rows) == pytest.approx(np.outer(unit, unit), abs=1e-6)
    assert tensor_of(rows, "uncertainty").max() < 1e-6
    assert "fabric_direction_1_x" not in rows  # all directions along layers are alike


def test_tilted_tubes_are_seen_within_the_uncertainty():
    x, y, z = centres((48, 48, 48))
    away = np.hypot(((2 * x - y + 24) % 48 - 24) / math.sqrt(5), z - 24)
    rows = rows_of(grid_of(away < 8.3, periodic=ALL))
    anisotropy = rows["degree_of_anisotropy"]
    assert abs(anisotropy.value - 1) <= anisotropy.uncertainty + 1e-12
    assert anisotropy.uncertainty < 0.03
    axis = directed(rows, 1)
    doubts = [rows[f"fabric_direction_1_{a}"].uncertainty for a in "xyz"]
    wanted = np.array((1, 2, 0)) / math.sqrt(5)
    assert (np.abs(axis - wanted) <= 2 * np.array(doubts) + 1e-9).all()
    assert max(doubts) < 0.03


def stretched(shape, radius, count, along, seed):
    """Balls in random places, stretched along a direction with the space that they lie in."""
    random, reach = np.random.default_rng(seed), math.ceil(1.6 * radius)
    shrink = np.linalg.inv(along)
    solid = np.zeros(shape, bool)
    for place in random.uniform(0, shape, (random.poisson(count), 3)):
        near = [np.arange(int(c) - reach - 1, int(c) + reach + 2) for c in place]
        gaps = np.meshgrid(*(a + 0.5 - c for a, c in zip(near, place, strict=True)), indexing="ij")
        squares = (np.tensordot(shrink, np.array(gaps), 1) ** 2).sum(axis=0)
        wrapped = [a % n for a, n in zip(near, shape, strict=True)]
        solid[np.ix_(*wrapped)] |= squares < radius**2
    return solid


def test_a_stretched_body_has_the_anisotropy_of_its_stretch():
    """Stretched by 3/2, intercepts are so much longer: 1/MIL² is a quadratic form, exactly."""
    axis, shape, radius, eta = np.array((1, 2, 2)) / 3, (80, 84, 88), 4.0, 0.7
    along = np.eye(3) + 0.5 * np.outer(axis, axis)
    count = eta * math.prod(shape) / (4 / 3 * math.pi * radius**3 * 1.5)
    found = [
        rows_of(grid_of(stretched(shape, radius, count, along, s), periodic=ALL)) for s in (1, 2, 3)
    ]
    across = 2 * radius / (3 * eta) / math.exp(-eta)
    known = {
        "mean_intercept_length_1": 1.5 * across,
        "mean_intercept_length_2": across,
        "mean_intercept_length_3": across,
        "degree_of_anisotropy": 1 - 1 / 1.5**2,
    }
    for name, value in known.items():
        assert np.mean([rows[name].value for rows in found]) == pytest.approx(value, rel=0.04)
        assert max(rows[name].uncertainty for rows in found) < 0.05 * value
    for rows in found:
        assert directed(rows, 1) == pytest.approx(axis, abs=0.03)
    wanted = np.eye(3) - (1 - 1 / 1.5**2) * np.outer(axis, axis)
    wanted /= np.trace(wanted)
    for rows in found:
        assert np.trace(tensor_of(rows)) == pytest.approx(1)
        off = np.abs(tensor_of(rows) - wanted)
        assert off.max() < 0.02
        assert tensor_of(rows, "uncertainty").max() < 0.02


@pytest.mark.parametrize("radius", [3, 5, 8])
def test_noise_alone_is_within_the_uncertainty_of_the_anisotropy(radius):
    """A ball is the same in all directions; where it lies among the voxels is not."""
    for place in np.random.default_rng(radius).random((4, 3)):
        x = centres((2 * radius + 12,) * 3) - (radius + 6 + place)[:, None, None, None]
        rows = rows_of(grid_of((x**2).sum(axis=0) < radius**2, periodic=ALL))
        row = rows["degree_of_anisotropy"]
        assert row.value <= 2 * row.uncertainty
        assert row.uncertainty < 2 / radius**1.5
        off = np.abs(tensor_of(rows) - np.eye(3) / 3)
        assert (off < 3 * tensor_of(rows, "uncertainty")).all()


def test_cubic_bodies_have_no_direction_and_turned_ones_the_same_numbers():
    x = centres((40, 40, 40)) * 2 * np.pi / 40
    rows = rows_of(grid_of(np.cos(x).sum(axis=0) > 0.3, periodic=ALL))
    assert rows["degree_of_anisotropy"].value == pytest.approx(0, abs=1e-12)
    assert not any(name.startswith("fabric_direction") for name in rows)
    solid, _ = overlapping((30, 36, 44), 4.0, 60, 3)
    solid[:, ::6] = True
    one = rows_of(grid_of(solid, (1, 0.7, 1.2), ALL))
    turned = rows_of(grid_of(solid.transpose(2, 0, 1), (1.2, 1, 0.7), ALL))
    for name in ("mean_intercept_length_3", "degree_of_anisotropy"):
        assert turned[name].value == pytest.approx(one[name].value, rel=1e-9)
    assert tensor_of(turned) == pytest.approx(
        tensor_of(one)[np.ix_((2, 0, 1), (2, 0, 1))], abs=1e-9
    )
    assert directed(turned, 3) == pytest.approx(directed(one, 3)[[2, 0, 1]], abs=1e-9)
    assert abs(directed(one, 3)[1]) > 0.99


def test_crossings_of_a_gyroid_are_right_within_half_a_percent():
    """Of 49 directions the mean is a fifth of a percent off, however fine the voxels are."""
    doubts = []
    for n in (24, 48, 96):
        x, y, z = 2 * np.pi * centres((n, n, n)) / n
        level = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
        mean, doubt = intercepts(grid_of(level > 0, (1 / n,) * 3, ALL)).mean
        assert 2 * mean == pytest.approx(3.09164, rel=0.005)
        assert abs(2 * mean - 3.09164) <= 2 * doubt
        doubts.append(2 * doubt / 3.09164)
    assert 0.05 > doubts[0] > doubts[1] > doubts[2] > 0.002


def test_what_intercepts_cannot_be_of():
    with pytest.raises(GridError, match=r"wanted 8 along each edge"):
        intercepts(grid_of(np.indices((7, 9, 9)).sum(axis=0) % 2 == 0))
    with pytest.raises(GridError, match="one phase only"):
        intercepts(grid_of(np.ones((8, 9, 9), bool)))
    found = intercepts(grid_of(np.indices((8, 9, 10)).sum(axis=0) % 5 == 0))
    assert pickle.loads(pickle.dumps(found)) == found
    with pytest.raises(GridError, match=r"wanted \(m, 3\)"):
        replace(found, weights=[1.0])

    def stop(*_):
        raise Cancelled("enough")

    with pytest.raises(Cancelled):
        intercepts(grid_of(np.ones((8, 9, 9), bool)), progress=stop)


# --- the family ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def body():
    solid, _ = overlapping((48, 52, 56), 5.0, 190, 5)
    return grid_of(solid, (0.2, 0.2, 0.2), ALL, "cm")


@pytest.fixture(scope="module")
def found(body):
    return survey(body, only=["statistics"])


def test_chords_and_areas_by_all_methods_agree(body, found):
    for prefix in ("pore", "wall"):
        crofton = found.measures[f"{prefix}_chord_mean", "crofton"]
        lines = found.measures[f"{prefix}_chord_mean", "lattice lines"]
        axes = [found.measures[f"{prefix}_chord_mean_{axis}"] for axis in "xyz"]
        assert abs(crofton.value - lines.value) <= crofton.uncertainty + lines.uncertainty
        along = 3 / sum(1 / row.value for row in axes)  # as lines of all three axes have it
        doubt = max(row.uncertainty for row in axes)
        assert abs(along - lines.value) <= 2 * doubt < 0.2 * along
    area, other = found.measures["interface_area"], interface_area(body)
    assert (area.method, area.unit, other.method) == ("lattice lines", "cm²", "crofton")
    assert abs(area.value - other.value) <= area.uncertainty + other.uncertainty
    assert area.uncertainty < 0.03 * area.value


def test_each_curve_is_what_it_says(body, found):
    curves = {(curve.name, curve.series): curve for curve in found.curves}
    assert len(curves) == len(found.curves)
    share = porosity(body, method="voxel count").value
    for axis in "xyz":
        chords = curves["pore_chord_distribution", f"along {axis}"]
        assert np.diff(chords.x) @ chords.y[:-1] == pytest.approx(1)
        assert curves["pore_lineal_path", f"along {axis}"].y[0] == pytest.approx(share)
        assert curves["two_point_correlation", f"along {axis}"].y[0] == pytest.approx(share)
        layers = curves["porosity_profile", f"along {axis}"]
        assert layers.y.mean() == pytest.approx(share)
    slope = curves["two_point_correlation", "slope by the surface"]
    steep = (slope.y[1] - slope.y[0]) / (slope.x[1] - slope.x[0])
    area = found.measures["interface_area", "lattice lines"].value / body.frame.box.volume
    assert steep == pytest.approx(-area / 4)
    first = curves["two_point_correlation", "all directions"]
    # It bends upwards from there on (balls overlap in creases), and never lies below.
    assert (first.y[1:4] > slope.y[0] + steep * first.x[1:4]).all()
    rose = curves["mean_intercept_length", "in the xy plane"]
    assert len(rose.x) == 8
    assert rose.y[0] == pytest.approx(1 / intercepts(body).crossings[_along(body, (1, 0, 0))])


def _along(body, direction):
    return int(np.argmax(intercepts(body).directions @ direction))


def test_bins_of_chords_are_as_wide_as_a_voxel_or_few():
    solid = np.zeros((400, 8, 8), bool)
    solid[::4] = True
    solid[100:300] = False
    lengths = chord_lengths(grid_of(solid, (0.1, 1, 1), ALL))
    (curve, *_) = (c for c in chord_curves(lengths) if c.name == "pore_chord_distribution")
    # Chords of 3 voxels, and one of 203, in bins of six: from half a voxel on.
    assert np.diff(curve.x) == pytest.approx(np.full(len(curve.x) - 1, 0.6))
    told = curve.y[:-1] * 0.6
    assert curve.x[0] == pytest.approx(0.05)
    assert told[[0, -1]] == pytest.approx([49 / 50, 1 / 50])
    assert curve.x[-2] < 20.3 < curve.x[-1]


def test_profiles_follow_what_changes_along_an_axis():
    frame = Frame((1, 2, 3), (0.5, 0.25, 1), (10, 12, 14))
    fill = np.broadcast_to((np.arange(12) * 20)[:, None], (10, 12, 14)).astype(np.uint8)
    grid = VoxelGrid(frame, fill, sampling="centre")
    x, y, z = (c for c in survey(grid, only=["statistics"]).curves if c.name == "porosity_profile")
    assert y.y == pytest.approx(1 - np.arange(12) * 20 / 255)
    assert y.x.tolist() == frame.centres(1).tolist()
    assert np.ptp(x.y) < 1e-12 > np.ptp(z.y)
    bulk = np.zeros(frame.shape, np.uint8)
    bulk[:, 3:9] = 255
    (x, y, _) = (
        c
        for c in survey(replace(grid, bulk=bulk), only=["statistics"]).curves
        if c.name == "porosity_profile"
    )
    assert y.x.tolist() == frame.centres(1)[3:9].tolist()
    assert x.y == pytest.approx(np.full(10, 1 - np.arange(3, 9).mean() * 20 / 255))


@pytest.mark.parametrize("solid", [False, True])
def test_a_grid_without_bulk_has_no_profile(solid):
    grid = grid_of(np.full((12, 13, 14), solid))
    found = survey(replace(grid, bulk=np.zeros_like(grid.fill)), only=["statistics"])
    assert not [curve for curve in found.curves if curve.name == "porosity_profile"]
    assert not [row for row in found.measures if row.name.startswith(("pore", "material"))]


def boxes(grid, name="representative_volume"):
    curves = [c for c in survey(grid, only=["statistics"]).curves if c.name == name]
    return curves[0] if curves else None


def test_boxes_of_noise_differ_by_the_root_of_their_volume():
    solid = np.random.default_rng(1).random((96, 96, 100)) < 0.4
    curve = boxes(grid_of(solid, (0.5, 0.5, 0.5)))
    assert curve.x.tolist() == [0.5 * 4 * k for k in (1, 2, 3, 4, 6, 8, 12)]
    spread = (curve.high - curve.low) / 2
    voxels = (curve.x / 0.5) ** 3
    assert (spread * np.sqrt(voxels))[:5] == pytest.approx(math.sqrt(0.4 * 0.6), rel=0.12)
    assert curve.y[0] == pytest.approx(1 - solid.mean())
    surface = boxes(grid_of(solid, (0.5, 0.5, 0.5)), "representative_surface")
    rule = crofton((0.5, 0.5, 0.5))
    assert surface.y[0] == pytest.approx(
        4 * 0.4 * 0.6 * rule.weights @ (1 / rule.lengths), rel=0.01
    )


def test_boxes_of_whole_periods_are_alike():
    x = centres((96, 96, 96)) * 2 * np.pi / 24
    curve = boxes(grid_of(np.cos(x).sum(axis=0) > 0.5, periodic=ALL))
    spread = (curve.high - curve.low) / 2
    at = dict(zip(curve.x.tolist(), spread.tolist(), strict=True))
    assert at[24.0] < 1e-12 > at[48.0]
    assert at[4.0] > 0.2
    surface = boxes(grid_of(np.cos(x).sum(axis=0) > 0.5, periodic=ALL), "representative_surface")
    assert (surface.high - surface.low)[surface.x == 24] < 1e-12
    assert np.ptp(surface.y) < 1e-12


def test_boxes_that_are_not_all_bulk_are_left_out():
    solid = np.zeros((48, 48, 48), bool)
    solid[:24] = True
    bulk = np.full(solid.shape, 255, np.uint8)
    bulk[:24] = 0
    curve = boxes(replace(grid_of(solid), bulk=bulk))
    assert set(curve.y.tolist()) == {1.0}
    assert curve.x[-1] == 16  # 3 × 3 of those in the upper half; of 24 there are but 4
    assert boxes(grid_of(solid[:11])) is None


def test_samples_of_something_larger_say_so(body):
    cut = replace(body, frame=replace(body.frame, periodic=NONE))
    rows = survey(cut, how=Survey(beyond="unknown"), only=["statistics"]).measures
    names = ("porosity", "specific_surface", "pore_chord_mean", "wall_chord_mean")
    for name in (*names, *(f"mean_intercept_length_{place}" for place in (1, 2, 3))):
        row = rows[f"material_{name}"]
        assert 0 < row.uncertainty < 0.2 * row.value
        assert row.method == "blocks"
    assert "material_porosity" not in survey(cut, only=["statistics"]).measures
    # Solid that does not end at the sides has chords by lines as well.
    lines = rows["wall_chord_mean", "lattice lines"]
    assert abs(lines.value - rows["wall_chord_mean", "crofton"].value) < lines.uncertainty * 3


def test_samples_of_balls_at_random_tell_what_all_of_them_are():
    """Six samples that know nothing of each other: one of them may be off by 2σ."""
    radius, eta = 4.0, math.log(2)
    solid, _ = overlapping((96, 96, 144), radius, eta * 96 * 96 * 144 / (4 / 3 * math.pi * 64), 7)
    surface = 3 * eta / radius / 2
    known = {
        "porosity": 0.5,
        "specific_surface": surface,
        "pore_chord_mean": 2 / surface,
        "wall_chord_mean": 2 / surface,
        "mean_intercept_length_1": 2 / surface,
        "mean_intercept_length_3": 2 / surface,
        "degree_of_anisotropy": 0.0,
    }
    rows = []
    for x, y, z in ((0, 0, 0), (48, 0, 48), (0, 48, 96), (48, 48, 0), (0, 0, 96), (48, 0, 0)):
        part = grid_of(solid[x : x + 48, y : y + 48, z : z + 48])
        rows.append(survey(part, how=Survey(beyond="unknown"), only=["statistics"]).measures)
    for name, value in known.items():
        off = [
            (told[f"material_{name}"].value - value) / told[f"material_{name}"].uncertainty
            for told in rows
        ]
        assert sum(abs(z) > 2 for z in off) <= 1, name
    surfaces = [told["material_specific_surface"] for told in rows]
    assert max(row.uncertainty / row.value for row in surfaces) < 0.06
    assert np.std([row.value for row in surfaces]) < 2 * min(row.uncertainty for row in surfaces)


def test_blocks_too_short_for_their_correlation_tell_no_error():
    solid, _ = overlapping((24, 25, 26), 5.0, 24, 2)
    rows = survey(grid_of(solid), how=Survey(beyond="unknown"), only=["statistics"]).measures
    assert math.isinf(rows["material_specific_surface"].uncertainty)
    assert math.isinf(rows["material_degree_of_anisotropy"].uncertainty)


def test_larger_grids_are_looked_at_with_fewer_voxels(body, monkeypatch):
    from porous.measures import _statistics

    monkeypatch.setattr(_statistics, "MOST", 30**3)
    found = survey(body, only=["statistics"])
    (note,) = found.notes
    assert note.startswith("Pairs of points and boxes were looked at on 24 × 26 × 28 voxels, each")
    curves = correlation_curves(two_point(Sample(body).coarse.grid, longest=48 * 0.2 / 3))
    (told,) = (c for c in found.curves if c.series == "all directions")
    assert told == curves[0]


@settings(max_examples=25)
@given(
    st.integers(0, 10**6),
    st.tuples(*(st.sampled_from([1, 2, 5, 8, 9, 16]),) * 3),
    st.sampled_from([ALL, NONE, (True, False, True)]),
    st.sampled_from(["void", "unknown"]),
    st.sampled_from([0.0, 0.02, 0.5, 0.98, 1.0]),
    st.booleans(),
)
def test_any_body_gives_numbers_or_none(seed, shape, periodic, beyond, share, has_bulk):
    random = np.random.default_rng(seed)
    grid = grid_of(random.random(shape) < share, (1.0, 0.7, 1.3), periodic)
    if has_bulk:
        bulk = np.full(shape, 255, np.uint8)
        bulk[: shape[0] // 2] = 0
        grid = replace(grid, bulk=bulk)
    found = survey(grid, how=Survey(beyond=beyond), only=["sizes", "statistics"])
    for row in found.measures:
        assert not math.isnan(row.value), row
        assert not math.isnan(row.uncertainty), row
    assert len({(row.name, row.method) for row in found.measures}) == len(found.measures)
    for curve in found.curves:
        for numbers in (curve.x, curve.y, curve.low, curve.high):
            assert numbers is None or np.isfinite(numbers).all(), curve.name
    assert len({(curve.name, curve.series) for curve in found.curves}) == len(found.curves)
