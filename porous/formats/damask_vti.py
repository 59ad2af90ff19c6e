"""DAMASK's grid: VTK image data with the number of a material in each voxel.

Material 0 is the pore and material 1 the solid (fill of 128 and more): the first and the second
entry of the list ``material`` in ``material.yaml``. Lengths are in metres. The arrays stand in
place in base64, compressed by zlib, with the first voxel at the first corner: DAMASK's own
reader takes no others. Its solver takes every grid as periodic; how the grid was sampled, its bulk
and its periods are not kept.
"""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING

import numpy as np

from porous.formats import _image as images
from porous.formats._registry import Format
from porous.values import VoxelGrid
from porous.values.units import length_ratio

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

SOLID = 128
BLOCK = 3 << 18
"""Bytes of a block before it is compressed; what is in base64 comes in threes."""


def write(grid: VoxelGrid) -> Iterator[bytes]:
    """Write a grid of voxels as pore (0) and solid (1)."""
    frame = grid.frame
    ratio = length_ratio(frame.unit, "m")
    extent = " ".join(f"0 {n}" for n in frame.shape)
    head = 'version="1.0" byte_order="LittleEndian" header_type="UInt64"'
    yield (
        '<?xml version="1.0"?>\n'
        f'<VTKFile type="ImageData" {head} compressor="vtkZLibDataCompressor">\n'
        f'  <ImageData WholeExtent="{extent}" Origin="{_spell(frame.box.lower, ratio)}"'
        f' Spacing="{_spell(frame.spacing, ratio)}" Direction="1 0 0 0 1 0 0 0 1">\n'
        f'    <Piece Extent="{extent}">\n'
        "      <PointData>\n      </PointData>\n"
        '      <CellData Scalars="material">\n'
        '        <DataArray type="Int32" Name="material" format="binary">\n'
    ).encode("ascii")
    blocks = list(images.in_parallel(_blocks(grid)))
    sizes = [len(blocks), BLOCK, 4 * frame.size % BLOCK, *map(len, blocks)]
    yield base64.b64encode(np.array(sizes, "<u8").tobytes())
    yield from _in_base64(blocks)
    yield (b"\n        </DataArray>\n      </CellData>\n    </Piece>\n  </ImageData>\n</VTKFile>\n")


def _spell(values: Iterable[float], ratio: float) -> str:
    return " ".join(repr(value * ratio) for value in values)


def _blocks(grid: VoxelGrid) -> Iterator[bytes]:
    """Give the numbers of materials in blocks of the same size, but for the last."""
    left = b""
    for piece in images.layers(grid.fill):
        numbers = (np.frombuffer(piece, np.uint8) >= SOLID).astype("<i4").tobytes()
        left += numbers
        whole = len(left) // BLOCK * BLOCK
        yield from (left[k : k + BLOCK] for k in range(0, whole, BLOCK))
        left = left[whole:]
    if left:
        yield left


def _in_base64(blocks: list[bytes]) -> Iterator[bytes]:
    """Give blocks as one text: each piece but the last is of threes, so that none is padded."""
    left = b""
    for block in blocks:
        left += block
        whole = len(left) // 3 * 3
        yield base64.b64encode(left[:whole])
        left = left[whole:]
    yield base64.b64encode(left)


FORMAT = Format("DAMASK grid", (".damask.vti",), writes=(VoxelGrid,), write=write)
