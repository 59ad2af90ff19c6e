"""The case table of marching cubes: every entry obeys the rules, and follows from them."""

from collections import Counter
from itertools import combinations

import naive_surface as naive
import numpy as np
import pytest

from porous.kernels._cases import CASES, COUNTS, TRIANGLES, TUNNELS

ALL = range(256)


def triangles_of(case):
    return [tuple(map(int, t)) for t in TRIANGLES[case, : 3 * COUNTS[case]].reshape(-1, 3)]


def directed(triangles):
    return Counter((t[k], t[(k + 1) % 3]) for t in triangles for k in range(3))


def test_the_text_is_the_table():
    assert [naive.packed(triangles_of(case)) for case in ALL] == list(CASES)
    assert COUNTS.max() == 6


def test_tunnels_are_the_cases_of_two_opposite_void_corners():
    opposite = [case for case in ALL if (255 - case) in {1 << c | 1 << (7 - c) for c in range(4)}]
    assert sorted(opposite) == list(TUNNELS) == list(naive.TUNNELS)


def rim(case):
    sides = directed(triangles_of(case))
    return dict(+Counter({side: n - sides[side[::-1]] for side, n in sides.items()}))


def test_sides_that_no_other_triangle_takes_back_are_the_segments_in_the_faces():
    wanted = {case: dict.fromkeys(naive.links(case).items(), 1) for case in ALL}
    assert [case for case in ALL if rim(case) != wanted[case]] == []


def test_no_side_is_run_twice_the_same_way():
    most = {case: max(directed(triangles_of(case)).values(), default=1) for case in ALL}
    assert set(most.values()) == {1}


def test_no_chord_lies_in_a_face():
    chords = {case: naive.chords(triangles_of(case), case) for case in ALL}
    assert [case for case in ALL if any(map(naive.in_a_face, chords[case]))] == []


def test_every_cut_edge_has_a_vertex():
    for case in ALL:
        cut = {e for e, (a, b) in enumerate(naive.ENDS) if (case >> a ^ case >> b) & 1}
        assert {edge for t in triangles_of(case) for edge in t} == cut


def test_every_loop_bounds_a_disc_and_tunnels_are_annuli():
    for case in ALL:
        triangles = triangles_of(case)
        sides = {frozenset(s) for t in triangles for s in combinations(t, 2)}
        vertices = {edge for t in triangles for edge in t}
        discs = 0 if case in TUNNELS else len(naive.loops(case))
        assert len(vertices) - len(sides) + len(triangles) == discs


def test_a_lone_corner_is_seen_from_the_void():
    points = naive.places(np.full((1, 12), 0.5))[0]
    for corner in range(8):
        ((a, b, c),) = triangles_of(1 << corner)
        normal = np.cross(points[b] - points[a], points[c] - points[a])
        assert normal @ (points[a] - naive.CORNERS[corner]) > 0


def test_triangles_of_a_cube_never_cross_wherever_their_corners_lie():
    points = naive.places(naive.parameters(seed=7)[::4])
    assert [case for case in ALL if naive.crossings(triangles_of(case), points)] == []


def test_another_strip_through_a_tunnel_would_cross():
    points = naive.places(naive.parameters()[::4])
    clean = [s for s in naive.annuli(126) if not naive.crossings(s, points)]
    strips = {frozenset(map(frozenset, strip)) for strip in clean}
    assert strips == {frozenset(map(frozenset, triangles_of(126)))}


@pytest.mark.slow
@pytest.mark.nightly
def test_the_table_follows_from_the_rules():
    points = naive.places(naive.parameters())
    assert [naive.packed(naive.derive(case, points)) for case in ALL] == list(CASES)
