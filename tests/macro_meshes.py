"""Level-0 cells of several bodies, as lists of controls, and cells named in other frames."""

import itertools

import numpy as np

FRAMES = [
    (order, flips)
    for order in itertools.permutations(range(3))
    for flips in itertools.product((0, 1), repeat=3)
]
"""The 48 symmetries of a cube: an order of the axes, and which of them run backwards."""


class Points:
    """Controls that are numbered where they are met; those at one place are one."""

    def __init__(self):
        self.numbers = {}

    def __call__(self, point):
        key = tuple((np.round(point, 9) + 0.0).tolist())
        return self.numbers.setdefault(key, len(self.numbers))

    @property
    def array(self):
        return np.array(list(self.numbers)).T


def relabelled(cell, frame):
    """Return a cell that names its controls along other axes."""
    order, flips = frame
    width = round(len(cell) ** (1 / 3))
    ids = np.array(cell).reshape((width,) * 3)
    return np.flip(ids.transpose(order), np.flatnonzero(flips)).ravel().tolist()


def shuffled(cells, rng):
    """Return cells each in a frame of its own."""
    return [relabelled(cell, FRAMES[rng.integers(48)]) for cell in cells]


def grid(shape, width, place):
    """Return controls and cells of nx × ny × nz cells; ``place`` bends lattice coordinates."""
    points, cells = Points(), []
    steps = np.linspace(0, 1, width)
    for corner in itertools.product(*map(range, shape)):
        lattice = itertools.product(*([c + s for s in steps] for c in corner))
        cells.append([points(place(np.array(u))) for u in lattice])
    return points.array, cells


def quads_by_height(quads, heights):
    """Return controls and cells over plane quads (k, w, w, 2): a layer between heights."""
    points = Points()
    cells = [
        [points((*spot, z)) for row in quad for spot in row for z in heights] for quad in quads
    ]
    return points.array, cells


def turned(quad, angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(quad) @ np.array([[c, s], [-s, c]])


def o_grid(rng=None, amount=0.03, width=3):
    """Return a cylinder of a square core and four sectors, controls displaced at random."""
    steps = np.linspace(0, 1, width)
    core = [[(x - 0.5, y - 0.5) for y in steps] for x in steps]
    sector = []
    for t in steps:
        row = []
        for y in steps - 0.5:
            inner, angle = np.array([0.5, y]), y * np.pi / 2
            middle = 1.0 if abs(y) == 0.5 else 1.2
            outer = 1.5 * middle * np.array([np.cos(angle), np.sin(angle)])
            row.append((1 - t) * inner + t * outer)
        sector.append(row)
    quads = [core, *(turned(sector, k * np.pi / 2) for k in range(4))]
    controls, cells = quads_by_height(quads, steps * 1.3)
    if rng is not None:
        controls = controls + rng.uniform(-amount, amount, controls.shape)
    return controls, cells


def cylinder_12():
    """Return a cylinder of 2 × 2 core cells and eight sectors, straight between corners."""
    ring = [np.array(p) for p in ((1, -1), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1))]
    ring = [*ring, np.array((0, -1)), ring[0]]
    outer = [3 * p / np.linalg.norm(p) for p in ring]
    core = [[[(x + a, y + b) for b in (0, 1)] for a in (0, 1)] for x in (-1, 0) for y in (-1, 0)]
    sectors = [[[ring[k], ring[k + 1]], [outer[k], outer[k + 1]]] for k in range(8)]
    return quads_by_height([*core, *sectors], (0.0, 1.7))


def twisted_ring(count, quarters, radius=4.0):
    """Return a ring of cells whose square section is twisted by quarter turns on its way round."""
    corners = np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)], float)
    points, sections = Points(), []
    for k in range(count + 1):
        way, twist = 2 * np.pi * k / count, quarters * np.pi / 2 * k / count
        spots = turned(corners, twist)
        sections.append(
            [
                points(((radius + r) * np.cos(way), (radius + r) * np.sin(way), 1.2 * z))
                for r, z in spots
            ]
        )
    cells = [[*a, *b] for a, b in itertools.pairwise(sections)]
    return points.array, cells
