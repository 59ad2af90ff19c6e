"""What each measure and each method is, read from the page of measures: one source for both."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

PAGE, CITATION = "measures.md", "CITATION.cff"

OTHERS = "Further numbers"
"""What rows stand under that the page of measures does not know."""

CELL = re.compile(r"(?<!\\)\|")
SIDE = re.compile(r"_(?:[xyz](?:min|max)?|[xyz]{2}|p?\d+)$")
"""How names end of which the page has one in place of all: axes, sides, numbers."""


@dataclass(frozen=True)
class Definition:
    """What a measure is.

    Parameters
    ----------
    name
        As on the page; one row may stand for all axes or sides.
    text
        The definition, in Markdown.
    section
        The heading it stands under.
    """

    name: str
    text: str
    section: str


@dataclass(frozen=True)
class Source:
    """A publication: how the page names it, who wrote it, when, and where it is found."""

    named: str
    authors: str
    year: str
    title: str
    published: str

    @property
    def key(self) -> str:
        """How BibTeX calls it."""
        first = re.split(r", | and ", self.authors)[0].split()[-1]
        return re.sub(r"[^a-z0-9]", "", first.casefold().translate(_PLAIN)) + self.year


_PLAIN = str.maketrans({"ü": "u", "ö": "o", "ä": "a", "é": "e", "è": "e", "ß": "ss", "ç": "c"})


def documents(name: str) -> Path:
    """Return where a page is: inside the package once installed, beside it in a checkout."""
    inside = Path(__file__).parent.parent / "_docs" / name
    if inside.is_file():
        return inside
    root = Path(__file__).parent.parent.parent
    return root / name if name == CITATION else root / "docs" / name


@cache
def definitions() -> dict[str, Definition]:
    """Return what is defined on the page of measures, by name, in its order."""
    found = {}
    for section, head, cells in _rows():
        name = re.fullmatch(r"`(\w+)`", cells[0])
        if name and head[0] == "name":
            found[name[1]] = Definition(name[1], cells[2], section)
    return found


@cache
def methods() -> dict[str, str]:
    """Return what each method does, in Markdown."""
    return {
        method: cells[1]
        for _, head, cells in _rows()
        if head[0] == "method"
        for method in cells[0].split(", ")
    }


@cache
def sources() -> tuple[Source, ...]:
    """Return the publications that the page names."""
    return tuple(Source(*cells) for _, head, cells in _rows() if head[0] == "named")


def definition(name: str) -> Definition | None:
    """Return what a measure is; of an axis, a side or a number what is said of another of them."""
    known = definitions()
    if name in known:
        return known[name]
    stem = SIDE.sub("", name)
    alike = [other for other in known if stem != name and SIDE.sub("", other) == stem]
    return known[alike[0]] if alike else None


def _rows() -> Iterator[tuple[str, list[str], list[str]]]:
    """Yield heading, head and cells of each row of each table."""
    section, head = "", list[str]()
    for line in documents(PAGE).read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            section = line.lstrip("# ")
        if not line.startswith("| "):
            head = []
            continue
        cells = [cell.strip().replace(r"\|", "|") for cell in CELL.split(line)[1:-1]]
        if not head:
            head = cells
        elif set(cells[0]) - set("-:"):
            yield section, head, cells
