"""What a scan has too much: specks of solid in the pores, and pores that nothing reaches.

Pieces are those of the measures: solid is joined by faces, void by faces, edges and corners; along
periodic axes pieces go on at the other side. What was done is told step by step.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import GridError
from porous.kernels.components import label_runs, layer_labels, sizes_from, touching, unite
from porous.memory import check_memory
from porous.values.value import Value, adopted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from porous.kernels.components import Runs
    from porous.values import VoxelGrid

    Axes = tuple[bool, bool, bool]
    Bools = NDArray[np.bool_]
    Bytes = NDArray[np.uint8]
    Ints = NDArray[np.int64]

LARGEST = "all but the largest"
FILL = "fill"
OUTSIDE, ENDLESS = 1, 2
"""Marks of a piece: that it touches the outside; that it winds around x, twice and four times that
of y and z."""
BYTES = 12
"""Bytes that a voxel takes while its piece is looked for, about."""


@dataclass(frozen=True, eq=False)
class CleanStep(Value):
    """One step of cleaning, as it came out.

    Parameters
    ----------
    name
        ``"islands"`` or ``"closed_pores"``.
    wanted
        What was asked for, in words.
    pieces, of
        How many pieces were changed, and how many of that phase there were.
    voxels
        How many voxels those pieces had.
    volume
        By how much the solid volume has changed, in ``unit`` cubed.
    share
        That change as a part of the solid volume before.
    unit
        Unit of length.
    """

    name: str
    wanted: str
    pieces: int
    of: int
    voxels: int
    volume: float
    share: float
    unit: str

    def __str__(self) -> str:
        what, done = _WORDS[self.name]
        return (
            f"clean.{self.name}: {self.pieces} of {self.of} {what}, {self.wanted}, {done}: "
            f"{self.voxels} voxels, solid volume {self.volume:+.4g} {self.unit}³, "
            f"{self.share:+.3%}"
        )


_WORDS = {
    "islands": ("pieces of solid", "were removed"),
    "closed_pores": ("pores", "were filled"),
}


@dataclass(frozen=True, eq=False)
class Cleaned(Value):
    """A grid that was cleaned, and what was done to it."""

    grid: VoxelGrid = field(repr=False)
    steps: tuple[CleanStep, ...] = ()

    @property
    def is_changed(self) -> bool:
        """Whether anything was there to be cleaned."""
        return any(step.pieces for step in self.steps)


def clean(
    grid: VoxelGrid,
    *,
    islands: int | str | None = None,
    closed_pores: int | str | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Cleaned:
    """Remove pieces of solid that lie apart, then fill pores that nothing reaches.

    Parameters
    ----------
    grid
        The body.
    islands
        A whole number: pieces of solid of fewer voxels go. ``"all but the largest"``: all others.
        None: all stay.
    closed_pores
        ``"fill"``: pores that are cut off from the outside become solid. A whole number: those of
        fewer voxels. None: all stay. What the outside is, is said in ``open_porosity``.
    progress
        Called as ``progress("clean", done)`` with done in 0 … 1; raising in it cancels.

    Returns
    -------
    Cleaned
        Of voxels that are solid in part, those go too that only bordered on what went, and those
        are filled that only bordered on what was filled. A grid that was changed has no Hausdorff
        bound any more.

    Raises
    ------
    GridError
        For other words and numbers below 1; where no solid would be left.
    MemoryLimitError
        Where the work would not fit.
    """
    _check(islands, "islands", LARGEST)
    _check(closed_pores, "closed_pores", FILL)
    check_memory(BYTES * grid.frame.size, "cleaning the voxels", "Choose fewer of them.")
    steps = []
    if islands is not None:
        grid, step = _without_islands(grid, islands)
        steps.append(step)
    if progress is not None:
        progress("clean", 0.5)
    if closed_pores is not None:
        grid, step = _without_closed_pores(grid, closed_pores)
        steps.append(step)
    if progress is not None:
        progress("clean", 1.0)
    return Cleaned(grid, tuple(steps))


def _check(value: int | str | None, name: str, word: str) -> None:
    good = value is None or value == word
    if not good and not (isinstance(value, int) and not isinstance(value, bool) and value >= 1):
        raise GridError(
            f'{name}: got {value!r}; wanted a number of voxels, at least 1, or "{word}"'
        )


def _without_islands(grid: VoxelGrid, wanted: int | str) -> tuple[VoxelGrid, CleanStep]:
    solid = grid.solid
    pieces = _Pieces.of(solid, 6, grid.frame.periodic)
    if wanted == LARGEST:
        chosen = np.ones(len(pieces.sizes), bool)
        if len(chosen):
            chosen[np.argmax(pieces.sizes)] = False
        words = "all but the largest"
    else:
        chosen = pieces.sizes < int(wanted)
        words = f"each of fewer than {wanted} voxels"
    if chosen.all() and len(chosen):
        raise GridError(
            f"islands: got {wanted}, and the largest of {len(chosen)} pieces of solid has "
            f"{pieces.sizes.max()} voxels: none would be left; wanted fewer"
        )
    voxels = pieces.voxels(chosen)
    return _changed(grid, voxels, np.uint8(0), ("islands", words, int(chosen.sum()), len(chosen)))


def _without_closed_pores(grid: VoxelGrid, wanted: int | str) -> tuple[VoxelGrid, CleanStep]:
    void, beyond = ~grid.solid, None
    if grid.bulk is not None:
        beyond = void & (grid.bulk < 128)
        void &= grid.bulk >= 128
    pieces = _Pieces.of(void, 26, grid.frame.periodic, beyond)
    chosen, words = pieces.marks == 0, "closed"
    if wanted != FILL:
        chosen &= pieces.sizes < int(wanted)
        words += f" and of fewer than {wanted} voxels"
    told = ("closed_pores", words, int(chosen.sum()), len(chosen))
    return _changed(grid, pieces.voxels(chosen), np.uint8(255), told)


def _changed(
    grid: VoxelGrid, voxels: Ints, value: np.uint8, told: tuple[str, str, int, int]
) -> tuple[VoxelGrid, CleanStep]:
    """Return the grid with another fill in some voxels, and what that was."""
    before = float(grid.fill.sum(dtype=np.int64))
    if len(voxels):
        fill = grid.fill.copy()
        fill.reshape(-1)[voxels] = value
        _finish_rim(grid, fill, voxels, value)
        grid = replace(grid, fill=adopted(fill), hausdorff=None)
    change = float(grid.fill.sum(dtype=np.int64)) - before
    frame = grid.frame
    volume, share = change / 255 * frame.voxel_volume, change / before if before else 0.0
    return grid, CleanStep(*told, len(voxels), volume, share, frame.unit)


def _finish_rim(grid: VoxelGrid, fill: Bytes, voxels: Ints, value: np.uint8) -> None:
    """Give voxels of a part the same fill that bordered on what has changed and on no other."""
    partial = (grid.fill > 0) & (grid.fill < 255)
    if not partial.any():
        return
    changed = np.zeros(fill.shape, bool)
    changed.reshape(-1)[voxels] = True
    periodic = grid.frame.periodic
    # A rim of what went is void in part; it stays where solid that stays is next to it.
    rim, rest = (fill < 128, fill >= 128) if value == 0 else (fill >= 128, fill < 128)
    rim &= partial & _grown(changed, periodic)
    fill[rim & ~_grown(rest, periodic)] = value


def _grown(mask: Bools, periodic: Axes) -> Bools:
    """Return the voxels that are in the mask or next to it by a face, an edge or a corner."""
    result = mask.copy()
    for axis in range(3):
        before = np.moveaxis(result.copy(), axis, 0)
        after = np.moveaxis(result, axis, 0)
        after[1:] |= before[:-1]
        after[:-1] |= before[1:]
        if periodic[axis]:
            after[0] |= before[-1]
            after[-1] |= before[0]
    return result


class _Pieces(NamedTuple):
    """Connected pieces of a mask: runs of it with a layer more below periodic axes, and pieces.

    ``numbers`` tell which piece a component of the runs belongs to; ``sizes`` and ``marks`` are of
    pieces. ``shape`` and ``halo`` are of what was labelled.
    """

    runs: Runs
    shape: tuple[int, int, int]
    halo: tuple[int, int, int]
    numbers: Ints
    sizes: Ints
    marks: Ints

    @classmethod
    def of(
        cls, mask: Bools, connectivity: int, periodic: Axes, beyond: Bools | None = None
    ) -> _Pieces:
        """Find the pieces; ``beyond`` are voxels outside of the body."""
        halo = (int(periodic[0]), int(periodic[1]), int(periodic[2]))
        padded = _wrapped(mask, halo)
        runs = label_runs(padded, connectivity)
        shape, sizes = padded.shape, sizes_from(runs, padded.shape, halo)
        marks: Ints = np.zeros(runs.total, np.int64)
        for axis in (a for a in range(3) if not periodic[a]):
            for layer in (0, shape[axis] - 1):
                labels = layer_labels(runs, shape, axis, layer)
                marks[labels[labels > 0] - 1] |= OUTSIDE
        if beyond is not None:
            # What is next to it: as void is joined, by faces, edges and corners.
            near = _grown(_wrapped(beyond, halo), (False, False, False))
            marks[touching(runs, near)] |= OUTSIDE
        if not any(periodic):
            return cls(runs, shape, halo, np.arange(runs.total), sizes, marks)
        one = unite(*_seams(runs, shape, halo), sizes, marks, around=ENDLESS)
        return cls(runs, shape, halo, one.numbers, one.sizes, one.marks)

    def voxels(self, chosen: Bools) -> Ints:
        """Return the numbers of the voxels of some pieces, each once, in raster order."""
        runs, (hx, hy, hz) = self.runs, self.halo
        _, ny, nz = self.shape
        mine: Ints = np.flatnonzero(chosen[self.numbers[runs.labels]])
        starts = np.maximum(runs.starts[mine], hz).astype(np.int64)
        lengths = np.maximum(runs.stops[mine] - starts, 0)
        x, y = np.divmod(runs.rows[mine], ny)
        lengths[(x < hx) | (y < hy)] = 0
        first = ((x - hx) * (ny - hy) + y - hy) * (nz - hz) + starts - hz
        ends = np.cumsum(lengths)
        total = int(ends[-1]) if len(ends) else 0
        return np.repeat(first - (ends - lengths), lengths) + np.arange(total)


def _wrapped(mask: Bools, halo: tuple[int, int, int]) -> Bools:
    return np.pad(mask, [(h, 0) for h in halo], mode="wrap") if any(halo) else mask


def _seams(
    runs: Runs, shape: tuple[int, int, int], halo: tuple[int, int, int]
) -> tuple[Ints, NDArray[np.int32], NDArray[np.int32]]:
    """Return the voxels that were labelled twice: numbers, components, and periods off the grid."""
    layers = zip(*_layers(runs, shape, halo), strict=True)
    voxels, owners, turns = (np.concatenate(parts) for parts in layers)
    order = np.argsort(voxels, kind="stable")
    return voxels[order], owners[order], turns[order]


def _layers(
    runs: Runs, shape: tuple[int, int, int], halo: tuple[int, int, int]
) -> Iterator[tuple[Ints, NDArray[np.int32], NDArray[np.int32]]]:
    """Yield the layers that stand for the same voxels: the last along an axis, and its copy."""
    size = [n - h for n, h in zip(shape, halo, strict=True)]
    for axis in (a for a in range(3) if halo[a]):
        for layer in (0, size[axis]):
            labels = layer_labels(runs, shape, axis, layer)
            where = list(np.nonzero(labels))
            owners = (labels[tuple(where)] - 1).astype(np.int32)
            where.insert(axis, np.full(len(owners), layer))
            split = [np.divmod(i - h, n) for i, h, n in zip(where, halo, size, strict=True)]
            places = tuple(place for _, place in split)
            turns = np.stack([turn for turn, _ in split], axis=1).astype(np.int32)
            yield np.asarray(np.ravel_multi_index(places, size)), owners, turns
