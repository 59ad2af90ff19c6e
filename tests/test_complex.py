"""Cell complexes: which cells share what, how many there are of each, and what holes they leave."""

import itertools
import time
from types import SimpleNamespace

import naive_complex as naive
import naive_oracle
import numpy as np
import pytest

from porous.errors import MemoryLimitError, ModelError
from porous.models import digits as sets
from porous.models.automaton import cells
from porous.models.betti import betti
from porous.models.brep import Adjacency, Boundary, BRep, CellState, Child, Incidence, selection
from porous.models.builders import Options, build_cell
from porous.models.closure import closure
from porous.models.complex import CellEntities, Complex, cell_complex
from porous.models.counts import boundary_count, counts, euler_number
from porous.models.digits import DigitSet
from porous.models.oracle import Prefractal
from porous.models.solve import solve

NAMES = (
    "menger",
    "full-2",
    "full-3",
    "mosely-heavy",
    "mosely-light",
    "vicsek-7",
    "vicsek-9",
    "cantor-dust",
    "even-parity",
    "edge-cubes",
    "minus-corner",
)


def given(brep):
    """A system whose guesses are its matrices."""
    matrices = tuple(tuple(c.guess for c in state.children) for state in brep.states)
    return SimpleNamespace(brep=brep, matrices=matrices)


def box(name_or_set):
    chosen = sets.named(name_or_set) if isinstance(name_or_set, str) else name_or_set
    return naive.box_system(chosen.divisions, chosen.keep)


def arrays(made, level, start=None):
    found = cell_complex(made, level, start)
    return tuple(found.count(d) for d in range(4))


def union(digits, level):
    """Numbers of vertices, edges, faces and cells of the closed union, from the oracle."""
    body = Prefractal(digits, level)
    return tuple(body.count(name) for name in ("vertices", "edges", "faces", "cells"))


@pytest.mark.parametrize("name", NAMES)
def test_hexahedra_share_what_closed_voxels_share(name):
    made = closure(solve(box(name)))
    digits = sets.named(name)
    for level in range(3):
        wanted = union(digits, level)
        assert arrays(made, level) == counts(made, level) == wanted
        assert euler_number(made, level) == Prefractal(digits, level).count("euler_number_26")
        faces = Prefractal(digits, level).faces
        assert boundary_count(made, level) == faces
    solid = naive_oracle.voxels(digits.divisions, digits.keep, 2)
    found = cell_complex(made, 2)
    assert found.components == naive_oracle.components(solid, 26)
    assert found.euler_number == naive_oracle.euler_number_26(solid)


def test_random_digit_sets_share_what_closed_voxels_share():
    rng = np.random.default_rng(11)
    for draw in range(10):
        n = 2 + draw % 2
        digits = DigitSet(n, naive_oracle.random_digits(rng, n))
        made = closure(given(box(digits)))
        for level in range(3):
            assert arrays(made, level) == counts(made, level) == union(digits, level)
        assert counts(made, 9) == union(digits, 9)


@pytest.mark.parametrize("cell", ["hex-8", "hex-27"])
def test_built_cells_are_the_same_complex(cell):
    for name in ("menger", "minus-corner"):
        made = closure(solve(build_cell(Options(cell, (sets.named(name),)))))
        for level in range(4):
            assert arrays(made, level) == counts(made, level) == union(sets.named(name), level)


def test_minus_corner_at_four_levels():
    made = closure(given(box("minus-corner")))
    assert arrays(made, 1) == (26, 51, 33, 7)
    assert arrays(made, 4) == (3893, 10521, 9186, 2401)
    assert [euler_number(made, n) for n in range(1, 5)] == [1, 2, 18, 157]


def test_menger_has_its_closed_forms_at_any_level():
    made = closure(given(box("menger")))
    # V = 192/133 + (192/85) 3ⁿ + (88/35) 8ⁿ + (576/323) 20ⁿ and its like, over 11305 = 5·7·17·19.
    for level in (0, 1, 2, 3, 4, 50):
        v = 16320 + 25536 * 3**level + 28424 * 8**level + 20160 * 20**level
        e = 25536 * 3**level + 54264 * 8**level + 55860 * 20**level
        exact = v // 11305, e // 11305, 4 * 20**level + 2 * 8**level, 20**level
        assert v % 11305 == e % 11305 == 0
        assert counts(made, level) == exact
        assert boundary_count(made, level) == 2 * 20**level + 4 * 8**level
        assert 133 * euler_number(made, level) == 192 - 38 * 8**level - 21 * 20**level
        if level < 5:
            assert arrays(made, level) == exact


def twin_counts(brep, level, **glue):
    twin = naive.Twin(brep, given(brep).matrices, **glue)
    for _ in range(level):
        twin.refine()
    return twin.counts()


@pytest.mark.parametrize("name", ["vicsek-7", "mosely-light", "even-parity", "minus-corner"])
def test_twin_of_hexahedra(name):
    brep = box(name)
    made = closure(given(brep))
    for level in range(2 if brep.states[3].children[8:] else 3):
        assert arrays(made, level) == twin_counts(brep, level)


def test_twin_of_random_digit_sets():
    rng = np.random.default_rng(5)
    for _ in range(6):
        brep = box(DigitSet(2, naive_oracle.random_digits(rng, 2)))
        assert arrays(closure(given(brep)), 2) == twin_counts(brep, 2)


def test_sierpinski_tetrahedra():
    brep = naive.tetra_system()
    made = closure(solve(brep))
    for n in (0, 1, 2, 3, 7):
        wanted = 2 * 4**n + 2, 6 * 4**n, 4 * 4**n, 4**n
        assert arrays(made, n) == counts(made, n) == wanted
        assert boundary_count(made, n) == 4 * 4**n
        if n < 4:
            assert wanted == twin_counts(brep, n)
            assert betti(cell_complex(made, n)) == (1, 4**n - 1, 0)


def test_an_edge_curve():
    brep = BRep((naive.vertex_state(), naive.edge_state()), 1)
    made = closure(solve(brep))
    for n in range(6):
        assert arrays(made, n) == counts(made, n) == (2**n + 1, 2**n, 0, 0)
        assert betti(cell_complex(made, n)) == (1, 0, 0)
    assert arrays(made, 3) == twin_counts(brep, 3)


def triangles(kept):
    return BRep((naive.vertex_state(), naive.edge_state(), naive.triangle_state(kept)), 2)


def test_a_triangle_whose_edges_are_used_both_ways():
    made = closure(solve(triangles((0, 1, 2, 3))))
    assert made.orders[1] == ((0, 1), (1, 0))
    for n in range(5):
        edges = 3 * 2**n * (2**n + 1) // 2
        wanted = (2**n + 1) * (2**n + 2) // 2, edges, 4**n, 0
        assert arrays(made, n) == counts(made, n) == wanted
        assert betti(cell_complex(made, n)) == (1, 0, 0)
        if n < 4:
            assert wanted == twin_counts(triangles((0, 1, 2, 3)), n)
    gasket = closure(solve(triangles((0, 1, 2))))
    for n in range(5):
        assert arrays(gasket, n) == ((3 ** (n + 1) + 3) // 2, 3 ** (n + 1), 3**n, 0)
        assert betti(cell_complex(gasket, n)) == (1, (3**n - 1) // 2, 0)


def test_tetrahedra_and_octahedra_fill_a_tetrahedron():
    made = closure(solve(build_cell(Options("tetra-octa"))))
    names = [state.name for state in made.brep.states]
    assert len(made.orders[names.index("triangle")]) == 6
    for n in range(5):
        size = 2**n
        vertices, _, _, volumes = counts(made, n)
        assert vertices == (size + 1) * (size + 2) * (size + 3) // 6
        assert volumes == size * (size + 1) * (size + 2) // 6 + size * (size * size - 1) // 6 + (
            (size - 1) * (size - 2) * size // 6
        )
        assert boundary_count(made, n) == 4 * 4**n
        assert counts(made, n) == arrays(made, n)
        assert betti(cell_complex(made, n)) == (1, 0, 0)


def glued(solution, mine, theirs, order):
    """Two level-0 cells, boundary ``theirs`` of the second = ``mine`` of the first in an order."""
    brep = solution.brep
    states = [b.state for b in brep.states[brep.start].boundaries]
    plain = [tuple(range(brep.states[s].size)) for s in states]
    shared = {theirs: (mine, order)}
    twin = naive.Twin(brep, solution.matrices)
    for m, (to, turn) in enumerate(twin.turned(states[mine], order, "boundaries")):
        own, other = brep.sub[brep.start][theirs][m], brep.sub[brep.start][mine][to]
        seen = naive.then(naive.then(other.order, turn), naive.back(own.order))
        shared[own.boundary] = other.boundary, seen
    second = [shared.get(k, (None, plain[k]))[1] for k in range(len(states))]
    both = tuple((a, b) for a, b in zip(plain, second, strict=True))
    made = closure(solution, {brep.start: both})
    used, rows = [0] * len(brep.states), []
    for cell in range(2):
        row = []
        for k, s in enumerate([*states, brep.start]):
            if cell and k in shared:
                row.append(rows[0][shared[k][0]])
            else:
                row.append(used[s])
                used[s] += 1
        rows.append(row)
    orders = [
        [made.orders[s].index(o[c]) for s, o in zip(states, both, strict=True)] for c in (0, 1)
    ]
    group = CellEntities(
        brep.start, np.array(rows), np.array([[*o, 0] for o in orders]), np.arange(2)
    )
    origin = tuple(np.full(n, -1, np.int32) for n in used)
    return made, Complex(brep, 0, tuple(used), (group,), origin)


def both_ways(solution, mine, theirs, order, levels):
    """Counts of two glued cells; arrays, types and the twin must agree."""
    made, start = glued(solution, mine, theirs, order)
    result = []
    for level in range(levels):
        found = arrays(made, level, start)
        assert counts(made, level, start) == found
        glue = [(0, mine, 1, theirs, naive.back(order))]
        twin = naive.Twin(solution.brep, solution.matrices, cells=2, glue=glue)
        for _ in range(level):
            twin.refine()
        assert twin.counts() == found
        result.append(found)
    return result


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_tetrahedra_glued_in_all_six_orders(order):
    solution = solve(naive.tetra_system())
    for theirs in (0, 2):
        for n, found in enumerate(both_ways(solution, 1, theirs, order, 3)):
            one = np.array([2 * 4**n + 2, 6 * 4**n, 4 * 4**n, 4**n])
            face = [(3 ** (n + 1) + 3) // 2, 3 ** (n + 1), 3**n, 0]
            assert found == tuple(2 * one - face)


SQUARE = [
    tuple(2 * ((i >> a & 1) ^ x) + ((i >> 1 - a & 1) ^ y) for i in range(4))
    for a, x, y in itertools.product((0, 1), repeat=3)
]
"""The eight symmetries of a square's corners."""


@pytest.mark.parametrize("order", SQUARE)
def test_hexahedra_glued_in_all_eight_orders(order):
    solution = solve(box("minus-corner"))
    names = [b.name for b in solution.brep.states[3].boundaries]
    found = both_ways(solution, names.index("1**"), names.index("*0*"), order, 3)
    assert found[0] == (12, 20, 11, 2)
    menger = solve(box("menger"))
    made, start = glued(menger, names.index("1**"), names.index("**1"), order)
    for n in range(4):
        # They share a carpet: 8ⁿ squares.
        one = np.array(union(sets.named("menger"), n))
        assert counts(made, n, start)[2] == 2 * one[2] - 8**n
        assert counts(made, n, start) == arrays(made, n, start)


def test_a_twisted_face_is_refused():
    solution = solve(box("full-2"))
    states = [b.state for b in solution.brep.states[3].boundaries]
    plain = [(tuple(range(solution.brep.states[s].size)),) for s in states]
    face = states.index(2)
    starts = {3: (*plain[:face], ((0, 1, 3, 2),), *plain[face + 1 :])}
    with pytest.raises(ModelError, match=r"state quad is not symmetric under \(0, 1, 3, 2\)"):
        closure(solution, starts)
    # Cells in orders that a closure was not made for.
    _, start = glued(solution, face, states.index(2, face + 1), (1, 0, 3, 2))
    with pytest.raises(ModelError, match="wanted a closure made for these cells"):
        cell_complex(closure(solution), 1, start)


def test_betti_numbers_of_sponges():
    made = closure(given(box("menger")))
    for n, genus in enumerate((0, 5, 81, 1409)):
        assert betti(cell_complex(made, n)) == (1, genus, 0)
    made = closure(given(box("cube-minus-centre")))
    for n, euler in enumerate((1, 2, 28)):
        assert euler_number(made, n) == euler
        assert betti(cell_complex(made, n)) == (1, 0, euler - 1)
    made = closure(given(box("cantor-dust")))
    assert betti(cell_complex(made, 2)) == (64, 0, 0)


def test_betti_numbers_by_labels():
    rng = np.random.default_rng(3)
    for draw in range(12):
        n = 2 + draw % 2
        keep = naive_oracle.random_digits(rng, n)
        found = cell_complex(closure(given(box(DigitSet(n, keep)))), 2)
        solid = naive_oracle.voxels(n, keep, 2)
        pieces, holes = naive_oracle.components(solid, 26), naive_oracle.cavities(solid, 6)
        tunnels = pieces + holes - naive_oracle.euler_number_26(solid)
        assert betti(found) == (pieces, tunnels, holes)


def test_place_is_that_of_the_automaton():
    for options in (
        Options("hex-8", (sets.named("menger"), sets.named("full-2"))),
        Options("tetra-octa"),
    ):
        solution = solve(build_cell(options))
        made, automaton = closure(solution), solution.automaton()
        for level in range(4):
            groups = cells(automaton, level)
            found = cell_complex(made, level).cells
            for ours, theirs in zip(found, groups, strict=True):
                assert made.brep.states[ours.state].name == automaton.states[theirs.state].name
                np.testing.assert_array_equal(ours.place, theirs.place)


@pytest.mark.parametrize(
    "options", [Options("hex-8", (sets.named("mosely-heavy"),)), Options("tetra-octa")]
)
def test_entities_are_the_points_that_coincide(options):
    solution = solve(build_cell(options))
    made = closure(solution)
    # In general position: no two vertices coincide but by the constraints.
    rng = np.random.default_rng(7)
    start = solution.brep.states[solution.brep.start]
    controls = start.controls + 0.01 * rng.standard_normal(start.controls.shape)
    automaton = solution.automaton(controls)
    for level in (1, 2):
        found = cell_complex(made, level)
        where = np.full((found.count(0), 3), np.nan)
        for group, body in zip(found.cells, cells(automaton, level), strict=True):
            ids = found.vertex_ids(group)
            slots = solution.brep.of_dimension(group.state, 0)
            weights = [solution.brep.states[group.state].boundaries[k].matrix for k in slots]
            points = np.moveaxis(body.points @ np.hstack(weights), 1, 2)
            known = ~np.isnan(where[ids][..., 0])
            np.testing.assert_allclose(points[known], where[ids][known], atol=1e-13)
            where[ids] = points
        assert not np.isnan(where).any()
        distinct = np.unique(np.round(where, 9), axis=0)
        assert len(distinct) == len(where)


def test_origin_tells_what_lies_on_the_block():
    solution = solve(box("menger"))
    made = closure(solution)
    names = [b.name for b in solution.brep.states[3].boundaries]
    for level in range(3):
        found = cell_complex(made, level)
        quads = found.origin[2]
        # Each side of the block is a carpet, each edge a line of 3ⁿ, each corner a vertex.
        for face in [k for k, name in enumerate(names) if name.count("*") == 2]:
            assert (quads == face).sum() == 8**level
        for edge in [k for k, name in enumerate(names) if name.count("*") == 1]:
            assert (found.origin[1] == edge).sum() == 3**level
            assert (found.origin[0] == edge).sum() == 3**level - 1
        for corner in [k for k, name in enumerate(names) if "*" not in name]:
            assert (found.origin[0] == corner).sum() == 1
        assert (found.origin[3] == -1).all()


def shuffled(brep, rng):
    """The same system with its states, boundaries, children and controls in another order."""
    states = rng.permutation(len(brep.states))
    number = np.argsort(states)
    controls = [rng.permutation(s.size) for s in brep.states]
    bounds = [rng.permutation(len(s.boundaries)) for s in brep.states]
    children = [rng.permutation(len(s.children)) for s in brep.states]
    bound_at, child_at = [np.argsort(b) for b in bounds], [np.argsort(c) for c in children]

    def turned(order, s):
        if not order:
            return ()
        back = np.argsort(controls[s])
        return tuple(int(back[order[t]]) for t in controls[s])

    def made(q):
        state = brep.states[q]
        kind = [c.state for c in state.children]
        shared = lambda i, k: brep.states[kind[i]].boundaries[k].state  # noqa: E731

        def slot(i, k):
            return int(child_at[q][i]), int(bound_at[kind[i]][k])

        return CellState(
            f"{state.name} {rng.integers(1000)}",
            state.shape,
            state.controls[:, controls[q]],
            [
                Boundary(
                    b.name, int(number[b.state]), b.matrix[np.ix_(controls[q], controls[b.state])]
                )
                for b in (state.boundaries[k] for k in bounds[q])
            ],
            [
                Child(c.name, int(number[c.state]), c.guess[np.ix_(controls[q], controls[c.state])])
                for c in (state.children[i] for i in children[q])
            ],
            [
                Incidence(
                    *slot(a.child, a.boundary),
                    int(bound_at[q][a.face]),
                    int(child_at[state.boundaries[a.face].state][a.letter]),
                    turned(a.order, shared(a.child, a.boundary)),
                )
                for a in (state.incidences[j] for j in rng.permutation(len(state.incidences)))
            ],
            [
                Adjacency(
                    *slot(a.child, a.boundary),
                    *slot(a.other, a.other_boundary),
                    turned(a.order, shared(a.child, a.boundary)),
                )
                for a in (state.adjacencies[j] for j in rng.permutation(len(state.adjacencies)))
            ],
        )

    return BRep(tuple(made(q) for q in states), int(number[brep.start]))


def test_names_and_orders_of_states_change_no_count():
    rng = np.random.default_rng(2)
    systems = [
        (box("minus-corner"), 3),
        (naive.tetra_system(), 3),
        (triangles((0, 1, 2, 3)), 4),
        (build_cell(Options("tetra-octa")), 2),
    ]
    for brep, level in systems:
        wanted = counts(closure(given(brep)), level)
        for _ in range(25):
            made = closure(given(shuffled(brep, rng)))
            assert counts(made, level) == arrays(made, level) == wanted
            assert made.brep.states[made.brep.start].dimension == max(
                state.dimension for state in brep.states
            )


def crooked(at):
    """A triangle cut in four whose edges are cut off their middle."""
    brep = triangles((0, 1, 2, 3))
    return BRep((brep.states[0], naive.edge_state(at), brep.states[2]), 2)


def test_an_edge_used_both_ways_must_be_symmetric():
    with pytest.raises(
        ModelError,
        match=r"state edge is not symmetric under \(1, 0\); "
        r"wanted by triangle: 3.E\d\d = \d.E\d\d \(1, 0\)",
    ):
        closure(given(crooked(0.4)))
    closure(given(crooked(0.5)))


def with_constraints(brep, q, incidences=(), adjacencies=()):
    s = brep.states[q]
    state = CellState(
        s.name,
        s.shape,
        s.controls,
        s.boundaries,
        s.children,
        (*s.incidences, *incidences),
        (*s.adjacencies, *adjacencies),
    )
    return BRep((*brep.states[:q], state, *brep.states[q + 1 :]), brep.start)


def test_symmetric_weights_with_a_slit_are_not_symmetric():
    # Two tetrahedra glued with their faces turned, but the face's middle triangle is held by one
    # of its three edges only: the constraints, not the weights, break the symmetry.
    brep = naive.tetra_system()
    face = brep.states[2]
    slit = CellState(
        "triangle",
        "triangle",
        face.controls,
        face.boundaries,
        face.children,
        face.incidences,
        face.adjacencies[:1],
    )
    solution = solve(BRep((*brep.states[:2], slit, brep.states[3]), 3))
    closure(solution)
    with pytest.raises(ModelError, match=r"state triangle is not symmetric under \(1, 2, 0\)"):
        glued(solution, 0, 1, (1, 2, 0))


def test_one_thing_in_two_places_is_refused():
    edge = BRep((naive.vertex_state(), naive.edge_state()), 1)
    ends = with_constraints(edge, 1, [Incidence(0, 0, 1, 0)])
    with pytest.raises(ModelError) as caught:
        closure(given(ends))
    assert str(caught.value) == (
        "edge: 0.0 = 0/0; edge: 0.0 = 1/0: contradict, for they put one thing in two places"
    )
    # Through a chain: both ends of the edge would be its middle.
    chain = with_constraints(edge, 1, [Incidence(0, 1, 0, 0), Incidence(1, 0, 1, 0)])
    with pytest.raises(ModelError, match=r"edge: 0\.1 = 0/0; edge: 0\.1 = 1\.0; edge: 1\.0 = 1/0"):
        closure(given(chain))


def test_an_edge_that_would_be_its_own_reversal_is_refused():
    brep = box("full-2")
    names = [b.name for b in brep.states[2].boundaries]
    join = next(a for a in brep.states[2].adjacencies if "*" in names[a.boundary])
    back = with_constraints(brep, 2, (), [Adjacency(*join[:4], (1, 0))])
    with pytest.raises(ModelError, match=r"own reordering \(1, 0\)") as caught:
        closure(given(back))
    texts = brep.text(2, join), brep.text(2, back.states[2].adjacencies[-1])
    assert all(text in str(caught.value) for text in texts)


def trunk(cut):
    """A hexahedron in eight beside a terminal edge that ends in the cube's centre."""
    brep = box("full-2")
    cube = brep.states[3]
    vertex = next(k for k, b in enumerate(cube.boundaries) if b.name == "111")
    ends = [Boundary("root", 0, selection(2, [0])), Boundary("tip", 0, selection(2, [1]))]
    strut = CellState("strut", "edge", np.array([[0, 1.0], [0, 0], [0, 0]]), ends)
    matrix = np.stack([np.eye(8)[0], np.ones(8) / 8], axis=1)
    middle = next(a for a in cube.adjacencies if a.other == 0 and a.other_boundary == vertex)
    joined = [Adjacency(8, 1, 0, middle.other_boundary)]
    corner = next(k for k, b in enumerate(cube.boundaries) if b.name == "000")
    state = CellState(
        "hexa",
        "hexa",
        cube.controls,
        cube.boundaries,
        (*cube.children, Child("strut", 4, matrix)),
        (*cube.incidences, Incidence(8, 0, corner, 0)),
        (*cube.adjacencies, *joined),
    )
    states = [*brep.states[:3], state, strut]
    if cut:
        states[3] = CellState("block", "hexa", cube.controls, cube.boundaries)
    return BRep(tuple(states), 3)


def test_terminal_cells_stay_on_their_vertices():
    brep = trunk(cut=False)
    solution = solve(brep)
    made = closure(solution)
    struts = 0
    for level in range(4):
        size = 2**level
        # The struts run along no edge of the hexahedra, from vertex to vertex.
        wanted = (
            (size + 1) ** 3,
            3 * size * (size + 1) ** 2 + struts,
            3 * size**2 * (size + 1),
            8**level,
        )
        assert arrays(made, level) == counts(made, level) == wanted
        found = cell_complex(made, level)
        assert betti(found) == (1, struts, 0)
        if level < 3:
            assert wanted == twin_counts(brep, level)
        for ours, theirs in zip(found.cells, cells(solution.automaton(), level), strict=True):
            np.testing.assert_array_equal(ours.place, theirs.place)
        struts += 8**level


def test_a_terminal_cell_beside_cut_faces_is_refused():
    with pytest.raises(
        ModelError, match=r"state block is terminal, but its boundary .* goes on into \d+ entities"
    ):
        closure(given(trunk(cut=True)))


def test_levels_that_cannot_be():
    made = closure(given(box("menger")))
    for work in (cell_complex, counts):
        with pytest.raises(ModelError, match="level: got -1; wanted 0 or more"):
            work(made, -1)
    with pytest.raises(MemoryLimitError, match=r"level 12 \(4096000000000000 cells\)"):
        cell_complex(made, 12)


def test_complex_is_fast_and_small():
    solution = solve(build_cell(Options("hex-27", (sets.named("menger"),))))
    times = []
    for _ in range(3):
        began = time.perf_counter()
        made = closure(solution)
        middle = time.perf_counter()
        cell_complex(made, 3)
        times.append((middle - began, time.perf_counter() - middle))
    # Measured: 7 ms and 9 ms.
    assert min(t for t, _ in times) < 0.5
    assert min(t for _, t in times) < 0.1


def fork():
    """An edge that splits into two from its root: one to its tip, one half-way to nowhere."""
    edge = naive.edge_state()
    matrices = [np.array([[1, 0.0], [0, 1]]), np.array([[1, 0.5], [0, 0.5]])]
    children = [Child(str(i), 1, matrix) for i, matrix in enumerate(matrices)]
    incidences = [Incidence(0, 0, 0, 0), Incidence(0, 1, 1, 0), Incidence(1, 0, 0, 0)]
    state = CellState("fork", "edge", edge.controls, edge.boundaries, children, incidences)
    return BRep((naive.vertex_state(), state), 1)


def test_counts_do_not_grow_with_the_cells_about_a_vertex():
    # 2ⁿ cells meet in the root.
    made = closure(given(fork()))
    for n in range(5):
        assert arrays(made, n) == counts(made, n) == (2**n + 1, 2**n, 0, 0)
    assert counts(made, 90) == (2**90 + 1, 2**90, 0, 0)


def test_too_many_kinds_of_entities_are_refused(monkeypatch):
    from porous.models import counts as module

    monkeypatch.setattr(module, "LARGEST", 20)
    with pytest.raises(ModelError, match="more than 20 kinds of entities"):
        counts(closure(given(box("menger"))), 3)
