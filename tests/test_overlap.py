"""Attractors whose parts overlap many times: covers by seeking words backwards from voxels."""

import time

import naive_limits
import naive_sampling
import numpy as np
import pytest
from scipy.spatial import cKDTree

import porous as po
from porous.errors import ModelError
from porous.kernels import overlap as overlap_kernel
from porous.kernels.cover import Descent
from porous.models import cover, overlap
from porous.models.automaton import of_maps
from porous.models.cell_cover import cover_cells
from porous.models.enclosure import enclosing_balls
from porous.values import Frame


def turned_maps(count, ratio, seed, squeeze=(1, 1, 1)):
    random = np.random.default_rng(seed)
    turned = [np.linalg.qr(random.normal(size=(3, 3)))[0] for _ in range(count)]
    return [(q * ratio * np.array(squeeze), random.uniform(-0.5, 0.5, 3)) for q in turned]


SHEAR = np.eye(3) + np.diag([0.8, 0.8], 1)


def sheared(maps, by=SHEAR):
    """The same maps in other coordinates: those of the world are the inverse's images."""
    back = np.linalg.inv(by)
    return [(back @ A @ by, back @ b) for A, b in maps]


SYSTEMS = {
    "six of 0.7": turned_maps(6, 0.7, 5),
    "five of 0.7, one of 0.96": [*turned_maps(5, 0.7, 5), *turned_maps(1, 0.96, 2)],
    "eight of 0.6, squeezed": turned_maps(8, 0.62, 7, (1, 0.9, 1.1)),
    "six of 0.7, sheared": sheared(turned_maps(6, 0.7, 5)),
}
STRETCHED = sheared(turned_maps(6, 0.7, 5), np.diag([1, 1, 0.45]))
each_system = pytest.mark.parametrize("name", SYSTEMS)


def system_of(maps):
    automaton = of_maps(maps)
    balls = enclosing_balls(automaton)
    return automaton, balls, cover._system(automaton, balls.tobytes())


def framed(maps, voxels):
    frame = Frame.fit(po.ifs(maps, level="limit").domain, voxels=voxels)
    return Frame(frame.origin, tuple(np.array(frame.spacing) * [1, 1.1, 0.95]), frame.shape)


def game(maps, count, seed=0):
    """Points of the attractor: many chaos games side by side."""
    random = np.random.default_rng(seed)
    linear, shift = (np.array(part) for part in zip(*maps, strict=True))
    points = np.zeros((2000, 3))
    found = []
    for step in range(40 + count // 2000):
        chosen = random.integers(0, len(maps), 2000)
        points = np.einsum("kab,kb->ka", linear[chosen], points) + shift[chosen]
        if step >= 40:
            found.append(points)
    return np.concatenate(found)


@each_system
def test_no_point_lies_outside(name):
    maps = SYSTEMS[name]
    automaton, balls, system = system_of(maps)
    assert overlap.overlaps(system)
    frame = framed(maps, 50)
    marks, _ = cover.cover_attractor(automaton, balls, frame)
    index = np.floor((game(maps, 500_000) - frame.origin) / frame.spacing).astype(int)
    inside = ((index >= 0) & (index < frame.shape)).all(axis=1)
    assert marks[tuple(index[inside].T)].all()
    assert 0 < marks.mean() < 1


@each_system
def test_what_is_marked_is_near(name):
    # Half a voxel's grid of samples of the attractor, from the words of a descent: no marked voxel
    # is further from them than the bound and what the samples leave.
    maps = SYSTEMS[name]
    automaton, balls, system = system_of(maps)
    frame = framed(maps, 16)
    marks, bound = cover.cover_attractor(automaton, balls, frame)
    net = overlap.reference(system)
    back = np.linalg.inv(net.turn)
    tree = cKDTree(net.points @ back.T)
    # How far the attractor is from them, in the world.
    error = (net.doubt - np.sqrt(3) * net.edge) * np.linalg.norm(back, 2)
    index = np.argwhere(marks)
    worst = 0.0
    for corner in np.ndindex(2, 2, 2):
        place = frame.origin + (index + corner) * np.array(frame.spacing)
        worst = max(worst, tree.query(place)[0].max())
    assert worst <= bound + error
    assert worst > 0.3 * frame.diagonal


@each_system
def test_it_agrees_with_a_descent(name):
    maps = SYSTEMS[name]
    automaton, balls, system = system_of(maps)
    frame = framed(maps, 18)
    marks, _ = cover.cover_attractor(automaton, balls, frame)
    descent = np.zeros(frame.shape, np.uint8)
    spacing = np.array(frame.spacing)
    root = cover._root(automaton, frame, 1)
    Descent(descent, np.array(frame.start), spacing, system, root).run(
        float(spacing.min()) / 16, whole=True, limit=10**9
    )
    # Both hold what is touched, and nothing more than 2 ε from it.
    assert (descent != marks).mean() < 0.01
    rough, _ = cover.cover_attractor(automaton, balls, frame, fine=2)
    assert not ((marks != 0) & (rough == 0)).any()


@pytest.mark.parametrize("name", ["six of 0.7", "six of 0.7, sheared"])
def test_it_does_not_depend_on_order_repetition_or_tiles(name):
    maps = SYSTEMS[name]
    frame = framed(maps, 40)
    marks, _ = cover.cover_attractor(*system_of(maps)[:2], frame)
    again, _ = cover.cover_attractor(*system_of([*maps[::-1], *maps[:2]])[:2], frame)
    assert np.array_equal(again, marks)
    for start, stop in [
        ((0, 0, 0), (19, frame.shape[1], 5)),
        ((17, 6, 5), (31, 13, min(33, frame.shape[2]))),
        ((4, 4, 4), (5, 5, 5)),
    ]:
        part = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
        tile, _ = cover.cover_attractor(*system_of(maps)[:2], frame.tile(start, stop))
        assert np.array_equal(tile, marks[part])


@each_system
def test_a_net_holds_the_attractor_within_its_doubt(name):
    maps = SYSTEMS[name]
    net = overlap.reference(system_of(maps)[2])
    points = game(maps, 100_000, seed=3) @ net.turn.T
    assert (np.linalg.norm(points - net.ball[:3], axis=1) <= net.ball[3]).all()
    error = net.doubt - np.sqrt(3) * net.edge
    assert cKDTree(net.points).query(points)[0].max() <= error
    index = np.floor((points - net.low) / net.edge).astype(int)
    assert (index >= 0).all()
    assert (index < net.distance.shape).all()
    # Distances that are told are no longer than those to the attractor.
    probes = np.random.default_rng(1).uniform(
        net.low, net.low + net.edge * np.array(net.distance.shape), (500, 3)
    )
    told = net.distance[tuple(np.floor((probes - net.low) / net.edge).astype(int).T)] - net.doubt
    assert (told <= cKDTree(points).query(probes)[0]).all()


def test_which_systems_are_sought_backwards():
    def told(maps):
        return overlap.overlaps(system_of(maps)[2])

    assert all(map(told, SYSTEMS.values()))
    assert not told(turned_maps(4, 0.5, 1))
    assert not told([(np.diag([0.9, 0.9, 0.0]), np.array([k, 0, 0.0])) for k in range(3)])
    assert told([(np.diag([0.97, 0.9, 0.9]), np.array([k, k**2, k**3.0])) for k in range(3)])
    assert not told([(np.diag([0.97, 0.9, 0.9]), np.array([k, 0, 0.0])) for k in range(3)])
    assert not told([(np.diag([0.96, 0.5, 0.9]), np.array([k, k**2, k**3.0])) for k in range(7)])
    assert not told([(np.eye(3) * 0.9, np.zeros(3))])


def test_work_without_end_is_refused(monkeypatch):
    monkeypatch.setattr(cover, "MOST_STEPS", 1000)
    monkeypatch.setattr(cover, "STEPS_PER_VOXEL", 0)
    maps = SYSTEMS["six of 0.7"]
    automaton, balls, _ = system_of(maps)
    with pytest.raises(ModelError, match="overlap so much that 1000 words"):
        cover.cover_attractor(automaton, balls, framed(maps, 70))


# --- words that coincide -------------------------------------------------------------------


def about_z(angle, shift):
    c, s = np.cos(angle), np.sin(angle)
    return 0.7 * np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array(shift)


COMMUTING = [about_z(angle, (0, 0, 0)) for angle in (0.3, 1.1, 8**0.5)]
STEPS = [(np.eye(3) / 2, np.array(d) / 4) for d in np.ndindex(3, 3, 3)]


def test_letters_are_words_that_differ():
    # Three maps that commute: n letters make (n + 1)(n + 2) / 2 words.
    maps, growth = overlap.letters(system_of([*COMMUTING])[2])
    length = round(np.log(np.linalg.det(maps[0, :, :3])) / np.log(0.7**3))
    assert len(maps) == (length + 1) * (length + 2) / 2
    assert length >= 5
    assert growth == pytest.approx(0.7**3 * len(maps) ** (1 / length))
    # Steps along an axis are whole numbers up to 2 · (2ⁿ − 1): 3, 7 and 15 of the words.
    along = [m for m in STEPS if m[1][0] == 0 and m[1][1] == 0]
    maps, growth = overlap.letters(system_of(along)[2])
    length = round(np.log2(len(maps) + 1)) - 1
    assert np.array_equal(np.unique(maps[:, 2, 3]) * 2 ** (length + 1), np.arange(len(maps)))
    assert growth == pytest.approx(len(maps) ** (1 / length) / 8)
    assert length >= 5
    # Where none coincide they are the maps.
    system = system_of(SYSTEMS["six of 0.7"])[2]
    assert np.array_equal(overlap.letters(system)[0], system.maps)


def test_words_that_coincide_count_once():
    maps = [*COMMUTING, about_z(0.5, (0.5, 0, 0.3))]
    automaton, balls, system = system_of(maps)
    assert not overlap.overlaps(system)  # 4 · 0.343 = 1.37 by letter, but 1.08 by words that differ
    frame = framed(maps, 40)
    marks, _ = cover.cover_attractor(automaton, balls, frame)
    index = np.floor((game(maps, 300_000) - frame.origin) / frame.spacing).astype(int)
    inside = ((index >= 0) & (index < frame.shape)).all(axis=1)
    assert marks[tuple(index[inside].T)].all()
    cells, _ = cover_cells(automaton, frame)
    assert (marks != (cells != 0)).sum() < 0.01 * marks.sum()


# --- coordinates ---------------------------------------------------------------------------


def test_norms_of_sheared_maps_are_those_of_the_maps_themselves():
    for maps, by in ((SYSTEMS["six of 0.7, sheared"], SHEAR), (STRETCHED, np.diag([1, 1, 0.45]))):
        given = system_of(maps)[2].maps
        assert np.linalg.norm(given[:, :, :3], 2, axis=(1, 2)).max() > 1.2
        turn = overlap.coordinates(given)
        own = turn @ given[:, :, :3] @ np.linalg.inv(turn)
        assert np.linalg.norm(own, 2, axis=(1, 2)).max() < 0.7 * 1.01
        assert np.linalg.det(turn) == pytest.approx(1)
        # But for a rotation and a size they are the coordinates that were sheared.
        assert np.allclose(turn.T @ turn, by.T @ by / np.linalg.det(by) ** (2 / 3), atol=0.02)
    maps = system_of(SYSTEMS["six of 0.7"])[2].maps
    assert np.array_equal(overlap.coordinates(maps), np.eye(3))


def test_the_bound_holds_in_sheared_coordinates():
    # Samples that leave out no more than a gap: in the coordinates where the maps are turned ones.
    turned, gap = turned_maps(4, 0.7, 9), 0.3
    maps = sheared(turned)
    automaton, balls, system = system_of(maps)
    assert overlap.overlaps(system)
    frame = framed(maps, 9)
    marks, bound = cover.cover_attractor(automaton, balls, frame)
    back = np.linalg.inv(SHEAR)
    radius = enclosing_balls(of_maps(turned))[0, 3]
    points = naive_sampling.word_points(turned, gap, 2 * radius) @ back.T
    index, inside = naive_limits.voxels_of(points, frame)
    assert marks[tuple(index[inside].T)].all()
    worst = naive_limits.furthest(marks, frame, points)
    assert 0.3 * bound < worst <= bound + gap * np.linalg.norm(back, 2)


def words_per_voxel(maps, monkeypatch):
    """How many words are looked at for each voxel of a cover, and that of the cover."""
    found = []
    seek = overlap_kernel.seek

    def counted(marks, *given, **options):
        found.append(seek(marks, *given, **options))
        return found[-1]

    monkeypatch.setattr(overlap_kernel, "seek", counted)
    automaton, balls, _ = system_of(maps)
    marks, _ = cover.cover_attractor(automaton, balls, framed(maps, 64))
    return sum(found) / marks.sum()


def test_sheared_maps_take_little_more_work(monkeypatch):
    plain = words_per_voxel(SYSTEMS["six of 0.7"], monkeypatch)
    for maps in (SYSTEMS["six of 0.7, sheared"], STRETCHED):
        assert words_per_voxel(maps, monkeypatch) < 5 * plain


def in_plane(angle, ratio):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shift = np.array([np.cos(3 * angle), np.sin(2 * angle), 0])
    return ratio * np.block([[turn, np.zeros((2, 1))], [np.zeros((1, 2)), np.eye(1)]]), shift


FLAT = {
    "square": [(0.7 * np.eye(3), 0.3 * np.array([x, y, 0.0])) for x in (0, 1) for y in (0, 1)],
    "six of a plane": [in_plane(angle, 0.7) for angle in (0, 1, 2.2, 3.9, 4.4, 5.5)],
    "four of a line": [(0.8 * np.eye(3), np.array([x, 0, 0])) for x in (0, 0.3, 0.7, 1)],
}


@pytest.mark.parametrize("name", FLAT)
def test_flat_attractors_that_overlap_are_covered_forwards(name):
    maps = FLAT[name]
    points = game(maps, 300_000)
    low, high = points.min(axis=0) - 0.1, points.max(axis=0) + np.array([0.1, 0.1, 0.11])
    automaton, balls, system = system_of(maps)
    assert np.abs(np.linalg.det(system.maps[:, :, :3])).sum() > 1.3
    assert not overlap.overlaps(system)
    edge = float((high - low).max()) / 33
    frame = Frame(tuple(low), (edge,) * 3, tuple(np.ceil((high - low) / edge).astype(int)))
    started = time.process_time()
    marks, _ = cover.cover_attractor(automaton, balls, frame)
    assert time.process_time() - started < 2
    index = np.floor((points - low) / edge).astype(int)
    assert marks[tuple(index.T)].all()
    # A plane's or a line's voxels, and those beside it at most.
    assert marks.any(axis=(0, 1)).sum() <= 2


def test_flatness_is_that_of_the_attractor_in_any_direction():
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    for maps in FLAT.values():
        turned = [(turn @ A @ turn.T, turn @ b) for A, b in maps]
        assert overlap._is_flat(system_of(turned)[2])
        besides = [(0.5 * np.eye(3), axis) for axis in turn.T]
        assert not overlap._is_flat(system_of([*turned, *besides])[2])
