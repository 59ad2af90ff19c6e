"""HDF5: one data set of voxels with attributes.

``fill`` is uint8 with axes (z, y, x), as Fiji and ilastik take images, in chunks compressed by
gzip; ``bulk`` stands beside it where there is one. ``element_size_um`` (z, y, x) is what those two
read as voxel size; ``spacing``, ``origin`` (the outer corner), ``start`` and ``periodic`` are along
(x, y, z). Needs h5py.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.formats._registry import Format
from porous.values import VoxelGrid
from porous.values.units import length_ratio

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

CHUNK = 64
LEVEL = 3
STEP = 1 << 22


def write(grid: VoxelGrid) -> Iterator[bytes]:
    """Write a grid of voxels; the file is put together in memory, compressed."""
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w", libver=("earliest", "v110")) as file:
        file.attrs.update(_attributes(grid))
        for name, values in (("fill", grid.fill), ("bulk", grid.bulk)):
            if values is not None:
                _add(file, name, values, grid)
    view = stream.getbuffer()
    for start in range(0, len(view), STEP):
        yield bytes(view[start : start + STEP])


def _add(file: Any, name: str, values: NDArray[np.uint8], grid: VoxelGrid) -> None:
    turned = values.transpose(2, 1, 0)
    chunks = tuple(min(CHUNK, n) for n in turned.shape)
    data = file.create_dataset(
        name, turned.shape, "u1", chunks=chunks, compression="gzip", compression_opts=LEVEL
    )
    for start in range(0, turned.shape[0], CHUNK):
        data[start : start + CHUNK] = np.ascontiguousarray(turned[start : start + CHUNK])
    for axis, label in enumerate("zyx"):
        data.dims[axis].label = label
    ratio = length_ratio(grid.frame.unit, "um")
    data.attrs["element_size_um"] = np.array([h * ratio for h in grid.frame.spacing[::-1]])


def _attributes(grid: VoxelGrid) -> dict[str, Any]:
    frame = grid.frame
    more = {} if grid.hausdorff is None else {"hausdorff": grid.hausdorff}
    return {
        "spacing": np.array(frame.spacing),
        "origin": np.array(frame.origin),
        "start": np.array(frame.start, dtype=np.int64),
        "periodic": np.array(frame.periodic, dtype=np.uint8),
        "unit": frame.unit,
        "sampling": grid.sampling,
        "sampling_error": grid.sampling_error,
        **more,
    }


FORMAT = Format("HDF5", (".h5", ".hdf5"), writes=(VoxelGrid,), write=write, needs=("h5py",))
