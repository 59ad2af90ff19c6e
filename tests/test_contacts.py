"""Contacts of zero area: counts of the literature, twins on voxels, contacts in part of an edge."""

import naive_boundary as naive
import numpy as np
import pytest
import systems
from hypothesis import given, settings
from hypothesis import strategies as st

from porous.errors import ModelError
from porous.guests import manifold
from porous.models.automaton import of_maps
from porous.models.contacts import contact_points
from porous.models.membership import covered
from porous.models.primitive import named, of_surface
from porous.values import SurfaceMesh

CUBE = named("cube")


def placed(*cells):
    """Return frames of cells given as (scale or matrix, translation)."""
    frames = np.zeros((len(cells), 3, 4))
    for frame, (matrix, shift) in zip(frames, cells, strict=True):
        frame[:, :3] = matrix * np.eye(3) if np.ndim(matrix) == 0 else matrix
        frame[:, 3] = shift
    return frames


@pytest.mark.parametrize("level", [1, 2, 3])
def test_flakes_have_as_many_contacts_as_shared_corners(level):
    # Corners of the closed union (bcifs.md 6.3), less those of one cell only.
    automaton, solid = systems.flake("tetrahedron")
    found = contact_points(solid, systems.cell_frames(automaton, level))
    assert len(found) == 2 * 4**level + 2 - 4
    automaton, solid = systems.flake("octahedron")
    found = contact_points(solid, systems.cell_frames(automaton, level))
    assert len(found) == 2 * 6**level + 3 * 2**level + 1 - 6


def test_menger_has_none():
    frames = systems.cell_frames(systems.digits(3, systems.MENGER), 2)
    assert contact_points(CUBE, frames).shape == (0, 3)


def test_jerusalem_has_none_although_its_faces_only_overlap():
    frames = systems.cell_frames(of_maps(systems.jerusalem_maps()), 1)
    assert contact_points(CUBE, frames).shape == (0, 3)


@settings(max_examples=60)
@given(st.data())
def test_random_digit_sets_agree_with_voxels(data):
    n = data.draw(st.sampled_from([2, 3]))
    lattice = [(x, y, z) for x in range(n) for y in range(n) for z in range(n)]
    keep = data.draw(st.lists(st.sampled_from(lattice), min_size=1, max_size=16, unique=True))
    level = data.draw(st.integers(1, 2))
    frames = systems.cell_frames(systems.digits(n, keep), level)
    found = contact_points(CUBE, frames) * n**level
    assert np.abs(found - found.round()).max(initial=0) < 1e-9
    expected = naive.contacts(naive.prefractal(n, keep, level))
    assert {tuple(p) for p in found.round().astype(int).tolist()} == expected
    assert len(found) == len(expected)


def test_an_edge_that_touches_in_part_has_the_ends_of_that_part():
    frames = placed((1, [0, 0, 0]), (0.5, [1, 1, 0.25]))
    assert np.allclose(contact_points(CUBE, frames), [[1, 1, 0.25], [1, 1, 0.75]])


def test_a_corner_in_a_face_is_a_contact():
    octahedron = named("octahedron")
    touching = placed((1, [0, 0, 0]), (0.5, [0.5 + 1 / 3 - 0.25, 0.1, 0]))
    assert contact_points(octahedron, touching).shape == (0, 3)  # apart
    # The lower tip of a small octahedron stands on a slanted face of a large one.
    tip, on = np.array([0.5, 0.5, 0.0]) * 0.5, np.array([0.5, 0.5, 0.5]) + 0.5 / 3
    found = contact_points(octahedron, placed((1, [0, 0, 0]), (0.5, on - tip)))
    assert np.allclose(found, [on])


def test_edges_that_cross_touch_in_one_point():
    c, s = np.cos(np.pi / 4), np.sin(np.pi / 4)
    roof = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])  # an edge along x on top
    keel = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])  # an edge along y below
    lower = [0, 0, 0]
    upper = np.array([0.5, 0, 2**0.5]) - keel @ [1, 0.5, 0]
    found = contact_points(CUBE, placed((roof, lower), (keel, upper)))
    assert np.allclose(found, [[0.5, 0, 2**0.5]])


def test_cells_that_overlap_are_joined():
    frames = placed((1, [0, 0, 0]), (1, [0.9, 0.9, 0.9]), (1, [1.8, 1.8, 0.9]))
    assert contact_points(CUBE, frames).shape == (0, 3)


def test_a_corner_joined_by_a_third_cell_is_no_contact():
    two = placed((1, [0, 0, 0]), (1, [1, 1, 0]))
    assert len(contact_points(CUBE, two)) == 2
    three = placed((1, [0, 0, 0]), (1, [1, 1, 0]), (1, [1, 0, 0]))
    assert contact_points(CUBE, three).shape == (0, 3)
    small = placed((1, [0, 0, 0]), (1, [1, 1, 0]), (0.5, [1, 0.5, 0]))
    assert np.allclose(contact_points(CUBE, small), [[1, 1, 1]])


def test_balls_touch_where_their_radii_add_up():
    ball = named("ball")
    found = contact_points(ball, placed((1, [0, 0, 0]), (0.5, [1, 0.25, 0.25]), (1, [0, 2, 0])))
    assert np.allclose(found, [[1, 0.5, 0.5]])
    stretched = placed((np.diag([1, 2, 1]), [0, 0, 0]), (1, [1, 0, 0]))
    with pytest.raises(ModelError, match="ellipsoid"):
        contact_points(ball, stretched)


def test_meshes_that_are_not_convex_touch_in_corners():
    parts = [manifold.box((0, 0, 0), (1, 0.5, 1)), manifold.box((0, 0, 0), (0.5, 1, 1))]
    bracket = of_surface(SurfaceMesh(*manifold.union(parts)))
    apart = placed((1, [0, 0, 0]), (1, [1, 0.5, 1]))
    assert np.allclose(contact_points(bracket, apart), [[1, 0.5, 1]])
    stacked = placed((1, [0, 0, 0]), (1, [0, 0, 1]))
    assert contact_points(bracket, stacked).shape == (0, 3)


def test_scaling_and_moving_changes_nothing():
    automaton, solid = systems.flake("octahedron")
    frames = systems.cell_frames(automaton, 2)
    found = contact_points(solid, frames)
    moved = frames * 1e-3
    moved[:, :, 3] += [5.0, -3.0, 2.0]
    back = (contact_points(solid, moved) - [5, -3, 2]) * 1e3
    assert len(back) == len(found)
    assert {tuple(p) for p in back.round(6).tolist()} == {tuple(p) for p in found.round(6).tolist()}


@pytest.mark.parametrize("convex", [True, False])
def test_points_are_covered_by_the_cells_they_lie_in(convex):
    parts = [manifold.box((0, 0, 0), (1, 0.5, 1)), manifold.box((0, 0, 0), (0.5, 1, 1))]
    bracket = of_surface(SurfaceMesh(*manifold.union(parts)))
    frames = placed((0.5, [0, 0, 0]), (0.25, [0.5, 0.5, 0.5]))
    points = np.random.default_rng(0).random((500, 3))

    def inside(p, scale, shift):
        x, y, z = (p - shift) / scale
        box = min(x, y, z) >= 0 and max(x, y, z) <= 1
        return box and (convex or min(x, y) <= 0.5)

    expected = [inside(p, 0.5, 0) or inside(p, 0.25, np.full(3, 0.5)) for p in points]
    solid = CUBE if convex else bracket
    assert covered(points, solid, frames).tolist() == expected
