"""What all tests share: hypothesis without a clock, judges, a settled machine."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "porous",
    deadline=None,  # a kernel that compiles in an example is not slow
    derandomize=True,  # the same examples in every run: a failure is a failure for all
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("porous")


@pytest.fixture
def judge():
    """Return the path of a foreign program; a machine without it skips, CI fails."""

    def find(name: str) -> str:
        path = shutil.which(name)
        if path is None:
            missing = f"{name} is not installed here"
            (pytest.fail if os.environ.get("CI") else pytest.skip)(missing)
        return path

    return find


@pytest.fixture
def ask(tmp_path_factory):
    """Return what runs a script of ``tests/judges`` and gives back the JSON that it prints.

    Judges are libraries of others that read what we write. They run in a process of their own, in
    the environment whose Python ``POROUS_JUDGES`` names (else in ours), with a time limit and no
    standard input. One that is not installed skips; in CI it fails.
    """

    def run(script: str, *arguments: object, seconds: float = 120.0):
        said = tmp_path_factory.mktemp("judge") / "said.json"
        python = os.environ.get("POROUS_JUDGES", sys.executable)
        path = Path(__file__).parent / "judges" / f"{script}.py"
        with said.open("wb") as output:
            done = subprocess.run(
                [python, path, *map(str, arguments)],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.PIPE,
                timeout=seconds,
                check=False,
            )
        errors = done.stderr[-2000:].decode(errors="replace")
        if done.returncode and "ModuleNotFoundError" in errors:
            (pytest.fail if os.environ.get("CI") else pytest.skip)(errors.splitlines()[-1])
        assert done.returncode == 0, errors
        assert said.stat().st_size < 2**26
        return json.loads(said.read_text())

    return run
