"""A recipe from end to end: the stages in order, what each cost, and what is known in the end."""

from porous.pipeline._result import Origin, Result
from porous.pipeline._run import WANTED, Progress, examine, run, run_stored
from porous.pipeline._stored import STORE, SURFACE, check_stored

__all__ = [
    "STORE",
    "SURFACE",
    "WANTED",
    "Origin",
    "Progress",
    "Result",
    "check_stored",
    "examine",
    "run",
    "run_stored",
]
