"""Jobs: what recipes say of them, which body bears the load, why there is no step, and decks."""

import itertools
import json
from dataclasses import replace
from typing import get_args

import naive_boundary as naive
import numpy as np
import pytest
import systems

from porous import load, make
from porous.errors import GuestError, MeshError, RecipeError
from porous.formats import formats, inp
from porous.guests import ccx
from porous.jobs import SimulationSection, compression, prepare, sections
from porous.recipe import dump, schema
from porous.stages import hexahedralize, name_parts
from porous.values import Block, Box, Frame, Material, Part, Pressed, VolumeMesh, VoxelGrid
from porous.values.job import PROCEDURES

STEEL = Material("steel", 210e3, 0.3, 7.85e-9)


def hexes(solid, spacing=(1.0, 2.0, 3.0)):
    frame = Frame((0, 0, 0), spacing, solid.shape)
    return name_parts(hexahedralize(VoxelGrid.of_solid(solid, frame)), frame.box)


def press(solid, pressure=2.0):
    return compression(hexes(solid), material=STEEL, pressure=pressure)


def columns(*ranges):
    """Return voxels of a 5×4×3 frame that are solid where listed: ((x, y), z from, z to)."""
    solid = np.zeros((5, 4, 3), dtype=bool)
    for (x, y), low, high in ranges:
        solid[x, y, low:high] = True
    return solid


def test_the_body_between_is_pressed():
    job = press(columns(((0, 0), 0, 3)))
    assert (job.steps[0].held[0].part, job.steps[0].pressed) == (
        "ZMIN",
        (Pressed("ZMAX_FACES", 2.0),),
    )
    assert (job.mesh.cells, job.note, job.why_no_step) == (3, "", "")
    assert len(job.mesh.parts["ZMIN"].members) == 4


def test_what_bears_no_load_is_left_out_and_said():
    # A column; a stub beside it, joined by an edge; another on the floor; one in the air.
    job = press(columns(((0, 0), 0, 3), ((1, 1), 1, 3), ((4, 0), 0, 1), ((4, 3), 1, 2)))
    assert job.mesh.cells == 3
    assert len(job.mesh.points) == 16
    assert "3 bodies of 4 cells left out" in job.note
    assert len(job.mesh.parts["ZMAX_FACES"].members) == 1
    assert job.mesh.parts["SOLID"].members.tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("solid", "words"),
    [
        (columns(((0, 0), 0, 2)), "no face lies on ZMAX"),
        (columns(((0, 0), 1, 2)), "no face lies on ZMIN or ZMAX"),
        (columns(((0, 0), 0, 2), ((1, 0), 2, 3)), "no face-connected body.*2 bodies"),
        (columns(((0, 0), 0, 1), ((1, 0), 1, 3)), "point or an edge bears no load"),
        (columns(((0, 0), 0, 3), ((2, 2), 0, 3)), "2 of them reach.*side by side"),
    ],
)
def test_no_step_and_why(solid, words):
    job = press(solid)
    assert not job.steps
    assert job.mesh == hexes(solid)
    import re

    assert re.search(words, job.why_no_step)


@pytest.mark.parametrize(("divisions", "keep"), [(3, systems.VICSEK_9), (2, systems.PARITY)])
def test_cells_that_only_touch_bear_nothing(divisions, keep):
    job = press(naive.prefractal(divisions, keep, 2))
    assert not job.steps
    assert f"{len(keep) ** 2} bodies that no face joins" in job.why_no_step
    assert "fuse" in job.why_no_step


def test_cantor_squares_stay_in_pieces():
    keep = [(x, y, z) for x, y in itertools.product((0, 2), repeat=2) for z in range(3)]
    job = press(naive.prefractal(3, keep, 2))
    assert not job.steps
    assert "16 of them reach from ZMIN to ZMAX" in job.why_no_step


def test_bad_jobs_are_refused():
    empty = VolumeMesh(np.zeros((0, 3)), ())
    with pytest.raises(MeshError, match="no cells"):
        compression(empty, material=STEEL, pressure=1.0)
    with pytest.raises(MeshError, match="pressure"):
        press(columns(((0, 0), 0, 3)), pressure=float("nan"))


def test_a_mesh_without_names_has_no_step():
    mesh = VolumeMesh(np.eye(4, 3), (Block("tet4", np.array([[3, 0, 1, 2]])),))
    assert "ZMIN" in compression(mesh, material=STEEL, pressure=1.0).why_no_step
    named = name_parts(mesh, Box((0, 0, 0), (1, 1, 1)))
    assert "no face lies on ZMAX" in compression(named, material=STEEL, pressure=1.0).why_no_step


# ------------------------------------------------------------------ analyses and their sections


def test_an_analysis_is_a_file_with_a_section_and_a_function():
    assert {"compression", "conduction", "homogenisation", "modal"} <= set(sections())
    for name, section in sections().items():
        assert issubclass(section, SimulationSection)
        assert get_args(section.model_fields["analysis"].annotation) == (name,)
        assert set(section.PROCEDURES) <= set(PROCEDURES)
        assert section.PHASE in ("solid", "pore", "both")
        assert all(field.description for field in section.model_fields.values()), name
        home = {form.suffix[1:]: form.procedures for form in formats()}[section.DECK]
        assert set(section.PROCEDURES) <= set(home)


def test_the_schema_knows_every_analysis():
    found = schema()
    refs = [ref["$ref"].rpartition("/")[2] for ref in found["properties"]["simulation"]["oneOf"]]
    assert refs == [f"simulation_{name}" for name in sections()]
    assert "temperatures" in found["$defs"]["simulation_conduction"]["properties"]


def test_another_analysis_forgets_what_it_does_not_know():
    assert load("menger").simulation.analysis == "compression"
    other = load("menger", set={"simulation.analysis": "conduction", "simulation.axis": "x"})
    assert (other.simulation.analysis, other.simulation.axis) == ("conduction", "x")
    with pytest.raises(RecipeError, match=r"simulation\.pressure: unknown key"):
        load("menger", set={"simulation.analysis": "modal", "simulation.pressure": 1.0})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"analysis": "fire"}, 'analysis: got "fire"; wanted one of "compression", "conduction"'),
        ({"analysis": 3}, "analysis: got 3; wanted one of"),
        ({"units": "mm-N"}, 'units: got "mm-N"; wanted "mm-N-MPa" or "m-SI"'),
        ({"material": "stele"}, "material: no material 'stele'; did you mean 'steel'"),
        ({"material": "gone.toml"}, 'material: not found: "gone.toml"; wanted a file'),
        ({"axis": "w"}, 'axis: got "w"; wanted "x", "y" or "z"'),
        ({"strain": 0.0}, "strain: wanted a number but zero"),
        ({"decks": ["doc"]}, "no deck 'doc'"),
        ({"decks": ["foam"]}, "a .foam file cannot hold a step of static; wanted some of .*inp"),
        ({"analysis": "conduction", "temperatures": [1.0, 1.0]}, "wanted two that differ"),
        ({"analysis": "conduction", "pore_material": "wtaer"}, "did you mean 'water'"),
        ({"analysis": "modal", "modes": 0}, "modes: got 0; wanted how many"),
        ({"analysis": "modal", "clamped": "TOP"}, 'clamped: got "TOP"; wanted the side'),
        ({"analysis": "homogenisation", "property": "colour"}, 'property: got "colour"'),
        ({"analysis": "homogenisation", "decks": ["cdb"]}, "decks.*inp"),
        ({"presure": 1.0}, "presure: unknown key; did you mean 'pressure'"),
    ],
)
def test_sections_that_cannot_be_understood(changes, words):
    analysis = {"simulation.analysis": changes["analysis"]} if "analysis" in changes else {}
    given = analysis | {f"simulation.{key}": value for key, value in changes.items()}
    with pytest.raises(RecipeError, match=words) as caught:
        load("menger", set=given)
    assert caught.value.exit_code == 2
    assert "simulation" in str(caught.value)


def test_a_body_is_pressed_or_moved():
    moved = load("menger", set={"simulation.strain": 0.1}).simulation
    assert (moved.strain, moved.pressure) == (0.1, None)  # the preset says a pressure
    with pytest.raises(ValueError, match="got pressure and strain; wanted one of them"):
        sections()["compression"](pressure=1.0, strain=0.1)


def test_a_material_that_lacks_what_is_needed_is_told():
    mesh = hexes(columns(((0, 0), 0, 3)))
    with pytest.raises(MeshError, match="pla: has no conductivity; it has youngs_modulus"):
        prepare(mesh, sections()["conduction"](material="pla"))
    with pytest.raises(MeshError, match="water: has no youngs_modulus"):
        prepare(mesh, sections()["modal"](material="water"))


def test_parts_that_are_missing_or_select_nothing_are_told():
    mesh = hexes(columns(((0, 0), 0, 3)))
    with pytest.raises(MeshError, match="no part PORE, cells of the pore; it has SKIN, SOLID"):
        prepare(mesh, sections()["conduction"](pore_material="water"))
    with pytest.raises(MeshError, match="no pairs of nodes XPAIRS"):
        prepare(mesh, sections()["homogenisation"]())
    with pytest.raises(MeshError, match="the mesh has no cells"):
        prepare(VolumeMesh(np.zeros((0, 3)), ()), sections()["modal"]())
    nothing = {**mesh.parts, "ZMIN": Part("nodes", np.zeros(0, np.int64))}
    with pytest.raises(MeshError, match="'ZMIN' selects nothing; wanted some nodes"):
        prepare(replace(mesh, parts=nothing), sections()["modal"]())


def test_of_both_phases_the_solid_alone_is_pressed():
    mesh = hexes(np.ones((2, 2, 3), dtype=bool))
    lower = mesh.blocks[0].cells.min(axis=1) < 12
    parts = {"SOLID": np.flatnonzero(lower), "PORE": np.flatnonzero(~lower)}
    both = replace(mesh, parts={**mesh.parts, **{k: Part("cells", v) for k, v in parts.items()}})
    job = prepare(both, sections()["compression"]())
    assert job.mesh.cells == lower.sum() < mesh.cells
    empty = prepare(both, sections()["conduction"](axis="y"))
    filled = prepare(both, sections()["conduction"](axis="y", pore_material="air"))
    assert (empty.mesh.cells, filled.mesh.cells) == (lower.sum(), mesh.cells)
    assert {part: made.name for part, made in filled.materials.items()} == {
        "SOLID": "steel",
        "PORE": "air",
    }


def test_heat_flows_in_bodies_side_by_side_and_in_no_other():
    solid = columns(((0, 0), 0, 3), ((2, 2), 0, 3), ((4, 0), 0, 2), ((1, 1), 0, 1))
    job = prepare(hexes(solid), sections()["conduction"](temperatures=(300.0, 350.0)))
    assert job.mesh.cells == 6
    assert "2 bodies of 3 cells left out" in job.note
    assert [held.value for held in job.steps[0].held] == [300.0, 350.0]
    job = prepare(hexes(columns(((0, 0), 0, 2), ((1, 0), 2, 3))), sections()["conduction"]())
    assert "no face-connected body joins ZMIN and ZMAX" in job.why_no_step


def test_the_largest_body_swings():
    solid = columns(((0, 0), 0, 1), ((2, 2), 0, 2), ((4, 0), 0, 3), ((3, 1), 1, 3))
    job = prepare(hexes(solid), sections()["modal"](clamped="ZMAX", modes=3))
    assert (job.mesh.cells, job.steps[0].modes) == (3, 3)
    assert "3 bodies of 5 cells left out" in job.note
    free = prepare(
        hexes(columns(((0, 0), 0, 1), ((2, 2), 1, 3))), sections()["modal"](clamped="none")
    )
    assert (free.mesh.cells, free.steps[0].held) == (2, ())
    none = prepare(hexes(columns(((2, 2), 1, 3))), sections()["modal"](clamped="ZMIN"))
    assert "no face lies on ZMIN" in none.why_no_step


@pytest.mark.judge
@pytest.mark.parametrize(
    ("shape", "clamped", "modes"),
    [
        ((1, 1, 1), "ZMIN", 2),
        ((1, 1, 1), "none", 4),
        ((2, 2, 2), "ZMIN", 10),
        ((2, 1, 1), "ZMIN", 3),
    ],
)
def test_of_more_modes_than_a_mesh_can_have_those_are_sought_that_can_be_found(
    judge, shape, clamped, modes
):
    mesh = hexes(np.ones(shape, dtype=bool))
    job = prepare(mesh, sections()["modal"](clamped=clamped, modes=100))
    assert job.steps[0].modes == modes
    assert f"{modes} modes in place of 100: the mesh has" in job.note
    assert len(ccx.solve(inp.write(job), program=judge("ccx")).frequencies) == modes
    more = replace(job, steps=(replace(job.steps[0], modes=modes + 1),))
    with pytest.raises(GuestError, match="aupd"):
        ccx.solve(inp.write(more), program=judge("ccx"))
    assert not prepare(mesh, sections()["modal"](clamped=clamped, modes=modes)).note


def test_a_mesh_that_is_too_coarse_to_swing_has_no_step():
    mesh = hexes(np.ones((1, 1, 1), dtype=bool))
    one = mesh.blocks[0].cells[0, 0]
    others = Part("nodes", np.delete(np.arange(8), one))
    parts = {**mesh.parts, "ZMIN": others}
    job = prepare(replace(mesh, parts=parts), sections()["modal"]())
    assert "3 degrees of freedom, 5 are needed for each mode" in job.why_no_step


# ------------------------------------------------------------------ into a folder

RUBBER = """
title = "Rubber, natural"
source = "none"
youngs_modulus = "1 MPa"
poissons_ratio = 0.49
density = "1.1 g/cm3"
conductivity = "0.13 W/(m K)"
"""
COARSE = {"volume.method": "voxel-hex", "voxels.voxels": 9, "model.level": 1}


def made(recipe, folder):
    make(recipe, folder, only="simulation")  # without pictures, which take long


def test_a_material_of_ones_own_goes_with_the_recipe(tmp_path):
    (tmp_path / "rubber.toml").write_text(RUBBER)
    text = dump(load("menger", set=COARSE | {"simulation.units": "m-SI"}))
    assert 'material = "steel"' in text
    text = text.replace('material = "steel"', 'material = "./rubber.toml"')
    (tmp_path / "mine.toml").write_text(text)
    made(load(tmp_path / "mine.toml"), tmp_path / "out")
    assert (tmp_path / "out" / "material.toml").read_text() == RUBBER
    assert 'material = "material.toml"' in (tmp_path / "out" / "recipe.toml").read_text()
    deck = (tmp_path / "out" / "hexes.inp").read_bytes()
    assert b"*MATERIAL, NAME=RUBBER-NATURAL\n*ELASTIC\n1.000000000e+06, 4.9" in deck
    made(load(tmp_path / "out" / "recipe.toml"), tmp_path / "again")
    assert (tmp_path / "again" / "hexes.inp").read_bytes() == deck


def test_decks_are_written_as_the_recipe_lists_them(tmp_path):
    out = tmp_path / "out"
    asked = COARSE | {"simulation.analysis": "conduction", "simulation.decks": ["cdb", "foam"]}
    recipe = load("menger", set=asked)
    made(recipe, out)
    files = {path.name for path in out.iterdir()}
    assert {"hexes.inp", "hexes.cdb", "hexes.foam", "hexes.vtu"} <= files
    log = json.loads((out / "log.json").read_text())
    assert "ccx -i hexes" in log["commands"]
    # What a solver has put into the case stays where the recipe is the same …
    (out / "hexes.foam" / "100").mkdir()
    made(recipe, out)
    assert (out / "hexes.foam" / "100").is_dir()
    # … and is not thrown away for another.
    before = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    with pytest.raises(RecipeError, match=r"holds a case hexes\.foam of another"):
        made(load("menger", set=COARSE), out)
    assert before == {path.name: path.stat().st_mtime_ns for path in out.iterdir()}


def test_decks_of_another_recipe_go(tmp_path):
    out = tmp_path / "out"
    made(load("menger", set=COARSE | {"simulation.decks": ["bdf"]}), out)
    assert (out / "hexes.bdf").exists()
    made(load("menger", set=COARSE), out)
    assert not (out / "hexes.bdf").exists()
    assert (out / "hexes.inp").exists()
