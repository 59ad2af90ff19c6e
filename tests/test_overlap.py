"""Attractors whose parts overlap many times: covers by seeking words backwards from voxels."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

import porous as po
from porous.errors import ModelError
from porous.kernels.cover import Descent
from porous.models import cover, overlap
from porous.models.automaton import of_maps
from porous.models.enclosure import enclosing_balls
from porous.values import Frame


def turned_maps(count, ratio, seed, squeeze=(1, 1, 1)):
    random = np.random.default_rng(seed)
    turned = [np.linalg.qr(random.normal(size=(3, 3)))[0] for _ in range(count)]
    return [(q * ratio * np.array(squeeze), random.uniform(-0.5, 0.5, 3)) for q in turned]


SYSTEMS = {
    "six of 0.7": turned_maps(6, 0.7, 5),
    "eight of 0.6, squeezed": turned_maps(8, 0.62, 7, (1, 0.9, 1.1)),
}
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
    index = np.floor((game(maps, 1_000_000) - frame.origin) / frame.spacing).astype(int)
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
    tree = cKDTree(net.points)
    error = (net.doubt / net.edge - np.sqrt(3)) * net.edge  # how far the attractor is from them
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


def test_it_does_not_depend_on_order_repetition_or_tiles():
    maps = SYSTEMS["six of 0.7"]
    frame = framed(maps, 40)
    marks, _ = cover.cover_attractor(*system_of(maps)[:2], frame)
    again, _ = cover.cover_attractor(*system_of([*maps[::-1], *maps[:2]])[:2], frame)
    assert np.array_equal(again, marks)
    for start, stop in [
        ((0, 0, 0), (19, 40, 5)),
        ((17, 6, 5), (31, 13, 33)),
        ((4, 4, 4), (5, 5, 5)),
    ]:
        part = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
        tile, _ = cover.cover_attractor(*system_of(maps)[:2], frame.tile(start, stop))
        assert np.array_equal(tile, marks[part])


@each_system
def test_a_net_holds_the_attractor_within_its_doubt(name):
    maps = SYSTEMS[name]
    net = overlap.reference(system_of(maps)[2])
    points = game(maps, 100_000, seed=3)
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

    assert told(SYSTEMS["six of 0.7"])
    assert not told(turned_maps(4, 0.5, 1))
    assert not told([(np.diag([0.9, 0.9, 0.0]), np.array([k, 0, 0.0])) for k in range(3)])
    assert not told([(np.diag([0.97, 0.9, 0.9]), np.array([k, 0, 0.0])) for k in range(3)])
    assert not told([(np.eye(3) * 0.9, np.zeros(3))])


def test_work_without_end_is_refused(monkeypatch):
    monkeypatch.setattr(cover, "MOST_STEPS", 1000)
    monkeypatch.setattr(cover, "STEPS_PER_VOXEL", 0)
    maps = SYSTEMS["six of 0.7"]
    automaton, balls, _ = system_of(maps)
    with pytest.raises(ModelError, match="overlap so much that 1000 words"):
        cover.cover_attractor(automaton, balls, framed(maps, 70))
