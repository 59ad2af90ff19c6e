"""The body that porosity refers to, where cells have lost some of their children.

Faces are subdivided in full whatever the cells keep, so the level-0 cell's faces bound a body
without holes: the same cell with nothing taken away. It holds every cell of the level.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from porous.errors import MeshError
from porous.models.automaton import expand, product
from porous.models.cell_folds import corner_weights
from porous.values import SurfaceMesh
from porous.values.surface_topology import check_closed, joined

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.models.solve import Solution

    Floats = NDArray[np.float64]

WELD = 1e-9
"""Corners of neighbouring faces within this part of the body's size are one point."""

LOOPS = {"triangle": (0, 1, 2), "quad": (0, 1, 3, 2)}
"""Corners of a face in the order of its rim."""


def bulk_surface(solution: Solution, controls: Floats, level: int, unit: str) -> SurfaceMesh:
    """Return the level-0 cell's boundary at a level, quads fanned about their means.

    Where a state's faces do not cover themselves (a cell of one's own whose faces have holes), it
    is the boundary of the level-0 cell.
    """
    surface = _surface(solution, controls, level, unit)
    try:
        check_closed(surface)
    except MeshError:
        return _surface(solution, controls, 0, unit)
    return surface


def _surface(solution: Solution, controls: Floats, level: int, unit: str) -> SurfaceMesh:
    """Return the triangles of the faces; those of a mirrored cell are turned round."""
    brep = solution.brep
    state = brep.states[brep.start]
    soups = []
    for face in brep.of_dimension(brep.start, 2):
        boundary = state.boundaries[face]
        soup = _triangles(solution, boundary.state, product(controls, boundary.matrix), level)
        # Seen from the reference cell's middle, its faces look outwards.
        plan = _triangles(solution, boundary.state, product(state.controls, boundary.matrix), 0)
        middle = state.controls.mean(axis=1)
        if np.einsum("ti,ti->", _areas(plan), plan.mean(axis=1) - middle) < 0:
            soup = soup[:, ::-1]
        soups.append(soup)
    surface = _welded(np.concatenate(soups), unit)
    if surface.volume < 0:
        return replace(surface, triangles=surface.triangles[:, ::-1])
    return surface


def _areas(triangles: Floats) -> Floats:
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.asarray(np.cross(b - a, c - a) / 2)


def _triangles(solution: Solution, state: int, controls: Floats, level: int) -> Floats:
    """Return the triangles (t, 3, 3) of a face's level-``level`` cells."""
    here = replace(solution, brep=replace(solution.brep, start=state))
    states = here.brep.reached
    groups: tuple[tuple[int, Floats], ...] = ((0, controls[None]),)
    if level and here.brep.states[state].children:
        groups = expand(here.automaton(controls), level)
    soups = []
    for place, points in groups:
        q = states[place]
        corners = np.swapaxes(product(points, corner_weights(here, q)), 1, 2)
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
