"""The exact boundary: closed forms, twins, order of the maps, and what it refuses."""

import time

import naive_boundary as naive
import numpy as np
import pytest
import systems
from hypothesis import given, settings
from hypothesis import strategies as st

from porous.errors import MeshError, ModelError
from porous.guests import manifold
from porous.models.apart import apart
from porous.models.automaton import Automaton, State, Transition, of_maps
from porous.models.boundary import exact_boundary, gathered
from porous.models.primitive import Primitive, named, of_surface
from porous.stages import exact_surface
from porous.values import Box, SurfaceMesh
from porous.values.surface_topology import defects, euler_number, pieces

CUBE = named("cube")


def turn(x, y, z):
    """Return a rotation about x, then y, then z."""
    result = np.eye(3)
    for angle, (i, j) in ((x, (1, 2)), (y, (2, 0)), (z, (0, 1))):
        m = np.eye(3)
        m[i, i] = m[j, j] = np.cos(angle)
        m[i, j], m[j, i] = -np.sin(angle), np.sin(angle)
        result = m @ result
    return result


def facts(surface):
    assert not defects(surface)
    return euler_number(surface), int(pieces(surface).max()) + 1


@pytest.mark.parametrize("level", [0, 1, 2, 3])
def test_menger_is_exact(level):
    surface = exact_boundary(systems.digits(3, systems.MENGER), CUBE, level)
    area = 2 * (20 / 9) ** level + 4 * (8 / 9) ** level
    chi = (192 - 38 * 8**level - 21 * 20**level) // 133
    assert surface.volume == pytest.approx((20 / 27) ** level, rel=1e-12)
    assert surface.area == pytest.approx(area, rel=1e-12)
    assert facts(surface) == (2 * chi, 1)
    # Two triangles for each face of a cell, and no slivers.
    assert len(surface.triangles) == round(2 * area * 9**level)


@pytest.mark.parametrize(
    "level", [1, 2, pytest.param(3, marks=[pytest.mark.slow, pytest.mark.nightly])]
)
def test_jerusalem_is_certain_in_any_order(level):
    maps = systems.jerusalem_maps()
    k = 2**0.5 - 1
    shuffled = [maps[i] for i in np.random.default_rng(level).permutation(len(maps))]
    for order in (maps, maps[::-1], shuffled):
        surface = exact_boundary(of_maps(order), CUBE, level)
        chi, parts = facts(surface)
        assert (1 - chi // 2, parts) == ({1: 5, 2: 81, 3: 1409}[level], 1)
        assert surface.volume == pytest.approx((8 * k**3 + 12 * k**6) ** level, rel=1e-11)


def test_jerusalem_without_gathering_is_wrong():
    # What the gathering of coordinates is for: raw numbers of the second level do not meet.
    k = manifold.Body(CUBE.points, CUBE.triangles)
    for _ in range(2):
        moved = [
            manifold.Body(k.points @ A.T + b, k.triangles) for A, b in systems.jerusalem_maps()
        ]
        k = manifold.union(moved)
    assert euler_number(SurfaceMesh(*k)) != -160


@pytest.mark.parametrize(
    ("n", "count", "area", "chi"), [(1, 20, 72, -4), (2, 172, 600, -44), (3, 1616, 5280, -400)]
)
def test_the_pell_body(n, count, area, chi):
    box = manifold.Body(CUBE.points, CUBE.triangles)
    bodies, sides = {-1: box, 0: box}, {-1: 1, 0: 1}
    for i in range(1, n + 1):
        a, b = sides[i - 1], sides[i - 2]
        sides[i] = 2 * a + b
        moved = [(bodies[i - 1], p) for p in naive.pell_corners(sides[i], a)]
        moved += [(bodies[i - 2], p) for p in naive.pell_edges(sides[i], a, b)]
        bodies[i] = manifold.union([manifold.Body(m.points + p, m.triangles) for m, p in moved])
    surface = SurfaceMesh(*apart(*bodies[n]))
    assert surface.volume == pytest.approx(count, rel=1e-12)
    assert surface.area == pytest.approx(area, rel=1e-12)
    assert facts(surface) == (2 * chi, 1)
    solid = naive.pell(n)
    assert solid.sum() == count
    if n < 3:
        assert naive.surface_facts(solid) == (2 * chi, 1)


@settings(max_examples=40)
@given(st.data())
def test_random_digit_sets_agree_with_voxels(data):
    divisions = data.draw(st.sampled_from([2, 3]))
    lattice = [
        (x, y, z) for x in range(divisions) for y in range(divisions) for z in range(divisions)
    ]
    keep = data.draw(st.lists(st.sampled_from(lattice), min_size=2, max_size=14, unique=True))
    level = data.draw(st.integers(1, 2))
    surface = exact_boundary(systems.digits(divisions, keep), CUBE, level)
    solid = naive.prefractal(divisions, keep, level)
    assert surface.volume == pytest.approx(solid.sum() / solid.size, rel=1e-12)
    faces = len(naive.quads(solid)) / len(solid) ** 2
    assert surface.area == pytest.approx(faces, rel=1e-12)
    assert facts(surface) == naive.surface_facts(solid)


def test_an_edge_of_two_solids_that_are_joined_at_both_its_ends_gets_two_midpoints():
    surface = exact_boundary(systems.digits(2, systems.MINUS_CORNER), CUBE, 4)
    solid = naive.prefractal(2, systems.MINUS_CORNER, 4)
    assert facts(surface) == naive.surface_facts(solid)


@pytest.mark.parametrize(("name", "cells"), [("tetrahedron", 4), ("octahedron", 6)])
def test_flakes_fall_apart_where_they_only_touch(name, cells):
    automaton, solid = systems.flake(name)
    for level in (1, 2, 3):
        surface = exact_boundary(automaton, solid, level)
        assert facts(surface) == (2 * cells**level, cells**level)
        assert surface.volume == pytest.approx(solid.volume * (cells / 8) ** level, rel=1e-12)
        assert surface.area == pytest.approx(solid.area * (cells / 4) ** level, rel=1e-12)
        assert len(surface.points) == cells**level * len(solid.points)


@pytest.mark.parametrize(("name", "cells"), [("icosahedron", 12), ("dodecahedron", 20)])
def test_golden_flakes_fall_apart(name, cells):
    automaton, solid = systems.flake(name)
    surface = exact_boundary(automaton, solid, 2)
    assert facts(surface) == (2 * cells**2, cells**2)


def test_a_turned_sponge_is_as_exact_as_an_upright_one():
    R = turn(0.3, 0.5, 0.7)
    turned = Primitive("cube", CUBE.points @ R.T, CUBE.triangles, convex=True)
    maps = [(np.eye(3) / 3, R @ np.array(d) / 3) for d in systems.MENGER]
    surface = exact_boundary(of_maps(maps), turned, 2)
    assert facts(surface) == (-160, 1)
    assert surface.area == pytest.approx(2 * (20 / 9) ** 2 + 4 * (8 / 9) ** 2, rel=1e-9)


def test_rotated_overlapping_maps_have_the_volume_of_the_samples():
    maps = [
        (0.62 * turn(0.3, 0.2, 0.1), [0.05, 0.1, 0.0]),
        (0.55 * turn(-0.4, 0.5, 0.9), [0.4, 0.3, 0.35]),
    ]
    automaton = of_maps(maps)
    surface = exact_boundary(automaton, CUBE, 3)
    lower, upper = np.array(surface.box.lower), np.array(surface.box.upper)
    points = lower + (upper - lower) * np.random.default_rng(1).random((40_000, 3))
    frames = systems.cell_frames(automaton, 3)
    inside = np.zeros(len(points), dtype=bool)
    for frame in frames:
        local = (points - frame[:, 3]) @ np.linalg.inv(frame[:, :3]).T
        inside |= ((local >= 0) & (local <= 1)).all(axis=1)
    expected = inside.mean() * np.prod(upper - lower)
    assert surface.volume == pytest.approx(expected, rel=4 / np.sqrt(inside.sum()))


def test_mirrored_maps_keep_the_outside_out():
    mirror = np.diag([-0.5, 0.5, 0.5])
    maps = [(mirror, [0.5, 0, 0]), (np.eye(3) / 2, [0.5, 0.5, 0.5])]
    surface = exact_boundary(of_maps(maps), CUBE, 2)
    assert surface.volume == pytest.approx(4 / 64)


def test_a_mesh_that_is_not_convex_is_a_primitive():
    boxes = [((0, 0, 0), (1.0, 0.4, 0.6)), ((0, 0, 0), (0.4, 1.0, 0.6))]
    body = manifold.union([manifold.box(*b) for b in boxes])
    bracket = of_surface(SurfaceMesh(*body))
    assert not bracket.convex
    maps = [(np.eye(3) / 2, np.array(t)) for t in ((0, 0, 0), (0.5, 0, 0), (0, 0.5, 0.1))]
    surface = exact_boundary(of_maps(maps), bracket, 2)
    assert not defects(surface)
    assert surface.volume <= 9 * bracket.volume / 64 * (1 + 1e-12)


def test_a_system_of_two_states_is_the_system_it_says():
    # A: eight corners of A and, one step later, twelve edges: the Jerusalem cube that lags.
    maps = systems.jerusalem_maps()
    one = of_maps(maps)
    state = one.states[0]
    identity = of_maps([(np.eye(3), np.zeros(3))]).transitions[0].matrix
    waits = [Transition(0, 0, t.matrix) for t in one.transitions[:8]]
    waits += [Transition(0, 1, t.matrix) for t in one.transitions[8:]]
    waits += [Transition(1, 0, identity)]
    automaton = Automaton(
        (State("now", state.controls), State("later", state.controls)), tuple(waits)
    )
    k = 2**0.5 - 1
    surface = exact_boundary(automaton, CUBE, 2)
    assert facts(surface) == (-88, 1)
    assert surface.volume == pytest.approx(8 * k**3 * (8 * k**3 + 12 * k**6) + 12 * k**6, rel=1e-12)


@pytest.mark.parametrize(("name", "loops"), [("tetrahedron", 3), ("octahedron", None)])
def test_fused_flakes_are_one_body(name, loops):
    automaton, solid = systems.flake(name)
    loose = exact_boundary(automaton, solid, 1)
    fused = exact_boundary(automaton, solid, 1, contacts="fuse", contact_radius=0.05)
    chi, parts = facts(fused)
    assert parts == 1
    assert loose.volume < fused.volume < loose.volume + 13 * 4 / 3 * np.pi * 0.05**3
    if loops is not None:
        assert chi == 2 * (1 - loops)


def test_a_domain_cuts_and_names_the_sides():
    domain = Box((0.0, 0.0, 0.0), (1.0, 0.8, 1.0))
    automaton, solid = systems.flake("tetrahedron")
    whole = exact_boundary(automaton, solid, 1, contacts="fuse", contact_radius=0.08)
    cut = exact_boundary(automaton, solid, 1, contacts="fuse", contact_radius=0.08, domain=domain)
    assert cut.names == ("WALL", "XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX")
    assert cut.volume < whole.volume
    assert cut.box == domain
    areas = np.bincount(cut.labels, np.linalg.norm(cut.area_vectors, axis=1), minlength=7)
    assert (areas[1:] > 0).all()
    # At height t of a tetrahedron in a cube of edge a the section is √2·a·t by √2·a·(1 − t); the
    # plane y = 0.8 cuts two of a = 1/2 at t = 0.6, and no ball.
    assert areas[4] == pytest.approx(2 * 2 * 0.25 * 0.6 * 0.4, rel=1e-12)


def test_the_same_model_gives_the_same_bytes():
    automaton = systems.digits(3, systems.MENGER)
    assert exact_boundary(automaton, CUBE, 2) == exact_boundary(automaton, CUBE, 2)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"offset": 0.1}, "offset"),
        ({"level": "limit"}, "limit"),
        ({"primitive": named("ball")}, "balls"),
        ({"contacts": "fuse"}, "contact_radius"),
    ],
)
def test_what_has_no_exact_boundary_is_refused(options, words):
    given_ = {"primitive": CUBE, "level": 1} | options
    primitive, level = given_.pop("primitive"), given_.pop("level")
    with pytest.raises(ModelError, match=words):
        exact_boundary(systems.digits(3, systems.MENGER), primitive, level, **given_)


def test_flat_cells_are_refused():
    maps = [(np.diag([0.5, 0.5, 0.0]), [0, 0, 0.5]), (np.eye(3) / 2, [0, 0, 0])]
    with pytest.raises(ModelError, match="flatten"):
        exact_boundary(of_maps(maps), CUBE, 1)


@pytest.mark.parametrize("gap", [1e-8, 3e-10])
def test_features_that_nearly_coincide_are_refused(gap):
    # A ratio with eight digits: do the cells touch? Nobody can tell.
    ratio = 1 / 3 - gap
    maps = [(np.eye(3) * ratio, np.array(d) / 3) for d in systems.MENGER]
    with pytest.raises(ModelError, match="extract_surface"):
        exact_boundary(of_maps(maps), CUBE, 2)


def test_a_model_without_boundary_says_what_to_use():
    with pytest.raises(ModelError, match="extract_surface"):
        exact_surface(object())


def test_solids_that_touch_in_an_edge_or_a_point_are_taken_apart():
    steps = [(0, 0, 0), (1, 1, 0), (2, 2, 1)]
    points = np.concatenate([CUBE.points + s for s in steps])
    triangles = np.concatenate([CUBE.triangles + 8 * i for i in range(3)])
    welded, index = np.unique(points, axis=0, return_inverse=True)
    joined = SurfaceMesh(welded, index.reshape(-1)[triangles])
    assert defects(joined)
    assert facts(SurfaceMesh(*apart(joined.points, joined.triangles))) == (6, 3)


def test_faces_that_lie_on_each_other_are_refused():
    points = np.concatenate([CUBE.points, CUBE.points + np.array([1, 0, 0])])
    triangles = np.concatenate([CUBE.triangles, CUBE.triangles + 8])
    with pytest.raises(MeshError, match=r"lie on each other|alternate"):
        apart(points, triangles)


def test_gathering_takes_the_lowest_of_near_numbers():
    points = np.array([[0.1, 0, 1], [0.1 + 1e-15, 1, 1 - 1e-14], [0.5, 1e-16, 0]])
    assert gathered(points, 1e-12).tolist() == [
        [0.1, 0, 1 - 1e-14],
        [0.1, 1, 1 - 1e-14],
        [0.5, 0, 0],
    ]


@pytest.mark.slow
def test_menger_3_takes_less_than_two_seconds_of_a_processor():
    automaton = systems.digits(3, systems.MENGER)
    exact_boundary(automaton, CUBE, 1)
    begin = time.process_time()
    surface = exact_boundary(automaton, CUBE, 3)
    assert time.process_time() - begin < 2
    assert len(surface.triangles) == 36_096
