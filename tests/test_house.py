"""The house's own rules, read from the source: who may print, write, import, and how much."""

import ast
import importlib
import io
import os
import statistics
import subprocess
import sys
import tokenize
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "porous"
FILES = sorted(PACKAGE.rglob("*.py"))
PACKAGES = sorted(path.parent for path in FILES if path.name == "__init__.py")


def name_of(path):
    return path.relative_to(PACKAGE).as_posix()


@cache
def tree_of(path):
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


@cache
def nodes(path):
    return tuple(ast.walk(tree_of(path)))


def module_of(folder):
    return importlib.import_module(".".join(folder.relative_to(ROOT).parts))


@pytest.fixture(scope="module", autouse=True)
def forgotten():
    """Give back what trees take once all rules have been asked."""
    yield
    for kept in (calls, nodes, tree_of):
        kept.cache_clear()


each_file = pytest.mark.parametrize("path", FILES, ids=name_of)
each_package = pytest.mark.parametrize("folder", PACKAGES, ids=lambda p: p.name)


# --- rooms ---------------------------------------------------------------------------------


@each_file
def test_a_file_says_what_room_it_is(path):
    sentence = (ast.get_docstring(tree_of(path)) or "").split("\n")[0]
    assert len(sentence.split()) > 2
    assert sentence.endswith(".")


@each_file
def test_no_drawers(path):
    drawers = {"utils", "util", "helpers", "common", "misc", "tools", "core", "base"}
    assert path.stem.strip("_") not in drawers


def code_lines(path):
    """Lines that hold a token other than a comment or a string that stands alone."""
    lines, alone = set(), True
    idle = {tokenize.COMMENT, tokenize.NL, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    for token in tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline):
        if token.type == tokenize.NEWLINE:
            alone = True
        elif token.type not in idle:
            if not (token.type == tokenize.STRING and alone):
                lines.update(range(token.start[0], token.end[0] + 1))
            alone = False
    return len(lines)


@each_file
def test_no_file_is_long(path):
    assert code_lines(path) <= 400


def functions():
    for path in FILES:
        if "kernels" not in path.parts:
            for node in nodes(path):
                if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                    first = node.body[1:] if ast.get_docstring(node) else node.body
                    length = first[-1].end_lineno - first[0].lineno + 1 if first else 0
                    yield f"{name_of(path)}:{node.lineno} {node.name}", length


def test_functions_are_short():
    lengths = dict(functions())
    assert statistics.median(lengths.values()) <= 8
    assert {name: n for name, n in lengths.items() if n >= 60} == {}


# --- who may do what -----------------------------------------------------------------------


@cache
def calls(path):
    found = [node for node in nodes(path) if isinstance(node, ast.Call)]
    return [(ast.unparse(node.func), node) for node in found]


@each_file
def test_only_the_command_line_prints_and_exits(path):
    speakers = {"print", "exit", "quit", "sys.exit", "os._exit", "sys.stdout.write", "input"}
    found = {name for name, _ in calls(path)} & speakers
    exits = [n for n in nodes(path) if isinstance(n, ast.Name) and n.id == "SystemExit"]
    if name_of(path) == "__main__.py":
        found -= {"sys.exit"}  # it hands on what the command line returns
    assert name_of(path) == "cli.py" or not (found or exits)


@each_file
def test_nothing_is_evaluated(path):
    assert not {name for name, _ in calls(path)} & {"eval", "exec", "compile", "pickle.load"}


@each_file
def test_no_bare_except(path):
    assert not [
        node.lineno
        for node in nodes(path)
        if isinstance(node, ast.ExceptHandler) and node.type is None
    ]


def imports(path):
    for node in nodes(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""


OWNERS = {
    "numba": ("kernels/",),
    "llvmlite": ("kernels/",),
    "pyvista": ("view.py", "guests/", "adapters.py"),
    "vtk": ("view.py", "guests/"),
    "vtkmodules": ("view.py", "guests/"),
    "pytetwild": ("guests/",),
    "manifold3d": ("guests/",),
    "trimesh": ("adapters.py",),
    "skfem": ("adapters.py",),
    "jinja2": ("report/",),
    "markupsafe": ("report/",),
    "plotly": ("report/",),
    "cyclopts": ("cli.py",),
    "pickle": (),
    "multiprocessing": (),
}


@each_file
def test_a_dependency_has_one_owner(path):
    for module in imports(path):
        owners = OWNERS.get(module.split(".")[0])
        assert owners is None or name_of(path).startswith(owners or "nobody"), module


WRITERS = ("disk.py", "guests/", "view.py", "kernels/_shared.py")
"""The disk; engines and their callers, in temporary folders; the kernels' cache."""
CHANGES = {
    *("write_text", "write_bytes", "mkdir", "rmdir", "unlink", "touch", "rename", "replace"),
    *("makedirs", "rmtree", "copy", "copyfile", "move", "symlink_to", "hardlink_to"),
    *("savez", "savez_compressed", "savetxt", "tofile", "memmap", "mkstemp", "mkdtemp"),
    *("NamedTemporaryFile", "TemporaryDirectory"),
}
MODULES_OF_FILES = {"os", "shutil", "tempfile", "np", "numpy", "Path"}


def changes_the_disk(name, node):
    """Whether a call creates, changes or removes a file."""
    owner, _, attribute = name.rpartition(".")
    if attribute == "open":
        mode = node.args[1] if name == "open" and len(node.args) > 1 else None
        if name != "open" and node.args:
            mode = node.args[0]
        mode = next((k.value for k in node.keywords if k.arg == "mode"), mode)
        return isinstance(mode, ast.Constant) and bool(set(str(mode.value)) & set("wax+"))
    if attribute in {"write_text", "write_bytes", "mkdir", "unlink", "touch", "rmdir"}:
        return owner not in {"disk", "porous.disk", ""}
    return attribute in CHANGES and owner.split("(")[0] in MODULES_OF_FILES


@each_file
def test_only_the_disk_writes(path):
    found = [f"{n} (line {node.lineno})" for n, node in calls(path) if changes_the_disk(n, node)]
    assert name_of(path).startswith(WRITERS) or found == []


@pytest.mark.parametrize(
    ("line", "changes"),
    [
        ("open(p, 'wb')", True),
        ("open(p, mode='a')", True),
        ("path.open('r+b')", True),
        ("open(p)", False),
        ("path.open('rb')", False),
        ("Path(p).write_text(t)", True),
        ("disk.write_bytes(p, b)", False),
        ("write_bytes(p, b)", False),
        ("shutil.rmtree(p)", True),
        ("os.replace(a, b)", True),
        ("text.replace(a, b)", False),
        ("dataclasses.replace(a, b=c)", False),
        ("array.copy()", False),
        ("np.savez(p, a=a)", True),
        ("tempfile.mkdtemp()", True),
    ],
)
def test_the_rule_about_writing_sees(line, changes):
    call = ast.parse(line).body[0].value
    assert changes_the_disk(ast.unparse(call.func), call) == changes


# --- names ---------------------------------------------------------------------------------


def order(name):
    """Return the order of ``__all__``: constants, classes, functions, each by name."""
    return (0 if name.isupper() else 1 if name[0].isupper() else 2), name


def bound_by(folder):
    """Public names that a package's ``__init__`` imports or defines."""
    names = set()
    for node in ast.walk(tree_of(folder / "__init__.py")):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("porous"):
            names |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.ClassDef | ast.FunctionDef):
            names.add(node.name)
    return {name for name in names if not name.startswith("_")}


@each_package
def test_all_is_sorted_and_complete(folder):
    module = module_of(folder)
    names = list(getattr(module, "__all__", []))
    assert names == sorted(names, key=order)
    assert set(names) == bound_by(folder)
    assert [name for name in names if getattr(module, name) is None] == []


@each_package
def test_no_function_has_the_name_of_a_module_beside_it(folder):
    modules = {path.stem for path in folder.glob("*.py")} | {p.name for p in folder.iterdir()}
    module = module_of(folder)
    for name in getattr(module, "__all__", []):
        assert name not in modules or isinstance(getattr(module, name), type(sys)), name


def run_python(code, **environment):
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_importing_porous_costs_numpy_and_nothing_more():
    heavy = "numba scipy skimage pyvista vtk pydantic rich cyclopts psutil jinja2 pytetwild"
    loaded = run_python(f"import sys, porous; print(*(set({heavy.split()}) & set(sys.modules)))")
    assert loaded.split() == []


def test_star_import_gives_every_public_name():
    assert run_python(
        "import porous; before = set(globals()); from porous import *;"
        "print(set(porous.__all__) <= set(globals()), set(porous.__all__) <= set(dir(porous)))"
    ).split() == ["True", "True"]


# --- studies and kernels -------------------------------------------------------------------


def test_studies_run_but_cannot_be_imported():
    studies = sorted((ROOT / "analysis").glob("*.py"))
    assert studies
    assert not (ROOT / "analysis" / "__init__.py").exists()
    assert [path.name for path in studies if path.stem.isidentifier()] == []


COUNT = """
import sys, tempfile
from pathlib import Path
import porous as po
with tempfile.TemporaryDirectory() as folder:
    po.make(po.load("menger"), Path(folder) / "out")
from numba.core.dispatcher import Dispatcher
found = {
    id(item): (module.__name__, name, len(item.signatures))
    for module in list(sys.modules.values()) if module.__name__.startswith("porous.kernels")
    for name, item in vars(module).items() if isinstance(item, Dispatcher)
}
for module, name, count in found.values():
    print(module, name, count)
"""


@pytest.mark.slow
def test_a_cold_start_compiles_few_kernels(tmp_path):
    # Of kernels that were kept compiled those that others call are not seen: nothing is kept here.
    said = run_python(COUNT, NUMBA_CACHE_DIR=str(tmp_path))
    rows = [line.split() for line in said.splitlines() if line.startswith("porous.")]
    compiled = {f"{module}.{name}": int(count) for module, name, count in rows if int(count)}
    assert compiled
    assert sum(compiled.values()) <= 15, compiled
