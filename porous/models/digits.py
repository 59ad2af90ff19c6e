"""Sets of digits: which sub-cubes of the cube cut into N × N × N are kept, and named ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from porous.errors import ModelError
from porous.memory import check_memory
from porous.values.value import Value, frozen

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

SNAP = 1e-12
"""How far from a lattice a map's numbers may be to count as lying on it, in divisions."""

LARGEST = 1 << 20
"""The largest number of divisions; coordinates are multiplied by it."""


@dataclass(frozen=True, eq=False)
class DigitSet(Value):
    """The maps x ↦ (x + d) / divisions for the digits d that are kept.

    Parameters
    ----------
    divisions
        N ≥ 2, along each axis.
    keep
        int64, shape (k, 3), k ≥ 1, each digit once and below ``divisions``; the order is the
        order of the maps.

    Raises
    ------
    ModelError
        Where that is not so; names the digit.
    """

    divisions: int
    keep: NDArray[np.int64]

    def __post_init__(self) -> None:
        if not 2 <= self.divisions <= LARGEST:
            raise ModelError(f"digits: got divisions = {self.divisions}; wanted 2 … {LARGEST}")
        self._set("divisions", int(self.divisions))
        self._set("keep", frozen(_digits(self.keep), np.int64))
        _check_range(self.keep, self.divisions)
        unique, first = np.unique(self.keep, axis=0, return_index=True)
        if len(unique) < len(self.keep):
            again = min(set(range(len(self.keep))) - set(first.tolist()))
            raise ModelError(f"digits: keep[{again}] = {self.keep[again].tolist()} is there twice")

    @property
    def table(self) -> NDArray[np.bool_]:
        """Whether each sub-cube is kept, shape (N, N, N)."""
        check_memory(self.divisions**3, f"a table of {self.divisions}³ sub-cubes", "Divide less.")
        result = np.zeros((self.divisions,) * 3, bool)
        result[tuple(self.keep.T)] = True
        return result

    @cached_property
    def maps(self) -> tuple[tuple[NDArray[np.float64], NDArray[np.float64]], ...]:
        """The affine maps of the unit cube, in the order of ``keep``: matrix and translation."""
        matrix = np.eye(3) / self.divisions
        return tuple((matrix, digit / self.divisions) for digit in self.keep)

    def _content(self) -> tuple[object, ...]:
        return self.divisions, self.keep


def named(name: str, divisions: int | None = None) -> DigitSet:
    """Return a digit set by its name, or raise ``ModelError`` listing what there is.

    ``divisions`` may repeat the set's number of divisions and must then agree.
    """
    if name not in _NAMED:
        raise ModelError(f"digits: no set {name!r}; there are {', '.join(names())}")
    base, kept = _NAMED[name]
    if divisions not in (None, base):
        raise ModelError(f"digits: {name!r} has divisions = {base}; got {divisions}")
    chosen = [d for d in product(range(base), repeat=3) if kept(d)]
    return DigitSet(base, np.array(chosen, np.int64))


def names() -> tuple[str, ...]:
    """Return the names of the digit sets there are, sorted."""
    return tuple(sorted(_NAMED))


def detect(
    maps: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]],
) -> DigitSet | None:
    """Return the digit set whose maps of the unit cube these are, or None where there is none.

    Numbers within ``SNAP`` of the lattice count as on it; two maps on one digit are one.
    """
    ratio = float(maps[0][0][0, 0])
    divisions = round(1 / ratio) if 1 / LARGEST <= ratio <= 0.5 else 0
    if divisions < 2:
        return None
    matrices = np.stack([matrix for matrix, _ in maps]) * divisions
    digits = np.stack([shift for _, shift in maps]) * divisions
    nearest = np.rint(digits)
    if np.abs(matrices - np.eye(3)).max() > SNAP or np.abs(digits - nearest).max() > SNAP:
        return None
    if nearest.min() < 0 or nearest.max() >= divisions:
        return None
    unique, first = np.unique(nearest, axis=0, return_index=True)
    return DigitSet(divisions, unique[np.argsort(first)].astype(np.int64))


def _digits(keep: Any) -> NDArray[np.int64]:
    try:
        array = np.asarray(keep)
        whole = array.astype(np.int64)
    except (TypeError, ValueError, OverflowError):
        raise ModelError(f"digits: got keep = {keep!r:.100}; wanted rows of three") from None
    if whole.ndim != 2 or whole.shape[1] != 3 or not len(whole):
        raise ModelError(f"digits: got keep of shape {whole.shape}; wanted (k, 3) with k ≥ 1")
    if (array != whole).any():
        raise ModelError("digits: wanted whole numbers in keep")
    return whole


def _check_range(keep: NDArray[np.int64], divisions: int) -> None:
    outside = ((keep < 0) | (keep >= divisions)).any(axis=1)
    if outside.any():
        index = int(np.flatnonzero(outside)[0])
        raise ModelError(
            f"digits: keep[{index}] = {keep[index].tolist()}; wanted 0 … {divisions - 1}"
        )


def _middles(digit: tuple[int, ...]) -> int:
    return sum(d == 1 for d in digit)


def _on_planar(*figures: set[tuple[int, int]]) -> Callable[[tuple[int, ...]], bool]:
    return lambda digit: all((digit[0], digit[1]) in figure for figure in figures)


_CORNERS = {(0, 0), (0, 2), (2, 0), (2, 2)}
_RING = {(a, b) for a in range(3) for b in range(3)} - {(1, 1)}

_NAMED: dict[str, tuple[int, Callable[[tuple[int, ...]], bool]]] = {
    "menger": (3, lambda d: _middles(d) <= 1),
    "vicsek-7": (3, lambda d: _middles(d) >= 2),
    "vicsek-9": (3, lambda d: _middles(d) in (0, 3)),
    "cantor-dust": (3, lambda d: _middles(d) == 0),
    "mosely-light": (3, lambda d: _middles(d) in (1, 2)),
    "mosely-heavy": (3, lambda d: _middles(d) >= 1),
    "carpet-prism": (3, _on_planar(_RING)),
    "cantor-prism": (3, _on_planar(_CORNERS)),
    "cube-minus-centre": (3, lambda d: _middles(d) < 3),
    "edge-cubes": (3, lambda d: _middles(d) == 1),
    "even-parity": (2, lambda d: sum(d) % 2 == 0),
    "minus-corner": (2, lambda d: sum(d) < 3),
    "triangle-prism": (2, lambda d: d[:2] != (1, 1)),
    "full-2": (2, lambda _: True),
    "full-3": (3, lambda _: True),
}
"""Divisions and rule of each named set; a digit's rule speaks of how many coordinates are 1."""
