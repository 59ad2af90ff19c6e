"""Every block of the README and of the pages in docs is run."""

import os
import re
import shlex
import sys
from pathlib import Path

import pytest
from programs import said

from porous.cli import main
from porous.jobs._material import read_material
from porous.recipe import build, load

ROOT = Path(__file__).parent.parent
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
INSTALLS = "python3 -m venv "
"""How the two commands begin that .ci/run executes in fresh environments."""
SOLVERS = {"ccx": "ccx", "sh": "simpleFoam"}
"""Commands besides our own, and what must be installed for them."""


def blocks(page):
    """Language, file name and text of each fenced block of a page, in order."""
    fenced = r"^```(\w*) ?(\S*)\n(.*?)^```$"
    return re.findall(fenced, page.read_text(encoding="utf-8"), re.M | re.S)


each_page = pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)


@each_page
def test_no_block_is_of_a_kind_that_nobody_runs(page):
    assert {kind for kind, _, _ in blocks(page)} <= {"sh", "python", "toml", "text"}


@each_page
@pytest.mark.slow
def test_a_page_runs_from_top_to_bottom(page, tmp_path, monkeypatch, capsys, judge):
    monkeypatch.chdir(tmp_path)
    names, said = {}, ""
    for kind, file, text in blocks(page):
        if kind == "python":
            capsys.readouterr()
            exec(compile(text, str(page), "exec"), names)  # it is our own page
            said = capsys.readouterr().out
        elif kind == "toml":
            given = Path(file or "recipe.toml")
            given.write_text(text, encoding="utf-8")
            assert read_material(given) if "[model]" not in text else build(load(given))
        elif kind == "sh":
            for line in text.splitlines():
                run_line(line, judge, capsys)
        else:
            assert said.strip() == text.strip()


def run_line(line, judge, capsys):
    """Run one command line of a page: porous here, a solver where it is installed."""
    words = shlex.split(line, comments=True)
    if not words or line.startswith(INSTALLS):
        return
    if words[:2] == ["porous", "solve"]:
        judge("ccx")
    if words[0] == "porous":
        assert main(words[1:]) == 0, f"{line}: {capsys.readouterr().err}"
        return
    assert words[0] in SOLVERS, f"nobody runs {line!r}"
    judge(SOLVERS[words[0]])
    said([judge(words[0]), *words[1:]], ".", seconds=120)


def test_the_two_commands_come_first_and_ci_runs_them():
    first, second = [text for kind, _, text in blocks(ROOT / "README.md") if kind == "sh"][:2]
    assert first.startswith(f"{INSTALLS}.venv && ")
    assert first.rstrip().endswith("porous make menger -o out")
    assert second.startswith(f"{INSTALLS}.venv-test && ")
    assert "pytest" in second
    script = (ROOT / ".ci" / "run").read_text()
    assert "readme .venv)" in script
    assert "readme .venv-test)" in script


def test_the_scripts_can_be_run():
    for name in (".ci/run", "scripts/check"):
        assert os.access(ROOT / name, os.X_OK)


@each_page
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), target


def test_the_python_version_is_the_one_the_readme_names():
    wanted = re.search(r"Python (3\.\d+) or later", (ROOT / "README.md").read_text())
    assert f'requires-python = ">={wanted[1]}"' in (ROOT / "pyproject.toml").read_text()
    assert sys.version_info >= tuple(map(int, wanted[1].split(".")))
