"""Whatever tests and studies start has a time limit and cannot wait for anybody to type."""

import ast
import sys
from pathlib import Path

import pytest
from programs import said

from porous.errors import GuestError

ROOT = Path(__file__).parent.parent
FILES = sorted([*(ROOT / "tests").rglob("*.py"), *(ROOT / "analysis").glob("*.py")])
STARTS = {"run", "Popen", "call", "check_call", "check_output"}


def started(text):
    """Yield the line, and the names of what is given, of each process that a file starts."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call) and ast.unparse(node.func).startswith("subprocess."):
            name = ast.unparse(node.func).partition(".")[2]
            if name in STARTS:
                yield node.lineno, name, {word.arg for word in node.keywords}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_every_process_has_a_time_limit_and_no_input(path):
    for line, name, given in started(path.read_text("utf-8")):
        assert given & {"stdin", "input"}, f"line {line}: wanted stdin=subprocess.DEVNULL"
        assert name == "Popen" or "timeout" in given, f"line {line}: wanted a timeout"


def test_a_program_is_run_with_limits(tmp_path):
    python = sys.executable
    printed, _ = said([python, "-c", "import sys; print(repr(sys.stdin.read()))"], tmp_path)
    assert printed == "''\n"
    with pytest.raises(GuestError, match=r"time limit of 0\.5 s"):
        said([python, "-c", "import time; time.sleep(60)"], seconds=0.5)
    with pytest.raises(GuestError, match="more than the 67108864 that a guest may"):
        said([python, "-c", "while True: print('y' * 1000)"])
