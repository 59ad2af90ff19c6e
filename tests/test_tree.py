"""Branching trees: cells, constraints and counts, node heights, radii by law, bodies, refusals."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from naive_quotient import Quotient
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from porous.cli import main
from porous.errors import ModelError, RecipeError
from porous.guests import ccx
from porous.measures import components, volume
from porous.models.bcifs import bcifs
from porous.models.closure import closure
from porous.models.complex import cell_complex
from porous.models.solve import solve
from porous.models.tree import build, strut_radii, tree
from porous.models.tree_cells import APEX, CONTROLS, TRUNK, tree_cells
from porous.recipe import dump, parse
from porous.stages import voxelize
from porous.values import CENTRE, Box, Frame

SPEC = (3, 2), (0.35, 0.45)
"""Threefold once, twofold from then on, each with its height."""

SYSTEMS = [SPEC, ((2,), (0.45,)), ((4,), (0.3,)), ((2, 3), (0.5,)), ((2,), (0.3, 0.6, 0.5))]
each_system = pytest.mark.parametrize(("branches", "heights"), SYSTEMS)


def at(values, level):
    """What holds on a level: the last holds below."""
    return values[min(level, len(values) - 1)]


def struts(model):
    """Ends (k, 2, 3) and radii (k,) of all struts, trunks and leaves."""
    parts = model.body.parts
    ends = np.concatenate([part.capsules for part in parts])
    return ends, np.concatenate([part.capsule_radii for part in parts])


def by_level(model, levels):
    """Ends of the struts of each level, by the height of their lower ends."""
    ends, radii = struts(model)
    _, level = np.unique(ends[:, 0, 2].round(9), return_inverse=True)
    assert level.max() == levels
    return [(ends[level == k], radii[level == k]) for k in range(levels + 1)]


def tops(brep, level, controls):
    """Controls (3, 5) of the subtrees of a level."""
    found = [(brep.start, controls)]
    for _ in range(level):
        found = [(c.state, P @ c.guess) for q, P in found for c in brep.states[q].children or ()]
    return np.array([P for _, P in found if P.shape[1] == 5])


# --- cells and constraints -------------------------------------------------------------------


def test_a_twofold_tree_is_the_one_in_the_literature():
    brep = tree_cells((2,), (0.45,))
    first, trunk = brep.states[0].children[0], brep.states[0].children[-1]
    node = [0.1125, 0.1125, 0.1125, 0.1125, 0.55]
    columns = [
        [1, 0, 0, 0, 0],
        [0.5, 0.5, 0, 0, 0],
        [0.5, 0, 0.5, 0, 0],
        [0.25, 0.25, 0.25, 0.25, 0],
        node,
    ]
    np.testing.assert_allclose(first.guess.T, columns, rtol=0, atol=1e-16)
    np.testing.assert_allclose(trunk.guess.T, [[0, 0, 0, 0, 1], node], rtol=0, atol=1e-16)
    assert trunk.name == brep.states[trunk.state].name == TRUNK
    assert not brep.states[trunk.state].children


def test_the_node_is_all_that_is_free():
    brep = tree_cells((2,), (0.45,))
    tree_state = brep.states[0]
    assert (len(tree_state.incidences), len(tree_state.adjacencies)) == (5, 4)
    solution = solve(brep)
    assert solution.residual <= 1e-15
    assert solution.free_points(0) == 1
    (slider,) = (s for s in solution.sliders if s.state == 0)
    moved = solve(brep, {slider.name: [0.1, 0, 0, 0, -0.1]})
    assert moved.residual <= 1e-15
    nodes = {tuple((moved.matrices[0][i] @ e).round(12)) for i, e in enumerate(np.eye(5)[[4] * 4])}
    assert nodes == {tuple(moved.matrices[0][4][:, 1].round(12))}
    assert nodes == {(0.2125, 0.1125, 0.1125, 0.1125, 0.45)}


@each_system
def test_counts_are_those_of_a_tree_on_a_grid(branches, heights):
    brep = tree_cells(branches, heights)
    found = closure(solve(brep))
    side, trunks = 1, 0
    for level in range(4):
        complex_ = cell_complex(found, level)
        names = [state.name.rstrip("0123456789") for state in brep.states]
        counts = dict.fromkeys(names, 0)
        for name, many in zip(names, complex_.states, strict=True):
            counts[name] += many
        assert counts["tree"] == counts["face"] == side**2
        assert counts["edge"] == 2 * side * (side + 1)
        assert counts[TRUNK] == trunks
        assert counts["vertex"] == (side + 1) ** 2 + trunks + 1
        assert complex_.components == 1
        trunks += side**2
        side *= at(branches, level)


def test_three_then_two_then_two():
    brep = tree_cells(*SPEC)
    complex_ = cell_complex(closure(solve(brep)), 3)
    counts = dict(zip([state.name for state in brep.states], complex_.states, strict=True))
    assert (counts["tree0"], counts["tree1"], counts[TRUNK]) == (0, 144, 1 + 9 + 36)
    assert counts["vertex"] == 13 * 13 + 46 + 1
    grid = tops(brep, 3, CONTROLS)[:, :, :4].swapaxes(1, 2).reshape(-1, 3)
    assert np.abs(grid * 12 - np.rint(grid * 12)).max() <= 1e-14
    nodes = {tuple(p) for p in np.rint(grid * 12).astype(int).tolist()}
    assert nodes == {(i, j, 12) for i in range(13) for j in range(13)}


def refined(brep, cells):
    """The children of cells (state, controls), a terminal cell its own."""
    return [
        pair
        for q, P in cells
        for pair in [(c.state, P @ c.guess) for c in brep.states[q].children] or [(q, P)]
    ]


@each_system
def test_constraints_join_what_coincides_and_nothing_else(branches, heights):
    """Vertices are one where they lie at one place, whatever the five controls are."""
    brep = tree_cells(branches, heights)
    found = closure(solve(brep))
    (vertex,) = (q for q, state in enumerate(brep.states) if state.shape == "vertex")
    cells = [(brep.start, np.random.default_rng(3).normal(size=(4, 5)))]
    for level in range(4):
        points = np.concatenate([P.T for _, P in cells])
        assert cell_complex(found, level).states[vertex] == len(np.unique(points.round(9), axis=0))
        cells = refined(brep, cells)


def test_a_union_find_of_instances_counts_the_same():
    """It does not carry terminal cells on, so that it sees one level."""
    brep = tree_cells((3,), (0.4,))
    quotient = Quotient(brep)
    quotient.refine()
    roots = set(quotient.roots(quotient.cells))
    counts = tuple(sum(quotient.state[r] == q for r in roots) for q in range(len(brep.states)))
    assert counts == cell_complex(closure(solve(brep)), 1).states


def test_subtrees_share_top_edges_with_their_neighbours_and_the_parent():
    brep = tree_cells((3,), (0.4,))
    complex_ = cell_complex(closure(solve(brep)), 2)
    (group,) = (g for g in complex_.cells if brep.states[g.state].shape == "pyramid")
    edges = complex_.ids_of(group, 1)
    uses = np.bincount(edges.ravel())
    assert ((uses == 1).sum(), (uses == 2).sum()) == (4 * 9, 2 * 9 * 8)


# --- heights, radii, slenderness -------------------------------------------------------------


def test_nodes_lie_where_the_product_says():
    levels = by_level(tree(*SPEC, radius=0.1), 3)
    heights = [ends[0, 1, 2] for ends, _ in levels]
    np.testing.assert_allclose(heights, [0.35, 0.6425, 0.803375, 1], rtol=0, atol=1e-15)
    for k, (ends, _) in enumerate(levels[:3]):
        expected = 1 - math.prod(1 - at(SPEC[1], j) for j in range(k + 1))
        np.testing.assert_allclose(ends[:, 1, 2], expected, rtol=0, atol=1e-15)
    assert [len(ends) for ends, _ in levels] == [1, 9, 36, 144]


def test_nodes_are_mixed_from_wherever_the_controls_are():
    rng = np.random.default_rng(5)
    controls = rng.normal(size=(5, 3)) * [3, 1, 2]
    ends, _ = struts(tree((2,), (0.4,), radius=0.1, level=1, controls=controls))
    node = 0.4 * controls[:4].mean(axis=0) + 0.6 * controls[4]
    middles = [
        np.einsum("a,b,abx->x", u, v, controls[:4].reshape(2, 2, 3))
        for u in ([0.75, 0.25], [0.25, 0.75])
        for v in ([0.75, 0.25], [0.25, 0.75])
    ]
    expected = [[node, middle] for middle in middles] + [[controls[4], node]]
    found = sorted(np.round(ends, 12).tolist())
    np.testing.assert_allclose(found, sorted(np.round(expected, 12).tolist()), rtol=0, atol=1e-12)


@each_system
@pytest.mark.parametrize(("law", "power"), [("area", 2), ("murray", 3)])
def test_each_law_keeps_its_sum_on_all_levels(branches, heights, law, power):
    model = tree(branches, heights, radius=0.07, level=3, law=law)
    sums = [(radii**power).sum() for _, radii in by_level(model, 3)]
    np.testing.assert_allclose(sums, 0.07**power, rtol=1e-12)
    for level, (_, radii) in enumerate(by_level(model, 3)):
        np.testing.assert_allclose(radii, strut_radii(0.07, branches, law)[level], rtol=1e-15)


@pytest.mark.parametrize("branches", [2, 3, 4])
@pytest.mark.parametrize("margin", [-0.08, 0.08])
def test_struts_get_slenderer_where_they_shorten_less_than_they_thin(branches, margin):
    height = 1 - 1 / branches - margin
    levels = by_level(tree((branches,), (height,), radius=0.1, level=3), 3)[:3]
    slender = [np.ptp(ends[0, :, 2]) / radii[0] for ends, radii in levels]
    ratio = (1 - height) * branches
    np.testing.assert_allclose(np.divide(slender[1:], slender[:-1]), ratio, rtol=1e-12)
    assert (np.diff(slender) > 0).all() == (margin > 0)


# --- bodies ----------------------------------------------------------------------------------


@each_system
def test_the_struts_are_a_tree(branches, heights):
    ends, _ = struts(tree(branches, heights, radius=0.05))
    _, node = np.unique(ends.reshape(-1, 3).round(9), axis=0, return_inverse=True)
    pairs, many = node.reshape(-1, 2), node.max() + 1
    joined = coo_array((np.ones(len(pairs)), pairs.T), shape=(many, many))
    assert connected_components(joined, directed=False)[0] == 1
    assert len(pairs) == many - 1


def test_the_body_is_one_piece_of_the_volume_of_its_struts():
    """Voxels hold the struts; their ends overlap, so that the sum of all is an upper bound."""
    controls = [[0, 0, 12], [0, 10, 12], [9, 0, 12], [9, 10, 12], [4, 5, 0]]
    model = tree(*SPEC, radius=1.0, level=2, controls=controls)
    grid = voxelize(model, spacing=(0.13, 0.11, 0.12))
    assert components(grid).value == 1
    ends, radii = struts(model)
    lengths = np.linalg.norm(np.diff(ends, axis=1)[:, 0], axis=1)
    cylinders = float((np.pi * radii**2 * lengths).sum())
    capped = cylinders + float((4 / 3 * np.pi * radii**3).sum())
    assert 0.85 * cylinders < volume(grid).value < capped


def test_a_tree_that_does_not_branch_is_a_bar():
    """Of round ends nothing is left: it is cut off flat in the root's plane and in the top's."""
    model = tree((2,), (0.5,), radius=0.2, level=0, controls=[*(2 * CONTROLS.T)])
    expected = np.pi * 0.2**2 * 2
    found = [volume(voxelize(model, voxels=n)).value for n in (40, 160)]
    assert found[1] == pytest.approx(expected, rel=2e-3)


def test_a_plate_covers_the_top():
    model = tree((2,), (0.5,), radius=0.1, level=2, plate=0.05)
    z = 1.0 + 0.02
    frame = Frame.fit(Box((0, 0, z), (1, 1, z + 0.001)), spacing=(0.07, 0.05, 0.001))
    assert model.sample(frame, CENTRE).all()
    bare = tree((2,), (0.5,), radius=0.1, level=2)
    assert not bare.sample(frame, CENTRE).all()
    assert model.smallest_feature() == pytest.approx(0.05)
    assert bare.smallest_feature() == pytest.approx(2 * 0.1 / 4)


TURNS = [np.eye(3), np.diag([1, 1, -1]), np.roll(np.eye(3), 1, axis=0)]


@pytest.mark.parametrize("turn", TURNS, ids=["upright", "hanging", "lying"])
@pytest.mark.parametrize(("plate", "offset"), [(None, 0.0), (None, 0.05), (0.1, 0.0), (0.1, 0.05)])
def test_it_is_cut_off_flat_where_it_stands_and_where_it_bears(turn, plate, offset):
    controls = turn @ (np.array([[2.0], [3.0], [4.0]]) * CONTROLS)
    model = tree((2,), (0.5,), radius=0.3, level=2, controls=controls.T, plate=plate, offset=offset)
    root, top = controls[:, APEX], controls[:, :APEX].mean(axis=1)
    axis = int(np.argmax(np.abs(top - root)))
    thick = (plate / 2 + offset) if plate else 0.0
    ends = sorted((root[axis], top[axis] + np.sign(top - root)[axis] * thick))
    assert (model.domain.lower[axis], model.domain.upper[axis]) == pytest.approx(ends)
    assert model.bulk == model.domain
    ends, reach = struts(model)
    assert reach.min() == pytest.approx(0.3 / 4 + offset)
    for other in {0, 1, 2} - {axis}:
        assert model.domain.lower[other] <= (ends[..., other].min(axis=1) - reach).min() + 1e-12
        assert model.domain.upper[other] >= (ends[..., other].max(axis=1) + reach).max() - 1e-12


@pytest.mark.parametrize("controls", [CONTROLS.T, CONTROLS.T + np.eye(5, 3, -2)])
def test_a_tree_of_any_level_lies_in_one_box(controls):
    boxes = {
        (m.domain.lower, m.domain.upper)
        for m in (tree(*SPEC, radius=0.1, level=k, controls=controls) for k in range(4))
    }
    assert len(boxes) == 1


def test_a_sloping_top_is_not_cut():
    controls = CONTROLS.T.copy()
    controls[0, 2] = 1.5
    model = tree((2,), (0.5,), radius=0.1, level=2, controls=controls)
    assert model.domain.lower[2] == pytest.approx(-0.1)
    assert model.domain.upper[2] > 1.5 - 1e-12


def test_a_domain_is_in_the_units_of_controls():
    half = Box((0, 0, 0), (1, 1, 0.5))
    model = tree((2,), (0.5,), radius=1.0, size=24.0, domain=half)
    assert model.domain.upper == model.bulk.upper == (24.0, 24.0, 12.0)


def test_levels_that_can_be_printed():
    model = tree(*SPEC, radius=1.2, size=20.0)
    assert model.finest_printable_level(2 * 1.2 / 6) == 2
    assert model.finest_printable_level(2 * 1.2 / 6 + 1e-6) == 1
    assert model.finest_printable_level(2.5) is None
    for level in range(3):
        least = tree(*SPEC, radius=1.2, size=20.0, level=level).smallest_feature()
        assert least == pytest.approx(2 * strut_radii(1.2, SPEC[0], "area")[level])


# --- what is refused -------------------------------------------------------------------------


def test_struts_too_thin_to_print_are_refused_with_the_numbers():
    with pytest.raises(ModelError) as caught:
        tree(*SPEC, size=24.0, radius=1.0, minimum_radius=0.15)
    text = str(caught.value)
    assert "struts of radius 0.08333 after 3 branchings" in text
    assert "minimum_radius is 0.15" in text
    assert "Wanted radius = 1.8 or more, or level = 2" in text
    tree(*SPEC, size=24.0, radius=1.8, minimum_radius=0.15)
    tree(*SPEC, size=24.0, radius=1.0, minimum_radius=0.15, level=2)
    tree(*SPEC, size=24.0, radius=1.0, minimum_radius=0.15, offset=0.07)
    tree(*SPEC, size=24.0, radius=1.0, minimum_radius=0.15, law="murray")
    with pytest.raises(ModelError, match=r"Wanted radius = 2 or more$"):
        tree(*SPEC, size=24.0, radius=1.0, minimum_radius=2.0, level=0)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"branches": ()}, r"branches: got \[\]; wanted whole numbers"),
        ({"branches": (3, 1)}, r"branches: got \[3, 1\]; wanted whole numbers"),
        ({"branches": (2.5,)}, r"branches: got \[2.5\]; wanted whole numbers"),
        ({"heights": (0.4, 1.0)}, r"heights: got \[0.4, 1.0\]; wanted parts of the way"),
        ({"heights": ()}, r"heights: got \[\]"),
        ({"radius": 0.0}, "radius: got 0.0; wanted a length above zero"),
        ({"law": "leonardo"}, "law: got 'leonardo'; wanted area or murray"),
        ({"level": -1}, "level: got -1; wanted 0 …"),
        ({"level": 33}, "level: got 33; wanted 0 … 32"),
        ({"minimum_radius": -1.0}, "minimum_radius: got -1.0; wanted zero or a length"),
        ({"plate": 0.0}, "thickness: got"),
        ({"radius": 0.41}, "radius: got 0.41, of a first trunk 0.4 long; wanted that at most"),
        ({"radius": 11.0, "size": 24.0}, "radius: got 11, of a first trunk 9.6 long; wanted"),
        ({"radius": 1e9}, r"radius: got 1e\+09, of a first trunk 0.4 long; wanted"),
        ({"plate": 1.0}, "plate: got 1, on a tree 1 from the root to the top; wanted less"),
        ({"plate": 1e9, "size": 24.0}, r"plate: got 1e\+09, on a tree 24 from the root"),
        ({"controls": np.eye(3)}, r"controls: got shape \(3, 3\); wanted \(5, 3\)"),
        ({"controls": np.ones((5, 3))}, "controls: 0 and 1 coincide"),
    ],
)
def test_what_cannot_be_is_refused(changed, said):
    given = {"branches": (2,), "heights": (0.4,), "radius": 0.1} | changed
    with pytest.raises(ModelError, match=said):
        tree(**given)


def test_a_pyramid_is_no_cell_to_fill():
    with pytest.raises(ModelError, match="state tree are of shape pyramid"):
        bcifs(tree_cells((2,), (0.4,)), level=1)


# --- recipes ---------------------------------------------------------------------------------

MODEL = {
    "kind": "tree",
    "branches": [3, 2],
    "heights": [0.35, 0.45],
    "radius": 1.0,
    "size": 20.0,
    "unit": "mm",
    "plate": 0.5,
}


def test_a_recipe_says_the_same_tree():
    recipe = parse({"format": 1, "model": MODEL})
    again = parse({"format": 1, "model": MODEL | {"level": 3, "law": "area"}})
    assert dump(recipe) == dump(again)
    model = build(recipe.model, None)
    assert model == tree(*SPEC, radius=1.0, size=20.0, plate=0.5)
    one = parse({"format": 1, "model": MODEL | {"branches": 2, "heights": 0.5}})
    assert (one.model.branches, one.model.heights) == ((2,), (0.5,))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("branches", [1]),
        ("heights", [1.5]),
        ("radius", 0),
        ("law", "leonardo"),
        ("level", "limit"),
        ("twigs", 3),
    ],
)
def test_a_recipe_that_says_no_tree_is_refused(key, value):
    with pytest.raises(RecipeError, match=f"model.*{key}"):
        parse({"format": 1, "model": MODEL | {key: value}})


@pytest.mark.judge
@pytest.mark.slow
def test_the_deck_of_the_tree_on_the_page_runs(judge, tmp_path):
    page = Path(__file__).parent.parent / "docs" / "support-tree.md"
    text = page.read_text(encoding="utf-8").split("```toml tree.toml\n")[1].split("```")[0]
    (tmp_path / "tree.toml").write_text(text, encoding="utf-8")
    coarser = ["--set", "voxels.voxels=48"]  # test_readme runs it as it stands
    assert main(["make", str(tmp_path / "tree.toml"), "-o", str(tmp_path / "made"), *coarser]) == 0
    deck = (tmp_path / "made" / "hexes.inp").read_bytes()
    assert b"*STEP" in deck
    solved = ccx.solve([deck], program=judge("ccx"))
    assert solved.reaction[2] == pytest.approx(24.6**2, rel=0.02)
