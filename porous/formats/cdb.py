"""CDB: archives of Ansys Mechanical APDL, read by CDREAD or /INPUT, with a solution that is ready.

Coordinates have 14 digits (NBLOCK, 6e21.13e3), material properties all. Elements are SOLID185
(wedges: nodes K and L, O and P are one), SOLID186, SOLID187 and SOLID285, whose pressures keep
linear tetrahedra from locking; of heat SOLID70 (tetrahedra: K and L, M to P are one), SOLID90 and
SOLID87. Ansys has no sets of faces: the nodes of each are a component, pressures go to the faces
themselves (SFE). A component has at most 32 letters, digits and underscores.
Ansys, Mechanical APDL: Element Reference; Command Reference (NBLOCK, EBLOCK, CMBLOCK, SFE).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.formats._cards import deck_of, lines, packed, plain, rows, runs
from porous.formats._groups import face_elements
from porous.formats._registry import Format
from porous.values import Job, VolumeMesh

if TYPE_CHECKING:
    from collections.abc import Iterator

    from porous.formats._cards import Deck, Indices, Piece
    from porous.values import Pressed, Step

MOST = 999_999_999
"""The largest number in a field of nine characters."""
STRUCTURE = {"tet4": 285, "hex8": 185, "wed6": 185, "tet10": 187, "hex20": 186}
HEAT = {"tet4": 70, "hex8": 70, "wed6": 70, "tet10": 87, "hex20": 90}
WEDGE = [0, 1, 2, 2, 3, 4, 5, 5]
TETRAHEDRON = [0, 1, 2, 2, 3, 3, 3, 3]
"""Nodes of what is a brick with nodes that fall together."""
SIDES = {
    "tet4": (1, 2, 3, 4),
    "tet10": (1, 2, 3, 4),
    "hex8": (1, 6, 2, 3, 4, 5),
    "hex20": (1, 6, 2, 3, 4, 5),
    "wed6": (1, 6, 2, 3, 5),
}
"""Ansys' numbers of the faces, in the order of ``SHAPES``."""
PROPERTIES = {
    "youngs_modulus": "EX",
    "poissons_ratio": "PRXY",
    "density": "DENS",
    "conductivity": "KXX",
    "specific_heat": "C",
}
RESERVED = ("ALL", "STAT", "DEFA")
"""What a component must not be called: ``D,ALL,UX`` holds every node."""
AXES = ("UX", "UY", "UZ")


def write(value: Job | VolumeMesh) -> Iterator[bytes]:
    """Write an archive; of a bare mesh its nodes, elements and components."""
    deck = deck_of(value, ".cdb", odd="[^A-Z0-9_]", longest=32, together=True, reserved=RESERVED)
    mesh = deck.mesh
    if max(len(mesh.points), mesh.cells) > MOST:
        raise FormatError(f"{mesh.cells} cells; an archive holds {MOST} at most")
    heat = any(step.procedure == "conduction" for step in deck.job.steps)
    types = {
        shape: number for number, shape in enumerate(dict.fromkeys(b.shape for b in mesh.blocks), 1)
    }
    yield lines(*(f"! {line}" for line in deck.heading()))
    yield lines("/PREP7", f"/TITLE,{plain(deck.job.title)[:70]}")
    yield lines(*(f"ET,{n},{(HEAT if heat else STRUCTURE)[shape]}" for shape, n in types.items()))
    yield from _nodes(deck)
    yield from _elements(deck, types, heat=heat)
    yield from _components(deck)
    yield from _materials(deck)
    yield b"FINISH\n"
    for step in deck.job.steps:
        yield from _step(step, deck)


def _nodes(deck: Deck) -> Iterator[bytes]:
    count = len(deck.points)
    yield lines(f"NBLOCK,6,SOLID,{count:9d},{count:9d}", "(3i9,6e21.13e3)")
    numbers = np.arange(1, count + 1)
    for chunk in rows("%9d        0        0%21.13e%21.13e%21.13e\n", numbers, deck.points):
        yield _wide(chunk)
    yield b"N,R5.3,LOC,       -1,\n"


def _wide(chunk: bytes) -> bytes:
    """Return numbers as C prints them with exponents of three digits, as e21.13e3 asks."""
    # Each keeps its 21 characters: the blank before it makes room for the zero.
    text = np.frombuffer(chunk, np.uint8).reshape(-1, 27 + 3 * 21 + 1).copy()
    fields = text[:, 27:-1].reshape(-1, 21)
    short = fields[:, -4] == ord("e")
    fields[short] = np.concatenate(
        [fields[short, 1:-2], np.full((int(short.sum()), 1), ord("0")), fields[short, -2:]], axis=1
    )
    text[:, 27:-1] = fields.reshape(len(text), -1)
    return text.tobytes()


def _elements(deck: Deck, types: dict[str, int], *, heat: bool) -> Iterator[bytes]:
    count = deck.mesh.cells
    yield lines(f"EBLOCK,19,SOLID,{count:9d},{count:9d}", "(19i9)")
    for piece in deck.pieces():
        yield from _piece(piece, types[piece.shape], heat=heat)
    yield b"       -1\n"


def _piece(piece: Piece, kind: int, *, heat: bool) -> Iterator[bytes]:
    nodes = piece.nodes + 1
    if piece.shape == "wed6":
        nodes = nodes[:, WEDGE]
    elif piece.shape == "tet4" and heat:
        nodes = nodes[:, TETRAHEDRON]
    width = nodes.shape[1]
    # Material, type, real constants, section, system, alive, model, shape; nodes, unused, number.
    front = f"{piece.group + 1:9d}{kind:9d}" + "%9d" * 6 % (1, 1, 0, 0, 0, 0)
    line = f"{front}{width:9d}{0:9d}%9d" + "%9d" * min(width, 8) + "\n"
    if width > 8:
        line += "%9d" * (width - 8) + "\n"
    yield from rows(line, piece.numbers, nodes)


def _components(deck: Deck) -> Iterator[bytes]:
    for _, name, members in deck.parts("nodes"):
        yield from _component(name, "NODE", members + 1)
    for _, name, members in deck.parts("faces"):
        nodes = [some.ravel() for _, some in face_elements(deck.mesh, members).values()]
        yield from _component(name, "NODE", np.unique(np.concatenate(nodes)) + 1)
    for _, name, members in deck.parts("cells"):
        yield from _component(name, "ELEM", members + 1)


def _component(name: str, kind: str, numbers: Indices) -> Iterator[bytes]:
    first, last = runs(numbers)
    # A run of two is two numbers; the negative of its end closes a longer one.
    ends = np.where(last - first > 1, -last, last)
    items = np.column_stack([first, ends]).ravel()
    items = items[np.column_stack([np.ones(len(first), bool), last > first]).ravel()]
    yield lines(f"CMBLOCK,{name},{kind},{len(items):8d}", "(8i10)")
    yield from packed(items, "%10d", 8)


def _materials(deck: Deck) -> Iterator[bytes]:
    for number, group in enumerate(deck.groups, 1):
        if group.material is None:
            yield lines(f"! material {number}, {group.name}: not given")
            continue
        for name, label in PROPERTIES.items():
            if getattr(group.material, name) is not None:
                yield lines(f"MP,{label},{number},{deck.known(group.material, name)!r}")


def _step(step: Step, deck: Deck) -> Iterator[bytes]:
    yield lines("/SOLU", f"! {plain(step.name)}", "LSCLEAR,ALL")
    if step.procedure == "modal":
        yield lines("ANTYPE,MODAL", f"MODOPT,LANB,{step.modes}", f"MXPAND,{step.modes}")
    else:
        yield lines("ANTYPE,STATIC")
    for held in step.held:
        labels = [AXES[axis] for axis in sorted(held.components)] or ["TEMP"]
        name = deck.names[held.part]
        yield lines(*(f"D,{name},{label},{deck.held(held)!r}" for label in labels))
    for pressed in step.pressed:
        yield from _pressed(pressed, deck)
    yield lines("SOLVE", "FINISH")


def _pressed(pressed: Pressed, deck: Deck) -> Iterator[bytes]:
    pressure = deck.scaled(pressed.pressure, "pressure")
    cell, face = np.unique(deck.mesh.parts[pressed.part].members, axis=0).T
    start = 0
    for block in deck.mesh.blocks:
        own = (cell >= start) & (cell < start + len(block.cells))
        side = np.array(SIDES[block.shape])[face[own]]
        yield from rows(f"SFE,%d,%d,PRES,0,{pressure!r}\n", cell[own] + 1, side)
        start += len(block.cells)


FORMAT = Format(
    name="Ansys Mechanical APDL archive",
    suffixes=(".cdb",),
    writes=(Job, VolumeMesh),
    write=write,
    shapes=tuple(STRUCTURE),
    procedures=("static", "modal", "conduction"),
)
