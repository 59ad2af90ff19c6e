"""What all tests share: hypothesis without a clock, judges, a settled machine."""

import os
import shutil

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
