"""A recipe into a folder of files, and the decks there into what they come to."""

from porous.workspace._compare import compare
from porous.workspace._folder import rendered
from porous.workspace._make import (
    DECK,
    KNOWN,
    LAST,
    LOG,
    UNFINISHED,
    is_whole,
    make,
    make_stored,
    record,
    resume,
    write_measures,
)
from porous.workspace._measure import examined, is_recipe, measured
from porous.workspace._solve import Solved, solve

__all__ = [
    "DECK",
    "KNOWN",
    "LAST",
    "LOG",
    "UNFINISHED",
    "Solved",
    "compare",
    "examined",
    "is_recipe",
    "is_whole",
    "make",
    "make_stored",
    "measured",
    "record",
    "rendered",
    "resume",
    "solve",
    "write_measures",
]
