"""Automata: what is refused at the door, words, order, memory, renaming and duplication."""

import pickle

import naive_oracle as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from porous import memory
from porous.errors import MemoryLimitError, ModelError
from porous.models.automaton import (
    Automaton,
    State,
    Transition,
    cells,
    checked_map,
    count_cells,
    expand,
    frames,
    of_maps,
    words,
)
from porous.models.digits import DigitSet, detect, named, names

FRAME = np.hstack([np.zeros((3, 1)), np.eye(3)])


def random_automaton(seed, *, states=3, terminal=False):
    """States of 2 to 5 controls in a ring, one to three children each; columns sum to 1."""
    rng = np.random.default_rng(seed)
    kinds = [State(f"q{i}", rng.normal(size=(3, int(rng.integers(2, 6))))) for i in range(states)]
    transitions = []
    for source in range(states - terminal):
        ends = [(source + 1) % states, *rng.integers(0, states, int(rng.integers(0, 3)))]
        for target in ends:
            T = rng.normal(size=(kinds[source].size, kinds[target].size)) * 0.4
            transitions.append(Transition(source, int(target), T + (1 - T.sum(axis=0)) / len(T)))
    return Automaton(tuple(kinds), tuple(transitions))


def renamed(automaton, order):
    """The same automaton with states in another order and other names."""
    place = {state: i for i, state in enumerate(order)}
    states = [State(f"r{i}", automaton.states[q].controls) for i, q in enumerate(order)]
    moved = [Transition(place[t.source], place[t.target], t.matrix) for t in automaton.transitions]
    return Automaton(tuple(states), tuple(moved), place[automaton.start])


def duplicated(automaton, rng):
    """Every state twice; each transition leads to either twin of its target."""
    count = len(automaton.states)
    doubled = [
        Transition(t.source + copy, t.target + count * int(rng.integers(2)), t.matrix)
        for copy in (0, count)
        for t in automaton.transitions
    ]
    try:
        return Automaton(automaton.states * 2, tuple(doubled), automaton.start)
    except ModelError:  # a twin that nothing leads to
        return duplicated(automaton, rng)


@settings(deadline=None, derandomize=True, max_examples=40)
@given(seed=st.integers(0, 10**6), terminal=st.booleans(), level=st.integers(0, 4))
def test_cells_are_the_words_one_by_one(seed, terminal, level):
    automaton = random_automaton(seed, terminal=terminal)
    expected = list(naive.words(automaton, level))
    assert count_cells(automaton, level) == len(expected)
    found = {}
    for group in cells(automaton, level):
        for points, place in zip(group.points, group.place, strict=True):
            found[int(place)] = group.state, points
    assert sorted(found) == list(range(len(expected)))
    letters = words(automaton, level)
    for place, (word, state, points) in enumerate(expected):
        assert found[place][0] == state
        np.testing.assert_allclose(found[place][1], points, rtol=0, atol=1e-11)
        assert tuple(letters[place][: len(word)]) == word
        assert (letters[place][len(word) :] == -1).all()


@settings(deadline=None, derandomize=True, max_examples=30)
@given(seed=st.integers(0, 10**6), terminal=st.booleans(), order=st.permutations(range(3)))
def test_renaming_states_changes_no_cell(seed, terminal, order):
    automaton = random_automaton(seed, terminal=terminal)
    other = renamed(automaton, order)
    assert {tuple(points.ravel()) for _, group in expand(automaton, 3) for points in group} == {
        tuple(points.ravel()) for _, group in expand(other, 3) for points in group
    }
    assert (words(automaton, 3) == words(other, 3)).all()


@settings(deadline=None, derandomize=True, max_examples=30)
@given(seed=st.integers(0, 10**6))
def test_duplicating_states_changes_no_cell(seed):
    automaton = random_automaton(seed, states=2)
    twin = duplicated(automaton, np.random.default_rng(seed))
    assert sorted(tuple(p.ravel()) for _, g in expand(automaton, 3) for p in g) == sorted(
        tuple(p.ravel()) for _, g in expand(twin, 3) for p in g
    )


def test_frames_do_not_depend_on_names_or_copies():
    maps = [(np.diag([0.5, 0.4, 0.3]) + 0.01, np.array([0.1, 0.2, 0.3]) * i) for i in range(3)]
    plain = of_maps(maps)
    twin = duplicated(plain, np.random.default_rng(4))
    other = renamed(twin, [1, 0])
    expected = frames(plain, cells(plain, 4))
    assert (frames(twin, cells(twin, 4)) == expected).all()
    assert (frames(other, cells(other, 4)) == expected).all()


def test_frames_are_the_products_of_the_maps_first_letter_outermost():
    rng = np.random.default_rng(2)
    maps = [(rng.normal(size=(3, 3)), rng.normal(size=3)) for _ in range(3)]
    automaton = of_maps(maps)
    placed = frames(automaton, cells(automaton, 3))
    for frame, word in zip(placed, words(automaton, 3), strict=True):
        A, b = np.eye(3), np.zeros(3)
        for letter in word:
            A, b = A @ maps[letter][0], A @ maps[letter][1] + b
        np.testing.assert_allclose(frame, np.column_stack([A, b]), rtol=0, atol=1e-12)


def test_scaling_multiplies_places_and_keeps_matrices():
    automaton = of_maps(named("menger").maps)
    large = automaton.scaled(30.0)
    small, big = frames(automaton, cells(automaton, 2)), frames(large, cells(large, 2))
    np.testing.assert_allclose(big[:, :, :3], small[:, :, :3], atol=1e-13)
    np.testing.assert_allclose(big[:, :, 3], 30 * small[:, :, 3], atol=1e-12)


def test_dyadic_maps_are_exact():
    automaton = of_maps(named("minus-corner").maps)
    placed = frames(automaton, cells(automaton, 6))
    assert (placed[:, :, 3] * 64 == np.rint(placed[:, :, 3] * 64)).all()
    assert (placed[:, :, :3] == np.eye(3) / 64).all()


def test_projective_points_of_many_controls_stay_affine():
    # An automaton on eight controls commutes with affine maps of its controls.
    automaton = random_automaton(7)
    Q = np.random.default_rng(1).normal(size=(3, 3))
    moved = Automaton(
        tuple(State(s.name, Q @ s.controls + 1.5) for s in automaton.states), automaton.transitions
    )
    for (_, a), (_, b) in zip(expand(automaton, 3), expand(moved, 3), strict=True):
        np.testing.assert_allclose(np.einsum("ij,kjm->kim", Q, a) + 1.5, b, atol=1e-10)


def test_too_many_cells_are_refused_before_they_are_made(monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: 10**8)
    automaton = of_maps(named("menger").maps)
    with pytest.raises(MemoryLimitError, match=rf"level 40 \({20**40} cells\) would need"):
        expand(automaton, 40)
    with pytest.raises(MemoryLimitError):
        words(automaton, 30)


REFUSED = {
    "nan": ([FRAME], [(0, 0, np.full((4, 4), np.nan))], 0, "finite"),
    "infinite": ([FRAME], [(0, 0, np.full((4, 4), np.inf))], 0, "finite"),
    "sum": ([FRAME], [(0, 0, np.eye(4) * 0.9)], 0, "column 0 sums to 0.9; wanted 1"),
    "shape": ([FRAME], [(0, 0, np.eye(3))], 0, r"shape \(3, 3\); wanted \(4, 4\)"),
    "absent": ([FRAME], [(0, 1, np.eye(4))], 0, "names state 1; there are 1"),
    "negative": ([FRAME], [(-1, 0, np.eye(4))], 0, "names state -1"),
    "start": ([FRAME], [(0, 0, np.eye(4))], 2, "start is 2"),
    "unreached": ([FRAME, FRAME], [(0, 0, np.eye(4))], 0, r"state 1 \('s1'\) is never reached"),
    "none": ([FRAME], [], 0, "at least one"),
    "flat controls": ([np.zeros(4)], [(0, 0, np.eye(4))], 0, r"wanted \(3, m\)"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_at_the_door(case):
    controls, transitions, start, message = REFUSED[case]
    with pytest.raises(ModelError, match=message):
        Automaton(
            tuple(State(f"s{i}", c) for i, c in enumerate(controls)),
            tuple(Transition(*t) for t in transitions),
            start,
        )


def test_sums_may_be_off_by_rounding_only():
    def automaton(error):
        T = np.eye(4)
        T[0, 0] += error
        return Automaton((State("cell", FRAME),), (Transition(0, 0, T),))

    automaton(1e-10)
    with pytest.raises(ModelError, match="sums to"):
        automaton(1e-8)


def test_maps_are_named_by_their_index():
    good = (np.eye(3) / 2, np.zeros(3))
    for bad in [(np.eye(2), np.zeros(3)), (np.eye(3), np.zeros(2)), (np.eye(3), [0, 0, "a"])]:
        with pytest.raises(ModelError, match=r"maps\[1\]"):
            of_maps([good, bad])
    with pytest.raises(ModelError, match=r"maps\[0\].matrix.*finite"):
        checked_map(0, np.full((3, 3), np.nan), np.zeros(3))
    with pytest.raises(ModelError, match="got none"):
        of_maps([])
    with pytest.raises(ModelError, match="level: got -1"):
        expand(of_maps([good]), -1)


def test_states_without_four_independent_controls_have_no_frames():
    automaton = random_automaton(3)
    with pytest.raises(ModelError, match="no four independent controls"):
        frames(automaton, cells(automaton, 1))
    with pytest.raises(ModelError, match="no four independent controls"):
        _ = automaton.maps
    flat = State("flat", np.array([[0, 1, 0, 1], [0, 0, 1, 1], [0, 0, 0, 0]]))
    assert flat.inverse is None


def test_automata_are_values():
    automaton = random_automaton(11)
    assert automaton.children
    twin = pickle.loads(pickle.dumps(automaton))
    assert twin == automaton
    assert hash(twin) == hash(automaton)
    assert twin != renamed(automaton, [1, 0, 2])
    assert not twin.states[0].controls.flags.writeable


# --- digits --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", names())
def test_named_sets_are_found_again_from_their_maps(name):
    digits = named(name)
    assert detect(digits.maps) == digits


def test_sizes_of_the_named_sets():
    sizes = {name: len(named(name).keep) for name in names()}
    assert sizes["menger"] == 20
    assert sizes["vicsek-7"] == 7
    assert sizes["vicsek-9"] == 9
    assert sizes["cantor-dust"] == 8
    assert sizes["mosely-light"] == 18
    assert sizes["mosely-heavy"] == 19
    assert sizes["carpet-prism"] == 24
    assert sizes["cube-minus-centre"] == 26
    assert sizes["edge-cubes"] == 12
    assert sizes["even-parity"] == 4
    assert sizes["minus-corner"] == 7


def test_other_maps_are_no_digit_set():
    third = np.eye(3) / 3
    assert detect([(third, np.array([0.1, 0, 0]))]) is None
    assert detect([(third, np.array([1, 0, 0]))]) is None
    assert detect([(-third, np.array([1 / 3] * 3))]) is None
    assert detect([(np.diag([1 / 3, 1 / 3, 0.5]), np.zeros(3))]) is None
    assert detect([(third, np.zeros(3)), (np.eye(3) / 2, np.zeros(3))]) is None
    assert detect([(np.eye(3) * 0.4, np.zeros(3))]) is None
    assert detect([(np.zeros((3, 3)), np.zeros(3))]) is None
    found = detect([(third, np.array([1 / 3, 0, 2 / 3])), (third, np.zeros(3))])
    assert found is not None
    assert found.keep.tolist() == [[1, 0, 2], [0, 0, 0]]


@pytest.mark.parametrize(
    ("divisions", "keep", "message"),
    [
        (1, [[0, 0, 0]], "divisions = 1"),
        (3, [], "k ≥ 1"),
        (3, [[0, 0]], r"\(k, 3\)"),
        (3, [[0, 0, 3]], r"keep\[0\] = \[0, 0, 3\]; wanted 0 … 2"),
        (3, [[0, 0, 0], [-1, 0, 0]], r"keep\[1\]"),
        (3, [[0, 1, 2], [0, 0, 0], [0, 1, 2]], r"keep\[2\] = \[0, 1, 2\] is there twice"),
        (3, [[0, 0.5, 0]], "whole numbers"),
        (3, "abc", "rows of three"),
    ],
)
def test_bad_digits_are_named(divisions, keep, message):
    with pytest.raises(ModelError, match=message):
        DigitSet(divisions, keep)


def test_names_of_digit_sets():
    with pytest.raises(ModelError, match=r"no set .menge.; there are .*menger"):
        named("menge")
    with pytest.raises(ModelError, match="has divisions = 3; got 4"):
        named("menger", 4)
    assert named("menger", 3) == named("menger")


def test_a_table_of_many_divisions_is_refused_before_it_is_made():
    with pytest.raises(MemoryLimitError, match="sub-cubes"):
        _ = DigitSet(1 << 20, [[0, 0, 0]]).table
