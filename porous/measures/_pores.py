"""How the pores of a grid hang together: open, closed and through porosity."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from porous.measures._answer import answer
from porous.measures._census import Census
from porous.measures._porosity import Amounts
from porous.values import Measure

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from porous.measures._answer import Table
    from porous.measures._connected import Pieces
    from porous.values.tiled import Tiled

    Choice = Callable[[Pieces], NDArray[np.bool_]]

METHOD = "voxel count"


def _part(census: Census, name: str, choice: Choice) -> Measure:
    """Return the part of the bulk that the chosen pores take, joined by corners and by faces."""
    amounts = Amounts(census)
    bulk = amounts.bulk_count
    wide, narrow = (
        int(pores.voxels[choice(pores)].sum()) / bulk
        for pores in (
            census.pieces(solid=False, connectivity=connectivity, in_bulk=True)
            for connectivity in (26, 6)
        )
    )
    # What sampling may have missed is shared out among all pores by their volumes; where there are
    # none it may be of any kind.
    pores = bulk - amounts.solid_count
    share = amounts.count_share_doubt * (wide * bulk / pores if pores else 1.0)
    return Measure(name, wide, "1", METHOD, abs(wide - narrow) + share, "standard", "grid")


def _open(pores: Pieces) -> NDArray[np.bool_]:
    return pores.open


def _closed(pores: Pieces) -> NDArray[np.bool_]:
    return ~pores.open


def _through(axis: int) -> Choice:
    return lambda pores: pores.through[:, axis]


_CHOICES: dict[str, Choice] = {
    "open_porosity": _open,
    "closed_porosity": _closed,
    **{f"through_porosity_{axis}": _through(a) for a, axis in enumerate("xyz")},
}

GRID: Table[Census] = {
    (name, METHOD): partial(_part, name=name, choice=choice) for name, choice in _CHOICES.items()
}


def open_porosity(grid: Tiled) -> Measure:
    """Return the part of the bulk in pores that are joined with the outside, unit 1.

    The outside is what lies beyond the frame, along axes that are not periodic, and void that is
    not of the bulk. Pores that wind around a periodic axis go on without end and count as open
    too. Pores are joined by faces, edges and corners of voxels (26-connected); the uncertainty
    is the difference to joining by faces only and a fair share of the porosity's, all of it where
    no pore is seen. Open and closed porosity add up to the porosity by voxel count.
    """
    return answer(GRID, "open_porosity", METHOD, Census(grid))


def closed_porosity(grid: Tiled) -> Measure:
    """Return the part of the bulk in pores that are cut off from the outside, unit 1.

    What is open is said in ``open_porosity``.
    """
    return answer(GRID, "closed_porosity", METHOD, Census(grid))


def through_porosity_x(grid: Tiled) -> Measure:
    """Return the part of the bulk in pores that lead through it along x, unit 1.

    Left out of ``measure`` for bodies whose bulk is bent or tilted: they end in no layer of voxels.
    A pore leads through where it reaches the first and the last layer of the bulk; along a
    periodic axis where it winds around it, so that a walk inside the pore leads to the same place
    one or more periods on. Connectivity and uncertainty are those of ``open_porosity``.
    """
    return answer(GRID, "through_porosity_x", METHOD, Census(grid))


def through_porosity_y(grid: Tiled) -> Measure:
    """Return the part of the bulk in pores that lead through it along y; see along x."""
    return answer(GRID, "through_porosity_y", METHOD, Census(grid))


def through_porosity_z(grid: Tiled) -> Measure:
    """Return the part of the bulk in pores that lead through it along z; see along x."""
    return answer(GRID, "through_porosity_z", METHOD, Census(grid))
