"""Curves of every sort that a report may be asked to draw, and a result that has them."""

from functools import cache

import numpy as np

from porous.measures import Findings
from porous.pipeline import Result
from porous.report import report_html
from porous.values import Curve

HOSTILE = "</script><b>{{ 7 * 7 }} & ☃ \u2028"
X = np.linspace(0.1, 3.0, 30)
BELL = np.exp(-((X - 1) ** 2))
LONG = np.geomspace(0.01, 10, 9000)


def curve(name, series, x, y, **more):
    given = {"x_name": "diameter", "x_unit": "mm", "y_name": "share", "y_unit": "1"}
    return Curve(name, series, x, y, **{**given, "method": "local thickness", **more})


CURVES = (
    curve("pore_size", "pore", X, BELL, low=0.9 * BELL, high=1.1 * BELL, drawn="steps"),
    curve("pore_size", HOSTILE, X, BELL**2),
    curve("pore_size", "=1+1", X, -BELL, method="-x", drawn="points"),
    curve("decay", "along x", LONG, LONG**-2.0, log="xy"),
    curve("decay", "along y", np.array([0.0, 1.0, 2.0]), np.array([1.0, 0.0, -1.0]), log="xy"),
    curve(
        "growth",
        "blocks",
        np.array([1.0, 2.0, 3.0]),
        np.array([0.3, np.nan, np.inf]),
        low=np.array([0.2, 0.3, np.nan]),
        high=np.array([0.4, np.inf, 0.5]),
        drawn="points",
        y_name="<i>porosity</i>",
    ),
    curve("single", "one", np.array([1.0]), np.array([0.0])),
    curve("nothing", "none", np.array([1.0, 2.0]), np.array([np.nan, np.nan]), log="y"),
    curve("flat", "level", np.array([1e-300, 1e300]), np.array([5.0, 5.0])),
)


@cache
def plotted():
    """Return the page of a result that has nothing but these."""
    return report_html(Result(recipe=None, findings=Findings(curves=CURVES)))
