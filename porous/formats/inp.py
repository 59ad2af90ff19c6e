"""INP: decks for CalculiX and Abaqus in mm, N, MPa and t, with sets, material and a step.

CalculiX refuses fields longer than 20 characters; sets have at most 16 numbers in a line. Element
faces are S1, S2, … as ``SHAPES`` lists them. Nodes and elements are numbered from 1.

Read are the nodes and the hexahedra, wedges and tetrahedra of decks that stand in one file,
without instances; hexahedra of 20 and 27 nodes by their corners. Lengths are taken as millimetres.
Sets, materials and steps are passed over, and so are elements without a volume.
https://www.dhondt.de/ccx_2.20.pdf
"""

from __future__ import annotations

import re
import textwrap
from itertools import chain, pairwise
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.formats._elements import Draft
from porous.formats._registry import Format
from porous.formats.gate import numbers, refuse, whole
from porous.values import Job, VolumeMesh
from porous.values.units import length_ratio

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.formats.gate import Source
    from porous.values import Held, Material, Part, Pressed, Step

ELEMENTS = {"tet4": "C3D4", "hex8": "C3D8", "wed6": "C3D6", "tet10": "C3D10", "hex20": "C3D20"}
"""Element types; VTK's node order is CalculiX's for all of them."""

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

SOLID = "SOLID"
SLAB = 10_000
PER_LINE = 16
WIDTH = 78


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
    """Write a deck; of a bare mesh its nodes, elements and sets."""
    job = value if isinstance(value, Job) else None
    mesh = value if isinstance(value, VolumeMesh) else value.mesh
    if not mesh.cells:
        raise FormatError("the mesh has no cells; a deck needs at least one")
    names = _set_names(mesh)
    yield from _heading(job, mesh)
    yield from _nodes(mesh)
    yield from _elements(mesh)
    for key, part in mesh.parts.items():
        yield from _part(names[key], part, mesh)
    if job is not None:
        for name, material in job.materials.items():
            yield _material(material, names[name])
        if not job.steps:
            yield _comment(f"no step: {job.why_no_step}")
        for step in job.steps:
            yield from _step(step, mesh, names)


def _heading(job: Job | None, mesh: VolumeMesh) -> Iterator[bytes]:
    title = job.title if job else "mesh"
    yield _lines("*HEADING", _plain(title)[:WIDTH])
    yield _comment(f"made by porous; lengths in mm (the mesh was in {mesh.unit}), forces in N,")
    yield _comment("stresses in MPa, densities in t/mm3")
    if job is not None and job.note:
        yield _comment(job.note)


def _nodes(mesh: VolumeMesh) -> Iterator[bytes]:
    yield b"*NODE, NSET=ALL\n"
    points = mesh.points * length_ratio(mesh.unit, "mm")
    for start in range(0, len(points), SLAB):
        slab = points[start : start + SLAB].tolist()
        yield "".join(
            f"{number}, {x:.9e}, {y:.9e}, {z:.9e}\n"
            for number, (x, y, z) in enumerate(slab, start + 1)
        ).encode()


def _elements(mesh: VolumeMesh) -> Iterator[bytes]:
    first = 1
    several = len(mesh.blocks) > 1
    for index, block in enumerate(mesh.blocks, 1):
        name = f"{SOLID}_{index}" if several else SOLID
        yield _lines(f"*ELEMENT, TYPE={ELEMENTS[block.shape]}, ELSET={name}")
        numbers = np.arange(first, first + len(block.cells))
        yield from _rows(np.column_stack([numbers, block.cells + 1]))
        first += len(block.cells)
    if several:
        blocks = ", ".join(f"{SOLID}_{i + 1}" for i in range(len(mesh.blocks)))
        yield _lines(f"*ELSET, ELSET={SOLID}", blocks)


def _part(name: str, part: Part, mesh: VolumeMesh) -> Iterator[bytes]:
    if not len(part.members) or (name == SOLID and len(part.members) == mesh.cells):
        return
    if part.kind == "pairs":
        return
    if part.kind == "faces":
        yield _lines(f"*SURFACE, NAME={name}, TYPE=ELEMENT")
        for start in range(0, len(part.members), SLAB):
            slab = (part.members[start : start + SLAB] + 1).tolist()
            yield "".join(f"{cell}, S{face}\n" for cell, face in slab).encode()
        return
    kind = "NSET" if part.kind == "nodes" else "ELSET"
    yield _lines(f"*{kind}, {kind}={name}")
    numbers = part.members + 1
    whole = len(numbers) // PER_LINE * PER_LINE
    yield from _rows(numbers[:whole].reshape(-1, PER_LINE))
    yield from _rows(numbers[None, whole:] if whole < len(numbers) else numbers[None, :0])


def _material(material: Material, cells: str) -> bytes:
    name = _name(material.name)
    return _comment(material.source) + _lines(
        f"*MATERIAL, NAME={name}",
        "*ELASTIC",
        f"{material.youngs_modulus:.9e}, {material.poissons_ratio:.9e}",
        "*DENSITY",
        f"{material.density:.9e}",
        f"*SOLID SECTION, ELSET={cells}, MATERIAL={name}",
    )


def _step(step: Step, mesh: VolumeMesh, names: dict[str, str]) -> Iterator[bytes]:
    yield _lines("*STEP", "*STATIC")
    for held in step.held:
        yield _held(held, names)
    yield _lines("*DLOAD")
    for pressed in step.pressed:
        yield from _pressed(pressed, mesh)
    for held in step.held:
        yield _lines(f"*NODE PRINT, NSET={names[held.part]}, TOTALS=ONLY", "RF")
    yield _lines(
        f"*EL PRINT, ELSET={SOLID}, TOTALS=ONLY",
        "ELSE, EVOL",
        "*NODE FILE",
        "U, RF",
        "*EL FILE",
        "S, E",
        "*END STEP",
    )


def _held(held: Held, names: dict[str, str]) -> bytes:
    first, last = min(held.components) + 1, max(held.components) + 1
    return _lines("*BOUNDARY", f"{names[held.part]}, {first}, {last}")


def _pressed(pressed: Pressed, mesh: VolumeMesh) -> Iterator[bytes]:
    faces = mesh.parts[pressed.part].members + 1
    for start in range(0, len(faces), SLAB):
        yield "".join(
            f"{cell}, P{face}, {pressed.pressure:.9e}\n"
            for cell, face in faces[start : start + SLAB].tolist()
        ).encode()


def _rows(table: NDArray[np.int64]) -> Iterator[bytes]:
    line = ", ".join(["%d"] * table.shape[1]) + "\n"
    for start in range(0, len(table) if table.size else 0, SLAB):
        slab = table[start : start + SLAB]
        yield (line * len(slab) % tuple(slab.ravel().tolist())).encode()


def _set_names(mesh: VolumeMesh) -> dict[str, str]:
    """Return the name that each part has in the deck, or refuse two that would be one."""
    names = {key: _name(key) for key in mesh.parts}
    seen: dict[tuple[str, str], str] = {}
    for key, name in names.items():
        first = seen.setdefault((mesh.parts[key].kind, name), key)
        if first != key:
            raise FormatError(f"parts {first!r} and {key!r} would both be {name} in a deck")
    return names


def _name(text: str) -> str:
    """Return a set's name: capitals, digits, _ and -, a letter first, at most 60."""
    name = re.sub(r"[^A-Z0-9_-]", "_", text.upper())[:60]
    return name if name[:1].isalpha() else f"N_{name}"


def _plain(text: str) -> str:
    """Return one line of ASCII: no text of the user can become a card."""
    words = " ".join(text.split()).lstrip("*")
    return words.replace("³", "3").encode("ascii", "replace").decode()


def _comment(text: str) -> bytes:
    return _lines(*(f"** {line}" for line in textwrap.wrap(_plain(text), WIDTH)))


def _lines(*lines: str) -> bytes:
    return "".join(f"{line}\n" for line in lines).encode()


FORMAT = Format(
    name="CalculiX and Abaqus input deck",
    suffixes=(".inp",),
    reads=VolumeMesh,
    read=read,
    writes=(Job, VolumeMesh),
    write=write,
    procedures=("static",),
)
