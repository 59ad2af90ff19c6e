"""Cells of a level that differ: words whose cells coincide are drawn once, and nothing is lost."""

import itertools
import math

import numpy as np
import pytest

import porous as po
from porous import memory
from porous.errors import MemoryLimitError, ModelError
from porous.models import distinct, features
from porous.models.automaton import (
    Automaton,
    State,
    Transition,
    cells,
    count_cells,
    frames,
    of_maps,
    words,
)
from porous.models.cifs import cifs
from porous.models.digits import named
from porous.models.distinct import SAME, count_distinct, cut_set, distinct_cells, merged
from porous.models.drawing import body, sticks
from porous.models.pieces import Pieces
from porous.models.primitive import named as solid
from porous.values import FILL, Box, Frame

STEPS = [(np.eye(3) / 2, np.array(d) / 4) for d in itertools.product(range(3), repeat=3)]
"""27 maps x/2 + d/4: words are whole numbers below 2ⁿ⁺¹ − 1 along each axis, 27ⁿ words of them."""


def turned(angle, ratio, axis=2):
    c, s = math.cos(angle), math.sin(angle)
    turn = np.eye(3)
    turn[np.ix_(*[[a for a in range(3) if a != axis]] * 2)] = [[c, -s], [s, c]]
    return turn * ratio


COMMUTING = [(turned(t, r), np.zeros(3)) for t, r in ((0.3, 0.8), (1.1, 0.7), (2.9, 0.6))]
"""Maps that commute but for rounding: a word is how often each letter stands in it."""


def frame(box=None, voxels=23):
    box = box or Box((-0.03, -0.11, -0.07), (1.04, 1.02, 1.09))
    first = Frame.fit(box, voxels=voxels)
    return Frame(first.origin, tuple(np.array(first.spacing) * [1, 1.07, 0.93]), first.shape)


def total(groups):
    return sum(len(group.place) for group in groups)


@pytest.mark.parametrize("level", range(5))
def test_words_of_steps_are_whole_numbers(level):
    automaton = of_maps(STEPS)
    groups, births = distinct_cells(automaton, level)
    assert total(groups) == (2 ** (level + 1) - 1) ** 3
    assert (births == level).all()
    placed = frames(automaton, groups)
    found = {tuple(row) for row in (placed[:, :, 3] * 2 ** (level + 1)).tolist()}
    assert found == set(itertools.product(range(2 ** (level + 1) - 1), repeat=3))


@pytest.mark.parametrize("level", [2, 4, 6])
def test_words_of_maps_that_commute_are_multisets_in_spite_of_rounding(level):
    groups, _ = distinct_cells(of_maps(COMMUTING), level)
    assert total(groups) == math.comb(level + 2, 2)


def random_system(seed):
    """Two states, maps that commute, repeat and end, and one that does neither."""
    rng = np.random.default_rng(seed)
    T = [of_maps([pair]).transitions[0].matrix for pair in COMMUTING[:2]]
    other = of_maps([(turned(0.7, 0.5, 0), rng.uniform(-0.2, 0.2, 3))]).transitions[0].matrix
    state = of_maps(COMMUTING).states[0]
    kinds = [State(name, state.controls) for name in ("a", "b", "end")]
    ends = [(0, 0, T[0]), (0, 0, T[1]), (0, 1, T[0]), (1, 0, T[1]), (0, 0, T[0]), (1, 1, other)]
    ends += [(0, 2, T[1]), (1, 2, T[1])]
    return Automaton(kinds, [Transition(*e) for e in (ends[i] for i in rng.permutation(len(ends)))])


@pytest.mark.parametrize("seed", range(3))
def test_each_word_has_one_cell_within_its_reach(seed):
    automaton, level = random_system(seed), 5
    groups, births = distinct_cells(automaton, level)
    ended = (words(automaton, level) >= 0).sum(axis=1)
    reach = level * 5 * SAME
    assert total(groups) < 0.3 * count_cells(automaton, level)
    for every in cells(automaton, level):
        (own,) = [group for group in groups if group.state == every.state]
        apart = np.abs(every.points[:, None] - own.points[None]).max(axis=(2, 3))
        apart[ended[every.place][:, None] != births[own.place][None]] = np.inf
        assert (apart.min(axis=1) <= reach).all()
        # What differs is kept: no two of the kept ones are one.
        assert ((apart <= 1e-9).sum(axis=1) == 1).all()
    assert sorted(np.concatenate([g.place for g in groups])) == list(range(total(groups)))


@pytest.mark.parametrize(("gap", "cells_left"), [(0.4 * SAME, 1), (3 * SAME, 2), (1e-9, 2)])
def test_cells_that_differ_by_more_than_rounding_are_kept(gap, cells_left):
    half = np.eye(3) / 2
    automaton = of_maps([(half, np.zeros(3)), (half, np.array([0, gap, 0]))])
    assert total(distinct_cells(automaton, 1)[0]) == cells_left


def test_equal_keys_alone_do_not_make_cells_one(monkeypatch):
    # With a mixture of zeros every cell has the same key; only the first one's twins are merged.
    class Zeros:
        def uniform(self, *given):
            return np.zeros(given[-1])

    automaton = of_maps(STEPS)
    groups = cells(automaton, 2)
    monkeypatch.setattr(distinct.np.random, "default_rng", lambda _: Zeros())
    left, kept = merged(automaton, groups)
    assert {tuple(p.ravel()) for p in left[0].points} == {
        tuple(p.ravel()) for p in groups[0].points
    }
    assert len(kept) > 343


def test_order_is_that_of_the_words_and_does_not_change_the_cells():
    automaton = of_maps(STEPS)
    (own,), _ = distinct_cells(automaton, 3)
    (every,) = cells(automaton, 3)
    first = np.sort(np.unique(every.points.reshape(-1, 12), axis=0, return_index=True)[1])
    assert np.array_equal(own.points, every.points[first])
    (other,), _ = distinct_cells(of_maps(STEPS[::-1]), 3)
    assert np.array_equal(*(np.unique(g.points.reshape(-1, 12), axis=0) for g in (own, other)))


def test_where_none_coincide_nothing_changes():
    automaton = of_maps([(turned(k, 0.4, k % 3), np.array([k, k**2, 0]) / 9) for k in range(4)])
    for plain, own in zip(cells(automaton, 4), distinct_cells(automaton, 4)[0], strict=True):
        assert np.array_equal(plain.place, own.place)
        assert np.array_equal(plain.points, own.points)


@pytest.mark.parametrize("name", ["cube", "ball", "octahedron"])
@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_the_body_is_that_of_all_words(name, offset):
    maps = [*STEPS[:9], (turned(0.4, 0.5), np.array([0.3, 0.1, 0.2])), STEPS[3], STEPS[20]]
    made = po.ifs(maps, level=3, primitive=name, offset=offset)
    automaton = of_maps(maps)
    every = Pieces(solid(name), frames(automaton, cells(automaton, 3)), offset)
    assert len(made.frames()) < 0.5 * len(every.frames)
    here = frame(made.domain)
    assert np.array_equal(made.sample(here, FILL), every.sample(here, FILL))
    marks, bound = made.cover(here)
    assert np.array_equal(marks, every.cover(here)[0])
    assert bound == every.cover(here)[1]


def test_drawings_are_those_of_all_words_with_the_radii_of_their_birth():
    automaton = random_system(1)
    drawings = ["none", "none", sticks(4, beams="edges", balls="all", radius=[1, 0.2, 0.1, 0.02])]
    made = cifs(automaton, drawings, level=4)
    births = (words(automaton, 4) >= 0).sum(axis=1)
    every = body(made.drawings, cells(automaton, 4), births)
    assert len(made.body.parts[0].capsules) < 0.7 * len(every.parts[0].capsules)
    here = frame(made.domain)
    assert np.array_equal(made.sample(here, FILL), every.sample(here, FILL))
    assert np.array_equal(made.cover(here)[0], every.cover(here)[0])


def test_what_is_known_exactly_is_of_the_body():
    # A map given twice is given once: nothing is counted twice, or nothing is known.
    (once,) = [po.ifs(STEPS[::2], level=2)]
    twice = po.ifs([*STEPS[::2], STEPS[0]], level=2)
    rows = {row.name: row.value for row in once.exact()}
    assert all(rows.get(row.name) == row.value for row in twice.exact())
    assert twice.smallest_feature() == once.smallest_feature() == 0.25


def test_deep_levels_are_refused_by_what_differs(monkeypatch):
    automaton = of_maps(STEPS)
    monkeypatch.setattr(memory, "available", lambda: 10**8)
    assert count_cells(automaton, 4) * 300 > 10**8
    assert total(distinct_cells(automaton, 3)[0]) == 3375
    assert total(distinct_cells(of_maps(COMMUTING), 40)[0]) == math.comb(42, 2)
    with pytest.raises(MemoryLimitError, match=r"level 9 \(\d+ cells\) would need"):
        distinct_cells(automaton, 9)
    # Where no words coincide all are counted before there is one.
    with pytest.raises(MemoryLimitError, match=rf"level 40 \({20**40} cells\) would need"):
        distinct_cells(of_maps(named("menger").maps), 40)
    with pytest.raises(ModelError, match="-1"):
        distinct_cells(automaton, -1)


def test_counts_are_of_what_differs_as_far_as_one_looks():
    automaton = of_maps(STEPS)
    for level in range(5):
        assert count_distinct(automaton, level, 10**5) == (2 ** (level + 1) - 1) ** 3
    assert count_distinct(automaton, 4, 10**4) == 3375 * 27
    assert count_distinct(automaton, 50, 10**4) == 3375 * 27**47
    assert count_distinct(of_maps(named("menger").maps), 30, 1000) == 20**30
    mixed = random_system(0)
    assert count_distinct(mixed, 5, 10**6) == total(distinct_cells(mixed, 5)[0])


def test_the_thinnest_cell_of_a_deep_level_is_found_among_those_that_differ(monkeypatch):
    # No similarities: fifteen levels are 14 million words, of which 136 differ. A quarter turn that
    # squeezes by 0.7 and 0.9 squeezes both ways alike when done twice.
    B = np.array([[0, -0.7, 0], [0.9, 0, 0], [0, 0, 0.8]])
    monkeypatch.setattr(features, "MOST_CELLS", 1000)
    made = po.ifs([(B * ratio, np.zeros(3)) for ratio in (1.0, 0.95, 0.9)], level=15)
    assert made.smallest_feature() == pytest.approx(0.9**15 * 0.63**7 * 0.7, rel=1e-9)


# --- cut sets ------------------------------------------------------------------------------


def sizes(group):
    return np.linalg.norm(group.points[:, :, 1] - group.points[:, :, 0], axis=1)


def test_a_cut_set_ends_where_cells_first_are_small():
    ratios = (0.5, 0.25, 0.7)
    automaton = of_maps([(np.eye(3) * r, np.eye(3)[i]) for i, r in enumerate(ratios)])
    (group,) = cut_set(automaton, 0.2, sizes)
    found = sorted(sizes(group))

    def descend(size):
        return [size] if size < 0.2 else [s for r in ratios for s in descend(size * r)]

    np.testing.assert_allclose(found, sorted(descend(1.0)), rtol=1e-12)
    assert sorted(group.place) == list(range(len(found)))


def test_a_cut_set_of_maps_that_commute_holds_each_cell_once():
    ratios = (0.5, 0.25, 0.7)
    (group,) = cut_set(of_maps([(np.eye(3) * r, np.zeros(3)) for r in ratios]), 0.2, sizes)

    def descend(size):
        return {size} if size < 0.2 else {round(s, 9) for r in ratios for s in descend(size * r)}

    np.testing.assert_allclose(sorted(sizes(group)), sorted(descend(1.0)), atol=1e-8)


def test_a_cut_set_of_equal_ratios_is_a_level():
    automaton = of_maps(named("menger").maps)
    (cut,) = cut_set(automaton, 0.2, sizes)
    (level,) = cells(automaton, 2)
    assert (cut.points == level.points).all()
    # A cell that is as large as asked is refined in spite of rounding.
    assert len(cut_set(automaton, 1 / 9, sizes)[0].place) == 8000


def test_a_cut_set_of_what_does_not_shrink_ends():
    automaton = of_maps([(np.eye(3), np.ones(3))])
    with pytest.raises(ModelError, match=r"not smaller than 0\.5 after"):
        cut_set(automaton, 0.5, sizes)
    for size in (0.0, -1.0, float("nan")):
        with pytest.raises(ModelError, match="positive"):
            cut_set(automaton, size, sizes)


def test_a_cut_set_that_is_too_large_is_refused(monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: 10**8)
    with pytest.raises(MemoryLimitError, match="cells smaller than 1e-08"):
        cut_set(of_maps(named("menger").maps), 1e-8, sizes)
