"""Several materials on one page: side by side, held against the first, from folders or results."""

import json
import math
import re

import numpy as np
import pytest
from report_curves import CURVES, HOSTILE, curve
from test_report import parsed, row

import porous as po
from porous.cli import main
from porous.errors import DiskError, FormatError, RecipeError
from porous.measures import Findings
from porous.pipeline import Result
from porous.recipe import load
from porous.report import Material, compare_html
from porous.report._compare import _overlaid, factor
from porous.values import Measures
from porous.workspace import write_measures
from porous.workspace._compare import LARGEST, _labels, _names

A = Measures(
    (
        row("porosity", 0.5, "voxel fill", 0.01, "bound"),
        row("porosity", 0.52, "voxel count", 0.03, "bound"),
        row("specific_surface_area", 2.0, "crofton", 0.1, "standard", unit="1/mm"),
        row("volume", 8.0, "voxel fill", 0.5, "bound", unit="mm³"),
        row("components", 1, "voxel count"),
    )
)
B = Measures(
    (
        row("porosity", 0.505, "voxel fill", 0.01, "bound"),
        row("specific_surface_area", 2.5e-3, "crofton", 0.04e-3, "standard", unit="1/um"),
        row("volume", 8.1e9, "voxel fill", 0.1e9, "bound", unit="um³"),
        row("components", math.nan, "voxel count"),
        row("genus", 7, "voxel count"),
    )
)


def material(label, measures, **more):
    return Material(label, f"Title of {label}", measures=measures, **more)


def cells(html, name):
    """Text of the cells of a measure's row in the full tables, a list for each material."""
    full = html[html.index('<h2 id="measures"') :]
    (found,) = re.findall(
        rf'<tr><th scope="row">(?:<a [^>]*>)?{name}(?:</a>)?</th>(.*?)</tr>', full
    )
    return [
        [re.sub("<[^>]+>", "", part) for part in cell.split("<br>")]
        for cell in re.findall(r"<td[^>]*>(.*?)</td>", found)
    ]


@pytest.fixture(scope="module")
def page():
    return compare_html([material("one", A), material("two", B)])


def test_numbers_stand_side_by_side_with_half_widths_and_marks(page):
    assert cells(page, "porosity") == [
        [""],
        ["voxel fill"],
        ["0.5", "± 0.01"],
        ["0.505", "± 0.01", "✓ agrees"],
    ]
    assert cells(page, "genus")[2:] == [["—"], ["7", "exact"]]
    assert cells(page, "components")[3] == ["not defined", "exact", "✓ agrees"]


def test_lengths_are_told_in_the_unit_of_the_first(page):
    unit, _, first, second = cells(page, "specific_surface_area")
    assert unit == ["1/mm"]
    assert first == ["2", "± 0.2"]
    assert second == ["2.5", "± 0.08", "differs by +25.00%"]
    assert cells(page, "volume")[3] == ["8.1", "± 0.1", "✓ agrees"]


def test_what_differs_is_said_at_the_top(page):
    assert (
        "Of 4 measures 1 differ from one beyond both uncertainties: specific surface area."
        in parsed(page).words
    )
    alike = compare_html([material("one", A), material("two", A)])
    assert "Of 4 measures none differs from one beyond both" in parsed(alike).words


def test_materials_are_told_by_the_best_method_that_they_share():
    other = Measures((row("porosity", 0.6, "voxel count", 0.01, "bound"),))
    shared = cells(compare_html([material("one", A), material("two", other)]), "porosity")
    assert shared[1:] == [
        ["voxel count"],
        ["0.52", "± 0.03"],
        ["0.6", "± 0.01", "differs by +15.38%"],
    ]
    alone = Measures((row("porosity", 0.6, "closed form"),))
    each = cells(compare_html([material("one", A), material("two", alone)]), "porosity")
    assert each[2:] == [
        ["0.5", "± 0.01", "voxel fill"],
        ["0.6", "exact", "closed form", "differs by +20.00%"],
    ]


def test_units_of_different_kinds_are_not_compared():
    rows = (row("volume", 8.0, "voxel fill", unit="mm²"),)
    html = compare_html([material("one", A), material("two", Measures(rows))])
    assert cells(html, "volume")[3] == ["8 mm²", "exact", "has another unit"]


@pytest.mark.parametrize(
    ("unit", "target", "wanted"),
    [
        ("um", "mm", 1e-3),
        ("mm³", "cm³", 1e-3),
        ("1/mm²", "1/m²", 1e6),
        ("1", "1", 1.0),
        ("in", "mm", 25.4),
        ("mm", "mm²", None),
        ("1/mm", "mm", None),
        ("1", "mm", None),
        ("°", "1", None),
    ],
)
def test_units_of_length_are_converted(unit, target, wanted):
    assert factor(unit, target) == (None if wanted is None else pytest.approx(wanted, rel=1e-14))


def test_curves_lie_over_each_other_in_one_unit():
    x = np.array([1.0, 2.0])
    near = curve("size", "pore", x, x, x_unit="mm", y_unit="mm")
    far = curve("size", "pore", 1e3 * x, 1e3 * x, low=x, high=1e4 * x, x_unit="um", y_unit="um")
    html = compare_html([material("one", A, curves=(near,)), material("two", B, curves=(far,))])
    (data,) = re.findall(r'id="figures">(.*?)</script>', html)
    (figure,) = json.loads(data).values()
    lines = {trace["name"]: trace for trace in figure["data"] if "name" in trace}
    assert list(lines) == ["one: pore", "two: pore"]
    assert lines["one: pore"]["x"] == lines["two: pore"]["x"] == [1.0, 2.0]
    assert lines["two: pore"]["y"] == [1.0, 2.0]
    assert figure["data"][-2]["y"] == [10.0, 20.0]


@pytest.mark.parametrize(("ratio", "log"), [(20.0, ""), (1000.0, "x")])
def test_sizes_far_apart_share_a_logarithmic_axis(ratio, log):
    x = np.array([0.5, 1.0])
    lines = [curve("size", "pore", x * by, x, y_unit="1") for by in (1.0, ratio)]
    parts = [material(str(i), A, curves=(line,)) for i, line in enumerate(lines)]
    assert {line.log for line in _overlaid(parts, [part.curves for part in parts])} == {log}


def test_folders_of_one_name_are_told_by_the_one_above(tmp_path):
    places = [tmp_path / "fine" / "out", tmp_path / "coarse" / "out", tmp_path / "b"]
    assert _names(places) == ["fine/out", "coarse/out", "b"]
    assert _names([places[0], places[0]]) == ["out", "out"]


def test_hostile_text_is_shown_not_obeyed():
    hostile = Material(
        HOSTILE,
        HOSTILE,
        HOSTILE,
        Measures((row(HOSTILE, 1, HOSTILE, unit=HOSTILE),)),
        CURVES,
        *3 * (HOSTILE,),
        (HOSTILE,),
    )
    html = compare_html([hostile, hostile])
    found = parsed(html)
    assert found.faults == []
    assert found.stack == []
    assert html.count("<script") == 3
    assert "<b>" not in html


def test_a_page_without_any_number_says_so():
    words = parsed(compare_html([material("one", Measures()), material("two", Measures())])).words
    assert "Nothing was measured" in words


# --- folders -------------------------------------------------------------------------------


@pytest.fixture
def folders(tmp_path):
    """Two folders as porous fills them, of hand-made results."""
    for name, measures, curves in (("a", A, CURVES), ("b", B, ())):
        recipe = load("menger", set={"title": f"Foam {name}"})
        result = Result(recipe, measures=measures, findings=Findings(curves=curves), notes=("n",))
        write_measures(result, tmp_path / name)
    return tmp_path


def test_folders_and_results_give_the_same_page(folders):
    out = folders / "c.html"
    po.compare([folders / "a", str(folders / "b")], out)
    page = out.read_text(encoding="utf-8")
    assert parsed(page).faults == []
    assert cells(page, "volume")[3] == ["8.1", "± 0.1", "✓ agrees"]
    assert "Comparison of a and b" in page
    words = parsed(page).words
    assert {"Foam a", "Foam b"} <= set(re.findall("Foam [ab]", words))
    result = Result(
        load("menger", set={"title": "a"}), measures=A, findings=Findings(curves=CURVES)
    )
    po.compare([result, folders / "b"], folders / "d.html")
    again = (folders / "d.html").read_text(encoding="utf-8")
    assert re.findall(r'id="figures">(.*?)<', again) == re.findall(r'id="figures">(.*?)<', page)
    full = slice(page.index('<h2 id="measures"'), page.index('<h2 id="origin"'))
    assert page[full] in again


def test_names_that_are_there_twice_are_counted():
    assert _labels(["a", "b", "a"]) == ["a (1)", "b", "a (2)"]


def test_from_the_command_line(folders, monkeypatch, capsys):
    monkeypatch.chdir(folders)
    assert main(["compare", "a", "b", "a", "-o", "c.html"]) == 0
    assert "Comparison of a (1), b and a (2)" in (folders / "c.html").read_text(encoding="utf-8")
    assert main(["compare", "a", "-o", "d.html"]) == 2
    assert "got 1 material; wanted two or more" in capsys.readouterr().err
    assert main(["compare", "a", "none", "-o", "d.html"]) == 2
    assert "none: has no measures.json; wanted a folder that porous make" in capsys.readouterr().err
    assert not (folders / "d.html").exists()


DAMAGES = {
    "[]": "is not what porous writes",
    "{": "is damaged: Expecting property name",
    "[" * 100_000: "is damaged",
    '{"version": "0.2.0"}': "wanted version, measures and recipe",
    '{"version": 3, "measures": []}': "is not what porous writes",
    '{"version": "9.9", "measures": [7]}': r"measure 1 .* the file says porous 9\.9",
    '{"version": "9", "measures": [{"name": "x"}]}': r"measure 1 .* the file says porous 9",
    '{"version": "9", "measures": [], "recipe": 7}': "is not what porous writes",
}


@pytest.mark.parametrize(("text", "said"), DAMAGES.items(), ids=range(len(DAMAGES)))
def test_damaged_folders_are_refused(folders, text, said):
    (folders / "b" / "measures.json").write_text(text)
    with pytest.raises(FormatError, match=rf"b/measures\.json: .*{said}"):
        po.compare([folders / "a", folders / "b"], folders / "c.html")
    assert not (folders / "c.html").exists()


@pytest.mark.parametrize(
    ("key", "value"),
    [("value", "1"), ("value", True), ("kind", "maybe"), ("of", 1), ("unit", None)],
)
def test_a_row_that_is_no_measure_is_refused(folders, key, value):
    path = folders / "b" / "measures.json"
    record = json.loads(path.read_bytes())
    record["measures"][1][key] = value
    path.write_text(json.dumps(record))
    with pytest.raises(FormatError, match=r"measures\.json: measure 2 is not as porous"):
        po.compare([folders / "a", folders / "b"], folders / "c.html")


def test_what_is_not_finite_comes_back_as_not_known(folders):
    rows = Measures((row("porosity", math.inf, "voxel count", math.inf, "bound"),))
    write_measures(Result(None, measures=rows), folders / "e")
    po.compare([folders / "a", folders / "e"], folders / "c.html")
    page = (folders / "c.html").read_text(encoding="utf-8")
    assert cells(page, "porosity")[3] == ["not defined", "not known", "✓ agrees"]


def test_damaged_curves_and_files_that_are_too_large_are_refused(folders):
    path = folders / "a" / "curves.csv"
    assert path.exists()
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(FormatError, match=r"a/curves\.csv: is damaged"):
        po.compare([folders / "b", folders / "a"], folders / "c.html")
    with path.open("wb") as stream:
        stream.truncate(LARGEST + 1)
    with pytest.raises(FormatError, match=r"a/curves\.csv: has \d+ bytes; wanted"):
        po.compare([folders / "b", folders / "a"], folders / "c.html")
    (folders / "a" / "recipe.toml").mkdir()
    path.unlink()
    with pytest.raises(FormatError, match=r"recipe\.toml: cannot be read: is a directory"):
        po.compare([folders / "b", folders / "a"], folders / "c.html")


def test_one_material_is_none_to_compare_and_a_disk_may_refuse(folders):
    with pytest.raises(RecipeError, match="got 1 material"):
        po.compare([folders / "a"], folders / "c.html")
    with pytest.raises(DiskError):
        po.compare([folders / "a", folders / "b"], folders / "nowhere" / "c.html")
