"""Bodies that are drawn with beams, as lattices: nodes shared, each beam once.

What is drawn knows only where its beams end. Ends at the same place, give or take rounding, become
one node; that changes the body by rounding, for a lattice is the union of its beams.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.models.simplices import Simplices
from porous.values import BeamLattice

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from porous.values import Box

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

ROUNDING = 1e-10
"""Ends that are closer than this part of the largest coordinate are one node."""


def lattice(parts: Iterable[object], domain: Box, unit: str) -> tuple[BeamLattice, str]:
    """Return beams and balls of a body as a lattice, and what else it has, in words.

    Parameters
    ----------
    parts
        What the body is the union of: ``Simplices``, and parts of other kinds.
    domain
        What lies outside is cut off.
    unit
        Of all lengths.

    Raises
    ------
    ModelError
        Where there are neither beams nor balls.
    """
    parts = list(parts)
    known = [part for part in parts if isinstance(part, Simplices)]
    ends = np.concatenate([np.zeros((0, 2, 3)), *(part.capsules for part in known)])
    radii = np.concatenate([np.zeros(0), *(part.capsule_radii for part in known)])
    balls = np.concatenate([np.zeros((0, 4)), *(part.balls for part in known)])
    if not len(ends) + len(balls):
        raise ModelError(
            "beams: the body is drawn without any; wanted draw = { beams = …, radius = … } or "
            'draw = { along = ["edges"], radius = … }'
        )
    found = _joined(ends, radii, balls, unit)
    if not domain.contains(found.box, tolerance=ROUNDING * max(domain.lengths)):
        found = replace(found, clip=domain)
    return found, _others(known, len(parts) - len(known))


def _joined(ends: Floats, radii: Floats, balls: Floats, unit: str) -> BeamLattice:
    points, index = _merged(np.concatenate([ends.reshape(-1, 3), balls[:, :3]]))
    beams, centres = np.sort(index[: 2 * len(ends)].reshape(-1, 2), axis=1), index[2 * len(ends) :]
    point = beams[:, 0] == beams[:, 1]  # a beam without length is a ball
    centres = np.concatenate([centres, beams[point, 0]])
    beams, thick = _largest(beams[~point], radii[~point])
    nodes, ball_radii = _largest(centres[:, None], np.concatenate([balls[:, 3], radii[point]]))
    return BeamLattice(
        points, beams, np.repeat(thick[:, None], 2, axis=1), nodes[:, 0], ball_radii, unit=unit
    )


def _largest(rows: Indices, radii: Floats) -> tuple[Indices, Floats]:
    """Return each row once, with the largest radius that it has; without one, nothing is left."""
    rows, radii = rows[radii > 0], radii[radii > 0]
    order = np.lexsort((-radii, *rows.T[::-1]))
    rows, radii = rows[order], radii[order]
    first = np.ones(len(rows), bool)
    first[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    return rows[first], radii[first]


def _merged(points: Floats) -> tuple[Floats, Indices]:
    """Return the places that differ by more than rounding, and the place of each point."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    places, index = np.unique(points, axis=0, return_inverse=True)
    near = ROUNDING * float(np.abs(places).max())
    pairs = cKDTree(places).query_pairs(near, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(places), len(places)))
    _, group = connected_components(graph, directed=False)
    _, first, order = np.unique(group, return_index=True, return_inverse=True)
    return places[first], order[index.reshape(-1)].astype(np.int64)


def _others(known: list[Simplices], others: int) -> str:
    counts = {
        "plates": sum(len(part.plates) for part in known),
        "tetrahedra": sum(len(part.tets) for part in known),
        "groups of images of a primitive": others,
    }
    return " and ".join(f"{count} {what}" for what, count in counts.items() if count)
