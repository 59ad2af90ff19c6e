"""Doo and Sabin's surface about extraordinary faces: literature values, seams, refusals."""

from dataclasses import replace

import numpy as np
import pytest

from porous import voxelize
from porous.errors import ModelError
from porous.models.bcifs import BCIFSSection, bcifs, build
from porous.models.builders import Options, build_cell
from porous.models.builders.doo_sabin import CELLS
from porous.models.cell_folds import corner_weights
from porous.models.cell_nodes import placed_corners
from porous.models.closure import closure
from porous.models.complex import cell_complex
from porous.models.solve import solve
from porous.models.swept_body import Sweep
from porous.recipe import load

each_face = pytest.mark.parametrize("n", [3, 4, 5, 6, 7, 8])


def cell(n):
    return build_cell(Options(f"doo-sabin-{n}"))


def ring(n, random):
    """The controls (3, n + 5) of n cells about one face, bent at random, all that they share one.

    Cell i has the corner p_i of the face, its neighbours s_i (towards p_{i+1}'s side) and t_i
    (towards p_{i-1}'s), and r_i opposite.
    """
    angle = 2 * np.pi * np.arange(n) / n

    def around(radius, turn):
        flat = [radius * np.cos(angle + turn), radius * np.sin(angle + turn), np.zeros(n)]
        return np.array(flat).T + random.normal(scale=0.1, size=(n, 3))

    p, r = around(1, 0), around(3, 0)
    s, t = around(2.2, 0.3), around(2.2, -0.3)
    cells = []
    for i in range(n):
        after, before = (i + 1) % n, i - 1
        others = [p[(i + 1 + j) % n] for j in range(1, n - 2)]
        grid = [p[after], t[after], p[before], p[i], s[i], s[before], t[i], r[i]]
        cells.append(np.array([*others, *grid]).T)
    return cells


def corners(solution, level, controls):
    """Where the vertices of a level lie, (v, 3), and the level-0 boundary that each is in."""
    found = cell_complex(closure(solution), level)
    points, _ = placed_corners(solution, found, solution.automaton(controls), level)
    states = [q for q, s in enumerate(solution.brep.states) if s.dimension == 0]
    return points, np.concatenate([found.origin[q] for q in states])


def named(state, name):
    return next(k for k, b in enumerate(state.boundaries) if b.name == name)


def distinct(points):
    """How many points there are, and how far occurrences of one lie apart."""
    order = np.lexsort(np.rint(points * 1e7).T)
    step = np.abs(np.diff(points[order], axis=0)).max(axis=1)
    return 1 + int((step > 1e-6).sum()), float(step[step <= 1e-6].max())


# --- matrices --------------------------------------------------------------------------------


def test_four_corners_are_the_biquadratic_patch():
    found, expected = cell(4), build_cell(Options("biquadratic"))
    for mine, theirs in zip(found.states[0].children, expected.states[0].children, strict=True):
        assert mine.name == theirs.name
        assert np.array_equal(mine.guess, theirs.guess)
    assert np.array_equal(found.states[0].controls, expected.states[0].controls)
    for mine, theirs in zip(found.states[0].boundaries, expected.states[0].boundaries, strict=True):
        assert mine.name == theirs.name
        assert set(mine.matrix.argmax(axis=0)) == set(theirs.matrix.argmax(axis=0))


@each_face
def test_eigenvalues_at_the_middle_are_those_of_a_smooth_surface(n):
    solution = solve(cell(n))
    found = np.sort(np.abs(np.linalg.eigvals(solution.matrices[0][0])))[::-1]
    np.testing.assert_allclose(found[:3], [1, 0.5, 0.5], rtol=0, atol=1e-12)
    # The quarters have fewer eigenvectors than there are of them: known to a root of rounding.
    np.testing.assert_allclose(found[3], 0.25, rtol=0, atol=1e-4)


@each_face
def test_a_face_s_own_eigenvalues_are_a_half_and_quarters(n):
    # Of the discrete Fourier transform: 1, ½ for one turn either way, ¼ for all others.
    ((matrix,),) = (solve(cell(n)).matrices[2],)
    expected = [1, *[0.5] * 2, *[0.25] * (n - 3)]
    found = np.sort(np.linalg.eigvalsh(matrix))[::-1]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


@each_face
def test_weights_are_a_partition_of_unity_and_none_is_negative(n):
    brep = cell(n)
    solution = solve(brep)
    assert solution.residual <= 1e-15
    for state, matrices in zip(brep.states, solution.matrices, strict=True):
        for child, matrix in zip(state.children, matrices, strict=True):
            assert np.array_equal(matrix, child.guess)
            assert (matrix >= 0).all()
            np.testing.assert_allclose(matrix.sum(axis=0), 1, rtol=0, atol=4e-16)


@each_face
def test_the_reference_net_shrinks_by_halves_about_the_middle(n):
    # The reference is planar and symmetric: the eigenvectors of ½ are its coordinates nearby.
    brep = cell(n)
    P, T = brep.states[0].controls, solve(brep).matrices[0][0]
    hub = brep.states[0].boundaries[named(brep.states[0], "V00")].matrix
    np.testing.assert_allclose((P @ hub).sum(axis=1), 0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(P @ T @ hub, P @ hub / 2, rtol=0, atol=1e-14)


# --- seams -----------------------------------------------------------------------------------


@each_face
def test_counts_are_those_of_a_grid(n):
    found = closure(solve(cell(n)))
    for level in range(4):
        side = 2**level
        counts = [cell_complex(found, level).count(dimension) for dimension in range(3)]
        assert counts == [(side + 1) ** 2, 2 * side * (side + 1), side**2]


@each_face
def test_cells_about_a_face_are_one_surface(n):
    solution = solve(cell(n))
    controls = ring(n, np.random.default_rng(n))
    for level in (0, 1, 3):
        side = 2**level
        points = [corners(solution, level, P)[0] for P in controls]
        count, tear = distinct(np.concatenate(points))
        assert count == n * side**2 + n * side + 1
        assert tear < 1e-14


@each_face
@pytest.mark.parametrize("face", [("UMAX", "UMIN"), ("VMAX", "VMIN")])
def test_edges_agree_with_biquadratic_neighbours(n, face):
    solution, patch = solve(cell(n)), solve(build_cell(Options("biquadratic")))
    random = np.random.default_rng(n)
    mine, theirs = (
        next(b.matrix for b in s.brep.states[0].boundaries if b.name == name)
        for s, name in zip((solution, patch), face, strict=True)
    )
    P, Q = random.normal(size=(3, n + 5)), random.normal(size=(3, 9))
    Q[:, theirs.argmax(axis=0)] = P @ mine
    edges = []
    for system, controls, name in ((solution, P, face[0]), (patch, Q, face[1])):
        points, origin = corners(system, 4, controls)
        state = system.brep.states[0]
        within = [named(state, name)] + [
            use.boundary for use in system.brep.sub[0][named(state, name)]
        ]
        chosen = points[np.isin(origin, within)]
        edges.append(chosen[np.lexsort(chosen.T)])
    assert len(edges[0]) == 17
    np.testing.assert_allclose(*edges, rtol=0, atol=1e-14)


@each_face
def test_the_hub_is_the_face_s_middle_at_every_level(n):
    brep = cell(n)
    weights = corner_weights(solve(brep), 0)[:, 0]
    hub = brep.states[0].boundaries[named(brep.states[0], "V00")].matrix
    np.testing.assert_allclose(weights, hub.mean(axis=1), rtol=0, atol=1e-15)


@each_face
def test_the_normal_is_continuous_at_the_hub(n):
    solution = solve(cell(n))
    T, C = solution.matrices[0][0], corner_weights(solution, 0)
    spreads = []
    for level in (4, 8, 12):
        normals = []
        for P in ring(n, np.random.default_rng(n)):
            spots = P @ np.linalg.matrix_power(T, level) @ C
            # A quad's corners: every corner's own normal, from the edges that meet there.
            for at, u, v in ((0, 2, 1), (1, 0, 3), (3, 1, 2), (2, 3, 0)):
                normal = np.cross(spots[:, u] - spots[:, at], spots[:, v] - spots[:, at])
                normals.append(normal / np.linalg.norm(normal))
        mean = np.mean(normals, axis=0)
        spreads.append(np.linalg.norm(normals - mean / np.linalg.norm(mean), axis=1).max())
    # What bends shrinks as ℓ/4ˡ at most (quarters with too few eigenvectors), what is flat as 1/2ˡ.
    assert spreads[0] > 1e-3
    assert np.divide(spreads[1:], spreads[:-1]).max() < 2 / 16


# --- models ----------------------------------------------------------------------------------


def test_cells_are_drawn_and_have_a_limit():
    brep = cell(5)
    plates = bcifs(brep, level=3, draw=Sweep(("faces",), 0.04))
    corners = plates.corners()
    area = sum(
        0.5 * np.abs(np.cross(c[:, 3] - c[:, 0], c[:, 2] - c[:, 1])[:, 2]).sum() for _, c in corners
    )
    limit = bcifs(brep, level="limit", offset=0.04)
    for model, voxels in ((plates, 64), (limit, 36)):
        # The net is flat: a plate, and half a rod around it (its rim is less than 5 long).
        grid = voxelize(model, voxels=voxels)
        volume = grid.fill.sum() / 255 * np.prod(grid.frame.spacing)
        assert 0.08 * area < volume * 1.02
        assert volume < 0.08 * area + 5 * np.pi * 0.04**2 / 2


def test_quarters_are_kept_by_name():
    section = BCIFSSection.model_validate(
        {
            "kind": "bcifs",
            "cell": "doo-sabin-6",
            "keep": {"cell": ("00", "01", "10"), "patch": ("00", "11", "10")},
            "level": 2,
            "draw": {"along": ("faces",), "radius": 0.01},
        }
    )
    model = build(section, None)
    # The cell is itself and two patches, a patch three.
    assert model.counts[2] == 3 + 2 * 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"keep": {"cell": ("02",)}}, r"keep: got '02' for cell"),
        ({"keep": {"spoke": ("0",)}}, r"keep: got children of 'spoke'"),
        ({"controls": 9}, r"controls: got 9; wanted 10, those of its faces"),
    ],
)
def test_what_is_no_cell_is_refused(options, message):
    with pytest.raises(ModelError, match=message):
        build_cell(Options("doo-sabin-5", **options))


def test_there_are_faces_of_three_to_eight_corners():
    assert sorted(CELLS.values()) == [3, 4, 5, 6, 7, 8]
    with pytest.raises(ModelError, match="doo-sabin-9"):
        build_cell(Options("doo-sabin-9"))


def test_cells_about_all_triangles_of_a_polyhedron_are_a_closed_surface():
    # Every corner of the preset's polyhedron is of one triangle and three squares.
    recipe = load("doo-sabin-shell")
    for level in (0, 1, 2, 4):
        model = replace(build(recipe.model, None), level=level)
        cells = 24 * 4**level
        assert model.counts == (cells + 2, 2 * cells, cells, 0)
    surface = replace(model, level=3)
    assert surface.betti_numbers == (1, 0, 1)
    points = surface.places[0]
    assert len(np.unique(np.rint(points * 1e9), axis=0)) == len(points)
    # All symmetries of a cube: every point has its mirror images.
    for turned in (-points, points[:, [1, 2, 0]], points[:, [1, 0, 2]]):
        gap = np.abs(turned[:, None] - points[None]).max(axis=2).min(axis=1)
        assert gap.max() < 1e-12
