"""Islands: pieces of a layer that are printed in the air, for six directions to build a body in."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from porous.measures._build import (
    Direction,
    angle_of,
    check_room,
    directions_named,
    layers_of,
    paired,
    row,
)
from porous.measures._sample import Sample, Survey
from porous.values import Curve, Measures

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from porous.kernels.spans import Layers
    from porous.measures._sample import Progress
    from porous.values import Frame, VoxelGrid

METHOD = "voxel layers"

EACH = 3.0
"""Bytes per voxel that spans of solid take."""


def islands(
    grid: VoxelGrid,
    *,
    direction: str | None = None,
    overhang: float = 45.0,
    progress: Progress | None = None,
) -> Measures:
    """Return what hangs in the air while a body is built layer by layer.

    An island is a piece of a layer of voxels, joined by edges of its pixels, that has no solid
    within reach in the layer below: under it, or as far beside as a face at the angle ``overhang``
    to the plate leads in one layer, height / tan(overhang), from centre to centre. The first layer
    with a solid voxel lies on the plate. What hangs in the air is islands, and all that stands on
    nothing else, up to the layer where it grows together with what stands on the plate.

    Parameters
    ----------
    grid
        The body; any spacing. Layers close on themselves along periodic axes.
    direction
        ``"z_up"`` is built upwards along z, its plate at the low end; ``"z_down"`` from the high
        end. x and y as well; all six where not given.
    overhang
        Angle to the plate, in degrees, below which a face needs support.
    progress
        Called as ``progress("islands", done)``; raising in it cancels.

    Returns
    -------
    Measures
        unsupported_islands_z_up, the number of islands, and unsupported_volume_z_up, in the grid's
        unit cubed, of all that hangs in the air; so for each direction, but for those along
        periodic axes. The uncertainty is the difference to half the resolution, and of volumes a
        voxel for each island; infinite where the grid cannot be halved.

    Raises
    ------
    GridError
        For an unknown direction or one along a periodic axis, or an angle that is not between 0
        and 90°.
    MemoryLimitError
        Where there is too little memory.
    """
    how = Survey(overhang=angle_of(overhang))
    directions = directions_named(direction, grid.frame)
    return grid_islands(Sample(grid, how=how, progress=progress), directions)[0]


def grid_islands(
    sample: Sample, directions: Sequence[Direction]
) -> tuple[Measures, tuple[Curve, ...]]:
    """Return the rows of a grid, and islands by height."""
    check_room(sample.frame, EACH, "islands")
    rows, curves = [], []
    solid = {
        id(of): layers_of(of.grid.solid.view(np.uint8), directions)
        for of in (sample, sample.coarse)
        if of is not None
    }
    voxel, unit = sample.frame.voxel_volume, f"{sample.frame.unit}³"
    for place, direction in enumerate(directions):

        def told(done: int, count: int, place: int = place) -> None:
            sample.tell("islands", (place + done / count) / len(directions))

        layers = _hanging(sample, solid[id(sample)][direction], direction, told)
        curves.append(_curve(sample.frame, direction, layers))

        def totals(
            of: Sample,
            direction: Direction = direction,
            here: Sample = sample,
            layers: NDArray[np.int64] = layers,
        ) -> tuple[float, float]:
            found = layers if of is here else _hanging(of, solid[id(of)][direction], direction)
            return float(found[:, 0].sum()), float(found[:, 2].sum()) * of.frame.voxel_volume

        (count, count_doubt), (volume, volume_doubt) = paired(sample, totals)
        # A voxel more or less under each island is nobody's to tell.
        volume_doubt = math.hypot(volume_doubt, voxel * count)
        name = direction.name
        rows.append(row(f"unsupported_islands_{name}", count, "1", METHOD, count_doubt))
        rows.append(row(f"unsupported_volume_{name}", volume, unit, METHOD, volume_doubt))
    return Measures(tuple(rows)), tuple(curves)


def _hanging(
    sample: Sample,
    layers: Layers,
    direction: Direction,
    told: Callable[[int, int], None] | None = None,
) -> NDArray[np.int64]:
    from porous.kernels.layers import hanging

    frame = sample.frame
    return hanging(
        layers,
        _reach(frame, direction, sample.how.overhang),
        periodic=direction.around(frame),
        progress=told,
    )


def _reach(frame: Frame, direction: Direction, angle: float) -> NDArray[np.int64]:
    """Return the steps to voxels of the layer below that carry a voxel, the nearest first."""
    length = frame.spacing[direction.axis] / math.tan(math.radians(angle)) * (1 + 1e-9)
    edges = [frame.spacing[a] for a in direction.across]
    most = [
        min(int(length / h), frame.shape[a]) for h, a in zip(edges, direction.across, strict=True)
    ]
    steps = np.indices([2 * n + 1 for n in most]).reshape(2, -1).T - most
    squares = ((steps * edges) ** 2).sum(axis=1)
    near = squares <= length**2
    order = np.argsort(squares[near], kind="stable")
    return np.asarray(steps[near][order], np.int64)


def _curve(frame: Frame, direction: Direction, layers: NDArray[np.int64]) -> Curve:
    height = frame.spacing[direction.axis]
    return Curve(
        "islands_by_layer",
        f"built along {direction.words}",
        np.asarray(np.arange(len(layers)) * height, np.float64),
        layers[:, 0].astype(np.float64),
        "height",
        frame.unit,
        "islands",
        "1",
        METHOD,
        drawn="steps",
    )
