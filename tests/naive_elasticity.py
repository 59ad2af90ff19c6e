"""Linear elasticity by scikit-fem: what a deck's static step should come to."""

import itertools

import numpy as np
import skfem
from skfem.helpers import ddot, div, sym_grad

KINDS = {
    "tet4": (skfem.MeshTet, skfem.ElementTetP1(), [0, 1, 2, 3]),
    "hex8": (skfem.MeshHex, skfem.ElementHex1(), [0, 1, 3, 4, 2, 5, 7, 6]),
    "wed6": (skfem.MeshWedge1, skfem.ElementWedge1(), [0, 1, 2, 3, 4, 5]),
}
"""scikit-fem's mesh and element, and its corners in our numbers."""


WEDGE = np.array([[1 / 3, 1 / 3, 0.5 - s * 12**-0.5] for s in (1, -1)]).T, np.array([0.25, 0.25])
"""Points and weights in a wedge."""


def energy(job):
    """Return the strain energy of a job's step, in the mesh's own unit, and the reaction (3,).

    Tetrahedra are linear. Hexahedra are trilinear, of any shape, and integrated in 2 × 2 × 2
    points, wedges linear times linear and in 1 × 2, as CalculiX has them.
    """
    u, f = solved(job)
    return 0.5 * u @ f, -f.reshape(-1, 3).sum(axis=0)


def solved(job):
    """Return displacements and forces of a job's step, three for each node."""
    mesh = job.mesh
    points = np.ascontiguousarray(mesh.points.T)
    E, nu = job.materials["SOLID"].youngs_modulus, job.materials["SOLID"].poissons_ratio
    shear, bulk = E / (2 * (1 + nu)), E / (3 * (1 - 2 * nu))

    @skfem.BilinearForm
    def stiffness(u, v, _):
        a, b = sym_grad(u), sym_grad(v)
        return 2 * shear * ddot(a, b) + (bulk - 2 * shear / 3) * div(u) * div(v)

    K = 0
    for block in mesh.blocks:
        kind, element, order = KINDS[block.shape]
        m = kind(points, np.ascontiguousarray(block.cells[:, order].T))
        points_of = {"quadrature": WEDGE} if block.shape == "wed6" else {"intorder": 3}
        part = stiffness.assemble(skfem.Basis(m, skfem.ElementVector(element), **points_of))
        part.resize((mesh.points.size,) * 2)  # the last points may be of other blocks
        K = K + part
    f = np.zeros(K.shape[0])
    for nodes, areas in loaded(job):
        f[3 * nodes[:, None] + np.arange(3)] -= job.steps[0].pressed[0].pressure * areas
    held = (3 * mesh.parts[job.steps[0].held[0].part].members[:, None] + np.arange(3)).ravel()
    return skfem.solve(*skfem.condense(K, f, D=held)), f


CURVED = {
    "tet10": (4, skfem.MeshTet, skfem.ElementTetP2(), [0, 1, 2, 3]),
    "hex20": (8, skfem.MeshHex, skfem.ElementHexS2(), [0, 1, 3, 4, 2, 5, 7, 6]),
}
"""Of elements with nodes along straight edges: their corners, and as in ``KINDS``."""


def curved_energy(job):
    """Return what ``energy`` does for the quadratic elements of a box pressed along an axis.

    The sides are found by coordinates, not by the parts that the deck is written from.
    """
    mesh, step = job.mesh, job.steps[0]
    (block,) = mesh.blocks
    count, kind, element, order = CURVED[block.shape]
    used, cells = np.unique(block.cells[:, :count], return_inverse=True)
    cells = cells.reshape(-1, count)[:, order]
    m = kind(np.ascontiguousarray(mesh.points[used].T), np.ascontiguousarray(cells.T))
    basis = skfem.Basis(m, skfem.ElementVector(element), intorder=4)
    material = job.materials["SOLID"]
    E, nu = material.youngs_modulus, material.poissons_ratio
    shear, lame = E / (2 * (1 + nu)), E * nu / (1 + nu) / (1 - 2 * nu)

    @skfem.BilinearForm
    def stiffness(u, v, _):
        a, b = sym_grad(u), sym_grad(v)
        return 2 * shear * ddot(a, b) + lame * div(u) * div(v)

    @skfem.LinearForm
    def push(v, w):
        return -step.pressed[0].pressure * sum(v[i] * w.n[i] for i in range(3))

    axis = "XYZ".index(step.held[0].part[0])
    low, high = (
        m.facets_satisfying(lambda x, end=end: np.isclose(x[axis], end), boundaries_only=True)
        for end in (m.p[axis].min(), m.p[axis].max())
    )
    K = stiffness.assemble(basis)
    f = push.assemble(skfem.FacetBasis(m, skfem.ElementVector(element), facets=high, intorder=4))
    u = skfem.solve(*skfem.condense(K, f, D=basis.get_dofs(low).all()))
    return 0.5 * u @ f


def loaded(job):
    """Yield the nodes of each loaded face and the part of its outward area that each bears."""
    from porous.values import SHAPES

    cells = [(block.shape, cell) for block in job.mesh.blocks for cell in block.cells]
    for number, local in job.mesh.parts[job.steps[0].pressed[0].part].members:
        shape, cell = cells[number]
        nodes = cell[list(SHAPES[shape].faces[local])]
        p = job.mesh.points[nodes]
        if len(nodes) == 3:
            yield nodes, np.tile(np.cross(p[1] - p[0], p[2] - p[0]) / 6, (3, 1))
        else:
            yield nodes, bilinear(p)


def bilinear(p):
    """Return the integral of each corner's weight times the area vector, in 2 × 2 points."""
    areas = np.zeros((4, 3))
    for s, t in itertools.product((0.5 - 0.5 / 3**0.5, 0.5 + 0.5 / 3**0.5), repeat=2):
        along_s = (1 - t) * (p[1] - p[0]) + t * (p[2] - p[3])
        along_t = (1 - s) * (p[3] - p[0]) + s * (p[2] - p[1])
        weights = np.array([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t])
        areas += weights[:, None] * np.cross(along_s, along_t) / 4
    return areas
