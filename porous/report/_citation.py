"""What was done, ready to be pasted into a paper, and how to cite it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from porous.report._definitions import CITATION, definition, documents, methods, sources
from porous.report._digits import number
from porous.report._provenance import surroundings, times

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from porous.pipeline import Result
    from porous.report._definitions import Source
    from porous.values import Measures

MANY = 8
"""Names of measures that a sentence takes."""


@dataclass(frozen=True)
class Citation:
    """A paragraph on what was done, a line to cite porous by, and both as BibTeX."""

    paragraph: str
    line: str
    bibtex: str


def citation(result: Result, version: str) -> Citation:
    """Return what a result was made by, in words for a paper.

    Parameters
    ----------
    result
        What was made.
    version
        Of porous.
    """
    cited = cited_by(result.measures)
    said = (*_of_recipe(result, version), *_of_stages(result), *_of_measures(result.measures))
    return Citation(" ".join(said), software_line(version), bibtex(cited, version))


def cited_by(measures: Measures) -> tuple[Source, ...]:
    """Return the publications that define the measures of a page, or their methods."""
    best = [measures[name] for name in measures.names]
    texts = [known.text for known in map(definition, measures.names) if known]
    texts += [methods().get(row.method, "") for row in best]
    together = " ".join(texts)
    return tuple(source for source in sources() if source.named in together)


def software() -> dict[str, str]:
    """Return title and authors of porous, as its citation file has them."""
    text = documents(CITATION).read_text(encoding="utf-8")
    title = re.search(r'^title: "?(.+?)"?$', text, re.M)
    assert title is not None
    names = re.findall(r'^ +- name: "?(.+?)"?$', text, re.M)
    return {"title": title[1], "authors": " and ".join(names)}


def software_line(version: str) -> str:
    """Return a reference to porous in one line."""
    known = software()
    return f"{known['authors']}. {known['title']}. Version {version}."


def bibtex(cited: Iterable[Source], version: str) -> str:
    """Return porous and publications as BibTeX."""
    known = software()
    own = {"author": known["authors"], "title": known["title"], "version": version}
    entries = [_entry("software", "porous", {**own, "note": f"version {version}"})]
    for source in cited:
        fields = {
            "author": source.authors.replace(", ", " and "),
            "title": source.title,
            "howpublished": source.published,
            "year": source.year,
        }
        entries.append(_entry("misc", source.key, fields))
    return "\n\n".join(entries)


def _entry(kind: str, key: str, fields: dict[str, str]) -> str:
    lines = [f"  {name} = {{{_braced(name, text)}}}," for name, text in fields.items()]
    return "\n".join((f"@{kind}{{{key},", *lines, "}"))


def _braced(name: str, text: str) -> str:
    # BibTeX would make capitals small in titles, and read authors' groups as persons.
    own = name == "title" or (name == "author" and text.startswith("The "))
    return f"{{{text}}}" if own else text


def _of_recipe(result: Result, version: str) -> Iterator[str]:
    recipe = result.recipe
    if recipe is None:
        yield f"A body was read from a file and measured with porous {version}."
        return
    after = f" (after {recipe.source})" if recipe.source else ""
    yield (
        f"{recipe.title or 'A body'}{after} was made and measured with porous {version} from a "
        f"recipe (SHA-256 {recipe.sha256}, seed {recipe.seed})."
    )


def _of_stages(result: Result) -> Iterator[str]:
    if result.grid is not None:
        frame = result.grid.frame
        yield (
            f"It was sampled by {times(frame.shape)} voxels of {times(frame.spacing)} {frame.unit} "
            f"(sampling: {result.grid.sampling}), {surroundings(frame)}."
        )
    if result.surface is not None:
        triangles = result.surface.triangles
        count = triangles if isinstance(triangles, int) else len(triangles)
        yield f"Its surface was taken as {number(count)} triangles."
    if result.volume is not None:
        yield f"Its volume was meshed by {number(result.volume.cells)} elements."


def _of_measures(measures: Measures) -> Iterator[str]:
    if not len(measures):
        return
    together: dict[str, list[str]] = {}
    for name in measures.names:
        together.setdefault(measures[name].method, []).append(name.replace("_", " "))
    said = [f"{_listed(names)} by {method}{_by(method)}" for method, names in together.items()]
    yield f"Measured were {'; '.join(said)}."
    named = [source.named for source in cited_by(measures)]
    if named:
        yield f"Definitions follow {'; '.join(named)}."
    yield (
        "Uncertainties are half-widths: bounds where they are said to be, else two standard "
        "uncertainties (95 %)."
    )


def _listed(names: list[str]) -> str:
    more = len(names) - MANY
    return ", ".join(names[:MANY]) + (f" and {more} more" if more > 0 else "")


def _by(method: str) -> str:
    named = [source.named for source in sources() if source.named in methods().get(method, "")]
    return f" ({'; '.join(named)})" if named else ""
