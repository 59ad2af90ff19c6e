"""Counts written down on the way: who is killed counts on, with the same numbers."""

import json

import numpy as np
import pytest

from porous.measures import Census, fold, measure
from porous.measures._boxes import BoxCount
from porous.measures._census import count_fills, count_windows
from porous.measures._connected import Phase
from porous.measures._fold import Together, tiles_of
from porous.scale import Tally, seal
from porous.scale.tally import DIGITS
from porous.values import Frame, VoxelGrid
from porous.values.value import same

SHAPE = (9, 8, 13)


def noise(seed, periodic=(False, True, False)):
    random = np.random.default_rng(seed)
    frame = Frame((0, 0, 0), (1.0, 0.5, 0.25), SHAPE, periodic)
    return VoxelGrid(frame, random.choice([0, 100, 200, 255], SHAPE).astype(np.uint8))


def counts():
    last = tuple(n - 1 for n in SHAPE)
    phases = [
        Phase(solid, way, False, (0, 0, 0), last) for solid in (True, False) for way in (6, 26)
    ]
    return Together((count_fills, count_windows, BoxCount(2), *phases))


def contents(value):
    """Return all arrays and numbers of a count, in order."""
    if hasattr(value, "__dataclass_fields__"):
        value = tuple(getattr(value, name) for name in value.__dataclass_fields__)
    if isinstance(value, tuple | list):
        return [part for inner in value for part in contents(inner)]
    return [value]


def equal(a, b):
    pairs = zip(contents(a), contents(b), strict=True)
    return all(same(x, y) for x, y in pairs)


class Stopped(Exception):
    pass


def stopping(after):
    """Return a ``map`` that ends the work after so many tiles, and tells which it counted."""
    taken = []

    def map_(function, items):
        for item in items:
            if len(taken) == after:
                raise Stopped
            taken.append(item)
            yield function(item)

    return map_, taken


@pytest.mark.parametrize("after", range(1, 12))
def test_counting_goes_on_where_it_stopped(tmp_path, after):
    grid, tiles = noise(after), tiles_of(SHAPE, size=90)
    assert len(tiles) > 11
    wanted = fold(counts(), grid, tiles)
    first, _ = stopping(after)
    with pytest.raises(Stopped):
        fold(counts(), grid, tiles, map=first, journal=Tally(tmp_path, "it", every=0))
    second, taken = stopping(len(tiles))
    found = fold(counts(), grid, tiles, map=second, journal=Tally(tmp_path, "it", every=0))
    assert len(taken) == len(tiles) - after
    assert equal(found, wanted)


def test_measures_are_the_same(tmp_path):
    grid = noise(3)
    tiles = tiles_of(SHAPE, size=90)
    journal = Tally(tmp_path, "it", every=0)
    first, _ = stopping(5)
    with pytest.raises(Stopped):
        measure(Census(grid, tiles=tiles, map=first, journal=journal))
    assert measure(Census(grid, tiles=tiles, journal=journal)) == measure(grid)
    journal.clear()
    assert not list(tmp_path.iterdir())


def begun(folder, about="it"):
    grid, tiles = noise(1), tiles_of(SHAPE, size=90)
    tally = Tally(folder, about, every=0)
    key = f"{counts()!r} of {tiles!r}"
    with pytest.raises(Stopped):
        fold(counts(), grid, tiles, map=stopping(6)[0], journal=tally)
    assert tally.load(key)[0] == 6
    return tally, key


def test_other_counts_are_not_taken(tmp_path):
    tally, key = begun(tmp_path)
    assert tally.load(f"{key} ")[0] == 0
    assert Tally(tmp_path, "another").load(key) == (0, [])
    (path,) = tmp_path.iterdir()
    path.rename(Tally(tmp_path, "another")._file(Tally(tmp_path, "another")._name(key)))
    assert Tally(tmp_path, "another").load(key) == (0, [])


def test_what_was_written_is_due_only_now_and_then(tmp_path):
    tally = Tally(tmp_path, "it", every=1e9)
    fold(counts(), noise(1), tiles_of(SHAPE, size=90), journal=tally)
    assert not list(tmp_path.iterdir())


def test_a_flipped_bit_or_a_missing_byte_is_noticed(tmp_path):
    tally, key = begun(tmp_path)
    (path,) = tmp_path.iterdir()
    data = path.read_bytes()
    random = np.random.default_rng(5)
    for place in random.integers(DIGITS + 1, len(data), 300):
        changed = bytearray(data)
        changed[place] ^= 1 << int(random.integers(8))
        path.write_bytes(changed)
        assert tally.load(key) == (0, [])
    for length in (0, 5, DIGITS, DIGITS + 50, len(data) - 1):
        path.write_bytes(data[:length])
        assert tally.load(key) == (0, [])
    path.write_bytes(data)
    assert tally.load(key)[0] == 6


@pytest.mark.parametrize(
    "change",
    [
        {"arrays": [["<i8", [1 << 50], 4, 0]]},
        {"arrays": [["|O", [1], 0, 0]]},
        {"arrays": [["<i8", [-1, -5], 0, 0]]},
        {"sums": [[0, ["Popen", [["number", "ls"]]]]]},
        {"sums": [[0, ["array", 7777]]]},
        {"sums": 5},
        {"done": "all"},
    ],
)
def test_hostile_files_are_of_no_use(tmp_path, change):
    tally, key = begun(tmp_path)
    (path,) = tmp_path.iterdir()
    data = path.read_bytes()
    stop = DIGITS + 1 + int(data[:DIGITS])
    header = {**json.loads(data[DIGITS + 1 : stop])["content"], **change}
    text = seal(header)
    path.write_bytes(f"{len(text):{DIGITS}d}\n".encode() + text + data[stop:])
    assert tally.load(key) == (0, [])
