"""What every page has: its head, its policy, scripts that are known by their hash, templates."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import zlib
from functools import cache
from importlib import resources
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from markupsafe import Markup, escape

from porous.report._table import anchor, method_anchor, sortable

if TYPE_CHECKING:
    from collections.abc import Iterable

    from jinja2 import Environment

    from porous.report._plots import Plot

FEW = 12
"""Items of a long list that are shown at once."""

POLICY = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src {scripts}"
"""What a browser lets the page do: run the scripts it was made with, and load nothing."""


def page(
    template: str, *, plots: Iterable[Plot] = (), scripts: Iterable[str] = (), **given: Any
) -> str:
    """Return a page of its own: everything in it, and nothing that anybody else has put there.

    Parameters
    ----------
    template
        The name of its template.
    plots
        What is drawn on it; plotly comes along where there is any.
    scripts
        Besides the page's own, as they stand in it.
    given
        What the template asks for besides; every text is escaped.
    """
    drawn = tuple(plots)
    own = text_of("page.js")
    known = [_hash(text) for text in (own, *scripts)]
    if drawn:
        known.append(_hash(_plotly()))
    body = _environment().get_template(template)
    return body.render(
        **given,
        plots=drawn,
        figures=embedded({plot.key: plot.figure for plot in drawn}) if drawn else "",
        plotly=_packed() if drawn else "",
        policy=Markup(POLICY.format(scripts=" ".join(known))),  # noqa: S704  (hashes alone)
        script=Markup(own),  # noqa: S704  (a file of the package)
        style=Markup(text_of("style.css")),  # noqa: S704  (a file of the package)
        version=version("porous"),
        FEW=FEW,
    )


def embedded(value: Any) -> Markup:
    """Return a value as JSON that may stand in a script element: nothing in it closes one."""
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)  # noqa: S704  (no sign of markup is left)


def markdown(text: str) -> Markup:
    """Return a cell of a page of the docs as HTML: its names of code, without its links."""
    plain = str(escape(re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text)))
    return Markup(re.sub(r"`([^`]*)`", r"<code>\1</code>", plain))  # noqa: S704  (escaped above)


def _hash(script: str) -> str:
    digest = hashlib.sha256(script.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


@cache
def text_of(name: str) -> str:
    """Return a file of the package's page as it stands."""
    return resources.files("porous.report").joinpath(name).read_text(encoding="utf-8")


@cache
def _plotly() -> str:
    """Return the source of plotly.js, out of its Python package."""
    path = resources.files("plotly").joinpath("package_data/plotly.min.js")
    return path.read_bytes().decode("utf-8")


@cache
def _packed() -> str:
    """Return plotly.js deflated, in base64."""
    return base64.b64encode(zlib.compress(_plotly().encode("utf-8"), 9)).decode()


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    made = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=FunctionLoader(text_of),
    )
    made.filters["markdown"] = markdown
    made.globals |= {"anchor": anchor, "method_anchor": method_anchor, "sortable": sortable}
    return made
