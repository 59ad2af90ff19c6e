"""INP: decks for CalculiX and Abaqus with sets, materials, ties and steps, in mm-N-MPa or m-SI.

CalculiX refuses fields longer than 20 characters; sets have at most 16 numbers in a line. Element
faces are S1, S2, … as ``SHAPES`` lists them. Nodes and elements are numbered from 1.

Read are the nodes and the hexahedra, wedges and tetrahedra of decks that stand in one file,
without instances; hexahedra of 20 and 27 nodes by their corners. Lengths are taken as millimetres.
Sets, materials and steps are passed over, and so are elements without a volume.
https://www.dhondt.de/ccx_2.20.pdf
"""

from __future__ import annotations

import re
from itertools import chain, pairwise
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
from porous.formats._elements import Draft
from porous.formats._registry import Format
from porous.formats.gate import numbers, refuse, whole
from porous.values import Job, VolumeMesh
from porous.values.units import SYSTEMS, length_ratio, system_length

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from porous.formats.gate import Source
    from porous.values import Part

ELEMENTS = {"tet4": "C3D4", "hex8": "C3D8", "wed6": "C3D6", "tet10": "C3D10", "hex20": "C3D20"}
"""Element types; VTK's node order is CalculiX's for all of them. Hexahedra are integrated in full,
C3D8 in 2 × 2 × 2 and C3D20 in 3 × 3 × 3 points: reduced ones bend better and have modes without
energy, which a thin strut of few elements finds. C3D10 is integrated in 4 points, which is exact
where edges are straight."""
HEAT = {shape: f"D{name}" for shape, name in ELEMENTS.items()}
"""Element types of heat; Abaqus needs these, and CalculiX takes them for those of stress."""
ENDS = ("FIRST", "SECOND")
"""How the names end of the sets that hold the nodes of pairs, in order."""

READ = {
    "8": ("hex8", 8),
    "20": ("hex8", 20),
    "27": ("hex8", 27),
    "6": ("wed6", 6),
    "4": ("tet4", 4),
    "10": ("tet10", 10),
}
"""What C3D… is read as, and its nodes."""
VOLUME = re.compile(r"D?C3D(\d+)[A-Z]*")
"""Continuum elements, of stress or (D) of heat, with what the letters say of their integration."""
FLAT = re.compile(
    r"(S\d|STRI|DS\d|M3D|MAX|CP[SEF]|CG?AX|DCAX|S?AX|DC[12]D|T[23]D|B[23]|PIPE|ELBOW|FRAME"
    r"|R[23]D|RAX|RB[23]D|SFM|SFMAX|CONN|SPRING|DASHPOT|MASS|ROTARYI|GAP).*"
)
"""Elements without a volume of their own: shells, planes, trusses, beams, springs, masses."""
ELSEWHERE = {
    "INCLUDE": "all of the deck in one file",
    "INSTANCE": "a deck without instances: Abaqus/CAE writes it where the model's attribute "
    '"Do not use parts and assemblies in input files" is set',
    "SYSTEM": "nodes in the global system",
    **dict.fromkeys(("NGEN", "NFILL", "NCOPY", "NMAP"), "every node written out"),
    **dict.fromkeys(("ELGEN", "ELCOPY"), "every element written out"),
}
"""Cards without which a mesh would not be what its author meant, and what would be right."""
CARD = re.compile(rb"^\*(?!\*)", re.MULTILINE)
COMMENT = re.compile(rb"^\*\*[^\n]*", re.MULTILINE)
LONGEST = 4096
"""The longest card, in characters, over all its lines."""
DATA = bytes.maketrans(b",dD", b" ee")
"""What parts numbers becomes a blank, Fortran's exponents everybody's."""

SOLID, ALL = "SOLID", "ALL_CELLS"


def read(source: Source) -> VolumeMesh:
    """Read nodes and volume elements; whatever else the deck says is passed over."""
    draft = Draft(source)
    nodes: list[bytes] = []
    elements: dict[str, list[bytes]] = {}
    for keyword, options, body in _cards(source.data):
        if keyword and not keyword[0].isalpha():
            refuse("card", f"*{keyword[:20]}", "a keyword that begins with a letter")
        if keyword in ELSEWHERE:
            refuse("card", f"*{keyword}", ELSEWHERE[keyword])
        if keyword in ("NODE", "ELEMENT"):
            _check_options(keyword, options)
        if keyword == "NODE":
            nodes.append(body)
        elif keyword == "ELEMENT" and (kind := _kind(options)):
            elements.setdefault(kind, []).append(body)
    return _mesh(draft, b"".join(nodes), {k: b"".join(bodies) for k, bodies in elements.items()})


def _mesh(draft: Draft, nodes: bytes, elements: dict[str, bytes]) -> VolumeMesh:
    table = _table(nodes, 4, "*NODE")
    draft.add_nodes(whole(table[:, 0], "*NODE"), table[:, 1:])
    labels = [np.zeros(0, np.int64)]
    for kind, body in elements.items():
        shape, count = READ[kind]
        what = f"*ELEMENT of {count} nodes"
        cells = whole(_table(body, 1 + count, what, spread=True), what)
        draft.add_cells(shape, cells[:, 1:])
        labels.append(cells[:, 0])
    numbered = np.concatenate(labels)
    if len(np.unique(numbered)) < len(numbered):
        raise FormatError("*ELEMENT: a number stands twice; wanted each once")
    return draft.mesh()


def _cards(data: bytes) -> Iterator[tuple[str, dict[str, str], bytes]]:
    """Give each card's keyword, its options, and the lines of data that follow it."""
    starts = (match.start() for match in CARD.finditer(data))
    for start, stop in pairwise(chain(starts, [len(data)])):
        end = _line_end(data, start, stop)
        while data[start:end].rstrip().endswith(b",") and end < stop:
            end = _line_end(data, end + 1, stop)
            if end - start > LONGEST:
                raise FormatError(f"a card of more than {LONGEST} characters")
        first, *words = data[start + 1 : min(end, start + LONGEST)].decode("latin-1").split(",")
        pairs = (word.partition("=") for word in words)
        options = {name.strip().upper(): value.strip() for name, _, value in pairs}
        yield " ".join(first.split()).upper(), options, data[end:stop]


def _line_end(data: bytes, start: int, stop: int) -> int:
    end = data.find(b"\n", start, stop)
    return stop if end < 0 else end


def _check_options(keyword: str, options: dict[str, str]) -> None:
    if "INPUT" in options:
        refuse(f"*{keyword} INPUT", options["INPUT"], "all of the deck in one file")
    if (system := options.get("SYSTEM", "R").upper()) != "R":
        refuse(f"*{keyword} SYSTEM", system, "R: nodes as x, y and z")
    if lost := next((name for name in options if not name[:1].isalpha()), None):
        refuse(f"*{keyword}, an option", lost, "a name, and no comma at the end of the card")


def _kind(options: dict[str, str]) -> str:
    """Return the number in the name of a volume element, nothing for what has no volume."""
    name = options.get("TYPE", "").upper()
    if FLAT.fullmatch(name):
        return ""
    volume = VOLUME.fullmatch(name)
    if volume is None or volume[1] not in READ:
        refuse("*ELEMENT TYPE", name, "C3D8, C3D20, C3D6, C3D4, C3D10 and their kin")
    return volume[1]


def _table(body: bytes, width: int, what: str, *, spread: bool = False) -> NDArray[np.float64]:
    """Return lines of data as rows of ``width`` numbers, which may be ``spread`` over several.

    A line never holds numbers of two rows, so that a number too few or too many is not made up for
    by the next line.
    """
    text = COMMENT.sub(b"", body).translate(DATA)
    values = numbers(text, what)
    codes = np.frombuffer(text, np.uint8)
    word = codes > 32  # white space, as bytes.split() has it, lies below
    begins = np.flatnonzero(word & ~np.concatenate([[False], word[:-1]]))
    ends = np.append(np.searchsorted(begins, np.flatnonzero(codes == 10)), len(begins))
    starts = np.append(0, ends[:-1])
    good = (starts // width == (ends - 1) // width) if spread else (ends - starts == width)
    good[starts == ends] = True
    if len(values) % width:  # the last row lacks numbers
        good[np.flatnonzero(starts < ends)[-1:]] = False
    if not good.all() or len(values) != len(begins):
        line = int(np.argmin(good))
        got = text.split(b"\n", line + 1)[line].decode("utf-8", "replace")
        refuse(f"{what}: a line", got.strip(), f"{width} numbers")
    return values.reshape(-1, width)


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
    names = _set_names(mesh, job.tied if job else ())
    every = _everything(mesh, names)
    deck = Deck(job, names, every) if job else None
    yield from _heading(job, mesh)
    yield from _nodes(mesh, system_length(job.system) if job else "mm")
    yield from deck.references() if deck else ()
    yield from _elements(mesh, every, HEAT if deck and deck.is_thermal else ELEMENTS)
    for key, part in mesh.parts.items():
        if not (names[key] == every and len(part.members) == mesh.cells):
            yield from _part(names[key], part, ordered=job is None)
    if deck is not None:
        yield from deck.far()
        yield from deck.equations()
        yield from deck.materials()
        yield from deck.steps()


def _heading(job: Job | None, mesh: VolumeMesh) -> Iterator[bytes]:
    title = job.title if job else "mesh"
    yield lines("*HEADING", plain(title)[:WIDTH])
    units = UNITS[job.system if job else SYSTEMS[0]]
    yield comment(f"made by porous; the mesh was in {mesh.unit}; {units}")
    if job is not None and job.steps:
        yield comment("to run it where it is called NAME.inp: ccx -i NAME")
    if job is not None and job.note:
        yield comment(job.note)


def _nodes(mesh: VolumeMesh, unit: str) -> Iterator[bytes]:
    yield b"*NODE, NSET=ALL\n"
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
    """Return the name of the set of all elements: SOLID, unless that is a part of them only."""
    own = [key for key, name in names.items() if name == SOLID and mesh.parts[key].kind == "cells"]
    if all(len(mesh.parts[key].members) == mesh.cells for key in own):
        return SOLID
    return next(
        name
        for name in (ALL, *(f"{ALL}_{i}" for i in range(len(names) + 1)))
        if name not in names.values()
    )


def _set_names(mesh: VolumeMesh, tied: Sequence[str]) -> dict[str, str]:
    """Return the name that each part has in the deck, or refuse two that would be one."""
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
    return names


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
