"""What the command line says, as text: measures in a table, and how far the work is."""

from __future__ import annotations

import math
import sys
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from porous.pipeline import Result
    from porous.values import Measures
    from porous.workspace import Solved

CLOSED = "closed form"


class Progress:
    """What is being done: a bar on a terminal, else a line for every stage, which ``say`` gets."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self.say = say
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
            self.say(f"{stage}: {now - begin:.1f} s")


def of_result(result: Result | Solved, *, every: bool) -> str:
    """Return measures, notes and certificate; every row, or the best of each measure."""
    parts = [_of_measures(result.measures, every=every)]
    parts += [f"note: {note}" for note in result.notes]
    if getattr(result, "certificate", None) is not None:
        parts.append(str(result.certificate))  # type: ignore[union-attr]
    return "\n".join(parts)


def _of_measures(measures: Measures, *, every: bool) -> str:
    """Return what was measured, the best row of each or every one, closed forms beside it."""
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
    return columns(lines)


def _number(value: float) -> str:
    if math.isfinite(value) and value == int(value) and abs(value) < 1e9:
        return str(int(value))
    return f"{value:.6g}"


def columns(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of texts as lines, each column as wide as its widest."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)
