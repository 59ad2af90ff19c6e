"""What a grid is a sample of: its numbers, as doubtful as the sample's blocks differ."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from porous.measures._blocks import over_blocks
from porous.measures._census import Census
from porous.measures._intercept import LEAST, crossings, fitted
from porous.measures._porosity import Amounts
from porous.values import Measure, Measures

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.measures._intercept import Intercepts
    from porous.measures._sample import Sample
    from porous.measures._thickness import LocalThickness
    from porous.values import VoxelGrid

    Floats = NDArray[np.float64]

METHOD = "blocks"

NAMES = (
    "porosity",
    "specific_surface",
    "pore_chord_mean",
    "wall_chord_mean",
    *(f"mean_intercept_length_{place}" for place in (1, 2, 3)),
    "degree_of_anisotropy",
)
"""What is told of the material."""

APART = 5.0
"""Correlation lengths that a block is long, at least, for blocks to count as independent."""

WIDE = 3.0
"""Mean diameters that an octant is long, at least, for octants to count as independent."""


def material(
    sample: Sample, lines: Intercepts, rows: Measures, correlation: float, most: int
) -> Measures:
    """Return what a grid is a sample of by its lines, and how far off another sample would be.

    Parameters
    ----------
    sample
        A grid that was cut out of something larger.
    lines
        What ``intercepts`` found of it.
    rows
        What these come to: mean intercept lengths, anisotropy, mean chords.
    correlation
        The correlation length.
    most
        Voxels at most that blocks are looked at on; coarser ones where the grid has more.

    Returns
    -------
    Measures
        material_porosity, material_specific_surface (of lattice lines, as are all that follow),
        material_pore_chord_mean, material_wall_chord_mean, material_mean_intercept_length_1 … _3
        and material_degree_of_anisotropy: those of the sample. None of a grid with a bulk.

        Uncertainties are those of the grid combined with the standard error by ``over_blocks``.
        There are 8, 27 or 64 blocks, as many as are ``APART`` correlation lengths long; where 8
        are not, nobody knows the error. A sample always looks more anisotropic than the material
        is, for its directions differ by chance too: the anisotropy's uncertainty is the most that
        fabrics may differ in it that are so far apart as those of samples are.
    """
    grid, frame, less = sample.grid, sample.frame, sample.within(most)
    if grid.bulk is not None:
        return Measures()
    fits = (k for k in (4, 3, 2) if min(less.frame.shape) >= LEAST * k)
    long_enough = (k for k in fits if min(frame.box.lengths) / k >= APART * correlation)
    blocks, errors = next(long_enough, 0), dict.fromkeys(NAMES, math.inf)
    if blocks:
        errors = _errors(sample, lines, less.grid, blocks)
    given = _given(sample, lines) + rows
    return Measures(tuple(_row(row, errors[row.name]) for row in given if row.name in errors))


def _row(row: Measure, error: float) -> Measure:
    doubt = math.hypot(row.uncertainty, error)
    return replace(row, name=f"material_{row.name}", method=METHOD, uncertainty=doubt)


def _given(sample: Sample, lines: Intercepts) -> Measures:
    amounts, (rate, doubt) = Amounts(sample.census), lines.mean
    rows = (
        ("porosity", 1 - amounts.solid / amounts.bulk, "1", amounts.inside_doubt / amounts.bulk),
        ("specific_surface", 2 * rate, f"1/{lines.unit}", 2 * doubt),
    )
    return Measures(
        tuple(
            Measure(name, value, unit, METHOD, doubt, "standard", "grid")
            for name, value, unit, doubt in rows
        )
    )


def _errors(sample: Sample, lines: Intercepts, grid: VoxelGrid, blocks: int) -> dict[str, float]:
    """Return the standard errors of ``NAMES``.

    Small differences of the pores' part and of crossings add up in all of them, so that it is known
    what each block adds, however small it is.
    """
    amounts, tensor, rate = Amounts(sample.census), fitted(lines), lines.mean[0]
    part, whole = 1 - amounts.solid / amounts.bulk, tensor.matrix(lines.crossings**2)

    def take(block: VoxelGrid) -> Floats:
        here, found = Amounts(Census(block)), crossings(block)
        pores, mean = 1 - here.solid / here.bulk, float(lines.weights @ found)
        chords = (pores - part * mean / rate, 1 - pores - (1 - part) * mean / rate)
        # Squares follow their tangents; a fabric is as good as any multiple of it.
        given = tensor.matrix(2 * lines.crossings * found)
        turned = given - np.trace(given) / np.trace(whole) * whole
        amount = [pores, 2 * mean, *(2 * chord / rate for chord in chords)]
        return np.array([*amount, *given.ravel(), *turned.ravel()])

    told = over_blocks(take, grid, blocks=blocks).error
    change, turn = (float(np.linalg.norm(told[k : k + 9])) for k in (4, 13))
    # No eigenvalue λ changes by more than the matrix does, no two of them by more than √2 of it.
    with np.errstate(divide="ignore"):
        lengths = change / 2 * tensor.values**-1.5
    apart = math.sqrt(2) * turn / tensor.values[2]
    return dict(zip(NAMES, map(float, (*told[:4], *lengths, apart)), strict=True))


def octants(local: LocalThickness, row: Measure) -> Measure:
    """Return a mean thickness as that of what the grid is a sample of: material_….

    Parameters
    ----------
    local
        The local thickness of a phase of a grid that was cut out of something larger.
    row
        Its mean.

    Returns
    -------
    Measure
        The uncertainty is that of the row combined with the standard error by the octants' means.
        It is not known where octants are shorter than ``WIDE`` such diameters.
    """
    frame = local.frame
    if min(frame.shape) < 2 or min(frame.box.lengths) < 2 * WIDE * row.value:
        return _row(row, math.inf)
    halves = [(slice(n // 2), slice(n // 2, None)) for n in frame.shape]
    parts = [local.diameters[place] for place in product(*halves)]
    sums = np.array([part.sum(dtype=np.float64) for part in parts])
    counts = np.array([np.count_nonzero(part > 0) for part in parts])
    # What each octant adds to the mean, however little of the phase it has.
    adds = (sums - sums.sum() / counts.sum() * counts) / counts.mean()
    return _row(row, float(adds.std(ddof=1)) / math.sqrt(len(adds)))
