"""Bodies of balls, beams and plates along the cells of a boundary-controlled system.

Also the solid cells themselves where they grow by a ball or are fused where they touch: bodies
that are no meshes by construction.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import ModelError
from porous.models.cell_body import filled, thinnest
from porous.models.cell_bulk import fanned
from porous.models.cell_mesh import hung
from porous.models.cell_surface import cell_boundary
from porous.models.cell_system import CellSystem
from porous.models.simplices import Simplices
from porous.models.struts import lattice
from porous.values.value import Value

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from porous.models.brep import BRep
    from porous.models.lines import LineBody
    from porous.values import BeamLattice, Frame, Pattern

    Floats = NDArray[np.float64]
    Indices = NDArray[np.int64]

DIMENSIONS = {"vertices": 0, "edges": 1, "face-diagonals": 2, "faces": 2, "body-diagonals": 3}
"""What can be swept, and the dimension of the parts of cells that it is found on."""

DIAGONALS = {"quad": ((0, 3), (1, 2)), "hexa": ((0, 7), (1, 6), (2, 5), (3, 4))}
"""Pairs of corners of a shape that a diagonal joins; other shapes have none."""

RIMS = {"triangle": (0, 1, 2), "quad": (0, 1, 3, 2)}


@dataclass(frozen=True, eq=False)
class Sweep(Value):
    """What is swept by a ball: parts of the cells, and the ball's radius in the model's unit.

    Raises ``ModelError`` for parts that there are not or a radius that is not positive.
    """

    along: tuple[str, ...]
    radius: float

    def __post_init__(self) -> None:
        self._set("along", tuple(self.along))
        missing = [part for part in self.along if part not in DIMENSIONS]
        if missing or not self.along:
            raise ModelError(f"draw: got {list(self.along)}; wanted some of {list(DIMENSIONS)}")
        if not 0 < self.radius < np.inf:
            raise ModelError(f"draw: got a radius of {self.radius}; wanted a length above zero")


@dataclass(frozen=True, eq=False)
class SweptBody(CellSystem):
    """What is drawn along the cells of a level, grown by a ball.

    Parameters
    ----------
    sweep
        What is swept; None for the solid cells.
    offset
        Radius of the ball added, in ``unit``.
    fused
        Radius of what joins solid cells that meet in an edge or a point alone; zero for nothing.
    """

    sweep: Sweep | None = None
    offset: float = 0.0
    fused: float = 0.0

    def sample(self, frame: Frame, pattern: Pattern) -> NDArray[np.uint64]:
        """Return the mask of each voxel: bit r·C + c where the pattern's point lies in the body."""
        self.reach.check(frame, certain=False)
        return self.body.sample(frame, pattern)

    def cover(self, frame: Frame) -> tuple[NDArray[np.uint64], float]:
        """Return marks of every voxel that the body touches, and a Hausdorff bound."""
        self.reach.check(frame, certain=True)
        return self.body.cover(frame)

    @cached_property
    def body(self) -> Simplices:
        """The body as a union of simplices, solid and swept."""
        if self.sweep is not None:
            return swept(self, self.sweep).grown(self.offset)
        balls, capsules = self._joints()
        solid = Simplices(
            tets=filled(self),
            balls=balls,
            capsules=capsules,
            capsule_radii=np.full(len(capsules), self.fused),
        )
        if not self.offset:
            return solid
        skin = cell_boundary(self.nodes, unit=self.unit)
        return solid.grown(self.offset, skin=skin.corners)

    def line_body(self) -> LineBody | None:
        """Return the body for lines; see ``models.lines``."""
        from porous.models.lines import lines_of

        return lines_of([self.body])

    def beam_lattice(self) -> tuple[BeamLattice, str]:
        """Return the beams and balls along the cells, and what else there is, in words.

        Raises ``ModelError`` where there are none.
        """
        return lattice((self.body,), self.domain, self.unit)

    def _joints(self) -> tuple[Floats, Floats]:
        if not self.fused:
            return np.zeros((0, 4)), np.zeros((0, 2, 3))
        points, edges = contacts(self)
        centres, ends = self.nodes.points[points], self.nodes.points[edges]
        return np.column_stack([centres, np.full(len(centres), self.fused)]), ends

    @property
    def feature_size(self) -> float | None:
        """The length that ``per_feature`` divides: the thickness of what is swept, or of cells."""
        if self.sweep is not None:
            return 2 * (self.sweep.radius + self.offset)
        return min(thinnest(self)) + 2 * self.offset or None


def swept(system: CellSystem, sweep: Sweep) -> Simplices:
    """Return balls at vertices, beams along edges and diagonals, and plates on faces."""
    used, places = _used_parts(system), system.places[0]
    vertices, beams = [np.zeros(0, np.int64)], [np.zeros((0, 2), np.int64)]
    plates = [np.zeros((0, 3, 3))]
    for part in used:
        if "vertices" in sweep.along and part.shape == "vertex":
            vertices.append(part.vertices.ravel())
        if "edges" in sweep.along and part.shape == "edge":
            beams.append(part.vertices)
        for name in ("face-diagonals", "body-diagonals"):
            if name in sweep.along and DIMENSIONS[name] == part.dimension:
                pairs = np.array(DIAGONALS.get(part.shape, ()), np.int64).reshape(-1, 2)
                beams.append(part.vertices[:, pairs].reshape(-1, 2))
        if "faces" in sweep.along and part.shape in RIMS:
            plates.append(fanned(places[part.vertices[:, RIMS[part.shape]]]))
    return _body(
        places[np.concatenate(vertices)],
        places[np.concatenate(beams)],
        np.concatenate(plates),
        sweep.radius,
    )


def _body(points: Floats, beams: Floats, plates: Floats, radius: float) -> Simplices:
    return Simplices(
        balls=np.column_stack([points, np.full(len(points), radius)]),
        capsules=beams,
        capsule_radii=np.full(len(beams), radius),
        plates=plates,
        plate_radii=np.full(len(plates), radius),
    )


class _Parts(NamedTuple):
    """All the parts of one state that cells of a level have, each once: vertices (k, c)."""

    shape: str
    dimension: int
    vertices: Indices


def _used_parts(system: CellSystem) -> list[_Parts]:
    """Return the vertices, edges, faces and cells of a level, each once."""
    brep = system.brep
    found: dict[int, dict[str, list[Indices]]] = {}
    result = []
    for group, vertices in zip(system.complex.cells, system.places[1], strict=True):
        state = brep.states[group.state]
        place = {k: i for i, k in enumerate(brep.of_dimension(group.state, 0))}
        for k, boundary in enumerate(state.boundaries):
            ends = [
                place[use.boundary]
                for use, inner in zip(
                    brep.sub[group.state][k], brep.states[boundary.state].boundaries, strict=True
                )
                if brep.states[inner.state].dimension == 0
            ]
            if not ends:
                ends = [place[k]]
            known = found.setdefault(boundary.state, {"ids": [], "vertices": []})
            known["ids"].append(group.ids[:, k])
            known["vertices"].append(vertices[:, ends])
        result.append(_Parts(state.shape, state.dimension, vertices))
    for index, known in found.items():
        _, first = np.unique(np.concatenate(known["ids"]), return_index=True)
        shape = brep.states[index].shape
        vertices = np.concatenate(known["vertices"])[first]
        result.append(_Parts(shape, brep.states[index].dimension, vertices))
    return result


def contacts(system: CellSystem) -> tuple[Indices, Indices]:
    """Return the vertices (p,) and edges (e, 2) where cells meet that are not joined by faces."""
    node, vertex = hung(system.nodes)
    points = np.flatnonzero(np.bincount(vertex) > 1)
    ends, first = [], 0
    for group in system.nodes.groups:
        own = node[first : first + group.corners.size].reshape(group.corners.shape)
        first += group.corners.size
        ends.append(own[:, _edge_corners(system.brep, group.state)].reshape(-1, 2))
    pairs = np.unique(np.sort(np.concatenate(ends), axis=1), axis=0)
    rows, count = np.unique(np.sort(vertex[pairs], axis=1), axis=0, return_counts=True)
    return points, np.asarray(rows[count > 1])


def _edge_corners(brep: BRep, state: int) -> Indices:
    """Return the corners (e, 2) that the edges of a cell join."""
    place = {k: i for i, k in enumerate(brep.of_dimension(state, 0))}
    edges = [brep.sub[state][k] for k in brep.of_dimension(state, 1)]
    return np.array([[place[use.boundary] for use in edge] for edge in edges])
