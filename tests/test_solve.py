"""Subdivision matrices under constraints: closed forms, a rational twin, contradictions."""

import itertools
import pickle

import naive_brep as cells
import naive_solve as naive
import numpy as np
import pytest

from porous.errors import ModelError
from porous.models.automaton import expand
from porous.models.brep import (
    Adjacency,
    Boundary,
    BRep,
    CellState,
    Child,
    Incidence,
    find_use,
    selection,
)
from porous.models.constraints import kernel
from porous.models.solve import displacement_weights, solve

DRAWS = 100
RULES = {
    "straight": cells.straight(3),
    "parabola": cells.rough(),
    "rough": cells.rough((0.5, 0.3), (0.45, -0.4, 0.45)),
}
HALVES = [d for d in itertools.product(range(2), repeat=3) if d != (1, 1, 1)]


def all_matrices(solution):
    return [T for group in solution.matrices for T in group]


def gap(a, b):
    return max(np.abs(x - y).max() for x, y in zip(all_matrices(a), all_matrices(b), strict=True))


def rough_columns(rng, shape):
    guess = rng.normal(size=shape)
    return guess + (1 - guess.sum(axis=0)) / shape[0]


def random_moves(rng, solution, share=0.5):
    chosen = [s for s in solution.sliders if rng.random() < share]
    moves = {s.name: rng.normal(size=s.size) for s in chosen}
    return {name: move - move.mean() for name, move in moves.items()}


def changed(old, **changes):
    fields = ("name", "shape", "controls", "boundaries", "children", "incidences", "adjacencies")
    return CellState(**{f: changes.get(f, getattr(old, f)) for f in fields})


def with_states(brep, **changes):
    """The same cells, with fields of the start state changed."""
    new = changed(brep.states[brep.start], **changes)
    return BRep((*brep.states[: brep.start], new, *brep.states[brep.start + 1 :]), brep.start)


# --- closed forms --------------------------------------------------------------------------


@pytest.mark.parametrize("kept", [cells.MENGER, list(itertools.product(range(3), repeat=3))])
def test_a_straight_menger_cell_has_the_free_points_of_the_literature(kept):
    brep = cells.hexa(RULES["straight"], kept, np.random.default_rng(1))
    solution = solve(brep)
    assert [solution.free_points(q) for q in range(4)] == [0, 2, 4, 8]
    assert [solution.degrees_of_freedom(q) for q in range(4)] == [0, 2, 12, 56]
    assert solution.residual <= 1e-14
    assert naive.residual(brep, solution.matrices) <= 1e-14
    assert max(np.abs(T.sum(axis=0) - 1).max() for T in all_matrices(solution)) <= 2e-15


def test_a_carpet_face_has_as_many_free_points_as_a_full_one():
    brep = cells.hexa(RULES["straight"], cells.MENGER)
    face = cells.box_state("carpet", 2, RULES["straight"], cells.CARPET)
    assert (len(face.incidences), len(face.adjacencies)) == (16, 24)
    solution = solve(BRep((*brep.states[:2], face), 2))
    assert (solution.free_points(2), solution.degrees_of_freedom(2)) == (4, 12)


@pytest.mark.parametrize("rule", RULES)
def test_free_points_are_the_points_of_the_children_inside_the_cell(rule):
    brep = cells.hexa(RULES[rule], cells.MENGER)
    solution = solve(brep)
    along = 3 * (len(RULES[rule][0]) - 1)
    for q, state in enumerate(brep.states[1:], 1):
        lattice = state.controls[:q] * (len(RULES[rule][0]) - 1)
        digits = [np.array([int(d) for d in c.name]) for c in state.children]
        points = np.unique(
            np.vstack([(lattice.T + d * (len(RULES[rule][0]) - 1)) for d in digits]), axis=0
        )
        inside = ((points > 0) & (points < along)).all(axis=1)
        assert solution.free_points(q) == inside.sum()


@pytest.mark.parametrize("rule", RULES)
def test_matrices_that_satisfy_every_constraint_come_back_untouched(rule):
    solution = solve(cells.hexa(RULES[rule], cells.MENGER))
    for state, matrices in zip(solution.brep.states, solution.matrices, strict=True):
        for child, matrix in zip(state.children, matrices, strict=True):
            np.testing.assert_allclose(matrix, child.guess, atol=4e-16, rtol=0)


def test_a_spline_follows_from_the_state_of_its_ends():
    rng = np.random.default_rng(2)
    for _ in range(DRAWS):
        solution = solve(cells.chaikin([rough_columns(rng, (3, 3)) for _ in range(2)]))
        assert all(map(np.array_equal, solution.matrices[1], cells.CHAIKIN))
    assert [s.name for s in solution.sliders] == ["end.0.0", "end.0.1"]


def test_a_parabola_keeps_its_ends_and_joins_its_parts():
    rng = np.random.default_rng(3)
    for _ in range(DRAWS):
        guesses = [rough_columns(rng, (3, 3)) for _ in range(2)]
        solution = solve(cells.bezier(guesses))
        first, second = solution.matrices[1]
        assert np.array_equal(first[:, 0], [1, 0, 0])
        assert np.array_equal(second[:, 2], [0, 0, 1])
        joint = (guesses[0][:, 2] + guesses[1][:, 0]) / 2
        np.testing.assert_allclose(first[:, 2], joint, atol=1e-15)
        assert np.array_equal(first[:, 2], second[:, 0])
        np.testing.assert_allclose(first[:, 1], guesses[0][:, 1], atol=1e-15)
    assert [s.name for s in solution.sliders] == ["curve.a.1", "curve.a.2", "curve.b.1"]
    assert [s.direction.tolist() for s in solution.sliders] == [
        [0, 1, 0, 0, 0, 0],
        [0, 0, 1, 1, 0, 0],
        [0, 0, 0, 0, 1, 0],
    ]


def tree(height=0.45):
    """Four subtrees on a trunk that is drawn and never refined; the tops tile a quad."""
    base = cells.box_state("top", 2, cells.straight(2))
    edge = cells.box_state("edge", 1, cells.straight(2))
    trunk = CellState(
        "trunk",
        "edge",
        np.array([[0, 0], [0, 0], [0, 1.0]]),
        tuple(Boundary(n, 0, selection(2, [i])) for i, n in enumerate(("start", "end"))),
    )
    controls = np.array([[0, 0, 1, 1, 0.5], [0, 1, 0, 1, 0.5], [1, 1, 1, 1, 0]])
    top = Boundary("top", 2, selection(5, range(4)))
    sides = [
        Boundary(b.name, b.state, np.vstack([b.matrix, np.zeros((1, b.matrix.shape[1]))]))
        for b in base.boundaries
    ]
    root = Boundary("root", 0, selection(5, [4]))
    node = np.array([*[height / 4] * 4, 1 - height])
    subtrees = [
        Child(
            c.name,
            4,
            np.column_stack([np.vstack([c.guess, np.zeros((1, 4))]), node]),
        )
        for c in base.children
    ]
    trunk_child = Child("trunk", 3, np.column_stack([np.eye(5)[:, 4], node]))
    last = 1 + len(sides)
    state = CellState(
        "tree",
        "hexa",
        controls,
        (top, *sides, root),
        (*subtrees, trunk_child),
        (*(Incidence(i, 0, 0, i) for i in range(4)), Incidence(4, 0, last, 0)),
        tuple(Adjacency(i, last, 4, 1) for i in range(4)),
    )
    return BRep((cells.vertex(), edge, base, trunk, state), 4)


def test_a_tree_has_one_free_node():
    brep = tree()
    solution = solve(brep)
    assert (solution.free_points(4), solution.degrees_of_freedom(4)) == (1, 4)
    assert solution.sliders[-1].name == "tree.00.4"
    guesses = [child.guess for child in brep.states[4].children]
    assert all(map(np.array_equal, solution.matrices[4], guesses))
    lifted = solve(brep, {"tree.00.4": [0.1, 0.1, 0.1, 0.1, -0.4]}).matrices[4]
    for T in lifted:
        np.testing.assert_allclose(T[:, -1], [0.2125] * 4 + [0.15], atol=1e-15)
    assert solution.matrices[3] == ()
    automaton = solution.automaton()
    assert [s.name for s in automaton.states] == ["tree", "trunk"]
    assert automaton.children[1] == ()


# --- a rational twin -----------------------------------------------------------------------


def same_as_twin(brep):
    solution = solve(brep)
    matrices, free = naive.nearest(brep)
    for mine, his in zip(solution.matrices, matrices, strict=True):
        for T, exact in zip(mine, his, strict=True):
            np.testing.assert_allclose(T, np.array(exact, float), atol=1e-12, rtol=0)
    expected = [0 if q.size == 1 else f for q, f in zip(brep.states, free, strict=True)]
    assert [solution.free_points(q) for q in range(len(free))] == expected


@pytest.mark.parametrize("facets", [False, True])
def test_the_twin_solves_volumes_alike(facets):
    rng = np.random.default_rng(4)
    for _ in range(12):
        count = int(rng.integers(1, 9))
        digits = [tuple(map(int, d)) for d in rng.permutation(list(np.ndindex(2, 2, 2)))[:count]]
        same_as_twin(cells.hexa(cells.straight(2), digits, rng, facets=facets))
    same_as_twin(cells.hexa(cells.straight(3), cells.MENGER, rng, facets=facets))


def dyadic_basis(rng, size):
    """Columns that sum to one, and an inverse without rounding."""
    basis = np.eye(size)
    for column in range(1, size):
        target, source = rng.integers(0, column, 2)
        basis[target, column] += 0.25
        basis[source, column] -= 0.25
        if size == 2:
            basis[:, column] = 0.5
    return basis


def dyadic(rng, shape):
    guess = rng.integers(-32, 33, size=shape) / 64
    guess[-1] += 1 - guess.sum(axis=0)
    return guess


def in_random_weights(rng, brep):
    matrices = [[dyadic(rng, c.guess.shape) for c in q.children] for q in brep.states]
    matrices[0] = [c.guess for c in brep.states[0].children]
    rough = cells.guessing(brep, matrices)
    return cells.in_other_weights(rough, [dyadic_basis(rng, q.size) for q in brep.states])


DIFFERENT = np.array([[1, 0.5, 0.25], [0, 0.5, 0.25], [0, 0, 0.5]])
"""Weights of three new controls in the old."""


def curves_and_cells():
    yield cells.bezier()
    yield cells.chaikin()
    yield BRep(
        (
            cells.vertex(),
            cells.box_state("edge", 1, cells.straight(2)),
            cells.box_state("quad", 2, cells.straight(2)),
        ),
        2,
    )


def test_the_twin_solves_boundaries_of_any_weights_alike():
    rng = np.random.default_rng(5)
    for _ in range(10):
        for brep in curves_and_cells():
            same_as_twin(in_random_weights(rng, brep))


def test_other_weights_make_as_much_free_and_the_same_matrices_where_nothing_is():
    rng = np.random.default_rng(6)
    for _ in range(20):
        bases = [np.eye(2), rough_columns(rng, (3, 3)) / 4 + 0.75 * np.eye(3)]
        moved = solve(cells.in_other_weights(cells.chaikin(), bases))
        for mine, T in zip(moved.matrices[1], cells.CHAIKIN, strict=True):
            expected = np.linalg.solve(bases[1], T @ bases[1])
            np.testing.assert_allclose(mine, expected, atol=1e-11)


def test_a_kernel_vector_is_one_at_its_own_first_place():
    rng = np.random.default_rng(7)
    for _ in range(DRAWS):
        n, rank = int(rng.integers(1, 9)), int(rng.integers(0, 6))
        C = rng.normal(size=(n, rank)) @ rng.normal(size=(rank, 7))
        basis = kernel(C)
        assert len(basis) == n - np.linalg.matrix_rank(C)
        assert np.abs(basis @ C).max(initial=0) < 1e-9
        firsts = [int(np.flatnonzero(v)[0]) for v in basis]
        assert firsts == sorted(firsts)
        np.testing.assert_array_equal(basis[:, firsts], np.eye(len(basis)))


# --- whatever the guess and the sliders ------------------------------------------------------


def test_guesses_and_sliders_never_tear():
    rng = np.random.default_rng(8)
    whole = {rule: cells.hexa(RULES[rule], cells.MENGER) for rule in ("straight", "rough")}
    for draw in range(DRAWS):
        rule, full = list(whole.items())[draw % 2]
        brep = cells.hexa(RULES[rule], cells.MENGER, rng, facets=draw % 4 < 2)
        moves = random_moves(rng, solve(brep))
        solution = solve(brep, moves)
        assert solution.residual < 1e-12
        # Constraints on faces say everything about edges and vertices.
        assert naive.residual(full, solution.matrices) < 1e-12
        assert max(np.abs(T.sum(axis=0) - 1).max() for T in all_matrices(solution)) < 1e-13


def test_sliders_of_any_weights_never_tear():
    rng = np.random.default_rng(9)
    for _ in range(40):
        for plain in curves_and_cells():
            brep = in_random_weights(rng, plain)
            moves = random_moves(rng, solve(brep))
            solution = solve(brep, moves)
            assert naive.residual(brep, solution.matrices) < 1e-12
            assert max(np.abs(T.sum(axis=0) - 1).max() for T in all_matrices(solution)) < 1e-12


def test_random_menger_cells_share_what_the_complex_says():
    rng = np.random.default_rng(10)
    for _ in range(5):
        brep = cells.hexa(RULES["straight"], cells.MENGER, rng, facets=True)
        solution = solve(brep, random_moves(rng, solve(brep)))
        level = np.hstack(solution.matrices[3])
        for wanted in (64, 896):
            assert len(np.unique(level.T.round(9), axis=0)) == wanted
            cubes = np.split(level, level.shape[1] // 8, axis=1)
            level = np.hstack([cube @ T for cube in cubes for T in solution.matrices[3]])


def test_a_move_adds_to_the_nearest_matrices_and_nothing_else():
    rng = np.random.default_rng(11)
    brep = cells.hexa(RULES["rough"], cells.MENGER, rng)
    still = solve(brep)
    volume = [s for s in still.sliders if s.state == 3]
    for slider in [volume[i] for i in rng.integers(0, len(volume), 10)]:
        move = rng.normal(size=27)
        move -= move.mean()
        moved = solve(brep, {slider.name: move})
        change = np.hstack(moved.matrices[3]) - np.hstack(still.matrices[3])
        np.testing.assert_allclose(change, np.outer(move, slider.direction), atol=1e-14)
        assert slider.size == 27


def test_a_move_of_an_edge_moves_all_its_faces_and_volumes():
    brep = cells.hexa(RULES["parabola"], cells.MENGER)
    move = np.array([0.2, -0.3, 0.1])
    solution = solve(brep, {"edge.0.1": move})
    assert gap(solution, solve(brep)) > 0.1
    assert naive.residual(brep, solution.matrices) < 1e-15
    for q in (2, 3):
        state = brep.states[q]
        for at in state.incidences:
            if state.boundaries[at.face].state == 1 and at.letter == 0:
                sides = brep.states[state.children[at.child].state].boundaries
                mine = solution.matrices[q][at.child] @ sides[at.boundary].matrix
                shift = (
                    mine[:, 1] - (state.children[at.child].guess @ sides[at.boundary].matrix)[:, 1]
                )
                expected = state.boundaries[at.face].matrix @ move
                np.testing.assert_allclose(shift, expected, atol=1e-15)


def test_what_is_solved_stays():
    rng = np.random.default_rng(12)
    for rule in RULES.values():
        brep = cells.hexa(rule, cells.MENGER, rng)
        solution = solve(brep, random_moves(rng, solve(brep)))
        again = solve(cells.guessing(brep, solution.matrices))
        assert all(map(np.array_equal, all_matrices(again), all_matrices(solution)))
    for plain in curves_and_cells():
        brep = in_random_weights(rng, plain)
        solution = solve(brep)
        assert gap(solve(cells.guessing(brep, solution.matrices)), solution) < 1e-13


def test_nothing_feasible_is_nearer_to_the_guess():
    # Pythagoras: the step to the nearest is at right angles to all that is free.
    rng = np.random.default_rng(13)
    for draw in range(DRAWS):
        plain = list(curves_and_cells())[draw % 3]
        brep = in_random_weights(rng, plain)
        q = brep.start
        solution = solve(brep)
        guess = np.hstack([c.guess for c in brep.states[q].children])
        nearest = np.hstack(solution.matrices[q])
        own = {s.name for s in solution.sliders if s.state == q}
        moves = {n: m for n, m in random_moves(rng, solution, 1).items() if n in own}
        other = np.hstack(solve(brep, moves).matrices[q])
        assert np.linalg.norm(other - guess) >= np.linalg.norm(nearest - guess) - 1e-12
        squares = [
            ((a - b) ** 2).sum() for a, b in [(other, guess), (nearest, guess), (other, nearest)]
        ]
        assert squares[0] == pytest.approx(squares[1] + squares[2], rel=1e-11)


def test_names_and_order_of_states_change_nothing():
    rng = np.random.default_rng(14)
    for _ in range(20):
        brep = cells.hexa(cells.straight(2), HALVES, rng)
        solution = solve(brep)
        order = rng.permutation(4).tolist()
        place = np.argsort(order).tolist()
        states = [
            CellState(
                "new " + q.name,
                q.shape,
                q.controls,
                tuple(Boundary(b.name, place[b.state], b.matrix) for b in q.boundaries),
                tuple(Child(c.name, place[c.state], c.guess) for c in q.children),
                q.incidences,
                q.adjacencies,
            )
            for q in (brep.states[i] for i in order)
        ]
        other = solve(BRep(tuple(states), place[3]))
        for i, q in enumerate(order):
            assert all(map(np.array_equal, other.matrices[i], solution.matrices[q]))
        assert [s.name for s in other.sliders] == ["new " + s.name for s in solution.sliders]
        assert other.automaton().states[0].name == "new hexa"


def test_the_order_of_constraints_and_children_changes_nothing():
    rng = np.random.default_rng(15)
    for _ in range(20):
        brep = cells.hexa(cells.straight(2), HALVES, rng)
        q = brep.states[3]
        order = rng.permutation(len(q.children)).tolist()
        place = np.argsort(order).tolist()
        first = [i._replace(child=place[i.child]) for i in q.incidences]
        second = [a._replace(child=place[a.child], other=place[a.other]) for a in q.adjacencies]
        other = with_states(
            brep,
            children=tuple(q.children[i] for i in order),
            incidences=tuple(first[i] for i in rng.permutation(len(first))),
            adjacencies=tuple(second[i] for i in rng.permutation(len(second))),
        )
        mine, his = solve(other), solve(brep)
        assert mine.free_points(3) == his.free_points(3)
        for i, child in enumerate(order):
            np.testing.assert_allclose(mine.matrices[3][i], his.matrices[3][child], atol=1e-15)


# --- orders of the controls ------------------------------------------------------------------


def symmetries(lattice):
    """The 48 orders of a cube's controls."""
    for axes in itertools.permutations(range(3)):
        for flips in itertools.product((0, 1), repeat=3):
            moved = lattice[list(axes)]
            moved = np.where(np.array(flips)[:, None], 1 - moved, moved)
            yield [int(np.abs(lattice - p[:, None]).sum(axis=0).argmin()) for p in moved.T]


def relabelled(brep, orders):
    """Children that name their controls in other orders; constraints say so."""
    q = brep.states[3]
    sides = [(k, b.matrix) for k, b in enumerate(q.boundaries)]
    turned = []
    for order in orders:
        kinds = [find_use(selection(8, order) @ B, sides) for _, B in sides]
        turned.append({use.boundary: (k, use.order) for k, use in enumerate(kinds)})

    def constraint(at):
        k, order = turned[at.child][at.boundary]
        if isinstance(at, Incidence):
            return at._replace(boundary=k, order=order)
        other, back = turned[at.other][at.other_boundary]
        inverse = np.argsort(back).tolist()
        order = tuple(inverse[t] for t in order)
        return at._replace(boundary=k, other_boundary=other, order=order)

    children = [
        Child(c.name, 3, c.guess[:, order]) for c, order in zip(q.children, orders, strict=True)
    ]
    return with_states(
        brep,
        children=tuple(children),
        incidences=tuple(map(constraint, q.incidences)),
        adjacencies=tuple(map(constraint, q.adjacencies)),
    )


def test_children_may_name_their_controls_in_any_of_48_orders():
    rng = np.random.default_rng(16)
    every = list(symmetries(cells.box_state("hexa", 3, cells.straight(2)).controls))
    assert len({tuple(order) for order in every}) == 48
    for draw in range(30):
        brep = cells.hexa(cells.straight(2), HALVES, rng, facets=draw % 2 == 0)
        orders = [every[i] for i in rng.integers(0, 48, len(HALVES))]
        other = relabelled(brep, orders)
        mine, his = solve(other), solve(brep)
        assert naive.residual(other, mine.matrices) < 1e-14
        assert mine.free_points(3) == his.free_points(3) == 1
        for T, plain, order in zip(mine.matrices[3], his.matrices[3], orders, strict=True):
            np.testing.assert_allclose(T, plain[:, order], atol=1e-15)


def test_a_spline_glued_backwards():
    brep = cells.chaikin()
    guesses = [np.full((3, 3), 1 / 3)] * 2
    children = tuple(
        Child(c.name, c.state, g) for c, g in zip(brep.states[1].children, guesses, strict=True)
    )
    backwards = with_states(
        brep,
        children=children,
        incidences=(Incidence(0, 0, 0, 0), Incidence(1, 0, 1, 0, (1, 0))),
        adjacencies=(Adjacency(0, 1, 1, 1, (1, 0)),),
    )
    first, second = solve(backwards).matrices[1]
    np.testing.assert_array_equal(first, cells.CHAIKIN[0])
    np.testing.assert_array_equal(second, cells.CHAIKIN[1][:, ::-1])


# --- contradictions --------------------------------------------------------------------------


def chain_of_starts(links):
    """An edge of parts a, b, … whose starts are all one; the last starts at the edge's end."""
    names = "abcdefgh"[: links + 1]
    brep = cells.bezier()
    children = tuple(Child(n, 1, cells.BEZIER[0]) for n in names)
    return with_states(
        brep,
        children=children,
        incidences=(Incidence(0, 0, 0, 0), Incidence(links, 0, 1, 0), Incidence(0, 1, 1, 0)),
        adjacencies=tuple(Adjacency(i, 0, i + 1, 0) for i in range(links)),
    )


@pytest.mark.parametrize("links", [1, 2, 5])
def test_a_chain_that_joins_two_places_is_named_whole(links):
    names = "abcdefgh"
    with pytest.raises(ModelError, match="contradict each other") as caught:
        solve(chain_of_starts(links))
    message = str(caught.value)
    wanted = [
        "curve: a.start = start/0",
        f"curve: {names[links]}.start = end/0",
        *(f"curve: {names[i]}.start = {names[i + 1]}.start" for i in range(links)),
    ]
    assert all(text in message for text in wanted)
    assert message.count(";") == len(wanted)
    assert "a.end" not in message


def named_in(message, brep, q):
    texts = [brep.text(q, at) for at in naive.constraints(brep, q)]
    listed = message.split("each other: ")[1].split("; wanted")[0].split("; ")
    return [texts.index(text) for text in listed]


def test_the_constraints_named_contradict_and_none_can_be_spared():
    rng = np.random.default_rng(17)
    base = cells.hexa(cells.straight(2), HALVES)
    matrices, _ = naive.nearest(base)
    found = 0
    for draw in range(40):
        q = base.states[3]
        wrong = list(q.incidences)
        edges = [i for i, at in enumerate(wrong) if q.boundaries[at.boundary].state in (1, 2)]
        bad = int(rng.choice(edges))
        letters = 2 ** q.boundaries[wrong[bad].boundary].state
        wrong[bad] = wrong[bad]._replace(letter=(wrong[bad].letter + 1) % letters)
        brep = with_states(base, incidences=tuple(wrong[:: 1 if draw % 2 else -1]))
        with pytest.raises(ModelError, match="state hexa: constraints contradict") as caught:
            solve(brep)
        named = named_in(str(caught.value), brep, 3)
        assert naive.contradictory(brep, 3, named, matrices)
        for one in named:
            assert not naive.contradictory(brep, 3, [n for n in named if n != one], matrices)
        assert len(named) <= 3
        found += brep.text(3, wrong[bad]) in str(caught.value)
    assert found == 40


def test_contradictions_in_any_weights_are_named_alike():
    rng = np.random.default_rng(18)
    for links in (1, 3):
        brep = chain_of_starts(links)
        bases = [np.eye(1), dyadic_basis(rng, 3) @ DIFFERENT]
        general = cells.in_other_weights(brep, bases)
        with pytest.raises(ModelError, match="contradict each other") as caught:
            solve(general)
        assert len(named_in(str(caught.value), general, 1)) == links + 2


def twice_at_the_start(gap):
    """A spline whose first part starts like either of two ends, which are a gap apart."""
    brep = cells.chaikin()
    other = cells.CHAIKIN_END + np.array([[gap, 0], [-gap, 0]])
    end = changed(brep.states[0], children=(*brep.states[0].children, Child("1", 0, other)))
    starts = Incidence(0, 0, 0, 0), Incidence(0, 0, 0, 1)
    return BRep((end, changed(brep.states[1], incidences=starts)), 1)


def test_rounding_is_no_contradiction():
    assert solve(twice_at_the_start(5e-10)).residual == pytest.approx(5e-10)
    with pytest.raises(
        ModelError, match=r": curve: a\.start = start/0; curve: a\.start = start/1;"
    ):
        solve(twice_at_the_start(5e-9))
    general = cells.in_other_weights(twice_at_the_start(5e-10), [np.eye(2), DIFFERENT])
    # The gap is 1e-9 in these weights; the nearest is in the middle.
    assert solve(general).residual == pytest.approx(5e-10, rel=1e-6)
    general = cells.in_other_weights(twice_at_the_start(5e-8), [np.eye(2), DIFFERENT])
    with pytest.raises(
        ModelError, match=r": curve: a\.start = start/0; curve: a\.start = start/1;"
    ):
        solve(general)


# --- sliders that are refused ----------------------------------------------------------------


def refused(message, moves, brep=None):
    with pytest.raises(ModelError, match=message):
        solve(brep or cells.hexa(RULES["straight"], cells.MENGER), moves)


def test_a_slider_that_is_not_there_is_named_with_the_nearest():
    refused(r"'edge\.0\.2' is not there; the nearest of 14 is 'edge\.0\.1'", {"edge.0.2": [0, 0]})
    refused("'x' is not there; the nearest of", {"x": [0, 0]})
    alone = BRep((cells.vertex(),))
    refused("'x' is not there; nothing is free", {"x": [0]}, alone)


def test_a_name_of_two_sliders_is_refused():
    brep = cells.bezier()
    twice = with_states(brep, children=tuple(Child("a", 1, T) for T in cells.BEZIER))
    refused("is 2 sliders; wanted one", {"curve.a.1": [0.1, -0.1, 0]}, twice)


def test_moves_of_a_wrong_sum_or_length_are_refused():
    refused(r"edge\.0\.1: got weights that sum to 0\.1; wanted 0", {"edge.0.1": [0.2, -0.1]})
    refused(r"wanted 2 weights that sum to zero, or 3 of a displacement", {"edge.0.1": [0.2] * 4})
    refused(r"wanted finite numbers", {"edge.0.1": [np.nan, 0]})
    refused(r"wanted numbers", {"edge.0.1": ["a", "b"]})
    refused(r"got numbers of shape \(2, 1\)", {"edge.0.1": [[0.1], [-0.1]]})
    refused(r"weights that sum to zero$", {"curve.a.1": [0.2]}, cells.bezier())
    refused(r"sum to 0\.3; wanted 0", {"curve.a.1": [0.1, 0.1, 0.1]}, cells.bezier())


def test_decimals_are_mended():
    brep = cells.bezier()
    solution = solve(brep, {"curve.a.1": [0.3333333333, -0.6666666667, 0.3333333334 + 1e-11]})
    assert max(np.abs(T.sum(axis=0) - 1).max() for T in all_matrices(solution)) < 1e-15
    guesses = [T * (1 + 1e-10) for T in cells.BEZIER]
    sums = [T.sum(axis=0) for T in solve(cells.bezier(guesses)).matrices[1]]
    np.testing.assert_allclose(sums, 1, atol=4e-16, rtol=0)
    assert solve(cells.bezier(guesses)).matrices[1][0][2, 1] == 0


# --- displacements ---------------------------------------------------------------------------

STRETCH = np.array([[2, 0.3, 0], [0.1, 3, 0.2], [0, 0.4, 5]])
ORIGIN = np.array([[1], [-2], [0.5]])


def lattice_state(dimension, along):
    state = cells.box_state("box", dimension, [np.eye(along)])
    return CellState("box", state.shape, STRETCH @ state.controls + ORIGIN)


def monomials(dimension, along, x):
    powers = list(itertools.product(range(along), repeat=dimension))
    return np.array([np.prod(x[:dimension] ** p) for p in powers])


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("along", [2, 3])
def test_a_displacement_is_exact_on_every_polynomial_of_the_cell(dimension, along):
    rng = np.random.default_rng(19)
    state = lattice_state(dimension, along)
    inverse = np.linalg.inv(STRETCH)
    for _ in range(20):
        weights = rough_columns(rng, (state.size, 1))[:, 0] * 0.1 + 0.9 / state.size
        step = STRETCH[:, :dimension] @ rng.normal(size=dimension) * 0.1
        move = displacement_weights(state, weights, step)
        assert abs(move.sum()) < 1e-14
        np.testing.assert_allclose(state.controls @ move, step, atol=1e-12)
        start = state.controls @ weights

        def at(x):
            return monomials(dimension, along, inverse @ (x - ORIGIN[:, 0]))

        nodes = np.stack([at(x) for x in state.controls.T], axis=1)
        np.testing.assert_allclose(nodes @ move, at(start + step) - at(start), atol=1e-10)


@pytest.mark.parametrize("shape", ["triangle", "tetra", "octa"])
def test_simplices_and_octahedra_are_displaced_by_the_smallest_weights(shape):
    rng = np.random.default_rng(20)
    controls = {
        "triangle": np.array([[0, 2, 0], [0, 0, 3], [0, 0, 0.0]]),
        "tetra": np.hstack([np.zeros((3, 1)), np.diag([1.0, 2, 3])]),
        "octa": np.kron(np.diag([1.0, 2, 3]), [[-1, 1]]),
    }[shape]
    state = CellState(shape, shape, controls)
    for _ in range(10):
        step = rng.normal(size=3) * [1, 1, shape != "triangle"]
        move = displacement_weights(state, np.full(state.size, 1 / state.size), step)
        assert abs(move.sum()) < 1e-14
        np.testing.assert_allclose(controls @ move, step, atol=1e-12)
        # The smallest: at right angles to whatever moves nothing.
        idle = kernel(np.vstack([controls, np.ones(state.size)]).T)
        assert np.abs(idle @ move).max(initial=0) < 1e-13


def test_three_numbers_displace_a_free_point():
    brep = cells.hexa(RULES["parabola"], cells.MENGER)
    still = solve(brep)
    step = np.array([0.03, -0.02, 0.01])
    slider = next(s for s in still.sliders if s.state == 3)
    moved = solve(brep, {slider.name: step})
    places = [brep.states[3].controls @ np.hstack(s.matrices[3]) for s in (still, moved)]
    np.testing.assert_allclose(places[1] - places[0], np.outer(step, slider.direction), atol=1e-14)
    along = solve(cells.hexa(RULES["straight"], cells.MENGER), {"edge.0.1": [0.1, 0, 0]})
    np.testing.assert_allclose(along.matrices[1][0][:, 1], [2 / 3 - 0.1, 1 / 3 + 0.1], atol=1e-15)


def test_a_displacement_that_the_cell_does_not_reach_is_refused():
    refused(r"state edge: got displacement \[0\.0, 0\.1, 0\.0\]", {"edge.0.1": [0, 0.1, 0]})
    flat = CellState("flat", "quad", np.zeros((3, 4)))
    with pytest.raises(ModelError, match="all that its 4 controls reach"):
        displacement_weights(flat, [0.25] * 4, [1, 0, 0])


# --- the automaton and the value -------------------------------------------------------------


def test_the_automaton_draws_what_was_solved():
    rng = np.random.default_rng(21)
    brep = cells.hexa(RULES["straight"], cells.MENGER)
    solution = solve(brep, random_moves(rng, solve(brep)))
    controls = rng.normal(size=(3, 8))
    automaton = solution.automaton(controls, scale=2.0)
    assert [s.name for s in automaton.states] == ["hexa"]
    ((_, points),) = expand(automaton, 1)
    expected = [2 * controls @ T for T in solution.matrices[3]]
    np.testing.assert_allclose(points, expected, atol=1e-13)
    plain = solution.automaton()
    np.testing.assert_array_equal(plain.states[0].controls, brep.states[3].controls)
    assert plain.transitions[0] is automaton.transitions[0]
    with pytest.raises(ModelError, match=r"controls of hexa: got shape \(3, 7\); wanted \(3, 8\)"):
        solution.automaton(np.zeros((3, 7)))
    with pytest.raises(ModelError, match="wanted finite numbers"):
        solution.automaton(np.full((3, 8), np.inf))


def test_solutions_compare_by_content_and_pickle():
    brep = cells.hexa(cells.straight(2), HALVES)
    first, second = solve(brep), solve(brep)
    assert first == second
    assert hash(first) == hash(second)
    assert first != solve(brep, {"edge.0.1": [0.1, -0.1]})
    first.automaton()
    again = pickle.loads(pickle.dumps(first))
    assert again == first
    assert not again.matrices[3][0].flags.writeable
