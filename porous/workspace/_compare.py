"""Folders that porous has filled, side by side on one page."""

from __future__ import annotations

import json
import math
from collections import Counter
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from porous import disk
from porous.errors import FormatError, RecipeError
from porous.pipeline import Result
from porous.report import Material, compare_html, material_of, read_curves
from porous.values import Measure, Measures
from porous.workspace._make import LAST

if TYPE_CHECKING:
    from collections.abc import Sequence

CURVES, RECIPE = "curves.csv", "recipe.toml"

WORDS = ("name", "unit", "method", "kind", "of")
NULLS = {"value": math.nan, "uncertainty": math.inf}
"""What a row of measures has: text, and numbers, with what null means of them."""

LARGEST = 1 << 28
"""Bytes of a file that is read; ours are far smaller."""


def compare(materials: Sequence[str | Path | Result], out: str | Path) -> None:
    """Write a page that has several materials side by side.

    Parameters
    ----------
    materials
        Two or more: folders that ``make`` or ``porous measure -o`` has filled, or results. All are
        held against the first.
    out
        The HTML file to write.

    Raises
    ------
    RecipeError
        For fewer than two materials.
    FormatError
        For a folder that porous has not filled, or what is damaged there.
    DiskError
        Where the disk refuses; what was there before is untouched.
    """
    if len(materials) < 2:
        raise RecipeError(f"compare: got {len(materials)} material; wanted two or more")
    labels = _labels(_names(materials))
    found = [_material(one, label) for one, label in zip(materials, labels, strict=True)]
    disk.write_bytes(out, compare_html(found).encode("utf-8"))


def _names(materials: Sequence[str | Path | Result]) -> list[str]:
    """Return what materials are called; other folders of one name are told by the one above."""
    places: dict[str, set[Path]] = {}
    for one in materials:
        if not isinstance(one, Result):
            places.setdefault(_name(one), set()).add(Path(one).absolute())
    return [
        _name(one) if isinstance(one, Result) or len(places[_name(one)]) == 1 else _above(Path(one))
        for one in materials
    ]


def _above(path: Path) -> str:
    return "/".join(path.absolute().parts[-2:]).lstrip("/")


def _name(one: str | Path | Result) -> str:
    if isinstance(one, Result):
        return (one.recipe.title if one.recipe else "") or "a body"
    return Path(one).absolute().name or str(one)


def _labels(names: Sequence[str]) -> list[str]:
    """Return a name of its own for each: those that are there twice are counted."""
    often, seen, labels = Counter(names), Counter[str](), list[str]()
    for name in names:
        seen[name] += 1
        labels.append(f"{name} ({seen[name]})" if often[name] > 1 else name)
    return labels


def _material(one: str | Path | Result, label: str) -> Material:
    return material_of(one, label) if isinstance(one, Result) else _read(Path(one), label)


def _read(folder: Path, label: str) -> Material:
    record = _record(folder)
    recipe = record.get("recipe") or {}
    text, curves = _content(folder / RECIPE), _content(folder / CURVES)
    return Material(
        label=label,
        title=str(recipe.get("title") or label),
        source=str(recipe.get("source") or ""),
        measures=_measures(folder / LAST, record),
        curves=read_curves(curves, str(folder / CURVES)) if curves is not None else (),
        recipe=(text or b"").decode("utf-8", "replace"),
        sha256=str(record.get("recipe_sha256") or ""),
        version=str(record["version"]),
        notes=tuple(map(str, record.get("notes") or ())),
    )


def _record(folder: Path) -> dict[str, Any]:
    """Return the content of ``measures.json``, its outer shape checked."""
    path = folder / LAST
    content = _content(path)
    if content is None:
        raise FormatError(
            f"{folder}: has no {LAST}; wanted a folder that porous make or porous measure -o has "
            "filled to the end"
        )
    try:
        record = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: is damaged: {error}; make the folder again") from None
    shapes = {"version": str, "measures": list, "recipe": dict | None, "notes": list | None}
    good = isinstance(record, dict) and all(
        isinstance(record.get(key), shape) for key, shape in shapes.items()
    )
    if not good:
        raise FormatError(
            f"{path}: is not what porous writes; wanted version, measures and recipe in it"
        )
    return record  # type: ignore[no-any-return]


def _content(path: Path) -> bytes | None:
    """Return the bytes of a file; None where there is none."""
    try:
        if path.stat().st_size > LARGEST:
            raise FormatError(f"{path}: has {path.stat().st_size} bytes; wanted {LARGEST} at most")
        return path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise FormatError(f"{path}: cannot be read: {_reason(error)}") from None


def _reason(error: OSError | ValueError) -> str:
    return str(getattr(error, "strerror", None) or error).lower()


def _measures(path: Path, record: dict[str, Any]) -> Measures:
    return Measures(tuple(_row(path, record, i, row) for i, row in enumerate(record["measures"])))


def _row(path: Path, record: dict[str, Any], place: int, row: Any) -> Measure:
    """Return a row of ``measures.json``; what is not finite stands there as null."""
    try:
        name, unit, method, kind, of = (_word(row[key]) for key in WORDS)
        value, half = (_finite(row[key], other) for key, other in NULLS.items())
        return Measure(name, value, unit, method, half, kind, of)
    except (TypeError, KeyError, ValueError, OverflowError) as error:
        why = f" ({error})" if str(error) else ""
        raise FormatError(
            f"{path}: measure {place + 1} is not as porous {version('porous')} writes it{why}; the "
            f"file says porous {record['version']}: make the folder again"
        ) from None


def _word(text: Any) -> str:
    if not isinstance(text, str):
        raise TypeError(f"got {text!r}; wanted text")
    return text


def _finite(number: Any, other: float) -> float:
    if number is None:
        return other
    if isinstance(number, bool) or not isinstance(number, int | float):
        raise TypeError(f"got {number!r}; wanted a number")
    return float(number)
