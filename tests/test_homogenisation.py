"""Effective properties of periodic cells from our own decks: closed forms, limits, references."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import systems
from naive_boundary import prefractal

from porous import load, make
from porous.errors import MeshError
from porous.formats import inp, read, write
from porous.guests import ccx
from porous.jobs import prepare, results, sections
from porous.jobs._homogenisation import PAIRS, STRAINS
from porous.stages import hexahedralize, name_parts, quadratic
from porous.values import Frame, Material, Part, VoxelGrid
from porous.values.ties import ties

SPACING = (0.5, 0.25, 1.0)


def periodic(solid, spacing=SPACING, unit="mm"):
    frame = Frame((0, 0, 0), spacing, solid.shape, periodic=(True,) * 3, unit=unit)
    return name_parts(hexahedralize(VoxelGrid.of_solid(solid, frame)), frame.box)


def job_of(mesh, materials=None, **options):
    """Return a job of homogenisation; materials by part stand in for those of the presets."""
    names = {"material": "steel"} | ({"pore_material": "copper"} if "PORE" in mesh.parts else {})
    made = prepare(mesh, sections()["homogenisation"](**names, **options))
    return replace(made, materials=materials) if materials else made


def solved(job, program):
    solution = ccx.solve(inp.write(job), program=program)
    return results(job, solution.steps), solution


def tensor(measures):
    stiffness = np.zeros((6, 6))
    for i, j in itertools.combinations_with_replacement(range(6), 2):
        stiffness[i, j] = stiffness[j, i] = measures[f"effective_stiffness_{i + 1}{j + 1}"].value
    return stiffness


def isotropic(E, nu):
    lame, shear = E * nu / (1 + nu) / (1 - 2 * nu), E / 2 / (1 + nu)
    stiffness = np.diag([2 * shear] * 3 + [shear] * 3)
    stiffness[:3, :3] += lame
    return stiffness


def laminate(shares, layers):
    """Return the stiffness of layers normal to z (Backus 1962), each of E and ν."""
    lame = np.array([E * nu / (1 + nu) / (1 - 2 * nu) for E, nu in layers])
    shear = np.array([E / 2 / (1 + nu) for E, nu in layers])
    M = lame + 2 * shear
    mean = lambda values: np.dot(shares, values)  # noqa: E731
    C33, C44, C66 = 1 / mean(1 / M), 1 / mean(1 / shear), mean(shear)
    C13 = C33 * mean(lame / M)
    C11 = mean(M - lame**2 / M) + C13**2 / C33
    stiffness = np.diag([C11, C11, C33, C44, C44, C66])
    stiffness[0, 1] = stiffness[1, 0] = C11 - 2 * C66
    stiffness[:2, 2] = stiffness[2, :2] = C13
    return stiffness


# ------------------------------------------------------------------ ties


def test_every_node_is_tied_straight_to_one_root():
    mesh = periodic(np.ones((2, 3, 4), dtype=bool))
    tied = ties(mesh, PAIRS)
    assert len(np.unique(tied.root)) == 2 * 3 * 4
    assert np.array_equal(tied.root[tied.root], tied.root)
    apart = mesh.points - mesh.points[tied.root]
    assert np.allclose(apart, tied.offset @ tied.periods)
    assert np.allclose(tied.periods, np.diag([1.0, 0.75, 4.0]))
    for part in range(3):
        upper = np.flatnonzero(mesh.points[:, part] > tied.periods[part, part] - 1e-9)
        assert np.array_equal(tied.far(part), upper)


def test_pairs_that_lead_from_a_node_to_itself_are_refused():
    mesh = periodic(np.ones((2, 2, 2), dtype=bool))
    pairs = mesh.parts["XPAIRS"].members
    wrong = {**mesh.parts, "XPAIRS": Part("pairs", np.vstack([pairs, pairs[:1, ::-1]]))}
    with pytest.raises(MeshError, match="pairs lead from a node to itself"):
        ties(replace(mesh, parts=wrong), PAIRS)


def test_no_dependent_node_is_used_twice():
    deck = b"".join(inp.write(job_of(periodic(np.ones((3, 2, 2), dtype=bool))))).decode()
    equations = deck[deck.index("*EQUATION") :]
    equations = equations[: equations.index("\n*M")].splitlines()[1:]
    seen, index = [], 0
    while index < len(equations):
        if equations[index].startswith("**"):
            index += 1
            continue
        count, text = int(equations[index]), ""
        while text.count(",") + 1 < 3 * count:
            index += 1
            text += equations[index]
        terms = np.array([float(word) for word in text.split(",")]).reshape(-1, 3)
        assert len(terms) == count
        seen.append(terms)
        index += 1
    dependent = [tuple(terms[0, :2]) for terms in seen]
    others = {tuple(term[:2]) for terms in seen for term in terms[1:]}
    assert len(set(dependent)) == len(dependent) == 3 * (4 * 3 * 3 - 12)
    assert not others & set(dependent)
    assert all(abs(terms[:2, 2].sum()) == 0 and terms[0, 2] == 1 for terms in seen)


# ------------------------------------------------------------------ exact


@pytest.mark.judge
def test_a_block_is_as_stiff_as_what_it_is_made_of(judge):
    steel = Material("steel", 210e3, 0.3)
    job = job_of(periodic(np.ones((3, 2, 2), dtype=bool), unit="cm"), {"SOLID": steel})
    found, solution = solved(job, judge("ccx"))
    assert tensor(found) == pytest.approx(isotropic(210e3, 0.3), rel=1e-6, abs=1e-6 * 210e3)
    for axis in "xyz":
        assert found[f"effective_youngs_modulus_{axis}"].value == pytest.approx(210e3, rel=1e-6)
    # Energies say the same as forces.
    energies = [step["internal energy", "SOLID"][0] for step in solution.steps]
    volume = 15 * 5 * 20
    assert energies == pytest.approx(np.diag(isotropic(210e3, 0.3)) * volume * 1e3 / 2000, rel=1e-6)


@pytest.mark.judge
def test_pairs_in_any_order_are_the_same_cell(judge):
    mesh = periodic(np.ones((3, 2, 2), dtype=bool))
    turned = Part("pairs", mesh.parts["XPAIRS"].members[::-1])
    bare = replace(mesh, parts={**mesh.parts, "XPAIRS": turned})
    assert b"*NSET, NSET=XPAIRS_SECOND, UNSORTED\n" in b"".join(inp.write(bare))
    made = {"SOLID": Material("one", 1.0, 0.3)}
    found, solution = solved(job_of(bare, made), judge("ccx"))
    assert tensor(found) == pytest.approx(isotropic(1.0, 0.3), rel=1e-6, abs=1e-6)
    assert "WARNING" not in solution.log


@pytest.mark.judge
def test_quadratic_elements_are_tied_in_the_middle_of_edges_too(judge):
    # Layers normal to x; were the nodes between not tied, it would be softer.
    mesh = quadratic(periodic(np.ones((4, 1, 2), dtype=bool), (1.0, 2.0, 0.5)))
    layer = np.arange(8) < 4
    layers = {"SOLID": Part("cells", np.flatnonzero(layer)), "PORE": Part("cells", np.arange(4, 8))}
    made = {"SOLID": Material("hard", 5.0, 0.2), "PORE": Material("soft", 1.0, 0.3)}
    found, _ = solved(job_of(replace(mesh, parts={**mesh.parts, **layers}), made), judge("ccx"))
    exact = laminate([0.5, 0.5], [(5.0, 0.2), (1.0, 0.3)])
    turned = [2, 1, 0, 5, 4, 3]  # from z to x: xx and zz, yz and xy change places
    exact = exact[np.ix_(turned, turned)]
    assert tensor(found) == pytest.approx(exact, rel=1e-6, abs=1e-6)


@pytest.mark.judge
def test_the_deck_of_a_periodic_recipe_runs_as_written(judge, tmp_path):
    told = {
        "model.level": 1,
        "voxels.voxels": 6,
        "voxels.periodic": [True] * 3,
        "simulation.analysis": "homogenisation",
        "simulation.symmetry": "cubic",
    }
    result = make(load("menger", set=told), tmp_path / "out", only="simulation")
    solution = ccx.solve((tmp_path / "out" / "hexes.inp").read_bytes(), program=judge("ccx"))
    found = results(result.job, solution.steps)
    coarse = menger(2, judge("ccx"))  # of E = 1
    for name in ("effective_stiffness_11", "effective_stiffness_44"):
        assert found[name].value == pytest.approx(210e3 * coarse[name].value, rel=1e-6)


@pytest.mark.judge
@pytest.mark.parametrize("units", ["mm-N-MPa", "m-SI"])
def test_a_laminate_is_as_its_closed_form_says(judge, units):
    made = {"SOLID": Material("hard", 210e3, 0.3, conductivity=50.0)}
    made["PORE"] = Material("soft", 3e3, 0.4, conductivity=0.2)
    mesh = periodic(np.ones((3, 2, 4), dtype=bool))
    low = np.add.reduce(mesh.points[mesh.blocks[0].cells, 2], axis=1) / 8 < 1.0
    layers = {
        "SOLID": Part("cells", np.flatnonzero(low)),
        "PORE": Part("cells", np.flatnonzero(~low)),
    }
    mesh = replace(mesh, parts={**mesh.parts, **layers})
    shares = np.array([0.25, 0.75])
    found, _ = solved(job_of(mesh, made, units=units), judge("ccx"))
    exact = laminate(shares, [(210e3, 0.3), (3e3, 0.4)])
    assert tensor(found) == pytest.approx(exact, rel=1e-6, abs=1e-6 * exact[0, 0])
    heat, _ = solved(job_of(mesh, made, units=units, property="conductivity"), judge("ccx"))
    along, across = shares @ [50.0, 0.2], 1 / (shares @ [1 / 50.0, 1 / 0.2])
    for axis, wanted in zip("xyz", (along, along, across), strict=True):
        assert heat[f"effective_conductivity_{axis}"].value == pytest.approx(wanted, rel=1e-6)
    for pair in ("yz", "xz", "xy"):
        assert heat[f"effective_conductivity_{pair}"].value == pytest.approx(0, abs=1e-6)


@pytest.mark.judge
def test_a_sheared_cell_is_as_stiff_as_its_axes_say(judge):
    """Layers that lean: a cell whose conductivity has off-diagonal terms and is known exactly."""
    solid = np.ones((4, 2, 2), dtype=bool)
    mesh = periodic(solid, (1.0, 1.0, 1.0))
    shear = np.array([[1, 0, 0], [0, 1, 0], [0.5, 0, 1]])  # x moves with z
    mesh = replace(mesh, points=mesh.points @ shear)
    low = mesh.blocks[0].cells.min(axis=1) < np.median(mesh.blocks[0].cells.min(axis=1))
    layers = {
        "SOLID": Part("cells", np.flatnonzero(low)),
        "PORE": Part("cells", np.flatnonzero(~low)),
    }
    mesh = replace(mesh, parts={**mesh.parts, **layers})
    made = {"SOLID": Material("a", conductivity=3.0), "PORE": Material("b", conductivity=1.0)}
    heat, _ = solved(job_of(mesh, made, property="conductivity"), judge("ccx"))
    normal = np.array([1, 0, -0.5]) / np.hypot(1, 0.5)  # of planes that hold y and (½, 0, 1)
    exact = 2.0 * np.eye(3) + (1 / (0.5 / 3 + 0.5) - 2.0) * np.outer(normal, normal)
    for name, (i, j) in {"x": (0, 0), "y": (1, 1), "z": (2, 2), "xz": (0, 2)}.items():
        assert heat[f"effective_conductivity_{name}"].value == pytest.approx(exact[i, j], rel=1e-6)


# ------------------------------------------------------------------ what does not hold together


def bars():
    """Return three bars that pass each other, and a voxel that touches one of them in an edge."""
    solid = np.zeros((5, 5, 5), dtype=bool)
    solid[:, 0, 0] = solid[2, :, 2] = solid[4, 2, :] = True
    solid[2, 4, 4] = True
    return periodic(solid, (1.0, 2.0, 4.0))


def test_bars_that_may_turn_have_no_step_and_why():
    job = job_of(bars())
    assert not job.steps
    assert "in one direction only" in job.why_no_step


@pytest.mark.judge
def test_bars_that_do_not_touch_lead_heat_each_by_itself(judge):
    made = {"SOLID": Material("one", conductivity=1.0)}
    job = job_of(bars(), made, property="conductivity")
    assert job.mesh.cells == 15
    assert len(job.mesh.parts["PINNED"].members) == 3
    assert "1 bodies of 1 cells left out" in job.note
    heat, _ = solved(job, judge("ccx"))
    for axis in "xyz":
        assert heat[f"effective_conductivity_{axis}"].value == pytest.approx(1 / 25, rel=1e-6)


def test_an_island_is_no_material():
    solid = np.zeros((4, 4, 4), dtype=bool)
    solid[0, 0, :] = solid[0, :, 0] = solid[:, 0, 0] = True  # a jungle gym
    solid[2, 2, 2] = True
    job = job_of(periodic(solid))
    assert job.mesh.cells == 10
    assert "left out" in job.note
    assert len(job.steps) == 6


def test_bodies_that_wind_around_the_cell_are_told_by_all_their_ways():
    # A stair along (1, 1, 0) passes two sides and yet goes on in one direction only.
    solid = np.zeros((4, 4, 2), dtype=bool)
    for i in range(4):
        solid[i, i] = solid[i, (i + 1) % 4] = True
    mesh = periodic(solid)
    assert len(job_of(mesh).steps) == 6  # it goes on along z too
    solid[:, :, 1] = False
    solid[1, 2, 1] = False
    flat = periodic(solid)
    made = {**flat.parts, "ZPAIRS": flat.parts["XPAIRS"]}
    with pytest.raises(MeshError, match="pairs lead"):  # pairs of two names contradict each other
        job_of(replace(flat, parts=made), property="conductivity")
    bare = {name: part for name, part in flat.parts.items() if name != "ZPAIRS"}
    with pytest.raises(MeshError, match=r"no pairs of nodes ZPAIRS.*voxels\.periodic"):
        job_of(replace(flat, parts=bare))


def apart(name):
    """Return voxels of a 4×4×4 cell that do not go on along every axis, and along which they do."""
    solid = np.zeros((4, 4, 4), dtype=bool)
    if name == "rods":
        solid[1:3, 1] = True
        return solid, "z", 1 / 8
    if name == "plates":
        solid[1:3] = True
        return solid, "yz", 1 / 2
    solid[1:3, 1:3, 1:3] = True
    return solid, "", 0.0


@pytest.mark.judge
@pytest.mark.parametrize("units", ["mm-N-MPa", "m-SI"])
@pytest.mark.parametrize("name", ["rods", "plates"])
def test_heat_flows_along_what_goes_on_and_not_across(judge, tmp_path, name, units):
    solid, along, share = apart(name)
    solid[0, 3, 1] = solid[3, 3, 1] = name == "rods"  # an island across the border
    # Through a file, and of a mesh of both phases, whose pores are empty.
    grid = VoxelGrid.of_solid(solid, Frame((1, 2, 3), SPACING, solid.shape, periodic=(True,) * 3))
    made = {"SOLID": Material("one", conductivity=3.0)}
    for phase in ("solid", "both"):
        mesh = name_parts(hexahedralize(grid, phase=phase), grid.frame.box)
        write(mesh, tmp_path / "a.vtu")
        assert read(tmp_path / "a.vtu") == mesh
        section = sections()["homogenisation"](property="conductivity", units=units)
        job = replace(prepare(read(tmp_path / "a.vtu"), section), materials=made)
        assert job.mesh.cells == share * solid.size
        assert job.tied == tuple(f"{axis.upper()}PAIRS" for axis in along)
        assert f"goes on along {' and '.join(a for a in 'xyz' if a not in along)}" in job.note
        totals = ccx.solve(inp.write(job), program=judge("ccx")).steps
        found = results(job, totals, box=grid.frame.box)
        for axis in "xyz":
            exact = 3 * share if axis in along else 0
            value = found[f"effective_conductivity_{axis}"].value
            assert value == pytest.approx(exact, rel=1e-6, abs=1e-9)
        for pair in ("yz", "xz", "xy"):
            assert found[f"effective_conductivity_{pair}"].value == pytest.approx(0, abs=1e-6)
        with pytest.raises(MeshError, match="wanted the box of the cell too"):
            results(job, totals)


@pytest.mark.judge
@pytest.mark.parametrize("layers", [(1, 2), (0, 3), (2, 3)])
def test_loose_plates_are_sheets_in_plane_stress_wherever_the_cell_is_cut(judge, layers):
    solid = np.zeros((4, 2, 3), dtype=bool)
    solid[list(layers)] = True
    box = Frame((0, 0, 0), SPACING, solid.shape).box
    job = job_of(periodic(solid), {"SOLID": Material("one", 4.0, 0.3)})
    assert ("no body goes on along x" in job.note) == (layers != (0, 3))
    totals = ccx.solve(inp.write(job), program=judge("ccx")).steps
    found = tensor(results(job, totals, box=box))
    exact = np.zeros((6, 6))
    exact[1:3, 1:3] = 4 / (1 - 0.09) / 2 * np.array([[1, 0.3], [0.3, 1]])
    exact[3, 3] = 4 / 2.6 / 2
    assert found == pytest.approx(exact, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("order", [1, 2])
def test_what_goes_on_along_one_axis_or_none_is_not_stiff_and_why(order):
    for name, words in {
        "rods": "a body goes on in one direction only",
        "island": "no body goes on across faces",
    }.items():
        mesh = periodic(apart(name)[0])
        job = job_of(quadratic(mesh) if order == 2 else mesh)
        assert not job.steps
        assert words in job.why_no_step
    island = job_of(periodic(apart("island")[0]), property="conductivity")
    assert "no body goes on across faces" in island.why_no_step
    with pytest.raises(MeshError, match=r'nothing goes on along some of the axes; .*"none"'):
        job_of(periodic(apart("rods")[0]), property="conductivity", symmetry="cubic")


def test_totals_that_are_missing_are_told():
    job = job_of(periodic(np.ones((2, 2, 2), dtype=bool)))
    with pytest.raises(MeshError, match="0 steps; wanted 6"):
        results(job, [])
    with pytest.raises(MeshError, match="'strain-xx' has no total"):
        results(job, [{}] * 6)


# ------------------------------------------------------------------ Menger's sponge


def limits(values):
    """Return what three values on meshes of edges 4 : 2 : 1 tend to, and their order."""
    coarse, middle, fine = np.asarray(values)
    ratio = (coarse - middle) / (middle - fine)
    return fine + (fine - middle) / (ratio - 1), np.log2(ratio)


def menger(fine, program, **options):
    solid = np.kron(prefractal(3, systems.MENGER, 1), np.ones((fine,) * 3, dtype=bool))
    made = {"SOLID": Material("unit", 1.0, 0.3, conductivity=1.0)}
    mesh = periodic(solid, (1 / (3 * fine),) * 3)
    return solved(job_of(mesh, made, symmetry="cubic", **options), program)[0]


@pytest.mark.judge
@pytest.mark.slow
def test_menger_is_as_stiff_as_the_reference(judge):
    names = ["effective_stiffness_11", "effective_youngs_modulus_x", "effective_stiffness_44"]
    solved_ = [menger(n, judge("ccx")) for n in (2, 4, 8)]
    values = [[measures[name].value for name in names] for measures in solved_]
    limit, order = limits(values)
    assert limit[0] == pytest.approx(0.625, abs=0.005)
    assert limit[1] == pytest.approx(0.549, abs=0.004)
    assert limit[2] == pytest.approx(0.158, abs=0.002)
    # Edges of angle 3π/2 make the solution rough: energies converge with an order below two.
    assert (order > 1).all()
    assert (order < 1.5).all()
    # Displacements that fit together are too stiff.
    assert (np.diff(values, axis=0) < 0).all()
    assert (limit < values[-1]).all()


@pytest.mark.judge
@pytest.mark.slow
def test_menger_leads_heat_as_the_reference(judge):
    values = [
        menger(n, judge("ccx"), property="conductivity")["effective_conductivity_x"].value
        for n in (2, 4, 8)
    ]
    limit, order = limits(values)
    assert limit == pytest.approx(0.5866, abs=0.002)
    assert 1 < order < 1.5
    assert values[0] > values[1] > values[2] > limit


@pytest.mark.judge
def test_symmetry_says_what_all_cases_say(judge):
    cubic = menger(2, judge("ccx"))
    solid = np.kron(prefractal(3, systems.MENGER, 1), np.ones((2, 2, 2), dtype=bool))
    made = {"SOLID": Material("unit", 1.0, 0.3)}
    every, _ = solved(job_of(periodic(solid, (1 / 6,) * 3), made), judge("ccx"))
    assert tensor(cubic) == pytest.approx(tensor(every), rel=1e-6, abs=1e-6)
    assert np.isnan(every["effective_stiffness_11"].uncertainty)
    assert "discretisation not included" in every["effective_stiffness_11"].method


CUBE = (0.5, 0.5, 0.5)


@pytest.mark.parametrize("found", ["stiffness", "conductivity"])
@pytest.mark.parametrize(
    ("shape", "spacing", "words"),
    [
        ((2, 2, 2), SPACING, "the cell is 1 × 0.5 × 2 mm, no cube"),
        ((2, 2, 4), CUBE, "the cell is 1 × 1 × 2 mm, no cube"),
        ((2, 2, 4), (0.5, 0.5, 0.25), "not the same along x, y and z: 16 of 16 elements"),
    ],
)
def test_a_cell_that_is_no_cube_is_not_taken_for_one(shape, spacing, words, found):
    mesh = periodic(np.ones(shape, dtype=bool), spacing)
    with pytest.raises(MeshError, match=words) as caught:
        job_of(mesh, symmetry="cubic", property=found)
    assert 'wanted simulation.symmetry = "none"' in str(caught.value)
    assert job_of(mesh, property=found).steps


def test_a_carpet_is_no_cube_and_neither_are_layers():
    carpet = np.ones((3, 3, 3), dtype=bool)
    carpet[1, 1] = False
    with pytest.raises(MeshError, match="not the same along x, y and z: 2 of 24"):
        job_of(periodic(carpet, CUBE), symmetry="cubic", property="conductivity")
    mesh = periodic(np.ones((2, 2, 2), dtype=bool), CUBE)
    layers = {"SOLID": Part("cells", np.arange(4)), "PORE": Part("cells", np.arange(4, 8))}
    with pytest.raises(MeshError, match="not the same along x, y and z: 4 of 8"):
        job_of(replace(mesh, parts={**mesh.parts, **layers}), symmetry="cubic")


@pytest.mark.judge
def test_what_turns_about_its_diagonal_only_is_told_by_its_stresses(judge):
    any_ = np.random.default_rng(3).random((4, 4, 4))
    turned = sum(np.transpose(any_, order) for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1)))
    solid = turned < 1.7
    made = {"SOLID": Material("one", 1.0, 0.3)}
    job = job_of(periodic(solid, CUBE), made, symmetry="cubic")
    with pytest.raises(MeshError, match=r'differ by .* % of the greatest; wanted .*"none"'):
        solved(job, judge("ccx"))


def test_load_cases_are_in_voigts_order():
    job = job_of(periodic(np.ones((2, 2, 2), dtype=bool)))
    assert [step.name for step in job.steps] == [f"strain-{name}" for name in STRAINS]
    for step, (i, j) in zip(job.steps, STRAINS.values(), strict=True):
        strain = np.reshape(step.gradient, (3, 3))
        assert np.array_equal(strain, strain.T)
        assert strain[i, j] == (1.0 if i == j else 0.5)
        assert strain.sum() == 1
