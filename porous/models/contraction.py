"""Whether an automaton's maps contract together: yes, no or unknown, with what proves it.

A system of affine maps has an attractor exactly where the joint spectral radius of its linear parts
is below one (Atkins, Barnsley, Vince & Wilson 2010); single maps may stretch. That radius lies
between the spectral radii and the norms of products (Berger & Wang 1992).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.models.adapted import EPSILON, System, adapted_norms, in_coordinates, stretched, turned
from porous.models.gripenberg import MARGIN, REFINEMENT, Found, Letters, gripenberg
from porous.models.shrinking import shrinks
from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.models.adapted import Turned
    from porous.models.automaton import Automaton, Transition

SMALL = 3
"""Blocks of more coordinates are searched in a flag's coordinates at once."""

CLOSE = 1e-9
"""Maps whose largest eigenvalue is this close to one are looked at exactly, …"""

LOOKS = 4
"""… the largest so many."""

MOST_DOBRUSHIN = 1000
"""How many words Dobrushin's coefficient is taken of."""


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
    system: System


def contractivity(automaton: Automaton) -> Contractivity:
    """Decide whether the automaton's maps contract together.

    Coordinates that act on each other only one way are told apart first (block triangular
    systems: the joint spectral radius is the largest of the diagonal blocks'). Each block is
    searched by Gripenberg's branch and bound (1996) in the Euclidean norm and in the ellipsoid
    norm P = I + γ⁻² Σ AᵢᵀPAᵢ; large ones, and what is left open, in coordinates that make the
    matrices block triangular where they have common subspaces. Norms carry a bound on their
    rounding errors; that a product does not shrink is decided exactly, in integers. Where states
    are no frames of space, matrices act on the weights that sum to zero, and Dobrushin's
    coefficient of words is tried too.
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
    if answer == "unknown":
        bounds += f", {_named(lowest.word)} comes closest"
    return Contractivity(answer, lowest.lower, max(upper, lowest.lower), lowest.word, bounds)


def check_contracts(automaton: Automaton, letters: Sequence[str] | None = None) -> Contractivity:
    """Return the certificate, or raise ``ModelError`` naming the word that stretches.

    ``letters`` are the names that users know the transitions by, in their order.
    """
    result = contractivity(automaton)
    named = ", ".join(letters[letter] for letter in result.word) if letters else ""
    word = f" (the word is {named})" if named else ""
    if result.answer == "no":
        raise ModelError(f"the model has no attractor: {result.reason}{word}")
    if result.answer == "unknown":
        raise ModelError(
            f"whether the maps contract together could not be decided: {result.reason}; "
            f"scale the maps so that their products shrink clearly{word}"
        )
    return result


def linear_parts(automaton: Automaton) -> list[NDArray[np.float64]]:
    """Return the matrix of each transition: of space, or on the weights that sum to zero."""
    if automaton.spatial:
        return [matrix[:, :3] for matrix in automaton.maps]
    # The basis e_j − e_last of the weights that sum to zero; the last row follows from the others.
    return [t.matrix[:-1, :-1] - t.matrix[:-1, -1:] for t in automaton.transitions]


def dobrushin(T: NDArray[np.float64]) -> float:
    """Return τ(T) = ½ max ‖T_j − T_k‖₁ over columns: the norm that ℓ1 induces on weights of sum 0.

    No product of matrices has a larger one than the product of theirs.
    """
    columns = T.T
    return max(float(np.abs(columns - column).sum(axis=1).max()) for column in columns) / 2


def _refusal(found: Found, upper: float) -> Contractivity:
    name, many = _named(found.word), len(found.word)
    reason = (
        f"{name} (word of length {many}, first letter outermost) stretch: "
        if many > 1
        else f"{name} does not shrink: "
    ) + f"spectral radius {found.lower**many:.6g}; wanted less than 1"
    return Contractivity("no", found.lower, max(upper, found.lower), found.word, reason)


def _named(word: tuple[int, ...]) -> str:
    return f"{'maps' if len(word) > 1 else 'map'} {'·'.join(map(str, word))}"


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
    number = np.cumsum([len(some) > 0 for some in chosen]) - 1
    size = max(map(len, chosen))
    letters, ends, parts, errors = [], [], [], []
    for letter, (t, A) in enumerate(zip(automaton.transitions, matrices, strict=True)):
        rows, columns = chosen[t.source], chosen[t.target]
        if len(rows) and len(columns):
            part, doubt = np.zeros((2, size, size))
            here = np.ix_(rows, columns)
            part[: len(rows), : len(columns)] = A[here]
            doubt[: len(rows), : len(columns)] = (_rounding(automaton, t) * (A != 0))[here]
            letters.append(letter)
            ends.append((number[t.source], number[t.target]))
            parts.append(part)
            errors.append(doubt)
    sources, targets = np.array(ends).T
    widths = np.array([len(some) for some in chosen if len(some)])
    return _Block(
        tuple(letters), System(sources, targets, np.stack(parts), np.stack(errors), widths)
    )


def _rounding(automaton: Automaton, t: Transition) -> NDArray[np.float64]:
    """Return bounds on the rounding errors of a linear part's entries; zeros are exact."""
    weights = np.abs(t.matrix)
    if not automaton.spatial:
        return EPSILON * (weights[:-1, :-1] + weights[:-1, -1:])
    inverse = automaton.states[t.target].inverse
    assert inverse is not None
    controls = np.abs(automaton.states[t.source].controls)
    return np.asarray(8 * EPSILON * (controls @ weights @ np.abs(inverse))[:, :3])


def _search(block: _Block) -> Found:
    """Search a block in several norms; the result's word is of the automaton's letters."""
    found = Found(0.0, np.inf, (0,), refuted=False)
    if block.system.matrices.shape[1] <= SMALL:
        found = _in_ellipsoids(block.system)
    if not found.refuted and found.upper >= 1 - MARGIN:
        found = _in_flags(block.system, found)
    return found._replace(word=tuple(block.letters[letter] for letter in found.word))


def _in_ellipsoids(system: System) -> Found:
    """Search in the Euclidean norm, then in the adapted one; keep the best of both."""
    best = gripenberg(_letters(system), system.matrices)
    if best.refuted or best.settled:
        return best
    bases = adapted_norms(system.sources, system.targets, system.matrices)
    if bases is None:
        return best
    # |Lᵀx| is the norm: y = Lᵀx are the coordinates.
    groups = np.zeros(bases.shape[:2], np.int64)
    adapted = in_coordinates(system, bases.transpose(0, 2, 1), groups).system
    return _better(best, gripenberg(_letters(adapted), system.matrices))


def _in_flags(system: System, best: Found) -> Found:
    """Search where the matrices are block triangular, as far as they can be.

    The blocks on the diagonal say which word is the worst; the certificate is the norm of the whole
    in coordinates that are stretched group by group, which needs no exact zeros.
    """
    found = turned(system)
    for number in range(int(found.groups.max()) + 1):
        part = _letters(_diagonal(found, number))
        best = _better(best, gripenberg(part, budget=REFINEMENT)._replace(upper=np.inf))
    for word in _suspects(found, best):
        if not shrinks(*system.matrices[list(word)]):
            radius = max(best.lower, 1.0) if word != best.word else best.lower
            return Found(radius, np.inf, word, refuted=True)
    bound, scaled = stretched(found, best.lower)
    best = best._replace(upper=min(best.upper, bound))
    if best.upper < 1 - MARGIN or best.lower > 1 - CLOSE:
        return best
    rows = bool((np.diff(found.groups, axis=1) != 0).all())
    best = _better(best, gripenberg(_letters(scaled, rows=rows)))
    worst = best.lower > 1 - CLOSE and not shrinks(*system.matrices[list(best.word)])
    return best._replace(refuted=worst)


def _suspects(found: Turned, best: Found) -> list[tuple[int, ...]]:
    """Return words that may not shrink: the worst one known and the largest single maps."""
    if best.lower <= 1 - CLOSE:
        return []
    system = found.system
    closed = np.flatnonzero(system.sources == system.targets)
    sizes = np.zeros(len(closed))
    for number in range(int(found.groups.max()) + 1):
        blocks = _diagonal(found, number).matrices[closed]
        sizes = np.maximum(sizes, np.abs(np.linalg.eigvals(blocks)).max(axis=1, initial=0.0))
    order = [int(i) for i in np.argsort(-sizes, kind="stable")[:LOOKS] if sizes[i] > 1 - CLOSE]
    return list(dict.fromkeys([best.word, *((int(closed[i]),) for i in order)]))


def _diagonal(found: Turned, number: int) -> System:
    """Return the system on one group of coordinates."""
    columns = [np.flatnonzero(row == number) for row in found.groups]
    system, size = found.system, max(map(len, columns))
    blocks = np.zeros((2, len(system.matrices), size, size))
    for i, (q, r) in enumerate(zip(system.sources, system.targets, strict=True)):
        here = np.ix_(columns[q], columns[r])
        blocks[0, i, : len(columns[q]), : len(columns[r])] = system.matrices[i][here]
        blocks[1, i, : len(columns[q]), : len(columns[r])] = system.errors[i][here]
    widths = np.array([len(some) for some in columns])
    return system._replace(matrices=blocks[0], errors=blocks[1], widths=widths)


def _letters(system: System, *, rows: bool = False) -> Letters:
    if rows:
        errors = system.errors.sum(axis=2).max(axis=1)
    else:
        errors = np.linalg.norm(system.errors, axis=(1, 2))
    return Letters(system.sources, system.targets, system.matrices, errors, rows)


def _better(one: Found, other: Found) -> Found:
    lower, word = max((one.lower, one.word), (other.lower, other.word))
    return Found(lower, min(one.upper, other.upper), word, one.refuted or other.refuted)


def _dobrushin(automaton: Automaton, longest: int = 4) -> float:
    """Return max τ(T_w)^(1/k) over words of length k, the best of a few k."""
    words = [(t.target, t.matrix) for t in automaton.transitions]
    best = np.inf
    for length in range(1, longest + 1):
        best = min(best, max(dobrushin(T) for _, T in words) ** (1 / length))
        if best < 1 - MARGIN or len(words) * len(automaton.transitions) > MOST_DOBRUSHIN:
            break
        words = [(t.target, T @ t.matrix) for end, T in words for t in automaton.children[end]]
        if not words:
            return 0.0
    return best * (1 + 1e-13)
