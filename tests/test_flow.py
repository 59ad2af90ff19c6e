"""Flow and diffusion through pores: exact solutions, other discretisations, and what goes wrong."""

import math
import stat

import naive_boundary as naive
import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spla
import systems

from porous import formats
from porous.errors import GuestError, MeshError, PorousError
from porous.formats import foam
from porous.guests import openfoam
from porous.jobs import (
    diffusion,
    effective_diffusivity,
    flow,
    material,
    permeability,
    prepare,
    sections,
)
from porous.stages import hexahedralize, name_parts
from porous.values import Frame, Held, Job, Material, Step, VoxelGrid

WATER, OXYGEN = material("water"), material("oxygen-in-water")
PLAIN = Material("plain", conductivity=1.0, diffusivity=1.0)


def mesh_of(solid, spacing, *, unit="mm", phase="pore"):
    """Return hexahedra with their parts, and their box."""
    frame = Frame((-1, 0, 2), spacing, solid.shape, unit=unit)
    mesh = hexahedralize(VoxelGrid.of_solid(solid, frame), phase=phase)
    return name_parts(mesh, frame.box), frame.box


def menger(level, per=1):
    return np.kron(naive.prefractal(3, systems.MENGER, level), np.ones((per,) * 3, bool))


def solved(job, **more):
    return openfoam.solve(foam.write_files(job, "a.foam"), **more)


def permeable(job, box):
    solution = solved(job)
    return {
        row.name: row.value for row in permeability(job, solution.rates, solution.pressures, box)
    }


def duct(a, b):
    """Return the exact permeability of a duct of a by b, a ≤ b: White, Viscous Fluid Flow, 3-48."""
    odd = np.arange(1, 400, 2)
    series = (np.tanh(odd * np.pi * b / (2 * a)) / odd**5).sum()
    return a**2 / 12 * (1 - 192 * a / (np.pi**5 * b) * series)


@pytest.fixture
def simple(judge):
    """Need simpleFoam."""
    return judge("simpleFoam")


with_simple = pytest.mark.usefixtures("simple")


# --- flow ----------------------------------------------------------------------------------------


@pytest.mark.slow
@with_simple
def test_the_mean_velocity_in_a_square_duct_is_exact():
    found = {}
    for count in (12, 24):
        empty = np.zeros((4, count, count), bool)
        mesh, box = mesh_of(empty, (0.3, 1 / count, 1 / count))
        job = flow(mesh, fluid=WATER, pressure_drop=1e-3)
        found[count] = permeable(job, box)["superficial_velocity_x"]
    exact = duct(1, 1) * 1e-9 / (WATER.viscosity * 1.2)
    assert found[24] == pytest.approx(exact, rel=0.02)
    # Second order: four times nearer, and nothing left of the error once it is taken off.
    assert (found[12] / exact - 1) / (found[24] / exact - 1) == pytest.approx(4, abs=0.1)
    assert (4 * found[24] - found[12]) / 3 == pytest.approx(exact, rel=5e-4)


@pytest.mark.slow
@with_simple
@pytest.mark.parametrize(("axis", "unit"), [("x", "um"), ("y", "cm"), ("z", "nm")])
def test_every_axis_and_unit_gives_the_same_permeability(axis, unit):
    # A duct of 1 by 1.5, coarse: its error is that of the mesh, the same along every axis.
    shape, spacing = (3, 8, 12), (0.7, 1 / 8, 1.5 / 12)
    turn = np.roll(np.arange(3), "xyz".index(axis))
    empty = np.zeros([shape[i] for i in turn], bool)
    mesh, box = mesh_of(empty, tuple(spacing[i] for i in turn), unit=unit)
    found = permeable(flow(mesh, fluid=WATER, axis=axis), box)
    area = {"um": 1e-6, "cm": 1e2, "nm": 1e-12}[unit]
    assert found[f"permeability_{axis}"] == pytest.approx(0.0510794510 * area, rel=1e-6)
    assert found[f"permeability_{axis}"] == pytest.approx(duct(1, 1.5) * area, rel=0.05)
    darcy = found[f"permeability_{axis}"] * 1e-6 / 9.869233e-13
    assert found[f"permeability_{axis}_in_darcy"] == pytest.approx(darcy)
    assert found["reynolds_number"] == pytest.approx(0.0114, rel=0.02)


@pytest.mark.slow
@with_simple
def test_between_plates_the_fluid_slips_along_the_other_sides():
    # Two plates at the sides of z, of voxels, 0.8 mm apart in a box of 1.2 mm: k = h³ / (12 H).
    solid = np.zeros((3, 2, 24), bool)
    solid[:, :, :4] = solid[:, :, -4:] = True
    mesh, box = mesh_of(solid, (0.3, 0.5, 0.05))
    found = permeable(flow(mesh, fluid=WATER, slip=True), box)
    # Sixteen cells across: the balance over cells gives 1 + 2/n² times the exact value.
    exact = 0.8**3 / (12 * 1.2)
    assert found["permeability_x"] == pytest.approx(exact * (1 + 2 / 16**2), rel=1e-5)
    # A tube of the same hydraulic diameter 2h would carry half as much again.
    assert found["reynolds_number"] == pytest.approx(0.01 * 2 / 3 * (1 + 2 / 16**2), rel=1e-5)


@pytest.mark.slow
@with_simple
def test_a_velocity_that_is_given_is_the_one_that_comes_out():
    mesh, box = mesh_of(np.zeros((4, 6, 5), bool), (0.5, 0.2, 0.3))
    job = flow(mesh, fluid=WATER, velocity=0.02)
    solution = solved(job)
    assert solution.rates["XMAX"] == pytest.approx(0.02e-3 * 1.2 * 1.5 * 1e-6, rel=1e-6)
    assert solution.rates["XMIN"] == pytest.approx(-solution.rates["XMAX"], rel=1e-6)
    assert solution.pressures["XMIN"] > solution.pressures["XMAX"] == 0
    found = permeability(job, solution.rates, solution.pressures, box)
    assert found["superficial_velocity_x"].value == pytest.approx(0.02)
    developed = permeable(flow(mesh, fluid=WATER), box)["permeability_x"]
    assert found["permeability_x"].value == pytest.approx(developed, rel=0.1)


@pytest.mark.slow
@with_simple
def test_slow_flow_through_a_sponge_is_linear_in_the_pressure():
    mesh, box = mesh_of(menger(2), (0.2, 0.3, 0.25))
    once, ten = (
        permeable(flow(mesh, fluid=WATER, pressure_drop=drop), box) for drop in (1e-4, 1e-3)
    )
    assert ten["permeability_x"] == pytest.approx(once["permeability_x"], rel=1e-4)
    assert ten["reynolds_number"] == pytest.approx(10 * once["reynolds_number"], rel=1e-4)
    assert once["reynolds_number"] < 0.1


# --- diffusion and conduction --------------------------------------------------------------------


def test_diffusion_in_parallel_slabs_is_exact(judge):
    judge("laplacianFoam")
    # Two slabs of pore that lead through, three voxels of seven; a dead end and a closed pore.
    solid = np.ones((5, 7, 3), bool)
    solid[:, 1] = solid[:, 3:5] = False
    solid[:2, 6, 0] = solid[3, 6, 2] = False
    mesh, box = mesh_of(solid, (1.0, 0.5, 2.0), unit="um")
    job = diffusion(mesh, material=OXYGEN, concentrations=(3.0, 1.0))
    assert job.note == "pores left out, for they do not lead through: 2, of 3 cells"
    found = effective_diffusivity(job, solved(job).rates, box)
    values = {row.name: row.value for row in found}
    assert values["through_porosity"] == pytest.approx(3 / 7)
    assert values["effective_diffusivity_x"] == pytest.approx(2.1e-3 * 3 / 7, rel=1e-8)
    assert values["tortuosity_factor_x"] == pytest.approx(1.0, rel=1e-8)
    again = effective_diffusivity(job, solved(job).rates, box, porosity=0.5)
    assert again["tortuosity_factor_x"].value == pytest.approx(0.5 / (3 / 7), rel=1e-8)


def finite_elements(mesh, edge):
    """Return the energy of trilinear cubes with u = 1 on XMIN and 0 on XMAX."""
    slope, mass = np.array([[1, -1], [-1, 1]]), np.array([[2, 1], [1, 2]]) / 6
    kinds = [(slope, mass, mass), (mass, slope, mass), (mass, mass, slope)]
    stiffness = edge * sum(np.kron(np.kron(x, y), z) for x, y, z in kinds)
    cells = mesh.blocks[0].cells[:, [0, 4, 3, 7, 1, 5, 2, 6]]
    rows, columns = np.repeat(cells, 8, axis=1).ravel(), np.tile(cells, (1, 8)).ravel()
    matrix = sp.csr_matrix((np.tile(stiffness.ravel(), len(cells)), (rows, columns)))
    u = np.zeros(len(mesh.points))
    u[mesh.parts["XMIN"].members] = 1
    free = np.ones(len(u), bool)
    free[mesh.parts["XMIN"].members] = free[mesh.parts["XMAX"].members] = False
    inner = matrix[free][:, free]
    jacobi = spla.LinearOperator(inner.shape, lambda v: v / inner.diagonal())
    u[free], fault = spla.cg(inner, -(matrix @ u)[free], rtol=1e-10, M=jacobi)
    assert fault == 0
    return u @ (matrix @ u)


@pytest.mark.slow
def test_heat_through_menger_is_that_of_finite_elements(judge):
    judge("laplacianFoam")
    # Along edges of 270° the field goes as r^(2/3), so both energies converge as h^(4/3).
    ends = {}
    for per in (2, 4):
        edge = 1 / (9 * per)
        mesh, _ = mesh_of(menger(2, per), (edge,) * 3, phase="solid")
        held = (Held("XMIN", "temperature", 1.0), Held("XMAX", "temperature"))
        job = Job("heat", mesh, {"SOLID": PLAIN}, (Step("heat", "conduction", held),))
        # The energy is the heat that leaves, for u is 1 and 0 on the sides; W/(m·K) over mm.
        ends[per] = np.array([finite_elements(mesh, edge), solved(job).rates["XMAX"] * 1e3])
    order = 4 / 3
    elements, volumes = (2**order * ends[4] - ends[2]) / (2**order - 1)
    assert volumes == pytest.approx(elements, rel=0.01)
    assert elements == pytest.approx(0.3586, rel=0.002)


# --- jobs ----------------------------------------------------------------------------------------


def test_a_recipe_asks_for_flow_and_diffusion():
    mesh, _ = mesh_of(menger(1, 2), (0.2, 0.3, 0.25), phase="both")
    for name, procedure in (("flow", "flow"), ("diffusion", "diffusion")):
        section = sections()[name](analysis=name, axis="y")
        assert (section.PHASE, section.suffixes) == ("pore", ("foam",))
        job = prepare(mesh, section)
        assert job.mesh.cells == 7 * 8
        assert set(job.materials) == {"PORE"}
        assert job.steps[0].procedure == procedure
        assert [held.part for held in job.steps[0].held] == ["YMIN", "YMAX"]
    assert "Reynolds number about 0.01" in prepare(mesh, sections()["flow"](analysis="flow")).title


@pytest.mark.parametrize("sides", ["walls", "slip"])
@pytest.mark.parametrize("name", ["flow", "diffusion"])
def test_pores_of_a_mesh_of_both_phases_have_the_walls_of_pores_alone(name, sides):
    # A pore that leads through, a closed one, and one at a side; lying in the side too.
    solid = np.ones((4, 5, 3), bool)
    solid[:, 1, 1] = solid[2, 3, 1] = False
    solid[:, 0, 0] = False
    meshes = [mesh_of(solid, (0.2, 0.3, 0.25), phase=phase)[0] for phase in ("pore", "both")]
    told = {"sides": sides} if name == "flow" else {}
    alone, cut = (prepare(mesh, sections()[name](analysis=name, **told)) for mesh in meshes)
    assert alone.title == cut.title
    assert alone.steps == cut.steps != ()
    for part in ("WALL", "SKIN", "XMIN_FACES"):
        assert alone.mesh.parts[part] == cut.mesh.parts[part]
    pressures, rates = {"XMIN": 1.0, "XMAX": 0.0}, {"XMIN": -1.0, "XMAX": 1.0}
    _, box = mesh_of(solid, (0.2, 0.3, 0.25))
    if name == "flow":
        one, other = (permeability(job, rates, pressures, box) for job in (alone, cut))
        assert one == other


@pytest.mark.parametrize(
    ("name", "given", "words"),
    [
        ("flow", {"pressure_drop": 1.0, "velocity": 1.0}, "one of them"),
        ("flow", {"pressure_drop": 0.0}, "greater than 0"),
        ("flow", {"sides": "open"}, "walls"),
        ("diffusion", {"concentrations": (1.0, 1.0)}, "two that differ"),
    ],
)
def test_sections_that_make_no_sense(name, given, words):
    with pytest.raises(ValueError, match=words):
        sections()[name](analysis=name, **given)


@pytest.mark.parametrize(
    ("cut", "words"),
    [
        (np.s_[1:-1], "no pore opens on XMIN or XMAX"),
        (np.s_[:-1], "no pore opens on XMAX"),
        (None, "no pore leads from XMIN to XMAX: they fall into 2"),
    ],
)
def test_no_step_and_why(cut, words):
    solid = np.ones((5, 4, 3), bool)
    if cut is None:
        solid[:2, 1, 1] = solid[2:, 2, 1] = False  # they touch in an edge
    else:
        solid[cut, 1, 1] = False
    mesh, _ = mesh_of(solid, (1.0, 2.0, 3.0))
    for job in (flow(mesh, fluid=WATER), diffusion(mesh, material=OXYGEN)):
        assert not job.steps
        assert words in job.why_no_step
        assert job.mesh == mesh


def test_without_a_wall_nothing_holds_the_fluid():
    mesh, _ = mesh_of(np.zeros((3, 4, 5), bool), (1.0, 2.0, 3.0))
    assert "no wall" in flow(mesh, fluid=WATER, slip=True).why_no_step
    assert flow(mesh, fluid=WATER).steps


def test_bad_drives_and_fluids_are_refused():
    mesh, _ = mesh_of(np.zeros((3, 4, 5), bool), (1.0, 2.0, 3.0))
    for given in ({"pressure_drop": -1.0}, {"velocity": 0.0}, {"velocity": math.inf}):
        with pytest.raises(MeshError, match="more than zero"):
            flow(mesh, fluid=WATER, **given)
    with pytest.raises(MeshError, match="one of them"):
        flow(mesh, fluid=WATER, pressure_drop=1.0, velocity=1.0)
    with pytest.raises(MeshError, match="no viscosity"):
        flow(mesh, fluid=OXYGEN)
    with pytest.raises(MeshError, match="two numbers"):
        diffusion(mesh, material=OXYGEN, concentrations=(math.nan, 1.0))


def held_otherwise(*held):
    mesh, _ = mesh_of(np.zeros((3, 4, 5), bool), (1.0, 2.0, 3.0))
    return Job("", mesh, {"PORE": WATER}, (Step("flow", "flow", held),))


@pytest.mark.parametrize(
    ("held", "words"),
    [
        (Held("XMIN", "velocity", 1.0, (0,)), "velocity on XMIN is held in part"),
        (Held("YMIN", "velocity", 0.0, (0,)), "velocity on YMIN is held in part"),
        (Held("XMIN", "temperature", 1.0), "wanted a pressure, or a velocity"),
    ],
)
def test_what_simple_foam_cannot_hold(held, words, tmp_path):
    with pytest.raises(PorousError, match=words):
        formats.write(held_otherwise(held), tmp_path / "a.foam")
    assert not list(tmp_path.iterdir())


# --- the solver, and what goes wrong -------------------------------------------------------------


@pytest.fixture
def case(tmp_path):
    """Return the folder of a small case that runs."""
    mesh, _ = mesh_of(np.zeros((3, 4, 5), bool), (1.0, 2.0, 3.0))
    formats.write(diffusion(mesh, material=OXYGEN), tmp_path / "a.foam")
    return tmp_path / "a.foam"


def test_a_folder_is_solved_and_left_as_it_is(case, judge):
    judge("laplacianFoam")
    before = sorted(case.rglob("*"))
    solution = openfoam.solve(case)
    assert solution.rates["XMAX"] == pytest.approx(2.1e-9 * 8 * 15e-3 / 3, rel=1e-9)
    assert solution.iterations >= 1
    assert "Solving for T" in solution.log
    assert sorted(case.rglob("*")) == before


def test_an_error_that_openfoam_reports(case, judge):
    judge("laplacianFoam")
    (case / "0" / "T").unlink()
    with pytest.raises(GuestError, match=r"laplacianFoam reports.*cannot find file"):
        openfoam.solve(case)


def pretender(folder, script):
    path = folder / "pretender"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


RATES = """\
mkdir -p postProcessing/out-X{0}/0
printf '{1}' > postProcessing/out-X{0}/0/surfaceFieldValue.dat
"""


def rates(low, high):
    return RATES.format("MIN", low) + RATES.format("MAX", high)


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("sleep 60", "time limit of 0.5 s"),
        ("kill -KILL $$", "was ended by SIGKILL"),
        ("kill -FPE $$", "diverged"),
        ("exit 3", "exit code 3"),
        ("true", "wrote no rates"),
        (rates("1 -1\\n2 -2\\n", "1 1\\n2 2\\n"), "did not come to rest"),
        (rates("1 -1\\n", "1 1.5\\n"), "lost some"),
        (rates("1 -1\\n", "1 nan\\n"), "diverged"),
    ],
)
def test_solvers_that_go_wrong(script, words, case, tmp_path):
    with pytest.raises(GuestError, match=words):
        openfoam.solve(case, program=pretender(tmp_path, script), time_limit=0.5)


def test_a_solver_that_is_not_there_and_cases_without_a_step(case, tmp_path):
    wanted = (
        r"OpenFOAM is not installed: .* '/no/such/solver'; on Debian: apt-get install openfoam$"
    )
    with pytest.raises(GuestError, match=wanted):
        openfoam.solve(case, program="/no/such/solver")
    with pytest.raises(GuestError, match=r"has no system.controlDict"):
        openfoam.solve(tmp_path)
    mesh, _ = mesh_of(np.zeros((3, 4, 5), bool), (1.0, 2.0, 3.0))
    with pytest.raises(GuestError, match="the case has no step"):
        openfoam.solve(foam.write_files(mesh, "a.foam"))
