"""The report in a browser with no network: it draws, sorts, prints, and can be used by keyboard."""

import base64
import re
from dataclasses import replace

import numpy as np
import pytest
from browser import Browser, chromium
from report_curves import CURVES, HOSTILE
from scipy.ndimage import gaussian_filter
from test_report import MEASURES, row

from porous.measures import Findings
from porous.pipeline import Result
from porous.recipe import load
from porous.report import Material, _report, compare_html, report_html
from porous.report._plots import plots
from porous.stages import extract_surface
from porous.values import Frame, Measures, VoxelGrid

pytestmark = pytest.mark.slow

DRAWN = "document.documentElement.dataset.plots === 'drawn'"
DOT = base64.b64decode(
    b"iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)
"""A picture of one pixel."""
TABS = 400
"""So many steps by keyboard lead through any of these pages."""


@pytest.fixture(scope="module")
def browser():
    with Browser(chromium(), seconds=150) as made:
        yield made


def result():
    """A body with all that a report can have, under a name that attacks it."""
    grid = np.full((12, 16, 20), 255, np.uint8)
    grid[2:6, 3:9, :] = 0
    frame = Frame((0, 0, 0), (0.5, 0.25, 1), grid.shape, unit="mm")
    thin = row("smallest_wall", 0.4, "distance ridge", 0.1, "bound", unit="mm")
    return Result(
        load("menger", set={"title": HOSTILE, "source": "<script>window.hacked = 1</script>"}),
        grid=VoxelGrid(frame, grid),
        measures=MEASURES + Measures((thin,)),
        findings=Findings(MEASURES, CURVES, (HOSTILE,)),
        notes=(HOSTILE,),
    )


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    with pytest.MonkeyPatch.context() as patched:  # pictures have tests of their own
        patched.setattr(_report, "picture", lambda *_, **__: DOT)
        path.write_text(report_html(result()), encoding="utf-8")
    return path


@pytest.fixture
def opened(browser, page):
    """The page, opened anew only where a test has left something behind."""
    if getattr(browser, "page", "") != page.as_uri() or browser.evaluate("window.spoilt"):
        browser.open(page)
        browser.wait(DRAWN)
    return browser


def test_it_asks_for_nothing_and_complains_of_nothing(opened):
    assert opened.complaints == []
    assert opened.requests == []
    assert opened.evaluate("window.hacked === undefined")
    assert opened.evaluate("document.querySelector('h1').textContent") == HOSTILE
    assert opened.evaluate("document.querySelectorAll('b').length") == 0


def test_every_plot_is_drawn_in_place_of_the_plain_one(opened):
    found = opened.evaluate(
        "[...document.querySelectorAll('figure.plot')].map(f => [f.id,"
        "f.querySelectorAll('.js-plotly-plot .main-svg').length,"
        "f.querySelector('.drawn').offsetHeight > 300, f.querySelector('.still').offsetHeight])"
    )
    assert [key for key, *_ in found] == [plot.key for plot in plots(CURVES)]
    assert all(count > 0 and high and not still for _, count, high, still in found)
    lines = opened.evaluate(
        "[...document.querySelectorAll('figure.plot')].map(f =>"
        "f.querySelectorAll('.scatterlayer .trace').length)"
    )
    shown = [sum(t.get("showlegend", True) for t in p.figure["data"]) for p in plots(CURVES)]
    assert all(
        there >= 1 for there, p in zip(lines, plots(CURVES), strict=True) if p.title != "Nothing"
    )
    assert lines[0] >= shown[0] == 3


def test_the_body_turns_when_it_is_dragged(opened):
    opened.wait("document.documentElement.dataset.view === 'ready'")
    before = opened.picture("#view")
    assert len(np.unique(before.reshape(-1, 3), axis=0)) > 10
    opened.drag("#view", (-120, 40))
    after = opened.picture("#view")
    changed = (before.astype(int) - after).any(axis=2).mean()
    assert changed > 0.05
    picture = "getComputedStyle(document.querySelector('figure.picture')).display"
    assert opened.evaluate(picture) == "none"


def test_plots_offer_nothing_that_would_leave_the_machine(opened):
    buttons = opened.evaluate(
        "[...document.querySelector('.modebar').querySelectorAll('button, a')]"
        ".map(e => e.dataset.title)"
    )
    assert buttons == ["Zoom", "Pan", "Zoom in", "Zoom out", "Reset axes"]
    assert opened.evaluate("Plotly.Plots && document.querySelectorAll('a[href^=http]').length") == 0


def test_only_scripts_that_the_page_was_made_with_run(opened):
    opened.evaluate("window.spoilt = true")
    put = "{ const s = document.createElement('script'); s.textContent = 'window.hacked = 1';"
    opened.evaluate(put + "document.head.append(s); }")
    assert opened.evaluate("window.hacked === undefined")
    opened.evaluate("document.body.insertAdjacentHTML('beforeend', '<img src=x onerror=hacked=1>')")
    opened.settle()
    assert opened.evaluate("window.hacked === undefined")
    assert sum("Content Security Policy" in said for said in opened.complaints) == 3


def column(browser, table, place):
    return browser.evaluate(
        f"[...document.querySelectorAll('{table} tbody tr')].map(r => r.cells[{place}].innerText)"
    )


def test_tables_sort_by_mouse_and_by_keyboard(opened):
    table = "#key ~ .wide table"
    before = column(opened, table, 5)
    opened.click(f"{table} th:nth-child(6) button")
    up = column(opened, table, 5)
    assert up != before
    assert sorted(up) == sorted(before)
    told = [float(text.replace("\u202f", "")) for text in up if text != "—"]
    assert told == sorted(told)
    assert set(up[len(told) :]) == {"—"}
    head = f"document.querySelector('{table} th:nth-child(6)').getAttribute('aria-sort')"
    assert opened.evaluate(head) == "ascending"
    opened.focus(f"{table} th:nth-child(6) button")
    opened.press("Enter")
    assert column(opened, table, 5)[: len(told)] == up[: len(told)][::-1]
    assert opened.evaluate(head) == "descending"
    opened.focus(f"{table} th:nth-child(1) button")
    opened.press(" ")
    names = column(opened, table, 0)
    assert names == sorted(names, key=str.casefold)
    assert opened.evaluate(head) is None


def test_the_keyboard_reaches_everything(browser, page):
    browser.open(page)
    browser.wait(DRAWN)
    opened, reached = browser, []
    opened.press("Tab")
    assert opened.evaluate("getComputedStyle(document.activeElement).outlineWidth") == "3px"
    opened.press("Tab", shift=True)
    for _ in range(TABS):
        opened.press("Tab")
        here = opened.evaluate(
            "(e => e === document.body ? '' : e.tagName + ' ' + (e.closest('[id]') || e).id + ' ' +"
            "(e.innerText || e.getAttribute('aria-label') || '').slice(0, 40))"
            "(document.activeElement)"
        )
        if not here or (reached and here == reached[0]):
            break
        reached.append(here)
    assert reached[0].startswith("A ")
    assert reached[0].endswith("Skip to the content")
    tags = [text.split()[0] for text in reached]
    assert tags.count("BUTTON") >= 30
    assert sum("the numbers" in text for text in reached if text.startswith("SUMMARY")) == len(
        plots(CURVES)
    )
    assert any("Save the plot" in text for text in reached)
    assert any(text.startswith("CANVAS view") for text in reached)
    assert {"view-front", "view-x"} <= {text.split()[1] for text in reached if " " in text}


def test_everything_that_is_used_or_looked_at_has_a_name(opened):
    nodes = opened.call("Accessibility.getFullAXTree")["nodes"]
    wanted = {"button", "link", "table", "region", "heading", "navigation"}
    named = [
        (node["role"]["value"], node.get("name", {}).get("value", ""))
        for node in nodes
        if not node["ignored"] and node.get("role", {}).get("value") in wanted
    ]
    roles = [role for role, _ in named]
    assert wanted == set(roles)
    assert [role for role, name in named if not name.strip()] == []
    labels = opened.evaluate(
        "[...document.querySelectorAll('img, [role=img], [role=group]')]"
        ".map(e => e.alt || e.getAttribute('aria-label') || e.getAttribute('aria-labelledby'))"
    )
    assert len(labels) > 2 * len(plots(CURVES))
    assert all(labels)
    landmarks = {node["role"]["value"] for node in nodes if "role" in node}
    assert {"banner", "main", "contentinfo"} <= landmarks


def test_it_prints_on_several_pages_with_plain_drawings(opened):
    pdf = opened.pdf(preferCSSPageSize=True)
    assert pdf.startswith(b"%PDF")
    assert len(re.findall(rb"/Type /Page\b", pdf)) > 2
    sizes = set(re.findall(rb"/MediaBox \[([\d. ]+)\]", pdf))
    (box,) = [[float(v) for v in size.split()] for size in sizes]
    assert box == pytest.approx([0, 0, 595, 842], abs=1)
    assert re.search(rb"/Title ", pdf)
    opened.media("print")
    shown = opened.evaluate(
        "[...document.querySelectorAll('figure.plot')].map(f => ['.still', '.drawn', '.numbers',"
        "'button'].map(s => getComputedStyle(f.querySelector(s)).display))"
    )
    assert shown == [["block", "none", "none", "none"]] * len(plots(CURVES))
    displays = "s => getComputedStyle(document.querySelector(s)).display"
    assert opened.evaluate(f"['#viewer', 'figure.picture'].map({displays})") == ["none", "block"]
    opened.media()


def test_without_scripts_all_can_be_read(browser, page):
    browser._fresh()
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    browser.page = page.as_uri()
    browser.complaints.clear()
    browser.call("Page.navigate", url=browser.page)
    browser.wait("document.readyState === 'complete' && document.querySelector('footer') !== null")
    assert browser.evaluate("document.querySelectorAll('thead button').length") == 0
    heights = "[...document.querySelectorAll('.still')].map(e => e.offsetHeight > 200)"
    assert browser.evaluate(heights) == [True] * len(plots(CURVES))
    assert browser.complaints == []
    shown = "getComputedStyle(document.querySelector('figure.picture')).display"
    assert browser.evaluate(shown) == "block"
    browser.page = ""


def test_nothing_moves_for_who_does_not_want_it(opened):
    behaviour = "getComputedStyle(document.documentElement).scrollBehavior"
    assert opened.evaluate(behaviour) == "smooth"
    opened.media(prefers_reduced_motion="reduce")
    assert opened.evaluate(behaviour) == "auto"
    opened.media()


def test_a_narrow_window_scrolls_tables_and_not_the_page(opened):
    opened.resize(360, 800)
    opened.settle()
    assert opened.evaluate("document.documentElement.scrollWidth") <= 360
    opened.resize(*opened.size)


def test_links_to_what_is_folded_unfold_it(opened):
    opened.evaluate("window.spoilt = true")
    opened.evaluate(
        "document.querySelector('#origin').insertAdjacentHTML('afterend',"
        "'<details id=folded><summary>x</summary><p id=inside>y</p></details>')"
    )
    opened.evaluate("location.hash = 'inside'")
    opened.wait("document.getElementById('folded').open")


def test_a_comparison_is_a_page_as_good(browser, tmp_path):
    path = tmp_path / "comparison.html"
    other = Measures(tuple(replace(m, value=1.5 * m.value) for m in MEASURES))
    one = Material(HOSTILE, "One", measures=MEASURES, curves=CURVES)
    two = Material("two", "Two", measures=other, curves=CURVES)
    path.write_text(compare_html([one, two]), encoding="utf-8")
    browser.open(path)
    browser.wait(DRAWN)
    assert browser.complaints == []
    assert browser.requests == []
    assert browser.evaluate("document.querySelectorAll('.js-plotly-plot').length") == len(
        plots(CURVES)
    )
    browser.click("#key ~ .wide table th:nth-child(4) button")
    first = column(browser, "#key ~ .wide table", 3)
    browser.click("#key ~ .wide table th:nth-child(4) button")
    assert column(browser, "#key ~ .wide table", 3) == first[::-1] != first


@pytest.mark.parametrize("edge", [80, pytest.param(256, marks=pytest.mark.nightly)])
def test_a_page_of_256_voxels_an_edge_is_light(tmp_path, monkeypatch, edge):
    monkeypatch.setattr(_report, "picture", lambda *_, **__: DOT * 10_000)
    noise = np.random.default_rng(3).standard_normal((edge,) * 3, np.float32)
    grid = np.where(gaussian_filter(noise, 4, mode="wrap") > 0, 255, 0).astype(np.uint8)
    frame = Frame((0, 0, 0), (1, 1, 1), grid.shape, unit="um")
    voxels = VoxelGrid(frame, grid)
    many = Result(
        None,
        grid=voxels,
        surface=extract_surface(voxels),
        measures=MEASURES,
        findings=Findings(MEASURES, CURVES),
    )
    assert len(many.surface.triangles) > 15 * edge**2
    path = tmp_path / "report.html"
    path.write_text(report_html(many), encoding="utf-8")
    assert path.stat().st_size < 8_000_000
    with Browser(chromium(), seconds=90) as browser:
        browser.open(path)
        browser.wait(DRAWN)
        browser.wait("document.documentElement.dataset.view === 'ready'")
        assert browser.complaints == []
        assert browser.requests == []
