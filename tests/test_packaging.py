"""What is shipped: the wheel has the package and its presets, and nothing else."""

import importlib.metadata
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from porous import presets

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def run(*command, **options):
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        **options,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder), cwd=ROOT)
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def members(wheel):
    with zipfile.ZipFile(wheel) as archive:
        return archive.namelist()


def test_the_wheel_holds_every_module(members):
    modules = [path.relative_to(ROOT).as_posix() for path in (ROOT / "porous").rglob("*.py")]
    assert set(modules) <= set(members)
    assert "porous/py.typed" in members


def test_the_wheel_holds_every_preset_and_material(members):
    here = [path.relative_to(ROOT / "presets") for path in (ROOT / "presets").rglob("*.*")]
    assert here
    assert {f"porous/_presets/{path.as_posix()}" for path in here} <= set(members)


def test_the_wheel_holds_what_the_report_is_made_of(members):
    data = [
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "porous" / "report").iterdir()
        if path.is_file() and path.suffix != ".pyc"
    ]
    assert set(data) <= set(members)
    assert any(name.endswith(".html") for name in data)


def test_the_wheel_holds_the_pages_that_the_report_quotes(wheel):
    with zipfile.ZipFile(wheel) as archive:
        for name, place in (("measures.md", ROOT / "docs"), ("CITATION.cff", ROOT)):
            assert archive.read(f"porous/_docs/{name}") == (place / name).read_bytes()


def test_the_wheel_holds_nothing_else(members):
    tops = {name.split("/")[0] for name in members}
    assert tops == {"porous", f"porous-{PROJECT['version']}.dist-info"}
    folders = {name.split("/")[1] for name in members if name.count("/") > 1}
    assert not folders & {"tests", "analysis", "docs", "scripts"}
    assert not [name for name in members if name.endswith((".pyc", ".nbi", ".nbc", ".csv"))]


def test_the_installed_wheel_finds_its_presets(wheel, tmp_path):
    site = tmp_path / "site"
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index"]
    run(*pip, "--target", str(site), str(wheel))
    code = "import porous.presets as p;print(p.folder(), '|', *p.names(), '|', *p.material_names())"
    environment = {**os.environ, "PYTHONPATH": str(site)}
    folder, names, materials = run(sys.executable, "-c", code, cwd=tmp_path, env=environment).split(
        "|"
    )
    assert folder.strip() == str(site / "porous" / "_presets")
    assert names.split() == list(presets.names())
    assert materials.split() == list(presets.material_names())
    code = (
        "import porous.report._definitions as d; print(d.documents(d.PAGE), len(d.definitions()))"
    )
    page, count = run(sys.executable, "-c", code, cwd=tmp_path, env=environment).split()
    assert page == str(site / "porous" / "_docs" / "measures.md")
    assert int(count) > 50
    listed = run(sys.executable, "-m", "porous", "list", cwd=tmp_path, env=environment)
    assert "menger" in listed


def test_an_editable_install_finds_the_presets_of_the_checkout():
    assert presets.folder().samefile(ROOT / "presets")
    assert "menger" in presets.names()
    assert "steel" in presets.material_names()


def test_one_version_everywhere():
    version = PROJECT["version"]
    assert importlib.metadata.version("porous") == version
    latest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert latest is not None
    assert latest[1] == version
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.M)
    assert cited is not None
    assert cited[1] == version


def test_dependencies_say_why_they_are_there():
    lines = (ROOT / "pyproject.toml").read_text().splitlines()
    start = lines.index("dependencies = [")
    wanted = lines[start + 1 : lines.index("]", start)]
    assert len(wanted) == len(PROJECT["dependencies"])
    assert [line for line in wanted if not re.fullmatch(r'    ".+>=[\d.]+",\s+# .+', line)] == []
