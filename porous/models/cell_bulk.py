"""The body that porosity refers to, where cells have lost some of their children.

Faces are subdivided in full whatever the cells keep, so the level-0 cell's faces bound a body
without holes: the same cell with nothing taken away. It holds every cell of the level.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError
from porous.models.automaton import Cells, expand, product
from porous.models.cell_folds import corner_weights, handedness
from porous.models.rational import positions
from porous.values import SurfaceMesh
from porous.values.surface_topology import check_closed, joined

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.models.automaton import Automaton
    from porous.models.complex import Complex
    from porous.models.solve import Solution

    Floats = NDArray[np.float64]

WELD = 1e-9
"""Corners of neighbouring faces within this part of the body's size are one point."""

LOOPS = {"triangle": (0, 1, 2), "quad": (0, 1, 3, 2)}
"""Corners of a face in the order of its rim."""


def bulk_surface(
    solution: Solution, automaton: Automaton, start: Complex, level: int, unit: str
) -> SurfaceMesh:
    """Return the outer boundary of the level-0 cells at a level, quads fanned about their means.

    Where a state's faces do not cover themselves (a cell of one's own whose faces have holes), it
    is the boundary of the level-0 cells.

    Parameters
    ----------
    solution
        The matrices.
    automaton
        The placed level-0 cells.
    start
        The complex of these.
    level
        Zero or more.
    unit
        Unit of the coordinates.
    """
    surface = _surface(solution, automaton, start, level, unit)
    try:
        check_closed(surface)
    except MeshError:
        return _surface(solution, automaton, start, 0, unit)
    return surface


def _surface(
    solution: Solution, automaton: Automaton, start: Complex, level: int, unit: str
) -> SurfaceMesh:
    """Return the triangles of the outer faces; those of mirrored cells are turned round."""
    brep = solution.brep
    weights = {q: corner_weights(solution, q) for q in brep.reached}
    hand = handedness(solution, automaton, weights, 0)
    soups = []
    for group, placed in zip(start.cells, automaton.level_zero, strict=True):
        state = brep.states[group.state]
        middle = state.controls.mean(axis=1)
        for face in brep.of_dimension(group.state, 2):
            boundary = state.boundaries[face]
            # Seen from the reference cell's middle, its faces look outwards.
            plan = product(state.controls, boundary.matrix)[None]
            seen = _triangles(solution, boundary.state, plan, 0)
            way = np.einsum("ti,ti->", _areas(seen), seen.mean(axis=1) - middle)
            outer = start.origin[boundary.state][group.ids[:, face]] >= 0
            for own in (outer & (hand[placed.place] > 0), outer & (hand[placed.place] < 0)):
                if own.any():
                    points = product(placed.points[own], boundary.matrix)
                    soup = _triangles(solution, boundary.state, points, level)
                    turned = way * hand[placed.place[own][0]] < 0
                    soups.append(soup[:, ::-1] if turned else soup)
    return _welded(np.concatenate(soups), unit)


def _areas(triangles: Floats) -> Floats:
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.asarray(np.cross(b - a, c - a) / 2)


def _triangles(solution: Solution, state: int, controls: Floats, level: int) -> Floats:
    """Return the triangles (t, 3, 3) of the level-``level`` cells of faces (k, 3 or 4, m)."""
    here = replace(solution, brep=replace(solution.brep, start=state, more=()))
    states = here.brep.reached
    groups: tuple[tuple[int, Floats], ...] = ((0, controls),)
    if level and here.brep.states[state].children:
        roots = (Cells(0, controls, np.arange(len(controls))),)
        groups = expand(here.automaton(roots=roots), level)
    soups = []
    for place, points in groups:
        q = states[place]
        corners = np.swapaxes(positions(product(points, corner_weights(here, q))), 1, 2)
        soups.append(fanned(corners[:, LOOPS[here.brep.states[q].shape]]))
    return np.concatenate(soups)


def fanned(rims: Floats) -> Floats:
    """Return the triangles (t, 3, 3) of rims (k, c, 3): quads are fanned about their mean."""
    if rims.shape[1] == 3:
        return rims
    after = np.roll(rims, -1, axis=1)
    middle = np.broadcast_to(rims.mean(axis=1, keepdims=True), rims.shape)
    return np.stack([rims, after, middle], axis=2).reshape(-1, 3, 3)


def _welded(triangles: Floats, unit: str) -> SurfaceMesh:
    from scipy.spatial import cKDTree

    corners = triangles.reshape(-1, 3)
    size = float(np.ptp(corners, axis=0).max())
    pairs = cKDTree(corners).query_pairs(WELD * size, output_type="ndarray")
    point = joined(len(corners), pairs[:, 0], pairs[:, 1])
    points = np.empty((point.max() + 1, 3))
    points[point[::-1]] = corners[::-1]
    return SurfaceMesh(points, point.reshape(-1, 3), unit)
