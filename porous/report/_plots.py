"""Curves as plots: what plotly draws, what stands there without it, and what both show in words."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from porous.report._definitions import definition
from porous.report._digits import number
from porous.report._svg import LEGEND, axis, drawing, look

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from porous.values import Curve

Floats = NDArray[np.float64]
Cell = tuple[str, str]

DRAWN_POINTS = 4000
"""Points of a line that are drawn; of longer ones every so many."""

SPREAD = "The band is one standard deviation of boxes of that size to either side of their mean."
SPREADS = {"representative_volume": SPREAD, "representative_surface": SPREAD}
"""What bands are that are no uncertainty."""

SHARE = re.compile(r"\b(?:share|part|porosity|probability|intruded pores)\b")
SIZE = re.compile(r"%|(?:1/)?(?:nm|um|mm|cm|m|in)[²³]?")
"""Names of what lies from nought to one, and units of what is never below nought."""

FEW = 3
"""Lines whose legend stands in one row above a plot; that of more stands below it."""

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
    band
        What their bands are, in a sentence; nothing where they have none.
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
    band: str


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
    shown = [clipped(thinned(line, DRAWN_POINTS)) for line in lines]
    rows, remark = _rows(lines)
    known = definition(first.name)
    return Plot(
        key=f"plot-{place}-{re.sub('[^a-z0-9]+', '-', first.name.casefold()).strip('-')}",
        title=_title(first, alone=alone),
        words=_words(lines),
        definition=known.name if known else "",
        svg=drawing(shown),
        figure={"data": _traces(shown), "layout": _layout(shown)},
        head=("series", axis(first.x_name, first.x_unit), axis(first.y_name, first.y_unit))
        + (("from", "to") if any(line.low is not None for line in lines) else ()),
        rows=rows,
        remark=remark,
        methods=tuple(dict.fromkeys(line.method for line in lines)),
        band=_band_words(lines),
    )


def _title(first: Curve, *, alone: bool) -> str:
    """Return the title of a plot; where others have its name, and other axes, it tells them."""
    title = first.name.replace("_", " ")
    if not alone:
        y = axis(first.y_name, "")
        title += f"{'' if y == title else f', {y}'} over {axis(first.x_name, '')}"
    return title[:1].upper() + title[1:]


def clipped(curve: Curve) -> Curve:
    """Return a curve whose band goes no further than its quantity can: to nought, or to one."""
    if curve.low is None or curve.high is None or not (curve.y[np.isfinite(curve.y)] >= 0).all():
        return curve
    share = curve.y_unit == "1" and SHARE.search(curve.y_name.casefold())
    if not share and not SIZE.fullmatch(curve.y_unit):
        return curve
    most = 1.0 if share and not (curve.y > 1).any() else math.inf
    return replace(curve, low=curve.low.clip(0.0, most), high=curve.high.clip(0.0, most))


def _band_words(lines: Sequence[Curve]) -> str:
    """Say what the bands of a plot are, if it has any."""
    if all(line.low is None for line in lines):
        return ""
    return SPREADS.get(lines[0].name, "Bands are one standard uncertainty wide to either side.")


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
    colour, dash, symbol = look(place)
    shape = "hv" if line.drawn == "steps" else "linear"
    trace: dict[str, Any] = {
        "type": "scatter",
        "name": plain(line.series),
        "x": numbers(line.x),
        "y": numbers(line.y),
        "mode": "markers" if line.drawn == "points" or len(line.x) == 1 else "lines",
        "line": {"color": colour, "dash": PLOTLY_DASH[dash], "shape": shape, "width": 2},
        "marker": {"color": colour, "symbol": symbol, "size": 8},
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
    tint = tuple(int(look(place)[0][i : i + 2], 16) for i in (1, 3, 5))
    fill = {"fill": "tonexty", "fillcolor": f"rgba{(*tint, 0.18)}"}
    return [{**same, "y": numbers(line.low)}, {**same, **fill, "y": numbers(line.high)}]


def _layout(lines: Sequence[Curve]) -> dict[str, Any]:
    first = lines[0]
    many = len(lines) > FEW
    legend = {"traceorder": "normal", "orientation": "h", "x": 0}
    legend |= {"y": -0.22, "yanchor": "top"} if many else {"y": 1.02, "yanchor": "bottom"}
    ys = [band for line in lines for band in (line.y, line.low, line.high) if band is not None]
    return {
        "autosize": True,
        "height": 340 + (LEGEND * len(lines) if many else 0),
        "margin": {"l": 70, "r": 20, "t": 20, "b": 60},
        "font": {"family": 'system-ui, "DejaVu Sans", sans-serif', "size": 14, "color": "#1d1d1d"},
        "paper_bgcolor": "#fff",
        "plot_bgcolor": "#fff",
        "showlegend": True,
        "legend": legend,
        "xaxis": _axis(first, "x", [line.x for line in lines]),
        "yaxis": _axis(first, "y", ys),
    }


def _axis(first: Curve, letter: str, values: Sequence[Floats]) -> dict[str, Any]:
    log = letter in first.log
    text = axis(getattr(first, f"{letter}_name"), getattr(first, f"{letter}_unit"))
    made: dict[str, Any] = {"title": {"text": plain(text)}, "type": "log" if log else "linear"}
    if not log and not any((part < 0).any() for part in values):
        made["rangemode"] = "nonnegative"
    return {**made, **AXIS}


def plain(text: str) -> str:
    """Return text that plotly takes as it stands: it reads tags in labels."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def numbers(values: Floats) -> list[float | None]:
    """Return what JSON can hold of numbers, to seven figures; nothing for what is not finite."""
    return [float(f"{v:.7g}") if math.isfinite(v) else None for v in values.tolist()]
