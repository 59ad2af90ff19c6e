"""Recipes: what they mean when little is said, how they are changed, written and read again."""

from __future__ import annotations

import json
import pickle
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from porous import presets, recipe
from porous.errors import RecipeError, nearest
from porous.recipe import Recipe, assignment, dump, load, parse, schema

PLAIN = {
    "model": {
        "kind": "ifs",
        "level": 1,
        "digits": {"divisions": 2, "keep": [[0, 0, 0], [1, 1, 0]]},
    }
}
HALF = [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]]
TETRAHEDRON = """v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""


@pytest.mark.parametrize("name", presets.names())
def test_a_recipe_written_in_full_is_the_same_recipe(name, tmp_path):
    first = load(name)
    path = tmp_path / "elsewhere.toml"
    path.write_text(dump(first), encoding="utf-8")
    again = load(path)
    assert again == first
    assert dump(again) == dump(first)
    assert again.sha256 == first.sha256
    assert pickle.loads(pickle.dumps(first)) == first


def test_what_is_not_said_is_settled():
    plain = parse(PLAIN)
    assert plain.voxels.per_feature == 4
    assert plain.voxels.sampling == "fill"
    assert plain.surface.method == plain.volume.method == "auto"
    assert plain.simulation is None
    said = tomllib.loads(dump(plain))
    assert said["model"]["unit"] == "mm"
    assert said["voxels"]["per_feature"] == 4
    assert "spacing" not in said["voxels"]


def test_the_limit_is_covered_unless_it_has_an_offset():
    limit = {**PLAIN, "voxels": {"voxels": 20}}
    limit["model"] = {**PLAIN["model"], "level": "limit"}
    assert parse(limit).voxels.sampling == "cover"
    limit["model"] = {**limit["model"], "offset": 0.1}
    assert parse(limit).voxels.sampling == "fill"
    limit["voxels"] = {"voxels": 20, "sampling": "centre"}
    assert parse(limit).voxels.sampling == "centre"


def test_the_limit_needs_a_resolution():
    with pytest.raises(RecipeError, match=r"voxels\.per_feature.*voxels\.voxels = 100"):
        parse({"model": {**PLAIN["model"], "level": "limit"}})


@pytest.mark.parametrize(
    ("key", "value", "gone"),
    [
        ("voxels.voxels", 40, ("per_feature", "spacing")),
        ("voxels.spacing", 0.1, ("per_feature", "voxels")),
        ("voxels.per_feature", 2, ("spacing", "voxels")),
    ],
)
@pytest.mark.parametrize("before", ["voxels = 30", "spacing = [0.1, 0.2, 0.3]", "per_feature = 3"])
def test_alternatives_displace_each_other(key, value, gone, before, tmp_path):
    path = written(tmp_path, f"[voxels]\n{before}\n")
    voxels = load(path, set={key: value}).voxels
    assert getattr(voxels, key.partition(".")[2]) is not None
    assert all(getattr(voxels, name) is None for name in gone)


@pytest.mark.parametrize(
    ("analysis", "one", "other"),
    [("compression", "pressure", "strain"), ("flow", "pressure_drop", "velocity")],
)
def test_one_load_displaces_the_other(analysis, one, other, tmp_path):
    for before, after in ((one, other), (other, one)):
        lines = f'[simulation]\nanalysis = "{analysis}"\n{before} = 0.5\n'
        section = load(written(tmp_path, lines), set={f"simulation.{after}": 0.25}).simulation
        assert (getattr(section, before), getattr(section, after)) == (None, 0.25)


def test_a_setting_beside_what_is_no_table_is_refused(tmp_path):
    path = written(tmp_path)
    path.write_text(f"simulation = 3\n{path.read_text()}")
    with pytest.raises(RecipeError, match="strain"):
        load(path, set={"simulation.strain": 0.1, "simulation.stran": 1})


def test_maps_displace_digits_and_digits_maps(tmp_path):
    path = written(tmp_path)
    one = [{"matrix": HALF, "translation": [0.0, 0.0, 0.0]}]
    with_maps = tomllib.loads(dump(load(path, set={"model.maps": one})))["model"]
    assert "digits" not in with_maps
    path.write_text(dump(load(path, set={"model.maps": one})), encoding="utf-8")
    digits = {"divisions": 3, "keep": "menger"}
    assert "maps" not in tomllib.loads(dump(load(path, set={"model.digits": digits})))["model"]
    with pytest.raises(RecipeError, match="keep: got nothing"):
        load(path, set={"model.digits.divisions": 3})


def test_settings_reach_into_arrays_and_replace_plain_values(tmp_path):
    path = written(tmp_path)
    changed = load(path, set={"model.digits.keep.1": [1, 0, 1], "model.level.size": 0.3})
    model = tomllib.loads(dump(changed))["model"]
    assert model["digits"]["keep"] == [[0, 0, 0], [1, 0, 1]]
    assert model["level"] == {"size": 0.3}


def test_expectations_are_of_the_recipe_as_it_was(tmp_path):
    path = written(tmp_path, "[expect]\nporosity = { value = 0.5, tolerance = 0.1 }\n")
    assert load(path).expect["porosity"].value == 0.5
    assert load(path, set={"model.level": 2}).expect == {}
    kept = load(path, set={"model.level": 2, "expect.porosity.value": 0.7})
    assert kept.expect["porosity"].value == 0.7
    assert kept.expect["porosity"].tolerance == 0.1


def test_files_are_found_beside_the_recipe_and_then_among_the_presets(tmp_path, monkeypatch):
    path = written(tmp_path, 'primitive = { mesh = "part.obj" }\n')
    (tmp_path / "part.obj").write_text(TETRAHEDRON)
    monkeypatch.chdir("/")
    assert recipe.files(load(path)) == {"model.primitive.mesh": (tmp_path / "part.obj").resolve()}
    shipped = next(file for file in presets.folder().iterdir() if file.suffix == ".obj")
    path = written(tmp_path, f'primitive = {{ mesh = "{shipped.name}" }}\n')
    assert recipe.files(load(path)) == {"model.primitive.mesh": shipped.resolve()}


def test_files_can_be_exchanged():
    crosses = load("menger-crosses")
    local = recipe.with_files(crosses, {"model.primitive.mesh": Path("mesh.obj")})
    assert recipe.files(local) == {"model.primitive.mesh": Path("mesh.obj")}
    assert recipe.with_files(local, recipe.files(crosses)) == crosses


def test_a_path_and_a_name_are_told_apart(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "menger").mkdir()
    assert recipe.find("menger") == presets.path_of("menger")
    assert recipe.find("./menger") == Path("./menger")
    assert recipe.find("x.toml") == Path("x.toml")
    (tmp_path / "mine").write_text(dump(load("menger")))
    assert load("mine") == load("menger")
    with pytest.raises(RecipeError, match="no preset 'mengr'; did you mean 'menger'"):
        recipe.find("mengr")


def test_the_schema_knows_every_key_of_every_preset():
    found = schema()
    json.dumps(found)
    known = set(found["properties"])
    assert known == set(Recipe.model_fields)
    parts = [
        found["$defs"][ref["$ref"].rpartition("/")[2]]
        for ref in found["properties"]["model"]["oneOf"]
    ]
    kinds = {part["properties"]["kind"]["const"]: part["properties"] for part in parts}
    assert list(kinds) == list(recipe.sections())
    for name in presets.names():
        table = tomllib.loads(dump(load(name)))
        assert set(table) <= known
        assert set(table["model"]) <= set(kinds[table["model"]["kind"]])


def test_every_reference_of_the_schema_leads_somewhere():
    found = schema()

    def references(part):
        if isinstance(part, dict):
            if "$ref" in part:
                yield part["$ref"]
            for inner in part.values():
                yield from references(inner)
        elif isinstance(part, list):
            for inner in part:
                yield from references(inner)

    for reference in references(found):
        assert reference.rpartition("/")[2] in found["$defs"], reference


def test_every_key_says_what_is_wanted():
    for section in (Recipe, recipe.VoxelsSection, *recipe.sections().values()):
        for name, field in section.model_fields.items():
            assert field.description or name == "kind", (section, name)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("model.level=3", ("model.level", 3)),
        ("model.level = limit", ("model.level", "limit")),
        ('title="a = b"', ("title", "a = b")),
    ],
)
def test_assignments(text, expected):
    assert assignment(text) == expected


KNOWN = sorted({*Recipe.model_fields, *recipe.VoxelsSection.model_fields})


@given(st.sampled_from(KNOWN), st.integers(0, 30), st.sampled_from("qxz"))
def test_a_misspelt_key_is_given_its_nearest(key, place, letter):
    place = place % (len(key) + 1)
    wrong = key[:place] + letter + key[place:]
    near = nearest(wrong, KNOWN)
    assert near.startswith("; did you mean ")


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=6,
)
PATHS = (
    [("model",), ("voxels",), ("surface",), ("simulation",), ("expect",), ("title",), ("seed",)]
    + [("model", key) for key in ("kind", "level", "size", "digits", "maps", "primitive", "offset")]
    + [("voxels", key) for key in recipe.VoxelsSection.model_fields]
    + [("model", "digits", "keep"), ("model", "digits", "divisions"), ("simulation", "pressure")]
    + [("model", "primitive", "mesh"), ("model", "level", "size"), ("expect", "porosity")]
)


@given(st.sampled_from(PATHS), JUNK)
def test_junk_is_a_recipe_error_or_a_recipe(path, junk):
    table = json.loads(json.dumps(PLAIN))
    here = table
    for step in path[:-1]:
        if not isinstance(here.get(step), dict):
            here[step] = {}
        here = here[step]
    here[path[-1]] = junk
    try:
        made = parse(table, name="it")
    except RecipeError as error:
        said = str(error)
    else:
        said = "it: fine"
        assert parse(tomllib.loads(dump(made))) == made
    assert said.startswith("it: ")
    assert "\n" not in said


def written(folder: Path, more: str = "") -> Path:
    """Write a small recipe; what is added goes into [model] or below."""
    text = "[model]\nkind = 'ifs'\nlevel = 1\n"
    text += "digits = { divisions = 2, keep = [[0, 0, 0], [1, 1, 0]] }\n"
    path = folder / "recipe.toml"
    path.write_text(text + more, encoding="utf-8")
    return path
