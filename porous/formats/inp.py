"""INP: decks for CalculiX and Abaqus in mm, N, MPa and t, with sets, material and a step.

CalculiX refuses fields longer than 20 characters; sets have at most 16 numbers in a line. Element
faces are S1, S2, … as ``SHAPES`` lists them. Nodes and elements are numbered from 1.
https://www.dhondt.de/ccx_2.20.pdf
"""

from __future__ import annotations

import re
import textwrap
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.formats._registry import Format
from porous.values import Job, VolumeMesh
from porous.values.units import length_ratio

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.values import Compression, Material, Part

ELEMENTS = {"tet4": "C3D4", "hex8": "C3D8", "tet10": "C3D10"}
"""Element types; VTK's node order is CalculiX's for all of them."""

SOLID = "SOLID"
SLAB = 10_000
PER_LINE = 16
WIDTH = 78


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
        yield _material(job.material)
        yield from _step(job, names)


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


def _material(material: Material) -> bytes:
    name = _name(material.name)
    return _comment(material.source) + _lines(
        f"*MATERIAL, NAME={name}",
        "*ELASTIC",
        f"{material.youngs_modulus:.9e}, {material.poissons_ratio:.9e}",
        "*DENSITY",
        f"{material.density:.9e}",
        f"*SOLID SECTION, ELSET={SOLID}, MATERIAL={name}",
    )


def _step(job: Job, names: dict[str, str]) -> Iterator[bytes]:
    if job.step is None:
        yield _comment(f"no step: {job.why_no_step}")
        return
    fixed = names[job.step.fixed]
    yield _lines("*STEP", "*STATIC", "*BOUNDARY", f"{fixed}, 1, 3", "*DLOAD")
    yield from _loads(job.mesh, job.step)
    yield _lines(
        f"*NODE PRINT, NSET={fixed}, TOTALS=ONLY",
        "RF",
        f"*EL PRINT, ELSET={SOLID}, TOTALS=ONLY",
        "ELSE, EVOL",
        "*NODE FILE",
        "U, RF",
        "*EL FILE",
        "S, E",
        "*END STEP",
    )


def _loads(mesh: VolumeMesh, step: Compression) -> Iterator[bytes]:
    faces = mesh.parts[step.loaded].members + 1
    for start in range(0, len(faces), SLAB):
        yield "".join(
            f"{cell}, P{face}, {step.pressure:.9e}\n"
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
    writes=(Job, VolumeMesh),
    write=write,
)
