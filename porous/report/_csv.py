"""Measures and curves as tables of text that any spreadsheet opens, and back again."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.values import Curve

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from porous.values import Measure

MEASURES = ("name", "value", "unit", "method", "uncertainty", "kind", "of")
LINE = ("name", "series", "x_name", "x_unit", "y_name", "y_unit", "method")
POINT = ("x", "y", "low", "high")
CURVES = (*LINE, *POINT, "drawn", "log")

FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""How a cell begins that a spreadsheet would work out."""

GUARD = "'"


def measures_csv(measures: Iterable[Measure]) -> bytes:
    """Return measures as the bytes of a CSV file (RFC 4180, UTF-8), numbers in full.

    The columns are name, value, unit, method, uncertainty, kind and of, as in ``measures.json``;
    what is not finite is ``inf`` or ``nan``. Text that a spreadsheet would take for a formula
    begins with an apostrophe.
    """
    return _table(MEASURES, ([getattr(row, name) for name in MEASURES] for row in measures))


def curves_csv(curves: Iterable[Curve]) -> bytes:
    """Return curves as the bytes of a CSV file (RFC 4180, UTF-8), one row a point.

    The columns are name, series, x_name, x_unit, y_name, y_unit, method, x, y, low, high, drawn and
    log; low and high are empty where a curve has no band.
    """
    return _table(CURVES, (row for curve in curves for row in _points(curve)))


def read_curves(content: bytes, name: str) -> tuple[Curve, ...]:
    """Return the curves that ``curves_csv`` has written.

    Parameters
    ----------
    content
        The bytes of the file.
    name
        What it is called in what is said of it.

    Raises
    ------
    FormatError
        Where it is damaged or of another kind.
    """
    try:
        rows = list(csv.reader(io.StringIO(content.decode("utf-8"), newline=""), strict=True))
        if not rows or tuple(rows[0]) != CURVES:
            got = ", ".join(rows[0])[:200] if rows else "nothing"
            raise FormatError(f"{name}: got the columns {got}; wanted {', '.join(CURVES)}")
        return tuple(_curve(lines) for lines in _parts(rows[1:]))
    except (ValueError, csv.Error) as error:
        raise FormatError(f"{name}: is damaged: {error}; make the folder again") from None


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> bytes:
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(head)
    writer.writerows([_cell(value) for value in row] for row in rows)
    return text.getvalue().encode("utf-8")


def _cell(value: object) -> str:
    if isinstance(value, float):
        return repr(value)
    text = "" if value is None else str(value)
    return GUARD + text if text.startswith((*FORMULA, GUARD)) else text


def _points(curve: Curve) -> Iterator[list[object]]:
    line = [getattr(curve, name) for name in LINE]
    bands = [None] * len(curve.x)
    columns = [bands if c is None else c.tolist() for c in _columns(curve)]
    for point in zip(*columns, strict=True):
        yield [*line, *point, curve.drawn, curve.log]


def _columns(curve: Curve) -> tuple[np.ndarray | None, ...]:
    return curve.x, curve.y, curve.low, curve.high


def _parts(rows: Iterable[list[str]]) -> Iterator[list[list[str]]]:
    """Yield the rows of each curve: they stand together."""
    part: list[list[str]] = []
    for row in rows:
        if len(row) != len(CURVES):
            raise ValueError(f"a row of {len(row)} cells among {len(CURVES)} columns")
        if part and _line(row) != _line(part[0]):
            yield part
            part = []
        part.append(row)
    if part:
        yield part


def _line(row: list[str]) -> list[str]:
    return [*row[: len(LINE)], *row[-2:]]


def _curve(rows: list[list[str]]) -> Curve:
    text = dict(zip((*LINE, "drawn", "log"), map(_unguarded, _line(rows[0])), strict=True))
    numbers = [[float(v) if v else None for v in row[len(LINE) : -2]] for row in rows]
    x, y, low, high = (np.array(column, np.float64) for column in zip(*numbers, strict=True))
    bands = {"low": low, "high": high} if any(n[2] is not None for n in numbers) else {}
    return Curve(x=x, y=y, **bands, **text)  # type: ignore[arg-type]


def _unguarded(text: str) -> str:
    return text.removeprefix(GUARD)
