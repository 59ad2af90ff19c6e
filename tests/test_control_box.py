"""Boxes of control points hold every level, are as tight as they say, and are quick."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rough import BEZIER, bent, corners, curve, rough, sponge, straight, takagi

from porous.errors import ModelError
from porous.models.automaton import Automaton, State, Transition, cells
from porous.models.contraction import contractivity
from porous.models.control_box import control_box
from porous.models.enclosure import enclosing_balls

HEIGHTS = (0.5, 0.3)
ENDS = {0: [0, 2]}


def drawn_points(automaton, level, drawn):
    """All drawn controls of a level's cells, (n, 3)."""
    found = []
    for group in cells(automaton, level):
        chosen = drawn.get(group.state)
        points = group.points if chosen is None else group.points[:, :, list(chosen)]
        found.append(points.transpose(0, 2, 1).reshape(-1, 3))
    return np.concatenate(found)


def reach(automaton, levels, drawn):
    points = np.concatenate([drawn_points(automaton, level, drawn) for level in range(levels)])
    return points.min(axis=0), points.max(axis=0)


def assert_holds(box, extremes):
    assert (np.array(box.lower) <= extremes[0]).all()
    assert (np.array(box.upper) >= extremes[1]).all()


@pytest.mark.parametrize(
    ("w", "height"), [(0.25, 0.5), (0.5, 2 / 3), (0.7, 1 / 0.9), (0.8, 1 / 0.6)]
)
def test_takagi_s_maxima(w, height):
    # Σ wᵏ·dist(2ᵏ/3, Z) = 1/(3(1 − w)) from one half on; the parabola's top for one quarter.
    automaton = curve(takagi(w), [(0, 0), (0.5, 1), (1, 0)])
    box = control_box(automaton, tolerance=1e-4, drawn=ENDS)
    assert height <= box.upper[1] <= height + 1.1e-4
    assert box.lower == pytest.approx((0, 0, 0), abs=1.1e-4)
    assert (box.upper[0], box.upper[2]) == pytest.approx((1, 0), abs=1.1e-4)
    assert max(box.lower) <= 0
    assert_holds(box, reach(automaton, 12, ENDS))


def test_slow_textures_are_held_though_not_tightly():
    automaton = curve(takagi(0.9), [(0, 0), (0.5, 1), (1, 0)])
    box = control_box(automaton, tolerance=1e-4, drawn=ENDS)
    assert 10 / 3 <= box.upper[1] <= 3.5


def test_handles_count_where_they_are_drawn():
    automaton = curve(takagi(0.25), [(0, 0), (0.5, 1), (1, 0)])
    assert control_box(automaton, tolerance=1e-6).upper[1] == pytest.approx(1, abs=2e-6)
    ends = control_box(automaton, tolerance=1e-6, drawn=ENDS)
    assert ends.upper[1] == pytest.approx(0.5, abs=2e-6)
    nothing = control_box(automaton, tolerance=1e-6, drawn={0: ()})
    assert nothing.upper == pytest.approx(ends.upper, abs=2e-6)


def test_weights_that_are_positive_keep_the_hull():
    automaton = sponge(straight(3), bend=bent(8, 1))
    box = control_box(automaton, tolerance=1e-9)
    controls = automaton.states[0].controls
    assert box.lower == pytest.approx(controls.min(axis=1), abs=1e-11)
    assert box.upper == pytest.approx(controls.max(axis=1), abs=1e-11)
    assert_holds(box, (controls.min(axis=1), controls.max(axis=1)))


@pytest.mark.parametrize("texture", [(1 / 3,) * 3, (0.45, -0.4, 0.45), (0.9, -0.9, 0.9)])
def test_texture_without_bend_draws_the_regular_body(texture):
    # Handles midway: δ·P = 0, so that no texture shows.
    automaton = sponge(rough(HEIGHTS, texture))
    box = control_box(automaton, tolerance=1e-3, drawn={0: corners(27)})
    assert box.lower == pytest.approx((0, 0, 0), abs=1e-5)
    assert box.upper == pytest.approx((1, 1, 1), abs=1e-5)


def test_transient_levels_of_an_uneven_body_keep_the_cube():
    threes = sponge(rough((0.4, 0.4), (0.2, 0.2, 0.2)))
    kept = [(0, 0, 0), (1, 0, 1), (0, 1, 1), (1, 0, 0), (1, 1, 1)]
    twos = sponge(rough((0.4,), (0.2, 0.4)), kept)
    state = threes.states[0]
    moves = [Transition(0, 1, t.matrix) for t in threes.transitions]
    moves += [Transition(1, 1, t.matrix) for t in twos.transitions]
    automaton = Automaton((state, state), tuple(moves))
    box = control_box(automaton, tolerance=1e-3, drawn={0: corners(27), 1: corners(27)})
    assert box.lower == pytest.approx((0, 0, 0), abs=1e-5)
    assert box.upper == pytest.approx((1, 1, 1), abs=1e-5)


@pytest.mark.parametrize(
    "rules", [BEZIER, rough(HEIGHTS, (0.3, 0.3, 0.3)), rough(HEIGHTS, (0.45, -0.4, 0.45))]
)
def test_rough_bodies_are_held_tightly_and_at_once(rules):
    automaton = sponge(rules, bend=bent(27, 3))
    drawn = {0: corners(27)}
    control_box(automaton, tolerance=0.1, drawn=drawn)
    before = time.process_time()
    box = control_box(automaton, tolerance=1e-3, drawn=drawn)
    assert time.process_time() - before < 1.0
    least, most = reach(automaton, 4, drawn)
    assert_holds(box, (least, most))
    finer = control_box(automaton, tolerance=1e-4, drawn=drawn)
    assert box.contains(finer, tolerance=1e-6)
    assert np.max(np.subtract(box.upper, finer.upper)) <= 1e-3
    # What later levels may add shrinks with their cells.
    left = 1e-3 + 2 * contractivity(automaton).upper ** 3
    assert (most >= np.array(box.upper) - left).all()
    assert (least <= np.array(box.lower) + left).all()


@settings(deadline=None, derandomize=True, max_examples=100)
@given(seed=st.integers(0, 10**6), divisions=st.integers(2, 3))
def test_random_curves_stay_inside_and_boxes_are_tight(seed, divisions):
    rng = np.random.default_rng(seed)
    texture = rng.uniform(-0.6, 0.6, size=divisions)
    rules = rough(rng.normal(size=divisions - 1) / 2, texture)
    automaton = curve(rules, rng.normal(size=(3, 2)) * (1, 5))
    shown = {0: [[0, 2], [0, 1, 2], []][int(rng.integers(3))]}
    box = control_box(automaton, tolerance=1e-3, drawn=shown)
    limit = reach(automaton, 8, {0: shown[0] or [0]})
    if shown[0]:
        assert_holds(box, limit)
    level = drawn_points(automaton, 10 if divisions == 2 else 7, {})
    # Nothing of the box is far from what is drawn or what the limit is near to.
    near = np.vstack([level, limit]) if shown[0] else level
    slack = 1e-3 + 20 * 0.61 ** (9 if divisions == 2 else 6)
    assert (near.max(axis=0) >= np.array(box.upper) - slack).all()
    assert (near.min(axis=0) <= np.array(box.lower) + slack).all()


@settings(deadline=None, derandomize=True, max_examples=15)
@given(seed=st.integers(0, 10**6))
def test_the_box_moves_with_the_controls(seed):
    # Affine invariance: weights sum to one.
    rng = np.random.default_rng(seed)
    rules = rough(HEIGHTS, (0.4, -0.3, 0.5))
    points = rng.normal(size=(3, 2))
    shift, scale = rng.normal(size=2), rng.uniform(0.2, 3, size=2)
    one = control_box(curve(rules, points), tolerance=1e-5, drawn=ENDS)
    other = control_box(curve(rules, points * scale + shift), tolerance=1e-5, drawn=ENDS)
    expected = np.array(one.upper[:2]) * scale + shift
    assert other.upper[:2] == pytest.approx(expected, abs=1e-4)


def test_renamed_states_have_the_same_box():
    rules = rough(HEIGHTS, (0.4, -0.3, 0.5))
    points = [(0, 0), (0.4, 0.7), (1, 0.2)]
    one = curve(rules, points)
    state = one.states[0]
    twin = Automaton(
        (state, state),
        tuple(Transition(q, (q + i) % 2, T) for q in (0, 1) for i, T in enumerate(rules)),
    )
    boxes = [control_box(a, tolerance=1e-5, drawn={0: [0], 1: [0]}) for a in (one, twin)]
    assert boxes[0].lower == pytest.approx(boxes[1].lower, abs=2e-5)
    assert boxes[0].upper == pytest.approx(boxes[1].upper, abs=2e-5)


def tower():
    """A curve whose cells carry a terminal strut that sticks out, first through another level."""
    curve_, strut = State("curve", np.eye(3)), State("strut", np.eye(3)[:, :2])
    start = State("start", np.array([[0, 0.5, 1], [0, 1, 0], [0, 0, 0.0]]))
    out = np.array([[1.0, -1.0], [0, 3.0], [0, -1.0]])
    moves = [Transition(0, 1, np.eye(3) * 1.0)]
    moves += [Transition(1, 1, T) for T in takagi(0.3)] + [Transition(1, 2, out)]
    return Automaton((start, curve_, strut), tuple(moves))


def test_terminal_cells_are_held_where_they_stand():
    automaton = tower()
    drawn = {0: (), 1: (), 2: None}
    box = control_box(automaton, tolerance=1e-6, drawn=drawn)
    assert_holds(box, reach(automaton, 8, drawn))
    # The first strut leads from (0, 0) to 3·(½, 1) − (0, 0) − (1, 0).
    assert box.upper[1] == pytest.approx(3, abs=1e-5)
    bare = control_box(automaton, tolerance=1e-6, drawn={0: (), 1: (), 2: ()})
    assert bare.upper[1] < 1


def test_paths_that_end_are_boxed_exactly():
    states = State("start", np.eye(3)), State("end", np.zeros((3, 2)))
    automaton = Automaton(
        states, (Transition(0, 1, np.array([[2.0, 0.5], [-1.0, 0.5], [0.0, 0.0]])),)
    )
    box = control_box(automaton, tolerance=1e-3, drawn={0: ()})
    assert (box.lower, box.upper) == ((0.5, -1, 0), (2, 0.5, 0))
    with pytest.raises(ModelError, match="nothing is drawn"):
        control_box(automaton, tolerance=1e-3, drawn={0: (), 1: ()})


def test_a_vertex_stays_where_it_is():
    vertex = State("vertex", np.array([[1.0], [2.0], [3.0]]))
    box = control_box(Automaton((vertex,), (Transition(0, 0, np.eye(1)),)), tolerance=1e-3)
    assert box.lower == pytest.approx((1, 2, 3), abs=1e-11)


def test_rotating_weights_need_longer_words():
    # Maps that stretch singly: E = [[0, −1.2], [½, 0]] and −E, on three controls.
    rotating = np.array([[0, -1.2], [0.5, 0]])
    moves = []
    for sign, shift in ((1, (0.3, 0.2)), (-1, (0.1, 0.6))):
        corner = np.array(shift)[:, None]
        upper = np.hstack([sign * rotating + corner, corner])
        moves.append(Transition(0, 0, np.vstack([upper, 1 - upper.sum(axis=0)])))
    automaton = Automaton(
        (State("c", np.array([[1, 0, 0], [0, 1, 0], [0, 0, 0.0]])),), tuple(moves)
    )
    box = control_box(automaton, tolerance=1e-4)
    least, most = reach(automaton, 14, {})
    assert_holds(box, (least, most))
    assert np.max(np.array(box.upper) - most) < 0.02
    assert np.max(least - np.array(box.lower)) < 0.02


@settings(deadline=None, derandomize=True, max_examples=20)
@given(seed=st.integers(0, 10**6), amount=st.floats(0.01, 0.06))
def test_rules_without_common_subspaces_are_held_by_ellipsoids(seed, amount):
    rng = np.random.default_rng(seed)
    regular = sponge(straight(2), bend=bent(8, seed))
    moves = []
    for t in regular.transitions[:5]:
        noise = rng.normal(size=(8, 8)) * amount
        moves.append(Transition(0, 0, t.matrix + noise - noise.mean(axis=0)))
    automaton = Automaton(regular.states, tuple(moves))
    box = control_box(automaton, tolerance=1e-2)
    least, most = reach(automaton, 5, {})
    assert_holds(box, (least, most))
    # Cells of the fifth level are small; the box may be looser than asked for, not wild.
    assert (np.array(box.lengths) <= 1.3 * (most - least) + 0.05).all()


def test_what_does_not_shrink_is_refused():
    automaton = curve(rough(HEIGHTS, (0.3, 1.05, 0.2)), [(0, 0), (0.5, 1), (1, 0)])
    with pytest.raises(ModelError, match="do not shrink fast enough"):
        control_box(automaton, tolerance=1e-3)
    with pytest.raises(ModelError, match="tolerance 0; wanted more"):
        control_box(automaton, tolerance=0)


def test_balls_of_states_with_terminal_siblings():
    automaton = tower()
    balls = enclosing_balls(automaton)
    assert balls.shape == (3, 4)
    found = drawn_points(automaton, 9, {1: (), 2: None})
    assert (np.linalg.norm(found - balls[0, :3], axis=1) <= balls[0, 3]).all()
    assert np.linalg.norm(np.eye(3)[:, :2].T - balls[2, :3], axis=1).max() <= balls[2, 3]
    regular = enclosing_balls(sponge(straight(3)))
    assert regular[0] == pytest.approx((0.5, 0.5, 0.5, 0.75**0.5), abs=0.02)
