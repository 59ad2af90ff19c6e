"""Dimensions of an automaton's attractor: of similarities exactly, of affine maps from above."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.models.automaton import Automaton

SIMILAR = 1e-9
"""A matrix is a similarity where its singular values agree to this, relative to the largest."""

MOST_WORDS = 20_000
"""Up to how many words the affinity bound looks at."""


def singular_values(automaton: Automaton) -> NDArray[np.float64]:
    """Return the singular values of each transition's map of space, (t, 3), falling."""
    return np.asarray(np.linalg.svd(automaton.maps[:, :, :3], compute_uv=False))


def ratios(automaton: Automaton) -> NDArray[np.float64] | None:
    """Return the ratio of each transition (t,) where all are similarities of space, else None."""
    if not automaton.spatial:
        return None
    sigma = singular_values(automaton)
    if (sigma[:, 0] - sigma[:, 2] > SIMILAR * sigma[:, 0]).any():
        return None
    return np.asarray(np.cbrt(sigma.prod(axis=1)))


def similarity_dimension(automaton: Automaton) -> float | None:
    """Return the similarity dimension, or None where some map is no similarity.

    The root s of ρ(M(s)) = 1 with M(s)_qr = Σ ratioˢ over the transitions q → r: Σ ratioˢ = 1 for
    one state (Moran 1946; Hutchinson 1981), the largest of the strongly connected parts' for
    several (Mauldin & Williams 1988). It is the Hausdorff dimension where the images do not
    overlap (open set condition). −∞ where no path is endless.
    """
    scale = ratios(automaton)
    if scale is None:
        return None
    ends = _ends(automaton)
    return _root(ends, lambda s: _powers(scale, s), len(automaton.states))


def affinity_bound(automaton: Automaton, length: int) -> float:
    """Return the root s of ρ(Σ φˢ(A_w)) = 1 over words of ``length``: no dimension exceeds it.

    φˢ(A) = σ₁…σ_k σ_{k+1}^{s−k} with k = ⌊s⌋, and |det A|^{s/3} from 3 on (Falconer 1988). It
    bounds the box and Hausdorff dimensions of the attractor from above, capped at 3.
    """
    ends, A = _ends(automaton), automaton.maps[:, :, :3]
    start, end, products = ends[0], ends[1], A
    for _ in range(length - 1):
        i, j = np.nonzero(end[:, None] == ends[0][None, :])
        start, end, products = start[i], ends[1][j], products[i] @ A[j]
    sigma = np.asarray(np.linalg.svd(products, compute_uv=False), np.float64)
    words = np.stack([start, end])
    return min(3.0, _root(words, lambda s: _falconer(sigma, s), len(automaton.states)))


def affinity_dimension(automaton: Automaton) -> float | None:
    """Return the best affinity bound over words of lengths that are affordable.

    None where cells are no affine images of space.
    """
    if not automaton.spatial:
        return None
    best, length = affinity_bound(automaton, 1), 2
    many = max(len(children) for children in automaton.children)
    while len(automaton.transitions) * many ** (length - 1) <= MOST_WORDS and length <= 12:
        best = min(best, affinity_bound(automaton, length))
        length += 1
    return best


def _ends(automaton: Automaton) -> NDArray[np.int64]:
    return np.array([(t.source, t.target) for t in automaton.transitions], np.int64).T


def _powers(scale: NDArray[np.float64], s: float) -> NDArray[np.float64]:
    return np.where(scale > 0, scale, 0.0) ** s if s > 0 else np.ones_like(scale)


def _falconer(sigma: NDArray[np.float64], s: float) -> NDArray[np.float64]:
    if s >= 3:
        return np.asarray(sigma.prod(axis=1) ** (s / 3))
    k = math.floor(s)
    return np.asarray(sigma[:, :k].prod(axis=1) * _powers(sigma[:, k], s - k))


def _root(
    ends: NDArray[np.int64], weights: Callable[[float], NDArray[np.float64]], states: int
) -> float:
    """Return the largest root of ρ(M(s)) = 1 over the strongly connected parts, or −∞."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(ends.shape[1], np.int8), (ends[0], ends[1])), shape=(states,) * 2)
    label = connected_components(graph, directed=True, connection="strong")[1]
    same = label[ends[0]] == label[ends[1]]
    best = -math.inf
    for part in np.unique(label[ends[0][same]]):
        best = max(best, _bisected(ends, weights, states, same & (label[ends[0]] == part)))
    return best


def _bisected(
    ends: NDArray[np.int64],
    weights: Callable[[float], NDArray[np.float64]],
    states: int,
    part: NDArray[np.bool_],
) -> float:
    def excess(s: float) -> float:
        matrix = np.zeros((states, states))
        np.add.at(matrix, (ends[0][part], ends[1][part]), weights(s)[part])
        return float(np.abs(np.linalg.eigvals(matrix)).max()) - 1

    low, high = 0.0, 1.0
    if excess(low) <= 1e-12:
        return 0.0
    while excess(high) > 0:
        low, high = high, 2 * high
        if high > 1e6:
            return math.inf
    while high - low > 1e-14 * max(1.0, high):
        middle = (low + high) / 2
        if middle in (low, high):
            break
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return (low + high) / 2
