"""Iterated function systems that several tests ask about."""

import itertools

import numpy as np

from porous.models.automaton import cells, frames, of_maps
from porous.models.primitive import named

GOLD = (1 + 5**0.5) / 2
RATIOS = {
    "tetrahedron": 1 / 2,
    "octahedron": 1 / 2,
    "icosahedron": 1 / (1 + GOLD),
    "dodecahedron": 1 / (2 + GOLD),
}
MENGER = [d for d in itertools.product(range(3), repeat=3) if d.count(1) < 2]
VICSEK_9 = [*itertools.product((0, 2), repeat=3), (1, 1, 1)]
EDGES_12 = [d for d in itertools.product(range(3), repeat=3) if d.count(1) == 1]
PARITY = [d for d in itertools.product(range(2), repeat=3) if sum(d) % 2 == 0]
MINUS_CORNER = [d for d in itertools.product(range(2), repeat=3) if d != (1, 1, 1)]


def digits(divisions, keep):
    return of_maps([(np.eye(3) / divisions, np.array(d) / divisions) for d in keep])


def flake(name):
    """Return a flake's automaton and primitive: a copy at each corner."""
    solid, ratio = named(name), RATIOS[name]
    return of_maps([(np.eye(3) * ratio, p * (1 - ratio)) for p in solid.points]), solid


def jerusalem_maps():
    k = 2**0.5 - 1
    maps = [(np.eye(3) * k, np.array(c) * (1 - k)) for c in itertools.product((0, 1), repeat=3)]
    maps += [
        (np.eye(3) * k * k, np.insert(np.array(c) * (1 - k * k), axis, k))
        for axis in range(3)
        for c in itertools.product((0, 1), repeat=2)
    ]
    return maps


def cell_frames(automaton, level):
    return frames(automaton, cells(automaton, level))
