"""The command line: what each command prints and the code it ends with."""

from __future__ import annotations

import csv
import json
import math
import os
import subprocess
import sys
import time
from importlib.metadata import version

import pytest
import pyvista

from porous import presets
from porous.cli import main
from porous.errors import ViewError
from porous.jobs import material
from porous.jobs._material import read_material
from porous.recipe import dump, load, sections
from porous.toml import read_table
from porous.workspace import LAST

FAST = ["--set", "model.level=1", "--voxels", "9", "--set", "volume.method=voxel-hex"]
FAST += ["--set", "surface.method=marching-cubes"]
MAPS = ("pore_diameter", "wall_thickness")


@pytest.fixture(autouse=True)
def no_picture(monkeypatch):
    """Draw no pictures: that takes seconds, and the report is tested elsewhere."""

    def refuse(*_, **__):
        raise ViewError("not now")

    monkeypatch.setattr("porous.report._report.picture", refuse)


def test_help_comes_at_once_and_names_every_command():
    # Compiled bytecode is there after the first run, as it is for a user's second one.
    seconds = []
    for _ in range(4):
        begin = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", "porous", "--help"],
            capture_output=True,
            text=True,
            check=True,
            stdin=subprocess.DEVNULL,
            timeout=120,
        )
        seconds.append(time.perf_counter() - begin)
    commands = ["list", "recipe", "make", "measure", "convert", "show", "formats", "models"]
    for command in (*commands, "materials", "solve", "resume"):
        assert f" {command} " in done.stdout
    assert min(seconds) < 0.7


@pytest.mark.parametrize("command", ["list", "recipe", "make", "measure", "convert", "show"])
def test_every_command_has_help(command, capsys):
    assert main([command, "--help"]) == 0
    assert "Usage: porous " in capsys.readouterr().out


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"porous {version('porous')}\n"


def test_list_has_a_line_for_every_preset(capsys):
    assert main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    kinds = [[name, load(name).model.kind] for name in presets.names()]
    assert [line.split()[:2] for line in lines] == kinds
    assert lines[presets.names().index("menger")].endswith("Menger sponge")


def test_recipe_prints_what_can_be_made_again(capsys, tmp_path):
    assert main(["recipe", "menger", "--voxels", "9"]) == 0
    text = capsys.readouterr().out
    assert text == dump(load("menger", set={"voxels.voxels": 9}))
    (tmp_path / "it.toml").write_text(text)
    assert main(["recipe", str(tmp_path / "it.toml")]) == 0
    assert capsys.readouterr().out == text


def test_recipe_prints_the_schema(capsys):
    assert main(["recipe", "--schema"]) == 0
    assert "model" in json.loads(capsys.readouterr().out)["properties"]


def test_formats_and_models(capsys):
    assert main(["formats"]) == 0
    text = capsys.readouterr().out
    for suffix in (".stl", ".ply", ".obj", ".vti", ".vtu", ".npz", ".inp"):
        assert suffix in text
    assert main(["models"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [*sections()]


def test_materials_are_listed_with_what_is_known(capsys):
    assert main(["materials"]) == 0
    lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert tuple(lines) == presets.material_names()
    assert lines["steel"].split("  ")[0] == "Structural steel"
    for name, line in lines.items():
        known = set(line.rpartition("  ")[2].split(", "))
        given = set(read_table(presets.material_path(name))) - {"title", "source"}
        assert known == given


def test_a_material_is_printed_as_a_file_that_is_read_again(capsys, tmp_path):
    assert main(["materials", "steel"]) == 0
    path = tmp_path / "steel.toml"
    path.write_text(capsys.readouterr().out, encoding="utf-8")
    assert read_material(path).youngs_modulus == material("steel").youngs_modulus == 210_000
    assert main(["materials", "stel"]) == 2
    assert "no material 'stel'; did you mean 'steel'" in capsys.readouterr().err


def test_make_ends_with_the_measures_and_says_its_progress_on_stderr(capsys, tmp_path):
    assert main(["make", "menger", "-o", str(tmp_path / "out"), *FAST]) == 0
    said = capsys.readouterr()
    assert said.out.splitlines()[0].split()[:2] == ["measure", "value"]
    assert "porosity" in said.out
    assert "closed form" in said.out
    assert "measures.json" in said.out.splitlines()[-1]
    for stage in ("model", "voxels", "surface", "volume", "measures", "report"):
        assert f"\n{stage}: " in "\n" + said.err


def test_make_prints_json_and_nothing_else(capsys, tmp_path):
    out = tmp_path / "out"
    assert main(["make", "menger", "-o", str(out), "--only", "voxels", "--json", *FAST]) == 0
    text = capsys.readouterr().out
    assert text == (out / LAST).read_text()
    rows = json.loads(text)["measures"]
    assert {row["method"] for row in rows if row["name"] == "porosity"} > {"closed form"}


def test_measure_of_a_preset_and_of_the_files_made_of_it_agree(capsys, tmp_path):
    out = tmp_path / "out"
    assert main(["make", "menger", "-o", str(out), *FAST]) == 0
    capsys.readouterr()

    def of(source, name, method):
        assert main(["measure", str(source), "--json"]) == 0
        rows = json.loads(capsys.readouterr().out)["measures"]
        return next(r["value"] for r in rows if (r["name"], r["method"]) == (name, method))

    made = {
        (r["name"], r["method"]): r["value"]
        for r in json.loads((out / LAST).read_text())["measures"]
    }
    assert of(out / "grid.vti", "porosity", "voxel count") == made["porosity", "voxel count"]
    area = of(out / "surface.stl", "surface_area", "triangles")
    assert area == pytest.approx(made["surface_area", "triangles"], rel=1e-6)


def test_measure_writes_a_report(capsys, tmp_path):
    assert main(["make", "menger", "-o", str(tmp_path / "a"), "--only", "surface", *FAST]) == 0
    assert main(["measure", str(tmp_path / "a" / "surface.stl"), "-o", str(tmp_path / "b")]) == 0
    capsys.readouterr()
    assert {path.name for path in (tmp_path / "b").iterdir()} == {
        LAST,
        "measures.csv",
        "report.html",
    }


def test_full_detail_is_a_flag_and_stands_in_the_recipe(capsys, tmp_path):
    rest = ["-o", str(tmp_path / "a"), "--only", "measures", "--detail", "full", *FAST]
    rest += ["--set", "report.maps=true", "--set", "report.smallest_wall=0.4"]
    rest += ["--set", "report.smallest_gap=0.1"]
    assert main(["make", "menger", *rest]) == 0
    capsys.readouterr()
    assert load(tmp_path / "a" / "recipe.toml").report.detail == "full"
    rows = csv.DictReader((tmp_path / "a" / "measures.csv").read_text().splitlines())
    told = json.loads((tmp_path / "a" / LAST).read_text())["measures"]
    assert [
        (row["name"], float(row["value"])) for row in rows if math.isfinite(float(row["value"]))
    ] == [(row["name"], row["value"]) for row in told if row["value"] is not None]
    maps = pyvista.read(tmp_path / "a" / "maps.vti")
    assert set(maps.cell_data) == {*MAPS, "thin_wall", "narrow_gap"}
    walls = maps["wall_thickness"]
    assert (maps["thin_wall"] == walls * (walls < 0.4)).all()
    assert maps["thin_wall"].any()
    assert not maps["narrow_gap"].any()


def test_measure_tells_the_finest_level_that_can_be_printed(capsys):
    argv = ["measure", "menger", "--feature", "0.03", "--json", *FAST]
    assert main(argv) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["measures"]}
    # 3⁻³ = 0.037 can be printed, 3⁻⁴ = 0.012 cannot.
    assert rows["finest_printable_level"]["value"] == 3


def test_convert(capsys, tmp_path):
    assert main(["make", "menger", "-o", str(tmp_path), "--only", "surface", *FAST]) == 0
    assert main(["convert", str(tmp_path / "surface.stl"), str(tmp_path / "surface.ply")]) == 0
    capsys.readouterr()
    assert (tmp_path / "surface.ply").read_bytes().startswith(b"ply")


def test_no_command_prints_help(capsys):
    assert main([]) == 0
    assert "Usage: porous" in capsys.readouterr().out


def test_memory_that_may_be_taken_is_given_back(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("POROUS_MAX_MEMORY", "3G")
    argv = ["make", "menger", "-o", str(tmp_path / "out"), "--max-memory", "1K", *FAST]
    assert main(argv) == 2
    assert "1 KiB" in capsys.readouterr().err
    assert os.environ["POROUS_MAX_MEMORY"] == "3G"


def test_a_fault_of_our_own_is_said_in_one_line(capsys, monkeypatch):
    def broken(_):
        raise ZeroDivisionError("oh")

    monkeypatch.setattr("porous.toml.read_table", broken)
    assert main(["list"]) == 1
    assert capsys.readouterr().err.startswith(
        "porous: a fault of porous itself: ZeroDivisionError: oh"
    )


def test_what_is_wrong_with_a_model_names_its_recipe(tmp_path, capsys):
    path = tmp_path / "mine.toml"
    path.write_text('[model]\nkind = "bcifs"\ncell = "tetra"\ncontrols = [[0, 0, 0]]\n')
    assert main(["make", str(path), "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith(f"porous: {path}: controls: ")
    assert not (tmp_path / "out").exists()


def test_a_dry_run_says_what_it_takes_and_makes_nothing(tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["make", "menger", "--voxels", "243", "--dry-run", "-o", str(out)]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].split() == ["stage", "memory", "disk", "time"]
    assert said[-1].startswith("243 × 243 × 243 voxels: ")
    assert "of memory at most" in said[-1]
    assert not out.exists()


def test_what_memory_does_not_hold_is_refused_before_it_is_begun(tmp_path, capsys):
    out = tmp_path / "out"
    command = ["make", "menger", "--voxels", "3000", "--only", "voxels", "-o", str(out)]
    assert main([*command, "--max-memory", "2G"]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert "2 GiB may be used" in said[-1]
    assert "--out-of-core" in said[-1]
    largest = int(said[-1].partition("voxels.voxels = ")[2].split()[0])
    assert 300 < largest < 1291
    assert not out.exists()


def test_an_estimate_comes_before_the_work(tmp_path, capsys):
    command = ["make", "menger", "--set", "model.level=1", "--only", "voxels"]
    assert main([*command, "-o", str(tmp_path / "out")]) == 0
    first = capsys.readouterr().err.splitlines()[0]
    assert first.startswith("12 × 12 × 12 voxels: ")
    assert "on disk" in first
