"""Junctions of quadratic with cubic splines: matrices, eigenvalues, seams, what is refused."""

import numpy as np
import pytest

from porous.errors import ModelError
from porous.models.bcifs import bcifs
from porous.models.brep import selection
from porous.models.builders import Options, build_cell
from porous.models.builders._curves import uniform
from porous.models.cell_nodes import placed_corners
from porous.models.closure import closure
from porous.models.complex import cell_complex
from porous.models.solve import solve
from porous.models.swept_body import Sweep

CHAIKIN = np.array([0, 3, 1, 0, 0]) / 4
FREE = np.array([0, 1, 1, 2, 0]) / 4


def corners(solution, level, controls):
    """Where the vertices of a level lie, (v, 3)."""
    found = cell_complex(closure(solution), level)
    return placed_corners(solution, found, solution.automaton(controls), level)[0]


def sides(state):
    return {b.name: b.matrix for b in state.boundaries}


# --- the curve -------------------------------------------------------------------------------


def test_the_curve_is_the_one_in_print():
    brep = build_cell(Options("junction-curve"))
    zero, one = solve(brep).matrices[0]
    first = [[3, 1, 0, 0, 0], [1, 3, 0, 0, 0], [0, 1, 1, 2, 0]]
    assert np.array_equal(4 * zero.T, first)
    second = [[2, 6, 0, 0, 0], [0, 2, 2, 4, 0], [0, 0, 4, 4, 0], [0, 0, 1, 6, 1], [0, 0, 0, 4, 4]]
    assert np.array_equal(8 * one.T, second)
    assert [c.state for c in brep.states[0].children] == [1, 0]
    assert np.array_equal(brep.states[0].boundaries[0].matrix, selection(5, (0, 1)))
    assert np.array_equal(brep.states[0].boundaries[1].matrix, selection(5, (2, 3, 4)))


def test_its_other_states_are_the_splines():
    brep = build_cell(Options("junction-curve"))
    matrices = solve(brep).matrices
    assert np.array_equal(matrices[1], uniform(2).matrices)
    assert np.array_equal(matrices[2][0], uniform(2).ends[0].matrix)
    assert np.array_equal(matrices[3][0], uniform(3).ends[0].matrix)


def test_eigenvalues_of_the_smaller_junction_are_those_of_a_smooth_curve():
    solution = solve(build_cell(Options("junction-curve")))
    found = np.sort(np.linalg.eigvals(solution.matrices[0][1]).real)[::-1]
    np.testing.assert_allclose(found, [1, 0.5, 0.25, 0.25, 0.25], rtol=0, atol=1e-7)


def test_the_free_point_is_a_slider():
    brep = build_cell(Options("junction-curve"))
    assert [s.name for s in solve(brep).sliders if s.state == 0] == ["cell.0.2"]
    moved = solve(brep, {"cell.0.2": CHAIKIN - FREE})
    np.testing.assert_allclose(moved.matrices[0][0][:, 2], CHAIKIN, rtol=0, atol=1e-16)
    np.testing.assert_allclose(moved.matrices[0][1][:, 1], CHAIKIN, rtol=0, atol=1e-16)
    found = np.sort(np.abs(np.linalg.eigvals(moved.matrices[0][1])))[::-1]
    np.testing.assert_allclose(found[:2], [1, 0.75], rtol=0, atol=1e-14)


def test_lines_stay_evenly_divided_lines_and_parabolas_parabolas():
    solution = solve(build_cell(Options("junction-curve")))
    points = corners(solution, 6, solution.brep.states[0].controls)
    np.testing.assert_allclose(np.sort(points[:, 0]), np.arange(65) / 64, rtol=0, atol=1e-14)
    np.testing.assert_allclose(points[:, 1], points[:, 0] ** 2, rtol=0, atol=1e-14)


@pytest.mark.parametrize("level", [14, 20])
def test_the_curve_has_a_tangent_at_the_cubic_end(level):
    solution = solve(build_cell(Options("junction-curve")))
    P = np.random.default_rng(5).normal(size=(3, 5))
    small = P @ np.linalg.matrix_power(solution.matrices[0][1], level)
    # The cubic's tangent, and the direction from the junction's last piece but one to its end.
    tangent, chord = P[:, 4] - P[:, 2], small[:, 3] - (small[:, 0] + small[:, 1]) / 2
    cosine = tangent @ chord / np.linalg.norm(tangent) / np.linalg.norm(chord)
    assert np.arccos(cosine) < 40 * 2.0**-level


@pytest.mark.parametrize("end", [0, 1])
def test_ends_agree_with_the_splines_beyond(end):
    solution = solve(build_cell(Options("junction-curve")))
    other = uniform(2 + end)
    P = np.random.default_rng(end).normal(size=(3, 5))
    beyond = np.random.default_rng(7).normal(size=(3, 3 + end))
    if end:
        beyond[:, :3] = P[:, 2:]
        start = beyond[:, :3] @ [1 / 6, 4 / 6, 1 / 6]
    else:
        beyond[:, 1:] = P[:, :2]
        start = beyond[:, 1:] @ [1 / 2, 1 / 2]
    points = corners(solution, 3, P)
    assert np.abs(points - start).max(axis=1).min() < 1e-15
    # Neighbours' controls: what the curve beyond has left at the joint is what the junction has.
    for level in range(1, 4):
        mine = P @ np.linalg.matrix_power(solution.matrices[0][1], level)[:, 2:]
        if not end:
            first = np.linalg.matrix_power(other.matrices[0], level - 1)
            mine = P @ solution.matrices[0][0] @ first[:, :2]
        piece = np.linalg.matrix_power(other.matrices[end - 1], level)
        theirs = beyond @ piece[:, :3] if end else beyond @ piece[:, 1:]
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-14)


# --- the strip -------------------------------------------------------------------------------


def printed_strip():
    """The matrices of the strip's quarters, column by column, as they are derived by hand."""
    Q = np.array([[3, 1, 0], [1, 3, 0], [0, 3, 1], [0, 1, 3]]) / 4
    D = np.array([[1, 3, 0, 0], [0, 3, 1, 0], [0, 1, 3, 0], [0, 0, 3, 1]]) / 4
    cubic = np.array([[4, 4, 0, 0], [1, 6, 1, 0], [0, 4, 4, 0], [0, 1, 6, 1], [0, 0, 4, 4]]) / 8
    end = np.array([[4, 4, 0], [1, 6, 1], [0, 4, 4]]) / 8

    def left(a, q):
        return np.append(np.kron(a, q), np.zeros(12))

    def free(k):
        return np.append(np.kron([0, 1 / 4], Q[k]), np.kron([1 / 4, 1 / 2, 0], D[k]))

    found = {}
    for j in (0, 1):
        rows = [left((3 / 4, 1 / 4), Q[j + v]) for v in range(3)]
        inner = [left((1 / 4, 3 / 4), Q[j + v]) for v in range(3)]
        meeting = [free(j + v) for v in range(3)]
        found[f"0{j}"] = [*rows, *inner, *meeting]
        outer = [
            np.append(np.zeros(6), np.kron(end[i], cubic[j + k]))
            for i in range(3)
            for k in range(4)
        ]
        found[f"1{j}"] = [*inner, *meeting, *outer]
    return {name: np.array(columns).T for name, columns in found.items()}


def test_the_strip_is_the_one_derived_by_hand():
    brep = build_cell(Options("junction-strip"))
    expected = printed_strip()
    assert [c.name for c in brep.states[0].children] == ["00", "01", "10", "11"]
    for child, matrix in zip(brep.states[0].children, solve(brep).matrices[0], strict=True):
        np.testing.assert_allclose(matrix, expected[child.name], rtol=0, atol=1e-16)


def test_the_strip_s_constraints_hold_and_are_all_there():
    brep = build_cell(Options("junction-strip"))
    solution = solve(brep)
    assert solution.residual == 0
    strip = brep.states[0]
    assert [brep.text(0, at) for at in strip.incidences] == [
        *("cell: 00.UMIN = UMIN/0", "cell: 00.VMIN = VMIN/0"),
        *("cell: 01.UMIN = UMIN/1", "cell: 01.VMAX = VMAX/0"),
        *("cell: 10.UMAX = UMAX/0", "cell: 10.VMIN = VMIN/1"),
        *("cell: 11.UMAX = UMAX/1", "cell: 11.VMAX = VMAX/1"),
    ]
    assert [brep.text(0, to) for to in strip.adjacencies] == [
        *("cell: 10.UMIN = 00.UMAX", "cell: 01.VMIN = 00.VMAX"),
        *("cell: 11.UMIN = 01.UMAX", "cell: 11.VMIN = 10.VMAX"),
    ]
    # Its long edges need 13 controls each, its ends are the patches' edges.
    sizes = {b.name: b.matrix.shape[1] for b in strip.boundaries}
    assert sizes["VMIN"] == sizes["VMAX"] == 13
    assert (sizes["UMIN"], sizes["UMAX"]) == (6, 12)


@pytest.mark.parametrize("level", [1, 2, 3])
def test_the_strip_counts_as_a_grid_and_its_corners_are_apart(level):
    solution = solve(build_cell(Options("junction-strip")))
    found, side = cell_complex(closure(solution), level), 2**level
    counts = [found.count(dimension) for dimension in range(3)]
    assert counts == [(side + 1) ** 2, 2 * side * (side + 1), side**2]
    P = np.random.default_rng(level).normal(size=(3, 18))
    assert len(np.unique(np.rint(corners(solution, level, P) * 1e9), axis=0)) == (side + 1) ** 2


def test_the_level_strip_is_evenly_divided():
    solution = solve(build_cell(Options("junction-strip")))
    u, v, w = corners(solution, 4, solution.brep.states[0].controls).T * 16
    assert np.array_equal(w, np.zeros(17 * 17))
    for values in (u, v):
        np.testing.assert_allclose(values, np.rint(values), rtol=0, atol=1e-12)
    assert len(set(zip(np.rint(u), np.rint(v), strict=True))) == 17 * 17


@pytest.mark.parametrize("name", ["biquadratic", "bicubic", "junction-strip"])
def test_the_strip_s_edges_are_its_neighbours_at_every_level(name):
    strip, other = solve(build_cell(Options("junction-strip"))), solve(build_cell(Options(name)))
    mine, theirs = {
        "biquadratic": ("UMIN", "UMAX"),
        "bicubic": ("UMAX", "UMIN"),
        "junction-strip": ("VMAX", "VMIN"),
    }[name]
    start = other.brep.states[0]
    random = np.random.default_rng(3)
    P, Q = random.normal(size=(3, 18)), random.normal(size=(3, start.size))
    B, C = sides(strip.brep.states[0])[mine], sides(start)[theirs]
    Q[:, C.argmax(axis=0)] = P @ B
    for level in (1, 3):
        one, two = corners(strip, level, P), corners(other, level, Q)
        together = np.concatenate([one, two])
        apart = len(np.unique(np.rint(together * 1e9), axis=0))
        assert apart == 2 * (2**level + 1) ** 2 - (2**level + 1)


@pytest.mark.parametrize("name", ["junction-curve", "junction-strip"])
def test_junctions_contract_and_are_drawn(name):
    model = bcifs(build_cell(Options(name)), level=3, draw=Sweep(("edges",), 0.02))
    assert max(model.domain.lengths) < 1.1
    assert len(model.body.capsules) == {"junction-curve": 8, "junction-strip": 2 * 8 * 9}[name]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cell": "junction-curve", "controls": 4}, r"controls: got 4 for a junction-curve cell"),
        ({"cell": "junction-strip", "controls": 16}, r"wanted 18"),
        ({"cell": "junction-strip", "keep": {"cell": ("20",)}}, r"keep: got '20' for cell"),
        ({"cell": "junction-strip", "keep": {"across": ("0",)}}, r"children of 'across'"),
    ],
)
def test_what_is_no_junction_is_refused(options, message):
    with pytest.raises(ModelError, match=message):
        build_cell(Options(**options))
