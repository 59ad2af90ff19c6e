"""What all tests share: hypothesis without a clock, judges, a settled machine."""

import json
import os
import shutil
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from programs import said

from porous.errors import GuestError

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
    the environment whose Python ``POROUS_JUDGES`` names (else in ours), with a time limit, no
    standard input and a cap on what they print. One that is not installed skips; in CI it fails.
    """

    def run(script: str, *arguments: object, seconds: float = 120.0):
        python = os.environ.get("POROUS_JUDGES", sys.executable)
        path = Path(__file__).parent / "judges" / f"{script}.py"
        try:
            printed, _ = said(
                [python, path, *arguments], tmp_path_factory.mktemp("judge"), seconds=seconds
            )
        except GuestError as error:
            if "ModuleNotFoundError" in str(error):
                (pytest.fail if os.environ.get("CI") else pytest.skip)(f"{script}: {error}")
            raise
        return json.loads(printed)

    return run
