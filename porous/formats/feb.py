"""FEB: models of FEBio, specification 4.0, with a static step that is ready.

Numbers have all their digits. FEBio reckons with large deformations: small loads give what linear
statics do. The pressure keeps the direction that the faces had (linear). Cells of one material and
one shape are one domain; parts of cells are element sets besides.
FEBio User Manual 4.0: Free format input; Mesh section; Boundary; Loads.
"""

from __future__ import annotations

from itertools import chain, count
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.formats._cards import deck_of, lines, plain, rows
from porous.formats._groups import face_elements
from porous.formats._registry import Format
from porous.values import Job, VolumeMesh

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.formats._cards import Deck, Indices, Piece
    from porous.values import Held, Material, Step

ELEMENTS = {
    "tet4": "tet4",
    "hex8": "hex8",
    "wed6": "penta6",
    "tet10": "tet10",
    "hex20": "hex20",
}
FACETS = ("tri3", "tri6", "quad4", "quad8")
UNITS = {"mm-N-MPa": "mm-N-s", "m-SI": "SI"}
AXES = "xyz"
NODES = "ALL"
"""What the set of all nodes is called, where no part has that name."""
TOLERANCE = 1e-9
"""How small the change of the last iteration is, relative to all of the displacement."""


def write(value: Job | VolumeMesh) -> Iterator[bytes]:
    """Write a model; of a bare mesh its nodes, elements and sets."""
    deck = deck_of(value, ".feb", most_steps=1)
    pieces = [(f"part{n}_{piece.shape}", piece) for n, piece in enumerate(deck.pieces(), 1)]
    yield lines('<?xml version="1.0" encoding="ISO-8859-1"?>', '<febio_spec version="4.0">')
    yield lines(*(f"<!-- {line} -->" for line in (plain(deck.job.title), *deck.heading())))
    yield lines('<Module type="solid">', f"<units>{UNITS[deck.job.system]}</units>", "</Module>")
    for _ in deck.job.steps:
        yield _control()
    yield from _materials(deck)
    yield from _mesh(deck, pieces)
    yield from _domains(deck, pieces)
    for step in deck.job.steps:
        yield from _step(step, deck)
    yield lines("</febio_spec>")


def _control() -> bytes:
    return lines(
        "<Control>",
        "<analysis>STATIC</analysis>",
        "<time_steps>1</time_steps>",
        "<step_size>1</step_size>",
        '<solver type="solid">',
        "<max_refs>50</max_refs>",
        f"<dtol>{TOLERANCE!r}</dtol>",
        "<etol>0.01</etol>",
        "<rtol>0</rtol>",
        "</solver>",
        "</Control>",
    )


def _elastic(material: Material | None) -> bool:
    return (
        material is not None
        and material.youngs_modulus is not None
        and material.poissons_ratio is not None
    )


def _materials(deck: Deck) -> Iterator[bytes]:
    if not any(_elastic(group.material) for group in deck.groups):
        return
    yield lines("<Material>")
    for number, group in enumerate(deck.groups, 1):
        if _elastic(group.material):
            assert group.material is not None
            yield lines(f'<material id="{number}" name="{group.name}" type="isotropic elastic">')
            if group.material.density is not None:
                yield lines(f"<density>{deck.known(group.material, 'density')!r}</density>")
            yield lines(
                f"<E>{deck.known(group.material, 'youngs_modulus')!r}</E>",
                f"<v>{deck.known(group.material, 'poissons_ratio')!r}</v>",
                "</material>",
            )
    yield lines("</Material>")


# ------------------------------------------------------------------ the mesh


def _mesh(deck: Deck, pieces: list[tuple[str, Piece]]) -> Iterator[bytes]:
    taken = {name for _, name, _ in deck.parts("nodes")}
    every = next(
        name for name in chain((NODES,), (f"{NODES}_{i}" for i in count(1))) if name not in taken
    )
    yield lines("<Mesh>", f'<Nodes name="{every}">')
    yield from _numbered("node", deck.points, "%r")
    yield lines("</Nodes>")
    for name, piece in pieces:
        yield lines(f'<Elements type="{ELEMENTS[piece.shape]}" name="{name}">')
        words = ",".join(["%d"] * piece.nodes.shape[1])
        yield from rows(f'<elem id="%d">{words}</elem>\n', piece.numbers, piece.nodes + 1)
        yield lines("</Elements>")
    for _, name, members in deck.parts("faces"):
        yield from _surface(deck, name, members)
    for tag, kind in (("ElementSet", "cells"), ("NodeSet", "nodes")):
        for _, name, members in deck.parts(kind):
            yield f'<{tag} name="{name}">'.encode("ascii")
            yield ",".join(map(str, (members + 1).tolist())).encode("ascii")
            yield lines(f"</{tag}>")
    yield lines("</Mesh>")


def _surface(deck: Deck, name: str, members: Indices) -> Iterator[bytes]:
    found, first = face_elements(deck.mesh, members), 1
    yield lines(f'<Surface name="{name}">')
    for tag in FACETS:
        if tag in found:
            _, nodes = found[tag]
            yield from _numbered(tag, nodes + 1, "%d", first)
            first += len(nodes)
    yield lines("</Surface>")


def _numbered(tag: str, table: NDArray[Any], word: str, first: int = 1) -> Iterator[bytes]:
    """Give a tag with a number for each row of a table."""
    words = ",".join([word] * table.shape[1])
    numbers = np.arange(first, first + len(table))
    yield from rows(f'<{tag} id="%d">{words}</{tag}>\n', numbers, table)


def _domains(deck: Deck, pieces: list[tuple[str, Piece]]) -> Iterator[bytes]:
    there = [
        (name, deck.groups[piece.group].name)
        for name, piece in pieces
        if _elastic(deck.groups[piece.group].material)
    ]
    if there:
        yield lines("<MeshDomains>")
        yield lines(*(f'<SolidDomain name="{name}" mat="{of}"/>' for name, of in there))
        yield lines("</MeshDomains>")


# ------------------------------------------------------------------ the step


def _step(step: Step, deck: Deck) -> Iterator[bytes]:
    yield lines(
        "<LoadData>",
        '<load_controller id="1" type="loadcurve">',
        "<interpolate>LINEAR</interpolate>",
        "<points>",
        *("<pt>0,0</pt>", "<pt>1,1</pt>"),
        "</points>",
        "</load_controller>",
        "</LoadData>",
    )
    yield lines("<Loads>")
    for pressed in step.pressed:
        yield _pressure(deck.names[pressed.part], deck.scaled(pressed.pressure, "pressure"))
    yield lines("</Loads>", "<Boundary>")
    for held in step.held:
        yield from _held(held, deck)
    yield lines("</Boundary>", "<Output>", '<plotfile type="febio">')
    yield lines(
        '<var type="displacement"/>', '<var type="stress"/>', '<var type="reaction forces"/>'
    )
    yield lines("</plotfile>", "</Output>")


def _pressure(surface: str, value: float) -> bytes:
    return lines(
        f'<surface_load type="pressure" surface="{surface}">',
        "<symmetric_stiffness>1</symmetric_stiffness>",
        "<linear>1</linear>",
        f'<pressure lc="1">{value!r}</pressure>',
        "</surface_load>",
    )


def _held(held: Held, deck: Deck) -> Iterator[bytes]:
    nodes = deck.names[held.part]
    if not held.value:
        yield lines(
            f'<bc type="zero displacement" node_set="{nodes}">',
            *(
                f"<{axis}_dof>{int(i in held.components)}</{axis}_dof>"
                for i, axis in enumerate(AXES)
            ),
            "</bc>",
        )
        return
    for axis in sorted(held.components):
        yield lines(
            f'<bc type="prescribed displacement" node_set="{nodes}">',
            f"<dof>{AXES[axis]}</dof>",
            f'<value lc="1">{deck.held(held)!r}</value>',
            "<relative>0</relative>",
            "</bc>",
        )


FORMAT = Format(
    name="FEBio model",
    suffixes=(".feb",),
    writes=(Job, VolumeMesh),
    write=write,
    shapes=tuple(ELEMENTS),
    procedures=("static",),
)
