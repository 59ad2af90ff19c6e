"""SU2: meshes of the solver of that name, with markers on their boundary.

Every face of the boundary is in one marker: that of its smallest part, so that a side comes before
the skin; faces in no part are WALL. Faces between cells have none. Nodes are counted from 0, and a
wedge's first triangle is seen from outside, as VTK has it. Lengths are mm, or those of the job: SU2
itself reckons in metres. Numbers have all their digits.
https://su2code.github.io/docs_v7/Mesh-File/
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.formats._cards import deck_of, lines, rows
from porous.formats._registry import Format
from porous.values import SHAPES, Job, VolumeMesh
from porous.values.volume_topology import boundary_faces, nodes_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from porous.formats._cards import Deck, Indices

ORDERS = {"tet4": [0, 1, 2, 3], "hex8": list(range(8)), "wed6": [0, 2, 1, 3, 5, 4]}
TRIANGLE, RECTANGLE = 5, 9
REST = "WALL"
LAST = "SKIN"
"""The part that leaves a face to any other of the same size."""
FACES = max(len(shape.faces) for shape in SHAPES.values())


def write(value: Job | VolumeMesh) -> Iterator[bytes]:
    """Write a mesh: elements, points and markers."""
    deck = deck_of(value, ".su2")
    mesh = deck.mesh
    markers = _markers(deck)
    yield lines(*(f"% {line}" for line in deck.heading()))
    yield lines("NDIME= 3", f"NELEM= {mesh.cells}")
    first = 0
    for block in mesh.blocks:
        order = ORDERS[block.shape]
        line = f"{SHAPES[block.shape].vtk}" + " %d" * (len(order) + 1) + "\n"
        numbers = np.arange(first, first + len(block.cells))
        yield from rows(line, block.cells[:, order], numbers)
        first += len(block.cells)
    yield lines(f"NPOIN= {len(deck.points)}")
    yield from rows("%r %r %r %d\n", deck.points, np.arange(len(deck.points)))
    yield lines(f"NMARK= {len(markers)}")
    for name, faces in markers:
        yield lines(f"MARKER_TAG= {name}", f"MARKER_ELEMS= {len(faces)}")
        yield from _faces(nodes_of(mesh, faces))


def _markers(deck: Deck) -> list[tuple[str, Indices]]:
    """Return the markers that are not empty, in the order of the parts, and their faces."""
    boundary = boundary_faces(deck.mesh)
    code = boundary @ np.array([FACES, 1])
    order = np.argsort(code)
    parts = [(name, members) for _, name, members in deck.parts("faces")]
    names = list(dict.fromkeys([*(name for name, _ in parts), REST]))
    label = np.full(len(boundary), names.index(REST))
    for name, members in sorted(parts, key=lambda part: (-len(part[1]), part[0] != LAST)):
        place = np.searchsorted(code[order], members @ np.array([FACES, 1]))
        found = order[np.minimum(place, len(order) - 1)]
        same = (boundary[found] == members).all(axis=1)
        label[found[same]] = names.index(name)
    faces = [(name, boundary[label == number]) for number, name in enumerate(names)]
    return [(name, some) for name, some in faces if len(some)]


def _faces(nodes: Indices) -> Iterator[bytes]:
    flat = nodes[:, 3] < 0
    yield from rows(f"{TRIANGLE} %d %d %d\n", nodes[flat, :3])
    yield from rows(f"{RECTANGLE} %d %d %d %d\n", nodes[~flat])


FORMAT = Format(
    name="SU2 mesh",
    suffixes=(".su2",),
    writes=(Job, VolumeMesh),
    write=write,
    shapes=tuple(ORDERS),
)
