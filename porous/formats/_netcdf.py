"""NetCDF files in the classic format with 64-bit offsets, given out piece by piece.

https://docs.unidata.ucar.edu/netcdf-c/current/file_format_specifications.html
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.errors import FormatError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

DIMENSIONS, VARIABLES, ATTRIBUTES = 10, 11, 12
TYPES = {"S": (2, "S1"), "i4": (4, ">i4"), "f4": (5, ">f4"), "f8": (6, ">f8")}
"""Numbers of types, and how their values lie in the file."""
LARGEST = 2**32 - 4
"""The most bytes of a variable."""


@dataclass
class Classic:
    """A file that is being made: dimensions, attributes and variables in their order."""

    attributes: Mapping[str, Any]
    dimensions: dict[str, int] = field(default_factory=dict)
    variables: dict[str, tuple[tuple[str, ...], NDArray[Any], Mapping[str, str]]] = field(
        default_factory=dict
    )

    def put(self, name: str, array: NDArray[Any], /, *dimensions: str, **marks: str) -> None:
        """Add a variable; dimensions that are new get the lengths that the array has.

        One without values grows along the dimension of length 0, and comes last.

        Raises
        ------
        FormatError
            For an array that is larger than the format's offsets allow.
        """
        if array.nbytes > LARGEST:
            raise FormatError(f"{name}: {array.nbytes} bytes; wanted at most {LARGEST} in netCDF")
        for dimension, length in zip(dimensions, array.shape, strict=True):
            if self.dimensions.setdefault(dimension, length) != length:
                raise AssertionError(f"{name}: {dimension} is {self.dimensions[dimension]}")
        self.variables[name] = dimensions, array, marks

    def put_texts(self, name: str, texts: list[str], dimension: str, width: str) -> None:
        """Add a variable of texts, shorter by one than the dimension ``width`` at the most."""
        table = np.zeros((len(texts), self.dimensions[width]), "S1")
        for row, text in zip(table, texts, strict=True):
            row[: len(text)] = np.frombuffer(text.encode("ascii"), "S1")
        self.put(name, table, dimension, width)

    def chunks(self) -> Iterator[bytes]:
        """Give the file's bytes."""
        place = len(self._header(0))
        yield self._header(place)
        for _, array, _ in self.variables.values():
            yield _padded(_laid(array).tobytes())

    def _header(self, place: int) -> bytes:
        """Return what stands before the values, which begin at ``place``."""
        numbers = {name: number for number, name in enumerate(self.dimensions)}
        lengths = [_name(n) + struct.pack(">i", length) for n, length in self.dimensions.items()]
        rows = []
        for name, (dimensions, array, marks) in self.variables.items():
            size = -(-array.nbytes // 4) * 4 or array.itemsize
            shape = [len(dimensions), *(numbers[dimension] for dimension in dimensions)]
            rows.append(
                _name(name)
                + struct.pack(f">{len(shape)}i", *shape)
                + _attributes(marks)
                + struct.pack(">iIq", _type(array)[0], size, place)
            )
            place += size
        return (
            b"CDF\2\0\0\0\0"
            + _list(DIMENSIONS, lengths)
            + _attributes(self.attributes)
            + _list(VARIABLES, rows)
        )


def _attributes(marks: Mapping[str, Any]) -> bytes:
    rows = []
    for name, value in marks.items():
        array = np.array([*value] if isinstance(value, str) else [value])
        if isinstance(value, str):
            array = np.frombuffer(value.encode("ascii"), "S1")
        head = struct.pack(">ii", _type(array)[0], len(array))
        rows.append(_name(name) + head + _padded(_laid(array).tobytes()))
    return _list(ATTRIBUTES, rows)


def _type(array: NDArray[Any]) -> tuple[int, str]:
    return TYPES["S" if array.dtype.kind == "S" else array.dtype.str[1:]]


def _laid(array: NDArray[Any]) -> NDArray[Any]:
    return array.astype(_type(array)[1], copy=False)


def _list(kind: int, rows: list[bytes]) -> bytes:
    return struct.pack(">ii", kind if rows else 0, len(rows)) + b"".join(rows)


def _name(text: str) -> bytes:
    return struct.pack(">i", len(text)) + _padded(text.encode("ascii"))


def _padded(data: bytes) -> bytes:
    return data + b"\0" * (-len(data) % 4)
