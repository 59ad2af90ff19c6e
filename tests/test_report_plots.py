"""Curves on a page: by plotly, drawn plainly, told in words, listed; and as tables of text."""

import base64
import csv
import io
import json
import math
import re
import xml.etree.ElementTree as ET
import zlib
from dataclasses import replace

import numpy as np
import pytest
from report_curves import BELL, CURVES, HOSTILE, X, curve, plotted

from porous.errors import FormatError
from porous.report import curves_csv, measures_csv
from porous.report._csv import read_curves
from porous.report._page import embedded
from porous.report._plots import DRAWN_POINTS, LISTED, clipped, plots, thinned
from porous.report._svg import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, drawing
from porous.values import Measure, Measures

SVG = "{http://www.w3.org/2000/svg}"


def svg_of(lines):
    return ET.fromstring(drawing(lines))


def places(text):
    return np.array([[float(v) for v in pair.split(",")] for pair in text.split()])


# --- on the page ---------------------------------------------------------------------------


def test_curves_of_one_name_and_the_same_axes_share_a_plot():
    found = plots(CURVES)
    assert [plot.title for plot in found] == [
        "Pore size",
        "Decay",
        "Growth",
        "Single",
        "Nothing",
        "Flat",
    ]
    assert len({plot.key for plot in found}) == len(found)
    other = replace(CURVES[1], y_unit="mm")
    assert len(plots((CURVES[0], other))) == 2


def test_a_page_has_every_plot_thrice_in_words_and_its_numbers():
    html = plotted()
    for plot in plots(CURVES):
        assert html.count(f'data-figure="{plot.key}"') == 1
    assert html.count("<svg") == html.count('role="img"') == len(plots(CURVES))
    assert html.count('<details class="numbers">') == len(plots(CURVES))
    words = re.findall(r'role="img" aria-label="([^"]*)"', html)
    assert all(len(text) > 40 for text in words)


def test_what_is_embedded_is_what_was_measured():
    (data,) = re.findall(r'<script type="application/json" id="figures">(.*?)</script>', plotted())
    figures = list(json.loads(data).values())
    traces = figures[0]["data"]
    assert [trace.get("name") for trace in traces if trace.get("showlegend", True)] == [
        "pore",
        HOSTILE.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;"),
        "=1+1",
    ]
    low, high, line = traces[:3]
    np.testing.assert_allclose(line["x"], X, rtol=1e-6)
    np.testing.assert_allclose(line["y"], BELL, rtol=1e-6)
    np.testing.assert_allclose(low["y"], 0.9 * BELL, rtol=1e-6)
    np.testing.assert_allclose(high["y"], np.minimum(1.1 * BELL, 1), rtol=1e-6)  # a share
    assert line["line"]["shape"] == low["line"]["shape"] == "hv"
    assert high["fill"] == "tonexty"
    assert figures[1]["layout"]["xaxis"]["type"] == figures[1]["layout"]["yaxis"]["type"] == "log"
    assert figures[2]["data"][0]["y"] == [0.3, None, None]
    assert figures[2]["data"][0]["mode"] == "markers"


def test_plotly_comes_along_once_and_whole():
    (packed,) = re.findall(r'id="plotly">(.*?)</script>', plotted())
    source = zlib.decompress(base64.b64decode(packed)).decode()
    assert source.lstrip().startswith("/**\n* plotly.js v")
    assert len(plotted()) < 2_500_000


@pytest.mark.parametrize("text", ["</script>", "<!--", "a\u2028b", "&amp;", "]]>"])
def test_json_in_a_page_cannot_end_its_element(text):
    said = embedded({text: [text]})
    assert not re.search(r"[<>&\u2028]", said)
    assert json.loads(said) == {text: [text]}


def test_words_tell_range_median_and_peak():
    (plot,) = plots([curve("x", "pore", np.array([1.0, 2, 3, 4]), np.array([5.0, -1, 9, 2]))])
    assert plot.words == (
        "share over diameter / mm. pore: 4 values for 1 to 4, from −1 to 9, median 3.5, "
        "greatest at 3."
    )
    assert "none of them finite" in plots(CURVES)[4].words


def test_numbers_are_listed_up_to_so_many_and_the_rest_is_told():
    few, many = plots(CURVES)[2], plots(CURVES)[1]
    assert [cells[0] for _, cells in few.rows] == [("1", "1.0"), ("2", "2.0"), ("3", "3.0")]
    assert few.remark == ""
    assert len(many.rows) <= LISTED
    assert many.rows[0][1][0] == ("0.01", "0.01")
    assert many.remark == f"{len(many.rows)} of 9003 points; curves.csv has all."


def test_a_thinned_curve_keeps_its_ends_and_has_only_points_that_there_were():
    thin = thinned(CURVES[3], DRAWN_POINTS)
    assert len(thin.x) <= DRAWN_POINTS
    assert (thin.x[0], thin.x[-1]) == (CURVES[3].x[0], CURVES[3].x[-1])
    assert set(thin.x.tolist()) <= set(CURVES[3].x.tolist())
    assert thinned(CURVES[0], len(X)) is CURVES[0]


# --- without scripts -----------------------------------------------------------------------


@pytest.mark.parametrize("plot", plots(CURVES), ids=lambda plot: plot.title)
def test_plain_drawings_are_well_formed_and_stay_in_their_frame(plot):
    tree = ET.fromstring(plot.svg)
    numbers = re.findall(r"(?<![\d#.a-f])-?\d+\.\d+", plot.svg)
    assert all(math.isfinite(float(n)) for n in numbers)
    assert "nan" not in plot.svg
    assert "inf" not in plot.svg
    for line in tree.iter("polyline"):
        at = places(line.get("points"))
        assert (at[:, 0] >= LEFT - 0.1).all()
        assert (at[:, 0] <= WIDTH - RIGHT + 0.1).all()
        assert (at[:, 1] >= TOP - 0.1).all()
        assert (at[:, 1] <= HEIGHT - BOTTOM + 0.1).all()


def test_a_plain_line_goes_where_its_ticks_say():
    tree = svg_of([curve("x", "s", np.array([1.0, 2, 3, 5]), np.array([10.0, 40, 20, 30]))])
    (line,) = tree.iter("polyline")
    at = places(line.get("points"))
    ticks = {
        t.text: float(t.get("x"))
        for t in tree.iter("text")
        if t.get("text-anchor") == "middle" and t.get("x")
    }
    assert at[0, 0] == pytest.approx(ticks["1"], abs=0.11)
    assert at[3, 0] == pytest.approx(ticks["5"], abs=0.11)
    heights = {
        t.text: float(t.get("y")) - 5 for t in tree.iter("text") if t.get("text-anchor") == "end"
    }
    assert at[:, 1] == pytest.approx([heights[w] for w in ("10", "40", "20", "30")], abs=0.11)


def test_plain_logarithmic_axes_have_a_tick_a_decade():
    tree = svg_of([curve("x", "s", np.array([1.0, 1000.0]), np.array([1.0, 2.0]), log="x")])
    words = [t.text for t in tree.iter("text")]
    assert [w for w in words if w in {"1", "10", "100", "1000"}][:4] == ["1", "10", "100", "1000"]


def test_plain_steps_hold_until_the_next():
    tree = svg_of([curve("x", "s", np.array([0.0, 1, 2]), np.array([1.0, 3, 2]), drawn="steps")])
    (line,) = tree.iter("polyline")
    at = places(line.get("points"))
    assert len(at) == 5
    assert at[1].tolist() == [at[2][0], at[0][1]]


def test_hostile_names_do_not_leave_a_drawing():
    texts = [t.text for t in ET.fromstring(plots(CURVES)[0].svg).iter("text")]
    assert HOSTILE in texts


# --- tables of text ------------------------------------------------------------------------

ROWS = Measures(
    (
        Measure("porosity", 1 / 3, "1", "voxel fill", 1e-17, "bound", "grid"),
        Measure("x", -math.inf, "mm", '=cmd|" /C calc"!A0', math.inf, "standard", "volume"),
        Measure("y, z", -0.5, "@u", "line\nbreak", math.nan, "bound", "model"),
    )
)


def test_measures_in_csv_are_those_of_measures_json_in_full():
    text = measures_csv(ROWS).decode()
    assert text.splitlines()[0] == "name,value,unit,method,uncertainty,kind,of"
    assert text.count("\r\n") == len(ROWS) + 1
    rows = list(csv.DictReader(io.StringIO(text, newline="")))
    assert [float(row["value"]) for row in rows] == [1 / 3, -math.inf, -0.5]
    assert rows[0]["uncertainty"] == "1e-17"
    assert rows[2]["method"] == "line\nbreak"
    assert rows[2]["name"] == "y, z"


def test_no_text_becomes_a_formula():
    rows = list(csv.reader(io.StringIO(measures_csv(ROWS).decode(), newline="")))
    assert rows[2][3].startswith("'=cmd")
    assert rows[3][2] == "'@u"
    assert rows[2][1] == "-inf"
    lines = list(csv.reader(io.StringIO(curves_csv(CURVES).decode(), newline="")))
    said = {cell for row in lines[1:] for cell in (*row[:7], *row[11:])}
    assert {"'=1+1", "'-x"} <= said
    assert not any(cell.startswith(("=", "+", "-", "@")) for cell in said)


def test_curves_come_back_from_csv_bit_by_bit():
    back = read_curves(curves_csv(CURVES), "curves.csv")
    assert len(back) == len(CURVES)
    for ours, given in zip(back, CURVES, strict=True):
        for name in given.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(ours, name), getattr(given, name), strict=True)
    guarded = curve("'=", "'", X, BELL)
    assert read_curves(curves_csv([guarded]), "curves.csv") == (guarded,)
    assert read_curves(curves_csv([]), "curves.csv") == ()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda _: b"", "got the columns nothing"),
        (lambda _: b"a,b\r\n1,2\r\n", "got the columns a, b; wanted name, series"),
        (lambda b: b.replace(b"steps", b"stops"), "drawn: got 'stops'"),
        (lambda b: b[:-9], "is damaged"),
        (lambda b: b.replace(b"0.1,", b"zero,", 1), "could not convert"),
        (lambda b: b + b'"', "is damaged"),
        (lambda b: b + b"\xff", "is damaged"),
    ],
)
def test_damaged_curves_are_refused(change, said):
    with pytest.raises(FormatError, match=f"^out/curves.csv: .*{said}"):
        read_curves(change(curves_csv(CURVES[:1])), "out/curves.csv")


# --- what is drawn, and how it is called ---------------------------------------------------


@pytest.mark.parametrize(
    ("given", "low", "high"),
    [
        ({"y_name": "part of the volume"}, 0.0, 1.0),
        ({"y_name": "area", "y_unit": "1/mm"}, 0.0, 1.4),
        ({"y_name": "slope"}, -0.5, 1.4),
    ],
)
def test_bands_end_where_their_quantity_does(given, low, high):
    y = np.array([0.5, 1.0])
    one = clipped(curve("c", "s", np.array([1.0, 2.0]), y, low=y - 1, high=y + 0.4, **given))
    assert (one.low.min(), one.high.max()) == (low, high)


def test_bands_are_called_what_they_are():
    x = np.array([1.0, 2.0])
    lines = [curve(n, "s", x, x, low=x, high=x) for n in ("size", "representative_volume")]
    size, boxes = plots([*lines])
    assert size.band == "Bands are one standard uncertainty wide to either side."
    assert "one standard deviation of boxes" in boxes.band
    assert plots([curve("size", "s", x, x)])[0].band == ""


def test_axes_of_what_is_never_negative_begin_at_nought():
    x = np.array([0.0, 1.0])
    (counts,) = plots([curve("islands", "s", x, 0 * x)])
    assert counts.figure["layout"]["yaxis"]["rangemode"] == "nonnegative"
    assert "−" not in counts.svg
    (slopes,) = plots([curve("slopes", "s", x, -x)])
    assert "rangemode" not in slopes.figure["layout"]["yaxis"]
    assert "−" in slopes.svg


def test_titles_and_axes_do_not_repeat_themselves():
    x = np.array([0.0, 1.0])
    given = {"y_name": "chord", "x_unit": "um"}
    first, other = plots([curve("chord", "s", x, x, x_name=n, **given) for n in ("To x", "to y")])
    assert (first.title, other.title) == ("Chord over to x", "Chord over to y")
    assert first.head[1] == "to x / µm"
    assert "to x / µm" in first.svg


def test_legends_of_many_lines_stand_below_and_make_room():
    x = np.array([0.0, 1.0])
    (few,) = plots([curve("c", "s", x, x)])
    (many,) = plots([curve("c", f"s{i}", x, x) for i in range(15)])
    assert many.figure["layout"]["legend"]["yanchor"] == "top"
    assert many.figure["layout"]["height"] >= few.figure["layout"]["height"] + 15 * 20


def test_lines_of_five_materials_can_be_told_apart():
    x = np.array([0.0, 1.0])
    (many,) = plots([curve("c", f"s{i}", x, x) for i in range(15)])
    looks = {(t["line"]["color"], t["line"]["dash"]) for t in many.figure["data"]}
    assert len(looks) == 15
