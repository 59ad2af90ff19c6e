"""Primitives against the closed forms of the platonic solids, and what no mesh may be."""

import math
import pickle

import numpy as np
import pytest

from porous.errors import MeshError, ModelError
from porous.models.primitive import NAMES, Primitive, named, of_surface
from porous.values import SurfaceMesh

GOLD = (1 + math.sqrt(5)) / 2
EDGE = {
    "cube": 1.0,
    "tetrahedron": math.sqrt(2),
    "octahedron": math.sqrt(0.5),
    "icosahedron": 1 / GOLD,
    "dodecahedron": 1 / GOLD**2,
}
VOLUME = {
    "cube": 1.0,
    "tetrahedron": 1 / (6 * math.sqrt(2)),
    "octahedron": math.sqrt(2) / 3,
    "icosahedron": 5 * (3 + math.sqrt(5)) / 12,
    "dodecahedron": (15 + 7 * math.sqrt(5)) / 4,
}
AREA = {
    "cube": 6.0,
    "tetrahedron": math.sqrt(3),
    "octahedron": 2 * math.sqrt(3),
    "icosahedron": 5 * math.sqrt(3),
    "dodecahedron": 3 * math.sqrt(25 + 10 * math.sqrt(5)),
}
WIDTH = {
    "cube": 1.0,
    "tetrahedron": 1 / math.sqrt(2),  # opposite edges
    "octahedron": math.sqrt(2 / 3),  # opposite faces
    "icosahedron": GOLD**2 / math.sqrt(3),
    "dodecahedron": 2 * math.sqrt(250 + 110 * math.sqrt(5)) / 20,
}
COUNTS = {  # points, edges, facets
    "cube": (8, 12, 6),
    "tetrahedron": (4, 6, 4),
    "octahedron": (6, 12, 8),
    "icosahedron": (12, 30, 20),
    "dodecahedron": (20, 30, 12),
}

each = pytest.mark.parametrize("name", sorted(EDGE))


@each
def test_measures_of_the_platonic_solids(name):
    solid, a = named(name), EDGE[name]
    assert solid.volume == pytest.approx(VOLUME[name] * a**3, rel=1e-12)
    assert solid.area == pytest.approx(AREA[name] * a**2, rel=1e-12)
    assert solid.thickness == pytest.approx(WIDTH[name] * a, rel=1e-9)
    assert np.allclose(solid.box.lower, 0, atol=1e-15)
    assert np.allclose(solid.box.upper, 1, atol=1e-15)


@each
def test_edges_and_facets_of_the_platonic_solids(name):
    solid = named(name)
    assert (len(solid.points), len(solid.edges), len(solid.planes)) == COUNTS[name]
    ends = solid.points[solid.edges]
    assert np.allclose(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), EDGE[name])
    heights = solid.points @ solid.planes[:, :3].T - solid.planes[:, 3]
    assert heights.max() < 1e-12
    for facet, on in zip(solid.facets, (np.abs(heights) < 1e-12).T, strict=True):
        assert set(facet) == set(np.flatnonzero(on))


@each
def test_facets_run_counter_clockwise(name):
    solid = named(name)
    for facet, plane in zip(solid.facets, solid.planes, strict=True):
        corners = solid.points[facet]
        area = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
        assert area @ plane[:3] == pytest.approx(np.linalg.norm(area), rel=1e-9)


def test_ball():
    ball = named("ball")
    assert ball.volume == pytest.approx(math.pi / 6)
    assert ball.area == pytest.approx(math.pi)
    assert ball.thickness == 1.0
    assert ball.box.lower == (0, 0, 0)
    assert ball.box.upper == (1, 1, 1)
    assert ball.planes.shape == (0, 4)
    assert ball.edges.shape == (0, 2)


def test_unknown_names_list_what_there_is():
    with pytest.raises(ModelError, match="octahedron"):
        named("octahedran")
    assert set(NAMES) == {*EDGE, "ball"}


@pytest.mark.parametrize("name", NAMES)
def test_scaling(name):
    large = named(name).scaled(3.0)
    assert large.volume == pytest.approx(27 * named(name).volume)
    assert large.thickness == pytest.approx(3 * named(name).thickness)
    with pytest.raises(ModelError, match="factor"):
        large.scaled(0.0)


def test_values_compare_by_content_and_pickle():
    solid = named("dodecahedron")
    hash(solid.planes.shape)  # fills the caches, which are no content
    assert pickle.loads(pickle.dumps(solid)) == solid == named("dodecahedron")
    assert solid != named("cube")


# --- any closed mesh -----------------------------------------------------------------------


def surface(solid):
    return SurfaceMesh(solid.points, solid.triangles)


def joined(*solids):
    points = np.concatenate([s.points for s in solids])
    shift = np.cumsum([0, *(len(s.points) for s in solids)])[:-1]
    return SurfaceMesh(
        points, np.concatenate([s.triangles + k for s, k in zip(solids, shift, strict=True)])
    )


def moved(solid, factor, shift):
    return Primitive("moved", solid.points * factor + shift, solid.triangles, convex=True)


def turned(solid):
    return Primitive("turned", solid.points, solid.triangles[:, ::-1], convex=False)


@each
def test_a_mesh_of_a_convex_solid_is_known_to_be_convex(name):
    mesh = of_surface(surface(named(name)))
    assert mesh.convex
    assert len(mesh.planes) == len(named(name).planes)
    assert mesh.thickness == pytest.approx(named(name).thickness)


def corner_block():
    """A cube of edge 2 without one of its eight unit cubes, by its outline."""
    p = np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], float)
    points = np.array([(*xy, z) for z in (0.0, 1.0) for xy in p])
    cap = [(0, 1, 2), (0, 2, 3), (0, 3, 5), (3, 4, 5)]
    triangles = [(c, b, a) for a, b, c in cap] + [(a + 6, b + 6, c + 6) for a, b, c in cap]
    for k in range(6):
        m = (k + 1) % 6
        triangles += [(k, m, m + 6), (k, m + 6, k + 6)]
    return SurfaceMesh(points, np.array(triangles))


def test_a_mesh_that_is_not_convex():
    solid = of_surface(corner_block())
    assert not solid.convex
    assert solid.volume == pytest.approx(3.0)
    assert solid.area == pytest.approx(2 * 3 + 8)
    assert len(solid.edges) == 18
    assert solid.thickness == pytest.approx(1.0)


def test_triangles_without_a_common_point_are_welded():
    cube = named("cube")
    soup = SurfaceMesh(cube.points[cube.triangles].reshape(-1, 3), np.arange(36).reshape(12, 3))
    assert of_surface(soup).convex
    assert len(of_surface(soup).points) == 8


def test_a_hole_is_named_with_its_edges_and_place():
    cube = named("cube")
    with pytest.raises(MeshError, match=r"hole.*3 edges.*from \("):
        of_surface(SurfaceMesh(cube.points, cube.triangles[1:]))


def test_an_inside_out_mesh_is_refused():
    with pytest.raises(MeshError, match="inside out"):
        of_surface(surface(turned(named("cube"))))


def test_one_turned_triangle_is_refused():
    cube = named("cube")
    bad = cube.triangles.copy()
    bad[0] = bad[0][::-1]
    with pytest.raises(MeshError, match="turned against"):
        of_surface(SurfaceMesh(cube.points, bad))


def test_two_solids_that_share_an_edge_are_not_manifold():
    cube = named("cube")
    with pytest.raises(MeshError, match=r"1 edges of more than two triangles.*near"):
        of_surface(joined(cube, moved(cube, 1.0, [1.0, 1.0, 0.0])))


def test_a_cavity_is_a_cavity():
    cube = named("cube")
    hollow = of_surface(joined(cube, turned(moved(cube, 0.5, 0.25))))
    assert not hollow.convex
    assert hollow.volume == pytest.approx(1 - 0.125)


def test_a_shell_inside_out_beside_another_is_refused():
    cube = named("cube")
    with pytest.raises(MeshError, match=r"shell at \(.*inside out"):
        of_surface(joined(cube, turned(moved(cube, 0.5, 2.0))))


def test_a_flat_mesh_is_refused():
    flat = SurfaceMesh(np.eye(3), np.array([[0, 1, 2], [0, 2, 1]]))
    with pytest.raises(MeshError, match="volume"):
        of_surface(flat)


def test_two_solids_apart_are_a_solid_but_not_convex():
    cube = named("cube")
    assert not of_surface(joined(cube, moved(cube, 0.5, [2.0, 0.0, 0.0]))).convex


def test_a_sphere_of_many_facets_is_no_hull_to_the_kernels():
    from scipy.spatial import ConvexHull

    k = np.arange(400) + 0.5
    z, turn = 1 - 2 * k / 400, math.pi * (1 + math.sqrt(5)) * k
    points = np.column_stack(
        [np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z]
    )
    hull = ConvexHull(points)
    triangles = hull.simplices.copy()
    corners = points[triangles]
    inward = (
        np.einsum(
            "ij,ij->i",
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]),
            corners[:, 0],
        )
        < 0
    )
    triangles[inward] = triangles[inward, ::-1]
    solid = of_surface(SurfaceMesh(points, triangles))
    assert not solid.convex
    assert solid.volume == pytest.approx(4 / 3 * math.pi, rel=0.03)
