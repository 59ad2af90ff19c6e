"""OME-Zarr: a folder of chunks, as napari, Fiji and neuroglancer take it.

OME-NGFF 0.5 on Zarr 3: axes z, y, x; one level at full resolution; scale and translation in the
grid's unit, where the translation is the centre of the first voxel. Chunks are uint8 compressed by
gzip, and each is there even where it is empty, so that a lost one is noticed. The bulk is a label
image. What NGFF has no word for stands in the attribute ``porous``. https://ngff.openmicroscopy.org/0.5/
"""

from __future__ import annotations

import itertools
import json
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.formats import _image as images
from porous.formats._registry import Format
from porous.values import VoxelGrid

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.formats._registry import File
    from porous.values import Frame

VERSION = "0.5"
CHUNK, LEVEL, GZIP = 128, 3, 31
UNITS = {
    "nm": "nanometer",
    "um": "micrometer",
    "mm": "millimeter",
    "cm": "centimeter",
    "m": "meter",
    "in": "inch",
}
"""What NGFF calls units of length."""
AXES = "zyx"


def write_files(grid: VoxelGrid, name: str) -> Iterator[File]:
    """Write a grid of voxels as a folder."""
    frame = grid.frame
    title = name.removesuffix(".ome.zarr")
    yield from _array("0", grid.fill)
    if grid.bulk is not None:
        yield from _array("labels/bulk/0", grid.bulk)
        source = {"image-label": {"source": {"image": "../../"}}}
        yield _group("labels/bulk/", {"ome": {**_multiscale(frame, "bulk"), **source}})
        yield _group("labels/", {"ome": {"version": VERSION, "labels": ["bulk"]}})
    mark = json.loads(images.mark_of(grid))
    yield _group("", {"ome": _multiscale(frame, title), "porous": mark})


def _multiscale(frame: Frame, name: str) -> dict[str, Any]:
    axes = [{"name": axis, "type": "space", "unit": UNITS[frame.unit]} for axis in AXES]
    placed = [
        {"type": "scale", "scale": list(frame.spacing[::-1])},
        {"type": "translation", "translation": list(images.first_centre(frame)[::-1])},
    ]
    level = {"path": "0", "coordinateTransformations": placed}
    return {"version": VERSION, "multiscales": [{"name": name, "axes": axes, "datasets": [level]}]}


def _group(path: str, attributes: dict[str, Any]) -> File:
    return _json(path, {"zarr_format": 3, "node_type": "group", "attributes": attributes})


def _json(path: str, content: dict[str, Any]) -> File:
    return f"{path}zarr.json", [json.dumps(content, indent=2).encode("ascii") + b"\n"]


def _array(path: str, values: NDArray[np.uint8]) -> Iterator[File]:
    turned = values.transpose(2, 1, 0)
    chunk = [min(CHUNK, n) for n in turned.shape]
    gzip = {"name": "gzip", "configuration": {"level": LEVEL}}
    yield _json(
        f"{path}/",
        {
            "zarr_format": 3,
            "node_type": "array",
            "shape": list(turned.shape),
            "data_type": "uint8",
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": chunk}},
            "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
            "fill_value": 0,
            "codecs": [{"name": "bytes"}, gzip],
            "dimension_names": list(AXES),
            "attributes": {},
        },
    )
    counts = (range(-(-n // c)) for n, c in zip(turned.shape, chunk, strict=True))
    for place in itertools.product(*counts):
        yield f"{path}/c/{'/'.join(map(str, place))}", [_chunk(turned, place, chunk)]


def _chunk(values: NDArray[np.uint8], place: tuple[int, ...], chunk: list[int]) -> bytes:
    box = tuple(slice(i * c, (i + 1) * c) for i, c in zip(place, chunk, strict=True))
    part = values[box]
    whole = np.zeros(chunk, np.uint8)  # the last chunks reach beyond the grid
    whole[tuple(slice(n) for n in part.shape)] = part
    machine = zlib.compressobj(LEVEL, zlib.DEFLATED, GZIP)
    return machine.compress(whole.tobytes()) + machine.flush()


FORMAT = Format(
    "OME-Zarr",
    (".ome.zarr",),
    writes=(VoxelGrid,),
    write_files=write_files,
    folder=True,
)
