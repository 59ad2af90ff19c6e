"""INP: decks for CalculiX and Abaqus with sets, materials, ties and steps, in mm-N-MPa or m-SI.

CalculiX refuses fields longer than 20 characters; sets have at most 16 numbers in a line. Element
faces are S1, S2, … as ``SHAPES`` lists them. Nodes and elements are numbered from 1.

Read are the nodes, the hexahedra, wedges and tetrahedra, and the sets of decks that stand in one
file, without instances (``_inp_read``, ``_inp_sets``). Materials and steps are passed over.
https://www.dhondt.de/ccx_2.20.pdf
"""

from __future__ import annotations

from itertools import chain, count
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.formats._deck import (
    FAR,
    PROCEDURES,
    REFERENCE,
    SLAB,
    UNITS,
    WIDTH,
    Deck,
    comment,
    lines,
    node_set,
    plain,
    rows,
    set_name,
)
from porous.formats._inp_read import read
from porous.formats._registry import Format
from porous.values import Job, VolumeMesh
from porous.values.units import SYSTEMS, length_ratio, system_length

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from porous.values import Part

ELEMENTS = {"tet4": "C3D4", "hex8": "C3D8", "wed6": "C3D6", "tet10": "C3D10", "hex20": "C3D20"}
"""Element types; VTK's node order is CalculiX's for all of them. Hexahedra are integrated in full,
C3D8 in 2 × 2 × 2 and C3D20 in 3 × 3 × 3 points: reduced ones bend better and have modes without
energy, which a thin strut of few elements finds. C3D10 is integrated in 4 points, which is exact
where edges are straight."""
HEAT = {shape: f"D{name}" for shape, name in ELEMENTS.items()}
"""Element types of heat; Abaqus needs these, and CalculiX takes them for those of stress."""
REFERENCE_VOLUMES = {"tet": 1 / 6, "wed": 1.0, "hex": 8.0}
"""Of elements in their own coordinates: det J is on average a volume over this."""
LEAST = 1.1e-20
"""The smallest det J that is written; CalculiX 2.20 stops below 1e-20, in any unit."""
ENDS = ("FIRST", "SECOND")
"""How the names end of the sets that hold the nodes of pairs, in order."""

SOLID, ALL, NODES = "SOLID", "ALL_CELLS", "ALL"
"""What the sets of all elements and of all nodes are called, where no part has that name."""


def write(value: Job | VolumeMesh) -> Iterator[bytes]:
    """Write a deck; of a bare mesh its nodes, elements and sets.

    Raises
    ------
    FormatError
        For a mesh without cells, for names that would be one in a deck, and for a job with steps
        of heat and of stress, or with what decks cannot hold.
    """
    job = value if isinstance(value, Job) else None
    mesh = value if isinstance(value, VolumeMesh) else value.mesh
    if not mesh.cells:
        raise FormatError("the mesh has no cells; a deck needs at least one")
    names, taken = _set_names(mesh, job.tied if job else ())
    every = _everything(mesh, names)
    deck = Deck(job, names, every) if job else None
    if job is not None and job.steps:
        _check_size(job)
    yield from _heading(job, mesh)
    nodes = next(name for name in _numbered(NODES) if name not in taken)
    yield from _nodes(mesh, nodes, system_length(job.system) if job else "mm")
    yield from deck.references() if deck else ()
    yield from _elements(mesh, every, HEAT if deck and deck.is_thermal else ELEMENTS)
    for key, part in mesh.parts.items():
        if part.kind != "cells" or names[key] != every:
            yield from _part(names[key], part, ordered=job is None)
    if deck is not None:
        yield from deck.far()
        yield from deck.equations()
        yield from deck.materials()
        yield from deck.steps()


def _check_size(job: Job) -> None:
    """Refuse elements that CalculiX takes for turned inside out, since they are so small.

    It compares det J, in the deck's unit of length cubed, to a number: ``LEAST``.
    """
    unit = system_length(job.system)
    volumes = job.mesh.volumes * length_ratio(job.mesh.unit, unit) ** 3
    reference = [REFERENCE_VOLUMES[block.shape[:3]] for block in job.mesh.blocks]
    least = float((volumes / np.repeat(reference, [len(b.cells) for b in job.mesh.blocks])).min())
    if least < LEAST:
        other = SYSTEMS[0]
        wanted = f'simulation.units = "{other}"' if job.system != other else "a larger model.unit"
        raise FormatError(
            f"an element is about {abs(volumes.min()) ** (1 / 3):.3g} {unit} wide; CalculiX "
            f"works with det J from {LEAST:g} {unit}³ on, here it is {least:.3g}; wanted {wanted}"
        )


def _heading(job: Job | None, mesh: VolumeMesh) -> Iterator[bytes]:
    title, system = (job.title, job.system) if job else ("mesh", SYSTEMS[0])
    # CalculiX hands the heading on to its results, which have no other place for units.
    yield lines("*HEADING", f"units {system}: {plain(title)}"[:WIDTH])
    units = UNITS[system]
    yield comment(f"made by porous; the mesh was in {mesh.unit}; {units}")
    if job is not None and job.steps:
        yield comment("to run it where it is called NAME.inp: ccx -i NAME")
    if job is not None and job.note:
        yield comment(job.note)


def _nodes(mesh: VolumeMesh, every: str, unit: str) -> Iterator[bytes]:
    yield lines(f"*NODE, NSET={every}")
    ratio = length_ratio(mesh.unit, unit)
    form = "%d, %.9e, %.9e, %.9e\n"
    for start in range(0, len(mesh.points), SLAB):
        slab = mesh.points[start : start + SLAB] * ratio
        numbered = zip(range(start + 1, start + 1 + len(slab)), *slab.T.tolist(), strict=True)
        yield (form * len(slab) % tuple(chain.from_iterable(numbered))).encode()


def _elements(mesh: VolumeMesh, every: str, types: Mapping[str, str]) -> Iterator[bytes]:
    first = 1
    several = len(mesh.blocks) > 1
    for index, block in enumerate(mesh.blocks, 1):
        name = f"{every}_{index}" if several else every
        yield lines(f"*ELEMENT, TYPE={types[block.shape]}, ELSET={name}")
        for start in range(0, len(block.cells), SLAB):
            slab = block.cells[start : start + SLAB] + 1
            numbers = np.arange(first + start, first + start + len(slab))
            yield from rows(np.column_stack([numbers, slab]))
        first += len(block.cells)
    if several:
        blocks = [f"{every}_{i + 1}" for i in range(len(mesh.blocks))]
        yield lines(f"*ELSET, ELSET={every}", ", ".join(blocks))


def _part(name: str, part: Part, *, ordered: bool) -> Iterator[bytes]:
    """Give a set; the nodes of pairs in their order, unless equations say which belong together."""
    numbers = part.members + 1
    if not len(numbers):
        return
    if part.kind == "faces":
        yield lines(f"*SURFACE, NAME={name}, TYPE=ELEMENT")
        yield from rows(numbers, "%d, S%d\n")
    elif part.kind == "pairs":
        for end, column in zip(ENDS, numbers.T, strict=True):
            yield from node_set("NSET", f"{name}_{end}", column, ordered=ordered)
    else:
        yield from node_set("NSET" if part.kind == "nodes" else "ELSET", name, numbers)


def _everything(mesh: VolumeMesh, names: Mapping[str, str]) -> str:
    """Return the name of the set of all elements, which no part of some of them has.

    Nor has one the name of a block: that with a number.
    """
    cells = {name: key for key, name in names.items() if mesh.parts[key].kind == "cells"}
    blocks = range(1, len(mesh.blocks) + 1) if len(mesh.blocks) > 1 else ()

    def is_free(name: str) -> bool:
        own = mesh.parts[cells[name]].members if name in cells else np.arange(mesh.cells)
        return len(np.unique(own)) == mesh.cells and not any(f"{name}_{i}" in cells for i in blocks)

    return next(name for name in chain((SOLID,), _numbered(ALL)) if is_free(name))


def _numbered(name: str) -> Iterator[str]:
    """Give a name, and for whom it is taken the same with a number."""
    return chain((name,), (f"{name}_{i}" for i in count(1)))


def _set_names(mesh: VolumeMesh, tied: Sequence[str]) -> tuple[dict[str, str], set[str]]:
    """Return the name that each part has in the deck, or refuse two that would be one.

    And what sets of nodes are called, those of ties too.
    """
    names = {key: set_name(key) for key in mesh.parts}
    seen: dict[tuple[str, str], str] = {}
    for key, name in names.items():
        part = mesh.parts[key]
        own = [name] if part.kind != "pairs" else [f"{name}_{end}" for end in ENDS]
        own += [REFERENCE + name, FAR + name] if key in tied else []
        for one in own:
            kind = "nodes" if part.kind == "pairs" else part.kind
            first = seen.setdefault((kind, one), key)
            if first != key:
                raise FormatError(f"parts {first!r} and {key!r} would both be {one} in a deck")
    return names, {name for kind, name in seen if kind == "nodes"}


FORMAT = Format(
    name="CalculiX and Abaqus input deck",
    suffixes=(".inp",),
    reads=VolumeMesh,
    read=read,
    writes=(Job, VolumeMesh),
    write=write,
    shapes=tuple(ELEMENTS),
    procedures=PROCEDURES,
    command="ccx -i {stem}",
)
