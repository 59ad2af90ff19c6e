"""How many pieces, tunnels and cavities solid and pores have, and tunnels per volume."""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import GridError, nearest
from porous.kernels.windows import FUNCTIONALS, block_histogram
from porous.measures._census import Census, count_windows
from porous.measures._phase import BEYOND, PREFIX
from porous.measures._porosity import Amounts
from porous.measures._sample import Family, Findings, Sample
from porous.measures._topology import METHOD, cavities
from porous.models.model import HasExact
from porous.values import Frame, Measure, Measures, VoxelGrid

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from porous.models.model import Model
    from porous.values.tiled import Tiled

    Ints = NDArray[np.int64]

CLOSED, SIDES = "closed form", "voxel count without sides"

EULER = {6: "euler_number", 26: "euler_number_26"}
SUFFIX = {6: "", 26: "_26"}


def _exact(name: str, value: float, method: str = METHOD, of: str = "grid") -> Measure:
    return Measure(name, value, "1", method, 0.0, "exact", of)


def betti_numbers(grid: Tiled | Census, *, phase: str = "solid", connectivity: int = 6) -> Measures:
    """Return the Betti numbers of a phase: its pieces, its tunnels and its cavities, unit 1.

    b₁ = b₀ + b₂ − χ, the Euler number of three dimensions, of which the others are counted.

    Parameters
    ----------
    grid
        The body, in memory; any spacing. What lies beyond its sides is void, and of pores solid.
    phase
        pore or solid; pores that are not of the bulk do not count.
    connectivity
        How voxels of the solid are joined: 6, by faces, or 26, by edges and corners too. Pores are
        joined as solid is not, so that what is no tunnel of the one is none of the other.

    Returns
    -------
    Measures
        betti_0, betti_1 and betti_2, with ``pore_`` before them and ``_26`` after them as asked
        for; exact. Along periodic axes betti_0 alone: a body in a torus has tunnels of space itself
        among its own, and χ tells no other number.

    Raises
    ------
    GridError
        For an unknown phase or connectivity.
    """
    if phase not in PREFIX:
        raise GridError(f"phase: got {phase!r}{nearest(phase, PREFIX)}")
    if connectivity not in EULER:
        raise GridError(f"connectivity: got {connectivity!r}; wanted 6 or 26")
    census, suffix = Census.of(grid), SUFFIX[connectivity]
    begin = "" if phase == "solid" else "pore_"
    if phase == "solid":
        found = _numbers(census, connectivity, solid=True)
    elif census.has_bulk:
        found = _numbers(_of_pores(census.source), 32 - connectivity, solid=True)
    else:
        found = _numbers(census, 32 - connectivity, solid=False)
    return Measures(
        tuple(_exact(f"{begin}betti_{k}{suffix}", value) for k, value in enumerate(found))
    )


def _of_pores(grid: Tiled) -> Census:
    """Return the census of the grid whose solid is the pores of this one."""
    fill, bulk = grid.block((0, 0, 0), grid.frame.shape)
    pores = fill < 128 if bulk is None else (fill < 128) & (bulk >= 128)
    return Census(VoxelGrid.of_solid(pores, grid.frame))


def _numbers(census: Census, connectivity: int, *, solid: bool) -> list[int]:
    """Return the Betti numbers of the solid, or of all that is not."""
    rest = 32 - connectivity
    of = census.phase(solid=solid, connectivity=connectivity)
    if any(census.frame.periodic):
        return [census.pieces(solid=solid, connectivity=connectivity).number]
    census.take((of, census.phase(solid=not solid, connectivity=rest), count_windows))
    pieces = census.pieces(solid=solid, connectivity=connectivity).number
    enclosed = cavities(census, rest, solid=not solid)
    windows = census.windows if solid else census.void_windows
    euler = int(windows @ FUNCTIONALS[EULER[connectivity]])
    return [pieces, pieces + enclosed - euler, enclosed]


def _closed_forms(model: Model, frame: Frame) -> Iterator[Measure]:
    """Yield the Betti numbers that a model's own pieces, tunnels and Euler number tell."""
    if not isinstance(model, HasExact) or any(frame.periodic):
        return
    known = {row.name: row.value for row in model.exact(frame.periodic)}
    for suffix in SUFFIX.values():
        names = [f"{name}{suffix}" for name in ("components", "genus", "euler_number")]
        if all(math.isfinite(known.get(name, math.nan)) for name in names):
            pieces, tunnels, euler = (known[name] for name in names)
            numbers = (pieces, tunnels, euler - pieces + tunnels)
            for k, value in enumerate(numbers):
                yield _exact(f"betti_{k}{suffix}", value, CLOSED, "model")


def connectivity_density(
    grid: Tiled | Census, *, beyond: str = "void", connectivity: int = 6
) -> Measure:
    """Return the tunnels of the solid per volume, (1 − χ)/V, unit 1/length³.

    A. Odgaard & H. J. G. Gundersen, Bone 14, 1993: of one piece without cavities 1 − χ is the
    number of its tunnels. Of a body without end, along a periodic axis, it is −χ/V: one piece more
    or less does not count among its copies.

    Parameters
    ----------
    grid
        The body, in memory; any spacing.
    beyond
        What lies beyond sides that are not periodic. Of a body that ends there (``"void"``) χ is
        its own, and V the volume of its bulk. Of what was cut out of a larger one (``"unknown"``)
        χ is without what the sides have added: parts of the boundary that a side makes count half
        on a side, a quarter on an edge and an eighth on a corner, so that samples that lie side by
        side add up. It is counted about the lattice's inner vertices, of which eight voxels are
        known each, in the box between the outermost voxels' centres.
    connectivity
        How voxels of the solid are joined, 6 or 26.

    Returns
    -------
    Measure
        Exact of a body that ends, but for the volume of a bulk that fills voxels in part: that was
        sampled, and so is its volume. Of a sample the uncertainty is the standard error of −χ/V
        over its eight octants, which a trend adds to, and 1/V; half the difference between the two
        ways to join voxels, here or at half the resolution, whichever is more; and the difference
        to half the resolution. Where bodies meet in creases χ is off at any resolution, and these
        two tell by how much. Not known where the grid cannot be halved.

    Raises
    ------
    GridError
        For an unknown beyond or connectivity, a sample of one layer, or one with a bulk.
    """
    if beyond not in BEYOND:
        raise GridError(f"beyond: got {beyond!r}{nearest(beyond, BEYOND)}")
    if connectivity not in EULER:
        raise GridError(f"connectivity: got {connectivity!r}; wanted 6 or 26")
    census = Census.of(grid)
    if beyond == "void" or all(census.frame.periodic):
        return _of_body(census, connectivity)
    return _of_sample(census, (connectivity,))[0]


def _density(census: Census, method: str, value: float, doubt: float, connectivity: int) -> Measure:
    name, unit = f"connectivity_density{SUFFIX[connectivity]}", f"1/{census.frame.unit}³"
    kind = "standard" if doubt else "exact"
    return Measure(name, value, unit, method, doubt, kind, "grid")


def _of_body(census: Census, connectivity: int) -> Measure:
    amounts = _amounts(census)
    tunnels = _one(census.frame) - census.number(EULER[connectivity])
    value = tunnels / (amounts.bulk * census.frame.voxel_volume)
    doubt = abs(value) * amounts.bulk_doubt / amounts.bulk
    return _density(census, METHOD, value, doubt, connectivity)


def _one(frame: Frame) -> int:
    return 0 if any(frame.periodic) else 1


def _amounts(census: Census) -> Amounts:
    """Return the volumes of a grid whose bulk was sampled where it fills voxels in part."""
    in_part = bool(census.fills.histogram.sum(axis=0)[1:255].any())
    same = census.sampled == in_part
    return Amounts(census if same else Census(census.source, sampled=in_part))


def _of_sample(
    census: Census, connectivities: Iterable[int], coarse: Sample | None = None
) -> tuple[Measure, ...]:
    frame = census.frame
    if census.has_bulk:
        raise GridError("connectivity_density: the bulk is not the grid's box; wanted a box")
    if any(n < 2 and not wraps for n, wraps in zip(frame.shape, frame.periodic, strict=True)):
        raise GridError(
            f"connectivity_density: got a sample of {frame.shape} voxels; wanted two layers or more"
        )
    one, volume = _one(frame), _volume(frame)
    here, spread = _densities_of(census.inner_windows, frame, one), _over_octants(census)
    if coarse is None:
        fill, _ = census.source.block((0, 0, 0), frame.shape)
        coarse = Sample(VoxelGrid(frame, fill)).coarse
    there = None
    if coarse is not None:
        there = _densities_of(coarse.census.inner_windows, coarse.frame, one)
    return tuple(
        _density(
            census,
            SIDES,
            here[c],
            math.hypot(spread[c], 1 / volume, _unsure(here, there, c)),
            c,
        )
        for c in connectivities
    )


def _unsure(here: dict[int, float], there: dict[int, float] | None, connectivity: int) -> float:
    """Return what voxels leave open: how they are joined, and how many there are."""
    if there is None:
        return math.inf
    joined = max(abs(found[6] - found[26]) / 2 for found in (here, there))
    return math.hypot(joined, here[connectivity] - there[connectivity])


def _mirrored(weights: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return what each window adds to a functional on average, over its mirror images.

    A window's weights are those of what lies above its vertex, on one side of each plane through
    it: of a half-open box. The mean over mirror images takes half of either side.
    """
    bits = (np.arange(256)[:, None] >> np.arange(8)) & 1
    cubes = bits.reshape(256, 2, 2, 2)
    total = np.zeros(256)
    for steps in product((1, -1), repeat=3):
        turned = cubes[(slice(None), *(slice(None, None, step) for step in steps))]
        total += weights[turned.reshape(256, 8) @ (1 << np.arange(8))]
    return total / 8


MIRRORED = {c: _mirrored(FUNCTIONALS[name]) for c, name in EULER.items()}


def _volume(frame: Frame) -> float:
    """Return the volume between outermost centres."""
    gaps = [n if wraps else n - 1 for n, wraps in zip(frame.shape, frame.periodic, strict=True)]
    return float(math.prod(gaps)) * frame.voxel_volume


def _densities_of(windows: Ints, frame: Frame, one: int) -> dict[int, float]:
    """Return one less the Euler number about inner vertices, per volume, of both ways to join."""
    volume = _volume(frame)
    return {c: (one - float(windows @ MIRRORED[c])) / volume for c in EULER}


def _over_octants(census: Census) -> dict[int, float]:
    """Return the standard error of −χ/V over octants, which share the layers where they meet."""
    shape = census.frame.shape
    if min(shape) < 4:
        return dict.fromkeys(EULER, math.inf)
    found = []
    for ends in product(*(((0, n // 2 + 1), (n // 2, n)) for n in shape)):
        (a, b), (c, d), (e, f) = ends
        fill, _ = census.source.block((a, c, e), (b, d, f))
        windows = block_histogram(fill, below=("nothing",) * 3, above=("nothing",) * 3)
        octant = Frame((0, 0, 0), census.frame.spacing, (b - a, d - c, f - e))
        found.append(_densities_of(windows, octant, 0))
    return {
        c: float(np.std([part[c] for part in found], ddof=1) / math.sqrt(len(found))) for c in EULER
    }


def take(sample: Sample) -> Findings:
    """Take the Betti numbers of both phases, and the tunnels per volume."""
    rows: list[Measure] = []
    if sample.model is not None:
        rows += _closed_forms(sample.model, sample.frame)
    if sample.has("solid"):
        for connectivity in EULER:
            rows += betti_numbers(sample.census, connectivity=connectivity)
    sample.tell("topology", 0.5)
    if sample.has("pore"):
        rows += betti_numbers(sample.census, phase="pore")
    if sample.has("solid"):
        rows += _densities(sample)
    notes = (
        ("Tunnels and cavities of a periodic grid are not told: those of space are among them.",)
        if any(sample.frame.periodic)
        else ()
    )
    return Findings(Measures(tuple(rows)), notes=notes)


def _densities(sample: Sample) -> Iterator[Measure]:
    bulk, beyond = sample.grid.bulk, sample.how.beyond
    if bulk is not None and (beyond == "unknown" or bulk.max() < 128):
        return
    if beyond == "unknown" and not all(sample.frame.periodic):
        if min(sample.frame.shape) > 1:
            yield from _of_sample(sample.census, EULER, sample.coarse)
        return
    for connectivity in EULER:
        yield connectivity_density(sample.census, beyond=beyond, connectivity=connectivity)


FAMILY = Family("topology", "Pieces, tunnels and cavities", 50, take)
