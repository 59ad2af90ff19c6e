"""Meshes that neutral formats are tested on: every shape, all kinds of parts, awkward names."""

from functools import cache

import numpy as np

from porous.stages import hexahedralize, name_parts
from porous.values import SHAPES, Block, Frame, Part, VolumeMesh, VoxelGrid
from porous.values.volume_topology import faces, matched

KUHN = [[0, 1, 2, 6], [0, 5, 1, 6], [0, 4, 5, 6], [0, 7, 4, 6], [0, 3, 7, 6], [0, 2, 3, 6]]
WEDGES = [[0, 1, 2, 4, 5, 6], [0, 2, 3, 4, 6, 7]]
PIECES = {"hex8": [list(range(8))], "tet4": KUHN, "wed6": WEDGES}
LENGTHS = (1.5, 2.0, 0.75)
"""Edges of the box that every mesh fills but for one hole of ``HOLE``."""
COUNTS = (3, 4, 5)
HOLE = LENGTHS[0] / 3 * LENGTHS[1] / 4 * LENGTHS[2] / 5
VOLUME = LENGTHS[0] * LENGTHS[1] * LENGTHS[2] - HOLE


def holed():
    """Return hexahedra of a box with one missing inside."""
    solid = np.ones(COUNTS, dtype=bool)
    solid[1, 2, 3] = False
    frame = Frame((-0.5, 1.0, 2.0), tuple(np.array(LENGTHS) / COUNTS), COUNTS)
    return hexahedralize(VoxelGrid.of_solid(solid, frame)), frame.box


def midpoints(points, block, shape):
    """Return points and a block with nodes in the middle of edges."""
    pairs = np.sort(np.array(SHAPES[shape].edges), axis=1)
    ends = np.sort(block.cells[:, pairs].reshape(-1, 2), axis=1)
    edges, place = np.unique(ends, axis=0, return_inverse=True)
    middle = points[edges].mean(axis=1)
    more = len(points) + place.reshape(len(block.cells), -1)
    return np.concatenate([points, middle]), Block(shape, np.hstack([block.cells, more]))


def cut(cells, shape):
    return Block(shape, np.concatenate([cells[:, piece] for piece in PIECES[shape]]))


def with_parts(mesh, box, unit="mm"):
    """Return the mesh with its sides, overlapping parts, pairs, an empty part and a lone node."""
    named = name_parts(mesh, box)
    cells = mesh.cells
    pore = np.arange(0, cells, 5)
    solid = np.setdiff1d(np.arange(cells), pore)
    every = faces(mesh)
    within = every.members[matched(every)[0]]
    parts = dict(named.parts)
    for axis in "XYZ":
        low, high = (named.parts[f"{axis}{end}"].members for end in ("MIN", "MAX"))
        others = [i for i in range(3) if i != "XYZ".index(axis)]
        low, high = (p[np.lexsort(mesh.points[p][:, others].round(9).T)] for p in (low, high))
        parts[f"{axis}PAIRS"] = Part("pairs", np.stack([low, high], axis=1))
    parts |= {
        "SOLID": Part("cells", solid),
        "PORE": Part("cells", pore),
        "WORD_00": Part("cells", solid[: len(solid) // 2]),
        "INTERFACE": Part("faces", within[np.isin(within[:, 0], solid)][::7]),
        "GRIP": Part("nodes", np.array([2, 0, 5, 2])),
        "NOTHING": Part("cells", np.zeros(0, dtype=np.int64)),
        "NO_FACE": Part("faces", np.zeros((0, 2), dtype=np.int64)),
        "NO_NODE": Part("nodes", np.zeros(0, dtype=np.int64)),
    }
    phase = np.zeros(cells, dtype=np.int64)
    phase[solid] = 1
    return VolumeMesh(mesh.points, mesh.blocks, {"phase": phase}, parts, unit)


@cache
def body(kind, unit="mm"):
    """Return the body of one shape, or ``mixed`` of hexahedra, wedges and tetrahedra."""
    mesh, box = holed()
    cells, points = mesh.blocks[0].cells, mesh.points
    if kind == "mixed":
        x = points[cells].mean(axis=1)[:, 0] + 0.5
        third = np.minimum((x / LENGTHS[0] * 3).astype(int), 2)
        blocks = [cut(cells[third == i], s) for i, s in enumerate(("wed6", "hex8", "tet4"))]
    elif linear := SHAPES[kind].linear:
        points, block = midpoints(points, cut(cells, linear), kind)
        blocks = [block]
    else:
        blocks = [cut(cells, kind)]
    return with_parts(VolumeMesh(points, tuple(blocks), unit=unit), box, unit)


KINDS = [*SHAPES, "mixed"]


def one_cell(shape):
    """Return one cell alone, without any part."""
    mesh = body(shape)
    used, place = np.unique(mesh.blocks[0].cells[0], return_inverse=True)
    return VolumeMesh(mesh.points[used], (Block(shape, place.reshape(1, -1)),))


def renamed(names, kind="cells"):
    """Return a few hexahedra with parts of those names."""
    mesh, _ = holed()
    member = {"cells": [0], "nodes": [1], "faces": [[0, 1]]}[kind]
    parts = {name: Part(kind, np.array(member)) for name in names}
    return VolumeMesh(mesh.points, mesh.blocks, {}, parts)


def counts(mesh):
    """Return what a judge must find: cells by shape, members by part."""
    shapes = {}
    for block in mesh.blocks:
        shapes[block.shape] = shapes.get(block.shape, 0) + len(block.cells)
    sets = {
        kind: {
            name: len(np.unique(part.members, axis=0))
            for name, part in mesh.parts.items()
            if part.kind == kind and len(part.members)
        }
        for kind in ("nodes", "faces", "cells")
    }
    return shapes, sets


def cells_by_nodes(mesh):
    """Return every cell as its shape and its corners' places in order."""
    return sorted(
        (block.shape, *mesh.points[row].round(12).ravel().tolist())
        for block in mesh.blocks
        for row in block.cells
    )
