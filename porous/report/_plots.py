"""Curves as plots: what plotly draws, what stands there without it, and what both show in words."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from porous.report._definitions import definition
from porous.report._digits import number
from porous.report._svg import COLOURS, DASHES, SYMBOLS, drawing

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from porous.values import Curve

Floats = NDArray[np.float64]
Cell = tuple[str, str]

DRAWN_POINTS = 4000
"""Points of a line that are drawn; of longer ones every so many."""

LISTED = 200
"""Rows of the table beside a plot."""

AXIS = {"showline": True, "mirror": True, "linecolor": "#444", "gridcolor": "#ddd"}
AXIS |= {"ticks": "outside", "exponentformat": "power"}
PLOTLY_DASH = {"": "solid", "7 3": "7px,3px", "2 3": "2px,3px", "9 3 2 3": "9px,3px,2px,3px"}
PLOTLY_DASH |= {"12 4": "12px,4px", "5 2 5 2 1 2": "5px,2px,5px,2px,1px,2px"}


@dataclass(frozen=True)
class Plot:
    """One plot of the page.

    Parameters
    ----------
    key
        For the page's own use: letters, digits and hyphens.
    title, words
        For people: what it is, and what it shows, in sentences.
    definition
        The name under which the page of measures defines it, or nothing.
    svg
        As it stands without scripts and on paper.
    figure
        What plotly is given.
    head, rows, remark
        The numbers by series, as they are read and in full, and what was left out of them.
    methods
        How the lines were found.
    """

    key: str
    title: str
    words: str
    definition: str
    svg: str
    figure: dict[str, Any]
    head: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]
    remark: str
    methods: tuple[str, ...]


def plots(curves: Iterable[Curve]) -> tuple[Plot, ...]:
    """Return a plot for each name of curves and kind of axes, in their order."""
    together: dict[tuple[str, ...], list[Curve]] = {}
    for curve in curves:
        axes = (curve.x_name, curve.x_unit, curve.y_name, curve.y_unit, curve.log)
        together.setdefault((curve.name, *axes), []).append(curve)
    named = Counter(name for name, *_ in together)
    return tuple(
        _plot(lines, place, alone=named[lines[0].name] == 1)
        for place, lines in enumerate(together.values(), 1)
    )


def _plot(lines: Sequence[Curve], place: int, *, alone: bool) -> Plot:
    first = lines[0]
    shown = [thinned(line, DRAWN_POINTS) for line in lines]
    rows, remark = _rows(lines)
    title = first.name.replace("_", " ")
    if not alone:  # others have its name, and other axes
        title += f", {axis(first.y_name, first.y_unit)} over {axis(first.x_name, first.x_unit)}"
    known = definition(first.name)
    return Plot(
        key=f"plot-{place}-{re.sub('[^a-z0-9]+', '-', first.name.casefold()).strip('-')}",
        title=title[:1].upper() + title[1:],
        words=_words(lines),
        definition=known.name if known else "",
        svg=drawing(shown),
        figure={"data": _traces(shown), "layout": _layout(first)},
        head=("series", axis(first.x_name, first.x_unit), axis(first.y_name, first.y_unit))
        + (("from", "to") if any(line.low is not None for line in lines) else ()),
        rows=rows,
        remark=remark,
        methods=tuple(dict.fromkeys(line.method for line in lines)),
    )


def axis(name: str, unit: str) -> str:
    """Return what stands beside an axis."""
    said = name.replace("_", " ")
    return said if unit in ("1", "") else f"{said} / {unit}"


def thinned(curve: Curve, most: int) -> Curve:
    """Return a curve with no more points than that: its first, its last and every so many."""
    if len(curve.x) <= most:
        return curve
    keep = np.unique(np.linspace(0, len(curve.x) - 1, most).round().astype(np.int64))
    low = None if curve.low is None else curve.low[keep]
    high = None if curve.high is None else curve.high[keep]
    fields = {name: getattr(curve, name) for name in curve.__dataclass_fields__}
    fields |= {"x": curve.x[keep], "y": curve.y[keep], "low": low, "high": high}
    return type(curve)(**fields)


def _rows(lines: Sequence[Curve]) -> tuple[tuple[tuple[str, tuple[Cell, ...]], ...], str]:
    """Return the numbers of a plot, so many as a reader can take in, and what is left out."""
    most = max(1, LISTED // len(lines))
    banded = any(line.low is not None for line in lines)
    rows = []
    for few in (thinned(line, most) for line in lines[:LISTED]):
        bands = (few.low, few.high) if banded else ()
        columns = [
            [("—", "nan")] * len(few.x) if column is None else list(map(_cell, column.tolist()))
            for column in (few.x, few.y, *bands)
        ]
        rows += [(few.series, cells) for cells in zip(*columns, strict=True)]
    total = sum(len(line.x) for line in lines)
    remark = "" if len(rows) == total else f"{len(rows)} of {total} points; curves.csv has all."
    return tuple(rows), remark


def _cell(value: float) -> Cell:
    return number(value), repr(value)


def _words(lines: Sequence[Curve]) -> str:
    """Say what a plot shows to who cannot see it."""
    first = lines[0]
    said = [f"{axis(first.y_name, first.y_unit)} over {axis(first.x_name, first.x_unit)}"]
    if first.log:
        which = " and ".join(first.log)
        said[0] += f", {which} on {'logarithmic axes' if len(first.log) > 1 else 'a log axis'}"
    said += [_line_words(line) for line in lines[:6]]
    if len(lines) > 6:
        said.append(f"and {len(lines) - 6} more lines")
    return ". ".join(said) + "."


def _line_words(line: Curve) -> str:
    y = np.where(np.isfinite(line.y), line.y, np.nan)
    count = f"{len(line.x)} value{'s' if len(line.x) > 1 else ''}"
    if not np.isfinite(y).any():
        return f"{line.series}: {count}, none of them finite"
    top = int(np.nanargmax(y))
    return (
        f"{line.series}: {count} for {_short(line.x.min())} to {_short(line.x.max())}, from "
        f"{_short(np.nanmin(y))} to {_short(np.nanmax(y))}, median {_short(np.nanmedian(y))}, "
        f"greatest at {_short(line.x[top])}"
    )


def _short(value: float) -> str:
    return f"{value:.4g}".replace("-", "−") if math.isfinite(value) else number(float(value))


# --- plotly --------------------------------------------------------------------------------


def _traces(lines: Sequence[Curve]) -> list[dict[str, Any]]:
    return [trace for i, line in enumerate(lines) for trace in (*_band(line, i), _line(line, i))]


def _line(line: Curve, place: int) -> dict[str, Any]:
    colour = COLOURS[place % len(COLOURS)]
    dash = PLOTLY_DASH[DASHES[place % len(DASHES)]]
    shape = "hv" if line.drawn == "steps" else "linear"
    trace: dict[str, Any] = {
        "type": "scatter",
        "name": plain(line.series),
        "x": numbers(line.x),
        "y": numbers(line.y),
        "mode": "markers" if line.drawn == "points" or len(line.x) == 1 else "lines",
        "line": {"color": colour, "dash": dash, "shape": shape, "width": 2},
        "marker": {"color": colour, "symbol": SYMBOLS[place % len(SYMBOLS)], "size": 8},
    }
    if line.drawn == "points" and line.low is not None and line.high is not None:
        above, below = numbers(line.high - line.y), numbers(line.y - line.low)
        trace["error_y"] = {"type": "data", "array": above, "arrayminus": below, "color": colour}
    return trace


def _band(line: Curve, place: int) -> list[dict[str, Any]]:
    """Return what fills the band of a line: its lower edge, and its upper one filled down to it."""
    if line.low is None or line.high is None or line.drawn == "points":
        return []
    shape = "hv" if line.drawn == "steps" else "linear"
    same: dict[str, Any] = {
        "type": "scatter",
        "mode": "lines",
        "line": {"width": 0, "shape": shape},
        "hoverinfo": "skip",
        "showlegend": False,
        "x": numbers(line.x),
    }
    tint = tuple(int(COLOURS[place % len(COLOURS)][i : i + 2], 16) for i in (1, 3, 5))
    fill = {"fill": "tonexty", "fillcolor": f"rgba{(*tint, 0.18)}"}
    return [{**same, "y": numbers(line.low)}, {**same, **fill, "y": numbers(line.high)}]


def _layout(first: Curve) -> dict[str, Any]:
    kinds = {name: "log" if name in first.log else "linear" for name in "xy"}
    x, y = axis(first.x_name, first.x_unit), axis(first.y_name, first.y_unit)
    return {
        "autosize": True,
        "height": 340,
        "margin": {"l": 70, "r": 20, "t": 20, "b": 60},
        "font": {"family": 'system-ui, "DejaVu Sans", sans-serif', "size": 14, "color": "#1d1d1d"},
        "paper_bgcolor": "#fff",
        "plot_bgcolor": "#fff",
        "showlegend": True,
        "legend": {
            "traceorder": "normal",
            "orientation": "h",
            "y": 1.02,
            "yanchor": "bottom",
            "x": 0,
        },
        "xaxis": {"title": {"text": plain(x)}, "type": kinds["x"], **AXIS},
        "yaxis": {"title": {"text": plain(y)}, "type": kinds["y"], **AXIS},
    }


def plain(text: str) -> str:
    """Return text that plotly takes as it stands: it reads tags in labels."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def numbers(values: Floats) -> list[float | None]:
    """Return what JSON can hold of numbers, to seven figures; nothing for what is not finite."""
    return [float(f"{v:.7g}") if math.isfinite(v) else None for v in values.tolist()]
