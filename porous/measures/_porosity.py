"""How much of a grid is solid: porosity, relative density, volume."""

from __future__ import annotations

import math
from copy import copy
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError
from porous.measures._answer import answer
from porous.measures._census import Census
from porous.values import Measure

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.measures._answer import Table
    from porous.values.tiled import Tiled

    Floats = NDArray[np.float64]

VOXEL = 0.13
"""What sampling at the 64 points of ``values.FILL`` may get wrong of a voxel that a plane cuts
(0.128 at worst). A plane of whole-number normal v crosses voxels in |v|₁ different places, with as
many different fills; the mean of their errors is below ``VOXEL`` / √|v|₁, and 1/32 across an axis.
"""

OFFSET = 12**-0.5
"""Standard uncertainty of where a face lies between two rows of voxel centres, in voxels."""


def solid_fractions(histogram: NDArray[np.int64], sampling: str) -> Floats:
    """Return what solid fraction each of the 256 fills stands for, float64, shape (256,).

    Fills counted from 64 points are (255·k + 32)//64 and stand for k/64 exactly; where other
    bytes occur, or the grid was not sampled so, a byte stands for its 255th.
    """
    k = np.arange(65)
    bytes_of = (255 * k + 32) // 64
    fractions = np.arange(256) / 255
    if sampling == "fill" and histogram.sum() == histogram[bytes_of].sum():
        fractions[bytes_of] = k / 64
    return fractions


class Amounts:
    """Volumes in voxels, from a census of fills.

    ``bulk`` and ``bulk_count`` are the body that porosity refers to, in fractions and in whole
    voxels; ``solid`` and ``solid_count`` what is solid of it; ``everywhere`` all that is solid;
    ``beyond`` how much of that is more than the bulk of its voxel, which it then leaves for
    certain; ``bulk_doubt`` the uncertainty of ``bulk``, where it was sampled.
    """

    def __init__(self, census: Census) -> None:
        counts, self.sampling = census.fills, census.source.sampling
        histogram = counts.histogram
        fills = solid_fractions(histogram.sum(axis=1), self.sampling)[:, None]
        bulks = solid_fractions(histogram.sum(axis=0), "fill" if census.sampled else "")[None]
        self.bulk = float((histogram * bulks).sum())
        self.solid = float((histogram * np.minimum(fills, bulks)).sum())
        self.everywhere = float((histogram * fills).sum())
        self.bulk_count = int(histogram[:, 128:].sum())
        self.solid_count = int(histogram[128:, 128:].sum())
        # Where both end in a voxel, nobody knows how much of the one lies in the other.
        least = np.maximum(fills + bulks - 1, 0)
        apart = np.maximum(np.minimum(fills, bulks) - least, 0)
        self.unknown = float((histogram * apart).sum())
        self.beyond = float((histogram * np.maximum(fills - bulks - 1 / 255, 0)).sum())
        if census.sampled and self.sampling == "fill" and not self.beyond:
            # At the same points, none of which is solid and not bulk: neither are the others.
            self.unknown = 0.0
        self.bulk_doubt = _bulk_doubt(census)
        self.cuts = histogram[1:255].sum(axis=1)
        self.jumps = counts.jumps
        self.shift = _shifted(census)
        self.lattice = census.frame.shape, census.frame.periodic
        if not self.bulk_count:
            raise GridError("porosity: the bulk has no voxel that is at least half in it")

    @property
    def cut(self) -> int:
        """Number of voxels that are neither full nor empty."""
        return int(self.cuts.sum())

    @property
    def doubt(self) -> float:
        """Uncertainty of ``solid``, in voxels, by how the grid was sampled."""
        return min(self.everywhere_doubt + self.unknown, self.bulk)

    @property
    def everywhere_doubt(self) -> float:
        """Uncertainty of ``everywhere``, in voxels, by how the grid was sampled."""
        return math.hypot(_DOUBTS[self.sampling](self), self.shift)

    @property
    def inside_doubt(self) -> float:
        """Uncertainty of the void within the frame, on whose sides none of it ends."""
        inside, jumps = copy(self), self.jumps.copy()
        for axis, (n, wraps) in enumerate(zip(*self.lattice, strict=True)):
            if not wraps:
                jumps[axis, [0, n]] = 0
        inside.jumps = jumps
        return inside.everywhere_doubt

    @property
    def count_doubt(self) -> float:
        """Uncertainty of ``solid_count``, in voxels."""
        return abs(self.solid_count - self.solid) + self.doubt

    @property
    def share_doubt(self) -> float:
        """Uncertainty of ``solid`` as a part of ``bulk``: of both, as their ratio has it."""
        return math.hypot(self.doubt, self.solid / self.bulk * self.bulk_doubt) / self.bulk

    @property
    def count_share_doubt(self) -> float:
        """Uncertainty of ``solid_count`` as a part of ``bulk_count``."""
        bulk = self.bulk_doubt and abs(self.bulk_count - self.bulk) + self.bulk_doubt
        part = self.solid_count / self.bulk_count
        return math.hypot(self.count_doubt, part * bulk) / self.bulk_count


def _shifted(census: Census) -> float:
    """Return the standard uncertainty of the volume whose boundary is off by up to so much.

    In voxels: area × the error, which lies anywhere between its bounds (a rectangle's 1/√3).
    """
    error, frame = census.source.sampling_error, census.frame
    if not error:
        return 0.0
    counts = np.array([census.number(f"faces_{axis}") for axis in "xyz"], dtype=float)
    # A voxel's share of all its faces' area is at least that of the surface in it.
    steps = error / np.array(frame.spacing)
    return float((counts * steps).sum()) / math.sqrt(3)


def _bulk_doubt(census: Census) -> float:
    """Return the uncertainty of a bulk that was sampled, in voxels; of a box's there is none."""
    if not census.sampled:
        return 0.0
    counts = census.bulk_fills
    return _sampling_doubt(counts.histogram[1:255].sum(axis=1), counts.jumps)


def _sampling_doubt(cuts: NDArray[np.int64], jumps: NDArray[np.int64]) -> float:
    # Voxels of one fill may all lie alike about one plane and share an error; those of different
    # fills do not. Flat faces along the lattice show few fills, oblique and curved ones many.
    return VOXEL * float(np.linalg.norm(np.append(cuts, jumps.ravel())))


def _fill_doubt(amounts: Amounts) -> float:
    return _sampling_doubt(amounts.cuts, amounts.jumps)


def _centre_doubt(amounts: Amounts) -> float:
    # Faces across one axis may be those of parallel planes that are all rounded the same way.
    return OFFSET * float(np.linalg.norm(np.append(amounts.cuts, amounts.jumps.sum(axis=1))))


def _cover_doubt(amounts: Amounts) -> float:
    # A cover holds the set and says no more of its volume than that it is no larger.
    return amounts.everywhere


_DOUBTS: dict[str, Callable[[Amounts], float]] = {
    "fill": _fill_doubt,
    "centre": _centre_doubt,
    "cover": _cover_doubt,
}


def _row(name: str, method: str, value: float, doubt: float, unit: str = "1") -> Measure:
    return Measure(name, value, unit, method, doubt, "standard", "grid")


def _porosity_fill(census: Census) -> Measure:
    a = Amounts(census)
    return _row("porosity", "voxel fill", 1 - a.solid / a.bulk, a.share_doubt)


def _porosity_count(census: Census) -> Measure:
    a = Amounts(census)
    value = (a.bulk_count - a.solid_count) / a.bulk_count
    return _row("porosity", "voxel count", value, a.count_share_doubt)


def _density_fill(census: Census) -> Measure:
    a = Amounts(census)
    return _row("relative_density", "voxel fill", a.solid / a.bulk, a.share_doubt)


def _density_count(census: Census) -> Measure:
    a = Amounts(census)
    value = a.solid_count / a.bulk_count
    return _row("relative_density", "voxel count", value, a.count_share_doubt)


def _volume_fill(census: Census) -> Measure:
    a, voxel = Amounts(census), census.frame.voxel_volume
    unit = f"{census.frame.unit}³"
    return _row("volume", "voxel fill", a.everywhere * voxel, a.everywhere_doubt * voxel, unit)


def _volume_count(census: Census) -> Measure:
    a, voxel = Amounts(census), census.frame.voxel_volume
    count = census.number("cells")
    doubt = abs(count - a.everywhere) + a.everywhere_doubt
    return _row("volume", "voxel count", count * voxel, doubt * voxel, f"{census.frame.unit}³")


GRID: Table[Census] = {
    ("porosity", "voxel fill"): _porosity_fill,
    ("porosity", "voxel count"): _porosity_count,
    ("relative_density", "voxel fill"): _density_fill,
    ("relative_density", "voxel count"): _density_count,
    ("volume", "voxel fill"): _volume_fill,
    ("volume", "voxel count"): _volume_count,
}


def porosity(grid: Tiled, *, method: str = "voxel fill") -> Measure:
    """Return the void part of the bulk: 1 − solid volume / bulk volume, unit 1.

    Parameters
    ----------
    grid
        The body; its bulk is the whole frame where it names none.
    method
        ``"voxel fill"`` sums the solid fractions, ``"voxel count"`` the voxels that are at least
        half solid over those that are at least half bulk.

    Returns
    -------
    Measure
        The uncertainty is what sampling may have missed of the voxels that the surface crosses.
        At 64 points those of one fill may share an error, and so may full ones that meet empty ones
        in one lattice plane: ``VOXEL`` · √(Σ n²) for n of each group. Where only centres were asked
        it is ``OFFSET`` instead and a group is all planes across one axis; where the set was
        covered, all that is solid. A boundary that was sampled off the body's
        (``VoxelGrid.sampling_error``) adds area × error / √3. Solids and pores thinner
        than a voxel may escape the samples altogether; no grid can tell.

    Raises
    ------
    GridError
        Where no voxel is bulk.
    """
    return answer(GRID, "porosity", method, Census(grid))


def relative_density(grid: Tiled, *, method: str = "voxel fill") -> Measure:
    """Return the solid part of the bulk, 1 − porosity, unit 1.

    Takes, returns and raises what ``porosity`` does.
    """
    return answer(GRID, "relative_density", method, Census(grid))
