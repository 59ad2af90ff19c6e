"""K: keyword decks of LS-DYNA, with an implicit solution that is ready.

Coordinates have 16 characters: numbers from 1e-5 to 1 keep 13 decimals or more, larger ones 14
digits (13 and a sign), smaller ones 10 (9 and a sign). Material properties have 10 characters,
which is five digits or more; pressures and displacements are points of curves, with 20. Numbers of
nodes and elements have at most eight digits.

A part is of one material and one element formulation: cells of several shapes are several parts.
Quadratic faces in sets of segments have their corners only, so they bear no pressure here.
LS-DYNA Keyword User's Manual, Volume I: NODE, ELEMENT_SOLID, SET, SECTION_SOLID, CONTROL_IMPLICIT.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.formats._cards import deck_of, fitted, lines, node_rows, packed, plain, rows
from porous.formats._registry import Format
from porous.values import SHAPES, Job, VolumeMesh
from porous.values.volume_topology import nodes_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from porous.formats._cards import Deck, Group, Indices, Piece
    from porous.values import Held, Pressed, Step

MOST = 99_999_999
"""The largest number in a field of eight characters."""
FORMULATIONS = {"tet4": 10, "hex8": 2, "wed6": 15, "tet10": 16, "hex20": 23}
"""Tetrahedra of one point, bricks fully integrated, wedges; and the quadratic ones."""
ORDERS = {
    "tet4": [0, 1, 2, 3, 3, 3, 3, 3],
    "wed6": [0, 2, 5, 3, 1, 1, 4, 4],
    **{shape: list(range(SHAPES[shape].nodes)) for shape in ("hex8", "tet10", "hex20")},
}
"""Nodes of each element; a wedge is a brick upon a rectangle whose upper edges are points."""
ELASTIC = ("density", "youngs_modulus", "poissons_ratio")
"""What *MAT_ELASTIC says, in this order."""
KEYWORDS = {"tet10": "*ELEMENT_SOLID", "hex20": "*ELEMENT_SOLID_H20"}
DISPLACEMENT = 2
"""What LS-DYNA calls a prescribed motion that is one."""


def write(value: Job | VolumeMesh) -> Iterator[bytes]:
    """Write a deck; of a bare mesh its nodes, elements and sets."""
    deck = deck_of(value, ".k", most_steps=1)
    mesh = deck.mesh
    if max(len(mesh.points), mesh.cells) > MOST:
        raise FormatError(f"{mesh.cells} cells; a deck holds {MOST} at most")
    for step in deck.job.steps:
        _check(step, deck)
    number = {key: n for n, key in enumerate(mesh.parts, 1)}
    yield b"*KEYWORD\n"
    yield lines("*TITLE", plain(deck.job.title)[:70] or "job")
    yield lines(*(f"$ {line}" for line in deck.heading()))
    for step in deck.job.steps:
        yield from _control(step)
    pieces = list(deck.pieces())
    yield from _parts(deck, pieces)
    yield b"*NODE\n"
    yield from node_rows(deck.points, ("%8d", "", ""), "\n")
    for part, piece in enumerate(pieces, 1):
        yield from _elements(piece, part)
    yield from _sets(deck, number)
    for step in deck.job.steps:
        yield from _step(step, deck, number)
    yield b"*END\n"


def _check(step: Step, deck: Deck) -> None:
    for group in deck.groups:
        assert group.material is not None
        if group.material.density is None:
            raise FormatError(
                f"material {group.material.name}: has no density; LS-DYNA needs one in every step"
            )
    curved = np.concatenate(
        [np.full(len(block.cells), bool(SHAPES[block.shape].linear)) for block in deck.mesh.blocks]
    )
    for pressed in step.pressed:
        if curved[deck.mesh.parts[pressed.part].members[:, 0]].any():
            raise FormatError(
                f"part {pressed.part!r}: a .k file cannot hold a pressure on faces of quadratic "
                "elements; wanted linear ones"
            )


# ------------------------------------------------------------------ the mesh


def _parts(deck: Deck, pieces: list[Piece]) -> Iterator[bytes]:
    """Give a part for each piece, a section for each shape, a material for each group."""
    section = {shape: n for n, shape in enumerate(dict.fromkeys(p.shape for p in pieces), 1)}
    for shape, number in section.items():
        yield lines("*SECTION_SOLID", fitted([number, FORMULATIONS[shape]], 10))
    for number, group in enumerate(deck.groups, 1):
        yield _material(deck, group, number)
    for number, piece in enumerate(pieces, 1):
        group = deck.groups[piece.group]
        material = piece.group + 1 if _elastic(group) else 0
        fields = [number, section[piece.shape], material]
        yield lines("*PART", f"{group.name} {piece.shape}", fitted(fields, 10))


def _elastic(group: Group) -> bool:
    """Whether all is known of a material that LS-DYNA needs."""
    return group.material is not None and all(
        getattr(group.material, name) is not None for name in ELASTIC
    )


def _material(deck: Deck, group: Group, number: int) -> bytes:
    if group.material is None or not _elastic(group):
        return lines(f"$ material {number}, {group.name}: not given, add *MAT_ELASTIC")
    values = [deck.known(group.material, name) for name in ELASTIC]
    return lines("*MAT_ELASTIC", fitted([number, *values], 10))


def _elements(piece: Piece, part: int) -> Iterator[bytes]:
    """Give a keyword and the elements of a part: eight nodes in one line, or ten in each."""
    nodes = piece.nodes[:, ORDERS[piece.shape]] + 1
    keyword = KEYWORDS.get(piece.shape)
    yield lines(keyword or "*ELEMENT_SOLID")
    width = nodes.shape[1]
    if keyword is None:
        line = f"%8d{part:8d}" + "%8d" * width + "\n"
    else:
        line = f"%8d{part:8d}\n" + ("%8d" * 10 + "\n") * (width // 10)
    yield from rows(line, piece.numbers, nodes)


def _sets(deck: Deck, number: dict[str, int]) -> Iterator[bytes]:
    for key, name, members in deck.parts("nodes"):
        yield lines("*SET_NODE_LIST_TITLE", name, f"{number[key]:10d}")
        yield from packed(members + 1, "%10d", 8)
    for key, name, members in deck.parts("cells"):
        yield lines("*SET_SOLID_TITLE", name, f"{number[key]:10d}")
        yield from packed(members + 1, "%10d", 8)
    for key, name, members in deck.parts("faces"):
        yield lines("*SET_SEGMENT_TITLE", name, f"{number[key]:10d}")
        yield from rows("%10d%10d%10d%10d\n", _segments(deck.mesh, members))


def _segments(mesh: VolumeMesh, members: Indices) -> Indices:
    """Return the corners of faces seen from outside; a triangle's third is its fourth too."""
    nodes = nodes_of(mesh, members)
    return np.column_stack([nodes[:, :3], np.where(nodes[:, 3] < 0, nodes[:, 2], nodes[:, 3])]) + 1


# ------------------------------------------------------------------ the step


def _control(step: Step) -> Iterator[bytes]:
    yield lines(f"$ step {plain(step.name)}", "*CONTROL_TERMINATION", fitted([1.0], 10))
    yield lines("*CONTROL_IMPLICIT_GENERAL", fitted([1, 1.0], 10))
    if step.procedure == "modal":
        yield lines("*CONTROL_IMPLICIT_EIGENVALUE", fitted([step.modes], 10))
    else:
        yield lines("*CONTROL_IMPLICIT_SOLUTION", fitted([1], 10))
    yield lines("*DATABASE_BINARY_D3PLOT", fitted([1.0], 10))
    yield lines("*DATABASE_SPCFORC", fitted([1.0], 10))


def _step(step: Step, deck: Deck, number: dict[str, int]) -> Iterator[bytes]:
    curve = 0
    for held in step.held:
        curve += int(bool(held.value))
        yield from _held(held, deck, number[held.part], curve)
    for pressed in step.pressed:
        curve += 1
        yield from _pressed(pressed, deck, number[pressed.part], curve)


def _held(held: Held, deck: Deck, nodes: int, curve: int) -> Iterator[bytes]:
    if not held.value:
        free = [int(axis in held.components) for axis in range(3)]
        yield lines("*BOUNDARY_SPC_SET", fitted([nodes, 0, *free, 0, 0, 0], 10))
        return
    yield _curve(curve, deck.held(held))
    for axis in sorted(held.components):
        fields = [nodes, axis + 1, DISPLACEMENT, curve, 1.0]
        yield lines("*BOUNDARY_PRESCRIBED_MOTION_SET", fitted(fields, 10))


def _pressed(pressed: Pressed, deck: Deck, segments: int, curve: int) -> Iterator[bytes]:
    yield _curve(curve, deck.scaled(pressed.pressure, "pressure"))
    yield lines("*LOAD_SEGMENT_SET", fitted([segments, curve, 1.0, 0.0], 10))


def _curve(number: int, value: float) -> bytes:
    """Return a curve from zero to a value at time one."""
    points = [fitted([time, height], 20) for time, height in ((0.0, 0.0), (1.0, value))]
    return lines("*DEFINE_CURVE", f"{number:10d}", *points)


FORMAT = Format(
    name="LS-DYNA keyword deck",
    suffixes=(".k", ".key"),
    writes=(Job, VolumeMesh),
    write=write,
    shapes=tuple(FORMULATIONS),
    procedures=("static", "modal"),
)
