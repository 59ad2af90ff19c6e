"""TOML files: guarded before they are parsed, and written the way people write them.

``tomllib`` takes time and memory without bound for deep keys and recursion for deep brackets, so a
text is measured first.
"""

from __future__ import annotations

import re
import stat
import tomllib
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

from porous.errors import RecipeError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

LARGEST_FILE = 1 << 20
"""Bytes that a recipe may have."""

DEEPEST_BRACKETS = 64
DEEPEST_KEY = 64
WIDTH = 100
"""Columns that an array may take before it is broken into lines."""

# Every branch eats to the end of the line or the text where the closing quote is missing, so that
# one pass is enough whatever the text; tomllib then says what is wrong with it.
_OPAQUE = re.compile(
    r'"""(?:\\.?|[^\\])*?(?:"""|\Z)'
    r"|'''.*?(?:'''|\Z)"
    r'|"(?:\\.?|[^"\\\n])*(?:"|\n|\Z)'
    r"|'[^'\n]*(?:'|\n|\Z)"
    r"|#[^\n]*",
    re.DOTALL,
)
WORD = re.compile(r"(?:\.{0,2}/|[A-Za-z_])[A-Za-z0-9_./-]*")
"""What ``parse_value`` takes as a string without quotation marks."""
_BLANKS = str.maketrans("", "", " \t\r")
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def read_table(path: str | Path) -> dict[str, Any]:
    """Return what a TOML file says.

    Raises
    ------
    RecipeError
        Where there is no such file, it is a folder or a device, too large, not UTF-8, nested too
        deeply or not TOML; names the file and, where there is one, the line.
    """
    content = _content(Path(path))
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecipeError(f"{path}: not UTF-8 text: byte {error.start} is wrong") from None
    return parse_table(text, str(path))


def parse_table(text: str, name: str) -> dict[str, Any]:
    """Return what a TOML text says; ``name`` is what errors call it. Raises ``RecipeError``."""
    _guard(text, name)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise RecipeError(f"{name}: not TOML: {_lower(str(error))}") from None


def parse_value(text: str, name: str) -> object:
    """Return the value that a TOML text says; a bare word is a string. Raises ``RecipeError``.

    A word may be a file's name: letters, digits, ``.``, ``/``, ``_`` and ``-``, first a letter,
    ``_``, ``/``, ``./`` or ``../``. No number, date or other value of TOML is such a word.
    """
    if WORD.fullmatch(text) and text not in ("true", "false", "inf", "nan"):
        return text
    if not text or "\n" in text:
        raise RecipeError(f"{name}: got {shown(text)}; wanted a TOML value")
    return parse_table(f"value = {text}", name)["value"]


def shown(value: object) -> str:
    """Return a value as a recipe would say it, shortened for messages."""
    try:
        text = _inline(value)
    except TypeError:
        text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


def render_table(table: Mapping[str, Any]) -> str:
    """Return TOML text: scalars first, then a section for each table; the order is the table's."""
    return "\n".join(_lines(table, "")).lstrip("\n") + "\n"


def _content(path: Path) -> bytes:
    try:
        if path.is_dir():
            raise RecipeError(f"{path}: is a folder; wanted a TOML file or a preset's name")
        if not stat.S_ISREG(path.stat().st_mode):
            raise RecipeError(f"{path}: is not an ordinary file; wanted a TOML file")
        with path.open("rb") as stream:
            content = stream.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise RecipeError(f"{path}: cannot be read: {reason.lower()}") from None
    if len(content) > LARGEST_FILE:
        raise RecipeError(f"{path}: more than {LARGEST_FILE} bytes; wanted a recipe")
    return content


def _guard(text: str, name: str) -> None:
    """Raise ``RecipeError`` for a text that would take tomllib ages or the whole stack."""
    bare = _OPAQUE.sub(_placeholder, text).translate(_BLANKS)
    steps = (1 if mark in "[{" else -1 for mark in re.findall(r"[\[\]{}]", bare))
    depth = max(accumulate(steps), default=0)
    if depth > DEEPEST_BRACKETS:
        raise RecipeError(f"{name}: brackets {depth} deep; wanted at most {DEEPEST_BRACKETS}")
    dots = max(piece.count(".") for piece in re.split(r"[\n,=\[\]{}]", bare))
    if dots >= DEEPEST_KEY:
        raise RecipeError(f"{name}: a key of {dots + 1} parts; wanted at most {DEEPEST_KEY}")


def _placeholder(match: re.Match[str]) -> str:
    return "\n" if match[0].endswith("\n") else "s"


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]


def _lines(table: Mapping[str, Any], path: str) -> Iterator[str]:
    below = {key for key, value in table.items() if _is_section(value, top=not path)}
    for key, value in table.items():
        if key not in below:
            yield f"{_key(key)} = {_value(value, len(key) + 3)}"
    for key, value in table.items():
        if key in below:
            name = f"{path}.{_key(key)}" if path else _key(key)
            single = isinstance(value, dict)
            for part in [value] if single else value:
                yield ""
                yield f"[{name}]" if single else f"[[{name}]]"
                yield from _lines(part, name)


def _is_section(value: object, *, top: bool) -> bool:
    """Tell whether a value is written under a header: every table at the top, long ones below."""
    if isinstance(value, list):
        return bool(value) and all(isinstance(part, dict) for part in value)
    if not isinstance(value, dict):
        return False
    return (
        top or any(isinstance(part, dict) for part in value.values()) or len(_inline(value)) > WIDTH
    )


def _value(value: object, indent: int) -> str:
    text = _inline(value)
    if isinstance(value, list) and len(text) + indent > WIDTH:
        return "[\n" + "".join(f"    {line}\n" for line in _filled(map(_inline, value))) + "]"
    return text


def _filled(parts: Iterable[str]) -> Iterator[str]:
    """Return lines of as many parts as fit."""
    line = ""
    for part in parts:
        if line and len(line) + len(part) + 6 > WIDTH:
            yield line
            line = ""
        line += f"{' ' if line else ''}{part},"
    yield line


def _inline(value: object) -> str:
    if isinstance(value, dict):
        inner = ", ".join(f"{_key(key)} = {_inline(part)}" for key, part in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_inline, value))}]"
    return _scalar(value)


def _scalar(value: object) -> str:
    import tomli_w

    return tomli_w.dumps({"x": value})[4:-1]


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _scalar(key)
