"""How likely two points at a distance lie in the same phase: the two-point correlation S₂."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.measures._phase import voxels_of
from porous.values import Measure
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.measures._phase import Bools
    from porous.values import Frame
    from porous.values.tiled import Tiled

    Complexes = NDArray[np.complex128]
    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]
    Index = tuple[int, int, int]


SLAB = 1 << 17
"""Numbers that are transformed at once, about."""


@dataclass(frozen=True, eq=False)
class TwoPoint(Value):
    """The two-point correlation of a phase, averaged over directions, and along the axes.

    Parameters
    ----------
    phase
        pore or solid.
    unit
        Of length.
    spacing
        Edges of a voxel, in ``unit``.
    distances, values, lags
        Shape (n,): mean distance of a bin, the probability that two points so far from each other
        lie in the phase, and the number of vectors between voxels that the bin has. Bin b is of
        distances nearest to b times the shortest edge of a voxel.
    axes
        The probabilities at lags of 0, 1, 2, … voxels along x, y and z.
    """

    phase: str
    unit: str
    spacing: tuple[float, float, float]
    distances: Floats = field(repr=False)
    values: Floats = field(repr=False)
    lags: NDArray[np.int64] = field(repr=False)
    axes: tuple[Floats, Floats, Floats] = field(repr=False)

    def __post_init__(self) -> None:
        self._set("distances", frozen(self.distances, np.float64))
        self._set("values", frozen(self.values, np.float64))
        self._set("lags", frozen(self.lags, np.int64))
        self._set("axes", tuple(frozen(along, np.float64) for along in self.axes))
        if not self.distances.shape == self.values.shape == self.lags.shape:
            raise GridError(
                f"two-point correlation: got {self.distances.shape} distances, "
                f"{self.values.shape} values and {self.lags.shape} lags; wanted as many of each"
            )


def two_point(grid: Tiled, *, phase: str = "pore", longest: float | None = None) -> TwoPoint:
    """Return the two-point correlation of pores or of solid, by Fourier transforms.

    S₂(r) is the part of all pairs of places r apart, both in the bulk, of which both lie in the
    phase (S. Torquato, Random Heterogeneous Materials, 2002, section 2.2); along axes that are not
    periodic pairs lie within the grid, whose number is what is divided by. Counts of pairs are
    exact.

    Parameters
    ----------
    grid
        The body; any spacing.
    phase
        pore or solid.
    longest
        Distances are told up to this length, in ``grid.frame.unit``; half the shortest edge of the
        frame where not given. Longer ones than half a period have no meaning of their own.

    Returns
    -------
    TwoPoint
        Averages over directions weigh all vectors between voxels alike.

    Raises
    ------
    GridError
        For a longest distance that is none, or is longer than the frame has pairs for.
    MemoryLimitError
        Where there is too little memory.
    """
    frame = grid.frame
    reach = _reach(frame, longest)
    most = _lags(frame, reach)
    sizes = _sizes(frame, most)
    voxels = voxels_of(grid, phase, "void", "two-point correlation", _bytes(frame, sizes, most))
    hits = _correlated(voxels.counted, sizes, most)
    bulk = voxels.bulk
    pairs = _box_pairs(frame, most) if bulk is None else _correlated(bulk, sizes, most)
    axes = tuple(_along(hits, pairs, axis, n) for axis, n in enumerate(most))
    distances, values, lags = _averaged(_planes(hits, pairs, most), frame.spacing, reach)
    return TwoPoint(
        phase,
        frame.unit,
        frame.spacing,
        distances,
        values,
        lags,
        axes,  # type: ignore[arg-type]
    )


def _reach(frame: Frame, longest: float | None) -> float:
    lengths = frame.box.lengths
    if longest is None:
        return min(lengths) / 2
    most = min(
        a / 2 if wraps else a - h
        for a, h, wraps in zip(lengths, frame.spacing, frame.periodic, strict=True)
    )
    if not 0 < longest <= most * (1 + 1e-9):
        raise GridError(f"longest: got {longest}; wanted a length of {most:.6g} at most")
    return longest


def _lags(frame: Frame, reach: float) -> Index:
    """Return how many voxels the longest lag has along each axis."""
    found = (int(reach / h * (1 + 1e-12)) for h in frame.spacing)
    return tuple(min(k, n - 1) for k, n in zip(found, frame.shape, strict=True))  # type: ignore[return-value]


def _sizes(frame: Frame, most: Index) -> Index:
    """Return the sizes of transforms: without periods, with void as wide as the longest lag."""
    from scipy.fft import next_fast_len

    each = zip(frame.shape, most, frame.periodic, strict=True)
    return tuple(n if wraps else next_fast_len(n + k, real=True) for n, k, wraps in each)  # type: ignore[return-value]


def _bytes(frame: Frame, sizes: Index, most: Index) -> float:
    """Return the memory that is needed per voxel."""
    lags = (2 * most[0] + 1) * (most[1] + 1) * (2 * most[2] + 1)
    across = frame.shape[1] * frame.shape[2] + (most[1] + 1) * (2 * most[2] + 1)
    # Masks, complex numbers of both steps, counts of both halves, and the same of pairs.
    return 3 + (16 * (sizes[0] // 2 + 1) * across + 4 * 8 * lags) / frame.size


def _correlated(mask: Bools, sizes: Index, most: Index) -> Floats:
    """Return how many pairs of voxels of a mask have each lag; negative lags from the ends.

    Shape (kx + 1, 2 ky + 1, 2 kz + 1), along x none that are negative. One axis after another is
    transformed, of as little as there is, plane by plane, and only lags that are wanted go back.
    """
    from scipy.fft import hfft, rfft

    from porous.kernels._shared import slabs

    _, ny, nz = mask.shape
    (wide, deep), (mx, my, mz) = sizes[:2], most
    spectrum = np.empty((wide // 2 + 1, ny, nz), np.complex128)

    def there(a: int, b: int) -> None:
        spectrum[:, a:b] = rfft(mask[:, a:b].astype(np.float64), n=wide, axis=0)

    slabs(ny, max(1, SLAB // (wide * nz)), there)
    lags = np.empty((len(spectrum), my + 1, 2 * mz + 1), np.complex128)

    def planes(a: int, b: int) -> None:
        for k in range(a, b):
            lags[k] = _plane(spectrum[k], sizes[1:], most[1:])

    slabs(len(spectrum), max(1, SLAB // (deep * sizes[2])), planes)
    counts = np.empty((2 * mx + 1, my + 1, 2 * mz + 1))

    def back(a: int, b: int) -> None:
        found = hfft(lags[:, a:b], n=wide, axis=0)[_upto(mx, wide)]
        np.rint(np.abs(found) / math.prod(sizes), out=counts[:, a:b])

    slabs(my + 1, max(1, SLAB // (wide * lags.shape[2])), back)
    # A lag has as many pairs as the one the other way round.
    x, z = -np.arange(mx + 1), -_upto(mz, 2 * mz + 1)
    other = counts[np.ix_(x, np.arange(my, 0, -1), z)]
    return np.concatenate([counts[: mx + 1], other], axis=1)


def _plane(spectrum: Complexes, sizes: tuple[int, int], most: tuple[int, int]) -> Complexes:
    """Return the correlation of planes, as it is transformed across them: half along y."""
    from scipy.fft import fft, rfft

    along_z = fft(spectrum, n=sizes[1], axis=1)
    both = fft(along_z, n=sizes[0], axis=0)
    power = both.real**2 + both.imag**2
    # Transforms of what is real have one half; all go forwards, so that lags are the other way
    # round along each axis, which is the same.
    half = rfft(power, axis=0)[: most[0] + 1]
    return np.asarray(fft(half, axis=1)[:, _upto(most[1], sizes[1])])


def _upto(most: int, size: int) -> Ints:
    """Return where lags of 0, 1, …, most and −most, …, −1 are."""
    return np.roll(np.arange(-most, most + 1), -most) % size


def _box_pairs(frame: Frame, most: Index) -> Floats:
    """Return how many pairs of voxels of the frame have each lag, as ``_correlated`` does."""
    counts = np.ones((1, 1, 1))
    for axis, (n, k, wraps) in enumerate(zip(frame.shape, most, frame.periodic, strict=True)):
        lag = np.arange(k + 1)
        one = np.full(k + 1, float(n)) if wraps else n - lag.astype(np.float64)
        both = np.concatenate([one, one[:0:-1]])
        shape = [1, 1, 1]
        shape[axis] = len(both)
        counts = counts * both.reshape(shape)
    return counts


def _along(hits: Floats, pairs: Floats, axis: int, most: int) -> Floats:
    place = tuple(slice(most + 1) if a == axis else 0 for a in range(3))
    return np.asarray(hits[place] / pairs[place])


def _planes(
    hits: Floats, pairs: Floats, most: Index
) -> Iterator[tuple[int, Floats, NDArray[np.int64], NDArray[np.int64]]]:
    """Yield lags along x ≥ 0 with the probabilities at those along y and z: of both signs."""
    y, z = (np.arange(-k, k + 1) for k in most[1:])
    for x in range(most[0] + 1):
        with np.errstate(invalid="ignore"):
            yield x, hits[x][np.ix_(y, z)] / pairs[x][np.ix_(y, z)], y, z


def _averaged(
    planes: Iterator[tuple[int, Floats, NDArray[np.int64], NDArray[np.int64]]],
    spacing: tuple[float, float, float],
    reach: float,
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return mean distances, mean values and numbers of lags of bins as wide as a voxel."""
    step = min(spacing)
    bins = int(reach / step + 0.5) + 1
    sums = np.zeros((3, bins))
    for x, values, y, z in planes:
        square = (y * spacing[1])[:, None] ** 2 + (z * spacing[2]) ** 2 + (x * spacing[0]) ** 2
        distances = np.sqrt(square)
        told = (distances <= reach * (1 + 1e-12)) & ~np.isnan(values)
        place = (distances[told] / step + 0.5).astype(np.int64)
        taken = (None, distances[told], values[told])
        counts = np.array([np.bincount(place, weights, bins) for weights in taken])
        sums += counts * (1 if x == 0 else 2)  # a lag along −x is one along x the other way round
    known = sums[0] > 0
    lags, lengths, found = sums[:, known]
    return lengths / lags, found / lags, lags.astype(np.int64)


def correlation_length(found: TwoPoint, coarse: TwoPoint | None = None) -> Measure:
    """Return how far the phases correlate: the integral of (S₂ − φ²)/(φ − φ²), in units of length.

    S₂ is the two-point correlation averaged over directions and φ its value at zero. The integral
    runs up to where S₂ first comes down to φ² (the integral scale). It is the same for pores and
    for solid.

    Parameters
    ----------
    found
        What ``two_point`` found.
    coarse
        The same of voxels twice as long.

    Returns
    -------
    Measure
        The uncertainty is the difference to the coarse one. It is not known without that, or where
        S₂ does not come down so far within the distances told.

    Raises
    ------
    GridError
        Where one of the phases is missing.
    """
    value, ended = _integral(found)
    doubt = math.inf
    if coarse is not None and ended:
        other, ended = _integral(coarse)
        doubt = abs(value - other) if ended else math.inf
    name, unit = "correlation_length", found.unit
    return Measure(name, value, unit, "two-point correlation", doubt, "standard", "grid")


def _integral(found: TwoPoint) -> tuple[float, bool]:
    """Return the integral, and whether it ended before the distances did."""
    share = float(found.values[0])
    if not 0 < share < 1:
        raise GridError(f"correlation_length: got a phase that is {share:.6g} of all; wanted both")
    left = (found.values - share**2) / (share - share**2)
    past = np.flatnonzero(left <= 0)
    x = found.distances
    if not len(past):
        return float(np.trapezoid(left, x)), False
    k = int(past[0])
    end = x[k - 1] + (x[k] - x[k - 1]) * left[k - 1] / (left[k - 1] - left[k])
    upto = np.append(left[:k], 0.0)
    return float(np.trapezoid(upto, np.append(x[:k], end))), True
