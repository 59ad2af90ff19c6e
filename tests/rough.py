"""Subdivision rules of curves, their tensor products and tetrahedra with octahedra, for tests."""

import itertools

import numpy as np

from porous.models.automaton import Automaton, State, Transition

BUMP = np.array([-0.5, 1.0, -0.5])


def straight(divisions):
    """Two controls: the segment in equal parts."""
    n = divisions
    return [np.array([[1 - k / n, 1 - (k + 1) / n], [k / n, (k + 1) / n]]) for k in range(n)]


def rough(heights, texture):
    """Three controls, the middle one a handle: R(h; r), JSR max(1/N, |r|) (triangular)."""
    n = len(texture)
    inner = [np.array([1 - i / n, 0, i / n]) + heights[i - 1] * BUMP for i in range(1, n)]
    ends = [np.array([1.0, 0, 0]), *inner, np.array([0, 0, 1.0])]
    return [
        np.column_stack([a, (a + b) / 2 + r * BUMP, b])
        for a, b, r in zip(ends, ends[1:], texture, strict=False)
    ]


BEZIER = rough((4 / 9, 4 / 9), (1 / 9, 1 / 9, 1 / 9))
"""The quadratic Bézier curve in thirds."""


def takagi(w):
    """Heights Σ wᵏ·dist(2ᵏx, Z) over the unit segment, for the controls (0, 0), (½, 1), (1, 0)."""
    first = np.array([[1, 5 / 8 - w / 2, 1 / 4], [0, 1 / 4 + w, 1 / 2], [0, 1 / 8 - w / 2, 1 / 4]])
    return [first, first[::-1, ::-1].copy()]


def curve(rules, controls):
    """A curve in the plane z = 0 from its rules and controls (m, 2)."""
    points = np.vstack([np.array(controls, float).T, np.zeros(len(controls))])
    return Automaton((State("curve", points),), tuple(Transition(0, 0, T) for T in rules))


def sponge(rules, keep=None, bend=None):
    """The tensor cube of a curve's rules; the Menger digits of three, unless told."""
    n, m = len(rules), len(rules[0])
    digits = itertools.product(range(n), repeat=3)
    kept = keep or [d for d in digits if n != 3 or sum(x == 1 for x in d) <= 1]
    controls = np.array(list(itertools.product(np.linspace(0, 1, m), repeat=3))).T
    state = State("hex", controls if bend is None else controls + bend)
    matrices = [np.kron(rules[a], np.kron(rules[b], rules[c])) for a, b, c in kept]
    return Automaton((state,), tuple(Transition(0, 0, T) for T in matrices))


def corners(controls):
    """Indices of the corners among the m³ controls of a hexahedron."""
    m = round(controls ** (1 / 3))
    lattice = itertools.product(range(m), repeat=3)
    return [i for i, place in enumerate(lattice) if set(place) <= {0, m - 1}]


def bent(controls, seed, amount=0.1):
    """Displacements of the controls of a hexahedron."""
    return np.random.default_rng(seed).normal(size=(3, controls)) * amount


TETRAHEDRON = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]]).T * 1.0


def tetrahedra_and_octahedra(tetra=(4, 1), octa=(8, 6)):
    """Halves of a tetrahedron and an octahedron, as many of each kind as told.

    ``tetra`` are how many tetrahedra and octahedra a tetrahedron keeps, ``octa`` an octahedron.
    """
    mids = list(itertools.combinations(range(4), 2))
    pairs = [0, 5, 1, 4, 2, 3]  # opposite edges next to each other
    half = [np.eye(4)[:, list(mids[k])].mean(axis=1) for k in pairs]
    moves = [(0, 0, (np.eye(4) + np.eye(4)[:, [i]]) / 2) for i in range(4)][: tetra[0]]
    moves += [(0, 1, np.column_stack(half))] * tetra[1]
    unit, centre = np.eye(6), np.full((6, 1), 1 / 6)
    faces = itertools.product((0, 1), (2, 3), (4, 5))
    # A face's halves and the centre: a tetrahedron; a corner and the middles about it.
    inner = [
        np.hstack([centre, (unit[:, [a, b, c]] + unit[:, [b, c, a]]) / 2]) for a, b, c in faces
    ]
    moves += [(1, 0, T) for T in inner[: octa[0]]]
    moves += [(1, 1, (unit + unit[:, [i]]) / 2) for i in range(6)][: octa[1]]
    states = State("tetra", TETRAHEDRON), State("octa", TETRAHEDRON @ np.column_stack(half))
    used = [q for q in (0, 1) if q == 0 or tetra[1]]
    kept = [Transition(a, b, T) for a, b, T in moves if a in used and b in used]
    return Automaton(tuple(states[q] for q in used), tuple(kept))


def koch(model, *, voxels):
    """Return the recipe of von Koch's curve, its state in full; ``model`` says the other keys."""
    third, two = repr(1 / 3), repr(2 / 3)
    return f"""
format = 1
[model]
kind = "bcifs"
{model}
[[model.states]]
name = "curve"
shape = "edge"
controls = [[0, 0, 0], [0.5, 0.28867513459481287, 0], [1, 0, 0]]
boundaries = [
  {{ name = "A", state = "vertex", controls = [0] }},
  {{ name = "B", state = "vertex", controls = [2] }},
]
children = [
  {{ name = "a", state = "curve", matrix = [[1, @, @], [0, #, 0], [0, 0, #]] }},
  {{ name = "b", state = "curve", matrix = [[@, #, 0], [0, @, 1], [#, 0, 0]] }},
  {{ name = "c", state = "curve", matrix = [[0, 0, #], [1, @, 0], [0, #, @]] }},
  {{ name = "d", state = "curve", matrix = [[#, 0, 0], [0, #, 0], [@, @, 1]] }},
]
constraints = ["a.A = A/0", "d.B = B/0", "a.B = b.A", "b.B = c.A", "c.B = d.A"]
[voxels]
voxels = {voxels}
""".replace("@", two).replace("#", third)
