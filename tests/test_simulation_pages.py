"""The pages on simulations say what the code does: keys, defaults, decks, materials, measures."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from porous import jobs
from porous.formats import formats
from porous.jobs import material, sections
from porous.jobs._material import UNITS
from porous.jobs._section import SimulationSection
from porous.presets import material_names
from porous.toml import parse_value
from porous.values.job import PROCEDURES, PROPERTIES

DOCS = Path(__file__).parent.parent / "docs"
SIMULATE = (DOCS / "simulate.md").read_text(encoding="utf-8")
MEASURES = (DOCS / "measures.md").read_text(encoding="utf-8")
ANY = r"\w+"
MAKERS = {"Measure", "solved"}
"""What makes a measure, its name first."""


def rows(page, heads):
    """Cells of the rows of the table with these heads."""
    head = "| " + " | ".join(heads) + " |\n"
    assert page.count(head) == 1, f"no table {heads}"
    lines = page.partition(head)[2].splitlines()[1:]
    end = next(i for i, line in enumerate(lines) if not line.startswith("|"))
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[:end]]


def told(cell):
    """What stands between grave accents."""
    return re.findall(r"`([^`]+)`", cell)


def keys():
    table = rows(SIMULATE, ["analysis", "key", "default", "says"])
    found = {(of, told(key)[0]): (default, says) for of, key, default, says in table}
    assert len(found) == len(table)
    return found


def own(section):
    """Keys that an analysis adds, or that it takes otherwise than all do."""
    common = SimulationSection.model_fields
    return {
        key: field
        for key, field in section.model_fields.items()
        if key != "analysis"
        and (key not in common or (field.default, field.annotation) != _as(common[key]))
    }


def _as(field):
    return field.default, field.annotation


def test_every_key_of_every_analysis_is_on_the_page_and_no_other():
    wanted = {("all", key) for key in ("analysis", *SimulationSection.model_fields)}
    wanted |= {(name, key) for name, of in sections().items() for key in own(of)}
    assert set(keys()) == wanted
    assert set(told(keys()["all", "analysis"][1])) == {f'"{name}"' for name in sections()}


@pytest.mark.parametrize("name", sorted(sections()))
def test_defaults_are_as_the_page_says(name):
    settled = sections()[name](analysis=name)
    for (of, key), (default, _) in keys().items():
        if of == name or (of == "all" and key not in own(sections()[name]) and key != "analysis"):
            given = getattr(settled, key)
            given = list(given) if isinstance(given, tuple) else given
            assert given == (None if default == "none" else parse_value(told(default)[0], key)), key


def test_decks_are_those_that_hold_the_steps():
    table = rows(SIMULATE, ["analysis", "unasked", "by `decks`"])
    assert {name for name, _, _ in table} == set(sections())
    for name, unasked, others in table:
        section = sections()[name]
        assert told(unasked) == [section.DECK]
        held = {f.suffix[1:] for f in formats() if set(section.PROCEDURES) <= set(f.procedures)}
        assert set(told(others)) == (set() if name == "homogenisation" else held - {section.DECK})


def test_materials_and_what_they_serve_are_as_the_page_says():
    table = rows(SIMULATE, ["for", "names"])
    assert {one for _, names in table for one in told(names)} == set(material_names())
    for uses, names in table:
        analyses = [name for name in sections() if name in uses]
        assert analyses, uses
        for one in told(names):
            needed = {p for name in analyses for p in sections()[name].PROCEDURES}
            if one == "pla":
                needed.remove("conduction")
            assert all(
                getattr(material(one), key) is not None for p in needed for key in PROCEDURES[p]
            )


def test_units_of_materials_are_as_the_page_says():
    table = rows(SIMULATE, ["key", "units", "needed for"])
    assert {told(key)[0] for key, _, _ in table} == set(PROPERTIES)
    for key, units, _ in table:
        known = UNITS.get(PROPERTIES[told(key)[0]])
        if known is not None:
            assert units.removesuffix("; dynamic").split(", ") == list(known)


def measured():
    """Pattern of the name, and unit where it stands there, of each measure of a solved job."""
    folder = Path(jobs.__file__).parent
    for path in (*folder.glob("*.py"), folder.parent / "workspace" / "_solve.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            parts = ()
            if isinstance(node, ast.Yield) and isinstance(node.value, ast.Tuple):
                parts = node.value.elts
            elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in MAKERS:
                parts = node.args
            if len(parts) >= 3 and (pattern := pattern_of(parts[0])):
                yield pattern, getattr(parts[2], "value", None)
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "name":
                yield pattern_of(node.value), None


def pattern_of(node):
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(
            part.value if isinstance(part, ast.Constant) else ANY for part in node.values
        )
    return ""


def test_every_measure_of_a_solved_job_is_on_the_page_and_no_other():
    table = {told(name)[0]: unit for name, unit, _ in rows(MEASURES, ["name", "unit", "of what"])}
    found = {pattern: unit for pattern, unit in measured() if pattern}
    assert len(found) > 10
    for pattern, unit in found.items():
        hits = [name for name in table if re.fullmatch(pattern, name)]
        assert hits, pattern
        assert unit is None or any(table[name] == unit for name in hits), pattern
    for name in table:
        assert any(re.fullmatch(pattern, name) for pattern in found), name
