"""TOML texts: what is refused before it is parsed, and that writing and reading agree."""

from __future__ import annotations

import math
import os
import time
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from porous import toml
from porous.errors import RecipeError

HOSTILE = {
    "brackets": ("a = " + "[" * 100_000, "brackets 100000 deep"),
    "tables": ("a = " + "{ b = " * 70 + "1" + "}" * 70, "brackets 70 deep"),
    "dots": ("a" + ".b" * 20_000 + " = 1", "a key of 20001 parts"),
    "spaced dots": ("a" + " .\tb" * 70 + " = 1", "a key of 71 parts"),
    "quoted dots": ('"a"' + ".'b'" * 70 + " = 1", "a key of 71 parts"),
    "dots in brackets": ("x = { a" + ".b" * 70 + " = 1 }", "a key of 71 parts"),
    "dots in a header": ("[a" + ".b" * 70 + "]", "a key of 71 parts"),
    "open string": ('a = "' + '\\"' * 500_000, "not TOML"),
    "open long string": ('a = """' + "\\" * 999_999, "not TOML"),
    "quotes": ("a = '" * 200_000, "not TOML"),
    "blanks": ("a" + " " * 1_000_000, "not TOML"),
    "many digits": ("a = " + "9" * 5000, "not TOML"),
    "nul": ("a = 1\0", "not TOML"),
    "twice": ("a = 1\na = 2\nb = 3", "line 2"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_texts_are_refused_at_once(name):
    text, words = HOSTILE[name]
    begin = time.perf_counter()
    with pytest.raises(RecipeError, match=words):
        toml.parse_table(text, "it.toml")
    assert time.perf_counter() - begin < 5


def test_brackets_and_dots_in_strings_and_comments_count_for_nothing():
    text = "# " + "[" * 500 + "." * 500 + '\na = "' + "[" * 500 + "." * 500 + '"\nb = 1.5\n'
    text += "c = '''\n" + "[." * 500 + "'''\nd = \"\"\"\n" + '[.\\"' * 500 + '"""\n'
    assert toml.parse_table(text, "it") == tomllib.loads(text)


def test_many_flat_values_are_fine():
    text = "a = [" + "[1.5, 2.5], " * 20_000 + "]"
    assert len(toml.parse_table(text, "it")["a"]) == 20_000


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\xff\xfea\x00", "not UTF-8 text: byte 0"),
        (b"a = 1\n# caf\xe9", "not UTF-8 text: byte 11"),
        (b"#" * (toml.LARGEST_FILE + 1), "more than 1048576 bytes"),
    ],
)
def test_wrong_files_are_refused(tmp_path, content, words):
    path = tmp_path / "it.toml"
    path.write_bytes(content)
    with pytest.raises(RecipeError, match=words):
        toml.read_table(path)


def test_byte_order_mark_and_windows_lines_are_fine(tmp_path):
    path = tmp_path / "it.toml"
    path.write_bytes(b"\xef\xbb\xbfa = 1\r\nb = 2\r\n")
    assert toml.read_table(path) == {"a": 1, "b": 2}


def test_folders_pipes_and_missing_files_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path, words in [
        (tmp_path, "is a folder"),
        (tmp_path / "pipe", "not an ordinary file"),
        (tmp_path / "none.toml", "no such file"),
        (tmp_path / ("x" * 300), "name too long"),
        ("a\0b", "cannot be read"),
    ]:
        with pytest.raises(RecipeError, match=words):
            toml.read_table(path)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("3", 3),
        ("1e-3", 1e-3),
        ("true", True),
        ("steel", "steel"),
        ("marching-cubes", "marching-cubes"),
        ("m.toml", "m.toml"),
        ("../materials/steel-2.toml", "../materials/steel-2.toml"),
        ("/a/b.toml", "/a/b.toml"),
        ("true.toml", "true.toml"),
        ("1.5", 1.5),
        ("-inf", -math.inf),
        ('"a b"', "a b"),
        ("[1, 2.5]", [1, 2.5]),
        ("{ size = 0.2 }", {"size": 0.2}),
    ],
)
def test_values_are_toml_and_bare_words_strings(text, value):
    assert toml.parse_value(text, "--set x") == value


@pytest.mark.parametrize(
    "text", ["", "1 2", "a b", "3.4.5", "1m.toml", "a.b c", ".a", "[1,", "1\nb = 2", "é", "'"]
)
def test_values_that_are_not_toml_are_refused(text):
    with pytest.raises(RecipeError, match="--set x"):
        toml.parse_value(text, "--set x")


SCALARS = (
    st.booleans()
    | st.integers(-(2**62), 2**62)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(codec="utf-8", exclude_characters="\r"), max_size=40)
)
KEYS = st.text(st.characters(codec="utf-8", exclude_characters="\r"), min_size=1, max_size=8)
TABLES = st.recursive(
    st.dictionaries(KEYS, SCALARS | st.lists(SCALARS, max_size=40), max_size=4),
    lambda inner: st.dictionaries(
        KEYS, SCALARS | inner | st.lists(inner, min_size=1, max_size=3), max_size=4
    ),
    max_leaves=8,
)


@given(TABLES)
def test_what_is_written_is_read_back(table):
    text = toml.render_table(table)
    assert tomllib.loads(text) == table
    assert toml.render_table(tomllib.loads(text)) == text


def test_long_arrays_break_into_lines_that_fit():
    text = toml.render_table({"keep": [[i, i, i] for i in range(60)]})
    assert max(map(len, text.splitlines())) <= toml.WIDTH
    assert len(text.splitlines()) <= 12


def test_what_is_shown_in_messages_is_short():
    assert toml.shown({"size": 0.2}) == "{ size = 0.2 }"
    assert len(toml.shown([1.0] * 1000)) == 58
    assert toml.shown(None) == "None"
