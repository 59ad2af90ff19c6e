"""Clouds of attractor points: where they lie, how dense they are, which voxels they mark."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

import porous as po
from porous.kernels import clouds as kernel
from porous.kernels.clouds import stamp
from porous.models import clouds, cover
from porous.models.automaton import of_maps
from porous.models.enclosure import enclosing_balls
from porous.values import Frame


def turned_maps(count, ratio, seed):
    random = np.random.default_rng(seed)
    turned = [np.linalg.qr(random.normal(size=(3, 3)))[0] for _ in range(count)]
    return [(q * ratio, random.uniform(-0.5, 0.5, 3)) for q in turned]


MENGER = [
    (np.eye(3) / 3, np.array(d) / 3)
    for d in itertools.product(range(3), repeat=3)
    if sum(v == 1 for v in d) < 2
]
FERN = [
    (np.diag([0.0, 0.16, 0.0]), np.zeros(3)),
    (np.array([[0.85, 0.04, 0], [-0.04, 0.85, 0.1], [0, -0.1, 0.3]]), np.array([0, 1.6, 0])),
    (np.array([[0.2, -0.26, 0], [0.23, 0.22, 0], [0, 0, 0.3]]), np.array([0, 1.6, 0])),
]
SYSTEMS = {
    "menger": MENGER,
    "fern": FERN,
    "turned": turned_maps(4, 0.5, 1),
    "overlapping": turned_maps(5, 0.6, 2),
    "one point": [(np.eye(3) / 2, np.array([0.1, 0.2, 0.3]))],
    "unequal": [(np.eye(3) * r, np.array([r, 1 - r, r / 2])) for r in (0.1, 0.3, 0.6)],
}
each_system = pytest.mark.parametrize("name", SYSTEMS)


def system_of(maps):
    automaton = of_maps(maps)
    balls = enclosing_balls(automaton)
    return automaton, balls, cover._system(automaton, balls.tobytes())


def framed(maps, voxels):
    return Frame.fit(po.ifs(maps, level="limit").domain, voxels=voxels)


def window_of(automaton, frame):
    """Return the root in the window's own voxels, their numbers and edge lengths."""
    state, map_ = cover._root(automaton, frame, 1)
    map_[:, 3] -= frame.start
    return (state, map_), np.array(frame.shape), np.array(frame.spacing)


FINE = 1e-3
"""Edge of voxels for which clouds have as many points as may be."""


def marked(maps, frame):
    automaton, balls, system = system_of(maps)
    marks = np.zeros(frame.shape, np.uint8)
    found = clouds.clouds(system, min(frame.spacing))
    words = clouds.fitting(system, found, *window_of(automaton, frame))
    clouds.stamp_points(marks, found, words, np.array(frame.spacing))
    return marks, cover.cover_attractor(automaton, balls, frame)[0]


@each_system
def test_every_marked_voxel_is_of_the_cover_and_most_of_them_are(name):
    frame = framed(SYSTEMS[name], 45)
    marks, whole = marked(SYSTEMS[name], frame)
    assert set(np.unique(marks)) <= {0, 1}
    assert not (marks.astype(bool) & (whole == 0)).any()
    assert marks.sum() >= (0.1 if name == "one point" else 0.3) * whole.sum()


@each_system
def test_points_of_a_cloud_lie_in_the_attractor(name):
    maps = SYSTEMS[name]
    _, balls, system = system_of(maps)
    (cloud,) = clouds.clouds(system, FINE)
    points = cloud.points.T
    assert 1 <= len(points) <= clouds.POINTS
    assert (np.linalg.norm(points - balls[0, :3], axis=1) <= balls[0, 3] * (1 + 1e-9) + 1e-12).all()
    # Their images under words are within these words' parts, and no point is far from an image.
    frame = framed(maps, 31)
    automaton = of_maps(maps)
    whole, _ = cover.cover_attractor(automaton, balls, frame)
    index = np.floor((points - frame.origin) / frame.spacing).astype(int)
    inside = ((index >= 0) & (index < frame.shape)).all(axis=1)
    assert whole[tuple(index[inside].T)].all()


def naive_words(system, found, root, shape, spacing):
    """The words that fit a window, one after the other: (state, map, half diagonal, inside)."""
    words, most = [root], clouds.MOST_POINTS * shape.prod()
    most += max(cloud.points.shape[1] for cloud in found)
    while True:
        kept, finer, points, any_wide = [], [], 0, False
        for state, map_ in words:
            ball, block, linear = system.balls[state], system.blocks[state], map_[:, :3]
            middle, other = (linear @ held[:3] + map_[:, 3] for held in (ball, block))
            reach = np.linalg.norm(linear, axis=1) * ball[3]
            across = np.abs(linear) @ block[3:]
            low = np.maximum(middle - reach, other - across)
            high = np.minimum(middle + reach, other + across)
            if (high <= -clouds.MARGIN).any() or (low >= shape + clouds.MARGIN).any():
                continue
            inside = (low > clouds.MARGIN).all() and (high < shape - clouds.MARGIN).all()
            size = np.linalg.norm(reach * spacing)
            kept.append((state, map_, size, inside))
            cloud = found[state]
            wide = cloud.dimension > 0 and cloud.per_voxel(size / spacing.min()) < clouds.WANTED
            any_wide |= wide
            own = []
            for child in range(system.first[state], system.first[state + 1]) if wide else ():
                longer = linear @ system.maps[child]
                longer[:, 3] += map_[:, 3]
                own.append((system.targets[child], longer))
            finer += own if wide else [(state, map_)]
        points = sum(found[state].points.shape[1] for state, _ in finer)
        if not any_wide or points > most:
            return kept
        words = finer


@each_system
@pytest.mark.parametrize("voxels", [20, 300])
def test_words_that_fit_a_window(name, voxels, monkeypatch):
    monkeypatch.setattr(kernel, "ROOM", 3)  # more are found than there is room for
    monkeypatch.setattr(clouds, "POINTS", 500)
    automaton, _, system = system_of(SYSTEMS[name])
    frame = framed(SYSTEMS[name], voxels)
    tile = frame.tile([n // 3 for n in frame.shape], [max(1, n // 2) for n in frame.shape])
    found = clouds.clouds(system, FINE)
    for window in (frame, tile) if voxels < 100 else (tile,):
        words = clouds.fitting(system, found, *window_of(automaton, window))
        expected = naive_words(system, found, *window_of(automaton, window))
        assert len(words.states) == len(expected)
        if not expected:
            continue
        states, maps, sizes, inside = map(np.array, zip(*expected, strict=True))
        order, other = (np.lexsort(m.reshape(-1, 12).round(6).T) for m in (words.maps, maps))
        assert words.maps[order] == pytest.approx(maps[other], abs=1e-9)
        assert np.array_equal(words.states[order], states[other])
        assert words.sizes[order] == pytest.approx(sizes[other])
        assert np.array_equal(words.inside[order], inside[other])


def test_how_dense_a_cloud_is():
    (cloud,) = clouds.clouds(system_of(MENGER)[2], FINE)
    assert cloud.points.shape == (3, 8000)
    assert cloud.fineness == pytest.approx(1 / 27, rel=1e-6)
    assert cloud.dimension == pytest.approx(np.log(20) / np.log(3))
    (single,) = clouds.clouds(system_of(SYSTEMS["one point"])[2], FINE)
    assert single.points.shape == (3, 1)
    assert single.dimension == 0


@each_system
def test_clouds_are_as_fine_as_voxels_ask(name):
    system = system_of(SYSTEMS[name])[2]
    whole = np.sqrt(3) * system.balls[0, 3]
    counts = []
    for part in (2.0, 0.1, 0.01):
        (cloud,) = clouds.clouds(system, part * whole)
        counts.append(cloud.points.shape[1])
        assert cloud.fineness <= min(1, part) ** clouds.FINE or counts[-1] > clouds.POINTS / 8
    assert counts[0] == 1
    assert counts == sorted(counts)
    # Of each part there is a point.
    (finer,) = clouds.clouds(system, 0.001 * whole)
    gaps = cKDTree(cloud.points.T).query(finer.points.T)[0]
    assert gaps.max() <= 2 * cloud.fineness * whole + 1e-12
    some = cloud.thinned(0.25)
    assert some.shape == (3, int(np.ceil(0.25 * counts[-1])))
    assert {tuple(p) for p in some.T} <= {tuple(p) for p in cloud.points.T}
    assert np.array_equal(cloud.thinned(1.0), cloud.points)


def test_longer_words_are_all_there_are():
    first, targets = np.array([0, 2, 3]), np.array([0, 1, 0])
    maps = np.random.default_rng(4).normal(size=(3, 3, 4))
    words = np.array([1, 0]), np.random.default_rng(5).normal(size=(2, 3, 4))
    ends, found = kernel.longer(first, targets, maps, words)
    assert ends.tolist() == [0, 0, 1]
    bottom = np.array([[0.0, 0, 0, 1]])
    for row, (word, letter) in enumerate([(0, 2), (1, 0), (1, 1)]):
        expected = words[1][word] @ np.vstack([maps[letter], bottom])
        assert found[row] == pytest.approx(expected)


def test_marks_do_not_reach_beyond_a_tile():
    maps = SYSTEMS["turned"]
    frame = framed(maps, 60)
    whole = cover.cover_attractor(*system_of(maps)[:2], frame)[0]
    tile = frame.tile((11, 5, 20), (40, 33, 41))
    marks, part = marked(maps, tile)
    assert np.array_equal(part, whole[11:40, 5:33, 20:41])
    assert not (marks.astype(bool) & (part == 0)).any()


entries = st.floats(-3, 3, width=32)


@settings(max_examples=30)
@given(st.lists(entries, min_size=12, max_size=12), st.integers(0, 10**6))
def test_stamping_is_what_it_says(values, seed):
    random = np.random.default_rng(seed)
    cloud = random.normal(size=(3, 200))
    maps = np.array([np.reshape(values, (3, 4)), np.eye(3, 4)])
    maps[:, :, 3] += [5, 6, 4]
    marks = np.zeros((9, 11, 8), np.uint8)
    stamp(marks, maps, cloud, inside=False)
    expected = np.zeros_like(marks)
    for map_ in maps:
        place = np.floor((map_ @ np.vstack([cloud, np.ones(200)])).T)
        for point in place[((place >= 0) & (place < marks.shape)).all(axis=1)]:
            expected[tuple(point.astype(int))] = 1
    different = np.argwhere(expected != marks)  # but for points on a border between voxels
    assert len(different) <= 1


def test_both_ways_of_stamping_agree():
    random = np.random.default_rng(5)
    cloud = random.uniform(-1, 1, (3, 500))
    maps = np.concatenate([np.eye(3)[None].repeat(4, 0), random.uniform(2, 5, (4, 3, 1))], axis=2)
    one, other = np.zeros((8, 9, 7), np.uint8), np.zeros((8, 9, 7), np.uint8)
    stamp(one, maps, cloud, inside=True)
    stamp(other, maps, cloud, inside=False)
    assert np.array_equal(one, other)
    assert one.any()


def test_no_more_words_than_points_are_wanted():
    _, _, system = system_of(turned_maps(6, 0.7, 5))
    shape = np.array([40, 41, 42])
    root = (0, np.column_stack([np.eye(3) * 20, np.full(3, 20.0)]))
    found = clouds.clouds(system, FINE)
    words = clouds.fitting(system, found, root, shape, np.ones(3))
    assert len(words.states) * found[0].points.shape[1] <= (
        clouds.MOST_POINTS * shape.prod() + found[0].points.shape[1]
    )


@each_system
def test_a_coarser_cover_holds_a_finer_one(name):
    automaton, balls, _ = system_of(SYSTEMS[name])
    frame = framed(SYSTEMS[name], 33)
    fine, near = cover.cover_attractor(automaton, balls, frame)
    rough, far = cover.cover_attractor(automaton, balls, frame, fine=2)
    assert not ((fine != 0) & (rough == 0)).any()
    assert frame.diagonal < near < far
    assert far == pytest.approx(frame.diagonal + min(frame.spacing), rel=1e-4)
