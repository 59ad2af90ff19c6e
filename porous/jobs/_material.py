"""Materials by name: one TOML each, figures with their units, read into mm, t, s and K."""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import TYPE_CHECKING

from porous.errors import MeshError, RecipeError, nearest
from porous.presets import material_names, material_path
from porous.toml import read_table
from porous.values import Material
from porous.values.job import PROCEDURES, PROPERTIES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "pressure": MappingProxyType(
            {
                "Pa": 1e-6,
                "kPa": 1e-3,
                "MPa": 1.0,
                "GPa": 1e3,
                "N/m2": 1e-6,
                "N/mm2": 1.0,
                "kN/mm2": 1e3,
                "psi": 6.894757293168e-3,
            }
        ),
        "density": MappingProxyType({"kg/m3": 1e-12, "g/cm3": 1e-9, "t/mm3": 1.0}),
        "conductivity": MappingProxyType(
            {"W/(m K)": 1.0, "W/m/K": 1.0, "mW/(mm K)": 1.0, "W/(mm K)": 1e3, "W/(cm K)": 1e2}
        ),
        "specific_heat": MappingProxyType(
            {"J/(kg K)": 1e6, "J/kg/K": 1e6, "kJ/(kg K)": 1e9, "J/(g K)": 1e9}
        ),
        "viscosity": MappingProxyType({"Pa s": 1e-6, "mPa s": 1e-9, "cP": 1e-9, "MPa s": 1.0}),
        "diffusivity": MappingProxyType({"m2/s": 1e6, "cm2/s": 1e2, "mm2/s": 1.0}),
    }
)
"""What one of each unit is in mm, t, s and K, by dimension; as ``_plain`` has them."""

SIGNS = str.maketrans({"·": " ", "⋅": " ", "*": " ", "²": "2", "³": "3", "^": None})
"""Signs of products and powers, as our own reports and others print them."""

TEXTS = ("title", "source")


def material(name: str) -> Material:
    """Return a material of the presets, in mm, t, s and K.

    Raises
    ------
    RecipeError
        For a name that is not there (lists what is), or a file with a key, a unit or a number
        that cannot be understood.
    """
    return read_material(material_path(name))


def read_material(path: Path) -> Material:
    """Return the material that a TOML file describes; its name is the file's.

    The file holds ``title``, ``source`` and what is known: ``youngs_modulus = "210 GPa"``,
    ``poissons_ratio = 0.3``, ``density = "7850 kg/m3"``, ``conductivity = "50 W/(m K)"``,
    ``specific_heat = "440 J/(kg K)"``, ``viscosity = "1 mPa s"``, ``diffusivity = "2e-9 m2/s"``.

    Raises
    ------
    RecipeError
        Naming file and key, what was got and what was wanted.
    """
    try:
        given = read_table(path)
    except RecipeError as error:
        raise RecipeError(f"{path}: cannot be read as a material: {error}") from None
    for key in given:
        if key not in (*TEXTS, *PROPERTIES):
            raise RecipeError(f"{path}: {key}: unknown key{nearest(key, (*TEXTS, *PROPERTIES))}")
    missing = [key for key in TEXTS if key not in given]
    if missing or not set(given) - set(TEXTS):
        wanted = " and ".join(missing) or f"some of {', '.join(PROPERTIES)}"
        raise RecipeError(f"{path}: a material lacks {wanted}")
    known = {key: _quantity(path, key, given[key]) for key in PROPERTIES if key in given}
    try:
        return Material(path.stem, source=str(given["source"]), **known)
    except MeshError as error:
        raise RecipeError(f"{path}: {error}") from None


def _quantity(path: Path, key: str, value: object) -> float:
    if PROPERTIES[key] == "number":
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            raise RecipeError(f"{path}: {key}: got {value!r}; wanted a number")
        return float(value)
    number, _, unit = str(value).strip().partition(" ")
    factors = UNITS[PROPERTIES[key]]
    try:
        known = float(number) * factors[_plain(unit)]
    except (ValueError, KeyError):
        raise RecipeError(
            f"{path}: {key}: got {value!r}; wanted a number and one of {', '.join(factors)}"
        ) from None
    if not 0 < known < math.inf:
        raise RecipeError(f"{path}: {key} = {value!r}; wanted more than zero")
    return known


def _plain(unit: str) -> str:
    """Return a unit with a space for each product and digits for powers."""
    return " ".join(unit.translate(SIGNS).split())


def check_known(found: Material, procedures: Iterable[str]) -> None:
    """Refuse a material that lacks what each of several procedures needs; name some that do not.

    Raises
    ------
    MeshError
        Names what it lacks for the first of them, and the presets that have it.
    """
    for procedure in procedures:
        if not _lacking(found, procedure):
            return
    for procedure in procedures:
        lacking = _lacking(found, procedure)[0]
        try:
            found.known(lacking)
        except MeshError as error:
            there = [name for name in material_names() if not _lacking(material(name), procedure)]
            raise MeshError(
                f"{error}; wanted one of {', '.join(there)}, or a file of your own"
            ) from None


def _lacking(found: Material, procedure: str) -> list[str]:
    return [name for name in PROCEDURES[procedure] if getattr(found, name) is None]
