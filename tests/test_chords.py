"""Chords and lineal paths: equal to counting by hand, and Cauchy's mean of four volumes by area."""

import math
import pickle
from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from porous.errors import GridError
from porous.measures import chord_lengths, chords, pore_chord_mean, wall_chord_mean
from porous.values import Frame, VoxelGrid

PERIODS = [(False, False, False), (True, True, True), (False, True, False)]


def grid_of(solid, spacing=(1.0, 1.0, 1.0), periodic=(False, False, False), unit="mm"):
    return VoxelGrid.of_solid(solid, Frame((0, 0, 0), spacing, solid.shape, periodic, unit))


def naive_line(line, wraps, beyond):
    """Lengths of the chords of a line of codes, with how many of their ends are cut."""
    line = [int(code) for code in line]
    if wraps:
        if set(line) == {1}:
            return [(len(line), None)]
        first = next(k for k, code in enumerate(line) if code != 1)
        line = line[first:] + line[: first + 1]
    else:
        line = [beyond, *line, beyond]
    found, place = [], 0
    for code, run in groupby(line):
        length = len(list(run))
        if code == 1:
            found.append((length, (line[place - 1] == 2) + (line[place + length] == 2)))
        place += length
    return found


@given(st.integers(0, 10**6), st.sampled_from(PERIODS), st.booleans(), st.sampled_from((0.3, 0.9)))
def test_chords_are_those_that_are_counted(seed, periodic, has_bulk, share):
    random = np.random.default_rng(seed)
    solid = random.random((5, 6, 4)) < share
    body = random.random(solid.shape) < 0.8
    grid = grid_of(solid, (1.0, 2.0, 0.5), periodic)
    if has_bulk:
        grid = replace(grid, bulk=np.where(body, 255, 0).astype(np.uint8))
    if not (~solid & body).any() or not solid.any():
        return
    for phase, beyond in (("pore", "void"), ("solid", "void"), ("solid", "unknown")):
        codes = (solid == (phase == "solid")).astype(int)
        if has_bulk and phase == "pore":
            codes[~body] = 2
        side = 0 if (phase, beyond) == ("solid", "void") else 2
        found = chord_lengths(grid, phase=phase, beyond=beyond)
        for axis, along in enumerate(found.axes):
            lines = np.moveaxis(codes, axis, -1).reshape(-1, codes.shape[axis])
            wanted = [c for line in lines for c in naive_line(line, periodic[axis], side)]
            n = codes.shape[axis] + 1
            whole = np.bincount([length for length, cuts in wanted if cuts == 0], minlength=n)
            cut = np.bincount([length for length, cuts in wanted if cuts], minlength=n)
            assert along.whole.tolist() == whole.tolist()
            assert along.cut.tolist() == cut.tolist()
            assert along.ends == sum(2 - cuts for _, cuts in wanted if cuts is not None)
            assert along.endless == sum(cuts is None for _, cuts in wanted)
            assert along.total == pytest.approx((codes == 1).sum() * grid.frame.spacing[axis])
            assert_lineal_path(along.lineal_path, lines, periodic[axis])


def assert_lineal_path(path, lines, wraps):
    for m, value in enumerate(path.values, 1):
        inside = known = 0
        for line in lines:
            n = len(line)
            for start in range(n if wraps else n - m + 1):
                segment = [line[(start + k) % n] for k in range(m)]
                known += 2 not in segment
                inside += set(segment) == {1}
        assert value == pytest.approx(inside / known)


def centres(shape):
    return np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in shape), indexing="ij"))


def test_layers_have_chords_as_long_as_they_are_thick():
    solid = np.zeros((10, 6, 7), bool)
    solid[2:6] = True
    grid = grid_of(solid, (0.5, 1, 1), (True, True, True), "um")
    wall, pore = (chord_lengths(grid, phase=phase) for phase in ("solid", "pore"))
    rows = [*chords(wall), *chords(pore)]
    assert [row.name for row in rows] == [
        *(f"wall_chord_mean_{axis}" for axis in "xyz"),
        *(f"pore_chord_mean_{axis}" for axis in "xyz"),
    ]
    assert [row.value for row in rows] == [2, math.inf, math.inf, 3, math.inf, math.inf]
    assert [math.isinf(row.uncertainty) for row in rows] == [False, True, True] * 2
    assert {row.unit for row in rows} == {"um"}
    assert wall.axes[1].lineal_path.values.tolist() == pytest.approx([0.4] * 6)
    assert wall.axes[0].lineal_path.values[:5].tolist() == pytest.approx([0.4, 0.3, 0.2, 0.1, 0])
    assert pickle.loads(pickle.dumps(wall)) == wall


def test_chords_of_balls_are_four_thirds_of_the_radius():
    for radius in (5.3, 10.2, 19.7):
        n = int(2 * radius) + 6
        x = centres((n, n + 1, n + 2)) - (n / 2 + np.array([0.1, 0.7, 0.3]))[:, None, None, None]
        grid = grid_of((x**2).sum(axis=0) < radius**2, (0.3,) * 3)
        exact = 4 / 3 * radius * 0.3
        for row in chords(chord_lengths(grid, phase="solid")):
            assert abs(row.value - exact) < 2 * row.uncertainty < 0.3 * exact
        mean = wall_chord_mean(grid)
        assert abs(mean.value - exact) < mean.uncertainty < 0.2 * exact
        assert (mean.method, mean.unit, mean.of) == ("crofton", "mm", "grid")


@pytest.mark.parametrize("wraps", [False, True])
@pytest.mark.parametrize("shape", [(9, 8, 7), (1, 2, 3), (12, 11, 10)])
def test_chords_and_their_doubts_are_the_same_whichever_way_round(wraps, shape):
    solid = np.random.default_rng(3).random(shape) < 0.6
    solid.flat[:2] = True, False

    def taken(solid, phase):
        rows = chords(chord_lengths(grid_of(solid, periodic=(wraps,) * 3), phase=phase))
        return [number for row in rows for number in (row.value, row.uncertainty)]

    for phase in ("pore", "solid"):
        for axes in ((0,), (1,), (2,), (0, 1, 2)):
            assert taken(np.flip(solid, axes), phase) == pytest.approx(taken(solid, phase))
    if wraps:
        assert taken(np.roll(solid, 1, (0, 1, 2)), "pore") == pytest.approx(taken(solid, "pore"))


def test_a_single_voxel_is_as_doubtful_along_each_axis():
    solid = np.zeros((16, 16, 16), bool)
    solid[7, 8, 9] = True
    for wraps in (True, False):
        rows = chords(chord_lengths(grid_of(solid, periodic=(wraps,) * 3), phase="solid"))
        assert [(row.value, row.uncertainty) for row in rows] == [(1, 2)] * 3


def test_the_skin_of_a_block_makes_chords_of_its_pores_no_more_doubtful():
    x = centres((48, 50, 52)) - 25.1
    solid = (x**2).sum(axis=0) >= 10**2
    for wraps in (True, False):
        row = pore_chord_mean(grid_of(solid, periodic=(wraps,) * 3))
        assert abs(row.value - 40 / 3) < row.uncertainty < 0.2 * row.value


def overlapping(shape, radius, count, seed):
    """A Boolean model of balls in a periodic box, and its η and number of balls."""
    random, solid = np.random.default_rng(seed), np.zeros(shape, bool)
    reach = math.ceil(radius)
    for place in random.uniform(0, shape, (random.poisson(count), 3)):
        near = [np.arange(int(c) - reach - 1, int(c) + reach + 2) for c in place]
        gaps = np.meshgrid(*(a + 0.5 - c for a, c in zip(near, place, strict=True)), indexing="ij")
        wrapped = [a % n for a, n in zip(near, shape, strict=True)]
        solid[np.ix_(*wrapped)] |= sum(gap**2 for gap in gaps) < radius**2
    return solid, 4 / 3 * math.pi * radius**3 * count / math.prod(shape)


def test_four_volumes_by_area_of_a_gyroid():
    n = 60
    x, y, z = 2 * np.pi * centres((n, n, n)) / n
    level = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
    grid = grid_of(level > 0, (1 / n,) * 3, (True, True, True))
    for row in (pore_chord_mean(grid), wall_chord_mean(grid)):
        assert row.value == pytest.approx(4 * 0.5 / 3.0916, abs=row.uncertainty)
        assert row.uncertainty < 0.05


def test_pores_cut_by_sides_are_no_shorter_for_it():
    solid, _ = overlapping((60, 62, 64), 6.0, 180, 3)
    around, cut = (grid_of(solid, periodic=(wraps,) * 3) for wraps in (True, False))
    for whole, parts in zip(chord_lengths(around).axes, chord_lengths(cut).axes, strict=True):
        assert parts.mean == pytest.approx(whole.mean, rel=0.03)
        assert parts.cut.sum() > 0 == whole.cut.sum()
        kept = parts.lengths @ parts.whole / parts.whole.sum()
        assert kept < parts.mean


def test_wrong_wishes_are_refused():
    grid = grid_of(np.ones((4, 5, 6), bool))
    with pytest.raises(GridError, match="chord lengths: the grid has no pore voxel"):
        chord_lengths(grid)
    with pytest.raises(GridError, match="pore_chord_mean: got volume 0 and area 0"):
        pore_chord_mean(grid)
    with pytest.raises(GridError, match="the bulk is not the grid's box"):
        pore_chord_mean(replace(grid, bulk=np.pad(grid.fill[1:], ((1, 0), (0, 0), (0, 0)))))
    along = chord_lengths(grid, phase="solid").axes[0]
    with pytest.raises(GridError, match=r"wanted n \+ 1, n \+ 1 and n"):
        replace(along, cut=[0])
