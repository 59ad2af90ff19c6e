"""Colours of a scale from little to much: as far apart to the eye, also to one that sees two."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

COUNT = 64

LIGHTNESS = (0.30, 0.90)
"""From dark to light in equal steps: it can be read without any colour."""

HUE = (300.0, 100.0)
"""From violet over blue and green to yellow, in degrees."""

CHROMA = 0.15
"""At most; less where a screen cannot show it."""

TO_CONES = (
    (1.0, 0.3963377774, 0.2158037573),
    (1.0, -0.1055613458, -0.0638541728),
    (1.0, -0.0894841775, -1.2914855480),
)
TO_LIGHT = (
    (4.0767416621, -3.3077115913, 0.2309699292),
    (-1.2684380046, 2.6097574011, -0.3413193965),
    (-0.0041960863, -0.7034186147, 1.7076147010),
)
"""From Oklab to what cones see, and from that to red, green and blue (Ottosson 2020)."""


def colours(count: int = COUNT) -> NDArray[np.uint8]:
    """Return red, green and blue, shape (count, 3), each 0 … 255, in equal steps of lightness."""
    light = np.linspace(*LIGHTNESS, count)
    hue = np.radians(np.linspace(*HUE, count))
    low, high = np.zeros(count), np.full(count, CHROMA)
    for _ in range(30):  # halving: the most chroma that a screen can show
        middle = (low + high) / 2
        rgb = _linear(light, middle, hue)
        inside = ((rgb >= 0) & (rgb <= 1)).all(axis=1)
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    rgb = np.clip(_linear(light, _gentle(low), hue), 0, 1)
    bent = np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * bent), np.uint8)


def _gentle(chroma: Floats) -> Floats:
    """Return chroma without sudden turns, nowhere more: the mean of what is least about."""
    about = len(chroma) // 12
    wide = np.pad(chroma, 2 * about, mode="edge")
    least = np.lib.stride_tricks.sliding_window_view(wide, 2 * about + 1).min(axis=1)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(least, 2 * about + 1).mean(axis=1))


def _linear(light: Floats, chroma: Floats, hue: Floats) -> Floats:
    lab = np.stack([light, chroma * np.cos(hue), chroma * np.sin(hue)], axis=1)
    return np.asarray((lab @ np.array(TO_CONES).T) ** 3 @ np.array(TO_LIGHT).T)
