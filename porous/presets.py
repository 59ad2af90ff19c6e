"""Where presets are found: beside the package in a checkout, inside it once installed."""

from __future__ import annotations

from pathlib import Path

from porous.errors import RecipeError, nearest

SUFFIX = ".toml"


def folder() -> Path:
    """Return the folder of presets."""
    installed = Path(__file__).parent / "_presets"
    return installed if installed.is_dir() else Path(__file__).parent.parent / "presets"


def names() -> tuple[str, ...]:
    """Return the names of the presets, sorted."""
    return tuple(sorted(path.stem for path in folder().glob(f"*{SUFFIX}")))


def path_of(name: str) -> Path:
    """Return the path of a preset, or raise ``RecipeError`` naming what there is."""
    if name not in names():
        raise RecipeError(f"no preset {name!r}{nearest(name, names())}")
    return folder() / f"{name}{SUFFIX}"


def material_names() -> tuple[str, ...]:
    """Return the names of the materials, sorted."""
    return tuple(sorted(path.stem for path in (folder() / "materials").glob(f"*{SUFFIX}")))


def material_path(name: str) -> Path:
    """Return the path of a material, or raise ``RecipeError`` naming what there is."""
    if name not in material_names():
        raise RecipeError(f"no material {name!r}{nearest(name, material_names())}")
    return folder() / "materials" / f"{name}{SUFFIX}"
