"""Weights of all cells of a state: affine maps of them, and intervals that hold them all.

All cells of a state lie in its space of weights, where the child's weights are affine images of the
parent's. In coordinates that make these maps block triangular, intervals that the maps keep hold
all weights: negative entries are welcome.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.models.adapted import (
    EPSILON,
    System,
    Turned,
    block_norms,
    growth,
    in_coordinates,
    least_fixed_point,
    subinvariant,
    turned,
    weight_system,
)
from porous.models.rational import positions

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from porous.models.automaton import Automaton

RATIOS = (0.9, 0.99, 0.999, 0.9999, 0.999999)
"""To which ratio the maps must contract for intervals to be found; tried in this order."""

MOST_WORDS = 10_000
"""Words are made longer until intervals are found, as long as there are no more of them."""

MOST_SKEW = 1e3
"""Positions serve as coordinates where they are no closer to dependent than this."""

SLACK = 1e-9
"""By which part of their size balls are blown up against rounding."""

SMALL = 1e-9
"""Positions are independent of what they depend on by less than this part."""

RIDGE = 1e-9
"""Which part of the largest variance counts as none."""

MOMENTS = 100
"""How many steps the second moments of the limit are followed."""

REFUSAL = (
    "the cells' weights do not shrink fast enough for bounds on them to be found; "
    "ask contractivity() which maps stretch, or make the texture smaller"
)


class Endless(NamedTuple):
    """The states with endless paths and the transitions between them.

    ``states`` are their indices in the automaton, ``drawn`` the weights (m, k) of what is drawn in
    their cells: their own controls and all that paths which end draw.
    """

    states: list[int]
    sizes: list[int]
    ends: list[tuple[int, int]]
    matrices: list[NDArray[np.float64]]
    drawn: list[NDArray[np.float64]]
    controls: list[NDArray[np.float64]]


class Weights(NamedTuple):
    """The maps y ↦ B·y + shift of weights, y = Y·(z − c), z all weights but the last.

    ``doubts`` (t, n) bound the errors of the shifts; ``centres`` and ``bases`` are the states' c
    and Y⁻¹, ``widths`` their dimensions. Per state, ``controls`` are y of the controls, ``drawn``
    of those that are drawn, ``points`` of some points of the limit. ``signed`` tells whether any
    weight is negative. Coordinates of one of the ``groups`` (s, n) are measured by |y|₂.
    """

    system: System
    shifts: NDArray[np.float64]
    doubts: NDArray[np.float64]
    centres: NDArray[np.float64]
    bases: NDArray[np.float64]
    controls: list[NDArray[np.float64]]
    drawn: list[NDArray[np.float64]]
    points: list[NDArray[np.float64]]
    signed: bool
    groups: NDArray[np.int64]

    @property
    def widths(self) -> NDArray[np.int64]:
        """Dimensions of the states' weights that sum to zero."""
        return self.system.widths


class Intervals(NamedTuple):
    """Bounds (s, n) on all y, and on the sum of weights that are negative, (s,).

    ``balls`` (s, g), where known, bound |y|₂ of each group of coordinates.
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    negative: NDArray[np.float64]
    balls: NDArray[np.float64] | None = None


def endless(
    automaton: Automaton, drawn: Mapping[int, Sequence[int] | None]
) -> tuple[Endless, list[NDArray[np.float64]]]:
    """Return the states with endless paths, and the weights of all that each state draws.

    The latter (m, k) are its own controls that are drawn and what paths that end draw; where it
    has endless paths there is more.

    Parameters
    ----------
    drawn
        Which controls of a state are drawn; all of them where a state is not named.
    """
    points = [_shown(state.size, drawn.get(q)) for q, state in enumerate(automaton.states)]
    left, open_ = list(automaton.transitions), set(range(len(points)))
    while closed := open_ - {t.source for t in left}:
        for t in left:
            if t.target in closed:
                points[t.source] = np.hstack([points[t.source], t.matrix @ points[t.target]])
        left = [t for t in left if t.target not in closed]
        open_ -= closed
    states = sorted(open_)
    number = {q: i for i, q in enumerate(states)}
    ends = [(number[t.source], number[t.target]) for t in left]
    sizes = [automaton.states[q].size for q in states]
    shown = [points[q] for q in states]
    controls = [positions(automaton.states[q].controls) for q in states]
    found = Endless(states, sizes, ends, [t.matrix for t in left], shown, controls)
    return found, points


def _shown(size: int, chosen: Sequence[int] | None) -> NDArray[np.float64]:
    unit = np.eye(size)
    return unit if chosen is None else unit[:, np.asarray(chosen, np.int64)]


def weights_of(part: Endless) -> Weights:
    """Return the maps of weights in adapted coordinates."""
    system, b = weight_system(part.ends, part.matrices, part.sizes)
    n = b.shape[1]
    corners = [np.vstack([np.eye(n)[: size - 1], np.zeros(n)]) for size in part.sizes]
    shown = [W.T @ z for W, z in zip(part.drawn, corners, strict=True)]
    centres = _means(system, b)
    moved = np.einsum("tij,tj->ti", system.matrices, centres[system.targets]) + b
    moved -= centres[system.sources]
    found = _upright(part, turned(system), moved)
    left = found.coordinates[system.sources]
    shifts = np.einsum("tij,tj->ti", left, moved)
    size = np.einsum("tij,tj->ti", np.abs(system.matrices), np.abs(centres[system.targets]))
    size += np.abs(b) + np.abs(centres[system.sources])
    doubts = (2 * n + 8) * EPSILON * np.einsum("tij,tj->ti", np.abs(left), size)
    turn = [
        [(z - c) @ Y.T for z, c, Y in zip(points, centres, found.coordinates, strict=True)]
        for points in (corners, shown)
    ]
    signed = any((W < 0).any() for W in (*part.matrices, *part.drawn))
    known = centres, found.bases, turn[0], turn[1]
    weights = Weights(found.system, shifts, doubts, *known, [], signed, found.groups)
    return weights._replace(points=_limit_points(weights))


def _upright(part: Endless, found: Turned, moved: NDArray[np.float64]) -> Turned:
    """Return coordinates that are block triangular still and make intervals tighter.

    The last ones, where they can, are the controls' positions; the others are rid of what is
    linear in later ones on average (the least squares of the limit's measure).
    """
    Y = found.coordinates.copy()
    seen = [_seen(controls, X) for controls, X in zip(part.controls, found.bases, strict=True)]
    placed = _reproduced(found.system, seen)
    for q, width in enumerate(found.original.widths):
        place = _ending(seen[q][:, :width]) if placed else _last(seen[q][:, :width])
        Y[q, :width] = place @ Y[q, :width]
    first = in_coordinates(found.original, Y, _singles(found))
    C = _moments(first, np.einsum("tij,tj->ti", Y[found.system.sources], moved))
    for q, width in enumerate(found.original.widths):
        Y[q, :width] = _decorrelation(C[q, :width, :width]) @ Y[q, :width]
    upright = in_coordinates(found.original, Y, _singles(found))
    return found if _contraction(upright.system) is None else upright


def _singles(found: Turned) -> NDArray[np.int64]:
    """Return every coordinate as a group of its own."""
    numbers = np.arange(found.groups.shape[1])
    return np.where(found.groups < 0, -1, numbers)


def _reproduced(system: System, seen: list[NDArray[np.float64]]) -> bool:
    """Tell whether positions of children follow from their parents' alone."""
    for q, r, B in zip(system.sources, system.targets, system.matrices, strict=True):
        rows = seen[q] @ B
        F = np.linalg.lstsq(seen[r].T, rows.T, rcond=SMALL)[0].T
        if np.abs(rows - F @ seen[r]).max() > SMALL * np.abs(seen[q]).max():
            return False
    return True


def _ending(seen: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the change to coordinates that end in the positions which are independent.

    They take the places where their echelon form begins, so that the others still depend on later
    ones alone.
    """
    rows, leads, used = seen.copy(), [], []
    size = max(float(np.abs(seen).max(initial=0.0)), 1e-300)
    for column in range(seen.shape[1]):
        left = [k for k in range(3) if k not in used]
        if not left:
            break
        k = max(left, key=lambda k: abs(rows[k, column]))
        if abs(rows[k, column]) > SMALL * size:
            leads.append(column)
            used.append(k)
            for other in left:
                if other != k:
                    rows[other] -= rows[k] * rows[other, column] / rows[k, column]
    others = np.delete(np.eye(seen.shape[1]), leads, axis=0)
    ends = seen[sorted(used)]
    return np.vstack([others, ends / np.linalg.norm(ends, axis=1, keepdims=True)])


def _last(seen: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the change of the last three coordinates to the positions' dependence on them."""
    change = np.eye(seen.shape[1])
    last = seen[:, -3:]
    size = np.linalg.norm(last, axis=1, keepdims=True)
    free = last.shape == (3, 3) and size.min() > SMALL * np.abs(seen).max()
    if free and np.linalg.cond(last / size) < MOST_SKEW:
        change[-3:, -3:] = last / size
    return change


def _contraction(system: System) -> tuple[NDArray[np.float64], float] | None:
    """Return x > 0 and λ < 1 with |B|·x ≤ λ·x, errors included, or None."""
    sizes = np.abs(system.matrices) + system.errors
    for ratio in RATIOS:
        x = subinvariant(system, sizes, ratio)
        found = 1.0 if x is None else growth(system, sizes, x)
        if x is not None and found < 1:
            return x, found
    return None


def _seen(controls: NDArray[np.float64], bases: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how positions (3, n) depend on the coordinates."""
    z = controls[:, :-1] - controls[:, -1:]
    return np.asarray(z @ bases[: z.shape[1]])


def _moments(found: Turned, shifts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the second moments of the limit's measure about the centres, (s, n, n), nearly."""
    sources, targets, B = found.system.sources, found.system.targets, found.system.matrices
    share = 1 / np.bincount(sources, minlength=len(found.bases))[sources]
    steps = share[:, None, None] * shifts[:, :, None] * shifts[:, None, :]
    C = np.zeros_like(found.bases)
    for _ in range(MOMENTS):
        images = share[:, None, None] * (B @ C[targets] @ B.transpose(0, 2, 1)) + steps
        C = np.zeros_like(C)
        np.add.at(C, sources, images)
    return C


def _decorrelation(C: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a unit upper triangle U such that U·C·Uᵀ is nearly diagonal.

    The last three coordinates, the positions, are left as they are.
    """
    U = np.eye(len(C))
    # What does not vary says nothing: the ridge keeps it out.
    ridged = C + RIDGE * max(float(np.diag(C).max(initial=0.0)), 1e-300) * np.eye(len(C))
    for i in range(len(C) - 3):
        U[i, i + 1 :] = -np.linalg.solve(ridged[i + 1 :, i + 1 :], C[i + 1 :, i])
    return U


def _means(system: System, b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean weights of each state's limit: c_q = mean of A_e·c_r + b_e."""
    count, n = len(system.widths), b.shape[1]
    share = 1 / np.bincount(system.sources, minlength=count)[system.sources]
    whole, right = np.eye(n * count).reshape(count, n, count, n), np.zeros((count, n))
    for q, r, A, shift, part in zip(
        system.sources, system.targets, system.matrices, b, share, strict=True
    ):
        whole[q, :, r] -= part * A
        right[q] += part * shift
    try:
        flat = np.linalg.solve(whole.reshape(n * count, n * count), right.ravel())
    except np.linalg.LinAlgError:
        raise ModelError(REFUSAL) from None
    return np.asarray(flat.reshape(count, n))


def _limit_points(weights: Weights) -> list[NDArray[np.float64]]:
    """Return points of every state's limit: ends of the paths that turn alike at every state."""
    system, (states, n) = weights.system, weights.centres.shape
    letters = [np.flatnonzero(system.sources == q) for q in range(states)]
    found = []
    for turn in range(max(map(len, letters))):
        whole, right = np.eye(states * n).reshape(states, n, states, n), np.zeros((states, n))
        for q in range(states):
            e = letters[q][turn % len(letters[q])]
            whole[q, :, system.targets[e]] -= system.matrices[e]
            right[q] = weights.shifts[e]
        flat = whole.reshape(states * n, states * n)
        if np.linalg.cond(flat) < MOST_SKEW**4:
            found.append(np.linalg.solve(flat, right.ravel()).reshape(states, n))
    points = np.array(found).reshape(-1, states, n)
    return [points[:, q] for q in range(states)]


def intervals(weights: Weights) -> Intervals:
    """Return intervals that hold what is drawn and that the maps, or their words, keep.

    Raises ``ModelError`` where none are found.
    """
    hulls = _hulls(weights.drawn, weights.shifts.shape[1])
    fans = np.bincount(weights.system.sources, minlength=len(weights.widths))
    words, base, balls, ratio = weights, hulls, None, 1.0
    while True:
        found = _kept(words, base)
        if found is not None:
            return Intervals(*found, negatives(weights, *found))
        wider = _balls(words, base)
        if wider is not None and wider[1] < ratio:
            balls, ratio = wider
        if ratio <= RATIOS[0] or fans[words.system.targets].sum() > MOST_WORDS:
            break
        base = _joined(base, words, hulls)
        words = _longer_words(words, weights)
    if balls is None:
        raise ModelError(REFUSAL)
    return _shrunk(weights, hulls, balls)


def negatives(
    weights: Weights, lower: NDArray[np.float64], upper: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return bounds (s,) on the sum of negative weights where y lies in intervals."""
    result = np.zeros(len(lower))
    if not weights.signed:
        return result
    middle, half = (lower + upper) / 2, (upper - lower) / 2
    half = half + 1e-12 * np.maximum(np.abs(lower), np.abs(upper))
    for q, width in enumerate(weights.widths):
        X = weights.bases[q][:width]
        rows = np.vstack([X, -X.sum(axis=0)])
        centre = weights.centres[q][:width]
        value = np.append(centre, 1 - centre.sum()) + rows @ middle[q]
        result[q] = np.maximum(np.abs(rows) @ half[q] - value, 0).sum() * (1 + 1e-9)
    return result


def _balls(
    weights: Weights, base: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> tuple[NDArray[np.float64], float] | None:
    """Return bounds (s, g) on |y|₂ of the groups of coordinates, and λ, or None.

    R_q = max(base, max_e(|shift_e| + λ_e·R_r)) in the norm max |y_g|/x_g of the groups g.
    """
    system, groups = weights.system, weights.groups
    norms = block_norms(system, groups)
    for ratio in RATIOS:
        x = subinvariant(system, norms, ratio)
        if x is None:
            continue
        images = np.einsum("tgh,th->tg", norms, x[system.targets]) / x[system.sources]
        reach = group_sizes(np.abs(weights.shifts) + weights.doubts, groups[system.sources])
        steps = (reach / x[system.sources]).max(axis=1) * (1 + 1e-9)
        first = group_sizes(np.maximum(np.abs(base[0]), np.abs(base[1])), groups) / x
        shrink = images.max(axis=1)[:, None, None] * (1 + 1e-12)
        R = least_fixed_point(system, shrink, steps[:, None], first.max(axis=1)[:, None])
        return None if R is None else (R * (1 + SLACK) * x, float(images.max()))
    return None


def group_sizes(rows: NDArray[np.float64], groups: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return |·|₂ of each group of coordinates, (k, g), of rows (k, n) of states (k, n)."""
    numbers = np.arange(int(groups.max(initial=0)) + 1)
    squares = (rows[:, :, None] ** 2 * (groups[:, :, None] == numbers)).sum(axis=1)
    return np.asarray(np.sqrt(squares))


def _shrunk(
    weights: Weights,
    base: tuple[NDArray[np.float64], NDArray[np.float64]],
    balls: NDArray[np.float64],
) -> Intervals:
    """Return intervals about balls, cut down to their images as long as that helps."""
    width = np.take_along_axis(balls, np.maximum(weights.groups, 0), axis=1)
    upper = np.where(weights.groups < 0, 0.0, width)
    lower = -upper
    for _ in range(MOMENTS):
        known = _joined(base, weights, (lower, upper))
        lower, upper = np.maximum(lower, known[0]), np.minimum(upper, known[1])
    return Intervals(lower, upper, negatives(weights, lower, upper), balls)


def _hulls(
    points: list[NDArray[np.float64]], n: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least intervals about points, the centre included (it lies in their hull)."""
    lower = [np.vstack([p, np.zeros((1, n))]).min(axis=0) for p in points]
    upper = [np.vstack([p, np.zeros((1, n))]).max(axis=0) for p in points]
    size = 1e-14 * max(1.0, float(np.abs([lower, upper]).max()))
    return np.array(lower) - size, np.array(upper) + size


def _kept(
    words: Weights, base: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return the least intervals that hold the base and that the words keep, a little larger.

    With v = (upper, −lower) intervals are images under matrices that are nowhere negative; what
    rounding leaves over is paid for along x > 0 with |B|·x ≤ λ·x, λ < 1.
    """
    system, n = words.system, words.shifts.shape[1]
    sizes = np.abs(system.matrices) + system.errors
    known = _contraction(system)
    if known is None:
        return None
    x, ratio = known
    plus, minus = np.maximum(system.matrices, 0), np.maximum(-system.matrices, 0)
    doubled = np.block([[plus, minus], [minus, plus]])
    constants = np.hstack([words.shifts, -words.shifts])
    start = np.hstack([base[1], -base[0]])
    v = least_fixed_point(system, doubled, constants, start)
    if v is None:
        return None
    doubts = words.doubts + np.einsum("tij,tj->ti", system.errors, _reach(v, n)[system.targets])
    doubts += 64 * n * EPSILON * np.einsum("tij,tj->ti", sizes, _reach(v, n)[system.targets])
    images = np.einsum("tij,tj->ti", doubled, v[system.targets]) + constants
    images += np.hstack([doubts, doubts])
    twice = np.hstack([x, x])
    over = max(
        float(((images - v[system.sources]) / twice[system.sources]).max()),
        float(((start - v) / twice).max()),
        0.0,
    )
    v = v + 2 * over / (1 - ratio) * twice
    return -v[:, n:], v[:, :n]


def _reach(v: NDArray[np.float64], n: int) -> NDArray[np.float64]:
    return np.maximum(np.abs(v[:, :n]), np.abs(v[:, n:]))


def _joined(
    base: tuple[NDArray[np.float64], NDArray[np.float64]],
    words: Weights,
    drawn: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the base with the words' images of what is drawn."""
    sources, targets = words.system.sources, words.system.targets
    middle, half = (drawn[0] + drawn[1]) / 2, (drawn[1] - drawn[0]) / 2
    centre = np.einsum("tij,tj->ti", words.system.matrices, middle[targets]) + words.shifts
    sizes = np.abs(words.system.matrices) + words.system.errors * (1 + 1e-9)
    reach = np.einsum("tij,tj->ti", sizes, half[targets]) + words.doubts
    reach += np.einsum("tij,tj->ti", words.system.errors, np.abs(middle[targets]))
    reach = reach * (1 + 1e-12) + 1e-14 * np.abs(centre)
    lower, upper = base[0].copy(), base[1].copy()
    np.minimum.at(lower, sources, centre - reach)
    np.maximum.at(upper, sources, centre + reach)
    return lower, upper


def _longer_words(words: Weights, letters: Weights) -> Weights:
    """Return the words one letter longer, errors bounded."""
    one, other = words.system, letters.system
    i, j = np.nonzero(one.targets[:, None] == other.sources[None, :])
    A, B = one.matrices[i], other.matrices[j]
    n = A.shape[1]
    errors = (np.abs(A) + one.errors[i]) @ (
        other.errors[j] + (n + 2) * EPSILON * np.abs(B)
    ) + one.errors[i] @ np.abs(B)
    shifts = words.shifts[i] + np.einsum("tij,tj->ti", A, letters.shifts[j])
    sizes = np.abs(A) + one.errors[i]
    known = letters.doubts[j] + (n + 4) * EPSILON * np.abs(letters.shifts[j])
    doubts = words.doubts[i] + np.einsum("tij,tj->ti", sizes, known)
    doubts += np.einsum("tij,tj->ti", one.errors[i], np.abs(letters.shifts[j]))
    doubts += 4 * EPSILON * np.abs(words.shifts[i])
    system = System(one.sources[i], other.targets[j], A @ B, errors, one.widths)
    return words._replace(system=system, shifts=shifts, doubts=doubts)
