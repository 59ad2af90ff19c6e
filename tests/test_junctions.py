"""Junctions of splines and of lattices: matrices, eigenvalues, seams, meshes, what is refused."""

import meshio
import naive_elasticity
import numpy as np
import pytest

from porous import formats, voxelize
from porous.errors import ModelError
from porous.formats import inp
from porous.guests import ccx
from porous.jobs import compression, material
from porous.measures._mesh import smallest_dihedral_angle, smallest_scaled_jacobian
from porous.models.bcifs import bcifs
from porous.models.brep import selection
from porous.models.builders import Options, build_cell
from porous.models.builders._curves import uniform
from porous.models.cell_nodes import placed_corners
from porous.models.closure import closure
from porous.models.complex import cell_complex
from porous.models.digits import named
from porous.models.solve import solve
from porous.models.swept_body import Sweep
from porous.values import Block, Box, VolumeMesh
from porous.values.surface_topology import check_closed
from porous.values.volume_topology import bodies, boundary_faces, hung_by_faces

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


# --- lattices --------------------------------------------------------------------------------


def types(found, dimension):
    """The state of each entity of a dimension that cells use, and how many of them use it."""
    uses = {}
    for group in found.cells:
        state = found.brep.states[group.state]
        for k in found.brep.of_dimension(group.state, dimension):
            for entity in group.ids[:, k].tolist():
                key = state.boundaries[k].state, entity
                uses[key] = uses.get(key, 0) + 1
    return uses


@pytest.mark.parametrize(("level", "cells"), list(enumerate([1, 5, 23, 101, 431])))
def test_the_triangle_counts_as_in_print(level, cells):
    brep = build_cell(Options("junction-lattice"))
    found = cell_complex(closure(solve(brep)), level)
    assert found.count(2) == cells
    assert found.euler_number == 1
    assert found.components == 1
    # Edges are of one type each, so that whoever shares one shares its type.
    uses = types(found, 1)
    names = {state: brep.states[state].name for state, _ in uses}
    outer = [names[state] for (state, _), count in uses.items() if count == 1]
    assert set(uses.values()) <= {1, 2}
    assert (outer.count("edge 3"), outer.count("edge 2")) == (3**level, 2 * 2**level)


def test_the_triangle_is_filled_and_inner_edges_are_reversed():
    brep = build_cell(Options("junction-lattice"))
    turned = [to for to in brep.states[brep.start].adjacencies if to.order]
    assert [brep.text(brep.start, to) for to in turned] == ["mixed: 3.E01 = 1.E12 (1, 0)"]
    P = np.array([[0, 3, 1], [0, 0.5, 4], [0, 0, 1.0]])
    whole = np.linalg.norm(np.cross(P[:, 1] - P[:, 0], P[:, 2] - P[:, 0]))
    model = bcifs(brep, level=4, controls=P, draw=Sweep(("faces",), 0.01))
    areas = [
        np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1).sum()
        for _, c in model.corners()
    ]
    assert sum(areas) == pytest.approx(whole, rel=1e-13)


@pytest.mark.parametrize("start", ["mixed-thirds", "mixed-halves"])
def test_prisms_have_the_sides_of_both_lattices(start):
    brep = build_cell(Options("junction-prism", start=start))
    state = brep.states[brep.start]
    names = [brep.states[b.state].name for b in state.boundaries if b.matrix.shape[1] >= 3]
    expected = {
        "mixed-thirds": ["face 33", *["face 23"] * 2, *["mixed"] * 2],
        "mixed-halves": ["face 23", *["face 22"] * 2, *["mixed"] * 2],
    }
    assert sorted(names) == sorted(expected[start])
    side = {"mixed-thirds": 3, "mixed-halves": 2}[start]
    found = closure(solve(brep))
    for level, cells in enumerate([1, 5, 23]):
        counted = cell_complex(found, level)
        assert counted.count(3) == cells * side**level
        assert counted.euler_number == 1


MENGER = tuple("".join(map(str, digit)) for digit in named("menger").keep)


def junction(level, **options):
    """A junction whose controls are off their grid at random, by less than it would fold."""
    brep = build_cell(Options("junction", **options))
    bend = np.random.default_rng(level).uniform(-0.1, 0.1, size=(3, 20))
    controls = brep.states[brep.start].controls + bend
    return bcifs(brep, level=level, controls=controls, domain=Box((-0.1,) * 3, (1.1, 1.1, 4.1)))


@pytest.mark.parametrize("level", [1, 2, 3])
def test_the_block_is_one_conforming_mesh(level):
    model = junction(level)
    mesh = model.cell_mesh()
    assert {block.shape for block in mesh.blocks} == {"hex8", "wed6"}
    assert mesh.volumes.min() > 0
    assert bodies(mesh).max() == 0
    assert (hung_by_faces(mesh).points.shape) == mesh.points.shape
    assert len(np.unique(np.rint(mesh.points * 1e9), axis=0)) == len(mesh.points)
    # Faces of one cell only are just the sides': as many as these are cut into.
    sides = {
        "ZMIN": 9 ** (level - 1),
        "ZMAX": 4 ** (level - 1),
    }
    for name, count in sides.items():
        assert len(mesh.parts[f"{name}_FACES"].members) == count
    assert len(boundary_faces(mesh)) == len(mesh.parts["SKIN"].members)
    assert "WALL" not in mesh.parts
    surface = model.boundary()
    check_closed(surface)
    assert surface.volume == pytest.approx(mesh.volumes.sum(), rel=1e-13)
    # Bilinear faces are divided exactly.
    assert mesh.volumes.sum() == pytest.approx(model.bulk_volume, rel=1e-12)


def test_the_block_s_cells_are_what_its_parts_become():
    found = closure(solve(build_cell(Options("junction"))))
    for level in (1, 2, 3):
        n = level - 1
        prisms = [1, 5, 23][n] * (3**n + 2**n) + 4**n * (3**n + 2**n)
        counted = cell_complex(found, level)
        assert counted.count(3) == 27**n + 8**n + prisms
        assert counted.euler_number == 1


def test_a_sponge_is_joined_to_a_lattice():
    kept = {"thirds": MENGER, "halves": ("001", "010", "011", "100", "101", "110")}
    model = junction(3, keep=kept)
    mesh = model.cell_mesh()
    assert bodies(mesh).max() == 0
    sponge, lattice = 20**2, 6**2
    assert mesh.cells == sponge + lattice + 23 * (9 + 4) + 16 * (9 + 4)
    grid = voxelize(model, voxels=96)
    filled = grid.fill.sum() / 255 * np.prod(grid.frame.spacing)
    assert filled == pytest.approx(mesh.volumes.sum(), rel=5e-3)


def test_a_full_prism_is_its_own_limit():
    brep = build_cell(Options("junction-prism"))
    limit, solid = (
        voxelize(bcifs(brep, level=level), voxels=8, sampling="cover") for level in ("limit", 1)
    )
    assert np.array_equal(limit.fill, solid.fill)
    assert 0.5 < limit.fill.mean() / 255 < 0.7


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cell": "junction-lattice", "start": "mixd"}, r"start: got 'mixd'.*'mixed'"),
        ({"cell": "junction", "start": "thirds"}, r"start: a junction cell takes none"),
        ({"cell": "junction", "controls": 8}, r"controls: got 8; wanted 20, those of cell"),
        ({"cell": "junction-prism", "keep": ("7",)}, r"keep: got '7' for mixed-thirds"),
    ],
)
def test_what_is_no_lattice_junction_is_refused(options, message):
    with pytest.raises(ModelError, match=message):
        build_cell(Options(**options))


# --- wedges ----------------------------------------------------------------------------------

WEDGE = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 5], [2, 0, 5], [0, 3, 5]], np.float64)


def wedge(points=WEDGE):
    return VolumeMesh(points, (Block("wed6", np.arange(6)[None]),))


def test_a_wedge_has_its_volume():
    assert wedge().volumes == pytest.approx([15])


def test_a_bent_wedge_has_the_volume_of_its_map():
    # ∫ det J over the triangle times the line, by Gauss points that are exact for its degree.
    bent = WEDGE + np.random.default_rng(2).uniform(-0.3, 0.3, size=(6, 3))
    a = np.array([1 / 6, 1 / 6, 2 / 3])
    total = 0.0
    for r, s in zip(a, np.roll(a, 1), strict=True):
        for t in (0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12)):
            lower, upper = bent[:3], bent[3:]
            along = (1 - t) * lower + t * upper
            third = np.array([1 - r - s, r, s]) @ (upper - lower)
            rows = along[1] - along[0], along[2] - along[0], third
            total += np.linalg.det(np.array(rows)) / 12
    assert wedge(bent).volumes == pytest.approx([total], rel=1e-13)


def test_a_regular_wedge_is_the_best():
    height = np.sqrt(3) / 2
    flat = np.array([[0, 0, 0], [1, 0, 0], [0.5, height, 0]])
    regular = wedge(np.vstack([flat, flat + np.array([0, 0, 0.7])]))
    assert smallest_scaled_jacobian(regular).value == pytest.approx(1)
    assert smallest_dihedral_angle(regular).value == pytest.approx(60)
    right = wedge(WEDGE * [3, 2, 1])
    assert smallest_scaled_jacobian(right).value == pytest.approx(np.sqrt(2 / 3))


def test_wedges_go_into_files_as_others_read_them(tmp_path):
    mesh = junction(2).cell_mesh()
    formats.write(mesh, tmp_path / "cells.vtu")
    back = formats.read(tmp_path / "cells.vtu")
    assert back == mesh
    theirs = meshio.read(tmp_path / "cells.vtu")
    blocks = {block.type: block.data for block in theirs.cells}
    for shape, name in (("wed6", "wedge"), ("hex8", "hexahedron")):
        ours = next(block.cells for block in mesh.blocks if block.shape == shape)
        assert np.array_equal(blocks[name], ours)
    formats.write(mesh, tmp_path / "cells.inp")
    deck = meshio.read(tmp_path / "cells.inp")
    assert {b.type: len(b.data) for b in deck.cells} == {"hexahedron": 35, "wedge": 45}
    assert np.array_equal(next(b.data for b in deck.cells if b.type == "wedge"), blocks["wedge"])


@pytest.mark.judge
@pytest.mark.slow
def test_the_deck_of_wedges_and_hexahedra_runs_as_written(judge):
    job = compression(junction(2).cell_mesh(), material=material("steel"), pressure=1.0)
    solved = ccx.solve(inp.write(job), program=judge("ccx"))
    energy, load = naive_elasticity.energy(job)
    assert solved.reaction == pytest.approx(load, abs=1e-5 * np.linalg.norm(load))
    assert solved.energy == pytest.approx(energy, rel=1e-5)
    assert solved.volume == pytest.approx(job.mesh.volumes.sum(), rel=1e-5)
