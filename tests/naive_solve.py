"""Nearest subdivision matrices the slow way: rational Gauss, one state after the other."""

from fractions import Fraction

import numpy as np

from porous.models.brep import Adjacency


class ContradictionError(Exception):
    """An equation says 0 = something else."""


def rational(matrix):
    return [[Fraction(float(x)) for x in row] for row in np.asarray(matrix)]


def product(a, b):
    columns = list(zip(*b, strict=True))
    return [
        [sum(x * y for x, y in zip(row, c, strict=True) if x and y) for c in columns] for row in a
    ]


def constraints(brep, q):
    return [*brep.states[q].incidences, *brep.states[q].adjacencies]


def equations(brep, q, matrices, chosen=None):
    """Rows ({slot: coefficient}, right side) of the constraints; those of ``chosen`` only."""
    state = brep.states[q]
    kinds = [brep.states[c.state] for c in state.children]
    first = [sum(k.size for k in kinds[:i]) for i in range(len(kinds))]
    result = []
    for number, at in enumerate(constraints(brep, q)):
        if chosen is not None and number not in chosen:
            continue
        B = rational(kinds[at.child].boundaries[at.boundary].matrix)
        order = at.order or range(len(B[0]))
        if isinstance(at, Adjacency):
            other = rational(kinds[at.other].boundaries[at.other_boundary].matrix)
        else:
            face = state.boundaries[at.face]
            points = product(rational(face.matrix), matrices[face.state][at.letter])
        for t, s in enumerate(order):
            row = {}
            for c, weights in enumerate(B):
                row[first[at.child] + c] = weights[t]
            right = [Fraction(0)] * state.size
            if isinstance(at, Adjacency):
                for c, weights in enumerate(other):
                    slot = first[at.other] + c
                    row[slot] = row.get(slot, 0) - weights[s]
            else:
                right = [p[s] for p in points]
            result.append(({k: v for k, v in row.items() if v}, right))
    return result


def reduced(rows):
    """Reduced row echelon form {pivot slot: (row, right side)}, or ``ContradictionError``."""
    done = {}
    for given in rows:
        row, right = dict(given[0]), list(given[1])
        for pivot in [p for p in row if p in done]:
            subtract(row, right, *done[pivot], row[pivot])
        if not row:
            if any(right):
                raise ContradictionError
            continue
        pivot = min(row)
        scale = row[pivot]
        for k in row:
            row[k] /= scale
        right[:] = [x / scale for x in right]
        for other, values in done.values():
            if pivot in other:
                subtract(other, values, row, right, other[pivot])
        done[pivot] = (row, right)
    return done


def subtract(row, right, other, values, factor):
    for k, v in other.items():
        row[k] = row.get(k, 0) - factor * v
        if not row[k]:
            del row[k]
    right[:] = [a - factor * b for a, b in zip(right, values, strict=True)]


def solved(A, rights):
    """Return the solution of A·x = right, square and regular, for each right side."""
    rows = [
        (dict(enumerate(row)), list(r)) for row, r in zip(A, zip(*rights, strict=True), strict=True)
    ]
    rows = [({k: v for k, v in row.items() if v}, r) for row, r in rows]
    done = reduced(rows)
    return [[done[i][1][j] for i in range(len(A))] for j in range(len(rights))]


def nearest(brep):
    """Matrices of every state's children as rationals, and the number of free slots of each."""
    matrices, free = [None] * len(brep.states), [0] * len(brep.states)
    for q in sorted(range(len(brep.states)), key=lambda q: brep.states[q].dimension):
        state = brep.states[q]
        sizes = [brep.states[c.state].size for c in state.children]
        guess = rational(np.hstack([np.zeros((state.size, 0)), *(c.guess for c in state.children)]))
        done = reduced(equations(brep, q, matrices))
        loose = [slot for slot in range(sum(sizes)) if slot not in done]
        free[q] = len(loose)
        slots = range(sum(sizes))
        X = [
            [done[s][1][r] if s in done else Fraction(0) for s in slots] for r in range(state.size)
        ]
        kernel = [
            [-done[s][0].get(f, Fraction(0)) if s in done else Fraction(s == f) for s in slots]
            for f in loose
        ]
        if loose:
            gaps = [
                [g - x for g, x in zip(*pair, strict=True)] for pair in zip(guess, X, strict=True)
            ]
            normal = product(kernel, list(zip(*kernel, strict=True)))
            rights = [[row[0] for row in product(kernel, [[x] for x in gap])] for gap in gaps]
            steps = product(solved(normal, rights), kernel)
            X = [[a + b for a, b in zip(*pair, strict=True)] for pair in zip(X, steps, strict=True)]
        ends = [sum(sizes[: i + 1]) for i in range(len(sizes))]
        matrices[q] = [
            [row[end - size : end] for row in X] for end, size in zip(ends, sizes, strict=True)
        ]
    return matrices, free


def contradictory(brep, q, chosen, matrices):
    """Whether constraints of a state, by number, cannot all hold."""
    try:
        reduced(equations(brep, q, matrices, set(chosen)))
    except ContradictionError:
        return True
    return False


def residual(brep, matrices):
    """Largest violation of a constraint, one after the other."""
    worst = 0.0
    for q, state in enumerate(brep.states):
        for at in constraints(brep, q):
            child = brep.states[state.children[at.child].state]
            left = matrices[q][at.child] @ child.boundaries[at.boundary].matrix
            if isinstance(at, Adjacency):
                other = brep.states[state.children[at.other].state]
                right = matrices[q][at.other] @ other.boundaries[at.other_boundary].matrix
            else:
                face = state.boundaries[at.face]
                right = face.matrix @ matrices[face.state][at.letter]
            right = right[:, list(at.order)] if at.order else right
            worst = max(worst, float(np.abs(left - right).max()))
    return worst
