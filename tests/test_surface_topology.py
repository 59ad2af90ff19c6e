"""What a surface's connectivity says: holes, turned triangles, pinched points, pieces."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from porous.errors import MeshError
from porous.values import SurfaceMesh
from porous.values.surface_topology import (
    check_closed,
    defects,
    euler_number,
    joined,
    pieces,
)

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3.0]])
TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def torus(n, m):
    u, v = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a, b = 2 * np.pi * u.ravel() / n, 2 * np.pi * v.ravel() / m
    radius = 3 + np.cos(b)
    points = np.stack([radius * np.cos(a), radius * np.sin(a), np.sin(b)], axis=1)
    here, right = u * m + v, (u + 1) % n * m + v
    up, both = u * m + (v + 1) % m, (u + 1) % n * m + (v + 1) % m
    first = np.stack([here, right, both], axis=-1).reshape(-1, 3)
    return SurfaceMesh(
        points, np.concatenate([first, np.stack([here, both, up], axis=-1).reshape(-1, 3)])
    )


def counts(surface):
    found = defects(surface)
    return (
        found.open_edges,
        found.nonmanifold_edges,
        found.misoriented_edges,
        found.degenerate_triangles,
        found.nonmanifold_vertices,
    )


def test_a_tetrahedron_has_no_defects():
    surface = SurfaceMesh(POINTS, TETRAHEDRON)
    assert not defects(surface)
    assert counts(surface) == (0, 0, 0, 0, 0)
    assert euler_number(surface) == 2
    assert pieces(surface).tolist() == [0, 0, 0, 0]
    check_closed(surface)


def test_a_torus_has_euler_number_zero_and_one_piece():
    surface = torus(7, 5)
    assert not defects(surface)
    assert euler_number(surface) == 0
    assert pieces(surface).max() == 0
    check_closed(surface)


def test_a_hole_is_named_and_its_rim_counted():
    surface = SurfaceMesh(POINTS, TETRAHEDRON[1:])
    assert counts(surface) == (3, 0, 0, 0, 0)
    assert bool(defects(surface))
    with pytest.raises(MeshError, match=r"a hole: 3 edges .* from \(0, 0, 0\) to \(1, 0, 0\)"):
        check_closed(surface)


def test_holes_are_counted():
    surface = torus(9, 8)
    keep = np.delete(np.arange(len(surface.triangles)), [0, 37])
    with pytest.raises(MeshError, match="2 holes: 6 edges"):
        check_closed(SurfaceMesh(surface.points, surface.triangles[keep]))


def test_a_turned_triangle_is_found():
    turned = TETRAHEDRON.copy()
    turned[2] = turned[2, ::-1]
    surface = SurfaceMesh(POINTS, turned)
    assert counts(surface) == (0, 0, 3, 0, 0)
    with pytest.raises(MeshError, match="3 edges where triangles are turned"):
        check_closed(surface)


def test_inside_out_and_empty_are_refused():
    with pytest.raises(MeshError, match="inside out"):
        check_closed(SurfaceMesh(POINTS, TETRAHEDRON[:, ::-1]))
    with pytest.raises(MeshError, match="no triangles"):
        check_closed(SurfaceMesh(POINTS, np.zeros((0, 3), int)))


def test_two_solids_that_touch_in_an_edge_are_closed_but_not_manifold():
    mirrored = np.array([[0, 0, 0], [1, 0, 0], [0, -2, 0], [0, 0, -3.0]])
    points = np.concatenate([POINTS, mirrored[2:]])
    second = np.array([0, 1, 4, 5])[np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])]
    surface = SurfaceMesh(points, np.concatenate([TETRAHEDRON, second]))
    assert counts(surface) == (0, 1, 0, 0, 0)
    assert defects(surface).first == (0.5, 0.0, 0.0)
    check_closed(surface)


def test_two_solids_that_touch_in_a_point_pinch_it():
    points = np.concatenate([POINTS, -POINTS[1:]])
    second = np.array([0, 4, 5, 6])[TETRAHEDRON[:, ::-1]]
    surface = SurfaceMesh(points, np.concatenate([TETRAHEDRON, second]))
    assert counts(surface) == (0, 0, 0, 0, 1)
    assert defects(surface).first == (0.0, 0.0, 0.0)
    assert euler_number(surface) == 3
    assert pieces(surface).tolist() == [0] * 4 + [1] * 4
    check_closed(surface)


def test_triangles_without_area_are_counted_whatever_the_scale():
    triangles = np.array([[0, 1, 1], [0, 1, 2]])
    flat = SurfaceMesh([[0, 0, 0], [1, 1, 1], [2, 2, 2]], triangles)
    assert defects(flat).degenerate_triangles == 2
    for scale in (1e-200, 1e150):
        assert defects(SurfaceMesh(POINTS * scale, TETRAHEDRON)).degenerate_triangles == 0


def test_a_surface_without_triangles_has_no_defects_and_no_pieces():
    surface = SurfaceMesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    assert not defects(surface)
    assert euler_number(surface) == 0
    assert len(pieces(surface)) == 0


def test_points_that_no_triangle_uses_do_not_count():
    surface = SurfaceMesh(np.concatenate([POINTS, POINTS + 9]), TETRAHEDRON)
    assert euler_number(surface) == 2
    assert not defects(surface)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 30), st.integers(0, 30)), max_size=60))
def test_joined_numbers_the_connected_sets_by_their_lowest_member(pairs):
    groups = [{n} for n in range(31)]
    for a, b in pairs:
        touched = [g for g in groups if g & {a, b}]
        groups = [g for g in groups if not g & {a, b}] + [set().union(*touched)]
    groups.sort(key=min)
    wanted = [next(n for n, g in enumerate(groups) if thing in g) for thing in range(31)]
    ends = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    assert joined(31, ends[:, 0], ends[:, 1]).tolist() == wanted


@settings(deadline=None, derandomize=True, max_examples=20)
@given(st.permutations(range(24)), st.permutations(range(48)))
def test_names_of_points_and_order_of_triangles_do_not_matter(points, triangles):
    surface = torus(6, 4)
    place = np.argsort(points)
    other = SurfaceMesh(surface.points[list(points)], place[surface.triangles[list(triangles)]])
    assert not defects(other)
    assert euler_number(other) == 0
    assert pieces(other).max() == 0


def test_a_long_chain_is_joined():
    n = 20_000
    order = np.random.default_rng(3).permutation(n)
    assert joined(n, order[:-1], order[1:]).max() == 0
