"""Foreign programs as tests run them: a time limit, no standard input, a cap on what they print."""

import tempfile
from pathlib import Path

from porous.guests import process


def said(command, folder=None, *, seconds=60.0, environment=None):
    """Run a program that has to end with 0, and return what it printed and what it complained of.

    It runs in ``folder``, or in one of its own, and is killed with all its children when it takes
    longer or prints more than 64 MiB.
    """
    with tempfile.TemporaryDirectory() as own:
        done = process.run(
            [str(word) for word in command],
            name=Path(command[0]).name,
            folder=Path(folder or own),
            time_limit=seconds,
            environment=environment,
        )
    return done.output, done.errors
