"""Cells by name: exact matrices, complete constraints, orientation, options that are refused."""

import pickle
from collections import Counter
from itertools import permutations, product

import numpy as np
import pytest
from naive_quotient import Quotient
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from porous.errors import MemoryLimitError, ModelError
from porous.models.brep import column_order
from porous.models.builders import Options, Texture, build_cell, builders, cell_names
from porous.models.builders.tetra import FACE_JOINED
from porous.models.digits import DigitSet, named, names
from porous.models.dimension import similarity_dimension
from porous.models.primitive import named as primitive
from porous.models.solve import solve

MENGER = named("menger")
ROUGH = Texture(edge=(0.45, -0.4, 0.45), bump=(0.5, 0.3))
T_ONLY = {"tetra": ("tetra",)}
O_TO_T = {"octa": ("tetra",)}

CELLS = {
    "straight Menger": Options("hex-8", (MENGER,)),
    "smooth Menger": Options("hex-27", (MENGER,)),
    "rough Menger": Options("hex-27", (MENGER,), ROUGH),
    "3 then 2": Options("hex-8", (MENGER, named("full-2"))),
    "3 then 2, per axis": Options(
        "hex-27",
        (named("mosely-light"), named("minus-corner")),
        (Texture(0.2, 0.4), Texture(), Texture(0.2, 0.4)),
    ),
    "full 2": Options("hex-8", (named("full-2"),)),
    "Vicsek 9": Options("hex-8", (named("vicsek-9"),)),
    "even parity": Options("hex-8", (named("even-parity"),)),
    "Mosely light": Options("hex-8", (named("mosely-light"),)),
    "edge cubes": Options("beam", (named("edge-cubes"),)),
    "Sierpinski": Options("tetra"),
    "face-joined": Options("tetra", keep=("tetra", "octa")),
    "tetra-octa": Options("tetra-octa"),
    "octa-tetra": Options("tetra-octa", start="octa"),
    "O to 8 T": Options("tetra-octa", keep=O_TO_T),
    "T to 4 T": Options("tetra-octa", keep=T_ONLY, start="octa"),
    "two tetrahedra of an octahedron": Options(
        "tetra-octa", keep={"octa": ("024", "135", "0")}, start="octa"
    ),
}
each_cell = pytest.mark.parametrize("options", CELLS.values(), ids=CELLS)


def sides(brep):
    """Both sides of every constraint, and the state it is of: T·B and B·T·Π or T·B·Π."""
    for state in brep.states:
        for at in (*state.incidences, *state.adjacencies):
            child = state.children[at.child]
            left = child.guess @ brep.states[child.state].boundaries[at.boundary].matrix
            if hasattr(at, "face"):
                face = state.boundaries[at.face]
                right = face.matrix @ brep.states[face.state].children[at.letter].guess
            else:
                other = state.children[at.other]
                right = other.guess @ brep.states[other.state].boundaries[at.other_boundary].matrix
            order = list(at.order) or list(range(right.shape[1]))
            yield state, left, right[:, order]


def cells(brep, level, controls, state=None):
    """State and controls of each cell of a level, in lexicographic order."""
    found = [(brep.start if state is None else state, controls)]
    for _ in range(level):
        found = [(c.state, P @ c.guess) for q, P in found for c in brep.states[q].children]
    return found


def corners(brep, state, controls):
    """The corners of a cell, one a row."""
    chosen = brep.of_dimension(state, 0)
    return np.hstack([controls @ brep.states[state].boundaries[k].matrix for k in chosen]).T


def random_texture(rng, divisions):
    return Texture(rng.uniform(-0.9, 0.9, divisions), rng.uniform(-0.7, 0.7, divisions - 1))


def random_digits(rng, divisions):
    every = np.array(list(product(range(divisions), repeat=3)))
    return DigitSet(divisions, every[rng.permutation(len(every))[: rng.integers(1, len(every))]])


# --- the curve rule --------------------------------------------------------------------------


def line(texture, divisions):
    """The matrices of an edge of three controls."""
    digits = DigitSet(divisions, [[0, 0, 0]])
    brep = build_cell(Options("hex-27", (digits,), texture))
    edge = next(state for state in brep.states if state.name == "edge")
    return [child.guess for child in edge.children]


def test_three_pieces_without_a_texture_are_beziers():
    expected = [
        np.array([[9, 6, 4], [0, 3, 4], [0, 0, 1]]) / 9,
        np.array([[4, 2, 1], [4, 5, 4], [1, 2, 4]]) / 9,
        np.array([[1, 0, 0], [4, 3, 0], [4, 6, 9]]) / 9,
    ]
    np.testing.assert_allclose(line(None, 3), expected, rtol=0, atol=2e-16)
    written = line(Texture(edge=1 / 9, bump=(4 / 9, 4 / 9)), 3)
    np.testing.assert_allclose(written, expected, rtol=0, atol=2e-16)


def test_two_pieces_without_a_texture_are_de_casteljaus():
    expected = [
        np.array([[4, 2, 1], [0, 2, 2], [0, 0, 1]]) / 4,
        np.array([[1, 0, 0], [2, 2, 0], [1, 2, 4]]) / 4,
    ]
    assert np.array_equal(line(None, 2), expected)


@pytest.mark.parametrize("w", [0.25, 0.5, 0.7])
def test_two_pieces_are_the_takagi_landsberg_curve(w):
    first = np.array([[1, 5 / 8 - w / 2, 1 / 4], [0, 1 / 4 + w, 1 / 2], [0, 1 / 8 - w / 2, 1 / 4]])
    found = line(Texture(edge=w, bump=0.5), 2)
    np.testing.assert_allclose(found, [first, first[::-1, ::-1]], rtol=0, atol=1e-16)


@pytest.mark.parametrize("divisions", [2, 3, 4, 7])
def test_any_number_of_pieces_follows_the_parabola(divisions):
    rng = np.random.default_rng(divisions)
    P = rng.normal(size=(3, 3))

    def parabola(t):
        return P @ np.stack([(1 - t) ** 2, 2 * t * (1 - t), t**2])

    t = rng.uniform(size=9)
    for k, matrix in enumerate(line(None, divisions)):
        found = P @ matrix @ np.stack([(1 - t) ** 2, 2 * t * (1 - t), t**2])
        np.testing.assert_allclose(found, parabola((k + t) / divisions), rtol=0, atol=1e-14)


def test_pieces_contract_as_the_texture_says():
    for k, matrix in enumerate(line(ROUGH, 3)):
        found = np.sort(np.linalg.eigvals(matrix).real)
        np.testing.assert_allclose(found, np.sort([1, 1 / 3, ROUGH.edge[k]]), atol=1e-12)


def test_a_middle_control_midway_makes_every_texture_straight():
    P = np.array([[0.0, 1.0, 2.0]])
    for texture in (None, ROUGH, Texture(0.8, -0.5)):
        found = [P @ matrix for matrix in line(texture, 3)]
        np.testing.assert_allclose(
            np.hstack(found), np.hstack([P / 3, P / 3 + 2 / 3, P / 3 + 4 / 3])
        )


# --- constraints -----------------------------------------------------------------------------


@each_cell
def test_constraints_hold_exactly(options):
    gaps = [np.abs(left - right).max() for _, left, right in sides(build_cell(options))]
    assert gaps
    assert max(gaps) <= 1e-15


def test_constraints_hold_for_any_digits_and_textures():
    rng = np.random.default_rng(1)
    for draw in range(100):
        divisions = rng.integers(2, 5, size=1 + draw % 2).tolist()
        digits = tuple(random_digits(rng, n) for n in divisions)
        texture = tuple(random_texture(rng, divisions[0]) for _ in range(3))
        if len(divisions) > 1:
            texture = tuple(Texture(*rng.uniform(-0.8, 0.8, 2)) for _ in range(3))
        options = Options("hex-27", digits, texture if draw % 3 else texture[0])
        assert all(np.abs(a - b).max() <= 1e-15 for _, a, b in sides(build_cell(options)))


@each_cell
def test_shared_boundaries_are_identical_wherever_the_controls_are(options):
    rng = np.random.default_rng(2)
    pairs = {}
    for state, left, right in sides(build_cell(options)):
        pairs.setdefault(state.size, []).append((left, right))
    for size, both in pairs.items():
        left, right = (np.hstack(side) for side in zip(*both, strict=True))
        for _ in range(100):
            P = rng.normal(size=(3, size)) * 10.0 ** rng.integers(-3, 4)
            assert np.abs(P @ left - P @ right).max() <= 1e-12 * np.abs(P).max()


@each_cell
def test_solving_changes_nothing(options):
    brep = build_cell(options)
    solution = solve(brep)
    assert solution.residual <= 1e-14
    for state, matrices in zip(brep.states, solution.matrices, strict=True):
        for child, matrix in zip(state.children, matrices, strict=True):
            np.testing.assert_allclose(matrix, child.guess, rtol=0, atol=1e-15)
            np.testing.assert_allclose(matrix.sum(axis=0), 1, rtol=0, atol=4e-15)


def entities(brep, state, controls):
    """Each boundary of a cell, and the cell, by its state and its controls."""
    parts = [(b.state, controls @ b.matrix) for b in brep.states[state].boundaries]
    for kind, points in (*parts, (state, controls)):
        yield kind, frozenset(map(tuple, np.rint(points.T * 1e9).astype(np.int64).tolist()))


def check_sharing(options, levels):
    """Hold what constraints join against what is one wherever the controls are.

    Of all boundaries of the cells, and of the cells of all boundaries of the level-0 cell.
    """
    brep = build_cell(options)
    start = brep.states[brep.start]
    quotient = Quotient(brep)
    for level in range(1, 1 + levels):
        quotient.refine()
        P = np.random.default_rng(level).normal(size=(start.size - 1, start.size))
        found = cells(brep, level, P)
        joined = quotient.roots(quotient.cells)
        for boundary, border in zip(start.boundaries, quotient.borders, strict=True):
            found += cells(brep, level, P @ boundary.matrix, boundary.state)
            joined += quotient.roots(border)
        keys = [key for cell in found for key in entities(brep, *cell)]
        assert len(set(joined)) == len(set(keys)) == len(set(zip(joined, keys, strict=True)))


@each_cell
def test_cells_share_what_constraints_join_and_nothing_else(options):
    check_sharing(options, 2)


def test_cells_of_any_digits_share_what_constraints_join():
    rng = np.random.default_rng(4)
    for draw in range(10):
        digits = random_digits(rng, 2 + draw % 3)
        check_sharing(Options("hex-8", (digits,)), 2 if len(digits.keep) < 12 else 1)


@pytest.mark.parametrize("texture", [None, ROUGH], ids=["smooth", "rough"])
def test_a_menger_cell_has_its_distinct_corners(texture):
    brep = build_cell(Options("hex-27", (MENGER,), texture))
    P = np.random.default_rng(3).normal(size=(3, 27))
    for level, count in ((1, 64), (2, 896)):
        points = np.vstack([corners(brep, *cell) for cell in cells(brep, level, P)])
        assert len(np.unique(np.round(points, 9), axis=0)) == count


def corner_count(options, level):
    """How many cells a level has, and how many vertices these."""
    quotient = Quotient(build_cell(options))
    for _ in range(level):
        quotient.refine()
    vertices = {r for r in quotient.roots(quotient.cells) if not quotient.parts[r]}
    return len(quotient.cells), len(vertices)


def test_counts_are_those_in_closed_form():
    assert corner_count(Options("tetra"), 3) == (4**3, 2 * 4**3 + 2)
    assert corner_count(Options("tetra-octa"), 2) == (34, 5 * 6 * 7 // 6)
    assert corner_count(Options("tetra-octa", start="octa"), 1) == (14, 19)
    assert corner_count(Options("hex-8", (named("full-2"),)), 2) == (64, 125)
    three_then_two = (named("full-3"), named("full-2"))
    assert corner_count(Options("hex-8", three_then_two), 2) == (216, 343)
    assert corner_count(Options("hex-8", (MENGER, named("full-2"))), 2) == (160, 324)


@pytest.mark.parametrize("name", ["triangle", "edge"])
def test_simplices_are_alike_in_every_order(name):
    state = next(s for s in build_cell(Options("tetra")).states if s.name == name)
    for order in permutations(range(state.size)):
        turn = np.eye(state.size)[:, order]
        for child in state.children:
            found = [column_order(turn @ child.guess, other.guess) for other in state.children]
            assert sum(order is not None for order in found) == 1


# --- hexahedra -------------------------------------------------------------------------------


def test_a_hexahedron_has_the_faces_that_people_name():
    brep = build_cell(Options("hex-27", (MENGER,)))
    cell = brep.states[brep.start]
    facets = [cell.boundaries[k] for k in brep.of_dimension(brep.start, 2)]
    assert [f.name for f in facets] == ["XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX"]
    for index, facet in enumerate(facets):
        place = cell.controls @ facet.matrix
        assert np.array_equal(place[index // 2], np.full(9, index % 2))
    expected = [list(p) for p in product((0.0, 1.0), repeat=3)]
    assert corners(brep, brep.start, cell.controls).tolist() == expected
    assert [child.name for child in cell.children[:3]] == ["000", "001", "002"]


def test_edges_and_vertices_lie_where_their_names_say():
    brep = build_cell(Options("hex-8", (MENGER,)))
    cell = brep.states[brep.start]
    for boundary in cell.boundaries[6:]:
        place = cell.controls @ boundary.matrix
        axis = "XYZ".find(boundary.name[0])
        fixed = [a for a in range(3) if a != axis]
        assert place[fixed].tolist() == [[int(s)] * place.shape[1] for s in boundary.name[1:]]
        assert axis < 0 or place[axis].tolist() == [0, 1]


def test_children_lie_where_their_digits_say():
    digits = DigitSet(12, [[0, 11, 3], [10, 0, 7], [1, 2, 3]])
    brep = build_cell(Options("hex-27", (digits,)))
    cell = brep.states[brep.start]
    for child, digit in zip(cell.children, digits.keep, strict=True):
        assert child.name == ".".join(map(str, digit))
        expected = (cell.controls + digit[:, None]) / 12
        np.testing.assert_allclose(cell.controls @ child.guess, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("name", names())
def test_boundaries_carry_all_digits_whatever_is_kept(name):
    digits = named(name)
    brep = build_cell(Options("hex-8", (digits,)))
    counts = [len(digits.keep), digits.divisions**2, digits.divisions, 1]
    assert [len(state.children) for state in brep.states] == counts


def test_levels_have_their_own_states():
    brep = build_cell(CELLS["3 then 2"])
    found = [
        [s.name, *dict.fromkeys(brep.states[c.state].name for c in s.children)] for s in brep.states
    ]
    assert found == [
        *(["cell0", "cell1"], ["cell1", "cell1"]),
        *(["face0", "face1"], ["face1", "face1"]),
        *(["edge0", "edge1"], ["edge1", "edge1"], ["vertex", "vertex"]),
    ]


def test_axes_of_equal_texture_share_their_states():
    x, y = Texture(0.2, 0.4), Texture()
    brep = build_cell(Options("hex-27", (MENGER,), (x, y, x)))
    assert [s.name for s in brep.states] == [
        *("cell", "face-xx", "face-xy", "edge-x", "edge-y", "vertex")
    ]
    kinds = [brep.states[b.state].name for b in brep.states[0].boundaries[:6:2]]
    assert kinds == ["face-xy", "face-xx", "face-xy"]
    same = build_cell(Options("hex-27", (MENGER,), (x, x, x)))
    assert same == build_cell(Options("hex-27", (MENGER,), x))
    unlike = build_cell(Options("hex-27", (MENGER,), (x, y, Texture(0.1))))
    assert len(unlike.states) == 1 + 3 + 3 + 1


def test_permuting_axes_permutes_the_cell():
    rng = np.random.default_rng(5)
    P = rng.normal(size=(3, 27))
    digits = random_digits(rng, 3)
    textures = tuple(random_texture(rng, 3) for _ in range(3))
    turn = [2, 0, 1]
    moved = Options(
        "hex-27", (DigitSet(3, digits.keep[:, turn]),), tuple(textures[a] for a in turn)
    )
    turned = P.reshape(3, 3, 3, 3).transpose(0, *(1 + a for a in turn)).reshape(3, 27)
    plain = build_cell(Options("hex-27", (digits,), textures))
    for child, other in zip(
        plain.states[0].children, build_cell(moved).states[0].children, strict=True
    ):
        found = (turned @ other.guess).reshape(3, 3, 3, 3)
        expected = (P @ child.guess).reshape(3, 3, 3, 3).transpose(0, *(1 + a for a in turn))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


def test_beams_have_eight_or_27_controls():
    for size in (8, 27):
        brep = build_cell(Options("beam", (MENGER,), controls=size))
        assert brep == build_cell(Options(f"hex-{size}", (MENGER,)))
    assert build_cell(Options("beam", (MENGER,))).states[0].size == 8


# --- tetrahedra and octahedra ----------------------------------------------------------------


def signed_volume(state, points):
    """Volume of a tetrahedron from its corners, of an octahedron from its three diagonals."""
    if state.shape == "tetra":
        return np.linalg.det(points[:, 1:] - points[:, :1]) / 6
    return np.linalg.det(points[:, 1::2] - points[:, ::2]) / 6


@pytest.mark.parametrize("start", ["tetra", "octa"])
def test_full_tetrahedra_and_octahedra_fill_their_parent(start):
    brep = build_cell(Options("tetra-octa", start=start))
    cell = brep.states[brep.start]
    whole = signed_volume(cell, cell.controls)
    assert whole == pytest.approx({"tetra": 1 / 3, "octa": 1 / 6}[start], rel=1e-15)
    for level in (1, 2, 3):
        parts = [signed_volume(brep.states[q], P) for q, P in cells(brep, level, cell.controls)]
        assert min(parts) > 0
        assert sum(parts) == pytest.approx(whole, rel=1e-13)


@each_cell
def test_every_child_is_right_handed(options):
    brep = build_cell(options)
    for state in brep.states:
        for child in state.children if state.dimension == 3 else ():
            shape, points = brep.states[child.state], state.controls @ child.guess
            if shape.shape == "hexa":
                eight = corners(brep, child.state, points)
                volumes = [np.linalg.det(eight[[4, 2, 1]] - eight[0])]
            else:
                volumes = [signed_volume(shape, points)]
            assert min(volumes) > 0


def test_reference_cells_are_the_primitives():
    brep = build_cell(Options("tetra-octa"))
    tetra, octa = (s.controls.T for s in brep.states[:2])
    assert {*map(tuple, tetra)} == {*map(tuple, primitive("tetrahedron").points)}
    edges = [np.linalg.norm(p[0] - p[-1]) for p in (tetra, octa)]
    assert edges == pytest.approx([2**0.5] * 2)
    octa = build_cell(Options("tetra-octa", start="octa")).states[0].controls.T
    assert np.array_equal(octa, primitive("octahedron").points)


def test_upright_tetrahedra_are_translates():
    brep = build_cell(CELLS["face-joined"])
    names_, cell = [s.name for s in brep.states], brep.states[brep.start]
    middle = cell.controls @ next(c.guess for c in cell.children if c.name == "octa")
    for child in brep.states[names_.index("octa")].children:
        if brep.states[child.state].name == "tetra":
            shift = middle @ child.guess - cell.controls / 4
            np.testing.assert_allclose(shift, shift[:, :1] + np.zeros(4), rtol=0, atol=1e-15)


def counts_matrix(brep):
    volumes = [q for q in brep.reached if brep.states[q].dimension == 3]
    found = [Counter(c.state for c in brep.states[q].children) for q in volumes]
    return np.array([[row[q] for q in volumes] for row in found])


@pytest.mark.parametrize(
    ("options", "dimension"),
    [
        (Options("tetra-octa"), 3.0),
        (Options("tetra-octa", start="octa"), 3.0),
        (CELLS["T to 4 T"], 2.584963),
        (Options("tetra-octa", keep=T_ONLY), 2.0),
        (CELLS["O to 8 T"], 2.449984),
        (CELLS["face-joined"], np.log2(6)),
    ],
)
def test_dimensions_follow_from_the_counts(options, dimension):
    radius = np.abs(np.linalg.eigvals(counts_matrix(build_cell(options)))).max()
    assert np.log2(radius) == pytest.approx(dimension, abs=5e-7)


def test_sierpinskis_dimension_is_two():
    automaton = solve(build_cell(Options("tetra"))).automaton()
    assert similarity_dimension(automaton) == pytest.approx(2, abs=1e-12)


def pieces(options, level):
    """How many bodies cells that share three corners make."""
    brep = build_cell(options)
    owners = {}
    found = cells(brep, level, brep.states[brep.start].controls)
    for index, (q, P) in enumerate(found):
        for k in brep.of_dimension(q, 2):
            place = np.rint(P @ brep.states[q].boundaries[k].matrix * 3 * 2**level)
            owners.setdefault(frozenset(map(tuple, place.T)), []).append(index)
    pairs = np.array([(c[0], c[-1]) for c in owners.values()]).T
    links = coo_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=(len(found),) * 2)
    assert max(map(len, owners.values())) <= 2
    return connected_components(links, directed=False)[0]


def test_octahedra_join_tetrahedra_across_faces_at_every_level():
    for level in range(5):
        assert pieces(Options("tetra"), level) == 4**level
        assert pieces(CELLS["face-joined"], level) == 1
        assert pieces(Options("tetra", keep=FACE_JOINED), level) == 1
    assert pieces(CELLS["O to 8 T"], 2) == 8


def test_keep_speaks_of_children_and_of_states():
    brep = build_cell(Options("tetra-octa", keep={"octa": ("octa", "024")}))
    children = [[c.name for c in s.children] for s in brep.states[:2]]
    assert children == [["0", "1", "2", "3", "octa"], ["024", "0", "1", "2", "3", "4", "5"]]
    assert build_cell(Options("tetra", keep=("0", "2"))).states[0].children[1].name == "2"
    assert [s.name for s in build_cell(Options("tetra")).states] == [
        *("tetra", "triangle", "edge", "vertex")
    ]


# --- options ---------------------------------------------------------------------------------


def test_cells_are_found_by_name():
    assert {"beam", "hex-27", "hex-8", "spline-2", "tetra", "tetra-octa"} < set(cell_names())
    assert list(cell_names()) == sorted(cell_names())
    assert set(builders()) == set(cell_names())
    assert Options("hex-8", (MENGER,)) == Options("hex-8", MENGER)
    kept = Options("tetra-octa", keep=O_TO_T)
    assert pickle.loads(pickle.dumps(kept)) == kept
    assert Options("tetra", keep={"tetra": ["0"]}) == Options("tetra", keep={"tetra": ("0",)})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Options("hex-72", (MENGER,)), "cell: got 'hex-72'; did you mean 'hex-27'"),
        (lambda: Options("hex-8"), "digits: got none"),
        (lambda: Options("hex-8", ("menger",)), "digits: got .*wanted sets of digits"),
        (lambda: Options("hex-8", (MENGER,), keep=("000",)), "keep: a hex-8 cell takes none"),
        (lambda: Options("tetra", (MENGER,)), "digits: a tetra cell takes none"),
        (lambda: Options("tetra", start="octa"), "start: a tetra cell takes none"),
        (lambda: Options("hex-8", (MENGER,), controls=27), "controls: got 27 for a hex-8 cell"),
        (lambda: Options("beam", (MENGER,), controls=9), "got 9 for a beam cell; wanted 8 or 27"),
        (lambda: Options("tetra", controls=8), "controls: got 8; wanted 4, of one tetra"),
        (lambda: Options("hex-8", (MENGER,), ROUGH), "line of two controls is straight"),
        (
            lambda: Options("hex-27", (MENGER,), (ROUGH, ROUGH)),
            "wanted one, or three for x, y and z",
        ),
        (lambda: Options("hex-27", (MENGER,), "rough"), "wanted one, or three"),
        (
            lambda: Options("hex-27", (MENGER,), Texture((0.1, 0.2))),
            "texture.edge: got 2 numbers; wanted 3 for divisions = 3, or a single number",
        ),
        (
            lambda: Options("hex-27", (MENGER, named("full-2")), ROUGH),
            "level 1: texture.edge: got 3 numbers; wanted 2 for divisions = 2",
        ),
        (
            lambda: Options("hex-27", (MENGER, named("full-2")), Texture(0.1, (0.4, 0.4))),
            "level 1: texture.bump: got 2 numbers; wanted 1",
        ),
        (lambda: Texture(edge=(0.1, 1.0, 0.1)), "r = 1 for piece 1: the word 1, 1, .* contract"),
        (lambda: Texture(edge=float("nan")), "texture.edge: got nan; wanted finite"),
        (lambda: Texture(bump=[[0.1]]), "texture.bump: got an array of shape"),
        (lambda: Texture(bump="rough"), "texture.bump: wanted numbers"),
        (lambda: Options("tetra", keep=()), "keep: got .* wanted names of children"),
        (lambda: Options("tetra", keep="0"), "keep: got '0'"),
        (lambda: Options("tetra", keep=("4",)), "keep: tetra has no child '4'; there is"),
        (lambda: Options("tetra", keep=("0", "tetra")), "child 0 of tetra is there twice"),
        (lambda: Options("tetra", keep={"octa": ("0",)}), "wanted octa among those of tetra"),
        (lambda: Options("tetra-octa", keep={"octas": ("0",)}), "did you mean 'octa'"),
        (lambda: Options("tetra-octa", start="cube"), "state: got 'cube'"),
        (lambda: Options("tetra-octa", start="edge"), "state: got 'edge'; there is octa, tetra"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(make, message):
    with pytest.raises(ModelError, match=message):
        build_cell(make())


def test_too_many_divisions_are_refused_before_they_are_made():
    with pytest.raises(MemoryLimitError, match="1048576³ sub-cells"):
        build_cell(Options("hex-8", (DigitSet(1 << 20, [[0, 0, 0]]),)))
