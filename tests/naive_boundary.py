"""Slow, obvious twins: surfaces and contacts of voxels, one voxel at a time; the Pell body."""

import itertools

import numpy as np

STEPS = [(axis, end) for axis in range(3) for end in (0, 1)]


def prefractal(divisions, keep, level):
    """Return the voxels of a digit set's level, one voxel per cell."""
    digit = np.zeros((divisions,) * 3, dtype=bool)
    digit[tuple(np.array(keep).T)] = True
    result = np.ones((1, 1, 1), dtype=bool)
    for _ in range(level):
        result = np.kron(result, digit)
    return result


def pell(n):
    """Return the voxels of the Jerusalem cube's integer model: 8 J(n−1) and 12 J(n−2)."""
    if n <= 0:
        return np.ones((1, 1, 1), dtype=bool)
    corner, edge = pell(n - 1), pell(n - 2)
    a, b = len(corner), len(edge)
    side = 2 * a + b
    result = np.zeros((side,) * 3, dtype=bool)
    for x, y, z in pell_corners(side, a):
        result[x : x + a, y : y + a, z : z + a] |= corner
    for x, y, z in pell_edges(side, a, b):
        result[x : x + b, y : y + b, z : z + b] |= edge
    return result


def pell_corners(side, a):
    return list(itertools.product((0, side - a), repeat=3))


def pell_edges(side, a, b):
    places = []
    for axis in range(3):
        for u, v in itertools.product((0, side - b), repeat=2):
            place = [u, v]
            place.insert(axis, a)
            places.append(tuple(place))
    return places


def solid_set(solid):
    return {tuple(v) for v in np.argwhere(solid).tolist()}


def neighbour(voxel, axis, end):
    return tuple(v + (2 * end - 1) * (i == axis) for i, v in enumerate(voxel))


def quads(solid):
    """Return the faces between solid and void as (voxel, axis, end)."""
    inside = solid_set(solid)
    return [
        (voxel, axis, end)
        for voxel in inside
        for axis, end in STEPS
        if neighbour(voxel, axis, end) not in inside
    ]


def corners_of(quad):
    voxel, axis, end = quad
    result = []
    for u, v in ((0, 0), (0, 1), (1, 1), (1, 0)):
        step = [u, v]
        step.insert(axis, end)
        result.append(tuple(a + b for a, b in zip(voxel, step, strict=True)))
    return result


class Groups:
    def __init__(self):
        self.above = {}

    def find(self, x):
        self.above.setdefault(x, x)
        while self.above[x] != x:
            x = self.above[x]
        return x

    def join(self, x, y):
        self.above[self.find(x)] = self.find(y)

    def count(self):
        return sum(self.find(x) == x for x in list(self.above))


def surface_facts(solid):
    """Return Euler number and pieces of the surface whose solid wedges are kept together.

    Around an edge with two opposite solid voxels the faces of one voxel belong together; around
    a point each fan of faces counts as a vertex.
    """
    every = quads(solid)
    at = {}
    for quad in every:
        ring = corners_of(quad)
        for a, b in itertools.pairwise([*ring, ring[0]]):
            at.setdefault(frozenset((a, b)), []).append(quad)
    fans, sheets, edges = Groups(), Groups(), 0
    for quad in every:
        sheets.find(quad)
        for corner in corners_of(quad):
            fans.find((quad, corner))
    for edge, around in at.items():
        pairs = [around] if len(around) == 2 else by_voxel(around)
        for one, two in pairs:
            edges += 1
            sheets.join(one, two)
            for corner in edge:
                fans.join((one, corner), (two, corner))
    return fans.count() - edges + len(every), sheets.count()


def by_voxel(around):
    first = [q for q in around if q[0] == around[0][0]]
    second = [q for q in around if q[0] != around[0][0]]
    return [first, second]


def contacts(solid):
    """Return the lattice points around which solid voxels are not all joined by faces."""
    inside = solid_set(solid)
    found = set()
    for voxel in inside:
        for step in itertools.product((0, 1), repeat=3):
            point = tuple(a + b for a, b in zip(voxel, step, strict=True))
            around = [
                cell
                for cell in (
                    tuple(p - d for p, d in zip(point, back, strict=True))
                    for back in itertools.product((0, 1), repeat=3)
                )
                if cell in inside
            ]
            groups = Groups()
            for one, two in itertools.product(around, repeat=2):
                groups.find(one)
                if sum(abs(a - b) for a, b in zip(one, two, strict=True)) == 1:
                    groups.join(one, two)
            if groups.count() > 1:
                found.add(point)
    return found
