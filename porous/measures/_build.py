"""Which way a body is built: six directions, and its layers in their order."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from porous.errors import GridError, nearest
from porous.memory import check_memory
from porous.values import Measure

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from porous.kernels.spans import Layers
    from porous.measures._sample import Sample
    from porous.values import Frame


@dataclass(frozen=True)
class Direction:
    """A way to build a body: along an axis, upwards from its low end or downwards from its high."""

    axis: int
    up: bool

    @property
    def name(self) -> str:
        """What names of measures end with: ``z_up``: the plate is at the low end of z."""
        return f"{'xyz'[self.axis]}_{'up' if self.up else 'down'}"

    @property
    def words(self) -> str:
        """The same for people: ``+z``."""
        return f"{'+' if self.up else '−'}{'xyz'[self.axis]}"

    @property
    def across(self) -> tuple[int, int]:
        """The two other axes."""
        return {0: (1, 2), 1: (0, 2), 2: (0, 1)}[self.axis]

    def around(self, frame: Frame) -> tuple[bool, bool]:
        """Tell along which axes layers close on themselves."""
        first, second = self.across
        return frame.periodic[first], frame.periodic[second]


def layers_of(kinds: NDArray[np.uint8], directions: Iterable[Direction]) -> dict[Direction, Layers]:
    """Return the layers of a grid in some directions, the first one on the plate.

    Lines of a layer, and voxels of a line, are those along the direction's axes ``across``.
    """
    from porous.kernels.spans import spans

    found, result = {}, {}
    for direction in directions:
        along = direction.across[1]
        if along not in found:
            found[along] = spans(kinds, along)
        result[direction] = found[along].layers(direction.axis, up=direction.up)
    return result


DIRECTIONS = tuple(Direction(axis, up) for axis in range(3) for up in (True, False))
"""The six."""


def directions_of(frame: Frame) -> tuple[Direction, ...]:
    """Return the directions a body may be built in: none along an axis that closes on itself."""
    return tuple(d for d in DIRECTIONS if not frame.periodic[d.axis])


def directions_named(name: str | None, frame: Frame) -> tuple[Direction, ...]:
    """Return the direction of that name (``z_up``), or all there are of a frame.

    Raises
    ------
    GridError
        For an unknown one, or one along a periodic axis.
    """
    if name is None:
        return directions_of(frame)
    known = {d.name: d for d in DIRECTIONS}
    if name not in known:
        raise GridError(f"direction: got {name!r}{nearest(name, known)}")
    if known[name] not in directions_of(frame):
        raise GridError(
            f"direction: got {name!r}; wanted one along which the frame is not periodic: a body "
            "without end stands on no plate"
        )
    return (known[name],)


def paired(
    sample: Sample, take: Callable[[Sample], Sequence[float]]
) -> Iterator[tuple[float, float]]:
    """Yield numbers of a sample, each with how far it is from that at half the resolution.

    Infinitely far where the grid is too small to be halved.
    """
    fine = take(sample)
    coarse = [math.inf] * len(fine) if sample.coarse is None else take(sample.coarse)
    for here, there in zip(fine, coarse, strict=True):
        yield here, abs(here - there)


def row(name: str, value: float, unit: str, method: str, doubt: float) -> Measure:
    """Return a measure of a grid with its standard uncertainty."""
    return Measure(name, value, unit, method, doubt, "standard", "grid")


def check_room(frame: Frame, each: float, what: str) -> None:
    """Raise ``MemoryLimitError`` where there are not so many bytes for each voxel."""
    size = " × ".join(map(str, frame.shape))
    check_memory(frame.size * each, f"{what} of {size} voxels", "Use fewer voxels, or a part.")


def angle_of(overhang: float) -> float:
    """Return an angle to the plate, in degrees, that is one.

    Raises
    ------
    GridError
        Where it is not above 0 and below 90.
    """
    if not 0 < overhang < 90:
        raise GridError(f"overhang: got {overhang}; wanted an angle to the plate between 0 and 90°")
    return float(overhang)
