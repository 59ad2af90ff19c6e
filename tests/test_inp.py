"""Decks: what CalculiX's reader needs, the same mesh for others, and the physics in the solver."""

import re
from dataclasses import replace

import deck_meshes
import meshio
import naive_boundary as naive
import naive_conduction
import naive_elasticity
import numpy as np
import pytest
import systems

from porous import load, make
from porous.errors import FormatError, GuestError
from porous.formats import inp, read, write
from porous.guests import ccx
from porous.jobs import compression, material, prepare, results, sections
from porous.models.boundary import exact_boundary
from porous.models.ifs import ifs
from porous.models.primitive import named
from porous.stages import (
    exact_surface,
    hexahedralize,
    name_parts,
    quadratic,
    tetrahedralize,
    voxelize,
)
from porous.values import Block, Box, Frame, Job, Material, Part, VolumeMesh, VoxelGrid

UNIT_BOX = Box((0, 0, 0), (1, 1, 1))


def voxel_job(solid, spacing, *, unit="mm", pressure=3.0):
    frame = Frame((0, 0, 0), spacing, solid.shape, unit=unit)
    mesh = name_parts(hexahedralize(VoxelGrid.of_solid(solid, frame)), frame.box)
    return compression(mesh, material=material("ti-6al-4v"), pressure=pressure)


def text(value):
    return b"".join(inp.write(value)).decode("ascii")


def small():
    return voxel_job(np.ones((2, 3, 4), dtype=bool), (1.0, 0.5, 0.25))


def test_lines_and_fields_are_as_the_solver_reads_them():
    far = voxel_job(np.ones((40, 2, 2), dtype=bool), (1e5, 1e-7, 1 / 3))
    heading, title, *lines = text(far).splitlines()
    assert (heading, len(title) <= 80) == ("*HEADING", True)
    for line in lines:
        assert len(line) <= 132
        if line.startswith("*"):
            continue
        fields = line.split(",")
        assert len(fields) <= 16
        assert all(0 < len(field.strip()) <= 20 for field in fields)


def test_a_deck_has_what_a_step_needs():
    deck = text(small())
    for card in (
        "*NODE, NSET=ALL",
        "*ELEMENT, TYPE=C3D8, ELSET=SOLID",
        "*NSET, NSET=ZMIN",
        "*SURFACE, NAME=ZMAX_FACES, TYPE=ELEMENT",
        "*MATERIAL, NAME=TI-6AL-4V\n*ELASTIC\n1.138000000e+05, 3.420000000e-01\n*DENSITY",
        "*SOLID SECTION, ELSET=SOLID, MATERIAL=TI-6AL-4V",
        "*STEP\n*STATIC\n*BOUNDARY\nZMIN, 1, 3\n*DLOAD",
        "*NODE PRINT, NSET=ZMIN, TOTALS=ONLY\nRF",
    ):
        assert card in deck
    assert len(re.findall(r"^\d+, P2, 3\.0+e\+00$", deck, re.MULTILINE)) == 6


def test_others_read_the_same_mesh(tmp_path):
    for mesh in (small().mesh, tets()):
        write(mesh, tmp_path / "mesh.inp")
        # meshio knows no *SURFACE: it is given the deck without them.
        deck = (tmp_path / "mesh.inp").read_text()
        deck = re.sub(r"\*SURFACE[^*]*", "", deck)
        (tmp_path / "other.inp").write_text(deck)
        read = meshio.read(tmp_path / "other.inp")
        assert np.allclose(read.points, mesh.points, rtol=1e-9)
        assert np.array_equal(read.cells[0].data, mesh.blocks[0].cells)
        assert np.array_equal(np.sort(read.point_sets["XMAX"]), mesh.parts["XMAX"].members)


def tets():
    surface = exact_boundary(systems.digits(3, systems.MENGER), named("cube"), 1)
    return name_parts(tetrahedralize(surface, edge_length=0.2), UNIT_BOX)


def test_a_bare_mesh_has_sets_and_no_step():
    deck = text(small().mesh)
    assert "*NSET, NSET=ZMIN" in deck
    assert "*STEP" not in deck
    assert "*MATERIAL" not in deck


def test_a_job_without_step_says_why_in_every_line_a_comment():
    lonely = voxel_job(naive.prefractal(3, systems.VICSEK_9, 1), (1, 2, 3))
    deck = text(lonely)
    assert "*STEP" not in deck
    assert f"** no step: {lonely.why_no_step}" in deck.replace("\n** ", " ").replace(
        " no step", "** no step"
    )
    assert "*SOLID SECTION" in deck


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("um", 1e-3), ("mm", 1), ("cm", 10), ("m", 1e3), ("in", 25.4), ("nm", 1e-6)],
)
def test_lengths_are_millimetres(unit, factor):
    deck = text(voxel_job(np.ones((2, 1, 1), dtype=bool), (1, 2, 3), unit=unit))
    lines = deck[deck.index("*NODE") : deck.index("*ELEMENT")].splitlines()[1:]
    points = np.array([[float(v) for v in line.split(",")[1:]] for line in lines])
    assert points.max(axis=0) == pytest.approx([2 * factor, 2 * factor, 3 * factor])


def test_no_text_becomes_a_card():
    job = small()
    sly = Job(
        "title\n*INCLUDE, INPUT=/etc/passwd",
        job.mesh,
        {"SOLID": Material("a\nb*", 1.0, 0.0, 1.0, "*STEP\n*END STEP é")},
        why_no_step="why\n*STEP",
    )
    cards = [line for line in text(sly).splitlines() if re.match(r"\*[A-Z]", line)]
    assert not any("INCLUDE" in card or "STEP" in card for card in cards)
    assert "*MATERIAL, NAME=A_B_" in text(sly)


def mixed():
    hexes = hexahedralize(
        VoxelGrid.of_solid(np.ones((1, 1, 2), bool), Frame((0, 0, 0), (1, 1, 1), (1, 1, 2)))
    )
    points = np.vstack([hexes.points, [5, 5, 5], [6, 5, 5], [5, 6, 5], [5, 5, 6]])
    tet = Block("tet4", len(hexes.points) + np.arange(4)[None])
    parts = {"2 grip/é": Part("cells", np.arange(3)), "empty": Part("nodes", np.zeros(0))}
    return VolumeMesh(points, (*hexes.blocks, tet), {}, parts)


def test_several_shapes_and_strange_names():
    deck = text(mixed())
    assert "*ELEMENT, TYPE=C3D8, ELSET=SOLID_1" in deck
    assert "*ELEMENT, TYPE=C3D4, ELSET=SOLID_2\n3, 13, 14, 15, 16" in deck
    assert "*ELSET, ELSET=SOLID\nSOLID_1, SOLID_2" in deck
    assert "*ELSET, ELSET=N_2_GRIP__\n1, 2, 3\n" in deck
    assert "EMPTY" not in deck


def test_names_that_would_be_one_are_refused():
    mesh = small().mesh
    parts = {name: Part("nodes", np.array([1])) for name in ("grip 1", "GRIP-1", "grip_1")}
    with pytest.raises(FormatError, match="'grip 1' and 'grip_1'"):
        text(VolumeMesh(mesh.points, mesh.blocks, {}, parts))


def test_parts_have_their_own_members_whatever_they_are_called(tmp_path):
    mesh, some = mixed(), np.array([1])
    count = mesh.cells
    parts = {
        "ALL": Part("nodes", np.array([0, 2])),
        "ALL_1": Part("nodes", np.array([3])),
        "SOLID": Part("nodes", np.arange(count)),
        "SOLID_1": Part("cells", np.arange(count - 1)),
        "ALL_CELLS": Part("faces", np.stack([np.arange(count), np.zeros(count, int)], axis=1)),
        "ALL_CELLS_2": Part("cells", some),
    }
    write(replace(mesh, parts=parts), tmp_path / "a.inp")
    deck = (tmp_path / "a.inp").read_text()
    assert "*NODE, NSET=ALL_2\n" in deck
    assert "*ELSET, ELSET=ALL_CELLS_1\nALL_CELLS_1_1, ALL_CELLS_1_2" in deck
    found = read(tmp_path / "a.inp").parts
    assert found.keys() == parts.keys()
    for name, part in parts.items():
        assert found[name].kind == part.kind
        np.testing.assert_array_equal(found[name].members, part.members)


def test_an_empty_mesh_is_refused():
    with pytest.raises(FormatError, match="no cells"):
        text(VolumeMesh(np.zeros((0, 3)), ()))


# ------------------------------------------------------------------ in the solver itself


def assert_solved(job, program, digits=5):
    """Assert that reaction, energy and volume are those of the job, to so many digits."""
    solved = ccx.solve(inp.write(job), program=program)
    energy, load = naive_elasticity.energy(job)
    assert solved.reaction == pytest.approx(load, abs=10**-digits * np.linalg.norm(load))
    assert solved.energy == pytest.approx(energy, rel=10**-digits)
    assert solved.volume == pytest.approx(job.mesh.volumes.sum(), rel=1e-6)
    assert "nonpositive" not in solved.log
    return solved


@pytest.mark.judge
def test_tetrahedra_of_menger_1_in_calculix(judge):
    job = compression(tets(), material=material("steel"), pressure=2.0)
    solved = assert_solved(job, judge("ccx"))
    assert solved.reaction[2] == pytest.approx(2.0 * 8 / 9, rel=1e-3)


@pytest.mark.judge
@pytest.mark.slow
def test_tetrahedra_of_menger_2_in_calculix(judge):
    surface = exact_boundary(systems.digits(3, systems.MENGER), named("cube"), 2)
    mesh = name_parts(tetrahedralize(surface), UNIT_BOX)
    job = compression(mesh, material=material("pla"), pressure=1.0)
    solved = assert_solved(job, judge("ccx"))
    assert solved.reaction[2] == pytest.approx((8 / 9) ** 2, rel=1e-3)


@pytest.mark.judge
@pytest.mark.slow
def test_the_deck_of_the_menger_preset_runs_as_written(judge, tmp_path):
    result = make(load("menger"), tmp_path / "out")
    deck = (tmp_path / "out" / "tets.inp").read_bytes()
    solved = ccx.solve([deck], program=judge("ccx"))
    energy, load_vector = naive_elasticity.energy(result.job)
    assert "ERROR" not in solved.log
    assert solved.reaction[2] == pytest.approx((8 / 9) ** 2, rel=1e-3)
    assert solved.reaction == pytest.approx(load_vector, abs=1e-5 * np.linalg.norm(load_vector))
    assert solved.energy == pytest.approx(energy, rel=1e-5)


@pytest.mark.judge
def test_hexahedra_of_unequal_edges_in_calculix(judge):
    solid = np.kron(naive.prefractal(3, systems.MENGER, 1), np.ones((2, 2, 2), dtype=bool))
    job = voxel_job(solid, (1 / 6, 1 / 7, 1 / 5))
    solved = assert_solved(job, judge("ccx"))
    assert solved.reaction[2] == pytest.approx(3 * 32 / 42, rel=1e-6)


@pytest.mark.judge
def test_a_bar_is_as_stiff_as_hooke_says(judge):
    bar = voxel_job(np.ones((2, 3, 8), dtype=bool), (1.0, 1.0, 2.0))
    soft = Material("soft", 1000.0, 0.0, 1e-9)  # ν = 0: the clamp holds nothing back
    job = Job(bar.title, bar.mesh, {"SOLID": soft}, bar.steps)
    solved = ccx.solve(inp.write(job), program=judge("ccx"))
    assert solved.energy == pytest.approx(0.5 * 3.0**2 / 1000 * 2 * 3 * 16, rel=1e-6)


@pytest.mark.judge
@pytest.mark.parametrize("axis", "xyz")
def test_quadratic_elements_in_calculix(judge, axis):
    for mesh in curved():
        job = compression(mesh, material=material("steel"), pressure=2.0, axis=axis)
        solved = ccx.solve(inp.write(job), program=judge("ccx"))
        assert solved.energy == pytest.approx(naive_elasticity.curved_energy(job), rel=1e-5)
        assert solved.volume == pytest.approx(mesh.volumes.sum(), rel=1e-6)


def curved():
    solid = naive.prefractal(3, systems.MENGER, 1)
    yield quadratic(voxel_job(solid, (1 / 3, 1 / 4, 1 / 5)).mesh)
    yield quadratic(split(voxel_job(solid, (1 / 3, 1 / 4, 1 / 5)).mesh))


def split(mesh):
    """Return a mesh of boxes as tetrahedra: six of each about a diagonal, in the same way."""
    ways = [[0, *way, 6] for way in ([1, 2], [2, 3], [3, 7], [7, 4], [4, 5], [5, 1])]
    cells = np.concatenate([mesh.blocks[0].cells[:, way] for way in ways])
    tets = VolumeMesh(mesh.points, (Block("tet4", cells),), unit=mesh.unit)
    assert (tets.volumes > 0).all()
    return name_parts(tets, Box.of_points(mesh.points))


@pytest.mark.judge
@pytest.mark.parametrize("units", ["mm-N-MPa", "m-SI"])
def test_heat_in_calculix_is_that_of_scikit_fem(judge, units):
    solid = naive.prefractal(3, systems.MENGER, 1)
    boxes = voxel_job(solid, (1 / 3, 1 / 4, 1 / 5)).mesh
    section = sections()["conduction"](material="copper", axis="x", units=units)
    for mesh in (boxes, split(boxes), *curved()):
        job = prepare(mesh, section)
        found = results(job, ccx.solve(inp.write(job), program=judge("ccx")).steps)
        flow = naive_conduction.heat_flow(job, 0)
        assert found["heat_flow"].value == pytest.approx(flow, rel=1e-6)


@pytest.mark.judge
def test_heat_flows_through_pores_that_are_filled(judge):
    mesh = voxel_job(np.ones((3, 4, 5), dtype=bool), (1.0, 0.5, 0.25)).mesh
    dense = np.random.default_rng(5).random(60) < 0.4
    phases = {"SOLID": np.flatnonzero(dense), "PORE": np.flatnonzero(~dense)}
    parts = {name: Part("cells", cells) for name, cells in phases.items()}
    mesh = replace(mesh, parts={**mesh.parts, **parts})
    job = prepare(mesh, sections()["conduction"](material="alumina", pore_material="water"))
    deck = text(job)
    assert "*ELEMENT, TYPE=DC3D8, ELSET=ALL_CELLS" in deck
    assert "*MATERIAL, NAME=WATER\n*DENSITY" in deck
    assert deck.count("*SOLID SECTION") == 2
    found = results(job, ccx.solve(deck.encode(), program=judge("ccx")).steps)
    assert found["heat_flow"].value == pytest.approx(naive_conduction.heat_flow(job, 2), rel=1e-6)


@pytest.mark.judge
@pytest.mark.parametrize("units", ["mm-N-MPa", "m-SI"])
def test_a_slender_bar_swings_as_euler_and_bernoulli_say(judge, units):
    long, wide, thick = 100.0, 4.0, 2.0
    spacing = (wide / 2, thick, long / 25)
    bar = quadratic(voxel_job(np.ones((2, 1, 25), dtype=bool), spacing).mesh)
    plain = Material("plain", 70e3, 0.0, 2.7e-9)

    def frequencies(**options):
        job = prepare(bar, sections()["modal"](units=units, **options))
        job = replace(job, materials={"SOLID": plain})
        solved = ccx.solve(inp.write(job), program=judge("ccx"))
        return [m.value for m in results(job, solved.steps, solved.frequencies).rows]

    def closed(root, depth):
        return root**2 / (2 * np.pi) * np.sqrt(70e3 * depth**2 / 12 / 2.7e-9 / long**4)

    first = frequencies(clamped="ZMIN", modes=3)
    exact = sorted(closed(root, depth) for root in (1.8751041, 4.6940911) for depth in (2.0, 4.0))
    assert first == pytest.approx(exact[:3], rel=4e-3)  # shear and turning: 0.4 (h/L)² and more
    free = frequencies(clamped="none", modes=8)
    assert np.abs(free[:6]) == pytest.approx(0, abs=1e-2 * free[6])
    assert free[6] == pytest.approx(closed(4.7300407, 2.0), rel=4e-3)


@pytest.mark.judge
def test_a_strain_moves_the_upper_side_and_lets_it_slide(judge):
    soft = Material("soft", 1000.0, 0.3, 1e-9)
    for unit, units, axis in (("mm", "mm-N-MPa", "y"), ("cm", "m-SI", "x")):
        far = 1.0 if unit == "mm" else 10.0
        mesh = voxel_job(np.ones((2, 3, 4), dtype=bool), (1.0, 0.5, 0.25), unit=unit).mesh
        job = prepare(mesh, sections()["compression"](axis=axis, strain=0.01, units=units))
        job = replace(job, materials={"SOLID": soft})
        found = results(job, ccx.solve(inp.write(job), program=judge("ccx")).steps)
        area = {"x": 1.5 * 1.0, "y": 2.0 * 1.0}[axis] * far**2
        reaction = found[f"reaction_{axis}"].value
        # The lower side cannot widen: somewhat stiffer than Hooke's bar.
        assert 1.0 < reaction / (1000.0 * 0.01 * area) < 1.35
        moved = 0.01 * {"x": 2.0, "y": 1.5}[axis] * far
        assert found["strain_energy"].value == pytest.approx(0.5 * reaction * moved, rel=1e-5)


def test_elements_of_twenty_nodes_take_two_lines():
    deck = text(next(curved()))
    body = deck[deck.index("*ELEMENT") :].splitlines()[1:41]
    assert "TYPE=C3D20," in deck
    assert all(line.count(",") == 16 for line in body[::2])  # sixteen numbers, and more to come
    assert all(line.count(",") == 4 for line in body[1::2])


def sierpinski(**options):
    automaton, solid = systems.flake("tetrahedron")
    return ifs(automaton, primitive=solid, level=1, domain=UNIT_BOX, **options)


FUSED = {"contacts": "fuse", "contact_radius": 0.12}


def test_a_sierpinski_tetrahedron_joined_in_points_has_no_step():
    loose = name_parts(tetrahedralize(exact_surface(sierpinski())), UNIT_BOX)
    job = compression(loose, material=material("pla"), pressure=1.0)
    assert not job.steps
    assert "4 bodies that no face joins" in job.why_no_step


@pytest.mark.judge
def test_a_fused_sierpinski_tetrahedron_carries_load_in_voxels(judge):
    mesh = name_parts(hexahedralize(voxelize(sierpinski(**FUSED), voxels=24)), UNIT_BOX)
    assert_solved(compression(mesh, material=material("pla"), pressure=1.0), judge("ccx"))


@pytest.mark.judge
@pytest.mark.slow
def test_a_fused_sierpinski_tetrahedron_carries_load_in_tetrahedra(judge):
    mesh = name_parts(tetrahedralize(exact_surface(sierpinski(**FUSED))), UNIT_BOX)
    assert_solved(compression(mesh, material=material("pla"), pressure=1.0), judge("ccx"))


def scaled(job, size, system):
    return replace(job, mesh=replace(job.mesh, points=job.mesh.points * size), system=system)


@pytest.mark.parametrize(
    ("kind", "edge"),
    [("hex8", 1e-20 * 8), ("tet4", 1e-20 / 6), ("wed6", 1e-20), ("tet10", 1e-20 / 6)],
)
@pytest.mark.judge
def test_elements_too_small_for_calculix_are_refused(judge, kind, edge):
    job = deck_meshes.zoo_job("static", (kind,), unit="m")
    size = (edge / job.mesh.volumes.min()) ** (1 / 3)
    fine = scaled(job, size * 1.05, "m-SI")
    small = scaled(job, size * 0.99, "m-SI")
    with pytest.raises(FormatError, match=r'wide; .* det J .*units = "mm-N-MPa"'):
        text(small)
    assert ccx.solve(inp.write(fine), program=judge("ccx")).volume > 0
    ccx.solve(inp.write(replace(small, system="mm-N-MPa")), program=judge("ccx"))
    # It is the solver that cannot, not we.
    points = re.compile(r"(?<=\*NODE, NSET=ALL\n)[^*]*")
    shrunk = small.mesh.points
    nodes = "".join(f"{i}, {x:.9e}, {y:.9e}, {z:.9e}\n" for i, (x, y, z) in enumerate(shrunk, 1))
    with pytest.raises(GuestError, match="jacobian"):
        ccx.solve(points.sub(nodes, text(fine)).encode(), program=judge("ccx"))
    with pytest.raises(FormatError, match=r"wanted a larger model\.unit"):
        text(scaled(job, size * 0.99e-3, "mm-N-MPa"))
    text(small.mesh)


@pytest.mark.judge
def test_a_deck_that_is_wrong_is_told(judge):
    program = judge("ccx")
    good = text(small())
    with pytest.raises(GuestError, match="CalculiX"):
        ccx.solve(good.replace("TYPE=C3D8", "TYPE=C3D9").encode(), program=program)
    with pytest.raises(GuestError, match="no totals"):
        ccx.solve(text(small().mesh).encode(), program=program)


def test_a_missing_solver_is_told():
    with pytest.raises(GuestError, match="no-such-ccx"):
        ccx.solve(b"*HEADING\n", program="no-such-ccx")
