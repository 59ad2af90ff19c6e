"""How a body fills space from scale to scale: lacunarity, succolarity, generalised dimensions."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import GridError, ModelError
from porous.measures._boxes import METHOD as BOXES
from porous.measures._boxes import (
    NORMAL,
    POINTS,
    BoxCounts,
    Lattice,
    box_counts,
    fitted,
    lattices,
    scaling,
)
from porous.measures._model import smallest_feature
from porous.measures._phase import voxels_of
from porous.measures._sample import Family, Findings, Sample
from porous.memory import check_memory
from porous.values import Curve, Measure, Measures

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.kernels.components import Runs
    from porous.models.model import Model
    from porous.values import Frame, VoxelGrid

    Bools = NDArray[np.bool_]
    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

GLIDING = "gliding boxes"
FLOOD = "voxel flood"
MOMENTS = "box moments"

MOST = 256**3
"""Voxels at which a survey looks at boxes that glide, and at floods."""

STEP = 1.5
"""From one size of gliding boxes to the next."""

PART = 10
"""``lacunarity`` is told of boxes of this part of the grid's shortest edge, one voxel at least."""

FEW = 1 << 20
"""Sums below this are tallied in a table; there may be many of them."""

MANY = 16
"""Boxes of so many voxels are summed up of smaller ones, not of their voxels."""

BYTES = 40.0
"""Memory per voxel that sums over corners take, along periodic axes too."""

ORDERS = np.arange(-10, 11) / 2
"""The q of generalised dimensions."""

LACUNARITY = {"solid": "lacunarity", "pore": "pore_lacunarity"}


class Lacunarity(NamedTuple):
    """Edges of boxes in voxels, int64 (n,), and the lacunarity of either phase, float64 (n,)."""

    sizes: Ints
    solid: Floats
    pore: Floats

    def at(self, phase: str, size: float) -> float:
        """Return the lacunarity of a phase at any size: on a line, log-log, between sizes."""
        x, y = np.log(self.sizes), np.log(self.solid if phase == "solid" else self.pore)
        return float(np.exp(np.interp(math.log(size), x, y)))

    def of(self, *sizes: int) -> Lacunarity:
        """Return that of some sizes alone."""
        chosen = np.isin(self.sizes, sizes)
        return Lacunarity(self.sizes[chosen], self.solid[chosen], self.pore[chosen])


def gliding_boxes(sample: Sample | VoxelGrid) -> Lacunarity:
    """Return the lacunarity of solid and pores over sizes of boxes, from one voxel to half an edge.

    Λ(r) = ⟨m²⟩ / ⟨m⟩² of what boxes of r voxels along each axis hold, m, over all places where
    they fit (C. Allain, M. Cloitre, Phys. Rev. A 44 (1991) 3552). Λ(1) is one over the phase's part
    of the bulk, and a body that looks the same everywhere at scale r has Λ(r) = 1.

    Parameters
    ----------
    sample
        The body. Along periodic axes boxes go on; where the bulk is not the frame, they lie in it
        as a whole. Along unequal spacings boxes are no cubes.

    Returns
    -------
    Lacunarity
        NaN of a phase that no box holds anything of.

    Raises
    ------
    MemoryLimitError
        Where there is too little memory.
    """
    given = sample if isinstance(sample, Sample) else Sample(sample)
    return _gliding(given, _sizes(given.frame))


def _sizes(frame: Frame) -> Ints:
    """Return sizes of boxes, ``STEP`` apart or the next, and those that ``lacunarity`` is of."""
    sizes, most = set(_around(_told_size(frame))), max(1, min(frame.shape) // 2)
    size = 1.0
    while size <= most:
        sizes.add(round(size))
        size = max(size * STEP, round(size) + 1)
    return np.array(sorted(sizes), np.int64)


def _told_size(frame: Frame) -> float:
    return max(1.0, min(frame.shape) / PART)


def _around(size: float) -> tuple[int, ...]:
    """Return the whole sizes next to a size, and where it is not whole one more either way."""
    low, high = math.floor(size), math.ceil(size)
    return (low,) if low == high else (max(1, low - 1), low, high, high + 1)


def _gliding(sample: Sample, sizes: Ints) -> Lacunarity:
    from porous.kernels.gliding import corner_sums, gliding_moments

    grid, frame = sample.grid, sample.frame
    check_memory(int(BYTES * frame.size), "gliding boxes", "Choose fewer voxels.")
    longest = int(sizes[-1])
    solid = corner_sums(grid.solid, frame.periodic, longest)
    bulk = None if grid.bulk is None else corner_sums(grid.bulk >= 128, frame.periodic, longest)
    found = np.full((len(sizes), 2), np.nan)
    for row, size in enumerate(sizes.tolist()):
        x, y, z = (
            n if wraps else n - size + 1
            for n, wraps in zip(frame.shape, frame.periodic, strict=True)
        )
        count, first, second = gliding_moments(solid, bulk, (x, y, z), size)
        found[row] = _lacunarities(count, first, second, float(size) ** 3)
        sample.tell(FAMILY.name, 0.8 * (row + 1) / len(sizes))
    return Lacunarity(sizes, found[:, 0], found[:, 1])


def _lacunarities(count: int, first: float, second: float, volume: float) -> tuple[float, float]:
    """Return ⟨m²⟩/⟨m⟩² of what boxes of a volume hold, and of what is left in them."""
    if not count:
        return math.nan, math.nan
    mean, square = first / count, second / count
    left = volume - mean
    rest = volume**2 - 2 * volume * mean + square
    return square / mean**2 if mean else math.nan, rest / left**2 if left else math.nan


def lacunarity(grid: VoxelGrid, *, phase: str = "solid") -> Measure:
    """Return the lacunarity of a phase at boxes of a tenth of the grid's shortest edge, unit 1.

    Where that is no whole number of voxels, Λ lies on the line between the two next to it, log Λ
    over log r. ``gliding_boxes`` gives all sizes. The uncertainty is the difference to half the
    resolution, and not known where the grid cannot be halved, and that to a line between the sizes
    one voxel further away.

    Raises
    ------
    GridError
        For an unknown phase, or where it has no voxel.
    """
    voxels_of(grid, phase, "void", "lacunarity", BYTES)
    sample = Sample(grid)
    return _lacunarity(sample, gliding_boxes(sample), phase)


def _lacunarity(sample: Sample, found: Lacunarity, phase: str) -> Measure:
    size = _told_size(sample.frame)
    sizes = _around(size)
    value, doubt = found.at(phase, size), math.inf
    between = abs(found.of(sizes[0], sizes[-1]).at(phase, size) - value)
    if sample.coarse is not None:
        half = max(1.0, size / 2)
        near = np.array(sorted({math.floor(half), math.ceil(half)}), np.int64)
        other = _gliding(sample.coarse, near).at(phase, half)
        doubt = math.inf if math.isnan(other) else abs(value - other) + between
    return Measure(LACUNARITY[phase], value, "1", GLIDING, doubt, "standard", "grid")


def succolarity(grid: VoxelGrid) -> Measures:
    """Return the succolarity of the pores along each axis, unit 1.

    Fluid comes in by all pores of one side and goes as far as pores lead, and it counts in each
    voxel by the pressure there, which grows in proportion to the way from that side: the sum over
    what is flooded over the same sum over the whole grid (R. H. C. de Melo, A. Conci,
    Telecommunication Systems 52 (2013) 1643), with boxes of one voxel, and the mean of both sides
    of the axis. 0 where no pore is open to either side, 1 without solid.

    Returns
    -------
    Measures
        ``succolarity_x``, ``succolarity_y`` and ``succolarity_z``. Pores are joined by faces, edges
        and corners, and across periodic sides but for the axis's own. The uncertainty is the
        difference to pores joined by faces alone, and to half the resolution; not known where the
        grid cannot be halved.

    Raises
    ------
    GridError
        Where the bulk is not the frame.
    """
    if grid.bulk is not None:
        raise GridError("succolarity: the bulk is not the grid's box; wanted a box")
    return Measures(tuple(_succolarities(Sample(grid))))


def _succolarities(sample: Sample) -> Iterator[Measure]:
    wide, narrow = _flooded(sample.grid, 26), _flooded(sample.grid, 6)
    coarse = None if sample.coarse is None else _flooded(sample.coarse.grid, 26)
    for axis, name in enumerate("xyz"):
        scales = math.inf if coarse is None else abs(wide[axis] - coarse[axis])
        doubt = abs(wide[axis] - narrow[axis]) + scales
        row = f"succolarity_{name}"
        yield Measure(row, wide[axis], "1", FLOOD, doubt, "standard", "grid")


def _flooded(grid: VoxelGrid, connectivity: int) -> tuple[float, float, float]:
    """Return the succolarity along each axis."""
    from porous.kernels.components import label_runs

    pores, known = ~grid.solid, {}
    found = []
    for axis in range(3):
        wraps = tuple(w and a != axis for a, w in enumerate(grid.frame.periodic))
        if wraps not in known:
            known[wraps] = label_runs(pores, connectivity, periodic=wraps)  # type: ignore[arg-type]
        found.append(_along(known[wraps], grid.frame, axis))
    x, y, z = found
    return x, y, z


def _along(runs: Runs, frame: Frame, axis: int) -> float:
    shape, rows = frame.shape, runs.rows
    begin, end = runs.starts.astype(np.int64), runs.stops.astype(np.int64)
    if axis < 2:
        begin = rows // shape[1] if axis == 0 else rows % shape[1]
        end, length = begin + 1, end - runs.starts
    else:
        length = np.ones_like(begin)
    n, total = shape[axis], 0.0
    for low, high in ((begin, end), (n - end, n - begin)):
        # Pressures k + ½ from ``low`` on add up to half the difference of the squares.
        inside = np.zeros(runs.total, bool)
        inside[runs.labels[low == 0]] = True
        total += float((length * (high**2 - low**2))[inside[runs.labels]].sum())
    return total / 2 / (n * frame.size)


class Spectrum(NamedTuple):
    """Dimensions of a measure over orders q, each float64 (n,), with uncertainties.

    Parameters
    ----------
    order
        q, from −5 to 5.
    dimension, doubt
        D_q, and its uncertainty.
    alpha, f
        How strongly the measure is concentrated, α(q), and the dimension of the places where it is
        so, f(α(q)).
    alpha_doubt, f_doubt
        Their uncertainties.
    window
        Sizes of boxes that lines were fitted over, in voxels.
    """

    order: Floats
    dimension: Floats
    doubt: Floats
    alpha: Floats
    alpha_doubt: Floats
    f: Floats
    f_doubt: Floats
    window: Floats


def generalised_dimensions(grid: VoxelGrid, *, base: int | None = None) -> Spectrum:
    """Return the multifractal spectrum of the solid: D_q, and f over α.

    Of the parts p that boxes of size r hold of all solid, by the voxels' fills: (q − 1)·D_q is the
    slope of log Σ p^q over log r, D_1 that of Σ p log p (P. Grassberger 1983; T. Vicsek, Fractal
    Growth Phenomena, 1989); with μ = p^q / Σ p^q, α is the slope of Σ μ log p, and f that of
    Σ μ log μ (A. Chhabra, R. V. Jensen, Phys. Rev. Lett. 62 (1989) 1327). Boxes and sizes are those
    of ``box_dimension``, and so are uncertainties. A body that is everywhere alike has the same D_q
    for all q. Orders below zero weigh boxes with hardly anything in them: where boxes do not fit
    the body's own lattice these are accidents, and uncertainties are as wide.

    Parameters
    ----------
    grid
        The body.
    base
        As for ``box_counts``.

    Raises
    ------
    GridError
        Where nothing is solid, or the grid has fewer than three sizes of boxes.
    """
    return _spectrum(grid, box_counts(grid, base=base), base)


def _spectrum(grid: VoxelGrid, counts: BoxCounts, base: int | None = None) -> Spectrum:
    window = fitted(counts).window
    boxes = lattices(grid.frame.shape, base)[:window]
    check_memory(8 * grid.frame.size, "masses of boxes", "Choose fewer voxels.")
    table = np.array([_moments(*held) for held in _masses(grid.fill, boxes)])
    sizes = counts.sizes[:window]
    fits = np.array(
        [[_fit(sizes, table[:, i, k]) for k in range(table.shape[2])] for i in range(4)]
    )
    one = ORDERS == 1
    gap = np.where(one, 1.0, ORDERS - 1)
    slope, doubt = np.where(one[:, None], fits[3], fits[0] / gap[:, None]).T
    (alpha, wide), (f, high) = fits[1].T, fits[2].T
    return Spectrum(ORDERS, slope, np.abs(doubt), alpha, wide, f, high, sizes)


def _masses(fill: NDArray[np.uint8], boxes: tuple[Lattice, ...]) -> Iterator[tuple[Ints, Ints]]:
    """Yield what boxes of each size hold, and how many hold so much."""
    from porous.kernels.boxes import box_sums
    from porous.kernels.greys import level_counts

    held = level_counts(fill.reshape(-1))
    there = np.flatnonzero(held[1:]) + 1
    yield there, held[there]
    shape = (fill.shape[0], fill.shape[1], fill.shape[2])
    edge, within = 0, np.zeros(0, np.int64)
    for lattice in boxes[1:]:
        fits = lattice.fits(shape)
        if fits and edge and lattice.wanted % edge == 0 and MANY * within.size < fill.size:
            sums = _joined(within, lattice.wanted // edge)
        else:
            sums = box_sums(fill, (0, 0, 0), shape, lattice.parts)
        if fits:
            edge, within = lattice.wanted, sums
        yield _tallied(sums)


def _joined(sums: Ints, times: int) -> Ints:
    """Return the sums of so many boxes along each axis."""
    for axis in range(3):
        shape = sums.shape
        parts = (*shape[:axis], shape[axis] // times, times, *shape[axis + 1 :])
        sums = sums.reshape(parts).sum(axis=axis + 1)
    return sums


def _tallied(sums: Ints) -> tuple[Ints, Ints]:
    """Return the sums above zero that there are, and how many there are of each."""
    if sums.max() >= FEW:
        return np.unique(sums[sums > 0], return_counts=True)
    held = np.bincount(sums.ravel())
    there = np.flatnonzero(held[1:]) + 1
    return there, held[there]


def _moments(masses: Ints, counts: Ints) -> Floats:
    """Return log Σ p^q, Σ μ log p, Σ μ log μ and Σ p log p, each for all orders, (4, orders)."""
    total = float((masses * counts).sum())
    p = np.log(masses / total)
    powers = ORDERS[:, None] * p
    top = powers.max(axis=1, keepdims=True)
    weights = counts * np.exp(powers - top)
    sums = weights.sum(axis=1)
    norm = np.log(sums) + top[:, 0]
    mean = (weights * p).sum(axis=1) / sums
    information = float((counts * np.exp(p) * p).sum())
    return np.stack([norm, mean, ORDERS * mean - norm, np.full(len(ORDERS), information)])


def _fit(sizes: Floats, values: Floats) -> tuple[float, float]:
    """Return a slope over log size and its uncertainty, as ``box_dimension`` has them."""
    return scaling(np.log(sizes).tolist(), values.tolist())


def _take(sample: Sample) -> Findings:
    found = Findings()
    within = sample.within(MOST)
    gliding = gliding_boxes(within)
    for phase in LACUNARITY:
        if sample.has(phase) and not np.isnan(getattr(gliding, phase)).any():
            found += _of_gliding(within, gliding, phase)
    if sample.grid.bulk is None:
        found += Findings(Measures(tuple(_succolarities(within))))
    return found + _of_boxes(sample)


def _edge(frame: Frame) -> float:
    """Return the edge of a cube as large as a voxel."""
    return math.cbrt(frame.voxel_volume)


def _of_gliding(sample: Sample, gliding: Lacunarity, phase: str) -> Findings:
    edges: Floats = np.asarray(gliding.sizes * _edge(sample.frame), np.float64)
    values = getattr(gliding, phase)
    curve = Curve(
        "lacunarity", phase, edges, values, "edge of box", sample.frame.unit,
        "lacunarity", "1", GLIDING, log="xy",
    )  # fmt: skip
    size = _told_size(sample.frame)
    name = LACUNARITY[phase].replace("_", " ")
    note = (
        f"{name}: of boxes of {size:.4g} voxels ({size * _edge(sample.frame):.4g} "
        f"{sample.frame.unit}) along each edge"
    )
    return Findings(Measures((_lacunarity(sample, gliding, phase),)), (curve,), (note,))


def _of_boxes(sample: Sample) -> Findings:
    counts = box_counts(sample.grid)
    if len(counts.sizes) < POINTS or not counts.counts[0]:
        return Findings()
    spectrum = _spectrum(sample.grid, counts)
    rows = [
        _dimension(name, spectrum, order)
        for name, order in (("information_dimension", 1), ("correlation_dimension", 2))
    ]
    notes = (_interval(counts), *_details(sample, counts))
    return Findings(Measures(tuple(rows)), _curves(sample.frame, counts, spectrum), notes)


def _interval(counts: BoxCounts) -> str:
    """Return a box dimension and where it can lie, in words: between 0 and 3."""
    fit = fitted(counts)
    low, high = fit.slope - NORMAL * fit.doubt, fit.slope + NORMAL * fit.doubt
    low, high = min(3.0, max(0.0, low)), max(0.0, min(3.0, high))
    first, last = counts.sizes[0], counts.sizes[fit.window - 1]
    return (
        f"box dimension: {fit.slope:.4f}, with 95 % from {low:.4f} to {high:.4f}, is the slope "
        f"over {fit.window} sizes of boxes, {first:.4g} to {last:.4g} voxels along an edge"
    )


def _details(sample: Sample, counts: BoxCounts) -> Iterator[str]:
    """Yield that boxes of the fit are finer than all details, where they are."""
    feature = _feature(sample.model) if sample.model is not None else None
    if feature is None:
        return
    voxels = feature / _edge(sample.frame)
    window = counts.sizes[: fitted(counts).window]
    finer = int((window < voxels * (1 - 1e-9)).sum())
    if finer:
        yield (
            f"box dimension: {finer} of {len(window)} sizes of boxes are finer than the smallest "
            f"feature, {voxels:.4g} voxels, and see a body of dimension 3; dimensions tend to that"
        )


def _feature(model: Model) -> float | None:
    """Return a model's smallest feature, if it has any."""
    try:
        return smallest_feature(model).value
    except ModelError:
        return None


def _dimension(name: str, spectrum: Spectrum, order: float) -> Measure:
    at = int(np.flatnonzero(spectrum.order == order)[0])
    value, doubt = spectrum.dimension[at], spectrum.doubt[at]
    return Measure(name, value, "1", MOMENTS, doubt, "standard", "grid")


def _curves(frame: Frame, counts: BoxCounts, spectrum: Spectrum) -> tuple[Curve, ...]:
    fit = fitted(counts)
    sizes, number = (np.asarray(values, np.float64) for values in counts)
    edges = np.asarray(sizes * _edge(frame), np.float64)
    fitted_line = np.asarray(math.exp(fit.height) * sizes[: fit.window] ** -fit.slope, np.float64)
    boxes = Curve(
        "box_counts", "boxes with solid", edges, number, "edge of box", frame.unit,
        "number of boxes", "1", BOXES, drawn="points", log="xy",
    )  # fmt: skip
    slope = replace(boxes, series="line fitted", x=edges[: fit.window], y=fitted_line, drawn="line")
    q, dimension, doubt = spectrum[:3]
    orders = Curve(
        "generalised_dimensions", "solid", q, dimension, "order q", "1", "D_q", "1", MOMENTS,
        low=dimension - doubt, high=dimension + doubt,
    )  # fmt: skip
    alpha, f, high = spectrum.alpha, spectrum.f, spectrum.f_doubt
    concentrations = Curve(
        "multifractal_spectrum", "solid", alpha, f, "α", "1", "f(α)", "1", MOMENTS,
        low=f - high, high=f + high, drawn="points",
    )  # fmt: skip
    return boxes, slope, orders, concentrations


FAMILY = Family("fractal", "Fractal measures", 80, _take)
