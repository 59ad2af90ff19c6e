"""What the command line says: measures as a table, progress, complaints."""

from __future__ import annotations

import contextlib
import math
import sys
import time
import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from porous.pipeline import Result
    from porous.values import Measures
    from porous.workspace import Solved

CLOSED = "closed form"


def complain(text: str) -> None:
    """Say what is wrong, in one line."""
    tell(f"porous: {' '.join(text.split())}")


def tell(text: str) -> None:
    """Say something on stderr, if anybody listens."""
    with contextlib.suppress(OSError):
        print(text, file=sys.stderr, flush=True)


@contextlib.contextmanager
def quiet_warnings() -> Iterator[None]:
    """Say warnings in one line; those of other people's packages are not for the user."""

    def say(message: Warning | str, category: type[Warning], *_: Any) -> None:
        if category.__module__.startswith("porous."):
            complain(f"warning: {message}")

    with warnings.catch_warnings():
        warnings.simplefilter("default")
        warnings.showwarning = say  # type: ignore[assignment]
        yield


class Progress:
    """What is being done, on stderr: a bar on a terminal, else a line for every stage."""

    def __init__(self) -> None:
        self.begun: dict[str, float] = {}
        self.bar: Any = None
        self.tasks: dict[str, Any] = {}

    def __enter__(self) -> Progress:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import Progress

            self.bar = Progress(console=Console(stderr=True), transient=True)
            self.bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.stop()

    def __call__(self, stage: str, done: float) -> None:
        """Say how much of a stage is done, 0 to 1."""
        if self.bar is None:
            self._line(stage, done)
            return
        if stage not in self.tasks:
            self.tasks[stage] = self.bar.add_task(stage, total=1.0)
        self.bar.update(self.tasks[stage], completed=done)

    def _line(self, stage: str, done: float) -> None:
        now = time.perf_counter()
        begin = self.begun.setdefault(stage, now)
        if done >= 1:
            del self.begun[stage]
            tell(f"{stage}: {now - begin:.1f} s")


def print_result(result: Result | Solved, *, every: bool) -> None:
    """Print measures, notes and certificate of a result; every row, or the best of each measure."""
    print_measures(result.measures, every=every)
    for note in result.notes:
        print(f"note: {note}")
    if getattr(result, "certificate", None) is not None:
        print(result.certificate)  # type: ignore[union-attr]


def print_measures(measures: Measures, *, every: bool) -> None:
    """Print what was measured, the best row of each or every one, closed forms beside it."""
    known = {row.name: row for row in measures if row.method == CLOSED}
    lines = [("measure", "value", "", "unit", "method", "of", CLOSED)]
    for name in measures.names:
        rows = [row for row in measures.all(name) if row.method != CLOSED]
        if not rows:
            rows = [known[name]]
        elif not every:
            rows = [type(measures)(tuple(rows))[name]]
        beside = _number(known[name].value) if name in known else ""
        for row in rows:
            unit = "" if row.unit == "1" else row.unit
            lines.append((name, _number(row.value), row.spread, unit, row.method, row.of, beside))
    print_columns(lines)


def _number(value: float) -> str:
    if math.isfinite(value) and value == int(value) and abs(value) < 1e9:
        return str(int(value))
    return f"{value:.6g}"


def print_columns(rows: Sequence[Sequence[str]]) -> None:
    """Print rows of texts, each column as wide as its widest."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=True)]
        print("  ".join(cells).rstrip())
