"""Controlled systems: states with controls and drawings of their own, terminal states, weights."""

from __future__ import annotations

import itertools
import math
import pickle
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt
from systems import MENGER, PARITY

from porous.errors import MemoryLimitError, ModelError, RecipeError
from porous.measures import components, measure, similarity_dimension, volume
from porous.models.automaton import (
    Automaton,
    State,
    Transition,
    count_cells,
    frames,
    of_maps,
    words,
)
from porous.models.cifs import CIFS, cifs
from porous.models.distinct import distinct_cells
from porous.models.drawing import Body, cell, image, nothing, sticks
from porous.models.ifs import ifs
from porous.models.mixtures import weights_of
from porous.models.pieces import Pieces
from porous.models.primitive import named
from porous.recipe import build, dump, load, parse
from porous.stages import voxelize
from porous.values import CENTRE, FILL, Box, Frame

FRAME = np.hstack([np.zeros((3, 1)), np.eye(3)])
CUBE = np.array(list(itertools.product((0.0, 1.0), repeat=3))).T
UNIT = Box((0, 0, 0), (1, 1, 1))
SOLID = named("octahedron")


def contraction(rng, size=0.6):
    """Return a random map that shrinks, as (matrix, translation)."""
    A = rng.uniform(-1, 1, (3, 3))
    return A * size / np.linalg.norm(A, 2), rng.uniform(-0.5, 0.5, 3)


def boxes(divisions, keep):
    """Return the weights of sub-boxes of a hexahedron of eight controls."""
    state = State("hexa", CUBE)
    return [weights_of(state, (CUBE.T + d) / divisions) for d in np.array(keep, float)]


# --- what a system is ------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["cube", "tetrahedron", "ball", "icosahedron"])
def test_one_affine_state_is_an_ifs_voxel_for_voxel(name):
    rng = np.random.default_rng(len(name))
    for _ in range(5):
        maps = [contraction(rng) for _ in range(3)]
        plain = ifs(maps, level=3, primitive=name, offset=0.02)
        made = cifs(of_maps(maps), [name], level=3, offset=0.02)
        assert (made.domain, made.bulk) == (plain.domain, plain.bulk)
        frame = Frame.fit(made.domain, spacing=(0.11, 0.09, 0.07))
        assert np.array_equal(made.sample(frame, FILL), plain.sample(frame, FILL))
        assert np.array_equal(made.cover(frame)[0], plain.cover(frame)[0])
        assert made.smallest_feature() == pytest.approx(plain.smallest_feature(), rel=1e-9)


def test_a_digit_set_written_as_states_has_its_closed_forms():
    maps = [(np.eye(3) / 3, np.array(d) / 3) for d in MENGER]
    made = cifs(of_maps(maps), ["cube"], level=2)
    assert made.domain == made.bulk == UNIT
    rows = {row.name: row.value for row in made.exact()}
    assert rows["volume"] == pytest.approx((20 / 27) ** 2, rel=1e-12)
    assert made.exact((True, True, True)) == ()
    assert voxelize(made, voxels=27).fill.mean() / 255 == pytest.approx((20 / 27) ** 2, abs=1e-12)
    assert made.boundary().volume == pytest.approx((20 / 27) ** 2, rel=1e-9)


def test_the_limit_of_states_that_are_images_of_space_is_the_attractor():
    maps = [(np.eye(3) / 2, p / 2) for p in FRAME.T]
    plain, made = ifs(maps, level="limit"), cifs(of_maps(maps), ["cube"], level="limit")
    frame = Frame.fit(made.domain, spacing=(0.06, 0.05, 0.04))
    assert np.array_equal(made.cover(frame)[0], plain.cover(frame)[0])
    assert made.feature_size is None
    assert not made.is_cut
    grown = cifs(of_maps(maps), ["none"], level="limit", offset=0.05)
    assert grown.sample(frame, CENTRE).any()
    assert grown.sampling_error(frame) > 0


def mixed(rng, names=("block", "cell", "strut", "knot")):
    """Return a random system of states with 8, 4, 2 and 1 controls, two of them terminal."""
    states = (
        State(names[0], CUBE),
        State(names[1], FRAME),
        State(names[2], np.array([[0, 0, 0], [0, 0, 1.0]]).T),
        State(names[3], np.zeros((3, 1))),
    )
    ends = [(0, 1), (0, 0), (0, 2), (1, 2), (1, 0), (1, 1), (1, 3)]
    transitions = []
    for a, b in ends:
        matrix = rng.uniform(0, 1, (states[a].size, states[b].size))
        transitions.append(Transition(a, b, matrix / matrix.sum(axis=0)))
    drawings = (
        cell(8),
        image(SOLID, states[1]),
        sticks(2, beams="edges", radius=[0.05, 0.04, 0.03]),
        sticks(1, balls="all", radius=0.06),
    )
    return Automaton(states, tuple(transitions)), drawings


def reordered(automaton, drawings, order):
    """Return the same system with its states in another order and other names."""
    place = np.argsort(order)
    states = [State(f"s{q}", automaton.states[q].controls) for q in order]
    by_source = sorted(automaton.transitions, key=lambda t: place[t.source])
    transitions = [Transition(place[t.source], place[t.target], t.matrix) for t in by_source]
    made = Automaton(tuple(states), tuple(transitions), int(place[automaton.start]))
    return made, tuple(drawings[q] for q in order)


def test_renamed_and_reordered_states_are_the_same_body():
    rng = np.random.default_rng(5)
    frame = Frame.fit(Box((-0.1, -0.1, -0.1), (1.1, 1.1, 1.1)), spacing=(0.12, 0.1, 0.15))
    for _ in range(100):
        automaton, drawings = mixed(rng)
        other = reordered(automaton, drawings, rng.permutation(4))
        one, two = (CIFS(*pair, 2, UNIT, UNIT) for pair in ((automaton, drawings), other))
        assert np.array_equal(one.sample(frame, FILL), two.sample(frame, FILL))


def test_bodies_lie_in_their_domain_and_values_are_values():
    rng = np.random.default_rng(6)
    for _ in range(10):
        made = cifs(*mixed(rng), level=2, offset=0.01)
        around = Frame.fit(made.domain.grown(0.2), spacing=(0.06, 0.05, 0.04))
        centres = [
            o + (np.arange(n) + 0.5) * h
            for o, n, h in zip(around.origin, around.shape, around.spacing, strict=True)
        ]
        found = np.argwhere(made.sample(around, CENTRE))
        places = np.stack([c[i] for c, i in zip(centres, found.T, strict=True)], axis=1)
        assert len(places)
        assert (places >= np.array(made.domain.lower)).all()
        assert (places <= np.array(made.domain.upper)).all()
        assert not made.is_cut
        assert pickle.loads(pickle.dumps(made)) == made
    assert replace(made, domain=Box((0, 0, 0), (0.5, 0.5, 0.5))).is_cut


def test_level_zero_box_is_the_domain_where_nothing_leaves_it():
    rng = np.random.default_rng(7)
    automaton, drawings = mixed(rng)
    made = cifs(automaton, ("cell", "none", "none", "none"), level=0)
    assert made.domain == made.bulk == UNIT
    # Weights that mix are in the hull of the controls: radii alone reach out.
    grown = cifs(automaton, ("cell", "none", drawings[2], "none"), level=1)
    assert grown.bulk == UNIT
    assert grown.domain == UNIT.grown(0.05)


# --- terminal and transient states ------------------------------------------------------------


def tree(divisions, height=0.45):
    """Return N × N subtrees on a trunk: states of 5 controls and a terminal one of 2."""
    corners = [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)]
    controls = np.array([(*c, 1.0) for c in corners] + [(0.5, 0.5, 0.0)]).T
    node = np.array([height / 4] * 4 + [1 - height])
    children = []
    for i, j in itertools.product(range(divisions), repeat=2):
        columns = []
        for a, b in corners:
            u, v = (i + a) / divisions, (j + b) / divisions
            columns.append([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v, 0])
        children.append(Transition(0, 0, np.array([*columns, node]).T))
    trunk = np.array([[0, 0, 0, 0, 1.0], node]).T
    states = State("tree", controls), State("trunk", controls[:, 4:] @ np.ones((1, 2)))
    return Automaton(states, (*children, Transition(0, 1, trunk)))


@pytest.mark.parametrize("divisions", [2, 3])
def test_terminal_cells_are_drawn_once_and_remember_their_level(divisions):
    automaton, fan = tree(divisions), divisions**2
    for level in range(4):
        groups, births = distinct_cells(automaton, level)
        trunks = [births[g.place] for g in groups if g.state == 1]
        amounts = np.bincount(trunks[0]) if trunks else np.zeros(1, int)
        # Σ N²ᵏ = (N²ⁿ − 1) / (N² − 1) beams: bcifs trees have one per node and level.
        assert amounts.sum() == (fan**level - 1) // (fan - 1)
        assert amounts[1:].tolist() == [fan**k for k in range(level)]
        assert len(births) == count_cells(automaton, level)
        # What a word still says after its end is −1: the twin by addresses.
        ended = (words(automaton, level) >= 0).sum(axis=1)
        assert np.array_equal(births, ended)


def test_radii_follow_the_level_of_birth():
    automaton = tree(2)
    made = cifs(
        automaton, ["none", sticks(2, beams="edges", radius=[9, 0.08, 0.04])], level=3, unit="cm"
    )
    balls = {}
    for part in made.body.parts:
        for length, radius in zip(
            np.linalg.norm(np.diff(part.capsules, axis=1)[:, 0], axis=1),
            part.capsule_radii,
            strict=True,
        ):
            balls.setdefault(round(float(radius), 9), []).append(length)
    assert {radius: len(found) for radius, found in balls.items()} == {0.08: 1, 0.04: 20}
    assert made.smallest_feature() == pytest.approx(0.08)


def test_three_then_two_counts_boxes():
    threes, twos = boxes(3, MENGER), boxes(2, PARITY)
    automaton = Automaton(
        (State("first", CUBE), State("then", CUBE)),
        (*(Transition(0, 1, T) for T in threes), *(Transition(1, 1, T) for T in twos)),
    )
    for level, amount in enumerate((1, 20, 20 * 4, 20 * 4 * 4)):
        made = cifs(automaton, ["cell", "cell"], level=level)
        assert sum(len(g.place) for g in made.cells) == amount
        side = 1 if not level else 3 * 2 ** (level - 1)
        grid = voxelize(made, voxels=side, sampling="centre")
        assert int(grid.solid.sum()) == amount
        assert made.domain == UNIT
        width = made.smallest_feature()
        assert width == pytest.approx(1 / side)
    assert made.finest_printable_level(1 / 3) == 1
    assert made.finest_printable_level(1 / 6) == 2
    assert made.finest_printable_level(2.0) is None


# --- the Koch cube ----------------------------------------------------------------------------


def koch(level):
    """Return the preset at a level, sampled where its cubes end."""
    end = sum(3.0**-k for k in range(1, level + 1))
    domain = {"lower": [-end] * 3, "upper": [1 + end] * 3}
    model = build(load("koch-cube", set={"model.level": level, "model.domain": domain}))
    return model, voxelize(model, voxels=round((1 + 2 * end) * 3**level))


@pytest.mark.parametrize(("level", "euler"), [(0, 1), (1, 1), (2, -23), (3, -455)])
def test_koch_cubes_are_those_of_the_literature(level, euler):
    model, grid = koch(level)
    assert set(np.unique(grid.fill)) <= {0, 255}
    part = 1 + 3 / 7 * (1 - (13 / 27) ** level)
    assert grid.solid.sum() == round(part * 27**level)
    assert volume(grid).value == pytest.approx(part, rel=1e-12)
    padded = np.pad(grid.solid, 1)
    faces = sum(int(np.abs(np.diff(padded.astype(np.int8), axis=a)).sum()) for a in range(3))
    assert faces == 6 * 13**level
    rows = {row.name: row.value for row in measure(grid)}
    assert rows["euler_number_26"] == euler
    assert rows["components"] == 1
    assert similarity_dimension(model).value == pytest.approx(math.log(13) / math.log(3), abs=1e-12)
    assert not model.is_cut


def test_the_koch_cube_fills_half_an_edge_around_itself():
    model = build(load("koch-cube"))
    domain = cifs(model.automaton, model.drawings, level=0).domain
    assert domain.lower == pytest.approx((-0.5, -0.5, -0.5), abs=2e-3)
    assert domain.contains(Box((-0.5, -0.5, -0.5), (1.5, 1.5, 1.5)), tolerance=1e-12)
    assert domain.upper == pytest.approx((1.5, 1.5, 1.5), abs=2e-3)


# --- drawings ---------------------------------------------------------------------------------


def measured(body, box, spacing):
    frame = Frame.fit(box, spacing=spacing)
    masks = body.sample(frame, FILL)
    return int(np.bitwise_count(masks).sum()) / 64 * math.prod(frame.spacing)


def one_cell(drawing, controls):
    """Return what one cell is drawn as, as a body."""
    from porous.models.automaton import Cells
    from porous.models.drawing import body

    group = Cells(0, np.asarray(controls, float)[None], np.zeros(1, np.int64))
    return body([drawing], [group], np.zeros(1, np.int64))


OCTA = np.array(
    [[0, 1, 0.5, 0.5, 0.5, 0.5], [0.5, 0.5, 0, 1, 0.5, 0.5], [0.5, 0.5, 0.5, 0.5, 0, 1]]
)
LATTICE = np.array(list(itertools.product((0, 0.5, 1), repeat=3))).T
SOLIDS = {4: (FRAME, 1 / 6), 6: (OCTA, 1 / 6), 8: (CUBE, 1.0), 27: (LATTICE, 1.0)}


@pytest.mark.parametrize("controls", SOLIDS)
def test_cells_are_the_solids_on_their_controls(controls):
    rng = np.random.default_rng(controls)
    points, size = SOLIDS[controls]
    for _ in range(3):
        A = np.eye(3) + rng.uniform(-0.4, 0.4, (3, 3))
        made = one_cell(cell(controls), A @ points)
        box = Box.of_points((A @ points).T).grown(0.05)
        found = measured(made, box, (0.03, 0.026, 0.033))
        assert found == pytest.approx(size * abs(np.linalg.det(A)), rel=0.01)
    width = cell(controls).thinnest(points[None], np.zeros(1, int))
    assert width == pytest.approx({4: 1 / math.sqrt(3), 6: 1 / math.sqrt(3)}.get(controls, 1.0))


def test_sticks_are_capsules_balls_and_plates():
    length, r, t = 1.3, 0.11, 0.2
    beam = one_cell(sticks(2, beams="edges", radius=r), [[0, length], [0, 0], [0, 0]])
    found = measured(beam, Box((-0.2, -0.2, -0.2), (1.5, 0.2, 0.2)), (0.021, 0.017, 0.019))
    assert found == pytest.approx(math.pi * r**2 * (length + 4 / 3 * r), rel=0.01)
    ball = one_cell(sticks(1, balls=[0], radius=0.4), [[0.1], [0.2], [0.3]])
    found = measured(ball, Box((-0.4, -0.4, -0.4), (0.6, 0.7, 0.8)), (0.021, 0.027, 0.029))
    assert found == pytest.approx(4 / 3 * math.pi * 0.4**3, rel=0.01)
    # Steiner: area · t + perimeter · π (t/2)² / 2 + a ball's volume.
    quad = np.array([[0, 1, 1, 0], [0, 0, 0.7, 0.7], [0, 0, 0, 0]])
    plate = one_cell(sticks(4, plates=[[0, 1, 2, 3]], thickness=t), quad)
    found = measured(plate, Box((-0.2, -0.2, -0.2), (1.2, 0.9, 0.2)), (0.021, 0.017, 0.019))
    h = t / 2
    wanted = 0.7 * t + 3.4 * math.pi * h**2 / 2 + 4 / 3 * math.pi * h**3
    assert found == pytest.approx(wanted, rel=0.01)
    triangle = sticks(3, plates=[[0, 1, 2]], beams="edges", radius=0.05, thickness=t)
    assert triangle.thinnest(quad[None, :, :3], np.zeros(1, int)) == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("controls", "edges"), [(2, 1), (3, 3), (4, 6), (6, 12), (8, 12), (27, 12)]
)
def test_edges_are_those_of_the_solid(controls, edges):
    drawing = sticks(controls, beams="edges", radius=1.0)
    assert len(drawing.beams) == edges
    if controls in SOLIDS and controls != 4:
        points = SOLIDS[controls][0]
        ends = points[:, drawing.beams]
        lengths = np.linalg.norm(ends[..., 0] - ends[..., 1], axis=0)
        assert np.ptp(lengths) < 1e-12


def test_bodies_of_nothing_are_empty():
    frame = Frame.fit(UNIT, spacing=(0.3, 0.25, 0.2))
    empty = Body(())
    assert not empty.sample(frame, CENTRE).any()
    assert empty.cover(frame)[1] == 0
    assert nothing(5).is_empty
    assert nothing(5).thinnest(np.zeros((1, 3, 5)), np.zeros(1, int)) == math.inf


def test_an_offset_grows_every_part():
    rng = np.random.default_rng(9)
    automaton, drawings = mixed(rng)
    frame = Frame.fit(UNIT.grown(0.3), spacing=(0.07, 0.06, 0.05))
    made = cifs(automaton, drawings, level=1)
    grown = cifs(automaton, drawings, level=1, offset=0.1)
    # The same voxels by distances from a cover of the body, give or take a voxel.
    marks, bound = made.cover(frame)
    away = distance_transform_edt(marks == 0, sampling=frame.spacing)
    outer = grown.sample(frame, CENTRE) > 0
    assert outer[away <= 0.1 - bound].all()
    assert not outer[away > 0.1 + bound].any()
    assert (made.sample(frame, CENTRE) <= marks).all()
    assert grown.smallest_feature() == pytest.approx(made.smallest_feature() + 0.2)


# --- weights ----------------------------------------------------------------------------------


def test_weights_give_the_points_and_sum_to_one():
    rng = np.random.default_rng(10)
    for _ in range(100):
        A, b = rng.uniform(-1, 1, (3, 3)), rng.uniform(-1, 1, (3, 1))
        for controls in (FRAME, CUBE, CUBE[:, :4], CUBE[:, :2], OCTA, CUBE[:, :5]):
            state = State("any", A @ controls + b)
            known = rng.dirichlet(np.ones(controls.shape[1]), 4)
            points = (state.controls @ known.T).T
            found = weights_of(state, points)
            assert state.controls @ found == pytest.approx(points.T, abs=1e-9)
            assert found.sum(axis=0) == pytest.approx(1, abs=1e-9)


def test_weights_of_boxes_are_products_of_those_of_their_edges():
    rng = np.random.default_rng(11)
    state = State("hexa", CUBE)
    for u, v, w in rng.uniform(-0.2, 1.2, (20, 3)):
        wanted = np.kron(np.kron([1 - u, u], [1 - v, v]), [1 - w, w])
        assert weights_of(state, np.array([[u, v, w]]))[:, 0] == pytest.approx(wanted, abs=1e-12)
    quad = State("quad", CUBE[:, :4] + 0.3)
    found = weights_of(quad, np.array([[0.3, 0.3 + 0.25, 0.3 + 0.5]]))[:, 0]
    assert found == pytest.approx(np.kron([0.75, 0.25], [0.5, 0.5]), abs=1e-12)


def test_weights_of_others_are_the_least():
    rng = np.random.default_rng(12)
    controls = rng.uniform(0, 1, (3, 7))
    point = controls.mean(axis=1) + 0.1
    found = weights_of(State("any", controls), point[None])[:, 0]
    lifted = np.vstack([controls, np.ones(7)])
    free = np.linalg.svd(lifted)[2][4:]
    assert np.abs(free @ found).max() < 1e-12


def test_a_bent_block_is_of_trilinear_volume():
    twist = CUBE.copy()
    c, s = math.cos(0.5), math.sin(0.5)
    top = CUBE[2] == 1
    twist[:2, top] = np.array([[c, -s], [s, c]]) @ (CUBE[:2, top] - 0.5) + 0.5
    twos = [Transition(0, 0, T) for T in boxes(2, list(itertools.product((0, 1), repeat=3)))]
    automaton = Automaton((State("cell", CUBE),), tuple(twos))
    found = []
    for level in (0, 2):
        made = cifs(automaton, ["cell"], level=level, controls=twist.T)
        grid = voxelize(made, spacing=(0.021, 0.019, 0.023))
        found.append(volume(grid).value)
    # ∫ of |(1 − z) I + z R|, R a turn: 1 − 2 (1 − cos) ∫ z (1 − z) = 1 − (1 − cos) / 3.
    assert found[0] == pytest.approx(1 - (1 - c) / 3, rel=2e-3)
    assert found[1] == pytest.approx(found[0], rel=2e-3)


def test_moved_controls_move_the_whole_body():
    rng = np.random.default_rng(13)
    A, b = np.eye(3) + rng.uniform(-0.3, 0.3, (3, 3)), rng.uniform(-1, 1, 3)
    maps = [contraction(rng) for _ in range(3)]
    made = cifs(of_maps(maps), ["octahedron"], level=2, controls=(A @ FRAME).T + b)
    other = cifs(of_maps(maps), ["octahedron"], level=2)
    frame = Frame.fit(made.domain, spacing=(0.06, 0.05, 0.07))
    images = frames(other.automaton, other.cells)
    placed = np.concatenate([A @ images[:, :, :3], (A @ images[:, :, 3:] + b[:, None])], axis=2)
    twin = Pieces(named("octahedron"), placed).sample(frame, FILL)
    assert np.array_equal(made.sample(frame, FILL), twin)
    assert made.exact() == ()
    assert made.plain is None


def test_a_size_scales_controls_and_leaves_radii():
    rng = np.random.default_rng(14)
    automaton, drawings = mixed(rng)
    made = cifs(automaton, drawings, level=1)
    large = cifs(automaton, drawings, level=1, size=10.0, unit="um")
    assert max(large.bulk.lengths) == pytest.approx(10)
    factor = 10 / max(made.bulk.lengths)
    assert large.cells[0].points == pytest.approx(made.cells[0].points * factor)
    assert large.domain.lengths[0] - large.bulk.lengths[0] == pytest.approx(0.12)


# --- recipes ----------------------------------------------------------------------------------

RECIPE = """
[model]
kind = "cifs"
start = "cell"
level = 2

[model.states.cell]
controls = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
draw = "cube"
children = [
    { state = "cell", map = { matrix = [[0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5]] } },
    { state = "strut", points = [[0, 0, 0], [1, 1, 1]] },
    { state = "strut", matrix = [[0, 1], [1, 0], [0, 0], [0, 0]] },
]

[model.states.strut]
controls = [[0, 0, 0], [0, 0, 1]]
draw = { beams = [[0, 1]], radius = 0.1 }
"""
HALF = "[[0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5]]"
BAD = {
    "unknown state": (
        'state = "cell", map',
        'state = "cel", map',
        "cell.children.0.state: no state 'cel'; did you mean 'cell'",
    ),
    "unknown start": (
        'start = "cell"',
        'start = "sell"',
        "start: no state 'sell'; did you mean 'cell'",
    ),
    "no start": ('start = "cell"\n', "", "model.start: got nothing; wanted the name"),
    "never reached": ('start = "cell"', 'start = "strut"', "state 0 .'cell'. is never reached"),
    "matrix of another shape": (
        "[[0, 1], [1, 0], [0, 0], [0, 0]]",
        "[[0, 1], [1, 0]]",
        "cell.children.2.matrix: got 2 rows of .2. numbers; wanted 4 rows",
    ),
    "ragged matrix": (
        "[[0, 1], [1, 0], [0, 0], [0, 0]]",
        "[[0, 1], [1], [0, 0], [0, 0]]",
        "children.2.matrix: got 4 rows of .1, 2. numbers",
    ),
    "matrix of words": (
        "[[0, 1], [1, 0], [0, 0], [0, 0]]",
        '[["a"]]',
        'model.states.cell.children.2.matrix.0.0: got "a"; wanted rows of weights',
    ),
    "columns that do not sum": (
        "[[0, 1], [1, 0], [0, 0], [0, 0]]",
        "[[0, 1], [0.9, 0], [0, 0], [0, 0]]",
        "cell.children.2.matrix: column 0 sums to 0.9; wanted 1",
    ),
    "too few points": (
        "points = [[0, 0, 0], [1, 1, 1]]",
        "points = [[0, 0, 0]]",
        "children.1.points: got 1; wanted 2, the controls of 'strut'",
    ),
    "points and a matrix": (
        "points = [[0, 0, 0], [1, 1, 1]]",
        "points = [[0, 0, 0], [1, 1, 1]], matrix = [[1]]",
        "model.states.cell.children.1: got matrix and points",
    ),
    "no place": (
        ", points = [[0, 0, 0], [1, 1, 1]]",
        "",
        "model.states.cell.children.1: got none of matrix, points and map",
    ),
    "a point off the span": (
        "draw = { beams = [[0, 1]], radius = 0.1 }",
        'draw = "none"\nchildren = [{ state = "strut", points = [[0, 0, 0], [0, 1, 0.5]] }]',
        "states.strut.children.0.points.1.: .*wanted a point that is a mixture",
    ),
    "no drawing": ('draw = "cube"\n', "", "model.states.cell.draw: got nothing; wanted"),
    "unknown drawing": (
        'draw = "cube"',
        'draw = "cubes"',
        "states.cell.draw: no drawing 'cubes'; did you mean 'cube'",
    ),
    "unknown key": (
        "radius = 0.1",
        "radus = 0.1",
        "model.states.strut.draw.radus: unknown key; did you mean 'radius'",
    ),
    "a number for a drawing": (
        'draw = "cube"',
        "draw = 3",
        'model.states.cell.draw: got 3; wanted "none"',
    ),
    "no radius": (
        ", radius = 0.1",
        "",
        "model.states.strut.draw: got no radius; wanted it with balls and beams",
    ),
    "no radii": (
        "radius = 0.1",
        "radius = []",
        "model.states.strut.draw.radius: got ..; wanted a length",
    ),
    "a radius of zero": (
        "radius = 0.1",
        "radius = [0.1, 0]",
        "model.states.strut.draw.radius.*: got .*; wanted a length",
    ),
    "a thickness without plates": (
        "radius = 0.1",
        "radius = 0.1, thickness = 1.0",
        "model.states.strut.draw: got thickness",
    ),
    "nothing to draw": (
        "{ beams = [[0, 1]], radius = 0.1 }",
        "{ radius = 0.1 }",
        "model.states.strut.draw: got no balls, beams or plates",
    ),
    "a control that is not there": (
        "beams = [[0, 1]]",
        "beams = [[0, 2]]",
        "states.strut.draw.beams: got control 2; this state has 2, 0 … 1",
    ),
    "a beam of three": (
        "beams = [[0, 1]]",
        "beams = [[0, 1, 1]]",
        "model.states.strut.draw.beams.*: got .*wanted",
    ),
    "a cube on two controls": (
        "draw = { beams = [[0, 1]], radius = 0.1 }",
        'draw = "cube"',
        'states.strut.draw: "cube" is carried along by four independent',
    ),
    "a cell of two controls": (
        "draw = { beams = [[0, 1]], radius = 0.1 }",
        'draw = "cell"',
        'states.strut.draw: "cell" is a solid on 4, 6, 8 or 27',
    ),
    "no controls": (
        "controls = [[0, 0, 0], [0, 0, 1]]",
        "controls = []",
        "model.states.strut.controls: got ..; wanted",
    ),
    "controls of two numbers": (
        "controls = [[0, 0, 0], [0, 0, 1]]",
        "controls = [[0, 0], [0, 0]]",
        "model.states.strut.controls.0",
    ),
    "a level of half": ("level = 2", "level = 1.5", "model.level: got 1.5; wanted"),
    "fused contacts": (
        "level = 2",
        'level = 2\ncontacts = "fuse"',
        'model.contacts: got "fuse"; wanted "apart"',
    ),
    "no states": (
        RECIPE[RECIPE.index("[model.states.cell]") :],
        "[model.states]",
        "model.states: got .*; wanted a table for each state",
    ),
    "controls of another number": (
        "level = 2",
        "level = 2\ncontrols = [[0, 0, 0]]",
        r"controls: got shape \(1, 3\); wanted \(4, 3\)",
    ),
    "a map that does not shrink": (
        f"matrix = {HALF}",
        "matrix = [[1, 0, 0], [0, 0.5, 0], [0, 0, 0.5]]",
        "no attractor: .*states.cell.children.0",
    ),
    "a flat map": (
        f"matrix = {HALF}",
        "matrix = [[0.5, 0, 0], [0, 0.5, 0], [0, 0, 0]]",
        "states.cell.children.0: got a singular matrix",
    ),
}


def built(text):
    """Return the model of a recipe's text."""
    return build(parse(tomllib.loads(text), name="my.toml"))


@pytest.mark.parametrize("what", BAD)
def test_bad_recipes_name_the_key_or_the_state(what):
    old, new, said = BAD[what]
    assert old in RECIPE
    with pytest.raises((RecipeError, ModelError, MemoryLimitError), match=said) as found:
        voxelize(built(RECIPE.replace(old, new)), voxels=4)
    assert "\n" not in str(found.value)


def test_what_a_level_cannot_be():
    rng = np.random.default_rng(15)
    automaton, drawings = mixed(rng)
    with pytest.raises(ModelError, match=r"ever smaller cells of 'strut', whose radius"):
        cifs(
            automaton,
            [*drawings[:2], sticks(2, beams="edges", radius=0.1), nothing(1)],
            level="limit",
        )
    ends = Automaton(
        (State("a", FRAME), State("b", FRAME)),
        (Transition(0, 0, weights_of(State("a", FRAME), FRAME.T / 2)), Transition(0, 1, np.eye(4))),
    )
    with pytest.raises(ModelError, match="does not grow the cells of 'b'"):
        cifs(ends, ["cube", "cube"], level="limit", offset=0.1)
    finite = Automaton(ends.states, ends.transitions[1:])
    with pytest.raises(ModelError, match="all that start from 'a' end"):
        cifs(finite, ["cube", "cube"], level="limit")
    with pytest.raises(ModelError, match="nothing is drawn at level 0, whose cells are of 'block'"):
        cifs(automaton, ["none", *drawings[1:]], level=0)
    with pytest.raises(ModelError, match="wanted one for each of 4 states"):
        cifs(automaton, drawings[:3])
    with pytest.raises(ModelError, match="drawings: no state 'knob'; did you mean 'knot'"):
        cifs(automaton, {"knob": "none"})
    with pytest.raises(ModelError, match="a drawing on 8 controls; this state has 4"):
        cifs(automaton, [drawings[0], drawings[0], *drawings[2:]])
    with pytest.raises(ModelError, match="level: got -1; wanted 0"):
        cifs(automaton, drawings, level=-1)
    with pytest.raises(ModelError, match="offset: got -1"):
        cifs(automaton, drawings, level=1, offset=-1, domain=UNIT)
    many = cifs(of_maps([contraction(rng) for _ in range(9)]), ["none"], level="limit", offset=1)
    with pytest.raises(MemoryLimitError, match="level 30"):
        _ = cifs(many.automaton, ["cube"], level=30, domain=UNIT).cells
    with pytest.raises(ModelError, match="exact boundaries"):
        cifs(automaton, drawings, level=1, domain=UNIT).boundary()


def test_flat_bodies_want_a_thickness():
    half = weights_of(State("a", CUBE[:, :4]), CUBE[:, :4].T / 2)
    flat = Automaton((State("a", CUBE[:, :4]),), (Transition(0, 0, half),))
    thin = cifs(flat, [sticks(4, plates=[[0, 1, 3, 2]], thickness=0.2)], level=1)
    assert thin.domain == Box((-0.1, -0.1, -0.1), (0.1, 1.1, 1.1))
    assert thin.bulk == thin.domain
    with pytest.raises(ModelError, match="all controls lie in a plane"):
        cifs(flat, [cell(4)], level=1)


@pytest.mark.parametrize("name", ["koch-cube", "branching-struts"])
def test_recipes_are_read_as_they_are_written(name):
    recipe = load(name)
    again = parse(tomllib.loads(dump(recipe)))
    assert again == recipe
    assert dump(again) == dump(recipe)
    assert build(again) == build(recipe)


def test_a_map_and_points_and_a_matrix_are_one_child():
    frame = Frame.fit(UNIT.grown(0.1), spacing=(0.06, 0.05, 0.04))
    one = built(RECIPE)
    two = built(
        RECIPE.replace(
            f"map = {{ matrix = {HALF} }}",
            "points = [[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5]]",
        ).replace("matrix = [[0, 1], [1, 0], [0, 0], [0, 0]]", "points = [[1, 0, 0], [0, 0, 0]]")
    )
    assert one == two
    assert np.array_equal(one.sample(frame, FILL), two.sample(frame, FILL))
    assert voxelize(one, per_feature=2).solid.any()


def test_branching_struts_stand_on_their_base_and_carry_their_plate():
    made = build(load("branching-struts"))
    grid = voxelize(made, voxels=60)
    assert components(grid).value == 1
    assert grid.solid[:, :, 1].any()
    assert grid.solid[:, :, -2].any()
    # Layers of a level: one of each power of four; each leaves sixteen struts, of which neighbours
    # share those that stand on their border.
    amounts = {made.automaton.states[g.state].name: len(g.place) for g in made.cells}
    assert amounts == {"base": 1, "layer": 16, "strut": 16 + 7**2}


def test_systems_of_other_controls_have_measures_but_no_ratios():
    made = build(load("branching-struts"))
    rows = {row.name: row for row in measure(made)}
    assert set(rows) == {"smallest_feature", "similarity_dimension", "affinity_dimension"}
    # Its limit is the plate at the top: four halves of a layer, whatever the start makes of it.
    assert rows["similarity_dimension"].value == pytest.approx(2, abs=1e-12)
    assert (rows["smallest_feature"].value, rows["smallest_feature"].kind) == (0.06, "bound")


# --- far from the origin -----------------------------------------------------------------------


def far_away(controls, matrices, shift, level):
    """Return a system of one state whose controls and domain are moved along all axes."""
    lower, upper = controls.min(axis=1) + shift, controls.max(axis=1) + shift
    links = tuple(Transition(0, 0, matrix) for matrix in matrices)
    return cifs(
        Automaton((State("cell", controls + shift),), links),
        ["cell"] if level != "limit" or controls.shape[1] == 4 else ["none"],
        level=level,
        domain=Box(tuple(lower), tuple(upper)),
    )


HALVES = [(np.eye(4) + np.eye(4)[:, [k] * 4]) / 2 for k in range(4)]
MIXED = [0.5 * np.eye(6) + 0.5 * np.eye(6)[:, [k] * 6] for k in range(6)]
SIX = np.hstack([np.eye(3), -np.eye(3)])


@pytest.mark.parametrize(
    ("controls", "matrices", "level", "served", "refused"),
    [
        (FRAME, HALVES, "limit", 2.0**18, (2.0**24, 2.0**28, 1e8)),
        (FRAME, HALVES, 2, 2.0**6, (1e6, 1e12)),
        (SIX, MIXED, "limit", 2.0**30, (2.0**40, 1e14)),
    ],
)
def test_bodies_far_from_the_origin_have_the_same_voxels_or_none(
    controls, matrices, level, served, refused
):
    near, far = (
        voxelize(far_away(controls, matrices, shift, level), voxels=16, sampling="cover")
        for shift in (0.0, served)
    )
    assert near.fill.any()
    assert np.array_equal(near.fill, far.fill)
    for shift in refused:
        with pytest.raises(ModelError, match="nearer to the origin"):
            voxelize(far_away(controls, matrices, shift, level), voxels=16, sampling="cover")


def test_maps_of_controls_far_away_keep_their_matrices():
    shift = np.array([[1e9], [-3e8], [7e7]])
    moved = [
        Automaton((State("cell", FRAME + to),), tuple(Transition(0, 0, m) for m in HALVES))
        for to in (0.0, shift)
    ]
    near, far = (made.maps for made in moved)
    assert np.abs(far[:, :, :3] - near[:, :, :3]).max() < 1e-15
    fixed = far[:, :, :3] @ shift + far[:, :, 3:] - shift
    assert np.abs(fixed - near[:, :, 3:]).max() < 1e-6


@pytest.mark.parametrize("level", [2, "limit"])
def test_controls_with_weights_are_refused_in_the_users_words(level):
    weighted = State("cell", np.vstack([SIX, np.ones(6)]))
    automaton = Automaton((weighted,), tuple(Transition(0, 0, matrix) for matrix in MIXED))
    with pytest.raises(ModelError, match=r"states\.cell: got controls of shape \(4, 6\)"):
        cifs(automaton, ["cell"], level=level, domain=UNIT)
