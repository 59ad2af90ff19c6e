"""Dimensions against the literature, for one state and for several."""

import math

import numpy as np
import pytest

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
