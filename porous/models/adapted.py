"""Norms that suit matrices which act together: ellipsoids, and flags stretched group by group.

Any coordinates y = Y·x with Y invertible make |Y·x| a norm. What is computed here is how large the
matrices are in it, with bounds on every rounding error: good coordinates give good bounds, bad ones
only poor bounds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.models.flags import flag

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from porous.models.flags import Flag

EPSILON = float(np.finfo(float).eps)

LARGEST_KRONECKER = 12
"""With more coordinates in all states the ellipsoids come from iterations."""

ROUNDS = 40
"""How many of its steps are made, …"""

WEIGHTINGS = 10
"""… and for how many weightings of the matrices."""

POLICIES = 60
"""How often rows may choose anew."""

STEPS = (1e-6, 1e-4, 1e-3, 1e-2, 0.03, 0.1, 0.3, 0.6, 0.9)
"""Where between a lower bound on the joint spectral radius and one norms are tried."""


class System(NamedTuple):
    """Matrices (t, n, n) from the space of a target state to a source's, padded with zeros.

    ``errors`` (t, n, n) bound how far the matrices are from what they stand for; ``widths`` (s,)
    are the states' dimensions.
    """

    sources: NDArray[np.int64]
    targets: NDArray[np.int64]
    matrices: NDArray[np.float64]
    errors: NDArray[np.float64]
    widths: NDArray[np.int64]


class Turned(NamedTuple):
    """A system in other coordinates y = Y·x; ``bases`` (s, n, n) is the inverse X, nearly.

    Entry by entry |Y⁻¹ − X| ≤ |X|·defects.
    """

    original: System
    system: System
    coordinates: NDArray[np.float64]
    bases: NDArray[np.float64]
    defects: NDArray[np.float64]
    groups: NDArray[np.int64]


def weight_system(
    ends: Sequence[tuple[int, int]], matrices: Sequence[NDArray[np.float64]], sizes: Sequence[int]
) -> tuple[System, NDArray[np.float64]]:
    """Return the maps z ↦ A·z + b of weights whose sum is one, z all of them but the last.

    Parameters
    ----------
    ends
        Source and target of each transition.
    matrices
        Of weights, (m_source, m_target).
    sizes
        How many weights there are in each state.
    """
    widths = np.array(sizes) - 1
    n, count = max(1, int(widths.max())), len(matrices)
    A, errors, b = np.zeros((count, n, n)), np.zeros((count, n, n)), np.zeros((count, n))
    for i, ((q, r), T) in enumerate(zip(ends, matrices, strict=True)):
        here = i, slice(widths[q]), slice(widths[r])
        A[here] = T[:-1, :-1] - T[:-1, -1:]
        errors[here] = EPSILON * (np.abs(T[:-1, :-1]) + np.abs(T[:-1, -1:]))
        b[i, : widths[q]] = T[:-1, -1]
    sources, targets = np.array(ends).T
    return System(sources, targets, A, errors, widths), b


def turned(system: System) -> Turned:
    """Return the system in coordinates that make it block triangular, blocks in ellipsoid norms."""
    found = flag(system.sources, system.targets, system.matrices, system.widths)
    bases = found.bases.copy()
    inverses = np.linalg.inv(bases)
    rough = inverses[system.sources] @ system.matrices @ bases[system.targets]
    for number in range(int(found.groups.max(initial=-1)) + 1):
        _round_off(bases, found, number, system, rough)
    return in_coordinates(system, np.asarray(np.linalg.inv(bases), np.float64), found.groups)


def in_coordinates(
    system: System, coordinates: NDArray[np.float64], groups: NDArray[np.int64]
) -> Turned:
    """Return the system in coordinates Y (s, n, n), with bounds on what rounding does.

    With X ≈ Y⁻¹ and F = YX − 1, YAY⁻¹ = YAX·(1 + F)⁻¹: entry by entry |YAY⁻¹ − YAX| is at most
    |YAX|·|G|, |G| ≤ |F| + n·max|F|²·(1 + …).
    """
    n = coordinates.shape[1]
    bases = np.asarray(np.linalg.inv(coordinates))
    left, right = coordinates[system.sources], bases[system.targets]
    matrices = left @ system.matrices @ right
    doubt = (2 * n + 8) * EPSILON * (np.abs(left) @ np.abs(system.matrices) @ np.abs(right))
    doubt += np.abs(left) @ system.errors @ np.abs(right) * (1 + 1e-9)
    F = np.abs(coordinates @ bases - np.eye(n))
    F += (n + 4) * EPSILON * (np.abs(coordinates) @ np.abs(bases))
    F += 2 * n * F.max(axis=(1, 2), keepdims=True) ** 2
    doubt += (np.abs(matrices) + doubt) @ F[system.targets] * (1 + 1e-9)
    kept = system._replace(matrices=matrices, errors=doubt)
    return Turned(system, kept, coordinates, bases, F, groups)


def stretched(turned: Turned, lower: float) -> tuple[float, System]:
    """Return a bound on the joint spectral radius and the system in the norm that gives it.

    The norm is max |y_g|/x_g over the groups g: groups are stretched such that the triangle's outer
    blocks become small. x > 0 solves max_e |A_e|·x ≤ λ·x for the norms |A_e| of the blocks; where
    all groups have one dimension it is the norm of row sums in the system returned. ``lower``
    says where to look for λ.
    """
    norms = block_norms(turned.system, turned.groups)
    best, found = np.inf, turned.system
    for step in STEPS:
        weights = subinvariant(turned.system, norms, lower + step * abs(1 - lower))
        if weights is None:
            continue
        bound = growth(turned.system, norms, weights)
        if bound < best:
            scale = np.take_along_axis(weights, np.maximum(turned.groups, 0), axis=1)
            best, found = bound, _scaled(turned.system, np.where(turned.groups < 0, 1.0, scale))
    return best, found


def growth(system: System, norms: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """Return the least λ with norms_e·x_target ≤ λ·x_source for all transitions."""
    images = np.einsum("tgh,th->tg", norms, weights[system.targets])
    return float((images / weights[system.sources]).max() * (1 + 1e-13))


def subinvariant(
    system: System, norms: NDArray[np.float64], ratio: float
) -> NDArray[np.float64] | None:
    """Return x ≥ 1 (s, g) with max_e norms_e·x_target ≤ ratio·(x_source − 1), or None."""
    ones = np.ones((len(system.widths), norms.shape[1]))
    return least_fixed_point(system, norms / ratio, np.ones(norms.shape[:2]), ones)


def least_fixed_point(
    system: System,
    matrices: NDArray[np.float64],
    constants: NDArray[np.float64],
    base: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """Return x (s, g) with x_source = max(base, max_e matrices_e·x_target + constants_e), or None.

    By Howard's policy iteration: each row's largest transition is chosen, the linear system solved.
    None where it does not exist.

    Parameters
    ----------
    matrices
        Of the transitions, (t, g, g), not negative.
    constants
        Of the transitions, (t, g).
    base
        Of the states, (s, g).
    """
    x, chosen = base, np.full(base.shape, -1)
    for _ in range(POLICIES):
        policy = _largest(system, matrices, constants, base, x)
        if (policy == chosen).all():
            break
        chosen = policy
        solved = _solved_policy(system, matrices, constants, base, chosen)
        size = np.abs(x).max() * 1e-9
        if solved is None or not (solved >= x - size).all():
            return None
        x = solved
    return x


def _largest(
    system: System,
    matrices: NDArray[np.float64],
    constants: NDArray[np.float64],
    base: NDArray[np.float64],
    x: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Return the transition that is largest in each row (s, g), −1 where the base is."""
    images = np.einsum("tgh,th->tg", matrices, x[system.targets]) + constants
    policy = np.full(x.shape, -1)
    for q in np.unique(system.sources):
        letters = np.flatnonzero(system.sources == q)
        largest = letters[np.argmax(images[letters], axis=0)]
        policy[q] = np.where(images[letters].max(axis=0) > base[q], largest, -1)
    return policy


def _solved_policy(
    system: System,
    matrices: NDArray[np.float64],
    constants: NDArray[np.float64],
    base: NDArray[np.float64],
    chosen: NDArray[np.int64],
) -> NDArray[np.float64] | None:
    size = chosen.shape[1]
    whole, right = np.eye(chosen.size), base.ravel().copy()
    rows = np.flatnonzero(chosen >= 0)
    letters = chosen.ravel()[rows]
    columns = system.targets[letters][:, None] * size + np.arange(size)
    whole[rows[:, None], columns] -= matrices[letters, rows % size]
    right[rows] = constants[letters, rows % size]
    try:
        x = np.linalg.solve(whole, right)
    except np.linalg.LinAlgError:
        return None
    return np.asarray(x).reshape(chosen.shape) if np.isfinite(x).all() else None


def adapted_norms(
    sources: NDArray[np.int64], targets: NDArray[np.int64], matrices: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Return matrices L per state such that |Lᵀx| suits the maps, or None where there are none.

    P_r = I + γ⁻² Σ AᵀP_qA over the transitions q → r, γ slightly above ρ(ΣA⊗A)^½, and P = LLᵀ. It
    serves even where γ ≥ 1: the maps' norms are what counts. With many coordinates the matrices are
    weighted such that the largest norm becomes small.
    """
    count, size = int(max(sources.max(), targets.max())) + 1, matrices.shape[1]
    if count * size <= LARGEST_KRONECKER:
        return _root_of(_solved(sources, targets, matrices, count))
    best, least, weights = None, np.inf, np.ones(len(matrices))
    for _ in range(WEIGHTINGS):
        P = _iterated(sources, targets, matrices * np.sqrt(weights)[:, None, None], count)
        found = _root_of(P)
        if found is None:
            break
        left, right = found.transpose(0, 2, 1), np.linalg.inv(found).transpose(0, 2, 1)
        norms = np.linalg.norm(left[sources] @ matrices @ right[targets], 2, axis=(1, 2))
        if norms.max() < least:
            best, least = found, float(norms.max())
        # The largest matrices have more say in the next ellipsoids.
        weights *= (norms / norms.mean()) ** 4
        weights *= len(weights) / weights.sum()
    return best


def _root_of(P: NDArray[np.float64]) -> NDArray[np.float64] | None:
    try:
        return np.asarray(np.linalg.cholesky((P + P.transpose(0, 2, 1)) / 2), np.float64)
    except np.linalg.LinAlgError:
        return None


def _solved(
    sources: NDArray[np.int64],
    targets: NDArray[np.int64],
    matrices: NDArray[np.float64],
    count: int,
) -> NDArray[np.float64]:
    size = matrices.shape[1]
    square = size * size
    operator = np.zeros((count * square, count * square))
    for q, r, A in zip(sources, targets, matrices, strict=True):
        part = np.kron(A.T, A.T)
        operator[r * square : (r + 1) * square, q * square : (q + 1) * square] += part
    radius = float(np.abs(np.linalg.eigvals(operator)).max())
    gamma = max(radius, 1e-30) * 1.0025
    identity = np.tile(np.eye(size).reshape(-1), count)
    solved = np.linalg.solve(np.eye(len(operator)) - operator / gamma, identity)
    return np.asarray(solved.reshape(count, size, size))


def _iterated(
    sources: NDArray[np.int64],
    targets: NDArray[np.int64],
    matrices: NDArray[np.float64],
    count: int,
) -> NDArray[np.float64]:
    """Return nearly the same for many coordinates, γ² a little larger."""
    identity = np.tile(np.eye(matrices.shape[1]), (count, 1, 1))

    def applied(P: NDArray[np.float64]) -> NDArray[np.float64]:
        result = np.zeros_like(P)
        np.add.at(result, targets, matrices.transpose(0, 2, 1) @ P[sources] @ matrices)
        return result

    P, growth = identity, 1.0
    for _ in range(ROUNDS // 2):
        image = applied(P) + 1e-6 * P
        growth = float(np.abs(image).max() / np.abs(P).max())
        P = image / np.abs(image).max()
    P = identity
    for _ in range(ROUNDS):
        P = identity + applied(P) / (1.1 * growth)
    return P


def _round_off(
    bases: NDArray[np.float64],
    found: Flag,
    number: int,
    system: System,
    matrices: NDArray[np.float64],
) -> None:
    """Turn the basis of a group of several dimensions such that its ellipsoid is a ball."""
    columns = [np.flatnonzero(row == number) for row in found.groups]
    size = max(map(len, columns))
    if size < 2:
        return
    blocks = np.zeros((len(matrices), size, size))
    for block, q, r, A in zip(blocks, system.sources, system.targets, matrices, strict=True):
        block[: len(columns[q]), : len(columns[r])] = A[np.ix_(columns[q], columns[r])]
    lower = adapted_norms(system.sources, system.targets, blocks)
    if lower is None:
        return
    for q, chosen in enumerate(columns[: len(lower)]):
        many = len(chosen)
        bases[q][:, chosen] = bases[q][:, chosen] @ np.linalg.inv(lower[q][:many, :many].T)


def block_norms(system: System, groups: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return bounds on the norms of the blocks between groups, (t, g, g), errors included."""
    count = int(groups.max(initial=0)) + 1
    member = (groups[:, :, None] == np.arange(count)).astype(float)
    left, right = member[system.sources], member[system.targets]
    total = np.abs(system.matrices) + system.errors
    norms = np.sqrt(left.transpose(0, 2, 1) @ total**2 @ right)
    for number in range(count):
        rows, columns = left[:, :, number], right[:, :, number]
        if max(rows.sum(axis=1).max(), columns.sum(axis=1).max()) > 1:
            masks = rows[:, :, None] * columns[:, None, :]
            errors = np.linalg.norm(system.errors * masks, axis=(1, 2))
            norms[:, number, number] = (
                np.linalg.norm(system.matrices * masks, 2, axis=(1, 2)) + errors
            )
    return np.asarray(norms)


def _scaled(system: System, scale: NDArray[np.float64]) -> System:
    factors = scale[system.targets][:, None, :] / scale[system.sources][:, :, None]
    matrices = system.matrices * factors
    errors = system.errors * factors * (1 + 1e-15) + 4 * EPSILON * np.abs(matrices)
    return system._replace(matrices=matrices, errors=errors)
