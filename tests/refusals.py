"""Command lines that must fail: in one line, with the right code, leaving nothing behind."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from porous.cli import main

if TYPE_CHECKING:
    from pathlib import Path


def refuse(folder: Path, capsys, argv: list[str], code: int, words: str) -> None:
    """Run a command line that must fail: one line, its words, its code, no traces."""
    before = contents(folder)
    assert main(argv) == code
    said = capsys.readouterr()
    last = said.err.splitlines()[-1]
    assert said.out == ""
    assert last.startswith("porous: ")
    assert re.search(words, last), last
    assert "Traceback" not in said.err
    assert "fault of porous" not in last
    assert "\n  " not in said.err
    assert contents(folder) == before


def contents(folder: Path) -> dict[str, bytes | None]:
    """Return everything below a folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }
