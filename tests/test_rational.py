"""Rational controls: exact circles and spheres, splines with weights, boxes, covers, refusals."""

from itertools import product

import naive_elasticity
import naive_limits as naive
import numpy as np
import pytest
from rough import rough as rough_rule
from rough import sponge
from scipy.interpolate import BSpline

import porous as po
from porous import mesh_cells, voxelize
from porous.errors import ModelError, RecipeError
from porous.formats import inp
from porous.guests import ccx
from porous.jobs import compression, material
from porous.models.automaton import Automaton, Cells, State, Transition, cells
from porous.models.bcifs import bcifs
from porous.models.builders import Options, Texture, build_cell
from porous.models.builders._curves import bezier, rough, spline
from porous.models.builders.spline import tensor
from porous.models.cell_cover import cover_cells
from porous.models.cell_exact import exact_measures
from porous.models.cell_nodes import placed_corners
from porous.models.cell_system import CellSystem, natural_box
from porous.models.closure import closure
from porous.models.complex import cell_complex
from porous.models.control_box import control_box
from porous.models.digits import named
from porous.models.dimension import affinity_dimension
from porous.models.drawing import cell, nothing
from porous.models.mixtures import weights_of
from porous.models.rational import columns, homogeneous, positions, scaled
from porous.models.solve import solve
from porous.models.swept_body import Sweep
from porous.values import Box, Frame

MENGER, FULL = named("menger"), named("full-2")
ROUGH = Texture(edge=(0.3, -0.2, 0.3), bump=(0.5, 0.3))
HALF = np.sqrt(0.5)
QUARTER = np.array([[1, 0, 1], [1, 1, HALF], [0, 1, 1]])
"""x, y and weight of the three controls of a quarter circle."""


def ring(inner=1.0, outer=2.0, height=1.0):
    """Controls (4, 27) of a quarter of a hollow cylinder: along the radius, round it, up."""
    return np.array(
        [
            [r * x, r * y, z, w]
            for r in np.linspace(inner, outer, 3)
            for x, y, w in QUARTER
            for z in np.linspace(0, height, 3)
        ]
    ).T


def shell(inner=1.0, outer=1.25, low=-0.5, high=1.0):
    """Controls (4, 27) of a shell about the origin: a quarter round, between two latitudes."""
    middle, half = (low + high) / 2, (high - low) / 2
    arc = [
        (np.cos(low), np.sin(low), 1),
        (np.cos(middle) / np.cos(half), np.sin(middle) / np.cos(half), np.cos(half)),
        (np.cos(high), np.sin(high), 1),
    ]
    return np.array(
        [
            [r * a * x, r * a * y, r * b, v * w]
            for r in np.linspace(inner, outer, 3)
            for x, y, w in QUARTER
            for a, b, v in arc
        ]
    ).T


def hexa(digits=MENGER, controls=None, texture=None, **more):
    """A body of cells with 27 controls."""
    digits = digits if isinstance(digits, tuple) else (digits,)
    brep = build_cell(Options("hex-27", digits, texture))
    return bcifs(brep, digits=digits, controls=controls, **more)


def corners(brep, level, controls):
    """The corners (v, 3) of the cells of a level."""
    solution = solve(brep)
    found = cell_complex(closure(solution), level)
    return placed_corners(solution, found, solution.automaton(homogeneous(controls)), level)[0]


# --- circles and spheres ---------------------------------------------------------------------


@pytest.mark.parametrize("divisions", [2, 3])
def test_a_curve_of_three_controls_is_a_quarter_circle(divisions):
    wall = tensor([bezier(2, divisions), bezier(1, divisions)])
    P = np.array([[x, y, z, w] for x, y, w in QUARTER for z in (0.0, 1.0)]).T
    for level in range(1, 6):
        x, y, z = corners(wall, level, P).T
        np.testing.assert_allclose(np.hypot(x, y), 1, rtol=0, atol=1e-12)
        assert len(np.unique(np.rint(1e6 * np.arctan2(y, x)))) == divisions**level + 1
        np.testing.assert_allclose(
            np.sort(z[x == 1]), np.arange(divisions**level + 1) / divisions**level, atol=1e-15
        )


@pytest.mark.parametrize("level", [0, 2])
def test_a_quarter_cylinder_has_its_radii_exactly(level):
    body = hexa(named("full-3"), ring(), level=level)
    radius = np.hypot(*body.nodes.points[:, :2].T)
    steps = np.arange(3**level + 1) / 3**level
    nearest = np.abs(radius[:, None] - 1 - steps).min(axis=1)
    assert nearest.max() <= 1e-14
    for wanted in (1, 2):
        assert np.isclose(radius, wanted, rtol=0, atol=1e-14).sum() == len(steps) ** 2
    assert body.domain == Box((0, 0, 0), (2, 2, 1))


def test_the_bulk_of_a_quarter_cylinder_converges_with_the_square_of_the_cells():
    whole = 3 * np.pi / 4
    errors = []
    for level in (1, 2, 3):
        body = hexa(FULL, ring(), level=level)
        t = np.arange(2**level + 1) / 2**level
        x, y = QUARTER[:, :2].T * QUARTER[:, 2] @ [(1 - t) ** 2, 2 * t * (1 - t), t**2]
        chords = 1.5 * np.sin(np.diff(np.arctan2(y, x))).sum()
        assert body.bulk_volume == pytest.approx(chords, rel=1e-12)
        assert mesh_cells(body).volumes.sum() == pytest.approx(chords, rel=1e-12)
        errors.append(1 - chords / whole)
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders[-1] == pytest.approx(2, abs=0.02)


def test_a_shell_of_a_sphere_has_its_radius_exactly():
    exact = np.pi / 2 * (np.sin(1.0) - np.sin(-0.5)) * (1.25**3 - 1) / 3
    errors = []
    for level in (1, 2, 3):
        body = hexa(FULL, shell(), level=level)
        radius = np.linalg.norm(body.nodes.points, axis=1)
        for wanted in (1, 1.25):
            ends = np.isclose(radius, wanted, rtol=0, atol=1e-12)
            assert ends.sum() == (2**level + 1) ** 2
        errors.append(1 - body.bulk_volume / exact)
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders[-1] == pytest.approx(2, abs=0.05)


def test_an_octant_with_a_pole_is_refused():
    with pytest.raises(ModelError, match=r"controls: 2 and 5 coincide at "):
        hexa(FULL, shell(low=0.0, high=np.pi / 2), level=1)


# --- splines ---------------------------------------------------------------------------------


def test_splines_with_weights_are_scipys():
    around = [(-0.5, 0, 1, 3), (0, 0, 1, 2)]
    random = np.random.default_rng(5)
    P = np.concatenate(
        [random.normal(size=(3, 3, 3)) * (1, 1.7, 0.6), random.uniform(0.3, 2, (3, 3, 1))], axis=2
    )
    found = corners(tensor([spline(a) for a in around]), 3, P.reshape(-1, 4).T)
    lifted = np.concatenate([P[..., :3] * P[..., 3:], P[..., 3:]], axis=2)
    t = np.arange(9) / 8
    for axis, knots in enumerate(around):
        line = BSpline(np.array([knots[0], *knots, knots[-1]]), np.moveaxis(lifted, axis, 0), 2)
        lifted = np.moveaxis(line(t), 0, axis)
    wanted = (lifted[..., :3] / lifted[..., 3:]).reshape(-1, 3)
    assert len(found) == len(wanted)
    gaps = np.abs(found[:, None] - wanted).max(axis=2)
    assert gaps.min(axis=0).max() < 1e-10
    assert gaps.min(axis=1).max() < 1e-10


# --- weights ---------------------------------------------------------------------------------


def test_controls_move_with_the_body():
    shear = np.array([[2, 0.3, 0], [0, 1.3, -0.2], [0.1, 0, 0.8]])
    shift = np.array([[3.0], [-1], [0.5]])
    P = ring()
    moved = np.vstack([shear @ P[:3] + shift, P[3:]])
    box = Box((-9, -9, -9), (9, 9, 9))
    one, other = (hexa(MENGER, own, ROUGH, level=1, domain=box) for own in (P, moved))
    np.testing.assert_allclose(other.nodes.points, one.nodes.points @ shear.T + shift.T, atol=1e-14)
    assert other.bulk_volume == pytest.approx(one.bulk_volume * np.linalg.det(shear), rel=1e-13)


@pytest.mark.parametrize("factor", [1e-200, 0.37, 2.0**600])
def test_a_common_factor_of_all_weights_means_nothing(factor):
    P = ring()
    one, other = (hexa(MENGER, np.vstack([P[:3], w * P[3:]]), level=1) for w in (1, factor))
    np.testing.assert_allclose(other.nodes.points, one.nodes.points, rtol=0, atol=1e-15)


def test_equal_weights_are_none():
    P = ring()
    box = Box((0, 0, 0), (3, 3, 1))
    one = hexa(MENGER, P[:3], ROUGH, level=1, domain=box)
    other = hexa(MENGER, np.vstack([P[:3], np.full(27, 0.7)]), ROUGH, level=1, domain=box)
    assert np.array_equal(other.controls, one.controls)
    # Were they divided by, it would be the same.
    kept = np.vstack([0.7 * P[:3], np.full(27, 0.7)])
    divided = CellSystem(one.solution, kept, 1, box)
    np.testing.assert_allclose(divided.nodes.points, one.nodes.points, rtol=0, atol=2e-15)
    assert divided.bulk_volume == pytest.approx(one.bulk_volume, rel=1e-14)


def test_eight_corners_with_weights_serve():
    spots = np.array(list(product((0.0, 1.0), repeat=3)))
    P = np.column_stack([spots, np.linspace(1, 2, 8)]).T
    small = bcifs(build_cell(Options("hex-8", MENGER)), digits=(MENGER,), controls=P, level=2)
    large = hexa(MENGER, P, level=2)
    np.testing.assert_allclose(large.nodes.points, small.nodes.points, atol=1e-14)
    assert "volume" not in {row.name for row in exact_measures(small)}
    assert {row.name: row.value for row in exact_measures(small)}["genus"] == 81


def test_a_block_in_perspective_keeps_its_dimension():
    spots = np.array(list(product((0.0, 1.0), repeat=3)))
    weights = 1 + spots @ [0.3, 0.1, 0.2]
    P = np.column_stack([spots / weights[:, None], weights]).T
    body = bcifs(build_cell(Options("hex-8", MENGER)), digits=(MENGER,), controls=P, level=2)
    assert affinity_dimension(body.automaton) == pytest.approx(np.log(20) / np.log(3), abs=1e-9)
    # What was flat and straight stays it: the bulk is a hexahedron at all levels.
    whole = bcifs(build_cell(Options("hex-8", FULL)), digits=(FULL,), controls=P, level=3)
    assert body.bulk_volume == pytest.approx(whole.bulk_volume, rel=1e-13)
    assert mesh_cells(whole).volumes.sum() == pytest.approx(whole.bulk_volume, rel=1e-13)


def test_size_scales_controls_and_no_weights():
    body = hexa(MENGER, ring(), level=1, size=5.0)
    assert body.domain == Box((0, 0, 0), (5, 5, 2.5))
    radius = np.hypot(*body.nodes.points[:, :2].T)
    assert (radius.min(), radius.max()) == pytest.approx((2.5, 5), rel=1e-15)


def curve(texture, weights):
    """A rough curve of three controls with weights."""
    P = np.array([[1, 1, 0], [0, 1, 1], [0, 0, 0], weights])
    moves = tuple(Transition(0, 0, T) for T in rough_rule((0.5, 0.3), texture))
    return Automaton((State("curve", homogeneous(P)),), moves)


def test_weights_that_stay_above_zero_are_accepted():
    system = curve((0.45, -0.4, 0.45), (1, 0.2, 1))
    lowest = [cells(system, level)[0].points[:, 3].min() for level in range(1, 7)]
    assert min(lowest) == pytest.approx(0.44, abs=1e-12)
    box = control_box(system, tolerance=1e-4, drawn={0: (0, 2)})
    points = positions(cells(system, 8)[0].points)[:, :, [0, 2]].transpose(0, 2, 1).reshape(-1, 3)
    for side, found in ((box.lower, points.min(axis=0)), (box.upper, points.max(axis=0))):
        np.testing.assert_allclose(side, found, rtol=0, atol=2e-3)
    assert (points.min(axis=0) >= box.lower).all()
    assert (points.max(axis=0) <= box.upper).all()


def test_weights_that_fall_to_zero_are_refused():
    system = curve((0.9, -0.9, 0.9), (1, 0.2, 1))
    lowest = [float(cells(system, level)[0].points[:, 3].min()) for level in (1, 2, 6)]
    assert lowest == pytest.approx([0.08, -0.0893, -0.5488], abs=1e-4)
    with pytest.raises(
        ModelError, match=r"cells fall to -\d.* to -0.0893333 at a control of cell 0.2 "
    ):
        control_box(system, tolerance=1e-3)
    lines = [rough(Texture(edge=(0.9, -0.9, 0.9), bump=(0.5, 0.3)), 3), bezier(1, 3)]
    P = np.array([[x, y, z, w] for x, y, w in QUARTER for z in (0.0, 1.0)]).T
    P[3, 2:4] = 0.2
    thin = Sweep(("edges",), 0.01)
    with pytest.raises(ModelError, match="controls: the weights of smaller cells fall to -"):
        bcifs(tensor(lines), controls=P, level=2, draw=thin)
    # Where the box is given, what is divided is looked at.
    box = Box((-9, -9, -9), (9, 9, 9))
    with pytest.raises(ModelError, match="a point of some cell is mixed to a weight of -"):
        _ = bcifs(tensor(lines), controls=P, level=5, draw=thin, domain=box).places


# --- boxes -----------------------------------------------------------------------------------


def test_the_box_of_a_rough_ring_holds_it_tightly():
    brep = build_cell(Options("hex-27", (named("vicsek-9"),), Texture(edge=0.2, bump=0.4)))
    solution = solve(brep)
    box = natural_box(solution, solution.automaton(homogeneous(ring())), 1e-2)
    points = corners(brep, 3, ring())
    for side, found in ((box.lower, points.min(axis=0)), (box.upper, points.max(axis=0))):
        np.testing.assert_allclose(side, found, rtol=0, atol=0.06)
    assert (points.min(axis=0) >= box.lower).all()
    assert (points.max(axis=0) <= box.upper).all()


def test_the_box_of_several_cells_holds_each():
    one, other = curve((0.3, -0.2, 0.3), (1, 0.5, 1)), curve((0.3, -0.2, 0.3), (1, 2, 1.5))
    moved = scaled(other.states[0].controls, 1.3, np.array([[2.0], [0.5], [1]]))
    first = one.states[0].controls
    apart = [
        control_box(Automaton((State("curve", P),), one.transitions), tolerance=1e-4)
        for P in (first, moved)
    ]
    both = Cells(0, np.stack([first, moved]), np.arange(2))
    system = Automaton(one.states, one.transitions, roots=(both,))
    found = control_box(system, tolerance=1e-4)
    lower, upper = np.array([(box.lower, box.upper) for box in apart]).transpose(1, 0, 2)
    np.testing.assert_allclose(found.lower, lower.min(axis=0), rtol=0, atol=2e-4)
    np.testing.assert_allclose(found.upper, upper.max(axis=0), rtol=0, atol=2e-4)
    frame = Frame(found.lower, np.array(found.lengths) / (13, 9, 7) + 1e-3, (13, 9, 7))
    marks = cover_cells(system, frame)[0]
    each = [
        cover_cells(Automaton((State("curve", P),), one.transitions), frame)[0]
        for P in (first, moved)
    ]
    assert np.array_equal(marks, each[0] | each[1])


# --- bodies ----------------------------------------------------------------------------------


def test_voxels_of_a_ring_are_the_cells():
    body = hexa(MENGER, ring(), level=2)
    grid = voxelize(body, voxels=48)
    found = grid.fill.astype(float).sum() / 255 * grid.frame.voxel_volume
    assert found == pytest.approx(mesh_cells(body).volumes.sum(), rel=5e-3)
    assert body.betti_numbers == (1, 81, 0)


def test_shells_and_beams_of_arcs_have_the_volume_of_straight_ones():
    """A ball's sweep along what bends and does not stretch: Weyl's tube formula, 1939."""
    P = np.array([[x, y, z, w] for x, y, w in QUARTER for z in (0.0, 1.0)]).T
    radius, arc = 0.1, np.pi / 2
    ball = 4 / 3 * np.pi * radius**3
    beam = np.pi * radius**2 * arc + ball
    shell = 2 * radius * arc + np.pi / 2 * radius**2 * (2 * arc + 2) + ball
    for brep, controls, along, wanted in (
        (tensor([bezier(2)]), P[:, ::2], "edges", beam),
        (tensor([bezier(2), bezier(1)]), P, "faces", shell),
    ):
        body = bcifs(brep, controls=controls, level=4, draw=Sweep((along,), radius))
        grid = voxelize(body, voxels=60)
        found = grid.fill.astype(float).sum() / 255 * grid.frame.voxel_volume
        assert found == pytest.approx(wanted, rel=2e-3)
        ends = np.hypot(*body.places[0][:, :2].T)
        np.testing.assert_allclose(ends, 1, rtol=0, atol=1e-12)


def centres(frame):
    """Middles of voxels, three arrays."""
    steps = [np.arange(n) + 0.5 for n in frame.shape]
    axes = [a + h * i for a, h, i in zip(frame.origin, frame.spacing, steps, strict=True)]
    return np.meshgrid(*axes, indexing="ij")


# --- limits ----------------------------------------------------------------------------------


def with_weights(automaton, weights):
    """The same system with weights of the level-0 cell's controls."""
    first = automaton.states[0]
    lifted = State(first.name, np.vstack([first.controls * weights, weights]))
    return Automaton((lifted, *automaton.states[1:]), automaton.transitions)


KEPT = [(0, 0, 0), (1, 2, 0), (2, 1, 2), (0, 2, 1)]


@pytest.mark.parametrize("texture", [(1 / 9,) * 3, (0.3, -0.2, 0.3)], ids=["smooth", "rough"])
def test_a_cover_holds_the_limit_and_reaches_no_further_than_it_says(texture):
    P = homogeneous(ring(height=1.7))
    plan = sponge(rough_rule((4 / 9, 4 / 9), texture), KEPT)
    system = Automaton((State("ring", P),), plan.transitions)
    box = control_box(system, tolerance=1e-2)
    frame = Frame(box.lower, np.array(box.lengths) / (11, 9, 8), (11, 9, 8))
    marks, bound = cover_cells(system, frame)
    group = cells(system, 6)[0]
    places = positions(group.points)
    points = places[:, :, 0]  # a corner is a point of the limit
    size = np.linalg.norm(np.ptp(places, axis=2), axis=1).max() * (1 + naive.overhang(system))
    index, inside = naive.voxels_of(points, frame)
    assert inside.all()
    assert marks[tuple(index.T)].all()
    assert 10 < marks.sum() < marks.size / 3
    assert naive.furthest(marks, frame, points) <= bound + size


def test_a_divisor_of_one_changes_no_cover():
    system = sponge(rough_rule((0.5, 0.3), (0.3, -0.2, 0.3)), KEPT)
    system = Automaton((State("bent", ring(height=1.7)[:3]),), system.transitions)
    frame = Frame((-0.2, -0.1, -0.1), (0.21, 0.19, 0.23), (11, 12, 9))
    wanted = cover_cells(system, frame)
    for weight in (1.0, 0.3):
        found = cover_cells(with_weights(system, np.full(27, weight)), frame)
        assert np.array_equal(found[0], wanted[0])
        assert found[1] == wanted[1]
    part = frame.tile((3, 2, 1), (9, 11, 7))
    curved = with_weights(system, ring()[3])
    assert np.array_equal(
        cover_cells(curved, part)[0], cover_cells(curved, frame)[0][3:9, 2:11, 1:7]
    )


def test_cells_that_end_belong_to_the_limit_in_perspective():
    slope = np.array([0.3, 0.1, 0.2])
    corner = np.hstack([np.zeros((3, 1)), np.eye(3)])
    spots = np.array(list(product((0.0, 1.0), repeat=3)))
    block, leaf = State("block", spots.T), State("leaf", corner)
    places = [spots / 2, spots * [0.4, 0.5, 0.45] + [0.6, 0.5, 0.55]]
    moves = [Transition(0, 0, weights_of(block, points)) for points in places]
    moves.append(Transition(0, 1, weights_of(block, corner.T * 0.3 + [0.65, 0.05, 0.1])))
    drawings = nothing(8), cell(4)
    straight = Automaton((block, leaf), tuple(moves))
    lifted = State("block", np.vstack([spots.T, 1 + spots @ slope]))
    turned = Automaton((lifted, leaf), tuple(moves))
    frame = Frame((-0.03, -0.02, -0.04), (0.047, 0.053, 0.051), (17, 18, 16))
    marks, bound = cover_cells(turned, frame, drawings=drawings)
    ends = next(group.points for group in cells(straight, 9) if group.state == 1)
    shares = np.random.default_rng(3).dirichlet(np.ones(4), 30)
    points = (ends @ shares.T).transpose(0, 2, 1).reshape(-1, 3)
    points = points / (1 + points @ slope)[:, None]
    index, inside = naive.voxels_of(points, frame)
    assert inside.all()
    assert marks[tuple(index.T)].all()
    assert naive.furthest(marks, frame, points) <= bound + 0.1
    assert marks.sum() < marks.size / 4


def test_a_limit_of_rational_cells_is_covered_by_its_recipe():
    controls = ring(10, 20, 10).T.tolist()
    model = hexa(FULL, np.array(controls).T, level="limit", unit="mm")
    marks, bound = model.cover(Frame((0, 0, 0), (1, 1, 1), (20, 20, 10)))
    x, y = np.meshgrid(np.arange(20) + 0.5, np.arange(20) + 0.5, indexing="ij")
    radius = np.hypot(x, y)
    near, far = np.hypot(np.floor(x), np.floor(y)), np.hypot(np.ceil(x), np.ceil(y))
    touched = (far >= 10) & (near <= 20)
    assert (marks.all(axis=2) == touched).all() or (marks.all(axis=2) >= touched).all()
    assert not marks[(radius < 10 - bound) | (radius > 20 + bound)].any()


def test_a_grown_limit_of_rational_cells_keeps_its_radii():
    wall = tensor([bezier(2), bezier(1)])
    P = np.array([[x, y, z, w] for x, y, w in QUARTER for z in (0.0, 1.0)]).T
    model = bcifs(wall, controls=P, level="limit", offset=0.2)
    assert model.domain == Box((-0.2, -0.2, -0.2), (1.2, 1.2, 1.2))
    grid = voxelize(model, voxels=28)
    x, y, z = centres(grid.frame)
    gap = np.abs(np.hypot(x, y) - 1)
    inner = (x > 0) & (y > 0) & (z > 0) & (z < 1)
    reach = grid.frame.diagonal / 2 + model.sampling_error(grid.frame)
    assert (grid.fill[inner & (gap < 0.2 - reach)] == 255).all()
    assert not grid.fill[inner & (gap > 0.2 + reach)].any()
    shell = 0.4 * np.pi / 2 + np.pi / 2 * 0.04 * (np.pi + 2) + 4 / 3 * np.pi * 0.008
    found = grid.fill.astype(float).sum() / 255 * grid.frame.voxel_volume
    assert found == pytest.approx(shell, rel=0.02)


# --- refusals --------------------------------------------------------------------------------


def changed(**places):
    P = ring()
    for place, value in places.items():
        P[3, int(place[1:])] = value
    return P


@pytest.mark.parametrize(
    ("controls", "message"),
    [
        (changed(w4=0), r"controls\[4\]: got weight 0 beside a largest of 1; wanted weights above"),
        (changed(w0=-1), r"controls\[0\]: got weight -1 beside a largest of 1; wanted weights ab"),
        (changed(w0=-1, w3=-2), r"controls\[3\]: got weight -2"),
        (changed(w9=1e-12), r"controls\[9\]: got weight 1e-12 beside a largest of 1; wanted"),
        (changed(w9=np.nan), "controls: got .*; wanted finite numbers"),
        (changed(w9=np.inf), "controls: got .*; wanted finite numbers"),
        (-np.abs(ring()), r"controls\[\d+\]: got weight -1 beside a largest of -0.7"),
        (ring()[:2], r"controls: got shape \(2, 27\); wanted \(3, m\), or \(4, m\) with weights"),
        (np.vstack([ring(), ring()[:1]]), r"controls: got shape \(5, 27\); wanted \(3, m\)"),
        (ring()[:, :26], "controls: got 26 points; wanted 27"),
    ],
)
def test_weights_that_are_none_are_refused(controls, message):
    with pytest.raises(ModelError, match=message) as error:
        hexa(MENGER, controls, level=1)
    assert "\n" not in str(error.value)


def recipe(rows):
    return po.load("menger-bent", set={"model.controls": rows, "model.level": 1})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda rows: rows[5].pop(),
            r"controls\[5\]: got 3 numbers, but 4 in controls\[0\]; wante",
        ),
        (lambda rows: rows[5].append(1), r"controls"),
        (lambda rows: rows[5].__setitem__(3, float("nan")), r"controls"),
        (lambda rows: rows[5].__setitem__(3, "1"), r"controls"),
        (lambda rows: rows[5].__setitem__(3, -0.5), r"controls\[5\]: got weight -0.5"),
    ],
)
def test_a_recipe_s_weights_are_checked(change, message):
    rows = ring().T.tolist()
    change(rows)
    with pytest.raises((ModelError, RecipeError), match=message) as error:
        po.build(recipe(rows))
    assert "\n" not in str(error.value)


def test_a_recipe_takes_four_numbers():
    body = po.build(recipe(ring().T.tolist()))
    assert body.controls.shape == (4, 27)
    np.testing.assert_array_equal(columns(ring().T.tolist()), ring())
    np.testing.assert_array_equal(scaled(homogeneous(ring()), 2.0)[3], ring()[3])


# --- in the solver ---------------------------------------------------------------------------


@pytest.mark.judge
def test_a_quarter_cylinder_bears_its_load_in_calculix(judge):
    mesh = mesh_cells(hexa(MENGER, ring(10, 20, 10), level=2))
    job = compression(mesh, material=material("steel"), pressure=2.0)
    assert job.mesh.cells == 400
    solved = ccx.solve(inp.write(job), program=judge("ccx"))
    energy, load = naive_elasticity.energy(job)
    assert solved.reaction == pytest.approx(load, abs=1e-5 * np.linalg.norm(load))
    assert solved.energy == pytest.approx(energy, rel=1e-5)
    assert solved.volume == pytest.approx(mesh.volumes.sum(), rel=1e-5)
    assert "nonpositive" not in solved.log
