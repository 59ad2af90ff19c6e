"""Triangles that cross: held against linear programs, cases by hand, and the judge libigl."""

import itertools
import os

import numpy as np
import pytest
from scipy.optimize import linprog
from stepped import gyroid, hollow, noise, surface_of

from porous.kernels.crossings import crossing


def meet(points, one, other):
    """Tell whether triangles have a point in common beyond what they share (the slow twin).

    Common points are means of either's corners; the weights of corners not shared are made as
    great as can be.
    """
    equal = np.zeros((5, 6))
    equal[:3, :3], equal[:3, 3:] = points[one].T, -points[other].T
    equal[3, :3] = equal[4, 3:] = 1
    alone = np.concatenate([~np.isin(one, other), ~np.isin(other, one)])
    found = linprog(-alone.astype(float), A_eq=equal, b_eq=[0, 0, 0, 1, 1], bounds=(0, None))
    return found.status == 0 and -found.fun > 1e-9


def two_triangles(seed):
    """Return points and two triangles that share 0, 1 or 2 corners: anywhere or on a lattice."""
    random = np.random.default_rng(seed)
    count = 6 - seed % 3
    if seed % 2:
        points = random.integers(0, 4, (count, 3)).astype(float)
    else:
        points = random.normal(size=(count, 3))
    if seed % 5 == 0:
        points[:, 2] = points[:, 0]
    triangles = np.array([random.permutation(3), random.permutation(3) + count - 3])
    return points, triangles


def areas(points, triangles):
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


@pytest.mark.parametrize("shared", range(3))
def test_two_triangles_as_a_linear_program_says(shared):
    found = []
    for seed in range(shared, 600, 3):
        points, triangles = two_triangles(seed)
        if areas(points, triangles).min() > 0:
            marks = crossing(points, triangles)
            assert marks[0] == marks[1] == meet(points, *triangles), (points, triangles)
            found.append(marks[0])
    assert 0.02 < np.mean(found) < 0.7


FLAT = [[0, 0, 0], [4, 0, 0], [0, 4, 0]]
CASES = {
    "through": ([[1, 1, -1], [1, 1, 1], [9, 9, 1]], True),
    "over": ([[1, 1, 1e-9], [2, 1, 1], [1, 2, 1]], False),
    "a corner on the face": ([[1, 1, 0], [2, 1, 1], [1, 2, 1]], True),
    "a corner on a side": ([[2, 2, 0], [5, 5, 1], [5, 5, -1]], True),
    "in its plane, beside": ([[3, 3, 0], [5, 3, 0], [3, 5, 0]], False),
    "in its plane, within": ([[1, 1, 0], [2, 1, 0], [1, 2, 0]], True),
    "in its plane, across": ([[-1, 1, 0], [9, 1, 0], [9, 2, 0]], True),
    "the same place": (FLAT, True),
    "far": ([[10, 10, 10], [12, 10, 10], [10, 12, 10]], False),
    "a hair above": ([[-9, -9, 1e-13], [9, -9, 1e-13], [0, 20, 1e-13]], False),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("scale", [1e-9, 1, 1e9])
def test_two_triangles_by_hand(name, scale):
    other, wanted = CASES[name]
    points = scale * np.array(FLAT + other, float)
    for turn in itertools.permutations(range(3)):
        triangles = np.array([turn, (3, 4, 5)])
        assert crossing(points[:, turn], triangles).tolist() == [wanted] * 2


def test_sides_and_corners_that_are_shared():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.4, 0.8, 0], [2, -1, 0]])
    beside, folded, both = [[0, 1, 2], [3, 2, 1]], [[0, 1, 2], [0, 4, 1]], [[0, 1, 2], [0, 2, 1]]
    assert not crossing(points, np.array(beside)).any()
    assert crossing(points, np.array(folded)).all()
    assert crossing(points, np.array(both)).all()
    assert not crossing(points, np.array([[0, 1, 2], [1, 5, 3]])).any()
    assert crossing(points, np.array([[0, 1, 2], [2, 5, 3]])).all()
    assert crossing(points, np.array([[0, 1, 2], [0, 3, 4]])).all()


def test_a_triangle_without_area_is_found():
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0]], float)
    assert crossing(points, np.array([[0, 1, 2], [0, 2, 3]])).all()


def test_no_triangles_and_one():
    assert crossing(np.zeros((0, 3)), np.zeros((0, 3), np.int64)).shape == (0,)
    assert crossing(np.array(FLAT, float), np.array([[0, 1, 2]])).tolist() == [False]


@pytest.mark.parametrize("count", [3, 4, 5, 16, 17, 45])
def test_many_triangles_as_pair_by_pair(count):
    random = np.random.default_rng(count)
    points = random.normal(size=(3 * count, 3)) * [1, 2, 3]
    points[1::3] = points[::3] + random.normal(size=(count, 3))
    points[2::3] = points[::3] + 0.6 * random.normal(size=(count, 3))
    triangles = random.permutation(np.arange(3 * count).reshape(-1, 3))
    wanted = np.zeros(count, bool)
    for i, j in itertools.combinations(range(count), 2):
        pair = crossing(points, triangles[[i, j]])
        wanted[[i, j]] |= pair
    assert count < 40 or 0 < wanted.mean() < 1
    assert np.array_equal(crossing(points, triangles), wanted)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_threads_do_not_matter(threads, monkeypatch):
    surface = surface_of(gyroid())
    random = np.random.default_rng(1)
    points = surface.points + random.normal(size=surface.points.shape) * 0.15
    wanted = crossing(points, surface.triangles)
    assert 0.001 < wanted.mean() < 0.9
    monkeypatch.setenv("POROUS_THREADS", str(threads))
    assert np.array_equal(crossing(points, surface.triangles), wanted)


@pytest.mark.parametrize("shake", [0.0, 0.02, 0.1, 0.3])
def test_surfaces_as_libigl_says(shake):
    try:
        from igl.copyleft import cgal
    except ImportError:
        missing = "libigl is not installed here"
        (pytest.fail if os.environ.get("CI") else pytest.skip)(missing)
    random = np.random.default_rng(7)
    for fill in (noise(1, grey=True), noise(2, grey=False), hollow()):
        surface = surface_of(fill)
        points = surface.points + shake * random.normal(size=surface.points.shape)
        found = cgal.remesh_self_intersections(points, surface.triangles.copy(), detect_only=True)
        wanted = np.zeros(len(surface.triangles), bool)
        wanted[found[2].ravel()] = True
        assert shake or not wanted.any()
        assert shake < 0.3 or wanted.any()
        assert np.array_equal(crossing(points, surface.triangles), wanted)
