"""Slow, obvious twins of limits: a point of every small part, and how far voxels are from them."""

import itertools

import numpy as np
from scipy.spatial import cKDTree

LONGEST = 6
"""The longest words whose products are looked at."""


def shrinkage(matrices):
    """Return τ, the most by which ℓ¹ distances of weights shrink (Dobrushin), and ν.

    τ(T) = ½ max |T_j − T_k|₁ over columns; ν is the largest sum of a column's negative weights.
    """
    pairs = [np.abs(T[:, :, None] - T[:, None, :]).sum(axis=0).max() / 2 for T in matrices]
    return max(pairs), max(np.maximum(-T, 0).sum(axis=0).max() for T in matrices)


def overhang(automaton):
    """Return how much wider than their controls the parts of a limit may be: diam ≤ (1 + e)·diam.

    A = ∪ T_w(A) over the words of one length, so the ℓ¹ distance e of A from the simplex of
    weights obeys e ≤ 2 ν + τ e; and |P z| ≤ ½ diam(P) |z|₁ where z sums to zero.
    """
    letters = [(t.source, t.target, t.matrix) for t in automaton.transitions]
    words = letters
    for _ in range(LONGEST):
        tau, nu = shrinkage([T for _, _, T in words])
        if tau < 0.9:
            return 2 * nu / (1 - tau)
        words = [(q, s, A @ B) for q, r, A in words for r_, s, B in letters if r == r_]
    raise AssertionError("the weights do not shrink in a few steps")


def weights_in_limits(automaton):
    """Return weights (m,) in each state's limit: what its first children make of themselves."""
    found = []
    for state in range(len(automaton.states)):
        T, q = np.eye(automaton.states[state].size), state
        for _ in range(300):
            first = automaton.children[q][0]
            T, q = T @ first.matrix, first.target
        found.append(T[:, 0])
    return found


def limit_points(automaton, size):
    """Return a point of every part of the limit that has a diameter of at most ``size``."""
    more, inner = 1 + overhang(automaton), weights_in_limits(automaton)
    front = [(automaton.start, automaton.states[automaton.start].controls[None])]
    found = []
    while front:
        q, cells = front.pop()
        gaps = cells[:, :, :, None] - cells[:, :, None, :]
        small = np.sqrt((gaps**2).sum(axis=1)).max(axis=(1, 2)) * more <= size
        found.append(cells[small] @ inner[q])
        for t in automaton.children[q] if not small.all() else ():
            front += [(t.target, part) for part in split(cells[~small] @ t.matrix)]
    return np.concatenate(found)


def split(cells, most=4000):
    return [cells[k : k + most] for k in range(0, len(cells), most)]


def voxels_of(points, frame):
    """Return the indices (n, 3) of the voxels that points lie in, and which are in the frame."""
    index = np.floor((points - frame.origin) / frame.spacing).astype(int) - frame.start
    return index, ((index >= 0) & (index < frame.shape)).all(axis=1)


def furthest(marks, frame, points, steps=3):
    """Return the largest distance of a lattice of points on marked voxels, corners too."""
    tree, worst = cKDTree(points), 0.0
    index = np.argwhere(marks)
    for place in itertools.product(np.linspace(0, 1, steps), repeat=3):
        at = frame.origin + (index + frame.start + place) * np.array(frame.spacing)
        worst = max(worst, tree.query(at)[0].max())
    return worst
