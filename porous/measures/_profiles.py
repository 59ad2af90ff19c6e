"""How a body changes from place to place: layers along the axes, and boxes of growing size."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.kernels.windows import CROSSINGS
from porous.measures._porosity import solid_fractions
from porous.measures._surface_area import crofton
from porous.values import Curve

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.measures._census import Census
    from porous.measures._sample import Sample
    from porous.values import Frame

    Floats = NDArray[np.float64]
    Ints = NDArray[np.int64]

WHOLE = 64 * 255
"""A voxel in parts of which fractions are whole numbers: 64ths and 255ths."""

CELLS = (24, 12, 6)
"""Into how many cells the shortest edge is cut, of at least two voxels: boxes are made of them."""

BOXES = 8
"""Boxes of a size, at least, whose spread is told."""


class Sums(NamedTuple):
    """Solid and bulk of voxels, in fractions, summed."""

    solid: Floats
    bulk: Floats

    @property
    def porosity(self) -> Floats:
        """The void part of the bulk; NaN where there is none."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return 1 - self.solid / self.bulk


def _fractions(census: Census) -> tuple[Floats, Floats]:
    """Return the shares that fills and bulks stand for, each of 256 bytes."""
    histogram = census.fills.histogram
    bulk_sampling = "fill" if census.sampled else ""
    return (
        solid_fractions(histogram.sum(axis=1), census.source.sampling),
        solid_fractions(histogram.sum(axis=0), bulk_sampling),
    )


def porosity_profiles(sample: Sample) -> tuple[Curve, ...]:
    """Return the porosity of each layer of voxels along x, y and z, by voxel fill.

    It refers to the bulk; layers without any are left out. The mean over a box's layers is its
    porosity.

    Parameters
    ----------
    sample
        The grid under survey.

    Returns
    -------
    tuple of Curve
        porosity_profile along x, y and z, over the places of the layers' centres; none where there
        is no bulk.
    """
    from porous.kernels.sums import layer_sums

    grid, frame = sample.grid, sample.frame
    fills, bulks = (np.rint(WHOLE * parts).astype(np.int64) for parts in _fractions(sample.census))
    sums = layer_sums(grid.fill, grid.bulk, (fills, bulks))
    layers = enumerate(Sums(solid / WHOLE, bulk / WHOLE).porosity for solid, bulk in sums)
    return tuple(_profile(frame, axis, told) for axis, told in layers if np.isfinite(told).any())


def _profile(frame: Frame, axis: int, layers: Floats) -> Curve:
    letter, there = "xyz"[axis], np.isfinite(layers)
    return Curve(
        "porosity_profile",
        f"along {letter}",
        frame.centres(axis)[there],
        layers[there],
        "place",
        frame.unit,
        "porosity",
        "1",
        "voxel fill",
    )


class Cells(NamedTuple):
    """Cubes that boxes are made of: their edge, how many the largest box has along it, and sums.

    ``solid`` and ``bulk`` are in voxels, of which there are ``voxels``; ``area`` is that between
    solid and void, by the volume of a voxel.
    """

    edge: float
    most: int
    solid: Floats
    bulk: Floats
    area: Floats
    voxels: Floats


def representative_volumes(sample: Sample) -> tuple[Curve, ...]:
    """Return porosity and specific surface of boxes by their size: mean and spread.

    The frame is filled with cubes of one size, in turn from a 24th of its shortest edge to half of
    it. Where the spread has become small, a box is a representative volume (J. Bear, Dynamics of
    Fluids in Porous Media, 1972). The surface is that between the phases by crofton. Boxes that are
    not all bulk are left out, and so are sizes of fewer than 8 boxes.

    Parameters
    ----------
    sample
        The grid under survey.

    Returns
    -------
    tuple of Curve
        representative_volume (porosity) and representative_surface (area by volume), over the edge
        of the boxes; the band is one standard deviation of a box. None for small grids.
    """
    cells = _cells(sample)
    if cells is None:
        return ()
    rows = [row for j in _divisors(cells.most) if (row := _boxes(cells, j)) is not None]
    if not rows:
        return ()
    x, phi, spread, surface, scatter = np.array(rows).T
    unit = sample.frame.unit

    def curve(name: str, what: str, y_unit: str, method: str, y: Floats, by: Floats) -> Curve:
        words = ("boxes", x, y, "edge of a box", unit, what, y_unit, method)
        return Curve(name, *words, y - by, y + by)

    return (
        curve("representative_volume", "porosity", "1", "voxel fill", phi, spread),
        curve("representative_surface", "area by volume", f"1/{unit}", "crofton", surface, scatter),
    )


def _divisors(n: int) -> Iterator[int]:
    return (j for j in range(1, n + 1) if n % j == 0)


def _cells(sample: Sample) -> Cells | None:
    frame = sample.frame
    lengths = frame.box.lengths
    for most in CELLS:
        edge = min(lengths) / most
        if edge >= 2 * max(frame.spacing) * (1 - 1e-9):
            break
    else:
        return None
    bounds = [
        np.rint(np.arange(int(length / edge * (1 + 1e-9)) + 1) * edge / h).astype(np.int64)
        for length, h in zip(lengths, frame.spacing, strict=True)
    ]
    solid, bulk, area = _sums(sample, bounds)
    x, y, z = (np.diff(b).astype(np.float64) for b in bounds)
    return Cells(edge, most, solid, bulk, area, x[:, None, None] * y[:, None] * z)


def _sums(sample: Sample, bounds: list[Ints]) -> Floats:
    """Return solid, bulk and area of the voxels of cells between bounds along x, y and z."""
    from porous.kernels._shared import slabs
    from porous.kernels.sums import summed_planes

    grid, (x, y, z) = sample.grid, bounds
    wraps, worth = grid.frame.periodic, (*_fractions(sample.census), _areas(grid.frame))
    result = np.empty((3, *(len(b) - 1 for b in bounds)))

    def work(a: int, b: int) -> None:
        for i in range(a, b):
            planes = summed_planes(grid.fill, grid.bulk, worth, wraps, (int(x[i]), int(x[i + 1])))
            for total, plane in zip(result, planes[:, : y[-1], : z[-1]], strict=True):
                total[i] = np.add.reduceat(np.add.reduceat(plane, y[:-1], 0), z[:-1], 1)

    slabs(len(x) - 1, 1, work)
    return result


def _areas(frame: Frame) -> Floats:
    """Return the area that each window has, over a voxel's volume, by crofton; shape (256,)."""
    rule = crofton(frame.spacing)
    return np.asarray(2 * (rule.weights / rule.lengths) @ CROSSINGS)


def _boxes(cells: Cells, j: int) -> tuple[float, ...] | None:
    """Return edge, porosity and its spread, and specific surface and its, of boxes of j³ cells."""
    solid, bulk, area, voxels = (_joined(given, j) for given in cells[2:])
    whole = bulk >= voxels * (1 - 1e-9)
    values = 1 - solid[whole] / voxels[whole], area[whole] / voxels[whole]
    if len(values[0]) < BOXES:
        return None
    told = (part for value in values for part in (value.mean(), value.std(ddof=1)))
    return (j * cells.edge, *map(float, told))


def _joined(cells: Floats, j: int) -> Floats:
    """Return sums of j by j by j cells; what is left over at the ends is left out."""
    for axis in range(3):
        n = cells.shape[axis] // j
        kept = np.moveaxis(cells, axis, 0)[: n * j]
        cells = np.moveaxis(kept.reshape(n, j, *kept.shape[1:]).sum(axis=1), 0, axis)
    return cells
