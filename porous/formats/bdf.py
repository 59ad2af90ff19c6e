"""BDF: decks of Nastran (MSC, NX, Optistruct): executive and case control, then bulk data.

Coordinates stand in large fields of 16 characters: numbers from 1e-5 to 1 keep 13 decimals or more,
larger ones 14 digits (13 and a sign), smaller ones 10 (9 and a sign). Material properties have 16
characters too. Numbers of nodes and elements have at most eight digits.

Nodes and cells of parts are sets of the case control, in Nastran numbers: comments name them.
Nastran has no sets of faces: each is a load set of its own, PLOAD4 of pressure one, which LOAD
scales where a step presses it. A part of 1 MPa in a deck of pascals is thus scaled by 1e6.
MSC Nastran, Quick Reference Guide: GRID, CHEXA, CPENTA, CTETRA, PLOAD4, LOAD, SPC, EIGRL, NLPARM.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.formats._cards import deck_of, fitted, lines, node_rows, plain, rows, runs
from porous.formats._groups import node_order
from porous.formats._registry import Format
from porous.values import SHAPES, Job, VolumeMesh
from porous.values.volume_topology import nodes_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from porous.formats._cards import Deck, Indices
    from porous.values import Held, Pressed

MOST = 99_999_999
"""The largest number in a field of eight characters."""
ELEMENTS = {
    "tet4": "CTETRA",
    "hex8": "CHEXA",
    "wed6": "CPENTA",
    "tet10": "CTETRA",
    "hex20": "CHEXA",
}
RING = ((0, 1), (1, 2), (2, 3), (3, 0))
EDGES = {
    "tet10": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "hex20": (*RING, *((a, a + 4) for a in range(4)), *((a + 4, b + 4) for a, b in RING)),
}
"""Edges in the order of the nodes upon them: the upright ones stand between bottom and top."""
RUNS = 2
"""Runs in a line of the case control, which has 72 characters."""
SOLUTION = {"static": 101, "modal": 103, "conduction": 153}


def write(value: Job | VolumeMesh) -> Iterator[bytes]:
    """Write a deck; of a bare mesh its nodes, elements and sets."""
    deck = deck_of(value, ".bdf")
    mesh = deck.mesh
    if max(len(mesh.points), mesh.cells) > MOST:
        raise FormatError(f"{mesh.cells} cells; a deck holds {MOST} at most")
    number = {key: n for n, key in enumerate(mesh.parts, 1)}
    yield from _control(deck, number)
    yield b"BEGIN BULK\n"
    yield from _steps(deck, number)
    yield from _materials(deck)
    yield from node_rows(deck.points, ("GRID*   %16d" + " " * 16, "", "\n*       "), "\n")
    for piece in deck.pieces():
        order = _order(piece.shape)
        line = f"{ELEMENTS[piece.shape]:8s}%8d{piece.group + 1:8d}" + _folded(len(order))
        yield from rows(line, piece.numbers, piece.nodes[:, order] + 1)
    for key, name, members in deck.parts("faces"):
        yield lines(f"$ faces {name}: load set {number[key]}")
        yield from _faces(mesh, members, number[key])
    yield b"ENDDATA\n"


def _order(shape: str) -> list[int]:
    linear = SHAPES[shape].linear or shape
    return node_order(shape, range(SHAPES[linear].nodes), EDGES.get(shape, ()))


def _folded(nodes: int) -> str:
    """Return the fields of an element's nodes: six in its first line, eight in all others."""
    fields = ["%8d"] * nodes
    folded = ["".join(fields[:6])]
    folded += ["".join(fields[start : start + 8]) for start in range(6, nodes, 8)]
    return "\n        ".join(folded) + "\n"


# ------------------------------------------------------------------ what is done


def _control(deck: Deck, number: dict[str, int]) -> Iterator[bytes]:
    steps = deck.job.steps
    procedure = steps[0].procedure if steps else "static"
    yield lines(*(f"$ {line}" for line in deck.heading()))
    yield lines(f"SOL {SOLUTION[procedure]}", "CEND")
    yield lines(f"TITLE = {plain(deck.job.title)[:60]}", "ECHO = NONE")
    for kind in ("nodes", "cells"):
        for key, name, members in deck.parts(kind):
            yield lines(f"$ {kind} {name}: set {number[key]}")
            yield from _set(number[key], members + 1)
    if procedure == "conduction":
        yield lines("ANALYSIS = HEAT", "TEMPERATURE(INITIAL) = 1")
    for place, step in enumerate(steps, 1):
        yield lines(f"SUBCASE {place}", f"  LABEL = {plain(step.name)[:50]}")
        if step.held:
            yield lines(f"  SPC = {place}")
        if step.procedure == "static":
            load = [f"  LOAD = {_load(deck, place)}"] if step.pressed else []
            yield lines(*load)
            yield lines(
                "  DISPLACEMENT = ALL", "  SPCFORCES = ALL", "  STRESS = ALL", "  ESE = ALL"
            )
        elif step.procedure == "modal":
            yield lines(f"  METHOD = {place}", "  DISPLACEMENT = ALL")
        else:
            yield lines(f"  NLPARM = {place}", "  THERMAL = ALL", "  FLUX = ALL")


def _set(number: int, numbers: Indices) -> Iterator[bytes]:
    """Give a set of the case control: runs of numbers, as many in a line as always fit."""
    first, last = runs(numbers)
    texts = [
        f"{a}" if a == b else f"{a} THRU {b}"
        for a, b in zip(first.tolist(), last.tolist(), strict=True)
    ]
    said = [", ".join(texts[start : start + RUNS]) for start in range(0, len(texts), RUNS)]
    said[0] = f"SET {number} = {said[0]}"
    yield ",\n  ".join(said).encode("ascii") + b"\n"


def _load(deck: Deck, place: int) -> int:
    """Return the number of a step's combination of loads: beyond those of the parts."""
    return len(deck.mesh.parts) + place


def _steps(deck: Deck, number: dict[str, int]) -> Iterator[bytes]:
    if deck.job.steps and deck.job.steps[0].procedure == "conduction":
        yield lines("TEMPD" + " " * 3 + fitted([1, 0.0], 8))
    for place, step in enumerate(deck.job.steps, 1):
        yield lines(f"$ step {plain(step.name)}")
        if step.procedure == "modal":
            yield lines("EIGRL   " + fitted([place, None, None, step.modes], 8))
        elif step.procedure == "conduction":
            yield lines("NLPARM  " + fitted([place, 1], 8))
        if step.pressed:
            yield from _pressed(step.pressed, deck, number, place)
        for held in step.held:
            yield from _held(held, deck, place)


def _pressed(
    some: tuple[Pressed, ...], deck: Deck, number: dict[str, int], place: int
) -> Iterator[bytes]:
    """Give the combination of load sets that a step calls for."""
    fields: list[float | int | None] = [_load(deck, place), 1.0]
    for pressed in some:
        fields += [deck.scaled(pressed.pressure, "pressure"), number[pressed.part]]
    yield from _large("LOAD", fields)


def _large(card: str, fields: list[float | int | None]) -> Iterator[bytes]:
    """Give a card of large fields, four in a line, and an even number of lines."""
    starts = range(0, len(fields), 4)
    texts = [fitted(fields[start : start + 4], 16) for start in starts]
    heads = [f"{card}*".ljust(8), *["*       "] * len(texts)]
    if len(texts) % 2:
        texts.append("")
    yield lines(*(head + text for head, text in zip(heads, texts, strict=False)))


def _held(held: Held, deck: Deck, place: int) -> Iterator[bytes]:
    nodes = np.unique(deck.mesh.parts[held.part].members) + 1
    axes = "".join(str(axis + 1) for axis in sorted(held.components)) or "1"
    value = deck.held(held)
    if not value and held.quantity == "displacement":
        first, last = runs(nodes)
        pair = first < last
        yield from rows(f"SPC1    {place:8d}{axes:>8s}%8d    THRU%8d\n", first[pair], last[pair])
        yield from rows(f"SPC1    {place:8d}{axes:>8s}%8d\n", first[~pair])
        return
    line = f"SPC*    {place:16d}%16d{axes:>16s}{fitted([value], 16)}\n*\n"
    yield from rows(line, nodes)


# ------------------------------------------------------------------ what it is made of


def _materials(deck: Deck) -> Iterator[bytes]:
    for number, group in enumerate(deck.groups, 1):
        yield lines(f"$ property {number}: {group.name}")
        yield lines("PSOLID  " + fitted([number, number], 8))
        material = group.material
        if material is None:
            yield lines(f"$ no material is given: add MAT1 {number}")
            continue
        get = {
            name: deck.known(material, name) if getattr(material, name) is not None else None
            for name in (
                *("youngs_modulus", "poissons_ratio", "density"),
                *("conductivity", "specific_heat"),
            )
        }
        if get["youngs_modulus"] is not None and get["poissons_ratio"] is not None:
            elastic = [get["youngs_modulus"], None, get["poissons_ratio"], get["density"]]
            yield from _large("MAT1", [number, *elastic])
        if get["conductivity"] is not None:
            heat = [get["conductivity"], get["specific_heat"], get["density"]]
            yield from _large("MAT4", [number, *heat])


# ------------------------------------------------------------------ faces


def _faces(mesh: VolumeMesh, members: Indices, load: int) -> Iterator[bytes]:
    """Give PLOAD4 of one for faces: a corner and the one across it, or the one off the face."""
    card = f"PLOAD4  {load:8d}%8d     1.0" + " " * 24
    start = 0
    for block in mesh.blocks:
        cell = members[:, 0] - start
        own = members[(cell >= 0) & (cell < len(block.cells))]
        nodes = nodes_of(mesh, own)
        numbers = own[:, 0] + 1
        if block.shape in ("tet4", "tet10"):
            corners = block.cells[own[:, 0] - start, :4]
            off = corners.sum(axis=1) - nodes[:, :3].sum(axis=1)
            yield from rows(card + "%8d%8d\n", numbers, nodes[:, 0] + 1, off + 1)
        else:
            quad = nodes[:, 3] >= 0
            table = np.column_stack([numbers, nodes[:, 0] + 1, nodes[:, 2] + 1])
            yield from rows(card + "%8d%8d\n", table[quad])
            yield from rows(card + "%8d\n", table[~quad, :2])
        start += len(block.cells)


FORMAT = Format(
    name="Nastran bulk data deck",
    suffixes=(".bdf", ".nas"),
    writes=(Job, VolumeMesh),
    write=write,
    shapes=tuple(ELEMENTS),
    procedures=tuple(SOLUTION),
)
