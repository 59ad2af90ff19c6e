"""Pores as a network: the pore space divided at its throats, and what joins what."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.measures._phase import voxels_of
from porous.measures._sample import Family, Findings, Sample, Survey
from porous.values import Curve, Frame, Measure, Measures
from porous.values.value import Value, adopted, frozen

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from porous.kernels.watershed import Basins
    from porous.values import VoxelGrid

    Bools = NDArray[np.bool_]
    Floats = NDArray[np.float64]
    Progress = Callable[[str, float], None]

METHOD = "watershed"

MOST = 256**3
"""Voxels that a survey's network is made of, at most."""

NARROWER, NOISE = 0.1, 0.75
"""Two maxima of the distance are two pores where it falls between them by more than this part of
the lesser, and by more than so many voxels, which is how far the lattice is off."""

BYTES = 32.0
"""Memory per voxel."""

COUNTED = 1 << 20
"""Voxels that are counted at a time."""

POINTS = 256
"""Points of a curve, at most."""


@dataclass(frozen=True, eq=False)
class PoreNetwork(Value):
    """Pores and the throats between them; row p is of the voxels with label p + 1.

    Parameters
    ----------
    frame
        Where the voxels lie.
    labels
        int32, shape ``frame.shape``: 0 where there is no pore.
    centres
        float64, shape (n, 3), in ``frame.unit``: of the largest ball in each pore.
    volumes
        float64, shape (n,), in ``frame.unit`` cubed.
    inscribed_diameters
        float64, shape (n,), of that ball: between walls, as ``local_thickness`` tells it.
    cut
        bool, shape (n,): whether a side of the grid or of the bulk cuts it.
    throats
        int32, shape (m, 2): rows of the two pores that a throat joins, the lesser first. Pores that
        touch in several places have one throat, but one for each image of the other that they
        touch along periodic axes; a throat to a pore's own image, both rows the same, stands once
        and leads out at either end. None have pores that touch only in lines and points, where
        others lie between them, nor one that goes on into its own image where nothing narrows.
    throat_diameters
        float64, shape (m,): of the largest ball that passes from the one to the other, likewise.
    periods
        int32, shape (m, 3): how many periods along each axis the image of the second pore is away
        that the first one touches, of those images whose centres are ``centres`` both; zero where
        the throat does not leave the grid.

    Raises
    ------
    GridError
        Where shapes disagree.
    """

    frame: Frame
    labels: NDArray[np.int32] = field(repr=False)
    centres: Floats = field(repr=False)
    volumes: Floats = field(repr=False)
    inscribed_diameters: Floats = field(repr=False)
    cut: Bools = field(repr=False)
    throats: NDArray[np.int32] = field(repr=False)
    throat_diameters: Floats = field(repr=False)
    periods: NDArray[np.int32] = field(repr=False)

    def __post_init__(self) -> None:
        for name in ("centres", "volumes", "inscribed_diameters", "throat_diameters"):
            self._set(name, frozen(getattr(self, name), np.float64))
        for name in ("labels", "throats", "periods"):
            self._set(name, frozen(getattr(self, name), np.int32))
        self._set("cut", frozen(self.cut, np.bool_))
        n, m = len(self.volumes), len(self.throat_diameters)
        wanted = {
            "labels": self.frame.shape,
            "centres": (n, 3),
            "volumes": (n,),
            "inscribed_diameters": (n,),
            "cut": (n,),
            "throats": (m, 2),
            "throat_diameters": (m,),
            "periods": (m, 3),
        }
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape:
                raise GridError(f"{name}: got shape {getattr(self, name).shape}; wanted {shape}")

    def __len__(self) -> int:
        return len(self.volumes)

    @property
    def diameters(self) -> Floats:
        """Diameters of balls as large as the pores, float64, shape (n,)."""
        return np.asarray(np.cbrt(6 / math.pi * self.volumes))

    @property
    def coordination_numbers(self) -> NDArray[np.int64]:
        """How many throats lead out of each pore, int64, shape (n,); of one to its image both."""
        return np.bincount(self.throats.ravel(), minlength=len(self))


def pore_network(
    grid: VoxelGrid, *, beyond: str = "void", progress: Progress | None = None
) -> PoreNetwork:
    """Divide the pores of a grid at their throats.

    Watershed of the distance to the solid (J. T. Gostick, Phys. Rev. E 96, 023307, 2017): every
    pore voxel belongs to the maximum of the distance that it lies uphill to. Two maxima are one
    pore where the distance falls on the widest way between them by no more than a tenth of the
    lesser or ¾ of a voxel's longest edge; and where the lesser lies in the ball about the other.

    Parameters
    ----------
    grid
        The body; any spacing. Pores go on along periodic axes, and no pore ends at another side.
    beyond
        As for ``local_thickness``; it changes nothing for pores.
    progress
        Called as ``progress("watershed", done)`` with done in 0 … 1; raising in it cancels.

    Returns
    -------
    PoreNetwork
        Pores in the order of their largest balls, the largest first.

    Raises
    ------
    GridError
        Where the grid has no pores, or nothing else.
    MemoryLimitError
        Where there is too little memory.
    """
    voxels_of(grid, "pore", beyond, METHOD, BYTES)
    return _network(Sample(grid, how=Survey(beyond=beyond), progress=progress))


def _network(sample: Sample) -> PoreNetwork:
    from porous.kernels.watershed import Rule, basins

    if not sample.has_both:
        raise GridError("pore network: wanted a grid of both phases, pore and solid")
    squares, voxels, frame = sample.squares("pore"), sample.voxels("pore"), sample.frame
    found = basins(
        squares,
        voxels.counted,
        Rule(NARROWER, NOISE * max(frame.spacing) / squares.step),
        periodic=frame.periodic,
        progress=lambda done, count: sample.tell(METHOD, done / count),
    )
    labels, n = found.labels, len(found.peaks)
    counts = _counts(labels, n)
    places = np.unravel_index(found.peaks, frame.shape)
    return PoreNetwork(
        frame,
        adopted(labels),
        np.stack([frame.centres(axis)[places[axis]] for axis in range(3)], axis=1),
        counts.astype(np.float64) * frame.voxel_volume,
        2 * sample.half_widths("pore", found.depths.astype(np.float64)),
        _cut(found, frame, None if voxels.bulk is None else voxels.mask & ~voxels.bulk),
        found.pairs - 1,
        2 * sample.half_widths("pore", found.saddles.astype(np.float64)),
        found.periods,
    )


def _counts(labels: NDArray[np.int32], n: int) -> NDArray[np.int64]:
    """Return how many voxels each of the labels 1 … n has; few at a time, for they are copied."""
    flat, counts = labels.reshape(-1), np.zeros(n + 1, np.int64)
    for a in range(0, len(flat), COUNTED):
        counts += np.bincount(flat[a : a + COUNTED], minlength=n + 1)
    return counts[1:]


def _cut(found: Basins, frame: Frame, beyond: Bools | None) -> Bools:
    """Return which pores a side cuts, or void that is not of the bulk."""
    result = np.zeros(len(found.peaks) + 1, np.bool_)
    for axis in range(3):
        labels = np.moveaxis(found.labels, axis, 0)
        if not frame.periodic[axis]:
            result[labels[0]] = result[labels[-1]] = True
        if beyond is not None:
            outside = np.moveaxis(beyond, axis, 0)
            result[labels[1:][outside[:-1]]] = True
            result[labels[:-1][outside[1:]]] = True
    return result[1:]


def take(sample: Sample) -> Findings:
    """Take the network of the pores, of 256³ voxels at most."""
    body = sample.within(MOST)
    if not body.has_both:
        return Findings()
    body.progress = sample.progress
    network = _network(body)
    coarse = body.coarse
    other = _network(coarse) if coarse is not None and coarse.has_both else None
    notes: tuple[str, ...] = ()
    if body is not sample:
        size = " × ".join(map(str, body.frame.shape))
        notes = (f"The pore network is that of {size} voxels, coarser than the grid.",)
    return Findings(Measures(tuple(_rows(network, other))), tuple(_curves(network)), notes)


def _rows(network: PoreNetwork, coarse: PoreNetwork | None) -> Iterator[Measure]:
    others = {} if coarse is None else _values(coarse)
    for name, value in _values(network).items():
        length = "diameter" in name
        unit, least = (network.frame.unit, max(network.frame.spacing)) if length else ("1", 0.0)
        doubt = max(abs(value - others[name]), least) if name in others else math.inf
        yield Measure(name, value, unit, METHOD, doubt, "standard", "grid")


def _values(network: PoreNetwork) -> dict[str, float]:
    """Return what a network comes to; means over pores are of those that no side cuts."""
    whole, values = ~network.cut, {"pores": float(len(network))}
    if whole.any():
        diameters, inscribed = network.diameters[whole], network.inscribed_diameters[whole]
        values["coordination_number_mean"] = float(network.coordination_numbers[whole].mean())
        values["pore_diameter_mean"] = float(diameters.mean())
        values["pore_diameter_p50"] = float(np.median(diameters))
        values["inscribed_pore_diameter_p50"] = float(np.median(inscribed))
    if len(network.throats):
        values["throat_diameter_mean"] = float(network.throat_diameters.mean())
        values["throat_diameter_p50"] = float(np.median(network.throat_diameters))
    return values


def _curves(network: PoreNetwork) -> Iterator[Curve]:
    whole = ~network.cut
    if whole.any():
        counts = np.bincount(network.coordination_numbers[whole])
        places: Floats = np.arange(len(counts) + 1, dtype=np.float64) - 0.5
        shares: Floats = np.append(counts / np.float64(whole.sum()), 0.0)
        names = ("Throats of a pore", "1", "Part of the pores", "1")
        yield Curve("coordination_number", "pores", places, shares, *names, METHOD, drawn="steps")
        for series, sizes in (
            ("as large as the pore", network.diameters),
            ("inscribed", network.inscribed_diameters),
        ):
            yield _distribution("network_pore_diameter", series, sizes[whole], network.frame.unit)
    if len(network.throats):
        sizes = network.throat_diameters
        yield _distribution("throat_diameter", "throats", sizes, network.frame.unit)


def _distribution(name: str, series: str, sizes: Floats, unit: str) -> Curve:
    """Return the part of pores or throats, by number, that are not larger."""
    values = np.sort(sizes)
    parts = np.arange(1, len(values) + 1) / len(values)
    if len(values) > POINTS:
        chosen = np.linspace(0, len(values) - 1, POINTS).round().astype(np.intp)
        values, parts = values[chosen], parts[chosen]
    return Curve(name, series, values, parts, "Diameter", unit, "Part not larger", "1", METHOD)


FAMILY = Family("network", "Pores and throats", 60, take)
