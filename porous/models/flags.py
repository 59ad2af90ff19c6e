"""Coordinates in which matrices that act together are block triangular, as far as they can be.

Subspaces that all matrices keep (one for each state: A_e W_target ⊂ W_source) are found as what the
eigenvectors of a generic product generate, smallest first; the same is done with what is left over.
The search is numerical and may miss some: whoever builds on it must not rely on exact zeros.
"""

from __future__ import annotations

from itertools import combinations, pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

KEPT = 1e-8
"""A vector lies in a subspace where what sticks out is this small, relative to the matrices."""

CLUSTERS = (1e-8, 1e-3)
"""Eigenvalues that are this close, relative to the largest, are tried as one: defective matrices'
are only known to a root of the rounding error."""

POLISH = 2
"""How many of Newton's steps improve a line."""

SQUARED = 1e-14
"""Squares of singular values are told from zero down to this, relative to the largest."""

SPAN = 1e-14
"""Matrices are spanned by others where what is left is this small, relative to the largest."""

CLEAN = 1e-11
"""A flag is good where what sticks out of it is this small, relative to the matrices."""

SPREAD = 0.1
"""Common eigenvectors belong to one layer where they are no closer to dependent than this."""


class Flag(NamedTuple):
    """A basis of every state's space and the group of each basis vector.

    ``bases`` (s, n, n): columns are basis vectors, padded by those of the identity; ``groups``
    (s, n): numbers that rise along the columns, −1 where padded. In these coordinates no matrix
    takes a group to a higher one, but for rounding.
    """

    bases: NDArray[np.float64]
    groups: NDArray[np.int64]


class _Effort(NamedTuple):
    """How many matrices between two states and how many generic sums of words stand in for all.

    ``exact`` are tolerances with which lines are looked for where the sums commute.
    """

    matrices: int
    generic: int
    exact: tuple[float, ...]


EFFORTS = (
    _Effort(4, 3, ()),
    _Effort(5, 3, ()),
    _Effort(1000, 8, (1e-12, 1e-9)),
    _Effort(4, 3, (1e-8,)),
)
"""A few generic ones mostly do; where eigenvalues coincide, or nearly, it takes all."""


class _System(NamedTuple):
    """Matrices (k_source, k_target) between the states' spaces of ``widths`` dimensions."""

    ends: list[tuple[int, int]]
    matrices: list[NDArray[np.float64]]
    widths: list[int]

    @property
    def size(self) -> float:
        return max((float(np.abs(A).max(initial=0.0)) for A in self.matrices), default=0.0)

    def restricted(
        self, left: list[NDArray[np.float64]], right: list[NDArray[np.float64]]
    ) -> _System:
        parts = [
            left[q].T @ A @ right[r] for (q, r), A in zip(self.ends, self.matrices, strict=True)
        ]
        return _System(self.ends, parts, [basis.shape[1] for basis in right])

    @property
    def dual(self) -> _System:
        return _System([(r, q) for q, r in self.ends], [A.T for A in self.matrices], self.widths)


_Family = list["NDArray[np.float64]"]


def flag(
    sources: NDArray[np.int64],
    targets: NDArray[np.int64],
    matrices: NDArray[np.float64],
    widths: NDArray[np.int64],
) -> Flag:
    """Return coordinates that make the matrices block triangular.

    Parameters
    ----------
    sources, targets
        The states between which each matrix acts, (t,): from the target's space to the source's.
    matrices
        (t, n, n), zero beyond the states' dimensions.
    widths
        The dimension of each state's space, (s,).
    """
    ends = [(int(q), int(r)) for q, r in zip(sources, targets, strict=True)]
    parts = [A[: widths[q], : widths[r]] for (q, r), A in zip(ends, matrices, strict=True)]
    system = _System(ends, parts, [int(w) for w in widths])
    best, score = None, (-1, 0.0)
    for seed, effort in enumerate(EFFORTS):
        rng = np.random.default_rng(seed)
        layers = _layers(_spanning(system, effort.matrices, rng), rng, effort)
        found = _flag(layers, widths, matrices.shape[1])
        defect = _defect(found, sources, targets, matrices)
        clean = defect <= CLEAN * max(float(np.abs(matrices).max(initial=0.0)), 1e-300)
        rank = (len(layers) if clean else 0, -defect)
        if best is None or rank > score:
            best, score = found, rank
        if clean and all(W.shape[1] <= 1 for layer in layers for W in layer):
            break
    assert best is not None
    return best


def _flag(layers: list[_Family], widths: NDArray[np.int64], size: int) -> Flag:
    bases = np.tile(np.eye(size), (len(widths), 1, 1))
    groups = np.full((len(widths), size), -1)
    for q, width in enumerate(widths):
        if width:
            many = [layer[q].shape[1] for layer in layers]
            bases[q, :width, :width] = np.hstack([layer[q] for layer in layers])
            groups[q, :width] = np.repeat(np.arange(len(layers)), many)
    return Flag(bases, groups)


def _defect(
    found: Flag,
    sources: NDArray[np.int64],
    targets: NDArray[np.int64],
    matrices: NDArray[np.float64],
) -> float:
    """Return the largest entry that takes a group to a higher one."""
    turned = np.linalg.inv(found.bases)[sources] @ matrices @ found.bases[targets]
    rises = found.groups[sources][:, :, None] > found.groups[targets][:, None, :]
    return float(np.abs(turned * rises * (found.groups[targets] >= 0)[:, None, :]).max(initial=0.0))


def _spanning(system: _System, most: int, rng: np.random.Generator) -> _System:
    """Return fewer matrices that span the same, or generic ones among them.

    They keep the same subspaces, the latter all but surely.
    """
    ends, matrices = [], []
    for end in sorted(set(system.ends)):
        among = [A for other, A in zip(system.ends, system.matrices, strict=True) if other == end]
        flat = np.stack(among).reshape(len(among), -1)
        if len(among) > 1 and flat.size:
            _, sigma, rows = np.linalg.svd(flat, full_matrices=False)
            chosen = sigma > SPAN * sigma[0]
            flat = (sigma[:, None] * rows)[chosen]
            if len(flat) > most:
                flat = rng.normal(size=(most, len(flat))) @ flat
            among = list(flat.reshape(-1, *among[0].shape))
        ends += [end] * len(among)
        matrices += among
    return _System(ends, matrices, system.widths)


def _layers(system: _System, rng: np.random.Generator, effort: _Effort) -> list[_Family]:
    """Return families of subspaces, each kept together with those before it; they span all."""
    result: list[_Family] = []
    left = [np.eye(width) for width in system.widths]
    while any(system.widths):
        found = _kept(system, rng, effort)
        result += [[Q @ W for Q, W in zip(left, family, strict=True)] for family in found]
        whole = [np.hstack([family[q] for family in found]) for q in range(len(left))]
        others = [_complement(W) for W in whole]
        left = [Q @ C for Q, C in zip(left, others, strict=True)]
        system = system.restricted(others, others)
    return result


def _kept(system: _System, rng: np.random.Generator, effort: _Effort) -> list[_Family]:
    """Return families that are kept and independent of each other; all, if none are smaller."""
    generic = [_closed(system, rng) for _ in range(effort.generic)]
    for kept in effort.exact:
        found = _lines(system, _commuting(generic, kept), effort.exact[0])
        if found:
            return found
    for cluster in CLUSTERS:
        starts = _starts(generic, cluster)
        found = _lines(system, starts, KEPT)
        if found:
            return found
        smallest = _smallest(system, starts)
        if smallest is not None:
            inner = system.restricted(smallest, smallest)
            return [
                [Q @ W for Q, W in zip(smallest, layer, strict=True)]
                for layer in _layers(inner, rng, effort)
            ]
        other = _smallest(system.dual, _starts([_transposed(g) for g in generic], cluster))
        if other is not None:
            below = [_complement(W) for W in other]
            layers = _layers(system.restricted(below, below), rng, effort)
            return [[Q @ W for Q, W in zip(below, layer, strict=True)] for layer in layers]
    return [[np.eye(width) for width in system.widths]]


def _closed(system: _System, rng: np.random.Generator) -> _Family:
    """Return for every state a generic sum of all words that start and end there."""
    first = np.concatenate([[0], np.cumsum(system.widths)])
    whole = np.zeros((first[-1], first[-1]))
    weights = rng.normal(size=len(system.ends))
    for weight, (q, r), A in zip(weights, system.ends, system.matrices, strict=True):
        whole[first[q] : first[q + 1], first[r] : first[r + 1]] += weight * A
    size = float(np.linalg.norm(whole, 2))
    inverse = np.linalg.inv(np.eye(len(whole)) - whole * (0.7 / size if size else 0.0))
    return [np.asarray(inverse[a:b, a:b], np.float64) for a, b in pairwise(first)]


def _transposed(family: _Family) -> _Family:
    return [matrix.T for matrix in family]


def _starts(generic: list[_Family], cluster: float) -> list[tuple[int, NDArray[np.complex128]]]:
    """Return the states' eigenspaces under the first generic sum, each cut to what others keep."""
    result = []
    for q, R in enumerate(generic[0]):
        others = [g[q] for g in generic[1:]]
        own, largest = _size([R]), _size(others)
        for value in _distinct(R, cluster) if len(R) else []:
            space = _null(R - value * np.eye(len(R)), KEPT * own)
            smaller = _held(space, others, KEPT * largest)
            # Where nothing is held each vector of the eigenspace may still generate less than all.
            result.append((q, smaller if smaller.shape[1] else space))
    return result


def _commuting(generic: list[_Family], kept: float) -> list[tuple[int, NDArray[np.complex128]]]:
    """Return eigenspaces where the states' generic sums commute: there lie all common lines.

    That is told well even where eigenvalues lie so close that eigenvectors are not.
    """
    result = []
    for q in range(len(generic[0])):
        sums = [g[q] for g in generic]
        size = _size(sums)
        pairs = [A @ B - B @ A for A, B in combinations(sums, 2)]
        space = _null(np.vstack(pairs), kept * size**2, least=0)
        while True:
            smaller = _held(space, sums, kept * size)
            if smaller.shape == space.shape:
                break
            space = smaller
        inner = (space.conj().T @ sums[0] @ space).real
        for value in _distinct(inner, CLUSTERS[-1]) if len(inner) else []:
            part = _null(inner - value * np.eye(len(inner)), kept * size)
            result.append((q, space @ part))
    return result


def _distinct(matrix: NDArray[np.float64], cluster: float) -> list[complex]:
    """Return the means of eigenvalues that lie together; of conjugate ones a single one."""
    values = [complex(value) for value in np.linalg.eigvals(matrix)]
    left = sorted(
        (value for value in values if value.imag >= 0), key=lambda value: (value.real, value.imag)
    )
    scale = max(map(abs, left))
    result = []
    while left:
        near = [v for v in left if abs(v - left[0]) <= cluster * scale]
        left = [v for v in left if abs(v - left[0]) > cluster * scale]
        mean = sum(near) / len(near)
        result.append(mean if abs(mean.imag) > cluster * scale else complex(mean.real))
    return result


def _null(
    matrix: NDArray[np.complex128] | NDArray[np.float64], size: float, least: int = 1
) -> NDArray[np.complex128]:
    """Return an orthonormal basis of what the matrix takes to less than ``size``.

    Of at least so many vectors.
    """
    real = matrix.real if not matrix.imag.any() else matrix
    _, sigma, rows = np.linalg.svd(real)
    many = max(least, int((sigma <= size).sum()))
    return np.asarray(rows[len(rows) - many :].conj().T)


def _size(matrices: _Family) -> float:
    """Return the largest spectral norm."""
    return max((float(np.linalg.norm(R, 2)) for R in matrices if R.size), default=0.0)


def _held(space: NDArray[np.complex128], others: _Family, size: float) -> NDArray[np.complex128]:
    """Return the part of a space that matrices take into itself, but for less than ``size``."""
    while space.shape[1] > 1:
        out = [R @ space - space @ (space.conj().T @ (R @ space)) for R in others]
        _, sigma, rows = np.linalg.svd(np.vstack(out), full_matrices=False)
        stays = sigma <= size
        if stays.all():
            break
        space = space @ rows[stays].conj().T
    return space


def _lines(
    system: _System, starts: list[tuple[int, NDArray[np.complex128]]], kept: float
) -> list[_Family]:
    """Return independent families of at most one dimension in every state, as exact as told."""
    found: list[_Family] = []
    limit = [1] * len(system.widths)
    for q, space in starts:
        if np.iscomplexobj(space):
            continue
        for vector in space.T:
            family = _generated(system, q, vector[:, None], limit)
            if family is not None:
                family = _polished(system, family)
                defect = float(np.abs(_equations(system, family)[1]).max(initial=0.0))
                if defect <= kept * system.size and _independent([*found, family]):
                    found.append(family)
    return found


def _polished(system: _System, family: _Family) -> _Family:
    """Return lines that every matrix keeps as well as floating point can tell.

    Newton's steps for x_source ∥ A_e·x_target, all matrices at once: that is better conditioned
    than an eigenvector of a single one. A step's rounding errors shrink with the defect, so the
    normal equations do: factoring the many rows costs up to ten times as much where other
    processes hold the cores that the linear algebra's threads wait for.
    """
    for _ in range(POLISH):
        rows, defects = _equations(system, family)
        step = np.linalg.lstsq(rows.T @ rows, -rows.T @ defects, rcond=SQUARED)[0]
        parts = np.split(step, np.cumsum(system.widths)[:-1])
        family = [
            (W + part[:, None]) / np.linalg.norm(W[:, 0] + part) if W.size else W
            for W, part in zip(family, parts, strict=True)
        ]
    return family


def _equations(system: _System, family: _Family) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how much images of lines leave them and the linear change with the lines."""
    first = np.concatenate([[0], np.cumsum(system.widths)])
    rows, defects = [], []
    for (q, r), A in zip(system.ends, system.matrices, strict=True):
        line, image = family[q].sum(axis=1), A @ family[r].sum(axis=1)
        across = np.eye(len(A)) - np.outer(line, line)
        row = np.zeros((len(A), first[-1]))
        row[:, first[r] : first[r + 1]] = across @ A
        row[:, first[q] : first[q + 1]] -= (line @ image) * across
        rows.append(row)
        defects.append(across @ image)
    return np.vstack(rows), np.concatenate(defects)


def _independent(families: list[_Family]) -> bool:
    for parts in zip(*families, strict=True):
        together = np.hstack(parts)
        rows, columns = together.shape
        if columns > rows:
            return False
        if columns and np.linalg.svd(together, compute_uv=False)[-1] < SPREAD:
            return False
    return True


def _smallest(system: _System, starts: list[tuple[int, NDArray[np.complex128]]]) -> _Family | None:
    """Return the smallest proper family that a vector generates, or None."""
    best, least = None, sum(system.widths)
    for q, space in starts:
        vector = space[:, :1]
        pair = np.hstack([vector.real, vector.imag] if np.iscomplexobj(vector) else [vector.real])
        family = _generated(system, q, pair, system.widths)
        many = least if family is None else sum(W.shape[1] for W in family)
        if many < least:
            best, least = family, many
    return best


def _generated(
    system: _System, state: int, vectors: NDArray[np.float64], limit: list[int]
) -> _Family | None:
    """Return orthonormal bases of what vectors generate, or None beyond ``limit`` dimensions."""
    size = max(system.size, 1e-300)
    bases: _Family = [np.zeros((width, 0)) for width in system.widths]
    fresh: _Family = [np.zeros((width, 0)) for width in system.widths]
    bases[state] = fresh[state] = _range(vectors, KEPT * float(np.abs(vectors).max()))
    while any(N.shape[1] for N in fresh):
        if any(W.shape[1] > most for W, most in zip(bases, limit, strict=True)):
            return None
        images: list[list[NDArray[np.float64]]] = [[] for _ in bases]
        for (q, r), A in zip(system.ends, system.matrices, strict=True):
            if fresh[r].shape[1]:
                images[q].append(A @ fresh[r])
        for q, parts in enumerate(images):
            fresh[q] = np.zeros((system.widths[q], 0))
            if parts:
                image = np.hstack(parts)
                fresh[q] = _range(image - bases[q] @ (bases[q].T @ image), KEPT * size)
                bases[q] = np.linalg.qr(np.hstack([bases[q], fresh[q]]))[0]
    return bases


def _range(vectors: NDArray[np.float64], size: float) -> NDArray[np.float64]:
    """Return an orthonormal basis of what vectors span, but for parts smaller than ``size``."""
    left, sigma, _ = np.linalg.svd(vectors, full_matrices=False)
    return np.asarray(left[:, sigma > size])


def _complement(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return an orthonormal basis of what is orthogonal to independent vectors."""
    left = np.linalg.svd(vectors, full_matrices=True)[0]
    return np.asarray(left[:, vectors.shape[1] :])
