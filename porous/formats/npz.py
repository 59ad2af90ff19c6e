"""NPZ: numpy's zip of arrays; what scripts exchange.

``fill`` (uint8, axes x, y, z) and ``spacing`` (three lengths) must be there; ``origin``, ``unit``
and ``sampling`` have defaults; ``bulk``, ``hausdorff``, ``sampling_error``, ``periodic`` and
``start`` stand where they say more than the defaults. ``numpy.load`` reads it. The same grid gives
the same bytes. Pickles are never read.
"""

from __future__ import annotations

import io
import math
import re
import zipfile
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from porous.formats._registry import Format
from porous.formats._zip import EPOCH, METHODS, check_directory, damage
from porous.formats.gate import need, refuse
from porous.memory import check_memory
from porous.values import Frame, VoxelGrid
from porous.values.image import Image

if TYPE_CHECKING:
    from collections.abc import Iterator
    from zipfile import ZipFile, ZipInfo

    from numpy.typing import NDArray

    from porous.formats.gate import Source

STEP = 1 << 20
MAGIC = b"\x93NUMPY"
HEAD, AXES = 4096, 3
OURS = frozenset(
    ("bulk", "hausdorff", "sampling_error", "periodic", "start", "spacing", "origin", "unit")
) | {"sampling"}
"""What stands beside the voxels in an archive."""
DESCRIPTION = re.compile(
    r"\{'descr': '([<>|=]?(?:b1|[iu][1248]|f[248]|U[1-9][0-9]{0,3}))', "
    r"'fortran_order': (True|False), "
    r"'shape': \(((?:[0-9]{1,18}, ?)*(?:[0-9]{1,18})?)\),? ?\}\s*"
)


def read(source: Source) -> VoxelGrid:
    """Read a grid of voxels."""
    with _opened(source) as archive:
        return _grid(_Arrays(archive))


def read_image(source: Source) -> Image:
    """Read the grey values as they are: of ``fill``, or of the one array of three axes."""
    with _opened(source) as archive:
        return _image(_Arrays(archive), source)


def _opened(source: Source) -> ZipFile:
    check_directory(source.data)
    with damage("the archive"):
        return zipfile.ZipFile(io.BytesIO(source.data))


def write(grid: VoxelGrid) -> Iterator[bytes]:
    """Write a grid of voxels, compressed."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in _arrays(grid).items():
            info = zipfile.ZipInfo(f"{name}.npy", EPOCH)
            info.compress_type, info.create_system = zipfile.ZIP_DEFLATED, 3
            with archive.open(info, "w", force_zip64=array.nbytes >= 2**31) as member:
                np.lib.format.write_array(member, array, version=(1, 0), allow_pickle=False)
    yield stream.getvalue()


def _arrays(grid: VoxelGrid) -> dict[str, NDArray[Any]]:
    frame = grid.frame
    more: dict[str, Any] = {
        "bulk": grid.bulk,
        "hausdorff": None if grid.hausdorff is None else np.float64(grid.hausdorff),
        "sampling_error": np.float64(grid.sampling_error) if grid.sampling_error else None,
        "periodic": np.array(frame.periodic) if any(frame.periodic) else None,
        "start": np.array(frame.start, dtype=np.int64) if any(frame.start) else None,
    }
    return {
        "fill": grid.fill,
        "spacing": np.array(frame.spacing),
        "origin": np.array(frame.origin),
        "unit": np.array(frame.unit),
        "sampling": np.array(grid.sampling),
        **{name: np.asarray(value) for name, value in more.items() if value is not None},
    }


def _grid(arrays: _Arrays) -> VoxelGrid:
    if missing := [name for name in ("fill", "spacing") if name not in arrays.members]:
        got = ", ".join(arrays.members) or "none"
        refuse("arrays", got, f"{' and '.join(missing)}, as in np.savez(…, fill=…, spacing=…)")
    fill, bulk = arrays.voxels("fill"), arrays.voxels("bulk")
    assert fill is not None
    frame = Frame(
        arrays.three("origin", (0.0, 0.0, 0.0)),
        arrays.three("spacing", (1.0, 1.0, 1.0)),
        fill.shape,
        arrays.three("periodic", (False, False, False)),
        arrays.word("unit", "mm"),
        arrays.three("start", (0, 0, 0)),
    )
    binary = not ((fill > 0) & (fill < 255)).any()
    sampling = arrays.word("sampling", "centre" if binary else "fill")
    bound, error = arrays.distance("hausdorff"), arrays.distance("sampling_error")
    return VoxelGrid(frame, fill, bulk, sampling, bound, error or 0.0)


def _image(arrays: _Arrays, source: Source) -> Image:
    values = arrays.grey()
    if "spacing" not in arrays.members:
        source.note("it says no voxel size; taken as 1 mm along x, y and z")
    spacing = arrays.three("spacing", (1.0, 1.0, 1.0))
    start, origin = (arrays.three(name, (0.0, 0.0, 0.0)) for name in ("start", "origin"))
    x, y, z = (o + a * h for o, a, h in zip(origin, start, spacing, strict=True))
    return Image(values, spacing, (x, y, z), arrays.word("unit", "mm"))


class _Arrays:
    """The arrays of an archive by name, read when they are asked for."""

    def __init__(self, archive: ZipFile) -> None:
        infos = archive.infolist()
        self.archive = archive
        self.members = {info.filename.removesuffix(".npy"): info for info in infos}
        if len(self.members) < len(infos):
            refuse("members", ", ".join(info.filename for info in infos), "each name once")

    def voxels(self, name: str) -> NDArray[np.uint8] | None:
        if name not in self.members:
            return None
        values = self._read(name)
        if values.ndim != 3 or values.dtype not in (bool, np.uint8):
            refuse(name, f"{values.dtype} of shape {values.shape}", "uint8 or bool, three axes")
        return values * np.uint8(255) if values.dtype == bool else values

    def grey(self) -> NDArray[Any]:
        """Return the one array that can be an image."""
        names = ["fill"] if "fill" in self.members else [n for n in self.members if n not in OURS]
        if len(names) != 1:
            got = ", ".join(self.members) or "none"
            refuse("arrays", got, "the grey values as fill, or as the only array besides our own")
        values = self._read(names[0])
        if values.ndim != AXES or values.dtype.kind not in "biuf":
            got = f"{values.dtype} of shape {values.shape}"
            refuse(names[0], got, "numbers on three axes")
        return values

    def three(self, name: str, default: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
        if name not in self.members:
            return default
        values = self._read(name)
        if values.shape != (3,) or values.dtype.kind == "U":
            refuse(name, f"{values.dtype} of shape {values.shape}", "three numbers")
        x, y, z = values.tolist()
        return x, y, z

    def word(self, name: str, default: str) -> str:
        if name not in self.members:
            return default
        values = self._read(name)
        if values.shape != () or values.dtype.kind != "U":
            refuse(name, f"{values.dtype} of shape {values.shape}", "one text")
        return str(values)

    def distance(self, name: str) -> float | None:
        if name not in self.members:
            return None
        values = self._read(name)
        if values.shape != () or values.dtype.kind == "U":
            refuse(name, f"{values.dtype} of shape {values.shape}", "one number")
        return float(values)

    def _read(self, name: str) -> NDArray[Any]:
        info = self.members[name]
        if info.compress_type not in METHODS:
            refuse(f"compression of {name}", info.compress_type, "stored (0) or deflated (8)")
        need(info.file_size, METHODS[info.compress_type] * info.compress_size, name)
        with damage(name), self.archive.open(info) as member:
            form, turned, shape, left = _described(member, info, name)
            count = math.prod(shape)
            if count * form.itemsize != left:
                wanted = f"{count * form.itemsize}, as its header says"
                refuse(f"bytes of {name}", left, wanted)
            check_memory(2 * left, f"the array {name}", "Cut it into parts.")
            values = np.frombuffer(_taken(member, left, name), form)
        values = values.astype(form.newbyteorder("="), copy=False)
        return values.reshape(shape, order="F" if turned else "C")


def _described(
    member: IO[bytes], info: ZipInfo, name: str
) -> tuple[np.dtype[Any], bool, tuple[int, ...], int]:
    """Return dtype, Fortran order, shape, and how many bytes follow the header of an array."""
    head = member.read(8)
    width = 2 if head[6:7] == b"\1" else 4
    if len(head) < 8 or not head.startswith(MAGIC) or head[6] not in (1, 2, 3):
        refuse(f"first bytes of {name}", head, "those of an .npy file, version 1 to 3")
    length = int.from_bytes(member.read(width), "little")
    need(length, min(HEAD, info.file_size), f"the header of {name}")
    text = member.read(length).decode("latin-1")
    match = DESCRIPTION.fullmatch(text)
    if match is None:
        refuse(f"header of {name}", text.strip(), "an array of plain numbers or texts")
    shape = tuple(int(word) for word in match[3].split(",") if word.strip())
    if len(shape) > AXES:
        refuse(f"shape of {name}", shape, f"at most {AXES} axes")
    return np.dtype(match[1]), match[2] == "True", shape, info.file_size - 8 - width - length


def _taken(member: IO[bytes], size: int, name: str) -> bytearray:
    result = bytearray(size)
    view, done = memoryview(result), 0
    while piece := member.read(STEP):  # the read that gives nothing checks the sum of the member
        if done + len(piece) > size:
            break
        view[done : done + len(piece)] = piece
        done += len(piece)
    if done != size:
        refuse(f"bytes of {name}", done, f"{size}")
    return result


FORMAT = Format(
    "NumPy archive", (".npz",), VoxelGrid, read, (VoxelGrid,), write, read_image=read_image
)
