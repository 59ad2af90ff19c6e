"""What was done, ready to be pasted into a paper, and how to cite it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from porous.report._definitions import CITATION, definition, documents, methods, sources
from porous.report._digits import number, unit_text
from porous.report._names import CLOSED, LABELS, called
from porous.report._provenance import surroundings, times
from porous.values import Measures

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from porous.pipeline import Origin, Result
    from porous.report._definitions import Source
    from porous.values import Measure

MANY = 8
"""Names of measures that a sentence takes where none of them is a key number."""

PERCENTILE = re.compile(r"_p\d\d$")
AXIS = re.compile(r" along [xyz]$")


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
    means = [PERCENTILE.sub("_mean", name) for name in measures.names]  # whose source is theirs
    names = dict.fromkeys((*measures.names, *means))
    texts = [known.text for known in map(definition, names) if known]
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
    recipe, source = result.recipe, result.source
    if recipe is None:
        body = f"The file {source.name}{_hashed(source)}" if source else "A body"
        yield f"{body} was read and measured with porous {version}."
        return
    after = f" (after {recipe.source})" if recipe.source else ""
    yield (
        f"{recipe.title or 'A body'}{after} was made and measured with porous {version} from a "
        f"recipe (SHA-256 {recipe.sha256}, seed {recipe.seed})."
    )


def _hashed(source: Origin) -> str:
    return f" (SHA-256 {source.sha256})" if source.sha256 else ""


def _of_stages(result: Result) -> Iterator[str]:
    if result.grid is not None:
        frame = result.grid.frame
        yield (
            f"It was sampled by {times(frame.shape)} voxels of {times(frame.spacing)} "
            f"{unit_text(frame.unit)} (sampling: {result.grid.sampling}), {surroundings(frame)}."
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
    told = _told(measures)
    together: dict[str, list[str]] = {}
    for row in told:
        together.setdefault(row.method, []).append(AXIS.sub("", called(row.name)))
    said = [f"{_listed(names)} by {method}{_by(method)}" for method, names in together.items()]
    yield f"Measured were {'; '.join(said)}."
    named = [source.named for source in cited_by(Measures(told))]
    if named:
        yield f"Definitions follow {'; '.join(named)}."
    if any(row.kind != "exact" for row in told):
        yield (
            "Uncertainties are half-widths: bounds where they are said to be, else two standard "
            "uncertainties (95 %)."
        )


def _told(measures: Measures) -> tuple[Measure, ...]:
    """Return the rows that a paper would tell: the key numbers, as measured where they were."""
    names = [name for name in LABELS if name in measures] or measures.names[:MANY]
    rows = []
    for name in names:
        taken = tuple(row for row in measures.all(name) if row.method != CLOSED)
        rows.append(Measures(taken or measures.all(name))[name])
    return tuple(rows)


def _listed(names: list[str]) -> str:
    once = list(dict.fromkeys(names))
    return " and ".join((", ".join(once[:-1]), once[-1])) if len(once) > 1 else once[0]


def _by(method: str) -> str:
    named = [source.named for source in sources() if source.named in methods().get(method, "")]
    return f" ({'; '.join(named)})" if named else ""
