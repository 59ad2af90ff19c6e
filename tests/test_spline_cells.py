"""Tensor products of curves: sharing, scipy's patches and blocks, boxes, what is refused."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from naive_quotient import Quotient
from pydantic import ValidationError
from scipy.interpolate import BSpline

from porous import mesh_cells, voxelize
from porous.errors import MemoryLimitError, ModelError
from porous.models.bcifs import bcifs
from porous.models.bcifs_section import BCIFSSection, system_of
from porous.models.brep import BRep
from porous.models.builders import Options, Texture, build_cell
from porous.models.builders._curves import bezier, koch, rough, spline, takagi, uniform
from porous.models.builders._tensor import tensor
from porous.models.cell_exact import exact_measures
from porous.models.cell_folds import corner_weights
from porous.models.cell_nodes import placed_corners
from porous.models.closure import closure
from porous.models.complex import cell_complex
from porous.models.digits import DigitSet, named
from porous.models.solve import solve

MENGER, FULL = named("menger"), named("full-2")
ROUGH = Texture(edge=(0.45, -0.4, 0.45), bump=(0.5, 0.3))
CORNERS = np.array(list(product((0.0, 1.0), repeat=3)))

CELLS = {
    "biquadratic": lambda: build_cell(Options("biquadratic")),
    "bicubic": lambda: build_cell(Options("bicubic")),
    "spline-2": lambda: build_cell(Options("spline-2")),
    "spline-3": lambda: build_cell(Options("spline-3")),
    "Menger": lambda: build_cell(Options("spline-2", MENGER)),
    "3 then 2": lambda: build_cell(Options("spline-2", (MENGER, FULL))),
    "uneven quadratic": lambda: tensor([spline((0, 0, 1, 1.5))] * 2),
    "uneven cubic": lambda: tensor([spline((-3, -1, 0, 1, 1.5, 4))] * 2),
    "three curves": lambda: tensor([bezier(3), uniform(2), spline((-0.5, 0, 1, 2))]),
    "Koch wall": lambda: tensor([koch(), bezier(1, 4)]),
    "Koch": lambda: build_cell(Options("tensor", curves=(koch(),))),
    "kept Koch": lambda: build_cell(
        Options("tensor", curves=(koch(), bezier(2, 4)), keep=("00", "13", "21"))
    ),
}
each_cell = pytest.mark.parametrize("make", CELLS.values(), ids=CELLS)


def grid_counts(sides, dimension):
    """Vertices, edges, faces and cells of a full grid."""
    counts = [0] * 4
    for free in product((0, 1), repeat=dimension):
        counts[sum(free)] += int(np.prod([sides + 1 - f for f in free]))
    return counts


def counts(brep, level):
    found = cell_complex(closure(solve(brep)), level)
    return [found.count(dimension) for dimension in range(4)]


def corners(brep, level, controls):
    """The corners of the cells of a level, (k, c, 3), in lexicographic order."""
    solution = solve(brep)
    found = cell_complex(closure(solution), level)
    points, own = placed_corners(solution, found, solution.automaton(controls), level)
    result = np.empty((len(np.hstack([g.place for g in found.cells])), own[0].shape[1], 3))
    for group, ids in zip(found.cells, own, strict=True):
        result[group.place] = points[ids]
    return result


# --- constraints -----------------------------------------------------------------------------


@each_cell
def test_solving_changes_nothing(make):
    brep = make()
    solution = solve(brep)
    assert solution.residual <= 1e-15
    for state, matrices in zip(brep.states, solution.matrices, strict=True):
        for child, matrix in zip(state.children, matrices, strict=True):
            np.testing.assert_allclose(matrix, child.guess, rtol=0, atol=2e-16)
            np.testing.assert_allclose(matrix.sum(axis=0), 1, rtol=0, atol=1e-15)


@each_cell
def test_cells_share_what_is_one_wherever_the_controls_are(make):
    brep = make()
    start = brep.states[brep.start]
    quotient = Quotient(brep)
    for level in (1, 2) if start.dimension == 2 else (1,):
        quotient.refine()
        P = np.random.default_rng(level).normal(size=(start.size - 1, start.size))
        cells = [(brep.start, P)]
        for _ in range(level):
            cells = [(c.state, Q @ c.guess) for q, Q in cells for c in brep.states[q].children]
        keys = [
            (state, frozenset(map(tuple, np.rint(points.T * 1e9).astype(np.int64).tolist())))
            for q, Q in cells
            for state, points in [
                *((b.state, Q @ b.matrix) for b in brep.states[q].boundaries),
                (q, Q),
            ]
        ]
        joined = quotient.roots(quotient.cells)
        assert len(set(joined)) == len(set(keys)) == len(set(zip(joined, keys, strict=True)))


@pytest.mark.parametrize("name", ["biquadratic", "bicubic", "spline-2", "spline-3"])
def test_full_cells_count_as_the_grid(name):
    brep = CELLS[name]()
    dimension = brep.states[brep.start].dimension
    for level in (0, 1, 2, 3):
        assert counts(brep, level) == grid_counts(2**level, dimension)


def test_kept_cells_count_as_straight_ones():
    for digits in ((MENGER,), (MENGER, FULL), (named("minus-corner"),)):
        straight, bent = (build_cell(Options(name, digits)) for name in ("hex-8", "spline-2"))
        assert counts(bent, 2) == counts(straight, 2)


def test_quarters_are_kept_by_name():
    brep = build_cell(Options("biquadratic", keep=("00", "11", "01")))
    assert [c.name for c in brep.states[0].children] == ["00", "11", "01"]
    assert [len(state.children) for state in brep.states[1:]] == [2, 1]
    # An L of three quarters: its 3 × 3 corners but the one that only 10 has.
    assert counts(brep, 1) == [8, 10, 3, 0]


# --- states ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "degree"), [("spline-2", 2), ("spline-3", 3)])
def test_boundaries_have_as_many_layers_as_the_degree(name, degree):
    brep = build_cell(Options(name))
    assert [state.name for state in brep.states] == ["cell", "face", "edge", "vertex"]
    assert [state.size for state in brep.states] == [
        (degree + 1) ** free * degree ** (3 - free) for free in (3, 2, 1, 0)
    ]
    names = [b.name for b in brep.states[0].boundaries]
    assert names[:7] == ["XMIN", "XMAX", "YMIN", "YMAX", "ZMIN", "ZMAX", "X00"]
    assert names == [b.name for b in build_cell(Options("hex-8", FULL)).states[0].boundaries]
    lattice = list(product(range(degree + 1), repeat=3))
    for boundary in brep.states[0].boundaries[:6]:
        axis, last = "XYZ".index(boundary.name[0]), boundary.name.endswith("MAX")
        used = [lattice[c] for c in np.flatnonzero(boundary.matrix.any(axis=1))]
        layers = set(range(int(last), degree + int(last)))
        assert used == [place for place in lattice if place[axis] in layers]


def test_bezier_products_are_the_cells_of_27_controls():
    made = tensor([bezier(2, 3)] * 3, [MENGER.keep])
    known = build_cell(Options("hex-27", MENGER))
    assert [(s.name, s.size) for s in made.states] == [(s.name, s.size) for s in known.states]
    for ours, theirs in zip(made.states, known.states, strict=True):
        assert (ours.incidences, ours.adjacencies) == (theirs.incidences, theirs.adjacencies)
        assert np.array_equal(ours.controls, theirs.controls)
        for part, other in zip(ours.boundaries, theirs.boundaries, strict=True):
            assert part == other
        for child, other in zip(ours.children, theirs.children, strict=True):
            np.testing.assert_allclose(child.guess, other.guess, rtol=0, atol=2e-16)


def test_rough_lines_make_the_textured_cell():
    x, y = ROUGH, Texture()
    made = tensor([rough(x, 3), rough(y, 3), rough(x, 3)], [MENGER.keep])
    known = build_cell(Options("hex-27", MENGER, (x, y, x)))
    assert len(made.states) == len(known.states)
    for child, other in zip(made.states[0].children, known.states[0].children, strict=True):
        np.testing.assert_allclose(child.guess, other.guess, rtol=0, atol=2e-16)


def test_ends_of_several_controls_lead_to_a_fixed_point():
    brep = build_cell(Options("spline-2", (MENGER, FULL)))
    assert [s.name for s in brep.states if s.shape == "vertex"] == ["vertex0", "vertex1"]
    controls = brep.states[0].controls
    for corner in corners(brep, 0, controls):
        np.testing.assert_allclose(corner, CORNERS, rtol=0, atol=1e-14)


def test_ends_that_go_in_circles_have_no_point():
    brep = build_cell(Options("spline-2", (MENGER, FULL)))
    last = next(q for q, s in enumerate(brep.states) if s.name == "vertex1")
    first = next(q for q, s in enumerate(brep.states) if s.name == "vertex0")
    states = list(brep.states)
    (child,) = states[last].children
    states[last] = replace(states[last], children=(replace(child, state=first),))
    circle = replace(solve(brep), brep=_Unchecked(tuple(states)))
    with pytest.raises(ModelError, match="vertex state vertex1 has 8 controls and does not lead"):
        corner_weights(circle, 0)


class _Unchecked(BRep):
    def __post_init__(self):
        self._set("states", tuple(self.states))


# --- against scipy ---------------------------------------------------------------------------


def knots(degree):
    return np.arange(-degree, degree + 2, dtype=float)


def evaluate(P, lines, t):
    """Values (…, 3) at the grid of parameters t: scipy's splines, axis by axis."""
    values = P
    for axis, (around, degree) in enumerate(lines):
        values = np.moveaxis(BSpline(around, np.moveaxis(values, axis, 0), degree)(t), 0, axis)
    return values


def check_scipy(brep, P, lines, level, divisions=2):
    """Hold the corners of a full cell's cells against scipy."""
    dimension = len(lines)
    n = divisions**level
    expected = evaluate(P, lines, np.arange(n + 1) / n)
    found = corners(brep, level, P.reshape(-1, 3).T)
    places = np.zeros((1, dimension), np.int64)
    digits = np.array(list(product(range(divisions), repeat=dimension)))
    for _ in range(level):
        places = (places[:, None] * divisions + digits).reshape(-1, dimension)
    steps = np.array(list(product((0, 1), repeat=dimension)))
    assert len(found) == len(places) == n**dimension
    for step, spots in zip(steps, found.transpose(1, 0, 2), strict=True):
        wanted = expected[tuple((places + step).T)]
        np.testing.assert_allclose(spots, wanted, rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("name", "degree", "dimension", "level"),
    [
        ("biquadratic", 2, 2, 4),
        ("bicubic", 3, 2, 4),
        ("spline-2", 2, 3, 3),
        ("spline-3", 3, 3, 2),
    ],
)
def test_uniform_cells_are_scipys(name, degree, dimension, level):
    random = np.random.default_rng(degree + dimension)
    P = random.normal(size=(*[degree + 1] * dimension, 3)) * (1, 1.7, 0.6)
    lines = [(knots(degree), degree)] * dimension
    check_scipy(build_cell(Options(name)), P, lines, level)


def test_cells_of_uneven_knots_are_scipys():
    around = [(-0.5, 0, 1, 3), (-3, -1, 0, 1, 1.5, 4), (0, 0, 1, 2)]
    lines = [(np.array([a[0], *a, a[-1]]), len(a) // 2) for a in around]
    P = np.random.default_rng(5).normal(size=(3, 4, 3, 3))
    check_scipy(tensor([spline(a) for a in around]), P, lines, 2)


def test_thirds_are_scipys():
    P = np.random.default_rng(6).normal(size=(3, 4, 3))
    lines = [(knots(2), 2), (knots(3), 3)]
    check_scipy(tensor([uniform(2, 3), uniform(3, 3)]), P, lines, 3, divisions=3)


# --- models ----------------------------------------------------------------------------------


@pytest.mark.parametrize("digits", [(FULL,), (MENGER,), (named("vicsek-9"),), (MENGER, FULL)])
def test_the_box_is_that_of_the_corners_not_of_the_controls(digits):
    system = bcifs(build_cell(Options("spline-2", digits)), digits=digits, level=1)
    np.testing.assert_allclose(system.domain.lower, 0, rtol=0, atol=1e-3)
    np.testing.assert_allclose(system.domain.upper, 1, rtol=0, atol=1e-3)
    assert system.controls.min() == -0.5


def test_a_body_of_splines_is_meshed():
    system = bcifs(build_cell(Options("spline-2", MENGER)), digits=(MENGER,), level=2, size=6.0)
    mesh = mesh_cells(system)
    assert len(mesh.points) == 896
    np.testing.assert_allclose(mesh.volumes.sum(), 6**3 * (20 / 27) ** 2, rtol=1e-10)


def test_an_affine_body_has_its_exact_volume_and_bulk():
    brep = build_cell(Options("spline-2", MENGER))
    shear = np.array([[2, 0.3, 0], [0, 1.3, -0.2], [0, 0, 0.8]])
    controls = shear @ brep.states[0].controls
    system = bcifs(brep, digits=(MENGER,), level=2, controls=controls)
    assert system.bulk_volume == pytest.approx(2 * 1.3 * 0.8, rel=1e-12)
    exact = {row.name: row.value for row in exact_measures(system)}
    assert exact["volume"] == pytest.approx(2.08 * (20 / 27) ** 2, rel=1e-12)
    assert exact["porosity"] == pytest.approx(1 - (20 / 27) ** 2, rel=1e-12)
    assert exact["euler_number"] == -80


def test_a_bent_body_refers_to_its_cell_with_nothing_lost():
    full, kept = (build_cell(Options("spline-2", named(n))) for n in ("full-3", "menger"))
    controls = full.states[0].controls
    random = np.random.default_rng(8)
    controls = controls + random.uniform(-0.15, 0.15, controls.shape)
    whole = mesh_cells(bcifs(full, level=2, controls=controls))
    system = bcifs(kept, level=2, controls=controls)
    assert system.bulk_volume == pytest.approx(whole.volumes.sum(), rel=1e-12)
    assert abs(system.bulk_volume - 1) > 0.01
    grid = voxelize(system, voxels=32)
    found = grid.fill.astype(float).sum() / 255 * grid.frame.voxel_volume
    assert found == pytest.approx(mesh_cells(system).volumes.sum(), rel=0.01)


def test_a_bent_body_lies_in_its_box():
    brep = build_cell(Options("spline-2"))
    random = np.random.default_rng(7)
    controls = brep.states[0].controls * [[1], [1.3], [0.8]]
    controls = controls + random.uniform(-0.1, 0.1, controls.shape)
    system = bcifs(brep, controls=controls, level=3)
    points = corners(brep, 3, controls).reshape(-1, 3)
    slack = 2e-3 * np.ptp(controls)
    for side, found in ((system.domain.lower, points.min(0)), (system.domain.upper, points.max(0))):
        sign = 1 if side is system.domain.lower else -1
        gap = sign * (found - np.array(side))
        assert (gap >= 0).all()
        assert (gap <= slack).all()


def test_digits_that_are_not_the_cells_are_refused():
    with pytest.raises(ModelError, match=r"digits\[0\]: the 8 children of state cell are not the"):
        bcifs(build_cell(Options("spline-2")), digits=(MENGER,), level=1)
    with pytest.raises(ModelError, match=r"got 8 points; wanted 27, those of cell$"):
        bcifs(build_cell(Options("spline-2")), controls=CORNERS.T, level=1)


# --- refusals --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: build_cell(Options("spline-2", FULL, controls=8)), "controls: got 8 for a spl"),
        (lambda: build_cell(Options("spline-2", keep=("002",))), "keep: got '002' for cell"),
        (lambda: build_cell(Options("spline-2", FULL, keep=("000",))), "got both of digits and k"),
        (
            lambda: build_cell(Options("bicubic", curves=(koch(),))),
            "curves: a bicubic cell has its",
        ),
        (lambda: build_cell(Options("tensor")), "curves: got none; wanted one to three"),
        (
            lambda: build_cell(
                Options("tensor", MENGER, curves=(koch(), bezier(1, 3), bezier(2, 3)))
            ),
            r"digits\[0\]: got divisions = 3 for curves of 4 × 3 × 3 pieces",
        ),
        (
            lambda: build_cell(Options("tensor", controls=8, curves=(koch(), bezier(1, 3)))),
            "controls: got 8 for a tensor cell; wanted 3 × 2 = 6",
        ),
        (lambda: build_cell(Options("bicubic", FULL)), "digits: a bicubic cell takes none; wan"),
        (lambda: build_cell(Options("bicubic", keep=("02",))), "keep: got '02' for cell"),
        (
            lambda: build_cell(Options("bicubic", keep={"face": ("00",)})),
            "keep: got children of 'face'; wanted those of cell",
        ),
        (lambda: build_cell(Options("bicubic", texture=ROUGH)), "texture: a bicubic cell takes no"),
        (lambda: tensor([bezier(2)] * 4), "curves: got 4; wanted one to three"),
        (lambda: tensor([bezier(2)] * 2, []), "keep: got digits of 0 levels; wanted 1"),
        (lambda: tensor([bezier(2)] * 2, [np.array([[0, 2]])]), r"keep\[0\]: got digits \[\[0, 2"),
        (lambda: tensor([bezier(2)] * 2, [np.array([[0]])]), r"keep\[0\]: got digits \[\[0\]\]"),
    ],
)
def test_what_is_no_cell_is_refused(make, message):
    with pytest.raises(ModelError, match=message):
        make()


def test_too_many_divisions_are_refused_before_anything_is_made():
    with pytest.raises(MemoryLimitError, match="a cell of 1000000³ sub-cells"):
        build_cell(Options("spline-3", DigitSet(1_000_000, [[0, 0, 0]])))


# --- in recipes ------------------------------------------------------------------------------


def recipe_of(curves, **more):
    table = {"kind": "bcifs", "cell": "tensor", "level": 1, "curves": curves, **more}
    return BCIFSSection.model_validate(table)


@pytest.mark.parametrize(
    ("said", "made"),
    [
        ({"curve": "bezier", "degree": 3}, bezier(3)),
        ({"curve": "bezier"}, bezier(2)),
        ({"curve": "b-spline", "degree": 3, "divisions": 3}, uniform(3, 3)),
        ({"curve": "b-spline", "knots": [0, 0, 1, 1.5]}, spline((0, 0, 1, 1.5))),
        ({"curve": "koch"}, koch()),
        ({"curve": "takagi", "weight": 0.6}, takagi(0.6)),
        ({"curve": "rough", "edge": 0.3, "divisions": 3}, rough(Texture(edge=0.3), 3)),
    ],
    ids=str,
)
def test_recipes_name_curves(said, made):
    brep = system_of(recipe_of([said, {"curve": "bezier", "degree": 1}]), Path()).brep
    assert brep == tensor([made, bezier(1)])


def test_curves_of_a_recipe_have_the_divisions_of_its_digits():
    digits = {"divisions": 3, "keep": "menger"}
    brep = system_of(recipe_of([{"curve": "bezier"}] * 3, digits=digits), Path()).brep
    assert brep == tensor([bezier(2, [3])] * 3, [MENGER.keep])


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"curve": "bezier", "knots": [0, 1]}, "knots: bezier takes none; wanted degree, divisi"),
        ({"curve": "koch", "divisions": 3}, "divisions: koch takes none; wanted no more keys"),
        ({"curve": "takagi"}, "weight: takagi wants one, between -1 and 1"),
        ({"curve": "takagi", "weight": 1.5}, r"got r = 1\.5"),
        ({"curve": "b-spline", "knots": [0, 2, 1, 3]}, "wanted none below the one before"),
        ({"curve": "b-spline", "degree": 3, "knots": [0, 0, 1, 1]}, "knots: got 4; wanted 6"),
        ({"curve": "rough", "edge": [0.1, 0.2, 0.3]}, "got 3 numbers; wanted 2 for divisions = 2"),
        ({"curve": "nurbs"}, "'bezier', 'b-spline', 'koch', 'takagi' or 'rough'"),
        ({"curve": "bezier", "degree": 9}, "less than or equal to 8"),
    ],
    ids=str,
)
def test_curves_that_are_none_are_refused(said, message):
    with pytest.raises(ValidationError, match=message):
        recipe_of([said])
