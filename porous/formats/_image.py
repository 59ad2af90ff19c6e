"""What formats of images share: the order of bytes, what is kept of a grid, and what is solid.

Images of others hold grey values. One of two values is taken as solid and void, the larger one
solid; more need a threshold, which is for a model to choose. What porous writes carries a *mark*:
a line of JSON with all that the format has no field for, and a sum of the voxels. Where the sum is
right, the fill is taken as it stands; where somebody has changed the voxels, the mark is void.
"""

from __future__ import annotations

import json
import math
import os
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.errors import FormatError
from porous.formats.gate import need, refuse
from porous.memory import check_memory
from porous.values import Frame, VoxelGrid
from porous.values.units import length_ratio

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from porous.formats.gate import Source
    from porous.values.image import Image

    Vector = tuple[float, float, float]

LEVEL = 3
MARK = 4096
"""The longest mark that is read, in characters."""
LAYERS, SLAB = 64, 1 << 26
"""How many layers of voxels are turned at once, and how many bytes at most."""
CLOSE = 1e-6
"""How far, in voxels, what a format's own fields say may lie from the mark: they are rounded."""
NAMES = {
    **dict.fromkeys(("nm", "nanometer", "nanometre", "nanometers"), "nm"),
    **dict.fromkeys(("um", "µm", "μm", "micron", "microns", "micrometer", "micrometre"), "um"),
    **dict.fromkeys(("mm", "millimeter", "millimetre", "millimeters"), "mm"),
    **dict.fromkeys(("cm", "centimeter", "centimetre", "centimeters"), "cm"),
    **dict.fromkeys(("m", "meter", "metre", "meters"), "m"),
    **dict.fromkeys(("in", "inch", "inches"), "in"),
}
"""What units of length are called, in small letters."""


@dataclass(frozen=True)
class Mark:
    """What a file that porous has written says: the mark's entries, and the bulk if it has one."""

    entries: dict[str, Any]
    bulk: NDArray[np.uint8] | None = None


# --- writing -----------------------------------------------------------------------------------


def layers(values: NDArray[np.uint8]) -> Iterator[bytes]:
    """Give voxels in the order of image files, x fastest and z slowest, some layers at a time."""
    step = max(1, min(LAYERS, SLAB // (values.shape[0] * values.shape[1])))
    for start in range(0, values.shape[2], step):
        yield np.ascontiguousarray(values[:, :, start : start + step].transpose(2, 1, 0)).tobytes()


def packed(values: NDArray[np.uint8], kind: int) -> Iterator[bytes]:
    """Give the voxels compressed in one stream; ``kind`` is zlib's window, 15 or 31 for gzip."""
    machine = zlib.compressobj(LEVEL, zlib.DEFLATED, kind)
    for piece in layers(values):
        yield machine.compress(piece)
    yield machine.flush()


def in_parallel(pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Give pieces compressed by zlib each, in their order, a few ahead of who takes them."""
    count = len(os.sched_getaffinity(0))
    with ThreadPoolExecutor(count) as pool:
        waiting = []
        for piece in pieces:
            waiting.append(pool.submit(zlib.compress, piece, LEVEL))
            if len(waiting) > 2 * count:
                yield waiting.pop(0).result()
        for done in waiting:
            yield done.result()


def mark_of(grid: VoxelGrid, **more: Any) -> str:
    """Return the mark of a grid: one line of JSON in ASCII, without spaces."""
    entries = {
        "porous": 1,
        "crc32": sum_of(grid.fill),
        "bulk": None if grid.bulk is None else sum_of(grid.bulk),
        "shape": grid.frame.shape,
        "unit": grid.frame.unit,
        "origin": grid.frame.origin,
        "spacing": grid.frame.spacing,
        "start": grid.frame.start,
        "periodic": grid.frame.periodic,
        "sampling": grid.sampling,
        "hausdorff": grid.hausdorff,
        "sampling_error": grid.sampling_error,
        **more,
    }
    return json.dumps(entries, separators=(",", ":"))


def sum_of(values: NDArray[np.uint8]) -> int:
    """Return the CRC-32 of voxels in our own order, z fastest."""
    return zlib.crc32(np.ascontiguousarray(values).data)


def first_centre(frame: Frame) -> Vector:
    """Return the centre of the first voxel, which others call the origin."""
    x, y, z = (low + h / 2 for low, h in zip(frame.box.lower, frame.spacing, strict=True))
    return x, y, z


# --- reading -----------------------------------------------------------------------------------


def entries_of(text: str | None) -> dict[str, Any] | None:
    """Return what a mark says; None where there is none that can be read."""
    if text is None or len(text) > MARK:
        return None
    try:
        entries = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return entries if isinstance(entries, dict) and entries.get("porous") == 1 else None


def shape_of(sizes: Iterable[int], what: str) -> tuple[int, int, int]:
    """Return three numbers of voxels, all at least 1."""
    given = list(sizes)
    if len(given) != 3 or min(given) < 1:
        refuse(what, " ".join(map(str, given)), "three numbers of voxels, at least 1 each")
    x, y, z = given
    return x, y, z


def check_size(shape: tuple[int, int, int], width: int, most: int) -> int:
    """Return how many bytes the voxels take; refuse more than ``most``, or than there is memory."""
    size = math.prod(shape) * width
    what = f"an image of {' × '.join(map(str, shape))} voxels"
    need(size, most, what)
    check_memory(3 * size, what, "Cut it into parts.")
    return size


def axes_of(directions: NDArray[np.float64], what: str) -> tuple[Vector, tuple[bool, ...]]:
    """Return the spacing that three directions stand for, and which axes run backwards."""
    if not np.isfinite(directions).all() or not directions.any(axis=1).all():
        refuse(what, directions.tolist(), "three directions, finite and not zero")
    lengths = np.abs(np.diag(directions))
    if (np.abs(directions - np.diag(np.diag(directions))) > CLOSE * lengths.min()).any():
        refuse(what, directions.tolist(), "directions along x, y and z; resample what is turned")
    x, y, z = lengths.tolist()
    return (x, y, z), tuple((np.diag(directions) < 0).tolist())


def forwards(
    values: NDArray[Any], centre: Vector, spacing: Vector, flips: tuple[bool, ...]
) -> tuple[NDArray[Any], Vector]:
    """Return voxels whose axes all run forwards, and the outer corner of the first of them."""
    corner = []
    for n, c, h, flip in zip(values.shape, centre, spacing, flips, strict=True):
        corner.append((c - (n - 1) * h if flip else c) - h / 2)
    x, y, z = corner
    return values[tuple(slice(None, None, -1 if flip else None) for flip in flips)], (x, y, z)


def unit_of(name: str, what: str) -> str:
    """Return the unit of length of a name."""
    unit = NAMES.get(name.strip().lower())
    return unit if unit is not None else refuse(what, name, "a unit of length, such as mm or um")


def grid_of(image: Image, mark: Mark | None, source: Source) -> VoxelGrid:
    """Return the grid that an image is: porous' own as it was, others' by the two-value rule.

    Raises
    ------
    FormatError
        For more than two grey values, and for values that are no numbers.
    """
    if mark is not None:
        if (grid := _own(image, mark, source)) is not None:
            return grid
        source.note("its voxels are not those that porous wrote; read as an image of any program")
    return _two_values(image, source)


def _own(image: Image, mark: Mark, source: Source) -> VoxelGrid | None:
    """Return the grid that porous wrote, None where the voxels are others now."""
    fill = np.ascontiguousarray(image.values)
    entries = mark.entries
    same = fill.dtype == np.uint8 and entries.get("shape") == list(fill.shape)
    if not same or entries.get("crc32") != sum_of(fill):
        return None
    bulk = None if mark.bulk is None else np.ascontiguousarray(mark.bulk)
    if bulk is None and entries.get("bulk") is not None:
        source.note("the bulk is not in it any more; porosity will refer to the whole box")
    elif entries.get("bulk") != (None if bulk is None else sum_of(bulk)):
        raise FormatError("the bulk is damaged: it is not what porous wrote")
    names = ("origin", "spacing", "start", "periodic", "unit", "sampling")
    if missing := [name for name in (*names, "hausdorff", "sampling_error") if name not in entries]:
        refuse("porous' mark", ", ".join(entries), f"{', '.join(missing)} as well")
    try:
        said = Frame(
            entries["origin"],
            entries["spacing"],
            image.shape,
            entries["periodic"],
            str(entries["unit"]),
            entries["start"],
        )
        frame = said if _agree(said, image) else _frame(image, said.periodic)
        more = entries["sampling"], entries["hausdorff"], entries["sampling_error"]
        return VoxelGrid(frame, fill, bulk, *more)
    except TypeError as error:
        raise FormatError(f"porous' mark: {error}") from None


def _agree(said: Frame, image: Image) -> bool:
    """Whether a mark's frame is that of the file's own fields, which somebody may have changed."""
    ratio = length_ratio(image.unit, said.unit)
    return all(
        math.isclose(h, k * ratio, rel_tol=CLOSE)
        and abs(a - b * ratio) <= CLOSE * max(h, abs(a), abs(o))
        for h, k, a, b, o in zip(
            said.spacing, image.spacing, said.box.lower, image.origin, said.origin, strict=True
        )
    )


def _frame(image: Image, periodic: tuple[bool, bool, bool] = (False, False, False)) -> Frame:
    return Frame(image.origin, image.spacing, image.shape, periodic, image.unit)


def _two_values(image: Image, source: Source) -> VoxelGrid:
    values = image.values
    low, high = values.min(), values.max()
    if values.dtype.kind == "f" and not np.isfinite([low, high]).all():
        bad = int(values.size - np.isfinite(values).sum())
        raise FormatError(f"grey values: {bad} of them are not finite; wanted numbers")
    solid = values == high
    if not (solid | (values == low)).all():
        raise FormatError(
            f"got {_levels(values)} grey levels, from {low} to {high}; wanted a segmented image of "
            "two values, pore and solid; or give it a threshold: porous make FILE --set "
            "model.threshold=otsu -o FOLDER"
        )
    if low == high:
        solid = np.full(values.shape, bool(high))
        source.note(f"all voxels hold {high}; taken as all {'solid' if high else 'void'}")
    elif values.dtype != bool:
        source.note(f"two grey values, {low} and {high}; the larger is taken as solid")
    return VoxelGrid.of_solid(solid, _frame(image))


def _levels(values: NDArray[Any]) -> str:
    if values.dtype.kind == "f":
        return "more than two"
    small = values.dtype.itemsize <= 2
    levels = len(np.unique(values)) if small or values.size < SLAB >> 3 else 0
    return str(levels) if levels else "more than two"
