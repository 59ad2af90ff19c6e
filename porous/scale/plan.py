"""What a store is going to hold: everything that identifies the work, before any of it is done."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from importlib.metadata import version
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.errors import FormatError, GridError, PorousError
from porous.scale.codec import crc32c
from porous.scale.sealed import seal
from porous.values import Frame
from porous.values.grid import SAMPLINGS
from porous.values.value import Value, counts

if TYPE_CHECKING:
    from collections.abc import Iterator

VERSION = version("porous")
"""Of the porous that runs; asked for once, for it is read from disk."""
FORMAT = 1
"""Changes whenever a store of before would be read wrongly."""
LARGEST_CHUNK = 1 << 28
"""Voxels that a chunk may have: what a hostile store can make a reader allocate."""
MOST_CHUNKS = 1 << 20
"""Chunks that an array may have: more would make the manifest larger than memory likes."""
HASH = re.compile("[0-9a-f]{64}")
FRAME = ("origin", "spacing", "shape", "periodic", "unit", "start")
REST = ("chunk", "sampling", "has_bulk", "recipe_sha256", "hausdorff", "sampling_error", "version")

Triple = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Plan(Value):
    """What is to be stored.

    Parameters
    ----------
    frame
        Where the voxels lie.
    chunk
        Voxels of a chunk along x, y and z; never more than the frame has.
    sampling
        fill, centre or cover.
    has_bulk
        Whether there is a second array, ``bulk``.
    recipe_sha256
        Names the recipe that the voxels come from.
    hausdorff, sampling_error
        As in ``VoxelGrid``.
    version
        Of porous; another one might make other voxels.

    Raises
    ------
    GridError
        For chunks that are empty or too large, too many of them, or values no grid could have.
    """

    frame: Frame
    chunk: Triple
    sampling: str
    has_bulk: bool
    recipe_sha256: str
    hausdorff: float | None = None
    sampling_error: float = 0.0
    version: str = ""

    def __post_init__(self) -> None:
        wanted = counts(self.chunk, "chunk", GridError)
        if min(wanted) < 1:
            raise GridError(f"chunk: got {wanted}; wanted at least one voxel per axis")
        fitted = tuple(min(a, n) for a, n in zip(wanted, self.frame.shape, strict=True))
        self._set("chunk", fitted)
        self._set("version", str(self.version or VERSION))
        self._set("has_bulk", bool(self.has_bulk))
        self._set("sampling_error", float(self.sampling_error))
        self._set("hausdorff", None if self.hausdorff is None else float(self.hausdorff))
        if math.prod(fitted) > LARGEST_CHUNK:
            raise GridError(f"chunk: got {fitted}; wanted at most {LARGEST_CHUNK} voxels")
        if math.prod(self.counts) > MOST_CHUNKS:
            raise GridError(
                f"chunk: {fitted} cuts {self.frame.shape} into {math.prod(self.counts)} chunks; "
                f"wanted at most {MOST_CHUNKS}: choose larger chunks"
            )
        if not HASH.fullmatch(self.recipe_sha256):
            raise GridError(f"recipe_sha256: got {self.recipe_sha256!r}; wanted 64 hex digits")
        self._check_sampling()

    def _check_sampling(self) -> None:
        if self.sampling not in SAMPLINGS:
            raise GridError(f"sampling: got {self.sampling!r}; wanted one of {SAMPLINGS}")
        bounds = (self.sampling_error, 0.0 if self.hausdorff is None else self.hausdorff)
        if not all(0 <= bound < np.inf for bound in bounds):
            raise GridError(f"sampling_error, hausdorff: got {bounds}; wanted distances")

    @property
    def crc32c(self) -> int:
        """The CRC32C of ``plan.json``."""
        return crc32c(seal(self.record()))

    @property
    def arrays(self) -> tuple[str, ...]:
        """Names of the arrays: ``fill``, and ``bulk`` where there is one."""
        return ("fill", "bulk") if self.has_bulk else ("fill",)

    @property
    def counts(self) -> Triple:
        """Numbers of chunks along x, y and z."""
        nx, ny, nz = (-(-n // a) for n, a in zip(self.frame.shape, self.chunk, strict=True))
        return nx, ny, nz

    @property
    def tiles(self) -> tuple[tuple[Triple, Triple], ...]:
        """First voxel and end (not within) of every chunk, cut to the frame, in C order."""
        return tuple(map(self.tile, self.places((0, 0, 0), self.frame.shape)))

    def tile(self, place: Triple) -> tuple[Triple, Triple]:
        """Return first voxel and end of the chunk at ``place`` in the lattice of chunks."""
        x, y, z = (i * a for i, a in zip(place, self.chunk, strict=True))
        shape = self.frame.shape
        u, v, w = (min(s + a, n) for s, a, n in zip((x, y, z), self.chunk, shape, strict=True))
        return (x, y, z), (u, v, w)

    def place(self, index: int) -> Triple:
        """Return where the chunk of that number in C order lies in the lattice of chunks."""
        x, y, z = (int(i) for i in np.unravel_index(index, self.counts))
        return x, y, z

    def places(self, start: Triple, stop: Triple) -> Iterator[Triple]:
        """Return where the chunks lie in their lattice that a box of voxels meets, in C order."""
        edges = zip(start, stop, self.chunk, strict=True)
        x, y, z = (range(a // n, -(-b // n)) for a, b, n in edges)
        return product(x, y, z)

    def chunk_name(self, name: str, place: Triple) -> str:
        """Return the file of a chunk, relative to the store: ``fill/c.0.0.1``."""
        return f"{name}/c.{place[0]}.{place[1]}.{place[2]}"

    def chunk_names(self) -> Iterator[str]:
        """Give the files of all chunks, array by array, in C order."""
        for name in self.arrays:
            for place in self.places((0, 0, 0), self.frame.shape):
                yield self.chunk_name(name, place)

    def record(self) -> dict[str, Any]:
        """Return the plan as plain data for JSON."""
        frame = {name: _plain(getattr(self.frame, name)) for name in FRAME}
        rest = {name: _plain(getattr(self, name)) for name in REST}
        return {"format": FORMAT, "frame": frame, **rest}

    @classmethod
    def of_record(cls, record: dict[str, Any]) -> Plan:
        """Return the plan that a record tells of.

        Raises
        ------
        FormatError
            Where it tells of none, or its format is of a later porous.
        """
        if record.get("format") != FORMAT:
            got = str(record.get("format"))[:20]
            raise FormatError(f"has format {got}; this porous reads {FORMAT}")
        try:
            plan = cls(Frame(**record["frame"]), **{name: record[name] for name in REST})
        except (PorousError, KeyError, TypeError, ValueError, OverflowError) as error:
            raise FormatError(f"tells of no store that could be: {error}") from None
        if plan.record() != record:
            raise FormatError("tells of no store that could be: its values contradict each other")
        return plan

    @classmethod
    def of_metadata(cls, text: bytes) -> Plan:
        """Return the plan that the group's ``zarr.json`` repeats.

        Raises
        ------
        FormatError
            Where one character of it is not as ``metadata`` has written it.
        """
        try:
            plan = cls.of_record(json.loads(text)["attributes"]["porous"])
        except (ValueError, RecursionError, KeyError, TypeError, AttributeError):
            raise FormatError("repeats no plan") from None
        if plan.metadata()["zarr.json"] != text:
            raise FormatError("is damaged")
        return plan

    def metadata(self) -> dict[str, bytes]:
        """Return Zarr's own files by name: the group's and the arrays' ``zarr.json``.

        The group repeats the plan, so that whoever opens it with Zarr learns where the voxels
        lie, and a damaged plan can be mended. It repeats what the arrays say as zarr-python's
        consolidated metadata do, which spares their readers the listing of the folder.
        """
        inner = {name: self._array() for name in self.arrays}
        group = {
            "zarr_format": 3,
            "node_type": "group",
            "attributes": {"porous": self.record(), "porous_crc32c": f"{self.crc32c:08x}"},
            "consolidated_metadata": {
                "kind": "inline",
                "must_understand": False,
                "metadata": inner,
            },
        }
        texts = {"zarr.json": group, **{f"{name}/zarr.json": inner[name] for name in inner}}
        return {name: json.dumps(texts[name], indent=1).encode() + b"\n" for name in texts}

    def _array(self) -> dict[str, Any]:
        return {
            "zarr_format": 3,
            "node_type": "array",
            "shape": list(self.frame.shape),
            "data_type": "uint8",
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": list(self.chunk)}},
            "chunk_key_encoding": {"name": "default", "configuration": {"separator": "."}},
            "fill_value": 0,
            "codecs": [
                {"name": "bytes"},
                {"name": "zstd", "configuration": {"level": 1, "checksum": False}},
                {"name": "crc32c"},
            ],
            "attributes": {},
            "dimension_names": ["x", "y", "z"],
            "storage_transformers": [],
        }


def _plain(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value
