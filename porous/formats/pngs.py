"""PNG slices: a folder of one grey picture for each layer of voxels; what resin printers expose.

``slice-00000.png`` is the lowest layer. A picture is seen from above: x runs to the right, y
upwards, so its first row holds the voxels of the largest y. Grey is the fill: 0 is void and dark,
255 is solid and cured. ``slices.json`` comes last and says how large a pixel and a layer are, in
the grid's own unit; the pictures say the size of a pixel too, to a whole number of pixels a metre.
"""

from __future__ import annotations

import json
import struct
import zlib
from typing import TYPE_CHECKING

import numpy as np

from porous.formats._registry import Format
from porous.formats._series import SIGNATURE, members, read_image
from porous.values import VoxelGrid
from porous.values.units import METRES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

GREY = (8, 0, 0, 0, 0)
"""Eight bits, grey, and the only ways to pack, filter and interlace."""
MOST = 2**31 - 1
METRE = 1
DIGITS = 5


def write_files(grid: VoxelGrid, _: str) -> Iterator[tuple[str, Iterable[bytes]]]:
    """Give a picture of each layer, from the lowest up, and what is to be known of them."""
    digits = max(DIGITS, len(str(grid.frame.shape[2] - 1)))
    names = [f"slice-{layer:0{digits}}.png" for layer in range(grid.frame.shape[2])]
    density = _density(grid)
    for layer, name in enumerate(names):
        yield name, (_picture(grid.fill[:, ::-1, layer].T, density),)
    yield "slices.json", (json.dumps(_known(grid, names), indent=1).encode() + b"\n",)


def _known(grid: VoxelGrid, names: list[str]) -> dict[str, object]:
    (width, height, layers), (x, y, z) = grid.frame.shape, grid.frame.spacing
    return {
        "format": "porous slices",
        "unit": grid.frame.unit,
        "pixel_width": x,
        "pixel_height": y,
        "layer_height": z,
        "width": width,
        "height": height,
        "layers": layers,
        "lower": list(grid.frame.box.lower),
        "grey": "0 is void, 255 is solid",
        "first_row": "largest y",
        "slices": names,
    }


def _picture(rows: NDArray[np.uint8], density: bytes) -> bytes:
    """Return a PNG of grey rows, (height, width), none of them filtered."""
    height, width = rows.shape
    lines = np.zeros((height, width + 1), np.uint8)  # before each row stands how it is filtered
    lines[:, 1:] = rows
    return b"".join(
        (
            SIGNATURE,
            _chunk(b"IHDR", struct.pack(">II5B", width, height, *GREY)),
            density,
            _chunk(b"IDAT", zlib.compress(lines.tobytes(), 6)),
            _chunk(b"IEND", b""),
        )
    )


def _density(grid: VoxelGrid) -> bytes:
    """Return the chunk that says how many pixels a metre has, where such numbers can."""
    metre = METRES[grid.frame.unit]
    counts = [round(1 / (size * metre)) for size in grid.frame.spacing[:2]]
    if not all(1 <= count <= MOST for count in counts):
        return b""
    return _chunk(b"pHYs", struct.pack(">IIB", *counts, METRE))


def _chunk(kind: bytes, data: bytes) -> bytes:
    body = kind + data
    return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))


FORMAT = Format(
    "PNG slices",
    (".pngs",),
    writes=(VoxelGrid,),
    write_files=write_files,
    folder=True,
    read_image=read_image,
    members=members,
)
