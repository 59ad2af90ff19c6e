"""Curves as data: exact matrices, scipy's B-splines, classical fractals, what is refused."""

import pickle
from fractions import Fraction
from itertools import pairwise
from math import comb

import numpy as np
import pytest
from scipy.interpolate import BSpline

from porous.errors import ModelError
from porous.models.builders._curves import (
    Arc,
    Curve,
    End,
    Piece,
    bezier,
    koch,
    pointed,
    rough,
    spline,
    takagi,
    uniform,
)
from porous.models.builders._rules import Texture, straight

CHAIKIN = np.array([[[3, 1, 0], [1, 3, 3], [0, 0, 1]], [[1, 0, 0], [3, 3, 1], [0, 1, 3]]]) / 4
CUBIC = np.array([[4, 1, 0, 0], [4, 6, 4, 1], [0, 1, 4, 6], [0, 0, 0, 1]]) / 8
QUADRATICS = [(0, 1), (0.5, 2), (0, 0), (1, 3)]
FAMILIES = {
    "line": bezier(1, 3),
    "parabola": bezier(2),
    "quintic by level": bezier(5, (3, 2)),
    "Chaikin": uniform(2),
    "cubic in thirds": uniform(3, 3),
    "quartic by level": uniform(4, (2, 3)),
    "quadratic": spline((-0.5, 0, 1, 3)),
    "cubic": spline((-3, -1, 0, 1, 1.5, 4)),
    "cubic of a double knot": spline((-1, 0, 0, 1, 2, 2)),
    "clamped cubic": spline((0, 0, 0, 1, 2, 4), (3, 2)),
    "Koch": koch(),
    "Takagi": takagi(0.6),
    "rough": rough(Texture(edge=(0.45, -0.4, 0.45), bump=(0.5, 0.3)), 3),
}
each_family = pytest.mark.parametrize("curve", FAMILIES.values(), ids=FAMILIES)


def quadratic(before, after):
    return (-before, 0, 1, 1 + after)


def pieces(curve, level):
    """Arc and weights of each piece of a level, from first to last."""
    found = [(0, np.eye(curve.arcs[0].size))]
    for _ in range(level):
        found = [(p.arc, W @ p.matrix) for arc, W in found for p in curve.arcs[arc].pieces]
    return found


def point(curve, end):
    """The weights of the point that an end shrinks to."""
    result = np.eye(curve.ends[end].size)
    for _ in range(200):
        result = result @ curve.ends[end].matrix
        end = curve.ends[end].after
    return result[:, 0]


def starts(curve, level):
    """The weights of where the pieces of a level begin."""
    return np.array(
        [
            W @ curve.boundary(arc, 0) @ point(curve, curve.arcs[arc].ends[0])
            for arc, W in pieces(curve, level)
        ]
    ).T


# --- matrices --------------------------------------------------------------------------------


def test_chaikin_and_the_cubic_are_those_in_print():
    assert np.array_equal(uniform(2).matrices, CHAIKIN)
    assert np.array_equal(uniform(3).matrices, [CUBIC, CUBIC[::-1, ::-1]])
    assert np.array_equal(spline(quadratic(1, 1)).matrices, CHAIKIN)


def test_ends_of_uniform_splines_shrink_to_one_point():
    for degree, values, fixed in ((2, [1, 1 / 2], [1, 1]), (3, [1, 1 / 2, 1 / 4], [1, 4, 1])):
        (end,) = uniform(degree).ends
        found = np.sort(np.linalg.eigvals(end.matrix).real)[::-1]
        np.testing.assert_allclose(found, values, rtol=0, atol=1e-14)
        np.testing.assert_allclose(point(uniform(degree), 0), np.array(fixed) / sum(fixed))
    assert np.array_equal(uniform(2).ends[0].matrix, np.array([[3, 1], [1, 3]]) / 4)
    assert np.array_equal(uniform(3).ends[0].matrix, CUBIC[:3, :3])


@pytest.mark.parametrize("degree", [1, 2, 3, 5, 8])
def test_bezier_halves_are_de_casteljaus(degree):
    first = np.array(
        [[comb(j, a) / 2**j if a <= j else 0 for j in range(degree + 1)] for a in range(degree + 1)]
    )
    assert np.array_equal(bezier(degree).matrices, [first, first[::-1, ::-1]])


def test_bezier_thirds_are_a_texture():
    thirds = rough(Texture(edge=1 / 9, bump=4 / 9), 3).matrices
    np.testing.assert_allclose(bezier(2, 3).matrices, thirds, rtol=0, atol=2e-16)
    np.testing.assert_allclose(bezier(1, 3).matrices, straight(3), rtol=0, atol=2e-16)


def test_quadratics_of_knots_are_those_in_print():
    expected = {
        (0, 1): ([[4, 2, 0], [0, 2, 3], [0, 0, 1]], [[2, 0, 0], [2, 3, 1], [0, 1, 3]]),
        (0, 0): ([[4, 2, 0], [0, 2, 2], [0, 0, 2]], [[2, 0, 0], [2, 2, 0], [0, 2, 4]]),
    }
    for around, matrices in expected.items():
        assert np.array_equal(spline(quadratic(*around)).matrices, np.array(matrices) / 4)


@pytest.mark.parametrize("around", QUADRATICS)
def test_quadratics_have_at_most_four_arcs(around):
    curve = spline(quadratic(*around))
    assert len(curve.arcs) <= 4
    assert len(curve.ends) <= 3
    before = around[0]
    expected = np.array([1, before, 0]) / (1 + before)
    np.testing.assert_allclose(starts(curve, 0)[:, 0], expected, rtol=0, atol=1e-15)


@each_family
def test_weights_sum_to_one_and_neighbours_have_their_ends_in_common(curve):
    for index, arc in enumerate(curve.arcs):
        for side in (0, 1):
            piece = arc.pieces[-side]
            assert curve.arcs[piece.arc].ends[side] == curve.ends[arc.ends[side]].after
            outer = curve.boundary(index, side) @ curve.ends[arc.ends[side]].matrix
            assert np.array_equal(piece.matrix @ curve.boundary(piece.arc, side), outer)
        for one, two in pairwise(arc.pieces):
            assert curve.arcs[one.arc].ends[1] == curve.arcs[two.arc].ends[0]
            left = one.matrix @ curve.boundary(one.arc, 1)
            right = two.matrix @ curve.boundary(two.arc, 0)
            np.testing.assert_allclose(left, right, rtol=0, atol=2e-16)
        for piece in arc.pieces:
            np.testing.assert_allclose(piece.matrix.sum(axis=0), 1, rtol=0, atol=4e-16)


@each_family
def test_controls_in_common_have_one_place(curve):
    for index, arc in enumerate(curve.arcs):
        slots = {}
        for piece, places in zip(arc.pieces, curve.places(index), strict=True):
            for place, column in zip(places.tolist(), piece.matrix.T, strict=True):
                slots.setdefault(place, []).append(column)
        assert sorted(slots) == list(range(len(slots)))
        for columns in slots.values():
            np.testing.assert_allclose(columns, columns[:1] * len(columns), rtol=0, atol=2e-16)


@pytest.mark.parametrize("name", sorted(set(FAMILIES) - {"Koch"}))
def test_the_line_is_divided_evenly(name):
    curve = FAMILIES[name]
    for level in (0, 1, 3):
        found = curve.arcs[0].controls @ starts(curve, level)
        np.testing.assert_allclose(found, np.arange(len(found)) / len(found), rtol=0, atol=1e-13)


# --- against scipy ---------------------------------------------------------------------------


SPANS = {
    **{f"quadratic {around}": quadratic(*around) for around in QUADRATICS},
    "Chaikin": (-1, 0, 1, 2),
    "cubic": (-2, -1, 0, 1, 2, 3),
    "quartic": (-3, -2, -1, 0, 1, 2, 3, 4),
    "uneven cubic": (-3, -1, 0, 1, 1.5, 4),
    "double knots": (-1, 0, 0, 1, 1, 2.5),
    "clamped quintic": (0, 0, 0, 0, 0, 1, 2, 2, 3, 7),
}


@pytest.mark.parametrize("divisions", [2, 3, (3, 2)])
@pytest.mark.parametrize("knots", SPANS.values(), ids=SPANS)
def test_splines_are_scipys(knots, divisions):
    degree = len(knots) // 2
    random = np.random.default_rng(degree)
    P = random.normal(size=(3, degree + 1))
    level = 4 if divisions == 3 else 6
    curve = spline(knots, divisions)
    found = P @ starts(curve, level)
    t = np.arange(found.shape[1]) / found.shape[1]
    assert len(t) >= 64
    # scipy wants one knot more at each end; what lies in the middle span asks for neither.
    whole = BSpline([knots[0], *knots, knots[-1]], P.T, degree)
    np.testing.assert_allclose(found.T, whole(t), rtol=0, atol=1e-10)


@pytest.mark.parametrize("degree", [1, 2, 3, 6])
@pytest.mark.parametrize("divisions", [2, 3, 5])
def test_bezier_curves_are_bernsteins(degree, divisions):
    P = np.random.default_rng(degree).normal(size=(3, degree + 1))
    found = P @ starts(bezier(degree, divisions), 3)
    t = np.arange(divisions**3) / divisions**3
    powers = np.array([comb(degree, j) * t**j * (1 - t) ** (degree - j) for j in range(degree + 1)])
    np.testing.assert_allclose(found, P @ powers, rtol=0, atol=1e-13)


def test_knots_say_the_same_in_any_unit():
    knots = [Fraction(u) for u in (-3, -1, 0, 1, Fraction(3, 2), 4)]
    moved = spline([float(8 + u / 4) for u in knots])
    assert moved == spline([float(u) for u in knots])


def test_homogeneous_controls_draw_the_quarter_circle():
    weights = np.array([1, np.sqrt(0.5), 1])
    P = np.vstack([np.array([[1, 1, 0], [0, 1, 1]]) * weights, weights])
    for divisions in (2, 3):
        x, y, w = P @ starts(bezier(2, divisions), 5)
        np.testing.assert_allclose(np.hypot(x / w, y / w), 1, rtol=0, atol=1e-12)
        assert (np.diff(np.arctan2(y, x)) > 0).all()


# --- fractals --------------------------------------------------------------------------------


def koch_polyline(level):
    """The classical curve, by turning complex numbers."""
    line = np.array([0, 1], np.complex128)
    turn = np.exp(1j * np.pi / 3)
    for _ in range(level):
        a, d = line[:-1], (line[1:] - line[:-1]) / 3
        parts = np.stack([a, a + d, a + d + d * turn, a + 2 * d], axis=1).ravel()
        line = np.append(parts, 1)
    return line


def test_kochs_curve_is_the_classical_polyline():
    P = np.array([[0, 0.5, 1], [0, np.sqrt(3) / 6, 0]])
    found = P @ starts(koch(), 4)
    expected = koch_polyline(4)[:-1]
    assert found.shape == (2, 256)
    np.testing.assert_allclose(found[0] + 1j * found[1], expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("edge", [(0.45, -0.4, 0.45), (0.5, 0.45, -0.5)])
def test_ranges_of_rough_pieces_add_up_to_more_at_each_level(edge):
    """Their sum grows by Σ|r| a level, so a graph's box dimension is 1 + ln Σ|r| / ln 3."""
    matrices = rough(Texture(edge=edge, bump=(0.5, 0.3)), 3).matrices
    heights = np.array([[0.0, 1.0, 0.0]])  # over the abscissae 0, ½, 1: a graph
    for _ in range(12):
        heights = (heights[:, None, None] @ matrices).reshape(-1, 3)
    ends = np.append(heights[:, 0], heights[-1, 2])
    sums = []
    for level in (4, 5, 6):
        pieces = ends[:-1].reshape(3**level, -1)
        following = ends[pieces.shape[1] :: pieces.shape[1]]
        joined = np.column_stack([pieces, following])
        sums.append(np.ptp(joined, axis=1).sum())
    growth = np.abs(edge).sum()
    assert growth > 1
    assert np.array(sums[1:]) / sums[:-1] == pytest.approx(growth, rel=0.02)


@pytest.mark.parametrize("w", [0.25, 0.5, 0.7, -0.4])
def test_takagis_curve_is_its_series(w):
    P = np.array([[0, 0.5, 1], [0, 1, 0]])
    t, y = P @ starts(takagi(w), 8)
    parts = [w**k * np.abs(2**k * t - np.rint(2**k * t)) for k in range(9)]
    np.testing.assert_allclose(t, np.arange(256) / 256, rtol=0, atol=1e-14)
    np.testing.assert_allclose(y, np.sum(parts, axis=0), rtol=0, atol=1e-13)


def test_takagis_curve_of_a_quarter_is_the_parabola():
    np.testing.assert_allclose(takagi(0.25).matrices, bezier(2).matrices, rtol=0, atol=1e-16)
    P = np.array([[0, 0.5, 1], [0, 1, 0]])
    t, y = P @ starts(takagi(0.25), 6)
    np.testing.assert_allclose(y, 2 * t * (1 - t), rtol=0, atol=1e-14)


def test_rough_pieces_shrink_as_their_texture_says():
    texture = Texture(edge=(0.45, -0.4, 0.3), bump=(0.5, 0.3))
    for matrix, r in zip(rough(texture, 3).matrices, texture.edge, strict=True):
        found = np.sort(np.linalg.eigvals(matrix).real)
        np.testing.assert_allclose(found, np.sort([1, 1 / 3, r]), rtol=0, atol=1e-12)


# --- values and refusals ---------------------------------------------------------------------


@each_family
def test_curves_are_values(curve):
    assert pickle.loads(pickle.dumps(curve)) == curve
    with pytest.raises(ValueError, match="read-only"):
        curve.arcs[0].pieces[0].matrix[0, 0] = 2


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: bezier(0), r"degree: got 0; wanted a whole number, 1 … 8"),
        (lambda: uniform(9), r"degree: got 9; wanted a whole number, 1 … 8"),
        (lambda: uniform(True), r"degree: got True; wanted a whole number"),
        (lambda: bezier(2, 1), r"divisions: got 1; wanted a whole number, 2 or more"),
        (lambda: bezier(2, ()), r"divisions: got none; wanted those of each level"),
        (lambda: spline(()), r"knots: got \[\]; wanted 2p numbers"),
        (lambda: spline((0, 1, 2)), r"knots: got \[0.0, 1.0, 2.0\]; wanted 2p numbers"),
        (lambda: spline((0, 0, np.nan, 1)), r"knots"),
        (lambda: spline((0, 1, 1, 2)), r"wanted none below the one before, and a middle span"),
        (lambda: spline((1, 0, 1, 2)), r"wanted none below the one before"),
        (lambda: takagi(1.0), r"texture.edge: got r = 1 for piece 0"),
        (lambda: pointed(np.ones((2, 2, 2))), r"arc 0: piece 0: column 0 sums to 2; wanted 1"),
        (lambda: pointed(CHAIKIN), r"arc 0: its outer piece does not end where it ends itself"),
        (lambda: pointed(straight(4)[[0, 3]]), r"arc 0: pieces 0 and 1 have no end in common"),
    ],
)
def test_what_is_no_curve_is_refused(make, message):
    with pytest.raises(ModelError, match=message):
        make()


def test_ends_whose_weights_do_not_sum_to_one_are_refused():
    arc = Arc(0, (0, 0), tuple(Piece(0, matrix) for matrix in straight(2)), np.array([0.0, 1]))
    with pytest.raises(ModelError, match=r"end 0: column 0 sums to 2; wanted 1"):
        Curve((arc,), (End(0, np.array([[2.0]]), np.zeros(1)),))
