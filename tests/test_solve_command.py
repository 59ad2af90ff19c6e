"""A deck is run where porous has put it: numbers that are known, and whatever a solver may do."""

import json
import os
import shutil
import signal
import stat
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_view import draws

import porous as po
from porous import formats, view, workspace
from porous.cli import main
from porous.errors import (
    Cancelled,
    DiskError,
    FormatError,
    GuestError,
    MeshError,
    RecipeError,
    ViewError,
)
from porous.jobs import diffusion, effective_diffusivity, flow, material, permeability
from porous.recipe import load
from porous.values import Box, Frame, VoxelGrid

STEEL = material("steel")
SMALL = {"model.level": 1, "voxels.voxels": 6, "volume.method": "voxel-hex"}
RESULTS = ["results.json", "results.png", "results.vtu"]


def made(folder, *, preset="menger", **settings):
    """Make a folder without its report: that takes most of the time."""
    wanted = {**SMALL, **{name.replace("__", "."): value for name, value in settings.items()}}
    recipe = load(preset, set=wanted)
    workspace.make(recipe, folder, only="simulation")
    return folder


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    return made(tmp_path_factory.mktemp("base") / "out")


@pytest.fixture
def out(base, tmp_path):
    shutil.copytree(base, tmp_path / "out")
    return tmp_path / "out"


@pytest.fixture
def blind(monkeypatch):
    """No pictures: they take a second each."""

    def refuse(*_, **__):
        raise ViewError("this machine cannot draw: no libX11")

    monkeypatch.setattr(view, "field_picture", refuse)


def values(solved):
    return {row.name: row.value for row in solved.measures}


def fake(folder, script):
    """Return a program that does what a shell script says."""
    path = folder / "ccx-fake"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


# --- what it comes to ----------------------------------------------------------------------


@draws
@pytest.mark.slow
def test_compression_from_the_command_line(out, judge, capsys):
    judge("ccx")
    before = content(out)
    assert main(["solve", str(out)]) == 0
    said = capsys.readouterr()
    assert "effective_youngs_modulus_z" in said.out
    assert f"{out}: results.json, results.png, results.vtu" in said.out
    after = content(out)
    assert {name: after.pop(name)[:1] for name in RESULTS} == {
        "results.json": b"{",
        "results.png": b"\x89",
        "results.vtu": b"<",
    }
    assert after == before
    record = json.loads((out / "results.json").read_text())
    assert record["solver"]["name"] == "CalculiX"
    assert record["solver"]["command"] == "ccx -i hexes"
    assert float(record["solver"]["version"]) >= 2
    assert record["deck"] == "hexes.inp"
    assert record["notes"] == []
    assert {row["uncertainty"] for row in record["measures"]} == {None}
    assert {f["name"]: f["unit"] for f in record["fields"]}["von_mises_stress"] == "MPa"
    assert main(["solve", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["measures"] == record["measures"]


@pytest.mark.usefixtures("blind")
def test_numbers_of_compression_agree_with_each_other(out, judge):
    solved = po.solve(out, program=judge("ccx"))
    assert solved.notes == ("no picture: this machine cannot draw: no libX11",)
    assert not (out / "results.png").exists()
    found = values(solved)
    assert found["reaction_z"] == pytest.approx(8 / 9, rel=1e-6)
    mesh, moved = solved.fields.mesh, solved.fields["displacement"].values
    assert found["mean_displacement_z"] == pytest.approx(
        mean_over(mesh, "ZMAX_FACES", moved[:, 2]), rel=2e-5
    )
    assert found["effective_youngs_modulus_z"] == pytest.approx(
        8 / 9 / -found["mean_displacement_z"], rel=1e-6
    )
    assert 0.5 < found["effective_youngs_modulus_z"] / STEEL.youngs_modulus < 0.6
    assert found["largest_von_mises_stress"] == solved.fields["von_mises_stress"].values.max()
    assert formats.read(out / "results.vtu") == mesh


def mean_over(mesh, part, field):
    """The mean of a field over faces of squares."""
    from porous.values.volume_topology import nodes_of

    return field[nodes_of(mesh, mesh.parts[part].members)].mean()


@pytest.mark.usefixtures("blind")
@pytest.mark.parametrize("units", ["mm-N-MPa", "m-SI"])
def test_heat_through_a_solid_block_is_that_of_its_material(tmp_path, judge, units):
    heat = {"analysis": "conduction", "axis": "y", "temperatures": [3.0, 8.0], "units": units}
    more = {f"simulation.{name}": value for name, value in heat.items()}
    out = made(
        tmp_path / "out", **{"model.level": 0, "model.unit": "cm", "model.size": 2.0}, **more
    )
    solved = po.solve(out, program=judge("ccx"))
    found = values(solved)
    assert found["effective_conductivity_y"] == pytest.approx(STEEL.conductivity, rel=1e-6)
    assert found["heat_flow"] == pytest.approx(STEEL.conductivity * 20 * 5, rel=1e-6)
    temperature, flux = solved.fields["temperature"], solved.fields["heat_flux"]
    y = solved.fields.mesh.points[:, 1]
    np.testing.assert_allclose(temperature.values, 3 + 5 * (y - y.min()) / np.ptp(y), rtol=2e-5)
    assert (temperature.unit, flux.unit) == ("K", "mW/mm²")
    np.testing.assert_allclose(flux.values[:, 1], -STEEL.conductivity * 5 / 20, rtol=1e-4)


@pytest.mark.usefixtures("blind")
def test_units_and_load_change_no_modulus(tmp_path, judge):
    """Pressed or moved, in metres or millimetres: a softer side that slides bears a little less."""
    found = {}
    for name, text in {"pressed": "pressure = 2.0", "moved": "strain = 0.01"}.items():
        for units in ("mm-N-MPa", "m-SI"):
            recipe = tmp_path / f"{name}-{units}.toml"
            recipe.write_text(
                'title = "t"\nsource = "s"\n[model]\nkind = "ifs"\nlevel = 1\nprimitive = "cube"\n'
                'size = 3.0\nunit = "cm"\ndigits = { divisions = 3, keep = "menger" }\n'
                '[voxels]\nvoxels = 6\n[volume]\nmethod = "voxel-hex"\n'
                f'[simulation]\naxis = "x"\n{text}\nunits = "{units}"\n'
            )
            out = tmp_path / recipe.stem
            workspace.make(load(recipe), out, only="simulation")
            solved = po.solve(out, program=judge("ccx"))
            found[name, units] = values(solved)
            assert solved.fields["displacement"].unit == "cm"
            most = np.abs(solved.fields["displacement"].values[:, 0]).max() * 10
            assert most >= abs(found[name, units]["mean_displacement_x"]) * (1 - 2e-5)
    modulus = {key: row["effective_youngs_modulus_x"] for key, row in found.items()}
    for name in ("pressed", "moved"):
        assert modulus[name, "m-SI"] == pytest.approx(modulus[name, "mm-N-MPa"], rel=1e-6)
    assert modulus["moved", "m-SI"] == pytest.approx(modulus["pressed", "m-SI"], rel=0.1)
    assert (
        modulus["moved", "m-SI"] > modulus["pressed", "m-SI"]
    )  # a rigid side, and energy's bounds
    assert found["moved", "m-SI"]["mean_displacement_x"] == pytest.approx(-0.3)


@pytest.mark.usefixtures("blind")
@pytest.mark.parametrize(
    ("preset", "analysis", "told", "why"),
    [
        ("menger-bent", "compression", {"strain_energy"}, "XMIN is not that of its box"),
        ("menger-bent", "conduction", {"heat_flow"}, "XMIN is not that of its box"),
        ("menger-twisted", "conduction", {"heat_flow"}, "fill 0.494 of their box only"),
        (
            "menger-cylinder",
            "compression",
            {"mean_displacement_z", "strain_energy"},
            "fill 0.48 of their box only",
        ),
    ],
)
def test_of_what_is_no_block_no_material_is_told(tmp_path, judge, preset, analysis, told, why):
    more = {"model.level": 0, "volume.method": "cells", "simulation.analysis": analysis}
    solved = po.solve(made(tmp_path / "out", preset=preset, **more), program=judge("ccx"))
    forces = {f"reaction_{axis}" for axis in "xyz"} | {"largest_von_mises_stress"}
    assert set(values(solved)) - forces == told
    (note,) = [note for note in solved.notes if "no effective value of a material" in note]
    assert why in note


def test_a_wedge_of_pores_has_no_permeability():
    """Two sides of the box, the others not: cells that widen along x."""
    frame = Frame((0, 0, 0), (1.0, 2.0, 3.0), (4, 3, 2))
    mesh = po.hexahedralize(VoxelGrid.of_solid(np.zeros((4, 3, 2), bool), frame), phase="pore")
    mesh = po.name_parts(mesh, frame.box)
    wide = np.where(np.arange(3) == 1, 1 + mesh.points[:, :1] / 8, 1)
    wedge = replace(mesh, points=mesh.points * wide)
    rates, pressures = {"XMIN": -2e-9, "XMAX": 2e-9}, {"XMIN": 3.0, "XMAX": 0.0}
    box = Box.of_points(wedge.points)
    for mesh_, names in ((wedge, ["flow_rate", "pressure_drop"]), (mesh, 4)):
        job = flow(mesh_, fluid=material("water"))
        found = permeability(job, rates, pressures, box if mesh_ is wedge else frame.box)
        assert [row.name for row in found] == names or len(found) == names
    job = flow(wedge, fluid=material("water"))
    found = permeability(job, rates, pressures, box)
    assert [row.value for row in found] == pytest.approx([2.0, 3e-6])
    assert permeability(job, rates, pressures, None) == found
    job = diffusion(wedge, material=material("oxygen-in-water"))
    (row,) = effective_diffusivity(job, rates, box)
    assert (row.name, row.value, row.unit) == ("diffusion_rate", pytest.approx(2.0), "mm³/s")


@pytest.mark.usefixtures("blind")
def test_modes_have_shapes_of_size_one(tmp_path, judge):
    more = {"simulation.analysis": "modal", "simulation.modes": 3}
    solved = po.solve(made(tmp_path / "out", **more), program=judge("ccx"))
    found = values(solved)
    assert list(found) == [f"natural_frequency_{i}" for i in (1, 2, 3)]
    assert found["natural_frequency_1"] == pytest.approx(found["natural_frequency_2"], rel=1e-4)
    assert solved.fields.names == ("mode_1", "mode_2", "mode_3")
    assert [f.magnitude.max() for f in solved.fields] == pytest.approx([1, 1, 1])


@pytest.mark.usefixtures("blind")
def test_a_periodic_cell_has_its_tensors_and_steps_by_name(tmp_path, judge):
    more = {"simulation.analysis": "homogenisation", "voxels.periodic": [True] * 3}
    cubic = {"simulation.symmetry": "cubic", **more}
    stiff = po.solve(made(tmp_path / "stiff", **cubic), program=judge("ccx"))
    found = values(stiff)
    assert found["effective_stiffness_11"] > found["effective_youngs_modulus_x"]
    assert "displacement_strain_xx" in stiff.fields.names
    assert "von_mises_stress_strain_yz" in stiff.fields.names
    heat = made(tmp_path / "heat", **more, **{"simulation.property": "conductivity"})
    rows = values(po.solve(heat, program=judge("ccx")))
    plain = made(tmp_path / "plain", **{"simulation.analysis": "conduction"})
    # By symmetry heat that is driven through a tile by its sides flows as in the endless body.
    assert rows["effective_conductivity_z"] == pytest.approx(
        values(po.solve(plain, program=judge("ccx")))["effective_conductivity_z"], rel=1e-6
    )


@pytest.mark.usefixtures("blind")
def test_heat_in_rods_flows_along_them_only(tmp_path, judge):
    fill = np.zeros((4, 4, 3), np.uint8)
    fill[:2, :2] = 255
    formats.write(
        VoxelGrid(Frame((0, 0, 0), (0.1, 0.2, 0.3), fill.shape), fill), tmp_path / "r.nrrd"
    )
    (tmp_path / "rod.toml").write_text(
        'title = "rods"\nsource = "made up"\n[model]\nkind = "image"\npath = "r.nrrd"\n'
        "[voxels]\nperiodic = [true, true, true]\n"
        '[simulation]\nanalysis = "homogenisation"\nproperty = "conductivity"\n'
    )
    workspace.make(load(tmp_path / "rod.toml"), tmp_path / "out", only="simulation")
    solved = po.solve(tmp_path / "out", program=judge("ccx"))
    found = [values(solved)[f"effective_conductivity_{axis}"] for axis in "xyz"]
    assert found == pytest.approx([0, 0, STEEL.conductivity / 4], rel=1e-6)
    assert any("no body goes on along x and y" in note for note in solved.notes)


@pytest.mark.parametrize(
    ("analysis", "stuff", "name"),
    [("flow", "water", "permeability_x"), ("diffusion", "oxygen-in-water", "tortuosity_factor_x")],
)
def test_cases_of_openfoam_are_run_too(tmp_path, judge, analysis, stuff, name, capsys):
    judge("simpleFoam")
    more = {"simulation.analysis": analysis, "simulation.material": stuff}
    out = made(tmp_path / "out", **more)
    before = sorted(path for path in out.rglob("*"))
    assert main(["solve", str(out)]) == 0
    assert name in capsys.readouterr().out
    assert sorted(out.rglob("*")) == sorted([*before, out / "results.json"])
    record = json.loads((out / "results.json").read_text())
    assert record["solver"]["name"] == "OpenFOAM"
    assert record["notes"] == []


def test_a_flow_that_is_too_fast_is_told_how_fast_it_is(tmp_path):
    flow = {"analysis": "flow", "material": "water", "pressure_drop": 1e4}
    out = made(tmp_path / "out", **{f"simulation.{name}": value for name, value in flow.items()})
    program = fake(tmp_path, "kill -FPE $$")
    wanted = (
        r"wanted a slower flow.*; this one was made for a Reynolds number about [1-9]\S*e\+0\d$"
    )
    with pytest.raises(GuestError, match=wanted):
        po.solve(out, program=program)
    with pytest.raises(GuestError, match=r"exit code 3$"):
        po.solve(out, program=fake(tmp_path, "exit 3"))


# --- decks of somebody else's --------------------------------------------------------------


@pytest.mark.usefixtures("blind")
def test_a_deck_that_was_edited_is_run_and_told_as_printed(out, judge):
    deck = out / "hexes.inp"
    deck.write_text(deck.read_text().replace("2.100000000e+05", "1.050000000e+05"))
    solved = po.solve(out, program=judge("ccx"))
    assert "hexes.inp is not what porous" in solved.notes[0]
    found = values(solved)
    assert found["force_z_of_ZMIN"] == pytest.approx(8 / 9, rel=1e-6)
    assert found["volume_of_SOLID"] == pytest.approx(20 / 27, rel=1e-6)
    assert {row.unit for row in solved.measures} == {""}
    assert solved.fields["displacement"].unit == ""
    assert (out / "results.vtu").exists()


@pytest.mark.usefixtures("blind")
def test_a_made_folder_forgets_what_another_mesh_came_to(out, judge):
    po.solve(out, program=judge("ccx"))
    assert (out / "results.json").exists()
    workspace.make(load("menger", set=SMALL), out, only="simulation")
    assert not list(out.glob("results.*"))


@pytest.mark.parametrize("card", ["*STEP", "*step"])
def test_a_deck_without_a_step_is_refused(out, card):
    deck = out / "hexes.inp"
    deck.write_text(deck.read_text().replace("*STEP", "** no step"))
    with pytest.raises(MeshError, match=r"hexes.inp: has no step; wanted one, as `porous make`"):
        po.solve(out)
    deck.write_text(deck.read_text() + f"{card}\n")
    with pytest.raises(GuestError):
        po.solve(out, program=fake(out.parent, "exit 3"))


def test_why_a_deck_has_no_step_is_said(tmp_path, capsys):
    out = tmp_path / "out"
    recipe = tmp_path / "corner.toml"
    recipe.write_text(
        'title = "two cubes that meet in a corner"\nsource = "made up"\n[model]\nkind = "ifs"\n'
        'level = 1\nprimitive = "cube"\nsize = 2.0\n'
        "digits = { divisions = 2, keep = [[0, 0, 0], [1, 1, 1]] }\n"
        '[voxels]\nvoxels = 4\n[volume]\nmethod = "voxel-hex"\n[simulation]\n'
    )
    workspace.make(load(recipe), out, only="simulation")
    assert main(["solve", str(out)]) == 2
    assert "hexes.inp: has no step: " in capsys.readouterr().err


# --- what may go wrong ---------------------------------------------------------------------


def refused(out, error, said, **how):
    """Assert that a folder stays as it was; return what was said."""
    before = content(out)
    with pytest.raises(error, match=said) as caught:
        po.solve(out, **how)
    assert content(out) == before
    return caught.value


def test_folders_that_are_not_made(tmp_path, out):
    with pytest.raises(FormatError, match="no such folder; wanted one that `porous make`"):
        po.solve(tmp_path / "nowhere")
    assert not (tmp_path / "nowhere").exists()
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", FormatError, "holds no recipe.toml")
    refused(out, RecipeError, "time limit: got 0 s", time_limit=0)
    (out / "hexes.vtu").rename(tmp_path / "kept.vtu")
    refused(out, FormatError, "hexes.vtu: cannot be opened: no such file")
    (out / "hexes.inp").unlink()
    refused(out, FormatError, "holds no deck .inp; it has no mesh; wanted what `porous make`")
    (tmp_path / "kept.vtu").rename(out / "hexes.vtu")
    os.mkfifo(out / "hexes.inp")
    with pytest.raises(FormatError, match=r"hexes\.inp: is not a regular file"):
        po.solve(out)


def test_a_solver_that_is_not_there(out, capsys, monkeypatch):
    monkeypatch.setenv("PATH", "/nonexistent")
    before = content(out)
    assert main(["solve", str(out)]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert (
        "CalculiX is not installed: there is no program 'ccx'; on Debian: apt-get install" in said
    )
    assert content(out) == before


GOOD_DAT = """cat > job.dat <<'END'

 total force (fx,fy,fz) for set ZMIN and time  0.1000000E+01

        1.0E-10  1.0E-10  8.888889E-01

 total internal energy for set SOLID and time  0.1000000E+01

        3.5E-06

END
"""


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("exit 3", "CalculiX failed with exit code 3"),
        ("kill -SEGV $$", "CalculiX was ended by SIGSEGV"),
        ("kill -KILL $$", "CalculiX was ended by SIGKILL"),
        ("echo; echo ' *ERROR reading *STEP: no'; exit 201", r"reports \*ERROR reading \*STEP: no"),
        (f"{GOOD_DAT} echo ' *ERROR in e_c3d: nonpositive jacobian'", "nonpositive jacobian"),
        ("exit 0", "printed no totals and no frequencies"),
        ("head -c 100000 /dev/urandom > job.dat", "printed no totals"),
        ("mkdir job.dat job.frd", "printed no totals"),
        (f"{GOOD_DAT} head -c 100000 /dev/urandom > job.frd", "makes no sense: "),
        (f"{GOOD_DAT} echo '    1C' > job.frd", "makes no sense: the file ends before"),
        (GOOD_DAT.replace("3.5E-06", "nan"), "makes no sense: results: the solver printed no inte"),
        (GOOD_DAT.replace("3.5E-06", "1-2-3-4"), "printed '1-2-3-4' where a number belongs"),
        (GOOD_DAT.replace("3.5E-06", "1.0E+999"), "makes no sense: got totals that are not finite"),
        (GOOD_DAT.replace("3.5E-06", "0.0"), "makes no sense: results: nothing bears the load"),
        (GOOD_DAT.replace("ZMIN", "YMIN"), "printed no force of ZMIN"),
    ],
)
def test_whatever_a_solver_does_the_folder_stays(out, script, said):
    error = refused(out, GuestError, said, program=fake(out.parent, script))
    assert error.exit_code == 1


def test_a_solver_that_hangs_is_stopped_with_its_children(out, tmp_path):
    program = fake(tmp_path, f"sleep 60 & echo $! > {tmp_path}/child; sleep 60")
    begin = time.monotonic()
    refused(
        out, GuestError, "stopped after its time limit of 0.5 s", program=program, time_limit=0.5
    )
    assert time.monotonic() - begin < 10
    assert is_gone(int((tmp_path / "child").read_text()))


def is_gone(number):
    for _ in range(100):
        try:
            state = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            return True
        if state == "Z":
            return True
        time.sleep(0.02)
    return False


def test_who_loses_patience_may_say_so(out, tmp_path):
    def stop(stage, done):
        assert (stage, done) == ("solve", 0.0)
        raise Cancelled("enough")

    refused(out, Cancelled, "enough", program=fake(tmp_path, "sleep 60"), progress=stop)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_who_is_interrupted_leaves_nothing(out, tmp_path, number):
    program = fake(tmp_path, f"echo $$ > {tmp_path}/begun; sleep 60")
    before = content(out)
    begun = tmp_path / "begun"
    process = subprocess.Popen(
        [sys.executable, "-m", "porous", "solve", str(out), "--program", program],
        stdin=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    for _ in range(600):
        if begun.exists() and begun.read_text():
            break
        time.sleep(0.05)
    process.send_signal(number)
    assert process.wait(30) == (130 if number == signal.SIGINT else 128 + number)
    assert content(out) == before
    assert is_gone(int(begun.read_text()))


def test_without_fields_the_measures_are_told(out):
    solved = po.solve(out, program=fake(out.parent, GOOD_DAT))
    assert solved.fields is None
    assert solved.notes == ("CalculiX wrote no fields",)
    assert values(solved)["effective_youngs_modulus_z"] == pytest.approx((8 / 9) ** 2 / 7e-6)
    assert sorted(path.name for path in out.glob("results.*")) == ["results.json"]
    assert json.loads((out / "results.json").read_text())["solver"]["version"] is None


@pytest.mark.usefixtures("blind")
def test_a_disk_that_is_full_leaves_what_was_there(out, judge, monkeypatch):
    def full(_):
        raise DiskError("no space left on device")

    monkeypatch.setattr(workspace._solve, "as_json", full)  # the fields are staged by then
    refused(out, DiskError, "no space left", program=judge("ccx"))
