"""Cells with boundaries written out by hand: digit sets of boxes, and curves."""

from functools import reduce
from itertools import product

import numpy as np

from porous.models.brep import Adjacency, Boundary, BRep, CellState, Child, Incidence, selection

SHAPES = ("vertex", "edge", "quad", "hexa")
MENGER = [d for d in product(range(3), repeat=3) if d.count(1) < 2]
CARPET = [d for d in product(range(3), repeat=2) if d != (1, 1)]


def straight(divisions):
    """Matrices (2, 2) of a segment's equal parts."""
    ends = [np.array([1 - t, t]) for t in np.arange(divisions + 1) / divisions]
    return [np.stack(ends[k : k + 2], axis=1) for k in range(divisions)]


def rough(heights=(4 / 9, 4 / 9), roughness=(1 / 9, 1 / 9, 1 / 9)):
    """Matrices (3, 3) of the rough curve R(h; r) of three parts; the default is a parabola."""
    bump = np.array([-0.5, 1.0, -0.5])
    unit = np.eye(3)
    inner = [
        np.array([2, 0, 1]) / 3 + heights[0] * bump,
        np.array([1, 0, 2]) / 3 + heights[1] * bump,
    ]
    points = [unit[0], *inner, unit[2]]
    return [
        np.stack([a, (a + b) / 2 + r * bump, b], axis=1)
        for a, b, r in zip(points[:-1], points[1:], roughness, strict=True)
    ]


def patterns(dimension):
    """Boundaries of a cube: what each axis is fixed to, or None; faces first."""
    every = product((0, 1, None), repeat=dimension)
    found = [p for p in every if p.count(None) < dimension]
    return sorted(found, key=lambda p: -p.count(None))


def box_state(name, dimension, rule, kept=None, rng=None, lowest=0):
    """A cube of any dimension whose children are digits; boundary states are 0, 1, … by dimension.

    Parameters
    ----------
    rule
        Matrices (n, n) of the curve along an axis.
    kept
        Digits of the children; all where not given.
    rng
        Disturbs the guesses.
    lowest
        Dimension of the smallest boundaries that constraints name.
    """
    divisions, along = len(rule), len(rule[0])
    kept = kept or list(product(range(divisions), repeat=dimension))
    lattice = list(product(range(along), repeat=dimension))
    controls = np.zeros((3, along**dimension))
    controls[:dimension] = np.array(lattice, float).reshape(-1, dimension).T / max(1, along - 1)
    sides = patterns(dimension)
    boundaries = []
    for side in sides:
        fixed = [None if s is None else s * (along - 1) for s in side]
        of_side = [
            i
            for i, p in enumerate(lattice)
            if all(f in (None, x) for f, x in zip(fixed, p, strict=True))
        ]
        word = "".join("*" if s is None else str(s) for s in side)
        boundaries.append(Boundary(word, side.count(None), selection(along**dimension, of_side)))
    children = []
    for digits in kept:
        guess = reduce(np.kron, [rule[d] for d in digits], np.ones((1, 1)))
        if rng is not None:
            noise = rng.normal(size=guess.shape) * 0.1
            guess = guess + noise - noise.mean(axis=0)
        children.append(Child("".join(map(str, digits)), dimension, guess))
    incidences, adjacencies, seen = [], [], {}
    for number, digits in enumerate(kept):
        for k, side in [(k, s) for k, s in enumerate(sides) if s.count(None) >= lowest]:
            planes = tuple(
                ("in", d) if s is None else ("at", d + s) for d, s in zip(digits, side, strict=True)
            )
            fixed = [plane for kind, plane in planes if kind == "at"]
            if set(fixed) <= {0, divisions}:
                face = tuple(None if kind == "in" else p // divisions for kind, p in planes)
                free = [d for d, s in zip(digits, side, strict=True) if s is None]
                letter = sum(d * divisions**i for i, d in enumerate(reversed(free)))
                incidences.append(Incidence(number, k, sides.index(face), letter))
            elif planes in seen:
                adjacencies.append(Adjacency(*seen[planes], number, k))
            else:
                seen[planes] = (number, k)
    return CellState(
        name,
        SHAPES[dimension],
        controls,
        tuple(boundaries),
        tuple(children),
        tuple(incidences),
        tuple(adjacencies),
    )


def vertex(name="vertex"):
    return CellState(name, "vertex", np.zeros((3, 1)), (), (Child("0", 0, np.eye(1)),))


def hexa(rule, kept, rng=None, *, facets=False):
    """A hexahedral digit-set cell: vertex, edge, face and volume are states 0 to 3.

    ``facets``: constraints name boundaries of the highest dimension only.
    """
    kinds = [(SHAPES[d], d, rule, kept if d == 3 else None, rng) for d in (1, 2, 3)]
    return BRep((vertex(), *(box_state(*k, facets * (k[1] - 1)) for k in kinds)), 3)


BEZIER = [
    np.array([[4, 2, 1], [0, 2, 2], [0, 0, 1]]) / 4,
    np.array([[1, 0, 0], [2, 2, 0], [1, 2, 4]]) / 4,
]
CHAIKIN = [
    np.array([[3, 1, 0], [1, 3, 3], [0, 0, 1]]) / 4,
    np.array([[1, 0, 0], [3, 3, 1], [0, 1, 3]]) / 4,
]
CHAIKIN_END = np.array([[3, 1], [1, 3]]) / 4
BEND = np.array([[0, 0.5, 1], [0, 1, 0], [0, 0, 0]])


def chain(guesses, end_state, ends):
    """A curve of two parts, joined; the first starts where it does, the second ends there."""
    size, inner = len(guesses[0]), len(ends[0])
    curve = CellState(
        "curve",
        "edge",
        BEND[:, :size],
        (
            Boundary("start", 0, selection(size, ends[0])),
            Boundary("end", 0, selection(size, ends[1])),
        ),
        tuple(Child(name, 1, guess) for name, guess in zip("ab", guesses, strict=True)),
        (Incidence(0, 0, 0, 0), Incidence(1, 1, 1, 0)),
        (Adjacency(0, 1, 1, 0),),
    )
    assert end_state.size == inner
    return BRep((end_state, curve), 1)


def bezier(guesses=BEZIER):
    """A parabola by de Casteljau; its end points are its first and last control."""
    return chain(guesses, vertex(), ((0,), (2,)))


def chaikin(guesses=CHAIKIN, end=CHAIKIN_END):
    """The uniform quadratic B-spline: its ends are states of two controls."""
    controls = np.array([[-0.5, 0.5], [0, 0], [0, 0]])
    end_state = CellState("end", "vertex", controls, (), (Child("0", 0, end),))
    return chain(guesses, end_state, ((0, 1), (1, 2)))


def guessing(brep, matrices):
    """The same cells with other guesses: for each state, a matrix for each child."""
    states = [
        CellState(
            q.name,
            q.shape,
            q.controls,
            q.boundaries,
            tuple(Child(c.name, c.state, T) for c, T in zip(q.children, group, strict=True)),
            q.incidences,
            q.adjacencies,
        )
        for q, group in zip(brep.states, matrices, strict=True)
    ]
    return BRep(tuple(states), brep.start)


def in_other_weights(brep, bases):
    """The same cells with new controls, old·basis: T' = S⁻¹·T·S_child, B' = S⁻¹·B·S_boundary."""

    def moved(matrix, state, inner):
        return np.linalg.solve(bases[state], matrix @ bases[inner])

    states = [
        CellState(
            q.name,
            q.shape,
            q.controls @ bases[i],
            tuple(Boundary(b.name, b.state, moved(b.matrix, i, b.state)) for b in q.boundaries),
            tuple(Child(c.name, c.state, moved(c.guess, i, c.state)) for c in q.children),
            q.incidences,
            q.adjacencies,
        )
        for i, q in enumerate(brep.states)
    ]
    return BRep(tuple(states), brep.start)
