"""Balls and boxes that are certain to hold an automaton's sets.

``Seeds`` are what is drawn in every cell: with seeds the set that is enclosed is the union of all
prefractals and of the attractor, U = K₀ ∪ F(U); without, it is the attractor alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.models.adapted import adapted_norms
from porous.models.automaton import DEEPEST, Automaton, Transition, reachable
from porous.models.control_box import control_box
from porous.values import Box
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from numpy.typing import NDArray

SLACK = 1e-9
"""By which part of their size balls are blown up against rounding."""

SHRUNK = 0.9
"""A word's map must shrink at least to this to carry a ball."""

COARSE = 0.01
"""How much too large the boxes of weights' images may be, relative to the controls' extent."""

MOST_WORDS = 20_000
"""How many words a search may hold."""


@dataclass(frozen=True, eq=False)
class Seeds(Value):
    """Points (n, 3) of every cell in its state's reference coordinates, or balls about them."""

    points: NDArray[np.float64]
    radius: float = 0.0

    def __post_init__(self) -> None:
        self._set("points", frozen(self.points, np.float64))

    @property
    def box(self) -> Box:
        """The tight box of the seeds."""
        return Box.of_points(self.points).grown(self.radius)


class _Words(NamedTuple):
    """Words of maps by their ends, and their maps: source ← target, A (k, 3, 3), b (k, 3)."""

    sources: NDArray[np.int64]
    targets: NDArray[np.int64]
    A: NDArray[np.float64]
    b: NDArray[np.float64]


class _Enclosure(NamedTuple):
    """Per state: an ellipsoid |Lᵀ(x − c)| ≤ R and a box, both holding the state's set."""

    inverses: NDArray[np.float64]
    centres: NDArray[np.float64]
    radii: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]


def enclosing_balls(automaton: Automaton, seeds: Seeds | None = None) -> NDArray[np.float64]:
    """Return a ball (x, y, z, radius) per state, (s, 4), that holds that state's set.

    Hart & DeFanti 1991, Rice 1996: a ball that every map sends into itself holds the attractor.
    Its radius is convex in its centre; for one state it is minimised, for several the centres are
    the means of the invariant measures. Where maps stretch, words that shrink take their place, in
    the adapted norm where that needs fewer. Where states are no frames of space, terminal ones or
    others, the balls are those about the boxes of their weights' images (``control_box``).

    Raises
    ------
    ModelError
        Where the maps shrink too slowly for the search, or seeds are asked for without frames.
    """
    if seeds is None and not automaton.spatial:
        return np.array([_ball_of_weights(automaton, q) for q in range(len(automaton.states))])
    found = _boxed(automaton, seeds, _ellipsoids(automaton, seeds))
    widest = np.linalg.norm(found.inverses, 2, axis=(1, 2)) * found.radii * (1 + SLACK)
    about = np.linalg.norm(found.upper - found.lower, axis=1) / 2 * (1 + SLACK)
    # The ball about the box is the better one where the ellipsoid is long.
    rounder = (widest <= about)[:, None]
    centres = np.where(rounder, found.centres, (found.lower + found.upper) / 2)
    return np.hstack([centres, np.minimum(widest, about)[:, None]])


def enclosing_box(automaton: Automaton, seeds: Seeds | None = None, *, tolerance: float) -> Box:
    """Return a box that holds the start state's set, each face at most ``tolerance`` too far out.

    Branch and bound along the six directions: a word's upper bound is the support of the image of
    its state's enclosure, lower bounds come from points of the set. Where more than ``MOST_WORDS``
    words stay open the search ends early: the box is looser but still holds the set.
    """
    enclosure = _boxed(automaton, seeds, _ellipsoids(automaton, seeds))
    inner = [_inner(automaton, seeds, state) for state in range(len(automaton.states))]
    axes = np.eye(3)
    upper = [_support(automaton, enclosure, inner, axes[k], tolerance) for k in range(3)]
    lower = [-_support(automaton, enclosure, inner, -axes[k], tolerance) for k in range(3)]
    return Box(tuple(lower), tuple(upper))  # type: ignore[arg-type]


def invariant_box(automaton: Automaton, box: Box, *, tolerance: float = 1e-12) -> bool:
    """Tell whether every map sends ``box`` (of every state's reference space) into itself."""
    corners = np.array(box.corners)
    slack = tolerance * max(box.lengths)
    lower, upper = np.array(box.lower) - slack, np.array(box.upper) + slack
    images = np.einsum("tij,cj->tci", automaton.maps[:, :, :3], corners)
    images += automaton.maps[:, None, :, 3]
    return bool((images >= lower).all() and (images <= upper).all())


def orbit_box(automaton: Automaton, seeds: Seeds, *, tolerance: float) -> Box:
    """Return a box of all prefractals and the attractor: the seeds' own where maps keep it."""
    if invariant_box(automaton, seeds.box):
        return seeds.box
    return enclosing_box(automaton, seeds, tolerance=tolerance)


def _ball_of_weights(automaton: Automaton, state: int) -> tuple[float, float, float, float]:
    """Return a ball about a certified box of one state's set."""
    chosen = sorted(reachable(automaton, state))
    controls = automaton.states[state].controls
    if chosen == [state] and not automaton.children[state]:
        box = Box.of_points(controls.T)
    else:
        moves = tuple(
            Transition(chosen.index(t.source), chosen.index(t.target), t.matrix)
            for t in automaton.transitions
            if t.source in chosen
        )
        states = tuple(automaton.states[q] for q in chosen)
        part = Automaton(states, moves, chosen.index(state))
        silent = {q: () for q, children in enumerate(part.children) if children}
        size = max(float(np.ptp(controls, axis=1).max()), 1e-300)
        box = control_box(part, tolerance=COARSE * size, drawn=silent)
    x, y, z = box.centre
    radius = float(np.linalg.norm(np.subtract(box.upper, box.lower))) / 2
    return x, y, z, radius * (1 + SLACK) + SLACK * 1e-3


def _ellipsoids(automaton: Automaton, seeds: Seeds | None) -> _Enclosure:
    ends = np.array([(t.source, t.target) for t in automaton.transitions]).T
    A, b = automaton.maps[:, :, :3], automaton.maps[:, :, 3]
    bases = np.tile(np.eye(3), (len(automaton.states), 1, 1))
    if np.linalg.norm(A, 2, axis=(1, 2)).max() > SHRUNK:
        adapted = adapted_norms(ends[0], ends[1], A)
        if adapted is not None and len(adapted) == len(bases):
            bases = adapted
    inverses = np.asarray(np.linalg.inv(bases).transpose(0, 2, 1), np.float64)
    single = _Words(ends[0], ends[1], A, b)
    words, prefixes = _shrinking_words(automaton, single, bases, inverses)
    fixed = _fixed_sets(automaton, seeds, prefixes)
    centres = _mean_points(automaton, fixed)
    norms = _norms(words, bases, inverses, fixed)
    if len(centres) == 1:
        centres = _best_centre(words, norms, fixed, centres)
    radii = _radii(words, norms, fixed, centres)
    nothing = np.full_like(centres, np.inf)
    return _Enclosure(inverses, centres, radii, -nothing, nothing)


def _shrinking_words(
    automaton: Automaton,
    single: _Words,
    bases: NDArray[np.float64],
    inverses: NDArray[np.float64],
) -> tuple[_Words, _Words]:
    """Return for every state the shortest words that shrink to SHRUNK, and their prefixes.

    The words of a state are a cut set: its set is the union of their images. Prefixes are what
    lies above: where seeds are drawn as well; the empty words come first.
    """
    states = np.arange(len(automaton.states))
    empty = _Words(
        states, states, np.tile(np.eye(3), (len(states), 1, 1)), np.zeros((len(states), 3))
    )
    done, above, front = [], [empty], empty
    total = 0
    many = max(len(children) for children in automaton.children)
    while len(front.sources):
        total += len(front.sources) * many
        if total > MOST_WORDS + len(single.sources):
            raise ModelError(
                "the maps contract so slowly together that no enclosure of the attractor was "
                f"found among {MOST_WORDS} words; scale them down"
            )
        front = _extended(front, single)
        left, right = bases.transpose(0, 2, 1)[front.sources], inverses[front.targets]
        short = np.linalg.norm(left @ front.A @ right, 2, axis=(1, 2)) <= SHRUNK
        done.append(_Words(*(field[short] for field in front)))
        front = _Words(*(field[~short] for field in front))
        above.append(front)
    return _joined(done), _joined(above)


def _extended(words: _Words, single: _Words) -> _Words:
    i, j = np.nonzero(words.targets[:, None] == single.sources[None, :])
    A = words.A[i] @ single.A[j]
    b = np.einsum("kij,kj->ki", words.A[i], single.b[j]) + words.b[i]
    return _Words(words.sources[i], single.targets[j], A, b)


def _joined(parts: list[_Words]) -> _Words:
    return _Words(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))


class _Fixed(NamedTuple):
    """Points (n, 3) that a state's set must hold, and the images of the unit ball about them.

    The latter as matrices (n, 3, 3).
    """

    points: NDArray[np.float64]
    around: NDArray[np.float64]


def _fixed_sets(automaton: Automaton, seeds: Seeds | None, prefixes: _Words) -> list[_Fixed]:
    result = []
    for state in range(len(automaton.states)):
        rows = np.flatnonzero(prefixes.sources == state)
        if seeds is None:
            rows = rows[[not automaton.children[prefixes.targets[row]] for row in rows]]
        points, radius = _drawn(automaton, seeds, state)
        images = np.einsum("wij,nj->wni", prefixes.A[rows], points)
        images += prefixes.b[rows][:, None]
        around = np.repeat(prefixes.A[rows] * radius, len(points), axis=0)
        result.append(_Fixed(images.reshape(-1, 3), around))
    return result


def _drawn(
    automaton: Automaton, seeds: Seeds | None, state: int
) -> tuple[NDArray[np.float64], float]:
    if seeds is None:
        return automaton.states[state].controls.T, 0.0
    return seeds.points, seeds.radius


def _mean_points(automaton: Automaton, fixed: list[_Fixed]) -> NDArray[np.float64]:
    """Return the mean of each state's invariant measure: c_q = mean of A_e c_r + b_e."""
    size = 3 * len(automaton.states)
    system, right = np.eye(size), np.zeros(size)
    for q, children in enumerate(automaton.children):
        here = slice(3 * q, 3 * q + 3)
        if not children:
            points = fixed[q].points
            right[here] = points.mean(axis=0) if len(points) else 0.0
    for t, F in zip(automaton.transitions, automaton.maps, strict=True):
        weight = 1 / len(automaton.children[t.source])
        here = slice(3 * t.source, 3 * t.source + 3)
        system[here, 3 * t.target : 3 * t.target + 3] -= weight * F[:, :3]
        right[here] += weight * F[:, 3]
    return np.asarray(np.linalg.solve(system, right)).reshape(-1, 3)


class _Norms(NamedTuple):
    """What radii are made of, wherever centres are.

    ``bases`` (s, 3, 3) of the norms of states, those of the words' ``sources`` (k, 3, 3)
    transposed; how far words ``shrink``, (k,); how ``wide`` a state's drawn balls are, (n,) each.
    """

    bases: NDArray[np.float64]
    sources: NDArray[np.float64]
    shrink: NDArray[np.float64]
    wide: list[NDArray[np.float64]]


def _norms(
    words: _Words,
    bases: NDArray[np.float64],
    inverses: NDArray[np.float64],
    fixed: list[_Fixed],
) -> _Norms:
    transposed = bases.transpose(0, 2, 1)
    sources = transposed[words.sources]
    shrink = np.linalg.norm(sources @ words.A @ inverses[words.targets], 2, axis=(1, 2))
    wide = [np.linalg.norm(transposed[q] @ own.around, 2, (1, 2)) for q, own in enumerate(fixed)]
    return _Norms(bases, sources, shrink, wide)


def _best_centre(
    words: _Words, norms: _Norms, fixed: list[_Fixed], start: NDArray[np.float64]
) -> NDArray[np.float64]:
    from scipy.optimize import minimize

    def radius(centre: NDArray[np.float64]) -> float:
        return float(_radii(words, norms, fixed, centre.reshape(1, 3))[0])

    spread = max(radius(start[0]), 1e-12)
    simplex = start[0] + spread * 0.2 * np.vstack([np.zeros(3), np.eye(3)])
    options = {"initial_simplex": simplex, "maxiter": 300, "xatol": 1e-6 * spread, "fatol": 0}
    found = minimize(radius, start[0], method="Nelder-Mead", options=options)
    return np.asarray(found.x if found.fun <= radius(start[0]) else start[0]).reshape(1, 3)


def _radii(
    words: _Words, norms: _Norms, fixed: list[_Fixed], centres: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the radii for which every word sends the target's ellipsoid into the source's."""
    reach = np.zeros(len(centres))
    for q, (points, _) in enumerate(fixed):
        if len(points):
            distances = np.linalg.norm((points - centres[q]) @ norms.bases[q], axis=1)
            reach[q] = (distances + norms.wide[q]).max()
    if not len(words.sources):
        return reach * (1 + SLACK) + SLACK * 1e-3
    images = np.einsum("kij,kj->ki", words.A, centres[words.targets]) + words.b
    shifts = np.einsum("kij,kj->ki", norms.sources, images - centres[words.sources])
    return _least(words, norms.shrink, np.linalg.norm(shifts, axis=1), reach)


def _least(
    words: _Words,
    shrink: NDArray[np.float64],
    shift: NDArray[np.float64],
    reach: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return R_q ≥ reach_q with R_q ≥ shift + shrink·R_r for all words, from below."""
    if len(reach) == 1:
        least = np.maximum(reach, (shift / (1 - shrink)).max(keepdims=True))
        return np.asarray(least * (1 + SLACK) + 1e-12)
    radii = reach
    while True:
        wanted = reach.copy()
        np.maximum.at(wanted, words.sources, shift + shrink * radii[words.targets])
        if (wanted <= radii * (1 + 1e-12)).all():
            return np.asarray(radii * (1 + SLACK) + 1e-12)
        radii = np.maximum(radii, wanted)


def _boxed(automaton: Automaton, seeds: Seeds | None, found: _Enclosure) -> _Enclosure:
    """Add boxes: shrunk by F as long as that helps, and certain at every step."""
    lower, upper = _ellipsoid_boxes(found)
    scale = (upper - lower).max()
    ends = np.array([(t.source, t.target) for t in automaton.transitions]).T
    A, b = automaton.maps[:, :, :3], automaton.maps[:, :, 3]
    absolute = np.abs(A)
    for _ in range(200):
        middle, half = (lower + upper) / 2, (upper - lower) / 2
        centre = np.einsum("tij,tj->ti", A, middle[ends[1]]) + b
        reach = np.einsum("tij,tj->ti", absolute, half[ends[1]])
        least, most = _drawn_boxes(automaton, seeds)
        np.minimum.at(least, ends[0], centre - reach - 1e-13 * scale)
        np.maximum.at(most, ends[0], centre + reach + 1e-13 * scale)
        least, most = np.maximum(lower, least), np.minimum(upper, most)
        gain = max((least - lower).max(), (upper - most).max())
        lower, upper = least, most
        if gain <= 1e-12 * scale:
            break
    return found._replace(lower=lower, upper=upper)


def _ellipsoid_boxes(found: _Enclosure) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    half = np.linalg.norm(found.inverses, axis=2) * found.radii[:, None]
    return found.centres - half, found.centres + half


def _drawn_boxes(
    automaton: Automaton, seeds: Seeds | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    least = np.full((len(automaton.states), 3), np.inf)
    for q, children in enumerate(automaton.children):
        if seeds is not None or not children:
            points, radius = _drawn(automaton, seeds, q)
            least[q] = points.min(axis=0) - radius
    most = np.full_like(least, -np.inf)
    for q, children in enumerate(automaton.children):
        if seeds is not None or not children:
            points, radius = _drawn(automaton, seeds, q)
            most[q] = points.max(axis=0) + radius
    return least, most


class _Inner(NamedTuple):
    """Points of a state's set (n, 3), and the radii of the balls about them that lie in it."""

    points: NDArray[np.float64]
    radii: NDArray[np.float64]

    def supports(self, a: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return max a·x over these balls for each row of ``a`` (k, 3)."""
        lengths = np.linalg.norm(a, axis=1)
        return np.asarray((a @ self.points.T + lengths[:, None] * self.radii).max(axis=1))


def _inner(automaton: Automaton, seeds: Seeds | None, state: int) -> _Inner:
    """Return what is drawn in a state and the ends of periodic paths."""
    children = automaton.children[state]
    points, radius = _drawn(automaton, seeds, state)
    if seeds is None and children:
        points = points[:0]
    ends = [
        np.linalg.solve(np.eye(3) - F[:, :3], F[:, 3])
        for t, F in zip(automaton.transitions, automaton.maps, strict=True)
        if t.source == t.target == state
    ] or [_cycle_point(automaton, state, seeds)]
    radii = np.concatenate([np.full(len(points), radius), np.zeros(len(ends))])
    return _Inner(np.vstack([points, *ends]), radii)


def _cycle_point(automaton: Automaton, state: int, seeds: Seeds | None) -> NDArray[np.float64]:
    """Return the point that the path of first children leads to."""
    trail: list[int] = []
    F = np.eye(4)
    steps = []
    while state not in trail and automaton.children[state]:
        trail.append(state)
        steps.append(np.eye(4))
        first = automaton.children[state][0]
        index = next(i for i, t in enumerate(automaton.transitions) if t is first)
        steps[-1][:3] = automaton.maps[index]
        state = first.target
    if not automaton.children[state]:
        end = _drawn(automaton, seeds, state)[0][0]
    else:
        loop = np.linalg.multi_dot([np.eye(4), *steps[trail.index(state) :], np.eye(4)])
        end = np.linalg.solve(np.eye(3) - loop[:3, :3], loop[:3, 3])
        steps = steps[: trail.index(state)]
    for step in steps:
        F = F @ step
    return np.asarray(F[:3, :3] @ end + F[:3, 3])


class _Rows(NamedTuple):
    """Functionals a·x + offset on the sets of states, one for each word: the images' supports."""

    states: NDArray[np.int64]
    a: NDArray[np.float64]
    offsets: NDArray[np.float64]
    bounds: NDArray[np.float64]


def _support(
    automaton: Automaton,
    enclosure: _Enclosure,
    inner: list[_Inner],
    direction: NDArray[np.float64],
    tolerance: float,
) -> float:
    """Return a bound on max u·x over the start state's set, at most ``tolerance`` too large.

    Words whose image reaches no further than ``tolerance`` beyond a known point are settled, the
    others are made longer.
    """
    start = np.array([automaton.start])
    rows = _bounded(enclosure, start, direction[None], np.zeros(1), np.array([np.inf]))
    best, settled = -np.inf, -np.inf
    many = max(len(children) for children in automaton.children)
    for _ in range(DEEPEST):
        reached = _reached(inner, rows)
        best = max(best, reached.max())
        ends = np.array([not children for children in automaton.children])[rows.states]
        done = ends | (rows.bounds <= best + tolerance)
        # A terminal cell is what is drawn there: its support is known.
        settled = max(settled, np.where(ends, reached, rows.bounds)[done].max(initial=-np.inf))
        rows = _Rows(rows.states[~done], rows.a[~done], rows.offsets[~done], rows.bounds[~done])
        if not 0 < len(rows.bounds) * many <= MOST_WORDS * 10:
            break
        rows = _longer(automaton, enclosure, rows)
    scale = float(np.abs([enclosure.lower, enclosure.upper]).max())
    return float(max(best, settled, rows.bounds.max(initial=-np.inf))) + 1e-12 * scale


def _reached(inner: list[_Inner], rows: _Rows) -> NDArray[np.float64]:
    result = np.empty(len(rows.states))
    for state, known in enumerate(inner):
        mine = rows.states == state
        result[mine] = known.supports(rows.a[mine])
    return result + rows.offsets


def _longer(automaton: Automaton, enclosure: _Enclosure, rows: _Rows) -> _Rows:
    sources, targets = np.array([(t.source, t.target) for t in automaton.transitions]).T
    i, j = np.nonzero(rows.states[:, None] == sources[None, :])
    F = automaton.maps[j]
    a = np.einsum("ki,kij->kj", rows.a[i], F[:, :, :3])
    offsets = rows.offsets[i] + np.einsum("ki,ki->k", rows.a[i], F[:, :, 3])
    return _bounded(enclosure, targets[j], a, offsets, rows.bounds[i])


def _bounded(
    enclosure: _Enclosure,
    states: NDArray[np.int64],
    a: NDArray[np.float64],
    offsets: NDArray[np.float64],
    most: NDArray[np.float64],
) -> _Rows:
    across = np.einsum("kji,kj->ki", enclosure.inverses[states], a)
    reach = np.linalg.norm(across, axis=1) * enclosure.radii[states]
    ball = np.einsum("ki,ki->k", a, enclosure.centres[states]) + reach
    corner = np.where(a > 0, enclosure.upper[states], enclosure.lower[states])
    box = np.einsum("ki,ki->k", a, corner)
    return _Rows(states, a, offsets, np.minimum(offsets + np.minimum(ball, box), most))
