"""A number with its method, unit and uncertainty; and a table of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from porous.values.value import Value

if TYPE_CHECKING:
    from collections.abc import Iterator

KINDS = ("exact", "bound", "standard")
ONE_SIDED = {"upper bound": "at most", "lower bound": "at least"}
"""Methods whose value is itself the bound."""

SUBJECTS = ("model", "grid", "surface", "volume")


@dataclass(frozen=True, eq=False)
class Measure(Value):
    """What is known of a body.

    Parameters
    ----------
    name
        The field's term in snake case: ``porosity``, ``specific_surface_area``, …
    value
        The number; infinite or NaN where the quantity is (a non-percolating tortuosity).
    unit
        ``"1"`` for pure numbers, else ``mm``, ``mm²``, ``mm³``, ``1/mm``, …
    method
        How it was found: ``closed form``, ``voxel count``, ``crofton``, …
    uncertainty
        Half-width: zero for exact numbers, a true bound for ``bound``, one standard uncertainty
        for ``standard``; in ``unit``.
    kind
        exact, bound or standard.
    of
        model, grid, surface or volume.
    """

    name: str
    value: float
    unit: str
    method: str
    uncertainty: float
    kind: str
    of: str

    def __post_init__(self) -> None:
        self._set("value", float(self.value))
        self._set("uncertainty", float(self.uncertainty))
        if self.kind not in KINDS:
            raise ValueError(f"kind: got {self.kind!r}; wanted one of {KINDS}")
        if self.of not in SUBJECTS:
            raise ValueError(f"of: got {self.of!r}; wanted one of {SUBJECTS}")
        if not self.uncertainty >= 0 and not math.isnan(self.uncertainty):
            raise ValueError(f"uncertainty: got {self.uncertainty}; wanted zero or more")
        if self.kind == "exact" and self.uncertainty:
            raise ValueError(
                f"uncertainty: got {self.uncertainty}; an exact number has no uncertainty"
            )

    @property
    def spread(self) -> str:
        """How far off it may be, for people: exact, ± 0.01, at most, at least, not known."""
        if self.kind == "exact":
            return "exact"
        if self.method in ONE_SIDED:
            return ONE_SIDED[self.method]
        return f"± {self.uncertainty:.2g}" if math.isfinite(self.uncertainty) else "not known"

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        bound = " bound" if self.spread.startswith("±") and self.kind == "bound" else ""
        return f"{self.name} = {self.value:.6g}{unit} ({self.method}, {self.spread}{bound})"


@dataclass(frozen=True, eq=False)
class Measures(Value):
    """Measures of one body, in the order they were taken.

    ``table["porosity"]`` is the best row by the fixed order of methods,
    ``table["porosity", "voxel count"]`` is that very row, ``table.all("porosity")`` is every row.
    """

    rows: tuple[Measure, ...] = ()

    def __post_init__(self) -> None:
        self._set("rows", tuple(self.rows))

    def __getitem__(self, key: str | tuple[str, str]) -> Measure:
        name, method = (key, None) if isinstance(key, str) else key
        rows = [row for row in self.all(name) if method in (None, row.method)]
        if not rows:
            there = [f"{row.name} ({row.method})" for row in self]
            raise KeyError(f"no measure {key!r}; there are {', '.join(there)}")
        return min(rows, key=_rank)

    def __iter__(self) -> Iterator[Measure]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __add__(self, other: Measures) -> Measures:
        return Measures(self.rows + other.rows)

    def all(self, name: str) -> tuple[Measure, ...]:
        """Return every row of that name."""
        return tuple(row for row in self.rows if row.name == name)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the measures there are, each once, in their order."""
        return tuple(dict.fromkeys(row.name for row in self.rows))


ORDER = (
    "closed form",
    "exact boundary",
    "cells",
    "voxel fill",
    "line probes",
    "crofton",
    "triangles",
    "tetrahedra",
    "hexahedra",
    "voxel count",
    "voxel faces",
)
"""Which method answers for a measure that several took: the first that is there. Binary voxel
faces come last, for on curved bodies they are half as much again. Lattice lines are not there, and
so come after them: of round bodies and of faces at an angle to the axes they are nearer than
crofton, but of faces along the axes they do not doubt where between two voxels these lie (a cube
of 9.3 voxels that fills 10: 12 % too much, said to be right within 4 %), and of walls two voxels
thin they see a fifth too much. Crofton's doubts hold both."""


def _rank(row: Measure) -> int:
    """Return the place of a row's method in ``ORDER``; methods that are not there come after."""
    return ORDER.index(row.method) if row.method in ORDER else len(ORDER)
