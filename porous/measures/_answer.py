"""How a measure is asked for by name: tables of rows, and the one that answers."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from porous.values import Measure

C = TypeVar("C")

if TYPE_CHECKING:
    Table = Mapping[tuple[str, str], Callable[[C], Measure]]


def answer(table: Table[C], name: str, method: str, census: C) -> Measure:
    """Return the row ``name`` by ``method`` of what ``census`` has counted.

    Raises
    ------
    ValueError
        For a method that this measure does not have; names those it has.
    """
    if (name, method) not in table:
        there = ", ".join(repr(m) for n, m in table if n == name)
        raise ValueError(f"{name}: no method {method!r}; wanted one of {there}")
    return table[name, method](census)
