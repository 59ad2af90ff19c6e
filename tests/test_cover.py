"""Covers: what they must hold, how far they may reach, and that nothing but the lattice shows."""

import itertools
import time
from concurrent.futures import ThreadPoolExecutor

import naive_sampling as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial import cKDTree

from porous.errors import ModelError
from porous.kernels.overlap import held
from porous.models import cover as covers
from porous.models import net
from porous.models.automaton import Automaton, State, Transition, of_maps
from porous.models.clouds import clouds
from porous.models.enclosure import enclosing_balls
from porous.models.pieces import Pieces
from porous.models.primitive import named, of_surface
from porous.models.rasterise import cover_attractor, cover_pieces, sample_attractor
from porous.values import CENTRE, FILL, Box, Frame, SurfaceMesh


def rotation(seed):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def turned_maps(count, ratio, seed):
    random = np.random.default_rng(seed)
    return [(rotation(100 * seed + k) * ratio, random.uniform(-0.5, 0.5, 3)) for k in range(count)]


MENGER = [
    (np.eye(3) / 3, np.array(d) / 3)
    for d in itertools.product(range(3), repeat=3)
    if sum(v == 1 for v in d) < 2
]
TETRA = [(np.eye(3) / 2, np.array(d) / 2) for d in [(0, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1)]]
FERN = [
    (np.diag([0.0, 0.16, 0.0]), np.zeros(3)),
    (np.array([[0.85, 0.04, 0], [-0.04, 0.85, 0.1], [0, -0.1, 0.3]]), np.array([0, 1.6, 0])),
    (np.array([[0.2, -0.26, 0], [0.23, 0.22, 0], [0, 0, 0.3]]), np.array([0, 1.6, 0])),
    (np.array([[-0.15, 0.28, 0], [0.26, 0.24, 0], [0, 0, 0.3]]), np.array([0, 0.44, 0])),
]
# Each map stretches y to x by 1.2, yet no word of two does: they contract together.
STRETCHING = [
    (np.array([[0, -1.2, 0], [0.5, 0, 0], [0, 0, 0.5]]), np.array([0.5, 0, 0.2])),
    (np.array([[0, 1.2, 0], [-0.5, 0, 0], [0, 0, 0.4]]), np.array([-0.5, 0, -0.1])),
]
# Parts that are ever flatter, or longer; in a plane; on a line; a point.
FLAT = [(rotation(k) @ np.diag([0.6, 0.5, 0.15]), np.eye(3)[k] / 2) for k in range(3)]
NEEDLES = [(rotation(k) @ np.diag([0.7, 0.2, 0.1]), np.eye(3)[k] / 2) for k in range(3)]
PLANE = [
    (rotation(7) @ np.diag([0.5, 0.5, 0.0]), rotation(7) @ np.array([x, y, 0.3]))
    for x, y in [(0, 0), (0.5, 0), (0.1, 0.5)]
]
LINE = [(np.outer(rotation(3)[0], [0.4, 0.1, 0.2]), rotation(3)[0] * k / 2) for k in range(3)]
SYSTEMS = {
    "menger": MENGER,
    "tetrahedron": TETRA,
    "fern": FERN,
    "stretching": STRETCHING,
    "turned": turned_maps(4, 0.5, 1),
    "overlapping": turned_maps(4, 0.6, 2),
    "flat": FLAT,
    "needles": NEEDLES,
    "plane": PLANE,
    "line": LINE,
    "point": [(rotation(4) * 0.5, np.array([0.1, 0.2, 0.3]))],
}
each_system = pytest.mark.parametrize("name", SYSTEMS)


def framed(maps, shape, margin=0.03):
    points = naive.chaos_points(maps, 20_000)
    box = Box.of_points(points)
    box = box.grown(margin * max(*box.lengths, 0.1))
    return Frame(box.lower, np.array(box.lengths) / shape, shape)


def covered(maps, frame, **options):
    automaton = of_maps(maps)
    return cover_attractor(automaton, enclosing_balls(automaton), frame, **options)


def voxels_of(points, frame):
    index = np.floor((points - frame.origin) / frame.spacing).astype(int) - frame.start
    inside = ((index >= 0) & (index < frame.shape)).all(axis=1)
    return tuple(index[inside].T)


def furthest_corners(index, frame, tree):
    """The largest distance of the corners of voxels from points, the points' own being known."""
    worst = 0.0
    for corner in itertools.product((0, 1), repeat=3):
        at = frame.origin + (index + frame.start + corner) * np.array(frame.spacing)
        worst = max(worst, tree.query(at)[0].max())
    return worst


# --- what holds an attractor -----------------------------------------------------------------


@settings(max_examples=20)
@given(st.integers(1, 60), st.integers(0, 10**6), st.sampled_from([0.0, 0.3, 2.0]))
def test_a_ball_about_images_of_balls_holds_them_and_is_hardly_too_large(count, seed, spread):
    random = np.random.default_rng(seed)
    middles, radii = random.normal(size=(count, 3)), spread * random.random(count)
    maps = np.concatenate([radii[:, None, None] * np.eye(3), middles[:, :, None]], axis=2)
    unit, block = np.array([[0.0, 0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 0.0, 1.0, 1.0, 1.0]])
    (*centre, radius), box = held((np.zeros(count, int), maps), radii, unit, block)
    reach = (np.linalg.norm(middles - centre, axis=1) + radii).max()
    assert reach <= radius <= reach * (1 + 1e-8)
    # One as wide as the whole holds it all if √1.5 times as large (Jung), and so many steps come
    # within an eighth of the smallest.
    gaps = np.linalg.norm(middles[:, None] - middles, axis=2)
    least = max(radii.max(), (gaps + radii[:, None] + radii).max() / 2)
    assert least * (1 - 1e-12) <= radius <= least * 1.5**0.5 * 1.125
    low, high = (middles - radii[:, None]).min(axis=0), (middles + radii[:, None]).max(axis=0)
    assert box == pytest.approx(np.concatenate([low + high, high - low]) / 2, abs=1e-8)


@settings(max_examples=12)
@given(st.integers(0, 10**6))
def test_enclosures_hold_an_attractor_and_are_hardly_too_large(seed):
    random = np.random.default_rng(seed)
    scales = random.uniform(0.05, 0.7, (3, 3))
    maps = [(rotation(seed + k) * scales[k], random.uniform(-5, 5, 3)) for k in range(3)]
    automaton = of_maps(maps)
    system = covers._system(automaton, enclosing_balls(automaton).tobytes())
    (ball,), (block,), (hull,), (gap,) = system.balls, system.blocks, system.hulls, system.gaps
    points = naive.word_points(maps, ball[3] / 40, 2 * ball[3])
    grid = np.linspace(-1, 1, hull.shape[1])
    for face in range(3):
        flat = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1)
        directions = np.insert(flat, face, 1.0, axis=2)
        reach = points @ directions.reshape(-1, 3).T
        low, high = reach.min(axis=0), reach.max(axis=0)
        middle, half = hull[face].reshape(-1, 2).T
        assert (middle - half <= low).all()
        assert (high <= middle + half).all()
        assert (2 * half <= high - low + 0.2 * ball[3]).all()
    assert (np.abs(points - block[:3]) <= block[3:]).all()
    assert np.linalg.norm(points - ball[:3], axis=1).max() <= ball[3]
    nearest = np.linalg.norm(points - block[:3], axis=1).min()
    assert nearest - ball[3] / 40 <= gap <= nearest + ball[3] / 40


# --- attractors ----------------------------------------------------------------------------


@each_system
def test_a_cover_holds_the_points_of_the_chaos_game(name):
    frame = framed(SYSTEMS[name], (29, 31, 23))
    marks, bound = covered(SYSTEMS[name], frame)
    assert set(np.unique(marks)) == {0, 1}
    assert marks.dtype == np.uint8
    points = naive.chaos_points(SYSTEMS[name], 100_000, seed=3)
    assert marks[voxels_of(points, frame)].all()
    assert bound == pytest.approx(frame.diagonal + min(frame.spacing) / 8, rel=1e-4)


@each_system
def test_a_cover_reaches_no_further_than_it_says(name):
    maps = SYSTEMS[name]
    frame = framed(maps, (15, 17, 13))
    marks, bound = covered(maps, frame)
    ball = enclosing_balls(of_maps(maps))[0]
    size = min(frame.spacing) / 2
    tree = cKDTree(naive.word_points(maps, size, 2 * ball[3]))
    # Each part of the attractor has a point here: its others are within ``size`` of that.
    assert furthest_corners(np.argwhere(marks), frame, tree) <= bound + size


@each_system
def test_a_cover_does_not_depend_on_order_repetition_or_tiles(name):
    maps = SYSTEMS[name]
    frame = framed(maps, (21, 19, 23))
    marks, _ = covered(maps, frame)
    again, _ = covered([*maps[::-1], *maps[:2]], frame)
    assert np.array_equal(again, marks)
    for start, stop in [((0, 0, 0), (9, 19, 5)), ((7, 6, 5), (21, 13, 23)), ((4, 4, 4), (5, 5, 5))]:
        part = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
        assert np.array_equal(covered(maps, frame.tile(start, stop))[0], marks[part])


@pytest.mark.parametrize("name", ["fern", "turned", "overlapping"])
def test_a_cover_does_not_depend_on_slabs_or_threads(name, monkeypatch):
    frame = framed(SYSTEMS[name], (26, 19, 23))
    marks, _ = covered(SYSTEMS[name], frame)
    monkeypatch.setattr(covers, "FIRST", 0)
    monkeypatch.setattr(covers, "FEW", 0)
    monkeypatch.setattr(covers, "SLAB", 1)
    monkeypatch.setattr(covers, "WORTH", 1)
    window = covers._Window.of(frame)
    thick = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("POROUS_THREADS", threads)
        thick.append(window._thickness(1e9))
        assert np.array_equal(covered(SYSTEMS[name], frame)[0], marks)
    assert thick == [7, 4, 2]
    monkeypatch.setattr(covers, "MOST_CELLS", 3 * 19 * 23)
    assert window._thickness(0.0) == 3
    assert np.array_equal(covered(SYSTEMS[name], frame)[0], marks)


@each_system
def test_a_cover_does_not_depend_on_whether_points_are_marked_first(name, monkeypatch):
    maps = SYSTEMS[name]
    frame = framed(maps, (31, 43, 36)).tile((3, 0, 7), (29, 43, 34))
    for fine in (2, 16):
        found = []
        for first, few in ((0, 0), (100, 0), (100, 1e9), (10**9, 0)):
            monkeypatch.setattr(covers, "FIRST", first)
            monkeypatch.setattr(covers, "FEW", few)
            found.append(covered(maps, frame, fine=fine)[0])
        assert found[0].any()
        assert all(np.array_equal(marks, found[0]) for marks in found)


def test_a_cover_does_not_depend_on_the_names_of_states():
    # The four maps as transitions among two states that are the same.
    one = of_maps(TETRA)
    matrices = [t.matrix for t in one.transitions]
    states = (State("a", one.states[0].controls), State("b", one.states[0].controls))
    two = Automaton(
        states,
        tuple(Transition(q, (q + k) % 2, m) for q in (0, 1) for k, m in enumerate(matrices)),
    )
    frame = framed(TETRA, (14, 15, 16))
    marks, _ = cover_attractor(two, enclosing_balls(two), frame)
    assert np.array_equal(marks, covered(TETRA, frame)[0])


def test_a_frame_that_an_attractor_does_not_reach_has_no_marks():
    frame = Frame((1.3, 0, 0), (0.1, 0.2, 0.3), (7, 5, 3))
    marks, bound = covered(MENGER, frame)
    assert marks.shape == frame.shape
    assert marks.dtype == np.uint8
    assert not marks.any()
    assert bound == pytest.approx(frame.diagonal + min(frame.spacing) / 8, rel=1e-4)


def test_threads_that_want_the_same_wait_for_one(monkeypatch):
    automaton = of_maps(turned_maps(3, 0.4, 11))
    balls, frame = enclosing_balls(automaton), framed(turned_maps(3, 0.4, 11), (9, 8, 7))
    made = []

    def slowly(system, edge):
        made.append(system)
        time.sleep(0.05)
        return clouds(system, edge)

    monkeypatch.setattr(covers, "FIRST", 0)
    monkeypatch.setattr(covers, "clouds", slowly)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: cover_attractor(automaton, balls, frame)[0], range(4)))
    assert len(made) == 1
    assert all(np.array_equal(marks, found[0]) for marks in found)


def test_a_graph_directed_cover():
    # a holds halves of itself and of b, b holds thirds of itself: Cantor dust beside what it feeds.
    corners = [np.array(d, float) for d in itertools.product((0, 1), repeat=3)]
    controls = np.hstack([np.zeros((3, 1)), np.eye(3)])
    lifted = np.vstack([controls, np.ones(4)])

    def matrix(ratio, shift):
        image = np.vstack([ratio * controls + shift[:, None], np.ones(4)])
        return np.linalg.solve(lifted, image)

    transitions = [Transition(0, k % 2, matrix(0.5, c / 2)) for k, c in enumerate(corners[:4])]
    transitions += [Transition(1, 1, matrix(1 / 3, 2 * c / 3)) for c in corners]
    system = Automaton((State("a", controls), State("b", controls)), tuple(transitions))
    frame = Frame((-0.01,) * 3, (0.033, 0.034, 0.035), (31, 30, 30))
    marks, _ = cover_attractor(system, enclosing_balls(system), frame)
    random = np.random.default_rng(0)
    maps = system.maps
    for _ in range(3000):
        state, linear, shift = 0, np.eye(3), np.zeros(3)
        for _ in range(30):
            children = [i for i, t in enumerate(transitions) if t.source == state]
            i = int(random.choice(children))
            shift, linear = shift + linear @ maps[i, :, 3], linear @ maps[i, :, :3]
            state = transitions[i].target
        assert marks[voxels_of(shift[None], frame)].all()
    assert marks.mean() < 0.6


def test_an_aligned_menger_sponge_has_its_cells_and_their_neighbours():
    frame = Frame((0, 0, 0), (1 / 9,) * 3, (9, 9, 9))
    marks, _ = covered(MENGER, frame)
    cells = np.zeros((9, 9, 9), bool)
    for a, b in itertools.product(MENGER, repeat=2):
        cells[tuple(np.rint(9 * (a[1] + b[1] / 3)).astype(int))] = True
    assert marks[cells].all()
    padded = np.pad(cells, 1)
    touched = np.zeros_like(cells)
    for shift in itertools.product(range(3), repeat=3):
        touched |= padded[tuple(slice(s, s + 9) for s in shift)]
    assert not marks[~touched].any()


def test_work_without_end_is_refused(monkeypatch):
    monkeypatch.setattr(covers, "MOST_STEPS", 1000)
    monkeypatch.setattr(covers, "STEPS_PER_VOXEL", 0)
    with pytest.raises(ModelError, match="overlap so much"):
        covered(SYSTEMS["overlapping"], framed(SYSTEMS["overlapping"], (20, 20, 20)))


def test_heavy_overlap_has_an_end():
    maps = turned_maps(6, 0.7, 5)  # similarity dimension 5
    frame = framed(maps, (40, 41, 42))
    marks, _ = covered(maps, frame)
    assert marks[voxels_of(naive.chaos_points(maps, 100_000), frame)].all()


# --- attractors grown by a ball ------------------------------------------------------------


@pytest.mark.parametrize("name", ["tetrahedron", "fern", "stretching", "turned"])
@pytest.mark.parametrize("steps", [0.7, 2.0])
def test_grown_attractors_lie_where_they_should(name, steps):
    maps = SYSTEMS[name]
    frame = framed(maps, (7, 9, 8), margin=0.2)
    h = min(frame.spacing)
    radius = steps * h
    automaton = of_maps(maps)
    balls = enclosing_balls(automaton)
    masks = sample_attractor(automaton, balls, frame, FILL, offset=radius)
    size = h / 3
    tree = cKDTree(naive.word_points(maps, size, 2 * balls[0, 3]))
    distance = tree.query(naive.samples(frame, FILL))[0]
    found = naive.bits(masks, FILL.points)
    cell = max(h / net.CELLS, radius / net.CELLS_OF_OFFSET)
    error = 1.37 * cell
    assert found[distance <= radius - error].all()
    assert not found[distance > radius + error + size].any()
    assert found.any()


def test_grown_attractors_are_tiled_without_seams():
    automaton = of_maps(SYSTEMS["turned"])
    balls = enclosing_balls(automaton)
    frame = framed(SYSTEMS["turned"], (13, 12, 14), margin=0.1)
    radius = 1.3 * min(frame.spacing)
    whole = sample_attractor(automaton, balls, frame, FILL, offset=radius)
    cover, bound = cover_attractor(automaton, balls, frame, offset=radius)
    for start, stop in [((0, 0, 0), (6, 12, 14)), ((5, 4, 7), (13, 9, 9))]:
        part = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
        tile = frame.tile(start, stop)
        assert np.array_equal(
            sample_attractor(automaton, balls, tile, FILL, offset=radius), whole[part]
        )
        assert np.array_equal(
            cover_attractor(automaton, balls, tile, offset=radius)[0], cover[part]
        )
    assert cover[whole != 0].all()
    assert frame.diagonal < bound < frame.diagonal + min(frame.spacing)


def test_a_cover_of_a_grown_attractor_holds_it_and_keeps_its_bound():
    maps, radius = TETRA, 0.11
    frame = Frame((-0.2,) * 3, (0.07, 0.09, 0.08), (20, 16, 18))
    marks, bound = covered(maps, frame, offset=radius)
    points = naive.word_points(maps, 0.01, 2.0)
    directions = np.random.default_rng(1).normal(size=(len(points), 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    assert marks[voxels_of(points + radius * directions, frame)].all()
    assert furthest_corners(np.argwhere(marks), frame, cKDTree(points)) <= radius + bound + 0.01


def test_an_attractor_without_offset_has_no_samples():
    automaton = of_maps(TETRA)
    with pytest.raises(ModelError, match="cover"):
        sample_attractor(
            automaton, enclosing_balls(automaton), framed(TETRA, (5, 5, 5)), CENTRE, offset=0.0
        )


def test_a_single_point_grows_to_a_ball():
    automaton = of_maps([(np.eye(3) / 2, np.array([0.1, 0.2, 0.3]))])
    frame = Frame((-0.3, -0.1, 0.0), (0.05, 0.05, 0.05), (20, 20, 24))
    masks = sample_attractor(automaton, enclosing_balls(automaton), frame, FILL, offset=0.4)
    volume = np.bitwise_count(masks).sum() / 64 * frame.voxel_volume
    assert volume == pytest.approx(4 / 3 * np.pi * 0.4**3, rel=0.03)


# --- prefractals ---------------------------------------------------------------------------


def meets(hull, low, high):
    """Whether the hull of points meets a closed box: weights of a common point, by simplex."""
    n = len(hull)
    found = linprog(
        np.zeros(n),
        A_ub=np.vstack([hull.T, -hull.T]),
        b_ub=np.concatenate([high, -low]),
        A_eq=np.ones((1, n)),
        b_eq=[1.0],
        bounds=(0, None),
    )
    return found.status == 0


entries = st.floats(-1, 1, width=32)


@settings(max_examples=12)
@given(
    st.lists(entries, min_size=9, max_size=9),
    st.sampled_from(["cube", "tetrahedron", "octahedron", "mesh"]),
    st.sampled_from([(1, 1, 1), (1, 1, 0), (1, 0, 0), (0, 0, 0)]),
)
def test_a_hull_marks_just_the_voxels_it_touches(values, name, rank):
    solid = named("tetrahedron" if name == "mesh" else name)
    if name == "mesh":
        from dataclasses import replace

        solid = replace(of_surface(SurfaceMesh(solid.points, solid.triangles)), convex=False)
    matrix = np.array(values).reshape(3, 3) @ np.diag(rank)
    frames = np.column_stack([matrix, [0.111, 0.222, -0.093]])[None]
    hull = solid.points @ matrix.T + frames[0, :, 3]
    frame = Frame((-0.9, -0.8, -1.0), (0.63, 0.71, 0.57), (4, 3, 4))
    marks, bound = cover_pieces(solid, frames, frame)
    assert bound == pytest.approx(frame.diagonal, rel=1e-4)
    for index in np.ndindex(*frame.shape):
        low = frame.origin + np.array(index) * frame.spacing
        high = low + frame.spacing
        slack = 1e-5
        if meets(hull, low + slack, high - slack):
            assert marks[index]
        if not meets(hull, low - slack, high + slack):
            assert not marks[index]


@pytest.mark.parametrize(("name", "offset"), [("ball", 0.0), ("ball", 0.1), ("cube", 0.1)])
def test_grown_pieces_are_covered_within_the_bound(name, offset):
    solid = named(name)
    matrix = rotation(3) @ np.diag([0.9, 0.5, 0.7])
    shift = -matrix @ [0.5, 0.5, 0.5]
    pieces = Pieces(solid, np.column_stack([matrix, shift])[None], offset)
    frame = Frame((-1.0, -1.1, -0.9), (0.13, 0.15, 0.17), (16, 15, 11))
    marks, bound = pieces.cover(frame)
    assert marks[pieces.sample(frame, FILL) != 0].all()
    random = np.random.default_rng(0)
    inside = random.uniform(-0.5, 0.5, (40_000, 3))
    if name == "ball":
        inside = inside[np.linalg.norm(inside, axis=1) <= 0.5]
    cloud = inside @ matrix.T
    # The cloud is dense: no point of the solid is further from it than this.
    gap = cKDTree(cloud).query(inside[:2000] @ matrix.T * 0.999)[0].max() + 0.05
    assert furthest_corners(np.argwhere(marks), frame, cKDTree(cloud)) <= bound + offset + gap


def test_balls_are_covered():
    balls = np.array([[0.52, 0.55, 0.58, 0.2]])
    frame = Frame((0, 0, 0), (0.1, 0.1, 0.1), (11, 11, 11))
    marks, _ = cover_pieces(named("cube"), np.zeros((0, 3, 4)), frame, balls=balls)
    low = np.stack(np.meshgrid(*[np.arange(11) * 0.1] * 3, indexing="ij"), axis=-1)
    nearest = np.clip(balls[0, :3], low, low + 0.1)
    distance = np.linalg.norm(nearest - balls[0, :3], axis=-1)
    assert marks[distance <= 0.2].all()
    assert not marks[distance > 0.2 + frame.diagonal / 2].any()


def test_a_mesh_that_is_hollow_keeps_its_hole():
    cube = named("cube")
    points = np.concatenate([cube.points, 0.2 + 0.6 * cube.points])
    triangles = np.concatenate([cube.triangles, cube.triangles[:, ::-1] + 8])
    solid = of_surface(SurfaceMesh(points, triangles))
    frame = Frame((-0.13,) * 3, (0.0931,) * 3, (14, 14, 14))
    marks, _ = cover_pieces(solid, np.eye(3, 4)[None], frame)
    low = -0.13 + 0.0931 * np.stack(np.meshgrid(*[np.arange(14)] * 3, indexing="ij"), axis=-1)
    high = low + 0.0931
    outside = ((high < 0) | (low > 1)).any(axis=-1)
    hollow = ((low > 0.2) & (high < 0.8)).all(axis=-1)
    assert np.array_equal(marks == 0, outside | hollow)


def test_a_state_without_transitions_is_no_part_of_a_limit():
    unit = np.vstack([np.zeros(3), np.eye(3)]).T
    states = (State("cell", unit), State("strut", unit))
    matrix = np.eye(4) / 2 + np.outer(np.eye(4)[0], np.full(4, 0.5))  # x → x / 2
    automaton = Automaton(states, (Transition(0, 0, matrix), Transition(0, 1, matrix)))
    frame = Frame((0, 0, 0), (0.1, 0.11, 0.12), (10, 9, 8))
    with pytest.raises(ModelError, match="'strut': has no transitions"):
        cover_attractor(automaton, enclosing_balls(automaton), frame)
