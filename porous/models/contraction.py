"""Whether an automaton's maps contract together: yes, no or unknown, with what proves it.

A system of affine maps has an attractor exactly where the joint spectral radius of its linear parts
is below one (Atkins, Barnsley, Vince & Wilson 2010); single maps may stretch. That radius lies
between the spectral radii and the norms of products (Berger & Wang 1992).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.values.value import Value

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.models.automaton import Automaton, Transition

MARGIN = 1e-12
"""An upper bound must be this far below one to count as a proof in floating point."""

GAP = 1e-9
"""The search for the joint spectral radius stops where its bounds are this close."""

BUDGET = 100_000
"""How many products a search may form to come to an answer."""

REFINEMENT = 3_000
"""How many products it may form to narrow the bounds of an answer that is known."""

EPSILON = float(np.finfo(float).eps)

LONGEST = 400
"""The longest word that is looked at."""

LARGEST_KRONECKER = 40
"""Blocks with more coordinates in all their states go without an adapted norm."""


@dataclass(frozen=True, eq=False)
class Contractivity(Value):
    """The answer, bounds on the joint spectral radius, and the word that refutes.

    Parameters
    ----------
    answer
        ``"yes"``, ``"no"`` or ``"unknown"``.
    lower, upper
        The joint spectral radius lies between them; ``upper`` is a certified bound, ``lower`` is
        an eigenvalue in floating point.
    word
        Letters of the closed word whose product does not shrink, where the answer is no; else the
        word that gives ``lower``. A letter is the index of a transition.
    reason
        One sentence for people.
    """

    answer: str
    lower: float
    upper: float
    word: tuple[int, ...]
    reason: str


class _Block(NamedTuple):
    """A strongly connected part: its transitions on the coordinates that act on each other."""

    letters: tuple[int, ...]
    sources: NDArray[np.int64]
    targets: NDArray[np.int64]
    matrices: NDArray[np.float64]
    errors: NDArray[np.float64]


class _Search(NamedTuple):
    lower: float
    upper: float
    word: tuple[int, ...]
    refuted: bool


def contractivity(automaton: Automaton) -> Contractivity:
    """Decide whether the automaton's maps contract together.

    Coordinates that act on each other only one way are told apart first (block triangular
    systems: the joint spectral radius is the largest of the diagonal blocks'). Each block is
    searched by Gripenberg's branch and bound (1996) in the Euclidean norm and in the ellipsoid
    norm P = I + γ⁻² Σ AᵢᵀPAᵢ. Norms carry a bound on their rounding errors; that a product does not
    shrink is decided exactly, in integers. Where states are no frames of space, matrices act on the
    weights that sum to zero, and Dobrushin's coefficient of words is tried too.
    """
    searches = [_search(block) for block in _blocks(automaton)]
    if not searches:
        return Contractivity("yes", 0.0, 0.0, (), "every path ends")
    refuted = [found for found in searches if found.refuted]
    lowest = max(searches, key=lambda found: found.lower)
    upper = max(found.upper for found in searches)
    if not refuted and upper >= 1 - MARGIN and not automaton.spatial:
        upper = min(upper, _dobrushin(automaton))
    if refuted:
        return _refusal(max(refuted, key=lambda found: found.lower), upper)
    bounds = f"the joint spectral radius lies in [{lowest.lower:.9g}, {upper:.9g}]"
    answer = "yes" if upper < 1 - MARGIN else "unknown"
    return Contractivity(answer, lowest.lower, max(upper, lowest.lower), lowest.word, bounds)


def check_contracts(automaton: Automaton) -> Contractivity:
    """Return the certificate, or raise ``ModelError`` naming the word that stretches."""
    result = contractivity(automaton)
    if result.answer == "no":
        raise ModelError(f"the model has no attractor: {result.reason}")
    if result.answer == "unknown":
        raise ModelError(
            f"whether the maps contract together could not be decided: {result.reason}; "
            "scale the maps so that their products shrink clearly"
        )
    return result


def shrinks(matrix: NDArray[np.float64], *more: NDArray[np.float64]) -> bool:
    """Tell exactly whether the product of matrices has a spectral radius below one.

    Floating-point numbers are whole numbers over powers of two: the characteristic polynomial is
    formed in integers (Faddeev–LeVerrier), and Schur–Cohn's recursion decides.
    """
    whole, shift = _integers(matrix)
    for factor in more:
        other, power = _integers(factor)
        whole, shift = whole @ other, shift + power
    return _schur(_characteristic(whole, shift))


def linear_parts(automaton: Automaton) -> list[NDArray[np.float64]]:
    """Return the matrix of each transition: of space, or on the weights that sum to zero."""
    if automaton.spatial:
        return [matrix[:, :3] for matrix in automaton.maps]
    # The basis e_j − e_last of the weights that sum to zero; the last row follows from the others.
    return [t.matrix[:-1, :-1] - t.matrix[:-1, -1:] for t in automaton.transitions]


def adapted_norms(
    sources: NDArray[np.int64], targets: NDArray[np.int64], matrices: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Return matrices L per state such that |Lᵀx| suits the maps, or None where there are none.

    P_r = I + γ⁻² Σ AᵀP_qA over the transitions q → r, γ slightly above ρ(ΣA⊗A)^½, and P = LLᵀ. It
    serves even where γ ≥ 1: the maps' norms are what counts.
    """
    count, size = int(max(sources.max(), targets.max())) + 1, matrices.shape[1]
    if count * size > LARGEST_KRONECKER:
        return None
    square = size * size
    operator = np.zeros((count * square, count * square))
    for q, r, A in zip(sources, targets, matrices, strict=True):
        part = np.kron(A.T, A.T)
        operator[r * square : (r + 1) * square, q * square : (q + 1) * square] += part
    radius = float(np.abs(np.linalg.eigvals(operator)).max())
    gamma = max(radius, 1e-30) * 1.0025
    identity = np.tile(np.eye(size).reshape(-1), count)
    solved = np.linalg.solve(np.eye(len(operator)) - operator / gamma, identity)
    P = solved.reshape(count, size, size)
    try:
        return np.asarray(np.linalg.cholesky((P + P.transpose(0, 2, 1)) / 2), np.float64)
    except np.linalg.LinAlgError:
        return None


def _refusal(found: _Search, upper: float) -> Contractivity:
    letters = "·".join(map(str, found.word))
    many = "maps" if len(found.word) > 1 else "map"
    reason = (
        f"{many} {letters} (word of length {len(found.word)}, first letter outermost) stretch: "
        if len(found.word) > 1
        else f"{many} {letters} does not shrink: "
    ) + f"spectral radius {found.lower ** len(found.word):.6g}; wanted less than 1"
    return Contractivity("no", found.lower, max(upper, found.lower), found.word, reason)


def _blocks(automaton: Automaton) -> list[_Block]:
    """Split the coordinates of all states into strongly connected parts."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    matrices = linear_parts(automaton)
    widths = [0] * len(automaton.states)
    for t, A in zip(automaton.transitions, matrices, strict=True):
        widths[t.source], widths[t.target] = A.shape
    first = np.concatenate([[0], np.cumsum(widths)])
    rows, columns = [], []
    for t, A in zip(automaton.transitions, matrices, strict=True):
        i, j = np.nonzero(A)
        rows.append(first[t.source] + i)
        columns.append(first[t.target] + j)
    a, b = np.concatenate(rows), np.concatenate(columns)
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(first[-1], first[-1]))
    label = connected_components(graph, directed=True, connection="strong")[1]
    inside = np.unique(label[a][label[a] == label[b]])
    return [_block(automaton, matrices, first, label == part) for part in inside]


def _block(
    automaton: Automaton,
    matrices: list[NDArray[np.float64]],
    first: NDArray[np.int64],
    member: NDArray[np.bool_],
) -> _Block:
    chosen = [np.flatnonzero(member[a:b]) for a, b in pairwise(first)]
    size = max(map(len, chosen))
    letters, ends, parts, errors = [], [], [], []
    for letter, (t, A) in enumerate(zip(automaton.transitions, matrices, strict=True)):
        rows, columns = chosen[t.source], chosen[t.target]
        if len(rows) and len(columns):
            part = np.zeros((size, size))
            part[: len(rows), : len(columns)] = A[np.ix_(rows, columns)]
            doubt = _rounding(automaton, t) * (A != 0)
            errors.append(float(np.linalg.norm(doubt[np.ix_(rows, columns)])))
            letters.append(letter)
            ends.append((t.source, t.target))
            parts.append(part)
    sources, targets = np.array(ends).T
    return _Block(tuple(letters), sources, targets, np.stack(parts), np.array(errors))


def _rounding(automaton: Automaton, t: Transition) -> NDArray[np.float64]:
    """Return bounds on the rounding errors of a linear part's entries; zeros are exact."""
    weights = np.abs(t.matrix)
    if not automaton.spatial:
        return EPSILON * (weights[:-1, :-1] + weights[:-1, -1:])
    inverse = automaton.states[t.target].inverse
    assert inverse is not None
    controls = np.abs(automaton.states[t.source].controls)
    return np.asarray(8 * EPSILON * (controls @ weights @ np.abs(inverse))[:, :3])


def _search(block: _Block) -> _Search:
    """Search a block in the Euclidean norm, then in the adapted one; keep the best of both."""
    best = _gripenberg(block, block)
    if best.refuted or best.upper <= best.lower + 2 * GAP:
        return best
    adapted = _in_adapted_norm(block)
    if adapted is None:
        return best
    other = _gripenberg(adapted, block)
    lower, word = max((best.lower, best.word), (other.lower, other.word))
    return _Search(lower, min(best.upper, other.upper), word, other.refuted)


def _in_adapted_norm(block: _Block) -> _Block | None:
    bases = adapted_norms(block.sources, block.targets, block.matrices)
    if bases is None:
        return None
    inverses = np.linalg.inv(bases)
    # |Lᵀx| is the norm: x = L⁻ᵀy turns A into L_qᵀ A L_r⁻ᵀ.
    left = bases.transpose(0, 2, 1)[block.sources]
    right = inverses.transpose(0, 2, 1)[block.targets]
    matrices = left @ block.matrices @ right
    norms = [np.linalg.norm(m, 2, axis=(1, 2)) for m in (left, block.matrices, right)]
    conditions = np.linalg.cond(bases)[block.targets]
    errors = norms[0] * norms[2] * (64 * EPSILON * norms[1] * conditions + block.errors)
    return block._replace(matrices=matrices, errors=errors)


class _Words(NamedTuple):
    """Products of one length: matrices, their error bounds, ends, letters, best mean norm."""

    products: NDArray[np.float64]
    errors: NDArray[np.float64]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    letters: NDArray[np.int64]
    scores: NDArray[np.float64]


def _gripenberg(block: _Block, exact: _Block) -> _Search:
    """Bound the joint spectral radius: branch over words, drop those that cannot matter.

    A word is dropped once some prefix has a mean norm ‖A_v‖^(1/|v|) of at most lower + GAP. Every
    endless word is made of such prefixes, so the largest of their mean norms bounds the radius;
    error bounds are added to every norm, so it does in spite of rounding.
    """
    lower, upper, settled, formed = 0.0, np.inf, 0.0, 0
    best: tuple[int, ...] = (0,)
    words: _Words | None = None
    while words is None or len(words.scores):
        words = _first(block) if words is None else _longer(words, block)
        formed += len(words.scores)
        radius, index = _largest_cycle(words)
        if radius > lower:
            lower, best = radius, tuple(words.letters[index].tolist())
            if radius > 1 - 1e-6 and not shrinks(*exact.matrices[list(best)]):
                return _Search(lower, np.inf, _named(block, best), refuted=True)
        upper = min(upper, max(settled, words.scores.max(initial=0.0)))
        dropped = words.scores <= lower + GAP
        settled = max(settled, words.scores[dropped].max(initial=0.0))
        words = _chosen(words, ~dropped)
        allowed = REFINEMENT if upper < 1 - MARGIN else BUDGET
        more = len(words.scores) * len(block.letters)
        if formed + more > allowed or words.letters.shape[1] == LONGEST:
            break
    return _Search(lower, float(upper), _named(block, best), refuted=False)


def _chosen(words: _Words, mask: NDArray[np.bool_]) -> _Words:
    chosen: Any = (field[mask] for field in words)
    return _Words(*chosen)


def _named(block: _Block, word: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(block.letters[letter] for letter in word)


def _first(block: _Block) -> _Words:
    letters = np.arange(len(block.letters))[:, None]
    scores = _norms(block.matrices) + block.errors
    return _Words(block.matrices, block.errors, block.sources, block.targets, letters, scores)


def _longer(words: _Words, block: _Block) -> _Words:
    follows = words.ends[:, None] == block.sources[None, :]
    i, j = np.nonzero(follows)
    products = words.products[i] @ block.matrices[j]
    sizes, steps = _norms(words.products)[i], _norms(block.matrices)[j]
    rounding = 8 * len(products[0]) * EPSILON * sizes * steps
    errors = words.errors[i] * (steps + block.errors[j]) + sizes * block.errors[j] + rounding
    letters = np.hstack([words.letters[i], j[:, None]])
    means = (_norms(products) + errors) ** (1 / letters.shape[1]) * (1 + 1e-15)
    scores = np.minimum(words.scores[i], means)
    return _Words(products, errors, words.starts[i], block.targets[j], letters, scores)


def _norms(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
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


def _dobrushin(automaton: Automaton, longest: int = 4) -> float:
    """Return max τ(T_w)^(1/k) over words of length k, the best of a few k."""
    words = [(t.target, t.matrix) for t in automaton.transitions]
    best = np.inf
    for length in range(1, longest + 1):
        best = min(best, max(dobrushin(T) for _, T in words) ** (1 / length))
        if best < 1 - MARGIN or len(words) * len(automaton.transitions) > BUDGET // 20:
            break
        words = [(t.target, T @ t.matrix) for end, T in words for t in automaton.children[end]]
        if not words:
            return 0.0
    return best * (1 + 1e-13)


def dobrushin(T: NDArray[np.float64]) -> float:
    """Return τ(T) = ½ max ‖T_j − T_k‖₁ over columns: the norm that ℓ1 induces on weights of sum 0.

    No product of matrices has a larger one than the product of theirs.
    """
    columns = T.T
    return max(float(np.abs(columns - column).sum(axis=1).max()) for column in columns) / 2


def _integers(matrix: NDArray[np.float64]) -> tuple[NDArray[np.object_], int]:
    """Return whole numbers M and a shift s with matrix = M / 2^s, exactly."""
    fractions = [Fraction(float(value)) for value in matrix.flat]
    shift = max(f.denominator.bit_length() - 1 for f in fractions)
    whole = np.array([int(f * (1 << shift)) for f in fractions], dtype=object)
    return whole.reshape(matrix.shape), shift


def _characteristic(M: NDArray[np.object_], shift: int) -> list[int]:
    """Return whole coefficients of a multiple of det(z − M/2^shift), constant term first."""
    n = len(M)
    identity = np.array([[int(i == j) for j in range(n)] for i in range(n)], dtype=object)
    coefficients, B = [1], identity
    for k in range(1, n + 1):
        MB = M @ B
        c = -sum(int(MB[i, i]) for i in range(n)) // k
        coefficients.append(c)
        B = MB + c * identity
    # The coefficient of z^(n−k) of M/2^s is c_k / 2^(s·k); multiply all by 2^(s·n).
    return [c << (shift * (n - k)) for k, c in enumerate(coefficients)][::-1]


def _schur(polynomial: list[int]) -> bool:
    """Tell whether all roots lie inside the unit circle; constant term first, leading not zero."""
    p = polynomial
    while len(p) > 1:
        first, last = p[0], p[-1]
        if abs(first) >= abs(last):
            return False
        p = [last * a - first * b for a, b in zip(p, reversed(p), strict=True)][1:]
        common = int(np.gcd.reduce(np.array(p, dtype=object)))
        p = [c // common for c in p] if common > 1 else p
    return True
