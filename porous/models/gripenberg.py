"""The joint spectral radius of matrices between bounds: Gripenberg's branch and bound (1996)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.models.adapted import EPSILON
from porous.models.shrinking import shrinks

if TYPE_CHECKING:
    from numpy.typing import NDArray

MARGIN = 1e-12
"""An upper bound must be this far below one to count as a proof in floating point."""

GAP = 1e-9
"""The search for the joint spectral radius stops where its bounds are this close."""

BUDGET = 100_000
"""How many products of 3×3 matrices a search may form to come to an answer."""

REFINEMENT = 3_000
"""How many products it may form to narrow the bounds of an answer that is known."""

LONGEST = 400
"""The longest word that is looked at."""


class Letters(NamedTuple):
    """Matrices (t, n, n) between states, and bounds on the norms of their errors, (t,).

    The norm is the Euclidean one, or the largest sum of a row where ``rows``.
    """

    sources: NDArray[np.int64]
    targets: NDArray[np.int64]
    matrices: NDArray[np.float64]
    errors: NDArray[np.float64]
    rows: bool = False


class Found(NamedTuple):
    """Bounds on the joint spectral radius and the word that gives the lower one.

    ``refuted`` tells that this word is known not to shrink.
    """

    lower: float
    upper: float
    word: tuple[int, ...]
    refuted: bool

    @property
    def settled(self) -> bool:
        """Whether no search can bring the bounds much closer."""
        return self.upper <= self.lower + 2 * GAP


class _Words(NamedTuple):
    """Products of one length: matrices, their error bounds, ends, letters, best mean norm."""

    products: NDArray[np.float64]
    errors: NDArray[np.float64]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    letters: NDArray[np.int64]
    scores: NDArray[np.float64]


def gripenberg(
    letters: Letters, exact: NDArray[np.float64] | None = None, budget: int = BUDGET
) -> Found:
    """Bound the joint spectral radius: branch over words, drop those that cannot matter.

    A word is dropped once some prefix has a mean norm ‖A_v‖^(1/|v|) of at most lower + GAP. Every
    endless word is made of such prefixes, so the largest of their mean norms bounds the radius;
    error bounds are added to every norm, so it does in spite of rounding.

    Parameters
    ----------
    letters
        The matrices, in coordinates whose norm suits them.
    exact
        The matrices (t, n, n) as they are: with them a word that does not shrink ends the search.
    budget
        How many products of 3×3 matrices may be formed to come to an answer; of larger ones fewer.
    """
    cost = max(1.0, letters.matrices.shape[1] / 3)
    lower, upper, settled, formed = 0.0, np.inf, 0.0, 0.0
    best: tuple[int, ...] = (0,)
    words: _Words | None = None
    while words is None or len(words.scores):
        words = _first(letters) if words is None else _longer(words, letters)
        formed += cost * len(words.scores)
        radius, index = _largest_cycle(words)
        if radius > lower:
            lower, best = radius, tuple(words.letters[index].tolist())
            if exact is not None and radius > 1 - 1e-6 and not shrinks(*exact[list(best)]):
                return Found(lower, np.inf, best, refuted=True)
        upper = min(upper, max(settled, words.scores.max(initial=0.0)))
        dropped = words.scores <= lower + GAP
        settled = max(settled, words.scores[dropped].max(initial=0.0))
        words = _chosen(words, ~dropped)
        allowed = REFINEMENT if upper < 1 - MARGIN else budget
        more = cost * len(words.scores) * len(letters.matrices)
        if formed + more > allowed or words.letters.shape[1] == LONGEST:
            break
    return Found(lower, float(upper), best, refuted=False)


def _chosen(words: _Words, mask: NDArray[np.bool_]) -> _Words:
    chosen: Any = (field[mask] for field in words)
    return _Words(*chosen)


def _first(letters: Letters) -> _Words:
    names = np.arange(len(letters.matrices))[:, None]
    scores = _norms(letters, letters.matrices) + letters.errors
    return _Words(letters.matrices, letters.errors, letters.sources, letters.targets, names, scores)


def _longer(words: _Words, letters: Letters) -> _Words:
    follows = words.ends[:, None] == letters.sources[None, :]
    i, j = np.nonzero(follows)
    products = words.products[i] @ letters.matrices[j]
    sizes, steps = _norms(letters, words.products)[i], _norms(letters, letters.matrices)[j]
    size = products.shape[1]
    rounding = size * max(8, size) * EPSILON * sizes * steps
    errors = words.errors[i] * (steps + letters.errors[j]) + sizes * letters.errors[j] + rounding
    names = np.hstack([words.letters[i], j[:, None]])
    means = (_norms(letters, products) + errors) ** (1 / names.shape[1]) * (1 + 1e-15)
    scores = np.minimum(words.scores[i], means)
    return _Words(products, errors, words.starts[i], letters.targets[j], names, scores)


def _norms(letters: Letters, matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    if letters.rows:
        return np.asarray(np.abs(matrices).sum(axis=2).max(axis=1) * (1 + 1e-14))
    norms: NDArray[np.float64] = np.linalg.norm(matrices, 2, axis=(1, 2))
    return norms * (1 + 1e-14)


def _largest_cycle(words: _Words) -> tuple[float, int]:
    """Return the largest mean spectral radius of the closed words, and which it is of."""
    closed = np.flatnonzero(words.starts == words.ends)
    if not len(closed):
        return 0.0, 0
    radii = np.abs(np.linalg.eigvals(words.products[closed])).max(axis=1)
    index = int(np.argmax(radii))
    return float(radii[index] ** (1 / words.letters.shape[1])), int(closed[index])
