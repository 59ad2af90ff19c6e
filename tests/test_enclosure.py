"""Enclosures hold what they say they hold, and are as tight as they say."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from porous.errors import ModelError
from porous.models.automaton import Automaton, State, Transition, cells, frames, of_maps
from porous.models.contraction import contractivity
from porous.models.digits import named
from porous.models.enclosure import (
    Seeds,
    enclosing_balls,
    enclosing_box,
    invariant_box,
    orbit_box,
)
from porous.values import Box

FERN = [
    ([[0.85, 0.04], [-0.04, 0.85]], [0, 1.6]),
    ([[0, 0], [0, 0.16]], [0, 0]),
    ([[0.2, -0.26], [0.23, 0.22]], [0, 1.6]),
    ([[-0.15, 0.28], [0.26, 0.24]], [0, 0.44]),
]
CUBE = Seeds(np.array(Box((0, 0, 0), (1, 1, 1)).corners))


def flat(maps, third=0.0):
    result = []
    for A, b in maps:
        matrix = np.pad(np.array(A, float), (0, 1))
        matrix[2, 2] = third
        result.append((matrix, np.array([*b, 0.0])))
    return of_maps(result)


def chaos(automaton, seed, count=4000):
    """Points of each state's attractor, by the random iteration algorithm, (state, point)."""
    rng = np.random.default_rng(seed)
    points = {}
    for state in range(len(automaton.states)):
        inward = [(t, F) for t, F in zip(automaton.transitions, automaton.maps, strict=True)]
        found = []
        for _ in range(count // 200):
            q, F = state, np.eye(4)
            for _ in range(200):
                options = [(t, M) for t, M in inward if t.source == q]
                t, M = options[rng.integers(len(options))]
                F = F @ np.vstack([M, [0, 0, 0, 1]])
                q = t.target
            found.append(F[:3, 3])
        points[state] = np.array(found)
    return points


def test_the_fern_s_box():
    box = enclosing_box(flat(FERN), tolerance=1e-3)
    expected = Box((-2.1829, -0.0007, 0), (2.6566, 9.9992, 0))
    assert box.lower == pytest.approx(expected.lower, abs=1.1e-3)
    assert box.upper == pytest.approx(expected.upper, abs=1.1e-3)
    finer = enclosing_box(flat(FERN), tolerance=1e-6)
    assert box.contains(finer, tolerance=1e-9)
    assert max(np.subtract(box.upper, finer.upper)) <= 1e-3


def test_the_fern_s_ball():
    # Rice's ball, of least radius among those that every map sends into themselves.
    ((x, y, z, radius),) = enclosing_balls(flat(FERN))
    assert (x, y) == pytest.approx((1.1336, 5.1138), abs=2e-3)
    assert z == pytest.approx(0, abs=1e-3)
    assert radius == pytest.approx(5.2888, abs=1e-3)


def test_maps_that_stretch():
    rotating = flat([([[0, -1.2], [0.5, 0]], [0, 0]), ([[0, 1.2], [-0.5, 0]], [1, 0])])
    box = enclosing_box(rotating, tolerance=1e-6)
    # x' = ∓1.2 y (+ 1), y' = ±.5 x: the widest points follow from |x| alone.
    assert box.lower == pytest.approx((-1.5, -1.25, 0), abs=1e-6)
    assert box.upper == pytest.approx((2.5, 1.25, 0), abs=1e-6)
    ((*centre, radius),) = enclosing_balls(rotating)
    assert radius < 3
    points = chaos(rotating, 1)[0]
    assert (np.linalg.norm(points - centre, axis=1) <= radius).all()


@pytest.mark.parametrize("name", ["menger", "vicsek-9", "minus-corner"])
def test_digit_sets_fill_their_cube_s_box(name):
    automaton = of_maps(named(name).maps)
    box = enclosing_box(automaton, tolerance=1e-9)
    assert box.lower == pytest.approx((0, 0, 0), abs=1e-9)
    assert box.upper == pytest.approx((1, 1, 1), abs=1e-9)
    assert orbit_box(automaton, CUBE, tolerance=1e-3) == Box((0, 0, 0), (1, 1, 1))


def test_the_orbit_s_box_is_exact_only_where_maps_keep_it():
    automaton = of_maps(named("menger").maps)
    assert invariant_box(automaton, CUBE.box)
    assert not invariant_box(automaton, Box((0.1, 0, 0), (1, 1, 1)))
    shifted = of_maps([(np.eye(3) / 2, np.array([1.0, 0, 0]))])
    box = orbit_box(shifted, CUBE, tolerance=1e-6)
    # The cube wanders to the fixed point (2, 0, 0).
    assert box.lower == pytest.approx((0, 0, 0), abs=1e-6)
    assert box.upper == pytest.approx((2, 1, 1), abs=1e-6)


def random_contraction(seed, stretch):
    """Two or three random maps scaled to a joint spectral radius of about ``stretch``."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(int(rng.integers(2, 4)), 3, 3))
    found = contractivity(of_maps([(M / 10, np.zeros(3)) for M in A]))
    A *= stretch / (10 * found.upper)
    return of_maps([(M, b) for M, b in zip(A, rng.normal(size=(len(A), 3)), strict=True)])


@settings(deadline=None, derandomize=True, max_examples=10)
@given(seed=st.integers(0, 10**6), stretch=st.floats(0.2, 0.85))
def test_random_maps_stay_inside_and_boxes_are_tight(seed, stretch):
    automaton = random_contraction(seed, stretch)
    points = chaos(automaton, seed)[0]
    ((*centre, radius),) = enclosing_balls(automaton)
    assert (np.linalg.norm(points - centre, axis=1) <= radius).all()
    rough = enclosing_box(automaton, tolerance=0.05 * radius)
    fine = enclosing_box(automaton, tolerance=0.01 * radius)
    for box in (rough, fine):
        assert (points >= box.lower).all()
        assert (points <= box.upper).all()
    ends = [np.subtract(rough.upper, fine.upper), np.subtract(fine.lower, rough.lower)]
    assert np.max(ends) <= 0.05 * radius + 1e-9
    assert np.min(ends) >= -0.01 * radius - 1e-9


@settings(deadline=None, derandomize=True, max_examples=8)
@given(seed=st.integers(0, 10**6), radius=st.sampled_from([0.0, 0.4]))
def test_the_orbit_s_box_holds_every_level(seed, radius):
    automaton = random_contraction(seed, 0.6)
    seeds = Seeds(CUBE.points[:4], radius)
    box = orbit_box(automaton, seeds, tolerance=1e-3)
    ((*centre, reach),) = enclosing_balls(automaton, seeds)
    tight = [np.full(3, np.inf), np.full(3, -np.inf)]
    for level in range(7):
        placed = frames(automaton, cells(automaton, level))
        points = np.einsum("kij,nj->kni", placed[:, :, :3], seeds.points) + placed[:, None, :, 3]
        around = radius * np.linalg.norm(placed[:, :, :3], axis=2)[:, None]
        tight[0] = np.minimum(tight[0], (points - around).min(axis=(0, 1)))
        tight[1] = np.maximum(tight[1], (points + around).max(axis=(0, 1)))
        widest = radius * np.linalg.norm(placed[:, :, :3], 2, axis=(1, 2))[:, None]
        assert (np.linalg.norm(points - centre, axis=2) + 0 * widest <= reach).all()
    assert (tight[0] >= np.array(box.lower)).all()
    assert (tight[1] <= np.array(box.upper)).all()
    # Levels beyond the sixth reach no further than their maps' size.
    left = 1e-3 + 2 * reach * contractivity(automaton).upper ** 3
    assert (tight[0] <= np.array(box.lower) + left).all()


def frame_of(maps_by_ends, states):
    frame = State("f", np.hstack([np.zeros((3, 1)), np.eye(3)]))
    moves = [
        Transition(a, b, of_maps([(np.array(A, float), np.array(v, float))]).transitions[0].matrix)
        for a, b, A, v in maps_by_ends
    ]
    return Automaton((frame,) * states, tuple(moves))


def test_several_states_have_balls_of_their_own():
    half, turn = np.eye(3) / 2, np.array([[0, -0.6, 0], [0.6, 0, 0], [0, 0, 0.3]])
    automaton = frame_of(
        [
            (0, 0, half, [0, 0, 0]),
            (0, 1, turn, [3, 0, 0]),
            (1, 0, half, [0, 1, 0]),
            (1, 1, half, [0, 0, 2]),
        ],
        2,
    )
    balls = enclosing_balls(automaton)
    points = chaos(automaton, 3)
    for state, (*centre, radius) in enumerate(balls):
        assert (np.linalg.norm(points[state] - centre, axis=1) <= radius).all()
    box = enclosing_box(automaton, tolerance=1e-4)
    assert (points[0] >= box.lower).all()
    assert (points[0] <= box.upper).all()


def test_a_state_twice_has_the_same_box():
    automaton = flat(FERN, 0.2)
    maps = [(F[:, :3], F[:, 3]) for F in automaton.maps]
    twin = frame_of([(q, (i + q) % 2, A, b) for q in (0, 1) for i, (A, b) in enumerate(maps)], 2)
    one, two = (enclosing_box(a, tolerance=1e-4) for a in (automaton, twin))
    assert one.lower == pytest.approx(two.lower, abs=1e-4)
    assert one.upper == pytest.approx(two.upper, abs=1e-4)


def test_terminal_states_are_held_as_they_are():
    automaton = frame_of([(0, 0, np.eye(3) / 2, [0, 0, 0]), (0, 1, np.eye(3) * 3, [5, 0, 0])], 2)
    box = orbit_box(automaton, CUBE, tolerance=1e-6)
    assert box.lower == pytest.approx((0, 0, 0), abs=1e-6)
    assert box.upper == pytest.approx((8, 3, 3), abs=1e-5)


def test_seeds_are_balls_too():
    seeds = Seeds(np.array([[0.5, 0.5, 0.5]]), 0.5)
    automaton = of_maps(named("menger").maps)
    assert orbit_box(automaton, seeds, tolerance=1e-4) == Box((0, 0, 0), (1, 1, 1))
    turned = np.array([[0, -0.5, 0], [0.5, 0, 0], [0, 0, 0.5]])
    box = orbit_box(of_maps([(turned, np.zeros(3))]), seeds, tolerance=1e-6)
    # The first image is the ball of radius ¼ about (−¼, ¼, ¼), the next that of ⅛ about …
    assert box.lower == pytest.approx((-0.5, -0.25, 0), abs=1e-5)
    assert box.upper == pytest.approx((1, 1, 1), abs=1e-5)


def test_a_ball_about_a_box_where_that_is_smaller():
    long = of_maps([(np.diag([0.5, 0.5, 0.5]), v) for v in np.diag([0.5, 0.0, 0.0])])
    ((*_, radius),) = enclosing_balls(long)
    assert radius == pytest.approx(0.5, abs=1e-6)


def test_maps_that_hardly_shrink_are_refused_by_name():
    slow = np.diag([0.99999, 0.99999, 0.5])
    turn = [
        np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]) for a in (1, 2)
    ]
    with pytest.raises(ModelError, match="contract so slowly"):
        enclosing_balls(of_maps([(slow @ t, np.ones(3)) for t in turn]))


def test_radius_is_positive_even_for_a_point():
    ((x, y, z, radius),) = enclosing_balls(of_maps([(np.eye(3) / 2, np.array([1.0, 2, 3]))]))
    assert math.dist((x, y, z), (2, 4, 6)) <= radius < 1e-5
