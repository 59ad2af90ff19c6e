"""Slow, obvious twins of the automaton core: words one by one, voxels one by one."""

import itertools

import numpy as np
from scipy import ndimage


def voxels(divisions, keep, level):
    """The solid voxels of a digit set's prefractal, True, shape (N^level,)·3."""
    unit = np.zeros((divisions,) * 3, bool)
    for digit in keep:
        unit[tuple(digit)] = True
    solid = np.ones((1, 1, 1), bool)
    for _ in range(level):
        solid = np.kron(unit, solid)
    return solid


def histogram(solid, periodic=(False, False, False)):
    """Counts of the 2×2×2 windows, one vertex after the other."""
    for axis, wraps in enumerate(periodic):
        pad = [(0, 0)] * 3
        pad[axis] = (1, 0) if wraps else (1, 1)
        solid = np.pad(solid, pad, mode="wrap" if wraps else "constant")
    counts = [0] * 256
    for x, y, z in itertools.product(*(range(n - 1) for n in solid.shape)):
        window = 0
        for a, b, c in itertools.product((0, 1), repeat=3):
            if solid[x + a, y + b, z + c]:
                window |= 1 << (4 * a + 2 * b + c)
        counts[window] += 1
    return tuple(counts)


def euler_number_26(solid):
    """V − E + F − C of the closed union, by sets of doubled coordinates."""
    cells = set()
    for corner in np.argwhere(solid):
        for offset in itertools.product((0, 1, 2), repeat=3):
            cells.add(tuple(2 * corner + offset))
    return sum((-1) ** sum(c % 2 for c in cell) for cell in cells)


def euler_number_6(solid):
    """Voxels − pairs + squares − cubes."""
    chosen = {tuple(v) for v in np.argwhere(solid)}
    total = 0
    for shape in itertools.product((1, 2), repeat=3):
        offsets = list(itertools.product(*(range(n) for n in shape)))
        sign = (-1) ** sum(n == 2 for n in shape)
        total += sign * sum(
            all((x + a, y + b, z + c) in chosen for a, b, c in offsets) for x, y, z in chosen
        )
    return total


def faces(solid):
    """Voxel faces between solid and void, in vacuum."""
    padded = np.pad(solid, 1).astype(int)
    return sum(int(np.abs(np.diff(padded, axis=axis)).sum()) for axis in range(3))


def components(solid, connectivity, periodic=(False, False, False)):
    """Pieces; along periodic axes three copies are laid side by side and joined again."""
    structure = ndimage.generate_binary_structure(3, 1 if connectivity == 6 else 3)
    padded = np.pad(solid, [(1, 1) if wraps else (0, 0) for wraps in periodic], mode="wrap")
    labels, count = ndimage.label(padded, structure)
    parent = list(range(count + 1))

    def root(i):
        while parent[i] != i:
            i = parent[i]
        return i

    shifts = [(0, -(padded.shape[a] - 2), padded.shape[a] - 2) for a in range(3)]
    for place in np.argwhere(padded):
        for axis in range(3):
            if periodic[axis]:
                for shift in shifts[axis]:
                    other = place.copy()
                    other[axis] += shift
                    if 0 <= other[axis] < padded.shape[axis] and padded[tuple(other)]:
                        parent[root(labels[tuple(place)])] = root(labels[tuple(other)])
    return len({root(i) for i in range(1, count + 1)})


def cavities(solid, connectivity):
    """Voids that do not reach the outside."""
    structure = ndimage.generate_binary_structure(3, 1 if connectivity == 6 else 3)
    return ndimage.label(~np.pad(solid, 1), structure)[1] - 1


def narrowest_run(solid):
    """The shortest run of void between two solid voxels along an axis, or None."""
    best = None
    for axis in range(3):
        for line in np.moveaxis(solid, axis, 2).reshape(-1, solid.shape[axis]):
            places = np.flatnonzero(line)
            for a, b in itertools.pairwise(places):
                if b > a + 1 and (best is None or b - a - 1 < best):
                    best = int(b - a - 1)
    return best


def words(automaton, level):
    """Every word of the level with its control points, by recursion, in lexicographic order."""

    def descend(state, points, word):
        children = [t for t in automaton.transitions if t.source == state]
        if len(word) == level or not children:
            yield word, state, points
            return
        for letter, t in enumerate(children):
            yield from descend(t.target, points @ t.matrix, (*word, letter))

    yield from descend(automaton.start, automaton.states[automaton.start].controls, ())


def random_digits(rng, divisions):
    """A random set of digits, at least one."""
    every = np.array(list(itertools.product(range(divisions), repeat=3)))
    chosen = rng.random(len(every)) < rng.uniform(0.2, 0.9)
    chosen[rng.integers(len(every))] = True
    return every[chosen]
