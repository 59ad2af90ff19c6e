"""Meshes and jobs that decks are tried on: every shape, several materials, names that are odd."""

import numpy as np

from porous.values import SHAPES, Block, Held, Job, Material, Part, Pressed, Step, VolumeMesh

CORNERS = {
    "tet4": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
    "wed6": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)],
    "hex8": [
        *((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)),
        *((0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)),
    ],
}
VOLUMES = {"tet4": 1 / 6, "tet10": 1 / 6, "wed6": 1 / 2, "hex8": 1.0, "hex20": 1.0}
BASES = {"tet4": 1 / 2, "tet10": 1 / 2, "wed6": 1 / 2, "hex8": 1.0, "hex20": 1.0}
SIZE = np.array([1.0, 2.0, 0.3])
APART = 1.7
STEEL = Material(
    "steel", 210000.0, 0.3, 7.85e-9, "a <book>, p. 3", conductivity=50.0, specific_heat=4.9e8
)
SOFT = Material("soft", 1234.56789, 0.45, 1.25e-9, conductivity=0.02)
SHAPED = tuple(SHAPES)


def element(shape):
    """Return the nodes of one element of unequal edges, with nodes in the middle of its edges."""
    corners = np.array(CORNERS[SHAPES[shape].linear or shape], float) * SIZE
    middle = [(corners[a] + corners[b]) / 2 for a, b in SHAPES[shape].edges]
    return np.vstack([corners, *middle])


def zoo(shapes=SHAPED, unit="mm"):
    """Return elements side by side, upon z = 0, with parts that overlap, are odd, or empty."""
    nodes = [element(shape) + np.array([APART * i, 0, 0]) for i, shape in enumerate(shapes)]
    starts = np.cumsum([0, *map(len, nodes)])
    points = np.vstack(nodes)
    blocks = tuple(
        Block(shape, start + np.arange(len(own))[None])
        for shape, start, own in zip(shapes, starts, nodes, strict=False)
    )
    bottom = [(cell, 0) for cell in range(len(shapes))]
    every = [(c, f) for c, shape in enumerate(shapes) for f in range(len(SHAPES[shape].faces))]
    half = (len(shapes) + 1) // 2
    cells = np.arange(len(shapes))
    parts = {
        "ZMIN": Part("nodes", np.flatnonzero(points[:, 2] == 0)),
        "ZMIN_FACES": Part("faces", np.array(bottom)),
        "3 odd/é name": Part("faces", np.array(every)),
        "SOLID": Part("cells", cells[:half]),
        "PORE": Part("cells", cells[half:]),
        "WORD_01": Part("cells", cells[::2]),
        "none": Part("nodes", np.zeros(0, np.int64)),
        "no cells": Part("cells", np.zeros(0, np.int64)),
        "no faces": Part("faces", np.zeros((0, 2), np.int64)),
    }
    return VolumeMesh(points, blocks, {}, parts, unit)


def volume(shapes=SHAPED):
    return float(np.prod(SIZE)) * sum(VOLUMES[shape] for shape in shapes)


def base(shapes=SHAPED):
    """Return the area upon z = 0."""
    return float(SIZE[0] * SIZE[1]) * sum(BASES[shape] for shape in shapes)


def counts(mesh):
    """Return how many members each part has that is not empty, by kind."""
    result = {"nodes": {}, "faces": {}, "cells": {}}
    for name, part in mesh.parts.items():
        if len(part.members):
            result[part.kind][name] = len(part.members)
    return result


STEPS = {
    "static": Step(
        "push $ up",
        "static",
        (
            Held("ZMIN", "displacement", components=(0, 1)),
            Held("ZMIN", "displacement", -0.125, components=(2,)),
        ),
        (Pressed("ZMIN_FACES", 2.5),),
    ),
    "modal": Step("ring", "modal", (Held("ZMIN", "displacement", components=(0, 1, 2)),), modes=7),
    "conduction": Step("warm", "conduction", (Held("ZMIN", "temperature", 300.5),)),
}


def zoo_job(procedure="static", shapes=SHAPED, system="mm-N-MPa", unit="mm", title="a *zoo*"):
    """Return a job of two materials, or of one where there is one element."""
    mesh = zoo(shapes, unit)
    known = {"SOLID": STEEL, "PORE": SOFT}
    materials = {name: known[name] for name in known if len(mesh.parts[name].members)}
    return Job(title, mesh, materials, (STEPS[procedure],), system=system)


def written(form, value):
    return b"".join(form.write(value)).decode("ascii")
