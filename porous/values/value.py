"""What every value has: read-only arrays, comparison by content, pickling."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray


def frozen(array: object, dtype: DTypeLike) -> NDArray[Any]:
    """Return a C-contiguous read-only array; copies only where the caller could write."""
    given = np.asarray(array)
    result = np.ascontiguousarray(given, dtype=dtype)
    if result.flags.writeable:
        result = result.copy() if result is given or result.base is not None else result
        result.flags.writeable = False
    return result


def adopted(array: NDArray[Any]) -> NDArray[Any]:
    """Make an array that porous itself has just made read-only, without a copy."""
    array.flags.writeable = False
    return array


def same(a: object, b: object) -> bool:
    """Compare two fields by content: arrays element by element, mappings key by key."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return (
            isinstance(a, np.ndarray)
            and isinstance(b, np.ndarray)
            and a.dtype == b.dtype
            and np.array_equal(a, b)
        )
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return bool(a == b)


class Value:
    """Base of the frozen dataclasses that flow: compare by content, hash by the small fields."""

    def _content(self) -> tuple[object, ...]:
        return tuple(getattr(self, field.name) for field in fields(self))  # type: ignore[arg-type]

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        assert isinstance(other, Value)
        return all(map(same, self._content(), other._content()))

    def __hash__(self) -> int:
        small = (int, float, str, bool, type(None))
        return hash((type(self).__name__, *(v for v in self._content() if isinstance(v, small))))

    def _set(self, name: str, value: object) -> None:
        """Put a validated field in place; only ``__post_init__`` calls this."""
        object.__setattr__(self, name, value)

    def __getstate__(self) -> dict[str, object]:
        return {
            key: dict(value) if isinstance(value, MappingProxyType) else value
            for key, value in self.__dict__.items()
        }

    def __setstate__(self, state: dict[str, object]) -> None:
        for key, value in state.items():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            self._set(key, MappingProxyType(value) if isinstance(value, dict) else value)


def vector(value: object, what: str, error: type[Exception]) -> tuple[float, float, float]:
    """Return three finite floats, or raise ``error`` naming ``what``."""
    try:
        x, y, z = (float(v) for v in value)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        raise error(f"{what}: got {value!r}; wanted three numbers") from None
    if not all(np.isfinite((x, y, z))):
        raise error(f"{what}: got {value!r}; wanted three finite numbers")
    return x, y, z


def counts(value: object, what: str, error: type[Exception]) -> tuple[int, int, int]:
    """Return three whole numbers, or raise ``error`` naming ``what``."""
    try:
        x, y, z = (int(v) for v in value)  # type: ignore[attr-defined]
    except (TypeError, ValueError, OverflowError):
        raise error(f"{what}: got {value!r}; wanted three whole numbers") from None
    return x, y, z
