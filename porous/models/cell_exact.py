"""What is known in closed form of bodies of cells: volumes, and topology by counting.

Counts come from powers of the matrix that says which entities an entity is split into, volumes from
the ratios of children or the moments of digits: neither looks at the cells of the level.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from porous.errors import ModelError
from porous.models.brep import MATCHING
from porous.models.cell_body import SPLITS
from porous.models.cell_folds import corner_weights
from porous.models.hexa_volume import block_volume
from porous.models.oracle import Prefractal
from porous.models.rational import is_rational
from porous.models.simplices import volumes
from porous.values import Measure
from porous.values.surface_topology import joined

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from porous.models.automaton import Automaton
    from porous.models.cell_body import CellBody
    from porous.models.solve import Solution

    Floats = NDArray[np.float64]

METHOD = "closed form"


def exact_measures(body: CellBody) -> tuple[Measure, ...]:
    """Return volume, porosity, area and topology of a body of cells, as far as they are known.

    Volumes of cells that are affine images of their state's reference cell, and of blocks with
    eight controls without weights, however bent; areas of straight cubes; the closed union's Euler
    number and pieces (``_26``) of every system, those of 6-connected solids of digit sets and of
    cells that are joined by faces. Nothing is known of bodies with folded cells.
    """
    if _is_folded(body):
        return ()
    return (*_volumes(body), *_areas(body), *_topology(body))


def _is_folded(body: CellBody) -> bool:
    """Tell whether some cell is folded; affine images of cells that are not never are."""
    if affine_volume(body.solution, body.automaton, body.level) is not None:
        return False
    try:
        _ = body.nodes.unfolded
    except ModelError:
        return True
    return False


def _row(name: str, value: float, unit: str = "1") -> Measure:
    return Measure(name, float(value), unit, METHOD, 0.0, "exact", "model")


def _volumes(body: CellBody) -> Iterator[Measure]:
    volume = affine_volume(body.solution, body.automaton, body.level)
    if volume is None and _is_block(body):
        cells = (points for group in body.automaton.level_zero for points in group.points)
        volume = sum(block_volume(points, body.digits_by_level) for points in cells)
    if volume is None:
        return
    density = volume / body.bulk_volume
    if body.bulk_box is None:
        density = min(density, 1.0)  # the cells lie in it: more is rounding
    yield _row("volume", volume, f"{body.unit}³")
    yield _row("porosity", 1 - density)
    yield _row("relative_density", density)


def _areas(body: CellBody) -> Iterator[Measure]:
    """Yield the area of a straight cube with one digit set: its faces, counted."""
    edge = _cube_edge(body)
    if edge is None or len(set(body.digits)) != 1:
        return
    counted = Prefractal(body.digits[0], body.level)
    area = counted.faces * (edge / body.digits[0].divisions ** body.level) ** 2
    yield _row("surface_area", area, f"{body.unit}²")
    yield _row("specific_surface_area", area / body.bulk_volume, f"1/{body.unit}")


def _is_block(body: CellBody) -> bool:
    """Tell whether the cells are the images of a cube's sub-cubes under trilinear maps."""
    regular = volume_ratios(body.solution) is not None
    eight = body.brep.states[body.brep.start].size == 8 and not is_rational(body.controls)
    return regular and bool(body.digits) and eight


def _cube_edge(body: CellBody) -> float | None:
    if body.macro or not _is_block(body):
        return None
    edges = body.controls[:, [4, 2, 1]] - body.controls[:, :1]
    edge = float(np.linalg.norm(edges[:, 0]))
    square = np.abs(edges.T @ edges - edge**2 * np.eye(3)).max() <= MATCHING * edge**2
    reference = body.brep.states[body.brep.start].controls
    straight = affine_image(reference, body.controls) is not None
    return edge if square and straight else None


def _topology(body: CellBody) -> Iterator[Measure]:
    from porous.models.counts import euler_number

    if len(set(body.digits)) == 1 and not body.macro:
        counted = Prefractal(body.digits[0], body.level)
        known = {
            "components": counted.components(6),
            "euler_number": counted.count("euler_number"),
            "genus": counted.genus(6),
            "components_26": counted.components(26),
            "euler_number_26": counted.count("euler_number_26"),
            "genus_26": counted.genus(26),
        }
    else:
        known = {
            "components": _face_components(body),
            "components_26": body.complex.components,
            "euler_number_26": euler_number(body.closure, body.level, body.level_zero),
        }
    for name, value in known.items():
        if value is not None:
            yield _row(name, float(value))


def _face_components(body: CellBody) -> int:
    """Return the number of pieces of cells that are joined by faces."""
    nodes = body.nodes
    fans = [np.full(len(group.place), group.faces.shape[1]) for group in nodes.groups]
    cell = np.repeat(np.arange(nodes.cells), np.concatenate(fans))
    one, other = (cell[sides] for sides in nodes.pairs)
    return int(joined(nodes.cells, one, other).max(initial=-1)) + 1


def affine_volume(solution: Solution, automaton: Automaton, level: int) -> float | None:
    """Return the volume of all cells of a level where each is an affine image of its reference.

    The sum over the paths of the products of volume ratios: a power of the matrix of ratios. None
    where some child is no affine image of its state's reference cell, or a level-0 cell is not,
    as cells with weights are not.

    Parameters
    ----------
    solution
        The matrices.
    automaton
        The placed level-0 cells.
    level
        Zero or more.
    """
    brep = solution.brep
    ratios = volume_ratios(solution)
    if ratios is None:
        return None
    filled = np.array([reference_volume(solution, q) for q in brep.reached])
    sums = np.linalg.matrix_power(ratios, level) @ filled
    total = 0.0
    for group in automaton.level_zero:
        reference = brep.states[brep.reached[group.state]].controls
        for points in group.points:
            whole = None if is_rational(points) else affine_image(reference, points)
            if whole is None:
                return None
            total += float(abs(np.linalg.det(whole)) * sums[group.state])
    return total


def volume_ratios(solution: Solution) -> Floats | None:
    """Return the sums of the volume ratios of children by states (reached, reached).

    A ratio is |det A| of the affine map that takes a child's reference cell into its parent's; None
    where some child is no affine image of its reference cell.
    """
    brep = solution.brep
    place = {q: i for i, q in enumerate(brep.reached)}
    ratios = np.zeros((len(place),) * 2)
    for q in brep.reached:
        state = brep.states[q]
        for child, matrix in zip(state.children, solution.matrices[q], strict=True):
            image = affine_image(brep.states[child.state].controls, state.controls @ matrix)
            if image is None:
                return None
            ratios[place[q], place[child.state]] += abs(np.linalg.det(image))
        if not state.children:
            ratios[place[q], place[q]] = 1.0
    return ratios


def reference_volume(solution: Solution, index: int) -> float:
    """Return the volume of a state's reference cell."""
    state = solution.brep.states[index]
    corners = (state.controls @ corner_weights(solution, index)).T
    return float(np.abs(volumes(SPLITS[state.shape](corners[None]))).sum())


def affine_image(reference: Floats, points: Floats) -> Floats | None:
    """Return the linear part A (3, 3) with points = A·reference + b, or None where there is none.

    Both are (3, m); differences within ``MATCHING`` of the points' extent count as none.
    """
    lifted = np.vstack([reference, np.ones(reference.shape[1])])
    found = np.linalg.lstsq(lifted.T, points.T, rcond=None)[0].T
    size = float(np.ptp(points, axis=1).max())
    gap = float(np.abs(found @ lifted - points).max())
    return np.asarray(found[:, :3]) if gap <= MATCHING * size else None
