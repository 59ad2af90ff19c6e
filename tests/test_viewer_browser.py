"""The view of a body in a real browser: it is drawn, turns, and asks for nothing."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from browser import Browser, chromium
from scipy.ndimage import uniform_filter

from porous.measures import LocalThickness
from porous.pipeline import Result
from porous.recipe import load
from porous.report._scene import scene, scene_html
from porous.stages import extract_surface
from porous.values import Frame, VoxelGrid

pytestmark = [pytest.mark.slow, pytest.mark.judge]

POLICY = (
    "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
)
READY = "document.documentElement.dataset.view"


def page(result, path):
    piece = scene_html(scene(result))
    path.write_text(
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>A body</title>'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}"></head>'
        f'<body style="margin: 10px">{piece}<figure class="picture">still</figure></body></html>',
        encoding="utf-8",
    )
    return path


def gyroid(shape=(36, 30, 42)):
    x, y, z = np.meshgrid(*((np.arange(n) + 0.5) / 18 * 2 * np.pi for n in shape), indexing="ij")
    wave = (
        np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x) + 0.2 * np.sin(x / 2)
    )
    frame = Frame((1.0, 2.0, 3.0), (0.1, 0.12, 0.1), shape, unit="mm")
    return VoxelGrid(frame, np.clip(127.5 - 300 * wave, 0, 255).astype(np.uint8))


def depths(grid, mask, phase):
    """Return a map that is wide where much of the phase is about: what colours need, and quick."""
    about = uniform_filter(mask.astype(np.float32), 9) * mask
    wide = (about > 0) * (0.3 + about).astype(np.float32)
    sizes, counts = np.unique(wide[wide > 0], return_counts=True)
    shares = counts / counts.sum()
    return LocalThickness(grid.frame, wide, phase, sizes, shares, float(sizes[0]), 0.1)


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """A body with local thickness and limits, and one of a mesh alone."""
    folder = tmp_path_factory.mktemp("pages")
    grid = gyroid()
    surface = extract_surface(grid)
    maps = {"pore": depths(grid, ~grid.solid, "pore"), "solid": depths(grid, grid.solid, "solid")}
    recipe = load("menger", set={"report.smallest_wall": 0.8, "report.smallest_gap": 0.8})
    full = Result(recipe, grid=grid, surface=surface, maps=maps)
    return SimpleNamespace(
        full=page(full, folder / "full.html"),
        mesh=page(Result(None, surface=surface), folder / "mesh.html"),
    )


@pytest.fixture(scope="module")
def browser():
    with Browser(chromium(), seconds=150, size=(700, 640)) as opened:
        yield opened


def shown(browser, path, query=""):
    browser.open(path, query)
    browser.wait(READY)
    assert browser.evaluate(READY) == "ready"
    browser.media(prefers_reduced_motion="reduce")


def still(browser):
    assert not browser.complaints
    assert not browser.requests


def change(one, other):
    """Return the part of pixels that differ, but for the rim, where focus is shown."""
    off = np.abs(one.astype(int) - other.astype(int)).max(axis=2)
    return float((off[6:-6, 6:-6] > 8).mean())


def slide(browser, name, value):
    browser.evaluate(
        f"(e => {{ e.value = {value}; e.dispatchEvent(new Event('input', {{bubbles: true}})) }})"
        f"(document.getElementById('view-{name}'))"
    )


def test_a_body_is_drawn_and_turns(browser, pages):
    shown(browser, pages.full)
    first = browser.picture("#view")
    assert first.std(axis=(0, 1)).min() > 15  # not blank
    browser.drag("#view", (-90, 20))
    dragged = browser.picture("#view")
    assert change(first, dragged) > 0.1
    browser.focus("#view")
    browser.press("ArrowLeft")
    turned = browser.picture("#view")
    assert change(dragged, turned) > 0.05
    browser.press("+")
    assert change(turned, browser.picture("#view")) > 0.02
    browser.press("ArrowUp", shift=True)
    browser.drag("#view", (30, 10), shift=True)
    browser.wheel("#view", 80)
    browser.drag("#view", (10, 10), button="right")
    moved = browser.picture("#view")
    browser.press("0")
    assert change(moved, browser.picture("#view")) > 0.1
    assert change(first, browser.picture("#view")) == 0
    browser.press("ArrowRight")
    browser.click("#view", count=2)
    assert change(first, browser.picture("#view")) == 0
    still(browser)


def test_fingers_turn_and_zoom(browser, pages):
    shown(browser, pages.full)
    first = browser.picture("#view")
    browser.touch("#view", ((0, 0), (70, 0)))
    turned = browser.picture("#view")
    assert change(first, turned) > 0.1
    browser.touch("#view", ((-40, 0), (-110, 0)), ((40, 0), (110, 0)))
    wide = (np.abs(browser.picture("#view").astype(int) - 245).max(axis=2) > 40).mean()
    assert wide > 1.3 * (np.abs(turned.astype(int) - 245).max(axis=2) > 40).mean()
    still(browser)


def test_buttons_show_sides(browser, pages):
    shown(browser, pages.full)
    seen = []
    for name in ("front", "side", "top", "reset"):
        browser.click(f"#view-{name}")
        seen.append(browser.picture("#view"))
    assert all(change(a, b) > 0.05 for i, a in enumerate(seen) for b in seen[:i])
    browser.click("#view-front")
    names = "['x', 'y', 'z'].map(a => document.getElementById('view-name-' + a).hidden)"
    assert browser.evaluate(names) == [False, True, False]  # y points away
    still(browser)


def test_slices_cut_and_move(browser, pages):
    shown(browser, pages.full)
    whole = browser.picture("#view")
    browser.click("#view-x")
    cut = browser.picture("#view")
    assert change(whole, cut) > 0.03
    slide(browser, "x-at", 0.25)
    assert change(cut, browser.picture("#view")) > 0.03
    assert browser.evaluate("document.getElementById('view-x-is').textContent") == "1.9 mm"
    browser.click("#view-cut")
    browser.click("#view-surface")
    alone = browser.picture("#view")
    greys = alone[np.ptp(alone, axis=2).astype(int) < 4]
    assert greys.min() < 60  # the void is dark
    slide(browser, "x-at", 0.9)
    assert change(alone, browser.picture("#view")) > 0.03
    still(browser)


def test_pores_colours_and_marks_are_told_apart(browser, pages):
    shown(browser, pages.full)
    marked = browser.picture("#view")
    shown_at = "document.getElementById('view-{}').checkVisibility()"
    bars = ("bar-solid", "bar-pore", "thin-solid", "thin-pore")

    def visible():
        return [browser.evaluate(shown_at.format(name)) for name in bars]

    def hot(picture):
        red, green, blue = picture.astype(int).transpose(2, 0, 1)
        return float(((red - green > 60) & (blue - green > 20) & (red > blue)).mean())

    assert visible() == [True, False, True, False]
    assert hot(marked) > 0.005
    browser.click("#view-marks")
    plain = browser.picture("#view")
    assert hot(plain) < 0.001
    browser.click("#view-colour")
    assert visible() == [False] * 4
    assert change(plain, browser.picture("#view")) > 0.1
    for name in ("pores", "colour", "marks"):
        browser.click(f"#view-{name}")
    assert visible() == [True] * 4
    both = browser.picture("#view")
    browser.click("#view-surface")
    assert visible() == [False, True, False, True]
    assert change(both, browser.picture("#view")) > 0.05
    still(browser)


def test_colours_follow_the_thickness(browser, pages):
    shown(browser, pages.full)
    browser.click("#view-marks")
    browser.click("#view-front")
    picture = browser.picture("#view").astype(int)
    body = picture[np.ptp(picture, axis=2) > 25]
    assert len(body) > 10_000
    blue, yellow = body[:, 2] - body[:, 0], body[:, 0] - body[:, 2]
    assert (blue > 30).mean() > 0.05  # thin and thick walls are both there
    assert (yellow > 20).mean() > 0.05


def test_it_is_drawn_when_something_changes_only(browser, pages):
    shown(browser, pages.full)
    browser.settle()
    drawn = "document.getElementById('view').dataset.drawn"
    before = browser.evaluate(drawn)
    browser.evaluate("new Promise(done => setTimeout(done, 300))")
    assert browser.evaluate(drawn) == before
    browser.resize(500, 640, 2.0)
    browser.settle()
    sizes = "c => [c.width / c.clientWidth, c.height / c.clientHeight]"
    assert browser.evaluate(f"({sizes})(document.getElementById('view'))") == pytest.approx(
        [2, 2], rel=0.01
    )
    assert int(browser.evaluate(drawn)) > int(before)
    browser.resize(*browser.size)
    still(browser)


def test_a_lost_card_comes_back(browser, pages):
    shown(browser, pages.full)
    first = browser.picture("#view")
    message = "document.getElementById('view-message').textContent"
    browser.evaluate(
        "window.lose = document.getElementById('view').getContext('webgl2')"
        ".getExtension('WEBGL_lose_context'); lose.loseContext()"
    )
    browser.wait(f"{message} !== ''")
    browser.evaluate("lose.restoreContext()")
    browser.wait(f"{message} === ''")
    assert change(first, browser.picture("#view")) == 0


def test_a_mesh_alone_is_cut_too(browser, pages):
    shown(browser, pages.mesh)
    first = browser.picture("#view")
    browser.click("#view-y")
    assert change(first, browser.picture("#view")) > 0.03
    offered = "n => document.getElementById('view-' + n).checkVisibility()"
    assert browser.evaluate(f"['colour', 'marks', 'cut', 'y'].map({offered})") == [False] * 3 + [
        True
    ]
    still(browser)


def test_it_says_what_it_shows_to_all(browser, pages):
    shown(browser, pages.full)
    canvas = "document.getElementById('view')"
    told = browser.evaluate(f"{canvas}.getAttribute('aria-label')")
    assert re.search(
        r"3\.6 × 3\.6 × 4\.2 mm, .* triangles; colours show pore diameter and wall", told
    )
    described = browser.evaluate(
        f"document.getElementById({canvas}.getAttribute('aria-describedby')).textContent"
    )
    assert described.startswith("Shown: all ")
    nameless = browser.evaluate(
        "[...document.querySelectorAll('#viewer input, #viewer button')].filter(e => "
        "!e.getAttribute('aria-label') && !e.textContent.trim() && !e.labels?.length).length"
    )
    assert nameless == 0
    displays = "s => getComputedStyle(document.querySelector(s)).display"
    assert browser.evaluate(f"['#viewer', 'figure.picture'].map({displays})") == ["block", "none"]
    browser.media("print")
    assert browser.evaluate(f"['#viewer', 'figure.picture'].map({displays})") == ["none", "block"]
    assert browser.pdf().startswith(b"%PDF-")
    browser.media()


def test_without_webgl_the_page_says_so(pages):
    flags = ("--disable-3d-apis",)
    with Browser(chromium(), seconds=30, flags=flags) as opened:
        opened.open(pages.full)
        opened.wait(READY)
        assert opened.evaluate(READY) == "failed"
        said = opened.evaluate("document.getElementById('view-message').textContent")
        assert "no WebGL2" in said
        displays = "s => getComputedStyle(document.querySelector(s)).display"
        assert opened.evaluate(f"['#view-body', 'figure.picture'].map({displays})") == [
            "none",
            "block",
        ]
        assert not opened.requests
