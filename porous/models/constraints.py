"""The constraints on a state's subdivision as linear equations: their solution, and what is free.

X·C = D for X = [T_0 | T_1 | …], the matrices of a state's children (Tosan et al. 2006; Sokolov,
Gouaty & Gentil 2015). A *slot*, column of X, is a control point of a child; an equation, column of
C, is a control point of a boundary that a constraint names. Equations link slots to *parts*, which
are solved one by one. Where boundaries are selections of controls, all slots of a part are one
point: everything is copied, and exact.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.models.brep import Adjacency

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from porous.models.brep import BRep, CellState, Incidence

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]
    Matrices = Sequence[tuple[Floats, ...]]

CONTRADICTION = 1e-9
"""How far, relative to its weights, a point may be from where two constraints want it."""

RANK = 1e-8
"""Singular values and pivots that are smaller, relative to the largest, are zero."""

NOISE = 1e-13
"""Smaller numbers in a vector whose largest are about one are rounding."""


class System(NamedTuple):
    """X·C = D of a state, and how it falls apart into parts: slots that constraints link."""

    state: int
    starts: Integers  # first slot of each child, and their number
    columns: Integers  # first equation of each constraint, and their number
    C: Any  # sparse (slots, equations)
    part: Integers  # of each slot
    part_of: Integers  # of each equation; −1 where it says nothing
    mixed: NDArray[np.bool_]  # whether a part has more than equal slots and given points

    @property
    def children(self) -> int:
        """Number of children."""
        return len(self.starts) - 1

    @property
    def entries(self) -> Integers:
        """Number of slots in each equation."""
        return np.asarray(np.diff(self.C.indptr))

    def owner(self, equation: int) -> int:
        """Return which constraint an equation comes from."""
        return int(np.searchsorted(self.columns, equation, side="right")) - 1

    def ends(self, equation: int) -> list[int]:
        """Return the slots of an equation."""
        first, last = self.C.indptr[equation : equation + 2]
        return [int(slot) for slot in self.C.indices[first:last]]


def system_of(brep: BRep, index: int) -> System:
    """Return the equations of a state, without their right side."""
    from scipy.sparse import csc_array

    state = brep.states[index]
    starts = np.cumsum([0, *(brep.states[child.state].size for child in state.children)])
    constraints = _constraints(state)
    sizes = [_boundary_size(brep, state, at) for at in constraints]
    columns = np.cumsum([0, *sizes])
    terms = [_terms(brep, state, at) for at in constraints]
    flat = [
        (starts[child] + rows, columns[number] + places, values)
        for number, sides in enumerate(terms)
        for child, rows, places, values in sides
    ]
    shape = int(starts[-1]), int(columns[-1])
    if not flat:
        return _parted(index, starts, columns, csc_array(shape))
    rows, places, values = (np.concatenate(part) for part in zip(*flat, strict=True))
    return _parted(index, starts, columns, csc_array((values, (rows, places)), shape=shape))


def _constraints(state: CellState) -> tuple[Incidence | Adjacency, ...]:
    return (*state.incidences, *state.adjacencies)


def _boundary_size(brep: BRep, state: CellState, at: Incidence | Adjacency) -> int:
    return int(_boundary(brep, state, at.child, at.boundary).shape[1])


def _boundary(brep: BRep, state: CellState, child: int, boundary: int) -> Floats:
    return brep.states[state.children[child].state].boundaries[boundary].matrix


def _terms(
    brep: BRep, state: CellState, at: Incidence | Adjacency
) -> Iterator[tuple[int, Integers, Integers, Floats]]:
    # Both sides of a constraint as entries of C: child, controls, equations and weights.
    B = _boundary(brep, state, at.child, at.boundary)
    rows, places = np.nonzero(B)
    yield at.child, rows, places, B[rows, places]
    if isinstance(at, Adjacency):
        B = _boundary(brep, state, at.other, at.other_boundary)
        B = B[:, list(at.order)] if at.order else B
        rows, places = np.nonzero(B)
        yield at.other, rows, places, -B[rows, places]


def _parted(index: int, starts: Integers, columns: Integers, C: Any) -> System:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    C.sum_duplicates()
    C.eliminate_zeros()
    slots, width = C.shape
    count = np.diff(C.indptr)
    equation = np.repeat(np.arange(width), count)
    linked = equation[1:] == equation[:-1]
    links = C.indices[:-1][linked], C.indices[1:][linked]
    graph = coo_array((np.ones(len(links[0]), np.int8), links), shape=(slots, slots))
    amount, part = connected_components(graph, directed=False) if slots else (0, np.empty(0, int))
    part_of = np.full(width, -1)
    part_of[count > 0] = part[C.indices[C.indptr[:-1][count > 0]]]
    # One slot with weight 1 is a given point; two with weights 1 and −1 are one point.
    odd = np.bincount(equation, np.abs(C.data) != 1, minlength=width) > 0
    odd |= np.bincount(equation, C.data, minlength=width) != (count == 1)
    mixed = np.zeros(amount, bool)
    mixed[part_of[(odd | (count > 2)) & (count > 0)]] = True
    return System(index, starts, columns, C, part, part_of, mixed)


def right_side(brep: BRep, system: System, matrices: Matrices) -> Floats:
    """Return D (m, p): what incidences put is the boundaries' own subdivision; the rest is zero.

    ``matrices`` holds, for each boundary state, the matrices of its children.
    """
    state = brep.states[system.state]
    D = np.zeros((state.size, int(system.columns[-1])))
    for at, first in zip(state.incidences, system.columns.tolist(), strict=False):
        face = state.boundaries[at.face]
        points = face.matrix @ matrices[face.state][at.letter]
        points = points[:, list(at.order)] if at.order else points
        D[:, first : first + points.shape[1]] = points
    return D


# --- the nearest solution --------------------------------------------------------------------


def nearest_matrices(brep: BRep, system: System, wanted: Floats) -> Floats:
    """Return X (m, slots) with X·C = ``wanted`` nearest to the guesses, or raise ``ModelError``.

    X = G + (D − G·C)·C⁺; where all slots of a part are one point, that is the mean of its guesses
    or the place it is given. The error names a smallest set of constraints that contradict.
    """
    guess = _guess(brep.states[system.state])
    if not guess.size:
        return guess
    X = np.where(system.mixed[system.part], guess, _means(system.part, guess))
    _put_given(brep, system, wanted, X)
    for part in np.flatnonzero(system.mixed):
        _project(brep, system, wanted, X, int(part))
    return X


def _guess(state: CellState) -> Floats:
    guesses = [np.zeros((state.size, 0)), *(child.guess for child in state.children)]
    return summing_to(1.0, np.hstack(guesses))


def summing_to(total: float, columns: Floats) -> Floats:
    """Return columns that sum to ``total``; those that do up to rounding stay as they are.

    Decimals such as .333 + .666 are mended by their size: zeros stay zeros.
    """
    size = np.abs(columns).sum(axis=0)
    gap = total - columns.sum(axis=0)
    gap[np.abs(gap) <= 4 * np.finfo(float).eps * size] = 0
    return np.asarray(columns + np.abs(columns) * (gap / np.where(size > 0, size, 1)))


def _means(part: Integers, guess: Floats) -> Floats:
    from scipy.sparse import csr_array

    # Relative to each part's first slot, so that the mean of equal guesses is that guess.
    _, first, count = np.unique(part, return_index=True, return_counts=True)
    base = guess[:, first]
    shape = len(part), len(first)
    belongs = csr_array((np.ones(len(part)), (np.arange(len(part)), part)), shape=shape)
    shift = (belongs.T @ (guess - base[:, part]).T).T / count
    return np.asarray((base + shift)[:, part])


def _put_given(brep: BRep, system: System, wanted: Floats, X: Floats) -> None:
    given = np.flatnonzero((system.entries == 1) & ~system.mixed[system.part_of])
    part = system.part_of[given]
    parts, first = np.unique(part, return_index=True)
    which = np.full(len(system.mixed), -1)
    which[parts] = np.arange(len(parts))
    points = wanted[:, given[first]]
    bad = _differ(wanted[:, given], points[:, which[part]])
    if bad.any():
        chains = [_chain(system, wanted, int(p)) for p in np.unique(part[bad])]
        _contradict(brep, system, wanted, min(chains, key=len))
    slots = which[system.part] >= 0
    X[:, slots] = points[:, which[system.part[slots]]]


def _differ(a: Floats, b: Floats) -> NDArray[np.bool_]:
    size = np.maximum(1.0, np.abs(a).max(axis=0, initial=0.0))
    return np.asarray(np.abs(a - b).max(axis=0, initial=0.0) > CONTRADICTION * size)


def _project(brep: BRep, system: System, wanted: Floats, X: Floats, part: int) -> None:
    slots, equations = _members(system, part)
    C, D = _dense(system, slots, equations), wanted[:, equations]
    inverse = np.linalg.pinv(C, rcond=RANK)
    nearest = X[:, slots]
    for _ in range(2):  # the second time for what rounding left
        nearest = nearest + (D - nearest @ C) @ inverse
    if _differ(D, nearest @ C).any():
        _contradict(brep, system, wanted, equations.tolist())
    X[:, slots] = nearest


def _members(system: System, part: int) -> tuple[Integers, Integers]:
    return np.flatnonzero(system.part == part), np.flatnonzero(system.part_of == part)


def _dense(system: System, slots: Integers, equations: Integers) -> Floats:
    return np.asarray(system.C[:, equations].tocsr()[slots].toarray())


# --- contradictions --------------------------------------------------------------------------


def _chain(system: System, wanted: Floats, part: int) -> tuple[int, ...]:
    # The shortest chain of equations between two given points of one part that differ.
    links: dict[int, list[tuple[int, int]]] = {}
    given: dict[int, list[int]] = {}
    for equation in _members(system, part)[1].tolist():
        ends = system.ends(equation)
        for end in ends:
            links.setdefault(end, []).append((equation, ends[0] + ends[-1] - end))
        if len(ends) == 1:
            given.setdefault(ends[0], []).append(equation)
    starts = [(slot, equation) for slot, equations in given.items() for equation in equations]
    chains = (_search(slot, start, links, given, wanted) for slot, start in starts)
    return min((chain for chain in chains if chain), key=len)


def _search(
    slot: int,
    start: int,
    links: Mapping[int, list[tuple[int, int]]],
    given: Mapping[int, list[int]],
    wanted: Floats,
) -> tuple[int, ...]:
    chains: dict[int, tuple[int, ...]] = {slot: (start,)}
    front = [slot]
    for here in front:
        ends = np.array(given.get(here, []), int)
        bad = ends[_differ(wanted[:, [start]], wanted[:, ends])]
        if len(bad):
            return (*chains[here], int(bad[0]))
        for link, there in links[here]:
            if there not in chains:
                chains[there] = (*chains[here], link)
                front.append(there)
    return ()


def _contradict(brep: BRep, system: System, wanted: Floats, equations: Sequence[int]) -> None:
    # Always raises.
    def fails(owners: list[int]) -> bool:
        chosen = np.concatenate([np.arange(*system.columns[o : o + 2]) for o in owners])
        slots = np.unique(system.C[:, chosen].indices)
        C, D = _dense(system, slots, chosen), wanted[:, chosen]
        X = np.linalg.lstsq(C.T, D.T, rcond=RANK)[0]
        return bool(_differ(D, X.T @ C).any())

    owners = list(dict.fromkeys(system.owner(e) for e in equations))
    state = brep.states[system.state]
    names = [
        brep.text(system.state, _constraints(state)[owner])
        for owner in sorted(_irreducible(owners, fails))
    ]
    raise ModelError(
        f"state {state.name}: constraints contradict each other: {'; '.join(names)}; wanted the "
        "same place for a point whichever of them puts it there"
    )


def _irreducible(
    candidates: list[int], fails: Callable[[list[int]], bool], base: tuple[int, ...] = ()
) -> list[int]:
    """Return candidates that fail with ``base``, none of which can be spared (Junker 2004)."""
    if len(candidates) == 1:
        return candidates
    half = len(candidates) // 2
    left, right = candidates[:half], candidates[half:]

    def needed(part: list[int], other: list[int]) -> list[int]:
        known = [*base, *other]
        if other and fails(known):
            return []
        return _irreducible(part, fails, tuple(known))

    last = needed(right, left)
    return needed(left, last) + last


# --- what is free ----------------------------------------------------------------------------


def directions(system: System) -> Iterator[tuple[Integers, Floats]]:
    """Yield slots and values of a basis of the v with v·C = 0; each is 1 at its first slot."""
    fixed = np.zeros(len(system.mixed), bool)
    fixed[system.part_of[system.entries == 1]] = True
    order = np.argsort(system.part, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(system.part[order])) + 1)
    for part, slots in enumerate(groups):
        if system.mixed[part]:
            C = _dense(system, *_members(system, part))
            for vector in kernel(C):
                yield slots[vector != 0], vector[vector != 0]
        elif not fixed[part]:
            yield slots, np.ones(len(slots))


def kernel(C: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a basis (f, n) of the vectors v with v·C = 0, C (n, p).

    Each is 1 at its first place that is not zero, where all others are 0: Gaussian elimination
    from the last place to the first.
    """
    A = np.unique(C, axis=1).T[:, ::-1].copy()
    least = RANK * np.abs(A).max(initial=0.0)
    pivots: list[int] = []
    for column in range(A.shape[1]):
        row = len(pivots)
        if row == len(A):
            break
        best = row + int(np.abs(A[row:, column]).argmax())
        if abs(A[best, column]) > least:
            A[[row, best]] = A[[best, row]]
            A[row] /= A[row, column]
            others = np.arange(len(A)) != row
            A[others] -= np.outer(A[others, column], A[row])
            pivots.append(column)
    free = [column for column in range(A.shape[1]) if column not in pivots]
    result = np.zeros((len(free), A.shape[1]))
    result[np.arange(len(free)), free] = 1
    result[:, pivots] = -A[: len(pivots), free].T
    result[np.abs(result) < NOISE] = 0
    return np.asarray(result[::-1, ::-1])
