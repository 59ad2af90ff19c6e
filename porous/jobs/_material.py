"""Materials by name: one TOML each, figures with their units, read into mm-N-MPa."""

from __future__ import annotations

import tomllib
from types import MappingProxyType
from typing import TYPE_CHECKING

from porous.errors import MeshError, RecipeError
from porous.presets import material_path
from porous.values import Material

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "youngs_modulus": MappingProxyType(
            {"Pa": 1e-6, "kPa": 1e-3, "MPa": 1.0, "GPa": 1e3, "psi": 6.894757293168e-3}
        ),
        "density": MappingProxyType(
            {"kg/m3": 1e-12, "kg/m³": 1e-12, "g/cm3": 1e-9, "g/cm³": 1e-9, "t/mm3": 1.0}
        ),
    }
)
"""What one of each unit is in MPa and in t/mm³."""

KEYS = ("title", "source", "youngs_modulus", "poissons_ratio", "density")


def material(name: str) -> Material:
    """Return a material of the presets, in mm-N-MPa.

    Raises
    ------
    RecipeError
        For a name that is not there (lists what is), or a file with a key, a unit or a number
        that cannot be understood.
    """
    return read_material(material_path(name))


def read_material(path: Path) -> Material:
    """Return the material that a TOML file describes; its name is the file's.

    The file holds ``youngs_modulus = "210 GPa"``, ``poissons_ratio = 0.3``,
    ``density = "7850 kg/m3"``, ``title`` and ``source``.

    Raises
    ------
    RecipeError
        Naming file and key, what was got and what was wanted.
    """
    try:
        given = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise RecipeError(f"{path}: cannot be read as a material: {error}") from None
    unknown, missing = sorted(set(given) - set(KEYS)), sorted(set(KEYS) - set(given))
    if unknown or missing:
        raise RecipeError(
            f"{path}: unknown keys {unknown}, missing keys {missing}; wanted {', '.join(KEYS)}"
        )
    ratio = given["poissons_ratio"]
    if not isinstance(ratio, (int, float)) or isinstance(ratio, bool):
        raise RecipeError(f"{path}: poissons_ratio: got {ratio!r}; wanted a number")
    try:
        return Material(
            path.stem,
            _quantity(path, "youngs_modulus", given),
            float(ratio),
            _quantity(path, "density", given),
            str(given["source"]),
        )
    except MeshError as error:
        raise RecipeError(f"{path}: {error}") from None


def _quantity(path: Path, key: str, given: Mapping[str, object]) -> float:
    number, _, unit = str(given[key]).strip().partition(" ")
    factors = UNITS[key]
    try:
        return float(number) * factors[unit.strip()]
    except (ValueError, KeyError):
        raise RecipeError(
            f"{path}: {key}: got {given[key]!r}; wanted a number and one of {', '.join(factors)}"
        ) from None
