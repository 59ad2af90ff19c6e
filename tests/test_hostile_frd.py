"""Results of CalculiX that are damaged, lie, or are made to harm: the right answer, or why not."""

import re

import numpy as np
import pytest
from test_hostile import HEX, HEX_POINTS, judged

SHOWN = {1: (HEX, 8), 3: ((1, 2, 3, 5), 4)}
FIELD = np.arange(24).reshape(8, 3) / 8


def rows(table, digits=10):
    """Return lines of a number of a node and values of twelve characters."""
    return "".join(
        f" -1{number:{digits}d}{''.join(f'{value:12.5E}' for value in values)}\n"
        for number, values in table
    )


def element(number, kind, nodes, digits=10):
    return f" -1{number:{digits}d}{kind:5d}    0    1\n -2" + "".join(
        f"{node:{digits}d}" for node in nodes
    )


HEAD = "    1C\n    1UUSER                                                              \n"
END = " -3\n"


def block(values, *, name="DISP", count=None, parts=3, made=1, step=1, kind=0, form=1, labels=None):
    """Return a block of values at the eight nodes."""
    table = list(zip(labels or range(1, len(values) + 1), values, strict=True))
    lines = [f" -5  {c:8}    1    2    1    0\n" for c in ("D1", "D2", "D3", "D4")[:parts]]
    lines += [" -5  ALL         1    2    0    0    1ALL\n"] * made
    number = len(values) if count is None else count
    return (
        f"  100CL  101 1.000000000{number:12}{'':20}{kind:2}{step:5}{'':10}{form:2}\n"
        f" -4  {name:8}{parts + made:5}    1\n{''.join(lines)}{rows(table)}{END}"
    )


def frd(**changes):
    """Return one hexahedron and its displacements, but for what is changed."""
    nodes = list(zip(range(1, 9), HEX_POINTS.tolist(), strict=True))
    parts = {
        "count": 8,
        "nodes": rows(nodes),
        "cells": 1,
        "elements": element(1, 1, HEX) + "\n",
        "fields": block(FIELD),
        "form": 1,
        "tail": " 9999\n",
        **changes,
    }
    return (
        f"{HEAD}    2C{'':18}{parts['count']:>12}{'':37}{parts['form']}\n{parts['nodes']}{END}"
        f"    3C{'':18}{parts['cells']:>12}{'':37}1\n{parts['elements']}{END}"
        f"{parts['fields']}{parts['tail']}"
    ).encode()


GOOD = {"brick": frd(), "two steps": frd(fields=block(FIELD) + block(-FIELD, step=2))}
LABEL = 10**9 - 1


def is_a_brick(value):
    return value.mesh.volumes == pytest.approx([30.0])


def all_of(value):
    return is_a_brick(value) and len(value.fields) == 1


def missing(value):
    return is_a_brick(value) and np.isnan(value.fields[0].values).any()


FRD = {
    "one cell": (frd(), all_of),
    "lines of Windows": (frd().replace(b"\n", b"\r\n"), all_of),
    "nodes 1e11": (frd(count=10**11), "nodes: got '8 lines'; wanted 100000000000 as announced"),
    "nodes -8": (frd(count=-8), "nodes: got '8 lines'; wanted -8 as announced"),
    "nodes of a word": (frd(count="many"), "number of nodes: got .*many'; wanted a whole number"),
    "cells 1e11": (frd(cells=10**11), "elements: got 1; wanted 100000000000 as announced"),
    "cells -1": (frd(cells=-1), "elements: got 1; wanted -1 as announced"),
    "values 1e11": (frd(fields=block(FIELD, count=10**11)), "DISP would take 100000000000 lines"),
    "values -8": (frd(fields=block(FIELD, count=-8)), "DISP would take -8|DISP: got -8"),
    "a node that is not there": (frd(elements=element(1, 1, [*HEX[:7], 9]) + "\n"), "node 9"),
    "a node below zero": (frd(elements=element(1, 1, [*HEX[:7], -1]) + "\n"), "node -1"),
    "a node twice": (
        frd(nodes=rows([(1, p) for p in HEX_POINTS.tolist()])),
        "twice",
    ),
    "values of nodes that are not there": (
        frd(fields=block(FIELD, labels=[1, 2, 3, 4, 5, 6, 7, LABEL])),
        missing,
    ),
    "nan": (frd(nodes=rows(zip(range(1, 9), HEX_POINTS * np.nan, strict=True))), "point 0 is .nan"),
    "inf": (frd(nodes=rows(zip(range(1, 9), HEX_POINTS + np.inf, strict=True))), "point 0 is .inf"),
    "words": (frd().replace(b"5.00000E+00", b"five       ", 1), "got 'five'; wanted a number"),
    "commas": (frd().replace(b"5.00000E+00", b"5,00000E+00", 1), "got '5,00000E.00'; wanted"),
    "an empty column": (frd().replace(b"5.00000E+00", b" " * 11, 1), "a number in every column"),
    "two in a column": (frd().replace(b"5.00000E+00", b"5.0000 5E+0", 1), "a number in every col"),
    "a line cut": (frd().replace(b" 5.00000E+00\n", b"\n", 1), "a line: got .*columns of 12 char"),
    "no key": (frd().replace(b"\n -1 ", b"\nxx1 ", 2), "a line"),
    "a key of its own": (frd().replace(b"\n -1 ", b"\n -9 ", 2), "each with the key -1"),
    "a type unknown": (frd(elements=element(1, 5, HEX) + "\n"), "type: got 5; wanted one of 1, 2"),
    "a type of 99999": (frd(elements=element(1, 99999, HEX) + "\n"), "type: got 99999; wanted"),
    "shells alone": (frd(elements=element(1, 9, HEX[:4]) + "\n"), "no volume elements"),
    "an element of no lines": (
        frd(elements=element(1, 1, HEX).split("\n")[0] + "\n"),
        "elements of type 1: got 'lines of nodes'; wanted 1 for each",
    ),
    "an element of many lines": (
        frd(elements=element(1, 1, HEX) + "\n" + " -2         1\n" * 999),
        "elements of type 1: got 'lines of nodes'; wanted 1 for each",
    ),
    "components 1e4": (
        frd().replace(b" -4  DISP        4", b" -4  DISP     9999"),
        "components of DISP: got .*; wanted a line -5 for each",
    ),
    "components -1": (
        frd().replace(b" -4  DISP        4", b" -4  DISP       -1"),
        lambda value: is_a_brick(value) and not value.fields,
    ),
    "a field of two components": (
        frd(fields=block(FIELD[:, :2], parts=2)),
        lambda value: is_a_brick(value) and not value.fields,
    ),
    "a binary file": (frd(form=2), "format: got 2; wanted 0 or 1, text"),
    "format of a word": (frd(form="x"), "format: got b'x'; wanted a whole number"),
    "no end of a block": (frd().replace(b" -3\n", b""), "a block without an end; wanted a line -3"),
    "no end": (frd(tail=""), "ends before its last line, 9999; did the solver finish"),
    "no nodes": (HEAD.encode() + b" 9999\n", "no nodes|no volume elements|nodes: got"),
    "a line unknown": (frd(fields="   77C\n"), "a line: got '77C'; wanted one of 1C"),
    "a line of a megabyte": (b"    1C" + b"x" * 10**6 + frd(), "a line: got .*at most 200 char"),
    "many lines of users": (b"    1U\n" * 50_000 + frd(), all_of),
    "many empty lines": (b"\n" * 50_000 + frd(), all_of),
    "many blocks": (frd(fields=block(FIELD, name="FLUX") * 300), all_of),
    "many blocks of none": (
        frd(fields=block(FIELD[:0], name="FLUX") * 1000),
        lambda value: missing(value) or not value.fields,
    ),
    "a name that steers terminals": (
        frd(fields=block(FIELD, name="\x1b[31m\x9b")).replace(b"\xc2\x9b", b"\x9b"),
        all_of,
    ),
    "not text": (bytes(range(256)) * 9, "a line"),
    "a null byte": (frd().replace(b"5.00000E+00", b"5.0\x00000E+00", 1), "number|column"),
    "something else": (b"GIF89a", "a line: got 'GIF89a'; wanted one of 1C"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("hostile")


@pytest.mark.parametrize("name", FRD)
def test_hostile_results(folder, name):
    data, expected = FRD[name]
    outcome = judged(folder, ".frd", data)
    if callable(expected):
        assert not isinstance(outcome, str), outcome
        assert expected(outcome)
    else:
        assert isinstance(outcome, str), "it was accepted"
        assert re.search(expected, outcome), outcome


@pytest.mark.parametrize("name", GOOD)
def test_results_that_are_cut_short(folder, name):
    for stop in np.linspace(0, len(GOOD[name]) - 8, 64).astype(int).tolist():
        assert isinstance(judged(folder, ".frd", GOOD[name][:stop]), str), f"cut at {stop}"
