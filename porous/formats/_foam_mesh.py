"""A mesh as OpenFOAM keeps it: faces with an owner and a neighbour, patches and zones.

Faces between cells come first, by owner and then by neighbour, each wound so that its normal leaves
the owner, which is the cell with the smaller number; then the boundary, patch by patch. Patches are
the sides of the box, and ``WALL``, which is all else; every other part is a zone.
https://www.openfoam.com/documentation/user-guide/4-mesh-generation-and-conversion/4.1-mesh-description
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import FormatError
from porous.memory import check_memory
from porous.values.box import SIDES
from porous.values.units import length_ratio
from porous.values.volume_mesh import SHAPES
from porous.values.volume_topology import faces, matched

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from porous.values import VolumeMesh

    Indices = NDArray[np.int64]
    Flags = NDArray[np.bool_]

WALL = "WALL"
"""The patch of all faces that lie on no side of the box."""
SLAB = 20_000
BYTES_PER_CELL = 1400
"""Measured on a million hexahedra, of which each has six faces."""
LONGEST = 60


@dataclass(frozen=True)
class PolyMesh:
    """Faces, owners and neighbours of a mesh, in metres."""

    points: NDArray[np.float64]
    faces: Indices
    """Nodes, (f, 4), −1 last where there are three."""
    owner: Indices
    neighbour: Indices
    """One for each face between cells, which come first."""
    cells: int
    patches: Mapping[str, range]
    cell_zones: Mapping[str, Indices]
    face_zones: Mapping[str, tuple[Indices, Flags]]
    """Faces, and whether the zone's side of each is that of the neighbour."""
    point_zones: Mapping[str, Indices]


def poly_mesh(mesh: VolumeMesh) -> PolyMesh:
    """Return a mesh's faces in the order that OpenFOAM wants; nodes without a cell are left out.

    Raises
    ------
    FormatError
        For a mesh without cells, or parts whose names would become one.
    """
    if not mesh.cells:
        raise FormatError("the mesh has no cells; a case needs at least one")
    check_memory(BYTES_PER_CELL * mesh.cells, f"the faces of {mesh.cells} cells", "Coarsen.")
    every = faces(mesh)
    first, second = matched(every)
    cell = every.members[:, 0]
    swap = cell[first] > cell[second]
    own, other = np.where(swap, second, first), np.where(swap, first, second)
    order = np.lexsort((cell[other], cell[own]))
    own, other = own[order], other[order]
    outer = np.ones(len(cell), dtype=bool)
    outer[own] = outer[other] = False
    boundary, patches = _patches(mesh, outer, len(own))
    listed = np.concatenate([own, boundary])
    number = np.empty(len(cell), np.int64)
    number[listed] = np.arange(len(listed))
    number[other] = np.arange(len(own))
    flipped = np.zeros(len(cell), dtype=bool)
    flipped[other] = True
    used, node = _used(mesh)
    nodes = every.nodes[listed]
    return PolyMesh(
        mesh.points[used] * length_ratio(mesh.unit, "m"),
        np.where(nodes < 0, -1, node[nodes]),
        cell[listed],
        cell[other],
        mesh.cells,
        patches,
        {name: np.unique(members) for name, members in _named(mesh, "cells").items()},
        _face_zones(mesh, number, flipped),
        _point_zones(mesh, used, node),
    )


def held_patch(mesh: VolumeMesh, part: str) -> str:
    """Return the patch that stands for a part of nodes, which must be a side of the box.

    Raises
    ------
    FormatError
        Where a part is no side, or the mesh has no face on it.
    """
    there = _sides(mesh)
    if part not in there:
        raise FormatError(
            f"held {part}: OpenFOAM holds faces, not nodes; wanted a side of the box that the "
            f"mesh has faces on: {', '.join(there) or 'there is none'}"
        )
    return part


def _sides(mesh: VolumeMesh) -> list[str]:
    """Return the sides of the box that a mesh has faces on."""
    parts = {side: mesh.parts.get(f"{side}_FACES") for side in SIDES}
    return [side for side, part in parts.items() if part is not None and len(part.members)]


def _patches(mesh: VolumeMesh, outer: Flags, start: int) -> tuple[Indices, dict[str, range]]:
    """Return the boundary's faces patch by patch, and the range of each, from ``start`` on."""
    names = _sides(mesh)
    patch = np.full(len(outer), len(names))
    for index, name in reversed(list(enumerate(names))):
        patch[_slots(mesh, mesh.parts[f"{name}_FACES"].members)] = index
    boundary = np.flatnonzero(outer)
    boundary = boundary[np.argsort(patch[boundary], kind="stable")]
    ends = start + np.searchsorted(patch[boundary], np.arange(len(names) + 2))
    bounds = zip([*names, WALL], ends[:-1].tolist(), ends[1:].tolist(), strict=True)
    return boundary, {name: range(low, high) for name, low, high in bounds if low < high}


def _face_zones(
    mesh: VolumeMesh, number: Indices, flipped: Flags
) -> dict[str, tuple[Indices, Flags]]:
    zones = {}
    for name, members in _named(mesh, "faces").items():
        if name not in (WALL, *(f"{side}_FACES" for side in SIDES)):
            slots = _slots(mesh, members)
            listed, index = np.unique(number[slots], return_index=True)
            zones[name] = listed, flipped[slots[index]]
    return zones


def _point_zones(mesh: VolumeMesh, used: Flags, node: Indices) -> dict[str, Indices]:
    zones = _named(mesh, "nodes").items()
    return {name: np.unique(node[members[used[members]]]) for name, members in zones}


def _slots(mesh: VolumeMesh, members: Indices) -> Indices:
    """Return where faces stand among those of all cells."""
    counts = [np.full(len(block.cells), len(SHAPES[block.shape].faces)) for block in mesh.blocks]
    starts = np.concatenate([[0], np.cumsum(np.concatenate(counts))])
    return np.asarray(starts[members[:, 0]] + members[:, 1])


def _used(mesh: VolumeMesh) -> tuple[Flags, Indices]:
    used = np.zeros(len(mesh.points), dtype=bool)
    for block in mesh.blocks:
        used[block.cells] = True
    return used, np.cumsum(used) - 1


def _named(mesh: VolumeMesh, kind: str) -> dict[str, Indices]:
    """Return the parts of a kind that are not empty by names that OpenFOAM can read."""
    found: dict[str, Indices] = {}
    for key, part in mesh.parts.items():
        if part.kind != kind or not len(part.members):
            continue
        name = word(key)
        if name in found:
            raise FormatError(f"parts {key!r} and another would both be {name} in a case")
        found[name] = part.members
    return found


def word(text: str) -> str:
    """Return a name of letters, digits, ``_``, ``.`` and ``-`` that begins with a letter."""
    name = re.sub(r"[^A-Za-z0-9_.-]", "_", text)[:LONGEST]
    return name if name[:1].isalpha() else f"N_{name}"


# --- the files -----------------------------------------------------------------------------------


def poly_mesh_files(poly: PolyMesh, walls: frozenset[str]) -> Iterator[tuple[str, Iterator[bytes]]]:
    """Give the files of ``constant/polyMesh``; ``walls`` are the patches that flow clings to."""
    note = (
        f"nPoints: {len(poly.points)} nCells: {poly.cells} nFaces: {len(poly.faces)} "
        f"nInternalFaces: {len(poly.neighbour)}"
    )
    yield "points", _file("vectorField", "points", _points(poly.points))
    yield "faces", _file("faceList", "faces", _faces(poly.faces))
    yield "owner", _file("labelList", "owner", _labels(poly.owner), note)
    yield "neighbour", _file("labelList", "neighbour", _labels(poly.neighbour), note)
    yield "boundary", _file("polyBoundaryMesh", "boundary", _boundary(poly, walls))
    for kind in ("cell", "face", "point"):
        zones = getattr(poly, f"{kind}_zones")
        if zones:
            yield f"{kind}Zones", _file("regIOobject", f"{kind}Zones", _zones(kind, zones))


def header(kind: str, name: str, note: str = "", location: str = "constant/polyMesh") -> bytes:
    """Return how every file of a case begins."""
    told = f'    note        "{note}";\n' if note else ""
    return (
        "FoamFile\n{\n    version     2.0;\n    format      ascii;\n"
        f'    class       {kind};\n{told}    location    "{location}";\n'
        f"    object      {name};\n}}\n"
    ).encode()


def _file(kind: str, name: str, body: Iterator[bytes], note: str = "") -> Iterator[bytes]:
    yield header(kind, name, note)
    yield from body


def _rows(table: NDArray[np.generic], line: str) -> Iterator[bytes]:
    """Give a list, a row in each line."""
    yield f"{len(table)}\n(\n".encode()
    for start in range(0, len(table), SLAB):
        slab = table[start : start + SLAB]
        yield (line * len(slab) % tuple(slab.ravel().tolist())).encode()
    yield b")\n"


def _points(points: NDArray[np.float64]) -> Iterator[bytes]:
    yield from _rows(points + 0.0, "(%r %r %r)\n")


def _labels(labels: NDArray[np.generic]) -> Iterator[bytes]:
    yield from _rows(labels, "%d\n")


def _faces(nodes: Indices) -> Iterator[bytes]:
    yield f"{len(nodes)}\n(\n".encode()
    lines = np.array(["3(%d %d %d)\n", "4(%d %d %d %d)\n"], dtype=object)
    for start in range(0, len(nodes), SLAB):
        slab = nodes[start : start + SLAB]
        text = "".join(lines[(slab[:, 3] >= 0).astype(int)])
        yield (text % tuple(slab[slab >= 0].tolist())).encode()
    yield b")\n"


def _boundary(poly: PolyMesh, walls: frozenset[str]) -> Iterator[bytes]:
    yield f"{len(poly.patches)}\n(\n".encode()
    for name, place in poly.patches.items():
        yield (
            f"    {name}\n    {{\n        type        {'wall' if name in walls else 'patch'};\n"
            f"        nFaces      {len(place)};\n        startFace   {place.start};\n    }}\n"
        ).encode()
    yield b")\n"


def _zones(kind: str, zones: Mapping[str, Indices | tuple[Indices, Flags]]) -> Iterator[bytes]:
    yield f"{len(zones)}\n(\n".encode()
    for name, zone in zones.items():
        labels, flips = zone if isinstance(zone, tuple) else (zone, None)
        yield f"{name}\n{{\n    type {kind}Zone;\n    {kind}Labels List<label>\n".encode()
        yield from _labels(labels)
        if flips is not None:
            yield b";\n    flipMap List<bool>\n"
            yield from _labels(flips.astype(np.int64))
        yield b";\n}\n"
    yield b")\n"
