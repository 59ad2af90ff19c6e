"""Contractivity in three values: literature values, exact refusals, bounds that hold."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rough import BEZIER, curve, rough, sponge, straight, tetrahedra_and_octahedra

from porous.errors import ModelError
from porous.models.automaton import Automaton, State, Transition, of_maps
from porous.models.contraction import check_contracts, contractivity, dobrushin
from porous.models.digits import named
from porous.models.shrinking import _characteristic, _integers, _schur, _schur_rounded, shrinks

FERN = [
    [[0.85, 0.04], [-0.04, 0.85]],
    [[0, 0], [0, 0.16]],
    [[0.2, -0.26], [0.23, 0.22]],
    [[-0.15, 0.28], [0.26, 0.24]],
]
ROTATING = np.array([[0, -1.2], [0.5, 0]])


def system(matrices, third=0.1):
    """Plane maps as maps of space, z shrunk by ``third``."""
    result = []
    for matrix in matrices:
        A = np.eye(3) * third
        n = len(matrix)
        A[:n, :n] = matrix
        result.append((A, np.zeros(3)))
    return of_maps(result)


def test_the_fern():
    found = contractivity(system(FERN))
    assert found.answer == "yes"
    assert found.lower == pytest.approx(0.8509407, abs=1e-7)
    assert found.upper == pytest.approx(0.8509407, abs=1e-7)
    assert found.word == (0,)


def test_maps_that_stretch_but_contract_together():
    pair = [ROTATING, -ROTATING]
    assert np.linalg.norm(ROTATING, 2) == pytest.approx(1.2)
    found = contractivity(system(pair))
    assert found.answer == "yes"
    assert found.lower == pytest.approx(np.sqrt(0.6), abs=1e-9)
    assert found.upper == pytest.approx(np.sqrt(0.6), abs=1e-6)


def test_a_word_that_stretches_is_named():
    # Each map shrinks again and again, their product does not.
    up, down = np.diag([0.0, 0.0]), np.diag([0.0, 0.0])
    up[0, 1], down[1, 0] = 2.0, 0.52
    found = contractivity(system([up, down]))
    assert found.answer == "no"
    assert sorted(found.word) == [0, 1]
    assert found.lower == pytest.approx(np.sqrt(1.04))
    with pytest.raises(
        ModelError, match=r"no attractor: maps 0·1 \(word of length 2.*spectral radius 1.04"
    ):
        check_contracts(system([up, down]))


def test_a_single_map_is_named():
    with pytest.raises(ModelError, match=r"map 1 does not shrink: spectral radius 1\.5"):
        check_contracts(system([np.eye(2) / 2, np.diag([0.1, 1.5])]))


@pytest.mark.parametrize("angle", [0.0, np.pi, 0.7])
def test_what_keeps_its_size_is_not_accepted(angle):
    c, s = np.cos(angle), np.sin(angle)
    found = contractivity(system([np.array([[c, -s], [s, c]])]))
    assert found.answer in ({"no"} if angle != 0.7 else {"no", "unknown"})


def test_within_rounding_of_one_the_answer_is_unknown():
    nearly = system([np.array([[1 - 1e-14, 0.3], [-0.3, 1 - 1e-14]]) / np.hypot(1, 0.3)])
    found = contractivity(nearly)
    assert found.answer == "unknown"
    with pytest.raises(ModelError, match=r"could not be decided: .*lies in \[.*scale the maps"):
        check_contracts(nearly)


def test_near_one_is_still_told_apart():
    for radius, answer in [(1 - 1e-10, "yes"), (1 + 1e-10, "no")]:
        assert contractivity(system([np.diag([radius, 0.5])])).answer == answer


def test_shears_are_told_block_by_block():
    shear = np.array([[0.5, 1000, 3], [0, 0.5, 10], [0, 0, 0.5]])
    found = contractivity(of_maps([(shear, np.zeros(3))] * 20))
    assert found.answer == "yes"
    assert found.upper == pytest.approx(0.5, abs=1e-9)


def test_eigenvalues_of_defective_matrices_do_not_deceive():
    # Floating-point eigenvalues of a Jordan block are off by the root of the rounding error.
    block = np.array([[1 - 1e-9, 1e6], [0, 1 - 1e-9]])
    turned = np.array([[0.6, 0.8], [-0.8, 0.6]])
    assert np.abs(np.linalg.eigvals(turned @ block @ turned.T)).max() > 1 + 1e-7
    assert shrinks(block)
    assert contractivity(system([block])).answer == "yes"


@settings(deadline=None, derandomize=True, max_examples=60)
@given(seed=st.integers(0, 10**6), size=st.integers(1, 6), radius=st.floats(0.5, 1.5))
def test_shrinking_is_decided_exactly(seed, size, radius):
    A = np.random.default_rng(seed).normal(size=(size, size))
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    if abs(radius - 1) > 1e-6:
        assert shrinks(A) == (radius < 1)
        assert shrinks(A, A, A) == (radius < 1)


def test_shrinking_at_the_circle_itself():
    assert not shrinks(np.array([[0.0, -1.0], [1.0, 0.0]]))
    assert not shrinks(np.eye(3))
    assert not shrinks(np.array([[2.0, 0], [0, 0.5]]))
    assert shrinks(np.zeros((2, 2)))
    assert not shrinks(np.array([[0.0, 2.0], [0.0, 0.0]]), np.array([[0.0, 0.0], [0.5, 0.0]]))
    below = np.nextafter(1.0, 0)
    assert shrinks(np.array([[below]]))
    assert not shrinks(np.array([[1.0]]))


def exhaustive(matrices, length):
    """Bounds on the joint spectral radius from all words up to a length."""
    lower, upper = 0.0, np.inf
    for k in range(1, length + 1):
        products = [np.linalg.multi_dot([np.eye(3), *w, np.eye(3)]) for w in words_of(matrices, k)]
        lower = max(lower, *(np.abs(np.linalg.eigvals(p)).max() ** (1 / k) for p in products))
        upper = min(upper, max(np.linalg.norm(p, 2) for p in products) ** (1 / k))
    return lower, upper


def words_of(matrices, length):
    return itertools.product(matrices, repeat=length)


@settings(deadline=None, derandomize=True, max_examples=25)
@given(seed=st.integers(0, 10**6), scale=st.floats(0.1, 0.6))
def test_bounds_enclose_what_all_words_say(seed, scale):
    matrices = np.random.default_rng(seed).normal(size=(2, 3, 3)) * scale
    found = contractivity(of_maps([(A, np.zeros(3)) for A in matrices]))
    lower, upper = exhaustive(matrices, 6)
    assert found.lower <= upper * (1 + 1e-9)
    if found.answer == "no":
        product = np.linalg.multi_dot([np.eye(3), *matrices[list(found.word)], np.eye(3)])
        assert np.abs(np.linalg.eigvals(product)).max() > 1 - 1e-6
        assert upper >= 1 - 1e-9
    else:
        assert found.upper >= lower * (1 - 1e-9)
        assert found.lower <= found.upper
        assert (found.answer == "yes") == (found.upper < 1 - 1e-12)


def test_the_answer_does_not_depend_on_coordinates():
    rng = np.random.default_rng(8)
    pair = [np.pad(ROTATING, (0, 1)), np.pad(-ROTATING, (0, 1))]
    for _ in range(5):
        V = rng.normal(size=(3, 3))
        turned = [(V @ A @ np.linalg.inv(V), rng.normal(size=3)) for A in pair]
        found = contractivity(of_maps(turned))
        assert found.answer == "yes"
        assert found.lower == pytest.approx(np.sqrt(0.6), abs=1e-6)
        assert found.upper < 0.8


# --- automata ------------------------------------------------------------------------------


def two_states(ab, ba, aa=None):
    """Two frames of space: a → b scales by ``ab``, b → a by ``ba``, a → a by ``aa``."""
    frame = State("f", np.hstack([np.zeros((3, 1)), np.eye(3)]))

    def move(source, target, ratio):
        return Transition(
            source, target, of_maps([(np.eye(3) * ratio, [0] * 3)]).transitions[0].matrix
        )

    moves = [move(0, 1, ab), move(1, 0, ba)]
    return Automaton((frame, frame), (*moves, *([move(0, 0, aa)] if aa else [])))


def test_only_closed_words_count():
    # Stretching by ten on the way there is paid for on the way back.
    found = contractivity(two_states(10.0, 0.05))
    assert found.answer == "yes"
    assert found.upper == pytest.approx(np.sqrt(0.5), abs=1e-6)
    assert contractivity(two_states(10.0, 0.11)).answer == "no"
    assert contractivity(two_states(10.0, 0.05, 0.9)).upper == pytest.approx(0.9, abs=1e-6)


def test_a_transient_state_may_stretch():
    frame = State("f", np.hstack([np.zeros((3, 1)), np.eye(3)]))
    grow, half = (of_maps([(np.eye(3) * r, [0] * 3)]).transitions[0].matrix for r in (7.0, 0.5))
    automaton = Automaton((frame, frame), (Transition(0, 1, grow), Transition(1, 1, half)))
    found = contractivity(automaton)
    assert found.answer == "yes"
    assert found.upper == pytest.approx(0.5, abs=1e-9)
    ends = Automaton((frame, frame), (Transition(0, 1, grow),))
    assert contractivity(ends).answer == "yes"


def hexahedron(keep, divisions):
    """Regular subdivision of a hexahedron's eight controls."""
    n = divisions
    lines = [np.array([[1 - d / n, 1 - (d + 1) / n], [d / n, (d + 1) / n]]) for d in range(n)]
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=3))).T
    matrices = [np.kron(np.kron(lines[x], lines[y]), lines[z]) for x, y, z in keep]
    cell = State("hexahedron", corners)
    return Automaton((cell,), tuple(Transition(0, 0, T) for T in matrices))


def test_weights_that_sum_to_zero():
    automaton = hexahedron(named("menger").keep, 3)
    matrices = [t.matrix for t in automaton.transitions]
    assert max(map(dobrushin, matrices)) == pytest.approx(0.7037, abs=5e-5)
    pairs = [a @ b for a in matrices for b in matrices]
    assert max(map(dobrushin, pairs)) == pytest.approx(0.29767, abs=5e-6)
    found = contractivity(automaton)
    assert found.answer == "yes"
    assert found.lower == pytest.approx(1 / 3, abs=1e-9)
    assert found.upper < 0.34


def test_signed_weights_that_do_not_contract():
    bump = np.array([[1.0, 2.5, 0.5], [0.0, -4.0, 0.0], [0.0, 2.5, 0.5]])
    automaton = Automaton((State("curve", np.eye(3)),), (Transition(0, 0, bump),))
    assert contractivity(automaton).answer == "no"


@pytest.mark.parametrize("name", ["menger", "cube-minus-centre", "full-3"])
def test_similarities_need_no_search(name):
    found = contractivity(of_maps(named(name).maps))
    assert (found.answer, found.lower) == ("yes", pytest.approx(1 / 3, abs=1e-12))
    assert found.upper == pytest.approx(1 / 3, abs=1e-12)


# --- states of many controls -----------------------------------------------------------------

HEIGHTS = (0.5, 0.3)


@pytest.mark.parametrize(
    ("rules", "radius"),
    [
        (straight(3), 1 / 3),
        (straight(2), 1 / 2),
        (BEZIER, 1 / 3),
        (rough(HEIGHTS, (0.3, 0.3, 0.3)), 1 / 3),
        (rough(HEIGHTS, (0.45, -0.4, 0.45)), 0.45),
        (rough(HEIGHTS, (0.9, -0.9, 0.9)), 0.9),
        (rough(HEIGHTS, (0.98, 0.98, 0.98)), 0.98),
        (rough((0.5,), (0.7, 0.7)), 0.7),
    ],
)
def test_tensor_products_are_decided_by_the_curve_s_texture(rules, radius):
    # The joint spectral radius of rules that are triangular together: the largest diagonal entry.
    found = contractivity(sponge(rules))
    assert found.answer == "yes"
    assert found.lower == pytest.approx(radius, abs=1e-9)
    assert radius - 1e-9 <= found.upper <= radius + 1e-5


@pytest.mark.parametrize("texture", [(1.0, 1.0, 1.0), (-1.1, 0.3, 0.2), (0.2, 0.2, 1.1)])
def test_textures_that_do_not_shrink_are_refused_by_the_word(texture):
    automaton = sponge(rough(HEIGHTS, texture))
    found = contractivity(automaton)
    assert found.answer == "no"
    matrices = [t.matrix[:-1, :-1] - t.matrix[:-1, -1:] for t in automaton.transitions]
    product = np.linalg.multi_dot([np.eye(26), *(matrices[i] for i in found.word), np.eye(26)])
    assert np.abs(np.linalg.eigvals(product)).max() > 1 - 1e-6
    with pytest.raises(ModelError, match=f"map {found.word[0]} does not shrink"):
        check_contracts(automaton)


def test_textures_that_shrink_by_rounding_alone_are_not_accepted():
    # No word's exact spectral radius reaches one: the products of rounded numbers miss it.
    automaton = sponge(rough(HEIGHTS, (0.3, 0.2, -1.0)))
    found = contractivity(automaton)
    assert (found.answer, found.lower) == ("unknown", pytest.approx(1, abs=1e-12))
    with pytest.raises(ModelError, match=rf"decided: .*map {found.word[0]} comes closest"):
        check_contracts(automaton)


def test_tau_of_many_controls_says_less():
    # Dobrushin's coefficient of level 1 and 2: above one though the textures shrink.
    levels = []
    automaton = sponge(rough(HEIGHTS, (0.45, -0.4, 0.45)))
    words = [t.matrix for t in automaton.transitions]
    levels.append(max(map(dobrushin, words)))
    corner = [words[i] @ words[j] for i in (0, 7, 12) for j in range(len(words))]
    levels.append(max(map(dobrushin, corner)))
    assert levels[0] == pytest.approx(1.663, abs=5e-4)
    assert 1 < levels[1] < 1.1525
    bezier = [t.matrix for t in sponge(BEZIER).transitions]
    assert max(map(dobrushin, bezier)) == pytest.approx(0.91221, abs=5e-6)


@settings(deadline=None, derandomize=True, max_examples=100)
@given(seed=st.integers(0, 10**6), divisions=st.integers(2, 4))
def test_curves_shrink_where_their_diagonals_do(seed, divisions):
    rng = np.random.default_rng(seed)
    rules = rough(rng.normal(size=divisions - 1), rng.uniform(-1.2, 1.2, size=divisions))
    radius = max(1 / divisions, *(abs(np.trace(T) - 1 - 1 / divisions) for T in rules))
    # In any coordinates, those of a permutation of the controls for one.
    order = rng.permutation(3)
    automaton = curve([T[np.ix_(order, order)] for T in rules], rng.normal(size=(3, 2)))
    found = contractivity(automaton)
    assert found.answer == ("yes" if radius < 1 else "no")
    assert found.lower == pytest.approx(radius, abs=1e-6) or found.answer == "no"


@settings(deadline=None, derandomize=True, max_examples=40)
@given(seed=st.integers(0, 10**6), size=st.integers(4, 9), scale=st.floats(0.2, 1.2))
def test_hidden_triangles_are_found(seed, size, scale):
    rng = np.random.default_rng(seed)
    upper = np.triu(rng.normal(size=(3, size, size)), 1) * 3
    upper[:, range(size), range(size)] = rng.uniform(-scale, scale, size=(3, size))
    V = np.linalg.qr(rng.normal(size=(size, size)))[0]
    A = np.pad(V @ upper @ V.T, ((0, 0), (0, 1), (0, 1)))
    # Columns that sum to one, with that action on weights that sum to zero.
    A[:, -1] = 1 - A.sum(axis=1)
    controls = State("cell", rng.normal(size=(3, size + 1)))
    automaton = Automaton((controls,), tuple(Transition(0, 0, T) for T in A))
    radius = np.abs(upper[:, range(size), range(size)]).max()
    found = contractivity(automaton)
    if abs(radius - 1) > 0.01:
        assert found.answer == ("yes" if radius < 1 else "no")
    assert found.answer == "no" or found.lower <= radius * (1 + 1e-6) <= found.upper * (1 + 1e-5)


def test_blocks_that_turn_are_told_too():
    # Rotating maps that stretch singly, hidden among seven coordinates with what they drive.
    rng = np.random.default_rng(4)
    V = np.linalg.qr(rng.normal(size=(7, 7)))[0]
    matrices = []
    for sign in (1, -1):
        A = np.triu(rng.normal(size=(7, 7)), 1) * 0.5
        A[range(7), range(7)] = rng.uniform(-0.6, 0.6, 7)
        A[2:4, 2:4] = sign * ROTATING
        matrices.append(np.pad(V @ A @ V.T, ((0, 1), (0, 1))))
        matrices[-1][-1] = 1 - matrices[-1].sum(axis=0)
    state = State("cell", rng.normal(size=(3, 8)))
    found = contractivity(Automaton((state,), tuple(Transition(0, 0, T) for T in matrices)))
    assert found.answer == "yes"
    assert found.lower == pytest.approx(np.sqrt(0.6), abs=1e-6)
    assert found.upper < 0.8


def test_states_of_several_sizes():
    # Tetrahedra and octahedra: every child is half its parent.
    found = contractivity(tetrahedra_and_octahedra())
    assert (found.answer, found.lower) == ("yes", pytest.approx(0.5, abs=1e-9))
    assert found.upper == pytest.approx(0.5, abs=3e-3)


def test_terminal_states_do_not_disturb():
    cell, strut = State("cell", np.eye(3)), State("strut", np.eye(3)[:, :2])
    grow = np.array([[5.0, -3.0], [-4.0, 2.0], [0.0, 2.0]])
    rules = [Transition(0, 0, T) for T in rough(HEIGHTS, (0.9, 0.2, 0.1))]
    alone = contractivity(Automaton((cell,), tuple(rules)))
    found = contractivity(Automaton((cell, strut), (*rules, Transition(0, 1, grow))))
    assert (found.answer, found.lower, found.upper) == ("yes", alone.lower, alone.upper)


def test_vertices_of_one_control_always_shrink():
    vertex = State("vertex", np.zeros((3, 1)))
    assert contractivity(Automaton((vertex,), (Transition(0, 0, np.eye(1)),))).answer == "yes"


@pytest.mark.parametrize("seed", range(8))
def test_numbers_cut_short_decide_as_whole_ones_do(seed):
    A = np.random.default_rng(seed).normal(size=(12, 12))
    A *= (0.999 if seed % 2 else 1.001) / np.abs(np.linalg.eigvals(A)).max()
    polynomial = _characteristic(*_integers(A))
    assert _schur_rounded(polynomial) == _schur(polynomial) == bool(seed % 2)
    assert shrinks(A) == bool(seed % 2)
    # A root on the circle is too close to tell: left to the whole numbers.
    assert _schur_rounded([-1, 0, 1]) is None
