"""What every value has: read-only arrays, comparison by content, pickling."""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import DTypeLike, NDArray


def frozen(array: object, dtype: DTypeLike) -> NDArray[Any]:
    """Return a C-contiguous read-only array; copies only where somebody else could write."""
    result = np.asarray(array, dtype=dtype, order="C")
    shared = result is array or result.base is not None
    if shared and _writeable(result):
        result = result.copy()
    result.flags.writeable = False
    return result


def frozen_whole(
    array: object, dtype: DTypeLike, what: str, error: type[Exception]
) -> NDArray[Any]:
    """Return ``frozen`` whole numbers, or raise ``error`` where a cast would change a number."""
    given = np.asarray(array)
    if given.size and given.dtype.kind not in "iu":
        raise error(f"{what}: got {given.dtype}; wanted whole numbers")
    if given.size and not np.can_cast(given.dtype, dtype):
        low, high, bounds = int(given.min()), int(given.max()), np.iinfo(np.dtype(dtype))
        if not bounds.min <= low <= high <= bounds.max:
            raise error(f"{what}: got numbers from {low} to {high}; they do not fit {bounds.dtype}")
    return frozen(array, dtype)


def _writeable(array: NDArray[Any]) -> bool:
    # A read-only view of an array that can be written to is not safe.
    owner: object = array
    while isinstance(owner, np.ndarray):
        if owner.flags.writeable:
            return True
        owner = owner.base
    return False


def adopted(array: NDArray[Any]) -> NDArray[Any]:
    """Make an array that porous itself has just made read-only, and what it is a view of."""
    owner: object = array
    while isinstance(owner, np.ndarray):
        owner.flags.writeable = False
        owner = owner.base
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
    both_nan = isinstance(a, float) and isinstance(b, float) and math.isnan(a) and math.isnan(b)
    return both_nan or bool(a == b)


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
        # NaN is left out: equal values would hash by identity.
        small = [v for v in self._content() if isinstance(v, int | float | str) and v == v]
        return hash((type(self).__name__, *small))

    def _set(self, name: str, value: object) -> None:
        """Put a validated field in place; only ``__post_init__`` calls this."""
        object.__setattr__(self, name, value)

    def __getstate__(self) -> dict[str, object]:
        # The fields alone: what a cached property remembers can be found again.
        names = [field.name for field in fields(self)]  # type: ignore[arg-type]
        content = {name: self.__dict__[name] for name in names}
        return {
            name: dict(value) if isinstance(value, MappingProxyType) else value
            for name, value in content.items()
        }

    def __setstate__(self, state: dict[str, object]) -> None:
        for key, value in state.items():
            members = value.values() if isinstance(value, dict) else (value,)
            for array in members:
                if isinstance(array, np.ndarray):
                    array.flags.writeable = False
            self._set(key, MappingProxyType(value) if isinstance(value, dict) else value)


def vector(value: object, what: str, error: type[Exception]) -> tuple[float, float, float]:
    """Return three finite floats, or raise ``error`` naming ``what``."""
    try:
        x, y, z = (float(v) for v in _numbers(value))
    except (TypeError, ValueError, OverflowError):
        raise error(f"{what}: got {value!r}; wanted three numbers") from None
    if not all(map(math.isfinite, (x, y, z))):
        raise error(f"{what}: got {value!r}; wanted three finite numbers")
    return x, y, z


def counts(value: object, what: str, error: type[Exception]) -> tuple[int, int, int]:
    """Return three whole numbers, or raise ``error`` naming ``what``."""
    try:
        x, y, z = map(operator.index, _numbers(value))
    except (TypeError, ValueError):
        raise error(f"{what}: got {value!r}; wanted three whole numbers") from None
    return x, y, z


def flags(value: object, what: str, error: type[Exception]) -> tuple[bool, bool, bool]:
    """Return three truth values, or raise ``error`` naming ``what``."""
    given = tuple(value) if isinstance(value, Iterable) else ()
    if len(given) != 3 or not all(isinstance(v, bool | np.bool_) for v in given):
        raise error(f"{what}: got {value!r}; wanted three of True and False")
    return bool(given[0]), bool(given[1]), bool(given[2])


def _numbers(value: object) -> Iterable[Any]:
    # Text is iterable and its letters may be digits; it is not a vector.
    if not isinstance(value, Iterable) or isinstance(value, str | bytes):
        raise TypeError
    return value
