"""Dimensions of an automaton's attractor: of similarities exactly, of affine maps from above.

The states may have any number of control points.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from porous.models.adapted import turned, weight_system
from porous.models.rational import is_rational

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.models.automaton import Automaton

SIMILAR = 1e-9
"""A matrix is a similarity where its singular values agree to this, relative to the largest."""

MOST_WORDS = 20_000
"""Up to how many words of space's maps the affinity bound looks at."""

MEANS = 400
"""How many means are taken in the search for a metric."""

DEFINITE = 1e-9
"""A metric of trace one is blind where its eigenvalues are smaller."""

LONGEST = 12
"""The longest of them."""


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
    """Return the similarity dimension, or None where some cell is no similar image of its parent.

    The root s of ρ(M(s)) = 1 with M(s)_qr = Σ ratioˢ over the transitions q → r: Σ ratioˢ = 1 for
    one state (Moran 1946; Hutchinson 1981), the largest of the strongly connected parts' for
    several (Mauldin & Williams 1988). It is the Hausdorff dimension where the images do not
    overlap (open set condition). −∞ where no path is endless, 0 where endless paths only turn in
    circles. Cells of any number of controls count as similar where their controls are.
    """
    scale = _figure_ratios(automaton)
    if scale is None:
        return None
    return _root(_ends(automaton), lambda s: _powers(scale, s), len(automaton.states))


def affinity_bound(automaton: Automaton, length: int) -> float:
    """Return the root s of ρ(Σ φˢ(A_w)) = 1 over words of ``length``: no dimension exceeds it.

    φˢ(A) = σ₁…σ_k σ_{k+1}^{s−k} with k = ⌊s⌋, and |det A|^{s/d} from d on (Falconer 1988). It
    bounds the box and Hausdorff dimensions of the attractor from above, capped at 3. Where states
    are no frames of space, A acts on the controls where children are affine images of their
    parents, and on the weights that sum to zero: the attractor is an image of theirs.
    """
    return min(3.0, *(_affinity(automaton, part, length) for part in _actions(automaton)))


def affinity_dimension(automaton: Automaton) -> float:
    """Return the best affinity bound over words of lengths that are affordable; −∞ as above.

    Of similar cells it is the similarity dimension, or 3.
    """
    known = similarity_dimension(automaton)
    if known is not None:
        return min(3.0, known)
    many = max(len(children) for children in automaton.children)
    best = 3.0
    for part in _actions(automaton):
        cost = max(1.0, part.shape[1] / 3) ** 2
        best, length = min(best, _affinity(automaton, part, 1)), 2
        while cost * len(part) * many ** (length - 1) <= MOST_WORDS and length <= LONGEST:
            best = min(best, _affinity(automaton, part, length))
            length += 1
    return best


def _affinity(automaton: Automaton, A: NDArray[np.float64], length: int) -> float:
    ends = _ends(automaton)
    start, end, products = ends[0], ends[1], A
    for _ in range(length - 1):
        i, j = np.nonzero(end[:, None] == ends[0][None, :])
        start, end, products = start[i], ends[1][j], products[i] @ A[j]
    sigma = np.asarray(np.linalg.svd(products, compute_uv=False), np.float64)
    words = np.stack([start, end])
    return _root(words, lambda s: _falconer(sigma, s), len(automaton.states))


def _actions(automaton: Automaton) -> list[NDArray[np.float64]]:
    """Return what transitions do, as matrices (t, n, n): on space, else on controls and weights."""
    if automaton.spatial:
        return [automaton.maps[:, :, :3]]
    found = _figure_maps(automaton)
    weights = _weight_blocks(automaton)
    return [weights] if found is None else [found, weights]


def _weight_blocks(automaton: Automaton) -> NDArray[np.float64]:
    """Return the diagonal blocks on the weights that sum to zero, in a flag that is kept.

    Stretching the flag makes what is off the diagonal as small as one likes: only the blocks
    count.
    """
    letters, label = _turning(automaton)
    if not len(letters):
        return np.zeros((len(label), 1, 1))
    moves = [automaton.transitions[letter] for letter in letters]
    sizes = np.ones(len(automaton.states), np.int64)
    for t in moves:
        sizes[t.source] = len(t.matrix)
    ends = [(t.source, t.target) for t in moves]
    found = turned(weight_system(ends, [t.matrix for t in moves], sizes.tolist())[0])
    same = found.groups[found.system.sources][:, :, None]
    same = same == found.groups[found.system.targets][:, None, :]
    result = np.zeros((len(label), *found.system.matrices.shape[1:]))
    result[letters] = np.where(same, found.system.matrices, 0.0)
    return result


# --- cells as images of their parents -------------------------------------------------------


def _figure_ratios(automaton: Automaton) -> NDArray[np.float64] | None:
    """Return the ratio of each transition on a cycle (t,), zero off them; None if not similar."""
    A = _figure_maps(automaton)
    if A is None:
        return None
    letters = np.flatnonzero(np.abs(A).max(axis=(1, 2)) > 0)
    sources, targets = _ends(automaton)[:, letters]
    metrics = _metrics(sources, targets, A[letters], len(automaton.states))
    pulled = A[letters].transpose(0, 2, 1) @ metrics[sources] @ A[letters]
    squares = np.trace(pulled, axis1=1, axis2=2)
    if not _definite(A[letters], targets, metrics):
        return None
    defects = np.abs(pulled - squares[:, None, None] * metrics[targets]).max(axis=(1, 2))
    if (defects > SIMILAR * squares).any():
        return None
    result = np.zeros(len(A))
    result[letters] = np.sqrt(squares)
    return result


def _definite(
    A: NDArray[np.float64], targets: NDArray[np.int64], metrics: NDArray[np.float64]
) -> bool:
    """Tell whether the inner products are positive wherever some map is not zero."""
    size = np.linalg.norm(A, axis=(1, 2))
    values, vectors = np.linalg.eigh(metrics)
    # What a metric hardly measures must be what the maps hardly see.
    blind = np.where(values < DEFINITE, 1.0, 0.0)
    hidden = vectors * blind[:, None, :]
    return bool((np.abs(A @ hidden[targets]).max(axis=(1, 2)) <= SIMILAR * size).all())


def _metrics(
    sources: NDArray[np.int64], targets: NDArray[np.int64], A: NDArray[np.float64], states: int
) -> NDArray[np.float64]:
    """Return inner products G_q (s, 3, 3) of trace one for which the maps are similar, if any are.

    An affine image of similar maps is none, but has their dimension: AᵀG_qA ∝ G_r is what the
    mean over the maps, and over their words, comes to.
    """
    spans = np.zeros((states, 3, 3))
    np.add.at(spans, targets, A.transpose(0, 2, 1) @ A)
    G = np.zeros_like(spans)
    for q, span in enumerate(spans):
        values, vectors = np.linalg.eigh(span)
        inside = vectors[:, values > SIMILAR * max(values[-1], 1e-300)]
        G[q] = inside @ inside.T / max(inside.shape[1], 1)
    share = 1 / np.maximum(np.bincount(targets, minlength=states), 1)[targets]
    for _ in range(MEANS):
        pulled = A.transpose(0, 2, 1) @ G[sources] @ A
        pulled *= (share / np.maximum(np.trace(pulled, axis1=1, axis2=2), 1e-300))[:, None, None]
        mean = np.zeros_like(G)
        np.add.at(mean, targets, pulled)
        change = np.abs(mean - G).max()
        G = (G + mean) / 2
        if change <= 1e-14:
            break
    return G


def _figure_maps(automaton: Automaton) -> NDArray[np.float64] | None:
    """Return the linear maps (t, 3, 3) from parents to children on cycles, zero off them.

    None where the controls of some child on a cycle are no affine image of those of its state, or
    are divided by weights. A state's controls are the reference ones, or those of a cell below the
    part's first state: whichever serves.
    """
    if any(is_rational(state.controls) for state in automaton.states):
        return None
    turning, label = _turning(automaton)
    result = np.zeros((len(label), 3, 3))
    for part in np.unique(label[turning]):
        letters = turning[label[turning] == part]
        for places in _places(automaton, letters):
            found = [_image(automaton, places, int(letter)) for letter in letters]
            if all(A is not None for A in found):
                result[letters] = found
                break
        else:
            return None
    return result


def _places(
    automaton: Automaton, letters: NDArray[np.int64]
) -> list[dict[int, NDArray[np.float64]]]:
    """Return where the controls of a part's states may lie: two choices."""
    moves = [automaton.transitions[letter] for letter in letters]
    reference = {t.source: automaton.states[t.source].controls for t in moves}
    first = moves[0].source
    below = {first: reference[first]}
    while len(below) < len(reference):
        for t in moves:
            if t.source in below and t.target not in below:
                below[t.target] = below[t.source] @ t.matrix
    return [reference, below]


def _image(
    automaton: Automaton,
    places: dict[int, NDArray[np.float64]],
    letter: int,
) -> NDArray[np.float64] | None:
    """Return the linear map (3, 3) that takes a state's controls to the child's, or None.

    Where the controls span less than space it is zero across them.
    """
    t = automaton.transitions[letter]
    original, image = places[t.target], places[t.source] @ t.matrix
    original = original - original.mean(axis=1, keepdims=True)
    image = image - image.mean(axis=1, keepdims=True)
    U, sizes, rows = np.linalg.svd(original, full_matrices=False)
    rank = int((sizes > SIMILAR * max(sizes[0], 1e-300)).sum())
    A = (image @ rows[:rank].T / sizes[:rank]) @ U[:, :rank].T
    size = max(float(np.abs(image).max()), float(np.abs(original).max()) * 1e-3)
    if np.abs(A @ original - image).max() > SIMILAR * size:
        return None
    return np.asarray(A)


def _ends(automaton: Automaton) -> NDArray[np.int64]:
    return np.array([(t.source, t.target) for t in automaton.transitions], np.int64).T


def _powers(scale: NDArray[np.float64], s: float) -> NDArray[np.float64]:
    return np.where(scale > 0, scale, 0.0) ** s if s > 0 else np.ones_like(scale)


def _falconer(sigma: NDArray[np.float64], s: float) -> NDArray[np.float64]:
    d = sigma.shape[1]
    if s >= d:
        return np.asarray(sigma.prod(axis=1) ** (s / d))
    k = math.floor(s)
    return np.asarray(sigma[:, :k].prod(axis=1) * _powers(sigma[:, k], s - k))


def _root(
    ends: NDArray[np.int64], weights: Callable[[float], NDArray[np.float64]], states: int
) -> float:
    """Return the largest root of ρ(M(s)) = 1 over the strongly connected parts, or −∞."""
    label = _parts(ends, states)
    same = label[ends[0]] == label[ends[1]]
    best = -math.inf
    for part in np.unique(label[ends[0][same]]):
        best = max(best, _bisected(ends, weights, states, same & (label[ends[0]] == part)))
    return best


def _turning(automaton: Automaton) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the transitions on cycles, and the part that each transition's source is of, (t,)."""
    ends = _ends(automaton)
    label = _parts(ends, len(automaton.states))
    return np.flatnonzero(label[ends[0]] == label[ends[1]]), label[ends[0]]


def _parts(ends: NDArray[np.int64], states: int) -> NDArray[np.int64]:
    """Return the number of each state's strongly connected part."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(ends.shape[1], np.int8), (ends[0], ends[1])), shape=(states,) * 2)
    return np.asarray(connected_components(graph, directed=True, connection="strong")[1])


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
