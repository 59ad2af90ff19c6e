"""A small model of cells for tests: hexahedra of a lattice, bent, some of them left out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from porous.models.simplices import Simplices, hexa_tets
from porous.stages._hexahedralize import CORNERS
from porous.values import Block, Box, Measure, Part, SurfaceMesh, VolumeMesh
from porous.values.volume_mesh import SHAPES
from porous.values.volume_topology import boundary_faces, hung_by_faces, nodes_of

FACES = {"ZMIN": 0, "ZMAX": 1, "YMIN": 2, "XMAX": 3, "YMAX": 4, "XMIN": 5}
"""Local faces of a hexahedron at the ends of the lattice."""


def bent(points):
    """Bend a slab of 2 × 3 × 4 about y, and shear it a little."""
    x, y, z = points.T
    angle = 0.25 * z
    return np.stack([(5 + x) * np.cos(angle), y + 0.1 * x, (5 + x) * np.sin(angle)], axis=1)


@dataclass(frozen=True)
class BentCells:
    """Cells where ``solid`` is True, bent by ``bend``; the bulk is all cells."""

    solid: np.ndarray
    bend: object = bent
    contacts: str = "apart"
    sides: bool = True
    unit: str = "cm"

    @property
    def nodes(self):
        """Lattice points, bent, in C order."""
        shape = np.array(self.solid.shape) + 1
        return self.bend(np.argwhere(np.ones(shape)).astype(float))

    def cells(self, solid):
        """VTK hexahedra (n, 8) of the cells where ``solid`` is."""
        strides = np.array([(n + 1) for n in self.solid.shape])
        place = np.argwhere(solid)[:, None] + np.array(CORNERS)
        return (place[..., 0] * strides[1] + place[..., 1]) * strides[2] + place[..., 2]

    def tets(self, solid):
        """The 24 tetrahedra of each cell."""
        order = [CORNERS.index(corner) for corner in product((0, 1), repeat=3)]
        return Simplices(tets=hexa_tets(self.nodes[self.cells(solid)[:, order]]))

    @property
    def bulk(self):
        return Box(tuple(self.nodes.min(axis=0)), tuple(self.nodes.max(axis=0)))

    domain = bulk

    @cached_property
    def body(self):
        return self.tets(self.solid)

    @cached_property
    def whole(self):
        return self.tets(np.ones_like(self.solid))

    def sample(self, frame, pattern):
        return self.body.sample(frame, pattern)

    def cover(self, frame):
        return self.body.cover(frame)

    def sample_bulk(self, frame, pattern):
        return self.whole.sample(frame, pattern)

    @property
    def bulk_volume(self):
        return gauss(self.nodes[self.cells(np.ones_like(self.solid))])

    @property
    def feature_size(self):
        return 1.0

    def cell_mesh(self):
        mesh = VolumeMesh(self.nodes, (Block("hex8", self.cells(self.solid)),), unit=self.unit)
        if self.contacts == "apart":
            mesh = hung_by_faces(mesh)
        parts = dict(self.parts(mesh)) if self.sides else {}
        tags = {"address": np.flatnonzero(self.solid)}
        return VolumeMesh(mesh.points, mesh.blocks, tags, parts, self.unit)

    def parts(self, mesh):
        cells, outer = np.argwhere(self.solid), boundary_faces(mesh)
        for name, local in FACES.items():
            axis, end = "XYZ".index(name[0]), name.endswith("MAX") * (-1)
            last = np.arange(self.solid.shape[axis])[end]
            own = outer[(outer[:, 1] == local) & (cells[outer[:, 0], axis] == last)]
            yield f"{name}_FACES", Part("faces", own)
            yield name, Part("nodes", np.unique(nodes_of(mesh, own)))

    def boundary(self):
        mesh = self.cell_mesh()
        ring = nodes_of(mesh, boundary_faces(mesh))
        middle = len(mesh.points) + np.arange(len(ring))
        points = np.vstack([mesh.points, mesh.points[ring].mean(axis=1)])
        fans = [[ring[:, k], ring[:, (k + 1) % 4], middle] for k in range(4)]
        triangles = np.array(fans).transpose(2, 0, 1).reshape(-1, 3)
        return SurfaceMesh(points, triangles, self.unit)

    def exact(self, _=(False, False, False)):
        volume = gauss(self.nodes[self.cells(self.solid)])
        rows = {"volume": (volume, "cm³"), "porosity": (1 - volume / self.bulk_volume, "1")}
        return tuple(
            Measure(name, value, unit, "closed form", 0.0, "exact", "model")
            for name, (value, unit) in rows.items()
        )


def gauss(corners):
    """Volume of trilinear hexahedra (n, 8, 3) by Gauss's points, exact."""
    signs = 2 * np.array(CORNERS) - 1
    total = 0.0
    for xi in product((-(3**-0.5), 3**-0.5), repeat=3):
        terms = 1 + signs * xi
        slopes = [signs[:, a] * np.delete(terms, a, axis=1).prod(axis=1) / 8 for a in range(3)]
        jacobian = np.einsum("an,cni->cai", slopes, corners)
        total += np.linalg.det(jacobian).sum()
    return float(total)


assert len(SHAPES["hex8"].faces) == len(FACES)
