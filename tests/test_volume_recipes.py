"""What a recipe's [volume] says: phases, order, branches, pairs of periodic bodies."""

import numpy as np
import pytest

import porous as po
from porous import view
from porous.errors import ModelError, RecipeError, ViewError
from porous.measures import measure
from porous.pipeline import run
from porous.recipe import load
from porous.stages import hexahedralize, quadratic

MENGER = {"model.level": 1, "voxels.voxels": 9, "model.unit": "cm", "volume.method": "voxel-hex"}


def made(name="menger", **change):
    change = {key.replace("__", "."): value for key, value in change.items()}
    return run(load(name, set={**MENGER, **change}), only="volume")


def agrees(result):
    rows = {row.quantity: row.verdict for row in result.certificate.rows}
    assert result.certificate.good, str(result.certificate)
    return rows


@pytest.mark.parametrize("phase", ["solid", "pore", "both"])
def test_porosity_of_a_mesh_is_that_of_the_body(phase):
    result = made(volume__phase=phase)
    volume = {row.name: row for row in result.measures if row.of == "volume"}
    assert volume["porosity"].value == pytest.approx(7 / 27)
    # As far off as the grid says that its solid is, whichever phase was meshed.
    doubt = result.measures["porosity", "voxel fill"].uncertainty
    assert volume["porosity"].uncertainty == pytest.approx(doubt)
    assert ("pore_volume" in volume) == (phase != "solid")
    if phase != "solid":
        assert volume["pore_volume"].value == pytest.approx(7 / 27)
        assert volume["pore_volume"].unit == "cm³"
    assert ("volume" in volume) == (phase != "pore")
    assert agrees(result)["volume"] == "agree"
    cells = {"solid": 20, "pore": 7, "both": 27}[phase] * 27
    assert result.volume.cells == cells
    names = {"solid": {"SOLID", "WALL"}, "pore": {"PORE", "WALL"}, "both": {"SOLID", "PORE"}}[phase]
    there = {"SOLID", "PORE", "WALL", "INTERFACE"} & set(result.volume.parts)
    assert there == names | ({"INTERFACE"} if phase == "both" else set())


def test_both_phases_tell_of_the_solid_what_the_solid_alone_does():
    alone, both = made(), made(volume__phase="both")
    mine, theirs = (
        {row.name: row.value for row in r.measures if row.of == "volume"} for r in (alone, both)
    )
    shared = set(mine) & set(theirs)
    assert {"components", "euler_number", "mesh_euler_number", "volume"} < shared
    assert {name: mine[name] for name in shared} == pytest.approx(
        {name: theirs[name] for name in shared}
    )
    # A file that knows no model: both phases fill the bulk.
    table = {row.name: row.value for row in measure(both.volume)}
    assert table["porosity"] == pytest.approx(7 / 27)
    pores = {row.name: row.value for row in measure(made(volume__phase="pore").volume)}
    assert pores["pore_volume"] == pytest.approx(7 / 27)
    assert "porosity" not in pores


def test_half_filled_voxels_say_how_far_off_the_pores_may_be():
    result = made(voxels__voxels=10, volume__phase="pore")
    row = result.measures["porosity", "hexahedra"]
    assert row.value != pytest.approx(7 / 27, abs=1e-3)
    assert abs(row.value - 7 / 27) <= 1.01 * row.uncertainty


def test_bodies_that_bend_have_pores_in_their_bulk_alone():
    change = {"voxels__voxels": 24, "volume__phase": "both"}
    result = made("menger-bent", **change)
    exact = result.measures["porosity"]
    row = result.measures["porosity", "hexahedra"]
    assert abs(row.value - exact.value) < 3 * row.uncertainty < 0.2
    box = result.grid.frame.box
    assert result.volume.volumes.sum() < 0.8 * box.volume
    with pytest.raises(ModelError, match="the bulk of this model is another body"):
        made("menger-bent", **{**change, "volume__method": "tetwild"})


def test_auto_is_what_the_analysis_needs():
    assert load("menger").phase == "solid"
    assert load("menger", set={"volume.phase": "pore"}).phase == "pore"
    plain = {"simulation.analysis": "conduction"}
    assert load("menger", set=plain).phase == "solid"
    filled = load("menger", set={**plain, "simulation.pore_material": "water"})
    assert filled.phase == "both"


def test_pores_unasked_go_by_voxels_and_a_period_too():
    result = made(volume__method="auto", volume__phase="pore")
    assert result.volume.blocks[0].shape == "hex8"
    assert any("they mesh pores" in note for note in result.notes)
    result = made(volume__method="auto", voxels__periodic=[True, False, True])
    assert any("periodic body then have the same nodes" in note for note in result.notes)
    assert {name for name in result.volume.parts if "PAIRS" in name} == {"XPAIRS", "ZPAIRS"}
    # The side is a ring of 72 squares on 96 nodes: 16 by 6 … of 10 × 10 less 2 × 2 in the hole.
    assert len(result.volume.parts["XPAIRS"].members) == 100 - 4


def test_cells_of_a_periodic_frame_have_pairs():
    result = made("menger-block", volume__method="cells", voxels__periodic=[True, True, False])
    assert result.volume.is_of_cells
    assert {name for name in result.volume.parts if "PAIRS" in name} == {"XPAIRS", "YPAIRS"}
    bent = made("menger-bent", volume__method="cells", voxels__periodic=[True, True, True])
    assert "XPAIRS" not in bent.volume.parts
    assert any("the cells have no pairs of nodes: periodic pairs" in note for note in bent.notes)


PERIODIC = {"voxels__periodic": [True, True, True]}


def test_auto_takes_cells_that_go_on_and_says_why_it_took_voxels():
    result = made("menger-block", volume__method="auto", **PERIODIC)
    assert result.volume.is_of_cells
    assert {name for name in result.volume.parts if "PAIRS" in name} == {
        "XPAIRS",
        "YPAIRS",
        "ZPAIRS",
    }
    assert not result.notes
    bent = made("menger-bent", volume__method="auto", **PERIODIC)
    assert not bent.volume.is_of_cells
    assert "YPAIRS" in bent.volume.parts
    first, second = bent.notes
    assert first.startswith("volume not of the model's cells: periodic pairs: ")
    assert second.startswith("auto took voxel-hex, one hexahedron per voxel: opposite sides of a")
    mended = made("menger-block", volume__method="auto", clean__islands=2, **PERIODIC)
    assert any(note.startswith("auto took voxel-hex") for note in mended.notes)


def test_cells_in_a_periodic_frame_tell_nothing_that_the_frame_alone_knows():
    change = {"model.level": 1, "voxels.voxels": 6, "voxels.periodic": [True, True, True]}
    result = run(load("menger-block", set={**change, "volume.method": "cells"}))
    assert {"euler_number", "components"}.isdisjoint(
        row.name for row in result.measures if row.of == "volume"
    )
    verdicts = {row.quantity: row.verdict for row in result.certificate.rows}
    assert "differ" not in {verdicts[name] for name in ("components", "euler_number")}


def test_a_tensor_of_cells_is_that_of_voxels_of_the_same_cubes(tmp_path, judge, monkeypatch):
    def blind(*_, **__):
        raise ViewError("pictures take a second each")

    monkeypatch.setattr(view, "field_picture", blind)
    change = {
        "model.level": 1,
        "voxels.voxels": 3,
        "voxels.periodic": [True, True, True],
        "simulation.analysis": "homogenisation",
        "simulation.symmetry": "cubic",
    }
    found = {}
    for method in ("auto", "voxel-hex"):
        recipe = load("menger-block", set={**change, "volume.method": method})
        made = po.make(recipe, tmp_path / method, only="simulation")
        assert made.volume.is_of_cells == (method == "auto")
        rows = po.solve(tmp_path / method, program=judge("ccx")).measures
        found[method] = [rows[f"effective_stiffness_{index}"].value for index in (11, 12, 44)]
    assert found["auto"] == pytest.approx(found["voxel-hex"], rel=1e-6)
    # Of titanium, E = 113.8 GPa and ν = 0.342: C11 is less than its share of the solid's.
    assert 1e3 < found["auto"][0] < 20 / 27 * 113.8e3 * 0.658 / (1.342 * 0.316)


def test_cells_are_solid():
    with pytest.raises(RecipeError, match='phase: got "pore", but a model\'s cells are its solid'):
        made("menger-block", volume__method="cells", volume__phase="pore")
    change = {"simulation.analysis": "conduction", "simulation.pore_material": "water"}
    recipe = load("menger-block", set={**MENGER, **change, "volume.method": "cells"})
    with pytest.raises(ModelError, match='phase = "both" wanted'):
        run(recipe)


@pytest.mark.parametrize("name", ["menger", "menger-block"])
def test_order_two_measures_as_order_one(name):
    method = "cells" if name == "menger-block" else "voxel-hex"
    one, two = (made(name, volume__method=method, volume__order=order) for order in (1, 2))
    assert two.volume == quadratic(one.volume)
    assert two.volume.blocks[0].shape == "hex20"
    tables = [
        {row.name: row.value for row in result.measures if row.of == "volume"}
        for result in (one, two)
    ]
    assert tables[0] == pytest.approx(tables[1])
    agrees(two)
    if method == "cells":
        assert two.measures["pinched_nodes"] == one.measures["pinched_nodes"]


def test_branches_of_a_recipe():
    result = made(volume__branches=1)
    words = [name for name in result.volume.parts if name.startswith("WORD_")]
    assert len(words) == 20
    with pytest.raises(ModelError, match="length 2; wanted 1 … 1"):
        made(volume__branches=2)
    with pytest.raises(RecipeError, match=r"volume\.order: got 3; wanted 1 or 2"):
        made(volume__order=3)
    with pytest.raises(RecipeError, match=r'volume\.phase: got "void"; wanted .*"both"'):
        made(volume__phase="void")


@pytest.mark.slow
@pytest.mark.parametrize("phase", ["both", "pore"])
def test_tetrahedra_of_pores(phase):
    result = made(volume__method="tetwild", volume__phase=phase, volume__edge_length=0.2)
    row = result.measures["porosity", "tetrahedra"]
    assert row.value == pytest.approx(7 / 27, abs=2e-3)
    assert set(result.volume.cell_tags["phase"]) == ({0, 1} if phase == "both" else {0})
    agrees(result)
    assert "PORE" in result.volume.parts


def test_what_a_tag_of_other_numbers_says_is_not_asked():
    mesh = hexahedralize(po.voxelize(po.build(load("menger", set={"model.level": 1})), voxels=3))
    other = po.VolumeMesh(mesh.points, mesh.blocks, {"phase": np.arange(mesh.cells)})
    assert measure(other) == measure(mesh)
