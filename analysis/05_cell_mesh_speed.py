"""How fast do cells become a mesh, against arithmetic on a lattice and against hashed coordinates?

A bent Menger block of 8 and of 27 controls is built from its states to mesh and boundary, step by
step. In the same run its nodes, cells and boundary quadrilaterals are made by hand, by marks on the
lattice of whole numbers that this one body has; and its nodes and cells by ``np.unique`` on rounded
coordinates, for those who know no topology. All have to give the same mesh.
"""

import csv
import os
import sys
import time
from itertools import product
from pathlib import Path

import numpy as np

from porous.models.automaton import expand
from porous.models.builders import Options, build_cell
from porous.models.cell_folds import corner_weights
from porous.models.cell_mesh import cell_mesh
from porous.models.cell_nodes import cell_nodes
from porous.models.cell_surface import cell_boundary
from porous.models.closure import closure
from porous.models.complex import cell_complex
from porous.models.digits import named
from porous.models.solve import solve

RESULTS = Path(os.environ.get("POROUS_RESULTS", Path(__file__).parent / "results"))
CORNERS = np.array(list(product((0, 1), repeat=3)))
MENGER = named("menger")
BARS = {3: 0.5, 4: 5.0}
"""Within how many seconds a level shall be built, by level."""
REPEATS = {3: 7, 4: 5}
NODES = {3: 15616, 4: 295808}
TOTAL, LATTICE, ROUNDED = "all of these", "lattice by hand", "rounded coordinates"
TEAR = 1e-12


class Clock:
    """Seconds of steps."""

    def __init__(self):
        self.seconds = {}
        self.last = time.perf_counter()

    def lap(self, step, made):
        now = time.perf_counter()
        self.seconds[step] = now - self.last
        self.last = time.perf_counter()
        return made


def controls(along):
    """Return the controls of a block with unequal edges, each displaced at random."""
    lattice = np.array(list(product(np.linspace(0, 1, along), repeat=3)))
    moves = np.random.default_rng(0).uniform(-0.05, 0.05, lattice.shape)
    return ((lattice + moves) * [1.0, 1.3, 0.8]).T


def by_construction(name, P, level):
    """Return seconds by step, corners of cells (k, 8, 3), numbers of nodes and of quads."""
    clock = Clock()
    brep = clock.lap("states", build_cell(Options(name, digits=(MENGER,))))
    solution = clock.lap("matrices", solve(brep))
    table = clock.lap("closure table", closure(solution))
    cells = clock.lap("complex", cell_complex(table, level))
    nodes = clock.lap("nodes", cell_nodes(solution, cells, solution.automaton(P), level))
    mesh = clock.lap("mesh", cell_mesh(nodes))
    surface = clock.lap("boundary", cell_boundary(nodes))
    seconds = {**clock.seconds, TOTAL: sum(clock.seconds.values())}
    corners = nodes.points[nodes.groups[0].corners]
    return seconds, corners, len(mesh.points), len(surface.triangles) // 4


def by_lattice(_, P, level):
    """Do the same on the lattice of a cube cut into 3^level along each edge."""
    clock = Clock()
    places = np.zeros((1, 3), np.int64)
    for _ in range(level):
        places = (3 * places[:, None] + MENGER.keep).reshape(-1, 3)
    side = 3**level + 1
    strides = np.array([side**2, side, 1])
    low = places @ strides
    ids = low[:, None] + CORNERS @ strides
    mark = np.zeros(side**3, bool)
    mark[ids] = True
    number = np.cumsum(mark, dtype=np.int64) - 1
    cells = number[ids]
    points = tensor(P, np.flatnonzero(mark), side)
    faces = np.concatenate([3 * (low + end * strides[axis]) + axis for axis, end in SIDES])
    outer = np.flatnonzero(np.bincount(faces) == 1)
    axis = outer % 3
    quads = number[(outer // 3)[:, None] + (RIMS @ strides)[axis]]
    clock.lap(LATTICE, quads)
    return clock.seconds, points[cells], len(points), len(quads)


SIDES = tuple(product(range(3), (0, 1)))
RIMS = np.array([np.insert(CORNERS[[0, 1, 3, 2], 1:], axis, 0, axis=1) for axis in range(3)])
"""Corners of a quadrilateral across each axis."""


def tensor(P, ids, side):
    """Return a tensor product of Bernstein polynomials of degree one or two at lattice points."""
    u = np.linspace(0, 1, side)
    line = {8: [1 - u, u], 27: [(1 - u) ** 2, 2 * u * (1 - u), u**2]}[P.shape[1]]
    x, y, z = np.unravel_index(ids, (side,) * 3)
    basis = np.stack(line, axis=1)
    # P is summed axis by axis over whole lattices, which are small.
    along = len(line)
    rows = np.tensordot(basis, P.reshape(3, along, along, along), (1, 1))  # x, 3, b, c
    sheets = np.tensordot(basis, rows, (1, 2))  # y, x, 3, c
    grid = np.tensordot(basis, sheets, (1, 3))  # z, y, x, 3
    return grid[z, y, x]


def by_rounding(name, P, level):
    """Return nodes and cells of corners whose coordinates agree to nine decimals."""
    solution = solve(build_cell(Options(name, digits=(MENGER,))))
    clock = Clock()
    ((_, cells),) = expand(solution.automaton(P), level)
    corners = (cells @ corner_weights(solution, solution.brep.start)).transpose(0, 2, 1)
    rounded = np.round(corners.reshape(-1, 3), 9)
    _, first, inverse = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    points = corners.reshape(-1, 3)[first]
    spots = points[inverse.reshape(-1, 8)]
    clock.lap(ROUNDED, spots)
    return clock.seconds, spots, len(points), None


def measured(make, name, P, level):
    """Return the seconds by step of the run with the least sum, and what it made."""
    runs = [make(name, P, level) for _ in range(REPEATS[level])]
    return min(runs, key=lambda run: sum(run[0].values()))


def check(made, level, size):
    """End the study where the ways do not give the same mesh."""
    _, corners, nodes, quads = made[0]
    for _, others, many, outer in made:
        gap = float(np.abs(others - corners).max())
        if (
            many != nodes
            or nodes != NODES[level]
            or gap > TEAR * size
            or outer not in (quads, None)
        ):
            sys.exit(f"level {level}: {many} nodes, {outer} quadrilaterals, {gap:.3g} apart")


def rows():
    for name, along in (("hex-8", 2), ("hex-27", 3)):
        P = controls(along)
        for make in (by_construction, by_lattice, by_rounding):
            make(name, P, 1)  # imports and caches are not what is measured
        for level, bar in BARS.items():
            ways = (by_construction, by_lattice, by_rounding)
            made = [measured(make, name, P, level) for make in ways]
            check(made, level, float(np.abs(P).max()))
            seconds = {step: took for run in made for step, took in run[0].items()}
            for step, took in seconds.items():
                wanted = bar if step == TOTAL else None
                yield {
                    "cell": name,
                    "level": level,
                    "cells": len(MENGER.keep) ** level,
                    "nodes": NODES[level],
                    "step": step,
                    "seconds": f"{took:.4f}",
                    "times_as_long_as_the_lattice": f"{took / seconds[LATTICE]:.2f}",
                    "times_as_long_as_rounded_coordinates": f"{took / seconds[ROUNDED]:.3f}",
                    "load_of_the_machine": f"{os.getloadavg()[0]:.1f}",
                    "wanted_at_most": "" if wanted is None else f"{wanted:g}",
                    "met": "" if wanted is None else "yes" if took <= wanted else "no",
                }


def main():
    table = []
    for row in rows():
        table.append(row)
        print(*row.values(), sep="\t")
    with (RESULTS / f"{Path(__file__).stem}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, table[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)


if __name__ == "__main__":
    main()
