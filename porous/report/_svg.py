"""Plain drawings of curves: what a page shows where no script runs, and on paper."""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import escape
from numpy.typing import NDArray

from porous.report._digits import unit_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from porous.values import Curve

Floats = NDArray[np.float64]

COLOURS = ("#0b5fa5", "#b34700", "#00704f", "#8a3a7f", "#1d1d1d", "#7a5a00")
"""Of lines: apart for the colour-blind too, and dark enough on white."""
DASHES = ("", "7 3", "2 3", "9 3 2 3", "12 4", "5 2 5 2 1 2")
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "x", "cross")

WIDTH, HEIGHT = 720, 400
LEFT, RIGHT, TOP, BOTTOM = 78, 14, 14, 52
LEGEND = 20
"""Height of a line of the legend."""
TICKS = 6

CAPITAL = re.compile("[A-Z][a-z]")
"""How a name begins that is no sign."""


def look(place: int) -> tuple[str, str, str]:
    """Return colour, dash and symbol of the line of that place; 36 differ."""
    turn = place + place // len(COLOURS)
    return COLOURS[place % len(COLOURS)], DASHES[turn % len(DASHES)], SYMBOLS[turn % len(SYMBOLS)]


@dataclass(frozen=True)
class Scale:
    """An axis: from numbers to places, and the numbers that stand beside it."""

    low: float
    high: float
    begin: float
    end: float
    log: bool

    def __call__(self, values: Floats) -> Floats:
        """Return where numbers lie; NaN for what has no place."""
        with np.errstate(divide="ignore", invalid="ignore"):
            given = np.log10(values) if self.log else np.asarray(values, np.float64)
        given = np.where(np.isfinite(given), given, np.nan)
        share = (given - self.low) / (self.high - self.low)
        return np.asarray(self.begin + np.clip(share, -0.5, 1.5) * (self.end - self.begin))

    def ticks(self) -> list[tuple[float, str]]:
        """Return places and what stands there."""
        step = _step((self.high - self.low) / TICKS)
        if self.log:
            step = max(1.0, math.ceil(step))
        first = math.ceil(self.low / step - 1e-9)
        last = math.floor(self.high / step + 1e-9)
        marks = [i * step for i in range(first, last + 1)]
        if self.log and len(marks) < 2:
            marks = [self.low, self.high]
        values = [10.0**m for m in marks] if self.log else marks
        places = self(np.array(values, np.float64)).tolist()
        return [
            (place, f"{value:.4g}".replace("-", "−"))
            for place, value in zip(places, values, strict=True)
        ]


def drawing(lines: Sequence[Curve]) -> str:
    """Return curves of the same axes as an SVG element; it has no words of its own for readers."""
    parts = list(_parts(lines))
    height = HEIGHT + LEGEND * len(lines)
    head = (
        f'<svg viewBox="0 0 {WIDTH} {height}" aria-hidden="true" focusable="false" '
        'font-size="14" font-family="system-ui, DejaVu Sans, sans-serif">'
    )
    return "".join((head, *parts, "</svg>"))


def _parts(lines: Sequence[Curve]) -> Iterator[str]:
    first = lines[0]
    across = _scale([line.x for line in lines], LEFT, WIDTH - RIGHT, log="x" in first.log)
    bands = [band for line in lines for band in (line.low, line.high) if band is not None]
    up = _scale([*(line.y for line in lines), *bands], HEIGHT - BOTTOM, TOP, log="y" in first.log)
    yield from _axes(across, up, first)
    for i, line in enumerate(lines):
        yield from _curve(line, across, up, i)
        yield _key(line, i)


def _scale(values: Sequence[Floats], begin: float, end: float, *, log: bool) -> Scale:
    flat = np.concatenate(list(values))
    flat = flat[np.isfinite(flat) & ((flat > 0) | (not log))]
    flat = np.log10(flat) if log else flat.clip(-1e300, 1e300)
    low, high = (float(flat.min()), float(flat.max())) if len(flat) else (0.0, 1.0)
    if high - low <= max(abs(low), abs(high), 1.0 if log else 1e-300) * 1e-9:
        pad = 0.5 if log or not low else abs(low) / 2
    else:
        pad = (high - low) * 0.03
    least = low - pad if log or low < 0 else max(low - pad, 0.0)
    return Scale(least, high + pad, begin, end, log)


def _step(raw: float) -> float:
    """Return one, two or five times a power of ten, not below ``raw``."""
    power = 10.0 ** math.floor(math.log10(raw))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= raw * (1 - 1e-9))


def _axes(across: Scale, up: Scale, first: Curve) -> Iterator[str]:
    bottom, right = HEIGHT - BOTTOM, WIDTH - RIGHT
    for place, text in across.ticks():
        yield f'<path d="M{place:.1f} {TOP}V{bottom}" stroke="#ddd"/>'
        yield f'<text x="{place:.1f}" y="{bottom + 18}" text-anchor="middle">{text}</text>'
    for place, text in up.ticks():
        yield f'<path d="M{LEFT} {place:.1f}H{right}" stroke="#ddd"/>'
        yield f'<text x="{LEFT - 6}" y="{place + 5:.1f}" text-anchor="end">{text}</text>'
    yield f'<path d="M{LEFT} {TOP}H{right}V{bottom}H{LEFT}Z" fill="none" stroke="#444"/>'
    names = [axis(first.x_name, first.x_unit), axis(first.y_name, first.y_unit)]
    middle = (LEFT + right) / 2
    yield f'<text x="{middle}" y="{bottom + 42}" text-anchor="middle">{escape(names[0])}</text>'
    middle = (TOP + bottom) / 2
    turned = f"translate(16 {middle}) rotate(-90)"
    yield f'<text transform="{turned}" text-anchor="middle">{escape(names[1])}</text>'


def axis(name: str, unit: str) -> str:
    """Return what stands beside an axis."""
    said = name.replace("_", " ")
    if CAPITAL.match(said):
        said = said[0].lower() + said[1:]
    return said if unit in ("1", "") else f"{said} / {unit_text(unit)}"


def _curve(line: Curve, across: Scale, up: Scale, place: int) -> Iterator[str]:
    colour, dash, _ = look(place)
    steps = line.drawn == "steps"
    x = across(line.x)
    if line.low is not None and line.high is not None:
        low, high = _path(x, up(line.low), steps=steps), _path(x, up(line.high), steps=steps)
        if line.drawn == "points":
            ends = np.stack([x, up(line.low), up(line.high)], axis=1)
            ends = ends[np.isfinite(ends).all(axis=1)]
            bars = "".join(f"M{a:.1f} {b:.1f}V{c:.1f}" for a, b, c in ends.tolist())
            yield f'<path d="{bars}" stroke="{colour}"/>'
        elif low and high:
            points = " ".join(f"{a:.1f},{b:.1f}" for a, b in (*low, *reversed(high)))
            yield f'<polygon points="{points}" fill="{colour}" fill-opacity="0.18"/>'
    path = _path(x, up(line.y), steps=steps)
    if line.drawn == "points" or len(path) == 1:
        yield from (f'<circle cx="{a:.1f}" cy="{b:.1f}" r="4" fill="{colour}"/>' for a, b in path)
    elif path:
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in path)
        yield (
            f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2" '
            f'stroke-dasharray="{dash}"/>'
        )


def _path(x: Floats, y: Floats, *, steps: bool) -> list[tuple[float, float]]:
    """Return the places of a line that there are; a step goes on to the next before it rises."""
    there = np.isfinite(x) & np.isfinite(y)
    path = list(zip(x[there].tolist(), y[there].tolist(), strict=True))
    if not steps:
        return path
    corners = [(b[0], a[1]) for a, b in itertools.pairwise(path)]
    woven = [point for pair in zip(path, corners, strict=False) for point in pair]
    return [*woven, *path[-1:]]


def _key(line: Curve, place: int) -> str:
    colour, dash, _ = look(place)
    y = HEIGHT + LEGEND * place + 8
    mark = (
        f'<path d="M{LEFT} {y}h36" stroke="{colour}" stroke-width="2" stroke-dasharray="{dash}"/>'
    )
    if line.drawn == "points":
        mark = f'<circle cx="{LEFT + 18}" cy="{y}" r="4" fill="{colour}"/>'
    return f'{mark}<text x="{LEFT + 46}" y="{y + 5}">{escape(line.series)}</text>'
