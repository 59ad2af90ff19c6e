"""The units of length that frames and meshes carry, and what they are in metres."""

from __future__ import annotations

from porous.errors import GridError, MeshError

METRES = {"nm": 1e-9, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}


def check_unit(unit: str) -> str:
    """Return ``unit`` where it is known, else raise ``GridError`` listing what there is."""
    if unit not in METRES:
        raise GridError(f"unit: got {unit!r}; wanted one of {', '.join(METRES)}")
    return unit


def length_ratio(unit: str, target: str) -> float:
    """Return how many ``target`` units one ``unit`` is: ``length_ratio("cm", "mm")`` is 10."""
    return METRES[check_unit(unit)] / METRES[check_unit(target)]


SYSTEMS = ("mm-N-MPa", "m-SI")
"""Systems of units that decks are written in: mm, t, s, K with N and MPa; or m, kg, s, K."""
DIMENSIONS: dict[str, tuple[int, int, int, int]] = {
    "number": (0, 0, 0, 0),
    "length": (1, 0, 0, 0),
    "pressure": (-1, 1, -2, 0),
    "force": (1, 1, -2, 0),
    "energy": (2, 1, -2, 0),
    "density": (-3, 1, 0, 0),
    "conductivity": (1, 1, -3, -1),
    "specific_heat": (2, 0, -2, -1),
    "viscosity": (-1, 1, -1, 0),
    "diffusivity": (2, 0, -1, 0),
    "velocity": (1, 0, -1, 0),
    "power": (2, 1, -3, 0),
    "temperature": (0, 0, 0, 1),
}
"""Exponents of length, mass, time and temperature; the latter two are s and K in both systems."""


def check_system(system: str) -> str:
    """Return ``system`` where it is known, else raise ``MeshError`` listing what there is."""
    if system not in SYSTEMS:
        raise MeshError(f"units: got {system!r}; wanted one of {', '.join(SYSTEMS)}")
    return system


def system_ratio(system: str, dimension: str) -> float:
    """Return how many units of ``system`` one unit in mm-t-s-K is: ``("m-SI", "pressure")`` 1e6."""
    length, mass, _, _ = DIMENSIONS[dimension]
    thousand = 1 if check_system(system) == SYSTEMS[1] else 0
    return float(10.0 ** (3 * thousand * (mass - length)))


def system_length(system: str) -> str:
    """Return the unit of length of a system: mm or m."""
    return check_system(system).partition("-")[0]
