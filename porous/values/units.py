"""The units of length that frames and meshes carry, and what they are in metres."""

from __future__ import annotations

from porous.errors import GridError

METRES = {"nm": 1e-9, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}


def check_unit(unit: str) -> str:
    """Return ``unit`` where it is known, else raise ``GridError`` listing what there is."""
    if unit not in METRES:
        raise GridError(f"unit: got {unit!r}; wanted one of {', '.join(METRES)}")
    return unit


def length_ratio(unit: str, target: str) -> float:
    """Return how many ``target`` units one ``unit`` is: ``length_ratio("cm", "mm")`` is 10."""
    return METRES[check_unit(unit)] / METRES[check_unit(target)]
