"""Dimensions against the literature, for one state and for several."""

import math

import numpy as np
import pytest
from rough import (
    BEZIER,
    TETRAHEDRON,
    bent,
    curve,
    rough,
    sponge,
    straight,
    takagi,
    tetrahedra_and_octahedra,
)

from porous.models.automaton import Automaton, State, Transition, of_maps
from porous.models.digits import named
from porous.models.dimension import affinity_bound, affinity_dimension, similarity_dimension
from porous.models.ifs import ifs

GOLDEN = (1 + math.sqrt(5)) / 2
K = math.sqrt(2) - 1


def similar(count, ratio):
    return [(np.eye(3) * ratio, np.zeros(3))] * count


@pytest.mark.parametrize(
    ("maps", "dimension"),
    [
        (named("menger").maps, 2.726833),
        (similar(4, 0.5), 2.0),
        (similar(6, 0.5), 2.584963),
        (named("vicsek-7").maps, 1.771244),
        (named("vicsek-9").maps, 2.0),
        (named("cantor-dust").maps, 1.892789),
        (named("mosely-light").maps, 2.630930),
        (named("mosely-heavy").maps, 2.6801439),
        (similar(8, K) + similar(12, K**2), 2.529121),
        (similar(20, 1 / (2 + GOLDEN)), 2.329622),
        (similar(12, 1 / (1 + GOLDEN)), 2.581926),
        (similar(4, 1 / 3), 1.261860),
        (similar(13, 1 / 3), 2.334718),
        (similar(1, 0.5), 0.0),
    ],
)
def test_similarity_dimensions(maps, dimension):
    automaton = of_maps(maps)
    assert similarity_dimension(automaton) == pytest.approx(dimension, abs=5e-7)
    # For similarities the affinity dimension is the same.
    assert affinity_dimension(automaton) == pytest.approx(min(3, dimension), abs=5e-7)


def test_jerusalem_in_closed_form():
    automaton = of_maps(similar(8, K) + similar(12, K**2))
    s = similarity_dimension(automaton)
    assert K**s == pytest.approx((math.sqrt(7) - 2) / 6, rel=1e-12)


def test_mirrored_and_turned_maps_are_similarities():
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, -1]])
    automaton = of_maps([(turn / 2, np.zeros(3))] * 4)
    assert similarity_dimension(automaton) == pytest.approx(2.0, abs=1e-12)


def graph(*edges, states=2):
    """States are frames of space; edges (source, target, count), all of ratio one half."""
    frame = State("f", np.hstack([np.zeros((3, 1)), np.eye(3)]))
    half = of_maps([(np.eye(3) / 2, np.zeros(3))]).transitions[0].matrix
    moves = [Transition(a, b, half) for a, b, count in edges for _ in range(count)]
    return Automaton((frame,) * states, tuple(moves))


def test_tetrahedra_and_octahedra():
    full = graph((0, 0, 4), (0, 1, 1), (1, 0, 8), (1, 1, 6))
    assert similarity_dimension(full) == pytest.approx(3, abs=1e-12)
    # Without octahedra in the tetrahedron the larger part that is reached decides.
    leads_up = graph((0, 0, 4), (0, 1, 1), (1, 1, 6))
    assert similarity_dimension(leads_up) == pytest.approx(2.584963, abs=5e-7)
    leads_down = graph((0, 0, 6), (0, 1, 8), (1, 1, 4))
    assert similarity_dimension(leads_down) == pytest.approx(2.584963, abs=5e-7)
    back_and_forth = graph((0, 0, 4), (0, 1, 1), (1, 0, 8))
    assert similarity_dimension(back_and_forth) == pytest.approx(2.449984, abs=5e-7)
    assert affinity_dimension(back_and_forth) == pytest.approx(2.449984, abs=5e-7)


def test_paths_that_end_have_no_dimension():
    assert similarity_dimension(graph((0, 1, 5))) == -math.inf
    assert similarity_dimension(graph((0, 1, 5), (1, 1, 1))) == 0.0


def test_affine_maps():
    carpet = np.diag([1 / 2, 1 / 3, 0])
    automaton = of_maps([(carpet, np.zeros(3))] * 3)
    assert similarity_dimension(automaton) is None
    expected = 1 + math.log(1.5) / math.log(3)
    assert expected == pytest.approx(1.369070, abs=5e-7)
    for length in (1, 2, 3):
        assert affinity_bound(automaton, length) == pytest.approx(expected, abs=1e-9)


def test_the_fern_from_above():
    flat = [
        [[0.85, 0.04], [-0.04, 0.85]],
        [[0, 0], [0, 0.16]],
        [[0.2, -0.26], [0.23, 0.22]],
        [[-0.15, 0.28], [0.26, 0.24]],
    ]
    automaton = of_maps([(np.pad(np.array(A), (0, 1)), np.zeros(3)) for A in flat])
    bounds = [affinity_bound(automaton, k) for k in range(1, 7)]
    assert bounds == pytest.approx([1.8433, 1.8428, 1.8424, 1.8420, 1.8416, 1.8413], abs=6e-5)
    assert affinity_dimension(automaton) <= bounds[-1]


def test_overlapping_maps_are_capped_at_three():
    assert affinity_dimension(of_maps(similar(20, 0.9))) == 3.0
    assert similarity_dimension(of_maps(similar(20, 0.9))) > 3


def test_a_model_has_its_automaton_s_dimension_at_any_size():
    model = ifs(named("menger"), level=1, size=17.0, unit="cm")
    assert similarity_dimension(model.automaton) == pytest.approx(2.726833, abs=5e-7)


# --- states of many controls -----------------------------------------------------------------

MENGER = math.log(20) / math.log(3)


def both(automaton):
    return similarity_dimension(automaton), affinity_dimension(automaton)


def test_cells_of_four_and_six_controls():
    # The tetrahedron is full: four tetrahedra and an octahedron, that of eight and six.
    assert both(tetrahedra_and_octahedra()) == pytest.approx((3, 3), abs=1e-9)
    without = tetrahedra_and_octahedra(tetra=(4, 0))
    assert both(without) == pytest.approx((2, 2), abs=1e-9)
    # Tetrahedra lead to octahedra but not back: the larger part that is reached decides.
    leads_up = tetrahedra_and_octahedra(octa=(0, 6))
    assert both(leads_up) == pytest.approx((2.584963, 2.584963), abs=5e-7)
    porous = tetrahedra_and_octahedra(octa=(8, 0))
    assert both(porous) == pytest.approx((2.449984, 2.449984), abs=5e-7)


@pytest.mark.parametrize("seed", range(6))
def test_affine_images_of_similar_systems_are_seen_through(seed):
    rng = np.random.default_rng(seed)
    V = rng.normal(size=(3, 3)) + 2 * np.eye(3)
    maps = []
    for _ in range(5):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        maps.append((V @ turn @ np.linalg.inv(V) / 2, rng.normal(size=3)))
    automaton = of_maps(maps)
    assert similarity_dimension(automaton) == pytest.approx(math.log2(5), abs=1e-9)
    # One map that is none among them: no metric makes all similar.
    other = of_maps([*maps, (np.diag([0.5, 0.4, 0.5]), np.zeros(3))])
    assert similarity_dimension(other) is None


def test_a_sheared_tetrahedron_has_the_same_dimension():
    automaton = tetrahedra_and_octahedra(octa=(8, 0))
    start = State("tetra", np.diag([1.0, 2.0, 5.0]) @ TETRAHEDRON + 3)
    sheared = Automaton((start, automaton.states[1]), automaton.transitions)
    assert both(sheared) == pytest.approx((2.449984, 2.449984), abs=5e-7)


@pytest.mark.parametrize("rules", [straight(3), BEZIER, rough((0.5, 0.3), (0.3, -0.2, 0.3))])
def test_sponges_of_eight_and_twenty_seven_controls(rules):
    m = len(rules[0]) ** 3
    assert both(sponge(rules)) == pytest.approx((MENGER, MENGER), abs=1e-9)
    stretched = sponge(rules)
    controls = np.diag([1.0, 7.0, 0.2]) @ stretched.states[0].controls
    stretched = Automaton((State("hex", controls),), stretched.transitions)
    assert both(stretched) == pytest.approx((MENGER, MENGER), abs=1e-9)
    # Bent cells are no similar images; a texture below one third adds nothing to the bound.
    assert similarity_dimension(sponge(rules, bend=bent(m, 2))) is None
    assert affinity_dimension(sponge(rules, bend=bent(m, 2))) == pytest.approx(MENGER, abs=1e-9)


def test_rough_textures_raise_the_bound():
    automaton = sponge(rough((0.5, 0.3), (0.45, -0.4, 0.45)), bend=bent(27, 2))
    assert affinity_dimension(automaton) == 3.0
    # Graphs: 1 + ln Σ|r| / ln 3, the box dimension, is what the bound on curves gives.
    graph = curve(rough((0.5, 0.3), (0.45, -0.4, 0.45)), [(0, 0), (0.5, 1), (1, 0)])
    assert affinity_dimension(graph) == pytest.approx(1 + math.log(1.3) / math.log(3), abs=1e-9)
    assert affinity_dimension(curve(takagi(0.7), [(0, 0), (0.5, 1), (1, 0)])) == pytest.approx(
        2 + math.log2(0.7), abs=1e-9
    )


def koch():
    """The four maps of von Koch's curve on three controls."""
    first = [[1, 2 / 3, 2 / 3], [0, 1 / 3, 0], [0, 0, 1 / 3]]
    second = [[2 / 3, 1 / 3, 0], [0, 2 / 3, 1], [1 / 3, 0, 0]]
    rules = [np.array(first), np.array(second)]
    rules += [T[::-1, ::-1].copy() for T in reversed(rules)]
    return rules


def test_von_koch_s_curve():
    dimension = math.log(4) / math.log(3)
    assert dimension == pytest.approx(1.261860, abs=5e-7)
    flat = curve(koch(), [(0, 0), (0.5, math.sqrt(3) / 6), (1, 0)])
    assert both(flat) == pytest.approx((dimension, dimension), abs=1e-9)
    # Other controls give an affine image, of the same dimension.
    leaning = curve(koch(), [(0, 0), (0.9, 0.7), (1, 0)])
    assert both(leaning) == pytest.approx((dimension, dimension), abs=1e-9)


def test_faces_of_the_koch_cube_with_a_terminal_cell():
    # Eight ninths of a square and five faces of the cube on the middle one, which is terminal.
    # Controls: the corners in the order of a square, and the centre raised by an edge's length.
    def weights(point):
        x, y, z = point
        u, v = np.array([-1.0, 1, 0, 0, 0]), np.array([-1.0, 0, 0, 1, 0])
        up = np.array([-0.25, -0.25, -0.25, -0.25, 1])
        return np.array([1.0, 0, 0, 0, 0]) + x * u + y * v + z * up

    def face(origin, along, across):
        o, a, b = (np.array(vector) / 3 for vector in (origin, along, across))
        points = [o, o + a, o + a + b, o + b, o + (a + b) / 2 + 3 * np.cross(a, b)]
        return np.column_stack([weights(point) for point in points])

    x, y, z = np.eye(3)
    flat = [face((i, j, 0), x, y) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    raised = [face((1, 1, 1), x, y), face((1, 1, 0), x, z), face((2, 1, 0), y, z)]
    raised += [face((2, 2, 0), -x, z), face((1, 2, 0), -y, z)]
    cube = np.column_stack([weights((1 / 3, 1 / 3, 0)), weights((2 / 3, 2 / 3, 1 / 3))])
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]]).T
    moves = [Transition(0, 0, T) for T in flat + raised] + [Transition(0, 1, cube)]
    automaton = Automaton((State("face", corners), State("cube", np.zeros((3, 2)))), tuple(moves))
    assert both(automaton) == pytest.approx((2.334718, 2.334718), abs=5e-7)


def test_circles_and_ends_of_states_of_many_controls():
    square, strut = State("cell", np.eye(3)), State("strut", np.eye(3)[:, :2])
    halves = rough((0.5,), (0.3, 0.3))
    ends = Automaton((square, strut), (Transition(0, 1, halves[0][:, :2]),))
    assert both(ends) == (-math.inf, -math.inf)
    assert affinity_bound(ends, 1) == -math.inf
    circle = Automaton((square, strut), (*ends.transitions, Transition(0, 0, halves[0])))
    assert affinity_dimension(circle) == 0.0
    vertex = Automaton((State("v", np.zeros((3, 1))),), (Transition(0, 0, np.eye(1)),))
    assert both(vertex) == (0.0, 0.0)
