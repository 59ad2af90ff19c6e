"""What importing porous costs, and that every public name is where it says it is."""

from __future__ import annotations

import ast
import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

import porous

HEAVY = {"numba", "scipy", "skimage", "vtk", "vtkmodules", "pyvista", "pydantic", "manifold3d"}
HEAVY |= {"pytetwild", "jinja2", "rich", "cyclopts", "psutil"}


def loaded(code: str) -> set[str]:
    """Return the top-level modules that are there after some code has run."""
    tell = "import sys, json; print(json.dumps(sorted({n.split('.')[0] for n in sys.modules})))"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\n{tell}"],
        capture_output=True,
        text=True,
        check=True,
        stdin=subprocess.DEVNULL,
        timeout=120,
    )
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_importing_costs_numpy_at_most():
    assert not loaded("import porous") & HEAVY


def test_values_cost_numpy_only():
    assert not loaded("import porous as po; po.Box((0, 0, 0), (1, 2, 3))") & HEAVY


def test_help_and_list_load_no_engine():
    for command in ("['--help']", "['list']", "['--version']"):
        found = loaded(f"import sys; from porous.cli import main; main({command})")
        assert not found & (HEAVY - {"rich", "cyclopts"}), command


@pytest.mark.parametrize("name", porous.__all__)
def test_every_public_name_is_there(name):
    value = getattr(porous, name)
    assert value is getattr(porous, name)
    assert name in dir(porous)


def test_public_names_are_sorted_and_documented():
    assert list(porous.__all__) == sorted(porous.__all__)
    for name in porous.__all__:
        assert getattr(porous, name).__doc__, name


def test_unknown_names_are_attribute_errors():
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        porous.nothing  # noqa: B018


def test_type_checkers_and_the_interpreter_see_the_same_names():
    tree = ast.parse(Path(porous.__file__).read_text(encoding="utf-8"))
    branch = next(node for node in tree.body if isinstance(node, ast.If))
    for statement in branch.body:
        assert isinstance(statement, ast.ImportFrom)
        for alias in statement.names:
            home = importlib.import_module(statement.module)
            expected = getattr(home, alias.name, None) or importlib.import_module(
                f"{statement.module}.{alias.name}"
            )
            assert getattr(porous, alias.name) is expected
    imported = {alias.name for node in branch.body for alias in node.names}
    assert imported == set(porous.__all__)


def test_functions_do_not_share_the_name_of_a_module():
    modules = {path.stem for path in Path(porous.__file__).parent.iterdir()}
    assert set(porous.__all__) & modules == {"measures"}
