"""Bad input of every sort: one clear line, the right exit code, and nothing left behind."""

from __future__ import annotations

import contextlib
import os
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from refusals import contents, refuse

from porous.cli import main

CUBE = "[model]\nkind = 'ifs'\nlevel = 1\ndigits = { divisions = 2, keep = [[0, 0, 0]] }\n"
HALF = "[[0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5]]"


def maps(*matrices: str) -> str:
    """Return the text of a recipe with these matrices, none of them moved."""
    tables = [f"[[model.maps]]\nmatrix = {m}\ntranslation = [0, 0, 0]\n" for m in matrices]
    return "[model]\nkind = 'ifs'\nlevel = 1\n" + "".join(tables)


SETTINGS = {
    "unknown key": ("model.levle=3", "model.levle: unknown key; did you mean 'level'"),
    "unknown section": ("voxel.voxels=3", "voxel: unknown key; did you mean 'voxels'"),
    "unknown key below": ("surface.metod=exact", "surface.metod: unknown key; did you mean"),
    "unknown key of digits": ("model.digits.division=3", "division.*did you mean 'divisions'"),
    "unknown kind": ("model.kind=tpms", 'model.kind: unknown kind "tpms"; there is .*ifs'),
    "kind is a number": ("model.kind=3", "model.kind: unknown kind 3"),
    "level below zero": ("model.level=-1", "model.level: got -1; wanted"),
    "level is half": ("model.level=1.5", "model.level: got 1.5; wanted"),
    "level is a word": ("model.level=deep", 'model.level: got "deep"; wanted'),
    "level is true": ("model.level=true", "model.level: got true; wanted"),
    "cut size zero": ("model.level={ size = 0 }", "model.level"),
    "level 40": ("model.level=40", "memory|floating point"),
    "size zero": ("model.size=0", "model.size: got 0; wanted"),
    "size below zero": ("model.size=-2.0", "model.size: got -2.0; wanted"),
    "size NaN": ("model.size=nan", "model.size: got nan; wanted"),
    "size infinite": ("model.size=inf", "model.size: got inf; wanted"),
    "size is text": ('model.size="1.0"', 'model.size: got "1.0"; wanted'),
    "unknown unit": ("model.unit=furlong", "model.unit: .*furlong"),
    "unknown contacts": ("model.contacts=glue", 'model.contacts: got "glue"; wanted'),
    "offset below zero": ("model.offset=-1", "model.offset: got -1; wanted"),
    "unknown primitive": ("model.primitive=teapot", "primitive.*teapot"),
    "no mesh": (
        'model.primitive={ mesh = "none.stl" }',
        r'model.primitive.mesh: not found: "none.stl"; wanted',
    ),
    "no digits": ("model.digits.keep=[]", "digits"),
    "digit out of range": ("model.digits.keep=[[0, 0, 3]]", r"\[0, 0, 3\]"),
    "digit twice": ("model.digits.keep=[[0, 0, 0], [0, 0, 0]]", "twice"),
    "unknown digits": ("model.digits.keep=mengr", "mengr"),
    "one division": ("model.digits.divisions=1", "divisions"),
    "no maps": ("model.maps=[]", "maps"),
    "no voxels": ("voxels.voxels=0", "voxels.voxels: got 0; wanted"),
    "half a voxel": ("voxels.voxels=0.5", "voxels.voxels: got 0.5; wanted"),
    "spacing zero": ("voxels.spacing=0.0", "voxels.spacing"),
    "spacing of two": ("voxels.spacing=[1.0, 1.0]", "voxels.spacing"),
    "spacing below zero": ("voxels.spacing=[0.1, -0.1, 0.1]", "voxels.spacing"),
    "tiny spacing": ("voxels.spacing=1e-9", "memory"),
    "per_feature zero": ("voxels.per_feature=0", "voxels.per_feature: got 0; wanted"),
    "unknown sampling": ("voxels.sampling=random", 'voxels.sampling: got "random"; wanted'),
    "periodic in two": ("voxels.periodic=[true, false]", "voxels.periodic"),
    "periodic in words": ("voxels.periodic=xy", 'voxels.periodic: got "xy"; wanted three'),
    "unknown surface": ("surface.method=magic", 'surface.method: got "magic"; wanted'),
    "unknown volume": ("volume.method=magic", 'volume.method: got "magic"; wanted'),
    "edge length zero": ("volume.edge_length=0", "volume.edge_length: got 0; wanted"),
    "unknown analysis": ("simulation.analysis=fire", 'simulation.analysis: got "fire"; wanted'),
    "unknown material": ("simulation.material=steal", "'steal'; did you mean 'steel'"),
    "pressure NaN": ("simulation.pressure=nan", "simulation.pressure: got nan; wanted"),
    "pressure in words": ("simulation.pressure=high", 'simulation.pressure: got "high"'),
    "format of the future": ("format=2", "format: got 2; wanted 1"),
    "seed below zero": ("seed=-1", "seed: got -1; wanted"),
    "title is a number": ("title=3", "title: got 3; wanted"),
    "title is a table": ("title.de=x", 'title: got { de = "x" }; wanted'),
    "expectation without tolerance": (
        "expect.volume.value=1.0",
        "expect.volume.tolerance: got nothing",
    ),
    "no value": ("model.level", "wanted path=VALUE"),
    "no path": ("=3", "wanted path=VALUE"),
    "empty step": ("model..level=3", "empty key"),
    "empty value": ("model.level=", "wanted a TOML value"),
    "value of two words": ("title=a b", "not TOML"),
    "map out of range": (
        "model.digits.keep.99=[0, 0, 0]",
        "model.digits.keep: got .*99.*; wanted a list",
    ),
}
"""What ``porous make menger --set …`` is told, and words of the answer; exit code 2."""

RECIPES = {
    "not TOML": ("[model\n", "not TOML"),
    "syntax error with its line": ("format = 1\ntitle = \n", "line 2"),
    "not UTF-8": (b"title = '\xff'", "not UTF-8"),
    "UTF-16": ("title = 'x'".encode("utf-16"), "not UTF-8"),
    "binary junk": (bytes(range(256)) * 10, "not UTF-8"),
    "NUL": ("a = 1\0", "not TOML"),
    "empty": ("", "model: got nothing; wanted"),
    "model is a number": ("model = 3", "model: got 3; wanted"),
    "deep brackets": ("a = " + "[" * 100_000, "brackets 100000 deep"),
    "deep keys": ("a" + ".b" * 20_000 + " = 1", "a key of 20001 parts"),
    "large": ("#" * 2_000_000, "more than 1048576 bytes"),
    "no kind": ("[model]\nlevel = 2\n", "model.kind: missing; there is .*ifs"),
    "neither maps nor digits": ("[model]\nkind = 'ifs'\nlevel = 1\n", "maps"),
    "both maps and digits": (
        CUBE + f"maps = [{{ matrix = {HALF}, translation = [0, 0, 0] }}]\n",
        "digits",
    ),
    "a map that stretches": (maps(HALF, "[[2, 0, 0], [0, 2, 0], [0, 0, 2]]"), r"\bmap"),
    "a word that stretches": (
        maps("[[0, 2, 0], [0.2, 0, 0], [0, 0, 0.5]]", "[[0, 0.2, 0], [2, 0, 0], [0, 0, 0.5]]"),
        "word",
    ),
    "a rotation": (maps("[[0, -1, 0], [1, 0, 0], [0, 0, 1]]"), "contract|attractor"),
    "a singular matrix": (maps("[[0.5, 0, 0], [0, 0.5, 0], [0, 0, 0]]"), "singular|volume|flat"),
    "NaN in a matrix": (maps("[[nan, 0, 0], [0, 0.5, 0], [0, 0, 0.5]]"), "model.maps.0.matrix"),
    "inf in a matrix": (maps("[[inf, 0, 0], [0, 0.5, 0], [0, 0, 0.5]]"), "model.maps.0.matrix"),
    "a matrix of two rows": (maps("[[0.5, 0, 0], [0, 0.5, 0]]"), "model.maps.0.matrix"),
    "a matrix of words": (maps('[["a", 0, 0], [0, 0.5, 0], [0, 0, 0.5]]'), "model.maps.0.matrix"),
    "a map without matrix": (
        CUBE.split("digits")[0] + "[[model.maps]]\ntranslation = [0, 0, 0]\n",
        "model.maps.0.matrix: got nothing; wanted three rows",
    ),
    "a million divisions": (
        CUBE.replace("level = 1", "level = 3").replace("divisions = 2", "divisions = 1000"),
        "memory",
    ),
    "the limit per feature": (
        CUBE.replace("level = 1", "level = 'limit'") + "[voxels]\nper_feature = 4\n",
        "voxels.voxels",
    ),
    "voxels and spacing": (CUBE + "[voxels]\nvoxels = 3\nspacing = 0.1\n", "voxels and spacing"),
    "an empty grid": (
        CUBE.replace("[[0, 0, 0]]", "[[1, 1, 1]]").replace("level = 1", "level = 9")
        + "[voxels]\nvoxels = 2\n[surface]\nmethod = 'marching-cubes'\n",
        "none of the 8 voxels is solid",
    ),
    "code": ("[model]\nkind = 'ifs'\nlevel = __import__('os').getpid()\n", "not TOML"),
}
"""The text of a recipe, and words of what ``porous make`` says to it; exit code 2."""

COMMANDS = {
    "no command": (["mak", "menger", "-o", "out"], 2, 'Did you mean "make"'),
    "no option": (["make", "menger", "-o", "out", "--voxls", "3"], 2, "Did you mean --voxels"),
    "no folder": (["make", "menger"], 2, "--out"),
    "no recipe": (["make", "-o", "out"], 2, "(?i)source"),
    "too much": (["make", "menger", "sponge", "-o", "out"], 2, "sponge"),
    "a word for a number": (["make", "menger", "-o", "out", "--voxels", "many"], 2, "many"),
    "no voxels": (["make", "menger", "-o", "out", "--voxels", "0"], 2, "voxels.voxels: got 0"),
    "voxels below zero": (["make", "menger", "-o", "out", "--voxels=-5"], 2, "got -5"),
    "voxels without end": (["make", "menger", "-o", "out", "--voxels", "100000"], 2, "memory"),
    "unknown preset": (
        ["make", "mengr", "-o", "out"],
        2,
        "no preset 'mengr'; did you mean 'menger'",
    ),
    "recipe is missing": (["make", "none.toml", "-o", "out"], 2, "none.toml: .*no such file"),
    "recipe is a folder": (["make", "./", "-o", "out"], 2, "is a folder without slices"),
    "image is missing": (["make", "none.tif", "-o", "out"], 2, "none.tif: .*not found"),
    "voxels without a header": (["make", "ct.raw", "-o", "out"], 2, "ct.raw: .*wanted an .mhd"),
    "measures into a file": (
        ["measure", "menger", "--voxels", "100000", "-o", "taken"],
        1,
        "taken: cannot be written",  # before the memory is asked for that is not there
    ),
    "recipe is a device": (["make", "/dev/null", "-o", "out"], 2, "not an ordinary file"),
    "only nonsense": (
        ["make", "menger", "-o", "out", "--only", "voxel"],
        2,
        "did you mean 'voxels'",
    ),
    "memory in words": (["make", "menger", "-o", "out", "--max-memory", "lots"], 2, "'lots'"),
    "too little memory": (["make", "menger", "-o", "out", "--max-memory", "1K"], 2, "1 KiB"),
    "folder is a file": (["make", "menger", "-o", "taken"], 1, "taken: cannot be written"),
    "folder below a file": (["make", "menger", "-o", "taken/out"], 1, "cannot be written"),
    "folder in /proc": (["make", "menger", "-o", "/proc/porous"], 1, "/proc/porous: cannot be"),
    "measure nothing": (["measure", "none.stl"], 2, "none.stl"),
    "measure of no format": (["measure", "it.docx"], 2, "unknown format '.docx'"),
    "measure a broken surface": (["measure", "broken.stl"], 2, "broken.stl"),
    "settings for a file": (["measure", "broken.stl", "--voxels", "3"], 2, "presets and recipes"),
    "convert to nothing": (["convert", "broken.stl", "it.docx"], 2, "broken.stl|docx"),
    "recipe of nothing": (["recipe"], 2, "porous list"),
    "recipe unknown": (["recipe", "vicsek-8"], 2, "did you mean 'vicsek-"),
}
"""A command line in a folder with ``taken``, ``ct.raw``, ``broken.stl``; exit code and words."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a folder to work in, with a file that is in the way and a broken surface."""
    (tmp_path / "taken").write_text("a file")
    (tmp_path / "ct.raw").write_bytes(bytes(range(128, 192)))
    (tmp_path / "broken.stl").write_bytes(b"\0" * 80 + (7).to_bytes(4, "little") + b"\0" * 9)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", SETTINGS)
def test_settings(name, folder, capsys):
    value, words = SETTINGS[name]
    refuse(folder, capsys, ["make", "menger", "-o", "out", "--set", value], 2, words)


@pytest.mark.parametrize("name", RECIPES)
def test_recipes(name, folder, capsys):
    text, words = RECIPES[name]
    path = folder / "it.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    refuse(folder, capsys, ["make", "it.toml", "-o", "a/b/out"], 2, words)


@pytest.mark.parametrize("name", COMMANDS)
def test_commands(name, folder, capsys):
    argv, code, words = COMMANDS[name]
    refuse(folder, capsys, argv, code, words)


def test_a_billion_maps_do_not_fit_into_a_recipe(folder, capsys):
    """A file that would hold them is not read to its end; a sparse one costs nothing to make."""
    with (folder / "it.toml").open("wb") as stream:
        stream.write(b"[model]\nkind = 'ifs'\n")
        stream.truncate(60_000_000_000)
    assert main(["make", "it.toml", "-o", "out"]) == 2
    assert "more than 1048576 bytes" in capsys.readouterr().err
    assert not (folder / "out").exists()


def test_a_billion_cells_are_refused_before_they_are_made(folder, capsys):
    argv = ["make", "menger", "-o", "out", "--set", "model.level=7", "--max-memory", "200M"]
    refuse(folder, capsys, argv, 2, "memory")


@pytest.mark.parametrize("hole", ["hole", "empty", "inside out"])
def test_a_primitive_with_a_hole(hole, folder, capsys):
    corners = {
        "hole": "021 013 032",
        "empty": "",
        "inside out": "012 031 132 023",
    }[hole].split()
    points = ["0 0 0", "1 0 0", "0 1 0", "0 0 1"]
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {points[int(i)]}\n" for i in corner)
        + "endloop\nendfacet\n"
        for corner in corners
    )
    (folder / "part.stl").write_text(f"solid part\n{facets}endsolid part\n")
    (folder / "it.toml").write_text(CUBE + 'primitive = { mesh = "part.stl" }\n', encoding="utf-8")
    refuse(folder, capsys, ["make", "it.toml", "-o", "out"], 2, "part.stl|surface|triangle")


def porous(*argv: str, folder: Path, **how) -> subprocess.Popen:
    """Start the command line in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "porous", *argv],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **how,
    )


def still_running(mark: str) -> list[str]:
    """Return the command lines of processes that carry a mark in their environment."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError):
                if mark.encode() in (entry / "environ").read_bytes():
                    found.append((entry / "cmdline").read_text())
    return found


@pytest.mark.parametrize(
    ("stage", "stop"),
    [
        ("surface", signal.SIGINT),
        pytest.param("model", signal.SIGINT, marks=pytest.mark.slow),
        pytest.param("voxels", signal.SIGINT, marks=pytest.mark.slow),
        pytest.param("model", signal.SIGTERM, marks=pytest.mark.slow),
        pytest.param("voxels", signal.SIGTERM, marks=pytest.mark.slow),
        pytest.param("surface", signal.SIGTERM, marks=pytest.mark.slow),
    ],
)
def test_an_interrupt_halfway_leaves_nothing(stage, stop, folder):
    """Stopped while the stage after ``stage`` is under way: voxels, surface, the guest's mesh."""
    before = contents(folder)
    argv = ["make", "menger", "-o", "new/out", "--voxels", "200", "--set", "model.level=3"]
    argv += ["--set", "surface.method=marching-cubes", "--set", "volume.method=tetwild"]
    mark = f"POROUS_TEST={os.getpid()}-{stage}-{stop}"
    environment = dict([*os.environ.items(), mark.split("=")])
    process = porous(*argv, folder=folder, env=environment)
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith(f"{stage}:"):
            break
    time.sleep(0.5 if stage == "surface" else 0.02)
    running = still_running(mark)
    process.send_signal(stop)
    _, err = process.communicate(timeout=60)
    assert process.returncode == (130 if stop == signal.SIGINT else 143)
    assert "Traceback" not in err
    assert any("tetwild" in line for line in running) or stage != "surface"
    assert still_running(mark) == []
    assert contents(folder) == before


@pytest.mark.parametrize(
    "limit",
    [
        pytest.param(100, marks=pytest.mark.slow),
        20_000,
        pytest.param(60_000, marks=[pytest.mark.slow, pytest.mark.nightly]),
    ],
)
def test_a_full_disk(limit, folder, tmp_path_factory):
    """No file may grow beyond a limit, as on a disk that is full: exit 1, the folder as it was.

    With a limit of 100 bytes compiled kernels cannot be kept either, and that is no reason to fail.
    """

    def shrink() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    before = contents(folder)
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    if limit == 100:
        environment["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("cache"))
    argv = ["make", "menger", "-o", "new/out", "--set", "volume.method=none"]
    process = porous(*argv, folder=folder, env=environment, preexec_fn=shrink)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 1, err
    assert re.match(r"porous: new/out.*: cannot be written", err.splitlines()[-1])
    assert contents(folder) == before


def test_a_failed_run_keeps_the_folder_of_the_last_one(folder, capsys):
    argv = ["make", "menger", "-o", "out", "--only", "voxels"]
    assert main([*argv, "--set", "model.level=1"]) == 0
    capsys.readouterr()
    refuse(folder, capsys, [*argv, "--set", "model.level=40"], 2, "memory|floating point")
    assert (folder / "out" / "measures.json").exists()


def test_a_reader_that_goes_away_is_no_error(folder):
    process = porous("list", folder=folder)
    assert process.stdout is not None
    process.stdout.close()
    _, err = process.communicate(timeout=30)
    assert err == ""
    assert process.returncode == 0
