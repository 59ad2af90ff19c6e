"""The gate gives what is there, piece by piece, and refuses what is not."""

import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from porous.errors import FormatError
from porous.formats import gate

blanks = st.text(" \t\r\n", min_size=1, max_size=200)
decimals = st.floats(allow_nan=False)


@given(
    values=st.lists(st.tuples(decimals, blanks), max_size=60),
    before=blanks,
    step=st.integers(70, 90),
)
def test_numbers_are_the_same_wherever_the_pieces_end(values, before, step):
    text = before + "".join(f"{value!r}{blank}" for value, blank in values)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gate, "STEP", step)
        result = gate.numbers(text.encode(), "it")
        assert result.tolist() == [value for value, _ in values]
        assert gate.numbers(text.strip().encode(), "it").tolist() == result.tolist()


@pytest.mark.parametrize(
    "text", [b"1 2 three 4", b"1 0x10", b"1,5", b"1 \xff", b"--1", b"1 2 " + b"7" * 65]
)
def test_what_is_no_number(text):
    with pytest.raises(FormatError, match=r"^it: got .*; wanted (a number|numbers)$"):
        gate.numbers(text, "it")


def test_more_numbers_than_were_announced(monkeypatch):
    monkeypatch.setattr(gate, "STEP", 100)
    with pytest.raises(FormatError, match="more than the 120 numbers"):
        gate.numbers(b"1 " * 10_000, "it", most=120)
    assert gate.numbers(b"1 " * 120, "it", most=120).sum() == 120


def test_numbers_take_no_more_memory_than_they_must():
    import tracemalloc

    text = b"1 " * 2_000_000
    tracemalloc.start()
    result = gate.numbers(text, "it")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(result) == 2_000_000
    assert peak < 2.2 * result.nbytes + 30e6


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.5, 2.0**53, -1e300])
def test_what_is_no_whole_number(value):
    with pytest.raises(FormatError, match="wanted a whole number"):
        gate.whole(np.array([1.0, value]), "it")


def test_whole_numbers():
    values = np.array([0.0, -0.0, 3.0, -(2.0**53) + 1])
    assert gate.whole(values, "it").tolist() == [0, 0, 3, -(2**53) + 1]


@pytest.mark.parametrize("text", [None, "", "x", "1.5", "9" * 65, b"\xff"])
def test_what_is_no_integer(text):
    with pytest.raises(FormatError, match=r"^it: got .*; wanted a whole number$"):
        gate.integer(text, "it")


@given(data=st.binary(max_size=500))
def test_inflating_gives_what_was_packed_and_no_other_length(data):
    packed = zlib.compress(data)
    assert gate.inflate(packed, len(data), "it") == data
    for size in {len(data) - 1, len(data) + 1, 10**9} - {-1}:
        with pytest.raises(FormatError, match=r"^it"):
            gate.inflate(packed, size, "it")


def test_inflating_never_makes_more_than_was_announced():
    import tracemalloc

    bomb = zlib.compress(bytes(2**28), 9)
    tracemalloc.start()
    with pytest.raises(FormatError, match="did not decompress to 1000 bytes"):
        gate.inflate(bomb, 1000, "it")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2**20


def test_the_ratio_is_that_of_deflate():
    assert gate.RATIO * len(zlib.compress(bytes(2**26), 9)) > 2**26


def test_refusals_are_cut_short():
    with pytest.raises(FormatError) as caught:
        gate.refuse("it", "x" * 10_000, "less")
    assert len(str(caught.value)) < 100
