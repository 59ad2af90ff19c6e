"""The report: one page that needs nothing else, says everything, and escapes what it is told."""

import base64
import hashlib
import itertools
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from report_curves import plotted

from porous import disk, view
from porous.certificate import Certificate, Check, certify
from porous.errors import DiskError, ViewError
from porous.formats import write
from porous.measures import Findings
from porous.pipeline import Origin, Result, run
from porous.recipe import build, load, with_files
from porous.report import _page, _provenance, _report, report_html, write_report
from porous.report._agreement import agree, conflicts, groups, lines, verdict
from porous.report._citation import citation, software
from porous.report._definitions import definitions, documents, methods, sources
from porous.report._digits import half_text, number, value_text
from porous.report._doubts import doubts
from porous.report._names import FORMS, KEYS, called
from porous.report._page import markdown
from porous.report._svg import COLOURS, DASHES, SYMBOLS
from porous.report._table import keys, sections
from porous.values import (
    Block,
    Frame,
    Job,
    Measure,
    Measures,
    SurfaceMesh,
    VolumeMesh,
    VoxelGrid,
)
from porous.workspace import record
from porous.workspace._measure import examined

HOSTILE = "</title><script>alert(1)</script>&\"'<img src=x onerror=y> {{ 7 * 7 }} ☃"
VOID_ELEMENTS = {"meta", "img", "br", "link", "input", "hr"}


def row(name, value, method, uncertainty=0.0, kind="exact", of="grid", unit="1"):
    return Measure(name, value, unit, method, uncertainty, kind, of)


MEASURES = Measures(
    (
        row("porosity", 0.451303155, "closed form", of="model"),
        row("porosity", 0.4513, "voxel fill", 1e-4, "bound"),
        row("porosity", 0.47, "voxel count", 1e-3, "standard"),
        row("surface_area", 9.5, "triangles", 0.5, "standard", "surface", "mm²"),
        row("components", 1, "closed form", of="model"),
        row("genus", 1409, "closed form", of="model"),
        row("tortuosity_factor", math.nan, "random walk", math.nan, "bound"),
    )
)


@pytest.fixture(scope="module")
def body():
    frame = Frame((0, 0, 0), (0.5, 0.25, 1), (3, 4, 5), (False, True, False), "mm")
    points = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 5.0]])
    mesh = VolumeMesh(points, (Block("tet4", [[0, 1, 2, 3]]),))
    return Result(
        recipe=None,
        grid=VoxelGrid(frame, np.full(frame.shape, 255, np.uint8), hausdorff=0.125),
        surface=SurfaceMesh(points, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])),
        volume=mesh,
        job=Job("x", mesh, why_no_step="nothing joins the sides"),
        measures=MEASURES,
        times={"voxels": 1.25},
        notes=("surface from voxels: " + HOSTILE,),
    )


@pytest.fixture(autouse=True)
def quick_picture(monkeypatch):
    """Draw nothing: VTK is slow, and pictures have tests of their own."""
    monkeypatch.setattr(_report, "picture", lambda *_, **__: b"\x89PNG not really")
    monkeypatch.setattr(_provenance, "now", lambda: "today")


def recipe_named(title):
    recipe = load("menger", set={"title": title, "source": HOSTILE})
    assert recipe.title == title
    return recipe


# --- the page ------------------------------------------------------------------------------


class Strict(HTMLParser):
    """Notes everything of a page that a browser would have to guess, load or run."""

    def __init__(self):
        super().__init__(convert_charrefs=True)
        self.stack, self.ids, self.faults, self.text, self.headings = [], [], [], [], []
        self.seen = []

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.seen.append((tag, values))
        if tag not in VOID_ELEMENTS:
            self.stack.append(tag)
        if re.fullmatch("h[1-6]", tag):
            self.headings.append(int(tag[1]))
        self.ids += [values["id"]] if "id" in values else []
        self.faults += [fault for fault, found in faults(tag, attributes) if found]

    def handle_endtag(self, tag):
        if not self.stack or self.stack.pop() != tag:
            self.faults.append(f"</{tag}> closes something else")

    def handle_data(self, data):
        self.text.append(data)

    @property
    def words(self):
        return " ".join(" ".join(self.text).split())


def faults(tag, attributes):
    """What would be wrong with a tag, and whether it is."""
    values = dict(attributes)
    yield f"<{tag}> names an attribute twice", len(values) != len(attributes)
    yield f"<{tag}>", tag in {"iframe", "object", "embed", "link", "base", "form"}
    yield "a picture without words", tag == "img" and not values.get("alt")
    scopes = {"col", "row", "rowgroup"}
    yield "a table header without scope", tag == "th" and values.get("scope") not in scopes
    for name, value in attributes:
        yield f"{name} runs code", name.startswith("on")
        loads = name in {"src", "href", "action", "srcset", "data", "poster"}
        inside = (value or "").startswith(("data:image/png;", "#"))
        yield f"{name}={value!r}", loads and not inside


def parsed(html):
    page = Strict()
    page.feed(html)
    page.close()
    return page


def test_the_page_is_well_formed_and_needs_nothing_else(body):
    html = report_html(replace(body, recipe=recipe_named("A foam")))
    page = parsed(html)
    assert page.faults == []
    assert page.stack == []
    assert len(set(page.ids)) == len(page.ids)
    assert html.startswith('<!doctype html>\n<html lang="en">')
    assert "url(" not in html
    assert "@import" not in html
    labels = [v["aria-labelledby"] for _, v in page.seen if "aria-labelledby" in v]
    links = [v["href"][1:] for tag, v in page.seen if tag == "a"]
    assert links
    assert {*labels, *links} <= set(page.ids)


def running(html):
    """Scripts of a page that are code, not data."""
    return re.findall(r"<script>(.*?)</script>", html, re.S)


def policy(html):
    (content,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', html)
    return dict(part.strip().split(" ", 1) for part in content.split(";"))


def sha(script):
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return f"'sha256-{digest}'"


def test_only_scripts_of_ours_run(body):
    allowed = policy(report_html(body))
    assert allowed["default-src"] == "'none'"
    assert "connect-src" not in allowed
    scripts = running(report_html(body))
    assert len(scripts) == 3
    assert sorted(allowed["script-src"].split()) == sorted(map(sha, scripts))
    (own,) = running(plotted())
    assert policy(plotted())["script-src"].split() == [sha(own), sha(_page._plotly())]


def test_headings_descend_one_by_one(body):
    levels = parsed(report_html(replace(body, recipe=recipe_named("A foam")))).headings
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b <= a + 1 for a, b in itertools.pairwise(levels))


def test_hostile_text_is_shown_not_obeyed(body):
    html = report_html(replace(body, recipe=recipe_named(HOSTILE)))
    page = parsed(html)
    assert page.faults == []
    assert HOSTILE in page.words
    kinds = [values.get("type", "code") for tag, values in page.seen if tag == "script"]
    assert sorted(kinds) == ["application/json", "code", "code", "code", "text/plain"]
    assert html.count("<script") == len(kinds)
    assert "49" not in re.findall(r"<h1>(.*?)</h1>", html, re.S)[0]


def test_a_table_has_as_many_cells_in_each_row(body):
    certified = replace(body, certificate=certify(None, body.grid, body.surface, body.volume))
    html = report_html(certified)
    tables = re.findall(r"<table.*?</table>", html + plotted(), re.S)
    assert len(tables) > 6
    for table in tables:
        head, rows = table.split("</thead>")
        columns = len(re.findall("<th ", head))
        assert {len(re.findall("<t[hd]", row)) for row in rows.split("<tr")[1:]} == {columns}


def test_colours_can_be_read():
    style = _page.text_of("style.css")
    inks = set(re.findall(r"(?<![-\w])color: (#[0-9a-f]{3,6})\b", style))
    papers = set(re.findall(r"background: (#[0-9a-f]{3,6})\b", style))
    assert "#fff" in papers
    assert len(inks) > 4
    for ink, paper in itertools.product(inks, papers):
        assert contrast(ink, paper) >= 4.5, (ink, paper)
    assert min(contrast(ink, "#fff") for ink in COLOURS) >= 4.5


def test_lines_differ_by_more_than_colour():
    looks = set(zip(COLOURS, DASHES, SYMBOLS, strict=True))
    assert len(looks) == len(set(DASHES)) == len(set(SYMBOLS)) == len(COLOURS)


def contrast(a, b):
    """Return the contrast of two colours as WCAG 2 defines it."""
    light, dark = sorted((luminance(a), luminance(b)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def luminance(colour):
    digits = colour[1:] if len(colour) == 7 else "".join(c * 2 for c in colour[1:])
    parts = [int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


# --- what it says --------------------------------------------------------------------------


def test_everything_is_said(body):
    recipe = recipe_named("A foam")
    words = parsed(report_html(replace(body, recipe=recipe))).words
    for wanted in (
        "A foam",
        recipe.sha256,
        'keep = "menger"',
        "1.25 s",
        "0.4513032",
        "3 × 4 × 5 = 60",
        "periodic along y",
        "≤ 0.125 mm",
        "4 triangles",
        "1 tetrahedra",
        "no step: nothing joins the sides",
        "surface from voxels",
        "numpy",
        "not defined",
        "1 409",
    ):
        assert wanted in words, wanted


def test_the_closed_form_comes_first_and_contradictions_are_marked(body):
    porosity = groups(body.measures)[0]
    assert [r.method for r in porosity.rows] == ["closed form", "voxel fill", "voxel count"]
    assert [r.mark for r in porosity.rows] == ["", "agrees", "differs by +4.14%"]
    assert [(a.method, b.method) for a, b in conflicts(body.measures)] == [
        ("closed form", "voxel count")
    ]
    page = report_html(body)
    assert page.count('class="differs"') == 1
    assert page.count("</span> differs by +4.14%") == 1


def test_the_numbers_that_are_looked_for_first_come_first(body):
    html = report_html(body)
    first = html[html.index('id="key"') : html.index('id="uncertain"')]
    words = parsed(first).words
    assert "porosity 0.4513 ± 0.0001 voxel fill 0.4513032 ✓ agrees" in words
    assert "pieces of solid — closed form 1" in words
    assert "surface_area" not in words


def test_a_measurement_that_contradicts_the_closed_form_is_marked_at_once():
    rows = (row("porosity", 0.5, "closed form", of="model"), row("porosity", 0.6, "voxel fill"))
    (found,) = keys(Measures(rows))
    assert (found.value, found.closed, found.mark) == ("0.6", "0.5", "differs by +20.00%")
    assert found.tone == "bad"


def test_closed_forms_of_another_name_stand_beside_what_is_measured():
    rows = (
        row("smallest_wall", 0.11, "distance ridge", 0.02, "standard", unit="mm"),
        row("smallest_feature", 0.1, "closed form", of="model", unit="mm"),
        row("box_dimension", 2.8, "voxel count", 0.01, "standard"),
        row("similarity_dimension", 2.7, "closed form", of="model"),
        row("smallest_pore", 0.3, "closed form", of="model", unit="mm"),
    )
    found = {key.label: key for key in keys(Measures(rows))}
    assert list(found) == ["thinnest wall", "narrowest gap", "box dimension"]
    said = [(key.value, key.closed, key.mark, key.tone) for key in found.values()]
    assert said == [
        ("0.11", "0.1", "agrees", "good"),
        ("—", "0.3", "", "good"),
        ("2.8", "2.7", "differs by +3.70%", "open"),
    ]


def test_a_bound_of_the_model_answers_where_nothing_was_measured():
    rows = (row("smallest_feature", 0.1, "lower bound", math.inf, "bound", "model", "mm"),)
    (found,) = keys(Measures(rows))
    assert (found.label, found.value, found.half) == ("thinnest wall", "0.1", "at least")


def test_the_overhang_is_told_of_the_best_direction():
    rows = [
        row(f"overhang_share_{a}_{w}", v, "voxel normals", 0.01, "standard")
        for a, w, v in (("x", "up", 0.3), ("y", "down", 0.2), ("z", "up", 0.2 + 1e-9))
    ]
    (found,) = keys(Measures(tuple(rows)))
    assert (found.label, found.value) == ("overhang share, built along −y", "0.2")


@pytest.mark.parametrize(("open_ones", "said"), [("xz", "x, z"), ("", "none"), ("xyz", "x, y, z")])
def test_axes_that_pores_pass_are_named(open_ones, said):
    rows = [
        row(f"through_porosity_{a}", 0.3 * (a in open_ones), "voxel count", 0.01, "bound")
        for a in "xyz"
    ]
    (found,) = keys(Measures(tuple(rows)))
    assert (found.label, found.value) == ("axes that pores pass", said)


def test_half_widths_are_those_of_95_percent(body):
    rows = {(r.name, r.method): r.half for part in sections(body.measures) for r in part.rows}
    assert rows["porosity", "closed form"] == "exact"
    assert rows["porosity", "voxel fill"] == "± 0.0001"
    assert rows["porosity", "voxel count"] == "± 0.002"
    assert rows["tortuosity_factor", "random walk"] == "not known"


def test_rows_stand_under_the_headings_of_their_definitions(body):
    side = Measures((row("sq_xmin", 0.1, "height map", unit="mm"),))
    found = {part.title: part.rows for part in sections(body.measures + side)}
    assert list(found) == [
        "How much is solid",
        "How large the surface is",
        "How it is connected",
        "How rough its sides are",
        "Further numbers",
    ]
    assert [r.name for r in found["Further numbers"]] == ["tortuosity_factor"]
    assert sum(map(len, found.values())) == len(body.measures) + 1


def test_every_name_leads_to_its_definition_and_every_method_to_what_it_does(body):
    side = Measures((row("sq_xmin", 0.1, "height map", unit="mm"),))
    html = report_html(replace(body, measures=body.measures + side))
    assert '<a href="#def-sq_zmax">sq_xmin</a>' in html
    assert re.search(r'<dt id="def-sq_zmax">sq_zmax</dt><dd>root of the mean', html)
    assert '<a href="#how-height-map">height map</a>' in html
    assert '<dt id="how-height-map">height map</dt><dd>measures heights' in html
    assert "def-tortuosity_factor" not in html


def test_every_definition_and_method_of_the_page_of_measures_is_read():
    page = documents("measures.md").read_text(encoding="utf-8")
    assert set(definitions()) == set(re.findall(r"^\| `(\w+)` \|", page, re.M))
    assert definitions()["sa_zmax"].text.startswith("mean of |z|, z the height")
    assert methods()["tetrahedra"] == methods()["hexahedra"]
    assert "closed form" in methods()


def test_the_numbers_that_come_first_are_all_defined():
    assert {name for name, _ in KEYS} | set(FORMS.values()) <= set(definitions())
    assert len({label for _, label in KEYS}) == len(KEYS)


def test_markdown_becomes_text_that_is_escaped():
    said = markdown("`a<b` & [a link](x.md#y) <script>")
    assert said == "<code>a&lt;b</code> &amp; a link &lt;script&gt;"


def test_doubts_name_contradictions_resolution_and_spread(body):
    rows = (
        row("smallest_feature", 1.5, "prefractal", of="model", unit="mm"),
        row("specific_surface_area", 2.0, "crofton", 0.1, "bound", unit="1/mm"),
    )
    said = doubts(replace(body, measures=body.measures + Measures(rows)))
    assert said.first == (
        (
            "Porosity by voxel count of the grid is 0.47 ± 0.002 (95 %), which contradicts "
            "0.4513032 by closed form of the model; 0.3 % of right numbers do so by chance."
        ),
        "The smallest feature is 1.5 mm, 1.5 voxels across; below 3 voxels its shape is lost.",
        "Specific surface area is 2 ± 0.1 1/mm, by crofton: ± 5 %.",
    )
    assert said.others == (
        "Surface area is 9.5 ± 1 mm² (95 %), by triangles: ± 11 %.",
        "Tortuosity factor is not defined for this body (random walk).",
    )


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (row("degree_of_anisotropy", 6.66e-16, "m", 0.35, "bound"), "not told apart from zero."),
        (row("closed_porosity", 0.1, "m", 0.2142, "bound"), "not told apart from zero."),
        (
            row("correlation_length", 0.3, "m", math.inf, "bound"),
            "0.3, by m: how far off is not known.",
        ),
        (row("thin_wall_share", 0.83, "m", 0.829, "bound"), "by m: ± 100 %."),
        (row("porosity", 0.41, "m", 0.065, "standard"), "0.41 ± 0.13 (95 %), by m: ± 32 %."),
        (row("smallest_feature", 0.1, "lower bound", math.inf, "bound"), "at least 0.1; how far"),
    ],
)
def test_what_is_uncertain_of_a_number_is_said_in_words(given, said):
    found = doubts(Result(None, measures=Measures((given,))))
    (text,) = found.first + found.others
    assert said in text
    assert "_" not in text
    assert "inf " not in text


def test_rounding_is_no_doubt(body):
    rows = (
        row("closed_porosity", 0.0, "m", 4.4e-16, "bound"),
        row("trapped_volume", 1e-15, "m", 4.4e-14, "bound", unit="mm³"),
        row("open_porosity", 0.2, "m", 1e-12, "standard"),
    )
    said = doubts(replace(body, measures=Measures(rows)))
    assert said.first == said.others == ()


def test_what_the_threshold_does_is_a_doubt():
    note = (
        "threshold at 99: 30% are selected; 29% to 31% would be where the threshold lay 1% higher"
    )
    assert doubts(Result(None, notes=(note, "another"))).first == (note,)


def test_findings_are_no_doubts(body):
    html = report_html(replace(body, findings=Findings(notes=("best built along +x",))))
    assert "best built" in html[html.index('id="findings"') : html.index('id="measures"')]
    assert "best built" not in html[html.index('id="uncertain"') : html.index('id="findings"')]
    assert 'id="findings"' not in report_html(body)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("smallest_wall", "thinnest wall"),
        ("overhang_area_x_down", "overhang area, built along −x"),
        ("succolarity_y", "succolarity along y"),
        ("throat_diameter_p50", "throat diameter D50"),
        ("sq_zmax", "sq zmax"),
    ],
)
def test_measures_have_names_for_people(name, said):
    assert called(name) == said


def test_a_body_without_doubts_says_so(body):
    exact = Measures((row("genus", 5, "closed form", of="model"),))
    plain = replace(body, measures=exact, notes=())
    assert doubts(plain).first == doubts(plain).others == ()
    words = parsed(report_html(plain)).words
    assert "No measure contradicts another" in words
    assert "Nothing out of the ordinary" in words


def test_a_surface_alone_says_what_voxels_would_tell(body):
    skin = Result(
        recipe=None, surface=body.surface, measures=Measures((row("volume", 5, "triangles"),))
    )
    words = parsed(report_html(skin)).words
    assert "There are no voxels: porosity needs a bulk" in words
    assert "Of what there is, no measure contradicts another" in words
    nothing = replace(skin, surface=None)
    assert "neither voxels nor a mesh were made" in parsed(report_html(nothing)).words


def test_nothing_at_all_still_makes_a_page():
    page = parsed(report_html(Result(recipe=None)))
    assert page.faults == []
    assert "Nothing was measured" in page.words


@pytest.mark.parametrize(
    ("a", "b", "same"),
    [
        (row("v", 1, "m"), row("v", 1 + 1e-12, "n"), True),
        (row("v", 1, "m"), row("v", 1 + 1e-6, "n"), False),
        (row("v", 1, "m", 0.1, "bound"), row("v", 1.2, "n", 0.1, "bound"), True),
        (row("v", 1, "m", 0.1, "bound"), row("v", 1.21, "n", 0.1, "bound"), False),
        (row("v", 1, "m", 0.1, "standard"), row("v", 1.2, "n"), True),
        (row("v", math.inf, "m"), row("v", math.inf, "n"), True),
        (row("v", math.inf, "m"), row("v", 3, "n", 1, "bound"), False),
        (row("v", math.nan, "m"), row("v", 3, "n"), True),
    ],
)
def test_numbers_agree_within_what_both_admit(a, b, same):
    assert agree(a, b) == same
    assert agree(b, a) == same


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (12, "12"),
        (-4.0, "−4"),
        (
            1982627123.4,
            "1\N{NARROW NO-BREAK SPACE}982\N{NARROW NO-BREAK SPACE}627\N{NARROW NO-BREAK SPACE}000",
        ),
        (64000000, "64\N{NARROW NO-BREAK SPACE}000\N{NARROW NO-BREAK SPACE}000"),
        (1 / 3, "0.3333333"),
        (-1.5e-9, "−1.5e−09"),
        (math.nan, "not defined"),
        (math.inf, "infinite"),
        (-math.inf, "−infinite"),
    ],
)
def test_numbers_are_for_people(value, text):
    assert number(value) == text


def test_the_certificate_is_in_the_report(body):
    certificate = certify(None, body.grid, body.surface, body.volume)
    words = parsed(report_html(replace(body, certificate=certificate))).words
    for check in certificate.rows:
        assert check.quantity in words
        assert check.verdict in words


@pytest.mark.parametrize(
    ("verdicts", "tone", "words"),
    [
        (("agree", "agree"), "good", "Voxels and surface agree in volume, genus."),
        (("agree", "unknown"), "open", "Voxels and surface agree in volume; not decided: genus."),
        (("agree", "differ"), "bad", "Voxels and surface differ in genus: the certificate says"),
        (("unknown", "unknown"), "open", "nothing to compare with"),
        ((), "open", "nothing to compare with"),
    ],
)
def test_the_verdict_is_that_of_the_worst_check_and_names_what_was_compared(verdicts, tone, words):
    names = zip(("volume", "genus"), verdicts, strict=False)
    checks = tuple(Check(name, "1", None, 1, 1, None, 0.0, 0.1, said) for name, said in names)
    said = verdict(Certificate(checks))
    assert said.tone == tone
    assert words in said.text


def test_what_is_not_decided_is_neither_ticked_nor_crossed(body):
    words = ("agree", "unknown", "differ")
    checks = tuple(Check(f"q{w}", "1", 1, 13.037, None, 2, 1.5, 0.1, w) for w in words)
    html = report_html(replace(body, measures=Measures(), certificate=Certificate(checks)))
    part = parsed(html[html.index('id="certificate"') : html.index('id="notes"')]).words
    assert "✓ agree" in part
    assert "0.1 unknown" in part
    assert "✗ differ" in part


def test_the_voxels_of_the_certificate_have_their_half_width():
    check = Check("volume", "mm³", 11.618, 13.037, 12.0, None, 1.5, 0.1, "agree")
    (line,) = lines(Certificate((check,)))
    assert line.values == ("11.618", "13 ± 1.5", "12", "—")


@pytest.mark.parametrize(
    ("value", "half", "unit", "said"),
    [
        (93.8, 36, "mm", ("94", "± 36")),
        (0.451303155, 1.3e-4, "1", ("0.4513", "± 0.00013")),
        (0.451303155, 2.6e-11, "1", ("0.4513032", "exact as shown")),
        (1.11e-16, 2.2e-16, "1", ("0", "exact as shown")),
        (1.11e-16, 2.2e-16, "m³", ("1.1e−16", "± 2.2e−16")),
        (6.66e-16, 0.35, "1", ("0", "± 0.35")),
        (1982627123.4, 3.4e3, "mm³", ("1 982 627 100", "± 3 400")),
        (0.123456, math.inf, "1", ("0.1235", "not known")),
        (math.inf, math.inf, "1", ("infinite", "not known")),
        (1.665e-15, math.inf, "1", ("0", "not known")),
        (12, 0.0, "1", ("12", "exact as shown")),
    ],
)
def test_no_more_figures_are_told_than_are_known(value, half, unit, said):
    one = row("v", value, "m", half, "bound", unit=unit)
    told = tuple(
        text.replace("\N{NARROW NO-BREAK SPACE}", " ") for text in (value_text(one), half_text(one))
    )
    assert told == said


# --- where it comes from, and how to cite it ------------------------------------------------


def test_every_source_that_the_page_of_measures_names_is_in_full_at_its_end():
    page = documents("measures.md").read_text(encoding="utf-8").partition("## Sources")[0]
    author = r"(?:[A-Z]\.[- ]?)+(?:de )?[A-ZÀ-Ž][\w-]+"
    words = " ".join(page.split())
    named = re.findall(rf"{author}(?:, {author})*(?: and others)? (?:19|20)\d\d(?!\d)", words)
    assert len(set(named)) > 20
    assert set(named) == {source.named for source in sources()}
    assert all(source.year in source.named for source in sources())
    assert len({source.key for source in sources()}) == len(sources())


def test_the_methods_paragraph_tells_what_was_done_and_whom_it_follows(body):
    recipe = recipe_named("A foam")
    said = citation(replace(body, recipe=recipe), "1.2.3")
    for wanted in (
        "A foam (after ",
        f"porous 1.2.3 from a recipe (SHA-256 {recipe.sha256}, seed 0)",
        "sampled by 3 × 4 × 5 voxels of 0.5 × 0.25 × 1 mm (sampling: fill), periodic along y",
        "4 triangles",
        "1 elements",
        "Measured were porosity by voxel fill; pieces of solid and independent tunnels by closed",
    ):
        assert wanted in said.paragraph, wanted
    assert "Definitions follow" not in said.paragraph
    assert said.bibtex.count("@") == 1


def test_sources_become_bibtex_where_what_they_define_is_told():
    rows = (
        row("specific_surface_area", 2.0, "crofton", 0.1, "standard", unit="1/mm"),
        row("pore_thickness_p50", 0.2, "local thickness", 0.1, "bound", unit="mm"),
    )
    said = citation(Result(None, measures=Measures(rows)), "1.2.3")
    assert "specific surface area by crofton (J. Ohser, F. Mücklich 2000)" in said.paragraph
    assert "Definitions follow J. Ohser, F. Mücklich 2000; T. Hildebrand" in said.paragraph
    entries = re.findall(r"^@(\w+)\{(\w+),$", said.bibtex, re.M)
    assert entries == [("software", "porous"), ("misc", "ohser2000"), ("misc", "hildebrand1997")]
    assert "author = {T. Hildebrand and P. Rüegsegger}" in said.bibtex
    assert said.bibtex.count("{") == said.bibtex.count("}")
    assert "version = {1.2.3}" in said.bibtex
    assert said.line.endswith("Version 1.2.3.")
    assert software()["title"] in said.line


def test_a_paragraph_names_ways_and_sizes_along_axes_once():
    rows = [row(f"percolation_diameter_{a}", 0.2, "widest paths") for a in "xyz"]
    rows += [row(f"succolarity_{a}", 0.2, "voxel flood") for a in "xyz"]
    said = citation(Result(None, measures=Measures(tuple(rows))), "1.2.3").paragraph
    assert said == (
        "A body was read and measured with porous 1.2.3. "
        "Measured were widest ball that passes by widest paths. "
        "Definitions follow A. J. Katz, A. H. Thompson 1986."
    )


def test_a_file_that_was_measured_is_named_with_its_hash_and_size(body, tmp_path):
    path = tmp_path / "box.stl"
    write(body.surface, path)
    content = path.read_bytes()
    result = examined(str(path))
    digest = hashlib.sha256(content).hexdigest()
    assert result.source == Origin("box.stl", digest, len(content))
    words = parsed(report_html(result)).words
    assert words.startswith("Measures of box.stl")
    assert f"box.stl, SHA-256 {digest}, {len(content)} bytes" in words
    assert f"The file box.stl (SHA-256 {digest}) was read" in words


def test_when_it_was_made_is_told_beside_the_measures_not_among_them(body, monkeypatch):
    monkeypatch.setattr(_provenance, "now", lambda: "2001-02-03 04:05 UTC")
    assert "2001-02-03 04:05 UTC" in parsed(report_html(body)).words
    assert "2001" not in str(record(body))


def test_files_that_a_recipe_reads_are_told_with_their_hashes(body, tmp_path):
    (tmp_path / "part.stl").write_bytes(b"solid")
    recipe = with_files(
        load("menger", set={"model.primitive": {"mesh": str(tmp_path / "part.stl")}}),
        {"model.primitive.mesh": Path("part.stl")},
    )
    told_of = replace(body, recipe=recipe)
    write_report(told_of, tmp_path / "report.html")
    words = parsed((tmp_path / "report.html").read_text(encoding="utf-8")).words
    assert f"part.stl, SHA-256 {hashlib.sha256(b'solid').hexdigest()}" in words
    elsewhere = parsed(report_html(told_of)).words
    assert "part.stl" in elsewhere
    assert "part.stl, SHA-256" not in elsewhere


def test_what_was_done_to_an_image_stands_apart_from_other_notes(tmp_path):
    values = np.zeros((8, 9, 10), np.uint8)
    values[1:7, 2:8, 1:9] = 200
    values[0, 0, 0] = 200
    np.savez(tmp_path / "scan.npz", fill=values)
    grey = tmp_path / "scan.npz"
    recipe = load(grey, set={"clean.islands": 5, "report.detail": "brief", "model.threshold": 99})
    result = run(recipe, only="voxels")
    html = report_html(replace(result, notes=(*result.notes, "something else")))
    part = parsed(html[html.index('id="image"') : html.index('id="notes"')]).words
    assert "threshold at 99" in part
    assert "clean.islands: 1 of 2 pieces of solid" in part
    assert "something else" not in part
    assert "How the image was read" not in report_html(replace(result, recipe=None))


def test_what_a_sample_says_of_the_whole_is_among_the_doubts(body):
    rows = [
        row("material_porosity", 0.3, "blocks", 0.05, "standard"),
        row("material_specific_surface", 2.0, "blocks", math.inf, "standard", unit="1/mm"),
    ]
    said = doubts(replace(body, measures=Measures(tuple(rows))))
    assert said.first == (
        "As a sample of a larger body, porosity: 0.3 ± 0.1 (95 %), by blocks.",
        "Of what the grid was cut out of is not known: area by volume.",
    )


def test_of_axes_alike_is_told_once():
    rows = [row(f"throat_{a}", v, "m", 0.1, "bound") for a, v in (("x", 1), ("y", 1), ("z", 2))]
    assert doubts(Result(None, measures=Measures(tuple(rows)))).others == (
        "Throat along x, y is 1 ± 0.1, by m: ± 10 %.",
        "Throat along z is 2 ± 0.1, by m: ± 5 %.",
    )


def test_many_findings_are_folded():
    notes = tuple(f"doubt {i}" for i in range(30))
    html = report_html(Result(None, findings=Findings(notes=notes)))
    folded = html[html.index("<summary>18 more</summary>") :]
    assert "doubt 11<" not in folded
    assert "<li>doubt 12</li>" in folded


# --- the picture and the file --------------------------------------------------------------


def test_a_machine_that_cannot_draw_says_so_and_goes_on(body, monkeypatch):
    def refuse(*_, **__):
        raise ViewError("this machine cannot draw: libX11 is missing")

    monkeypatch.setattr(_report, "picture", refuse)
    page = parsed(report_html(body))
    assert "There is no picture: this machine cannot draw: libX11 is missing" in page.words
    assert "img" not in [tag for tag, _ in page.seen]
    assert "canvas" in [tag for tag, _ in page.seen]


def test_a_surface_too_large_to_draw_is_shown_by_its_voxels(body, monkeypatch):
    drawn = []
    monkeypatch.setattr(_report, "picture", lambda value, **_: drawn.append(value) or b"x")
    report_html(body)
    monkeypatch.setattr(_report, "DRAWN_TRIANGLES", 3)
    report_html(body)
    assert drawn == [body.surface, body.grid]


def test_a_report_is_written_whole_or_not_at_all(body, tmp_path, monkeypatch):
    path = tmp_path / "report.html"
    write_report(body, path)
    assert path.read_text(encoding="utf-8") == report_html(body)
    with pytest.raises(DiskError):
        write_report(body, tmp_path / "nowhere" / "report.html")
    monkeypatch.setattr(_report, "report_html", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_report(body, path)
    assert path.read_bytes().startswith(b"<!doctype html>")
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    assert disk


@pytest.mark.slow
def test_the_report_of_a_real_run(monkeypatch):
    monkeypatch.setattr(_report, "picture", view.picture)
    result = run(load("menger", set={"model.level": 1}))
    assert build(result.recipe) == result.model
    page = parsed(report_html(result))
    assert page.faults == []
    pictures = [values for tag, values in page.seen if tag == "img"]
    assert len(pictures) <= 1
    assert all(len(values["src"]) > 10_000 for values in pictures)
    assert "0.2592593" in page.words
